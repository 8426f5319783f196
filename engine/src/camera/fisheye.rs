//! The fisheye model of OpenCV (Kannala and Brandt 2006): `k1` to `k4`, of the angle off the axis.
//!
//! ```text
//! r = sqrt(x^2 + y^2),   theta = atan(r)
//! theta_d = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8)
//! x' = x theta_d / r,   y' = y theta_d / r
//! ```

use super::fold::first_root;
use super::model::{COEFFICIENTS, LensKeys, LensModel};
use nalgebra::{Matrix2, SMatrix, Vector2};
use std::f64::consts::FRAC_PI_2;

/// Coefficients, and the cone in which the model is one to one.
#[derive(Clone, Debug, PartialEq)]
pub struct Fisheye {
    k: [f64; 4],
    /// Angle off the axis at which the model folds over, or ends: 90 degrees \[rad\].
    fold_rad: f64,
}

impl Fisheye {
    /// From OpenCV's order `k1, k2, k3, k4`.
    pub fn new(k: [f64; 4]) -> Self {
        let [k1, k2, k3, k4] = k;
        // The slope of theta_d by theta, in theta^2.
        let slope = [1.0, 3.0 * k1, 5.0 * k2, 7.0 * k3, 9.0 * k4];
        let fold_rad = first_root(&slope, FRAC_PI_2 * FRAC_PI_2).map_or(FRAC_PI_2, f64::sqrt);
        Fisheye { k, fold_rad }
    }

    /// In OpenCV's order.
    pub fn coefficients(&self) -> [f64; 4] {
        self.k
    }

    /// Angle off the axis at which the model folds over \[rad\]; 90 degrees where it does not before,
    /// for only what lies before the camera is seen.
    pub fn fold_rad(&self) -> f64 {
        self.fold_rad
    }

    /// `theta_d`.
    fn bent(&self, angle: f64) -> f64 {
        let ([k1, k2, k3, k4], s) = (self.k, angle * angle);
        angle * (1.0 + s * (k1 + s * (k2 + s * (k3 + s * k4))))
    }

    /// Derivative of `theta_d` by `theta`.
    fn slope(&self, angle: f64) -> f64 {
        let ([k1, k2, k3, k4], s) = (self.k, angle * angle);
        1.0 + s * (3.0 * k1 + s * (5.0 * k2 + s * (7.0 * k3 + s * 9.0 * k4)))
    }
}

impl LensModel for Fisheye {
    const KEYS: LensKeys = LensKeys { model: "fisheye", coefficients: &["k1", "k2", "k3", "k4"], held: &[] };

    fn of_numbers([k1, k2, k3, k4, _]: &[f64; COEFFICIENTS], _held: &[f64]) -> Self {
        Fisheye::new([*k1, *k2, *k3, *k4])
    }

    fn numbers(&self) -> [f64; COEFFICIENTS] {
        let [k1, k2, k3, k4] = self.k;
        [k1, k2, k3, k4, 0.0]
    }

    #[inline(always)]
    fn near(&self, [k1, k2, k3, k4, _]: &[f64; COEFFICIENTS]) -> Self {
        Fisheye { k: [*k1, *k2, *k3, *k4], fold_rad: self.fold_rad }
    }

    fn distort(&self, ray: &Vector2<f64>) -> Option<Vector2<f64>> {
        let radius = ray.norm();
        let angle = radius.atan();
        let scale = if radius == 0.0 { 1.0 } else { self.bent(angle) / radius };
        (angle < self.fold_rad).then(|| scale * ray)
    }

    fn distort_jacobian(&self, ray: &Vector2<f64>) -> Matrix2<f64> {
        let radius = ray.norm();
        if radius == 0.0 {
            return Matrix2::identity();
        }
        let angle = radius.atan();
        let across = self.bent(angle) / radius;
        let along = self.slope(angle) / (1.0 + radius * radius);
        let outwards = ray / radius;
        Matrix2::identity() * across + outwards * outwards.transpose() * (along - across)
    }

