//! Where unknowns and measurements go: a least-squares system, or the examination of what is open. Whoever declares
//! them does not know which.

use super::source::Source;
use trackbundle_solver::loss::Loss;
use trackbundle_solver::manifold::Manifold;
use trackbundle_solver::residual::Residual;
use trackbundle_solver::system::{BlockId, GroupId, Measurement, SystemBuilder};

/// Whose unknowns a block has. Vehicles, points, targets, frames and receivers are indices.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Owner {
    /// The camera in a frame.
    Camera(usize),
    /// A vehicle in a frame.
    Pose(usize, usize),
    /// The rear axle of a vehicle.
    Axle(usize),
    /// A point of a vehicle.
    Point(usize, usize),
    /// The point of a vehicle that its motion is told of.
    Middle(usize),
    /// A target.
    Target(usize),
    /// The bias of the terrain.
    Bias,
    /// The interior orientation.
    Interior,
    /// The readout time.
    Readout,
    /// The antenna of a receiver in the vehicle frame.
    Antenna(usize),
    /// Clock, drift and shift of a receiver.
    Receiver(usize),
}

/// What takes the unknowns and measurements of a network.
pub trait Sink {
    /// Adds a block of unknowns of this value; components that are not free are held.
    fn block(&mut self, owner: Owner, manifold: Manifold, value: &[f64], free: &[bool]) -> BlockId;

    /// Whether measurements between these blocks are wanted: for a system, whether one of them is adjusted.
    fn decides(&self, blocks: &[BlockId]) -> bool;

    /// Adds a group of measurements of one source under one loss.
    fn group<const ROWS: usize, const BLOCKS: usize, R: Residual<ROWS, BLOCKS> + 'static>(
        &mut self,
        source: Source,
        name: &'static str,
        loss: Loss,
        measurements: Vec<Measurement<R, ROWS, BLOCKS>>,
    ) -> GroupId;

    /// [`Sink::group`] by plain least squares.
    fn squares<const ROWS: usize, const BLOCKS: usize, R: Residual<ROWS, BLOCKS> + 'static>(
        &mut self,
        source: Source,
        name: &'static str,
        measurements: Vec<Measurement<R, ROWS, BLOCKS>>,
    ) -> GroupId {
        self.group(source, name, Loss::Squared, measurements)
    }
}

/// A least-squares system that is being built, and what its groups are.
#[derive(Default)]
pub struct SystemSink {
    /// The system.
    pub builder: SystemBuilder,
    /// Every group and what it is.
    pub sources: Vec<(Source, GroupId)>,
}

impl Sink for SystemSink {
    fn block(&mut self, _: Owner, manifold: Manifold, value: &[f64], free: &[bool]) -> BlockId {
        self.builder.add_block(manifold, value, free)
    }

    fn decides(&self, blocks: &[BlockId]) -> bool {
        self.builder.decides(blocks)
    }

    fn group<const ROWS: usize, const BLOCKS: usize, R: Residual<ROWS, BLOCKS> + 'static>(
        &mut self,
        source: Source,
        name: &'static str,
        loss: Loss,
        measurements: Vec<Measurement<R, ROWS, BLOCKS>>,
    ) -> GroupId {
        let group = self.builder.add_group(name, loss, measurements);
        self.sources.push((source, group));
        group
    }
}
