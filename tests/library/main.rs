//! What the library finds, of problems whose truth is known.

mod adjustment;
mod convergence;
mod dbat;
mod diagnosis;
mod found_poses;
mod gross_errors;
mod noise_free;
mod observability;
mod pulls;
mod registration;
mod scale_bar;
mod scene;
mod statistics;
#[path = "../support/mod.rs"]
mod support;
mod wrong_tracks;
