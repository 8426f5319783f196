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
//!
//! This module has the structure and the linearisation. There are two ways on from there: all bodies
//! [together](super::together), and many bodies [apart](super::apart); the one that takes fewer operations
//! is taken.

use super::apart::{self, ApartFactor};
use super::group::AnyGroup;
use super::selected::{Leverage, SelectedFrames};
use super::together::TogetherFactor;
use super::{Block, BlockId, Curvature, Normal, System, Values};
use crate::linear::cholesky::{Singular, TooLarge};
use crate::linear::coupling::{Coupling, CouplingBlock, CouplingPattern};
use crate::linear::matrix::Pattern;
use crate::linear::small::{POINT, POSE};
use crate::manifold::{Manifold, body_from_observer_motion, read_pose};
use nalgebra::{DMatrix, Matrix6, Vector6};
use rayon::prelude::*;
use std::fmt;
use std::str::FromStr;
use std::sync::Arc;

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

/// How bodies are eliminated after the poses of a frame have been turned.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Arrangement {
    /// What takes fewer operations.
    #[default]
    Cheapest,
    /// All poses along time, which leaves one dense system of all shapes.
    Together,
    /// Each body with its shape, which leaves the observers and what all share.
    Apart,
}

impl Arrangement {
    const ALL: [(&str, Arrangement); 3] = [
        ("cheapest", Arrangement::Cheapest),
        ("together", Arrangement::Together),
        ("apart", Arrangement::Apart),
    ];
}

impl fmt::Display for Arrangement {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let found = Arrangement::ALL.iter().find(|(_, arrangement)| arrangement == self);
        f.write_str(found.expect("all have names").0)
    }
}

impl FromStr for Arrangement {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        let found = Arrangement::ALL.iter().find(|(name, _)| *name == text);
        found.map(|found| found.1).ok_or_else(|| "wanted cheapest, together or apart".to_owned())
    }
}

/// Where a block of the pattern is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Place {
    /// In the chain: step, and first scalar in it, in the order c, v.
    Chain(usize, usize),
    /// In the border.
    Border(usize),
}

/// The structure: which unknown is where, and which image points each body has in each step.
pub(super) struct Frames {
    pub steps: Vec<Step>,
    /// Unknowns `(c, y)` of each step.
    pub dims: Vec<(usize, usize)>,
    pub band: usize,
    /// How many steps apart poses may be of whom the covariance is wanted.
    pub reach: usize,
    pub places: Vec<Place>,
    /// The same for every scalar of the pattern.
    pub scalars: Vec<Place>,
    /// First `y` of each step, and their number at the end.
    pub y_starts: Vec<usize>,
    /// Scalars of the border: those that image points see, and all.
    pub shape: usize,
    pub border: usize,
    /// Where the coupling of shapes is kept: one for all bodies, or one for each.
    pub homes: Vec<Home>,
    /// The bodies, where they are eliminated apart.
    pub apart: Option<Vec<apart::Body>>,
    chunks: Vec<std::ops::Range<usize>>,
    /// Operations of one elimination.
    pub flops: f64,
}

/// Some bodies: their rows of the border, and which of their points their poses see, in time order.
#[derive(Clone, Debug)]
pub(super) struct Home {
    pub rows: std::ops::Range<usize>,
    pub coupling: Arc<CouplingPattern>,
}

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

/// The image points of a linearisation.
pub(super) struct FramesLinear {
    /// For each body of each step, in order: `Hyy`, its gradient, and the motion `A`.
    pub bodies: Vec<(Matrix6<f64>, Vector6<f64>, Matrix6<f64>)>,
    /// `W` of each home.
    pub coupling: Vec<Coupling>,
    /// For each chunk the shape's diagonal blocks (9 numbers each) and gradient.
    pub sums: Vec<(Vec<f64>, Vec<f64>)>,
}

