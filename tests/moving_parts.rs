//! What moves between two exposures: clocks, rows, and a receiver whose positions are observations.
//!
//! A short form runs with all tests; the study itself is
//!
//! ```text
//! cargo test --release --test moving_parts -- --ignored --nocapture
//! ```

mod support;

use support::moving::{Flight, Truth};
use trackbundle::diagnose::{Diagnosis, diagnose};
use trackbundle::geometry::align::rigid_fit;
use trackbundle::initialise::{Method, initialise};
use trackbundle::problem::Problem;
use trackbundle::refine::{Adjusted, RefineOptions, adjust};

fn adjusted(problem: &Problem) -> (Adjusted, Diagnosis) {
    let start = initialise(problem, Method::RobustWhereNeeded).unwrap().estimate;
    let mut adjusted = adjust(problem, &start, &RefineOptions::default(), None).unwrap();
    let diagnosis = diagnose(problem, &mut adjusted).expect("least squares").unwrap();
    (adjusted, diagnosis)
}

/// Errors of one run.
#[derive(Clone, Copy, Debug, Default)]
struct Errors {
    marker_m: f64,
    shape_m: f64,
    scale: f64,
    clock_s: f64,
    readout_s: f64,
}

fn errors(problem: &Problem, truth: &Truth, adjusted: &Adjusted) -> Errors {
    let found = &adjusted.estimate.vehicles[0];
    let mark = found.points[0].unwrap();
    let plan = found.poses.iter().zip(&truth.vehicle).filter_map(|(pose, wanted)| {
        Some((pose.as_ref()? * mark - wanted * truth.points[0]).xy().norm_squared() / 2.0)
    });
    let plan: Vec<f64> = plan.collect();
    let pairs = found.points.iter().zip(&truth.points).filter_map(|(p, q)| Some(((*p)?, *q)));
    let (points, wanted): (Vec<_>, Vec<_>) = pairs.unzip();
    let fit = rigid_fit(&wanted, &points).unwrap();
    let mean = wanted.iter().map(|p| p.coords).sum::<nalgebra::Vector3<f64>>() / wanted.len() as f64;
    let (mut dot, mut size, mut squares) = (0.0, 0.0, 0.0);
    for (p, q) in points.iter().zip(&wanted) {
        dot += (fit * (q.coords - mean)).dot(&p.coords);
        size += (q.coords - mean).norm_squared();
        squares += (p - fit * q).norm_squared() / 3.0;
    }
    Errors {
        marker_m: (plan.iter().sum::<f64>() / plan.len() as f64).sqrt(),
        shape_m: (squares / points.len() as f64).sqrt(),
        scale: dot / size - 1.0,
        clock_s: match problem.receivers.is_empty() {
            true => 0.0,
            false => adjusted.estimate.receivers[0].clock_offset_s - truth.clock_s,
        },
        readout_s: adjusted.estimate.readout_s - truth.readout_s,
    }
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

const SMALL: Flight = Flight {
    frames: 90,
    points: 60,
    targets: 20,
    image_px: 1.0,
    speed_mps: 10.0,
    height_m: 60.0,
    pose_m: 0.3,
    terrain_bias_m: 0.5,
    terrain_m: 0.05,
    roof_m: 0.1,
    clock_s: 0.03,
    readout_s: [0.03, 0.01],
    gross: 0.05,
    gnss: Some((5.0, 0.02)),
};

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
    println!("{:#}", report["verdict"]);
    println!("{:#}", report["estimated"]);
    println!("{:#}", report["directed_tests"]);
}

#[test]
#[ignore = "a study"]
fn explore() {
    let runs: u64 = std::env::var("RUNS").map_or(6, |runs| runs.parse().unwrap());
    for flight in [Flight::default(), Flight { gnss: None, ..Flight::default() }] {
        let mut squares = [0.0; 5];
        for seed in 0..runs {
            let (problem, truth) = flight.draw(seed);
            let clock = std::time::Instant::now();
            let (adjusted, diagnosis) = adjusted(&problem);
            let e = errors(&problem, &truth, &adjusted);
            for (sum, e) in squares.iter_mut().zip([e.marker_m, e.shape_m, e.scale, e.clock_s, e.readout_s]) {
                *sum += e * e;
            }
            println!(
                "{seed}: {} it {:?} {:.1} s {:.4} {:.4} {:.5} {:.5} {:.5} scale sigma {:.5} bias {:.3} ({:.3}) sigma0 {:?} {:?}",
                adjusted.adjustment.iterations(),
                adjusted.adjustment.stop.status(),
                clock.elapsed().as_secs_f64(),
                e.marker_m,
                e.shape_m,
                e.scale,
                e.clock_s,
                e.readout_s,
                diagnosis.scales[0].sigma,
                adjusted.estimate.terrain_bias_m,
                truth.bias_m,
                adjusted.adjustment.sigma0,
                adjusted.adjustment.fits.tally,
            );
        }
        println!("rms {:?}", squares.map(|s: f64| (s / runs as f64).sqrt()));
    }
}
