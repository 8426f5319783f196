//! Elimination of frames: poses along time first, then one dense system of shapes.
//!
//! An image point of a body sees the pose of its observer and that of the body only as they lie to each
//! other. With `A` the motion of the body that looks like one of the observer, the unknowns of a frame
//! are taken as
//!
//! ```text
//! c   perturbation of the observer
//! y   = v + A c,   v that of the body:   what an image point sees
//! ```
//!
//! so that image points couple `y` and shape alone, with 18 numbers each, and never `c`. Everything else
//! (starting poses, motion, contact, targets) is assembled in `c` and `v` as ever and turned by
//! `T = [1 0; -A 1]`. What is left is a [`Chain`] along time with the shape as its border:
//!
//! ```text
//!    frames            shape  rest
//!  [ T' H T + Hyy    |  W   |  V  ]        rest: targets and what all frames share
//!  [ W'              |  B   |     ]
//!  [ V'              |      |  C  ]
//! ```

use super::group::AnyGroup;
use super::leaves::Local;
use super::{Block, BlockId, Curvature, Normal, System, Values};
use crate::nlls::linear::chain::Chain;
use crate::nlls::linear::cholesky::{DenseCholesky, Singular, TooLarge};
use crate::nlls::linear::matrix::Pattern;
use crate::nlls::manifold::{Manifold, body_from_observer_motion, read_pose};
use nalgebra::{DMatrix, DMatrixView, Matrix6, Vector6};
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

/// A pose.
const POSE: usize = 6;
/// A point of a shape.
const POINT: usize = 3;
/// Steps that one task linearises.
const CHUNKS: usize = 8;
/// The most steps that one measurement may span.
const MOST_BAND: usize = 4;
/// Operations beyond which a dense system of all shapes is not worth it.
const MOST_FLOPS: f64 = 5e11;

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
enum Place {
    /// In the chain: step, and first scalar in it, in the order c, v.
    Chain(usize, usize),
    /// In the border.
    Border(usize),
}

/// The structure: which unknown is where, and which image points each body has in each step.
pub(super) struct Frames {
    steps: Vec<Step>,
    /// Unknowns `(c, y)` of each step.
    dims: Vec<(usize, usize)>,
    band: usize,
    places: Vec<Place>,
    /// The same for every scalar of the pattern.
    scalars: Vec<Place>,
    /// First `y` of each step, and their number at the end.
    y_starts: Vec<usize>,
    /// Scalars of the border: those that image points see, and all.
    shape: usize,
    border: usize,
    chunks: Vec<std::ops::Range<usize>>,
    /// Operations of one elimination.
    pub flops: f64,
}

struct Step {
    /// Block of the observer, and whether it is free.
    observer: Option<(usize, bool)>,
    /// Block of each body and its image points.
    bodies: Vec<(usize, Vec<(u32, u32)>)>,
}

/// The image points of a linearisation.
pub(super) struct FramesLinear {
    /// For each body of each step, in order: `Hyy`, its gradient, and the motion `A`.
    bodies: Vec<(Matrix6<f64>, Vector6<f64>, Matrix6<f64>)>,
    /// `W^T`: the border's rows of shape, one column for each `y`.
    coupling: Vec<f64>,
    /// For each chunk the shape's diagonal blocks (9 numbers each) and gradient.
    sums: Vec<(Vec<f64>, Vec<f64>)>,
    locals: Vec<Local>,
}

