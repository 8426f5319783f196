//! A static point from its rays in many frames, some of them gross errors.
//!
//! Two rays that cross at a wide angle give a hypothesis; of many such pairs that one is kept whose median
//! residual over all rays is least (Rousseeuw 1984), which needs neither a standard deviation of the
//! poses nor good rays in more than half of the frames. From there on Tukey's loss, its scale stretched by
//! that median, is minimised by Gauss-Newton:
//!
//! ```text
//! X = A G + b  (camera_from_world),    r = ((x, y) - (X1, X2) / X3) / sigma
//! dr/dG = -1/X3 [A1 - X1/X3 A3 ; A2 - X2/X3 A3] / sigma
//! ```
//!
//! What is known of a coordinate beforehand is a row of its own. The covariance is the inverse of the
//! normal matrix at the end, from the standard deviations of the rays as stated.

use super::dlt::{LinearPoint, Sighting};
use crate::problem::Known;
use crate::rules::rules;
use crate::stats::normal::GROSS_SIGMAS;
use crate::stats::quantile::upper_median;
use nalgebra::{Matrix2x3, Matrix3, Point3, Vector2, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use trackbundle_solver::loss::{Loss, LossName, robust_spread};

rules! {
    /// Robust intersection of rays.
    pub struct TriangulationRules {
        /// A point whose depth is worse known is said to have none: the camera hardly moves, and the point would
        /// drift along its ray.
        least_parallax: f64 = 0.01, "share of the distance";
        /// The same where the rays scatter more than stated and this is taken into account.
        least_scattered_parallax: f64 = 0.1, "share of the distance";
        /// Most pairs of rays that are tried.
        most_pairs: usize = 100, "pairs";
        /// Of so many random pairs the one with the widest angle is tried.
        draws_for_a_pair: usize = 4, "pairs";
        /// Rays by which hypotheses are compared; of more an even choice is taken.
        most_judging_rays: usize = 200, "rays";
        /// Fewest rays that say anything about how they scatter.
        spread_least_rays: usize = 5, "rays";
        /// Cameras nearer together stand in one place.
        still_camera_m: f64 = 1e-6, "m";
        /// The most steps of least squares.
        most_steps: usize = 20, "steps";
        /// Standard deviation that a coordinate known as exact is given.
        exact_sigma_m: f64 = 1e-6, "m";
    }
}

const RULES: TriangulationRules = TriangulationRules::DEFAULT;
const SEED: u64 = 7;

/// A point and how well it is known.
#[derive(Clone, Debug, PartialEq)]
pub struct Triangulated {
    /// Where it is, in the frame of the body (of a static point: the world) \[m\].
    pub point: Point3<f64>,
    /// Its covariance from the standard deviations of the rays as stated, 3 x 3 \[m^2\].
    pub covariance: Matrix3<f64>,
    /// By what the rays scatter more than stated, at least 1.
    pub spread: f64,
    /// Which rays are no gross errors.
    pub is_good: Vec<bool>,
}

/// Why there is no point.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum NoPoint {
    /// Fewer than two rays.
    #[error("{0} frames see it, two are needed")]
    TooFew(usize),
    /// They are too nearly parallel.
    #[error("its rays are so nearly parallel that its position is only known to {sigma_m:.1} m")]
    Parallel {
        /// Standard deviation along its worst axis \[m\]; infinite where nothing is known.
        sigma_m: f64,
    },
    /// Too few of them meet in a point in front of the cameras.
    #[error("only {good} of its {all} rays meet")]
    Contradictory {
        /// Rays that meet.
        good: usize,
        /// All rays.
        all: usize,
    },
}

