//! Elimination of poses along time, where what is seen depends on part of them only.
//!
//! The unknowns of step `t` are `x_t = (c_t, y_t)`. Steps are coupled to at most `band` next ones, and
//! a border of many unknowns `s` sees the `y_t` alone:
//!
//! ```text
//!    x0  x1  x2  ...   s
//!  [ H00 .   .       | W0 ]      chain  H = L L^T, block band
//!  [ H10 H11 .       | W1 ]      border S = B - W^T [H^-1]_yy W
//!  [ H20 H21 H22     | W2 ]
//!  [     ...         | .. ]
//!  [ W0' W1' W2' ... | B  ]
//! ```
//!
//! `W^T [H^-1]_yy W` costs most. `L^-1 W` has as many rows as the chain has unknowns; but `[H^-1]_yy`
//! is the covariance of the `y_t` alone, and has a factor of its own, as narrow as they are: that of
//! their innovations. Run backwards, the chain is a Markov process,
//!
//! ```text
//! L_tt^T x_t = z_t - sum_s L_st^T x_s      s = t+1 .. t+band,  z white
//! ```
//!
//! and a Kalman filter that observes every `y_t` without error writes `y_t` as what the later ones
//! predict plus an innovation `e_t` of covariance `R_t R_t^T`. With the adjoint of that filter run
//! forwards over `W`, the border loses `sum (a_t R_t)(a_t R_t)^T`, `a_t` the adjoint of `e_t`. For one
//! vehicle under one camera this halves the work.

use super::cholesky::Singular;
use super::coupling::Coupling;
use super::small::{POSE, axpy, dot};
use super::tiles::{TILE, TiledCholesky};
use nalgebra::DMatrix;
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

/// Columns that are collected before the border is updated.
const PANEL_COLUMNS: usize = 192;

/// A block band matrix in steps, lower triangle.
#[derive(Clone, Debug)]
pub(crate) struct Chain {
    /// Unknowns `(c, y)` of each step.
    dims: Vec<(usize, usize)>,
    /// First scalar of each step, and their number at the end.
    starts: Vec<usize>,
    band: usize,
    /// `blocks[t][k]`: row step `t + k`, column step `t`; the factor after [`Chain::factorise`].
    blocks: Vec<Vec<DMatrix<f64>>>,
}

impl Chain {
    /// Zeros.
    pub(crate) fn new(dims: Vec<(usize, usize)>, band: usize) -> Self {
        let mut starts = vec![0];
        dims.iter().for_each(|(c, y)| starts.push(starts[starts.len() - 1] + c + y));
        let size = |t: usize| dims[t].0 + dims[t].1;
        let block = |t: usize, k: usize| DMatrix::zeros(size(t + k), size(t));
        let column = |t: usize| (0..=band.min(dims.len() - 1 - t)).map(|k| block(t, k)).collect();
        let blocks = (0..dims.len()).map(column).collect();
        Chain { dims, starts, band, blocks }
    }

    /// Unknowns.
    pub(crate) fn size(&self) -> usize {
        self.starts[self.starts.len() - 1]
    }

    /// First scalar of a step.
    pub(crate) fn start(&self, step: usize) -> usize {
        self.starts[step]
    }

    /// Behind the last scalar of a step.
    pub(crate) fn end(&self, step: usize) -> usize {
        self.starts[step + 1]
    }

    /// Sets everything to zero.
    pub(crate) fn clear(&mut self) {
        self.blocks.iter_mut().flatten().for_each(|block| block.fill(0.0));
    }

    /// The block at row step `column + k`.
    pub(crate) fn block_mut(&mut self, column: usize, k: usize) -> &mut DMatrix<f64> {
        &mut self.blocks[column][k]
    }

