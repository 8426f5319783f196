//! One cell: what its standard deviations will be, and what a run of its Monte Carlo is off by.

use crate::cloud::CloudIndex;
use crate::diagnose::{Influence, Quantity, expectation, source_key};
use crate::estimate::{Estimate, VehicleEstimate};
use crate::network::{BodyFrame, MotionPriors, camera_gap};
use crate::pipeline::{Options, start};
use crate::problem::Problem;
use crate::refine::expected;
use crate::simulate::scenario::{BodySettings, Scenario};
use crate::simulate::{Chance, SimulatedVideo, World};
use nalgebra::{Point3, Vector3};
use std::collections::HashMap;

/// Of a shape those points count that are known best; so many of all. (Of the others some are seen for a moment or
/// at a grazing angle, and would make all the difference.)
pub const BEST_SHARE: f64 = 0.5;
/// A scale that is known to no better than this is not determined, nor is what goes with it: a first order says
/// nothing of what may be half as large.
const MOST_SCALE: f64 = 0.5;
/// A found frame is laid on the true one in so many steps.
const RESTORING_STEPS: usize = 12;
/// Distances of which the share of points is told \[m\].
pub const WITHIN_M: [f64; 3] = [0.01, 0.02, 0.05];

/// What is told of a cell beforehand.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Prediction {
    /// For each vehicle the standard deviation of each quantity, in the order of [`Quantity::ALL`]: root mean square
    /// over frames, or over points. Metres, metres per second, degrees; infinite where one is not determined.
    pub sigmas: Vec<[f64; 6]>,
    /// For each vehicle and quantity the main sources of its variance and their shares.
    pub factors: Vec<Vec<Vec<(String, f64)>>>,
    /// What an image shows of the ground \[m^2\].
    pub view_m2: f64,
    /// Image points of vehicles, targets, points at a time.
    pub counts: [usize; 3],
}

/// What a run is off by.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RunErrors {
    /// For each vehicle the mean square of each quantity.
    pub squares: Vec<[f64; 6]>,
    /// For each vehicle the share of its points within [`WITHIN_M`] of their true places, ...
    pub to_points: Vec<[f64; 3]>,
    /// ... and of the scan that they were sampled from, where there is one.
    pub to_scan: Vec<[f64; 3]>,
}

/// What runs of a cell have in common.
pub struct Prepared {
    world: World,
    exact: SimulatedVideo,
    frames: Vec<BodyFrame>,
    /// For each vehicle the points that count.
    best: Vec<Vec<usize>>,
    scans: Vec<Option<CloudIndex>>,
}

