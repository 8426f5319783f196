//! Association: which frame is compared with which place of the reference.

use crate::clock::curve::{Curve, Place};
use crate::files::TrackPosition;
use crate::reference::GnssPosition;
use crate::stats::quantile::median;
use nalgebra::Point3;

/// What is compared with what.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Association {
    /// Every frame with the reference at its time, between samples ([`Curve`]).
    Interpolated,
    /// Every sample of the sparser of the two with the nearest one of the other: as it is often done. At
    /// 10 m/s and 30 frames a second it adds up to 17 cm along the track.
    Nearest {
        /// They are no farther apart in time \[s\]; `None` for half the median step of the denser one.
        max_gap_s: Option<f64>,
    },
}

impl Association {
    /// Its name in options and reports.
    pub fn name(self) -> &'static str {
        match self {
            Association::Interpolated => "interpolated",
            Association::Nearest { .. } => "nearest",
        }
    }
}

/// A position of the track, and when and where the reference was.
#[derive(Clone, Copy, Debug)]
pub struct Pair<'t> {
    /// The frame.
    pub at: &'t TrackPosition,
    /// Where the reference is between its samples.
    pub place: Place,
    /// Position of the reference \[m\].
    pub reference: Point3<f64>,
    /// Time of that position, on the clock of the reference \[s\].
    pub reference_time_s: f64,
}

/// The pairs at an offset of the reference's clock \[s\], in the order of the one that is gone through, and
/// the greatest difference of time that was allowed to them \[s\].
pub fn pairs<'t>(
    track: &'t [TrackPosition],
    reference: &[GnssPosition],
    curve: &Curve,
    offset_s: f64,
    association: Association,
) -> (Vec<Pair<'t>>, f64) {
    match association {
        Association::Interpolated => {
            let pair = |at: &'t TrackPosition| {
                let reference_time_s = at.time_s + offset_s;
                let place = curve.find(reference_time_s)?;
                Some(Pair { at, place, reference: curve.position(place), reference_time_s })
            };
            (track.iter().filter_map(pair).collect(), 0.0)
        }
        Association::Nearest { max_gap_s } => nearest(track, reference, offset_s, max_gap_s),
    }
}

