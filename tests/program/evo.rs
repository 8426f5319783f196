//! Statistics of positions are those of `evo`: against numbers that it computed (`tests/evo/golden.json`), and
//! on request against `evo` itself.

use crate::support;

use serde_json::Value;
use std::path::Path;
use support::{in_package, program};

/// Time and position \[s, m\].
type Sample = [f64; 4];

/// Where the vehicle is at a time: the same formula as in tests/evo/compare.py.
fn road(t: f64) -> [f64; 3] {
    [7.0 * t + 9.0 * (0.41 * t).sin(), 14.0 * (0.29 * t + 0.5).sin(), 0.3 * (0.2 * t).sin()]
}

/// A result that is somewhat turned, too large, and off.
fn film(rate: f64, count: usize) -> Vec<Sample> {
    let sample = |k: usize| {
        let t = k as f64 / rate;
        let [x, y, z] = road(t);
        let wobble = |axis: f64| 0.05 * (11.0 * t + axis).sin();
        [
            t,
            1.01 * x - 0.02 * y + 0.4 + wobble(0.0),
            1.01 * y + 0.02 * x - 0.3 + wobble(1.0),
            z + 0.2 + wobble(2.0),
        ]
    };
    (0..count).map(sample).collect()
}

fn receiver(rate: f64, count: usize, first_s: f64) -> Vec<Sample> {
    let sample = |k: usize| {
        let t = first_s + k as f64 / rate;
        let [x, y, z] = road(t);
        [t, x + 0.02 * (3.0 * t).sin(), y + 0.02 * (2.0 * t).cos(), z]
    };
    (0..count).map(sample).collect()
}

/// A problem and a result folder with these tracks.
fn save(folder: &Path, film: &[Sample], receiver: &[Sample]) {
    let (problem, result) = (folder.join("problem"), folder.join("result"));
    std::fs::create_dir_all(problem.join("reference")).unwrap();
    std::fs::create_dir(&result).unwrap();
    let save = |name: &str, text: String| std::fs::write(folder.join(name), text).unwrap();
    let numbered = |header: &str, row: &dyn Fn(usize, &Sample) -> String| {
        film.iter().enumerate().fold(format!("{header}\n"), |text, (k, s)| text + &row(k, s) + "\n")
    };
    save(
        "problem/problem.toml",
        "format = 1\nname = \"p\"\n[camera]\nmodel = \"pinhole\"\nwidth = 100\nheight = 100\nfx = 100.0\n\
         fy = 100.0\ncx = 50.0\ncy = 50.0\n[terrain]\nplane_z = 0.0\n[[vehicle]]\nid = \"a\"\n"
            .to_owned(),
    );
    save("problem/frames.csv", numbered("frame,time_s", &|k, s| format!("{k},{:.6}", s[0])));
    save(
        "problem/camera_poses.csv",
        numbered("frame,x,y,z,qw,qx,qy,qz", &|k, _| format!("{k},0,0,50,0,1,0,0")),
    );
    save(
        "problem/vehicle_observations.csv",
        numbered("frame,vehicle,point,u,v", &|k, _| format!("{k},a,p,50,50")),
    );
    let cells = |s: &Sample| s.map(|v| format!("{v:.6}")).join(",");
    save(
        "result/trajectories.csv",
        numbered("vehicle,frame,time_s,x,y,z", &|k, s| format!("a,{k},{}", cells(s))),
    );
    let rows = receiver.iter().map(|s| format!("a,{}\n", cells(s)));
    save("problem/reference/gnss.csv", "vehicle,time_s,x,y,z\n".to_owned() + &rows.collect::<String>());
}

fn distances(folder: &Path, wanted: &Value) -> Value {
    let mut command = program();
    command
        .arg("evaluate")
        .arg(folder.join("problem"))
        .arg(folder.join("result"))
        .args(["--json", "--quiet"]);
    command.args(["--association", wanted["association"].as_str().unwrap()]);
    command.args(["--alignment", wanted["alignment"].as_str().unwrap()]);
    if let Some(gap) = wanted["max_gap_s"].as_f64() {
        command.args(["--max-gap", &gap.to_string()]);
    }
    let output = command.output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(report["alignment"], wanted["alignment"]);
    report["vehicles"][0]["track"]["distances"].clone()
}

#[test]
fn statistics_are_those_that_evo_computed() {
    let golden = std::fs::read_to_string(in_package("tests/evo/golden.json")).unwrap();
    let golden: Vec<Value> = serde_json::from_str(&golden).unwrap();
    assert_eq!(golden.len(), 24, "two pairs of tracks, four associations, three alignments");
    for (name, film, receiver) in [
        ("film30", film(29.97, 600), receiver(5.0, 100, 0.513)),
        ("film5", film(5.0, 100), receiver(29.97, 660, -1.013)),
    ] {
        let place = tempfile::tempdir().unwrap();
        save(place.path(), &film, &receiver);
        for wanted in golden.iter().filter(|row| row["tracks"] == name) {
            let found = distances(place.path(), wanted);
            assert_eq!(found["count"], wanted["count"], "{wanted}");
            for statistic in ["rmse", "mean", "median", "std", "min", "max", "sse"] {
                let [found, wanted] = [&found, wanted].map(|row| row[statistic].as_f64().unwrap());
                let off = (found - wanted).abs() / wanted.abs().max(1.0);
                assert!(off <= 1e-9, "{name}: {statistic} is {found}, of evo {wanted}");
            }
        }
    }
}
