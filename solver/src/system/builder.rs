//! Collects blocks and measurements, and decides how they are eliminated.

use super::assembly::Gather;
use super::frames::{Arrangement, Declared, Frames};
use super::gauge_orbit::GaugeOrbit;
use super::group::{AnyGroup, Group, Measurement};
use super::layout::{Block, BlockId, Common, GroupId, Layout, Values};
use super::least_squares::System;
use super::leaves::Leaves;
use super::time_steps::{Parts, TimeStep};
use crate::linear::matrix::Pattern;
use crate::loss::Loss;
use crate::manifold::{MAX_TANGENT, Manifold};
use crate::residual::Residual;
use std::sync::Arc;

/// Collects blocks and measurements.
///
/// The mean of three readings (a [`Residual`] of one number):
///
/// ```
/// # use trackbundle_solver::nalgebra::Vector1;
/// # use trackbundle_solver::{Covariance, Jacobian, Loss, Manifold, Measurement, Minimiser, MinimiserOptions};
/// # use trackbundle_solver::{Residual, SystemBuilder};
/// # struct Reading(f64);
/// # impl Residual<1, 1> for Reading {
/// #     const MANIFOLDS: [Manifold; 1] = [Manifold::SCALAR];
/// #     fn evaluate(&self, x: &[&[f64]; 1], jacobian: Option<&mut Jacobian<1, 1>>) -> Option<Vector1<f64>> {
/// #         if let Some(jacobian) = jacobian {
/// #             jacobian.set(0, 0, &Vector1::new(1.0));
/// #         }
/// #         Some(Vector1::new(x[0][0] - self.0))
/// #     }
/// # }
/// let mut builder = SystemBuilder::default();
/// let level = builder.add_block(Manifold::SCALAR, &[0.0], &[true]);
/// let readings = [1.0, 2.0, 6.0].map(|read| Measurement { residual: Reading(read), blocks: [level], sigma: [0.3] });
/// builder.add_group("readings", Loss::Squared, readings.into());
/// let system = builder.build();
/// assert_eq!((system.parameters(), system.value(system.start(), level)), (1, &[0.0][..]));
/// let minimum = Minimiser::new(&system)?.run(&system, system.start(), MinimiserOptions::default(), None);
/// assert!((system.value(&minimum.values, level)[0] - 3.0).abs() < 1e-8);
/// # Ok::<(), trackbundle_solver::TooLarge>(())
/// ```
#[derive(Default)]
pub struct SystemBuilder {
    blocks: Vec<Block>,
    start: Vec<f64>,
    groups: Vec<Box<dyn AnyGroup>>,
    orbits: Vec<GaugeOrbit>,
    leaves: Vec<BlockId>,
    common: Vec<BlockId>,
    steps: Vec<TimeStep>,
    relative: Vec<usize>,
    reach: usize,
    arrangement: Arrangement,
}

impl SystemBuilder {
    /// Adds a block that starts at `value`; only its `free` perturbations are adjusted.
    ///
    /// # Panics
    ///
    /// If `value` or `free` is not as long as the manifold says, or perturbed by more than
    /// [`MAX_TANGENT`] numbers.
    pub fn add_block(&mut self, manifold: Manifold, value: &[f64], free: &[bool]) -> BlockId {
        assert_eq!(value.len(), manifold.ambient(), "length of a value");
        assert_eq!(free.len(), manifold.tangent(), "length of a mask");
        assert!(free.len() <= MAX_TANGENT, "a block of more than {MAX_TANGENT} numbers");
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
    ///
    /// # Panics
    ///
    /// If a block is not of the manifold that the residual states, or a measurement sees a block twice.
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
        self.groups.push(Box::new(Group { name, loss, sigma_factors: [1.0; ROWS], measurements: kept }));
        GroupId(self.groups.len() - 1)
    }

    /// Declares that these points and poses are one rigid body, so that a step may turn and shift its
    /// frame exactly. Without effect where a component of one of them is held.
    pub fn add_rigid_body(&mut self, points: Vec<BlockId>, poses: Vec<BlockId>) {
        self.orbits.push(GaugeOrbit { points, poses });
    }

    /// Declares blocks that share no measurement with each other: each is eliminated by itself, before
    /// all others, and the normal matrix is that of the others alone (a Schur complement, never formed from
    /// stored blocks).
    ///
    /// # Panics
    ///
    /// If a block is perturbed by another number of values than 1, 2, 3, 6 or 9.
    pub fn eliminate(&mut self, blocks: Vec<BlockId>) {
        for block in &blocks {
            let tangent = self.blocks[block.0].manifold.tangent();
            assert!(Leaves::can_take(tangent), "blocks of {tangent} numbers are not eliminated first");
        }
        self.leaves.extend(blocks);
    }

