//! From feet on the ground to one plane pose a frame, whatever share of them is gross.
//!
//! The pattern of a body, one plane position `m` a point, is built along time: each frame is placed by
//! the plane motion `x + R(psi) m` that most of its feet agree with (from the motion before it, or
//! from pairs of feet as in RANSAC, then by re-weighted least squares), and its feet are taken into the
//! pattern. A position in the pattern is the median of the latest sightings, and points that disagreed
//! with the motion count less, so that what stands still or wanders while most points move along
//! loses its say. Where a frame shares too few points with the pattern a new one begins; patterns that
//! turn out to share points are joined.

use super::forward::Foot;
use crate::rules::rules;
use crate::stats::quantile::upper_median;
use nalgebra::{Rotation2, Vector2};

/// A plane pose: position of the pattern's origin \[m\] and its heading \[rad\].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlanePose {
    /// Position in the world.
    pub place_m: Vector2<f64>,
    /// Counter-clockwise from the world's x axis, not confined to one turn.
    pub heading_rad: f64,
}

impl PlanePose {
    /// A point of the pattern in the world.
    pub fn place(&self, pattern_m: &Vector2<f64>) -> Vector2<f64> {
        self.place_m + Rotation2::new(self.heading_rad) * pattern_m
    }

    /// A point of the world in the pattern.
    pub fn pattern(&self, place_m: &Vector2<f64>) -> Vector2<f64> {
        Rotation2::new(-self.heading_rad) * (place_m - self.place_m)
    }

    /// This pose after `inner`: `world_from_b = world_from_a * a_from_b`.
    pub fn after(&self, inner: &PlanePose) -> PlanePose {
        PlanePose { place_m: self.place(&inner.place_m), heading_rad: self.heading_rad + inner.heading_rad }
    }

    /// The inverse motion.
    pub fn inverse(&self) -> PlanePose {
        PlanePose { place_m: self.pattern(&Vector2::zeros()), heading_rad: -self.heading_rad }
    }
}

/// Plane poses and patterns of one body.
#[derive(Clone, Debug)]
pub struct Chain {
    /// Pose of each frame; `None` where it could not be placed.
    pub poses: Vec<Option<PlanePose>>,
    /// The part of the motion that each frame belongs to. Poses of different parts refer to different
    /// origins and axes of the body.
    pub part: Vec<usize>,
    /// Position of each point in the pattern of each part \[m\].
    pub patterns: Vec<Vec<Option<Vector2<f64>>>>,
}

rules! {
    /// Motion of a rigid pattern of feet in the plane.
    pub struct PlaneMotionRules {
        /// The position of a point in the pattern is the median of so many of the latest.
        recent_sightings: usize = 45, "sightings";
        /// Pairs of feet that are tried for a frame.
        most_pairs: usize = 150, "pairs";
        /// A frame is placed if so much agrees.
        placed_share: f64 = 0.25, "share of what is shared with the pattern";
        /// If so much agrees with the motion before, no pair is tried.
        predicted_share: f64 = 0.85, "share of what is shared with the pattern";
        /// Frames in a row that do not fit the pattern before another is begun.
        most_failures: usize = 12, "frames";
        /// Feet nearer to each other give no direction.
        least_base_m: f64 = 0.3, "m";
        /// How far a frame with two shared points may turn from the motion before it.
        most_turn_of_two_rad: f64 = 0.5, "rad";
    }
}

const RULES: PlaneMotionRules = PlaneMotionRules::DEFAULT;

/// One pair of a foot and its position in the pattern.
#[derive(Clone, Copy, Debug)]
struct Pair {
    place_m: Vector2<f64>,
    pattern_m: Vector2<f64>,
    /// What it counts.
    weight: f64,
    /// How far it may be off \[m\].
    tolerance_m: f64,
}

#[derive(Clone, Debug, Default)]
struct Member {
    recent: Vec<Vector2<f64>>,
    next: usize,
    median_m: Vector2<f64>,
    agreed: f64,
    seen: f64,
}

impl Member {
    fn take(&mut self, pattern_m: Vector2<f64>, agrees: Option<bool>) {
        if self.recent.len() < RULES.recent_sightings {
            self.recent.push(pattern_m);
        } else {
            self.recent[self.next % RULES.recent_sightings] = pattern_m;
            self.next += 1;
        }
        let median = |axis: usize| upper_median(self.recent.iter().map(|p| p[axis]).collect()).unwrap_or(0.0);
        self.median_m = Vector2::new(median(0), median(1));
        if let Some(agrees) = agrees {
            self.seen += 1.0;
            self.agreed += f64::from(u8::from(agrees));
        }
    }

