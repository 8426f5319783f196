//! What open directions are called.

use crate::diagnose::observability::{DatumFreedom, Kind};

/// The code of a direction.
pub fn direction_code(kind: &Kind) -> &'static str {
    match kind {
        Kind::WorldScale => "world_scale",
        Kind::World { freedom: DatumFreedom::Shift, .. } => "world_shift",
        Kind::World { freedom: DatumFreedom::Rotation, .. } => "world_rotation",
        Kind::Scale { .. } => "vehicle_scale",
        Kind::BodyFrame { freedom: DatumFreedom::Shift, .. } => "body_frame_shift",
        Kind::BodyFrame { freedom: DatumFreedom::Rotation, .. } => "body_frame_rotation",
        Kind::PointDepth { vehicle: None, .. } => "target_depth",
        Kind::PointDepth { vehicle: Some(_), .. } => "point_depth",
        Kind::CameraPose { .. } => "camera_pose",
        Kind::VehiclePose { .. } => "vehicle_pose",
        Kind::Interior { .. } => "interior_orientation",
        Kind::Readout => "readout_time",
        Kind::Axle { .. } => "rear_axle",
        Kind::Antenna { .. } => "antenna",
        Kind::Receiver { .. } => "receiver",
        Kind::Other => "other",
    }
}
