//! A track against GNSS positions: result minus reference, as they stand.

use super::statistics::{HalfWidth, Statistics, half_width_at_half_maximum, median, quantile};
use crate::clock::curve::{Curve, Place};
use crate::files::TrackPosition;
use crate::reference::GnssPosition;
use nalgebra::{Matrix2, Vector2, Vector3};

/// A reference that moves more slowly than this has no direction \[m/s\].
pub const LEAST_SPEED_MPS: f64 = 0.5;

/// What is compared with what.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Association {
    /// Every frame with the reference at its time, between samples ([`Curve`]).
    Interpolated,
    /// Every sample of the reference with the frame nearest in time, at most half a frame away: as it is
    /// often done. At 10 m/s and 30 frames a second it adds up to 17 cm along the track.
    Nearest,
}

/// Where the speed of the reference comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SpeedSource {
    /// Its own velocities.
    Measured,
    /// Differences of the positions before and after a sample.
    Differences,
    /// One or the other.
    Mixed,
}

/// A frame that is compared.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Compared {
    /// Number of the frame.
    pub frame: i64,
    /// Its time, on the clock of the film \[s\].
    pub time_s: f64,
    /// Result minus reference \[m\].
    pub difference_m: Vector3<f64>,
    /// The same along the reference's motion and to the left of it \[m\]; `None` where it hardly moves.
    pub along_across_m: Option<Vector2<f64>>,
    /// Horizontal speed, result minus reference \[m/s\].
    pub speed_difference_mps: Option<f64>,
    /// Speed of the reference \[m/s\].
    pub reference_speed_mps: Option<f64>,
    /// Standard deviations of the result \[m\].
    pub sigma_m: [Option<f64>; 3],
    /// Standard deviations of the reference \[m\].
    pub reference_sigma_m: [Option<f64>; 3],
    /// Chi-square of the difference in the plan, of two degrees of freedom.
    pub chi_square: Option<f64>,
}

/// A track held against its reference.
#[derive(Clone, Debug, PartialEq)]
pub struct TrackComparison {
    /// What was compared with what.
    pub association: Association,
    /// The offset of clocks that was applied \[s\].
    pub clock_offset_s: f64,
    /// Positions of the track, and of the reference.
    pub positions: [usize; 2],
    /// Frames outside the time of the reference (with [`Association::Nearest`]: its samples without a frame).
    pub outside: usize,
    /// Frames in its gaps.
    pub in_gaps: usize,
    /// The longest step of the reference that is no gap \[s\].
    pub longest_step_s: f64,
    /// What was compared, in time order.
    pub compared: Vec<Compared>,
    /// Differences along x, y, z \[m\].
    pub axes_m: [Statistics; 3],
    /// Differences along the motion and to the left of it \[m\].
    pub along_across_m: Option<[Statistics; 2]>,
    /// 90 % of horizontal distances are no larger (CE90), nor are 90 % of vertical ones (LE90) \[m\].
    pub circular_linear_90_m: [f64; 2],
    /// Differences of speed \[m/s\].
    pub speed_mps: Option<Statistics>,
    /// Half width of their histogram at half its maximum \[m/s\].
    pub speed_half_width_mps: Option<HalfWidth>,
    /// Where the speed of the reference comes from.
    pub speed_source: Option<SpeedSource>,
    /// Median speed of the reference \[m/s\].
    pub median_speed_mps: Option<f64>,
    /// Median standard deviations of the result \[m\], where they are known.
    pub sigma_m: [Option<f64>; 3],
    /// The same of the reference \[m\].
    pub reference_sigma_m: [Option<f64>; 3],
    /// Chi-square of the plan per degree of freedom, and of how many positions: where the covariances of
    /// both are known.
    pub chi_square: Option<(f64, usize)>,
}

/// A position of the track, and when and where the reference was.
struct Pair<'t> {
    at: &'t TrackPosition,
    place: Place,
}

