//! Image point of a vehicle point \[px\]:
//!
//! ```text
//! X = Rc^T (Rv M + tv - tc)          the point in the camera frame
//! r = (u, v) - project(X)            observed minus computed
//!
//! dr/dM  = -P Rc^T Rv                P = d project / dX, 2 x 3
//! dr/dtv = -P Rc^T                   dr/drv =  P Rc^T Rv [M]x
//! dr/dtc =  P Rc^T                   dr/drc = -P [X]x
//! ```
//!
//! It is equations (1), (7) and (8) of the seed paper without their algebraic scale: both rows, here
//! divided by the depth.

use crate::camera::Camera;
use crate::geometry::skew;
use nalgebra::{Matrix2x3, Vector2};
use std::sync::Arc;
use trackbundle_solver::manifold::{Manifold, read_point, read_pose};
use trackbundle_solver::residual::{Jacobian, Residual};

/// Blocks: camera pose, vehicle pose, point in the vehicle frame.
#[derive(Clone, Debug)]
pub struct VehicleImagePoint {
    /// The camera that saw it.
    pub camera: Arc<Camera>,
    /// Where it was seen \[px\].
    pub observed_px: Vector2<f64>,
}

impl Residual<2, 3> for VehicleImagePoint {
    const MANIFOLDS: [Manifold; 3] = [Manifold::Pose, Manifold::Pose, Manifold::POINT];

    #[inline(always)]
    fn evaluate(&self, x: &[&[f64]; 3], jacobian: Option<&mut Jacobian<2, 3>>) -> Option<Vector2<f64>> {
        let (world_from_camera, world_from_vehicle) = (read_pose(x[0]), read_pose(x[1]));
        let in_vehicle = read_point(x[2]);
        let in_world = world_from_vehicle * in_vehicle;
        let in_camera = world_from_camera.inverse_transform_point(&in_world).coords;
        let Some(jacobian) = jacobian else {
            return Some(self.observed_px - self.camera.project(&in_camera)?);
        };
        let (computed_px, by_camera_point) = self.camera.project_with_jacobian(&in_camera)?;
        let camera_from_world = world_from_camera.rotation.inverse().to_rotation_matrix();
        let by_world: Matrix2x3<f64> = by_camera_point * camera_from_world.matrix();
        let by_point = by_world * world_from_vehicle.rotation.to_rotation_matrix().matrix();
        jacobian.set(0, 0, &by_world);
        jacobian.set(0, 3, &-(by_camera_point * skew(&in_camera)));
        jacobian.set(1, 0, &-by_world);
        jacobian.set(1, 3, &(by_point * skew(&in_vehicle.coords)));
        jacobian.set(2, 0, &-by_point);
        Some(self.observed_px - computed_px)
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{assert_jacobian, camera_poses, vehicle_poses};
    use super::*;
    use crate::camera::tests::cameras;
    use trackbundle_solver::manifold::write_pose;

    #[test]
    fn the_jacobian_is_that_of_its_differences() {
        for camera in cameras() {
            let residual =
                VehicleImagePoint { camera: Arc::new(camera), observed_px: Vector2::new(1000.0, 800.0) };
            for camera_pose in camera_poses() {
                for vehicle_pose in vehicle_poses() {
                    for point in [[0.0, 0.0, 0.0], [2.1, 0.9, 1.6], [-2.3, -0.8, 0.4]] {
                        let x = (write_pose(&camera_pose), write_pose(&vehicle_pose));
                        assert_jacobian(&residual, &[&x.0, &x.1, &point]);
                    }
                }
            }
        }
    }

    #[test]
    fn a_point_behind_the_camera_has_no_residual() {
        let [camera, ..] = cameras();
        let residual = VehicleImagePoint { camera: Arc::new(camera), observed_px: Vector2::zeros() };
        let x = (write_pose(&camera_poses()[0]), write_pose(&vehicle_poses()[0]));
        assert!(residual.evaluate(&[&x.0, &x.1, &[0.0, 0.0, 200.0]], None).is_none());
    }
}
