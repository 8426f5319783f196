//! Covariance with inner constraints, and what of it is nobody's knowledge.
//!
//! What measurements leave open of the frame of a body is held by single coordinates in the least squares;
//! here that is transformed to inner constraints on its shape (Baarda's S-transformation), in which each point
//! weighs by its own variance: one that is hardly determined must not blur the frame of all others. With the
//! open directions `G`, the weights `W` of the points, `B = W G` and `G^T B = 1`, and `Y = Q B`,
//!
//! ```text
//! Q'_ab = Q_ab - G_a Y_b^T - Y_a G_b^T + G_a (B^T Y) G_b^T
//! ```
//!
//! Some of a variance may come from conventions: weak rows that keep an unknown in its place of which nothing
//! is known. Where they are most of it, the quantity is not determined, and its standard deviation is
//! infinite. That of a scale reaches everything along its direction `z = Q a`, of variance `a^T z`.

use crate::estimate::{Estimate, VehicleEstimate};
use crate::problem::{Problem, Vehicle};
use crate::refine::{BodyFrame, Network, Source, is_in_the_middle, point_motion, pose_motion};
use nalgebra::{DMatrix, DVector, Vector6};
use std::collections::BTreeMap;
use trackbundle_solver::covariance::Covariance;
use trackbundle_solver::system::BlockId;

/// The share of a variance that comes from conventions from which a quantity is not determined.
pub const UNDETERMINED: f64 = 0.5;

/// The covariance of a network.
pub struct Inner<'a> {
    pub network: &'a Network,
    covariance: Covariance<'a>,
    /// Variance of unit weight.
    variance: f64,
    bodies: Vec<Body>,
    /// For each block, by its first number, the rows that conventions have on it, a column each.
    conventions: BTreeMap<usize, DMatrix<f64>>,
}

struct Body {
    open: Vec<Vector6<f64>>,
    /// `B`, over all unknowns.
    shape: DMatrix<f64>,
    /// `Y` and `B^T Y`.
    times: DMatrix<f64>,
    square: DMatrix<f64>,
    /// The place whose track is wanted.
    place: Option<PlaceCovariance>,
    /// The direction of an undetermined scale, so long that its square is the variance that conventions
    /// leave it, and its part in the open directions.
    scale: Option<(DVector<f64>, DVector<f64>)>,
}

/// The place of a body whose track is wanted, where it is neither its origin nor held.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// A point of its shape.
    Point(usize),
    /// The middle of the box around its points in x and y: between these two points along each axis.
    Middle([[usize; 2]; 2]),
}

impl Place {
    /// The place of each vehicle: its marker, or the middle of the body where that is where its origin lies.
    pub fn of_vehicles(problem: &Problem, estimate: &Estimate) -> Vec<Option<Place>> {
        let vehicles = problem.vehicles.iter().zip(&estimate.vehicles);
        vehicles.map(|(vehicle, found)| Place::of_vehicle(vehicle, found)).collect()
    }

    /// That of one of them.
    pub fn of_vehicle(vehicle: &Vehicle, found: &VehicleEstimate) -> Option<Place> {
        match vehicle.marker {
            Some(marker) if found.points[marker].is_some() => Some(Place::Point(marker)),
            _ if found.left_out.is_some() || !is_in_the_middle(vehicle) => None,
            _ => found.box_sides().map(|[x, y, _]| Place::Middle([x, y])),
        }
    }

    /// Coordinates of points that make up its own: point, axis, and weight.
    fn parts(&self) -> Vec<(usize, usize, f64)> {
        match self {
            Place::Point(point) => (0..3).map(|axis| (*point, axis, 1.0)).collect(),
            Place::Middle(sides) => {
                (0..2).flat_map(|axis| sides[axis].map(|point| (point, axis, 0.5))).collect()
            }
        }
    }
}

/// A place as a linear function of the shape, `p = F^T x`: `F`, `Q F` and how it moves with the open directions.
struct PlaceCovariance {
    functional: DMatrix<f64>,
    times: DMatrix<f64>,
    motion: DMatrix<f64>,
    /// Its block, where it is a single point.
    block: Option<BlockId>,
}

/// Part of a joint covariance: how it moves with the open directions of its body.
pub struct Piece {
    /// Its block; `None` for the place of the body whose track is wanted.
    block: Option<BlockId>,
    motion: DMatrix<f64>,
}

/// A covariance, and the part of it that comes from conventions.
pub struct Joint {
    pub covariance: DMatrix<f64>,
    pub conventions: DMatrix<f64>,
}

impl Joint {
    /// The variance of a linear function; infinite where it is not determined.
    pub fn variance(&self, gradient: &DVector<f64>) -> f64 {
        let of = |matrix: &DMatrix<f64>| (gradient.transpose() * matrix * gradient)[(0, 0)].max(0.0);
        let variance = of(&self.covariance);
        if of(&self.conventions) > UNDETERMINED * variance { f64::INFINITY } else { variance }
    }

