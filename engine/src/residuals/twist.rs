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

use super::steps::{MeanRate, Steps};
use nalgebra::Vector3;
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

#[cfg(test)]
mod tests {
    use super::super::smooth_motion::{Acceleration, AngularAcceleration};
    use super::super::testing::{assert_jacobian, steady_curve, vehicle_poses};
    use super::*;
    use crate::geometry::{Pose, pose, rotation::exp};
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
