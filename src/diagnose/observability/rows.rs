//! What measurements and real knowledge say of the unknowns: coordinates of all blocks and the whitened rows
//! of the Jacobian, without anything that is only a start, a convention or a smoothness.

use crate::camera::INTERIOR;
use crate::estimate::{Estimate, RowMotion};
use crate::problem::{Freedom, Known, Problem, Role};
use crate::refine::{LEAST_CONTACT_SIGMA, LEAST_HEIGHT_SIGMA_M, antenna, highest_points, positions_at};
use crate::residuals::ground_contact::{FirstContact, NextContact};
use crate::residuals::known_coordinate::{KnownCoordinate, KnownNumber, KnownZero};
use crate::residuals::pose_prior::PosePrior;
use crate::residuals::row_image_point::{AtRow, RowTargetImagePoint, RowVehicleImagePoint};
use crate::residuals::target_image_point::TargetImagePoint;
use crate::residuals::vehicle_image_point::VehicleImagePoint;
use nalgebra::{DMatrix, Rotation3};
use std::sync::Arc;
use trackbundle_solver::manifold::write_pose;
use trackbundle_solver::residual::{Jacobian, Residual};

/// What is held exactly counts as measured with this standard deviation \[m or rad\].
const EXACT: f64 = 1e-4;

/// Whose coordinates a block is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Owner {
    /// The camera in a frame.
    Camera(usize),
    /// A vehicle in a frame.
    Pose(usize, usize),
    /// A point of a vehicle.
    Point(usize, usize),
    /// A target.
    Target(usize),
    /// The bias of the terrain.
    Bias,
    /// The interior orientation.
    Interior,
    /// The readout time.
    Readout,
    /// Clock, drift and shift of a receiver.
    Receiver(usize),
}

/// All coordinates, those that are held too, and where they are.
#[derive(Default)]
pub struct Coordinates {
    /// Owner, first coordinate and number of coordinates of each block.
    pub blocks: Vec<(Owner, usize, usize)>,
    /// Whether each coordinate is adjusted.
    pub is_free: Vec<bool>,
    /// First coordinate of the camera of each frame.
    pub cameras: Vec<usize>,
    /// Whether all of the pose of each camera is given with a standard deviation.
    pub camera_is_known: Vec<bool>,
    /// First coordinate of each vehicle's pose in each frame.
    pub poses: Vec<Vec<Option<usize>>>,
    /// First coordinate of each vehicle's points.
    pub points: Vec<Vec<Option<usize>>>,
    /// First coordinate of each target.
    pub targets: Vec<Option<usize>>,
    bias: usize,
    /// Interior orientation and readout time, where image points depend on them.
    open_camera: Option<[usize; 2]>,
    /// First coordinate of each receiver.
    pub receivers: Vec<usize>,
}

