//! The verdict on every image point: used, down-weighted, or rejected for a named reason.
//!
//! Gross errors come alone (a wrong match), as whole tracks (a shape point whose image points sit on the
//! road, on a shadow or on another vehicle, and which do not move with the body), and as whole frames (an
//! image of the wrong time, another image's points). A robust loss sees image points one by one. It is
//! bound to keep those few of a wrong track that fit by chance, where a place on the road crosses the path
//! of the shape point, and these pull at the poses all from one side. So image points are judged together:
//!
//! 1. an image point is gross beyond [`OUTLIER_SIGMAS`] times the spread;
//! 2. a track most of whose image points are gross is rejected as a whole, if nine in ten are, or if the
//!    gross ones follow each other: residuals of a thing that moves otherwise change slowly from one frame
//!    to the next, those of errors that come alone do not (after von Neumann's ratio of successive
//!    differences, 1941, with medians in place of mean squares);
//! 3. of what is left, a frame of a vehicle, or of the targets, likewise;
//! 4. what is then gross is rejected by itself.
//!
//! Whole tracks and frames take no part in the adjustment ([`Excluded`]): they are judged before it, by how
//! much worse than others they fit the first estimate, and again whenever poses are better known, each with
//! its point found anew. What then fits comes back.

use super::fit::ObservationFit;
use super::verdicts::{Excluded, ImagePointVerdict, RejectionReason, Verdicts};
use super::wrong_tracks::{Judge, against_the_body, kind_of, suspected_static, swapped_part};
use crate::estimate::{Estimate, Imaging};
use crate::initialise::{point_anew, static_scatter, static_tracks};
use crate::network::OUTLIER_SIGMAS;
use crate::problem::{Problem, Role};
use crate::rules::rules;
use crate::stats::quantile::{upper_median, value_at_share};
use nalgebra::Vector2;

rules! {
    /// Gross errors of image points, tracks and frames.
    pub struct GrossErrorRules {
        /// Fewest that are judged together.
        least_together: usize = 4, "image points";
        /// A track or frame of which more is gross is rejected, however its gross errors came.
        rejected_above_share: f64 = 0.9, "share of image points";
        /// Gross residuals of one cause differ by less from one to the next; those that come alone by 1.4.
        one_cause_change: f64 = 0.5, "share of their length";
        /// An image point that keeps less is down-weighted.
        full_weight: f64 = 0.5, "weight";
        /// The first estimate contradicts a track that fits so many times worse than a good one ...
        suspect_factor: f64 = 4.0, "factor";
        /// ... that is, than these do ...
        good_tracks_share: f64 = 0.25, "share of tracks";
        /// ... in these.
        good_points_share: f64 = 0.4, "share of frames";
        /// Where no more is left of a vehicle, it is the estimate that is wrong.
        least_left_share: f64 = 0.15, "share of image points";
        /// Fewest by which the first estimate is held against a track.
        least_track: usize = 8, "image points";
    }
}

const RULES: GrossErrorRules = GrossErrorRules::DEFAULT;

impl Excluded {
    /// What the first estimate contradicts: tracks that stay behind on the ground while others drive on, and
    /// tracks that fit much worse than others do. Starting poses may be far off, but they are off for all
    /// points of a frame.
    pub fn suspected(problem: &Problem, start: &Estimate) -> Excluded {
        let mut excluded = Excluded::nothing(problem);
        let sets = sets(problem, start);
        let is_left = static_tracks(problem, &start.camera_poses);
        let judge = judge_of(problem, start, 1.0);
        for (at, (vehicle, is_left)) in problem.vehicles.iter().zip(&is_left).enumerate() {
            let stands = suspected_static(&judge, at, &sets[at].tracks(), &sets[at].whitened());
            for (o, reason) in vehicle.observations.iter().zip(&mut excluded.vehicles[at]) {
                *reason = stands[o.point].or(is_left[o.point].then_some(RejectionReason::Static));
            }
        }
        for (set, reasons) in sets.iter().zip(excluded.sets_mut()) {
            let mut scores = Vec::new();
            for track in
                set.tracks().into_iter().filter(|track| track.iter().all(|at| reasons[*at].is_none()))
            {
                let judged = track.iter().map(|at| &set.seen[*at]).filter(|seen| seen.kind == Kind::Point);
                let norms: Vec<f64> =
                    judged.map(|seen| seen.whitened.map_or(f64::INFINITY, |w| w.norm())).collect();
                if norms.len() >= RULES.least_track {
                    scores.push((value_at_share(norms, RULES.good_points_share).unwrap_or(0.0), track));
                }
            }
            let good =
                value_at_share(scores.iter().map(|(score, _)| *score).collect(), RULES.good_tracks_share)
                    .unwrap_or(0.0);
            let limit = RULES.suspect_factor * good.max(OUTLIER_SIGMAS);
            for (_, track) in scores.into_iter().filter(|(score, _)| *score > limit) {
                track.into_iter().for_each(|at| reasons[at] = Some(RejectionReason::Track));
            }
        }
        excluded
    }

