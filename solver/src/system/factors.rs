//! The factors of the normal matrix, whichever way it is eliminated.

use super::common::CommonFactor;
use super::frames::Frames;
use super::frames_factor::{Accuracy, FramesFactor};
use super::least_squares::System;
use super::normal::Normal;
use crate::linear::cholesky::{Cholesky, Singular, TooLarge};
use crate::linear::matrix::BlockMatrix;
use nalgebra::DMatrix;

/// The factors of the normal matrix of a system.
pub struct Factors {
    pub(super) kind: Kind,
    pub(super) common: CommonFactor,
}

/// Those of all but what is common to all frames.
pub(super) enum Kind {
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
        let common = CommonFactor::default();
        if let Some(frames) = &system.frames {
            return Ok(Factors { kind: Kind::Frames(Box::new(FramesFactor::new(frames)?)), common });
        }
        let cholesky = Box::new(Cholesky::analyse(&system.pattern)?);
        let damped = (!system.has_eliminated_blocks()).then(|| BlockMatrix::zeros(system.pattern.clone()));
        Ok(Factors { kind: Kind::Sparse { damped, cholesky }, common })
    }

    /// Factorises the normal matrix with `extra` on its diagonal.
    pub fn factorise(&mut self, system: &System, normal: &mut Normal, extra: &[f64]) -> Result<(), Singular> {
        let (extra, of_common) = extra.split_at(system.pattern.size());
        match &mut self.kind {
            Kind::Sparse { damped: Some(damped), cholesky } => {
                damped.copy_with_diagonal(&normal.matrix, extra);
                cholesky.factorise(damped)?;
            }
            Kind::Sparse { damped: None, cholesky } => {
                normal.matrix.add_to_diagonal(extra);
                cholesky.factorise(&normal.matrix)?;
            }
            Kind::Frames(factor) => factor.factorise(frames_of(system), normal, extra)?,
        }
        if system.layout.common.size() > 0 {
            let mut solved = normal.common.coupling.clone();
            self.kind.solve(system, normal, Accuracy::Exact, solved.as_mut_slice());
            self.common.factorise(&normal.common, solved, of_common)?;
        }
        Ok(())
    }

    /// Factorises as far as a step needs it, and solves for one, in place, to this accuracy or better.
    pub fn step(
        &mut self,
        system: &System,
        normal: &mut Normal,
        extra: &[f64],
        accuracy: Accuracy,
        b: &mut [f64],
    ) -> Result<(), Singular> {
        match (&mut self.kind, accuracy, &system.frames) {
            (Kind::Frames(factor), Accuracy::Share(share), Some(frames))
                if system.layout.common.size() == 0 =>
            {
                factor.step(frames, normal, extra, share, b)
            }
            _ => {
                self.factorise(system, normal, extra)?;
                self.solve(system, normal, accuracy, b);
                Ok(())
            }
        }
    }

    /// Makes what the last step did without.
    pub fn complete(&mut self, system: &System, normal: &Normal) -> Result<(), Singular> {
        match (&mut self.kind, &system.frames) {
            (Kind::Frames(factor), Some(frames)) => factor.complete(frames, normal),
            _ => Ok(()),
        }
    }

    /// Solves for right-hand sides in elimination order, in place.
    pub fn solve(&mut self, system: &System, normal: &Normal, accuracy: Accuracy, b: &mut [f64]) {
        let (n, k) = (system.pattern.size(), system.layout.common.size());
        if k == 0 {
            return self.kind.solve(system, normal, accuracy, b);
        }
        let sides = b.len() / (n + k);
        let whole = DMatrix::from_column_slice(n + k, sides, b);
        let (mut others, mut common) = (whole.rows(0, n).into_owned(), whole.rows(n, k).into_owned());
        self.kind.solve(system, normal, accuracy, others.as_mut_slice());
        self.common.finish(&normal.common, &mut others, &mut common);
        for (side, b) in b.chunks_exact_mut(n + k).enumerate() {
            b[..n].copy_from_slice(others.column(side).as_slice());
            b[n..].copy_from_slice(common.column(side).as_slice());
        }
    }
}

impl Kind {
    fn solve(&mut self, system: &System, normal: &Normal, accuracy: Accuracy, b: &mut [f64]) {
        match self {
            Kind::Sparse { cholesky, .. } => cholesky.solve(b),
            Kind::Frames(factor) => factor.solve(frames_of(system), normal, accuracy, b),
        }
    }
}

fn frames_of(system: &System) -> &Frames {
    system.frames.as_ref().expect("poses are eliminated along time")
}
