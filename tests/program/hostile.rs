//! What goes wrong around a computation: files that are no files, places that cannot be written, readers that go away,
//! processes that die. A result is whole or not there, what is not ours is left alone, and an adjustment that is done is
//! not lost.

use crate::support;

use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::Duration;
use support::{copy_folder, in_package, program};
use tempfile::TempDir;

/// A place with a copy of the smallest problem in it, its truth left out.
fn tiny() -> (TempDir, PathBuf) {
    let place = tempfile::tempdir().unwrap();
    let problem = place.path().join("problem");
    copy_folder(&in_package("problems/tiny"), &problem);
    std::fs::remove_dir_all(problem.join("truth")).unwrap();
    (place, problem)
}

/// Replaces texts in a file.
fn change(file: &Path, changes: &[(&str, &str)]) {
    let mut text = std::fs::read_to_string(file).unwrap();
    for (from, to) in changes {
        assert!(text.contains(from), "{from} is not in {}", file.display());
        text = text.replacen(from, to, 1);
    }
    std::fs::write(file, text).unwrap();
}

fn run(place: &Path, arguments: &[&str]) -> Output {
    program().current_dir(place).args(arguments).output().unwrap()
}

fn refine(place: &Path, more: &[&str]) -> Output {
    run(place, &[&["refine", "problem", "--no-rrd", "--out", "o"], more].concat())
}

fn told(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn code(output: &Output) -> i32 {
    output.status.code().unwrap_or_else(|| panic!("killed: {}", told(output)))
}

fn report(folder: &Path) -> serde_json::Value {
    serde_json::from_slice(&std::fs::read(folder.join("report.json")).unwrap()).unwrap()
}

fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).unwrap();
    let mut names: Vec<String> =
        entries.map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

#[test]
fn a_pose_that_is_missing_beside_exact_ones_is_found() {
    let (place, problem) = tiny();
    change(&problem.join("vehicle_poses.csv"), &[("20,cart,0,0,0,1,0,0,0\n", "")]);
    let output = refine(place.path(), &[]);
    assert_eq!(code(&output), 0, "{}", told(&output));
    let report = report(&place.path().join("o"));
    assert_eq!(report["failed_steps"], serde_json::json!([]));
    assert!(report["statistics"].is_object(), "it was not diagnosed");
}

#[test]
fn a_problem_in_which_nothing_is_free_has_no_solution() {
    let (place, problem) = tiny();
    change(
        &problem.join("vehicle_poses.csv"),
        &[("10,cart,-1,", "10,cart,-1000,"), ("30,cart,1,", "30,cart,1000,")],
    );
    let output = refine(place.path(), &[]);
    assert_eq!(code(&output), 4, "{}", told(&output));
    assert!(told(&output).contains("nothing is left to adjust"), "{}", told(&output));
    assert_eq!(names(place.path()), ["problem"]);
}

#[test]
fn numbers_that_cannot_be_computed_are_left_empty_and_named() {
    let (place, problem) = tiny();
    change(&problem.join("frames.csv"), &[("20,1\n", "20,5e-324\n")]);
    let output = refine(place.path(), &[]);
    assert_eq!(code(&output), 0, "{}", told(&output));
    let folder = place.path().join("o");
    let wanted = "trajectories.csv: speed_mps is not a finite number in 1 row, left empty";
    assert!(told(&output).contains(wanted), "{}", told(&output));
    let report = report(&folder);
    let finding = report["findings"].as_array().unwrap().iter().find(|f| f["code"] == "not_finite").unwrap();
    assert_eq!((&finding["text"], &finding["value"]), (&wanted.into(), &1.0.into()));
    for table in ["trajectories.csv", "camera_poses.csv", "vehicle_poses.csv", "vehicle_points.csv"] {
        let text = std::fs::read_to_string(folder.join(table)).unwrap();
        assert!(
            !text.contains("NaN") && !text.contains(",inf,,") && !text.contains("-inf"),
            "{table}: {text}"
        );
    }
}

