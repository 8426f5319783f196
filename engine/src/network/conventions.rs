//! Priors without information content: they regularise, keep an unknown in its place, or hold a datum that nothing
//! else holds, and take no part in the statistics.

use super::blocks::{Blocks, VehicleBlocks};
use super::datum;
use super::selection::Anchors;
use super::sink::Sink;
use super::source::Source;
use crate::estimate::{Depth, Estimate};
use crate::problem::Problem;
use crate::residuals::inside_body::{BODY_BOX_M, BODY_MIDDLE_M, InsideBody};
use crate::residuals::known_coordinate::KnownCoordinate;
use crate::residuals::same_point::SamePoint;
use trackbundle_solver::system::{GroupId, Measurement};

/// How far beyond the box of a body a point may stick out \[m\].
const BODY_BOX_SIGMA_M: f64 = 0.1;

/// By what the usual size of a car is loosened for points whose rays meet: it then moves none of them,
/// and yet keeps one in its place whose image points are all rejected.
const LOOSENED: f64 = 1e4;
/// By what it is loosened for points that are told better: hundreds of these together may be known to a hundredth of it,
/// and are held by each of them.
const TOLD: f64 = 10.0;
/// How far apart two unknowns are that are one point \[m\]: nothing pulls at them that this would not hold.
const SAME_POINT_SIGMA_M: f64 = 1e-4;
/// Standard deviation that keeps a tie point whose image points are all rejected \[m\].
const TIE_POINT_SIGMA_M: f64 = 100.0;

/// Standard deviation of the starting shape as a whole, where nothing else knows the scale \[m\].
pub const STARTING_SHAPE_SIGMA_M: f64 = 0.2;

/// Standard deviation of a coordinate that holds an open direction of the frame of a body \[m\]: about that of a
/// point, so that the system stays well conditioned. It has no effect on what is transformed to inner constraints.
const ANCHOR_SIGMA_M: f64 = 0.01;

/// Where nothing fixes the scale of a vehicle, its origin and its shape would drift apart along the
/// rays: its shape in `held` keeps it where it is, with the weight of one observation.
pub fn add_starting_shapes(
    sink: &mut impl Sink,
    problem: &Problem,
    held: &Estimate,
    blocks: &Blocks,
) -> (GroupId, usize) {
    let mut rows = Vec::new();
    let mut numbers = 0;
    for ((vehicle, blocks), held) in problem.vehicles.iter().zip(&blocks.vehicles).zip(&held.vehicles) {
        if datum::scale_gap(problem, vehicle).is_none() {
            continue;
        }
        let points: Vec<_> =
            blocks.points.iter().zip(&held.points).filter_map(|(b, p)| Some(((*b)?, (*p)?))).collect();
        let sigma_m = STARTING_SHAPE_SIGMA_M * (points.len() as f64).sqrt();
        numbers += if points.is_empty() { 0 } else { 3 };
        for (block, point) in points {
            for axis in 0..3 {
                let residual = KnownCoordinate { axis, known_m: point[axis] };
                rows.push(Measurement { residual, blocks: [block], sigma: [sigma_m] });
            }
        }
    }
    (sink.squares(Source::Convention, "starting shape", rows), numbers)
}

/// Keeps points without depth near the body. Takes no part in the statistics.
pub fn add_body_boxes(sink: &mut impl Sink, blocks: &Blocks) -> GroupId {
    let points = blocks.vehicles.iter().flat_map(|vehicle| vehicle.points.iter().flatten());
    let inside = points.map(|block| Measurement {
        residual: InsideBody,
        blocks: [*block],
        sigma: [BODY_BOX_SIGMA_M; 3],
    });
    sink.squares(Source::Convention, "shape point inside a road vehicle", inside.collect())
}

/// What the size of road vehicles says of points: one whose rays leave its depth open lies about where
/// a car is. Takes no part in the statistics.
pub fn add_usual_sizes(sink: &mut impl Sink, start: &Estimate, blocks: &Blocks) -> GroupId {
    add_places(sink, start, blocks, &|_, _| Some(BODY_MIDDLE_M.map(|(middle_m, _)| middle_m)))
}

