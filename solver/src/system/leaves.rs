//! Blocks that are eliminated one by one: points that only poses see, frames that only a shape sees.
//!
//! A leaf shares no measurement with another leaf, so that the normal matrix is
//!
//! ```text
//!        leaves        others
//!   [ V1            |  W1  ]          S = H - sum W_e^T V_e^-1 W_e
//!   [    V2         |  W2  ]          others:  S x = -(g - sum W_e^T V_e^-1 g_e)
//!   [       ...     |  ... ]          a leaf:  x_e = -V_e^-1 (g_e + W_e x)
//!   [ W1' W2' ...   |  H   ]
//! ```
//!
//! Neither V nor W nor a Jacobian is stored. In one pass over a leaf its measurements are linearised
//! and eliminated: with their Jacobians `E_i` by the leaf and `J_i` by others, and `V = L L^T`,
//!
//! ```text
//! E~_i = E_i L^-T        S_ij += J_i^T (d_ij - E~_i E~_j^T) J_j
//! ```
//!
//! which for an image point has rank 2 where `W_e^T V_e^-1 W_e` has the rank of the leaf. Of a leaf whose
//! others are neighbours, `Y_i = J_i^T E~_i` is made first and `Y_i Y_j^T` subtracted column by column, since there they
//! stand together. A second pass linearises again and finds the steps of the leaves.
//!
//! Leaves are cut into chunks whose number depends on the problem alone; each has sums of its own,
//! which are added in order: the same bytes for any number of threads.

use super::accumulators::{Entry, Local};
use super::group::{AnyGroup, State};
use super::layout::Block;
use super::leaf_kernels::{COLUMNS, add_lower, dot, factor_leaf, subtract_products, times};
use crate::linear::matrix::{Pattern, Place};
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::Arc;

/// Sums of all chunks together may take this much room \[bytes\], but two are always kept.
const ROOM: usize = 32 << 20;
/// The most chunks.
const MOST_CHUNKS: usize = 16;
/// Up to so many blocks, the place of a pair is looked up in a table.
const MOST_IN_TABLE: usize = 2048;

/// How many blocks one after the other are a long run of them.
const LONG: usize = 4;

/// Work that is compiled for each size that a leaf may have ([`Leaves::can_take`]).
macro_rules! by_size {
    ($size:expr, $n:ident => $work:block) => {
        match $size {
            1 => by_size!(@ $n = 1, $work),
            2 => by_size!(@ $n = 2, $work),
            3 => by_size!(@ $n = 3, $work),
            6 => by_size!(@ $n = 6, $work),
            9 => by_size!(@ $n = 9, $work),
            other => unreachable!("leaves of {other} numbers are not declared"),
        }
    };
    (@ $n:ident = $value:literal, $work:block) => {{
        const $n: usize = $value;
        $work
    }};
}

/// The leaves of a system and the measurements of each.
pub(super) struct Leaves {
    /// Block of each leaf.
    blocks: Vec<usize>,
    /// First scalar of each leaf's step, counted from the first leaf, and their number at the end.
    steps: Vec<usize>,
    /// First measurement of each leaf, and their number at the end.
    starts: Vec<usize>,
    /// Group and item, by leaf, group and position of the first other block.
    items: Vec<(u32, u32)>,
    chunks: Vec<Range<usize>>,
    /// That of the reduced system.
    pattern: Arc<Pattern>,
    places: Places,
}

/// Where the values of a pair of blocks stand.
struct Places {
    columns: Vec<Vec<Place>>,
    /// Index in its column of the block at row and column; empty where there are too many.
    table: Vec<u32>,
    /// First scalar of each position.
    starts: Vec<usize>,
}

impl Places {
    fn new(pattern: &Pattern) -> Self {
        let n = pattern.rows().len();
        let mut table = Vec::new();
        if n <= MOST_IN_TABLE {
            table.resize(n * n, u32::MAX);
            for (column, rows) in pattern.rows().iter().enumerate() {
                rows.iter().enumerate().for_each(|(at, row)| table[row * n + column] = at as u32);
            }
        }
        let columns = (0..n).map(|column| pattern.places(column).collect()).collect();
        Places { columns, table, starts: (0..n).map(|p| pattern.range(p).start).collect() }
    }

