//! Directions in which no image point moves, by theory: each with its name.
//!
//! A rigid body with points `M`, seen by a camera at `c`, and a static world seen by a moving camera are the
//! same thing twice; what the first calls the pose of the body, the second calls the pose of the camera.
//!
//! ```text
//! frame of a body    dM = v + w x M     dt = -R v        dr = -w            shift v, rotation w
//! its scale          dM = M             dt = t - c                          each frame from its own camera
//! depth of a point   dM = ray in the body, where all rays are parallel; where all points of a body are
//!                    such, they take the place of its scale
//! a loose frame      what the image points in it leave open of its pose: fewer than three points
//! the world          cameras, static points and all vehicles that a camera sees are shifted and turned
//!                    together; its scale moves cameras and static points, and each vehicle as it lies to its
//!                    camera
//! a loose camera     takes all vehicles along
//! ```

use super::names::number;
use super::rows::{Coordinates, Rows, Sighting};
use super::{DatumFreedom, Kind, Part};
use crate::estimate::{Estimate, VehicleEstimate};
use crate::geometry::Pose;
use crate::network::{Owner, point_motion, pose_motion};
use crate::problem::Problem;
use nalgebra::{DMatrix, DVector, Matrix6, Point3, Vector3, Vector6};
use trackbundle_solver::manifold::body_from_observer_motion;

/// Rays whose directions differ by less than this are parallel \[rad\].
const PARALLEL_RAD: f64 = 1e-9;
/// What image points see of a pose by less than this, relative to what they see most, they do not see.
const UNSEEN: f64 = 1e-9;
/// In this order axes are named where a combination of several is open: heading first, shifts last.
const ORDER: [(DatumFreedom, usize); 6] = [
    (DatumFreedom::Rotation, 2),
    (DatumFreedom::Rotation, 0),
    (DatumFreedom::Rotation, 1),
    (DatumFreedom::Shift, 0),
    (DatumFreedom::Shift, 1),
    (DatumFreedom::Shift, 2),
];

/// A direction and its name. Its length is such that what it is about moves by about a metre.
#[derive(Clone, Debug)]
pub struct Candidate {
    /// What it is.
    pub kind: Kind,
    /// The perturbation of all coordinates.
    pub motion: DVector<f64>,
}

/// All candidates.
#[derive(Default)]
pub struct Candidates {
    /// Those of the world and then those of each vehicle.
    pub of_bodies: Vec<Vec<Candidate>>,
    /// Those of single frames, each for itself.
    pub of_frames: Vec<Vec<Candidate>>,
}

/// What candidates are made from.
struct Scene<'a> {
    problem: &'a Problem,
    estimate: &'a Estimate,
    all: &'a Coordinates,
    rows: &'a Rows,
}

/// The candidates of a problem at an estimate.
pub fn candidates(problem: &Problem, estimate: &Estimate, all: &Coordinates, rows: &Rows) -> Candidates {
    let scene = Scene { problem, estimate, all, rows };
    let mut found = Candidates::default();
    scene.add_world(&mut found);
    for vehicle in 0..problem.vehicles.len() {
        scene.add_vehicle(vehicle, &mut found);
    }
    scene.add_unseen(&mut found);
    found
}

/// A body and who sees what of it.
struct Body<'a> {
    rows: &'a Rows,
    sightings: &'a [Sighting],
    /// First coordinate of its pose in each frame that has one to be found.
    poses: Vec<Option<usize>>,
    /// First coordinate of each point.
    points: &'a [Option<usize>],
    /// Whether something of a point is known.
    knows: Vec<bool>,
}

/// A frame whose image points leave something of the pose open.
struct Loose {
    frame: usize,
    /// What they leave open of the pose, as columns.
    open: DMatrix<f64>,
    /// What they say of it.
    seen: DMatrix<f64>,
    /// Points that are seen here only, and follow.
    followers: Vec<usize>,
}

