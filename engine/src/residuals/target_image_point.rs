//! Image point of a target \[px\]:
//!
//! ```text
//! X = Rc^T (G - tc)                  the target in the camera frame
//! r = (u, v) - project(X)            observed minus computed
//!
//! dr/dG  = -P Rc^T                   P = d project / dX, 2 x 3
//! dr/dtc =  P Rc^T                   dr/drc = -P [X]x
//! ```

use crate::camera::Camera;
use crate::geometry::skew;
use nalgebra::Vector2;
use std::sync::Arc;
use trackbundle_solver::manifold::{Manifold, read_point, read_pose};
use trackbundle_solver::residual::{Jacobian, Residual};

/// Blocks: camera pose, target in the world.
#[derive(Clone, Debug)]
pub struct TargetImagePoint {
    /// The camera that saw it.
    pub camera: Arc<Camera>,
    /// Where it was seen \[px\].
    pub observed_px: Vector2<f64>,
}

impl Residual<2, 2> for TargetImagePoint {
    const MANIFOLDS: [Manifold; 2] = [Manifold::Pose, Manifold::POINT];

    fn evaluate(&self, x: &[&[f64]; 2], jacobian: Option<&mut Jacobian<2, 2>>) -> Option<Vector2<f64>> {
        let world_from_camera = read_pose(x[0]);
        let in_camera = world_from_camera.inverse_transform_point(&read_point(x[1])).coords;
        let Some(jacobian) = jacobian else {
            return Some(self.observed_px - self.camera.project(&in_camera)?);
        };
        let (computed_px, by_camera_point) = self.camera.project_with_jacobian(&in_camera)?;
        let camera_from_world = world_from_camera.rotation.inverse().to_rotation_matrix();
        let by_world = by_camera_point * camera_from_world.matrix();
        jacobian.set(0, 0, &by_world);
        jacobian.set(0, 3, &-(by_camera_point * skew(&in_camera)));
        jacobian.set(1, 0, &-by_world);
        Some(self.observed_px - computed_px)
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{assert_jacobian, camera_poses};
    use super::*;
    use crate::camera::tests::cameras;
    use trackbundle_solver::manifold::write_pose;

    #[test]
    fn the_jacobian_is_that_of_its_differences() {
        for camera in cameras() {
            let residual =
                TargetImagePoint { camera: Arc::new(camera), observed_px: Vector2::new(2000.0, 300.0) };
            for pose in camera_poses() {
                for target in [[0.0, 0.0, 0.0], [14.0, -9.0, 0.4], [-25.0, 12.0, -1.0]] {
                    assert_jacobian(&residual, &[&write_pose(&pose), &target]);
                }
            }
        }
    }
}
