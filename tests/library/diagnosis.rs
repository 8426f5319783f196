//! What is determined and by what, against dense algebra and against what must be so.

use crate::support;

use nalgebra::{DMatrix, DVector};
use support::drawn::Film;
use support::drive::Drive;
use trackbundle::internals::diagnose::{Diagnosis, Trust, Verdict, VerdictReason, diagnose};
use trackbundle::internals::files::read_problem;
use trackbundle::internals::initialise::{Method, initialise};
use trackbundle::internals::refine::{
    Adjusted, Arrangement, MotionPriors, Network, RefineOptions, Source, adjust_network as adjust,
};
use trackbundle::problem::Problem;
use trackbundle_solver::system::{GroupId, Values};

fn problem(drive: &Drive) -> Problem {
    let folder = tempfile::tempdir().unwrap();
    drive.write(folder.path());
    read_problem(folder.path()).unwrap_or_else(|findings| panic!("{findings}")).problem.unwrap()
}

fn diagnosed(problem: &Problem, motion: MotionPriors) -> (Adjusted, Diagnosis) {
    let start = initialise(problem, Method::RobustWhereNeeded).unwrap().estimate;
    let options = RefineOptions { motion, ..Default::default() };
    let mut adjusted = adjust(problem, &start, &options, None).unwrap();
    let diagnosis = diagnose(problem, &mut adjusted).expect("least squares").unwrap();
    (adjusted, diagnosis)
}

/// A small film of two vehicles, with all kinds of knowledge.
fn small() -> Problem {
    problem(&Drive { frames: 12, points: 7, vehicles: 2, targets: 6, ..Drive::default() })
}

/// A longer one, whose scale is held well.
fn longer() -> Problem {
    problem(&Drive { frames: 60, points: 10, vehicles: 2, ..Drive::default() })
}

/// The normal matrix of a network, dense, from products with unit vectors; held numbers have 1.
fn dense_normal(network: &Network) -> DMatrix<f64> {
    let system = &network.model.system;
    let n = system.size();
    let mut normal = DMatrix::zeros(n, n);
    for group in groups(network) {
        let mut jacobian = DMatrix::zeros(system.rows(group), n);
        for column in 0..n {
            let mut unit = vec![0.0; n];
            unit[column] = 1.0;
            jacobian.column_mut(column).copy_from_slice(&system.product(group, &network.values, &unit));
        }
        normal += jacobian.transpose() * jacobian;
    }
    for i in 0..n {
        if normal[(i, i)] == 0.0 {
            normal[(i, i)] = 1.0;
        }
    }
    normal
}

fn groups(network: &Network) -> Vec<GroupId> {
    network.model.sources.iter().map(|(_, group)| *group).collect()
}

#[test]
fn the_test_of_a_surveyed_coordinate_is_that_of_dense_algebra() {
    let problem = small();
    let (adjusted, diagnosis) = diagnosed(&problem, MotionPriors::OFF);
    let network = adjusted.network.as_ref().unwrap();
    let (system, inverse) = (&network.model.system, dense_normal(network).try_inverse().unwrap());
    let mut wanted = Vec::new();
    for group in network.model.groups_of(Source::Survey) {
        let rows = system.residuals(group, &network.values).into_iter().flatten().flatten();
        let mut jacobian = DMatrix::zeros(system.rows(group), inverse.nrows());
        for column in 0..inverse.nrows() {
            let mut unit = vec![0.0; inverse.nrows()];
            unit[column] = 1.0;
            jacobian.column_mut(column).copy_from_slice(&system.product(group, &network.values, &unit));
        }
        let leverage = &jacobian * &inverse * jacobian.transpose();
        // A target that is never seen is where its survey says: nothing checks it.
        let redundancy = |at: usize| Some(1.0 - leverage[(at, at)]).filter(|number| *number > 1e-6);
        wanted.extend(rows.enumerate().filter_map(|(at, v)| Some(v.abs() / redundancy(at)?.sqrt())));
    }
    let mut found = Vec::new();
    for ((target, place), w) in
        problem.targets.iter().zip(&adjusted.estimate.targets).zip(&diagnosis.survey_tests)
    {
        for (axis, w) in w.iter().enumerate() {
            let Some(w) = w else { continue };
            let difference_m = target.known[axis].unwrap().value_m - place.unwrap()[axis];
            assert_eq!(w.signum(), difference_m.signum(), "{}", target.id);
            found.push(w.abs());
        }
    }
    assert!(found.len() > 6, "{found:?}");
    assert_eq!(found.len(), wanted.len());
    for (found, wanted) in found.iter().zip(&wanted) {
        assert!((found - wanted).abs() < 1e-5 * (1.0 + wanted), "{found} {wanted}");
    }
}

