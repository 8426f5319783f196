//! Positions that receivers on vehicles measured, as measurements.
//!
//! A position belongs to the three frames around its video time, which depends on the clock offset: they are
//! chosen anew with every model.

use super::blocks::{Blocks, ReceiverBlocks};
use super::selection::{OUTLIER_SIGMAS, Purpose};
use super::sink::Sink;
use super::source::Source;
use super::warnings::NetworkWarning;
use crate::clock::curve::Curve;
use crate::clock::{ClockOffset, Shift, clock_offset};
use crate::estimate::{Estimate, ReceiverEstimate};
use crate::problem::{Problem, ReceivedPosition, Receiver};
use crate::residuals::antenna_position::{AntennaPosition, LeverArm, video_time_s};
use crate::residuals::known_coordinate::KnownNumber;
use crate::stats::normal::MEDIAN_OF_NORM_3;
use crate::stats::quantile::median;
use nalgebra::Vector3;
use trackbundle_solver::loss::{Loss, LossName};
use trackbundle_solver::manifold::write_pose;
use trackbundle_solver::residual::Residual;
use trackbundle_solver::system::{BlockId, Measurement};

/// Sets clocks of which nothing is known to where the positions lie on the track of an estimate: the cost of
/// an offset has many minima, and the adjustment finds the next. Where the track does not tell they stay.
pub fn start_clocks(problem: &Problem, estimate: &mut Estimate) {
    for (at, receiver) in problem.receivers.iter().enumerate() {
        let (None, Some(antenna)) =
            (receiver.knowledge.clock_offset, estimate.antenna(receiver, &estimate.receivers[at]))
        else {
            continue;
        };
        let poses = problem.frames.iter().zip(&estimate.vehicles[receiver.vehicle].poses);
        let track =
            Curve::new(poses.filter_map(|(frame, pose)| Some((frame.time_s, (*pose)? * antenna, None))));
        let measured = Curve::new(receiver.positions.iter().map(|p| (p.time_s, p.position, None)));
        let found = [Shift::Free, Shift::None].map(|shift| clock_offset(&track, &measured, shift));
        let offset_s = found.iter().find_map(|found| match found {
            ClockOffset::Estimated(found) => Some(found.offset_s),
            ClockOffset::NotObservable { .. } => None,
        });
        estimate.receivers[at].clock_offset_s = offset_s.unwrap_or(0.0);
    }
}

/// No lever arm is known better \[m\].
const LEAST_LEVER_SIGMA_M: f64 = 1e-3;
/// By what a clock of which nothing is known is kept near its start \[s\].
const CONVENTIONAL_OFFSET_S: f64 = 10.0;

/// Middle of a video, where clock offsets are counted \[s\].
pub fn middle_s(problem: &Problem) -> f64 {
    let times = problem.frames.first().zip(problem.frames.last());
    times.map_or(0.0, |(first, last)| 0.5 * (first.time_s + last.time_s))
}

/// The three frames around a time, from the times of frames that have a pose; `None` outside the video.
fn frames_around(times: &[(usize, f64)], time_s: f64) -> Option<[usize; 3]> {
    let n = times.len();
    if n < 3 {
        return None;
    }
    let step = |at: usize| times[at + 1].1 - times[at].1;
    if time_s < times[0].1 - 0.5 * step(0) || time_s > times[n - 1].1 + 0.5 * step(n - 2) {
        return None;
    }
    let after = times.partition_point(|(_, t)| *t < time_s);
    let nearest = match after {
        0 => 0,
        at if at == n => n - 1,
        at if time_s - times[at - 1].1 < times[at].1 - time_s => at - 1,
        at => at,
    };
    let middle = nearest.clamp(1, n - 2);
    Some([middle - 1, middle, middle + 1])
}

/// A position, its three frames, and its standard deviations \[m\].
type PlacedPosition = (AntennaPosition, [usize; 3], [f64; 3]);

