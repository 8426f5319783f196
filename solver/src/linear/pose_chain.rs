//! Poses of one body along time: a block band matrix whose blocks are all 6 x 6.
//!
//! ```text
//!    y0  y1  y2  ...   s
//!  [ H00 .   .       | W0 ]      chain  H = L L^T
//!  [ H10 H11 .       | W1 ]      border S = B - W^T H^-1 W = B - sum Z_t^T Z_t,   L Z = W
//!  [ H20 H21 H22     | W2 ]
//!  [     ...         | .. ]
//!  [ W0' W1' W2' ... | B  ]
//! ```
//!
//! Where a step has one pose that the border sees whole, `Z_t` has rank 6 as it is, and nothing of the
//! filter of [`super::chain`] is needed.

use super::cholesky::Singular;
use super::coupling::Coupling;
use super::small::{POSE, axpy};
use super::tiles::TiledCholesky;
use nalgebra::{DMatrix, Matrix6};
use pulp::{Arch, Simd, WithSimd};

/// Steps whose columns are collected before the border is updated.
const PANEL_STEPS: usize = 64;

/// A symmetric block band matrix, lower triangle, or its factor.
#[derive(Clone, Debug)]
pub(crate) struct PoseChain {
    band: usize,
    /// `blocks[t * (band + 1) + k]`: row step `t + k`, column step `t`.
    blocks: Vec<Matrix6<f64>>,
}

impl PoseChain {
    /// Zeros.
    pub(crate) fn new(steps: usize, band: usize) -> Self {
        PoseChain { band, blocks: vec![Matrix6::zeros(); steps * (band + 1)] }
    }

    /// How many steps.
    pub(crate) fn steps(&self) -> usize {
        self.blocks.len() / (self.band + 1)
    }

    /// To how many next steps a step is coupled at the most.
    pub(crate) fn band(&self) -> usize {
        self.band
    }

    /// Unknowns.
    pub(crate) fn size(&self) -> usize {
        POSE * self.steps()
    }

    /// Sets everything to zero.
    pub(crate) fn clear(&mut self) {
        self.blocks.fill(Matrix6::zeros());
    }

    /// Takes the values of another chain of the same shape.
    pub(crate) fn copy_from(&mut self, other: &PoseChain) {
        self.blocks.copy_from_slice(&other.blocks);
    }

    /// The block at row step `column + k`.
    pub(crate) fn block(&self, column: usize, k: usize) -> &Matrix6<f64> {
        &self.blocks[column * (self.band + 1) + k]
    }

    /// The block at row step `column + k`. Of diagonal blocks both triangles are kept.
    pub(crate) fn block_mut(&mut self, column: usize, k: usize) -> &mut Matrix6<f64> {
        &mut self.blocks[column * (self.band + 1) + k]
    }

    /// Blocks below and on the diagonal in a column.
    fn below(&self, column: usize) -> usize {
        self.band.min(self.steps() - 1 - column)
    }

    /// Replaces the matrix by its factor `L`.
    pub(crate) fn factorise(&mut self) -> Result<(), Singular> {
        for t in 0..self.steps() {
            let below = self.below(t);
            for j in 1..=self.band.min(t) {
                let row = self.block(t - j, j).transpose();
                for k in 0..=below {
                    if j + k <= self.band {
                        let product = self.block(t - j, j + k) * row;
                        *self.block_mut(t, k) -= product;
                    }
                }
            }
            let factor = self.block(t, 0).cholesky().ok_or(Singular)?.unpack();
            for k in 1..=below {
                let block = self.block_mut(t, k);
                let mut transposed = block.transpose();
                factor.solve_lower_triangular_mut(&mut transposed);
                *block = transposed.transpose();
            }
            *self.block_mut(t, 0) = factor;
        }
        Ok(())
    }

