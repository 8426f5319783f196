//! Where in a pattern the body's origin lies, and which way it looks.
//!
//! A car's rear axle moves along the body's x axis. With the motion of the pattern's middle seen from
//! the pattern, `v`, over a step in which it turns by `w`, there are a direction `e`, the normal `n` to its
//! left, and a place `l` of the axle on it for which
//!
//! ```text
//! n . v + l w = 0
//! ```
//!
//! in all steps. Both are found by re-weighted least squares; `l` is drawn to where cars have their
//! axle, because in a steady turn the two cannot be told apart.
//!
//! The sign of `e` is that of the larger distance travelled, unless the axle that the turns show lies ahead of the
//! middle, where no car has it. Of the two signs, driving backwards the distance `d` has the odds `p exp(-d / d0)`
//! against driving forwards, and an axle at `l +- s` where it is expected at `a +- b` the likelihood of a normal
//! number: the odds of the two are times `exp(2 l a / (s^2 + b^2))`. A body that hardly moves has the long axis of
//! its pattern, whose sign is a guess.

use super::plane_adjustment::Pattern;
use super::plane_motion::PlanePose;
use crate::geometry::{Pose, heading_rad};
use crate::problem::{ShapePoint, Vehicle};
use crate::rules::rules;
use crate::stats::normal::MEDIAN_OF_SIZE;
use crate::stats::quantile::upper_median;
use crate::stats::series::inflation;
use nalgebra::{Matrix2, Point3, Rotation2, SymmetricEigen, Vector2};

rules! {
    /// Axes of a body from how it drives.
    pub struct BodyAxesRules {
        /// Bounds of the length of the steps from which a direction is taken ...
        step_m: [f64; 2] = [0.5, 2.0], "m";
        /// ... and how many are wanted.
        wanted_steps: f64 = 20.0, "steps";
        /// A path that scatters more is averaged ...
        averaged_above_m: f64 = 0.05, "m";
        /// ... over so many frames to either side at the most.
        most_averaged_frames: usize = 10, "frames";
        /// A part that travels less has no direction of travel.
        least_travel_m: f64 = 1.0, "m";
        /// How far the rear axle is behind the middle of the shape.
        axle_behind_middle: f64 = 0.3, "share of the length";
        /// Its standard deviation: the constant part, and the part that grows with its distance. A body may as
        /// well turn about its middle ...
        axle_sigma_m: [f64; 2] = [0.2, 0.8], "m, share";
        /// ... but a car does not; of its shape perhaps one end was seen better.
        car_axle_sigma_m: [f64; 2] = [0.3, 0.25], "m, share";
        /// Odds of driving backwards at all ...
        reversing_odds: f64 = 0.05, "odds";
        /// ... and the distance by which they shrink to a third.
        reversing_m: f64 = 10.0, "m";
        /// A body does not quite point where it rolls: its wheels are not quite straight, the road is not quite level.
        crab_deg: f64 = 0.5, "deg";
        /// The widest turn in one step.
        widest_turn_rad: f64 = 0.7, "rad";
    }
}

const RULES: BodyAxesRules = BodyAxesRules::DEFAULT;

/// How the heading of a part was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Heading {
    /// From the direction of travel.
    Travel,
    /// From the long axis of the pattern, its sign from the part of the motion before or after it.
    LongAxis,
    /// From the long axis alone: it may be half a turn wrong.
    Guess,
    /// From points whose plane coordinates are known.
    Known,
}

/// Places the body in the pattern of each part: `pattern_from_body`, and how it was found. `None` for a
/// part without points that agree.
pub fn place_body(pattern: &Pattern, vehicle: &Vehicle) -> Vec<Option<(PlanePose, Heading)>> {
    let mut found: Vec<Option<(PlanePose, Heading)>> =
        (0..pattern.parts()).map(|part| of_part(pattern, part, &vehicle.points, vehicle.is_car)).collect();
    settle_signs(pattern, &mut found);
    found
}