impl Coordinates {
    /// The coordinates that an estimate has values for.
    pub fn new(problem: &Problem, estimate: &Estimate) -> Coordinates {
        let mut all = Coordinates::default();
        let camera = problem.camera_pose_sigma.components();
        for (frame, given) in problem.camera_poses.iter().enumerate() {
            let is_held = camera.map(|sigma| given.is_some() && sigma == Some(0.0));
            let start = all.add(Owner::Camera(frame), &is_held.map(|held| !held));
            all.cameras.push(start);
            all.camera_is_known.push(given.is_some() && camera.iter().all(Option::is_some));
        }
        let sigma = problem.vehicle_pose_sigma.components();
        for (at, (vehicle, found)) in problem.vehicles.iter().zip(&estimate.vehicles).enumerate() {
            let takes_part = found.left_out.is_none();
            let (span, without) = (vehicle.span(), vehicle.frames_without_pose());
            let mut poses = vec![None; problem.frames.len()];
            for frame in span.filter(|frame| takes_part && found.poses[*frame].is_some()) {
                let is_given = !without[frame] && vehicle.poses[frame].is_some();
                let free = sigma.map(|sigma| !(is_given && sigma == Some(0.0)));
                poses[frame] = Some(all.add(Owner::Pose(at, frame), &free));
            }
            all.poses.push(poses);
            let mut points = vec![None; vehicle.points.len()];
            for (index, point) in vehicle.points.iter().enumerate() {
                if takes_part && found.points[index].is_some() {
                    points[index] = Some(all.add(Owner::Point(at, index), &point.known.map(is_open)));
                }
            }
            all.points.push(points);
        }
        for (at, (target, place)) in problem.targets.iter().zip(&estimate.targets).enumerate() {
            let counts = target.role == Role::Control && place.is_some();
            let start = counts.then(|| all.add(Owner::Target(at), &target.known.map(is_open)));
            all.targets.push(start);
        }
        let is_biased = problem.ground.as_ref().is_some_and(|ground| ground.bias_sigma_m > 0.0);
        all.bias = all.add(Owner::Bias, &[is_biased]);
        if problem.has_open_camera() {
            let interior =
                all.add(Owner::Interior, &problem.calibration.map(|freedom| freedom.is_adjusted()));
            let readout = all.add(Owner::Readout, &[problem.shutter.freedom.is_adjusted()]);
            all.open_camera = Some([interior, readout]);
        }
        for (at, receiver) in problem.receivers.iter().enumerate() {
            let known = &receiver.knowledge;
            let shifts = known.shift_sigma_m > 0.0;
            let free = [
                known.clock_offset.is_none_or(|offset| offset.sigma_s > 0.0),
                known.drift_sigma > 0.0,
                shifts,
                shifts,
                shifts,
            ];
            let start = all.add(Owner::Receiver(at), &free);
            all.receivers.push(start);
        }
        all
    }

    fn add(&mut self, owner: Owner, free: &[bool]) -> usize {
        let start = self.is_free.len();
        self.blocks.push((owner, start, free.len()));
        self.is_free.extend_from_slice(free);
        start
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.is_free.len()
    }

    /// How many are adjusted.
    pub fn unknowns(&self) -> usize {
        self.is_free.iter().filter(|free| **free).count()
    }
}

fn is_open(known: Option<Known>) -> bool {
    known.is_none_or(|known| known.sigma_m > 0.0)
}

/// An image point that has rows.
#[derive(Clone, Copy, Debug)]
pub struct Sighting {
    /// Index of the frame.
    pub frame: usize,
    /// Index of the point or target.
    pub point: usize,
    /// The first of its two rows.
    pub row: usize,
}

/// Whitened rows of the Jacobian over all coordinates: image points, then knowledge, then what is held.
#[derive(Default)]
pub struct Rows {
    starts: Vec<usize>,
    entries: Vec<(usize, f64)>,
    /// Image points of each vehicle.
    pub of_vehicles: Vec<Vec<Sighting>>,
    /// Image points of targets.
    pub of_targets: Vec<Sighting>,
    /// How many rows are those of image points.
    pub images: usize,
    /// How many rows are not of coordinates that are held.
    pub measured: usize,
}

impl Rows {
    /// The rows at an estimate.
    pub fn new(problem: &Problem, estimate: &Estimate, all: &Coordinates) -> Rows {
        let mut rows = Rows { starts: vec![0], ..Rows::default() };
        rows.add_images(problem, estimate, all);
        rows.images = rows.len();
        rows.add_known_poses(problem, estimate, all);
        rows.add_known_points(problem, estimate, all);
        rows.add_contacts(problem, estimate, all);
        rows.add_camera_knowledge(problem, estimate, all);
        rows.add_receivers(problem, estimate, all);
        rows.measured = rows.len();
        for coordinate in (0..all.len()).filter(|at| !all.is_free[*at]) {
            rows.entries.push((coordinate, 1.0 / EXACT));
            rows.starts.push(rows.entries.len());
        }
        rows
    }

    /// How many rows there are.
    pub fn len(&self) -> usize {
        self.starts.len() - 1
    }

    /// The coordinates that a row depends on, and its derivatives by them.
    pub fn row(&self, row: usize) -> &[(usize, f64)] {
        &self.entries[self.starts[row]..self.starts[row + 1]]
    }

