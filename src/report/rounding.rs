//! How numbers are written. Digits: fewer than would show the order of a sum, many more
//! than were measured.

/// Positions are written to this \[m\].
pub const METRE: f64 = 1e9;
/// Quaternions and weights are written to this.
pub const RATIO: f64 = 1e12;
/// Pixels and degrees are written to this.
pub const PIXEL: f64 = 1e7;

/// `value` to the nearest `1 / steps`, and never "-0".
pub fn round(value: f64, steps: f64) -> f64 {
    let whole = (value * steps).round();
    // Beyond what has a digit left after the point.
    if whole.is_finite() { whole / steps + 0.0 } else { value }
}

/// A length as it is written.
pub fn metres(value: f64) -> f64 {
    round(value, METRE)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_rounded_and_never_minus_zero() {
        assert_eq!(round(1.234_567_890_49, METRE), 1.234_567_890);
        assert_eq!(round(-1e-12, METRE).to_string(), "0");
        assert_eq!(round(f64::INFINITY, METRE), f64::INFINITY);
        assert_eq!(round(-1e300, METRE), -1e300);
    }
}
