//! The unknowns: which blocks there are, and whose.

use super::datum::Treatment;
use super::sink::{Owner, Sink};
use crate::estimate::{Estimate, ReceiverEstimate};
use crate::problem::{Known, Problem, Receiver, Role, Vehicle};
use crate::residuals::antenna_position::RECEIVER;
use crate::residuals::row_image_point::INTERIOR_BLOCK;
use crate::stats::quantile::upper_median;
use nalgebra::Point3;
use trackbundle_solver::manifold::{Manifold, write_pose};
use trackbundle_solver::system::BlockId;

/// Where the unknowns of an estimate are.
pub struct Blocks {
    /// The camera of each frame.
    pub cameras: Vec<BlockId>,
    /// Those of each vehicle.
    pub vehicles: Vec<VehicleBlocks>,
    /// Each target that takes part.
    pub targets: Vec<Option<BlockId>>,
    /// The bias of the terrain.
    pub bias: BlockId,
    /// Interior orientation and readout time, where image points depend on them as unknowns or on rows.
    pub open_camera: Option<[BlockId; 2]>,
    /// Those of each receiver; `None` where its point has no place.
    pub receivers: Vec<Option<ReceiverBlocks>>,
}

/// The unknowns of a vehicle.
#[derive(Default)]
pub struct VehicleBlocks {
    /// Its pose in each frame that has one.
    pub poses: Vec<Option<BlockId>>,
    /// Each of its points that has a place.
    pub points: Vec<Option<BlockId>>,
    /// Of a car: rear axle.
    pub axle: Option<BlockId>,
    /// The point that its motion is told of.
    pub middle: Option<MiddleBlock>,
}

/// The point of a vehicle that its motion is told of: one of its shape that lies in the middle of what is seen. It has
/// a block of its own, beside what image points see, so that vehicles can be eliminated one by one.
#[derive(Clone, Copy, Debug)]
pub struct MiddleBlock {
    /// Its own block.
    pub block: BlockId,
    /// Which point of the shape it is.
    pub point: usize,
    /// Where that is in the vehicle frame \[m\].
    pub place: Point3<f64>,
}

/// The blocks of a receiver.
#[derive(Clone, Copy, Debug)]
pub struct ReceiverBlocks {
    /// Its antenna in the vehicle frame.
    pub antenna: BlockId,
    /// Clock offset, drift, shift.
    pub receiver: BlockId,
}

/// Blocks in the order in which they are best eliminated: frames along time, then what all share.
pub fn add_blocks(
    sink: &mut impl Sink,
    problem: &Problem,
    current: &Estimate,
    cameras: &Treatment,
    vehicles: &[Treatment],
) -> Blocks {
    let mut blocks = Blocks {
        cameras: Vec::new(),
        vehicles: problem.vehicles.iter().map(|_| VehicleBlocks::default()).collect(),
        targets: Vec::new(),
        bias: BlockId::default(),
        open_camera: None,
        receivers: Vec::new(),
    };
    let without_pose: Vec<Vec<bool>> = problem.vehicles.iter().map(|v| v.frames_without_pose()).collect();
    for frame in 0..problem.frames.len() {
        let pose = write_pose(&current.camera_poses[frame]);
        let free = if problem.camera_poses[frame].is_some() { cameras.free } else { [true; 6] };
        blocks.cameras.push(sink.block(Owner::Camera(frame), Manifold::Pose, &pose, &free));
        for (at, vehicle) in problem.vehicles.iter().enumerate() {
            let estimate = &current.vehicles[at];
            let in_span = vehicle.span().contains(&frame) && estimate.left_out.is_none();
            // A pose that was found is not held, however exact those are that were given.
            let free = if without_pose[at][frame] { [true; 6] } else { vehicles[at].free };
            let block = estimate.poses[frame]
                .filter(|_| in_span)
                .map(|pose| sink.block(Owner::Pose(at, frame), Manifold::Pose, &write_pose(&pose), &free));
            blocks.vehicles[at].poses.push(block);
        }
    }
    for (at, vehicle) in problem.vehicles.iter().enumerate() {
        let estimate = &current.vehicles[at];
        if vehicle.is_car && estimate.left_out.is_none() {
            let axle = sink.block(Owner::Axle(at), Manifold::Vector(2), &estimate.axle, &[true; 2]);
            blocks.vehicles[at].axle = Some(axle);
        }
        for (index, (shape_point, point)) in vehicle.points.iter().zip(&estimate.points).enumerate() {
            let point = point.filter(|_| estimate.left_out.is_none());
            let block = add_point(sink, Owner::Point(at, index), point, &shape_point.known);
            blocks.vehicles[at].points.push(block);
        }
        blocks.vehicles[at].middle =
            middle_of_what_is_seen(vehicle, &estimate.points, &blocks.vehicles[at].points).map(
                |(point, place)| {
                    let block =
                        sink.block(Owner::Middle(at), Manifold::POINT, place.coords.as_slice(), &[true; 3]);
                    MiddleBlock { block, point, place }
                },
            );
    }
    for (at, (target, point)) in problem.targets.iter().zip(&current.targets).enumerate() {
        let point = point.filter(|_| target.role == Role::Control);
        blocks.targets.push(add_point(sink, Owner::Target(at), point, &target.known));
    }
    let bias_is_free = problem.ground.as_ref().is_some_and(|ground| ground.bias_sigma_m > 0.0);
    blocks.bias = sink.block(Owner::Bias, Manifold::SCALAR, &[current.terrain_bias_m], &[bias_is_free]);
    blocks.open_camera = problem.has_open_camera().then(|| {
        let free = problem.calibration.map(|freedom| freedom.is_adjusted());
        let readout_is_free = problem.shutter.freedom.is_adjusted();
        [
            sink.block(Owner::Interior, INTERIOR_BLOCK, &current.camera.interior(), &free),
            sink.block(Owner::Readout, Manifold::SCALAR, &[current.readout_s], &[readout_is_free]),
        ]
    });
    blocks.receivers = add_receivers(sink, problem, current);
    blocks
}

