//! Selected blocks of the inverse of the normal matrix, frames first.
//!
//! With the chain `H` of [`super::together`], its coupling `X = H^-1 [W V]` to the border, and the border's
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

use super::factors::Kind as FactorKind;
use super::frames::{BodyAtStep, Frames, Place};
use super::leaves::Local;
use super::together::TogetherFactor;
use super::{BlockId, Curvature, Factors, GroupId, Normal, System, Values};
use crate::linear::small::{POINT, POSE};
use nalgebra::{DMatrix, Matrix6};
use rayon::prelude::*;

/// Rows of the border that one task solves for, whole points.
const BORDER_ROWS: usize = 126;
/// Columns of `X S^-1` that are made at a time.
const PANEL_COLUMNS: usize = 384;

/// The most unknowns of which the whole inverse is made, where frames are not eliminated first.
const MOST_WHOLE: usize = 8000;

/// Blocks of the inverse of the normal matrix of a system at one state, and the leverage `J Q J^T` of
/// every measurement.
pub struct SelectedInverse {
    kind: Kind,
    /// `X` and `X S^-1` of what is common to all frames ([`super::common`]).
    common: Option<(DMatrix<f64>, DMatrix<f64>)>,
    /// For each group, measurement after measurement.
    leverages: Vec<Vec<f64>>,
}

enum Kind {
    Whole(DMatrix<f64>),
    Frames(SelectedFrames),
}

impl SelectedInverse {
    /// From the factors of `normal`, which was linearised at `values` and is not damped. `None` where the
    /// way in which the system is eliminated has no such inverse.
    pub fn new(system: &System, values: &Values, normal: &Normal, factors: &mut Factors) -> Option<Self> {
        let common = factors.common.of_inverse();
        let (kind, of_frames) = match &mut factors.kind {
            FactorKind::Sparse { cholesky, .. } => {
                let n = system.pattern.size();
                if n > MOST_WHOLE || system.has_leaves() {
                    return None;
                }
                let mut whole = DMatrix::identity(n, n);
                cholesky.solve(whole.as_mut_slice());
                (Kind::Whole(whole), Vec::new())
            }
            FactorKind::Frames(factor) => {
                let frames = system.frames.as_ref()?;
                let (selected, leverages) = factor.selected(frames, system, values, normal)?;
                (Kind::Frames(selected), leverages)
            }
        };
        let mut inverse = SelectedInverse { kind, common, leverages: Vec::new() };
        let of_group = |group: usize| inverse.leverages_of_group(system, normal, group);
        inverse.leverages = (0..system.groups.len()).map(of_group).collect();
        for (group, item, leverage) in of_frames {
            let size = leverage.len();
            inverse.leverages[group as usize][item as usize * size..][..size].copy_from_slice(&leverage);
        }
        if inverse.common.is_some() {
            (0..system.groups.len())
                .filter(|group| normal.linear[*group].is_none())
                .for_each(|group| inverse.add_common_to_leverages(system, values, group));
        }
        Some(inverse)
    }

    /// What frames do not know: `J X S^-1 X^T J^T` of image points.
    fn add_common_to_leverages(&mut self, system: &System, values: &Values, index: usize) {
        let Some((x, solved)) = &self.common else { return };
        let group = &system.groups[index];
        let rows = group.rows();
        let times = |of: &DMatrix<f64>| -> Vec<Vec<f64>> {
            of.column_iter().map(|column| group.product(system, values, column.as_slice())).collect()
        };
        let (of_x, of_solved) = (times(x), times(solved));
        for (item, out) in self.leverages[index].chunks_exact_mut(rows * rows).enumerate() {
            for (of_x, of_solved) in of_x.iter().zip(&of_solved) {
                for column in 0..rows {
                    for row in 0..rows {
                        out[column * rows + row] += of_x[item * rows + row] * of_solved[item * rows + column];
                    }
                }
            }
        }
    }

    /// The block of the inverse between two blocks of unknowns; zero where a component is held, and `None`
    /// where one is held whole or the pair was not selected. Selected are pairs that share a measurement
    /// other than an image point, and all pairs without a pose.
    pub fn block(&self, system: &System, a: BlockId, b: BlockId) -> Option<DMatrix<f64>> {
        let (of_a, of_b) = (system.range_of(a)?, system.range_of(b)?);
        let is_common = system.common.has(a.0) || system.common.has(b.0);
        let mut block = match &self.kind {
            _ if is_common => DMatrix::zeros(of_a.len(), of_b.len()),
            Kind::Whole(whole) => whole.view((of_a.start, of_b.start), (of_a.len(), of_b.len())).into_owned(),
            Kind::Frames(selected) => {
                let places = &system.frames.as_ref()?.places;
                let place = |block: BlockId| Some(places[system.position[block.0]?]);
                selected.block((place(a)?, of_a.len()), (place(b)?, of_b.len()))?
            }
        };
        if let Some((x, solved)) = &self.common {
            let (x, solved) = (x.rows(of_a.start, of_a.len()), solved.rows(of_b.start, of_b.len()));
            block += x * solved.transpose();
        }
        for (row, _) in system.free(a).iter().enumerate().filter(|(_, free)| !**free) {
            block.row_mut(row).fill(0.0);
        }
        for (column, _) in system.free(b).iter().enumerate().filter(|(_, free)| !**free) {
            block.column_mut(column).fill(0.0);
        }
        Some(block)
    }

