//! What determined the scale of each vehicle.
//!
//! The scale of a shape is that of the similarity that fits a changed shape to the found one: with the points
//! `m` from their weighted middle and weights `w` by their variances,
//!
//! ```text
//! ds = a^T dx = sum w m . dM / sum w |m|^2        variance a^T Q a
//! ```
//!
//! Since `Q^-1 = sum over sources of J^T J`, the variance is a sum over sources, and the share of each
//!
//! ```text
//! |J_source Q a|^2 / a^T Q a
//! ```
//!
//! sums to one. Leaving a source out, its rows weigh nothing and the system is factorised anew. A common
//! error `e` of one standard deviation in all rows of a source moves the unknowns by `Q J^T e`.

use super::inner::UNDETERMINED;
use crate::estimate::Estimate;
use crate::network::{CommonCause, Source};
use crate::refine::Network;
use nalgebra::{DMatrix, Point3, Vector3};
use trackbundle_solver::covariance::{Covariance, Undamped};
use trackbundle_solver::system::GroupId;

/// By what the standard deviations of a source are multiplied that is left out.
const LEFT_OUT: f64 = 1e5;
/// A source of no more rows than this is left out without a factorisation ...
const MOST_ROWS_OUT: usize = 16;
/// ... unless no more than this share of a row is checked by others.
const LEAST_LEFT: f64 = 1e-5;

/// What determined the scale of a vehicle.
#[derive(Clone, Debug)]
pub struct Scale {
    /// Index of the vehicle.
    pub vehicle: usize,
    /// Standard deviation a posteriori, relative; infinite where it is not determined.
    pub sigma: f64,
    /// What each source contributes to the variance; all of them sum to one.
    pub shares: Vec<(Source, f64)>,
    /// The standard deviation without one source.
    pub without: Vec<(Source, f64)>,
    /// What a common error of one standard deviation in all rows of a source does.
    pub common: Vec<(Source, CommonError)>,
}

/// What a common error does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CommonError {
    /// Change of the scale, relative.
    pub scale: f64,
    /// How far it moves the middle of the shape in the world: root mean square over the frames \[m\].
    pub track_m: f64,
}

/// The direction of a scale: `Q a` and `a^T Q a`, both without the variance of unit weight.
pub struct Direction {
    pub step: Vec<f64>,
    pub variance: f64,
    /// The share that comes from conventions.
    pub conventions: f64,
}

/// `a` of each vehicle, a column each; zero where there is no shape.
pub fn functionals(estimate: &Estimate, network: &Network) -> DMatrix<f64> {
    let system = &network.model.system;
    let mut columns = DMatrix::zeros(system.size(), network.frames.len());
    for (vehicle, frame) in network.frames.iter().enumerate() {
        if estimate.vehicles[vehicle].left_out.is_some() || frame.points.is_empty() {
            continue;
        }
        let weighted = || frame.points.iter().zip(&frame.weights);
        let middle = middle(&frame.points, &frame.weights);
        let sum: f64 = weighted().map(|((_, p), w)| w * (p.coords - middle).norm_squared()).sum();
        for ((point, place), weight) in weighted() {
            let Some(block) = network.model.shape_point(vehicle, *point) else { continue };
            let Some(range) = system.range_of(block) else { continue };
            for axis in (0..3).filter(|axis| system.free(block)[*axis]) {
                columns[(range.start + axis, vehicle)] = weight * (place[axis] - middle[axis]) / sum;
            }
        }
    }
    columns
}

fn middle(points: &[(usize, Point3<f64>)], weights: &[f64]) -> Vector3<f64> {
    let sum: Vector3<f64> = points.iter().zip(weights).map(|((_, p), w)| p.coords * *w).sum();
    sum / weights.iter().sum::<f64>()
}

/// The direction of each scale from `Q A`.
pub fn directions(network: &Network, functionals: &DMatrix<f64>, solved: &DMatrix<f64>) -> Vec<Direction> {
    let direction = |vehicle: usize| {
        let step: Vec<f64> = solved.column(vehicle).iter().copied().collect();
        let variance = functionals.column(vehicle).dot(&solved.column(vehicle));
        let conventions = share(network, Source::Convention, &step, variance);
        Direction { step, variance, conventions }
    };
    (0..functionals.ncols()).map(direction).collect()
}

