//! A video judged as a user would judge it: the result against its truth, in standard deviations of its own.

use crate::diagnose::{Diagnosis, Trust, VerdictReason};
use crate::estimate::Estimate;
use crate::geometry::align::rigid_fit_trimmed;
use crate::geometry::{Pose, heading_rad, rotation::exp, skew};
use crate::pipeline::{Judged, Options, start};
use crate::refine::{BodyFrame, is_in_the_middle};
use crate::simulate::scenario::Scenario;
use crate::simulate::{Chance, SimulatedVideo, World};
use crate::study::cell::too_large;
use crate::words::Coded;
use nalgebra::{Matrix3x6, Matrix6, Point3, Vector6};
use std::collections::BTreeMap;
use std::f64::consts::{PI, TAU};

/// What is compared, and its unit.
pub const COMPARED: [(&str, &str); 9] = [
    ("x", "m"),
    ("y", "m"),
    ("z", "m"),
    ("speed", "m/s"),
    ("heading", "deg"),
    ("scale", "1"),
    ("camera_x", "m"),
    ("camera_y", "m"),
    ("camera_z", "m"),
];
const SPEED: usize = 3;
const HEADING: usize = 4;
const SCALE: usize = 5;
const CAMERA: usize = 6;

/// A shape is laid on its truth by so many of its points, those that fit best.
const FITTED_SHARE: f64 = 0.8;
/// ... and then in so many steps of least squares.
const LAYING_STEPS: usize = 10;

/// How one quantity differs from its truth over a video; all of it NaN where its standard deviation is not finite.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Difference {
    /// Mean of found minus true, in the unit of [`COMPARED`].
    pub mean: f64,
    /// Root mean square of its standard deviation.
    pub sigma: f64,
    /// Mean of found minus true over its standard deviation.
    pub mean_ratio: f64,
    /// Root mean square of that.
    pub rms_ratio: f64,
}

impl Difference {
    /// What is not compared.
    pub const NONE: Difference =
        Difference { mean: f64::NAN, sigma: f64::NAN, mean_ratio: f64::NAN, rms_ratio: f64::NAN };

    /// Of pairs of a difference and its standard deviation; those that are not determined say nothing.
    fn of(pairs: impl Iterator<Item = (f64, f64)>) -> Difference {
        let (mut count, mut sums) = (0.0, [0.0; 4]);
        for (off, sigma) in pairs.filter(|(_, sigma)| sigma.is_finite() && *sigma > 0.0) {
            let ratio = off / sigma;
            for (sum, value) in sums.iter_mut().zip([off, sigma * sigma, ratio, ratio * ratio]) {
                *sum += value;
            }
            count += 1.0;
        }
        if count == 0.0 {
            return Difference::NONE;
        }
        let [mean, sigma2, mean_ratio, ratio2] = sums.map(|sum| sum / count);
        Difference { mean, sigma: sigma2.sqrt(), mean_ratio, rms_ratio: ratio2.sqrt() }
    }
}

/// A vehicle of a video.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JudgedVehicle {
    /// In the order of [`COMPARED`].
    pub differences: [Difference; COMPARED.len()],
    /// Root mean square distance of its points from their true places, once it is laid on its truth; over the half
    /// of them with the smallest standard deviations \[m\].
    pub shape_m: f64,
    /// Tracks that are of something else, those of them that are not used; tracks of its body, those that are used.
    pub tracks: [usize; 4],
}

/// A video.
#[derive(Clone, Debug, PartialEq)]
pub struct JudgedVideo {
    /// The verdict.
    pub trust: String,
    /// The codes of its reasons.
    pub reasons: Vec<String>,
    /// Why the adjustment ended.
    pub stop: String,
    /// Of all rounds together.
    pub iterations: usize,
    /// The vehicles that were adjusted, with their index.
    pub vehicles: Vec<(usize, JudgedVehicle)>,
}

impl JudgedVideo {
    /// Whether the verdict says that it is as right as it says.
    pub fn is_relied_on(&self) -> bool {
        self.trust == Trust::Yes.name()
    }
}

