//! `trackbundle simulate`: what is written is what was said, whatever else is drawn.

use crate::support;

use nalgebra::{Point3, Vector2};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use support::score::{rows, score};
use support::{in_package, program};
use trackbundle::geometry::{Pose, interpolate, pose};
use trackbundle::internals::files::read_problem;
use trackbundle::internals::simulate::{Chance, World, WrongKind, read_scenario, simulated_files};
use trackbundle::internals::trajectory::Order;
use trackbundle::problem::Problem;

const SHIPPED: [&str; 9] =
    ["avenue", "crossing", "gross", "high", "paper", "road", "rolling", "streets", "van"];
/// Those that studies vary: bodies under the same drone, and a camera near the ground.
const OF_STUDIES: [&str; 6] = ["any-bus", "any-car", "any-low-car", "any-motorcycle", "any-van", "low"];

fn scenario(name: &str) -> PathBuf {
    in_package("problems/scenarios").join(format!("{name}.toml"))
}

fn simulate(scenario: &Path, out: &Path, more: &[&str]) {
    program().arg("simulate").arg(scenario).arg("--out").arg(out).args(more).assert().success();
}

/// All files below a folder.
fn contents(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut all = BTreeMap::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if path.is_dir() {
            all.extend(contents(&path).into_iter().map(|(inner, bytes)| (format!("{name}/{inner}"), bytes)));
        } else {
            all.insert(name, std::fs::read(&path).unwrap());
        }
    }
    all
}

/// Writes a scenario of its own.
fn written(folder: &Path, text: &str) -> PathBuf {
    let file = folder.join("scenario.toml");
    std::fs::write(&file, text).unwrap();
    file
}

const PLAIN: &str = "format = 1\nname = \"plain\"\n[camera]\npreset = \"pinhole-4k\"\n[film]\nframes = 40\n\
    [flight]\naltitude_m = 50.0\n[[vehicle]]\nid = \"car1\"\npoints = 25\n[targets]\ncount = 6\nspread_m = 15.0\n";

#[test]
fn every_shipped_scenario_is_a_problem_that_is_adjusted() {
    let folder = tempfile::tempdir().unwrap();
    for name in SHIPPED.into_iter().chain(OF_STUDIES) {
        let problem = folder.path().join(name);
        simulate(&scenario(name), &problem, &["-q"]);
        let result = folder.path().join(format!("{name}-out"));
        program()
            .arg("refine")
            .arg(&problem)
            .args(["--no-rrd", "-q", "--out"])
            .arg(&result)
            .assert()
            .success();
        // Of `low` the scale is known to 7 %.
        if name == "low" {
            continue;
        }
        for (vehicle, track_m) in [("car1", 0.1), ("car2", 0.1), ("van1", 0.15)] {
            if problem.join(format!("truth/trajectory_{vehicle}.csv")).exists() {
                let found = score(&result, &problem.join("truth"), vehicle);
                assert!(found.marker_rms_xy_m < track_m, "{name} {vehicle}: {found:?}");
                assert!(found.speed_mad_mps < 0.1, "{name} {vehicle}: {found:?}");
            }
        }
    }
    let files = std::fs::read_dir(in_package("problems/scenarios")).unwrap();
    let tomls = files.filter(|f| f.as_ref().unwrap().path().extension().is_some_and(|e| e == "toml")).count();
    assert_eq!(tomls, SHIPPED.len() + OF_STUDIES.len(), "all of them are tried");
}

#[test]
fn bytes_are_of_scenario_and_seed() {
    let folder = tempfile::tempdir().unwrap();
    let file = scenario("gross");
    for (name, more) in [("a", vec!["-q"]), ("b", vec!["-q"]), ("c", vec!["-q", "--seed", "2"])] {
        simulate(&file, &folder.path().join(name), &more);
    }
    let [a, b, c] = ["a", "b", "c"].map(|name| contents(&folder.path().join(name)));
    assert!(a == b);
    assert!(a["vehicle_observations.csv"] != c["vehicle_observations.csv"]);
    assert!(a["targets.csv"] != c["targets.csv"]);
    // What is there is left alone.
    program().arg("simulate").arg(&file).arg("--out").arg(folder.path().join("a")).assert().code(2);
    assert!(contents(&folder.path().join("a")) == a);
}

