//! Starting pose of a camera or a vehicle \[m, rad\]:
//!
//! ```text
//! r = [ A^T (t - t0) ; log(R0^T R) ]
//! ```
//!
//! the position along the columns of `A`, the attitude about the axes of the body.

use crate::geometry::Pose;
use nalgebra::{Matrix6, Rotation3, Vector6};
use trackbundle_solver::manifold::{Manifold, pose_minus, pose_minus_jacobian, read_pose};
use trackbundle_solver::residual::{Jacobian, Residual};

/// Block: a pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PosePrior {
    /// What it was before the adjustment.
    pub start: Pose,
    /// The directions, in the world, along which its position has the standard deviations given.
    pub axes: Rotation3<f64>,
}

impl Residual<6, 1> for PosePrior {
    const MANIFOLDS: [Manifold; 1] = [Manifold::Pose];

    fn evaluate(&self, x: &[&[f64]; 1], jacobian: Option<&mut Jacobian<6, 1>>) -> Option<Vector6<f64>> {
        let pose = read_pose(x[0]);
        let mut turn = Matrix6::identity();
        turn.fixed_view_mut::<3, 3>(0, 0).copy_from(self.axes.inverse().matrix());
        if let Some(jacobian) = jacobian {
            jacobian.set(0, 0, &(turn * pose_minus_jacobian(&pose, &self.start)));
        }
        Some(turn * pose_minus(&pose, &self.start))
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{assert_jacobian, camera_poses, vehicle_poses};
    use super::*;
    use trackbundle_solver::manifold::write_pose;

    #[test]
    fn the_jacobian_is_that_of_its_differences() {
        for start in camera_poses().into_iter().chain(vehicle_poses()) {
            for turn in [0.0, 1e-6, 0.02, 2.5] {
                let mut moved = [0.0; 7];
                let delta = [0.3, -0.2, 0.1, 0.6 * turn, -0.48 * turn, 0.64 * turn];
                Manifold::Pose.plus(&write_pose(&start), &delta, &mut moved);
                let axes = Rotation3::from_euler_angles(0.3, -0.2, 1.0);
                let prior = PosePrior { start, axes };
                assert_jacobian(&prior, &[&moved]);
                let found = prior.evaluate(&[&moved], None).unwrap();
                let position = axes * found.fixed_rows::<3>(0);
                assert!((position - Vector6::from(delta).fixed_rows::<3>(0)).norm() < 1e-12);
                let attitude = found.fixed_rows::<3>(3) - Vector6::from(delta).fixed_rows::<3>(3);
                assert!(attitude.norm() < 1e-12);
            }
        }
    }
}
