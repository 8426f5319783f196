//! Spatial resection: the exterior orientation of each frame from the control points that it sees.
//!
//! 1. Each frame by itself: a robust search over poses from three points, finished by least squares
//!    ([`frame`]). What is ambiguous, contradicted or poorly determined is left open.
//! 2. Each frame again from between its neighbours; the lower cost stays, so that a frame that fell into
//!    the mirrored solution is healed. Where several poses fit, that which the path of the neighbours
//!    ([`path`]) makes most probable is taken, if no other comes near.
//! 3. Frames that are still open are bridged: they lie on the smooth path between the others.

pub mod frame;
pub mod p3p;
pub mod path;
mod summary;

use crate::camera::Camera;
use crate::geometry::{Pose, interpolate};
use crate::problem::{PoseSigma, Problem, Role};
use crate::rules::{Rules, rules};
use crate::stats::normal::GROSS_SIGMAS;
use frame::{Fit, Frame, Sighting};
use nalgebra::{Matrix6, Vector3, Vector6};
use path::Anchor;
use rayon::prelude::*;
pub use summary::{Quality, warnings};
use trackbundle_solver::loss::robust_spread;
use trackbundle_solver::manifold::pose_minus;

rules! {
    /// Resection of all frames of a video.
    pub struct ResectionRules {
        /// Worst standard deviation of the position and of the attitude beyond which a frame is bridged: its
        /// targets are too poorly spread.
        most_sigma: [f64; 2] = [1.0, std::f64::consts::PI / 180.0], "m, rad";
        /// So many determine a pose so that an error among them shows.
        checked_points: usize = 4, "points";
        /// By so much the best pose must beat the next.
        rival_margin: f64 = 8.0, "half chi squared";
        /// Squared distance from the predicted pose beyond which a pose is not the one that was predicted: a normal
        /// one (6 numbers) gets there once in 10,000.
        predicted_within: f64 = 28.0, "chi squared";
        /// With fewer, chance may have brought four of them together: the pose must be near the path of the
        /// neighbours.
        well_checked_points: usize = 6, "points";
        /// Squared distance from that path of a pose that is none.
        off_path_beyond: f64 = 100.0, "chi squared";
        /// Of so many on either side the worst is dropped first: it spoils the path of the others.
        worst_of_frames_beside: usize = 8, "frames";
        /// Neighbours farther away predict nothing.
        neighbour_within_s: f64 = 2.0, "s";
        /// Points less wide across their best line are said to be on a line.
        line_width_share: f64 = 0.02, "share of the length";
        /// Rounds in which ambiguous frames are decided from the frames that were decided before.
        most_rounds: usize = 8, "rounds";
        /// Sightings of a frame from which its residuals say how much image points scatter.
        spread_least_points: usize = 6, "points";
        /// From this scatter on frames are searched again with it ...
        searched_again_spread: f64 = 1.2, "standard deviations as stated";
        /// ... so often at the most.
        most_spread_rounds: usize = 4, "rounds";
        /// Standard deviations of given poses that come without.
        given_sigma: [f64; 2] = [0.3, 0.009], "m, rad";
    }
}

const RULES: ResectionRules = ResectionRules::DEFAULT;

/// The constants of this stage.
pub fn constants() -> [Rules; 3] {
    [ResectionRules::PAGE, frame::FrameResectionRules::PAGE, path::CameraPathRules::PAGE]
}

/// How the pose of a frame was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Status {
    /// It was given.
    Given,
    /// From control points.
    Resected,
    /// From its neighbours.
    Bridged(BridgeReason),
}

/// Why a frame was not resected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BridgeReason {
    /// Fewer than three control points with three known coordinates are in view.
    TooFew,
    /// They are nearly on one line: the rotation about it is open.
    OnALine,
    /// The pose is not known to [`ResectionRules::most_sigma`].
    PoorlySpread,
    /// Several poses fit, and the neighbours do not tell which is the right one.
    Ambiguous,
    /// Too few of them agree on a pose.
    Contradictory,
}