#[test]
fn what_is_written_is_what_was_simulated() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["gross", "high", "rolling"] {
        let place = folder.path().join(name);
        simulate(&scenario(name), &place, &["-q"]);
        let read = read_problem(&place).unwrap();
        let problem = read.problem.unwrap();
        let world = World::new(read_scenario(&scenario(name)).unwrap(), None).unwrap();
        let film = world.video(Chance::Run(0)).unwrap();
        assert_same(&problem, &film.problem, name);
    }
}

fn assert_same(read: &Problem, made: &Problem, name: &str) {
    assert_eq!(read.camera.size_px, made.camera.size_px);
    assert_eq!(read.camera, made.camera);
    assert_eq!(read.shutter, made.shutter);
    assert_eq!(read.calibration, made.calibration);
    assert_eq!(read.frames.len(), made.frames.len());
    let near = |a: f64, b: f64, within: f64| assert!((a - b).abs() < within, "{name}: {a} {b}");
    for (a, b) in read.frames.iter().zip(&made.frames) {
        near(a.time_s, b.time_s, 1e-6);
    }
    let same_pose = |a: &Option<Pose>, b: &Option<Pose>| match (a, b) {
        (Some(a), Some(b)) => {
            near((a.translation.vector - b.translation.vector).norm(), 0.0, 2e-6);
            near(a.rotation.angle_to(&b.rotation), 0.0, 1e-7);
        }
        (a, b) => assert_eq!(a.is_some(), b.is_some()),
    };
    read.camera_poses.iter().zip(&made.camera_poses).for_each(|(a, b)| same_pose(a, b));
    assert_eq!(read.vehicles.len(), made.vehicles.len());
    for (a, b) in read.vehicles.iter().zip(&made.vehicles) {
        assert_eq!((&a.id, a.marker, a.is_car), (&b.id, b.marker, b.is_car));
        a.poses.iter().zip(&b.poses).for_each(|(a, b)| same_pose(a, b));
        assert_eq!(a.observations.len(), b.observations.len());
        for (p, q) in a.observations.iter().zip(&b.observations) {
            assert_eq!((p.frame, p.point, p.sigma_px), (q.frame, q.point, q.sigma_px));
            near((p.image_px - q.image_px).norm(), 0.0, 1e-4);
        }
        for (p, q) in a.points.iter().zip(&b.points) {
            assert_eq!(p.id, q.id);
            for (p, q) in p.known.iter().zip(&q.known) {
                assert_eq!(p.is_some(), q.is_some());
                p.iter().zip(q).for_each(|(p, q)| near(p.value_m, q.value_m, 1e-6));
            }
        }
    }
    assert_eq!(read.targets.len(), made.targets.len());
    assert_eq!(read.target_observations.len(), made.target_observations.len());
    let (a, b) = (read.ground.as_ref().unwrap(), made.ground.as_ref().unwrap());
    let lasts_s = |of: &trackbundle::problem::GroundKnowledge| of.correlation_s.unwrap();
    for (a, b) in [(a.sigma_m, b.sigma_m), (lasts_s(a), lasts_s(b)), (a.tilt_sigma_rad, b.tilt_sigma_rad)] {
        near(a, b, 1e-8);
    }
    assert_eq!(read.receivers.len(), made.receivers.len());
    for (a, b) in read.receivers.iter().zip(&made.receivers) {
        assert_eq!((a.vehicle, a.point, a.positions.len()), (b.vehicle, b.point, b.positions.len()));
        assert_eq!(a.knowledge, b.knowledge);
    }
}

/// The pose of a path between the rows of its table.
fn at(times: &[f64], poses: &[Pose], t: f64) -> Pose {
    let k = times.partition_point(|s| *s <= t).clamp(1, times.len() - 1);
    interpolate(&poses[k - 1], &poses[k], (t - times[k - 1]) / (times[k] - times[k - 1]))
}

fn table_pose(row: &BTreeMap<String, String>) -> Pose {
    let n = |key: &str| row[key].parse::<f64>().unwrap();
    pose([n("x"), n("y"), n("z")], [n("qw"), n("qx"), n("qy"), n("qz")])
}

