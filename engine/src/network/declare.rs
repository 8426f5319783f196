//! The network, declared once: all unknowns, all measurements, all that is known, and the conventions, for whoever
//! wants them.

use super::blocks::{Blocks, add_blocks};
use super::contact::add_contacts;
use super::conventions::{
    add_body_boxes, add_frames, add_present_places, add_starting_shapes, add_tie_points, add_usual_sizes,
};
use super::datum::{self, Treatment};
use super::driving::add_driving;
use super::images::{Images, add_images};
use super::knowledge::{add_camera_knowledge, add_knowledge, highest_points};
use super::motion::{Body, Counted, Motion, MotionPriors, TimedPose};
use super::receivers::add_receivers;
use super::selection::{Purpose, Selection};
use super::sink::Sink;
use super::starts::{Starting, add_starting_poses};
use super::warnings::NetworkWarning;
use crate::estimate::Estimate;
use crate::problem::Problem;
use nalgebra::{Point3, Vector3};
use trackbundle_solver::system::{BlockId, GroupId};

/// What a network is made from.
#[derive(Clone, Copy)]
pub struct Declaration<'a> {
    /// What was observed and is known.
    pub problem: &'a Problem,
    /// Where the adjustment started.
    pub start: &'a Estimate,
    /// The values of the unknowns, and what depends on them: highest points, rows, distances from the camera.
    pub current: &'a Estimate,
    /// How given camera poses are treated.
    pub cameras: &'a Treatment,
    /// How the poses of each vehicle are treated.
    pub vehicles: &'a [Treatment],
    /// The motion priors.
    pub motion: MotionPriors,
    /// Which image points take part.
    pub selection: &'a Selection,
    /// What it is for.
    pub purpose: Purpose<'a>,
}

/// What was declared.
pub struct Declared {
    /// Where the unknowns are.
    pub blocks: Blocks,
    /// Image points.
    pub images: Images,
    /// Index of the highest point of each vehicle whose height is known.
    pub highest_points: Vec<Option<usize>>,
    /// For each GNSS position that takes part: receiver and position.
    pub gnss_items: Vec<(usize, usize)>,
    /// What a shift of the ground by one standard deviation does to the first row of contacts, whitened: of
    /// first and of next contacts.
    pub ground_shift: Vec<(GroupId, Vec<f64>)>,
    /// The motion priors.
    pub motion: Motion,
    /// Groups whose rows together weigh as much as one observation of a few numbers.
    pub datum: Vec<GroupId>,
    /// Starting shapes, where nothing knows the scale.
    pub shapes: GroupId,
    /// How many numbers these count as.
    pub shape_rows: usize,
    /// What keeps points without depth in their places.
    pub places: GroupId,
    /// What keeps points within a road vehicle.
    pub boxes: GroupId,
    /// What is odd.
    pub warnings: Vec<NetworkWarning>,
}

/// Declares a network to a sink. A new measurement is one line here.
pub fn declare(sink: &mut impl Sink, declaration: &Declaration<'_>) -> Declared {
    let Declaration { problem, start, current, purpose, .. } = *declaration;
    let mut warnings = Vec::new();
    let blocks = add_blocks(sink, problem, current, declaration.cameras, declaration.vehicles);
    let images = add_images(sink, problem, current, &blocks, declaration.selection);
    let highest_points = highest_points(problem, current);
    add_knowledge(sink, problem, &blocks, &highest_points);
    add_camera_knowledge(sink, problem, blocks.open_camera);
    let gnss_items = add_receivers(sink, problem, current, &blocks, purpose, &mut warnings);
    let mut datum = add_starting_poses(sink, problem, &starting(declaration), &blocks, declaration.motion);
    let (shapes, shape_rows) = add_starting_shapes(sink, problem, start, &blocks);
    datum.push(shapes);
    let ground = problem.ground.as_ref();
    let ground_shift = ground
        .map(|ground| add_contacts(sink, problem, ground, current, &blocks, &mut warnings))
        .unwrap_or_default();
    add_frames(sink, current, &blocks, purpose.anchors());
    let boxes = add_body_boxes(sink, &blocks);
    let places = match purpose {
        Purpose::Adjustment { .. } => add_usual_sizes(sink, start, &blocks),
        // What was held on the way is held where it is by now.
        Purpose::Statistics { .. } => add_present_places(sink, start, current, &blocks),
    };
    add_tie_points(sink, problem, current, &blocks);
    let motion = add_motion(sink, declaration, &blocks);
    add_driving(sink, problem, &blocks);
    Declared {
        blocks,
        images,
        highest_points,
        gnss_items,
        ground_shift,
        motion,
        datum,
        shapes,
        shape_rows,
        places,
        boxes,
        warnings,
    }
}

