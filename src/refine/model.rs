//! Problem and estimate into a system of blocks and measurements, and back.

use super::NoSolution;
use super::RefineOptions;
use super::body_frame::{ANCHOR_SIGMA_M, BodyFrame};
use super::datum::{self, Treatment};
use super::gross_errors::Excluded;
use super::images::{Images, add_camera_knowledge, add_images};
use super::motion::{Body, Motion, MotionPrior, MotionPriors, Order, TimedPose};
use super::network_warnings::NetworkWarning;
use super::outcome::Fits;
use super::receivers::{self, ReceiverBlocks, add_receivers};
use crate::camera::INTERIOR;
use crate::estimate::{Estimate, ReceiverEstimate, USUAL_AXLE, VehicleEstimate};
use crate::geometry::Pose;
use crate::problem::{GroundKnowledge, Known, Problem, Role, Vehicle};
use crate::residuals::ground_contact::{FirstContact, NextContact};
use crate::residuals::inside_body::{BODY_MIDDLE_M, InsideBody};
use crate::residuals::known_coordinate::{KnownCoordinate, KnownNumber, KnownZero};
use crate::residuals::no_side_slip::NoSideSlip;
use crate::residuals::pose_prior::PosePrior;
use crate::residuals::row_image_point::INTERIOR_BLOCK;
use crate::terrain::{NoGround, Terrain};
use nalgebra::{Point3, Rotation3, Vector3};
use trackbundle_solver::loss::{Loss, robust_spread_of_many};
use trackbundle_solver::manifold::{Manifold, read_point, read_pose, write_pose};
use trackbundle_solver::minimise::Minimiser;
use trackbundle_solver::system::{BlockId, GroupId, Measurement, System, SystemBuilder, TimeStep, Values};

/// Least standard deviations of the contact with the ground \[m, rad\]: nothing stands exactly.
pub const LEAST_CONTACT_SIGMA: (f64, f64) = (1e-4, 1e-5);
/// Rows of a contact.
const CONTACT_ROWS: usize = 3;
/// How far around a pose there must be ground for it to be tied to it \[m\].
const GROUND_AROUND_M: f64 = 1.0;
/// Least standard deviation of a known height of a body \[m\].
pub const LEAST_HEIGHT_SIGMA_M: f64 = 1e-4;

/// How far beyond the box of a body a point may stick out \[m\].
const BODY_BOX_SIGMA_M: f64 = 0.1;

/// By what the usual size of a car is loosened for points whose rays meet: it then moves none of them,
/// and yet keeps one in its place whose image points are all rejected.
const LOOSENED: f64 = 1e4;
/// Standard deviation that keeps a tie point whose image points are all rejected \[m\].
const TIE_POINT_SIGMA_M: f64 = 100.0;

/// Standard deviation of the starting shape as a whole, where nothing else knows the scale \[m\].
const STARTING_SHAPE_SIGMA_M: f64 = 0.2;

/// By what the standard deviations of conventions are multiplied where they must not pass for knowledge.
const UNCONVENTIONAL: f64 = 100.0;

/// What a model is for.
#[derive(Clone, Copy)]
pub enum Purpose<'a> {
    /// To find the minimum from afar, without the image points that are left out.
    Adjustment {
        /// What is left out.
        excluded: &'a Excluded,
    },
    /// Least squares on accepted image points and what is known: frames of bodies are held by as many
    /// coordinates as measurements leave open.
    Statistics {
        /// Which image points are accepted.
        fits: &'a Fits,
        /// What holds the frame of each vehicle.
        frames: &'a [BodyFrame],
    },
}

