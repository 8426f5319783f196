//! What is done with all measurements of a group, whatever their kind.

use super::accumulators::{CommonLinear, Linear};
use super::group::{AnyGroup, IMPOSSIBLE_SIGMAS};
use super::layout::{BlockId, Layout, Values};
use super::model::Cost;
use nalgebra::DMatrix;
use rayon::prelude::*;

/// Measurements that one task works on; fixed, so that sums do not depend on the threads.
const CHUNK: usize = 512;
/// Tasks that sum what is common to all frames; likewise.
const COMMON_CHUNKS: usize = 8;

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).fold(0.0, |sum, (a, b)| sum + a * b)
}

/// Some measurements, linearised, one by one.
struct Linearised<'a> {
    group: &'a dyn AnyGroup,
    layout: &'a Layout,
    values: &'a Values,
    least_flatness: f64,
    /// Those of the last measurement.
    residual: Vec<f64>,
    jacobian: Vec<f64>,
}

impl<'a> Linearised<'a> {
    fn new(group: &'a dyn AnyGroup, layout: &'a Layout, values: &'a Values, least_flatness: f64) -> Self {
        let rows = group.rows();
        let (residual, jacobian) = (vec![0.0; rows], vec![0.0; rows * group.columns()]);
        Linearised { group, layout, values, least_flatness, residual, jacobian }
    }

    /// The weighted residual of an item and its Jacobian, column after column.
    fn at(&mut self, item: usize) -> (&[f64], &[f64]) {
        let Linearised { group, layout, values, least_flatness, residual, jacobian } = self;
        group.linearise_from(item, layout, values, *least_flatness, residual, jacobian);
        (residual, jacobian)
    }
}

