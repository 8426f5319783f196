//! `trackbundle view`, and sessions of `refine`: what cannot be shown costs no result.
#![cfg(feature = "viewer")]

use crate::support;

use assert_cmd::Command;
use std::collections::BTreeSet;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use support::in_package;

fn program() -> Command {
    let mut program = support::program();
    // No viewer of this machine is started by chance.
    program.env("PATH", "/nowhere");
    program
}

fn tiny() -> PathBuf {
    in_package("problems/tiny")
}

fn names(folder: &Path) -> BTreeSet<String> {
    let entries = std::fs::read_dir(folder).unwrap();
    entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect()
}

/// A result of the tiny problem, and what is in it.
fn refined(place: &Path, name: &str) -> PathBuf {
    let result = place.join(name);
    program().arg("refine").arg(tiny()).arg("--out").arg(&result).arg("--quiet").assert().success();
    result
}

fn is_recording(file: &Path) -> bool {
    std::fs::read(file).is_ok_and(|bytes| bytes.starts_with(b"RRF"))
}

fn stderr(output: &std::process::Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn a_problem_and_its_results_are_recorded() {
    let place = tempfile::tempdir().unwrap();
    let (one, two) = (refined(place.path(), "one"), refined(place.path(), "two"));
    let file = place.path().join("seen.rrd");
    let mut lengths = Vec::new();
    for results in [&[][..], std::slice::from_ref(&one), &[one.clone(), two.clone()]] {
        program().arg("view").arg(tiny()).args(results).arg("--rrd").arg(&file).assert().success();
        assert!(is_recording(&file));
        lengths.push(std::fs::metadata(&file).unwrap().len());
    }
    assert!(lengths[0] < lengths[1] && lengths[1] < lengths[2], "{lengths:?}");
    let other = place.path().join("notes.txt");
    std::fs::write(&other, "mine").unwrap();
    program().arg("view").arg(tiny()).arg("--rrd").arg(&other).assert().code(2);
    assert_eq!(std::fs::read_to_string(&other).unwrap(), "mine");
    for layout in ["overview", "shape", "map"] {
        let mut view = program();
        view.arg("view").arg(tiny()).arg(&one).args(["--layout", layout, "--rrd"]).arg(&file);
        view.assert().success();
    }
    let left = names(place.path());
    assert_eq!(left.into_iter().collect::<Vec<_>>(), ["notes.txt", "one", "seen.rrd", "two"]);
}

#[test]
fn what_is_no_result_is_named_and_nothing_is_written() {
    let place = tempfile::tempdir().unwrap();
    let result = refined(place.path(), "result");
    std::fs::remove_file(result.join("camera_poses.csv")).unwrap();
    let residuals = std::fs::read_to_string(result.join("residuals.csv")).unwrap();
    std::fs::write(result.join("residuals.csv"), residuals.replacen("vehicle,cart", "body,cart", 1)).unwrap();
    let file = place.path().join("seen.rrd");
    let output = program().arg("view").arg(tiny()).arg(&result).arg("--rrd").arg(&file).output().unwrap();
    assert_eq!(output.status.code(), Some(3));
    for wanted in
        ["camera_poses.csv: expected a table", "residuals.csv:2: column kind: expected vehicle or target"]
    {
        assert!(stderr(&output).contains(wanted), "{}", stderr(&output));
    }
    assert!(!file.exists());
}

#[test]
fn without_a_viewer_it_is_said_what_to_install() {
    // On a machine where something listens where viewers do, that is taken for one.
    if std::net::TcpStream::connect("127.0.0.1:9876").is_ok() {
        return;
    }
    let place = tempfile::tempdir().unwrap();
    let output = program().arg("view").arg(tiny()).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert!(
        stderr(&output).contains("not on the PATH: install it with `pip install rerun-sdk=="),
        "{}",
        stderr(&output)
    );

    let whole = names(&refined(place.path(), "whole"));
    let result = place.path().join("result");
    let output =
        program().arg("refine").arg(tiny()).arg("--spawn").arg("--out").arg(&result).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert_eq!(names(&result), whole);
    assert!(is_recording(&result.join("session.rrd")));
    let told = stderr(&output);
    assert!(told.contains("warning: nothing is shown: the viewer `rerun` is not on the PATH"), "{told}");
    assert!(told.contains("result is complete, but: the viewer"), "{told}");
}

#[test]
fn a_session_that_breaks_costs_no_result() {
    let place = tempfile::tempdir().unwrap();
    let whole = names(&refined(place.path(), "whole"));
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("rerun+http://{}/proxy", listener.local_addr().unwrap());
    let viewer = std::thread::spawn(move || {
        // It answers twice, as it is asked, and is gone.
        let taken: Vec<_> = (0..2).map(|_| listener.accept().unwrap()).collect();
        drop((taken, listener));
    });
    let result = place.path().join("result");
    let mut refine = program();
    refine.arg("refine").arg(tiny()).args(["--connect", &url]).arg("--out").arg(&result);
    let output = refine.output().unwrap();
    viewer.join().unwrap();
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    assert_eq!(names(&result), whole);
    assert!(
        stderr(&output).contains("is complete, but: the connection to the viewer was lost"),
        "{}",
        stderr(&output)
    );
    // Now nobody is there from the start.
    std::fs::remove_dir_all(&result).unwrap();
    let mut refine = program();
    refine.arg("refine").arg(tiny()).args(["--connect", &url]).arg("--out").arg(&result).assert().code(1);
    assert_eq!(names(&result), whole);
}

#[test]
fn a_place_that_cannot_take_a_recording_is_told_before_anything_is_computed() {
    let place = tempfile::tempdir().unwrap();
    let result = place.path().join("result");
    let refine = |recording: &Path| {
        let mut refine = program();
        refine.arg("refine").arg(tiny()).arg("--rrd").arg(recording).arg("--out").arg(&result);
        refine.output().unwrap()
    };
    std::fs::write(place.path().join("file"), "mine").unwrap();
    let output = refine(&place.path().join("file/x.rrd"));
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    assert!(!result.exists(), "{}", stderr(&output));
    // Folders that are missing are made.
    let deep = place.path().join("not/there/x.rrd");
    let output = refine(&deep);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert!(result.join("report.json").exists() && !result.join("session.rrd").exists());
    assert!(is_recording(&deep));
}

/// A disk on which the recording does not fit, but everything else does.
#[cfg(unix)]
#[test]
fn a_disk_too_small_for_the_recording_costs_no_result() {
    let place = tempfile::tempdir().unwrap();
    let mut whole = names(&refined(place.path(), "whole"));
    let result = place.path().join("result");
    let mut shell = std::process::Command::new("/bin/sh");
    // No file gets longer than 100 blocks of 512 bytes.
    shell.args(["-c", "trap '' XFSZ; ulimit -f 100; exec \"$0\" \"$@\""]);
    shell.arg(assert_cmd::cargo::cargo_bin("trackbundle"));
    let output = shell.arg("refine").arg(tiny()).arg("--out").arg(&result).output().unwrap();
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    assert!(stderr(&output).contains("is complete, but: session.rrd: the recording could not be written"));
    assert!(whole.remove("session.rrd"));
    assert_eq!(names(&result), whole);
    let report = std::fs::read_to_string(result.join("report.json")).unwrap();
    assert!(report.contains("session.rrd is missing: the recording could not be written"), "{report}");
}

#[test]
fn an_address_is_not_taken_for_a_problem() {
    let output = program().args(["view", "--connect"]).arg(tiny()).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("without one, --connect comes last"), "{}", stderr(&output));
    program().arg("view").arg(tiny()).args(["--spawn", "--connect"]).assert().code(2);
}