/// The resection of one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameResection {
    /// `world_from_camera`.
    pub pose: Pose,
    /// Covariance of its perturbation \[m, rad\]; of a given pose as stated.
    pub covariance: Matrix6<f64>,
    /// How it was found.
    pub status: Status,
    /// Control points in view.
    pub seen: usize,
    /// Of these, what took part.
    pub used: usize,
    /// Of these, gross errors.
    pub gross: usize,
    /// Root mean square of the coordinates of what took part \[px\].
    pub rms_px: Option<f64>,
}

/// The resection of a video.
#[derive(Clone, Debug, PartialEq)]
pub struct Resection {
    /// One for each frame.
    pub frames: Vec<FrameResection>,
    /// By what image points scatter more than their standard deviations say, at least 1.
    pub spread: f64,
}

/// No camera pose can be had.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum NotResectable {
    /// No frame sees three control points.
    TooFew {
        /// The most that a frame sees.
        most: usize,
    },
    /// In every frame the control points are on a line.
    OnALine,
    /// In every frame they are poorly spread.
    PoorlySpread,
    /// In every frame several poses fit.
    Ambiguous,
    /// In no frame do enough of them agree.
    Contradictory,
}

/// Resects the frames of a problem that have no pose.
pub fn resect_problem(problem: &Problem) -> Result<Resection, NotResectable> {
    let mut sightings: Vec<Vec<Sighting>> = vec![Vec::new(); problem.frames.len()];
    for o in &problem.target_observations {
        let target = &problem.targets[o.target];
        let (Role::Control, Some(point)) = (target.role, target.surveyed()) else { continue };
        let Some(ray) = problem.camera.ray(&o.image_px) else { continue };
        let sigma_m = Vector3::from(target.known.map(|known| known.map_or(0.0, |known| known.sigma_m)));
        let (image_px, sigma_px) = (o.image_px, o.sigma_px);
        sightings[o.frame].push(Sighting { point, sigma_m, image_px, ray, sigma_px });
    }
    let times_s: Vec<f64> = problem.frames.iter().map(|frame| frame.time_s).collect();
    let covariance = given_covariance(&problem.camera_pose_sigma);
    let given: Vec<_> = problem.camera_poses.iter().map(|pose| pose.map(|pose| (pose, covariance))).collect();
    resect(&problem.camera, &times_s, &sightings, &given)
}

fn given_covariance(sigma: &PoseSigma) -> Matrix6<f64> {
    let components = sigma.components();
    Matrix6::from_diagonal(&Vector6::from_fn(|i, _| {
        components[i].unwrap_or(RULES.given_sigma[i / 3]).powi(2)
    }))
}

/// Resects frames at `times_s` from what each sees of control; frames with a `given` pose (with its
/// covariance) keep it. The result is the same for any number of threads.
pub fn resect(
    camera: &Camera,
    times_s: &[f64],
    sightings: &[Vec<Sighting>],
    given: &[Option<(Pose, Matrix6<f64>)>],
) -> Result<Resection, NotResectable> {
    let search = |spread: f64| -> Vec<Vec<Fit>> {
        (0..times_s.len())
            .into_par_iter()
            .map(|at| match given[at] {
                Some(_) => Vec::new(),
                None => Frame { camera, sightings: &sightings[at], spread }.search(at as u64),
            })
            .collect()
    };
    let mut spread = 1.0;
    let mut fits = search(spread);
    for _ in 0..RULES.most_spread_rounds {
        let factor = spread_of(&fits);
        if factor < RULES.searched_again_spread {
            break;
        }
        spread *= factor;
        fits = search(spread);
    }
    let mut video = Video { camera, times_s, sightings, given, spread, fits, chosen: Vec::new() };
    video.chosen = (0..times_s.len()).map(|at| video.alone(at)).collect();
    video.restart_between_neighbours();
    video.decide_by_neighbours();
    video.drop_outcasts();
    video.decide_by_neighbours();
    video.bridge()
}

/// By what image points scatter more than stated, from the residuals of frames that see many.
fn spread_of(fits: &[Vec<Fit>]) -> f64 {
    let mut squares = Vec::new();
    for fit in fits.iter().filter_map(|fits| fits.first()) {
        let count = fit.norms.len() as f64;
        if fit.norms.len() >= RULES.spread_least_points {
            // Six numbers of the pose take their share of the residuals.
            let freed = 2.0 * count / (2.0 * count - 6.0);
            squares.extend(fit.norms.iter().map(|norm| norm * norm * freed));
        }
    }
    robust_spread(squares)
}

