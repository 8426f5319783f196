//! Image points as measurements, plain or of a camera of which something is open.

use super::blocks::Blocks;
use super::selection::Selection;
use super::sink::Sink;
use super::source::Source;
use crate::estimate::{Estimate, Imaging, RowMotion};
use crate::problem::Problem;
use crate::residuals::row_image_point::{AtRow, RowTargetImagePoint, RowVehicleImagePoint};
use crate::residuals::target_image_point::TargetImagePoint;
use crate::residuals::vehicle_image_point::VehicleImagePoint;
use nalgebra::Vector2;
use std::sync::Arc;
use trackbundle_solver::system::{BlockId, GroupId, Measurement};

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
    sink: &mut impl Sink,
    problem: &Problem,
    current: &Estimate,
    blocks: &Blocks,
    selection: &Selection,
) -> Images {
    let open = blocks.open_camera;
    let camera_decides = open.is_some_and(|open| sink.decides(&open));
    let (mut vehicle_items, mut vehicle_blocks) = (Vec::new(), Vec::new());
    for (at, (vehicle, own)) in problem.vehicles.iter().zip(&blocks.vehicles).enumerate() {
        for (item, observation) in vehicle.observations.iter().enumerate() {
            let (pose, point) = (own.poses[observation.frame], own.points[observation.point]);
            let (Some(pose), Some(point)) = (pose, point) else { continue };
            let seen = [blocks.cameras[observation.frame], pose, point];
            if selection.vehicles[at][item] && (camera_decides || sink.decides(&seen)) {
                vehicle_items.push((at, item));
                vehicle_blocks.push(seen);
            }
        }
    }
    let (mut target_items, mut target_blocks) = (Vec::new(), Vec::new());
    for (item, observation) in problem.target_observations.iter().enumerate() {
        let Some(target) = blocks.targets[observation.target] else { continue };
        let seen = [blocks.cameras[observation.frame], target];
        if selection.targets[item] && (camera_decides || sink.decides(&seen)) {
            target_items.push(item);
            target_blocks.push(seen);
        }
    }
    let items = (vehicle_items.as_slice(), target_items.as_slice());
    let seen = (vehicle_blocks, target_blocks);
    let groups = match open {
        None => add_plain(sink, problem, items, seen),
        Some(open) => add_at_rows(sink, problem, current, items, seen, open),
    };
    Images { groups, vehicle_items, target_items }
}

const NAMES: [&str; 2] = ["image point of a vehicle point", "image point of a target"];

type Items<'a> = (&'a [(usize, usize)], &'a [usize]);
type Seen = (Vec<[BlockId; 3]>, Vec<[BlockId; 2]>);

fn add_plain(
    sink: &mut impl Sink,
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
        sink.squares(Source::VehicleImages, NAMES[0], of_vehicles.collect()),
        sink.squares(Source::TargetImages, NAMES[1], of_targets.collect()),
    ]
}

fn add_at_rows(
    sink: &mut impl Sink,
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
    [
        sink.squares(Source::VehicleImages, NAMES[0], of_vehicles.collect()),
        sink.squares(Source::TargetImages, NAMES[1], of_targets.collect()),
    ]
}