/// Each position of a receiver as a measurement between three of these frames; `None` where it does not fall
/// into their time.
fn positions_in(
    problem: &Problem,
    frames: &[usize],
    receiver: &Receiver,
    found: &ReceiverEstimate,
) -> Vec<Option<PlacedPosition>> {
    let times: Vec<(usize, f64)> =
        frames.iter().map(|frame| (*frame, problem.frames[*frame].time_s)).collect();
    let middle_s = middle_s(problem);
    let placed = |position: &ReceivedPosition| {
        let t = video_time_s(position.time_s, middle_s, found.clock_offset_s, found.clock_drift);
        let around = frames_around(&times, t)?;
        let residual = AntennaPosition {
            frames_s: around.map(|k| times[k].1),
            time_s: position.time_s,
            middle_s,
            measured: position.position,
        };
        Some((residual, around.map(|k| times[k].0), position.sigma_m))
    };
    receiver.positions.iter().map(placed).collect()
}

/// Adds the positions that fall into the video, and what is known of receivers. Returns receiver and position of
/// each measured position that takes part.
pub fn add_receivers(
    sink: &mut impl Sink,
    problem: &Problem,
    current: &Estimate,
    blocks: &Blocks,
    purpose: Purpose<'_>,
    warnings: &mut Vec<NetworkWarning>,
) -> Vec<(usize, usize)> {
    let (mut positions, mut items) = (Vec::new(), Vec::new());
    let mut known = Knowledge::default();
    for (at, (receiver, own)) in problem.receivers.iter().zip(&blocks.receivers).enumerate() {
        let Some(own) = own else {
            let receiver = receiver.name(&problem.vehicles);
            warnings.push(NetworkWarning::ReceiverWithoutPlace { receiver });
            continue;
        };
        let poses = &blocks.vehicles[receiver.vehicle].poses;
        for (item, residual, frames, sigma) in chosen(problem, current, at, poses, purpose, warnings) {
            let [a, b, c] = frames.map(|frame| poses[frame].expect("a frame with a pose"));
            positions.push(Measurement { residual, blocks: [a, b, c, own.antenna, own.receiver], sigma });
            items.push((at, item));
        }
        let point = blocks.vehicles[receiver.vehicle].points[receiver.point];
        known.add(receiver, &current.receivers[at], *own, point);
    }
    let loss = match purpose {
        Purpose::Adjustment { .. } => Loss::Huber { scale: LossName::Huber.default_scale() },
        Purpose::Statistics { .. } => Loss::Squared,
    };
    sink.group(Source::Gnss, "position of an antenna", loss, positions);
    sink.squares(Source::GnssKnowledge, "known clock or shift of a receiver", known.numbers);
    sink.squares(Source::GnssKnowledge, "lever arm of an antenna", known.arms);
    sink.squares(Source::Convention, "start of a clock", known.kept);
    items
}

/// The positions of a receiver that take part: which, as a measurement, its three frames, its standard deviations.
fn chosen(
    problem: &Problem,
    current: &Estimate,
    at: usize,
    poses: &[Option<BlockId>],
    purpose: Purpose<'_>,
    warnings: &mut Vec<NetworkWarning>,
) -> Vec<(usize, AntennaPosition, [usize; 3], [f64; 3])> {
    let receiver = &problem.receivers[at];
    let name = receiver.name(&problem.vehicles);
    let frames: Vec<usize> = (0..poses.len()).filter(|frame| poses[*frame].is_some()).collect();
    let placed = positions_in(problem, &frames, receiver, &current.receivers[at]);
    // By what all scatter: where a clock is held at a wrong offset, all are off together.
    let deviations = deviations(problem, current, at, &placed);
    let limit = OUTLIER_SIGMAS * spread_of(&deviations);
    let (mut rejected, mut taken) = (0, Vec::new());
    for (item, (position, deviation)) in placed.into_iter().zip(deviations).enumerate() {
        let Some((residual, frames, sigma_m)) = position else { continue };
        if matches!(purpose, Purpose::Statistics { .. }) && deviation.is_none_or(|d| d > limit) {
            rejected += 1;
        } else {
            taken.push((item, residual, frames, sigma_m));
        }
    }
    let used = taken.len();
    if rejected > 0 {
        warnings.push(NetworkWarning::PositionsRejected { receiver: name.clone(), rejected, used });
    }
    if used == 0 {
        warnings.push(NetworkWarning::NoPositionInTime { receiver: name });
    }
    taken
}