    /// Standard deviations of the components.
    pub fn sigmas<const N: usize>(&self) -> [f64; N] {
        std::array::from_fn(|i| {
            let mut unit = DVector::zeros(N);
            unit[i] = 1.0;
            self.variance(&unit).sqrt()
        })
    }
}

/// The weighted shifts of the points of a vehicle along its open directions: `B`.
pub fn shape_rows(network: &Network, vehicle: usize, frame: &BodyFrame) -> DMatrix<f64> {
    let system = &network.model.system;
    let mut columns = DMatrix::zeros(system.size(), frame.open.len());
    for ((point, place), weight) in frame.points.iter().zip(&frame.weights) {
        let block = network.model.shape_point(vehicle, *point).expect("a point that counts");
        let Some(range) = system.range_of(block) else { continue };
        for (k, direction) in frame.open.iter().enumerate() {
            let moved = point_motion(direction, place) * *weight;
            columns.view_mut((range.start, k), (3, 1)).copy_from(&moved);
        }
    }
    columns
}

impl<'a> Inner<'a> {
    /// The covariance of `network`, of which `places` are those whose tracks are wanted.
    pub fn new(
        network: &'a Network,
        mut covariance: Covariance<'a>,
        variance: f64,
        places: &[Option<Place>],
    ) -> Self {
        let body = |(vehicle, frame): (usize, &BodyFrame)| {
            let shape = shape_rows(network, vehicle, frame);
            let times = covariance.times(&shape);
            let square = shape.tr_mul(&times);
            let place = places[vehicle].and_then(|place| {
                let functional = functional(network, vehicle, place)?;
                let motion = place_motion(frame, place);
                let block = match place {
                    Place::Point(point) => network.model.shape_point(vehicle, point),
                    Place::Middle(_) => None,
                };
                Some(PlaceCovariance { times: covariance.times(&functional), functional, motion, block })
            });
            Body { open: frame.open.clone(), shape, times, square, place, scale: None }
        };
        let bodies = network.frames.iter().enumerate().map(body).collect();
        let mut inner = Inner { network, covariance, variance, bodies, conventions: BTreeMap::new() };
        inner.find_conventions();
        inner
    }

    fn find_conventions(&mut self) {
        let mut found: BTreeMap<usize, DMatrix<f64>> = BTreeMap::new();
        for group in self.network.model.groups_of(Source::Convention) {
            for seen in self.covariance.jacobians(group) {
                let [(block, jacobian)] = seen.as_slice() else { continue };
                let start = self.network.model.system.range_of(*block).expect("free").start;
                let columns = jacobian.transpose();
                let all = match found.remove(&start) {
                    None => columns,
                    Some(before) => {
                        let at = before.ncols();
                        let mut all = before.insert_columns(at, columns.ncols(), 0.0);
                        all.columns_mut(at, columns.ncols()).copy_from(&columns);
                        all
                    }
                };
                found.insert(start, all);
            }
        }
        self.conventions = found;
    }

    /// Says that conventions leave the scale of a vehicle undetermined: its direction `Q a`, of variance
    /// `a^T Q a`.
    pub fn set_undetermined_scale(&mut self, vehicle: usize, direction: &[f64], variance: f64) {
        let z = DVector::from_column_slice(direction) / variance.sqrt();
        let body = &mut self.bodies[vehicle];
        let of_open = body.shape.tr_mul(&z);
        body.scale = Some((z, of_open));
    }

    /// A camera or target: no frame of a body moves it.
    pub fn fixed_piece(&self, vehicle: usize, block: BlockId) -> Piece {
        let size = self.network.model.system.free(block).len();
        Piece { block: Some(block), motion: DMatrix::zeros(size, self.bodies[vehicle].open.len()) }
    }

    /// A pose of a vehicle.
    pub fn pose_piece(&self, vehicle: usize, block: BlockId, pose: &crate::geometry::Pose) -> Piece {
        let open = &self.bodies[vehicle].open;
        let motion = DMatrix::from_fn(6, open.len(), |row, k| pose_motion(&open[k], pose)[row]);
        Piece { block: Some(block), motion }
    }

    /// A point of a vehicle.
    pub fn point_piece(&self, vehicle: usize, block: BlockId, point: &nalgebra::Point3<f64>) -> Piece {
        let open = &self.bodies[vehicle].open;
        let motion = DMatrix::from_fn(3, open.len(), |row, k| point_motion(&open[k], point)[row]);
        Piece { block: Some(block), motion }
    }

    /// The place of a vehicle whose track is wanted; `None` where that is its origin, or a point that is held.
    pub fn place_piece(&self, vehicle: usize) -> Option<Piece> {
        let place = self.bodies[vehicle].place.as_ref()?;
        Some(Piece { block: None, motion: place.motion.clone() })
    }

