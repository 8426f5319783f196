//! Where the frames of bodies are put in the end, in the directions that nothing fixes: a change of the datum, which no
//! measurement notices.
//!
//! While the adjustment runs such a frame is held by coordinates of some points of the body, so that it stays where it is
//! in the body. (Held by its poses alone it would wander to where the body's motion is smoothest: in a roundabout to the
//! middle of the ring.) At the end it is moved
//!
//! * to where poses that were given say, in the mean of all frames;
//! * where none were given, so that the x axis points where the body drives, and the origin lies in the middle of the body,
//!   on the ground: the middle of a box around its adjusted points that leaves out those farthest out.

use crate::estimate::{Estimate, VehicleEstimate};
use crate::geometry::Pose;
use crate::geometry::rotation::{exp, log};
use crate::initialise::vehicle_poses::body_axes::heading_of_travel;
use crate::network::{BodyFrame, of_vehicle, pose_motion};
use crate::problem::{Problem, Vehicle};
use crate::stats::series::sigma_of_mean;
use nalgebra::{DMatrix, DVector, Point3, UnitQuaternion, Vector3, Vector6};

/// A direction that turns about z by less does not turn, beside its shifts of a metre.
const LEAST_TURN: f64 = 1e-6;

/// Puts the frames of all bodies where they belong.
pub fn settle(problem: &Problem, estimate: &mut Estimate, frames: &[BodyFrame]) {
    put(problem, estimate, frames, true);
}

/// Once more, after bodies were moved in their frames; axes that look where a body drives stay as they are.
pub fn settle_again(problem: &Problem, estimate: &mut Estimate, frames: &[BodyFrame]) {
    put(problem, estimate, frames, false);
}

fn put(problem: &Problem, estimate: &mut Estimate, frames: &[BodyFrame], finds_axes: bool) {
    let mut receivers = std::mem::take(&mut estimate.receivers);
    for (at, (vehicle, found)) in problem.vehicles.iter().zip(&mut estimate.vehicles).enumerate() {
        if found.left_out.is_some() {
            continue;
        }
        let own = problem.receivers.iter().zip(&mut receivers).filter(|(receiver, _)| receiver.vehicle == at);
        let turn_arms = |by: &UnitQuaternion<f64>| own.for_each(|(_, r)| r.lever_arm_m = by * r.lever_arm_m);
        if !vehicle.has_no_poses() {
            let moved = as_given(problem, vehicle, found, &frames[at]);
            turn_arms(&moved.rotation.inverse());
        } else if !is_known(vehicle) {
            let turned = if finds_axes { look_where_it_drives(found, vehicle.is_car) } else { None };
            if let Some(turned) = turned {
                turn_arms(&turned.inverse());
            }
            origin_in_the_middle(found, problem.ground.is_some());
        }
    }
    estimate.receivers = receivers;
}

/// Gives points that took no part, as they were known before their frame was moved, their places in it.
pub fn take_along(before: &Estimate, moved: &mut Estimate, known: &[Vec<Option<Point3<f64>>>]) {
    for ((before, moved), known) in before.vehicles.iter().zip(&mut moved.vehicles).zip(known) {
        let mut poses = before.poses.iter().zip(&moved.poses);
        let new_from_old = poses.find_map(|(old, new)| Some((*new)?.inverse() * (*old)?));
        let new_from_old = new_from_old.unwrap_or_else(Pose::identity);
        for (point, known) in moved.points.iter_mut().zip(known) {
            *point = point.or(known.map(|known| new_from_old * known));
        }
    }
}

/// Whether the origin of a body lies in its middle for want of anything else that says where it lies.
pub fn is_in_the_middle(vehicle: &Vehicle) -> bool {
    vehicle.has_no_poses() && !is_known(vehicle)
}

/// Whether known coordinates say where the origin lies.
fn is_known(vehicle: &Vehicle) -> bool {
    vehicle.points.iter().any(|p| p.known[0].is_some() || p.known[1].is_some())
}

/// Moves a frame: poses and points change, and no place in the world does.
fn change(found: &mut VehicleEstimate, body_from_new: &Pose) {
    found.poses.iter_mut().flatten().for_each(|pose| *pose *= body_from_new);
    found.points.iter_mut().flatten().for_each(|p| *p = body_from_new.inverse_transform_point(p));
}

/// So that the x axis points where the body drives; the new frame in the old one, where it drives.
fn look_where_it_drives(found: &mut VehicleEstimate, is_car: bool) -> Option<UnitQuaternion<f64>> {
    let points: Vec<Point3<f64>> = found.points.iter().flatten().copied().collect();
    let Some(travel) = heading_of_travel(&found.poses, &points, is_car) else {
        found.heading_turned = 0.5;
        return None;
    };
    found.axes_sigma_rad = travel.sigma_rad;
    found.heading_turned = travel.turned;
    // Half a turn puts what lay ahead of the origin behind it.
    found.axle[0] *= travel.angle_rad.cos().signum();
    let body_from_turned = UnitQuaternion::from_scaled_axis(Vector3::z() * travel.angle_rad);
    change(found, &Pose::from_parts(Vector3::zeros().into(), body_from_turned));
    Some(body_from_turned)
}