#[test]
fn a_scale_that_cannot_be_computed_is_not_determined() {
    let (place, problem) = tiny();
    let text = "frame,vehicle,point,u,v\n10,cart,front,500,487\n20,cart,front,600,460\n30,cart,front,700,550\n\
        10,cart,rear,300,540\n20,cart,rear,400,550\n30,cart,rear,500,460\n10,cart,roof,375,460\n20,cart,roof,500,500\n\
        30,cart,roof,625,500\n10,cart,side,475,-1e300\n20,cart,side,600,540\n30,cart,side,725,550\n\
        20,cart,glint,512,500\n";
    std::fs::write(problem.join("vehicle_observations.csv"), text).unwrap();
    let output = refine(place.path(), &[]);
    assert_eq!(code(&output), 0, "{}", told(&output));
    let shown = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(!shown.contains("NaN"), "{shown}");
    assert_eq!(report(&place.path().join("o"))["verdict"]["trust"], "no");
}

#[test]
fn files_of_users_in_a_result_are_left_alone() {
    let (place, _) = tiny();
    assert_eq!(code(&refine(place.path(), &[])), 0);
    let folder = place.path().join("o");
    let listed: Vec<String> = serde_json::from_value(report(&folder)["files"].clone()).unwrap();
    assert_eq!(listed, names(&folder));
    std::fs::copy(folder.join("shape_cart.ply"), folder.join("shape_cart_cleaned.ply")).unwrap();
    std::fs::create_dir(folder.join("shape_mine.ply")).unwrap();
    std::fs::write(folder.join("shape_mine.ply/notes.txt"), "precious").unwrap();
    let before = names(&folder);
    let output = refine(place.path(), &[]);
    assert_eq!(code(&output), 2);
    assert!(
        told(&output).contains("does not list shape_cart_cleaned.ply, shape_mine.ply"),
        "{}",
        told(&output)
    );
    assert_eq!(names(&folder), before);
    std::fs::remove_dir_all(folder.join("shape_mine.ply")).unwrap();
    std::fs::remove_file(folder.join("shape_cart_cleaned.ply")).unwrap();
    assert_eq!(code(&refine(place.path(), &[])), 0);

    let evaluate = |place: &Path| run(place, &["evaluate", "problem", "o", "--out", "e"]);
    assert_eq!(code(&evaluate(place.path())), 0);
    assert_eq!(code(&evaluate(place.path())), 0);
    for name in ["evo_mine.zip", "scan_mine.ply", "track_mine.tum"] {
        let file = place.path().join("e").join(name);
        std::fs::write(&file, "precious").unwrap();
        let output = evaluate(place.path());
        assert_eq!(code(&output), 2, "{name}");
        std::fs::remove_file(&file).unwrap();
    }
}

#[test]
fn what_is_no_place_is_told_before_anything_is_computed() {
    let (place, problem) = tiny();
    let long = "o".repeat(256);
    let output = run(place.path(), &["refine", "problem", "--no-rrd", "--out", &long]);
    assert_eq!(code(&output), 1);
    assert!(!told(&output).contains("round 1"), "{}", told(&output));
    // Folders that would be made for it go again.
    let deep = run(place.path(), &["refine", "no-problem", "--no-rrd", "--out", "a/b/o"]);
    assert_eq!(code(&deep), 3);
    assert_eq!(names(place.path()), ["problem"]);
    change(&problem.join("problem.toml"), &[("id = \"cart\"", &format!("id = \"{}\"", "c".repeat(201)))]);
    let output = run(place.path(), &["check", "problem"]);
    assert_eq!(code(&output), 3);
    assert!(told(&output).contains("of at most 200 bytes"), "{}", told(&output));
}

#[test]
fn a_path_between_frames_has_a_bound() {
    let (place, _) = tiny();
    for rate in ["1e300", "1e9"] {
        let output = refine(place.path(), &["--states", rate]);
        assert_eq!(code(&output), 2, "{rate}");
        assert!(told(&output).contains("at most 1e7 are written"), "{}", told(&output));
    }
    assert_eq!(names(place.path()), ["problem"]);
}

