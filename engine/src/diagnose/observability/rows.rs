//! What measurements and real knowledge say of the unknowns: coordinates of all blocks and the whitened rows
//! of the Jacobian, without anything that is only a start, a convention or a smoothness.
//!
//! The network is declared to an [`Examination`] as it is to a system, with two differences: what is held has
//! coordinates too, and a camera pose is held only where it is given as exact.

use crate::estimate::Estimate;
use crate::network::{
    Declaration, Declared, MotionPriors, Owner, Purpose, Selection, Sink, Source, Treatment, declare,
    of_cameras, of_vehicle,
};
use crate::problem::Problem;
use nalgebra::DMatrix;
use trackbundle_solver::loss::Loss;
use trackbundle_solver::manifold::Manifold;
use trackbundle_solver::residual::{Jacobian, Residual};
use trackbundle_solver::system::{BlockId, GroupId, Measurement, SystemBuilder};

/// What is held exactly counts as measured with this standard deviation \[m or rad\].
const EXACT: f64 = 1e-4;

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
    /// First coordinate of the rear axle of each vehicle that has one.
    pub axles: Vec<Option<usize>>,
    /// First coordinate of each target.
    pub targets: Vec<Option<usize>>,
    /// First coordinates of the antenna, in the frame of its vehicle, and of the numbers of each receiver.
    pub receivers: Vec<Option<[usize; 2]>>,
}

impl Coordinates {
    /// How many there are.
    pub fn len(&self) -> usize {
        self.is_free.len()
    }

    /// How many are adjusted.
    pub fn unknowns(&self) -> usize {
        self.is_free.iter().filter(|free| **free).count()
    }

    fn add(&mut self, owner: Owner, free: &[bool]) {
        self.blocks.push((owner, self.is_free.len(), free.len()));
        self.is_free.extend_from_slice(free);
    }

    /// The first coordinate of a block.
    fn start(&self, block: BlockId) -> usize {
        self.blocks[block.index()].1
    }

    /// Notes where the blocks of a network are.
    fn index(&mut self, problem: &Problem, Declared { blocks, .. }: &Declared) {
        let start = |block: &BlockId| self.start(*block);
        let starts =
            |blocks: &[Option<BlockId>]| blocks.iter().map(|block| block.as_ref().map(start)).collect();
        let given = problem.camera_pose_sigma.components().iter().all(Option::is_some);
        let cameras = blocks.cameras.iter().map(start).collect();
        let poses = blocks.vehicles.iter().map(|vehicle| starts(&vehicle.poses)).collect();
        let points = blocks.vehicles.iter().map(|vehicle| starts(&vehicle.points)).collect();
        let axles = blocks.vehicles.iter().map(|vehicle| vehicle.axle.as_ref().map(start)).collect();
        let receiver = |own: &Option<crate::network::ReceiverBlocks>| {
            own.as_ref().map(|own| [start(&own.antenna), start(&own.receiver)])
        };
        let receivers = blocks.receivers.iter().map(receiver).collect();
        let targets = starts(&blocks.targets);
        self.camera_is_known = problem.camera_poses.iter().map(|pose| given && pose.is_some()).collect();
        (self.cameras, self.poses, self.points) = (cameras, poses, points);
        (self.axles, self.targets, self.receivers) = (axles, targets, receivers);
    }
}

/// Takes the unknowns and measurements of a network, and keeps the coordinates and what each measurement sees of
/// them.
#[derive(Default)]
struct Examination {
    /// Gives blocks and groups their ids.
    ids: SystemBuilder,
    all: Coordinates,
    values: Vec<Vec<f64>>,
    rows: Rows,
    /// For each measurement of image points its first row, where it has rows: of vehicles, of targets.
    images: [Vec<Option<usize>>; 2],
}

impl Sink for Examination {
    fn block(&mut self, owner: Owner, manifold: Manifold, value: &[f64], free: &[bool]) -> BlockId {
        // A second block of a point that is there already.
        let held = vec![false; free.len()];
        let free = if matches!(owner, Owner::Middle(_)) { &held } else { free };
        self.all.add(owner, free);
        self.values.push(value.to_vec());
        self.ids.add_block(manifold, value, free)
    }

    fn decides(&self, _: &[BlockId]) -> bool {
        true
    }

