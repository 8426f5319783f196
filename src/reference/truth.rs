//! `truth/vehicle_points.csv` of a simulated problem: where its shape points really are.

use crate::tables::{self, Finding, Findings, Line, input_row};
use nalgebra::Point3;
use std::collections::HashSet;
use std::path::Path;

const FILE: &str = "truth/vehicle_points.csv";

input_row!(
    /// A row of the table.
    TruePointRow {
        required vehicle: String, required point: String,
        required x: f64, required y: f64, required z: f64,
    }
);

/// The true shape of a vehicle: ids and places in the vehicle frame \[m\].
pub type TrueShape = Vec<(String, Point3<f64>)>;

/// The true shape of each vehicle that has one.
pub fn read(problem_folder: &Path, vehicles: &[String], findings: &mut Findings) -> Vec<(String, TrueShape)> {
    let mut shapes: Vec<(String, TrueShape)> = Vec::new();
    if std::fs::symlink_metadata(problem_folder.join(FILE)).is_err() {
        return shapes;
    }
    let rows: Vec<Line<TruePointRow>> = tables::read(problem_folder, FILE, findings).unwrap_or_default();
    let mut seen = HashSet::new();
    for Line { line, row } in rows {
        if !vehicles.contains(&row.vehicle) {
            let wanted = "a vehicle of problem.toml";
            findings.error(Finding::of_cell(FILE, line, "vehicle", wanted, &row.vehicle));
            continue;
        }
        if !seen.insert((row.vehicle.clone(), row.point.clone())) {
            let wanted = "a point that is listed once for this vehicle";
            findings.error(Finding::of_cell(FILE, line, "point", wanted, &row.point));
            continue;
        }
        let point = (row.point, Point3::new(row.x, row.y, row.z));
        match shapes.iter_mut().find(|(id, _)| *id == row.vehicle) {
            Some((_, points)) => points.push(point),
            None => shapes.push((row.vehicle, vec![point])),
        }
    }
    shapes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shapes_are_read_and_what_is_wrong_is_named() {
        let place = tempfile::tempdir().unwrap();
        let mut findings = Findings::default();
        assert!(read(place.path(), &[], &mut findings).is_empty() && !findings.is_invalid());
        std::fs::create_dir(place.path().join("truth")).unwrap();
        let text = "vehicle,point,x,y,z\na,1,1,2,3\na,2,4,5,6\nb,1,0,0,x\na,1,1,2,3\nc,1,0,0,0\n";
        std::fs::write(place.path().join(FILE), text).unwrap();
        let shapes = read(place.path(), &["a".to_owned(), "b".to_owned()], &mut findings);
        assert_eq!(shapes.len(), 1);
        assert_eq!(shapes[0].1[1], ("2".to_owned(), Point3::new(4.0, 5.0, 6.0)));
        let errors: Vec<String> = findings.errors().map(|f| f.to_string()).collect();
        assert_eq!(errors.len(), 3, "{errors:?}");
        assert!(errors[0].starts_with("truth/vehicle_points.csv:4: column z: expected a finite number"));
    }
}
