//! Problem and estimate into a system of blocks and measurements, and back.

use super::NoSolution;
use super::RefineOptions;
use super::datum::{self, Treatment};
use super::gross_errors::Excluded;
use super::motion::{Body, Motion, MotionPrior, MotionPriors};
use crate::estimate::{Estimate, VehicleEstimate};
use crate::geometry::Pose;
use crate::nlls::loss::{Loss, robust_spread_of_many};
use crate::nlls::manifold::{Manifold, read_point, read_pose, write_pose};
use crate::nlls::minimise::Minimiser;
use crate::nlls::system::{BlockId, GroupId, Measurement, System, SystemBuilder, TimeStep, Values};
use crate::problem::{GroundKnowledge, Known, Problem, Role};
use crate::residuals::ground_contact::{FirstContact, NextContact};
use crate::residuals::inside_body::{BODY_MIDDLE_M, InsideBody};
use crate::residuals::known_coordinate::{KnownCoordinate, KnownZero};
use crate::residuals::pose_prior::PosePrior;
use crate::residuals::target_image_point::TargetImagePoint;
use crate::residuals::vehicle_image_point::VehicleImagePoint;
use crate::terrain::{NoGround, Terrain};
use nalgebra::{Point3, Rotation3};
use std::sync::Arc;

/// Least standard deviations of the contact with the ground \[m, rad\]: nothing stands exactly.
const LEAST_CONTACT_SIGMA: (f64, f64) = (1e-4, 1e-5);
/// Rows of a contact.
const CONTACT_ROWS: usize = 3;
/// How far around a pose there must be ground for it to be tied to it \[m\].
const GROUND_AROUND_M: f64 = 1.0;
/// Least standard deviation of a known height of a body \[m\].
const LEAST_HEIGHT_SIGMA_M: f64 = 1e-4;

/// How far beyond the box of a body a point may stick out \[m\].
const BODY_BOX_SIGMA_M: f64 = 0.1;

/// By what the usual size of a car is loosened for points whose rays meet: it then moves none of them,
/// and yet keeps one in its place whose image points are all rejected.
const LOOSENED: f64 = 1e4;
/// Standard deviation that keeps a tie point whose image points are all rejected \[m\].
const TIE_POINT_SIGMA_M: f64 = 100.0;

/// Standard deviation of the starting shape as a whole, where nothing else knows the scale \[m\].
const STARTING_SHAPE_SIGMA_M: f64 = 0.2;

/// A system and where the unknowns of an estimate are in it.
pub struct Model {
    /// The least-squares problem.
    pub system: System,
    /// Index of the highest point of each vehicle whose height is known.
    pub highest_points: Vec<Option<usize>>,
    /// The motion priors.
    pub motion: Motion,
    /// What is odd about the datum.
    pub warnings: Vec<String>,
    /// Groups of image points: of vehicles, of targets.
    images: [GroupId; 2],
    /// Every other group whose rows are observations of their own, but those of motion.
    priors: Vec<GroupId>,
    /// Groups whose rows together weigh as much as one observation of a few numbers, and how many
    /// numbers that is.
    datum: Vec<GroupId>,
    datum_rows: usize,
    blocks: Blocks,
}

struct Blocks {
    cameras: Vec<BlockId>,
    vehicles: Vec<VehicleBlocks>,
    targets: Vec<Option<BlockId>>,
    bias: BlockId,
}

#[derive(Default)]
struct VehicleBlocks {
    poses: Vec<Option<BlockId>>,
    points: Vec<Option<BlockId>>,
}

