//! What is drawn of a result is the same, whether it comes from the adjustment or from its folder; and what it is
//! compared with lies where it belongs.

use crate::support;

use nalgebra::Point3;
use std::collections::BTreeMap;
use support::in_package;
use trackbundle::internals::diagnose::diagnose;
use trackbundle::internals::evaluate::{EvaluateOptions, evaluate, evaluate_shapes};
use trackbundle::internals::files::{
    RESIDUALS, read_points, read_poses, read_problem, read_residuals, read_tracks,
};
use trackbundle::internals::initialise::{Method, initialise};
use trackbundle::internals::reference::read_reference;
use trackbundle::internals::refine::{Progress, RefineOptions, adjust_network as adjust};
use trackbundle::internals::report::result_tables;
use trackbundle::internals::scene;
use trackbundle::internals::tables::Findings;
use trackbundle::problem::Problem;
use trackbundle_viz as viz;

const PROBLEM: &str = "problems/suv-noisy";

/// The scene of the adjustment, that of its folder, and the iterations.
struct Drawn {
    problem: Problem,
    adjusted: viz::Scene,
    read: viz::Scene,
    iterations: Vec<viz::Iteration>,
    folder: tempfile::TempDir,
}

fn drawn() -> Drawn {
    let problem = read_problem(&in_package(PROBLEM)).unwrap().problem.unwrap();
    let initial = initialise(&problem, Method::RobustWhereNeeded).unwrap();
    let mut iterations = Vec::new();
    let mut watch = |progress: Progress<'_>| {
        if let Progress::Iteration(record, estimate) = progress {
            iterations.push(scene::iteration(&problem, "stage", record, &estimate()));
        }
    };
    let options = RefineOptions::default();
    let mut found = adjust(&problem, &initial.estimate, &options, Some(&mut watch)).unwrap();
    let diagnosis = diagnose(&problem, &mut found).unwrap().unwrap();
    let precision = Some(&diagnosis.precision);
    let start = scene::start(&problem, &initial.estimate);
    let mut adjusted = start.clone();
    scene::add_end(&mut adjusted, &problem, &found.estimate, &found.adjustment.fits, precision);

    let folder = tempfile::tempdir().unwrap();
    for (name, bytes) in result_tables(&problem, &found.estimate, &found.adjustment.fits, precision) {
        std::fs::write(folder.path().join(name), bytes).unwrap();
    }
    let ids: Vec<String> = problem.vehicles.iter().map(|vehicle| vehicle.id.clone()).collect();
    let mut findings = Findings::default();
    let poses = read_poses(folder.path(), &problem.frames, &ids, &mut findings);
    let residuals = read_residuals(folder.path(), RESIDUALS, Some(&problem), &mut findings);
    let shapes = read_points(folder.path(), Some(&ids), &mut findings);
    let tracks = read_tracks(folder.path(), Some(&ids), Some(&problem.frames)).unwrap();
    assert!(!findings.is_invalid(), "{findings}");
    let mut read = start;
    let shown =
        scene::Shown { poses: &poses, tracks: &tracks, shapes: &shapes, residuals: residuals.as_ref() };
    scene::add_result(&mut read, &problem, shown);
    Drawn { problem, adjusted, read, iterations, folder }
}

fn apart(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    (0..3).map(|axis| (a[axis] - b[axis]).abs()).fold(0.0, f64::max)
}

#[test]
fn a_result_is_drawn_the_same_from_its_adjustment_and_from_its_folder() {
    let Drawn { adjusted, read, iterations, .. } = drawn();
    // Tables are rounded.
    let near = 1e-4;
    assert_eq!(adjusted.camera.after.len(), read.camera.after.len());
    for (a, b) in adjusted.camera.after.iter().zip(&read.camera.after) {
        assert!(apart(&a.position_m, &b.position_m) < near);
    }
    let [a, b] = [&adjusted, &read].map(|scene| &scene.bodies[0].after);
    assert!(a.points_m.iter().zip(&b.points_m).all(|(a, b)| apart(a, b) < near));
    assert_eq!((a.points_m.len(), a.poses.len()), (b.points_m.len(), b.poses.len()));
    for (a, b) in a.sigmas_m.iter().zip(&b.sigmas_m) {
        assert!(apart(&a.unwrap(), &b.unwrap()) < near);
    }
    assert_eq!(a.track.len(), b.track.len());
    for (a, b) in a.track.iter().zip(&b.track) {
        assert_eq!(a.frame, b.frame);
        assert!(apart(&a.position_m, &b.position_m) < near);
        assert!((a.speed_mps.unwrap() - b.speed_mps.unwrap()).abs() < 1e-3);
        let [a, b] = [a.precision.unwrap(), b.precision.unwrap()];
        assert!(apart(&a.sigma_m, &b.sigma_m) < near);
    }
    let mut counts = BTreeMap::new();
    for (a, b) in adjusted.image_points.iter().flatten().zip(read.image_points.iter().flatten()) {
        assert_eq!(
            (a.kind, a.observed_px, a.marking, a.reason),
            (b.kind, b.observed_px, b.marking, b.reason)
        );
        *counts.entry(format!("{:?}", a.marking)).or_insert(0) += 1;
        let away = |p: &viz::ImagePoint| p.computed_px.map(|c| [c[0], c[1], 0.0]);
        if let (Some(a), Some(b)) = (away(a), away(b)) {
            assert!(apart(&a, &b) < 2e-3, "{a:?} {b:?}");
        }
    }
    assert!(counts["Good"] > 10_000, "{counts:?}");
    // The last state on the way is the adjusted one: what follows chooses the frame of the body, not the track.
    let last = iterations.last().unwrap();
    assert_eq!(last.state.camera.len(), adjusted.camera.after.len());
    let end = &last.state.bodies[0];
    for (a, b) in end.track_m.iter().zip(&a.track) {
        assert!(apart(a, &b.position_m) < 1e-3, "{a:?} {:?}", b.position_m);
    }
    assert!(iterations.len() > 5 && iterations[0].step.is_none() && iterations[1].step.is_some());
    assert!(apart(&iterations[0].state.camera[0].position_m, &adjusted.camera.before[0].position_m) < 1e-9);
}

