//! A result against scans, as a page and as numbers; and that no reference reaches an adjustment.

use crate::support;

use nalgebra::Point3;
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;
use support::score::rows;
use support::{copy_folder, in_package, program};
use tempfile::TempDir;

fn refine(problem: &Path) -> (TempDir, PathBuf) {
    let place = tempfile::tempdir().unwrap();
    let result = place.path().join("result");
    program()
        .arg("refine")
        .arg(problem)
        .arg("--out")
        .arg(&result)
        .args(["--no-rrd", "-q"])
        .assert()
        .success();
    (place, result)
}

fn suv() -> PathBuf {
    in_package("problems/suv-exact")
}

static RESULT: LazyLock<(TempDir, PathBuf)> = LazyLock::new(|| refine(&suv()));

fn evaluate(arguments: &[&str]) -> assert_cmd::Command {
    let mut command = program();
    command.arg("evaluate").arg(suv()).arg(&RESULT.1).args(arguments);
    command
}

fn json(arguments: &[&str]) -> Value {
    let output = evaluate(arguments).args(["--json", "-q"]).assert().success().get_output().stdout.clone();
    serde_json::from_slice(&output).unwrap()
}

/// The vertices of an ASCII cloud.
fn scan() -> Vec<Point3<f64>> {
    let text = std::fs::read_to_string(suv().join("reference/car1.ply")).unwrap();
    let body = text.split("end_header\n").nth(1).unwrap();
    // Its properties are floats.
    let number = |cell: Option<&str>| f64::from(cell.unwrap().parse::<f32>().unwrap());
    let point = |line: &str| {
        let mut cells = line.split_whitespace();
        Point3::new(number(cells.next()), number(cells.next()), number(cells.next()))
    };
    body.lines().filter(|line| !line.is_empty()).map(point).collect()
}

#[test]
fn distances_to_the_scan_are_those_of_a_plain_loop() {
    let found = json(&["--registration", "none"]);
    let to_scan = &found["shapes"][0]["to_scan"];
    let scan = scan();
    let cell = |row: &std::collections::BTreeMap<String, String>, name: &str| row[name].parse::<f64>();
    let mut nearest: Vec<f64> = rows(&RESULT.1.join("vehicle_points.csv"))
        .iter()
        .filter_map(|row| Some(Point3::new(cell(row, "x").ok()?, cell(row, "y").ok()?, cell(row, "z").ok()?)))
        .map(|p| scan.iter().map(|q| (p - q).norm()).fold(f64::INFINITY, f64::min))
        .collect();
    nearest.sort_by(f64::total_cmp);
    assert_eq!(to_scan["count"], nearest.len());
    assert!((to_scan["median_m"].as_f64().unwrap() - nearest[nearest.len() / 2]).abs() < 1e-12);
    assert!((to_scan["max_m"].as_f64().unwrap() - nearest[nearest.len() - 1]).abs() < 1e-12);
    let within = nearest.iter().filter(|d| **d <= 0.05).count() as f64 / nearest.len() as f64;
    assert!((to_scan["within"][2].as_f64().unwrap() - within).abs() < 1e-12);
}

#[test]
fn most_of_the_shape_is_within_five_centimetres_of_its_scan_and_nearly_all_of_the_truth() {
    let found = json(&[]);
    let shape = &found["shapes"][0];
    // The scanner saw one side of the car; points of the other are far from anything that it measured.
    let within = |of: &str| shape[of]["within"][2].as_f64().unwrap();
    assert!(within("to_scan") > 0.65 && within("truth_rigid") > 0.93, "{shape:#}");
    // Registration finds that shape and scan stand in the same frame.
    assert!(
        shape["moved_m"].as_f64().unwrap() < 0.02 && shape["turned_deg"].as_f64().unwrap() < 0.5,
        "{shape:#}"
    );
    assert!((shape["truth_scale"].as_f64().unwrap() - 1.0).abs() < 0.02, "{shape:#}");
}

