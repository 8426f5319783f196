//! What was observed: cameras, frames, targets, vehicles, image points and prior knowledge.
//!
//! A [`Problem`] is a plain value. It is valid where every index is in range, every number is finite, no
//! standard deviation is negative, keys are unique, times increase: the room `files` makes it from a folder
//! and refuses anything else, and [`Problem::check`] says it of one that is built in memory.

mod check;
mod knowledge;
mod video;

use crate::camera::Camera;
use crate::geometry::Pose;
use crate::rules::rules;
use crate::terrain::Terrain;
pub use check::{Fault, Faults, Part, Wrong};
pub use knowledge::{
    Calibration, Freedom, KnownTime, ReceivedPosition, Receiver, ReceiverKnowledge, Shutter,
};
use nalgebra::{Point3, Vector2};
pub use video::Video;

/// One film with everything that is known of it.
#[derive(Clone, Debug)]
pub struct Problem {
    /// Its name.
    pub name: String,
    /// The camera.
    pub camera: Camera,
    /// Which numbers of its interior orientation are adjusted.
    pub calibration: Calibration,
    /// How its rows are read out.
    pub shutter: Shutter,
    /// The frames, in time order.
    pub frames: Vec<Frame>,
    /// `world_from_camera` of each frame, as far as it is known beforehand; there is one for every frame,
    /// or there are targets to resect the others from.
    pub camera_poses: Vec<Option<Pose>>,
    /// How well those that are given are known.
    pub camera_pose_sigma: PoseSigma,
    /// Surveyed points and tie points, sorted by id.
    pub targets: Vec<Target>,
    /// Image points of targets, sorted by frame and target.
    pub target_observations: Vec<TargetObservation>,
    /// The vehicles, in the order of declaration.
    pub vehicles: Vec<Vehicle>,
    /// How well the poses of vehicles are known beforehand.
    pub vehicle_pose_sigma: PoseSigma,
    /// The ground, where it is known.
    pub ground: Option<GroundKnowledge>,
    /// Receivers whose positions are adjusted to, in the order of vehicles and points.
    pub receivers: Vec<Receiver>,
    /// The film itself, where it is there.
    pub video: Option<Video>,
}

/// A frame of the film.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// The number it has in the tables.
    pub number: i64,
    /// Video time of its middle row \[s\].
    pub time_s: f64,
}

/// How well poses are known beforehand, per axis; `None`: they are starting values only; zero: they
/// are exact and held.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseSigma {
    /// Position, along the axes of the world \[m\].
    pub position_m: Option<f64>,
    /// Attitude, about the axes of the body \[rad\].
    pub rotation_rad: [Option<f64>; 3],
}

/// A coordinate that is known beforehand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Known {
    /// The coordinate \[m\].
    pub value_m: f64,
    /// Its standard deviation \[m\]; zero: exact and held.
    pub sigma_m: f64,
}

/// What a target is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// It holds the datum.
    Control,
    /// It is compared with, never adjusted to.
    Check,
}

/// A point of the static world.
#[derive(Clone, Debug, PartialEq)]
pub struct Target {
    /// Its id.
    pub id: String,
    /// Its coordinates in the world, as far as they are known.
    pub known: [Option<Known>; 3],
    /// What it is for.
    pub role: Role,
}

/// An image point of a target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TargetObservation {
    /// Index of the frame.
    pub frame: usize,
    /// Index of the target.
    pub target: usize,
    /// Where it was seen \[px\].
    pub image_px: Vector2<f64>,
    /// Standard deviation per coordinate \[px\], above zero.
    pub sigma_px: f64,
}