fn of_part(
    pattern: &Pattern,
    part: usize,
    points: &[ShapePoint],
    is_car: bool,
) -> Option<(PlanePose, Heading)> {
    let good: Vec<(usize, Vector2<f64>)> = good_points(pattern, part, points.len());
    if good.is_empty() {
        return None;
    }
    if let Some(known) = from_known(&good, points) {
        return Some((known, Heading::Known));
    }
    let (angle, how) = match direction_of_travel(pattern, part, &good, is_car) {
        Some(travel) => (travel.angle_rad, Heading::Travel),
        None => (long_axis(&good), Heading::Guess),
    };
    let turned: Vec<Vector2<f64>> = good.iter().map(|(_, m)| Rotation2::new(-angle) * m).collect();
    let middle = |axis: usize| {
        let mut values: Vec<f64> = turned.iter().map(|m| m[axis]).collect();
        values.sort_by(f64::total_cmp);
        let cut = values.len() / 20;
        let middle = (values[cut] + values[values.len() - 1 - cut]) / 2.0;
        // A coordinate that is known says where the origin is.
        let known = good.iter().zip(&turned).filter_map(|((point, _), m)| {
            points[*point].known[axis].map(|known| (m[axis] - known.value_m, known.sigma_m))
        });
        known.min_by(|a, b| a.1.total_cmp(&b.1)).map_or(middle, |(origin, _)| origin)
    };
    let origin = Vector2::new(middle(0), middle(1));
    Some((PlanePose { place_m: Rotation2::new(angle) * origin, heading_rad: angle }, how))
}

/// Points most of whose sightings agree, those seen often first of all.
fn good_points(pattern: &Pattern, part: usize, points: usize) -> Vec<(usize, Vector2<f64>)> {
    let all: Vec<(usize, Vector2<f64>, [usize; 2])> = (0..points)
        .filter_map(|point| {
            let (at, sightings) = pattern.point(part, point)?;
            Some((point, at.xy(), sightings))
        })
        .collect();
    let mut counts: Vec<usize> = all.iter().map(|(_, _, s)| s[1]).collect();
    counts.sort_unstable();
    let enough = counts.get(counts.len() / 2).map_or(1, |count| (count / 4).max(1));
    let good = all.iter().filter(|(_, _, [seen, agree])| *agree >= enough && 2 * agree >= *seen);
    good.map(|(point, at, _)| (*point, *at)).collect()
}

fn from_known(good: &[(usize, Vector2<f64>)], points: &[ShapePoint]) -> Option<PlanePose> {
    let pairs: Vec<(Vector2<f64>, Vector2<f64>)> = good
        .iter()
        .filter_map(|(point, at)| {
            let [x, y, _] = points[*point].known;
            Some((Vector2::new(x?.value_m, y?.value_m), *at))
        })
        .collect();
    let count = pairs.len() as f64;
    let body = pairs.iter().map(|p| p.0).sum::<Vector2<f64>>() / count;
    let at = pairs.iter().map(|p| p.1).sum::<Vector2<f64>>() / count;
    let (mut sine, mut cosine, mut extent) = (0.0, 0.0, 0.0);
    for (from, to) in &pairs {
        let (from, to) = (from - body, to - at);
        sine += from.perp(&to);
        cosine += from.dot(&to);
        extent += from.norm_squared();
    }
    if pairs.len() < 2 || extent < 0.25 {
        return None;
    }
    let heading_rad = sine.atan2(cosine);
    Some(PlanePose { place_m: at - Rotation2::new(heading_rad) * body, heading_rad })
}

/// The direction in which a body drives, in its frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Travel {
    /// The direction, counter-clockwise from the x axis \[rad\].
    pub angle_rad: f64,
    /// Its standard deviation \[rad\].
    pub sigma_rad: f64,
    /// The probability that it drives the other way, and the direction is half a turn wrong.
    pub turned: f64,
}

/// The direction of travel in the pattern.
fn direction_of_travel(
    pattern: &Pattern,
    part: usize,
    good: &[(usize, Vector2<f64>)],
    is_car: bool,
) -> Option<Travel> {
    // The middle of the pattern, not its origin, which may lie far off.
    let center = pattern_center(pattern, part);
    let frames = (0..pattern.poses.len()).filter(|frame| pattern.part[*frame] == part);
    let points: Vec<Vector2<f64>> = good.iter().map(|(_, at)| *at).collect();
    direction_along(frames.filter_map(|frame| pattern.poses[frame]), &center, &points, is_car)
}

