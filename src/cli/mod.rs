//! The command line: arguments, progress, exit codes; one file per command.

// Doc comments of arguments are what the terminal shows, angle brackets and all.
mod check;
mod comparison;
mod comparison_text;
#[cfg(test)]
mod constants;
#[allow(rustdoc::invalid_html_tags)]
mod evaluate;
mod evaluation_folder;
mod initialise;
pub mod interrupts;
mod options;
mod output;
#[allow(rustdoc::invalid_html_tags)]
mod refine;
mod session;
mod simulate;
mod study;
#[allow(rustdoc::invalid_html_tags)]
mod view;

use crate::initialise::NotResectable;
use crate::refine::NoSolution;
use crate::report::folder::PlaceError;
use crate::tables::Findings;
use clap::{CommandFactory, Parser, Subcommand};
use output::tell;
use std::ffi::OsString;
use std::path::PathBuf;

/// Bundle adjustment of moving vehicles filmed from a small drone.
#[derive(Debug, Parser)]
#[command(name = "trackbundle", version, about, long_about = LONG_ABOUT, after_help = EXIT_CODES)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

const LONG_ABOUT: &str = "\
Bundle adjustment of moving vehicles filmed from a small drone.

Reads a problem folder (image points of vehicles and of surveyed targets, a calibrated camera, \
starting poses, a terrain), adjusts the shapes of the vehicles, their poses and the poses of the \
camera together, and leaves a result folder with tables, clouds, a report and a recording for the \
Rerun viewer. The formats are described in docs/formats.md.";

const EXIT_CODES: &str = "\
Exit codes: 0 done, 2 wrong usage, 3 invalid input (findings are printed, nothing is written), \
4 no usable solution (what is missing is named), 1 anything else; 130 and 143 interrupted (SIGINT, SIGTERM).";

#[derive(Debug, Subcommand)]
enum Command {
    /// Validate a problem folder and say what is in it and what is missing for which stage.
    Check(check::Arguments),
    /// Find the first estimate: shapes by direct linear transformation from the starting poses.
    Initialise(initialise::Arguments),
    /// Adjust shapes, vehicle poses and camera poses together.
    Refine(refine::Arguments),
    /// Compare a result with the GNSS tracks and scans of reference/, which are never adjusted to.
    Evaluate(evaluate::Arguments),
    /// Show a problem, its results and its references in the Rerun viewer.
    View(view::Arguments),
    /// Make a problem folder with its truth from a scenario: flight, vehicles, targets and errors.
    Simulate(simulate::Arguments),
    /// Say how accurate results will be, over a grid of scenarios: by covariance, and by Monte Carlo.
    Study(study::Arguments),
    /// Find the flights that reach a wanted accuracy, and the cheapest of them.
    Plan(study::Arguments),
    /// Print completions for a shell: source <(trackbundle completions bash)
    Completions {
        /// The shell.
        shell: clap_complete::Shell,
    },
}

/// Why a command failed, by exit code.
#[derive(Debug)]
enum Failure {
    /// 2: the arguments do not fit.
    Usage(String),
    /// 3: the input is invalid, folder by folder.
    Invalid(Vec<(PathBuf, Findings)>),
    /// 4: there is no usable solution.
    NoSolution(String),
    /// 1: anything else.
    Other(String),
}

impl std::fmt::Display for Failure {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Failure::Usage(message) | Failure::NoSolution(message) | Failure::Other(message) => {
                f.write_str(message)
            }
            Failure::Invalid(folders) => {
                let all = folders.iter().flat_map(|(folder, findings)| {
                    findings.errors().map(move |finding| format!("{}/{finding}", folder.display()))
                });
                f.write_str(&all.collect::<Vec<_>>().join("; "))
            }
        }
    }
}

impl From<PlaceError> for Failure {
    fn from(error: PlaceError) -> Self {
        match error {
            PlaceError::Occupied(..) | PlaceError::Busy(_) => Failure::Usage(error.to_string()),
            PlaceError::Io { .. } => Failure::Other(error.to_string()),
        }
    }
}

impl From<NoSolution> for Failure {
    fn from(error: NoSolution) -> Self {
        Failure::NoSolution(error.to_string())
    }
}

impl From<NotResectable> for Failure {
    fn from(error: NotResectable) -> Self {
        Failure::NoSolution(error.to_string())
    }
}

/// Runs the program with these arguments, its own name first; returns its exit code. What it has to say goes to the
/// standard streams, and no error or panic leaves it.
pub fn run(arguments: impl IntoIterator<Item = impl Into<OsString> + Clone>) -> u8 {
    let given: Vec<OsString> = arguments.into_iter().map(Into::into).collect();
    let arguments = match Arguments::try_parse_from(&given) {
        Ok(arguments) => arguments,
        Err(told) => {
            // Help and the version are told this way too.
            let _ = told.print();
            return told.exit_code().try_into().unwrap_or(2);
        }
    };
    options::set_command(&given);
    let result = std::panic::catch_unwind(|| match &arguments.command {
        Command::Check(arguments) => check::run(arguments),
        Command::Initialise(arguments) => initialise::run(arguments),
        Command::Refine(arguments) => refine::run(arguments),
        Command::Evaluate(arguments) => evaluate::run(arguments),
        Command::View(arguments) => view::run(arguments),
        Command::Simulate(arguments) => simulate::run(arguments),
        Command::Study(arguments) => study::run(arguments),
        Command::Plan(arguments) => study::run_plan(arguments),
        Command::Completions { shell } => {
            let mut script = Vec::new();
            clap_complete::generate(*shell, &mut Arguments::command(), "trackbundle", &mut script);
            output::print(&String::from_utf8_lossy(&script))
        }
    });
    match result {
        Ok(Ok(())) => 0,
        Ok(Err(failure)) => report(&failure),
        // The message of the panic has been printed.
        Err(_) => 1,
    }
}

fn report(failure: &Failure) -> u8 {
    match failure {
        Failure::Usage(message) => {
            tell(format_args!("error: {message}"));
            2
        }
        Failure::Invalid(folders) => {
            for (folder, findings) in folders {
                for line in findings.to_string().lines() {
                    tell(format_args!("error: {}", folder.join(line).display()));
                }
                let count = findings.count();
                let s = if count == 1 { "" } else { "s" };
                tell(format_args!(
                    "{}: {count} finding{s}; nothing was computed or written",
                    folder.display()
                ));
            }
            3
        }
        Failure::NoSolution(message) => {
            tell(format_args!("error: {message}"));
            4
        }
        Failure::Other(message) => {
            tell(format_args!("error: {message}"));
            1
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_arguments_fit_each_other() {
        Arguments::command().debug_assert();
    }
}