/// What a group of measurements is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Source {
    /// Image points of vehicles.
    VehicleImages,
    /// Image points of targets.
    TargetImages,
    /// Surveyed coordinates of targets.
    Survey,
    /// Contact of vehicles with the terrain, and its bias.
    Terrain,
    /// Known heights of bodies.
    KnownHeight,
    /// Known coordinates of shape points.
    KnownPoint,
    /// What is known of the interior orientation.
    Calibration,
    /// What is known of the readout time.
    Readout,
    /// GNSS positions.
    Gnss,
    /// What is known of clocks, lever arms and shifts of GNSS receivers.
    GnssKnowledge,
    /// Given camera poses whose standard deviations are known.
    CameraPoses,
    /// Smooth motion of cameras.
    CameraMotion,
    /// Smooth motion of vehicles.
    VehicleMotion,
    /// Rear axles that roll without slip.
    Driving,
    /// Coordinates that hold what is open of the frames of bodies.
    Frame,
    /// What is nobody's knowledge and only keeps an unknown in its place.
    Convention,
}

/// A system and where the unknowns of an estimate are in it.
pub struct Model {
    /// The least-squares problem.
    pub system: System,
    /// Index of the highest point of each vehicle whose height is known.
    pub highest_points: Vec<Option<usize>>,
    /// The motion priors.
    pub motion: Motion,
    /// What is odd about the datum.
    pub warnings: Vec<NetworkWarning>,
    /// Every group and what it is.
    pub sources: Vec<(Source, GroupId)>,
    /// For each image point of a vehicle that takes part: vehicle and observation, in the order of the group.
    pub vehicle_items: Vec<(usize, usize)>,
    /// For each image point of a target likewise its observation.
    pub target_items: Vec<usize>,
    /// For each GNSS position that takes part: receiver and position.
    pub gnss_items: Vec<(usize, usize)>,
    /// What a shift of the ground by one standard deviation does to the first row of contacts, whitened: of
    /// first and of next contacts.
    pub ground_shift: Vec<(GroupId, Vec<f64>)>,
    /// Groups of image points: of vehicles, of targets.
    images: [GroupId; 2],
    /// Groups whose rows together weigh as much as one observation of a few numbers, and how many
    /// numbers that is.
    datum: Vec<GroupId>,
    datum_rows: usize,
    blocks: Blocks,
    /// Vehicle and point of each receiver.
    receiver_points: Vec<(usize, usize)>,
}

/// Where the unknowns of an estimate are.
pub(super) struct Blocks {
    pub cameras: Vec<BlockId>,
    pub vehicles: Vec<VehicleBlocks>,
    pub targets: Vec<Option<BlockId>>,
    pub bias: BlockId,
    /// Interior orientation and readout time, where image points depend on them as unknowns or on rows.
    pub open_camera: Option<[BlockId; 2]>,
    pub receivers: Vec<Option<ReceiverBlocks>>,
}

#[derive(Default)]
pub(super) struct VehicleBlocks {
    pub poses: Vec<Option<BlockId>>,
    pub points: Vec<Option<BlockId>>,
    /// Of a car: rear axle.
    pub axle: Option<BlockId>,
}

