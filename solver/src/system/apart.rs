//! Many bodies: each with its shape by itself, then observers and what all share.
//!
//! Bodies see each other only through their observers and through what all share, the `rest`. In the
//! unknowns `c`, `y` of [`super::frames`], with the prior `V` of a body's poses and `H` of its image points,
//!
//! ```text
//!     y, s of body 1      2        c             rest
//!   [ V+H  W          |       | -V A         |  K   ]      y
//!   [ W'   B          |       |              |  Ks  ]      s
//!   [ ----------------+-------+--------------+----- ]
//!   [                 |  ...  | ...          |  ... ]      the same for the next body
//!   [ ----------------+-------+--------------+----- ]
//!   [ -A'V            |  ...  | C + sum A'VA |  Kc - A'K ] c
//!   [  K'   Ks'       |  ...  | ...          |  R   ]      rest
//! ```
//!
//! A body is a band along time with its shape as a border, and small. What is left when all are
//! eliminated is full along time, since whatever moves smoothly links all moments; it is never formed
//! but solved by conjugate gradients. They converge fast because all bodies together act on the
//! observers nearly as one body would that had all their priors and all their image points:
//!
//! ```text
//! sum A' (V^-1 + H^-1)^-1 A  <=  ((sum A'VA)^-1 + (sum A'HA)^-1)^-1
//! ```
//!
//! with equality where all bodies have the same shares of both (the parallel sum is concave). Such a
//! body, its shape taken as known, has 6 unknowns a moment and preconditions the observers exactly
//! along time; the rest is its border.

use super::bodies::Body;
use super::frames::Frames;
use super::frames_linear::FramesLinear;
use super::normal::Normal;
use super::time_steps::Place;
use crate::linear::chain::Chain;
use crate::linear::cholesky::{Singular, TooLarge, kernel_threads};
use crate::linear::coupling::Coupling;
use crate::linear::gradients::{Preconditioned, conjugate_gradients};
use crate::linear::pose_chain::PoseChain;
use crate::linear::small::{POINT, POSE};
use crate::linear::tiles::TiledCholesky;
use nalgebra::{DMatrix, DMatrixView, Matrix6};
use rayon::ThreadPool;
use rayon::prelude::*;
use std::ops::Range;
use std::sync::Arc;

/// The most conjugate gradients of one solution.
const MOST_GRADIENTS: usize = 400;
/// Where a scalar of the pattern is: index of a chain and component, or row.
#[derive(Clone, Copy, Debug)]
enum At {
    Observer(u32, u8),
    Pose(u32, u32, u8),
    Shape(u32, u32),
    Rest(u32),
}

/// Entries of a sparse matrix: row, column, value.
type Entries = Vec<(u32, u32, f64)>;

/// `out += sign * K x`, or with `K` transposed.
fn add_product(k: &Entries, transposed: bool, sign: f64, x: DMatrixView<'_, f64>, out: &mut DMatrix<f64>) {
    for side in 0..x.ncols() {
        for &(row, column, value) in k {
            let (row, column) = if transposed { (column, row) } else { (row, column) };
            out[(row as usize, side)] += sign * value * x[(column as usize, side)];
        }
    }
}

/// A body with its factors.
struct Interior {
    /// For each of its moments: the place in the linearisation, and which free observer sees it.
    moments: Vec<(usize, Option<usize>)>,
    shape: Range<usize>,
    /// `A`, zero where the observer is held.
    turns: Vec<Matrix6<f64>>,
    /// `V`, and the factor of `V + H`.
    prior: PoseChain,
    factor: PoseChain,
    /// Factor of `B - W^T (V + H)^-1 W`.
    border: TiledCholesky,
    /// `K` and `Ks`.
    rest: Entries,
    shape_rest: Entries,
}

/// The factors of a damped system.
pub(super) struct ApartFactor {
    at: Vec<At>,
    bodies: Vec<Interior>,
    /// How many observers are free.
    observers: usize,
    /// `C`, `R` and `Kc`.
    own: PoseChain,
    rest: DMatrix<f64>,
    own_rest: Entries,
    /// Observers and the one body that stands for all, and their border.
    stand_in: Chain,
    stand_in_rest: [DMatrix<f64>; 2],
    stand_in_border: TiledCholesky,
    threads: Arc<ThreadPool>,
}

