//! The network, declared once: all unknowns, all measurements, all that is known, and the conventions, for whoever
//! wants them.

use super::blocks::{Blocks, MiddleBlock, VehicleBlocks, add_blocks};
use super::contact::{add_contacts, contacts_last_s};
use super::conventions::{
    add_body_boxes, add_frames, add_middles, add_present_places, add_starting_shapes, add_tie_points,
    add_usual_sizes,
};
use super::datum::{self, Treatment};
use super::driving::add_driving;
use super::highest::{Highest, highest_points};
use super::images::{Images, add_images};
use super::knowledge::{add_camera_knowledge, add_knowledge};
use super::motion::{Body, Counted, Motion, MotionPriors, TimedPose};
use super::receivers::add_receivers;
use super::selection::{Purpose, Selection};
use super::sink::Sink;
use super::starts::{Starting, add_starting_poses};
use super::warnings::NetworkWarning;
use crate::estimate::{Estimate, VehicleEstimate};
use crate::geometry::Pose;
use crate::problem::{GroundKnowledge, Problem};
use nalgebra::Point3;
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
    /// What stands for the highest point of each vehicle whose height is known.
    pub highest_points: Vec<Option<Highest>>,
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
    /// What says which points motion is told of: as many rows as unknowns.
    pub middles: GroupId,
    /// What is odd.
    pub warnings: Vec<NetworkWarning>,
}

/// Declares a network to a sink. A new measurement is one line here.
pub fn declare(sink: &mut impl Sink, declaration: &Declaration<'_>) -> Declared {
    let Declaration { problem, start, current, purpose, .. } = *declaration;
    let mut warnings = Vec::new();
    let blocks = add_blocks(sink, problem, current, declaration.cameras, declaration.vehicles);
    let images = add_images(sink, problem, current, &blocks, declaration.selection);
    let highest_points = highest_points(problem, current, &images.vehicle_items);
    add_knowledge(sink, problem, &blocks, &highest_points);
    add_camera_knowledge(sink, problem, blocks.open_camera);
    let gnss_items = add_receivers(sink, problem, current, &blocks, purpose, &mut warnings);
    let mut datum = add_starting_poses(sink, problem, &starting(declaration), &blocks, declaration.motion);
    let held = match purpose {
        Purpose::Statistics { .. } if problem.may_have_relief() => current,
        _ => start,
    };
    let (shapes, shape_rows) = add_starting_shapes(sink, problem, held, &blocks);
    datum.push(shapes);
    // Where only their own poses hold the cameras, the world has a size that no motion may decide.
    let is_adrift = datum::cameras_float(problem, declaration.cameras);
    let counted = counted_vehicles(current, &blocks, is_adrift);
    let mut seen = vec![vec![false; problem.frames.len()]; problem.vehicles.len()];
    for &(vehicle, observation) in &images.vehicle_items {
        seen[vehicle][problem.vehicles[vehicle].observations[observation].frame] = true;
    }
    let contacts = problem.ground.as_ref().map(|ground| (ground, contacts_last_s(problem, ground, current)));
    let ground_shift = contacts
        .as_ref()
        .map(|(ground, last_s)| {
            let ground = (*ground, last_s.as_slice());
            add_contacts(sink, problem, ground, current, &blocks, (&counted, &seen), &mut warnings)
        })
        .unwrap_or_default();
    add_frames(sink, current, &blocks, purpose.anchors());
    let middles = add_middles(sink, &blocks);
    let boxes = add_body_boxes(sink, &blocks);
    let places = match purpose {
        Purpose::Adjustment { .. } => add_usual_sizes(sink, start, &blocks),
        // What was held on the way is held where it is by now.
        Purpose::Statistics { .. } => add_present_places(sink, start, current, &blocks),
    };
    add_tie_points(sink, problem, current, &blocks);
    let motion = add_motion(sink, declaration, &blocks, &counted, is_adrift, contacts.as_ref());
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
        middles,
        warnings,
    }
}

fn starting<'a>(declaration: &Declaration<'a>) -> Starting<'a> {
    let Declaration { start, current, cameras, vehicles, purpose, .. } = *declaration;
    // Frames may have been turned since, and must not be pulled back.
    let now = matches!(purpose, Purpose::Statistics { .. }).then_some(current);
    Starting { start, now, cameras, vehicles }
}