/// The point where most of the rays meet. Two rays are needed at least; less than half of them may be gross
/// errors.
pub fn triangulate(sightings: &[Sighting], known: &[Option<Known>; 3]) -> Result<Triangulated, NoPoint> {
    if sightings.len() < 2 {
        return Err(NoPoint::TooFew(sightings.len()));
    }
    if is_still(sightings) && known.iter().all(Option::is_none) {
        return Err(NoPoint::Parallel { sigma_m: f64::INFINITY });
    }
    let stride = sightings.len().div_ceil(RULES.most_judging_rays);
    let judges: Vec<&Sighting> = sightings.iter().step_by(stride).collect();
    let middle = |point: &Point3<f64>| {
        upper_median(judges.iter().map(|s| norm(s, point)).collect()).unwrap_or(f64::INFINITY)
    };
    let hypotheses = pairs(sightings).into_iter().filter_map(|(i, j)| {
        let point = LinearPoint::new(&[sightings[i], sightings[j]], known).solve()?;
        Some((middle(&point), point))
    });
    let Some((median, start)) = hypotheses.min_by(|a, b| a.0.total_cmp(&b.0)) else {
        return Err(NoPoint::Parallel { sigma_m: f64::INFINITY });
    };
    if !median.is_finite() {
        let good = judges.iter().filter(|s| norm(s, &start).is_finite()).count();
        return Err(NoPoint::Contradictory { good, all: judges.len() });
    }
    // The norm of two unit normal numbers has the median sqrt(2 ln 2). A pair fits itself.
    let says_spread = sightings.len() >= RULES.spread_least_rays;
    let scale = if says_spread { (median / (2.0 * 2_f64.ln()).sqrt()).max(1.0) } else { 1.0 };
    let tukey = |spread: f64| LossName::Tukey.with_scale(GROSS_SIGMAS * spread, 0.0);
    let rough = descend(sightings, known, start, tukey(2.0 * scale));
    let squares = || sightings.iter().map(|s| norm(s, &rough).powi(2)).collect();
    let spread = if says_spread { robust_spread(squares()).max(1.0) } else { 1.0 };
    let point = descend(sightings, known, rough, tukey(spread));

    let limit = GROSS_SIGMAS * spread;
    let is_good: Vec<bool> = sightings.iter().map(|s| norm(s, &point) <= limit).collect();
    let good = is_good.iter().filter(|good| **good).count();
    if 2 * good < sightings.len() || good < 2 || !point.iter().all(|v| v.is_finite()) {
        return Err(NoPoint::Contradictory { good, all: sightings.len() });
    }
    let inside = sightings.iter().zip(&is_good).filter(|(_, good)| **good).map(|(s, _)| s);
    let (normal, ..) = normal(inside.clone(), known, &point, Loss::Squared);
    let Some(covariance) = inverse(&normal) else {
        return Err(NoPoint::Parallel { sigma_m: f64::INFINITY });
    };
    let distance_m = inside.map(|s| (s.camera_from_body * point).coords.norm()).fold(f64::INFINITY, f64::min);
    let sigma_m = covariance.symmetric_eigenvalues().max().max(0.0).sqrt();
    let real_m = sigma_m * spread;
    if sigma_m > RULES.least_parallax * distance_m || real_m > RULES.least_scattered_parallax * distance_m {
        return Err(NoPoint::Parallel { sigma_m: real_m });
    }
    Ok(Triangulated { point, covariance, spread, is_good })
}

/// The point that most rays meet within `limit` standard deviations, by pairs of rays (random sample consensus:
/// Fischler and Bolles 1981) and Tukey's loss of that scale; `None` where that is no place for it. The poses must
/// be right, and more than half of the rays may be gross errors.
pub fn consensus(
    sightings: &[Sighting],
    known: &[Option<Known>; 3],
    limit: f64,
    is_a_place: impl Fn(&Point3<f64>) -> bool,
) -> Option<Point3<f64>> {
    if sightings.len() < 2 {
        return None;
    }
    let meeting = |point: &Point3<f64>| sightings.iter().filter(|s| norm(s, point) <= limit).count();
    let hypotheses = pairs(sightings).into_iter().filter_map(|(i, j)| {
        let point = LinearPoint::new(&[sightings[i], sightings[j]], known).solve().filter(&is_a_place)?;
        Some((meeting(&point), point))
    });
    // Of several with the same number the first, so that the answer is always the same.
    let best = hypotheses.reduce(|best, other| if other.0 > best.0 { other } else { best })?.1;
    let point = descend(sightings, known, best, LossName::Tukey.with_scale(limit, 0.0));
    is_a_place(&point).then_some(point)
}

/// Whether all cameras stand in one place.
fn is_still(sightings: &[Sighting]) -> bool {
    let place = |s: &Sighting| s.camera_from_body.inverse().translation.vector;
    let first = place(&sightings[0]);
    sightings.iter().all(|s| (place(s) - first).norm() < RULES.still_camera_m)
}