impl ApartFactor {
    pub(super) fn new(frames: &Frames, bodies: &[Body]) -> Result<Self, TooLarge> {
        let mut observer_of = vec![None; frames.steps.len()];
        let mut observers = 0;
        for (step, dims) in frames.dims.iter().enumerate() {
            if dims.0 > 0 {
                observer_of[step] = Some(observers);
                observers += 1;
            }
        }
        let mut first_of_step = vec![0];
        frames
            .steps
            .iter()
            .for_each(|s| first_of_step.push(first_of_step[first_of_step.len() - 1] + s.bodies.len()));
        let mut moment_of: Vec<(u32, u32)> = vec![(0, 0); first_of_step[frames.steps.len()]];
        let threads = kernel_threads(rayon::current_num_threads())?;
        let mut interiors = Vec::with_capacity(bodies.len());
        let mut has_body = vec![false; observers];
        for (index, body) in bodies.iter().enumerate() {
            let mut moments = Vec::with_capacity(body.places.len());
            for (moment, &(step, order)) in body.places.iter().enumerate() {
                let place = first_of_step[step] + order;
                moment_of[place] = (index as u32, moment as u32);
                moments.push((place, observer_of[step]));
                observer_of[step].into_iter().for_each(|o| has_body[o] = true);
            }
            let steps = moments.len();
            interiors.push(Interior {
                turns: vec![Matrix6::zeros(); steps],
                moments,
                shape: body.shape.clone(),
                prior: PoseChain::new(steps, frames.band),
                factor: PoseChain::new(steps, frames.band),
                border: TiledCholesky::on_threads(body.shape.len(), threads.clone())?,
                rest: Vec::new(),
                shape_rest: Vec::new(),
            });
        }
        let mut body_of_row = vec![0; frames.shape];
        for (index, body) in bodies.iter().enumerate() {
            body_of_row[body.shape.clone()].fill(index);
        }
        let at = |place: &Place| match *place {
            Place::Chain(step, at) if at < frames.dims[step].0 => {
                At::Observer(observer_of[step].expect("free") as u32, at as u8)
            }
            Place::Chain(step, at) => {
                let at = at - frames.dims[step].0;
                let (body, moment) = moment_of[first_of_step[step] + at / POSE];
                At::Pose(body, moment, (at % POSE) as u8)
            }
            Place::Border(at) if at < frames.shape => {
                At::Shape(body_of_row[at] as u32, (at - bodies[body_of_row[at]].shape.start) as u32)
            }
            Place::Border(at) => At::Rest((at - frames.shape) as u32),
        };
        let rest = frames.border - frames.shape;
        let dims: Vec<(usize, usize)> =
            has_body.iter().map(|has| (POSE, if *has { POSE } else { 0 })).collect();
        let stand_in =
            if dims.is_empty() { Chain::new(vec![(0, 0)], 0) } else { Chain::new(dims, frames.band) };
        let n = stand_in.size();
        Ok(ApartFactor {
            at: frames.scalars.iter().map(at).collect(),
            bodies: interiors,
            observers,
            own: PoseChain::new(observers, frames.band),
            rest: DMatrix::zeros(rest, rest),
            own_rest: Vec::new(),
            stand_in,
            stand_in_rest: [DMatrix::zeros(n, rest), DMatrix::zeros(n, rest)],
            stand_in_border: TiledCholesky::on_threads(rest, threads.clone())?,
            threads,
        })
    }

    /// Factorises the normal matrix with `extra` on its diagonal.
    pub(super) fn factorise(&mut self, normal: &Normal, extra: &[f64]) -> Result<(), Singular> {
        let linear = normal.frames.as_ref().expect("linearised by frames");
        self.take_matrix(normal, extra);
        self.threads.install(|| {
            self.bodies
                .par_iter_mut()
                .zip(&linear.coupling)
                .try_for_each(|(body, coupling)| body.factorise(linear, coupling))
        })?;
        self.factorise_stand_in(linear)
    }

    /// Everything but image points.
    fn take_matrix(&mut self, normal: &Normal, extra: &[f64]) {
        self.own.clear();
        self.rest.fill(0.0);
        self.own_rest.clear();
        for body in &mut self.bodies {
            body.prior.clear();
            body.border.clear();
            body.rest.clear();
            body.shape_rest.clear();
        }
        let ApartFactor { at, bodies, own, rest, own_rest, .. } = self;
        normal.matrix.for_each_entry(|row, column, value| {
            let value = value + if row == column { extra[row] } else { 0.0 };
            let index = |t: u32, i: u8| (POSE * t as usize + usize::from(i)) as u32;
            match (at[row], at[column]) {
                (At::Observer(s, i), At::Observer(t, j)) => set(own, (s, i), (t, j), value),
                (At::Pose(b, s, i), At::Pose(_, t, j)) => {
                    set(&mut bodies[b as usize].prior, (s, i), (t, j), value)
                }
                (At::Shape(b, i), At::Shape(_, j)) => {
                    *bodies[b as usize].border.entry_mut(i.max(j) as usize, i.min(j) as usize) = value;
                }
                (At::Rest(i), At::Rest(j)) => {
                    rest[(i as usize, j as usize)] = value;
                    rest[(j as usize, i as usize)] = value;
                }
                (At::Observer(t, i), At::Rest(r)) | (At::Rest(r), At::Observer(t, i)) => {
                    own_rest.push((index(t, i), r, value));
                }
                (At::Pose(b, t, i), At::Rest(r)) | (At::Rest(r), At::Pose(b, t, i)) => {
                    bodies[b as usize].rest.push((index(t, i), r, value));
                }
                (At::Shape(b, i), At::Rest(r)) | (At::Rest(r), At::Shape(b, i)) => {
                    bodies[b as usize].shape_rest.push((i, r, value));
                }
                _ => unreachable!("bodies are apart"),
            }
        });
    }