    fn weight(&self) -> f64 {
        ((self.agreed + 1.0) / (self.seen + 2.0)).powi(2)
    }
}

/// Chains the frames of a body. `feet` are sorted by frame; `slack_m` is how far feet may be off
/// besides their standard deviation, because heights are not known.
pub fn chain(feet: &[Foot], frames: usize, points: usize, slack_m: f64) -> Chain {
    let mut found = Chain { poses: vec![None; frames], part: vec![0; frames], patterns: Vec::new() };
    let mut parts: Vec<Vec<Member>> = Vec::new();
    let (mut before, mut failures): (Vec<(usize, PlanePose)>, usize) = (Vec::new(), 0);
    for feet in feet.chunk_by(|a, b| a.frame == b.frame) {
        let frame = feet[0].frame;
        let mut fit = parts.last().and_then(|members| {
            let (pairs, _) = pairs(feet, members, slack_m);
            fit_frame(&pairs, predict(&before, frame), frame as u64)
        });
        if fit.is_none() {
            failures += 1;
            let is_young = before.len() < 2;
            let shared = parts.last().map_or(0, |members| pairs(feet, members, slack_m).0.len());
            if feet.len() >= 2
                && (parts.is_empty() || is_young || shared < 2 || failures > RULES.most_failures)
            {
                if is_young && !parts.is_empty() && shared >= 2 {
                    // The frame that it began with may have been the bad one.
                    parts.pop();
                    before.iter().for_each(|(frame, _)| found.poses[*frame] = None);
                }
                parts.push(vec![Member::default(); points]);
                before.clear();
                let middle = feet.iter().map(|f| f.place_m).sum::<Vector2<f64>>() / feet.len() as f64;
                fit = Some(PlanePose { place_m: middle, heading_rad: 0.0 });
            }
        }
        let Some(fit) = fit else { continue };
        failures = 0;
        let part = parts.len() - 1;
        for foot in feet {
            let member = &mut parts[part][foot.point];
            let pattern_m = fit.pattern(&foot.place_m);
            let is_new = member.recent.is_empty();
            let off_m = (pattern_m - member.median_m).norm();
            member.take(pattern_m, (!is_new).then_some(off_m < tolerance_m(foot, slack_m)));
        }
        found.poses[frame] = Some(fit);
        found.part[frame] = part;
        before.push((frame, fit));
    }
    let mut by_size: Vec<(usize, usize)> =
        (0..parts.len()).map(|part| (found.frames_of(part), part)).collect();
    by_size.sort_by_key(|(size, part)| (std::cmp::Reverse(*size), *part));
    for (_, part) in by_size {
        go_back(&mut found, feet, part, &mut parts[part], slack_m);
    }
    found.patterns = parts
        .iter()
        .map(|members| members.iter().map(|m| (!m.recent.is_empty()).then_some(m.median_m)).collect())
        .collect();
    join_parts(&mut found, &parts, slack_m);
    found
}

impl Chain {
    fn frames_of(&self, part: usize) -> usize {
        self.poses.iter().zip(&self.part).filter(|(pose, p)| pose.is_some() && **p == part).count()
    }
}

/// Chains a part backwards in time, over frames in which there was no pattern yet, or one of a smaller
/// part: a pattern that began among gross errors is known by its end.
fn go_back(found: &mut Chain, feet: &[Foot], part: usize, members: &mut [Member], slack_m: f64) {
    let own = found.frames_of(part);
    let smaller: Vec<bool> = (0..=found.part.iter().copied().max().unwrap_or(0))
        .map(|p| p != part && found.frames_of(p) < own)
        .collect();
    let (mut before, mut failures): (Vec<(usize, PlanePose)>, usize) = (Vec::new(), 0);
    members.iter_mut().for_each(|member| member.recent.clear());
    for feet in feet.chunk_by(|a, b| a.frame == b.frame).rev() {
        let frame = feet[0].frame;
        let pose = match found.poses[frame] {
            Some(pose) if found.part[frame] == part => {
                let pairs = pairs(feet, members, slack_m).0;
                let again = fit_frame(&pairs, predict(&before, frame).or(Some(pose)), frame as u64);
                Some(again.filter(|again| score(&pairs, again) > score(&pairs, &pose)).unwrap_or(pose))
            }
            Some(_) if !smaller[found.part[frame]] => None,
            _ if before.is_empty() || failures > 3 * RULES.most_failures => None,
            _ => {
                let pairs = pairs(feet, members, slack_m).0;
                let fit = fit_frame(&pairs, predict(&before, frame), frame as u64);
                fit.filter(|fit| pairs.iter().filter(|p| off_m(p, fit) < p.tolerance_m).count() >= 3)
            }
        };
        let Some(pose) = pose else {
            failures += 1;
            continue;
        };
        failures = 0;
        for foot in feet {
            members[foot.point].take(pose.pattern(&foot.place_m), None);
        }
        found.poses[frame] = Some(pose);
        found.part[frame] = part;
        before.push((frame, pose));
    }
}

