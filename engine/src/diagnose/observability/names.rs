//! Names of directions, and a report of all of them for people.

use super::rows::Coordinates;
use super::{Class, DatumFreedom, Direction, Kind, Observability, Part};
use crate::network::{Owner, scale_gap};
use crate::problem::Problem;
use nalgebra::DVector;
use std::fmt::Write;

/// Share of one point in what a direction does to points from which it is that point's.
const OF_ONE_POINT: f64 = 0.5;
/// Frames with at least this share of the one that moves most are named.
const OF_MOST: f64 = 0.1;
/// Share of position or attitude in the motion of cameras from which it is that alone.
const OF_ONE_PART: f64 = 0.9;

/// Numbers of a receiver.
const RECEIVER_NAMES: [&str; 5] =
    ["clock offset", "clock drift", "shift along x", "shift along y", "shift along z"];

/// A number beside poses and points.
pub fn number(owner: Owner, at: usize) -> Kind {
    match owner {
        Owner::Interior => Kind::Interior { at },
        Owner::Readout => Kind::Readout,
        Owner::Axle(vehicle) => Kind::Axle { vehicle, at },
        Owner::Antenna(receiver) => Kind::Antenna { receiver, axis: at },
        Owner::Receiver(receiver) => Kind::Receiver { receiver, at },
        _ => Kind::Other,
    }
}

/// Numbers of a rear axle.
const AXLE_NAMES: [&str; 2] = ["place of the rear axle", "rolling direction"];

const AXES: [&str; 3] = ["x", "y", "z"];

fn along(freedom: DatumFreedom, axis: usize) -> String {
    match freedom {
        DatumFreedom::Shift => format!("shift along {}", AXES[axis]),
        DatumFreedom::Rotation => format!("rotation about {}", AXES[axis]),
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
        Kind::CameraPose { frames: of, part } => camera(*part, &frames(problem, of)),
        Kind::VehiclePose { vehicle, frames: of } => {
            format!("pose of {} in {}", id(*vehicle), frames(problem, of))
        }
        Kind::Interior { at } => problem.camera.interior_names()[*at].to_owned(),
        Kind::Readout => "readout time".to_owned(),
        Kind::Axle { vehicle, at } => format!("{} of {}", AXLE_NAMES[*at], id(*vehicle)),
        Kind::Antenna { receiver, axis } => {
            let of = problem.receivers[*receiver].name(&problem.vehicles);
            format!("antenna of {of}, along {}", AXES[*axis])
        }
        Kind::Receiver { receiver, at } => {
            let of = problem.receivers[*receiver].name(&problem.vehicles);
            format!("{} of {of}", RECEIVER_NAMES[*at])
        }
        Kind::Other => "a combination of many unknowns".to_owned(),
    }
}

fn camera(part: Part, frames: &str) -> String {
    match part {
        Part::Position(axis) => format!("position of {frames}, along {}", AXES[axis]),
        Part::Attitude(axis) => format!("attitude of {frames}, about {}", AXES[axis]),
        Part::Pose => format!("pose of {frames}"),
    }
}

/// What holds a direction in the adjustment, where measurements and knowledge do not.
pub fn held_by(problem: &Problem, kind: &Kind) -> Option<&'static str> {
    let any_camera = problem.camera_poses.iter().any(Option::is_some);
    match kind {
        Kind::Scale { vehicle } => scale_gap(problem, &problem.vehicles[*vehicle]).map(|_| "starting poses"),
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
        Kind::Interior { .. }
        | Kind::Readout
        | Kind::Axle { .. }
        | Kind::Antenna { .. }
        | Kind::Receiver { .. } => Some("a convention"),
        Kind::Other => None,
    }
}

fn frames(problem: &Problem, indices: &[usize]) -> String {
    runs(indices.iter().map(|index| (*index, problem.frames[*index].number)))
}