    #[inline(always)]
    fn get(&self, pattern: &Pattern, row: usize, column: usize) -> Place {
        let at = if self.table.is_empty() {
            pattern.rows()[column].binary_search(&row).expect("in the pattern")
        } else {
            self.table[row * self.columns.len() + column] as usize
        };
        self.columns[column][at]
    }
}

/// What one chunk adds to the reduced system. Aligned, so that two threads share no cache line.
#[derive(Clone, Default)]
#[repr(align(128))]
pub(super) struct Sums {
    values: Vec<f64>,
    /// Gradient of the reduced system.
    gradient: Vec<f64>,
    /// Gradient before the elimination.
    raw_gradient: Vec<f64>,
    /// Diagonal before the elimination.
    diagonal: Vec<f64>,
    /// Largest entry of the gradient of a leaf.
    leaf_gradient: f64,
    singular: bool,
    local: Local,
}

/// What the steps of leaves add to the prediction of a step.
#[derive(Clone, Copy, Default)]
pub(super) struct LeafSteps {
    pub slope: f64,
    pub squared: f64,
}

impl Leaves {
    pub(super) fn new(
        leaf_blocks: &[usize],
        blocks: &[Block],
        groups: &[Box<dyn AnyGroup>],
        position: &[Option<usize>],
        pattern: &Arc<Pattern>,
    ) -> Self {
        let mut leaf_of = vec![u32::MAX; blocks.len()];
        leaf_blocks.iter().enumerate().for_each(|(at, &block)| leaf_of[block] = at as u32);
        let leaf_of_item = |group: &dyn AnyGroup, item: usize| {
            group.blocks(item).iter().map(|b| leaf_of[b.0]).find(|leaf| *leaf != u32::MAX)
        };
        let mut starts = vec![0; leaf_blocks.len() + 1];
        for group in groups {
            for item in 0..group.len() {
                if let Some(leaf) = leaf_of_item(&**group, item) {
                    starts[leaf as usize + 1] += 1;
                }
            }
        }
        for at in 1..starts.len() {
            starts[at] += starts[at - 1];
        }
        let mut next = starts.clone();
        let mut items = vec![(0, 0); starts[leaf_blocks.len()]];
        for (group_index, group) in groups.iter().enumerate() {
            for item in 0..group.len() {
                if let Some(leaf) = leaf_of_item(&**group, item) {
                    items[next[leaf as usize]] = (group_index as u32, item as u32);
                    next[leaf as usize] += 1;
                }
            }
        }
        let first_position = |&(group, item): &(u32, u32)| {
            let seen = groups[group as usize].blocks(item as usize);
            (group, seen.iter().find_map(|b| position[b.0]), item)
        };
        for leaf in 0..leaf_blocks.len() {
            items[starts[leaf]..starts[leaf + 1]].sort_by_key(first_position);
        }
        let mut steps = vec![0];
        for &block in leaf_blocks {
            steps.push(steps[steps.len() - 1] + blocks[block].manifold.tangent());
        }
        let bytes = 8 * pattern.values().max(1);
        let count = (ROOM / bytes).clamp(2, MOST_CHUNKS);
        let chunks = cut(&starts, count);
        let (pattern, places) = (pattern.clone(), Places::new(pattern));
        Leaves { blocks: leaf_blocks.to_vec(), steps, starts, items, chunks, pattern, places }
    }

    /// First scalar of each leaf's step.
    pub(super) fn steps(&self) -> &[usize] {
        &self.steps
    }

    /// Room for the sums of all chunks.
    pub(super) fn sums(&self) -> Vec<Sums> {
        let (values, n) = (vec![0.0; self.pattern.values()], vec![0.0; self.pattern.size()]);
        let sums =
            Sums { values, gradient: n.clone(), raw_gradient: n.clone(), diagonal: n, ..Default::default() };
        vec![sums; self.chunks.len()]
    }