    /// The leverages of a group: for each measurement `J Q J^T` of its whitened, weighted rows, column by
    /// column. Its diagonal is 1 minus the redundancy numbers.
    pub fn leverages(&self, group: GroupId) -> &[f64] {
        &self.leverages[group.0]
    }

    /// The measurements of a group, in their order: what each sees that is not held whole, and its whitened,
    /// weighted Jacobian by it. Empty for image points that frames take care of.
    pub fn jacobians(system: &System, normal: &Normal, group: GroupId) -> Vec<Vec<(BlockId, DMatrix<f64>)>> {
        let Some(linear) = &normal.linear[group.0] else { return Vec::new() };
        let group = &system.groups[group.0];
        let starts = group.column_starts();
        let of_item = |item: usize| {
            let seen = group.blocks(item).iter().zip(&starts);
            seen.filter_map(|(block, start)| {
                let count = system.range_of(*block)?.len();
                let columns = linear.columns(item, *start, count);
                Some((*block, DMatrix::from_column_slice(group.rows(), count, columns)))
            })
            .collect()
        };
        (0..group.len()).map(of_item).collect()
    }

    fn leverages_of_group(&self, system: &System, normal: &Normal, index: usize) -> Vec<f64> {
        let group = &system.groups[index];
        let rows = group.rows();
        let mut out = vec![0.0; group.len() * rows * rows];
        if normal.linear[index].is_none() {
            return out;
        }
        let jacobians = SelectedInverse::jacobians(system, normal, GroupId(index));
        for (seen, out) in jacobians.iter().zip(out.chunks_exact_mut(rows * rows)) {
            let mut sum = DMatrix::zeros(rows, rows);
            for (a, by_a) in seen {
                for (b, by_b) in seen {
                    // What frames see was taken care of.
                    let Some(block) = self.block(system, *a, *b) else { continue };
                    sum += by_a * block * by_b.transpose();
                }
            }
            out.copy_from_slice(sum.as_slice());
        }
        out
    }
}

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
    pub fn block(&self, a: (Place, usize), b: (Place, usize)) -> Option<DMatrix<f64>> {
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
    /// Selected blocks, and the leverages of image points, after the factorisation at `values`.
    pub fn selected(
        &mut self,
        frames: &Frames,
        system: &System,
        values: &Values,
        normal: &Normal,
    ) -> (SelectedFrames, Vec<Leverage>) {
        let linear = normal.frames.as_ref().expect("linearised by frames");
        let steps = frames.steps.len();
        let (m, all) = (frames.shape, frames.border);
        let border = self.border.inverse();
        let chain = &self.chain;
        let mut band = chain.selected_inverse(frames.reach);
        // X^T in pieces of rows of the border.
        let rest = &self.rest[0];
        let pieces: Vec<DMatrix<f64>> = (0..all)
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
            .collect();

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
            // S^-1 X^T
            let panel = self.border.product(&border, &parts, columns);
            let found: Vec<Vec<Leverage>> = band[first..last]
                .par_iter_mut()
                .zip(first..last)
                .map(|(blocks, t)| {
                    let width = chain.end(t) - chain.start(t);
                    let own = panel.columns(chain.start(t) - start, width);
                    for (k, block) in blocks.iter_mut().enumerate() {
                        let mut at = 0;
                        for piece in &pieces {
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
                            border: &border,
                        };
                        leverages_of(frames, system, values, body, &seen)
                    });
                    of_body.flatten().collect()
                })
                .collect();
            leverages.extend(found.into_iter().flatten());
            of_rest.rows_mut(start, columns).copy_from(&-panel.rows(m, all - m).transpose());
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
}

/// What image points of a body at a step see of the inverse.
struct Seen<'a> {
    /// The block of `y`.
    pose: Matrix6<f64>,
    /// The block of the border and `y`, its sign turned.
    shape: nalgebra::DMatrixView<'a, f64>,
    border: &'a DMatrix<f64>,
}

fn leverages_of(
    frames: &Frames,
    system: &System,
    values: &Values,
    body: &BodyAtStep,
    seen: &Seen<'_>,
) -> Vec<Leverage> {
    let mut out = Vec::with_capacity(body.items.len());
    let mut local = Local::default();
    for &(group, item) in &body.items {
        local.clear();
        system.groups[group as usize].linearise_leaf(
            &[(group, item)],
            body.block,
            system,
            values,
            Curvature::PLAIN.least_flatness,
            &mut local,
        );
        let rows = system.groups[group as usize].rows();
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
