//! The folder that `evaluate --out` writes: the page for people, and files for other tools.

use super::Failure;
use super::comparison::Compared;
use super::options::{not_written, put_in_place, write_files};
use crate::files::{RESIDUALS, START_RESIDUALS, read_residuals};
use crate::page::{PageInput, page};
use crate::problem::Problem;
use crate::report::folder::Staged;
use crate::report::{EvaluationReport, File, distance_clouds, exports};
use crate::tables::Findings;
use std::path::Path;

/// What was compared, and where it is from.
#[derive(Clone, Copy)]
pub struct Evaluated<'a> {
    /// The result folder.
    pub result_folder: &'a Path,
    /// Name of the problem.
    pub name: &'a str,
    /// The problem, where it can be computed.
    pub problem: Option<&'a Problem>,
    /// The comparison.
    pub compared: &'a Compared,
    /// What is odd.
    pub warnings: &'a [String],
}

/// Writes the folder: all of it or nothing. `json` is the comparison for programs, to which the files of the folder
/// are added.
pub fn write(
    staged: &mut Staged,
    evaluated: &Evaluated,
    json: &mut EvaluationReport,
    command: &str,
) -> Result<(), Failure> {
    let Evaluated { result_folder, name, problem, compared, warnings } = *evaluated;
    let Compared { tracks, report, inputs, evaluation, .. } = compared;
    let mut findings = Findings::default();
    let start = read_residuals(result_folder, START_RESIDUALS, problem, &mut findings);
    let end = read_residuals(result_folder, RESIDUALS, problem, &mut findings);
    if findings.is_invalid() {
        return Err(Failure::Invalid(vec![(result_folder.to_owned(), findings)]));
    }
    let page = page(&PageInput {
        name,
        command,
        problem,
        inputs,
        report,
        start: start.as_ref(),
        end: end.as_ref(),
        tracks,
        evaluation,
        warnings,
    });
    let mut files: Vec<File> = vec![("report.html".to_owned(), page.into_bytes())];
    files.extend(evaluation.shapes.iter().flat_map(distance_clouds));
    files.extend(exports(evaluation));
    write_files(staged, &files)?;
    json.files = staged.files();
    staged.write_known(json.to_json()).map_err(|error| not_written(staged, error))?;
    put_in_place(staged).map(|_| ())
}
