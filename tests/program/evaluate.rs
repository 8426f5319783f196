//! The command `evaluate`: small folders made by hand, each error in them known.

use crate::support;

use predicates::prelude::*;
use serde_json::Value;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use support::score::rows;
use support::{in_package, program};
use tempfile::TempDir;

const TRACK: &str = "vehicle,frame,time_s,x,y,z,speed_mps,heading_deg,sigma_x,sigma_y,sigma_z,cov_xy,\
                     sigma_speed_mps,sigma_heading_deg\n";

/// A road with bends, and the velocity on it.
fn road(t: f64) -> ([f64; 2], [f64; 2]) {
    let place = [6.0 * t + 8.0 * (0.4 * t).sin(), 12.0 * (0.3 * t).cos()];
    (place, [6.0 + 3.2 * (0.4 * t).cos(), -3.6 * (0.3 * t).sin()])
}

fn straight(t: f64) -> ([f64; 2], [f64; 2]) {
    ([10.0 * t, 0.0], [10.0, 0.0])
}

/// A track that is off by (0.1, -0.2, 0.3) m and 0.05 m/s.
fn track(road: fn(f64) -> ([f64; 2], [f64; 2])) -> String {
    let mut text = TRACK.to_owned();
    for frame in 0..200 {
        let t = f64::from(frame) * 0.1;
        let ([x, y], [vx, vy]) = road(t);
        let (x, y, speed) = (x + 0.1, y - 0.2, vx.hypot(vy) + 0.05);
        text += &format!("a,{frame},{t:.1},{x},{y},1.3,{speed},0,0.03,0.03,inf,0.0,,\n");
    }
    text
}

/// A receiver at 5 Hz that sees the film from 2.05 s on, its clock 0.12 s ahead.
fn receiver(road: fn(f64) -> ([f64; 2], [f64; 2])) -> String {
    let mut text = "vehicle,time_s,x,y,z,vx,vy,vz,sigma_x,sigma_y,sigma_z\n".to_owned();
    for k in 0..100 {
        let t = 2.05 + 0.2 * f64::from(k);
        let ([x, y], [vx, vy]) = road(t);
        text += &format!("a,{:.2},{x},{y},1.0,{vx},{vy},0,0.04,0.04,0.08\n", t + 0.12);
    }
    text
}

/// A problem of 20 s with two vehicles, and a result of one of them.
struct Folders {
    _place: TempDir,
    problem: PathBuf,
    result: PathBuf,
}

impl Folders {
    fn new(road: fn(f64) -> ([f64; 2], [f64; 2])) -> Self {
        let place = tempfile::tempdir().unwrap();
        let (problem, result) = (place.path().join("problem"), place.path().join("result"));
        std::fs::create_dir_all(problem.join("reference")).unwrap();
        std::fs::create_dir(&result).unwrap();
        let save = |name: &str, text: &str| std::fs::write(problem.join(name), text).unwrap();
        save(
            "problem.toml",
            "format = 1\nname = \"p\"\n[camera]\nmodel = \"pinhole\"\nwidth = 100\nheight = 100\nfx = 100.0\n\
             fy = 100.0\ncx = 50.0\ncy = 50.0\n[terrain]\nplane_z = 0.0\n[[vehicle]]\nid = \"a\"\n",
        );
        let mut frames = "frame,time_s\n".to_owned();
        let mut cameras = "frame,x,y,z,qw,qx,qy,qz\n".to_owned();
        let mut points = "frame,vehicle,point,u,v\n".to_owned();
        for frame in 0..200 {
            frames += &format!("{frame},{:.1}\n", f64::from(frame) * 0.1);
            cameras += &format!("{frame},0,0,50,0,1,0,0\n");
            points += &format!("{frame},a,p,50,50\n");
        }
        save("frames.csv", &frames);
        save("camera_poses.csv", &cameras);
        save("vehicle_observations.csv", &points);
        let folders = Folders { _place: place, problem, result };
        folders.save_reference(&receiver(road));
        folders.save_track(&track(road));
        folders
    }

    fn save_reference(&self, text: &str) {
        std::fs::write(self.problem.join("reference/gnss.csv"), text).unwrap();
    }

    fn save_track(&self, text: &str) {
        std::fs::write(self.result.join("trajectories.csv"), text).unwrap();
    }

