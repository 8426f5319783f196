//! `trackbundle refine`.

use super::Failure;
use super::comparison::{Invalid, ToCompare};
use super::comparison_text::describe;
use super::evaluation_folder::{self, Evaluated};
use super::options::{
    Opened, OutputOptions, command_told, default_result_folder, motion_prior, positive, shape,
};
use super::output::{describe_resection, print, progress};
use super::session::Session;
use crate::evaluate::EvaluateOptions;
use crate::files::InputFile;
use crate::initialise::Method;
use crate::network::{MotionPrior, MotionPriors};
use crate::pipeline::{Judged, Options, Started, start};
use crate::problem::Problem;
use crate::reference::Reference;
use crate::refine::{Adjusted, Arrangement, Fits, Progress, RefineOptions};
use crate::report::folder::{Holds, check_place};
use crate::report::{
    File, Report, evaluation_report, left_out, report_of_adjustment, resection_report, result_tables,
    start_residuals_table, states_table, targets_table,
};
use crate::scene;
use crate::words::Warning;
use clap::Args;
use std::path::{Path, PathBuf};
use trackbundle_solver::loss::{DEFAULT_SHAPE, LossName};
use trackbundle_viz::Iteration;

/// Arguments of the command.
#[derive(Debug, Args)]
pub struct Arguments {
    /// The problem folder
    problem: PathBuf,

    /// Where the result goes; a folder that is there and is not a result is never touched
    /// [default: <PROBLEM>-result]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,

    /// Robust loss of image points: none, huber, cauchy, tukey, geman-mcclure or barron
    #[arg(long, value_name = "NAME", default_value_t = RefineOptions::default().loss)]
    loss: LossName,

    /// Scale of the loss in standard deviations of an image point [default: what keeps 95 % of the
    /// efficiency of least squares on good image points]
    #[arg(long, value_name = "X", value_parser = positive)]
    loss_scale: Option<f64>,

    /// Shape of Barron's loss: 2 squared, 1 like Huber, 0 Cauchy, -2 Geman-McClure, -inf Welsch
    #[arg(long, value_name = "ALPHA", default_value_t = DEFAULT_SHAPE, value_parser = shape, allow_hyphen_values = true)]
    loss_shape: f64,

    /// The most iterations, all rounds together
    #[arg(long, value_name = "N", default_value_t = RefineOptions::default().max_iterations)]
    max_iterations: usize,

    /// Motion prior of vehicles, white noise on acceleration: estimate its strength from the data, off, or
    /// A,B: scatter of the mean acceleration over one second [m/s^2] and of the angular acceleration
    /// [deg/s^2]; jerk:estimate or jerk:A,B for white noise on jerk [m/s^3, deg/s^3]
    #[arg(long, value_name = "PRIOR", default_value = "estimate", value_parser = motion_prior)]
    vehicle_motion: MotionPrior,

    /// Motion prior of the camera, likewise
    #[arg(long, value_name = "PRIOR", default_value = "estimate", value_parser = motion_prior)]
    camera_motion: MotionPrior,

    /// How vehicles are eliminated, without effect on the result: cheapest by counted operations, together
    /// (poses along time, then all shapes) or apart (each vehicle, then the cameras)
    #[arg(long, value_name = "HOW", default_value_t = Arrangement::Cheapest)]
    elimination: Arrangement,

    /// Also write states.csv: position, velocity, acceleration, heading and yaw rate of each vehicle so many
    /// times a second, whatever the frames are
    #[arg(long, value_name = "HZ", value_parser = positive)]
    states: Option<f64>,

    /// Also write what `trackbundle evaluate` writes: the result held against reference/, as a page for people
    /// and files for other tools
    #[arg(long, value_name = "DIR")]
    evaluation: Option<PathBuf>,

    #[command(flatten)]
    output: OutputOptions,
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let output = &arguments.output;
    let target = arguments.target()?;
    let opened = output.open(&arguments.problem, &target)?;
    let problem = &opened.problem;
    let started = start(problem, Method::RobustWhereNeeded)?;
    output.warn(&started.initial.warnings);

