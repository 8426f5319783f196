//! Dense Cholesky factorisation in tiles, of which the lower triangle is kept.
//!
//! ```text
//!  [ 00          ]     A = L L^T, tile column by tile column:
//!  [ 10 11       ]       factor the tile on the diagonal, divide those below by it,
//!  [ 20 21 22    ]       subtract their products from all that is right of them
//! ```
//!
//! A tile is the work of one thread, so that sums do not depend on how many there are.

use super::cholesky::{Singular, TooLarge, kernel_threads};
use super::small::{POINT, axpy, dot};
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor;
use faer::linalg::matmul::matmul;
use faer::linalg::matmul::triangular::{
    self,
    BlockStructure::{Rectangular, TriangularLower},
};
use faer::linalg::triangular_solve::{solve_lower_triangular_in_place, solve_upper_triangular_in_place};
use faer::{Accum, MatMut, MatRef, Par};
use nalgebra::DMatrix;
use pulp::{Arch, Simd, WithSimd};
use rayon::ThreadPool;
use rayon::prelude::*;
use std::sync::Arc;

/// Rows of a tile: whole points, and whole columns of the matrix kernels.
pub(crate) const TILE: usize = 80 * POINT;
/// Operations from which they are shared out.
const SHARED_FLOPS: f64 = 2e7;
/// Right-hand sides that one task solves for.
const TASK_SIDES: usize = 64;

/// A symmetric matrix, or its factor, on threads of its own (see [`super::cholesky::Cholesky`]).
pub(crate) struct TiledCholesky {
    n: usize,
    /// Row by row: 00, 10, 11, 20, ...
    tiles: Vec<DMatrix<f64>>,
    workspace: MemBuffer,
    threads: Arc<ThreadPool>,
}

/// Rows and columns of the tiles, in their order.
fn places(count: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..count).flat_map(|i| (0..=i).map(move |j| (i, j)))
}

fn index(i: usize, j: usize) -> usize {
    i * (i + 1) / 2 + j
}

fn view(tile: &DMatrix<f64>) -> MatRef<'_, f64> {
    MatRef::from_column_major_slice(tile.as_slice(), tile.nrows(), tile.ncols())
}

fn view_mut(tile: &mut DMatrix<f64>) -> MatMut<'_, f64> {
    let (rows, columns) = tile.shape();
    MatMut::from_column_major_slice_mut(tile.as_mut_slice(), rows, columns)
}

/// `out -= A B^T`, the lower triangle only of a tile on the diagonal.
fn subtract_product(out: MatMut<'_, f64>, a: MatRef<'_, f64>, b: MatRef<'_, f64>, is_diagonal: bool) {
    let structure = if is_diagonal { TriangularLower } else { Rectangular };
    let b = b.transpose();
    triangular::matmul(out, structure, Accum::Add, a, Rectangular, b, Rectangular, -1.0, Par::Seq);
}

impl TiledCholesky {
    /// Room for a matrix of `n` rows, to be made and factorised in `flops` operations.
    pub(crate) fn new(n: usize, flops: f64) -> Result<Self, TooLarge> {
        let count = if flops > SHARED_FLOPS { rayon::current_num_threads() } else { 1 };
        TiledCholesky::on_threads(n, kernel_threads(count)?)
    }

    /// Room for a matrix of `n` rows on these threads.
    pub(crate) fn on_threads(n: usize, threads: Arc<ThreadPool>) -> Result<Self, TooLarge> {
        let size = |tile: usize| TILE.min(n - tile * TILE);
        let mut tiles = Vec::new();
        for (i, j) in places(n.div_ceil(TILE)) {
            let mut values = Vec::new();
            values.try_reserve_exact(size(i) * size(j)).map_err(|_| TooLarge)?;
            values.resize(size(i) * size(j), 0.0);
            tiles.push(DMatrix::from_vec(size(i), size(j), values));
        }
        let request = factor::cholesky_in_place_scratch::<f64>(TILE.min(n), Par::Seq, Default::default());
        let workspace = MemBuffer::try_new(request).map_err(|_| TooLarge)?;
        Ok(TiledCholesky { n, tiles, workspace, threads })
    }

    fn count(&self) -> usize {
        self.n.div_ceil(TILE)
    }

    /// Rows.
    pub(crate) fn size(&self) -> usize {
        self.n
    }

    /// Sets everything to zero.
    pub(crate) fn clear(&mut self) {
        self.tiles.iter_mut().for_each(|tile| tile.fill(0.0));
    }