    fn command(&self, more: &[&str]) -> assert_cmd::Command {
        let mut command = program();
        command.arg("evaluate").arg(&self.problem).arg(&self.result).args(more);
        command
    }

    fn json(&self, more: &[&str]) -> Value {
        let output = self.command(more).arg("--json").output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
        serde_json::from_slice(&output.stdout).unwrap()
    }
}

fn near(found: &Value, wanted: f64, within: f64) {
    let number = found.as_f64().unwrap_or(f64::NAN);
    assert!((number - wanted).abs() <= within, "{found} is not {wanted} within {within}");
}

#[test]
fn known_errors_come_back() {
    let folders = Folders::new(road);
    for offset in ["0.12", "estimate"] {
        let report = folders.json(&["--clock-offset", offset]);
        assert_eq!((&report["schema"], &report["alignment"]), (&1.into(), &"none".into()));
        let vehicle = &report["vehicles"][0];
        let track = &vehicle["track"];
        near(&vehicle["clock_offset_s"], 0.12, 5e-4);
        for (axis, wanted) in [("x", 0.1), ("y", -0.2), ("z", 0.3)] {
            near(&track[axis]["median"], wanted, 2e-3);
            near(&track[axis]["mean"], wanted, 2e-3);
            near(&track[axis]["rms"], f64::abs(wanted), 2e-3);
            near(&track[axis]["mad"], 0.0, 2e-3);
        }
        near(&track["ce90_m"], 0.1_f64.hypot(0.2), 3e-3);
        near(&track["le90_m"], 0.3, 1e-9);
        near(&track["speed"]["median"], 0.05, 1e-2);
        assert_eq!(track["speed_source"], "measured");
        // Per axis 0.03^2 + 0.04^2 = 0.05^2.
        near(&track["chi_square_per_freedom"], 0.5 * (0.01 + 0.04) / 0.0025, 0.5);
        assert_eq!(track["sigma_m"], serde_json::json!([0.03, 0.03, null]));
        near(&track["reference_sigma_m"][2], 0.08, 1e-9);
        assert_eq!((&track["frames"], &track["reference_positions"]), (&200.into(), &100.into()));
        assert_eq!((&track["compared"], &track["outside"]), (&179.into(), &21.into()));
        assert_eq!(vehicle["clock"]["matters"], false);
    }
}

#[test]
fn clocks_are_compared_as_they_are_unless_told_otherwise() {
    let folders = Folders::new(road);
    let report = folders.json(&[]);
    let vehicle = &report["vehicles"][0];
    near(&vehicle["clock_offset_s"], 0.0, 0.0);
    let clock = &vehicle["clock"];
    near(&clock["offset_s"], 0.12, 5e-4);
    near(&clock["shift_m"][0], 0.1, 2e-3);
    near(&clock["shift_m"][1], -0.2, 2e-3);
    assert_eq!((&clock["observable"], &clock["matters"]), (&true.into(), &true.into()));
    // With the shift of the folders: what 0.12 s are at some 7 m/s.
    assert!(vehicle["track"]["along"]["median"].as_f64().unwrap() > 0.6);
    let told = folders.command(&[]).assert().success();
    told.stderr(predicate::str::contains("--clock-offset estimate"));
    folders.command(&["--clock-offset", "0.12"]).assert().success().stderr("");
    let early = folders.json(&["--clock-offset", "-0.3"]);
    near(&early["vehicles"][0]["clock_offset_s"], -0.3, 0.0);
}

#[test]
fn the_text_has_names_units_and_what_was_done() {
    let folders = Folders::new(road);
    let output = folders.command(&["--clock-offset", "estimate"]).output().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    for wanted in [
        "result minus reference; alignment none\n",
        "association the reference at the times of frames",
        "vehicle     a: 179 compared of 200 frames and 100 positions of the reference; 21 outside, 0 in gaps (steps above 1.000 s)",
        "t_reference = t_video + 0.1200 s (estimated)",
        "m_x 0.1",
        "D_x 0.0",
        "m_y -0.2",
        "along track m_along",
        "half width at half maximum",
        "CE90, LE90  0.2",
        "reference by its own velocities",
        "sigma       x y z, median: result 0.0300 0.0300 - m, reference 0.0400 0.0400 0.0800 m",
        "chi-square  of x and y",
    ] {
        assert!(text.contains(wanted), "{wanted:?} is not in\n{text}");
    }
    let nearest = folders.command(&["--association", "nearest"]).assert().success();
    nearest
        .stdout(predicate::str::contains("association each position of the sparser track with the nearest"));
    folders.command(&["--quiet"]).assert().success().stdout("").stderr("");
}

