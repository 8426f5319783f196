//! The folder that `evaluate --out` writes: the page for people, and files for other tools.

use super::Failure;
use crate::evaluate::Evaluation;
use crate::files::{RESIDUALS, ResultTracks, START_RESIDUALS, input_files, read_report, read_residuals};
use crate::problem::Problem;
use crate::report::folder::{Holds, Staged};
use crate::report::{File, PageInput, changed_inputs, distance_clouds, exports, page};
use crate::tables::Findings;
use std::path::{Path, PathBuf};

/// What was compared, and where it is from.
#[derive(Clone, Copy)]
pub struct Evaluated<'a> {
    /// The problem folder.
    pub problem_folder: &'a Path,
    /// The result folder.
    pub result_folder: &'a Path,
    /// Name of the problem.
    pub name: &'a str,
    /// The problem, where it can be computed.
    pub problem: Option<&'a Problem>,
    /// The tracks of the result.
    pub tracks: &'a ResultTracks,
    /// The comparison.
    pub evaluation: &'a Evaluation,
    /// What is odd.
    pub warnings: &'a [String],
}

/// Writes the folder: all of it or nothing. `json` is the comparison for programs.
pub fn write(target: &Path, evaluated: &Evaluated, json: &str, command: &str) -> Result<PathBuf, Failure> {
    let failed = |error: &dyn std::fmt::Display| Failure::Other(format!("{}: {error}", target.display()));
    let Evaluated { problem_folder, result_folder, name, problem, tracks, evaluation, warnings } = *evaluated;
    let staged = Staged::begin(target, Holds::Evaluation)?;
    let mut findings = Findings::default();
    let report = read_report(result_folder, &mut findings).unwrap_or_default();
    let start = read_residuals(result_folder, START_RESIDUALS, &mut findings);
    let end = read_residuals(result_folder, RESIDUALS, &mut findings);
    if findings.is_invalid() {
        return Err(Failure::Invalid(vec![(result_folder.to_owned(), findings)]));
    }
    let inputs = input_files(problem_folder);
    let mut warnings = warnings.to_vec();
    let changed = changed_inputs(&report, &inputs);
    if !changed.is_empty() {
        warnings
            .push(format!("files of the problem are not those that were adjusted: {}", changed.join(", ")));
    }
    let page = page(&PageInput {
        name,
        command,
        problem,
        inputs: &inputs,
        report: &report,
        start: start.as_deref(),
        end: end.as_deref(),
        tracks,
        evaluation,
        warnings: &warnings,
    });
    let mut files: Vec<File> = vec![
        ("report.html".to_owned(), page.into_bytes()),
        ("evaluation.json".to_owned(), json.as_bytes().to_vec()),
    ];
    files.extend(evaluation.shapes.iter().flat_map(distance_clouds));
    files.extend(exports(evaluation));
    for file in &files {
        staged.write(file).map_err(|error| failed(&error))?;
    }
    staged.publish().map_err(|error| failed(&error))
}
