//! SO(3): exponential, logarithm, and the Jacobians that go with a perturbation from the right and
//! from the left.
//!
//! `R exp(phi)` turns the body by the rotation vector `phi` \[rad\] about its own axes.
//! Source of the closed forms: Sola et al., *A micro Lie theory for state estimation in robotics*,
//! arXiv:1812.01537, equations (132), (133), (143), (144).

use super::skew;
use nalgebra::{Matrix3, UnitQuaternion, Vector3};

/// Below this angle \[rad\] the series is exact to the last bit and the closed form is not.
const SMALL_ANGLE: f64 = 1e-4;

/// The rotation of `phi` \[rad\] about its own direction.
#[inline]
pub fn exp(phi: &Vector3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::from_scaled_axis(*phi)
}

/// The rotation vector of `q`, of length at most pi \[rad\]. Exact for small angles too.
#[inline]
pub fn log(q: &UnitQuaternion<f64>) -> Vector3<f64> {
    let sign = if q.w < 0.0 { -1.0 } else { 1.0 };
    let (w, v) = (sign * q.w, sign * q.imag());
    let sine = v.norm();
    let ratio = if sine < SMALL_ANGLE {
        2.0 / w * (1.0 - (sine / w).powi(2) / 3.0)
    } else {
        2.0 * sine.atan2(w) / sine
    };
    v * ratio
}

/// Inverse of the right Jacobian: `log(exp(phi) exp(d)) = phi + J d` to first order.
#[inline]
pub fn right_jacobian_inverse(phi: &Vector3<f64>) -> Matrix3<f64> {
    let cross = skew(phi);
    Matrix3::identity() + 0.5 * cross + quadratic(phi.norm()) * cross * cross
}

/// Inverse of the left Jacobian: `log(exp(d) exp(phi)) = phi + J d` to first order.
#[inline]
pub fn left_jacobian_inverse(phi: &Vector3<f64>) -> Matrix3<f64> {
    right_jacobian_inverse(phi).transpose()
}

/// The left Jacobian: `exp(phi + d) = exp(J d) exp(phi)` to first order.
#[inline]
pub fn left_jacobian(phi: &Vector3<f64>) -> Matrix3<f64> {
    let (square, cross) = (phi.norm_squared(), skew(phi));
    Matrix3::identity() + alternating(square, 2) * cross + alternating(square, 3) * cross * cross
}

/// Derivative of `left_jacobian_inverse(phi) x` with respect to `phi`:
///
/// ```text
/// J^-1 x = x - phi x x / 2 + c phi x (phi x x),        c = 1/t^2 - cot(t/2) / (2 t),   t = |phi|
/// d/dphi = [x]x / 2 - c ([phi x x]x + [phi]x [x]x) + (phi x (phi x x)) c'/t phi^T
/// ```
pub fn left_jacobian_inverse_slope(phi: &Vector3<f64>, x: &Vector3<f64>) -> Matrix3<f64> {
    let (angle, once) = (phi.norm(), phi.cross(x));
    let straight = 0.5 * skew(x) - quadratic(angle) * (skew(&once) + skew(phi) * skew(x));
    straight + phi.cross(&once) * (quadratic_slope(angle) * phi.transpose())
}

/// The sum of `(-square)^k / (first + 2 k)!` over `k`: to rounding where `square <= 40`.
pub(super) fn alternating(square: f64, first: u32) -> f64 {
    let mut term = 1.0 / (1..=first).map(f64::from).product::<f64>();
    let mut sum = term;
    let mut next = f64::from(first) + 1.0;
    while term.abs() > 1e-18 {
        term *= -square / (next * (next + 1.0));
        next += 2.0;
        sum += term;
    }
    sum
}

/// The factor `c` of the square in the inverse Jacobians.
fn quadratic(angle: f64) -> f64 {
    if angle < SMALL_ANGLE {
        1.0 / 12.0 + angle * angle / 720.0
    } else {
        1.0 / (angle * angle) - (1.0 + angle.cos()) / (2.0 * angle * angle.sin())
    }
}

