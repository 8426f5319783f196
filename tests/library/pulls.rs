//! What is assumed for want of knowledge, and how strongly motion is smoothed, must move nothing that is read.

use nalgebra::{Point3, Vector3};
use std::path::Path;
use trackbundle::internals::diagnose::{Diagnosis, PullCause, diagnose};
use trackbundle::internals::initialise::{Method, initialise};
use trackbundle::internals::network::{Model, Purpose};
use trackbundle::internals::refine::{Adjusted, Network, RefineOptions, Source, adjust_network as adjust};
use trackbundle::internals::simulate::{Chance, SimulatedVideo, World, parse};
use trackbundle::problem::Problem;
use trackbundle_solver::minimise::{Minimiser, MinimiserOptions};
use trackbundle_solver::system::Values;

fn videos(scenario: &str, runs: u64) -> Vec<SimulatedVideo> {
    let text = format!("format = 1\nname = \"pull\"\nseed = 3\n{scenario}");
    let scenario = parse("pull.toml", &text, Path::new("")).unwrap_or_else(|findings| panic!("{findings}"));
    let world = World::new(scenario, None).unwrap_or_else(|findings| panic!("{findings}"));
    let video = |run| world.video(Chance::Run(run)).unwrap_or_else(|findings| panic!("{findings}"));
    (0..runs).map(video).collect()
}

fn adjusted(problem: &Problem) -> (Adjusted, Diagnosis) {
    let start = initialise(problem, Method::RobustWhereNeeded).unwrap().estimate;
    let mut adjusted = adjust(problem, &start, &RefineOptions::default(), None).unwrap();
    let diagnosis = diagnose(problem, &mut adjusted).expect("least squares").unwrap();
    (adjusted, diagnosis)
}

/// A van of 2.6 m with points all over it, of which one has a height that is known to 5 cm.
const VAN: &str = "[camera]\npreset = \"pinhole-4k\"\n[film]\nframes = 40\nrate_hz = 10.0\n[flight]\naltitude_m = 50.0\n\
    tilt_deg = 15.0\n[[vehicle]]\nid = \"van1\"\nspeed_mps = 4.0\ncurvature_per_m = 0.03\npoints = 120\n\
    marker_sigma_m = 0.05\nbody = { length_m = 6.0, width_m = 2.0, height_m = 2.6 }\n[targets]\ncount = 12\n\
    spread_m = 20.0\n[vehicle_poses]\ngiven = \"none\"\n";

#[test]
fn the_usual_size_of_a_car_does_not_draw_a_van_down() {
    for video in videos(VAN, 3) {
        let (adjusted, diagnosis) = adjusted(&video.problem);
        let [found, truth] = [&adjusted.estimate, &video.truth].map(|of| &of.vehicles[0]);
        let vehicle = &video.problem.vehicles[0];
        let places = found.places(vehicle).zip(truth.places(vehicle));
        let mut all = places.zip(&diagnosis.precision.tracks[0]).map(|(((_, found), (_, truth)), sigmas)| {
            (found.z - truth.z) / sigmas.as_ref().unwrap().position_m[2]
        });
        let middle = all.nth(20).unwrap();
        println!("height of the mark: {middle:.2} sigma, pulls {:?}", diagnosis.pulls);
        assert!(middle.abs() < 3.0, "{middle}");
        let pull = diagnosis.pulls.iter().find(|pull| pull.cause == PullCause::Conventions).unwrap();
        assert!(pull.largest() < 0.05, "{pull:?}");
    }
}

