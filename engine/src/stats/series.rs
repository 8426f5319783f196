//! Values in sequence, alike where they are near each other.

/// Variance of the mean over that of a mean of independent values: `1 + 2 sum r_k (1 - k / n)`, over the correlations
/// `r_k` up to the first that is not positive (Geyer, *Practical Markov chain Monte Carlo*, 1992, takes pairs of them).
/// At least one, and what `n` values that are all alike would have at the most.
pub fn inflation(values: &[f64]) -> f64 {
    let count = values.len();
    if count < 3 {
        return 1.0;
    }
    let mean = values.iter().sum::<f64>() / count as f64;
    let product = |apart: usize| -> f64 {
        values.iter().zip(&values[apart..]).map(|(a, b)| (a - mean) * (b - mean)).sum::<f64>()
    };
    let square = product(0);
    if square <= 0.0 {
        return 1.0;
    }
    let mut sum = 0.0;
    for apart in 1..count {
        let alike = product(apart) / square;
        if alike <= 0.0 {
            break;
        }
        sum += alike;
    }
    (1.0 + 2.0 * sum).min(count as f64)
}

/// Standard deviation of the mean of values in sequence; zero of fewer than two.
pub fn sigma_of_mean(values: &[f64]) -> f64 {
    let count = values.len() as f64;
    if values.len() < 2 {
        return 0.0;
    }
    let mean = values.iter().sum::<f64>() / count;
    let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (count - 1.0);
    (variance * inflation(values) / count).sqrt()
}

#[cfg(test)]
mod tests {
    use super::super::drawn::Normal;
    use super::*;

    /// Means of many series scatter as it says, within what so short series can tell.
    #[test]
    fn means_scatter_as_they_say() {
        for (alike, tolerance) in [(0.0, 0.1), (0.8, 0.2)] {
            let mut drawn = Normal(11);
            let (mut squares, mut said, series) = (0.0, 0.0, 400);
            for _ in 0..series {
                let mut now = drawn.draw();
                let values: Vec<f64> = (0..150)
                    .map(|_| {
                        now = alike * now + f64::sqrt(1.0 - alike * alike) * drawn.draw();
                        now
                    })
                    .collect();
                squares += (values.iter().sum::<f64>() / 150.0).powi(2);
                said += sigma_of_mean(&values).powi(2);
            }
            let ratio = (squares / said).sqrt();
            assert!((ratio - 1.0).abs() < tolerance, "{alike}: {ratio}");
        }
        assert_eq!(sigma_of_mean(&[2.0; 20]), 0.0);
        assert_eq!(sigma_of_mean(&[2.0]), 0.0);
    }
}
