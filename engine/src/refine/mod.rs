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
mod directed_tests;
mod expected;
mod fit;
mod frames;
mod gross_errors;
mod outcome;
mod reversal;
mod schedule;
mod score_test;
mod verdicts;
mod warnings;
mod wrong_tracks;

pub use alone::alone;
pub use expected::expected;
pub use fit::ObservationFit;
pub use frames::is_in_the_middle;
pub use outcome::{Adjustment, CheckPoint, Fits, LeastSquares, Round};
pub use schedule::RoundSchedule;
pub use score_test::{CRITICAL, DirectedTest};
pub use verdicts::{Excluded, ImagePointVerdict, RejectionReason, Tally, Verdicts};
pub use warnings::{AdjustmentWarning, NoSolution};

use crate::estimate::{Depth, Estimate};
use crate::initialise::{BODY_MIDDLE_M, is_inside, start_anew};
use crate::network::{
    Anchors, LOOSENED_SHAPES, NetworkOptions, Purpose, STARTING_SHAPE_SIGMA_M, anchored, body_frames,
    half_sizes, start_clocks,
};
pub use crate::network::{
    Body, BodyStrength, MotionPrior, Order, Source, Strengths, camera_gap, frame_step, point_motion,
    pose_motion, scale_gap,
};
pub use crate::network::{BodyFrame, Model, MotionPriors, OUTLIER_SIGMAS};
use crate::problem::Problem;
use crate::rules::Rules;
use directed_tests::{Held, directed_tests};
use nalgebra::Point3;
use trackbundle_solver::TooLarge;
use trackbundle_solver::covariance::Covariance;
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
    /// The most iterations, all rounds together; where the approach begins anew without wrong tracks, from there on.
    pub max_iterations: usize,
    /// The motion priors.
    pub motion: MotionPriors,
    /// How vehicles are eliminated; without effect on the result.
    pub arrangement: Arrangement,
}

impl RefineOptions {
    /// What of them the network depends on.
    pub fn network(&self) -> NetworkOptions {
        NetworkOptions { motion: self.motion, arrangement: self.arrangement }
    }
}

