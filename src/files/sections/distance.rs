//! `[[distance]]`: a known distance between two points of a vehicle.

use super::super::cells::{decimal, quoted};
use super::super::section::Section;
use crate::problem::{Problem, ScaleBar, Vehicle};
use std::fmt::Write;

/// One `[[distance]]`.
#[derive(Debug)]
pub struct Distance {
    vehicle: String,
    points: [String; 2],
    length_m: f64,
    sigma_m: f64,
    /// Lines of `vehicle` and `points`.
    lines: [u64; 2],
}

/// Reads one `[[distance]]`.
pub fn read(distance: &Section) -> Option<Distance> {
    let above_zero = "a finite number above 0";
    let vehicle = distance.required("vehicle", "the id of a vehicle", || distance.text("vehicle"));
    let two = "two points of the vehicle that differ";
    let points = distance.required("points", two, || distance.texts("points")).and_then(|points| {
        let pair = <[String; 2]>::try_from(points).ok().filter(|[a, b]| a != b);
        if pair.is_none() {
            distance.error("points", two);
        }
        pair
    });
    let length_m = distance.required("length_m", above_zero, || distance.positive("length_m"));
    let sigma_m = distance.required("sigma_m", above_zero, || distance.positive("sigma_m"));
    let lines = [distance.line("vehicle"), distance.line("points")];
    Some(Distance { vehicle: vehicle?, points: points?, length_m: length_m?, sigma_m: sigma_m?, lines })
}

impl Distance {
    /// Adds it to its vehicle. `error` takes line, key, what is wanted, and what was found instead.
    pub fn join(&self, vehicles: &mut [Vehicle], error: &mut impl FnMut(u64, &str, &str, &str)) {
        let [of_vehicle, of_points] = self.lines;
        let Some(vehicle) = vehicles.iter_mut().find(|vehicle| vehicle.id == self.vehicle) else {
            error(of_vehicle, "distance.vehicle", "the id of a vehicle", &self.vehicle);
            return;
        };
        if vehicle.points.is_empty() {
            return;
        }
        let places = self.points.each_ref().map(|id| vehicle.points.iter().position(|point| point.id == *id));
        for (id, _) in self.points.iter().zip(&places).filter(|(_, place)| place.is_none()) {
            error(of_points, "distance.points", "points that are observed", id);
        }
        if let [Some(a), Some(b)] = places {
            let &Distance { length_m, sigma_m, .. } = self;
            vehicle.scale_bars.push(ScaleBar { points: [a, b], length_m, sigma_m });
        }
    }
}

/// Writes the known distances.
pub fn write(text: &mut String, problem: &Problem) {
    for vehicle in &problem.vehicles {
        for bar in &vehicle.scale_bars {
            let [a, b] = bar.points.map(|point| quoted(&vehicle.points[point].id));
            let [length_m, sigma_m] = [bar.length_m, bar.sigma_m].map(|metres| decimal(metres, 9));
            let _ = writeln!(
                text,
                "\n[[distance]]\nvehicle = {}\npoints = [{a}, {b}]\nlength_m = {length_m}\nsigma_m = {sigma_m}",
                quoted(&vehicle.id)
            );
        }
    }
}