#[test]
fn the_folder_appears_whole_and_alike_and_replaces_its_own_kind_only() {
    let place = tempfile::tempdir().unwrap();
    let target = place.path().join("proof");
    let run = || evaluate(&["-q", "--out"]).arg(&target).assert();
    let read = || {
        let mut files: Vec<(String, Vec<u8>)> = std::fs::read_dir(&target)
            .unwrap()
            .map(|entry| entry.unwrap().path())
            .map(|path| {
                (path.file_name().unwrap().to_str().unwrap().to_owned(), std::fs::read(path).unwrap())
            })
            .collect();
        files.sort();
        files
    };
    run().success();
    let first = read();
    // tests/program/exports.rs has the others.
    let named = |wanted: &str| first.iter().find(|(name, _)| name == wanted).expect(wanted).1.clone();
    for name in ["evaluation.json", "scan_car1.ply", "shape_car1.ply"] {
        assert!(!named(name).is_empty(), "{name}");
    }
    let html = String::from_utf8(named("report.html")).unwrap();
    for part in [
        "Table 1",
        "Figure 3",
        "Figure 4",
        "Figure 5",
        "Figure 6",
        "Figure 7",
        "Figure 8",
        "of its points are within 5 cm",
    ] {
        assert!(html.contains(part), "{part}");
    }
    run().success();
    assert!(read() == first, "the same bytes");
    std::fs::write(target.join("notes.txt"), "mine").unwrap();
    run().code(2);
    assert_eq!(read().len(), first.len() + 1);
}

#[test]
fn a_matrix_is_where_the_scan_stands() {
    let place = tempfile::tempdir().unwrap();
    let problem = place.path().join("problem");
    copy_folder(&suv(), &problem);
    // The scan in map coordinates, turned by a quarter.
    let moved: String = scan()
        .iter()
        .map(|p| format!("{:.6} {:.6} {:.6}\n", 500_000.0 - p.y, 3_900_000.0 + p.x, 50.0 + p.z))
        .collect();
    std::fs::remove_file(problem.join("reference/car1.ply")).unwrap();
    std::fs::write(problem.join("reference/car1.xyz"), moved).unwrap();
    let evaluate = |registration: &str| {
        let mut command = program();
        command.arg("evaluate").arg(&problem).arg(&RESULT.1).args([
            "--registration",
            registration,
            "--json",
            "-q",
        ]);
        let output = command.assert().success().get_output().stdout.clone();
        serde_json::from_slice::<Value>(&output).unwrap()
    };
    for registration in ["given", "icp"] {
        let why = evaluate(registration)["shapes_not_compared"][0]["why"].as_str().unwrap().to_owned();
        assert!(why.contains("car1.matrix.txt"), "{why}");
    }
    let matrix = "0 1 0 -3900000\n-1 0 0 500000\n0 0 1 -50\n0 0 0 1\n";
    std::fs::write(problem.join("reference/car1.matrix.txt"), matrix).unwrap();
    let here = json(&["--registration", "none"]);
    let there = evaluate("given");
    let median = |found: &Value| found["shapes"][0]["to_scan"]["median_m"].as_f64().unwrap();
    assert!((median(&here) - median(&there)).abs() < 1e-6);
    assert!((median(&json(&[])) - median(&evaluate("icp"))).abs() < 1e-5);
}

#[test]
fn no_reference_changes_a_byte_of_an_adjustment() {
    let place = tempfile::tempdir().unwrap();
    let problem = place.path().join("problem");
    copy_folder(&suv(), &problem);
    std::fs::write(problem.join("reference/gnss.csv"), "vehicle,time_s,x,y,z\ncar1,0,9,9,9\ncar1,1,-9,9,9\n")
        .unwrap();
    std::fs::write(
        problem.join("reference/car1.ply"),
        std::fs::read(in_package("problems/drive-60s/reference/car1.ply")).unwrap(),
    )
    .unwrap();
    let other = refine(&problem);
    std::fs::remove_file(problem.join("reference/gnss.csv")).unwrap();
    std::fs::write(problem.join("reference/car1.tum"), "0 9 9 9 0 0 0 1\n1 -9 9 9 0 0 0 1\n").unwrap();
    let of_a_receiver = refine(&problem);
    std::fs::remove_dir_all(problem.join("reference")).unwrap();
    std::fs::remove_dir_all(problem.join("truth")).unwrap();
    let without = refine(&problem);
    for entry in std::fs::read_dir(&RESULT.1).unwrap() {
        let name = entry.unwrap().file_name();
        let read = |folder: &Path| -> Vec<u8> {
            let bytes = std::fs::read(folder.join(&name)).unwrap();
            if name != "report.json" {
                return bytes;
            }
            let mut report: Value = serde_json::from_slice(&bytes).unwrap();
            report["seconds"] = Value::Null;
            report.to_string().into_bytes()
        };
        for folder in [&other.1, &of_a_receiver.1, &without.1] {
            assert!(read(&RESULT.1) == read(folder), "{}", name.display());
        }
    }
}

