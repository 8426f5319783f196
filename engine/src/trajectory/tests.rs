use super::*;
use crate::geometry::{pose, rotation};
use nalgebra::{DMatrix, DVector, Matrix6, SMatrix, SVector};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use trackbundle_solver::manifold::{Manifold, pose_minus, read_pose, write_pose};

const ORDERS: [Order; 2] = [Order::Acceleration, Order::Jerk];
const STRENGTHS: Strengths = Strengths { linear: 1.5, angular: 0.3 };

/// A car that accelerates, brakes and turns by up to 0.5 rad/s, on a slope; every millisecond.
struct Car {
    positions: Vec<Vector3<f64>>,
}

impl Car {
    const STEP_S: f64 = 1e-3;

    fn slope() -> nalgebra::UnitQuaternion<f64> {
        rotation::exp(&Vector3::new(0.03, -0.05, 0.4))
    }

    fn speed(t: f64) -> f64 {
        10.0 + 2.5 * (1.1 * t).sin()
    }

    fn heading(t: f64) -> f64 {
        0.6 * (1.0 - (t / 1.2).cos())
    }

    fn yaw_rate(t: f64) -> f64 {
        0.5 * (t / 1.2).sin()
    }

    fn new(duration_s: f64) -> Self {
        let velocity = |t: f64| {
            let heading = Car::heading(t);
            Car::slope() * (Vector3::new(heading.cos(), heading.sin(), 0.0) * Car::speed(t))
        };
        let mut positions = vec![Vector3::new(3.0, -2.0, 0.5)];
        for step in 0..(duration_s / Car::STEP_S) as usize {
            let (t, h) = (step as f64 * Car::STEP_S, Car::STEP_S);
            // Simpson.
            let moved = (velocity(t) + 4.0 * velocity(t + 0.5 * h) + velocity(t + h)) * (h / 6.0);
            positions.push(positions[step] + moved);
        }
        Car { positions }
    }

    fn pose(&self, step: usize) -> Pose {
        let turn = rotation::exp(&(Vector3::z() * Car::heading(step as f64 * Car::STEP_S)));
        Pose::from_parts(self.positions[step].into(), Car::slope() * turn)
    }

    fn trajectory(&self, steps: &[usize], order: Order) -> Trajectory {
        let times = steps.iter().map(|step| *step as f64 * Car::STEP_S).collect();
        Trajectory::new(times, steps.iter().map(|step| self.pose(*step)).collect(), order, STRENGTHS)
    }

    /// Largest error of position \[m\], velocity \[m/s\] and angular velocity \[rad/s\] in a span of
    /// steps, and of the acceleration \[m/s^2\].
    fn errors(&self, path: &Trajectory, steps: Range<usize>) -> [f64; 4] {
        let mut worst = [0.0_f64; 4];
        for step in steps {
            let t = step as f64 * Car::STEP_S;
            let (state, truth) = (path.state_at(t).unwrap(), self.pose(step));
            let acceleration = Vector3::new(2.75 * (1.1 * t).cos(), Car::speed(t) * Car::yaw_rate(t), 0.0);
            let errors = [
                (state.pose.translation.vector - truth.translation.vector).norm(),
                (state.velocity_mps - truth.rotation * (Vector3::x() * Car::speed(t))).norm(),
                (state.angular_velocity_rps - Vector3::z() * Car::yaw_rate(t)).norm(),
                (state.acceleration_mps2 - truth.rotation * acceleration).norm(),
            ];
            (0..4).for_each(|i| worst[i] = worst[i].max(errors[i]));
        }
        worst
    }
}

