//! Levenberg-Marquardt, as a solver of `argmin`.
//!
//! One iteration is one attempt at a step:
//!
//! ```text
//! linearise, unless the last attempt was rejected
//! solve  (H + lambda diag H) step = -g
//! gain = (cost - cost at the trial) / (decrease that the quadratic model predicts)
//! gain > 0: move, damp less      otherwise: stay, damp more
//! ```
//!
//! A step is judged by the true robust cost. The damping follows Nielsen, *Damping parameter in
//! Marquardt's method*, IMM-REP-1999-05.

use super::linear::cholesky::{Singular, TooLarge};
use super::system::{Accuracy, Cost, Curvature, Factors, Normal, Step, System, Values};
use argmin::core::{Error, Executor, KV, Problem, Solver, State, TerminationReason, TerminationStatus};
use std::collections::HashMap;
use std::fmt;
use std::time::{Duration, Instant};

/// When to stop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MinimiserOptions {
    /// The most attempts at a step.
    pub max_iterations: usize,
    /// Stop when a step that is hardly damped lowers the cost by less than this share of it.
    pub relative_decrease: f64,
    /// Damping at the start.
    pub first_damping: f64,
    /// Damping up to which a step is hardly damped.
    pub hardly_damped: f64,
    /// The least that the damping is multiplied by at an accepted step.
    pub shrink: f64,
    /// What it is multiplied by at a first rejection; twice that at the next one, and so on.
    pub growth: f64,
    /// How flat the model of a robust loss may become along residuals ([`Curvature`]): as flat as the
    /// steps prove to be better than predicted.
    pub least_flatness: f64,
}

impl Default for MinimiserOptions {
    fn default() -> Self {
        MinimiserOptions {
            max_iterations: 50,
            relative_decrease: 1e-8,
            first_damping: FIRST_DAMPING,
            hardly_damped: HARDLY_DAMPED,
            shrink: 0.1,
            growth: 10.0,
            least_flatness: 1.0,
        }
    }
}

/// Damping at the start. A body's frame, and often its scale, are held so weakly that more would
/// keep them from their place for many iterations; a start that needs more gets it by rejections.
const FIRST_DAMPING: f64 = 1e-9;
/// A weakly held direction, such as the scale, has moved to its place only when the damping is well
/// below its share of the curvature; a small decrease says nothing before.
const HARDLY_DAMPED: f64 = 1e-7;
/// A step is judged by the true cost and followed by another one, which makes good what it lacks; that
/// costs less than to solve exactly where the model is not. Of the decrease it lacks the square of this share.
const STEP_ACCURACY: Accuracy = Accuracy::Share(1e-2);
/// Damping beyond which no step is left.
const MOST_DAMPING: f64 = 1e16;
/// Damping below which it makes no difference.
const LEAST_DAMPING: f64 = 1e-14;
/// A gain above which the cost is flatter than its model, and one below which it is not.
const STEEPER: f64 = 1.25;
const SHALLOWER: f64 = 0.75;
/// A gain from which a longer step is tried, and how often it is doubled at the most.
const LONGER: f64 = 1.4;
const MOST_DOUBLINGS: usize = 8;
/// The shortest share of a step that is tried before the step is damped.
const LEAST_SHARE: f64 = 0.2;
/// A step that promises less than this share of the cost and does not keep it is the last: the cost may
/// jump by more, where the slope of a terrain grid does.
const NO_GAIN: f64 = 1e-7;
/// Changes of the cost below this share of it are rounding.
const ROUNDING: f64 = 1e-13;

/// What is asked at the limit of iterations: by what so many of the last ones lowered the cost ...
pub const LAST_ITERATIONS: usize = 10;
/// ... and whether that, as a share of the cost, is worth more of them.
const STILL_GAINS: f64 = 1e-6;

/// By what the last iterations lowered the cost, as a share of it.
fn last_decrease(records: &[IterationRecord]) -> f64 {
    let (Some(last), Some(before)) =
        (records.last(), records.get(records.len().saturating_sub(1 + LAST_ITERATIONS)))
    else {
        return 0.0;
    };
    (before.cost - last.cost) / last.cost.max(f64::MIN_POSITIVE)
}

