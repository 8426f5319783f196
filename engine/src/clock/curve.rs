//! A track between its samples.
//!
//! Between two samples runs a cubic with the positions and the tangents of both (Hermite). A tangent is
//! the measured velocity, else that of the parabola through a sample and its two neighbours (Catmull-Rom
//! for irregular times), and where there is but one neighbour, at the end of a track or beside a gap, that
//! of the parabola that arrives at it with its tangent. With a step `h` and a jerk `j` such a cubic is off
//! by up to `j h^3 / 15`. Two samples alone are joined by a line. Nothing is said outside the samples, nor
//! in a gap.

use crate::stats::quantile::median;
use nalgebra::{Point3, Vector3};

/// Steps longer than so many times their median are gaps.
pub const GAP_STEPS: f64 = 5.0;

/// A track as a function of time.
#[derive(Clone, Debug)]
pub struct Curve {
    times_s: Vec<f64>,
    positions: Vec<Point3<f64>>,
    tangents_mps: Vec<Vector3<f64>>,
    /// Counts the gaps before each sample.
    pieces: Vec<usize>,
    step_s: f64,
}

/// A time between two samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// Index of the sample before it.
    pub before: usize,
    /// Which part of the step has passed, from 0 to 1.
    pub fraction: f64,
}

impl Curve {
    /// The track through samples: time \[s\], position \[m\], velocity \[m/s\] where it was measured. A sample
    /// whose time does not lie after that of the one before is left out.
    pub fn new(samples: impl Iterator<Item = (f64, Point3<f64>, Option<Vector3<f64>>)>) -> Self {
        let (mut times_s, mut positions, mut measured) = (Vec::<f64>::new(), Vec::new(), Vec::new());
        for (time_s, position, velocity) in samples {
            if time_s.is_finite() && times_s.last().is_none_or(|last| time_s > *last) {
                times_s.push(time_s);
                positions.push(position);
                measured.push(velocity);
            }
        }
        let step_s = median(times_s.windows(2).map(|pair| pair[1] - pair[0]).collect()).unwrap_or(0.0);
        let mut pieces = Vec::with_capacity(times_s.len());
        for at in 0..times_s.len() {
            let before: usize = pieces.last().copied().unwrap_or(0);
            pieces.push(before + usize::from(at > 0 && times_s[at] - times_s[at - 1] > GAP_STEPS * step_s));
        }
        let mut curve = Curve { times_s, positions, tangents_mps: Vec::new(), pieces, step_s };
        curve.tangents_mps = curve.tangents(&measured);
        curve
    }

    /// The median step \[s\]; 0 without any.
    pub fn step_s(&self) -> f64 {
        self.step_s
    }

    /// The longest step that is no gap \[s\].
    pub fn longest_step_s(&self) -> f64 {
        GAP_STEPS * self.step_s
    }

    /// First and last time \[s\].
    pub fn span_s(&self) -> Option<[f64; 2]> {
        Some([*self.times_s.first()?, *self.times_s.last()?])
    }

    /// The times of the samples \[s\].
    pub fn times_s(&self) -> &[f64] {
        &self.times_s
    }

    /// Whether no gap lies between a sample and the next.
    fn is_joined(&self, at: usize) -> bool {
        at + 1 < self.pieces.len() && self.pieces[at] == self.pieces[at + 1]
    }

    /// Mean velocity from a sample to the next \[m/s\].
    fn slope(&self, at: usize) -> Vector3<f64> {
        (self.positions[at + 1] - self.positions[at]) / (self.times_s[at + 1] - self.times_s[at])
    }

    /// Velocity at a sample from it and its two neighbours \[m/s\].
    fn parabola(&self, at: usize) -> Option<Vector3<f64>> {
        if at == 0 || !self.is_joined(at - 1) || !self.is_joined(at) {
            return None;
        }
        let [before, after] = [at, at + 1].map(|k| self.times_s[k] - self.times_s[k - 1]);
        Some((after * self.slope(at - 1) + before * self.slope(at)) / (before + after))
    }

    fn tangents(&self, measured: &[Option<Vector3<f64>>]) -> Vec<Vector3<f64>> {
        let inner: Vec<Option<Vector3<f64>>> =
            (0..self.times_s.len()).map(|at| measured[at].or_else(|| self.parabola(at))).collect();
        let one_sided = |at: usize, neighbour: usize| {
            let slope = self.slope(at.min(neighbour));
            inner[neighbour].map_or(slope, |tangent| 2.0 * slope - tangent)
        };
        let tangent = |at: usize| match inner[at] {
            Some(tangent) => tangent,
            None if self.is_joined(at) => one_sided(at, at + 1),
            None if at > 0 && self.is_joined(at - 1) => one_sided(at, at - 1),
            None => Vector3::zeros(),
        };
        (0..inner.len()).map(tangent).collect()
    }

    /// Where a time lies; `None` outside the track and in its gaps.
    pub fn find(&self, time_s: f64) -> Option<Place> {
        let before = self.times_s.partition_point(|t| *t <= time_s).checked_sub(1)?;
        if self.is_joined(before) {
            let step = self.times_s[before + 1] - self.times_s[before];
            Some(Place { before, fraction: (time_s - self.times_s[before]) / step })
        } else {
            // The last sample of a piece.
            let is_end = time_s == self.times_s[before] && before > 0 && self.is_joined(before - 1);
            is_end.then(|| Place { before: before - 1, fraction: 1.0 })
        }
    }

    /// Whether the track is known from one time to another.
    pub fn covers(&self, from_s: f64, to_s: f64) -> bool {
        let piece = |time_s| self.find(time_s).map(|place| self.pieces[place.before]);
        piece(from_s).is_some_and(|first| piece(to_s) == Some(first))
    }

