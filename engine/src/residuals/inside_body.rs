//! A shape point lies within a road vehicle \[m\]:
//!
//! ```text
//! r_i = x_i - upper_i   above the box,   x_i - lower_i   below it,   0 inside
//! ```
//!
//! A point whose rays are all but parallel has no depth of its own, and would take the adjustment
//! along to anywhere on its ray, behind the camera too. The box is larger than any road vehicle, so
//! that it holds back no point that is determined.

use nalgebra::{Matrix3, Point3, Vector3};
use trackbundle_solver::manifold::Manifold;
use trackbundle_solver::residual::{Jacobian, Residual};

/// The box, in the vehicle frame \[m\]: room for the longest road train, wherever in it the origin is.
pub const BODY_BOX_M: [[f64; 2]; 3] = [[-20.0, 20.0], [-5.0, 5.0], [-1.0, 6.0]];

/// The middle of a car in its frame and how far it reaches to either side \[m\].
pub const BODY_MIDDLE_M: [(f64, f64); 3] = [(0.0, 3.0), (0.0, 1.5), (1.0, 1.0)];

/// Whether a point can be of a body.
pub fn is_inside(point: &Point3<f64>) -> bool {
    point.iter().zip(BODY_BOX_M).all(|(value, [lower, upper])| (lower..=upper).contains(value))
}

/// Block: a point in the vehicle frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InsideBody;

impl Residual<3, 1> for InsideBody {
    const MANIFOLDS: [Manifold; 1] = [Manifold::POINT];

    fn evaluate(&self, x: &[&[f64]; 1], jacobian: Option<&mut Jacobian<3, 1>>) -> Option<Vector3<f64>> {
        let beyond = Vector3::from_fn(|axis, _| {
            let [lower, upper] = BODY_BOX_M[axis];
            x[0][axis] - x[0][axis].clamp(lower, upper)
        });
        if let Some(jacobian) = jacobian {
            let outside = beyond.map(|b| if b == 0.0 { 0.0 } else { 1.0 });
            jacobian.set(0, 0, &Matrix3::from_diagonal(&outside));
        }
        Some(beyond)
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::assert_jacobian;
    use super::*;

    #[test]
    fn the_jacobian_is_that_of_its_differences() {
        for point in [[0.0, 0.0, 1.0], [21.0, -5.5, 7.0], [-30.0, 0.0, -2.0]] {
            assert_jacobian(&InsideBody, &[&point]);
        }
    }

    #[test]
    fn only_what_sticks_out_counts() {
        let found = InsideBody.evaluate(&[&[-21.0, 4.0, 6.5]], None).unwrap();
        assert_eq!(found, Vector3::new(-1.0, 0.0, 0.5));
    }
}
