//! What many differences are like.

use crate::stats::normal::MAD_TO_SIGMA;
use crate::stats::quantile::{median, quantile};

/// Differences in a few numbers, in their unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DifferenceStatistics {
    /// How many there are.
    pub count: usize,
    /// The middle one.
    pub median: f64,
    /// Median absolute deviation from the median, as it is.
    pub mad: f64,
    /// The same for comparison with a standard deviation: times [`MAD_TO_SIGMA`].
    pub mad_sigma: f64,
    /// Their mean: a constant shift, which is only reported.
    pub mean: f64,
    /// Root mean square, about zero.
    pub rms: f64,
    /// 95 % are no larger than this.
    pub abs_95: f64,
}

impl DifferenceStatistics {
    /// Of these values; `None` without any.
    pub fn of(values: &[f64]) -> Option<Self> {
        let middle = median(values.to_vec())?;
        let mad = median(values.iter().map(|v| (v - middle).abs()).collect())?;
        let count = values.len();
        let mean = |f: fn(f64) -> f64| values.iter().map(|v| f(*v)).sum::<f64>() / count as f64;
        Some(DifferenceStatistics {
            count,
            median: middle,
            mad,
            mad_sigma: MAD_TO_SIGMA * mad,
            mean: mean(|v| v),
            rms: mean(|v| v * v).sqrt(),
            abs_95: quantile(values.iter().map(|v| v.abs()).collect(), 0.95)?,
        })
    }
}

/// Distances of pairs in a few numbers, by the names of `evo` \[m\].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Distances {
    /// How many there are.
    pub count: usize,
    /// Root mean square.
    pub rmse: f64,
    /// Mean.
    pub mean: f64,
    /// Median.
    pub median: f64,
    /// Root mean square deviation from the mean.
    pub std: f64,
    /// The least.
    pub min: f64,
    /// The largest.
    pub max: f64,
    /// Sum of squares \[m^2\].
    pub sse: f64,
}

impl Distances {
    /// Of these; `None` without any.
    pub fn of(distances: &[f64]) -> Option<Self> {
        let count = distances.len() as f64;
        let mean = distances.iter().sum::<f64>() / count;
        let sse: f64 = distances.iter().map(|d| d * d).sum();
        let spread: f64 = distances.iter().map(|d| (d - mean).powi(2)).sum();
        Some(Distances {
            count: distances.len(),
            rmse: (sse / count).sqrt(),
            mean,
            median: median(distances.to_vec())?,
            std: (spread / count).sqrt(),
            min: quantile(distances.to_vec(), 0.0)?,
            max: quantile(distances.to_vec(), 1.0)?,
            sse,
        })
    }
}

/// How wide a histogram is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HalfWidth {
    /// Half its width at half its greatest height; 1.18 standard deviations of a normal distribution. Somewhat short: the highest bin is
    /// high by chance too (6 % for 40,000 normal numbers).
    pub half_width: f64,
    /// Width of a bin.
    pub bin: f64,
}

/// More bins than this are not made: values so far apart are no peak with a width.
const MOST_BINS: f64 = 1e6;

