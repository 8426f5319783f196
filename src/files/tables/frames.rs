//! `frames.csv`.

use super::super::cells::seconds;
use super::reading::Reader;
use crate::problem::{Frame, Problem};
use crate::tables::{Finding, Line, input_row, written};
use std::collections::HashMap;

/// Name of the file.
pub const FILE: &str = "frames.csv";

input_row!(
    /// `frames.csv`.
    FrameRow { required frame: i64, required time_s: f64 }
);

/// The numbers of the frames and where they stand.
pub fn check(reader: &mut Reader, rows: Option<&[Line<FrameRow>]>) -> HashMap<i64, usize> {
    let mut index = HashMap::new();
    let Some(rows) = rows else { return index };
    let mut last_time = f64::NEG_INFINITY;
    for (at, Line { line, row }) in rows.iter().enumerate() {
        if index.insert(row.frame, at).is_some() {
            reader.cell(FILE, *line, "frame", "a frame that is listed once", row.frame);
        }
        if row.time_s <= last_time {
            let wanted = format!("a time after {last_time}");
            reader.cell(FILE, *line, "time_s", &wanted, row.time_s);
        }
        last_time = row.time_s;
    }
    if rows.is_empty() && !reader.findings.is_invalid() {
        reader.findings.error(Finding::of_file(FILE, "at least one frame", "none"));
    }
    index
}

/// The frames, in their order.
pub fn frames(rows: &[Line<FrameRow>]) -> Vec<Frame> {
    rows.iter().map(|line| Frame { number: line.row.frame, time_s: line.row.time_s }).collect()
}

/// The table of a problem.
pub fn table(problem: &Problem) -> Vec<u8> {
    let rows = problem.frames.iter().map(|f| [f.number.to_string(), seconds(f.time_s)]);
    written(&["frame", "time_s"], rows)
}