    /// The tracks and frames that an estimate contradicts as a whole, and the estimate by which this was
    /// judged: a point whose track was left out, or would now be, is found anew from the poses first. `spread` is
    /// what good image points scatter, in standard deviations.
    pub fn judged_anew(&self, problem: &Problem, estimate: &Estimate, spread: f64) -> (Excluded, Estimate) {
        let limit = OUTLIER_SIGMAS * spread.max(1.0);
        let judge = |estimate: &Estimate| {
            let mut excluded = Excluded::nothing(problem);
            let before = self.vehicles.iter().chain([&self.targets]);
            let sets = sets(problem, estimate);
            let judge = judge_of(problem, estimate, spread);
            for (at, (reasons, before)) in excluded.sets_mut().zip(before).enumerate() {
                let judged = sets[at].judge_named(&judge, at, before).into_iter();
                *reasons =
                    judged.map(|reason| reason.filter(|r| *r != RejectionReason::ImagePoint)).collect();
                let left_in = reasons.iter().filter(|reason| reason.is_none()).count();
                if (left_in as f64) < RULES.least_left_share * reasons.len() as f64 {
                    reasons.clone_from(before);
                }
            }
            excluded
        };
        let mut doubted = judge(estimate);
        for (reasons, before) in doubted.sets_mut().zip(self.vehicles.iter().chain([&self.targets])) {
            reasons.iter_mut().zip(before).for_each(|(reason, before)| *reason = reason.or(*before));
        }
        if doubted.is_empty() {
            return (doubted, estimate.clone());
        }
        let mut anew = doubted.with_points_anew(problem, estimate, limit);
        let judged = judge(&anew);
        for (at, vehicle) in problem.vehicles.iter().enumerate() {
            let mut has_some = vec![false; vehicle.points.len()];
            for (o, reason) in vehicle.observations.iter().zip(&judged.vehicles[at]) {
                has_some[o.point] |= !reason.is_some_and(RejectionReason::is_of_track);
            }
            for point in (0..vehicle.points.len()).filter(|point| !has_some[*point]) {
                // Where few of its rays happen to meet may be anywhere.
                anew.vehicles[at].points[point] = estimate.vehicles[at].points[point];
            }
        }
        (judged, anew)
    }

    /// The estimate with all points anew whose tracks are left out, where more of their image points fit them
    /// than fit them now.
    fn with_points_anew(&self, problem: &Problem, estimate: &Estimate, limit: f64) -> Estimate {
        let mut anew = estimate.clone();
        for (at, vehicle) in problem.vehicles.iter().enumerate() {
            let mut is_out = vec![false; vehicle.points.len()];
            for (o, reason) in vehicle.observations.iter().zip(&self.vehicles[at]) {
                is_out[o.point] |= reason.is_some_and(RejectionReason::is_of_track);
            }
            // A point that has no coordinates gets none: the unknowns stay the same.
            let has = |point: &usize| estimate.vehicles[at].points[*point].is_some();
            for point in (0..vehicle.points.len()).filter(|point| is_out[*point]).filter(has) {
                if let Some(found) = point_anew(problem, estimate, at, point, limit) {
                    anew.vehicles[at].points[point] = Some(found);
                }
            }
        }
        let fitting = |of: &Estimate| -> Vec<Vec<usize>> {
            let count = |set: &Set| {
                let fits = |track: &Vec<usize>| track.iter().filter(|at| set.fits(**at, limit)).count();
                set.tracks().iter().map(fits).collect()
            };
            sets(problem, of).iter().map(count).collect()
        };
        let (now, then) = (fitting(estimate), fitting(&anew));
        for (at, vehicle) in estimate.vehicles.iter().enumerate() {
            for (point, before) in vehicle.points.iter().enumerate() {
                if then[at][point] <= now[at][point] {
                    anew.vehicles[at].points[point] = *before;
                }
            }
        }
        anew
    }

