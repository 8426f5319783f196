//! Tracks that are not of the body, and of what they are.
//!
//! * **static**: a point of the road, of the background, of the shadow of a building. Its rays meet in a static point
//!   much better than in a point of the body, while the body moves (`initialise/static_world.rs`);
//! * **sliding**: a highlight or a reflection that moves over the paint. It fits the camera perfectly and agrees with
//!   other ones, but fits no point of the body as well as others do, and its residuals change slowly;
//! * **swapped**: it goes over from one point of the body to another at some moment;
//! * **foreign**: a point of another vehicle, or of the carrier of the camera, which stays where it is in the image
//!   while the camera moves; whatever moves steadily and otherwise than the body.
//!
//! Static and sliding tracks bend a motion to themselves and then fit within the limit of gross errors. So they are
//! looked for beside these ([`against_the_body`]); of what a track is that was found gross as a whole is said by
//! [`kind_of`].

use super::verdicts::RejectionReason;
use crate::estimate::Estimate;
use crate::initialise::shape::dlt::Sighting;
use crate::initialise::static_world::{
    Standing, WorldTrack, distance_from_static, static_limit, static_tracks,
};
use crate::initialise::{BODY_MIDDLE_M, point_from_poses, sighting, world_sighting};
use crate::problem::Problem;
use crate::rules::rules;
use crate::stats::normal::median_of_norm_2;
use crate::stats::quantile::{upper_median, value_at_share};
use nalgebra::{Point3, Vector2, Vector3};

rules! {
    /// Tracks that are not of the body.
    pub struct WrongTrackRules {
        /// Fewest image points of a track that is judged by how it fits.
        least_points: usize = 6, "image points";
        /// A track whose image points are off by more, in the median, may be static ...
        doubtful_factor: f64 = 1.5, "median of good image points";
        /// ... if it fits a static point so much better: at the first estimate, and at poses that were adjusted.
        static_share: [f64; 2] = [0.5, 0.7], "share of the distance from the body";
        /// So many of the tracks of a vehicle are of its body, at the least.
        of_body_share: f64 = 0.25, "share of tracks";
        /// A body point moves that is so many times farther from static than the track.
        moving_factor: f64 = 3.0, "factor";
        /// Where the points of a body are is told by so many that are nearest together along an axis ...
        core_share: f64 = 0.4, "share of points";
        /// ... of so many at the least.
        least_core: usize = 10, "points";
        /// A point is not of it that fits a static point and is this far from there ...
        beside_m: f64 = 1.0, "m";
        /// ... and as much farther as so many times their extent.
        beside_extents: f64 = 1.5, "extents";
        /// Starting positions of vehicles that nobody says it of are wrong by so much, ...
        wrong_starts_m: f64 = 0.5, "m";
        /// ... others by what is stated, and by this at the least.
        least_wrong_starts_m: f64 = 0.1, "m";
        /// This share of the image points of a track says how well it fits.
        fitting_share: f64 = 0.7, "share of image points";
        /// A sliding track fits so many times worse than the median track ...
        sliding_factor: f64 = 2.0, "factor";
        /// One that was left out comes back below this part of that limit, so that none goes in and out.
        return_share: f64 = 0.75, "share of the limit";
        /// ... and worse than this ...
        sliding_sigmas: f64 = 2.0, "standard deviations of an image point";
        /// ... and its residuals change from one frame to the next by less; those of white noise do by 2.
        sliding_change: f64 = 1.0, "von Neumann's ratio";
        /// What slides goes no farther over the body.
        most_slide_m: f64 = 1.0, "m";
        /// So many of the image points of a track, or of its part, fit what it is said to be of.
        least_fitting_share: f64 = 0.75, "share of image points";
        /// Fewest image points of either part of a swapped track.
        least_part: usize = 4, "image points";
        /// It goes over at once: so far it is with its next image points.
        least_jump: f64 = 0.6, "share of the median distance of its other part";
        /// Residuals that change by less from one to the next are of one cause.
        one_cause_change: f64 = 0.5, "share of their length";
    }
}

