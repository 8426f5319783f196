//! The cost, and the quadratic model that a step minimises.

/// The cost of a state and how it comes about.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Cost {
    /// Half the sum of `rho`.
    pub value: f64,
    /// Measurements with an impossible geometry, charged
    /// [`IMPOSSIBLE_SIGMAS`](crate::system::IMPOSSIBLE_SIGMAS) each.
    pub impossible: usize,
}

/// What a quadratic model adds to the Gauss-Newton one, and what it takes from it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Curvature {
    /// Share of the diagonal of the normal matrix that is added to it.
    pub damping: f64,
    /// How flat the model may be along a residual whose loss bends, as a share of its curvature
    /// across: 1 is iteratively re-weighted least squares, towards 0 Newton's method
    /// ([`Loss::flatness`](crate::loss::Loss::flatness)).
    pub least_flatness: f64,
}

impl Curvature {
    /// Neither damped nor flattened.
    pub const PLAIN: Curvature = Curvature { damping: 0.0, least_flatness: 1.0 };
}

/// A damped step and what the quadratic model says of it.
pub(crate) struct Step {
    /// The perturbation of every free block.
    pub delta: Vec<f64>,
    /// `g^T delta`
    pub slope: f64,
    /// `delta^T D delta`, where `D` is the diagonal of the normal matrix.
    pub squared: f64,
}

/// The entries of a diagonal that scale the damping.
pub(super) fn clamped(diagonal: f64) -> f64 {
    diagonal.clamp(1e-12, 1e32)
}
