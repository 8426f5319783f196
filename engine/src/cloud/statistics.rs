//! What many distances are like, all alike or weighted by what is known of their points.

use crate::stats::weighted::{WeightedSample, weighted_quantile};

/// Shares of the points for which the distance is stated that they do not exceed.
pub const PERCENTILES: [f64; 4] = [0.50, 0.68, 0.90, 0.95];

/// Distances within which the share of the points is stated \[m\].
pub const WITHIN_M: [f64; 4] = [0.01, 0.02, 0.05, 0.10];

/// Distances in a few numbers. Those of signed distances keep the sign in the median, the mean and the MAD.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DistanceStatistics {
    /// How many points.
    pub count: usize,
    /// The middle one \[m\].
    pub median_m: f64,
    /// Median absolute deviation from the median, as it is \[m\].
    pub mad_m: f64,
    /// Mean \[m\].
    pub mean_m: f64,
    /// Root mean square, about zero \[m\].
    pub rms_m: f64,
    /// The largest, without sign \[m\].
    pub max_m: f64,
    /// What shares of [`PERCENTILES`] do not exceed, without sign \[m\].
    pub percentiles_m: [f64; 4],
    /// Shares that are within [`WITHIN_M`], without sign.
    pub within: [f64; 4],
}

impl DistanceStatistics {
    /// Of these distances \[m\], each counted once; `None` without a finite one.
    pub fn of(distances_m: &[f64]) -> Option<Self> {
        Self::weighted(distances_m, &vec![1.0; distances_m.len()])
    }

    /// Of these distances \[m\], each with its weight, of which only ratios matter. Distances that are not
    /// finite and weights that are not positive are left out; `None` if nothing is left.
    pub fn weighted(distances_m: &[f64], weights: &[f64]) -> Option<Self> {
        let pairs: Vec<(f64, f64)> = distances_m
            .iter()
            .zip(weights)
            .map(|(distance, weight)| (*distance, *weight))
            .filter(|(distance, weight)| distance.is_finite() && weight.is_finite() && *weight > 0.0)
            .collect();
        let of = |f: &dyn Fn(f64) -> f64| pairs.iter().map(|(d, w)| (f(*d), *w)).collect::<Vec<_>>();
        let total: f64 = pairs.iter().map(|(_, w)| w).sum();
        let mean = |f: &dyn Fn(f64) -> f64| pairs.iter().map(|(d, w)| w * f(*d)).sum::<f64>() / total;
        let median_m = weighted_quantile(of(&|d| d), 0.5)?;
        let unsigned = WeightedSample::new(of(&f64::abs))?;
        Some(DistanceStatistics {
            count: pairs.len(),
            median_m,
            mad_m: weighted_quantile(of(&|d| (d - median_m).abs()), 0.5)?,
            mean_m: mean(&|d| d),
            rms_m: mean(&|d| d * d).sqrt(),
            max_m: unsigned.quantile(1.0),
            percentiles_m: PERCENTILES.map(|share| unsigned.quantile(share)),
            within: WITHIN_M.map(|limit| mean(&|d| f64::from(u8::from(d.abs() <= limit)))),
        })
    }

    /// Of those distances \[m\] whose own standard deviation \[m\] is known and at most `limit_m`.
    pub fn limited(distances_m: &[f64], sigmas_m: &[Option<f64>], limit_m: f64) -> Option<Self> {
        let weight = |sigma: &Option<f64>| f64::from(u8::from(sigma.is_some_and(|sigma| sigma <= limit_m)));
        Self::weighted(distances_m, &sigmas_m.iter().map(weight).collect::<Vec<_>>())
    }
}

/// The weight of a distance whose point has the standard deviation `sigma_m`: `1 / (s0^2 + sigma^2)`. Here `s0` is
/// what else separates the clouds (noise of the scan, its spacing, the body itself), so that a point
/// with a small standard deviation does not count for more than a perfect one could.
pub fn precision_weight(s0_m: f64, sigma_m: f64) -> f64 {
    1.0 / (s0_m * s0_m + sigma_m * sigma_m)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::tests::Draws;

    #[test]
    fn a_few_distances_by_hand() {
        let found = DistanceStatistics::of(&[0.01, -0.02, 0.04, 0.0, 1.0]).unwrap();
        assert_eq!((found.count, found.median_m, found.max_m), (5, 0.01, 1.0));
        assert!((found.mad_m - 0.03).abs() < 1e-15);
        assert!((found.mean_m - 0.206).abs() < 1e-15);
        assert!((found.rms_m - (1.0021_f64 / 5.0).sqrt()).abs() < 1e-15);
        assert_eq!(found.within, [0.4, 0.6, 0.8, 0.8]);
        assert!((found.percentiles_m[0] - 0.02).abs() < 1e-15);
        assert!((found.percentiles_m[3] - (0.04 + 0.8 * 0.96)).abs() < 1e-12);
        assert_eq!(DistanceStatistics::of(&[f64::NAN]), None);
    }

    #[test]
    fn a_heavy_point_counts_like_many() {
        let mut draws = Draws::new(7);
        let values: Vec<f64> = (0..400).map(|_| draws.uniform()).collect();
        let weights: Vec<f64> = (0..400).map(|i| f64::from(1 + i % 4)).collect();
        let repeated: Vec<f64> =
            values.iter().zip(&weights).flat_map(|(v, w)| std::iter::repeat_n(*v, *w as usize)).collect();
        let found = DistanceStatistics::weighted(&values, &weights).unwrap();
        let wanted = DistanceStatistics::of(&repeated).unwrap();
        assert!((found.mean_m - wanted.mean_m).abs() < 1e-12 && (found.rms_m - wanted.rms_m).abs() < 1e-12);
        assert!(found.within.iter().zip(&wanted.within).all(|(a, b)| (a - b).abs() < 1e-12));
        // Quantiles differ by a place of the sample at the most.
        assert!((found.median_m - wanted.median_m).abs() < 0.01, "{found:?} {wanted:?}");
        assert!((found.percentiles_m[3] - wanted.percentiles_m[3]).abs() < 0.01);
    }

    #[test]
    fn poor_points_can_be_left_out() {
        let distances = [0.01, 0.02, 0.9, 0.03];
        let sigmas = [Some(0.01), Some(0.02), Some(0.5), None];
        let found = DistanceStatistics::limited(&distances, &sigmas, 0.02).unwrap();
        assert_eq!(Some(found), DistanceStatistics::of(&distances[..2]));
        assert_eq!(DistanceStatistics::limited(&distances, &sigmas, 0.001), None);
        assert!((precision_weight(0.03, 0.04) - 400.0).abs() < 1e-9);
    }
}
