//! What moves between two exposures: clocks, rows, and a receiver whose positions are observations.
//!
//! A short form runs with all tests; the study itself is
//!
//! ```text
//! cargo bench --bench studies moving_parts
//! ```

use crate::support;

use nalgebra::Vector3;
use support::moving::{FULL, Flight};
use trackbundle::internals::diagnose::{Diagnosis, diagnose};
use trackbundle::internals::initialise::{Method, initialise};
use trackbundle::internals::refine::{Adjusted, RefineOptions, adjust_network as adjust};
use trackbundle::problem::{Freedom, KnownTime, Problem, ReceiverKnowledge, Shutter};

fn adjusted(problem: &Problem) -> (Adjusted, Diagnosis) {
    let start = initialise(problem, Method::RobustWhereNeeded).unwrap().estimate;
    let mut adjusted = adjust(problem, &start, &RefineOptions::default(), None).unwrap();
    let diagnosis = diagnose(problem, &mut adjusted).expect("least squares").unwrap();
    (adjusted, diagnosis)
}

/// What must be told of a result of the program.
fn refined(folder: &std::path::Path) -> serde_json::Value {
    let out = folder.join("result");
    let run = support::program()
        .args(["refine", "--quiet", "--json", "--no-rrd", "--out"])
        .args([&out, &folder.join("problem")])
        .output()
        .unwrap();
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    serde_json::from_slice(&std::fs::read(out.join("report.json")).unwrap()).unwrap()
}

fn estimated<'r>(report: &'r serde_json::Value, name: &str) -> &'r serde_json::Value {
    let all = report["estimated"].as_array().unwrap();
    all.iter().find(|p| p["name"] == name).unwrap_or_else(|| panic!("no {name}: {all:?}"))
}

const SMALL: Flight = Flight { frames: 90, points: 60, targets: 20, ..FULL };

#[test]
fn a_folder_with_gnss_and_a_rolling_shutter_is_refined() {
    let place = tempfile::tempdir().unwrap();
    let (problem, truth) = SMALL.draw(1);
    support::moving::write(&problem, &place.path().join("problem"), "");
    let report = refined(place.path());
    for (name, wanted, most) in
        [("readout_s", truth.readout_s, 0.01), ("clock_offset_s", truth.clock_s, 0.01)]
    {
        let found = estimated(&report, name);
        let (value, sigma) = (found["value"].as_f64().unwrap(), found["sigma"].as_f64().unwrap());
        assert!(sigma < most && (value - wanted).abs() < 3.3 * sigma, "{name}: {found} {wanted}");
        assert_eq!(found["observable"], true, "{found}");
        assert!(found["effect_m"].as_f64().unwrap() > 0.0);
    }
    // Without the positions the scale is held by roof and ground, a third as well.
    let scale = &report["scales"][0];
    let (with, without) = (&scale["sigma"], &scale["sigma_without"]["GNSS positions"]);
    assert!(without.as_f64().unwrap() > 2.5 * with.as_f64().unwrap(), "{scale}");
    assert_eq!(report["directed_tests"].as_array().unwrap().len(), 0, "nothing is held");
    assert_eq!(report["verdict"]["trust"], "yes", "{}", report["verdict"]);
}

/// The clocks of film and receiver are seconds apart, and nothing is known of that.
#[test]
fn a_clock_that_is_seconds_off_is_found() {
    let (mut problem, truth) = SMALL.draw(2);
    let receiver = &mut problem.receivers[0];
    receiver.positions.iter_mut().for_each(|p| p.time_s += 4.0 - truth.clock_s);
    // One position is a gross error.
    receiver.positions[5].position.x += 3.0;
    let (adjusted, diagnosis) = adjusted(&problem);
    let found = adjusted.estimate.receivers[0].clock_offset_s;
    let sigma = diagnosis.parameters.iter().find(|p| p.name == "clock_offset_s").unwrap().sigma;
    assert!((found - 4.0).abs() < 3.3 * sigma && sigma < 0.003, "{found} +- {sigma}");
    let warned = adjusted.adjustment.warnings.iter().any(|w| w.to_string().contains("1 rejected"));
    assert!(warned, "{:?}", adjusted.adjustment.warnings);
}

