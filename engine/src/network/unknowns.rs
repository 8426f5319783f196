//! Values of a network's unknowns from an estimate, and back.

use super::blocks::{ReceiverBlocks, VehicleBlocks};
use super::model::Model;
use super::motion::Body;
use crate::camera::INTERIOR;
use crate::estimate::{Estimate, ReceiverEstimate, VehicleEstimate};
use crate::problem::{Problem, Vehicle};
use nalgebra::{Point3, Vector3};
use trackbundle_solver::manifold::{read_point, read_pose, write_pose};
use trackbundle_solver::system::{BlockId, Values};

impl Model {
    /// The values of an estimate.
    pub fn values(&self, estimate: &Estimate) -> Values {
        let mut values = self.system.start().clone();
        for (block, pose) in self.blocks().cameras.iter().zip(&estimate.camera_poses) {
            self.system.set_value(&mut values, *block, &write_pose(pose));
        }
        for (blocks, estimate) in self.blocks().vehicles.iter().zip(&estimate.vehicles) {
            for (block, pose) in blocks.poses.iter().zip(&estimate.poses) {
                if let (Some(block), Some(pose)) = (block, pose) {
                    self.system.set_value(&mut values, *block, &write_pose(pose));
                }
            }
            self.set_points(&mut values, &blocks.points, &estimate.points);
            if let Some((middle, place)) =
                blocks.middle.and_then(|m| Some((m.block, estimate.points[m.point]?)))
            {
                self.system.set_value(&mut values, middle, place.coords.as_slice());
            }
            if let Some(axle) = blocks.axle {
                self.system.set_value(&mut values, axle, &estimate.axle);
            }
        }
        self.set_points(&mut values, &self.blocks().targets, &estimate.targets);
        self.system.set_value(&mut values, self.blocks().bias, &[estimate.terrain_bias_m]);
        if let Some([interior, readout]) = self.blocks().open_camera {
            self.system.set_value(&mut values, interior, &estimate.camera.interior());
            self.system.set_value(&mut values, readout, &[estimate.readout_s]);
        }
        for ((own, found), (vehicle, point)) in
            self.blocks().receivers.iter().zip(&estimate.receivers).zip(self.receiver_points())
        {
            let place = estimate.vehicles[*vehicle].points[*point];
            if let (Some(own), Some(place)) = (own, place) {
                self.system.set_value(
                    &mut values,
                    own.antenna,
                    (place + found.lever_arm_m).coords.as_slice(),
                );
                let shift = found.shift_m;
                let value = [found.clock_offset_s, found.clock_drift, shift.x, shift.y, shift.z];
                self.system.set_value(&mut values, own.receiver, &value);
            }
        }
        values
    }

    fn set_points(&self, values: &mut Values, blocks: &[Option<BlockId>], points: &[Option<Point3<f64>>]) {
        for (block, point) in blocks.iter().zip(points) {
            if let (Some(block), Some(point)) = (block, point) {
                self.system.set_value(values, *block, point.coords.as_slice());
            }
        }
    }

    /// The estimate of values; what is not in the system is as in `start`.
    pub fn estimate(&self, problem: &Problem, start: &Estimate, values: &Values) -> Estimate {
        let pose = |block: BlockId| read_pose(self.system.value(values, block));
        let point = |block: BlockId| read_point(self.system.value(values, block));
        let strengths = self.motion.strengths(&self.system);
        let vehicle = |((blocks, start), vehicle): ((&VehicleBlocks, &VehicleEstimate), &Vehicle)| {
            if start.left_out.is_some() {
                return start.clone();
            }
            let mut estimate = VehicleEstimate {
                poses: blocks.poses.iter().map(|block| block.map(pose)).collect(),
                points: blocks.points.iter().map(|block| block.map(point)).collect(),
                depths: start.depths.clone(),
                axle: blocks
                    .axle
                    .map_or(start.axle, |axle| self.system.value(values, axle).try_into().expect("an axle")),
                motion: strengths
                    .iter()
                    .find(|found| found.body == Body::Vehicle(vehicle.id.clone()))
                    .map(|found| (found.order, found.strength)),
                axes_sigma_rad: start.axes_sigma_rad,
                heading_turned: start.heading_turned,
                left_out: None,
            };
            estimate.bridge_gaps(problem, vehicle);
            estimate
        };
        let vehicles = self.blocks().vehicles.iter().zip(&start.vehicles).zip(&problem.vehicles);
        let targets = self.blocks().targets.iter().zip(&start.targets);
        let (camera, readout_s) = match self.blocks().open_camera {
            None => (start.camera.clone(), start.readout_s),
            Some([interior, readout]) => {
                let numbers: [f64; INTERIOR] =
                    self.system.value(values, interior).try_into().expect("an interior orientation");
                let is_adjusted = self.system.free(interior).contains(&true);
                let camera =
                    if is_adjusted { problem.camera.with_interior(&numbers) } else { start.camera.clone() };
                (camera, self.system.value(values, readout)[0])
            }
        };
        let receiver = |((own, start), (vehicle, at)): (
            (&Option<ReceiverBlocks>, &ReceiverEstimate),
            &(usize, usize),
        )| {
            let Some((own, place)) = own.zip(self.blocks().vehicles[*vehicle].points[*at]) else {
                return *start;
            };
            let value = self.system.value(values, own.receiver);
            ReceiverEstimate {
                clock_offset_s: value[0],
                clock_drift: value[1],
                shift_m: Vector3::new(value[2], value[3], value[4]),
                lever_arm_m: point(own.antenna) - point(place),
            }
        };
        let receivers = self.blocks().receivers.iter().zip(&start.receivers).zip(self.receiver_points());
        Estimate {
            camera_poses: self.blocks().cameras.iter().map(|block| pose(*block)).collect(),
            receivers: receivers.map(receiver).collect(),
            vehicles: vehicles.map(vehicle).collect(),
            targets: targets.map(|(block, start)| block.map(point).or(*start)).collect(),
            terrain_bias_m: self.system.value(values, self.blocks().bias)[0],
            camera,
            readout_s,
        }
    }
}
