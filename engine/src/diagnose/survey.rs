//! Baarda's test of each surveyed coordinate that is an observation.
//!
//! A coordinate of standard deviation `s` was corrected by the adjustment; its survey minus its adjusted value has
//! the variance `s^2 - q`, `q` its own a posteriori, both for a variance of unit weight of 1:
//!
//! ```text
//! w = (survey - adjusted) / sqrt(s^2 - q)
//! ```

use super::statistics::UNCHECKED;
use crate::estimate::Estimate;
use crate::problem::{Known, Problem, Role};
use nalgebra::Point3;

/// For each target the statistic of each coordinate; `None` where it is no observation, or nothing checks it.
/// `sigmas_m` are those a posteriori; where they are upper bounds, so are the statistics.
pub fn survey_tests(
    problem: &Problem,
    estimate: &Estimate,
    sigmas_m: &[Option<[f64; 3]>],
    variance: f64,
) -> Vec<[Option<f64>; 3]> {
    let of_target = |target: usize| -> Option<[Option<f64>; 3]> {
        let known = &problem.targets[target].known;
        let place: Point3<f64> = estimate.targets[target]?;
        let sigmas_m = sigmas_m.get(target).copied().flatten()?;
        let one = |axis: usize| {
            let Known { value_m, sigma_m } = known[axis].filter(|known| known.sigma_m > 0.0)?;
            let stated = sigma_m * sigma_m;
            let left = stated - sigmas_m[axis] * sigmas_m[axis] / variance;
            (left > UNCHECKED * stated).then(|| (value_m - place[axis]) / left.sqrt())
        };
        (problem.targets[target].role == Role::Control).then(|| [0, 1, 2].map(one))
    };
    (0..problem.targets.len()).map(|target| of_target(target).unwrap_or_default()).collect()
}
