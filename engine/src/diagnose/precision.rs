//! Standard deviations of everything that is written.

use super::inner::{Inner, Joint, Piece};
use super::moment::{Function, Moment, direction};
use crate::estimate::{Estimate, TrackPoint, VehicleEstimate};
use crate::geometry::{Pose, skew};
use crate::problem::{PoseSigma, Problem};
use crate::refine::is_in_the_middle;
use crate::trajectory::Trajectory;
use nalgebra::{DVector, Point3, Vector3};
use rayon::prelude::*;

/// Standard deviations of a pose: of its position along the axes of the world \[m\], of its attitude about
/// the axes of the body \[rad\].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PosePrecision {
    /// x, y, z.
    pub position_m: [f64; 3],
    /// Roll, pitch, yaw.
    pub attitude_rad: [f64; 3],
}

/// Standard deviations of a place of a track.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackPrecision {
    /// x, y, z \[m\].
    pub position_m: [f64; 3],
    /// Covariance of x and y \[m^2\]; `None` where one of them is not determined.
    pub covariance_xy_m2: Option<f64>,
    /// Of the horizontal speed \[m/s\].
    pub speed_mps: Option<f64>,
    /// Of the heading \[rad\].
    pub heading_rad: f64,
}

/// Standard deviations of a place of a path at some time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StatePrecision {
    /// The time \[s\].
    pub time_s: f64,
    /// Of the marker, x, y, z \[m\].
    pub position_m: [f64; 3],
    /// Of its velocity \[m/s\].
    pub velocity_mps: [f64; 3],
    /// Of its horizontal speed \[m/s\].
    pub speed_mps: f64,
    /// Of the heading \[rad\].
    pub heading_rad: f64,
    /// Of the yaw rate \[rad/s\].
    pub yaw_rate_rps: f64,
}

/// Standard deviations, a posteriori; infinite where a quantity is not determined, `None` where it has none.
#[derive(Clone, Debug, Default)]
pub struct Precision {
    /// Of each frame's camera.
    pub cameras: Vec<Option<PosePrecision>>,
    /// Of each vehicle's pose in each frame.
    pub vehicles: Vec<Vec<Option<PosePrecision>>>,
    /// Of each vehicle's points \[m\].
    pub points: Vec<Vec<Option<[f64; 3]>>>,
    /// Of targets \[m\].
    pub targets: Vec<Option<[f64; 3]>>,
    /// Of each vehicle's track, in the order of [`crate::estimate::VehicleEstimate::track`].
    pub tracks: Vec<Vec<Option<TrackPrecision>>>,
    /// Of each vehicle's path, at the times that were asked for.
    pub states: Vec<Vec<StatePrecision>>,
}

impl Precision {
    /// Adds the vehicles of another, and takes the lesser standard deviations of cameras and targets.
    pub(super) fn join(&mut self, other: Precision) {
        let Precision { cameras, vehicles, points, targets, tracks, states } = other;
        let square = |sigmas: &[f64; 3]| sigmas.iter().map(|sigma| sigma * sigma).sum::<f64>();
        for (own, other) in self.cameras.iter_mut().zip(cameras) {
            if let (Some(a), Some(b)) = (&own, &other)
                && square(&b.position_m) < square(&a.position_m)
            {
                *own = other;
            }
        }
        for (own, other) in self.targets.iter_mut().zip(targets) {
            if let (Some(a), Some(b)) = (&own, &other)
                && square(b) < square(a)
            {
                *own = other;
            }
        }
        self.vehicles.extend(vehicles);
        self.points.extend(points);
        self.tracks.extend(tracks);
        self.states.extend(states);
    }
}