/// Second road: the usual size of a car, where a car usually is, at a third of its weight, and the least squares solved
/// anew with it.
#[test]
fn a_pull_is_how_far_the_solution_goes() {
    let video = videos(VAN, 1).remove(0);
    let start = initialise(&video.problem, Method::RobustWhereNeeded).unwrap().estimate;
    let (mut adjusted, _) = adjusted(&video.problem);
    let Network { model: last, frames, .. } = adjusted.network.take().unwrap();
    let anchors: Vec<_> = frames.iter().map(|frame| frame.anchors.clone()).collect();
    let (options, selection) = (RefineOptions::default(), adjusted.adjustment.fits.selection());
    let purpose = Purpose::Adjustment { anchors: &anchors };
    let mut model =
        Model::new(&video.problem, &start, &adjusted.estimate, options.network(), &selection, purpose);
    model.copy_motion(&last);
    model.set_image_factors(last.image_factors());
    let options = MinimiserOptions { relative_decrease: 1e-14, ..Default::default() };
    let solved = |model: &Model, from: &Values| {
        Minimiser::new(&model.system).unwrap().run(&model.system, from, options, None).values
    };
    model.loosen_conventions();
    let free = solved(&model, model.system.start());
    let strong: Vec<_> = model.groups_of(Source::Convention).collect();
    strong.into_iter().for_each(|group| model.system.set_sigma_factor(group, 3.0));
    let pulled = solved(&model, &free);
    let of = |values| model.estimate(&video.problem, &start, values);
    let (free, moved) = (of(&free), of(&pulled));
    let scale = size(&moved.vehicles[0].points) / size(&free.vehicles[0].points) - 1.0;
    adjusted.estimate = moved;
    adjusted.network = Some(Network { model, values: pulled, frames });
    let diagnosis = diagnose(&video.problem, &mut adjusted).unwrap().unwrap();
    let pull = diagnosis.pulls[0].scale * diagnosis.scales[0].sigma;
    println!("scale moved by {scale:e}, pull {pull:e}, sigma {:e}", diagnosis.scales[0].sigma);
    assert!(diagnosis.pulls[0].scale > 0.1, "{:?}", diagnosis.pulls[0]);
    assert!((pull / scale.abs() - 1.0).abs() < 0.15, "{pull} {scale}");
}

/// Points of a van that are seen for a moment have hardly a depth. A height that is known to 10 cm, and that nothing else
/// tells to better than metres, must be met: with a redundancy of 4e-4 it cannot be contradicted.
#[test]
fn points_without_depth_leave_a_known_height_alone() {
    let scenario = "[camera]\npreset = \"dji-mini-2\"\n[film]\nframes = 78\nrate_hz = 10.0\n[flight]\n\
        altitude_m = 52.0\nkind = \"straight\"\nspeed_mps = 3.0\ndirection_deg = 40.0\ntilt_deg = 44.0\nazimuth_deg = 287.0\n\
        [terrain]\ntilt_sigma_deg = 0.5\n[[vehicle]]\nid = \"van1\"\nspeed_mps = 10.0\nheading_deg = 105.0\npoints = 36\n\
        track_s = 2.3\ndropout = 0.15\nmarker_sigma_m = 0.1\nbody = { length_m = 6.0, width_m = 2.0, height_m = 2.6 }\n\
        [targets]\ncount = 14\nspread_m = 13.0\nsigma_m = 0.03\n[errors]\nvehicle_px = 0.7\n";
    for video in videos(scenario, 2) {
        let (adjusted, diagnosis) = adjusted(&video.problem);
        let vehicle = &video.problem.vehicles[0];
        let marker = vehicle.marker.unwrap();
        let known = vehicle.points[marker].known[2].unwrap();
        let off = (adjusted.estimate.vehicles[0].points[marker].unwrap().z - known.value_m) / known.sigma_m;
        println!("known height met to {off:.2} sigma, pulls {:?}", diagnosis.pulls[0]);
        assert!(off.abs() < 0.3, "{off}");
    }
}

/// Root of the summed squares of distances from the middle \[m\].
fn size(points: &[Option<Point3<f64>>]) -> f64 {
    let middle = points.iter().flatten().map(|p| p.coords).sum::<Vector3<f64>>()
        / points.iter().flatten().count() as f64;
    points.iter().flatten().map(|p| (p.coords - middle).norm_squared()).sum::<f64>().sqrt()
}