/// A constant shift and a lever arm come with priors.
#[test]
fn a_shift_and_a_lever_arm_are_estimated() {
    let (mut problem, _) = SMALL.draw(3);
    let receiver = &mut problem.receivers[0];
    let shift = Vector3::new(0.05, -0.04, 0.03);
    receiver.positions.iter_mut().for_each(|p| p.position += shift);
    receiver.knowledge =
        ReceiverKnowledge { shift_sigma_m: 0.05, lever_sigma_m: 0.01, ..ReceiverKnowledge::default() };
    let (_, diagnosis) = adjusted(&problem);
    for (axis, name) in ["shift_x_m", "shift_y_m"].into_iter().enumerate() {
        let found = diagnosis.parameters.iter().find(|p| p.name == name).unwrap();
        assert!((found.value - shift[axis]).abs() < 3.3 * found.sigma && found.sigma < 0.04, "{found:?}");
    }
    // The lever arm, not the place of the antenna in a frame that is a choice.
    let arm = diagnosis.parameters.iter().find(|p| p.name == "lever_z_m").unwrap();
    assert!(arm.sigma < 0.0102 && arm.value.abs() < 3.3 * arm.sigma, "{arm:?}");
}

/// A focal length that is 2 % off, over targets that are surveyed at several heights, comes back; of a
/// distortion that is nothing, nothing is found.
#[test]
fn an_interior_orientation_is_estimated_and_named() {
    let (mut problem, _) = Flight { gnss: None, readout_s: [0.0, 0.0], ..SMALL }.draw(4);
    problem.camera.focal_px *= 1.02;
    problem.camera.lens = trackbundle::camera::Lens::Brown(trackbundle::camera::Brown::new([0.0; 5]));
    problem.calibration[0] = Freedom::Free;
    problem.calibration[3] = Freedom::Prior(0.05);
    let (adjusted, diagnosis) = adjusted(&problem);
    let named = |name: &str| diagnosis.parameters.iter().find(|p| p.name == name).unwrap();
    let focal = named("focal_length_px");
    assert!((focal.value - 2680.0).abs() < 3.3 * focal.sigma && focal.sigma < 15.0, "{focal:?}");
    assert!((adjusted.estimate.camera.focal_px.y - focal.value).abs() < 1e-9);
    assert!(focal.is_observable && focal.sigma_before.is_none());
    let bent = named("k1");
    assert!(bent.value.abs() < 3.3 * bent.sigma && bent.sigma < 0.05, "{bent:?}");
    assert!(focal.effect_m > 0.0);
}

/// A readout that is left out is found by its own test, though the scatter of all rows says nothing; and the
/// numbers of threads change no bit.
#[test]
fn what_is_held_is_tested() {
    let mut said = Vec::new();
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let tests = pool.install(|| adjusted(&held(&SMALL, 5, 0.05)).0.adjustment.directed_tests);
        assert_eq!(tests.iter().map(|t| t.name).collect::<Vec<_>>(), ["readout_s", "clock_offset_s"]);
        assert!(tests.iter().all(|t| t.is_rejected()), "{tests:?}");
        said.push(format!("{tests:?}"));
    }
    assert_eq!(said[0], said[1]);
    let right = Flight { readout_s: [0.0, 0.0], ..SMALL };
    let tests = adjusted(&held(&right, 6, 0.0)).0.adjustment.directed_tests;
    assert!(tests.len() == 2 && tests.iter().all(|t| !t.is_rejected()), "{tests:?}");
}

