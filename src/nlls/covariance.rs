//! The covariance of the unknowns at a state: blocks of the inverse of the normal matrix, neither damped
//! nor scaled.

use super::linear::cholesky::{Singular, TooLarge};
use super::system::{
    Accuracy, BlockId, Curvature, Factors, GroupId, Normal, SelectedInverse, System, Values,
};
use nalgebra::DMatrix;

/// Why there is no covariance.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NoCovariance {
    /// Some combination of unknowns is not determined.
    #[error(transparent)]
    Singular(#[from] Singular),
    /// It does not fit into memory.
    #[error(transparent)]
    TooLarge(#[from] TooLarge),
    /// There are too many unknowns for the way in which they are eliminated.
    #[error("the normal equations are too large for their inverse")]
    NotSelected,
}

/// Covariance of unknowns whose measurements have the standard deviations stated (a variance of unit weight
/// of 1). A pose is perturbed as [`super::manifold`] says: position \[m\] along the axes of the world,
/// attitude \[rad\] about the axes of the body.
pub struct Covariance<'a> {
    system: &'a System,
    values: &'a Values,
    normal: Normal,
    factors: Factors,
    selected: SelectedInverse,
}

impl<'a> Covariance<'a> {
    /// The covariance at `values`.
    pub fn new(system: &'a System, values: &'a Values) -> Result<Self, NoCovariance> {
        let mut normal = system.normal();
        let mut factors = Factors::new(system)?;
        system.linearise(values, Curvature::PLAIN, &mut normal).ok_or(Singular)?;
        let undamped = vec![0.0; system.pattern().size()];
        factors.factorise(system, &mut normal, &undamped)?;
        let selected = SelectedInverse::new(system, values, &normal, &mut factors);
        let selected = selected.ok_or(NoCovariance::NotSelected)?;
        Ok(Covariance { system, values, normal, factors, selected })
    }

    /// The system.
    pub fn system(&self) -> &'a System {
        self.system
    }

    /// The state.
    pub fn values(&self) -> &'a Values {
        self.values
    }

    /// The covariance between two blocks; see [`SelectedInverse::block`].
    pub fn block(&self, a: BlockId, b: BlockId) -> Option<DMatrix<f64>> {
        self.selected.block(self.system, a, b)
    }

    /// The covariance matrix times each column of `x`.
    pub fn times(&mut self, x: &DMatrix<f64>) -> DMatrix<f64> {
        let mut product = x.clone();
        self.factors.solve(self.system, &self.normal, Accuracy::Exact, product.as_mut_slice());
        product
    }

    /// `J^T z` of a group; see [`System::transposed_product`].
    pub fn transposed_product(&self, group: GroupId, z: &[f64]) -> Vec<f64> {
        self.system.transposed_product(group, &self.normal, z)
    }

    /// The measurements of a group, linearised; see [`SelectedInverse::jacobians`].
    pub fn jacobians(&self, group: GroupId) -> Vec<Vec<(BlockId, DMatrix<f64>)>> {
        SelectedInverse::jacobians(self.system, &self.normal, group)
    }

    /// The leverages of a group; see [`SelectedInverse::leverages`].
    pub fn leverages(&self, group: GroupId) -> &[f64] {
        self.selected.leverages(group)
    }
}
