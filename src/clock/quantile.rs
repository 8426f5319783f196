//! Quantiles of a sample.

/// The value below which this share of all lies, between two of them linearly (type 7 of Hyndman and Fan,
/// *Sample quantiles in statistical packages*, 1996).
pub fn quantile(mut values: Vec<f64>, share: f64) -> Option<f64> {
    let place = values.len().checked_sub(1)? as f64 * share;
    let (_, below, rest) = values.select_nth_unstable_by(place as usize, f64::total_cmp);
    let above = rest.iter().copied().min_by(f64::total_cmp).unwrap_or(*below);
    Some(if *below == above { above } else { *below + place.fract() * (above - *below) })
}

/// The middle value, or the mean of the two middle ones.
pub fn median(values: Vec<f64>) -> Option<f64> {
    quantile(values, 0.5)
}
