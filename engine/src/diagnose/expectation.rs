//! What standard deviations an adjustment will have, and what they come from, before anything is measured.
//!
//! From the network at the true unknowns ([`crate::refine::expected`]): the standard deviations are those of any
//! result. Since `Q^-1 = sum over sources of J^T J`, the variance of a function `a` of the unknowns is a sum over
//! sources,
//!
//! ```text
//! a^T Q a = sum over sources of |J_source Q a|^2
//! ```
//!
//! and each source has its share. Of a track, a speed or a shape the variances at places spread over it are added.

use super::inner::{Inner, Place, shape_rows};
use super::moment::Moment;
use super::precision::{Precision, precision};
use super::scale;
use crate::estimate::Estimate;
use crate::geometry::skew;
use crate::problem::Problem;
use crate::refine::{Network, Source, frame_step};
use nalgebra::{DMatrix, DVector, Point3, Vector3};
use rayon::prelude::*;
use trackbundle_solver::covariance::{Covariance, NoCovariance};
use trackbundle_solver::system::BlockId;

/// Places of a track, and points of a shape, at which shares are taken.
const PLACES: usize = 12;
const POINTS: usize = 16;

/// What can be asked of a vehicle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Quantity {
    /// Place of the track in the plan, both coordinates together.
    TrackPlan,
    /// Its height.
    TrackHeight,
    /// Horizontal speed.
    Speed,
    /// Heading.
    Heading,
    /// Place of a point of the shape, all three coordinates together.
    Shape,
    /// Scale of the shape.
    Scale,
}

impl Quantity {
    /// All of them.
    pub const ALL: [Quantity; 6] = [
        Quantity::TrackPlan,
        Quantity::TrackHeight,
        Quantity::Speed,
        Quantity::Heading,
        Quantity::Shape,
        Quantity::Scale,
    ];
}

/// What the variance of a quantity comes from.
#[derive(Clone, Debug, PartialEq)]
pub struct Influence {
    /// Index of the vehicle.
    pub vehicle: usize,
    /// The quantity.
    pub quantity: Quantity,
    /// The share of each source, the largest first; they sum to one.
    pub shares: Vec<(Source, f64)>,
}

/// What an adjustment will be worth.
#[derive(Clone, Debug)]
pub struct Expectation {
    /// Standard deviations.
    pub precision: Precision,
    /// Relative standard deviation of the scale of each vehicle; infinite where it is not determined.
    pub scales: Vec<f64>,
    /// What variances come from.
    pub influences: Vec<Influence>,
}

/// A function of the unknowns: its gradient, and a variance that it has beside that.
struct Asked {
    vehicle: usize,
    quantity: Quantity,
    gradient: DVector<f64>,
    between: f64,
}

/// The expectation of a network at `truth`, whose motion is set.
pub fn expectation(
    problem: &Problem,
    truth: &Estimate,
    network: &Network,
) -> Result<Expectation, NoCovariance> {
    let mut covariance = Covariance::new(&network.model.system, &network.values)?;
    let functionals = scale::functionals(truth, network);
    let solved = covariance.times(&functionals);
    let directions = scale::directions(network, &functionals, &solved);
    let mut asked: Vec<Asked> = Vec::new();
    for vehicle in 0..problem.vehicles.len() {
        asked.extend(of_track(problem, truth, network, vehicle));
        asked.extend(of_shape(truth, network, vehicle));
        let gradient = functionals.column(vehicle).into_owned();
        asked.push(Asked { vehicle, quantity: Quantity::Scale, gradient, between: 0.0 });
    }
    take_open_directions(truth, network, &mut asked);
    let columns: Vec<_> = asked.iter().map(|one| one.gradient.clone()).collect();
    let steps = covariance.times(&match columns.is_empty() {
        true => DMatrix::zeros(network.model.system.size(), 0),
        false => DMatrix::from_columns(&columns),
    });
    let sources = scale::sources(network);
    let shares: Vec<Vec<f64>> = (0..asked.len())
        .into_par_iter()
        .map(|at| {
            let step: Vec<f64> = steps.column(at).iter().copied().collect();
            sources.iter().map(|source| scale::share(network, *source, &step, 1.0)).collect()
        })
        .collect();
    let mut influences = Vec::new();
    for vehicle in 0..problem.vehicles.len() {
        for quantity in Quantity::ALL {
            let mut sums = vec![0.0; sources.len()];
            for (one, shares) in asked.iter().zip(&shares) {
                if (one.vehicle, one.quantity) == (vehicle, quantity) {
                    sums.iter_mut().zip(shares).for_each(|(sum, share)| *sum += share);
                    let motion = sources.iter().position(|source| *source == Source::VehicleMotion);
                    motion.into_iter().for_each(|at| sums[at] += one.between);
                }
            }
            let all: f64 = sums.iter().sum();
            if !(all > 0.0 && all.is_finite()) {
                continue;
            }
            let mut shares: Vec<(Source, f64)> =
                sources.iter().copied().zip(sums.iter().map(|sum| sum / all)).collect();
            shares.sort_by(|a, b| b.1.total_cmp(&a.1));
            influences.push(Influence { vehicle, quantity, shares });
        }
    }
    let places = Place::of_vehicles(problem, truth);
    let mut inner = Inner::new(network, covariance, 1.0, &places);
    let scales: Vec<f64> = directions.iter().map(|direction| scale::sigma_of(direction, 1.0)).collect();
    for (vehicle, direction) in directions.iter().enumerate() {
        if scales[vehicle].is_infinite() {
            inner.set_undetermined_scale(vehicle, &direction.step, direction.variance);
        }
    }
    let precision = precision(problem, truth, &inner, None);
    Ok(Expectation { precision, scales, influences })
}