/// Compares a track with its reference, whose curve is `curve`, at an offset of its clock \[s\]; or says what
/// is missing.
pub fn compare(
    track: &[TrackPosition],
    reference: &[GnssPosition],
    curve: &Curve,
    offset_s: f64,
    association: Association,
) -> Result<TrackComparison, String> {
    let pairs = match association {
        Association::Interpolated => track
            .iter()
            .filter_map(|at| Some(Pair { at, place: curve.find(at.time_s + offset_s)? }))
            .collect(),
        Association::Nearest => nearest(track, curve, offset_s),
    };
    let in_gaps = track.iter().filter(|at| curve.is_in_gap(at.time_s + offset_s)).count();
    let velocities: Vec<Option<Vector3<f64>>> = (0..reference.len())
        .map(|at| reference[at].velocity_mps.or_else(|| curve.difference_at(at)))
        .collect();
    let compared: Vec<Compared> =
        pairs.iter().map(|pair| compare_one(pair, reference, curve, &velocities)).collect();

    let axis = |axis: usize| {
        Statistics::of(&compared.iter().map(|c| c.difference_m[axis]).collect::<Vec<_>>())
            .ok_or_else(|| nothing_in_common(track, curve, offset_s))
    };
    let axes_m = [axis(0)?, axis(1)?, axis(2)?];
    let turned: Vec<Vector2<f64>> = compared.iter().filter_map(|c| c.along_across_m).collect();
    let of_turned = |axis: usize| Statistics::of(&turned.iter().map(|v| v[axis]).collect::<Vec<_>>());
    let speeds: Vec<f64> = compared.iter().filter_map(|c| c.speed_difference_mps).collect();
    let share_90 =
        |f: fn(&Compared) -> f64| quantile(compared.iter().map(f).collect(), 0.9).unwrap_or(f64::NAN);
    let sigma = |of: fn(&Compared) -> &[Option<f64>; 3]| {
        std::array::from_fn(|axis| median(compared.iter().filter_map(|c| of(c)[axis]).collect()))
    };
    let squares: Vec<f64> = compared.iter().filter_map(|c| c.chi_square).collect();
    let measured = reference.iter().filter(|at| at.velocity_mps.is_some()).count();
    Ok(TrackComparison {
        association,
        clock_offset_s: offset_s,
        positions: [track.len(), reference.len()],
        outside: match association {
            Association::Interpolated => track.len() - compared.len() - in_gaps,
            Association::Nearest => reference.len() - compared.len(),
        },
        in_gaps: if association == Association::Interpolated { in_gaps } else { 0 },
        longest_step_s: curve.longest_step_s(),
        axes_m,
        along_across_m: of_turned(0).zip(of_turned(1)).map(|(along, across)| [along, across]),
        circular_linear_90_m: [
            share_90(|c| c.difference_m.xy().norm()),
            share_90(|c| c.difference_m.z.abs()),
        ],
        speed_mps: Statistics::of(&speeds),
        speed_half_width_mps: half_width_at_half_maximum(&speeds),
        speed_source: (!speeds.is_empty()).then_some(match measured {
            0 => SpeedSource::Differences,
            all if all == reference.len() => SpeedSource::Measured,
            _ => SpeedSource::Mixed,
        }),
        median_speed_mps: median(compared.iter().filter_map(|c| c.reference_speed_mps).collect()),
        sigma_m: sigma(|c| &c.sigma_m),
        reference_sigma_m: sigma(|c| &c.reference_sigma_m),
        chi_square: (!squares.is_empty())
            .then(|| (squares.iter().sum::<f64>() / (2 * squares.len()) as f64, squares.len())),
        compared,
    })
}

fn nothing_in_common(track: &[TrackPosition], curve: &Curve, offset_s: f64) -> String {
    let span = |first: f64, last: f64| format!("{first:.3} s to {last:.3} s");
    let of_track = match (track.first(), track.last()) {
        (Some(first), Some(last)) => span(first.time_s, last.time_s),
        _ => "empty".to_owned(),
    };
    let of_reference = match curve.span_s() {
        Some([first, last]) if first < last => span(first, last),
        Some([only, _]) => format!("a single position at {only:.3} s"),
        None => "empty".to_owned(),
    };
    format!(
        "no frame falls into the reference: the track is {of_track}, the reference {of_reference} on its own \
         clock, with an offset of {offset_s:.3} s (--clock-offset)"
    )
}