/// `frame 7`, `frames 80-96, 99`, of indices and numbers.
fn runs(frames: impl Iterator<Item = (usize, i64)>) -> String {
    let mut runs: Vec<(usize, i64, i64)> = Vec::new();
    let mut count = 0;
    for (index, number) in frames {
        count += 1;
        match runs.last_mut() {
            Some((end, _, last)) if *end + 1 == index => (*end, *last) = (index, number),
            _ => runs.push((index, number, number)),
        }
    }
    let run = |(_, first, last): (usize, i64, i64)| match first == last {
        true => first.to_string(),
        false => format!("{first}-{last}"),
    };
    let text: Vec<String> = runs.into_iter().map(run).collect();
    format!("{} {}", if count == 1 { "frame" } else { "frames" }, text.join(", "))
}

/// What a scaled perturbation that is in no theory moves most.
pub fn by_weight(all: &Coordinates, perturbation: &DVector<f64>) -> Kind {
    let (of_frames, vehicles) = (all.cameras.len(), all.poses.len());
    let mut cameras = vec![[0.0; 2]; of_frames];
    let mut poses = vec![vec![0.0; of_frames]; vehicles];
    let (mut points, mut most, mut heaviest_point) = (0.0, 0.0, Kind::Other);
    let mut heaviest_number = (0.0, Kind::Other);
    for (owner, start, length) in &all.blocks {
        let square = |at: std::ops::Range<usize>| perturbation.rows(at.start, at.len()).norm_squared();
        let weight = square(*start..start + length);
        match *owner {
            Owner::Camera(frame) => {
                cameras[frame] = [square(*start..start + 3), square(start + 3..start + 6)];
            }
            Owner::Pose(vehicle, frame) => poses[vehicle][frame] = weight,
            Owner::Point(..) | Owner::Target(_) => {
                points += weight;
                if weight > most {
                    most = weight;
                    heaviest_point = match *owner {
                        Owner::Point(vehicle, point) => Kind::PointDepth { vehicle: Some(vehicle), point },
                        Owner::Target(point) => Kind::PointDepth { vehicle: None, point },
                        _ => Kind::Other,
                    };
                }
            }
            Owner::Bias | Owner::Middle(_) => {}
            Owner::Interior | Owner::Readout | Owner::Axle(_) | Owner::Antenna(_) | Owner::Receiver(_) => {
                if weight > heaviest_number.0 {
                    let square = |at: usize| perturbation[start + at].powi(2);
                    let at = (0..*length).max_by(|a, b| square(*a).total_cmp(&square(*b))).unwrap_or(0);
                    heaviest_number = (weight, number(*owner, at));
                }
            }
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
    if heaviest_number.0 > points.max(of_camera).max(of_vehicle) {
        return heaviest_number.1;
    }
    if points > of_camera.max(of_vehicle) {
        return if most > OF_ONE_POINT * points { heaviest_point } else { Kind::Other };
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

/// Directions that share a line of a report.
struct Line<'a> {
    of: &'a Direction,
    /// Indices and numbers of all their frames.
    frames: Vec<(usize, i64)>,
    /// What they differ by else.
    parts: Vec<&'a str>,
    number: usize,
    ratio: f64,
}

/// A report in short lines. Directions that differ only by their frames, axes or points share one.
pub fn describe(found: &Observability) -> String {
    let way = match found.is_dense {
        true => "all singular values",
        false => "theory, confirmed; too many unknowns for all singular values",
    };
    let Observability { unknowns, rank, defect, expected_defect, .. } = *found;
    let theory = match expected_defect == defect {
        true => "as expected".to_owned(),
        false => format!("expected {expected_defect}"),
    };
    let mut text = format!("unknowns {unknowns}, rank {rank}, defect {defect} ({theory}; by {way})\n");
    let mut lines: Vec<Line<'_>> = Vec::new();
    for direction in &found.directions {
        let at = lines.iter().position(|line| share_a_line(line.of, direction));
        let at = at.unwrap_or_else(|| {
            let (frames, parts) = (Vec::new(), Vec::new());
            lines.push(Line { of: direction, frames, parts, number: 0, ratio: 0.0 });
            lines.len() - 1
        });
        let line = &mut lines[at];
        line.number += 1;
        line.ratio = line.ratio.max(direction.singular_ratio);
        if let Kind::CameraPose { frames, .. } | Kind::VehiclePose { frames, .. } = &direction.kind {
            line.frames.extend(frames.iter().copied().zip(direction.frames.iter().copied()));
        }
        line.parts.extend(direction.name.split_once(", ").map(|(_, part)| part));
    }
    for mut line in lines {
        line.frames.sort_unstable();
        line.frames.dedup();
        let class = match line.of.class {
            Class::Null => "null".to_owned(),
            Class::Weak => format!("weak, {:.0e}", line.ratio),
        };
        let name = line.name();
        let held = line.of.held_by.map_or(String::new(), |by| format!("; held by {by}"));
        // Writing to a text does not fail.
        let _ = writeln!(text, "{class}: {name}{held}");
    }
    text
}

fn share_a_line(a: &Direction, b: &Direction) -> bool {
    let same = match (&a.kind, &b.kind) {
        (Kind::CameraPose { part: a, .. }, Kind::CameraPose { part: b, .. }) => a == b,
        (Kind::VehiclePose { vehicle: a, .. }, Kind::VehiclePose { vehicle: b, .. })
        | (Kind::BodyFrame { vehicle: a, .. }, Kind::BodyFrame { vehicle: b, .. }) => a == b,
        (Kind::PointDepth { vehicle: a, .. }, Kind::PointDepth { vehicle: b, .. }) => a == b,
        (Kind::World { .. }, Kind::World { .. }) | (Kind::Other, Kind::Other) => true,
        _ => false,
    };
    same && (a.class, a.held_by) == (b.class, b.held_by)
}

impl Line<'_> {
    fn name(&self) -> String {
        let name = self.of.name.as_str();
        let number = self.number;
        match &self.of.kind {
            _ if number == 1 => name.to_owned(),
            Kind::CameraPose { part, .. } => camera(*part, &runs(self.frames.iter().copied())),
            Kind::VehiclePose { .. } => {
                let body = name.split(" in frame").next().unwrap_or_default();
                format!("{body} in {} ({number} directions)", runs(self.frames.iter().copied()))
            }
            Kind::BodyFrame { .. } | Kind::World { .. } => {
                let whole = name.split(", ").next().unwrap_or_default();
                match number {
                    6 => format!("{whole}, all six"),
                    _ => format!("{whole}, {}", self.parts.join(", ")),
                }
            }
            Kind::PointDepth { vehicle: None, .. } => format!("depths of {number} targets"),
            Kind::PointDepth { .. } => {
                let body = name.rsplit(" of ").next().unwrap_or_default();
                format!("depths of {number} points of {body}")
            }
            _ => format!("{name} ({number} directions)"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_named_in_runs() {
        let of = |frames: &[(usize, i64)]| runs(frames.iter().copied());
        assert_eq!(of(&[(3, 7)]), "frame 7");
        // Neighbours in the film, whatever their numbers.
        assert_eq!(of(&[(0, 80), (1, 85), (2, 90), (4, 100)]), "frames 80-90, 100");
        assert_eq!(camera(Part::Attitude(2), &of(&[(0, 1), (1, 2)])), "attitude of frames 1-2, about z");
        assert_eq!(camera(Part::Pose, "frame 3"), "pose of frame 3");
    }

    #[test]
    fn directions_that_differ_by_their_axes_share_a_line() {
        let direction = |axis: usize, class: Class| Direction {
            name: format!("body frame of car1, shift along {}", AXES[axis]),
            kind: Kind::BodyFrame { vehicle: 0, freedom: DatumFreedom::Shift, axis },
            class,
            singular_ratio: 2e-5,
            held_by: None,
            frames: Vec::new(),
        };
        let found = Observability {
            unknowns: 9,
            rank: 8,
            defect: 1,
            expected_defect: 2,
            largest_singular: 1.0,
            directions: vec![direction(1, Class::Null), direction(0, Class::Weak), direction(2, Class::Weak)],
            is_dense: true,
        };
        assert_eq!(
            describe(&found),
            "unknowns 9, rank 8, defect 1 (expected 2; by all singular values)\n\
             null: body frame of car1, shift along y\n\
             weak, 2e-5: body frame of car1, shift along x, shift along z\n"
        );
    }
}
