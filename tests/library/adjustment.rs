//! The adjustment against simulated drives whose truth is known.

use crate::support;

use crate::support::refine;
use nalgebra::{Point3, Vector3};
use std::sync::Arc;
use support::drive::{Drive, Truth};
use trackbundle::estimate::{Depth, Estimate, LeftOut};
use trackbundle::geometry::{Pose, align::rigid_fit, rotation::exp};
use trackbundle::internals::files::read_problem;
use trackbundle::internals::initialise::{Method, initialise};
use trackbundle::internals::refine::{Adjustment, MotionPriors, NoSolution, RefineOptions};
use trackbundle::problem::{Known, Problem};
use trackbundle::terrain::{Grid, Terrain};
use trackbundle_solver::loss::LossName;

fn problem(drive: &Drive) -> (Problem, Truth) {
    let folder = tempfile::tempdir().unwrap();
    let truth = drive.write(folder.path());
    let folder = read_problem(folder.path()).unwrap_or_else(|findings| panic!("{findings}"));
    (folder.problem.unwrap(), truth)
}

fn start(problem: &Problem) -> Estimate {
    initialise(problem, Method::RobustWhereNeeded).unwrap().estimate
}

fn adjust(problem: &Problem) -> (Estimate, Adjustment) {
    refine(problem, &start(problem), &RefineOptions::default(), None).unwrap()
}

/// Root mean square distance of the points after a rigid fit \[m\].
fn shape_error(estimate: &Estimate, vehicle: usize, truth: &Truth) -> f64 {
    let found: Vec<Point3<f64>> = estimate.vehicles[vehicle].points.iter().map(|p| p.unwrap()).collect();
    let wanted: Vec<Point3<f64>> = truth.points.iter().map(|(_, p)| *p).collect();
    let fit = rigid_fit(&found, &wanted).unwrap();
    rms(found.iter().zip(&wanted).map(|(a, b)| (fit * a - b).norm()))
}

/// Root mean square distance of the mark's track \[m\].
fn track_error(estimate: &Estimate, problem: &Problem, vehicle: usize, truth: &Truth) -> f64 {
    let track = estimate.vehicles[vehicle].track(problem, &problem.vehicles[vehicle]);
    assert_eq!(track.len(), truth.mark(vehicle).len());
    rms(track.iter().zip(truth.mark(vehicle)).map(|(a, b)| (a.position - b).norm()))
}

/// Size of the estimated shape over that of the true one.
fn scale(estimate: &Estimate, truth: &Truth) -> f64 {
    let size = |points: &[Point3<f64>]| {
        let mean = points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / points.len() as f64;
        rms(points.iter().map(|p| (p.coords - mean).norm()))
    };
    let found: Vec<Point3<f64>> = estimate.vehicles[0].points.iter().flatten().copied().collect();
    size(&found) / size(&truth.points.iter().map(|(_, p)| *p).collect::<Vec<_>>())
}

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let values: Vec<f64> = values.collect();
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

#[test]
fn noise_free_data_come_back_from_a_wrong_start() {
    let exact =
        Drive { noise_px: [0.0; 2], camera_error: [0.0; 2], vehicle_error: [0.0; 2], ..Default::default() };
    let (problem, truth) = problem(&exact);
    let mut start = start(&problem);
    for (frame, pose) in start.vehicles[0].poses.iter_mut().flatten().enumerate() {
        let wave =
            Vector3::new((1.0 + frame as f64).sin(), (2.0 * frame as f64).cos(), (0.5 * frame as f64).sin());
        *pose = Pose::from_parts(
            (pose.translation.vector + wave * 0.3).into(),
            pose.rotation * exp(&(wave * 0.03)),
        );
    }
    for point in start.vehicles[0].points.iter_mut().flatten() {
        *point += Vector3::new(0.1, -0.1, 0.2) * point.x;
    }
    // A motion prior is no part of the truth: this drive turns.
    for loss in [LossName::None, LossName::Tukey] {
        let options = RefineOptions { motion: MotionPriors::OFF, loss, ..Default::default() };
        let (end, adjustment) = refine(&problem, &start, &options, None).unwrap();
        assert!(adjustment.stop.converged() && adjustment.initial_cost > 100.0, "{:?}", adjustment.stop);
        assert!(shape_error(&start, 0, &truth) > 0.05);
        assert!(shape_error(&end, 0, &truth) < 1e-6, "{loss}: {}", shape_error(&end, 0, &truth));
        assert!(track_error(&end, &problem, 0, &truth) < 1e-6, "{loss}");
        assert!(adjustment.final_cost < 1e-6);
    }
}