impl Model {
    /// The system of `problem` without the image points that are left out, with values from `current` and
    /// starting poses from `start`.
    pub fn new(
        problem: &Problem,
        start: &Estimate,
        current: &Estimate,
        options: &RefineOptions,
        excluded: &Excluded,
    ) -> Model {
        let mut warnings = Vec::new();
        let (cameras, warning) = datum::of_cameras(problem);
        warnings.extend(warning);
        let vehicles: Vec<Treatment> =
            problem.vehicles.iter().map(|vehicle| datum::of_vehicle(problem, vehicle)).collect();
        for (vehicle, estimate) in problem.vehicles.iter().zip(&start.vehicles) {
            if estimate.left_out.is_none()
                && let Some(gap) = datum::scale_gap(problem, vehicle)
            {
                warnings.push(format!(
                    "scale of {}: held only by the starting poses ({gap}); size, height and track are wrong by one common share",
                    vehicle.id
                ));
            }
        }
        let mut builder = SystemBuilder::default();
        let blocks = add_blocks(&mut builder, problem, current, &cameras, &vehicles);
        for vehicle in &blocks.vehicles {
            let points = vehicle.points.iter().flatten().copied().collect();
            builder.add_rigid_body(points, vehicle.poses.iter().flatten().copied().collect());
        }
        let images = add_images(&mut builder, problem, &blocks, excluded);
        let highest_points = highest_points(problem, current);
        let mut groups = add_knowledge(&mut builder, problem, &blocks, &highest_points);
        let starting = Starting { start, cameras: &cameras, vehicles: &vehicles };
        let poses = add_starting_poses(&mut builder, problem, &starting, &blocks, options.motion);
        let (shapes, shape_rows) = add_starting_shapes(&mut builder, problem, start, &blocks);
        let free = |treatment: &Treatment| treatment.free.iter().filter(|free| **free).count();
        let adjusted = vehicles.iter().zip(&start.vehicles).filter(|(_, start)| start.left_out.is_none());
        let is_given = problem.camera_poses.iter().any(Option::is_some);
        let camera_rows = if is_given { free(&cameras) } else { 0 };
        let pose_rows = camera_rows + adjusted.map(|(treatment, _)| free(treatment)).sum::<usize>();
        if let Some(ground) = &problem.ground {
            groups.extend(add_contacts(&mut builder, problem, ground, current, &blocks, &mut warnings));
        }
        add_body_boxes(&mut builder, &blocks);
        add_usual_sizes(&mut builder, start, &blocks);
        add_tie_points(&mut builder, problem, current, &blocks);
        let motion = add_motion(&mut builder, problem, &blocks, options.motion);
        let steps = blocks.cameras.iter().enumerate().map(|(frame, camera)| TimeStep {
            observer: Some(*camera),
            bodies: blocks.vehicles.iter().filter_map(|vehicle| vehicle.poses[frame]).collect(),
        });
        builder.along_time(steps.collect(), vec![images[0]]);
        builder.arrange(options.arrangement);
        let system = builder.build();
        Model {
            system,
            highest_points,
            motion,
            warnings,
            images,
            priors: groups,
            datum: poses.into_iter().chain([shapes]).collect(),
            datum_rows: pose_rows + shape_rows,
            blocks,
        }
    }

    /// Sets the loss of all image points.
    pub fn set_image_loss(&mut self, loss: Loss) {
        self.images.iter().for_each(|group| self.system.set_loss(*group, loss));
    }

    /// Robust spread of the whitened image points of vehicles: 1 where their sigmas are right.
    pub fn spread(&self, values: &Values) -> f64 {
        let squares = self.system.squared_norms(self.images[0], values);
        robust_spread_of_many(squares.into_iter().map(|s| s.unwrap_or(f64::INFINITY)).collect())
    }

    /// Share of the image points of vehicles that are off by more than so many standard deviations.
    pub fn share_beyond(&self, values: &Values, limit: f64) -> f64 {
        let squares = self.system.squared_norms(self.images[0], values);
        let beyond =
            squares.iter().filter(|square| square.is_none_or(|square| square > limit * limit)).count();
        beyond as f64 / squares.len().max(1) as f64
    }

    /// Estimates the strength of the motion priors anew and returns the largest factor by which one
    /// changes.
    pub fn estimate_motion(&mut self, minimiser: &mut Minimiser, values: &Values) -> Result<f64, NoSolution> {
        self.motion.estimate(&mut self.system, minimiser, values)
    }

    /// Takes over the strengths of another model of the same problem.
    pub fn copy_motion(&mut self, other: &Model) {
        self.motion.copy(&mut self.system, &other.motion, &other.system);
    }

