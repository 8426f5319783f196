//! How an image point fits.

use nalgebra::Vector2;

/// How an image point fits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObservationFit {
    /// Observed minus computed \[px\].
    pub residual_px: Vector2<f64>,
    /// What it weighs: 1 in full, 0 not at all.
    pub weight: f64,
    /// Whether it is a gross error, by itself or with its track or frame.
    pub is_outlier: bool,
}

impl ObservationFit {
    /// Whether it takes part in least squares: it is no gross error and belongs to no check point.
    pub fn is_accepted(&self) -> bool {
        !self.is_outlier && self.weight > 0.0
    }
}