    let session = Session::open(output)?;
    session.begin(|| {
        let mut drawn = scene::start(problem, &started.initial.estimate);
        drawn.film = scene::film(problem);
        drawn
    });
    let (judged, iterations) = arguments.adjust(&started, &session)?;
    let Judged { adjusted, diagnosis, verdict, .. } = &judged;
    output.warn(&adjusted.adjustment.warnings);
    if let Err(missing) = diagnosis {
        output.warn(&[*missing]);
    }
    let mut report = arguments.report(&opened, &started, &judged);
    let tables = arguments.tables(&started, &judged);
    let precision = diagnosis.as_ref().ok().map(|found| &found.precision);
    let draw = |report: &Report| {
        let mut drawn = scene::start(problem, &started.initial.estimate);
        // Images would make every result as large as its video.
        drawn.film = output.rrd.as_ref().and_then(|_| scene::film(problem));
        scene::add_end(&mut drawn, problem, &adjusted.estimate, &adjusted.adjustment.fits, precision);
        drawn.iterations = iterations;
        drawn.summary = report.document();
        drawn.warnings.clone_from(&report.warnings);
        drawn
    };
    let written = output.write(&target, &tables, &mut report, draw)?;
    if !output.json && !output.quiet {
        print(&describe_resection(started.initial.resection.as_ref()))?;
        print(&report.facts().summary(&adjusted.adjustment.fits.tally, verdict.as_ref()))?;
        print(&format!("result      {}\n", written.folder.display()))?;
    }
    let Opened { problem, inputs, vehicles, reference, .. } = &opened;
    let inputs = inputs.clone();
    let referenced = Referenced { folder: &arguments.problem, vehicles, reference, inputs };
    compare_with(referenced, problem, &written.folder, arguments)?;
    session.end(written)
}

impl Arguments {
    /// Where the result goes, once it is clear that it may go there.
    fn target(&self) -> Result<PathBuf, Failure> {
        let target = match &self.out {
            Some(folder) => folder.clone(),
            None => default_result_folder(&self.problem)?,
        };
        if let Some(place) = &self.evaluation {
            if *place == target {
                let message =
                    format!("{}: the result and its evaluation need a folder each", target.display());
                return Err(Failure::Usage(message));
            }
            check_place(place, Holds::Evaluation)?;
        }
        Ok(target)
    }

    fn options(&self) -> Options {
        let refine = RefineOptions {
            loss: self.loss,
            loss_scale: self.loss_scale,
            loss_shape: self.loss_shape,
            max_iterations: self.max_iterations,
            arrangement: self.elimination,
            motion: MotionPriors { camera: self.camera_motion, vehicle: self.vehicle_motion },
        };
        Options { refine, states_hz: self.states, ..Options::default() }
    }

