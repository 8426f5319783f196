//! The final least squares of one vehicle with cameras and targets, as if the others had not been seen.

use super::{Adjusted, Arrangement, Network, RefineOptions};
use crate::estimate::Estimate;
use crate::network::{Body, BodyStrength, Model, MotionPrior, MotionPriors, Purpose, Selection};
use crate::problem::{Problem, Receiver};

/// The problem, the estimate and the least squares of one vehicle alone, at the adjusted unknowns of all;
/// `None` where there is no final least squares.
pub fn alone(problem: &Problem, adjusted: &Adjusted, vehicle: usize) -> Option<(Problem, Estimate, Network)> {
    let Adjusted { estimate, adjustment, network } = adjusted;
    let network = network.as_ref()?;
    let receivers: Vec<_> = problem
        .receivers
        .iter()
        .zip(&estimate.receivers)
        .filter(|(receiver, _)| receiver.vehicle == vehicle)
        .map(|(receiver, found)| (Receiver { vehicle: 0, ..receiver.clone() }, *found))
        .collect();
    // Field by field: the other vehicles are not copied.
    let own = Problem {
        name: problem.name.clone(),
        camera: problem.camera.clone(),
        calibration: problem.calibration,
        shutter: problem.shutter,
        receivers: receivers.iter().map(|(own, _)| own.clone()).collect(),
        frames: problem.frames.clone(),
        vehicle_pose_sigma: problem.vehicle_pose_sigma,
        ground: problem.ground.clone(),
        camera_poses: problem.camera_poses.clone(),
        camera_pose_sigma: problem.camera_pose_sigma,
        targets: problem.targets.clone(),
        target_observations: problem.target_observations.clone(),
        vehicles: vec![problem.vehicles[vehicle].clone()],
        video: None,
    };
    let found = Estimate {
        camera_poses: estimate.camera_poses.clone(),
        vehicles: vec![estimate.vehicles[vehicle].clone()],
        targets: estimate.targets.clone(),
        terrain_bias_m: estimate.terrain_bias_m,
        camera: estimate.camera.clone(),
        readout_s: estimate.readout_s,
        receivers: receivers.iter().map(|(_, found)| *found).collect(),
    };
    let accepted = adjustment.fits.selection();
    let selection =
        Selection { vehicles: vec![accepted.vehicles[vehicle].clone()], targets: accepted.targets };
    let prior = |body: Body| {
        let of_body = |strength: &&BodyStrength| strength.body == body;
        adjustment
            .motion
            .iter()
            .find(of_body)
            .map_or(MotionPrior::Off, |s| MotionPrior::Given(s.order, s.strength))
    };
    let motion = MotionPriors {
        camera: prior(Body::Camera),
        vehicle: prior(Body::Vehicle(problem.vehicles[vehicle].id.clone())),
    };
    let options = RefineOptions { motion, arrangement: Arrangement::Together, ..Default::default() };
    let frames = vec![network.frames[vehicle].clone()];
    let anchors = [frames[0].anchors.clone()];
    let purpose = Purpose::Statistics { anchors: &anchors };
    let mut model = Model::new(&own, &found, &found, options.network(), &selection, purpose);
    model.set_image_factors(network.model.image_factors());
    model.loosen_conventions();
    let values = model.system.start().clone();
    Some((own, found, Network { model, values, frames }))
}