/// Pairs of rays to try: all, or of random ones those with the widest angle.
fn pairs(sightings: &[Sighting]) -> Vec<(usize, usize)> {
    let count = sightings.len();
    if count * (count - 1) / 2 <= RULES.most_pairs {
        return (0..count).flat_map(|i| (i + 1..count).map(move |j| (i, j))).collect();
    }
    let direction = |at: usize| {
        let Sighting { camera_from_body, ray, .. } = &sightings[at];
        camera_from_body.rotation.inverse() * ray.push(1.0).normalize()
    };
    let mut rng = ChaCha8Rng::seed_from_u64(SEED);
    let mut draw = || {
        let i = rng.random_range(0..count);
        (i, (i + rng.random_range(1..count)) % count)
    };
    let sine = |(i, j): &(usize, usize)| direction(*i).cross(&direction(*j)).norm();
    let mut widest = || {
        let drawn: [_; RULES.draws_for_a_pair] = std::array::from_fn(|_| draw());
        drawn.into_iter().max_by(|a, b| sine(a).total_cmp(&sine(b))).unwrap_or((0, 1))
    };
    (0..RULES.most_pairs).map(|_| widest()).collect()
}

/// Residual of a sighting in standard deviations, and its derivative by the point; `None` behind the
/// camera.
fn whitened(sighting: &Sighting, point: &Point3<f64>) -> Option<(Vector2<f64>, Matrix2x3<f64>)> {
    let seen = sighting.camera_from_body * point;
    if seen.z <= 0.0 {
        return None;
    }
    let ray = seen.coords.xy() / seen.z;
    let rotation = sighting.camera_from_body.rotation.to_rotation_matrix();
    let by_camera_point = Matrix2x3::new(1.0, 0.0, -ray.x, 0.0, 1.0, -ray.y) / -(seen.z * sighting.sigma);
    Some(((sighting.ray - ray) / sighting.sigma, by_camera_point * rotation.matrix()))
}

/// Length of the residual in standard deviations; infinite behind the camera.
fn norm(sighting: &Sighting, point: &Point3<f64>) -> f64 {
    let seen = sighting.camera_from_body * point;
    if seen.z <= 0.0 {
        return f64::INFINITY;
    }
    (sighting.ray - seen.coords.xy() / seen.z).norm() / sighting.sigma
}

/// Normal matrix, gradient and half the sum of rho.
fn normal<'s>(
    sightings: impl Iterator<Item = &'s Sighting>,
    known: &[Option<Known>; 3],
    point: &Point3<f64>,
    loss: Loss,
) -> (Matrix3<f64>, Vector3<f64>, f64) {
    let (mut matrix, mut gradient, mut cost) = (Matrix3::zeros(), Vector3::zeros(), 0.0);
    for sighting in sightings {
        let Some((residual, jacobian)) = whitened(sighting, point) else {
            cost += 0.5 * loss.rho(f64::MAX)[0];
            continue;
        };
        let [rho, weight, _] = loss.rho(residual.norm_squared());
        cost += 0.5 * rho;
        if weight > 0.0 {
            matrix += weight * jacobian.transpose() * jacobian;
            gradient += weight * jacobian.transpose() * residual;
        }
    }
    for (axis, known) in known.iter().enumerate() {
        let Some(Known { value_m, sigma_m }) = *known else { continue };
        let weight = sigma_m.max(RULES.exact_sigma_m).powi(-2);
        let off_m = point[axis] - value_m;
        cost += 0.5 * weight * off_m * off_m;
        matrix[(axis, axis)] += weight;
        gradient[axis] += weight * off_m;
    }
    (matrix, gradient, cost)
}