const RULES: WrongTrackRules = WrongTrackRules::DEFAULT;

/// Residuals of the image points of a vehicle in standard deviations, where they have one.
pub type Whitened<'a> = &'a [Option<Vector2<f64>>];

/// What tracks are held against.
#[derive(Clone, Copy)]
pub struct Judge<'a> {
    /// What was observed.
    pub problem: &'a Problem,
    /// Poses and shapes.
    pub estimate: &'a Estimate,
    /// An image point beyond is gross \[standard deviations\].
    pub limit: f64,
    /// What good image points of vehicles scatter.
    pub spread: f64,
    /// What image points of static points scatter, by the camera poses of the estimate.
    pub static_scatter: f64,
}

/// For each point of a vehicle whether the first estimate says that its track is static, or stays in the image: it
/// fits a static point, and the body much worse, while in its frames others fit none, or the starting poses move by
/// more than they scatter. These may be far off, but they are off for all points of a frame.
pub fn suspected_static(
    judge: &Judge<'_>,
    vehicle: usize,
    tracks: &[Vec<usize>],
    whitened: Whitened<'_>,
) -> Vec<Option<RejectionReason>> {
    let observations = &judge.problem.vehicles[vehicle].observations;
    let ray = |at: &usize| {
        let o = &observations[*at];
        Some((o.frame, world_sighting(judge.problem, &judge.estimate.camera_poses, o)?))
    };
    let rays: Vec<WorldTrack> = tracks.iter().map(|track| track.iter().filter_map(ray).collect()).collect();
    // What starting poses scatter, by tracks of the body, which may be the fewer: their motion says something beyond that.
    let from_body: Vec<Option<f64>> = tracks.iter().map(|track| median_length(track, whitened)).collect();
    let scatter =
        value_at_share(from_body.iter().flatten().copied().collect(), RULES.of_body_share).unwrap_or(0.0);
    let places = &judge.estimate.vehicles[vehicle].points;
    let of_body: Vec<Point3<f64>> = places.iter().flatten().copied().collect();
    let beside = beside_most(places, &of_body);
    let standing = static_tracks(&rays, judge.static_scatter);
    let what = |(point, track): (usize, &Vec<usize>)| {
        let Standing { distance, others_move } = standing[point]?;
        let is_nearer = from_body[point].is_some_and(|body| distance < RULES.static_share[0] * body);
        let is_static = (is_nearer || beside[point])
            && (others_move
                || moves(judge, vehicle, track, distance.max(scatter))
                || goes_on(judge, vehicle, track));
        is_static.then(|| what_stands(judge, vehicle, track))
    };
    tracks.iter().enumerate().map(what).collect()
}

/// For each point of a vehicle, what its track proves to be of by how it fits: static or sliding. `tracks` are the
/// indices of its image points in order of time, `before` says as what they were left out.
pub fn against_the_body(
    judge: &Judge<'_>,
    vehicle: usize,
    tracks: &[Vec<usize>],
    whitened: Whitened<'_>,
    before: &[Option<RejectionReason>],
) -> Vec<Option<RejectionReason>> {
    let is_out: Vec<bool> = before.iter().map(Option::is_some).collect();
    let sliding = sliding_tracks(judge, vehicle, tracks, whitened, &is_out);
    let beside = beside_the_body(judge, vehicle, tracks, &is_out);
    let one = |(point, track): (usize, &Vec<usize>)| {
        if is_static(judge, vehicle, track, whitened, (before[point], beside[point])) {
            Some(what_stands(judge, vehicle, track))
        } else {
            sliding[point].then_some(RejectionReason::Sliding)
        }
    };
    tracks.iter().enumerate().map(one).collect()
}

