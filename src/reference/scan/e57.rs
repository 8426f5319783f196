//! E57: one or more clouds, each with its pose.

use super::{Cloud, Refusal};
use e57::{CartesianCoordinate, E57Reader, PointCloud, RecordDataType};
use nalgebra::Point3;
use std::io::Cursor;

pub(super) fn read(bytes: &[u8]) -> Result<Cloud, Refusal> {
    let mut reader = E57Reader::new(Cursor::new(bytes))?;
    let mut cloud = Cloud::default();
    for (at, part) in reader.pointclouds().iter().enumerate() {
        check(part, bytes.len()).map_err(|found| format!("cloud {at}: {found}"))?;
        let mut points = reader.pointcloud_simple(part)?;
        points.apply_pose(true);
        points.spherical_to_cartesian(true);
        for point in points {
            match point?.cartesian {
                CartesianCoordinate::Valid { x, y, z } if [x, y, z].iter().all(|v| v.is_finite()) => {
                    cloud.points.push(Point3::new(x, y, z));
                }
                CartesianCoordinate::Valid { x, y, z } => {
                    let index = cloud.points.len() + cloud.skipped;
                    return Err(format!("point {index} is {:?}", [x, y, z]).into());
                }
                CartesianCoordinate::Direction { .. } | CartesianCoordinate::Invalid => cloud.skipped += 1,
            }
        }
    }
    Ok(cloud)
}

/// Whether a file of this size can hold the cloud, and its pose is one.
fn check(part: &PointCloud, size: usize) -> Result<(), String> {
    // A value that is always the same takes no bits, but a point of no bits could not be counted.
    let bits = |kind: &RecordDataType| match kind {
        RecordDataType::Single { .. } => 32,
        RecordDataType::Double { .. } => 64,
        RecordDataType::ScaledInteger { min, max, .. } | RecordDataType::Integer { min, max } => {
            (i128::from(*max) - i128::from(*min)).max(0).checked_ilog2().map_or(0, |bits| bits + 1)
        }
    };
    let of_point: u32 = part.prototype.iter().map(|record| bits(&record.data_type)).sum();
    if of_point == 0 || u128::from(part.records) * u128::from(of_point) > 8 * size as u128 {
        return Err(format!("{} points of {of_point} bits in {size} bytes", part.records));
    }
    if let Some(pose) = &part.transform {
        let (q, t) = (&pose.rotation, &pose.translation);
        let length = (q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z).sqrt();
        if !((length - 1.0).abs() < 1e-3 && [t.x, t.y, t.z].iter().all(|v| v.is_finite())) {
            return Err(format!("a pose with the rotation {:?}", [q.w, q.x, q.y, q.z]));
        }
    }
    Ok(())
}
