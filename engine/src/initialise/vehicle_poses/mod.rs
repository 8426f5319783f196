//! Starting poses of a vehicle that comes without: from its image points, the cameras and the ground.
//!
//! Forward intersection with the ground raised by a height common to all points, without the tracks that
//! stay behind while the others drive on; one pattern and its
//! motion, heights and pattern adjusted together; again with each point's own height; then the body in
//! the pattern, and the motion as a cone program.

pub mod body_axes;
pub mod forward;
pub mod motion_program;
pub mod plane_adjustment;
pub mod plane_motion;
pub mod static_tracks;

use super::warnings::InitialWarning;
use crate::camera::Camera;
use crate::estimate::LeftOut;
use crate::geometry::{Pose, heading_rad};
use crate::problem::{Frame, Vehicle};
use crate::rules::rules;
use crate::stats::quantile::upper_median;
use crate::terrain::{Ground, Terrain};
use body_axes::{Heading, place_body, scatter};
use forward::{Foot, feet};
use motion_program::{Bound, Excess, Limits, NoMotion};
use nalgebra::{Matrix3, Rotation3, Translation3, UnitQuaternion, Vector2, Vector3};
use plane_adjustment::{KnownHeight, Pattern};
use plane_motion::{PlanePose, chain};
use static_tracks::static_tracks;
use std::f64::consts::TAU;

rules! {
    /// Poses of vehicles that none are given of.
    pub struct FoundPoseRules {
        /// Mean height above the ground of the points of a car.
        car_mean_height_m: f64 = 0.8, "m";
        /// Mean height of points where the height of the highest is known.
        mean_height_share: f64 = 0.5, "share of the height";
        /// Least standard deviation of a known height.
        least_height_sigma_m: f64 = 0.01, "m";
        /// How far feet may be off because heights are not known: in the first round, and after it.
        foot_slack_m: [f64; 2] = [0.15, 0.04], "m";
        /// How far beyond the usual a foot counts: in the first round, and after it.
        foot_reach_factor: [f64; 2] = [2.0, 1.2], "factor";
        /// Adjustments with feet found anew, after the second chain.
        last_rounds: usize = 2, "rounds";
        /// Bounds of the standard deviation of a place as a datum of the motion.
        place_sigma_m: [f64; 2] = [0.01, 1.0], "m";
        /// The same of a heading.
        heading_sigma_rad: [f64; 2] = [0.003, 0.3], "rad";
        /// Scatter of the mean acceleration over one second: weak, so that only noise goes.
        acceleration_scatter_mps2: f64 = 1.5, "m/s^2";
        /// The same of turns.
        turn_scatter_radps2: f64 = 1.0, "rad/s^2";
    }
}

const RULES: FoundPoseRules = FoundPoseRules::DEFAULT;

/// What no road vehicle does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionBounds {
    /// Highest speed \[m/s\], > 0. Default 60.
    pub speed_mps: f64,
    /// Largest acceleration in any direction \[m/s^2\], > 0. Default 12.
    pub acceleration_mps2: f64,
    /// Highest rate of turn \[rad/s\], > 0. Default 90 deg/s.
    pub turn_rad_per_s: f64,
}

impl Default for MotionBounds {
    fn default() -> Self {
        MotionBounds { speed_mps: 60.0, acceleration_mps2: 12.0, turn_rad_per_s: std::f64::consts::FRAC_PI_2 }
    }
}

/// Poses that were found.
#[derive(Clone, Debug)]
pub struct FoundPoses {
    /// `world_from_vehicle` of each frame of the vehicle's span: as it is given, or else as it was found.
    pub poses: Vec<Option<Pose>>,
    /// As it was found, where one is given too, in the body frame of those that are given.
    pub found: Vec<Option<Pose>>,
    /// What is odd.
    pub warnings: Vec<InitialWarning>,
}

impl FoundPoses {
    /// Nothing but what is given.
    pub fn given(vehicle: &Vehicle) -> Self {
        FoundPoses { poses: vehicle.poses.clone(), found: Vec::new(), warnings: Vec::new() }
    }
}

impl From<NoMotion> for LeftOut {
    fn from(why: NoMotion) -> Self {
        match why {
            NoMotion::NoData => LeftOut::NoPositions,
            NoMotion::NotSolved => LeftOut::MotionNotSolved,
        }
    }
}

