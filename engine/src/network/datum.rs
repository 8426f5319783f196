//! What holds the coordinate systems: which poses are held, and how much their starting values weigh.
//!
//! Starting poses come from one method and are wrong *together* over many frames. Whatever the
//! spectrum of `n` errors of standard deviation `s` is, no combination of them (of unit length) has a
//! variance above `n s^2`. Rows with standard deviation `s sqrt(n)` are therefore never too
//! confident, and all of them together weigh as much as one observation of `s`.
//!
//! The starting pose of a vehicle is only to say where in the body its origin lies and which way it
//! looks. What it says of the scale is no news: it was computed from camera and terrain. A change of
//! scale moves a vehicle along its ray from the camera, so along that ray its position weighs a
//! hundredth, unless nothing else knows the scale.

use super::warnings::{CameraGap, ScaleGap};
use crate::geometry::Pose;
use crate::problem::{Problem, Receiver, Role, Vehicle};
use nalgebra::{Rotation3, Vector3};

/// By what the standard deviation of a vehicle's starting position is multiplied along its ray.
const WEAKNESS_ALONG_RAY: f64 = 10.0;
/// Standard deviations of starting poses of vehicles that come without \[m, rad\].
const UNKNOWN_VEHICLE_POSE: [f64; 6] = [1.0, 1.0, 1.0, 0.05, 0.05, 0.1];
/// Standard deviations of starting poses of cameras that come without and are held by targets: so
/// weak that they only keep frames that see nothing from being undetermined \[m, rad\].
const UNKNOWN_CAMERA_POSE: [f64; 6] = [10.0, 10.0, 10.0, 0.2, 0.2, 0.2];
/// Control targets that a frame needs to be held by them.
const TARGETS_THAT_HOLD: usize = 3;

/// How the poses of one body enter the adjustment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Treatment {
    /// Which components of a pose are adjusted.
    pub free: [bool; 6],
    /// Standard deviations of the rows of each starting pose \[m, rad\]. For a vehicle the third is
    /// that along its ray from the camera.
    pub prior_sigma: [f64; 6],
}

/// The axes along which the starting position of a vehicle has its standard deviations: the third is
/// its ray from the camera.
pub fn ray_axes(camera: &Pose, vehicle: &Pose) -> Rotation3<f64> {
    let ray = vehicle.translation.vector - camera.translation.vector;
    // Any two directions across will do.
    let up = if ray.x.abs() < ray.z.abs() { Vector3::x() } else { Vector3::z() };
    Rotation3::face_towards(&ray, &up)
}

/// How camera poses that were given are treated, and a warning where they are held for want of anything
/// better. Those that were not given come from the targets, which are in the adjustment themselves: they
/// are free, and their starting values weigh nothing.
pub fn of_cameras(problem: &Problem) -> (Treatment, Option<CameraGap>) {
    let given = problem.camera_poses.iter().flatten().count();
    let rows = given as f64;
    let components = problem.camera_pose_sigma.components();
    let held_by_targets = targets_hold(problem);
    let unknown_is_held = given > 0 && !held_by_targets && components.iter().any(Option::is_none);
    let treatment = Treatment {
        free: components.map(|sigma| sigma.map_or(held_by_targets, |s| s > 0.0)),
        prior_sigma: prior_sigma(&components, &UNKNOWN_CAMERA_POSE, rows.sqrt()),
    };
    let is_adrift = !held_by_targets && (given < problem.frames.len() || treatment.free.contains(&true));
    let gap = unknown_is_held.then(|| {
        let sigma = &problem.camera_pose_sigma;
        let positions = sigma.is_unknown() || sigma.position_m.is_none();
        let attitudes = sigma.is_unknown() || !positions;
        CameraGap::Held { positions, attitudes, targets_needed: TARGETS_THAT_HOLD }
    });
    (treatment, gap.or(is_adrift.then_some(CameraGap::Adrift)))
}

/// What is missing that would hold the cameras, if something is.
pub fn camera_gap(problem: &Problem) -> Option<CameraGap> {
    of_cameras(problem).1
}