impl Frames {
    /// `None` where the structure is another: a pose is held in part, say.
    pub fn new(
        steps: &[TimeStep],
        relative: &[usize],
        blocks: &[Block],
        groups: &[Box<dyn AnyGroup>],
        position: &[Option<usize>],
        pattern: &Pattern,
    ) -> Option<Frames> {
        let mut at_step = vec![None; blocks.len()];
        let mut found: Vec<Step> = Vec::new();
        for (at, step) in steps.iter().enumerate() {
            let all = |b: &BlockId, free: bool| blocks[b.0].free().iter().all(|f| *f == free);
            let is_seen = |b: &&BlockId| position[b.0].is_some();
            if !step.bodies.iter().filter(is_seen).all(|b| all(b, true)) {
                return None;
            }
            let observer = match &step.observer {
                Some(b) if all(b, true) || all(b, false) => Some((b.0, position[b.0].is_some())),
                Some(_) => return None,
                None => None,
            };
            let bodies: Vec<(usize, Vec<(u32, u32)>)> =
                step.bodies.iter().filter(is_seen).map(|b| (b.0, Vec::new())).collect();
            for block in observer.iter().filter(|o| o.1).map(|o| o.0).chain(bodies.iter().map(|b| b.0)) {
                at_step[block] = Some(at);
            }
            found.push(Step { observer, bodies });
        }
        let mut is_shape = vec![false; blocks.len()];
        let mut is_rest = vec![false; blocks.len()];
        let mut band = 0;
        for (index, group) in groups.iter().enumerate() {
            for item in 0..group.len() {
                let seen = group.blocks(item);
                if relative.contains(&index) {
                    let [observer, body, point] = seen else { return None };
                    let at = at_step[body.0]?;
                    if found[at].observer.map(|o| o.0) != Some(observer.0) {
                        return None;
                    }
                    let bodies = &mut found[at].bodies;
                    let own = bodies.iter_mut().find(|b| b.0 == body.0)?;
                    own.1.push((index as u32, item as u32));
                    is_shape[point.0] |= position[point.0].is_some();
                    continue;
                }
                let times: Vec<usize> = seen.iter().filter_map(|b| at_step[b.0]).collect();
                if let (Some(first), Some(last)) = (times.iter().min(), times.iter().max()) {
                    band = band.max(last - first);
                    for b in seen.iter().filter(|b| at_step[b.0].is_none()) {
                        is_rest[b.0] = position[b.0].is_some();
                    }
                }
            }
        }
        let is_point = |b: usize| blocks[b].manifold == Manifold::POINT;
        if band > MOST_BAND || (0..blocks.len()).any(|b| is_shape[b] && (is_rest[b] || !is_point(b))) {
            return None;
        }
        let dims: Vec<(usize, usize)> = found
            .iter()
            .map(|s| (if s.observer.is_some_and(|o| o.1) { POSE } else { 0 }, POSE * s.bodies.len()))
            .collect();
        let mut places = vec![Place::Border(0); pattern.rows().len()];
        for (at, step) in found.iter().enumerate() {
            let free = step.observer.iter().filter(|o| o.1).map(|o| o.0);
            for (order, block) in free.chain(step.bodies.iter().map(|b| b.0)).enumerate() {
                places[position[block]?] = Place::Chain(at, POSE * order);
            }
        }
        let mut border = 0;
        let mut shape = 0;
        for of_shape in [true, false] {
            for block in 0..blocks.len() {
                let Some(p) = position[block] else { continue };
                if at_step[block].is_none() && is_shape[block] == of_shape {
                    places[p] = Place::Border(border);
                    border += pattern.range(p).len();
                }
            }
            if of_shape {
                shape = border;
            }
        }
        let scalars = places.iter().enumerate().flat_map(|(position, place)| {
            (0..pattern.range(position).len()).map(move |inner| match *place {
                Place::Chain(step, at) => Place::Chain(step, at + inner),
                Place::Border(at) => Place::Border(at + inner),
            })
        });
        let scalars = scalars.collect();
        let mut y_starts = vec![0];
        dims.iter().for_each(|(_, y)| y_starts.push(y_starts[y_starts.len() - 1] + y));
        let (m, ys) = (border as f64, y_starts[y_starts.len() - 1] as f64);
        let flops = ys * (shape as f64).powi(2) + m.powi(3) / 3.0;
        if flops > MOST_FLOPS {
            return None;
        }
        let count = found.len();
        let size = count.div_ceil(CHUNKS).max(1);
        let chunks = (0..count).step_by(size).map(|first| first..(first + size).min(count)).collect();
        Some(Frames { steps: found, dims, band, places, scalars, y_starts, shape, border, chunks, flops })
    }

    /// Room for a linearisation.
    pub fn linear(&self) -> FramesLinear {
        let bodies = self.steps.iter().map(|s| s.bodies.len()).sum();
        let sums = (vec![0.0; self.shape * POINT], vec![0.0; self.shape]);
        FramesLinear {
            bodies: vec![(Matrix6::zeros(), Vector6::zeros(), Matrix6::zeros()); bodies],
            coupling: vec![0.0; self.shape * self.y_starts[self.steps.len()]],
            sums: vec![sums; self.chunks.len()],
            locals: vec![Local::default(); self.chunks.len()],
        }
    }

