//! Selected blocks of the inverse of the normal matrix, frames first.
//!
//! With the chain `H` of [together](super::together), its coupling `X = H^-1 [W V]` to the border, and the border's
//! own system `S`, the inverse is
//!
//! ```text
//!    frames                    border
//!  [ H^-1 + X S^-1 X^T   |  -X S^-1  ]
//!  [        ...          |    S^-1   ]
//! ```
//!
//! Of the frames only the band is wanted, which is `H^-1` by the recursion of
//! [`Chain::selected_inverse`](crate::linear::chain::Chain::selected_inverse) and a small product for
//! each step. `X S^-1` is made for some steps at a time, and used at once for what image points need of
//! it: it is never stored. Blocks are turned back from `c`, `y` into `c`, `v` at the end.

use super::accumulators::Local;
use super::frames::Frames;
use super::frames_linear::FramesLinear;
use super::group::State;
use super::normal::Normal;
use super::time_steps::{BodyAtStep, Place};
use super::together::TogetherFactor;
use crate::linear::chain::Chain;
use crate::linear::small::{POINT, POSE};
use nalgebra::{DMatrix, Matrix6};
use rayon::prelude::*;

/// Rows of the border that one task solves for, whole points.
const BORDER_ROWS: usize = 126;
/// Columns of `X S^-1` that are made at a time.
const PANEL_COLUMNS: usize = 384;

/// Blocks of the inverse.
pub(super) struct SelectedFrames {
    /// `band[t][k]`: rows of step `t + k`, columns of step `t`, in the order c, v.
    band: Vec<Vec<DMatrix<f64>>>,
    /// First scalar of each step.
    starts: Vec<usize>,
    /// Rows of the chain, columns of the border after the shapes.
    rest: DMatrix<f64>,
    border: DMatrix<f64>,
    shape: usize,
}

/// `J Q J^T` of a measurement that a frame sees: group, item, `rows x rows` numbers.
pub(super) type Leverage = (u32, u32, Vec<f64>);

impl SelectedFrames {
    /// A block between scalars of two places of the pattern; `None` where it was not selected.
    pub(super) fn block(&self, a: (Place, usize), b: (Place, usize)) -> Option<DMatrix<f64>> {
        match (a.0, b.0) {
            (Place::Chain(s, i), Place::Chain(t, j)) if s >= t => {
                Some(self.band[t].get(s - t)?.view((i, j), (a.1, b.1)).into_owned())
            }
            (Place::Chain(t, i), Place::Border(j)) if j >= self.shape => {
                Some(self.rest.view((self.starts[t] + i, j - self.shape), (a.1, b.1)).into_owned())
            }
            (Place::Border(i), Place::Border(j)) => Some(self.border.view((i, j), (a.1, b.1)).into_owned()),
            (Place::Chain(..), Place::Border(_)) => None,
            _ => Some(self.block(b, a)?.transpose()),
        }
    }
}

impl TogetherFactor {
    /// Selected blocks, and the leverages of image points, after the factorisation at the values of `state`.
    pub(super) fn selected(
        &mut self,
        frames: &Frames,
        state: State<'_>,
        normal: &Normal,
    ) -> (SelectedFrames, Vec<Leverage>) {
        let linear = normal.frames.as_ref().expect("linearised by frames");
        let steps = frames.steps.len();
        let (m, all) = (frames.shape, frames.border);
        let border = self.border.inverse();
        let chain = &self.chain;
        let mut band = chain.selected_inverse(frames.reach);
        let pieces = self.pieces(frames, linear);
        let mut of_rest = DMatrix::zeros(chain.size(), all - m);
        let mut leverages = Vec::new();
        let mut first = 0;
        while first < steps {
            let start = chain.start(first);
            let mut last = first + 1;
            while last < steps && chain.end(last) - start <= PANEL_COLUMNS {
                last += 1;
            }
            let columns = chain.end(last - 1) - start;
            let parts: Vec<&[f64]> = pieces
                .iter()
                .map(|piece| &piece.as_slice()[start * piece.nrows()..][..columns * piece.nrows()])
                .collect();
            let product = self.border.product(&border, &parts, columns);
            let panel =
                Panel { frames, state, chain, pieces: &pieces, border: &border, product: &product, start };
            let found: Vec<Vec<Leverage>> = band[first..last]
                .par_iter_mut()
                .zip(first..last)
                .map(|(blocks, t)| panel.finish(blocks, t))
                .collect();
            leverages.extend(found.into_iter().flatten());
            of_rest.rows_mut(start, columns).copy_from(&-product.rows(m, all - m).transpose());
            first = last;
        }
        // Back into c, v.
        let turns = frames.turns(linear);
        for (t, blocks) in band.iter_mut().enumerate() {
            for (k, block) in blocks.iter_mut().enumerate() {
                *block = &turns[t + k] * &*block * turns[t].transpose();
            }
            let turned = &turns[t] * of_rest.rows(chain.start(t), turns[t].nrows());
            of_rest.rows_mut(chain.start(t), turns[t].nrows()).copy_from(&turned);
        }
        let starts = (0..steps).map(|t| chain.start(t)).collect();
        (SelectedFrames { band, starts, rest: of_rest, border, shape: m }, leverages)
    }

