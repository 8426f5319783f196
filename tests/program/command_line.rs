//! The program as a user meets it: commands, streams, exit codes, the result folder.

use crate::support;

use predicates::prelude::*;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use support::score::rows;
use support::{copy_folder, in_package, program};
use tempfile::TempDir;

/// A copy of the smallest problem in a place of its own.
fn tiny() -> (TempDir, PathBuf) {
    let place = tempfile::tempdir().unwrap();
    let problem = place.path().join("tiny");
    copy_folder(&in_package("problems/tiny"), &problem);
    (place, problem)
}

fn names(folder: &Path) -> BTreeSet<String> {
    std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect()
}

fn header(file: &Path) -> String {
    std::fs::read_to_string(file).unwrap().lines().next().unwrap().to_owned()
}

#[test]
fn the_result_stands_beside_the_problem_and_is_whole() {
    let (place, problem) = tiny();
    program().arg("refine").arg(&problem).assert().success();
    assert_eq!(names(place.path()), ["tiny", "tiny-result"].map(String::from).into());
    let mut wanted: BTreeSet<String> = [
        "camera_poses.csv",
        "report.json",
        "residuals.csv",
        "residuals_start.csv",
        "shape_cart.ply",
        "targets.csv",
        "trajectories.csv",
        "vehicle_points.csv",
        "vehicle_poses.csv",
    ]
    .map(String::from)
    .into();
    if cfg!(feature = "viewer") {
        wanted.insert("session.rrd".to_owned());
    }
    assert_eq!(names(&place.path().join("tiny-result")), wanted);
}

#[test]
fn the_tables_have_the_columns_of_the_format() {
    let (place, problem) = tiny();
    program().arg("refine").arg(&problem).assert().success();
    let pose = "x,y,z,qw,qx,qy,qz,sigma_x,sigma_y,sigma_z,sigma_roll_deg,sigma_pitch_deg,sigma_yaw_deg";
    for (table, wanted) in [
        ("camera_poses.csv", format!("frame,{pose}")),
        ("vehicle_poses.csv", format!("frame,vehicle,{pose}")),
        (
            "vehicle_points.csv",
            "vehicle,point,x,y,z,sigma_x,sigma_y,sigma_z,observations,inliers,rms_px".to_owned(),
        ),
        (
            "trajectories.csv",
            "vehicle,frame,time_s,x,y,z,speed_mps,heading_deg,sigma_x,sigma_y,sigma_z,cov_xy,\
             sigma_speed_mps,sigma_heading_deg"
                .to_owned(),
        ),
        (
            "targets.csv",
            "target,role,x,y,z,sigma_x,sigma_y,sigma_z,dx,dy,dz,w_x,w_y,w_z,used,rejected".to_owned(),
        ),
        ("residuals.csv", "frame,kind,vehicle,point,du,dv,weight,reason,u_computed,v_computed".to_owned()),
    ] {
        assert_eq!(header(&place.path().join("tiny-result").join(table)), wanted, "{table}");
    }
    let cloud = std::fs::read_to_string(place.path().join("tiny-result/shape_cart.ply")).unwrap();
    for line in ["ply", "format ascii 1.0", "element vertex 4", "property double sigma_z", "end_header"] {
        assert!(cloud.lines().any(|l| l.trim_end() == line), "{line} is not in\n{cloud}");
    }
}

#[test]
fn the_first_estimate_has_the_same_tables_without_standard_deviations() {
    let (place, problem) = tiny();
    let out = place.path().join("first");
    program().arg("initialise").arg(&problem).arg("--out").arg(&out).assert().success();
    program().arg("refine").arg(&problem).assert().success();
    assert_eq!(names(&out), names(&place.path().join("tiny-result")));
    for table in ["camera_poses.csv", "vehicle_poses.csv", "vehicle_points.csv", "trajectories.csv"] {
        let found = rows(&out.join(table));
        assert!(!found.is_empty(), "{table}");
        let sigmas = found.iter().flatten().filter(|(column, _)| column.starts_with("sigma_"));
        assert!(sigmas.map(|(_, value)| value).all(String::is_empty), "{table}");
        assert_eq!(header(&out.join(table)), header(&place.path().join("tiny-result").join(table)));
    }
}