/// Of what a track is that fits a static point: what stays in the image of a camera that moves straight on is as a
/// point at infinity.
fn what_stands(judge: &Judge<'_>, vehicle: usize, track: &[usize]) -> RejectionReason {
    match stays_in_the_image(judge, vehicle, track) {
        true => RejectionReason::Foreign,
        false => RejectionReason::Static,
    }
}

/// Median length of the residuals of a track; infinite behind the camera.
fn median_length(track: &[usize], whitened: Whitened<'_>) -> Option<f64> {
    upper_median(track.iter().map(|at| whitened[*at].map_or(f64::INFINITY, |w| w.norm())).collect())
}

/// For each point whether its place by the poses is far from those of the others. Motions exist that carry a point of
/// the body along with one of the background, metres beside it: a few that fit there turn the whole motion.
fn beside_the_body(judge: &Judge<'_>, vehicle: usize, tracks: &[Vec<usize>], is_out: &[bool]) -> Vec<bool> {
    let found = &judge.estimate.vehicles[vehicle];
    let place = |(point, track): (usize, &Vec<usize>)| match (track.is_empty(), is_out[point]) {
        (true, _) => None,
        (false, false) => found.points[point],
        (false, true) => {
            let rays = body_rays(judge, vehicle, vehicle, track);
            let rays: Vec<Sighting> = rays.into_iter().map(|(_, ray)| ray).collect();
            point_from_poses(&rays, &[None; 3], judge.limit)
        }
    };
    let places: Vec<Option<Point3<f64>>> = tracks.iter().enumerate().map(place).collect();
    let of_body = places.iter().zip(is_out).filter(|(_, is_out)| !**is_out);
    let of_body: Vec<Point3<f64>> = of_body.filter_map(|(place, _)| *place).collect();
    beside_most(&places, &of_body)
}

/// Which places are far from where most of the points of a body are along some axis.
fn beside_most(places: &[Option<Point3<f64>>], of_body: &[Point3<f64>]) -> Vec<bool> {
    if of_body.len() < RULES.least_core {
        return vec![false; places.len()];
    }
    let room = [0, 1, 2].map(|axis| {
        let [least, most] = shortest_interval(of_body.iter().map(|place| place[axis]).collect());
        let beside_m = RULES.beside_m + RULES.beside_extents * (most - least);
        [least - beside_m, most + beside_m]
    });
    let is_beside = |place: &Point3<f64>| {
        place.iter().zip(room).any(|(value, [least, most])| !(least..=most).contains(value))
    };
    places.iter().map(|place| place.as_ref().is_some_and(is_beside)).collect()
}

/// The shortest interval that holds the share of the core; of several the first.
fn shortest_interval(mut values: Vec<f64>) -> [f64; 2] {
    values.sort_by(f64::total_cmp);
    let within = ((RULES.core_share * values.len() as f64).ceil() as usize).clamp(1, values.len());
    let intervals = values.windows(within).map(|some| [some[0], some[within - 1]]);
    let shorter =
        |best: [f64; 2], next: [f64; 2]| if next[1] - next[0] < best[1] - best[0] { next } else { best };
    intervals.reduce(shorter).unwrap_or([f64::NEG_INFINITY, f64::INFINITY])
}

/// Whether a track fits a static point better than the body, where the body moves, or fits one and is beside it. One
/// that was left out as static comes back where it fits the body much better: where most tracks are static, a body that
/// was bent to them stands itself.
fn is_static(
    judge: &Judge<'_>,
    vehicle: usize,
    track: &[usize],
    whitened: Whitened<'_>,
    (before, is_beside): (Option<RejectionReason>, bool),
) -> bool {
    let doubtful = RULES.doubtful_factor * judge.spread.max(1.0) * median_of_norm_2();
    let from_body = median_length(track, whitened).unwrap_or(0.0);
    let is_doubtful = track.len() >= RULES.least_points && (from_body > doubtful || before.is_some());
    if !is_doubtful && !is_beside {
        return false;
    }
    let rays = static_rays(judge, vehicle, track);
    let Some(from_static) = distance_from_static(rays.iter()) else { return false };
    let was_static = before == Some(RejectionReason::Static);
    let share = match before {
        Some(RejectionReason::Static) => 1.0 / RULES.static_share[1],
        Some(_) => 1.0,
        None => RULES.static_share[1],
    };
    from_static <= static_limit(judge.static_scatter)
        && (is_beside || from_static < share * from_body)
        && (was_static || moves(judge, vehicle, track, from_static))
}