/// The share of a source in a variance `a^T Q a`, given `Q a`.
pub fn share(network: &Network, source: Source, step: &[f64], variance: f64) -> f64 {
    let squares: f64 = network
        .model
        .groups_of(source)
        .flat_map(|group| network.model.system.product(group, &network.values, step))
        .map(|v| v * v)
        .sum();
    if variance > 0.0 { squares / variance } else { 0.0 }
}

/// Sources, each once, in the order of [`Source`].
pub fn sources(network: &Network) -> Vec<Source> {
    let has_rows = |of: &Source| {
        network.model.groups_of(*of).map(|group| network.model.system.rows(group)).sum::<usize>() > 0
    };
    let mut all: Vec<Source> = network.model.sources.iter().map(|(source, _)| *source).collect();
    all.sort_unstable();
    all.dedup();
    all.retain(has_rows);
    all
}

pub fn sigma_of(direction: &Direction, variance_factor: f64) -> f64 {
    let sigma = (direction.variance * variance_factor).sqrt();
    // A variance that cannot be computed determines nothing.
    if direction.conventions > UNDETERMINED || !sigma.is_finite() { f64::INFINITY } else { sigma }
}

/// The scales of all vehicles, given their functionals and directions; without the sources that take a
/// factorisation of their own to be left out ([`leave_out`]), which come back too.
pub fn scales(
    estimate: &Estimate,
    network: &Network,
    covariance: &mut Covariance<'_>,
    (a, found): (&DMatrix<f64>, &[Direction]),
    variance_factor: f64,
) -> (Vec<Scale>, Vec<Source>) {
    let all = sources(network);
    let scale = |(vehicle, direction): (usize, &Direction)| Scale {
        vehicle,
        sigma: sigma_of(direction, variance_factor),
        shares: all
            .iter()
            .map(|source| (*source, share(network, *source, &direction.step, direction.variance)))
            .collect(),
        without: Vec::new(),
        common: Vec::new(),
    };
    let mut scales: Vec<Scale> = found.iter().enumerate().map(scale).collect();
    let mut left = Vec::new();
    for source in all.into_iter().filter(|source| source.is_knowledge()) {
        if let Some(error) = common_error(network, covariance, source) {
            let moved = covariance.times(&DMatrix::from_vec(error.len(), 1, error));
            for scale in &mut scales {
                let change = a.column(scale.vehicle).dot(&moved.column(0));
                let track_m = track_shift(estimate, network, scale.vehicle, moved.as_slice());
                scale.common.push((source, CommonError { scale: change, track_m }));
            }
        }
        match directions_without_few(network, covariance, source, a, found) {
            Some(without) => {
                for scale in &mut scales {
                    scale.without.push((source, sigma_of(&without[scale.vehicle], variance_factor)));
                }
            }
            None => left.push(source),
        }
    }
    scales.retain(|scale| estimate.vehicles[scale.vehicle].left_out.is_none());
    (scales, left)
}

/// Directions without a source of few rows `J`, by Woodbury's formula:
///
/// ```text
/// Q- = Q + Z (1 - J Z)^-1 Z^T      Z = Q J^T
/// ```
///
/// `None` where its rows are many, or are all that holds something.
fn directions_without_few(
    network: &Network,
    covariance: &mut Covariance<'_>,
    source: Source,
    a: &DMatrix<f64>,
    found: &[Direction],
) -> Option<Vec<Direction>> {
    let system = &network.model.system;
    let groups: Vec<_> = network.model.groups_of(source).collect();
    let rows: usize = groups.iter().map(|group| system.rows(*group)).sum();
    if rows > MOST_ROWS_OUT {
        return None;
    }
    let mut transposed = DMatrix::zeros(a.nrows(), rows);
    let mut row = 0;
    for seen in groups.iter().flat_map(|group| covariance.jacobians(*group)) {
        let count = seen.first().map_or(0, |(_, jacobian)| jacobian.nrows());
        for (block, jacobian) in &seen {
            let start = system.range_of(*block)?.start;
            transposed.view_mut((start, row), (jacobian.ncols(), count)).copy_from(&jacobian.transpose());
        }
        row += count;
    }
    let z = covariance.times(&transposed);
    let left = DMatrix::identity(rows, rows) - transposed.tr_mul(&z);
    let eigen = left.clone().symmetric_eigenvalues();
    if eigen.iter().any(|value| *value < LEAST_LEFT) {
        return None;
    }
    let inverse = left.try_inverse()?;
    let direction = |(vehicle, direction): (usize, &Direction)| {
        let moved = &z * (&inverse * z.tr_mul(&a.column(vehicle)));
        let step: Vec<f64> = direction.step.iter().zip(moved.iter()).map(|(d, m)| d + m).collect();
        let variance = direction.variance + a.column(vehicle).dot(&moved.column(0));
        let conventions = share(network, Source::Convention, &step, variance);
        Direction { step, variance, conventions }
    };
    Some(found.iter().enumerate().map(direction).collect())
}

