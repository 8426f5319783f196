//! The tables of a result folder, read back: `trajectories.csv`.

use super::rows::TrajectoryRow;
use crate::problem::Frame;
use crate::tables::{self, Finding, Findings, Line};
use nalgebra::Point3;
use std::collections::{BTreeMap, HashMap, HashSet};
use std::path::Path;

const FILE: &str = "trajectories.csv";

/// Times of a track and of its frames that differ by more are told \[s\].
const SAME_TIME_S: f64 = 1e-3;

/// A place of a track of a result.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TrackPosition {
    /// Number of the frame.
    pub frame: i64,
    /// Its time \[s\].
    pub time_s: f64,
    /// Position in the world \[m\].
    pub position: Point3<f64>,
    /// Horizontal speed \[m/s\], where there is one.
    pub speed_mps: Option<f64>,
    /// Heading of the body's x axis, counter-clockwise from the world's x axis \[deg\].
    pub heading_deg: Option<f64>,
    /// Standard deviation per axis \[m\]; `None` where it was not computed or nothing determines the axis.
    pub sigma_m: [Option<f64>; 3],
    /// Whether nothing determines the axis.
    pub is_open: [bool; 3],
    /// Covariance of x and y \[m^2\], likewise.
    pub covariance_xy_m2: Option<f64>,
    /// Standard deviation of the speed \[m/s\], likewise.
    pub sigma_speed_mps: Option<f64>,
    /// Standard deviation of the heading \[deg\], likewise.
    pub sigma_heading_deg: Option<f64>,
}

/// The tracks of a result folder.
#[derive(Clone, Debug, Default)]
pub struct ResultTracks {
    /// That of each vehicle that has one, in time order.
    pub tracks: Vec<(String, Vec<TrackPosition>)>,
    /// What is odd.
    pub warnings: Vec<String>,
}

