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

use crate::refine::{BodyFrame, Network, Source, point_motion, pose_motion};
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
    /// Covariance with three coordinates of a point.
    marker: Option<(BlockId, DMatrix<f64>)>,
    /// The direction of an undetermined scale, so long that its square is the variance that conventions
    /// leave it, and its part in the open directions.
    scale: Option<(DVector<f64>, DVector<f64>)>,
}

/// A block in the covariance of several: how it moves with the open directions of its body.
pub struct Piece {
    pub block: BlockId,
    pub motion: DMatrix<f64>,
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
    /// The covariance of `network`, of which `markers` are the points whose tracks are wanted.
    pub fn new(
        network: &'a Network,
        mut covariance: Covariance<'a>,
        variance: f64,
        markers: &[Option<usize>],
    ) -> Self {
        let body = |(vehicle, frame): (usize, &BodyFrame)| {
            let shape = shape_rows(network, vehicle, frame);
            let times = covariance.times(&shape);
            let square = shape.tr_mul(&times);
            let marker = markers[vehicle].and_then(|point| network.model.shape_point(vehicle, point));
            let marker = marker.and_then(|block| {
                let range = network.model.system.range_of(block)?;
                let mut units = DMatrix::zeros(shape.nrows(), range.len());
                units.rows_mut(range.start, range.len()).fill_with_identity();
                Some((block, covariance.times(&units)))
            });
            Body { open: frame.open.clone(), shape, times, square, marker, scale: None }
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
        Piece { block, motion: DMatrix::zeros(size, self.bodies[vehicle].open.len()) }
    }

    /// A pose of a vehicle.
    pub fn pose_piece(&self, vehicle: usize, block: BlockId, pose: &crate::geometry::Pose) -> Piece {
        let open = &self.bodies[vehicle].open;
        let motion = DMatrix::from_fn(6, open.len(), |row, k| pose_motion(&open[k], pose)[row]);
        Piece { block, motion }
    }

    /// A point of a vehicle.
    pub fn point_piece(&self, vehicle: usize, block: BlockId, point: &nalgebra::Point3<f64>) -> Piece {
        let open = &self.bodies[vehicle].open;
        let motion = DMatrix::from_fn(3, open.len(), |row, k| point_motion(&open[k], point)[row]);
        Piece { block, motion }
    }

    fn cross(&self, vehicle: usize, a: BlockId, b: BlockId) -> Option<DMatrix<f64>> {
        let with_marker = |marker: BlockId, other: BlockId| {
            let (block, columns) = self.bodies[vehicle].marker.as_ref()?;
            let range = self.network.model.system.range_of(other)?;
            (*block == marker).then(|| columns.rows(range.start, range.len()).into_owned())
        };
        self.covariance
            .block(a, b)
            .or_else(|| with_marker(b, a))
            .or_else(|| Some(with_marker(a, b)?.transpose()))
    }

    /// The covariance of blocks of a vehicle; `None` where one is held whole, or a pair was not selected.
    pub fn joint(&self, vehicle: usize, pieces: &[Piece]) -> Option<Joint> {
        let body = &self.bodies[vehicle];
        let system = &self.network.model.system;
        let ranges: Vec<_> =
            pieces.iter().map(|piece| system.range_of(piece.block)).collect::<Option<_>>()?;
        let size = ranges.iter().map(|range| range.len()).sum();
        let mut covariance = DMatrix::zeros(size, size);
        let mut conventions = DMatrix::zeros(size, size);
        let mut z = DVector::zeros(size);
        let mut row = 0;
        for (a, of_a) in pieces.iter().zip(&ranges) {
            let ya = body.times.rows(of_a.start, of_a.len());
            let mut column = 0;
            for (b, of_b) in pieces.iter().zip(&ranges) {
                let yb = body.times.rows(of_b.start, of_b.len());
                let mut block = self.cross(vehicle, a.block, b.block)?;
                block -= &a.motion * yb.transpose() + ya * b.motion.transpose();
                block += &a.motion * &body.square * b.motion.transpose();
                covariance.view_mut((row, column), (of_a.len(), of_b.len())).copy_from(&block);
                column += of_b.len();
            }
            if let Some(rows) = self.conventions.get(&of_a.start) {
                // What the rows on this block contribute to all pieces: Q' J^T.
                let mut moved = DMatrix::zeros(size, rows.ncols());
                let mut at = 0;
                for (b, of_b) in pieces.iter().zip(&ranges) {
                    let block = self.cross(vehicle, b.block, a.block)? - &b.motion * ya.transpose();
                    moved.rows_mut(at, of_b.len()).copy_from(&(block * rows));
                    at += of_b.len();
                }
                conventions += &moved * moved.transpose();
            }
            if let Some((direction, of_open)) = &body.scale {
                let along = direction.rows(of_a.start, of_a.len()) - &a.motion * of_open;
                z.rows_mut(row, of_a.len()).copy_from(&along);
            }
            row += of_a.len();
        }
        conventions += &z * z.transpose();
        Some(Joint { covariance: covariance * self.variance, conventions: conventions * self.variance })
    }
}
