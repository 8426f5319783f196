//! Image points of a camera whose rows are exposed one after another, or whose interior orientation is
//! adjusted \[px\]:
//!
//! ```text
//! X0 = Rc^T (Rv M + tv - tc)         a point of a vehicle in the camera frame, at the time of the frame
//! X0 = Rc^T (G - tc)                 a target
//! X  = exp(d z) X0                   at the time of its row, d = share * readout after that of the frame
//! r  = (u, v) - project(X; c)        observed minus computed
//!
//! dr/dreadout = -P share (w x X + v)        z = [v; w]
//! dr/dc       = -d project / dc
//! dr/dX0      = -P E                        E the rotation of exp(d z)
//! ```
//!
//! `share` is that of the computed row, and `z` is the motion of the body as the camera sees it, `d X / dt = w x X + v`, taken from neighbouring frames;
//! both stay as they are while Jacobians are formed: it knows neither of the body's frame nor of the world's, so that
//! what image points leave open stays open. Derivatives by poses and points are those of
//! [`super::vehicle_image_point`] with `P E` for `P`.

use crate::camera::{Camera, INTERIOR};
use crate::geometry::{Pose, se3, skew};
use nalgebra::{Matrix2x3, SMatrix, Vector2, Vector3, Vector6};
use std::sync::Arc;
use trackbundle_solver::manifold::{Manifold, read_point, read_pose};
use trackbundle_solver::residual::{Jacobian, Residual};

/// Where an interior orientation lives.
pub const INTERIOR_BLOCK: Manifold = Manifold::Vector(INTERIOR);

/// What is known of an image point.
#[derive(Clone, Debug)]
pub struct AtRow {
    /// The camera that saw it; its interior orientation is that of the block.
    pub camera: Arc<Camera>,
    /// Where it was seen \[px\].
    pub observed_px: Vector2<f64>,
    /// When its row is read out, as a share of the readout time after the middle row: of the computed image
    /// point. (The row where it was observed has the noise of the observation, and that times itself does not
    /// average out.)
    pub row_share: f64,
    /// Motion of what was seen in the camera frame \[m/s, rad/s\].
    pub twist: Vector6<f64>,
}

/// Blocks: camera pose, vehicle pose, point in the vehicle frame, interior orientation, readout time.
#[derive(Clone, Debug)]
pub struct RowVehicleImagePoint(pub AtRow);

/// Blocks: camera pose, target in the world, interior orientation, readout time.
#[derive(Clone, Debug)]
pub struct RowTargetImagePoint(pub AtRow);

/// A computed image point and its derivatives.
struct Seen {
    px: Vector2<f64>,
    by_point: Matrix2x3<f64>,
    by_interior: SMatrix<f64, 2, INTERIOR>,
    by_readout: Vector2<f64>,
}

impl AtRow {
    #[inline(always)]
    fn moved(&self, in_camera: &Vector3<f64>, readout_s: f64) -> (Vector3<f64>, Pose) {
        let motion = se3::exp(&(self.twist * (self.row_share * readout_s)));
        (motion.rotation * in_camera + motion.translation.vector, motion)
    }

    #[inline(always)]
    fn computed(&self, in_camera: &Vector3<f64>, interior: &[f64], readout_s: f64) -> Option<Vector2<f64>> {
        self.camera.near(interior).project(&self.moved(in_camera, readout_s).0)
    }

    #[inline(always)]
    fn seen(&self, in_camera: &Vector3<f64>, interior: &[f64], readout_s: f64) -> Option<Seen> {
        let camera = self.camera.near(interior);
        let (place, motion) = self.moved(in_camera, readout_s);
        let (px, by_place) = camera.project_with_jacobian(&place)?;
        let (v, w): (Vector3<f64>, Vector3<f64>) =
            (self.twist.fixed_rows::<3>(0).into(), self.twist.fixed_rows::<3>(3).into());
        Some(Seen {
            px,
            by_point: by_place * motion.rotation.to_rotation_matrix().matrix(),
            by_interior: camera.interior_jacobian(&place)?,
            by_readout: by_place * (w.cross(&place) + v) * self.row_share,
        })
    }
}

impl Residual<2, 5> for RowVehicleImagePoint {
    const MANIFOLDS: [Manifold; 5] =
        [Manifold::Pose, Manifold::Pose, Manifold::POINT, INTERIOR_BLOCK, Manifold::SCALAR];

    #[inline(always)]
    fn evaluate(&self, x: &[&[f64]; 5], jacobian: Option<&mut Jacobian<2, 5>>) -> Option<Vector2<f64>> {
        let (world_from_camera, world_from_vehicle) = (read_pose(x[0]), read_pose(x[1]));
        let in_vehicle = read_point(x[2]);
        let in_world = world_from_vehicle * in_vehicle;
        let in_camera = world_from_camera.inverse_transform_point(&in_world).coords;
        let Some(jacobian) = jacobian else {
            return Some(self.0.observed_px - self.0.computed(&in_camera, x[3], x[4][0])?);
        };
        let Seen { px, by_point: by_camera_point, by_interior, by_readout } =
            self.0.seen(&in_camera, x[3], x[4][0])?;
        let camera_from_world = world_from_camera.rotation.inverse().to_rotation_matrix();
        let by_world: Matrix2x3<f64> = by_camera_point * camera_from_world.matrix();
        let by_point = by_world * world_from_vehicle.rotation.to_rotation_matrix().matrix();
        jacobian.set(0, 0, &by_world);
        jacobian.set(0, 3, &-(by_camera_point * skew(&in_camera)));
        jacobian.set(1, 0, &-by_world);
        jacobian.set(1, 3, &(by_point * skew(&in_vehicle.coords)));
        jacobian.set(2, 0, &-by_point);
        jacobian.set(3, 0, &-by_interior);
        jacobian.set(4, 0, &-by_readout);
        Some(self.0.observed_px - px)
    }
}

