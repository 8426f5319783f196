//! The files of an evaluation folder for other programs: they read back as what is printed.

use crate::support;

use serde_json::Value;
use std::collections::BTreeMap;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;
use support::score::rows;
use support::{in_package, program};
use tempfile::TempDir;

type Row = BTreeMap<String, String>;

fn suv() -> PathBuf {
    in_package("problems/suv-exact")
}

static RESULT: LazyLock<(TempDir, PathBuf)> = LazyLock::new(|| {
    let place = tempfile::tempdir().unwrap();
    let result = place.path().join("result");
    program().arg("refine").arg(suv()).arg("--out").arg(&result).args(["--no-rrd", "-q"]).assert().success();
    (place, result)
});

/// An evaluation folder, what it says of its first vehicle and of its first shape, and what is printed.
struct Exported {
    _place: TempDir,
    folder: PathBuf,
    track: Value,
    shape: Value,
    printed: String,
}

impl Exported {
    fn of(arguments: &[&str]) -> Self {
        let place = tempfile::tempdir().unwrap();
        let folder = place.path().join("evaluation");
        let mut command = program();
        command.arg("evaluate").arg(suv()).arg(&RESULT.1).args(arguments).arg("--out").arg(&folder);
        let printed = command.assert().success().get_output().stdout.clone();
        let text = std::fs::read_to_string(folder.join("evaluation.json")).unwrap();
        let report: Value = serde_json::from_str(&text).unwrap();
        let (track, shape) = (report["vehicles"][0]["track"].clone(), report["shapes"][0].clone());
        Exported { _place: place, folder, track, shape, printed: String::from_utf8(printed).unwrap() }
    }

    fn table(&self, name: &str) -> Vec<Row> {
        rows(&self.folder.join(name))
    }

    /// Rows of numbers with blanks between.
    fn numbers(&self, name: &str) -> Vec<Vec<f64>> {
        numbers(&std::fs::read_to_string(self.folder.join(name)).unwrap())
    }

    fn files(&self) -> Vec<(String, Vec<u8>)> {
        let name = |path: &Path| path.file_name().unwrap().to_str().unwrap().to_owned();
        let paths = std::fs::read_dir(&self.folder).unwrap().map(|entry| entry.unwrap().path());
        let mut files: Vec<_> = paths.map(|path| (name(&path), std::fs::read(&path).unwrap())).collect();
        files.sort();
        files
    }
}

static PLAIN: LazyLock<Exported> = LazyLock::new(|| Exported::of(&["--clock-offset", "0.0625"]));
static ALIGNED: LazyLock<Exported> = LazyLock::new(|| {
    Exported::of(&["--association", "nearest", "--alignment", "similarity", "--clock-offset", "0.03"])
});

fn numbers(text: &str) -> Vec<Vec<f64>> {
    text.lines().map(|line| line.split(' ').map(|cell| cell.parse().unwrap()).collect()).collect()
}

fn cell(row: &Row, column: &str) -> Option<f64> {
    let text = &row[column];
    (!text.is_empty()).then(|| text.parse().unwrap_or_else(|_| panic!("{column}: {text}")))
}

fn column(rows: &[Row], column: &str) -> Vec<f64> {
    rows.iter().filter_map(|row| cell(row, column)).collect()
}

fn median(values: &[f64]) -> f64 {
    let mut values = values.to_vec();
    values.sort_by(f64::total_cmp);
    let middle = values.len() / 2;
    if values.len() % 2 == 1 { values[middle] } else { 0.5 * (values[middle - 1] + values[middle]) }
}

