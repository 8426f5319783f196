//! Singular values of a dense matrix.

use super::cholesky::TooLarge;
use faer::diag::Diag;
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::svd::SvdParams;
use faer::linalg::svd::{self, ComputeSvdVectors};
use faer::{Mat, MatRef, Par, Spec};
use nalgebra::DMatrix;

/// Singular values and right singular vectors of a matrix, largest first: one for every column.
pub struct Spectrum {
    /// The singular values.
    pub values: Vec<f64>,
    /// The right singular vectors, as columns.
    pub vectors: DMatrix<f64>,
}

impl Spectrum {
    /// The spectrum of `matrix`. Its singular values are exact to rounding of the largest, which those of its
    /// normal matrix are only to the root of that. `None` if it is not finite.
    pub fn of(matrix: &DMatrix<f64>) -> Result<Option<Spectrum>, TooLarge> {
        // The kernels of the library slow down all other code of their thread.
        let run = || std::thread::scope(|scope| scope.spawn(|| decompose(matrix)).join());
        run().unwrap_or(Err(TooLarge))
    }
}

fn decompose(matrix: &DMatrix<f64>) -> Result<Option<Spectrum>, TooLarge> {
    let columns = matrix.ncols();
    if matrix.iter().any(|x| !x.is_finite()) {
        return Ok(None);
    }
    if columns == 0 {
        return Ok(Some(Spectrum { values: Vec::new(), vectors: DMatrix::zeros(0, 0) }));
    }
    // A matrix that is too low has null vectors all the same.
    let padded = (matrix.nrows() < columns).then(|| matrix.clone().resize(columns, columns, 0.0));
    let matrix = padded.as_ref().unwrap_or(matrix);
    let view = MatRef::from_column_major_slice(matrix.as_slice(), matrix.nrows(), columns);
    // Divide and conquer has been seen to miss a singular value of zero by 1e-6 of the largest.
    let mut by_rotations: Spec<SvdParams, f64> = Default::default();
    by_rotations.recursion_threshold = usize::MAX;
    let mut values = Diag::<f64>::zeros(columns);
    let mut vectors = Mat::<f64>::zeros(columns, columns);
    let scratch = svd::svd_scratch::<f64>(
        matrix.nrows(),
        columns,
        ComputeSvdVectors::No,
        ComputeSvdVectors::Full,
        Par::Seq,
        by_rotations,
    );
    let mut memory = MemBuffer::try_new(scratch).map_err(|_| TooLarge)?;
    let stack = MemStack::new(&mut memory);
    let (into, right) = (values.as_mut(), Some(vectors.as_mut()));
    if svd::svd(view, into, None, right, Par::Seq, stack, by_rotations).is_err() {
        return Ok(None);
    }
    Ok(Some(Spectrum {
        values: (0..columns).map(|i| values[i]).collect(),
        vectors: DMatrix::from_fn(columns, columns, |i, j| vectors[(i, j)]),
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_known_of_a_matrix_is_found() {
        // Singular values 5, 3 and, the matrix being low, 0.
        let matrix = DMatrix::from_row_slice(2, 3, &[3.0, 2.0, 2.0, 2.0, 3.0, -2.0]);
        let found = Spectrum::of(&matrix).unwrap().unwrap();
        for (found, wanted) in found.values.iter().zip([5.0, 3.0, 0.0]) {
            assert!((found - wanted).abs() < 1e-14);
        }
        let null = found.vectors.column(2);
        assert!((&matrix * null).norm() < 1e-14);
        assert!(((null[0] / null[2]).abs() - 2.0).abs() < 1e-13);
    }

    #[test]
    fn small_singular_values_do_not_drown() {
        let turn =
            DMatrix::from_fn(4, 4, |i, j| 0.5 * if (i & j).count_ones() % 2 == 0 { 1.0 } else { -1.0 });
        let wanted = [1.0, 1e-4, 1e-9, 1e-12];
        let matrix = &turn * DMatrix::from_diagonal(&nalgebra::DVector::from_row_slice(&wanted)) * &turn;
        let found = Spectrum::of(&matrix).unwrap().unwrap();
        for (found, wanted) in found.values.iter().zip(wanted) {
            assert!((found - wanted).abs() < 1e-15, "{found} {wanted}");
        }
    }

    /// Also where faer would divide and conquer.
    #[test]
    fn as_many_zeros_are_found_as_there_are() {
        let (rows, columns, rank) = (300, 180, 171);
        let wave = |i: usize, j: usize| (1.7 * i as f64 * (j + 1) as f64 + 0.3 * (j * j) as f64).sin();
        let left = DMatrix::from_fn(rows, rank, wave);
        let right = DMatrix::from_fn(rank, columns, |i, j| wave(j + 7, i + 3));
        let found = Spectrum::of(&(left * right)).unwrap().unwrap();
        let is_zero = |value: &&f64| **value < 1e-12 * found.values[0];
        assert_eq!(found.values.iter().filter(is_zero).count(), columns - rank);
        let product = found.vectors.tr_mul(&found.vectors);
        assert!((product - DMatrix::identity(columns, columns)).amax() < 1e-12);
    }

    #[test]
    fn a_matrix_that_is_not_finite_has_none() {
        assert!(Spectrum::of(&DMatrix::from_element(3, 2, f64::NAN)).unwrap().is_none());
    }
}
