//! Contact of a vehicle with the ground \[m, rad\]:
//!
//! ```text
//! h(T) = [ z - terrain(x, y) - bias ]     height of the body's origin above the ground
//!        [ (R^T n)_x ]                    lean of the body's z axis from the normal n of the
//!        [ (R^T n)_y ]                    ground: pitch and roll against the slope
//!
//! first frame      r = h(T0)
//! every next one   r = h(Tt) - c h(Tt-1),   c = exp(-(time between) / (correlation time))
//! ```
//!
//! An error of the ground lasts: with standard deviation `s` and correlation time `tau` it is a
//! first-order Gauss-Markov process, and `h(Tt) - c h(Tt-1)` is its innovation, independent of all
//! others, of standard deviation `s sqrt(1 - c^2)`. Taken as independent, the 150 frames of five
//! seconds would hold the scale five times too well.
//!
//! A contact is declared where the ground is known around a pose. A step of the minimiser may lead beyond its border
//! all the same; there the ground goes on from where it is known ([`Terrain::footing_at`]), since a residual that
//! comes and goes makes the cost jump. A pose some metres beyond has no residual. Neither do the edges between cells
//! make it jump, and of a fine and noisy grid the surface is that of local fits ([`Terrain::footing_at`]).

use crate::geometry::Pose;
use crate::terrain::Terrain;
use nalgebra::{Matrix3x6, Vector3};
use trackbundle_solver::manifold::{Manifold, read_pose};
use trackbundle_solver::residual::{Jacobian, Residual};

/// First contact of a vehicle. Blocks: its pose, the bias of the terrain \[m\].
#[derive(Clone, Debug, PartialEq)]
pub struct FirstContact {
    /// The ground.
    pub terrain: Terrain,
}

/// Every next contact. Blocks: the pose, the pose before, the bias of the terrain \[m\].
#[derive(Clone, Debug, PartialEq)]
pub struct NextContact {
    /// The ground.
    pub terrain: Terrain,
    /// Correlation of the error with that of the contact before, in \[0, 1).
    pub correlation: f64,
}

impl NextContact {
    /// A contact that follows another after `step_s`, of an error that lasts `correlation_s` (zero:
    /// each for itself), and by what the standard deviations of a first contact are multiplied.
    pub fn after(terrain: Terrain, step_s: f64, correlation_s: f64) -> (Self, f64) {
        if correlation_s == 0.0 {
            return (NextContact { terrain, correlation: 0.0 }, 1.0);
        }
        let ratio = step_s / correlation_s;
        // 1 - c^2, also where c is nearly 1.
        let innovation = (-(-2.0 * ratio).exp_m1()).sqrt().max(1e-9);
        (NextContact { terrain, correlation: (-ratio).exp() }, innovation)
    }
}

/// `h` and its derivative by the pose; `None` where there is no ground.
fn deviation(terrain: &Terrain, pose: &Pose, bias_m: f64) -> Option<(Vector3<f64>, Matrix3x6<f64>)> {
    let position = pose.translation.vector;
    let ground = terrain.footing_at(position.x, position.y)?;
    let normal = pose.rotation.inverse_transform_vector(&ground.normal());
    let value = Vector3::new(position.z - ground.height_m - bias_m, normal.x, normal.y);
    let mut jacobian = Matrix3x6::zeros();
    jacobian[(0, 0)] = -ground.slope.x;
    jacobian[(0, 1)] = -ground.slope.y;
    jacobian[(0, 2)] = 1.0;
    let body_from_world = pose.rotation.to_rotation_matrix().inverse();
    let by_place = body_from_world.matrix() * ground.normal_by_place();
    jacobian.fixed_view_mut::<2, 2>(1, 0).copy_from(&by_place.fixed_view::<2, 2>(0, 0));
    // d (R exp(r))^T n = [R^T n]x r
    let turned = crate::geometry::skew(&normal);
    jacobian.fixed_view_mut::<2, 3>(1, 3).copy_from(&turned.fixed_view::<2, 3>(0, 0));
    Some((value, jacobian))
}

impl Residual<3, 2> for FirstContact {
    const MANIFOLDS: [Manifold; 2] = [Manifold::Pose, Manifold::SCALAR];

    fn evaluate(&self, x: &[&[f64]; 2], jacobian: Option<&mut Jacobian<3, 2>>) -> Option<Vector3<f64>> {
        let (value, by_pose) = deviation(&self.terrain, &read_pose(x[0]), x[1][0])?;
        if let Some(jacobian) = jacobian {
            jacobian.set(0, 0, &by_pose);
            jacobian.set(1, 0, &-Vector3::x());
        }
        Some(value)
    }
}

impl Residual<3, 3> for NextContact {
    const MANIFOLDS: [Manifold; 3] = [Manifold::Pose, Manifold::Pose, Manifold::SCALAR];