fn mad(values: &[f64]) -> f64 {
    let middle = median(values);
    median(&values.iter().map(|v| (v - middle).abs()).collect::<Vec<_>>())
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

fn assert_close(found: f64, wanted: &Value, what: &str) {
    let wanted = wanted.as_f64().unwrap_or_else(|| panic!("{what} is not known"));
    assert!((found - wanted).abs() <= 1e-12 * wanted.abs().max(1.0), "{what}: {found}, not {wanted}");
}

#[test]
fn every_file_is_there_and_nothing_else_and_again_the_same_bytes() {
    let names: Vec<String> = PLAIN.files().into_iter().map(|(name, _)| name).collect();
    let wanted = [
        "evaluation.json",
        "evo_car1.zip",
        "poses_car1.kitti",
        "reference_car1.kitti",
        "reference_car1.tum",
        "report.html",
        "scan_car1.ply",
        "shape_car1.ply",
        "shape_distances.csv",
        "track_car1.tum",
        "track_differences.csv",
    ];
    assert_eq!(names, wanted);
    let again = Exported::of(&["--clock-offset", "0.0625"]);
    for ((name, first), (_, second)) in PLAIN.files().iter().zip(&again.files()) {
        // The page has its own command in it, and with it the folder.
        assert!(name == "report.html" || first == second, "{name}");
    }
}

#[test]
fn the_table_of_tracks_gives_the_statistics_that_are_printed() {
    for exported in [&*PLAIN, &*ALIGNED] {
        let (table, track) = (exported.table("track_differences.csv"), &exported.track);
        assert_eq!(track["compared"], table.len());
        for (name, of) in [
            ("dx_m", "x"),
            ("dy_m", "y"),
            ("dz_m", "z"),
            ("along_m", "along"),
            ("across_m", "across"),
            ("dspeed_mps", "speed"),
            ("heading_difference_deg", "heading"),
            ("course_difference_deg", "course"),
        ] {
            let values = column(&table, name);
            assert_eq!(track[of]["count"], values.len(), "{name}");
            assert_close(median(&values), &track[of]["median"], name);
            assert_close(mad(&values), &track[of]["mad"], name);
            assert_close(rms(&values), &track[of]["rms"], name);
        }
        assert_close(rms(&column(&table, "distance_m")), &track["distances"]["rmse"], "distance_m");
        assert_close(
            median(&column(&table, "reference_speed_mps")),
            &track["median_speed_mps"],
            "reference speed",
        );
        for axis in 0..3 {
            let sigma = column(&table, ["sigma_x", "sigma_y", "sigma_z"][axis]);
            assert_close(median(&sigma), &track["sigma_m"][axis], "sigma");
        }
        let x = column(&table, "dx_m");
        let line = format!("m_x {:.4} m, D_x {:.4} m", median(&x), mad(&x));
        assert!(exported.printed.contains(&line), "{line}\n{}", exported.printed);
        assert_eq!(column(&table, "reference_sigma_x"), [0.0; 0], "what is not known is empty");
    }
}

#[test]
fn differences_of_a_row_are_those_of_its_places() {
    for exported in [&*PLAIN, &*ALIGNED] {
        for row in exported.table("track_differences.csv") {
            let at = |name: &str| cell(&row, name).unwrap();
            let [x, y, z] = ["x", "y", "z"]
                .map(|axis| at(axis) - at(&format!("reference_{axis}")) - at(&format!("d{axis}_m")));
            assert!(x == 0.0 && y == 0.0 && z == 0.0, "{row:?}");
            let length = at("dx_m").hypot(at("dy_m")).hypot(at("dz_m"));
            assert!((length - at("distance_m")).abs() < 1e-15, "{row:?}");
            if let (Some(along), Some(across)) = (cell(&row, "along_m"), cell(&row, "across_m")) {
                assert!((along.hypot(across) - at("dx_m").hypot(at("dy_m"))).abs() < 1e-14, "{row:?}");
            }
            if let Some(difference) = cell(&row, "dspeed_mps") {
                assert_eq!(at("speed_mps") - at("reference_speed_mps"), difference);
            }
        }
    }
}

#[test]
fn frames_are_those_of_the_result_at_the_time_of_the_reference() {
    let result: BTreeMap<String, Row> =
        rows(&RESULT.1.join("trajectories.csv")).into_iter().map(|row| (row["frame"].clone(), row)).collect();
    let table = PLAIN.table("track_differences.csv");
    let (track, poses) = (PLAIN.numbers("track_car1.tum"), PLAIN.numbers("poses_car1.kitti"));
    let (reference, still) = (PLAIN.numbers("reference_car1.tum"), PLAIN.numbers("reference_car1.kitti"));
    assert!(table.len() > 100);
    for rows in [&track, &poses, &reference, &still] {
        assert_eq!(rows.len(), table.len());
    }
    for (at, row) in table.iter().enumerate() {
        let own = &result[&row["frame"]];
        for name in ["time_s", "x", "y", "z", "speed_mps", "heading_deg", "sigma_x", "sigma_speed_mps"] {
            assert_eq!(cell(row, name), cell(own, name), "{name}");
        }
        let place = ["x", "y", "z"].map(|axis| cell(own, axis).unwrap());
        let of_reference = ["reference_x", "reference_y", "reference_z"].map(|axis| cell(row, axis).unwrap());
        let time_s = cell(own, "time_s").unwrap() + 0.0625;
        assert_eq!(cell(row, "reference_time_s"), Some(time_s));
        assert_eq!((track[at][0], reference[at][0]), (time_s, time_s));
        assert_eq!((&track[at][1..4], &reference[at][1..4]), (&place[..], &of_reference[..]));
        assert_eq!(reference[at][4..], [0.0, 0.0, 0.0, 1.0]);
        assert_eq!([3, 7, 11].map(|cell| poses[at][cell]), place);
        assert_eq!([3, 7, 11].map(|cell| still[at][cell]), of_reference);
        assert_eq!([0, 5, 10].map(|cell| still[at][cell]), [1.0; 3]);
        // The body's x axis, from the quaternion and from the matrix.
        let heading = cell(own, "heading_deg").unwrap().to_radians();
        let [qx, qy, qz, qw] = [4, 5, 6, 7].map(|cell| track[at][cell]);
        let by_quaternion =
            [1.0 - 2.0 * (qy * qy + qz * qz), 2.0 * (qx * qy + qw * qz), 2.0 * (qx * qz - qw * qy)];
        let by_matrix = [0, 4, 8].map(|cell| poses[at][cell]);
        for (axis, wanted) in [heading.cos(), heading.sin(), 0.0].into_iter().enumerate() {
            assert!((by_quaternion[axis] - wanted).abs() < 1e-14, "{row:?}");
            assert!((by_matrix[axis] - wanted).abs() < 1e-14, "{row:?}");
        }
    }
}

#[test]
fn the_nearest_are_rows_of_the_reference_with_their_own_times() {
    let samples: Vec<[f64; 4]> = rows(&suv().join("reference/gnss.csv"))
        .iter()
        .map(|row| ["time_s", "x", "y", "z"].map(|name| cell(row, name).unwrap()))
        .collect();
    let (track, reference) = (ALIGNED.numbers("track_car1.tum"), ALIGNED.numbers("reference_car1.tum"));
    let gap = ALIGNED.track["max_gap_s"].as_f64().unwrap();
    assert!(reference.len() > 20 && track.len() == reference.len());
    for (own, row) in track.iter().zip(&reference) {
        assert!(samples.iter().any(|sample| sample[..] == row[..4]), "{row:?}");
        assert!((own[0] - row[0]).abs() <= gap, "{own:?} {row:?}");
    }
    assert!(track.iter().zip(&reference).any(|(own, row)| own[0] != row[0]));
}

/// The files of the archive in its order.
fn archived(exported: &Exported) -> Vec<(String, Vec<u8>)> {
    let file = std::fs::File::open(exported.folder.join("evo_car1.zip")).unwrap();
    let mut archive = zip::ZipArchive::new(file).unwrap();
    let count = archive.len();
    let read = |at: usize| {
        let mut entry = archive.by_index(at).unwrap();
        let mut bytes = Vec::new();
        entry.read_to_end(&mut bytes).unwrap();
        (entry.name().unwrap().into_owned(), bytes)
    };
    (0..count).map(read).collect()
}

/// The values of an array of 64 bits.
fn values(npy: &[u8]) -> Vec<f64> {
    assert!(npy.starts_with(b"\x93NUMPY\x01\x00"));
    let start = 10 + usize::from(u16::from_le_bytes([npy[8], npy[9]]));
    assert!(start % 64 == 0 && npy[start - 1] == b'\n');
    npy[start..].chunks_exact(8).map(|value| f64::from_le_bytes(value.try_into().unwrap())).collect()
}

#[test]
fn the_archive_of_evo_says_what_is_printed() {
    for (exported, title) in [(&*PLAIN, "(not aligned)"), (&*ALIGNED, "(with Sim(3) Umeyama alignment)")] {
        let files = archived(exported);
        let names: Vec<&str> = files.iter().map(|(name, _)| name.as_str()).collect();
        let with_matrix = exported.track["aligned"] != Value::Null;
        let mut wanted = vec![
            "info.json",
            "stats.json",
            "error_array.npy",
            "seconds_from_start.npy",
            "timestamps.npy",
            "distances_from_start.npy",
            "distances.npy",
            "alignment_transformation_sim3.npy",
            "reference_car1.tum",
            "track_car1.tum",
        ];
        wanted.retain(|name| with_matrix || !name.starts_with("alignment"));
        assert_eq!(names, wanted);
        let file = |name: &str| &files.iter().find(|(found, _)| found == name).unwrap().1;
        let json = |name: &str| serde_json::from_slice::<Value>(file(name)).unwrap();
        let info = json("info.json");
        assert_eq!(info["title"], format!("APE w.r.t. translation part (m)\n{title}"));
        assert_eq!(
            [&info["label"], &info["ref_name"], &info["est_name"]],
            ["APE (m)", "reference_car1", "track_car1"]
        );
        let mut distances = exported.track["distances"].clone();
        distances.as_object_mut().unwrap().remove("count");
        assert_eq!(json("stats.json"), distances);

        let table = exported.table("track_differences.csv");
        assert_eq!(values(file("error_array.npy")), column(&table, "distance_m"));
        for name in ["reference_car1.tum", "track_car1.tum"] {
            assert!(*file(name) == std::fs::read(exported.folder.join(name)).unwrap(), "{name}");
        }
        let track = exported.numbers("track_car1.tum");
        let times: Vec<f64> = track.iter().map(|row| row[0]).collect();
        assert_eq!(values(file("timestamps.npy")), times);
        let since: Vec<f64> = times.iter().map(|time| time - times[0]).collect();
        assert_eq!(values(file("seconds_from_start.npy")), since);
        for (array, of) in [("distances.npy", "track"), ("distances_from_start.npy", "reference")] {
            let places = exported.numbers(&format!("{of}_car1.tum"));
            let mut way = 0.0;
            for (at, found) in values(file(array)).into_iter().enumerate() {
                for pair in places[at.saturating_sub(1)..=at].windows(2) {
                    way += (1..4).map(|k| (pair[1][k] - pair[0][k]).powi(2)).sum::<f64>().sqrt();
                }
                assert!((found - way).abs() < 1e-12, "{array} {at}");
            }
        }
        if with_matrix {
            let matrix = values(file("alignment_transformation_sim3.npy"));
            let applied = &exported.track["aligned"];
            for row in 0..3 {
                assert_close(matrix[4 * row + 3], &applied["translation_m"][row], "translation");
                assert_close(rms(&matrix[4 * row..4 * row + 3]) * 3_f64.sqrt(), &applied["scale"], "scale");
            }
            assert_eq!(matrix[12..], [0.0, 0.0, 0.0, 1.0]);
        }
    }
}

#[test]
fn the_table_of_shapes_gives_the_statistics_that_are_printed() {
    let (table, shape) = (PLAIN.table("shape_distances.csv"), &PLAIN.shape);
    for (name, of) in [
        ("to_scan_m", "to_scan"),
        ("to_plane_m", "to_plane"),
        ("truth_raw_m", "truth_raw"),
        ("truth_rigid_m", "truth_rigid"),
        ("truth_similarity_m", "truth_similarity"),
    ] {
        let (values, found) = (column(&table, name), &shape[of]);
        assert_eq!(found["count"], values.len(), "{name}");
        assert_close(median(&values), &found["median_m"], name);
        assert_close(mad(&values), &found["mad_m"], name);
        assert_close(rms(&values), &found["rms_m"], name);
        let within = values.iter().filter(|v| v.abs() <= 0.05).count() as f64 / values.len() as f64;
        assert_close(within, &found["within"][2], name);
    }
    let is_poor = |row: &&Row| {
        let squares =
            ["sigma_x", "sigma_y", "sigma_z"].map(|axis| cell(row, axis).unwrap_or(f64::INFINITY).powi(2));
        squares.iter().sum::<f64>().sqrt() > shape["limit_m"].as_f64().unwrap()
    };
    let good = table.iter().filter(|row| !is_poor(row)).count();
    assert_eq!(shape["to_scan_limited"]["count"], good);
    assert_eq!(column(&table, "to_mesh_m"), [0.0; 0], "the scan is no mesh");

    let points: BTreeMap<String, Row> = rows(&RESULT.1.join("vehicle_points.csv"))
        .into_iter()
        .map(|row| (row["point"].clone(), row))
        .collect();
    let truth: BTreeMap<String, Row> = rows(&suv().join("truth/vehicle_points.csv"))
        .into_iter()
        .map(|row| (row["point"].clone(), row))
        .collect();
    for row in &table {
        for name in ["x", "y", "z"] {
            assert_eq!(row["vehicle"], "car1");
            assert_eq!(cell(row, name), cell(&points[&row["point"]], name));
        }
        let off =
            ["x", "y", "z"].map(|axis| cell(row, axis).unwrap() - cell(&truth[&row["point"]], axis).unwrap());
        let length = off.iter().map(|v| v * v).sum::<f64>().sqrt();
        assert!((length - cell(row, "truth_raw_m").unwrap()).abs() < 1e-12, "{row:?}");
    }
}