/// Why the minimiser stopped, with what it measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Stop {
    /// A step that was hardly damped no longer lowered the cost.
    SmallDecrease {
        /// Decrease as a share of the cost.
        relative: f64,
        /// What it was held against.
        limit: f64,
    },
    /// The predicted decrease is below rounding, or nearly so and does not come: no step can be told from
    /// none.
    AtRounding {
        /// Predicted decrease as a share of the cost.
        relative: f64,
        /// What it was held against.
        limit: f64,
    },
    /// Nothing is left to adjust, or the gradient is exactly zero.
    ZeroGradient,
    /// The limit of iterations was reached.
    Iterations {
        /// The limit.
        limit: usize,
        /// By what the last iterations, [`LAST_ITERATIONS`] at the most, lowered the cost, as a share of it.
        decrease: f64,
    },
    /// However strongly damped, no step lowers the cost.
    Stalled {
        /// The damping that was reached.
        damping: f64,
    },
}

impl Stop {
    /// Whether the estimate is a minimum of the cost.
    pub fn converged(&self) -> bool {
        !matches!(self, Stop::Iterations { .. } | Stop::Stalled { .. })
    }

    /// One word for a report.
    pub fn status(&self) -> &'static str {
        match self {
            Stop::Iterations { .. } => "iteration_limit",
            Stop::Stalled { .. } => "stalled",
            _ => "converged",
        }
    }
}

impl fmt::Display for Stop {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Stop::SmallDecrease { relative, limit } => {
                write!(f, "relative decrease {relative:.2e} < {limit:.0e}")
            }
            Stop::AtRounding { relative, limit } => {
                write!(f, "predicted relative decrease {relative:.2e} < {limit:.0e}")
            }
            Stop::ZeroGradient => f.write_str("the gradient is zero"),
            Stop::Iterations { limit, decrease } => {
                write!(
                    f,
                    "iteration limit {limit}; the last iterations lowered the cost by {decrease:.1e} of it: "
                )?;
                f.write_str(if *decrease > STILL_GAINS {
                    "more would gain"
                } else {
                    "more would hardly gain"
                })
            }
            Stop::Stalled { damping } => write!(f, "no step lowers the cost, damping {damping:.1e}"),
        }
    }
}

/// One attempt at a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct IterationRecord {
    /// 0 is the start.
    pub iteration: usize,
    /// Cost after it.
    pub cost: f64,
    /// By how much it lowered the cost; for a rejected step, what it would have been.
    pub change: f64,
    /// Largest entry of the gradient.
    pub gradient: f64,
    /// Length of the step, each unknown in units of its own curvature: `sqrt(step^T diag(H) step)`.
    pub step: f64,
    /// Decrease over predicted decrease.
    pub gain: f64,
    /// The damping of this step.
    pub damping: f64,
    /// Whether the step was taken.
    pub accepted: bool,
    /// Wall time of the iteration \[s\].
    pub seconds: f64,
}

/// What the minimiser found.
pub struct Minimum {
    /// The best values.
    pub values: Values,
    /// Their cost.
    pub cost: Cost,
    /// Why it stopped.
    pub stop: Stop,
    /// Every attempt, the start first.
    pub records: Vec<IterationRecord>,
}

/// Wall time of the stages of all iterations \[s\].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StageSeconds {
    /// Jacobians, normal equations, elimination of the blocks that are eliminated first.
    pub linearise: f64,
    /// Factorisation and solution of what is left.
    pub factorise: f64,
    /// Steps of the blocks that are eliminated first.
    pub substitute: f64,
    /// Costs.
    pub cost: f64,
}

/// Where the minimiser reports each iteration, with the values after it. (Observers of `argmin` would have to
/// outlive everything that they look at.)
pub type Watch<'a> = &'a mut dyn FnMut(&IterationRecord, &Values);

