//! The result of a score test: what a number that is held would be, and how certain that is.

use crate::stats::normal::TWO_SIDED_99_9;

/// Critical value at a level of 0.1 %.
pub const CRITICAL: f64 = TWO_SIDED_99_9;
/// The test of a number.
#[derive(Clone, Debug, PartialEq)]
pub struct DirectedTest {
    /// Its name, with its unit at the end.
    pub name: &'static str,
    /// Whose.
    pub of: Option<String>,
    /// What it is held at.
    pub held_at: f64,
    /// What it would be, to first order.
    pub estimate: f64,
    /// Standard deviation of that.
    pub sigma: f64,
}

impl DirectedTest {
    /// Standard normal where the number is what it is held at.
    pub fn statistic(&self) -> f64 {
        (self.estimate - self.held_at) / self.sigma
    }

    /// Whether that is rejected at a level of 0.1 %.
    pub fn is_rejected(&self) -> bool {
        self.statistic().abs() > CRITICAL
    }
}
