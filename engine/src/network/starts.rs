//! Starting poses: observations of the camera where their standard deviations are known, else what keeps a pose
//! where it was found.

use super::blocks::Blocks;
use super::datum::{self, Treatment};
use super::motion::{MotionPrior, MotionPriors};
use super::sink::Sink;
use super::source::Source;
use crate::estimate::Estimate;
use crate::geometry::Pose;
use crate::problem::Problem;
use crate::residuals::pose_prior::PosePrior;
use nalgebra::Rotation3;
use trackbundle_solver::system::{BlockId, GroupId, Measurement};

/// Starting poses and how they are treated.
pub struct Starting<'a> {
    /// The starting poses.
    pub start: &'a Estimate,
    /// Where vehicles are held instead.
    pub now: Option<&'a Estimate>,
    /// How given camera poses are treated.
    pub cameras: &'a Treatment,
    /// How the poses of each vehicle are treated.
    pub vehicles: &'a [Treatment],
}

/// Adds starting poses; returns the groups that together weigh as much as one observation of a few numbers.
pub fn add_starting_poses(
    sink: &mut impl Sink,
    problem: &Problem,
    starting: &Starting<'_>,
    blocks: &Blocks,
    priors: MotionPriors,
) -> Vec<GroupId> {
    let lost = datum::of_bridged_cameras(problem, priors.camera != MotionPrior::Off);
    let found = blocks.cameras.iter().zip(&starting.start.camera_poses).zip(lost);
    let of_lost = found.filter_map(|((block, pose), sigma)| Some(in_the_world(block, pose, sigma?)));
    let of_lost = of_lost.collect();
    sink.squares(Source::Convention, "pose of a camera that nothing holds", of_lost);
    let mut groups = Vec::new();
    for (source, sigma) in sources_of_cameras(problem, starting.cameras) {
        let given = blocks.cameras.iter().zip(&problem.camera_poses);
        let rows = given.filter_map(|(block, pose)| Some(in_the_world(block, pose.as_ref()?, sigma)));
        groups.push(sink.squares(source, "starting pose of a camera", rows.collect()));
    }
    let (of_vehicles, measured) = vehicle_rows(problem, starting, blocks);
    groups.push(sink.squares(Source::Convention, "starting pose of a vehicle", of_vehicles));
    sink.squares(Source::VehiclePoses, "measured pose of a vehicle", measured);
    groups
}

fn in_the_world(block: &BlockId, start: &Pose, sigma: [f64; 6]) -> Measurement<PosePrior, 6, 1> {
    let residual = PosePrior { start: *start, axes: Rotation3::identity() };
    Measurement { residual, blocks: [*block], sigma }
}

/// Components of given camera poses whose standard deviations are known are observations, the others
/// conventions: what each kind weighs, an infinite standard deviation where a component is of the other kind.
fn sources_of_cameras(problem: &Problem, cameras: &Treatment) -> Vec<(Source, [f64; 6])> {
    let is_known = problem.camera_pose_sigma.components().map(|sigma| sigma.is_some());
    let only = |known: bool| {
        std::array::from_fn(|at| if is_known[at] == known { cameras.prior_sigma[at] } else { f64::INFINITY })
    };
    match (is_known.contains(&true), is_known.contains(&false)) {
        (true, false) => vec![(Source::CameraPoses, cameras.prior_sigma)],
        (false, _) => vec![(Source::Convention, cameras.prior_sigma)],
        (true, true) => vec![(Source::CameraPoses, only(true)), (Source::Convention, only(false))],
    }
}

/// Rows of starting poses, and of poses that were measured.
fn vehicle_rows(
    problem: &Problem,
    Starting { start, now, vehicles, .. }: &Starting<'_>,
    blocks: &Blocks,
) -> (Vec<Measurement<PosePrior, 6, 1>>, Vec<Measurement<PosePrior, 6, 1>>) {
    let (mut rows, mut measured) = (Vec::new(), Vec::new());
    for (at, (blocks, treatment)) in blocks.vehicles.iter().zip(*vehicles).enumerate() {
        let (vehicle, cameras) = (&problem.vehicles[at], &start.camera_poses);
        if vehicle.has_measured_poses() {
            let given = blocks.poses.iter().zip(&vehicle.poses);
            measured.extend(given.filter_map(|(block, pose)| {
                Some(in_the_world(block.as_ref()?, pose.as_ref()?, treatment.prior_sigma))
            }));
            continue;
        }
        // Where no pose is given, those that were found say where in the body its origin is, no more.
        let found = start.vehicles[at].poses.iter().zip(vehicle.frames_without_pose());
        let found: Vec<_> = found.map(|(pose, without)| pose.filter(|_| without)).collect();
        let given = if vehicle.has_no_poses() { &found } else { &vehicle.poses };
        let starts = now.map_or(given, |now| &now.vehicles[at].poses);
        for ((block, start), camera) in blocks.poses.iter().zip(starts).zip(cameras) {
            if let (Some(block), Some(start)) = (*block, *start) {
                let residual = PosePrior { start, axes: datum::ray_axes(camera, &start) };
                rows.push(Measurement { residual, blocks: [block], sigma: treatment.prior_sigma });
            }
        }
    }
    (rows, measured)
}
