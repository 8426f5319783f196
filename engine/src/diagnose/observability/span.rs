//! The span of candidates: which of their combinations rows leave open, and what those are called.
//!
//! Perturbations are scaled by the norms of the columns of the Jacobian, `D`, so that a number is as good as
//! any other. Candidates `Z` are made orthonormal one after the other, `D Z = Q R`, and one that depends on
//! those before it is dropped. The singular values of `J D^-1 Q` are then those of the Jacobian restricted to
//! the span, and `a = R^-1 b` what a combination `Q b` has of each candidate.

use super::Kind;
use super::candidates::Candidate;
use super::rows::Rows;
use nalgebra::{DMatrix, DVector};
use std::ops::Range;
use trackbundle_solver::Spectrum;

/// A candidate of which less than this is left, beside those before it, is one of their combinations.
const DEPENDENT: f64 = 1e-7;
/// A combination with at least this share of a scale or a depth, among others by which bodies move as far, is
/// called by it: a shape that grows is more than a convention.
const SHARE_OF_SHAPE: f64 = 0.02;
/// The same for a frame or a pose.
const SHARE_OF_FRAME: f64 = 0.3;

/// Independent candidates and an orthonormal basis of their span.
pub struct Span {
    /// What each is.
    pub kinds: Vec<Kind>,
    basis: DMatrix<f64>,
    triangle: DMatrix<f64>,
}

/// A direction in a span.
pub struct Named {
    /// What it is called.
    pub kind: Kind,
    /// What it has of the columns of the basis, of unit length.
    pub along: DVector<f64>,
}

impl Span {
    /// The span of candidates, in order of preference.
    pub fn new(candidates: &[Candidate], norms: &[f64]) -> Span {
        let mut kinds = Vec::new();
        let mut basis: Vec<DVector<f64>> = Vec::new();
        let mut triangle: Vec<Vec<f64>> = Vec::new();
        for candidate in candidates {
            let mut left = candidate.motion.clone();
            left.iter_mut().zip(norms).for_each(|(x, norm)| *x *= norm);
            let length = left.norm();
            let mut along = vec![0.0; basis.len()];
            for _ in 0..2 {
                for (axis, sum) in basis.iter().zip(&mut along) {
                    let part = axis.dot(&left);
                    left.axpy(-part, axis, 1.0);
                    *sum += part;
                }
            }
            let rest = left.norm();
            if rest.is_finite() && rest > DEPENDENT * length {
                along.push(rest);
                basis.push(left / rest);
                triangle.push(along);
                kinds.push(candidate.kind.clone());
            }
        }
        let number = basis.len();
        let triangle = DMatrix::from_fn(number, number, |i, j| triangle[j].get(i).copied().unwrap_or(0.0));
        let basis = match number {
            0 => DMatrix::zeros(norms.len(), 0),
            _ => DMatrix::from_columns(&basis),
        };
        Span { kinds, basis, triangle }
    }

    /// How many directions it has.
    pub fn len(&self) -> usize {
        self.kinds.len()
    }

    /// Some rows restricted to the span.
    pub fn restricted(&self, rows: &Rows, some: &[usize], norms: &[f64]) -> DMatrix<f64> {
        let mut scaled = self.basis.clone();
        for (mut row, norm) in scaled.row_iter_mut().zip(norms) {
            row /= *norm;
        }
        rows.times(some, &scaled)
    }

    /// Of lists of rows by coordinate, the rows that see anything of the span, in order.
    pub fn seen_by(&self, of_coordinates: &[Vec<usize>]) -> Vec<usize> {
        let moves = |at: &usize| self.basis.row(*at).iter().any(|x| *x != 0.0);
        let mut rows: Vec<usize> =
            (0..self.basis.nrows()).filter(moves).flat_map(|at| of_coordinates[at].iter().copied()).collect();
        rows.sort_unstable();
        rows.dedup();
        rows
    }

    /// The scaled perturbation of a combination.
    pub fn perturbation(&self, along: &DVector<f64>) -> DVector<f64> {
        &self.basis * along
    }

    /// The combination that is nearest to a scaled perturbation.
    pub fn along(&self, perturbation: &DVector<f64>) -> DVector<f64> {
        self.basis.tr_mul(perturbation)
    }

    /// Names for directions that combinations span, and the direction that each stands for: candidates are
    /// asked in order, and the first of which the combinations have a substantial share names one of them; the
    /// others then have nothing of it.
    pub fn names(&self, combinations: &DMatrix<f64>) -> Vec<Named> {
        let Some(parts) = self.triangle.solve_upper_triangular(combinations) else { return Vec::new() };
        let mut parts = orthonormal(&parts);
        let mut named = Vec::new();
        let mut is_free = vec![true; self.len()];
        let wanted = parts.ncols();
        let mut take = |at: usize, parts: &mut DMatrix<f64>, is_free: &mut [bool]| {
            let row = parts.row(at).transpose();
            let row = &row / row.norm();
            let direction = &*parts * &row;
            *parts -= &direction * row.transpose();
            is_free[at] = false;
            let along = &self.triangle * direction;
            let length = along.norm();
            named.push(Named { kind: self.kinds[at].clone(), along: along / length });
        };
        let mut number = 0;
        for at in 0..self.len() {
            let least = match self.kinds[at] {
                Kind::Scale { .. } | Kind::WorldScale | Kind::PointDepth { .. } => SHARE_OF_SHAPE,
                _ => SHARE_OF_FRAME,
            };
            if number < wanted && parts.row(at).norm() > least {
                take(at, &mut parts, &mut is_free);
                number += 1;
            }
        }
        while number < wanted {
            let left = (0..self.len()).filter(|at| is_free[*at]);
            let largest = left.max_by(|a, b| parts.row(*a).norm().total_cmp(&parts.row(*b).norm()));
            let Some(at) = largest.filter(|at| parts.row(*at).norm() > 0.0) else { break };
            take(at, &mut parts, &mut is_free);
            number += 1;
        }
        named
    }
}

