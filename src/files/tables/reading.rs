//! What all tables of a problem folder are read and checked with.

use super::super::problem_toml::Settings;
use crate::disk::Inputs;
use crate::geometry::{self, Pose};
use crate::problem::Known;
use crate::tables::{self, Finding, Findings, Line, Row};
use nalgebra::{Vector2, Vector4};
use std::collections::HashMap;

/// A quaternion may be off unit length by this much.
const UNIT_TOLERANCE: f64 = 1e-6;
/// An image point of standard deviation zero is taken as this good \[px\]: nothing measured is exact.
const LEAST_SIGMA_PX: f64 = 1e-3;

/// Where each id stands.
pub fn positions<'a>(ids: &[&'a str]) -> HashMap<&'a str, usize> {
    ids.iter().enumerate().map(|(at, id)| (*id, at)).collect()
}

/// A problem folder and what was found wrong with it.
pub struct Reader<'a> {
    pub inputs: Inputs<'a>,
    pub findings: Findings,
}

/// The rows of a table as they stand; `None` where the file is not there or is no table.
pub type Rows<R> = Option<Vec<Line<R>>>;

impl Reader<'_> {
    /// Reads a table that must be there.
    pub fn read<R: Row>(&mut self, file: &str) -> Rows<R> {
        tables::table_of(self.inputs.read(file), file, &mut self.findings)
    }

    /// Whether a file is there.
    pub fn is_there(&self, file: &str) -> bool {
        std::fs::symlink_metadata(self.inputs.folder().join(file)).is_ok()
    }

    /// Reads a table that may be there.
    pub fn read_if_there<R: Row>(&mut self, file: &str) -> Rows<R> {
        if self.is_there(file) { self.read(file) } else { None }
    }

    /// A cell that does not hold what is wanted.
    pub fn cell(&mut self, file: &str, line: u64, column: &str, wanted: &str, found: impl ToString) {
        self.findings.error(Finding::of_cell(file, line, column, wanted, &found.to_string()));
    }

    /// Index of a declared frame.
    pub fn frame(&mut self, file: &str, line: u64, frame: i64, index: &Index) -> Option<usize> {
        let found = index.frames.get(&frame).copied();
        if found.is_none() && !index.frames.is_empty() {
            self.cell(file, line, "frame", "a frame of frames.csv", frame);
        }
        found
    }

    /// Index of a declared vehicle.
    pub fn vehicle(&mut self, file: &str, line: u64, id: &str, index: &Index) -> Option<usize> {
        let vehicles = index.vehicles.as_ref()?;
        let found = vehicles.get(id).copied();
        if found.is_none() {
            self.cell(file, line, "vehicle", "a vehicle of problem.toml", id);
        }
        found
    }

    /// A pose whose quaternion is one of length 1.
    pub fn pose(&mut self, file: &str, line: u64, position: [f64; 3], quaternion: [f64; 4]) -> Pose {
        let norm = Vector4::from(quaternion).norm();
        if (norm - 1.0).abs() > UNIT_TOLERANCE {
            self.cell(file, line, "qw,qx,qy,qz", "a quaternion of length 1", format!("length {norm}"));
        }
        geometry::pose(position, quaternion)
    }
}

/// Where declared ids stand.
pub struct Index<'a> {
    pub frames: HashMap<i64, usize>,
    /// `None` where problem.toml could not be read, so that nothing can be said.
    pub vehicles: Option<HashMap<&'a str, usize>>,
}

/// What is known of three coordinates; those without a standard deviation are counted and have the usual one.
pub fn known(
    coordinates: [Option<f64>; 3],
    sigmas: [Option<f64>; 3],
    default_m: f64,
    without: &mut usize,
) -> [Option<Known>; 3] {
    std::array::from_fn(|axis| {
        let value_m = coordinates[axis]?;
        if sigmas[axis].is_none() {
            *without += 1;
        }
        Some(Known { value_m, sigma_m: sigmas[axis].unwrap_or(default_m) })
    })
}

/// Image points of a table: their standard deviation, and what is odd about them.
pub struct Pixels<'a> {
    file: &'a str,
    settings: Option<&'a Settings>,
    default_px: f64,
    outside: Tally,
    without_ray: Tally,
    exact: Tally,
}

/// How many, and the line of the first.
#[derive(Default)]
struct Tally {
    count: usize,
    first_line: u64,
}

impl Tally {
    fn count(&mut self, line: u64) {
        if self.count == 0 {
            self.first_line = line;
        }
        self.count += 1;
    }
}

impl<'a> Pixels<'a> {
    pub fn new(file: &'a str, settings: Option<&'a Settings>, default: impl Fn(&Settings) -> f64) -> Self {
        let default_px = settings.map_or(1.0, default);
        let [outside, without_ray, exact] = Default::default();
        Pixels { file, settings, default_px, outside, without_ray, exact }
    }

    /// An image point and its standard deviation; `None` where the lens model has no ray for it.
    pub fn check(&mut self, line: u64, u: f64, v: f64, sigma_px: Option<f64>) -> Option<(Vector2<f64>, f64)> {
        let image_px = Vector2::new(u, v);
        if let Some(Settings { camera, .. }) = self.settings {
            if !camera.contains(&image_px) {
                self.outside.count(line);
            }
            if camera.ray(&image_px).is_none() {
                self.without_ray.count(line);
                return None;
            }
        }
        let sigma_px = sigma_px.unwrap_or(self.default_px);
        if sigma_px == 0.0 {
            self.exact.count(line);
        }
        Some((image_px, sigma_px.max(LEAST_SIGMA_PX)))
    }

    pub fn warn(&self, findings: &mut Findings) {
        let Pixels { file, outside, without_ray, exact, .. } = self;
        let mut warn = |what: &str, Tally { count, first_line }: &Tally| {
            if *count > 0 {
                findings
                    .warn(format!("{file}: image points {what}: {count}, the first on line {first_line}"));
            }
        };
        warn("outside the image", outside);
        warn("beyond the fold of the lens model, which are left out", without_ray);
        warn(&format!("with a sigma of 0 px, for which {LEAST_SIGMA_PX} px is assumed"), exact);
    }
}

/// Smallest, median and largest; zeros where there is none.
pub fn spread(mut counts: Vec<usize>) -> [usize; 3] {
    counts.sort_unstable();
    match counts.as_slice() {
        [] => [0; 3],
        [first, ..] => [*first, counts[counts.len() / 2], counts[counts.len() - 1]],
    }
}
