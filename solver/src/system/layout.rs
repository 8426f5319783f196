//! Which blocks there are, and where each stands: among the values, in the elimination order, in a step.

use crate::manifold::{MAX_TANGENT, Manifold};
use std::ops::Range;

/// A block of unknowns of a system.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BlockId(pub(super) usize);

impl BlockId {
    /// How many blocks were added to the same builder before it.
    pub fn index(self) -> usize {
        self.0
    }
}

/// A group of measurements of a system.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GroupId(pub(super) usize);

/// A value for every block of a system.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Values(pub(super) Vec<f64>);

pub(super) struct Block {
    pub manifold: Manifold,
    /// First number of its value.
    pub start: usize,
    pub free: [bool; MAX_TANGENT],
}

impl Block {
    /// Which of its perturbations are adjusted.
    #[inline(always)]
    pub(super) fn free(&self) -> &[bool] {
        &self.free[..self.manifold.tangent()]
    }

    pub(super) fn is_free(&self) -> bool {
        self.free().contains(&true)
    }
}

/// The blocks of a system whose structure is fixed.
pub(super) struct Layout {
    pub blocks: Vec<Block>,
    /// Position of each block in the elimination order; `None` where it is held, eliminated first or common.
    pub position: Vec<Option<usize>>,
    /// Where the step of each block begins; `None` where it is held.
    pub step_start: Vec<Option<usize>>,
    /// Numbers of the blocks that have a position.
    pub others: usize,
    pub common: Common,
}

impl Layout {
    /// The value of a block.
    #[inline(always)]
    pub(super) fn value<'a>(&self, values: &'a Values, block: BlockId) -> &'a [f64] {
        let Block { manifold, start, .. } = self.blocks[block.0];
        &values.0[start..start + manifold.ambient()]
    }

    /// Sets the value of a block.
    pub(super) fn set_value(&self, values: &mut Values, block: BlockId, value: &[f64]) {
        let Block { manifold, start, .. } = self.blocks[block.0];
        values.0[start..start + manifold.ambient()].copy_from_slice(value);
    }

    /// How long a step is without the blocks that are eliminated first.
    pub(super) fn size(&self) -> usize {
        self.others + self.common.size()
    }

    /// Which components of a block are adjusted.
    #[inline(always)]
    pub(super) fn free(&self, block: BlockId) -> &[bool] {
        self.blocks[block.0].free()
    }

    /// Where the perturbation of a block is in a step; `None` where the block is held.
    #[inline]
    pub(super) fn range_of(&self, block: BlockId) -> Option<Range<usize>> {
        let start = self.step_start[block.0]?;
        Some(start..start + self.blocks[block.0].manifold.tangent())
    }

    /// The part of a step that moves a free block.
    pub(super) fn step_of<'a>(&self, block: BlockId, step: &'a [f64]) -> &'a [f64] {
        let start = self.step_start[block.0].expect("a free block");
        &step[start..start + self.blocks[block.0].manifold.tangent()]
    }
}

/// The blocks that measurements of all frames share, and where each begins among them.
#[derive(Default)]
pub(super) struct Common {
    blocks: Vec<usize>,
    starts: Vec<usize>,
    size: usize,
}

impl Common {
    /// Those of `declared` that are adjusted.
    pub(super) fn new(declared: &[BlockId], blocks: &[Block]) -> Self {
        let mut common = Common::default();
        for block in declared.iter().filter(|block| blocks[block.0].is_free()) {
            common.blocks.push(block.0);
            common.starts.push(common.size);
            common.size += blocks[block.0].manifold.tangent();
        }
        common
    }

    /// How many numbers perturb them.
    pub(super) fn size(&self) -> usize {
        self.size
    }

    /// Whether a block is one of them.
    #[inline]
    pub(super) fn has(&self, block: usize) -> bool {
        self.blocks.contains(&block)
    }

    /// The blocks, and where each begins.
    pub(super) fn places(&self) -> impl Iterator<Item = (usize, usize)> {
        self.blocks.iter().copied().zip(self.starts.iter().copied())
    }

    /// Where a block begins.
    #[inline]
    pub(super) fn start_of(&self, block: usize) -> Option<usize> {
        self.blocks.iter().position(|b| *b == block).map(|at| self.starts[at])
    }
}
