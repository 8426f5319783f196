//! Forward intersection: where the rays of image points meet the ground raised by the points' heights.
//!
//! A point `M = (m, h)` of a body that stands on the ground at `x`, with the heading `psi` and its z
//! axis along the normal `n`, lies at `q + h n`, where its foot `q` has the plane position
//! `x + R(psi) m`. The ray from the camera `c` along `d` meets the ground raised by `h` at `p`; then
//!
//! ```text
//! q = p_xy - h n_xy,      dq/dh = d_xy / (d_z - slope . d_xy) - n_xy
//! ```
//!
//! The derivative says by how much a wrong height moves a foot: the tangent of the angle off the
//! nadir. The foot's standard deviation is that of the ray at the distance of `p`, and shrinks with a
//! greater height: by `1 - dh / clearance`. The tilt shortens `m` by the cosine of the slope, which is left out: 1e-3 at 5 %.

use crate::camera::Camera;
use crate::geometry::Pose;
use crate::problem::VehicleObservation;
use crate::rules::rules;
use crate::terrain::Terrain;
use nalgebra::{Point3, Vector2};

rules! {
    /// Where rays meet the ground.
    pub struct ForwardRules {
        /// A ray that descends by less is said to miss the ground.
        least_descent: f64 = 0.02, "share of the length";
    }
}

const RULES: ForwardRules = ForwardRules::DEFAULT;

/// The foot of a point of a body in one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Foot {
    /// Index of the frame.
    pub frame: usize,
    /// Index of the point.
    pub point: usize,
    /// Its plane position in the world \[m\].
    pub place_m: Vector2<f64>,
    /// Derivative of the place by the height of the point.
    pub by_height: Vector2<f64>,
    /// Standard deviation of the place per coordinate, from that of the image point \[m\].
    pub sigma_m: f64,
    /// How far the camera is above the raised ground \[m\].
    pub clearance_m: f64,
}

/// The feet of all image points whose rays meet the ground, in the order of the observations.
/// `height_m` has the height above the ground of each point.
pub fn feet(
    observations: &[VehicleObservation],
    camera: &Camera,
    camera_poses: &[Pose],
    height_m: &[f64],
    terrain: &Terrain,
) -> Vec<Foot> {
    let foot = |observation: &VehicleObservation| {
        let ray = camera.ray(&observation.image_px)?;
        let pose = &camera_poses[observation.frame];
        let direction = (pose.rotation * ray.push(1.0)).normalize();
        if direction.z > -RULES.least_descent {
            return None;
        }
        let origin = Point3::from(pose.translation.vector);
        let height = height_m[observation.point];
        let met = terrain.intersect(&origin, &direction, height).ok()?;
        let ground = terrain.at(met.x, met.y).ok()?;
        let descent = direction.z - ground.slope.dot(&direction.xy());
        if descent > -RULES.least_descent {
            return None;
        }
        let normal = ground.normal().xy();
        let distance_m = (met - origin).norm();
        let foot = Foot {
            frame: observation.frame,
            point: observation.point,
            place_m: met.coords.xy() - height * normal,
            by_height: direction.xy() / descent - normal,
            sigma_m: observation.sigma_px / camera.focal_px.mean() * distance_m / (-descent).sqrt(),
            clearance_m: distance_m * -descent,
        };
        (foot.place_m.iter().all(|v| v.is_finite()) && foot.sigma_m > 0.0).then_some(foot)
    };
    observations.iter().filter_map(foot).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Lens;
    use crate::geometry::{pose, rotation::exp};
    use crate::terrain::Grid;
    use nalgebra::{UnitQuaternion, Vector3};
    use std::sync::Arc;

    /// A plane that slopes.
    fn slope(along: Vector2<f64>) -> Terrain {
        let nodes = [[-200.0, -200.0], [200.0, -200.0], [-200.0, 200.0], [200.0, 200.0]];
        let heights = nodes.map(|[x, y]| along.dot(&Vector2::new(x, y))).to_vec();
        Terrain::Grid(Arc::new(Grid::new([-200.0; 2], [400.0; 2], [2, 2], heights).unwrap()))
    }

    fn camera() -> Camera {
        Camera {
            size_px: [3840, 2160],
            focal_px: Vector2::new(2680.0, 2680.0),
            principal_px: Vector2::new(1920.0, 1080.0),
            lens: Lens::Pinhole,
            pixel_centre_px: 0.0,
        }
    }

    /// A camera that looks down obliquely, and the image point of a place.
    fn seen(place: &Point3<f64>) -> (Pose, VehicleObservation) {
        let mut world_from_camera = pose([3.0, -2.0, 60.0], [0.0, 1.0, 0.0, 0.0]);
        world_from_camera.rotation *= exp(&Vector3::new(0.3, -0.2, 0.4));
        let image_px = camera().project(&world_from_camera.inverse_transform_point(place).coords).unwrap();
        (world_from_camera, VehicleObservation { frame: 0, point: 0, image_px, sigma_px: 1.0 })
    }

    #[test]
    fn a_foot_lies_under_its_point_on_sloping_ground() {
        let slope = slope(Vector2::new(0.05, -0.03));
        let normal = slope.at(0.0, 0.0).unwrap().normal();
        let foot = Vector2::new(-7.0, 11.0);
        let on_ground = foot.push(slope.at(foot.x, foot.y).unwrap().height_m);
        let (camera_pose, observation) = seen(&Point3::from(on_ground + 1.4 * normal));
        let at = |height: f64| feet(&[observation], &camera(), &[camera_pose], &[height], &slope)[0];
        // The height above the ground is counted along the normal here and along z there: 0.2 %.
        assert!((at(1.4).place_m - foot).norm() < 3e-3, "{}", at(1.4).place_m - foot);
        let by_difference = (at(1.5).place_m - at(1.3).place_m) / 0.2;
        assert!((by_difference - at(1.4).by_height).norm() < 1e-9);
        let nearer = 1.0 - 0.1 / at(1.4).clearance_m;
        assert!((at(1.5).sigma_m / at(1.4).sigma_m - nearer).abs() < 1e-4);
    }

    #[test]
    fn rays_that_do_not_descend_have_no_foot() {
        let (_, observation) = seen(&Point3::origin());
        let sideways = Pose::from_parts(
            Vector3::new(0.0, 0.0, 60.0).into(),
            UnitQuaternion::from_scaled_axis(Vector3::x() * 1.6),
        );
        let level = slope(Vector2::zeros());
        assert!(feet(&[observation], &camera(), &[sideways], &[0.8], &level).is_empty());
    }
}
