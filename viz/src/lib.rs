//! What is seen of an adjustment: a [`Scene`] of numbers, and its recording for the Rerun viewer.
//!
//! This package knows nothing of adjustment. It draws cameras, moving bodies, points, image points
//! and curves that somebody else computed. Without the feature `rerun` it is the scene alone.

#[cfg(feature = "rerun")]
mod blueprint;
#[cfg(feature = "rerun")]
mod colour;
mod error;
#[cfg(feature = "rerun")]
mod file;
#[cfg(feature = "rerun")]
mod live;
#[cfg(feature = "rerun")]
mod path;
#[cfg(feature = "rerun")]
mod recording;
mod scene;
#[cfg(feature = "rerun")]
mod sdk;
#[cfg(not(feature = "rerun"))]
mod without;

pub use error::RecordingError;
#[cfg(feature = "rerun")]
pub use file::save;
#[cfg(feature = "rerun")]
pub use live::{Live, show};
pub use scene::{
    Body, BodySnapshot, Camera, DEFAULT_RESIDUAL_FACTOR, Film, Frame, Geodetic, Ground, ImagePoint,
    ImagePointKind, Iteration, Map, MapTrack, Marking, Open, Pose, ReferencePlace, Scan, Scene, Snapshot,
    State, Target, TargetRole, TrackPoint, TrackPrecision, each_second,
};
#[cfg(not(feature = "rerun"))]
pub use without::{Live, save, show};

/// Whether this build records at all.
pub const RECORDS: bool = cfg!(feature = "rerun");

/// The version of the viewer that fits.
pub const VIEWER_VERSION: &str = "0.36.3";

/// Which layout is on top when a recording is opened; the others are tabs beside it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Layout {
    /// World, camera's view, curves and the summary.
    #[default]
    Overview,
    /// The shape of a body, and its scan.
    Shape,
    /// Tracks on a map, where the world has a place on the Earth.
    Map,
}

/// Where a session is seen.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Viewer {
    /// In a viewer that is started on this machine, unless one runs.
    Spawned,
    /// In a viewer that runs at this URL.
    At(String),
}

/// Where a viewer listens if nothing else is said.
pub const DEFAULT_URL: &str = "rerun+http://127.0.0.1:9876/proxy";