#[test]
fn a_page_is_drawn_of_whatever_residuals() {
    let (place, _) = tiny();
    assert_eq!(code(&refine(place.path(), &[])), 0);
    let file = place.path().join("o/residuals.csv");
    let text = std::fs::read_to_string(&file).unwrap();
    for largest in ["1e70", "1e155", "1e300"] {
        let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
        for line in &mut lines[1..3] {
            let mut cells: Vec<&str> = line.split(',').collect();
            cells[4] = largest;
            *line = cells.join(",");
        }
        std::fs::write(&file, lines.join("\n")).unwrap();
        let output = run(place.path(), &["evaluate", "problem", "o", "--out", "e"]);
        assert_eq!(code(&output), 0, "{largest}: {}", told(&output));
        let page = std::fs::read_to_string(place.path().join("e/report.html")).unwrap();
        assert!(page.contains("<svg") && page.len() < 2_000_000, "{largest}: {}", page.len());
    }
}

#[test]
fn an_image_has_a_bound_and_any_shape() {
    let (place, problem) = tiny();
    let toml = problem.join("problem.toml");
    let text = std::fs::read_to_string(&toml).unwrap();
    let with_height = |height: &str| {
        let line = |line: &str| {
            if line.starts_with("height =") { format!("height = {height}") } else { line.to_owned() }
        };
        std::fs::write(&toml, text.lines().map(line).collect::<Vec<_>>().join("\n")).unwrap();
    };
    with_height("4294967295");
    assert!(told(&run(place.path(), &["check", "problem"])).contains("a whole number from 1 to 1000000"));
    with_height("1000000");
    let output = refine(place.path(), &["--evaluation", "e"]);
    assert_eq!(code(&output), 0, "{}", told(&output));
    assert!(place.path().join("e/report.html").exists());
}

#[test]
fn many_tables_keys_and_findings_are_counted() {
    let (place, problem) = tiny();
    let toml = std::fs::read_to_string(problem.join("problem.toml")).unwrap();
    let mut many = toml.clone();
    (0..30_000).for_each(|at| many += &format!("\n[[vehicle]]\nid = \"v{at}\"\n"));
    std::fs::write(problem.join("problem.toml"), many).unwrap();
    assert_eq!(code(&run(place.path(), &["check", "problem"])), 0);
    let mut many = toml.clone();
    (0..100_000).for_each(|at| many += &format!("key{at} = 1\n"));
    std::fs::write(problem.join("problem.toml"), many).unwrap();
    let output = run(place.path(), &["check", "problem"]);
    assert!(told(&output).lines().count() < 1100 && told(&output).contains("99000 more warnings"));

    std::fs::write(problem.join("problem.toml"), &toml).unwrap();
    let observations = problem.join("vehicle_observations.csv");
    let mut bad = std::fs::read_to_string(&observations).unwrap();
    (0..100_000).for_each(|_| bad += "10,cart,front,left,right\n");
    std::fs::write(&observations, bad).unwrap();
    let output = run(place.path(), &["check", "problem"]);
    assert_eq!(code(&output), 3);
    let told = told(&output);
    assert!(told.lines().count() < 40, "{}", told.lines().count());
    assert!(told.contains("column u: expected a finite number, 99990 more times"), "{told}");
    assert!(told.contains("200000 findings"), "{told}");
}

#[test]
fn terminals_obey_nothing_in_a_problem() {
    let (place, problem) = tiny();
    change(&problem.join("problem.toml"), &[("name = \"", "name = \"\\u001b]0;title\\u0007")]);
    let output = run(place.path(), &["check", "problem"]);
    assert_eq!(code(&output), 0);
    let shown = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(shown.contains("\\u{1b}]0;title\\u{7}") && !shown.contains('\u{1b}'), "{shown}");
}

