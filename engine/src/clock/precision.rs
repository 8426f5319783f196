//! How well an offset is known.
//!
//! With `u` the velocity less its mean (the mean goes with the free shift), `psi = rho' r` and `a` the mean
//! of `rho' + s rho''`, the offset of a sum of rho has the variance
//!
//! ```text
//! sum_ij u_i^T C(i - j) u_j / (a sum |u|^2)^2,     C(k) = mean of psi_i psi_(i+k)^T
//! ```
//!
//! the usual one of an M-estimator (Huber 1964), with errors that last. `C` ends where its trace is no
//! longer positive (Geyer, *Practical Markov chain Monte Carlo*, 1992). It is enlarged for the unknowns that
//! the residuals were fitted with, counted against independent samples.
//!
//! What drifts over all of the film does not show in what is left: with a velocity that grows evenly it is
//! the same as an offset. `by_drift_s` is what such an error would do,
//!
//! ```text
//! | sum_i u_i tau_i | / sum |u|^2,     tau a line of root mean square 1 over the film
//! ```
//!
//! Velocities are noisy, and noise looks like change. `sum |u|^2` is therefore that of the velocities of both
//! tracks, one times the other, whose noises have nothing in common; each is the slope of a line fitted to
//! the places nearby, gross errors left out.

use super::curve::Curve;
use super::{Sample, Shift};
use nalgebra::{Matrix2, Vector2};
use trackbundle_solver::loss::Loss;

/// Velocities are those of lines fitted to the time within this \[s\], or within two steps of the reference.
const HALF_WINDOW_S: f64 = 0.5;
/// Velocities that vary together by less than noise would in one of some hundred cases are noise.
const CHANCE_SIGMAS: f64 = 3.0;
/// In short tracks chance goes far; from this correlation on, it is none.
const CERTAIN: f64 = 0.9;

/// Rounds of the variance of the mean.
const MEANS: usize = 3;
/// It is taken for this share of the variance at most.
const LARGEST_MEAN: f64 = 0.25;

/// How well an offset is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OffsetPrecision {
    /// Its standard deviation \[s\].
    pub sigma_s: f64,
    /// What it is known by: the change of velocity (without a shift, the velocity), root mean square \[m/s\].
    pub change_mps: f64,
    /// How many independent samples there are.
    pub independent: f64,
    /// How far a drift of the track in x, in y, of 1 m root mean square moves the offset \[s/m\].
    pub by_drift_s: [f64; 2],
}

/// Of the offset at which these samples of the track leave these residuals \[m\] against the reference.
pub fn precision(
    samples: &[Sample],
    residuals: &[Vector2<f64>],
    loss: Loss,
    reference: &Curve,
    offset_s: f64,
    shift: Shift,
) -> Result<OffsetPrecision, String> {
    let weights: Vec<f64> = residuals.iter().map(|r| loss.weight(r.norm_squared())).collect();
    let other: Vec<Sample> = samples
        .iter()
        .map(|(time_s, at)| (*time_s, reference.at(time_s + offset_s).map_or(*at, |p| p.coords.xy())))
        .collect();
    let half_s = HALF_WINDOW_S.max(2.0 * reference.step_s());
    let pairs: Vec<Option<[Vector2<f64>; 2]>> = velocities(samples, &weights, half_s)
        .into_iter()
        .zip(velocities(&other, &weights, half_s))
        .map(|(own, other)| Some([own?, other?]))
        .collect();
    let changes = changes(&pairs, &weights, shift);
    let sum = |f: &dyn Fn(&[Vector2<f64>; 2]) -> f64| changes.iter().map(f).sum::<f64>();
    let information = sum(&|[own, other]| own.dot(other));
    let noise = (sum(&|[own, _]| own.norm_squared()) * sum(&|[_, other]| other.norm_squared())).sqrt();
    let count = residuals.len() as f64;
    let change_mps = (information.max(0.0) / count).sqrt();
    let [first, last] = [samples.first(), samples.last()].map(|s| s.map_or(0.0, |(time_s, _)| *time_s));
    let windows = ((last - first) / (2.0 * half_s)).max(1.0);
    let by_chance = (CHANCE_SIGMAS / (2.0 * windows).sqrt()).min(CERTAIN);
    if information.is_nan() || information <= by_chance * noise {
        return Err(format!(
            "{} shows the offset, and there is hardly any: {:.3} m/s (rms) in the reference, its correlation \
             with that of the track {:.2}, by chance up to {by_chance:.2}",
            shift.what_counts(),
            (sum(&|[_, other]| other.norm_squared()) / count).sqrt(),
            if noise > 0.0 { information / noise } else { 0.0 }
        ));
    }

    let psi: Vec<Vector2<f64>> = residuals.iter().zip(&weights).map(|(r, w)| *w * r).collect();
    let bend = |r: &Vector2<f64>| {
        let [_, slope, bend] = loss.rho(r.norm_squared());
        slope + r.norm_squared() * bend
    };
    let curvature = residuals.iter().map(bend).sum::<f64>() / count;
    let middle = 0.5 * (first + last);
    let drift =
        |(time_s, _): &Sample| 12_f64.sqrt() * (time_s - middle) / (last - first).max(f64::MIN_POSITIVE);
    let along: Vector2<f64> =
        samples.iter().zip(&changes).map(|(sample, [own, other])| 0.5 * drift(sample) * (own + other)).sum();
    let by_drift_s = [along.x, along.y].map(|sum| sum.abs() / information);
    let mean: Vec<Vector2<f64>> = changes.iter().map(|[own, other]| 0.5 * (own + other)).collect();
    let [variance, white, lasting] = correlated(&psi, &mean);
    let independent = count / lasting;
    let freedom = 2.0 * independent;
    if freedom <= shift.unknowns() + 1.0 {
        return Err(format!(
            "what is left lasts so long that it is worth {independent:.1} independent places, too few for {} unknowns",
            shift.unknowns()
        ));
    }
    let enlarged = variance.max(white) * freedom / (freedom - shift.unknowns());
    let sigma_s = enlarged.sqrt() / (curvature * information);
    if !(curvature > 0.0 && sigma_s.is_finite()) {
        return Err("what is left has no scale".to_owned());
    }
    Ok(OffsetPrecision { sigma_s, change_mps, independent, by_drift_s })
}