    /// Adjusts, telling how far it is; returns the iterations as they are drawn, where they are.
    fn adjust(&self, started: &Started<'_>, session: &Session) -> Result<(Judged, Vec<Iteration>), Failure> {
        let (output, options) = (&self.output, self.options());
        let mut told = progress(output.verbose, output.quiet, options.refine.max_iterations);
        let (is_shown, mut stage, mut iterations) = (output.shows()?, "", Vec::new());
        let mut sink = |progress: Progress<'_>| {
            told(&progress);
            match progress {
                Progress::Round(_, name) => stage = name,
                Progress::Iteration(record, estimate) if is_shown => {
                    let iteration = scene::iteration(started.problem, stage, record, &estimate());
                    session.iteration(&iteration);
                    iterations.push(iteration);
                }
                Progress::Iteration(..) => {}
            }
        };
        let judged = started.adjust(&options, Some(&mut sink))?;
        Ok((judged, iterations))
    }

    fn report(&self, opened: &Opened, started: &Started<'_>, judged: &Judged) -> Report {
        let (problem, initial) = (started.problem, &started.initial);
        let Adjusted { estimate, adjustment, .. } = &judged.adjusted;
        let mut report = report_of_adjustment(problem, adjustment, left_out(problem, estimate));
        if let (Ok(diagnosis), Some(verdict)) = (&judged.diagnosis, &judged.verdict) {
            report.add_diagnosis(problem, diagnosis, verdict);
        }
        report.resection = resection_report(problem, initial.resection.as_ref());
        let from_before = opened.warnings.iter().cloned().map(Warning::Input);
        let from_before = from_before.chain(initial.warnings.iter().cloned().map(Warning::Initial));
        report.warn_before(&from_before.collect::<Vec<_>>());
        report.add_origin(command_told(&self.problem), &opened.inputs);
        report.add_seconds("read", opened.read_s);
        report.add_seconds("initialise", started.initialise_s);
        report.add_seconds("refine", judged.refine_s);
        report.add_seconds("diagnose", judged.diagnose_s);
        report
    }

    fn tables(&self, started: &Started<'_>, judged: &Judged) -> Vec<File> {
        let problem = started.problem;
        let Adjusted { estimate, adjustment, .. } = &judged.adjusted;
        let diagnosis = judged.diagnosis.as_ref().ok();
        let precision = diagnosis.map(|found| &found.precision);
        let mut tables = result_tables(problem, estimate, &adjustment.fits, precision);
        let checks = &adjustment.check_points;
        tables.push(targets_table(problem, estimate, &adjustment.fits, checks, diagnosis));
        let start = Fits::of_start(problem, &started.initial.estimate);
        tables.push(start_residuals_table(problem, &start));
        tables.extend(self.states.map(|rate_hz| states_table(problem, estimate, precision, rate_hz)));
        tables
    }
}

/// A problem folder with what its results are compared with.
struct Referenced<'a> {
    folder: &'a Path,
    vehicles: &'a [String],
    reference: &'a Reference,
    inputs: Vec<InputFile>,
}

/// Holds the result that has just been written against the references: it is read as `evaluate` reads it, and
/// nothing of it changes. Without an evaluation that was asked for a failure is a warning.
fn compare_with(
    referenced: Referenced,
    problem: &Problem,
    result_folder: &Path,
    arguments: &Arguments,
) -> Result<(), Failure> {
    let Referenced { folder, vehicles, reference, inputs } = referenced;
    let output = &arguments.output;
    if arguments.evaluation.is_none()
        && (output.quiet || output.json || reference.tracks.is_empty() && reference.scans.is_empty())
    {
        return Ok(());
    }
    let mut invalid = Invalid::new();
    let frames = Some(problem.frames.as_slice());
    let to_compare = ToCompare::read(folder, result_folder, Some(vehicles), frames, inputs, &mut invalid);
    let (Some(to_compare), true) = (to_compare, invalid.is_empty()) else {
        if arguments.evaluation.is_some() {
            return Err(Failure::Invalid(invalid));
        }
        let told =
            invalid.iter().map(|(folder, found)| format!("not compared: {}: {found}", folder.display()));
        output.warn(&told.collect::<Vec<_>>());
        return Ok(());
    };
    let options = EvaluateOptions::default();
    let compared = to_compare.compare(vehicles, reference, Some(problem), &options);
    let warnings = compared.told();
    output.warn(&warnings);
    if let Some(place) = &arguments.evaluation {
        let json = evaluation_report(folder, result_folder, &compared.evaluation, warnings.clone()).to_json();
        let evaluated = Evaluated {
            result_folder,
            name: &problem.name,
            problem: Some(problem),
            compared: &compared,
            warnings: &warnings,
        };
        evaluation_folder::write(place, &evaluated, &json, &command_told(folder))?;
    }
    if !output.json && !output.quiet && !compared.is_empty() {
        print(&describe(&compared.evaluation, &options))?;
    }
    Ok(())
}