#[test]
fn an_id_with_blanks_at_its_ends_is_refused() {
    let (place, problem) = tiny();
    change(&problem.join("problem.toml"), &[("id = \"cart\"", "id = \"cart \"")]);
    let output = run(place.path(), &["check", "problem"]);
    assert_eq!(code(&output), 3);
    assert!(told(&output).contains("an id without blanks at its ends"), "{}", told(&output));
}

/// What is only so where files are as Unix has them.
#[cfg(unix)]
mod unix {
    use super::*;
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt;
    use std::os::unix::fs::symlink;
    use std::os::unix::process::ExitStatusExt;

    /// The program by its path, for what only the standard library can do with it.
    fn command() -> Command {
        Command::new(program().get_program())
    }

    #[test]
    fn what_is_no_file_is_refused_at_once() {
        for file in [
            "problem.toml",
            "vehicle_observations.csv",
            "frames.csv",
            "targets.csv",
            "reference/cart.ply",
            "reference/cart.pos",
            "reference/gnss.csv",
            "reference/reference.toml",
            "reference/cart.matrix.txt",
        ] {
            let (place, problem) = tiny();
            std::fs::create_dir_all(problem.join("reference")).unwrap();
            let path = problem.join(file);
            let _ = std::fs::remove_file(&path);
            assert!(Command::new("mkfifo").arg(&path).status().unwrap().success());
            let is_refused = |kind: &str| {
                let output = run(place.path(), &["check", "problem"]);
                assert_eq!(code(&output), 3, "{file}");
                assert!(told(&output).contains(kind), "{file}: {}", told(&output));
            };
            is_refused("a pipe, not a file");
            std::fs::remove_file(&path).unwrap();
            symlink("/dev/zero", &path).unwrap();
            is_refused("a device, not a file");
            std::fs::remove_file(&path).unwrap();
            std::fs::create_dir(&path).unwrap();
            is_refused("a folder, not a file");
        }
        let (place, problem) = tiny();
        change(&problem.join("problem.toml"), &[("[terrain]", "[terrain]\ngrid = \"/dev/zero\"\n#")]);
        let output = run(place.path(), &["check", "problem"]);
        assert_eq!(code(&output), 3);
    }

    #[test]
    fn paths_need_not_be_utf8() {
        let (place, problem) = tiny();
        let name = |begin: &str| OsStr::from_bytes(&[begin.as_bytes(), b"\xff"].concat()).to_owned();
        std::fs::rename(problem, place.path().join(name("p"))).unwrap();
        let run = |arguments: &[&OsStr]| {
            let output = command().current_dir(place.path()).args(arguments).output().unwrap();
            assert_eq!(code(&output), 0, "{}", told(&output));
        };
        let [refine, evaluate, out, no_rrd] = ["refine", "evaluate", "--out", "--no-rrd"].map(OsStr::new);
        run(&[refine, &name("p"), out, &name("o"), no_rrd]);
        run(&[evaluate, &name("p"), &name("o"), out, &name("e")]);
        assert_eq!(report(&place.path().join(name("o")))["command"], "trackbundle refine PROBLEM");
    }

    #[test]
    fn a_reader_that_goes_away_costs_no_result() {
        let (place, _) = tiny();
        let full = std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
        let mut refine = command();
        refine.current_dir(place.path()).args(["refine", "problem", "--no-rrd", "--out", "o"]);
        let status = refine.stdout(Stdio::null()).stderr(full).status().unwrap();
        assert_eq!(status.code(), Some(0));
        assert!(place.path().join("o/report.json").exists());
        // A pipe whose reader has gone.
        let mut child = command()
            .current_dir(place.path())
            .args(["refine", "problem", "--no-rrd", "--out", "p", "--verbose"])
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        drop(child.stderr.take());
        assert_eq!(child.wait().unwrap().code(), Some(0));
        assert!(place.path().join("p/report.json").exists());
    }

