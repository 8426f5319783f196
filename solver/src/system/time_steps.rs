//! The poses of each moment, classified: which are seen, by whom, in which image points, and where each block is.

use super::group::AnyGroup;
use super::layout::{Block, BlockId};
use crate::linear::matrix::Pattern;
use crate::linear::small::POSE;
use crate::manifold::Manifold;

/// The poses of one moment.
#[derive(Clone, Debug, Default)]
pub struct TimeStep {
    /// The pose from which bodies are seen.
    pub observer: Option<BlockId>,
    /// The poses of bodies.
    pub bodies: Vec<BlockId>,
}

/// Where a block of the pattern is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Place {
    /// In the chain: step, and first scalar in it, in the order c, v.
    Chain(usize, usize),
    /// In the border.
    Border(usize),
}

/// The poses of one moment that take part.
pub(super) struct Step {
    /// Block of the observer, and whether it is free.
    pub observer: Option<(usize, bool)>,
    pub bodies: Vec<BodyAtStep>,
}

/// A body at a moment.
pub(super) struct BodyAtStep {
    /// Block of its pose.
    pub block: usize,
    /// Its image points: group and item.
    pub items: Vec<(u32, u32)>,
    /// Where its coupling is kept.
    pub home: usize,
}

/// The blocks of a system, its groups, and where blocks stand in the pattern.
#[derive(Clone, Copy)]
pub(super) struct Parts<'a> {
    pub blocks: &'a [Block],
    pub groups: &'a [Box<dyn AnyGroup>],
    pub position: &'a [Option<usize>],
    pub pattern: &'a Pattern,
}

impl Parts<'_> {
    fn is_seen(&self, block: BlockId) -> bool {
        self.position[block.0].is_some()
    }

    /// Whether all components of a block are adjusted, or none is.
    fn is_all(&self, block: BlockId, free: bool) -> bool {
        self.blocks[block.0].free().iter().all(|f| *f == free)
    }
}

/// The steps and the step of each block that is a pose of one.
pub(super) struct Classified {
    pub steps: Vec<Step>,
    pub at_step: Vec<Option<usize>>,
    /// Which blocks are points that image points see.
    is_shape: Vec<bool>,
    /// How many steps apart poses are at the most that share a measurement.
    band: usize,
}

impl Classified {
    /// `None` where the structure is another: a pose is held in part, say. `relative` are the groups of image
    /// points.
    pub(super) fn new(declared: &[TimeStep], relative: &[usize], parts: Parts<'_>) -> Option<Classified> {
        let count = parts.blocks.len();
        let (steps, at_step) = (Vec::with_capacity(declared.len()), vec![None; count]);
        let mut found = Classified { steps, at_step, is_shape: vec![false; count], band: 0 };
        declared.iter().try_for_each(|step| found.add_step(step, parts))?;
        let mut is_rest = vec![false; count];
        for (index, group) in parts.groups.iter().enumerate() {
            for item in 0..group.len() {
                let seen = group.blocks(item);
                if relative.contains(&index) {
                    found.add_sight(seen, (index as u32, item as u32), parts)?;
                } else {
                    found.add_other(seen, &mut is_rest, parts);
                }
            }
        }
        let is_point = |b: usize| parts.blocks[b].manifold == Manifold::POINT;
        let is_other = |b: usize| found.is_shape[b] && (is_rest[b] || !is_point(b));
        (!(0..count).any(is_other)).then_some(found)
    }

    fn add_step(&mut self, step: &TimeStep, parts: Parts<'_>) -> Option<()> {
        let seen = || step.bodies.iter().filter(|b| parts.is_seen(**b));
        if !seen().all(|b| parts.is_all(*b, true)) {
            return None;
        }
        let observer = match step.observer {
            Some(b) if parts.is_all(b, true) || parts.is_all(b, false) => Some((b.0, parts.is_seen(b))),
            Some(_) => return None,
            None => None,
        };
        let body = |b: &BlockId| BodyAtStep { block: b.0, items: Vec::new(), home: 0 };
        let bodies: Vec<BodyAtStep> = seen().map(body).collect();
        for block in observer.iter().filter(|o| o.1).map(|o| o.0).chain(bodies.iter().map(|b| b.block)) {
            self.at_step[block] = Some(self.steps.len());
        }
        self.steps.push(Step { observer, bodies });
        Some(())
    }

    /// An image point: observer, body and point of one moment; what else it sees is common to all, or held.
    fn add_sight(&mut self, seen: &[BlockId], item: (u32, u32), parts: Parts<'_>) -> Option<()> {
        let [observer, body, point, common @ ..] = seen else { return None };
        if common.iter().any(|b| parts.is_seen(*b)) {
            return None;
        }
        let step = &mut self.steps[self.at_step[body.0]?];
        if step.observer.map(|o| o.0) != Some(observer.0) {
            return None;
        }
        let own = step.bodies.iter_mut().find(|b| b.block == body.0)?;
        own.items.push(item);
        self.is_shape[point.0] |= parts.is_seen(*point);
        Some(())
    }

    /// Any other measurement: what it sees beside poses is no shape.
    fn add_other(&mut self, seen: &[BlockId], is_rest: &mut [bool], parts: Parts<'_>) {
        let times = || seen.iter().filter_map(|b| self.at_step[b.0]);
        if let (Some(first), Some(last)) = (times().min(), times().max()) {
            self.band = self.band.max(last - first);
            for b in seen.iter().filter(|b| self.at_step[b.0].is_none()) {
                is_rest[b.0] = parts.is_seen(*b);
            }
        }
    }

    /// Gives every block of the pattern its place: poses along time, then the points of bodies, those of a body
    /// together (`of_block` tells which), then what is no shape.
    pub(super) fn place(self, of_block: &[usize], parts: Parts<'_>) -> Option<Placed> {
        let Classified { steps, at_step, is_shape, band } = self;
        let Parts { blocks, position, pattern, .. } = parts;
        let dims: Vec<(usize, usize)> = steps
            .iter()
            .map(|s| (if s.observer.is_some_and(|o| o.1) { POSE } else { 0 }, POSE * s.bodies.len()))
            .collect();
        let mut places = vec![Place::Border(0); pattern.rows().len()];
        for (at, step) in steps.iter().enumerate() {
            let free = step.observer.iter().filter(|o| o.1).map(|o| o.0);
            for (order, block) in free.chain(step.bodies.iter().map(|b| b.block)).enumerate() {
                places[position[block]?] = Place::Chain(at, POSE * order);
            }
        }
        let mut in_border: Vec<usize> = (0..blocks.len())
            .filter(|&block| position[block].is_some() && at_step[block].is_none())
            .collect();
        in_border.sort_by_key(|&block| (!is_shape[block], if is_shape[block] { of_block[block] } else { 0 }));
        let mut border = 0;
        let mut shape = 0;
        for &block in &in_border {
            let p = position[block]?;
            places[p] = Place::Border(border);
            border += pattern.range(p).len();
            if is_shape[block] {
                shape = border;
            }
        }
        Some(Placed { steps, dims, band, places, shape, border })
    }
}

/// Which unknown is where.
pub(super) struct Placed {
    pub steps: Vec<Step>,
    /// Unknowns `(c, y)` of each step.
    pub dims: Vec<(usize, usize)>,
    /// How many steps apart poses are at the most that share a measurement.
    pub band: usize,
    pub places: Vec<Place>,
    /// Scalars of the border: those that image points see, and all.
    pub shape: usize,
    pub border: usize,
}
