//! Image points that an estimate predicts, each at the time of its row.

use super::Estimate;
use crate::geometry::{Pose, se3};
use crate::problem::Problem;
use nalgebra::{DMatrix, Point3, Vector2, Vector3, Vector6};

/// Motion is taken from frames this far before and after \[s\] ...
const HALF_SPAN_S: f64 = 0.1;
/// ... and from so many at least, on either side ...
const LEAST_FRAMES: usize = 2;
/// ... unless they are farther away than this: then nobody saw how it moved in between \[s\].
const FARTHEST_S: f64 = 0.75;
/// Of what degree the polynomial is whose slope is taken: that of a straight line would be short of swaying
/// motion by a hundredth.
const DEGREE: usize = 3;

/// How cameras see the static world and vehicles move, frame by frame: twists `[v; w]` in the camera frame,
/// `dX/dt = w x X + v` \[m/s, rad/s\].
#[derive(Clone, Debug)]
pub struct RowMotion {
    /// Of the static world.
    pub world: Vec<Vector6<f64>>,
    /// Of each vehicle; zero where it has no pose.
    pub vehicles: Vec<Vec<Vector6<f64>>>,
}

impl RowMotion {
    /// The motions of an estimate.
    pub fn new(problem: &Problem, estimate: &Estimate) -> RowMotion {
        let times: Vec<f64> = problem.frames.iter().map(|frame| frame.time_s).collect();
        let world: Vec<Option<Pose>> =
            estimate.camera_poses.iter().map(|pose| Some(pose.inverse())).collect();
        let of_vehicle = |vehicle: &super::VehicleEstimate| {
            let seen = estimate.camera_poses.iter().zip(&vehicle.poses);
            let seen: Vec<Option<Pose>> =
                seen.map(|(camera, pose)| Some(camera.inverse() * (*pose)?)).collect();
            twists(&times, &seen)
        };
        RowMotion {
            world: twists(&times, &world),
            vehicles: estimate.vehicles.iter().map(of_vehicle).collect(),
        }
    }
}

/// The twist of a body at each moment, from its poses around it: the slope of the polynomial of least squares
/// through `log(X_k X^-1)` (Savitzky and Golay 1964, for irregular times).
fn twists(times: &[f64], camera_from_body: &[Option<Pose>]) -> Vec<Vector6<f64>> {
    let known: Vec<(f64, Pose)> =
        times.iter().zip(camera_from_body).filter_map(|(time_s, pose)| Some((*time_s, (*pose)?))).collect();
    let mut of_known = (0..known.len()).map(|at| twist_at(&known, at));
    let twist = |pose: &Option<Pose>| pose.and_then(|_| of_known.next()).unwrap_or_else(Vector6::zeros);
    camera_from_body.iter().map(twist).collect()
}

fn twist_at(known: &[(f64, Pose)], at: usize) -> Vector6<f64> {
    let (time_s, pose) = &known[at];
    let is_around = |k: &usize| {
        let away_s = (known[*k].0 - time_s).abs();
        away_s < HALF_SPAN_S + 1e-6 || (k.abs_diff(at) <= LEAST_FRAMES && away_s < FARTHEST_S)
    };
    let first = (0..at).rev().take_while(is_around).last().unwrap_or(at);
    let last = (at..known.len()).take_while(is_around).last().unwrap_or(at);
    let count = last - first + 1;
    let degree = DEGREE.min(count - 1);
    if degree == 0 {
        return Vector6::zeros();
    }
    // In units of the span, so that powers stay well conditioned.
    let unit_s = (known[last].0 - known[first].0).max(f64::MIN_POSITIVE);
    let powers = DMatrix::from_fn(count, degree + 1, |row, power| {
        ((known[first + row].0 - time_s) / unit_s).powi(power as i32)
    });
    let Some(inverse) = (powers.tr_mul(&powers)).try_inverse() else { return Vector6::zeros() };
    let slope = (inverse * powers.transpose()).row(1) / unit_s;
    let inverse = pose.inverse();
    (first..=last).zip(slope.iter()).map(|(k, weight)| se3::log(&(known[k].1 * inverse)) * *weight).sum()
}

