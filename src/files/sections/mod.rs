//! The sections of `problem.toml`, a file each: what it says, how it is read and how it is written.
//!
//! A new section is a file here, and a line in `problem_toml.rs` for each of the three; of one that
//! names points of vehicles, in [`OfPoints`], whose sections are joined to the vehicles when their points are known.

pub mod camera;
mod distance;
pub mod gnss;
pub mod noise;
pub mod terrain;
pub mod vehicle;
pub mod video;

use super::section::Section;
use crate::problem::{Problem, Vehicle};
use crate::tables::{Finding, Findings};

/// Name of the file.
pub const FILE: &str = "problem.toml";

/// What the sections say that name points of vehicles.
#[derive(Debug)]
pub struct OfPoints {
    distances: Vec<distance::Distance>,
}

impl OfPoints {
    /// Reads these sections.
    pub fn read(top: &Section) -> OfPoints {
        OfPoints { distances: top.tables("distance", distance::read).into_iter().flatten().collect() }
    }

    /// Joins them to the vehicles that they name; a vehicle that is never seen is left out, with what is known of it.
    pub fn join(&self, vehicles: &mut [Vehicle], findings: &mut Findings) {
        let mut error = |line: u64, key: &str, wanted: &str, found: &str| {
            findings.error(Finding::of_cell(FILE, line, key, wanted, found));
        };
        self.distances.iter().for_each(|distance| distance.join(vehicles, &mut error));
    }

    /// Writes them.
    pub fn write(text: &mut String, problem: &Problem) {
        distance::write(text, problem);
    }
}
