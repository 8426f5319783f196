//! Parameter blocks and groups of measurements, in a stable order: the least-squares problem itself.
//!
//! The order in which blocks and measurements are added is the order of every sum, so that a result
//! depends on neither chance nor the number of threads.
//!
//! ```text
//! builder                            collects, and decides how blocks are eliminated
//! least_squares                      cost, linearisation, steps
//! factors, selected                  of the normal matrix, whichever way it is eliminated
//! frames_factor, selected_frames     of poses along time
//! apart, together                    many bodies one by one; all bodies at once
//! normal                             what is linearised, for all of them
//! frames_linear, frames, bodies, time_steps      poses along time
//! leaves, leaf_kernels               blocks that are eliminated first, one by one
//! assembly                           all other blocks
//! common                             what all moments share
//! gauge_orbit                        steps that follow a body's frame
//! group                              measurements of one kind
//! accumulators, layout, model        what they fill, where it stands, what it means
//! ```
//!
//! Each uses what stands below it, and nothing above.

mod accumulators;
mod apart;
mod assembly;
mod bodies;
mod builder;
mod common;
mod factors;
mod frames;
mod frames_factor;
mod frames_linear;
mod gauge_orbit;
mod group;
mod layout;
mod leaf_kernels;
mod least_squares;
mod leaves;
mod model;
mod normal;
mod selected;
mod selected_frames;
#[cfg(test)]
mod tests;
mod time_steps;
mod together;
mod whole_group;

pub use builder::SystemBuilder;
pub use factors::Factors;
pub use frames::Arrangement;
pub use frames_factor::Accuracy;
pub use group::{IMPOSSIBLE_SIGMAS, Measurement};
pub use layout::{BlockId, GroupId, Values};
pub use least_squares::{OwnNormals, System};
pub(crate) use model::Step;
pub use model::{Cost, Curvature};
pub use normal::Normal;
pub(crate) use selected::SelectedInverse;
pub use time_steps::TimeStep;
