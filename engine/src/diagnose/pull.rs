//! What conventions, and the strengths of motion that were estimated, do to a result: their pull.
//!
//! At the minimum the gradients of all rows are in balance. Without the rows of some group, `r` whitened, the
//! unknowns would move by `Q J^T r` to first order, and that is how far the group pulls them the other way. For
//! what is knowledge that is as it should be. A convention is nobody's knowledge, and must pull nothing that is
//! read: each pull is given in standard deviations of what it pulls at.
//!
//! A strength `s` of a motion prior weighs its rows by `1 / s^2`. Where it is estimated, it is known to
//! `d(ln s) = 1 / sqrt(2 redundancy)`, and an error of that size moves the unknowns by
//!
//! ```text
//! 2 Q J^T r d(ln s)
//! ```
//!
//! What is not determined has no standard deviation, and nothing that could be pulled.

use super::inner::{Place, functional, shape_rows};
use super::statistics::of_group;
use super::{Precision, Scale};
use crate::estimate::Estimate;
use crate::geometry::skew;
use crate::network::{Body, Source, frame_step};
use crate::problem::Problem;
use crate::refine::Network;
use nalgebra::{DMatrix, DVector, Vector3};
use trackbundle_solver::covariance::Covariance;
use trackbundle_solver::system::GroupId;

/// What pulls.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PullCause {
    /// Rows that are nobody's knowledge.
    Conventions,
    /// An error of one standard deviation in the strengths of motion that were estimated.
    MotionStrengths,
}

/// How far something pulls at a vehicle and its cameras, in standard deviations of these.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pull {
    /// Index of the vehicle.
    pub vehicle: usize,
    /// What pulls.
    pub cause: PullCause,
    /// At its scale.
    pub scale: f64,
    /// At the coordinate of its track that is pulled most.
    pub track: f64,
    /// At the coordinate of its shape that is pulled most.
    pub shape: f64,
    /// At the coordinate of a camera position that is pulled most.
    pub camera: f64,
}

impl Pull {
    /// The largest of them.
    pub fn largest(&self) -> f64 {
        [self.scale, self.track, self.shape, self.camera].into_iter().fold(0.0, f64::max)
    }
}

/// The steps by which each cause pulls at the vehicles, unknowns in elimination order.
pub struct Pulls {
    conventions: DVector<f64>,
    /// Of the camera's motion, whatever the vehicle.
    of_camera: Vec<DVector<f64>>,
    /// Of the motion of each vehicle.
    of_vehicles: Vec<Vec<DVector<f64>>>,
}

impl Pulls {
    /// What pulls in a network.
    pub fn new(problem: &Problem, network: &Network, covariance: &mut Covariance<'_>) -> Pulls {
        let size = network.model.system.size();
        let mut gradient = DVector::zeros(size);
        for group in network.model.groups_of(Source::Convention) {
            // By what they weighed at the minimum.
            gradient +=
                gradient_of(network, covariance, group, |_| true) * network.model.weight_before(group);
        }
        let conventions = times(covariance, gradient);
        let estimated = network.model.motion.estimated_groups();
        let mut of = |body: &Body| -> Vec<DVector<f64>> {
            let own = estimated.iter().filter(|(of, ..)| *of == body).map(|(_, group, rows)| (*group, *rows));
            own.filter(|(group, _)| network.model.system.rows(*group) > 0)
                .map(|(group, tells)| {
                    let (_, redundancy, _) = of_group(network, covariance, group);
                    let step = times(covariance, gradient_of(network, covariance, group, |row| tells[row]));
                    step * (2.0 / (2.0 * redundancy.max(LEAST_REDUNDANCY)).sqrt())
                })
                .collect()
        };
        let of_camera = of(&Body::Camera);
        let of_vehicles = problem.vehicles.iter().map(|v| of(&Body::Vehicle(v.id.clone()))).collect();
        Pulls { conventions, of_camera, of_vehicles }
    }

    /// How far they pull. `functionals` are those of the scales, a column for each vehicle.
    pub fn of_result(
        &self,
        problem: &Problem,
        estimate: &Estimate,
        network: &Network,
        functionals: &DMatrix<f64>,
        (precision, scales): (&Precision, &[Scale]),
    ) -> Vec<Pull> {
        let mut pulls = Vec::new();
        for scale in scales {
            let pulled = Pulled::new(problem, estimate, network, functionals, (precision, scale));
            let of_strengths = self.of_camera.iter().chain(&self.of_vehicles[scale.vehicle]);
            let steps = [
                (PullCause::Conventions, vec![&self.conventions]),
                (PullCause::MotionStrengths, of_strengths.collect()),
            ];
            pulls.extend(steps.into_iter().map(|(cause, steps)| pulled.by(cause, &steps)));
        }
        pulls
    }
}

/// Of a coordinate of a point that is worth a word \[m\].
const MOST_SIGMA_M: f64 = 1.0;

/// A strength is not known worse than this redundancy says.
const LEAST_REDUNDANCY: f64 = 0.5;

/// `J^T r` of these rows of each measurement of a group that is no image points, whitened.
fn gradient_of(
    network: &Network,
    covariance: &Covariance<'_>,
    group: GroupId,
    takes_part: impl Fn(usize) -> bool,
) -> DVector<f64> {
    let system = &network.model.system;
    let mut gradient = DVector::zeros(system.size());
    let residuals = system.residuals(group, &network.values);
    for (residual, seen) in residuals.into_iter().zip(covariance.jacobians(group)) {
        let Some(mut residual) = residual.map(DVector::from_vec) else { continue };
        residual.iter_mut().enumerate().for_each(|(row, r)| *r *= f64::from(u8::from(takes_part(row))));
        for (block, jacobian) in seen {
            let Some(range) = system.range_of(block) else { continue };
            let mut rows = gradient.rows_mut(range.start, range.len());
            rows += jacobian.tr_mul(&residual);
        }
    }
    gradient
}