/// So many of a number of things, spread evenly.
fn spread(count: usize, wanted: usize) -> Vec<usize> {
    let taken = wanted.min(count);
    (0..taken).map(|k| (2 * k + 1) * count / (2 * taken)).collect()
}

/// Adds a part of a gradient where its block is free.
fn add(network: &Network, gradient: &mut DVector<f64>, block: Option<BlockId>, part: &[f64]) {
    let Some(block) = block else { return };
    let Some(range) = network.model.system.range_of(block) else { return };
    for (axis, free) in network.model.system.free(block).iter().enumerate() {
        if *free {
            gradient[range.start + axis] += part[axis];
        }
    }
}

/// Puts functions under the inner constraints of their shapes: `S^T a`, `S = 1 - G B^T`. Only what depends on the
/// choice of a body's frame changes.
fn take_open_directions(truth: &Estimate, network: &Network, asked: &mut [Asked]) {
    for (vehicle, frame) in network.frames.iter().enumerate() {
        let held = shape_rows(network, vehicle, frame);
        let motions: Vec<DVector<f64>> = frame
            .open
            .iter()
            .map(|direction| DVector::from_vec(frame_step(truth, &network.model, vehicle, direction)))
            .collect();
        for one in asked.iter_mut().filter(|one| one.vehicle == vehicle) {
            let open = motions.iter().map(|motion| motion.dot(&one.gradient));
            one.gradient -= &held * DVector::from_iterator(motions.len(), open);
        }
    }
}

fn of_track(problem: &Problem, truth: &Estimate, network: &Network, vehicle: usize) -> Vec<Asked> {
    let (settings, found) = (&problem.vehicles[vehicle], &truth.vehicles[vehicle]);
    let model = &network.model;
    let marker = settings.marker.and_then(|at| found.points[at]).unwrap_or_else(Point3::origin);
    let marker_block = settings.marker.and_then(|at| model.shape_point(vehicle, at));
    let size = model.system.size();
    let frames: Vec<usize> = settings.span().filter(|frame| found.poses[*frame].is_some()).collect();
    let path = found.path(problem, settings);
    let mut all = Vec::new();
    for at in spread(frames.len(), PLACES) {
        let frame = frames[at];
        let Some(pose) = found.poses[frame] else { continue };
        let turn = pose.rotation.to_rotation_matrix();
        let by_turn = -(turn.matrix() * skew(&marker.coords));
        let block = model.vehicle_pose(vehicle, frame);
        for axis in 0..3 {
            let mut gradient = DVector::zeros(size);
            let mut part = [0.0; 6];
            part[axis] = 1.0;
            (0..3).for_each(|k| part[3 + k] = by_turn[(axis, k)]);
            add(network, &mut gradient, block, &part);
            let row: Vector3<f64> = turn.matrix().row(axis).transpose();
            add(network, &mut gradient, marker_block, row.as_slice());
            let quantity = if axis < 2 { Quantity::TrackPlan } else { Quantity::TrackHeight };
            all.push(Asked { vehicle, quantity, gradient, between: 0.0 });
        }
        let moment = path.as_ref().and_then(|path| path.linear_at(problem.frames[frame].time_s));
        let Some(moment) = moment.map(|linear| Moment { linear, marker }) else { continue };
        for (quantity, function) in
            [(Quantity::Speed, moment.of_speed()), (Quantity::Heading, moment.of_heading())]
        {
            let mut gradient = DVector::zeros(size);
            for (knot, (shift, turn)) in moment.linear.knots.clone().zip(moment.by_poses(&function)) {
                let part = [shift.x, shift.y, shift.z, turn.x, turn.y, turn.z];
                add(network, &mut gradient, model.vehicle_pose(vehicle, frames[knot]), &part);
            }
            add(network, &mut gradient, marker_block, function.1.as_slice());
            all.push(Asked { vehicle, quantity, gradient, between: moment.between(&function) });
        }
    }
    all
}

/// Coordinates of points.
fn of_shape(truth: &Estimate, network: &Network, vehicle: usize) -> Vec<Asked> {
    let model = &network.model;
    let count = truth.vehicles[vehicle].points.len();
    let points: Vec<BlockId> = (0..count).filter_map(|point| model.shape_point(vehicle, point)).collect();
    let mut all = Vec::new();
    for at in spread(points.len(), POINTS) {
        for axis in 0..3 {
            let mut gradient = DVector::zeros(model.system.size());
            let mut part = [0.0; 3];
            part[axis] = 1.0;
            add(network, &mut gradient, Some(points[at]), &part);
            all.push(Asked { vehicle, quantity: Quantity::Shape, gradient, between: 0.0 });
        }
    }
    all
}
