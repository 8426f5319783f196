//! The offset between the clock of a receiver and that of a film: `t_reference = t_video + offset`.
//!
//! The offset is sought at which result minus reference, after a constant shift in the plan, is least. The
//! cost has many minima, so a scan over a grid comes first; its measure, the median distance from the median
//! shift, grows with the distance from the right offset without a limit. The lowest minima of the scan are
//! refined, and where one fits hardly worse than the best there is no answer. The best is then refined by a
//! sum of Tukey's rho, at the scale of what is left there, with Brent's method.
//!
//! A free shift takes with it what a constant velocity says of the offset: only its changes count.

pub mod curve;
mod precision;
#[cfg(test)]
mod tests;

use crate::stats::quantile::median;
use argmin::core::{CostFunction, Error, Executor};
use argmin::solver::brent::BrentOpt;
use curve::Curve;
use nalgebra::Vector2;
use precision::{OffsetPrecision, precision};
use trackbundle_solver::loss::{Loss, LossName, robust_spread};

/// Offsets are sought up to this, on either side \[s\].
pub const FARTHEST_S: f64 = 10.0;
/// Step of the scan \[s\]: a vehicle changes its velocity little in this time.
const GRID_STEP_S: f64 = 0.05;
/// Fewer samples say nothing.
const LEAST_SAMPLES: usize = 10;
/// Nor does less time in common \[s\].
const LEAST_OVERLAP_S: f64 = 2.0;
/// Of the greatest overlap of all offsets, this share must be left.
const LEAST_SHARE: f64 = 0.5;
/// An offset that is known worse than this is not known \[s\].
pub const LARGEST_SIGMA_S: f64 = 0.05;
/// A second minimum is clearly worse where its residuals are larger by this factor.
pub const CLEARLY_WORSE: f64 = 1.25;
/// Residuals are not told apart below this \[m\].
const LEAST_SCALE_M: f64 = 1e-3;
/// So many minima of the scan are refined.
const CANDIDATES: usize = 8;
/// The scan makes do with this many places.
const SCANNED: usize = 600;
/// To this an offset is sought \[s\].
const TOLERANCE_S: f64 = 1e-6;

/// What else than the offset is free.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shift {
    /// A constant shift in the plan: the frames of result and reference may differ.
    Free,
    /// Nothing: both are in the same frame. A constant velocity then shows the offset, and an error of the
    /// frame along it goes into it.
    None,
}

/// An offset that was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockEstimate {
    /// `t_reference - t_video` \[s\].
    pub offset_s: f64,
    /// Its standard deviation, with the correlation in time of what is left \[s\].
    pub sigma_s: f64,
    /// Result minus reference, in x and y, that was constant \[m\].
    pub shift_m: [f64; 2],
    /// Places that were compared: frames, and the middles between them.
    pub samples: usize,
    /// Of these, what did not count at all.
    pub rejected: usize,
    /// How many independent ones they are worth.
    pub independent: f64,
    /// How far a drift of the track in x, in y, of 1 m root mean square over the film moves the offset
    /// \[s/m\]: it is not among what is left.
    pub by_drift_s: [f64; 2],
    /// Robust standard deviation of what is left, per axis \[m\].
    pub scale_m: f64,
    /// Root mean square distance of what is left and counted \[m\].
    pub rms_m: f64,
}

/// What tracks say of the clocks.
#[derive(Clone, Debug, PartialEq)]
pub enum ClockOffset {
    /// This.
    Estimated(ClockEstimate),
    /// Nothing.
    NotObservable {
        /// The reason.
        why: String,
    },
}

/// Estimates the offset of the reference's clock.
pub fn clock_offset(track: &Curve, reference: &Curve, shift: Shift) -> ClockOffset {
    match search(track, reference, shift) {
        Ok(found) => ClockOffset::Estimated(found),
        Err(why) => ClockOffset::NotObservable { why },
    }
}

/// Where the track is at a time \[s, m\].
type Sample = (f64, Vector2<f64>);

/// The frames of a track and the middles between them. Between samples of the reference its noise averages
/// out in part; with frames in step with them, the cost would have a minimum at half a step by that alone.
fn samples(track: &Curve) -> Vec<Sample> {
    let mut times = track.times_s().to_vec();
    times.extend(track.times_s().windows(2).map(|pair| 0.5 * (pair[0] + pair[1])));
    times.sort_by(f64::total_cmp);
    times.into_iter().filter_map(|time_s| Some((time_s, track.at(time_s)?.coords.xy()))).collect()
}

/// A minimum of the scan.
#[derive(Clone, Copy, Debug)]
struct Candidate {
    offset_s: f64,
    spread_m: f64,
    /// Whether the scan ends beside it.
    is_at_end: bool,
}