impl Model {
    /// The system of `problem`, with values from `current` and starting poses from `start`.
    pub fn new(
        problem: &Problem,
        start: &Estimate,
        current: &Estimate,
        options: &RefineOptions,
        purpose: Purpose<'_>,
    ) -> Model {
        let mut warnings = Vec::new();
        let (cameras, warning) = datum::of_cameras(problem);
        warnings.extend(warning.map(NetworkWarning::Cameras));
        let vehicles: Vec<Treatment> =
            problem.vehicles.iter().map(|vehicle| datum::of_vehicle(problem, vehicle)).collect();
        for (vehicle, estimate) in problem.vehicles.iter().zip(&start.vehicles) {
            if estimate.left_out.is_none()
                && let Some(gap) = datum::scale_gap(problem, vehicle)
            {
                warnings.push(NetworkWarning::Scale { vehicle: vehicle.id.clone(), gap });
            }
        }
        let mut builder = SystemBuilder::default();
        let blocks = add_blocks(&mut builder, problem, current, &cameras, &vehicles);
        for (at, vehicle) in blocks.vehicles.iter().enumerate() {
            let receivers = problem.receivers.iter().zip(&blocks.receivers);
            let antennas =
                receivers.filter(|(r, _)| r.vehicle == at).filter_map(|(_, own)| Some((*own)?.antenna));
            let points = vehicle.points.iter().flatten().copied().chain(antennas).collect();
            builder.add_rigid_body(points, vehicle.poses.iter().flatten().copied().collect());
        }
        let Images { groups: images, vehicle_items, target_items } =
            add_images(&mut builder, problem, current, &blocks, purpose);
        let highest_points = highest_points(problem, current);
        let knowledge = add_knowledge(&mut builder, problem, &blocks, &highest_points);
        let mut sources = vec![(Source::VehicleImages, images[0]), (Source::TargetImages, images[1])];
        sources.extend(knowledge);
        let of_camera = add_camera_knowledge(&mut builder, problem, blocks.open_camera);
        sources.extend(
            of_camera
                .into_iter()
                .zip([Source::Calibration, Source::Readout, Source::Convention, Source::Convention])
                .map(|(group, source)| (source, group)),
        );
        let received = add_receivers(&mut builder, problem, current, &blocks, purpose, &mut warnings);
        sources.push((Source::Gnss, received.positions));
        sources.extend(received.knowledge.map(|group| (Source::GnssKnowledge, group)));
        sources.push((Source::Convention, received.conventions));
        // Frames may have been turned since, and must not be pulled back.
        let now = matches!(purpose, Purpose::Statistics { .. }).then_some(current);
        let starting = Starting { start, now, cameras: &cameras, vehicles: &vehicles };
        let poses = add_starting_poses(&mut builder, problem, &starting, &blocks, options.motion);
        let of_cameras =
            if problem.camera_pose_sigma.is_unknown() { Source::Convention } else { Source::CameraPoses };
        sources.extend([
            (of_cameras, poses[0]),
            (Source::Convention, poses[1]),
            (Source::Convention, poses[2]),
        ]);
        let poses = [poses[0], poses[1]];
        let (shapes, shape_rows) = add_starting_shapes(&mut builder, problem, start, &blocks);
        sources.push((Source::Convention, shapes));
        let free = |treatment: &Treatment| treatment.free.iter().filter(|free| **free).count();
        let adjusted = vehicles.iter().zip(&start.vehicles).filter(|(_, start)| start.left_out.is_none());
        let is_given = problem.camera_poses.iter().any(Option::is_some);
        let camera_rows = if is_given { free(&cameras) } else { 0 };
        let vehicle_rows = match purpose {
            Purpose::Adjustment { .. } => adjusted.map(|(treatment, _)| free(treatment)).sum::<usize>(),
            Purpose::Statistics { .. } => 0,
        };
        let pose_rows = camera_rows + vehicle_rows;
        let mut ground_shift = Vec::new();
        if let Some(ground) = &problem.ground {
            ground_shift = add_contacts(&mut builder, problem, ground, current, &blocks, &mut warnings);
            sources.extend(ground_shift.iter().map(|(group, _)| (Source::Terrain, *group)));
        }
        sources.push((Source::Convention, add_body_boxes(&mut builder, &blocks)));
        if let Purpose::Statistics { frames, .. } = purpose {
            sources.push((Source::Frame, add_frames(&mut builder, current, &blocks, frames)));
        }
        sources.push((Source::Convention, add_usual_sizes(&mut builder, start, &blocks)));
        sources.push((Source::Convention, add_tie_points(&mut builder, problem, current, &blocks)));
        let motion = add_motion(&mut builder, problem, current, &blocks, options.motion);
        sources.extend(motion.bodies().map(|(body, group)| match body {
            Body::Camera => (Source::CameraMotion, group),
            Body::Vehicle(_) => (Source::VehicleMotion, group),
        }));
        let (driving, kept) = add_driving(&mut builder, problem, &blocks);
        sources.extend([(Source::Driving, driving), (Source::Convention, kept)]);
        let steps = blocks.cameras.iter().enumerate().map(|(frame, camera)| TimeStep {
            observer: Some(*camera),
            bodies: blocks.vehicles.iter().filter_map(|vehicle| vehicle.poses[frame]).collect(),
        });
        builder.along_time(steps.collect(), vec![images[0]]);
        if let Purpose::Statistics { .. } = purpose {
            // Of all poses that a velocity depends on.
            builder.select_within(Order::window(options.motion.vehicle_order()) * 2 - 1);
        }
        builder.arrange(options.arrangement);
        let system = builder.build();
        Model {
            system,
            highest_points,
            motion,
            warnings,
            sources,
            vehicle_items,
            target_items,
            gnss_items: received.items,
            ground_shift,
            images,
            datum: poses.into_iter().chain([shapes]).collect(),
            datum_rows: pose_rows + shape_rows,
            blocks,
            receiver_points: problem.receivers.iter().map(|r| (r.vehicle, r.point)).collect(),
        }
    }