fn tolerance_m(foot: &Foot, slack_m: f64) -> f64 {
    4.5 * foot.sigma_m + slack_m
}

fn pairs(feet: &[Foot], members: &[Member], slack_m: f64) -> (Vec<Pair>, Vec<usize>) {
    let shared = feet.iter().enumerate().filter(|(_, foot)| !members[foot.point].recent.is_empty());
    shared
        .map(|(at, foot)| {
            let member = &members[foot.point];
            let pair = Pair {
                place_m: foot.place_m,
                pattern_m: member.median_m,
                weight: member.weight(),
                tolerance_m: tolerance_m(foot, slack_m),
            };
            (pair, at)
        })
        .unzip()
}

/// Where the motion of the frames before leads.
fn predict(before: &[(usize, PlanePose)], frame: usize) -> Option<PlanePose> {
    let (last_frame, last) = *before.last()?;
    let (old_frame, old) = before[before.len().saturating_sub(6)];
    if old_frame == last_frame {
        return Some(last);
    }
    let share = frame.abs_diff(last_frame) as f64 / last_frame.abs_diff(old_frame) as f64;
    let share = share.min(1.0);
    Some(PlanePose {
        place_m: last.place_m + share * (last.place_m - old.place_m),
        heading_rad: last.heading_rad + share * (last.heading_rad - old.heading_rad),
    })
}

/// The plane motion that most pairs agree with, with the heading nearest to that of `predicted`.
fn fit_frame(pairs: &[Pair], predicted: Option<PlanePose>, seed: u64) -> Option<PlanePose> {
    if pairs.len() < 2 {
        return None;
    }
    let total: f64 = pairs.iter().map(|p| p.weight).sum();
    let mut best: Option<(f64, PlanePose)> = None;
    let mut consider = |pose: PlanePose| {
        let score = score(pairs, &pose);
        if best.is_none_or(|(most, _)| score > most) {
            best = Some((score, pose));
        }
        score
    };
    let mut is_good = false;
    if let Some(predicted) = predicted {
        let polished = polish(pairs, predicted);
        is_good = consider(polished) > RULES.predicted_share * total;
    }
    if !is_good {
        let mut random = SplitMix(seed);
        for _ in 0..RULES.most_pairs {
            let (i, j) = (random.below(pairs.len()), random.below(pairs.len()));
            if let Some(pose) = from_two(&pairs[i], &pairs[j]) {
                consider(pose);
            }
        }
    }
    let (_, pose) = best?;
    let mut pose = polish(pairs, pose);
    let agreeing = pairs.iter().filter(|p| off_m(p, &pose) < p.tolerance_m).count();
    if let Some(predicted) = predicted {
        let turns = ((predicted.heading_rad - pose.heading_rad) / std::f64::consts::TAU).round();
        pose.heading_rad += turns * std::f64::consts::TAU;
        if agreeing == 2 && (pose.heading_rad - predicted.heading_rad).abs() > RULES.most_turn_of_two_rad {
            return None;
        }
    }
    let wanted = (RULES.placed_share * pairs.len() as f64).ceil().max(2.0) as usize;
    (agreeing >= wanted).then_some(pose)
}

fn off_m(pair: &Pair, pose: &PlanePose) -> f64 {
    (pose.place(&pair.pattern_m) - pair.place_m).norm()
}

fn score(pairs: &[Pair], pose: &PlanePose) -> f64 {
    pairs.iter().map(|p| p.weight * (1.0 - (off_m(p, pose) / p.tolerance_m).powi(2)).max(0.0).sqrt()).sum()
}

