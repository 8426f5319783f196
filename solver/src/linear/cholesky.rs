//! Sparse Cholesky factorisation of a [`BlockMatrix`], its symbolic part done once.

use super::matrix::{BlockMatrix, Pattern};
use faer::dyn_stack::{MemBuffer, MemStack, StackReq};
use faer::perm::PermRef;
use faer::sparse::linalg::SupernodalThreshold;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, LltRef, SymbolicCholesky, SymmetricOrdering, factorize_symbolic_cholesky,
};
use faer::{Conj, MatMut, Par, Side};
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::sync::Arc;

/// Factor of a matrix `A = L L^T` and the workspace to make it again with other values.
pub(crate) struct Cholesky {
    symbolic: SymbolicCholesky<usize>,
    factor: Vec<f64>,
    workspace: MemBuffer,
    /// Threads of its own. The kernels of the library leave a thread in a state in which all
    /// other vector code runs two to four times slower (measured), so none of ours must run them.
    threads: ThreadPool,
    parallelism: Par,
}

/// Operations from which a factorisation is shared out.
const SHARED_FLOPS: f64 = 2e7;

/// The matrix is not positive definite: some combination of unknowns is not determined.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the normal equations are singular")]
pub struct Singular;

/// The matrix has no factorisation that fits into memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the normal equations are too large for this machine's memory")]
pub struct TooLarge;

impl Cholesky {
    /// Analyses a pattern. Uses the threads of the current pool; their number does not
    /// change the result.
    pub(crate) fn analyse(matrix: &Pattern) -> Result<Self, TooLarge> {
        let n = matrix.size();
        // The matrix is kept in elimination order already.
        let identity: Vec<usize> = (0..n).collect();
        let symbolic = factorize_symbolic_cholesky(
            matrix.symbolic(),
            Side::Lower,
            SymmetricOrdering::Custom(PermRef::new_checked(&identity, &identity, n)),
            CholeskySymbolicParams {
                // Blocks of 6 and long bands: measured 1.5 to 4.5 times faster than simplicial.
                supernodal_flop_ratio_threshold: SupernodalThreshold::FORCE_SUPERNODAL,
                ..Default::default()
            },
        )
        .map_err(|_| TooLarge)?;
        let is_shared = matrix.ordering().flops > SHARED_FLOPS;
        let count = if is_shared { rayon::current_num_threads() } else { 1 };
        let threads = ThreadPoolBuilder::new().num_threads(count).build().map_err(|_| TooLarge)?;
        let parallelism = if count == 1 { Par::Seq } else { Par::rayon(count) };
        let request = StackReq::any_of(&[
            symbolic.factorize_numeric_llt_scratch::<f64>(parallelism, Default::default()),
            symbolic.solve_in_place_scratch::<f64>(MAX_RIGHT_SIDES, Par::Seq),
        ]);
        let workspace = MemBuffer::try_new(request).map_err(|_| TooLarge)?;
        let mut factor = Vec::new();
        factor.try_reserve_exact(symbolic.len_val()).map_err(|_| TooLarge)?;
        factor.resize(symbolic.len_val(), 0.0);
        Ok(Cholesky { symbolic, factor, workspace, threads, parallelism })
    }

    /// Factorises `matrix`, which has the pattern that was analysed.
    pub(crate) fn factorise(&mut self, matrix: &BlockMatrix) -> Result<(), Singular> {
        let Cholesky { symbolic, factor, workspace, threads, parallelism } = self;
        threads.install(|| {
            let result = symbolic.factorize_numeric_llt(
                factor,
                matrix.lower(),
                Side::Lower,
                Default::default(),
                *parallelism,
                MemStack::new(workspace),
                Default::default(),
            );
            result.map(|_| ()).map_err(|_| Singular)
        })
    }

    /// Solves `A x = b` in place for the columns of `b`, each as long as the matrix.
    pub(crate) fn solve(&mut self, b: &mut [f64]) {
        let n = self.symbolic.nrows();
        if n == 0 {
            return;
        }
        let Cholesky { symbolic, factor, workspace, threads, .. } = self;
        let solve = |columns: &mut [f64]| {
            let count = columns.len() / n;
            LltRef::new(symbolic, factor).solve_in_place_with_conj(
                Conj::No,
                MatMut::from_column_major_slice_mut(columns, n, count),
                // Parallel products with a single vector sum in an order that depends on the threads.
                Par::Seq,
                MemStack::new(workspace),
            );
        };
        threads.install(|| b.chunks_mut(n * MAX_RIGHT_SIDES).for_each(solve));
    }
}

/// Threads for the kernels of the library: see [`Cholesky`].
pub(crate) fn kernel_threads(count: usize) -> Result<Arc<ThreadPool>, TooLarge> {
    ThreadPoolBuilder::new().num_threads(count).build().map(Arc::new).map_err(|_| TooLarge)
}