/// Gradient of a function of the unknowns by central differences through the solver's own update.
fn gradient(network: &Network, function: &dyn Fn(&Values) -> f64) -> DVector<f64> {
    let system = &network.model.system;
    let n = system.size();
    DVector::from_fn(n, |at, _| {
        let moved = |by: f64| {
            let mut step = vec![0.0; n];
            step[at] = by;
            function(&system.plus(&network.values, &step))
        };
        (moved(1e-5) - moved(-1e-5)) / 2e-5
    })
}

#[test]
fn tracks_and_speeds_have_the_variances_of_dense_algebra() {
    let problem = small();
    for motion in [MotionPriors::ESTIMATED, MotionPriors::OFF] {
        let (adjusted, diagnosis) = diagnosed(&problem, motion);
        let network = adjusted.network.as_ref().unwrap();
        let inverse = dense_normal(network).cholesky().unwrap().inverse();
        let factor = adjusted.adjustment.sigma0.unwrap();
        let start = initialise(&problem, Method::RobustWhereNeeded).unwrap().estimate;
        let estimate = |values: &Values| network.model.estimate(&problem, &start, values);
        for vehicle in 0..2 {
            for frame in [0, 5, 11] {
                let of = |what: &dyn Fn(&trackbundle::estimate::TrackPoint) -> f64| {
                    let gradient = gradient(network, &|values| {
                        let track =
                            estimate(values).vehicles[vehicle].track(&problem, &problem.vehicles[vehicle]);
                        what(&track[frame])
                    });
                    factor * (gradient.transpose() * &inverse * &gradient)[(0, 0)].sqrt()
                };
                let found = diagnosis.precision.tracks[vehicle][frame].unwrap();
                let wanted = [of(&|t| t.position.x), of(&|t| t.position.y), of(&|t| t.position.z)];
                for axis in 0..3 {
                    let gap = found.position_m[axis] / wanted[axis] - 1.0;
                    assert!(gap.abs() < 1e-5, "{vehicle} {frame} {axis}: {gap:e}");
                }
                let own = &adjusted.estimate.vehicles[vehicle];
                // What the path leaves open even where its poses are known.
                let free = own.path(&problem, &problem.vehicles[vehicle]).map_or(0.0, |path| {
                    let linear = path.linear_at(problem.frames[frame].time_s).unwrap();
                    let marker =
                        problem.vehicles[vehicle].marker.and_then(|m| own.points[m]).unwrap_or_default();
                    let along = linear.state.velocity_of(&marker).xy().normalize().push(0.0);
                    let in_body = linear.state.pose.rotation.inverse() * along;
                    let mut by_state = DVector::zeros(12);
                    by_state.rows_mut(6, 3).copy_from(&along);
                    by_state.rows_mut(9, 3).copy_from(&marker.coords.cross(&in_body));
                    (by_state.transpose() * linear.process * &by_state)[(0, 0)]
                });
                assert_eq!(free > 0.0, motion != MotionPriors::OFF);
                let wanted = of(&|t| t.speed_mps.unwrap()).hypot(free.sqrt());
                let gap = found.speed_mps.unwrap() / wanted - 1.0;
                assert!(gap.abs() < 1e-5, "speed {vehicle} {frame}: {gap:e}");
            }
        }
    }
}