/// The rays of a track in the world.
fn static_rays(judge: &Judge<'_>, vehicle: usize, track: &[usize]) -> Vec<Sighting> {
    let observations = &judge.problem.vehicles[vehicle].observations;
    let of = |at: &usize| world_sighting(judge.problem, &judge.estimate.camera_poses, &observations[*at]);
    track.iter().filter_map(of).collect()
}

/// Whether a point in the middle of the body is seen to move in the frames of a track, by more than `scatter` standard
/// deviations of an image point.
fn moves(judge: &Judge<'_>, vehicle: usize, track: &[usize], scatter: f64) -> bool {
    let Judge { problem, estimate, .. } = *judge;
    let found = &estimate.vehicles[vehicle];
    let middle = Point3::from(BODY_MIDDLE_M.map(|(middle_m, _)| middle_m));
    let rays = track.iter().filter_map(|at| {
        let o = &problem.vehicles[vehicle].observations[*at];
        let camera_from_world = estimate.camera_poses[o.frame].inverse();
        let seen = camera_from_world * (found.poses[o.frame]? * middle);
        let ray = (seen.z > 0.0).then(|| seen.coords.xy() / seen.z)?;
        let sigma = o.sigma_px / problem.camera.focal_px.mean();
        Some(Sighting { camera_from_body: camera_from_world, ray, sigma })
    });
    let rays: Vec<Sighting> = rays.collect();
    let away = distance_from_static(rays.iter()).unwrap_or(0.0);
    away > RULES.moving_factor * scatter.max(median_of_norm_2())
}

/// Whether the starting poses of a body go farther in the frames of a track than they are wrong by: what drives straight
/// away from a camera hardly moves in its image.
fn goes_on(judge: &Judge<'_>, vehicle: usize, track: &[usize]) -> bool {
    let Judge { problem, estimate, .. } = *judge;
    let place = |at: &usize| {
        let frame = problem.vehicles[vehicle].observations[*at].frame;
        Some(estimate.vehicles[vehicle].poses[frame]?.translation.vector)
    };
    let places: Vec<Vector3<f64>> = track.iter().filter_map(place).collect();
    if places.len() < RULES.least_points {
        return false;
    }
    let stated_m =
        problem.vehicle_pose_sigma.position_m.filter(|_| !problem.vehicles[vehicle].has_no_poses());
    let wrong_m = stated_m.unwrap_or(RULES.wrong_starts_m).max(RULES.least_wrong_starts_m);
    let bent = places.windows(3).map(|p| (p[2] - 2.0 * p[1] + p[0]).norm());
    let shaken_m = upper_median(bent.collect()).unwrap_or(0.0);
    let third = places.len() / 3;
    let middle = |some: &[Vector3<f64>]| {
        Vector3::from_fn(|axis, _| upper_median(some.iter().map(|p| p[axis]).collect()).unwrap_or(0.0))
    };
    let gone_m = (middle(&places[places.len() - third..]) - middle(&places[..third])).norm();
    gone_m > RULES.moving_factor * wrong_m.max(shaken_m)
}

