//! The first estimate: poses as they are given, cameras without one by spatial resection, vehicles
//! without one from the ground below them, shapes by direct linear transformation, static points by
//! intersection of their rays.

pub mod resection;
pub mod shape;
pub mod static_world;
pub mod vehicle_poses;
mod warnings;

use crate::estimate::{Depth, Estimate, LeftOut, VehicleEstimate};
use crate::geometry::Pose;
use crate::problem::{Known, Problem, Role, TargetObservation, Vehicle, VehicleObservation};
use crate::residuals::inside_body::BODY_BOX_M;
pub use crate::residuals::inside_body::{BODY_MIDDLE_M, is_inside};
use crate::rules::{Rules, rules};
use crate::stats::quantile::upper_median;
use nalgebra::{Point3, Vector2};
use rayon::prelude::*;
pub use resection::{NotResectable, Resection};
use shape::dlt::{LinearPoint, Sighting};
use shape::{robust_dlt, triangulation};
use static_world::WorldTrack;
use trackbundle_solver::loss::robust_spread;
pub use vehicle_poses::MotionBounds;
use vehicle_poses::{FoundPoses, find_poses, static_points};
pub use warnings::InitialWarning;

rules! {
    /// The first estimate.
    pub struct InitialiseRules {
        /// Fewest points that give a vehicle a pose in every frame.
        least_points: usize = 3, "points";
        /// From this standard deviation on the depth of a shape point is said to be left open by its rays.
        open_depth_m: f64 = 0.3, "m";
        /// Where more of the points of a vehicle have gross errors, all are intersected robustly.
        most_gross_share: f64 = 0.02, "share of points";
        /// Where a residual of an image point turns linear.
        huber_sigmas: f64 = 1.5, "standard deviations";
        /// Fewest image points of targets that say what static points scatter.
        least_static: usize = 20, "image points";
    }
}

const RULES: InitialiseRules = InitialiseRules::DEFAULT;

/// The constants of the first estimate.
pub fn constants() -> Vec<Rules> {
    let of_poses = [
        vehicle_poses::forward::ForwardRules::PAGE,
        vehicle_poses::static_tracks::StaticTrackRules::PAGE,
        vehicle_poses::plane_motion::PlaneMotionRules::PAGE,
        vehicle_poses::plane_adjustment::PlaneAdjustmentRules::PAGE,
        vehicle_poses::motion_program::MotionRules::PAGE,
        vehicle_poses::body_axes::BodyAxesRules::PAGE,
        vehicle_poses::FoundPoseRules::PAGE,
    ];
    let of_shapes = [
        static_world::StaticWorldRules::PAGE,
        shape::dlt::DltRules::PAGE,
        shape::triangulation::TriangulationRules::PAGE,
    ];
    [InitialiseRules::PAGE]
        .into_iter()
        .chain(resection::constants())
        .chain(of_poses)
        .chain(of_shapes)
        .collect()
}

/// How a shape is found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// Least squares on all rows of a point: the seed paper's.
    Plain,
    /// Plain, and where that leaves large residuals a Huber fit ([`robust_dlt`]).
    RobustWhereNeeded,
}

/// A first estimate and what is odd about it.
#[derive(Clone, Debug)]
pub struct Initial {
    /// The estimate.
    pub estimate: Estimate,
    /// How many points needed the robust fit.
    pub robust_points: usize,
    /// How cameras without a given pose were found, where there are any.
    pub resection: Option<Resection>,
    /// What is odd.
    pub warnings: Vec<InitialWarning>,
}

/// The first estimate of a problem, with the default bounds of motion.
pub fn initialise(problem: &Problem, method: Method) -> Result<Initial, NotResectable> {
    initialise_within(problem, method, &MotionBounds::default())
}