/// Right-hand sides that are solved together.
const MAX_RIGHT_SIDES: usize = 32;

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;

    /// A diagonally dominant matrix on an irregular graph of blocks, and its dense copy.
    fn example() -> (BlockMatrix, nalgebra::DMatrix<f64>) {
        let dims: Vec<usize> = (0..25).map(|i| [6, 3, 1][i % 3]).collect();
        let pairs: Vec<_> = (0..25)
            .flat_map(|a| (0..a).map(move |b| (a, b)))
            .filter(|(a, b)| (a * 5 + b * 3) % 7 < 2)
            .collect();
        let mut matrix = BlockMatrix::zeros(Arc::new(Pattern::new(&dims, pairs.iter().copied())));
        let ranges: Vec<_> = (0..25).map(|position| matrix.range(position)).collect();
        let mut dense = nalgebra::DMatrix::zeros(matrix.size(), matrix.size());
        let mut state = 1_u32;
        for mut column in matrix.columns_mut() {
            column.clear();
            let at = column.position;
            column.for_each_block(|row, block| {
                for c in 0..ranges[at].len() {
                    for r in 0..ranges[row].len() {
                        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                        let mut value = f64::from(state >> 16) / 65536.0 - 0.5;
                        let (i, j) = (ranges[row].start + r, ranges[at].start + c);
                        if i < j {
                            continue;
                        }
                        value += if i == j { 40.0 } else { 0.0 };
                        block.add(r, c, value);
                        dense[(i, j)] = value;
                        dense[(j, i)] = value;
                    }
                }
            });
        }
        (matrix, dense)
    }

    #[test]
    fn solutions_agree_with_a_dense_solver() {
        let (matrix, dense) = example();
        let mut cholesky = Cholesky::analyse(&matrix).unwrap();
        cholesky.factorise(&matrix).unwrap();
        let n = matrix.size();
        // More right-hand sides than are solved together.
        let sides = MAX_RIGHT_SIDES + 3;
        let b: Vec<f64> = (0..n * sides).map(|i| (i as f64 * 0.37).sin()).collect();
        let mut x = b.clone();
        cholesky.solve(&mut x);
        let wanted = dense.cholesky().unwrap().solve(&nalgebra::DMatrix::from_column_slice(n, sides, &b));
        let found = nalgebra::DMatrix::from_column_slice(n, sides, &x);
        assert!((&found - &wanted).norm() < 1e-12 * wanted.norm());
    }

    #[test]
    fn the_product_agrees_with_a_dense_one() {
        let (matrix, dense) = example();
        let x: Vec<f64> = (0..matrix.size()).map(|i| (i as f64 * 0.71).cos()).collect();
        let wanted = dense * nalgebra::DVector::from_column_slice(&x);
        let found = nalgebra::DVector::from_vec(matrix.multiply(&x));
        assert!((found - &wanted).norm() < 1e-13 * wanted.norm());
    }

    #[test]
    fn factor_and_solution_are_the_same_for_any_number_of_threads() {
        // As in an adjustment: poses along time, and a dense part that is large enough for the
        // library to share it out.
        let (poses, points) = (60, 250);
        let dims: Vec<usize> = (0..poses + points).map(|at| if at < poses { 6 } else { 3 }).collect();
        let band = (1..poses).map(|at| (at, at - 1));
        let border = (poses..poses + points).flat_map(|row| (0..row).map(move |column| (row, column)));
        let mut matrix = BlockMatrix::zeros(Arc::new(Pattern::new(&dims, band.chain(border))));
        let n = matrix.size();
        for mut column in matrix.columns_mut() {
            column.clear();
            let at = column.position;
            column.for_each_block(|row, block| {
                for c in 0..dims[at] {
                    for r in (if row == at { c } else { 0 })..dims[row] {
                        let value = ((row * 31 + at * 17 + r * 7 + c) as f64).sin();
                        block.add(r, c, if row == at && r == c { n as f64 } else { value });
                    }
                }
            });
        }
        let with = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let mut cholesky = Cholesky::analyse(&matrix).unwrap();
                cholesky.factorise(&matrix).unwrap();
                let mut x: Vec<f64> = (0..n).map(|i| (i as f64 * 0.37).sin()).collect();
                cholesky.solve(&mut x);
                let bits = |values: &[f64]| values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
                (bits(&cholesky.factor), bits(&x))
            })
        };
        let one = with(1);
        for threads in [2, 3, 5] {
            let other = with(threads);
            assert!(one.0 == other.0, "factor with {threads} threads");
            assert!(one.1 == other.1, "solution with {threads} threads");
        }
    }

    #[test]
    fn an_indefinite_matrix_is_singular() {
        let (matrix, _) = example();
        let mut shifted = matrix.clone();
        shifted.copy_with_diagonal(&matrix, &vec![-60.0; matrix.size()]);
        let mut cholesky = Cholesky::analyse(&matrix).unwrap();
        assert_eq!(cholesky.factorise(&shifted), Err(Singular));
        assert_eq!(cholesky.factorise(&matrix), Ok(()));
    }
}
