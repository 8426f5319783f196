//! A system that is linearised: its normal equations, in the parts that each elimination keeps.

use super::accumulators::{CommonLinear, Linear};
use super::frames_linear::FramesLinear;
use super::leaves::Sums;
use super::model::clamped;
use crate::linear::matrix::BlockMatrix;

/// The system at one state, linearised: what the minimiser needs for a step.
pub struct Normal {
    /// `J^T W J` of the whitened, weighted measurements, leaves eliminated. Held perturbations have 1
    /// on the diagonal.
    pub(crate) matrix: BlockMatrix,
    /// Gradient of the cost, leaves eliminated, in elimination order.
    pub(crate) gradient: Vec<f64>,
    /// The diagonal and the gradient before the elimination of leaves.
    pub(super) diagonal: Vec<f64>,
    pub(super) raw_gradient: Vec<f64>,
    /// Largest entry of the gradient of a leaf.
    pub(super) leaf_gradient: f64,
    pub(super) linear: Vec<Option<Linear>>,
    pub(super) sums: Vec<Sums>,
    pub(super) frames: Option<FramesLinear>,
    pub(super) common: CommonLinear,
}

impl Normal {
    /// The diagonal of the normal matrix, in elimination order, without what is common to all moments and what
    /// image points say of moments.
    pub fn diagonal(&self) -> Vec<f64> {
        self.matrix.diagonal()
    }

    /// Every entry of the lower triangle of the same matrix: row, column, value. Blocks that are eliminated first
    /// are so; held perturbations have 1 on the diagonal.
    pub fn for_each_entry(&self, give: impl FnMut(usize, usize, f64)) {
        self.matrix.for_each_entry(give);
    }

    /// Largest entry of the gradient.
    pub fn largest_gradient(&self) -> f64 {
        self.raw_gradient.iter().fold(self.leaf_gradient, |a, g| a.max(g.abs()))
    }

    /// Gradient of all blocks but those that are eliminated first, before that elimination.
    pub fn raw_gradient(&self) -> &[f64] {
        &self.raw_gradient
    }

    /// What the damping of the others is multiplied by.
    pub fn scale(&self) -> Vec<f64> {
        self.diagonal.iter().map(|d| clamped(*d)).collect()
    }
}