/// Gauss-Newton, damped where a step would raise the cost.
fn descend(
    sightings: &[Sighting],
    known: &[Option<Known>; 3],
    start: Point3<f64>,
    loss: Loss,
) -> Point3<f64> {
    let mut point = start;
    let (mut matrix, mut gradient, mut cost) = normal(sightings.iter(), known, &point, loss);
    let mut damping = 0.0;
    for _ in 0..RULES.most_steps {
        let mut damped = matrix;
        (0..3).for_each(|i| damped[(i, i)] *= 1.0 + damping);
        let Some(step) = damped.cholesky().map(|factor| factor.solve(&-gradient)) else { break };
        let next = point + step;
        let (next_matrix, next_gradient, next_cost) = normal(sightings.iter(), known, &next, loss);
        if next_cost <= cost {
            let is_small = step.dot(&(matrix * step)) < 1e-10;
            (point, matrix, gradient, cost) = (next, next_matrix, next_gradient, next_cost);
            damping *= 0.1;
            if is_small {
                break;
            }
        } else {
            damping = (10.0 * damping).max(1e-3);
        }
    }
    point
}

/// Inverse of a normal matrix, scaled to a unit diagonal first; `None` where it is singular.
fn inverse(normal: &Matrix3<f64>) -> Option<Matrix3<f64>> {
    let scale = Matrix3::from_diagonal(&Vector3::from_fn(|i, _| 1.0 / normal[(i, i)].sqrt()));
    let inverse = scale * (scale * normal * scale).cholesky()?.inverse() * scale;
    inverse.iter().all(|v| v.is_finite()).then_some(inverse)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Pose, rotation::exp};

    const SIGMA: f64 = 1.0 / 2680.0;

    fn normal_number(rng: &mut ChaCha8Rng) -> f64 {
        let radius = (-2.0 * rng.random_range(f64::EPSILON..1.0).ln()).sqrt();
        radius * rng.random_range(0.0..std::f64::consts::TAU).cos()
    }

    fn point() -> Point3<f64> {
        Point3::new(3.0, -5.0, 0.7)
    }

    /// A camera that flies `flown_m` while it looks down on the point, and a share of gross errors.
    fn sightings(count: usize, flown_m: f64, gross: f64, noise: f64, rng: &mut ChaCha8Rng) -> Vec<Sighting> {
        let one = |k: usize| {
            let share = k as f64 / (count - 1) as f64;
            let place = Vector3::new(flown_m * (share - 0.5), 0.05 * flown_m * share, 60.0);
            let turn = exp(&Vector3::new(std::f64::consts::PI, 0.1 * share, 0.2));
            let camera_from_body = Pose::from_parts(place.into(), turn).inverse();
            let seen = camera_from_body * point();
            let mut ray = seen.coords.xy() / seen.z;
            ray += Vector2::new(normal_number(rng), normal_number(rng)) * noise * SIGMA;
            if rng.random::<f64>() < gross {
                ray += Vector2::new(rng.random_range(-0.3..0.3), rng.random_range(-0.3..0.3));
            }
            Sighting { camera_from_body, ray, sigma: SIGMA }
        };
        (0..count).map(one).collect()
    }

    #[test]
    fn exact_rays_give_the_point_back() {
        let rng = &mut ChaCha8Rng::seed_from_u64(1);
        for count in [2, 3, 40] {
            let found = triangulate(&sightings(count, 30.0, 0.0, 0.0, rng), &[None; 3]).unwrap();
            assert!((found.point - point()).norm() < 1e-9, "{}", found.point);
        }
    }

    #[test]
    fn the_jacobian_is_that_of_its_differences() {
        let rng = &mut ChaCha8Rng::seed_from_u64(2);
        for sighting in sightings(5, 40.0, 0.5, 1.0, rng) {
            let (_, jacobian) = whitened(&sighting, &point()).unwrap();
            for axis in 0..3 {
                let at = |by: f64| whitened(&sighting, &(point() + Vector3::ith(axis, by))).unwrap().0;
                let slope = (at(1e-5) - at(-1e-5)) / 2e-5;
                assert!((slope - jacobian.column(axis)).norm() < 1e-6, "axis {axis}");
            }
        }
    }

    #[test]
    fn errors_are_what_the_covariance_says() {
        let rng = &mut ChaCha8Rng::seed_from_u64(3);
        let mut sum = 0.0;
        for _ in 0..300 {
            let found = triangulate(&sightings(30, 20.0, 0.0, 1.0, rng), &[None; 3]).unwrap();
            let gap = found.point - point();
            sum += gap.dot(&(found.covariance.try_inverse().unwrap() * gap));
        }
        // Chi squared with 3 degrees of freedom: the mean of 300 scatters by 0.14; Tukey costs 5 %.
        assert!((sum / 300.0 - 3.15).abs() < 0.5, "{}", sum / 300.0);
    }

    #[test]
    fn two_in_five_gross_errors_move_nothing() {
        let rng = &mut ChaCha8Rng::seed_from_u64(4);
        for count in [12, 60, 1800] {
            for _ in 0..20 {
                let all = sightings(count, 30.0, 0.37, 1.0, rng);
                let gross = all.iter().filter(|s| norm(s, &point()) > 8.0).count();
                if 2 * gross >= count {
                    continue;
                }
                let found = triangulate(&all, &[None; 3]).unwrap();
                let limit_m = 6.0 * found.covariance.symmetric_eigenvalues().max().sqrt();
                assert!((found.point - point()).norm() < limit_m, "{count}: {}", found.point);
                assert!(found.is_good.iter().filter(|good| !**good).count() >= gross);
            }
        }
    }

    #[test]
    fn consensus_outlives_two_gross_rays_in_three() {
        let rng = &mut ChaCha8Rng::seed_from_u64(8);
        let anywhere = |_: &Point3<f64>| true;
        for _ in 0..20 {
            let found =
                consensus(&sightings(120, 30.0, 0.65, 1.0, rng), &[None; 3], GROSS_SIGMAS, anywhere).unwrap();
            assert!((found - point()).norm() < 0.1, "{found}");
        }
        assert_eq!(consensus(&[], &[None; 3], GROSS_SIGMAS, anywhere), None);
    }

    #[test]
    fn poses_that_are_wrong_by_more_than_stated_are_no_gross_errors() {
        let rng = &mut ChaCha8Rng::seed_from_u64(5);
        let found = triangulate(&sightings(200, 30.0, 0.2, 25.0, rng), &[None; 3]).unwrap();
        assert!((20.0..32.0).contains(&found.spread), "{}", found.spread);
        assert!((found.point - point()).norm() < 1.0, "{}", found.point);
        assert!(found.is_good.iter().filter(|good| **good).count() > 150);
    }

    #[test]
    fn parallel_rays_have_no_depth_unless_something_is_known() {
        let rng = &mut ChaCha8Rng::seed_from_u64(6);
        let hovering = sightings(100, 0.05, 0.0, 1.0, rng);
        let still: Vec<Sighting> = hovering
            .iter()
            .map(|s| Sighting { camera_from_body: hovering[0].camera_from_body, ..*s })
            .collect();
        assert!(
            matches!(triangulate(&still, &[None; 3]), Err(NoPoint::Parallel { sigma_m }) if sigma_m > 1.0)
        );
        let outcome = triangulate(&hovering, &[None; 3]);
        assert!(outcome.is_err(), "{outcome:?}");
        let height = Some(Known { value_m: 0.7, sigma_m: 0.0 });
        let found = triangulate(&hovering, &[None, None, height]).unwrap();
        assert!((found.point - point()).norm() < 0.05, "{}", found.point);
    }

    #[test]
    fn rays_that_do_not_meet_in_front_are_refused() {
        let rng = &mut ChaCha8Rng::seed_from_u64(7);
        let one = sightings(2, 30.0, 0.0, 1.0, rng);
        assert_eq!(triangulate(&one[..1], &[None; 3]), Err(NoPoint::TooFew(1)));
        assert_eq!(triangulate(&[], &[None; 3]), Err(NoPoint::TooFew(0)));
        // Mirrored rays meet behind the cameras.
        let mut behind = sightings(20, 30.0, 0.0, 1.0, rng);
        for sighting in &mut behind {
            let about = Pose::rotation(Vector3::new(std::f64::consts::PI, 0.0, 0.0));
            sighting.camera_from_body = about * sighting.camera_from_body;
            sighting.ray.y = -sighting.ray.y;
            sighting.ray = -sighting.ray;
        }
        assert!(matches!(triangulate(&behind, &[None; 3]), Err(NoPoint::Contradictory { .. })));
        let mut scattered = sightings(30, 30.0, 1.0, 1.0, rng);
        scattered.iter_mut().for_each(|s| s.sigma = 1e-6);
        let outcome = triangulate(&scattered, &[None; 3]);
        assert!(outcome.as_ref().map_or(true, |found| found.spread > 100.0), "{outcome:?}");
    }
}