/// A vehicle and all that was seen of it.
#[derive(Clone, Debug, Default)]
pub struct Vehicle {
    /// Its id.
    pub id: String,
    /// Index of the point whose track is reported; without one it is the origin of the body.
    pub marker: Option<usize>,
    /// Height above the ground of the highest observed point.
    pub height: Option<Known>,
    /// Distances between its points that are known.
    pub scale_bars: Vec<ScaleBar>,
    /// Whether it has a rear axle that rolls without slip.
    pub is_car: bool,
    /// Its points, sorted by id.
    pub points: Vec<ShapePoint>,
    /// Its image points, sorted by frame and point.
    pub observations: Vec<VehicleObservation>,
    /// `world_from_vehicle` of each frame, as far as it is known beforehand. Where there is none for a
    /// frame in which the vehicle is seen, it is to be found.
    pub poses: Vec<Option<Pose>>,
    /// Whether these poses were measured, each with errors of its own of the standard deviations of the problem: they
    /// are observations then. Otherwise they say where to start, and where in the body its frame is.
    pub poses_are_measured: bool,
}

/// A distance between two points of a vehicle that is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScaleBar {
    /// Indices of the points.
    pub points: [usize; 2],
    /// Their distance \[m\], above zero.
    pub length_m: f64,
    /// Its standard deviation \[m\], above zero.
    pub sigma_m: f64,
}

/// A point of a vehicle.
#[derive(Clone, Debug, PartialEq)]
pub struct ShapePoint {
    /// Its id.
    pub id: String,
    /// Its coordinates in the vehicle frame, as far as they are known beforehand.
    pub known: [Option<Known>; 3],
}

/// An image point of a vehicle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VehicleObservation {
    /// Index of the frame.
    pub frame: usize,
    /// Index of the point.
    pub point: usize,
    /// Where it was seen \[px\].
    pub image_px: Vector2<f64>,
    /// Standard deviation per coordinate \[px\], above zero.
    pub sigma_px: f64,
}

/// How the ground ties the vehicles.
#[derive(Clone, Debug, PartialEq)]
pub struct GroundKnowledge {
    /// The terrain model.
    pub terrain: Terrain,
    /// How far the origin of a vehicle lies above or below it \[m\].
    pub sigma_m: f64,
    /// How long such an error lasts \[s\]; `None`: as long as ground stays alike along the way of a vehicle
    /// ([`GroundKnowledge::lasts_s`]).
    pub correlation_s: Option<f64>,
    /// An error of the terrain that is common to the whole film \[m\].
    pub bias_sigma_m: f64,
    /// Roll and pitch of a vehicle against the slope \[rad\].
    pub tilt_sigma_rad: f64,
}

rules! {
    /// How a vehicle rides over its terrain, where nobody says it.
    pub struct ContactRules {
        /// Errors of a terrain belong to its places: they last as long as a vehicle needs for this way ...
        alike_m: f64 = 10.0, "m";
        /// ... but so long at the least, as springs and tyres take, ...
        least_s: f64 = 1.0, "s";
        /// ... and so long at the most, where it hardly moves.
        most_s: f64 = 10.0, "s";
        /// A vehicle touches the ground so far from its middle: what is uneven within that is no knowledge of its height
        /// and its lean ...
        reach_m: f64 = 1.4, "m";
        /// ... and one place so far from another is as uneven as that by `exp(-1)`.
        uneven_m: f64 = 2.8, "m";
        /// More than this of the lean against the ground is no motion, but a slope that is not known.
        most_lean_rad: f64 = 0.0175, "rad";
    }
}

impl GroundKnowledge {
    /// How long an error of its contact lasts under a vehicle of this mean speed \[s\].
    pub fn lasts_s(&self, speed_m_s: f64) -> f64 {
        let ContactRules { alike_m, least_s, most_s, .. } = ContactRules::DEFAULT;
        self.correlation_s.unwrap_or_else(|| (alike_m / speed_m_s.max(alike_m / most_s)).max(least_s))
    }
}

impl Vehicle {
    /// The frames from the first to the last in which the vehicle is seen.
    pub fn span(&self) -> std::ops::Range<usize> {
        match (self.observations.first(), self.observations.last()) {
            (Some(first), Some(last)) => first.frame..last.frame + 1,
            _ => 0..0,
        }
    }

    /// Whether there are poses that were measured.
    pub fn has_measured_poses(&self) -> bool {
        self.poses_are_measured && !self.has_no_poses()
    }

