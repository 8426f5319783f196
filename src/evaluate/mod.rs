//! A result held against what it was never adjusted to.
//!
//! Tracks are compared with GNSS positions: clocks ([`crate::clock`]), association in time ([`pairs`], [`crate::clock::curve`]),
//! and what is left ([`track`], [`statistics`]). A difference is result minus reference, as they stand
//! unless an alignment is asked for ([`alignment`]). `docs/evaluate.md` has the formulas.

pub mod alignment;
pub mod pairs;
pub mod shape;
pub mod statistics;
pub mod track;

use crate::clock::curve::Curve;
use crate::clock::{ClockEstimate, ClockOffset, Shift, clock_offset};
use crate::files::{ResultPoint, TrackPosition};
use crate::reference::{GnssPosition, Reference, TrueShape};
use crate::rules::Rules;
use crate::stats::quantile::median;
use alignment::Alignment;
use nalgebra::Point3;
use pairs::Association;
use shape::{Registering, ShapeComparison, compare_shape};
use std::collections::HashSet;
use track::{Comparison, TrackComparison, compare};

/// The constants of the comparison.
pub fn constants() -> Vec<Rules> {
    vec![alignment::AlignmentRules::PAGE]
}

/// Which offset of the receiver's clock is applied: `t_reference = t_video + offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Clock {
    /// This \[s\].
    Given(f64),
    /// That which is estimated from the tracks; without one, a vehicle is not compared.
    Estimated,
}

/// How tracks are compared.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EvaluateOptions {
    /// The offset that is applied.
    pub clock: Clock,
    /// What else than the offset is free where it is estimated.
    pub shift: Shift,
    /// What is compared with what.
    pub association: Association,
    /// What may be changed of the result before it is compared.
    pub alignment: Alignment,
    /// How a shape comes onto its scan.
    pub registering: Registering,
    /// Distances are also told of points with a standard deviation of at most this alone \[m\].
    pub sigma_limit_m: f64,
}

impl Default for EvaluateOptions {
    fn default() -> Self {
        EvaluateOptions {
            clock: Clock::Given(0.0),
            shift: Shift::Free,
            association: Association::Interpolated,
            alignment: Alignment::None,
            registering: Registering::Icp,
            sigma_limit_m: 0.1,
        }
    }
}

/// The comparison of a vehicle.
#[derive(Clone, Debug, PartialEq)]
pub struct VehicleEvaluation {
    /// Its id.
    pub vehicle: String,
    /// What the tracks say of the clocks, whether it was applied or not.
    pub clock: ClockOffset,
    /// Its track, against GNSS.
    pub track: TrackComparison,
}

impl VehicleEvaluation {
    /// What is lost for the clocks: how far the estimated offset lies from the applied one \[s\], and how far
    /// the vehicle moves in this time \[m\]. `None` where it does not matter: within three standard
    /// deviations, or less than tracks scatter anyway.
    pub fn clock_matters(&self) -> Option<[f64; 2]> {
        let ClockOffset::Estimated(found) = &self.clock else { return None };
        let off_s = found.offset_s - self.track.clock_offset_s;
        let moved_m = off_s.abs() * self.track.median_speed_mps?;
        (off_s.abs() > 3.0 * found.sigma_s && moved_m > found.scale_m).then_some([off_s, moved_m])
    }
}

/// The comparison of a result.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Evaluation {
    /// What might be changed of a result before.
    pub alignment: Alignment,
    /// Of the vehicles that have two tracks.
    pub vehicles: Vec<VehicleEvaluation>,
    /// The others, and why they were not compared.
    pub not_compared: Vec<(String, String)>,
    /// Of the vehicles that have a shape and a scan.
    pub shapes: Vec<ShapeComparison>,
    /// The others, and why.
    pub shapes_not_compared: Vec<(String, String)>,
}

/// Compares the tracks of a result with those of the reference, for each of the problem's `vehicles`. A
/// reference that has a position which was `used` as an observation of the same vehicle is no check, and refused.
pub fn evaluate(
    vehicles: &[String],
    result: &[(String, Vec<TrackPosition>)],
    reference: &Reference,
    used: &[(String, Point3<f64>)],
    options: &EvaluateOptions,
) -> Evaluation {
    let mut evaluation = Evaluation { alignment: options.alignment, ..Evaluation::default() };
    for vehicle in vehicles {
        let track = result.iter().find(|(id, _)| id == vehicle).map(|(_, track)| track.as_slice());
        let positions =
            reference.tracks.iter().find(|(id, _)| id == vehicle).map(|(_, track)| track.as_slice());
        let compared = match (track, positions) {
            (None, None) => Err("neither the result nor reference/ has its track".to_owned()),
            (None, Some(_)) => Err("the result has no track of it".to_owned()),
            (Some(_), None) => Err("reference/ has no position of it".to_owned()),
            (Some(_), Some(positions)) if is_used(vehicle, positions, used) => Err("positions of its reference are observations (observations/gnss.csv): what was adjusted to is no check".to_owned()),
            (Some(track), Some(positions)) => evaluate_vehicle(vehicle, track, positions, options),
        };
        match compared {
            Ok(compared) => evaluation.vehicles.push(compared),
            Err(why) => evaluation.not_compared.push((vehicle.clone(), why)),
        }
    }
    evaluation
}

