//! How poses and the points of a shape are coupled: `W`, kept as what image points say of it.
//!
//! ```text
//!            point 0  1  2  3 ...          for each pose the points that it sees,
//!  pose 0  [       x     x                 a block of 6 x 3 each
//!  pose 1  [          x  x  x
//!  ...
//! ```
//!
//! A pose may see a point more than once; its blocks add up.

use super::small::{POINT, POSE};
use nalgebra::DMatrix;
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::Arc;

/// For each number of a point, those of the pose.
pub(crate) type CouplingBlock = [[f64; POSE]; POINT];
/// Blocks that one task takes; fixed, so that sums do not depend on the threads.
const TASK_BLOCKS: usize = 1 << 14;

/// Which points each pose sees.
#[derive(Clone, Debug)]
pub(crate) struct CouplingPattern {
    /// Numbers of the shape.
    rows: usize,
    /// First block of each pose, and their number at the end.
    starts: Vec<usize>,
    /// First number of the point of each block.
    points: Vec<u32>,
    /// The poses of each task.
    tasks: Vec<Range<usize>>,
}

/// `W`.
#[derive(Clone, Debug)]
pub(crate) struct Coupling {
    pattern: Arc<CouplingPattern>,
    blocks: Vec<CouplingBlock>,
}

impl CouplingPattern {
    /// For each pose, in time order, the first numbers of the points that it sees, of a shape of `rows` numbers.
    pub(crate) fn new(rows: usize, poses: impl IntoIterator<Item = Vec<u32>>) -> Self {
        let (mut starts, mut points) = (vec![0], Vec::new());
        let (mut tasks, mut first) = (Vec::new(), 0);
        for (pose, seen) in poses.into_iter().enumerate() {
            assert!(seen.iter().all(|&at| at as usize + POINT <= rows), "points of the shape");
            points.extend(seen);
            starts.push(points.len());
            if points.len() - starts[first] >= TASK_BLOCKS {
                tasks.push(first..pose + 1);
                first = pose + 1;
            }
        }
        if first + 1 < starts.len() {
            tasks.push(first..starts.len() - 1);
        }
        CouplingPattern { rows, starts, points, tasks }
    }

    /// How many poses.
    pub(crate) fn poses(&self) -> usize {
        self.starts.len() - 1
    }

    /// Numbers of the shape.
    pub(crate) fn rows(&self) -> usize {
        self.rows
    }

    /// How many blocks there are.
    pub(crate) fn blocks(&self) -> usize {
        self.points.len()
    }

    /// First numbers of the points that a pose sees.
    pub(crate) fn points(&self, pose: usize) -> &[u32] {
        &self.points[self.starts[pose]..self.starts[pose + 1]]
    }
}

impl Coupling {
    /// Zeros.
    pub(crate) fn zeros(pattern: Arc<CouplingPattern>) -> Self {
        let blocks = vec![[[0.0; POSE]; POINT]; pattern.points.len()];
        Coupling { pattern, blocks }
    }

    /// Which points each pose sees.
    pub(crate) fn pattern(&self) -> &CouplingPattern {
        &self.pattern
    }

    /// The blocks, pose after pose, in the order of the pattern's points.
    pub(crate) fn blocks_mut(&mut self) -> &mut [CouplingBlock] {
        &mut self.blocks
    }

    fn seen(&self, pose: usize) -> impl Iterator<Item = (usize, &CouplingBlock)> {
        let blocks = self.pattern.starts[pose]..self.pattern.starts[pose + 1];
        self.pattern.points(pose).iter().map(|at| *at as usize).zip(&self.blocks[blocks])
    }

    /// Adds the columns of `W^T` that are a pose's to `out`, column after column, of the shape's numbers in
    /// `rows` only. They begin and end with a point.
    #[inline(always)]
    pub(crate) fn add_columns(&self, pose: usize, rows: Range<usize>, out: &mut [f64]) {
        let height = rows.len();
        for (at, block) in self.seen(pose).filter(|(at, _)| rows.contains(at)) {
            let at = at - rows.start;
            for k in 0..POSE {
                let out = &mut out[k * height + at..][..POINT];
                for i in 0..POINT {
                    out[i] += block[i][k];
                }
            }
        }
    }

