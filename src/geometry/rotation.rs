//! SO(3): exponential, logarithm, and the Jacobian that goes with a right perturbation.
//!
//! `R exp(phi)` turns the body by the rotation vector `phi` \[rad\] about its own axes.
//! Source of the closed forms: Sola et al., *A micro Lie theory for state estimation in robotics*,
//! arXiv:1812.01537, equations (132), (133), (143), (144).

use super::skew;
use nalgebra::{Matrix3, UnitQuaternion, Vector3};

/// Below this angle \[rad\] the series is exact to the last bit and the closed form is not.
const SMALL_ANGLE: f64 = 1e-4;

/// The rotation of `phi` \[rad\] about its own direction.
pub fn exp(phi: &Vector3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::from_scaled_axis(*phi)
}

/// The rotation vector of `q`, of length at most pi \[rad\]. Exact for small angles too.
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
pub fn right_jacobian_inverse(phi: &Vector3<f64>) -> Matrix3<f64> {
    let angle = phi.norm();
    let cross = skew(phi);
    let quadratic = if angle < SMALL_ANGLE {
        1.0 / 12.0 + angle * angle / 720.0
    } else {
        1.0 / (angle * angle) - (1.0 + angle.cos()) / (2.0 * angle * angle.sin())
    };
    Matrix3::identity() + 0.5 * cross + quadratic * cross * cross
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
}