    /// Whether a frame in which the vehicle is seen has no pose.
    pub fn misses_poses(&self) -> bool {
        self.observations.iter().any(|o| self.poses[o.frame].is_none())
    }

    /// For each frame whether the vehicle is seen in it and has no pose.
    pub fn frames_without_pose(&self) -> Vec<bool> {
        let mut without = vec![false; self.poses.len()];
        self.observations.iter().for_each(|o| without[o.frame] = self.poses[o.frame].is_none());
        without
    }

    /// Whether no frame has a pose.
    pub fn has_no_poses(&self) -> bool {
        self.poses.iter().all(Option::is_none)
    }

    /// In how many frames each point is seen.
    pub fn sightings(&self) -> Vec<usize> {
        let mut count = vec![0; self.points.len()];
        self.observations.iter().for_each(|o| count[o.point] += 1);
        count
    }

    /// Whether a point can have coordinates: one frame alone gives two equations for three unknowns.
    pub fn determinable(&self) -> Vec<bool> {
        self.sightings().into_iter().map(|count| count >= 2).collect()
    }

    /// Whether something is known between its points that holds its size, wherever it is.
    pub fn knows_size(&self) -> bool {
        let knows = |axis: usize| self.points.iter().filter(|p| p.known[axis].is_some()).count();
        let has_places = |bar: &ScaleBar, places: &[bool]| {
            bar.points.iter().all(|point| places.get(*point) == Some(&true))
        };
        (0..3).any(|axis| knows(axis) >= 2)
            || !self.scale_bars.is_empty() && {
                let places = self.determinable();
                self.scale_bars.iter().any(|bar| has_places(bar, &places))
            }
    }

    /// What is wrong with what is known between its points: the field, and what is wrong with it.
    fn faults_between_points(&self) -> Vec<(&'static str, Wrong)> {
        let mut faults = Vec::new();
        for bar in &self.scale_bars {
            let count = self.points.len();
            let beyond = bar.points.into_iter().filter(|point| *point >= count);
            faults.extend(beyond.map(|found| ("scale_bars", Wrong::Index { found, count })));
            if bar.points[0] == bar.points[1] {
                faults.push(("scale_bars", Wrong::Repeated));
            }
            for number in [bar.length_m, bar.sigma_m] {
                if !number.is_finite() {
                    faults.push(("scale_bars", Wrong::NotFinite));
                } else if number <= 0.0 {
                    faults.push(("scale_bars", Wrong::NotAboveZero(number)));
                }
            }
        }
        faults
    }
}

impl Problem {
    /// Whether the ground may rise and fall: it then knows where a vehicle is that drives over it, and so its scale.
    pub fn may_have_relief(&self) -> bool {
        self.ground.as_ref().is_some_and(|ground| matches!(ground.terrain, Terrain::Grid(_)))
    }

    /// Whether an image point depends on more than poses and points: rows that are exposed one after
    /// another, or an interior orientation that is adjusted.
    pub fn has_open_camera(&self) -> bool {
        self.shutter.is_rolling() || self.calibration.iter().any(|freedom| freedom.is_adjusted())
    }
}

impl PoseSigma {
    /// Whether every component is exact.
    pub fn is_exact(&self) -> bool {
        self.components().iter().all(|sigma| *sigma == Some(0.0))
    }

    /// Whether no component is known.
    pub fn is_unknown(&self) -> bool {
        self.components().iter().all(Option::is_none)
    }

    /// Position three times, then attitude, in the order of the perturbation of a pose.
    pub fn components(&self) -> [Option<f64>; 6] {
        let [roll, pitch, yaw] = self.rotation_rad;
        [self.position_m, self.position_m, self.position_m, roll, pitch, yaw]
    }
}

impl Target {
    /// Its coordinates, where all of them are known.
    pub fn surveyed(&self) -> Option<Point3<f64>> {
        let [x, y, z] = self.known;
        Some(Point3::new(x?.value_m, y?.value_m, z?.value_m))
    }

    /// Whether all of its coordinates are known.
    pub fn is_surveyed(&self) -> bool {
        self.surveyed().is_some()
    }
}
