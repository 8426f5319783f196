//! Conjugate gradients with a preconditioner.

use nalgebra::DMatrix;

/// A positive definite matrix that is only applied, and something close to its inverse.
pub(crate) trait Preconditioned {
    /// `A x`
    fn multiply(&mut self, x: &DMatrix<f64>) -> DMatrix<f64>;

    /// `M^-1 b`, `M` near `A`.
    fn precondition(&mut self, b: &DMatrix<f64>) -> DMatrix<f64>;
}

/// What conjugate gradients came to.
pub(crate) struct Solution {
    /// As far as they came.
    pub x: DMatrix<f64>,
    /// Whether that is as near as was wanted, or as rounding lets it be.
    pub is_done: bool,
}

/// Solves `A x = b`. The columns are solved side by side, each as if it were alone, until the residual in
/// the norm of `M^-1` is `tolerance` times what it was at zero, with at most `most` products.
pub(crate) fn conjugate_gradients(
    a: &mut dyn Preconditioned,
    b: DMatrix<f64>,
    tolerance: f64,
    most: usize,
) -> Solution {
    let sides = b.ncols();
    let dots = |a: &DMatrix<f64>, b: &DMatrix<f64>| -> Vec<f64> {
        (0..sides).map(|side| a.column(side).dot(&b.column(side))).collect()
    };
    let mut x = DMatrix::zeros(b.nrows(), sides);
    let mut residual = b;
    let mut z = a.precondition(&residual);
    let mut direction = z.clone();
    let mut squares = dots(&residual, &z);
    let limits: Vec<f64> = squares.iter().map(|s| s * tolerance * tolerance).collect();
    let mut is_done: Vec<bool> = squares.iter().map(|s| s.is_nan() || *s <= 0.0).collect();
    for _ in 0..most {
        if is_done.iter().all(|done| *done) {
            break;
        }
        let product = a.multiply(&direction);
        let curvatures = dots(&direction, &product);
        for side in 0..sides {
            // Rounding alone makes a curvature vanish: there is nothing left to gain.
            is_done[side] |= curvatures[side].is_nan() || curvatures[side] <= 0.0;
            if !is_done[side] {
                let length = squares[side] / curvatures[side];
                x.column_mut(side).axpy(length, &direction.column(side), 1.0);
                residual.column_mut(side).axpy(-length, &product.column(side), 1.0);
            }
        }
        z = a.precondition(&residual);
        let now = dots(&residual, &z);
        for side in 0..sides {
            if !is_done[side] {
                direction.column_mut(side).axpy(1.0, &z.column(side), now[side] / squares[side]);
                squares[side] = now[side];
                is_done[side] = now[side].is_nan() || now[side] <= limits[side];
            }
        }
    }
    Solution { x, is_done: is_done.iter().all(|done| *done) }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Dense {
        matrix: DMatrix<f64>,
        near: DMatrix<f64>,
        products: usize,
    }

    impl Preconditioned for Dense {
        fn multiply(&mut self, x: &DMatrix<f64>) -> DMatrix<f64> {
            self.products += 1;
            &self.matrix * x
        }

        fn precondition(&mut self, b: &DMatrix<f64>) -> DMatrix<f64> {
            self.near.clone().cholesky().expect("positive definite").solve(b)
        }
    }

    #[test]
    fn columns_are_solved_and_a_near_matrix_needs_few_products() {
        let n = 20;
        let root = DMatrix::from_fn(n, n, |i, j| ((i * 7 + j * 3) as f64).sin());
        let matrix = &root * root.transpose() + DMatrix::identity(n, n) * 0.1;
        let b = DMatrix::from_fn(n, 3, |i, j| ((i + 5 * j) as f64).cos());
        let wanted = matrix.clone().cholesky().unwrap().solve(&b);
        // Three directions are unlike, so that four products do.
        let mut near = matrix.clone();
        for i in 0..3 {
            near[(i, i)] += 2.0;
        }
        let mut a = Dense { matrix, near, products: 0 };
        let found = conjugate_gradients(&mut a, b.clone(), 1e-12, 50);
        assert!(found.is_done);
        assert!((&found.x - &wanted).norm() < 1e-10 * wanted.norm());
        assert!(a.products <= 5, "{}", a.products);
        assert!(!conjugate_gradients(&mut a, b, 1e-12, 2).is_done);
    }
}
