//! The interior orientation as numbers that can be adjusted.
//!
//! ```text
//! focal length f (of the columns; that of the rows is f times their ratio), cx, cy,
//! the coefficients of the lens: k1, k2, p1, p2, k3 of a Brown lens, say
//! ```

use super::model::COEFFICIENTS;
use super::{Camera, Lens, ray_of};
use nalgebra::{SMatrix, Vector2, Vector3};

/// How many numbers an interior orientation has; those that a lens lacks are zero and without effect.
pub const INTERIOR: usize = POINT_AND_FOCAL + COEFFICIENTS;

/// Focal length and principal point.
const POINT_AND_FOCAL: usize = 3;

impl Camera {
    /// The numbers of the interior orientation.
    pub fn interior(&self) -> [f64; INTERIOR] {
        let mut all = [0.0; INTERIOR];
        all[0] = self.focal_px.x;
        all[1] = self.principal_px.x;
        all[2] = self.principal_px.y;
        all[POINT_AND_FOCAL..].copy_from_slice(&self.lens.numbers());
        all
    }

    /// The names of [`Camera::interior`].
    pub fn interior_names(&self) -> [&'static str; INTERIOR] {
        let keys = match &self.lens {
            // Those that it would have.
            Lens::Pinhole => Lens::USUAL,
            lens => lens.keys(),
        };
        let mut names = [""; INTERIOR];
        let all = ["focal_length_px", "cx_px", "cy_px"].iter().chain(keys.coefficients);
        names.iter_mut().zip(all).for_each(|(to, from)| *to = from);
        names
    }

    /// How many of them the lens has.
    pub fn interior_count(&self) -> usize {
        POINT_AND_FOCAL + self.lens.keys().coefficients.len()
    }

    /// The same camera with another interior orientation, seen through the same cone: where the lens folds
    /// over is that of this camera. Cheap enough for every image point.
    #[inline(always)]
    pub fn near(&self, interior: &[f64]) -> Camera {
        let ratio = self.focal_px.y / self.focal_px.x;
        let lens = self.lens.near(&std::array::from_fn(|i| interior[POINT_AND_FOCAL + i]));
        Camera {
            size_px: self.size_px,
            focal_px: Vector2::new(interior[0], interior[0] * ratio),
            principal_px: Vector2::new(interior[1], interior[2]),
            pixel_centre_px: self.pixel_centre_px,
            lens,
        }
    }

    /// The camera of another interior orientation, with the cone of its own lens.
    pub fn with_interior(&self, interior: &[f64; INTERIOR]) -> Camera {
        let near = self.near(interior);
        let model = self.lens.keys().model;
        let own = Lens::of_model(model, &interior[POINT_AND_FOCAL..], &self.lens.held());
        let lens = own.unwrap_or_else(|| near.lens.clone());
        Camera { lens, ..near }
    }

    /// Derivative of [`Camera::project`] by the interior orientation, 2 x 8.
    pub fn interior_jacobian(&self, point_in_camera: &Vector3<f64>) -> Option<SMatrix<f64, 2, INTERIOR>> {
        let ray = ray_of(point_in_camera)?;
        let mut jacobian = SMatrix::<f64, 2, INTERIOR>::zeros();
        let distorted = self.lens.distort(&ray)?;
        let by_coefficients = self.pixel_by_distorted() * self.lens.by_coefficients(&ray);
        jacobian.fixed_view_mut::<2, COEFFICIENTS>(0, POINT_AND_FOCAL).copy_from(&by_coefficients);
        jacobian[(0, 0)] = distorted.x;
        jacobian[(1, 0)] = distorted.y * self.focal_px.y / self.focal_px.x;
        jacobian[(0, 1)] = 1.0;
        jacobian[(1, 2)] = 1.0;
        Some(jacobian)
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::cameras;
    use super::*;

    #[test]
    fn the_derivative_by_the_interior_orientation_is_that_of_its_differences() {
        for camera in cameras() {
            let interior = camera.interior();
            assert_eq!(camera.with_interior(&interior), camera);
            assert_eq!(camera.near(&interior), camera);
            for point in [[3.0, -2.0, 60.0], [-30.0, 20.0, 50.0], [0.0, 0.0, 10.0]] {
                let point = Vector3::from(point);
                let analytic = camera.interior_jacobian(&point).unwrap();
                for (at, value) in interior.iter().enumerate() {
                    let step = 1e-5 * (1.0 + value.abs());
                    let moved = |by: f64| {
                        let mut interior = interior;
                        interior[at] += by;
                        camera.near(&interior).project(&point).unwrap()
                    };
                    let slope = (moved(step) - moved(-step)) / (2.0 * step);
                    let gap = (slope - analytic.column(at)).norm();
                    assert!(gap < 1e-5 * (1.0 + slope.norm()), "{at}: {slope} {analytic}");
                }
            }
        }
    }
}