/// Standard deviations of an estimate; of paths so many times a second, if wanted.
pub fn precision(
    problem: &Problem,
    estimate: &Estimate,
    inner: &Inner<'_>,
    states_hz: Option<f64>,
) -> Precision {
    let model = &inner.network.model;
    let cameras = (0..problem.frames.len()).map(|frame| {
        let block = model.camera(frame);
        match inner.joint(0, &[inner.fixed_piece(0, block)]) {
            Some(joint) => Some(pose_precision(joint.sigmas())),
            None => held_pose(&problem.camera_pose_sigma),
        }
    });
    let targets = (0..problem.targets.len()).map(|target| {
        let block = model.target(target)?;
        match inner.joint(0, &[inner.fixed_piece(0, block)]) {
            Some(joint) => Some(joint.sigmas()),
            // Known exactly.
            None => Some([0.0; 3]),
        }
    });
    let mut out =
        Precision { cameras: cameras.collect(), targets: targets.collect(), ..Precision::default() };
    for (at, vehicle) in problem.vehicles.iter().enumerate() {
        let found = &estimate.vehicles[at];
        let poses = found.poses.iter().enumerate().map(|(frame, pose)| {
            let (pose, block) = ((*pose)?, model.vehicle_pose(at, frame)?);
            let piece = inner.pose_piece(at, block, &pose);
            let middle = if is_in_the_middle(vehicle) { inner.place_piece(at) } else { None };
            match middle {
                Some(middle) => {
                    let joint = inner.joint(at, &[piece, middle])?;
                    Some(with_axes(in_the_middle(&joint, &pose, found), found))
                }
                None => match inner.joint(at, &[piece]) {
                    Some(joint) => Some(with_axes(pose_precision(joint.sigmas()), found)),
                    None => held_pose(&problem.vehicle_pose_sigma),
                },
            }
        });
        out.vehicles.push(poses.collect());
        let points = found.points.iter().enumerate().map(|(point, place)| {
            let (place, block) = ((*place)?, model.shape_point(at, point)?);
            match inner.joint(at, &[inner.point_piece(at, block, &place)]) {
                Some(joint) => Some(joint.sigmas()),
                None => Some([0.0; 3]),
            }
        });
        out.points.push(points.collect());
        let (mut tracks, mut states) = (Vec::new(), Vec::new());
        if found.left_out.is_none() {
            let track = found.track(problem, vehicle);
            let marker = vehicle.marker.and_then(|m| found.points[m]);
            let path = found.path(problem, vehicle);
            let track = Track { problem, estimate, inner, vehicle: at, marker, track: &track, path };
            tracks = (0..track.track.len()).into_par_iter().map(|place| track.precision(place)).collect();
            if let (Some(rate_hz), Some(path)) = (states_hz, &track.path) {
                let times = path.times_at(rate_hz);
                states = times.into_par_iter().filter_map(|time_s| track.state(path, time_s)).collect();
            }
        }
        out.tracks.push(tracks);
        out.states.push(states);
    }
    out
}

/// With what puts the x axis where it points.
fn with_axes(sigma: PosePrecision, found: &VehicleEstimate) -> PosePrecision {
    let [roll, pitch, yaw] = sigma.attitude_rad;
    PosePrecision { attitude_rad: [roll, pitch, yaw.hypot(found.axes_sigma_rad)], ..sigma }
}

fn pose_precision(sigmas: [f64; 6]) -> PosePrecision {
    let [x, y, z, roll, pitch, yaw] = sigmas;
    PosePrecision { position_m: [x, y, z], attitude_rad: [roll, pitch, yaw] }
}

/// Of a pose whose origin lies in the middle of the body: that moves with the points at its sides.
fn in_the_middle(joint: &Joint, pose: &Pose, found: &VehicleEstimate) -> PosePrecision {
    let turn = pose.rotation.to_rotation_matrix();
    let sigma = |gradient: &[(usize, f64)]| {
        let mut all = DVector::zeros(9);
        gradient.iter().for_each(|(at, value)| all[*at] = *value);
        joint.variance(&all).sqrt()
    };
    let position = |axis: usize| {
        let of_middle = (0..3).map(|k| (6 + k, turn.matrix()[(axis, k)]));
        let of_axes = (turn * found.middle_by_turn())[axis] * found.axes_sigma_rad;
        sigma(&[(axis, 1.0)].into_iter().chain(of_middle).collect::<Vec<_>>()).hypot(of_axes)
    };
    PosePrecision {
        position_m: [0, 1, 2].map(position),
        attitude_rad: [3, 4, 5].map(|at| sigma(&[(at, 1.0)])),
    }
}

/// Of a pose that is held: none where it is known to be exact; of one that is held for want of anything
/// better nothing is known.
fn held_pose(sigma: &PoseSigma) -> Option<PosePrecision> {
    sigma.is_exact().then_some(PosePrecision { position_m: [0.0; 3], attitude_rad: [0.0; 3] })
}

/// The track of a vehicle.
struct Track<'a> {
    problem: &'a Problem,
    estimate: &'a Estimate,
    inner: &'a Inner<'a>,
    vehicle: usize,
    /// The marker in the body; none where the track is that of the origin.
    marker: Option<Point3<f64>>,
    track: &'a [TrackPoint],
    /// Its path, whose poses are those of the places.
    path: Option<Trajectory>,
}

