//! When a vehicle stands.
//!
//! A speed that cannot be told from none (three standard deviations, 0.05 m/s at least, 0.3 m/s at most) for a
//! second is standstill: there the heading is that of the body and no direction of travel, and no clock can
//! be read off the track.

/// A speed is never told from none below this \[m/s\].
const LEAST_SPEED_MPS: f64 = 0.05;
/// One above this is told, however large its standard deviation is.
const MOST_SPEED_MPS: f64 = 0.3;
/// In units of the standard deviation.
const SIGMAS: f64 = 3.0;
/// Standing takes at least this long \[s\].
const LEAST_S: f64 = 1.0;

/// From when to when a vehicle stands \[s\], given times, speeds and their standard deviations, as far as they
/// are known.
pub fn standstill(places: impl Iterator<Item = (f64, f64, Option<f64>)>) -> Vec<[f64; 2]> {
    let mut all: Vec<[f64; 2]> = Vec::new();
    let mut current: Option<[f64; 2]> = None;
    for (time_s, speed_mps, sigma_mps) in places {
        let limit = (SIGMAS * sigma_mps.unwrap_or(0.0)).clamp(LEAST_SPEED_MPS, MOST_SPEED_MPS);
        if speed_mps < limit {
            current = Some([current.map_or(time_s, |[begin, _]| begin), time_s]);
        } else {
            all.extend(current.take());
        }
    }
    all.extend(current);
    all.retain(|[begin, end]| end - begin >= LEAST_S);
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stop_is_told_from_a_crawl_and_from_noise() {
        let of = |speed: &dyn Fn(f64) -> f64, sigma: Option<f64>| {
            standstill((0..200).map(|k| f64::from(k) * 0.05).map(|t| (t, speed(t), sigma)))
        };
        let stop = |t: f64| if (3.0..6.0).contains(&t) { 0.02 } else { 4.0 };
        assert_eq!(of(&stop, Some(0.01)), [[3.0, 5.95]]);
        assert_eq!(of(&stop, None), [[3.0, 5.95]]);
        // Half a metre a second is no standstill, however poor the speed; nor is half a second.
        assert!(of(&|_| 0.5, Some(f64::INFINITY)).is_empty());
        assert!(of(&|t| if (3.0..3.5).contains(&t) { 0.0 } else { 4.0 }, None).is_empty());
        assert_eq!(of(&|_| 0.1, Some(0.05)).len(), 1);
    }
}
