//! The image residuals of a result, each joined to the image point that it is of.

use super::rows::ResidualRow;
use crate::problem::Problem;
use crate::tables::{self, Finding, Findings, Line};
use nalgebra::Vector2;
use std::collections::HashMap;
use std::path::Path;

/// Image residuals at the end.
pub const RESIDUALS: &str = "residuals.csv";
/// Image residuals at the first estimate.
pub const START_RESIDUALS: &str = "residuals_start.csv";

/// An image residual of a result.
#[derive(Clone, Debug, PartialEq)]
pub struct ResultResidual {
    /// Index of the frame.
    pub frame: usize,
    /// Index of the target, where it is of one.
    pub target: Option<usize>,
    /// The image point \[px\].
    pub image_px: Vector2<f64>,
    /// Observed minus computed \[px\].
    pub residual_px: Vector2<f64>,
    /// 0: it did not count, 1: in full.
    pub weight: f64,
    /// The code of why it was rejected; `None` where it was not, or where an older version did not say.
    pub reason: Option<String>,
}

impl ResultResidual {
    /// Whether it counted.
    pub fn is_accepted(&self) -> bool {
        self.weight > 0.0
    }
}

/// The image residuals of a result in the order of a problem's image points; `None` where a result has none.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ResultResiduals {
    /// For each vehicle one for each of its image points.
    pub vehicles: Vec<Vec<Option<ResultResidual>>>,
    /// One for each image point of a target.
    pub targets: Vec<Option<ResultResidual>>,
}

impl ResultResiduals {
    /// A result without any.
    pub fn none_of(problem: &Problem) -> Self {
        ResultResiduals {
            vehicles: problem.vehicles.iter().map(|v| vec![None; v.observations.len()]).collect(),
            targets: vec![None; problem.target_observations.len()],
        }
    }

    /// One for each image point: of vehicles, then of targets.
    pub fn each(&self) -> impl Iterator<Item = Option<&ResultResidual>> {
        self.vehicles.iter().flatten().chain(&self.targets).map(Option::as_ref)
    }

    /// Those that there are.
    pub fn all(&self) -> impl Iterator<Item = &ResultResidual> {
        self.each().flatten()
    }
}

/// Reads image residuals from `file`; `None` without it. Those of other image points than the problem's are left
/// out; without a problem all are, and the table is only checked.
pub fn read_residuals(
    folder: &Path,
    file: &str,
    problem: Option<&Problem>,
    findings: &mut Findings,
) -> Option<ResultResiduals> {
    std::fs::symlink_metadata(folder.join(file)).ok()?;
    let rows: Vec<Line<ResidualRow>> = tables::read(folder, file, findings)?;
    let index = problem.map(Index::new);
    let mut residuals = problem.map(ResultResiduals::none_of).unwrap_or_default();
    for Line { line, row } in rows {
        if !["vehicle", "target"].contains(&row.kind.as_str()) {
            findings.error(Finding::of_cell(file, line, "kind", "vehicle or target", &row.kind));
            continue;
        }
        if let Some(index) = &index {
            index.join(row, &mut residuals);
        }
    }
    Some(residuals)
}

/// Where the image points of a problem stand.
struct Index<'p> {
    problem: &'p Problem,
    frames: HashMap<i64, usize>,
    targets: HashMap<&'p str, usize>,
    points: HashMap<(&'p str, &'p str), [usize; 2]>,
}

impl<'p> Index<'p> {
    fn new(problem: &'p Problem) -> Self {
        let mut points = HashMap::new();
        for (vehicle_at, vehicle) in problem.vehicles.iter().enumerate() {
            for (at, point) in vehicle.points.iter().enumerate() {
                points.insert((vehicle.id.as_str(), point.id.as_str()), [vehicle_at, at]);
            }
        }
        Index {
            problem,
            frames: problem.frames.iter().enumerate().map(|(at, f)| (f.number, at)).collect(),
            targets: problem.targets.iter().enumerate().map(|(at, t)| (t.id.as_str(), at)).collect(),
            points,
        }
    }

