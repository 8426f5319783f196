//! The other tables of a result folder, read back: shapes, poses and the report.

use super::rows::{CameraPoseResultRow, VehiclePointResultRow, VehiclePoseResultRow};
use crate::disk;
use crate::geometry::Pose;
use crate::problem::Frame;
use crate::tables::{self, Finding, Findings, Line};
use nalgebra::{Point3, Quaternion, Translation3, UnitQuaternion};
use serde::de::DeserializeOwned;
use std::collections::{HashMap, HashSet};
use std::path::Path;

const POINTS: &str = "vehicle_points.csv";
const CAMERA_POSES: &str = "camera_poses.csv";
const VEHICLE_POSES: &str = "vehicle_poses.csv";
const REPORT: &str = "report.json";

/// A shape point of a result.
#[derive(Clone, Debug, PartialEq)]
pub struct ResultPoint {
    /// Its id.
    pub point: String,
    /// Its place in the vehicle frame \[m\].
    pub position: Point3<f64>,
    /// Standard deviation per axis \[m\]; `None` where it was not computed or nothing determines the axis.
    pub sigma_m: [Option<f64>; 3],
    /// Whether nothing determines the axis.
    pub is_open: [bool; 3],
}

/// The poses of a result, by index of the frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ResultPoses {
    /// `world_from_camera`.
    pub cameras: Vec<(usize, Pose)>,
    /// `world_from_vehicle` of each vehicle that has some, in the order of the frames.
    pub vehicles: Vec<(String, Vec<(usize, Pose)>)>,
}

/// Quaternions of a result are rounded, but not by more than this.
const UNIT: f64 = 1e-3;

/// Reads the shape of each vehicle; points without coordinates are left out. Without the table there are none.
pub fn read_points(
    folder: &Path,
    vehicles: Option<&[String]>,
    findings: &mut Findings,
) -> Vec<(String, Vec<ResultPoint>)> {
    let mut shapes: Vec<(String, Vec<ResultPoint>)> = Vec::new();
    if std::fs::symlink_metadata(folder.join(POINTS)).is_err() {
        return shapes;
    }
    let rows: Vec<Line<VehiclePointResultRow>> = tables::read(folder, POINTS, findings).unwrap_or_default();
    let mut seen = HashSet::new();
    for Line { line, row } in rows {
        if vehicles.is_some_and(|vehicles| !vehicles.contains(&row.vehicle)) {
            let wanted = "a vehicle of problem.toml";
            findings.error(Finding::of_cell(POINTS, line, "vehicle", wanted, &row.vehicle));
            continue;
        }
        if !seen.insert((row.vehicle.clone(), row.point.clone())) {
            let wanted = "a point that is listed once for this vehicle";
            findings.error(Finding::of_cell(POINTS, line, "point", wanted, &row.point));
            continue;
        }
        let (Some(x), Some(y), Some(z)) = (row.x, row.y, row.z) else { continue };
        let point = ResultPoint {
            point: row.point,
            position: Point3::new(x, y, z),
            sigma_m: [row.sigma_x.known(), row.sigma_y.known(), row.sigma_z.known()],
            is_open: [row.sigma_x.is_open(), row.sigma_y.is_open(), row.sigma_z.is_open()],
        };
        match shapes.iter_mut().find(|(id, _)| *id == row.vehicle) {
            Some((_, points)) => points.push(point),
            None => shapes.push((row.vehicle, vec![point])),
        }
    }
    shapes
}

