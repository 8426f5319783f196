//! The network, declared once: all unknowns, all measurements, all that is known, and the conventions, for whoever
//! wants them.

use super::blocks::{Blocks, add_blocks};
use super::contact::add_contacts;
use super::conventions::{add_body_boxes, add_frames, add_starting_shapes, add_tie_points, add_usual_sizes};
use super::datum::Treatment;
use super::driving::add_driving;
use super::images::{Images, add_images};
use super::knowledge::{add_camera_knowledge, add_knowledge, highest_points};
use super::motion::{Body, Motion, MotionPriors, TimedPose};
use super::receivers::add_receivers;
use super::selection::{Purpose, Selection};
use super::sink::Sink;
use super::starts::{Starting, add_starting_poses};
use super::warnings::NetworkWarning;
use crate::estimate::Estimate;
use crate::problem::Problem;
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
    /// How many numbers that is, of starting shapes.
    pub shape_rows: usize,
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
    add_body_boxes(sink, &blocks);
    if let Purpose::Statistics { anchors } = purpose {
        add_frames(sink, current, &blocks, anchors);
    }
    add_usual_sizes(sink, start, &blocks);
    add_tie_points(sink, problem, current, &blocks);
    let motion = add_motion(sink, problem, current, &blocks, declaration.motion);
    add_driving(sink, problem, &blocks);
    Declared { blocks, images, highest_points, gnss_items, ground_shift, motion, datum, shape_rows, warnings }
}

fn starting<'a>(declaration: &Declaration<'a>) -> Starting<'a> {
    let Declaration { start, current, cameras, vehicles, purpose, .. } = *declaration;
    // Frames may have been turned since, and must not be pulled back.
    let now = matches!(purpose, Purpose::Statistics { .. }).then_some(current);
    Starting { start, now, cameras, vehicles }
}

fn add_motion(
    sink: &mut impl Sink,
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
    motion.add(sink, Body::Camera, &of_camera, priors.camera, false);
    for (at, (vehicle, blocks)) in problem.vehicles.iter().zip(&blocks.vehicles).enumerate() {
        let seen = |(frame, block): (usize, &Option<BlockId>)| {
            let camera = Point3::from(current.camera_poses[frame].translation.vector);
            let place = current.vehicles[at].poses[frame]?.translation.vector;
            let distance_m = (place - camera.coords).norm().max(1.0);
            Some(TimedPose { seen_from: Some((camera, distance_m)), ..pose(frame, (*block)?) })
        };
        let poses: Vec<TimedPose> = blocks.poses.iter().enumerate().filter_map(seen).collect();
        let on_ground = problem.ground.is_some();
        motion.add(sink, Body::Vehicle(vehicle.id.clone()), &poses, priors.vehicle, on_ground);
    }
    motion
}