fn from_two(a: &Pair, b: &Pair) -> Option<PlanePose> {
    let (from, to) = (b.pattern_m - a.pattern_m, b.place_m - a.place_m);
    if from.norm() < RULES.least_base_m || (from.norm() - to.norm()).abs() > a.tolerance_m + b.tolerance_m {
        return None;
    }
    let heading_rad = from.perp(&to).atan2(from.dot(&to));
    let middle = (a.pattern_m + b.pattern_m) / 2.0;
    let place_m = (a.place_m + b.place_m) / 2.0 - Rotation2::new(heading_rad) * middle;
    Some(PlanePose { place_m, heading_rad })
}

/// Re-weighted least squares from `pose` on: what is farther off than the tolerance counts nothing, in
/// the first step twice as far.
fn polish(pairs: &[Pair], mut pose: PlanePose) -> PlanePose {
    for step in 0..6 {
        let reach = if step == 0 { 2.0 } else { 1.0 };
        let weights: Vec<f64> = pairs
            .iter()
            .map(|p| p.weight * (1.0 - (off_m(p, &pose) / (reach * p.tolerance_m)).powi(2)).max(0.0).powi(2))
            .collect();
        match weighted_fit(pairs, &weights) {
            Some(next) => pose = next,
            None => break,
        }
    }
    pose
}

fn weighted_fit(pairs: &[Pair], weights: &[f64]) -> Option<PlanePose> {
    let total: f64 = weights.iter().sum();
    if weights.iter().filter(|w| **w > 0.0).count() < 2 || total <= 0.0 {
        return None;
    }
    let mean = |of: fn(&Pair) -> Vector2<f64>| {
        pairs.iter().zip(weights).map(|(p, w)| *w * of(p)).sum::<Vector2<f64>>() / total
    };
    let (pattern, place) = (mean(|p| p.pattern_m), mean(|p| p.place_m));
    let (mut sine, mut cosine) = (0.0, 0.0);
    for (pair, weight) in pairs.iter().zip(weights) {
        let (from, to) = (pair.pattern_m - pattern, pair.place_m - place);
        sine += weight * from.perp(&to);
        cosine += weight * from.dot(&to);
    }
    if sine.hypot(cosine) == 0.0 {
        return None;
    }
    let heading_rad = sine.atan2(cosine);
    Some(PlanePose { place_m: place - Rotation2::new(heading_rad) * pattern, heading_rad })
}

/// Joins parts that share points: the later one is moved into the pattern of the earlier.
fn join_parts(found: &mut Chain, parts: &[Vec<Member>], slack_m: f64) {
    for later in 1..parts.len() {
        for earlier in 0..later {
            if !found.part.iter().zip(&found.poses).any(|(p, pose)| *p == earlier && pose.is_some()) {
                continue;
            }
            let shared = found.patterns[earlier].iter().zip(&found.patterns[later]).enumerate();
            let pairs: Vec<Pair> = shared
                .filter_map(|(point, (to, from))| {
                    let weight = parts[later][point].weight() * parts[earlier][point].weight();
                    let tolerance_m = 0.1 + slack_m;
                    Some(Pair { place_m: (*to)?, pattern_m: (*from)?, weight, tolerance_m })
                })
                .collect();
            if pairs.len() < 3 {
                continue;
            }
            let Some(motion) = fit_frame(&pairs, None, later as u64) else { continue };
            let agreeing = pairs.iter().filter(|p| off_m(p, &motion) < p.tolerance_m).count();
            if agreeing < 3 || 2 * agreeing < pairs.len() {
                continue;
            }
            let inverse = motion.inverse();
            for frame in 0..found.poses.len() {
                if found.part[frame] == later
                    && let Some(pose) = &mut found.poses[frame]
                {
                    *pose = pose.after(&inverse);
                    found.part[frame] = earlier;
                }
            }
            for point in 0..found.patterns[later].len() {
                if let (Some(from), None) =
                    (found.patterns[later][point].take(), found.patterns[earlier][point])
                {
                    found.patterns[earlier][point] = Some(motion.place(&from));
                }
            }
            break;
        }
    }
}

/// A small generator of fixed sequences: Steele et al., *Fast splittable pseudorandom number
/// generators*, OOPSLA 2014.
struct SplitMix(u64);