/// So that the origin lies in the middle of the body; on the ground as it is where there is one, or below all points.
fn origin_in_the_middle(found: &mut VehicleEstimate, is_on_ground: bool) {
    let Some(mut middle) = found.middle() else { return };
    if is_on_ground {
        middle.z = 0.0;
    }
    found.axle[0] -= middle.x;
    change(found, &Pose::from_parts(middle.coords.into(), UnitQuaternion::identity()));
}

/// So that poses differ least from those that were given, along what is open of the frame; the new frame in the old one.
fn as_given(problem: &Problem, vehicle: &Vehicle, found: &mut VehicleEstimate, frame: &BodyFrame) -> Pose {
    let sigma = Vector6::from(of_vehicle(problem, vehicle).prior_sigma);
    let mut moved = Pose::identity();
    // Least squares over the open directions; what is left after one step is of second order.
    for _ in 0..3 {
        let open = frame.open.len();
        let mut normal = DMatrix::<f64>::zeros(open, open);
        let mut right = DVector::<f64>::zeros(open);
        for (pose, given) in found.poses.iter().zip(&vehicle.poses) {
            let (Some(pose), Some(given)) = (pose, given) else { continue };
            let mut residual = Vector6::zeros();
            let shift = given.translation.vector - pose.translation.vector;
            residual.fixed_rows_mut::<3>(0).copy_from(&shift);
            let turn = log(&(pose.rotation.inverse() * given.rotation));
            residual.fixed_rows_mut::<3>(3).copy_from(&turn);
            let columns =
                DMatrix::from_fn(6, open, |row, k| pose_motion(&frame.open[k], pose)[row] / sigma[row]);
            normal += columns.tr_mul(&columns);
            right += columns.tr_mul(&residual.component_div(&sigma));
        }
        let Some(solved) = normal.cholesky().map(|factor| factor.solve(&right)) else { return moved };
        let step: Vector6<f64> =
            frame.open.iter().zip(solved.iter()).map(|(direction, by)| direction * *by).sum();
        // A frame that moves by `(v, w)` moves poses by `(-R v, -w)`.
        let (shift, turn) = (-step.fixed_rows::<3>(0).into_owned(), -step.fixed_rows::<3>(3).into_owned());
        let body_from_new = Pose::from_parts(shift.into(), exp(&turn));
        change(found, &body_from_new);
        moved *= body_from_new;
    }
    found.axes_sigma_rad = of_given_axes(vehicle, found, frame);
    moved
}

/// How well the given poses together say where the x axis points, where nothing else does \[rad\]: by how they scatter
/// about the adjusted ones. What they all share nobody can know.
fn of_given_axes(vehicle: &Vehicle, found: &VehicleEstimate, frame: &BodyFrame) -> f64 {
    if !frame.open.iter().any(|direction| direction[5].abs() > LEAST_TURN) {
        return 0.0;
    }
    let turn = |(pose, given): (&Option<Pose>, &Option<Pose>)| {
        Some(log(&((*pose)?.rotation.inverse() * (*given)?.rotation)).z)
    };
    sigma_of_mean(&found.poses.iter().zip(&vehicle.poses).filter_map(turn).collect::<Vec<f64>>())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn body(points: Vec<Option<Point3<f64>>>) -> VehicleEstimate {
        VehicleEstimate {
            poses: vec![Some(crate::geometry::pose([3.0, -2.0, 0.1], [0.9, 0.0, 0.1, 0.4])), None],
            points,
            depths: Vec::new(),
            motion: None,
            axle: [-1.3, 0.0],
            axes_sigma_rad: 0.0,
            heading_turned: 0.0,
            left_out: None,
        }
    }

    #[test]
    fn a_mirror_does_not_move_the_middle() {
        let mut points: Vec<Option<Point3<f64>>> = Vec::new();
        for at in 0..40 {
            let angle = f64::from(at) * 0.7;
            points.push(Some(Point3::new(1.0 + 2.2 * angle.cos(), 0.5 + 0.9 * angle.sin(), 0.3)));
        }
        let before = body(points.clone()).middle().unwrap();
        points.push(Some(Point3::new(1.5, 2.9, 1.0)));
        points.push(None);
        let after = body(points).middle().unwrap();
        assert!(
            (before - after).norm() < 0.05 && (before - Point3::new(1.0, 0.5, 0.3)).norm() < 0.1,
            "{after}"
        );
        assert!(body(vec![None]).middle().is_none());
    }

    #[test]
    fn a_change_of_the_frame_moves_no_point_in_the_world() {
        let mut found = body(vec![Some(Point3::new(1.0, 2.0, 0.5)), Some(Point3::new(-3.0, 0.0, 1.5)), None]);
        let place = |of: &VehicleEstimate| of.poses[0].unwrap() * of.points[1].unwrap();
        let before = place(&found);
        origin_in_the_middle(&mut found, true);
        assert!((place(&found) - before).norm() < 1e-12);
        assert_eq!(found.points[0].map(|p| [p.x, p.z]), Some([2.0, 0.5]));
        assert!((found.axle[0] + 0.3).abs() < 1e-12);
    }
}
