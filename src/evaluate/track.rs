//! A track against GNSS positions: result minus reference, as they stand or after an alignment.

use super::alignment::{Aligned, Alignment};
use super::pairs::{Association, Pair, pairs};
use super::statistics::{DifferenceStatistics, Distances, HalfWidth, half_width_at_half_maximum};
use crate::clock::curve::Curve;
use crate::files::TrackPosition;
use crate::reference::GnssPosition;
use crate::stats::quantile::{median, quantile};
use nalgebra::{Matrix2, Point3, Vector2, Vector3};

/// A reference that moves more slowly than this has no direction \[m/s\].
pub const LEAST_SPEED_MPS: f64 = 0.5;

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
    /// Time of the place of the reference, on its own clock \[s\].
    pub reference_time_s: f64,
    /// Position of the result, where the alignment brought it \[m\].
    pub position: Point3<f64>,
    /// Position of the reference \[m\].
    pub reference: Point3<f64>,
    /// Result minus reference \[m\].
    pub difference_m: Vector3<f64>,
    /// The same along the reference's motion and to the left of it \[m\]; `None` where it hardly moves.
    pub along_across_m: Option<Vector2<f64>>,
    /// Horizontal speed of the result, in the scale to which the alignment brought it \[m/s\].
    pub speed_mps: Option<f64>,
    /// Its standard deviation, in its own scale \[m/s\].
    pub sigma_speed_mps: Option<f64>,
    /// Horizontal speed, result minus reference \[m/s\].
    pub speed_difference_mps: Option<f64>,
    /// Speed of the reference \[m/s\].
    pub reference_speed_mps: Option<f64>,
    /// Heading of the result's body, where the alignment turned it \[deg\].
    pub heading_deg: Option<f64>,
    /// Heading of the result's body less the course of the reference, in (-180, 180\] \[deg\].
    pub heading_difference_deg: Option<f64>,
    /// Direction in which the result moves less that of the reference, likewise \[deg\].
    pub course_difference_deg: Option<f64>,
    /// Standard deviation of the result's heading \[deg\].
    pub sigma_heading_deg: Option<f64>,
    /// Standard deviations of the result, in its own frame \[m\].
    pub sigma_m: [Option<f64>; 3],
    /// Standard deviations of the reference \[m\].
    pub reference_sigma_m: [Option<f64>; 3],
    /// Chi-square of the difference in the plan, of two degrees of freedom; none after an alignment.
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
    /// Frames outside the time of the reference (with [`Association::Nearest`]: samples of the sparser of the
    /// two without a partner).
    pub outside: usize,
    /// Frames in its gaps.
    pub in_gaps: usize,
    /// The longest step of the reference that is no gap \[s\].
    pub longest_step_s: f64,
    /// The greatest difference of time between what was compared that was allowed \[s\].
    pub max_gap_s: f64,
    /// What was done to the result before.
    pub aligned: Aligned,
    /// What was compared, in time order.
    pub compared: Vec<Compared>,
    /// Differences along x, y, z \[m\].
    pub axes_m: [DifferenceStatistics; 3],
    /// Differences along the motion and to the left of it \[m\].
    pub along_across_m: Option<[DifferenceStatistics; 2]>,
    /// Distances in space \[m\].
    pub distances_m: Distances,
    /// 90 % of horizontal distances are no larger (CE90), nor are 90 % of vertical ones (LE90) \[m\].
    pub circular_linear_90_m: [f64; 2],
    /// Differences of speed \[m/s\].
    pub speed_mps: Option<DifferenceStatistics>,
    /// Half width of their histogram at half its maximum \[m/s\].
    pub speed_half_width_mps: Option<HalfWidth>,
    /// Where the speed of the reference comes from.
    pub speed_source: Option<SpeedSource>,
    /// Median speed of the reference \[m/s\].
    pub median_speed_mps: Option<f64>,
    /// Heading of the result's body less the course of the reference \[deg\].
    pub heading_deg: Option<DifferenceStatistics>,
    /// Course of the result less the course of the reference \[deg\].
    pub course_deg: Option<DifferenceStatistics>,
    /// Half the time over which the course of the result is a difference of places \[s\].
    pub course_step_s: f64,
    /// Median standard deviation of the result's heading \[deg\].
    pub sigma_heading_deg: Option<f64>,
    /// Median standard deviations of the result \[m\], where they are known.
    pub sigma_m: [Option<f64>; 3],
    /// The same of the reference \[m\].
    pub reference_sigma_m: [Option<f64>; 3],
    /// Chi-square of the plan per degree of freedom, and of how many positions: where the covariances of
    /// both are known.
    pub chi_square: Option<(f64, usize)>,
}

