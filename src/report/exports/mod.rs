//! A comparison in the forms of other programs: TUM and KITTI trajectories, a result of evo, tables.

mod archive;
mod tables;
mod trajectories;

use super::File;
use crate::evaluate::Evaluation;

/// All of them: four files for each vehicle that has a track, and the archive of evo; a table of all tracks
/// and one of all shapes, where there are any.
pub fn exports(evaluation: &Evaluation) -> Vec<File> {
    let mut files = Vec::new();
    for found in &evaluation.vehicles {
        files.extend(trajectories::files(found));
        files.push(archive::evo(found));
    }
    if !evaluation.vehicles.is_empty() {
        files.push(tables::track_differences(&evaluation.vehicles));
    }
    if !evaluation.shapes.is_empty() {
        files.push(tables::shape_distances(&evaluation.shapes));
    }
    files
}