impl dyn AnyGroup + '_ {
    /// Columns of a Jacobian.
    fn columns(&self) -> usize {
        self.manifolds().iter().map(|manifold| manifold.tangent()).sum()
    }

    /// First Jacobian column of each block.
    pub(super) fn column_starts(&self) -> Vec<usize> {
        let tangents = self.manifolds().iter().map(|manifold| manifold.tangent());
        tangents
            .scan(0, |next, tangent| {
                let start = *next;
                *next += tangent;
                Some(start)
            })
            .collect()
    }

    /// What is made of the whitened residuals of each chunk of items, in their order; NaN where one is impossible.
    fn of_chunks<T: Send>(
        &self,
        layout: &Layout,
        values: &Values,
        of_chunk: &(dyn Fn(&[f64]) -> T + Sync),
    ) -> Vec<T> {
        let count = self.len();
        let work = |chunk: usize| {
            let items = CHUNK.min(count - chunk * CHUNK);
            let mut residuals = vec![0.0; items * self.rows()];
            self.residuals_from(chunk * CHUNK, layout, values, &mut residuals);
            of_chunk(&residuals)
        };
        (0..count.div_ceil(CHUNK)).into_par_iter().map(work).collect()
    }

    pub(super) fn cost(&self, layout: &Layout, values: &Values) -> Cost {
        let (rows, loss) = (self.rows(), self.loss());
        let parts = self.of_chunks(layout, values, &|residuals| {
            let mut cost = Cost::default();
            for residual in residuals.chunks_exact(rows) {
                let squared = match squared_norm(residual) {
                    Some(squared) => squared,
                    None => {
                        cost.impossible += 1;
                        IMPOSSIBLE_SIGMAS * IMPOSSIBLE_SIGMAS
                    }
                };
                cost.value += 0.5 * loss.rho(squared)[0];
            }
            cost
        });
        Cost {
            value: parts.iter().map(|part| part.value).sum(),
            impossible: parts.iter().map(|part| part.impossible).sum(),
        }
    }

    pub(super) fn squared_norms(&self, layout: &Layout, values: &Values) -> Vec<Option<f64>> {
        let of_chunk = |residuals: &[f64]| -> Vec<Option<f64>> {
            residuals.chunks_exact(self.rows()).map(squared_norm).collect()
        };
        self.of_chunks(layout, values, &of_chunk).concat()
    }

    pub(super) fn residuals(&self, layout: &Layout, values: &Values) -> Vec<Option<Vec<f64>>> {
        let of_item = |residual: &[f64]| (!residual[0].is_nan()).then(|| residual.to_vec());
        let of_chunk = |residuals: &[f64]| -> Vec<Option<Vec<f64>>> {
            residuals.chunks_exact(self.rows()).map(of_item).collect()
        };
        self.of_chunks(layout, values, &of_chunk).into_iter().flatten().collect()
    }

    /// Room for a linearisation.
    pub(super) fn linear(&self) -> Linear {
        let (rows, columns) = (self.rows(), self.columns());
        let residuals = vec![0.0; self.len() * rows];
        Linear { rows, columns, jacobians: vec![0.0; residuals.len() * columns], residuals }
    }

    pub(super) fn linearise(
        &self,
        layout: &Layout,
        values: &Values,
        least_flatness: f64,
        linear: &mut Linear,
    ) {
        let size = CHUNK * linear.rows;
        let residuals = linear.residuals.par_chunks_mut(size);
        let jacobians = linear.jacobians.par_chunks_mut(size * linear.columns);
        residuals.zip(jacobians).enumerate().for_each(|(chunk, (residuals, jacobians))| {
            self.linearise_from(chunk * CHUNK, layout, values, least_flatness, residuals, jacobians);
        });
    }

    /// Adds what measurements say of the unknowns that are common to all.
    pub(super) fn add_common(
        &self,
        layout: &Layout,
        values: &Values,
        least_flatness: f64,
        sums: &mut CommonLinear,
    ) {
        let sees = |item: &usize| self.blocks(*item).iter().any(|b| layout.common.has(b.0));
        let count = self.len();
        if !(0..count).any(|item| sees(&item)) {
            return;
        }
        let (size, starts) = (count.div_ceil(COMMON_CHUNKS), self.column_starts());
        let of_chunk = |chunk: usize| {
            let mut sums = CommonLinear::zeros(layout.others, layout.common.size());
            let mut linearised = Linearised::new(self, layout, values, least_flatness);
            for item in (chunk * size..count.min((chunk + 1) * size)).filter(sees) {
                add_one_to_common(self.blocks(item), &starts, layout, linearised.at(item), &mut sums);
            }
            sums
        };
        let parts: Vec<CommonLinear> = (0..count.div_ceil(size)).into_par_iter().map(of_chunk).collect();
        for part in parts {
            sums.coupling += part.coupling;
            sums.own += part.own;
            sums.gradient += part.gradient;
        }
    }

    /// Adds `J^T J` by each block alone to its sum.
    pub(super) fn add_own(&self, layout: &Layout, values: &Values, sums: &mut [DMatrix<f64>]) {
        let (rows, starts) = (self.rows(), self.column_starts());
        let mut linearised = Linearised::new(self, layout, values, 1.0);
        for item in 0..self.len() {
            let (_, jacobian) = linearised.at(item);
            for ((block, manifold), start) in self.blocks(item).iter().zip(self.manifolds()).zip(&starts) {
                let column = |column: usize| &jacobian[(start + column) * rows..][..rows];
                let sum = &mut sums[block.0];
                for j in 0..manifold.tangent() {
                    for i in 0..manifold.tangent() {
                        sum[(i, j)] += dot(column(i), column(j));
                    }
                }
            }
        }
    }

    /// `J x`, whitened and weighted, row by row.
    pub(super) fn product(&self, layout: &Layout, values: &Values, x: &[f64]) -> Vec<f64> {
        let (rows, starts) = (self.rows(), self.column_starts());
        let mut product = vec![0.0; self.len() * rows];
        product.par_chunks_mut(CHUNK * rows).enumerate().for_each(|(chunk, out)| {
            let mut linearised = Linearised::new(self, layout, values, 1.0);
            for (item, out) in (chunk * CHUNK..).zip(out.chunks_exact_mut(rows)) {
                let (_, jacobian) = linearised.at(item);
                for (block, start) in self.blocks(item).iter().zip(&starts) {
                    let Some(range) = layout.range_of(*block) else { continue };
                    for (x, column) in x[range].iter().zip(jacobian[start * rows..].chunks_exact(rows)) {
                        out.iter_mut().zip(column).for_each(|(out, by_x)| *out += by_x * x);
                    }
                }
            }
        });
        product
    }
}

/// Of a residual; `None` where it has no value.
fn squared_norm(residual: &[f64]) -> Option<f64> {
    let squared = dot(residual, residual);
    (!squared.is_nan()).then_some(squared)
}

/// Adds the weighted residual and Jacobian of one measurement; `starts` has the first column of each block.
fn add_one_to_common(
    blocks: &[BlockId],
    starts: &[usize],
    layout: &Layout,
    (residual, jacobian): (&[f64], &[f64]),
    sums: &mut CommonLinear,
) {
    let rows = residual.len();
    let column = |at: usize| &jacobian[at * rows..][..rows];
    let columns = |block: BlockId, start: usize| (start..start + layout.free(block).len()).map(column);
    for (common, first) in blocks.iter().zip(starts) {
        let Some(start_of_common) = layout.common.start_of(common.0) else { continue };
        for (at, own) in (start_of_common..).zip(columns(*common, *first)) {
            sums.gradient[at] += dot(own, residual);
            for (block, first) in blocks.iter().zip(starts) {
                if let Some(start) = layout.common.start_of(block.0) {
                    for (i, by_block) in (start..).zip(columns(*block, *first)) {
                        sums.own[(i, at)] += dot(by_block, own);
                    }
                } else if let Some(range) = layout.range_of(*block) {
                    for (i, by_block) in range.zip(columns(*block, *first)) {
                        sums.coupling[(i, at)] += dot(by_block, own);
                    }
                }
            }
        }
    }
}
