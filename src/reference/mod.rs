//! What a result is compared with, and never adjusted to: GNSS tracks and scans.
//!
//! Nothing on the way from a problem to its adjustment can open this room.

mod gnss;
mod scan;

use crate::tables::Findings;
pub use gnss::GnssPosition;
use nalgebra::Point3;
use std::path::Path;

/// The references of a problem.
#[derive(Clone, Debug, Default)]
pub struct Reference {
    /// Measured positions of each vehicle that has some, in time order.
    pub tracks: Vec<(String, Vec<GnssPosition>)>,
    /// The scan of each vehicle that has one, in its own frame \[m\].
    pub scans: Vec<(String, Vec<Point3<f64>>)>,
}

/// Reads and validates the folder `reference` of a problem with these vehicles.
pub fn read_reference(problem_folder: &Path, vehicles: &[String]) -> Result<Reference, Findings> {
    let mut findings = Findings::default();
    let tracks = gnss::read(problem_folder, vehicles, &mut findings);
    let scans = scan::read(problem_folder, vehicles, &mut findings);
    if findings.is_invalid() { Err(findings) } else { Ok(Reference { tracks, scans }) }
}
