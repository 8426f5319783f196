//! `vehicle_observations.csv` and `vehicle_poses.csv`: what was seen of vehicles, and their starting poses.

use super::super::cells::{self, POSE_COLUMNS};
use super::Tables;
use super::reading::{Index, Pixels, Reader, spread};
use crate::geometry::Pose;
use crate::problem::{Frame, Problem, ShapePoint, Vehicle, VehicleObservation};
use crate::tables::{Finding, Line, Sigma, input_row, written};
use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};

/// Name of the file of image points.
pub const OBSERVATIONS: &str = "vehicle_observations.csv";
/// Name of that of starting poses.
pub const POSES: &str = "vehicle_poses.csv";

input_row!(
    /// `vehicle_observations.csv`.
    VehicleObservationRow {
        required frame: i64, required vehicle: String, required point: String,
        required u: f64, required v: f64,
        optional sigma_px: Sigma,
    }
);

input_row!(
    /// `vehicle_poses.csv`.
    VehiclePoseRow {
        required frame: i64, required vehicle: String,
        required x: f64, required y: f64, required z: f64,
        required qw: f64, required qx: f64, required qy: f64, required qz: f64,
    }
);

/// What was seen of the vehicles.
#[derive(Default)]
pub struct Observed<'t> {
    /// Vehicle and point of every row, whatever else is wrong with it.
    pub points: HashSet<(&'t str, &'t str)>,
    /// For each vehicle the ids of its points and its image points, both sorted.
    pub vehicles: Vec<(Vec<&'t str>, Vec<VehicleObservation>)>,
}

/// The image points of vehicles.
pub fn check_observations<'t>(reader: &mut Reader, tables: &'t Tables, index: &Index) -> Observed<'t> {
    let mut pixels = Pixels::new(OBSERVATIONS, tables.settings.as_ref(), |s| s.vehicle_px);
    let mut observed = Observed::default();
    let mut seen = HashSet::new();
    let count = tables.settings.as_ref().map_or(0, |settings| settings.vehicles.len());
    // Points are numbered as they come at first.
    let mut numbers: Vec<BTreeMap<&str, usize>> = vec![BTreeMap::new(); count];
    let mut observations: Vec<Vec<VehicleObservation>> = vec![Vec::new(); count];
    for Line { line, row } in tables.vehicle_observations.iter().flatten() {
        observed.points.insert((&row.vehicle, &row.point));
        let frame = reader.frame(OBSERVATIONS, *line, row.frame, index);
        let vehicle = reader.vehicle(OBSERVATIONS, *line, &row.vehicle, index);
        let (Some(frame), Some(vehicle)) = (frame, vehicle) else { continue };
        if !seen.insert((frame, vehicle, row.point.as_str())) {
            let found = format!("{} twice in frame {}", row.point, row.frame);
            reader.cell(OBSERVATIONS, *line, "point", "a point once in a frame", found);
        }
        let Some((image_px, sigma_px)) = pixels.check(*line, row.u, row.v, row.sigma_px.0) else {
            continue;
        };
        let next = numbers[vehicle].len();
        let point = *numbers[vehicle].entry(&row.point).or_insert(next);
        observations[vehicle].push(VehicleObservation { frame, point, image_px, sigma_px });
    }
    pixels.warn(&mut reader.findings);
    let sorted = |(numbers, mut observations): (BTreeMap<&'t str, usize>, Vec<VehicleObservation>)| {
        let mut places = vec![0; numbers.len()];
        numbers.values().enumerate().for_each(|(place, number)| places[*number] = place);
        observations.iter_mut().for_each(|o| o.point = places[o.point]);
        observations.sort_by_key(|o| (o.frame, o.point));
        (numbers.into_keys().collect(), observations)
    };
    observed.vehicles = numbers.into_iter().zip(observations).map(sorted).collect();
    observed
}

/// The poses by vehicle and frame.
pub fn check_poses(reader: &mut Reader, tables: &Tables, index: &Index) -> HashMap<(usize, usize), Pose> {
    let mut poses = HashMap::new();
    let Some(rows) = &tables.vehicle_poses else { return poses };
    for Line { line, row } in rows {
        let pose = reader.pose(POSES, *line, [row.x, row.y, row.z], [row.qw, row.qx, row.qy, row.qz]);
        let frame = reader.frame(POSES, *line, row.frame, index);
        let vehicle = reader.vehicle(POSES, *line, &row.vehicle, index);
        let (Some(frame), Some(vehicle)) = (frame, vehicle) else { continue };
        if poses.insert((vehicle, frame), pose).is_some() {
            let found = format!("{} twice in frame {}", row.vehicle, row.frame);
            reader.cell(POSES, *line, "vehicle", "a vehicle once in a frame", found);
        }
    }
    let mut missing = BTreeSet::new();
    for Line { row, .. } in tables.vehicle_observations.iter().flatten() {
        let frame = index.frames.get(&row.frame);
        let vehicle = index.vehicles.as_ref().and_then(|v| v.get(row.vehicle.as_str()));
        if let (Some(frame), Some(vehicle)) = (frame, vehicle)
            && !poses.contains_key(&(*vehicle, *frame))
        {
            missing.insert((row.vehicle.as_str(), row.frame));
        }
    }
    let has_ground = tables.settings.as_ref().is_none_or(|settings| settings.ground.is_some());
    if has_ground && !missing.is_empty() {
        reader.findings.warn(format!(
            "{POSES}: poses that are missing where a vehicle is seen, and are found on the terrain: {}",
            missing.len()
        ));
        return poses;
    }
    for (vehicle, frame) in missing {
        let wanted = format!("a pose of {vehicle} in frame {frame}, where it is seen (or a terrain)");
        reader.findings.error(Finding::of_file(POSES, &wanted, "none"));
    }
    poses
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

impl VehicleInventory {
    /// Counts it.
    pub fn new(vehicle: &Vehicle, frames: &[Frame]) -> VehicleInventory {
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

/// The table of the image points of a problem's vehicles.
pub fn observations_table(problem: &Problem) -> Vec<u8> {
    let seen = problem.vehicles.iter().flat_map(|vehicle| {
        vehicle.observations.iter().map(move |o| (o, &vehicle.id, &vehicle.points[o.point].id))
    });
    let seen = seen.map(|(o, vehicle, point)| {
        let [u, v, sigma_px] = cells::pixels(&o.image_px, o.sigma_px);
        let number = problem.frames[o.frame].number.to_string();
        [number, vehicle.clone(), point.clone(), u, v, sigma_px]
    });
    written(&["frame", "vehicle", "point", "u", "v", "sigma_px"], seen)
}

/// The table of these poses of the vehicles of a problem, one for each frame.
pub fn vehicle_pose_table<'p>(problem: &Problem, poses: impl Iterator<Item = &'p [Option<Pose>]>) -> Vec<u8> {
    let rows = problem.vehicles.iter().zip(poses).flat_map(|(vehicle, poses)| {
        let rows = problem.frames.iter().zip(poses);
        rows.filter_map(|(frame, pose)| {
            Some((frame.number.to_string(), &vehicle.id, cells::pose(pose.as_ref()?)))
        })
    });
    let rows = rows.map(|(frame, id, cells)| [frame, id.clone()].into_iter().chain(cells));
    written(&[&["frame", "vehicle"], &POSE_COLUMNS[..]].concat(), rows)
}