/// The first estimate of a problem. Cameras without a given pose are resected from control targets; the
/// error says why no pose can be had. Where a vehicle has no pose in a frame in which it is seen, its
/// poses are found ([`vehicle_poses`]) within `bounds`.
pub fn initialise_within(
    problem: &Problem,
    method: Method,
    bounds: &MotionBounds,
) -> Result<Initial, NotResectable> {
    let mut warnings = Vec::new();
    let (camera_poses, resection) = camera_poses(problem)?;
    if let Some(resection) = &resection {
        warnings.extend(resection::warnings(resection, &problem.frames));
    }
    let mut robust_points = 0;
    let mut vehicles = Vec::new();
    let poses: Vec<Result<FoundPoses, LeftOut>> = problem
        .vehicles
        .par_iter()
        .map(|vehicle| poses_of(problem, vehicle, &camera_poses, bounds))
        .collect();
    for (vehicle, poses) in problem.vehicles.iter().zip(poses) {
        let no_poses = poses.as_ref().err().copied();
        let poses = poses.unwrap_or_else(|_| FoundPoses::given(vehicle));
        warnings.extend(poses.warnings);
        let mut estimate = VehicleEstimate { poses: poses.poses, ..VehicleEstimate::without_points(vehicle) };
        estimate.bridge_gaps(problem, vehicle);
        let counts = find_shape(problem, &camera_poses, vehicle, &mut estimate, method);
        robust_points += counts.robust;
        estimate.left_out = no_poses.or_else(|| reason_to_leave_out(problem, vehicle, &estimate));
        warn_of_points(vehicle, &estimate, counts.without_depth, &mut warnings);
        vehicles.push(estimate);
    }
    let mut estimate = Estimate::new(problem, camera_poses, vehicles);
    let mut without_depth = Vec::new();
    for (at, target) in problem.targets.iter().enumerate() {
        let surveyed = target.surveyed().filter(|_| target.role == Role::Control);
        estimate.targets[at] = surveyed.or_else(|| intersect_target(problem, &estimate.camera_poses, at));
        let seen = problem.target_observations.iter().any(|o| o.target == at);
        if seen && target.role == Role::Control && estimate.targets[at].is_none() {
            without_depth.push(target.id.clone());
        }
    }
    if !without_depth.is_empty() {
        warnings.push(InitialWarning::TargetsLeftOut { targets: without_depth });
    }
    Ok(Initial { estimate, robust_points, resection, warnings })
}

/// Another start for vehicles whose poses are given: found as if they were not, in the body frame of
/// those. `None` where no vehicle has one.
pub fn start_anew(problem: &Problem, start: &Estimate) -> Option<Estimate> {
    let ground = problem.ground.as_ref().filter(|_| !problem.vehicle_pose_sigma.is_exact())?;
    let mut anew = start.clone();
    let changed: Vec<bool> = problem
        .vehicles
        .par_iter()
        .zip(&mut anew.vehicles)
        .map(|(vehicle, estimate)| {
            if vehicle.has_no_poses() || estimate.left_out.is_some() {
                return false;
            }
            let (frames, bounds) = (&problem.frames, MotionBounds::default());
            let cameras = &start.camera_poses;
            let stands = standing_tracks(problem, vehicle, cameras);
            let terrain = &ground.terrain;
            let Ok(found) = find_poses(vehicle, &stands, frames, &problem.camera, cameras, terrain, &bounds)
            else {
                return false;
            };
            let mut other =
                VehicleEstimate { poses: found.found, ..VehicleEstimate::without_points(vehicle) };
            find_shape(problem, cameras, vehicle, &mut other, Method::RobustWhereNeeded);
            // The same unknowns, so that costs can be compared.
            let is_whole = estimate.points.iter().zip(&other.points).all(|(a, b)| a.is_some() <= b.is_some());
            if is_whole {
                estimate.points.iter_mut().zip(other.points).for_each(|(a, b)| *a = a.and(b));
                estimate.poses = other.poses;
            }
            is_whole
        })
        .collect();
    changed.contains(&true).then_some(anew)
}

