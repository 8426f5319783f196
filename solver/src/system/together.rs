//! All bodies together: their poses along time first, which leaves one dense system of all shapes.
//!
//! ```text
//!    frames            shape  rest
//!  [ T' H T + Hyy    |  W   |  V  ]        a [`Chain`] along time, in c and y
//!  [ W'              |  B   |     ]        its border, dense
//!  [ V'              |      |  C  ]
//! ```
//!
//! To make what is left of the border costs most by far, and from one iteration to the next it changes
//! little. For a step it is therefore solved by conjugate gradients, with the chain and the coupling as they
//! are and the factor of an earlier border as the preconditioner; where they do not come to their end
//! within half of what making it costs, it is made.

use super::frames::Frames;
use super::frames_linear::FramesLinear;
use super::normal::Normal;
use super::time_steps::Place;
use crate::linear::chain::Chain;
use crate::linear::cholesky::{Singular, TooLarge};
use crate::linear::gradients::{Preconditioned, conjugate_gradients};
use crate::linear::small::{POINT, POSE};
use crate::linear::tiles::TiledCholesky;
use nalgebra::DMatrix;

/// How many times longer an operation of conjugate gradients takes, which waits for memory, than one of
/// making the border.
const WAITING: f64 = 4.0;
/// Fewer conjugate gradients than these are not worth trying.
const LEAST_GRADIENTS: usize = 4;

/// The factors of a damped system.
pub(super) struct TogetherFactor {
    pub chain: Chain,
    pub border: TiledCholesky,
    /// Of which border that is the factor.
    made: Made,
    /// `V` and `H^-1 V`.
    pub rest: [DMatrix<f64>; 2],
    /// `T` of each step.
    turns: Vec<DMatrix<f64>>,
    /// What the border has by itself: the block of every point, row after row, and other entries, row and
    /// column, of the lower triangle.
    blocks: Vec<f64>,
    entries: Vec<(u32, u32, f64)>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Made {
    Nothing,
    Earlier,
    Present,
}

impl TogetherFactor {
    pub(super) fn new(frames: &Frames) -> Result<Self, TooLarge> {
        let chain = Chain::new(frames.dims.clone(), frames.band);
        let (n, r) = (chain.size(), frames.border - frames.shape);
        let border = TiledCholesky::new(frames.border, frames.flops)?;
        Ok(TogetherFactor {
            chain,
            border,
            made: Made::Nothing,
            rest: [DMatrix::zeros(n, r), DMatrix::zeros(n, r)],
            turns: Vec::new(),
            blocks: vec![0.0; POINT * frames.shape],
            entries: Vec::new(),
        })
    }

    /// Factorises the normal matrix with `extra` on its diagonal.
    pub(super) fn factorise(
        &mut self,
        frames: &Frames,
        normal: &Normal,
        extra: &[f64],
    ) -> Result<(), Singular> {
        self.eliminate_poses(frames, normal, extra)?;
        self.complete(frames, normal)
    }

    /// Solves with `extra` on the diagonal, in place, until the residual is this share of the right-hand side
    /// or less, and factorises no more than that takes.
    pub(super) fn step(
        &mut self,
        frames: &Frames,
        normal: &Normal,
        extra: &[f64],
        share: f64,
        b: &mut [f64],
    ) -> Result<(), Singular> {
        let most = frames.most_gradients();
        let most = if most >= LEAST_GRADIENTS { most } else { 0 };
        self.step_within(frames, normal, extra, (share, most), b).map(|_| ())
    }

    /// The same with at most so many conjugate gradients, and whether they came to their end.
    pub(super) fn step_within(
        &mut self,
        frames: &Frames,
        normal: &Normal,
        extra: &[f64],
        (share, most): (f64, usize),
        b: &mut [f64],
    ) -> Result<bool, Singular> {
        self.eliminate_poses(frames, normal, extra)?;
        let is_tried = self.made == Made::Earlier && most > 0;
        if is_tried && self.solve_by(frames, normal, b, Some((share, most))) {
            return Ok(true);
        }
        self.complete(frames, normal)?;
        self.solve(frames, normal, b);
        Ok(false)
    }