    /// The root of the sum of squares of each column; 1 where that is zero.
    pub fn column_norms(&self, columns: usize) -> Vec<f64> {
        let mut squares = vec![0.0; columns];
        self.entries.iter().for_each(|(at, value)| squares[*at] += value * value);
        squares.into_iter().map(|s: f64| if s > 0.0 { s.sqrt() } else { 1.0 }).collect()
    }

    /// Some rows times the columns of a matrix whose rows are coordinates.
    pub fn times(&self, rows: &[usize], x: &DMatrix<f64>) -> DMatrix<f64> {
        let mut product = DMatrix::zeros(rows.len(), x.ncols());
        for column in 0..x.ncols() {
            let x = x.column(column);
            for (into, row) in rows.iter().enumerate() {
                product[(into, column)] = self.row(*row).iter().map(|(at, value)| value * x[*at]).sum();
            }
        }
        product
    }

    /// The rows that depend on each coordinate.
    pub fn of_coordinates(&self, coordinates: usize) -> Vec<Vec<usize>> {
        let mut rows = vec![Vec::new(); coordinates];
        for row in 0..self.len() {
            self.row(row).iter().for_each(|(at, _)| rows[*at].push(row));
        }
        rows
    }

    /// Adds the rows of a residual whose standard deviation is known, and returns the first; `None` where it
    /// has no value.
    fn add<const ROWS: usize, const BLOCKS: usize, R: Residual<ROWS, BLOCKS>>(
        &mut self,
        residual: &R,
        blocks: [(usize, &[f64]); BLOCKS],
        sigma: [Option<f64>; ROWS],
    ) -> Option<usize> {
        let mut jacobian = Jacobian::zeros();
        residual.evaluate(&blocks.map(|block| block.1), Some(&mut jacobian))?;
        let first = self.len();
        for (row, sigma) in sigma.into_iter().enumerate() {
            let Some(sigma) = sigma.filter(|sigma| *sigma > 0.0) else { continue };
            for ((derivative, manifold), (start, _)) in jacobian.0.iter().zip(R::MANIFOLDS).zip(&blocks) {
                let columns = 0..manifold.tangent();
                self.entries.extend(columns.map(|at| (start + at, derivative[(row, at)] / sigma)));
            }
            self.starts.push(self.entries.len());
        }
        Some(first)
    }

    fn add_images(&mut self, problem: &Problem, estimate: &Estimate, all: &Coordinates) {
        let camera = Arc::new(problem.camera.clone());
        let (interior, readout) = (estimate.camera.interior(), [estimate.readout_s]);
        let open = all.open_camera.map(|[a, b]| {
            let blocks = [(a, interior.as_slice()), (b, readout.as_slice())];
            (RowMotion::new(problem, estimate), blocks)
        });
        let cameras: Vec<[f64; 7]> = estimate.camera_poses.iter().map(write_pose).collect();
        for (at, (vehicle, found)) in problem.vehicles.iter().zip(&estimate.vehicles).enumerate() {
            let mut sightings = Vec::new();
            for seen in &vehicle.observations {
                let blocks = (all.poses[at][seen.frame], all.points[at][seen.point]);
                let values = (&found.poses[seen.frame], &found.points[seen.point]);
                let ((Some(pose_at), Some(point_at)), (Some(pose), Some(point))) = (blocks, values) else {
                    continue;
                };
                let pose = write_pose(pose);
                let [c, v, p] = [
                    (all.cameras[seen.frame], cameras[seen.frame].as_slice()),
                    (pose_at, pose.as_slice()),
                    (point_at, point.coords.as_slice()),
                ];
                let (camera, observed_px, sigma) = (camera.clone(), seen.image_px, [Some(seen.sigma_px); 2]);
                let row = match &open {
                    None => self.add(&VehicleImagePoint { camera, observed_px }, [c, v, p], sigma),
                    Some((motion, [interior, readout])) => {
                        let twist = motion.vehicles[at][seen.frame];
                        let residual = RowVehicleImagePoint(AtRow {
                            row_share: camera.row_delay(observed_px.y),
                            camera,
                            observed_px,
                            twist,
                        });
                        self.add(&residual, [c, v, p, *interior, *readout], sigma)
                    }
                };
                sightings.extend(row.map(|row| Sighting { frame: seen.frame, point: seen.point, row }));
            }
            self.of_vehicles.push(sightings);
        }
        for seen in &problem.target_observations {
            let (Some(at), Some(place)) = (all.targets[seen.target], estimate.targets[seen.target]) else {
                continue;
            };
            let c = (all.cameras[seen.frame], cameras[seen.frame].as_slice());
            let target = (at, place.coords.as_slice());
            let (camera, observed_px, sigma) = (camera.clone(), seen.image_px, [Some(seen.sigma_px); 2]);
            let row = match &open {
                None => self.add(&TargetImagePoint { camera, observed_px }, [c, target], sigma),
                Some((motion, [interior, readout])) => {
                    let twist = motion.world[seen.frame];
                    let residual = RowTargetImagePoint(AtRow {
                        row_share: camera.row_delay(observed_px.y),
                        camera,
                        observed_px,
                        twist,
                    });
                    self.add(&residual, [c, target, *interior, *readout], sigma)
                }
            };
            self.of_targets.extend(row.map(|row| Sighting { frame: seen.frame, point: seen.target, row }));
        }
    }

