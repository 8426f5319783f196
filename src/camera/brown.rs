//! The distortion model of Brown in OpenCV's form: `k1, k2, k3` radial, `p1, p2` tangential.
//!
//! ```text
//! r2 = x^2 + y^2,   radial = 1 + k1 r2 + k2 r2^2 + k3 r2^3
//! x' = x radial + 2 p1 x y + p2 (r2 + 2 x^2)
//! y' = y radial + p1 (r2 + 2 y^2) + 2 p2 x y
//! ```

use super::fold::first_root;
use nalgebra::{Matrix2, SMatrix, Vector2};

/// Coefficients, and the cone in which the model is one to one.
#[derive(Clone, Debug, PartialEq)]
pub struct Brown {
    k: [f64; 3],
    p: [f64; 2],
    /// Squared radius at which the radial part folds over; infinite where it never does.
    fold_radius2: f64,
}

impl Brown {
    /// From OpenCV's order `k1, k2, p1, p2, k3`.
    pub fn new([k1, k2, p1, p2, k3]: [f64; 5]) -> Self {
        let k = [k1, k2, k3];
        Brown { k, p: [p1, p2], fold_radius2: fold_radius2(k) }
    }

    /// In OpenCV's order `k1, k2, p1, p2, k3`.
    pub fn coefficients(&self) -> [f64; 5] {
        let ([k1, k2, k3], [p1, p2]) = (self.k, self.p);
        [k1, k2, p1, p2, k3]
    }

    /// Other coefficients within the same cone.
    #[inline(always)]
    pub(super) fn near(&self, [k1, k2, p1, p2, k3]: [f64; 5]) -> Brown {
        Brown { k: [k1, k2, k3], p: [p1, p2], fold_radius2: self.fold_radius2 }
    }

    /// Derivative of [`Brown::distort`] by the coefficients, 2 x 5; it is linear in them.
    pub(super) fn by_coefficients(ray: &Vector2<f64>) -> SMatrix<f64, 2, 5> {
        let (x, y, r2) = (ray.x, ray.y, ray.norm_squared());
        let (r4, xy) = (r2 * r2, 2.0 * x * y);
        #[rustfmt::skip]
        let by = SMatrix::<f64, 2, 5>::new(
            x * r2, x * r4, xy, r2 + 2.0 * x * x, x * r4 * r2,
            y * r2, y * r4, r2 + 2.0 * y * y, xy, y * r4 * r2,
        );
        by
    }

    /// Radius `tan(angle from the axis)` at which the model folds over.
    pub fn fold_radius(&self) -> f64 {
        self.fold_radius2.sqrt()
    }

    /// The direction that the lens bends `ray` to; `None` beyond the fold.
    pub fn distort(&self, ray: &Vector2<f64>) -> Option<Vector2<f64>> {
        let r2 = ray.norm_squared();
        (r2 < self.fold_radius2).then(|| self.distort_anywhere(ray))
    }

    fn distort_anywhere(&self, ray: &Vector2<f64>) -> Vector2<f64> {
        let (x, y, r2) = (ray.x, ray.y, ray.norm_squared());
        let [p1, p2] = self.p;
        let radial = self.radial(r2);
        Vector2::new(
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        )
    }

    /// Derivative of [`Brown::distort`], 2 x 2.
    pub fn distort_jacobian(&self, ray: &Vector2<f64>) -> Matrix2<f64> {
        let (x, y, r2) = (ray.x, ray.y, ray.norm_squared());
        let ([k1, k2, k3], [p1, p2]) = (self.k, self.p);
        let radial = self.radial(r2);
        let slope = k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3);
        let mixed = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y;
        Matrix2::new(
            radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x,
            mixed,
            mixed,
            radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x,
        )
    }

    /// The ray that is bent to `distorted`, by Newton's method to machine precision; `None` where
    /// there is none inside the fold.
    pub fn undistort(&self, distorted: &Vector2<f64>) -> Option<Vector2<f64>> {
        let mut ray = *distorted;
        if ray.norm_squared() >= self.fold_radius2 {
            ray *= 0.9 * (self.fold_radius2 / ray.norm_squared()).sqrt();
        }
        for _ in 0..50 {
            let error = self.distort_anywhere(&ray) - distorted;
            if error.norm() <= 4.0 * f64::EPSILON * (1.0 + distorted.norm()) {
                break;
            }
            let mut step = self.distort_jacobian(&ray).try_inverse()? * error;
            // A full step must not leave the fold.
            while (ray - step).norm_squared() >= self.fold_radius2 && step.norm() > 1e-15 {
                step *= 0.5;
            }
            ray -= step;
        }
        let error = (self.distort(&ray)? - distorted).norm();
        (error <= 1e-12 * (1.0 + distorted.norm())).then_some(ray)
    }

    fn radial(&self, r2: f64) -> f64 {
        let [k1, k2, k3] = self.k;
        1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    }
}

/// Smallest positive root of `1 + 3 k1 s + 5 k2 s^2 + 7 k3 s^3`, the slope of the distorted radius
/// by the radius, where `s` is the squared radius.
fn fold_radius2([k1, k2, k3]: [f64; 3]) -> f64 {
    // A lens sees less than 89 degrees off its axis: s < 3300.
    first_root(&[1.0, 3.0 * k1, 5.0 * k2, 7.0 * k3], 3300.0).unwrap_or(f64::INFINITY)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folding_lens_knows_where_it_folds() {
        // Distorted radius r - 0.3 r^3: slope 1 - 0.9 r^2, largest at r = 1 / sqrt(0.9).
        let lens = Brown::new([-0.3, 0.0, 0.0, 0.0, 0.0]);
        let fold = 1.0 / 0.9_f64.sqrt();
        assert!((lens.fold_radius() - fold).abs() < 1e-12);
        assert_eq!(lens.distort(&Vector2::new(1.01 * fold, 0.0)), None);
        let farthest = fold - 0.3 * fold.powi(3);
        assert_eq!(lens.undistort(&Vector2::new(1.01 * farthest, 0.0)), None);
        let near = Vector2::new(0.6 * farthest, 0.78 * farthest);
        let back = lens.distort(&lens.undistort(&near).unwrap()).unwrap();
        assert!((back - near).norm() < 1e-14);
    }

    #[test]
    fn a_plain_lens_never_folds() {
        assert_eq!(Brown::new([0.0; 5]).fold_radius(), f64::INFINITY);
        assert_eq!(Brown::new([0.1, 0.0, 0.0, 0.0, 0.01]).fold_radius(), f64::INFINITY);
    }

    #[test]
    fn values_agree_with_opencv() {
        // cv2.projectPoints (4.x) of (0.3, -0.2, 1) with these coefficients and unit focal length.
        let lens = Brown::new([-0.12, 0.05, 0.001, -0.002, 0.01]);
        let wanted = Vector2::new(0.294840091, -0.196603394);
        assert!((lens.distort(&Vector2::new(0.3, -0.2)).unwrap() - wanted).norm() < 1e-9);
    }
}
