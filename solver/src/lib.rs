//! Sparse nonlinear least squares: the solver knows nothing of cameras and vehicles.
//!
//! Minimised is `sum over measurements of rho(|r|^2) / 2`, where `r` is a whitened residual
//! (divided by its standard deviation) and `rho` a robust loss.

pub mod covariance;
pub mod geometry;
pub mod linear;
pub mod loss;
pub mod manifold;
pub mod minimise;
pub mod residual;
pub mod system;