    /// Linearises and eliminates all leaves with this damping, and adds the sums of all chunks to
    /// the reduced system. Returns the largest entry of the gradients of leaves; `None` where one
    /// is not determined.
    pub(super) fn eliminate(&self, state: State<'_>, sums: &mut [Sums], reduced: Reduced<'_>) -> Option<f64> {
        self.chunks.par_iter().zip(sums.par_iter_mut()).for_each(|(chunk, sums)| {
            Arch::new().dispatch(EliminateChunk(self, state, chunk.clone(), sums));
        });
        let sums = &*sums;
        let add = |out: &mut [f64], of: fn(&Sums) -> &[f64]| {
            const PIECE: usize = 1 << 14;
            out.par_chunks_mut(PIECE).enumerate().for_each(|(piece, out)| {
                for sums in sums {
                    let part = &of(sums)[piece * PIECE..][..out.len()];
                    out.iter_mut().zip(part).for_each(|(out, value)| *out += value);
                }
            });
        };
        add(reduced.values, |s| &s.values);
        add(reduced.gradient, |s| &s.gradient);
        add(reduced.raw_gradient, |s| &s.raw_gradient);
        add(reduced.diagonal, |s| &s.diagonal);
        let largest = sums.iter().map(|s| s.leaf_gradient).fold(0.0, f64::max);
        (!sums.iter().any(|s| s.singular)).then_some(largest)
    }

    #[inline(always)]
    fn eliminate_chunk(&self, state: State<'_>, chunk: Range<usize>, sums: &mut Sums) {
        for out in [&mut sums.values, &mut sums.gradient, &mut sums.raw_gradient, &mut sums.diagonal] {
            out.fill(0.0);
        }
        (sums.leaf_gradient, sums.singular) = (0.0, false);
        let mut local = std::mem::take(&mut sums.local);
        for leaf in chunk {
            self.linearise(state, leaf, &mut local);
            let free = state.layout.blocks[self.blocks[leaf]].free();
            let done = by_size!(free.len(), N => {
                self.eliminate_leaf::<N>(free, state.curvature.damping, &mut local, sums)
            });
            sums.singular |= done.is_none();
        }
        sums.local = local;
    }

    /// Sizes that a leaf may have.
    pub(super) fn can_take(tangent: usize) -> bool {
        matches!(tangent, 1 | 2 | 3 | 6 | 9)
    }

    #[inline(always)]
    fn linearise(&self, state: State<'_>, leaf: usize, local: &mut Local) {
        local.clear();
        let mut items = &self.items[self.starts[leaf]..self.starts[leaf + 1]];
        while let Some(&(group, _)) = items.first() {
            let end = items.iter().position(|item| item.0 != group).unwrap_or(items.len());
            state.groups[group as usize].linearise_leaf(
                &items[..end],
                self.blocks[leaf],
                state.layout,
                state.values,
                state.curvature.least_flatness,
                local,
            );
            items = &items[end..];
        }
    }