/// The video of a scenario as it really is, its prediction, and what its runs need.
pub fn predict(scenario: &Scenario) -> Result<(Prediction, Prepared), String> {
    let world = World::new(scenario.clone(), None).map_err(|findings| findings.to_string())?;
    let exact = world.video(Chance::Exact).map_err(|findings| findings.to_string())?;
    let problem = &exact.problem;
    for vehicle in &problem.vehicles {
        if vehicle.points.len() < 3 {
            return Err(format!("fewer than three points of {} are in view", vehicle.id));
        }
        if vehicle.marker.is_none() {
            return Err(format!("the marker of {} is not in view", vehicle.id));
        }
    }
    if let Some(gap) = camera_gap(problem) {
        // Standard deviations would be those of a world in which starting poses are right.
        return Err(gap.to_string());
    }
    let (network, truth) = expected(problem, &exact.truth, MotionPriors::ESTIMATED);
    let found = expectation(problem, &truth, &network).map_err(|error| error.to_string())?;
    let mut prediction = Prediction {
        view_m2: world.view_m2(&exact),
        counts: [
            problem.vehicles.iter().map(|vehicle| vehicle.observations.len()).sum(),
            problem.targets.len(),
            scenario.vehicles.iter().map(|vehicle| vehicle.points).sum(),
        ],
        ..Prediction::default()
    };
    let mut best = Vec::new();
    for at in 0..problem.vehicles.len() {
        let tracks = || found.precision.tracks[at].iter().flatten();
        let square = |sigma: f64| sigma * sigma;
        let of_points =
            |point: &Option<[f64; 3]>| point.map_or(f64::INFINITY, |s| s.map(square).iter().sum());
        let variances: Vec<f64> = found.precision.points[at].iter().map(of_points).collect();
        let mut order: Vec<usize> = (0..variances.len()).collect();
        order.sort_by(|a, b| variances[*a].total_cmp(&variances[*b]));
        order.truncate(((BEST_SHARE * order.len() as f64).ceil() as usize).max(1));
        order.sort_unstable();
        let mut sigmas = [
            root_mean(tracks().map(|t| square(t.position_m[0]) + square(t.position_m[1]))),
            root_mean(tracks().map(|t| square(t.position_m[2]))),
            root_mean(tracks().map(|t| t.speed_mps.map_or(f64::INFINITY, square))),
            root_mean(tracks().map(|t| square(t.heading_rad.to_degrees()))),
            root_mean(order.iter().map(|point| variances[*point])),
            found.scales[at],
        ];
        if found.scales[at] > MOST_SCALE {
            let of_scale = Quantity::ALL.into_iter().filter(|quantity| *quantity != Quantity::Heading);
            of_scale.for_each(|quantity| sigmas[quantity as usize] = f64::INFINITY);
        }
        prediction.sigmas.push(sigmas);
        best.push(order);
        let of = |quantity: Quantity| -> Vec<(String, f64)> {
            let is_it = |i: &&Influence| i.vehicle == at && i.quantity == quantity;
            let shares = found.influences.iter().find(is_it).map(|i| i.shares.as_slice()).unwrap_or_default();
            shares.iter().map(|(source, share)| (source_key(*source).to_owned(), *share)).collect()
        };
        prediction.factors.push(Quantity::ALL.map(of).to_vec());
    }
    let scans = scenario.vehicles.iter().enumerate().map(|(at, vehicle)| match vehicle.body {
        BodySettings::Scan(_) => CloudIndex::new(world.scan(at).to_vec()).ok(),
        BodySettings::Car { .. } => None,
    });
    let scans = scans.collect();
    let frames = network.frames;
    Ok((prediction, Prepared { world, exact, frames, best, scans }))
}

/// Root of the mean; infinite where nothing is known.
fn root_mean(squares: impl Iterator<Item = f64>) -> f64 {
    let (mut sum, mut count) = (0.0, 0_usize);
    squares.for_each(|square| {
        sum += square;
        count += 1;
    });
    if count == 0 { f64::INFINITY } else { (sum / count as f64).sqrt() }
}

impl Prepared {
    /// A run: simulated, given to the adjustment as a user would, and held against the truth. The error says why
    /// there is no result.
    pub fn run(&self, number: u64) -> Result<RunErrors, String> {
        let video = self.world.video(Chance::Run(number)).map_err(|findings| findings.to_string())?;
        let options = Options::default();
        let started = start(&video.problem, options.method).map_err(|error| error.to_string())?;
        let adjusted = started.refine(&options.refine, None).map_err(|error| error.to_string())?;
        let mut errors = RunErrors::default();
        for vehicle in 0..video.problem.vehicles.len() {
            if let Some(why) = &adjusted.estimate.vehicles[vehicle].left_out {
                return Err(why.to_string());
            }
            self.add_errors(vehicle, &video, &adjusted.estimate, &mut errors)
                .ok_or("too little of a vehicle was found to compare")?;
        }
        Ok(errors)
    }

