//! The factors of [frames](super::frames), whichever way bodies are eliminated, and solutions with them.

use super::apart::ApartFactor;
use super::frames::Frames;
use super::frames_linear::FramesLinear;
use super::group::State;
use super::normal::Normal;
use super::selected_frames::{Leverage, SelectedFrames};
use super::time_steps::Place;
use super::together::TogetherFactor;
use crate::linear::cholesky::{Singular, TooLarge};
use crate::linear::small::{POINT, POSE};
use nalgebra::{DMatrix, Vector6};

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
pub(super) struct FramesFactor {
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
        state: State<'_>,
        normal: &Normal,
    ) -> Option<(SelectedFrames, Vec<Leverage>)> {
        match &mut self.kind {
            Kind::Together(factor) => Some(factor.selected(frames, state, normal)),
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
        for &(at, start) in &self.points {
            shape.rows_mut(at, POINT).copy_from_slice(&x[start..start + POINT]);
        }
        let ys = self.multiply_poses(normal, linear, &shape, x, &mut product);
        let of_shape = self.multiply_shape(linear, &shape, &ys);
        for &(at, start) in &self.points {
            for i in 0..POINT {
                product[start + i] += of_shape[at + i];
            }
        }
        product
    }

    /// Adds what image points say of poses, and returns the `y` of each home.
    fn multiply_poses(
        &self,
        normal: &Normal,
        linear: &FramesLinear,
        shape: &DMatrix<f64>,
        x: &[f64],
        product: &mut [f64],
    ) -> Vec<DMatrix<f64>> {
        let starts = self.starts_of_poses(normal);
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
        ys
    }

    /// Where the blocks of each step stand in the pattern, in the order c, v.
    fn starts_of_poses(&self, normal: &Normal) -> Vec<Vec<usize>> {
        let mut starts: Vec<Vec<usize>> = self.steps.iter().map(|s| vec![0; s.bodies.len() + 1]).collect();
        for (position, place) in self.places.iter().enumerate() {
            if let Place::Chain(t, at) = *place {
                let order = at / POSE + usize::from(self.dims[t].0 == 0);
                starts[t][order] = normal.matrix.range(position).start;
            }
        }
        starts
    }

    /// What image points say of the shape.
    fn multiply_shape(
        &self,
        linear: &FramesLinear,
        shape: &DMatrix<f64>,
        ys: &[DMatrix<f64>],
    ) -> DMatrix<f64> {
        let mut of_shape = DMatrix::zeros(self.shape, 1);
        for ((home, coupling), y) in self.homes.iter().zip(&linear.coupling).zip(ys) {
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
        of_shape
    }
}