impl Frames {
    /// `None` where the structure is another: a pose is held in part, say.
    pub fn new(
        (steps, relative, reach): (&[TimeStep], &[usize], usize),
        wanted: Arrangement,
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
            let body = |b: &BlockId| BodyAtStep { block: b.0, items: Vec::new(), home: 0 };
            let bodies: Vec<BodyAtStep> = step.bodies.iter().filter(is_seen).map(body).collect();
            for block in observer.iter().filter(|o| o.1).map(|o| o.0).chain(bodies.iter().map(|b| b.block)) {
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
                    // What else it sees is common to all, or held.
                    let [observer, body, point, common @ ..] = seen else { return None };
                    if common.iter().any(|b| position[b.0].is_some()) {
                        return None;
                    }
                    let at = at_step[body.0]?;
                    if found[at].observer.map(|o| o.0) != Some(observer.0) {
                        return None;
                    }
                    let bodies = &mut found[at].bodies;
                    let own = bodies.iter_mut().find(|b| b.block == body.0)?;
                    own.items.push((index as u32, item as u32));
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
            for (order, block) in free.chain(step.bodies.iter().map(|b| b.block)).enumerate() {
                places[position[block]?] = Place::Chain(at, POSE * order);
            }
        }
        // The points of a body stand together, then what is no shape.
        let of_body = apart::components(&found, relative, groups, &at_step, blocks.len());
        let mut of_position = vec![0; pattern.rows().len()];
        for block in 0..blocks.len() {
            position[block].into_iter().for_each(|p| of_position[p] = of_body[block]);
        }
        let mut in_border: Vec<usize> = (0..blocks.len())
            .filter(|&block| position[block].is_some() && at_step[block].is_none())
            .collect();
        in_border.sort_by_key(|&block| (!is_shape[block], if is_shape[block] { of_body[block] } else { 0 }));
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
        let together = ys * (shape as f64).powi(2) + m.powi(3) / 3.0;
        let count = found.len();
        let size = count.div_ceil(CHUNKS).max(1);
        let chunks = (0..count).step_by(size).map(|first| first..(first + size).min(count)).collect();
        let mut frames = Frames {
            steps: found,
            dims,
            band,
            reach,
            places,
            scalars,
            y_starts,
            shape,
            border,
            homes: Vec::new(),
            apart: None,
            chunks,
            flops: together,
        };
        let bodies = match wanted {
            Arrangement::Together => None,
            _ => apart::bodies(&frames, pattern, &of_body, &of_position),
        };
        match bodies {
            Some((bodies, flops)) if wanted == Arrangement::Apart || flops < together => {
                for (home, body) in bodies.iter().enumerate() {
                    for &(step, order) in &body.places {
                        frames.steps[step].bodies[order].home = home;
                    }
                }
                let rows = bodies.iter().map(|body| body.shape.clone()).collect();
                frames.apart = Some(bodies);
                frames.flops = flops;
                frames.set_homes(rows, groups, position);
            }
            _ if together > MOST_FLOPS => return None,
            _ => frames.set_homes(std::iter::once(0..shape).collect(), groups, position),
        }
        Some(frames)
    }

    fn set_homes(
        &mut self,
        rows: Vec<std::ops::Range<usize>>,
        groups: &[Box<dyn AnyGroup>],
        position: &[Option<usize>],
    ) {
        let mut seen: Vec<Vec<Vec<u32>>> = vec![Vec::new(); rows.len()];
        for body in self.steps.iter().flat_map(|step| &step.bodies) {
            let of_item = |&(group, item): &(u32, u32)| {
                let point = groups[group as usize].blocks(item as usize)[2];
                match self.places[position[point.0]?] {
                    Place::Border(at) => Some((at - rows[body.home].start) as u32),
                    Place::Chain(..) => None,
                }
            };
            seen[body.home].push(body.items.iter().filter_map(of_item).collect());
        }
        let home = |(rows, seen): (std::ops::Range<usize>, Vec<Vec<u32>>)| Home {
            coupling: Arc::new(CouplingPattern::new(rows.len(), seen)),
            rows,
        };
        self.homes = rows.into_iter().zip(seen).map(home).collect();
    }