struct Video<'a> {
    camera: &'a Camera,
    times_s: &'a [f64],
    sightings: &'a [Vec<Sighting>],
    given: &'a [Option<(Pose, Matrix6<f64>)>],
    spread: f64,
    /// Poses that fit each frame, the best first.
    fits: Vec<Vec<Fit>>,
    /// The fit of each frame that is decided, or why it is not.
    chosen: Vec<Result<Fit, BridgeReason>>,
}

impl Video<'_> {
    fn frame(&self, at: usize) -> Frame<'_> {
        Frame { camera: self.camera, sightings: &self.sightings[at], spread: self.spread }
    }

    /// What a frame says by itself.
    fn alone(&self, at: usize) -> Result<Fit, BridgeReason> {
        let seen = self.sightings[at].len();
        let Some(best) = self.fits[at].first() else {
            return Err(match seen {
                0..3 => BridgeReason::TooFew,
                _ if is_on_a_line(&self.sightings[at]) => BridgeReason::OnALine,
                _ => BridgeReason::Contradictory,
            });
        };
        let is_rivalled =
            self.fits[at].get(1).is_some_and(|next| next.rating() < best.rating() + RULES.rival_margin);
        if is_rivalled && self.fits[at].iter().any(|fit| self.is_sound(at, fit).is_ok()) {
            return Err(BridgeReason::Ambiguous);
        }
        self.is_sound(at, best)?;
        match best.used() {
            // Three points that allow one pose only are not checked by a fourth, but nothing is against it.
            used if used >= RULES.checked_points || seen == 3 => Ok(best.clone()),
            _ => Err(BridgeReason::Ambiguous),
        }
    }

    /// Whether three points, and at least half of those in view, agree on a fit and determine it.
    fn is_sound(&self, at: usize, fit: &Fit) -> Result<(), BridgeReason> {
        let used = fit.used();
        if used < 3 || 2 * used < self.sightings[at].len() {
            return Err(BridgeReason::Contradictory);
        }
        self.is_determined(at, fit)
    }

    /// Whether the points that agree on a fit determine it.
    fn is_determined(&self, at: usize, fit: &Fit) -> Result<(), BridgeReason> {
        let inside = self.sightings[at].iter().zip(&fit.norms).filter(|(_, norm)| **norm <= GROSS_SIGMAS);
        if is_on_a_line(inside.map(|(sighting, _)| sighting)) {
            return Err(BridgeReason::OnALine);
        }
        match fit.largest_sigmas() {
            Some([position_m, rad]) if position_m <= RULES.most_sigma[0] && rad <= RULES.most_sigma[1] => {
                Ok(())
            }
            _ => Err(BridgeReason::PoorlySpread),
        }
    }

    fn anchor(&self, at: usize) -> Option<Anchor> {
        let time_s = self.times_s[at];
        if let Some((pose, covariance)) = self.given[at] {
            return Some(Anchor { time_s, pose, covariance });
        }
        let fit = self.chosen[at].as_ref().ok()?;
        Some(Anchor { time_s, pose: fit.pose, covariance: fit.covariance? })
    }

    /// The decided frames next to a frame that are not too far away.
    fn neighbours(&self, at: usize) -> [Option<Anchor>; 2] {
        let near = |anchor: &Anchor| (anchor.time_s - self.times_s[at]).abs() <= RULES.neighbour_within_s;
        let before = (0..at).rev().find_map(|k| self.anchor(k));
        let after = (at + 1..self.times_s.len()).find_map(|k| self.anchor(k));
        [before.filter(near), after.filter(near)]
    }

    /// Restarts every frame from between its neighbours; the lower cost stays.
    fn restart_between_neighbours(&mut self) {
        let restart = |at: usize| -> Option<Fit> {
            if self.given[at].is_some() || self.sightings[at].len() < 3 {
                return None;
            }
            let start = match self.neighbours(at) {
                [Some(a), Some(b)] => {
                    interpolate(&a.pose, &b.pose, (self.times_s[at] - a.time_s) / (b.time_s - a.time_s))
                }
                [Some(one), None] | [None, Some(one)] => one.pose,
                [None, None] => return None,
            };
            self.frame(at).finish(&start, self.chosen[at].is_err())
        };
        let found: Vec<Option<Fit>> = (0..self.times_s.len()).into_par_iter().map(restart).collect();
        for (at, fit) in found.into_iter().enumerate() {
            let Some(fit) = fit else { continue };
            self.fits[at].push(fit);
            frame::sort_out(&mut self.fits[at]);
            self.chosen[at] = self.alone(at);
        }
    }

    /// Decides frames that several poses fit by where their neighbours predict them.
    fn decide_by_neighbours(&mut self) {
        for _ in 0..RULES.most_rounds {
            let decided: Vec<Option<Fit>> =
                (0..self.times_s.len()).into_par_iter().map(|at| self.most_probable(at)).collect();
            if decided.iter().all(Option::is_none) {
                break;
            }
            for (at, fit) in decided.into_iter().enumerate() {
                if let Some(fit) = fit {
                    self.chosen[at] = Ok(fit);
                }
            }
        }
    }

    /// Takes back poses on few points that lie far from the path of their neighbours.
    fn drop_outcasts(&mut self) {
        let distance = |video: &Self, at: usize| -> Option<f64> {
            let fit = video.chosen[at].as_ref().ok().filter(|fit| fit.used() < RULES.well_checked_points)?;
            if video.given[at].is_some() || video.neighbours(at) == [None, None] {
                return None;
            }
            let (pose, covariance) = video.predict(at..at + 1)?.pop()?;
            let gap = pose_minus(&fit.pose, &pose);
            Some(gap.dot(&(covariance + fit.covariance?).cholesky()?.solve(&gap)))
        };
        for _ in 0..RULES.most_rounds {
            let count = self.times_s.len();
            let off: Vec<f64> =
                (0..count).into_par_iter().map(|at| distance(self, at).unwrap_or(0.0)).collect();
            let beside = |at: usize| {
                at.saturating_sub(RULES.worst_of_frames_beside)
                    ..(at + RULES.worst_of_frames_beside + 1).min(count)
            };
            let is_outcast =
                |at: &usize| off[*at] > RULES.off_path_beyond && beside(*at).all(|k| off[k] <= off[*at]);
            let outcasts: Vec<usize> = (0..count).filter(is_outcast).collect();
            if outcasts.is_empty() {
                break;
            }
            outcasts.into_iter().for_each(|at| self.chosen[at] = Err(BridgeReason::Contradictory));
        }
    }

    /// The pose that fits a frame and lies where its neighbours predict it, if just one does: of an ambiguous
    /// frame, or of one in which less than half of the points agree.
    fn most_probable(&self, at: usize) -> Option<Fit> {
        let is_likely = |fit: &Fit| match &self.chosen[at] {
            Err(BridgeReason::Ambiguous) => self.is_sound(at, fit).is_ok(),
            Err(BridgeReason::Contradictory) => {
                fit.used() >= RULES.checked_points && self.is_determined(at, fit).is_ok()
            }
            _ => false,
        };
        if !self.fits[at].iter().any(is_likely) || self.neighbours(at) == [None, None] {
            return None;
        }
        let (pose, covariance) = self.predict(at..at + 1)?.pop()?;
        let mut rated: Vec<(f64, &Fit)> = Vec::new();
        for fit in &self.fits[at] {
            let Some(own) = fit.covariance.filter(|_| is_likely(fit)) else { continue };
            let gap = pose_minus(&fit.pose, &pose);
            let distance = gap.dot(&(covariance + own).cholesky()?.solve(&gap));
            if distance < RULES.predicted_within {
                rated.push((fit.rating() + 0.5 * distance, fit));
            }
        }
        rated.sort_by(|a, b| a.0.total_cmp(&b.0));
        let is_rivalled = rated.get(1).is_some_and(|next| next.0 < rated[0].0 + RULES.rival_margin);
        rated.first().filter(|_| !is_rivalled).map(|(_, fit)| (*fit).clone())
    }

    /// Where the decided frames before and after put the frames of a gap.
    fn predict(&self, gap: std::ops::Range<usize>) -> Option<Vec<(Pose, Matrix6<f64>)>> {
        let mut before: Vec<Anchor> = (0..gap.start).rev().filter_map(|k| self.anchor(k)).take(8).collect();
        before.reverse();
        let after: Vec<Anchor> =
            (gap.end..self.times_s.len()).filter_map(|k| self.anchor(k)).take(8).collect();
        path::between(&before, &self.times_s[gap], &after)
    }

    /// The result; frames that are still open lie on the path between the others.
    fn bridge(self) -> Result<Resection, NotResectable> {
        let count = self.times_s.len();
        let is_open = |at: usize| self.anchor(at).is_none();
        if (0..count).all(is_open) {
            return Err(self.why_none());
        }
        let mut frames = Vec::with_capacity(count);
        while frames.len() < count {
            let at = frames.len();
            if let Some(anchor) = self.anchor(at) {
                frames.push(self.summary(at, &anchor.pose, &anchor.covariance));
                continue;
            }
            let end = (at..count).find(|k| !is_open(*k)).unwrap_or(count);
            let path = self.predict(at..end).unwrap_or_else(|| {
                // The filter broke down on covariances out of all proportion.
                let near = (0..at).rev().chain(end..count).find_map(|k| self.anchor(k));
                near.map_or_else(Vec::new, |a| vec![(a.pose, a.covariance); end - at])
            });
            frames.extend(
                (at..end).zip(&path).map(|(at, (pose, covariance))| self.summary(at, pose, covariance)),
            );
        }
        Ok(Resection { frames, spread: self.spread })
    }

    fn summary(&self, at: usize, pose: &Pose, covariance: &Matrix6<f64>) -> FrameResection {
        let seen = self.sightings[at].len();
        let fit = self.chosen[at].as_ref().ok().filter(|_| self.given[at].is_none());
        let status = match (&self.given[at], &self.chosen[at]) {
            (Some(_), _) => Status::Given,
            (None, Ok(_)) => Status::Resected,
            (None, Err(reason)) => Status::Bridged(*reason),
        };
        let used = fit.map_or(0, Fit::used);
        FrameResection {
            pose: *pose,
            covariance: *covariance,
            status,
            seen,
            used,
            gross: fit.map_or(0, |_| seen - used),
            rms_px: fit.map(|fit| fit.rms_px),
        }
    }

    /// Why no frame at all was resected: the reason of the frames that came farthest.
    fn why_none(&self) -> NotResectable {
        let reasons: Vec<BridgeReason> =
            self.chosen.iter().filter_map(|c| c.as_ref().err().copied()).collect();
        let is_there = |reason: BridgeReason| reasons.contains(&reason);
        if is_there(BridgeReason::Ambiguous) {
            NotResectable::Ambiguous
        } else if is_there(BridgeReason::PoorlySpread) {
            NotResectable::PoorlySpread
        } else if is_there(BridgeReason::OnALine) {
            NotResectable::OnALine
        } else if is_there(BridgeReason::Contradictory) {
            NotResectable::Contradictory
        } else {
            NotResectable::TooFew { most: self.sightings.iter().map(Vec::len).max().unwrap_or(0) }
        }
    }
}

/// Whether points lie nearly on one line.
fn is_on_a_line<'s>(sightings: impl IntoIterator<Item = &'s Sighting>) -> bool {
    let points: Vec<Vector3<f64>> = sightings.into_iter().map(|s| s.point.coords).collect();
    let mean = points.iter().sum::<Vector3<f64>>() / points.len().max(1) as f64;
    let scatter: nalgebra::Matrix3<f64> = points.iter().map(|p| (p - mean) * (p - mean).transpose()).sum();
    let mut along: [f64; 3] = scatter.symmetric_eigenvalues().into();
    along.sort_by(f64::total_cmp);
    along[1] <= RULES.line_width_share * RULES.line_width_share * along[2]
}

#[cfg(test)]
mod tests;
