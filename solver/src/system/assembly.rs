//! From linearised measurements to normal equations.
//!
//! Every block of the normal matrix knows beforehand which measurements contribute to it and sums
//! them in their order: no lock, no race, the same sum on any number of threads.

use super::accumulators::Linear;
use super::group::AnyGroup;
use super::layout::{BlockId, Layout};
use crate::linear::matrix::{BlockMatrix, Pattern};
use crate::manifold::MAX_TANGENT;
use rayon::prelude::*;

/// One measurement's share of a block: `J_row^T J_column`.
#[derive(Clone, Copy, Default)]
struct Share {
    item: u32,
    group: u16,
    /// First Jacobian column of the row's and of the column's block.
    row_at: u8,
    column_at: u8,
}

/// For each block of the matrix, in storage order, its shares.
pub(super) struct Gather {
    /// First block of each block column.
    column_starts: Vec<usize>,
    /// First share of each block, and their number at the end.
    share_starts: Vec<usize>,
    shares: Vec<Share>,
    /// Whether any measurement of a group contributes.
    takes_part: Vec<bool>,
}

impl Gather {
    /// For the measurements that are not taken care of elsewhere.
    pub(super) fn new(
        matrix: &Pattern,
        groups: &[Box<dyn AnyGroup>],
        position: &[Option<usize>],
        is_taken: &dyn Fn(usize, &[BlockId]) -> bool,
    ) -> Self {
        let mut column_starts = vec![0];
        matrix
            .rows()
            .iter()
            .for_each(|rows| column_starts.push(column_starts[column_starts.len() - 1] + rows.len()));
        let block_at = |row: usize, column: usize| {
            let found = matrix.rows()[column].binary_search(&row).expect("in the pattern");
            column_starts[column] + found
        };
        // Calls `give` for every share, in the order of the measurements.
        let for_each_share = |give: &mut dyn FnMut(usize, Share)| {
            for (group_index, group) in groups.iter().enumerate() {
                let starts = group.column_starts();
                for item in 0..group.len() {
                    let blocks = group.blocks(item);
                    if is_taken(group_index, blocks) {
                        continue;
                    }
                    for (i, a) in blocks.iter().enumerate() {
                        for (j, b) in blocks.iter().enumerate() {
                            let (Some(row), Some(column)) = (position[a.0], position[b.0]) else {
                                continue;
                            };
                            if row < column || (row == column && i != j) {
                                continue;
                            }
                            give(
                                block_at(row, column),
                                Share {
                                    item: u32::try_from(item).expect("fewer than 2^32 measurements"),
                                    group: u16::try_from(group_index).expect("few groups"),
                                    row_at: starts[i] as u8,
                                    column_at: starts[j] as u8,
                                },
                            );
                        }
                    }
                }
            }
        };
        let mut share_starts = vec![0; column_starts[column_starts.len() - 1] + 1];
        for_each_share(&mut |block, _| share_starts[block + 1] += 1);
        for block in 1..share_starts.len() {
            share_starts[block] += share_starts[block - 1];
        }
        let takes_part = |index: usize, group: &dyn AnyGroup| {
            (0..group.len()).any(|item| !is_taken(index, group.blocks(item)))
        };
        let takes_part =
            groups.iter().enumerate().map(|(index, group)| takes_part(index, &**group)).collect();
        let mut next = share_starts.clone();
        let mut shares = vec![Share::default(); share_starts[share_starts.len() - 1]];
        for_each_share(&mut |block, share| {
            shares[next[block]] = share;
            next[block] += 1;
        });
        Gather { column_starts, share_starts, shares, takes_part }
    }

    /// Whether any measurement of a group contributes.
    pub(super) fn takes_part(&self, group: usize) -> bool {
        self.takes_part[group]
    }

    /// Sums the normal matrix and the gradient.
    pub(super) fn assemble(&self, linear: &[Option<Linear>], matrix: &mut BlockMatrix, gradient: &mut [f64]) {
        let dims: Vec<usize> = (0..matrix.rows().len()).map(|p| matrix.range(p).len()).collect();
        let gradients = split_by(gradient, &dims);
        matrix.columns_mut().into_par_iter().zip(gradients).for_each(|(mut column, gradient)| {
            column.clear();
            gradient.fill(0.0);
            let position = column.position;
            let mut block_index = self.column_starts[position];
            column.for_each_block(|row, block| {
                let shares = &self.shares[self.share_starts[block_index]..self.share_starts[block_index + 1]];
                block_index += 1;
                let (height, width) = (dims[row], dims[position]);
                let mut sum = [0.0; MAX_TANGENT * MAX_TANGENT];
                for share in shares {
                    let linear = linear[share.group as usize].as_ref().expect("a group that takes part");
                    let (a, b) = (
                        linear.columns_of(share, share.row_at, height),
                        linear.columns_of(share, share.column_at, width),
                    );
                    match linear.rows {
                        2 => add_product::<2>(a, b, &mut sum),
                        3 => add_product::<3>(a, b, &mut sum),
                        rows => add_product_of(rows, a, b, &mut sum),
                    }
                    if row == position {
                        let residual = &linear.residuals[share.item as usize * linear.rows..][..linear.rows];
                        for (out, column) in gradient.iter_mut().zip(b.chunks_exact(linear.rows)) {
                            *out += dot(column, residual);
                        }
                    }
                }
                for c in 0..width {
                    for r in 0..height {
                        block.add(r, c, sum[c * height + r]);
                    }
                }
            });
        });
    }

    /// `J^T z` of one group.
    pub(super) fn transposed_product(
        group: &dyn AnyGroup,
        linear: &Linear,
        z: &[f64],
        layout: &Layout,
    ) -> Vec<f64> {
        let starts = group.column_starts();
        let mut product = vec![0.0; layout.size()];
        for item in 0..group.len() {
            let z = &z[item * linear.rows..][..linear.rows];
            for (block, start) in group.blocks(item).iter().zip(&starts) {
                let Some(range) = layout.range_of(*block) else { continue };
                let columns = &linear.jacobians[(item * linear.columns + start) * linear.rows..];
                for (out, column) in product[range].iter_mut().zip(columns.chunks_exact(linear.rows)) {
                    *out += dot(column, z);
                }
            }
        }
        product
    }
}

impl Linear {
    fn columns_of(&self, share: &Share, start: u8, count: usize) -> &[f64] {
        let first = share.item as usize * self.columns + start as usize;
        &self.jacobians[first * self.rows..][..count * self.rows]
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[inline(always)]
fn add_product_of(rows: usize, a: &[f64], b: &[f64], sum: &mut [f64]) {
    let height = a.len() / rows;
    for (b, out) in b.chunks_exact(rows).zip(sum.chunks_mut(height)) {
        for (a, out) in a.chunks_exact(rows).zip(out) {
            *out += dot(a, b);
        }
    }
}

fn add_product<const ROWS: usize>(a: &[f64], b: &[f64], sum: &mut [f64]) {
    add_product_of(ROWS, a, b, sum);
}

/// Cuts a slice into pieces of the given lengths.
fn split_by<'a>(mut all: &'a mut [f64], lengths: &[usize]) -> Vec<&'a mut [f64]> {
    let mut pieces = Vec::with_capacity(lengths.len());
    for &length in lengths {
        let (piece, rest) = all.split_at_mut(length);
        pieces.push(piece);
        all = rest;
    }
    pieces
}