    /// Linearises the image points, and adds them to gradient and diagonal.
    pub fn linearise(
        &self,
        system: &System,
        values: &Values,
        curvature: Curvature,
        linear: &mut FramesLinear,
        gradient: &mut [f64],
        diagonal: &mut [f64],
    ) {
        let FramesLinear { bodies, coupling, sums, locals } = linear;
        let mut tasks = Vec::with_capacity(self.chunks.len());
        let (mut bodies_left, mut coupling_left) = (bodies.as_mut_slice(), coupling.as_mut_slice());
        for ((chunk, sums), local) in self.chunks.iter().zip(sums).zip(locals) {
            let count: usize = self.steps[chunk.clone()].iter().map(|s| s.bodies.len()).sum();
            let (own_bodies, rest) = bodies_left.split_at_mut(count);
            bodies_left = rest;
            let (own_coupling, rest) = coupling_left.split_at_mut(self.shape * POSE * count);
            coupling_left = rest;
            tasks.push(Task {
                frames: self,
                system,
                values,
                curvature,
                chunk: chunk.clone(),
                bodies: own_bodies,
                coupling: own_coupling,
                sums,
                local,
            });
        }
        tasks.into_par_iter().for_each(|task| Arch::new().dispatch(task));
        let mut body = linear.bodies.iter();
        for step in &self.steps {
            for (block, _) in &step.bodies {
                let (h, g, a) = body.next().expect("one for each body");
                let mut add = |block: usize, g: Vector6<f64>, d: Vector6<f64>| {
                    let start = system.step_start[block].expect("free");
                    for i in 0..POSE {
                        gradient[start + i] += g[i];
                        diagonal[start + i] += d[i];
                    }
                };
                add(*block, *g, h.diagonal());
                if let Some((observer, true)) = step.observer {
                    add(observer, a.transpose() * g, (a.transpose() * h * a).diagonal());
                }
            }
        }
        for (position, place) in self.places.iter().enumerate() {
            let Place::Border(at) = *place else { continue };
            if at < self.shape {
                let start = system.pattern.range(position).start;
                for (diagonal_blocks, of_points) in &linear.sums {
                    for i in 0..POINT {
                        gradient[start + i] += of_points[at + i];
                        diagonal[start + i] += diagonal_blocks[POINT * at + i * POINT + i];
                    }
                }
            }
        }
    }
}

/// The image points of some steps.
struct Task<'a> {
    frames: &'a Frames,
    system: &'a System,
    values: &'a Values,
    curvature: Curvature,
    chunk: std::ops::Range<usize>,
    bodies: &'a mut [(Matrix6<f64>, Vector6<f64>, Matrix6<f64>)],
    coupling: &'a mut [f64],
    sums: &'a mut (Vec<f64>, Vec<f64>),
    local: &'a mut Local,
}

impl WithSimd for Task<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Task { frames, system, values, curvature, chunk, bodies, coupling, sums, local } = self;
        coupling.fill(0.0);
        sums.0.fill(0.0);
        sums.1.fill(0.0);
        let m = frames.shape;
        let mut columns = coupling.chunks_exact_mut(m * POSE);
        let mut bodies = bodies.iter_mut();
        for step in &frames.steps[chunk] {
            for (body, items) in &step.bodies {
                let mut none = [];
                let w = if m > 0 { columns.next().expect("six columns a body") } else { &mut none[..] };
                let mut h = [[0.0; POSE]; POSE];
                let mut g = [0.0; POSE];
                local.clear();
                let mut left = items.as_slice();
                while let Some(&(group, _)) = left.first() {
                    let end = left.iter().position(|item| item.0 != group).unwrap_or(left.len());
                    let least = curvature.least_flatness;
                    system.groups[group as usize].linearise_leaf(
                        &left[..end],
                        *body,
                        system,
                        values,
                        least,
                        local,
                    );
                    left = &left[end..];
                }
                for entry in &local.entries {
                    let point =
                        local.parts[entry.parts.0..entry.parts.1].iter().find_map(|part| {
                            match frames.places[part.position] {
                                Place::Border(at) => Some((at, part.column)),
                                Place::Chain(..) => None,
                            }
                        });
                    for row in 0..entry.rows {
                        let v: &[f64; POSE] =
                            local.leaf.as_chunks::<POSE>().0[entry.row + row..].first().expect("a row");
                        let r = local.residuals[entry.row + row];
                        for i in 0..POSE {
                            g[i] += v[i] * r;
                            for j in 0..POSE {
                                h[i][j] += v[i] * v[j];
                            }
                        }
                        let Some((at, column)) = point else { continue };
                        let p: [f64; POINT] = std::array::from_fn(|i| {
                            local.other[entry.other + row * entry.width + column + i]
                        });
                        for k in 0..POSE {
                            let out = &mut w[k * m + at..][..POINT];
                            for i in 0..POINT {
                                out[i] += v[k] * p[i];
                            }
                        }
                        let own = &mut sums.0[POINT * at..][..POINT * POINT];
                        for i in 0..POINT {
                            for j in 0..POINT {
                                own[i * POINT + j] += p[i] * p[j];
                            }
                        }
                        for i in 0..POINT {
                            sums.1[at + i] += p[i] * r;
                        }
                    }
                }
                let out = bodies.next().expect("one for each body");
                out.0 = Matrix6::from_fn(|i, j| h[i][j]);
                out.1 = Vector6::from(g);
                let pose = |block: usize| read_pose(system.value(values, BlockId(block)));
                out.2 = step.observer.map_or(Matrix6::zeros(), |(observer, _)| {
                    body_from_observer_motion(&pose(observer), &pose(*body))
                });
            }
        }
    }
}

