//! Positions that receivers on vehicles measured, as measurements.
//!
//! A position belongs to the three frames around its video time, which depends on the clock offset: they are
//! chosen anew with every model.

use super::model::{Blocks, Purpose};
use super::network_warnings::NetworkWarning;
use super::outcome::OUTLIER_SIGMAS;
use crate::clock::curve::Curve;
use crate::clock::quantile::median;
use crate::clock::{ClockOffset, Shift, clock_offset};
use crate::estimate::{Estimate, ReceiverEstimate};
use crate::problem::{Problem, ReceivedPosition, Receiver};
use crate::residuals::antenna_position::{AntennaPosition, LeverArm, RECEIVER, video_time_s};
use crate::residuals::known_coordinate::KnownNumber;
use nalgebra::{Point3, Vector3};
use trackbundle_solver::loss::{Loss, LossName};
use trackbundle_solver::manifold::write_pose;
use trackbundle_solver::residual::Residual;
use trackbundle_solver::system::{BlockId, GroupId, Measurement, SystemBuilder};

/// Sets clocks of which nothing is known to where the positions lie on the track of an estimate: the cost of
/// an offset has many minima, and the adjustment finds the next. Where the track does not tell they stay.
pub fn start_clocks(problem: &Problem, estimate: &mut Estimate) {
    for (at, receiver) in problem.receivers.iter().enumerate() {
        let (None, Some(antenna)) =
            (receiver.knowledge.clock_offset, antenna(receiver, &estimate.receivers[at], estimate))
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

/// The blocks of a receiver.
#[derive(Clone, Copy, Debug)]
pub struct ReceiverBlocks {
    /// Its antenna in the vehicle frame.
    pub antenna: BlockId,
    /// Clock offset, drift, shift.
    pub receiver: BlockId,
}

/// No lever arm is known better \[m\].
const LEAST_LEVER_SIGMA_M: f64 = 1e-3;
/// By what a clock of which nothing is known is kept near its start \[s\].
const CONVENTIONAL_OFFSET_S: f64 = 10.0;

/// Middle of a film, where clock offsets are counted \[s\].
pub fn middle_s(problem: &Problem) -> f64 {
    let times = problem.frames.first().zip(problem.frames.last());
    times.map_or(0.0, |(first, last)| 0.5 * (first.time_s + last.time_s))
}

/// Where the antenna of a receiver is in the vehicle frame; `None` where its point has no place.
pub fn antenna(receiver: &Receiver, found: &ReceiverEstimate, estimate: &Estimate) -> Option<Point3<f64>> {
    let vehicle = &estimate.vehicles[receiver.vehicle];
    let point = vehicle.points[receiver.point].filter(|_| vehicle.left_out.is_none())?;
    Some(point + found.lever_arm_m)
}

/// The blocks of all receivers; `None` where the point of one has no place.
pub fn add_blocks(
    builder: &mut SystemBuilder,
    problem: &Problem,
    current: &Estimate,
) -> Vec<Option<ReceiverBlocks>> {
    let of_receiver = |(receiver, found): (&Receiver, &ReceiverEstimate)| {
        let antenna = antenna(receiver, found, current)?;
        let known = &receiver.knowledge;
        let drifts = known.drift_sigma > 0.0;
        let shifts = known.shift_sigma_m > 0.0;
        let has_offset = known.clock_offset.is_none_or(|offset| offset.sigma_m > 0.0);
        let shift = found.shift_m;
        let value = [found.clock_offset_s, found.clock_drift, shift.x, shift.y, shift.z];
        Some(ReceiverBlocks {
            antenna: builder.add_block(
                trackbundle_solver::manifold::Manifold::POINT,
                antenna.coords.as_slice(),
                &[true; 3],
            ),
            receiver: builder.add_block(RECEIVER, &value, &[has_offset, drifts, shifts, shifts, shifts]),
        })
    };
    problem.receivers.iter().zip(&current.receivers).map(of_receiver).collect()
}

/// The groups of receivers.
pub struct ReceiverGroups {
    /// Measured positions.
    pub positions: GroupId,
    /// What is known of clocks, shifts and lever arms.
    pub knowledge: [GroupId; 2],
    /// What only keeps clocks near their start.
    pub conventions: GroupId,
    /// Receiver and position of each measured position.
    pub items: Vec<(usize, usize)>,
}

/// The three frames around a time, from the times of frames that have a pose; `None` outside the film.
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
pub type PlacedPosition = (AntennaPosition, [usize; 3], [f64; 3]);

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

/// The positions of a receiver that fall into the time of these frames.
pub fn positions_at(
    problem: &Problem,
    frames: &[usize],
    receiver: &Receiver,
    found: &ReceiverEstimate,
) -> Vec<PlacedPosition> {
    positions_in(problem, frames, receiver, found).into_iter().flatten().collect()
}

/// Adds the positions that fall into the film, and what is known of receivers.
pub fn add_receivers(
    builder: &mut SystemBuilder,
    problem: &Problem,
    current: &Estimate,
    blocks: &Blocks,
    purpose: Purpose<'_>,
    warnings: &mut Vec<NetworkWarning>,
) -> ReceiverGroups {
    let (mut positions, mut items) = (Vec::new(), Vec::new());
    let (mut numbers, mut arms, mut kept) = (Vec::new(), Vec::new(), Vec::new());
    for (at, (receiver, own)) in problem.receivers.iter().zip(&blocks.receivers).enumerate() {
        let name = receiver.name(&problem.vehicles);
        let Some(own) = own else {
            warnings.push(NetworkWarning::ReceiverWithoutPlace { receiver: name });
            continue;
        };
        let poses = &blocks.vehicles[receiver.vehicle].poses;
        let found = &current.receivers[at];
        let (mut rejected, mut used) = (0, 0);
        let frames: Vec<usize> = (0..poses.len()).filter(|frame| poses[*frame].is_some()).collect();
        let placed = positions_in(problem, &frames, receiver, found);
        // By what all scatter: where a clock is held at a wrong offset, all are off together.
        let deviations = deviations(problem, current, at, &placed);
        let limit = OUTLIER_SIGMAS * spread_of(&deviations);
        for (item, (position, deviation)) in placed.into_iter().zip(deviations).enumerate() {
            let Some((residual, frames, sigma_m)) = position else { continue };
            if matches!(purpose, Purpose::Statistics { .. }) && deviation.is_none_or(|d| d > limit) {
                rejected += 1;
                continue;
            }
            used += 1;
            let [a, b, c] = frames.map(|frame| poses[frame].expect("a frame with a pose"));
            let seen = [a, b, c, own.antenna, own.receiver];
            positions.push(Measurement { residual, blocks: seen, sigma: sigma_m });
            items.push((at, item));
        }
        if rejected > 0 {
            warnings.push(NetworkWarning::PositionsRejected { receiver: name.clone(), rejected, used });
        }
        if used == 0 {
            warnings.push(NetworkWarning::NoPositionInTime { receiver: name });
        }
        let known = &receiver.knowledge;
        if let Some(point) = blocks.vehicles[receiver.vehicle].points[receiver.point] {
            let sigma_m = known.lever_sigma_m.max(LEAST_LEVER_SIGMA_M);
            arms.push(Measurement {
                residual: LeverArm { arm_m: known.lever_arm_m },
                blocks: [own.antenna, point],
                sigma: [sigma_m; 3],
            });
        }
        let row = |at: usize, known: f64, sigma: f64| Measurement {
            residual: KnownNumber::<5> { at, known },
            blocks: [own.receiver],
            sigma: [sigma],
        };
        match known.clock_offset {
            None => kept.push(row(0, found.clock_offset_s, CONVENTIONAL_OFFSET_S)),
            Some(offset) if offset.sigma_m > 0.0 => numbers.push(row(0, offset.value_m, offset.sigma_m)),
            Some(_) => {}
        }
        if known.drift_sigma > 0.0 {
            numbers.push(row(1, 0.0, known.drift_sigma));
        }
        if known.shift_sigma_m > 0.0 {
            numbers.extend((2..5).map(|at| row(at, 0.0, known.shift_sigma_m)));
        }
    }
    let loss = match purpose {
        Purpose::Adjustment { .. } => Loss::Huber { scale: LossName::Huber.default_scale() },
        Purpose::Statistics { .. } => Loss::Squared,
    };
    ReceiverGroups {
        positions: builder.add_group("position of an antenna", loss, positions),
        knowledge: [
            builder.add_group("known clock or shift of a receiver", Loss::Squared, numbers),
            builder.add_group("lever arm of an antenna", Loss::Squared, arms),
        ],
        conventions: builder.add_group("start of a clock", Loss::Squared, kept),
        items,
    }
}

/// The scatter of deviations in three axes, at least 1.
fn spread_of(deviations: &[Option<f64>]) -> f64 {
    // The median of the norm of three normal numbers.
    const MEDIAN: f64 = 1.538;
    median(deviations.iter().copied().flatten().collect()).map_or(1.0, |median| (median / MEDIAN).max(1.0))
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
    let shift = found.shift_m;
    let value = [found.clock_offset_s, found.clock_drift, shift.x, shift.y, shift.z];
    let deviation = |(residual, frames, sigma_m): &PlacedPosition| {
        let antenna = antenna(receiver, found, current)?;
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
