//! What we believe: the unknowns of a problem as a value to clone, compare and write.

mod left_out;
mod rows;

use crate::camera::Camera;
use crate::geometry::{self, Pose};
use crate::problem::{Problem, Receiver, Vehicle};
use crate::trajectory::{Order, Strengths, Trajectory};
pub use left_out::LeftOut;
use nalgebra::{Point3, Vector3};
pub use rows::{Imaging, RowMotion};

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
    /// The camera with its interior orientation.
    pub camera: Camera,
    /// Time from the first to the last row of an image \[s\].
    pub readout_s: f64,
    /// One for each receiver of the problem.
    pub receivers: Vec<ReceiverEstimate>,
}

/// Where the rear axle of a car usually is.
pub const USUAL_AXLE: [f64; 2] = [-1.3, 0.0];

/// Of the points of a body, so many of a hundred may stick out of its box to either side.
const BEYOND_BOX: usize = 5;

/// The unknowns of a receiver.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ReceiverEstimate {
    /// Its time minus video time, in the middle of the film \[s\].
    pub clock_offset_s: f64,
    /// The rate of that \[s/s\].
    pub clock_drift: f64,
    /// What all its positions are off by: measured minus true, in the world \[m\].
    pub shift_m: Vector3<f64>,
    /// From its point to its antenna, in the vehicle frame \[m\].
    pub lever_arm_m: Vector3<f64>,
}

impl ReceiverEstimate {
    /// Clock offset \[s\], drift and shift \[m\].
    pub fn numbers(&self) -> [f64; 5] {
        let shift = self.shift_m;
        [self.clock_offset_s, self.clock_drift, shift.x, shift.y, shift.z]
    }
}

/// The unknowns of one vehicle.
#[derive(Clone, Debug, PartialEq)]
pub struct VehicleEstimate {
    /// `world_from_vehicle` of each frame; there is one for every frame of the vehicle's span.
    pub poses: Vec<Option<Pose>>,
    /// Position of each point in the vehicle frame; `None` where it is not determined.
    pub points: Vec<Option<Point3<f64>>>,
    /// What its rays say of the depth of each point.
    pub depths: Vec<Depth>,
    /// How it moves between poses, where that was part of the adjustment.
    pub motion: Option<(Order, Strengths)>,
    /// Place of the rear axle along the body's x axis \[m\], and the direction in which it rolls,
    /// counter-clockwise from that axis \[rad\].
    pub axle: [f64; 2],
    /// How well the x axis points where the body drives, where that is how it was put \[rad\]; zero where
    /// something else fixes it.
    pub axes_sigma_rad: f64,
    /// The probability that the x axis points where the body came from; zero where something else fixes it.
    pub heading_turned: f64,
    /// Why the vehicle is left out of the adjustment, if it is.
    pub left_out: Option<LeftOut>,
}

/// What rays say of the depth of a point at the start, and what is known of it in the end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Depth {
    /// Where it is.
    Known,
    /// Nothing, but other knowledge does, better than that it is on a car.
    Told,
    /// Nothing, and perhaps other knowledge does.
    Weak,
    /// Nothing.
    Open,
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
    /// An estimate of poses and points, everything else as it is known beforehand.
    pub fn new(problem: &Problem, camera_poses: Vec<Pose>, vehicles: Vec<VehicleEstimate>) -> Self {
        let receiver = |receiver: &Receiver| ReceiverEstimate {
            clock_offset_s: receiver.knowledge.clock_offset.map_or(0.0, |known| known.value_s),
            lever_arm_m: receiver.knowledge.lever_arm_m,
            ..ReceiverEstimate::default()
        };
        Estimate {
            camera_poses,
            vehicles,
            targets: vec![None; problem.targets.len()],
            terrain_bias_m: 0.0,
            camera: problem.camera.clone(),
            readout_s: problem.shutter.readout_s,
            receivers: problem.receivers.iter().map(receiver).collect(),
        }
    }

    /// Where the antenna of a receiver is in the vehicle frame; `None` where its point has no place.
    pub fn antenna(&self, receiver: &Receiver, found: &ReceiverEstimate) -> Option<Point3<f64>> {
        let vehicle = &self.vehicles[receiver.vehicle];
        let point = vehicle.points[receiver.point].filter(|_| vehicle.left_out.is_none())?;
        Some(point + found.lever_arm_m)
    }

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
}