/// `c'(t) / t` of [`quadratic`]; below 0.3 rad, where the closed form cancels, by the Bernoulli
/// numbers: the sum of `(2 n - 2) |B_2n| t^(2n - 4) / (2 n)!` from `n = 2` on.
fn quadratic_slope(angle: f64) -> f64 {
    let square = angle * angle;
    if angle < 0.3 {
        const SERIES: [f64; 5] =
            [1.0 / 360.0, 1.0 / 7560.0, 1.0 / 201_600.0, 1.0 / 5_987_520.0, 691.0 / 130_767_436_800.0];
        SERIES.iter().rev().fold(0.0, |sum, factor| sum * square + factor)
    } else {
        let (sine, cosine) = (0.5 * angle).sin_cos();
        let cotangent = cosine / sine;
        (0.25 / (sine * sine) + 0.5 * cotangent / angle - 2.0 / square) / square
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn samples() -> Vec<Vector3<f64>> {
        let direction = Vector3::new(0.3, -0.5, 0.7).normalize();
        [0.0, 1e-12, 1e-7, 0.9e-4, 1.1e-4, 0.01, 0.5, 2.0, 3.13].map(|angle| direction * angle).to_vec()
    }

    #[test]
    fn log_undoes_exp() {
        for phi in samples() {
            let back = log(&exp(&phi));
            assert!((back - phi).norm() <= 1e-15 + 1e-12 * phi.norm(), "{phi}");
        }
    }

    #[test]
    fn log_takes_the_short_way_round() {
        let long = exp(&(Vector3::z() * 3.5));
        let wanted = 3.5 - 2.0 * std::f64::consts::PI;
        assert!((log(&long) - Vector3::z() * wanted).norm() < 1e-14);
    }

    #[test]
    fn right_jacobian_inverse_is_the_derivative_of_log() {
        for phi in samples() {
            let analytic = right_jacobian_inverse(&phi);
            for axis in 0..3 {
                let step = Vector3::ith(axis, 1e-6);
                let slope = (log(&(exp(&phi) * exp(&step))) - log(&(exp(&phi) * exp(&-step)))) / 2e-6;
                let gap = (slope - analytic.column(axis)).norm();
                assert!(gap < 2e-7, "phi {phi} axis {axis}: gap {gap}");
            }
        }
    }

    #[test]
    fn left_and_right_jacobians_are_each_others_mirror_and_inverse() {
        for phi in samples() {
            let product = left_jacobian(&phi) * left_jacobian_inverse(&phi);
            assert!((product - Matrix3::identity()).norm() < 1e-7, "{phi}: {product}");
            for axis in 0..3 {
                let step = Vector3::ith(axis, 1e-6);
                let slope = (log(&(exp(&step) * exp(&phi))) - log(&(exp(&-step) * exp(&phi)))) / 2e-6;
                let gap = (slope - left_jacobian_inverse(&phi).column(axis)).norm();
                assert!(gap < 2e-7, "phi {phi} axis {axis}: gap {gap}");
            }
        }
    }

    #[test]
    fn the_slope_of_the_left_jacobian_inverse_is_that_of_its_differences() {
        let x = Vector3::new(2.0, -1.0, 0.7);
        let direction = Vector3::new(0.3, -0.5, 0.7).normalize();
        for angle in [0.0, 1e-7, 1e-3, 0.1, 0.299, 0.301, 1.0, 2.5] {
            let phi = direction * angle;
            let analytic = left_jacobian_inverse_slope(&phi, &x);
            for axis in 0..3 {
                let step = Vector3::ith(axis, 1e-4);
                let at = |phi: Vector3<f64>| left_jacobian_inverse(&phi) * x;
                let slope = (at(phi + step) - at(phi - step)) / 2e-4;
                let gap = (slope - analytic.column(axis)).norm();
                assert!(gap < 2e-8, "angle {angle} axis {axis}: gap {gap}");
            }
        }
        let gap = quadratic_slope(0.3 - 1e-12) - quadratic_slope(0.3);
        assert!(gap.abs() < 1e-11, "series and closed form: {gap}");
    }
}