#[test]
fn a_car_is_followed_between_frames() {
    let car = Car::new(4.0);
    // 30 Hz with times that jitter, and a gap of 0.3 s.
    let even: Vec<usize> = (0..120).map(|k| k * 100 / 3).collect();
    let uneven: Vec<usize> =
        even.iter().enumerate().filter(|(k, _)| !(60..68).contains(k)).map(|(k, s)| s + k * k % 11).collect();
    // Position, velocity, angular velocity, acceleration: at 30 Hz, and over the gap.
    let bounds = [
        (Order::Acceleration, [2e-6, 2e-4, 3e-5, 0.015], [5e-4, 5e-3, 1e-4, 0.1]),
        (Order::Jerk, [1e-8, 2e-6, 2e-7, 2e-4], [5e-7, 1e-5, 1e-6, 3e-4]),
    ];
    for (order, frames, gap) in bounds {
        let path = car.trajectory(&even, order);
        let found = car.errors(&path, 400..3500);
        assert!((0..4).all(|i| found[i] < frames[i]), "{order:?}: {found:?}");
        assert!(car.errors(&path, 0..3966)[0] < 1e-3, "at the ends too");
        let path = car.trajectory(&uneven, order);
        let found = car.errors(&path, 400..3500);
        assert!((0..4).all(|i| found[i] < gap[i]), "{order:?}: {found:?}");
    }
}

#[test]
fn a_steady_curve_is_followed_exactly_and_beyond_its_ends() {
    let start = pose([1e3, -2e3, 40.0], [0.7, -0.1, 0.2, 0.6]);
    let twist = Vector6::new(12.0, 0.4, -0.3, 0.02, -0.05, 0.6);
    let at = |t: f64| start * se3::exp(&(twist * t));
    let times = vec![1e3, 1e3 + 0.04, 1e3 + 0.07, 1e3 + 0.5, 1e3 + 0.53];
    for order in ORDERS {
        let poses = times.iter().map(|t| at(t - 1e3)).collect();
        let path = Trajectory::new(times.clone(), poses, order, STRENGTHS);
        for t in [-0.2, 0.0, 0.05, 0.07, 0.3, 0.9] {
            let (state, truth) = (path.state_at(1e3 + t).unwrap(), at(t));
            let (v, w) = se3::parts(&twist);
            assert!(pose_minus(&state.pose, &truth).norm() < 1e-9, "{order:?} at {t}");
            assert!((state.velocity_mps - truth.rotation * v).norm() < 1e-8);
            assert!((state.angular_velocity_rps - w).norm() < 1e-8);
            assert!((state.acceleration_mps2 - truth.rotation * w.cross(&v)).norm() < 1e-5);
        }
    }
}

#[test]
fn points_of_a_body_move_as_it_turns() {
    let car = Car::new(2.0);
    let path = car.trajectory(&(0..60).map(|k| k * 100 / 3).collect::<Vec<_>>(), Order::Acceleration);
    let (point, t, h) = (Point3::new(2.0, -0.7, 1.4), 0.91, 1e-5);
    let state = path.state_at(t).unwrap();
    let [before, after] = [t - h, t + h].map(|t| path.state_at(t).unwrap());
    let slope = (after.pose * point - before.pose * point) / (2.0 * h);
    assert!((slope - state.velocity_of(&point)).norm() < 1e-6);
    let slope = (after.velocity_of(&point) - before.velocity_of(&point)) / (2.0 * h);
    assert!((slope - state.acceleration_of(&point)).norm() < 1e-5);
    let slope = (after.heading_rad() - before.heading_rad()) / (2.0 * h);
    assert!((slope - state.yaw_rate_rps()).abs() < 1e-7);
    assert!((state.speed_of_mps(&point) - state.velocity_of(&point).xy().norm()).abs() < 1e-15);
    assert!((state.speed_of_mps(&point) - state.speed_of_mps(&Point3::origin())).abs() > 0.01);
}

#[test]
fn too_few_poses_have_no_state() {
    let one = Trajectory::new(vec![0.0], vec![Pose::identity()], Order::Acceleration, STRENGTHS);
    assert!(one.state_at(0.0).is_none() && one.linear_at(0.0).is_none());
    let poses = vec![Pose::identity(), pose([1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0])];
    let two = |order| Trajectory::new(vec![0.0, 0.1], poses.clone(), order, STRENGTHS);
    assert!(two(Order::Jerk).state_at(0.05).is_none());
    let velocity = two(Order::Acceleration).state_at(0.02).unwrap().velocity_mps;
    assert!((velocity - Vector3::x() * 10.0).norm() < 1e-12);
    assert!(two(Order::Acceleration).state_at(f64::NAN).is_none());
}

