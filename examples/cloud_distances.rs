//! Distances from the points of one text file to the nearest points of another.
//!
//! `cloud_distances FROM TO` reads two files with `x y z` \[m\] on each line and prints, for each point of the first, the
//! number of its nearest point in the second (from 0) and the distance \[m\] with 17 digits.
//! `tests/clouds/compare.py` holds them against another implementation.

use nalgebra::Point3;
use std::io::Write;
use trackbundle::internals::cloud::{CloudIndex, distances};

fn points(path: &str) -> Result<Vec<Point3<f64>>, String> {
    let text = std::fs::read_to_string(path).map_err(|e| format!("{path}: {e}"))?;
    let mut points = Vec::new();
    for (at, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
        let numbers: Result<Vec<f64>, _> = line.split_whitespace().map(str::parse).collect();
        match numbers.as_deref() {
            Ok([x, y, z, ..]) => points.push(Point3::new(*x, *y, *z)),
            _ => return Err(format!("{path}:{}: expected three numbers, found {line:?}", at + 1)),
        }
    }
    Ok(points)
}

fn main() -> Result<(), String> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [from, to] = arguments.as_slice() else { return Err("usage: cloud_distances FROM TO".to_owned()) };
    let index = CloudIndex::new(points(to)?).map_err(|e| format!("{to}: {e}"))?;
    let mut out = std::io::BufWriter::new(std::io::stdout().lock());
    for nearest in distances(&points(from)?, &index) {
        writeln!(out, "{} {:.17e}", nearest.index, nearest.distance_m).map_err(|e| e.to_string())?;
    }
    Ok(())
}
