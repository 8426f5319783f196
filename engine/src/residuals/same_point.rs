//! Two blocks that are one point of a body \[m\]:
//!
//! ```text
//! r = a - b
//! ```

use nalgebra::{Matrix3, Vector3};
use trackbundle_solver::manifold::Manifold;
use trackbundle_solver::residual::{Jacobian, Residual};

/// Blocks: the two points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SamePoint;

impl Residual<3, 2> for SamePoint {
    const MANIFOLDS: [Manifold; 2] = [Manifold::POINT; 2];

    fn evaluate(&self, x: &[&[f64]; 2], jacobian: Option<&mut Jacobian<3, 2>>) -> Option<Vector3<f64>> {
        if let Some(jacobian) = jacobian {
            jacobian.set(0, 0, &Matrix3::identity());
            jacobian.set(1, 0, &-Matrix3::identity());
        }
        Some(Vector3::from_column_slice(x[0]) - Vector3::from_column_slice(x[1]))
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::assert_jacobian;
    use super::*;

    #[test]
    fn the_jacobian_is_that_of_its_differences() {
        assert_jacobian(&SamePoint, &[&[1.0, -2.0, 0.5], &[0.7, 3.0, -1.0]]);
        assert_eq!(
            SamePoint.evaluate(&[&[1.0, 2.0, 3.0], &[0.5, 2.0, 4.0]], None),
            Some(Vector3::new(0.5, 0.0, -1.0))
        );
    }
}
