//! Smooth motion of a camera or a vehicle: how its acceleration changes over four neighbouring frames.
//!
//! ```text
//! r = (A123 - A012) / ((a + b + c)/3)                 [m/s^3, rad/s^3]
//! A012 = (V12 - V01) / ((a + b)/2)                    and so on
//! V01  = (p1 - p0) / a                                position in the world
//!      = J^-1(phi) R0^T (p1 - p0) / a                 in the axes of the body, see super::twist
//!      = phi / a,   phi = log(R0^T R1)                attitude
//! ```
//!
//! with the times `a`, `b`, `c` between them. For the position this is the third divided difference
//! times six, the jerk itself where it is constant, at any times. White noise of spectral density `q`
//! on the jerk gives it a spectral density `q` at low frequencies (the sum of its autocovariance times
//! the step), so that taken as independent it has the standard deviation `sqrt(q / h)`, `h` the mean of
//! the three times: `sqrt(q)` is the scatter of the mean jerk over one second.

use super::steps::{MeanRate, combined};
use crate::geometry::Pose;
use nalgebra::Vector3;
use trackbundle_solver::manifold::{Manifold, read_pose};
use trackbundle_solver::residual::{Jacobian, Residual};

/// The times between four neighbouring frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FourSteps {
    /// From the first to the second \[s\].
    pub first_s: f64,
    /// From the second to the third \[s\].
    pub second_s: f64,
    /// From the third to the fourth \[s\].
    pub third_s: f64,
}

impl FourSteps {
    /// Over what time the jerk is a mean \[s\].
    pub fn mean_s(&self) -> f64 {
        (self.first_s + self.second_s + self.third_s) / 3.0
    }

    /// The weights of the three mean velocities in the jerk \[1/s^2\].
    pub fn weights(&self) -> [f64; 3] {
        let mean_s = self.mean_s();
        let before = 2.0 / ((self.first_s + self.second_s) * mean_s);
        let after = 2.0 / ((self.second_s + self.third_s) * mean_s);
        [before, -(before + after), after]
    }

    fn evaluate(
        &self,
        x: &[&[f64]; 4],
        rate: impl Fn(&Pose, &Pose, f64) -> MeanRate,
        jacobian: Option<&mut Jacobian<3, 4>>,
    ) -> Vector3<f64> {
        let [t0, t1, t2, t3] = x.map(read_pose);
        let rates =
            [rate(&t0, &t1, self.first_s), rate(&t1, &t2, self.second_s), rate(&t2, &t3, self.third_s)];
        combined(&rates, &self.weights(), jacobian)
    }
}

/// Of the position in the world. Blocks: four poses in time order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Jerk(
    /// The times between them.
    pub FourSteps,
);

/// Of the position in the axes of the body, zero in a steady curve. Blocks: four poses in time order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinearJerk(
    /// The times between them.
    pub FourSteps,
);

/// Of the attitude. Blocks: four poses in time order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AngularJerk(
    /// The times between them.
    pub FourSteps,
);

impl Residual<3, 4> for Jerk {
    const MANIFOLDS: [Manifold; 4] = [Manifold::Pose; 4];

    fn evaluate(&self, x: &[&[f64]; 4], jacobian: Option<&mut Jacobian<3, 4>>) -> Option<Vector3<f64>> {
        Some(self.0.evaluate(x, MeanRate::of_position, jacobian))
    }
}

impl Residual<3, 4> for LinearJerk {
    const MANIFOLDS: [Manifold; 4] = [Manifold::Pose; 4];

    fn evaluate(&self, x: &[&[f64]; 4], jacobian: Option<&mut Jacobian<3, 4>>) -> Option<Vector3<f64>> {
        Some(self.0.evaluate(x, MeanRate::linear, jacobian))
    }
}

impl Residual<3, 4> for AngularJerk {
    const MANIFOLDS: [Manifold; 4] = [Manifold::Pose; 4];

