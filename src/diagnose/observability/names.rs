//! Names of directions, and a report of all of them for people.

use super::rows::{Coordinates, Owner};
use super::{Class, Freedom, Kind, Observability, Part};
use crate::problem::Problem;
use crate::refine::scale_gap;
use nalgebra::DVector;
use std::fmt::Write;

/// Share of one point in a direction from which it is that point's.
const OF_ONE_POINT: f64 = 0.5;
/// Frames with at least this share of the one that moves most are named.
const OF_MOST: f64 = 0.1;
/// Share of position or attitude in the motion of cameras from which it is that alone.
const OF_ONE_PART: f64 = 0.9;

const AXES: [&str; 3] = ["x", "y", "z"];

fn along(freedom: Freedom, axis: usize) -> String {
    match freedom {
        Freedom::Shift => format!("shift along {}", AXES[axis]),
        Freedom::Rotation => format!("rotation about {}", AXES[axis]),
    }
}

/// The name of a direction in the words of the user.
pub fn name(problem: &Problem, kind: &Kind) -> String {
    let id = |vehicle: usize| problem.vehicles[vehicle].id.as_str();
    match kind {
        Kind::Scale { vehicle } => format!("scale of {}", id(*vehicle)),
        Kind::BodyFrame { vehicle, freedom, axis } => {
            format!("body frame of {}, {}", id(*vehicle), along(*freedom, *axis))
        }
        Kind::WorldScale => "scale of the world".to_owned(),
        Kind::World { freedom, axis } => format!("frame of the world, {}", along(*freedom, *axis)),
        Kind::PointDepth { vehicle: None, point } => {
            format!("depth of target {}", problem.targets[*point].id)
        }
        Kind::PointDepth { vehicle: Some(vehicle), point } => {
            format!("depth of point {} of {}", problem.vehicles[*vehicle].points[*point].id, id(*vehicle))
        }
        Kind::CameraPose { frames: of, part } => match part {
            Part::Position(axis) => format!("position of {}, along {}", frames(problem, of), AXES[*axis]),
            Part::Attitude(axis) => format!("attitude of {}, about {}", frames(problem, of), AXES[*axis]),
            Part::Pose => format!("pose of the camera in {}", frames(problem, of)),
        },
        Kind::VehiclePose { vehicle, frames: of } => {
            format!("pose of {} in {}", id(*vehicle), frames(problem, of))
        }
        Kind::Other => "a combination of many unknowns".to_owned(),
    }
}

/// What holds a direction in the adjustment, where measurements and knowledge do not.
pub fn held_by(problem: &Problem, kind: &Kind) -> Option<&'static str> {
    let any_camera = problem.camera_poses.iter().any(Option::is_some);
    match kind {
        Kind::Scale { vehicle } => {
            scale_gap(problem, &problem.vehicles[*vehicle]).map(|_| "starting poses")
        }
        Kind::BodyFrame { vehicle, .. } => match problem.vehicles[*vehicle].has_no_poses() {
            true => Some("a convention"),
            false => Some("starting poses"),
        },
        Kind::World { .. } | Kind::WorldScale => any_camera.then_some("given camera poses"),
        Kind::PointDepth { .. } => Some("a convention"),
        Kind::CameraPose { frames, .. } => {
            match frames.iter().all(|frame| problem.camera_poses[*frame].is_some()) {
                true => Some("given camera poses"),
                false => Some("motion"),
            }
        }
        Kind::VehiclePose { .. } => Some("motion"),
        Kind::Other => None,
    }
}

/// `frame 7`, `frames 80-96, 99`.
fn frames(problem: &Problem, indices: &[usize]) -> String {
    let mut runs: Vec<(usize, usize)> = Vec::new();
    for &index in indices {
        match runs.last_mut() {
            Some((_, last)) if *last + 1 == index => *last = index,
            _ => runs.push((index, index)),
        }
    }
    let number = |index: usize| problem.frames[index].number;
    let run = |(first, last): (usize, usize)| match first == last {
        true => number(first).to_string(),
        false => format!("{}-{}", number(first), number(last)),
    };
    let text: Vec<String> = runs.into_iter().map(run).collect();
    format!("{} {}", if indices.len() == 1 { "frame" } else { "frames" }, text.join(", "))
}