/// How the poses of a vehicle are treated that are given; without any, how all of them are. Poses that
/// were found are starting values and nothing known, so that they are treated as poses without a sigma.
pub fn of_vehicle(problem: &Problem, vehicle: &Vehicle) -> Treatment {
    let (rows, components) = if vehicle.has_no_poses() {
        (vehicle.frames_without_pose().iter().filter(|without| **without).count(), [None; 6])
    } else {
        (vehicle.poses.iter().flatten().count(), problem.vehicle_pose_sigma.components())
    };
    if vehicle.has_measured_poses() {
        // Each by itself, and their standard deviations are above zero or held.
        let prior_sigma = prior_sigma(&components, &UNKNOWN_VEHICLE_POSE, 1.0);
        return Treatment { free: components.map(|sigma| sigma != Some(0.0)), prior_sigma };
    }
    let rows = rows as f64;
    let mut prior_sigma = prior_sigma(&components, &UNKNOWN_VEHICLE_POSE, rows.sqrt());
    if scale_gap(problem, vehicle).is_none() {
        prior_sigma[2] *= WEAKNESS_ALONG_RAY;
    }
    Treatment { free: components.map(|sigma| sigma != Some(0.0)), prior_sigma }
}

fn prior_sigma(known: &[Option<f64>; 6], unknown: &[f64; 6], factor: f64) -> [f64; 6] {
    std::array::from_fn(|i| match known[i] {
        // Held: the row is zero whatever it is divided by.
        Some(0.0) => 1.0,
        sigma => sigma.unwrap_or(unknown[i]) * factor,
    })
}

/// Standard deviations that keep the camera of a frame from being undetermined that has neither a given
/// pose, nor a motion prior, nor targets enough; `None` where nothing of the kind is needed \[m, rad\].
pub fn of_bridged_cameras(problem: &Problem, has_motion: bool) -> Vec<Option<[f64; 6]>> {
    let factor = (problem.frames.len() as f64).sqrt();
    let is_lost =
        |(pose, seen): (&Option<Pose>, usize)| pose.is_none() && !has_motion && seen < TARGETS_THAT_HOLD;
    let lost = problem.camera_poses.iter().zip(control_in_view(problem)).map(is_lost);
    lost.map(|is_lost| is_lost.then(|| UNKNOWN_CAMERA_POSE.map(|sigma| sigma * factor))).collect()
}

/// Whether nothing but their own given poses holds the cameras, and they are adjusted.
pub fn cameras_float(problem: &Problem, cameras: &Treatment) -> bool {
    !targets_hold(problem) && cameras.free[..3].contains(&true)
}

/// Whether most frames see enough surveyed control targets to be held by them.
fn targets_hold(problem: &Problem) -> bool {
    let mut seen = control_in_view(problem);
    seen.sort_unstable();
    seen[seen.len() / 2] >= TARGETS_THAT_HOLD
}

/// How many surveyed control targets each frame sees.
fn control_in_view(problem: &Problem) -> Vec<usize> {
    let mut seen = vec![0; problem.frames.len()];
    for observation in &problem.target_observations {
        let target = &problem.targets[observation.target];
        seen[observation.frame] += usize::from(target.role == Role::Control && target.is_surveyed());
    }
    seen
}

/// Why the scale of a vehicle is not fixed by the problem, where it is not.
///
/// A rigid body under one camera has a scale that no image point sees. This looks at what is known
/// only; how well the scale is held is for the covariance to say.
pub fn scale_gap(problem: &Problem, vehicle: &Vehicle) -> Option<ScaleGap> {
    let sigma = problem.vehicle_pose_sigma;
    if sigma.position_m == Some(0.0) && !vehicle.has_no_poses() {
        return None;
    }
    if vehicle.has_measured_poses() && vehicle.poses.iter().flatten().count() >= 2 {
        return None;
    }
    let is_own = |receiver: &Receiver| problem.vehicles[receiver.vehicle].id == vehicle.id;
    if problem.receivers.iter().any(|receiver| is_own(receiver) && receiver.positions.len() >= 2) {
        return None;
    }
    let knows_height = vehicle.height.is_some() || vehicle.points.iter().any(|p| p.known[2].is_some());
    match (vehicle.knows_size(), knows_height, has_ground(problem, vehicle)) {
        (true, _, _) | (_, true, true) => None,
        (false, true, false) => Some(ScaleGap::NoTerrain),
        (false, false, true) => Some(ScaleGap::NoHeight),
        (false, false, false) => Some(ScaleGap::Nothing),
    }
}

/// Whether the terrain is known below a pose of a vehicle; where it has none yet, whether at all.
fn has_ground(problem: &Problem, vehicle: &Vehicle) -> bool {
    problem.ground.as_ref().is_some_and(|ground| {
        let mut poses = vehicle.poses.iter().flatten().peekable();
        poses.peek().is_none()
            || poses.any(|pose| ground.terrain.at(pose.translation.x, pose.translation.y).is_ok())
    })
}