fn starting<'a>(declaration: &Declaration<'a>) -> Starting<'a> {
    let Declaration { start, current, cameras, vehicles, purpose, .. } = *declaration;
    // Frames may have been turned since, and must not be pulled back.
    let now = matches!(purpose, Purpose::Statistics { .. }).then_some(current);
    Starting { start, now, cameras, vehicles }
}

fn add_motion(sink: &mut impl Sink, declaration: &Declaration<'_>, blocks: &Blocks) -> Motion {
    let Declaration { problem, current, motion: priors, .. } = *declaration;
    let mut motion = Motion::default();
    let pose = |frame: usize, block: BlockId, counted| TimedPose {
        time_s: problem.frames[frame].time_s,
        block,
        counted,
    };
    // Where only their own poses hold the cameras, the world has a size that no motion may decide.
    let is_adrift = datum::cameras_float(problem, declaration.cameras);
    let place = |frame: usize| current.camera_poses[frame].translation.vector;
    let seen = if is_adrift { seen_vehicles(current, blocks) } else { Vec::new() };
    let of_camera = |(frame, block): (usize, &BlockId)| {
        let counted = match nearest(&seen, frame) {
            Some((_, vehicle, at)) => {
                let distance_m = (at - place(frame)).norm().max(1.0);
                Counted::FromVehicle { vehicle: *vehicle, distance_m }
            }
            None => Counted::Metres,
        };
        pose(frame, *block, counted)
    };
    let of_cameras: Vec<TimedPose> = blocks.cameras.iter().enumerate().map(of_camera).collect();
    motion.add(sink, Body::Camera, &of_cameras, priors.camera, false);
    for (at, (vehicle, own)) in problem.vehicles.iter().zip(&blocks.vehicles).enumerate() {
        let seen = |(frame, block): (usize, &Option<BlockId>)| {
            let vehicle = current.vehicles[at].poses[frame]?.translation.vector;
            let distance_m = (vehicle - place(frame)).norm().max(1.0);
            let counted = match is_adrift {
                true => Counted::FromCamera { camera: blocks.cameras[frame], distance_m },
                false => Counted::FromPlace { camera: Point3::from(place(frame)), distance_m },
            };
            Some(pose(frame, (*block)?, counted))
        };
        let poses: Vec<TimedPose> = own.poses.iter().enumerate().filter_map(seen).collect();
        let on_ground = problem.ground.is_some();
        motion.add(sink, Body::Vehicle(vehicle.id.clone()), &poses, priors.vehicle, on_ground);
    }
    motion
}

/// A frame with the pose of a vehicle in it: its block, and where it is \[m\].
type Seen = (usize, BlockId, Vector3<f64>);

/// For each frame in which a vehicle has a pose the first of them.
fn seen_vehicles(current: &Estimate, blocks: &Blocks) -> Vec<Seen> {
    let in_frame = |frame: usize| {
        let mut vehicles = blocks.vehicles.iter().zip(&current.vehicles);
        vehicles.find_map(|(own, found)| {
            let block = (*own.poses.get(frame)?)?;
            Some((frame, block, found.poses[frame]?.translation.vector))
        })
    };
    (0..current.camera_poses.len()).filter_map(in_frame).collect()
}

/// The one in the frame that is nearest to another.
fn nearest(seen: &[Seen], frame: usize) -> Option<&Seen> {
    seen.iter().min_by_key(|(own, ..)| own.abs_diff(frame))
}
