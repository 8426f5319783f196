//! `camera_poses.csv`.

use super::super::cells::{self, POSE_COLUMNS};
use super::reading::{Index, Reader};
use super::{Tables, targets};
use crate::geometry::Pose;
use crate::problem::Problem;
use crate::tables::{Finding, Line, input_row, written};
use std::collections::HashMap;

/// Name of the file.
pub const FILE: &str = "camera_poses.csv";

input_row!(
    /// `camera_poses.csv`.
    CameraPoseRow {
        required frame: i64,
        required x: f64, required y: f64, required z: f64,
        required qw: f64, required qx: f64, required qy: f64, required qz: f64,
    }
);

/// The poses by index of their frames.
pub fn check(reader: &mut Reader, tables: &Tables, index: &Index) -> HashMap<usize, Pose> {
    let mut poses = HashMap::new();
    let Some(rows) = &tables.camera_poses else {
        if !reader.is_there(FILE) && !reader.is_there(targets::FILE) {
            let wanted = "camera poses, or targets.csv to resect from";
            reader.findings.error(Finding::of_file(FILE, wanted, "neither"));
        }
        return poses;
    };
    for Line { line, row } in rows {
        let pose = reader.pose(FILE, *line, [row.x, row.y, row.z], [row.qw, row.qx, row.qy, row.qz]);
        let Some(frame) = reader.frame(FILE, *line, row.frame, index) else { continue };
        if poses.insert(frame, pose).is_some() {
            reader.cell(FILE, *line, "frame", "a frame that has one pose", row.frame);
        }
    }
    if targets::can_resect(tables.targets.as_deref()) {
        return poses;
    }
    for Line { row, .. } in tables.frames.iter().flatten() {
        if index.frames.get(&row.frame).is_some_and(|frame| !poses.contains_key(frame)) {
            let (frame, least) = (row.frame, targets::LEAST_CONTROL);
            let wanted =
                format!("a pose of frame {frame} (there are not {least} control targets to resect it from)");
            reader.findings.error(Finding::of_file(FILE, &wanted, "none"));
        }
    }
    poses
}

/// The table of these camera poses of a problem, one for each frame.
pub fn camera_pose_table(problem: &Problem, poses: &[Option<Pose>]) -> Vec<u8> {
    let rows = problem.frames.iter().zip(poses);
    let rows = rows.filter_map(|(frame, pose)| Some((frame.number.to_string(), cells::pose(pose.as_ref()?))));
    let rows = rows.map(|(frame, cells)| std::iter::once(frame).chain(cells));
    written(&[&["frame"], &POSE_COLUMNS[..]].concat(), rows)
}