    /// Solves `H x = b` in place for the columns of `b`, after the factorisation.
    pub(crate) fn solve(&self, b: &mut DMatrix<f64>) {
        for mut column in b.column_iter_mut() {
            let x = column.as_mut_slice().as_chunks_mut::<POSE>().0;
            for t in 0..x.len() {
                forward(self.block(t, 0), &mut x[t]);
                for k in 1..=self.below(t) {
                    let own = x[t];
                    add(-1.0, self.block(t, k), &own, &mut x[t + k]);
                }
            }
            for t in (0..x.len()).rev() {
                for k in 1..=self.below(t) {
                    let later = x[t + k];
                    add_transposed(-1.0, self.block(t, k), &later, &mut x[t]);
                }
                backward(self.block(t, 0), &mut x[t]);
            }
        }
    }

    /// `H x`, before the factorisation.
    pub(crate) fn multiply(&self, x: &DMatrix<f64>) -> DMatrix<f64> {
        let mut product = DMatrix::zeros(x.nrows(), x.ncols());
        for (x, mut out) in x.column_iter().zip(product.column_iter_mut()) {
            let x = x.as_slice().as_chunks::<POSE>().0;
            let out = out.as_mut_slice().as_chunks_mut::<POSE>().0;
            for t in 0..x.len() {
                add(1.0, self.block(t, 0), &x[t], &mut out[t]);
                for k in 1..=self.below(t) {
                    add(1.0, self.block(t, k), &x[t], &mut out[t + k]);
                    add_transposed(1.0, self.block(t, k), &x[t + k], &mut out[t]);
                }
            }
        }
        product
    }

    /// Subtracts `W^T H^-1 W` from the lower triangle of `border`, after the factorisation.
    pub(crate) fn reduce(&self, coupling: &Coupling, border: &mut TiledCholesky) {
        let m = border.size();
        if m == 0 {
            return;
        }
        // Z^T of the steps of a panel, after those of the last steps of the one before.
        let width = POSE * m;
        let mut panel = vec![0.0; (self.band + PANEL_STEPS) * width];
        let mut first = 0;
        while first < self.steps() {
            let count = PANEL_STEPS.min(self.steps() - first);
            Arch::new().dispatch(Panel { chain: self, coupling, m, first, count, panel: &mut panel });
            border.subtract_whole(&panel[self.band * width..][..count * width], count * POSE);
            panel.copy_within(count * width..(count + self.band) * width, 0);
            first += count;
        }
    }
}

/// `Z^T` of some steps.
struct Panel<'a> {
    chain: &'a PoseChain,
    coupling: &'a Coupling,
    m: usize,
    first: usize,
    count: usize,
    panel: &'a mut [f64],
}

impl WithSimd for Panel<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Panel { chain, coupling, m, first, count, panel } = self;
        let width = POSE * m;
        for step in 0..count {
            let t = first + step;
            let (earlier, own) = panel.split_at_mut((chain.band + step) * width);
            let own = &mut own[..width];
            own.fill(0.0);
            coupling.add_columns(t, 0..m, own);
            for j in 1..=chain.band.min(t) {
                let before = &earlier[(chain.band + step - j) * width..][..width];
                let block = chain.block(t - j, j);
                for c in 0..POSE {
                    for d in 0..POSE {
                        axpy(-block[(c, d)], &before[d * m..][..m], &mut own[c * m..][..m]);
                    }
                }
            }
            let factor = chain.block(t, 0);
            for c in 0..POSE {
                let (done, rest) = own.split_at_mut(c * m);
                let column = &mut rest[..m];
                for d in 0..c {
                    axpy(-factor[(c, d)], &done[d * m..][..m], column);
                }
                let scale = 1.0 / factor[(c, c)];
                column.iter_mut().for_each(|v| *v *= scale);
            }
        }
    }
}

#[inline(always)]
fn forward(factor: &Matrix6<f64>, x: &mut [f64; POSE]) {
    for i in 0..POSE {
        for j in 0..i {
            x[i] -= factor[(i, j)] * x[j];
        }
        x[i] /= factor[(i, i)];
    }
}