    fn evaluate(&self, x: &[&[f64]; 3], jacobian: Option<&mut Jacobian<3, 3>>) -> Option<Vector3<f64>> {
        let (value, by_pose) = deviation(&self.terrain, &read_pose(x[0]), x[2][0])?;
        let (before, by_before) = deviation(&self.terrain, &read_pose(x[1]), x[2][0])?;
        if let Some(jacobian) = jacobian {
            jacobian.set(0, 0, &by_pose);
            jacobian.set(1, 0, &(-self.correlation * by_before));
            jacobian.set(2, 0, &(Vector3::x() * (self.correlation - 1.0)));
        }
        Some(value - self.correlation * before)
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{assert_jacobian, vehicle_poses};
    use super::*;
    use crate::terrain::tests::hills;
    use trackbundle_solver::manifold::write_pose;

    const LEVEL: Terrain = Terrain::Plane { z_m: 0.7 };

    #[test]
    fn the_jacobian_is_that_of_its_differences() {
        for terrain in [LEVEL, hills()] {
            for pose in vehicle_poses() {
                let residual = FirstContact { terrain: terrain.clone() };
                assert_jacobian(&residual, &[&write_pose(&off_knots(&pose)), &[0.3]]);
                for before in vehicle_poses() {
                    let residual = NextContact { terrain: terrain.clone(), correlation: 0.9 };
                    let (pose, before) = (write_pose(&off_knots(&pose)), write_pose(&off_knots(&before)));
                    assert_jacobian(&residual, &[&pose, &before, &[0.3]]);
                }
            }
        }
    }

    /// Moved away from where the third derivatives of the ground jump, which differences would see.
    fn off_knots(pose: &Pose) -> Pose {
        nalgebra::Translation3::new(0.37, 0.29, 0.0) * pose
    }

    #[test]
    fn a_vehicle_far_off_the_grid_has_no_residual() {
        let at = |x: f64| write_pose(&crate::geometry::pose([x, 6.0, 0.7], [1.0, 0.0, 0.0, 0.0]));
        let first = FirstContact { terrain: hills() };
        assert!(first.evaluate(&[&at(20.1), &[0.0]], None).is_some());
        assert!(first.evaluate(&[&at(26.1), &[0.0]], None).is_none());
        let next = NextContact { terrain: hills(), correlation: 0.9 };
        assert!(next.evaluate(&[&at(26.1), &at(19.9), &[0.0]], None).is_none());
        assert!(next.evaluate(&[&at(19.9), &at(26.1), &[0.0]], None).is_none());
    }

    /// What a step across the border of the grid changes is what the same step changes inside it.
    #[test]
    fn a_vehicle_crosses_the_border_of_the_grid_without_a_jump() {
        let first = FirstContact { terrain: hills() };
        let at = |x: f64| {
            let pose = write_pose(&crate::geometry::pose([x, 6.3, 0.7], [1.0, 0.0, 0.0, 0.0]));
            first.evaluate(&[&pose, &[0.0]], None).unwrap()
        };
        let step = 1e-6;
        let (inside, across) =
            (at(20.0 - 0.5 * step) - at(20.0 - 1.5 * step), at(20.0 + 0.5 * step) - at(20.0 - 0.5 * step));
        assert!((inside - across).norm() < 1e-9, "{inside} {across}");
    }

    #[test]
    fn a_vehicle_that_stands_on_the_ground_has_no_residual() {
        let level = crate::geometry::pose([5.0, 6.0, 0.7], [0.3, 0.0, 0.0, 0.9]);
        let residual = FirstContact { terrain: LEVEL };
        let found = residual.evaluate(&[&write_pose(&level), &[0.0]], None).unwrap();
        assert!(found.norm() < 1e-15);
    }

    /// Second road: the information about a common height from innovations is that of the dense
    /// covariance of a Gauss-Markov process.
    #[test]
    fn innovations_whiten_the_process() {
        let (sigma, tau, step, count) = (0.02, 1.0, 1.0 / 30.0, 60);
        let covariance = nalgebra::DMatrix::from_fn(count, count, |i, j| {
            sigma * sigma * (-(i as f64 - j as f64).abs() * step / tau).exp()
        });
        let ones = nalgebra::DVector::repeat(count, 1.0);
        let dense = ones.dot(&covariance.cholesky().unwrap().solve(&ones));
        let (next, innovation) = NextContact::after(LEVEL, step, tau);
        let innovation = (1.0 - next.correlation) / (sigma * innovation);
        let sequential = 1.0 / (sigma * sigma) + (count - 1) as f64 * innovation * innovation;
        assert!((dense - sequential).abs() < 1e-9 * dense);
    }
}
