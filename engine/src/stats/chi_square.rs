//! The chi-square distribution, for tests.

/// Probability that chi-square with `freedom` degrees exceeds `value`: `Q(freedom / 2, value / 2)`, by the
/// series of the incomplete gamma function below its mean and by its continued fraction above (Abramowitz
/// and Stegun, 6.5.29 and 6.5.31).
pub fn chi_square_exceeded(value: f64, freedom: f64) -> f64 {
    let (a, x) = (freedom / 2.0, value / 2.0);
    if a.is_nan() || x.is_nan() || a <= 0.0 || x <= 0.0 {
        return 1.0;
    }
    let front = (a * x.ln() - x - log_gamma(a)).exp();
    if x < a + 1.0 {
        let (mut term, mut sum, mut n) = (1.0 / a, 1.0 / a, a);
        while term > sum * 1e-16 {
            n += 1.0;
            term *= x / n;
            sum += term;
        }
        return (1.0 - front * sum).clamp(0.0, 1.0);
    }
    // Lentz's way with continued fractions.
    let mut b = x + 1.0 - a;
    let (mut c, mut d) = (1e300, 1.0 / b);
    let mut fraction = d;
    for i in 1..100_000 {
        let i = f64::from(i);
        let numerator = -i * (i - a);
        b += 2.0;
        d = 1.0 / (numerator * d + b);
        c = b + numerator / c;
        let change = c * d;
        fraction *= change;
        if (change - 1.0).abs() < 1e-15 {
            break;
        }
    }
    (front * fraction).clamp(0.0, 1.0)
}

/// The value that chi-square with `freedom` degrees exceeds with this probability.
pub fn chi_square_quantile(exceeded: f64, freedom: f64) -> f64 {
    let (mut low, mut high) = (0.0, freedom + 10.0);
    while chi_square_exceeded(high, freedom) > exceeded {
        high *= 2.0;
    }
    for _ in 0..200 {
        let middle = 0.5 * (low + high);
        if chi_square_exceeded(middle, freedom) > exceeded {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
}

/// Logarithm of the gamma function of a number above zero, by Stirling's series (Abramowitz and Stegun,
/// 6.1.41).
fn log_gamma(x: f64) -> f64 {
    let (mut x, mut shift) = (x, 0.0);
    while x < 20.0 {
        shift += x.ln();
        x += 1.0;
    }
    let inverse = 1.0 / x;
    let square = inverse * inverse;
    let series = inverse * (1.0 / 12.0 - square * (1.0 / 360.0 - square * (1.0 / 1260.0 - square / 1680.0)));
    (x - 0.5) * x.ln() - x + 0.5 * (2.0 * std::f64::consts::PI).ln() + series - shift
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn probabilities_are_those_of_tables() {
        // Two degrees: exp(-x / 2). One degree: 3.8415 at 5 %. Ten: 18.3070 at 5 %.
        for x in [0.1, 1.0, 3.0, 20.0] {
            assert!((chi_square_exceeded(x, 2.0) - (-x / 2.0_f64).exp()).abs() < 1e-14);
        }
        for (freedom, exceeded, wanted) in [
            (1.0, 0.05, 3.841_459),
            (10.0, 0.05, 18.307_038),
            (10.0, 0.95, 3.940_299),
            (100.0, 0.01, 135.806_723),
        ] {
            let found = chi_square_quantile(exceeded, freedom);
            assert!((found - wanted).abs() < 1e-5, "{freedom} {exceeded}: {found}");
        }
    }

    #[test]
    fn a_large_number_of_degrees_is_nearly_normal() {
        let freedom = 2e5_f64;
        let one_sigma = chi_square_exceeded(freedom + (2.0 * freedom).sqrt(), freedom);
        assert!((one_sigma - 0.158_655).abs() < 1e-3, "{one_sigma}");
    }
}
