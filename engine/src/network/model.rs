//! A network as a least-squares system, and where its unknowns are in it.

use super::blocks::{Blocks, VehicleBlocks};
use super::contact::CONTACT_ROWS;
use super::datum::{self, Treatment};
use super::declare::{Declaration, Declared, declare};
use super::highest::Highest;
use super::motion::{Motion, MotionPriors, Order};
use super::selection::{Purpose, Selection};
use super::sink::SystemSink;
use super::source::Source;
use super::warnings::NetworkWarning;
use crate::estimate::Estimate;
use crate::problem::Problem;
use crate::residuals::inside_body::BODY_MIDDLE_M;
use nalgebra::Matrix3;
use trackbundle_solver::Singular;
use trackbundle_solver::loss::{Loss, robust_spread_of_many};
use trackbundle_solver::minimise::Minimiser;
use trackbundle_solver::system::{Arrangement, BlockId, GroupId, System, SystemBuilder, TimeStep, Values};

/// By what the standard deviations of conventions are multiplied where they must not pass for knowledge.
const UNCONVENTIONAL: f64 = 100.0;
/// By what those of starting shapes are in the last least squares, where a relief may know a scale: it then decides it in a
/// round or two.
pub const LOOSENED_SHAPES: f64 = 10.0;

/// What of a network a user may choose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NetworkOptions {
    /// The motion priors.
    pub motion: MotionPriors,
    /// How vehicles are eliminated; without effect on the result.
    pub arrangement: Arrangement,
}

/// A system and where the unknowns of an estimate are in it.
pub struct Model {
    /// The least-squares problem.
    pub system: System,
    /// What stands for the highest point of each vehicle whose height is known.
    pub highest_points: Vec<Option<Highest>>,
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
    /// Those of starting shapes, where nothing knows the scale.
    shapes: GroupId,
    /// By what their standard deviations are multiplied in the last least squares.
    shapes_before: f64,
    /// What keeps points without depth in their places.
    places: GroupId,
    /// What keeps points within a road vehicle.
    boxes: GroupId,
    /// What says which points motion is told of.
    middles: GroupId,
    /// Whether it is that of the last least squares.
    is_final: bool,
    blocks: Blocks,
    /// Vehicle and point of each receiver.
    receiver_points: Vec<(usize, usize)>,
}

impl Model {
    /// The system of `problem`, with values from `current` and starting poses from `start`.
    pub fn new(
        problem: &Problem,
        start: &Estimate,
        current: &Estimate,
        options: NetworkOptions,
        selection: &Selection,
        purpose: Purpose<'_>,
    ) -> Model {
        let (cameras, warning) = datum::of_cameras(problem);
        let vehicles: Vec<Treatment> =
            problem.vehicles.iter().map(|vehicle| datum::of_vehicle(problem, vehicle)).collect();
        let mut warnings: Vec<NetworkWarning> = warning.map(NetworkWarning::Cameras).into_iter().collect();
        warnings.extend(scale_warnings(problem, start));
        let NetworkOptions { motion, arrangement } = options;
        let (cameras, vehicles) = (&cameras, vehicles.as_slice());
        let declaration =
            Declaration { problem, start, current, cameras, vehicles, motion, selection, purpose };
        let mut sink = SystemSink::default();
        let declared = declare(&mut sink, &declaration);
        let SystemSink { mut builder, sources } = sink;
        arrange(&mut builder, problem, &declared, motion, purpose);
        builder.arrange(arrangement);
        let Declared { blocks, images, highest_points, gnss_items, ground_shift, motion, datum, .. } =
            declared;
        warnings.extend(declared.warnings);
        Model {
            system: builder.build(),
            highest_points,
            motion,
            warnings,
            sources,
            vehicle_items: images.vehicle_items,
            target_items: images.target_items,
            gnss_items,
            ground_shift,
            images: images.groups,
            datum,
            datum_rows: pose_rows(&declaration) + declared.shape_rows,
            shapes: declared.shapes,
            shapes_before: if problem.may_have_relief() { LOOSENED_SHAPES } else { 1.0 },
            places: declared.places,
            boxes: declared.boxes,
            middles: declared.middles,
            is_final: matches!(purpose, Purpose::Statistics { .. }),
            blocks,
            receiver_points: problem.receivers.iter().map(|r| (r.vehicle, r.point)).collect(),
        }
    }

    /// The group that says which points motion is told of.
    pub fn middles(&self) -> GroupId {
        self.middles
    }

    /// How many unknowns are adjusted, each once.
    pub fn parameters(&self) -> usize {
        self.system.parameters() - self.system.rows(self.middles)
    }

    /// Where the unknowns are.
    pub(super) fn blocks(&self) -> &Blocks {
        &self.blocks
    }

    /// Vehicle and point of each receiver.
    pub(super) fn receiver_points(&self) -> &[(usize, usize)] {
        &self.receiver_points
    }

    /// Takes almost all weight from conventions: what they hold is then seen to be held by nothing else.
    pub fn loosen_conventions(&mut self) {
        self.loosen_all_but(&[]);
    }

    fn loosen_all_but(&mut self, kept: &[GroupId]) {
        let is_loosened =
            |(source, group): &&(Source, GroupId)| *source == Source::Convention && !kept.contains(group);
        for (_, group) in self.sources.iter().filter(is_loosened) {
            self.system.set_sigma_factor(*group, UNCONVENTIONAL);
        }
    }