/// The direction of a body's path of travel in the body: zero where its x axis points where it
/// drives, as seen from its rear axle. `None` where it hardly moves. `points` are those of its shape; of a car it is known
/// that its rear axle is in the rear.
pub fn heading_of_travel(poses: &[Option<Pose>], points: &[Point3<f64>], is_car: bool) -> Option<Travel> {
    let plane =
        |pose: &Pose| PlanePose { place_m: pose.translation.vector.xy(), heading_rad: heading_rad(pose) };
    let points: Vec<Vector2<f64>> = points.iter().map(|p| p.coords.xy()).collect();
    direction_along(poses.iter().flatten().map(plane), &median_place(&points), &points, is_car)
}

fn direction_along(
    poses: impl Iterator<Item = PlanePose>,
    center: &Vector2<f64>,
    good: &[Vector2<f64>],
    is_car: bool,
) -> Option<Travel> {
    let steps = Steps::of(poses, center)?;
    let forward = nearest_direction(&steps.steps);
    let extent = |angle: f64| {
        let along = Rotation2::new(-angle);
        let mut values: Vec<f64> = good.iter().map(|m| (along * m).x).collect();
        values.sort_by(f64::total_cmp);
        let cut = values.len() / 20;
        values[values.len() - 1 - cut] - values[cut]
    };
    let expected_m = -RULES.axle_behind_middle * extent(forward);
    let about = |[constant, share]: [f64; 2]| constant + share * expected_m.abs();
    let (sigma_m, of_kind) =
        (about(RULES.axle_sigma_m), about(if is_car { RULES.car_axle_sigma_m } else { RULES.axle_sigma_m }));
    let found = steps.rolling(forward, expected_m, sigma_m)?;
    let turned = steps.probability_of_reverse(&found, expected_m, of_kind);
    // Whichever way it looks, its axle is expected behind its middle.
    let way = if turned > 0.5 { found.angle_rad + std::f64::consts::PI } else { found.angle_rad };
    let Rolling { angle_rad, sigma_rad, .. } = steps.rolling(way, expected_m, of_kind)?;
    Some(Travel { angle_rad, sigma_rad, turned: turned.min(1.0 - turned) })
}

/// The motion of the middle of a body in steps.
struct Steps {
    /// By how much it moves, seen from the body halfway \[m\], and by how much it turns \[rad\].
    steps: Vec<(Vector2<f64>, f64)>,
    /// Their least length \[m\].
    least_m: f64,
    /// Scatter of the heading from frame to frame \[rad\].
    turn_noise_rad: f64,
}

/// Where a body rolls along its axis.
struct Rolling {
    angle_rad: f64,
    sigma_rad: f64,
    /// Where the turns alone have the axle \[m\], and its variance; `None` where they do not tell.
    axle_m: Option<(f64, f64)>,
}

impl Steps {
    fn of(poses: impl Iterator<Item = PlanePose>, center: &Vector2<f64>) -> Option<Steps> {
        let mut path: Vec<PlanePose> = Vec::new();
        for pose in poses {
            let before = path.last().map_or(pose.heading_rad, |last| last.heading_rad);
            let turns = ((pose.heading_rad - before) / std::f64::consts::TAU).round();
            let heading_rad = pose.heading_rad - turns * std::f64::consts::TAU;
            path.push(PlanePose { place_m: pose.place(center), heading_rad });
        }
        let (path, noise_m) = calmed(&path);
        let length_m: f64 = path.windows(2).map(|p| (p[1].place_m - p[0].place_m).norm()).sum();
        let bounds = RULES.step_m;
        let least_m = (length_m / RULES.wanted_steps).clamp(bounds[0], bounds[1]).max(10.0 * noise_m);
        let turn_noise_rad = scatter(path.iter().map(|p| p.heading_rad));
        let mut steps: Vec<(Vector2<f64>, f64)> = Vec::new();
        let mut from = *path.first()?;
        for pose in path {
            let moved = pose.place_m - from.place_m;
            let turn = pose.heading_rad - from.heading_rad;
            if turn.abs() > RULES.widest_turn_rad {
                from = pose;
            } else if moved.norm() >= least_m {
                let middle = Rotation2::new(-(from.heading_rad + turn / 2.0));
                steps.push((middle * moved, turn));
                from = pose;
            }
        }
        let travelled: f64 = steps.iter().map(|(v, _)| v.norm()).sum();
        let is_enough = travelled >= RULES.least_travel_m && steps.len() >= 2;
        is_enough.then_some(Steps { steps, least_m, turn_noise_rad })
    }

