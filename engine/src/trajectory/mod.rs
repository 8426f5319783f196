//! The path of a rigid body between and at the times of its poses: where it is, how fast it moves and
//! turns, and how well that follows from the poses.
//!
//! Body-frame acceleration (or jerk) is white noise. Around the pose `T_r` nearest to the time, the
//! poses `T_k` of a window have the coordinates
//!
//! ```text
//! xi_k = log(T_r^-1 T_k)
//! ```
//!
//! of which each component follows the scalar process of [`process`]; its mean gives `xi`, `dxi/dt`
//! and
//!
//! ```text
//! T(t) = T_r exp(xi),   [v; w] = J(xi) dxi/dt   in body axes, J the right Jacobian of SE(3)
//! ```
//!
//! A steady curve is a straight line in `xi`, exactly. Source: Anderson and Barfoot, *Full STEAM
//! ahead: exactly sparse Gaussian process regression for batch continuous-time trajectory estimation
//! on SE(3)*, IROS 2015; there velocities are unknowns beside the poses, here they are conditioned on
//! the poses.

mod linear;
pub mod process;

pub use linear::{Linear, StateBlock, StateCovariance};
pub use process::Order;

use crate::geometry::{self, Pose, se3};
use nalgebra::{Point3, Vector3, Vector6};
use process::{Conditional, conditional};
use std::ops::Range;

/// Beyond this turn from the nearest pose \[rad\] a window ends: logarithms wrap at pi.
const MOST_TURN_RAD: f64 = 2.0;

impl Order {
    /// How many knots on either side of a time count. The influence of a knot falls by 0.268 (0.431)
    /// from knot to knot, the decay of cubic (quintic) splines: `0.268^6 = 4e-4`, `0.431^11 = 1e-4`.
    /// What is left out is below 1e-3 of positions and velocities, even of knots that scatter freely.
    pub fn window(self) -> usize {
        match self {
            Order::Acceleration => 6,
            Order::Jerk => 11,
        }
    }
}

/// Roots of the spectral densities of the white noise: the scatter of its mean over one second.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Strengths {
    /// Of the position, per axis \[m/s^2, or m/s^3 where jerk is white\].
    pub linear: f64,
    /// Of the attitude, per axis \[rad/s^2, or rad/s^3 where jerk is white\].
    pub angular: f64,
}

/// The path of one rigid body.
#[derive(Clone, Debug, PartialEq)]
pub struct Trajectory {
    times_s: Vec<f64>,
    poses: Vec<Pose>,
    order: Order,
    strengths: Strengths,
}

/// Where a body is and how it moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct State {
    /// `world_from_body`.
    pub pose: Pose,
    /// Velocity of the body's origin in the world \[m/s\].
    pub velocity_mps: Vector3<f64>,
    /// Angular velocity in body axes \[rad/s\].
    pub angular_velocity_rps: Vector3<f64>,
    /// Acceleration of the body's origin in the world \[m/s^2\]: that of the mean path.
    pub acceleration_mps2: Vector3<f64>,
    /// Angular acceleration in body axes \[rad/s^2\]: that of the mean path.
    pub angular_acceleration_rps2: Vector3<f64>,
}

/// Coordinates around the nearest pose, and what they are at the time that was asked for.
struct Local {
    knots: Range<usize>,
    reference: usize,
    /// Of each knot.
    twists: Vec<Vector6<f64>>,
    path: Conditional,
    twist: Vector6<f64>,
    /// First and second derivative in time.
    rate: Vector6<f64>,
    second: Vector6<f64>,
}

impl Trajectory {
    /// The path through these poses `world_from_body`, whose times ascend \[s\].
    pub fn new(times_s: Vec<f64>, poses: Vec<Pose>, order: Order, strengths: Strengths) -> Self {
        assert_eq!(times_s.len(), poses.len(), "each pose has a time");
        assert!(times_s.windows(2).all(|pair| pair[0] < pair[1]), "times ascend");
        Trajectory { times_s, poses, order, strengths }
    }

    /// Times on the path, so many a second, at whole multiples of the step; at most a million.
    pub fn times_at(&self, rate_hz: f64) -> Vec<f64> {
        let (Some(first), Some(last)) = (self.times_s.first(), self.times_s.last()) else {
            return Vec::new();
        };
        let begin = (first * rate_hz - 1e-6).ceil();
        let count = ((last * rate_hz + 1e-6).floor() - begin + 1.0).clamp(0.0, 1e6) as usize;
        (0..count).map(|k| ((begin + k as f64) / rate_hz).clamp(*first, *last)).collect()
    }

