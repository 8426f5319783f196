//! The system against dense algebra and finite differences.

mod along_time;
mod eliminated_first;
mod examples;
mod gauge_orbit;
mod normal_equations;
mod residuals;
mod selected;
mod shared;