impl Body<'_> {
    /// Whether a point links the frames in which it is seen: in one frame only it follows any pose.
    fn links(&self) -> Vec<bool> {
        let mut count = vec![0; self.points.len()];
        self.sightings.iter().for_each(|seen| count[seen.point] += 1);
        let is_alone = self.poses.iter().flatten().count() == 1;
        count.iter().zip(&self.knows).map(|(count, knows)| *count > 1 || *knows || is_alone).collect()
    }

    /// The derivatives of an image point by six or three coordinates.
    fn by(&self, seen: &Sighting, start: usize, columns: usize) -> DMatrix<f64> {
        let mut derivative = DMatrix::zeros(2, columns);
        for row in 0..2 {
            for (at, value) in self.rows.row(seen.row + row) {
                if (start..start + columns).contains(at) {
                    derivative[(row, at - start)] = *value;
                }
            }
        }
        derivative
    }

    fn loose(&self) -> Vec<Loose> {
        let links = self.links();
        let mut of_frame: Vec<Vec<&Sighting>> = vec![Vec::new(); self.poses.len()];
        self.sightings.iter().for_each(|seen| of_frame[seen.frame].push(seen));
        let of_pose = |(frame, (pose, sightings)): (usize, (&Option<usize>, Vec<&Sighting>))| {
            let pose = (*pose)?;
            let (linked, followers): (Vec<&Sighting>, Vec<&Sighting>) =
                sightings.into_iter().partition(|seen| links[seen.point]);
            let mut seen = DMatrix::zeros(2 * linked.len(), 6);
            for (at, sighting) in linked.iter().enumerate() {
                seen.rows_mut(2 * at, 2).copy_from(&self.by(sighting, pose, 6));
            }
            let open = unseen(&seen);
            let followers = followers.into_iter().map(|seen| seen.point).collect();
            (open.ncols() > 0).then_some(Loose { frame, open, seen, followers })
        };
        self.poses.iter().zip(of_frame).enumerate().filter_map(of_pose).collect()
    }

    /// Points whose rays are all parallel in the body, and the ray; frames that are loose have no say.
    fn without_parallax(
        &self,
        loose: &[Loose],
        ray: &dyn Fn(&Sighting) -> Vector3<f64>,
    ) -> Vec<(usize, Vector3<f64>)> {
        let mut is_loose = vec![false; self.poses.len()];
        loose.iter().for_each(|loose| is_loose[loose.frame] = true);
        let mut rays: Vec<Vec<Vector3<f64>>> = vec![Vec::new(); self.points.len()];
        let mut elsewhere = vec![None; self.points.len()];
        for seen in self.sightings {
            match is_loose[seen.frame] {
                false => rays[seen.point].push(ray(seen)),
                true => elsewhere[seen.point] = Some(ray(seen)),
            }
        }
        let is_open = |(point, rays): (usize, &Vec<Vector3<f64>>)| {
            let first = rays.first().copied().or(elsewhere[point])?;
            let all_parallel = rays.iter().all(|ray| ray.cross(&first).norm() < PARALLEL_RAD);
            all_parallel.then_some((point, first))
        };
        rays.iter().enumerate().filter_map(is_open).collect()
    }

    /// The motion of a point along its ray, and of the loose frames that must follow.
    fn depth(&self, size: usize, point: usize, ray: &Vector3<f64>, loose: &[Loose]) -> DVector<f64> {
        let mut motion = DVector::zeros(size);
        let Some(start) = self.points[point] else { return motion };
        write(&mut motion, start, ray.as_slice());
        let links = self.links();
        for loose in loose {
            let here = || self.sightings.iter().filter(|seen| seen.frame == loose.frame);
            let linked = || here().filter(|seen| links[seen.point]);
            let (Some(at), Some(pose)) =
                (linked().position(|seen| seen.point == point), self.poses[loose.frame])
            else {
                continue;
            };
            let Some(sighting) = linked().nth(at) else { continue };
            let mut wanted = DVector::zeros(loose.seen.nrows());
            wanted.rows_mut(2 * at, 2).copy_from(&-(self.by(sighting, start, 3) * ray));
            let svd = loose.seen.clone().svd(true, true);
            if let Ok(step) = svd.solve(&wanted, UNSEEN * svd.singular_values.max()) {
                write(&mut motion, pose, step.as_slice());
            }
        }
        motion
    }
}

/// What rows leave open of six numbers, as columns of unit length.
fn unseen(rows: &DMatrix<f64>) -> DMatrix<f64> {
    if rows.nrows() == 0 {
        return DMatrix::identity(6, 6);
    }
    let scale = Vector6::from_fn(|i, _| match rows.column(i).norm() {
        0.0 => 1.0,
        norm => 1.0 / norm,
    });
    let mut scaled = rows.clone().resize(rows.nrows().max(6), 6, 0.0);
    (0..6).for_each(|i| scaled.column_mut(i).scale_mut(scale[i]));
    let svd = scaled.svd(false, true);
    let Some(right) = svd.v_t else { return DMatrix::zeros(6, 0) };
    let largest = svd.singular_values.max();
    let columns: Vec<DVector<f64>> = (0..6)
        .filter(|i| svd.singular_values[*i] <= UNSEEN * largest)
        .map(|i| DVector::from_fn(6, |k, _| right[(i, k)] * scale[k]).normalize())
        .collect();
    if columns.is_empty() { DMatrix::zeros(6, 0) } else { DMatrix::from_columns(&columns) }
}

