//! The adjustment: shapes, vehicle poses and camera poses together.
//!
//! It runs in rounds, each a minimisation from where the last one ended:
//!
//! 1. **approach**: a loss that keeps pulling however far off a measurement is (Huber), because the
//!    starting poses alone can put good image points tens of pixels off;
//! 2. **graduated**: where many image points are gross, the chosen loss with a scale that shrinks to its own
//!    (graduated non-convexity: Blake and Zisserman 1987; Yang et al., RA-L 5, 2020), from the convex loss of
//!    the approach on, so that motion is not estimated from poses that gross errors still pull at;
//! 3. **variance components**: the chosen loss, and after each round the strength of the motion
//!    priors is estimated anew, until it no longer changes;
//! 4. **final**: all strengths fixed, to full accuracy.
//!
//! Before the first round, between rounds and after the last, whole tracks and frames are judged
//! (`gross_errors`); what is gross as a whole is left out, and what was left out and fits comes back.

mod alone;
mod body_frame;
mod datum;
mod directed_tests;
mod expected;
mod gross_errors;
mod images;
mod model;
mod motion;
mod network_warnings;
mod outcome;
mod receivers;
mod reversal;
mod warnings;

pub use alone::alone;
use body_frame::body_frames;
pub use body_frame::{BodyFrame, frame_step, point_motion, pose_motion};
pub use datum::{camera_gap, scale_gap};
pub use directed_tests::{CRITICAL, DirectedTest};
pub use expected::expected;
pub use gross_errors::{Excluded, Reason, Tally, Verdict, Verdicts};
pub use model::{LEAST_CONTACT_SIGMA, LEAST_HEIGHT_SIGMA_M, Model, Source, highest_points};
pub use motion::{Body, BodyStrength, MotionPrior, MotionPriors, Order, Strengths};
pub use network_warnings::{CameraGap, NetworkWarning, ScaleGap};
pub use outcome::{Adjustment, CheckPoint, Fits, LeastSquares, OUTLIER_SIGMAS, ObservationFit, Round};
pub use receivers::{antenna, positions_at};
pub use warnings::{AdjustmentWarning, NoSolution};

use crate::estimate::Estimate;
use crate::initialise::body_axes::heading_of_travel;
use crate::initialise::start_anew;
use crate::problem::Problem;
use directed_tests::{Held, directed_tests};
use model::Purpose;
use nalgebra::{Point3, UnitQuaternion, Vector3};
use trackbundle_solver::covariance::Covariance;
use trackbundle_solver::linear::cholesky::TooLarge;
use trackbundle_solver::loss::{DEFAULT_SHAPE, Loss, LossName};
use trackbundle_solver::minimise::{IterationRecord, Minimiser, MinimiserOptions, Minimum, Stop};
pub use trackbundle_solver::system::Arrangement;
use trackbundle_solver::system::Values;

/// What a user may choose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RefineOptions {
    /// The robust loss of image points.
    pub loss: LossName,
    /// Its scale in standard deviations of an image point; default: 95 % efficiency on good points.
    pub loss_scale: Option<f64>,
    /// Barron's alpha.
    pub loss_shape: f64,
    /// The most iterations, all rounds together.
    pub max_iterations: usize,
    /// The motion priors.
    pub motion: MotionPriors,
    /// How vehicles are eliminated; without effect on the result.
    pub arrangement: Arrangement,
}

impl Default for RefineOptions {
    fn default() -> Self {
        RefineOptions {
            loss: LossName::Tukey,
            loss_scale: None,
            loss_shape: DEFAULT_SHAPE,
            max_iterations: 100,
            motion: MotionPriors::ESTIMATED,
            arrangement: Arrangement::Cheapest,
        }
    }
}

/// Progress of an adjustment.
pub enum Progress<'a> {
    /// A round begins; rounds count from 1.
    Round(usize, &'static str),
    /// An iteration has ended, and what the estimate is then.
    Iteration(&'a IterationRecord, &'a dyn Fn() -> Estimate),
}