impl Residual<2, 4> for RowTargetImagePoint {
    const MANIFOLDS: [Manifold; 4] = [Manifold::Pose, Manifold::POINT, INTERIOR_BLOCK, Manifold::SCALAR];

    fn evaluate(&self, x: &[&[f64]; 4], jacobian: Option<&mut Jacobian<2, 4>>) -> Option<Vector2<f64>> {
        let world_from_camera = read_pose(x[0]);
        let in_camera = world_from_camera.inverse_transform_point(&read_point(x[1])).coords;
        let Some(jacobian) = jacobian else {
            return Some(self.0.observed_px - self.0.computed(&in_camera, x[2], x[3][0])?);
        };
        let Seen { px, by_point: by_camera_point, by_interior, by_readout } =
            self.0.seen(&in_camera, x[2], x[3][0])?;
        let camera_from_world = world_from_camera.rotation.inverse().to_rotation_matrix();
        let by_world = by_camera_point * camera_from_world.matrix();
        jacobian.set(0, 0, &by_world);
        jacobian.set(0, 3, &-(by_camera_point * skew(&in_camera)));
        jacobian.set(1, 0, &-by_world);
        jacobian.set(2, 0, &-by_interior);
        jacobian.set(3, 0, &-by_readout);
        Some(self.0.observed_px - px)
    }
}

#[cfg(test)]
mod tests {
    use super::super::target_image_point::TargetImagePoint;
    use super::super::testing::{assert_jacobian, camera_poses, vehicle_poses};
    use super::super::vehicle_image_point::VehicleImagePoint;
    use super::*;
    use crate::camera::tests::cameras;
    use trackbundle_solver::manifold::write_pose;

    const TWIST: [f64; 6] = [9.0, -4.0, 0.5, 0.02, -0.3, 0.4];

    fn rows(observed_px: Vector2<f64>) -> impl Iterator<Item = AtRow> {
        let twist = Vector6::from(TWIST);
        cameras().into_iter().map(move |camera| {
            let row_share = camera.row_delay(observed_px.y);
            AtRow { camera: Arc::new(camera), observed_px, row_share, twist }
        })
    }

    #[test]
    fn the_jacobian_is_that_of_its_differences() {
        for at in rows(Vector2::new(1000.0, 1800.0)) {
            let interior = at.camera.interior();
            for camera_pose in camera_poses() {
                for vehicle_pose in vehicle_poses() {
                    let (camera, vehicle) = (write_pose(&camera_pose), write_pose(&vehicle_pose));
                    let point = [2.1, 0.9, 1.6];
                    let residual = RowVehicleImagePoint(at.clone());
                    assert_jacobian(&residual, &[&camera, &vehicle, &point, &interior, &[0.03]]);
                }
                let residual = RowTargetImagePoint(at.clone());
                let camera = write_pose(&camera_pose);
                assert_jacobian(&residual, &[&camera, &[14.0, -9.0, 0.4], &interior, &[-0.02]]);
            }
        }
    }

    #[test]
    fn without_a_readout_it_is_the_plain_image_point() {
        let observed_px = Vector2::new(1000.0, 800.0);
        for at in rows(observed_px) {
            let (camera, vehicle) = (write_pose(&camera_poses()[0]), write_pose(&vehicle_poses()[0]));
            let (point, interior) = ([2.1, 0.9, 1.6], at.camera.interior());
            let plain = VehicleImagePoint { camera: at.camera.clone(), observed_px };
            let wanted = plain.evaluate(&[&camera, &vehicle, &point], None).unwrap();
            let found = RowVehicleImagePoint(at.clone())
                .evaluate(&[&camera, &vehicle, &point, &interior, &[0.0]], None)
                .unwrap();
            assert!((found - wanted).norm() < 1e-10);
            let plain = TargetImagePoint { camera: at.camera.clone(), observed_px };
            let wanted = plain.evaluate(&[&camera, &point], None).unwrap();
            let found =
                RowTargetImagePoint(at).evaluate(&[&camera, &point, &interior, &[0.0]], None).unwrap();
            assert!((found - wanted).norm() < 1e-10);
        }
    }

    /// Second road: poses that are moved to the time of the row.
    #[test]
    fn a_row_sees_the_body_where_it_is_by_then() {
        let readout_s = 0.03;
        for at in rows(Vector2::new(1000.0, 1800.0)) {
            let interior = at.camera.interior();
            let world_from_camera = camera_poses()[0];
            let camera_from_vehicle = world_from_camera.inverse() * vehicle_poses()[1];
            let delay_s = at.camera.row_delay(1800.0) * readout_s;
            // A body that moves steadily in the camera frame.
            let later = se3::exp(&(at.twist * delay_s)) * camera_from_vehicle;
            let point = nalgebra::Point3::new(2.1, 0.9, 1.6);
            let wanted = at.observed_px - at.camera.project(&(later * point).coords).unwrap();
            let (camera, vehicle) = (write_pose(&world_from_camera), write_pose(&vehicle_poses()[1]));
            let x: [&[f64]; 5] = [&camera, &vehicle, point.coords.as_slice(), &interior, &[readout_s]];
            let found = RowVehicleImagePoint(at).evaluate(&x, None).unwrap();
            assert!((found - wanted).norm() < 1e-9, "{found} {wanted}");
        }
    }
}
