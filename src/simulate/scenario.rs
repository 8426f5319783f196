//! What a scenario says: a flight, vehicles, targets, what is known of them, and every error.
//!
//! Numbers are in the units of their names; defaults are those of a small drone above a crossing.

use super::knowledge::KnowledgeSettings;
use crate::camera::Camera;
use crate::problem::Calibration;
use std::path::PathBuf;

/// A scenario.
#[derive(Clone, Debug)]
pub struct Scenario {
    /// Where it stands; what it names is beside it.
    pub folder: PathBuf,
    /// Its name; that of the problem.
    pub name: String,
    /// What the random numbers begin from.
    pub seed: u64,
    /// The camera as it is calibrated.
    pub camera: CameraSettings,
    /// The frames.
    pub video: VideoSettings,
    /// The path of the camera.
    pub flight: FlightSettings,
    /// The ground.
    pub terrain: TerrainSettings,
    /// The vehicles, one at least.
    pub vehicles: Vec<VehicleSettings>,
    /// Surveyed targets.
    pub targets: TargetSettings,
    /// What is wrong.
    pub errors: ErrorSettings,
    /// Starting poses of cameras, of vehicles.
    pub poses: [PoseSettings; 2],
    /// A receiver on each vehicle.
    pub gnss: Option<GnssSettings>,
}

impl Scenario {
    /// The names of the files that it names.
    pub fn files(&self) -> Vec<String> {
        let of_vehicle = |vehicle: &VehicleSettings| {
            let body = match &vehicle.body {
                BodySettings::Scan(file) => Some(file.clone()),
                BodySettings::Car { .. } => None,
            };
            let path = match &vehicle.path {
                PathSettings::File(file) => Some(file.clone()),
                PathSettings::Driven { .. } => None,
            };
            body.into_iter().chain(path)
        };
        self.vehicles.iter().flat_map(of_vehicle).chain(self.terrain.grid.clone()).collect()
    }
}

/// `[camera]`.
#[derive(Clone, Debug)]
pub struct CameraSettings {
    /// Interior orientation.
    pub camera: Camera,
    /// What of it is adjusted.
    pub calibration: Calibration,
    /// Time from the first to the last row \[s\].
    pub readout_s: f64,
    /// How well that is known; above zero it is adjusted.
    pub readout_sigma_s: f64,
}

/// `[film]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VideoSettings {
    /// Number of frames, two at least.
    pub frames: usize,
    /// Frames a second.
    pub rate_hz: f64,
}

/// How the drone flies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Course {
    /// It stays.
    Hover,
    /// Straight on at a speed, in a direction counter-clockwise from x.
    Straight {
        /// Over the ground.
        speed_mps: f64,
        /// Where to.
        direction_deg: f64,
    },
    /// Around the scene, which it looks at.
    Orbit {
        /// How far from the middle.
        radius_m: f64,
        /// How fast, counter-clockwise.
        turn_dps: f64,
    },
    /// As the first vehicle goes.
    Follow,
}

/// `[flight]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlightSettings {
    /// How it flies.
    pub course: Course,
    /// Above the ground in the middle of the scene.
    pub altitude_m: f64,
    /// How far it looks from straight down.
    pub tilt_deg: f64,
    /// Where the top of the image points to, counter-clockwise from x.
    pub azimuth_deg: f64,
    /// How far it drifts about its course, per axis.
    pub drift_m: f64,
    /// How long a drift lasts.
    pub drift_s: f64,
    /// How far its attitude sways, per axis.
    pub sway_deg: f64,
    /// How long that lasts.
    pub sway_s: f64,
    /// White attitude from frame to frame, per axis.
    pub vibration_deg: f64,
}

/// The surface that is really there, and what the problem knows of it.
#[derive(Clone, Debug, PartialEq)]
pub struct TerrainSettings {
    /// The grid in this file; without one a plane.
    pub grid: Option<String>,
    /// Height of the plane.
    pub plane_z_m: f64,
    /// Whether the problem has the terrain.
    pub is_known: bool,
    /// How far vehicles really ride above and below it, and how long that lasts.
    pub sigma_m: f64,
    /// See `sigma_m`.
    pub correlation_s: f64,
    /// Of an error common to the video.
    pub bias_sigma_m: f64,
    /// Roll and pitch of vehicles against the slope.
    pub tilt_sigma_deg: f64,
    /// The problem knows it as a grid that was measured, not as it is.
    pub measured: Option<MeasuredGrid>,
}

/// A grid of heights that was measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasuredGrid {
    /// From one node to the next.
    pub cell_m: f64,
    /// White noise of each height.
    pub noise_m: f64,
    /// How far it reaches from the origin along x and y.
    pub reach_m: f64,
}

/// What points are sampled on.
#[derive(Clone, Debug, PartialEq)]
pub enum BodySettings {
    /// A car of boxes: a lower one, and a cabin on it.
    Car {
        /// Length, width and height.
        size_m: [f64; 3],
    },
    /// A cloud, or a mesh, in the vehicle frame.
    Scan(String),
}

/// A stretch of a path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Segment {
    /// How long it takes.
    pub duration_s: f64,
    /// The speed at its end; it changes evenly.
    pub speed_mps: f64,
    /// Of the path, to the left above zero.
    pub curvature_per_m: f64,
}

