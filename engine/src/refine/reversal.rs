//! The other depth: a body that hardly turns under its camera looks nearly the same turned inside out.
//!
//! From far away a shape mirrored along the line of sight, turning the other way, has the same image points
//! (Necker's reversal: Ullman, *The Interpretation of Visual Motion*, 1979). Only perspective and what is
//! known of height and motion tell the two apart, and each is a minimum of its own. So the mirrored one is
//! adjusted too, body by body under the cameras as they are, and taken where its cost is lower.

use super::RefineOptions;
use super::verdicts::Excluded;
use crate::estimate::{Estimate, VehicleEstimate};
use crate::geometry::Pose;
use crate::geometry::rotation::{exp, log};
use crate::network::{Body, BodyStrength, MotionPrior, MotionPriors, Selection, anchored};
use crate::problem::{Freedom, PoseSigma, Problem, Shutter};
use crate::rules::rules;
use nalgebra::{Point3, Unit, UnitQuaternion, Vector3};
use trackbundle_solver::TooLarge;
use trackbundle_solver::loss::Loss;
use trackbundle_solver::minimise::{Minimiser, MinimiserOptions};

rules! {
    /// Bodies at the wrong one of two depths.
    pub struct ReversalRules {
        /// A body that turns more across the line of sight has one depth.
        most_turn_rad: f64 = 0.1, "rad";
        /// The most iterations of each of the two.
        most_iterations: usize = 60, "iterations";
        /// By so much the mirrored one must be better.
        least_decrease: f64 = 1e-7, "share of the cost";
    }
}

const RULES: ReversalRules = ReversalRules::DEFAULT;

/// The estimate with those vehicles mirrored that fit better so; `None` where none does.
pub fn better_reversed(
    problem: &Problem,
    start: &Estimate,
    now: &Estimate,
    options: &RefineOptions,
    strengths: &[BodyStrength],
    loss: Loss,
    excluded: &Excluded,
) -> Result<Option<Estimate>, TooLarge> {
    if problem.vehicle_pose_sigma.is_exact() {
        return Ok(None);
    }
    let mut better = None;
    for (at, vehicle) in problem.vehicles.iter().enumerate() {
        let Some(mirrored) = reversed(&now.camera_poses, &now.vehicles[at]) else { continue };
        let exact = PoseSigma { position_m: Some(0.0), rotation_rad: [Some(0.0); 3] };
        // Field by field: the other vehicles are not copied.
        let alone = Problem {
            name: problem.name.clone(),
            camera: now.camera.clone(),
            calibration: Default::default(),
            shutter: Shutter { readout_s: now.readout_s, freedom: Freedom::Fixed },
            // They say nothing of depth that the images do not.
            receivers: Vec::new(),
            frames: problem.frames.clone(),
            vehicle_pose_sigma: problem.vehicle_pose_sigma,
            ground: problem.ground.clone(),
            camera_poses: now.camera_poses.iter().copied().map(Some).collect(),
            camera_pose_sigma: exact,
            targets: Vec::new(),
            target_observations: Vec::new(),
            vehicles: vec![vehicle.clone()],
            video: None,
        };
        let with = |of: &Estimate, vehicle: &VehicleEstimate| Estimate {
            camera_poses: now.camera_poses.clone(),
            vehicles: vec![vehicle.clone()],
            targets: Vec::new(),
            terrain_bias_m: of.terrain_bias_m,
            camera: now.camera.clone(),
            readout_s: now.readout_s,
            receivers: Vec::new(),
        };
        let own = strengths.iter().find(|s| s.body == Body::Vehicle(vehicle.id.clone()));
        let motion = MotionPriors {
            camera: MotionPrior::Off,
            vehicle: own.map_or(MotionPrior::Off, |own| MotionPrior::Given(own.order, own.strength)),
        };
        let options = RefineOptions { motion, ..*options };
        let start = with(start, &start.vehicles[at]);
        let taken = excluded.selection().vehicles.swap_remove(at);
        let selection = Selection { vehicles: vec![taken], targets: Vec::new() };
        let adjusted = |from: &VehicleEstimate| -> Result<(f64, VehicleEstimate), TooLarge> {
            let current = with(now, from);
            let mut model = anchored(&alone, &start, &current, options.network(), &selection);
            model.set_image_loss(loss);
            let limits = MinimiserOptions { max_iterations: RULES.most_iterations, ..Default::default() };
            let minimum =
                Minimiser::new(&model.system)?.run(&model.system, model.system.start(), limits, None);
            let mut end = model.estimate(&alone, &start, &minimum.values);
            Ok((minimum.cost.value, end.vehicles.remove(0)))
        };
        let (cost, _) = adjusted(&now.vehicles[at])?;
        let (other_cost, other) = adjusted(&mirrored)?;
        if other_cost < cost * (1.0 - RULES.least_decrease) {
            better.get_or_insert_with(|| now.clone()).vehicles[at] = other;
        }
    }
    Ok(better)
}

/// The vehicle mirrored along the mean line of sight, turning the other way across it; `None` where it turns
/// too much for that to look the same.
fn reversed(camera_poses: &[Pose], vehicle: &VehicleEstimate) -> Option<VehicleEstimate> {
    let points: Vec<Point3<f64>> = vehicle.points.iter().flatten().copied().collect();
    let poses: Vec<(&Pose, Pose)> = camera_poses
        .iter()
        .zip(&vehicle.poses)
        .filter_map(|(camera, pose)| Some((camera, (*pose)?)))
        .collect();
    if points.is_empty() || vehicle.left_out.is_some() {
        return None;
    }
    let middle = Point3::from(points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / points.len() as f64);
    let turn = |(camera, pose): &(&Pose, Pose)| camera.rotation.inverse() * pose.rotation;
    let (camera, pose) = poses.get(poses.len() / 2)?;
    let mean = turn(&(camera, *pose));
    let sight = pose.inverse_transform_point(&Point3::from(camera.translation.vector)) - middle;
    let sight = Unit::try_new(sight, 1e-6)?;
    let mut mirrored = vehicle.clone();
    for (camera, own) in camera_poses.iter().zip(&mut mirrored.poses) {
        let Some(pose) = own else { continue };
        let by = log(&(mean.inverse() * turn(&(camera, *pose))));
        let along = sight.into_inner() * sight.dot(&by);
        if (by - along).norm() > RULES.most_turn_rad {
            return None;
        }
        let held = *pose * middle;
        let rotation: UnitQuaternion<f64> = camera.rotation * mean * exp(&(2.0 * along - by));
        *pose = Pose::from_parts((held.coords - rotation * middle.coords).into(), rotation);
    }
    let mirror = |point: &Point3<f64>| point - sight.into_inner() * (2.0 * sight.dot(&(point - middle)));
    mirrored.points.iter_mut().flatten().for_each(|point| *point = mirror(point));
    Some(mirrored)
}