#[test]
fn the_report_goes_to_standard_output_when_asked_for() {
    let (place, problem) = tiny();
    let output = program().arg("refine").arg(&problem).args(["--json", "--no-rrd"]).output().unwrap();
    let printed: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let written = std::fs::read(place.path().join("tiny-result/report.json")).unwrap();
    assert_eq!(printed, serde_json::from_slice::<serde_json::Value>(&written).unwrap());
    for key in [
        "status",
        "iterations",
        "initial_cost",
        "final_cost",
        "observations",
        "parameters",
        "redundancy",
        "sigma0",
        "rms_px",
        "outliers",
        "seconds",
        "warnings",
    ] {
        assert!(!printed[key].is_null(), "{key} is not in the report");
    }
    assert!(printed["seconds"].as_object().unwrap().values().all(|v| v.as_f64().unwrap() >= 0.0));
    assert_eq!(printed["warnings"].as_array().unwrap().len(), 1);
    assert!(String::from_utf8_lossy(&output.stderr).contains("warning: vehicle cart"));
}

#[test]
fn quiet_silences_all_but_errors() {
    let (_place, problem) = tiny();
    program().arg("refine").arg(&problem).arg("--quiet").assert().success().stdout("").stderr("");
    std::fs::remove_file(problem.join("frames.csv")).unwrap();
    let refused = program().arg("refine").arg(&problem).arg("--quiet").assert().code(3).stdout("");
    refused.stderr(predicate::str::contains("frames.csv"));
}

#[test]
fn progress_is_no_bar_where_there_is_no_terminal() {
    let (_place, problem) = tiny();
    let assert = program().arg("refine").arg(&problem).assert().success();
    let progress = String::from_utf8_lossy(&assert.get_output().stderr).into_owned();
    assert!(progress.contains("round 1: approach\nround 2: final\n"), "{progress}");
    assert!(!progress.contains(['\r', '\u{1b}']), "{progress:?}");
}

#[test]
fn every_iteration_has_a_line_when_asked_for() {
    let (_place, problem) = tiny();
    let assert = program().arg("refine").arg(&problem).arg("-v").assert().success();
    let table = String::from_utf8_lossy(&assert.get_output().stderr).into_owned();
    let columns =
        ["iter", "cost", "change", "|gradient|", "|step|", "gain", "damping", "iter time", "total time"];
    assert!(columns.iter().all(|column| table.contains(column)), "{table}");
    let lines = table.lines().filter(|line| line.trim_start().starts_with(|c: char| c.is_ascii_digit()));
    assert!(lines.count() >= 4, "{table}");
}

#[test]
fn the_recording_goes_where_it_is_told() {
    let (place, problem) = tiny();
    let file = place.path().join("here.rrd");
    let mut command = program();
    command.arg("refine").arg(&problem).arg("--rrd").arg(&file);
    if cfg!(feature = "viewer") {
        command.assert().success();
        assert!(std::fs::read(&file).unwrap().starts_with(b"RRF"));
        assert!(!place.path().join("tiny-result/session.rrd").exists());
    } else {
        command.assert().code(2);
        assert_eq!(names(place.path()), ["tiny"].map(String::from).into());
    }
    program().arg("refine").arg(&problem).arg("--no-rrd").assert().success();
    assert!(!names(&place.path().join("tiny-result")).contains("session.rrd"));
}

#[test]
fn what_is_no_result_is_never_touched() {
    let (place, problem) = tiny();
    let out = place.path().join("thesis");
    std::fs::create_dir(&out).unwrap();
    std::fs::write(out.join("report.json"), "{\"program\": \"another\"}").unwrap();
    let refused = program().arg("refine").arg(&problem).arg("--out").arg(&out).assert().code(2);
    refused.stderr(predicate::str::contains("thesis"));
    assert_eq!(names(&out), ["report.json"].map(String::from).into());
    assert_eq!(names(place.path()), ["thesis", "tiny"].map(String::from).into());
    // A result makes way for the next one.
    program().arg("refine").arg(&problem).assert().success();
    std::fs::write(place.path().join("tiny-result/shape_old.ply"), "").unwrap();
    // But not with what a user put there, whatever its name looks like.
    program().arg("refine").arg(&problem).assert().code(2);
    std::fs::remove_file(place.path().join("tiny-result/shape_old.ply")).unwrap();
    program().arg("refine").arg(&problem).assert().success();
    std::fs::write(place.path().join("tiny-result/notes.txt"), "mine").unwrap();
    program().arg("refine").arg(&problem).assert().code(2);
    assert!(names(&place.path().join("tiny-result")).contains("notes.txt"));
}