    /// Takes almost all weight from conventions: what they hold is then seen to be held by nothing else.
    pub fn loosen_conventions(&mut self) {
        for (_, group) in self.sources.iter().filter(|(source, _)| *source == Source::Convention) {
            self.system.set_sigma_factor(*group, UNCONVENTIONAL);
        }
    }

    /// Groups of image points: of vehicles, of targets.
    pub fn image_groups(&self) -> [GroupId; 2] {
        self.images
    }

    /// How many observations the rows of a group count as.
    pub fn counted_rows(&self, group: GroupId) -> usize {
        let rows = self.system.rows(group);
        if self.datum.contains(&group) { rows.min(self.datum_rows) } else { rows }
    }

    /// By what the standard deviations of image points are multiplied: of vehicles, of targets.
    pub fn image_factors(&self) -> [f64; 2] {
        self.images.map(|group| self.system.sigma_factor(group))
    }

    /// Sets what [`Model::image_factors`] says.
    pub fn set_image_factors(&mut self, factors: [f64; 2]) {
        for (group, factor) in self.images.into_iter().zip(factors) {
            self.system.set_sigma_factor(group, factor);
        }
    }

    /// Rows of image points and the sum of their whitened squares: of vehicles, of targets.
    pub fn image_rows(&self, values: &Values) -> [(usize, f64); 2] {
        self.images.map(|group| {
            let squares = self.system.squared_norms(group, values).into_iter().flatten().sum();
            (self.system.rows(group), squares)
        })
    }

    /// Sets the loss of all image points.
    pub fn set_image_loss(&mut self, loss: Loss) {
        self.images.iter().for_each(|group| self.system.set_loss(*group, loss));
    }

    /// Block of the camera pose of a frame.
    pub fn camera(&self, frame: usize) -> BlockId {
        self.blocks.cameras[frame]
    }

    /// Block of the pose of a vehicle in a frame.
    pub fn vehicle_pose(&self, vehicle: usize, frame: usize) -> Option<BlockId> {
        self.blocks.vehicles[vehicle].poses[frame]
    }

    /// Block of a shape point of a vehicle.
    pub fn shape_point(&self, vehicle: usize, point: usize) -> Option<BlockId> {
        self.blocks.vehicles[vehicle].points[point]
    }

    /// Block of a target.
    pub fn target(&self, target: usize) -> Option<BlockId> {
        self.blocks.targets[target]
    }

    /// Blocks of the interior orientation and of the readout time, where anything depends on them.
    pub fn open_camera(&self) -> Option<[BlockId; 2]> {
        self.blocks.open_camera
    }

    /// Block of the rear axle of a car.
    pub fn axle(&self, vehicle: usize) -> Option<BlockId> {
        self.blocks.vehicles[vehicle].axle
    }

    /// Block of the bias of the terrain.
    pub fn terrain_bias(&self) -> BlockId {
        self.blocks.bias
    }

    /// Block of clock, drift and shift of a receiver.
    pub fn receiver(&self, receiver: usize) -> Option<BlockId> {
        Some(self.blocks.receivers[receiver]?.receiver)
    }

    /// Block of the antenna of a receiver.
    pub fn antenna(&self, receiver: usize) -> Option<BlockId> {
        Some(self.blocks.receivers[receiver]?.antenna)
    }