    /// Replaces the matrix by its factor `L`. Of diagonal blocks the lower triangle counts.
    pub(crate) fn factorise(&mut self) -> Result<(), Singular> {
        for t in 0..self.dims.len() {
            let (before, rest) = self.blocks.split_at_mut(t);
            let column = &mut rest[0];
            for j in 1..=self.band.min(t) {
                let earlier = &before[t - j];
                let row = &earlier[j];
                for (k, block) in column.iter_mut().enumerate() {
                    if let Some(below) = earlier.get(j + k) {
                        block.gemm(-1.0, below, &row.transpose(), 1.0);
                    }
                }
            }
            let factor = column[0].clone().cholesky().ok_or(Singular)?.unpack();
            for block in &mut column[1..] {
                // A L^-T
                let mut transposed = block.transpose();
                let solved = factor.solve_lower_triangular_mut(&mut transposed);
                debug_assert!(solved);
                *block = transposed.transpose();
            }
            column[0] = factor;
        }
        Ok(())
    }

    /// Solves `H x = b` in place for the columns of `b`, after the factorisation.
    pub(crate) fn solve(&self, b: &mut DMatrix<f64>) {
        struct Work<'a>(&'a Chain, &'a mut [f64]);
        impl WithSimd for Work<'_> {
            type Output = ();
            #[inline(always)]
            fn with_simd<S: Simd>(self, _: S) {
                self.0.solve_column(self.1);
            }
        }
        let n = self.size();
        b.as_mut_slice().par_chunks_exact_mut(n.max(1)).for_each(|x| Arch::new().dispatch(Work(self, x)));
    }

    #[inline(always)]
    fn solve_column(&self, x: &mut [f64]) {
        for (t, column) in self.blocks.iter().enumerate() {
            let (own, later) = x[self.starts[t]..].split_at_mut(self.starts[t + 1] - self.starts[t]);
            let (factor, below) = column.split_first().expect("a diagonal block");
            forward(factor, own);
            let mut at = 0;
            for block in below {
                let rows = block.nrows();
                if rows > 0 {
                    for (column, own) in block.as_slice().chunks_exact(rows).zip(&*own) {
                        axpy(-own, column, &mut later[at..][..rows]);
                    }
                }
                at += rows;
            }
        }
        for (t, column) in self.blocks.iter().enumerate().rev() {
            let (own, later) = x[self.starts[t]..].split_at_mut(self.starts[t + 1] - self.starts[t]);
            let (factor, below) = column.split_first().expect("a diagonal block");
            let mut at = 0;
            for block in below {
                let rows = block.nrows();
                if rows > 0 {
                    for (column, own) in block.as_slice().chunks_exact(rows).zip(&mut *own) {
                        *own -= dot(column, &later[at..][..rows]);
                    }
                }
                at += rows;
            }
            backward(factor, own);
        }
    }

    /// Blocks of `H^-1` within `reach` steps or the band, whichever is more, laid out as those of the matrix,
    /// after the factorisation (Takahashi,
    /// Fagan and Chin, 1973): from `Z L = L^-T`, step by step from the last to the first,
    ///
    /// ```text
    /// Z_st = (delta_st L_tt^-T - sum_j Z_s,t+j L_t+j,t) L_tt^-1       j = 1 .. band
    /// ```
    pub(crate) fn selected_inverse(&self, reach: usize) -> Vec<Vec<DMatrix<f64>>> {
        let mut inverse: Vec<Vec<DMatrix<f64>>> = vec![Vec::new(); self.dims.len()];
        for (t, column) in self.blocks.iter().enumerate().rev() {
            let (factor, below) = column.split_first().expect("a diagonal block");
            let mut found = vec![DMatrix::identity(factor.nrows(), factor.nrows())];
            for k in 1..column.len().max((reach + 1).min(self.dims.len() - t)) {
                let mut sum = DMatrix::zeros(inverse[t + k][0].nrows(), factor.ncols());
                for (j, block) in (1..).zip(below) {
                    if k >= j {
                        sum.gemm(-1.0, &inverse[t + j][k - j], block, 1.0);
                    } else {
                        sum.gemm_tr(-1.0, &inverse[t + k][j - k], block, 1.0);
                    }
                }
                found.push(divided(sum, factor));
            }
            let (own, others) = found.split_first_mut().expect("a diagonal block");
            factor.tr_solve_lower_triangular_mut(own);
            for (z, block) in others.iter().zip(below) {
                own.gemm_tr(-1.0, z, block, 1.0);
            }
            let square = divided(std::mem::take(own), factor);
            *own = (&square + square.transpose()) * 0.5;
            inverse[t] = found;
        }
        inverse
    }

    /// Replaces `B` by `B H^-1`, after the factorisation: [`Chain::solve`] for rows instead of columns.
    pub(crate) fn solve_rows(&self, b: &mut DMatrix<f64>) {
        let steps = self.dims.len();
        let range = |t: usize| (self.starts[t], self.starts[t + 1] - self.starts[t]);
        for t in 0..steps {
            let (start, size) = range(t);
            let mut own = b.columns(start, size).transpose();
            self.blocks[t][0].solve_lower_triangular_mut(&mut own);
            let own = own.transpose();
            b.columns_mut(start, size).copy_from(&own);
            for (k, block) in self.blocks[t].iter().enumerate().skip(1) {
                let (start, size) = range(t + k);
                b.columns_mut(start, size).gemm(-1.0, &own, &block.transpose(), 1.0);
            }
        }
        for t in (0..steps).rev() {
            let (start, size) = range(t);
            let mut own = b.columns(start, size).into_owned();
            for (k, block) in self.blocks[t].iter().enumerate().skip(1) {
                let (start, size) = range(t + k);
                own.gemm(-1.0, &b.columns(start, size), block, 1.0);
            }
            b.columns_mut(start, size).copy_from(&divided(own, &self.blocks[t][0]));
        }
    }

    /// The filter of the `y`, after the factorisation.
    fn innovations(&self) -> Vec<Innovation> {
        let steps = self.dims.len();
        let mut filter = Vec::with_capacity(steps);
        // Root of the covariance of the c of the steps t+1 .. t+band, given the y of all later steps. (As
        // a covariance it would lose its sign to rounding within some dozens of steps.)
        let mut spread = DMatrix::<f64>::zeros(0, 0);
        for t in (0..steps).rev() {
            let (nc, ny) = self.dims[t];
            let next: Vec<usize> = (1..self.blocks[t].len()).collect();
            let l = &self.blocks[t][0];
            let (lcc, lyc, lyy) =
                (l.view((0, 0), (nc, nc)), l.view((nc, 0), (ny, nc)), l.view((nc, nc), (ny, ny)));
            // Rows y or c of L_st^T, columns c or y of all next steps.
            let part = |rows: (usize, usize), of_y: bool| -> DMatrix<f64> {
                let pick = |k: &usize| {
                    let (c, y) = self.dims[t + k];
                    let (first, count) = if of_y { (c, y) } else { (0, c) };
                    self.blocks[t][*k].view((first, rows.0), (count, rows.1)).transpose()
                };
                let parts: Vec<DMatrix<f64>> = next.iter().map(pick).collect();
                let width = parts.iter().map(|p| p.ncols()).sum();
                let mut all = DMatrix::zeros(rows.1, width);
                let mut at = 0;
                for part in &parts {
                    all.columns_mut(at, part.ncols()).copy_from(part);
                    at += part.ncols();
                }
                all
            };
            let (y_by_c, y_by_y) = (part((nc, ny), false), part((nc, ny), true));
            let (mut c_by_c, mut c_by_y) = (part((0, nc), false), part((0, nc), true));

            // Innovation of y: Lyy^T e = z - N c, and what it says of c,
            //   [ 1  -N F ]     [ U  0  ]
            //   [ 0     F ] Q = [ G  F+ ].
            let p = spread.nrows();
            let mut array = DMatrix::identity(ny + p, ny + p);
            array.view_mut((0, ny), (ny, p)).copy_from(&-(&y_by_c * &spread));
            array.view_mut((ny, ny), (p, p)).copy_from(&spread);
            let array = lower_root(array);
            let mut root = array.view((0, 0), (ny, ny)).into_owned();
            let mut gain = array.view((ny, 0), (p, ny)).transpose();
            root.tr_solve_lower_triangular_mut(&mut gain);
            let gain = gain.transpose() * lyy.transpose();
            let spread_left = array.view((ny, ny), (p, p)).into_owned();
            lyy.tr_solve_lower_triangular_mut(&mut root);
            let (mut by_c, mut by_y) = (-&y_by_c, -&y_by_y);
            lyy.tr_solve_lower_triangular_mut(&mut by_c);
            lyy.tr_solve_lower_triangular_mut(&mut by_y);

            // c, given y and the next steps.
            let mut own = -lyc.transpose();
            lcc.tr_solve_lower_triangular_mut(&mut own);
            lcc.tr_solve_lower_triangular_mut(&mut c_by_c);
            lcc.tr_solve_lower_triangular_mut(&mut c_by_y);
            let (c_by_c, c_by_y) = (-c_by_c, -c_by_y);
            // Their root is [ Lcc^-T  Psi F+ ; 0  F+ ], made square.
            let kept = (1..self.band).filter(|k| t + k < steps).map(|k| self.dims[t + k].0).sum::<usize>();
            spread = if self.band == 0 {
                DMatrix::zeros(0, 0)
            } else {
                let mut array = DMatrix::identity(nc + kept, nc + p);
                lcc.tr_solve_lower_triangular_mut(&mut array.view_mut((0, 0), (nc, nc)));
                array.view_mut((0, nc), (nc, p)).copy_from(&(&c_by_c * &spread_left));
                array.view_mut((nc, nc), (kept, p)).copy_from(&spread_left.rows(0, kept));
                lower_root(array)
            };
            filter.push(Innovation { root, by_c, by_y, gain, own, c_by_c, c_by_y });
        }
        filter.reverse();
        filter
    }

    /// Subtracts `W^T [H^-1]_yy W` from the lower triangle of the leading part of `border`. The poses of the
    /// coupling are those of all `y` in time order.
    pub(crate) fn reduce(&self, coupling: &Coupling, border: &mut TiledCholesky) {
        let m = coupling.pattern().rows();
        if m == 0 {
            return;
        }
        let filter = self.innovations();
        let mut y_starts = vec![0];
        self.dims.iter().for_each(|(_, y)| y_starts.push(y_starts[y_starts.len() - 1] + y));
        let mut pieces: Vec<Adjoint> =
            (0..m).step_by(TILE).map(|first| Adjoint::new(first, TILE.min(m - first), self.band)).collect();
        let mut panels: Vec<Vec<f64>> = vec![Vec::new(); pieces.len()];
        let steps = self.dims.len();
        let mut first = 0;
        while first < steps {
            let mut last = first + 1;
            while last < steps && y_starts[last + 1] - y_starts[first] <= PANEL_COLUMNS {
                last += 1;
            }
            let columns = y_starts[last] - y_starts[first];
            // Row pieces of the panel, each column after column.
            pieces.par_iter_mut().zip(&mut panels).for_each(|(piece, panel)| {
                panel.clear();
                for t in first..last {
                    piece.step(self, t, &filter[t], coupling, y_starts[t] / POSE, panel);
                }
            });
            if columns > 0 {
                border.subtract_pieces(&panels, columns);
            }
            first = last;
        }
    }
}

