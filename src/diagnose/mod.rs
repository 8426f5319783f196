//! How far a result can be trusted: what is determined and by what, standard deviations, tests.
//!
//! Everything is computed from the final least squares ([`crate::refine::Network`]): the undamped, unscaled
//! normal equations of accepted image points and what is known.

mod check_points;
mod distribution;
mod inner;
pub mod observability;
mod precision;
mod scale;
mod statistics;
mod verdict;

pub use check_points::CheckPoint;
pub use precision::{PosePrecision, Precision, TrackPrecision};
pub use scale::{CommonError, Scale};
pub use statistics::{Component, Reliability, Statistics, VarianceTest};
pub use verdict::{Trust, Verdict};

use crate::estimate::Estimate;
use crate::nlls::covariance::{Covariance, NoCovariance};
use crate::problem::Problem;
use crate::refine::{Adjusted, Network, Source};
use inner::{Inner, UNDETERMINED};

/// What can be said of a result.
#[derive(Clone, Debug)]
pub struct Diagnosis {
    /// Standard deviations.
    pub precision: Precision,
    /// Statistics of the observations.
    pub statistics: Statistics,
    /// What determined the scale of each vehicle that was adjusted.
    pub scales: Vec<Scale>,
    /// Check points.
    pub check_points: Vec<CheckPoint>,
    /// For each vehicle how many directions of its frame are a convention, and the standard deviations of the
    /// six from what is known: root mean square over the points \[m\], worst first.
    pub frames: Vec<(usize, Vec<f64>)>,
}

/// Diagnoses a result; `None` where it has no final least squares.
pub fn diagnose(problem: &Problem, adjusted: &mut Adjusted) -> Option<Result<Diagnosis, NoCovariance>> {
    let Adjusted { estimate, adjustment, network } = adjusted;
    let network = network.as_mut()?;
    // Without redundancy the standard deviations stated are all that is known.
    let variance = adjustment.sigma0.map_or(1.0, |sigma0| sigma0 * sigma0);
    Some(of_network(problem, estimate, network, variance))
}

fn of_network(
    problem: &Problem,
    estimate: &Estimate,
    network: &mut Network,
    variance: f64,
) -> Result<Diagnosis, NoCovariance> {
    let mut covariance = Covariance::new(&network.model.system, &network.values)?;
    let functionals = scale::functionals(estimate, network);
    let solved = covariance.times(&functionals);
    let directions = scale::directions(network, &functionals, &solved);
    let statistics = statistics::statistics(problem, network, &covariance);
    let (mut scales, left) =
        scale::scales(estimate, network, &mut covariance, (&functionals, &directions), variance);
    let check_points = check_points::check_points(problem, estimate, network, &mut covariance, variance);
    let markers: Vec<Option<usize>> = problem
        .vehicles
        .iter()
        .zip(&estimate.vehicles)
        .map(|(vehicle, found)| vehicle.marker.filter(|marker| found.points[*marker].is_some()))
        .collect();
    let mut inner = Inner::new(network, covariance, variance, &markers);
    for (vehicle, direction) in directions.iter().enumerate() {
        if direction.conventions > UNDETERMINED {
            inner.set_undetermined_scale(vehicle, &direction.step, direction.variance);
        }
    }
    let precision = precision::precision(problem, estimate, &inner);
    // Its memory is wanted below.
    drop(inner);
    let frames = network
        .frames
        .iter()
        .map(|frame| (frame.open.len(), frame.known.iter().map(|known| known.0).collect()))
        .collect();
    scale::leave_out(network, &mut scales, &left, &functionals, variance);
    Ok(Diagnosis { precision, statistics, scales, check_points, frames })
}

/// A source in the user's words.
pub fn source_name(source: Source) -> &'static str {
    match source {
        Source::VehicleImages => "image points of vehicles",
        Source::TargetImages => "image points of targets",
        Source::Survey => "survey of targets",
        Source::Terrain => "terrain contact",
        Source::KnownHeight => "known height",
        Source::KnownPoint => "known points",
        Source::CameraPoses => "given camera poses",
        Source::CameraMotion => "motion of the camera",
        Source::VehicleMotion => "motion of vehicles",
        Source::Frame => "frame of the body",
        Source::Convention => "conventions",
    }
}
