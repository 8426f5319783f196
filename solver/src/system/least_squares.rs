//! The least-squares problem with its structure fixed: cost, linearisation, steps.

use super::accumulators::CommonLinear;
use super::assembly::Gather;
use super::common;
use super::frames::Frames;
use super::gauge_orbit::GaugeOrbit;
use super::group::{AnyGroup, State};
use super::layout::{Block, BlockId, GroupId, Layout, Values};
use super::leaves::{Leaves, Reduced};
use super::model::{Cost, Curvature, Step, clamped};
use super::normal::Normal;
use crate::linear::matrix::{BlockMatrix, Pattern};
use crate::linear::ordering::Elimination;
use crate::loss::Loss;
use nalgebra::DMatrix;
use std::ops::Range;
use std::sync::Arc;

/// A normal matrix for every block of a system by itself.
pub struct OwnNormals(Vec<DMatrix<f64>>);

impl OwnNormals {
    /// That of a block.
    pub fn of(&self, block: BlockId) -> &DMatrix<f64> {
        &self.0[block.0]
    }
}

/// A least-squares problem whose structure is fixed. Losses and the sigma factors of groups may
/// still change.
pub struct System {
    pub(super) layout: Layout,
    pub(super) start: Values,
    pub(super) groups: Vec<Box<dyn AnyGroup>>,
    /// The pattern of the normal matrix without the blocks that are eliminated first.
    pub(super) pattern: Arc<Pattern>,
    pub(super) gather: Gather,
    pub(super) leaves: Option<Leaves>,
    pub(super) frames: Option<Frames>,
    pub(super) orbits: Vec<GaugeOrbit>,
}

impl System {
    /// The values that the blocks were added with.
    pub fn start(&self) -> &Values {
        &self.start
    }