/// Adds to each scale its standard deviation without each of these sources, by a factorisation for each. The
/// system comes back as it was.
pub fn leave_out(
    network: &mut Network,
    scales: &mut [Scale],
    sources: &[Source],
    a: &DMatrix<f64>,
    variance_factor: f64,
) {
    for source in sources {
        let groups: Vec<_> = network.model.groups_of(*source).collect();
        let factors = |group: &GroupId| network.model.system.sigma_factors(*group).to_vec();
        let before: Vec<Vec<f64>> = groups.iter().map(factors).collect();
        for group in &groups {
            network.model.system.set_sigma_factor(*group, LEFT_OUT);
        }
        let without = Undamped::new(&network.model.system, &network.values)
            .map(|mut undamped| directions(network, a, &undamped.times(a)));
        for (group, factors) in groups.iter().zip(before) {
            network.model.system.set_sigma_factors(*group, &factors);
        }
        for scale in scales.iter_mut() {
            let sigma = match &without {
                Ok(without) => sigma_of(&without[scale.vehicle], variance_factor),
                Err(_) => f64::INFINITY,
            };
            scale.without.push((*source, sigma));
            scale.without.sort_by_key(|(source, _)| *source);
        }
    }
}

/// `J^T e` for an error `e` that all rows of a source have in common, of one standard deviation; `None` where
/// that is no error it can have.
fn common_error(network: &Network, covariance: &Covariance<'_>, source: Source) -> Option<Vec<f64>> {
    let Network { model, .. } = network;
    let mut sum = vec![0.0; model.system.size()];
    match source.traits().common_cause {
        CommonCause::None => return None,
        CommonCause::GroundShift => {
            for (group, shifts) in &model.ground_shift {
                let rows = shifts.iter().flat_map(|shift| [*shift, 0.0, 0.0]);
                add(&mut sum, &covariance.transposed_product(*group, &rows.collect::<Vec<_>>()));
            }
        }
        CommonCause::OneSigma => {
            for group in model.groups_of(source) {
                let error = vec![1.0; model.system.rows(group)];
                add(&mut sum, &covariance.transposed_product(group, &error));
            }
        }
    }
    Some(sum)
}

fn add(sum: &mut [f64], part: &[f64]) {
    sum.iter_mut().zip(part).for_each(|(s, p)| *s += p);
}

/// How far a step moves the middle of a shape in the world: root mean square over the frames \[m\].
pub fn track_shift(estimate: &Estimate, network: &Network, vehicle: usize, step: &[f64]) -> f64 {
    let frame = &network.frames[vehicle];
    let system = &network.model.system;
    let weights = &frame.weights;
    let middle = middle(&frame.points, weights);
    let sum: f64 = weights.iter().sum();
    let mut of_middle = Vector3::zeros();
    for ((point, _), weight) in frame.points.iter().zip(weights) {
        let block = network.model.shape_point(vehicle, *point).and_then(|block| system.range_of(block));
        if let Some(range) = block {
            of_middle += Vector3::from_column_slice(&step[range]) * (weight / sum);
        }
    }
    let (mut sum, mut count) = (0.0, 0_usize);
    for (at, pose) in estimate.vehicles[vehicle].poses.iter().enumerate() {
        let block = network.model.vehicle_pose(vehicle, at).and_then(|block| system.range_of(block));
        let (Some(pose), Some(range)) = (pose, block) else { continue };
        let delta = &step[range];
        let turn = Vector3::from_column_slice(&delta[3..6]);
        let moved =
            Vector3::from_column_slice(&delta[..3]) + pose.rotation * (turn.cross(&middle) + of_middle);
        sum += moved.norm_squared();
        count += 1;
    }
    (sum / count.max(1) as f64).sqrt()
}