impl Track<'_> {
    /// A pose of the track, and its piece where it is not held exactly.
    fn pose(&self, place: usize) -> Option<(Option<Piece>, Pose)> {
        let frame = self.track[place].frame;
        let pose = self.estimate.vehicles[self.vehicle].poses[frame]?;
        let block = self.inner.network.model.vehicle_pose(self.vehicle, frame)?;
        let is_free = self.inner.network.model.system.range_of(block).is_some();
        Some((is_free.then(|| self.inner.pose_piece(self.vehicle, block, &pose)), pose))
    }

    /// The place in the body whose track it is, where it is free.
    fn marker_piece(&self) -> Option<Piece> {
        self.inner.place_piece(self.vehicle)
    }

    /// By how much an error of one standard deviation of the axes of the body moves a place of the track in the
    /// world \[m\]: the middle of a body depends on them.
    fn by_axes(&self, pose: &Pose) -> Vector3<f64> {
        let found = &self.estimate.vehicles[self.vehicle];
        match is_in_the_middle(&self.problem.vehicles[self.vehicle]) && self.marker.is_none() {
            true => pose.rotation * found.middle_by_turn() * found.axes_sigma_rad,
            false => Vector3::zeros(),
        }
    }

    /// Of a heading: what the poses leave, and what the axes of the body do.
    fn of_heading(&self, sigma_rad: f64) -> f64 {
        sigma_rad.hypot(self.estimate.vehicles[self.vehicle].axes_sigma_rad)
    }

    /// Gradients of the three coordinates of a place by the pose and the marker.
    fn gradient(&self, pose: &Pose) -> [[Vector3<f64>; 3]; 3] {
        let marker = self.marker.map_or(Vector3::zeros(), |place| place.coords);
        let turn = pose.rotation.to_rotation_matrix();
        let by_turn = -(turn.matrix() * skew(&marker));
        std::array::from_fn(|axis| {
            let mut shift = Vector3::zeros();
            shift[axis] = 1.0;
            [shift, by_turn.row(axis).transpose(), turn.matrix().row(axis).transpose()]
        })
    }

    fn precision(&self, place: usize) -> Option<TrackPrecision> {
        let (piece, pose) = self.pose(place)?;
        let joint = Terms::new(self, vec![piece])?;
        let by_axis =
            self.gradient(&pose).map(|[shift, turn, point]| joint.gradient(&[Some((shift, turn))], point));
        let of_axes = self.by_axes(&pose);
        let variances = [0, 1, 2].map(|axis| joint.variance(&by_axis[axis]) + of_axes[axis].powi(2));
        let covariance = joint.covariance(&by_axis[0], &by_axis[1]) + of_axes.x * of_axes.y;
        // d(R ex) = R (dr x ex); the heading is that of its horizontal part.
        let turn = pose.rotation.to_rotation_matrix();
        let ahead = turn.matrix().column(0).into_owned();
        let by_turn = -(turn.matrix() * skew(&Vector3::x()));
        let level = ahead.xy().norm_squared();
        let of_turn = (by_turn.row(1) * ahead.x - by_turn.row(0) * ahead.y) / level;
        let heading = joint.gradient(&[Some((Vector3::zeros(), of_turn.transpose()))], Vector3::zeros());
        Some(TrackPrecision {
            position_m: variances.map(f64::sqrt),
            covariance_xy_m2: (variances[0].is_finite() && variances[1].is_finite()).then_some(covariance),
            speed_mps: self.speed(place),
            heading_rad: self.of_heading(joint.variance(&heading).sqrt()),
        })
    }

    /// Of the speed: that of the path, as far as poses hold it and as it is free between them; without a
    /// path half the sum of the two steps beside a place, as the speed itself.
    fn speed(&self, place: usize) -> Option<f64> {
        match &self.path {
            Some(path) => self.speed_of_path(path, place),
            None => self.speed_of_differences(place),
        }
    }

    fn speed_of_path(&self, path: &Trajectory, place: usize) -> Option<f64> {
        let (moment, terms) = self.moment(path, self.problem.frames[self.track[place].frame].time_s)?;
        Some(terms.sigma(&moment, &moment.of_speed()))
    }

    /// The path at any time, and what of its covariance is wanted.
    fn moment(&self, path: &Trajectory, time_s: f64) -> Option<(Moment, Terms)> {
        let linear = path.linear_at(time_s)?;
        let pieces = linear.knots.clone().map(|knot| Some(self.pose(knot)?.0)).collect::<Option<_>>()?;
        let terms = Terms::new(self, pieces)?;
        let marker = self.marker.unwrap_or_else(Point3::origin);
        Some((Moment { linear, marker }, terms))
    }

    /// The state at a time.
    fn state(&self, path: &Trajectory, time_s: f64) -> Option<StatePrecision> {
        let (moment, terms) = self.moment(path, time_s)?;
        let sigma = |function| terms.sigma(&moment, &function);
        let axis = |axis: usize| Vector3::ith(axis, 1.0);
        let of_axes = self.by_axes(&moment.linear.state.pose);
        Some(StatePrecision {
            time_s,
            position_m: [0, 1, 2].map(|k| sigma(moment.of_position(&axis(k))).hypot(of_axes[k])),
            velocity_mps: [0, 1, 2].map(|k| sigma(moment.of_velocity(&axis(k)))),
            speed_mps: sigma(moment.of_speed()),
            heading_rad: self.of_heading(sigma(moment.of_heading())),
            yaw_rate_rps: sigma(moment.of_yaw_rate()),
        })
    }

    fn speed_of_differences(&self, place: usize) -> Option<f64> {
        let (before, after) = (place.saturating_sub(1), (place + 1).min(self.track.len() - 1));
        if before == after {
            return None;
        }
        let moved = self.track[after].position.xy() - self.track[before].position.xy();
        let time = |k: usize| self.problem.frames[self.track[k].frame].time_s;
        let ((first, from), (second, to)) = (self.pose(before)?, self.pose(after)?);
        let joint = Terms::new(self, vec![first, second])?;
        let (of_from, of_to) = (self.gradient(&from), self.gradient(&to));
        let by_axis = [0, 1].map(|axis| {
            let [shift, turn, point] = of_from[axis];
            let [shift_to, turn_to, point_to] = of_to[axis];
            joint.gradient(&[Some((-shift, -turn)), Some((shift_to, turn_to))], point_to - point)
        });
        let direction = direction(moved);
        let gradient = &by_axis[0] * direction.x + &by_axis[1] * direction.y;
        Some(joint.variance(&gradient).sqrt() / (time(after) - time(before)))
    }
}