    #[inline(always)]
    fn eliminate_leaf<const DE: usize>(
        &self,
        free: &[bool],
        damping: f64,
        local: &mut Local,
        sums: &mut Sums,
    ) -> Option<()> {
        let (factor, gradient, _) = factor_leaf::<DE>(local, free, damping)?;
        sums.leaf_gradient = gradient.iter().fold(sums.leaf_gradient, |a, g| a.max(g.abs()));
        let half = factor.forward(gradient);
        let Local { leaf, reduced, .. } = local;
        reduced.resize(leaf.len(), 0.0);
        for (row, out) in leaf.as_chunks::<DE>().0.iter().zip(reduced.as_chunks_mut::<DE>().0) {
            *out = factor.forward(*row);
        }
        // In the order of positions, and whether most stand in long runs of them.
        let mut in_runs = false;
        let mut uniform = |rows: usize, width: usize| {
            let alike = |e: &Entry| e.rows == rows && e.width == width && e.parts.1 - e.parts.0 == 1;
            if !local.entries.iter().all(alike) {
                return false;
            }
            let position = |e: &Entry| local.parts[e.parts.0].position;
            let (mut runs, mut others) = (1, 1);
            let in_order = local.entries.windows(2).all(|pair| {
                let (a, b) = (position(&pair[0]), position(&pair[1]));
                runs += usize::from(b > a + 1);
                others += usize::from(b > a);
                b >= a
            });
            in_runs = others >= LONG * runs;
            in_order
        };
        let pattern = &*self.pattern;
        if uniform(2, 9) {
            if in_runs {
                self.add_runs::<DE, 9>(pattern, &half, local, sums);
            } else {
                self.add_uniform::<DE, 9>(pattern, &half, local, sums);
            }
        } else if uniform(2, 6) {
            if in_runs {
                self.add_runs::<DE, 6>(pattern, &half, local, sums);
            } else {
                self.add_uniform::<DE, 6>(pattern, &half, local, sums);
            }
        } else {
            self.add_any::<DE>(pattern, &half, local, sums);
        }
        Some(())
    }

    #[inline(always)]
    fn add_gradients<const DE: usize, const D: usize>(
        &self,
        position: usize,
        jacobian: &[[f64; D]; 2],
        reduced: &[[f64; DE]; 2],
        r: &[f64; 2],
        half: &[f64; DE],
        sums: &mut Sums,
    ) {
        let start = self.places.starts[position];
        let own = &mut sums.gradient[start..start + D];
        let q = [r[0] - dot(&reduced[0], half), r[1] - dot(&reduced[1], half)];
        for c in 0..D {
            own[c] += jacobian[0][c] * q[0] + jacobian[1][c] * q[1];
        }
        let own = &mut sums.raw_gradient[start..start + D];
        for c in 0..D {
            own[c] += jacobian[0][c] * r[0] + jacobian[1][c] * r[1];
        }
        let own = &mut sums.diagonal[start..start + D];
        for c in 0..D {
            own[c] += jacobian[0][c] * jacobian[0][c] + jacobian[1][c] * jacobian[1][c];
        }
    }

    /// Image points with one other block each, in long runs of positions.
    #[inline(always)]
    fn add_runs<const DE: usize, const D: usize>(
        &self,
        pattern: &Pattern,
        half: &[f64; DE],
        local: &mut Local,
        sums: &mut Sums,
    ) {
        let Local { parts, residuals, other, reduced, panel, positions, runs, .. } = local;
        let jacobians = other.as_chunks::<D>().0.as_chunks::<2>().0;
        let reduced = reduced.as_chunks::<DE>().0.as_chunks::<2>().0;
        let residuals = residuals.as_chunks::<2>().0;
        positions.clear();
        positions.extend(parts.iter().map(|part| part.position));
        positions.dedup();
        runs.clear();
        for (i, position) in positions.iter().enumerate() {
            match runs.last_mut() {
                Some(run) if positions[i - 1] + 1 == *position => run.end = i + 1,
                _ => runs.push(i..i + 1),
            }
        }
        let rows = positions.len() * D;
        panel.clear();
        panel.resize(DE * rows, 0.0);
        let mut i = 0;
        for (measurement, &jacobian) in jacobians.iter().enumerate() {
            let (e, position) = (&reduced[measurement], parts[measurement].position);
            i += usize::from(positions[i] != position);
            self.add_gradients(position, &jacobian, e, &residuals[measurement], half, sums);
            let place = self.places.get(pattern, position, position);
            add_lower::<D>(&mut sums.values, place, &jacobian, &jacobian);
            for d in 0..DE {
                let out = &mut panel[d * rows + i * D..][..D];
                for c in 0..D {
                    out[c] += jacobian[0][c] * e[0][d] + jacobian[1][c] * e[1][d];
                }
            }
        }
        let mut run = 0;
        for j in 0..positions.len() {
            while runs[run].end <= j {
                run += 1;
            }
            for first in (0..D).step_by(COLUMNS) {
                let y: [[f64; COLUMNS]; DE] =
                    std::array::from_fn(|d| std::array::from_fn(|c| panel[d * rows + j * D + first + c]));
                for run in &runs[run..] {
                    // On the diagonal, rows from the last of these columns on; the triangle above by itself.
                    let is_own = run.start <= j;
                    let i = run.start.max(j);
                    let skipped = if is_own { first + COLUMNS - 1 } else { 0 };
                    let place = self.places.get(pattern, positions[i], positions[j]);
                    let (begin, end) = (i * D + skipped, run.end * D);
                    let out = sums.values.get_disjoint_mut(std::array::from_fn::<_, COLUMNS, _>(|c| {
                        let at = place.column_start(first + c) + skipped;
                        at..at + (end - begin)
                    }));
                    let out = out.expect("columns stand one behind the other");
                    let own = std::array::from_fn(|d| &panel[d * rows + begin..d * rows + end]);
                    subtract_products(out, own, &y);
                    if is_own {
                        for c in 0..COLUMNS - 1 {
                            let at = place.column_start(first + c);
                            for row in first + c..skipped {
                                for d in 0..DE {
                                    sums.values[at + row] -= panel[d * rows + j * D + row] * y[d][c];
                                }
                            }
                        }
                    }
                }
            }
        }
    }

