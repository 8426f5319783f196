//! A coordinate that is known beforehand \[m\]:
//!
//! ```text
//! r = x[axis] - known
//! ```
//!
//! of a target in the world (survey), of a shape point in the vehicle frame (a measured marker), of
//! the highest point in the vehicle frame, whose z is the height of the body above the ground, and of
//! the bias of the terrain, whose known value is zero.

use nalgebra::{RowVector1, RowVector3, Vector1};
use trackbundle_solver::manifold::Manifold;
use trackbundle_solver::residual::{Jacobian, Residual};

/// Block: a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KnownCoordinate {
    /// 0, 1 or 2.
    pub axis: usize,
    /// What it is known to be \[m\].
    pub known_m: f64,
}

impl Residual<1, 1> for KnownCoordinate {
    const MANIFOLDS: [Manifold; 1] = [Manifold::POINT];

    fn evaluate(&self, x: &[&[f64]; 1], jacobian: Option<&mut Jacobian<1, 1>>) -> Option<Vector1<f64>> {
        if let Some(jacobian) = jacobian {
            let mut row = RowVector3::zeros();
            row[self.axis] = 1.0;
            jacobian.set(0, 0, &row);
        }
        Some(Vector1::new(x[0][self.axis] - self.known_m))
    }
}

/// Block: numbers, of which one is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KnownNumber<const N: usize> {
    /// Which.
    pub at: usize,
    /// What it is known to be, in its own unit.
    pub known: f64,
}

impl<const N: usize> Residual<1, 1> for KnownNumber<N> {
    const MANIFOLDS: [Manifold; 1] = [Manifold::Vector(N)];

    fn evaluate(&self, x: &[&[f64]; 1], jacobian: Option<&mut Jacobian<1, 1>>) -> Option<Vector1<f64>> {
        if let Some(jacobian) = jacobian {
            jacobian.0[0][(0, self.at)] = 1.0;
        }
        Some(Vector1::new(x[0][self.at] - self.known))
    }
}

/// Block: one number, known to be zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KnownZero;

impl Residual<1, 1> for KnownZero {
    const MANIFOLDS: [Manifold; 1] = [Manifold::SCALAR];

    fn evaluate(&self, x: &[&[f64]; 1], jacobian: Option<&mut Jacobian<1, 1>>) -> Option<Vector1<f64>> {
        if let Some(jacobian) = jacobian {
            jacobian.set(0, 0, &RowVector1::new(1.0));
        }
        Some(Vector1::new(x[0][0]))
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::assert_jacobian;
    use super::*;

    #[test]
    fn the_jacobian_is_that_of_its_differences() {
        for axis in 0..3 {
            let residual = KnownCoordinate { axis, known_m: 1.5 };
            assert_jacobian(&residual, &[&[0.3, -2.0, 1.6]]);
            let found = residual.evaluate(&[&[0.3, -2.0, 1.6]], None).unwrap().x;
            assert_eq!(found, [0.3, -2.0, 1.6][axis] - 1.5);
        }
        assert_jacobian(&KnownZero, &[&[0.4]]);
        assert_jacobian(&KnownNumber::<4> { at: 2, known: 0.3 }, &[&[0.4, 0.1, 0.5, 2.0]]);
        assert_jacobian(&KnownNumber::<1> { at: 0, known: 0.3 }, &[&[0.4]]);
    }
}
