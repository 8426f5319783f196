//! Selected blocks of the inverse of the normal matrix, and the leverages of all measurements, whichever way the
//! system is eliminated.

use super::factors::Factors;
use super::factors::Kind as FactorKind;
use super::layout::{BlockId, GroupId, Values};
use super::least_squares::System;
use super::model::Curvature;
use super::normal::Normal;
use super::selected_frames::SelectedFrames;
use nalgebra::DMatrix;

/// The most unknowns of which the whole inverse is made, where frames are not eliminated first.
const MOST_WHOLE: usize = 8000;

/// Blocks of the inverse of the normal matrix of a system at one state, and the leverage `J Q J^T` of
/// every measurement.
pub(crate) struct SelectedInverse {
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
    pub(crate) fn new(
        system: &System,
        values: &Values,
        normal: &Normal,
        factors: &mut Factors,
    ) -> Option<Self> {
        let common = factors.common.of_inverse();
        let (kind, of_frames) = match &mut factors.kind {
            FactorKind::Sparse { cholesky, .. } => {
                let n = system.pattern.size();
                if n > MOST_WHOLE || system.leaves.is_some() {
                    return None;
                }
                let mut whole = DMatrix::identity(n, n);
                cholesky.solve(whole.as_mut_slice());
                (Kind::Whole(whole), Vec::new())
            }
            FactorKind::Frames(factor) => {
                let frames = system.frames.as_ref()?;
                let (selected, leverages) =
                    factor.selected(frames, system.state(values, Curvature::PLAIN), normal)?;
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
            of.column_iter().map(|column| group.product(&system.layout, values, column.as_slice())).collect()
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
    pub(crate) fn block(&self, system: &System, a: BlockId, b: BlockId) -> Option<DMatrix<f64>> {
        let (of_a, of_b) = (system.range_of(a)?, system.range_of(b)?);
        let is_common = system.layout.common.has(a.0) || system.layout.common.has(b.0);
        let mut block = match &self.kind {
            _ if is_common => DMatrix::zeros(of_a.len(), of_b.len()),
            Kind::Whole(whole) => whole.view((of_a.start, of_b.start), (of_a.len(), of_b.len())).into_owned(),
            Kind::Frames(selected) => {
                let places = &system.frames.as_ref()?.places;
                let place = |block: BlockId| Some(places[system.layout.position[block.0]?]);
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
    pub(crate) fn leverages(&self, group: GroupId) -> &[f64] {
        &self.leverages[group.0]
    }

    /// The measurements of a group, in their order: what each sees that is not held whole, and its whitened,
    /// weighted Jacobian by it. Empty for image points that frames take care of.
    pub(crate) fn jacobians(
        system: &System,
        normal: &Normal,
        group: GroupId,
    ) -> Vec<Vec<(BlockId, DMatrix<f64>)>> {
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
