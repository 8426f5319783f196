//! PCD of the Point Cloud Library: ASCII, binary, compressed. A point that is not a number is a missing
//! one. The viewpoint is that of the sensor: points are not moved by it.

use super::{Cloud, Refusal};
use nalgebra::Point3;
use pcd_rs::{DataKind, DynReader, Field, PcdMeta};

/// Bytes that three compressed bytes make at the most, and so the most that one makes.
const MOST_FROM_A_BYTE: u128 = 264 / 3;

pub(super) fn read(bytes: &[u8]) -> Result<Cloud, Refusal> {
    let mut data = bytes;
    let meta = PcdMeta::from_reader(&mut data)?;
    let place = |axis| meta.field_defs.iter().position(|field| field.name == axis && field.count == 1);
    let mut axes = [0; 3];
    for (at, axis) in ["x", "y", "z"].into_iter().enumerate() {
        axes[at] = place(axis).ok_or_else(|| format!("no field {axis:?}"))?;
    }
    let values: u128 = meta.field_defs.iter().map(|field| u128::from(field.count)).sum();
    let size = meta.field_defs.iter().map(|f| u128::from(f.count).saturating_mul(f.kind.byte_size() as u128));
    let promised = size.sum::<u128>().saturating_mul(meta.num_points.into());
    let held = match meta.data {
        DataKind::Ascii => values.saturating_mul(meta.num_points.into()) <= data.len() as u128,
        DataKind::Binary => promised <= data.len() as u128,
        DataKind::BinaryCompressed => {
            let word = |at: usize| Some(u32::from_le_bytes(data.get(at..at + 4)?.try_into().ok()?));
            let packed = u128::from(word(0).ok_or("no size of the compressed data")?);
            let unpacked = u128::from(word(4).ok_or("no size of the compressed data")?);
            packed <= data.len() as u128 - 8 && unpacked <= packed * MOST_FROM_A_BYTE && unpacked == promised
        }
    };
    if !held {
        let found = format!("{} points, {} bytes of data", meta.num_points, data.len());
        return Err(found.into());
    }
    let mut cloud = Cloud::default();
    for (at, record) in DynReader::from_bytes(bytes)?.enumerate() {
        let fields = record.map_err(|error| format!("point {at}: {error}"))?.0;
        let coordinate = |axis: usize| fields.get(axes[axis]).and_then(number);
        match (coordinate(0), coordinate(1), coordinate(2)) {
            (Some(x), Some(y), Some(z)) if [x, y, z].iter().all(|v| v.is_finite()) => {
                cloud.points.push(Point3::new(x, y, z));
            }
            _ => cloud.skipped += 1,
        }
    }
    Ok(cloud)
}

/// The value of a field that has one.
fn number(field: &Field) -> Option<f64> {
    match field {
        Field::I8(values) => values.first().map(|v| (*v).into()),
        Field::I16(values) => values.first().map(|v| (*v).into()),
        Field::I32(values) => values.first().map(|v| (*v).into()),
        Field::I64(values) => values.first().map(|v| *v as f64),
        Field::U8(values) => values.first().map(|v| (*v).into()),
        Field::U16(values) => values.first().map(|v| (*v).into()),
        Field::U32(values) => values.first().map(|v| (*v).into()),
        Field::U64(values) => values.first().map(|v| *v as f64),
        Field::F32(values) => values.first().map(|v| (*v).into()),
        Field::F64(values) => values.first().copied(),
    }
}
