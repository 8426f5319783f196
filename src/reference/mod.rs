//! What a result is compared with, and never adjusted to: GNSS tracks and scans.
//!
//! Nothing on the way from a problem to its adjustment can open this room.

mod gnss;
mod quality;
mod scan;

use crate::tables::Findings;
pub use gnss::GnssPosition;
use nalgebra::Point3;
pub use quality::{QUALITIES, Quality};
use std::path::Path;

/// The file with a table of tracks.
const TABLE: &str = "reference/gnss.csv";

/// The references of a problem.
#[derive(Clone, Debug, Default)]
pub struct Reference {
    /// Measured positions of each vehicle that has some, in time order.
    pub tracks: Vec<(String, Vec<GnssPosition>)>,
    /// The file that each of these tracks is from, in the same order.
    pub sources: Vec<TrackSource>,
    /// The scan of each vehicle that has one, in its own frame \[m\].
    pub scans: Vec<(String, Vec<Point3<f64>>)>,
    /// What is odd.
    pub warnings: Vec<String>,
}

/// Where a track is from.
#[derive(Clone, Debug, PartialEq)]
pub struct TrackSource {
    /// The vehicle.
    pub vehicle: String,
    /// The file, relative to the problem folder.
    pub file: String,
    /// Its positions by their quality, best first, where it is told: how many there are, whether they are taken.
    pub qualities: Vec<(Quality, usize, bool)>,
}

impl Reference {
    /// The file that the track of a vehicle is from, or would be.
    pub fn file_of(&self, vehicle: &str) -> &str {
        self.sources.iter().find(|source| source.vehicle == vehicle).map_or(TABLE, |source| &source.file)
    }
}

fn warn_of_files_not_read(problem_folder: &Path, vehicles: &[String], findings: &mut Findings) {
    let Ok(entries) = std::fs::read_dir(problem_folder.join("reference")) else { return };
    let is_read = |name: &str| {
        name == "gnss.csv" || name.strip_suffix(".ply").is_some_and(|id| vehicles.iter().any(|v| v == id))
    };
    let name = |entry: std::fs::DirEntry| entry.file_name().to_string_lossy().into_owned();
    let mut names: Vec<String> = entries.flatten().map(name).filter(|name| !is_read(name)).collect();
    names.sort();
    if !names.is_empty() {
        findings.warn(format!(
            "reference: not read (neither gnss.csv nor the .ply of a vehicle of problem.toml): {}",
            names.join(", ")
        ));
    }
}

/// Reads and validates the folder `reference` of a problem with these vehicles.
pub fn read_reference(problem_folder: &Path, vehicles: &[String]) -> Result<Reference, Findings> {
    let mut findings = Findings::default();
    let tracks = gnss::read(problem_folder, vehicles, &mut findings);
    let source = |(vehicle, _): &(String, _)| TrackSource {
        vehicle: vehicle.clone(),
        file: TABLE.to_owned(),
        qualities: Vec::new(),
    };
    let sources = tracks.iter().map(source).collect();
    let scans = scan::read(problem_folder, vehicles, &mut findings);
    warn_of_files_not_read(problem_folder, vehicles, &mut findings);
    let warnings = findings.warnings().to_vec();
    if findings.is_invalid() { Err(findings) } else { Ok(Reference { tracks, sources, scans, warnings }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_that_are_not_read_are_named() {
        let place = tempfile::tempdir().unwrap();
        let folder = place.path().join("reference");
        std::fs::create_dir(&folder).unwrap();
        for name in ["car1.xyz", "ghost.ply"] {
            std::fs::write(folder.join(name), "x").unwrap();
        }
        let gnss = "vehicle,time_s,x,y,z,antenna\ncar1,0,1,2,3,a\n";
        std::fs::write(folder.join("gnss.csv"), gnss).unwrap();
        let reference = read_reference(place.path(), &["car1".to_owned()]).unwrap();
        assert_eq!(reference.warnings.len(), 2, "{:?}", reference.warnings);
        assert!(reference.warnings[0].contains("antenna"));
        assert!(reference.warnings[1].ends_with("car1.xyz, ghost.ply"));
    }
}
