//! The motion of a vehicle as a cone program: smooth, bounded, and near to what was seen.
//!
//! For positions `x_f` (or, with one coordinate, headings) at the times `t_f`, `h_f = t_f+1 - t_f`,
//!
//! ```text
//! minimise    sum over data  |w_f|^2 / 2 + k u_f  +  sum h |a_f|^2 / (2 q^2)  +  k/s (n sum b_f + n^2 sum c_f)
//! subject to  |(x_f - d_f) / s_f - w_f| <= u_f                          Huber's loss of a datum
//!             |x_f+1 - x_f| <= h_f v_max + b_f,  b_f >= 0               speed, or rate of turn
//!             |a_f| h^2     <= h^2 a_max + c_f,  c_f >= 0               acceleration
//! ```
//!
//! with `a_f` the second divided difference and all norms second-order cones. What is given up of a
//! bound (`b`, `c`) costs its size, not its square: an exact penalty, with which a bound holds to the
//! last bit unless the data pull at it harder than the price. The price is set so that outliers of up
//! to `n` frames in a row are overruled; where more than that demand it, the bound gives way, and which
//! one, when and by how much is reported. Frames without a datum lie where the motion is smoothest.

use crate::initialise::shape::robust_dlt::Triplets;
use crate::rules::rules;
use crate::stats::quantile::upper_median;
use clarabel::algebra::CscMatrix;
use clarabel::solver::{
    DefaultSettingsBuilder, DefaultSolver, IPSolver, NonnegativeConeT, SecondOrderConeT, SolverStatus,
    SupportedConeT,
};

rules! {
    /// Motion of a vehicle as a cone program.
    pub struct MotionRules {
        /// Where a residual turns linear.
        huber_sigmas: f64 = 1.5, "standard deviations";
        /// Data that disagree with a bound for longer make it give way.
        patience_s: f64 = 0.2, "s";
        /// A bound that is exceeded by less is held.
        held_within_share: f64 = 0.02, "share of the bound";
    }
}

const RULES: MotionRules = MotionRules::DEFAULT;

/// A bound on a motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Bound {
    /// On the first difference.
    Rate,
    /// On the second difference.
    Acceleration,
}

/// A bound that the data do not keep to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Excess {
    /// Which.
    pub bound: Bound,
    /// First and last time \[s\].
    pub time_s: [f64; 2],
    /// The largest value.
    pub reached: f64,
}

/// What is known of a motion beforehand, in its own unit (m or rad).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Largest first derivative \[1/s\].
    pub rate: f64,
    /// Largest second derivative \[1/s^2\], if it is bounded.
    pub acceleration: Option<f64>,
    /// Scatter of the mean second derivative over one second \[1/s^2\].
    pub scatter: f64,
}

/// A datum: `D` coordinates and their common standard deviation.
pub type Datum<const D: usize> = ([f64; D], f64);

/// A motion that was found.
#[derive(Clone, Debug, PartialEq)]
pub struct Motion<const D: usize> {
    /// The coordinates at each time.
    pub values: Vec<[f64; D]>,
    /// Bounds that gave way, in the order of time.
    pub excesses: Vec<Excess>,
}

/// Why there is no motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoMotion {
    /// No time has a datum.
    NoData,
    /// The solver stopped early.
    NotSolved,
}

/// Fits a motion. `times_s` increase; `data` has one entry a time.
pub fn fit<const D: usize>(
    times_s: &[f64],
    data: &[Option<Datum<D>>],
    limits: &Limits,
) -> Result<Motion<D>, NoMotion> {
    let count = times_s.len();
    let given: Vec<(usize, Datum<D>)> =
        data.iter().enumerate().filter_map(|(at, datum)| Some((at, (*datum)?))).collect();
    let Some((_, (first, _))) = given.first() else { return Err(NoMotion::NoData) };
    if count == 1 || given.len() == 1 {
        return Ok(Motion { values: vec![*first; count], excesses: Vec::new() });
    }
    let program = Program::new(times_s, &given, limits);
    let values = program.solved().ok_or(NoMotion::NotSolved)?;
    let excesses = excesses(times_s, &values, limits);
    Ok(Motion { values, excesses })
}