    /// The rows of a matrix over all unknowns that belong to a piece.
    fn rows_of(&self, vehicle: usize, piece: &Piece, of: &DMatrix<f64>) -> Option<DMatrix<f64>> {
        match piece.block {
            Some(block) => {
                let range = self.network.model.system.range_of(block)?;
                Some(of.rows(range.start, range.len()).into_owned())
            }
            None => Some(self.bodies[vehicle].place.as_ref()?.functional.tr_mul(of)),
        }
    }

    fn cross(&self, vehicle: usize, a: &Piece, b: &Piece) -> Option<DMatrix<f64>> {
        let place = self.bodies[vehicle].place.as_ref();
        let with_place = |other: &Piece| self.rows_of(vehicle, other, &place?.times);
        match (a.block, b.block) {
            (_, None) => with_place(a),
            (None, _) => Some(with_place(b)?.transpose()),
            (Some(of_a), Some(of_b)) => {
                let is_place = |block| place.is_some_and(|place| place.block == Some(block));
                self.covariance.block(of_a, of_b).or_else(|| match (is_place(of_a), is_place(of_b)) {
                    (_, true) => with_place(a),
                    (true, false) => Some(with_place(b)?.transpose()),
                    (false, false) => None,
                })
            }
        }
    }

    /// What conventions say of the block of a piece, a column each.
    fn conventions_on(&self, piece: &Piece) -> Option<&DMatrix<f64>> {
        self.conventions.get(&self.network.model.system.range_of(piece.block?)?.start)
    }

    /// The covariance of pieces of a vehicle; `None` where one is held whole, or a pair was not selected.
    pub fn joint(&self, vehicle: usize, pieces: &[Piece]) -> Option<Joint> {
        let body = &self.bodies[vehicle];
        let times: Vec<DMatrix<f64>> =
            pieces.iter().map(|piece| self.rows_of(vehicle, piece, &body.times)).collect::<Option<_>>()?;
        let size = times.iter().map(DMatrix::nrows).sum();
        let mut covariance = DMatrix::zeros(size, size);
        let mut conventions = DMatrix::zeros(size, size);
        let mut z = DVector::zeros(size);
        let mut row = 0;
        for (a, ya) in pieces.iter().zip(&times) {
            let mut column = 0;
            for (b, yb) in pieces.iter().zip(&times) {
                let mut block = self.cross(vehicle, a, b)?;
                block -= &a.motion * yb.transpose() + ya * b.motion.transpose();
                block += &a.motion * &body.square * b.motion.transpose();
                covariance.view_mut((row, column), (ya.nrows(), yb.nrows())).copy_from(&block);
                column += yb.nrows();
            }
            if let Some(rows) = self.conventions_on(a) {
                // What the rows on this block contribute to all pieces: Q' J^T.
                let mut moved = DMatrix::zeros(size, rows.ncols());
                let mut at = 0;
                for (b, yb) in pieces.iter().zip(&times) {
                    let block = self.cross(vehicle, b, a)? - &b.motion * ya.transpose();
                    moved.rows_mut(at, yb.nrows()).copy_from(&(block * rows));
                    at += yb.nrows();
                }
                conventions += &moved * moved.transpose();
            }
            if let Some((direction, of_open)) = &body.scale {
                let of_direction = DMatrix::from_column_slice(direction.len(), 1, direction.as_slice());
                let along = self.rows_of(vehicle, a, &of_direction)?.column(0) - &a.motion * of_open;
                z.rows_mut(row, ya.nrows()).copy_from(&along);
            }
            row += ya.nrows();
        }
        conventions += &z * z.transpose();
        Some(Joint { covariance: covariance * self.variance, conventions: conventions * self.variance })
    }
}

/// `F` of a place; `None` where it is held.
pub fn functional(network: &Network, vehicle: usize, place: Place) -> Option<DMatrix<f64>> {
    let system = &network.model.system;
    let mut functional = DMatrix::zeros(system.size(), 3);
    for (point, axis, weight) in place.parts() {
        let range = network.model.shape_point(vehicle, point).and_then(|block| system.range_of(block));
        if let Some(range) = range {
            functional[(range.start + axis, axis)] += weight;
        }
    }
    functional.iter().any(|weight| *weight != 0.0).then_some(functional)
}

/// How a place moves with the open directions of the frame of its body.
fn place_motion(frame: &BodyFrame, place: Place) -> DMatrix<f64> {
    let mut motion = DMatrix::zeros(3, frame.open.len());
    for (point, axis, weight) in place.parts() {
        let Some((_, at)) = frame.points.iter().find(|(index, _)| *index == point) else { continue };
        for (k, direction) in frame.open.iter().enumerate() {
            motion[(axis, k)] += weight * point_motion(direction, at)[axis];
        }
    }
    motion
}
