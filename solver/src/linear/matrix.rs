//! A symmetric matrix of small dense blocks, lower triangle, in elimination order.

use super::ordering::{self, Ordering};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMat, SymbolicSparseColMatRef};
use std::ops::Deref;
use std::sync::Arc;

/// Which blocks there are, and where their values stand. Positions are places in the elimination
/// order.
#[derive(Debug)]
pub(crate) struct Pattern {
    ordering: Ordering,
    position: Vec<usize>,
    /// Size of the block at each position.
    dims: Vec<usize>,
    /// First scalar index of the block at each position, and the size of the matrix at the end.
    starts: Vec<usize>,
    /// Positions of the blocks in each block column, diagonal first, sorted.
    rows: Vec<Vec<usize>>,
    /// Where each block column begins among the values, and their number at the end.
    value_starts: Vec<usize>,
    symbolic: SymbolicSparseColMat<usize>,
}

/// A pattern and its values.
#[derive(Clone, Debug)]
pub(crate) struct BlockMatrix {
    pattern: Arc<Pattern>,
    values: Vec<f64>,
}

impl Deref for BlockMatrix {
    type Target = Pattern;

    fn deref(&self) -> &Pattern {
        &self.pattern
    }
}

/// Where the values of a block stand: column `c` of a block is contiguous, its row `r` at
/// [`Place::column_start`]` + r`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Place {
    first: usize,
    /// Entries of the first scalar column of the block column; each next one has one fewer.
    height: usize,
}

impl Place {
    /// Where row 0 of a column of the block stands. In a diagonal block, rows above the diagonal do
    /// not exist: count on from here only for `row >= column`.
    #[inline(always)]
    pub(crate) fn column_start(self, column: usize) -> usize {
        // Column c of the lower triangle is c entries shorter than the first.
        self.first + column * self.height - column * column.saturating_sub(1) / 2 - column
    }
}

/// One block column, to be written.
pub(crate) struct ColumnMut<'a> {
    /// Position of the column.
    pub position: usize,
    /// Positions of its blocks, diagonal first, sorted.
    pub rows: &'a [usize],
    dims: &'a [usize],
    height: usize,
    values: &'a mut [f64],
}

/// Up to so many blocks, pairs are collected in a table of bits.
const MOST_IN_TABLE: usize = 8192;

impl Pattern {
    /// A diagonal block for each of `dims` and a block for each pair that shares a measurement. The
    /// elimination order is the cheapest known.
    pub(crate) fn new(dims: &[usize], pairs: impl IntoIterator<Item = (usize, usize)>) -> Self {
        let neighbours = neighbours(dims.len(), pairs);
        let ordering = ordering::cheapest(dims, &neighbours);
        Self::with_ordering(dims, &neighbours, ordering)
    }

    fn with_ordering(dims: &[usize], neighbours: &[Vec<usize>], ordering: Ordering) -> Self {
        let order = &ordering.order;
        let mut position = vec![0; order.len()];
        order.iter().enumerate().for_each(|(at, &block)| position[block] = at);
        let dims: Vec<usize> = order.iter().map(|&block| dims[block]).collect();
        let mut starts = vec![0];
        dims.iter().for_each(|dim| starts.push(starts[starts.len() - 1] + dim));

        let mut rows = Vec::with_capacity(order.len());
        let (mut value_starts, mut column_starts, mut row_indices) = (vec![0], vec![0], Vec::new());
        for (at, &block) in order.iter().enumerate() {
            let mut column: Vec<usize> = neighbours[block]
                .iter()
                .map(|&other| position[other])
                .filter(|&row| row >= at)
                .chain([at])
                .collect();
            column.sort_unstable();
            for inner in 0..dims[at] {
                let below_diagonal = starts[at] + inner..starts[at] + dims[at];
                row_indices.extend(below_diagonal);
                for &row in &column[1..] {
                    row_indices.extend(starts[row]..starts[row + 1]);
                }
                column_starts.push(row_indices.len());
            }
            value_starts.push(row_indices.len());
            rows.push(column);
        }
        let n = starts[starts.len() - 1];
        let symbolic = SymbolicSparseColMat::new_checked(n, n, column_starts, None, row_indices);
        Pattern { ordering, position, dims, starts, rows, value_starts, symbolic }
    }

    /// Rows and columns.
    pub(crate) fn size(&self) -> usize {
        self.starts[self.starts.len() - 1]
    }

    /// How many values a matrix of this pattern has.
    pub(crate) fn values(&self) -> usize {
        self.value_starts[self.value_starts.len() - 1]
    }

    /// The elimination order and what it costs.
    pub(crate) fn ordering(&self) -> &Ordering {
        &self.ordering
    }

    /// Position of a block in the elimination order.
    pub(crate) fn position(&self, block: usize) -> usize {
        self.position[block]
    }

    /// The scalar indices of the block at a position.
    pub(crate) fn range(&self, position: usize) -> std::ops::Range<usize> {
        self.starts[position]..self.starts[position + 1]
    }

    /// The lower triangle as compressed sparse columns.
    pub(crate) fn symbolic(&self) -> SymbolicSparseColMatRef<'_, usize> {
        self.symbolic.as_ref()
    }

    /// For each column its block rows, diagonal first, sorted.
    pub(crate) fn rows(&self) -> &[Vec<usize>] {
        &self.rows
    }

    /// Where the values of every block of a column stand, in the order of its rows.
    pub(crate) fn places(&self, column: usize) -> impl Iterator<Item = Place> {
        let height = self.rows[column].iter().map(|&row| self.dims[row]).sum();
        let first = self.value_starts[column];
        self.rows[column].iter().scan(first, move |next, &row| {
            let place = Place { first: *next, height };
            *next += self.dims[row];
            Some(place)
        })
    }
}