/// The minimiser of one system, with its workspace: the symbolic factorisation is made once, and the
/// last factors stay for those who want variances.
///
/// ```
/// # use trackbundle_solver::nalgebra::Vector1;
/// # use trackbundle_solver::{Covariance, Jacobian, Loss, Manifold, Measurement, Minimiser, MinimiserOptions};
/// # use trackbundle_solver::{Residual, SystemBuilder};
/// # struct Reading(f64);
/// # impl Residual<1, 1> for Reading {
/// #     const MANIFOLDS: [Manifold; 1] = [Manifold::SCALAR];
/// #     fn evaluate(&self, x: &[&[f64]; 1], jacobian: Option<&mut Jacobian<1, 1>>) -> Option<Vector1<f64>> {
/// #         if let Some(jacobian) = jacobian {
/// #             jacobian.set(0, 0, &Vector1::new(1.0));
/// #         }
/// #         Some(Vector1::new(x[0][0] - self.0))
/// #     }
/// # }
/// # let mut builder = SystemBuilder::default();
/// # let level = builder.add_block(Manifold::SCALAR, &[0.0], &[true]);
/// # let readings = [1.0, 2.0, 6.0].map(|read| Measurement { residual: Reading(read), blocks: [level], sigma: [0.3] });
/// # builder.add_group("readings", Loss::Squared, readings.into());
/// # let system = builder.build();
/// let mut costs = Vec::new();
/// let mut watch = |record: &trackbundle_solver::IterationRecord, _: &_| costs.push(record.cost);
/// let options = MinimiserOptions { max_iterations: 20, ..MinimiserOptions::default() };
/// let minimum = Minimiser::new(&system)?.run(&system, system.start(), options, Some(&mut watch));
/// assert!(minimum.stop.converged(), "{}", minimum.stop);
/// assert_eq!(costs.len(), minimum.records.len());
/// assert!(minimum.cost.value < costs[0]);
/// # Ok::<(), trackbundle_solver::TooLarge>(())
/// ```
pub struct Minimiser {
    options: MinimiserOptions,
    normal: Normal,
    factors: Factors,
    damping: f64,
    least_flatness: f64,
    /// By what the damping is multiplied at the next rejection.
    growth: f64,
    /// The curvature with which `normal` was formed at the current values, if it was.
    linearised: Option<Curvature>,
    /// The damping of the last factorisation.
    factor_damping: f64,
    stages: StageSeconds,
}

impl Minimiser {
    /// A minimiser of `system`.
    pub fn new(system: &System) -> Result<Self, TooLarge> {
        let normal = system.normal();
        let factors = Factors::new(system)?;
        Ok(Minimiser {
            options: MinimiserOptions::default(),
            normal,
            factors,
            damping: FIRST_DAMPING,
            least_flatness: 1.0,
            growth: 1.0,
            linearised: None,
            factor_damping: f64::INFINITY,
            stages: StageSeconds::default(),
        })
    }

    /// Wall time of the stages of all iterations of all runs.
    pub fn stage_seconds(&self) -> StageSeconds {
        self.stages
    }

    /// Minimises the cost of `system` from `start`.
    pub fn run(
        &mut self,
        system: &System,
        start: &Values,
        options: MinimiserOptions,
        watch: Option<Watch<'_>>,
    ) -> Minimum {
        self.options = options;
        self.damping = options.first_damping;
        self.least_flatness = 1.0;
        self.growth = self.options.growth;
        self.linearised = None;
        let executor = Executor::new(system, Watched { minimiser: self, watch })
            .configure(|state: LmState| state.start_at(start.clone(), options.max_iterations))
            .ctrlc(false);
        let state = executor.run().expect("the solver returns no error").state;
        Minimum {
            values: state.values.expect("set at the start"),
            cost: state.cost,
            stop: state.stop.unwrap_or_else(|| Stop::Iterations {
                limit: options.max_iterations,
                decrease: last_decrease(&state.records),
            }),
            records: state.records,
        }
    }