    /// Image points with one other block each, in the order of its position.
    #[inline(always)]
    fn add_uniform<const DE: usize, const D: usize>(
        &self,
        pattern: &Pattern,
        half: &[f64; DE],
        local: &Local,
        sums: &mut Sums,
    ) {
        let jacobians = local.other.as_chunks::<D>().0.as_chunks::<2>().0;
        let reduced = local.reduced.as_chunks::<DE>().0.as_chunks::<2>().0;
        let residuals = local.residuals.as_chunks::<2>().0;
        // Copies, so that what is added to is known to be something else.
        for (i, &j_i) in jacobians.iter().enumerate() {
            let e_i = &reduced[i];
            let position = local.parts[i].position;
            self.add_gradients(position, &j_i, e_i, &residuals[i], half, sums);
            let cross = -dot(&e_i[0], &e_i[1]);
            let p = [[1.0 - dot(&e_i[0], &e_i[0]), cross], [cross, 1.0 - dot(&e_i[1], &e_i[1])]];
            let place = self.places.get(pattern, position, position);
            add_lower::<D>(&mut sums.values, place, &j_i, &times(&p, &j_i));
            for j in 0..i {
                let e_j = &reduced[j];
                let p = [
                    [-dot(&e_i[0], &e_j[0]), -dot(&e_i[0], &e_j[1])],
                    [-dot(&e_i[1], &e_j[0]), -dot(&e_i[1], &e_j[1])],
                ];
                let other = local.parts[j].position;
                let t = times(&p, &jacobians[j]);
                if other == position {
                    // Twice in one image: this and its transpose.
                    add_lower::<D>(&mut sums.values, place, &j_i, &t);
                    add_lower::<D>(&mut sums.values, place, &t, &j_i);
                } else {
                    let place = self.places.get(pattern, position, other);
                    for c in 0..D {
                        let at = place.column_start(c);
                        let column = &mut sums.values[at..at + D];
                        let mut moved = [0.0; D];
                        for row in 0..D {
                            moved[row] = column[row] + (j_i[0][row] * t[0][c] + j_i[1][row] * t[1][c]);
                        }
                        column.copy_from_slice(&moved);
                    }
                }
            }
        }
    }

