//! What is odd about a network, as data: what is missing that would hold it, and what is not used.

use crate::terrain::NoGround;

/// What nothing knows of the cameras.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CameraGap {
    /// Neither sigmas nor targets say how good camera poses are, which are held as given.
    Held {
        /// Whether nothing is known of positions ...
        positions: bool,
        /// ... and of attitudes.
        attitudes: bool,
        /// Control targets that a frame needs to be held by them.
        targets_needed: usize,
    },
    /// Most frames see too few control targets.
    Adrift,
}

/// What is missing that would fix the scale of a vehicle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ScaleGap {
    /// A height is known, and no terrain.
    NoTerrain,
    /// The terrain is known, and no height.
    NoHeight,
    /// Neither, nor a size.
    Nothing,
}

/// What is odd about a network.
#[derive(Clone, Debug, PartialEq)]
pub enum NetworkWarning {
    /// Something is missing that would hold the cameras.
    Cameras(CameraGap),
    /// Only the starting poses hold the scale of a vehicle.
    Scale {
        /// The vehicle.
        vehicle: String,
        /// What is missing.
        gap: ScaleGap,
    },
    /// Poses have no ground below them.
    WithoutGround {
        /// The vehicle.
        vehicle: String,
        /// How many.
        poses: usize,
        /// Number of the first frame.
        frame: i64,
        /// Why.
        reason: NoGround,
    },
    /// The point of a receiver has no place.
    ReceiverWithoutPlace {
        /// The receiver: vehicle and point.
        receiver: String,
    },
    /// GNSS positions are gross errors.
    PositionsRejected {
        /// The receiver: vehicle and point.
        receiver: String,
        /// How many.
        rejected: usize,
        /// How many took part.
        used: usize,
    },
    /// No GNSS position falls into the time in which the vehicle is seen.
    NoPositionInTime {
        /// The receiver: vehicle and point.
        receiver: String,
    },
}

impl NetworkWarning {
    /// Whether another says the same, though perhaps of poses that have moved a little since.
    pub fn is_of_the_same(&self, other: &NetworkWarning) -> bool {
        use NetworkWarning::WithoutGround;
        match (self, other) {
            (
                WithoutGround { vehicle, poses, frame, .. },
                WithoutGround { vehicle: other, poses: other_poses, frame: other_frame, .. },
            ) => (vehicle, poses, frame) == (other, other_poses, other_frame),
            _ => self == other,
        }
    }
}