#[test]
fn wrong_poses_are_refined_to_the_noise_of_the_image() {
    let (problem, truth) = problem(&Drive::default());
    let start = start(&problem);
    let (end, adjustment) = adjust(&problem);
    assert!(adjustment.stop.converged());
    assert!(track_error(&start, &problem, 0, &truth) > 0.3);
    assert!(track_error(&end, &problem, 0, &truth) < 0.03, "{}", track_error(&end, &problem, 0, &truth));
    assert!(shape_error(&end, 0, &truth) < 0.04, "{}", shape_error(&end, 0, &truth));
    let sigma0 = adjustment.sigma0.unwrap();
    assert!((0.95..1.05).contains(&sigma0), "sigma0 {sigma0}");
    assert!(
        (adjustment.rms_px[0].unwrap() - 1.0).abs() < 0.05
            && (adjustment.rms_px[1].unwrap() - 1.0).abs() < 0.1
    );
    assert_eq!(adjustment.fits.outliers, 0);
}

#[test]
fn gross_errors_spoil_the_plain_start_and_neither_the_robust_one_nor_the_result() {
    let drive = Drive { gross: (0.3, [50.0, 600.0]), seed: 3, ..Default::default() };
    let (problem, truth) = problem(&drive);
    let robust = initialise(&problem, Method::RobustWhereNeeded).unwrap();
    let plain = initialise(&problem, Method::Plain).unwrap();
    assert!(robust.robust_points > 35, "{}", robust.robust_points);
    // Median distance of the points from where they are, in the body's own frame.
    let off = |estimate: &Estimate| {
        let pairs = estimate.vehicles[0].points.iter().zip(&truth.points);
        support::score::median(pairs.map(|(found, (_, truth))| (found.unwrap() - truth).norm()).collect())
    };
    let (plain_m, robust_m) = (off(&plain.estimate), off(&robust.estimate));
    assert!(plain_m > 3.0, "the plain start is {plain_m} m off");
    assert!(robust_m < 0.6, "the robust start is {robust_m} m off");

    let (end, adjustment) = refine(&problem, &robust.estimate, &RefineOptions::default(), None).unwrap();
    assert!(adjustment.stop.converged());
    let (clean_problem, _) = self::problem(&Drive { gross: (0.0, [0.0; 2]), ..drive });
    let (clean, _) = adjust(&clean_problem);
    let (with, without) = (shape_error(&end, 0, &truth), shape_error(&clean, 0, &truth));
    assert!(with < 1.5 * without, "shape {with} m, {without} m without gross errors");
    assert!(track_error(&end, &problem, 0, &truth) < 0.03, "{}", track_error(&end, &problem, 0, &truth));
    let observed = problem.vehicles[0].observations.len();
    let share = adjustment.fits.outliers as f64 / observed as f64;
    assert!((share - 0.3).abs() < 0.03, "{share} of {observed} were rejected");
}

#[test]
fn several_vehicles_share_the_cameras_of_their_frames() {
    let (problem, truth) =
        problem(&Drive { vehicles: 3, points: 20, visibility: 0.7, seed: 4, ..Default::default() });
    let (end, adjustment) = adjust(&problem);
    assert!(adjustment.stop.converged());
    for vehicle in 0..3 {
        assert!(
            track_error(&end, &problem, vehicle, &truth) < 0.06,
            "{vehicle}: {}",
            track_error(&end, &problem, vehicle, &truth)
        );
    }
    assert_eq!(adjustment.motion.len(), 4, "the camera and three vehicles");
}