    /// The linearisation at the last values that a step was made from, and the factor of its normal
    /// matrix. Nothing but a step that was hardly damped lies between them and the minimum.
    pub fn factors(&mut self, system: &System, values: &Values) -> Result<(&Normal, &mut Factors), Singular> {
        if self.factor_damping > HARDLY_DAMPED {
            system.linearise(values, Curvature::PLAIN, &mut self.normal).ok_or(Singular)?;
            self.linearised = Some(Curvature::PLAIN);
            let undamped = vec![0.0; system.size()];
            self.factors.factorise(system, &mut self.normal, &undamped)?;
            self.factor_damping = 0.0;
        }
        self.factors.complete(system, &self.normal)?;
        Ok((&self.normal, &mut self.factors))
    }

    /// Linearises at `values`, unless that is done; `None` where the system cannot be solved.
    fn linearise(&mut self, system: &System, values: &Values) -> Option<()> {
        let wanted = self.curvature();
        let is_done = |found: Curvature| {
            found.least_flatness == wanted.least_flatness
                && (found.damping == wanted.damping || !system.has_eliminated_blocks())
        };
        if !self.linearised.is_some_and(is_done) {
            self.linearised = None;
            let begin = Instant::now();
            let done = system.linearise(values, wanted, &mut self.normal);
            self.stages.linearise += begin.elapsed().as_secs_f64();
            done?;
            self.linearised = Some(wanted);
        }
        Some(())
    }

    /// The damped step; `None` where the system cannot be solved.
    fn step(&mut self, system: &System, values: &Values) -> Option<Step> {
        let begin = Instant::now();
        let extra: Vec<f64> = self.normal.scale().iter().map(|d| d * self.damping).collect();
        self.factor_damping = f64::INFINITY;
        if system.has_eliminated_blocks() {
            // Formed for this damping alone.
            self.linearised = None;
        }
        let gradient =
            if system.is_along_time() { self.normal.raw_gradient() } else { self.normal.gradient.as_slice() };
        let mut others: Vec<f64> = gradient.iter().map(|g| -g).collect();
        self.factors.step(system, &mut self.normal, &extra, STEP_ACCURACY, &mut others).ok()?;
        self.factor_damping = self.damping;
        self.stages.factorise += begin.elapsed().as_secs_f64();
        let begin = Instant::now();
        let step = system.back_substitute(values, self.curvature(), &mut self.normal, others);
        self.stages.substitute += begin.elapsed().as_secs_f64();
        step.delta.iter().all(|s| s.is_finite()).then_some(step)
    }

    fn curvature(&self) -> Curvature {
        Curvature { damping: self.damping, least_flatness: self.least_flatness }
    }

    fn reject(&mut self) {
        self.damping *= self.growth;
        self.growth *= 2.0;
        self.least_flatness = (4.0 * self.least_flatness).min(1.0);
    }

    fn accept(&mut self, gain: f64) {
        let factor = (1.0 - (2.0 * gain - 1.0).powi(3)).clamp(self.options.shrink, 2.0);
        self.damping = (self.damping * factor).max(LEAST_DAMPING);
        self.growth = self.options.growth;
        if gain > STEEPER {
            self.least_flatness = (0.5 * self.least_flatness).max(self.options.least_flatness);
        } else if gain < SHALLOWER {
            self.least_flatness = (2.0 * self.least_flatness).min(1.0);
        }
        self.linearised = None;
    }

    /// Doubles a step that lowers the cost by much more than predicted, as long as that lowers it further:
    /// the cost is nearly straight along it, and a step of the model's length would creep.
    fn lengthen(
        &self,
        system: &System,
        values: &Values,
        delta: &[f64],
        mut best: (Values, Cost),
    ) -> (Values, Cost) {
        let mut longer = delta.to_vec();
        for _ in 0..MOST_DOUBLINGS {
            longer.iter_mut().for_each(|d| *d *= 2.0);
            let trial = system.plus(values, &longer);
            let cost = system.cost(&trial);
            if cost.value < best.1.value {
                best = (trial, cost);
            } else {
                break;
            }
        }
        best
    }