    /// `out += W^T x` for every column of `x`.
    pub(crate) fn add_transposed_times(&self, x: &DMatrix<f64>, out: &mut DMatrix<f64>) {
        struct Work<'a>(&'a Coupling, Range<usize>, &'a DMatrix<f64>, &'a mut DMatrix<f64>);
        impl WithSimd for Work<'_> {
            type Output = ();
            #[inline(always)]
            fn with_simd<S: Simd>(self, _: S) {
                let Work(coupling, poses, x, out) = self;
                let (n, rows) = (x.nrows(), coupling.pattern.rows);
                // The blocks of a pose stay at hand for all columns.
                for pose in poses {
                    for (x, out) in
                        x.as_slice().chunks_exact(n).zip(out.as_mut_slice().chunks_exact_mut(rows))
                    {
                        let x = &x.as_chunks::<POSE>().0[pose];
                        for (at, block) in coupling.seen(pose) {
                            let out = &mut out[at..at + POINT];
                            for i in 0..POINT {
                                out[i] += (block[i][0] * x[0] + block[i][1] * x[1])
                                    + (block[i][2] * x[2] + block[i][3] * x[3])
                                    + (block[i][4] * x[4] + block[i][5] * x[5]);
                            }
                        }
                    }
                }
            }
        }
        if self.blocks.is_empty() {
            return;
        }
        // The same sums for any number of threads.
        let of_task = |task: &Range<usize>| {
            let mut part = DMatrix::zeros(out.nrows(), out.ncols());
            Arch::new().dispatch(Work(self, task.clone(), x, &mut part));
            part
        };
        let parts: Vec<DMatrix<f64>> = self.pattern.tasks.par_iter().map(of_task).collect();
        parts.iter().for_each(|part| *out += part);
    }

    /// `W s` for every column of `s`.
    pub(crate) fn times(&self, s: &DMatrix<f64>) -> DMatrix<f64> {
        struct Work<'a>(&'a Coupling, Range<usize>, &'a DMatrix<f64>, &'a mut DMatrix<f64>);
        impl WithSimd for Work<'_> {
            type Output = ();
            #[inline(always)]
            fn with_simd<S: Simd>(self, _: S) {
                let Work(coupling, poses, s, out) = self;
                let (n, rows) = (out.nrows(), s.nrows());
                for (place, pose) in poses.enumerate() {
                    let sides = s.as_slice().chunks_exact(rows).zip(out.as_mut_slice().chunks_exact_mut(n));
                    for (s, out) in sides {
                        let mut sum = [0.0; POSE];
                        for (at, block) in coupling.seen(pose) {
                            let s = &s[at..at + POINT];
                            for k in 0..POSE {
                                sum[k] += (block[0][k] * s[0] + block[1][k] * s[1]) + block[2][k] * s[2];
                            }
                        }
                        out.as_chunks_mut::<POSE>().0[place] = sum;
                    }
                }
            }
        }
        let mut out = DMatrix::zeros(POSE * self.pattern.poses(), s.ncols());
        if self.blocks.is_empty() {
            return out;
        }
        let of_task = |task: &Range<usize>| {
            let mut part = DMatrix::zeros(POSE * task.len(), s.ncols());
            Arch::new().dispatch(Work(self, task.clone(), s, &mut part));
            (task.start, part)
        };
        let parts: Vec<(usize, DMatrix<f64>)> = self.pattern.tasks.par_iter().map(of_task).collect();
        for (first, part) in parts {
            out.rows_mut(POSE * first, part.nrows()).copy_from(&part);
        }
        out
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// A coupling in which poses see some points, one of them twice, and `W^T` as a dense matrix.
    pub(crate) fn example(poses: usize, points: usize) -> (Coupling, DMatrix<f64>) {
        let sees = |pose: usize| -> Vec<u32> {
            let seen = (0..points).filter(|point| !(pose * 7 + point * 5).is_multiple_of(3));
            let seen = seen.map(|point| (POINT * point) as u32);
            seen.chain((points > 0).then_some(0)).collect()
        };
        let pattern = CouplingPattern::new(POINT * points, (0..poses).map(sees));
        let mut coupling = Coupling::zeros(Arc::new(pattern));
        for (at, block) in coupling.blocks_mut().iter_mut().enumerate() {
            *block = std::array::from_fn(|i| {
                std::array::from_fn(|k| (0.37 * (at * 18 + i * POSE + k) as f64).cos())
            });
        }
        let mut dense = DMatrix::zeros(POINT * points, POSE * poses);
        for pose in 0..poses {
            for (at, block) in coupling.seen(pose) {
                for i in 0..POINT {
                    for k in 0..POSE {
                        dense[(at + i, POSE * pose + k)] += block[i][k];
                    }
                }
            }
        }
        (coupling, dense)
    }

    #[test]
    fn products_are_those_of_a_dense_matrix() {
        // More blocks than one task takes.
        for (poses, points) in [(5, 4), (300, 90), (0, 3), (3, 0)] {
            let (coupling, dense) = example(poses, points);
            let x = DMatrix::from_fn(POSE * poses, 2, |i, j| ((i + 3 * j) as f64).sin());
            let s = DMatrix::from_fn(POINT * points, 2, |i, j| ((i + 5 * j) as f64).cos());
            let mut found = s.clone();
            coupling.add_transposed_times(&x, &mut found);
            let wanted = &s + &dense * &x;
            assert!((found - &wanted).norm() <= 1e-13 * wanted.norm(), "{poses} {points}");
            let wanted = dense.transpose() * &s;
            assert!((coupling.times(&s) - &wanted).norm() <= 1e-13 * wanted.norm(), "{poses} {points}");
            if points > 3 {
                let rows = 3..3 * points - 3;
                for pose in 0..poses {
                    let mut columns = vec![1.0; POSE * rows.len()];
                    coupling.add_columns(pose, rows.clone(), &mut columns);
                    let found = DMatrix::from_vec(rows.len(), POSE, columns);
                    let wanted = dense.view((rows.start, POSE * pose), found.shape()).add_scalar(1.0);
                    assert!((found - wanted).amax() < 1e-14);
                }
            }
        }
        assert!(example(300, 90).0.pattern.tasks.len() > 1);
    }
}