    /// An entry of the lower triangle.
    #[cfg(test)]
    pub(crate) fn entry(&self, row: usize, column: usize) -> f64 {
        self.tiles[index(row / TILE, column / TILE)][(row % TILE, column % TILE)]
    }

    /// The same, to be written, before the factorisation.
    pub(crate) fn entry_mut(&mut self, row: usize, column: usize) -> &mut f64 {
        &mut self.tiles[index(row / TILE, column / TILE)][(row % TILE, column % TILE)]
    }

    /// Subtracts `P P^T` from the leading part of the matrix, where `P` has so many columns and comes in
    /// pieces of [`TILE`] rows, the last one shorter.
    pub(crate) fn subtract_pieces(&mut self, pieces: &[Vec<f64>], columns: usize) {
        let piece = |piece: &Vec<f64>| piece.len() / columns;
        let pieces =
            pieces.iter().map(|p| MatRef::from_column_major_slice(p, piece(p), columns)).collect::<Vec<_>>();
        self.subtract_square(&pieces);
    }

    /// The same for a `P` of all rows in one piece.
    pub(crate) fn subtract_whole(&mut self, panel: &[f64], columns: usize) {
        let n = self.n;
        let panel = MatRef::from_column_major_slice(panel, n, columns);
        let piece = |first: usize| panel.subrows(first, TILE.min(n - first));
        self.subtract_square(&(0..n).step_by(TILE).map(piece).collect::<Vec<_>>());
    }

    fn subtract_square(&mut self, pieces: &[MatRef<'_, f64>]) {
        let TiledCholesky { tiles, threads, .. } = self;
        let work: Vec<_> = tiles.iter_mut().zip(places(pieces.len())).collect();
        threads.install(|| {
            work.into_par_iter().for_each(|(tile, (i, j))| {
                let (rows, columns) = (pieces[i].nrows(), pieces[j].nrows());
                let out = view_mut(tile).submatrix_mut(0, 0, rows, columns);
                subtract_product(out, pieces[i], pieces[j], i == j);
            });
        });
    }

    /// Replaces the matrix by its factor.
    pub(crate) fn factorise(&mut self) -> Result<(), Singular> {
        let count = self.count();
        let TiledCholesky { tiles, workspace, threads, .. } = self;
        threads.install(|| {
            for k in 0..count {
                let mut own = std::mem::take(&mut tiles[index(k, k)]);
                let stack = MemStack::new(workspace);
                let found = factor::cholesky_in_place(
                    view_mut(&mut own),
                    Default::default(),
                    Par::Seq,
                    stack,
                    Default::default(),
                );
                let mut below: Vec<DMatrix<f64>> =
                    (k + 1..count).map(|i| std::mem::take(&mut tiles[index(i, k)])).collect();
                if found.is_ok() {
                    // X L^T = A
                    below.par_iter_mut().for_each(|tile| {
                        let transposed = view_mut(tile).transpose_mut();
                        solve_lower_triangular_in_place(view(&own), transposed, Par::Seq);
                    });
                    let right = tiles.iter_mut().zip(places(count)).filter(|(_, (_, j))| *j > k);
                    right.collect::<Vec<_>>().into_par_iter().for_each(|(tile, (i, j))| {
                        let (a, b) = (&below[i - k - 1], &below[j - k - 1]);
                        subtract_product(view_mut(tile), view(a), view(b), i == j);
                    });
                }
                tiles[index(k, k)] = own;
                for (i, tile) in (k + 1..).zip(below) {
                    tiles[index(i, k)] = tile;
                }
                found.map_err(|_| Singular)?;
            }
            Ok(())
        })
    }

    /// Solves for the columns of `b` in place, after the factorisation.
    pub(crate) fn solve(&self, b: &mut DMatrix<f64>) {
        if self.n == 0 {
            return;
        }
        self.threads.install(|| {
            b.as_mut_slice().par_chunks_mut(self.n * TASK_SIDES).for_each(|columns| {
                let sides = columns.len() / self.n;
                self.solve_some(MatMut::from_column_major_slice_mut(columns, self.n, sides));
            });
        });
    }

    fn solve_some(&self, mut b: MatMut<'_, f64>) {
        let tile = |i: usize, j: usize| view(&self.tiles[index(i, j)]);
        let count = self.count();
        for k in 0..count {
            let (done, mut rest) = b.as_mut().split_at_row_mut(self.n.min((k + 1) * TILE));
            let mut own = done.get_mut(k * TILE.., ..);
            solve_lower_triangular_in_place(tile(k, k), own.as_mut(), Par::Seq);
            for i in k + 1..count {
                let (at, a) = ((i - k - 1) * TILE, tile(i, k));
                let out = rest.as_mut().subrows_mut(at, a.nrows());
                matmul(out, Accum::Add, a, own.as_ref(), -1.0, Par::Seq);
            }
        }
        for k in (0..count).rev() {
            let (done, rest) = b.as_mut().split_at_row_mut(self.n.min((k + 1) * TILE));
            let mut own = done.get_mut(k * TILE.., ..);
            for i in k + 1..count {
                let (at, a) = ((i - k - 1) * TILE, tile(i, k));
                let seen = rest.as_ref().subrows(at, a.nrows());
                matmul(own.as_mut(), Accum::Add, a.transpose(), seen, -1.0, Par::Seq);
            }
            solve_upper_triangular_in_place(tile(k, k).transpose(), own, Par::Seq);
        }
    }

    /// The same for few columns, on this thread.
    pub(crate) fn solve_here(&self, b: &mut DMatrix<f64>) {
        struct Work<'a>(&'a TiledCholesky, &'a mut [f64]);
        impl WithSimd for Work<'_> {
            type Output = ();
            #[inline(always)]
            fn with_simd<S: Simd>(self, _: S) {
                self.0.solve_column(self.1);
            }
        }
        if self.n > 0 {
            let columns = b.as_mut_slice().chunks_exact_mut(self.n);
            columns.for_each(|x| Arch::new().dispatch(Work(self, x)));
        }
    }