#[test]
fn references_lie_where_they_were_measured() {
    let Drawn { problem, mut read, folder, .. } = drawn();
    let ids: Vec<String> = problem.vehicles.iter().map(|vehicle| vehicle.id.clone()).collect();
    let reference = read_reference(&in_package(PROBLEM), &ids).unwrap();
    let tracks = read_tracks(folder.path(), Some(&ids), Some(&problem.frames)).unwrap();
    let shapes = read_points(folder.path(), Some(&ids), &mut Findings::default());
    let options = EvaluateOptions::default();
    let mut evaluation = evaluate(&ids, &tracks.tracks, &reference, &[], &options);
    evaluation.shapes = evaluate_shapes(&ids, &shapes, &reference, &[], &options).0;
    scene::add_comparison(&mut read, &problem, &evaluation);
    let body = &read.bodies[0];
    assert!(body.reference.len() > 50);
    let mut with_course = 0;
    for place in &body.reference {
        let own = body.after.track.iter().find(|t| t.frame == place.frame).unwrap();
        for axis in 0..3 {
            let difference = own.position_m[axis] - place.position_m[axis];
            assert!((difference - place.difference_m[axis]).abs() < 1e-9);
        }
        assert!(place.difference_m.iter().all(|d| d.abs() < 1.0), "{place:?}");
        // The course of a car that drives on is its heading; at the ends of its track there may be none.
        if let Some(course_deg) = place.course_deg {
            let off = (course_deg - own.heading_deg).rem_euclid(360.0);
            assert!(off.min(360.0 - off) < 5.0, "{off}");
            with_course += 1;
        }
    }
    assert!(with_course > 50, "{with_course}");
    // The scan is brought to the body: distances are those of its points, the long way.
    let scan = body.scan.as_ref().unwrap();
    assert!(scan.points_m.len() > 1000);
    let points: Vec<Point3<f64>> = body.after.points_m.iter().map(|p| Point3::from(*p)).collect();
    for (place, distance) in scan.points_m.iter().zip(&scan.distances_m).step_by(37) {
        let nearest = points.iter().map(|p| (p - Point3::from(*place)).norm()).fold(f64::INFINITY, f64::min);
        assert!((nearest - distance).abs() < 1e-9, "{nearest} {distance}");
    }
    let of_scan: Vec<Point3<f64>> = scan.points_m.iter().map(|p| Point3::from(*p)).collect();
    assert_eq!(scan.shape_distances_m.len(), points.len());
    for (place, distance) in points.iter().zip(&scan.shape_distances_m).step_by(11) {
        let nearest = of_scan.iter().map(|p| (p - place).norm()).fold(f64::INFINITY, f64::min);
        assert!((nearest - distance.unwrap()).abs() < 1e-9);
    }
    scene::add_map(&mut read, |place| Some([45.0 + 1e-5 * place.y, 11.0 + 1e-5 * place.x]));
    let map = read.map.as_ref().unwrap();
    let [latitude, longitude] = map.tracks[0].after_deg[3];
    let place = read.bodies[0].after.track[3].position_m;
    assert!((latitude - 45.0 - 1e-5 * place[1]).abs() < 1e-12);
    assert!((longitude - 11.0 - 1e-5 * place[0]).abs() < 1e-12);
    assert_eq!(map.tracks[0].reference_deg.len(), read.bodies[0].reference.len());
    assert_eq!(map.camera_deg.len(), problem.frames.len());
}