/// For each point whether its track slides: it fits much worse than others, and its residuals change slowly. What is
/// known of a vehicle, and its marker, are painted on.
fn sliding_tracks(
    judge: &Judge<'_>,
    vehicle: usize,
    tracks: &[Vec<usize>],
    whitened: Whitened<'_>,
    is_out: &[bool],
) -> Vec<bool> {
    let of_vehicle = &judge.problem.vehicles[vehicle];
    let residuals =
        |track: &[usize]| -> Vec<Vector2<f64>> { track.iter().filter_map(|at| whitened[*at]).collect() };
    let score = |track: &Vec<usize>| {
        let lengths: Vec<f64> = residuals(track).iter().map(Vector2::norm).collect();
        if lengths.len() < RULES.least_points { None } else { value_at_share(lengths, RULES.fitting_share) }
    };
    let scores: Vec<Option<f64>> = tracks.iter().map(score).collect();
    let typical = upper_median(scores.iter().flatten().copied().collect()).unwrap_or(0.0);
    let limit = (RULES.sliding_factor * typical).max(RULES.sliding_sigmas);
    let slides = |(point, track): (usize, &Vec<usize>)| {
        let is_painted =
            of_vehicle.marker == Some(point) || of_vehicle.points[point].known.iter().any(Option::is_some);
        let limit = limit * if is_out[point] { RULES.return_share } else { 1.0 };
        let Some(score) = scores[point].filter(|score| *score > limit && !is_painted) else { return false };
        change_ratio(&residuals(track), 2.0 * score) < RULES.sliding_change
    };
    tracks.iter().enumerate().map(slides).collect()
}

/// Mean square of the changes from one residual to the next over their own: 2 of white noise, less where they last
/// (von Neumann 1941). Longer ones are cut to `most`.
fn change_ratio(residuals: &[Vector2<f64>], most: f64) -> f64 {
    let cut: Vec<Vector2<f64>> = residuals.iter().map(|r| r * (most / r.norm().max(most))).collect();
    let own = cut.iter().map(Vector2::norm_squared).sum::<f64>() / cut.len() as f64;
    let changes = cut.windows(2).map(|two| (two[1] - two[0]).norm_squared()).sum::<f64>();
    changes / (cut.len().max(2) - 1) as f64 / own.max(f64::MIN_POSITIVE)
}

/// Of what a track is that the body contradicts as a whole: a named kind, or `Track` where nobody can say.
pub fn kind_of(
    judge: &Judge<'_>,
    vehicle: usize,
    point: usize,
    track: &[usize],
    whitened: Whitened<'_>,
) -> RejectionReason {
    if track.len() < RULES.least_part {
        return RejectionReason::Track;
    }
    if stays_in_the_image(judge, vehicle, track) {
        return RejectionReason::Foreign;
    }
    let from_body = median_length(track, whitened).unwrap_or(f64::INFINITY);
    let from_static =
        distance_from_static(static_rays(judge, vehicle, track).iter()).unwrap_or(f64::INFINITY);
    if from_static <= static_limit(judge.static_scatter) && from_static < RULES.static_share[1] * from_body {
        return RejectionReason::Static;
    }
    let others = (0..judge.problem.vehicles.len()).filter(|other| *other != vehicle);
    if others.into_iter().any(|other| fits_vehicle(judge, vehicle, other, track)) {
        return RejectionReason::Foreign;
    }
    own_motion(judge, vehicle, point, track, whitened)
}

/// Whether a track stays where it is in the image while what stands in the world does not.
fn stays_in_the_image(judge: &Judge<'_>, vehicle: usize, track: &[usize]) -> bool {
    let Judge { problem, estimate, .. } = *judge;
    let observations = &problem.vehicles[vehicle].observations;
    let image_px: Vec<Vector2<f64>> = track.iter().map(|at| observations[*at].image_px).collect();
    let sigma_px = observations[track[0]].sigma_px;
    let limit_px = static_limit(1.0) * sigma_px;
    if median_away(&image_px) > limit_px {
        return false;
    }
    let middle = observations[track[track.len() / 2]].frame;
    let Some(pose) = &estimate.vehicles[vehicle].poses[middle] else { return false };
    let place = Point3::from(pose.translation.vector);
    let seen = |at: &usize| {
        let camera = &estimate.camera_poses[observations[*at].frame];
        problem.camera.project(&camera.inverse_transform_point(&place).coords)
    };
    let of_world: Vec<Vector2<f64>> = track.iter().filter_map(seen).collect();
    median_away(&of_world) > RULES.moving_factor * limit_px
}