    /// The mean of the path at a time \[s\]; beyond its ends with the twist (the twist and its
    /// change) of the end. `None` where there are fewer poses than [`Order::states`].
    pub fn state_at(&self, time_s: f64) -> Option<State> {
        let local = self.local(time_s)?;
        Some(local.state(&self.poses[local.reference]))
    }

    fn local(&self, time_s: f64) -> Option<Local> {
        let count = self.poses.len();
        if count < self.order.states() || !time_s.is_finite() {
            return None;
        }
        let before = self.times_s.partition_point(|t| *t <= time_s).saturating_sub(1).min(count - 2);
        let is_late = time_s - self.times_s[before] > self.times_s[before + 1] - time_s;
        let reference = before + usize::from(is_late);
        let inverse = self.poses[reference].inverse();
        let twist = |knot: usize| se3::log(&(inverse * self.poses[knot]));
        let is_near = |xi: &Vector6<f64>| se3::parts(xi).1.norm() < MOST_TURN_RAD;

        let window = self.order.window();
        let mut twists: Vec<Vector6<f64>> =
            ((before + 1).saturating_sub(window)..before).rev().map(twist).take_while(is_near).collect();
        let first = before - twists.len();
        twists.reverse();
        twists.extend([twist(before), twist(before + 1)]);
        twists.extend((before + 2..(before + 1 + window).min(count)).map(twist).take_while(is_near));
        let knots = first..first + twists.len();

        let path = conditional(self.order, &self.times_s[knots.clone()], time_s)?;
        let mean = |row: usize| -> Vector6<f64> {
            twists.iter().zip(path.weights.row(row).iter()).map(|(xi, weight)| xi * *weight).sum()
        };
        let (twist, rate, second) = (mean(0), mean(1), mean(2));
        Some(Local { knots, reference, twists, path, twist, rate, second })
    }
}

impl Local {
    fn state(&self, reference: &Pose) -> State {
        let pose = reference * se3::exp(&self.twist);
        let jacobian = se3::right_jacobian(&self.twist);
        let (v, w) = se3::parts(&(jacobian * self.rate));
        let change = se3::right_jacobian_slope(&self.twist, &self.rate) * self.rate + jacobian * self.second;
        let (dv, dw) = se3::parts(&change);
        State {
            pose,
            velocity_mps: pose.rotation * v,
            angular_velocity_rps: w,
            acceleration_mps2: pose.rotation * (dv + w.cross(&v)),
            angular_acceleration_rps2: dw,
        }
    }
}

impl State {
    /// Velocity of a point of the body, given in body axes, in the world \[m/s\].
    pub fn velocity_of(&self, point_in_body: &Point3<f64>) -> Vector3<f64> {
        self.velocity_mps + self.pose.rotation * self.angular_velocity_rps.cross(&point_in_body.coords)
    }

    /// Acceleration of a point of the body in the world \[m/s^2\].
    pub fn acceleration_of(&self, point_in_body: &Point3<f64>) -> Vector3<f64> {
        let (w, arm) = (self.angular_velocity_rps, point_in_body.coords);
        let about = self.angular_acceleration_rps2.cross(&arm) + w.cross(&w.cross(&arm));
        self.acceleration_mps2 + self.pose.rotation * about
    }

    /// Horizontal speed of a point of the body \[m/s\].
    pub fn speed_of_mps(&self, point_in_body: &Point3<f64>) -> f64 {
        self.velocity_of(point_in_body).xy().norm()
    }

    /// Heading of the body's x axis, as [`geometry::heading_rad`] \[rad\].
    pub fn heading_rad(&self) -> f64 {
        geometry::heading_rad(&self.pose)
    }

    /// How fast the heading grows \[rad/s\]; not a number where the x axis is upright.
    pub fn yaw_rate_rps(&self) -> f64 {
        let forward = self.pose.rotation * Vector3::x();
        let turning = self.pose.rotation * self.angular_velocity_rps.cross(&Vector3::x());
        (forward.x * turning.y - forward.y * turning.x) / forward.xy().norm_squared()
    }
}

#[cfg(test)]
mod tests;
