//! `trackbundle initialise`.

use super::Failure;
use super::options::{Opened, OutputOptions, command_told};
use super::output::{counted, describe_resection, grouped, print};
use super::session::Session;
use crate::diagnose::observability::{describe, observability};
use crate::initialise::{Method, initialise};
use crate::refine::Fits;
use crate::report::{
    Report, left_out, report_of_initial, result_tables, start_residuals_table, targets_table,
};
use crate::scene;
use crate::words::Warning;
use clap::{Args, ValueEnum};
use std::path::PathBuf;
use std::time::Instant;

/// Arguments of the command.
#[derive(Debug, Args)]
pub struct Arguments {
    /// The problem folder
    problem: PathBuf,

    /// Where the result goes; a folder that is there and is not a result is never touched
    #[arg(long, value_name = "DIR")]
    out: PathBuf,

    /// How shapes are found
    #[arg(long, value_enum, default_value_t = Dlt::Robust)]
    dlt: Dlt,

    #[command(flatten)]
    output: OutputOptions,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Dlt {
    /// Least squares, and a Huber fit where that leaves large residuals
    Robust,
    /// Least squares alone
    Plain,
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let output = &arguments.output;
    let (opened, mut staged) = output.open(&arguments.problem, &arguments.out)?;
    let Opened { problem, warnings, inputs, read_s, .. } = opened;

    let begin = Instant::now();
    let method = match arguments.dlt {
        Dlt::Robust => Method::RobustWhereNeeded,
        Dlt::Plain => Method::Plain,
    };
    let initial = initialise(&problem, method)?;
    output.warn(&initial.warnings);
    if !initial.estimate.is_finite() {
        return Err(Failure::NoSolution("a starting value is out of all proportion".to_owned()));
    }
    let fits = Fits::of_start(&problem, &initial.estimate);
    let mut report = report_of_initial(&problem, &initial, left_out(&problem, &initial.estimate));
    let open = observability(&problem, &initial.estimate);
    report.add_observability(&open);
    let warnings: Vec<Warning> = warnings.into_iter().map(Warning::Input).collect();
    report.warn_before(&warnings);
    report.add_origin(command_told(&arguments.problem), &inputs);
    report.add_seconds("read", read_s);
    report.add_seconds("initialise", begin.elapsed().as_secs_f64());
    let mut tables = result_tables(&problem, &initial.estimate, &fits, None);
    tables.push(targets_table(&problem, &initial.estimate, &fits, &[], None));
    tables.push(start_residuals_table(&problem, &fits));
    let session = Session::open(output)?;
    let draw = |report: &Report| {
        let mut drawn = scene::start(&problem, &initial.estimate);
        session.begin(|| drawn.clone());
        scene::add_end(&mut drawn, &problem, &initial.estimate, &fits, None);
        drawn.summary = report.document();
        drawn.warnings.clone_from(&report.warnings);
        drawn
    };
    let written = output.write(&mut staged, tables, &mut report, draw)?;
    if !output.json && !output.quiet {
        let mut text = String::new();
        for (vehicle, estimate) in problem.vehicles.iter().zip(&initial.estimate.vehicles) {
            let found = estimate.points.iter().flatten().count();
            text += &format!(
                "vehicle     {}: {} of {} have coordinates\n",
                vehicle.id,
                grouped(found),
                counted(vehicle.points.len(), "point")
            );
        }
        text += &describe_resection(initial.resection.as_ref());
        text += &describe(&open);
        text += &format!("robust fit  of {}\n", counted(initial.robust_points, "point"));
        text += &format!("result      {}\n", written.folder.display());
        print(&text)?;
    }
    session.end(output, written, &mut staged, &mut report)
}
