//! Robust losses: what a large residual is allowed to cost.
//!
//! A loss is a function `rho` of the squared norm `s = |r|^2` of a whitened residual; the cost of
//! the measurement is `rho(s) / 2`. Its slope `rho'(s)` is the weight that the measurement keeps:
//! 1 for a good one, 0 for one that no longer counts.

use std::fmt;
use std::str::FromStr;

/// The losses on offer. `scale` is in standard deviations of the whitened residual's norm.
///
/// Laws, for every loss: `rho(0) = 0`; `rho'(0) = 1`; `rho'` is the slope of `rho` and `rho''`
/// that of `rho'`; `rho' >= 0`.
///
/// Sources: Huber (1964); Black and Anandan, IJCV 19 (1996) for Tukey, Cauchy (Lorentzian) and
/// Geman-McClure; Barron, *A general and adaptive robust loss function*, CVPR 2019, equation (8).
///
/// ```
/// use trackbundle_solver::Loss;
///
/// let loss = Loss::Huber { scale: 2.0 };
/// assert_eq!(loss.weight(1.0), 1.0);
/// // Ten standard deviations off: a fifth of its weight is left.
/// assert_eq!(loss.weight(100.0), 0.2);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Loss {
    /// `s`: least squares.
    Squared,
    /// `s` up to `scale^2`, then linear in the norm.
    Huber {
        /// The norm where it turns linear.
        scale: f64,
    },
    /// `c^2 ln(1 + s / c^2)`.
    Cauchy {
        /// `c`.
        scale: f64,
    },
    /// Bisquare: constant beyond `scale`.
    Tukey {
        /// The norm from which on a measurement is rejected.
        scale: f64,
    },
    /// `s / (1 + s / c^2)`.
    GemanMcClure {
        /// `c`.
        scale: f64,
    },
    /// Barron's family: `shape` 2 is squared, 1 a smooth Huber, 0 Cauchy, -2 Geman-McClure,
    /// negative infinity Welsch.
    Barron {
        /// `alpha <= 2`.
        shape: f64,
        /// `c`.
        scale: f64,
    },
}

impl Loss {
    /// `[rho, rho', rho'']` at `s >= 0`.
    #[inline(always)]
    pub fn rho(&self, s: f64) -> [f64; 3] {
        match *self {
            Loss::Squared => [s, 1.0, 0.0],
            Loss::Huber { scale: k } => {
                if s <= k * k {
                    [s, 1.0, 0.0]
                } else {
                    let norm = s.sqrt();
                    [2.0 * k * norm - k * k, k / norm, -0.5 * k / (norm * s)]
                }
            }
            Loss::Cauchy { scale: c } => {
                let ratio = s / (c * c);
                let weight = 1.0 / (1.0 + ratio);
                [c * c * ratio.ln_1p(), weight, -weight * weight / (c * c)]
            }
            Loss::Tukey { scale: c } => {
                let left = 1.0 - s / (c * c);
                if left > 0.0 {
                    let rho = s * (1.0 + left + left * left) / 3.0;
                    [rho, left * left, -2.0 * left / (c * c)]
                } else {
                    [c * c / 3.0, 0.0, 0.0]
                }
            }
            Loss::GemanMcClure { scale: c } => {
                let weight = 1.0 / (1.0 + s / (c * c));
                let slope = weight * weight;
                [s * weight, slope, -2.0 * slope * weight / (c * c)]
            }
            Loss::Barron { shape, scale } => barron(s, shape, scale),
        }
    }

    /// The weight `rho'(s)` that a measurement of squared norm `s` keeps.
    #[inline(always)]
    pub fn weight(&self, s: f64) -> f64 {
        self.rho(s)[1]
    }