/// The factors of a damped system.
pub struct FramesFactor {
    chain: Chain,
    border: DenseCholesky,
    /// `V` and `H^-1 V`.
    rest: [DMatrix<f64>; 2],
    /// What was added to the diagonal.
    extra: Vec<f64>,
}

impl FramesFactor {
    pub(super) fn new(frames: &Frames) -> Result<Self, TooLarge> {
        let chain = Chain::new(frames.dims.clone(), frames.band);
        let (n, r) = (chain.size(), frames.border - frames.shape);
        let border = DenseCholesky::new(frames.border, frames.flops)?;
        Ok(FramesFactor {
            chain,
            border,
            rest: [DMatrix::zeros(n, r), DMatrix::zeros(n, r)],
            extra: Vec::new(),
        })
    }

    /// Factorises the normal matrix with `extra` on its diagonal.
    pub(super) fn factorise(
        &mut self,
        frames: &Frames,
        normal: &Normal,
        extra: &[f64],
    ) -> Result<(), Singular> {
        let linear = normal.frames.as_ref().expect("linearised by frames");
        self.extra = extra.to_vec();
        let FramesFactor { chain, border, rest: [rest, solved], .. } = self;
        chain.clear();
        rest.fill(0.0);
        border.matrix_mut().fill(0.0);
        normal.matrix.for_each_entry(|row, column, value| {
            let (i, j) = (frames.scalars[row], frames.scalars[column]);
            let value = value + if row == column { extra[row] } else { 0.0 };
            match (i, j) {
                (Place::Chain(s, i), Place::Chain(t, j)) => {
                    let (s, i, t, j) = if s >= t { (s, i, t, j) } else { (t, j, s, i) };
                    let block = chain.block_mut(t, s - t);
                    block[(i, j)] = value;
                    if s == t {
                        block[(j, i)] = value;
                    }
                }
                (Place::Border(i), Place::Border(j)) => {
                    border.matrix_mut()[(i.max(j), i.min(j))] = value;
                }
                (Place::Chain(t, i), Place::Border(j)) | (Place::Border(j), Place::Chain(t, i)) => {
                    rest[(chain.start(t) + i, j - frames.shape)] = value;
                }
            }
        });
        // Into c, y; and the image points.
        let turns = frames.turns(linear);
        let mut body = linear.bodies.iter();
        for t in 0..frames.steps.len() {
            for k in 0..=frames.band.min(frames.steps.len() - 1 - t) {
                let block = chain.block_mut(t, k);
                *block = turns[t + k].transpose() * &*block * &turns[t];
            }
            let (c, _) = frames.dims[t];
            let diagonal = chain.block_mut(t, 0);
            for i in 0..frames.steps[t].bodies.len() {
                let (h, ..) = body.next().expect("one for each body");
                let mut own = diagonal.fixed_view_mut::<POSE, POSE>(c + POSE * i, c + POSE * i);
                own += h;
            }
            let range = (chain.start(t), turns[t].nrows());
            let turned = turns[t].transpose() * rest.rows(range.0, range.1);
            rest.rows_mut(range.0, range.1).copy_from(&turned);
        }
        for (blocks, _) in &linear.sums {
            for at in (0..frames.shape).step_by(POINT) {
                for i in 0..POINT {
                    for j in 0..=i {
                        border.matrix_mut()[(at + i, at + j)] += blocks[POINT * at + i * POINT + j];
                    }
                }
            }
        }
        chain.factorise()?;
        solved.copy_from(rest);
        chain.solve(solved);
        let (m, r) = (frames.shape, frames.border - frames.shape);
        if r > 0 {
            let below = frames.coupling_times(linear, chain, solved);
            let matrix = border.matrix_mut();
            for i in 0..r {
                for j in 0..m {
                    matrix[(m + i, j)] -= below[(j, i)];
                }
            }
            let own = rest.transpose() * &*solved;
            for i in 0..r {
                for j in 0..=i {
                    matrix[(m + i, m + j)] -= own[(i, j)];
                }
            }
        }
        border.install(|matrix, threads| chain.reduce(&linear.coupling, m, matrix, threads));
        border.factorise()
    }