/// The adjusted point that is nearest to the middle of what is seen of a vehicle: of each coordinate of its points, each
/// as often as it is seen. `None` without points.
fn middle_of_what_is_seen(
    vehicle: &Vehicle,
    points: &[Option<Point3<f64>>],
    blocks: &[Option<BlockId>],
) -> Option<(usize, Point3<f64>)> {
    let seen: Vec<Point3<f64>> =
        vehicle.observations.iter().filter_map(|observation| points[observation.point]).collect();
    let middle = |axis: usize| upper_median(seen.iter().map(|point| point[axis]).collect());
    let middle = Point3::new(middle(0)?, middle(1)?, middle(2)?);
    let adjusted = points.iter().zip(blocks).enumerate();
    let adjusted = adjusted.filter_map(|(at, (place, block))| block.and_then(|_| Some((at, (*place)?))));
    adjusted.min_by(|(_, a), (_, b)| (a - middle).norm().total_cmp(&(b - middle).norm()))
}

/// Adds a point; a coordinate that is known exactly is held at what it is known to be.
fn add_point(
    sink: &mut impl Sink,
    owner: Owner,
    point: Option<Point3<f64>>,
    known: &[Option<Known>; 3],
) -> Option<BlockId> {
    let mut point = point?;
    let mut free = [true; 3];
    for axis in 0..3 {
        if let Some(Known { value_m, sigma_m: 0.0 }) = known[axis] {
            point[axis] = value_m;
            free[axis] = false;
        }
    }
    Some(sink.block(owner, Manifold::POINT, point.coords.as_slice(), &free))
}

/// The blocks of all receivers; `None` where the point of one has no place.
fn add_receivers(sink: &mut impl Sink, problem: &Problem, current: &Estimate) -> Vec<Option<ReceiverBlocks>> {
    let mut of_receiver = |(at, (receiver, found)): (usize, (&Receiver, &ReceiverEstimate))| {
        let antenna = current.antenna(receiver, found)?;
        let known = &receiver.knowledge;
        let drifts = known.drift_sigma > 0.0;
        let shifts = known.shift_sigma_m > 0.0;
        let has_offset = known.clock_offset.is_none_or(|offset| offset.sigma_s > 0.0);
        let free = [has_offset, drifts, shifts, shifts, shifts];
        let place = antenna.coords;
        Some(ReceiverBlocks {
            antenna: sink.block(Owner::Antenna(at), Manifold::POINT, place.as_slice(), &[true; 3]),
            receiver: sink.block(Owner::Receiver(at), RECEIVER, &found.numbers(), &free),
        })
    };
    problem.receivers.iter().zip(&current.receivers).enumerate().map(&mut of_receiver).collect()
}
