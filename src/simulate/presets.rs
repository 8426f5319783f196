//! Cameras by name. Each says where its numbers come from.

use crate::camera::{Camera, Fisheye, Lens};
use nalgebra::Vector2;

/// A camera and how fast it videos.
pub struct Preset {
    /// Its name.
    pub name: &'static str,
    /// Where its numbers come from.
    pub source: &'static str,
    size_px: [u32; 2],
    focal_px: [f64; 2],
    principal_px: [f64; 2],
    fisheye: Option<[f64; 4]>,
    /// Frames a second.
    pub rate_hz: f64,
}

/// All of them. Single user calibrations of one model differ by more than a tenth in focal length: a preset is
/// for planning, never a calibration.
pub const PRESETS: [Preset; 3] = [
    Preset {
        name: "dji-mini-2",
        source: "gyroflow/lens_profiles at 886fc616, DJI_Mini2_FOV83_24mm_4k_16by9_3840x2160-29.97fps (CC0-1.0)",
        size_px: [3840, 2160],
        focal_px: [2866.5623, 2836.2941],
        principal_px: [1894.6562, 1065.3844],
        fisheye: Some([0.34628723, -0.0826789, 0.40836893, -0.04068703]),
        rate_hz: 29.97,
    },
    Preset {
        name: "dji-air-2s",
        source: "gyroflow/lens_profiles at f9e749bc, DJI_AIR 2S___4k_16by9_3840x2160-29.97fps (CC0-1.0)",
        size_px: [3840, 2160],
        focal_px: [1979.2456, 1976.4309],
        principal_px: [1971.958, 1091.8437],
        fisheye: Some([0.30204543, 0.26161968, -0.64287898, 0.77951013]),
        rate_hz: 29.97,
    },
    Preset {
        name: "pinhole-4k",
        source: "a pinhole of 71 degrees across, that of the problems that come along",
        size_px: [3840, 2160],
        focal_px: [2680.0, 2680.0],
        principal_px: [1920.0, 1080.0],
        fisheye: None,
        rate_hz: 30.0,
    },
];

impl Preset {
    /// The preset of a name.
    pub fn named(name: &str) -> Option<&'static Preset> {
        PRESETS.iter().find(|preset| preset.name == name)
    }

    /// The camera.
    pub fn camera(&self) -> Camera {
        Camera {
            size_px: self.size_px,
            focal_px: Vector2::from(self.focal_px),
            principal_px: Vector2::from(self.principal_px),
            pixel_centre_px: 0.0,
            lens: self.fisheye.map_or(Lens::Pinhole, |k| Lens::Fisheye(Fisheye::new(k))),
        }
    }
}
