//! The highest point of a body whose height is known.
//!
//! Of many points whose heights are found to a centimetre each, the one that is found highest is one whose error points
//! up. To tie it to the known height would make every roof too low, and with it the vehicle too large and too near; the
//! more so, the more points there are. What is known is the height of the point that *is* highest. So heights near
//! the top count as drawn from a normal distribution whose mean and scatter are estimated from them (empirical Bayes,
//! Efron and Morris 1973): with heights `h_i` found to `s_i`,
//!
//! ```text
//! sum (h_i - m)^2 / (tau^2 + s_i^2) = n - 1,   tau = 0 where the left is less
//! k_i = tau^2 / (tau^2 + s_i^2)
//! true height of i ~ N(m + k_i (h_i - m), k_i s_i^2),         top = E max of these
//! ```
//!
//! and the point that is highest by these means is tied to where the top lies at the known height: `h - (h - top)`.

use crate::estimate::{Estimate, VehicleEstimate};
use crate::problem::{Problem, Vehicle};
use crate::rules::rules;
use crate::stats::normal::normal_below;
use crate::stats::quantile::upper_median;
use nalgebra::{Matrix3, Vector3};

rules! {
    /// The highest point of a body.
    pub struct HighestRules {
        /// A point that is seen less often than this part of what most are may lie anywhere.
        least_seen: f64 = 0.5, "share of the median";
        /// Points this near to the highest found one may be the highest.
        near_sigmas: f64 = 4.0, "standard deviations of a height";
        /// Steps of the integral over the height of the top.
        steps: usize = 200, "steps";
        /// Halvings in which the scatter of heights near the top is found.
        halvings: usize = 60, "halvings";
    }
}

const RULES: HighestRules = HighestRules::DEFAULT;
/// Of a height that is found exactly \[m^2\].
const LEAST_VARIANCE: f64 = 1e-18;

/// A point that stands for the highest one of a body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Highest {
    /// Its index.
    pub point: usize,
    /// How much higher it is found than the highest one is likely to be \[m\].
    pub above_m: f64,
    /// Standard deviation of that, beside that of the point itself \[m\].
    pub above_sigma_m: f64,
}

/// A height, how well it is found by its own image points, and of which point it is.
#[derive(Clone, Copy, Debug)]
struct Height {
    height_m: f64,
    sigma_m: f64,
    point: usize,
}

/// What stands for the highest point of each vehicle whose height is known. `items` are the image points that take
/// part, as indices of vehicles and of their observations.
pub fn highest_points(
    problem: &Problem,
    estimate: &Estimate,
    items: &[(usize, usize)],
) -> Vec<Option<Highest>> {
    let mut of_vehicles = vec![Vec::new(); problem.vehicles.len()];
    items.iter().for_each(|(vehicle, item)| of_vehicles[*vehicle].push(*item));
    let of_vehicle = |(at, items): (usize, Vec<usize>)| {
        let (vehicle, found) = (&problem.vehicles[at], &estimate.vehicles[at]);
        vehicle.height?;
        highest(&heights(problem, estimate, (vehicle, found), &items))
    };
    of_vehicles.into_iter().enumerate().map(of_vehicle).collect()
}

/// The heights of points that are seen well enough, with their standard deviations at the present poses.
fn heights(
    problem: &Problem,
    estimate: &Estimate,
    (vehicle, found): (&Vehicle, &VehicleEstimate),
    items: &[usize],
) -> Vec<Height> {
    let focal_px = problem.camera.focal_px.mean();
    let mut normals = vec![(Matrix3::zeros(), 0); vehicle.points.len()];
    for observation in items.iter().map(|item| &vehicle.observations[*item]) {
        let frame = observation.frame;
        let (Some(point), Some(pose)) = (found.points[observation.point], found.poses[frame]) else {
            continue;
        };
        let camera = estimate.camera_poses[frame].translation.vector;
        let ray: Vector3<f64> = pose.rotation.inverse() * ((pose * point).coords - camera);
        let (distance_m, direction) = (ray.norm(), ray.normalize());
        let per_m = focal_px / (distance_m * observation.sigma_px);
        let (normal, count) = &mut normals[observation.point];
        *normal += (Matrix3::identity() - direction * direction.transpose()) * per_m.powi(2);
        *count += 1;
    }
    let counts: Vec<usize> = normals.iter().map(|(_, count)| *count).filter(|count| *count > 0).collect();
    let enough =
        upper_median(counts.iter().map(|count| *count as f64).collect()).unwrap_or(0.0) * RULES.least_seen;
    let height = |(point, (normal, count)): (usize, &(Matrix3<f64>, usize))| {
        let sigma_m = normal.try_inverse().filter(|_| *count as f64 >= enough)?[(2, 2)].max(0.0).sqrt();
        Some(Height { height_m: found.points[point]?.z, sigma_m, point })
    };
    normals.iter().enumerate().filter_map(height).filter(|height| height.sigma_m.is_finite()).collect()
}

