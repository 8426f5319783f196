//! Interior orientation: from points in the camera frame to pixels and back.
//!
//! The camera looks along z, x to the right, y down. Pixels are in the convention of the principal
//! point `cx`, `cy`.

mod brown;

pub use brown::Brown;
use nalgebra::{Matrix2, Matrix2x3, Vector2, Vector3};

/// Points nearer to the camera's plane than this are not seen \[m\].
const LEAST_DEPTH_M: f64 = 1e-3;

/// A calibrated camera.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    /// Width and height of the image \[px\].
    pub size_px: [u32; 2],
    /// Focal lengths `fx`, `fy` \[px\].
    pub focal_px: Vector2<f64>,
    /// Principal point `cx`, `cy` \[px\].
    pub principal_px: Vector2<f64>,
    /// Lens distortion.
    pub lens: Lens,
}

/// How a lens departs from a pinhole.
#[derive(Clone, Debug, PartialEq)]
pub enum Lens {
    /// Not at all.
    Pinhole,
    /// Radial and tangential, as in OpenCV.
    Brown(Brown),
}

impl Camera {
    /// The pixel of a point in the camera frame \[m\]; `None` behind the camera, or outside the cone
    /// in which the lens model is one to one.
    pub fn project(&self, point_in_camera: &Vector3<f64>) -> Option<Vector2<f64>> {
        let ray = ray_of(point_in_camera)?;
        let distorted = match &self.lens {
            Lens::Pinhole => ray,
            Lens::Brown(lens) => lens.distort(&ray)?,
        };
        Some(self.focal_px.component_mul(&distorted) + self.principal_px)
    }

    /// [`Camera::project`] with its derivative by the point, 2 x 3 \[px/m\].
    pub fn project_with_jacobian(
        &self,
        point_in_camera: &Vector3<f64>,
    ) -> Option<(Vector2<f64>, Matrix2x3<f64>)> {
        let ray = ray_of(point_in_camera)?;
        let inverse_depth = 1.0 / point_in_camera.z;
        #[rustfmt::skip]
        let ray_by_point = Matrix2x3::new(
            inverse_depth, 0.0, -ray.x * inverse_depth,
            0.0, inverse_depth, -ray.y * inverse_depth,
        );
        let (distorted, distorted_by_point) = match &self.lens {
            Lens::Pinhole => (ray, ray_by_point),
            Lens::Brown(lens) => (lens.distort(&ray)?, lens.distort_jacobian(&ray) * ray_by_point),
        };
        let scale = Matrix2::from_diagonal(&self.focal_px);
        Some((self.focal_px.component_mul(&distorted) + self.principal_px, scale * distorted_by_point))
    }

    /// The direction `(x/z, y/z)` that a pixel looks along, the distortion removed; `None` where no
    /// direction of the lens model leads to this pixel.
    pub fn ray(&self, image_px: &Vector2<f64>) -> Option<Vector2<f64>> {
        let distorted = (image_px - self.principal_px).component_div(&self.focal_px);
        match &self.lens {
            Lens::Pinhole => Some(distorted),
            Lens::Brown(lens) => lens.undistort(&distorted),
        }
    }

    /// Whether a pixel lies in the image.
    pub fn contains(&self, image_px: &Vector2<f64>) -> bool {
        // The pixel convention may put the first pixel's edge at 0 or at -0.5.
        (-0.5..=f64::from(self.size_px[0])).contains(&image_px.x)
            && (-0.5..=f64::from(self.size_px[1])).contains(&image_px.y)
    }
}

fn ray_of(point_in_camera: &Vector3<f64>) -> Option<Vector2<f64>> {
    (point_in_camera.z > LEAST_DEPTH_M).then(|| point_in_camera.xy() / point_in_camera.z)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// A camera of either kind, the distorted one stronger than any real lens of this class.
    pub(crate) fn cameras() -> [Camera; 2] {
        let pinhole = Camera {
            size_px: [3840, 2160],
            focal_px: Vector2::new(2680.0, 2650.0),
            principal_px: Vector2::new(1925.0, 1070.0),
            lens: Lens::Pinhole,
        };
        let brown = Brown::new([-0.11, 0.08, 0.002, -0.001, -0.02]);
        [pinhole.clone(), Camera { lens: Lens::Brown(brown), ..pinhole }]
    }

    fn pixels() -> impl Iterator<Item = Vector2<f64>> {
        (0..=8).flat_map(|i| (0..=8).map(move |j| Vector2::new(480.0 * f64::from(i), 270.0 * f64::from(j))))
    }

    #[test]
    fn a_pixel_comes_back_from_its_ray() {
        for camera in cameras() {
            for pixel in pixels() {
                let ray = camera.ray(&pixel).expect("inside the image");
                let back = camera.project(&Vector3::new(ray.x * 60.0, ray.y * 60.0, 60.0)).unwrap();
                assert!((back - pixel).norm() < 1e-9, "{pixel} {back}");
            }
        }
    }

    #[test]
    fn the_derivative_is_that_of_its_differences() {
        for camera in cameras() {
            for pixel in pixels() {
                let ray = camera.ray(&pixel).unwrap();
                let point = Vector3::new(ray.x * 60.0, ray.y * 60.0, 60.0);
                let (value, jacobian) = camera.project_with_jacobian(&point).unwrap();
                assert_eq!(Some(value), camera.project(&point));
                for axis in 0..3 {
                    let step = Vector3::ith(axis, 1e-4);
                    let slope = (camera.project(&(point + step)).unwrap()
                        - camera.project(&(point - step)).unwrap())
                        / 2e-4;
                    assert!((slope - jacobian.column(axis)).norm() < 1e-6, "{pixel} axis {axis}");
                }
            }
        }
    }

    #[test]
    fn nothing_is_seen_behind_the_camera() {
        for camera in cameras() {
            assert_eq!(camera.project(&Vector3::new(0.1, 0.1, -1.0)), None);
            assert_eq!(camera.project(&Vector3::new(0.1, 0.1, 0.0)), None);
            assert!(camera.project_with_jacobian(&Vector3::new(0.0, 0.0, -2.0)).is_none());
        }
    }

    #[test]
    fn the_image_ends_at_its_edges() {
        let [camera, _] = cameras();
        assert!(camera.contains(&Vector2::new(-0.5, 2160.0)));
        assert!(!camera.contains(&Vector2::new(3840.1, 10.0)));
        assert!(!camera.contains(&Vector2::new(10.0, -0.6)));
    }
}
