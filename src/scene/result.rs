//! A result as it is read back from its folder.

use super::images::image_points;
use super::open::add_open;
use super::pose;
use crate::files::{ResultPoint, ResultPoses, ResultResiduals, ResultTracks, TrackPosition};
use crate::geometry::Pose;
use crate::problem::Problem;
use std::collections::HashMap;
use trackbundle_viz as viz;

/// The tables of a result.
#[derive(Clone, Copy)]
pub struct Shown<'a> {
    /// Poses of cameras and vehicles.
    pub poses: &'a ResultPoses,
    /// Tracks.
    pub tracks: &'a ResultTracks,
    /// Shapes.
    pub shapes: &'a [(String, Vec<ResultPoint>)],
    /// Image residuals, where there are some.
    pub residuals: Option<&'a ResultResiduals>,
}

/// Adds a result to a scene of the start. Bodies that it does not have are left out.
pub fn add_result(scene: &mut viz::Scene, problem: &Problem, shown: Shown<'_>) {
    let index: HashMap<i64, usize> =
        problem.frames.iter().enumerate().map(|(at, frame)| (frame.number, at)).collect();
    // A camera that misses some frames cannot be drawn as one path of all.
    if shown.poses.cameras.len() == problem.frames.len() {
        scene.camera.after = shown.poses.cameras.iter().map(|(_, found)| pose(found)).collect();
    }
    for body in &mut scene.bodies {
        let poses = of(&shown.poses.vehicles, &body.id);
        let points = of(shown.shapes, &body.id);
        let track = of(&shown.tracks.tracks, &body.id);
        body.after = viz::State {
            points_m: points.iter().map(|point| point.position.coords.into()).collect(),
            sigmas_m: points.iter().map(|point| sigmas(point.sigma_m, point.is_open)).collect(),
            poses: poses.iter().map(|(frame, found): &(usize, Pose)| (*frame, pose(found))).collect(),
            track: track
                .iter()
                .filter_map(|place| Some(track_point(*index.get(&place.frame)?, place)))
                .collect(),
        };
    }
    scene.bodies.retain(|body| !body.after.poses.is_empty());
    if shown.residuals.is_some() {
        scene.image_points = image_points(problem, shown.residuals);
    }
    add_open(scene);
}

fn of<'a, T>(all: &'a [(String, Vec<T>)], id: &str) -> &'a [T] {
    all.iter().find(|(found, _)| found == id).map_or(&[], |(_, own)| own)
}

/// Infinite where nothing determines an axis; nothing where one was not computed.
fn sigmas(sigma_m: [Option<f64>; 3], is_open: [bool; 3]) -> Option<[f64; 3]> {
    let one = |axis: usize| if is_open[axis] { Some(f64::INFINITY) } else { sigma_m[axis] };
    Some([one(0)?, one(1)?, one(2)?])
}

fn track_point(frame: usize, place: &TrackPosition) -> viz::TrackPoint {
    let precision = sigmas(place.sigma_m, place.is_open).map(|sigma_m| viz::TrackPrecision {
        sigma_m,
        covariance_xy_m2: place.covariance_xy_m2.unwrap_or(f64::INFINITY),
        sigma_speed_mps: place.sigma_speed_mps,
        sigma_heading_deg: place.sigma_heading_deg.unwrap_or(f64::INFINITY),
    });
    viz::TrackPoint {
        frame,
        position_m: place.position.coords.into(),
        speed_mps: place.speed_mps,
        heading_deg: place.heading_deg.unwrap_or(f64::NAN),
        precision,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_axis_that_is_open_is_infinite_and_one_that_was_not_computed_is_nothing() {
        assert_eq!(
            sigmas([Some(0.1), None, Some(0.3)], [false, true, false]),
            Some([0.1, f64::INFINITY, 0.3])
        );
        assert_eq!(sigmas([Some(0.1), None, Some(0.3)], [false; 3]), None);
    }
}