    fn factorise_stand_in(&mut self, linear: &FramesLinear) -> Result<(), Singular> {
        let ApartFactor { bodies, own, rest, own_rest, stand_in, stand_in_rest, stand_in_border, .. } = self;
        stand_in.clear();
        let [coupling, solved] = stand_in_rest;
        coupling.fill(0.0);
        for t in 0..self.observers {
            for k in 0..=own.band().min(self.observers - 1 - t) {
                let mut corner = stand_in.block_mut(t, k).fixed_view_mut::<POSE, POSE>(0, 0);
                corner += own.block(t, k);
            }
        }
        for body in bodies.iter() {
            for (moment, &(place, observer)) in body.moments.iter().enumerate() {
                let Some(t) = observer else { continue };
                let turn = &body.turns[moment];
                let seen = turn.transpose() * linear.bodies[place].0 * turn;
                let mut corner = stand_in.block_mut(t, 0).fixed_view_mut::<POSE, POSE>(POSE, POSE);
                corner += seen;
                for k in 0..=body.prior.band().min(body.moments.len() - 1 - moment) {
                    // Across a gap there is no prior.
                    let Some(s) = body.moments[moment + k].1.filter(|s| s - t <= own.band()) else {
                        continue;
                    };
                    let prior = body.turns[moment + k].transpose() * body.prior.block(moment, k) * turn;
                    let block = stand_in.block_mut(t, s - t);
                    for (row, column, sign) in
                        [(0, 0, 1.0), (POSE, 0, -1.0), (0, POSE, -1.0), (POSE, POSE, 1.0)]
                    {
                        let mut part = block.fixed_view_mut::<POSE, POSE>(row, column);
                        part += prior * sign;
                    }
                }
            }
        }
        stand_in.factorise()?;
        for &(row, column, value) in own_rest.iter() {
            let (t, i) = (row as usize / POSE, row as usize % POSE);
            coupling[(stand_in.start(t) + i, column as usize)] = value;
        }
        solved.copy_from(coupling);
        stand_in.solve(solved);
        let reduced = &*rest - coupling.tr_mul(solved);
        for column in 0..reduced.ncols() {
            for row in column..reduced.nrows() {
                *stand_in_border.entry_mut(row, column) = reduced[(row, column)];
            }
        }
        stand_in_border.factorise()
    }