/// The singular values of rows as shares of `largest`, and their combinations.
pub struct Shares {
    /// The shares, largest first.
    pub values: Vec<f64>,
    vectors: DMatrix<f64>,
}

impl Shares {
    /// As shares of the largest of them, which is returned with them.
    pub fn of_its_largest(rows: &DMatrix<f64>) -> Option<(Shares, f64)> {
        let mut shares = Shares::of(rows, 1.0)?;
        let largest = shares.values.first().copied().unwrap_or(0.0);
        if largest > 0.0 {
            shares.values.iter_mut().for_each(|value| *value /= largest);
        }
        Some((shares, largest))
    }

    /// `None` where a number is none.
    pub fn of(rows: &DMatrix<f64>, largest: f64) -> Option<Shares> {
        let Spectrum { values, vectors } = Spectrum::of(rows).ok()??;
        let share = |value: f64| if largest > 0.0 { value / largest } else { 0.0 };
        Some(Shares { values: values.into_iter().map(share).collect(), vectors })
    }

    /// Combinations whose share lies in a range.
    pub fn within(&self, range: Range<f64>) -> DMatrix<f64> {
        let chosen: Vec<usize> =
            (0..self.values.len()).filter(|i| range.contains(&self.values[*i])).collect();
        self.vectors.select_columns(&chosen)
    }
}

/// Columns made orthonormal; those that depend on others are dropped.
pub fn orthonormal(columns: &DMatrix<f64>) -> DMatrix<f64> {
    let mut out: Vec<DVector<f64>> = Vec::new();
    for column in columns.column_iter() {
        let length = column.norm();
        let mut left: DVector<f64> = column / if length > 0.0 { length } else { 1.0 };
        for _ in 0..2 {
            for other in &out {
                let part = other.dot(&left);
                left.axpy(-part, other, 1.0);
            }
        }
        let rest = left.norm();
        if rest > DEPENDENT {
            out.push(left / rest);
        }
    }
    if out.is_empty() { DMatrix::zeros(columns.nrows(), 0) } else { DMatrix::from_columns(&out) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn candidate(kind: Kind, motion: [f64; 3]) -> Candidate {
        Candidate { kind, motion: DVector::from_row_slice(&motion) }
    }

    fn shift(axis: usize) -> Kind {
        Kind::BodyFrame { vehicle: 0, freedom: super::super::DatumFreedom::Shift, axis }
    }

    #[test]
    fn a_combination_of_others_is_no_candidate() {
        let candidates = [
            candidate(Kind::Scale { vehicle: 0 }, [1.0, 0.0, 0.0]),
            candidate(shift(0), [1.0, 1.0, 0.0]),
            candidate(shift(1), [0.0, -3.0, 0.0]),
            candidate(shift(2), [0.0, 0.0, 1e-3]),
        ];
        let span = Span::new(&candidates, &[2.0, 1.0, 5.0]);
        assert_eq!(span.kinds, [Kind::Scale { vehicle: 0 }, shift(0), shift(2)]);
    }

    /// A scale that goes with a shift twenty times as large is a scale; a shift of another axis is one by itself.
    #[test]
    fn a_combination_is_named_by_the_first_that_has_a_share() {
        let candidates = [
            candidate(Kind::Scale { vehicle: 0 }, [1.0, 0.0, 0.0]),
            candidate(shift(0), [0.0, 1.0, 0.0]),
            candidate(shift(1), [0.0, 0.0, 1.0]),
        ];
        let span = Span::new(&candidates, &[1.0; 3]);
        let named = |columns: &[[f64; 3]]| -> Vec<Kind> {
            let columns: Vec<DVector<f64>> = columns.iter().map(|c| DVector::from_row_slice(c)).collect();
            span.names(&DMatrix::from_columns(&columns)).into_iter().map(|named| named.kind).collect()
        };
        assert_eq!(named(&[[1.0, 20.0, 0.0]]), [Kind::Scale { vehicle: 0 }]);
        assert_eq!(named(&[[0.0, 1.0, 0.1]]), [shift(0)]);
        assert_eq!(named(&[[0.0, 0.1, 1.0]]), [shift(1)]);
        // Less than its share.
        assert_eq!(named(&[[1.0, 100.0, 0.0]]), [shift(0)]);
        assert_eq!(named(&[[0.0, 0.0, 1.0], [1.0, 20.0, 0.0]]), [Kind::Scale { vehicle: 0 }, shift(1)]);
    }
}