#[test]
fn wrong_usage_is_told_apart() {
    let (place, problem) = tiny();
    for arguments in [
        vec!["refine"],
        vec!["polish"],
        vec!["refine", "x", "--loss", "l1"],
        vec!["refine", "x", "--loss-scale", "0"],
        vec!["refine", "x", "--threads", "0"],
        vec!["refine", "x", "--max-iterations", "-1"],
        vec!["initialise", "x"],
    ] {
        program().args(&arguments).assert().code(2).stdout("");
    }
    program().arg("refine").arg(place.path().join("nowhere")).assert().code(3);
    program().arg("check").arg(&problem).assert().success();
    assert_eq!(names(place.path()), ["tiny"].map(String::from).into());
}

#[test]
fn a_check_says_what_is_there() {
    let output = program().arg("check").arg(in_package("problems/suv-noisy")).output().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    for wanted in [
        "problem     suv-noisy\n",
        "frames      150, 0.000 s to 4.967 s\n",
        "car1: 401 points, 60,150 image points, seen in 150 frames (0 to 149)",
        "a point is seen in 150 to 150 frames, median 150",
        "24 control, 0 check, 0 tie; 2,571 image points",
        "GNSS track of car1 (24 positions), scan of car1 (5,518 points)",
        "ready for   initialise, refine\n",
        "scale       of car1 is fixed",
    ] {
        assert!(text.contains(wanted), "{wanted:?} is not in\n{text}");
    }
}

#[test]
fn every_loss_can_be_named() {
    let (_place, problem) = tiny();
    for loss in ["none", "huber", "cauchy", "tukey", "geman-mcclure", "barron"] {
        let output = program().arg("refine").arg(&problem).args(["--json", "--loss", loss]).output().unwrap();
        let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(report["loss"]["name"], loss);
    }
}

#[test]
fn the_limit_of_iterations_is_said_to_have_been_reached() {
    let place = tempfile::tempdir().unwrap();
    let output = program()
        .arg("refine")
        .arg(in_package("problems/suv-noisy"))
        .arg("--out")
        .arg(place.path().join("out"))
        .args(["--max-iterations", "2", "--json", "--no-rrd"])
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(0));
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((&report["status"], &report["iterations"]), (&"iteration_limit".into(), &2.into()));
}

#[test]
fn versions_helps_and_completions_are_printed() {
    let version = format!("trackbundle {}\n", env!("CARGO_PKG_VERSION"));
    program().arg("--version").assert().success().stdout(version);
    for command in ["check", "initialise", "refine", "completions"] {
        let help = program().args([command, "--help"]).assert().success();
        help.stdout(predicate::str::contains("Usage: trackbundle"));
    }
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let script = program().args(["completions", shell]).assert().success();
        script.stdout(predicate::str::contains("refine"));
    }
}

#[test]
#[cfg(feature = "viewer")]
fn a_recording_replaces_nothing_but_a_recording() {
    let (place, problem) = tiny();
    let table = problem.join("frames.csv");
    let before = std::fs::read(&table).unwrap();
    for occupied in [&table, &problem] {
        program().arg("refine").arg(&problem).arg("--rrd").arg(occupied).assert().code(2);
    }
    assert_eq!(std::fs::read(&table).unwrap(), before);
    assert_eq!(names(place.path()), ["tiny"].map(String::from).into());
    let file = place.path().join("a.rrd");
    for _ in 0..2 {
        program().arg("refine").arg(&problem).arg("--rrd").arg(&file).assert().success();
    }
}

