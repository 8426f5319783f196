//! Where a radial lens model folds over: the first root of the slope of its radius.

/// The smallest `s` in `0..limit` at which the polynomial `c0 + c1 s + c2 s^2 + ...` has a root with a
/// change of sign. `None` without one.
pub fn first_root(coefficients: &[f64], limit: f64) -> Option<f64> {
    roots(coefficients, limit).first().copied()
}

/// All such roots, in order. Between the roots of its derivative a polynomial is monotone.
fn roots(coefficients: &[f64], limit: f64) -> Vec<f64> {
    if coefficients.len() < 2 {
        return Vec::new();
    }
    let derivative: Vec<f64> = (1..).zip(&coefficients[1..]).map(|(power, c)| f64::from(power) * c).collect();
    let value = |s: f64| coefficients.iter().rev().fold(0.0, |sum, c| sum * s + c);
    let mut borders = vec![0.0];
    borders.extend(roots(&derivative, limit));
    borders.push(limit);
    let bisect = |pair: &[f64]| {
        let (mut low, mut high) = (pair[0], pair[1]);
        let sign = value(low).signum();
        if value(high).signum() == sign {
            return None;
        }
        while (low + high) * 0.5 > low && (low + high) * 0.5 < high {
            let middle = 0.5 * (low + high);
            if value(middle).signum() == sign { low = middle } else { high = middle }
        }
        Some(low)
    };
    borders.windows(2).filter_map(bisect).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_root_is_found_however_close_the_second() {
        // (s - 1) (s - 1.0001) (s + 2)
        let coefficients = [2.0 * 1.0001, 1.0001 - 2.0 * 2.0001, 2.0 - 2.0001, 1.0];
        assert!((first_root(&coefficients, 10.0).unwrap() - 1.0).abs() < 1e-11);
        assert_eq!(first_root(&coefficients, 0.9), None);
        assert!((first_root(&coefficients, 1.00005).unwrap() - 1.0).abs() < 1e-11);
    }

    #[test]
    fn without_a_root_there_is_none() {
        for coefficients in [&[1.0][..], &[1.0, 0.5], &[1.0, -2.0, 1.5], &[1.0, 0.0, 0.0, 0.0]] {
            assert_eq!(first_root(coefficients, 100.0), None);
        }
        assert!((first_root(&[1.0, -0.25], 100.0).unwrap() - 4.0).abs() < 1e-14);
    }
}
