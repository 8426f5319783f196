//! `vehicle_points.csv` of a problem: what is known beforehand of points in the vehicle frame.

use super::super::cells::number_sigma;
use super::Tables;
use super::reading::{Index, Reader, known};
use super::vehicles::Observed;
use crate::problem::{Known, Problem};
use crate::tables::{Line, Sigma, input_row, written};
use std::collections::HashMap;

/// Name of the file.
pub const FILE: &str = "vehicle_points.csv";

/// Standard deviation of a coordinate of a shape point that is given without one \[m\].
const SIGMA_M: f64 = 0.1;

input_row!(
    /// `vehicle_points.csv` of a problem: what is known beforehand of a point in the vehicle frame.
    KnownPointRow {
        required vehicle: String, required point: String,
        required x: Option<f64>, required y: Option<f64>, required z: Option<f64>,
        required sigma_x: Sigma, required sigma_y: Sigma, required sigma_z: Sigma,
    }
);

/// What is known, by vehicle and point.
pub fn check<'t>(
    reader: &mut Reader,
    tables: &'t Tables,
    index: &Index,
    observed: &Observed,
) -> HashMap<(usize, &'t str), [Option<Known>; 3]> {
    let mut points = HashMap::new();
    let mut without_sigma = 0;
    for Line { line, row } in tables.known_points.iter().flatten() {
        let Some(vehicle) = reader.vehicle(FILE, *line, &row.vehicle, index) else { continue };
        if tables.vehicle_observations.is_some() && !observed.points.contains(&(&row.vehicle, &row.point)) {
            reader.cell(FILE, *line, "point", "a point that is observed", &row.point);
        }
        let sigmas = [row.sigma_x.0, row.sigma_y.0, row.sigma_z.0];
        let known = known([row.x, row.y, row.z], sigmas, SIGMA_M, &mut without_sigma);
        if points.insert((vehicle, row.point.as_str()), known).is_some() {
            reader.cell(FILE, *line, "point", "a point that is listed once", &row.point);
        }
    }
    if without_sigma > 0 {
        reader
            .findings
            .warn(format!("{FILE}: coordinates without a sigma: {without_sigma}; {SIGMA_M} m is assumed"));
    }
    points
}

/// The table of a problem; `None` where nothing is known.
pub fn table(problem: &Problem) -> Option<Vec<u8>> {
    let known = problem.vehicles.iter().flat_map(|vehicle| {
        let points = vehicle.points.iter().filter(|point| point.known.iter().any(Option::is_some));
        points.map(|point| (vehicle.id.clone(), point))
    });
    let known = known.map(|(vehicle, point)| {
        let [[x, sx], [y, sy], [z, sz]] = point.known.map(number_sigma);
        [vehicle, point.id.clone(), x, y, z, sx, sy, sz]
    });
    let known: Vec<_> = known.collect();
    let header = ["vehicle", "point", "x", "y", "z", "sigma_x", "sigma_y", "sigma_z"];
    (!known.is_empty()).then(|| written(&header, known))
}
