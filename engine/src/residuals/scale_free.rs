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
//!
//! Where nothing but its own poses holds the camera, it is an unknown that takes part in this, in two ways. The world
//! becomes smaller as a whole when the camera sinks: the distance must be that from where the camera is. And what moves
//! an image point may be put down to the vehicle or to the camera, which costs the less, counted in metres, the nearer
//! the vehicle is. So the motion of the camera is counted in the same distances:
//!
//! ```text
//! r' = r D / |t1 - t|       t1 the place of the second pose, t that of the other body, dr'/dt = r (t1 - t)^T D / |t1 - t|^3
//! ```

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

/// Blocks: poses, the second of which is where the motion is, and the pose of the other body there: of the camera that
/// sees a vehicle, of a vehicle that a camera sees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScaleFreeSeen<R> {
    /// The motion.
    pub motion: R,
    /// About how far away it is \[m\].
    pub distance_m: f64,
}

/// The poses of a motion with one more block after them.
macro_rules! seen_motion {
    ($poses:literal, $blocks:literal) => {
        impl<R: Residual<3, $poses>> Residual<3, $blocks> for ScaleFreeSeen<R> {
            const MANIFOLDS: [Manifold; $blocks] = [Manifold::Pose; $blocks];

            fn evaluate(
                &self,
                x: &[&[f64]; $blocks],
                jacobian: Option<&mut Jacobian<3, $blocks>>,
            ) -> Option<Vector3<f64>> {
                let poses: [&[f64]; $poses] = std::array::from_fn(|at| x[at]);
                let camera = read_pose(x[$poses]).translation.vector;
                let ray = read_pose(x[1]).translation.vector - camera;
                let distance = ray.norm().max(f64::MIN_POSITIVE);
                let factor = self.distance_m / distance;
                let Some(jacobian) = jacobian else {
                    return Some(self.motion.evaluate(&poses, None)? * factor);
                };
                let mut of_motion = Jacobian::zeros();
                let value: SVector<f64, 3> = self.motion.evaluate(&poses, Some(&mut of_motion))?;
                for (at, block) in of_motion.0.iter().enumerate() {
                    jacobian.0[at] = block * factor;
                }
                let by_place = value * ray.transpose() * (-factor / (distance * distance));
                let mut block = jacobian.0[1].fixed_view_mut::<3, 3>(0, 0);
                block += by_place;
                jacobian.set($poses, 0, &-by_place);
                Some(value * factor)
            }
        }
    };
}

seen_motion!(3, 4);
seen_motion!(4, 5);

#[cfg(test)]
mod tests {
    use super::super::jerk::{FourSteps, LinearJerk};
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
    fn the_jacobians_by_the_camera_are_those_of_their_differences() {
        let poses = vehicle_poses().map(|p| write_pose(&p));
        let camera = write_pose(&crate::geometry::pose([3.0, 5.0, 40.0], [0.1, 0.9, 0.0, 0.3]));
        let residual = ScaleFreeSeen { motion: MOTION, distance_m: 35.0 };
        assert_jacobian(&residual, &[&poses[0], &poses[1], &poses[2], &camera]);
        let steps = FourSteps { first_s: 0.7, second_s: 1.1, third_s: 0.9 };
        let residual = ScaleFreeSeen { motion: LinearJerk(steps), distance_m: 35.0 };
        assert_jacobian(&residual, &[&poses[0], &poses[1], &poses[2], &poses[1], &camera]);
    }

    #[test]
    fn a_smaller_world_changes_nothing() {
        let scaled = |by: f64| {
            let of = |mut pose: crate::geometry::Pose| {
                pose.translation.vector *= by;
                write_pose(&pose)
            };
            let camera = of(crate::geometry::pose([3.0, 5.0, 40.0], [0.1, 0.9, 0.0, 0.3]));
            let poses = vehicle_poses().map(of);
            let seen = ScaleFreeSeen { motion: MOTION, distance_m: 35.0 };
            seen.evaluate(&[&poses[0], &poses[1], &poses[2], &camera], None).unwrap()
        };
        let (one, other) = (scaled(1.0), scaled(0.7));
        assert!((one - other).norm() < 1e-12 && one.norm() > 0.1);
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
