//! The path of a camera between the frames whose pose is known.
//!
//! Position and attitude (as a rotation vector from a pose nearby) move with white noise on their
//! acceleration; what is known of single frames are measurements of them with their covariances. The
//! most probable path is that of a Kalman filter, smoothed backwards (Rauch, Tung and Striebel 1965):
//! a cubic spline between exact poses, and nearly a straight line after the last one.

use crate::geometry::Pose;
use crate::geometry::rotation::{exp, log, right_jacobian_inverse};
use crate::rules::rules;
use nalgebra::{Matrix6, SMatrix, SVector, Vector3, Vector6};
use trackbundle_solver::manifold::pose_minus;

rules! {
    /// The path of the camera across frames that are bridged.
    pub struct CameraPathRules {
        /// Scatter of the mean acceleration over one second, of a drone in wind.
        acceleration_scatter: [f64; 2] = [1.0, 0.1], "m/s^2, rad/s^2";
        /// Standard deviations before anything is known, from the first known pose ...
        unknown_pose_sigma: [f64; 2] = [50.0, 3.0], "m, rad";
        /// ... and of the velocity.
        unknown_velocity_sigma: [f64; 2] = [20.0, 1.0], "m/s, rad/s";
        /// Known poses beside a gap that are looked at, on either side.
        window_poses: usize = 8, "poses";
        /// How far beyond the last known pose the velocity is kept; then the camera is held.
        velocity_kept_s: f64 = 0.5, "s";
        /// Least standard deviations of a known pose, which keep the filter sound.
        least_sigma: [f64; 2] = [1e-4, 1e-6], "m, rad";
    }
}

const RULES: CameraPathRules = CameraPathRules::DEFAULT;

/// A frame whose pose is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Anchor {
    /// When \[s\].
    pub time_s: f64,
    /// `world_from_camera`.
    pub pose: Pose,
    /// Of its perturbation \[m, rad\].
    pub covariance: Matrix6<f64>,
}

/// Pose and covariance at `times_s` (in order), from anchors (in order) before the first of them and
/// after the last; `None` without any.
pub fn between(before: &[Anchor], times_s: &[f64], after: &[Anchor]) -> Option<Vec<(Pose, Matrix6<f64>)>> {
    let before = &before[before.len().saturating_sub(RULES.window_poses)..];
    let after = &after[..after.len().min(RULES.window_poses)];
    let reference = before.last().or(after.first())?.pose;
    let [earliest_s, latest_s] = [
        before.last().map_or_else(|| after[0].time_s - RULES.velocity_kept_s, |a| a.time_s),
        after.first().map_or_else(|| before[before.len() - 1].time_s + RULES.velocity_kept_s, |a| a.time_s),
    ];
    // Times: of the anchors, where the path is asked for, and where it is asked for its uncertainty.
    let mut steps: Vec<Step> = Vec::new();
    steps.extend(before.iter().chain(after).map(|anchor| Step::of_anchor(anchor, &reference)));
    for time_s in times_s {
        let kept_s = time_s.clamp(earliest_s, latest_s);
        steps.push(Step { time_s: kept_s, measured: None });
        if kept_s != *time_s {
            steps.push(Step { time_s: *time_s, measured: None });
        }
    }
    steps.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
    let smoothed = smooth(&steps)?;
    let at = |time_s: f64| {
        let found = steps.iter().zip(&smoothed).find(|(step, _)| step.time_s == time_s);
        found.map(|(_, state)| state)
    };
    let place = |time_s: &f64| {
        let (value, _) = at(time_s.clamp(earliest_s, latest_s))?;
        let (_, covariance) = at(*time_s)?;
        let turn = value.fixed_rows::<3>(3).into_owned();
        let pose = Pose::from_parts(
            (reference.translation.vector + value.fixed_rows::<3>(0)).into(),
            reference.rotation * exp(&turn),
        );
        let mut to_own_axes = Matrix6::identity();
        to_own_axes.fixed_view_mut::<3, 3>(3, 3).copy_from(&right_jacobian_inverse(&turn).try_inverse()?);
        let covariance = to_own_axes * covariance.fixed_view::<6, 6>(0, 0) * to_own_axes.transpose();
        Some((pose, 0.5 * (covariance + covariance.transpose())))
    };
    times_s.iter().map(place).collect()
}

/// Position, rotation vector, and the velocities of both.
type State = SVector<f64, 12>;
type StateCovariance = SMatrix<f64, 12, 12>;

struct Step {
    time_s: f64,
    measured: Option<(Vector6<f64>, Matrix6<f64>)>,
}

