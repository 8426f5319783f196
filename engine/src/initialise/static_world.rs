//! Tracks of what stands still: road, background, the shadow of a building.
//!
//! Over half a second to a second a static point may fit a point of a body within a few pixels, and tracks of many
//! such points bend the motion of the body to them. What tells them apart needs no truth: by the poses of the camera
//! alone the rays of a static point meet, at any height and at any depth, also at infinity where the camera is
//! still. In homogeneous coordinates `X = (D, w)`, with `camera_from_world = [A | b]` and a ray `(x, y)`,
//!
//! ```text
//! (x A3 - A1) D + (x b3 - b1) w = 0      (y A3 - A2) D + (y b3 - b2) w = 0
//! ```
//!
//! `X` is the one of the least median of residuals among those of pairs of rays (Rousseeuw 1984), then of least
//! squares without what is far from it.
//!
//! That the rays of a track meet so is no proof: those of a vehicle that stands do too. A track is static where in
//! its own frames others, as tracks of the vehicle are, fit no static point ([`static_tracks`]).

use super::shape::dlt::Sighting;
use crate::rules::rules;
use crate::stats::normal::median_of_norm_2;
use crate::stats::quantile::upper_median;
use nalgebra::allocator::Allocator;
use nalgebra::{
    DefaultAllocator, DimName, Matrix4, OVector, Point3, SymmetricEigen, UnitQuaternion, Vector2, Vector3,
    Vector4,
};
use rayon::prelude::*;

rules! {
    /// Tracks of what stands still.
    pub struct StaticWorldRules {
        /// Rays of a track that are looked at; of more an even choice is taken.
        most_rays: usize = 24, "rays";
        /// Pairs of rays of which a static point is tried.
        most_pairs: usize = 12, "pairs";
        /// Re-weightings of least squares.
        steps: usize = 4, "steps";
        /// Rays this many times farther off than the median do not count in it.
        trimmed_beyond: f64 = 3.0, "medians";
        /// Fewest image points of a track by which it is called static, and of another one in the same frames.
        least_points: usize = 4, "image points";
        /// A track that fits a static point stays within so many times what static points scatter ...
        most_scatter: f64 = 3.0, "factor";
        /// ... and others in its frames move that are so many times farther off ...
        moving_factor: f64 = 3.0, "factor";
        /// ... so many of them at least ...
        least_moving: usize = 3, "tracks";
        /// ... and so large a share.
        least_moving_share: f64 = 0.15, "share of the tracks in the same frames";
        /// Cameras nearer together stand in one place.
        still_camera_m: f64 = 1e-6, "m";
        /// Tracks in the same frames that are looked at; of more an even choice is taken.
        most_others: usize = 40, "tracks";
    }
}

/// A point counts as in front of a camera from here on, of a direction of length 1.
const LEAST_DEPTH: f64 = 1e-9;
const RULES: StaticWorldRules = StaticWorldRules::DEFAULT;

/// A track as rays in the world, each with its frame, in order of time.
pub type WorldTrack = Vec<(usize, Sighting)>;

/// How far the rays of a track are from the static point that fits them best: the median \[standard deviations of an
/// image point\]. `None` with fewer than two rays.
pub fn distance_from_static<'s>(sightings: impl Iterator<Item = &'s Sighting>) -> Option<f64> {
    let all: Vec<&Sighting> = sightings.collect();
    let stride = all.len().div_ceil(RULES.most_rays).max(1);
    let origin = Point3::from(all.get(all.len() / 2)?.camera_from_body.inverse().translation.vector);
    let rays: Vec<Ray> =
        all.into_iter().step_by(stride).map(|sighting| Ray::new(sighting, &origin)).collect();
    if rays.len() < 2 {
        return None;
    }
    // Of cameras that stand in one place all points of a ray are one.
    let baseline_m = rays.iter().map(|ray| ray.translation_m.norm()).fold(0.0, f64::max);
    let unit_m = (baseline_m > RULES.still_camera_m).then_some(baseline_m);
    let (pairs, half) = (RULES.most_pairs.min(rays.len() / 2), rays.len() / 2);
    let finite = (0..pairs).filter_map(|k| {
        let at = k * half / pairs;
        least_of([at, at + rays.len() - half].into_iter().map(|ray| (&rays[ray], 1.0)), unit_m)
    });
    let infinite = rays.iter().step_by(rays.len().div_ceil(RULES.most_pairs)).map(Ray::at_infinity);
    let judged = finite.chain(infinite).map(|point| (median_distance(&rays, &point), point));
    // Of several alike the first, so that the answer is always the same.
    let (mut median, mut point) = judged.reduce(|best, other| if other.0 < best.0 { other } else { best })?;
    for _ in 0..RULES.steps {
        let limit = RULES.trimmed_beyond * median;
        let near = rays.iter().filter_map(|ray| {
            let (norm, depth) = ray.distance(&point)?;
            // Rows are residuals times the depth.
            (norm <= limit).then_some((ray, 1.0 / depth))
        });
        let Some(next) = least_of(near, unit_m) else { break };
        let next_median = median_distance(&rays, &next);
        if next_median >= median {
            break;
        }
        (median, point) = (next_median, next);
    }
    median.is_finite().then_some(median)
}