/// Reads the poses of cameras and vehicles. `frames` and `vehicles` are those of the problem.
pub fn read_poses(
    folder: &Path,
    frames: &[Frame],
    vehicles: &[String],
    findings: &mut Findings,
) -> ResultPoses {
    let index: HashMap<i64, usize> =
        frames.iter().enumerate().map(|(at, frame)| (frame.number, at)).collect();
    let mut poses = ResultPoses::default();
    let mut seen = HashSet::new();
    let cameras: Vec<Line<CameraPoseResultRow>> =
        tables::read(folder, CAMERA_POSES, findings).unwrap_or_default();
    for Line { line, row } in cameras {
        let numbers = [row.x, row.y, row.z, row.qw, row.qx, row.qy, row.qz];
        let place = Place { file: CAMERA_POSES, line, frame: row.frame };
        if let Some((frame, pose)) = place.pose(&index, numbers, seen.insert((None, row.frame)), findings) {
            poses.cameras.push((frame, pose));
        }
    }
    let rows: Vec<Line<VehiclePoseResultRow>> =
        tables::read(folder, VEHICLE_POSES, findings).unwrap_or_default();
    for Line { line, row } in rows {
        if !vehicles.contains(&row.vehicle) {
            let wanted = "a vehicle of problem.toml";
            findings.error(Finding::of_cell(VEHICLE_POSES, line, "vehicle", wanted, &row.vehicle));
            continue;
        }
        let numbers = [row.x, row.y, row.z, row.qw, row.qx, row.qy, row.qz];
        let place = Place { file: VEHICLE_POSES, line, frame: row.frame };
        let is_new = seen.insert((Some(row.vehicle.clone()), row.frame));
        let Some(found) = place.pose(&index, numbers, is_new, findings) else { continue };
        match poses.vehicles.iter_mut().find(|(id, _)| *id == row.vehicle) {
            Some((_, poses)) => poses.push(found),
            None => poses.vehicles.push((row.vehicle, vec![found])),
        }
    }
    poses.cameras.sort_by_key(|(frame, _)| *frame);
    poses.vehicles.iter_mut().for_each(|(_, poses)| poses.sort_by_key(|(frame, _)| *frame));
    poses
}

/// Where a pose stands in its table.
struct Place {
    file: &'static str,
    line: u64,
    frame: i64,
}

impl Place {
    fn pose(
        &self,
        index: &HashMap<i64, usize>,
        [x, y, z, qw, qx, qy, qz]: [f64; 7],
        is_new: bool,
        findings: &mut Findings,
    ) -> Option<(usize, Pose)> {
        let Place { file, line, frame } = *self;
        let mut wrong = |column: &str, wanted: &str, found: &str| {
            findings.error(Finding::of_cell(file, line, column, wanted, found));
        };
        let Some(at) = index.get(&frame) else {
            wrong("frame", "a frame of frames.csv", &frame.to_string());
            return None;
        };
        if !is_new {
            wrong("frame", "a frame that is listed once", &frame.to_string());
            return None;
        }
        let quaternion = Quaternion::new(qw, qx, qy, qz);
        if (quaternion.norm() - 1.0).abs() > UNIT {
            wrong("qw", "a unit quaternion", &format!("one of length {}", quaternion.norm()));
            return None;
        }
        let rotation = UnitQuaternion::from_quaternion(quaternion);
        Some((*at, Pose::from_parts(Translation3::new(x, y, z), rotation)))
    }
}

