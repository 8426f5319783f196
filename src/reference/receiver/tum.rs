//! TUM trajectories: `timestamp tx ty tz qx qy qz qw` in a line, in the world of the problem and on the
//! receiver's clock. Lines that begin with `#` are comments.

use super::{finite, push};
use crate::reference::GnssPosition;
use crate::tables::{Finding, Findings};
use nalgebra::Point3;

pub(super) fn parse(text: &str, file: &str, findings: &mut Findings) -> Option<Vec<GnssPosition>> {
    let mut track = Vec::new();
    for (at, line) in text.lines().enumerate() {
        let line_number = at as u64 + 1;
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let numbers: Option<Vec<f64>> = line.split_whitespace().map(finite).collect();
        let Some([time_s, x, y, z, _, _, _, _]) = numbers.as_deref() else {
            let wanted = "eight finite numbers: timestamp tx ty tz qx qy qz qw";
            findings.error(Finding::of_line(file, line_number, wanted, line));
            return None;
        };
        let position =
            GnssPosition { time_s: *time_s, position: Point3::new(*x, *y, *z), ..GnssPosition::default() };
        push(&mut track, position, file, line_number, findings)?;
    }
    if track.is_empty() {
        findings.error(Finding::of_file(file, "lines with a time, a position and a quaternion", "none"));
        return None;
    }
    Some(track)
}