/// Starting poses that are wrong together must not settle the scale: here all of them lie a metre too
/// near to the camera, with a stated standard deviation of 0.2 m.
#[test]
fn starting_poses_that_are_wrong_together_do_not_pull_the_scale() {
    let (mut problem, truth) = problem(&Drive::default());
    for (pose, camera) in problem.vehicles[0].poses.iter_mut().zip(&truth.cameras) {
        let pose = pose.as_mut().unwrap();
        let ray = pose.translation.vector - camera.translation.vector;
        pose.translation.vector -= ray.normalize();
    }
    let start = start(&problem);
    assert!((scale(&start, &truth) - 1.0).abs() > 0.01, "{}", scale(&start, &truth));
    let (end, _) = adjust(&problem);
    assert!((scale(&end, &truth) - 1.0).abs() < 0.003, "{}", scale(&end, &truth));
}

#[test]
fn a_known_height_of_the_body_fixes_the_scale_too() {
    let settings =
        format!("marker = \"mark\"\nheight_m = {}\nheight_sigma_m = 0.01\n", support::drive::MARK_HEIGHT_M);
    let (problem, truth) =
        problem(&Drive { knows_mark: false, vehicle_settings: settings, ..Default::default() });
    let (end, adjustment) = adjust(&problem);
    assert!(adjustment.warnings.is_empty(), "{:?}", adjustment.warnings);
    assert!((scale(&end, &truth) - 1.0).abs() < 0.005, "{}", scale(&end, &truth));
}

#[test]
fn a_scale_that_nothing_fixes_is_said_to_be_so() {
    let (problem, truth) = problem(&Drive { knows_mark: false, ..Default::default() });
    let (end, adjustment) = adjust(&problem);
    assert!(
        adjustment.warnings.iter().any(|w| w.to_string().starts_with("scale of car0")),
        "{:?}",
        adjustment.warnings
    );
    // It stays where the starting poses have it, whatever the motion prior would like.
    assert!((scale(&end, &truth) - 1.0).abs() < 0.02, "{}", scale(&end, &truth));
}

/// Poses that were found are starting values: what the table's noise would have said of them, exact
/// even, does not hold them.
#[test]
fn poses_that_were_found_are_refined_as_those_that_were_given() {
    let drive = Drive { frames: 90, camera_error: [0.05, 0.001], ..Default::default() };
    let settings = drive.settings.replace("vehicle_position_m = 0.2", "vehicle_position_m = 0.0");
    let settings = settings.replace("vehicle_rotation_deg = 1.2", "vehicle_rotation_deg = 0.0");
    let (mut problem, truth) = problem(&Drive { settings, ..drive });
    problem.vehicles[0].poses.iter_mut().for_each(|pose| *pose = None);
    let found = start(&problem);
    let (adjusted, _) = adjust(&problem);
    let errors = [&found, &adjusted].map(|estimate| track_error(estimate, &problem, 0, &truth));
    println!("found {:.4} m, adjusted {:.4} m", errors[0], errors[1]);
    assert!(errors[0] < 0.2 && errors[1] < 0.04, "{errors:?}");
    assert!(shape_error(&adjusted, 0, &truth) < 0.03);
    assert!(found.vehicles[0].poses.iter().zip(&adjusted.vehicles[0].poses).all(|(a, b)| a != b));
}

#[test]
fn what_is_exact_is_held() {
    let settings = "camera_position_m = 0.0\ncamera_rotation_deg = 0.25\nvehicle_position_m = 0.0\nvehicle_rotation_deg = 0.0\n";
    let drive = Drive {
        settings: settings.to_owned(),
        camera_error: [0.0, 0.004],
        vehicle_error: [0.0; 2],
        ..Default::default()
    };
    let (problem, truth) = problem(&drive);
    let start = start(&problem);
    let (end, _) = adjust(&problem);
    assert_eq!(end.vehicles[0].poses, start.vehicles[0].poses);
    let turn = |estimate: &Estimate| {
        rms(estimate.camera_poses.iter().zip(&truth.cameras).map(|(a, b)| a.rotation.angle_to(&b.rotation)))
    };
    for (found, given) in end.camera_poses.iter().zip(&start.camera_poses) {
        assert_eq!(found.translation, given.translation);
        assert_ne!(found.rotation, given.rotation);
    }
    assert!(turn(&end) < 0.1 * turn(&start), "{} {}", turn(&end), turn(&start));
}