/// The program of a motion. Its unknowns are, in this order, `x`, `w`, `u`, `b` and `c`.
struct Program<'a, const D: usize> {
    given: &'a [(usize, Datum<D>)],
    limits: &'a Limits,
    /// Times between neighbours \[s\].
    steps: Vec<f64>,
    typical_step_s: f64,
    typical_sigma: f64,
    /// What coordinates are counted from.
    middle: [f64; D],
    /// Lengths are counted in this unit, in which steps and standard deviations are of the order of 1.
    unit: f64,
}

/// Rows of the program, and the cones that they lie in.
#[derive(Default)]
struct Cones {
    rows: Triplets,
    right: Vec<f64>,
    cones: Vec<SupportedConeT<f64>>,
}

impl Cones {
    fn row(&mut self, right: f64) -> usize {
        self.right.push(right);
        self.rows.next_row()
    }
}

impl<'a, const D: usize> Program<'a, D> {
    /// Of two times and two data, at least.
    fn new(times_s: &[f64], given: &'a [(usize, Datum<D>)], limits: &'a Limits) -> Self {
        let typical = |values: Vec<f64>| upper_median(values).unwrap_or(0.0);
        let typical_sigma = typical(given.iter().map(|(_, (_, sigma))| *sigma).collect());
        let steps: Vec<f64> = times_s.windows(2).map(|t| t[1] - t[0]).collect();
        Program {
            given,
            limits,
            typical_step_s: typical(steps.clone()),
            steps: steps.into_iter().map(|h| h.max(1e-6)).collect(),
            typical_sigma,
            middle: std::array::from_fn(|axis| {
                typical(given.iter().map(|(_, (value, _))| value[axis]).collect())
            }),
            unit: 10.0 * typical_sigma,
        }
    }

    fn times(&self) -> usize {
        self.steps.len() + 1
    }

    fn bends(&self) -> usize {
        self.steps.len() - 1
    }

    /// Second differences that are bounded.
    fn bounded_bends(&self) -> usize {
        if self.limits.acceleration.is_some() { self.bends() } else { 0 }
    }

    fn x(&self, at: usize, axis: usize) -> usize {
        at * D + axis
    }

    fn w(&self, datum: usize, axis: usize) -> usize {
        self.times() * D + datum * D + axis
    }

    fn u(&self, datum: usize) -> usize {
        self.times() * D + self.given.len() * D + datum
    }

    fn b(&self, step: usize) -> usize {
        self.times() * D + self.given.len() * (D + 1) + step
    }

    fn c(&self, bend: usize) -> usize {
        self.b(self.steps.len()) + bend
    }

    fn unknowns(&self) -> usize {
        self.c(0) + self.bounded_bends()
    }

    /// The second divided difference by the values before, at and after, times the step squared, and the step.
    fn bend(&self, at: usize) -> ([f64; 3], f64) {
        let (before, after) = (self.steps[at], self.steps[at + 1]);
        let h = (before + after) / 2.0;
        ([h / before, -h / before - h / after, h / after], h)
    }

    /// What is given up of a bound is not negative.
    fn add_given_up(&self, all: &mut Cones) {
        for slack in self.b(0)..self.unknowns() {
            let row = all.row(0.0);
            all.rows.add(row, slack, -1.0);
        }
        all.cones.push(NonnegativeConeT(self.unknowns() - self.b(0)));
    }

    /// `(u, (x - d) / s - w)` of each datum.
    fn add_data(&self, all: &mut Cones) {
        for (datum, (at, (value, sigma))) in self.given.iter().enumerate() {
            let row = all.row(0.0);
            all.rows.add(row, self.u(datum), -1.0);
            for axis in 0..D {
                let row = all.row(-(value[axis] - self.middle[axis]) / sigma);
                all.rows.add(row, self.x(*at, axis), -self.unit / sigma);
                all.rows.add(row, self.w(datum, axis), 1.0);
            }
            all.cones.push(SecondOrderConeT(D + 1));
        }
    }