    /// Rows of everything but image points, and the sum of their whitened squares.
    pub fn prior_rows(&self, values: &Values) -> (usize, f64) {
        let squares =
            |group: GroupId| -> f64 { self.system.squared_norms(group, values).into_iter().flatten().sum() };
        let counted: Vec<GroupId> = self.priors.iter().copied().chain(self.motion.groups()).collect();
        let rows: usize = counted.iter().map(|group| self.system.rows(*group)).sum();
        let rows = rows - CONTACT_ROWS * self.lost_contacts(values);
        (rows + self.datum_rows, counted.iter().chain(&self.datum).map(|group| squares(*group)).sum())
    }

    /// How many contacts with the ground have no residual, because a pose went where none is.
    pub fn lost_contacts(&self, values: &Values) -> usize {
        let lost = |group: &GroupId| {
            self.system.squared_norms(*group, values).into_iter().filter(Option::is_none).count()
        };
        // No other of the priors can be without a residual.
        self.priors.iter().map(lost).sum()
    }

    /// The values of an estimate.
    pub fn values(&self, estimate: &Estimate) -> Values {
        let mut values = self.system.start().clone();
        for (block, pose) in self.blocks.cameras.iter().zip(&estimate.camera_poses) {
            self.system.set_value(&mut values, *block, &write_pose(pose));
        }
        for (blocks, estimate) in self.blocks.vehicles.iter().zip(&estimate.vehicles) {
            for (block, pose) in blocks.poses.iter().zip(&estimate.poses) {
                if let (Some(block), Some(pose)) = (block, pose) {
                    self.system.set_value(&mut values, *block, &write_pose(pose));
                }
            }
            self.set_points(&mut values, &blocks.points, &estimate.points);
        }
        self.set_points(&mut values, &self.blocks.targets, &estimate.targets);
        self.system.set_value(&mut values, self.blocks.bias, &[estimate.terrain_bias_m]);
        values
    }

    fn set_points(&self, values: &mut Values, blocks: &[Option<BlockId>], points: &[Option<Point3<f64>>]) {
        for (block, point) in blocks.iter().zip(points) {
            if let (Some(block), Some(point)) = (block, point) {
                self.system.set_value(values, *block, point.coords.as_slice());
            }
        }
    }

    /// The estimate of values; what is not in the system is as in `start`.
    pub fn estimate(&self, problem: &Problem, start: &Estimate, values: &Values) -> Estimate {
        let pose = |block: BlockId| read_pose(self.system.value(values, block));
        let point = |block: BlockId| read_point(self.system.value(values, block));
        let vehicle = |((blocks, start), vehicle): ((&VehicleBlocks, &VehicleEstimate), _)| {
            if start.left_out.is_some() {
                return start.clone();
            }
            let mut estimate = VehicleEstimate {
                poses: blocks.poses.iter().map(|block| block.map(pose)).collect(),
                points: blocks.points.iter().map(|block| block.map(point)).collect(),
                open_depth: start.open_depth.clone(),
                left_out: None,
            };
            estimate.bridge_gaps(problem, vehicle);
            estimate
        };
        let vehicles = self.blocks.vehicles.iter().zip(&start.vehicles).zip(&problem.vehicles);
        let targets = self.blocks.targets.iter().zip(&start.targets);
        Estimate {
            camera_poses: self.blocks.cameras.iter().map(|block| pose(*block)).collect(),
            vehicles: vehicles.map(vehicle).collect(),
            targets: targets.map(|(block, start)| block.map(point).or(*start)).collect(),
            terrain_bias_m: self.system.value(values, self.blocks.bias)[0],
        }
    }
}

/// The highest point of each vehicle whose height is known, among those that are seen at least half
/// as often as most: a point that is hardly seen may lie anywhere.
pub fn highest_points(problem: &Problem, estimate: &Estimate) -> Vec<Option<usize>> {
    let of_vehicle = |(vehicle, estimate): (&crate::problem::Vehicle, &VehicleEstimate)| {
        vehicle.height?;
        let sightings = vehicle.sightings();
        let mut sorted = sightings.clone();
        sorted.sort_unstable();
        let enough = sorted.get(sorted.len() / 2)? / 2;
        let height = |point: usize| estimate.points[point].map(|p| (p.z, point));
        (0..vehicle.points.len())
            .filter(|point| sightings[*point] >= enough)
            .filter_map(height)
            .max_by(|a, b| a.0.total_cmp(&b.0))
            .map(|(_, point)| point)
    };
    problem.vehicles.iter().zip(&estimate.vehicles).map(of_vehicle).collect()
}