    /// Everything but what is left of the border.
    fn eliminate_poses(&mut self, frames: &Frames, normal: &Normal, extra: &[f64]) -> Result<(), Singular> {
        let linear = normal.frames.as_ref().expect("linearised by frames");
        let TogetherFactor { chain, made, rest: [rest, solved], turns, blocks, entries, .. } = self;
        if *made == Made::Present {
            *made = Made::Earlier;
        }
        chain.clear();
        rest.fill(0.0);
        entries.clear();
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
                    entries.push((i.max(j) as u32, i.min(j) as u32, value));
                }
                (Place::Chain(t, i), Place::Border(j)) | (Place::Border(j), Place::Chain(t, i)) => {
                    rest[(chain.start(t) + i, j - frames.shape)] = value;
                }
            }
        });
        // Into c, y; and the image points.
        *turns = frames.turns(linear);
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
        blocks.fill(0.0);
        for (of_chunk, _) in &linear.sums {
            blocks.iter_mut().zip(of_chunk).for_each(|(sum, part)| *sum += part);
        }
        chain.factorise()?;
        solved.copy_from(rest);
        chain.solve(solved);
        Ok(())
    }

    /// Makes what is left of the border, where that is not done.
    pub(super) fn complete(&mut self, frames: &Frames, normal: &Normal) -> Result<(), Singular> {
        if self.made == Made::Present {
            return Ok(());
        }
        let linear = normal.frames.as_ref().expect("linearised by frames");
        let TogetherFactor { chain, border, made, rest: [rest, solved], blocks, entries, .. } = self;
        *made = Made::Nothing;
        border.clear();
        for &(row, column, value) in &*entries {
            *border.entry_mut(row as usize, column as usize) = value;
        }
        for at in (0..frames.shape).step_by(POINT) {
            for i in 0..POINT {
                for j in 0..=i {
                    *border.entry_mut(at + i, at + j) += blocks[POINT * at + i * POINT + j];
                }
            }
        }
        let (m, r) = (frames.shape, frames.border - frames.shape);
        if r > 0 {
            let below = frames.coupling_times(linear, chain, solved);
            for i in 0..r {
                for j in 0..m {
                    *border.entry_mut(m + i, j) -= below[(j, i)];
                }
            }
            let own = rest.transpose() * &*solved;
            for i in 0..r {
                for j in 0..=i {
                    *border.entry_mut(m + i, m + j) -= own[(i, j)];
                }
            }
        }
        chain.reduce(&linear.coupling[0], border);
        border.factorise()?;
        *made = Made::Present;
        Ok(())
    }

    /// Solves for right-hand sides in the order of the pattern, in place.
    pub(super) fn solve(&mut self, frames: &Frames, normal: &Normal, b: &mut [f64]) {
        assert_eq!(self.made, Made::Present, "the border is made");
        self.solve_by(frames, normal, b, None);
    }

    /// The same, with the border's own factor or by conjugate gradients: tolerance and most products, within
    /// which they may come to no end; then nothing is solved.
    fn solve_by(
        &mut self,
        frames: &Frames,
        normal: &Normal,
        b: &mut [f64],
        gradients: Option<(f64, usize)>,
    ) -> bool {
        let linear = normal.frames.as_ref().expect("linearised by frames");
        let n = normal.matrix.size();
        let sides = b.len() / n.max(1);
        let chain = &self.chain;
        let mut x = DMatrix::zeros(chain.size(), sides);
        let mut s = DMatrix::zeros(frames.border, sides);
        for (side, b) in b.chunks_exact(n.max(1)).enumerate() {
            for (index, value) in b.iter().enumerate() {
                match frames.scalars[index] {
                    Place::Chain(t, i) => x[(chain.start(t) + i, side)] = *value,
                    Place::Border(i) => s[(i, side)] = *value,
                }
            }
        }
        for (t, turn) in self.turns.iter().enumerate() {
            let turned = turn.transpose() * x.rows(chain.start(t), turn.nrows());
            x.rows_mut(chain.start(t), turn.nrows()).copy_from(&turned);
        }
        chain.solve(&mut x);
        let mut border = Border { factor: self, frames, linear };
        border.subtract_seen(&x, &mut s);
        match gradients {
            None => self.border.solve(&mut s),
            Some((tolerance, most)) => {
                let found = conjugate_gradients(&mut border, s, tolerance, most);
                if !found.is_done {
                    return false;
                }
                s = found.x;
            }
        }
        let TogetherFactor { chain, turns, rest: [_, solved], .. } = self;
        let (m, r) = (frames.shape, frames.border - frames.shape);
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
        true
    }
}