fn search(track: &Curve, reference: &Curve, shift: Shift) -> Result<ClockEstimate, String> {
    let samples = samples(track);
    let comparison = Comparison { reference, shift };
    let thin = samples.len().div_ceil(SCANNED).max(1);
    let scanned: Vec<Sample> = samples.iter().copied().step_by(thin).collect();
    let candidates = candidates(&comparison, &scanned, 0.5 * track.step_s() * thin as f64)?;
    let best = *candidates.first().ok_or("the tracks have no numbers to compare")?;
    let (estimate, precision) = refine(&comparison, &samples, best.offset_s)?;
    let OffsetPrecision { change_mps, sigma_s, .. } = precision;
    let far_s = (3.0 * sigma_s).max(2.0 * GRID_STEP_S);
    // Where the sigma alone is no reason, another minimum may be one.
    let other = candidates.iter().find(|c| {
        (c.offset_s - estimate.offset_s).abs() > far_s
            && c.spread_m < CLEARLY_WORSE * best.spread_m.max(LEAST_SCALE_M)
    });
    if sigma_s > LARGEST_SIGMA_S {
        return Err(format!(
            "its standard deviation would be {sigma_s:.3} s, above {LARGEST_SIGMA_S} s: {} is {change_mps:.3} m/s \
             (rms), and the tracks differ by {:.3} m",
            shift.what_counts(),
            estimate.scale_m
        ));
    }
    if let Some(other) = other {
        return Err(format!(
            "{:.3} s and {:.3} s fit alike: residuals of {:.4} m and {:.4} m",
            best.offset_s, other.offset_s, best.spread_m, other.spread_m
        ));
    }
    if best.is_at_end {
        return Err(format!(
            "the best offset, {:.3} s, is the last one that was tried: the track leaves no room, or the offset \
             is beyond {FARTHEST_S} s",
            best.offset_s
        ));
    }
    Ok(estimate)
}

impl Shift {
    /// What shows the offset.
    fn what_counts(self) -> &'static str {
        match self {
            Shift::Free => "the change of velocity",
            Shift::None => "the velocity",
        }
    }

    /// Numbers that are estimated.
    fn unknowns(self) -> f64 {
        match self {
            Shift::Free => 3.0,
            Shift::None => 1.0,
        }
    }
}

/// The minima of the scan, the best first, refined.
fn candidates(comparison: &Comparison, samples: &[Sample], step_s: f64) -> Result<Vec<Candidate>, String> {
    let steps = (FARTHEST_S / GRID_STEP_S).round() as i32;
    let offsets: Vec<f64> = (-steps..=steps).map(|k| f64::from(k) * GRID_STEP_S).collect();
    let differences: Vec<Vec<Vector2<f64>>> =
        offsets.iter().map(|offset_s| comparison.differences(samples, *offset_s)).collect();
    let most = differences.iter().map(Vec::len).max().unwrap_or(0);
    let least = LEAST_SAMPLES.max((LEAST_OVERLAP_S / step_s.max(1e-9)).ceil() as usize);
    if most < least {
        return Err(format!(
            "the tracks have {:.2} s in common at most, {LEAST_OVERLAP_S} s and {LEAST_SAMPLES} places are needed",
            most as f64 * step_s
        ));
    }
    let least = least.max((LEAST_SHARE * most as f64).ceil() as usize);
    let spreads: Vec<Option<f64>> = differences
        .iter()
        .map(|differences| (differences.len() >= least).then(|| comparison.spread(differences)))
        .map(|spread| spread.filter(|spread| spread.is_finite()))
        .collect();
    let mut found: Vec<(usize, f64, bool)> = Vec::new();
    for (at, spread) in spreads.iter().enumerate() {
        let Some(spread) = *spread else { continue };
        let beside = [at.checked_sub(1), Some(at + 1)].map(|k| spreads.get(k?).copied().flatten());
        if beside.iter().flatten().all(|other| spread <= *other) {
            found.push((at, spread, beside.contains(&None)));
        }
    }
    found.sort_by(|a, b| a.1.total_cmp(&b.1));
    found.truncate(CANDIDATES);
    let refined = |(at, spread_m, is_at_end): (usize, f64, bool)| {
        let centre = offsets[at];
        let covered = comparison.covered(samples, centre, GRID_STEP_S);
        if is_at_end || covered.len() < LEAST_SAMPLES {
            return Candidate { offset_s: centre, spread_m, is_at_end };
        }
        let spread = |offset_s| comparison.spread(&comparison.differences(&covered, offset_s));
        let offset_s = minimum(centre, GRID_STEP_S, spread);
        Candidate { offset_s, spread_m: spread(offset_s), is_at_end }
    };
    let mut candidates: Vec<Candidate> = found.into_iter().map(refined).collect();
    candidates.sort_by(|a, b| a.spread_m.total_cmp(&b.spread_m));
    Ok(candidates)
}

/// Rounds of scale and offset in turn.
const ROUNDS: usize = 6;