    fn sets_mut(&mut self) -> impl Iterator<Item = &mut Vec<Option<RejectionReason>>> {
        self.vehicles.iter_mut().chain([&mut self.targets])
    }
}

/// The verdicts on the image points of an estimate, from how those of vehicles and of targets fit. `excluded` took
/// no part.
pub fn verdicts(
    problem: &Problem,
    estimate: &Estimate,
    (of_vehicles, of_targets): (&[Vec<Option<ObservationFit>>], &[Option<ObservationFit>]),
    excluded: &Excluded,
    limit: f64,
) -> Verdicts {
    let mut verdicts = Vec::new();
    let all_fits = of_vehicles.iter().map(Vec::as_slice).chain([of_targets]);
    let all_out = excluded.vehicles.iter().chain([&excluded.targets]);
    let residual_px = |fit: &Option<ObservationFit>| fit.map(|fit| fit.residual_px);
    let sets = sets_of(
        problem,
        estimate,
        |vehicle, at| residual_px(&of_vehicles[vehicle][at]),
        |at| residual_px(&of_targets[at]),
    );
    let judge = judge_of(problem, estimate, limit / OUTLIER_SIGMAS);
    for (at, ((set, fits), out)) in sets.iter().zip(all_fits).zip(all_out).enumerate() {
        let judged = set.verdicts(&judge, at);
        let one = |at: usize| match (out[at], set.seen[at].kind, &fits[at]) {
            (_, Kind::Check, _) => ImagePointVerdict::Rejected(RejectionReason::CheckPoint),
            (Some(reason), ..) => ImagePointVerdict::Rejected(reason),
            (None, Kind::WithoutCoordinates, _) => {
                ImagePointVerdict::Rejected(RejectionReason::NoCoordinates)
            }
            (None, Kind::Point, None) => ImagePointVerdict::Rejected(RejectionReason::BehindCamera),
            (None, Kind::Point, Some(fit)) => judged[at].map_or(of_weight(fit), ImagePointVerdict::Rejected),
        };
        verdicts.push((0..set.seen.len()).map(one).collect::<Vec<_>>());
    }
    let targets = verdicts.pop().unwrap_or_default();
    Verdicts { vehicles: verdicts, targets }
}

fn of_weight(fit: &ObservationFit) -> ImagePointVerdict {
    if fit.weight < RULES.full_weight { ImagePointVerdict::DownWeighted } else { ImagePointVerdict::Used }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Point,
    WithoutCoordinates,
    Check,
}

/// An image point and how it fits.
#[derive(Clone, Copy, Debug)]
struct Seen {
    frame: usize,
    point: usize,
    kind: Kind,
    /// Residual in standard deviations, where it has one that counts.
    whitened: Option<Vector2<f64>>,
}

/// The image points that are judged together: those of a vehicle, or of all targets.
struct Set {
    seen: Vec<Seen>,
    points: usize,
    frames: usize,
}

/// The sets of an estimate's own image points.
fn sets(problem: &Problem, estimate: &Estimate) -> Vec<Set> {
    let imaging = Imaging::new(problem, estimate);
    let of_vehicle = |vehicle: usize, at: usize| {
        let o = &problem.vehicles[vehicle].observations[at];
        Some(o.image_px - imaging.vehicle_px(vehicle, o.frame, o.point)?)
    };
    let of_target = |at: usize| {
        let o = &problem.target_observations[at];
        Some(o.image_px - imaging.target_px(o.frame, &estimate.targets[o.target]?)?)
    };
    sets_of(problem, estimate, of_vehicle, of_target)
}