/// Every sample of the reference with the frame that is nearest in time.
fn nearest<'t>(track: &'t [TrackPosition], curve: &Curve, offset_s: f64) -> Vec<Pair<'t>> {
    let steps = track.windows(2).map(|pair| pair[1].time_s - pair[0].time_s).collect();
    // Half of the median step, and a little for rounded times.
    let farthest_s = 0.5 * median(steps).unwrap_or(0.0) + 1e-6;
    let sample = |time_s: &f64| {
        let time = |at: &&TrackPosition| (at.time_s + offset_s - time_s).abs();
        let after = track.partition_point(|at| at.time_s + offset_s < *time_s);
        let beside = &track[after.saturating_sub(1)..(after + 1).min(track.len())];
        let at = beside.iter().min_by(|a, b| time(a).total_cmp(&time(b)))?;
        (time(&at) <= farthest_s).then_some(Pair { at, place: curve.find(*time_s)? })
    };
    curve.times_s().iter().filter_map(sample).collect()
}

fn compare_one(
    pair: &Pair,
    reference: &[GnssPosition],
    curve: &Curve,
    velocities: &[Option<Vector3<f64>>],
) -> Compared {
    let Pair { at, place } = pair;
    let [before, after] = [place.before, place.before + 1];
    let between = |from: f64, to: f64| from + place.fraction * (to - from);
    let difference_m = at.position - curve.position(*place);
    // The velocity of a sample itself does not need the next one.
    let velocity = match (velocities[before], velocities[after]) {
        (Some(from), Some(to)) => Some(from + place.fraction * (to - from)),
        (from, _) if place.fraction == 0.0 => from,
        (_, to) if place.fraction == 1.0 => to,
        _ => None,
    };
    let velocity = velocity.map(|velocity| velocity.xy());
    let direction = velocity.filter(|v| v.norm() >= LEAST_SPEED_MPS).map(|v| v.normalize());
    // Errors of a receiver last longer than its step: interpolation does not make them smaller.
    let reference_sigma_m = std::array::from_fn(|axis| {
        Some(between(reference[before].sigma_m[axis]?, reference[after].sigma_m[axis]?))
    });
    Compared {
        frame: at.frame,
        time_s: at.time_s,
        difference_m,
        along_across_m: direction.map(|d| {
            let plan = difference_m.xy();
            Vector2::new(plan.dot(&d), d.perp(&plan))
        }),
        speed_difference_mps: at.speed_mps.zip(velocity).map(|(speed, velocity)| speed - velocity.norm()),
        reference_speed_mps: velocity.map(|v| v.norm()),
        sigma_m: at.sigma_m,
        reference_sigma_m,
        chi_square: chi_square(&difference_m.xy(), at, &reference_sigma_m),
    }
}