    /// Curvature of the cost along a residual as a share of that across it, `1 + 2 s rho'' / rho'`:
    /// what a Newton step sees of a measurement along its residual. At least `least`, which must be
    /// above zero: the curvature of a loss that redescends is negative far out.
    #[inline(always)]
    pub fn flatness(&self, s: f64, least: f64) -> f64 {
        if least >= 1.0 || matches!(self, Loss::Squared) {
            return 1.0;
        }
        let [_, slope, bend] = self.rho(s);
        (1.0 + 2.0 * s * bend / slope).clamp(least, 1.0)
    }

    /// The same loss with its scale multiplied by `factor`.
    pub fn stretched(self, factor: f64) -> Loss {
        match self {
            Loss::Squared => Loss::Squared,
            Loss::Huber { scale } => Loss::Huber { scale: scale * factor },
            Loss::Cauchy { scale } => Loss::Cauchy { scale: scale * factor },
            Loss::Tukey { scale } => Loss::Tukey { scale: scale * factor },
            Loss::GemanMcClure { scale } => Loss::GemanMcClure { scale: scale * factor },
            Loss::Barron { shape, scale } => Loss::Barron { shape, scale: scale * factor },
        }
    }

    /// Whether a large enough residual loses its pull, so that the cost has more than one minimum
    /// and the adjustment needs a good start.
    pub fn redescends(&self) -> bool {
        match self {
            Loss::Squared | Loss::Huber { .. } => false,
            Loss::Cauchy { .. } | Loss::Tukey { .. } | Loss::GemanMcClure { .. } => true,
            Loss::Barron { shape, .. } => *shape < 1.0,
        }
    }
}

/// Barron's loss, scaled so that `rho'(0) = 1`: `rho = 2 c^2 f`.
fn barron(s: f64, shape: f64, c: f64) -> [f64; 3] {
    let z = s / (c * c);
    if shape == 2.0 {
        [s, 1.0, 0.0]
    } else if shape == 0.0 {
        let weight = 1.0 / (1.0 + 0.5 * z);
        [2.0 * c * c * (0.5 * z).ln_1p(), weight, -0.5 * weight * weight / (c * c)]
    } else if shape == f64::NEG_INFINITY {
        let weight = (-0.5 * z).exp();
        [-2.0 * c * c * (-0.5 * z).exp_m1(), weight, -0.5 * weight / (c * c)]
    } else {
        let b = (shape - 2.0).abs();
        let log_base = (z / b).ln_1p();
        let rho = 2.0 * c * c * (b / shape) * (0.5 * shape * log_base).exp_m1();
        let weight = ((0.5 * shape - 1.0) * log_base).exp();
        let slope = (0.5 * shape - 1.0) / (c * c * b) * ((0.5 * shape - 2.0) * log_base).exp();
        [rho, weight, slope]
    }
}

/// Barron's alpha where none is given: Cauchy.
pub const DEFAULT_SHAPE: f64 = 0.0;

/// The name of a loss, as it is spelled on the command line, before its scale is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LossName {
    /// Least squares.
    None,
    /// [`Loss::Huber`].
    Huber,
    /// [`Loss::Cauchy`].
    Cauchy,
    /// [`Loss::Tukey`].
    Tukey,
    /// [`Loss::GemanMcClure`].
    GemanMcClure,
    /// [`Loss::Barron`].
    Barron,
}

impl LossName {
    /// All of them with their spelling.
    pub const ALL: [(LossName, &'static str); 6] = [
        (LossName::None, "none"),
        (LossName::Huber, "huber"),
        (LossName::Cauchy, "cauchy"),
        (LossName::Tukey, "tukey"),
        (LossName::GemanMcClure, "geman-mcclure"),
        (LossName::Barron, "barron"),
    ];

    /// The loss of this name. `scale` in standard deviations; `shape` is Barron's alpha.
    pub fn with_scale(self, scale: f64, shape: f64) -> Loss {
        match self {
            LossName::None => Loss::Squared,
            LossName::Huber => Loss::Huber { scale },
            LossName::Cauchy => Loss::Cauchy { scale },
            LossName::Tukey => Loss::Tukey { scale },
            LossName::GemanMcClure => Loss::GemanMcClure { scale },
            LossName::Barron => Loss::Barron { shape, scale },
        }
    }

    /// The scale at which the loss keeps 95 % of the efficiency of least squares on good image
    /// points, that is on two normal coordinates under one norm (Barron: for its default shape).
    pub fn default_scale(self) -> f64 {
        match self {
            LossName::None => f64::INFINITY,
            LossName::Huber => 1.50,
            LossName::Cauchy => 2.55,
            LossName::Tukey => 5.12,
            LossName::GemanMcClure => 4.10,
            LossName::Barron => 1.80,
        }
    }
}

impl fmt::Display for LossName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (_, spelling) = Self::ALL.iter().find(|(name, _)| name == self).expect("listed");
        f.write_str(spelling)
    }
}

