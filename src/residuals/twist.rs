//! Smooth motion of a vehicle in its own axes: how its mean twist changes over three neighbouring
//! frames.
//!
//! ```text
//! phi = log(R0^T R1)                           turn between two frames
//! nu  = J^-1(phi) R0^T (p1 - p0) / h           mean velocity between them, in the axes of the body
//! r   = (nu12 - nu01) / ((a + b)/2)            [m/s^2]
//! ```
//!
//! with the left Jacobian `J` of SO(3) and the times `a`, `b` between the frames. `[nu; phi / h]` is
//! the twist that brings the first pose to the second at a steady rate: in a steady curve, where the
//! acceleration in world axes is the centripetal one, `r` is zero. Scaled as
//! [`super::smooth_motion`]; the attitude has `AngularAcceleration` there.

use super::smooth_motion::Steps;
use crate::geometry::rotation::{
    left_jacobian_inverse, left_jacobian_inverse_slope, log, right_jacobian_inverse,
};
use crate::geometry::{Pose, skew};
use nalgebra::{Matrix3, Matrix3x6, Vector3};
use trackbundle_solver::manifold::Manifold;
use trackbundle_solver::residual::{Jacobian, Residual};

/// Blocks: three poses in time order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinearAcceleration(
    /// The times between them.
    pub Steps,
);

impl Residual<3, 3> for LinearAcceleration {
    const MANIFOLDS: [Manifold; 3] = [Manifold::Pose; 3];

    fn evaluate(&self, x: &[&[f64]; 3], jacobian: Option<&mut Jacobian<3, 3>>) -> Option<Vector3<f64>> {
        Some(self.0.evaluate(x, MeanRate::linear, jacobian))
    }
}

/// A mean velocity between two poses and its derivatives by their perturbations.
pub(super) struct MeanRate {
    /// The velocity \[m/s or rad/s\].
    pub value: Vector3<f64>,
    /// By the pose before.
    pub by_first: Matrix3x6<f64>,
    /// By the pose after.
    pub by_second: Matrix3x6<f64>,
}

impl MeanRate {
    /// Of the position in the world \[m/s\], over `step_s`.
    pub fn of_position(from: &Pose, to: &Pose, step_s: f64) -> Self {
        let by_second = joined(&(Matrix3::identity() / step_s), &Matrix3::zeros());
        let value = (to.translation.vector - from.translation.vector) / step_s;
        MeanRate { value, by_first: -by_second, by_second }
    }

    /// The angular part of the twist \[rad/s\]: `log(R0^T R1) / h`.
    pub fn angular(from: &Pose, to: &Pose, step_s: f64) -> Self {
        let turn = log(&(from.rotation.inverse() * to.rotation));
        // log((R exp(a))^T S exp(b)) = phi - Jl^-1(phi) a + Jr^-1(phi) b to first order.
        let by_first = joined(&Matrix3::zeros(), &(left_jacobian_inverse(&turn) / -step_s));
        let by_second = joined(&Matrix3::zeros(), &(right_jacobian_inverse(&turn) / step_s));
        MeanRate { value: turn / step_s, by_first, by_second }
    }

    /// The linear part of the twist, in the axes of the body \[m/s\]: `Jl^-1(phi) R0^T (p1 - p0) / h`.
    pub fn linear(from: &Pose, to: &Pose, step_s: f64) -> Self {
        let turn = log(&(from.rotation.inverse() * to.rotation));
        let to_body = from.rotation.inverse().to_rotation_matrix().into_inner();
        let moved = to_body * (to.translation.vector - from.translation.vector);
        let inverse = left_jacobian_inverse(&turn);
        // exp(-a) g = g + [g]x a to first order.
        let by_turn = left_jacobian_inverse_slope(&turn, &moved);
        let by_position = inverse * to_body / step_s;
        let by_first = (inverse * skew(&moved) - by_turn * inverse) / step_s;
        let by_second = by_turn * right_jacobian_inverse(&turn) / step_s;
        MeanRate {
            value: inverse * moved / step_s,
            by_first: joined(&-by_position, &by_first),
            by_second: joined(&by_position, &by_second),
        }
    }
}