    #[test]
    fn links_stay_links_and_are_not_followed() {
        let (place, _) = tiny();
        assert_eq!(code(&refine(place.path(), &[])), 0);
        std::fs::rename(place.path().join("o"), place.path().join("real")).unwrap();
        symlink("real", place.path().join("o")).unwrap();
        assert_eq!(code(&refine(place.path(), &[])), 0);
        assert!(std::fs::symlink_metadata(place.path().join("o")).unwrap().is_symlink());
        // A file in a result that became a link is the user's.
        let table = place.path().join("real/targets.csv");
        std::fs::rename(&table, place.path().join("kept.csv")).unwrap();
        symlink("../kept.csv", &table).unwrap();
        assert_eq!(code(&refine(place.path(), &[])), 2);
    }

    /// A problem that takes long enough to be interrupted.
    fn long(place: &Path) -> Command {
        let mut command = command();
        command.current_dir(place).args(["refine"]).arg(in_package("problems/drive-60s"));
        command.args(["--no-rrd", "--out", "deep/o"]).stdout(Stdio::null()).stderr(Stdio::piped());
        command
    }

    fn wait_for(place: &Path, what: impl Fn(&Path) -> bool) {
        while !what(place) {
            std::thread::sleep(Duration::from_millis(10));
        }
    }

    fn is_taken(place: &Path) -> bool {
        std::fs::read_dir(place.join("deep")).is_ok_and(|mut entries| entries.next().is_some())
    }

    /// Whether this process was begun with SIGINT ignored, as those in the background of a script are.
    fn ignores_interrupts() -> bool {
        let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
        let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:")).unwrap_or("0");
        u64::from_str_radix(mask.trim(), 16).unwrap_or(0) & 2 != 0
    }

    #[test]
    fn an_interruption_ends_at_once_and_leaves_nothing() {
        for (signal, wanted) in [("INT", 130), ("TERM", 143)] {
            if signal == "INT" && ignores_interrupts() {
                // A job in the background; its children do as well.
                continue;
            }
            let place = tempfile::tempdir().unwrap();
            let child = long(place.path()).spawn().unwrap();
            wait_for(place.path(), is_taken);
            let kill = Command::new("kill").args([&format!("-{signal}"), &child.id().to_string()]).status();
            assert!(kill.unwrap().success());
            let output = child.wait_with_output().unwrap();
            assert_eq!(output.status.code(), Some(wanted), "{}", told(&output));
            assert!(told(&output).contains(&format!("interrupted (SIG{signal}): nothing was written")));
            assert!(names(place.path()).is_empty());
        }
    }

    #[test]
    fn one_place_is_for_one_process_and_what_the_dead_leave_goes() {
        let (place, _) = tiny();
        std::fs::create_dir(place.path().join("deep")).unwrap();
        let mut child = long(place.path()).spawn().unwrap();
        wait_for(place.path(), is_taken);
        let again = || run(place.path(), &["refine", "problem", "--no-rrd", "--out", "deep/o"]);
        let second = again();
        assert_eq!(code(&second), 2, "{}", told(&second));
        assert!(told(&second).contains("another trackbundle is at work on this place"));
        // Another place beside it is free.
        assert_eq!(code(&run(place.path(), &["refine", "problem", "--no-rrd", "--out", "deep/p"])), 0);
        child.kill().unwrap();
        assert_eq!(child.wait().unwrap().signal(), Some(9));
        assert_eq!(names(&place.path().join("deep")).len(), 2);
        let third = again();
        assert_eq!(code(&third), 0, "{}", told(&third));
        assert!(told(&third).contains("left by a run that was cut off, and removed"), "{}", told(&third));
        assert_eq!(names(&place.path().join("deep")), ["o", "p"]);
    }

    #[test]
    fn a_reference_that_cannot_be_read_is_an_error() {
        let (place, problem) = tiny();
        std::fs::write(problem.join("reference"), "a file").unwrap();
        let output = run(place.path(), &["check", "problem"]);
        assert_eq!(code(&output), 3, "{}", told(&output));
        assert!(told(&output).contains("reference: expected a folder that can be read"), "{}", told(&output));
    }
}
