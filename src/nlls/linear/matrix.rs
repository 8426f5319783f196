//! A symmetric matrix of small dense blocks, lower triangle, in elimination order.

use super::ordering::{self, Ordering};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMat};

/// Pattern and values. Positions are places in the elimination order.
#[derive(Clone, Debug)]
pub struct BlockMatrix {
    ordering: Ordering,
    position: Vec<usize>,
    /// Size of the block at each position.
    dims: Vec<usize>,
    /// First scalar index of the block at each position, and the size of the matrix at the end.
    starts: Vec<usize>,
    /// Positions of the blocks in each block column, diagonal first, sorted.
    rows: Vec<Vec<usize>>,
    /// Where each block column begins in `values`, and their number at the end.
    value_starts: Vec<usize>,
    symbolic: SymbolicSparseColMat<usize>,
    values: Vec<f64>,
}

/// One block column, to be written.
pub struct ColumnMut<'a> {
    /// Position of the column.
    pub position: usize,
    /// Positions of its blocks, diagonal first, sorted.
    pub rows: &'a [usize],
    dims: &'a [usize],
    height: usize,
    values: &'a mut [f64],
}

impl BlockMatrix {
    /// A zero matrix with a diagonal block for each of `dims` and a block for each pair that shares
    /// a measurement. The elimination order is the cheapest known.
    pub fn new(dims: &[usize], pairs: impl IntoIterator<Item = (usize, usize)>) -> Self {
        let mut neighbours: Vec<Vec<usize>> = vec![Vec::new(); dims.len()];
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
        let values = vec![0.0; row_indices.len()];
        let symbolic = SymbolicSparseColMat::new_checked(n, n, column_starts, None, row_indices);
        BlockMatrix { ordering, position, dims, starts, rows, value_starts, symbolic, values }
    }

    /// Rows and columns.
    pub fn size(&self) -> usize {
        self.starts[self.starts.len() - 1]
    }

    /// The elimination order and what it costs.
    pub fn ordering(&self) -> &Ordering {
        &self.ordering
    }

    /// Position of a block in the elimination order.
    pub fn position(&self, block: usize) -> usize {
        self.position[block]
    }

    /// The scalar indices of the block at a position.
    pub fn range(&self, position: usize) -> std::ops::Range<usize> {
        self.starts[position]..self.starts[position + 1]
    }

    /// For each column its block rows, diagonal first, sorted.
    pub fn rows(&self) -> &[Vec<usize>] {
        &self.rows
    }

    /// Every block column, to be written independently of the others.
    pub fn columns_mut(&mut self) -> Vec<ColumnMut<'_>> {
        let mut left = self.values.as_mut_slice();
        let mut columns = Vec::with_capacity(self.dims.len());
        for (position, rows) in self.rows.iter().enumerate() {
            let length = self.value_starts[position + 1] - self.value_starts[position];
            let (values, rest) = left.split_at_mut(length);
            left = rest;
            let height = rows.iter().map(|&row| self.dims[row]).sum();
            columns.push(ColumnMut { position, rows, dims: &self.dims, height, values });
        }
        columns
    }

    /// The diagonal, by scalar index.
    pub fn diagonal(&self) -> Vec<f64> {
        let starts = &self.symbolic.col_ptr()[..self.size()];
        starts.iter().map(|&start| self.values[start]).collect()
    }

    /// Sets one entry of the diagonal, by scalar index.
    pub fn set_diagonal(&mut self, index: usize, value: f64) {
        self.values[self.symbolic.col_ptr()[index]] = value;
    }

    /// Copies the values of `other`, which has the same pattern, adding `extra` to the diagonal.
    pub fn copy_with_diagonal(&mut self, other: &BlockMatrix, extra: &[f64]) {
        self.values.copy_from_slice(&other.values);
        for (start, extra) in self.symbolic.col_ptr().iter().zip(extra) {
            self.values[*start] += extra;
        }
    }

    /// The lower triangle as compressed sparse columns.
    pub fn lower(&self) -> SparseColMatRef<'_, usize, f64> {
        SparseColMatRef::new(self.symbolic.as_ref(), &self.values)
    }

    /// `self * x` for the whole symmetric matrix.
    pub fn multiply(&self, x: &[f64]) -> Vec<f64> {
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
    pub fn clear(&mut self) {
        self.values.fill(0.0);
    }

    /// A writer for each block of the column, in the order of `rows`.
    pub fn for_each_block(&mut self, mut write: impl FnMut(usize, &mut BlockMut<'_>)) {
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
pub struct BlockMut<'a> {
    values: &'a mut [f64],
    height: usize,
    offset: usize,
    diagonal: bool,
}

impl BlockMut<'_> {
    /// Adds `value` at a row and column of the block; above the diagonal it is left out.
    #[inline]
    pub fn add(&mut self, row: usize, column: usize, value: f64) {
        if self.diagonal && row < column {
            return;
        }
        // Column c of the lower triangle is c entries shorter than the first.
        let column_start = column * self.height - column * column.saturating_sub(1) / 2;
        self.values[column_start + self.offset + row - column] += value;
    }
}