    fn add_errors(
        &self,
        at: usize,
        video: &SimulatedVideo,
        estimate: &Estimate,
        errors: &mut RunErrors,
    ) -> Option<()> {
        let (problem, vehicle) = (&self.exact.problem, &self.exact.problem.vehicles[at]);
        let true_points = &self.exact.truth.vehicles[at].points;
        let true_poses = &video.truth.vehicles[at].poses;
        // Points that chance hides, or that it alone shows, aside: those of the exact video, in its order.
        let mut found = in_order_of(problem, at, &video.problem, &estimate.vehicles[at]);
        // A track that is of two points has no true place.
        for (place, point) in found.points.iter_mut().zip(&vehicle.points) {
            if video.wrong_tracks[at].contains_key(&point.id) {
                *place = None;
            }
        }
        let truth =
            VehicleEstimate { points: true_points.clone(), poses: true_poses.clone(), ..found.clone() };
        let frame = &self.frames[at];
        // Where points are missing, or the frame is far off, each step goes a part of the way.
        (0..RESTORING_STEPS).for_each(|_| frame.restore(&truth, &mut found));

        let marker = true_points[vehicle.marker?]?;
        let (mut plan, mut height, mut speed, mut heading) = (vec![], vec![], vec![], vec![]);
        for place in found.track(problem, vehicle) {
            let pose = true_poses[place.frame]?;
            let off = place.position - pose * marker;
            plan.push(off.xy().norm_squared());
            height.push(off.z * off.z);
            let turn = place.heading_rad - crate::geometry::heading_rad(&pose);
            heading.push(turn.sin().atan2(turn.cos()).to_degrees().powi(2));
            if let Some(mps) = place.speed_mps {
                speed.push((mps - video.velocities[at][place.frame].xy().norm()).powi(2));
            }
        }
        let off = |point: usize| Some(found.points[point]? - true_points[point]?);
        let shape: Vec<f64> = self.best[at].iter().filter_map(|p| Some(off(*p)?.norm_squared())).collect();
        if plan.is_empty() || speed.is_empty() || shape.len() < 3 {
            return None;
        }
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
        let scale = scale_error(frame, &found.points, true_points);
        errors.squares.push([
            mean(&plan),
            mean(&height),
            mean(&speed),
            mean(&heading),
            mean(&shape),
            scale * scale,
        ]);
        let distances: Vec<f64> =
            (0..true_points.len()).filter_map(|point| Some(off(point)?.norm())).collect();
        errors.to_points.push(shares(&distances));
        errors.to_scan.push(match &self.scans[at] {
            None => [f64::NAN; 3],
            Some(scan) => {
                let distance =
                    |p: &Option<Point3<f64>>| p.map_or(f64::INFINITY, |p| scan.nearest(&p).distance_m);
                shares(&found.points.iter().map(distance).collect::<Vec<_>>())
            }
        });
        Some(())
    }
}

fn shares(distances: &[f64]) -> [f64; 3] {
    WITHIN_M.map(|limit| distances.iter().filter(|d| **d <= limit).count() as f64 / distances.len() as f64)
}

/// The estimate of a vehicle of another problem with the points of this one, in their order.
fn in_order_of(problem: &Problem, at: usize, other: &Problem, found: &VehicleEstimate) -> VehicleEstimate {
    let ids = other.vehicles[at].points.iter().map(|point| point.id.as_str());
    let places: HashMap<&str, usize> = ids.zip(0..).collect();
    let own = problem.vehicles[at].points.iter().map(|point| places.get(point.id.as_str()));
    VehicleEstimate {
        points: own.map(|place| place.and_then(|place| found.points[*place])).collect(),
        depths: Vec::new(),
        ..found.clone()
    }
}

/// By how much a shape is too large, relative, each point by its weight.
fn scale_error(frame: &BodyFrame, found: &[Option<Point3<f64>>], truth: &[Option<Point3<f64>>]) -> f64 {
    let points = frame.points.iter().zip(&frame.weights);
    let known = points.filter_map(|((at, place), weight)| Some((*place, found[*at]? - truth[*at]?, *weight)));
    too_large(&known.collect::<Vec<_>>())
}

/// By how much a shape is too large, relative: of the similarity that lays it on the true one, to first order. `known` has
/// the place of each point, how far it is off, and its weight.
pub fn too_large(known: &[(Point3<f64>, Vector3<f64>, f64)]) -> f64 {
    let all: f64 = known.iter().map(|(_, _, weight)| weight).sum();
    let middle: Vector3<f64> = known.iter().map(|(place, _, weight)| place.coords * (weight / all)).sum();
    let from_middle = |place: &Point3<f64>| place.coords - middle;
    let size: f64 = known.iter().map(|(place, _, weight)| weight * from_middle(place).norm_squared()).sum();
    known.iter().map(|(place, off, weight)| weight * from_middle(place).dot(off)).sum::<f64>() / size
}
