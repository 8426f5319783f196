//! What is odd about a first estimate, as data.

use super::resection::BridgeReason;
use super::vehicle_poses::motion_program::Bound;
use crate::estimate::LeftOut;

/// What is odd about a first estimate. Vehicles and targets are told by their ids, frames by their numbers.
#[derive(Clone, Debug, PartialEq)]
pub enum InitialWarning {
    /// Camera poses of neighbouring frames were bridged.
    Bridged {
        /// Why.
        reason: BridgeReason,
        /// The first frame and the last.
        frames: [i64; 2],
        /// The fewest and the most control targets that one of them sees.
        targets: [usize; 2],
        /// Largest standard deviation of a position along its worst axis \[m\].
        sigma_m: f64,
    },
    /// So were more frames, in shorter gaps.
    MoreBridged {
        /// How many frames.
        frames: usize,
        /// How many gaps.
        gaps: usize,
    },
    /// Image points of targets scatter more than stated.
    TargetsScatter {
        /// By what factor.
        factor: f64,
    },
    /// The heading of a vehicle that hardly moves may be half a turn wrong.
    HeadingGuessed {
        /// The vehicle.
        vehicle: String,
    },
    /// Image points demand a motion beyond the bounds.
    BeyondBounds {
        /// The vehicle.
        vehicle: String,
        /// From when to when \[s\].
        time_s: [f64; 2],
        /// Of what.
        bound: Bound,
        /// Whether it is the rotation that does.
        turns: bool,
        /// What they demand \[m/s, m/s^2, rad/s\].
        reached: f64,
        /// The bound, likewise.
        limit: f64,
    },
    /// A vehicle takes no part.
    VehicleLeftOut {
        /// The vehicle.
        vehicle: String,
        /// Why.
        reason: LeftOut,
    },
    /// Points are seen in one frame only.
    SeenOnce {
        /// The vehicle.
        vehicle: String,
        /// How many.
        points: usize,
    },
    /// Rays to points do not meet.
    RaysDoNotMeet {
        /// The vehicle.
        vehicle: String,
        /// How many.
        points: usize,
    },
    /// Rays to most points leave their depth open.
    DepthOpen {
        /// The vehicle.
        vehicle: String,
        /// How many.
        points: usize,
        /// Of how many that have coordinates.
        of: usize,
    },
    /// The marker has no coordinates.
    MarkerMissing {
        /// The vehicle.
        vehicle: String,
    },
    /// Rays to targets are nearly parallel.
    TargetsLeftOut {
        /// Which.
        targets: Vec<String>,
    },
}