    /// Tries the least cost of the parabola through what is known along a step that lowers the cost by less
    /// than predicted: where the model lacks half the curvature, whole steps swing from side to side.
    fn shorten(
        &self,
        system: &System,
        values: &Values,
        delta: &[f64],
        gain: f64,
        whole: (Values, Cost),
    ) -> (Values, Cost) {
        let share = 1.0 / (2.0 - gain);
        // Much shorter, a damped step is the better one.
        if !(LEAST_SHARE..1.0).contains(&share) {
            return whole;
        }
        let shorter: Vec<f64> = delta.iter().map(|d| d * share).collect();
        let trial = system.plus(values, &shorter);
        let cost = system.cost(&trial);
        if cost.value < whole.1.value { (trial, cost) } else { whole }
    }

    /// One attempt: the record of it, and the reason to stop after it, if there is one.
    fn attempt(&mut self, system: &System, state: &mut LmState) -> (IterationRecord, Option<Stop>) {
        let values = state.values.as_ref().expect("set at the start");
        let is_linear = self.linearise(system, values).is_some();
        let gradient = self.normal.largest_gradient();
        let mut record = IterationRecord {
            iteration: state.iteration as usize + 1,
            cost: state.cost.value,
            gradient,
            damping: self.damping,
            ..Default::default()
        };
        if is_linear && gradient == 0.0 {
            return (record, Some(Stop::ZeroGradient));
        }
        let stalled = (self.damping > MOST_DAMPING).then_some(Stop::Stalled { damping: self.damping });
        let Some(step) = is_linear.then(|| self.step(system, values)).flatten() else {
            self.reject();
            return (record, stalled);
        };
        // Of the undamped model, for the damped step: -g s - s H s / 2 = (lambda s D s - g s) / 2.
        let predicted = 0.5 * (self.damping * step.squared - step.slope);
        record.step = step.squared.sqrt();
        let begin = Instant::now();
        let mut trial = system.plus(values, &step.delta);
        let mut trial_cost = system.cost(&trial);
        record.change = state.cost.value - trial_cost.value;
        record.gain = record.change / predicted;
        if record.gain > LONGER {
            (trial, trial_cost) = self.lengthen(system, values, &step.delta, (trial, trial_cost));
            record.change = state.cost.value - trial_cost.value;
        } else if record.gain < SHALLOWER {
            (trial, trial_cost) = self.shorten(system, values, &step.delta, record.gain, (trial, trial_cost));
            record.change = state.cost.value - trial_cost.value;
            record.gain = record.gain.max(record.change / predicted);
        }
        self.stages.cost += begin.elapsed().as_secs_f64();
        let rounding = ROUNDING * state.cost.value;
        if record.change > 0.0 && record.gain > 1e-3 {
            record.accepted = true;
            record.cost = trial_cost.value;
            let relative = record.change / state.cost.value;
            let limit = self.options.relative_decrease;
            let hardly_damped = self.damping <= self.options.hardly_damped;
            state.values = Some(trial);
            state.cost = trial_cost;
            self.accept(record.gain);
            let stop = (hardly_damped && relative < limit).then_some(Stop::SmallDecrease { relative, limit });
            (record, stop)
        } else if predicted <= rounding {
            let relative = predicted / state.cost.value.max(f64::MIN_POSITIVE);
            (record, Some(Stop::AtRounding { relative, limit: ROUNDING }))
        } else if self.damping <= self.options.hardly_damped && predicted < NO_GAIN * state.cost.value {
            let relative = predicted / state.cost.value;
            (record, Some(Stop::AtRounding { relative, limit: NO_GAIN }))
        } else {
            self.reject();
            (record, stalled)
        }
    }
}

/// A minimiser at work.
struct Watched<'m, 'w> {
    minimiser: &'m mut Minimiser,
    watch: Option<Watch<'w>>,
}

