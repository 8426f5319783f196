//! A path whose acceleration or jerk is white noise, given its positions at some times: where it is,
//! and how fast, at any other time.
//!
//! The state `x` is position and velocity (and acceleration), and over a time `h`
//!
//! ```text
//! x(t + h) = F x(t) + w,   w ~ N(0, q Q)
//! acceleration white:  F = [1 h]   Q = [h^3/3 h^2/2]      jerk white:  F = [1 h h^2/2]   Q = [h^5/20 h^4/8 h^3/6]
//!                          [0 1]       [h^2/2 h    ]                       [0 1   h  ]       [h^4/8  h^3/3 h^2/2]
//!                                                                          [0 0   1  ]       [h^3/6  h^2/2 h    ]
//! ```
//!
//! with the spectral density `q`; nothing is known of the first state. Positions at the knots leave
//! the derivatives there open. Their information is block tridiagonal, and they are solved for;
//! between knots `a`, `b` with states the path is, with `s = t - a` and `h = b - a`,
//!
//! ```text
//! x(t) = (F(s) - P F(h)) x_a + P x_b + e,   P = Q(s) F(h - s)^T Q(h)^-1,   cov e = q (Q(s) - P F(h - s) Q(s))
//! ```
//!
//! The mean is the natural spline through the positions, cubic or quintic. Sources: Barfoot, *State
//! Estimation for Robotics* (2017), sections 3.4 and 11.1; Wahba, *Improper priors, spline
//! smoothing and the problem of guarding against model errors in regression*, JRSS B 40 (1978).

use crate::stats::quantile::upper_median;
use nalgebra::{Cholesky, DMatrix, Matrix3, Matrix3x6, Matrix3xX, Matrix6, Matrix6xX};

/// Which derivative of the position is white noise.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// The second: velocity is a random walk.
    Acceleration,
    /// The third: acceleration is a random walk.
    Jerk,
}

impl Order {
    /// The size of a state, which is also the least number of knots that determine a path.
    pub fn states(self) -> usize {
        match self {
            Order::Acceleration => 2,
            Order::Jerk => 3,
        }
    }
}

/// What is known of a path at a time, its positions at the knots being known.
#[derive(Clone, Debug, PartialEq)]
pub struct Conditional {
    /// Mean position, velocity \[1/s\] and acceleration \[1/s^2\], one a row, by the positions at the
    /// knots, one a column.
    pub weights: Matrix3xX<f64>,
    /// Covariance of the same three, for a spectral density of 1. That of an acceleration that is
    /// white noise is infinite.
    pub covariance: Matrix3<f64>,
}

/// The path at `time`, given its positions at `knot_times`, which ascend \[s\]. Before the first and
/// beyond the last knot velocity (acceleration) stays in the mean and the covariance grows. `None`
/// where there are fewer knots than [`Order::states`]: the path is open then.
pub fn conditional(order: Order, knot_times: &[f64], time: f64) -> Option<Conditional> {
    let (n, count) = (order.states(), knot_times.len());
    if count < n {
        return None;
    }
    // Times in median steps: all numbers are near one.
    let unit = median_step(knot_times);
    let since = |knot: usize| (time - knot_times[knot]) / unit;
    let step = |knot: usize| (knot_times[knot + 1] - knot_times[knot]) / unit;
    let before = knot_times.partition_point(|knot| *knot <= time).saturating_sub(1).min(count - 2);

    let (ends, spread) = end_states(order, &(0..count - 1).map(step).collect::<Vec<_>>(), before)?;
    let (from_ends, own) = between(order, since(before), step(before), count - 2 == before, before == 0);
    let mut weights = from_ends * ends;
    let mut covariance = from_ends * spread * from_ends.transpose() + own;
    covariance = (covariance + covariance.transpose()) * 0.5;
    // At a knot rounding can leave a variance below zero.
    (0..3).for_each(|i| covariance[(i, i)] = covariance[(i, i)].max(0.0));

    let density = unit.powi(2 * n as i32 - 1);
    for i in 0..3 {
        weights.row_mut(i).scale_mut(unit.powi(-(i as i32)));
        for j in 0..3 {
            covariance[(i, j)] *= density * unit.powi(-((i + j) as i32));
        }
    }
    if order == Order::Acceleration {
        covariance[(2, 2)] = f64::INFINITY;
    }
    Some(Conditional { weights, covariance })
}