/// Drone telemetry of 1.5 m, a known height of the roof, and no target: the world has a size that smooth motion knows
/// nothing of. (Counted in metres it sank by two of its standard deviations, in all of them.)
#[test]
fn smooth_motion_does_not_draw_cameras_down() {
    let scenario = "[camera]\npreset = \"pinhole-4k\"\n[film]\nframes = 100\nrate_hz = 15.0\n[flight]\n\
        altitude_m = 70.0\ntilt_deg = 20.0\n[[vehicle]]\nid = \"car1\"\nspeed_mps = 3.0\ncurvature_per_m = 0.05\n\
        points = 40\nheight_sigma_m = 0.1\n[targets]\ncount = 0\n[camera_poses]\ngiven = \"known\"\nwhite_m = 0.05\n\
        white_deg = 0.05\nslow_m = 1.5\nslow_deg = 0.1\nslow_s = 300\n";
    let mut sum = 0.0;
    let videos = videos(scenario, 4);
    for video in &videos {
        let (adjusted, diagnosis) = adjusted(&video.problem);
        let height = |of: &trackbundle::estimate::Estimate| of.camera_poses[50].translation.z;
        let sigma_m = diagnosis.precision.cameras[50].unwrap().position_m[2];
        let error = (height(&adjusted.estimate) - height(&video.truth)) / sigma_m;
        println!("camera {error:.2} sigma of {sigma_m:.2} m");
        assert!(error.abs() < 3.0, "{error}");
        sum += error;
    }
    // Of four independent ones the mean has half a standard deviation.
    assert!((sum / 4.0).abs() < 1.3, "{sum}");
}

/// Without a marker, known coordinates or given poses the track is that of the middle of the body, and it stays there.
#[test]
fn the_origin_of_a_body_stays_in_its_middle() {
    let scenario = "[camera]\npreset = \"pinhole-4k\"\n[film]\nframes = 60\nrate_hz = 8.0\n[flight]\naltitude_m = 50.0\n\
        [[vehicle]]\nid = \"car1\"\nspeed_mps = 6.0\ncurvature_per_m = 0.08\npoints = 30\nheight_sigma_m = 0.03\n\
        [targets]\ncount = 12\nspread_m = 20.0\n[vehicle_poses]\ngiven = \"none\"\n";
    for video in videos(scenario, 2) {
        let mut problem = video.problem.clone();
        problem.vehicles[0].marker = None;
        let (adjusted, diagnosis) = adjusted(&problem);
        let found = &adjusted.estimate.vehicles[0];
        let truth = &video.truth.vehicles[0];
        // The same sides of the true body, in its true frame.
        let sides = found.box_sides().unwrap();
        let middle =
            |axis: usize| sides[axis].iter().map(|at| truth.points[*at].unwrap()[axis] / 2.0).sum::<f64>();
        let middle = Point3::new(middle(0), middle(1), 0.0);
        let mut worst: f64 = 0.0;
        let in_body: Vec<Vector3<f64>> = (0..problem.frames.len())
            .zip(&diagnosis.precision.tracks[0])
            .filter_map(|(frame, sigmas)| {
                let (pose, true_pose) = (found.poses[frame]?, truth.poses[frame]?);
                let off = pose.translation.vector - (true_pose * middle).coords;
                let sigma_m = sigmas.as_ref()?.position_m;
                worst = worst.max(off.x.hypot(off.y) / sigma_m[0].hypot(sigma_m[1]));
                Some(true_pose.rotation.inverse() * off)
            })
            .collect();
        let mean = in_body.iter().sum::<Vector3<f64>>() / in_body.len() as f64;
        let wander_m = (in_body.iter().map(|off| (off - mean).norm_squared()).sum::<f64>()
            / in_body.len() as f64)
            .sqrt();
        println!("wanders by {wander_m:.3} m in the body, {worst:.2} sigma off, mean {mean:.3}");
        // What poses scatter from frame to frame; held by its poses alone, the origin wandered by metres.
        assert!(wander_m < 0.04 && worst < 4.0, "{wander_m} {worst}");
    }
}

/// Poses of the vehicle that were measured hold its scale, which starting poses do not.
#[test]
fn measured_poses_are_observations() {
    let scenario = |given: &str| {
        format!(
            "[camera]\npreset = \"pinhole-4k\"\n[film]\nframes = 40\nrate_hz = 10.0\n[flight]\naltitude_m = 50.0\n\
             [terrain]\nknown = false\n[[vehicle]]\nid = \"car1\"\nspeed_mps = 6.0\ncurvature_per_m = 0.05\npoints = 30\n\
             [targets]\ncount = 12\nspread_m = 20.0\n[vehicle_poses]\ngiven = \"{given}\"\nwhite_m = 0.05\nwhite_deg = 0.5\n"
        )
    };
    let started = videos(&scenario("start"), 1).remove(0);
    let without = adjusted(&started.problem).1.scales[0].sigma;
    let video = videos(&scenario("measured"), 1).remove(0);
    let (adjusted, diagnosis) = adjusted(&video.problem);
    let sigma = diagnosis.scales[0].sigma;
    // 5 cm over the root of 40 frames, over a way of 24 m.
    assert!((1e-4..5e-3).contains(&sigma) && without > 10.0 * sigma, "{sigma} {without}");
    let [found, truth] = [&adjusted.estimate, &video.truth].map(|of| &of.vehicles[0]);
    let vehicle = &video.problem.vehicles[0];
    let places = found.places(vehicle).zip(truth.places(vehicle)).zip(&diagnosis.precision.tracks[0]);
    for (((_, found), (_, truth)), sigmas) in places {
        let sigmas = sigmas.as_ref().unwrap().position_m;
        for axis in 0..3 {
            let off = (found[axis] - truth[axis]) / sigmas[axis];
            assert!(off.abs() < 4.0, "{axis}: {off} of {}", sigmas[axis]);
        }
    }
    let of_poses = diagnosis.statistics.components.iter().find(|c| c.source == Source::VehiclePoses).unwrap();
    assert!((0.8..1.2).contains(&of_poses.sigma_factor().unwrap()), "{of_poses:?}");
}

