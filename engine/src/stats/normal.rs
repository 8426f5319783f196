//! Critical values of the normal distribution, and what the median of a sample says of its standard deviation.

use super::chi_square::chi_square_exceeded;

/// Half the width of an interval that holds 95 %, in standard deviations.
pub const TWO_SIDED_95: f64 = 1.96;

/// Critical value of a two-sided test at a level of 0.1 %.
pub const TWO_SIDED_99_9: f64 = 3.29;

/// The norm of two unit normal numbers exceeds this once in half a million; from here on an image point is a gross
/// error.
pub const GROSS_SIGMAS: f64 = 5.12;

/// By what a median absolute deviation is multiplied to be the standard deviation of a normal distribution.
pub const MAD_TO_SIGMA: f64 = 1.482_602_218_505_602;

/// The same to five digits, as the surface of a scan is fitted with.
pub const MAD_TO_SIGMA_ROUNDED: f64 = 1.4826;

/// The median of the size of a unit normal number.
pub const MEDIAN_OF_SIZE: f64 = 0.6745;

/// The median of the norm of three unit normal numbers.
pub const MEDIAN_OF_NORM_3: f64 = 1.538;

/// The median of the norm of two unit normal numbers, `sqrt(2 ln 2)`.
pub fn median_of_norm_2() -> f64 {
    (2.0 * 2_f64.ln()).sqrt()
}

/// How probable it is that a unit normal number is below this.
pub fn normal_below(x: f64) -> f64 {
    let beyond = 0.5 * chi_square_exceeded(x * x, 1.0);
    if x < 0.0 { beyond } else { 1.0 - beyond }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn critical_values_and_medians_are_those_of_the_distribution() {
        for (norm, freedom, exceeded, rounding) in [
            (TWO_SIDED_95, 1.0, 0.05, 1e-5),
            (TWO_SIDED_99_9, 1.0, 0.001, 1e-5),
            (GROSS_SIGMAS, 2.0, 1.0 / 500_000.0, 1e-7),
            (1.0 / MAD_TO_SIGMA, 1.0, 0.5, 1e-12),
            (1.0 / MAD_TO_SIGMA_ROUNDED, 1.0, 0.5, 1e-5),
            (MEDIAN_OF_SIZE, 1.0, 0.5, 1e-5),
            (median_of_norm_2(), 2.0, 0.5, 1e-12),
            (MEDIAN_OF_NORM_3, 3.0, 0.5, 1e-3),
        ] {
            let found = chi_square_exceeded(norm * norm, freedom);
            assert!((found - exceeded).abs() < rounding, "{norm}: {found}");
        }
    }
}