#[test]
fn cameras_that_nothing_holds_are_held_as_given() {
    let settings = "vehicle_position_m = 0.2\nvehicle_rotation_deg = 1.2\n[terrain]\nplane_z = 0.0\n";
    let (problem, _) = problem(&Drive { settings: settings.to_owned(), targets: 0, ..Default::default() });
    let (end, adjustment) = adjust(&problem);
    assert!(end.camera_poses.iter().zip(&problem.camera_poses).all(|(end, given)| Some(*end) == *given));
    assert!(
        adjustment.warnings.iter().any(|w| w.to_string().starts_with("camera poses are held as given")),
        "{:?}",
        adjustment.warnings
    );
}

#[test]
fn starting_values_of_cameras_do_not_matter_where_targets_hold_them() {
    let settings = "vehicle_position_m = 0.2\nvehicle_rotation_deg = 1.2\n[terrain]\nplane_z = 0.0\n";
    let (problem, truth) = problem(&Drive { settings: settings.to_owned(), ..Default::default() });
    let (end, adjustment) = adjust(&problem);
    assert!(adjustment.warnings.is_empty(), "{:?}", adjustment.warnings);
    assert!(track_error(&end, &problem, 0, &truth) < 0.03, "{}", track_error(&end, &problem, 0, &truth));
}

#[test]
fn check_points_are_compared_with_and_never_adjusted_to() {
    let (problem, _) = problem(&Drive { check: 4, ..Default::default() });
    let mut moved = problem.clone();
    for target in &mut moved.targets[..4] {
        target.known[0].as_mut().unwrap().value_m += 5.0;
    }
    let (end, adjustment) = adjust(&problem);
    let (end_moved, adjustment_moved) = adjust(&moved);
    assert_eq!(end.camera_poses, end_moved.camera_poses);
    assert_eq!(end.vehicles, end_moved.vehicles);
    assert_eq!(adjustment.check_points.len(), 4);
    assert_eq!(adjustment.final_cost, adjustment_moved.final_cost);
    let checked = |fits: &trackbundle::internals::refine::Fits| -> Vec<f64> {
        let of_check = problem.target_observations.iter().zip(&fits.targets).filter(|(o, _)| o.target < 4);
        of_check
            .map(|(_, fit)| fit.unwrap())
            .inspect(|fit| assert_eq!(fit.weight, 0.0))
            .map(|f| f.residual_px.norm())
            .collect()
    };
    assert!(rms(checked(&adjustment.fits).into_iter()) < 3.0);
    assert!(rms(checked(&adjustment_moved.fits).into_iter()) > 100.0, "5 m are more than 200 px");
}

#[test]
fn the_bias_of_the_terrain_is_found_where_poses_are_known() {
    let settings = "camera_position_m = 0.0\ncamera_rotation_deg = 0.0\nvehicle_position_m = 0.0\nvehicle_rotation_deg = 0.0\n\
                    [terrain]\nplane_z = -0.35\nbias_sigma_m = 0.5\n";
    let drive = Drive {
        settings: settings.to_owned(),
        camera_error: [0.0; 2],
        vehicle_error: [0.0; 2],
        ..Default::default()
    };
    let (problem, _) = problem(&drive);
    let (end, _) = adjust(&problem);
    assert!((end.terrain_bias_m - 0.35).abs() < 0.01, "{}", end.terrain_bias_m);
}

/// The same problem, moved in the world, on a grid that has these heights.
fn moved_onto_grid(problem: &Problem, motion: &Pose, height_m: impl Fn(f64, f64) -> f64) -> Problem {
    let mut moved = problem.clone();
    moved.camera_poses.iter_mut().flatten().for_each(|pose| *pose = motion * *pose);
    for pose in moved.vehicles.iter_mut().flat_map(|vehicle| vehicle.poses.iter_mut().flatten()) {
        *pose = motion * *pose;
    }
    for target in &mut moved.targets {
        let place = motion * target.surveyed().unwrap();
        for (known, value_m) in target.known.iter_mut().zip(place.iter()) {
            known.as_mut().unwrap().value_m = *value_m;
        }
    }
    let node = |at: usize| 7.0 * at as f64 - 350.0;
    let heights = (0..101).flat_map(|j| (0..101).map(move |i| (node(i), node(j))));
    let heights = heights.map(|(x, y)| height_m(x, y)).collect();
    let grid = Grid::new([node(0), node(0)], [7.0, 7.0], [101, 101], heights).unwrap();
    moved.ground.as_mut().unwrap().terrain = Terrain::Grid(Arc::new(grid));
    moved
}