    fn undistort(&self, distorted: &Vector2<f64>) -> Option<Vector2<f64>> {
        let wanted = distorted.norm();
        if wanted == 0.0 {
            return Some(*distorted);
        }
        if wanted.is_nan() || wanted >= self.bent(self.fold_rad) {
            return None;
        }
        // theta_d grows from 0 to the fold: Newton's method, kept inside a bracket.
        let (mut low, mut high) = (0.0, self.fold_rad);
        let mut angle = wanted.min(0.5 * self.fold_rad);
        for _ in 0..200 {
            let error = self.bent(angle) - wanted;
            if error > 0.0 {
                high = angle
            } else {
                low = angle
            }
            let step = angle - error / self.slope(angle);
            let next = if low < step && step < high { step } else { 0.5 * (low + high) };
            if error == 0.0 || (next - angle).abs() <= f64::EPSILON * angle {
                break;
            }
            angle = next;
        }
        Some(distorted * (angle.tan() / wanted))
    }

    fn by_coefficients(ray: &Vector2<f64>) -> SMatrix<f64, 2, COEFFICIENTS> {
        let radius = ray.norm();
        let angle = radius.atan();
        let outwards = if radius == 0.0 { *ray } else { ray / radius };
        SMatrix::from_fn(|axis, k| if k < 4 { outwards[axis] * angle.powi(2 * k as i32 + 3) } else { 0.0 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folding_lens_knows_where_it_folds() {
        // theta - 0.5 theta^3: slope 1 - 1.5 theta^2.
        let lens = Fisheye::new([-0.5, 0.0, 0.0, 0.0]);
        let fold = 1.0 / 1.5_f64.sqrt();
        assert!((lens.fold_rad() - fold).abs() < 1e-14);
        assert_eq!(lens.distort(&Vector2::new(0.0, (1.001 * fold).tan())), None);
        assert!(lens.distort(&Vector2::new(0.0, (0.999 * fold).tan())).is_some());
        let farthest = fold - 0.5 * fold.powi(3);
        assert_eq!(lens.undistort(&Vector2::new(1.0001 * farthest, 0.0)), None);
        assert_eq!(lens.undistort(&Vector2::new(f64::NAN, 0.0)), None);
        let near = Vector2::new(0.6 * farthest, 0.79999 * farthest);
        let back = lens.distort(&lens.undistort(&near).unwrap()).unwrap();
        assert!((back - near).norm() < 1e-15, "{}", (back - near).norm());
    }

    #[test]
    fn a_plain_lens_sees_all_that_lies_before_it() {
        let lens = Fisheye::new([0.0; 4]);
        assert_eq!(lens.fold_rad(), FRAC_PI_2);
        // Equidistant: the angle itself.
        for degrees in [1e-6_f64, 1.0, 45.0, 89.9] {
            let angle = degrees.to_radians();
            let bent = lens.distort(&Vector2::new(0.0, angle.tan())).unwrap();
            assert!((bent.y - angle).abs() < 1e-15);
            let ray = lens.undistort(&Vector2::new(-angle, 0.0)).unwrap();
            assert!((ray.x + angle.tan()).abs() < 1e-13 * angle.tan().powi(2).max(1.0));
        }
        assert_eq!(lens.undistort(&Vector2::new(1.6, 0.0)), None);
        assert_eq!(lens.undistort(&Vector2::zeros()), Some(Vector2::zeros()));
    }

    #[test]
    fn it_is_the_formula_of_its_head() {
        let [k1, k2, k3, k4] = [0.11, -0.05, 0.02, 0.003];
        let lens = Fisheye::new([k1, k2, k3, k4]);
        let (x, y): (f64, f64) = (0.7, -0.4);
        let r = (x * x + y * y).sqrt();
        let t = r.atan();
        let bent = t * (1.0 + k1 * t.powi(2) + k2 * t.powi(4) + k3 * t.powi(6) + k4 * t.powi(8));
        let wanted = Vector2::new(x * bent / r, y * bent / r);
        assert!((lens.distort(&Vector2::new(x, y)).unwrap() - wanted).norm() < 1e-15);
    }

    #[test]
    fn next_to_the_axis_nothing_is_lost() {
        let lens = Fisheye::new([0.3, 0.1, 0.0, 0.0]);
        for size in [1e-3, 1e-8, 1e-150, 1e-200] {
            let ray = Vector2::new(0.6 * size, -0.8 * size);
            assert!((lens.distort(&ray).unwrap() - ray).norm() <= size * size + 1e-15 * size);
            assert!((lens.distort_jacobian(&ray) - Matrix2::identity()).norm() <= 2.0 * size * size + 1e-15);
        }
    }
}
