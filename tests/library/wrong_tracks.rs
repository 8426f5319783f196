//! Tracks that are not of the body: static ones before a low camera, sliding and foreign ones.
//!
//! A camera 2 m above the ground sees a car turn slowly, as a camera on another vehicle does. Over half a second to a
//! second points of the background fit a point of the body within a few pixels.

use nalgebra::{Point3, Vector3};
use std::path::Path;
use trackbundle::geometry::align::similarity_fit;
use trackbundle::internals::files::read_problem;
use trackbundle::internals::refine::{RejectionReason, Tally};
use trackbundle::internals::simulate::{Chance, SimulatedVideo, World, parse};
use trackbundle::{Options, Outcome, adjust_problem};

const LOW: &str = r#"
format = 1
name = "low"
[camera]
model = "pinhole"
width = 1920
height = 1080
fx = 933.5
fy = 934.7
cx = 896.5
cy = 507.4
[film]
frames = 62
rate_hz = 10
[flight]
kind = "straight"
speed_mps = 0.3
direction_deg = 0
altitude_m = 2.0
tilt_deg = 80
drift_m = 0.05
sway_deg = 0.1
[[vehicle]]
id = "car"
heading_deg = 40
speed_mps = 2.0
curvature_per_m = 0.13
points = 120
track_s = 2.0
height_sigma_m = 0.03
[errors]
vehicle_px = 0.5
[camera_poses]
given = "known"
white_m = 0
white_deg = 0
slow_m = 0.01
slow_deg = 0.02
[vehicle_poses]
given = "start"
white_m = 0.02
white_deg = 0.3
slow_m = 0.07
slow_deg = 1.2
slow_s = 3
"#;

struct Found {
    /// Of the shape, relative.
    scale_error: f64,
    scale_sigma: f64,
    /// Root mean square over the points of the body after a similarity \[m\].
    shape_m: f64,
    /// Of the wrong tracks those of which nothing is used, and of the others those of which most is used.
    found: f64,
    kept: f64,
    tally: Tally,
    converged: bool,
}

/// Simulates and adjusts a run of the low camera with these errors.
fn run(errors: &str, raw: bool, run: u64) -> Found {
    let mut text = LOW.replace("vehicle_px = 0.5", &format!("vehicle_px = 0.5\n{errors}"));
    if raw {
        let poses = text.find("[vehicle_poses]").unwrap();
        text.truncate(poses);
        text += "[vehicle_poses]\ngiven = \"none\"\n";
    }
    let scenario = parse("low.toml", &text, std::path::Path::new("")).unwrap_or_else(|f| panic!("{f}"));
    let video = World::new(scenario, Some(1)).unwrap().video(Chance::Run(run)).unwrap();
    let outcome = adjust_problem(video.problem.clone(), &Options::default()).unwrap();
    judged(&video, &outcome)
}

fn judged(video: &SimulatedVideo, outcome: &Outcome) -> Found {
    let (vehicle, fits) = (&outcome.problem.vehicles[0], &outcome.adjustment().fits);
    let (mut seen, mut used) = (vec![0; vehicle.points.len()], vec![0; vehicle.points.len()]);
    for (o, verdict) in vehicle.observations.iter().zip(&fits.verdicts.vehicles[0]) {
        seen[o.point] += 1;
        used[o.point] += usize::from(verdict.reason().is_none());
    }
    let is_wrong = |point: &usize| video.wrong_tracks[0].contains_key(&vehicle.points[*point].id);
    let points = || (0..vehicle.points.len()).filter(|point| seen[*point] > 0);
    let share = |count: usize, of: usize| if of == 0 { 1.0 } else { count as f64 / of as f64 };
    let wrong: Vec<usize> = points().filter(is_wrong).collect();
    let right: Vec<usize> = points().filter(|point| !is_wrong(point)).collect();
    let found = wrong.iter().filter(|point| used[**point] == 0).count();
    let kept = right.iter().filter(|point| 2 * used[**point] >= seen[**point]).count();
    let (true_points, found_points) =
        (&video.truth.vehicles[0].points, &outcome.estimate().vehicles[0].points);
    let pairs: Vec<_> = right.iter().filter_map(|at| Some((true_points[*at]?, found_points[*at]?))).collect();
    let (scale, shape_m) = similarity(&pairs);
    Found {
        scale_error: scale - 1.0,
        scale_sigma: outcome.diagnosis.as_ref().unwrap().scales[0].sigma,
        shape_m,
        found: share(found, wrong.len()),
        kept: share(kept, right.len()),
        tally: fits.tally,
        converged: outcome.adjustment().stop.converged(),
    }
}

