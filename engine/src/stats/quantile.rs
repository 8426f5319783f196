//! Quantiles of a sample.

/// The value below which this share of all lies, between two of them linearly (type 7 of Hyndman and Fan,
/// *Sample quantiles in statistical packages*, 1996). `None` without values.
pub fn quantile(mut values: Vec<f64>, share: f64) -> Option<f64> {
    let place = values.len().checked_sub(1)? as f64 * share;
    let (_, below, rest) = values.select_nth_unstable_by(place as usize, f64::total_cmp);
    let above = rest.iter().copied().min_by(f64::total_cmp).unwrap_or(*below);
    Some(if *below == above { above } else { *below + place.fract() * (above - *below) })
}

/// The middle value, or the mean of the two middle ones. `None` without values.
pub fn median(values: Vec<f64>) -> Option<f64> {
    quantile(values, 0.5)
}

/// The value that has this share of all before it in their order, rounded down: one of the values. `None` where all
/// would stand before it, and without values.
pub fn value_at_share(mut values: Vec<f64>, share: f64) -> Option<f64> {
    let at = (share * values.len() as f64) as usize;
    (at < values.len()).then(|| *values.select_nth_unstable_by(at, f64::total_cmp).1)
}

/// The middle value, or the larger of the two middle ones: one of the values. `None` without values.
pub fn upper_median(mut values: Vec<f64>) -> Option<f64> {
    let at = values.len() / 2;
    (at < values.len()).then(|| *values.select_nth_unstable_by(at, f64::total_cmp).1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_two_conventions_differ_for_even_numbers_alone() {
        let (odd, even) = (vec![3.0, 1.0, 10.0], vec![3.0, 1.0, 2.0, 10.0]);
        assert_eq!([median(odd.clone()), upper_median(odd.clone())], [Some(3.0); 2]);
        assert_eq!([median(even.clone()), upper_median(even.clone())], [Some(2.5), Some(3.0)]);
        assert_eq!([value_at_share(odd, 0.5), value_at_share(even, 0.5)], [Some(3.0); 2]);
    }

    #[test]
    fn a_value_at_a_share_has_so_many_before_it() {
        let values: Vec<f64> = (0..10).rev().map(f64::from).collect();
        for (share, wanted) in [(0.0, Some(0.0)), (0.25, Some(2.0)), (0.4, Some(4.0)), (1.0, None)] {
            assert_eq!(value_at_share(values.clone(), share), wanted);
        }
        assert_eq!((value_at_share(vec![], 0.5), upper_median(vec![]), median(vec![])), (None, None, None));
    }
}