/// `d^T (C + C_reference)^-1 d`, where both are known.
fn chi_square(
    difference_m: &Vector2<f64>,
    at: &TrackPosition,
    reference_sigma_m: &[Option<f64>; 3],
) -> Option<f64> {
    let variance = |axis: usize| Some(at.sigma_m[axis]?.powi(2) + reference_sigma_m[axis]?.powi(2));
    let covariance = at.covariance_xy_m2?;
    let both = Matrix2::new(variance(0)?, covariance, covariance, variance(1)?);
    let chi_square = difference_m.dot(&(both.cholesky()?.solve(difference_m)));
    chi_square.is_finite().then_some(chi_square)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::tests::Normal;
    use nalgebra::Point3;

    /// A receiver at 5 Hz that goes around a circle of 20 m at 8 m/s, its clock 1 s ahead.
    fn around(time_s: f64) -> (Point3<f64>, Vector3<f64>) {
        let (sin, cos) = (0.4 * time_s).sin_cos();
        (Point3::new(20.0 * cos, 20.0 * sin, 1.0), Vector3::new(-8.0 * sin, 8.0 * cos, 0.0))
    }

    fn receiver(with_velocity: bool) -> Vec<GnssPosition> {
        let sample = |k: i32| {
            let time_s = 0.2 * f64::from(k);
            let (position, velocity) = around(time_s - 1.0);
            let velocity_mps = with_velocity.then_some(velocity);
            GnssPosition { time_s, position, velocity_mps, sigma_m: [Some(0.03), Some(0.04), None] }
        };
        (0..100).map(sample).collect()
    }

    /// A film at 30 frames a second whose track is off by `error` along and across its motion and upwards.
    fn film(error: impl FnMut(usize) -> Vector3<f64>) -> Vec<TrackPosition> {
        let mut error = error;
        let at = |frame: usize| {
            let time_s = frame as f64 / 30.0;
            let (position, velocity) = around(time_s);
            let (along, e) = (velocity.normalize(), error(frame));
            let across = Vector3::new(-along.y, along.x, 0.0);
            TrackPosition {
                frame: frame as i64,
                time_s,
                position: position + along * e.x + across * e.y + Vector3::z() * e.z,
                speed_mps: Some(8.0 + 0.1 * e.x),
                sigma_m: [Some(0.04), Some(0.03), Some(f64::INFINITY)].map(|s| s.filter(|s| s.is_finite())),
                covariance_xy_m2: Some(0.0),
            }
        };
        (0..600).map(at).collect()
    }

    fn compared(
        track: &[TrackPosition],
        reference: &[GnssPosition],
        association: Association,
    ) -> TrackComparison {
        let curve = Curve::new(reference.iter().map(|at| (at.time_s, at.position, at.velocity_mps)));
        compare(track, reference, &curve, 1.0, association).unwrap()
    }

    #[test]
    fn errors_along_across_and_upwards_come_back() {
        for with_velocity in [true, false] {
            let reference = receiver(with_velocity);
            let found =
                compared(&film(|_| Vector3::new(0.5, -0.2, 0.1)), &reference, Association::Interpolated);
            let [along, across] = found.along_across_m.unwrap();
            assert!((along.median - 0.5).abs() < 2e-3 && (across.median + 0.2).abs() < 2e-3, "{found:?}");
            assert!(along.mad < 2e-3 && (along.rms - 0.5).abs() < 2e-3 && (along.mean - 0.5).abs() < 2e-3);
            assert!((found.axes_m[2].median - 0.1).abs() < 1e-9);
            assert!((found.circular_linear_90_m[0] - 0.5_f64.hypot(0.2)).abs() < 2e-3);
            assert!((found.circular_linear_90_m[1] - 0.1).abs() < 1e-9);
            // The chord of 0.4 s is shorter than the arc.
            let speed = if with_velocity { 0.05 } else { 0.05 + 8.0 * 0.08 * 0.08 / 6.0 };
            assert!((found.speed_mps.unwrap().median - speed).abs() < 2e-2 * 0.4, "{:?}", found.speed_mps);
            let source = if with_velocity { SpeedSource::Measured } else { SpeedSource::Differences };
            assert_eq!(found.speed_source, Some(source));
            // 19.8 s of the reference, of which the film sees those from 1 s on.
            assert_eq!((found.compared.len(), found.outside, found.in_gaps), (565, 35, 0));
            assert_eq!(found.sigma_m, [Some(0.04), Some(0.03), None]);
            assert!((found.reference_sigma_m[1].unwrap() - 0.04).abs() < 1e-12);
            assert!((found.median_speed_mps.unwrap() - 8.0).abs() < 0.02);
        }
    }

    #[test]
    fn differences_of_x_and_y_are_those_of_a_plain_loop() {
        let (track, reference) = (film(|k| Vector3::new(0.01 * k as f64, 0.3, 0.0)), receiver(true));
        let found = compared(&track, &reference, Association::Interpolated);
        let mut x: Vec<f64> = Vec::new();
        for at in &track {
            if at.time_s + 1.0 <= 0.2 * 99.0 {
                x.push(at.position.x - around(at.time_s).0.x);
            }
        }
        x.sort_by(f64::total_cmp);
        assert_eq!(x.len(), found.axes_m[0].count);
        assert!((x[x.len() / 2] - found.axes_m[0].median).abs() < 1e-3);
        let rms = (x.iter().map(|v| v * v).sum::<f64>() / x.len() as f64).sqrt();
        assert!((rms - found.axes_m[0].rms).abs() < 1e-3);
    }

    #[test]
    fn chi_square_is_one_where_both_are_as_good_as_they_say() {
        // Each axis has a variance of 0.03^2 + 0.04^2.
        let mut normal = Normal(7);
        let mut track = film(|_| Vector3::new(0.05 * normal.draw(), 0.05 * normal.draw(), 0.0));
        let found = compared(&track, &receiver(true), Association::Interpolated);
        let (value, count) = found.chi_square.unwrap();
        assert!(count == 565 && (value - 1.0).abs() < 0.15, "{value} of {count}");
        // With a covariance, by the inverse of the matrix in full.
        track[3].covariance_xy_m2 = Some(1e-3);
        let found = compared(&track, &receiver(true), Association::Interpolated).compared[3];
        let both = Matrix2::new(0.0025, 1e-3, 1e-3, 0.0025).try_inverse().unwrap();
        let d = found.difference_m.xy();
        assert!((found.chi_square.unwrap() - (d.transpose() * both * d)[0]).abs() < 1e-9);
        track.iter_mut().for_each(|at| at.covariance_xy_m2 = None);
        assert_eq!(compared(&track, &receiver(true), Association::Interpolated).chi_square, None);
    }

    #[test]
    fn gaps_of_the_reference_are_counted() {
        let mut reference = receiver(false);
        // 1.2 s without a sample: from 9.8 s to 11 s of its clock.
        reference.drain(50..55);
        let found = compared(&film(|_| Vector3::zeros()), &reference, Association::Interpolated);
        assert_eq!((found.compared.len() + found.in_gaps, found.outside), (565, 35));
        assert!((34..=36).contains(&found.in_gaps), "{}", found.in_gaps);
        assert!((found.longest_step_s - 1.0).abs() < 1e-9);
        assert!(found.axes_m[0].abs_95 < 0.01);
    }

    #[test]
    fn the_nearest_frame_is_as_far_off_as_it_is_late() {
        let mut track = film(|_| Vector3::zeros());
        // Every frame 10 ms late: 8 cm along the track.
        track.iter_mut().for_each(|at| at.time_s -= 0.01);
        let found = compared(&track, &receiver(true), Association::Nearest);
        assert_eq!((found.compared.len(), found.outside), (95, 5));
        assert!((found.along_across_m.unwrap()[0].median.abs()) < 0.01, "{found:?}");
        let found = compared(&track, &receiver(true), Association::Interpolated);
        assert!((found.along_across_m.unwrap()[0].median - 0.08).abs() < 1e-3);
    }

    #[test]
    fn a_standing_vehicle_has_no_direction() {
        let reference: Vec<GnssPosition> = receiver(false)
            .into_iter()
            .map(|at| GnssPosition { position: Point3::new(1.0, 2.0, 3.0), ..at })
            .collect();
        let found = compared(&film(|_| Vector3::zeros()), &reference, Association::Interpolated);
        assert_eq!(found.along_across_m, None);
        assert_eq!(found.median_speed_mps, Some(0.0));
    }

    #[test]
    fn what_is_missing_is_named() {
        let reference = receiver(false);
        for (reference, wanted) in [
            (&reference[..0], "the reference empty"),
            (&reference[..1], "a single position at 0.000 s"),
            (&reference[..3], "the reference 0.000 s to 0.400 s on its own clock, with an offset of 1.000 s"),
        ] {
            let curve = Curve::new(reference.iter().map(|at| (at.time_s, at.position, at.velocity_mps)));
            let why = compare(&film(|_| Vector3::zeros()), reference, &curve, 1.0, Association::Interpolated);
            let why = why.unwrap_err();
            assert!(why.contains(wanted), "{why}");
            assert!(why.contains("the track is 0.000 s to 19.967 s"), "{why}");
        }
    }
}