    /// Room for a linearisation.
    pub fn linear(&self) -> FramesLinear {
        let bodies = self.steps.iter().map(|s| s.bodies.len()).sum();
        let sums = (vec![0.0; self.shape * POINT], vec![0.0; self.shape]);
        FramesLinear {
            bodies: vec![(Matrix6::zeros(), Vector6::zeros(), Matrix6::zeros()); bodies],
            coupling: self.homes.iter().map(|home| Coupling::zeros(home.coupling.clone())).collect(),
            sums: vec![sums; self.chunks.len()],
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
        let FramesLinear { bodies, coupling, sums } = linear;
        let mut tasks = Vec::with_capacity(self.chunks.len());
        let mut bodies_left = bodies.as_mut_slice();
        let mut coupling_left: Vec<&mut [CouplingBlock]> =
            coupling.iter_mut().map(Coupling::blocks_mut).collect();
        let mut next_pose = vec![0; self.homes.len()];
        for (chunk, sums) in self.chunks.iter().zip(sums) {
            let of_chunk = || self.steps[chunk.clone()].iter().flat_map(|s| &s.bodies);
            let own_bodies = bodies_left.split_off_mut(..of_chunk().count()).expect("one for each body");
            let first_pose = next_pose.clone();
            of_chunk().for_each(|body| next_pose[body.home] += 1);
            let own_coupling = self
                .homes
                .iter()
                .zip(&mut coupling_left)
                .zip(first_pose.iter().zip(&next_pose))
                .map(|((home, left), (first, next))| {
                    let count = (*first..*next).map(|pose| home.coupling.points(pose).len()).sum();
                    left.split_off_mut(..count).expect("blocks for each pose")
                })
                .collect();
            tasks.push(Task {
                frames: self,
                system,
                values,
                curvature,
                chunk: chunk.clone(),
                bodies: own_bodies,
                coupling: own_coupling,
                next_pose: first_pose,
                sums,
            });
        }
        tasks.into_par_iter().for_each(Task::run);
        let mut body = linear.bodies.iter();
        for step in &self.steps {
            for BodyAtStep { block, .. } in &step.bodies {
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
    /// What is left of each home, and the pose that comes next.
    coupling: Vec<&'a mut [CouplingBlock]>,
    next_pose: Vec<usize>,
    sums: &'a mut (Vec<f64>, Vec<f64>),
}

impl Task<'_> {
    fn run(self) {
        let Task { frames, system, values, curvature, chunk, bodies, mut coupling, mut next_pose, sums } =
            self;
        let (own, gradient) = sums;
        own.fill(0.0);
        gradient.fill(0.0);
        let mut bodies = bodies.iter_mut();
        for step in &frames.steps[chunk] {
            for BodyAtStep { block: body, items, home } in &step.bodies {
                let Home { rows, coupling: pattern } = &frames.homes[*home];
                let points = pattern.points(next_pose[*home]);
                next_pose[*home] += 1;
                let mut moment = Moment {
                    by_pose: [[0.0; POSE]; POSE],
                    of_pose: [0.0; POSE],
                    points,
                    coupling: coupling[*home].split_off_mut(..points.len()).expect("a block for each point"),
                    by_point: &mut own[POINT * rows.start..POINT * rows.end],
                    of_point: &mut gradient[rows.clone()],
                };
                for items in items.chunk_by(|a, b| a.0 == b.0) {
                    let group = &system.groups[items[0].0 as usize];
                    group.add_to_moment(items, system, values, curvature.least_flatness, &mut moment);
                }
                let h = moment.by_pose;
                let out = bodies.next().expect("one for each body");
                out.0 = Matrix6::from_fn(|i, j| h[i.max(j)][i.min(j)]);
                out.1 = Vector6::from(moment.of_pose);
                let pose = |block: usize| read_pose(system.value(values, BlockId(block)));
                out.2 = step.observer.map_or(Matrix6::zeros(), |(observer, _)| {
                    body_from_observer_motion(&pose(observer), &pose(*body))
                });
            }
        }
    }
}

/// What the image points of a body at a moment add up to.
pub(super) struct Moment<'a> {
    /// `J^T J` by the pose as it is seen, lower triangle, and `J^T r`.
    pub by_pose: [[f64; POSE]; POSE],
    pub of_pose: [f64; POSE],
    /// First numbers of the points that are yet to come, of those that are adjusted, and their blocks of the
    /// coupling.
    pub points: &'a [u32],
    pub coupling: &'a mut [CouplingBlock],
    /// `J^T J` of each point by itself, row after row, and `J^T r`.
    pub by_point: &'a mut [f64],
    pub of_point: &'a mut [f64],
}

/// How well a system is solved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Accuracy {
    /// To rounding.
    Exact,
    /// Where it is solved by iterations, until the residual is this share of the right-hand side; without
    /// a refinement in any case.
    Share(f64),
}

/// Residual, as a share of the right-hand side, at which iterations end: at first, and in the refinement.
const EXACT_TOLERANCES: [f64; 2] = [1e-8, 1e-5];

/// The factors of a damped system.
pub struct FramesFactor {
    kind: Kind,
    /// What was added to the diagonal.
    extra: Vec<f64>,
}

enum Kind {
    Together(TogetherFactor),
    Apart(ApartFactor),
}

impl FramesFactor {
    pub(super) fn new(frames: &Frames) -> Result<Self, TooLarge> {
        let kind = match &frames.apart {
            None => Kind::Together(TogetherFactor::new(frames)?),
            Some(bodies) => Kind::Apart(ApartFactor::new(frames, bodies)?),
        };
        Ok(FramesFactor { kind, extra: Vec::new() })
    }

    /// Factorises the normal matrix with `extra` on its diagonal.
    pub(super) fn factorise(
        &mut self,
        frames: &Frames,
        normal: &Normal,
        extra: &[f64],
    ) -> Result<(), Singular> {
        self.extra.clear();
        self.extra.extend_from_slice(extra);
        match &mut self.kind {
            Kind::Together(factor) => factor.factorise(frames, normal, extra),
            Kind::Apart(factor) => factor.factorise(normal, extra),
        }
    }

