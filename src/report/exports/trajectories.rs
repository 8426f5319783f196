//! What was compared as trajectories, row by row: TUM (`timestamp tx ty tz qx qy qz qw`) and KITTI (the upper
//! three rows of `world_from_body`, by rows). Numbers read back the same.
//!
//! Times are those of the reference's clock. The pose of the result is its place with the heading of its body,
//! level; the reference has no orientation, nor has a result without a heading: both have the identity.

use super::super::File;
use crate::evaluate::VehicleEvaluation;
use crate::evaluate::track::{Compared, TrackComparison};
use crate::geometry::Pose;
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};
use std::fmt::Write;

/// A pose and its time \[s\].
type Stamped = (f64, Pose);

/// The trajectories of a vehicle.
pub fn files(found: &VehicleEvaluation) -> [File; 4] {
    let VehicleEvaluation { vehicle, track, .. } = found;
    let [result, reference] = [of_result(track), of_reference(track)];
    [
        (format!("track_{vehicle}.tum"), tum(&result)),
        (format!("reference_{vehicle}.tum"), tum(&reference)),
        (format!("poses_{vehicle}.kitti"), kitti(&result)),
        (format!("reference_{vehicle}.kitti"), kitti(&reference)),
    ]
}

/// The result where it was compared.
pub fn of_result(track: &TrackComparison) -> Vec<Stamped> {
    let pose = |at: &Compared| {
        let heading_rad = at.heading_deg.map_or(0.0, f64::to_radians);
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), heading_rad);
        (at.time_s + track.clock_offset_s, at_place(&at.position, turn))
    };
    track.compared.iter().map(pose).collect()
}

/// The reference where the result was compared with it.
pub fn of_reference(track: &TrackComparison) -> Vec<Stamped> {
    let pose = |at: &Compared| (at.reference_time_s, at_place(&at.reference, UnitQuaternion::identity()));
    track.compared.iter().map(pose).collect()
}

fn at_place(place: &Point3<f64>, turn: UnitQuaternion<f64>) -> Pose {
    Pose::from_parts(Translation3::from(place.coords), turn)
}

/// As TUM.
pub fn tum(poses: &[Stamped]) -> Vec<u8> {
    let mut text = String::new();
    for (time_s, pose) in poses {
        let t = &pose.translation.vector;
        let q = &pose.rotation.coords;
        row(&mut text, &[*time_s, t.x, t.y, t.z, q.x, q.y, q.z, q.w]);
    }
    text.into_bytes()
}

/// As KITTI.
fn kitti(poses: &[Stamped]) -> Vec<u8> {
    let mut text = String::new();
    for (_, pose) in poses {
        let matrix = pose.to_homogeneous();
        let numbers: Vec<f64> = (0..12).map(|at| matrix[(at / 4, at % 4)]).collect();
        row(&mut text, &numbers);
    }
    text.into_bytes()
}

/// Numbers with a blank between, never "-0".
fn row(text: &mut String, numbers: &[f64]) {
    for (at, number) in numbers.iter().enumerate() {
        let blank = if at == 0 { "" } else { " " };
        write!(text, "{blank}{}", number + 0.0).expect("writing to memory");
    }
    text.push('\n');
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_those_of_the_formats() {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_2);
        let poses = [(0.1 + 0.2, at_place(&Point3::new(500_000.125, -2.0, -0.0), turn))];
        let numbers = |bytes: Vec<u8>| -> Vec<f64> {
            let text = String::from_utf8(bytes).unwrap();
            assert!(text.ends_with('\n') && !text.contains("-0 ") && text.lines().count() == 1, "{text:?}");
            text.trim_end().split(' ').map(|cell| cell.parse().unwrap()).collect()
        };
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let found = numbers(tum(&poses));
        assert_eq!(found[..6], [0.1 + 0.2, 500_000.125, -2.0, 0.0, 0.0, 0.0]);
        assert!((found[6] - half).abs() < 1e-15 && (found[7] - half).abs() < 1e-15 && found.len() == 8);
        let wanted = [0.0, -1.0, 0.0, 500_000.125, 1.0, 0.0, 0.0, -2.0, 0.0, 0.0, 1.0, 0.0];
        let found = numbers(kitti(&poses));
        assert_eq!(found.len(), 12);
        assert!(found.iter().zip(wanted).all(|(found, wanted)| (found - wanted).abs() < 1e-15), "{found:?}");
    }
}
