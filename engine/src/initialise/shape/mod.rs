//! The shape of a vehicle, and targets: points where rays meet.

pub mod dlt;
pub mod robust_dlt;
pub mod triangulation;