impl SplitMix {
    fn below(&mut self, limit: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) % limit as u64) as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose(x: f64, y: f64, heading_rad: f64) -> PlanePose {
        PlanePose { place_m: Vector2::new(x, y), heading_rad }
    }

    /// Feet of twelve points of a body that drives a bend; some never move along.
    fn drive(frames: usize, stay: usize) -> (Vec<Foot>, Vec<PlanePose>) {
        let poses: Vec<PlanePose> = (0..frames)
            .map(|f| pose(0.3 * f as f64, 0.002 * (f * f) as f64, 0.01 * f as f64 - 4.0))
            .collect();
        let mut feet = Vec::new();
        for frame in 0..frames {
            for point in 0..12 {
                let angle = 2.4 * point as f64;
                let at = Vector2::new(2.0 * angle.cos(), angle.sin());
                let noise =
                    Vector2::new((7.0 * (frame * 12 + point) as f64).sin(), (angle + frame as f64).cos());
                let from = if point < stay { &poses[0] } else { &poses[frame] };
                let place_m = from.place(&at) + 0.01 * noise;
                let by_height = Vector2::zeros();
                feet.push(Foot { frame, point, place_m, by_height, sigma_m: 0.02, clearance_m: 60.0 });
            }
        }
        (feet, poses)
    }

    /// Largest turn between frames that is wrong \[rad\].
    fn worst_turn(found: &Chain, truth: &[PlanePose]) -> f64 {
        let first = found.poses[0].unwrap().heading_rad - truth[0].heading_rad;
        let off = |(found, truth): (&Option<PlanePose>, &PlanePose)| {
            (found.unwrap().heading_rad - truth.heading_rad - first).abs()
        };
        found.poses.iter().zip(truth).map(off).fold(0.0, f64::max)
    }

    #[test]
    fn a_pose_and_its_inverse_undo_each_other() {
        let (a, b) = (pose(3.0, -1.0, 0.7), pose(-0.4, 2.0, 2.9));
        let back = a.inverse().after(&a.after(&b));
        assert!(
            (back.place_m - b.place_m).norm() < 1e-12 && (back.heading_rad - b.heading_rad).abs() < 1e-12
        );
        let at = Vector2::new(0.3, 0.8);
        assert!((a.after(&b).place(&at) - a.place(&b.place(&at))).norm() < 1e-12);
        assert!((a.pattern(&a.place(&at)) - at).norm() < 1e-12);
    }

    #[test]
    fn the_larger_set_that_moves_together_wins() {
        for stay in [0, 5] {
            let (feet, truth) = drive(120, stay);
            let found = chain(&feet, 120, 12, 0.02);
            assert!(worst_turn(&found, &truth) < 0.03, "{stay}: {}", worst_turn(&found, &truth));
        }
    }

    #[test]
    fn parts_without_common_points_stay_apart_and_others_are_joined() {
        let (feet, truth) = drive(100, 0);
        // Those that both halves see are seen late in the second.
        let visible = |foot: &Foot, both: usize| match foot.frame {
            0..40 => foot.point < 4 + both,
            40..60 => false,
            60..75 => foot.point >= 8,
            _ => foot.point >= 4,
        };
        let run = |both: usize| {
            let feet: Vec<Foot> = feet.iter().filter(|foot| visible(foot, both)).copied().collect();
            chain(&feet, 100, 12, 0.02)
        };
        let apart = run(0);
        assert_ne!(apart.part[39], apart.part[60]);
        assert_eq!(apart.poses[50], None);
        let joined = run(4);
        assert_eq!(joined.part[39], joined.part[60]);
        let turn = joined.poses[60].unwrap().heading_rad - joined.poses[39].unwrap().heading_rad;
        assert!((turn - truth[60].heading_rad + truth[39].heading_rad).abs() < 0.03);
    }

    #[test]
    fn gross_errors_at_the_beginning_do_not_spoil_the_chain() {
        let (mut feet, truth) = drive(80, 0);
        for foot in feet.iter_mut().filter(|foot| foot.frame < 15 && foot.point % 4 != 0) {
            let angle = (foot.frame * 31 + foot.point * 17) as f64;
            foot.place_m += 3.0 * Vector2::new(angle.cos(), (1.7 * angle).sin());
        }
        let found = chain(&feet, 80, 12, 0.02);
        let good = (0..80).filter(|f| found.part[*f] == found.part[79] && found.poses[*f].is_some());
        let offset = found.poses[79].unwrap().heading_rad - truth[79].heading_rad;
        let off =
            |f: &usize| (found.poses[*f].unwrap().heading_rad - truth[*f].heading_rad - offset).abs() < 0.05;
        assert!(good.clone().count() > 75 && good.clone().all(|f| off(&f)), "{}", good.count());
    }
}
