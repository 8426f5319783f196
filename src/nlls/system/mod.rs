//! Parameter blocks and groups of measurements, in a stable order: the least-squares problem itself.
//!
//! The order in which blocks and measurements are added is the order of every sum, so that a result
//! depends on neither chance nor the number of threads.

mod assembly;
mod group;
mod orbit;
#[cfg(test)]
mod tests;

pub use group::{IMPOSSIBLE_SIGMAS, Measurement};

use super::linear::matrix::BlockMatrix;
use super::loss::Loss;
use super::manifold::{MAX_TANGENT, Manifold};
use super::residual::Residual;
use assembly::Gather;
use group::{AnyGroup, Group, Linear};
use orbit::Orbit;

/// A block of unknowns of a system.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BlockId(usize);

/// A group of measurements of a system.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GroupId(usize);

/// A value for every block of a system.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Values(Vec<f64>);

struct Block {
    manifold: Manifold,
    start: usize,
    free: [bool; MAX_TANGENT],
}

impl Block {
    fn is_free(&self) -> bool {
        self.free[..self.manifold.tangent()].contains(&true)
    }
}

/// Collects blocks and measurements.
#[derive(Default)]
pub struct SystemBuilder {
    blocks: Vec<Block>,
    start: Vec<f64>,
    groups: Vec<Box<dyn AnyGroup>>,
    orbits: Vec<Orbit>,
}

impl SystemBuilder {
    /// Adds a block that starts at `value`; only its `free` perturbations are adjusted.
    pub fn add_block(&mut self, manifold: Manifold, value: &[f64], free: &[bool]) -> BlockId {
        assert_eq!(value.len(), manifold.ambient(), "length of a value");
        assert_eq!(free.len(), manifold.tangent(), "length of a mask");
        let mut mask = [false; MAX_TANGENT];
        mask[..free.len()].copy_from_slice(free);
        self.blocks.push(Block { manifold, start: self.start.len(), free: mask });
        self.start.extend_from_slice(value);
        BlockId(self.blocks.len() - 1)
    }

    /// Adds a group of measurements under one loss. Those between held blocks alone decide nothing
    /// and are left out.
    pub fn add_group<const ROWS: usize, const BLOCKS: usize, R: Residual<ROWS, BLOCKS> + 'static>(
        &mut self,
        name: &'static str,
        loss: Loss,
        measurements: Vec<Measurement<R, ROWS, BLOCKS>>,
    ) -> GroupId {
        let blocks = &self.blocks;
        for measurement in &measurements {
            for (block, manifold) in measurement.blocks.iter().zip(R::MANIFOLDS) {
                assert_eq!(blocks[block.0].manifold, manifold, "block of a {name}");
            }
            for (i, block) in measurement.blocks.iter().enumerate() {
                assert!(!measurement.blocks[..i].contains(block), "a {name} sees a block twice");
            }
        }
        let decides = |m: &Measurement<R, ROWS, BLOCKS>| m.blocks.iter().any(|b| blocks[b.0].is_free());
        let kept = measurements.into_iter().filter(decides).collect();
        self.groups.push(Box::new(Group { name, loss, sigma_factor: 1.0, measurements: kept }));
        GroupId(self.groups.len() - 1)
    }

    /// Declares that these points and poses are one rigid body, so that a step may turn and shift its
    /// frame exactly. Without effect where a component of one of them is held.
    pub fn add_rigid_body(&mut self, points: Vec<BlockId>, poses: Vec<BlockId>) {
        self.orbits.push(Orbit { points, poses });
    }

    /// Finds the pattern of the normal matrix and its elimination order. Blocks that no measurement
    /// sees are held.
    pub fn build(mut self) -> System {
        let mut seen = vec![false; self.blocks.len()];
        for group in &self.groups {
            for item in 0..group.len() {
                group.blocks(item).iter().for_each(|block| seen[block.0] = true);
            }
        }
        for (block, seen) in self.blocks.iter_mut().zip(&seen) {
            if !seen {
                block.free = [false; MAX_TANGENT];
            }
        }
        let free: Vec<usize> = (0..self.blocks.len()).filter(|&b| self.blocks[b].is_free()).collect();
        let mut unknown = vec![None; self.blocks.len()];
        free.iter().enumerate().for_each(|(u, &block)| unknown[block] = Some(u));
        let dims: Vec<usize> = free.iter().map(|&b| self.blocks[b].manifold.tangent()).collect();
        let mut pairs = Vec::new();
        for group in &self.groups {
            for item in 0..group.len() {
                let blocks = group.blocks(item);
                for (i, a) in blocks.iter().enumerate() {
                    for b in &blocks[..i] {
                        if let (Some(a), Some(b)) = (unknown[a.0], unknown[b.0]) {
                            pairs.push((a, b));
                        }
                    }
                }
            }
        }
        let matrix = BlockMatrix::new(&dims, pairs);
        let position: Vec<Option<usize>> = unknown.iter().map(|u| u.map(|u| matrix.position(u))).collect();
        let gather = Gather::new(&matrix, &self.groups, &position);
        let all_free = |b: &BlockId| {
            let block = &self.blocks[b.0];
            block.free[..block.manifold.tangent()].iter().all(|free| *free)
        };
        let mut orbits = self.orbits;
        orbits.retain(|orbit| orbit.points.iter().chain(&orbit.poses).all(all_free));
        System {
            orbits,
            blocks: self.blocks,
            start: Values(self.start),
            groups: self.groups,
            position,
            matrix,
            gather,
        }
    }
}