/// Blocks in the order in which they are best eliminated: frames along time, then what all share.
fn add_blocks(
    builder: &mut SystemBuilder,
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
    };
    let without_pose: Vec<Vec<bool>> = problem.vehicles.iter().map(|v| v.frames_without_pose()).collect();
    for frame in 0..problem.frames.len() {
        let pose = write_pose(&current.camera_poses[frame]);
        let free = if problem.camera_poses[frame].is_some() { cameras.free } else { [true; 6] };
        blocks.cameras.push(builder.add_block(Manifold::Pose, &pose, &free));
        for (at, vehicle) in problem.vehicles.iter().enumerate() {
            let estimate = &current.vehicles[at];
            let in_span = vehicle.span().contains(&frame) && estimate.left_out.is_none();
            // A pose that was found is not held, however exact those are that were given.
            let free = if without_pose[at][frame] { [true; 6] } else { vehicles[at].free };
            let block = estimate.poses[frame]
                .filter(|_| in_span)
                .map(|pose| builder.add_block(Manifold::Pose, &write_pose(&pose), &free));
            blocks.vehicles[at].poses.push(block);
        }
    }
    for (at, vehicle) in problem.vehicles.iter().enumerate() {
        let estimate = &current.vehicles[at];
        for (shape_point, point) in vehicle.points.iter().zip(&estimate.points) {
            let point = point.filter(|_| estimate.left_out.is_none());
            blocks.vehicles[at].points.push(add_point(builder, point, &shape_point.known));
        }
    }
    for (target, point) in problem.targets.iter().zip(&current.targets) {
        let point = point.filter(|_| target.role == Role::Control);
        blocks.targets.push(add_point(builder, point, &target.known));
    }
    let bias_is_free = problem.ground.as_ref().is_some_and(|ground| ground.bias_sigma_m > 0.0);
    blocks.bias = builder.add_block(Manifold::SCALAR, &[current.terrain_bias_m], &[bias_is_free]);
    blocks
}

/// Adds a point; a coordinate that is known exactly is held at what it is known to be.
fn add_point(
    builder: &mut SystemBuilder,
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
    Some(builder.add_block(Manifold::POINT, point.coords.as_slice(), &free))
}

fn add_images(
    builder: &mut SystemBuilder,
    problem: &Problem,
    blocks: &Blocks,
    excluded: &Excluded,
) -> [GroupId; 2] {
    let camera = Arc::new(problem.camera.clone());
    let mut of_vehicles = Vec::new();
    for (at, (vehicle, vehicle_blocks)) in problem.vehicles.iter().zip(&blocks.vehicles).enumerate() {
        let left_in =
            vehicle.observations.iter().zip(&excluded.vehicles[at]).filter(|(_, out)| out.is_none());
        for (observation, _) in left_in {
            let pose = vehicle_blocks.poses[observation.frame];
            let (Some(pose), Some(point)) = (pose, vehicle_blocks.points[observation.point]) else {
                continue;
            };
            of_vehicles.push(Measurement {
                residual: VehicleImagePoint { camera: camera.clone(), observed_px: observation.image_px },
                blocks: [blocks.cameras[observation.frame], pose, point],
                sigma: [observation.sigma_px; 2],
            });
        }
    }
    let mut of_targets = Vec::new();
    let left_in = problem.target_observations.iter().zip(&excluded.targets).filter(|(_, out)| out.is_none());
    for (observation, _) in left_in {
        let Some(target) = blocks.targets[observation.target] else { continue };
        of_targets.push(Measurement {
            residual: TargetImagePoint { camera: camera.clone(), observed_px: observation.image_px },
            blocks: [blocks.cameras[observation.frame], target],
            sigma: [observation.sigma_px; 2],
        });
    }
    [
        builder.add_group("image point of a vehicle point", Loss::Squared, of_vehicles),
        builder.add_group("image point of a target", Loss::Squared, of_targets),
    ]
}