impl Default for RefineOptions {
    fn default() -> Self {
        RefineOptions {
            loss: LossName::Tukey,
            loss_scale: None,
            loss_shape: DEFAULT_SHAPE,
            max_iterations: 300,
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

/// The constants of the adjustment.
pub fn constants() -> Vec<Rules> {
    vec![
        crate::problem::ContactRules::PAGE,
        crate::network::HighestRules::PAGE,
        RoundSchedule::PAGE,
        gross_errors::GrossErrorRules::PAGE,
        wrong_tracks::WrongTrackRules::PAGE,
        reversal::ReversalRules::PAGE,
    ]
}

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

/// Adjusts `start`.
pub fn adjust_network(
    problem: &Problem,
    start: &Estimate,
    options: &RefineOptions,
    progress: Option<ProgressSink<'_>>,
) -> Result<Adjusted, NoSolution> {
    adjust_by(&RoundSchedule::DEFAULT, problem, start, options, progress)
}

/// Adjusts `start` in the rounds of a schedule.
pub fn adjust_by(
    schedule: &RoundSchedule,
    problem: &Problem,
    start: &Estimate,
    options: &RefineOptions,
    progress: Option<ProgressSink<'_>>,
) -> Result<Adjusted, NoSolution> {
    need_a_vehicle(problem, start)?;
    let mut start = start.clone();
    start_clocks(problem, &mut start);
    let mut run = Run::new(schedule, problem, &start, options, progress)?;
    run.approach()?;
    run.scale_loss();
    run.graduate()?;
    run.estimate_motion()?;
    run.judge(run.loss)?;
    run.take_stock(run.loss)?;
    let minimum = run.finish()?;
    run.conclude(minimum)
}

fn need_a_vehicle(problem: &Problem, start: &Estimate) -> Result<(), NoSolution> {
    if start.vehicles.iter().any(|vehicle| vehicle.left_out.is_none()) {
        return Ok(());
    }
    let all = problem.vehicles.iter().zip(&start.vehicles);
    let left_out = all.filter_map(|(v, e)| Some((v.id.clone(), e.left_out?))).collect();
    Err(NoSolution::NoVehicle { left_out })
}

/// The least squares on accepted image points, with frames of bodies held where they are.
fn statistical(
    problem: &Problem,
    start: &Estimate,
    current: &Estimate,
    options: &RefineOptions,
    accepted: &Fits,
    frames: &[BodyFrame],
) -> Model {
    let anchors: Vec<Anchors> = frames.iter().map(|frame| frame.anchors.clone()).collect();
    let purpose = Purpose::Statistics { anchors: &anchors };
    Model::new(problem, start, current, options.network(), &accepted.selection(), purpose)
}

/// By how many standard deviations points whose depth is weak, and shapes whose scale nothing was thought to know, pull at
/// anything at the most, that are held where they were before they moved: to first order a function of the unknowns is moved
/// by `a^T Q J^T r`, which is at most `|r|` of its standard deviations.
fn pull_of_places(problem: &Problem, start: &Estimate, held_at: &Estimate, now: &Estimate) -> f64 {
    let mut squares = 0.0;
    let of_shapes = problem.vehicles.iter().zip(held_at.vehicles.iter().zip(&now.vehicles));
    for (_, (held_at, now)) in
        of_shapes.filter(|(vehicle, _)| problem.may_have_relief() && scale_gap(problem, vehicle).is_some())
    {
        let places = held_at.points.iter().zip(&now.points);
        let moved: Vec<f64> =
            places.filter_map(|(before, after)| Some(((*after)? - (*before)?).norm_squared())).collect();
        let mean = moved.iter().sum::<f64>() / moved.len().max(1) as f64;
        squares += mean / (LOOSENED_SHAPES * STARTING_SHAPE_SIGMA_M).powi(2);
    }
    for ((start, held_at), now) in start.vehicles.iter().zip(&held_at.vehicles).zip(&now.vehicles) {
        let places = held_at.points.iter().zip(&now.points);
        for (depth, places) in start.depths.iter().zip(places) {
            let (Depth::Told | Depth::Weak, (Some(before), Some(after))) = (depth, places) else { continue };
            let moved = (after - before) / half_sizes(*depth);
            squares += (0..3).map(|axis| (moved[axis] / BODY_MIDDLE_M[axis].1).powi(2)).sum::<f64>();
        }
    }
    squares.sqrt()
}

struct Run<'a, 'p> {
    schedule: &'a RoundSchedule,
    problem: &'a Problem,
    start: &'a Estimate,
    options: &'a RefineOptions,
    progress: Option<ProgressSink<'p>>,
    model: Model,
    /// What the model leaves out.
    excluded: Excluded,
    /// Points of vehicles as they were last known, those too whose tracks are left out.
    known_points: Vec<Vec<Option<Point3<f64>>>>,
    minimiser: Minimiser,
    values: Values,
    /// The chosen loss of image points.
    loss: Loss,
    /// What good image points scatter after the approach, in standard deviations.
    spread: f64,
    estimates_motion: bool,
    /// Whether tracks were left out of late that bend a motion to themselves.
    is_bent: bool,
    /// Iterations left.
    left: usize,
    rounds: Vec<Round>,
}

impl<'a, 'p> Run<'a, 'p> {
    fn new(
        schedule: &'a RoundSchedule,
        problem: &'a Problem,
        start: &'a Estimate,
        options: &'a RefineOptions,
        progress: Option<ProgressSink<'p>>,
    ) -> Result<Self, TooLarge> {
        let scale = options.loss_scale.unwrap_or(options.loss.default_scale());
        let excluded = match options.loss {
            LossName::None => Excluded::nothing(problem),
            _ => Excluded::suspected(problem, start),
        };
        let selection = excluded.selection();
        let taken = excluded.without_points_left_out(problem, start);
        let model = anchored(problem, start, &taken, options.network(), &selection);
        Ok(Run {
            known_points: start.vehicles.iter().map(|vehicle| vehicle.points.clone()).collect(),
            schedule,
            problem,
            progress,
            start,
            options,
            minimiser: Minimiser::new(&model.system)?,
            values: model.system.start().clone(),
            loss: options.loss.with_scale(scale, options.loss_shape),
            spread: 1.0,
            estimates_motion: model.motion.is_estimated(),
            model,
            excluded,
            is_bent: false,
            left: options.max_iterations,
            rounds: Vec::new(),
        })
    }

    /// From poses that may be far off, with a loss that keeps pulling.
    fn approach(&mut self) -> Result<(), TooLarge> {
        let huber = Loss::Huber { scale: LossName::Huber.default_scale() };
        let loss = if self.loss.redescends() { huber } else { self.loss };
        if !self.loss.redescends() && !self.estimates_motion {
            return Ok(());
        }
        let (decrease, most) = (self.schedule.approach_decrease, self.schedule.interim_iterations);
        self.model.set_image_loss(loss);
        let minimum = self.round("approach", decrease, most);
        if !minimum.stop.converged() || minimum.records.len() > self.schedule.long_approach {
            self.approach_anew(loss, minimum.cost.value)?;
        }
        self.judge(loss)?;
        for _ in 0..self.schedule.most_new_approaches {
            if !std::mem::take(&mut self.is_bent) {
                break;
            }
            // Wrong tracks have bent the motion to themselves, and what is left would keep it there. It begins
            // anew, iterations and all.
            self.left = self.options.max_iterations;
            self.go_on_from(self.start, loss)?;
            self.round("approach without wrong tracks", decrease, most);
            self.judge(loss)?;
        }
        Ok(())
    }

    /// Image points worse than their stated sigma must not all be taken for gross errors.
    fn scale_loss(&mut self) {
        self.spread = self.model.spread(&self.values);
        if self.options.loss_scale.is_none() {
            self.loss = self.loss.stretched(self.spread.max(1.0));
        }
    }

    /// Where many image points are gross, the chosen loss in steps.
    fn graduate(&mut self) -> Result<(), TooLarge> {
        let RoundSchedule { interim_decrease, interim_iterations, graduated_above_share, .. } =
            *self.schedule;
        let are_many = self.loss.redescends() && self.gross_share(self.spread) > graduated_above_share;
        if !are_many {
            return Ok(());
        }
        for factor in self.schedule.graduated_scales {
            self.model.set_image_loss(self.loss.stretched(factor));
            self.round("graduated", interim_decrease, interim_iterations);
        }
        self.judge(self.loss)?;
        Ok(())
    }

    /// Variance components of motion, in turn with the unknowns.
    fn estimate_motion(&mut self) -> Result<(), NoSolution> {
        self.model.set_image_loss(self.loss);
        if !self.estimates_motion {
            return Ok(());
        }
        let RoundSchedule { interim_decrease, interim_iterations, motion_settled_factor, .. } =
            *self.schedule;
        for _ in 0..self.schedule.most_motion_rounds {
            let change = self.model.estimate_motion(&mut self.minimiser, &self.values)?;
            if change < motion_settled_factor || self.left == 0 {
                break;
            }
            self.round("variance components", interim_decrease, interim_iterations);
        }
        Ok(())
    }

    /// The last round, from the better of two depths, until nothing more is left out or comes back.
    fn finish(&mut self) -> Result<Minimum, NoSolution> {
        let decrease = self.schedule.final_decrease;
        let mut minimum = self.round("final", decrease, self.schedule.iterations_before_reversal);
        let now = self.model.estimate(self.problem, self.start, &self.values);
        let strengths = self.model.motion.strengths(&self.model.system);
        let (problem, start) = (self.problem, self.start);
        let excluded = &self.excluded;
        if let Some(better) =
            reversal::better_reversed(problem, start, &now, self.options, &strengths, self.loss, excluded)?
        {
            self.go_on_from(&better, self.loss)?;
            minimum = self.round("final, at the other depth", decrease, usize::MAX);
        } else if !minimum.stop.converged() {
            minimum = self.round("final, continued", decrease, usize::MAX);
        }
        for _ in 0..self.schedule.most_final_judgements {
            if self.left == 0 || !self.judge(self.loss)? {
                break;
            }
            minimum = self.round("final, judged anew", decrease, usize::MAX);
        }
        // On the way strengths were those of estimates that were not yet right.
        for _ in 0..self.schedule.most_final_motion_rounds {
            if !self.estimates_motion || self.left == 0 {
                break;
            }
            let change = self.model.estimate_motion(&mut self.minimiser, &self.values)?;
            if change < self.schedule.motion_settled_factor {
                break;
            }
            minimum = self.round("final, motion anew", decrease, usize::MAX);
        }
        if let Stop::Iterations { limit, .. } = &mut minimum.stop {
            // Of all rounds together.
            *limit = self.options.max_iterations;
        }
        Ok(minimum)
    }

    /// What is known now, with the points that the model leaves out where they were last.
    fn whole_estimate(&self) -> Estimate {
        let mut estimate = self.model.estimate(self.problem, self.start, &self.values);
        for (vehicle, known) in estimate.vehicles.iter_mut().zip(&self.known_points) {
            vehicle.points.iter_mut().zip(known).for_each(|(point, known)| *point = point.or(*known));
        }
        estimate
    }

    /// The robust estimate at its minimum, and how image points fit it.
    fn robust_estimate(&self, minimum: &Minimum) -> Result<(Estimate, Fits), NoSolution> {
        let mut estimate = self.model.estimate(self.problem, self.start, &self.values);
        let before = estimate.clone();
        let open = body_frames(self.problem, &estimate, &self.model, &self.values);
        frames::settle(self.problem, &mut estimate, &open);
        frames::take_along(&before, &mut estimate, &self.known_points);
        if !estimate.is_finite() || !minimum.cost.value.is_finite() {
            return Err(NoSolution::NotFinite);
        }
        let fits = Fits::new(self.problem, &estimate, self.loss, self.spread, &self.excluded);
        if fits.inside(self.problem)[0].is_empty() {
            return Err(NoSolution::NothingFits);
        }
        Ok((estimate, fits))
    }

    /// Least squares from the minimum of the robust adjustment, and what is said of both.
    fn conclude(mut self, minimum: Minimum) -> Result<Adjusted, NoSolution> {
        let (problem, start, options) = (self.problem, self.start, self.options);
        let (mut estimate, used) = self.robust_estimate(&minimum)?;
        let robust = estimate.clone();
        let dropped = outcome::drop_rejected_points(problem, &mut estimate, &used);
        let network = self.least_squares(&mut estimate, &used)?;
        if network.as_ref().is_some_and(|network| network.model.system.parameters() == 0) {
            return Err(NoSolution::NothingToAdjust);
        }
        let fits = match network {
            // Image points of points that were dropped stay the gross errors that they were.
            Some(_) => {
                let mut whole = estimate.clone();
                let known: Vec<_> = robust.vehicles.iter().map(|vehicle| vehicle.points.clone()).collect();
                frames::take_along(&robust, &mut whole, &known);
                Fits::new(problem, &whole, self.loss, self.spread, &self.excluded)
            }
            None => used.clone(),
        };
        let end = outcome::End {
            model: &self.model,
            minimum,
            rounds: self.rounds,
            spread: self.spread,
            image_loss: self.loss,
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
        let RoundSchedule { least_squares_decrease, least_squares_iterations, .. } = *self.schedule;
        let values = self.model.values(estimate);
        let frames = body_frames(self.problem, estimate, &self.model, &values);
        // Whoever wants plain least squares has nothing rejected.
        let accepted = if self.options.loss == LossName::None { &fits.all_accepted() } else { fits };
        // What was open at the start is perhaps determined by now.
        let mut start = self.start.clone();
        for depth in start.vehicles.iter_mut().flat_map(|vehicle| &mut vehicle.depths) {
            if *depth == Depth::Open {
                *depth = Depth::Weak;
            }
        }
        let robust = self.begin_least_squares(&start, estimate, accepted, &frames)?;
        let mut minimum = self.round("least squares", least_squares_decrease, least_squares_iterations);
        for _ in 0..self.schedule.most_reweightings {
            if !self.reweigh() {
                break;
            }
            self.model.estimate_motion(&mut self.minimiser, &self.values)?;
            minimum =
                self.round("least squares, weighed anew", least_squares_decrease, least_squares_iterations);
        }
        if let Some(last) = self.let_go(&mut start, estimate, accepted, &frames)? {
            minimum = last;
        }
        let mut found = self.model.estimate(self.problem, self.start, &self.values);
        let mut model = std::mem::replace(&mut self.model, robust);
        model.loosen_conventions();
        if !found.is_finite() || matches!(minimum.stop, Stop::Stalled { .. }) {
            return Ok(None);
        }
        for ((frame, before), found) in frames.iter().zip(&estimate.vehicles).zip(&mut found.vehicles) {
            frame.restore(before, found);
            found.axes_sigma_rad = before.axes_sigma_rad;
            found.heading_turned = before.heading_turned;
        }
        *estimate = found;
        let open = body_frames(self.problem, estimate, &model, &model.values(estimate));
        frames::settle_again(self.problem, estimate, &open);
        let values = model.values(estimate);
        let frames = body_frames(self.problem, estimate, &model, &values)
            .into_iter()
            .zip(frames)
            // Where the frame was held stays as it was chosen.
            .map(|(now, before)| BodyFrame { anchors: before.anchors, ..now })
            .collect();
        Ok(Some(Network { model, values, frames }))
    }

    /// Takes the least squares from `now` for its model, image points weighed as they were; returns the model before.
    fn begin_least_squares(
        &mut self,
        start: &Estimate,
        now: &Estimate,
        accepted: &Fits,
        frames: &[BodyFrame],
    ) -> Result<Model, TooLarge> {
        let mut model = statistical(self.problem, start, now, self.options, accepted, frames);
        model.copy_motion(&self.model);
        model.set_image_factors(self.model.image_factors());
        // What they hold on the way must not pull at the end.
        model.loosen_for_least_squares();
        self.values = model.system.start().clone();
        self.minimiser = Minimiser::new(&model.system)?;
        Ok(std::mem::replace(&mut self.model, model))
    }

    /// Points whose depth is weak have moved since they were put where they were, at `held_at`: puts them there anew,
    /// until they pull at nothing or it does not become less. The last minimum, where there was one.
    fn let_go(
        &mut self,
        start: &mut Estimate,
        held_at: &Estimate,
        accepted: &Fits,
        frames: &[BodyFrame],
    ) -> Result<Option<Minimum>, TooLarge> {
        let RoundSchedule { least_pull, settling_share, least_squares_decrease, .. } = *self.schedule;
        let mut now = self.model.estimate(self.problem, self.start, &self.values);
        let mut pull = pull_of_places(self.problem, start, held_at, &now);
        let mut last = None;
        for round in 0..self.schedule.most_lettings_go {
            if pull <= least_pull || !now.is_finite() {
                break;
            }
            if round == 0 {
                self.tell_depths(start);
            }
            // What has left the body has no depth that is worth the name.
            for (held, now) in start.vehicles.iter_mut().zip(&now.vehicles) {
                for (depth, place) in held.depths.iter_mut().zip(&now.points) {
                    let is_outside = place.is_some_and(|place| !is_inside(&place));
                    if matches!(*depth, Depth::Told | Depth::Weak) && is_outside {
                        *depth = Depth::Open;
                    }
                }
            }
            self.begin_least_squares(start, &now, accepted, frames)?;
            let held_at = now;
            let most = self.schedule.least_squares_iterations;
            last = Some(self.round("least squares, let go", least_squares_decrease, most));
            now = self.model.estimate(self.problem, self.start, &self.values);
            let pull_before =
                std::mem::replace(&mut pull, pull_of_places(self.problem, start, &held_at, &now));
            // Where it does not become less, nothing else tells these places.
            if round > 0 && pull > settling_share * pull_before {
                break;
            }
        }
        Ok(last)
    }

    /// Of points whose depth is weak tells those that other knowledge tells better than that they are on a car from those
    /// that nothing does.
    fn tell_depths(&self, start: &mut Estimate) {
        let sizes = self.model.open_places(&self.values);
        for (at, vehicle) in start.vehicles.iter_mut().enumerate() {
            for (point, depth) in vehicle.depths.iter_mut().enumerate() {
                if *depth == Depth::Weak {
                    let is_told = sizes[at][point].is_some_and(|size| size <= self.schedule.most_open_size);
                    *depth = if is_told { Depth::Told } else { Depth::Open };
                }
            }
        }
    }

    /// Weighs image points by their scatter (a variance component for each kind, [`motion`]), where that is
    /// certainly another than stated; whether that changed much.
    fn reweigh(&mut self) -> bool {
        let schedule = self.schedule;
        let (certain, [least, most]) = (schedule.reweighted_factor, schedule.reweighted_within);
        let rows = self.model.image_rows(&self.values);
        let unknowns = self.model.parameters();
        let factors = self.model.image_factors();
        let is_other = |(factor, (rows, squares)): (&f64, &(usize, f64))| {
            // Redundancy is at most that, and at least this.
            let redundancies = [*rows as f64, rows.saturating_sub(unknowns).max(1) as f64];
            let bounds = redundancies.map(|redundancy| factor * (squares / redundancy).sqrt());
            *rows >= schedule.reweighted_least_rows && (bounds[0] > certain || bounds[1] < 1.0 / certain)
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
            if rows >= schedule.reweighted_least_rows
                && factor.max(1.0 / factor) > certain
                && (least..most).contains(&factor)
            {
                weighed[at] = factor;
                largest = largest.max(change).max(1.0 / change);
            }
        }
        drop(covariance);
        self.model.set_image_factors(weighed);
        largest > schedule.reweighting_settled_factor
    }

    /// Where the way from the given poses is long, that from poses found in the images may be short: of the
    /// two ends the one of lower cost.
    fn approach_anew(&mut self, loss: Loss, cost: f64) -> Result<(), TooLarge> {
        let Some(anew) = start_anew(self.problem, self.start) else { return Ok(()) };
        let before = self.go_on_from(&anew, loss)?;
        let (decrease, most) = (self.schedule.approach_decrease, self.schedule.interim_iterations);
        let minimum = self.round("approach from found poses", decrease, most);
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
        let now = self.whole_estimate();
        let spread = self.model.spread(&self.values);
        let (judged, now) = self.excluded.judged_anew(self.problem, &now, spread);
        let changes = judged.selection() != self.excluded.selection();
        self.is_bent |= judged.has_new_tracks_that_bend(&self.excluded);
        self.excluded = judged;
        if changes {
            self.go_on_from(&now, image_loss)?;
        }
        Ok(changes)
    }

    /// Makes the model anew from what is known now: which point of a body is its highest, how things move
    /// while rows are read out, between which frames a GNSS position falls, how far vehicles are away.
    fn take_stock(&mut self, image_loss: Loss) -> Result<(), TooLarge> {
        let now = self.whole_estimate();
        self.go_on_from(&now, image_loss)?;
        Ok(())
    }

    /// Takes another estimate, losses and strengths as they are; returns what was before.
    fn go_on_from(
        &mut self,
        now: &Estimate,
        image_loss: Loss,
    ) -> Result<(Minimiser, Model, Values), TooLarge> {
        let (options, selection) = (self.options.network(), self.excluded.selection());
        for (known, now) in self.known_points.iter_mut().zip(&now.vehicles) {
            known.iter_mut().zip(&now.points).for_each(|(known, now)| *known = now.or(*known));
        }
        let taken = self.excluded.without_points_left_out(self.problem, now);
        let mut model = anchored(self.problem, self.start, &taken, options, &selection);
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