/// `L x = b`, in place.
#[inline(always)]
fn forward(factor: &DMatrix<f64>, x: &mut [f64]) {
    let n = x.len();
    for j in 0..n {
        let column = &factor.as_slice()[j * n..][..n];
        let (done, rest) = x.split_at_mut(j + 1);
        done[j] /= column[j];
        axpy(-done[j], &column[j + 1..], rest);
    }
}

/// `L^T x = b`, in place.
#[inline(always)]
fn backward(factor: &DMatrix<f64>, x: &mut [f64]) {
    let n = x.len();
    for j in (0..n).rev() {
        let column = &factor.as_slice()[j * n..][..n];
        x[j] = (x[j] - dot(&column[j + 1..], &x[j + 1..])) / column[j];
    }
}

/// `A L^-1`.
fn divided(a: DMatrix<f64>, factor: &DMatrix<f64>) -> DMatrix<f64> {
    let mut transposed = a.transpose();
    let solved = factor.tr_solve_lower_triangular_mut(&mut transposed);
    debug_assert!(solved);
    transposed.transpose()
}

/// The square lower triangle `L` with `L L^T = A A^T`, for an `A` of as many columns as rows or more.
fn lower_root(a: DMatrix<f64>) -> DMatrix<f64> {
    let rows = a.nrows();
    if rows == 0 {
        return a.columns(0, 0).into_owned();
    }
    a.transpose().qr().r().transpose().columns(0, rows).into_owned()
}

