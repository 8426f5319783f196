//! How far a result can be trusted: what is determined and by what, standard deviations, tests.
//!
//! Everything is computed from the final least squares ([`crate::refine::Network`]): the undamped, unscaled
//! normal equations of accepted image points and what is known.

mod check_points;
mod expectation;
mod inner;
mod moment;
pub mod observability;
pub mod parameters;
mod precision;
mod pull;
mod scale;
mod standstill;
mod statistics;
mod survey;
mod verdict;

pub use check_points::CheckPrecision;
pub use expectation::{Expectation, Influence, Quantity, expectation};
pub use parameters::Parameter;
pub use precision::{PosePrecision, Precision, StatePrecision, TrackPrecision};
pub use pull::{Pull, PullCause};
pub use scale::{CommonError, Scale};
pub use statistics::{Component, Reliability, Statistics, VarianceTest};
pub use verdict::{Trust, Verdict, VerdictFact, VerdictReason};

use crate::estimate::{Estimate, VehicleEstimate};
use crate::problem::{Problem, Vehicle};
use crate::refine::{Adjusted, CheckPoint, Network, Source, alone};
use crate::rules::Rules;
use inner::{Inner, Place, UNDETERMINED};
use observability::{Observability, observability};
use pull::Pulls;
use trackbundle_solver::covariance::{Covariance, NoCovariance};

/// The most image points whose rows are examined for what they leave open: some kilobytes each.
const MOST_EXAMINED: usize = 300_000;

/// The constants of the diagnosis.
pub fn constants() -> Vec<Rules> {
    vec![parameters::ParameterRules::PAGE]
}

/// Why there are no standard deviations.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum NoSigmas {
    /// The run ended before.
    NotReached,
    /// The diagnosis itself failed, and says why.
    Failed(String),
    /// There is no final least squares.
    NoLeastSquares,
    /// The normal equations have no inverse, or none that fits into memory.
    NoCovariance(NoCovariance),
}

/// What can be said of a result.
#[derive(Clone, Debug)]
pub struct Diagnosis {
    /// Standard deviations.
    pub precision: Precision,
    /// Statistics of the observations.
    pub statistics: Statistics,
    /// What determined the scale of each vehicle that was adjusted.
    pub scales: Vec<Scale>,
    /// What measurements and knowledge leave open, by name; `None` where image points are too many.
    pub observability: Option<Observability>,
    /// Whether vehicles were judged one by one, so that standard deviations are upper bounds.
    pub is_upper_bound: bool,
    /// How well check points agree, in the order of the adjustment.
    pub check_points: Vec<CheckPrecision>,
    /// For each target Baarda's w of each surveyed coordinate that is an observation.
    pub survey_tests: Vec<[Option<f64>; 3]>,
    /// What is adjusted beside poses and points.
    pub parameters: Vec<Parameter>,
    /// From when to when each vehicle stands \[s\].
    pub standstill: Vec<Vec<[f64; 2]>>,
    /// For every vehicle of the problem the probability that it looks the other way.
    pub headings_turned: Vec<f64>,
    /// What conventions and estimated strengths of motion do to each vehicle.
    pub pulls: Vec<Pull>,
    /// For each vehicle how many directions of its frame are a convention, and the standard deviations of the
    /// six from what is known: root mean square over the points \[m\], worst first.
    pub frames: Vec<(usize, Vec<f64>)>,
}

/// Diagnoses a result; `None` where it has no final least squares.
pub fn diagnose(problem: &Problem, adjusted: &mut Adjusted) -> Option<Result<Diagnosis, NoCovariance>> {
    diagnose_with_states(problem, adjusted, None)
}

/// [`diagnose`], with the standard deviations of paths so many times a second.
pub fn diagnose_with_states(
    problem: &Problem,
    adjusted: &mut Adjusted,
    states_hz: Option<f64>,
) -> Option<Result<Diagnosis, NoCovariance>> {
    // Without redundancy the standard deviations stated are all that is known.
    let variance = adjusted.adjustment.sigma0.map_or(1.0, |sigma0| sigma0 * sigma0);
    let Adjusted { estimate, adjustment, network } = adjusted;
    let checks = &adjustment.check_points;
    let mut found = match of_network(problem, estimate, network.as_mut()?, checks, variance, states_hz) {
        Err(NoCovariance::NotSelected) => vehicle_by_vehicle(problem, adjusted, variance, states_hz),
        found => found,
    };
    let vehicles = problem.vehicles.iter().map(|vehicle| vehicle.observations.len());
    let image_points = vehicles.sum::<usize>() + problem.target_observations.len();
    if let Ok(found) = &mut found {
        let sigmas_m = &found.precision.targets;
        let vehicles = adjusted.estimate.vehicles.iter();
        found.headings_turned = vehicles.map(|vehicle| vehicle.heading_turned).collect();
        found.survey_tests = survey::survey_tests(problem, &adjusted.estimate, sigmas_m, variance);
        if image_points <= MOST_EXAMINED {
            found.observability = Some(observability(problem, &adjusted.estimate));
        }
    }
    Some(found)
}