#[test]
fn a_constant_velocity_says_nothing_of_clocks_but_can_be_compared() {
    let folders = Folders::new(straight);
    let report = folders.json(&[]);
    let clock = &report["vehicles"][0]["clock"];
    assert_eq!((&clock["observable"], &clock["offset_s"]), (&false.into(), &Value::Null));
    assert!(clock["why"].as_str().unwrap().contains("change of velocity"), "{clock}");
    // 0.12 s are 1.2 m along x.
    near(&report["vehicles"][0]["track"]["x"]["median"], 1.3, 1e-6);
    let refused = folders.command(&["--clock-offset", "estimate"]).assert().code(4).stdout("");
    refused.stderr(predicate::str::contains("vehicle a: the offset of its clock cannot be estimated"));
    let told = folders.json(&["--clock-shift", "none"]);
    // With the shift of 0.1 m for 10 ms.
    near(&told["vehicles"][0]["clock"]["offset_s"], 0.13, 2e-3);
}

#[test]
fn what_is_wrong_with_either_folder_is_named_at_once() {
    let folders = Folders::new(road);
    let row = |cells: &str| format!("{TRACK}{cells}\n");
    for (text, wanted) in [
        (
            row("a,0,0,nan,0,0,1,0,,,,,,"),
            "trajectories.csv:2: column x: expected a finite number, found \"nan\"",
        ),
        (row("a,0,0,,0,0,1,0,,,,,,"), "trajectories.csv:2: column x: expected a finite number"),
        (row("a,0,soon,0,0,0,1,0,,,,,,"), "trajectories.csv:2: column time_s"),
        (
            row("b,0,0,0,0,0,1,0,,,,,,"),
            "trajectories.csv:2: column vehicle: expected a vehicle of problem.toml",
        ),
        (row("a,999,0,0,0,0,1,0,,,,,,"), "trajectories.csv:2: column frame: expected a frame of frames.csv"),
        (row("a,0,0,0,0,0,1,0,-1,,,,,"), "trajectories.csv:2: column sigma_x"),
        (row("a,0,0,0,0,0,1,0,,,,inf,,"), "trajectories.csv:2: column cov_xy"),
        (
            row("a,1,0.1,0,0,0,1,0,,,,,,\na,0,0,0,0,0,1,0,,,,,,"),
            "trajectories.csv:3: column time_s: expected a time after 0.1",
        ),
        (
            row("a,1,0.1,0,0,0,1,0,,,,,,\na,1,0.1,0,0,0,1,0,,,,,,"),
            "trajectories.csv:3: column frame: expected a frame that is listed once",
        ),
        (row("a,0,0"), "trajectories.csv:2: expected 14 cells"),
        (String::new(), "trajectories.csv:1: column vehicle: expected this column"),
        ("vehicle,frame,time_s,x,y\n".to_owned(), "trajectories.csv:1: column z: expected this column"),
    ] {
        folders.save_track(&text);
        let refused = folders.command(&["--json"]).assert().code(3).stdout("");
        refused.stderr(predicate::str::contains(wanted).and(predicate::str::contains("panicked").not()));
    }
    folders.save_track(&row("a,0,0,nan,0,0,1,0,,,,,,"));
    folders.save_reference("vehicle,time_s,x,y,z\na,1,0,0,0\na,1,0,0,0\n");
    let refused = folders.command(&[]).assert().code(3);
    refused.stderr(
        predicate::str::contains("reference/gnss.csv:3: column time_s")
            .and(predicate::str::contains("trajectories.csv:2: column x")),
    );
    std::fs::remove_file(folders.result.join("trajectories.csv")).unwrap();
    folders.save_reference(&receiver(road));
    let refused = folders.command(&[]).assert().code(3);
    refused.stderr(predicate::str::contains("trajectories.csv: expected a table that can be read"));
}

