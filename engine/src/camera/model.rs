//! What a lens model is to a camera and to the files that name it.

use nalgebra::{Matrix2, SMatrix, Vector2};

/// A lens has no more coefficients than this that can be adjusted.
pub const COEFFICIENTS: usize = 5;

/// The keys of a lens model's numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LensKeys {
    /// The name of the model.
    pub model: &'static str,
    /// Of the coefficients that can be adjusted, in their order.
    pub coefficients: &'static [&'static str],
    /// Of the numbers that are held as they were calibrated; zero where they are not given.
    pub held: &'static [&'static str],
}

/// A lens model: how rays `(x/z, y/z)` are bent, and the names of its numbers.
pub trait LensModel: Sized {
    /// Its keys; no more coefficients than `COEFFICIENTS`.
    const KEYS: LensKeys;

    /// The lens of these numbers, in the order of [`LensModel::KEYS`]; what it does not have is passed over.
    fn of_numbers(coefficients: &[f64; COEFFICIENTS], held: &[f64]) -> Self;

    /// Its coefficients; zero beyond those that it has.
    fn numbers(&self) -> [f64; COEFFICIENTS];

    /// The numbers that are held.
    fn held(&self) -> Vec<f64> {
        Vec::new()
    }

    /// Other coefficients within the same cone. Cheap enough for every image point.
    fn near(&self, coefficients: &[f64; COEFFICIENTS]) -> Self;

    /// The direction that the lens bends `ray` to; `None` beyond the fold.
    fn distort(&self, ray: &Vector2<f64>) -> Option<Vector2<f64>>;

    /// Derivative of [`LensModel::distort`], 2 x 2.
    fn distort_jacobian(&self, ray: &Vector2<f64>) -> Matrix2<f64>;

    /// Derivative of [`LensModel::distort`] by the coefficients, 2 x `COEFFICIENTS`; it is linear in them.
    fn by_coefficients(ray: &Vector2<f64>) -> SMatrix<f64, 2, COEFFICIENTS>;

    /// The ray that is bent to `distorted`, to machine precision; `None` where there is none inside the fold.
    fn undistort(&self, distorted: &Vector2<f64>) -> Option<Vector2<f64>>;

    /// What columns gain with the distorted y: the affine part of a camera whose axes are not square \[px\].
    fn skew_px(&self) -> f64 {
        0.0
    }
}
