//! SE(3): exponential, logarithm, adjoint, and the Jacobians.
//!
//! A twist is `[rho; phi]`, the linear part \[m\] above the angular part \[rad\], in the axes of the
//! body: `T exp(xi)` moves the body by `xi`, and `T^-1 dT/dt` has the twist `[v; w]` of its velocity.
//!
//! ```text
//! exp(rho, phi) = ( J(phi) rho, exp(phi) )          J the left Jacobian of SO(3)
//! left Jacobian = [ J(phi)  Q(rho, phi) ]           right Jacobian (xi) = left Jacobian (-xi)
//!                 [   0       J(phi)    ]
//! ```
//!
//! Source: Barfoot, *State Estimation for Robotics* (2017), section 7.1, in his order of twists; `Q` is
//! his (7.86).

use super::rotation::{self, alternating};
use super::{Pose, skew};
use nalgebra::{Matrix3, Matrix6, Translation3, Vector3, Vector6};

/// The motion by a twist \[m, rad\].
#[inline]
pub fn exp(twist: &Vector6<f64>) -> Pose {
    let (rho, phi) = parts(twist);
    Pose::from_parts(Translation3::from(rotation::left_jacobian(&phi) * rho), rotation::exp(&phi))
}

/// The twist of a motion, its angle at most pi \[m, rad\].
#[inline]
pub fn log(motion: &Pose) -> Vector6<f64> {
    let phi = rotation::log(&motion.rotation);
    joined(&(rotation::left_jacobian_inverse(&phi) * motion.translation.vector), &phi)
}

/// `Ad` with `T exp(xi) T^-1 = exp(Ad xi)`, 6 x 6.
#[inline]
pub fn adjoint(pose: &Pose) -> Matrix6<f64> {
    let turn = pose.rotation.to_rotation_matrix();
    blocks(turn.matrix(), &(skew(&pose.translation.vector) * turn.matrix()))
}

/// `ad` with `Ad(exp(xi)) = exp(ad)`, 6 x 6; `ad(a) b = -ad(b) a`.
pub fn small_adjoint(twist: &Vector6<f64>) -> Matrix6<f64> {
    let (rho, phi) = parts(twist);
    blocks(&skew(&phi), &skew(&rho))
}

/// The left Jacobian: `exp(xi + d) = exp(J d) exp(xi)` to first order.
pub fn left_jacobian(twist: &Vector6<f64>) -> Matrix6<f64> {
    let (rho, phi) = parts(twist);
    blocks(&rotation::left_jacobian(&phi), &corner(&rho, &phi))
}

/// The right Jacobian: `exp(xi + d) = exp(xi) exp(J d)` to first order; the twist of the velocity of
/// `exp(xi(t))` is `J dxi/dt`.
pub fn right_jacobian(twist: &Vector6<f64>) -> Matrix6<f64> {
    left_jacobian(&-twist)
}

/// Inverse of the left Jacobian: `log(exp(d) exp(xi)) = xi + J d` to first order.
pub fn left_jacobian_inverse(twist: &Vector6<f64>) -> Matrix6<f64> {
    let (rho, phi) = parts(twist);
    let inverse = rotation::left_jacobian_inverse(&phi);
    blocks(&inverse, &-(inverse * corner(&rho, &phi) * inverse))
}

/// Inverse of the right Jacobian: `log(exp(xi) exp(d)) = xi + J d` to first order.
pub fn right_jacobian_inverse(twist: &Vector6<f64>) -> Matrix6<f64> {
    left_jacobian_inverse(&-twist)
}

/// Derivative of `right_jacobian(xi) x` with respect to `xi`, from the series
///
/// ```text
/// J x = sum of (-1)^n y_n / (n + 1)!,   y_0 = x,   y_n = ad(xi) y_(n-1),
/// dy_n/dxi = ad(xi) dy_(n-1)/dxi - ad(y_(n-1))
/// ```
pub fn right_jacobian_slope(twist: &Vector6<f64>, x: &Vector6<f64>) -> Matrix6<f64> {
    let turn = small_adjoint(twist);
    let (mut y, mut slope, mut sum) = (*x, Matrix6::zeros(), Matrix6::zeros());
    let (mut factor, mut largest) = (1.0, 0.0_f64);
    for n in 1..60 {
        slope = turn * slope - small_adjoint(&y);
        y = turn * y;
        factor /= -f64::from(n + 1);
        sum += factor * slope;
        // A term can vanish by chance, two in a row do not.
        let size = factor.abs() * (slope.amax() + y.amax());
        largest = largest.max(size);
        if n > 2 && size <= 1e-17 * largest {
            break;
        }
    }
    sum
}

/// The linear and the angular part.
#[inline]
pub fn parts(twist: &Vector6<f64>) -> (Vector3<f64>, Vector3<f64>) {
    (twist.fixed_rows::<3>(0).into_owned(), twist.fixed_rows::<3>(3).into_owned())
}