/// What is left of the border when poses are eliminated, not made.
struct Border<'a> {
    factor: &'a TogetherFactor,
    frames: &'a Frames,
    linear: &'a FramesLinear,
}

impl Border<'_> {
    /// Subtracts from `s` what the border sees of poses that move by `x`.
    fn subtract_seen(&self, x: &DMatrix<f64>, s: &mut DMatrix<f64>) {
        let Border { factor: TogetherFactor { chain, rest: [rest, _], .. }, frames, linear } = self;
        let (m, r) = (frames.shape, frames.border - frames.shape);
        let mut of_shape = s.rows_mut(0, m);
        of_shape -= frames.coupling_times(linear, chain, x);
        if r > 0 {
            let mut of_rest = s.rows_mut(m, r);
            of_rest -= rest.tr_mul(x);
        }
    }
}

impl Preconditioned for Border<'_> {
    fn multiply(&mut self, s: &DMatrix<f64>) -> DMatrix<f64> {
        let TogetherFactor { chain, rest: [rest, _], blocks, entries, .. } = self.factor;
        let (m, r) = (self.frames.shape, self.frames.border - self.frames.shape);
        let mut x = self.frames.coupling_transposed_times(self.linear, chain, s);
        if r > 0 {
            x += rest * s.rows(m, r);
        }
        chain.solve(&mut x);
        let mut product = DMatrix::zeros(s.nrows(), s.ncols());
        for (s, mut product) in s.column_iter().zip(product.column_iter_mut()) {
            for (at, block) in blocks.chunks_exact(POINT * POINT).enumerate() {
                for i in 0..POINT {
                    for j in 0..POINT {
                        product[POINT * at + i] += block[i * POINT + j] * s[POINT * at + j];
                    }
                }
            }
            for &(row, column, value) in entries {
                let (row, column) = (row as usize, column as usize);
                product[row] += value * s[column];
                if row != column {
                    product[column] += value * s[row];
                }
            }
        }
        self.subtract_seen(&x, &mut product);
        product
    }

    fn precondition(&mut self, b: &DMatrix<f64>) -> DMatrix<f64> {
        let mut x = b.clone();
        self.factor.border.solve_here(&mut x);
        x
    }
}

impl Frames {
    /// How many conjugate gradients take half as long as to make the border.
    fn most_gradients(&self) -> usize {
        let (seen, m) = (self.homes[0].coupling.blocks() as f64, self.border as f64);
        let gradient = 4.0 * (POSE * POINT) as f64 * seen + 2.0 * m * m;
        (0.5 * self.flops / (WAITING * gradient)) as usize
    }

    /// `W^T x`.
    fn coupling_times(&self, linear: &FramesLinear, chain: &Chain, x: &DMatrix<f64>) -> DMatrix<f64> {
        let mut of_y = DMatrix::zeros(self.y_starts[self.steps.len()], x.ncols());
        for (t, &(c, y)) in self.dims.iter().enumerate() {
            of_y.rows_mut(self.y_starts[t], y).copy_from(&x.rows(chain.start(t) + c, y));
        }
        let mut product = DMatrix::zeros(self.shape, x.ncols());
        linear.coupling[0].add_transposed_times(&of_y, &mut product);
        product
    }

    /// `W s`, zero in all `c`.
    fn coupling_transposed_times(
        &self,
        linear: &FramesLinear,
        chain: &Chain,
        s: &DMatrix<f64>,
    ) -> DMatrix<f64> {
        let of_shape = s.rows(0, self.shape).into_owned();
        let of_y = linear.coupling[0].times(&of_shape);
        let mut product = DMatrix::zeros(chain.size(), s.ncols());
        for (t, &(c, y)) in self.dims.iter().enumerate() {
            product.rows_mut(chain.start(t) + c, y).copy_from(&of_y.rows(self.y_starts[t], y));
        }
        product
    }
}
