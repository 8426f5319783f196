//! Quantiles of weighted values.

/// Values in order, each with the place of the middle of its weight.
pub struct WeightedSample {
    values: Vec<(f64, f64)>,
}

impl WeightedSample {
    /// `None` without values; weights are positive.
    pub fn new(mut pairs: Vec<(f64, f64)>) -> Option<Self> {
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
        let mut before = 0.0;
        for (_, weight) in &mut pairs {
            let middle = before + 0.5 * *weight;
            before += *weight;
            *weight = middle;
        }
        (!pairs.is_empty()).then_some(WeightedSample { values: pairs })
    }

    /// See [`weighted_quantile`].
    pub fn quantile(&self, share: f64) -> f64 {
        let (first, last) = (self.values[0], self.values[self.values.len() - 1]);
        let place = first.1 + share.clamp(0.0, 1.0) * (last.1 - first.1);
        let above = self.values.partition_point(|(_, middle)| *middle < place);
        if above == 0 {
            return first.0;
        }
        let Some(b) = self.values.get(above) else { return last.0 };
        let a = self.values[above - 1];
        a.0 + (place - a.1) / (b.1 - a.1) * (b.0 - a.0)
    }
}

/// The value below which this share of the weight lies. Each value stands at the middle of its weight in
/// the running sum, and between two of them it is linear; the share 0 is the least value, 1 the largest.
/// With equal weights this is type 7 of Hyndman and Fan (1996). `None` without values; weights are positive.
pub fn weighted_quantile(values_and_weights: Vec<(f64, f64)>, share: f64) -> Option<f64> {
    WeightedSample::new(values_and_weights).map(|sorted| sorted.quantile(share))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_weights_give_type_7() {
        // Of no order.
        let mut values: Vec<f64> = (0..57).map(|k| f64::from(k * k % 59).sin()).collect();
        let pairs: Vec<(f64, f64)> = values.iter().map(|v| (*v, 0.3)).collect();
        values.sort_by(f64::total_cmp);
        for share in [0.0, 0.1, 0.5, 0.68, 0.95, 1.0] {
            let place: f64 = 56.0 * share;
            let (below, above) = (values[place as usize], values[(place as usize + 1).min(56)]);
            let wanted = below + place.fract() * (above - below);
            assert!((weighted_quantile(pairs.clone(), share).unwrap() - wanted).abs() < 1e-12);
        }
    }
}