impl FromStr for LossName {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        Self::ALL
            .iter()
            .find(|(_, spelling)| *spelling == text)
            .map(|(name, _)| *name)
            .ok_or_else(|| format!("wanted one of {}", Self::ALL.map(|(_, s)| s).join(", ")))
    }
}

/// Standard deviation per coordinate of pairs with these squared norms, of which less than half may be
/// gross: from the median on, the root mean square of those within three standard deviations, corrected
/// for the cut.
pub fn robust_spread(squares: Vec<f64>) -> f64 {
    spread_from(0.5, squares)
}

/// The same of many pairs, of which two thirds may be gross if these are ten standard deviations off or more: it
/// sets out from a lower quantile, which is of good ones then.
pub fn robust_spread_of_many(squares: Vec<f64>) -> f64 {
    let share = if squares.len() < MANY { 0.5 } else { LOW };
    spread_from(share, squares)
}

/// So many have a lower quantile that says something, and which that is.
const MANY: usize = 100;
const LOW: f64 = 0.15;

fn spread_from(share: f64, mut squares: Vec<f64>) -> f64 {
    if squares.is_empty() {
        return 1.0;
    }
    squares.sort_by(f64::total_cmp);
    // Half the squared norm of two unit normal numbers is exponential.
    let quantile = -(1.0 - share).ln();
    let first = squares[(share * squares.len() as f64) as usize];
    let mut variance = (0.5 * first / quantile).clamp(1e-6, 1e6);
    let half_cut: f64 = 4.5;
    let left = (1.0 - (-half_cut).exp() * (1.0 + half_cut)) / (1.0 - (-half_cut).exp());
    for _ in 0..20 {
        let inside = squares.partition_point(|s| 0.5 * s < half_cut * variance).max(1);
        let mean = squares[..inside].iter().sum::<f64>() / (2 * inside) as f64;
        variance = (mean / left).clamp(1e-6, 1e6);
    }
    variance.sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// The laws of [`Loss`], at `s` on both sides of every branch.
    fn obeys_the_laws(loss: Loss) {
        assert_eq!(loss.rho(0.0)[..2], [0.0, 1.0], "{loss:?}");
        for s in [1e-9, 0.3, 1.7, 3.9, 4.1, 26.0, 27.0, 400.0, 1e8] {
            let h = 1e-5 * s;
            let (below, at, above) = (loss.rho(s - h), loss.rho(s), loss.rho(s + h));
            let close = |slope: f64, wanted: f64, what: &str| {
                let limit = 1e-6 * wanted.abs() + 1e-9;
                assert!((slope - wanted).abs() <= limit, "{loss:?} {what} at {s}: {slope} {wanted}");
            };
            close((above[0] - below[0]) / (2.0 * h), at[1], "rho'");
            if s > 1e-3 {
                close((above[1] - below[1]) / (2.0 * h), at[2], "rho''");
            }
            assert!(at[1] >= 0.0 && at[0] >= 0.0 && at[0] <= s * (1.0 + 1e-12));
        }
    }

    #[test]
    fn every_loss_obeys_the_laws() {
        for scale in [2.0, 5.1] {
            for (name, _) in LossName::ALL {
                obeys_the_laws(name.with_scale(scale, 1.0));
            }
            for shape in [2.0, 1.5, 1.0, 0.5, 0.0, -2.0, -10.0, f64::NEG_INFINITY] {
                obeys_the_laws(Loss::Barron { shape, scale });
            }
        }
    }

    #[test]
    fn the_general_loss_contains_the_others() {
        let c = 1.7;
        for s in [0.0, 0.5, 3.0, 80.0] {
            let pairs = [
                (Loss::Barron { shape: 2.0, scale: c }, Loss::Squared),
                (Loss::Barron { shape: 0.0, scale: c }, Loss::Cauchy { scale: c * 2f64.sqrt() }),
                (Loss::Barron { shape: -2.0, scale: c }, Loss::GemanMcClure { scale: 2.0 * c }),
            ];
            for (general, special) in pairs {
                for (a, b) in general.rho(s).iter().zip(special.rho(s)) {
                    assert!((a - b).abs() <= 1e-12 * b.abs().max(1.0), "{special:?} at {s}: {a} {b}");
                }
            }
        }
    }

    /// Asymptotic efficiency against least squares for a location in the plane with unit normal
    /// noise: `(E[w + s w'])^2 / E[w^2 s / 2]`, where `s` is exponential with mean 2.
    fn efficiency(loss: Loss) -> f64 {
        let (mut slope, mut power, step) = (0.0, 0.0, 1e-3);
        for i in 0..60_000 {
            let s = (f64::from(i) + 0.5) * step;
            let density = 0.5 * (-0.5 * s).exp() * step;
            let [_, weight, change] = loss.rho(s);
            slope += (weight + s * change) * density;
            power += 0.5 * weight * weight * s * density;
        }
        slope * slope / power
    }

    #[test]
    fn default_scales_keep_95_percent_of_the_efficiency() {
        for (name, spelling) in LossName::ALL {
            let found = efficiency(name.with_scale(name.default_scale(), DEFAULT_SHAPE));
            let wanted = if name == LossName::None { 1.0 } else { 0.95 };
            assert!((found - wanted).abs() < 1e-3, "{spelling}: {found}");
        }
    }

    #[test]
    fn names_are_read_as_they_are_written() {
        for (name, spelling) in LossName::ALL {
            assert_eq!(spelling.parse(), Ok(name));
            assert_eq!(name.to_string(), spelling);
        }
        assert!("cauchi".parse::<LossName>().unwrap_err().contains("geman-mcclure"));
    }

    #[test]
    fn the_spread_is_that_of_the_good_ones() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let mut squares = |gross_share: f64| -> Vec<f64> {
            let one = |_| match rng.random::<f64>() {
                r if r < gross_share => rng.random_range(40.0..4000.0),
                _ => -2.0 * 1.7 * 1.7 * rng.random_range(f64::EPSILON..1.0).ln(),
            };
            (0..20_000).map(one).collect()
        };
        for (gross_share, tolerance) in [(0.0, 0.01), (0.2, 0.02), (0.45, 0.05)] {
            let found = robust_spread(squares(gross_share)) / 1.7;
            assert!((found - 1.0).abs() < tolerance, "{gross_share}: {found}");
        }
        for (gross_share, tolerance) in [(0.0, 0.01), (0.2, 0.02), (0.6, 0.08)] {
            let mut squares = squares(gross_share);
            let worse = |s: &f64| if (40.0..4000.0).contains(s) { 300.0 + s } else { *s };
            squares = squares.iter().map(worse).collect();
            let found = robust_spread_of_many(squares) / 1.7;
            assert!((found - 1.0).abs() < tolerance, "{gross_share}: {found}");
        }
        assert_eq!(robust_spread(Vec::new()), 1.0);
        assert_eq!(robust_spread_of_many(Vec::new()), 1.0);
        assert!(robust_spread(vec![0.0; 5]) > 0.0);
        assert!(robust_spread(vec![f64::INFINITY; 5]).is_finite());
    }
}