    /// The bound of each first difference.
    fn add_rates(&self, all: &mut Cones) {
        for (step, h) in self.steps.iter().enumerate() {
            let row = all.row(self.limits.rate * h / self.unit);
            all.rows.add(row, self.b(step), -1.0);
            for axis in 0..D {
                let row = all.row(0.0);
                all.rows.add(row, self.x(step + 1, axis), -1.0);
                all.rows.add(row, self.x(step, axis), 1.0);
            }
            all.cones.push(SecondOrderConeT(D + 1));
        }
    }

    /// The bound of each second difference, if there is one.
    fn add_accelerations(&self, all: &mut Cones) {
        let Some(most) = self.limits.acceleration else { return };
        for at in 0..self.bends() {
            let (weights, h) = self.bend(at);
            let row = all.row(most * h * h / self.unit);
            all.rows.add(row, self.c(at), -1.0);
            for axis in 0..D {
                let row = all.row(0.0);
                (0..3).for_each(|k| all.rows.add(row, self.x(at + k, axis), -weights[k]));
            }
            all.cones.push(SecondOrderConeT(D + 1));
        }
    }

    /// The quadratic part of the cost: smoothness, and small residuals.
    fn quadratic(&self) -> Triplets {
        let mut quadratic = Triplets::default();
        for at in 0..self.bends() {
            let (weights, h) = self.bend(at);
            // |a|^2 h / q^2, where `weights` give a h^2 in units.
            let weight = h * (self.unit / (h * h * self.limits.scatter)).powi(2);
            for axis in 0..D {
                for i in 0..3 {
                    for j in i..3 {
                        let (row, column) = (self.x(at + i, axis), self.x(at + j, axis));
                        quadratic.add(row, column, weight * weights[i] * weights[j]);
                    }
                }
            }
        }
        for at in 0..self.times() * D {
            quadratic.add(at, at, 1e-9);
        }
        let first = self.w(0, 0);
        (0..self.given.len() * D).for_each(|at| quadratic.add(first + at, first + at, 1.0));
        quadratic.set_rows(self.unknowns());
        quadratic
    }

    /// The linear part: large residuals, and what is given up of bounds.
    fn cost(&self) -> Vec<f64> {
        let mut cost = vec![0.0; self.unknowns()];
        (0..self.given.len()).for_each(|datum| cost[self.u(datum)] = RULES.huber_sigmas);
        let patience = (RULES.patience_s / self.typical_step_s).clamp(3.0, 100.0);
        let force = RULES.huber_sigmas * self.unit / self.typical_sigma;
        (0..self.steps.len()).for_each(|step| cost[self.b(step)] = patience * force);
        (0..self.bounded_bends()).for_each(|bend| cost[self.c(bend)] = patience * patience * force);
        cost
    }

    /// The coordinates at its minimum.
    fn solved(&self) -> Option<Vec<[f64; D]>> {
        let mut all = Cones::default();
        self.add_given_up(&mut all);
        self.add_data(&mut all);
        self.add_rates(&mut all);
        self.add_accelerations(&mut all);
        let unknowns = self.unknowns();
        let (quadratic, rows) = (self.quadratic().into_matrix(unknowns), all.rows.into_matrix(unknowns));
        let solution = solve(&quadratic, &self.cost(), &rows, &all.right, &all.cones)?;
        let value = |at: usize, axis: usize| self.middle[axis] + self.unit * solution[self.x(at, axis)];
        Some((0..self.times()).map(|at| std::array::from_fn(|axis| value(at, axis))).collect())
    }
}

fn solve(
    quadratic: &CscMatrix<f64>,
    cost: &[f64],
    rows: &CscMatrix<f64>,
    right: &[f64],
    cones: &[SupportedConeT<f64>],
) -> Option<Vec<f64>> {
    let settings = DefaultSettingsBuilder::default().verbose(false).max_threads(1).build().ok()?;
    let mut solver = DefaultSolver::new(quadratic, cost, rows, right, cones, settings).ok()?;
    solver.solve();
    let usable = matches!(solver.solution.status, SolverStatus::Solved | SolverStatus::AlmostSolved);
    (usable && solver.solution.x.iter().all(|v| v.is_finite())).then(|| solver.solution.x.clone())
}

