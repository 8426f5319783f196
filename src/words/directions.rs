//! What open directions are called.

use crate::diagnose::observability::{Freedom, Kind};

/// The code of a direction.
pub fn direction_code(kind: &Kind) -> &'static str {
    match kind {
        Kind::WorldScale => "world_scale",
        Kind::World { freedom: Freedom::Shift, .. } => "world_shift",
        Kind::World { freedom: Freedom::Rotation, .. } => "world_rotation",
        Kind::Scale { .. } => "vehicle_scale",
        Kind::BodyFrame { freedom: Freedom::Shift, .. } => "body_frame_shift",
        Kind::BodyFrame { freedom: Freedom::Rotation, .. } => "body_frame_rotation",
        Kind::PointDepth { vehicle: None, .. } => "target_depth",
        Kind::PointDepth { vehicle: Some(_), .. } => "point_depth",
        Kind::CameraPose { .. } => "camera_pose",
        Kind::VehiclePose { .. } => "vehicle_pose",
        Kind::Interior { .. } => "interior_orientation",
        Kind::Readout => "readout_time",
        Kind::Receiver { .. } => "receiver",
        Kind::Other => "other",
    }
}