/// Simulates a video, gives it to the adjustment as a user would, and holds the result against the truth. The error
/// says why there is no result.
pub fn judge(scenario: &Scenario, seed: u64, options: &Options) -> Result<JudgedVideo, String> {
    let world = World::new(scenario.clone(), Some(seed)).map_err(|findings| findings.to_string())?;
    let video = world.video(Chance::Run(0)).map_err(|findings| findings.to_string())?;
    let started = start(&video.problem, options.method).map_err(|error| error.to_string())?;
    let judged = started.adjust(options, None).map_err(|error| error.to_string())?;
    let diagnosis = judged.diagnosis.as_ref().map_err(|error| error.to_string())?;
    let verdict = &judged.verdict;
    let network = judged.adjusted.network.as_ref().ok_or("there is no final least squares")?;
    let estimate = &judged.adjusted.estimate;
    let camera = cameras(&video, estimate, diagnosis);
    let vehicles = (0..video.problem.vehicles.len())
        .filter(|at| estimate.vehicles[*at].left_out.is_none())
        .filter_map(|at| {
            let mut vehicle = compare(&video, at, &judged, diagnosis, &network.frames[at])?;
            vehicle.differences[CAMERA..].copy_from_slice(&camera);
            Some((at, vehicle))
        });
    let adjustment = &judged.adjusted.adjustment;
    Ok(JudgedVideo {
        trust: verdict.trust.name().to_owned(),
        reasons: verdict.findings.iter().map(|reason| reason.coded().code.to_owned()).collect(),
        stop: adjustment.stop.status().to_owned(),
        iterations: adjustment.rounds.iter().map(|round| round.records.len().saturating_sub(1)).sum(),
        vehicles: vehicles.collect(),
    })
}

/// Positions of the camera.
fn cameras(video: &SimulatedVideo, estimate: &Estimate, diagnosis: &Diagnosis) -> [Difference; 3] {
    std::array::from_fn(|axis| {
        let poses = estimate.camera_poses.iter().zip(&video.truth.camera_poses);
        let off = poses.map(|(found, truth)| found.translation.vector[axis] - truth.translation.vector[axis]);
        let sigmas = diagnosis.precision.cameras.iter();
        let sigmas = sigmas.map(|sigma| sigma.map_or(f64::INFINITY, |s| s.position_m[axis]));
        Difference::of(off.zip(sigmas))
    })
}

fn compare(
    video: &SimulatedVideo,
    at: usize,
    judged: &Judged,
    diagnosis: &Diagnosis,
    frame: &BodyFrame,
) -> Option<JudgedVehicle> {
    let (problem, vehicle) = (&video.problem, &video.problem.vehicles[at]);
    let (found, truth) = (&judged.adjusted.estimate.vehicles[at], &video.truth.vehicles[at]);
    let wrong = &video.wrong_tracks[at];
    let is_own: Vec<bool> = vehicle.points.iter().map(|point| !wrong.contains_key(&point.id)).collect();
    // Points that have a place in both, of the body.
    let both: Vec<Pair> = (0..vehicle.points.len())
        .filter(|point| is_own[*point])
        .filter_map(|point| Some((point, found.points[point]?, truth.points[point]?)))
        .collect();

    // The point whose track is told.
    let true_mark = match vehicle.marker.and_then(|marker| truth.points[marker]) {
        Some(marker) => marker,
        None if !is_in_the_middle(vehicle) => Point3::origin(),
        None => {
            let mut body = truth.clone();
            for (point, place) in body.points.iter_mut().enumerate() {
                *place = place.filter(|_| is_own[point] && found.points[point].is_some());
            }
            Point3::from(body.middle()?.coords.xy().push(0.0))
        }
    };
    let says_so = |finding: &VerdictReason| matches!(finding, VerdictReason::HeadingTurned { vehicle: id, .. } if *id == vehicle.id);
    let may_be_turned = judged.verdict.findings.iter().any(says_so);
    let mut pairs: [Vec<(f64, f64)>; SCALE] = Default::default();
    for (order, place) in found.track(problem, vehicle).into_iter().enumerate() {
        let pose: Pose = truth.poses[place.frame]?;
        let off = place.position - pose * true_mark;
        let sigma = diagnosis.precision.tracks[at].get(order).and_then(Option::as_ref);
        let Some(sigma) = sigma else { continue };
        for axis in 0..3 {
            pairs[axis].push((off[axis], sigma.position_m[axis]));
        }
        if let (Some(speed), Some(sigma)) = (place.speed_mps, sigma.speed_mps) {
            pairs[SPEED].push((speed - video.velocities[at][place.frame].xy().norm(), sigma));
        }
        // Of one that is said to look the other way, perhaps, the axis counts.
        let period = if may_be_turned { PI } else { TAU };
        let turn = (place.heading_rad - heading_rad(&pose) + period / 2.0).rem_euclid(period) - period / 2.0;
        pairs[HEADING].push((turn.to_degrees(), sigma.heading_rad.to_degrees()));
    }
    let mut differences = [Difference::NONE; COMPARED.len()];
    for (difference, pairs) in differences.iter_mut().zip(pairs) {
        *difference = Difference::of(pairs.into_iter());
    }

    let weights = weights(frame);
    let laid = laid_on_truth(&both, &weights)?;
    if let (Some(scale), Some(off)) =
        (diagnosis.scales.iter().find(|scale| scale.vehicle == at), scale_error(&laid, &weights))
    {
        differences[SCALE] = Difference::of(std::iter::once((off, scale.sigma)));
    }
    let mut shape: Vec<(f64, f64)> = laid
        .iter()
        .map(|(point, place, truth)| {
            let sigmas = diagnosis.precision.points[at][*point].unwrap_or([f64::INFINITY; 3]);
            let variance = sigmas.iter().map(|sigma| sigma * sigma).sum();
            (variance, (place - truth).norm_squared())
        })
        .collect();
    shape.sort_by(|a, b| a.0.total_cmp(&b.0));
    shape.truncate(shape.len().div_ceil(2));
    let shape_m = (shape.iter().map(|(_, square)| square).sum::<f64>() / shape.len() as f64).sqrt();

    let mut is_used = vec![false; vehicle.points.len()];
    for (observation, fit) in vehicle.observations.iter().zip(&judged.adjusted.adjustment.fits.vehicles[at]) {
        is_used[observation.point] |= fit.is_some_and(|fit| fit.is_accepted());
    }
    // Of the tracks that were seen at all.
    let mut is_seen = vec![false; vehicle.points.len()];
    vehicle.observations.iter().for_each(|observation| is_seen[observation.point] = true);
    let mut tracks = [0; 4];
    for point in (0..vehicle.points.len()).filter(|point| is_seen[*point]) {
        let (group, is_right) = if is_own[point] { (2, is_used[point]) } else { (0, !is_used[point]) };
        tracks[group] += 1;
        tracks[group + 1] += usize::from(is_right);
    }
    Some(JudgedVehicle { differences, shape_m, tracks })
}