#[test]
fn redundancy_numbers_and_shares_of_the_scale_add_up() {
    let problem = longer();
    let (adjusted, diagnosis) = diagnosed(&problem, MotionPriors::ESTIMATED);
    let statistics = &diagnosis.statistics;
    let redundancy = adjusted.adjustment.redundancy as f64;
    assert!((statistics.redundancy_numbers - redundancy).abs() < 0.05, "{statistics:?} {redundancy}");
    assert_eq!(diagnosis.scales.len(), 2);
    for scale in &diagnosis.scales {
        let sum: f64 = scale.shares.iter().map(|(_, share)| share).sum();
        assert!((sum - 1.0).abs() < 1e-6, "{sum}");
        assert!(scale.sigma > 1e-5 && scale.sigma < 0.05, "{}", scale.sigma);
        for (source, without) in &scale.without {
            assert!(*without >= scale.sigma * (1.0 - 1e-6), "{source:?}");
        }
        // Terrain alone or a height alone leave it free.
        for source in [Source::Terrain, Source::KnownPoint] {
            let without = scale.without.iter().find(|(of, _)| *of == source).unwrap().1;
            assert!(without > 3.0 * scale.sigma, "{source:?}: {without}");
        }
    }
}

#[test]
fn the_system_is_the_same_after_a_diagnosis() {
    let problem = small();
    let start = initialise(&problem, Method::RobustWhereNeeded).unwrap().estimate;
    let mut adjusted = adjust(&problem, &start, &RefineOptions::default(), None).unwrap();
    let first = diagnose(&problem, &mut adjusted).unwrap().unwrap();
    let second = diagnose(&problem, &mut adjusted).unwrap().unwrap();
    assert_eq!(format!("{:?}", first.precision), format!("{:?}", second.precision));
}

#[test]
fn any_number_of_threads_gives_the_same_sigmas() {
    let problem = small();
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| format!("{:?}", diagnosed(&problem, MotionPriors::ESTIMATED).1))
    };
    assert_eq!(with(1), with(3));
}

#[test]
fn without_any_height_the_scale_is_not_determined() {
    let drive = Drive {
        frames: 20,
        points: 12,
        knows_mark: false,
        settings: "camera_position_m = 0.2\ncamera_rotation_deg = 0.25\nvehicle_position_m = 0.2\n\
                   vehicle_rotation_deg = 1.2\n"
            .to_owned(),
        ..Drive::default()
    };
    let problem = problem(&drive);
    let (adjusted, diagnosis) = diagnosed(&problem, MotionPriors::OFF);
    assert!(diagnosis.scales[0].sigma.is_infinite(), "{:?}", diagnosis.scales[0]);
    let verdict = Verdict::new(&problem, &adjusted.adjustment, &diagnosis);
    assert_eq!(verdict.trust, Trust::No);
    let open = VerdictReason::ScaleOpen { vehicle: "car0".to_owned() };
    assert!(verdict.findings.contains(&open), "{:?}", verdict.findings);
    assert_eq!(open.to_string(), "nothing determines the scale of car0");
    // Along the rays nothing is known; the heading, and the cameras, are.
    for track in diagnosis.precision.tracks[0].iter().flatten() {
        assert!(track.position_m[2].is_infinite());
        assert!(track.heading_rad.is_finite(), "{track:?}");
    }
    // A point near the middle of the shape hardly moves with its scale.
    let open = diagnosis.precision.points[0].iter().flatten().filter(|p| p.iter().any(|s| s.is_infinite()));
    assert!(open.count() >= 10, "{:?}", diagnosis.precision.points[0]);
    for camera in diagnosis.precision.cameras.iter().flatten() {
        assert!(camera.position_m.iter().all(|sigma| sigma.is_finite() && *sigma > 0.0));
    }
}