#[inline(always)]
fn backward(factor: &Matrix6<f64>, x: &mut [f64; POSE]) {
    for i in (0..POSE).rev() {
        for j in i + 1..POSE {
            x[i] -= factor[(j, i)] * x[j];
        }
        x[i] /= factor[(i, i)];
    }
}

/// `out += sign * block * x`
#[inline(always)]
fn add(sign: f64, block: &Matrix6<f64>, x: &[f64; POSE], out: &mut [f64; POSE]) {
    for j in 0..POSE {
        for i in 0..POSE {
            out[i] += sign * block[(i, j)] * x[j];
        }
    }
}

/// `out += sign * block^T * x`
#[inline(always)]
fn add_transposed(sign: f64, block: &Matrix6<f64>, x: &[f64; POSE], out: &mut [f64; POSE]) {
    for i in 0..POSE {
        for j in 0..POSE {
            out[i] += sign * block[(j, i)] * x[j];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::coupling;
    use super::*;

    /// A positive definite chain and its dense copy.
    fn example(steps: usize, band: usize) -> (PoseChain, DMatrix<f64>) {
        let mut chain = PoseChain::new(steps, band);
        let n = chain.size();
        let mut dense = DMatrix::identity(n, n) * (0.5 + 6.0 * (band + 1) as f64);
        for t in 0..steps {
            for k in 0..=band.min(steps - 1 - t) {
                for i in 0..POSE {
                    for j in 0..POSE {
                        let value = ((t * 31 + k * 17 + i * 5 + j * 3) as f64 * 0.77).sin();
                        if k > 0 {
                            dense[(POSE * (t + k) + i, POSE * t + j)] = value;
                            dense[(POSE * t + j, POSE * (t + k) + i)] = value;
                        } else if i <= j {
                            dense[(POSE * t + i, POSE * t + j)] += value;
                            if i < j {
                                dense[(POSE * t + j, POSE * t + i)] += value;
                            }
                        }
                    }
                }
                let block = dense.fixed_view::<POSE, POSE>(POSE * (t + k), POSE * t).into_owned();
                *chain.block_mut(t, k) = block;
            }
        }
        (chain, dense)
    }

    #[test]
    fn a_band_is_multiplied_solved_and_reduced_as_a_dense_matrix() {
        // More steps than a panel has.
        for (steps, band) in [(1, 2), (3, 0), (7, 1), (9, 2), (9, 4), (2 * PANEL_STEPS + 5, 2)] {
            let (mut chain, dense) = example(steps, band);
            let n = chain.size();
            let b = DMatrix::from_fn(n, 3, |i, j| ((i * 3 + j) as f64).sin());
            assert!((chain.multiply(&b) - &dense * &b).norm() < 1e-13 * b.norm() * dense.norm());
            chain.factorise().unwrap();
            let inverse = dense.cholesky().unwrap().inverse();
            let mut x = b.clone();
            chain.solve(&mut x);
            let wanted = &inverse * &b;
            assert!((&x - &wanted).norm() < 1e-12 * wanted.norm(), "{steps} {band}");

            let (coupling, dense) = coupling::tests::example(steps, 4);
            let (w, m) = (dense.transpose(), dense.nrows());
            let wanted = w.transpose() * &inverse * &w;
            let mut border = TiledCholesky::new(m, 0.0).unwrap();
            chain.reduce(&coupling, &mut border);
            for column in 0..m {
                for row in column..m {
                    let gap = (border.entry(row, column) + wanted[(row, column)]).abs();
                    assert!(gap < 1e-11 * wanted.norm(), "{steps} {band}: {row} {column} {gap:e}");
                }
            }
        }
    }

    #[test]
    fn an_indefinite_chain_is_singular() {
        let (mut chain, _) = example(3, 1);
        chain.block_mut(1, 0)[(2, 2)] -= 100.0;
        assert_eq!(chain.factorise(), Err(Singular));
    }
}