#[test]
fn exact_image_points_are_those_of_the_written_truth() {
    // Read back from tables alone, rows exposed one after another and all.
    let folder = tempfile::tempdir().unwrap();
    for name in ["crossing", "rolling", "high"] {
        let place = folder.path().join(name);
        simulate(&scenario(name), &place, &["-q", "--exact"]);
        let problem = read_problem(&place).unwrap().problem.unwrap();
        let truth = place.join("truth");
        let times: Vec<f64> = problem.frames.iter().map(|f| f.time_s).collect();
        let cameras: Vec<Pose> = rows(&truth.join("camera_poses.csv")).iter().map(table_pose).collect();
        let readout_s = problem.shutter.readout_s;
        let places: BTreeMap<(String, String), Point3<f64>> = rows(&truth.join("vehicle_points.csv"))
            .iter()
            .map(|r| {
                let n = |key: &str| r[key].parse::<f64>().unwrap();
                ((r["vehicle"].clone(), r["point"].clone()), Point3::new(n("x"), n("y"), n("z")))
            })
            .collect();
        let mut worst = 0.0_f64;
        for vehicle in &problem.vehicles {
            let of_vehicle = rows(&truth.join("vehicle_poses.csv"));
            let poses: Vec<Pose> =
                of_vehicle.iter().filter(|r| r["vehicle"] == vehicle.id).map(table_pose).collect();
            for o in &vehicle.observations {
                // The last frame has no later one to move to.
                if o.frame + 1 == times.len() || o.frame == 0 {
                    continue;
                }
                let t = times[o.frame] + problem.camera.row_delay(o.image_px.y) * readout_s;
                let point = places[&(vehicle.id.clone(), vehicle.points[o.point].id.clone())];
                let in_camera =
                    at(&times, &cameras, t).inverse_transform_point(&(at(&times, &poses, t) * point));
                let pixel = problem.camera.project(&in_camera.coords).unwrap();
                worst = worst.max((pixel - o.image_px).norm());
            }
        }
        // Poses between frames are straight here and smooth there: sway bends by some hundredths of a pixel.
        let limit = if readout_s > 0.0 { 0.3 } else { 1e-3 };
        assert!(worst < limit, "{name}: {worst}");
    }
}

#[test]
fn errors_scatter_as_stated() {
    let mut world = World::new(read_scenario(&scenario("crossing")).unwrap(), None).unwrap();
    let exact = world.video(Chance::Exact).unwrap();
    assert!(exact.gross.is_empty());
    world.scenario.errors.gross = 0.2;
    world.scenario.errors.vehicle_px = 2.0;
    let (mut squares, mut count, mut gross, mut survey, mut surveyed) = (0.0, 0, 0, 0.0, 0);
    for run in 0..20 {
        let film = world.video(Chance::Run(run)).unwrap();
        let wrong: std::collections::HashSet<(i64, String)> =
            film.gross.iter().map(|(frame, _, point)| (*frame, point.clone())).collect();
        let (vehicle, truth) = (&film.problem.vehicles[0], &film.truth);
        for o in &vehicle.observations {
            let place =
                truth.vehicles[0].poses[o.frame].unwrap() * truth.vehicles[0].points[o.point].unwrap();
            let in_camera = truth.camera_poses[o.frame].inverse_transform_point(&place);
            let off: Vector2<f64> = o.image_px - film.problem.camera.project(&in_camera.coords).unwrap();
            if wrong.contains(&(o.frame as i64, vehicle.points[o.point].id.clone())) {
                gross += 1;
                assert!(off.norm() > 2.0, "a gross error of at least 10 px");
            } else {
                squares += off.norm_squared();
                count += 2;
            }
        }
        for (target, place) in film.problem.targets.iter().zip(&truth.targets) {
            let off = target.surveyed().unwrap() - place.unwrap();
            survey += off.norm_squared();
            surveyed += 3;
        }
    }
    let sigma = (squares / f64::from(count)).sqrt();
    // Some 90,000 coordinates: a quarter of a per cent.
    assert!((sigma / 2.0 - 1.0).abs() < 0.01, "{sigma}");
    let share = f64::from(gross) / f64::from(gross + count / 2);
    assert!((share - 0.2).abs() < 0.01, "{share}");
    let sigma = (survey / f64::from(surveyed)).sqrt();
    assert!((sigma / 0.02 - 1.0).abs() < 0.1, "{sigma}");
}

