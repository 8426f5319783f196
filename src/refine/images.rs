//! Image points as measurements, plain or of a camera of which something is open.

use super::model::{Blocks, Purpose};
use crate::estimate::{Estimate, Imaging, RowMotion};
use crate::problem::{Freedom, Problem};
use crate::residuals::known_coordinate::KnownNumber;
use crate::residuals::row_image_point::{AtRow, RowTargetImagePoint, RowVehicleImagePoint};
use crate::residuals::target_image_point::TargetImagePoint;
use crate::residuals::vehicle_image_point::VehicleImagePoint;
use nalgebra::Vector2;
use std::sync::Arc;
use trackbundle_solver::loss::Loss;
use trackbundle_solver::system::{BlockId, GroupId, Measurement, SystemBuilder};

/// Groups of image points and which observations are in them.
pub struct Images {
    /// Of vehicles, of targets.
    pub groups: [GroupId; 2],
    /// Vehicle and observation of each image point of a vehicle.
    pub vehicle_items: Vec<(usize, usize)>,
    /// Observation of each image point of a target.
    pub target_items: Vec<usize>,
}

/// Adds the image points that take part.
pub fn add_images(
    builder: &mut SystemBuilder,
    problem: &Problem,
    current: &Estimate,
    blocks: &Blocks,
    purpose: Purpose<'_>,
) -> Images {
    let takes_vehicle = |vehicle: usize, item: usize| match purpose {
        Purpose::Adjustment { excluded } => excluded.vehicles[vehicle][item].is_none(),
        Purpose::Statistics { fits, .. } => fits.vehicles[vehicle][item].is_some_and(|fit| fit.is_accepted()),
    };
    let takes_target = |item: usize| match purpose {
        Purpose::Adjustment { excluded } => excluded.targets[item].is_none(),
        Purpose::Statistics { fits, .. } => fits.targets[item].is_some_and(|fit| fit.is_accepted()),
    };
    let open = blocks.open_camera;
    let decides = |builder: &SystemBuilder, seen: &[BlockId]| {
        builder.decides(seen) || open.is_some_and(|open| builder.decides(&open))
    };
    let (mut vehicle_items, mut vehicle_blocks) = (Vec::new(), Vec::new());
    for (at, (vehicle, own)) in problem.vehicles.iter().zip(&blocks.vehicles).enumerate() {
        for (item, observation) in vehicle.observations.iter().enumerate() {
            let (pose, point) = (own.poses[observation.frame], own.points[observation.point]);
            let (Some(pose), Some(point)) = (pose, point) else { continue };
            let seen = [blocks.cameras[observation.frame], pose, point];
            if decides(builder, &seen) && takes_vehicle(at, item) {
                vehicle_items.push((at, item));
                vehicle_blocks.push(seen);
            }
        }
    }
    let (mut target_items, mut target_blocks) = (Vec::new(), Vec::new());
    for (item, observation) in problem.target_observations.iter().enumerate() {
        let Some(target) = blocks.targets[observation.target] else { continue };
        let seen = [blocks.cameras[observation.frame], target];
        if decides(builder, &seen) && takes_target(item) {
            target_items.push(item);
            target_blocks.push(seen);
        }
    }
    let items = (vehicle_items.as_slice(), target_items.as_slice());
    let seen = (vehicle_blocks, target_blocks);
    let groups = match open {
        None => add_plain(builder, problem, items, seen),
        Some(open) => add_at_rows(builder, problem, current, items, seen, open),
    };
    Images { groups, vehicle_items, target_items }
}

const NAMES: [&str; 2] = ["image point of a vehicle point", "image point of a target"];

type Items<'a> = (&'a [(usize, usize)], &'a [usize]);
type Seen = (Vec<[BlockId; 3]>, Vec<[BlockId; 2]>);

fn add_plain(
    builder: &mut SystemBuilder,
    problem: &Problem,
    (vehicle_items, target_items): Items<'_>,
    (vehicle_blocks, target_blocks): Seen,
) -> [GroupId; 2] {
    let camera = Arc::new(problem.camera.clone());
    let of_vehicles = vehicle_items.iter().zip(vehicle_blocks).map(|(&(vehicle, item), blocks)| {
        let seen = &problem.vehicles[vehicle].observations[item];
        let residual = VehicleImagePoint { camera: camera.clone(), observed_px: seen.image_px };
        Measurement { residual, blocks, sigma: [seen.sigma_px; 2] }
    });
    let of_targets = target_items.iter().zip(target_blocks).map(|(&item, blocks)| {
        let seen = &problem.target_observations[item];
        let residual = TargetImagePoint { camera: camera.clone(), observed_px: seen.image_px };
        Measurement { residual, blocks, sigma: [seen.sigma_px; 2] }
    });
    [
        builder.add_group(NAMES[0], Loss::Squared, of_vehicles.collect()),
        builder.add_group(NAMES[1], Loss::Squared, of_targets.collect()),
    ]
}

