//! A result as it is read back from its folder.

use super::images::{Judged, image_points, told};
use super::open::add_open;
use super::pose;
use crate::files::{ResultPoint, ResultPoses, ResultResidual, ResultTracks, TrackPosition};
use crate::geometry::Pose;
use crate::problem::Problem;
use crate::refine::RejectionReason;
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
    pub residuals: Option<&'a [ResultResidual]>,
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
    if let Some(residuals) = shown.residuals {
        let judged = Residuals::new(residuals);
        scene.image_points = image_points(
            problem,
            |vehicle, at| {
                let vehicle = &problem.vehicles[vehicle];
                let o = &vehicle.observations[at];
                let frame = problem.frames[o.frame].number;
                judged.of(frame, Some(&vehicle.id), &vehicle.points[o.point].id)
            },
            |at| {
                let o = &problem.target_observations[at];
                judged.of(problem.frames[o.frame].number, None, &problem.targets[o.target].id)
            },
        );
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

/// Of which frame, vehicle (none: a target) and point.
type Key<'a> = (i64, Option<&'a str>, &'a str);

/// Residuals by what they are of. Their table says which are rejected, not why: where all of a track are, or all of
/// a vehicle's, or of targets', in a frame, that is the reason.
struct Residuals<'a> {
    all: HashMap<Key<'a>, &'a ResultResidual>,
    tracks: HashMap<(Option<&'a str>, &'a str), bool>,
    frames: HashMap<(i64, Option<&'a str>), bool>,
}

impl<'a> Residuals<'a> {
    fn new(residuals: &'a [ResultResidual]) -> Self {
        let mut found = Residuals { all: HashMap::new(), tracks: HashMap::new(), frames: HashMap::new() };
        for residual in residuals {
            let (vehicle, point) = (residual.vehicle.as_deref(), residual.point.as_str());
            let is_rejected = residual.weight == 0.0;
            found.all.insert((residual.frame, vehicle, point), residual);
            *found.tracks.entry((vehicle, point)).or_insert(true) &= is_rejected;
            *found.frames.entry((residual.frame, vehicle)).or_insert(true) &= is_rejected;
        }
        found
    }

    fn of(&self, frame: i64, vehicle: Option<&str>, point: &str) -> Judged {
        let Some(residual) = self.all.get(&(frame, vehicle, point)) else { return Judged::default() };
        let reason = if self.tracks.get(&(vehicle, point)) == Some(&true) {
            RejectionReason::Track
        } else if self.frames.get(&(frame, vehicle)) == Some(&true) {
            RejectionReason::Frame
        } else {
            RejectionReason::ImagePoint
        };
        let is_rejected = residual.weight == 0.0;
        Judged {
            residual_px: Some(residual.residual_px),
            took_part: !is_rejected,
            rejected: is_rejected.then_some(told(reason)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector2;

    #[test]
    fn why_image_points_are_rejected_is_read_from_their_neighbours() {
        let residual = |frame: i64, point: &str, weight: f64| ResultResidual {
            frame,
            vehicle: Some("car".to_owned()),
            point: point.to_owned(),
            residual_px: Vector2::new(frame as f64, 0.0),
            weight,
        };
        let rows = [
            residual(0, "a", 1.0),
            residual(0, "b", 0.0),
            residual(0, "c", 0.0),
            residual(1, "a", 0.0),
            residual(1, "b", 0.0),
            residual(1, "c", 0.0),
            residual(2, "a", 0.5),
            residual(2, "c", 1.0),
        ];
        let judged = Residuals::new(&rows);
        let reason = |frame: i64, point: &str| judged.of(frame, Some("car"), point).rejected;
        assert_eq!([reason(0, "a"), reason(2, "a")], [None, None]);
        assert_eq!(reason(0, "b"), Some("rejected with its whole track"));
        assert_eq!(reason(0, "c"), Some("rejected alone"));
        assert_eq!([reason(1, "a"), reason(1, "c")], [Some("rejected with its whole frame"); 2]);
        let unknown = judged.of(7, Some("car"), "a");
        assert!(unknown.residual_px.is_none() && !unknown.took_part && unknown.rejected.is_none());
        assert!(judged.of(2, Some("car"), "a").took_part);
    }

    #[test]
    fn an_axis_that_is_open_is_infinite_and_one_that_was_not_computed_is_nothing() {
        assert_eq!(
            sigmas([Some(0.1), None, Some(0.3)], [false, true, false]),
            Some([0.1, f64::INFINITY, 0.3])
        );
        assert_eq!(sigmas([Some(0.1), None, Some(0.3)], [false; 3]), None);
    }
}
