//! Medians, quantiles, robust scatters, and the distributions that tests go by.
//!
//! Two conventions stand side by side. What is told of a sample is interpolated ([`quantile`](quantile::quantile),
//! [`median`](quantile::median)); what a decision is made by inside an estimation is one of the values
//! ([`upper_median`](quantile::upper_median), [`value_at_share`](quantile::value_at_share)), which for an even number
//! is the larger of the two middle ones.

pub mod chi_square;
pub mod drawn;
pub mod normal;
pub mod quantile;
pub mod series;
pub mod weighted;