fn refine(
    comparison: &Comparison,
    samples: &[Sample],
    start_s: f64,
) -> Result<(ClockEstimate, OffsetPrecision), String> {
    let mut offset_s = start_s;
    let mut half_s = GRID_STEP_S;
    let mut scale_m = comparison.spread(&comparison.differences(samples, offset_s)).max(LEAST_SCALE_M);
    for _ in 0..ROUNDS {
        // The same places everywhere in the bracket: else the cost would have steps.
        let covered = comparison.covered(samples, offset_s, half_s);
        let loss = loss(scale_m);
        offset_s = minimum(offset_s, half_s, |offset_s| {
            let differences = comparison.differences(&covered, offset_s);
            let centre = comparison.location(&differences, loss);
            differences.iter().map(|d| loss.rho((d - centre).norm_squared())[0]).sum()
        });
        let differences = comparison.differences(&covered, offset_s);
        let centre = comparison.location(&differences, loss);
        let scale = robust_spread(differences.iter().map(|d| (d - centre).norm_squared()).collect());
        let is_settled = (scale / scale_m - 1.0).abs() < 0.01;
        (scale_m, half_s) = (scale, 0.5 * half_s);
        if is_settled {
            break;
        }
    }
    let covered = comparison.covered(samples, offset_s, 0.0);
    let differences = comparison.differences(&covered, offset_s);
    let loss = loss(scale_m);
    let centre = comparison.location(&differences, loss);
    let residuals: Vec<Vector2<f64>> = differences.iter().map(|d| d - centre).collect();
    let precision = precision(&covered, &residuals, loss, comparison.reference, offset_s, comparison.shift)?;
    let counted: Vec<f64> =
        residuals.iter().map(Vector2::norm_squared).filter(|s| loss.weight(*s) > 0.0).collect();
    let estimate = ClockEstimate {
        offset_s,
        sigma_s: precision.sigma_s,
        shift_m: centre.into(),
        samples: residuals.len(),
        rejected: residuals.len() - counted.len(),
        independent: precision.independent,
        by_drift_s: precision.by_drift_s,
        scale_m,
        rms_m: (counted.iter().sum::<f64>() / counted.len().max(1) as f64).sqrt(),
    };
    Ok((estimate, precision))
}

/// Tukey's loss that keeps 95 % of the efficiency of least squares at this standard deviation \[m\].
fn loss(scale_m: f64) -> Loss {
    Loss::Tukey { scale: LossName::Tukey.default_scale() * scale_m }
}

struct Comparison<'c> {
    reference: &'c Curve,
    shift: Shift,
}

impl Comparison<'_> {
    /// The samples that fall into the reference at every offset within `half_s` of this one.
    fn covered(&self, samples: &[Sample], offset_s: f64, half_s: f64) -> Vec<Sample> {
        let is_covered =
            |time_s: f64| self.reference.covers(time_s + offset_s - half_s, time_s + offset_s + half_s);
        samples.iter().copied().filter(|(time_s, _)| is_covered(*time_s)).collect()
    }

    /// Result minus reference in the plan, where there are both \[m\].
    fn differences(&self, samples: &[Sample], offset_s: f64) -> Vec<Vector2<f64>> {
        let difference = |(time_s, at): &Sample| Some(at - self.reference.at(time_s + offset_s)?.coords.xy());
        samples.iter().filter_map(difference).collect()
    }

    /// Median of each axis.
    fn middle(&self, differences: &[Vector2<f64>]) -> Vector2<f64> {
        match self.shift {
            Shift::Free => Vector2::from_fn(|axis, _| {
                median(differences.iter().map(|d| d[axis]).collect()).unwrap_or(0.0)
            }),
            Shift::None => Vector2::zeros(),
        }
    }

    /// Standard deviation per axis by the median distance from the shift: that of two normal numbers is
    /// `sqrt(2 ln 2)`.
    fn spread(&self, differences: &[Vector2<f64>]) -> f64 {
        let middle = self.middle(differences);
        let distance = median(differences.iter().map(|d| (d - middle).norm()).collect());
        distance.unwrap_or(f64::INFINITY) / (2.0 * std::f64::consts::LN_2).sqrt()
    }

    /// The shift by the loss: a weighted mean of its own weights, from the median on.
    fn location(&self, differences: &[Vector2<f64>], loss: Loss) -> Vector2<f64> {
        let mut centre = self.middle(differences);
        if self.shift == Shift::None {
            return centre;
        }
        for _ in 0..50 {
            let (mut sum, mut weights) = (Vector2::zeros(), 0.0);
            for difference in differences {
                let weight = loss.weight((difference - centre).norm_squared());
                sum += weight * difference;
                weights += weight;
            }
            if weights.is_nan() || weights <= 0.0 {
                break;
            }
            let moved = (sum / weights - centre).norm();
            centre = sum / weights;
            if moved < 1e-10 {
                break;
            }
        }
        centre
    }
}

/// A function of one number.
struct OneNumber<F>(F);

impl<F: Fn(f64) -> f64> CostFunction for OneNumber<F> {
    type Param = f64;
    type Output = f64;

    fn cost(&self, at: &f64) -> Result<f64, Error> {
        Ok((self.0)(*at))
    }
}

/// Where a function is least within `half` of `centre`.
fn minimum(centre: f64, half: f64, function: impl Fn(f64) -> f64) -> f64 {
    let brent = BrentOpt::new(centre - half, centre + half).set_tolerance(1e-9, TOLERANCE_S);
    let run = Executor::new(OneNumber(function), brent).configure(|state| state.max_iters(100)).run();
    run.ok().and_then(|run| run.state.best_param).unwrap_or(centre)
}
