//! All bodies together: their poses along time first, which leaves one dense system of all shapes.
//!
//! ```text
//!    frames            shape  rest
//!  [ T' H T + Hyy    |  W   |  V  ]        a [`Chain`] along time, in c and y
//!  [ W'              |  B   |     ]        its border, dense
//!  [ V'              |      |  C  ]
//! ```

use super::Normal;
use super::frames::{Frames, FramesLinear, POINT, Place, Step};
use crate::nlls::linear::chain::Chain;
use crate::nlls::linear::cholesky::{DenseCholesky, Singular, TooLarge};
use crate::nlls::linear::pose_chain::{POSE, add_coupling_times, coupling_transposed_times};
use nalgebra::DMatrix;

/// The factors of a damped system.
pub(super) struct TogetherFactor {
    pub chain: Chain,
    pub border: DenseCholesky,
    /// `V` and `H^-1 V`.
    pub rest: [DMatrix<f64>; 2],
}

impl TogetherFactor {
    pub fn new(frames: &Frames) -> Result<Self, TooLarge> {
        let chain = Chain::new(frames.dims.clone(), frames.band);
        let (n, r) = (chain.size(), frames.border - frames.shape);
        let border = DenseCholesky::new(frames.border, frames.flops)?;
        Ok(TogetherFactor { chain, border, rest: [DMatrix::zeros(n, r), DMatrix::zeros(n, r)] })
    }

    /// Factorises the normal matrix with `extra` on its diagonal.
    pub fn factorise(&mut self, frames: &Frames, normal: &Normal, extra: &[f64]) -> Result<(), Singular> {
        let linear = normal.frames.as_ref().expect("linearised by frames");
        let TogetherFactor { chain, border, rest: [rest, solved], .. } = self;
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
        chain.reduce(&linear.coupling[0], m, border);
        border.factorise()
    }

    /// Solves for right-hand sides in the order of the pattern, in place.
    pub fn solve(&mut self, frames: &Frames, normal: &Normal, b: &mut [f64]) {
        let linear = normal.frames.as_ref().expect("linearised by frames");
        let n = normal.matrix.size();
        let turns = frames.turns(linear);
        let sides = b.len() / n.max(1);
        let TogetherFactor { chain, border, rest: [rest, solved], .. } = self;
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
    pub(super) fn turns(&self, linear: &FramesLinear) -> Vec<DMatrix<f64>> {
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

    /// `W^T x`.
    fn coupling_times(&self, linear: &FramesLinear, chain: &Chain, x: &DMatrix<f64>) -> DMatrix<f64> {
        let mut of_y = DMatrix::zeros(self.y_starts[self.steps.len()], x.ncols());
        for (t, &(c, y)) in self.dims.iter().enumerate() {
            of_y.rows_mut(self.y_starts[t], y).copy_from(&x.rows(chain.start(t) + c, y));
        }
        let mut product = DMatrix::zeros(self.shape, x.ncols());
        add_coupling_times(&linear.coupling[0], &of_y, &mut product);
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
        let of_y = coupling_transposed_times(&linear.coupling[0], self.y_starts[self.steps.len()], &of_shape);
        let mut product = DMatrix::zeros(chain.size(), s.ncols());
        for (t, &(c, y)) in self.dims.iter().enumerate() {
            product.rows_mut(chain.start(t) + c, y).copy_from(&of_y.rows(self.y_starts[t], y));
        }
        product
    }
}