/// The rear axle of a car that rolls about a point behind its middle.
#[test]
fn a_rear_axle_is_found() {
    let (mut problem, truth) = Flight { readout_s: [0.0, 0.0], gross: 0.0, ..SMALL }.draw(7);
    problem.vehicles[0].is_car = true;
    let (adjusted, diagnosis) = adjusted(&problem);
    // The body of this film rolls where its own origin is.
    let body_from_true = adjusted.estimate.vehicles[0].poses[40].unwrap().inverse() * truth.vehicle[40];
    let origin_x_m = body_from_true.translation.vector.x;
    let found = diagnosis.parameters.iter().find(|p| p.name == "rear_axle_x_m").unwrap();
    assert!(
        (found.value - origin_x_m).abs() < 3.3 * found.sigma && found.sigma < 0.8,
        "{found:?} {origin_x_m}"
    );
}

/// States at any time agree with the track at the frames, and their standard deviations with those there.
#[test]
fn states_at_any_time_are_written() {
    let place = tempfile::tempdir().unwrap();
    let (problem, _) = SMALL.draw(1);
    let folder = place.path().join("problem");
    support::moving::write(&problem, &folder, "");
    let out = place.path().join("result");
    let run = support::program()
        .args(["refine", "--quiet", "--no-rrd", "--states", "120", "--out"])
        .args([&out, &folder])
        .output()
        .unwrap();
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    let read = |name: &str| {
        let mut reader = csv::Reader::from_path(out.join(name)).unwrap();
        let header = reader.headers().unwrap().clone();
        let rows: Vec<csv::StringRecord> = reader.records().map(Result::unwrap).collect();
        move |row: usize, column: &str| -> Option<f64> {
            let at = header.iter().position(|name| name == column).unwrap();
            rows.get(row)?[at].parse().ok()
        }
    };
    let (track, states) = (read("trajectories.csv"), read("states.csv"));
    for frame in [0, 1, 40, 88, 89] {
        for column in ["x", "y", "z", "speed_mps", "heading_deg", "sigma_x", "sigma_y", "sigma_speed_mps"] {
            let (a, b) = (track(frame, column).unwrap(), states(4 * frame, column).unwrap());
            assert!((a - b).abs() < 2e-5, "{frame} {column}: {a} {b}");
        }
    }
    // Between frames a speed is no better known than at both.
    assert!(
        states(162, "sigma_speed_mps").unwrap() > 0.0 && states(162, "sigma_yaw_rate_degps").unwrap() > 0.0
    );
    assert!(states(356, "x").is_some() && states(357, "x").is_none());
}

/// The problem with the readout taken for none and the clocks for the same.
fn held(flight: &Flight, seed: u64, clock_s: f64) -> Problem {
    let (mut problem, truth) = flight.draw(seed);
    problem.shutter = Shutter::default();
    for receiver in &mut problem.receivers {
        receiver.knowledge.clock_offset = Some(KnownTime { value_s: 0.0, sigma_s: 0.0 });
        receiver.positions.iter_mut().for_each(|p| p.time_s += clock_s - truth.clock_s);
    }
    problem
}

/// The study, which `benches/studies.rs` runs.
#[allow(dead_code)]
pub mod study {
    use super::*;
    use nalgebra::{Matrix2, Vector2};
    use support::score::laid_on_truth;
    use trackbundle::geometry::align::rigid_fit;
    use trackbundle::internals::refine::CRITICAL;

    /// What one run says: errors, and whether each lies in its 95 % region.
    #[derive(Clone, Debug, Default)]
    struct Run {
        /// Squares: marker in plan, shape per coordinate, scale, clock offset, readout.
        squares: [f64; 5],
        /// In the region: marker in a frame, a coordinate of a point, scale, clock offset, readout.
        covered: [bool; 5],
        /// Mean square of the standard deviations of all coordinates of the shape.
        shape_predicted: f64,
        /// Standard deviation of the scale.
        scale_sigma: f64,
        /// Whether the clock offset is said not to be observable.
        without_clock: bool,
    }

    const NAMES: [&str; 5] =
        ["marker xy [cm]", "shape [cm]", "scale [%]", "clock offset [ms]", "readout [ms]"];
    const UNITS: [f64; 5] = [100.0, 100.0, 100.0, 1000.0, 1000.0];