/// Poses far from each other, at uneven times.
fn tumbling() -> (Vec<f64>, Vec<Pose>) {
    let times: Vec<f64> = (0..24).map(|k| f64::from(k) * 0.11 + 0.04 * (1.9 * f64::from(k)).sin()).collect();
    let poses = times.iter().map(|t| {
        let turn = Vector3::new(0.4 * (2.0 * t).sin(), 0.3 * (1.4 * t).cos(), 1.1 * t);
        let place = Vector3::new(9.0 * t, 4.0 * (1.3 * t).sin(), 0.5 * (2.2 * t).cos());
        Pose::from_parts(place.into(), rotation::exp(&turn))
    });
    (times.clone(), poses.collect())
}

#[test]
fn derivatives_are_those_of_differences() {
    const STEP: f64 = 1e-5;
    let (times, poses) = tumbling();
    for order in ORDERS {
        let path = Trajectory::new(times.clone(), poses.clone(), order, STRENGTHS);
        for time in [-0.1, 0.02, times[10], 0.5 * (times[11] + times[12]) + 0.01, 1.43, times[23] + 0.05] {
            let linear = path.linear_at(time).unwrap();
            assert_eq!(linear.state, path.state_at(time).unwrap());
            assert!(linear.knots.len() <= 2 * order.window());
            for (knot, block) in linear.knots.clone().zip(&linear.blocks) {
                for column in 0..6 {
                    let at = |step: f64| {
                        let (mut delta, mut moved, mut path) = ([0.0; 6], [0.0; 7], path.clone());
                        delta[column] = step;
                        Manifold::Pose.plus(&write_pose(&poses[knot]), &delta, &mut moved);
                        path.poses[knot] = read_pose(&moved);
                        perturbation(&path.state_at(time).unwrap(), &linear.state)
                    };
                    let slope = (at(STEP) - at(-STEP)) / (2.0 * STEP);
                    let gap = (slope - block.column(column)).amax();
                    // Velocities go with some 30/s of a position.
                    assert!(gap < 1e-6, "{order:?} at {time}, knot {knot}, column {column}: {gap}");
                }
            }
        }
    }
}

/// The perturbation that leads from `from` to `to`, in the rows of [`Linear`].
fn perturbation(to: &State, from: &State) -> SVector<f64, 12> {
    let mut delta = SVector::<f64, 12>::zeros();
    delta.fixed_rows_mut::<6>(0).copy_from(&pose_minus(&to.pose, &from.pose));
    delta.fixed_rows_mut::<3>(6).copy_from(&(to.velocity_mps - from.velocity_mps));
    delta.fixed_rows_mut::<3>(9).copy_from(&(to.angular_velocity_rps - from.angular_velocity_rps));
    delta
}

#[test]
fn moving_all_poses_alike_moves_the_state() {
    let (times, poses) = tumbling();
    let linear = Trajectory::new(times, poses, Order::Jerk, STRENGTHS).linear_at(1.43).unwrap();
    let sum: SMatrix<f64, 12, 6> = linear.blocks.iter().sum();
    let shifted = sum.fixed_view::<12, 3>(0, 0);
    let wanted = SMatrix::<f64, 12, 3>::identity();
    assert!((shifted - wanted).amax() < 1e-9, "{shifted}");
}