/// A ray, its camera seen from an origin near to all of them.
struct Ray {
    camera_from_world: UnitQuaternion<f64>,
    translation_m: Vector3<f64>,
    ray: Vector2<f64>,
    sigma: f64,
}

impl Ray {
    fn new(sighting: &Sighting, origin: &Point3<f64>) -> Ray {
        let Sighting { camera_from_body: camera_from_world, ray, sigma } = *sighting;
        let translation_m = (camera_from_world * origin).coords;
        Ray { camera_from_world: camera_from_world.rotation, translation_m, ray, sigma }
    }

    /// The point at infinity on it.
    fn at_infinity(&self) -> Vector4<f64> {
        (self.camera_from_world.inverse() * self.ray.push(1.0).normalize()).push(0.0)
    }

    /// How far a point is from it \[standard deviations\], and its depth; `None` behind the camera.
    fn distance(&self, point: &Vector4<f64>) -> Option<(f64, f64)> {
        let seen = self.camera_from_world * point.xyz() + self.translation_m * point.w;
        (seen.z > LEAST_DEPTH).then(|| ((self.ray - seen.xy() / seen.z).norm() / self.sigma, seen.z))
    }

    fn rows(&self) -> [Vector4<f64>; 2] {
        let a = self.camera_from_world.to_rotation_matrix();
        let b = self.translation_m;
        [0, 1].map(|axis| {
            let by_direction = a.matrix().row(2) * self.ray[axis] - a.matrix().row(axis);
            by_direction.transpose().push(b.z * self.ray[axis] - b[axis]) / self.sigma
        })
    }
}

fn median_distance(rays: &[Ray], point: &Vector4<f64>) -> f64 {
    let norms = rays.iter().map(|ray| ray.distance(point).map_or(f64::INFINITY, |(norm, _)| norm));
    upper_median(norms.collect()).unwrap_or(f64::INFINITY)
}

/// The point of least squares of weighted rays, its last coordinate not below zero: beyond infinity there is nothing.
/// `unit_m` is the length in which that is well scaled; without one the point is at infinity.
fn least_of<'r>(rays: impl Iterator<Item = (&'r Ray, f64)>, unit_m: Option<f64>) -> Option<Vector4<f64>> {
    let (mut normal, mut facing, mut count) = (Matrix4::zeros(), Vector3::zeros(), 0);
    for (ray, weight) in rays {
        for row in ray.rows() {
            let scaled = row.xyz().push(row.w / unit_m.unwrap_or(1.0));
            normal += weight * weight * scaled * scaled.transpose();
        }
        facing += ray.at_infinity().xyz();
        count += 1;
    }
    if count == 0 {
        return None;
    }
    if let Some(unit_m) = unit_m.filter(|_| count > 1) {
        let point = least_vector(normal.symmetric_eigen());
        let point = if point.xyz().dot(&facing) < 0.0 { -point } else { point };
        if point.w >= 0.0 {
            return Some(point.xyz().push(point.w / unit_m));
        }
    }
    let direction = least_vector(normal.fixed_view::<3, 3>(0, 0).into_owned().symmetric_eigen());
    let direction = if direction.dot(&facing) < 0.0 { -direction } else { direction };
    Some(direction.push(0.0))
}