#[test]
fn a_scale_that_is_not_determined_leaves_the_plan_position_below_the_camera() {
    // The mark passes straight below the camera in the middle of the film: there a change of the scale
    // moves it up and down only.
    let film = Film { frames: 41, points: 10, mark_m: 0.01, ..Film::default() };
    let (mut problem, mut start, _) = film.draw(3);
    problem.ground = None;
    problem.vehicles[0].points.iter_mut().for_each(|point| point.known = [None; 3]);
    let middle = 20;
    // Cameras that look straight down and are known exactly.
    problem.camera_pose_sigma.position_m = Some(0.0);
    problem.camera_pose_sigma.rotation_rad = [Some(0.0); 3];
    let mark = start.vehicles[0].poses[middle].unwrap() * start.vehicles[0].points[0].unwrap();
    let camera = problem.camera.clone();
    for frame in 0..film.frames {
        let mut pose = start.camera_poses[frame];
        pose.translation.vector.x = mark.x;
        pose.translation.vector.y = mark.y;
        start.camera_poses[frame] = pose;
        problem.camera_poses[frame] = Some(pose);
    }
    for vehicle in &mut problem.vehicles {
        for o in &mut vehicle.observations {
            let found = &start.vehicles[0];
            let in_world = found.poses[o.frame].unwrap() * found.points[o.point].unwrap();
            let local = start.camera_poses[o.frame].inverse_transform_point(&in_world);
            o.image_px = camera.project(&local.coords).unwrap();
        }
    }
    let options = RefineOptions { motion: MotionPriors::OFF, ..Default::default() };
    let mut adjusted = adjust(&problem, &start, &options, None).unwrap();
    let diagnosis = diagnose(&problem, &mut adjusted).unwrap().unwrap();
    let below = diagnosis.precision.tracks[0][middle].unwrap();
    assert!(below.position_m[0].is_finite() && below.position_m[1].is_finite(), "{below:?}");
    assert!(below.position_m[2].is_infinite(), "{below:?}");
    let aside = diagnosis.precision.tracks[0][0].unwrap();
    assert!(aside.position_m[0].is_infinite() || aside.position_m[1].is_infinite(), "{aside:?}");
}

#[test]
fn check_points_agree_within_their_sigmas() {
    // A camera that flies: below one that hovers rays do not meet.
    let film = Film { targets: 14, check: 5, drift_mps: 4.0, ..Film::default() };
    let mut squares = Vec::new();
    for seed in 0..4 {
        let (problem, start, _) = film.draw(seed);
        let options = RefineOptions { motion: Film::motion_priors(), ..Default::default() };
        let mut adjusted = adjust(&problem, &start, &options, None).unwrap();
        let diagnosis = diagnose(&problem, &mut adjusted).unwrap().unwrap();
        assert_eq!(diagnosis.check_points.len(), 5);
        for check in &diagnosis.check_points {
            // Some leave the view before their rays meet.
            let Some((value, probability)) = check.chi_square else { continue };
            assert!(probability > 1e-4, "{check:?}");
            // No better than the survey.
            assert!(check.sigma_m.unwrap().iter().all(|sigma| *sigma >= film.survey_m), "{check:?}");
            squares.push(value);
        }
    }
    assert!(squares.len() >= 8, "{}", squares.len());
    // Ten values of chi-square of three degrees: their mean has a standard deviation of 0.8.
    let mean = squares.iter().sum::<f64>() / squares.len() as f64;
    assert!((1.0..5.6).contains(&mean), "{mean}");
}

#[test]
fn vehicles_that_are_judged_one_by_one_have_upper_bounds() {
    let problem = longer();
    let start = initialise(&problem, Method::RobustWhereNeeded).unwrap().estimate;
    let with = |arrangement| {
        let options = RefineOptions { arrangement, ..Default::default() };
        let mut adjusted = adjust(&problem, &start, &options, None).unwrap();
        diagnose(&problem, &mut adjusted).unwrap().unwrap()
    };
    let (together, apart) = (with(Arrangement::Together), with(Arrangement::Apart));
    assert!(!together.is_upper_bound && apart.is_upper_bound);
    let sigmas = |of: &Diagnosis| -> Vec<f64> {
        let tracks = of.precision.tracks.iter().flatten().flatten().flat_map(|t| t.position_m);
        let points = of.precision.points.iter().flatten().flatten().flatten().copied();
        tracks.chain(points).collect()
    };
    let (exact, bound) = (sigmas(&together), sigmas(&apart));
    assert_eq!(exact.len(), bound.len());
    for (exact, bound) in exact.iter().zip(&bound) {
        assert!(*bound > 0.98 * exact && *bound < 2.0 * exact, "{exact} {bound}");
    }
    assert_eq!(apart.scales.iter().map(|s| s.vehicle).collect::<Vec<_>>(), [0, 1]);
}