/// Finds the poses of `vehicle` in all frames of its span, or says why they cannot be found. Poses that are
/// given fix its frame, and are returned as they are. Tracks of points that stand take no part.
pub fn find_poses(
    vehicle: &Vehicle,
    stands: &[bool],
    frames: &[Frame],
    camera: &Camera,
    camera_poses: &[Pose],
    terrain: &Terrain,
    bounds: &MotionBounds,
) -> Result<FoundPoses, LeftOut> {
    if vehicle.observations.is_empty() {
        return Err(LeftOut::NeverSeen);
    }
    let mut warnings = Vec::new();
    let pattern = find_pattern(vehicle, stands, frames.len(), camera, camera_poses, terrain)?;
    let bodies = place_body(&pattern, vehicle);
    let mut plane: Vec<Option<PlanePose>> = (0..frames.len())
        .map(|frame| Some(pattern.poses[frame]?.after(&bodies[pattern.part[frame]]?.0)))
        .collect();
    let has_given = align_to_given(&mut plane, vehicle);
    let guessed = |frame: usize| matches!(bodies[pattern.part[frame]], Some((_, Heading::Guess)));
    if !has_given && plane.iter().enumerate().any(|(frame, pose)| pose.is_some() && guessed(frame)) {
        warnings.push(InitialWarning::HeadingGuessed { vehicle: vehicle.id.clone() });
    }
    unwrap_headings(&mut plane);

    let span = vehicle.span();
    let times: Vec<f64> = frames[span.clone()].iter().map(|f| f.time_s).collect();
    // Errors that all points of a frame share, the camera's first of all, show in the path alone.
    let path: Vec<PlanePose> = plane[span.clone()].iter().flatten().copied().collect();
    let [x, y] = [0, 1].map(|axis| scatter(path.iter().map(|p| p.place_m[axis])));
    let (least_m, least_rad) = (x.max(y), scatter(path.iter().map(|p| p.heading_rad)));
    let clamp = |value: f64, [least, most]: [f64; 2]| value.max(least).min(most);
    let datum = |frame: usize| {
        let pose = plane[frame].filter(|_| pattern.agreeing[frame] >= 2)?;
        Some((pose, pattern.sigma[frame]))
    };
    let places: Vec<_> = span
        .clone()
        .map(|f| {
            datum(f).map(|(pose, s)| {
                ([pose.place_m.x, pose.place_m.y], clamp(s[0].max(least_m), RULES.place_sigma_m))
            })
        })
        .collect();
    let headings: Vec<_> = span
        .clone()
        .map(|f| {
            datum(f)
                .map(|(pose, s)| ([pose.heading_rad], clamp(s[1].max(least_rad), RULES.heading_sigma_rad)))
        })
        .collect();
    let of_place = Limits {
        rate: bounds.speed_mps,
        acceleration: Some(bounds.acceleration_mps2),
        scatter: RULES.acceleration_scatter_mps2,
    };
    let of_heading =
        Limits { rate: bounds.turn_rad_per_s, acceleration: None, scatter: RULES.turn_scatter_radps2 };
    let place = motion_program::fit::<2>(&times, &places, &of_place)?;
    let heading = motion_program::fit::<1>(&times, &headings, &of_heading)?;
    let excesses =
        place.excesses.iter().map(|e| (e, false)).chain(heading.excesses.iter().map(|e| (e, true)));
    warnings.extend(excesses.map(|(excess, turns)| beyond(vehicle, excess, turns, bounds)));

    let mut found = vec![None; frames.len()];
    let mut ground: Option<Ground> = None;
    let first = place.values.iter().find_map(|[x, y]| terrain.at(*x, *y).ok());
    for (at, frame) in span.enumerate() {
        let [x, y] = place.values[at];
        // Beyond the edge of the terrain it goes on level with where it was last known.
        ground = terrain.at(x, y).ok().or(ground).or(first);
        let Some(ground) = ground else {
            return Err(LeftOut::RaysMissTerrain { rays: vehicle.observations.len() });
        };
        found[frame] = Some(stand(Vector2::new(x, y), heading.values[at][0], &ground));
    }
    let poses =
        vehicle.poses.iter().zip(&found).map(|(given, found)| given.filter(|_| found.is_some()).or(*found));
    Ok(FoundPoses { poses: poses.collect(), found, warnings })
}

/// The pose of a body that stands on the ground.
fn stand(place_m: Vector2<f64>, heading_rad: f64, ground: &Ground) -> Pose {
    let up = ground.normal();
    let along = Vector3::new(heading_rad.cos(), heading_rad.sin(), 0.0);
    let left = up.cross(&along).normalize();
    let axes = Matrix3::from_columns(&[left.cross(&up), left, up]);
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
    Pose::from_parts(Translation3::from(place_m.push(ground.height_m)), rotation)
}

/// For each point of a vehicle whether its track stays behind while the others drive on (`static_tracks.rs`).
pub fn static_points(
    vehicle: &Vehicle,
    camera: &Camera,
    camera_poses: &[Pose],
    terrain: &Terrain,
) -> Vec<bool> {
    let (_, heights) = first_heights(vehicle);
    let met = feet(&vehicle.observations, camera, camera_poses, &heights, terrain);
    static_tracks(&met, camera_poses.len(), vehicle.points.len())
}

/// The mean height of the points of a vehicle, and that of each as far as it is known beforehand \[m\].
fn first_heights(vehicle: &Vehicle) -> (f64, Vec<f64>) {
    let mean_m =
        vehicle.height.map_or(RULES.car_mean_height_m, |height| RULES.mean_height_share * height.value_m);
    let heights = vehicle.points.iter().map(|point| point.known[2].map_or(mean_m, |known| known.value_m));
    (mean_m, heights.collect())
}

