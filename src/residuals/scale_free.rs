//! A motion whose size is counted in distances from the camera:
//!
//! ```text
//! r' = r D / |t1 - C|            t1 the second of the poses, C the camera, D a distance of this size
//! dr'/dx = dr/dx D / |t1 - C| - r (t1 - C)^T D / |t1 - C|^3 on t1
//! ```
//!
//! The scale of a vehicle moves it along its rays, and its accelerations grow with it. White noise of unknown
//! strength says nothing of that scale; but of `n` rows that weigh `r^2`, a smaller scale makes all smaller,
//! and the joint minimum goes that way by `n` times the variance of the scale (the most probable values of all
//! unknowns together are not those of one of them). Counted in distances from the camera, accelerations do not
//! change with the scale, and there is nothing to gain.

use nalgebra::{Point3, SVector, Vector3};
use trackbundle_solver::manifold::{Manifold, read_pose};
use trackbundle_solver::residual::{Jacobian, Residual};

/// Blocks: poses, the second of which is where the motion is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScaleFree<R> {
    /// The motion.
    pub motion: R,
    /// The camera of the second pose.
    pub camera: Point3<f64>,
    /// About how far away it is \[m\].
    pub distance_m: f64,
}

impl<const N: usize, R: Residual<3, N>> Residual<3, N> for ScaleFree<R> {
    const MANIFOLDS: [Manifold; N] = R::MANIFOLDS;

    fn evaluate(&self, x: &[&[f64]; N], jacobian: Option<&mut Jacobian<3, N>>) -> Option<Vector3<f64>> {
        let ray = read_pose(x[1]).translation.vector - self.camera.coords;
        let distance = ray.norm().max(f64::MIN_POSITIVE);
        let factor = self.distance_m / distance;
        let Some(jacobian) = jacobian else { return Some(self.motion.evaluate(x, None)? * factor) };
        let value: SVector<f64, 3> = self.motion.evaluate(x, Some(jacobian))?;
        jacobian.0.iter_mut().for_each(|block| *block *= factor);
        let by_place = value * ray.transpose() * (-factor / (distance * distance));
        let mut block = jacobian.0[1].fixed_view_mut::<3, 3>(0, 0);
        block += by_place;
        Some(value * factor)
    }
}

#[cfg(test)]
mod tests {
    use super::super::smooth_motion::{Acceleration, Steps};
    use super::super::testing::{assert_jacobian, vehicle_poses};
    use super::*;
    use trackbundle_solver::manifold::write_pose;

    const MOTION: Acceleration = Acceleration(Steps { first_s: 0.7, second_s: 1.1 });

    #[test]
    fn the_jacobian_is_that_of_its_differences() {
        let poses = vehicle_poses().map(|p| write_pose(&p));
        let residual = ScaleFree { motion: MOTION, camera: Point3::new(3.0, 5.0, 40.0), distance_m: 35.0 };
        assert_jacobian(&residual, &[&poses[0], &poses[1], &poses[2]]);
        assert_jacobian(&residual, &[&poses[2], &poses[0], &poses[1]]);
    }

    #[test]
    fn the_scale_changes_nothing() {
        let camera = Point3::new(3.0, 5.0, 40.0);
        let residual = ScaleFree { motion: MOTION, camera, distance_m: 35.0 };
        let scaled = |by: f64| {
            let poses = vehicle_poses().map(|mut pose| {
                pose.translation.vector = camera.coords + (pose.translation.vector - camera.coords) * by;
                write_pose(&pose)
            });
            residual.evaluate(&[&poses[0], &poses[1], &poses[2]], None).unwrap()
        };
        assert!((scaled(1.1) - scaled(1.0)).norm() < 1e-12);
    }
}