/// The sum of weighted rates, the next of which begins at the pose where the last one ends.
pub(super) fn combined<const BLOCKS: usize>(
    rates: &[MeanRate],
    weights: &[f64],
    jacobian: Option<&mut Jacobian<3, BLOCKS>>,
) -> Vector3<f64> {
    if let Some(jacobian) = jacobian {
        for (at, (rate, weight)) in rates.iter().zip(weights).enumerate() {
            for (block, part) in [(at, rate.by_first), (at + 1, rate.by_second)] {
                let mut columns = jacobian.0[block].fixed_columns_mut::<6>(0);
                columns += part * *weight;
            }
        }
    }
    rates.iter().zip(weights).map(|(rate, weight)| rate.value * *weight).sum()
}

/// The derivative with these parts by position and by attitude.
fn joined(position: &Matrix3<f64>, attitude: &Matrix3<f64>) -> Matrix3x6<f64> {
    let mut matrix = Matrix3x6::zeros();
    matrix.fixed_view_mut::<3, 3>(0, 0).copy_from(position);
    matrix.fixed_view_mut::<3, 3>(0, 3).copy_from(attitude);
    matrix
}

#[cfg(test)]
mod tests {
    use super::super::smooth_motion::{Acceleration, AngularAcceleration};
    use super::super::testing::{assert_jacobian, steady_curve, vehicle_poses};
    use super::*;
    use crate::geometry::{pose, rotation::exp};
    use trackbundle_solver::manifold::write_pose;

    const STEPS: Steps = Steps { first_s: 0.7, second_s: 1.1 };

    #[test]
    fn the_jacobian_is_that_of_its_differences() {
        let poses = vehicle_poses().map(|p| write_pose(&p));
        for (i, j, k) in [(0, 1, 2), (2, 0, 1), (1, 2, 0), (0, 0, 1), (2, 2, 2)] {
            let x = [poses[i].as_slice(), &poses[j], &poses[k]];
            assert_jacobian(&LinearAcceleration(STEPS), &x);
        }
        let near = steady_curve(&[0.0, 0.7, 1.8]);
        assert_jacobian(&LinearAcceleration(STEPS), &[&near[0], &near[1], &near[2]]);
    }

    #[test]
    fn a_steady_curve_has_no_acceleration_in_its_own_axes() {
        let curve = steady_curve(&[0.0, 0.7, 1.8]);
        let x = [curve[0].as_slice(), &curve[1], &curve[2]];
        assert!(LinearAcceleration(STEPS).evaluate(&x, None).unwrap().norm() < 1e-12);
        assert!(AngularAcceleration(STEPS).evaluate(&x, None).unwrap().norm() < 1e-12);
        assert!(Acceleration(STEPS).evaluate(&x, None).unwrap().norm() > 1.0);
    }

    #[test]
    fn on_a_straight_road_it_is_the_acceleration_in_body_axes() {
        let attitude = pose([0.0; 3], [0.9, 0.1, -0.05, 0.4]).rotation;
        let acceleration = Vector3::new(1.5, -0.3, 0.1);
        let at = |t: f64| {
            let moved = attitude * (Vector3::x() * (9.0 * t) + acceleration * (0.5 * t * t));
            write_pose(&Pose::from_parts(moved.into(), attitude))
        };
        let x = [0.0, 0.7, 1.8].map(at);
        let found = LinearAcceleration(STEPS).evaluate(&[&x[0], &x[1], &x[2]], None).unwrap();
        assert!((found - acceleration).norm() < 1e-12);
    }

    #[test]
    fn the_twist_between_two_poses_brings_one_to_the_other() {
        let [from, to, _] = vehicle_poses();
        let [linear, angular] = [MeanRate::linear, MeanRate::angular].map(|rate| rate(&from, &to, 0.5).value);
        // In 1,000 small steps.
        let mut now = from;
        for _ in 0..1000 {
            let half = now.rotation * exp(&(angular * 0.25e-3));
            now.translation.vector += half * linear * 0.5e-3;
            now.rotation *= exp(&(angular * 0.5e-3));
        }
        assert!((now.translation.vector - to.translation.vector).norm() < 1e-5);
        assert!(now.rotation.angle_to(&to.rotation) < 1e-7);
    }
}