/// Largest distance of two tracks \[m\].
fn apart(a: (&Estimate, &Problem), b: (&Estimate, &Problem), b_from_a: &Pose) -> f64 {
    let track = |(estimate, problem): (&Estimate, &Problem)| {
        estimate.vehicles[0].track(problem, &problem.vehicles[0]).into_iter().map(|t| t.position)
    };
    track(a).zip(track(b)).map(|(a, b)| (b_from_a * a - b).norm()).fold(0.0, f64::max)
}

#[test]
fn a_grid_holds_a_vehicle_as_a_plane_does() {
    let options = RefineOptions { motion: MotionPriors::OFF, ..Default::default() };
    let adjust = |problem: &Problem| {
        let (end, adjustment) = refine(problem, &start(problem), &options, None).unwrap();
        assert!(adjustment.warnings.is_empty(), "{:?}", adjustment.warnings);
        end
    };
    let (on_plane, _) = problem(&Drive::default());
    let end = adjust(&on_plane);
    let level = moved_onto_grid(&on_plane, &Pose::identity(), |_, _| 0.0);
    let distance = apart((&end, &on_plane), (&adjust(&level), &level), &Pose::identity());
    assert!(distance < 1e-9, "{distance}");

    // The world tilted by 4 degrees. What stands on it does so the same, but for the cosine between a
    // height and a distance from the ground.
    let tilt = 4_f64.to_radians();
    let motion = Pose::new(Vector3::new(0.0, 0.0, 12.0), Vector3::y() * -tilt);
    let sloping = moved_onto_grid(&on_plane, &motion, |x, _| 12.0 + x * tilt.tan());
    let distance = apart((&end, &on_plane), (&adjust(&sloping), &sloping), &motion);
    assert!(distance < 1e-3, "{distance}");
}

#[test]
fn a_vehicle_that_leaves_the_grid_is_tied_as_long_as_it_is_on_it() {
    let (on_plane, truth) = problem(&Drive::default());
    let (mut cut, mut without) = (on_plane.clone(), on_plane.clone());
    let place = on_plane.vehicles[0].poses[30].unwrap().translation;
    let grid = Grid::new([place.x, -350.0], [350.0, 350.0], [2, 3], vec![0.0; 6]).unwrap();
    cut.ground.as_mut().unwrap().terrain = Terrain::Grid(Arc::new(grid));
    without.ground = None;
    let (end, adjustment) = adjust(&cut);
    let [warning] = adjustment.warnings.as_slice() else { panic!("{:?}", adjustment.warnings) };
    assert!(warning.to_string().starts_with("vehicle car0: poses without ground below them"), "{warning}");
    // From frame 33 on it is on the grid.
    let height_error = |end: &Estimate, problem: &Problem| {
        let track = end.vehicles[0].track(problem, &problem.vehicles[0]);
        let errors = track.iter().zip(truth.mark(0)).map(|(found, mark)| (found.position.z - mark.z).abs());
        errors.skip(33).fold(0.0, f64::max)
    };
    let errors = [height_error(&end, &cut), height_error(&adjust(&without).0, &without)];
    assert!(errors[0] < 0.01 && errors[1] > 0.02, "{errors:?}");
}

#[test]
fn a_gap_is_bridged_and_the_track_has_no_hole() {
    let folder = tempfile::tempdir().unwrap();
    let truth = Drive::default().write(folder.path());
    for file in ["vehicle_observations.csv", "vehicle_poses.csv"] {
        let path = folder.path().join(file);
        let text = std::fs::read_to_string(&path).unwrap();
        let kept = text.lines().filter(|line| {
            let frame = line.split(',').next().unwrap().parse::<i64>();
            !frame.is_ok_and(|frame| (20..26).contains(&frame) || frame < 3)
        });
        std::fs::write(&path, kept.collect::<Vec<_>>().join("\n")).unwrap();
    }
    let problem = read_problem(folder.path()).unwrap().problem.unwrap();
    for motion in [MotionPriors::ESTIMATED, MotionPriors::OFF] {
        let options = RefineOptions { motion, ..Default::default() };
        let (end, adjustment) = refine(&problem, &start(&problem), &options, None).unwrap();
        assert!(adjustment.stop.converged());
        let track = end.vehicles[0].track(&problem, &problem.vehicles[0]);
        assert_eq!(track.first().unwrap().frame, 3);
        assert_eq!(track.len(), 57);
        let worst = track.iter().map(|t| (t.position - truth.mark(0)[t.frame]).norm()).fold(0.0, f64::max);
        assert!(worst < 0.3, "{motion:?}: {worst}");
    }
}