    /// Solves for right-hand sides in the order of the pattern, in place. What the change of variables
    /// cancels in a right-hand side is made good by one refinement.
    pub(super) fn solve(&mut self, frames: &Frames, normal: &Normal, b: &mut [f64]) {
        let mut x = b.to_vec();
        self.solve_once(frames, normal, &mut x);
        let n = normal.matrix.size().max(1);
        for (x, b) in x.chunks_exact(n).zip(b.chunks_exact_mut(n)) {
            let product = frames.multiply(normal, &self.extra, x);
            b.iter_mut().zip(product).for_each(|(b, p)| *b -= p);
        }
        self.solve_once(frames, normal, b);
        b.iter_mut().zip(x).for_each(|(b, x)| *b += x);
    }

    fn solve_once(&mut self, frames: &Frames, normal: &Normal, b: &mut [f64]) {
        let linear = normal.frames.as_ref().expect("linearised by frames");
        let n = normal.matrix.size();
        let turns = frames.turns(linear);
        let sides = b.len() / n.max(1);
        let FramesFactor { chain, border, rest: [rest, solved], .. } = self;
        let mut x = DMatrix::zeros(chain.size(), sides);
        let mut s = DMatrix::zeros(frames.border, sides);
        for (side, b) in b.chunks_exact(n).enumerate() {
            for (index, value) in b.iter().enumerate() {
                match frames.scalars[index] {
                    Place::Chain(t, i) => x[(chain.start(t) + i, side)] = *value,
                    Place::Border(i) => s[(i, side)] = *value,
                }
            }
        }
        for (t, turn) in turns.iter().enumerate() {
            let turned = turn.transpose() * x.rows(chain.start(t), turn.nrows());
            x.rows_mut(chain.start(t), turn.nrows()).copy_from(&turned);
        }
        chain.solve(&mut x);
        let (m, r) = (frames.shape, frames.border - frames.shape);
        let seen = frames.coupling_times(linear, chain, &x);
        let mut of_shape = s.rows_mut(0, m);
        of_shape -= seen;
        let mut of_rest = s.rows_mut(m, r);
        of_rest -= rest.transpose() * &x;
        border.solve(&mut s);
        let mut back = frames.coupling_transposed_times(linear, chain, &s);
        chain.solve(&mut back);
        x -= back;
        x -= &*solved * s.rows(m, r);
        for (t, turn) in turns.iter().enumerate() {
            let turned = turn * x.rows(chain.start(t), turn.nrows());
            x.rows_mut(chain.start(t), turn.nrows()).copy_from(&turned);
        }
        for (side, b) in b.chunks_exact_mut(n).enumerate() {
            for (index, value) in b.iter_mut().enumerate() {
                *value = match frames.scalars[index] {
                    Place::Chain(t, i) => x[(chain.start(t) + i, side)],
                    Place::Border(i) => s[(i, side)],
                };
            }
        }
    }
}

impl Frames {
    /// `T` of each step: `(c, v)` from `(c, y)`.
    fn turns(&self, linear: &FramesLinear) -> Vec<DMatrix<f64>> {
        let mut body = linear.bodies.iter();
        let turn = |(step, &(c, y)): (&Step, &(usize, usize))| {
            let mut turn = DMatrix::identity(c + y, c + y);
            for i in 0..step.bodies.len() {
                let (.., a) = body.next().expect("one for each body");
                if c > 0 {
                    turn.fixed_view_mut::<POSE, POSE>(c + POSE * i, 0).copy_from(&-a);
                }
            }
            turn
        };
        self.steps.iter().zip(&self.dims).map(turn).collect()
    }