    /// The direction near `angle` in which it rolls, with an axle that is expected somewhere.
    fn rolling(&self, angle: f64, expected_m: f64, sigma_m: f64) -> Option<Rolling> {
        let (mut angle_rad, mut axle_m, mut sigma_rad) = (angle, expected_m, 0.0);
        let mut alone = None;
        for _ in 0..10 {
            let (sine, cosine) = angle_rad.sin_cos();
            let (along, left) = (Vector2::new(cosine, sine), Vector2::new(-sine, cosine));
            let off: Vec<f64> = self.steps.iter().map(|(v, w)| left.dot(v) + axle_m * w).collect();
            let size = upper_median(off.iter().map(|o| o.abs()).collect())?;
            let scale = (1.5 * size).max(0.02 * self.least_m);
            // Noise of the turns would draw the axle to the middle; it is outweighed.
            let noise = 8.0 * self.steps.len() as f64 * self.turn_noise_rad.powi(2);
            let tie = (scale / sigma_m).powi(2) + noise;
            let mut normal = Matrix2::new(1e-9, 0.0, 0.0, 0.0);
            let mut right = Vector2::zeros();
            for ((v, w), off) in self.steps.iter().zip(&off) {
                let weight = 1.0 / (1.0 + (off / (2.0 * scale)).powi(2));
                let row = Vector2::new(-along.dot(v), *w);
                normal += weight * row * row.transpose();
                right -= weight * off * row;
            }
            alone = normal.try_inverse().map(|inverse| {
                let variance = scale.powi(2) * inverse[(1, 1)];
                (axle_m + (inverse * right).y, variance)
            });
            // Where turns are mostly noise they do not tell.
            alone = alone
                .filter(|(axle, variance)| axle.is_finite() && normal[(1, 1)] > noise && *variance > 0.0);
            normal[(1, 1)] += tie;
            right.y += tie * (expected_m - axle_m);
            let inverse = normal.try_inverse()?;
            let step = inverse * right;
            // What a step is off by is alike that of the step before.
            let alike = inflation(&off);
            sigma_rad =
                (scale * (alike * inverse[(0, 0)].max(0.0)).sqrt()).hypot(RULES.crab_deg.to_radians());
            angle_rad += step.x.clamp(-0.3, 0.3);
            axle_m += step.y;
        }
        Some(Rolling { angle_rad, sigma_rad, axle_m: alone })
    }

    /// The probability that the body looks the other way than it was found to.
    fn probability_of_reverse(&self, found: &Rolling, expected_m: f64, sigma_m: f64) -> f64 {
        let along = Vector2::new(found.angle_rad.cos(), found.angle_rad.sin());
        let backwards = |sign: f64| -> f64 {
            let distance_m: f64 = self.steps.iter().map(|(v, _)| (-sign * along.dot(v)).max(0.0)).sum();
            let at_all = if distance_m < RULES.least_travel_m { 0.0 } else { RULES.reversing_odds.ln() };
            at_all - distance_m / RULES.reversing_m
        };
        let by_axle = found
            .axle_m
            .map_or(0.0, |(axle_m, variance)| -2.0 * axle_m * expected_m / (variance + sigma_m.powi(2)));
        let log_odds = backwards(-1.0) - backwards(1.0) + by_axle;
        1.0 / (1.0 + (-log_odds).exp())
    }
}

/// The direction in which most of the distance was travelled, turns left out of account \[rad\].
fn nearest_direction(steps: &[(Vector2<f64>, f64)]) -> f64 {
    // Lengths of vectors of twice the angle, which a reversal does not change, show the line.
    let double: Vector2<f64> =
        steps.iter().map(|(v, _)| Vector2::new(v.x * v.x - v.y * v.y, 2.0 * v.x * v.y) / v.norm()).sum();
    let angle = double.y.atan2(double.x) / 2.0;
    let along = Vector2::new(angle.cos(), angle.sin());
    let travel: f64 = steps.iter().map(|(v, _)| along.dot(v)).sum();
    if travel < 0.0 { angle + std::f64::consts::PI } else { angle }
}