#[test]
fn tie_points_are_intersected_and_adjusted() {
    let folder = tempfile::tempdir().unwrap();
    let truth = Drive { camera_error: [0.1, 0.001], ..Default::default() }.write(folder.path());
    let path = folder.path().join("targets.csv");
    let text = std::fs::read_to_string(&path).unwrap();
    let tie =
        |line: &str| if line.starts_with("T00") { "T00,,,,,,,control".to_owned() } else { line.to_owned() };
    std::fs::write(&path, text.lines().map(tie).collect::<Vec<_>>().join("\n")).unwrap();
    let problem = read_problem(folder.path()).unwrap().problem.unwrap();
    let initial = initialise(&problem, Method::RobustWhereNeeded).unwrap();
    // This camera hovers: the depth of a tie point is open, and it is left out by name.
    assert!(
        initial.warnings.iter().any(|w| w.to_string().ends_with("left out: T00")),
        "{:?}",
        initial.warnings
    );
    let (end, adjustment) = refine(&problem, &initial.estimate, &RefineOptions::default(), None).unwrap();
    assert!(adjustment.fits.not_used > 0);
    assert!(track_error(&end, &problem, 0, &truth) < 0.03);
}

#[test]
fn no_vehicle_left_is_no_solution() {
    let (problem, _) = problem(&Drive { points: 1, ..Default::default() });
    let start = start(&problem);
    let reason = start.vehicles[0].left_out.unwrap();
    assert!(matches!(
        reason,
        LeftOut::TooFewSeen { needed: 3, .. } | LeftOut::TooFewIntersected { needed: 3, .. }
    ));
    assert!(reason.to_string().contains("3 are needed"), "{reason}");
    let error = refine(&problem, &start, &RefineOptions::default(), None).unwrap_err();
    assert!(error.to_string().contains("car0"), "{error}");
}

#[test]
fn every_loss_reaches_the_same_place_on_good_data() {
    let (problem, truth) = problem(&Drive { seed: 9, ..Default::default() });
    for (loss, _) in LossName::ALL {
        let (end, adjustment) =
            refine(&problem, &start(&problem), &RefineOptions { loss, ..Default::default() }, None).unwrap();
        assert!(adjustment.stop.converged(), "{loss}");
        assert!(
            track_error(&end, &problem, 0, &truth) < 0.03,
            "{loss}: {}",
            track_error(&end, &problem, 0, &truth)
        );
    }
}

/// Adds rows to a table.
fn append(folder: &std::path::Path, table: &str, rows: &str) {
    let path = folder.join(table);
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(path, format!("{}\n{rows}", text.trim_end())).unwrap();
}

#[test]
fn a_point_without_a_good_image_point_gets_no_coordinates_and_stops_nothing() {
    for tie in [false, true] {
        let folder = tempfile::tempdir().unwrap();
        let truth = Drive::default().write(folder.path());
        append(
            folder.path(),
            "vehicle_observations.csv",
            "3,car0,lost,100,100\n9,car0,lost,3000,90\n20,car0,lost,1200,2000\n",
        );
        if tie {
            append(folder.path(), "targets.csv", "X,,,,,,,control\n");
            let rows = "3,X,100,100\n9,X,3000,90\n20,X,1200,2000\n40,X,90,2000\n";
            append(folder.path(), "target_observations.csv", rows);
        }
        let problem = read_problem(folder.path()).unwrap().problem.unwrap();
        let (end, adjustment) = adjust(&problem);
        let lost = problem.vehicles[0].points.iter().position(|p| p.id == "lost").unwrap();
        assert!(end.vehicles[0].points[lost].is_none());
        assert!(adjustment.warnings.iter().any(|w| w.to_string().ends_with("no coordinates: lost")));
        assert!(
            adjustment.fits.outliers >= 3 && adjustment.stop.converged(),
            "{:?} {:?}",
            adjustment.stop,
            adjustment.fits.tally
        );
        assert!(track_error(&end, &problem, 0, &truth) < 0.03);
    }
}