/// How an estimate is seen.
pub struct Imaging<'a> {
    estimate: &'a Estimate,
    motion: Option<RowMotion>,
}

impl<'a> Imaging<'a> {
    /// The image points of an estimate.
    pub fn new(problem: &Problem, estimate: &'a Estimate) -> Self {
        let motion = (estimate.readout_s != 0.0).then(|| RowMotion::new(problem, estimate));
        Imaging { estimate, motion }
    }

    /// The same from the motions of the estimate, where they are wanted as well.
    pub fn of_motion(motion: RowMotion, estimate: &'a Estimate) -> Self {
        Imaging { estimate, motion: Some(motion) }
    }

    /// Computed image point of a point of a vehicle; `None` where one of its unknowns has no value or the
    /// camera does not see it.
    pub fn vehicle_px(&self, vehicle: usize, frame: usize, point: usize) -> Option<Vector2<f64>> {
        let found = &self.estimate.vehicles[vehicle];
        let in_world = found.poses[frame]? * found.points[point]?;
        self.seen(frame, &in_world, |motion| &motion.vehicles[vehicle][frame])
    }

    /// Computed image point of a target at `position`.
    pub fn target_px(&self, frame: usize, position: &Point3<f64>) -> Option<Vector2<f64>> {
        self.seen(frame, position, |motion| &motion.world[frame])
    }

    fn seen<'m>(
        &'m self,
        frame: usize,
        in_world: &Point3<f64>,
        twist: impl Fn(&'m RowMotion) -> &'m Vector6<f64>,
    ) -> Option<Vector2<f64>> {
        let camera = &self.estimate.camera;
        let in_camera = self.estimate.camera_poses[frame].inverse_transform_point(in_world).coords;
        let plain = camera.project(&in_camera)?;
        let Some(motion) = &self.motion else { return Some(plain) };
        let twist = twist(motion);
        let at_row = |v_px: f64| -> Option<Vector2<f64>> {
            let moved = se3::exp(&(twist * (camera.row_delay(v_px) * self.estimate.readout_s)));
            let place: Vector3<f64> = moved.rotation * in_camera + moved.translation.vector;
            camera.project(&place)
        };
        // The row is that where it is seen by then.
        at_row(at_row(plain.y)?.y)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_twist_of_a_steady_motion_is_found_at_irregular_times_and_beside_gaps() {
        let twist = Vector6::new(9.0, -4.0, 0.5, 0.02, -0.3, 0.4);
        let start = crate::geometry::pose([1.0, 2.0, 60.0], [0.9, 0.1, 0.2, 0.3]);
        let times = [0.0, 0.03, 0.07, 0.1, 0.14, 0.2, 0.9, 1.0];
        let mut poses: Vec<Option<Pose>> =
            times.iter().map(|t| Some(se3::exp(&(twist * *t)) * start)).collect();
        poses[3] = None;
        let found = twists(&times, &poses);
        for (at, found) in found.iter().enumerate() {
            let wanted = if at == 3 { Vector6::zeros() } else { twist };
            assert!((found - wanted).norm() < 1e-9, "{at}: {found}");
        }
        assert_eq!(twists(&[0.0], &[Some(start)]), [Vector6::zeros()]);
    }

    #[test]
    fn a_swaying_motion_is_not_underrated() {
        let times: Vec<f64> = (0..60).map(|k| f64::from(k) / 30.0).collect();
        let sway = |t: f64| (std::f64::consts::TAU * t / 2.5).sin() * 0.01;
        let poses: Vec<Option<Pose>> =
            times.iter().map(|t| Some(se3::exp(&(Vector6::y() * sway(*t))))).collect();
        let found = twists(&times, &poses);
        let most = std::f64::consts::TAU / 2.5 * 0.01;
        for (at, t) in times.iter().enumerate().filter(|(at, _)| (3..57).contains(at)) {
            let wanted = (std::f64::consts::TAU * t / 2.5).cos() * most;
            assert!((found[at].y - wanted).abs() < 1e-3 * most, "{at}");
        }
    }
}
