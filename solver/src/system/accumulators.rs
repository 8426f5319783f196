//! What groups of measurements fill when they are linearised, for each way in which blocks are eliminated.

use crate::linear::coupling::CouplingBlock;
use crate::linear::small::POSE;
use nalgebra::{DMatrix, DVector};
use std::ops::Range;

/// Whitened, weighted residuals and Jacobians of a group, measurement after measurement. Of a
/// Jacobian each column is contiguous.
#[derive(Clone, Debug)]
pub(super) struct Linear {
    pub rows: usize,
    pub columns: usize,
    pub residuals: Vec<f64>,
    pub jacobians: Vec<f64>,
}

impl Linear {
    /// The Jacobian of an item by some of its columns, column after column.
    #[inline(always)]
    pub(super) fn columns(&self, item: usize, start: usize, count: usize) -> &[f64] {
        &self.jacobians[(item * self.columns + start) * self.rows..][..count * self.rows]
    }
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
    /// Room for the numbers of common blocks beside those of the others.
    pub(super) fn zeros(others: usize, common: usize) -> Self {
        CommonLinear {
            coupling: DMatrix::zeros(others, common),
            own: DMatrix::zeros(common, common),
            gradient: DVector::zeros(common),
        }
    }
}

/// What the image points of a body at a moment add up to.
pub(super) struct Moment<'a> {
    /// `J^T J` by the pose as it is seen, lower triangle, and `J^T r`.
    pub by_pose: [[f64; POSE]; POSE],
    pub of_pose: [f64; POSE],
    /// First numbers of the points that are yet to come, of those that are adjusted, and their blocks of the
    /// coupling.
    pub points: &'a [u32],
    pub coupling: &'a mut [CouplingBlock],
    /// `J^T J` of each point by itself, row after row, and `J^T r`.
    pub by_point: &'a mut [f64],
    pub of_point: &'a mut [f64],
}

/// The measurements of one leaf, linearised, whitened and weighted. Jacobians are row by row.
#[derive(Clone, Default)]
pub(super) struct Local {
    pub entries: Vec<Entry>,
    pub parts: Vec<Part>,
    pub residuals: Vec<f64>,
    /// By the leaf, each row as long as the leaf's tangent.
    pub leaf: Vec<f64>,
    /// By the other blocks.
    pub other: Vec<f64>,
    /// Rows of `leaf` times `L^-T`.
    pub reduced: Vec<f64>,
    /// `Y`, all other blocks one below the other, column by column.
    pub panel: Vec<f64>,
    /// The positions of the other blocks, and which of them are neighbours.
    pub positions: Vec<usize>,
    pub runs: Vec<Range<usize>>,
}

/// One measurement.
#[derive(Clone, Copy)]
pub(super) struct Entry {
    /// Its first row and their number.
    pub row: usize,
    pub rows: usize,
    /// Its other blocks.
    pub parts: (usize, usize),
    /// Where its Jacobian by others begins, and the length of a row of it.
    pub other: usize,
    pub width: usize,
}

/// Another block of a measurement.
#[derive(Clone, Copy)]
pub(super) struct Part {
    pub position: usize,
    pub dim: usize,
    /// First column within a row of the Jacobian.
    pub column: usize,
}

impl Local {
    #[inline]
    pub(super) fn clear(&mut self) {
        self.entries.clear();
        self.parts.clear();
        self.residuals.clear();
        self.leaf.clear();
        self.other.clear();
    }

    #[inline(always)]
    pub(super) fn other_row(&self, entry: &Entry, row: usize) -> &[f64] {
        &self.other[entry.other + row * entry.width..][..entry.width]
    }
}