/// Gives a vehicle its shape.
fn find_shape(
    problem: &Problem,
    camera_poses: &[Pose],
    vehicle: &Vehicle,
    estimate: &mut VehicleEstimate,
    method: Method,
) -> ShapeCounts {
    let fits = shape(problem, camera_poses, vehicle, estimate, method);
    estimate.points = fits.iter().map(|fit| fit.as_ref().map(|fit| fit.point)).collect();
    let depth = |fit: &Option<Fit>| match fit {
        Some(fit) if fit.is_open => Depth::Open,
        _ => Depth::Known,
    };
    estimate.depths = fits.iter().map(depth).collect();
    let count = |of: fn(&Fit) -> bool| fits.iter().flatten().filter(|fit| of(fit)).count();
    ShapeCounts { robust: count(|fit| fit.robust), without_depth: count(|fit| fit.has_no_depth) }
}

/// For each vehicle and point whether its track stays behind on the ground while the others drive on.
pub fn static_tracks(problem: &Problem, camera_poses: &[Pose]) -> Vec<Vec<bool>> {
    let of_vehicle = |vehicle: &Vehicle| match &problem.ground {
        Some(ground) => static_points(vehicle, &problem.camera, camera_poses, &ground.terrain),
        None => vec![false; vehicle.points.len()],
    };
    problem.vehicles.par_iter().map(of_vehicle).collect()
}

/// For each point of a vehicle whether its track is of something that stands, by the poses of the camera alone, while
/// other tracks in the same frames are not.
fn standing_tracks(problem: &Problem, vehicle: &Vehicle, camera_poses: &[Pose]) -> Vec<bool> {
    let mut tracks: Vec<WorldTrack> = vec![Vec::new(); vehicle.points.len()];
    for o in &vehicle.observations {
        tracks[o.point].extend(world_sighting(problem, camera_poses, o).map(|ray| (o.frame, ray)));
    }
    let surveyed: Vec<_> = problem.targets.iter().map(|target| target.surveyed()).collect();
    let found = static_world::static_tracks(&tracks, static_scatter(problem, camera_poses, &surveyed));
    found.iter().map(|found| found.is_some_and(|standing| standing.others_move)).collect()
}

/// What image points of static points scatter by these camera poses, in their standard deviations, and at least 1:
/// as control targets do; without enough of them, as the stated attitudes of the camera do.
pub fn static_scatter(problem: &Problem, camera_poses: &[Pose], targets: &[Option<Point3<f64>>]) -> f64 {
    let square = |o: &TargetObservation| {
        let target = targets[o.target].filter(|_| problem.targets[o.target].role == Role::Control)?;
        let in_camera = camera_poses[o.frame].inverse_transform_point(&target).coords;
        Some((o.image_px - problem.camera.project(&in_camera)?).norm_squared() / (o.sigma_px * o.sigma_px))
    };
    let squares: Vec<f64> = problem.target_observations.iter().filter_map(square).collect();
    if squares.len() >= RULES.least_static {
        return robust_spread(squares).max(1.0);
    }
    let attitude_rad = problem.camera_pose_sigma.rotation_rad[0].unwrap_or(0.0);
    let sigmas_px = problem.vehicles.iter().flat_map(|v| v.observations.iter().map(|o| o.sigma_px));
    let sigma_px = upper_median(sigmas_px.collect()).unwrap_or(1.0);
    1_f64.hypot(attitude_rad * problem.camera.focal_px.mean() / sigma_px)
}

/// A point of a vehicle from poses that are right: where most of its rays meet within `limit` standard
/// deviations ([`triangulation::consensus`]), in the body. (In the frame of a body that drives straight on below
/// a camera that hovers, the rays to a place on the road are parallel: they all meet at infinity.)
pub fn point_anew(
    problem: &Problem,
    estimate: &Estimate,
    vehicle: usize,
    point: usize,
    limit: f64,
) -> Option<Point3<f64>> {
    let of_vehicle = &problem.vehicles[vehicle];
    let own = of_vehicle.observations.iter().filter(|o| o.point == point);
    let own = own.filter_map(|o| sighting(problem, &estimate.camera_poses, &estimate.vehicles[vehicle], o));
    let sightings: Vec<Sighting> = own.collect();
    point_from_poses(&sightings, &of_vehicle.points[point].known, limit)
}