/// A least-squares problem whose structure is fixed. Losses and the sigma factors of groups may
/// still change.
pub struct System {
    blocks: Vec<Block>,
    start: Values,
    groups: Vec<Box<dyn AnyGroup>>,
    /// Position of each block in the elimination order; `None` where it is held.
    position: Vec<Option<usize>>,
    /// The pattern of the normal matrix (its values are not used).
    matrix: BlockMatrix,
    gather: Gather,
    orbits: Vec<Orbit>,
}

/// The system at one state, linearised: what the minimiser needs for a step.
pub struct Normal {
    /// `J^T W J` of the whitened, weighted measurements. Held perturbations have 1 on the diagonal.
    pub matrix: BlockMatrix,
    /// Gradient of the cost, in elimination order.
    pub gradient: Vec<f64>,
    linear: Vec<Linear>,
}

/// The cost of a state and how it comes about.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Cost {
    /// Half the sum of `rho`.
    pub value: f64,
    /// Measurements with an impossible geometry, charged [`IMPOSSIBLE_SIGMAS`] each.
    pub impossible: usize,
}

impl System {
    /// The values that the blocks were added with.
    pub fn start(&self) -> &Values {
        &self.start
    }

    /// The value of a block.
    pub fn value<'a>(&self, values: &'a Values, block: BlockId) -> &'a [f64] {
        let Block { manifold, start, .. } = self.blocks[block.0];
        &values.0[start..start + manifold.ambient()]
    }

    /// Sets the value of a block.
    pub fn set_value(&self, values: &mut Values, block: BlockId, value: &[f64]) {
        let Block { manifold, start, .. } = self.blocks[block.0];
        values.0[start..start + manifold.ambient()].copy_from_slice(value);
    }

    /// How many numbers are adjusted.
    pub fn parameters(&self) -> usize {
        let count = |b: &Block| b.free[..b.manifold.tangent()].iter().filter(|f| **f).count();
        self.blocks.iter().map(count).sum()
    }

    /// How many rows a group contributes (measurements times their numbers).
    pub fn rows(&self, group: GroupId) -> usize {
        self.groups[group.0].len() * self.groups[group.0].rows()
    }

    /// The pattern of the normal matrix and its elimination order.
    pub fn pattern(&self) -> &BlockMatrix {
        &self.matrix
    }

    /// Changes the loss of a group.
    pub fn set_loss(&mut self, group: GroupId, loss: Loss) {
        self.groups[group.0].set_loss(loss);
    }

    /// Multiplies every standard deviation of a group by `factor` (1 at first).
    pub fn set_sigma_factor(&mut self, group: GroupId, factor: f64) {
        self.groups[group.0].set_sigma_factor(factor);
    }

    /// What multiplies the standard deviations of a group.
    pub fn sigma_factor(&self, group: GroupId) -> f64 {
        self.groups[group.0].sigma_factor()
    }

    /// The true robust cost.
    pub fn cost(&self, values: &Values) -> Cost {
        self.groups.iter().map(|group| group.cost(self, values)).fold(Cost::default(), |a, b| Cost {
            value: a.value + b.value,
            impossible: a.impossible + b.impossible,
        })
    }

    /// Squared norms of the whitened residuals of a group, before the loss; `None` where the
    /// geometry is impossible.
    pub fn squared_norms(&self, group: GroupId, values: &Values) -> Vec<Option<f64>> {
        self.groups[group.0].squared_norms(self, values)
    }

    /// `values` moved by a step in elimination order.
    pub fn plus(&self, values: &Values, step: &[f64]) -> Values {
        let mut moved = values.clone();
        for (block, position) in self.blocks.iter().zip(&self.position) {
            let Some(position) = *position else { continue };
            let at = block.start..block.start + block.manifold.ambient();
            let delta = &step[self.matrix.range(position)];
            block.manifold.plus(&values.0[at.clone()], delta, &mut moved.0[at]);
        }
        for orbit in &self.orbits {
            orbit.apply(self, values, step, &mut moved);
        }
        moved
    }

    /// The part of a step that moves a free block.
    fn step_of<'a>(&self, block: BlockId, step: &'a [f64]) -> &'a [f64] {
        &step[self.matrix.range(self.position[block.0].expect("a free block"))]
    }

    /// Linearises all measurements at `values` into `normal`.
    pub fn linearise(&self, values: &Values, normal: &mut Normal) {
        for (group, linear) in self.groups.iter().zip(&mut normal.linear) {
            group.linearise(self, values, linear);
        }
        self.gather.assemble(&normal.linear, &mut normal.matrix, &mut normal.gradient);
        for (block, position) in self.blocks.iter().zip(&self.position) {
            let Some(position) = *position else { continue };
            let range = self.matrix.range(position);
            for (component, free) in block.free[..block.manifold.tangent()].iter().enumerate() {
                if !free {
                    normal.matrix.set_diagonal(range.start + component, 1.0);
                }
            }
        }
    }

    /// Room for a linearisation.
    pub fn normal(&self) -> Normal {
        Normal {
            matrix: self.matrix.clone(),
            gradient: vec![0.0; self.matrix.size()],
            linear: self.groups.iter().map(|group| group.linear()).collect(),
        }
    }

    /// `J^T z` for the whitened, weighted rows of a group, where `z` has one number a row.
    pub fn transposed_product(&self, group: GroupId, normal: &Normal, z: &[f64]) -> Vec<f64> {
        self.gather.transposed_product(group.0, &normal.linear[group.0], z, self)
    }

    fn free(&self, block: BlockId) -> &[bool] {
        let block = &self.blocks[block.0];
        &block.free[..block.manifold.tangent()]
    }
}
