//! The distortion model of Brown in OpenCV's form: `k1, k2, k3, k4` radial, `p1, p2` tangential.
//!
//! ```text
//! r2 = x^2 + y^2,   radial = 1 + k1 r2 + k2 r2^2 + k3 r2^3 + k4 r2^4
//! x' = x radial + 2 p1 x y + p2 (r2 + 2 x^2)
//! y' = y radial + p1 (r2 + 2 y^2) + 2 p2 x y
//! u = fx x' + skew_px y' + cx,   v = fy y' + cy
//! ```
//!
//! `k4` and `skew_px` are held as they were calibrated.

use super::fold::first_root;
use super::model::{COEFFICIENTS, LensKeys, LensModel};
use nalgebra::{Matrix2, SMatrix, Vector2};

/// Coefficients, and the cone in which the model is one to one.
#[derive(Clone, Debug, PartialEq)]
pub struct Brown {
    k: [f64; 4],
    p: [f64; 2],
    skew_px: f64,
    /// Squared radius at which the radial part folds over; infinite where it never does.
    fold_radius2: f64,
}

impl Brown {
    /// From OpenCV's order `k1, k2, p1, p2, k3`.
    pub fn new(coefficients: [f64; 5]) -> Self {
        Brown::with(coefficients, [0.0; 2])
    }

    /// The same with `k4` and `skew_px`.
    pub fn with([k1, k2, p1, p2, k3]: [f64; 5], [k4, skew_px]: [f64; 2]) -> Self {
        let k = [k1, k2, k3, k4];
        Brown { k, p: [p1, p2], skew_px, fold_radius2: fold_radius2(k) }
    }

    /// In OpenCV's order `k1, k2, p1, p2, k3`.
    pub fn coefficients(&self) -> [f64; 5] {
        let ([k1, k2, k3, _], [p1, p2]) = (self.k, self.p);
        [k1, k2, p1, p2, k3]
    }

    /// Radius `tan(angle from the axis)` at which the model folds over.
    pub fn fold_radius(&self) -> f64 {
        self.fold_radius2.sqrt()
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

    fn radial(&self, r2: f64) -> f64 {
        let [k1, k2, k3, k4] = self.k;
        1.0 + r2 * (k1 + r2 * (k2 + r2 * (k3 + r2 * k4)))
    }
}

impl LensModel for Brown {
    const KEYS: LensKeys =
        LensKeys { model: "brown", coefficients: &["k1", "k2", "p1", "p2", "k3"], held: &["k4", "skew_px"] };

    fn of_numbers(coefficients: &[f64; COEFFICIENTS], held: &[f64]) -> Self {
        Brown::with(*coefficients, std::array::from_fn(|at| held.get(at).copied().unwrap_or(0.0)))
    }

    fn numbers(&self) -> [f64; COEFFICIENTS] {
        self.coefficients()
    }

    fn held(&self) -> Vec<f64> {
        vec![self.k[3], self.skew_px]
    }

    #[inline(always)]
    fn near(&self, [k1, k2, p1, p2, k3]: &[f64; COEFFICIENTS]) -> Self {
        Brown { k: [*k1, *k2, *k3, self.k[3]], p: [*p1, *p2], ..*self }
    }

    fn distort(&self, ray: &Vector2<f64>) -> Option<Vector2<f64>> {
        let r2 = ray.norm_squared();
        (r2 < self.fold_radius2).then(|| self.distort_anywhere(ray))
    }

    fn distort_jacobian(&self, ray: &Vector2<f64>) -> Matrix2<f64> {
        let (x, y, r2) = (ray.x, ray.y, ray.norm_squared());
        let ([k1, k2, k3, k4], [p1, p2]) = (self.k, self.p);
        let radial = self.radial(r2);
        let slope = k1 + r2 * (2.0 * k2 + (3.0 * r2 * k3 + 4.0 * r2 * r2 * k4));
        let mixed = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y;
        Matrix2::new(
            radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x,
            mixed,
            mixed,
            radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x,
        )
    }

    fn undistort(&self, distorted: &Vector2<f64>) -> Option<Vector2<f64>> {
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

    fn by_coefficients(ray: &Vector2<f64>) -> SMatrix<f64, 2, COEFFICIENTS> {
        let (x, y, r2) = (ray.x, ray.y, ray.norm_squared());
        let (r4, xy) = (r2 * r2, 2.0 * x * y);
        #[rustfmt::skip]
        let by = SMatrix::<f64, 2, COEFFICIENTS>::new(
            x * r2, x * r4, xy, r2 + 2.0 * x * x, x * r4 * r2,
            y * r2, y * r4, r2 + 2.0 * y * y, xy, y * r4 * r2,
        );
        by
    }

    fn skew_px(&self) -> f64 {
        self.skew_px
    }
}

/// Smallest positive root of `1 + 3 k1 s + 5 k2 s^2 + 7 k3 s^3 + 9 k4 s^4`, the slope of the distorted
/// radius by the radius, where `s` is the squared radius.
fn fold_radius2([k1, k2, k3, k4]: [f64; 4]) -> f64 {
    // A lens sees less than 89 degrees off its axis: s < 3300.
    first_root(&[1.0, 3.0 * k1, 5.0 * k2, 7.0 * k3, 9.0 * k4], 3300.0).unwrap_or(f64::INFINITY)
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
    fn it_folds_where_the_highest_power_makes_it() {
        // Distorted radius r - r^9 / 9: slope 1 - r^8.
        let lens = Brown::with([0.0; 5], [-1.0 / 9.0, 0.0]);
        assert!((lens.fold_radius() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn it_is_the_formula_of_its_head() {
        let ([k1, k2, p1, p2, k3], [k4, skew_px]) = ([-0.11, 0.08, 0.002, -0.001, -0.02], [0.04, 1.5]);
        let lens = Brown::with([k1, k2, p1, p2, k3], [k4, skew_px]);
        let (x, y): (f64, f64) = (0.7, -0.4);
        let r2 = x * x + y * y;
        let radial = 1.0 + k1 * r2 + k2 * r2.powi(2) + k3 * r2.powi(3) + k4 * r2.powi(4);
        let bent_x = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x);
        let bent_y = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y;
        let bent = lens.distort(&Vector2::new(x, y)).unwrap();
        assert!((bent - Vector2::new(bent_x, bent_y)).norm() < 1e-15);
        let (focal_px, principal_px) = (Vector2::new(2680.0, 2650.0), Vector2::new(1925.0, 1070.0));
        let lens = crate::camera::Lens::Brown(lens);
        let camera = crate::camera::Camera {
            size_px: [3840, 2160],
            focal_px,
            principal_px,
            pixel_centre_px: 0.0,
            lens,
        };
        let pixel = camera.project(&nalgebra::Vector3::new(60.0 * x, 60.0 * y, 60.0)).unwrap();
        let wanted = Vector2::new(2680.0 * bent_x + skew_px * bent_y + 1925.0, 2650.0 * bent_y + 1070.0);
        assert!((pixel - wanted).norm() < 1e-9, "{pixel} {wanted}");
    }

    #[test]
    fn values_agree_with_opencv() {
        // cv2.projectPoints (4.x) of (0.3, -0.2, 1) with these coefficients and unit focal length.
        let lens = Brown::new([-0.12, 0.05, 0.001, -0.002, 0.01]);
        let wanted = Vector2::new(0.294840091, -0.196603394);
        assert!((lens.distort(&Vector2::new(0.3, -0.2)).unwrap() - wanted).norm() < 1e-9);
    }
}