impl VehicleEstimate {
    /// The given poses and no points.
    pub fn without_points(vehicle: &Vehicle) -> Self {
        let points = vec![None; vehicle.points.len()];
        VehicleEstimate {
            poses: vehicle.poses.clone(),
            points,
            depths: Vec::new(),
            motion: None,
            axle: USUAL_AXLE,
            axes_sigma_rad: 0.0,
            heading_turned: 0.0,
            left_out: None,
        }
    }

    /// The continuous path of the vehicle through its poses, at any time; `None` where nothing is known of
    /// its motion.
    pub fn path(&self, problem: &Problem, vehicle: &Vehicle) -> Option<Trajectory> {
        let (order, strengths) = self.motion?;
        let known =
            vehicle.span().filter_map(|frame| Some((problem.frames[frame].time_s, self.poses[frame]?)));
        let (times_s, poses): (Vec<f64>, Vec<Pose>) = known.unzip();
        (poses.len() >= order.states()).then(|| Trajectory::new(times_s, poses, order, strengths))
    }

    /// The points at the sides of the box around the body: the lower and the upper one along each axis. Five in a
    /// hundred may stick out to either side, so that a mirror is no side.
    pub fn box_sides(&self) -> Option<[[usize; 2]; 3]> {
        let side = |axis: usize| {
            let places = self.points.iter().enumerate();
            let mut places: Vec<(f64, usize)> =
                places.filter_map(|(at, point)| Some(((*point)?[axis], at))).collect();
            places.sort_by(|a, b| a.0.total_cmp(&b.0));
            let cut = places.len() * BEYOND_BOX / 100;
            let last = places.len().checked_sub(1 + cut)?;
            Some([places[cut].1, places[last].1])
        };
        Some([side(0)?, side(1)?, side(2)?])
    }

    /// The middle of that box in x and y, and its lower side in z \[m\].
    pub fn middle(&self) -> Option<Point3<f64>> {
        let sides = self.box_sides()?;
        let value = |axis: usize, side: usize| Some(self.points[sides[axis][side]]?[axis]);
        let middle = |axis: usize| Some((value(axis, 0)? + value(axis, 1)?) / 2.0);
        Some(Point3::new(middle(0)?, middle(1)?, value(2, 0)?))
    }

    /// Where the middle of the box around the body goes when its axes turn about z: `dp/dw` in the vehicle frame
    /// \[m/rad\].
    pub fn middle_by_turn(&self) -> Vector3<f64> {
        let Some([x, y, _]) = self.box_sides() else { return Vector3::zeros() };
        let half = |side: [usize; 2], axis: usize| -> f64 {
            side.iter().filter_map(|at| Some((*self.points.get(*at)?)?[axis] / 2.0)).sum()
        };
        let middle = [half(x, 0), half(y, 1)];
        // Of a side of x, that it lies `y` beside the middle; and the other way round.
        Vector3::new(half(x, 1) - middle[1], -(half(y, 0) - middle[0]), 0.0)
    }

    /// The point whose track is reported, in the vehicle frame.
    fn marker(&self, vehicle: &Vehicle) -> Point3<f64> {
        vehicle.marker.and_then(|m| self.points[m]).unwrap_or_else(Point3::origin)
    }

    /// The places of [`VehicleEstimate::track`], by frame.
    pub fn places(&self, vehicle: &Vehicle) -> impl Iterator<Item = (usize, Point3<f64>)> {
        let marker = self.marker(vehicle);
        vehicle.span().filter_map(move |frame| Some((frame, self.poses[frame]? * marker)))
    }

    /// The track of the marker (without one, or where it is not determined, of the origin), one
    /// point for each frame of the vehicle's span that has a pose. Speeds are those of the path between the
    /// poses ([`VehicleEstimate::path`]); without one, central differences of the positions, one-sided at
    /// the ends.
    pub fn track(&self, problem: &Problem, vehicle: &Vehicle) -> Vec<TrackPoint> {
        let marker = self.marker(vehicle);
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
        if let Some(path) = self.path(problem, vehicle) {
            for place in &mut track {
                let state = path.state_at(problem.frames[place.frame].time_s);
                place.speed_mps = state.map(|state| state.speed_of_mps(&marker));
            }
            return track;
        }
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
