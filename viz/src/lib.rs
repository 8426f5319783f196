//! What is seen of an adjustment: a [`Scene`] of numbers, and its recording for the Rerun viewer.
//!
//! This package knows nothing of adjustment. It draws cameras, moving bodies, points, image points
//! and curves that somebody else computed. Without the feature `rerun` it is the scene alone.

#[cfg(feature = "rerun")]
mod blueprint;
#[cfg(feature = "rerun")]
mod colour;
#[cfg(feature = "rerun")]
mod path;
#[cfg(feature = "rerun")]
mod recording;
mod scene;

#[cfg(feature = "rerun")]
pub use recording::{RecordingError, save};
pub use scene::{
    Body, Camera, Frame, Ground, ImagePoint, ImagePointKind, Iteration, Marking, Pose, Scene, State, Target,
    TargetRole, TrackPoint, TrackPrecision,
};