    /// Any measurements, in any order.
    #[inline(always)]
    fn add_any<const DE: usize>(&self, pattern: &Pattern, half: &[f64; DE], local: &Local, sums: &mut Sums) {
        let reduced = local.reduced.as_chunks::<DE>().0;
        let parts = |e: &Entry| &local.parts[e.parts.0..e.parts.1];
        for (i, a) in local.entries.iter().enumerate() {
            for row in 0..a.rows {
                let r = local.residuals[a.row + row];
                let q = r - dot(&reduced[a.row + row], half);
                let jacobian = local.other_row(a, row);
                for part in parts(a) {
                    let start = self.places.starts[part.position];
                    for (c, j) in jacobian[part.column..][..part.dim].iter().enumerate() {
                        sums.gradient[start + c] += j * q;
                        sums.raw_gradient[start + c] += j * r;
                        sums.diagonal[start + c] += j * j;
                    }
                }
            }
            for (j, b) in local.entries.iter().enumerate().take(i + 1) {
                for k in 0..a.rows {
                    for l in 0..b.rows {
                        let same = if i == j && k == l { 1.0 } else { 0.0 };
                        let p = same - dot(&reduced[a.row + k], &reduced[b.row + l]);
                        let (j_a, j_b) = (local.other_row(a, k), local.other_row(b, l));
                        for at_a in parts(a) {
                            for at_b in parts(b) {
                                let (j_a, j_b) =
                                    (&j_a[at_a.column..][..at_a.dim], &j_b[at_b.column..][..at_b.dim]);
                                let ends = (at_a.position, at_b.position);
                                self.add_pair(pattern, &mut sums.values, ends, i == j, p, j_a, j_b);
                            }
                        }
                    }
                }
            }
        }
    }

    /// Adds `p j_a j_b^T` and, for two different measurements, its transpose.
    #[expect(clippy::too_many_arguments, reason = "a product of three, and where it goes")]
    fn add_pair(
        &self,
        pattern: &Pattern,
        values: &mut [f64],
        (a, b): (usize, usize),
        is_own: bool,
        p: f64,
        j_a: &[f64],
        j_b: &[f64],
    ) {
        if a < b && is_own {
            return;
        }
        let (row, column, j_row, j_column) = if a >= b { (a, b, j_a, j_b) } else { (b, a, j_b, j_a) };
        let place = self.places.get(pattern, row, column);
        for (c, right) in j_column.iter().enumerate() {
            let at = place.column_start(c);
            for (r, left) in j_row.iter().enumerate().skip(if row == column { c } else { 0 }) {
                values[at + r] += left * p * right;
                if row == column && !is_own {
                    values[at + r] += j_row[c] * p * j_column[r];
                }
            }
        }
    }

    /// The steps of all leaves, given the step of the others, behind which they are written.
    pub(super) fn back_substitute(
        &self,
        state: State<'_>,
        sums: &mut [Sums],
        others: &[f64],
        steps: &mut [f64],
    ) -> LeafSteps {
        let mut left = steps;
        let mut pieces = Vec::with_capacity(self.chunks.len());
        for chunk in &self.chunks {
            let (piece, rest) = left.split_at_mut(self.steps[chunk.end] - self.steps[chunk.start]);
            pieces.push(piece);
            left = rest;
        }
        let parts: Vec<LeafSteps> = self
            .chunks
            .par_iter()
            .zip(pieces)
            .zip(sums.par_iter_mut())
            .map(|((chunk, steps), sums)| {
                let job = StepsOfChunk(self, state, chunk.clone(), &mut sums.local, others, steps);
                Arch::new().dispatch(job)
            })
            .collect();
        parts.iter().fold(LeafSteps::default(), |a, b| LeafSteps {
            slope: a.slope + b.slope,
            squared: a.squared + b.squared,
        })
    }

    #[inline(always)]
    fn steps_of_chunk(
        &self,
        state: State<'_>,
        chunk: Range<usize>,
        local: &mut Local,
        others: &[f64],
        steps: &mut [f64],
    ) -> LeafSteps {
        let first = self.steps[chunk.start];
        let mut sum = LeafSteps::default();
        for leaf in chunk {
            self.linearise(state, leaf, local);
            let free = state.layout.blocks[self.blocks[leaf]].free();
            let step = &mut steps[self.steps[leaf] - first..self.steps[leaf + 1] - first];
            let part = by_size!(free.len(), N => {
                self.step_of_leaf::<N>(free, state.curvature.damping, local, others, step)
            });
            sum.slope += part.slope;
            sum.squared += part.squared;
        }
        sum
    }