/// One step of the filter. Columns of matrices "by" are those of the next steps.
struct Innovation {
    /// `y x y`: the covariance of the innovation is `root root^T`.
    root: DMatrix<f64>,
    /// Prediction of `y` from the `c` and the `y` of the next steps.
    by_c: DMatrix<f64>,
    by_y: DMatrix<f64>,
    /// What the innovation says of the `c` of the next steps.
    gain: DMatrix<f64>,
    /// `c` from the `y` of the same step, and from `c` and `y` of the next ones.
    own: DMatrix<f64>,
    c_by_c: DMatrix<f64>,
    c_by_y: DMatrix<f64>,
}

/// The adjoint of the filter for some rows of the border.
struct Adjoint {
    first: usize,
    rows: usize,
    /// Adjoints of `c` and `y` of the present step and the next ones; `None` is zero.
    ahead: std::collections::VecDeque<[Option<DMatrix<f64>>; 2]>,
}

impl Adjoint {
    fn new(first: usize, rows: usize, band: usize) -> Self {
        Adjoint { first, rows, ahead: (0..=band).map(|_| [None, None]).collect() }
    }

    /// Goes over one step and appends its columns to the panel.
    fn step(
        &mut self,
        chain: &Chain,
        t: usize,
        filter: &Innovation,
        coupling: &Coupling,
        first_pose: usize,
        panel: &mut Vec<f64>,
    ) {
        let ny = chain.dims[t].1;
        let next = 1..chain.blocks[t].len();
        let [alpha, beta] = self.ahead.pop_front().expect("band + 1 steps");
        self.ahead.push_back([None, None]);
        let mut beta = beta.unwrap_or_else(|| DMatrix::zeros(self.rows, ny));
        let rows = self.first..self.first + self.rows;
        for (pose, columns) in (first_pose..).zip(beta.as_mut_slice().chunks_exact_mut(POSE * self.rows)) {
            coupling.add_columns(pose, rows.clone(), columns);
        }
        // Now ahead[k - 1] is step t + k.
        if let Some(alpha) = &alpha {
            beta.gemm(1.0, alpha, &filter.own, 1.0);
            self.pass_on(chain, t, next.clone(), alpha, &filter.c_by_c, &filter.c_by_y);
        }
        let mut innovation = beta.clone();
        let mut at = 0;
        for k in next.clone() {
            let c = chain.dims[t + k].0;
            if let Some(alpha) = &self.ahead[k - 1][0] {
                innovation.gemm(1.0, alpha, &filter.gain.rows(at, c), 1.0);
            }
            at += c;
        }
        self.pass_on(chain, t, next, &beta, &filter.by_c, &filter.by_y);
        panel.extend_from_slice((innovation * &filter.root).as_slice());
    }