/// The scale of the similarity that lays the first of each pair on the second, and what is left: the root mean
/// square, of nine in ten points.
fn similarity(pairs: &[(Point3<f64>, Point3<f64>)]) -> (f64, f64) {
    let (from, to): (Vec<_>, Vec<_>) = pairs.iter().copied().unzip();
    let (scale, pose) = similarity_fit(&from, &to).unwrap();
    let off = |(from, to): &(Point3<f64>, Point3<f64>)| (to - pose * (from * scale)).norm_squared();
    let mut squares: Vec<f64> = pairs.iter().map(off).collect();
    squares.sort_by(f64::total_cmp);
    squares.truncate(9 * squares.len() / 10);
    (scale, (squares.iter().sum::<f64>() / squares.len() as f64).sqrt())
}

#[test]
fn static_tracks_before_a_low_camera_are_found() {
    let clean = run("", false, 0);
    assert!(clean.kept > 0.98, "{}", clean.kept);
    for share in [0.07, 0.4, 0.6] {
        let found = run(&format!("static_tracks = {share}"), false, 0);
        assert!(found.converged, "{share}");
        assert!(
            found.found >= 0.95 && found.kept >= 0.95,
            "{share}: found {}, kept {}",
            found.found,
            found.kept
        );
        let sigmas = found.scale_error / found.scale_sigma;
        assert!(sigmas.abs() < 3.0, "{share}: scale off by {sigmas} sigma");
        assert!(
            found.shape_m < 1.15 * clean.shape_m,
            "{share}: {} m, {} m without",
            found.shape_m,
            clean.shape_m
        );
        let named = found.tally.of(RejectionReason::Static) as f64 / found.tally.with_track() as f64;
        assert!(named > 0.9, "{share}: {named} of them named static");
    }
}

/// The distance of a track from the camera over that of the reference, in the mean; each position of the reference
/// with that of the nearest frame.
fn scale_of_track(outcome: &Outcome, reference: &Path) -> f64 {
    let problem = &outcome.problem;
    let mut sums = [0.0; 2];
    let text = std::fs::read_to_string(reference).unwrap();
    for line in text.lines().skip(1) {
        let numbers: Vec<f64> = line.split(',').skip(1).map(|cell| cell.parse().unwrap()).collect();
        let off_s = |frame: usize| (problem.frames[frame].time_s - numbers[0]).abs();
        let frame = (0..problem.frames.len()).min_by(|a, b| off_s(*a).total_cmp(&off_s(*b))).unwrap();
        let Some(pose) = &outcome.estimate().vehicles[0].poses[frame] else { continue };
        if off_s(frame) < 0.02 {
            let camera = outcome.estimate().camera_poses[frame].translation.vector;
            let [found, wanted] =
                [pose.translation.vector, Vector3::from_column_slice(&numbers[1..4])].map(|p| p - camera);
            sums[0] += found.dot(&wanted);
            sums[1] += wanted.norm_squared();
        }
    }
    sums[0] / sums[1]
}

#[test]
fn a_real_car_before_a_low_camera_has_its_size() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/turning-sedan");
    let problem = read_problem(&folder).unwrap_or_else(|findings| panic!("{findings}")).problem.unwrap();
    let outcome = adjust_problem(problem, &Options::default()).unwrap();
    assert!(outcome.adjustment().stop.converged());
    let sigma = outcome.diagnosis.as_ref().unwrap().scales[0].sigma;
    let error = scale_of_track(&outcome, &folder.join("reference/gnss.csv")) - 1.0;
    assert!(error.abs() < 0.03 && error.abs() < 3.0 * sigma, "{error} at {sigma}");
}
