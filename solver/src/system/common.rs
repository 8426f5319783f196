//! Unknowns that measurements of all frames share: a readout time, an interior orientation.
//!
//! In the pattern they would tie every frame to every other. They are few, and are eliminated last
//! instead, as a dense border of what is eliminated in whatever way by itself:
//!
//! ```text
//!  [ H   C ] [x]   [a]        U = H^-1 C,   S = D - C^T U
//!  [ C'  D ] [z] = [b]        z = S^-1 (b - U^T a),   x = H^-1 a - U z
//! ```
//!
//! The inverse is that of `H` and, with `X = [-U; 1]`, the product `X S^-1 X^T`.

use super::accumulators::CommonLinear;
use super::group::State;
use crate::linear::cholesky::Singular;
use nalgebra::{Cholesky, DMatrix, Dyn};

/// Sums what all measurements that see a common unknown say.
pub(super) fn linearise(state: &State<'_>, linear: &mut CommonLinear) {
    let State { layout, groups, values, curvature } = *state;
    *linear = CommonLinear::zeros(layout.others, layout.common.size());
    groups.iter().for_each(|group| group.add_common(layout, values, curvature.least_flatness, linear));
    for (block, start) in layout.common.places() {
        for (component, free) in layout.blocks[block].free().iter().enumerate() {
            if !free {
                linear.own[(start + component, start + component)] = 1.0;
            }
        }
    }
}

/// The factors of the common unknowns.
#[derive(Default)]
pub(super) struct CommonFactor {
    /// `U`
    solved: DMatrix<f64>,
    /// Of `S`.
    cholesky: Option<Cholesky<f64, Dyn>>,
}

impl CommonFactor {
    /// From `C`, and `C` solved with the factors of the others.
    pub(super) fn factorise(
        &mut self,
        linear: &CommonLinear,
        solved: DMatrix<f64>,
        extra: &[f64],
    ) -> Result<(), Singular> {
        let mut reduced = &linear.own - linear.coupling.tr_mul(&solved);
        for (at, extra) in extra.iter().enumerate() {
            reduced[(at, at)] += extra;
        }
        let reduced = (&reduced + reduced.transpose()) * 0.5;
        self.solved = solved;
        self.cholesky = Some(reduced.cholesky().ok_or(Singular)?);
        Ok(())
    }

    /// From `H^-1 a` and `b`, in place: the solution.
    pub(super) fn finish(&self, linear: &CommonLinear, others: &mut DMatrix<f64>, common: &mut DMatrix<f64>) {
        let Some(cholesky) = &self.cholesky else { return };
        *common -= linear.coupling.tr_mul(others);
        cholesky.solve_mut(common);
        others.gemm(-1.0, &self.solved, common, 1.0);
    }

    /// `X` and `X S^-1`.
    pub(super) fn of_inverse(&self) -> Option<(DMatrix<f64>, DMatrix<f64>)> {
        let cholesky = self.cholesky.as_ref()?;
        let (n, k) = self.solved.shape();
        let mut x = DMatrix::zeros(n + k, k);
        x.rows_mut(0, n).copy_from(&-&self.solved);
        x.rows_mut(n, k).fill_with_identity();
        let solved = &x * cholesky.inverse();
        Some((x, solved))
    }
}
