//! SE(3): exponential and logarithm of a twist `[v; w]` (linear \[m\], angular \[rad\]).
//!
//! ```text
//! exp([v; w]) = (exp(w), V(w) v)      V(w) the left Jacobian of SO(3)
//! ```
//!
//! Source: Barfoot, *State Estimation for Robotics*, 2017, chapter 7.

use super::rotation::{self, right_jacobian_inverse};
use super::{Pose, skew};
use nalgebra::{Matrix3, Vector3, Vector6};

/// Below this angle \[rad\] the series is exact to the last bit.
const SMALL_ANGLE: f64 = 1e-3;

/// The left Jacobian of SO(3).
fn left_jacobian(phi: &Vector3<f64>) -> Matrix3<f64> {
    let angle = phi.norm();
    let square = angle * angle;
    let (first, second) = if angle < SMALL_ANGLE {
        (0.5 - square / 24.0, 1.0 / 6.0 - square / 120.0)
    } else {
        ((1.0 - angle.cos()) / square, (angle - angle.sin()) / (square * angle))
    };
    let cross = skew(phi);
    Matrix3::identity() + first * cross + second * cross * cross
}

/// The rigid transform that a twist makes.
pub fn exp(twist: &Vector6<f64>) -> Pose {
    let (v, w): (Vector3<f64>, Vector3<f64>) =
        (twist.fixed_rows::<3>(0).into(), twist.fixed_rows::<3>(3).into());
    Pose::from_parts((left_jacobian(&w) * v).into(), rotation::exp(&w))
}

/// The twist of a rigid transform that turns by less than pi.
pub fn log(transform: &Pose) -> Vector6<f64> {
    let w = rotation::log(&transform.rotation);
    let v = right_jacobian_inverse(&-w) * transform.translation.vector;
    let mut twist = Vector6::zeros();
    twist.fixed_rows_mut::<3>(0).copy_from(&v);
    twist.fixed_rows_mut::<3>(3).copy_from(&w);
    twist
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn log_undoes_exp() {
        for angle in [0.0, 1e-9, 0.9e-3, 1.1e-3, 0.3, 2.0, 3.1] {
            let w = Vector3::new(0.3, -0.5, 0.7).normalize() * angle;
            let twist = Vector6::new(3.0, -1.0, 0.5, w.x, w.y, w.z);
            let back = log(&exp(&twist));
            assert!((back - twist).norm() < 1e-11, "{angle}: {back}");
        }
    }

    /// Second road: many small steps.
    #[test]
    fn a_twist_is_a_steady_motion() {
        let twist = Vector6::new(3.0, -1.0, 0.5, 0.2, 0.4, -1.1);
        let mut pose = Pose::identity();
        let steps = 100_000;
        for _ in 0..steps {
            let small = twist / f64::from(steps);
            let turn = rotation::exp(&small.fixed_rows::<3>(3).into());
            pose *= Pose::from_parts(Vector3::from(small.fixed_rows::<3>(0)).into(), turn);
        }
        let whole = exp(&twist);
        assert!((pose.translation.vector - whole.translation.vector).norm() < 1e-4);
        assert!(pose.rotation.angle_to(&whole.rotation) < 1e-9);
    }
}