fn find_pattern(
    vehicle: &Vehicle,
    stands: &[bool],
    frames: usize,
    camera: &Camera,
    camera_poses: &[Pose],
    terrain: &Terrain,
) -> Result<Pattern, LeftOut> {
    let mut known: Vec<Option<KnownHeight>> = vehicle
        .points
        .iter()
        .map(|point| {
            let known = point.known[2]?;
            Some(KnownHeight {
                value_m: known.value_m,
                sigma_m: known.sigma_m.max(RULES.least_height_sigma_m),
            })
        })
        .collect();
    let (mean_m, mut heights) = first_heights(vehicle);
    let meet = |heights: &[f64]| feet(&vehicle.observations, camera, camera_poses, heights, terrain);
    let mut met: Vec<Foot> = meet(&heights);
    let mut is_left = static_tracks(&met, frames, vehicle.points.len());
    is_left.iter_mut().zip(stands).for_each(|(is_left, stands)| *is_left |= stands);
    let meet = |heights: &[f64]| -> Vec<Foot> {
        meet(heights).into_iter().filter(|foot| !is_left[foot.point]).collect()
    };
    met.retain(|foot| !is_left[foot.point]);
    if met.is_empty() {
        return Err(LeftOut::RaysMissTerrain { rays: vehicle.observations.len() });
    }
    let adjusted = |met: &[Foot], heights: &[f64], known: &[Option<KnownHeight>], round: usize| {
        let links = chain(met, frames, vehicle.points.len(), RULES.foot_slack_m[round]);
        if links.patterns.is_empty() {
            return Err(LeftOut::TooFewOnTerrain);
        }
        let mut pattern = Pattern::new(&links, heights, known, mean_m);
        pattern.adjust(met, heights, RULES.foot_reach_factor[round]);
        Ok(pattern)
    };
    let mut pattern = adjusted(&met, &heights, &known, 0)?;
    heights = pattern.heights_m(&heights);
    if let Some(height) = vehicle.height
        && let Some(highest) = pattern.highest_point()
        && known[highest].is_none()
    {
        let sigma_m = height.sigma_m.max(RULES.least_height_sigma_m);
        known[highest] = Some(KnownHeight { value_m: height.value_m, sigma_m });
    }
    met = meet(&heights);
    pattern = adjusted(&met, &heights, &known, 1)?;
    for _ in 0..RULES.last_rounds {
        heights = pattern.heights_m(&heights);
        met = meet(&heights);
        pattern.adjust(&met, &heights, RULES.foot_reach_factor[1]);
    }
    Ok(pattern)
}

/// Moves the body into the frame of the poses that are given; whether there are any.
fn align_to_given(plane: &mut [Option<PlanePose>], vehicle: &Vehicle) -> bool {
    let offsets: Vec<PlanePose> = plane
        .iter()
        .zip(&vehicle.poses)
        .filter_map(|(found, given)| {
            let given = (*given)?;
            let place_m = given.translation.vector.xy();
            let given = PlanePose { place_m, heading_rad: heading_rad(&given) };
            Some((*found)?.inverse().after(&given))
        })
        .collect();
    let Some(first) = offsets.first() else { return false };
    let median =
        |of: &dyn Fn(&PlanePose) -> f64| upper_median(offsets.iter().map(of).collect()).unwrap_or(0.0);
    let near = |angle: f64| angle - ((angle - first.heading_rad) / TAU).round() * TAU;
    let offset = PlanePose {
        place_m: Vector2::new(median(&|o| o.place_m.x), median(&|o| o.place_m.y)),
        heading_rad: median(&|o| near(o.heading_rad)),
    };
    plane.iter_mut().flatten().for_each(|pose| *pose = pose.after(&offset));
    true
}

/// Adds full turns so that headings go on from the median of those just before.
fn unwrap_headings(plane: &mut [Option<PlanePose>]) {
    let mut recent: Vec<f64> = Vec::new();
    for pose in plane.iter_mut().flatten() {
        let mut sorted = recent.clone();
        sorted.sort_by(f64::total_cmp);
        if let Some(before) = sorted.get(sorted.len() / 2) {
            pose.heading_rad -= ((pose.heading_rad - before) / TAU).round() * TAU;
        }
        if recent.len() == 5 {
            recent.remove(0);
        }
        recent.push(pose.heading_rad);
    }
}

fn beyond(vehicle: &Vehicle, excess: &Excess, turns: bool, bounds: &MotionBounds) -> InitialWarning {
    let limit = match (excess.bound, turns) {
        (Bound::Rate, false) => bounds.speed_mps,
        (Bound::Rate, true) => bounds.turn_rad_per_s,
        (Bound::Acceleration, _) => bounds.acceleration_mps2,
    };
    InitialWarning::BeyondBounds {
        vehicle: vehicle.id.clone(),
        time_s: excess.time_s,
        bound: excess.bound,
        turns,
        reached: excess.reached,
        limit,
    }
}
