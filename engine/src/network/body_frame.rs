//! The frame of a body: which of its six freedoms measurements hold, and what holds the others.
//!
//! A body's frame is a choice: a shift `v` and a turn `w` of it,
//!
//! ```text
//! dM = v + w x M      dt = -R v      dr = -w
//! ```
//!
//! leave every image point as it is. Ground under the origin, known heights and known points hold some of
//! these directions. `G` are six of them, one a column, orthonormal in the weighted shifts of the points (one
//! that is hardly determined must not blur the frame of all others); of their information from everything but
//! image points and motion,
//!
//! ```text
//! I = sum |J G|^2
//! ```
//!
//! the eigenvectors with a standard deviation above 0.1 m are open: there the frame is a convention,
//! held by as many coordinates of points. Standard deviations are then transformed to inner constraints on
//! the shape (Baarda's S-transformation),
//!
//! ```text
//! Q' = S Q S^T      S = 1 - G B^T      B = W G in the rows of the shape, W the weights of the points
//! ```
//!
//! by which no single point, and no frame of the film, is free of error.

use super::model::{Model, NetworkOptions};
use super::selection::{Anchors, Purpose, Selection};
use super::source::Source;
use crate::estimate::{Estimate, VehicleEstimate};
use crate::geometry::{Pose, rotation::exp};
use crate::problem::Problem;
use nalgebra::{DMatrix, Matrix6, Point3, SymmetricEigen, Vector3, Vector6};
use trackbundle_solver::system::{BlockId, OwnNormals, Values};

/// A direction of a body's frame that is held less well than this is open: root mean square over the points
/// \[m\].
const OPEN_M: f64 = 0.1;
/// What is held exactly counts as held with this standard deviation \[m or rad\].
const EXACT: f64 = 1e-4;

/// What is open of the frame of a body, and what holds it.
#[derive(Clone, Debug, Default)]
pub struct BodyFrame {
    /// Open directions `(v, w)` \[m, rad\], orthonormal in the weighted shifts of the points.
    pub open: Vec<Vector6<f64>>,
    /// Standard deviation of each of six directions from what is known, and the direction: root mean square
    /// over the points \[m\], worst first.
    pub known: Vec<(f64, Vector6<f64>)>,
    /// Points that count: index and place \[m\].
    pub points: Vec<(usize, Point3<f64>)>,
    /// What each of them weighs, one in the mean: the inverse of the variance that it would have were all
    /// poses known. (With the frame, or the scale, it would be that of what holds these.)
    pub weights: Vec<f64>,
    /// Points and axes whose coordinates hold the open directions.
    pub anchors: Anchors,
}

/// Where a point moves when the frame of its body is shifted and turned.
pub fn point_motion(direction: &Vector6<f64>, point: &Point3<f64>) -> Vector3<f64> {
    direction.fixed_rows::<3>(0) + direction.fixed_rows::<3>(3).cross(&point.coords)
}

/// How a pose is perturbed when the frame of its body is shifted and turned.
pub fn pose_motion(direction: &Vector6<f64>, pose: &Pose) -> Vector6<f64> {
    let mut out = Vector6::zeros();
    out.fixed_rows_mut::<3>(0).copy_from(&-(pose.rotation * direction.fixed_rows::<3>(0).into_owned()));
    out.fixed_rows_mut::<3>(3).copy_from(&-direction.fixed_rows::<3>(3));
    out
}

/// The frames of all vehicles at `values`, which are those of `estimate`.
pub fn body_frames(problem: &Problem, estimate: &Estimate, model: &Model, values: &Values) -> Vec<BodyFrame> {
    // A lever arm says where a point is to its antenna, of which nothing is known either; and that two unknowns are one
    // point says nothing of it.
    let untold: Vec<_> = model.groups_of(Source::GnssKnowledge).chain([model.middles()]).collect();
    let normals = model.system.own_normals_without(values, &untold);
    let frame = |vehicle| body_frame(estimate, model, values, &normals, vehicle);
    (0..problem.vehicles.len()).map(frame).collect()
}

/// The network of an adjustment from `current`, in which frames of bodies are held by as many coordinates of points as
/// measurements leave open.
pub fn anchored(
    problem: &Problem,
    start: &Estimate,
    current: &Estimate,
    options: NetworkOptions,
    selection: &Selection,
) -> Model {
    let model = Model::new(problem, start, current, options, selection, Purpose::FROM_AFAR);
    let frames = body_frames(problem, current, &model, model.system.start());
    if frames.iter().all(|frame| frame.anchors.is_empty()) {
        return model;
    }
    let anchors: Vec<Anchors> = frames.into_iter().map(|frame| frame.anchors).collect();
    Model::new(problem, start, current, options, selection, Purpose::Adjustment { anchors: &anchors })
}

