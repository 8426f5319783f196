//! Parameter blocks and groups of measurements, in a stable order: the least-squares problem itself.
//!
//! The order in which blocks and measurements are added is the order of every sum, so that a result
//! depends on neither chance nor the number of threads.

mod apart;
mod assembly;
mod common;
mod factors;
mod frames;
mod group;
mod leaves;
mod orbit;
mod selected;
#[cfg(test)]
mod tests;
mod together;

pub use factors::Factors;
pub use frames::{Accuracy, Arrangement, FramesFactor, TimeStep};
pub use group::{IMPOSSIBLE_SIGMAS, Measurement};
pub use selected::SelectedInverse;

use super::linear::cholesky::{Singular, TooLarge};
use super::linear::matrix::{BlockMatrix, Pattern};
use super::linear::ordering::Rule;
use super::loss::Loss;
use super::manifold::{MAX_TANGENT, Manifold};
use super::residual::Residual;
use assembly::Gather;
use common::{Common, CommonLinear};
use frames::{Frames, FramesLinear};
use group::{AnyGroup, Group, Linear};
use leaves::{Leaves, Reduced, Sums, clamped};
use nalgebra::DMatrix;
use orbit::Orbit;
use std::sync::Arc;

/// A block of unknowns of a system.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BlockId(usize);

impl BlockId {
    /// How many blocks were added to the same builder before it.
    pub fn index(self) -> usize {
        self.0
    }
}

/// A group of measurements of a system.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GroupId(usize);

/// A normal matrix for every block of a system by itself.
pub struct OwnNormals(Vec<DMatrix<f64>>);

impl OwnNormals {
    /// That of a block.
    pub fn of(&self, block: BlockId) -> &DMatrix<f64> {
        &self.0[block.0]
    }
}

/// A value for every block of a system.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Values(Vec<f64>);

struct Block {
    manifold: Manifold,
    start: usize,
    free: [bool; MAX_TANGENT],
}

impl Block {
    /// Which of its perturbations are adjusted.
    fn free(&self) -> &[bool] {
        &self.free[..self.manifold.tangent()]
    }

    fn is_free(&self) -> bool {
        self.free().contains(&true)
    }
}

/// Collects blocks and measurements.
#[derive(Default)]
pub struct SystemBuilder {
    blocks: Vec<Block>,
    start: Vec<f64>,
    groups: Vec<Box<dyn AnyGroup>>,
    orbits: Vec<Orbit>,
    leaves: Vec<BlockId>,
    common: Vec<BlockId>,
    steps: Vec<TimeStep>,
    relative: Vec<usize>,
    reach: usize,
    arrangement: Arrangement,
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

