//! Results into what `viz` draws: the start, states on the way, the end as it was adjusted or as it is read back
//! from a folder, and what it is compared with.

mod compared;
mod ground;
mod images;
mod open;
mod result;

pub use compared::{add_comparison, add_map};
pub use result::{Shown, add_result};

use crate::diagnose::{Precision, TrackPrecision};
use crate::estimate::{Estimate, VehicleEstimate};
use crate::geometry::{self, quaternion_wxyz};
use crate::problem::{Known, Problem, Role, Vehicle, Video};
use crate::refine::Fits;
use images::image_points;
use trackbundle_solver::minimise::IterationRecord;
use trackbundle_viz as viz;

/// The scene before anything is adjusted.
pub fn start(problem: &Problem, start: &Estimate) -> viz::Scene {
    let frames = problem.frames.iter().map(|f| viz::Frame { number: f.number, time_s: f.time_s });
    let vehicles = problem.vehicles.iter().zip(&start.vehicles);
    viz::Scene {
        name: problem.name.clone(),
        frames: frames.collect(),
        camera: viz::Camera {
            size_px: problem.camera.size_px,
            focal_px: problem.camera.focal_px.into(),
            principal_px: problem.camera.principal_px.into(),
            before: start.camera_poses.iter().map(pose).collect(),
            after: Vec::new(),
        },
        bodies: vehicles
            .filter(|(_, estimate)| estimate.left_out.is_none())
            .map(|(vehicle, estimate)| viz::Body {
                id: vehicle.id.clone(),
                before: state(problem, vehicle, estimate, &[], &[]),
                ..viz::Body::default()
            })
            .collect(),
        targets: targets(problem, start),
        image_points: image_points(problem, None),
        ground: ground::ground(problem, start),
        ..viz::Scene::default()
    }
}

/// The film that the problem names.
pub fn film(problem: &Problem) -> Option<viz::Film> {
    problem.video.as_ref().map(|video| match video {
        Video::Images(files) => viz::Film::Images(files.clone()),
        Video::File { path, offset_s } => viz::Film::Video { file: path.clone(), offset_s: *offset_s },
    })
}

/// Adds the end of an adjustment.
pub fn add_end(
    scene: &mut viz::Scene,
    problem: &Problem,
    end: &Estimate,
    fits: &Fits,
    precision: Option<&Precision>,
) {
    let none = Precision::default();
    let precision = precision.unwrap_or(&none);
    scene.camera.after = end.camera_poses.iter().map(pose).collect();
    let vehicles = problem.vehicles.iter().zip(&end.vehicles).enumerate();
    for (at, (vehicle, estimate)) in vehicles.filter(|(_, (_, estimate))| estimate.left_out.is_none()) {
        let sigmas_m = precision.points.get(at).map_or(&[][..], Vec::as_slice);
        let of_track = precision.tracks.get(at).map_or(&[][..], Vec::as_slice);
        let after = state(problem, vehicle, estimate, sigmas_m, of_track);
        if let Some(body) = scene.bodies.iter_mut().find(|body| body.id == vehicle.id) {
            body.after = after;
        }
    }
    scene.bodies.retain(|body| !body.after.poses.is_empty());
    scene.targets = targets(problem, end);
    scene.image_points = image_points(problem, Some(&images::residuals(problem, fits)));
    open::add_open(scene);
}

/// An iteration with the state after it.
pub fn iteration(
    problem: &Problem,
    stage: &'static str,
    record: &IterationRecord,
    estimate: &Estimate,
) -> viz::Iteration {
    let vehicles = problem.vehicles.iter().zip(&estimate.vehicles);
    let body = |(vehicle, estimate): (&Vehicle, &VehicleEstimate)| viz::BodySnapshot {
        id: vehicle.id.clone(),
        track_m: estimate.places(vehicle).map(|(_, place)| place.coords.into()).collect(),
        points_m: estimate.points.iter().flatten().map(|p| p.coords.into()).collect(),
    };
    viz::Iteration {
        stage,
        cost: record.cost,
        damping: record.damping,
        step: (record.iteration > 0).then_some(record.step),
        state: viz::Snapshot {
            camera: estimate.camera_poses.iter().map(pose).collect(),
            bodies: vehicles.filter(|(_, estimate)| estimate.left_out.is_none()).map(body).collect(),
        },
    }
}

fn pose(pose: &geometry::Pose) -> viz::Pose {
    viz::Pose { position_m: pose.translation.vector.into(), quaternion_wxyz: quaternion_wxyz(pose) }
}

/// A state with its standard deviations, of each point and of each place of the track, where there are some.
fn state(
    problem: &Problem,
    vehicle: &Vehicle,
    estimate: &VehicleEstimate,
    sigmas_m: &[Option<[f64; 3]>],
    of_track: &[Option<TrackPrecision>],
) -> viz::State {
    let poses = vehicle.span().filter_map(|frame| Some((frame, pose(&estimate.poses[frame]?))));
    let track = estimate.track(problem, vehicle).into_iter().enumerate();
    let sigmas_m = estimate.points.iter().zip(sigmas_m).filter(|(point, _)| point.is_some());
    viz::State {
        points_m: estimate.points.iter().flatten().map(|p| p.coords.into()).collect(),
        sigmas_m: sigmas_m.map(|(_, sigma)| *sigma).collect(),
        poses: poses.collect(),
        track: track
            .map(|(at, t)| viz::TrackPoint {
                frame: t.frame,
                position_m: t.position.coords.into(),
                speed_mps: t.speed_mps,
                heading_deg: t.heading_rad.to_degrees(),
                precision: of_track.get(at).and_then(Option::as_ref).map(track_precision),
            })
            .collect(),
    }
}

fn track_precision(found: &TrackPrecision) -> viz::TrackPrecision {
    viz::TrackPrecision {
        sigma_m: found.position_m,
        covariance_xy_m2: found.covariance_xy_m2.unwrap_or(f64::INFINITY),
        sigma_speed_mps: found.speed_mps,
        sigma_heading_deg: found.heading_rad.to_degrees(),
    }
}

fn targets(problem: &Problem, estimate: &Estimate) -> Vec<viz::Target> {
    let target = |(target, found): (&crate::problem::Target, &Option<nalgebra::Point3<f64>>)| {
        let (role, position) = match target.role {
            Role::Check => (viz::TargetRole::Check, target.surveyed()?),
            Role::Control if target.is_surveyed() => (viz::TargetRole::Control, (*found)?),
            Role::Control => (viz::TargetRole::Tie, (*found)?),
        };
        let sigma = |known: Option<Known>| Some(known?.sigma_m);
        let [x, y, z] = target.known.map(sigma);
        let sigma_m = (|| Some([x?, y?, z?]))();
        Some(viz::Target { id: target.id.clone(), role, position_m: position.coords.into(), sigma_m })
    };
    problem.targets.iter().zip(&estimate.targets).filter_map(target).collect()
}
