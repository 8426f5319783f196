//! Smooth motion of a camera or a vehicle: its acceleration over three neighbouring frames.
//!
//! ```text
//! position   r = ((p2 - p1)/b - (p1 - p0)/a) / ((a + b)/2)                      [m/s^2]
//! attitude   r = (log(R1^T R2)/b - log(R0^T R1)/a) / ((a + b)/2)                [rad/s^2]
//! ```
//!
//! with the times `a`, `b` between them. White noise of spectral density `q` on the acceleration
//! makes its mean over a time `h` scatter by `sqrt(q / h)`, so that a prior of one strength fits any
//! frame rate, irregular times and gaps. `sqrt(q)` is the scatter of the mean over one second.

use super::steps::MeanRate;
pub use super::steps::Steps;
use nalgebra::Vector3;
use trackbundle_solver::manifold::Manifold;
use trackbundle_solver::residual::{Jacobian, Residual};

/// Blocks: three poses in time order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Acceleration(
    /// The times between them.
    pub Steps,
);

/// Blocks: three poses in time order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AngularAcceleration(
    /// The times between them.
    pub Steps,
);

impl Residual<3, 3> for Acceleration {
    const MANIFOLDS: [Manifold; 3] = [Manifold::Pose; 3];

    fn evaluate(&self, x: &[&[f64]; 3], jacobian: Option<&mut Jacobian<3, 3>>) -> Option<Vector3<f64>> {
        Some(self.0.evaluate(x, MeanRate::of_position, jacobian))
    }
}

impl Residual<3, 3> for AngularAcceleration {
    const MANIFOLDS: [Manifold; 3] = [Manifold::Pose; 3];

    fn evaluate(&self, x: &[&[f64]; 3], jacobian: Option<&mut Jacobian<3, 3>>) -> Option<Vector3<f64>> {
        Some(self.0.evaluate(x, MeanRate::angular, jacobian))
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{assert_jacobian, vehicle_poses};
    use super::*;
    use crate::geometry::{Pose, pose, rotation::exp};
    use trackbundle_solver::manifold::write_pose;

    const STEPS: Steps = Steps { first_s: 0.7, second_s: 1.1 };

    #[test]
    fn the_jacobian_is_that_of_its_differences() {
        let poses = vehicle_poses().map(|p| write_pose(&p));
        for (i, j, k) in [(0, 1, 2), (2, 0, 1), (1, 2, 0), (0, 0, 1), (2, 2, 2)] {
            let x = [poses[i].as_slice(), &poses[j], &poses[k]];
            assert_jacobian(&Acceleration(STEPS), &x);
            assert_jacobian(&AngularAcceleration(STEPS), &x);
        }
    }

    #[test]
    fn constant_acceleration_is_found_at_uneven_times() {
        let (acceleration, turn) = (Vector3::new(0.5, -2.0, 0.1), Vector3::z() * 0.3);
        let at = |time: f64| -> [f64; 7] {
            let start = pose([1.0, 2.0, 3.0], [0.9, 0.1, 0.0, 0.3]);
            let moved = Vector3::new(8.0, 1.0, 0.0) * time + acceleration * (0.5 * time * time);
            write_pose(&Pose::from_parts(
                (start.translation.vector + moved).into(),
                start.rotation * exp(&(turn * (0.5 * time * time))),
            ))
        };
        let x = (at(0.0), at(0.7), at(1.8));
        let x = [x.0.as_slice(), &x.1, &x.2];
        let found = Acceleration(STEPS).evaluate(&x, None).unwrap();
        assert!((found - acceleration).norm() < 1e-12);
        let found = AngularAcceleration(STEPS).evaluate(&x, None).unwrap();
        assert!((found - turn).norm() < 1e-12);
    }
}