/// Where progress is reported.
pub type ProgressSink<'a> = &'a mut dyn FnMut(Progress<'_>);

/// Rounds in which motion priors are estimated, at the most.
const MOST_ROUNDS: usize = 8;
/// The approach ends when a step lowers the cost by less than this share.
const APPROACHED: f64 = 1e-3;
/// Records of an approach that comes from far.
const LONG_WAY: usize = 6;
/// A round between two estimates of the motion priors ends when a step lowers the cost by less.
const FOLLOWED: f64 = 1e-2;
/// Where more than this share of image points is gross after the approach, the loss is tightened step by step ...
const MANY_GROSS: f64 = 0.1;
/// ... by these factors of its scale.
const GRADUATED: [f64; 2] = [2.0, 1.0];
/// The most iterations of a round before the last.
const ROUND_ITERATIONS: usize = 10;
/// The last round ends when a step lowers the cost by less.
const ENDED: f64 = 1e-8;
/// That of the final least squares, which starts where the robust adjustment ended. Of a cost of 1e5 it leaves
/// less than a tenth of a standard deviation in the worst direction.
const LEAST_SQUARES_ENDED: f64 = 5e-8;
/// A body may be at the wrong one of two depths ([`reversal`]), which is looked for after so many iterations
/// of the last round, if it has not ended before: in a wrong minimum it may go on for long.
const BEFORE_REVERSAL: usize = 25;
/// After the last round whole tracks and frames are judged anew, and the round goes on, so often at the most.
const MOST_VERDICTS: usize = 3;
/// Motion strengths have settled when none changes by more than this factor.
const SETTLED: f64 = 1.15;

/// Image points of other standard deviations than stated, by more than this factor, weigh what they prove
/// to be worth.
const REWEIGHTED: f64 = 1.1;
/// ... unless it is beyond these: data without noise prove nothing.
const WEIGHED_WITHIN: [f64; 2] = [0.2, 100.0];
/// Rows of image points from which that can be said.
const LEAST_IMAGE_ROWS: usize = 200;
/// Image points are weighed anew so many times at the most.
const MOST_REWEIGHTINGS: usize = 5;

/// The adjusted unknowns, and the least squares behind them.
pub struct Adjusted {
    /// The adjusted unknowns.
    pub estimate: Estimate,
    /// How it was found and how well image points fit.
    pub adjustment: Adjustment,
    /// The final least squares, where the statistics come from; `None` where it failed.
    pub network: Option<Network>,
}

/// Least squares on accepted image points and what is known, at its minimum.
pub struct Network {
    /// The measurements.
    pub model: Model,
    /// The adjusted unknowns.
    pub values: Values,
    /// What holds the frames of vehicles.
    pub frames: Vec<BodyFrame>,
}

/// Adjusts `start`; [`adjust`] without what its statistics come from.
pub fn refine(
    problem: &Problem,
    start: &Estimate,
    options: &RefineOptions,
    progress: Option<ProgressSink<'_>>,
) -> Result<(Estimate, Adjustment), NoSolution> {
    adjust(problem, start, options, progress).map(|adjusted| (adjusted.estimate, adjusted.adjustment))
}

/// Adjusts `start`.
pub fn adjust(
    problem: &Problem,
    start: &Estimate,
    options: &RefineOptions,
    progress: Option<ProgressSink<'_>>,
) -> Result<Adjusted, NoSolution> {
    if start.vehicles.iter().all(|vehicle| vehicle.left_out.is_some()) {
        let all = problem.vehicles.iter().zip(&start.vehicles);
        let left_out = all.filter_map(|(v, e)| Some((v.id.clone(), e.left_out?))).collect();
        return Err(NoSolution::NoVehicle { left_out });
    }
    let mut start = start.clone();
    receivers::start_clocks(problem, &mut start);
    let start = &start;
    let scale = options.loss_scale.unwrap_or(options.loss.default_scale());
    let chosen = options.loss.with_scale(scale, options.loss_shape);
    let excluded = match options.loss {
        LossName::None => Excluded::nothing(problem),
        _ => Excluded::suspected(problem, start),
    };
    let model = Model::new(problem, start, start, options, Purpose::Adjustment { excluded: &excluded });
    let mut run = Run {
        problem,
        progress,
        start,
        options,
        minimiser: Minimiser::new(&model.system)?,
        values: model.system.start().clone(),
        model,
        excluded,
        left: options.max_iterations,
        rounds: Vec::new(),
    };
    let huber = Loss::Huber { scale: LossName::Huber.default_scale() };
    let approach = if chosen.redescends() { huber } else { chosen };
    let estimates_motion = run.model.motion.is_estimated();
    if chosen.redescends() || estimates_motion {
        run.model.set_image_loss(approach);
        let minimum = run.round("approach", APPROACHED, ROUND_ITERATIONS);
        if !minimum.stop.converged() || minimum.records.len() > LONG_WAY {
            run.approach_anew(approach, minimum.cost.value)?;
        }
        run.judge(approach)?;
    }
    let spread = run.model.spread(&run.values);
    let chosen = match options.loss_scale {
        // Image points worse than their stated sigma must not all be taken for gross errors.
        None => chosen.stretched(spread.max(1.0)),
        Some(_) => chosen,
    };
    if chosen.redescends() && run.gross_share(spread) > MANY_GROSS {
        for factor in GRADUATED {
            run.model.set_image_loss(chosen.stretched(factor));
            run.round("graduated", FOLLOWED, ROUND_ITERATIONS);
        }
        run.judge(chosen)?;
    }
    run.model.set_image_loss(chosen);
    if estimates_motion {
        for _ in 0..MOST_ROUNDS {
            let change = run.model.estimate_motion(&mut run.minimiser, &run.values)?;
            if change < SETTLED || run.left == 0 {
                break;
            }
            run.round("variance components", FOLLOWED, ROUND_ITERATIONS);
        }
    }
    run.judge(chosen)?;
    run.take_stock(chosen)?;
    let mut minimum = run.round("final", ENDED, BEFORE_REVERSAL);
    let now = run.model.estimate(problem, start, &run.values);
    let strengths = run.model.motion.strengths(&run.model.system);
    if let Some(better) =
        reversal::better_reversed(problem, start, &now, options, &strengths, chosen, &run.excluded)?
    {
        run.go_on_from(&better, chosen)?;
        minimum = run.round("final, at the other depth", ENDED, usize::MAX);
    } else if !minimum.stop.converged() {
        minimum = run.round("final, continued", ENDED, usize::MAX);
    }
    for _ in 0..MOST_VERDICTS {
        if run.left == 0 || !run.judge(chosen)? {
            break;
        }
        minimum = run.round("final, judged anew", ENDED, usize::MAX);
    }
    let mut estimate = run.model.estimate(problem, start, &run.values);
    look_where_they_drive(problem, &mut estimate);
    if !estimate.is_finite() || !minimum.cost.value.is_finite() {
        return Err(NoSolution::NotFinite);
    }
    if let Stop::Iterations { limit } = &mut minimum.stop {
        // Of all rounds together.
        *limit = options.max_iterations;
    }
    let excluded = run.excluded.clone();
    let fits = Fits::new(problem, &estimate, chosen, spread, &excluded);
    if fits.inside(problem)[0].is_empty() {
        return Err(NoSolution::NothingFits);
    }
    let robust = estimate.clone();
    let dropped = outcome::drop_rejected_points(problem, &mut estimate, &fits);
    let network = run.least_squares(&mut estimate, &fits)?;
    let used = fits.clone();
    let fits = match network {
        // Image points of points that were dropped stay the gross errors that they were.
        Some(_) => Fits::new(problem, &with_points_of(&estimate, &robust), chosen, spread, &excluded),
        None => fits,
    };
    let end = outcome::End {
        model: &run.model,
        minimum,
        rounds: run.rounds,
        spread,
        image_loss: chosen,
        fits,
        robust: &robust,
        network: network.as_ref(),
    };
    let mut adjustment = outcome::summarise(problem, start, &estimate, end);
    adjustment.warnings.extend(dropped);
    if let Some(network) = &network {
        let accepted = if options.loss == LossName::None { &used.all_accepted() } else { &used };
        adjustment.directed_tests = directed_tests(&Held {
            problem,
            start,
            estimate: &estimate,
            options,
            fits: accepted,
            frames: &network.frames,
            model: &network.model,
        });
    }
    Ok(Adjusted { estimate, adjustment, network })
}

/// An estimate with the points that it lacks from another.
fn with_points_of(estimate: &Estimate, other: &Estimate) -> Estimate {
    let mut whole = estimate.clone();
    for (vehicle, other) in whole.vehicles.iter_mut().zip(&other.vehicles) {
        vehicle.points.iter_mut().zip(&other.points).for_each(|(point, other)| *point = point.or(*other));
    }
    whole
}

/// Turns the frames of vehicles that nothing else turns, so that their x axes point where they drive: a
/// change of the datum, which no measurement notices. Seen from adjusted poses the direction of travel is
/// better known than it was at the start, and what holds it on the way is weak.
fn look_where_they_drive(problem: &Problem, estimate: &mut Estimate) {
    let mut receivers = std::mem::take(&mut estimate.receivers);
    for (at, (vehicle, estimate)) in problem.vehicles.iter().zip(&mut estimate.vehicles).enumerate() {
        let is_known = vehicle.points.iter().any(|p| p.known[0].is_some() || p.known[1].is_some());
        if is_known || !vehicle.has_no_poses() || estimate.left_out.is_some() {
            continue;
        }
        let points: Vec<Point3<f64>> = estimate.points.iter().flatten().copied().collect();
        let Some(angle) = heading_of_travel(&estimate.poses, &points) else { continue };
        let body_from_turned = UnitQuaternion::from_scaled_axis(Vector3::z() * angle);
        estimate.poses.iter_mut().flatten().for_each(|pose| pose.rotation *= body_from_turned);
        estimate.points.iter_mut().flatten().for_each(|point| *point = body_from_turned.inverse() * *point);
        let own = problem.receivers.iter().zip(&mut receivers).filter(|(receiver, _)| receiver.vehicle == at);
        own.for_each(|(_, found)| found.lever_arm_m = body_from_turned.inverse() * found.lever_arm_m);
    }
    estimate.receivers = receivers;
}

struct Run<'a, 'p> {
    problem: &'a Problem,
    start: &'a Estimate,
    options: &'a RefineOptions,
    progress: Option<ProgressSink<'p>>,
    model: Model,
    /// What the model leaves out.
    excluded: Excluded,
    minimiser: Minimiser,
    values: Values,
    /// Iterations left.
    left: usize,
    rounds: Vec<Round>,
}

impl Run<'_, '_> {
    /// Minimises from the current values and moves them.
    fn round(&mut self, name: &'static str, relative_decrease: f64, most: usize) -> Minimum {
        if let Some(progress) = &mut self.progress {
            progress(Progress::Round(self.rounds.len() + 1, name));
        }
        let max_iterations = self.left.min(most);
        let options = MinimiserOptions { max_iterations, relative_decrease, ..Default::default() };
        let Run { problem, start, model, minimiser, values, progress, .. } = self;
        let mut watch = |record: &IterationRecord, values: &Values| {
            if let Some(progress) = progress {
                progress(Progress::Iteration(record, &|| model.estimate(problem, start, values)));
            }
        };
        let minimum = minimiser.run(&model.system, values, options, Some(&mut watch));
        self.left -= minimum.records.len() - 1;
        self.values = minimum.values.clone();
        self.rounds.push(Round { name, stop: minimum.stop, records: minimum.records.clone() });
        minimum
    }

    /// Least squares on the image points that fit, from `estimate`, which it moves. Image points whose scatter
    /// is another than stated are weighed by it, and motion anew with them. `None`, and nothing moved, where
    /// that cannot be solved.
    fn least_squares(&mut self, estimate: &mut Estimate, fits: &Fits) -> Result<Option<Network>, NoSolution> {
        let values = self.model.values(estimate);
        let frames = body_frames(self.problem, estimate, &self.model, &values);
        // Whoever wants plain least squares has nothing rejected.
        let accepted = if self.options.loss == LossName::None { &fits.all_accepted() } else { fits };
        let purpose = Purpose::Statistics { fits: accepted, frames: &frames };
        let mut model = Model::new(self.problem, self.start, estimate, self.options, purpose);
        model.copy_motion(&self.model);
        self.values = model.system.start().clone();
        self.minimiser = Minimiser::new(&model.system)?;
        let robust = std::mem::replace(&mut self.model, model);
        let mut minimum = self.round("least squares", LEAST_SQUARES_ENDED, ROUND_ITERATIONS);
        for _ in 0..MOST_REWEIGHTINGS {
            if !self.reweigh() {
                break;
            }
            self.model.estimate_motion(&mut self.minimiser, &self.values)?;
            minimum = self.round("least squares, weighed anew", LEAST_SQUARES_ENDED, ROUND_ITERATIONS);
        }
        let mut found = self.model.estimate(self.problem, self.start, &self.values);
        let mut model = std::mem::replace(&mut self.model, robust);
        model.loosen_conventions();
        if !found.is_finite() || matches!(minimum.stop, Stop::Stalled { .. }) {
            return Ok(None);
        }
        for ((frame, before), found) in frames.iter().zip(&estimate.vehicles).zip(&mut found.vehicles) {
            frame.restore(before, found);
        }
        *estimate = found;
        let values = model.values(estimate);
        let frames = body_frames(self.problem, estimate, &model, &values)
            .into_iter()
            .zip(frames)
            // Where the frame was held stays as it was chosen.
            .map(|(now, before)| BodyFrame { anchors: before.anchors, ..now })
            .collect();
        Ok(Some(Network { model, values, frames }))
    }

    /// Weighs image points by their scatter (a variance component for each kind, [`motion`]), where that is
    /// certainly another than stated; whether that changed much.
    fn reweigh(&mut self) -> bool {
        let rows = self.model.image_rows(&self.values);
        let unknowns = self.model.system.parameters();
        let factors = self.model.image_factors();
        let is_other = |(factor, (rows, squares)): (&f64, &(usize, f64))| {
            // Redundancy is at most that, and at least this.
            let (most, least) = (*rows as f64, rows.saturating_sub(unknowns).max(1) as f64);
            let bounds = [most, least].map(|redundancy| factor * (squares / redundancy).sqrt());
            *rows >= LEAST_IMAGE_ROWS && (bounds[0] > REWEIGHTED || bounds[1] < 1.0 / REWEIGHTED)
        };
        if !factors.iter().zip(&rows).any(is_other) {
            return false;
        }
        let Ok(covariance) = Covariance::new(&self.model.system, &self.values) else { return false };
        let mut weighed = factors;
        let mut largest = 1.0_f64;
        for (at, group) in self.model.image_groups().into_iter().enumerate() {
            let (rows, squares) = rows[at];
            let trace: f64 =
                covariance.leverages(group).chunks_exact(4).map(|block| block[0] + block[3]).sum();
            let change = (squares / (rows as f64 - trace).max(1.0)).sqrt();
            let factor = factors[at] * change;
            if rows >= LEAST_IMAGE_ROWS
                && factor.max(1.0 / factor) > REWEIGHTED
                && (WEIGHED_WITHIN[0]..WEIGHED_WITHIN[1]).contains(&factor)
            {
                weighed[at] = factor;
                largest = largest.max(change).max(1.0 / change);
            }
        }
        drop(covariance);
        self.model.set_image_factors(weighed);
        largest > 1.01
    }

    /// Where the way from the given poses is long, that from poses found in the images may be short: of the
    /// two ends the one of lower cost.
    fn approach_anew(&mut self, loss: Loss, cost: f64) -> Result<(), TooLarge> {
        let Some(anew) = start_anew(self.problem, self.start) else { return Ok(()) };
        let before = self.go_on_from(&anew, loss)?;
        let minimum = self.round("approach from found poses", APPROACHED, ROUND_ITERATIONS);
        if minimum.cost.value >= cost {
            (self.minimiser, self.model, self.values) = before;
        }
        Ok(())
    }

    /// Share of the image points of vehicles that are gross.
    fn gross_share(&self, spread: f64) -> f64 {
        self.model.share_beyond(&self.values, OUTLIER_SIGMAS * spread.max(1.0))
    }

    /// Judges whole tracks and frames by what is known of the poses now; what fits comes back. Whether that
    /// changes what is left out.
    fn judge(&mut self, image_loss: Loss) -> Result<bool, TooLarge> {
        if self.options.loss == LossName::None {
            return Ok(false);
        }
        let now = self.model.estimate(self.problem, self.start, &self.values);
        let spread = self.model.spread(&self.values);
        let (judged, now) = self.excluded.judged_anew(self.problem, &now, spread);
        let changes = judged != self.excluded;
        if changes {
            self.excluded = judged;
            self.go_on_from(&now, image_loss)?;
        }
        Ok(changes)
    }

    /// Makes the model anew from what is known now: which point of a body is its highest, how things move
    /// while rows are read out, between which frames a GNSS position falls, how far vehicles are away.
    fn take_stock(&mut self, image_loss: Loss) -> Result<(), TooLarge> {
        let now = self.model.estimate(self.problem, self.start, &self.values);
        self.go_on_from(&now, image_loss)?;
        Ok(())
    }

    /// Takes another estimate, losses and strengths as they are; returns what was before.
    fn go_on_from(
        &mut self,
        now: &Estimate,
        image_loss: Loss,
    ) -> Result<(Minimiser, Model, Values), TooLarge> {
        let purpose = Purpose::Adjustment { excluded: &self.excluded };
        let mut model = Model::new(self.problem, self.start, now, self.options, purpose);
        model.set_image_loss(image_loss);
        model.copy_motion(&self.model);
        let values = model.system.start().clone();
        Ok((
            std::mem::replace(&mut self.minimiser, Minimiser::new(&model.system)?),
            std::mem::replace(&mut self.model, model),
            std::mem::replace(&mut self.values, values),
        ))
    }
}