    /// `X^T` in pieces of rows of the border.
    fn pieces(&self, frames: &Frames, linear: &FramesLinear) -> Vec<DMatrix<f64>> {
        let (m, all) = (frames.shape, frames.border);
        let (chain, rest) = (&self.chain, &self.rest[0]);
        (0..all)
            .step_by(BORDER_ROWS)
            .collect::<Vec<_>>()
            .into_par_iter()
            .map(|first| {
                let rows = BORDER_ROWS.min(all - first);
                let mut piece = DMatrix::zeros(rows, chain.size());
                let shapes = first.min(m)..(first + rows).min(m);
                for (t, &(c, y)) in frames.dims.iter().enumerate() {
                    for (body, at) in (0..y).step_by(POSE).enumerate() {
                        let mut seen = DMatrix::zeros(shapes.len(), POSE);
                        let pose = frames.y_starts[t] / POSE + body;
                        linear.coupling[0].add_columns(pose, shapes.clone(), seen.as_mut_slice());
                        let place = (0, chain.start(t) + c + at);
                        piece.view_mut(place, seen.shape()).copy_from(&seen);
                    }
                }
                for row in shapes.len()..rows {
                    piece.row_mut(row).tr_copy_from(&rest.column(first + row - m));
                }
                chain.solve_rows(&mut piece);
                piece
            })
            .collect()
    }
}

/// Some steps, for which `S^-1 X^T` is made.
struct Panel<'a> {
    frames: &'a Frames,
    state: State<'a>,
    chain: &'a Chain,
    pieces: &'a [DMatrix<f64>],
    border: &'a DMatrix<f64>,
    /// `S^-1 X^T`, and its first column.
    product: &'a DMatrix<f64>,
    start: usize,
}

impl Panel<'_> {
    /// Adds `X S^-1 X^T` to the blocks of a step, and finds the leverages of its image points.
    fn finish(&self, blocks: &mut [DMatrix<f64>], t: usize) -> Vec<Leverage> {
        let Panel { frames, state, chain, pieces, border, product, start } = *self;
        let width = chain.end(t) - chain.start(t);
        let own = product.columns(chain.start(t) - start, width);
        for (k, block) in blocks.iter_mut().enumerate() {
            let mut at = 0;
            for piece in pieces {
                let seen = piece.columns(chain.start(t + k), block.nrows());
                block.gemm_tr(1.0, &seen, &own.rows(at, piece.nrows()), 1.0);
                at += piece.nrows();
            }
        }
        let c = frames.dims[t].0;
        let bodies = frames.steps[t].bodies.iter().enumerate();
        let of_body = bodies.map(|(order, body)| {
            let at = c + POSE * order;
            let seen = Seen {
                pose: blocks[0].fixed_view::<POSE, POSE>(at, at).into_owned(),
                shape: own.columns(at, POSE),
                border,
            };
            leverages_of(frames, state, body, &seen)
        });
        of_body.flatten().collect()
    }
}

/// What image points of a body at a step see of the inverse.
struct Seen<'a> {
    /// The block of `y`.
    pose: Matrix6<f64>,
    /// The block of the border and `y`, its sign turned.
    shape: nalgebra::DMatrixView<'a, f64>,
    border: &'a DMatrix<f64>,
}

fn leverages_of(frames: &Frames, state: State<'_>, body: &BodyAtStep, seen: &Seen<'_>) -> Vec<Leverage> {
    let mut out = Vec::with_capacity(body.items.len());
    let mut local = Local::default();
    for &(group, item) in &body.items {
        local.clear();
        let of_group = &*state.groups[group as usize];
        let flatness = state.curvature.least_flatness;
        let items = [(group, item)];
        of_group.linearise_leaf(&items, body.block, state.layout, state.values, flatness, &mut local);
        let rows = of_group.rows();
        let mut leverage = vec![0.0; rows * rows];
        if let Some(entry) = local.entries.first() {
            let by_pose = DMatrix::from_row_slice(rows, POSE, &local.leaf[..rows * POSE]);
            let mut product = &by_pose * seen.pose * by_pose.transpose();
            let point = local.parts[entry.parts.0..entry.parts.1].iter().find_map(|part| {
                match frames.places[part.position] {
                    Place::Border(at) => Some((at, part.column)),
                    Place::Chain(..) => None,
                }
            });
            if let Some((at, column)) = point {
                let by_point = DMatrix::from_fn(rows, POINT, |row, i| {
                    local.other[entry.other + row * entry.width + column + i]
                });
                let cross = &by_point * seen.shape.rows(at, POINT) * by_pose.transpose();
                product -= &cross + cross.transpose();
                product += &by_point * seen.border.view((at, at), (POINT, POINT)) * by_point.transpose();
            }
            leverage.copy_from_slice(product.as_slice());
        }
        out.push((group, item, leverage));
    }
    out
}