#[test]
fn where_nothing_can_be_compared_it_is_said_why() {
    let folders = Folders::new(road);
    let refused = |wanted: &str| {
        let refused = folders.command(&[]).assert().code(4).stdout("");
        refused.stderr(predicate::str::contains(wanted).and(predicate::str::contains("panicked").not()));
    };
    folders.save_track(TRACK);
    refused("vehicle a: the result has no track of it");
    folders.save_track(&track(road));
    folders.save_reference("vehicle,time_s,x,y,z\n");
    refused("vehicle a: reference/ has no position of it");
    folders.save_reference("vehicle,time_s,x,y,z\na,1,0,0,0\n");
    refused("the reference a single position at 1.000 s");
    folders.save_reference("vehicle,time_s,x,y,z\na,100,0,0,0\na,101,0,0,0\n");
    refused("the track is 0.000 s to 19.900 s, the reference 100.000 s to 101.000 s");
    std::fs::remove_file(folders.problem.join("reference/gnss.csv")).unwrap();
    refused("vehicle a: reference/ has no position of it");
}

/// What was adjusted to is no check.
#[test]
fn a_reference_that_was_an_observation_is_refused() {
    let folders = Folders::new(road);
    let reference = receiver(road);
    let row: Vec<&str> = reference.lines().nth(3).unwrap().split(',').collect();
    std::fs::create_dir(folders.problem.join("observations")).unwrap();
    let save = |x: &str| {
        let text = format!(
            "vehicle,point,time_s,x,y,z,sigma_x,sigma_y,sigma_z\na,p,{},{x},{},{},0.02,0.02,0.02\n",
            row[1], row[3], row[4]
        );
        std::fs::write(folders.problem.join("observations/gnss.csv"), text).unwrap();
    };
    save("1234.5");
    folders.command(&[]).assert().code(0);
    save(row[2]);
    let refused = folders.command(&[]).assert().code(4).stdout("");
    refused.stderr(predicate::str::contains("what was adjusted to is no check"));
}

#[test]
fn the_least_and_the_largest_that_can_be_compared() {
    let folders = Folders::new(road);
    // One frame; two samples; no speed anywhere.
    folders.save_track(&format!("{TRACK}a,5,0.5,1,2,3,,0,,,,,,\n"));
    folders.save_reference("vehicle,time_s,x,y,z\na,0,0,2,3\na,1,0,2,3\n");
    let report = folders.json(&[]);
    let track = &report["vehicles"][0]["track"];
    near(&track["x"]["median"], 1.0, 0.0);
    assert_eq!((&track["speed"], &track["along"]), (&Value::Null, &Value::Null));
    folders.command(&[]).assert().success();
    // Numbers out of all proportion.
    folders.save_reference("vehicle,time_s,x,y,z\na,0,1e308,2,3\na,0.4,-1e308,2,3\na,1,1e308,2,1e308\n");
    folders.save_track(&track_with_far_places());
    for arguments in [&[][..], &["--json"], &["--association", "nearest"], &["--clock-shift", "none"]] {
        let output = folders.command(arguments).output().unwrap();
        assert!(!String::from_utf8_lossy(&output.stderr).contains("panicked"));
        assert!(matches!(output.status.code(), Some(0 | 4)));
    }
}

fn track_with_far_places() -> String {
    let mut text = TRACK.to_owned();
    for frame in 0..50 {
        text += &format!(
            "a,{frame},{:.1},-1e308,1e300,0,1e308,0,1e300,1e-300,0,1e300,,\n",
            f64::from(frame) * 0.1
        );
    }
    text
}

#[test]
fn one_vehicle_without_a_track_does_not_stop_the_others() {
    let folders = Folders::new(road);
    let file = folders.problem.join("problem.toml");
    let two = std::fs::read_to_string(&file).unwrap() + "[[vehicle]]\nid = \"b\"\n";
    std::fs::write(&file, two).unwrap();
    let report = folders.json(&[]);
    assert_eq!(report["vehicles"].as_array().unwrap().len(), 1);
    assert_eq!(report["not_compared"][0]["vehicle"], "b");
    let told = folders.command(&[]).assert().success();
    told.stderr(predicate::str::contains("not compared: vehicle b: neither the result nor reference/"));
}

