//! The network: what is unknown, what was measured and what is known, as least squares.
//!
//! ```text
//! Problem + Estimate -> declare -> Sink: a least-squares system (Model), or the examination of what is open
//! ```
//!
//! [`declare()`] names every unknown and every measurement once, with its [`Source`]; what follows from a source is in
//! [`Source::traits`]. [`Selection`] says which image points take part, [`Purpose`] what the network is for.

mod blocks;
mod body_frame;
mod contact;
mod conventions;
mod datum;
mod declare;
mod driving;
mod highest;
mod images;
mod knowledge;
mod model;
mod motion;
mod receivers;
mod selection;
mod sink;
mod source;
mod starts;
mod unknowns;
mod warnings;

pub use blocks::{Blocks, ReceiverBlocks, VehicleBlocks};
pub use body_frame::{BodyFrame, anchored, body_frames, frame_step, point_motion, pose_motion};
pub use conventions::{STARTING_SHAPE_SIGMA_M, half_sizes};
pub use datum::{Treatment, camera_gap, of_cameras, of_vehicle, scale_gap};
pub use declare::{Declaration, Declared, declare};
pub use highest::{Highest, HighestRules};
pub use images::Images;
pub use model::{LOOSENED_SHAPES, Model, NetworkOptions};
pub use motion::{Body, BodyStrength, Motion, MotionPrior, MotionPriors, Order, Strengths, TimedPose};
pub use receivers::start_clocks;
pub use selection::{Anchors, OUTLIER_SIGMAS, Purpose, Selection};
pub use sink::{Owner, Sink, SystemSink};
pub use source::{CommonCause, Nature, Source, Traits};
pub use warnings::{CameraGap, NetworkWarning, ScaleGap};