/// Reads `report.json` as whatever a room above knows it as; `None` without it.
pub fn read_report<T: DeserializeOwned>(folder: &Path, findings: &mut Findings) -> Option<T> {
    let text = disk::read(&folder.join(REPORT)).ok()?;
    match serde_json::from_slice(&text) {
        Ok(report) => Some(report),
        Err(error) => {
            findings.error(Finding::of_file(REPORT, "JSON", &error.to_string()));
            None
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder(files: &[(&str, &str)]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        files.iter().for_each(|(name, text)| std::fs::write(folder.path().join(name), text).unwrap());
        folder
    }

    #[test]
    fn shapes_are_read_with_what_is_not_known() {
        let text = "vehicle,point,x,y,z,sigma_x,sigma_y,sigma_z,observations,inliers,rms_px\n\
                    a,1,1,2,3,0.1,inf,,5,4,0.5\na,2,,,,,,,1,0,\nb,1,4,5,6,,,,5,4,0.5\n";
        let mut findings = Findings::default();
        let shapes = read_points(folder(&[(POINTS, text)]).path(), None, &mut findings);
        assert!(!findings.is_invalid());
        let ids: Vec<_> = shapes.iter().map(|(id, points)| (id.as_str(), points.len())).collect();
        assert_eq!(ids, [("a", 1), ("b", 1)]);
        assert_eq!(shapes[0].1[0].sigma_m, [Some(0.1), None, None]);
        assert_eq!(shapes[0].1[0].is_open, [false, true, false]);
    }

    fn poses(cameras: &str, vehicles: &str) -> Result<ResultPoses, Vec<String>> {
        let header = "x,y,z,qw,qx,qy,qz\n";
        let cameras = format!("frame,{header}{cameras}");
        let vehicles = format!("frame,vehicle,{header}{vehicles}");
        let folder = folder(&[(CAMERA_POSES, &cameras), (VEHICLE_POSES, &vehicles)]);
        let frames = [Frame { number: 5, time_s: 0.0 }, Frame { number: 7, time_s: 0.1 }];
        let mut findings = Findings::default();
        let poses = read_poses(folder.path(), &frames, &["a".to_owned()], &mut findings);
        match findings.is_invalid() {
            true => Err(findings.errors().map(|f| f.to_string()).collect()),
            false => Ok(poses),
        }
    }

    #[test]
    fn poses_are_read_by_their_frames() {
        let found = poses("7,1,2,3,0,1,0,0\n5,4,5,6,1,0,0,0\n", "7,a,7,8,9,1,0,0,0\n").unwrap();
        let places: Vec<_> = found.cameras.iter().map(|(at, pose)| (*at, pose.translation.z)).collect();
        assert_eq!(places, [(0, 6.0), (1, 3.0)]);
        let (id, of_vehicle) = &found.vehicles[0];
        assert_eq!((id.as_str(), of_vehicle[0].0, of_vehicle[0].1.translation.y), ("a", 1, 8.0));
    }

    #[test]
    fn what_is_wrong_with_poses_is_named() {
        let errors = poses(
            "6,0,0,0,1,0,0,0\n5,0,0,0,1,0,0,0\n5,0,0,0,1,0,0,0\n7,0,0,0,0,0,0,2\n",
            "7,b,7,8,9,1,0,0,0\n",
        )
        .unwrap_err();
        let wanted = [
            "camera_poses.csv:2: column frame: expected a frame of frames.csv, found \"6\"",
            "camera_poses.csv:4: column frame: expected a frame that is listed once",
            "camera_poses.csv:5: column qw: expected a unit quaternion, found \"one of length 2\"",
            "vehicle_poses.csv:2: column vehicle: expected a vehicle of problem.toml, found \"b\"",
        ];
        assert_eq!(errors.len(), wanted.len(), "{errors:#?}");
        for (found, wanted) in errors.iter().zip(wanted) {
            assert!(found.starts_with(wanted), "{found}");
        }
    }

    #[test]
    fn what_is_wrong_is_named() {
        let points =
            "vehicle,point,x,y,z,sigma_x,sigma_y,sigma_z\na,1,1,2,3,,,\na,1,1,2,3,,,\nc,1,1,2,3,,,\n";
        let folder = folder(&[(POINTS, points), (REPORT, "{")]);
        let mut findings = Findings::default();
        read_points(folder.path(), Some(&["a".to_owned()]), &mut findings);
        read_report::<serde_json::Value>(folder.path(), &mut findings);
        let errors: Vec<String> = findings.errors().map(|f| f.to_string()).collect();
        for (found, wanted) in errors.iter().zip([
            "vehicle_points.csv:3: column point: expected a point that is listed once",
            "vehicle_points.csv:4: column vehicle: expected a vehicle of problem.toml",
            "report.json: expected JSON",
        ]) {
            assert!(found.starts_with(wanted), "{found}");
        }
        assert_eq!(errors.len(), 3);
    }
}
