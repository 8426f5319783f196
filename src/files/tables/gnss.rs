//! `observations/gnss.csv`: measured positions to adjust to.

use super::super::cells::{metres, seconds};
use super::Tables;
use super::reading::{Index, Reader};
use super::vehicles::Observed;
use crate::problem::{Problem, ReceivedPosition, Receiver, ReceiverKnowledge, Vehicle};
use crate::tables::{Line, Sigma, input_row, written};
use nalgebra::Point3;
use std::collections::HashSet;

/// Name of the file.
pub const FILE: &str = "observations/gnss.csv";

/// Standard deviation of a coordinate of a position that is given without one \[m\].
const SIGMA_M: f64 = 0.02;
/// No position is better than this \[m\].
const LEAST_SIGMA_M: f64 = 1e-4;

input_row!(
    /// `observations/gnss.csv`: measured positions to adjust to.
    GnssObservationRow {
        required vehicle: String, required point: String, required time_s: f64,
        required x: f64, required y: f64, required z: f64,
        required sigma_x: Sigma, required sigma_y: Sigma, required sigma_z: Sigma,
    }
);

/// The positions of each vehicle and point.
pub fn check<'t>(
    reader: &mut Reader,
    tables: &'t Tables,
    index: &Index,
    observed: &Observed,
) -> Vec<(usize, &'t str, ReceivedPosition)> {
    let mut seen = HashSet::new();
    let mut received = Vec::new();
    let mut without_sigma = 0;
    for Line { line, row } in tables.gnss.iter().flatten() {
        let vehicle = reader.vehicle(FILE, *line, &row.vehicle, index);
        if tables.vehicle_observations.is_some() && !observed.points.contains(&(&row.vehicle, &row.point)) {
            reader.cell(FILE, *line, "point", "a point that is observed", &row.point);
        }
        if !seen.insert((&row.vehicle, &row.point, row.time_s.to_bits())) {
            reader.cell(FILE, *line, "time_s", "a time that is listed once", row.time_s);
        }
        let Some(vehicle) = vehicle else { continue };
        let sigma_m = [row.sigma_x.0, row.sigma_y.0, row.sigma_z.0].map(|sigma| {
            without_sigma += usize::from(sigma.is_none());
            sigma.unwrap_or(SIGMA_M).max(LEAST_SIGMA_M)
        });
        let position = Point3::new(row.x, row.y, row.z);
        let (time_s, point) = (row.time_s, row.point.as_str());
        received.push((vehicle, point, ReceivedPosition { time_s, position, sigma_m }));
    }
    if without_sigma > 0 {
        reader
            .findings
            .warn(format!("{FILE}: coordinates without a sigma: {without_sigma}; {SIGMA_M} m is assumed"));
    }
    received
}

/// The receivers with their positions, in the order of vehicles and points.
pub fn receivers(
    received: &[(usize, &str, ReceivedPosition)],
    knowledge: ReceiverKnowledge,
    vehicles: &[Vehicle],
) -> Vec<Receiver> {
    let mut all: Vec<Receiver> = Vec::new();
    for (vehicle, id, received) in received {
        let points = &vehicles[*vehicle].points;
        let Some(point) = points.iter().position(|point| point.id == *id) else { continue };
        let at = all.iter().position(|r| (r.vehicle, r.point) == (*vehicle, point));
        let at = at.unwrap_or_else(|| {
            all.push(Receiver { vehicle: *vehicle, point, positions: Vec::new(), knowledge });
            all.len() - 1
        });
        all[at].positions.push(*received);
    }
    for receiver in &mut all {
        receiver.positions.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
    }
    all.sort_by_key(|receiver| (receiver.vehicle, receiver.point));
    all
}

/// The table of a problem.
pub fn table(problem: &Problem) -> Vec<u8> {
    let rows = problem.receivers.iter().flat_map(|receiver| {
        let vehicle = &problem.vehicles[receiver.vehicle];
        let ids = [vehicle.id.clone(), vehicle.points[receiver.point].id.clone()];
        receiver.positions.iter().map(move |p| {
            let numbers = p.position.iter().chain(&p.sigma_m).map(|v| metres(*v)).collect::<Vec<_>>();
            ids.clone().into_iter().chain([seconds(p.time_s)]).chain(numbers)
        })
    });
    let header = ["vehicle", "point", "time_s", "x", "y", "z", "sigma_x", "sigma_y", "sigma_z"];
    written(&header, rows)
}