#[test]
fn wrong_usage_is_told_apart() {
    let folders = Folders::new(road);
    for arguments in [
        ["--clock-offset", "soon"],
        ["--clock-offset", "nan"],
        ["--association", "nearly"],
        ["--clock-shift", "some"],
        ["--alignment", "some"],
        ["--max-gap", "-1"],
    ] {
        folders.command(&arguments).assert().code(2).stdout("");
    }
    program().arg("evaluate").arg(&folders.problem).assert().code(2);
    let help = program().args(["evaluate", "--help"]).assert().success();
    help.stdout(predicate::str::contains("Usage: trackbundle evaluate"));
}

#[test]
fn the_clock_of_the_minute_drive_is_found() {
    // The true track instead of a result: what is left are the errors of the receiver alone.
    let problem = in_package("problems/drive-60s");
    let result = tempfile::tempdir().unwrap();
    let mut text = "vehicle,frame,time_s,x,y,z\n".to_owned();
    for row in rows(&problem.join("truth/trajectory_car1.csv")) {
        let cells = ["frame", "time_s", "x", "y", "z"].map(|name| row[name].clone());
        text += &format!("car1,{}\n", cells.join(","));
    }
    std::fs::write(result.path().join("trajectories.csv"), text).unwrap();
    let mut command = program();
    let output = command.arg("evaluate").arg(&problem).arg(result.path()).arg("--json").output().unwrap();
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    let clock = &report["vehicles"][0]["clock"];
    near(&clock["offset_s"], 0.12, 0.003);
    near(&clock["offset_s"], 0.12, 3.0 * clock["sigma_s"].as_f64().unwrap());
    assert!(clock["sigma_s"].as_f64().unwrap() < 0.004, "{clock}");
}

#[test]
fn an_alignment_is_stated_and_a_line_refused() {
    let folders = Folders::new(road);
    let report = folders.json(&["--alignment", "similarity", "--clock-offset", "0.12"]);
    let track = &report["vehicles"][0]["track"];
    assert_eq!(
        (&report["alignment"], &track["chi_square_per_freedom"]),
        (&"similarity".into(), &Value::Null)
    );
    near(&track["aligned"]["scale"], 1.0, 1e-3);
    for (axis, wanted) in [-0.1, 0.2, -0.3].into_iter().enumerate() {
        near(&track["aligned"]["shift_m"][axis], wanted, 2e-3);
    }
    near(&track["distances"]["rmse"], 0.0, 0.01);
    assert_eq!(folders.json(&[])["vehicles"][0]["track"]["aligned"], Value::Null);
    let text = folders.command(&["--alignment", "rigid", "--clock-offset", "0.12"]).assert().success();
    text.stdout(
        predicate::str::contains("alignment rigid\n")
            .and(predicate::str::contains("alignment   rigid: scale 1.000000, rotation by 0.0")),
    );
    let told = folders.command(&["--max-gap", "0.1"]).assert().success();
    told.stderr(predicate::str::contains("--max-gap counts with --association nearest only"));
    let line = Folders::new(straight);
    let refused = line.command(&["--alignment", "rigid"]).assert().code(4).stdout("");
    refused.stderr(predicate::str::contains("vehicle a: an alignment (rigid) is not determined"));
}

fn keys(value: &Value, found: &mut BTreeSet<String>) {
    match value {
        Value::Object(map) => map.iter().for_each(|(key, value)| {
            found.insert(key.clone());
            keys(value, found);
        }),
        Value::Array(values) => values.iter().for_each(|value| keys(value, found)),
        _ => {}
    }
}

#[test]
fn every_key_is_in_the_documents_and_the_other_way_round() {
    let folders = Folders::new(road);
    let file: &Path = &folders.problem.join("problem.toml");
    let two = std::fs::read_to_string(file).unwrap() + "[[vehicle]]\nid = \"b\"\n";
    std::fs::write(file, two).unwrap();
    let mut found = BTreeSet::new();
    keys(&folders.json(&["--alignment", "rigid"]), &mut found);
    let documents = std::fs::read_to_string(in_package("docs/evaluate.md")).unwrap();
    let section = &documents[documents.find("## What `--json` prints").unwrap()..];
    let rows = section.lines().filter(|line| line.starts_with("| `"));
    let first_cells = rows.map(|line| line.split('|').nth(1).unwrap());
    let documented: BTreeSet<String> =
        first_cells.flat_map(|cell| cell.split('`').skip(1).step_by(2)).map(str::to_owned).collect();
    assert_eq!(found, documented);
}
