//! `reference/<vehicle>.ply`: the points of a scan.

use crate::tables::{Finding, Findings};
use nalgebra::Point3;
use ply_rs_bw::parser::{Parser, Reader};
use ply_rs_bw::ply::{PropertyAccess, PropertyAccessResult};
use std::path::Path;

/// A vertex; a coordinate that the file does not give stays not a number.
#[derive(Debug)]
struct Vertex([f64; 3]);

impl PropertyAccess for Vertex {
    fn new() -> Self {
        Vertex([f64::NAN; 3])
    }

    fn set_float(&mut self, name: &str, value: f32) -> PropertyAccessResult {
        self.set_double(name, f64::from(value))
    }

    fn set_double(&mut self, name: &str, value: f64) -> PropertyAccessResult {
        match ["x", "y", "z"].iter().position(|axis| *axis == name) {
            Some(axis) => {
                self.0[axis] = value;
                PropertyAccessResult::Set
            }
            None => PropertyAccessResult::Ignored,
        }
    }
}

/// The scan of each vehicle that has one.
pub fn read(
    problem_folder: &Path,
    vehicles: &[String],
    findings: &mut Findings,
) -> Vec<(String, Vec<Point3<f64>>)> {
    let mut scans = Vec::new();
    for vehicle in vehicles {
        let file = format!("reference/{vehicle}.ply");
        let path = problem_folder.join(&file);
        if std::fs::symlink_metadata(&path).is_err() {
            continue;
        }
        match std::fs::read(&path).map_err(|e| e.to_string()).and_then(|bytes| parse(&bytes)) {
            Ok(points) => scans.push((vehicle.clone(), points)),
            Err(found) => findings.error(Finding::of_file(&file, "a PLY cloud with x, y, z", &found)),
        }
    }
    scans
}

fn parse(bytes: &[u8]) -> Result<Vec<Point3<f64>>, String> {
    let parser = Parser::<Vertex>::new();
    let mut reader = Reader::new(bytes);
    let header = parser.read_header(&mut reader).map_err(|e| e.to_string())?;
    let vertices = header.elements.get("vertex").ok_or("no element \"vertex\"")?;
    for axis in ["x", "y", "z"] {
        if !vertices.properties.contains_key(axis) {
            return Err(format!("no property {axis:?}"));
        }
    }
    // The header must not promise more than the file can hold: a byte a vertex at the least.
    for element in header.elements.values() {
        if element.count as u128 > bytes.len() as u128 {
            return Err(format!("{} elements {:?} in {} bytes", element.count, element.name, bytes.len()));
        }
    }
    let payload = parser.read_payload(&mut reader, &header).map_err(|e| e.to_string())?;
    let points = payload.get("vertex").map(Vec::as_slice).unwrap_or_default();
    if let Some(at) = points.iter().position(|Vertex(p)| !p.iter().all(|v| v.is_finite())) {
        return Err(format!("vertex {at} is {:?}", points[at].0));
    }
    Ok(points.iter().map(|Vertex(p)| Point3::from(*p)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    const CLOUD: &str = "ply\nformat ascii 1.0\ncomment c\nelement vertex 2\nproperty float x\nproperty float y\nproperty double z\nend_header\n1 2 3\n4 5 6.5\n";

    #[test]
    fn a_cloud_is_read() {
        let points = parse(CLOUD.as_bytes()).unwrap();
        assert_eq!(points, [Point3::new(1.0, 2.0, 3.0), Point3::new(4.0, 5.0, 6.5)]);
    }

    #[test]
    fn damaged_clouds_are_refused() {
        for damaged in [
            String::new(),
            "no cloud at all".to_owned(),
            CLOUD.replace("vertex 2", "vertex 3"),
            CLOUD.replace("vertex 2", "vertex 99999999999999999"),
            CLOUD.replace("property float x\n", ""),
            CLOUD.replace("4 5 6.5", "4 nan 6.5"),
            CLOUD.replace("4 5 6.5", "4 five 6.5"),
            CLOUD.replace("element vertex", "element face"),
            CLOUD[..CLOUD.len() - 8].to_owned(),
            CLOUD.replace("ascii", "binary_little_endian"),
        ] {
            assert!(parse(damaged.as_bytes()).is_err(), "{damaged}");
        }
    }
}