/// Every sample of the sparser one (of equally many, every frame) with the nearest of the other, of two that
/// are equally near with the earlier; these are the rules of `evo`.
fn nearest<'t>(
    track: &'t [TrackPosition],
    reference: &[GnssPosition],
    offset_s: f64,
    max_gap_s: Option<f64>,
) -> (Vec<Pair<'t>>, f64) {
    let film: Vec<f64> = track.iter().map(|at| at.time_s + offset_s).collect();
    let receiver: Vec<f64> = reference.iter().map(|at| at.time_s).collect();
    let is_film_sparser = film.len() <= receiver.len();
    let (sparse, dense) = if is_film_sparser { (&film, &receiver) } else { (&receiver, &film) };
    // Half of the median step, and a little for rounded times.
    let max_gap_s = max_gap_s.unwrap_or_else(|| {
        0.5 * median(dense.windows(2).map(|pair| pair[1] - pair[0]).collect()).unwrap_or(0.0) + 1e-6
    });
    let partner = |time_s: f64| {
        let after = dense.partition_point(|t| *t <= time_s);
        let later = dense.get(after).map(|t| t - time_s).filter(|gap| *gap <= max_gap_s);
        let earlier = after.checked_sub(1).map(|at| time_s - dense[at]).filter(|gap| *gap <= max_gap_s);
        match (earlier, later) {
            (Some(earlier), Some(later)) if later < earlier => Some(after),
            (Some(_), _) => Some(after - 1),
            (None, Some(_)) => Some(after),
            (None, None) => None,
        }
    };
    let pair = |(at, time_s): (usize, &f64)| {
        let other = partner(*time_s)?;
        let (frame, sample) = if is_film_sparser { (at, other) } else { (other, at) };
        Some(Pair {
            at: &track[frame],
            place: Place { before: sample, fraction: 0.0 },
            reference: reference[sample].position,
            reference_time_s: receiver[sample],
        })
    };
    (sparse.iter().enumerate().filter_map(pair).collect(), max_gap_s)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn film(times: &[f64]) -> Vec<TrackPosition> {
        let at = |(k, time_s): (usize, &f64)| TrackPosition {
            frame: k as i64,
            time_s: *time_s,
            position: Point3::origin(),
            ..TrackPosition::default()
        };
        times.iter().enumerate().map(at).collect()
    }

    fn receiver(times: &[f64]) -> Vec<GnssPosition> {
        let at = |time_s: &f64| GnssPosition { time_s: *time_s, ..GnssPosition::default() };
        times.iter().map(at).collect()
    }

    fn found(film_s: &[f64], receiver_s: &[f64], max_gap_s: Option<f64>) -> Vec<(i64, usize)> {
        let (track, reference) = (film(film_s), receiver(receiver_s));
        let (pairs, _) = nearest(&track, &reference, 0.0, max_gap_s);
        pairs.iter().map(|pair| (pair.at.frame, pair.place.before)).collect()
    }

    #[test]
    fn the_sparser_one_is_gone_through() {
        assert_eq!(found(&[0.0, 0.1, 0.2, 0.3], &[0.12, 0.31], None), [(1, 0), (3, 1)]);
        assert_eq!(found(&[0.12, 0.31], &[0.0, 0.1, 0.2, 0.3], None), [(0, 1), (1, 3)]);
        // Of equally many, every frame: two of them with one sample.
        assert_eq!(found(&[0.0, 0.1], &[0.06, 9.0], Some(0.1)), [(0, 0), (1, 0)]);
    }

    #[test]
    fn of_two_equally_near_it_is_the_earlier() {
        assert_eq!(found(&[0.0, 0.5, 1.0], &[0.25], Some(0.25)), [(0, 0)]);
        assert_eq!(found(&[0.0, 0.5, 1.0], &[0.5], Some(0.0)), [(1, 0)]);
        assert_eq!(found(&[0.0, 0.5, 1.0], &[1.5], Some(0.5)), [(2, 0)]);
        assert_eq!(found(&[0.0, 0.5, 1.0], &[-0.5, 1.51], Some(0.5)), [(0, 0)]);
    }

    #[test]
    fn no_pair_is_missed_that_a_plain_search_finds() {
        let times = |count: usize, step: f64, from: f64| -> Vec<f64> {
            (0..count).map(|k| from + step * k as f64 + 0.01 * (k as f64 * 1.7).sin()).collect()
        };
        for (film_s, receiver_s) in [
            (times(90, 1.0 / 30.0, 0.0), times(20, 0.2, -0.5)),
            (times(20, 0.2, 0.3), times(90, 1.0 / 30.0, 0.1)),
            (times(30, 0.1, 0.0), times(30, 0.1, 0.04)),
        ] {
            for gap in [0.001, 0.017, 0.1, 10.0] {
                let is_film_sparser = film_s.len() <= receiver_s.len();
                let (sparse, dense) =
                    if is_film_sparser { (&film_s, &receiver_s) } else { (&receiver_s, &film_s) };
                let mut wanted = Vec::new();
                for (at, time) in sparse.iter().enumerate() {
                    let mut best = 0;
                    for k in 1..dense.len() {
                        if (dense[k] - time).abs() < (dense[best] - time).abs() {
                            best = k;
                        }
                    }
                    if (dense[best] - time).abs() <= gap {
                        wanted.push(if is_film_sparser { (at as i64, best) } else { (best as i64, at) });
                    }
                }
                assert_eq!(found(&film_s, &receiver_s, Some(gap)), wanted, "{gap}");
            }
        }
        assert_eq!(found(&[], &[1.0], None), []);
        assert_eq!(found(&[1.0], &[], None), []);
    }
}
