//! The targets of a result, read back.

use super::rows::TargetResultRow;
use crate::tables::{self, Finding, Findings, Line};
use nalgebra::Point3;
use std::collections::HashSet;
use std::path::Path;

/// Adjusted targets.
pub const RESULT_TARGETS: &str = "targets.csv";

/// What a target of a result is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ResultRole {
    /// It is adjusted to, with what is known of it.
    Control,
    /// It is compared with.
    Check,
    /// Nothing is known of it beforehand.
    Tie,
}

impl ResultRole {
    const ALL: [ResultRole; 3] = [ResultRole::Control, ResultRole::Check, ResultRole::Tie];

    /// Its name in the table.
    pub fn name(self) -> &'static str {
        match self {
            ResultRole::Control => "control",
            ResultRole::Check => "check",
            ResultRole::Tie => "tie",
        }
    }
}

/// A target of a result.
#[derive(Clone, Debug, PartialEq)]
pub struct ResultTarget {
    /// Its id.
    pub target: String,
    /// What it is for.
    pub role: ResultRole,
    /// Where it is in the world \[m\], if it was determined.
    pub position: Option<Point3<f64>>,
    /// Standard deviation per axis \[m\]; `None` where it was not computed or nothing determines the axis.
    pub sigma_m: [Option<f64>; 3],
    /// Whether nothing determines the axis.
    pub is_open: [bool; 3],
    /// Survey minus adjusted, per axis \[m\], where both are there.
    pub difference_m: [Option<f64>; 3],
    /// The difference in units of its own standard deviation.
    pub w: [Option<f64>; 3],
    /// Image points that took part.
    pub used: i64,
    /// Image points that did not.
    pub rejected: i64,
}

/// Reads the targets of a result; `None` without their table, as older versions have it.
pub fn read_targets(folder: &Path, findings: &mut Findings) -> Option<Vec<ResultTarget>> {
    std::fs::symlink_metadata(folder.join(RESULT_TARGETS)).ok()?;
    let rows: Vec<Line<TargetResultRow>> = tables::read(folder, RESULT_TARGETS, findings)?;
    let mut seen = HashSet::new();
    let mut targets = Vec::with_capacity(rows.len());
    for Line { line, row } in rows {
        let mut wrong = |column: &str, wanted: &str, found: &str| {
            findings.error(Finding::of_cell(RESULT_TARGETS, line, column, wanted, found));
        };
        let Some(role) = ResultRole::ALL.into_iter().find(|role| role.name() == row.role) else {
            wrong("role", "control, check or tie", &row.role);
            continue;
        };
        if !seen.insert(row.target.clone()) {
            wrong("target", "a target that is listed once", &row.target);
            continue;
        }
        let place = || Some(Point3::new(row.x?, row.y?, row.z?));
        targets.push(ResultTarget {
            role,
            position: place(),
            sigma_m: [row.sigma_x.known(), row.sigma_y.known(), row.sigma_z.known()],
            is_open: [row.sigma_x.is_open(), row.sigma_y.is_open(), row.sigma_z.is_open()],
            difference_m: [row.dx, row.dy, row.dz],
            w: [row.w_x, row.w_y, row.w_z],
            used: row.used,
            rejected: row.rejected,
            target: row.target,
        });
    }
    Some(targets)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(rows: &str) -> (Option<Vec<ResultTarget>>, Vec<String>) {
        let header = "target,role,x,y,z,sigma_x,sigma_y,sigma_z,dx,dy,dz,w_x,w_y,w_z,used,rejected\n";
        let folder = tempfile::tempdir().unwrap();
        let mut findings = Findings::default();
        assert_eq!(read_targets(folder.path(), &mut findings), None);
        std::fs::write(folder.path().join(RESULT_TARGETS), format!("{header}{rows}")).unwrap();
        let found = read_targets(folder.path(), &mut findings);
        (found, findings.errors().map(|f| f.to_string()).collect())
    }

    #[test]
    fn targets_are_read_with_what_is_not_known() {
        let (found, errors) =
            read("T1,control,1,2,3,0.1,inf,,0.01,-0.02,,1.5,,,7,2\nT2,tie,,,,,,,,,,,,,0,4\n");
        assert!(errors.is_empty(), "{errors:?}");
        let wanted = ResultTarget {
            target: "T1".to_owned(),
            role: ResultRole::Control,
            position: Some(Point3::new(1.0, 2.0, 3.0)),
            sigma_m: [Some(0.1), None, None],
            is_open: [false, true, false],
            difference_m: [Some(0.01), Some(-0.02), None],
            w: [Some(1.5), None, None],
            used: 7,
            rejected: 2,
        };
        let [first, second] = found.unwrap().try_into().unwrap();
        assert_eq!(first, wanted);
        assert_eq!((second.role, second.position, second.rejected), (ResultRole::Tie, None, 4));
    }

    #[test]
    fn what_is_wrong_with_targets_is_named() {
        let (_, errors) = read(
            "T1,control,1,2,3,,,,,,,,,,7,2\nT1,check,1,2,3,,,,,,,,,,7,2\nT2,goal,1,2,3,,,,,,,,,,7,2\n\
             T3,tie,1,2,3,,,,,,,,,,many,2\n",
        );
        let wanted = [
            "targets.csv:5: column used: expected a whole number, found \"many\"",
            "targets.csv:3: column target: expected a target that is listed once, found \"T1\"",
            "targets.csv:4: column role: expected control, check or tie, found \"goal\"",
        ];
        assert_eq!(errors, wanted);
    }
}
