//! `reference/gnss.csv`: where a receiver says a vehicle was.

use crate::tables::{self, Finding, Findings, Line, Sigma, input_row};
use nalgebra::{Point3, Vector3};
use std::path::Path;

/// The table.
pub const FILE: &str = "reference/gnss.csv";

input_row!(
    /// A row of the table.
    GnssRow {
        required vehicle: String, required time_s: f64,
        required x: f64, required y: f64, required z: f64,
        optional vx: Option<f64>, optional vy: Option<f64>, optional vz: Option<f64>,
        optional sigma_x: Sigma, optional sigma_y: Sigma, optional sigma_z: Sigma,
    }
);

/// A measured position.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GnssPosition {
    /// Time on the receiver's clock \[s\].
    pub time_s: f64,
    /// Position in the world \[m\].
    pub position: Point3<f64>,
    /// Velocity \[m/s\], where all of it was measured.
    pub velocity_mps: Option<Vector3<f64>>,
    /// Standard deviation per axis \[m\], where it is known.
    pub sigma_m: [Option<f64>; 3],
}

/// The track of each vehicle that has one.
pub fn read(
    problem_folder: &Path,
    vehicles: &[String],
    findings: &mut Findings,
) -> Vec<(String, Vec<GnssPosition>)> {
    if std::fs::symlink_metadata(problem_folder.join(FILE)).is_err() {
        return Vec::new();
    }
    let rows: Vec<Line<GnssRow>> = tables::read(problem_folder, FILE, findings).unwrap_or_default();
    let mut tracks: Vec<(String, Vec<GnssPosition>)> = Vec::new();
    for Line { line, row } in rows {
        if !vehicles.contains(&row.vehicle) {
            let wanted = "a vehicle of problem.toml";
            findings.error(Finding::of_cell(FILE, line, "vehicle", wanted, &row.vehicle));
            continue;
        }
        let position = GnssPosition {
            time_s: row.time_s,
            position: Point3::new(row.x, row.y, row.z),
            velocity_mps: (|| Some(Vector3::new(row.vx?, row.vy?, row.vz?)))(),
            sigma_m: [row.sigma_x.0, row.sigma_y.0, row.sigma_z.0],
        };
        let at = tracks.iter().position(|(id, _)| *id == row.vehicle).unwrap_or_else(|| {
            tracks.push((row.vehicle.clone(), Vec::new()));
            tracks.len() - 1
        });
        let track = &mut tracks[at].1;
        match track.last() {
            Some(last) if position.time_s <= last.time_s => {
                let wanted = format!("a time after {}", last.time_s);
                findings.error(Finding::of_cell(FILE, line, "time_s", &wanted, &row.time_s.to_string()));
            }
            _ => track.push(position),
        }
    }
    tracks
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tracks(text: &str) -> (Vec<(String, Vec<GnssPosition>)>, Vec<String>) {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join("reference")).unwrap();
        std::fs::write(folder.path().join(FILE), text).unwrap();
        let mut findings = Findings::default();
        let tracks = read(folder.path(), &["a".to_owned(), "b".to_owned()], &mut findings);
        (tracks, findings.errors().map(|f| f.to_string()).collect())
    }

    #[test]
    fn tracks_are_kept_apart() {
        let (tracks, errors) =
            tracks("vehicle,time_s,x,y,z,vx,vy,vz\na,1,1,2,3,,,\nb,0.5,4,5,6,1,0,0\na,2,1,2,3,,,\n");
        assert!(errors.is_empty());
        assert_eq!(
            tracks.iter().map(|(id, t)| (id.as_str(), t.len())).collect::<Vec<_>>(),
            [("a", 2), ("b", 1)]
        );
        assert_eq!(tracks[1].1[0].velocity_mps, Some(Vector3::x()));
        assert_eq!(tracks[0].1[0].velocity_mps, None);
    }

    #[test]
    fn what_is_wrong_is_named() {
        let (_, errors) = tracks("vehicle,time_s,x,y,z\na,1,1,2,3\na,1,1,2,3\nc,1,1,2,3\na,2,nan,2,3\n");
        assert_eq!(errors.len(), 3, "{errors:?}");
        assert!(errors[1].starts_with("reference/gnss.csv:3: column time_s: expected a time after 1"));
        assert!(errors[2].starts_with("reference/gnss.csv:4: column vehicle"));
    }
}
