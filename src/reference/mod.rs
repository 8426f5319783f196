//! What a result is compared with, and never adjusted to: GNSS tracks and scans.
//!
//! Nothing on the way from a problem to its adjustment can open this room.

mod gnss;
mod matrix;
mod scan;
mod truth;

use crate::geometry::Pose;
use crate::tables::Findings;
pub use gnss::GnssPosition;
pub use scan::{Scan, read_cloud};
use std::path::Path;
pub use truth::{TrueShape, read as read_true_shapes};

/// The references of a problem.
#[derive(Clone, Debug, Default)]
pub struct Reference {
    /// Measured positions of each vehicle that has some, in time order.
    pub tracks: Vec<(String, Vec<GnssPosition>)>,
    /// The scan of each vehicle that has one, in the frame of its file.
    pub scans: Vec<(String, Scan)>,
    /// `vehicle_from_scan` of each vehicle that has such a file.
    pub matrices: Vec<(String, Pose)>,
    /// What is odd.
    pub warnings: Vec<String>,
}

fn warn_of_files_not_read(problem_folder: &Path, vehicles: &[String], findings: &mut Findings) {
    let Ok(entries) = std::fs::read_dir(problem_folder.join("reference")) else { return };
    let is_read = |name: &str| {
        name == "gnss.csv"
            || scan::is_scan(name, vehicles)
            || vehicles.iter().any(|id| name.strip_suffix(matrix::END) == Some(id))
    };
    let name = |entry: std::fs::DirEntry| entry.file_name().to_string_lossy().into_owned();
    let mut names: Vec<String> = entries.flatten().map(name).filter(|name| !is_read(name)).collect();
    names.sort();
    if !names.is_empty() {
        findings.warn(format!(
            "reference: not read (neither gnss.csv nor a scan or track of a vehicle of problem.toml): {}",
            names.join(", ")
        ));
    }
}

/// Reads and validates the folder `reference` of a problem with these vehicles.
pub fn read_reference(problem_folder: &Path, vehicles: &[String]) -> Result<Reference, Findings> {
    let mut findings = Findings::default();
    let tracks = gnss::read(problem_folder, vehicles, &mut findings);
    let scans = scan::read(problem_folder, vehicles, &mut findings);
    let matrices = matrix::read(problem_folder, vehicles, &mut findings);
    warn_of_files_not_read(problem_folder, vehicles, &mut findings);
    let warnings = findings.warnings().to_vec();
    if findings.is_invalid() {
        return Err(findings);
    }
    Ok(Reference { tracks, scans, matrices, warnings })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_that_are_not_read_are_named() {
        let place = tempfile::tempdir().unwrap();
        let folder = place.path().join("reference");
        std::fs::create_dir(&folder).unwrap();
        for name in ["car1.txt", "car1.pos", "ghost.matrix.txt", "ghost.ply"] {
            std::fs::write(folder.join(name), "x").unwrap();
        }
        let gnss = "vehicle,time_s,x,y,z,antenna\ncar1,0,1,2,3,a\n";
        std::fs::write(folder.join("gnss.csv"), gnss).unwrap();
        let reference = read_reference(place.path(), &["car1".to_owned()]).unwrap();
        assert_eq!(reference.warnings.len(), 2, "{:?}", reference.warnings);
        assert!(reference.warnings[0].contains("antenna"));
        assert!(reference.warnings[1].ends_with(": car1.pos, car1.txt, ghost.matrix.txt, ghost.ply"));
    }
}
