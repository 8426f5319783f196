//! `reference/<vehicle>.matrix.txt`: how a scan stands in the vehicle frame.
//!
//! Four rows of four numbers, `vehicle_from_scan`, as CloudCompare writes and reads a transformation:
//!
//! ```text
//! r11 r12 r13 x
//! r21 r22 r23 y
//! r31 r32 r33 z
//!   0   0   0 1
//! ```

use crate::disk;
use crate::geometry::Pose;
use crate::tables::{Finding, Findings};
use nalgebra::{Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use std::path::Path;

/// Rows and columns of a rotation are off unit length and right angles by no more.
const TOLERANCE: f64 = 1e-3;

/// Ends of the names of such files.
pub const END: &str = ".matrix.txt";

/// The matrix of each vehicle that has one.
pub fn read(problem_folder: &Path, vehicles: &[String], findings: &mut Findings) -> Vec<(String, Pose)> {
    let mut found = Vec::new();
    for vehicle in vehicles {
        let file = format!("reference/{vehicle}{END}");
        let path = problem_folder.join(&file);
        if std::fs::symlink_metadata(&path).is_err() {
            continue;
        }
        match disk::read_text(&path) {
            Ok(text) => found.extend(parse(&text, &file, findings).map(|pose| (vehicle.clone(), pose))),
            Err(error) => {
                findings.error(Finding::of_file(&file, "a text that can be read", &error.to_string()));
            }
        }
    }
    found
}

fn parse(text: &str, file: &str, findings: &mut Findings) -> Option<Pose> {
    let mut rows: Vec<[f64; 4]> = Vec::new();
    let lines = text.trim_start_matches('\u{feff}').lines().enumerate();
    for (at, line) in lines.filter(|(_, line)| !line.trim().is_empty()) {
        let is_apart = |c: char| c.is_whitespace() || c == ',' || c == ';';
        let cells: Vec<&str> = line.split(is_apart).filter(|cell| !cell.is_empty()).collect();
        let numbers: Vec<f64> =
            cells.iter().filter_map(|c| c.parse().ok()).filter(|v: &f64| v.is_finite()).collect();
        match <[f64; 4]>::try_from(numbers) {
            Ok(row) if cells.len() == 4 => rows.push(row),
            _ => {
                findings.error(Finding::of_line(file, at as u64 + 1, "four finite numbers", line.trim()));
                return None;
            }
        }
    }
    let wanted = "four rows of four numbers: a rotation without scale, a position, and 0 0 0 1 below";
    let [a, b, c, last] = rows[..] else {
        findings.error(Finding::of_file(file, wanted, &format!("{} rows", rows.len())));
        return None;
    };
    let turn = Matrix3::new(a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2]);
    let off = (turn * turn.transpose() - Matrix3::identity()).amax();
    if !(off <= TOLERANCE && turn.determinant() > 0.0) || last != [0.0, 0.0, 0.0, 1.0] {
        let found = format!(
            "determinant {:.6}, off right angles by {off:.2e}, last row {last:?}",
            turn.determinant()
        );
        findings.error(Finding::of_file(file, wanted, &found));
        return None;
    }
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix(&turn));
    Some(Pose::from_parts(Translation3::from(Vector3::new(a[3], b[3], c[3])), rotation))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    #[test]
    fn a_matrix_is_read() {
        let mut findings = Findings::default();
        let text = "0.000000 -1.000000 0.000000 500000.25\n1 0 0 3900000.5\r\n\n0,0,1,-2\n0 0 0 1\n";
        let pose = parse(text, "m", &mut findings).unwrap();
        let found = pose * Point3::new(1.0, 2.0, 3.0);
        assert!((found - Point3::new(499_998.25, 3_900_001.5, 1.0)).norm() < 1e-9);
        assert!(!findings.is_invalid());
    }

    #[test]
    fn what_is_no_rigid_motion_is_refused() {
        for (text, wanted) in [
            ("1 0 0 0\n0 1 0\n", "m:2: expected four finite numbers"),
            ("1 0 0 0\n0 one 0 0\n", "m:2: expected four finite numbers"),
            ("1 0 0 nan\n", "m:1: expected four finite numbers"),
            ("1 0 0 0\n0 1 0 0\n0 0 1 0\n", "m: expected four rows"),
            ("2 0 0 0\n0 2 0 0\n0 0 2 0\n0 0 0 1\n", "m: expected four rows"),
            ("1 0 0 0\n0 1 0 0\n0 0 -1 0\n0 0 0 1\n", "m: expected four rows"),
            ("1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 2\n", "m: expected four rows"),
            ("", "m: expected four rows"),
        ] {
            let mut findings = Findings::default();
            assert_eq!(parse(text, "m", &mut findings), None);
            let errors = findings.to_string();
            assert!(errors.starts_with(wanted), "{errors}");
        }
    }
}