fn body_frame(
    estimate: &Estimate,
    model: &Model,
    values: &Values,
    normals: &OwnNormals,
    vehicle: usize,
) -> BodyFrame {
    let found = &estimate.vehicles[vehicle];
    let place = |(at, point): (usize, &Option<Point3<f64>>)| {
        model.shape_point(vehicle, at)?;
        Some((at, (*point)?))
    };
    let mut points: Vec<(usize, Point3<f64>)> = found.points.iter().enumerate().filter_map(place).collect();
    if found.left_out.is_some() {
        points.clear();
    }
    if points.len() < 3 {
        let weights = vec![1.0; points.len()];
        return BodyFrame { points, weights, ..BodyFrame::default() };
    }
    let weights = weights(model, normals, vehicle, &points);
    let generators = generators(&points, &weights);
    let steps: Vec<Vec<f64>> = generators.iter().map(|g| frame_step(estimate, model, vehicle, g)).collect();
    let mut information = Matrix6::zeros();
    let holding = model.sources.iter().filter(|(source, _)| source.traits().holds_frame);
    let mut holding: Vec<_> = holding.collect();
    holding.sort_by_key(|(source, _)| *source);
    for (_, group) in holding {
        let rows: Vec<Vec<f64>> =
            steps.iter().map(|step| model.system.product(*group, values, step)).collect();
        add_products(&mut information, &rows);
    }
    add_products(&mut information, &held_rows(estimate, model, vehicle, &generators));
    let number = points.len() as f64;
    let eigen = SymmetricEigen::new(information);
    let mut known: Vec<(f64, Vector6<f64>)> = (0..6)
        .map(|i| {
            let combined: Vector6<f64> = (0..6).map(|k| generators[k] * eigen.eigenvectors[(k, i)]).sum();
            // One metre over all points is 1 / sqrt(n) for each.
            let sigma_m = (1.0 / eigen.eigenvalues[i].max(0.0) / number).sqrt();
            (sigma_m, combined)
        })
        .collect();
    known.sort_by(|a, b| b.0.total_cmp(&a.0));
    let open: Vec<Vector6<f64>> = known.iter().filter(|k| k.0 > OPEN_M).map(|k| k.1).collect();
    let is_free = |point: usize, axis: usize| {
        model.shape_point(vehicle, point).is_some_and(|block| model.system.free(block)[axis])
    };
    let anchors = anchors(&points, &weights, &open, &is_free);
    BodyFrame { open, known, points, weights, anchors }
}

fn weights(model: &Model, normals: &OwnNormals, vehicle: usize, points: &[(usize, Point3<f64>)]) -> Vec<f64> {
    let of_point = |(point, _): &(usize, Point3<f64>)| {
        let block = model.shape_point(vehicle, *point).expect("a point that counts");
        let mut normal = normals.of(block).clone();
        for (at, _) in model.system.free(block).iter().enumerate().filter(|(_, free)| !**free) {
            // Known exactly.
            normal[(at, at)] = 1.0 / (EXACT * EXACT);
        }
        normal.try_inverse().map_or(0.0, |inverse| 1.0 / inverse.trace())
    };
    let mut weights: Vec<f64> = points.iter().map(of_point).collect();
    let mean = weights.iter().sum::<f64>() / weights.len() as f64;
    if mean > 0.0 && mean.is_finite() {
        weights.iter_mut().for_each(|weight| *weight /= mean);
    } else {
        weights.fill(1.0);
    }
    weights
}

/// Six directions, orthonormal in the weighted shifts of the points.
fn generators(points: &[(usize, Point3<f64>)], weights: &[f64]) -> [Vector6<f64>; 6] {
    let middle: Vector3<f64> =
        points.iter().map(|(_, p)| p.coords).sum::<Vector3<f64>>() / points.len() as f64;
    let mut plain = [Vector6::zeros(); 6];
    for axis in 0..3 {
        plain[axis][axis] = 1.0;
        let mut turn = Vector3::zeros();
        turn[axis] = 1.0;
        // About the middle of the points.
        plain[3 + axis].fixed_rows_mut::<3>(3).copy_from(&turn);
        plain[3 + axis].fixed_rows_mut::<3>(0).copy_from(&-turn.cross(&middle));
    }
    // Gram-Schmidt in the motions of the points.
    let motion = |g: &Vector6<f64>| -> Vec<f64> {
        let shift = |((_, p), w): (&(usize, Point3<f64>), &f64)| point_motion(g, p) * w.sqrt();
        points.iter().zip(weights).flat_map(|pair| <[f64; 3]>::from(shift(pair))).collect()
    };
    let dot = |a: &[f64], b: &[f64]| -> f64 { a.iter().zip(b).map(|(a, b)| a * b).sum() };
    let mut out: Vec<Vector6<f64>> = Vec::new();
    for g in plain {
        let mut g = g;
        for _ in 0..2 {
            for other in &out {
                g -= other * dot(&motion(&g), &motion(other));
            }
        }
        let length = dot(&motion(&g), &motion(&g)).sqrt();
        // Points on a line do not turn about it.
        out.push(if length > 1e-9 { g / length } else { Vector6::zeros() });
    }
    out.try_into().expect("six")
}

