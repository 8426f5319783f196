//! The other tables of a result folder, read back: shapes, residuals and the report.

use super::rows::{ResidualRow, VehiclePointResultRow};
use crate::tables::{self, Finding, Findings, Line};
use nalgebra::{Point3, Vector2};
use std::collections::HashSet;
use std::path::Path;

/// Image residuals at the end.
pub const RESIDUALS: &str = "residuals.csv";
/// Image residuals at the first estimate.
pub const START_RESIDUALS: &str = "residuals_start.csv";
const POINTS: &str = "vehicle_points.csv";
const REPORT: &str = "report.json";

/// `report.json` of a result.
pub type ResultReport = serde_json::Value;

/// A shape point of a result.
#[derive(Clone, Debug, PartialEq)]
pub struct ResultPoint {
    /// Its id.
    pub point: String,
    /// Its place in the vehicle frame \[m\].
    pub position: Point3<f64>,
    /// Standard deviation per axis \[m\]; `None` where it was not computed or nothing determines the axis.
    pub sigma_m: [Option<f64>; 3],
}

/// An image residual of a result.
#[derive(Clone, Debug, PartialEq)]
pub struct ResultResidual {
    /// Number of the frame.
    pub frame: i64,
    /// The vehicle, or `None` for a target.
    pub vehicle: Option<String>,
    /// The point or the target.
    pub point: String,
    /// Observed minus computed \[px\].
    pub residual_px: Vector2<f64>,
    /// 0: rejected.
    pub weight: f64,
}

/// Reads the shape of each vehicle; points without coordinates are left out. Without the table there are none.
pub fn read_points(
    folder: &Path,
    vehicles: Option<&[String]>,
    findings: &mut Findings,
) -> Vec<(String, Vec<ResultPoint>)> {
    let mut shapes: Vec<(String, Vec<ResultPoint>)> = Vec::new();
    if std::fs::symlink_metadata(folder.join(POINTS)).is_err() {
        return shapes;
    }
    let rows: Vec<Line<VehiclePointResultRow>> = tables::read(folder, POINTS, findings).unwrap_or_default();
    let mut seen = HashSet::new();
    for Line { line, row } in rows {
        if vehicles.is_some_and(|vehicles| !vehicles.contains(&row.vehicle)) {
            let wanted = "a vehicle of problem.toml";
            findings.error(Finding::of_cell(POINTS, line, "vehicle", wanted, &row.vehicle));
            continue;
        }
        if !seen.insert((row.vehicle.clone(), row.point.clone())) {
            let wanted = "a point that is listed once for this vehicle";
            findings.error(Finding::of_cell(POINTS, line, "point", wanted, &row.point));
            continue;
        }
        let (Some(x), Some(y), Some(z)) = (row.x, row.y, row.z) else { continue };
        let point = ResultPoint {
            point: row.point,
            position: Point3::new(x, y, z),
            sigma_m: [row.sigma_x.known(), row.sigma_y.known(), row.sigma_z.known()],
        };
        match shapes.iter_mut().find(|(id, _)| *id == row.vehicle) {
            Some((_, points)) => points.push(point),
            None => shapes.push((row.vehicle, vec![point])),
        }
    }
    shapes
}

/// Reads image residuals from `file`; `None` without it.
pub fn read_residuals(folder: &Path, file: &str, findings: &mut Findings) -> Option<Vec<ResultResidual>> {
    std::fs::symlink_metadata(folder.join(file)).ok()?;
    let rows: Vec<Line<ResidualRow>> = tables::read(folder, file, findings)?;
    let mut residuals = Vec::with_capacity(rows.len());
    for Line { line, row } in rows {
        let vehicle = match row.kind.as_str() {
            "vehicle" => Some(row.vehicle.unwrap_or_default()),
            "target" => None,
            other => {
                findings.error(Finding::of_cell(file, line, "kind", "vehicle or target", other));
                continue;
            }
        };
        residuals.push(ResultResidual {
            frame: row.frame,
            vehicle,
            point: row.point,
            residual_px: Vector2::new(row.du, row.dv),
            weight: row.weight,
        });
    }
    Some(residuals)
}

/// Reads `report.json`; `None` without it.
pub fn read_report(folder: &Path, findings: &mut Findings) -> Option<ResultReport> {
    let text = std::fs::read(folder.join(REPORT)).ok()?;
    match serde_json::from_slice(&text) {
        Ok(report) => Some(report),
        Err(error) => {
            findings.error(Finding::of_file(REPORT, "JSON", &error.to_string()));
            None
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder(files: &[(&str, &str)]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        files.iter().for_each(|(name, text)| std::fs::write(folder.path().join(name), text).unwrap());
        folder
    }

    #[test]
    fn shapes_are_read_with_what_is_not_known() {
        let text = "vehicle,point,x,y,z,sigma_x,sigma_y,sigma_z,observations,inliers,rms_px\n\
                    a,1,1,2,3,0.1,inf,,5,4,0.5\na,2,,,,,,,1,0,\nb,1,4,5,6,,,,5,4,0.5\n";
        let mut findings = Findings::default();
        let shapes = read_points(folder(&[(POINTS, text)]).path(), None, &mut findings);
        assert!(!findings.is_invalid());
        let ids: Vec<_> = shapes.iter().map(|(id, points)| (id.as_str(), points.len())).collect();
        assert_eq!(ids, [("a", 1), ("b", 1)]);
        assert_eq!(shapes[0].1[0].sigma_m, [Some(0.1), None, None]);
    }

    #[test]
    fn what_is_wrong_is_named() {
        let points =
            "vehicle,point,x,y,z,sigma_x,sigma_y,sigma_z\na,1,1,2,3,,,\na,1,1,2,3,,,\nc,1,1,2,3,,,\n";
        let residuals = "frame,kind,vehicle,point,du,dv,weight\n0,vehicle,a,1,0.5,1,1\n0,body,a,1,0.5,1,1\n\
                         1,target,,T1,0,inf,0\n";
        let folder = folder(&[(POINTS, points), (RESIDUALS, residuals), (REPORT, "{")]);
        let mut findings = Findings::default();
        read_points(folder.path(), Some(&["a".to_owned()]), &mut findings);
        let found = read_residuals(folder.path(), RESIDUALS, &mut findings).unwrap();
        assert_eq!(found.len(), 1);
        assert_eq!(read_residuals(folder.path(), START_RESIDUALS, &mut findings), None);
        read_report(folder.path(), &mut findings);
        let errors: Vec<String> = findings.errors().map(|f| f.to_string()).collect();
        for (found, wanted) in errors.iter().zip([
            "vehicle_points.csv:3: column point: expected a point that is listed once",
            "vehicle_points.csv:4: column vehicle: expected a vehicle of problem.toml",
            "residuals.csv:4: column dv: expected a finite number",
            "residuals.csv:3: column kind: expected vehicle or target, found \"body\"",
            "report.json: expected JSON",
        ]) {
            assert!(found.starts_with(wanted), "{found}");
        }
        assert_eq!(errors.len(), 5);
    }
}
