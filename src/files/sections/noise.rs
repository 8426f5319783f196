//! `[noise]`.

use super::super::cells::decimal;
use super::super::section::Section;
use crate::problem::{PoseSigma, Problem};
use std::fmt::Write;

const VEHICLE_POSES: &str = "vehicle_poses";
const MEASURED: &str = "measured";

/// What `[noise]` says.
#[derive(Debug)]
pub struct Noise {
    pub vehicle_px: f64,
    pub target_px: f64,
    pub camera: PoseSigma,
    pub vehicle: PoseSigma,
    /// Whether vehicle poses were measured, or say where to start.
    pub vehicle_poses_are_measured: bool,
}

impl Default for Noise {
    fn default() -> Self {
        Noise {
            vehicle_px: 1.0,
            target_px: 1.0,
            camera: pose_sigma(None, None, 1.0),
            vehicle: pose_sigma(None, None, 0.5),
            vehicle_poses_are_measured: false,
        }
    }
}

/// Reads `[noise]`.
pub fn read(noise: &Section) -> Noise {
    let pixels = |key| noise.not_negative(key).unwrap_or(1.0);
    let vehicle_poses_are_measured = match noise.text(VEHICLE_POSES).as_deref() {
        None | Some("start") => false,
        Some(MEASURED) => true,
        Some(_) => {
            noise.error(VEHICLE_POSES, "start or measured");
            false
        }
    };
    if vehicle_poses_are_measured {
        for key in ["vehicle_position_m", "vehicle_rotation_deg"] {
            if !noise.has(key) {
                noise.error(key, "a standard deviation, since vehicle poses were measured");
            }
        }
    }
    Noise {
        vehicle_px: pixels("vehicle_px"),
        target_px: pixels("target_px"),
        camera: pose_sigma(
            noise.not_negative("camera_position_m"),
            noise.not_negative("camera_rotation_deg"),
            1.0,
        ),
        vehicle: pose_sigma(
            noise.not_negative("vehicle_position_m"),
            noise.not_negative("vehicle_rotation_deg"),
            0.5,
        ),
        vehicle_poses_are_measured,
    }
}

/// `tilt_share`: what share of the standard deviation about z goes for those about x and y.
fn pose_sigma(position_m: Option<f64>, rotation_deg: Option<f64>, tilt_share: f64) -> PoseSigma {
    let about = |share: f64| rotation_deg.map(|deg| (share * deg).to_radians());
    PoseSigma { position_m, rotation_rad: [about(tilt_share), about(tilt_share), about(1.0)] }
}

/// Writes how well poses are known.
pub fn write(text: &mut String, problem: &Problem) {
    text.push_str("\n[noise]\n");
    write_sigma(text, "camera", &problem.camera_pose_sigma);
    write_sigma(text, "vehicle", &problem.vehicle_pose_sigma);
    if problem.vehicles.iter().any(|vehicle| vehicle.poses_are_measured) {
        let _ = writeln!(text, "{VEHICLE_POSES} = \"{MEASURED}\"");
    }
}

fn write_sigma(text: &mut String, of: &str, sigma: &PoseSigma) {
    if let Some(position_m) = sigma.position_m {
        let _ = writeln!(text, "{of}_position_m = {}", decimal(position_m, 9));
    }
    if let Some(yaw) = sigma.rotation_rad[2] {
        let _ = writeln!(text, "{of}_rotation_deg = {}", decimal(yaw.to_degrees(), 9));
    }
}