impl Watched<'_, '_> {
    fn record(&mut self, state: &mut LmState, record: IterationRecord) {
        if let (Some(watch), Some(values)) = (&mut self.watch, &state.values) {
            watch(&record, values);
        }
        state.records.push(record);
    }
}

impl Solver<&System, LmState> for Watched<'_, '_> {
    fn name(&self) -> &str {
        "Levenberg-Marquardt"
    }

    fn init(
        &mut self,
        problem: &mut Problem<&System>,
        mut state: LmState,
    ) -> Result<(LmState, Option<KV>), Error> {
        let begin = Instant::now();
        state.cost = problem.problem("cost_count", |system| {
            Ok(system.cost(state.values.as_ref().expect("set at the start")))
        })?;
        let record = IterationRecord {
            cost: state.cost.value,
            damping: self.minimiser.damping,
            accepted: true,
            seconds: begin.elapsed().as_secs_f64(),
            ..Default::default()
        };
        self.record(&mut state, record);
        Ok((state, None))
    }

    fn next_iter(
        &mut self,
        problem: &mut Problem<&System>,
        mut state: LmState,
    ) -> Result<(LmState, Option<KV>), Error> {
        let begin = Instant::now();
        let (mut record, stop) = problem.problem("step_count", |system| {
            // On the threads of the pool as a whole: waking them for each stage takes its time.
            Ok(rayon::scope(|_| self.minimiser.attempt(system, &mut state)))
        })?;
        record.seconds = begin.elapsed().as_secs_f64();
        self.record(&mut state, record);
        if let Some(stop) = stop {
            state.stop = Some(stop);
            state = state.terminate_with(match stop {
                Stop::SmallDecrease { .. } | Stop::AtRounding { .. } | Stop::ZeroGradient => {
                    TerminationReason::SolverConverged
                }
                other => TerminationReason::SolverExit(other.to_string()),
            });
        }
        Ok((state, None))
    }
}

/// The state of the minimiser as `argmin` sees it.
#[derive(Clone, Default)]
pub struct LmState {
    values: Option<Values>,
    cost: Cost,
    iteration: u64,
    max_iterations: u64,
    records: Vec<IterationRecord>,
    stop: Option<Stop>,
    status: TerminationStatus,
    counts: HashMap<String, u64>,
    time: Option<Duration>,
}

impl LmState {
    fn start_at(mut self, values: Values, max_iterations: usize) -> Self {
        self.values = Some(values);
        self.max_iterations = max_iterations as u64;
        self
    }
}

impl State for LmState {
    type Param = Values;
    type Float = f64;

