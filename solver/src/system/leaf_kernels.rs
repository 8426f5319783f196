//! Small dense products and factors of the elimination of [leaves](super::leaves), for sizes that are known when
//! they are compiled. All are inlined into code that is compiled for the machine's vector instructions.

use super::accumulators::Local;
use super::model::clamped;
use crate::linear::matrix::Place;

/// Columns of the reduced system that are updated together.
pub(super) const COLUMNS: usize = 3;
/// Rows that are updated together.
const LANES: usize = 8;

/// Cholesky factor of a leaf, the diagonal inverted.
pub(super) struct LeafFactor<const DE: usize>([[f64; DE]; DE]);

impl<const DE: usize> LeafFactor<DE> {
    /// `L^-1 b`
    #[inline(always)]
    pub(super) fn forward(&self, mut b: [f64; DE]) -> [f64; DE] {
        for r in 0..DE {
            for c in 0..r {
                b[r] -= self.0[r][c] * b[c];
            }
            b[r] *= self.0[r][r];
        }
        b
    }

    /// `L^-T b`
    #[inline(always)]
    pub(super) fn backward(&self, mut b: [f64; DE]) -> [f64; DE] {
        for r in (0..DE).rev() {
            for c in r + 1..DE {
                b[r] -= self.0[c][r] * b[c];
            }
            b[r] *= self.0[r][r];
        }
        b
    }
}

/// Factor of a leaf's damped block, its gradient, and the scale of its damping.
#[inline(always)]
pub(super) fn factor_leaf<const DE: usize>(
    local: &Local,
    free: &[bool],
    damping: f64,
) -> Option<(LeafFactor<DE>, [f64; DE], [f64; DE])> {
    let mut v = [[0.0; DE]; DE];
    let mut gradient = [0.0; DE];
    for (row, r) in local.leaf.as_chunks::<DE>().0.iter().zip(&local.residuals) {
        for a in 0..DE {
            gradient[a] += row[a] * r;
            for b in 0..=a {
                v[a][b] += row[a] * row[b];
            }
        }
    }
    let mut scale = [0.0; DE];
    for a in 0..DE {
        if !free[a] {
            v[a][a] = 1.0;
        }
        scale[a] = clamped(v[a][a]);
        v[a][a] += damping * scale[a];
    }
    for c in 0..DE {
        let mut pivot = v[c][c];
        for k in 0..c {
            pivot -= v[c][k] * v[c][k];
        }
        if pivot.is_nan() || pivot <= 0.0 {
            return None;
        }
        let inverse = 1.0 / pivot.sqrt();
        v[c][c] = inverse;
        for r in c + 1..DE {
            for k in 0..c {
                v[r][c] -= v[r][k] * v[c][k];
            }
            v[r][c] *= inverse;
        }
    }
    Some((LeafFactor(v), gradient, scale))
}

#[inline(always)]
pub(super) fn dot<const N: usize>(a: &[f64; N], b: &[f64; N]) -> f64 {
    let mut sum = 0.0;
    for i in 0..N {
        sum += a[i] * b[i];
    }
    sum
}

#[inline(always)]
pub(super) fn times<const D: usize>(p: &[[f64; 2]; 2], j: &[[f64; D]; 2]) -> [[f64; D]; 2] {
    let mut t = [[0.0; D]; 2];
    for c in 0..D {
        t[0][c] = p[0][0] * j[0][c] + p[0][1] * j[1][c];
        t[1][c] = p[1][0] * j[0][c] + p[1][1] * j[1][c];
    }
    t
}

/// Subtracts `P y` from some columns, `P` column by column.
#[inline(always)]
pub(super) fn subtract_products<const DE: usize>(
    out: [&mut [f64]; COLUMNS],
    panel: [&[f64]; DE],
    y: &[[f64; COLUMNS]; DE],
) {
    let rows = panel[0].len();
    let whole = rows - rows % LANES;
    for at in (0..whole).step_by(LANES) {
        // Copies, so that what is added to is known to be something else.
        let mut sums = [[0.0; LANES]; COLUMNS];
        for c in 0..COLUMNS {
            sums[c].copy_from_slice(&out[c][at..at + LANES]);
        }
        for d in 0..DE {
            let p: &[f64; LANES] = panel[d][at..].first_chunk().expect("whole");
            for c in 0..COLUMNS {
                for i in 0..LANES {
                    sums[c][i] -= p[i] * y[d][c];
                }
            }
        }
        for c in 0..COLUMNS {
            out[c][at..at + LANES].copy_from_slice(&sums[c]);
        }
    }
    for at in whole..rows {
        for c in 0..COLUMNS {
            for d in 0..DE {
                out[c][at] -= panel[d][at] * y[d][c];
            }
        }
    }
}

/// Adds the lower triangle of `a^T b`.
#[inline(always)]
pub(super) fn add_lower<const D: usize>(
    values: &mut [f64],
    place: Place,
    a: &[[f64; D]; 2],
    b: &[[f64; D]; 2],
) {
    for c in 0..D {
        let at = place.column_start(c);
        let column = &mut values[at + c..at + D];
        for (r, out) in (c..D).zip(column) {
            *out += a[0][r] * b[0][c] + a[1][r] * b[1][c];
        }
    }
}