/// One for each vehicle, then that of the targets, of these residuals \[px\]: by vehicle and image point, and of
/// targets.
fn sets_of(
    problem: &Problem,
    estimate: &Estimate,
    of_vehicle: impl Fn(usize, usize) -> Option<Vector2<f64>>,
    of_target: impl Fn(usize) -> Option<Vector2<f64>>,
) -> Vec<Set> {
    let frames = problem.frames.len();
    let mut sets = Vec::new();
    for (vehicle_at, vehicle) in problem.vehicles.iter().enumerate() {
        let found = &estimate.vehicles[vehicle_at];
        let seen = vehicle.observations.iter().enumerate().map(|(at, o)| {
            let is_there = found.left_out.is_none() && found.points[o.point].is_some();
            let residual_px = is_there.then(|| of_vehicle(vehicle_at, at)).flatten();
            Seen {
                frame: o.frame,
                point: o.point,
                kind: if is_there { Kind::Point } else { Kind::WithoutCoordinates },
                whitened: residual_px.map(|residual_px| residual_px / o.sigma_px),
            }
        });
        sets.push(Set { seen: seen.collect(), points: vehicle.points.len(), frames });
    }
    let seen = problem.target_observations.iter().enumerate().map(|(at, o)| {
        let kind = match (problem.targets[o.target].role, estimate.targets[o.target]) {
            (Role::Check, _) => Kind::Check,
            (Role::Control, None) => Kind::WithoutCoordinates,
            (Role::Control, Some(_)) => Kind::Point,
        };
        let residual_px = (kind == Kind::Point).then(|| of_target(at)).flatten();
        Seen {
            frame: o.frame,
            point: o.target,
            kind,
            whitened: residual_px.map(|residual_px| residual_px / o.sigma_px),
        }
    });
    sets.push(Set { seen: seen.collect(), points: problem.targets.len(), frames });
    sets
}

/// What tracks are held against; `spread` is what good image points of vehicles scatter.
fn judge_of<'a>(problem: &'a Problem, estimate: &'a Estimate, spread: f64) -> Judge<'a> {
    let static_scatter = static_scatter(problem, &estimate.camera_poses, &estimate.targets);
    let limit = OUTLIER_SIGMAS * spread.max(1.0);
    Judge { problem, estimate, limit, spread, static_scatter }
}

impl Set {
    /// Residuals in standard deviations.
    fn whitened(&self) -> Vec<Option<Vector2<f64>>> {
        self.seen.iter().map(|seen| seen.whitened).collect()
    }

    /// The verdicts by these residuals, each track that is of something else by what it is of. `before` was left out.
    fn judge_named(
        &self,
        judge: &Judge<'_>,
        at: usize,
        before: &[Option<RejectionReason>],
    ) -> Vec<Option<RejectionReason>> {
        if at >= judge.problem.vehicles.len() {
            return self.judge(judge.limit, &vec![None; self.points]);
        }
        let (tracks, whitened) = (self.tracks_with_coordinates(), self.whitened());
        let was_out = |at: &usize| before[*at].is_some_and(RejectionReason::is_of_track);
        let as_what = |track: &Vec<usize>| before[*track.first()?].filter(|_| track.iter().all(was_out));
        let left_out: Vec<_> = tracks.iter().map(as_what).collect();
        let mut wrong = against_the_body(judge, at, &tracks, &whitened, &left_out);
        let is_doubtful = |point: usize| match wrong[point] {
            None => {
                let gross = tracks[point].iter().filter(|at| !self.fits(**at, judge.limit)).count();
                gross >= RULES.least_together
            }
            Some(reason) => reason == RejectionReason::Sliding,
        };
        let parts: Vec<_> = tracks
            .iter()
            .enumerate()
            .map(|(point, track)| is_doubtful(point).then(|| swapped_part(judge, at, track)).flatten())
            .collect();
        wrong.iter_mut().zip(&parts).filter(|(_, part)| part.is_some()).for_each(|(wrong, _)| *wrong = None);
        let mut reasons = self.judge(judge.limit, &wrong);
        for (track, part) in tracks.iter().zip(&parts) {
            let Some(part) = part else { continue };
            for (place, at) in track.iter().enumerate() {
                let is_own = reasons[*at].is_some_and(RejectionReason::is_of_track);
                if part.contains(&place) {
                    reasons[*at] = Some(RejectionReason::Swapped);
                } else if is_own {
                    reasons[*at] = None;
                }
            }
        }
        self.name_tracks(judge, at, &mut reasons);
        reasons
    }