/// How a vehicle drives.
#[derive(Clone, Debug, PartialEq)]
pub enum PathSettings {
    /// As the table in this file says.
    File(String),
    /// With a speed and a curvature, or segments from the beginning of the video on; after the last it goes on.
    Driven {
        /// At the beginning.
        speed_mps: f64,
        /// Until the first segment.
        curvature_per_m: f64,
        /// Changes.
        segments: Vec<Segment>,
    },
}

/// `[[vehicle]]`.
#[derive(Clone, Debug, PartialEq)]
pub struct VehicleSettings {
    /// Its id.
    pub id: String,
    /// Whether the problem says that it rolls on a rear axle.
    pub is_car: bool,
    /// Where it is in the middle of the video, x, y, and its heading; with a path from a file, what is added to it.
    pub x_m: f64,
    /// See `x_m`.
    pub y_m: f64,
    /// See `x_m`.
    pub heading_deg: f64,
    /// How it drives.
    pub path: PathSettings,
    /// How far it is ahead of or behind its plan.
    pub wander_m: f64,
    /// How far it is beside its plan, its heading unmoved.
    pub side_wander_m: f64,
    /// How far its heading is off its plan.
    pub yaw_wander_deg: f64,
    /// How long all of that lasts.
    pub wander_s: f64,
    /// Pitch by acceleration, nose up \[deg s^2/m\].
    pub pitch_by_acceleration: f64,
    /// Roll by lateral acceleration, outwards \[deg s^2/m\].
    pub roll_by_acceleration: f64,
    /// Which place of its x axis follows the path: 0, the middle of the body; below it, its rear axle \[m\].
    pub rear_axle_m: f64,
    /// What points are on.
    pub body: BodySettings,
    /// Points that are tracked at a time, without the marker.
    pub points: usize,
    /// How long a point is tracked in the mean before another takes its place; without, for the whole video.
    pub track_s: Option<f64>,
    /// Share of image points that are missing.
    pub dropout: f64,
    /// A surface is seen up to this angle from its normal; 180: through the body.
    pub grazing_deg: f64,
    /// What is known of it beforehand.
    pub knowledge: KnowledgeSettings,
}

/// `[targets]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TargetSettings {
    /// How many; control points.
    pub count: usize,
    /// Check points, the last of them.
    pub check: usize,
    /// Half the side of the square that they are spread over, about the middle of the scene.
    pub spread_m: f64,
    /// They are up to so high above the ground.
    pub height_m: f64,
    /// Of the survey, per axis.
    pub sigma_m: f64,
}

/// `[errors]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ErrorSettings {
    /// White noise of image points of vehicles.
    pub vehicle_px: f64,
    /// ... of targets.
    pub target_px: f64,
    /// Share of image points of vehicles that are gross by themselves.
    pub gross: f64,
    /// ... of targets.
    pub gross_targets: f64,
    /// How far they are off, from and to.
    pub gross_px: [f64; 2],
    /// Share of tracks that are of a place on the road.
    pub ground_tracks: f64,
    /// Share of tracks that change places with another in the middle of their life.
    pub swapped_tracks: f64,
    /// Share of tracks, of all, that are of the static world around a vehicle, and come beside those of its body ...
    pub static_tracks: f64,
    /// ... of highlights that slide over it ...
    pub sliding_tracks: f64,
    /// ... of another vehicle, or without one of the carrier of the camera.
    pub foreign_tracks: f64,
    /// Of the focal length as the problem has it, relative.
    pub focal: f64,
    /// Of the principal point, per axis.
    pub principal_px: f64,
    /// By what errors really scatter.
    pub really: Scatter,
}

/// `[errors.really]`: by what errors scatter, as a multiple of what the problem says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scatter {
    /// Image points of vehicles.
    pub vehicle_px: f64,
    /// Image points of targets.
    pub target_px: f64,
    /// The survey of targets.
    pub survey: f64,
    /// Contact with the ground, and its bias.
    pub terrain: f64,
    /// Known heights.
    pub height: f64,
}

impl Scatter {
    /// As the problem says.
    pub const AS_STATED: Scatter =
        Scatter { vehicle_px: 1.0, target_px: 1.0, survey: 1.0, terrain: 1.0, height: 1.0 };
}

/// What a problem says of its poses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Given {
    /// They are exact.
    Exact,
    /// They are known to their standard deviations.
    Known,
    /// They were measured, each to its standard deviations: of vehicles.
    Measured,
    /// They are where to start.
    Start,
    /// There are none.
    Nothing,
}

/// `[camera_poses]` and `[vehicle_poses]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseSettings {
    /// What is said of them.
    pub given: Given,
    /// Errors that differ from frame to frame.
    pub white_m: f64,
    /// See `white_m`.
    pub white_deg: f64,
    /// Errors that last.
    pub slow_m: f64,
    /// See `slow_m`.
    pub slow_deg: f64,
    /// How long they last.
    pub slow_s: f64,
}

/// `[gnss]`: a receiver at the marker of each vehicle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GnssSettings {
    /// Whether its positions are observations, or a reference.
    pub is_observation: bool,
    /// Positions a second.
    pub rate_hz: f64,
    /// White noise, per axis.
    pub sigma_m: f64,
    /// Its time minus video time.
    pub clock_offset_s: f64,
    /// How well that is known; `None`: not at all.
    pub clock_sigma_s: Option<f64>,
    /// Of an error of all its positions, per axis.
    pub shift_sigma_m: f64,
}