    /// Whether a measurement of these blocks decides anything: not all of them are held.
    pub fn decides(&self, blocks: &[BlockId]) -> bool {
        blocks.iter().any(|block| self.blocks[block.0].is_free())
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

    /// Declares blocks that share no measurement with each other: each is eliminated by itself, before
    /// all others, and the normal matrix is that of the others alone.
    pub fn eliminate(&mut self, leaves: Vec<BlockId>) {
        for leaf in &leaves {
            let tangent = self.blocks[leaf.0].manifold.tangent();
            assert!(Leaves::can_take(tangent), "blocks of {tangent} numbers are not eliminated first");
        }
        self.leaves.extend(leaves);
    }

    /// Declares a few unknowns that measurements of all frames share, image points among them: they are
    /// eliminated last. Without effect where leaves are eliminated.
    pub fn share(&mut self, common: Vec<BlockId>) {
        self.common.extend(common);
    }

    /// Declares the poses of each moment, in time order, and the groups whose measurements see a point
    /// (their third block) of a body (the second) from an observer (the first) of the same moment, and
    /// both poses only as they lie to each other. Frames are then eliminated first, where that can be
    /// done and is worth it.
    pub fn along_time(&mut self, steps: Vec<TimeStep>, relative: Vec<GroupId>) {
        self.steps = steps;
        self.relative = relative.iter().map(|group| group.0).collect();
    }

    /// Wants the covariance of poses of one body that are up to so many moments apart.
    pub fn select_within(&mut self, moments: usize) {
        self.reach = moments;
    }

    /// Chooses how bodies are eliminated by frames, instead of what takes fewer operations.
    pub fn arrange(&mut self, arrangement: Arrangement) {
        self.arrangement = arrangement;
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
        let mut is_leaf = vec![false; self.blocks.len()];
        self.leaves.iter().for_each(|leaf| is_leaf[leaf.0] = self.blocks[leaf.0].is_free());
        let leaf_blocks: Vec<usize> = (0..self.blocks.len()).filter(|&b| is_leaf[b]).collect();
        let declared: &[BlockId] = if leaf_blocks.is_empty() { &self.common } else { &[] };
        let common = Common::new(declared, &self.blocks);
        let is_other = |block: usize| self.blocks[block].is_free() && !is_leaf[block] && !common.has(block);
        let others: Vec<usize> = (0..self.blocks.len()).filter(|&b| is_other(b)).collect();
        let mut unknown = vec![None; self.blocks.len()];
        others.iter().enumerate().for_each(|(u, &block)| unknown[block] = Some(u));
        let dims: Vec<usize> = others.iter().map(|&b| self.blocks[b].manifold.tangent()).collect();
        let structure = |without: &[usize]| {
            let pairs = pairs(&self.groups, without, &is_leaf, &leaf_blocks, &unknown);
            let pattern = Arc::new(Pattern::new(&dims, pairs));
            let position: Vec<Option<usize>> =
                unknown.iter().map(|u| u.map(|u| pattern.position(u))).collect();
            (pattern, position)
        };
        let by_frames = || {
            let (pattern, position) = structure(&self.relative);
            let blocks = &self.blocks;
            let declared = (self.steps.as_slice(), self.relative.as_slice(), self.reach);
            let wanted = self.arrangement;
            let frames = Frames::new(declared, wanted, blocks, &self.groups, &position, &pattern)?;
            Some((pattern, position, frames))
        };
        let wants_frames = leaf_blocks.is_empty() && !self.relative.is_empty();
        let (pattern, position, frames) = match wants_frames.then(by_frames).flatten() {
            Some((pattern, position, frames)) => (pattern, position, Some(frames)),
            None => {
                let (pattern, position) = structure(&[]);
                (pattern, position, None)
            }
        };
        let is_taken = |group: usize, blocks: &[BlockId]| {
            (frames.is_some() && self.relative.contains(&group)) || blocks.iter().any(|b| is_leaf[b.0])
        };
        let gather = Gather::new(&pattern, &self.groups, &position, &is_taken);
        let leaves = (!leaf_blocks.is_empty())
            .then(|| Leaves::new(&leaf_blocks, &self.blocks, &self.groups, &position, &pattern));
        let mut step_start: Vec<Option<usize>> =
            position.iter().map(|p| p.map(|p| pattern.range(p).start)).collect();
        if let Some(leaves) = &leaves {
            for (block, start) in leaf_blocks.iter().zip(leaves.steps()) {
                step_start[*block] = Some(pattern.size() + start);
            }
        }
        for (block, start) in common.places() {
            step_start[block] = Some(pattern.size() + start);
        }
        let all_free = |b: &BlockId| {
            let block = &self.blocks[b.0];
            block.free().iter().all(|free| *free)
        };
        let mut orbits = self.orbits;
        orbits.retain(|orbit| orbit.points.iter().chain(&orbit.poses).all(all_free));
        System {
            orbits,
            blocks: self.blocks,
            start: Values(self.start),
            groups: self.groups,
            position,
            step_start,
            pattern,
            gather,
            leaves,
            frames,
            common,
        }
    }
}

/// Pairs of unknowns that share a measurement, or a leaf that is eliminated before them.
fn pairs(
    groups: &[Box<dyn AnyGroup>],
    without: &[usize],
    is_leaf: &[bool],
    leaf_blocks: &[usize],
    unknown: &[Option<usize>],
) -> Vec<(usize, usize)> {
    let mut leaf_of = vec![usize::MAX; unknown.len()];
    leaf_blocks.iter().enumerate().for_each(|(at, &block)| leaf_of[block] = at);
    let mut around: Vec<Vec<u32>> = vec![Vec::new(); leaf_blocks.len()];
    let mut pairs = Vec::new();
    for (index, group) in groups.iter().enumerate() {
        if without.contains(&index) {
            continue;
        }
        for item in 0..group.len() {
            let blocks = group.blocks(item);
            let mut leaves = blocks.iter().filter(|b| is_leaf[b.0]);
            let leaf = leaves.next();
            assert!(leaves.next().is_none(), "blocks that are eliminated first share a measurement");
            let seen = blocks.iter().filter_map(|b| unknown[b.0]);
            match leaf {
                Some(leaf) => around[leaf_of[leaf.0]].extend(seen.map(|u| u as u32)),
                None => {
                    for (i, a) in seen.clone().enumerate() {
                        pairs.extend(seen.clone().take(i).map(|b| (a, b)));
                    }
                }
            }
        }
    }
    // Leaves that see the same are many.
    around.iter_mut().for_each(|seen| {
        seen.sort_unstable();
        seen.dedup();
    });
    around.sort_unstable();
    around.dedup();
    for seen in &around {
        for (i, &a) in seen.iter().enumerate() {
            pairs.extend(seen[..i].iter().map(|&b| (a as usize, b as usize)));
        }
    }
    pairs
}

/// A least-squares problem whose structure is fixed. Losses and the sigma factors of groups may
/// still change.
pub struct System {
    blocks: Vec<Block>,
    start: Values,
    groups: Vec<Box<dyn AnyGroup>>,
    /// Position of each block in the elimination order; `None` where it is held or a leaf.
    position: Vec<Option<usize>>,
    /// Where the step of each block begins; `None` where it is held.
    step_start: Vec<Option<usize>>,
    /// The pattern of the normal matrix, leaves eliminated.
    pattern: Arc<Pattern>,
    gather: Gather,
    leaves: Option<Leaves>,
    frames: Option<Frames>,
    common: Common,
    orbits: Vec<Orbit>,
}

/// The system at one state, linearised: what the minimiser needs for a step.
pub struct Normal {
    /// `J^T W J` of the whitened, weighted measurements, leaves eliminated. Held perturbations have 1
    /// on the diagonal.
    pub matrix: BlockMatrix,
    /// Gradient of the cost, leaves eliminated, in elimination order.
    pub gradient: Vec<f64>,
    /// The diagonal and the gradient before the elimination of leaves.
    diagonal: Vec<f64>,
    raw_gradient: Vec<f64>,
    /// Largest entry of the gradient of a leaf.
    leaf_gradient: f64,
    linear: Vec<Option<Linear>>,
    sums: Vec<Sums>,
    frames: Option<FramesLinear>,
    common: CommonLinear,
}

/// What a quadratic model adds to the Gauss-Newton one, and what it takes from it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Curvature {
    /// Share of the diagonal of the normal matrix that is added to it.
    pub damping: f64,
    /// How flat the model may be along a residual whose loss bends, as a share of its curvature
    /// across: 1 is iteratively re-weighted least squares, towards 0 Newton's method
    /// ([`Loss::flatness`]).
    pub least_flatness: f64,
}