/// What a scaled perturbation that is in no theory moves most.
pub fn by_weight(all: &Coordinates, perturbation: &DVector<f64>) -> Kind {
    let total = perturbation.norm_squared();
    let (of_frames, vehicles) = (all.cameras.len(), all.poses.len());
    let mut cameras = vec![[0.0; 2]; of_frames];
    let mut poses = vec![vec![0.0; of_frames]; vehicles];
    let mut shapes = 0.0;
    for (owner, start, length) in &all.blocks {
        let square = |at: std::ops::Range<usize>| perturbation.rows(at.start, at.len()).norm_squared();
        let weight = square(*start..start + length);
        match *owner {
            Owner::Camera(frame) => {
                cameras[frame] = [square(*start..start + 3), square(start + 3..start + 6)];
            }
            Owner::Pose(vehicle, frame) => poses[vehicle][frame] = weight,
            Owner::Point(vehicle, point) if weight > OF_ONE_POINT * total => {
                return Kind::PointDepth { vehicle: Some(vehicle), point };
            }
            Owner::Target(point) if weight > OF_ONE_POINT * total => {
                return Kind::PointDepth { vehicle: None, point };
            }
            Owner::Point(..) | Owner::Target(_) | Owner::Bias => shapes += weight,
        }
    }
    let most_moved = |weights: &[f64]| -> Vec<usize> {
        let most = weights.iter().fold(0.0_f64, |a, b| a.max(*b));
        (0..weights.len()).filter(|at| weights[*at] > 0.0 && weights[*at] >= OF_MOST * most).collect()
    };
    let of_cameras: Vec<f64> = cameras.iter().map(|[place, turn]| place + turn).collect();
    let sum = |weights: &[f64]| weights.iter().sum::<f64>();
    let heaviest = (0..vehicles).max_by(|a, b| sum(&poses[*a]).total_cmp(&sum(&poses[*b])));
    let of_vehicle = heaviest.map_or(0.0, |vehicle| sum(&poses[vehicle]));
    let of_camera = sum(&of_cameras);
    if shapes > of_camera.max(of_vehicle) {
        return Kind::Other;
    }
    match heaviest {
        Some(vehicle) if of_vehicle > of_camera => {
            Kind::VehiclePose { vehicle, frames: most_moved(&poses[vehicle]) }
        }
        _ => {
            let axis = |kind: usize| -> usize {
                let square = |axis: usize| -> f64 {
                    all.cameras.iter().map(|start| perturbation[start + 3 * kind + axis].powi(2)).sum()
                };
                (0..3).max_by(|a, b| square(*a).total_cmp(&square(*b))).unwrap_or(0)
            };
            let place: f64 = cameras.iter().map(|c| c[0]).sum();
            let part = match place / of_camera.max(f64::MIN_POSITIVE) {
                share if share > OF_ONE_PART => Part::Position(axis(0)),
                share if share < 1.0 - OF_ONE_PART => Part::Attitude(axis(1)),
                _ => Part::Pose,
            };
            Kind::CameraPose { frames: most_moved(&of_cameras), part }
        }
    }
}

/// A report in short lines. Directions that differ by their frames or axes only share a line.
pub fn describe(found: &Observability) -> String {
    let mut text = String::new();
    let way = match found.is_dense {
        true => "all singular values",
        false => "theory, confirmed; too many unknowns for all singular values",
    };
    let Observability { unknowns, rank, defect, expected_defect, .. } = *found;
    let theory = match expected_defect == defect {
        true => "as expected".to_owned(),
        false => format!("expected {expected_defect}"),
    };
    // Writing to a text does not fail.
    let _ = writeln!(text, "unknowns {unknowns}, rank {rank}, defect {defect} ({theory}; by {way})");
    let mut lines: Vec<(Class, String, usize, f64, Option<&str>)> = Vec::new();
    for direction in &found.directions {
        let (class, name) = (direction.class, headline(direction));
        let same = lines.iter_mut().find(|line| line.0 == class && line.1 == name);
        match same {
            Some(line) => {
                line.2 += 1;
                line.3 = line.3.max(direction.singular_ratio);
            }
            None => lines.push((class, name, 1, direction.singular_ratio, direction.held_by)),
        }
    }
    for (class, name, number, ratio, held_by) in lines {
        let class = match class {
            Class::Null => "null".to_owned(),
            Class::Weak => format!("weak ({ratio:.0e})"),
        };
        let number = if number > 1 { format!(" ({number} directions)") } else { String::new() };
        let held = held_by.map_or(String::new(), |by| format!("; held by {by}"));
        let _ = writeln!(text, "{class}: {name}{number}{held}");
    }
    text
}

/// The name of a direction, less what many of its kind differ by.
fn headline(direction: &super::Direction) -> String {
    match &direction.kind {
        Kind::CameraPose { .. } => "camera poses of frames that nothing static holds".to_owned(),
        Kind::PointDepth { vehicle: None, .. } => "depths of static points".to_owned(),
        Kind::BodyFrame { .. } | Kind::World { .. } => {
            direction.name.split(',').next().unwrap_or_default().to_owned()
        }
        _ => direction.name.clone(),
    }
}