    /// The verdicts at the end: what is not left out by now is judged by its image points alone.
    fn verdicts(&self, judge: &Judge<'_>, at: usize) -> Vec<Option<RejectionReason>> {
        let mut reasons = self.judge(judge.limit, &vec![None; self.points]);
        if at >= judge.problem.vehicles.len() {
            return reasons;
        }
        self.name_tracks(judge, at, &mut reasons);
        for track in self.tracks_with_coordinates() {
            let alone = track.iter().filter(|at| reasons[**at] == Some(RejectionReason::ImagePoint)).count();
            if alone < RULES.least_together {
                continue;
            }
            for place in swapped_part(judge, at, &track).into_iter().flatten() {
                let reason = &mut reasons[track[place]];
                *reason = reason.map(|_| RejectionReason::Swapped);
            }
        }
        reasons
    }

    /// Says of what the tracks are that are gross as a whole.
    fn name_tracks(&self, judge: &Judge<'_>, at: usize, reasons: &mut [Option<RejectionReason>]) {
        let whitened = self.whitened();
        for (point, track) in self.tracks_with_coordinates().iter().enumerate() {
            if track.first().is_some_and(|first| reasons[*first] == Some(RejectionReason::Track)) {
                let kind = kind_of(judge, at, point, track, &whitened);
                track.iter().for_each(|at| reasons[*at] = Some(kind));
            }
        }
    }

    /// The same as [`Set::tracks`], those of points without coordinates empty.
    fn tracks_with_coordinates(&self) -> Vec<Vec<usize>> {
        let mut tracks = self.tracks();
        tracks.iter_mut().for_each(|track| track.retain(|at| self.seen[*at].kind == Kind::Point));
        tracks
    }

    /// Indices of the image points of each point, in order of time.
    fn tracks(&self) -> Vec<Vec<usize>> {
        let mut tracks = vec![Vec::new(); self.points];
        self.seen.iter().enumerate().for_each(|(at, seen)| tracks[seen.point].push(at));
        tracks
    }

    fn fits(&self, at: usize, limit: f64) -> bool {
        self.seen[at].whitened.is_some_and(|residual| residual.norm() <= limit)
    }

    /// The verdicts by image points, beside what is known of tracks by their points.
    fn judge(&self, limit: f64, wrong: &[Option<RejectionReason>]) -> Vec<Option<RejectionReason>> {
        let mut reasons = vec![None; self.seen.len()];
        for (track, wrong) in self.tracks().into_iter().zip(wrong) {
            let gross = || self.is_gross_as_a_whole(&track, limit).then_some(RejectionReason::Track);
            if let Some(reason) = wrong.or_else(gross) {
                track.into_iter().for_each(|at| reasons[at] = Some(reason));
            }
        }
        let mut frames = vec![Vec::new(); self.frames];
        for (at, seen) in self.seen.iter().enumerate().filter(|(at, _)| reasons[*at].is_none()) {
            frames[seen.frame].push(at);
        }
        for frame in frames {
            if self.is_gross_as_a_whole(&frame, limit) {
                frame.into_iter().for_each(|at| reasons[at] = Some(RejectionReason::Frame));
            }
        }
        for (reason, seen) in reasons.iter_mut().zip(&self.seen) {
            if reason.is_none() && seen.whitened.is_some_and(|w| w.norm() > limit) {
                *reason = Some(RejectionReason::ImagePoint);
            }
        }
        reasons
    }