#[test]
#[cfg(target_os = "linux")]
fn output_that_cannot_be_written_is_an_error() {
    let full = std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
    let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_trackbundle"));
    command.arg("check").arg(in_package("problems/tiny")).stdout(full);
    let output = command.output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stderr).contains("standard output"));
}

/// Keys of all objects, but of those whose keys are names of things.
fn keys(value: &serde_json::Value, found: &mut std::collections::BTreeSet<String>) {
    const BY_NAME: [&str; 6] = ["shares", "sigma_without", "common_error", "vehicles", "seconds", "rejected"];
    match value {
        serde_json::Value::Object(map) => {
            for (key, value) in map {
                found.insert(key.clone());
                match value {
                    serde_json::Value::Object(inner) if BY_NAME.contains(&key.as_str()) => {
                        inner.values().for_each(|value| keys(value, found));
                    }
                    value => keys(value, found),
                }
            }
        }
        serde_json::Value::Array(values) => values.iter().for_each(|value| keys(value, found)),
        _ => {}
    }
}

#[test]
fn every_key_of_the_report_is_in_the_schema_and_every_word_of_the_documents_is_a_key() {
    let folder = tempfile::tempdir().unwrap();
    let (problem, out) = (folder.path().join("problem"), folder.path().join("out"));
    // With targets of all roles, and without camera poses.
    let drive = support::drive::Drive { frames: 40, targets: 14, check: 3, ..Default::default() };
    drive.write(&problem);
    std::fs::remove_file(problem.join("camera_poses.csv")).unwrap();
    // One that stands, and one with a rolling shutter and a receiver whose clock is held.
    let (standing, moving) = (folder.path().join("standing"), folder.path().join("moving"));
    support::drive::Drive { frames: 45, motion: [0.0, 0.0], ..Default::default() }.write(&standing);
    let flight = support::moving::Flight { frames: 45, points: 40, targets: 20, ..support::moving::FULL };
    support::moving::write(&flight.draw(1).0, &moving, "[gnss]\nclock_offset_s = 0.0\n");
    let (mut found, mut first) = (std::collections::BTreeSet::new(), std::collections::BTreeSet::new());
    for problem in [&problem, &standing, &moving] {
        program().arg("refine").arg(problem).arg("--no-rrd").arg("--out").arg(&out).assert().success();
        let text = std::fs::read_to_string(out.join("report.json")).unwrap();
        let report: serde_json::Value = serde_json::from_str(&text).unwrap();
        assert_eq!(report["schema"], 1);
        keys(&report, &mut found);
        first.extend(report.as_object().unwrap().keys().cloned());
    }
    let documents = std::fs::read_to_string(support::in_package("docs/formats.md")).unwrap();
    let start = documents.find("### `report.json`").unwrap();
    let section = &documents[start..start + documents[start..].find("## Exit codes").unwrap()];
    let documented: std::collections::BTreeSet<&str> =
        section.split('`').skip(1).step_by(2).filter(|word| !word.contains('"')).collect();
    let schema = std::fs::read_to_string(support::in_package("docs/report.schema.json")).unwrap();
    for key in &found {
        assert!(schema.contains(&format!("\"{key}\": {{")), "{key} is not in docs/report.schema.json");
    }
    for key in &first {
        assert!(documented.contains(key.as_str()), "{key} is not in docs/formats.md");
    }
    // Values, reasons and words of which there may be none.
    let values =
        ["report.json", "converged", "iteration_limit", "stalled", "initialised", "yes", "with care", "no"];
    let values = [
        values.as_slice(),
        &[
            "null",
            "acceleration",
            "jerk",
            "weak",
            "image_point",
            "track",
            "static",
            "sliding",
            "swapped",
            "foreign",
            "frame",
            "no_coordinates",
            "check_point",
            "step",
            "why",
            "diagnosis",
            "recording",
            "viewer",
            "comparison",
        ],
    ]
    .concat();
    let of_directions = ["class", "singular_ratio", "held_by"];
    for word in documented.iter().filter(|word| !values.contains(word) && !of_directions.contains(word)) {
        assert!(found.contains(*word), "{word} is in docs/formats.md and not in the report");
    }
}