/// What stands for the highest of these; `None` without any.
fn highest(heights: &[Height]) -> Option<Highest> {
    let found_m = heights.iter().map(|height| height.height_m).reduce(f64::max)?;
    let typical_m = upper_median(heights.iter().map(|height| height.sigma_m).collect())?;
    let from_m = found_m - RULES.near_sigmas * typical_m;
    let near: Vec<&Height> = heights.iter().filter(|height| height.height_m >= from_m).collect();
    let (mean_m, variance) = drawn_from(&near);
    // Where each of them is likely to be.
    let likely = |height: &&Height| {
        let kept = if near.len() == 1 {
            1.0
        } else {
            variance / (variance + height.sigma_m.powi(2)).max(f64::MIN_POSITIVE)
        };
        (mean_m + kept * (height.height_m - mean_m), kept.sqrt() * height.sigma_m)
    };
    let all: Vec<(f64, f64)> = near.iter().map(likely).collect();
    let above = |a: usize, b: usize| all[b].0 > all[a].0;
    let best = (0..near.len()).reduce(|a, b| if above(a, b) { b } else { a })?;
    let (top_m, top_variance) = maximum(&all);
    // What the point itself is off by is in the adjustment.
    let beyond_own = (top_variance - all[best].1.powi(2)).max(0.0);
    let above_m = near[best].height_m - top_m;
    Some(Highest { point: near[best].point, above_m, above_sigma_m: beyond_own.sqrt() })
}

/// The mean and the variance of the normal distribution that heights are drawn from: such that their squares, with their own
/// variances added, are as large as they should be (Paule and Mandel 1982).
fn drawn_from(heights: &[&Height]) -> (f64, f64) {
    let of = |variance: f64| {
        let weight = |height: &Height| 1.0 / (variance + height.sigma_m.powi(2)).max(LEAST_VARIANCE);
        let sums = heights.iter().fold([0.0; 2], |[sum, weights], height| {
            [sum + weight(height) * height.height_m, weights + weight(height)]
        });
        let mean = sums[0] / sums[1];
        let squares: f64 = heights.iter().map(|h| weight(h) * (h.height_m - mean).powi(2)).sum();
        (mean, squares)
    };
    let wanted = heights.len() as f64 - 1.0;
    let (mut least, mut most) = (0.0, heights.iter().map(|h| h.height_m.powi(2)).sum::<f64>().max(1.0));
    if of(least).1 <= wanted {
        return (of(least).0, least);
    }
    // Squares fall with the variance.
    for _ in 0..RULES.halvings {
        let middle = 0.5 * (least + most);
        if of(middle).1 > wanted { least = middle } else { most = middle }
    }
    (of(most).0, most)
}

