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
///
/// ```
/// # use trackbundle_solver::nalgebra::Vector1;
/// # use trackbundle_solver::{Covariance, Jacobian, Loss, Manifold, Measurement, Minimiser, MinimiserOptions};
/// # use trackbundle_solver::{Residual, SystemBuilder};
/// # struct Reading(f64);
/// # impl Residual<1, 1> for Reading {
/// #     const MANIFOLDS: [Manifold; 1] = [Manifold::SCALAR];
/// #     fn evaluate(&self, x: &[&[f64]; 1], jacobian: Option<&mut Jacobian<1, 1>>) -> Option<Vector1<f64>> {
/// #         if let Some(jacobian) = jacobian {
/// #             jacobian.set(0, 0, &Vector1::new(1.0));
/// #         }
/// #         Some(Vector1::new(x[0][0] - self.0))
/// #     }
/// # }
/// # let mut builder = SystemBuilder::default();
/// # let level = builder.add_block(Manifold::SCALAR, &[0.0], &[true]);
/// # let readings = [1.0, 2.0, 6.0].map(|read| Measurement { residual: Reading(read), blocks: [level], sigma: [0.3] });
/// # builder.add_group("readings", Loss::Squared, readings.into());
/// # let system = builder.build();
/// # let minimum = Minimiser::new(&system)?.run(&system, system.start(), MinimiserOptions::default(), None);
/// // The mean of three readings of 0.3.
/// let covariance = Covariance::new(&system, &minimum.values)?;
/// let sigma = covariance.block(level, level).expect("it is adjusted")[(0, 0)].sqrt();
/// assert!((sigma - 0.3 / 3.0_f64.sqrt()).abs() < 1e-12);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
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

    /// The covariance between two blocks; zero where a component is held, and `None` where one is held whole or
    /// the pair was not selected. Selected are pairs that share a measurement other than an image point, all pairs
    /// without a pose, and poses of one body within the moments of
    /// [`SystemBuilder::select_within`](super::system::SystemBuilder::select_within).
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

    /// The measurements of a group, in their order: what each sees that is not held whole, and its whitened,
    /// weighted Jacobian by it. Empty for image points that are eliminated along time.
    pub fn jacobians(&self, group: GroupId) -> Vec<Vec<(BlockId, DMatrix<f64>)>> {
        SelectedInverse::jacobians(self.undamped.system, &self.undamped.normal, group)
    }

    /// The leverages of a group: for each measurement `J Q J^T` of its whitened, weighted rows, column by
    /// column. Its diagonal is 1 minus the redundancy numbers.
    pub fn leverages(&self, group: GroupId) -> &[f64] {
        self.selected.leverages(group)
    }
}