    fn group<const ROWS: usize, const BLOCKS: usize, R: Residual<ROWS, BLOCKS> + 'static>(
        &mut self,
        source: Source,
        name: &'static str,
        loss: Loss,
        measurements: Vec<Measurement<R, ROWS, BLOCKS>>,
    ) -> GroupId {
        if source.is_measured() {
            let firsts: Vec<Option<usize>> = measurements.iter().map(|m| self.add(source, m)).collect();
            match source {
                Source::VehicleImages => self.images[0] = firsts,
                Source::TargetImages => self.images[1] = firsts,
                _ => {}
            }
        }
        self.ids.add_group(name, loss, Vec::<Measurement<R, ROWS, BLOCKS>>::new())
    }
}

impl Examination {
    /// Adds the rows of a measurement and returns the first; `None` where it has no value. Rows that see nothing
    /// that is adjusted are left out, unless they are of an image point.
    fn add<const ROWS: usize, const BLOCKS: usize, R: Residual<ROWS, BLOCKS>>(
        &mut self,
        source: Source,
        measurement: &Measurement<R, ROWS, BLOCKS>,
    ) -> Option<usize> {
        let mut jacobian = Jacobian::zeros();
        let values = measurement.blocks.map(|block| self.values[block.index()].as_slice());
        measurement.residual.evaluate(&values, Some(&mut jacobian))?;
        let starts = measurement.blocks.map(|block| self.all.start(block));
        let first = self.rows.len();
        for (row, sigma) in measurement.sigma.into_iter().enumerate() {
            let before = self.rows.entries.len();
            for ((derivative, manifold), start) in jacobian.0.iter().zip(R::MANIFOLDS).zip(starts) {
                let columns = 0..manifold.tangent();
                self.rows.entries.extend(columns.map(|at| (start + at, derivative[(row, at)] / sigma)));
            }
            let sees = |(at, value): &(usize, f64)| *value != 0.0 && self.all.is_free[*at];
            if source.is_image() || self.rows.entries[before..].iter().any(sees) {
                self.rows.starts.push(self.rows.entries.len());
            } else {
                self.rows.entries.truncate(before);
            }
        }
        if source.is_image() {
            self.rows.images = self.rows.len();
        }
        Some(first)
    }
}

/// Coordinates and rows of a problem at an estimate.
pub fn examine(problem: &Problem, estimate: &Estimate) -> (Coordinates, Rows) {
    let components = problem.camera_pose_sigma.components();
    let cameras = Treatment { free: components.map(|sigma| sigma != Some(0.0)), ..of_cameras(problem).0 };
    let vehicles: Vec<Treatment> = problem.vehicles.iter().map(|v| of_vehicle(problem, v)).collect();
    let mut examination =
        Examination { rows: Rows { starts: vec![0], ..Rows::default() }, ..Default::default() };
    let declared = declare(
        &mut examination,
        &Declaration {
            problem,
            start: estimate,
            current: estimate,
            cameras: &cameras,
            vehicles: &vehicles,
            motion: MotionPriors::OFF,
            selection: &Selection::everything(problem),
            purpose: Purpose::FROM_AFAR,
        },
    );
    let Examination { mut all, mut rows, images: [of_vehicles, of_targets], .. } = examination;
    all.index(problem, &declared);
    rows.of_vehicles = vec![Vec::new(); problem.vehicles.len()];
    for ((vehicle, item), row) in declared.images.vehicle_items.iter().zip(of_vehicles) {
        let seen = &problem.vehicles[*vehicle].observations[*item];
        let sighting = row.map(|row| Sighting { frame: seen.frame, point: seen.point, row });
        rows.of_vehicles[*vehicle].extend(sighting);
    }
    for (item, row) in declared.images.target_items.iter().zip(of_targets) {
        let seen = &problem.target_observations[*item];
        rows.of_targets.extend(row.map(|row| Sighting { frame: seen.frame, point: seen.target, row }));
    }
    rows.measured = rows.len();
    for coordinate in (0..all.len()).filter(|at| !all.is_free[*at]) {
        rows.entries.push((coordinate, 1.0 / EXACT));
        rows.starts.push(rows.entries.len());
    }
    (all, rows)
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
}
