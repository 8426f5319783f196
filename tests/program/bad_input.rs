//! Damaged copies of a problem: each is refused with exit code 3 and the place, and nothing is written.

use crate::support;

use std::path::Path;
use support::drive::Drive;
use support::program;
use trackbundle::internals::files::read_problem;
use trackbundle::problem::Video;

/// A problem with every table there is.
fn whole(folder: &Path) {
    Drive { frames: 6, points: 6, targets: 5, ..Default::default() }.write(folder);
    std::fs::create_dir(folder.join("reference")).unwrap();
    let save = |name: &str, text: &str| std::fs::write(folder.join(name), text).unwrap();
    save("reference/gnss.csv", "vehicle,time_s,x,y,z\ncar0,0.0,1,2,3\ncar0,0.2,1,2,3\n");
    save(
        "reference/car0.ply",
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n1 2 3\n",
    );
}

/// How a file is damaged.
enum Damage {
    /// A text is replaced where it first stands.
    Replace(&'static str, &'static str),
    /// A cell, by line (the header is 1) and column.
    Cell(usize, usize, &'static str),
    /// A line is written twice.
    Twice(usize),
    /// A line is taken out.
    Without(usize),
    /// The text becomes this.
    Whole(&'static [u8]),
    /// The file is taken away.
    Missing,
}

use Damage::{Cell, Missing, Replace, Twice, Whole, Without};

fn apply(damage: &Damage, path: &Path) {
    let text = std::fs::read_to_string(path).unwrap();
    let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
    match damage {
        Replace(from, to) => {
            assert!(text.contains(from), "{from} is not in {}", path.display());
            lines = text.replacen(from, to, 1).lines().map(str::to_owned).collect();
        }
        Cell(line, column, value) => {
            let mut cells: Vec<&str> = lines[line - 1].split(',').collect();
            cells[*column] = value;
            lines[line - 1] = cells.join(",");
        }
        Twice(line) => lines.insert(*line, lines[line - 1].clone()),
        Without(line) => {
            lines.remove(line - 1);
        }
        Whole(bytes) => return std::fs::write(path, bytes).unwrap(),
        Missing => return std::fs::remove_file(path).unwrap(),
    }
    std::fs::write(path, lines.join("\n")).unwrap();
}

/// File, damage, and what the message must contain.
const DAMAGES: &[(&str, Damage, &[&str])] = &[
    ("problem.toml", Missing, &["problem.toml"]),
    ("problem.toml", Whole(b""), &["problem.toml:1: column format"]),
    ("problem.toml", Whole(b"\xff\xfe"), &["problem.toml", "UTF-8"]),
    ("problem.toml", Replace("format = 1", "format = 2"), &["problem.toml:1: column format", "\"2\""]),
    ("problem.toml", Replace("fx = 2680", "fx = -2680"), &["column camera.fx", "\"-2680\""]),
    ("problem.toml", Replace("fy = 2680", "fy = nan"), &["column camera.fy", "\"nan\""]),
    ("problem.toml", Replace("width = 3840", "width = 0"), &["column camera.width", "\"0\""]),
    ("problem.toml", Replace("cx = 1920", "cx = \"left\""), &["column camera.cx"]),
    ("problem.toml", Replace("cx = 1920", "cx 1920"), &["problem.toml:", "valid TOML"]),
    ("problem.toml", Replace("vehicle_px = 1", "vehicle_px = -1"), &["column noise.vehicle_px"]),
    ("problem.toml", Replace("plane_z = 0.0", "plane = 0.0"), &["column terrain.plane_z"]),
    ("problem.toml", Replace("plane_z = 0.0", "grid = \"none.asc\""), &["none.asc"]),
    (
        "problem.toml",
        Replace("plane_z = 0.0", "plane_z = 0.0\ngrid = \"ground.asc\""),
        &["one of plane_z and grid"],
    ),
    (
        "problem.toml",
        Replace("width = 3840", "pixel_centre = 1\nwidth = 3840"),
        &["column camera.pixel_centre"],
    ),
    ("problem.toml", Replace("[[vehicle]]", "[[vehicles]]"), &["column vehicle", "[[vehicle]]"]),
    (
        "problem.toml",
        Replace("marker = \"mark\"", "marker = \"park\""),
        &["column vehicle.marker", "\"park\""],
    ),
    ("frames.csv", Missing, &["frames.csv"]),
    ("frames.csv", Whole(b""), &["frames.csv:1: column frame", "an empty file"]),
    ("frames.csv", Whole(b"frame,time_s\n"), &["frames.csv: expected at least one frame"]),
    ("frames.csv", Whole(b"frame,time\n0,0\n"), &["frames.csv:1: column time_s"]),
    ("frames.csv", Cell(3, 1, "0"), &["frames.csv:3: column time_s", "\"0\""]),
    ("frames.csv", Cell(4, 0, "1"), &["frames.csv:4: column frame"]),
    ("frames.csv", Cell(4, 0, "1.5"), &["frames.csv:4: column frame", "\"1.5\""]),
    ("camera_poses.csv", Twice(3), &["camera_poses.csv:4: column frame"]),
    ("camera_poses.csv", Cell(2, 4, "0.9"), &["camera_poses.csv:2: column qw,qx,qy,qz", "length"]),
    ("camera_poses.csv", Cell(2, 0, "77"), &["camera_poses.csv:2: column frame", "\"77\""]),
    ("camera_poses.csv", Cell(5, 1, "inf"), &["camera_poses.csv:5: column x", "\"inf\""]),
    ("targets.csv", Missing, &["targets.csv"]),
    ("targets.csv", Twice(2), &["targets.csv:3: column target"]),
    ("targets.csv", Cell(2, 4, "-0.1"), &["targets.csv:2: column sigma_x", "\"-0.1\""]),
    ("targets.csv", Cell(3, 7, "boss"), &["targets.csv:3: column role", "\"boss\""]),
    ("targets.csv", Cell(3, 1, "east"), &["targets.csv:3: column x", "\"east\""]),
    ("target_observations.csv", Missing, &["target_observations.csv"]),
    ("target_observations.csv", Cell(4, 1, "T99"), &["target_observations.csv:4: column target", "\"T99\""]),
    ("target_observations.csv", Twice(3), &["target_observations.csv:4: column target"]),
    ("target_observations.csv", Cell(2, 2, ""), &["target_observations.csv:2: column u", "\"\""]),
    ("vehicle_observations.csv", Missing, &["vehicle_observations.csv"]),
    ("vehicle_observations.csv", Cell(9, 3, "nan"), &["vehicle_observations.csv:9: column u", "\"nan\""]),
    (
        "vehicle_observations.csv",
        Cell(9, 1, "bus"),
        &["vehicle_observations.csv:9: column vehicle", "\"bus\""],
    ),
    ("vehicle_observations.csv", Cell(9, 2, ""), &["vehicle_observations.csv:9: column point"]),
    ("vehicle_observations.csv", Twice(5), &["vehicle_observations.csv:6: column point"]),
    (
        "vehicle_observations.csv",
        Replace("0,car0,mark,", "0,car0,mark,,"),
        &["vehicle_observations.csv:2: expected 5 cells", "\"6\""],
    ),
    (
        "vehicle_observations.csv",
        Whole(b"frame,vehicle,point,u,v\n0,car0,\xff,1,2\n"),
        &["vehicle_observations.csv:2", "UTF-8"],
    ),
    ("vehicle_poses.csv", Twice(3), &["vehicle_poses.csv:4: column vehicle"]),
    ("vehicle_poses.csv", Cell(2, 8, "1e3"), &["vehicle_poses.csv:2: column qw,qx,qy,qz"]),
    ("vehicle_points.csv", Cell(2, 1, "ghost"), &["vehicle_points.csv:2: column point", "\"ghost\""]),
    ("vehicle_points.csv", Cell(2, 7, "-1"), &["vehicle_points.csv:2: column sigma_z", "\"-1\""]),
    ("vehicle_points.csv", Twice(2), &["vehicle_points.csv:3: column point"]),
    ("reference/gnss.csv", Cell(2, 1, "soon"), &["reference/gnss.csv:2: column time_s", "\"soon\""]),
    ("reference/gnss.csv", Twice(3), &["reference/gnss.csv:4: column time_s"]),
    ("reference/car0.ply", Replace("1 2 3", "1 2"), &["reference/car0.ply"]),
];

const GRID: &str = "ncols 3\nnrows 2\nxllcorner -500\nyllcorner -500\ncellsize 500\n0 0 0\n0 0 0\n";

/// A problem on a terrain grid.
fn on_a_grid(folder: &Path) {
    whole(folder);
    std::fs::write(folder.join("ground.asc"), GRID).unwrap();
    apply(&Replace("plane_z = 0.0", "grid = \"ground.asc\""), &folder.join("problem.toml"));
}

/// Damages to the grid of [`on_a_grid`].
const GRID_DAMAGES: &[(&str, Damage, &[&str])] = &[
    ("ground.asc", Missing, &["ground.asc: expected the terrain grid that problem.toml names"]),
    ("ground.asc", Whole(b""), &["ground.asc:1: column ncols", "\"nothing\""]),
    ("ground.asc", Replace("nrows 2", "nrows two"), &["ground.asc:2: column nrows", "\"two\""]),
    ("ground.asc", Replace("cellsize 500", "cellsize -5"), &["ground.asc:5: column cellsize", "\"-5\""]),
    ("ground.asc", Replace("cellsize 500", "cell 500"), &["ground.asc:5", "\"cell\""]),
    ("ground.asc", Replace("0 0 0", "0 0"), &["ground.asc:6: expected 3 heights", "\"2\""]),
    ("ground.asc", Without(7), &["ground.asc:6: expected 3 x 2 heights", "\"3 on 1 lines\""]),
    ("ground.asc", Replace("0 0 0", "0 low 0"), &["ground.asc:6: column 2", "\"low\""]),
    ("ground.asc", Replace("0 0 0\n0 0 0", "-9999 -9999 -9999\n-9999 -9999 -9999"), &["at least one height"]),
    ("ground.asc", Whole(b"II*\0\x08\0\0\0\x05"), &["ground.asc: expected a GeoTIFF that can be read"]),
    ("problem.toml", Replace("ground.asc", "frames.csv"), &["frames.csv:1: expected a key of the header"]),
    ("problem.toml", Replace("ground.asc", "reference"), &["reference: expected the terrain grid"]),
];

/// A problem with the images of its frames.
fn filmed(folder: &Path) {
    whole(folder);
    std::fs::create_dir(folder.join("images")).unwrap();
    for frame in 0..6 {
        // The head of an image of 3840 x 2160 px.
        let head = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0\x0f\0\0\0\x08\x70\x08\x02\0\0\0";
        std::fs::write(folder.join(format!("images/{frame:03}.png")), head).unwrap();
    }
    apply(&Replace("[noise]", "[video]\nimages = \"images\"\n[noise]"), &folder.join("problem.toml"));
}

/// Damages to the film of [`filmed`].
const FILM_DAMAGES: &[(&str, Damage, &[&str])] = &[
    (
        "problem.toml",
        Replace("images = \"images\"", "images = \"frames\""),
        &["frames: expected the folder of images that problem.toml names"],
    ),
    (
        "problem.toml",
        Replace("images = \"images\"", "file = \"film.mp4\""),
        &["film.mp4: expected the film that problem.toml names"],
    ),
    (
        "problem.toml",
        Replace("images = \"images\"", "images = \"images\"\npattern = \"{frame}.jpg\""),
        &["images: expected images of the frames of frames.csv, {frame}.jpg, found \"none\""],
    ),
    (
        "problem.toml",
        Replace("images = \"images\"", "images = \"images\"\nfile = \"images/000.png\""),
        &["column video.images: expected one of images and file"],
    ),
    (
        "problem.toml",
        Replace("width = 3840", "width = 4096"),
        &[
            "images/005.png: expected 4096 x 2160 px as [camera] of problem.toml has it, found \"3840 x 2160 px\"",
        ],
    ),
    (
        "frames.csv",
        Replace("0,0\n", "-1,-1\n0,0\n"),
        &["images: expected as many images as frames.csv has frames (7), or a pattern, found \"6\""],
    ),
];

#[test]
fn damaged_copies_are_refused_with_their_place_and_nothing_is_written() {
    refuse_damages(whole, DAMAGES);
}

#[test]
fn damaged_terrain_grids_are_refused_with_their_place() {
    refuse_damages(on_a_grid, GRID_DAMAGES);
}

#[test]
fn damaged_films_are_refused_with_their_place() {
    refuse_damages(filmed, FILM_DAMAGES);
}

#[test]
fn a_film_is_found_and_has_no_effect() {
    let place = tempfile::tempdir().unwrap();
    let problem = place.path().join("problem");
    filmed(&problem);
    let wanted = (0..6).map(|frame| Some(problem.join(format!("images/{frame:03}.png")))).collect();
    let folder = read_problem(&problem).unwrap_or_else(|findings| panic!("{findings}"));
    assert_eq!((folder.problem.unwrap().video, folder.warnings.len()), (Some(Video::Images(wanted)), 0));
    let refined = || {
        program().arg("refine").arg(&problem).args(["--no-rrd", "--quiet"]).assert().success();
        std::fs::read(place.path().join("problem-result/vehicle_poses.csv")).unwrap()
    };
    let with = refined();
    apply(&Replace("[video]\nimages = \"images\"\n", ""), &problem.join("problem.toml"));
    assert!(read_problem(&problem).unwrap().problem.unwrap().video.is_none());
    assert!(refined() == with);
}

fn refuse_damages(whole: impl Fn(&Path), damages: &[(&str, Damage, &[&str])]) {
    let source = tempfile::tempdir().unwrap();
    whole(source.path());
    for (number, (file, damage, wanted)) in damages.iter().enumerate() {
        let place = tempfile::tempdir().unwrap();
        let problem = place.path().join("problem");
        support::copy_folder(source.path(), &problem);
        apply(damage, &problem.join(file));
        for command in ["refine", "check"] {
            let output = program().arg(command).arg(&problem).output().unwrap();
            let errors = String::from_utf8_lossy(&output.stderr);
            assert_eq!(output.status.code(), Some(3), "damage {number} of {file}: {errors}");
            for wanted in *wanted {
                assert!(errors.contains(wanted), "damage {number} of {file}: {wanted:?} is not in\n{errors}");
            }
            assert!(!errors.contains("panicked"), "{errors}");
            assert!(output.stdout.is_empty());
        }
        let left: Vec<_> = std::fs::read_dir(place.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
        assert_eq!(left, ["problem"], "damage {number} of {file}");
    }
}

#[test]
fn the_undamaged_problem_is_accepted() {
    let place = tempfile::tempdir().unwrap();
    let problem = place.path().join("problem");
    whole(&problem);
    program().arg("refine").arg(&problem).args(["--no-rrd", "--quiet"]).assert().success();
    assert!(place.path().join("problem-result/report.json").is_file());
}

#[test]
fn grids_and_fisheye_lenses_are_accepted_and_what_they_do_not_reach_is_told() {
    let place = tempfile::tempdir().unwrap();
    let problem = place.path().join("problem");
    on_a_grid(&problem);
    let accepted = |args: &[&str]| {
        let output = program().args(args).arg(&problem).output().unwrap();
        let errors = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(0), "{errors}");
        errors
    };
    let errors = accepted(&["refine", "--no-rrd"]);
    assert!(!errors.contains("without ground") && !errors.contains("fold"), "{errors}");
    apply(&Replace("xllcorner -500", "xllcorner 5000"), &problem.join("ground.asc"));
    let errors = accepted(&["refine", "--no-rrd"]);
    assert!(errors.contains("vehicle car0: poses without ground below them"), "{errors}");
    assert!(errors.contains("outside the terrain grid"), "{errors}");

    // A lens that sees 10 degrees off its axis, and no farther.
    let folding = "model = \"fisheye\"\nk1 = -11\nwidth = 3840";
    apply(&Replace("width = 3840", folding), &problem.join("problem.toml"));
    let errors = accepted(&["check"]);
    assert!(errors.contains("camera.model folds over inside the image, 31"), "{errors}");
    let wanted =
        "target_observations.csv: image points beyond the fold of the lens model, which are left out: 30,";
    assert!(errors.contains(wanted), "{errors}");
    let output = program().args(["refine", "--no-rrd"]).arg(&problem).output().unwrap();
    assert!(matches!(output.status.code(), Some(0 | 4)), "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn all_findings_of_all_files_come_at_once() {
    let place = tempfile::tempdir().unwrap();
    let problem = place.path().join("problem");
    whole(&problem);
    for (file, damage) in [
        ("problem.toml", Replace("fx = 2680", "fx = 0")),
        ("camera_poses.csv", Cell(2, 1, "x")),
        ("vehicle_poses.csv", Cell(3, 2, "y")),
        ("vehicle_observations.csv", Cell(4, 3, "u")),
        ("vehicle_observations.csv", Cell(6, 4, "v")),
    ] {
        apply(&damage, &problem.join(file));
    }
    let output = program().arg("check").arg(&problem).output().unwrap();
    let errors = String::from_utf8_lossy(&output.stderr);
    for wanted in [
        "problem.toml:6: column camera.fx",
        "camera_poses.csv:2: column x",
        "vehicle_poses.csv:3: column x",
        "vehicle_observations.csv:4: column u",
        "vehicle_observations.csv:6: column v",
    ] {
        assert!(errors.contains(wanted), "{wanted} is not in\n{errors}");
    }
    assert!(errors.contains("findings; nothing was computed or written"));
}

#[test]
fn a_pose_that_is_missing_is_found_on_the_terrain_and_invalid_without_one() {
    for has_terrain in [true, false] {
        let place = tempfile::tempdir().unwrap();
        let problem = place.path().join("problem");
        whole(&problem);
        apply(&Without(3), &problem.join("vehicle_poses.csv"));
        if !has_terrain {
            apply(&Replace("[terrain]\nplane_z = 0.0\n", ""), &problem.join("problem.toml"));
        }
        let output = program().arg("check").arg(&problem).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(if has_terrain { 0 } else { 3 }), "{said}");
        let wanted = match has_terrain {
            true => {
                "vehicle_poses.csv: poses that are missing where a vehicle is seen, and are found on the terrain: 1"
            }
            false => "vehicle_poses.csv: expected a pose of car0 in frame 1",
        };
        assert!(said.contains(wanted), "{said}");
    }
}

#[test]
fn what_is_not_computed_yet_is_refused_by_name() {
    let no_vehicles = |problem: &Path| {
        std::fs::remove_file(problem.join("vehicle_poses.csv")).unwrap();
        apply(&Replace("[terrain]\nplane_z = 0.0\n", ""), &problem.join("problem.toml"));
    };
    type Change = Box<dyn Fn(&Path)>;
    let cases: [(&str, Change); 1] = [("no terrain to find them on", Box::new(no_vehicles))];
    for (name, change) in cases {
        let place = tempfile::tempdir().unwrap();
        let problem = place.path().join("problem");
        whole(&problem);
        change(&problem);
        for command in ["check", "refine"] {
            let output = program().arg(command).arg(&problem).output().unwrap();
            let errors = String::from_utf8_lossy(&output.stderr);
            assert_eq!(output.status.code(), Some(4), "{name}: {errors}");
            assert!(errors.contains(name), "{name} is not in\n{errors}");
        }
        assert!(!place.path().join("problem-result").exists());
    }
}

#[test]
fn a_gap_in_the_camera_poses_needs_three_control_targets() {
    for (targets, check, code) in [(0, 0, 3), (2, 0, 3), (5, 3, 3), (6, 0, 0)] {
        let place = tempfile::tempdir().unwrap();
        let problem = place.path().join("problem");
        Drive { frames: 6, points: 6, targets, check, ..Default::default() }.write(&problem);
        apply(&Without(4), &problem.join("camera_poses.csv"));
        let output = program().arg("check").arg(&problem).output().unwrap();
        let errors = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{targets} {check}: {errors}");
        assert_eq!(code == 3, errors.contains("camera_poses.csv: expected a pose of frame 2"), "{errors}");
    }
}

#[test]
fn cameras_that_cannot_be_resected_are_no_solution() {
    type Place = fn(usize) -> [f64; 3];
    let cases: [(&str, Place); 2] = [
        ("none sees more than 1", |k| [2.0 * k as f64, if k == 0 { 1.0 } else { 900.0 }, 0.0]),
        ("rotation of the camera about that line", |k| [4.0 * k as f64 - 8.0, 2.0 * k as f64 - 3.0, 0.1]),
    ];
    for (wanted, place_of) in cases {
        let place = tempfile::tempdir().unwrap();
        let problem = place.path().join("problem");
        let drive =
            Drive { frames: 6, points: 6, targets: 5, target_place: Some(place_of), ..Default::default() };
        drive.write(&problem);
        std::fs::remove_file(problem.join("camera_poses.csv")).unwrap();
        for command in ["initialise", "refine"] {
            let out = place.path().join("result");
            let output = program().arg(command).arg(&problem).arg("--out").arg(&out).output().unwrap();
            let errors = String::from_utf8_lossy(&output.stderr);
            assert_eq!(output.status.code(), Some(4), "{errors}");
            assert!(errors.contains(wanted), "{wanted} is not in\n{errors}");
            assert!(!out.exists());
        }
    }
}