/// What is known of receivers, as measurements.
#[derive(Default)]
struct Knowledge {
    numbers: Vec<Measurement<KnownNumber<5>, 1, 1>>,
    arms: Vec<Measurement<LeverArm, 3, 2>>,
    /// What only keeps clocks near their start.
    kept: Vec<Measurement<KnownNumber<5>, 1, 1>>,
}

impl Knowledge {
    fn add(
        &mut self,
        receiver: &Receiver,
        found: &ReceiverEstimate,
        own: ReceiverBlocks,
        point: Option<BlockId>,
    ) {
        let known = &receiver.knowledge;
        if let Some(point) = point {
            let sigma_m = known.lever_sigma_m.max(LEAST_LEVER_SIGMA_M);
            let residual = LeverArm { arm_m: known.lever_arm_m };
            self.arms.push(Measurement { residual, blocks: [own.antenna, point], sigma: [sigma_m; 3] });
        }
        let row = |at: usize, known: f64, sigma: f64| {
            let residual = KnownNumber::<5> { at, known };
            Measurement { residual, blocks: [own.receiver], sigma: [sigma] }
        };
        match known.clock_offset {
            None => self.kept.push(row(0, found.clock_offset_s, CONVENTIONAL_OFFSET_S)),
            Some(offset) if offset.sigma_s > 0.0 => self.numbers.push(row(0, offset.value_s, offset.sigma_s)),
            Some(_) => {}
        }
        if known.drift_sigma > 0.0 {
            self.numbers.push(row(1, 0.0, known.drift_sigma));
        }
        if known.shift_sigma_m > 0.0 {
            self.numbers.extend((2..5).map(|at| row(at, 0.0, known.shift_sigma_m)));
        }
    }
}

/// The scatter of deviations in three axes, at least 1.
fn spread_of(deviations: &[Option<f64>]) -> f64 {
    median(deviations.iter().copied().flatten().collect())
        .map_or(1.0, |median| (median / MEDIAN_OF_NORM_3).max(1.0))
}

/// How many standard deviations each position is off at the current estimate; `None` where it takes no part.
fn deviations(
    problem: &Problem,
    current: &Estimate,
    receiver: usize,
    positions: &[Option<PlacedPosition>],
) -> Vec<Option<f64>> {
    let found = &current.receivers[receiver];
    let receiver = &problem.receivers[receiver];
    let poses = &current.vehicles[receiver.vehicle].poses;
    let value = found.numbers();
    let deviation = |(residual, frames, sigma_m): &PlacedPosition| {
        let antenna = current.antenna(receiver, found)?;
        let [a, b, c] = frames.map(|frame| poses[frame]);
        let [a, b, c] = [write_pose(&a?), write_pose(&b?), write_pose(&c?)];
        let off: Vector3<f64> = residual.evaluate(&[&a, &b, &c, antenna.coords.as_slice(), &value], None)?;
        Some(off.component_div(&Vector3::from(*sigma_m)).norm())
    };
    positions.iter().map(|position| deviation(position.as_ref()?)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_position_belongs_to_the_frames_around_it() {
        let times: Vec<(usize, f64)> = (0..5).map(|k| (k + 7, k as f64)).collect();
        assert_eq!(frames_around(&times, 2.4), Some([1, 2, 3]));
        assert_eq!(frames_around(&times, 2.6), Some([2, 3, 4]));
        assert_eq!(frames_around(&times, -0.4), Some([0, 1, 2]));
        assert_eq!(frames_around(&times, 4.4), Some([2, 3, 4]));
        assert_eq!(frames_around(&times, 4.6), None);
        assert_eq!(frames_around(&times, -0.6), None);
        assert_eq!(frames_around(&times[..2], 0.5), None);
    }
}
