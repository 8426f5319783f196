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

use super::robust_dlt::Triplets;
use clarabel::algebra::CscMatrix;
use clarabel::solver::{
    DefaultSettingsBuilder, DefaultSolver, IPSolver, NonnegativeConeT, SecondOrderConeT, SolverStatus,
    SupportedConeT,
};

/// Where a residual turns linear, in standard deviations.
const HUBER: f64 = 1.5;
/// Data that disagree with a bound for longer than this make it give way \[s\].
const PATIENCE_S: f64 = 0.2;
/// A bound that is exceeded by less than this share is held.
const HELD: f64 = 0.02;

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
    let middle: [f64; D] = std::array::from_fn(|axis| {
        let mut values: Vec<f64> = given.iter().map(|(_, (value, _))| value[axis]).collect();
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    });
    let mut sigmas: Vec<f64> = given.iter().map(|(_, (_, sigma))| *sigma).collect();
    sigmas.sort_by(f64::total_cmp);
    // Lengths are counted in this unit, in which steps and standard deviations are of the order of 1.
    let unit = 10.0 * sigmas[sigmas.len() / 2];
    let mut steps: Vec<f64> = times_s.windows(2).map(|t| t[1] - t[0]).collect();
    let typical = {
        let mut sorted = steps.clone();
        sorted.sort_by(f64::total_cmp);
        sorted[sorted.len() / 2]
    };
    steps.iter_mut().for_each(|h| *h = h.max(1e-6));

    let with_acceleration = limits.acceleration.is_some() && count > 2;
    let bends = count - 2;
    let accelerations = if with_acceleration { bends } else { 0 };
    let x = |at: usize, axis: usize| at * D + axis;
    let w = |datum: usize, axis: usize| count * D + datum * D + axis;
    let u = |datum: usize| count * D + given.len() * D + datum;
    let b = |step: usize| count * D + given.len() * (D + 1) + step;
    let c = |bend: usize| b(count - 1) + bend;
    let unknowns = c(0) + accelerations;
    let mut rows = Triplets::default();
    let mut right = Vec::new();
    let mut cones: Vec<SupportedConeT<f64>> = Vec::new();

    for slack in b(0)..unknowns {
        let at = rows.next_row();
        rows.add(at, slack, -1.0);
        right.push(0.0);
    }
    cones.push(NonnegativeConeT(unknowns - b(0)));
    for (datum, (at, (value, sigma))) in given.iter().enumerate() {
        // (u, (x - d) / s - w) lies in the cone.
        let row = rows.next_row();
        rows.add(row, u(datum), -1.0);
        right.push(0.0);
        for axis in 0..D {
            let row = rows.next_row();
            rows.add(row, x(*at, axis), -unit / sigma);
            rows.add(row, w(datum, axis), 1.0);
            right.push(-(value[axis] - middle[axis]) / sigma);
        }
        cones.push(SecondOrderConeT(D + 1));
    }
    for (step, h) in steps.iter().enumerate() {
        let row = rows.next_row();
        rows.add(row, b(step), -1.0);
        right.push(limits.rate * h / unit);
        for axis in 0..D {
            let row = rows.next_row();
            rows.add(row, x(step + 1, axis), -1.0);
            rows.add(row, x(step, axis), 1.0);
            right.push(0.0);
        }
        cones.push(SecondOrderConeT(D + 1));
    }
    // The second divided difference by the values before, at and after, times the step squared.
    let bend = |at: usize| {
        let (before, after) = (steps[at], steps[at + 1]);
        let h = (before + after) / 2.0;
        ([h / before, -h / before - h / after, h / after], h)
    };
    if let Some(most) = limits.acceleration.filter(|_| with_acceleration) {
        for at in 0..bends {
            let (weights, h) = bend(at);
            let row = rows.next_row();
            rows.add(row, c(at), -1.0);
            right.push(most * h * h / unit);
            for axis in 0..D {
                let row = rows.next_row();
                (0..3).for_each(|k| rows.add(row, x(at + k, axis), -weights[k]));
                right.push(0.0);
            }
            cones.push(SecondOrderConeT(D + 1));
        }
    }
    let mut quadratic = Triplets::default();
    for at in 0..bends {
        let (weights, h) = bend(at);
        // |a|^2 h / q^2, where `weights` give a h^2 in units.
        let weight = h * (unit / (h * h * limits.scatter)).powi(2);
        for axis in 0..D {
            for i in 0..3 {
                for j in i..3 {
                    quadratic.add(x(at + i, axis), x(at + j, axis), weight * weights[i] * weights[j]);
                }
            }
        }
    }
    for at in 0..count * D {
        quadratic.add(at, at, 1e-9);
    }
    (0..given.len() * D).for_each(|at| quadratic.add(w(0, 0) + at, w(0, 0) + at, 1.0));
    quadratic.set_rows(unknowns);
    let mut cost = vec![0.0; unknowns];
    (0..given.len()).for_each(|datum| cost[u(datum)] = HUBER);
    let patience = (PATIENCE_S / typical).clamp(3.0, 100.0);
    let force = HUBER * unit / sigmas[sigmas.len() / 2];
    (0..count - 1).for_each(|step| cost[b(step)] = patience * force);
    (0..accelerations).for_each(|bend| cost[c(bend)] = patience * patience * force);

    let solution =
        solve(&quadratic.into_matrix(unknowns), &cost, &rows.into_matrix(unknowns), &right, &cones)
            .ok_or(NoMotion::NotSolved)?;
    let values: Vec<[f64; D]> = (0..count)
        .map(|at| std::array::from_fn(|axis| middle[axis] + unit * solution[x(at, axis)]))
        .collect();
    let excesses = excesses(times_s, &values, limits);
    Ok(Motion { values, excesses })
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
        if reached <= limit * (1.0 + HELD) {
            return;
        }
        let near = |e: &&mut Excess| e.bound == bound && from - e.time_s[1] <= PATIENCE_S;
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
            assert!(speed < 8.0 * (1.0 + HELD), "{speed}");
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