impl Step {
    fn of_anchor(anchor: &Anchor, reference: &Pose) -> Step {
        let value = pose_minus(&anchor.pose, reference);
        let turn: Vector3<f64> = log(&(reference.rotation.inverse() * anchor.pose.rotation));
        let mut jacobian = Matrix6::identity();
        jacobian.fixed_view_mut::<3, 3>(3, 3).copy_from(&right_jacobian_inverse(&turn));
        let least = Vector6::from_fn(|i, _| RULES.least_sigma[i / 3].powi(2));
        let covariance =
            jacobian * (anchor.covariance + Matrix6::from_diagonal(&least)) * jacobian.transpose();
        Step { time_s: anchor.time_s, measured: Some((value, covariance)) }
    }
}

/// The most probable states; the first measured one stands for where the path begins.
fn smooth(steps: &[Step]) -> Option<Vec<(State, StateCovariance)>> {
    let (first, _) = steps.iter().find_map(|step| step.measured)?;
    let mut state = State::zeros();
    state.fixed_rows_mut::<6>(0).copy_from(&first);
    let mut covariance = StateCovariance::zeros();
    for i in 0..6 {
        covariance[(i, i)] = RULES.unknown_pose_sigma[i / 3].powi(2);
        covariance[(i + 6, i + 6)] = RULES.unknown_velocity_sigma[i / 3].powi(2);
    }
    let (mut filtered, mut predicted) = (Vec::with_capacity(steps.len()), Vec::with_capacity(steps.len()));
    let mut before_s = steps[0].time_s;
    for step in steps {
        let (transition, noise) = motion(step.time_s - before_s);
        before_s = step.time_s;
        state = transition * state;
        covariance = transition * covariance * transition.transpose() + noise;
        predicted.push((state, covariance, transition));
        if let Some((value, value_covariance)) = &step.measured {
            let seen = covariance.fixed_view::<6, 6>(0, 0) + value_covariance;
            let cross: SMatrix<f64, 12, 6> = covariance.fixed_view::<12, 6>(0, 0).into_owned();
            let gain = seen.cholesky()?.solve(&cross.transpose()).transpose();
            state += gain * (value - state.fixed_rows::<6>(0));
            covariance -= gain * cross.transpose();
            covariance = 0.5 * (covariance + covariance.transpose());
        }
        filtered.push((state, covariance));
    }
    let mut smoothed = filtered.clone();
    for k in (0..steps.len() - 1).rev() {
        let (next_state, next_covariance, transition) = &predicted[k + 1];
        if steps[k + 1].time_s == steps[k].time_s {
            smoothed[k] = smoothed[k + 1];
            continue;
        }
        let gain = next_covariance.cholesky()?.solve(&(transition * filtered[k].1)).transpose();
        let (state, covariance) = filtered[k];
        smoothed[k].0 = state + gain * (smoothed[k + 1].0 - next_state);
        smoothed[k].1 = covariance + gain * (smoothed[k + 1].1 - next_covariance) * gain.transpose();
    }
    Some(smoothed)
}