    #[inline(always)]
    fn step_of_leaf<const DE: usize>(
        &self,
        free: &[bool],
        damping: f64,
        local: &Local,
        others: &[f64],
        step: &mut [f64],
    ) -> LeafSteps {
        let Some((factor, gradient, scale)) = factor_leaf::<DE>(local, free, damping) else {
            step.fill(f64::NAN);
            return LeafSteps::default();
        };
        let mut right = gradient;
        let leaf = local.leaf.as_chunks::<DE>().0;
        for entry in &local.entries {
            for row in 0..entry.rows {
                let jacobian = local.other_row(entry, row);
                let mut moved = 0.0;
                for part in &local.parts[entry.parts.0..entry.parts.1] {
                    let start = self.places.starts[part.position];
                    let (a, b) = (&jacobian[part.column..][..part.dim], &others[start..][..part.dim]);
                    moved += a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
                }
                for (out, e) in right.iter_mut().zip(&leaf[entry.row + row]) {
                    *out += e * moved;
                }
            }
        }
        let solution = factor.backward(factor.forward(right));
        let mut sum = LeafSteps::default();
        for c in 0..DE {
            step[c] = -solution[c];
            sum.slope += gradient[c] * step[c];
            sum.squared += scale[c] * step[c] * step[c];
        }
        sum
    }
}

/// [`Leaves::eliminate_chunk`] with the vector instructions that the machine has: a closure would not
/// be compiled for them.
struct EliminateChunk<'a>(&'a Leaves, State<'a>, Range<usize>, &'a mut Sums);

impl WithSimd for EliminateChunk<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        self.0.eliminate_chunk(self.1, self.2, self.3);
    }
}

/// [`Leaves::steps_of_chunk`] likewise.
struct StepsOfChunk<'a>(&'a Leaves, State<'a>, Range<usize>, &'a mut Local, &'a [f64], &'a mut [f64]);

impl WithSimd for StepsOfChunk<'_> {
    type Output = LeafSteps;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> LeafSteps {
        self.0.steps_of_chunk(self.1, self.2, self.3, self.4, self.5)
    }
}

/// The reduced system, to be added to.
pub(super) struct Reduced<'a> {
    pub values: &'a mut [f64],
    pub gradient: &'a mut [f64],
    pub raw_gradient: &'a mut [f64],
    pub diagonal: &'a mut [f64],
}

/// Cuts leaves into chunks of like work: pairs of measurements, and measurements.
fn cut(starts: &[usize], count: usize) -> Vec<Range<usize>> {
    let work = |leaf: usize| {
        let measurements = (starts[leaf + 1] - starts[leaf]) as f64;
        measurements * (measurements + 8.0)
    };
    let leaves = starts.len() - 1;
    let total: f64 = (0..leaves).map(work).sum();
    let mut chunks = Vec::with_capacity(count);
    let (mut first, mut done) = (0, 0.0);
    for leaf in 0..leaves {
        done += work(leaf);
        if done >= total * (chunks.len() + 1) as f64 / count as f64 || leaf + 1 == leaves {
            chunks.push(first..leaf + 1);
            first = leaf + 1;
        }
    }
    chunks
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chunks_cover_all_leaves_in_order() {
        let starts = [0, 2, 4, 40, 41, 44, 47];
        for count in 1..8 {
            let chunks = cut(&starts, count);
            assert!(chunks.len() <= count + 1 && !chunks.iter().any(Range::is_empty), "{chunks:?}");
            let all: Vec<usize> = chunks.iter().cloned().flatten().collect();
            assert_eq!(all, (0..6).collect::<Vec<_>>());
        }
        assert!(cut(&[0], 3).is_empty());
    }
}