    /// Solves for one step with `extra` on the diagonal, in place, until the residual is this share of the
    /// right-hand side or less, and factorises no more than that takes.
    pub(super) fn step(
        &mut self,
        frames: &Frames,
        normal: &Normal,
        extra: &[f64],
        share: f64,
        b: &mut [f64],
    ) -> Result<(), Singular> {
        self.extra.clear();
        self.extra.extend_from_slice(extra);
        match &mut self.kind {
            Kind::Together(factor) => factor.step(frames, normal, extra, share, b),
            Kind::Apart(factor) => {
                factor.factorise(normal, extra)?;
                factor.solve(normal, b, share);
                Ok(())
            }
        }
    }

    /// Makes what the last step did without.
    pub(super) fn complete(&mut self, frames: &Frames, normal: &Normal) -> Result<(), Singular> {
        match &mut self.kind {
            Kind::Together(factor) => factor.complete(frames, normal),
            Kind::Apart(_) => Ok(()),
        }
    }

    /// Solves for right-hand sides in the order of the pattern, in place. What the change of variables
    /// cancels in a right-hand side is made good by one refinement.
    pub(super) fn solve(&mut self, frames: &Frames, normal: &Normal, accuracy: Accuracy, b: &mut [f64]) {
        let [first, refined] = match accuracy {
            Accuracy::Exact => EXACT_TOLERANCES,
            Accuracy::Share(share) => return self.solve_once(frames, normal, b, share),
        };
        let mut x = b.to_vec();
        self.solve_once(frames, normal, &mut x, first);
        let n = normal.matrix.size().max(1);
        for (x, b) in x.chunks_exact(n).zip(b.chunks_exact_mut(n)) {
            let product = frames.multiply(normal, &self.extra, x);
            b.iter_mut().zip(product).for_each(|(b, p)| *b -= p);
        }
        self.solve_once(frames, normal, b, refined);
        b.iter_mut().zip(x).for_each(|(b, x)| *b += x);
    }

    /// Selected blocks of the inverse, after the factorisation at `values`; `None` where bodies are apart.
    pub(super) fn selected(
        &mut self,
        frames: &Frames,
        system: &System,
        values: &Values,
        normal: &Normal,
    ) -> Option<(SelectedFrames, Vec<Leverage>)> {
        match &mut self.kind {
            Kind::Together(factor) => Some(factor.selected(frames, system, values, normal)),
            Kind::Apart(_) => None,
        }
    }

    fn solve_once(&mut self, frames: &Frames, normal: &Normal, b: &mut [f64], tolerance: f64) {
        match &mut self.kind {
            Kind::Together(factor) => factor.solve(frames, normal, b),
            Kind::Apart(factor) => factor.solve(normal, b, tolerance),
        }
    }
}

impl Frames {
    /// The normal matrix with `extra` on its diagonal, times `x`, in the order of the pattern.
    pub(super) fn multiply(&self, normal: &Normal, extra: &[f64], x: &[f64]) -> Vec<f64> {
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
        let seen_by_frames: Vec<DMatrix<f64>> = self
            .homes
            .iter()
            .zip(&linear.coupling)
            .map(|(home, coupling)| {
                coupling.times(&shape.rows(home.rows.start, home.rows.len()).into_owned())
            })
            .collect();
        let mut ys: Vec<DMatrix<f64>> =
            self.homes.iter().map(|home| DMatrix::zeros(POSE * home.coupling.poses(), 1)).collect();
        let mut next = vec![0; self.homes.len()];
        let mut body = linear.bodies.iter();
        for (t, starts) in starts.iter().enumerate() {
            for i in 0..self.steps[t].bodies.len() {
                let (h, _, a) = body.next().expect("one for each body");
                let has_observer = self.dims[t].0 > 0;
                let mut of_y = read(starts[1 + i]);
                if has_observer {
                    of_y += a * read(starts[0]);
                }
                let home = self.steps[t].bodies[i].home;
                let at = next[home];
                next[home] += POSE;
                ys[home].rows_mut(at, POSE).copy_from(&of_y);
                let force = h * of_y + seen_by_frames[home].fixed_view::<POSE, 1>(at, 0);
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
        let mut of_shape = DMatrix::zeros(self.shape, 1);
        for ((home, coupling), y) in self.homes.iter().zip(&linear.coupling).zip(&ys) {
            let mut own = DMatrix::zeros(home.rows.len(), 1);
            coupling.add_transposed_times(y, &mut own);
            of_shape.rows_mut(home.rows.start, home.rows.len()).copy_from(&own);
        }
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
}