/// The step in which the frame of a vehicle moves, in elimination order.
pub fn frame_step(estimate: &Estimate, model: &Model, vehicle: usize, direction: &Vector6<f64>) -> Vec<f64> {
    let mut step = vec![0.0; model.system.size()];
    let mut write = |block: Option<BlockId>, delta: &[f64]| {
        if let Some(range) = block.and_then(|block| model.system.range_of(block)) {
            step[range].copy_from_slice(delta);
        }
    };
    let found = &estimate.vehicles[vehicle];
    for (at, point) in found.points.iter().enumerate() {
        if let Some(point) = point {
            write(model.shape_point(vehicle, at), point_motion(direction, point).as_slice());
        }
    }
    for (frame, pose) in found.poses.iter().enumerate() {
        if let Some(pose) = pose {
            write(model.vehicle_pose(vehicle, frame), pose_motion(direction, pose).as_slice());
        }
    }
    step
}

/// What directions would move of what is held exactly, whitened.
fn held_rows(
    estimate: &Estimate,
    model: &Model,
    vehicle: usize,
    generators: &[Vector6<f64>; 6],
) -> Vec<Vec<f64>> {
    let found = &estimate.vehicles[vehicle];
    let mut rows = vec![Vec::new(); 6];
    let mut add = |block: Option<BlockId>, motion: &dyn Fn(&Vector6<f64>) -> Vec<f64>| {
        let Some(block) = block else { return };
        for (axis, _) in model.system.free(block).iter().enumerate().filter(|(_, free)| !**free) {
            for (rows, g) in rows.iter_mut().zip(generators) {
                rows.push(motion(g)[axis] / EXACT);
            }
        }
    };
    for (at, point) in found.points.iter().enumerate() {
        if let Some(point) = point {
            add(model.shape_point(vehicle, at), &|g| point_motion(g, point).as_slice().to_vec());
        }
    }
    for (frame, pose) in found.poses.iter().enumerate() {
        if let Some(pose) = pose {
            add(model.vehicle_pose(vehicle, frame), &|g| pose_motion(g, pose).as_slice().to_vec());
        }
    }
    rows
}

fn add_products(information: &mut Matrix6<f64>, rows: &[Vec<f64>]) {
    for i in 0..6 {
        for j in 0..6 {
            information[(i, j)] += rows[i].iter().zip(&rows[j]).map(|(a, b)| a * b).sum::<f64>();
        }
    }
}

/// As many coordinates as directions, each the one that sees most of what the others leave open.
fn anchors(
    points: &[(usize, Point3<f64>)],
    weights: &[f64],
    open: &[Vector6<f64>],
    is_free: &dyn Fn(usize, usize) -> bool,
) -> Vec<(usize, usize)> {
    let mut left = DMatrix::from_fn(3 * points.len(), open.len(), |row, column| {
        point_motion(&open[column], &points[row / 3].1)[row % 3] * weights[row / 3].sqrt()
    });
    let mut chosen = Vec::new();
    for _ in 0..open.len() {
        let squares = |row: usize| left.row(row).norm_squared();
        let candidates = (0..left.nrows()).filter(|row| is_free(points[row / 3].0, row % 3));
        // The first of equals.
        let Some(best) = candidates.reduce(|a, b| if squares(b) > squares(a) { b } else { a }) else { break };
        if squares(best) < 1e-12 {
            break;
        }
        chosen.push((points[best / 3].0, best % 3));
        let direction = left.row(best).normalize();
        let seen = &left * direction.transpose();
        left -= seen * direction;
    }
    chosen
}

impl BodyFrame {
    /// The shift and turn along open directions that lays a shape on another one, weighted: what a change of
    /// the shape has of a mere change of its frame. To first order.
    fn change(&self, before: &[Option<Point3<f64>>], after: &[Option<Point3<f64>>]) -> Vector6<f64> {
        let mut change = Vector6::zeros();
        for direction in &self.open {
            let part: f64 = self
                .points
                .iter()
                .zip(&self.weights)
                .filter_map(|((at, place), weight)| {
                    let moved = after[*at]? - before[*at]?;
                    Some(weight * point_motion(direction, place).dot(&moved))
                })
                .sum();
            change += direction * part;
        }
        change
    }

    /// Takes from the shape of a vehicle what it has of a mere change of its frame since `before`, so that
    /// its frame is where it was: inner constraints on the change of the shape.
    pub fn restore(&self, before: &VehicleEstimate, found: &mut VehicleEstimate) {
        // What is left after one is of second order.
        for _ in 0..2 {
            let change = self.change(&before.points, &found.points);
            let (shift, turn) =
                (change.fixed_rows::<3>(0).into_owned(), change.fixed_rows::<3>(3).into_owned());
            let body_from_moved = Pose::from_parts(shift.into(), exp(&turn));
            found.points.iter_mut().flatten().for_each(|p| *p = body_from_moved.inverse_transform_point(p));
            found.poses.iter_mut().flatten().for_each(|pose| *pose *= body_from_moved);
        }
    }
}