#[test]
fn a_refinement_ends_with_the_same_comparison_and_leaves_its_result_as_it_is() {
    let place = tempfile::tempdir().unwrap();
    let (result, proof) = (place.path().join("result"), place.path().join("proof"));
    let run = || {
        let mut command = program();
        command.arg("refine").arg(suv()).arg("--no-rrd").arg("--out").arg(&result);
        command
    };
    let assert = run().arg("--evaluation").arg(&proof).assert().success();
    let said = String::from_utf8(assert.get_output().stdout.clone()).unwrap();
    let compared = evaluate(&[]).assert().success();
    let compared = String::from_utf8(compared.get_output().stdout.clone()).unwrap();
    assert!(!compared.is_empty() && said.ends_with(&compared), "{said}");
    let read = |path: PathBuf| -> Value { serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap() };
    let (mut of_refine, mut of_evaluate) = (read(proof.join("evaluation.json")), json(&[]));
    for of in [&mut of_refine, &mut of_evaluate] {
        of["result"] = Value::Null;
        of["files"] = Value::Null;
    }
    assert_eq!(of_refine, of_evaluate);
    assert!(proof.join("report.html").exists());
    for name in ["trajectories.csv", "vehicle_points.csv", "vehicle_poses.csv"] {
        let read = |folder: &Path| std::fs::read(folder.join(name)).unwrap();
        assert!(read(&result) == read(&RESULT.1), "{name}");
    }
    let names = |folder: &Path| std::fs::read_dir(folder).unwrap().count();
    assert_eq!(names(&result), names(&RESULT.1));

    run().arg("--evaluation").arg(&result).assert().code(2);
    std::fs::write(proof.join("notes.txt"), "mine").unwrap();
    run().arg("--evaluation").arg(&proof).assert().code(2);
}

#[test]
fn a_shape_that_cannot_be_registered_and_a_changed_input_are_told() {
    let place = tempfile::tempdir().unwrap();
    let problem = place.path().join("problem");
    copy_folder(&suv(), &problem);
    let far = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
               end_header\n0 0 0\n1 0 0\n2 0 0\n";
    std::fs::write(problem.join("reference/car1.ply"), far).unwrap();
    let poses = std::fs::read_to_string(suv().join("vehicle_poses.csv")).unwrap() + "\n";
    std::fs::write(problem.join("vehicle_poses.csv"), poses).unwrap();
    let mut command = program();
    let output = command.arg("evaluate").arg(&problem).arg(&RESULT.1).arg("--json").assert().success();
    let output = output.get_output();
    let errors = String::from_utf8(output.stderr.clone()).unwrap();
    assert!(errors.contains("warning: not compared: shape of car1: "), "{errors}");
    assert!(
        errors.contains("warning: files of the problem are not those that were adjusted: vehicle_poses.csv"),
        "{errors}"
    );
    let json: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(json["warnings"].as_array().unwrap().len(), 2, "{errors}");
}

#[test]
fn a_track_in_the_file_of_a_receiver_is_compared_like_the_table() {
    let place = tempfile::tempdir().unwrap();
    let of = |name: &str, file: &str, text: String| -> Value {
        let problem = place.path().join(name);
        copy_folder(&suv(), &problem);
        std::fs::remove_file(problem.join("reference/gnss.csv")).unwrap();
        std::fs::write(problem.join("reference").join(file), text).unwrap();
        let mut command = program();
        let output =
            command.arg("evaluate").arg(&problem).arg(&RESULT.1).args(["--json", "-q"]).assert().success();
        let mut found: Value = serde_json::from_slice(&output.get_output().stdout).unwrap();
        found["vehicles"][0].take()
    };
    let samples = rows(&suv().join("reference/gnss.csv"));
    let cells = |row: &BTreeMap<String, String>| ["time_s", "x", "y", "z"].map(|name| row[name].clone());
    let table: String = samples.iter().map(|row| format!("car1,{}\n", cells(row).join(","))).collect();
    let tum: String = samples.iter().map(|row| format!("{} 0 0 0 1\n", cells(row).join(" "))).collect();
    let of_table = of("table", "gnss.csv", format!("vehicle,time_s,x,y,z\n{table}"));
    assert!(of_table["track"]["compared"].as_u64().unwrap() > 100);
    assert_eq!(of_table, of("tum", "car1.tum", tum));
}
