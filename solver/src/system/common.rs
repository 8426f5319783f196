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

use super::group::AnyGroup;
use super::{Block, BlockId, Normal, System, Values};
use crate::linear::cholesky::Singular;
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// Which blocks they are, and where each begins among them.
#[derive(Default)]
pub(super) struct Common {
    blocks: Vec<usize>,
    starts: Vec<usize>,
    size: usize,
}

/// The common unknowns of a linearisation.
#[derive(Clone)]
pub(super) struct CommonLinear {
    /// `C`: rows in elimination order.
    pub coupling: DMatrix<f64>,
    /// `D`.
    pub own: DMatrix<f64>,
    /// Their gradient.
    pub gradient: DVector<f64>,
}

impl CommonLinear {
    fn zeros(others: usize, common: usize) -> Self {
        CommonLinear {
            coupling: DMatrix::zeros(others, common),
            own: DMatrix::zeros(common, common),
            gradient: DVector::zeros(common),
        }
    }
}

impl Common {
    /// Those of `declared` that are adjusted.
    pub fn new(declared: &[BlockId], blocks: &[Block]) -> Self {
        let mut common = Common::default();
        for block in declared.iter().filter(|block| blocks[block.0].is_free()) {
            common.blocks.push(block.0);
            common.starts.push(common.size);
            common.size += blocks[block.0].manifold.tangent();
        }
        common
    }

    /// How many numbers perturb them.
    pub fn size(&self) -> usize {
        self.size
    }

    /// Whether a block is one of them.
    pub fn has(&self, block: usize) -> bool {
        self.blocks.contains(&block)
    }

    /// The blocks, and where each begins.
    pub fn places(&self) -> impl Iterator<Item = (usize, usize)> {
        self.blocks.iter().copied().zip(self.starts.iter().copied())
    }

    /// Where a block begins.
    pub fn start_of(&self, block: usize) -> Option<usize> {
        self.blocks.iter().position(|b| *b == block).map(|at| self.starts[at])
    }

    /// Room for a linearisation.
    pub fn linear(&self, others: usize) -> CommonLinear {
        CommonLinear::zeros(others, self.size)
    }

    /// Sums what all measurements that see one of them say.
    pub fn linearise(
        &self,
        system: &System,
        values: &Values,
        least_flatness: f64,
        linear: &mut CommonLinear,
    ) {
        *linear = self.linear(system.pattern.size());
        let groups: &[Box<dyn AnyGroup>] = &system.groups;
        groups.iter().for_each(|group| group.add_common(system, values, least_flatness, linear));
        for (block, start) in self.places() {
            for (component, free) in system.blocks[block].free().iter().enumerate() {
                if !free {
                    linear.own[(start + component, start + component)] = 1.0;
                }
            }
        }
    }
}

/// The factors of the common unknowns.
#[derive(Default)]
pub struct CommonFactor {
    /// `U`
    solved: DMatrix<f64>,
    /// Of `S`.
    cholesky: Option<Cholesky<f64, Dyn>>,
}

impl CommonFactor {
    /// From `C`, and `C` solved with the factors of the others.
    pub(super) fn factorise(
        &mut self,
        normal: &Normal,
        solved: DMatrix<f64>,
        extra: &[f64],
    ) -> Result<(), Singular> {
        let linear = &normal.common;
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
    pub(super) fn finish(&self, normal: &Normal, others: &mut DMatrix<f64>, common: &mut DMatrix<f64>) {
        let Some(cholesky) = &self.cholesky else { return };
        *common -= normal.common.coupling.tr_mul(others);
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