    #[inline(always)]
    fn solve_column(&self, x: &mut [f64]) {
        let count = self.count();
        // Column j of the factor in a tile.
        let column = |i: usize, k: usize, j: usize| {
            let tile = &self.tiles[index(i, k)];
            &tile.as_slice()[j * tile.nrows()..][..tile.nrows()]
        };
        for k in 0..count {
            let (own, rest) = x[k * TILE..].split_at_mut(TILE.min(self.n - k * TILE));
            for j in 0..own.len() {
                let factor = column(k, k, j);
                let (done, below) = own.split_at_mut(j + 1);
                done[j] /= factor[j];
                axpy(-done[j], &factor[j + 1..], below);
            }
            for (i, rest) in (k + 1..).zip(rest.chunks_mut(TILE)) {
                for (j, own) in own.iter().enumerate() {
                    axpy(-own, column(i, k, j), rest);
                }
            }
        }
        for k in (0..count).rev() {
            let (own, rest) = x[k * TILE..].split_at_mut(TILE.min(self.n - k * TILE));
            for (i, rest) in (k + 1..).zip(rest.chunks(TILE)) {
                for (j, own) in own.iter_mut().enumerate() {
                    *own -= dot(column(i, k, j), rest);
                }
            }
            for j in (0..own.len()).rev() {
                let factor = column(k, k, j);
                own[j] = (own[j] - dot(&factor[j + 1..], &own[j + 1..])) / factor[j];
            }
        }
    }

    /// The inverse of the matrix, after the factorisation.
    pub(crate) fn inverse(&self) -> DMatrix<f64> {
        let mut inverse = DMatrix::identity(self.n, self.n);
        self.solve(&mut inverse);
        inverse
    }