    /// Solves for right-hand sides in the order of the pattern, in place, until the residual is this
    /// share of what it was.
    pub(super) fn solve(&mut self, normal: &Normal, b: &mut [f64], tolerance: f64) {
        let linear = normal.frames.as_ref().expect("linearised by frames");
        let n = normal.matrix.size();
        let sides = b.len() / n.max(1);
        let (outer, rest) = (POSE * self.observers, self.rest.nrows());
        let mut o = DMatrix::zeros(outer + rest, sides);
        let mut ys: Vec<DMatrix<f64>> =
            self.bodies.iter().map(|body| DMatrix::zeros(body.prior.size(), sides)).collect();
        let mut shapes: Vec<DMatrix<f64>> =
            self.bodies.iter().map(|body| DMatrix::zeros(body.shape.len(), sides)).collect();
        let place = |at: &At| match *at {
            At::Observer(t, i) => (0, 0, POSE * t as usize + usize::from(i)),
            At::Rest(r) => (0, 0, outer + r as usize),
            At::Pose(b, t, i) => (1, b as usize, POSE * t as usize + usize::from(i)),
            At::Shape(b, i) => (2, b as usize, i as usize),
        };
        for (side, b) in b.chunks_exact(n).enumerate() {
            for (at, value) in self.at.iter().zip(b) {
                match place(at) {
                    (0, _, row) => o[(row, side)] = *value,
                    (1, body, row) => ys[body][(row, side)] = *value,
                    (_, body, row) => shapes[body][(row, side)] = *value,
                }
            }
        }
        // Bodies, given that nothing else moves, and what is left for the others.
        let parts: Vec<DMatrix<f64>> = self
            .bodies
            .par_iter_mut()
            .zip(&linear.coupling)
            .zip(ys.par_iter().zip(&shapes))
            .map(|((body, coupling), (y, shape))| {
                let (moved, reshaped) = body.solve(coupling, y.clone(), shape.clone());
                let mut part = DMatrix::zeros(outer + rest, sides);
                body.pass_to_observers(&(body.prior.multiply(&moved) - y), &mut part);
                let mut of_rest = DMatrix::zeros(rest, sides);
                add_product(&body.rest, true, -1.0, moved.as_view(), &mut of_rest);
                add_product(&body.shape_rest, true, -1.0, reshaped.as_view(), &mut of_rest);
                part.rows_mut(outer, rest).copy_from(&of_rest);
                part
            })
            .collect();
        parts.iter().for_each(|part| o += part);
        let o = conjugate_gradients(&mut Outer { factor: self, linear }, o, tolerance, MOST_GRADIENTS).x;
        // Bodies, given how the others move.
        let moves: Vec<(DMatrix<f64>, DMatrix<f64>)> = self
            .bodies
            .par_iter_mut()
            .zip(&linear.coupling)
            .zip(ys.par_iter().zip(&shapes))
            .map(|((body, coupling), (y, shape))| {
                let (of_y, of_shape, seen) = body.pull(&o, outer);
                let (mut moved, reshaped) = body.solve(coupling, y + of_y, shape + of_shape);
                moved -= seen;
                (moved, reshaped)
            })
            .collect();
        for (side, b) in b.chunks_exact_mut(n).enumerate() {
            for (at, value) in self.at.iter().zip(b) {
                *value = match place(at) {
                    (0, _, row) => o[(row, side)],
                    (1, body, row) => moves[body].0[(row, side)],
                    (_, body, row) => moves[body].1[(row, side)],
                };
            }
        }
    }

    /// What is left when all bodies are eliminated, times `x`.
    fn multiply(&mut self, linear: &FramesLinear, x: &DMatrix<f64>) -> DMatrix<f64> {
        let outer = POSE * self.observers;
        let rest = self.rest.nrows();
        let of_observers = x.rows(0, outer).into_owned();
        let of_rest = x.rows(outer, rest).into_owned();
        let mut product = DMatrix::zeros(outer + rest, x.ncols());
        let mut own = self.own.multiply(&of_observers);
        add_product(&self.own_rest, false, 1.0, of_rest.as_view(), &mut own);
        let mut own_rest = &self.rest * &of_rest;
        add_product(&self.own_rest, true, 1.0, of_observers.as_view(), &mut own_rest);
        product.rows_mut(0, outer).copy_from(&own);
        product.rows_mut(outer, rest).copy_from(&own_rest);
        let parts: Vec<DMatrix<f64>> = self
            .bodies
            .par_iter_mut()
            .zip(&linear.coupling)
            .map(|(body, coupling)| {
                let (of_y, of_shape, seen) = body.pull(x, outer);
                let (moved, reshaped) = body.solve(coupling, of_y.clone(), of_shape);
                let mut part = DMatrix::zeros(outer + rest, x.ncols());
                body.pass_to_observers(&(of_y - body.prior.multiply(&moved)), &mut part);
                let mut of_rest = DMatrix::zeros(rest, x.ncols());
                add_product(&body.rest, true, 1.0, (moved - seen).as_view(), &mut of_rest);
                add_product(&body.shape_rest, true, 1.0, reshaped.as_view(), &mut of_rest);
                part.rows_mut(outer, rest).copy_from(&of_rest);
                part
            })
            .collect();
        parts.iter().for_each(|part| product += part);
        product
    }

    /// The same with one body in the place of all, solved.
    fn precondition(&mut self, b: &DMatrix<f64>) -> DMatrix<f64> {
        let ApartFactor { stand_in, stand_in_rest: [coupling, solved], stand_in_border, .. } = self;
        let (outer, rest) = (POSE * self.observers, self.rest.nrows());
        let mut x = DMatrix::zeros(stand_in.size(), b.ncols());
        for t in 0..self.observers {
            x.rows_mut(stand_in.start(t), POSE).copy_from(&b.rows(POSE * t, POSE));
        }
        stand_in.solve(&mut x);
        let mut of_rest = b.rows(outer, rest) - coupling.tr_mul(&x);
        stand_in_border.solve(&mut of_rest);
        x -= &*solved * &of_rest;
        let mut out = DMatrix::zeros(outer + rest, b.ncols());
        for t in 0..self.observers {
            out.rows_mut(POSE * t, POSE).copy_from(&x.rows(stand_in.start(t), POSE));
        }
        out.rows_mut(outer, rest).copy_from(&of_rest);
        out
    }
}