/// The same in the last least squares, where nothing that is nobody's knowledge may pull: points are held where they are
/// now, or at the side of a road vehicle that they have left.
pub fn add_present_places(
    sink: &mut impl Sink,
    start: &Estimate,
    current: &Estimate,
    blocks: &Blocks,
) -> GroupId {
    add_places(sink, start, blocks, &|vehicle, point| {
        let place = current.vehicles[vehicle].points[point]?;
        Some(std::array::from_fn(|axis| {
            let [lower, upper] = BODY_BOX_M[axis];
            place[axis].clamp(lower, upper)
        }))
    })
}

/// By how many half sizes of a car a point is held in its place, as a standard deviation.
pub fn half_sizes(depth: Depth) -> f64 {
    match depth {
        Depth::Known => LOOSENED,
        Depth::Told => TOLD,
        Depth::Weak | Depth::Open => 1.0,
    }
}

/// Keeps points without depth near a place, by vehicle and point.
fn add_places(
    sink: &mut impl Sink,
    start: &Estimate,
    blocks: &Blocks,
    place: &dyn Fn(usize, usize) -> Option<[f64; 3]>,
) -> GroupId {
    let mut rows = Vec::new();
    for (vehicle, (blocks, start)) in blocks.vehicles.iter().zip(&start.vehicles).enumerate() {
        for (point, (block, depth)) in blocks.points.iter().zip(&start.depths).enumerate() {
            let (Some(block), Some(place_m)) = (*block, place(vehicle, point)) else { continue };
            for (axis, (_, half_size_m)) in BODY_MIDDLE_M.into_iter().enumerate() {
                rows.push(Measurement {
                    residual: KnownCoordinate { axis, known_m: place_m[axis] },
                    blocks: [block],
                    sigma: [half_size_m * half_sizes(*depth)],
                });
            }
        }
    }
    sink.squares(Source::Convention, "usual size of a car", rows)
}

/// Holds what measurements leave open of the frames of bodies, by coordinates of their own where they are.
pub fn add_frames(sink: &mut impl Sink, current: &Estimate, blocks: &Blocks, anchors: &[Anchors]) {
    let mut rows = Vec::new();
    for ((blocks, anchors), current) in blocks.vehicles.iter().zip(anchors).zip(&current.vehicles) {
        for &(point, axis) in anchors {
            let (Some(block), Some(place)) = (blocks.points[point], current.points[point]) else { continue };
            let residual = KnownCoordinate { axis, known_m: place[axis] };
            rows.push(Measurement { residual, blocks: [block], sigma: [ANCHOR_SIGMA_M] });
        }
    }
    sink.squares(Source::Frame, "frame of a body", rows);
}

/// Says of which point of its shape the motion of a vehicle is told: a definition, no measurement.
pub fn add_middles(sink: &mut impl Sink, blocks: &Blocks) -> GroupId {
    let tie = |vehicle: &VehicleBlocks| {
        let middle = vehicle.middle?;
        let blocks = [middle.block, vehicle.points[middle.point]?];
        Some(Measurement { residual: SamePoint, blocks, sigma: [SAME_POINT_SIGMA_M; 3] })
    };
    let ties = blocks.vehicles.iter().filter_map(tie).collect();
    sink.squares(Source::Frame, "point that motion is told of", ties)
}

/// Keeps tie points where they are should all their image points be rejected. Takes no part in the
/// statistics.
pub fn add_tie_points(sink: &mut impl Sink, problem: &Problem, current: &Estimate, blocks: &Blocks) {
    let mut rows = Vec::new();
    for ((target, block), place) in problem.targets.iter().zip(&blocks.targets).zip(&current.targets) {
        let (Some(block), Some(place)) = (*block, *place) else { continue };
        for axis in (0..3).filter(|axis| target.known[*axis].is_none()) {
            let residual = KnownCoordinate { axis, known_m: place[axis] };
            rows.push(Measurement { residual, blocks: [block], sigma: [TIE_POINT_SIGMA_M] });
        }
    }
    sink.squares(Source::Convention, "place of a tie point", rows);
}