/// How a track is compared.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Comparison {
    /// The offset of the reference's clock \[s\].
    pub offset_s: f64,
    /// What is compared with what.
    pub association: Association,
    /// What may be changed of the result before.
    pub alignment: Alignment,
}

/// A track and its reference, as samples and as curves.
struct Tracks<'t> {
    own: &'t Curve,
    reference: &'t [GnssPosition],
    curve: &'t Curve,
    /// Velocity of the reference at each of its samples \[m/s\].
    velocities: Vec<Option<Vector3<f64>>>,
    aligned: Aligned,
}

/// Compares a track, whose curve is `own`, with its reference, whose curve is `curve`; or says what is
/// missing.
pub fn compare(
    track: &[TrackPosition],
    own: &Curve,
    reference: &[GnssPosition],
    curve: &Curve,
    comparison: &Comparison,
) -> Result<TrackComparison, String> {
    let Comparison { offset_s, association, alignment } = *comparison;
    let (pairs, max_gap_s) = pairs(track, reference, curve, offset_s, association);
    if pairs.is_empty() {
        return Err(nothing_in_common(track, curve, offset_s));
    }
    let places = |of: fn(&Pair) -> Point3<f64>| pairs.iter().map(of).collect::<Vec<_>>();
    let aligned = Aligned::fit(alignment, &places(|pair| pair.at.position), &places(|pair| pair.reference))?;
    let in_gaps = track.iter().filter(|at| curve.is_in_gap(at.time_s + offset_s)).count();
    let velocities: Vec<Option<Vector3<f64>>> = (0..reference.len())
        .map(|at| reference[at].velocity_mps.or_else(|| curve.difference_at(at)))
        .collect();
    let tracks = Tracks { own, reference, curve, velocities, aligned };
    let compared: Vec<Compared> = pairs.iter().map(|pair| tracks.compare(pair)).collect();

    let axis = |axis: usize| {
        DifferenceStatistics::of(&compared.iter().map(|c| c.difference_m[axis]).collect::<Vec<_>>())
            .ok_or_else(|| nothing_in_common(track, curve, offset_s))
    };
    let axes_m = [axis(0)?, axis(1)?, axis(2)?];
    let turned: Vec<Vector2<f64>> = compared.iter().filter_map(|c| c.along_across_m).collect();
    let of_turned =
        |axis: usize| DifferenceStatistics::of(&turned.iter().map(|v| v[axis]).collect::<Vec<_>>());
    let speeds: Vec<f64> = compared.iter().filter_map(|c| c.speed_difference_mps).collect();
    let share_90 =
        |f: fn(&Compared) -> f64| quantile(compared.iter().map(f).collect(), 0.9).unwrap_or(f64::NAN);
    let sigma = |of: fn(&Compared) -> &[Option<f64>; 3]| {
        std::array::from_fn(|axis| median(compared.iter().filter_map(|c| of(c)[axis]).collect()))
    };
    let of_some = |of: fn(&Compared) -> Option<f64>| compared.iter().filter_map(of).collect::<Vec<_>>();
    let distances: Vec<f64> = compared.iter().map(|c| c.difference_m.norm()).collect();
    let squares: Vec<f64> = compared.iter().filter_map(|c| c.chi_square).collect();
    let measured = reference.iter().filter(|at| at.velocity_mps.is_some()).count();
    Ok(TrackComparison {
        association,
        clock_offset_s: offset_s,
        positions: [track.len(), reference.len()],
        outside: match association {
            Association::Interpolated => track.len() - compared.len() - in_gaps,
            Association::Nearest { .. } => track.len().min(reference.len()) - compared.len(),
        },
        in_gaps: if association == Association::Interpolated { in_gaps } else { 0 },
        longest_step_s: curve.longest_step_s(),
        max_gap_s,
        aligned,
        axes_m,
        along_across_m: of_turned(0).zip(of_turned(1)).map(|(along, across)| [along, across]),
        distances_m: Distances::of(&distances).ok_or_else(|| nothing_in_common(track, curve, offset_s))?,
        circular_linear_90_m: [
            share_90(|c| c.difference_m.xy().norm()),
            share_90(|c| c.difference_m.z.abs()),
        ],
        speed_mps: DifferenceStatistics::of(&speeds),
        speed_half_width_mps: half_width_at_half_maximum(&speeds),
        speed_source: (!speeds.is_empty()).then_some(match measured {
            0 => SpeedSource::Differences,
            all if all == reference.len() => SpeedSource::Measured,
            _ => SpeedSource::Mixed,
        }),
        heading_deg: DifferenceStatistics::of(&of_some(|c| c.heading_difference_deg)),
        course_deg: DifferenceStatistics::of(&of_some(|c| c.course_difference_deg)),
        course_step_s: curve.step_s(),
        sigma_heading_deg: median(of_some(|c| c.sigma_heading_deg)),
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

impl Tracks<'_> {
    fn compare(&self, pair: &Pair) -> Compared {
        let Pair { at, place, .. } = pair;
        let before = place.before;
        let after = (before + 1).min(self.reference.len() - 1);
        let position = self.aligned.position(&at.position);
        let difference_m = position - pair.reference;
        // The velocity of a sample itself does not need the next one.
        let velocity = match (self.velocities[before], self.velocities[after]) {
            (from, _) if place.fraction == 0.0 => from,
            (_, to) if place.fraction == 1.0 => to,
            (Some(from), Some(to)) => Some(from + place.fraction * (to - from)),
            _ => None,
        };
        let velocity = velocity.map(|velocity| velocity.xy());
        let direction = velocity.and_then(direction);
        let course = direction.map(|d| d.y.atan2(d.x));
        // Errors of a receiver last longer than its step: interpolation does not make them smaller.
        let reference_sigma_m = std::array::from_fn(|axis| {
            let [from, to] = [before, after].map(|sample| self.reference[sample].sigma_m[axis]);
            if place.fraction == 0.0 { from } else { Some(from? + place.fraction * (to? - from?)) }
        });
        let less_course = |heading: f64| {
            course.map(|course| wrapped_deg((self.aligned.heading_rad(heading) - course).to_degrees()))
        };
        let speed = at.speed_mps.map(|speed| self.aligned.scale * speed);
        Compared {
            frame: at.frame,
            time_s: at.time_s,
            reference_time_s: pair.reference_time_s,
            position,
            reference: pair.reference,
            difference_m,
            along_across_m: direction.map(|d| {
                let plan = difference_m.xy();
                Vector2::new(plan.dot(&d), d.perp(&plan))
            }),
            speed_mps: speed,
            sigma_speed_mps: at.sigma_speed_mps,
            speed_difference_mps: speed.zip(velocity).map(|(speed, velocity)| speed - velocity.norm()),
            reference_speed_mps: velocity.map(|v| v.norm()),
            heading_deg: at.heading_deg.map(|heading| self.aligned.heading_deg(heading)),
            heading_difference_deg: at.heading_deg.and_then(|heading| less_course(heading.to_radians())),
            course_difference_deg: self.own_course_rad(at.time_s).and_then(less_course),
            sigma_heading_deg: at.sigma_heading_deg,
            sigma_m: at.sigma_m,
            reference_sigma_m,
            chi_square: match self.aligned.alignment {
                Alignment::None => chi_square(&difference_m.xy(), at, &reference_sigma_m),
                Alignment::Rigid | Alignment::Similarity => None,
            },
        }
    }

    /// Direction in which the result moves: from its place a step of the reference earlier to that a step
    /// later, before any alignment \[rad\].
    fn own_course_rad(&self, time_s: f64) -> Option<f64> {
        let half_s = self.curve.step_s();
        let moved = self.own.at(time_s + half_s)? - self.own.at(time_s - half_s)?;
        direction(moved.xy() / (2.0 * half_s)).map(|d| d.y.atan2(d.x))
    }
}

/// Direction of a velocity that has one.
fn direction(velocity_mps: Vector2<f64>) -> Option<Vector2<f64>> {
    let speed = velocity_mps.norm();
    (speed >= LEAST_SPEED_MPS && speed.is_finite()).then(|| velocity_mps / speed)
}

/// An angle in (-180, 180\] \[deg\].
fn wrapped_deg(angle_deg: f64) -> f64 {
    let rest = angle_deg.rem_euclid(360.0);
    if rest > 180.0 { rest - 360.0 } else { rest }
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
    use crate::stats::drawn::Normal;
    use nalgebra::Rotation2;

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
            let sigma_m = [Some(0.03), Some(0.04), None];
            GnssPosition { time_s, position, velocity_mps, sigma_m }
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
                sigma_speed_mps: None,
                speed_mps: Some(8.0 + 0.1 * e.x),
                // 2 deg to the left of where it goes.
                heading_deg: Some(wrapped_deg(velocity.y.atan2(velocity.x).to_degrees() + 2.0)),
                sigma_heading_deg: Some(0.5),
                is_open: [false; 3],
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
        aligned(track, reference, association, Alignment::None).unwrap()
    }

    fn aligned(
        track: &[TrackPosition],
        reference: &[GnssPosition],
        association: Association,
        alignment: Alignment,
    ) -> Result<TrackComparison, String> {
        let own = Curve::new(track.iter().map(|at| (at.time_s, at.position, None)));
        let curve = Curve::new(reference.iter().map(|at| (at.time_s, at.position, at.velocity_mps)));
        let comparison = Comparison { offset_s: 1.0, association, alignment };
        compare(track, &own, reference, &curve, &comparison)
    }

    const NEAREST: Association = Association::Nearest { max_gap_s: None };

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
        let found = compared(&track, &receiver(true), NEAREST);
        assert_eq!((found.compared.len(), found.outside), (95, 5));
        assert!((found.along_across_m.unwrap()[0].median.abs()) < 0.01, "{found:?}");
        let found = compared(&track, &receiver(true), Association::Interpolated);
        assert!((found.along_across_m.unwrap()[0].median - 0.08).abs() < 1e-3);
    }

    #[test]
    fn headings_and_courses_are_told_apart() {
        for with_velocity in [true, false] {
            let track = film(|_| Vector3::new(0.0, 0.1, 0.0));
            let found = compared(&track, &receiver(with_velocity), Association::Interpolated);
            let (heading, course) = (found.heading_deg.unwrap(), found.course_deg.unwrap());
            assert!((heading.median - 2.0).abs() < 0.01 && heading.mad < 0.05, "{heading:?}");
            assert!(course.median.abs() < 0.01 && course.abs_95 < 0.1, "{course:?}");
            // The first and the last 0.2 s of the film have no course of their own.
            assert!(heading.count == 565 - if with_velocity { 0 } else { 6 } && course.count < heading.count);
            assert!((found.course_step_s - 0.2).abs() < 1e-9);
            assert_eq!(found.sigma_heading_deg, Some(0.5));
        }
    }

    #[test]
    fn angles_are_the_short_way_round() {
        for (angle, wanted) in [(181.0, -179.0), (180.0, 180.0), (-180.0, 180.0), (719.0, -1.0), (0.5, 0.5)] {
            assert_eq!(wrapped_deg(angle), wanted);
        }
    }

    #[test]
    fn an_alignment_takes_out_what_it_may_and_nothing_else() {
        // A result 2 % too small that was turned by 3 deg and shifted.
        let turn = Rotation2::new(3_f64.to_radians());
        let mut normal = Normal(5);
        let mut track = film(|_| Vector3::new(0.01 * normal.draw(), 0.01 * normal.draw(), 0.0));
        for at in &mut track {
            let plan = 0.98 * (turn * at.position.xy().coords) + Vector2::new(4.0, -1.0);
            at.position = Point3::new(plan.x, plan.y, 0.98 * at.position.z + 2.0);
            at.speed_mps = at.speed_mps.map(|speed| 0.98 * speed);
            at.heading_deg = at.heading_deg.map(|heading| heading + 3.0);
        }
        let reference = receiver(true);
        let with = |alignment| aligned(&track, &reference, Association::Interpolated, alignment).unwrap();
        let [none, rigid, similarity] = [Alignment::None, Alignment::Rigid, Alignment::Similarity].map(with);
        assert!(none.distances_m.rmse > 2.0 && none.chi_square.is_some() && rigid.chi_square.is_none());
        // A circle of 20 m that is 2 % too small.
        assert!((rigid.distances_m.mean - 0.4).abs() < 0.02, "{:?}", rigid.distances_m);
        assert!((similarity.distances_m.rmse - 0.01 * 2_f64.sqrt()).abs() < 0.003, "{similarity:?}");
        assert!((similarity.aligned.scale * 0.98 - 1.0).abs() < 1e-3 && rigid.aligned.scale == 1.0);
        for (found, speed) in [(rigid, -0.16), (similarity, 0.0)] {
            assert!((found.aligned.angle_rad() - 3_f64.to_radians()).abs() < 1e-3);
            assert!((found.heading_deg.unwrap().median - 2.0).abs() < 0.05, "{:?}", found.heading_deg);
            assert!(found.course_deg.unwrap().median.abs() < 0.05);
            assert!((found.speed_mps.unwrap().median - speed).abs() < 0.01, "{:?}", found.speed_mps);
        }
        assert!((none.heading_deg.unwrap().median - 5.0).abs() < 0.05);
        // Pairs of the nearest are aligned likewise.
        let nearest = aligned(&track, &reference, NEAREST, Alignment::Similarity).unwrap();
        assert!(nearest.distances_m.max < 0.2, "{:?}", nearest.distances_m);
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
            let track = film(|_| Vector3::zeros());
            let why = aligned(&track, reference, Association::Interpolated, Alignment::None).unwrap_err();
            assert!(why.contains(wanted), "{why}");
            assert!(why.contains("the track is 0.000 s to 19.967 s"), "{why}");
        }
    }
}