/// The same of rays in the frame of the body.
pub fn point_from_poses(
    sightings: &[Sighting],
    known: &[Option<Known>; 3],
    limit: f64,
) -> Option<Point3<f64>> {
    let in_body = |point: &Point3<f64>| {
        point.iter().zip(BODY_BOX_M).all(|(value, [lower, upper])| (lower..upper).contains(value))
    };
    triangulation::consensus(sightings, known, limit, in_body)
}

/// The ray of an image point of a vehicle in the world.
pub fn world_sighting(
    problem: &Problem,
    camera_poses: &[Pose],
    observation: &VehicleObservation,
) -> Option<Sighting> {
    let camera_from_world = camera_poses[observation.frame].inverse();
    ray_of(problem, camera_from_world, &observation.image_px, observation.sigma_px)
}

/// The ray of an image point in the frame of a body of this pose.
fn ray_of(
    problem: &Problem,
    camera_from_body: Pose,
    image_px: &Vector2<f64>,
    sigma_px: f64,
) -> Option<Sighting> {
    let sigma = sigma_px / problem.camera.focal_px.mean();
    Some(Sighting { camera_from_body, ray: problem.camera.ray(image_px)?, sigma })
}

/// The ray of an image point in the frame of its vehicle.
pub fn sighting(
    problem: &Problem,
    camera_poses: &[Pose],
    estimate: &VehicleEstimate,
    observation: &VehicleObservation,
) -> Option<Sighting> {
    let camera_from_body = camera_poses[observation.frame].inverse() * estimate.poses[observation.frame]?;
    ray_of(problem, camera_from_body, &observation.image_px, observation.sigma_px)
}

/// `world_from_camera` of each frame, and how those were found that were not given.
fn camera_poses(problem: &Problem) -> Result<(Vec<Pose>, Option<Resection>), NotResectable> {
    let given: Option<Vec<Pose>> = problem.camera_poses.iter().copied().collect();
    if let Some(given) = given {
        return Ok((given, None));
    }
    let resection = resection::resect_problem(problem)?;
    Ok((resection.frames.iter().map(|frame| frame.pose).collect(), Some(resection)))
}

/// The poses of a vehicle: as they are given, or found where one is missing.
fn poses_of(
    problem: &Problem,
    vehicle: &Vehicle,
    camera_poses: &[Pose],
    bounds: &MotionBounds,
) -> Result<FoundPoses, LeftOut> {
    if !vehicle.misses_poses() {
        return Ok(FoundPoses::given(vehicle));
    }
    let ground = problem.ground.as_ref().ok_or(LeftOut::NoTerrain)?;
    let stands = standing_tracks(problem, vehicle, camera_poses);
    find_poses(vehicle, &stands, &problem.frames, &problem.camera, camera_poses, &ground.terrain, bounds)
}

struct Fit {
    point: Point3<f64>,
    robust: bool,
    is_open: bool,
    /// Whether its depth were open even if the poses were right.
    has_no_depth: bool,
}

/// How many points of a shape needed the robust fit, and how many have no depth.
struct ShapeCounts {
    robust: usize,
    without_depth: usize,
}