    /// The normal matrix with `extra` on its diagonal, times `x`, in the order of the pattern.
    fn multiply(&self, normal: &Normal, extra: &[f64], x: &[f64]) -> Vec<f64> {
        let linear = normal.frames.as_ref().expect("linearised by frames");
        let mut product = normal.matrix.multiply(x);
        product.iter_mut().zip(extra).zip(x).for_each(|((p, e), x)| *p += e * x);
        let mut shape = DMatrix::zeros(self.shape, 1);
        for (position, place) in self.places.iter().enumerate() {
            if let Place::Border(at) = *place
                && at < self.shape
            {
                let start = normal.matrix.range(position).start;
                shape.rows_mut(at, POINT).copy_from_slice(&x[start..start + POINT]);
            }
        }
        // Where the blocks of each step stand in the pattern, in the order c, v.
        let mut starts: Vec<Vec<usize>> = self.steps.iter().map(|s| vec![0; s.bodies.len() + 1]).collect();
        for (position, place) in self.places.iter().enumerate() {
            if let Place::Chain(t, at) = *place {
                let order = at / POSE + usize::from(self.dims[t].0 == 0);
                starts[t][order] = normal.matrix.range(position).start;
            }
        }
        let read = |start: usize| Vector6::from_column_slice(&x[start..start + POSE]);
        let mut y = DMatrix::zeros(self.y_starts[self.steps.len()], 1);
        let seen_by_frames = self.coupling(linear).tr_mul(&shape);
        let mut body = linear.bodies.iter();
        for (t, starts) in starts.iter().enumerate() {
            for i in 0..self.steps[t].bodies.len() {
                let (h, _, a) = body.next().expect("one for each body");
                let has_observer = self.dims[t].0 > 0;
                let mut of_y = read(starts[1 + i]);
                if has_observer {
                    of_y += a * read(starts[0]);
                }
                let at = self.y_starts[t] + POSE * i;
                y.rows_mut(at, POSE).copy_from(&of_y);
                let force = h * of_y + seen_by_frames.fixed_view::<POSE, 1>(at, 0);
                for (k, f) in force.iter().enumerate() {
                    product[starts[1 + i] + k] += f;
                }
                if has_observer {
                    for (k, f) in (a.transpose() * force).iter().enumerate() {
                        product[starts[0] + k] += f;
                    }
                }
            }
        }
        let mut of_shape = self.coupling(linear) * y;
        for (blocks, _) in &linear.sums {
            for at in (0..self.shape).step_by(POINT) {
                for i in 0..POINT {
                    for j in 0..POINT {
                        of_shape[at + i] += blocks[POINT * at + i * POINT + j] * shape[at + j];
                    }
                }
            }
        }
        for (position, place) in self.places.iter().enumerate() {
            if let Place::Border(at) = *place
                && at < self.shape
            {
                let start = normal.matrix.range(position).start;
                for i in 0..POINT {
                    product[start + i] += of_shape[at + i];
                }
            }
        }
        product
    }

    /// `W^T`.
    fn coupling<'a>(&self, linear: &'a FramesLinear) -> DMatrixView<'a, f64> {
        DMatrixView::from_slice(&linear.coupling, self.shape, self.y_starts[self.steps.len()])
    }

    /// `W^T x`.
    fn coupling_times(&self, linear: &FramesLinear, chain: &Chain, x: &DMatrix<f64>) -> DMatrix<f64> {
        let mut of_y = DMatrix::zeros(self.y_starts[self.steps.len()], x.ncols());
        for (t, &(c, y)) in self.dims.iter().enumerate() {
            of_y.rows_mut(self.y_starts[t], y).copy_from(&x.rows(chain.start(t) + c, y));
        }
        self.coupling(linear) * of_y
    }

    /// `W s`, zero in all `c`.
    fn coupling_transposed_times(
        &self,
        linear: &FramesLinear,
        chain: &Chain,
        s: &DMatrix<f64>,
    ) -> DMatrix<f64> {
        let of_y = self.coupling(linear).tr_mul(&s.rows(0, self.shape));
        let mut product = DMatrix::zeros(chain.size(), s.ncols());
        for (t, &(c, y)) in self.dims.iter().enumerate() {
            product.rows_mut(chain.start(t) + c, y).copy_from(&of_y.rows(self.y_starts[t], y));
        }
        product
    }
}