/// The observers and the rest, when all bodies are eliminated.
struct Outer<'a> {
    factor: &'a mut ApartFactor,
    linear: &'a FramesLinear,
}

impl Preconditioned for Outer<'_> {
    fn multiply(&mut self, x: &DMatrix<f64>) -> DMatrix<f64> {
        self.factor.multiply(self.linear, x)
    }

    fn precondition(&mut self, b: &DMatrix<f64>) -> DMatrix<f64> {
        self.factor.precondition(b)
    }
}

fn set(chain: &mut PoseChain, (s, i): (u32, u8), (t, j): (u32, u8), value: f64) {
    let ((s, i), (t, j)) = if s >= t { ((s, i), (t, j)) } else { ((t, j), (s, i)) };
    let block = chain.block_mut(t as usize, (s - t) as usize);
    block[(i.into(), j.into())] = value;
    if s == t {
        block[(j.into(), i.into())] = value;
    }
}

impl Interior {
    fn factorise(&mut self, linear: &FramesLinear, coupling: &Coupling) -> Result<(), Singular> {
        self.factor.copy_from(&self.prior);
        for (moment, &(place, observer)) in self.moments.iter().enumerate() {
            let (h, _, turn) = &linear.bodies[place];
            *self.factor.block_mut(moment, 0) += h;
            self.turns[moment] = if observer.is_some() { *turn } else { Matrix6::zeros() };
        }
        self.factor.factorise()?;
        for (blocks, _) in &linear.sums {
            for at in (0..self.shape.len()).step_by(POINT) {
                let block = &blocks[POINT * (self.shape.start + at)..][..POINT * POINT];
                for i in 0..POINT {
                    for j in 0..=i {
                        *self.border.entry_mut(at + i, at + j) += block[i * POINT + j];
                    }
                }
            }
        }
        self.factor.reduce(coupling, &mut self.border);
        self.border.factorise()
    }

    /// Solves for poses and shape, given that nothing else moves.
    fn solve(
        &mut self,
        coupling: &Coupling,
        mut y: DMatrix<f64>,
        mut shape: DMatrix<f64>,
    ) -> (DMatrix<f64>, DMatrix<f64>) {
        let of_y = y.clone();
        self.factor.solve(&mut y);
        let mut seen = DMatrix::zeros(shape.nrows(), shape.ncols());
        coupling.add_transposed_times(&y, &mut seen);
        shape -= seen;
        self.border.solve_here(&mut shape);
        let mut rest = of_y - coupling.times(&shape);
        self.factor.solve(&mut rest);
        (rest, shape)
    }

    /// The right-hand sides of poses and shape when the others move by `o`, and how far the poses are
    /// seen to move: `V A c - K r`, `-Ks r`, `A c`.
    fn pull(&self, o: &DMatrix<f64>, outer: usize) -> (DMatrix<f64>, DMatrix<f64>, DMatrix<f64>) {
        let sides = o.ncols();
        let mut seen = DMatrix::zeros(self.prior.size(), sides);
        for (moment, (turn, &(_, observer))) in self.turns.iter().zip(&self.moments).enumerate() {
            if let Some(t) = observer {
                let moved = turn * o.rows(POSE * t, POSE);
                seen.rows_mut(POSE * moment, POSE).copy_from(&moved);
            }
        }
        let of_rest = o.rows(outer, o.nrows() - outer).into_owned();
        let mut of_y = self.prior.multiply(&seen);
        add_product(&self.rest, false, -1.0, of_rest.as_view(), &mut of_y);
        let mut of_shape = DMatrix::zeros(self.shape.len(), sides);
        add_product(&self.shape_rest, false, -1.0, of_rest.as_view(), &mut of_shape);
        (of_y, of_shape, seen)
    }

    /// Adds `A^T force` to the observers.
    fn pass_to_observers(&self, force: &DMatrix<f64>, out: &mut DMatrix<f64>) {
        for (moment, (turn, &(_, observer))) in self.turns.iter().zip(&self.moments).enumerate() {
            if let Some(t) = observer {
                let passed = turn.transpose() * force.rows(POSE * moment, POSE);
                let mut rows = out.rows_mut(POSE * t, POSE);
                rows += passed;
            }
        }
    }
}
