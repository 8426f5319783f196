//! What several test files need.
#![allow(dead_code, missing_docs)]

pub mod drawn;
pub mod drive;
pub mod gross;
pub mod moving;
pub mod photogrammetry;
mod place;
pub mod score;

pub use place::in_package;
use std::path::Path;
use trackbundle::estimate::Estimate;
use trackbundle::internals::refine::{
    Adjusted, Adjustment, NoSolution, ProgressSink, RefineOptions, adjust_network,
};
use trackbundle::problem::Problem;

/// The adjusted unknowns and how they were found.
pub fn refine(
    problem: &Problem,
    start: &Estimate,
    options: &RefineOptions,
    progress: Option<ProgressSink<'_>>,
) -> Result<(Estimate, Adjustment), NoSolution> {
    let Adjusted { estimate, adjustment, .. } = adjust_network(problem, start, options, progress)?;
    Ok((estimate, adjustment))
}

/// The program.
pub fn program() -> assert_cmd::Command {
    let Some(program) = option_env!("CARGO_BIN_EXE_trackbundle") else {
        panic!("integration tests alone know the program")
    };
    assert_cmd::Command::new(program)
}

/// Copies the files and folders of one folder into another, which is made.
pub fn copy_folder(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        let target = to.join(entry.file_name());
        if entry.file_type().unwrap().is_dir() {
            copy_folder(&entry.path(), &target);
        } else {
            std::fs::copy(entry.path(), target).unwrap();
        }
    }
}