/// A terrain grid whose heights are noisy says no more of a scale than one without noise, and what it says is right.
#[test]
fn a_rough_grid_claims_no_more_than_a_smooth_one() {
    let scenario = |noise_m: f64| {
        format!(
            "[camera]\npreset = \"pinhole-4k\"\n[film]\nframes = 40\nrate_hz = 10.0\n[flight]\naltitude_m = 50.0\n\
             tilt_deg = 30.0\n[terrain]\ncell_m = 0.5\nnoise_m = {noise_m}\nreach_m = 40.0\ntilt_sigma_deg = 1.5\n\
             [[vehicle]]\nid = \"car1\"\nspeed_mps = 6.0\ncurvature_per_m = 0.03\npoints = 30\nheight_sigma_m = 0.5\n\
             [targets]\ncount = 12\nspread_m = 20.0\n[vehicle_poses]\ngiven = \"none\"\n"
        )
    };
    let [smooth, rough] = [0.0, 0.03].map(|noise_m| {
        let video = videos(&scenario(noise_m), 1).remove(0);
        let (_, diagnosis) = adjusted(&video.problem);
        diagnosis.scales[0].sigma
    });
    println!("sigma of the scale {smooth:.4} with a smooth grid, {rough:.4} with a rough one");
    // Each has heights of its own.
    assert!(rough > 0.9 * smooth, "{smooth} {rough}");
}

/// Nothing that is listed knows the scale of this car, but the relief under it does. Where it started pulls nothing.
#[test]
fn a_start_does_not_draw_a_scale_that_relief_knows() {
    let scenario = "format = 1\nname = \"relief\"\nseed = 14\n[camera]\npreset = \"dji-mini-2\"\n[film]\nframes = 60\n\
        rate_hz = 10.0\n[flight]\naltitude_m = 50.0\ntilt_deg = 30.0\nazimuth_deg = 209.5\n[terrain]\ngrid = \"hills.asc\"\n\
        cell_m = 0.5\nnoise_m = 0.0\ntilt_sigma_deg = 1.5\n[[vehicle]]\nid = \"car1\"\nspeed_mps = 9.3\npoints = 40\n\
        heading_deg = 91.6\n[targets]\ncount = 10\nspread_m = 20.0\n[vehicle_poses]\ngiven = \"none\"\n";
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("problems/scenarios");
    let scenario = parse("relief.toml", scenario, &folder).unwrap_or_else(|findings| panic!("{findings}"));
    let world = World::new(scenario, None).unwrap_or_else(|findings| panic!("{findings}"));
    for run in 0..2 {
        let video = world.video(Chance::Run(run)).unwrap_or_else(|findings| panic!("{findings}"));
        let (adjusted, diagnosis) = adjusted(&video.problem);
        let scale = size(&adjusted.estimate.vehicles[0].points) / size(&video.truth.vehicles[0].points) - 1.0;
        let sigma = diagnosis.scales[0].sigma;
        let pull = diagnosis.pulls.iter().find(|pull| pull.cause == PullCause::Conventions).unwrap();
        println!("scale {:.2} of its sigma {sigma:.4}, {pull:?}", scale / sigma);
        assert!(sigma < 0.02 && scale.abs() < 3.0 * sigma, "{scale} at {sigma}");
        assert!(pull.largest() < 0.1, "{pull:?}");
    }
}