impl Curvature {
    /// Neither damped nor flattened.
    pub const PLAIN: Curvature = Curvature { damping: 0.0, least_flatness: 1.0 };
}

/// A damped step and what the quadratic model says of it.
pub struct Step {
    /// The perturbation of every free block.
    pub delta: Vec<f64>,
    /// `g^T delta`
    pub slope: f64,
    /// `delta^T D delta`, where `D` is the diagonal of the normal matrix.
    pub squared: f64,
}

impl Normal {
    /// Largest entry of the gradient.
    pub fn largest_gradient(&self) -> f64 {
        self.raw_gradient.iter().fold(self.leaf_gradient, |a, g| a.max(g.abs()))
    }

    /// Gradient of all blocks that are no leaves, before the elimination of leaves.
    pub fn raw_gradient(&self) -> &[f64] {
        &self.raw_gradient
    }

    /// What the damping of the others is multiplied by.
    pub fn scale(&self) -> Vec<f64> {
        self.diagonal.iter().map(|d| clamped(*d)).collect()
    }
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
    #[inline(always)]
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
        let count = |b: &Block| b.free().iter().filter(|f| **f).count();
        self.blocks.iter().map(count).sum()
    }

    /// How many rows a group contributes (measurements times their numbers).
    pub fn rows(&self, group: GroupId) -> usize {
        self.groups[group.0].len() * self.groups[group.0].rows()
    }

    /// How long a step is, in elimination order and without leaves: held components have a place, held
    /// blocks have none.
    pub fn size(&self) -> usize {
        self.pattern.size() + self.common.size()
    }

    /// The pattern of the normal matrix and its elimination order.
    pub fn pattern(&self) -> &Pattern {
        &self.pattern
    }

    /// Whether blocks are eliminated before the normal matrix is formed, which then depends on the
    /// damping.
    pub fn has_leaves(&self) -> bool {
        self.leaves.is_some()
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

    /// Whitened residuals of a group, before the loss; `None` where the geometry is impossible.
    pub fn residuals(&self, group: GroupId, values: &Values) -> Vec<Option<Vec<f64>>> {
        self.groups[group.0].residuals(self, values)
    }

    /// `J^T J` by each block alone at `values`: its normal matrix, were all others known.
    pub fn own_normals(&self, values: &Values) -> OwnNormals {
        self.own_normals_without(values, &[])
    }

    /// [`System::own_normals`], without what some groups say.
    pub fn own_normals_without(&self, values: &Values, without: &[GroupId]) -> OwnNormals {
        let size = |block: &Block| block.manifold.tangent();
        let mut sums: Vec<DMatrix<f64>> =
            self.blocks.iter().map(|block| DMatrix::zeros(size(block), size(block))).collect();
        let groups = self.groups.iter().enumerate().filter(|(at, _)| !without.contains(&GroupId(*at)));
        groups.for_each(|(_, group)| group.add_own(self, values, &mut sums));
        OwnNormals(sums)
    }

    /// `J x` for the whitened, weighted rows of a group at `values`, and `x` in elimination order.
    pub fn product(&self, group: GroupId, values: &Values, x: &[f64]) -> Vec<f64> {
        self.groups[group.0].product(self, values, x)
    }

    /// Where the perturbation of a block is in a step; `None` where the block is held.
    pub fn range_of(&self, block: BlockId) -> Option<std::ops::Range<usize>> {
        let start = self.step_start[block.0]?;
        Some(start..start + self.blocks[block.0].manifold.tangent())
    }

    /// Whether frames are eliminated first.
    pub fn has_frames(&self) -> bool {
        self.frames.is_some()
    }

    /// In which order the unknowns are eliminated, and operations of one factorisation.
    pub fn elimination(&self) -> (Rule, f64) {
        match &self.frames {
            Some(frames) if frames.apart.is_some() => (Rule::BodiesApart, frames.flops),
            Some(frames) => (Rule::FramesFirst, frames.flops),
            None => (self.pattern.ordering().rule, self.pattern.ordering().flops),
        }
    }

    /// Room for the factors where frames are eliminated first.
    pub fn frames_factor(&self) -> Result<FramesFactor, TooLarge> {
        FramesFactor::new(self.frames.as_ref().expect("frames are eliminated first"))
    }

    /// Factorises the normal matrix with `extra` on its diagonal, frames first.
    pub fn factorise_frames(
        &self,
        normal: &Normal,
        extra: &[f64],
        factor: &mut FramesFactor,
    ) -> Result<(), Singular> {
        factor.factorise(self.frames.as_ref().expect("frames are eliminated first"), normal, extra)
    }

    /// Solves with these factors in place, for right-hand sides in elimination order.
    pub fn solve_frames(
        &self,
        normal: &Normal,
        factor: &mut FramesFactor,
        accuracy: Accuracy,
        b: &mut [f64],
    ) {
        factor.solve(self.frames.as_ref().expect("frames are eliminated first"), normal, accuracy, b);
    }

    /// `values` moved by a step.
    pub fn plus(&self, values: &Values, step: &[f64]) -> Values {
        let mut moved = values.clone();
        for (block, start) in self.blocks.iter().zip(&self.step_start) {
            let Some(start) = *start else { continue };
            let at = block.start..block.start + block.manifold.ambient();
            let delta = &step[start..start + block.manifold.tangent()];
            block.manifold.plus(&values.0[at.clone()], delta, &mut moved.0[at]);
        }
        for orbit in &self.orbits {
            orbit.apply(self, values, step, &mut moved);
        }
        moved
    }

    /// The part of a step that moves a free block.
    fn step_of<'a>(&self, block: BlockId, step: &'a [f64]) -> &'a [f64] {
        let start = self.step_start[block.0].expect("a free block");
        &step[start..start + self.blocks[block.0].manifold.tangent()]
    }

    /// Linearises all measurements at `values` into `normal`. Leaves are eliminated with its damping;
    /// `None` where one of them is not determined.
    pub fn linearise(&self, values: &Values, curvature: Curvature, normal: &mut Normal) -> Option<()> {
        for (group, linear) in self.groups.iter().zip(&mut normal.linear) {
            if let Some(linear) = linear {
                group.linearise(self, values, curvature.least_flatness, linear);
            }
        }
        let n = self.pattern.size();
        self.gather.assemble(&normal.linear, &mut normal.matrix, &mut normal.gradient[..n]);
        normal.diagonal[..n].copy_from_slice(&normal.matrix.diagonal());
        if self.common.size() > 0 {
            self.common.linearise(self, values, curvature.least_flatness, &mut normal.common);
            normal.gradient[n..].copy_from_slice(normal.common.gradient.as_slice());
            normal.diagonal[n..].copy_from_slice(normal.common.own.diagonal().as_slice());
        }
        normal.raw_gradient.copy_from_slice(&normal.gradient);
        if let Some(leaves) = &self.leaves {
            let Normal { matrix, gradient, diagonal, raw_gradient, sums, .. } = normal;
            let reduced = Reduced { values: matrix.values_mut(), gradient, raw_gradient, diagonal };
            normal.leaf_gradient = leaves.eliminate(self, values, curvature, sums, reduced)?;
        }
        if let (Some(frames), Some(linear)) = (&self.frames, &mut normal.frames) {
            let (gradient, diagonal) = (&mut normal.raw_gradient, &mut normal.diagonal);
            frames.linearise(self, values, curvature, linear, gradient, diagonal);
        }
        for (block, position) in self.blocks.iter().zip(&self.position) {
            let Some(position) = *position else { continue };
            let range = self.pattern.range(position);
            for (component, free) in block.free().iter().enumerate() {
                if !free {
                    normal.matrix.set_diagonal(range.start + component, 1.0);
                    normal.diagonal[range.start + component] = 1.0;
                }
            }
        }
        Some(())
    }

    /// The whole step, given that of the blocks that are no leaves.
    pub fn back_substitute(
        &self,
        values: &Values,
        curvature: Curvature,
        normal: &mut Normal,
        others: Vec<f64>,
    ) -> Step {
        let n = others.len();
        let mut step = Step { delta: others, slope: 0.0, squared: 0.0 };
        for ((d, g), scale) in step.delta.iter().zip(&normal.raw_gradient).zip(&normal.diagonal) {
            step.slope += d * g;
            step.squared += clamped(*scale) * d * d;
        }
        if let Some(leaves) = &self.leaves {
            let count = leaves.steps()[leaves.steps().len() - 1];
            step.delta.resize(n + count, 0.0);
            let (others, steps) = step.delta.split_at_mut(n);
            let part = leaves.back_substitute(self, values, curvature, &mut normal.sums, others, steps);
            step.slope += part.slope;
            step.squared += part.squared;
        }
        step
    }

    /// Room for a linearisation.
    pub fn normal(&self) -> Normal {
        let n = self.size();
        let linear = self
            .groups
            .iter()
            .enumerate()
            .map(|(at, group)| self.gather.takes_part(at).then(|| group.linear()));
        Normal {
            matrix: BlockMatrix::zeros(self.pattern.clone()),
            gradient: vec![0.0; n],
            diagonal: vec![0.0; n],
            raw_gradient: vec![0.0; n],
            leaf_gradient: 0.0,
            common: self.common.linear(self.pattern.size()),
            linear: linear.collect(),
            frames: self.frames.as_ref().map(Frames::linear),
            sums: self.leaves.as_ref().map_or(Vec::new(), |leaves| leaves.sums(&self.pattern)),
        }
    }

    /// `J^T z` for the whitened, weighted rows of a group, where `z` has one number a row.
    pub fn transposed_product(&self, group: GroupId, normal: &Normal, z: &[f64]) -> Vec<f64> {
        let linear = normal.linear[group.0].as_ref().expect("a group that sees no leaf");
        self.gather.transposed_product(group.0, linear, z, self)
    }

    /// Which components of a block are adjusted.
    pub fn free(&self, block: BlockId) -> &[bool] {
        self.blocks[block.0].free()
    }
}