/// For each of `n` blocks those that it shares a pair with, sorted, without itself.
fn neighbours(n: usize, pairs: impl IntoIterator<Item = (usize, usize)>) -> Vec<Vec<usize>> {
    if n <= MOST_IN_TABLE {
        let words = n.div_ceil(64);
        let mut table = vec![0_u64; n * words];
        for (a, b) in pairs {
            table[a * words + b / 64] |= 1 << (b % 64);
            table[b * words + a / 64] |= 1 << (a % 64);
        }
        let of = |a: usize| {
            let is_set = |b: &usize| *b != a && table[a * words + b / 64] >> (b % 64) & 1 == 1;
            (0..n).filter(is_set).collect()
        };
        return (0..n).map(of).collect();
    }
    let mut neighbours: Vec<Vec<usize>> = vec![Vec::new(); n];
    for (a, b) in pairs {
        if a != b {
            neighbours[a].push(b);
            neighbours[b].push(a);
        }
    }
    for list in &mut neighbours {
        list.sort_unstable();
        list.dedup();
    }
    neighbours
}

impl BlockMatrix {
    /// A zero matrix of this pattern.
    pub(crate) fn zeros(pattern: Arc<Pattern>) -> Self {
        let values = vec![0.0; pattern.values()];
        BlockMatrix { pattern, values }
    }

    /// All values.
    pub(crate) fn values_mut(&mut self) -> &mut [f64] {
        &mut self.values
    }

    /// Every block column, to be written independently of the others.
    pub(crate) fn columns_mut(&mut self) -> Vec<ColumnMut<'_>> {
        let Pattern { dims, rows, value_starts, .. } = &*self.pattern;
        let mut left = self.values.as_mut_slice();
        let mut columns = Vec::with_capacity(dims.len());
        for (position, rows) in rows.iter().enumerate() {
            let length = value_starts[position + 1] - value_starts[position];
            let (values, rest) = left.split_at_mut(length);
            left = rest;
            let height = rows.iter().map(|&row| dims[row]).sum();
            columns.push(ColumnMut { position, rows, dims, height, values });
        }
        columns
    }

    /// The diagonal, by scalar index.
    pub(crate) fn diagonal(&self) -> Vec<f64> {
        let starts = &self.symbolic.col_ptr()[..self.size()];
        starts.iter().map(|&start| self.values[start]).collect()
    }

    /// Sets one entry of the diagonal, by scalar index.
    pub(crate) fn set_diagonal(&mut self, index: usize, value: f64) {
        let at = self.symbolic.col_ptr()[index];
        self.values[at] = value;
    }

    /// Copies the values of `other`, which has the same pattern, adding `extra` to the diagonal.
    pub(crate) fn copy_with_diagonal(&mut self, other: &BlockMatrix, extra: &[f64]) {
        self.values.copy_from_slice(&other.values);
        self.add_to_diagonal(extra);
    }

    /// Adds to the diagonal.
    pub(crate) fn add_to_diagonal(&mut self, extra: &[f64]) {
        let BlockMatrix { pattern, values } = self;
        for (start, extra) in pattern.symbolic.col_ptr().iter().zip(extra) {
            values[*start] += extra;
        }
    }

    /// Every entry of the lower triangle: row, column, value.
    pub(crate) fn for_each_entry(&self, mut give: impl FnMut(usize, usize, f64)) {
        let (starts, rows) = (self.symbolic.col_ptr(), self.symbolic.row_idx());
        for column in 0..self.size() {
            for at in starts[column]..starts[column + 1] {
                give(rows[at], column, self.values[at]);
            }
        }
    }

    /// The lower triangle as compressed sparse columns.
    pub(crate) fn lower(&self) -> SparseColMatRef<'_, usize, f64> {
        SparseColMatRef::new(self.symbolic.as_ref(), &self.values)
    }

    /// `self * x` for the whole symmetric matrix.
    pub(crate) fn multiply(&self, x: &[f64]) -> Vec<f64> {
        let mut product = vec![0.0; x.len()];
        let (starts, rows) = (self.symbolic.col_ptr(), self.symbolic.row_idx());
        for column in 0..self.size() {
            let range = starts[column]..starts[column + 1];
            for (&row, value) in rows[range.clone()].iter().zip(&self.values[range]) {
                product[row] += value * x[column];
                if row != column {
                    product[column] += value * x[row];
                }
            }
        }
        product
    }
}

impl ColumnMut<'_> {
    /// Sets everything to zero.
    pub(crate) fn clear(&mut self) {
        self.values.fill(0.0);
    }

    /// A writer for each block of the column, in the order of `rows`.
    pub(crate) fn for_each_block(&mut self, mut write: impl FnMut(usize, &mut BlockMut<'_>)) {
        let mut offset = 0;
        for &row in self.rows {
            let mut block =
                BlockMut { values: self.values, height: self.height, offset, diagonal: row == self.position };
            write(row, &mut block);
            offset += self.dims[row];
        }
    }
}

/// One block, to be written.
pub(crate) struct BlockMut<'a> {
    values: &'a mut [f64],
    height: usize,
    offset: usize,
    diagonal: bool,
}

impl BlockMut<'_> {
    /// Adds `value` at a row and column of the block; above the diagonal it is left out.
    #[inline]
    pub(crate) fn add(&mut self, row: usize, column: usize, value: f64) {
        if self.diagonal && row < column {
            return;
        }
        // Column c of the lower triangle is c entries shorter than the first.
        let column_start = column * self.height - column * column.saturating_sub(1) / 2;
        self.values[column_start + self.offset + row - column] += value;
    }
}