/// The slope of a line fitted to the places within `half_s` of each, by their weights \[m/s\]; `None` where
/// that time holds none to speak of.
fn velocities(samples: &[Sample], weights: &[f64], half_s: f64) -> Vec<Option<Vector2<f64>>> {
    let (mut first, mut last) = (0, 0);
    let slope = |(centre_s, centre): &Sample| {
        while samples[first].0 < centre_s - half_s {
            first += 1;
        }
        while last < samples.len() && samples[last].0 <= centre_s + half_s {
            last += 1;
        }
        let [mut w, mut wt, mut wtt] = [0.0; 3];
        let [mut wx, mut wtx] = [Vector2::zeros(); 2];
        for ((time_s, at), weight) in samples[first..last].iter().zip(&weights[first..last]) {
            let (t, x) = (time_s - centre_s, at - centre);
            w += weight;
            wt += weight * t;
            wtt += weight * t * t;
            wx += *weight * x;
            wtx += *weight * t * x;
        }
        let square = wtt - wt * wt / w;
        // A quarter of what all of them would have, or more.
        let is_wide = square > 0.25 * w * half_s * half_s / 3.0;
        is_wide.then(|| (wtx - wt / w * wx) / square)
    };
    samples.iter().map(slope).collect()
}

/// Velocities of both less their weighted means; zero where one of them is not known.
fn changes(pairs: &[Option<[Vector2<f64>; 2]>], weights: &[f64], shift: Shift) -> Vec<[Vector2<f64>; 2]> {
    let (mut means, mut sum) = ([Vector2::zeros(); 2], 0.0);
    for (pair, weight) in pairs.iter().zip(weights) {
        let Some(pair) = pair else { continue };
        sum += weight;
        (0..2).for_each(|k| means[k] += *weight * pair[k]);
    }
    if shift == Shift::None || sum <= 0.0 {
        means = [Vector2::zeros(); 2];
    } else {
        means.iter_mut().for_each(|mean| *mean /= sum);
    }
    let less = |pair: &Option<[Vector2<f64>; 2]>| {
        pair.map_or([Vector2::zeros(); 2], |[own, other]| [own - means[0], other - means[1]])
    };
    pairs.iter().map(less).collect()
}

/// `sum_ij u_i^T C(i - j) u_j`, the part of it with `i = j`, and how many samples one independent one is.
///
/// Residuals about their own mean have a `C` that is too small by the variance of that mean, which is
/// `C(0)` over the number of independent samples; it is put back.
fn correlated(psi: &[Vector2<f64>], u: &[Vector2<f64>]) -> [f64; 3] {
    let count = psi.len();
    let product = |a: &[Vector2<f64>], lag: usize| -> Matrix2<f64> {
        a.iter().zip(&a[lag..]).map(|(a, b)| a * b.transpose()).sum()
    };
    let first = product(psi, 0) / count as f64;
    let white = first.component_mul(&product(u, 0)).sum();
    let [mut variance, mut lasting] = [white, 1.0];
    let mut lags: Vec<[Matrix2<f64>; 2]> = Vec::new();
    for _ in 0..MEANS {
        let mean = first * (lasting / count as f64).min(LARGEST_MEAN);
        [variance, lasting] = [white, 1.0];
        for lag in 1..=count / 2 {
            if lags.len() < lag {
                let scale = 1.0 / (count - lag) as f64;
                lags.push([product(psi, lag) * scale, product(u, lag)]);
            }
            let covariance = lags[lag - 1][0] + mean;
            if covariance.trace().is_nan() || covariance.trace() <= 0.0 {
                break;
            }
            variance += 2.0 * covariance.component_mul(&lags[lag - 1][1]).sum();
            lasting += 2.0 * (1.0 - lag as f64 / count as f64) * covariance.trace() / (first + mean).trace();
        }
    }
    [variance, white, lasting]
}