/// The eigenvector of the least eigenvalue.
fn least_vector<D: DimName>(eigen: SymmetricEigen<f64, D>) -> OVector<f64, D>
where
    DefaultAllocator: Allocator<D> + Allocator<D, D>,
{
    let least = eigen.eigenvalues.argmin().0;
    eigen.eigenvectors.column(least).into_owned()
}

/// Up to which median distance a track fits a static point, where rays to these scatter by `scatter` \[standard
/// deviations of an image point\].
pub fn static_limit(scatter: f64) -> f64 {
    RULES.most_scatter * scatter.max(1.0) * median_of_norm_2()
}

/// A track whose rays meet in a static point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Standing {
    /// How far they are from it \[standard deviations of an image point\].
    pub distance: f64,
    /// Whether what other tracks follow in its frames moves.
    pub others_move: bool,
}

/// Each track whose rays meet in a static point. `scatter` is what rays to static points scatter \[standard deviations
/// of an image point\]; frames ascend along a track.
pub fn static_tracks(tracks: &[WorldTrack], scatter: f64) -> Vec<Option<Standing>> {
    let distances: Vec<Option<f64>> = tracks
        .par_iter()
        .map(|track| {
            let rays = track.iter().map(|(_, sighting)| sighting);
            distance_from_static(rays).filter(|_| track.len() >= RULES.least_points)
        })
        .collect();
    let limit = static_limit(scatter);
    let standing = |at: usize| {
        let own = distances[at].filter(|distance| *distance <= limit)?;
        let moves = |rays: &[&Sighting]| {
            let away = distance_from_static(rays.iter().copied()).unwrap_or(0.0);
            away > RULES.moving_factor * own.max(median_of_norm_2())
        };
        let others = in_the_same_frames(tracks, at);
        let moving = others.iter().filter(|rays| moves(rays)).count();
        let needed = RULES.least_moving.max((RULES.least_moving_share * others.len() as f64).ceil() as usize);
        Some(Standing { distance: own, others_move: moving >= needed })
    };
    (0..tracks.len()).into_par_iter().map(standing).collect()
}

