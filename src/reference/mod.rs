//! What a result is compared with, and never adjusted to: GNSS tracks and scans.
//!
//! Nothing on the way from a problem to its adjustment can open this room.

mod gnss;
mod matrix;
mod receiver;
mod scan;
mod truth;

use crate::geometry::Pose;
use crate::tables::{Finding, Findings};
pub use gnss::GnssPosition;
pub use receiver::World;
pub use scan::{Scan, read_cloud};
use std::io::ErrorKind;
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
    /// Where the world is on the Earth, if `reference/reference.toml` says so.
    pub world: Option<World>,
    /// What is odd.
    pub warnings: Vec<String>,
}

fn warn_of_files_not_read(problem_folder: &Path, vehicles: &[String], findings: &mut Findings) {
    let entries = match std::fs::read_dir(problem_folder.join("reference")) {
        Ok(entries) => entries,
        Err(error) if error.kind() == ErrorKind::NotFound => return,
        Err(error) => {
            return findings.error(Finding::of_file(
                "reference",
                "a folder that can be read",
                &error.to_string(),
            ));
        }
    };
    let is_read = |name: &str| {
        [gnss::FILE, receiver::SETTING_FILE].contains(&format!("reference/{name}").as_str())
            || receiver::is_track(name, vehicles)
            || scan::is_scan(name, vehicles)
            || vehicles.iter().any(|id| name.strip_suffix(matrix::END) == Some(id))
    };
    let name = |entry: std::fs::DirEntry| entry.file_name().to_string_lossy().into_owned();
    let mut names: Vec<String> = entries.flatten().map(name).filter(|name| !is_read(name)).collect();
    names.sort();
    if !names.is_empty() {
        findings.warn(format!(
            "reference: not read (neither a scan nor a track of a vehicle of problem.toml): {}",
            names.join(", ")
        ));
    }
}

/// The track of each vehicle that has one; two for one vehicle are refused. And where the world is.
fn read_tracks(
    problem_folder: &Path,
    vehicles: &[String],
    findings: &mut Findings,
) -> (Vec<(String, Vec<GnssPosition>)>, Option<World>) {
    let mut tracks = gnss::read(problem_folder, vehicles, findings);
    let mut files: Vec<(String, String)> =
        tracks.iter().map(|(vehicle, _)| (vehicle.clone(), gnss::FILE.to_owned())).collect();
    let received = receiver::read(problem_folder, vehicles, findings);
    for (vehicle, file, track) in received.tracks {
        match files.iter().find(|(id, _)| *id == vehicle) {
            Some((_, other)) => {
                let wanted = format!("one track of {vehicle}");
                findings.error(Finding::of_file(&file, &wanted, &format!("another one in {other}")));
            }
            None => {
                files.push((vehicle.clone(), file));
                tracks.push((vehicle, track));
            }
        }
    }
    (tracks, received.world)
}

/// Reads and validates the folder `reference` of a problem with these vehicles.
pub fn read_reference(problem_folder: &Path, vehicles: &[String]) -> Result<Reference, Findings> {
    let mut findings = Findings::default();
    let (tracks, world) = read_tracks(problem_folder, vehicles, &mut findings);
    let scans = scan::read(problem_folder, vehicles, &mut findings);
    let matrices = matrix::read(problem_folder, vehicles, &mut findings);
    warn_of_files_not_read(problem_folder, vehicles, &mut findings);
    let warnings = findings.warnings().to_vec();
    if findings.is_invalid() {
        return Err(findings);
    }
    Ok(Reference { tracks, scans, matrices, world, warnings })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_that_are_not_read_are_named() {
        let place = tempfile::tempdir().unwrap();
        let folder = place.path().join("reference");
        std::fs::create_dir(&folder).unwrap();
        for name in ["car1.txt", "ghost.pos", "ghost.matrix.txt", "ghost.ply"] {
            std::fs::write(folder.join(name), "x").unwrap();
        }
        let gnss = "vehicle,time_s,x,y,z,antenna\ncar1,0,1,2,3,a\n";
        std::fs::write(folder.join("gnss.csv"), gnss).unwrap();
        let reference = read_reference(place.path(), &["car1".to_owned()]).unwrap();
        assert_eq!(reference.warnings.len(), 2, "{:?}", reference.warnings);
        assert!(reference.warnings[0].contains("antenna"));
        assert!(reference.warnings[1].ends_with(": car1.txt, ghost.matrix.txt, ghost.ply, ghost.pos"));
    }

    #[test]
    fn the_world_is_known_without_a_track() {
        let place = tempfile::tempdir().unwrap();
        let folder = place.path().join("reference");
        std::fs::create_dir(&folder).unwrap();
        let read = || read_reference(place.path(), &["a".to_owned()]).unwrap();
        assert!(read().world.is_none());
        let text =
            "[world]\nutm_zone = 32\nhemisphere = \"north\"\nshift_x_m = 500000\nshift_y_m = 5000000\n";
        std::fs::write(folder.join("reference.toml"), text).unwrap();
        let Reference { tracks, world, warnings, .. } = read();
        assert_eq!((tracks.len(), warnings.len()), (0, 0));
        // On the meridian of the zone.
        let [latitude, longitude] = world.unwrap().geodetic_deg(nalgebra::Point3::origin()).unwrap();
        assert!((longitude - 9.0).abs() < 1e-9 && (45.0..45.3).contains(&latitude), "{latitude} {longitude}");
    }

    #[test]
    fn a_vehicle_has_one_track() {
        let place = tempfile::tempdir().unwrap();
        let folder = place.path().join("reference");
        std::fs::create_dir(&folder).unwrap();
        let write = |name: &str, text: &str| std::fs::write(folder.join(name), text).unwrap();
        write("b.tum", "0 1 2 3 0 0 0 1\n");
        write("gnss.csv", "vehicle,time_s,x,y,z\na,0,1,2,3\n");
        let vehicles = ["a".to_owned(), "b".to_owned()];
        let found = read_reference(place.path(), &vehicles).unwrap();
        assert_eq!(found.tracks.iter().map(|(id, _)| id.as_str()).collect::<Vec<_>>(), ["a", "b"]);
        write("a.tum", "0 1 2 3 0 0 0 1\n");
        let told = read_reference(place.path(), &vehicles).unwrap_err().to_string();
        assert_eq!(
            told,
            "reference/a.tum: expected one track of a, found \"another one in reference/gnss.csv\"\n"
        );
    }
}
