//! The rear axle of a road vehicle rolls where it points \[m/s\]:
//!
//! ```text
//! r = nu_y + a w_z - beta nu_x
//! nu = J^-1(phi) R0^T (p1 - p0) / h,   w = phi / h,   phi = log(R0^T R1)
//! ```
//!
//! with the mean twist `[nu; w]` between two neighbouring frames, the place `a` of the rear axle along
//! the body's x axis \[m\], and the direction `beta` in which the axle rolls, counter-clockwise from
//! the body's x axis \[rad\], small. Source of the constraint: the single-track model, Riekert and
//! Schunck, *Zur Fahrmechanik des gummibereiften Kraftfahrzeugs*, Ingenieur-Archiv 11 (1940), without
//! slip of the rear tyre.

use super::steps::MeanRate;
use nalgebra::{Vector1, Vector2};
use trackbundle_solver::manifold::{Manifold, read_pose};
use trackbundle_solver::residual::{Jacobian, Residual};

/// Blocks: the pose of a vehicle, its next pose, `[a, beta]` \[m, rad\].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NoSideSlip {
    /// The time between the poses \[s\].
    pub step_s: f64,
}

impl Residual<1, 3> for NoSideSlip {
    const MANIFOLDS: [Manifold; 3] = [Manifold::Pose, Manifold::Pose, Manifold::Vector(2)];

    fn evaluate(&self, x: &[&[f64]; 3], jacobian: Option<&mut Jacobian<1, 3>>) -> Option<Vector1<f64>> {
        let (from, to) = (read_pose(x[0]), read_pose(x[1]));
        let (axle, beta) = (x[2][0], x[2][1]);
        let linear = MeanRate::linear(&from, &to, self.step_s);
        let angular = MeanRate::angular(&from, &to, self.step_s);
        if let Some(jacobian) = jacobian {
            for (block, linear, angular) in
                [(0, linear.by_first, angular.by_first), (1, linear.by_second, angular.by_second)]
            {
                jacobian.set(block, 0, &(linear.row(1) + axle * angular.row(2) - beta * linear.row(0)));
            }
            jacobian.set(2, 0, &Vector2::new(angular.value.z, -linear.value.x).transpose());
        }
        Some(Vector1::new(linear.value.y + axle * angular.value.z - beta * linear.value.x))
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{assert_jacobian, vehicle_poses};
    use super::*;
    use crate::geometry::{Pose, pose, rotation::exp};
    use nalgebra::Vector3;
    use trackbundle_solver::manifold::write_pose;

    const RESIDUAL: NoSideSlip = NoSideSlip { step_s: 0.4 };

    #[test]
    fn the_jacobian_is_that_of_its_differences() {
        let poses = vehicle_poses().map(|p| write_pose(&p));
        for (i, j) in [(0, 1), (1, 2), (2, 0), (1, 1)] {
            assert_jacobian(&RESIDUAL, &[&poses[i], &poses[j], &[-1.4, 0.03]]);
        }
    }

    /// Body poses 0.4 s apart of a car whose rear axle drives a circle at 8 m/s and 0.6 rad/s, and
    /// whose body stands `beta` to the right of the direction in which the axle rolls.
    fn circle(axle: f64, beta: f64) -> [[f64; 7]; 2] {
        [0.0, 0.4].map(|t: f64| {
            let course = 0.3 + 0.6 * t;
            let rear = Vector3::new(course.sin(), -course.cos(), 0.0) * (8.0 / 0.6);
            let attitude = exp(&(Vector3::z() * (course - beta)));
            let lean = pose([2.0, 5.0, 1.0], [0.99, 0.03, -0.06, 0.2]);
            write_pose(&(lean * Pose::from_parts((rear - attitude * Vector3::x() * axle).into(), attitude)))
        })
    }

    #[test]
    fn a_rolling_axle_does_not_slip() {
        let at = |poses: &[[f64; 7]; 2], axle: f64, beta: f64| {
            RESIDUAL.evaluate(&[&poses[0], &poses[1], &[axle, beta]], None).unwrap().x
        };
        assert!(at(&circle(-1.4, 0.0), -1.4, 0.0).abs() < 1e-12);
        // The residual is linear in beta: tan(beta) makes it exact.
        let skewed = circle(-1.4, 0.03);
        assert!(at(&skewed, -1.4, 0.03_f64.tan()).abs() < 1e-12);
        assert!((at(&skewed, -1.4, 0.0) - 8.0 * 0.03_f64.sin()).abs() < 1e-12, "{}", at(&skewed, -1.4, 0.0));
        assert!((at(&skewed, -0.4, 0.03_f64.tan()) - 0.6).abs() < 1e-12, "an axle 1 m off");
    }
}