fn shape(
    problem: &Problem,
    camera_poses: &[Pose],
    vehicle: &Vehicle,
    estimate: &VehicleEstimate,
    method: Method,
) -> Vec<Option<Fit>> {
    let mut sightings: Vec<Vec<Sighting>> = vec![Vec::new(); vehicle.points.len()];
    for observation in &vehicle.observations {
        sightings[observation.point].extend(sighting(problem, camera_poses, estimate, observation));
    }
    let determinable = vehicle.determinable();
    let points = 0..vehicle.points.len();
    let plain: Vec<Option<(LinearPoint, Point3<f64>)>> = points
        .into_par_iter()
        .map(|point| {
            let linear = LinearPoint::new(&sightings[point], &vehicle.points[point].known);
            let plain = linear.solve().filter(|_| determinable[point])?;
            Some((linear, plain))
        })
        .collect();
    let heavy = |fit: &(LinearPoint, Point3<f64>)| fit.0.has_heavy_tails(&fit.1);
    let heavy_count = plain.iter().flatten().filter(|fit| heavy(fit)).count();
    // A plain fit may hide its gross errors; where many points have some, all are suspected.
    let all_are_suspect = heavy_count as f64 > RULES.most_gross_share * plain.iter().flatten().count() as f64;
    plain
        .into_par_iter()
        .map(|fit| {
            let fit = fit?;
            let is_suspect = method == Method::RobustWhereNeeded && (all_are_suspect || heavy(&fit));
            let (linear, plain) = fit;
            let robust = is_suspect.then(|| robust_dlt::solve(&linear, RULES.huber_sigmas)).flatten();
            let point = robust.unwrap_or(plain);
            let spread = linear.spread(&point);
            let sigma_m = linear.largest_sigma_m();
            let (is_open, has_no_depth) =
                (sigma_m * spread > RULES.open_depth_m, sigma_m > RULES.open_depth_m);
            let system = if is_open { linear.drawn_to_body(spread) } else { linear };
            let point = match (robust, is_open) {
                // Good rays scatter with the starting poses, all points of a frame alike; gross errors
                // scatter each for itself, and even a bounded pull of theirs would bend the shape.
                (Some(near), _) => system.polish(&near, spread).unwrap_or(near),
                (None, true) => system.solve()?,
                (None, false) => plain,
            };
            Some(Fit { point, robust: robust.is_some(), is_open, has_no_depth })
        })
        .collect()
}

/// Position of a target from its image points alone (and, for a point that is partly known, from
/// what is known of it); a check point's coordinates are never used.
pub fn intersect_target(problem: &Problem, camera_poses: &[Pose], target: usize) -> Option<Point3<f64>> {
    let known = match problem.targets[target].role {
        Role::Control => problem.targets[target].known,
        Role::Check => [None; 3],
    };
    let sightings: Vec<Sighting> = problem
        .target_observations
        .iter()
        .filter(|o| o.target == target)
        .filter_map(|o| ray_of(problem, camera_poses[o.frame].inverse(), &o.image_px, o.sigma_px))
        .collect();
    triangulation::triangulate(&sightings, &known).ok().map(|found| found.point)
}

fn reason_to_leave_out(problem: &Problem, vehicle: &Vehicle, estimate: &VehicleEstimate) -> Option<LeftOut> {
    let is_held = problem.vehicle_pose_sigma.is_exact() && !vehicle.misses_poses();
    let needed = if is_held { 1 } else { RULES.least_points };
    let several = vehicle.determinable().into_iter().filter(|d| *d).count();
    let found = estimate.points.iter().flatten().count();
    if vehicle.observations.is_empty() {
        Some(LeftOut::NeverSeen)
    } else if several < needed {
        Some(LeftOut::TooFewSeen { seen: several, needed })
    } else if found < needed {
        Some(LeftOut::TooFewIntersected { found, needed })
    } else {
        None
    }
}

fn warn_of_points(
    vehicle: &Vehicle,
    estimate: &VehicleEstimate,
    without_depth: usize,
    warnings: &mut Vec<InitialWarning>,
) {
    let id = || vehicle.id.clone();
    if let Some(reason) = estimate.left_out {
        warnings.push(InitialWarning::VehicleLeftOut { vehicle: id(), reason });
        return;
    }
    let determinable = vehicle.determinable();
    let single = determinable.iter().filter(|d| !**d).count();
    if single > 0 {
        warnings.push(InitialWarning::SeenOnce { vehicle: id(), points: single });
    }
    let lost = determinable.iter().zip(&estimate.points).filter(|(d, p)| **d && p.is_none()).count();
    if lost > 0 {
        warnings.push(InitialWarning::RaysDoNotMeet { vehicle: id(), points: lost });
    }
    let found = estimate.points.iter().flatten().count();
    if 2 * without_depth > found {
        warnings.push(InitialWarning::DepthOpen { vehicle: id(), points: without_depth, of: found });
    }
    if vehicle.marker.is_some_and(|marker| estimate.points[marker].is_none()) {
        warnings.push(InitialWarning::MarkerMissing { vehicle: id() });
    }
}