    /// Puts a row in the place of its image point, if there is one.
    fn join(&self, row: ResidualRow, residuals: &mut ResultResiduals) -> Option<()> {
        let frame = *self.frames.get(&row.frame)?;
        let (place, target, image_px) = if row.kind == "target" {
            let target = *self.targets.get(row.point.as_str())?;
            let all = &self.problem.target_observations;
            let at = all.binary_search_by_key(&(frame, target), |o| (o.frame, o.target)).ok()?;
            (&mut residuals.targets[at], Some(target), all[at].image_px)
        } else {
            let vehicle = row.vehicle.as_deref().unwrap_or_default();
            let [vehicle, point] = *self.points.get(&(vehicle, row.point.as_str()))?;
            let all = &self.problem.vehicles[vehicle].observations;
            let at = all.binary_search_by_key(&(frame, point), |o| (o.frame, o.point)).ok()?;
            (&mut residuals.vehicles[vehicle][at], None, all[at].image_px)
        };
        let residual_px = Vector2::new(row.du, row.dv);
        let ResidualRow { weight, reason, .. } = row;
        *place = Some(ResultResidual { frame, target, image_px, residual_px, weight, reason });
        Some(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::read_problem;

    fn problem(name: &str) -> Problem {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("problems").join(name);
        read_problem(&folder).unwrap().problem.unwrap()
    }

    fn read(text: &str, problem: Option<&Problem>) -> (Option<ResultResiduals>, Vec<String>) {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join(RESIDUALS), text).unwrap();
        let mut findings = Findings::default();
        assert_eq!(read_residuals(folder.path(), START_RESIDUALS, problem, &mut findings), None);
        let found = read_residuals(folder.path(), RESIDUALS, problem, &mut findings);
        (found, findings.errors().map(|f| f.to_string()).collect())
    }

    #[test]
    fn residuals_find_their_image_points_with_what_became_of_them() {
        let problem = problem("tiny");
        let vehicle = &problem.vehicles[0];
        let o = vehicle.observations[2];
        let (number, point) = (problem.frames[o.frame].number, &vehicle.points[o.point].id);
        // The last of two of one image point counts.
        let rows = format!(
            "{number},vehicle,cart,{point},9,9,1,,,\n{number},vehicle,cart,{point},0.5,-1,0,track,1,2\n\
             {number},vehicle,cart,ghost,1,1,1,,,\n-7,vehicle,cart,{point},1,1,1,,,\n{number},target,,T1,1,1,1,,,\n"
        );
        let text = format!("frame,kind,vehicle,point,du,dv,weight,reason,u_computed,v_computed\n{rows}");
        let (found, errors) = read(&text, Some(&problem));
        assert!(errors.is_empty(), "{errors:?}");
        let found = found.unwrap();
        assert_eq!(found.each().count(), vehicle.observations.len());
        let wanted = ResultResidual {
            frame: o.frame,
            target: None,
            image_px: o.image_px,
            residual_px: Vector2::new(0.5, -1.0),
            weight: 0.0,
            reason: Some("track".to_owned()),
        };
        assert_eq!(found.vehicles[0][2], Some(wanted));
        assert_eq!(found.all().count(), 1);
    }

    #[test]
    fn a_table_of_an_older_version_is_read() {
        let problem = problem("suv-noisy");
        let o = problem.target_observations[5];
        let (number, id) = (problem.frames[o.frame].number, &problem.targets[o.target].id);
        let text = format!("frame,kind,vehicle,point,du,dv,weight\n{number},target,,{id},0.5,-1,0\n");
        let (found, errors) = read(&text, Some(&problem));
        assert!(errors.is_empty(), "{errors:?}");
        let found = found.unwrap().targets[5].clone().unwrap();
        assert_eq!(
            (found.target, found.image_px, found.reason.as_deref()),
            (Some(o.target), o.image_px, None)
        );
        assert!(!found.is_accepted());
    }

    #[test]
    fn what_is_wrong_is_named_with_and_without_a_problem() {
        let text = "frame,kind,vehicle,point,du,dv,weight\n0,vehicle,a,1,0.5,1,1\n0,body,a,1,0.5,1,1\n\
                    1,target,,T1,0,inf,0\n";
        for problem in [None, Some(problem("tiny"))] {
            let (found, errors) = read(text, problem.as_ref());
            assert_eq!(found.unwrap().all().count(), 0);
            assert_eq!(errors.len(), 2);
            for (found, wanted) in errors.iter().zip([
                "residuals.csv:4: column dv: expected a finite number",
                "residuals.csv:3: column kind: expected vehicle or target, found \"body\"",
            ]) {
                assert!(found.starts_with(wanted), "{found}");
            }
        }
    }
}