#[test]
fn wrong_tracks_come_beside_those_of_the_body_and_are_told() {
    let base = read_scenario(&scenario("crossing")).unwrap();
    let without = World::new(base.clone(), None).unwrap().video(Chance::Run(3)).unwrap();
    let mut scenario = base;
    scenario.errors.static_tracks = 0.3;
    scenario.errors.sliding_tracks = 0.1;
    scenario.errors.foreign_tracks = 0.1;
    let world = World::new(scenario, None).unwrap();
    assert!(world.video(Chance::Exact).unwrap().wrong_tracks.iter().all(|tracks| tracks.is_empty()));
    let video = world.video(Chance::Run(3)).unwrap();
    let vehicle = &video.problem.vehicles[0];
    let is_wrong = |point: usize| video.wrong_tracks[0].contains_key(&vehicle.points[point].id);
    let of_body: Vec<_> = vehicle.observations.iter().filter(|o| !is_wrong(o.point)).copied().collect();
    assert_eq!(of_body, without.problem.vehicles[0].observations);
    let share = |kind: WrongKind| {
        let count = video.wrong_tracks[0].values().filter(|found| **found == kind).count();
        count as f64 / vehicle.points.len() as f64
    };
    for (kind, wanted) in [(WrongKind::Static, 0.3), (WrongKind::Sliding, 0.1), (WrongKind::Foreign, 0.1)] {
        // Of the tracks that were asked for; some points of the body have several, or are the mark.
        assert!((share(kind) - wanted).abs() < 0.03, "{kind:?}: {}", share(kind));
    }
    for point in (0..vehicle.points.len()).filter(|point| is_wrong(*point)) {
        let frames: Vec<usize> =
            vehicle.observations.iter().filter(|o| o.point == point).map(|o| o.frame).collect();
        assert!((8..=60).contains(&frames.len()) && frames.windows(2).all(|two| two[1] == two[0] + 1));
    }
    let files = simulated_files(&world, &video).unwrap();
    let table = files.iter().find(|(name, _)| name == "truth/wrong_tracks.csv").unwrap();
    let text = String::from_utf8(table.1.clone()).unwrap();
    assert_eq!(text.lines().next(), Some("vehicle,point,kind"));
    assert_eq!(text.lines().count(), 1 + video.wrong_tracks.iter().map(|tracks| tracks.len()).sum::<usize>());
    assert!(
        !simulated_files(&world, &without).unwrap().iter().any(|(name, _)| name == "truth/wrong_tracks.csv")
    );
}

#[test]
fn one_kind_of_error_does_not_move_another() {
    let base = read_scenario(&scenario("crossing")).unwrap();
    let mut other = base.clone();
    other.errors.vehicle_px = 3.0;
    other.targets.count = 5;
    let [a, b] = [base, other].map(|s| World::new(s, None).unwrap().video(Chance::Run(3)).unwrap());
    assert_eq!(a.problem.camera_poses, b.problem.camera_poses);
    assert_eq!(a.truth.vehicles[0].poses, b.truth.vehicles[0].poses);
    assert_eq!(a.problem.targets[..5], b.problem.targets[..]);
}

