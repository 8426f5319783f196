//! The tables of a problem folder, a file each: its rows, how they are checked, counted and written.
//!
//! A new table is a file here and a line in each list of this one.

pub mod cameras;
pub mod frames;
pub mod gnss;
pub mod points;
pub mod reading;
pub mod targets;
pub mod vehicles;

use super::problem_toml::Settings;
use crate::problem::{GroundKnowledge, Problem};
use reading::{Reader, Rows};

/// The names of all tables.
pub const NAMES: [&str; 8] = [
    frames::FILE,
    cameras::FILE,
    targets::FILE,
    targets::OBSERVATIONS,
    vehicles::OBSERVATIONS,
    vehicles::POSES,
    points::FILE,
    gnss::FILE,
];

/// Ground is needed no farther from cameras, targets and vehicles \[m\].
const SEEN_M: f64 = 1000.0;

/// The tables as they stand.
pub struct Tables {
    pub settings: Option<Settings>,
    pub ground: Option<GroundKnowledge>,
    pub frames: Rows<frames::FrameRow>,
    pub camera_poses: Rows<cameras::CameraPoseRow>,
    pub targets: Rows<targets::TargetRow>,
    pub target_observations: Rows<targets::TargetObservationRow>,
    pub vehicle_observations: Rows<vehicles::VehicleObservationRow>,
    pub vehicle_poses: Rows<vehicles::VehiclePoseRow>,
    pub known_points: Rows<points::KnownPointRow>,
    pub gnss: Rows<gnss::GnssObservationRow>,
}

impl Tables {
    /// Reads them, beside what `problem.toml` says; the ground that it names is not among them.
    pub fn read(reader: &mut Reader, settings: Option<Settings>) -> Tables {
        Tables {
            settings,
            ground: None,
            frames: reader.read(frames::FILE),
            camera_poses: reader.read_if_there(cameras::FILE),
            targets: reader.read_if_there(targets::FILE),
            target_observations: reader.read_if_there(targets::OBSERVATIONS),
            vehicle_observations: reader.read(vehicles::OBSERVATIONS),
            vehicle_poses: reader.read_if_there(vehicles::POSES),
            known_points: reader.read_if_there(points::FILE),
            gnss: reader.read_if_there(gnss::FILE),
        }
    }

    /// Where ground may be needed: the least and the largest x and y of all places that are told, and what can be seen
    /// from there \[m\]; `None` where there is no such place.
    pub fn area(&self) -> Option<[[f64; 2]; 2]> {
        let cameras = self.camera_poses.iter().flatten().map(|line| [line.row.x, line.row.y]);
        let targets = self.targets.iter().flatten().filter_map(|line| Some([line.row.x?, line.row.y?]));
        let vehicles = self.vehicle_poses.iter().flatten().map(|line| [line.row.x, line.row.y]);
        let receivers = self.gnss.iter().flatten().map(|line| [line.row.x, line.row.y]);
        let mut places = cameras.chain(targets).chain(vehicles).chain(receivers);
        let first = places.next()?;
        let wider = |area: [[f64; 2]; 2], place: [f64; 2]| {
            [0, 1].map(|axis| [area[axis][0].min(place[axis]), area[axis][1].max(place[axis])])
        };
        let area = places.fold(first.map(|value| [value, value]), wider);
        Some(area.map(|[least, most]| [least - SEEN_M, most + SEEN_M]))
    }
}

/// The tables of a problem: names and bytes.
pub fn written(problem: &Problem) -> Vec<(&'static str, Vec<u8>)> {
    let mut files = vec![
        (frames::FILE, frames::table(problem)),
        (vehicles::OBSERVATIONS, vehicles::observations_table(problem)),
    ];
    if problem.camera_poses.iter().any(Option::is_some) {
        files.push((cameras::FILE, cameras::camera_pose_table(problem, &problem.camera_poses)));
    }
    if problem.vehicles.iter().any(|vehicle| !vehicle.has_no_poses()) {
        let poses = problem.vehicles.iter().map(|vehicle| vehicle.poses.as_slice());
        files.push((vehicles::POSES, vehicles::vehicle_pose_table(problem, poses)));
    }
    if !problem.targets.is_empty() {
        files.push((targets::FILE, targets::table(problem)));
        files.push((targets::OBSERVATIONS, targets::observations_table(problem)));
    }
    files.extend(points::table(problem).map(|table| (points::FILE, table)));
    if !problem.receivers.is_empty() {
        files.push((gnss::FILE, gnss::table(problem)));
    }
    files
}
