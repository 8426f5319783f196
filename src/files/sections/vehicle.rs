//! `[[vehicle]]`.

use super::super::cells::{number_sigma, quoted};
use super::super::section::Section;
use crate::problem::{Known, Problem};
use std::fmt::Write;

/// An id is no longer: with what is added to it, it is the name of a file \[byte\].
const MOST_ID_BYTES: usize = 200;

/// One `[[vehicle]]`.
#[derive(Debug)]
pub struct VehicleSettings {
    pub id: String,
    /// The marker and the line where it stands.
    pub marker: Option<(String, u64)>,
    pub height: Option<Known>,
    pub is_car: bool,
}

/// Reads the id of a vehicle.
pub fn read_id(vehicle: &Section) -> Option<String> {
    let id = vehicle.required("id", "a text", || vehicle.text("id"));
    // The id becomes part of a file's name.
    let unfit = |c: char| c.is_control() || "/\\:*?\"<>|".contains(c);
    let fits = |id: &String| !id.contains(unfit) && !id.starts_with('.') && id.len() <= MOST_ID_BYTES;
    if id.as_ref().is_some_and(|id| !fits(id)) {
        vehicle
            .error("id", &format!("an id that can be part of a file name, of at most {MOST_ID_BYTES} bytes"));
    } else if id.as_ref().is_some_and(|id| id != id.trim()) {
        // Cells of tables are read without them.
        vehicle.error("id", "an id without blanks at its ends");
    }
    id
}

/// Reads one `[[vehicle]]`.
pub fn read(vehicle: &Section) -> Option<VehicleSettings> {
    let id = read_id(vehicle);
    let marker = vehicle.text("marker").map(|id| (id, vehicle.line("marker")));
    let height_m = vehicle.positive("height_m");
    let sigma_m = vehicle.not_negative("height_sigma_m").unwrap_or(0.1);
    if vehicle.has("height_sigma_m") && !vehicle.has("height_m") {
        vehicle.warn("height_sigma_m", "has no effect without height_m");
    }
    let kind = vehicle.text("kind");
    if kind.as_ref().is_some_and(|kind| kind != "car" && kind != "other") {
        vehicle.error("kind", "\"car\" or \"other\"");
    }
    let height = height_m.map(|value_m| Known { value_m, sigma_m });
    Some(VehicleSettings { id: id?, marker, height, is_car: kind.is_some_and(|kind| kind == "car") })
}

/// Writes the vehicles.
pub fn write(text: &mut String, problem: &Problem) {
    for vehicle in &problem.vehicles {
        text.push_str("\n[[vehicle]]\n");
        let _ = writeln!(text, "id = {}", quoted(&vehicle.id));
        if let Some(marker) = vehicle.marker {
            let _ = writeln!(text, "marker = {}", quoted(&vehicle.points[marker].id));
        }
        if vehicle.is_car {
            text.push_str("kind = \"car\"\n");
        }
        if let Some(height) = vehicle.height {
            let [value, sigma] = number_sigma(Some(height));
            let _ = writeln!(text, "height_m = {value}\nheight_sigma_m = {sigma}");
        }
    }
}