    fn is_gross_as_a_whole(&self, members: &[usize], limit: f64) -> bool {
        let judged: Vec<&Seen> =
            members.iter().map(|at| &self.seen[*at]).filter(|seen| seen.kind == Kind::Point).collect();
        let gross: Vec<Vector2<f64>> =
            judged.iter().filter_map(|seen| seen.whitened).filter(|r| r.norm() > limit).collect();
        // What lies behind the camera has no residual; it is as gross as can be.
        let behind = judged.iter().filter(|seen| seen.whitened.is_none()).count();
        let share = (gross.len() + behind) as f64 / judged.len().max(1) as f64;
        if judged.len() < RULES.least_together || share <= 0.5 {
            return false;
        }
        share > RULES.rejected_above_share || behind > gross.len() || {
            let length = upper_median(gross.iter().map(|r| r.norm()).collect());
            let change = upper_median(gross.windows(2).map(|two| (two[1] - two[0]).norm()).collect());
            change.unwrap_or(0.0) < RULES.one_cause_change * length.unwrap_or(0.0)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMIT: f64 = 5.12;
    const NONE: [Option<RejectionReason>; 5] = [None; 5];

    /// Image points of five points in 40 frames; `residual` by frame and point.
    fn set(residual: impl Fn(usize, usize) -> Option<f64>) -> Set {
        let one = |at: usize| {
            let (frame, point) = (at / 5, at % 5);
            // Directions turn slowly along a track, and are those of random errors otherwise.
            let angle = if point == 0 { 0.05 * frame as f64 } else { 7.3 * (frame * frame + point) as f64 };
            let direction = Vector2::new(angle.cos(), angle.sin());
            Seen { frame, point, kind: Kind::Point, whitened: residual(frame, point).map(|r| direction * r) }
        };
        Set { seen: (0..200).map(one).collect(), points: 5, frames: 40 }
    }

    fn count(reasons: &[Option<RejectionReason>], reason: RejectionReason) -> usize {
        reasons.iter().filter(|found| **found == Some(reason)).count()
    }

    #[test]
    fn of_a_track_that_goes_its_own_way_what_fits_by_chance_is_rejected_too() {
        let crossing = set(|frame, point| {
            let off = 0.8 * (frame as f64 - 15.0).abs();
            Some(if point == 0 { off } else { 1.0 })
        });
        let fitting = (0..40).filter(|frame| crossing.fits(5 * frame, LIMIT)).count();
        let reasons = crossing.judge(LIMIT, &NONE);
        assert!(fitting > 0 && count(&reasons, RejectionReason::Track) == 40, "{fitting}");
        assert_eq!(reasons.iter().flatten().count(), 40);
    }

    #[test]
    fn errors_that_come_alone_are_rejected_alone_even_where_they_are_most_of_a_track() {
        let scattered = set(|frame, point| Some(if point == 2 && frame % 5 > 1 { 90.0 } else { 1.0 }));
        let reasons = scattered.judge(LIMIT, &NONE);
        assert_eq!(
            [count(&reasons, RejectionReason::Track), count(&reasons, RejectionReason::ImagePoint)],
            [0, 24]
        );
        let all = set(|frame, point| Some(if point == 2 && frame > 0 { 90.0 } else { 1.0 }));
        assert_eq!(count(&all.judge(LIMIT, &NONE), RejectionReason::Track), 40);
    }

    #[test]
    fn a_frame_is_judged_by_what_wrong_tracks_leave_of_it() {
        let set = set(|frame, point| Some(if point < 1 || frame == 7 { 60.0 } else { 1.0 }));
        let reasons = set.judge(LIMIT, &NONE);
        assert_eq!(
            [count(&reasons, RejectionReason::Track), count(&reasons, RejectionReason::Frame)],
            [40, 4]
        );
    }

    #[test]
    fn what_lies_behind_the_camera_is_gross_as_can_be() {
        let set = set(|_, point| if point == 3 { None } else { Some(1.0) });
        assert_eq!(count(&set.judge(LIMIT, &NONE), RejectionReason::Track), 40);
    }
}
