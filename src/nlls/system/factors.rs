//! The factors of the normal matrix, whichever way it is eliminated.

use super::{Accuracy, FramesFactor, Normal, System};
use crate::nlls::linear::cholesky::{Cholesky, Singular, TooLarge};
use crate::nlls::linear::matrix::BlockMatrix;

/// The factors of the normal matrix of a system.
pub enum Factors {
    /// Sparse.
    Sparse {
        /// The damped matrix, where it is not formed with its damping at once.
        damped: Option<BlockMatrix>,
        /// Its factor.
        cholesky: Box<Cholesky>,
    },
    /// Frames first.
    Frames(Box<FramesFactor>),
}

impl Factors {
    /// Room for the factors of a system; what depends on its structure alone is done here.
    pub fn new(system: &System) -> Result<Self, TooLarge> {
        if system.has_frames() {
            return Ok(Factors::Frames(Box::new(system.frames_factor()?)));
        }
        let cholesky = Box::new(Cholesky::analyse(system.pattern())?);
        let damped = (!system.has_leaves()).then(|| BlockMatrix::zeros(system.pattern.clone()));
        Ok(Factors::Sparse { damped, cholesky })
    }

    /// Factorises the normal matrix with `extra` on its diagonal.
    pub fn factorise(&mut self, system: &System, normal: &mut Normal, extra: &[f64]) -> Result<(), Singular> {
        match self {
            Factors::Sparse { damped: Some(damped), cholesky } => {
                damped.copy_with_diagonal(&normal.matrix, extra);
                cholesky.factorise(damped)
            }
            Factors::Sparse { damped: None, cholesky } => {
                normal.matrix.add_to_diagonal(extra);
                cholesky.factorise(&normal.matrix)
            }
            Factors::Frames(factor) => system.factorise_frames(normal, extra, factor),
        }
    }

    /// Solves for right-hand sides in elimination order, in place.
    pub fn solve(&mut self, system: &System, normal: &Normal, accuracy: Accuracy, b: &mut [f64]) {
        match self {
            Factors::Sparse { cholesky, .. } => cholesky.solve(b),
            Factors::Frames(factor) => system.solve_frames(normal, factor, accuracy, b),
        }
    }
}