    /// Declares a few unknowns that measurements of all moments share, image points among them: they are
    /// eliminated last, as a dense border. Without effect where blocks are eliminated first.
    pub fn share(&mut self, common: Vec<BlockId>) {
        self.common.extend(common);
    }

    /// Declares the poses of each moment, in time order, and the groups whose measurements see a point
    /// (their third block) of a body (the second) from an observer (the first) of the same moment, and
    /// both poses only as they lie to each other. Poses are then eliminated first, along time, where that can be
    /// done and is worth it: no pose is held in part, the points of bodies are [`Manifold::POINT`], no
    /// measurement spans more than five moments, and what an image point sees beside observer, body and point is
    /// held or [shared](SystemBuilder::share). Where one of these is not so, the elimination is sparse
    /// ([`System::elimination`] tells): the same minimum, but slower.
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
        self.hold_unseen();
        let roles = Roles::new(&self);
        let (pattern, position, frames) = self.structure(&roles);
        let Roles { is_leaf, leaf_blocks, common, .. } = roles;
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
        let all_free = |b: &BlockId| self.blocks[b.0].free().iter().all(|free| *free);
        let mut orbits = self.orbits;
        orbits.retain(|orbit| orbit.points.iter().chain(&orbit.poses).all(all_free));
        System {
            orbits,
            layout: Layout { blocks: self.blocks, position, step_start, others: pattern.size(), common },
            start: Values(self.start),
            groups: self.groups,
            pattern,
            gather,
            leaves,
            frames,
        }
    }

    fn hold_unseen(&mut self) {
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
    }

    /// The pattern, where each block stands in it, and the structure along time, where there is one.
    fn structure(&self, roles: &Roles) -> (Arc<Pattern>, Vec<Option<usize>>, Option<Frames>) {
        let without_groups = |without: &[usize]| {
            let pattern = Arc::new(Pattern::new(&roles.dims, pairs(&self.groups, without, roles)));
            let position: Vec<Option<usize>> =
                roles.unknown.iter().map(|u| u.map(|u| pattern.position(u))).collect();
            (pattern, position)
        };
        let by_frames = || {
            let (pattern, position) = without_groups(&self.relative);
            let declared = Declared {
                steps: &self.steps,
                relative: &self.relative,
                reach: self.reach,
                wanted: self.arrangement,
            };
            let (blocks, groups) = (self.blocks.as_slice(), self.groups.as_slice());
            let parts = Parts { blocks, groups, position: &position, pattern: &pattern };
            let frames = Frames::new(&declared, parts)?;
            Some((pattern, position, Some(frames)))
        };
        let wants_frames = roles.leaf_blocks.is_empty() && !self.relative.is_empty();
        wants_frames.then(by_frames).flatten().unwrap_or_else(|| {
            let (pattern, position) = without_groups(&[]);
            (pattern, position, None)
        })
    }
}

/// What becomes of each block.
struct Roles {
    is_leaf: Vec<bool>,
    /// The blocks that are eliminated first.
    leaf_blocks: Vec<usize>,
    common: Common,
    /// All others are numbered, and this long.
    unknown: Vec<Option<usize>>,
    dims: Vec<usize>,
}

impl Roles {
    fn new(builder: &SystemBuilder) -> Roles {
        let blocks = &builder.blocks;
        let mut is_leaf = vec![false; blocks.len()];
        builder.leaves.iter().for_each(|leaf| is_leaf[leaf.0] = blocks[leaf.0].is_free());
        let leaf_blocks: Vec<usize> = (0..blocks.len()).filter(|&b| is_leaf[b]).collect();
        let declared: &[BlockId] = if leaf_blocks.is_empty() { &builder.common } else { &[] };
        let common = Common::new(declared, blocks);
        let is_other = |block: usize| blocks[block].is_free() && !is_leaf[block] && !common.has(block);
        let others: Vec<usize> = (0..blocks.len()).filter(|&b| is_other(b)).collect();
        let mut unknown = vec![None; blocks.len()];
        others.iter().enumerate().for_each(|(u, &block)| unknown[block] = Some(u));
        let dims = others.iter().map(|&b| blocks[b].manifold.tangent()).collect();
        Roles { is_leaf, leaf_blocks, common, unknown, dims }
    }
}

/// Pairs of unknowns that share a measurement, or a leaf that is eliminated before them.
fn pairs(groups: &[Box<dyn AnyGroup>], without: &[usize], roles: &Roles) -> Vec<(usize, usize)> {
    let Roles { is_leaf, leaf_blocks, unknown, .. } = roles;
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