/// Where a motion exceeds its limits; neighbours are told of together.
fn excesses<const D: usize>(times_s: &[f64], values: &[[f64; D]], limits: &Limits) -> Vec<Excess> {
    let norm = |v: [f64; D]| v.iter().map(|v| v * v).sum::<f64>().sqrt();
    let rate = |at: usize| -> [f64; D] {
        let h = times_s[at + 1] - times_s[at];
        std::array::from_fn(|axis| (values[at + 1][axis] - values[at][axis]) / h)
    };
    let mut found: Vec<Excess> = Vec::new();
    let mut add = |bound: Bound, from: f64, to: f64, reached: f64, limit: f64| {
        if reached <= limit * (1.0 + RULES.held_within_share) {
            return;
        }
        let near = |e: &&mut Excess| e.bound == bound && from - e.time_s[1] <= RULES.patience_s;
        if let Some(last) = found.iter_mut().rev().find(near) {
            last.time_s[1] = to;
            last.reached = last.reached.max(reached);
        } else {
            found.push(Excess { bound, time_s: [from, to], reached });
        }
    };
    for at in 0..values.len().saturating_sub(1) {
        add(Bound::Rate, times_s[at], times_s[at + 1], norm(rate(at)), limits.rate);
    }
    for at in 0..values.len().saturating_sub(2) {
        let Some(limit) = limits.acceleration else { break };
        let h = (times_s[at + 2] - times_s[at]) / 2.0;
        let (before, after) = (rate(at), rate(at + 1));
        let change = std::array::from_fn(|axis| (after[axis] - before[axis]) / h);
        add(Bound::Acceleration, times_s[at], times_s[at + 2], norm(change), limit);
    }
    found.sort_by(|a, b| a.time_s[0].total_cmp(&b.time_s[0]).then(a.bound.cmp(&b.bound)));
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector};

    const LIMITS: Limits = Limits { rate: 60.0, acceleration: Some(12.0), scatter: 1.5 };

    fn times(count: usize) -> Vec<f64> {
        // Not quite regular.
        (0..count).map(|f| (f as f64 + 0.2 * (1.7 * f as f64).sin()) / 30.0).collect()
    }

    fn along(times: &[f64], x: impl Fn(f64) -> f64, noise: f64) -> Vec<Option<Datum<2>>> {
        let one = |(at, t): (usize, &f64)| {
            let (a, b) = ((5.3 * at as f64).sin(), (3.1 * at as f64).cos());
            Some(([x(*t) + noise * a, 100.0 - 2.0 * t + noise * b], 0.02))
        };
        times.iter().enumerate().map(one).collect()
    }

    /// Where no bound and no loss bends it, the program is linear least squares.
    #[test]
    fn it_is_the_smoothing_of_least_squares_where_nothing_binds() {
        let times = times(40);
        let data = along(&times, |t| 3.0 * t + t * t, 0.01);
        let found = fit(&times, &data, &LIMITS).unwrap();
        assert!(found.excesses.is_empty());
        let count = times.len();
        let mut normal = DMatrix::<f64>::identity(count, count) / 0.02_f64.powi(2);
        for at in 0..count - 2 {
            let (before, after) = (times[at + 1] - times[at], times[at + 2] - times[at + 1]);
            let h = (before + after) / 2.0;
            let row = [1.0 / before / h, (-1.0 / before - 1.0 / after) / h, 1.0 / after / h];
            for i in 0..3 {
                for j in 0..3 {
                    normal[(at + i, at + j)] += h * row[i] * row[j] / LIMITS.scatter.powi(2);
                }
            }
        }
        let cholesky = normal.cholesky().unwrap();
        for axis in 0..2 {
            let right = data.iter().flatten().map(|(value, _)| value[axis] / 0.02_f64.powi(2));
            let wanted = cholesky.solve(&DVector::from_iterator(count, right));
            for (found, wanted) in found.values.iter().zip(wanted.iter()) {
                assert!((found[axis] - wanted).abs() < 1e-6, "{} {wanted}", found[axis]);
            }
        }
    }

    #[test]
    fn single_outliers_are_overruled_and_gaps_are_filled() {
        let times = times(120);
        let mut data = along(&times, |t| 8.0 * t, 0.005);
        for at in [20, 21, 70] {
            data[at].as_mut().unwrap().0[0] += 15.0;
        }
        data[85..110].iter_mut().for_each(|datum| *datum = None);
        let found = fit(&times, &data, &LIMITS).unwrap();
        assert!(found.excesses.is_empty(), "{:?}", found.excesses);
        for (time, value) in times.iter().zip(&found.values) {
            assert!((value[0] - 8.0 * time).abs() < 0.05, "{time}: {}", value[0] - 8.0 * time);
        }
    }

    #[test]
    fn a_bound_that_most_data_of_a_time_contradict_gives_way_and_is_named() {
        let times = times(150);
        let x = |t: f64| 20.0 * t + 60.0 * (t - 2.0).clamp(0.0, 1.5);
        let limits = Limits { acceleration: None, ..LIMITS };
        let found = fit(&times, &along(&times, x, 0.005), &limits).unwrap();
        let [Excess { bound: Bound::Rate, time_s: [from, to], reached }] = found.excesses[..] else {
            panic!("{:?}", found.excesses)
        };
        assert!((from - 2.0).abs() < 0.2 && (to - 3.5).abs() < 0.2, "{from} {to}");
        assert!((reached - 80.0).abs() < 3.0, "{reached}");
    }

    #[test]
    fn a_bound_holds_where_few_data_contradict_it() {
        let times = times(90);
        let x = |t: f64| 5.0 * t + if t > 1.5 { 0.4 } else { 0.0 };
        let limits = Limits { rate: 8.0, acceleration: None, scatter: 1000.0 };
        let found = fit(&times, &along(&times, x, 0.0), &limits).unwrap();
        for (pair, time) in found.values.windows(2).zip(times.windows(2)) {
            let speed = (pair[1][0] - pair[0][0]).hypot(pair[1][1] - pair[0][1]) / (time[1] - time[0]);
            assert!(speed < 8.0 * (1.0 + RULES.held_within_share), "{speed}");
        }
    }

    #[test]
    fn an_acceleration_that_most_data_demand_is_named() {
        let times = times(150);
        let x = |t: f64| {
            let s = (t - 2.0).clamp(0.0, 1.0);
            12.5 * s * s + 25.0 * s.min(1.0) * (t - 3.0).max(0.0)
        };
        let found = fit(&times, &along(&times, x, 0.005), &LIMITS).unwrap();
        assert!(found.excesses.iter().all(|e| e.bound == Bound::Acceleration), "{:?}", found.excesses);
        let [from, to] = [found.excesses[0].time_s[0], found.excesses[found.excesses.len() - 1].time_s[1]];
        assert!(from > 1.8 && to < 3.2 && to - from > 0.5, "{:?}", found.excesses);
    }

    #[test]
    fn short_sequences_have_an_answer() {
        let datum = Some(([1.0, 2.0], 0.1));
        let fit = |times: &[f64], data: &[Option<Datum<2>>]| fit(times, data, &LIMITS);
        assert_eq!(fit(&[0.0], &[datum]).unwrap().values, [[1.0, 2.0]]);
        assert_eq!(fit(&[0.0, 1.0, 2.0], &[None, datum, None]).unwrap().values, [[1.0, 2.0]; 3]);
        assert_eq!(fit(&[0.0, 1.0], &[None, None]), Err(NoMotion::NoData));
        let two = fit(&[0.0, 1.0], &[datum, Some(([3.0, 2.0], 0.1))]).unwrap();
        assert!((two.values[1][0] - 3.0).abs() < 1e-3);
    }
}
