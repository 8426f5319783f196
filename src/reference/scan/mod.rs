//! `reference/<vehicle>.ply`, `.las`, `.laz`, `.e57`, `.pcd` or `.xyz`: a scan of the vehicle.
//!
//! All readers give the points in the order of the file, in 64 bits. What a header promises is held
//! against the size of the file before anything is allocated for it.

#[cfg(feature = "scans")]
mod e57;
#[cfg(feature = "scans")]
mod las;
#[cfg(feature = "scans")]
mod pcd;
#[cfg(feature = "scans")]
mod ply;
#[cfg(all(test, feature = "scans"))]
mod tests;
#[cfg(not(feature = "scans"))]
mod without;
mod xyz;

use crate::disk;
use crate::tables::{Finding, Findings};
use nalgebra::Point3;
use std::path::Path;
#[cfg(not(feature = "scans"))]
use {without as e57, without as las, without as pcd, without as ply};

/// The points of a scan, and its surface where the file has one.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Scan {
    /// The file, relative to the problem folder.
    pub file: String,
    /// The points, in the order of the file \[m\].
    pub points: Vec<Point3<f64>>,
    /// Corners of the triangles of the surface, as indices of points; empty for a cloud.
    pub triangles: Vec<[u32; 3]>,
    /// Number of points that the file marks as without coordinates; they are not among the points.
    pub skipped: usize,
}

/// What stands in a file.
#[derive(Debug, Default)]
struct Cloud {
    points: Vec<Point3<f64>>,
    triangles: Vec<[u32; 3]>,
    skipped: usize,
}

/// Why a file is no scan.
#[derive(Debug)]
struct Refusal {
    line: Option<u64>,
    found: String,
}

impl<T: ToString> From<T> for Refusal {
    fn from(found: T) -> Self {
        Refusal { line: None, found: found.to_string() }
    }
}

type Read = fn(&[u8]) -> Result<Cloud, Refusal>;

/// Extensions, their readers, and what is expected of such a file.
const FORMATS: [(&str, Read, &str); 6] = [
    ("ply", ply::read, "a PLY cloud with x, y, z"),
    ("las", las::read, "a LAS cloud"),
    ("laz", las::read, "a LAZ cloud"),
    ("e57", e57::read, "an E57 cloud"),
    ("pcd", pcd::read, "a PCD cloud with x, y, z"),
    ("xyz", xyz::read, "rows that begin with x, y, z"),
];

/// The name without its extension, and the format that this is of.
fn format_of(name: &str) -> Option<(&str, &'static (&'static str, Read, &'static str))> {
    let (stem, extension) = name.rsplit_once('.')?;
    Some((stem, FORMATS.iter().find(|(known, ..)| extension.eq_ignore_ascii_case(known))?))
}

/// Whether a file of this name in `reference` is the scan of one of the vehicles.
pub(super) fn is_scan(name: &str, vehicles: &[String]) -> bool {
    format_of(name).is_some_and(|(stem, _)| vehicles.iter().any(|vehicle| vehicle == stem))
}

/// Reads a scan; its format is that of the extension, in capitals or not. Errors name the file as
/// `file`.
pub fn read_cloud(path: &Path, file: &str) -> Result<Scan, Finding> {
    let Some((_, (_, read, wanted))) = format_of(file) else {
        let known: Vec<String> = FORMATS.iter().map(|(extension, ..)| format!(".{extension}")).collect();
        return Err(Finding::of_file(file, &format!("a scan ({})", known.join(", ")), file));
    };
    let refused = |Refusal { line, found }| Finding { line, ..Finding::of_file(file, wanted, &found) };
    let bytes = disk::read(path).map_err(|e| refused(e.into()))?;
    let Cloud { points, triangles, skipped } = read(&bytes).map_err(refused)?;
    if points.is_empty() {
        let found = if skipped == 0 { "no point" } else { "no point that has coordinates" };
        return Err(refused(found.into()));
    }
    Ok(Scan { file: file.to_owned(), points, triangles, skipped })
}

/// The scan of each vehicle that has one.
pub(super) fn read(
    problem_folder: &Path,
    vehicles: &[String],
    findings: &mut Findings,
) -> Vec<(String, Scan)> {
    let folder = problem_folder.join("reference");
    let Ok(entries) = std::fs::read_dir(&folder) else { return Vec::new() };
    let name = |entry: std::fs::DirEntry| entry.file_name().to_string_lossy().into_owned();
    let mut names: Vec<String> = entries.flatten().map(name).collect();
    names.sort();
    let mut scans = Vec::new();
    for vehicle in vehicles {
        let of_vehicle = |name: &&String| format_of(name).is_some_and(|(stem, _)| stem == vehicle);
        let own: Vec<&str> = names.iter().filter(of_vehicle).map(String::as_str).collect();
        let name = match own[..] {
            [] => continue,
            [name] => name,
            [first, ..] => {
                let wanted = format!("one scan of {vehicle:?}");
                let finding = Finding::of_file(&format!("reference/{first}"), &wanted, &own.join(", "));
                findings.error(finding);
                continue;
            }
        };
        let file = format!("reference/{name}");
        match read_cloud(&folder.join(name), &file) {
            Ok(scan) => {
                if scan.skipped > 0 {
                    let (skipped, all) = (scan.skipped, scan.points.len() + scan.skipped);
                    findings.warn(format!("{file}: {skipped} of {all} points have no coordinates"));
                }
                scans.push((vehicle.clone(), scan));
            }
            Err(finding) => findings.error(finding),
        }
    }
    scans
}
