//! What we believe: the unknowns of a problem as a value to clone, compare and write.

use crate::geometry::{self, Pose};
use crate::problem::{Problem, Vehicle};
use nalgebra::{Point3, Vector2};

/// A value for every unknown.
#[derive(Clone, Debug, PartialEq)]
pub struct Estimate {
    /// `world_from_camera` of each frame.
    pub camera_poses: Vec<Pose>,
    /// One for each vehicle of the problem.
    pub vehicles: Vec<VehicleEstimate>,
    /// Position of each target in the world; `None` where it could not be found.
    pub targets: Vec<Option<Point3<f64>>>,
    /// Error of the terrain that is common to the whole film \[m\].
    pub terrain_bias_m: f64,
}

/// The unknowns of one vehicle.
#[derive(Clone, Debug, PartialEq)]
pub struct VehicleEstimate {
    /// `world_from_vehicle` of each frame; there is one for every frame of the vehicle's span.
    pub poses: Vec<Option<Pose>>,
    /// Position of each point in the vehicle frame; `None` where it is not determined.
    pub points: Vec<Option<Point3<f64>>>,
    /// Whether the rays to a point leave its depth open.
    pub open_depth: Vec<bool>,
    /// Why the vehicle is left out of the adjustment, if it is.
    pub left_out: Option<String>,
}

/// Where and how a point moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackPoint {
    /// Index of the frame.
    pub frame: usize,
    /// Position in the world \[m\].
    pub position: Point3<f64>,
    /// Horizontal speed \[m/s\]; `None` where the track is a single frame.
    pub speed_mps: Option<f64>,
    /// Heading of the vehicle \[rad\].
    pub heading_rad: f64,
}

impl Estimate {
    /// Whether every number is one.
    pub fn is_finite(&self) -> bool {
        let pose = |p: &Pose| p.to_homogeneous().iter().all(|v| v.is_finite());
        let point = |p: &Point3<f64>| p.iter().all(|v| v.is_finite());
        self.camera_poses.iter().all(pose)
            && self.targets.iter().flatten().all(point)
            && self
                .vehicles
                .iter()
                .all(|v| v.poses.iter().flatten().all(pose) && v.points.iter().flatten().all(point))
    }

    /// Computed image point of a point of a vehicle; `None` where one of its unknowns has no value
    /// or the camera does not see it.
    pub fn vehicle_image_px(
        &self,
        problem: &Problem,
        vehicle: usize,
        frame: usize,
        point: usize,
    ) -> Option<Vector2<f64>> {
        let estimate = &self.vehicles[vehicle];
        let in_world = estimate.poses[frame]? * estimate.points[point]?;
        problem.camera.project(&self.camera_poses[frame].inverse_transform_point(&in_world).coords)
    }

    /// Computed image point of a target at `position`.
    pub fn target_image_px(
        &self,
        problem: &Problem,
        frame: usize,
        position: &Point3<f64>,
    ) -> Option<Vector2<f64>> {
        problem.camera.project(&self.camera_poses[frame].inverse_transform_point(position).coords)
    }
}

impl VehicleEstimate {
    /// The given poses and no points.
    pub fn without_points(vehicle: &Vehicle) -> Self {
        let points = vec![None; vehicle.points.len()];
        VehicleEstimate { poses: vehicle.poses.clone(), points, open_depth: Vec::new(), left_out: None }
    }

    /// The track of the marker (without one, or where it is not determined, of the origin), one
    /// point for each frame of the vehicle's span that has a pose. Speeds are central differences of
    /// the positions, one-sided at the ends.
    pub fn track(&self, problem: &Problem, vehicle: &Vehicle) -> Vec<TrackPoint> {
        let marker = vehicle.marker.and_then(|m| self.points[m]).unwrap_or_else(Point3::origin);
        let mut track: Vec<TrackPoint> = vehicle
            .span()
            .filter_map(|frame| {
                let pose = self.poses[frame]?;
                Some(TrackPoint {
                    frame,
                    position: pose * marker,
                    speed_mps: None,
                    heading_rad: geometry::heading_rad(&pose),
                })
            })
            .collect();
        for i in 0..track.len() {
            let (before, after) = (i.saturating_sub(1), (i + 1).min(track.len() - 1));
            if before < after {
                let time = |k: usize| problem.frames[track[k].frame].time_s;
                let moved = track[after].position.xy() - track[before].position.xy();
                track[i].speed_mps = Some(moved.norm() / (time(after) - time(before)));
            }
        }
        track
    }

    /// Gives a pose to frames of the span that have none, between their neighbours that have one.
    pub fn bridge_gaps(&mut self, problem: &Problem, vehicle: &Vehicle) {
        let known: Vec<(usize, Pose)> =
            vehicle.span().filter_map(|frame| Some((frame, self.poses[frame]?))).collect();
        for pair in known.windows(2) {
            let [(first, from), (last, to)] = [pair[0], pair[1]];
            let time = |frame: usize| problem.frames[frame].time_s;
            for frame in first + 1..last {
                let fraction = (time(frame) - time(first)) / (time(last) - time(first));
                self.poses[frame] = Some(geometry::interpolate(&from, &to, fraction));
            }
        }
    }
}
