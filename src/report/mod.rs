//! Results into bytes, and the whole folder at once or not at all.

mod cloud;
mod diagnosis;
mod document;
mod evaluation;
mod exports;
mod finding;
pub mod folder;
mod json;
mod rounding;
mod study;
mod tables;

pub use cloud::cloud_with_scalars;
pub use cloud::distance_clouds;
pub use diagnosis::{ParameterReport, ScaleReport, Sigma};
pub use document::document;
pub use evaluation::{EvaluationReport, evaluation_report};
pub use exports::exports;
pub use finding::FindingReport;
pub use json::{FailedStepReport, Report, report_of_adjustment, report_of_initial, resection_report};
pub use study::{StudyReport, plan_table, study_files, video_files};
pub use tables::{finite_alone, result_tables, start_residuals_table, states_table, targets_table};

use crate::estimate::Estimate;
use crate::problem::Problem;

/// A file of a result folder: its name and its bytes.
pub type File = (String, Vec<u8>);

/// The vehicles that were left out, and why.
pub fn left_out(problem: &Problem, estimate: &Estimate) -> Vec<String> {
    let vehicles = problem.vehicles.iter().zip(&estimate.vehicles);
    vehicles.filter_map(|(v, e)| Some(format!("{}: {}", v.id, e.left_out.as_ref()?))).collect()
}