/// Reads and validates the tracks of a result. `vehicles` and `frames` are those of its problem, as far as
/// they are known.
pub fn read_tracks(
    result_folder: &Path,
    vehicles: Option<&[String]>,
    frames: Option<&[Frame]>,
) -> Result<ResultTracks, Findings> {
    let mut findings = Findings::default();
    let rows: Vec<Line<TrajectoryRow>> = tables::read(result_folder, FILE, &mut findings).unwrap_or_default();
    let frame_times: Option<HashMap<i64, f64>> =
        frames.map(|frames| frames.iter().map(|frame| (frame.number, frame.time_s)).collect());
    let mut tracks: Vec<(String, Vec<TrackPosition>)> = Vec::new();
    let mut places: BTreeMap<String, usize> = BTreeMap::new();
    let mut seen = HashSet::new();
    let mut other_times = 0;
    for Line { line, row } in rows {
        let mut wrong = |column: &str, wanted: &str, found: &str| {
            findings.error(Finding::of_cell(FILE, line, column, wanted, found));
        };
        if vehicles.is_some_and(|vehicles| !vehicles.contains(&row.vehicle)) {
            wrong("vehicle", "a vehicle of problem.toml", &row.vehicle);
            continue;
        }
        if let Some(times) = &frame_times {
            match times.get(&row.frame) {
                Some(time_s) => other_times += usize::from((time_s - row.time_s).abs() > SAME_TIME_S),
                None => wrong("frame", "a frame of frames.csv", &row.frame.to_string()),
            }
        }
        if !seen.insert((row.vehicle.clone(), row.frame)) {
            wrong("frame", "a frame that is listed once for this vehicle", &row.frame.to_string());
            continue;
        }
        let at = *places.entry(row.vehicle.clone()).or_insert_with(|| {
            tracks.push((row.vehicle.clone(), Vec::new()));
            tracks.len() - 1
        });
        let track = &mut tracks[at].1;
        match track.last() {
            Some(TrackPosition { time_s: last, .. }) if row.time_s <= *last => {
                wrong("time_s", &format!("a time after {last}"), &row.time_s.to_string());
            }
            _ => track.push(TrackPosition {
                frame: row.frame,
                time_s: row.time_s,
                position: Point3::new(row.x, row.y, row.z),
                speed_mps: row.speed_mps,
                heading_deg: row.heading_deg,
                sigma_m: [row.sigma_x.known(), row.sigma_y.known(), row.sigma_z.known()],
                is_open: [row.sigma_x.is_open(), row.sigma_y.is_open(), row.sigma_z.is_open()],
                covariance_xy_m2: row.cov_xy,
                sigma_speed_mps: row.sigma_speed_mps.known(),
                sigma_heading_deg: row.sigma_heading_deg.known(),
            }),
        }
    }
    if other_times > 0 {
        findings.warn(format!(
            "{FILE}: rows whose time is not that of their frame in frames.csv: {other_times}; is this a result of \
             this problem?"
        ));
    }
    let warnings = findings.warnings().to_vec();
    if findings.is_invalid() { Err(findings) } else { Ok(ResultTracks { tracks, warnings }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEADER: &str = "vehicle,frame,time_s,x,y,z,speed_mps,heading_deg,sigma_x,sigma_y,sigma_z,cov_xy,\
                          sigma_speed_mps,sigma_heading_deg\n";

    fn tracks(rows: &str) -> Result<ResultTracks, Vec<String>> {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join(FILE), format!("{HEADER}{rows}")).unwrap();
        let frame = |k: i64| Frame { number: k, time_s: 0.1 * k as f64 };
        let frames: Vec<Frame> = (0..5).map(frame).collect();
        read_tracks(folder.path(), Some(&["a".to_owned(), "b".to_owned()]), Some(&frames))
            .map_err(|findings| findings.errors().map(|f| f.to_string()).collect())
    }

    #[test]
    fn tracks_are_read_with_what_is_not_known() {
        let found = tracks(
            "a,0,0,1,2,3,,90,0.1,0.2,inf,-0.001,0.3,inf\nb,0,0,1,2,3,4,90,,,,,,\na,1,0.1,2,2,3,5,90,,,,,,\n",
        )
        .unwrap();
        assert!(found.warnings.is_empty(), "{:?}", found.warnings);
        let of = |at: usize| (found.tracks[at].0.as_str(), found.tracks[at].1.len());
        assert_eq!([of(0), of(1)], [("a", 2), ("b", 1)]);
        let first = found.tracks[0].1[0];
        assert_eq!(first.sigma_m, [Some(0.1), Some(0.2), None]);
        assert_eq!(first.is_open, [false, false, true]);
        assert_eq!((first.covariance_xy_m2, first.speed_mps), (Some(-0.001), None));
        assert_eq!(
            (first.heading_deg, first.sigma_speed_mps, first.sigma_heading_deg),
            (Some(90.0), Some(0.3), None)
        );
        assert_eq!(found.tracks[0].1[1].speed_mps, Some(5.0));
    }

    #[test]
    fn everything_that_is_wrong_is_named() {
        let errors = tracks(
            "c,0,0,1,2,3,,90,,,,,,\na,9,0,1,2,3,,90,,,,,,\na,1,0.1,1,2,nan,,90,-1,,,,,\na,2,0,1,2,3,,90,,,,,,\n\
             a,2,0.2,1,2,3,,90,,,,,,\na,3,0.3,1,2\n",
        )
        .unwrap_err();
        let wanted = [
            "trajectories.csv:4: column z: expected a finite number, found \"nan\"",
            "trajectories.csv:4: column sigma_x: expected a number of at least 0, inf, or nothing, found \"-1\"",
            "trajectories.csv:7: expected 14 cells",
            "trajectories.csv:2: column vehicle: expected a vehicle of problem.toml, found \"c\"",
            "trajectories.csv:3: column frame: expected a frame of frames.csv, found \"9\"",
            "trajectories.csv:5: column time_s: expected a time after 0, found \"0\"",
            "trajectories.csv:6: column frame: expected a frame that is listed once",
        ];
        assert_eq!(errors.len(), wanted.len(), "{errors:#?}");
        for (found, wanted) in errors.iter().zip(wanted) {
            assert!(found.starts_with(wanted), "{found}");
        }
    }

    #[test]
    fn times_of_another_film_are_told() {
        let found = tracks("a,0,0.5,1,2,3,,90,,,,,,\na,1,0.6,1,2,3,,90,,,,,,\n").unwrap();
        assert!(found.warnings[0].contains("frames.csv: 2;"), "{:?}", found.warnings);
    }

    #[test]
    fn no_table_is_a_finding() {
        let folder = tempfile::tempdir().unwrap();
        let findings = read_tracks(folder.path(), None, None).unwrap_err();
        assert!(findings.to_string().starts_with("trajectories.csv: expected a table that can be read"));
    }
}