fn add_motion(
    sink: &mut impl Sink,
    declaration: &Declaration<'_>,
    blocks: &Blocks,
    counted: &[Vec<Option<Counted>>],
    is_adrift: bool,
    contacts: Option<&(&GroundKnowledge, Vec<f64>)>,
) -> Motion {
    let Declaration { problem, current, motion: priors, .. } = *declaration;
    let mut motion = Motion::default();
    let pose = |frame: usize, block: BlockId, counted| TimedPose {
        time_s: problem.frames[frame].time_s,
        block,
        counted,
        ground: None,
    };
    let seen = if is_adrift { seen_vehicles(current, blocks) } else { Vec::new() };
    let of_camera = |(frame, block): (usize, &BlockId)| {
        let counted = match nearest(&seen, frame) {
            Some(Seen { vehicle, point, at, .. }) => {
                let place = Point3::from(current.camera_poses[frame].translation.vector);
                let distance_m = (at - place).norm().max(1.0);
                Counted::FromVehicle { vehicle: *vehicle, point: *point, distance_m }
            }
            None => Counted::Metres,
        };
        pose(frame, *block, counted)
    };
    let of_cameras: Vec<TimedPose> = blocks.cameras.iter().enumerate().map(of_camera).collect();
    motion.add(sink, Body::Camera, &of_cameras, priors.camera, None);
    for (at, (vehicle, own)) in problem.vehicles.iter().zip(&blocks.vehicles).enumerate() {
        let ground = |frame: usize| {
            let (ground, place) = (problem.ground.as_ref()?, current.vehicles[at].poses[frame]?.translation);
            ground.terrain.footing_at(place.x, place.y)
        };
        let timed = |(frame, block): (usize, &Option<BlockId>)| {
            let ground = ground(frame);
            Some(TimedPose { ground, ..pose(frame, (*block)?, counted[at][frame]?) })
        };
        let poses: Vec<TimedPose> = own.poses.iter().enumerate().filter_map(timed).collect();
        let contact = contacts.map(|(ground, last_s)| (*ground, last_s[at]));
        motion.add(sink, Body::Vehicle(vehicle.id.clone()), &poses, priors.vehicle, contact);
    }
    motion
}

/// For each vehicle and frame in what its motion is counted there, and its way up and down on the ground; `None` where
/// it has no pose.
fn counted_vehicles(current: &Estimate, blocks: &Blocks, is_adrift: bool) -> Vec<Vec<Option<Counted>>> {
    let of_vehicle = |(found, own): (&VehicleEstimate, &VehicleBlocks)| {
        let in_frame = |(frame, pose): (usize, &Option<Pose>)| {
            let (MiddleBlock { block: point, place, .. }, pose) = (own.middle?, (*pose)?);
            let camera = Point3::from(current.camera_poses[frame].translation.vector);
            let distance_m = (pose * place - camera).norm().max(1.0);
            Some(match is_adrift {
                true => Counted::FromCamera { point, camera: blocks.cameras[frame], distance_m },
                false => Counted::FromPlace { point, camera, distance_m },
            })
        };
        found.poses.iter().enumerate().map(in_frame).collect()
    };
    current.vehicles.iter().zip(&blocks.vehicles).map(of_vehicle).collect()
}

/// A vehicle in a frame: the block of its pose, that of its point, and where this is \[m\].
struct Seen {
    frame: usize,
    vehicle: BlockId,
    point: BlockId,
    at: Point3<f64>,
}

/// For each frame in which a vehicle has a pose the first of them.
fn seen_vehicles(current: &Estimate, blocks: &Blocks) -> Vec<Seen> {
    let in_frame = |frame: usize| {
        let mut vehicles = blocks.vehicles.iter().zip(&current.vehicles);
        vehicles.find_map(|(own, found)| {
            let (vehicle, MiddleBlock { block: point, place, .. }) = ((*own.poses.get(frame)?)?, own.middle?);
            Some(Seen { frame, vehicle, point, at: found.poses[frame]? * place })
        })
    };
    (0..current.camera_poses.len()).filter_map(in_frame).collect()
}

/// The one in the frame that is nearest to another.
fn nearest(seen: &[Seen], frame: usize) -> Option<&Seen> {
    seen.iter().min_by_key(|seen| seen.frame.abs_diff(frame))
}