    fn run(flight: &Flight, seed: u64) -> Run {
        let (problem, truth) = flight.draw(seed);
        let (adjusted, diagnosis) = adjusted(&problem);
        let found = &adjusted.estimate.vehicles[0];
        let mark = found.points[0].unwrap();
        let off: Vec<Vector2<f64>> = found
            .poses
            .iter()
            .zip(&truth.vehicle)
            .filter_map(|(pose, wanted)| Some((pose.as_ref()? * mark - wanted * truth.points[0]).xy()))
            .collect();
        let frame = seed as usize * 7 % off.len();
        let track = diagnosis.precision.tracks[0][frame].unwrap();
        let [x, y, _] = track.position_m;
        let plan = track.covariance_xy_m2.map(|cov| Matrix2::new(x * x, cov, cov, y * y));
        let is_in_ellipse =
            plan.is_none_or(|plan| off[frame].dot(&(plan.try_inverse().unwrap() * off[frame])) < 5.991);

        let laid = laid_on_truth(&found.points, &truth.points);
        let (point, axis) = (seed as usize * 5 % truth.points.len(), seed as usize % 3);
        let of_point = laid[point].map(|p| p[axis] - truth.points[point][axis]);
        let point_sigma = diagnosis.precision.points[0][point].map(|sigma| sigma[axis]);

        let pairs = found.points.iter().zip(&truth.points).filter_map(|(p, q)| Some(((*p)?, *q)));
        let (points, wanted): (Vec<_>, Vec<_>) = pairs.unzip();
        let fit = rigid_fit(&wanted, &points).unwrap();
        let mean = wanted.iter().map(|p| p.coords).sum::<Vector3<f64>>() / wanted.len() as f64;
        let (mut dot, mut size, mut weighed) = (0.0, 0.0, 0.0);
        for (p, q) in points.iter().zip(&wanted) {
            dot += (fit * (q.coords - mean)).dot(&p.coords);
            size += (q.coords - mean).norm_squared();
            weighed += (p - fit * q).norm_squared() / 3.0;
        }
        let scale = dot / size - 1.0;
        let scale_sigma = diagnosis.scales[0].sigma;
        let estimated = |name: &str| diagnosis.parameters.iter().find(|p| p.name == name);
        let of = |name: &str, truth: f64| {
            estimated(name)
                .map_or((0.0, true), |p| (p.value - truth, (p.value - truth).abs() < 1.96 * p.sigma))
        };
        let (clock, readout) = (of("clock_offset_s", truth.clock_s), of("readout_s", truth.readout_s));
        Run {
            squares: [
                off.iter().map(|d| d.norm_squared() / 2.0).sum::<f64>() / off.len() as f64,
                weighed / points.len() as f64,
                scale * scale,
                clock.0 * clock.0,
                readout.0 * readout.0,
            ],
            covered: [
                is_in_ellipse,
                of_point.zip(point_sigma).is_none_or(|(error, sigma)| error.abs() < 1.96 * sigma),
                scale.abs() < 1.96 * scale_sigma,
                clock.1,
                readout.1,
            ],
            shape_predicted: {
                let all: Vec<f64> =
                    diagnosis.precision.points[0].iter().flatten().flatten().copied().collect();
                all.iter().map(|sigma| sigma * sigma).sum::<f64>() / all.len() as f64
            },
            scale_sigma,
            without_clock: estimated("clock_offset_s").is_none_or(|p| !p.is_observable),
        }
    }

    /// One result for each seed, on two threads.
    fn each<R: Send>(count: u64, of_seed: impl Fn(u64) -> R + Sync) -> Vec<R> {
        let half = |first: u64| -> Vec<R> {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
            (first..count).step_by(2).map(|seed| pool.install(|| of_seed(seed))).collect()
        };
        let [even, odd] = std::thread::scope(|scope| {
            let odd = scope.spawn(|| half(1));
            [half(0), odd.join().unwrap()]
        });
        let mut odd = odd.into_iter();
        even.into_iter().flat_map(|even| [Some(even), odd.next()]).flatten().collect()
    }

