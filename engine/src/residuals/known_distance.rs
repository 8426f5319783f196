//! A distance between two shape points that is known beforehand \[m\]: a scale bar on a vehicle.
//!
//! ```text
//! r = |b - a| - length        dr/db = (b - a)^T / |b - a| = -dr/da
//! ```
//!
//! It says nothing of the frame of the body, and everything of its scale.

use nalgebra::{RowVector3, Vector1, Vector3};
use trackbundle_solver::manifold::Manifold;
use trackbundle_solver::residual::{Jacobian, Residual};

/// Points nearer to each other than this have no direction \[m\].
const LEAST_DISTANCE_M: f64 = 1e-9;

/// Blocks: two points of one vehicle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KnownDistance {
    /// What it is known to be \[m\].
    pub length_m: f64,
}

impl Residual<1, 2> for KnownDistance {
    const MANIFOLDS: [Manifold; 2] = [Manifold::POINT; 2];

    fn evaluate(&self, x: &[&[f64]; 2], jacobian: Option<&mut Jacobian<1, 2>>) -> Option<Vector1<f64>> {
        let between = Vector3::from_column_slice(x[1]) - Vector3::from_column_slice(x[0]);
        let distance_m = between.norm();
        if distance_m < LEAST_DISTANCE_M {
            return None;
        }
        if let Some(jacobian) = jacobian {
            let direction: RowVector3<f64> = between.transpose() / distance_m;
            jacobian.set(0, 0, &-direction);
            jacobian.set(1, 0, &direction);
        }
        Some(Vector1::new(distance_m - self.length_m))
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::assert_jacobian;
    use super::*;

    #[test]
    fn the_jacobian_is_that_of_its_differences() {
        let residual = KnownDistance { length_m: 2.5 };
        assert_jacobian(&residual, &[&[0.3, -2.0, 1.6], &[1.3, 0.5, 0.2]]);
        assert_jacobian(&residual, &[&[0.0, 0.0, 0.0], &[0.0, 0.0, 2.0]]);
    }

    #[test]
    fn a_bar_of_three_and_four_is_five_long() {
        let residual = KnownDistance { length_m: 4.9 };
        let found = residual.evaluate(&[&[1.0, 1.0, 1.0], &[4.0, 1.0, 5.0]], None).unwrap().x;
        assert!((found - 0.1).abs() < 1e-12);
        assert!(residual.evaluate(&[&[1.0; 3], &[1.0; 3]], None).is_none());
    }
}
