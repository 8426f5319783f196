//! Measured position of an antenna \[m\]:
//!
//! ```text
//! t = m + (T - m - o) / (1 + q)      video time of a position that has the receiver's time T: offset o at the
//!                                    middle m of the film, drift q
//! p = sum_j L_j(t) (R_j a + t_j)     the antenna between three frames (Lagrange, quadratic in time)
//! r = p + s - measured               s a shift that all positions have in common
//!
//! dr/do = -p' / (1 + q)    dr/dq = -p' (T - m - o) / (1 + q)^2    dr/ds = 1
//! dr/dtj = L_j             dr/drj = -L_j Rj [a]x                  dr/da = sum_j L_j Rj
//! ```
//!
//! Between frames of a thirtieth of a second the error of the parabola is that of its third derivative, some
//! micrometres. The antenna `a` is tied to a shape point by the lever arm: `r = a - M - arm`.

use crate::geometry::skew;
use nalgebra::{Matrix3, Point3, Vector3};
use trackbundle_solver::manifold::{Manifold, read_point, read_pose};
use trackbundle_solver::residual::{Jacobian, Residual};

/// Clock offset \[s\], drift \[s/s\], shift \[m\].
pub const RECEIVER: Manifold = Manifold::Vector(5);

/// Blocks: vehicle poses of three frames, antenna in the vehicle frame, receiver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AntennaPosition {
    /// Video times of the frames \[s\].
    pub frames_s: [f64; 3],
    /// Time on the receiver's clock \[s\].
    pub time_s: f64,
    /// Middle of the film \[s\].
    pub middle_s: f64,
    /// What was measured.
    pub measured: Point3<f64>,
}

/// Video time of a time on a receiver's clock.
pub fn video_time_s(time_s: f64, middle_s: f64, offset_s: f64, drift: f64) -> f64 {
    middle_s + (time_s - middle_s - offset_s) / (1.0 + drift)
}

/// Weights of three values at a time, and their derivatives by it.
fn lagrange(times: &[f64; 3], t: f64) -> ([f64; 3], [f64; 3]) {
    let mut weights = [0.0; 3];
    let mut slopes = [0.0; 3];
    for j in 0..3 {
        let (a, b) = (times[(j + 1) % 3], times[(j + 2) % 3]);
        let scale = 1.0 / ((times[j] - a) * (times[j] - b));
        weights[j] = (t - a) * (t - b) * scale;
        slopes[j] = (2.0 * t - a - b) * scale;
    }
    (weights, slopes)
}

impl Residual<3, 5> for AntennaPosition {
    const MANIFOLDS: [Manifold; 5] =
        [Manifold::Pose, Manifold::Pose, Manifold::Pose, Manifold::POINT, RECEIVER];

    fn evaluate(&self, x: &[&[f64]; 5], jacobian: Option<&mut Jacobian<3, 5>>) -> Option<Vector3<f64>> {
        let antenna = read_point(x[3]);
        let [offset_s, drift] = [x[4][0], x[4][1]];
        let shift = Vector3::new(x[4][2], x[4][3], x[4][4]);
        let t = video_time_s(self.time_s, self.middle_s, offset_s, drift);
        let (weights, slopes) = lagrange(&self.frames_s, t);
        let poses = [0, 1, 2].map(|j| read_pose(x[j]));
        let places = poses.map(|pose| (pose * antenna).coords);
        let sum = |by: &[f64; 3]| places[0] * by[0] + places[1] * by[1] + places[2] * by[2];
        if let Some(jacobian) = jacobian {
            let mut by_antenna = Matrix3::zeros();
            for (j, pose) in poses.iter().enumerate() {
                let turn = weights[j] * pose.rotation.to_rotation_matrix().matrix();
                jacobian.set(j, 0, &(Matrix3::identity() * weights[j]));
                jacobian.set(j, 3, &-(turn * skew(&antenna.coords)));
                by_antenna += turn;
            }
            jacobian.set(3, 0, &by_antenna);
            let velocity = sum(&slopes);
            let rate = 1.0 + drift;
            jacobian.set(4, 0, &(-velocity / rate));
            jacobian.set(4, 1, &(-velocity * ((self.time_s - self.middle_s - offset_s) / (rate * rate))));
            jacobian.set(4, 2, &Matrix3::identity());
        }
        Some(sum(&weights) + shift - self.measured.coords)
    }
}

/// Blocks: antenna, and the shape point that it stands on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LeverArm {
    /// From the point to the antenna, in the vehicle frame \[m\].
    pub arm_m: Vector3<f64>,
}

impl Residual<3, 2> for LeverArm {
    const MANIFOLDS: [Manifold; 2] = [Manifold::POINT, Manifold::POINT];

    fn evaluate(&self, x: &[&[f64]; 2], jacobian: Option<&mut Jacobian<3, 2>>) -> Option<Vector3<f64>> {
        if let Some(jacobian) = jacobian {
            jacobian.set(0, 0, &Matrix3::identity());
            jacobian.set(1, 0, &-Matrix3::identity());
        }
        Some(read_point(x[0]) - read_point(x[1]) - self.arm_m)
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{assert_jacobian, vehicle_poses};
    use super::*;
    use trackbundle_solver::manifold::write_pose;

    #[test]
    fn the_jacobian_is_that_of_its_differences() {
        let poses = vehicle_poses().map(|pose| write_pose(&pose));
        let residual = AntennaPosition {
            frames_s: [10.0, 10.04, 10.07],
            time_s: 10.17,
            middle_s: 9.0,
            measured: Point3::new(1.0, 2.0, 1.5),
        };
        let receiver = [0.12, 2e-5, 0.03, -0.02, 0.01];
        assert_jacobian(&residual, &[&poses[0], &poses[1], &poses[2], &[0.4, -0.1, 1.6], &receiver]);
        let arm = LeverArm { arm_m: Vector3::new(0.0, 0.1, 0.05) };
        assert_jacobian(&arm, &[&[0.4, -0.1, 1.6], &[0.4, -0.2, 1.5]]);
    }

    /// Second road: a vehicle on a parabola, whose receiver runs late and fast.
    #[test]
    fn a_parabola_has_no_residual() {
        let place = |t: f64| Vector3::new(3.0 + 10.0 * t - 2.0 * t * t, 1.0 - 4.0 * t * t, 0.1 * t);
        let frames_s = [3.0, 3.04, 3.07];
        let pose = |t: f64| write_pose(&crate::geometry::pose(place(t).into(), [0.8, 0.0, 0.0, 0.6]));
        let poses = frames_s.map(pose);
        let antenna = [0.4, -0.1, 1.6];
        let (offset_s, drift, middle_s) = (0.12, 3e-5, 1.0);
        let t = 3.052;
        let turned = crate::geometry::pose([0.0; 3], [0.8, 0.0, 0.0, 0.6]) * Point3::from(antenna);
        let shift = Vector3::new(0.03, -0.02, 0.01);
        let residual = AntennaPosition {
            frames_s,
            time_s: t + offset_s + drift * (t - middle_s),
            middle_s,
            measured: Point3::from(place(t) + turned.coords + shift),
        };
        let receiver = [offset_s, drift, shift.x, shift.y, shift.z];
        let found = residual.evaluate(&[&poses[0], &poses[1], &poses[2], &antenna, &receiver], None);
        assert!(found.unwrap().norm() < 1e-12);
    }
}
