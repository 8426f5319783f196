//! Without noise the truth comes back: drives of every kind, from starting poses and from raw measurements.

use crate::support;

use crate::support::refine;
use nalgebra::Point3;
use support::drive::{Drive, Truth};
use trackbundle::estimate::Estimate;
use trackbundle::internals::files::read_problem;
use trackbundle::internals::initialise::{Method, initialise};
use trackbundle::internals::refine::{MotionPriors, RefineOptions};
use trackbundle::problem::Problem;

/// Straight, turning, reversing on a turn.
const MOTIONS: [[f64; 2]; 3] = [[11.0, 0.0], [14.0, 0.25], [-4.0, 0.3]];

fn exact(motion: [f64; 2]) -> Drive {
    Drive {
        frames: 90,
        motion,
        noise_px: [0.0; 2],
        camera_error: [0.0; 2],
        vehicle_error: [0.0; 2],
        ..Default::default()
    }
}

fn adjusted(drive: &Drive, without: &[&str]) -> (Problem, Truth, Estimate) {
    let folder = tempfile::tempdir().unwrap();
    let truth = drive.write(folder.path());
    without.iter().for_each(|file| std::fs::remove_file(folder.path().join(file)).unwrap());
    let problem = read_problem(folder.path()).unwrap_or_else(|f| panic!("{f}")).problem.unwrap();
    let start = initialise(&problem, Method::RobustWhereNeeded).unwrap().estimate;
    let options = RefineOptions { motion: MotionPriors::OFF, ..Default::default() };
    let (end, _) = refine(&problem, &start, &options, None).unwrap();
    (problem, truth, end)
}

/// Largest distance of any point of the vehicle in any frame from where it really was, which no choice of the
/// body's frame changes, and of any camera \[m\].
fn worst(estimate: &Estimate, truth: &Truth) -> [f64; 2] {
    let vehicle = &estimate.vehicles[0];
    let points: Vec<Point3<f64>> = vehicle.points.iter().map(|p| p.unwrap()).collect();
    let mut worst = [0.0_f64; 2];
    for (frame, (found, wanted)) in vehicle.poses.iter().zip(&truth.vehicles[0]).enumerate() {
        let Some(found) = found else { continue };
        for (point, (_, true_point)) in points.iter().zip(&truth.points) {
            worst[0] = worst[0].max((found * point - wanted * true_point).norm());
        }
        let camera =
            estimate.camera_poses[frame].translation.vector - truth.cameras[frame].translation.vector;
        worst[1] = worst[1].max(camera.norm());
    }
    worst
}

#[test]
fn the_truth_comes_back_from_starting_poses() {
    for motion in MOTIONS {
        let (_, truth, end) = adjusted(&exact(motion), &[]);
        let [vehicle, camera] = worst(&end, &truth);
        assert!(vehicle < 1e-6 && camera < 1e-6, "{motion:?}: {vehicle:e} {camera:e}");
    }
}

#[test]
fn the_truth_comes_back_from_raw_measurements() {
    for motion in MOTIONS {
        let (problem, truth, end) = adjusted(&exact(motion), &["camera_poses.csv", "vehicle_poses.csv"]);
        assert!(problem.camera_poses.iter().all(Option::is_none));
        let [vehicle, camera] = worst(&end, &truth);
        assert!(vehicle < 1e-6 && camera < 1e-6, "{motion:?}: {vehicle:e} {camera:e}");
    }
}