/// What is known beforehand of points, heights and the terrain as a whole.
fn add_knowledge(
    builder: &mut SystemBuilder,
    problem: &Problem,
    blocks: &Blocks,
    highest: &[Option<usize>],
) -> Vec<GroupId> {
    let coordinates =
        |block: Option<BlockId>, known: &[Option<Known>; 3]| -> Vec<Measurement<KnownCoordinate, 1, 1>> {
            let Some(block) = block else { return Vec::new() };
            let one = |axis: usize| {
                let Known { value_m: known_m, sigma_m } = known[axis].filter(|known| known.sigma_m > 0.0)?;
                Some(Measurement {
                    residual: KnownCoordinate { axis, known_m },
                    blocks: [block],
                    sigma: [sigma_m],
                })
            };
            (0..3).filter_map(one).collect()
        };
    let of_targets = problem.targets.iter().zip(&blocks.targets);
    let survey = of_targets.flat_map(|(target, block)| coordinates(*block, &target.known)).collect();
    let (mut points, mut heights) = (Vec::new(), Vec::new());
    for ((vehicle, vehicle_blocks), highest) in problem.vehicles.iter().zip(&blocks.vehicles).zip(highest) {
        for (point, block) in vehicle.points.iter().zip(&vehicle_blocks.points) {
            points.extend(coordinates(*block, &point.known));
        }
        let highest = highest.and_then(|point| vehicle_blocks.points[point]);
        if let (Some(block), Some(Known { value_m: known_m, sigma_m })) = (highest, vehicle.height) {
            let residual = KnownCoordinate { axis: 2, known_m };
            heights.push(Measurement {
                residual,
                blocks: [block],
                sigma: [sigma_m.max(LEAST_HEIGHT_SIGMA_M)],
            });
        }
    }
    let bias_sigma_m = problem.ground.as_ref().map_or(0.0, |ground| ground.bias_sigma_m);
    let bias = (bias_sigma_m > 0.0).then_some(Measurement {
        residual: KnownZero,
        blocks: [blocks.bias],
        sigma: [bias_sigma_m],
    });
    vec![
        builder.add_group("surveyed coordinate of a target", Loss::Squared, survey),
        builder.add_group("known coordinate of a shape point", Loss::Squared, points),
        builder.add_group("known height of a body", Loss::Squared, heights),
        builder.add_group("bias of the terrain", Loss::Squared, bias.into_iter().collect()),
    ]
}

/// Where nothing fixes the scale of a vehicle, its origin and its shape would drift apart along the
/// rays: the starting shape holds it where it is, with the weight of one observation.
fn add_starting_shapes(
    builder: &mut SystemBuilder,
    problem: &Problem,
    start: &Estimate,
    blocks: &Blocks,
) -> (GroupId, usize) {
    let mut rows = Vec::new();
    let mut numbers = 0;
    for ((vehicle, blocks), start) in problem.vehicles.iter().zip(&blocks.vehicles).zip(&start.vehicles) {
        if datum::scale_gap(problem, vehicle).is_none() {
            continue;
        }
        let points: Vec<_> =
            blocks.points.iter().zip(&start.points).filter_map(|(b, p)| Some(((*b)?, (*p)?))).collect();
        let sigma_m = STARTING_SHAPE_SIGMA_M * (points.len() as f64).sqrt();
        numbers += if points.is_empty() { 0 } else { 3 };
        for (block, point) in points {
            for axis in 0..3 {
                let residual = KnownCoordinate { axis, known_m: point[axis] };
                rows.push(Measurement { residual, blocks: [block], sigma: [sigma_m] });
            }
        }
    }
    (builder.add_group("starting shape", Loss::Squared, rows), numbers)
}