#[test]
fn points_whose_depth_is_open_stay_within_a_car() {
    // Three frames of a standing car: every ray is nearly parallel to the next.
    let slow = Drive { frames: 3, ..Default::default() };
    let (mut problem, truth) = problem(&slow);
    problem.ground.as_mut().unwrap().correlation_s = Some(1.0);
    let start = start(&problem);
    assert!(start.vehicles[0].depths.iter().filter(|depth| **depth == Depth::Open).count() > 20);
    let (end, _) = adjust(&problem);
    for point in end.vehicles[0].points.iter().flatten() {
        assert!((-0.9..3.5).contains(&point.z), "{point}");
    }
    assert!(shape_error(&end, 0, &truth) < 1.0, "{}", shape_error(&end, 0, &truth));
}

#[test]
fn a_vehicle_that_is_never_seen_is_left_out() {
    let folder = tempfile::tempdir().unwrap();
    Drive::default().write(folder.path());
    let ghost = "[[vehicle]]\nid = \"ghost\"\nmarker = \"mark\"\nheight_m = 1.5\n";
    append(folder.path(), "problem.toml", ghost);
    let problem = read_problem(folder.path()).unwrap().problem.unwrap();
    let (end, adjustment) = adjust(&problem);
    assert!(adjustment.stop.converged());
    assert_eq!(end.vehicles[1].left_out, Some(LeftOut::NeverSeen));
}

/// Two cars without starting poses, of which the second keeps so many points; where it keeps none that meet the ground,
/// its mark is known all the same.
fn with_a_second_car(points: usize, is_on_ground: bool) -> (Problem, Truth) {
    let (mut problem, truth) = problem(&Drive { vehicles: 2, ..Default::default() });
    let second = &mut problem.vehicles[1];
    second.observations.retain(|o| o.point < points);
    problem.vehicles.iter_mut().for_each(|vehicle| vehicle.poses.fill(None));
    if !is_on_ground {
        let second = &mut problem.vehicles[1];
        second.points[0].known = [0.0, 0.0, 1.5].map(|value_m| Some(Known { value_m, sigma_m: 0.02 }));
        // Beyond the horizon.
        second.observations.iter_mut().for_each(|o| o.image_px = nalgebra::Vector2::new(1e9, 1e9));
    }
    (problem, truth)
}

#[test]
fn a_car_that_cannot_be_found_does_not_take_the_other_with_it() {
    for (points, is_on_ground) in [(0, true), (1, true), (2, true), (40, false)] {
        let (problem, truth) = with_a_second_car(points, is_on_ground);
        let (end, adjustment) = adjust(&problem);
        assert!(end.vehicles[1].left_out.is_some(), "{points} points");
        assert!(adjustment.stop.converged() && end.vehicles[0].left_out.is_none());
        let error_m = track_error(&end, &problem, 0, &truth);
        assert!(error_m < 0.03, "{points} points: {error_m}");
    }
}

#[test]
fn a_camera_that_looks_away_is_no_solution() {
    let (mut problem, _) = problem(&Drive::default());
    for pose in problem.camera_poses.iter_mut().flatten() {
        pose.rotation *= exp(&Vector3::new(std::f64::consts::PI, 0.0, 0.0));
    }
    let error = refine(&problem, &start(&problem), &RefineOptions::default(), None).unwrap_err();
    assert!(matches!(error, NoSolution::NothingFits | NoSolution::NoVehicle { .. }), "{error}");
}

#[test]
fn numbers_out_of_all_proportion_are_no_solution() {
    let (mut problem, _) = problem(&Drive::default());
    problem.camera_poses[3].as_mut().unwrap().translation.x = 1e300;
    assert!(refine(&problem, &start(&problem), &RefineOptions::default(), None).is_err());
}

#[test]
fn cameras_without_targets_are_warned_of() {
    let (problem, _) = problem(&Drive { targets: 0, ..Default::default() });
    let (_, adjustment) = adjust(&problem);
    assert!(
        adjustment
            .warnings
            .iter()
            .any(|w| w.to_string().contains("fewer than three surveyed control targets"))
    );
}

