//! Tables that fit each other, made into a problem.

use super::inventory::{Inventory, TargetInventory};
use super::problem_toml::Settings;
use crate::geometry::Pose;
use crate::problem::{
    Frame, GroundKnowledge, Known, Problem, ReceivedPosition, Receiver, ShapePoint, Target,
    TargetObservation, Vehicle, VehicleObservation, Video,
};
use crate::tables::Findings;
use nalgebra::Vector2;
use std::collections::{BTreeSet, HashMap};

/// A problem folder that is valid.
#[derive(Debug)]
pub struct Folder {
    /// What is there.
    pub inventory: Inventory,
    /// The problem, or what it needs that this version does not compute.
    pub problem: Result<Problem, Vec<String>>,
    /// What is odd.
    pub warnings: Vec<String>,
}

/// Where each id stands.
pub(super) fn positions<'a>(ids: &[&'a str]) -> HashMap<&'a str, usize> {
    ids.iter().enumerate().map(|(at, id)| (*id, at)).collect()
}

/// An image point of a vehicle; frame and vehicle are indices.
pub(super) struct ObservedRow<'t> {
    pub vehicle: usize,
    pub frame: usize,
    pub point: &'t str,
    pub image_px: Vector2<f64>,
    pub sigma_px: f64,
}

/// Tables that fit each other, as far as there are no findings.
pub(super) struct Checked<'t> {
    pub settings: &'t Settings,
    pub ground: Option<GroundKnowledge>,
    pub frames: Vec<Frame>,
    pub camera_poses: HashMap<usize, Pose>,
    pub targets: Vec<Target>,
    pub target_observations: Vec<TargetObservation>,
    pub vehicle_observations: Vec<ObservedRow<'t>>,
    pub vehicle_poses: HashMap<(usize, usize), Pose>,
    pub has_vehicle_poses: bool,
    pub known_points: HashMap<(usize, &'t str), [Option<Known>; 3]>,
    /// Positions of each vehicle and point.
    pub received: Vec<(usize, &'t str, ReceivedPosition)>,
    pub video: Option<Video>,
}

impl Checked<'_> {
    /// The folder, with the warnings of `findings`.
    pub fn into_folder(self, findings: Findings) -> Folder {
        let vehicles = self.vehicles();
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
            return Folder { inventory, problem: Err(not_supported), warnings };
        }
        let receivers = self.receivers(&vehicles);
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
        Folder { inventory, problem: Ok(problem), warnings }
    }

    fn receivers(&self, vehicles: &[Vehicle]) -> Vec<Receiver> {
        let mut all: Vec<Receiver> = Vec::new();
        for (vehicle, id, received) in &self.received {
            let points = &vehicles[*vehicle].points;
            let Some(point) = points.iter().position(|point| point.id == *id) else { continue };
            let at = all.iter().position(|r| (r.vehicle, r.point) == (*vehicle, point));
            let at = at.unwrap_or_else(|| {
                let (positions, knowledge) = (Vec::new(), self.settings.gnss);
                all.push(Receiver { vehicle: *vehicle, point, positions, knowledge });
                all.len() - 1
            });
            all[at].positions.push(*received);
        }
        for receiver in &mut all {
            receiver.positions.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
        }
        all.sort_by_key(|receiver| (receiver.vehicle, receiver.point));
        all
    }

    fn vehicles(&self) -> Vec<Vehicle> {
        let mut point_ids: Vec<BTreeSet<&str>> = vec![BTreeSet::new(); self.settings.vehicles.len()];
        for row in &self.vehicle_observations {
            point_ids[row.vehicle].insert(row.point);
        }
        let mut vehicles: Vec<Vehicle> = Vec::new();
        let mut indices = Vec::new();
        for (at, (settings, ids)) in self.settings.vehicles.iter().zip(&point_ids).enumerate() {
            let index = positions(&ids.iter().copied().collect::<Vec<_>>());
            let shape_point = |id: &&str| ShapePoint {
                id: (*id).to_owned(),
                known: self.known_points.get(&(at, *id)).copied().unwrap_or_default(),
            };
            vehicles.push(Vehicle {
                id: settings.id.clone(),
                marker: settings.marker.as_ref().and_then(|(id, _)| index.get(id.as_str()).copied()),
                height: settings.height,
                scale_bars: Vec::new(),
                is_car: settings.is_car,
                points: ids.iter().map(shape_point).collect(),
                observations: Vec::new(),
                poses: (0..self.frames.len())
                    .map(|frame| self.vehicle_poses.get(&(at, frame)).copied())
                    .collect(),
            });
            indices.push(index);
        }
        for ObservedRow { vehicle, frame, point, image_px, sigma_px } in &self.vehicle_observations {
            let point = indices[*vehicle][*point];
            let (frame, image_px, sigma_px) = (*frame, *image_px, *sigma_px);
            vehicles[*vehicle].observations.push(VehicleObservation { frame, point, image_px, sigma_px });
        }
        for vehicle in &mut vehicles {
            vehicle.observations.sort_by_key(|o| (o.frame, o.point));
        }
        vehicles
    }
}