/// Median distance of image points from their median.
fn median_away(image_px: &[Vector2<f64>]) -> f64 {
    let median = |axis: usize| upper_median(image_px.iter().map(|px| px[axis]).collect()).unwrap_or(0.0);
    let middle = Vector2::new(median(0), median(1));
    upper_median(image_px.iter().map(|px| (px - middle).norm()).collect()).unwrap_or(0.0)
}

/// The rays of a track in the frame of a vehicle, each with its place in the track.
fn body_rays(judge: &Judge<'_>, vehicle: usize, body: usize, track: &[usize]) -> Vec<(usize, Sighting)> {
    let Judge { problem, estimate, .. } = *judge;
    let of = |(at, item): (usize, &usize)| {
        let o = &problem.vehicles[vehicle].observations[*item];
        Some((at, sighting(problem, &estimate.camera_poses, &estimate.vehicles[body], o)?))
    };
    track.iter().enumerate().filter_map(of).collect()
}

/// How far some rays are from the point of a body that most of them meet \[standard deviations\]; infinite without one.
fn away_from_body(judge: &Judge<'_>, rays: &[(usize, Sighting)]) -> Vec<f64> {
    let own: Vec<Sighting> = rays.iter().map(|(_, ray)| *ray).collect();
    let Some(point) = point_from_poses(&own, &[None; 3], judge.limit) else {
        return vec![f64::INFINITY; own.len()];
    };
    let away = |ray: &Sighting| {
        let seen = ray.camera_from_body * point;
        if seen.z > 0.0 { (ray.ray - seen.coords.xy() / seen.z).norm() / ray.sigma } else { f64::INFINITY }
    };
    own.iter().map(away).collect()
}

/// Which of them meet in it.
fn meeting(judge: &Judge<'_>, rays: &[(usize, Sighting)]) -> Vec<bool> {
    away_from_body(judge, rays).iter().map(|away| *away <= judge.limit).collect()
}

fn share(flags: &[bool]) -> f64 {
    flags.iter().filter(|flag| **flag).count() as f64 / flags.len().max(1) as f64
}

fn fits_vehicle(judge: &Judge<'_>, vehicle: usize, other: usize, track: &[usize]) -> bool {
    if judge.estimate.vehicles[other].left_out.is_some() {
        return false;
    }
    let rays = body_rays(judge, vehicle, other, track);
    rays.len() >= RULES.least_part && share(&meeting(judge, &rays)) >= RULES.least_fitting_share
}

/// The part of a track that is of another point of the body than the rest: its image points, by their places in the
/// track.
pub fn swapped_part(judge: &Judge<'_>, vehicle: usize, track: &[usize]) -> Option<std::ops::Range<usize>> {
    let rays = body_rays(judge, vehicle, vehicle, track);
    if rays.len() < 2 * RULES.least_part || rays.len() < track.len() {
        return None;
    }
    let away = away_from_body(judge, &rays);
    let fits: Vec<bool> = away.iter().map(|away| *away <= judge.limit).collect();
    // Where the one ends and the other begins.
    let right = |k: usize, first: bool| {
        fits.iter().enumerate().filter(|(at, fits)| **fits == ((*at < k) == first)).count()
    };
    let splits = RULES.least_part..=rays.len() - RULES.least_part;
    let candidates = splits.flat_map(|k| [(k, true), (k, false)]);
    let (k, first) = candidates
        .reduce(|best, other| if right(other.0, other.1) > right(best.0, best.1) { other } else { best })?;
    let (part, rest) = if first { (k..rays.len(), 0..k) } else { (0..k, k..rays.len()) };
    let is_of_point = share(&fits[rest]) >= RULES.least_fitting_share;
    let is_of_other = share(&fits[part.clone()]) <= 1.0 - RULES.least_fitting_share
        && share(&meeting(judge, &rays[part.clone()])) >= RULES.least_fitting_share;
    // What slides away begins near by.
    let length = upper_median(away[part.clone()].to_vec())?;
    let first_two = if first { k..k + 2 } else { k - 2..k };
    let jumps = away[first_two].iter().all(|away| *away >= RULES.least_jump * length);
    (is_of_point && is_of_other && jumps).then_some(part)
}

