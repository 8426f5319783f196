//! Results into what `viz` draws.

mod ground;

use crate::diagnose::{Precision, TrackPrecision};
use crate::estimate::{Estimate, VehicleEstimate};
use crate::geometry::{self, quaternion_wxyz};
use crate::nlls::minimise::IterationRecord;
use crate::problem::{Known, Problem, Role, Vehicle};
use crate::refine::{Fits, ObservationFit};
use trackbundle_viz as viz;

/// The scene of an adjustment from `start` to `end`; the two are the same where nothing was adjusted.
pub fn scene(
    problem: &Problem,
    start: &Estimate,
    end: &Estimate,
    fits: &Fits,
    precision: Option<&Precision>,
    iterations: &[IterationRecord],
    summary: String,
) -> viz::Scene {
    let none = Precision::default();
    let precision = precision.unwrap_or(&none);
    let frames = problem.frames.iter().map(|f| viz::Frame { number: f.number, time_s: f.time_s });
    viz::Scene {
        name: problem.name.clone(),
        frames: frames.collect(),
        camera: viz::Camera {
            size_px: problem.camera.size_px,
            focal_px: problem.camera.focal_px.into(),
            principal_px: problem.camera.principal_px.into(),
            before: start.camera_poses.iter().map(pose).collect(),
            after: end.camera_poses.iter().map(pose).collect(),
        },
        bodies: bodies(problem, start, end, precision),
        targets: targets(problem, end),
        image_points: image_points(problem, fits),
        ground: ground::ground(problem, end),
        iterations: iterations
            .iter()
            .map(|r| viz::Iteration { cost: r.cost, damping: r.damping, step: r.step })
            .collect(),
        summary,
    }
}

fn pose(pose: &geometry::Pose) -> viz::Pose {
    viz::Pose { position_m: pose.translation.vector.into(), quaternion_wxyz: quaternion_wxyz(pose) }
}

fn bodies(problem: &Problem, start: &Estimate, end: &Estimate, precision: &Precision) -> Vec<viz::Body> {
    let pairs = start.vehicles.iter().zip(&end.vehicles).zip(&problem.vehicles).enumerate();
    pairs
        .filter(|(_, ((_, end), _))| end.left_out.is_none())
        .map(|(at, ((start, end), vehicle))| viz::Body {
            id: vehicle.id.clone(),
            before: state(problem, vehicle, start, &[], &[]),
            after: state(
                problem,
                vehicle,
                end,
                precision.points.get(at).map_or(&[], Vec::as_slice),
                precision.tracks.get(at).map_or(&[], Vec::as_slice),
            ),
        })
        .collect()
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

fn targets(problem: &Problem, end: &Estimate) -> Vec<viz::Target> {
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
    problem.targets.iter().zip(&end.targets).filter_map(target).collect()
}

fn image_points(problem: &Problem, fits: &Fits) -> Vec<Vec<viz::ImagePoint>> {
    let mut frames = vec![Vec::new(); problem.frames.len()];
    let point =
        |kind, observed_px: nalgebra::Vector2<f64>, takes_part: bool, fit: &Option<ObservationFit>| {
            viz::ImagePoint {
                kind,
                observed_px: observed_px.into(),
                computed_px: fit.map(|fit| (observed_px - fit.residual_px).into()),
                marking: match fit {
                    Some(fit) if takes_part && !fit.is_outlier => viz::Marking::Good,
                    Some(_) if takes_part => viz::Marking::Rejected,
                    _ => viz::Marking::NotUsed,
                },
            }
        };
    for (vehicle, fits) in problem.vehicles.iter().zip(&fits.vehicles) {
        for (o, fit) in vehicle.observations.iter().zip(fits) {
            frames[o.frame].push(point(viz::ImagePointKind::Body, o.image_px, true, fit));
        }
    }
    for (o, fit) in problem.target_observations.iter().zip(&fits.targets) {
        let takes_part = problem.targets[o.target].role == Role::Control;
        frames[o.frame].push(point(viz::ImagePointKind::Target, o.image_px, takes_part, fit));
    }
    frames
}