/// The twist with these parts.
#[inline]
pub fn joined(linear: &Vector3<f64>, angular: &Vector3<f64>) -> Vector6<f64> {
    Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)
}

/// `[diagonal, corner; 0, diagonal]`.
fn blocks(diagonal: &Matrix3<f64>, corner: &Matrix3<f64>) -> Matrix6<f64> {
    let mut matrix = Matrix6::zeros();
    matrix.fixed_view_mut::<3, 3>(0, 0).copy_from(diagonal);
    matrix.fixed_view_mut::<3, 3>(3, 3).copy_from(diagonal);
    matrix.fixed_view_mut::<3, 3>(0, 3).copy_from(corner);
    matrix
}

/// `Q(rho, phi)`; the factors by their series, which cancel nowhere.
fn corner(rho: &Vector3<f64>, phi: &Vector3<f64>) -> Matrix3<f64> {
    let (r, p, square) = (skew(rho), skew(phi), phi.norm_squared());
    let (third, fourth) = (alternating(square, 3), alternating(square, 4));
    let last = 0.5 * (fourth - 3.0 * alternating(square, 5));
    let (pr, prp) = (p * r, p * r * p);
    0.5 * r
        + third * (pr + r * p + prp)
        + fourth * (p * pr + r * p * p - 3.0 * prp)
        + last * (prp * p + p * prp)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn samples() -> Vec<Vector6<f64>> {
        let direction = Vector3::new(0.3, -0.5, 0.7).normalize();
        let rho = Vector3::new(3.0, -0.4, 1.2);
        [0.0, 1e-12, 1e-7, 0.9e-4, 1.1e-4, 0.01, 0.5, 2.0, 3.0]
            .iter()
            .flat_map(|angle| [0.0, 1.0].map(|scale| joined(&(rho * scale), &(direction * *angle))))
            .collect()
    }

    /// Central differences of a function of a twist at zero.
    fn slopes(at: impl Fn(&Vector6<f64>) -> Vector6<f64>) -> Matrix6<f64> {
        const STEP: f64 = 1e-5;
        let mut slopes = Matrix6::zeros();
        for i in 0..6 {
            let step = Vector6::ith(i, STEP);
            slopes.set_column(i, &((at(&step) - at(&-step)) / (2.0 * STEP)));
        }
        slopes
    }

    #[test]
    fn log_undoes_exp() {
        for xi in samples() {
            let gap = (log(&exp(&xi)) - xi).norm();
            assert!(gap < 2e-8, "{xi}: {gap}");
        }
        let straight = joined(&Vector3::new(1.0, 2.0, 3.0), &Vector3::zeros());
        assert_eq!(log(&exp(&straight)), straight);
    }

    #[test]
    fn jacobians_are_those_of_differences() {
        for xi in samples() {
            let pose = exp(&xi);
            let left = slopes(|d| log(&(exp(d) * pose)));
            let right = slopes(|d| log(&(pose * exp(d))));
            for (name, numeric, analytic) in [
                ("left inverse", left, left_jacobian_inverse(&xi)),
                ("right inverse", right, right_jacobian_inverse(&xi)),
                ("left", slopes(|d| log(&(exp(&(xi + d)) * pose.inverse()))), left_jacobian(&xi)),
                ("right", slopes(|d| log(&(pose.inverse() * exp(&(xi + d))))), right_jacobian(&xi)),
            ] {
                let gap = (numeric - analytic).amax();
                assert!(gap < 1e-7, "{name} at {xi}: {gap}");
            }
        }
    }

    #[test]
    fn the_closed_form_is_the_series() {
        for xi in samples() {
            let ad = small_adjoint(&xi);
            let (mut power, mut sum, mut factor) = (Matrix6::identity(), Matrix6::identity(), 1.0);
            for n in 1..40 {
                power *= ad;
                factor /= f64::from(n + 1);
                sum += factor * power;
            }
            assert!((sum - left_jacobian(&xi)).amax() < 1e-13, "{xi}");
        }
    }

    #[test]
    fn the_slope_of_the_right_jacobian_is_that_of_its_differences() {
        let x = Vector6::new(9.0, 0.3, -0.2, 0.1, -0.2, 0.5);
        for xi in samples() {
            let gap = (slopes(|d| right_jacobian(&(xi + d)) * x) - right_jacobian_slope(&xi, &x)).amax();
            assert!(gap < 1e-8, "{xi}: {gap}");
        }
    }

    #[test]
    fn the_adjoint_carries_a_twist_to_the_other_side() {
        let (pose, xi) = (exp(&samples()[15]), Vector6::new(0.1, -0.2, 0.3, 0.2, 0.1, -0.3));
        let carried = pose * exp(&xi) * pose.inverse();
        assert!((log(&carried) - adjoint(&pose) * xi).norm() < 1e-13);
        let series =
            (Matrix6::identity() - small_adjoint(&(-xi * 1e-9)) - adjoint(&exp(&(xi * 1e-9)))).amax();
        assert!(series < 1e-15, "{series}");
    }
}
