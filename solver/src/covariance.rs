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

/// The factors of the normal matrix of a system at one state, neither damped nor scaled.
pub struct Undamped<'a> {
    system: &'a System,
    normal: Normal,
    factors: Factors,
}

impl<'a> Undamped<'a> {
    /// The factors at `values`.
    pub fn new(system: &'a System, values: &Values) -> Result<Self, NoCovariance> {
        let mut normal = system.normal();
        let mut factors = Factors::new(system)?;
        system.linearise(values, Curvature::PLAIN, &mut normal).ok_or(Singular)?;
        factors.factorise(system, &mut normal, &vec![0.0; system.size()])?;
        Ok(Undamped { system, normal, factors })
    }

    /// The step to the minimum of the quadratic model.
    pub fn newton_step(&mut self) -> Vec<f64> {
        let mut step: Vec<f64> = self.normal.raw_gradient().iter().map(|g| -g).collect();
        self.factors.solve(self.system, &self.normal, Accuracy::Exact, &mut step);
        step
    }

    /// The covariance matrix times each column of `x`.
    pub fn times(&mut self, x: &DMatrix<f64>) -> DMatrix<f64> {
        let mut product = x.clone();
        self.factors.solve(self.system, &self.normal, Accuracy::Exact, product.as_mut_slice());
        product
    }
}

/// Covariance of unknowns whose measurements have the standard deviations stated (a variance of unit weight
/// of 1). A pose is perturbed as [`super::manifold`] says: position \[m\] along the axes of the world,
/// attitude \[rad\] about the axes of the body.
pub struct Covariance<'a> {
    undamped: Undamped<'a>,
    selected: SelectedInverse,
}

impl<'a> Covariance<'a> {
    /// The covariance at `values`.
    pub fn new(system: &'a System, values: &Values) -> Result<Self, NoCovariance> {
        let mut undamped = Undamped::new(system, values)?;
        let Undamped { normal, factors, .. } = &mut undamped;
        let selected = SelectedInverse::new(system, values, normal, factors);
        Ok(Covariance { selected: selected.ok_or(NoCovariance::NotSelected)?, undamped })
    }

    /// The covariance between two blocks; see [`SelectedInverse::block`].
    pub fn block(&self, a: BlockId, b: BlockId) -> Option<DMatrix<f64>> {
        self.selected.block(self.undamped.system, a, b)
    }

    /// See [`Undamped::times`].
    pub fn times(&mut self, x: &DMatrix<f64>) -> DMatrix<f64> {
        self.undamped.times(x)
    }

    /// `J^T z` of a group; see [`System::transposed_product`].
    pub fn transposed_product(&self, group: GroupId, z: &[f64]) -> Vec<f64> {
        self.undamped.system.transposed_product(group, &self.undamped.normal, z)
    }

    /// The measurements of a group, linearised; see [`SelectedInverse::jacobians`].
    pub fn jacobians(&self, group: GroupId) -> Vec<Vec<(BlockId, DMatrix<f64>)>> {
        SelectedInverse::jacobians(self.undamped.system, &self.undamped.normal, group)
    }

    /// The leverages of a group; see [`SelectedInverse::leverages`].
    pub fn leverages(&self, group: GroupId) -> &[f64] {
        self.selected.leverages(group)
    }
}