/// Gaussian enough: the sum of twelve uniform numbers.
fn normal(rng: &mut ChaCha8Rng) -> f64 {
    (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0
}

/// One axis of a path under white acceleration, its positions measured with noise at the knots:
/// exact least squares for all positions and velocities, by dense algebra.
struct Smoother {
    times: Vec<f64>,
    solve: DMatrix<f64>,
    noise_m: f64,
}

impl Smoother {
    fn new(times: &[f64], strength: f64, noise_m: f64) -> Self {
        let count = times.len();
        let mut information = DMatrix::zeros(2 * count, 2 * count);
        for (k, pair) in times.windows(2).enumerate() {
            let h = pair[1] - pair[0];
            let noise =
                nalgebra::Matrix2::new(h.powi(3) / 3.0, h * h / 2.0, h * h / 2.0, h) * strength.powi(2);
            let step = nalgebra::Matrix2x4::new(-1.0, -h, 1.0, 0.0, 0.0, -1.0, 0.0, 1.0);
            let part = step.transpose() * noise.try_inverse().unwrap() * step;
            let mut view = information.view_mut((2 * k, 2 * k), (4, 4));
            view += part;
        }
        (0..count).for_each(|k| information[(2 * k, 2 * k)] += noise_m.powi(-2));
        Smoother { times: times.to_vec(), solve: information.try_inverse().unwrap(), noise_m }
    }

    /// Covariance of the positions at two knots.
    fn covariance(&self, i: usize, j: usize) -> f64 {
        self.solve[(2 * i, 2 * j)]
    }

    fn positions(&self, measured: &[f64]) -> Vec<f64> {
        let mut right = DVector::zeros(2 * self.times.len());
        (0..measured.len()).for_each(|k| right[2 * k] = measured[k] / self.noise_m.powi(2));
        let states = &self.solve * right;
        (0..measured.len()).map(|k| states[2 * k]).collect()
    }
}

#[test]
fn the_covariance_is_that_of_draws() {
    const DRAWS: usize = 5000;
    let times = [0.0, 0.03, 0.07, 0.1, 0.13, 0.17, 0.4, 0.43, 0.47, 0.5, 0.53, 0.57];
    // At a knot, between two, in the gap.
    let asked = [0.1, 0.15, 0.3];
    let noise_m = 0.01;
    let smoother = Smoother::new(&times, STRENGTHS.linear, noise_m);
    let mut all: Vec<(f64, Option<usize>, Option<usize>)> =
        times.iter().enumerate().map(|(k, t)| (*t, Some(k), None)).collect();
    all.extend(asked.iter().enumerate().map(|(k, t)| (*t, None, Some(k))));
    all.sort_by(|a, b| a.0.total_cmp(&b.0));

    let rng = &mut ChaCha8Rng::seed_from_u64(5);
    // Per time: sums of squares of position and velocity, and of their product.
    let mut sums = [[0.0; 3]; 3];
    for _ in 0..DRAWS {
        let (mut x, mut v, mut now) = (3.0 * normal(rng), 8.0 + normal(rng), 0.0);
        let (mut measured, mut truth) = (vec![0.0; times.len()], [(0.0, 0.0); 3]);
        for &(time, knot, place) in &all {
            let h = time - now;
            let (a, b) = (normal(rng), normal(rng));
            // Cholesky factor of Q: [sqrt(h^3/3) 0; sqrt(3 h)/2 sqrt(h)/2].
            x += v * h + STRENGTHS.linear * (h.powi(3) / 3.0).sqrt() * a;
            v += STRENGTHS.linear * h.sqrt() * (0.75_f64.sqrt() * a + 0.5 * b);
            now = time;
            if let Some(knot) = knot {
                measured[knot] = x + noise_m * normal(rng);
            }
            if let Some(place) = place {
                truth[place] = (x, v);
            }
        }
        let positions = smoother.positions(&measured);
        let poses = positions.iter().map(|x| {
            // Along the y axis of bodies that stand turned.
            Pose::from_parts(Vector3::new(5.0, *x, 1.0).into(), rotation::exp(&Vector3::new(0.1, 0.2, 1.0)))
        });
        let path = Trajectory::new(times.to_vec(), poses.collect(), Order::Acceleration, STRENGTHS);
        for (k, time) in asked.iter().enumerate() {
            let state = path.state_at(*time).unwrap();
            let (dx, dv) = (state.pose.translation.y - truth[k].0, state.velocity_mps.y - truth[k].1);
            let products = [dx * dx, dv * dv, dx * dv];
            (0..3).for_each(|i| sums[k][i] += products[i] / DRAWS as f64);
        }
    }
    let poses = times.iter().map(|t| pose([5.0, 8.0 * t, 1.0], [1.0, 0.0, 0.0, 0.0])).collect();
    let path = Trajectory::new(times.to_vec(), poses, Order::Acceleration, STRENGTHS);
    for (k, time) in asked.iter().enumerate() {
        let known = |i: usize, j: usize| {
            let mut matrix = Matrix6::zeros();
            matrix[(1, 1)] = smoother.covariance(i, j);
            matrix
        };
        let predicted = path.linear_at(*time).unwrap().covariance(known);
        let [p, v, c] = [predicted[(1, 1)], predicted[(7, 7)], predicted[(1, 7)]];
        let ratios = [sums[k][0] / p, sums[k][1] / v, (sums[k][2] - c) / (p * v).sqrt()];
        assert!(ratios[..2].iter().all(|ratio| (ratio - 1.0).abs() < 0.05), "at {time}: {ratios:?}");
        assert!(ratios[2].abs() < 0.05, "at {time}: {ratios:?}");
        // The poses alone do not say it.
        assert!(path.linear_at(*time).unwrap().process[(7, 7)] > 0.05 * v);
    }
}

#[test]
fn knots_outside_the_window_hardly_count() {
    let rng = &mut ChaCha8Rng::seed_from_u64(9);
    let times: Vec<f64> =
        (0..60).map(|k| (f64::from(k) + 0.2 * normal(rng).clamp(-1.5, 1.5)) / 30.0).collect();
    let places: Vec<f64> = times.iter().map(|_| normal(rng)).collect();
    let poses: Vec<Pose> = places.iter().map(|x| pose([*x, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0])).collect();
    for order in ORDERS {
        let path = Trajectory::new(times.clone(), poses.clone(), order, STRENGTHS);
        let (mut gaps, mut sizes) = ([0.0; 2], [0.0; 2]);
        for k in 0..400 {
            let time = f64::from(k) * 0.005 - 0.01;
            let found = path.state_at(time).unwrap();
            let all = conditional(order, &times, time).unwrap();
            let wanted = &all.weights * DVector::from_column_slice(&places);
            for (i, found) in [found.pose.translation.x, found.velocity_mps.x].into_iter().enumerate() {
                gaps[i] += (found - wanted[i]).powi(2);
                sizes[i] += wanted[i].powi(2);
            }
            let process = path.linear_at(time).unwrap().process;
            let open = all.covariance[(1, 1)] * STRENGTHS.linear.powi(2);
            assert!((process[(6, 6)] - open).abs() < 1e-3 * open, "{order:?} at {time}");
        }
        let shares = [0, 1].map(|i: usize| (gaps[i] / sizes[i]).sqrt());
        assert!(shares.iter().all(|share| *share < 1e-3), "{order:?}: {shares:?}");
    }
}

#[test]
fn the_state_does_not_jump_where_another_pose_is_nearest() {
    let car = Car::new(3.0);
    for order in ORDERS {
        let steps: Vec<usize> = (0..80).map(|k| k * 100 / 3).collect();
        let path = car.trajectory(&steps, order);
        for pair in path.times_s.windows(2) {
            let middle = 0.5 * (pair[0] + pair[1]);
            let [before, after] = [-1e-9, 1e-9].map(|h| path.state_at(middle + h).unwrap());
            let jump = perturbation(&after, &before);
            assert!(jump.fixed_rows::<6>(0).amax() < 1e-6, "{order:?} at {middle}: {jump}");
            assert!(jump.amax() < 1e-4, "{order:?} at {middle}: {jump}");
        }
    }
}