/// Scatter of a sequence from frame to frame, in its unit: of its second differences.
pub fn scatter(values: impl IntoIterator<Item = f64>) -> f64 {
    let values: Vec<f64> = values.into_iter().collect();
    let bends = values.windows(3).map(|v| (v[0] - 2.0 * v[1] + v[2]).abs()).collect();
    // A bend has the variance 6.
    upper_median(bends).map_or(0.0, |bend| bend / (6_f64.sqrt() * MEDIAN_OF_SIZE))
}

/// A path without single outliers (medians of five) and, as far as its scatter asks for it, averaged;
/// and what it still scatters \[m\].
fn calmed(path: &[PlanePose]) -> (Vec<PlanePose>, f64) {
    let around = |path: &[PlanePose], at: usize, reach: usize, of: fn(Vec<f64>) -> f64| {
        let reach = reach.min(at).min(path.len() - 1 - at);
        let window = &path[at - reach..=at + reach];
        let of = |value: fn(&PlanePose) -> f64| of(window.iter().map(value).collect());
        let place_m = Vector2::new(of(|p| p.place_m.x), of(|p| p.place_m.y));
        PlanePose { place_m, heading_rad: of(|p| p.heading_rad) }
    };
    let median: fn(Vec<f64>) -> f64 = |values| upper_median(values).unwrap_or(0.0);
    let mean: fn(Vec<f64>) -> f64 = |values| values.iter().sum::<f64>() / values.len() as f64;
    let [x, y] = [0, 1].map(|axis| scatter(path.iter().map(|p| p.place_m[axis])));
    let noise_m = x.max(y);
    let medians: Vec<PlanePose> = (0..path.len()).map(|at| around(path, at, 2, median)).collect();
    let reach =
        ((noise_m / RULES.averaged_above_m).powi(2) / 2.0).min(RULES.most_averaged_frames as f64) as usize;
    let reach = reach.min(path.len() / 8);
    let calm = (reach..path.len() - reach).map(|at| around(&medians, at, reach, mean)).collect();
    (calm, noise_m / ((2 * reach + 1) as f64).sqrt())
}

fn pattern_center(pattern: &Pattern, part: usize) -> Vector2<f64> {
    let mut places: Vec<Vector2<f64>> = Vec::new();
    for point in 0..pattern.points() {
        if let Some((at, [seen, agree])) = pattern.point(part, point)
            && agree > 0
            && 2 * agree >= seen
        {
            places.push(at.xy());
        }
    }
    median_place(&places)
}

fn median_place(places: &[Vector2<f64>]) -> Vector2<f64> {
    let median = |axis: usize| upper_median(places.iter().map(|p| p[axis]).collect()).unwrap_or(0.0);
    Vector2::new(median(0), median(1))
}

fn long_axis(good: &[(usize, Vector2<f64>)]) -> f64 {
    let mean = good.iter().map(|(_, m)| m).sum::<Vector2<f64>>() / good.len() as f64;
    let scatter: Matrix2<f64> = good.iter().map(|(_, m)| (m - mean) * (m - mean).transpose()).sum();
    let eigen = SymmetricEigen::new(scatter);
    let larger = if eigen.eigenvalues[0] > eigen.eigenvalues[1] { 0 } else { 1 };
    let axis = eigen.eigenvectors.column(larger);
    axis.y.atan2(axis.x)
}