fn add_at_rows(
    builder: &mut SystemBuilder,
    problem: &Problem,
    current: &Estimate,
    (vehicle_items, target_items): Items<'_>,
    (vehicle_blocks, target_blocks): Seen,
    [interior, readout]: [BlockId; 2],
) -> [GroupId; 2] {
    let camera = Arc::new(problem.camera.clone());
    let motion = RowMotion::new(problem, current);
    let imaging = Imaging::of_motion(motion.clone(), current);
    let share = |computed_px: Option<Vector2<f64>>, observed_px: &Vector2<f64>| {
        camera.row_delay(computed_px.unwrap_or(*observed_px).y)
    };
    let of_vehicles = vehicle_items.iter().zip(vehicle_blocks).map(|(&(vehicle, item), [c, v, point])| {
        let seen = &problem.vehicles[vehicle].observations[item];
        let twist = motion.vehicles[vehicle][seen.frame];
        let computed_px = imaging.vehicle_px(vehicle, seen.frame, seen.point);
        let (observed_px, row_share) = (seen.image_px, share(computed_px, &seen.image_px));
        let residual = RowVehicleImagePoint(AtRow { camera: camera.clone(), observed_px, row_share, twist });
        Measurement { residual, blocks: [c, v, point, interior, readout], sigma: [seen.sigma_px; 2] }
    });
    let of_targets = target_items.iter().zip(target_blocks).map(|(&item, [c, target])| {
        let seen = &problem.target_observations[item];
        let twist = motion.world[seen.frame];
        let place = current.targets[seen.target];
        let computed_px = place.and_then(|place| imaging.target_px(seen.frame, &place));
        let (observed_px, row_share) = (seen.image_px, share(computed_px, &seen.image_px));
        let residual = RowTargetImagePoint(AtRow { camera: camera.clone(), observed_px, row_share, twist });
        Measurement { residual, blocks: [c, target, interior, readout], sigma: [seen.sigma_px; 2] }
    });
    builder.share(vec![interior, readout]);
    [
        builder.add_group(NAMES[0], Loss::Squared, of_vehicles.collect()),
        builder.add_group(NAMES[1], Loss::Squared, of_targets.collect()),
    ]
}

/// By what a number of an interior orientation that is free is kept near its start: as much as no lens is off.
fn conventional(problem: &Problem, at: usize) -> f64 {
    let camera = &problem.camera;
    match at {
        0 => 0.2 * camera.focal_px.x,
        1 | 2 => 0.2 * f64::from(camera.size_px[0]),
        _ => 1.0,
    }
}

/// By what a readout time that is free is kept near its start \[s\].
const CONVENTIONAL_READOUT_S: f64 = 0.1;

/// What is known of the camera beforehand, and what only keeps it near its start.
pub fn add_camera_knowledge(
    builder: &mut SystemBuilder,
    problem: &Problem,
    open: Option<[BlockId; 2]>,
) -> [GroupId; 4] {
    let (mut known, mut kept, mut readout_known, mut readout_kept) =
        (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    if let Some([interior, readout]) = open {
        for (at, (freedom, value)) in problem.calibration.iter().zip(problem.camera.interior()).enumerate() {
            let row = |sigma: f64| Measurement {
                residual: KnownNumber::<{ crate::camera::INTERIOR }> { at, known: value },
                blocks: [interior],
                sigma: [sigma],
            };
            match *freedom {
                Freedom::Fixed => {}
                Freedom::Prior(sigma) => known.push(row(sigma)),
                Freedom::Free => kept.push(row(conventional(problem, at))),
            }
        }
        let row = |sigma: f64| Measurement {
            residual: KnownNumber::<1> { at: 0, known: problem.shutter.readout_s },
            blocks: [readout],
            sigma: [sigma],
        };
        match problem.shutter.freedom {
            Freedom::Fixed => {}
            Freedom::Prior(sigma) => readout_known.push(row(sigma)),
            Freedom::Free => readout_kept.push(row(CONVENTIONAL_READOUT_S)),
        }
    }
    [
        builder.add_group("known interior orientation", Loss::Squared, known),
        builder.add_group("known readout time", Loss::Squared, readout_known),
        builder.add_group("start of the interior orientation", Loss::Squared, kept),
        builder.add_group("start of the readout time", Loss::Squared, readout_kept),
    ]
}