/// The mean and the variance of the largest of independent normal numbers of these means and standard deviations.
fn maximum(numbers: &[(f64, f64)]) -> (f64, f64) {
    let most = numbers.iter().map(|(mean, _)| *mean).fold(f64::NEG_INFINITY, f64::max);
    let widest = numbers.iter().map(|(_, sigma)| *sigma).fold(0.0, f64::max);
    if widest == 0.0 {
        return (most, 0.0);
    }
    if let [(mean, sigma)] = numbers {
        return (*mean, sigma * sigma);
    }
    // The largest is below `x` with the product `p` of what each is. From the top down, E = b - int p and
    // E (b - .)^2 = 2 int (b - x) p.
    let (from, to) = (most - 6.0 * widest, most + 6.0 * widest);
    let step = (to - from) / RULES.steps as f64;
    let (mut first, mut second) = (0.0, 0.0);
    for k in 0..RULES.steps {
        let x = from + (k as f64 + 0.5) * step;
        let below = |(mean, sigma): &(f64, f64)| normal_below((x - mean) / sigma.max(1e-9 * widest));
        let all = numbers.iter().map(below).product::<f64>() * step;
        first += all;
        second += 2.0 * (to - x) * all;
    }
    (to - first, (second - first * first).max(0.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stats::drawn::Normal;

    /// The mean of how much too high the top is taken for, over many roofs; and that of the highest found point.
    fn too_high(count: usize, sigma_m: f64, roof: impl Fn(usize) -> f64) -> [f64; 2] {
        let runs = 400;
        let mut sums = [0.0; 2];
        let mut drawn = Normal(11);
        let top = (0..count).map(&roof).fold(f64::NEG_INFINITY, f64::max);
        for _ in 0..runs {
            let height = |point| Height { height_m: roof(point) + sigma_m * drawn.draw(), sigma_m, point };
            let heights: Vec<Height> = (0..count).map(height).collect();
            let found = highest(&heights).unwrap();
            let found_m = heights[found.point].height_m;
            assert!(found.above_sigma_m < sigma_m, "{found:?}");
            sums[0] += found_m - found.above_m - top;
            sums[1] += heights.iter().map(|h| h.height_m).fold(f64::NEG_INFINITY, f64::max) - top;
        }
        sums.map(|sum| sum / runs as f64)
    }

    #[test]
    fn the_top_of_a_roof_is_not_the_highest_error() {
        let sigma_m = 0.01;
        for count in [10, 100, 300] {
            // Level; vaulted by 2 cm; by 30 cm; points all over a body.
            for vault_m in [0.0, 0.02, 0.3, 1.2] {
                let roof = |point: usize| -vault_m * (point as f64 / count as f64).powi(2);
                let [ours, highest] = too_high(count, sigma_m, roof);
                assert!(ours.abs() < 0.6 * sigma_m, "{count} points, {vault_m} m: {ours}");
                assert!(highest > ours, "{count} points, {vault_m} m: {highest}");
            }
            let [_, highest] = too_high(count, sigma_m, |_| 0.0);
            assert!(highest > 1.4 * sigma_m, "{highest}");
        }
    }

    #[test]
    fn one_point_is_its_own_top() {
        let height = |height_m, point| Height { height_m, sigma_m: 0.01, point };
        let far = [height(0.2, 4), height(1.5, 7), height(0.9, 8)];
        assert_eq!(highest(&far), Some(Highest { point: 7, above_m: 0.0, above_sigma_m: 0.0 }));
        assert_eq!(highest(&[]), None);
        // Without errors the highest is the highest.
        let exact = far.map(|height| Height { sigma_m: 0.0, ..height });
        assert_eq!(highest(&exact), Some(Highest { point: 7, above_m: 0.0, above_sigma_m: 0.0 }));
    }

    /// Of two alike the larger one is `1 / sqrt(pi)` above their mean, of three `1.5 / sqrt(pi)`.
    #[test]
    fn the_largest_of_some_is_where_it_is_known_to_be() {
        let root = std::f64::consts::PI.sqrt();
        let expected_maximum = |numbers: &[(f64, f64)]| maximum(numbers).0;
        assert!((expected_maximum(&[(0.0, 1.0); 2]) - 1.0 / root).abs() < 1e-6);
        assert!((maximum(&[(0.0, 1.0); 2]).1 - (1.0 - 1.0 / (root * root))).abs() < 5e-4);
        assert!((expected_maximum(&[(2.0, 0.1); 3]) - 2.0 - 0.15 / root).abs() < 1e-7);
        assert!((expected_maximum(&[(0.0, 1.0), (50.0, 1.0)]) - 50.0).abs() < 1e-6);
    }

    /// Points that are seen twice may lie anywhere: the height of others then says little.
    #[test]
    fn what_may_be_higher_makes_the_height_uncertain() {
        let height = |height_m, sigma_m, point| Height { height_m, sigma_m, point };
        let mut all = vec![height(1.5, 0.01, 0), height(1.49, 0.01, 1), height(0.7, 0.1, 2)];
        let good = highest(&all).unwrap();
        assert!(good.above_m.abs() < 0.01 && good.above_sigma_m < 0.02, "{good:?}");
        all.extend((3..8).map(|point| height(0.2 * point as f64, 3.0, point)));
        let doubtful = highest(&all).unwrap();
        assert!(doubtful.above_sigma_m > 0.1, "{doubtful:?}");
    }
}