fn write(motion: &mut DVector<f64>, start: usize, values: &[f64]) {
    motion.as_mut_slice()[start..start + values.len()].copy_from_slice(values);
}

/// Middle of points and their root mean square distance from it.
fn extent(points: &[Point3<f64>]) -> (Vector3<f64>, f64) {
    let number = points.len().max(1) as f64;
    let middle = points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / number;
    let square = points.iter().map(|p| (p.coords - middle).norm_squared()).sum::<f64>() / number;
    (middle, if square > 0.0 { square.sqrt() } else { 1.0 })
}

fn unit(axis: usize) -> Vector3<f64> {
    Vector3::ith(axis, 1.0)
}

impl Scene<'_> {
    fn camera(&self, frame: usize) -> &Pose {
        &self.estimate.camera_poses[frame]
    }

    /// No image point sees a rear axle, an antenna, a clock or a shift.
    fn add_unseen(&self, found: &mut Candidates) {
        for (owner, start, length) in &self.all.blocks {
            if !matches!(owner, Owner::Axle(_) | Owner::Antenna(_) | Owner::Receiver(_)) {
                continue;
            }
            let free = (0..*length).filter(|at| self.all.is_free[start + at]);
            let of_owner = free.map(|at| {
                let mut motion = DVector::zeros(self.all.len());
                motion[start + at] = 1.0;
                Candidate { kind: number(*owner, at), motion }
            });
            found.of_bodies.push(of_owner.collect());
        }
    }

    /// Places that move with a body and that no image point sees: the antennas on a vehicle.
    fn antennas(&self, vehicle: usize) -> impl Iterator<Item = (usize, Point3<f64>)> {
        let receivers = self.problem.receivers.iter().zip(&self.estimate.receivers).zip(&self.all.receivers);
        receivers.filter(move |((receiver, _), _)| receiver.vehicle == vehicle).filter_map(
            |((receiver, found), starts)| Some(((*starts)?[0], self.estimate.antenna(receiver, found)?)),
        )
    }

    /// The vehicles that have a pose in a frame: index, pose, first coordinate.
    fn vehicles_in(&self, frame: usize) -> impl Iterator<Item = (&Pose, usize)> {
        self.estimate.vehicles.iter().zip(&self.all.poses).filter_map(move |(found, starts)| {
            let (pose, start) = (found.poses[frame].as_ref()?, starts[frame]?);
            Some((pose, start))
        })
    }

    /// Moves a camera and all vehicles with it.
    fn move_camera(&self, motion: &mut DVector<f64>, frame: usize, delta: &Vector6<f64>) {
        write(motion, self.all.cameras[frame], delta.as_slice());
        for (pose, start) in self.vehicles_in(frame) {
            let follows: Matrix6<f64> = -body_from_observer_motion(self.camera(frame), pose);
            write(motion, start, (follows * delta).as_slice());
        }
    }

    fn add_world(&self, found: &mut Candidates) {
        let (all, estimate) = (self.all, self.estimate);
        let mut unsettled = all.cameras.iter().zip(&all.camera_is_known);
        let poses = unsettled.clone().map(|(start, known)| (!known).then_some(*start)).collect();
        let is_unsettled = unsettled.any(|(_, known)| !known);
        let body = Body {
            rows: self.rows,
            sightings: &self.rows.of_targets,
            poses,
            points: &all.targets,
            knows: self.problem.targets.iter().map(|t| t.known.iter().any(Option::is_some)).collect(),
        };
        let loose = body.loose();
        let ray = |seen: &Sighting| {
            let place = estimate.targets[seen.point].unwrap_or_else(Point3::origin);
            (place.coords - self.camera(seen.frame).translation.vector).normalize()
        };
        let open = body.without_parallax(&loose, &ray);
        let mut seen = vec![false; all.targets.len()];
        self.rows.of_targets.iter().for_each(|sighting| seen[sighting.point] = true);
        let number = seen.iter().filter(|seen| **seen).count();
        let mut of_world = Vec::new();
        if is_unsettled && number > 0 {
            self.add_world_frame(open.len() == number, &mut of_world);
        }
        for (point, ray) in &open {
            let motion = body.depth(all.len(), *point, ray, &loose);
            of_world.push(Candidate { kind: Kind::PointDepth { vehicle: None, point: *point }, motion });
        }
        found.of_bodies.push(of_world);
        for loose in &loose {
            let frame = loose.frame;
            let camera = self.camera(frame);
            let one = |column: usize| {
                let delta = Vector6::from_fn(|i, _| loose.open[(i, column)]);
                let mut motion = DVector::zeros(all.len());
                self.move_camera(&mut motion, frame, &delta);
                let shift: Vector3<f64> = delta.fixed_rows::<3>(0).into();
                let turn = camera.rotation * Vector3::from(delta.fixed_rows::<3>(3));
                for follower in &loose.followers {
                    if let (Some(start), Some(place)) = (all.targets[*follower], estimate.targets[*follower])
                    {
                        let moved = shift + turn.cross(&(place.coords - camera.translation.vector));
                        write(&mut motion, start, moved.as_slice());
                    }
                }
                let part = match (loose.open.ncols(), column) {
                    (6, 0..3) => Part::Position(column),
                    (6, _) => Part::Attitude(column - 3),
                    _ => Part::Pose,
                };
                Candidate { kind: Kind::CameraPose { frames: vec![frame], part }, motion }
            };
            found.of_frames.push((0..loose.open.ncols()).map(one).collect());
        }
    }

    /// Scale, rotations and shifts of cameras, static points and vehicles.
    fn add_world_frame(&self, is_without_baseline: bool, into: &mut Vec<Candidate>) {
        let (all, estimate) = (self.all, self.estimate);
        let places: Vec<(usize, Point3<f64>)> =
            all.targets.iter().zip(&estimate.targets).filter_map(|(s, p)| Some(((*s)?, (*p)?))).collect();
        let (middle, radius) = extent(&places.iter().map(|p| p.1).collect::<Vec<_>>());
        let cameras: Vec<Vector3<f64>> =
            estimate.camera_poses.iter().map(|pose| pose.translation.vector).collect();
        let away = cameras.iter().map(|c| (c - middle).norm()).sum::<f64>() / cameras.len().max(1) as f64;
        let mut add = |kind: Kind, shift: &dyn Fn(&Vector3<f64>) -> Vector3<f64>, turn: Vector3<f64>| {
            let mut motion = DVector::zeros(all.len());
            for (frame, camera) in estimate.camera_poses.iter().enumerate() {
                let mut delta = Vector6::zeros();
                delta.fixed_rows_mut::<3>(0).copy_from(&shift(&cameras[frame]));
                delta.fixed_rows_mut::<3>(3).copy_from(&camera.rotation.inverse_transform_vector(&turn));
                self.move_camera(&mut motion, frame, &delta);
            }
            for (start, place) in &places {
                write(&mut motion, *start, shift(&place.coords).as_slice());
            }
            into.push(Candidate { kind, motion });
        };
        if !is_without_baseline {
            add(Kind::WorldScale, &|x| (x - middle) / away.max(1e-3), Vector3::zeros());
        }
        for (freedom, axis) in ORDER {
            match freedom {
                DatumFreedom::Rotation => {
                    let turn = unit(axis) / radius;
                    add(Kind::World { freedom, axis }, &|x| turn.cross(&(x - middle)), turn);
                }
                DatumFreedom::Shift => add(Kind::World { freedom, axis }, &|_| unit(axis), Vector3::zeros()),
            }
        }
    }

    fn add_vehicle(&self, vehicle: usize, found: &mut Candidates) {
        let (all, estimate) = (self.all, &self.estimate.vehicles[vehicle]);
        let of_problem = &self.problem.vehicles[vehicle];
        let body = Body {
            rows: self.rows,
            sightings: &self.rows.of_vehicles[vehicle],
            poses: all.poses[vehicle].clone(),
            points: &all.points[vehicle],
            knows: of_problem.points.iter().map(|p| p.known.iter().any(Option::is_some)).collect(),
        };
        let loose = body.loose();
        let ray = |seen: &Sighting| {
            let (Some(pose), Some(point)) = (&estimate.poses[seen.frame], &estimate.points[seen.point])
            else {
                return Vector3::zeros();
            };
            let centre = pose.inverse_transform_point(&self.camera(seen.frame).translation.vector.into());
            (point - centre).normalize()
        };
        let open = body.without_parallax(&loose, &ray);
        let mut seen = vec![false; all.points[vehicle].len()];
        body.sightings.iter().for_each(|sighting| seen[sighting.point] = true);
        let number = seen.iter().filter(|seen| **seen).count();
        let mut of_body = Vec::new();
        let places: Vec<(usize, Point3<f64>)> = all.points[vehicle]
            .iter()
            .zip(&estimate.points)
            .filter_map(|(start, point)| Some(((*start)?, (*point)?)))
            .collect();
        if number > 0 && open.len() < number {
            of_body.push(self.scale(vehicle, estimate, &places));
        }
        for (point, ray) in &open {
            let motion = body.depth(all.len(), *point, ray, &loose);
            of_body
                .push(Candidate { kind: Kind::PointDepth { vehicle: Some(vehicle), point: *point }, motion });
        }
        if number > 0 {
            self.add_body_frame(vehicle, estimate, &places, &mut of_body);
        }
        found.of_bodies.push(of_body);
        for loose in &loose {
            let frame = loose.frame;
            let (Some(pose), Some(start)) = (&estimate.poses[frame], all.poses[vehicle][frame]) else {
                continue;
            };
            let one = |column: usize| {
                let delta = Vector6::from_fn(|i, _| loose.open[(i, column)]);
                let mut motion = DVector::zeros(all.len());
                write(&mut motion, start, delta.as_slice());
                let shift = pose.rotation.inverse_transform_vector(&delta.fixed_rows::<3>(0).into());
                let turn = Vector3::from(delta.fixed_rows::<3>(3));
                for follower in &loose.followers {
                    if let (Some(start), Some(place)) =
                        (all.points[vehicle][*follower], estimate.points[*follower])
                    {
                        write(&mut motion, start, (-(shift + turn.cross(&place.coords))).as_slice());
                    }
                }
                Candidate { kind: Kind::VehiclePose { vehicle, frames: vec![frame] }, motion }
            };
            found.of_frames.push((0..loose.open.ncols()).map(one).collect());
        }
    }

    fn scale(&self, vehicle: usize, found: &VehicleEstimate, places: &[(usize, Point3<f64>)]) -> Candidate {
        let mut motion = DVector::zeros(self.all.len());
        let (mut sum, mut number) = (0.0, 0.0);
        let mut rays = Vec::new();
        for (frame, pose) in found.poses.iter().enumerate() {
            if let (Some(pose), Some(start)) = (pose, self.all.poses[vehicle][frame]) {
                let ray = pose.translation.vector - self.camera(frame).translation.vector;
                sum += ray.norm();
                number += 1.0;
                rays.push((start, ray));
            }
        }
        // So that the body moves by a metre.
        let share = f64::max(number, 1.0) / f64::max(sum, 1e-3);
        rays.iter().for_each(|(start, ray)| write(&mut motion, *start, (ray * share).as_slice()));
        for (start, point) in places.iter().copied().chain(self.antennas(vehicle)) {
            write(&mut motion, start, (point.coords * share).as_slice());
        }
        if let Some(axle) = self.all.axles[vehicle] {
            motion[axle] = found.axle[0] * share;
        }
        Candidate { kind: Kind::Scale { vehicle }, motion }
    }

    fn add_body_frame(
        &self,
        vehicle: usize,
        found: &VehicleEstimate,
        places: &[(usize, Point3<f64>)],
        into: &mut Vec<Candidate>,
    ) {
        let (middle, radius) = extent(&places.iter().map(|p| p.1).collect::<Vec<_>>());
        for (freedom, axis) in ORDER {
            let mut direction = Vector6::zeros();
            match freedom {
                DatumFreedom::Shift => direction[axis] = 1.0,
                DatumFreedom::Rotation => {
                    let turn = unit(axis) / radius;
                    direction.fixed_rows_mut::<3>(0).copy_from(&-turn.cross(&middle));
                    direction.fixed_rows_mut::<3>(3).copy_from(&turn);
                }
            }
            let mut motion = DVector::zeros(self.all.len());
            for (start, point) in places.iter().copied().chain(self.antennas(vehicle)) {
                write(&mut motion, start, point_motion(&direction, &point).as_slice());
            }
            if let Some(axle) = self.all.axles[vehicle] {
                // Along the x axis it is shifted, about the z axis it is turned.
                write(&mut motion, axle, &[direction[0], direction[5]]);
            }
            for (pose, start) in found.poses.iter().zip(&self.all.poses[vehicle]) {
                if let (Some(pose), Some(start)) = (pose, start) {
                    write(&mut motion, *start, pose_motion(&direction, pose).as_slice());
                }
            }
            into.push(Candidate { kind: Kind::BodyFrame { vehicle, freedom, axis }, motion });
        }
    }
}