    /// `A B` on the threads of this factor, for a `B` of so many columns that comes in pieces of rows.
    pub(crate) fn product(&self, a: &DMatrix<f64>, pieces: &[&[f64]], columns: usize) -> DMatrix<f64> {
        const ROWS: usize = 128;
        let mut product = DMatrix::zeros(a.nrows(), columns);
        if columns == 0 {
            return product;
        }
        let n = a.nrows();
        let mut left = view_mut(&mut product);
        let mut tasks = Vec::with_capacity(n.div_ceil(ROWS));
        for first in (0..n).step_by(ROWS) {
            let (own, rest) = left.split_at_row_mut(ROWS.min(n - first));
            tasks.push((first, own));
            left = rest;
        }
        self.threads.install(|| {
            tasks.into_par_iter().for_each(|(first, mut own)| {
                let mut at = 0;
                for piece in pieces {
                    let rows = piece.len() / columns;
                    let part = view(a).submatrix(first, at, own.nrows(), rows);
                    let piece = MatRef::from_column_major_slice(piece, rows, columns);
                    matmul(own.as_mut(), Accum::Add, part, piece, 1.0, Par::Seq);
                    at += rows;
                }
            });
        });
        product
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn example(n: usize) -> DMatrix<f64> {
        DMatrix::from_fn(n, n, |i, j| {
            let value = ((i.max(j) * 31 + i.min(j) * 17) as f64).sin();
            if i == j { n as f64 } else { value }
        })
    }

    fn tiled(dense: &DMatrix<f64>) -> TiledCholesky {
        let n = dense.nrows();
        let mut tiled = TiledCholesky::new(n, 1e9).unwrap();
        for column in 0..n {
            (column..n).for_each(|row| *tiled.entry_mut(row, column) = dense[(row, column)]);
        }
        tiled
    }

    #[test]
    fn solutions_and_the_inverse_are_those_of_a_dense_solver() {
        for n in [0, 1, TILE, 2 * TILE + 17] {
            let dense = example(n);
            let mut tiled = tiled(&dense);
            assert_eq!(tiled.size(), n);
            tiled.factorise().unwrap();
            // More right-hand sides than one task takes.
            let b = DMatrix::from_fn(n, TASK_SIDES + 3, |i, j| ((i * 7 + j) as f64).cos());
            let cholesky = dense.cholesky().unwrap();
            let wanted = cholesky.solve(&b);
            let mut found = b.clone();
            tiled.solve(&mut found);
            assert!((&found - &wanted).norm() <= 1e-12 * wanted.norm(), "{n}");
            let mut found = b;
            tiled.solve_here(&mut found);
            assert!((&found - &wanted).norm() <= 1e-12 * wanted.norm(), "{n}");
            let wanted = cholesky.inverse();
            assert!((tiled.inverse() - &wanted).norm() <= 1e-12 * wanted.norm(), "{n}");
        }
    }

    #[test]
    fn squares_are_subtracted_whole_and_in_pieces() {
        let (n, columns) = (2 * TILE + 17, 5);
        let panel = DMatrix::from_fn(n, columns, |i, j| ((i + 3 * j) as f64).sin());
        // Of the leading part, in pieces: all but the last rows.
        let (dense, m) = (example(n), n - 9);
        let [mut whole, mut in_pieces] = [tiled(&dense), tiled(&dense)];
        whole.subtract_whole(panel.as_slice(), columns);
        let piece = |first: usize| panel.rows(first, TILE.min(m - first)).into_owned().as_slice().to_vec();
        in_pieces.subtract_pieces(&(0..m).step_by(TILE).map(piece).collect::<Vec<_>>(), columns);
        let wanted = &dense - &panel * panel.transpose();
        for column in 0..n {
            for row in column..n {
                assert!((whole.entry(row, column) - wanted[(row, column)]).abs() < 1e-11);
                let wanted = if row < m { wanted[(row, column)] } else { dense[(row, column)] };
                assert!((in_pieces.entry(row, column) - wanted).abs() < 1e-11, "{row} {column}");
            }
        }
    }

    #[test]
    fn an_indefinite_matrix_is_singular_and_can_be_made_again() {
        let dense = example(TILE + 30);
        let mut indefinite = dense.clone();
        indefinite[(TILE + 3, TILE + 3)] = -1.0;
        let mut tiled = tiled(&indefinite);
        assert_eq!(tiled.factorise(), Err(Singular));
        tiled.clear();
        for i in 0..dense.nrows() {
            *tiled.entry_mut(i, i) = 4.0;
        }
        assert_eq!(tiled.factorise(), Ok(()));
        assert_eq!(tiled.entry(TILE + 3, TILE + 3), 2.0);
    }

    #[test]
    fn the_factor_is_the_same_for_any_number_of_threads() {
        let dense = example(3 * TILE + 11);
        let with = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let mut tiled = tiled(&dense);
                let panel = vec![0.1; 7 * dense.nrows()];
                tiled.subtract_whole(&panel, 7);
                tiled.factorise().unwrap();
                let mut x = DMatrix::from_fn(dense.nrows(), 70, |i, j| ((i + j) as f64).sin());
                tiled.solve(&mut x);
                let bits = |values: &[f64]| values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
                let factor: Vec<_> = tiled.tiles.iter().map(|tile| bits(tile.as_slice())).collect();
                (factor, bits(x.as_slice()))
            })
        };
        let one = with(1);
        for threads in [2, 5] {
            assert!(one == with(threads), "{threads} threads");
        }
    }
}
