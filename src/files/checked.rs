//! Tables that fit each other, made into a problem.

use super::inventory::Inventory;
use super::problem_toml::Settings;
use super::sections::vehicle::VehicleSettings;
use super::tables::gnss;
use super::tables::targets::TargetInventory;
use crate::disk::InputFile;
use crate::geometry::Pose;
use crate::problem::{
    Frame, GroundKnowledge, Known, Problem, ReceivedPosition, ShapePoint, Target, TargetObservation, Vehicle,
    VehicleObservation, Video,
};
use crate::tables::Findings;
use std::collections::HashMap;

/// A problem folder that is valid.
#[derive(Debug)]
pub struct Folder {
    /// What is there.
    pub inventory: Inventory,
    /// The problem, or what it needs that this version does not compute.
    pub problem: Result<Problem, Vec<String>>,
    /// What is odd.
    pub warnings: Vec<String>,
    /// The files that it was read from.
    pub inputs: Vec<InputFile>,
}

/// Tables that fit each other, as far as there are no findings.
pub(super) struct Checked<'t> {
    pub settings: &'t Settings,
    pub ground: Option<GroundKnowledge>,
    pub frames: Vec<Frame>,
    pub camera_poses: HashMap<usize, Pose>,
    pub targets: Vec<Target>,
    pub target_observations: Vec<TargetObservation>,
    /// For each vehicle the ids of its points and its image points, both sorted.
    pub vehicle_observations: Vec<(Vec<&'t str>, Vec<VehicleObservation>)>,
    pub vehicle_poses: HashMap<(usize, usize), Pose>,
    pub has_vehicle_poses: bool,
    pub known_points: HashMap<(usize, &'t str), [Option<Known>; 3]>,
    /// Positions of each vehicle and point.
    pub received: Vec<(usize, &'t str, ReceivedPosition)>,
    pub video: Option<Video>,
}

impl Checked<'_> {
    /// The folder of these vehicles, with the warnings of `findings`.
    pub fn into_folder(self, vehicles: Vec<Vehicle>, findings: Findings, inputs: Vec<InputFile>) -> Folder {
        let targets = TargetInventory::new(&self.targets, &self.target_observations, self.frames.len());
        let Settings { name, camera, .. } = self.settings;
        let poses = self.camera_poses.len();
        let inventory = Inventory::new(name, camera.size_px, &self.frames, poses, &vehicles, targets);
        let mut not_supported = Vec::new();
        if !self.has_vehicle_poses && self.settings.ground.is_none() {
            not_supported.push(
                "vehicle poses (there is no vehicle_poses.csv, and no terrain to find them on)".to_owned(),
            );
        }
        let warnings = findings.warnings().to_vec();
        if !not_supported.is_empty() {
            return Folder { inventory, problem: Err(not_supported), warnings, inputs };
        }
        let are_measured = self.settings.vehicle_poses_are_measured;
        let vehicles: Vec<Vehicle> = vehicles
            .into_iter()
            .map(|vehicle| Vehicle { poses_are_measured: are_measured, ..vehicle })
            .collect();
        let receivers = gnss::receivers(&self.received, self.settings.gnss, &vehicles);
        let problem = Problem {
            name: self.settings.name.clone(),
            camera: self.settings.camera.clone(),
            calibration: self.settings.calibration,
            shutter: self.settings.shutter,
            camera_poses: (0..self.frames.len())
                .map(|frame| self.camera_poses.get(&frame).copied())
                .collect(),
            frames: self.frames,
            camera_pose_sigma: self.settings.camera_pose_sigma,
            targets: self.targets,
            target_observations: self.target_observations,
            vehicles,
            vehicle_pose_sigma: self.settings.vehicle_pose_sigma,
            ground: self.ground,
            receivers,
            video: self.video,
        };
        Folder { inventory, problem: Ok(problem), warnings, inputs }
    }

    /// The vehicles, with what is known of their points.
    pub fn vehicles(&self, findings: &mut Findings) -> Vec<Vehicle> {
        let all = self.settings.vehicles.iter().zip(&self.vehicle_observations).enumerate();
        let vehicle =
            |(at, (settings, (ids, observations))): (usize, (&VehicleSettings, &(Vec<&str>, Vec<_>)))| {
                let shape_point = |id: &&str| ShapePoint {
                    id: (*id).to_owned(),
                    known: self.known_points.get(&(at, *id)).copied().unwrap_or_default(),
                };
                let marker = settings.marker.as_ref();
                Vehicle {
                    id: settings.id.clone(),
                    marker: marker.and_then(|(marker, _)| ids.binary_search(&marker.as_str()).ok()),
                    height: settings.height,
                    is_car: settings.is_car,
                    points: ids.iter().map(shape_point).collect(),
                    observations: observations.clone(),
                    poses: (0..self.frames.len())
                        .map(|frame| self.vehicle_poses.get(&(at, frame)).copied())
                        .collect(),
                    ..Vehicle::default()
                }
            };
        let mut vehicles: Vec<Vehicle> = all.map(vehicle).collect();
        self.settings.of_points.join(&mut vehicles, findings);
        vehicles
    }
}