/// The states at knots `before` and `before + 1`, one above the other, by the positions at all
/// knots, and their covariance.
fn end_states(order: Order, steps: &[f64], before: usize) -> Option<(Matrix6xX<f64>, Matrix6<f64>)> {
    let (open, count) = (order.states() - 1, steps.len() + 1);
    // Information of the open derivatives, and what couples them with the positions.
    let mut information = DMatrix::<f64>::zeros(open * count, open * count);
    let mut coupling = DMatrix::<f64>::zeros(open * count, count);
    for (knot, &step) in steps.iter().enumerate() {
        let (across, inverse) = (transition(order, step), noise_inverse(order, step));
        let mixed = -across.transpose() * inverse;
        let parts = [
            (knot, knot, -mixed * across),
            (knot, knot + 1, mixed),
            (knot + 1, knot, mixed.transpose()),
            (knot + 1, knot + 1, inverse),
        ];
        for (row, column, part) in parts {
            for i in 0..open {
                coupling[(row * open + i, column)] += part[(i + 1, 0)];
                for j in 0..open {
                    information[(row * open + i, column * open + j)] += part[(i + 1, j + 1)];
                }
            }
        }
    }
    let mut solved = DMatrix::zeros(open * count, 2 * open);
    (0..2 * open).for_each(|i| solved[(before * open + i, i)] = 1.0);
    Cholesky::new(information)?.solve_mut(&mut solved);
    let slopes = -(solved.transpose() * coupling);

    let (mut states, mut covariance) = (Matrix6xX::zeros(count), Matrix6::zeros());
    let place = |i: usize| 3 * (i / open) + 1 + i % open;
    for i in 0..2 * open {
        states.row_mut(place(i)).copy_from(&slopes.row(i));
        for j in 0..2 * open {
            covariance[(place(i), place(j))] = solved[(before * open + i, j)];
        }
    }
    states[(0, before)] = 1.0;
    states[(3, before + 1)] = 1.0;
    Some((states, covariance))
}

/// The state at `since` of an interval of length `step` by the states at its two ends, and the
/// covariance that they leave open. Outside, the nearer end rules.
fn between(
    order: Order,
    since: f64,
    step: f64,
    is_last: bool,
    is_first: bool,
) -> (Matrix3x6<f64>, Matrix3<f64>) {
    let mut from_ends = Matrix3x6::zeros();
    let left = step - since;
    if since < 0.0 && is_first {
        from_ends.fixed_view_mut::<3, 3>(0, 0).copy_from(&transition(order, since));
        return (from_ends, -noise(order, since));
    }
    if left < 0.0 && is_last {
        from_ends.fixed_view_mut::<3, 3>(0, 3).copy_from(&transition(order, -left));
        return (from_ends, noise(order, -left));
    }
    let (across, rest) = (transition(order, step), transition(order, left));
    let pull = rest.transpose() * noise_inverse(order, step);
    let after = noise(order, since) * pull;
    from_ends.fixed_view_mut::<3, 3>(0, 0).copy_from(&(transition(order, since) - after * across));
    from_ends.fixed_view_mut::<3, 3>(0, 3).copy_from(&after);
    if order == Order::Acceleration {
        // The mean of the white noise itself.
        from_ends.fixed_view_mut::<1, 3>(2, 0).copy_from(&-(pull.row(1) * across));
        from_ends.fixed_view_mut::<1, 3>(2, 3).copy_from(&pull.row(1));
    }
    (from_ends, noise(order, since) - after * rest * noise(order, since))
}

/// `F` over the time `h`; what the order has no state for is zero.
fn transition(order: Order, h: f64) -> Matrix3<f64> {
    match order {
        Order::Acceleration => Matrix3::new(1.0, h, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0),
        Order::Jerk => Matrix3::new(1.0, h, 0.5 * h * h, 0.0, 1.0, h, 0.0, 0.0, 1.0),
    }
}

/// `Q` over the time `h`. Backwards in time the covariance is `-Q(h)`.
fn noise(order: Order, h: f64) -> Matrix3<f64> {
    let (h2, h3) = (h * h, h * h * h);
    match order {
        Order::Acceleration => Matrix3::new(h3 / 3.0, h2 / 2.0, 0.0, h2 / 2.0, h, 0.0, 0.0, 0.0, 0.0),
        Order::Jerk => {
            let (a, b, c, d) = (h3 * h2 / 20.0, h2 * h2 / 8.0, h3 / 6.0, h2 / 2.0);
            Matrix3::new(a, b, c, b, h3 / 3.0, d, c, d, h)
        }
    }
}