/// Those that were compared, and the other vehicles with the reason.
pub type Compared<T> = (Vec<T>, Vec<(String, String)>);

/// Compares the shapes of a result with scans, for each of the problem's `vehicles`.
pub fn evaluate_shapes(
    vehicles: &[String],
    shapes: &[(String, Vec<ResultPoint>)],
    reference: &Reference,
    truths: &[(String, TrueShape)],
    options: &EvaluateOptions,
) -> Compared<ShapeComparison> {
    let (mut compared, mut others) = (Vec::new(), Vec::new());
    for vehicle in vehicles {
        let points = shapes.iter().find(|(id, _)| id == vehicle).map_or(&[][..], |(_, points)| points);
        let truth = truths.iter().find(|(id, _)| id == vehicle).map(|(_, truth)| truth);
        match compare_shape(vehicle, points, reference, truth, options) {
            Ok(found) => compared.push(found),
            Err(why) => others.push((vehicle.clone(), why)),
        }
    }
    (compared, others)
}

/// Whether positions were observations of the vehicle: any to a tenth of a millimetre, or more than half of them
/// to a millimetre, as after a way through another format.
fn is_used(vehicle: &str, positions: &[GnssPosition], used: &[(String, Point3<f64>)]) -> bool {
    let cell = |p: &Point3<f64>, side_m: f64| [p.x, p.y, p.z].map(|v| (v / side_m).round() as i64);
    let own: Vec<&Point3<f64>> = used.iter().filter(|(id, _)| id == vehicle).map(|(_, p)| p).collect();
    let fine: HashSet<[i64; 3]> = own.iter().map(|p| cell(p, 1e-4)).collect();
    let coarse: HashSet<[i64; 3]> = own.iter().map(|p| cell(p, 1e-3)).collect();
    let is_near = |p: &Point3<f64>| {
        let [x, y, z] = cell(p, 1e-3);
        let beside = |i: i64| [i / 9 % 3 - 1, i / 3 % 3 - 1, i % 3 - 1];
        (0..27).map(beside).any(|[i, j, k]| {
            coarse.contains(&[x.saturating_add(i), y.saturating_add(j), z.saturating_add(k)])
        })
    };
    positions.iter().any(|p| fine.contains(&cell(&p.position, 1e-4)))
        || 2 * positions.iter().filter(|p| is_near(&p.position)).count() > positions.len()
}

/// What a track's own error does to the offset, were it a drift over all of the film as large as its standard
/// deviations: it is not among what is left, and comes beside it.
fn with_drift(clock: ClockOffset, track: &[TrackPosition]) -> ClockOffset {
    let ClockOffset::Estimated(found) = clock else { return clock };
    let sigma = |axis: usize| median(track.iter().filter_map(|at| at.sigma_m[axis]).collect()).unwrap_or(0.0);
    let drift_s = (found.by_drift_s[0] * sigma(0)).hypot(found.by_drift_s[1] * sigma(1));
    ClockOffset::Estimated(ClockEstimate { sigma_s: found.sigma_s.hypot(drift_s), ..found })
}

fn evaluate_vehicle(
    vehicle: &str,
    track: &[TrackPosition],
    reference: &[GnssPosition],
    options: &EvaluateOptions,
) -> Result<VehicleEvaluation, String> {
    let curve = Curve::new(track.iter().map(|at| (at.time_s, at.position, None)));
    let reference_curve = Curve::new(reference.iter().map(|at| (at.time_s, at.position, at.velocity_mps)));
    let clock = with_drift(clock_offset(&curve, &reference_curve, options.shift), track);
    let offset_s = match (options.clock, &clock) {
        (Clock::Given(offset_s), _) => offset_s,
        (Clock::Estimated, ClockOffset::Estimated(found)) => found.offset_s,
        (Clock::Estimated, ClockOffset::NotObservable { why }) => {
            return Err(format!("the offset of its clock cannot be estimated: {why}"));
        }
    };
    let EvaluateOptions { association, alignment, .. } = *options;
    let comparison = Comparison { offset_s, association, alignment };
    let track = compare(track, &curve, reference, &reference_curve, &comparison)?;
    Ok(VehicleEvaluation { vehicle: vehicle.to_owned(), clock, track })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_observed_is_known_again_after_a_way_through_another_format() {
        let place = |i: usize| Point3::new(100.0 + 0.31 * i as f64, 7.0005, -3.2);
        let used: Vec<_> = (0..10).map(|i| ("a".to_owned(), place(i))).collect();
        let moved = |shift_m: f64, of: fn(usize) -> bool| -> Vec<GnssPosition> {
            let shift = |i| nalgebra::Vector3::new(0.0, if of(i) { shift_m } else { 1.0 }, 0.0);
            let at = |i| GnssPosition { position: place(i) + shift(i), ..GnssPosition::default() };
            (0..10).map(at).collect()
        };
        assert!(is_used("a", &moved(0.0, |i| i == 3), &used));
        assert!(is_used("a", &moved(7e-4, |i| i < 6), &used));
        assert!(!is_used("a", &moved(7e-4, |i| i < 5), &used));
        assert!(!is_used("a", &moved(3e-3, |_| true), &used));
        assert!(!is_used("b", &moved(0.0, |_| true), &used));
    }
}