/// Half the width at half the maximum of the histogram of these values. Bins are `2 IQR n^(-1/3)` wide
/// (Freedman and Diaconis 1981), one of them with the median at its centre. From the highest bin outwards
/// the height is linear between the centres of bins, up to where it first falls to half. `None` where the
/// inner half of the values are equal, or are all there is.
pub fn half_width_at_half_maximum(values: &[f64]) -> Option<HalfWidth> {
    let of = |share| quantile(values.to_vec(), share);
    let bin = 2.0 * (of(0.75)? - of(0.25)?) / (values.len() as f64).cbrt();
    let (middle, least, most) = (of(0.5)?, of(0.0)?, of(1.0)?);
    if !(bin > 0.0 && bin.is_finite() && (most - least) / bin < MOST_BINS) {
        return None;
    }
    let number = |value: f64| ((value - middle) / bin).round() as i64;
    // An empty bin at either end, so that every peak falls off.
    let first = number(least) - 1;
    let mut counts = vec![0.0_f64; (number(most) - first + 2) as usize];
    values.iter().for_each(|value| counts[(number(*value) - first) as usize] += 1.0);
    let peak = (0..counts.len()).rev().max_by(|a, b| counts[*a].total_cmp(&counts[*b]))?;
    let half = 0.5 * counts[peak];
    // From a bin at or above half to the next one, which is below.
    let crossing = |inner: usize, outer: usize| (counts[inner] - half) / (counts[inner] - counts[outer]);
    let right = (peak..counts.len() - 1).find(|at| counts[at + 1] < half)?;
    let left = (1..=peak).rev().find(|at| counts[at - 1] < half)?;
    let width = (right - left) as f64 + crossing(right, right + 1) + crossing(left, left - 1);
    Some(HalfWidth { half_width: 0.5 * width * bin, bin })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stats::drawn::Normal;

    #[test]
    fn a_few_numbers_by_hand() {
        let found = DifferenceStatistics::of(&[1.0, -2.0, 4.0, 0.0, 100.0]).unwrap();
        assert_eq!((found.count, found.median, found.mad, found.mean), (5, 1.0, 3.0, 20.6));
        assert!((found.rms - (10021.0_f64 / 5.0).sqrt()).abs() < 1e-12);
        assert!((found.abs_95 - (4.0 + 0.8 * 96.0)).abs() < 1e-12);
        assert_eq!(median(vec![3.0, 1.0, 2.0, 10.0]), Some(2.5));
        assert_eq!((DifferenceStatistics::of(&[]), median(vec![])), (None, None));
    }

    #[test]
    fn distances_by_hand() {
        let found = Distances::of(&[3.0, 1.0, 4.0, 4.0]).unwrap();
        assert_eq!((found.count, found.mean, found.median, found.min, found.max), (4, 3.0, 3.5, 1.0, 4.0));
        assert_eq!((found.sse, found.rmse, found.std), (42.0, 10.5_f64.sqrt(), 1.5_f64.sqrt()));
        assert_eq!(Distances::of(&[]), None);
    }

    #[test]
    fn quantiles_count() {
        let mut normal = Normal(3);
        let values: Vec<f64> = (0..1001).map(|_| normal.draw()).collect();
        for share in [0.05, 0.5, 0.9] {
            let found = quantile(values.clone(), share).unwrap();
            let below = values.iter().filter(|v| **v < found).count();
            assert_eq!(below, (1000.0 * share) as usize);
        }
    }

    #[test]
    fn normal_numbers_have_their_widths() {
        let mut normal = Normal(1);
        let values: Vec<f64> = (0..40_000).map(|_| 5.0 + 0.3 * normal.draw()).collect();
        let found = DifferenceStatistics::of(&values).unwrap();
        assert!((found.mad_sigma / 0.3 - 1.0).abs() < 0.02, "{found:?}");
        let width = half_width_at_half_maximum(&values).unwrap();
        assert!((width.half_width / (0.3 * (2.0 * 2f64.ln()).sqrt()) - 1.0).abs() < 0.1, "{width:?}");
    }

    #[test]
    fn the_half_width_is_that_of_the_peak_and_not_of_its_tails() {
        // A triangle from -1 to 1 has half its height at half its way; far away a tenth of all.
        let mut values: Vec<f64> = Vec::new();
        for k in 0..=2000 {
            let x = f64::from(k) / 1000.0 - 1.0;
            values.extend(std::iter::repeat_n(x, ((1.0 - x.abs()) * 20.0).round() as usize));
        }
        values.extend((0..values.len() / 10).map(|k| 30.0 + 0.01 * k as f64));
        let width = half_width_at_half_maximum(&values).unwrap();
        assert!((width.half_width - 0.5).abs() < 0.03, "{width:?}");
    }

    #[test]
    fn values_without_a_width_have_none() {
        for values in [vec![], vec![1.0], vec![2.0; 9], vec![1.0, 1.0, 1.0, 1.0, 9.0], vec![f64::NAN; 5]] {
            assert_eq!(half_width_at_half_maximum(&values), None, "{values:?}");
        }
        assert_eq!(half_width_at_half_maximum(&[0.0, 1e-300, 2e-300, 3e-300, 1e300]), None);
    }
}