    /// Whether a time lies in a gap, rather than outside.
    pub fn is_in_gap(&self, time_s: f64) -> bool {
        let is_inside = self.span_s().is_some_and(|[first, last]| first <= time_s && time_s <= last);
        is_inside && self.find(time_s).is_none()
    }

    /// Position there \[m\].
    pub fn position(&self, place: Place) -> Point3<f64> {
        let Place { before, fraction: s } = place;
        let [from, to] = [before, before + 1].map(|at| self.positions[at].coords);
        let step = self.times_s[before + 1] - self.times_s[before];
        let [leave, arrive] = [before, before + 1].map(|at| step * self.tangents_mps[at]);
        let [s2, s3] = [s * s, s * s * s];
        Point3::from(
            from + (3.0 * s2 - 2.0 * s3) * (to - from) + (s3 - 2.0 * s2 + s) * leave + (s3 - s2) * arrive,
        )
    }

    /// Position at a time \[m\].
    pub fn at(&self, time_s: f64) -> Option<Point3<f64>> {
        self.find(time_s).map(|place| self.position(place))
    }

    /// Velocity at a sample by the difference of the two beside it \[m/s\]; `None` at ends and beside gaps.
    pub fn difference_at(&self, at: usize) -> Option<Vector3<f64>> {
        if at == 0 || !self.is_joined(at - 1) || !self.is_joined(at) {
            return None;
        }
        let moved = self.positions[at + 1] - self.positions[at - 1];
        Some(moved / (self.times_s[at + 1] - self.times_s[at - 1]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curve(times: &[f64], f: impl Fn(f64) -> f64) -> Curve {
        Curve::new(times.iter().map(|t| (*t, Point3::new(f(*t), 2.0 * f(*t), -*t), None)))
    }

    #[test]
    fn a_parabola_is_met_at_irregular_times_up_to_its_ends() {
        let parabola = |t: f64| 1.0 - 2.0 * t + 3.0 * t * t;
        let curve = curve(&[0.0, 0.3, 0.4, 0.9, 1.0, 1.6], parabola);
        for time in [0.0, 0.1, 0.3, 0.35, 0.77, 1.0, 1.59, 1.6] {
            let found = curve.at(time).unwrap();
            assert!((found - Point3::new(parabola(time), 2.0 * parabola(time), -time)).norm() < 1e-12);
        }
        assert_eq!((curve.at(-1e-9), curve.at(1.6 + 1e-9), curve.at(f64::NAN)), (None, None, None));
    }

    #[test]
    fn a_cubic_is_met_where_velocities_were_measured() {
        let cubic = |t: f64| t * t * t - t;
        let samples = [0.0, 1.0, 1.5, 3.0].map(|t: f64| {
            (t, Point3::new(cubic(t), 0.0, 0.0), Some(Vector3::new(3.0 * t * t - 1.0, 0.0, 0.0)))
        });
        let curve = Curve::new(samples.into_iter());
        for time in [0.4, 1.2, 2.9] {
            assert!((curve.at(time).unwrap().x - cubic(time)).abs() < 1e-12, "{time}");
        }
    }

    #[test]
    fn a_cubic_without_velocities_is_off_by_no_more_than_is_said() {
        let times: Vec<f64> = (0..30).map(|k| 0.2 * f64::from(k)).collect();
        let curve = curve(&times, |t| t * t * t);
        let worst = (0..5700).map(|k| f64::from(k) * 1e-3 + 0.05);
        let worst = worst.map(|t| (curve.at(t).unwrap().x - t * t * t).abs()).fold(0.0, f64::max);
        let said = 6.0 * 0.2_f64.powi(3) / 15.0;
        assert!(worst < said && worst > 0.2 * said, "{worst} against {said}");
    }

    #[test]
    fn gaps_are_not_bridged() {
        // A median step of 1 s: 5 s are bridged, 6 s are not.
        let curve = curve(&[0.0, 1.0, 2.0, 7.0, 8.0, 9.0, 10.0, 16.0, 17.0, 30.0], |t| t);
        assert_eq!((curve.step_s(), curve.longest_step_s()), (1.0, 5.0));
        assert!((curve.at(4.0).unwrap().x - 4.0).abs() < 1e-12);
        assert!(curve.at(10.0).is_some() && curve.at(16.0).is_some(), "the samples themselves are known");
        assert!(curve.at(10.001).is_none() && curve.is_in_gap(12.0) && !curve.is_in_gap(9.5));
        assert!((curve.at(16.5).unwrap().x - 16.5).abs() < 1e-12, "two samples alone: a line");
        assert!(curve.at(30.0).is_none(), "a sample alone");
        assert!(!curve.is_in_gap(30.5) && !curve.is_in_gap(-1.0), "outside is no gap");
        assert!(curve.covers(2.5, 9.9) && !curve.covers(9.0, 16.5) && !curve.covers(-0.1, 1.0));
    }

    #[test]
    fn velocities_are_differences() {
        let curve = curve(&[0.0, 1.0, 3.0, 4.0], |t| t * t);
        assert_eq!(curve.difference_at(0), None);
        assert_eq!(curve.difference_at(1).unwrap().x, 3.0);
        assert_eq!(curve.difference_at(3), None);
    }

    #[test]
    fn too_little_is_no_track() {
        for samples in [vec![], vec![(0.0, Point3::origin(), None)]] {
            let curve = Curve::new(samples.into_iter());
            assert_eq!((curve.at(0.0), curve.find(0.0)), (None, None));
        }
        // Times that do not increase are left out.
        let curve = curve(&[0.0, 0.0, 1.0, 0.5, f64::NAN, 2.0], |t| t);
        assert_eq!(curve.times_s(), [0.0, 1.0, 2.0]);
    }
}