#[test]
fn a_path_of_known_strength_is_found_to_be_so_strong() {
    // Drives whose motion along the ground and yaw are as strong as stated; contact with the ground is not to make
    // them look weaker.
    let mut found = Vec::new();
    for seed in 0..6 {
        let world = World::new(read_scenario(&scenario("crossing")).unwrap(), Some(seed)).unwrap();
        let film = world.video(Chance::Run(seed)).unwrap();
        let start = trackbundle::internals::initialise::initialise(
            &film.problem,
            trackbundle::internals::initialise::Method::RobustWhereNeeded,
        )
        .unwrap();
        let options = trackbundle::internals::refine::RefineOptions::default();
        let (_, adjustment) = crate::support::refine(&film.problem, &start.estimate, &options, None).unwrap();
        let own = adjustment
            .motion
            .iter()
            .find(|m| m.body != trackbundle::internals::refine::Body::Camera)
            .unwrap();
        assert_eq!(own.order, Order::Acceleration);
        found.push([own.strength.linear, own.strength.angular]);
    }
    let mean = |k: usize| (found.iter().map(|f| f[k] * f[k]).sum::<f64>() / found.len() as f64).sqrt();
    // A wander of sigma that lasts T has white acceleration of sigma sqrt(32 / T^3), but for what is slower than T.
    let strength = |sigma: f64| sigma * (32.0_f64 / 64.0).sqrt();
    let (linear, angular) = (mean(0) / strength(0.2), mean(1) / strength(0.8_f64.to_radians()));
    assert!((0.75..1.2).contains(&linear), "{linear}");
    assert!((0.65..1.3).contains(&angular), "{angular}");
}

#[test]
fn bad_scenarios_are_told_by_line_and_key() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let cases: [(&str, &str, &str); 14] = [
        ("preset = \"pinhole-4k\"", "preset = \"leica\"", "camera.preset: expected one of dji-mini-2"),
        ("altitude_m = 50.0", "altitude = 50.0", "flight.altitude: expected a key that is known"),
        ("altitude_m = 50.0", "altitude_m = -5.0", "flight.altitude_m: expected a finite number above 0"),
        ("altitude_m = 50.0", "altitude_m = nan", "flight.altitude_m: expected"),
        ("points = 25", "points = 2", "vehicle.points: expected a whole number from 3"),
        ("points = 25", "points = 1e9", "vehicle.points: expected a whole number"),
        ("id = \"car1\"", "id = \"a/b\"", "vehicle.id: expected an id that can be part of a file name"),
        (
            "frames = 40",
            "frames = 40\nduration_s = 3.0",
            "film.frames: expected one of frames and duration_s",
        ),
        ("count = 6", "count = 6\ncheck = 7", "targets.check: expected a whole number from 0 to 6"),
        ("points = 25", "points = 25\nbody = { scan = \"none.ply\" }", "none.ply"),
        ("points = 25", "points = 25\npath = \"none.csv\"", "none.csv"),
        ("[targets]", "[terrain]\ngrid = \"none.asc\"\n[targets]", "none.asc"),
        (
            "[targets]\ncount = 6",
            "[camera_poses]\ngiven = \"none\"\n[targets]\ncount = 2",
            "three targets or more",
        ),
        ("format = 1", "format = 1\nseed = -1", "seed: expected a whole number"),
    ];
    for (from, to, wanted) in cases {
        let text = PLAIN.replace(from, to);
        assert_ne!(text, PLAIN, "{from}");
        let file = written(folder.path(), &text);
        let run = program().arg("simulate").arg(&file).arg("--out").arg(&out).assert().code(3);
        let said = String::from_utf8_lossy(&run.get_output().stderr).into_owned();
        assert!(said.contains(wanted), "{to}: {said}");
        assert!(!out.exists(), "nothing is written");
    }
    // A vehicle that drives off the ground, and one that is nowhere near.
    std::fs::write(
        folder.path().join("small.asc"),
        "ncols 3\nnrows 3\nxllcorner -30\nyllcorner -30\ncellsize 20\nNODATA_value -9999\n0 0 0\n0 0 0\n0 0 0\n",
    )
    .unwrap();
    let text = PLAIN
        .replace("[targets]", "[terrain]\ngrid = \"small.asc\"\n[targets]")
        .replace("points = 25", "points = 25\nspeed_mps = 60.0");
    let file = written(folder.path(), &text);
    let run = program().arg("simulate").arg(&file).arg("--out").arg(&out).assert().code(3);
    let said = String::from_utf8_lossy(&run.get_output().stderr).into_owned();
    assert!(
        said.contains("ground under car1 on its way") && said.contains("outside the terrain grid"),
        "{said}"
    );
    let file = written(folder.path(), &PLAIN.replace("points = 25", "points = 25\nx_m = 5000.0"));
    program().arg("simulate").arg(&file).arg("--out").arg(&out).assert().code(4);
    assert!(!out.exists());
}