    /// The groups of a source.
    pub fn groups_of(&self, source: Source) -> impl Iterator<Item = GroupId> {
        self.sources.iter().filter(move |(of, _)| *of == source).map(|(_, group)| *group)
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

    /// Sets the strengths of the motion priors to what true `values` scatter.
    pub fn set_motion_by_truth(&mut self, values: &Values) {
        self.motion.set_by_truth(&mut self.system, values);
    }

    /// Takes over the strengths of another model of the same problem.
    pub fn copy_motion(&mut self, other: &Model) {
        self.motion.copy(&mut self.system, &other.motion, &other.system);
    }

    /// Rows of everything but image points, and the sum of their whitened squares.
    pub fn prior_rows(&self, values: &Values) -> (usize, f64) {
        let squares =
            |group: GroupId| -> f64 { self.system.squared_norms(group, values).into_iter().flatten().sum() };
        const COUNTED: [Source; 11] = [
            Source::Calibration,
            Source::Readout,
            Source::Gnss,
            Source::GnssKnowledge,
            Source::Survey,
            Source::Terrain,
            Source::KnownHeight,
            Source::KnownPoint,
            Source::CameraMotion,
            Source::VehicleMotion,
            Source::Driving,
        ];
        let counted = self.sources.iter().filter(|(source, _)| COUNTED.contains(source));
        let counted: Vec<GroupId> = counted.map(|(_, group)| *group).collect();
        let rows: usize = counted.iter().map(|group| self.system.rows(*group)).sum();
        let rows = rows - CONTACT_ROWS * self.lost_contacts(values);
        (rows + self.datum_rows, counted.iter().chain(&self.datum).map(|group| squares(*group)).sum())
    }

    /// How many contacts with the ground have no residual, because a pose went where none is.
    pub fn lost_contacts(&self, values: &Values) -> usize {
        let lost =
            |group| self.system.squared_norms(group, values).into_iter().filter(Option::is_none).count();
        self.groups_of(Source::Terrain).map(lost).sum()
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
            if let Some(axle) = blocks.axle {
                self.system.set_value(&mut values, axle, &estimate.axle);
            }
        }
        self.set_points(&mut values, &self.blocks.targets, &estimate.targets);
        self.system.set_value(&mut values, self.blocks.bias, &[estimate.terrain_bias_m]);
        if let Some([interior, readout]) = self.blocks.open_camera {
            self.system.set_value(&mut values, interior, &estimate.camera.interior());
            self.system.set_value(&mut values, readout, &[estimate.readout_s]);
        }
        for ((own, found), (vehicle, point)) in
            self.blocks.receivers.iter().zip(&estimate.receivers).zip(&self.receiver_points)
        {
            let place = estimate.vehicles[*vehicle].points[*point];
            if let (Some(own), Some(place)) = (own, place) {
                self.system.set_value(
                    &mut values,
                    own.antenna,
                    (place + found.lever_arm_m).coords.as_slice(),
                );
                let shift = found.shift_m;
                let value = [found.clock_offset_s, found.clock_drift, shift.x, shift.y, shift.z];
                self.system.set_value(&mut values, own.receiver, &value);
            }
        }
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
        let strengths = self.motion.strengths(&self.system);
        let vehicle = |((blocks, start), vehicle): ((&VehicleBlocks, &VehicleEstimate), &Vehicle)| {
            if start.left_out.is_some() {
                return start.clone();
            }
            let mut estimate = VehicleEstimate {
                poses: blocks.poses.iter().map(|block| block.map(pose)).collect(),
                points: blocks.points.iter().map(|block| block.map(point)).collect(),
                open_depth: start.open_depth.clone(),
                axle: blocks
                    .axle
                    .map_or(start.axle, |axle| self.system.value(values, axle).try_into().expect("an axle")),
                motion: strengths
                    .iter()
                    .find(|found| found.body == Body::Vehicle(vehicle.id.clone()))
                    .map(|found| (found.order, found.strength)),
                left_out: None,
            };
            estimate.bridge_gaps(problem, vehicle);
            estimate
        };
        let vehicles = self.blocks.vehicles.iter().zip(&start.vehicles).zip(&problem.vehicles);
        let targets = self.blocks.targets.iter().zip(&start.targets);
        let (camera, readout_s) = match self.blocks.open_camera {
            None => (start.camera.clone(), start.readout_s),
            Some([interior, readout]) => {
                let numbers: [f64; INTERIOR] =
                    self.system.value(values, interior).try_into().expect("an interior orientation");
                let is_adjusted = self.system.free(interior).contains(&true);
                let camera =
                    if is_adjusted { problem.camera.with_interior(&numbers) } else { start.camera.clone() };
                (camera, self.system.value(values, readout)[0])
            }
        };
        let receiver = |((own, start), (vehicle, at)): (
            (&Option<ReceiverBlocks>, &ReceiverEstimate),
            &(usize, usize),
        )| {
            let Some((own, place)) = own.zip(self.blocks.vehicles[*vehicle].points[*at]) else {
                return *start;
            };
            let value = self.system.value(values, own.receiver);
            ReceiverEstimate {
                clock_offset_s: value[0],
                clock_drift: value[1],
                shift_m: Vector3::new(value[2], value[3], value[4]),
                lever_arm_m: point(own.antenna) - point(place),
            }
        };
        let receivers = self.blocks.receivers.iter().zip(&start.receivers).zip(&self.receiver_points);
        Estimate {
            camera_poses: self.blocks.cameras.iter().map(|block| pose(*block)).collect(),
            receivers: receivers.map(receiver).collect(),
            vehicles: vehicles.map(vehicle).collect(),
            targets: targets.map(|(block, start)| block.map(point).or(*start)).collect(),
            terrain_bias_m: self.system.value(values, self.blocks.bias)[0],
            camera,
            readout_s,
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
        open_camera: None,
        receivers: Vec::new(),
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
        if vehicle.is_car && estimate.left_out.is_none() {
            let axle = builder.add_block(Manifold::Vector(2), &estimate.axle, &[true; 2]);
            blocks.vehicles[at].axle = Some(axle);
        }
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
    blocks.open_camera = problem.has_open_camera().then(|| {
        let free = problem.calibration.map(|freedom| freedom.is_adjusted());
        let readout_is_free = problem.shutter.freedom.is_adjusted();
        [
            builder.add_block(INTERIOR_BLOCK, &current.camera.interior(), &free),
            builder.add_block(Manifold::SCALAR, &[current.readout_s], &[readout_is_free]),
        ]
    });
    blocks.receivers = receivers::add_blocks(builder, problem, current);
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

/// What is known beforehand of points, heights and the terrain as a whole.
fn add_knowledge(
    builder: &mut SystemBuilder,
    problem: &Problem,
    blocks: &Blocks,
    highest: &[Option<usize>],
) -> [(Source, GroupId); 4] {
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
    let bias = bias.into_iter().collect();
    [
        (Source::Survey, builder.add_group("surveyed coordinate of a target", Loss::Squared, survey)),
        (Source::KnownPoint, builder.add_group("known coordinate of a shape point", Loss::Squared, points)),
        (Source::KnownHeight, builder.add_group("known height of a body", Loss::Squared, heights)),
        (Source::Terrain, builder.add_group("bias of the terrain", Loss::Squared, bias)),
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
fn add_body_boxes(builder: &mut SystemBuilder, blocks: &Blocks) -> GroupId {
    let points = blocks.vehicles.iter().flat_map(|vehicle| vehicle.points.iter().flatten());
    let inside = points.map(|block| Measurement {
        residual: InsideBody,
        blocks: [*block],
        sigma: [BODY_BOX_SIGMA_M; 3],
    });
    builder.add_group("shape point inside a road vehicle", Loss::Squared, inside.collect())
}

/// What the size of road vehicles says of points: one whose rays leave its depth open lies about where
/// a car is. Takes no part in the statistics.
fn add_usual_sizes(builder: &mut SystemBuilder, start: &Estimate, blocks: &Blocks) -> GroupId {
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
    builder.add_group("usual size of a car", Loss::Squared, rows)
}

/// Holds what measurements leave open of the frames of bodies, by coordinates of their own where they are.
fn add_frames(
    builder: &mut SystemBuilder,
    current: &Estimate,
    blocks: &Blocks,
    frames: &[BodyFrame],
) -> GroupId {
    let mut rows = Vec::new();
    for ((blocks, frame), current) in blocks.vehicles.iter().zip(frames).zip(&current.vehicles) {
        for &(point, axis) in &frame.anchors {
            let (Some(block), Some(place)) = (blocks.points[point], current.points[point]) else { continue };
            let residual = KnownCoordinate { axis, known_m: place[axis] };
            rows.push(Measurement { residual, blocks: [block], sigma: [ANCHOR_SIGMA_M] });
        }
    }
    builder.add_group("frame of a body", Loss::Squared, rows)
}

/// Keeps tie points where they are should all their image points be rejected. Takes no part in the
/// statistics.
fn add_tie_points(
    builder: &mut SystemBuilder,
    problem: &Problem,
    current: &Estimate,
    blocks: &Blocks,
) -> GroupId {
    let mut rows = Vec::new();
    for ((target, block), place) in problem.targets.iter().zip(&blocks.targets).zip(&current.targets) {
        let (Some(block), Some(place)) = (*block, *place) else { continue };
        for axis in (0..3).filter(|axis| target.known[*axis].is_none()) {
            let residual = KnownCoordinate { axis, known_m: place[axis] };
            rows.push(Measurement { residual, blocks: [block], sigma: [TIE_POINT_SIGMA_M] });
        }
    }
    builder.add_group("place of a tie point", Loss::Squared, rows)
}

/// Starting poses and how they are treated.
struct Starting<'a> {
    start: &'a Estimate,
    /// Where vehicles are held instead.
    now: Option<&'a Estimate>,
    cameras: &'a Treatment,
    vehicles: &'a [Treatment],
}

fn add_starting_poses(
    builder: &mut SystemBuilder,
    problem: &Problem,
    Starting { start, now, cameras, vehicles }: &Starting,
    blocks: &Blocks,
    priors: MotionPriors,
) -> [GroupId; 3] {
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
    let of_lost = builder.add_group("pose of a camera that nothing holds", Loss::Squared, of_lost.collect());
    let mut of_vehicles = Vec::new();
    for (at, (blocks, treatment)) in blocks.vehicles.iter().zip(*vehicles).enumerate() {
        let (vehicle, cameras) = (&problem.vehicles[at], &start.camera_poses);
        // Where no pose is given, those that were found say where in the body its origin is, no more.
        let found = start.vehicles[at].poses.iter().zip(vehicle.frames_without_pose());
        let found: Vec<_> = found.map(|(pose, without)| pose.filter(|_| without)).collect();
        let given = if vehicle.has_no_poses() { &found } else { &vehicle.poses };
        let starts = now.map_or(given, |now| &now.vehicles[at].poses);
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
        of_lost,
    ]
}

fn add_contacts(
    builder: &mut SystemBuilder,
    problem: &Problem,
    ground: &GroundKnowledge,
    current: &Estimate,
    blocks: &Blocks,
    warnings: &mut Vec<NetworkWarning>,
) -> Vec<(GroupId, Vec<f64>)> {
    let (least_m, least_rad) = LEAST_CONTACT_SIGMA;
    let tilt = ground.tilt_sigma_rad.max(least_rad);
    let sigma = [ground.sigma_m.max(least_m), tilt, tilt];
    let (mut first, mut next) = (Vec::new(), Vec::new());
    let mut shifts = [Vec::new(), Vec::new()];
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
                    let seen = [pose, blocks.bias];
                    if builder.decides(&seen) {
                        shifts[0].push(ground.sigma_m / sigma[0]);
                        first.push(Measurement { residual, blocks: seen, sigma });
                    }
                }
                Some((frame_before, pose_before)) => {
                    let step_s = problem.frames[frame].time_s - problem.frames[frame_before].time_s;
                    let (residual, innovation) =
                        NextContact::after(ground.terrain.clone(), step_s, ground.correlation_s);
                    let sigma = sigma.map(|s| s * innovation);
                    let seen = [pose, pose_before, blocks.bias];
                    if builder.decides(&seen) {
                        shifts[1].push((1.0 - residual.correlation) * ground.sigma_m / sigma[0]);
                        next.push(Measurement { residual, blocks: seen, sigma });
                    }
                }
            }
            before = Some((frame, pose));
        }
        if let Some((first, reason)) = without_ground.first() {
            warnings.push(NetworkWarning::WithoutGround {
                vehicle: problem.vehicles[at].id.clone(),
                poses: without_ground.len(),
                frame: problem.frames[*first].number,
                reason: *reason,
            });
        }
    }
    let [of_first, of_next] = shifts;
    vec![
        (builder.add_group("first contact with the ground", Loss::Squared, first), of_first),
        (builder.add_group("next contact with the ground", Loss::Squared, next), of_next),
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
    current: &Estimate,
    blocks: &Blocks,
    priors: MotionPriors,
) -> Motion {
    let mut motion = Motion::default();
    let pose = |frame: usize, block: BlockId| TimedPose {
        time_s: problem.frames[frame].time_s,
        block,
        seen_from: None,
    };
    let of_camera: Vec<TimedPose> =
        blocks.cameras.iter().enumerate().map(|(frame, block)| pose(frame, *block)).collect();
    motion.add(builder, Body::Camera, &of_camera, priors.camera, false);
    for (at, (vehicle, blocks)) in problem.vehicles.iter().zip(&blocks.vehicles).enumerate() {
        let seen = |(frame, block): (usize, &Option<BlockId>)| {
            let camera = Point3::from(current.camera_poses[frame].translation.vector);
            let place = current.vehicles[at].poses[frame]?.translation.vector;
            let distance_m = (place - camera.coords).norm().max(1.0);
            Some(TimedPose { seen_from: Some((camera, distance_m)), ..pose(frame, (*block)?) })
        };
        let poses: Vec<TimedPose> = blocks.poses.iter().enumerate().filter_map(seen).collect();
        let on_ground = problem.ground.is_some();
        motion.add(builder, Body::Vehicle(vehicle.id.clone()), &poses, priors.vehicle, on_ground);
    }
    motion
}

/// Slip of a rear axle across its direction, and how long it lasts \[m/s, s\].
const SLIP: (f64, f64) = (0.1, 1.0);
/// Standard deviation of the place of a rear axle \[m\], and of the direction in which it rolls \[rad\]: nothing
/// is known of that, since the x axis of a body is a convention.
const AXLE_SIGMA_M: f64 = 1.0;
const ROLLING_SIGMA_RAD: f64 = 0.2;

/// Rear axles of cars, which roll where they point, and what only keeps their direction near the x axis.
fn add_driving(builder: &mut SystemBuilder, problem: &Problem, blocks: &Blocks) -> (GroupId, GroupId) {
    let (mut rolling, mut places, mut directions) = (Vec::new(), Vec::new(), Vec::new());
    for vehicle in &blocks.vehicles {
        let Some(axle) = vehicle.axle else { continue };
        let known = vehicle.poses.iter().enumerate().filter_map(|(frame, pose)| Some((frame, (*pose)?)));
        let known: Vec<(usize, BlockId)> = known.collect();
        for pair in known.windows(2) {
            let [(before, from), (after, to)] = [pair[0], pair[1]];
            let step_s = problem.frames[after].time_s - problem.frames[before].time_s;
            // Errors that last count once in twice that time.
            let sigma = SLIP.0 * (2.0 * SLIP.1 / step_s).max(1.0).sqrt();
            let residual = NoSideSlip { step_s };
            rolling.push(Measurement { residual, blocks: [from, to, axle], sigma: [sigma] });
        }
        let row = |at: usize, sigma: f64| {
            let residual = KnownNumber::<2> { at, known: USUAL_AXLE[at] };
            Measurement { residual, blocks: [axle], sigma: [sigma] }
        };
        places.push(row(0, AXLE_SIGMA_M));
        directions.push(row(1, ROLLING_SIGMA_RAD));
    }
    let rolling = builder.add_group("rolling of a rear axle", Loss::Squared, rolling);
    let mut kept = places;
    kept.extend(directions);
    (rolling, builder.add_group("usual rear axle", Loss::Squared, kept))
}
