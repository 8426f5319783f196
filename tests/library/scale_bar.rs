//! A known distance between two shape points: from the folder into the problem, and as what holds the scale.

use std::path::Path;
use trackbundle::internals::diagnose::{Diagnosis, diagnose, source_key};
use trackbundle::internals::files::{problem_files, read_problem};
use trackbundle::internals::initialise::{Method, initialise};
use trackbundle::internals::refine::{
    Adjusted, MotionPriors, RefineOptions, Source, adjust_network as adjust,
};
use trackbundle::internals::simulate::{Chance, SimulatedVideo, World, parse};
use trackbundle::problem::{Fault, Faults, Part, Problem, Wrong};

/// Nothing but bars knows the size of the car: no ground, no height, starting poses only. Image points are so good
/// that the ends of a bar are seen much better than its length is known.
fn world(bars: &str) -> World {
    let text = format!(
        "format = 1\nname = \"bar\"\nseed = 5\n[camera]\npreset = \"pinhole-4k\"\n[film]\nframes = 30\n\
         [flight]\naltitude_m = 40.0\n[terrain]\nknown = false\n[[vehicle]]\nid = \"car1\"\npoints = 30\n{bars}\n\
         [targets]\ncount = 12\nspread_m = 14.0\n[errors]\nvehicle_px = 0.2\n[vehicle_poses]\ngiven = \"start\"\n"
    );
    let scenario = parse("bar.toml", &text, Path::new("")).unwrap_or_else(|findings| panic!("{findings}"));
    World::new(scenario, None).unwrap_or_else(|findings| panic!("{findings}"))
}

fn video(bars: &str, run: u64) -> SimulatedVideo {
    world(bars).video(Chance::Run(run)).unwrap_or_else(|findings| panic!("{findings}"))
}

fn diagnosed(problem: &Problem) -> (Adjusted, Diagnosis) {
    let start = initialise(problem, Method::RobustWhereNeeded).unwrap().estimate;
    let options = RefineOptions { motion: MotionPriors::OFF, ..Default::default() };
    let mut adjusted = adjust(problem, &start, &options, None).unwrap();
    let diagnosis = diagnose(problem, &mut adjusted).expect("least squares").unwrap();
    (adjusted, diagnosis)
}

/// How much too large the shape is: the mean of ratios of distances from the marker.
fn scale_error(video: &SimulatedVideo, adjusted: &Adjusted) -> f64 {
    let mark = video.problem.vehicles[0].marker.unwrap();
    let [found, truth] = [&adjusted.estimate, &video.truth].map(|estimate| &estimate.vehicles[0].points);
    let far =
        |points: &[Option<nalgebra::Point3<f64>>], at: usize| Some((points[at]? - points[mark]?).norm());
    let pairs: Vec<[f64; 2]> = (0..truth.len())
        .filter(|at| *at != mark)
        .filter_map(|at| Some([far(found, at)?, far(truth, at)?]))
        .collect();
    let [found, truth] = [0, 1].map(|of| pairs.iter().map(|pair| pair[of]).sum::<f64>());
    found / truth - 1.0
}

#[test]
fn one_bar_holds_the_scale_and_all_of_it() {
    for run in 0..3 {
        let video = video("scale_bars = 1\nscale_bar_sigma_m = 0.02", run);
        let (adjusted, diagnosis) = diagnosed(&video.problem);
        let scale = &diagnosis.scales[0];
        let share = |wanted: Source| {
            scale.shares.iter().filter(|(source, _)| *source == wanted).map(|(_, share)| share).sum::<f64>()
        };
        println!("run {run}: {:?}", scale.shares);
        let sum: f64 = scale.shares.iter().map(|(_, share)| share).sum();
        assert!((sum - 1.0).abs() < 1e-6, "{sum}");
        assert!(share(Source::KnownDistance) > 0.9, "{:?}", scale.shares);
        let bar = video.problem.vehicles[0].scale_bars[0];
        let by_hand = bar.sigma_m / bar.length_m;
        println!("run {run}: sigma {:e}, by hand {by_hand:e}", scale.sigma);
        assert!((scale.sigma / by_hand - 1.0).abs() < 0.1, "{} {by_hand}", scale.sigma);
        let error = scale_error(&video, &adjusted);
        println!("scale error {error:e}");
        assert!(error.abs() < 3.0 * scale.sigma, "{error} {}", scale.sigma);
    }
    assert_eq!(source_key(Source::KnownDistance), "known distances");
    let (_, without) = diagnosed(&video("", 0).problem);
    assert!(without.scales[0].sigma.is_infinite(), "{:?}", without.scales[0]);
}

#[test]
fn bars_are_drawn_apart_from_all_else() {
    let [without, with] = ["", "scale_bars = 6"].map(|bars| video(bars, 1).problem);
    assert!(without.vehicles[0].scale_bars.is_empty());
    assert_eq!(without.vehicles[0].observations, with.vehicles[0].observations);
    assert_eq!(without.targets, with.targets);
    let files = |problem: &Problem| problem_files(problem, None);
    for ((name, a), (_, b)) in files(&without).into_iter().zip(files(&with)) {
        assert_eq!(a == b, name != "problem.toml", "{name}");
    }
    let bars = &with.vehicles[0].scale_bars;
    assert_eq!(bars.len(), 6);
    // The plan stays, the errors do not; they are of the stated size.
    let other = &video("scale_bars = 6", 2);
    let truth = &other.truth.vehicles[0].points;
    for (one, two) in bars.iter().zip(&other.problem.vehicles[0].scale_bars) {
        assert_eq!(one.points, two.points);
        assert!(one.length_m != two.length_m && one.length_m > 1.5, "{one:?}");
        let [a, b] = two.points.map(|point| truth[point].unwrap());
        assert!(((a - b).norm() - two.length_m).abs() < 4.0 * two.sigma_m, "{two:?}");
    }
}