/// Transition over a time, and the covariance of what acceleration does in it.
fn motion(step_s: f64) -> (StateCovariance, StateCovariance) {
    let (mut transition, mut noise) = (StateCovariance::identity(), StateCovariance::zeros());
    for i in 0..6 {
        let density = RULES.acceleration_scatter[i / 3].powi(2);
        transition[(i, i + 6)] = step_s;
        noise[(i, i)] = density * step_s.powi(3) / 3.0;
        noise[(i, i + 6)] = density * step_s * step_s / 2.0;
        noise[(i + 6, i)] = noise[(i, i + 6)];
        noise[(i + 6, i + 6)] = density * step_s;
    }
    (transition, noise)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn path(time_s: f64) -> Pose {
        let turn = Vector3::new(0.1 * (0.8 * time_s).sin(), 0.05 * time_s, 0.3 * time_s);
        let place = Vector3::new(4.0 * time_s, 0.4 * time_s * time_s, 60.0 + (0.7 * time_s).sin());
        Pose::from_parts(place.into(), exp(&Vector3::new(3.0, 0.2, 0.0)) * exp(&turn))
    }

    fn anchors(times_s: impl Iterator<Item = f64>, sigma: [f64; 2]) -> Vec<Anchor> {
        let variances = Vector6::from_fn(|i, _| sigma[i / 3].powi(2));
        let covariance = Matrix6::from_diagonal(&variances);
        times_s.map(|time_s| Anchor { time_s, pose: path(time_s), covariance }).collect()
    }

    fn frames(range: std::ops::Range<i32>) -> impl Iterator<Item = f64> {
        range.map(|k| f64::from(k) / 30.0)
    }

    fn gap(found: &(Pose, Matrix6<f64>), time_s: f64) -> [f64; 2] {
        let gap = pose_minus(&found.0, &path(time_s));
        [gap.fixed_rows::<3>(0).norm(), gap.fixed_rows::<3>(3).norm()]
    }

    #[test]
    fn a_gap_is_bridged_along_the_curve() {
        let (before, after) = (anchors(frames(0..10), [0.01, 1e-4]), anchors(frames(40..50), [0.01, 1e-4]));
        let times: Vec<f64> = frames(10..40).collect();
        for (found, time_s) in between(&before, &times, &after).unwrap().iter().zip(&times) {
            let [position_m, attitude_rad] = gap(found, *time_s);
            assert!(position_m < 0.02 && attitude_rad < 0.005, "{time_s}: {position_m} {attitude_rad}");
            let [sigma_m, sigma_rad] = super::super::frame::largest_sigmas(&found.1);
            assert!((0.001..0.3).contains(&sigma_m) && sigma_rad < 0.03, "{sigma_m} {sigma_rad}");
        }
    }

    #[test]
    fn the_ends_are_held_after_a_while() {
        let known = anchors(frames(30..40), [1e-3, 1e-5]);
        let times = [1.4, 1.8, 2.3, 9.0];
        let after = between(&known, &times, &[]).unwrap();
        assert!(gap(&after[0], 1.4)[0] < 0.05, "{:?}", gap(&after[0], 1.4));
        assert_eq!(after[2].0, after[3].0);
        let sigma_m = |found: &(Pose, Matrix6<f64>)| super::super::frame::largest_sigmas(&found.1)[0];
        assert!(sigma_m(&after[3]) > 10.0 * sigma_m(&after[1]));
        let ahead = between(&[], &[-3.0, 0.2, 0.9], &known).unwrap();
        assert!(gap(&ahead[2], 0.9)[0] < 0.05, "{:?}", gap(&ahead[2], 0.9));
        assert!(ahead[0].0 == ahead[1].0 || gap(&ahead[0], 0.5)[0] < 1.0);
    }

    #[test]
    fn one_known_pose_is_held_and_none_is_none() {
        let one = anchors(frames(0..1), [0.01, 1e-4]);
        let found = between(&one, &[0.5, 2.0], &[]).unwrap();
        assert!(gap(&found[1], 0.0)[0] < 1e-6, "{:?}", gap(&found[1], 0.0));
        assert!(between(&[], &[0.5], &[]).is_none());
    }

    /// The second road: the same path as one system of normal equations, with the same noise.
    #[test]
    fn the_smoother_is_the_least_squares_path() {
        let times: Vec<f64> = vec![0.0, 0.1, 0.25, 0.3, 0.7, 0.8];
        let known = anchors(times.iter().copied(), [0.05, 1e-3]);
        let (before, after) = (&known[..3], &known[4..]);
        let found = &between(before, &[0.3], after).unwrap()[0];
        // Along x alone: states (x, v) at six times.
        let n = 12;
        let mut normal = nalgebra::DMatrix::<f64>::zeros(n, n);
        let mut right = nalgebra::DVector::<f64>::zeros(n);
        for k in 0..6 {
            normal[(2 * k + 1, 2 * k + 1)] +=
                if k == 0 { RULES.unknown_velocity_sigma[0].powi(-2) } else { 0.0 };
            if k != 3 {
                let weight = 1.0 / (0.05_f64.powi(2) + RULES.least_sigma[0].powi(2));
                normal[(2 * k, 2 * k)] += weight;
                right[2 * k] += weight * known[k].pose.translation.x;
            }
            if k > 0 {
                let h = times[k] - times[k - 1];
                let noise = nalgebra::Matrix2::new(h.powi(3) / 3.0, h * h / 2.0, h * h / 2.0, h)
                    * RULES.acceleration_scatter[0].powi(2);
                let row = nalgebra::Matrix2x4::new(-1.0, -h, 1.0, 0.0, 0.0, -1.0, 0.0, 1.0);
                let weight = row.transpose() * noise.try_inverse().unwrap() * row;
                let mut view = normal.view_mut((2 * k - 2, 2 * k - 2), (4, 4));
                view += weight;
            }
        }
        let inverse = normal.try_inverse().unwrap();
        let wanted = &inverse * right;
        assert!((found.0.translation.x - wanted[6]).abs() < 1e-4, "{} {}", found.0.translation.x, wanted[6]);
        let sigma = inverse[(6, 6)].sqrt();
        assert!((found.1[(0, 0)].sqrt() / sigma - 1.0).abs() < 1e-3, "{} {sigma}", found.1[(0, 0)].sqrt());
    }
}