/// A point with its found and its true place in the vehicle frame \[m\].
type Pair = (usize, Point3<f64>, Point3<f64>);

/// What each point weighs in the stated standard deviation of the scale.
fn weights(frame: &BodyFrame) -> BTreeMap<usize, f64> {
    frame.points.iter().map(|(point, _)| *point).zip(frame.weights.iter().copied()).collect()
}

/// The points in the frame of the truth: first by those that fit best, however far the frame is off, then by all of
/// them with their weights. (Some have no depth, perhaps.)
fn laid_on_truth(both: &[Pair], weights: &BTreeMap<usize, f64>) -> Option<Vec<Pair>> {
    let (places, true_places): (Vec<_>, Vec<_>) = both.iter().map(|(_, a, b)| (*a, *b)).unzip();
    let mut true_from_found = rigid_fit_trimmed(&places, &true_places, FITTED_SHARE)?;
    for _ in 0..LAYING_STEPS {
        let (mut normal, mut right) = (Matrix6::zeros(), Vector6::zeros());
        for (point, place, truth) in both {
            let Some(weight) = weights.get(point) else { continue };
            let laid = true_from_found * place;
            let mut moves = Matrix3x6::identity();
            moves.fixed_columns_mut::<3>(3).copy_from(&-skew(&laid.coords));
            normal += *weight * moves.transpose() * moves;
            right += *weight * moves.transpose() * (truth - laid);
        }
        let step: Vector6<f64> = normal.cholesky()?.solve(&right);
        let (shift, turn) = (step.fixed_rows::<3>(0).into_owned(), step.fixed_rows::<3>(3).into_owned());
        true_from_found = Pose::from_parts(shift.into(), exp(&turn)) * true_from_found;
    }
    Some(both.iter().map(|(point, place, truth)| (*point, true_from_found * place, *truth)).collect())
}

/// By how much a shape is too large, relative, each point by the weight that it has in the stated standard deviation.
fn scale_error(laid: &[Pair], weights: &BTreeMap<usize, f64>) -> Option<f64> {
    let known = laid.iter();
    let known = known.filter_map(|(point, place, truth)| Some((*truth, place - truth, *weights.get(point)?)));
    Some(too_large(&known.collect::<Vec<_>>())).filter(|off| off.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_difference_counts_what_is_determined() {
        let pairs = [(0.2, 0.1), (-0.1, 0.1), (5.0, f64::INFINITY)];
        let found = Difference::of(pairs.into_iter());
        assert!((found.mean - 0.05).abs() < 1e-12 && (found.sigma - 0.1).abs() < 1e-12);
        assert!((found.mean_ratio - 0.5).abs() < 1e-12 && (found.rms_ratio - 2.5_f64.sqrt()).abs() < 1e-12);
        assert!(Difference::of([(1.0, f64::INFINITY)].into_iter()).mean.is_nan());
    }
}