    /// The value of a block.
    #[inline(always)]
    pub fn value<'a>(&self, values: &'a Values, block: BlockId) -> &'a [f64] {
        self.layout.value(values, block)
    }

    /// Sets the value of a block.
    pub fn set_value(&self, values: &mut Values, block: BlockId, value: &[f64]) {
        self.layout.set_value(values, block, value);
    }

    /// How many numbers are adjusted.
    pub fn parameters(&self) -> usize {
        let count = |b: &Block| b.free().iter().filter(|f| **f).count();
        self.layout.blocks.iter().map(count).sum()
    }

    /// How many rows a group contributes (measurements times their numbers).
    pub fn rows(&self, group: GroupId) -> usize {
        self.groups[group.0].len() * self.groups[group.0].rows()
    }

    /// How long a step is, in elimination order and without blocks that are eliminated first: held components have
    /// a place, held blocks have none.
    pub fn size(&self) -> usize {
        self.layout.size()
    }

    /// Whether blocks are eliminated before the normal matrix is formed, which then depends on the
    /// damping.
    pub fn has_eliminated_blocks(&self) -> bool {
        self.leaves.is_some()
    }

    /// Changes the loss of a group.
    pub fn set_loss(&mut self, group: GroupId, loss: Loss) {
        self.groups[group.0].set_loss(loss);
    }

    /// Multiplies every standard deviation of a group by `factor` (1 at first).
    pub fn set_sigma_factor(&mut self, group: GroupId, factor: f64) {
        let factors = vec![factor; self.sigma_factors(group).len()];
        self.groups[group.0].set_sigma_factors(&factors);
    }

    /// The same for each row of its measurements by itself.
    pub fn set_sigma_factors(&mut self, group: GroupId, factors: &[f64]) {
        self.groups[group.0].set_sigma_factors(factors);
    }

    /// What multiplies the standard deviations of a group: those of the first row of its measurements.
    pub fn sigma_factor(&self, group: GroupId) -> f64 {
        self.sigma_factors(group)[0]
    }

    /// What multiplies the standard deviations of each row of the measurements of a group.
    pub fn sigma_factors(&self, group: GroupId) -> &[f64] {
        self.groups[group.0].sigma_factors()
    }

    /// The true robust cost.
    pub fn cost(&self, values: &Values) -> Cost {
        self.groups.iter().map(|group| group.cost(&self.layout, values)).fold(Cost::default(), |a, b| Cost {
            value: a.value + b.value,
            impossible: a.impossible + b.impossible,
        })
    }

    /// Squared norms of the whitened residuals of a group, before the loss; `None` where the
    /// geometry is impossible.
    pub fn squared_norms(&self, group: GroupId, values: &Values) -> Vec<Option<f64>> {
        self.groups[group.0].squared_norms(&self.layout, values)
    }

    /// Whitened residuals of a group, before the loss; `None` where the geometry is impossible.
    pub fn residuals(&self, group: GroupId, values: &Values) -> Vec<Option<Vec<f64>>> {
        self.groups[group.0].residuals(&self.layout, values)
    }

    /// `J^T J` by each block alone at `values`: its normal matrix, were all others known.
    pub fn own_normals(&self, values: &Values) -> OwnNormals {
        self.own_normals_without(values, &[])
    }

    /// [`System::own_normals`], without what some groups say.
    pub fn own_normals_without(&self, values: &Values, without: &[GroupId]) -> OwnNormals {
        let size = |block: &Block| block.manifold.tangent();
        let mut sums: Vec<DMatrix<f64>> =
            self.layout.blocks.iter().map(|block| DMatrix::zeros(size(block), size(block))).collect();
        let groups = self.groups.iter().enumerate().filter(|(at, _)| !without.contains(&GroupId(*at)));
        groups.for_each(|(_, group)| group.add_own(&self.layout, values, &mut sums));
        OwnNormals(sums)
    }

    /// `J x` for the whitened, weighted rows of a group at `values`, and `x` in elimination order.
    pub fn product(&self, group: GroupId, values: &Values, x: &[f64]) -> Vec<f64> {
        self.groups[group.0].product(&self.layout, values, x)
    }

    /// Where the perturbation of a block is in a step; `None` where the block is held.
    pub fn range_of(&self, block: BlockId) -> Option<Range<usize>> {
        self.layout.range_of(block)
    }

    /// Whether poses are eliminated first, along time ([`SystemBuilder::along_time`](super::SystemBuilder::along_time)).
    pub fn is_along_time(&self) -> bool {
        self.frames.is_some()
    }

    /// How the unknowns are eliminated, and operations of one factorisation.
    pub fn elimination(&self) -> (Elimination, f64) {
        match &self.frames {
            Some(frames) if frames.apart.is_some() => (Elimination::SeparateBodies, frames.flops),
            Some(frames) => (Elimination::JointBodies, frames.flops),
            None => (self.pattern.ordering().elimination, self.pattern.ordering().flops),
        }
    }

    /// `values` moved by a step.
    pub fn plus(&self, values: &Values, step: &[f64]) -> Values {
        let mut moved = values.clone();
        for (block, start) in self.layout.blocks.iter().zip(&self.layout.step_start) {
            let Some(start) = *start else { continue };
            let at = block.start..block.start + block.manifold.ambient();
            let delta = &step[start..start + block.manifold.tangent()];
            block.manifold.plus(&values.0[at.clone()], delta, &mut moved.0[at]);
        }
        for orbit in &self.orbits {
            orbit.apply(&self.layout, values, step, &mut moved);
        }
        moved
    }

    /// Linearises all measurements at `values` into `normal`. What is eliminated first is eliminated with the
    /// damping of `curvature`; `None` where such a block is not determined.
    pub fn linearise(&self, values: &Values, curvature: Curvature, normal: &mut Normal) -> Option<()> {
        let state = self.state(values, curvature);
        for (group, linear) in self.groups.iter().zip(&mut normal.linear) {
            if let Some(linear) = linear {
                group.linearise(&self.layout, values, curvature.least_flatness, linear);
            }
        }
        let n = self.pattern.size();
        self.gather.assemble(&normal.linear, &mut normal.matrix, &mut normal.gradient[..n]);
        normal.diagonal[..n].copy_from_slice(&normal.matrix.diagonal());
        if self.layout.common.size() > 0 {
            common::linearise(&state, &mut normal.common);
            normal.gradient[n..].copy_from_slice(normal.common.gradient.as_slice());
            normal.diagonal[n..].copy_from_slice(normal.common.own.diagonal().as_slice());
        }
        normal.raw_gradient.copy_from_slice(&normal.gradient);
        if let Some(leaves) = &self.leaves {
            let Normal { matrix, gradient, diagonal, raw_gradient, sums, .. } = normal;
            let reduced = Reduced { values: matrix.values_mut(), gradient, raw_gradient, diagonal };
            normal.leaf_gradient = leaves.eliminate(state, sums, reduced)?;
        }
        if let (Some(frames), Some(linear)) = (&self.frames, &mut normal.frames) {
            let (gradient, diagonal) = (&mut normal.raw_gradient, &mut normal.diagonal);
            frames.linearise(state, linear, gradient, diagonal);
        }
        for (block, position) in self.layout.blocks.iter().zip(&self.layout.position) {
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

    /// The whole step, given that of the blocks that are not eliminated first.
    pub(crate) fn back_substitute(
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
            let part = leaves.back_substitute(self.state(values, curvature), &mut normal.sums, others, steps);
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
            common: CommonLinear::zeros(self.layout.others, self.layout.common.size()),
            linear: linear.collect(),
            frames: self.frames.as_ref().map(Frames::linear),
            sums: self.leaves.as_ref().map_or(Vec::new(), |leaves| leaves.sums()),
        }
    }

    /// `J^T z` for the whitened, weighted rows of a group, where `z` has one number a row: zero where all that the
    /// group sees is held.
    ///
    /// # Panics
    ///
    /// Where the group sees blocks that are eliminated first, or that frames take care of.
    pub fn transposed_product(&self, group: GroupId, normal: &Normal, z: &[f64]) -> Vec<f64> {
        let seen = &self.groups[group.0];
        match &normal.linear[group.0] {
            Some(linear) => Gather::transposed_product(&**seen, linear, z, &self.layout),
            None => {
                let is_held = |item| seen.blocks(item).iter().all(|block| !self.free(*block).contains(&true));
                assert!((0..seen.len()).all(is_held), "a group whose blocks are eliminated by themselves");
                vec![0.0; self.size()]
            }
        }
    }

    /// The system at some values.
    pub(super) fn state<'a>(&'a self, values: &'a Values, curvature: Curvature) -> State<'a> {
        State { layout: &self.layout, groups: &self.groups, values, curvature }
    }

    /// Which components of a block are adjusted.
    pub fn free(&self, block: BlockId) -> &[bool] {
        self.layout.free(block)
    }
}