    fn add_known_poses(&mut self, problem: &Problem, estimate: &Estimate, all: &Coordinates) {
        let given = problem.camera_poses.iter().flatten().count();
        let sigma = problem.camera_pose_sigma.components().map(|s| Some(s? * (given as f64).sqrt()));
        for (frame, pose) in problem.camera_poses.iter().enumerate() {
            if let Some(start) = *pose {
                let residual = PosePrior { start, axes: Rotation3::identity() };
                let value = write_pose(&estimate.camera_poses[frame]);
                self.add(&residual, [(all.cameras[frame], &value)], sigma);
            }
        }
    }

    fn add_known_points(&mut self, problem: &Problem, estimate: &Estimate, all: &Coordinates) {
        let highest = highest_points(problem, estimate);
        let mut add = |start: usize, place: &[f64], axis: usize, value_m: f64, sigma_m: f64| {
            self.add(&KnownCoordinate { axis, known_m: value_m }, [(start, place)], [Some(sigma_m)]);
        };
        for (at, target) in problem.targets.iter().enumerate() {
            let (Some(start), Some(place)) = (all.targets[at], &estimate.targets[at]) else { continue };
            for (axis, known) in target.known.iter().enumerate() {
                if let Some(Known { value_m, sigma_m }) = *known {
                    add(start, place.coords.as_slice(), axis, value_m, sigma_m);
                }
            }
        }
        for (at, (vehicle, found)) in problem.vehicles.iter().zip(&estimate.vehicles).enumerate() {
            for (index, point) in vehicle.points.iter().enumerate() {
                let (Some(start), Some(place)) = (all.points[at][index], &found.points[index]) else {
                    continue;
                };
                let place = place.coords.as_slice();
                for (axis, known) in point.known.iter().enumerate() {
                    if let Some(Known { value_m, sigma_m }) = *known {
                        add(start, place, axis, value_m, sigma_m);
                    }
                }
                if let (Some(height), true) = (vehicle.height, highest[at] == Some(index)) {
                    add(start, place, 2, height.value_m, height.sigma_m.max(LEAST_HEIGHT_SIGMA_M));
                }
            }
        }
    }