    fn new() -> Self {
        LmState::default()
    }
    // Only better values are ever taken, so the current ones are the best.
    fn update(&mut self) {}
    fn get_param(&self) -> Option<&Values> {
        self.values.as_ref()
    }
    fn get_best_param(&self) -> Option<&Values> {
        self.values.as_ref()
    }
    fn get_max_iters(&self) -> u64 {
        self.max_iterations
    }
    fn increment_iter(&mut self) {
        self.iteration += 1;
    }
    fn get_iter(&self) -> u64 {
        self.iteration
    }
    fn get_cost(&self) -> f64 {
        self.cost.value
    }
    fn get_best_cost(&self) -> f64 {
        self.cost.value
    }
    fn get_target_cost(&self) -> f64 {
        f64::NEG_INFINITY
    }
    fn func_counts<O>(&mut self, problem: &Problem<O>) {
        self.counts = problem.counts.iter().map(|(k, v)| (k.to_string(), *v)).collect();
    }
    fn get_func_counts(&self) -> &HashMap<String, u64> {
        &self.counts
    }
    fn time(&mut self, time: Option<Duration>) -> &mut Self {
        self.time = time;
        self
    }
    fn get_time(&self) -> Option<Duration> {
        self.time
    }
    fn get_last_best_iter(&self) -> u64 {
        self.iteration
    }
    fn is_best(&self) -> bool {
        true
    }
    fn terminate_with(mut self, reason: TerminationReason) -> Self {
        self.status = TerminationStatus::Terminated(reason);
        self
    }
    fn get_termination_status(&self) -> &TerminationStatus {
        &self.status
    }
    fn get_termination_reason(&self) -> Option<&TerminationReason> {
        match &self.status {
            TerminationStatus::Terminated(reason) => Some(reason),
            TerminationStatus::NotTerminated => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::loss::Loss;
    use crate::manifold::Manifold;
    use crate::residual::{Jacobian, Residual};
    use crate::system::{BlockId, Measurement, SystemBuilder};
    use nalgebra::{Matrix2, Vector1, Vector2};

    /// Rosenbrock's valley as a sum of squares: `(10 (y - x^2), 1 - x)`.
    struct Valley;

    impl Residual<2, 1> for Valley {
        const MANIFOLDS: [Manifold; 1] = [Manifold::Vector(2)];
        fn evaluate(&self, x: &[&[f64]; 1], jacobian: Option<&mut Jacobian<2, 1>>) -> Option<Vector2<f64>> {
            let [x, y] = [x[0][0], x[0][1]];
            if let Some(jacobian) = jacobian {
                jacobian.set(0, 0, &Matrix2::new(-20.0 * x, 10.0, -1.0, 0.0));
            }
            Some(Vector2::new(10.0 * (y - x * x), 1.0 - x))
        }
    }

    /// A number that was measured; impossible where the unknown is not positive.
    struct Measured(f64);

    impl Residual<1, 1> for Measured {
        const MANIFOLDS: [Manifold; 1] = [Manifold::SCALAR];
        fn evaluate(&self, x: &[&[f64]; 1], jacobian: Option<&mut Jacobian<1, 1>>) -> Option<Vector1<f64>> {
            if let Some(jacobian) = jacobian {
                jacobian.set(0, 0, &Vector1::new(1.0));
            }
            (x[0][0] > 0.0).then(|| Vector1::new(x[0][0] - self.0))
        }
    }

    fn valley() -> System {
        let mut builder = SystemBuilder::default();
        let block = builder.add_block(Manifold::Vector(2), &[-1.2, 1.0], &[true, true]);
        builder.add_group(
            "valley",
            Loss::Squared,
            vec![Measurement { residual: Valley, blocks: [block], sigma: [1.0; 2] }],
        );
        builder.build()
    }

    fn measured(start: f64, loss: Loss, values: &[f64]) -> (System, BlockId) {
        let mut builder = SystemBuilder::default();
        let block = builder.add_block(Manifold::SCALAR, &[start], &[true]);
        let items =
            values.iter().map(|v| Measurement { residual: Measured(*v), blocks: [block], sigma: [1.0] });
        builder.add_group("measured", loss, items.collect());
        (builder.build(), block)
    }

    fn run(system: &System, options: MinimiserOptions) -> Minimum {
        Minimiser::new(system).unwrap().run(system, system.start(), options, None)
    }

    #[test]
    fn a_curved_valley_is_followed_to_its_end() {
        let system = valley();
        let minimum = run(&system, MinimiserOptions::default());
        assert!(minimum.stop.converged(), "{}", minimum.stop);
        assert!(minimum.cost.value < 1e-20, "{:?}", minimum.cost);
        assert!(minimum.records.len() < 60, "{}", minimum.records.len());
    }

    #[test]
    fn the_cost_never_rises_and_the_records_say_so() {
        let mut seen = Vec::new();
        let system = valley();
        let mut watch = |record: &IterationRecord, values: &Values| {
            assert_eq!(system.cost(values).value, record.cost, "the values are those after the iteration");
            seen.push(*record);
        };
        let minimum = Minimiser::new(&system).unwrap().run(
            &system,
            system.start(),
            MinimiserOptions::default(),
            Some(&mut watch),
        );
        assert_eq!(seen, minimum.records, "the observer sees every iteration");
        for (before, after) in minimum.records.iter().zip(&minimum.records[1..]) {
            assert_eq!(after.iteration, before.iteration + 1);
            assert!(if after.accepted { after.cost < before.cost } else { after.cost == before.cost });
        }
        assert!(minimum.records.iter().any(|r| !r.accepted), "this valley rejects steps");
    }

    #[test]
    fn a_limit_of_iterations_is_a_reason() {
        let minimum = run(&valley(), MinimiserOptions { max_iterations: 2, ..Default::default() });
        // Both steps are rejected in this valley.
        assert_eq!(minimum.stop, Stop::Iterations { limit: 2, decrease: 0.0 });
        assert!(!minimum.stop.converged());
        assert_eq!(minimum.records.len(), 3);
        for max_iterations in 14..19 {
            let longer = run(&valley(), MinimiserOptions { max_iterations, ..Default::default() });
            let Stop::Iterations { decrease, .. } = longer.stop else { panic!("{:?}", longer.stop) };
            let costs: Vec<f64> = longer.records.iter().map(|record| record.cost).collect();
            let [before, last] = [costs[max_iterations - 10], costs[max_iterations]];
            assert_eq!(decrease, (before - last) / last);
            assert!(decrease > 0.0 && longer.stop.to_string().ends_with("more would gain"), "{costs:?}");
        }
        let at_the_end = Stop::Iterations { limit: 13, decrease: 1e-9 };
        assert!(at_the_end.to_string().ends_with("more would hardly gain"));
        let none = run(&valley(), MinimiserOptions { max_iterations: 0, ..Default::default() });
        assert_eq!(none.values, *valley().start());
    }

    #[test]
    fn a_mean_is_found_and_a_robust_mean_ignores_gross_errors() {
        let values = [2.0, 2.5, 3.0, 1.5, 100.0];
        let (system, block) = measured(2.2, Loss::Squared, &values);
        let minimum = run(&system, MinimiserOptions::default());
        assert!((system.value(&minimum.values, block)[0] - 21.8).abs() < 1e-6);
        let (system, block) = measured(2.2, Loss::Tukey { scale: 5.0 }, &values);
        let minimum = run(&system, MinimiserOptions { relative_decrease: 1e-14, ..Default::default() });
        assert!((system.value(&minimum.values, block)[0] - 2.25).abs() < 1e-4);
    }

    #[test]
    fn a_step_into_the_impossible_is_not_taken() {
        // Least squares alone would go to -5, where the residual has no value.
        let (system, block) = measured(3.0, Loss::Squared, &[-5.0]);
        let minimum = run(&system, MinimiserOptions::default());
        assert_eq!(minimum.cost.impossible, 0);
        assert!(system.value(&minimum.values, block)[0] > 0.0);
        assert!(minimum.cost.value < 32.0, "it went as far as it could: {:?}", minimum.cost);
    }

    #[test]
    fn a_start_in_the_impossible_stays_and_is_told() {
        let (system, _) = measured(-3.0, Loss::Squared, &[1.0, 2.0]);
        let minimum = run(&system, MinimiserOptions::default());
        assert_eq!(minimum.cost.impossible, 2);
        assert_eq!(minimum.stop, Stop::ZeroGradient);
    }

    #[test]
    fn nothing_to_adjust_is_no_error() {
        let system = SystemBuilder::default().build();
        assert_eq!(run(&system, MinimiserOptions::default()).stop, Stop::ZeroGradient);
    }

    #[test]
    fn the_factors_at_the_end_are_those_of_the_minimum() {
        let system = valley();
        let mut minimiser = Minimiser::new(&system).unwrap();
        let minimum = minimiser.run(&system, system.start(), MinimiserOptions::default(), None);
        let (normal, factors) = minimiser.factors(&system, &minimum.values).unwrap();
        // H at (1, 1) is J^T J with J = [-20 10; -1 0].
        let mut right = [401.0_f64, -200.0];
        factors.solve(&system, normal, Accuracy::Exact, &mut right);
        assert!((right[0] - 1.0).abs() < 1e-4 && right[1].abs() < 1e-4, "{right:?}");
    }
}