/// Some poses and the marker, and where each is among the free numbers; those that are held have no
/// place and no variance.
struct Terms {
    joint: Option<Joint>,
    poses: Vec<Option<usize>>,
    marker: Option<usize>,
    size: usize,
}

impl Terms {
    fn new(track: &Track<'_>, poses: Vec<Option<Piece>>) -> Option<Terms> {
        let (mut pieces, mut size) = (Vec::new(), 0);
        let mut place = |piece: Option<Piece>| {
            let piece = piece?;
            pieces.push(piece);
            size += 6;
            Some(size - 6)
        };
        let places: Vec<Option<usize>> = poses.into_iter().map(&mut place).collect();
        let marker = track.marker_piece().map(|piece| {
            pieces.push(piece);
            size += 3;
            size - 3
        });
        let joint = match pieces.is_empty() {
            true => None,
            false => Some(track.inner.joint(track.vehicle, &pieces)?),
        };
        Some(Terms { joint, poses: places, marker, size })
    }

    /// A gradient from those by the shift and the turn of each pose and by the marker.
    fn gradient(
        &self,
        by_pose: &[Option<(Vector3<f64>, Vector3<f64>)>],
        by_marker: Vector3<f64>,
    ) -> DVector<f64> {
        let mut gradient = DVector::zeros(self.size);
        for (place, part) in self.poses.iter().zip(by_pose) {
            if let (Some(at), Some((shift, turn))) = (*place, *part) {
                gradient.rows_mut(at, 3).copy_from(&shift);
                gradient.rows_mut(at + 3, 3).copy_from(&turn);
            }
        }
        if let Some(at) = self.marker {
            gradient.rows_mut(at, 3).copy_from(&by_marker);
        }
        gradient
    }

    /// Standard deviation of a function of the state at a moment.
    fn sigma(&self, moment: &Moment, function: &Function) -> f64 {
        let by_pose: Vec<_> = moment.by_poses(function).into_iter().map(Some).collect();
        (self.variance(&self.gradient(&by_pose, function.1)) + moment.between(function)).sqrt()
    }

    fn variance(&self, gradient: &DVector<f64>) -> f64 {
        self.joint.as_ref().map_or(0.0, |joint| joint.variance(gradient))
    }

    fn covariance(&self, a: &DVector<f64>, b: &DVector<f64>) -> f64 {
        self.joint.as_ref().map_or(0.0, |joint| (a.transpose() * &joint.covariance * b)[(0, 0)])
    }
}