/// Keeps points without depth near the body. Takes no part in the statistics.
fn add_body_boxes(builder: &mut SystemBuilder, blocks: &Blocks) {
    let points = blocks.vehicles.iter().flat_map(|vehicle| vehicle.points.iter().flatten());
    let inside = points.map(|block| Measurement {
        residual: InsideBody,
        blocks: [*block],
        sigma: [BODY_BOX_SIGMA_M; 3],
    });
    builder.add_group("shape point inside a road vehicle", Loss::Squared, inside.collect());
}

/// What the size of road vehicles says of points: one whose rays leave its depth open lies about where
/// a car is. Takes no part in the statistics.
fn add_usual_sizes(builder: &mut SystemBuilder, start: &Estimate, blocks: &Blocks) {
    let mut rows = Vec::new();
    for (blocks, start) in blocks.vehicles.iter().zip(&start.vehicles) {
        for (block, is_open) in blocks.points.iter().zip(&start.open_depth) {
            let Some(block) = *block else { continue };
            for (axis, (middle_m, half_size_m)) in BODY_MIDDLE_M.into_iter().enumerate() {
                rows.push(Measurement {
                    residual: KnownCoordinate { axis, known_m: middle_m },
                    blocks: [block],
                    sigma: [half_size_m * if *is_open { 1.0 } else { LOOSENED }],
                });
            }
        }
    }
    builder.add_group("usual size of a car", Loss::Squared, rows);
}

/// Keeps tie points where they are should all their image points be rejected. Takes no part in the
/// statistics.
fn add_tie_points(builder: &mut SystemBuilder, problem: &Problem, current: &Estimate, blocks: &Blocks) {
    let mut rows = Vec::new();
    for ((target, block), place) in problem.targets.iter().zip(&blocks.targets).zip(&current.targets) {
        let (Some(block), Some(place)) = (*block, *place) else { continue };
        for axis in (0..3).filter(|axis| target.known[*axis].is_none()) {
            let residual = KnownCoordinate { axis, known_m: place[axis] };
            rows.push(Measurement { residual, blocks: [block], sigma: [TIE_POINT_SIGMA_M] });
        }
    }
    builder.add_group("place of a tie point", Loss::Squared, rows);
}

/// Starting poses and how they are treated.
struct Starting<'a> {
    start: &'a Estimate,
    cameras: &'a Treatment,
    vehicles: &'a [Treatment],
}

fn add_starting_poses(
    builder: &mut SystemBuilder,
    problem: &Problem,
    Starting { start, cameras, vehicles }: &Starting,
    blocks: &Blocks,
    priors: MotionPriors,
) -> [GroupId; 2] {
    let row = |block: &BlockId, start: &Pose, sigma: [f64; 6]| Measurement {
        residual: PosePrior { start: *start, axes: Rotation3::identity() },
        blocks: [*block],
        sigma,
    };
    let given = blocks.cameras.iter().zip(&problem.camera_poses);
    let of_cameras = given.filter_map(|(block, pose)| Some(row(block, pose.as_ref()?, cameras.prior_sigma)));
    let of_cameras = of_cameras.collect();
    let lost = datum::of_bridged_cameras(problem, priors.camera != MotionPrior::Off);
    let found = blocks.cameras.iter().zip(&start.camera_poses).zip(lost);
    let of_lost = found.filter_map(|((block, pose), sigma)| Some(row(block, pose, sigma?)));
    // Takes no part in the statistics.
    builder.add_group("pose of a camera that nothing holds", Loss::Squared, of_lost.collect());
    let mut of_vehicles = Vec::new();
    for (at, (blocks, treatment)) in blocks.vehicles.iter().zip(*vehicles).enumerate() {
        let (vehicle, cameras) = (&problem.vehicles[at], &start.camera_poses);
        // Where no pose is given, those that were found say where in the body its origin is, no more.
        let found = start.vehicles[at].poses.iter().zip(vehicle.frames_without_pose());
        let found: Vec<_> = found.map(|(pose, without)| pose.filter(|_| without)).collect();
        let starts = if vehicle.has_no_poses() { &found } else { &vehicle.poses };
        for ((block, start), camera) in blocks.poses.iter().zip(starts).zip(cameras) {
            if let (Some(block), Some(start)) = (*block, *start) {
                let residual = PosePrior { start, axes: datum::ray_axes(camera, &start) };
                of_vehicles.push(Measurement { residual, blocks: [block], sigma: treatment.prior_sigma });
            }
        }
    }
    [
        builder.add_group("starting pose of a camera", Loss::Squared, of_cameras),
        builder.add_group("starting pose of a vehicle", Loss::Squared, of_vehicles),
    ]
}