    fn root_mean(runs: &[Run], what: usize) -> f64 {
        (runs.iter().map(|run| run.squares[what]).sum::<f64>() / runs.len() as f64).sqrt()
    }

    fn coverage(runs: &[Run], what: usize) -> f64 {
        runs.iter().filter(|run| run.covered[what]).count() as f64 / runs.len() as f64
    }

    fn print(runs: &[Run]) {
        for (what, name) in NAMES.iter().enumerate() {
            println!(
                "{name}: rms {:.3}, in the 95 % region {:.1} %",
                root_mean(runs, what) * UNITS[what],
                100.0 * coverage(runs, what)
            );
        }
        let sigma = runs.iter().map(|run| run.scale_sigma).sum::<f64>() / runs.len() as f64;
        println!("scale: mean sigma {:.3} %", 100.0 * sigma);
    }

    fn runs() -> u64 {
        std::env::var("RUNS").map_or(200, |runs| runs.parse().expect("a number of runs"))
    }

    /// With GNSS everything is determined.
    pub fn with_gnss() {
        let runs = each(runs(), |seed| run(&Flight::default(), seed));
        print(&runs);
        for (what, most) in [0.022, f64::INFINITY, 0.0008, 0.0018, 0.0024].into_iter().enumerate() {
            let found = root_mean(&runs, what);
            assert!(found <= most, "{}: {found}", NAMES[what]);
            assert!((0.895..=0.99).contains(&coverage(&runs, what)), "{}", NAMES[what]);
        }
        // How well a point is known depends on how long it is seen. A rigid fit takes six numbers of all.
        let predicted = (runs.iter().map(|run| run.shape_predicted).sum::<f64>() / runs.len() as f64).sqrt();
        println!("shape: predicted {:.3} cm", 100.0 * predicted);
        assert!((0.85..1.05).contains(&(root_mean(&runs, 1) / predicted)));
    }

    /// Without GNSS the scale is weak and the clock is not observable.
    pub fn without_gnss() {
        let runs = each(runs(), |seed| run(&Flight { gnss: None, ..Flight::default() }, seed));
        print(&runs);
        assert!((0.895..=0.99).contains(&coverage(&runs, 2)));
        assert!(runs.iter().all(|run| run.without_clock && (0.007..0.011).contains(&run.scale_sigma)));
    }

    /// For each run how many standard deviations the tests of readout and clock offset are off.
    fn statistics(flight: &Flight, count: u64, clock_s: f64) -> Vec<[Option<f64>; 2]> {
        each(count, |seed| {
            let problem = held(flight, seed, clock_s);
            let (adjusted, _) = adjusted(&problem);
            ["readout_s", "clock_offset_s"].map(|name| {
                let tests = &adjusted.adjustment.directed_tests;
                tests.iter().find(|test| test.name == name).map(|test| test.statistic())
            })
        })
    }

    /// What is left out of the model is found.
    pub fn what_is_left_out() {
        for gnss in [Some((5.0, 0.02)), None] {
            let found = statistics(&Flight { gnss, ..Flight::default() }, runs(), 0.03);
            for (what, name) in ["readout", "clock offset"].iter().enumerate() {
                let tested: Vec<f64> = found.iter().filter_map(|run| run[what]).collect();
                if what == 1 && gnss.is_none() {
                    assert!(tested.is_empty());
                    continue;
                }
                let rejected =
                    tested.iter().filter(|w| w.abs() > CRITICAL).count() as f64 / tested.len() as f64;
                println!(
                    "GNSS {gnss:?}: {name} left out, rejected {:.1} % of {}",
                    100.0 * rejected,
                    tested.len()
                );
                assert!(rejected >= 0.95);
            }
        }
        // And where it is right: rejected once in a thousand runs.
        let right = Flight { readout_s: [0.0, 0.0], ..Flight::default() };
        let found = statistics(&right, runs().min(100), 0.0);
        let wrong = found.iter().flatten().flatten().filter(|w| w.abs() > CRITICAL).count();
        println!("right, and rejected: {wrong} of {}", 2 * found.len());
        assert!(wrong <= 2);
    }
}