/// The inverse of `Q` over the time `h`.
fn noise_inverse(order: Order, h: f64) -> Matrix3<f64> {
    let (i1, i2, i3) = (1.0 / h, 1.0 / (h * h), 1.0 / (h * h * h));
    match order {
        Order::Acceleration => {
            Matrix3::new(12.0 * i3, -6.0 * i2, 0.0, -6.0 * i2, 4.0 * i1, 0.0, 0.0, 0.0, 0.0)
        }
        Order::Jerk => {
            let (a, b, c, d) = (720.0 * i3 * i2, -360.0 * i2 * i2, 60.0 * i3, -36.0 * i2);
            Matrix3::new(a, b, c, b, 192.0 * i3, d, c, d, 9.0 * i1)
        }
    }
}

fn median_step(times: &[f64]) -> f64 {
    upper_median(times.windows(2).map(|pair| pair[1] - pair[0]).collect()).unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DVector;

    const ORDERS: [Order; 2] = [Order::Acceleration, Order::Jerk];
    /// Uneven, with a gap.
    const KNOTS: [f64; 9] = [0.0, 0.9, 2.0, 2.6, 4.1, 9.0, 9.8, 11.0, 12.0];
    /// Between, at, before and beyond knots, and next to one.
    const TIMES: [f64; 9] = [0.3, 2.0, 3.7, 4.1 + 1e-9, 6.0, 9.0 - 1e-7, 12.0, 13.5, -2.0];

    /// Covariance of derivatives `i` at `s` and `j` at `t` of white noise integrated from zero on:
    /// the integral of `(s - u)^a/a! (t - u)^b/b!` up to the earlier time, by Gauss and Legendre.
    fn kernel(order: Order, (s, i): (f64, usize), (t, j): (f64, usize)) -> f64 {
        let power = |x: f64, n: usize| x.powi(n as i32) / (1..=n).product::<usize>() as f64;
        let (half, n) = (0.5 * s.min(t), order.states() - 1);
        let node = 0.6_f64.sqrt();
        [(-node, 5.0 / 9.0), (0.0, 8.0 / 9.0), (node, 5.0 / 9.0)]
            .iter()
            .map(|(node, weight)| {
                let u = half * (1.0 + node);
                half * weight * power(s - u, n - i) * power(t - u, n - j)
            })
            .sum()
    }

    /// The other road: regression with the kernel of the integrated noise and a polynomial of which
    /// nothing is known (universal kriging, which is the limit of a huge prior).
    fn by_regression(order: Order, knots: &[f64], time: f64) -> (DMatrix<f64>, DMatrix<f64>) {
        const START: f64 = 3.0;
        let (n, m) = (order.states(), knots.len());
        let at = |k: usize| knots[k] - knots[0] + START;
        let time = time - knots[0] + START;
        let polynomial = |t: f64, derivative: usize, k: usize| {
            let factor: usize = (0..derivative).map(|d| k.saturating_sub(d)).product();
            if factor == 0 { 0.0 } else { factor as f64 * t.powi((k - derivative) as i32) }
        };
        let mut matrix = DMatrix::zeros(m + n, m + n);
        let mut right = DMatrix::zeros(m + n, n);
        for a in 0..m {
            for b in 0..m {
                matrix[(a, b)] = kernel(order, (at(a), 0), (at(b), 0));
            }
            for k in 0..n {
                matrix[(a, m + k)] = polynomial(at(a), 0, k);
                matrix[(m + k, a)] = polynomial(at(a), 0, k);
                right[(a, k)] = kernel(order, (time, k), (at(a), 0));
            }
        }
        for (k, derivative) in (0..n).flat_map(|k| (0..n).map(move |d| (k, d))) {
            right[(m + k, derivative)] = polynomial(time, derivative, k);
        }
        let solved = matrix.full_piv_lu().solve(&right).unwrap();
        let own = DMatrix::from_fn(n, n, |i, j| kernel(order, (time, i), (time, j)));
        let covariance = own - right.transpose() * &solved;
        (solved.rows(0, m).transpose(), covariance)
    }

    #[test]
    fn two_roads_lead_to_the_same_path() {
        for order in ORDERS {
            let n = order.states();
            for time in TIMES {
                let found = conditional(order, &KNOTS, time).unwrap();
                let (weights, covariance) = by_regression(order, &KNOTS, time);
                let gap = (found.weights.rows(0, n) - weights).amax();
                assert!(gap < 1e-8, "{order:?} at {time}: {gap}");
                let wanted = covariance.amax().max(1.0);
                let gap = (found.covariance.view((0, 0), (n, n)) - covariance).amax() / wanted;
                assert!(gap < 1e-8, "{order:?} at {time}: {gap}");
            }
        }
    }

    #[test]
    fn the_mean_under_white_acceleration_is_the_natural_cubic_spline() {
        let values = DVector::from_iterator(9, KNOTS.iter().map(|t| (1.3 * t).sin() + 0.2 * t * t));
        // Second derivatives m: h m- / 6 + (h + k) m / 3 + k m+ / 6 = slope+ - slope-.
        let step = |k: usize| KNOTS[k + 1] - KNOTS[k];
        let slope = |k: usize| (values[k + 1] - values[k]) / step(k);
        let (mut matrix, mut right) = (DMatrix::identity(9, 9), DVector::zeros(9));
        for k in 1..8 {
            matrix[(k, k - 1)] = step(k - 1) / 6.0;
            matrix[(k, k)] = (step(k - 1) + step(k)) / 3.0;
            matrix[(k, k + 1)] = step(k) / 6.0;
            right[k] = slope(k) - slope(k - 1);
        }
        let m = matrix.lu().solve(&right).unwrap();
        for (k, time) in [(0, 0.3), (2, 2.0), (3, 3.7), (4, 7.0), (6, 10.9)] {
            let (h, s) = (step(k), time - KNOTS[k]);
            let start = slope(k) - h * (2.0 * m[k] + m[k + 1]) / 6.0;
            let turn = (m[k + 1] - m[k]) / h;
            let wanted = [
                values[k] + s * (start + s * (m[k] / 2.0 + s * turn / 6.0)),
                start + s * (m[k] + s * turn / 2.0),
                m[k] + s * turn,
            ];
            let found = conditional(Order::Acceleration, &KNOTS, time).unwrap().weights * &values;
            (0..3).for_each(|i| assert!((found[i] - wanted[i]).abs() < 1e-11, "{time}: {found} {wanted:?}"));
        }
    }

    #[test]
    fn an_old_clock_and_a_fast_camera_cost_nothing() {
        for order in ORDERS {
            let n = order.states();
            let fast: Vec<f64> = KNOTS.iter().map(|t| 1e3 + t / 30.0).collect();
            for time in TIMES {
                let plain = conditional(order, &KNOTS, time).unwrap();
                let found = conditional(order, &fast, 1e3 + time / 30.0).unwrap();
                for i in 0..n {
                    let unit = 30_f64.powi(i as i32);
                    let gap = (found.weights.row(i) / unit - plain.weights.row(i)).amax();
                    assert!(gap < 1e-9, "{order:?} at {time}, row {i}: {gap}");
                    for j in 0..n {
                        let unit = 30_f64.powi((i + j) as i32 + 1 - 2 * n as i32);
                        let gap = found.covariance[(i, j)] / unit - plain.covariance[(i, j)];
                        assert!(gap.abs() < 1e-9 * plain.covariance.view((0, 0), (n, n)).amax().max(1.0));
                    }
                }
            }
        }
    }

    #[test]
    fn at_a_knot_the_position_is_known_and_the_velocity_is_not() {
        for order in ORDERS {
            for (k, knot) in KNOTS.iter().enumerate() {
                let found = conditional(order, &KNOTS, *knot).unwrap();
                let own = DVector::from_fn(9, |i, _| f64::from(u8::from(i == k)));
                assert!((found.weights.row(0).transpose() - own).amax() < 1e-12);
                let (position, velocity) = (found.covariance[(0, 0)], found.covariance[(1, 1)]);
                assert!(position.abs() < 1e-12 && velocity > 1e-3, "{order:?}: {position} {velocity}");
            }
        }
    }

    #[test]
    fn too_few_knots_leave_the_path_open() {
        assert!(conditional(Order::Acceleration, &KNOTS[..1], 0.0).is_none());
        assert!(conditional(Order::Jerk, &KNOTS[..2], 0.0).is_none());
        let two = conditional(Order::Acceleration, &KNOTS[..2], 0.45).unwrap();
        assert!((two.weights.column(1) - nalgebra::Vector3::new(0.5, 1.0 / 0.9, 0.0)).amax() < 1e-12);
        assert!(conditional(Order::Jerk, &KNOTS[..3], 5.0).is_some());
        assert!(conditional(Order::Acceleration, &[0.0, 1.0, 1.0], 0.5).is_none(), "a time twice");
    }

    #[test]
    fn far_knots_are_forgotten() {
        let knots: Vec<f64> = (0..31).map(f64::from).collect();
        for (order, root) in [(Order::Acceleration, 0.268), (Order::Jerk, 0.431)] {
            let weights = conditional(order, &knots, 15.0).unwrap().weights;
            for k in 21..26 {
                let ratio: f64 = weights[(1, k + 1)] / weights[(1, k)];
                assert!((ratio.abs() - root).abs() < 0.02, "{order:?} knot {k}: {ratio}");
            }
        }
    }
}