fn write(problem: &Problem, folder: &Path, change: impl Fn(&str) -> String) {
    for (name, bytes) in problem_files(problem, None) {
        let file = folder.join(&name);
        std::fs::create_dir_all(file.parent().unwrap()).unwrap();
        if name == "problem.toml" {
            std::fs::write(file, change(&String::from_utf8(bytes).unwrap())).unwrap();
        } else {
            std::fs::write(file, bytes).unwrap();
        }
    }
}

#[test]
fn a_folder_gives_back_the_bars_that_were_written() {
    let problem = video("scale_bars = 3", 0).problem;
    let folder = tempfile::tempdir().unwrap();
    write(&problem, folder.path(), str::to_owned);
    let read = read_problem(folder.path()).unwrap_or_else(|findings| panic!("{findings}")).problem.unwrap();
    let [wanted, found] = [&problem, &read].map(|problem| &problem.vehicles[0].scale_bars);
    assert_eq!([wanted.len(), found.len()], [3, 3]);
    for (wanted, found) in wanted.iter().zip(found) {
        assert_eq!(wanted.points, found.points);
        assert!((wanted.length_m - found.length_m).abs() < 1e-8);
        assert_eq!(wanted.sigma_m, found.sigma_m);
    }
}

#[test]
fn a_wrong_bar_is_a_finding_with_its_line() {
    let problem = video("", 0).problem;
    let bar = [
        "[[distance]]",
        "vehicle = \"car1\"",
        "points = [\"mark\", \"p00001\"]",
        "length_m = 2.5",
        "sigma_m = 0.01",
    ];
    let two = "two points of the vehicle that differ";
    let cases = [
        (1, "vehicle = \"bus\"", "distance.vehicle", "the id of a vehicle", "bus"),
        (1, "", "distance.vehicle", "the id of a vehicle", "nothing"),
        (2, "points = [\"mark\", \"p9\"]", "distance.points", "points that are observed", "p9"),
        (2, "points = [\"mark\", \"mark\"]", "distance.points", two, "]"),
        (2, "points = [\"mark\"]", "distance.points", two, "]"),
        (3, "length_m = 0.0", "distance.length_m", "a finite number above 0", "0.0"),
        (3, "", "distance.length_m", "a finite number above 0", "nothing"),
        (4, "sigma_m = -0.01", "distance.sigma_m", "a finite number above 0", "-0.01"),
    ];
    for (at, line, key, wanted, found) in cases {
        let mut lines = bar;
        lines[at] = line;
        let folder = tempfile::tempdir().unwrap();
        write(&problem, folder.path(), |text| format!("{text}\n{}\n", lines.join("\n")));
        let text = std::fs::read_to_string(folder.path().join("problem.toml")).unwrap();
        let first = text.lines().position(|line| line == "[[distance]]").unwrap() + 1;
        let place = if found == "nothing" { first } else { first + at };
        let Err(findings) = read_problem(folder.path()) else { panic!("{line} is taken") };
        let all: Vec<String> = findings.errors().map(ToString::to_string).collect();
        let [only] = all.as_slice() else { panic!("{all:?}") };
        let wanted = format!("problem.toml:{place}: column {key}: expected {wanted}, found ");
        assert!(only.starts_with(&wanted), "{only} instead of {wanted}");
        assert!(only.ends_with(&format!("{found}\"")) || only.ends_with(found), "{only}");
    }
}

#[test]
fn a_problem_in_memory_is_checked() {
    let valid = video("scale_bars = 2", 0).problem;
    assert_eq!(valid.check(), Ok(()));
    let count = valid.vehicles[0].points.len();
    type Breach = (fn(&mut Problem), fn(usize) -> Wrong);
    let breaches: [Breach; 5] = [
        (
            |p| p.vehicles[0].scale_bars[1].points[0] = p.vehicles[0].points.len(),
            |count| Wrong::Index { found: count, count },
        ),
        (
            |p| p.vehicles[0].scale_bars[1].points[0] = p.vehicles[0].scale_bars[1].points[1],
            |_| Wrong::Repeated,
        ),
        (|p| p.vehicles[0].scale_bars[0].length_m = 0.0, |_| Wrong::NotAboveZero(0.0)),
        (|p| p.vehicles[0].scale_bars[0].length_m = f64::NAN, |_| Wrong::NotFinite),
        (|p| p.vehicles[0].scale_bars[0].sigma_m = -1.0, |_| Wrong::NotAboveZero(-1.0)),
    ];
    for (breach, wrong) in breaches {
        let mut problem = valid.clone();
        breach(&mut problem);
        let fault = Fault { part: Part::Vehicle(0), field: "scale_bars", wrong: wrong(count) };
        assert_eq!(problem.check(), Err(Faults(vec![fault])));
    }
}