#[test]
fn cameras_are_resected_where_none_is_given() {
    let (mut problem, truth) = problem(&Drive::default());
    problem.camera_poses.fill(None);
    let initial = initialise(&problem, Method::RobustWhereNeeded).unwrap();
    let resection = initial.resection.as_ref().unwrap();
    assert_eq!(resection.quality().resected, 60);
    assert!(initial.warnings.is_empty(), "{:?}", initial.warnings);
    let off_m = |estimate: &Estimate| {
        let gap = |(a, b): (&Pose, &Pose)| (a.translation.vector - b.translation.vector).norm();
        rms(estimate.camera_poses.iter().zip(&truth.cameras).map(gap))
    };
    assert!(off_m(&initial.estimate) < 0.3, "{}", off_m(&initial.estimate));
    let (end, adjustment) = refine(&problem, &initial.estimate, &RefineOptions::default(), None).unwrap();
    assert!(adjustment.stop.converged() && adjustment.warnings.is_empty(), "{:?}", adjustment.warnings);
    assert!(off_m(&end) < 0.05, "{}", off_m(&end));
    assert!(track_error(&end, &problem, 0, &truth) < 0.03, "{}", track_error(&end, &problem, 0, &truth));
    let sigma0 = adjustment.sigma0.unwrap();
    assert!((sigma0 - 1.0).abs() < 0.05, "{sigma0}");
}

/// Where a resected camera starts must not matter: there is no row that holds it there.
#[test]
fn the_start_of_a_resected_camera_weighs_nothing() {
    let (mut problem, _) = problem(&Drive::default());
    problem.camera_poses.fill(None);
    let start = start(&problem);
    let mut moved = start.clone();
    for (at, pose) in moved.camera_poses.iter_mut().enumerate() {
        pose.translation.vector += Vector3::new(0.4, -0.3, 0.5) + Vector3::x() * (at as f64).sin() * 0.1;
    }
    let options = RefineOptions { motion: MotionPriors::OFF, ..Default::default() };
    let [one, other] = [&start, &moved].map(|start| refine(&problem, start, &options, None).unwrap().0);
    for (a, b) in one.camera_poses.iter().zip(&other.camera_poses) {
        assert!((a.translation.vector - b.translation.vector).norm() < 1e-3, "{a} {b}");
    }
}

#[test]
fn a_gap_in_the_camera_poses_is_filled() {
    let (mut problem, truth) = problem(&Drive::default());
    problem.camera_poses[20..40].fill(None);
    // Six of them see next to nothing.
    problem.target_observations.retain(|o| !(25..31).contains(&o.frame) || o.target == 3);
    let initial = initialise(&problem, Method::RobustWhereNeeded).unwrap();
    let quality = initial.resection.as_ref().unwrap().quality();
    assert_eq!((quality.given, quality.resected, quality.bridged), (40, 14, 6));
    assert!(
        initial.warnings[0].to_string().contains("frames 25-30: 1 control target in view; bridged"),
        "{:?}",
        initial.warnings
    );
    for (at, (found, given)) in initial.estimate.camera_poses.iter().zip(&problem.camera_poses).enumerate() {
        assert!(given.is_none_or(|given| given == *found), "frame {at}");
        assert!((found.translation.vector - truth.cameras[at].translation.vector).norm() < 1.5, "frame {at}");
    }
    for motion in [MotionPriors::ESTIMATED, MotionPriors::OFF] {
        let options = RefineOptions { motion, ..Default::default() };
        let (end, adjustment) = refine(&problem, &initial.estimate, &options, None).unwrap();
        assert!(adjustment.stop.converged(), "{}", adjustment.stop);
        assert!(track_error(&end, &problem, 0, &truth) < 0.15, "{}", track_error(&end, &problem, 0, &truth));
    }
}

#[test]
fn a_shape_whose_depth_is_open_is_said_to_be_so() {
    for (motion, is_open) in [([0.0, 0.0], true), ([14.0, 0.25], false)] {
        let (problem, _) =
            problem(&Drive { motion, camera_error: [0.0; 2], vehicle_error: [0.0; 2], ..Default::default() });
        let initial = initialise(&problem, Method::RobustWhereNeeded).unwrap();
        let said =
            initial.warnings.iter().any(|warning| warning.to_string().contains("leave their depth open"));
        assert_eq!(said, is_open, "{motion:?}: {:?}", initial.warnings);
    }
}