/// What other tracks have in the frames of a track: an even choice of those that have enough there.
fn in_the_same_frames(tracks: &[WorldTrack], at: usize) -> Vec<Vec<&Sighting>> {
    let own = &tracks[at];
    let (Some((first, _)), Some((last, _))) = (own.first(), own.last()) else { return Vec::new() };
    let within = |track: &WorldTrack| {
        let begin = track.partition_point(|(frame, _)| frame < first);
        let end = track.partition_point(|(frame, _)| frame <= last);
        begin..end
    };
    let long: Vec<usize> = (0..tracks.len())
        .filter(|other| *other != at && within(&tracks[*other]).len() >= RULES.least_points)
        .collect();
    let stride = long.len().div_ceil(RULES.most_others).max(1);
    let rays = |other: &usize| {
        let track = &tracks[*other];
        track[within(track)].iter().map(|(_, sighting)| sighting).collect()
    };
    long.iter().step_by(stride).map(rays).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Pose, rotation::exp};
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    const SIGMA: f64 = 1.0 / 1000.0;

    /// A camera 2 m above the ground that looks along y, moves by `moved_m` to the side and sways a little.
    fn camera_from_world(frame: usize, moved_m: f64) -> Pose {
        let share = frame as f64 / 60.0;
        let place = Vector3::new(moved_m * share, 0.0, 2.0);
        let turn =
            exp(&(Vector3::x() * -std::f64::consts::FRAC_PI_2)) * exp(&(Vector3::y() * (0.02 * share)));
        Pose::from_parts(place.into(), turn).inverse()
    }

    /// The rays to what is at `place` in each frame, with noise of one standard deviation; every so many-th is gross.
    fn track(
        frames: std::ops::Range<usize>,
        moved_m: f64,
        gross: f64,
        seed: u64,
        place: impl Fn(usize) -> Point3<f64>,
    ) -> WorldTrack {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut uniform = move || rng.random_range(-1.0..1.0) * 3_f64.sqrt() * SIGMA;
        let mut rays = Vec::new();
        for frame in frames {
            let camera_from_body = camera_from_world(frame, moved_m);
            let seen = camera_from_body * place(frame);
            assert!(seen.z > 0.0);
            let mut ray = seen.coords.xy() / seen.z + Vector2::new(uniform(), uniform());
            if (uniform() / SIGMA).abs() < gross * 3_f64.sqrt() {
                ray += Vector2::new(0.1, -0.2);
            }
            rays.push((frame, Sighting { camera_from_body, ray, sigma: SIGMA }));
        }
        rays
    }

    fn distance(track: &WorldTrack) -> f64 {
        distance_from_static(track.iter().map(|(_, ray)| ray)).unwrap()
    }

    /// A car at 2 m/s and 10 frames a second, some way off.
    fn driving(frame: usize) -> Point3<f64> {
        Point3::new(-5.0 + 0.2 * frame as f64, 12.0 + 0.05 * frame as f64, 0.8)
    }

    #[test]
    fn rays_to_what_stands_meet_wherever_it_is_and_however_the_camera_moves() {
        for moved_m in [0.0, 1e-9, 0.05, 4.0] {
            for (seed, place) in
                [[1.0, 12.0, 0.0], [-3.0, 8.0, 1.5], [400.0, 3000.0, 90.0]].into_iter().enumerate()
            {
                for gross in [0.0, 0.3] {
                    let found = track(5..25, moved_m, gross, seed as u64, |_| Point3::from(place));
                    // Where three in ten are gross, it is that of seven in ten of the others.
                    let most = if gross > 0.0 { 2.5 } else { 2.0 };
                    assert!(distance(&found) < most, "{moved_m} {place:?}: {}", distance(&found));
                }
            }
            let moving = distance(&track(5..25, moved_m, 0.0, 7, driving));
            assert!(moving > 50.0 || moved_m == 4.0, "{moved_m}: {moving}");
        }
        assert_eq!(distance_from_static([].iter()), None);
    }

    #[test]
    fn nothing_lies_behind_infinity() {
        // What moves ahead of a camera faster than this moves itself has its rays meet behind it.
        let ahead = track(0..20, 4.0, 0.0, 3, |frame| Point3::new(0.2 * frame as f64, 30.0, 1.0));
        assert!(distance(&ahead) > 10.0, "{}", distance(&ahead));
    }

    /// Tracks of 20 frames each of which the first so many stand around the way of a car.
    fn tracks(standing: usize, all: usize, driving: impl Fn(usize) -> Point3<f64>) -> Vec<WorldTrack> {
        let one = |at: usize| {
            let begin = 7 * at % 40;
            let aside = Vector3::new(0.3 * (at % 5) as f64, 0.2 * (at % 3) as f64, 0.1 * (at % 7) as f64);
            let place = |frame: usize| driving(if at < standing { 20 } else { frame }) + aside;
            track(begin..begin + 20, 0.5, 0.1, at as u64, place)
        };
        (0..all).map(one).collect()
    }

    fn stands(found: &[Option<Standing>]) -> Vec<bool> {
        found.iter().map(|found| found.is_some_and(|standing| standing.others_move)).collect()
    }

    #[test]
    fn what_stands_is_told_from_what_drives_also_where_it_is_more() {
        for standing in [0, 2, 20, 30] {
            let found = static_tracks(&tracks(standing, 50, driving), 1.0);
            let wanted: Vec<bool> = (0..50).map(|at| at < standing).collect();
            assert_eq!(stands(&found), wanted, "{standing} of 50 stand");
        }
    }

    #[test]
    fn a_vehicle_that_stands_has_no_static_tracks() {
        let found = static_tracks(&tracks(10, 50, |_| driving(20)), 1.0);
        assert!(!stands(&found).contains(&true));
        // Two tracks that move are not the vehicle.
        let found = static_tracks(&tracks(48, 50, driving), 1.0);
        assert!(!stands(&found).contains(&true));
        assert!(static_tracks(&[], 1.0).is_empty());
    }
}