/// The same where vehicles are too many for one covariance: each with cameras and targets, as if the others
/// had not been seen. What these say of the cameras is left out, so that all variances are upper bounds; of
/// cameras and targets the least is taken.
fn vehicle_by_vehicle(
    problem: &Problem,
    adjusted: &Adjusted,
    variance: f64,
    states_hz: Option<f64>,
) -> Result<Diagnosis, NoCovariance> {
    let mut all: Option<Diagnosis> = None;
    for vehicle in 0..problem.vehicles.len() {
        let Some((own, estimate, mut network)) = alone(problem, adjusted, vehicle) else { continue };
        // Once is enough.
        let checks = if all.is_none() { adjusted.adjustment.check_points.as_slice() } else { &[] };
        let mut found = of_network(&own, &estimate, &mut network, checks, variance, states_hz)?;
        found.scales.iter_mut().for_each(|scale| scale.vehicle = vehicle);
        found.pulls.iter_mut().for_each(|pull| pull.vehicle = vehicle);
        match &mut all {
            None => all = Some(found),
            Some(all) => all.join(found),
        }
    }
    let mut all = all.ok_or(NoCovariance::NotSelected)?;
    all.is_upper_bound = true;
    all.statistics.set_test(&adjusted.adjustment);
    Ok(all)
}

impl Diagnosis {
    /// Adds the diagnosis of another vehicle under the same cameras.
    fn join(&mut self, other: Diagnosis) {
        let Diagnosis { precision, statistics, scales, pulls, frames, parameters, standstill, .. } = other;
        self.standstill.extend(standstill);
        self.precision.join(precision);
        self.statistics.join(statistics);
        self.scales.extend(scales);
        self.pulls.extend(pulls);
        self.frames.extend(frames);
        self.join_parameters(parameters);
    }
}

impl Diagnosis {
    /// Of what cameras share the least standard deviation counts; clocks belong to their vehicles.
    fn join_parameters(&mut self, others: Vec<Parameter>) {
        for other in others {
            match self.parameters.iter_mut().find(|own| (own.name, &own.of) == (other.name, &other.of)) {
                Some(own) if other.sigma < own.sigma => *own = other,
                Some(_) => {}
                None => self.parameters.push(other),
            }
        }
    }
}

fn of_network(
    problem: &Problem,
    estimate: &Estimate,
    network: &mut Network,
    checks: &[CheckPoint],
    variance: f64,
    states_hz: Option<f64>,
) -> Result<Diagnosis, NoCovariance> {
    let mut covariance = Covariance::new(&network.model.system, &network.values)?;
    let functionals = scale::functionals(estimate, network);
    let solved = covariance.times(&functionals);
    let directions = scale::directions(network, &functionals, &solved);
    let statistics = statistics::statistics(problem, network, &covariance);
    let (mut scales, left) =
        scale::scales(estimate, network, &mut covariance, (&functionals, &directions), variance);
    let check_points =
        check_points::check_points(problem, estimate, checks, network, &mut covariance, variance);
    let parameters = parameters::parameters(problem, estimate, network, &mut covariance, variance);
    let pulls = Pulls::new(problem, network, &mut covariance);
    let places = Place::of_vehicles(problem, estimate);
    let mut inner = Inner::new(network, covariance, variance, &places);
    for (vehicle, direction) in directions.iter().enumerate() {
        if direction.conventions > UNDETERMINED {
            inner.set_undetermined_scale(vehicle, &direction.step, direction.variance);
        }
    }
    let precision = precision::precision(problem, estimate, &inner, states_hz);
    // Its memory is wanted below.
    drop(inner);
    let standstill = standstills(problem, estimate, &precision);
    let pulls = pulls.of_result(problem, estimate, network, &functionals, (&precision, &scales));
    let frames = network
        .frames
        .iter()
        .map(|frame| (frame.open.len(), frame.known.iter().map(|known| known.0).collect()))
        .collect();
    scale::leave_out(network, &mut scales, &left, &functionals, variance);
    let (observability, is_upper_bound) = (None, false);
    Ok(Diagnosis {
        precision,
        statistics,
        scales,
        observability,
        is_upper_bound,
        check_points,
        survey_tests: Vec::new(),
        parameters,
        standstill,
        headings_turned: Vec::new(),
        pulls,
        frames,
    })
}

/// When each vehicle stands.
fn standstills(problem: &Problem, estimate: &Estimate, precision: &Precision) -> Vec<Vec<[f64; 2]>> {
    let of_vehicle = |(vehicle, (found, sigmas)): (&Vehicle, (&VehicleEstimate, &Vec<_>))| {
        if found.left_out.is_some() {
            return Vec::new();
        }
        let places = found.track(problem, vehicle).into_iter().enumerate().filter_map(|(at, place)| {
            let sigma: Option<&TrackPrecision> = sigmas.get(at).and_then(Option::as_ref);
            Some((problem.frames[place.frame].time_s, place.speed_mps?, sigma.and_then(|s| s.speed_mps)))
        });
        standstill::standstill(places)
    };
    problem.vehicles.iter().zip(estimate.vehicles.iter().zip(&precision.tracks)).map(of_vehicle).collect()
}

/// The name of a source in files: a key of `report.json`, a value in `cells.csv`. It stays as it is whatever a
/// source is called in a sentence.
pub fn source_key(source: Source) -> &'static str {
    source.traits().key
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sources_are_called_in_files_as_ever() {
        use Source::*;
        let all = [
            (VehicleImages, "image points of vehicles"),
            (TargetImages, "image points of targets"),
            (Survey, "survey of targets"),
            (Terrain, "terrain contact"),
            (KnownHeight, "known height"),
            (KnownPoint, "known points"),
            (Calibration, "known interior orientation"),
            (Readout, "known readout time"),
            (Gnss, "GNSS positions"),
            (GnssKnowledge, "knowledge of GNSS receivers"),
            (CameraPoses, "given camera poses"),
            (CameraMotion, "motion of the camera"),
            (VehicleMotion, "motion of vehicles"),
            (Driving, "rolling of rear axles"),
            (Frame, "frame of the body"),
            (Convention, "conventions"),
        ];
        for (source, key) in all {
            assert_eq!(source_key(source), key);
        }
    }
}