fn add_contacts(
    builder: &mut SystemBuilder,
    problem: &Problem,
    ground: &GroundKnowledge,
    current: &Estimate,
    blocks: &Blocks,
    warnings: &mut Vec<String>,
) -> [GroupId; 2] {
    let (least_m, least_rad) = LEAST_CONTACT_SIGMA;
    let tilt = ground.tilt_sigma_rad.max(least_rad);
    let sigma = [ground.sigma_m.max(least_m), tilt, tilt];
    let (mut first, mut next) = (Vec::new(), Vec::new());
    for (at, vehicle) in blocks.vehicles.iter().enumerate() {
        let mut before: Option<(usize, BlockId)> = None;
        let mut without_ground = Vec::new();
        for (frame, pose) in vehicle.poses.iter().enumerate() {
            let (Some(pose), Some(place)) = (*pose, &current.vehicles[at].poses[frame]) else { continue };
            if let Err(reason) = ground_around(&ground.terrain, place) {
                without_ground.push((frame, reason));
                continue;
            }
            match before {
                None => {
                    let residual = FirstContact { terrain: ground.terrain.clone() };
                    first.push(Measurement { residual, blocks: [pose, blocks.bias], sigma });
                }
                Some((frame_before, pose_before)) => {
                    let step_s = problem.frames[frame].time_s - problem.frames[frame_before].time_s;
                    let (residual, innovation) =
                        NextContact::after(ground.terrain.clone(), step_s, ground.correlation_s);
                    let sigma = sigma.map(|s| s * innovation);
                    next.push(Measurement { residual, blocks: [pose, pose_before, blocks.bias], sigma });
                }
            }
            before = Some((frame, pose));
        }
        if let Some((first, reason)) = without_ground.first() {
            warnings.push(format!(
                "vehicle {}: poses without ground below them, which no terrain ties: {}, the first in frame {} \
                 ({reason})",
                problem.vehicles[at].id,
                without_ground.len(),
                problem.frames[*first].number
            ));
        }
    }
    [
        builder.add_group("first contact with the ground", Loss::Squared, first),
        builder.add_group("next contact with the ground", Loss::Squared, next),
    ]
}

/// Whether there is ground below a pose, and as far around it as it is likely to move: beyond, a
/// contact would have no residual, and the step that leads there would be refused.
fn ground_around(terrain: &Terrain, pose: &Pose) -> Result<(), NoGround> {
    let r = GROUND_AROUND_M;
    for [dx, dy] in [[0.0, 0.0], [r, 0.0], [-r, 0.0], [0.0, r], [0.0, -r]] {
        terrain.at(pose.translation.x + dx, pose.translation.y + dy)?;
    }
    Ok(())
}

fn add_motion(
    builder: &mut SystemBuilder,
    problem: &Problem,
    blocks: &Blocks,
    priors: MotionPriors,
) -> Motion {
    let time = |frame: usize| problem.frames[frame].time_s;
    let with_time = |poses: &mut dyn Iterator<Item = Option<BlockId>>| -> Vec<(f64, BlockId)> {
        poses.enumerate().filter_map(|(frame, block)| Some((time(frame), block?))).collect()
    };
    let mut motion = Motion::default();
    let camera = with_time(&mut blocks.cameras.iter().copied().map(Some));
    motion.add(builder, Body::Camera, &camera, priors.camera);
    for (vehicle, blocks) in problem.vehicles.iter().zip(&blocks.vehicles) {
        let poses = with_time(&mut blocks.poses.iter().copied());
        motion.add(builder, Body::Vehicle(vehicle.id.clone()), &poses, priors.vehicle);
    }
    motion
}