    /// Adds `adjoint * by` to the adjoints of the next steps.
    fn pass_on(
        &mut self,
        chain: &Chain,
        t: usize,
        next: std::ops::Range<usize>,
        adjoint: &DMatrix<f64>,
        by_c: &DMatrix<f64>,
        by_y: &DMatrix<f64>,
    ) {
        let mut at = [0, 0];
        for k in next {
            let (c, y) = chain.dims[t + k];
            for (of_y, (count, by)) in [(c, by_c), (y, by_y)].into_iter().enumerate() {
                if count > 0 && adjoint.ncols() > 0 {
                    let target =
                        self.ahead[k - 1][of_y].get_or_insert_with(|| DMatrix::zeros(self.rows, count));
                    target.gemm(1.0, adjoint, &by.columns(at[of_y], count), 1.0);
                }
                at[of_y] += count;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::coupling;
    use super::super::small::POINT;
    use super::*;

    /// A chain with these steps, and its dense copy.
    fn example(dims: &[(usize, usize)], band: usize) -> (Chain, DMatrix<f64>) {
        let mut chain = Chain::new(dims.to_vec(), band);
        let n = chain.size();
        let mut dense = DMatrix::zeros(n, n);
        let mut state = 1_u32;
        let mut random = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(state >> 16) / 65536.0 - 0.5
        };
        // A sum of squares of rows that see two steps, and a little on the diagonal.
        for t in 0..dims.len() {
            for k in 0..chain.blocks[t].len() {
                let steps = [t, t + k];
                for _ in 0..8 {
                    let mut row = DMatrix::zeros(1, n);
                    for s in steps {
                        for i in chain.starts[s]..chain.starts[s + 1] {
                            row[(0, i)] = random();
                        }
                    }
                    dense += row.transpose() * row;
                }
            }
        }
        for i in 0..n {
            dense[(i, i)] += 0.05;
        }
        for t in 0..dims.len() {
            for k in 0..chain.blocks[t].len() {
                let (row, column) = (chain.starts[t + k], chain.starts[t]);
                let size = |s: usize| chain.starts[s + 1] - chain.starts[s];
                let block = dense.view((row, column), (size(t + k), size(t))).into_owned();
                chain.block_mut(t, k).copy_from(&block);
            }
        }
        (chain, dense)
    }

    #[test]
    fn a_band_is_solved_and_reduced_as_a_dense_matrix() {
        let regular = [(6, 6); 7];
        let gaps = [(6, 6), (6, 0), (6, 12), (0, 6), (6, 6), (6, 0), (6, 6), (6, 6)];
        let bare = [(0, 6); 6];
        for (dims, band) in [
            (regular.as_slice(), 1),
            (&regular, 2),
            (&gaps, 2),
            (&gaps, 1),
            (&bare, 2),
            (&regular, 0),
            (&regular[..1], 2),
        ] {
            let (mut chain, dense) = example(dims, band);
            chain.factorise().unwrap();
            let n = chain.size();
            let inverse = dense.clone().cholesky().unwrap().inverse();
            let b = DMatrix::from_fn(n, 3, |i, j| ((i * 3 + j) as f64).sin());
            let mut x = b.clone();
            chain.solve(&mut x);
            let wanted = &inverse * &b;
            assert!((&x - &wanted).norm() < 1e-11 * wanted.norm(), "{dims:?} {band}");
            let mut rows = b.transpose();
            chain.solve_rows(&mut rows);
            assert!((rows.transpose() - &wanted).norm() < 1e-11 * wanted.norm(), "{dims:?} {band}");
            for (t, column) in chain.selected_inverse(3).iter().enumerate() {
                assert_eq!(column.len(), chain.blocks[t].len().max(4.min(dims.len() - t)));
                for (k, block) in column.iter().enumerate() {
                    let wanted = inverse.view((chain.starts[t + k], chain.starts[t]), block.shape());
                    assert!((block - wanted).norm() < 1e-11 * inverse.norm(), "{dims:?} {band}: {t} {k}");
                }
            }

            // The border sees the y alone. More rows than one task takes.
            let ys: usize = dims.iter().map(|d| d.1).sum();
            let (coupling, dense) = coupling::tests::example(ys / POSE, TILE / POINT + 2);
            let m = dense.nrows();
            let mut w = DMatrix::zeros(n, m);
            let mut y = 0;
            for (t, &(nc, ny)) in dims.iter().enumerate() {
                w.rows_mut(chain.starts[t] + nc, ny).copy_from(&dense.columns(y, ny).transpose());
                y += ny;
            }
            let wanted = w.transpose() * &inverse * &w;
            let mut border = TiledCholesky::new(m + 2, 1e9).unwrap();
            chain.reduce(&coupling, &mut border);
            for column in 0..m {
                for row in column..m {
                    let gap = (border.entry(row, column) + wanted[(row, column)]).abs();
                    assert!(gap < 1e-10 * wanted.norm(), "{dims:?} {band}: {row} {column} {gap:e}");
                }
            }
            assert_eq!(border.entry(m, 0), 0.0);
        }
    }

    #[test]
    fn an_indefinite_chain_is_singular() {
        let (mut chain, _) = example(&[(6, 6); 3], 1);
        chain.block_mut(1, 0)[(2, 2)] -= 100.0;
        assert_eq!(chain.factorise(), Err(Singular));
        // And can be made again.
        chain.clear();
        for t in 0..3 {
            chain.block_mut(t, 0).fill_with_identity();
        }
        assert_eq!(chain.factorise(), Ok(()));
    }
}