#[test]
fn flights_and_terrain_are_as_said() {
    let folder = tempfile::tempdir().unwrap();
    let heights = "ncols 3\nnrows 3\nxllcorner -150\nyllcorner -150\ncellsize 100\nNODATA_value -9999\n\
                   8 9 10\n4 5 6\n0 1 2\n";
    std::fs::write(folder.path().join("slope.asc"), heights).unwrap();
    let quiet = "drift_m = 0.0\nsway_deg = 0.0\n";
    for (flight, check) in [
        ("kind = \"hover\"\ntilt_deg = 30.0\n", 0),
        ("kind = \"straight\"\nspeed_mps = 4.0\ndirection_deg = 90.0\n", 1),
        ("kind = \"orbit\"\nradius_m = 20.0\nturn_dps = 10.0\n", 2),
        ("kind = \"follow\"\n", 3),
    ] {
        let text =
            PLAIN.replace("altitude_m = 50.0\n", &format!("altitude_m = 50.0\n{flight}{quiet}")).replace(
                "[targets]",
                "[terrain]\ngrid = \"slope.asc\"\nsigma_m = 0.0\ntilt_sigma_deg = 0.0\n[targets]",
            );
        let file = written(folder.path(), &text);
        let world = World::new(read_scenario(&file).unwrap(), None).unwrap();
        let film = world.video(Chance::Exact).unwrap();
        let (cameras, vehicle) = (&film.truth.camera_poses, &film.truth.vehicles[0]);
        let ground = |x: f64, y: f64| 5.0 + 0.01 * x + 0.04 * y;
        let place = |k: usize| cameras[k].translation.vector;
        let looks = |k: usize| cameras[k].rotation * nalgebra::Vector3::z();
        for k in [0, 17, 39] {
            assert!((place(k).z - 55.0).abs() < 1e-9, "{check}");
            let since = (k as f64 - 19.5) / 30.0;
            match check {
                0 => assert!((looks(k).z + 30_f64.to_radians().cos()).abs() < 1e-9),
                1 => assert!((place(k).y - 4.0 * since).abs() < 1e-9 && place(k).x.abs() < 1e-9),
                2 => {
                    assert!((place(k).xy().norm() - 20.0).abs() < 1e-9);
                    // It looks at the middle.
                    let hit = place(k) + looks(k) * (50.0 / -looks(k).z);
                    assert!(hit.xy().norm() < 1e-9);
                }
                _ => {
                    let car = vehicle.poses[k].unwrap().translation.vector;
                    assert!(
                        (place(k).xy() - car.xy()).norm() < 0.5,
                        "it stays above, but for the car's own wander aside"
                    );
                }
            }
            let car = vehicle.poses[k].unwrap();
            let foot = car.translation.vector;
            assert!((foot.z - ground(foot.x, foot.y)).abs() < 1e-9);
            let up = car.rotation * nalgebra::Vector3::z();
            let normal = nalgebra::Vector3::new(-0.01, -0.04, 1.0).normalize();
            assert!((up - normal).norm() < 1e-9);
        }
        // A point that faces away is not seen, and what is seen faces the camera.
        assert!(film.problem.vehicles[0].observations.len() > 300);
    }
}

#[test]
fn tracks_are_born_and_die_and_image_points_drop_out() {
    let folder = tempfile::tempdir().unwrap();
    let at_once = |more: &str| {
        let file = written(folder.path(), &PLAIN.replace("points = 25", &format!("points = 25\n{more}")));
        let world = World::new(read_scenario(&file).unwrap(), None).unwrap();
        world.video(Chance::Run(0)).unwrap().problem.vehicles.remove(0)
    };
    let (whole, short, thin) = (at_once(""), at_once("track_s = 0.5"), at_once("dropout = 0.4"));
    assert!(short.points.len() > 2 * whole.points.len(), "{} {}", short.points.len(), whole.points.len());
    let share = thin.observations.len() as f64 / whole.observations.len() as f64;
    assert!((share - 0.6).abs() < 0.05, "{share}");
    assert!(short.sightings().iter().all(|count| *count >= 2));
}