/// Gives the long axes the sign that fits the heading of the nearest part that has one.
fn settle_signs(pattern: &Pattern, found: &mut [Option<(PlanePose, Heading)>]) {
    let heading =
        |frame: usize, body: &PlanePose| pattern.poses[frame].map(|pose| pose.after(body).heading_rad);
    for part in 0..found.len() {
        let Some((body, Heading::Guess)) = found[part] else { continue };
        let own: Vec<usize> = (0..pattern.poses.len())
            .filter(|frame| pattern.part[*frame] == part && pattern.poses[*frame].is_some())
            .collect();
        let nearest = (0..pattern.poses.len()).filter_map(|frame| {
            let (body, how) = found[pattern.part[frame]].filter(|_| pattern.poses[frame].is_some())?;
            if how == Heading::Guess || pattern.part[frame] == part {
                return None;
            }
            let own = own.iter().copied().min_by_key(|own| own.abs_diff(frame))?;
            Some((own.abs_diff(frame), own, heading(frame, &body)?))
        });
        let Some((_, frame, wanted)) = nearest.min_by_key(|(gap, _, _)| *gap) else { continue };
        let Some(own) = heading(frame, &body) else { continue };
        let mut body = body;
        if (wanted - own).cos() < 0.0 {
            body.heading_rad += std::f64::consts::PI;
        }
        found[part] = Some((body, Heading::LongAxis));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_scatter_is_that_of_the_noise_and_not_of_the_path() {
        let noise = |at: usize| ((12.9898 * at as f64).sin() * 43_758.545_3).rem_euclid(1.0) - 0.5;
        let found = scatter((0..3000).map(|at| 0.2 * at as f64 + 1e-5 * (at * at) as f64 + noise(at)));
        // Uniform noise has the standard deviation 1 / sqrt(12).
        assert!((found * 12_f64.sqrt() - 1.0).abs() < 0.15, "{found}");
        assert_eq!(scatter([1.0, 2.0]), 0.0);
        assert!(scatter((0..100).map(|at| 0.3 * f64::from(at))) < 1e-12);
    }

    /// A car that drives out of one bend of 10 m into another by steps of 0.2 m, its rear axle 1.3 m behind its middle:
    /// poses of the middle, forwards or backwards.
    fn bends(sign: f64) -> Vec<Option<Pose>> {
        let (mut place, mut heading) = (Vector2::zeros(), 0.4_f64);
        let mut poses = Vec::new();
        for at in 0..60 {
            heading += sign * 0.2 / 10.0 * (f64::from(at) / 30.0 - 1.0);
            place += sign * 0.2 * Vector2::new(heading.cos(), heading.sin());
            let middle = place + 1.3 * Vector2::new(heading.cos(), heading.sin());
            let [w, z] = [(heading / 2.0).cos(), (heading / 2.0).sin()];
            poses.push(Some(crate::geometry::pose([middle.x, middle.y, 0.0], [w, 0.0, 0.0, z])));
        }
        poses
    }

    fn body() -> Vec<Point3<f64>> {
        let corner =
            |at: i32| Point3::new(2.1 * f64::from(at) / 20.0, if at % 2 == 0 { 0.9 } else { -0.9 }, 0.5);
        (-20..=20).map(corner).collect()
    }

    #[test]
    fn a_car_that_reverses_through_a_bend_looks_the_way_that_its_axle_says() {
        let found = heading_of_travel(&bends(-1.0), &body(), true).unwrap();
        assert!(found.angle_rad.cos() > 0.999 && found.turned < 0.05, "{found:?}");
        // Of a body that may turn about its middle the path decides, and that it may be wrong is said.
        let found = heading_of_travel(&bends(-1.0), &body(), false).unwrap();
        assert!(found.angle_rad.cos() < -0.99 && found.turned > 0.05, "{found:?}");
        let found = heading_of_travel(&bends(1.0), &body(), false).unwrap();
        assert!(found.angle_rad.cos() > 0.99 && found.turned < 0.01, "{found:?}");
    }

    #[test]
    fn forth_and_back_on_a_straight_line_is_a_guess() {
        let straight = |at: i32| {
            let x = if at < 24 { 0.1 * f64::from(at) } else { 2.4 - 0.1 * f64::from(at - 24) };
            Some(crate::geometry::pose([x, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]))
        };
        let poses: Vec<Option<Pose>> = (0..74).map(straight).collect();
        let found = heading_of_travel(&poses, &body(), true).unwrap();
        assert!(found.turned > 0.3, "{found:?}");
        // Long one way and never back it is none.
        let poses: Vec<Option<Pose>> = (0..300)
            .map(|at| Some(crate::geometry::pose([0.1 * f64::from(at), 0.0, 0.0], [1.0, 0.0, 0.0, 0.0])))
            .collect();
        let found = heading_of_travel(&poses, &body(), false).unwrap();
        assert!(found.turned < 0.01 && found.angle_rad.abs() < 1e-6, "{found:?}");
    }

    #[test]
    fn the_direction_is_that_of_the_larger_distance() {
        let step = |angle: f64, length: f64| (length * Vector2::new(angle.cos(), angle.sin()), 0.0);
        for angle in [0.3_f64, 1.7, -2.9] {
            let steps = [step(angle + 0.02, 3.0), step(angle - 0.02, 3.0), step(angle, -2.0)];
            assert!((nearest_direction(&steps) - angle).sin().abs() < 0.02);
            assert!((nearest_direction(&steps) - angle).cos() > 0.0);
        }
    }
}