    /// The same of all that is not needed while the last least squares goes on: starting shapes keep the scale of a
    /// vehicle where it is while nothing knows it, points without depth must stay somewhere, and all within a vehicle.
    pub fn loosen_for_least_squares(&mut self) {
        self.loosen_all_but(&self.kept());
        self.system.set_sigma_factor(self.shapes, self.shapes_before);
    }

    /// Conventions that the last least squares keeps.
    fn kept(&self) -> [GroupId; 3] {
        [self.shapes, self.places, self.boxes]
    }

    /// What a convention weighed in the last least squares over what it weighs now that it is loosened.
    pub fn weight_before(&self, group: GroupId) -> f64 {
        let before = if group == self.shapes { self.shapes_before } else { 1.0 };
        if self.is_final && self.kept().contains(&group) { (UNCONVENTIONAL / before).powi(2) } else { 1.0 }
    }

    /// For each vehicle and point its largest standard deviation over half the size of a car, all else taken as known, were
    /// it held by nothing but what was measured or is known.
    pub fn open_places(&self, values: &Values) -> Vec<Vec<Option<f64>>> {
        let held: Vec<GroupId> = self.groups_of(Source::Frame).chain([self.places]).collect();
        let normals = self.system.own_normals_without(values, &held);
        let largest = |block: BlockId| -> f64 {
            let free = self.system.free(block);
            // In half sizes; what is held exactly has no variance.
            let normal = Matrix3::from_fn(|i, j| match free[i] && free[j] {
                true => normals.of(block)[(i, j)] * BODY_MIDDLE_M[i].1 * BODY_MIDDLE_M[j].1,
                false => f64::from(u8::from(i == j)) / f64::EPSILON,
            });
            normal.cholesky().map_or(f64::INFINITY, |factor| factor.inverse().diagonal().max().sqrt())
        };
        let of_vehicle =
            |vehicle: &VehicleBlocks| vehicle.points.iter().map(|block| block.map(largest)).collect();
        self.blocks.vehicles.iter().map(of_vehicle).collect()
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
    pub fn estimate_motion(&mut self, minimiser: &mut Minimiser, values: &Values) -> Result<f64, Singular> {
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
        let counted = self.sources.iter().filter(|(source, _)| source.traits().counts_in_sigma0);
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
}

/// Vehicles whose scale only their starting poses hold.
fn scale_warnings(problem: &Problem, start: &Estimate) -> Vec<NetworkWarning> {
    let vehicles = problem.vehicles.iter().zip(&start.vehicles);
    let adjusted = vehicles.filter(|(_, estimate)| estimate.left_out.is_none());
    let warning = |(vehicle, _): (&crate::problem::Vehicle, _)| {
        let gap = datum::scale_gap(problem, vehicle)?;
        Some(NetworkWarning::Scale { vehicle: vehicle.id.clone(), gap })
    };
    adjusted.filter_map(warning).collect()
}

/// How many numbers the starting poses are that together count as one observation.
fn pose_rows(declaration: &Declaration<'_>) -> usize {
    let Declaration { problem, start, cameras, vehicles, purpose, .. } = declaration;
    let free = |treatment: &Treatment| treatment.free.iter().filter(|free| **free).count();
    let counts = |(at, _): &(usize, &Treatment)| {
        start.vehicles[*at].left_out.is_none() && !problem.vehicles[*at].has_measured_poses()
    };
    let adjusted = vehicles.iter().enumerate().filter(counts);
    let is_given = problem.camera_poses.iter().any(Option::is_some);
    let camera_rows = if is_given { free(cameras) } else { 0 };
    let vehicle_rows = match purpose {
        Purpose::Adjustment { .. } => adjusted.map(|(_, treatment)| free(treatment)).sum::<usize>(),
        Purpose::Statistics { .. } => 0,
    };
    camera_rows + vehicle_rows
}

/// Tells the solver what it may make use of: rigid bodies, what all image points share, and the order of time.
fn arrange(
    builder: &mut SystemBuilder,
    problem: &Problem,
    declared: &Declared,
    motion: MotionPriors,
    purpose: Purpose<'_>,
) {
    let blocks = &declared.blocks;
    for (at, vehicle) in blocks.vehicles.iter().enumerate() {
        let receivers = problem.receivers.iter().zip(&blocks.receivers);
        let antennas =
            receivers.filter(|(r, _)| r.vehicle == at).filter_map(|(_, own)| Some((*own)?.antenna));
        let middle = vehicle.middle.map(|middle| middle.block);
        let points = vehicle.points.iter().flatten().copied().chain(antennas).chain(middle).collect();
        builder.add_rigid_body(points, vehicle.poses.iter().flatten().copied().collect());
    }
    if let Some(open) = blocks.open_camera {
        builder.share(open.to_vec());
    }
    let steps = blocks.cameras.iter().enumerate().map(|(frame, camera)| TimeStep {
        observer: Some(*camera),
        bodies: blocks.vehicles.iter().filter_map(|vehicle| vehicle.poses[frame]).collect(),
    });
    builder.along_time(steps.collect(), vec![declared.images.groups[0]]);
    if let Purpose::Statistics { .. } = purpose {
        // Of all poses that a velocity depends on.
        builder.select_within(Order::window(motion.vehicle_order()) * 2 - 1);
    }
}