    fn add_camera_knowledge(&mut self, problem: &Problem, estimate: &Estimate, all: &Coordinates) {
        let Some([interior, readout]) = all.open_camera else { return };
        let value = estimate.camera.interior();
        for (at, (freedom, known)) in problem.calibration.iter().zip(problem.camera.interior()).enumerate() {
            if let Freedom::Prior(sigma) = freedom {
                let residual = KnownNumber::<INTERIOR> { at, known };
                self.add(&residual, [(interior, &value)], [Some(*sigma)]);
            }
        }
        if let Freedom::Prior(sigma) = problem.shutter.freedom {
            let residual = KnownNumber::<1> { at: 0, known: problem.shutter.readout_s };
            self.add(&residual, [(readout, &[estimate.readout_s])], [Some(sigma)]);
        }
    }

    fn add_receivers(&mut self, problem: &Problem, estimate: &Estimate, all: &Coordinates) {
        for (at, (receiver, found)) in problem.receivers.iter().zip(&estimate.receivers).enumerate() {
            let (known, start) = (&receiver.knowledge, all.receivers[at]);
            let shift = found.shift_m;
            let value = [found.clock_offset_s, found.clock_drift, shift.x, shift.y, shift.z];
            let vehicle = receiver.vehicle;
            let (Some(point_at), Some(antenna)) =
                (all.points[vehicle][receiver.point], antenna(receiver, found, estimate))
            else {
                continue;
            };
            let placed = |frame: &usize| all.poses[vehicle][*frame].is_some();
            let frames: Vec<usize> = (0..problem.frames.len()).filter(placed).collect();
            for (residual, around, sigma_m) in positions_at(problem, &frames, receiver, found) {
                let pose = |frame: usize| estimate.vehicles[vehicle].poses[frame].as_ref().map(write_pose);
                let [Some(a), Some(b), Some(c)] = around.map(pose) else { continue };
                let starts = around.map(|frame| all.poses[vehicle][frame].unwrap_or(0));
                let blocks = [
                    (starts[0], a.as_slice()),
                    (starts[1], b.as_slice()),
                    (starts[2], c.as_slice()),
                    (point_at, antenna.coords.as_slice()),
                    (start, value.as_slice()),
                ];
                self.add(&residual, blocks, sigma_m.map(Some));
            }
            let offset = known.clock_offset.map_or(0.0, |offset| offset.sigma_s);
            let shift = known.shift_sigma_m;
            for (at, sigma) in [offset, known.drift_sigma, shift, shift, shift].into_iter().enumerate() {
                let residual = KnownNumber::<5> { at, known: value[at] };
                self.add(&residual, [(start, &value)], [Some(sigma)]);
            }
        }
    }

    fn add_contacts(&mut self, problem: &Problem, estimate: &Estimate, all: &Coordinates) {
        let Some(ground) = &problem.ground else { return };
        let bias = [estimate.terrain_bias_m];
        let bias = (all.bias, bias.as_slice());
        self.add(&KnownZero, [bias], [Some(ground.bias_sigma_m)]);
        let tilt = ground.tilt_sigma_rad.max(LEAST_CONTACT_SIGMA.1);
        let sigma = [ground.sigma_m.max(LEAST_CONTACT_SIGMA.0), tilt, tilt];
        for (poses, found) in all.poses.iter().zip(&estimate.vehicles) {
            let mut before: Option<(usize, usize, [f64; 7])> = None;
            for (frame, (start, pose)) in poses.iter().zip(&found.poses).enumerate() {
                let (Some(start), Some(pose)) = (*start, pose) else { continue };
                if ground.terrain.at(pose.translation.x, pose.translation.y).is_err() {
                    continue;
                }
                let value = write_pose(pose);
                match before {
                    None => {
                        let residual = FirstContact { terrain: ground.terrain.clone() };
                        self.add(&residual, [(start, &value), bias], sigma.map(Some));
                    }
                    Some((frame_before, at_before, value_before)) => {
                        let step_s = problem.frames[frame].time_s - problem.frames[frame_before].time_s;
                        let (residual, innovation) =
                            NextContact::after(ground.terrain.clone(), step_s, ground.correlation_s);
                        let sigma = sigma.map(|sigma| Some(sigma * innovation));
                        self.add(&residual, [(start, &value), (at_before, &value_before), bias], sigma);
                    }
                }
                before = Some((frame, start, value));
            }
        }
    }
}