fn times(covariance: &mut Covariance<'_>, gradient: DVector<f64>) -> DVector<f64> {
    let size = gradient.len();
    covariance.times(&DMatrix::from_column_slice(size, 1, gradient.as_slice())).column(0).into_owned()
}

/// What is pulled at.
struct Pulled<'a> {
    problem: &'a Problem,
    estimate: &'a Estimate,
    network: &'a Network,
    functionals: &'a DMatrix<f64>,
    precision: &'a Precision,
    scale: &'a Scale,
    /// `B` of the open directions of its frame, and each of them as a step.
    shape: DMatrix<f64>,
    open: Vec<DVector<f64>>,
    /// The place whose track is wanted, where it is not the origin.
    place: Option<DMatrix<f64>>,
}

impl<'a> Pulled<'a> {
    fn new(
        problem: &'a Problem,
        estimate: &'a Estimate,
        network: &'a Network,
        functionals: &'a DMatrix<f64>,
        (precision, scale): (&'a Precision, &'a Scale),
    ) -> Self {
        let vehicle = scale.vehicle;
        let frame = &network.frames[vehicle];
        let step = |direction| frame_step(estimate, &network.model, vehicle, direction);
        let place = Place::of_vehicle(&problem.vehicles[vehicle], &estimate.vehicles[vehicle]);
        Pulled {
            problem,
            estimate,
            network,
            functionals,
            precision,
            scale,
            shape: shape_rows(network, vehicle, frame),
            open: frame.open.iter().map(|direction| DVector::from_vec(step(direction))).collect(),
            place: place.and_then(|place| functional(network, vehicle, place)),
        }
    }

    /// Independent steps of one cause, taken together.
    fn by(&self, cause: PullCause, steps: &[&DVector<f64>]) -> Pull {
        let mut squares = [Vec::new(), Vec::new(), Vec::new(), Vec::new()];
        for step in steps {
            for (squares, found) in squares.iter_mut().zip(self.ratios(step)) {
                squares.resize(found.len(), 0.0);
                squares.iter_mut().zip(found).for_each(|(sum, ratio): (&mut f64, f64)| *sum += ratio * ratio);
            }
        }
        let [scale, track, shape, camera] =
            squares.map(|squares| squares.into_iter().fold(0.0, f64::max).sqrt());
        Pull { vehicle: self.scale.vehicle, cause, scale, track, shape, camera }
    }

    /// By how many standard deviations a step moves the scale, and each coordinate of track, shape and cameras.
    fn ratios(&self, step: &DVector<f64>) -> [Vec<f64>; 4] {
        let vehicle = self.scale.vehicle;
        let (model, found) = (&self.network.model, &self.estimate.vehicles[vehicle]);
        let frame = &self.network.frames[vehicle];
        // A mere change of the frame of the body moves nothing.
        let of_frame = self.shape.tr_mul(step);
        let mut own = step.clone();
        for (direction, part) in self.open.iter().zip(of_frame.iter()) {
            own -= direction * *part;
        }
        let part = |of: &DVector<f64>, block, at: usize| match model.system.range_of(block) {
            Some(range) => Vector3::from_fn(|k, _| of[range.start + at + k]),
            None => Vector3::zeros(),
        };
        let scale = vec![ratio(self.functionals.column(vehicle).dot(step), self.scale.sigma)];
        let of_vehicle = &self.problem.vehicles[vehicle];
        let marker = of_vehicle.marker.and_then(|at| found.points[at]);
        let of_place = |place: &DMatrix<f64>| place.tr_mul(&own).fixed_rows::<3>(0).into_owned();
        let of_place = self.place.as_ref().map_or(Vector3::zeros(), of_place);
        let mut track = Vec::new();
        let places = found.places(of_vehicle).zip(&self.precision.tracks[vehicle]);
        for ((frame, _), sigmas) in places {
            let (Some(block), Some(pose)) = (model.vehicle_pose(vehicle, frame), found.poses[frame]) else {
                continue;
            };
            let mut moved = part(&own, block, 0);
            let turned =
                marker.map_or(Vector3::zeros(), |place| -(skew(&place.coords) * part(&own, block, 3)));
            moved += pose.rotation * (turned + of_place);
            let sigmas = sigmas.as_ref().map_or([f64::INFINITY; 3], |sigmas| sigmas.position_m);
            track.extend([0, 1, 2].map(|axis| ratio(moved[axis], sigmas[axis])));
        }
        let points = frame.points.iter().filter_map(|(at, _)| {
            let (block, sigmas) = (model.shape_point(vehicle, *at)?, self.precision.points[vehicle][*at]?);
            // A point that is known no better than a body is large is where a body is.
            let is_known = sigmas.iter().all(|sigma| *sigma < MOST_SIGMA_M);
            let moved = part(&own, block, 0);
            is_known.then(|| [0, 1, 2].map(|axis| ratio(moved[axis], sigmas[axis])))
        });
        let cameras = self.precision.cameras.iter().enumerate().filter_map(|(frame, sigmas)| {
            let moved = part(step, model.camera(frame), 0);
            let sigmas = sigmas.as_ref()?.position_m;
            Some([0, 1, 2].map(|axis| ratio(moved[axis], sigmas[axis])))
        });
        [scale, track, points.flatten().collect(), cameras.flatten().collect()]
    }
}

fn ratio(moved: f64, sigma: f64) -> f64 {
    if sigma > 0.0 && sigma.is_finite() { moved.abs() / sigma } else { 0.0 }
}