/// What goes its own way: over the body, or somewhere else; `Track` where its residuals are not of one cause.
fn own_motion(
    judge: &Judge<'_>,
    vehicle: usize,
    point: usize,
    track: &[usize],
    whitened: Whitened<'_>,
) -> RejectionReason {
    let residuals: Vec<Vector2<f64>> = track.iter().filter_map(|at| whitened[*at]).collect();
    let length = upper_median(residuals.iter().map(Vector2::norm).collect()).unwrap_or(0.0);
    let change = upper_median(residuals.windows(2).map(|two| (two[1] - two[0]).norm()).collect());
    if residuals.len() < RULES.least_points || change.is_none_or(|c| c >= RULES.one_cause_change * length) {
        return RejectionReason::Track;
    }
    let Judge { problem, estimate, .. } = *judge;
    let found = &estimate.vehicles[vehicle];
    let place = found.points[point].unwrap_or(Point3::origin());
    let away_m = track.iter().filter_map(|at| {
        let o = &problem.vehicles[vehicle].observations[*at];
        let seen = estimate.camera_poses[o.frame].inverse_transform_point(&(found.poses[o.frame]? * place));
        Some(whitened[*at]? * (o.sigma_px / problem.camera.focal_px.mean() * seen.z))
    });
    let away_m: Vec<Vector2<f64>> = away_m.collect();
    let least = |axis: usize| away_m.iter().map(|m| m[axis]).fold(f64::INFINITY, f64::min);
    let most = |axis: usize| away_m.iter().map(|m| m[axis]).fold(f64::NEG_INFINITY, f64::max);
    let range = Vector3::new(most(0) - least(0), most(1) - least(1), 0.0).norm();
    if range <= RULES.most_slide_m { RejectionReason::Sliding } else { RejectionReason::Foreign }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shortest_interval_holds_the_share_of_the_core() {
        // Four of ten within half a metre, the others all over.
        let values = vec![7.0, -3.0, 0.1, 0.5, 12.0, 0.0, -9.0, 0.4, 3.0, 40.0];
        assert_eq!(shortest_interval(values), [0.0, 0.5]);
        assert_eq!(shortest_interval(vec![2.0]), [2.0, 2.0]);
    }

    #[test]
    fn points_of_the_background_are_beside_a_body_also_where_they_are_more() {
        // A car seen from a side, and more points of a street behind it.
        let of_car = |at: usize| Point3::new(-2.2 + 4.4 * at as f64 / 29.0, 0.9, 0.3 + 0.04 * at as f64);
        let of_street = |at: usize| Point3::new(-30.0 + at as f64, 8.0 + 0.3 * at as f64, 0.1 * at as f64);
        let all: Vec<Point3<f64>> = (0..30).map(of_car).chain((0..40).map(of_street)).collect();
        let mut places: Vec<Option<Point3<f64>>> = all.iter().copied().map(Some).collect();
        places.push(None);
        let wanted: Vec<bool> = (0..71).map(|at| (30..70).contains(&at)).collect();
        assert_eq!(beside_most(&places, &all), wanted);
        // Of a few points nothing is said.
        assert!(!beside_most(&places, &all[..5]).contains(&true));
    }
}
