//! The contract between a measurement and the solver.

use super::manifold::{MAX_TANGENT, Manifold};
use nalgebra::{SMatrix, SVector};

/// Derivative of a residual with respect to the perturbation of each of its blocks: for block `b`
/// the first `Manifold::tangent()` columns of `self.0[b]` count.
#[derive(Clone, Copy, Debug)]
pub struct Jacobian<const ROWS: usize, const BLOCKS: usize>(pub [SMatrix<f64, ROWS, MAX_TANGENT>; BLOCKS]);

impl<const ROWS: usize, const BLOCKS: usize> Jacobian<ROWS, BLOCKS> {
    /// All zero.
    pub fn zeros() -> Self {
        Jacobian([SMatrix::zeros(); BLOCKS])
    }

    /// Sets the columns from `column` on of block `block`.
    pub fn set<const COLUMNS: usize>(
        &mut self,
        block: usize,
        column: usize,
        value: &SMatrix<f64, ROWS, COLUMNS>,
    ) {
        self.0[block].fixed_view_mut::<ROWS, COLUMNS>(0, column).copy_from(value);
    }
}

/// One measurement with one equation: `ROWS` numbers that are zero where the unknowns in its
/// `BLOCKS` blocks explain it.
///
/// A residual holds the measurement and nothing else. Its standard deviation and its robust loss
/// are applied outside, and which blocks are held fixed is the business of the system.
///
/// Laws: `evaluate` is a function of its arguments alone; its Jacobian is that of its value through
/// [`Manifold::plus`] ([`worst_jacobian_entry`] checks this); where the geometry is impossible (a
/// point behind the camera) it is `None`, never a number.
///
/// ```
/// use trackbundle_solver::nalgebra::Vector1;
/// use trackbundle_solver::{Jacobian, Manifold, Residual, worst_jacobian_entry};
///
/// /// A level that was read from a gauge.
/// struct Reading(f64);
///
/// impl Residual<1, 1> for Reading {
///     const MANIFOLDS: [Manifold; 1] = [Manifold::SCALAR];
///
///     fn evaluate(&self, x: &[&[f64]; 1], jacobian: Option<&mut Jacobian<1, 1>>) -> Option<Vector1<f64>> {
///         if let Some(jacobian) = jacobian {
///             jacobian.set(0, 0, &Vector1::new(1.0));
///         }
///         Some(Vector1::new(x[0][0] - self.0))
///     }
/// }
///
/// let worst = worst_jacobian_entry(&Reading(2.0), &[&[5.0]], 1e-6).expect("it has a value");
/// assert!(worst.gap < 1e-8);
/// ```
pub trait Residual<const ROWS: usize, const BLOCKS: usize>: Send + Sync {
    /// Where each block lives.
    const MANIFOLDS: [Manifold; BLOCKS];

    /// The residual at `x`, in the unit of the measurement, and its Jacobian where one is asked for.
    /// The Jacobian that comes in is zero.
    fn evaluate(
        &self,
        x: &[&[f64]; BLOCKS],
        jacobian: Option<&mut Jacobian<ROWS, BLOCKS>>,
    ) -> Option<SVector<f64, ROWS>>;
}

/// An entry of a Jacobian, computed twice.
#[derive(Clone, Copy, Debug, Default)]
pub struct JacobianEntry {
    /// Which block, row and column.
    pub place: (usize, usize, usize),
    /// What the residual says.
    pub analytic: f64,
    /// What central differences say.
    pub numeric: f64,
    /// Distance of the two, relative to the larger of 1 and the largest entry of the row.
    pub gap: f64,
}

/// Compares the Jacobian with central differences of step `step`, taken through the solver's own
/// update, and returns the entry with the largest gap. `None` where the residual has no value.
pub fn worst_jacobian_entry<const ROWS: usize, const BLOCKS: usize, R: Residual<ROWS, BLOCKS>>(
    residual: &R,
    x: &[&[f64]; BLOCKS],
    step: f64,
) -> Option<JacobianEntry> {
    let mut jacobian = Jacobian::zeros();
    residual.evaluate(x, Some(&mut jacobian))?;
    let scale = |row: usize| {
        let largest_of = |block: &SMatrix<f64, ROWS, MAX_TANGENT>| block.row(row).amax();
        jacobian.0.iter().map(largest_of).fold(1.0, f64::max)
    };
    let mut worst = JacobianEntry::default();
    for (block, manifold) in R::MANIFOLDS.iter().enumerate() {
        for column in 0..manifold.tangent() {
            let at = |step: f64| {
                let mut delta = [0.0; MAX_TANGENT];
                delta[column] = step;
                let mut moved = vec![0.0; manifold.ambient()];
                manifold.plus(x[block], &delta[..manifold.tangent()], &mut moved);
                let mut x = *x;
                x[block] = &moved;
                residual.evaluate(&x, None)
            };
            let slope = (at(step)? - at(-step)?) / (2.0 * step);
            for row in 0..ROWS {
                let analytic = jacobian.0[block][(row, column)];
                let gap = (analytic - slope[row]).abs() / scale(row);
                if gap > worst.gap || gap.is_nan() {
                    let place = (block, row, column);
                    worst = JacobianEntry { place, analytic, numeric: slope[row], gap };
                }
            }
        }
    }
    Some(worst)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector1;

    /// `x^2 - 2`, with a slope that can be wrong on purpose.
    struct Square {
        slope_error: f64,
    }

    impl Residual<1, 1> for Square {
        const MANIFOLDS: [Manifold; 1] = [Manifold::SCALAR];
        fn evaluate(&self, x: &[&[f64]; 1], jacobian: Option<&mut Jacobian<1, 1>>) -> Option<Vector1<f64>> {
            let x = x[0][0];
            if let Some(jacobian) = jacobian {
                jacobian.set(0, 0, &Vector1::new(2.0 * x * self.slope_error));
            }
            (x > 0.0).then(|| Vector1::new(x * x - 2.0))
        }
    }

    #[test]
    fn the_check_is_green_for_a_right_jacobian_and_red_for_a_wrong_one() {
        let gap = |slope_error, at| worst_jacobian_entry(&Square { slope_error }, &[&[at]], 1e-6);
        assert!(gap(1.0, 3.0).unwrap().gap < 1e-9);
        let wrong = gap(-1.0, 3.0).unwrap();
        assert!(wrong.gap > 1.0 && wrong.place == (0, 0, 0), "{wrong:?}");
        assert!(gap(1.001, 3.0).unwrap().gap > 1e-4);
    }

    #[test]
    fn a_residual_without_a_value_has_no_jacobian_to_check() {
        assert!(worst_jacobian_entry(&Square { slope_error: 1.0 }, &[&[-1.0]], 1e-6).is_none());
    }
}