    fn evaluate(&self, x: &[&[f64]; 4], jacobian: Option<&mut Jacobian<3, 4>>) -> Option<Vector3<f64>> {
        Some(self.0.evaluate(x, MeanRate::angular, jacobian))
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{assert_jacobian, steady_curve, vehicle_poses};
    use super::*;
    use crate::geometry::{pose, rotation::exp};
    use trackbundle_solver::manifold::write_pose;

    const STEPS: FourSteps = FourSteps { first_s: 0.7, second_s: 1.1, third_s: 0.9 };
    const TIMES: [f64; 4] = [0.0, 0.7, 1.8, 2.7];

    #[test]
    fn the_jacobian_is_that_of_its_differences() {
        let poses = vehicle_poses().map(|p| write_pose(&p));
        for (i, j, k, l) in [(0, 1, 2, 0), (2, 0, 1, 1), (1, 2, 0, 2), (0, 0, 0, 0)] {
            let x = [poses[i].as_slice(), &poses[j], &poses[k], &poses[l]];
            assert_jacobian(&Jerk(STEPS), &x);
            assert_jacobian(&LinearJerk(STEPS), &x);
            assert_jacobian(&AngularJerk(STEPS), &x);
        }
    }

    #[test]
    fn constant_jerk_is_found_at_uneven_times() {
        let (jerk, turn) = (Vector3::new(0.5, -2.0, 0.1), Vector3::z() * 0.1);
        let at = |t: f64, turn: Vector3<f64>| -> [f64; 7] {
            let start = pose([1.0, 2.0, 3.0], [0.9, 0.1, 0.0, 0.3]);
            let moved = Vector3::new(8.0, 1.0, 0.0) * t + Vector3::y() * (t * t) + jerk * (t.powi(3) / 6.0);
            let moved = start.translation.vector + start.rotation * moved;
            let turned = start.rotation * exp(&(turn * (t.powi(3) / 6.0)));
            write_pose(&Pose::from_parts(moved.into(), turned))
        };
        let rotation = pose([0.0; 3], [0.9, 0.1, 0.0, 0.3]).rotation;
        let x = TIMES.map(|t| at(t, turn));
        let x = [x[0].as_slice(), &x[1], &x[2], &x[3]];
        assert!((Jerk(STEPS).evaluate(&x, None).unwrap() - rotation * jerk).norm() < 1e-12);
        assert!((AngularJerk(STEPS).evaluate(&x, None).unwrap() - turn).norm() < 1e-12);
        let x = TIMES.map(|t| at(t, Vector3::zeros()));
        let x = [x[0].as_slice(), &x[1], &x[2], &x[3]];
        assert!((LinearJerk(STEPS).evaluate(&x, None).unwrap() - jerk).norm() < 1e-12);
    }

    #[test]
    fn a_steady_curve_has_no_jerk_in_its_own_axes() {
        let curve = steady_curve(&TIMES);
        let x = [curve[0].as_slice(), &curve[1], &curve[2], &curve[3]];
        assert!(LinearJerk(STEPS).evaluate(&x, None).unwrap().norm() < 1e-12);
        assert!(AngularJerk(STEPS).evaluate(&x, None).unwrap().norm() < 1e-12);
        assert!(Jerk(STEPS).evaluate(&x, None).unwrap().norm() > 0.5);
    }

    #[test]
    fn white_jerk_makes_it_as_strong_at_low_frequencies() {
        // Of the position of a path whose jerk is white noise of density 1: the integral of
        // (s - u)^2/2 (t - u)^2/2 up to the earlier time, in closed form.
        let covariance = |s: f64, t: f64| {
            let (m, d) = (s.min(t), (s - t).abs());
            (m.powi(5) / 5.0 + m.powi(4) * d / 2.0 + m.powi(3) * d * d / 3.0) / 4.0
        };
        const H: f64 = 0.04;
        let steps = FourSteps { first_s: H, second_s: H, third_s: H };
        // What the residual is of four positions.
        let weights: [f64; 4] = std::array::from_fn(|one| {
            let x = [0, 1, 2, 3]
                .map(|k| write_pose(&pose([f64::from(u8::from(k == one)), 0.0, 0.0], [1.0, 0.0, 0.0, 0.0])));
            Jerk(steps).evaluate(&[&x[0], &x[1], &x[2], &x[3]], None).unwrap().x
        });
        let lagged = |lag: usize| -> f64 {
            (0..16)
                .map(|k| {
                    let (i, j) = (k / 4, k % 4);
                    let (s, t) = (H * (1 + i) as f64, H * (1 + j + lag) as f64);
                    weights[i] * weights[j] * covariance(s, t)
                })
                .sum::<f64>()
                * H
        };
        let sum = lagged(0) + 2.0 * (lagged(1) + lagged(2));
        assert!((sum - 1.0).abs() < 1e-9, "{sum}");
        assert!((lagged(0) - 0.55).abs() < 1e-9 && lagged(3).abs() < 1e-9, "{}", lagged(0));
    }
}
