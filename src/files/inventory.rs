//! What is in a problem folder, counted.

use crate::problem::{Frame, Role, ShapePoint, Target, TargetObservation, Vehicle};
use std::collections::BTreeSet;

/// What is in a problem folder.
#[derive(Clone, Debug)]
pub struct Inventory {
    /// Name of the problem.
    pub name: String,
    /// How many frames.
    pub frames: usize,
    /// First and last video time \[s\].
    pub time_s: [f64; 2],
    /// Width and height of the image \[px\].
    pub size_px: [u32; 2],
    /// How many frames have a camera pose.
    pub camera_poses: usize,
    /// The vehicles.
    pub vehicles: Vec<VehicleInventory>,
    /// The targets.
    pub targets: TargetInventory,
}

/// What there is of a vehicle.
#[derive(Clone, Debug)]
pub struct VehicleInventory {
    /// Its id.
    pub id: String,
    /// Its marker.
    pub marker: Option<String>,
    /// How many points.
    pub points: usize,
    /// How many of them in one frame only.
    pub single_frame_points: usize,
    /// How many image points.
    pub observations: usize,
    /// Numbers of the first and last frame in which it is seen.
    pub span: Option<[i64; 2]>,
    /// In how many frames it is seen.
    pub frames: usize,
    /// Shortest, median and longest number of frames of a point.
    pub track_lengths: [usize; 3],
    /// How many frames have a starting pose.
    pub poses: usize,
    /// How many coordinates of its points are known beforehand.
    pub known_coordinates: usize,
    /// Whether its height is known.
    pub has_height: bool,
}

/// What there is of the static world.
#[derive(Clone, Debug, Default)]
pub struct TargetInventory {
    /// Surveyed targets that are adjusted to.
    pub control: usize,
    /// Targets that are compared with.
    pub check: usize,
    /// Points without known coordinates.
    pub tie: usize,
    /// How many image points.
    pub observations: usize,
    /// Fewest, median and most control targets in a frame.
    pub control_per_frame: [usize; 3],
}

impl Inventory {
    /// Counts what is there.
    pub(super) fn new(
        name: &str,
        size_px: [u32; 2],
        frames: &[Frame],
        camera_poses: usize,
        vehicles: &[Vehicle],
        targets: TargetInventory,
    ) -> Inventory {
        Inventory {
            name: name.to_owned(),
            frames: frames.len(),
            time_s: [frames[0].time_s, frames[frames.len() - 1].time_s],
            size_px,
            camera_poses,
            vehicles: vehicles.iter().map(|vehicle| VehicleInventory::new(vehicle, frames)).collect(),
            targets,
        }
    }
}

impl VehicleInventory {
    fn new(vehicle: &Vehicle, frames: &[Frame]) -> VehicleInventory {
        let number = |frame: usize| frames[frame].number;
        let sightings = vehicle.sightings();
        let seen: BTreeSet<usize> = vehicle.observations.iter().map(|o| o.frame).collect();
        let known = |point: &ShapePoint| point.known.iter().flatten().count();
        VehicleInventory {
            id: vehicle.id.clone(),
            marker: vehicle.marker.map(|point| vehicle.points[point].id.clone()),
            points: vehicle.points.len(),
            single_frame_points: sightings.iter().filter(|count| **count < 2).count(),
            observations: vehicle.observations.len(),
            span: seen.first().zip(seen.last()).map(|(a, b)| [number(*a), number(*b)]),
            frames: seen.len(),
            track_lengths: spread(sightings),
            poses: vehicle.poses.iter().flatten().count(),
            known_coordinates: vehicle.points.iter().map(known).sum(),
            has_height: vehicle.height.is_some(),
        }
    }
}

impl TargetInventory {
    pub(super) fn new(targets: &[Target], observations: &[TargetObservation], frames: usize) -> Self {
        let is_control = |t: &Target| t.role == Role::Control && t.known.iter().any(Option::is_some);
        let mut control_per_frame = vec![0; frames];
        for observation in observations {
            control_per_frame[observation.frame] += usize::from(is_control(&targets[observation.target]));
        }
        let check = targets.iter().filter(|t| t.role == Role::Check).count();
        let control = targets.iter().filter(|t| is_control(t)).count();
        TargetInventory {
            control,
            check,
            tie: targets.len() - control - check,
            observations: observations.len(),
            control_per_frame: spread(control_per_frame),
        }
    }
}

/// Smallest, median and largest; zeros where there is none.
fn spread(mut counts: Vec<usize>) -> [usize; 3] {
    counts.sort_unstable();
    match counts.as_slice() {
        [] => [0; 3],
        [first, ..] => [*first, counts[counts.len() / 2], counts[counts.len() - 1]],
    }
}
