//! `trackbundle refine`.

use super::Failure;
use super::comparison::{Invalid, ToCompare};
use super::comparison_text::describe;
use super::evaluation_folder::{self, Evaluated};
use super::options::{
    Opened, OutputOptions, command_told, default_result_folder, motion_prior, positive, shape, take_place,
};
use super::output::{counted, describe_resection, print, progress};
use super::session::Session;
use crate::diagnose::{Diagnosis, NoSigmas, Verdict};
use crate::disk::InputFile;
use crate::evaluate::EvaluateOptions;
use crate::initialise::Method;
use crate::network::{MotionPrior, MotionPriors};
use crate::pipeline::{Judged, Started, guarded, start};
use crate::problem::Problem;
use crate::reference::Reference;
use crate::refine::{Adjusted, Arrangement, Fits, Progress, RefineOptions};
use crate::report::folder::{Holds, Staged};
use crate::report::{
    File, Report, evaluation_report, left_out, report_of_adjustment, resection_report, result_tables,
    start_residuals_table, states_table, targets_table,
};
use crate::scene;
use crate::words::Warning;
use clap::Args;
use std::path::{Path, PathBuf};
use std::time::Instant;
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

/// A path that is told between frames may have so many rows.
const MOST_STATES: f64 = 1e7;

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let output = &arguments.output;
    let (target, evaluation) = arguments.places()?;
    let (opened, mut staged) = output.open(&arguments.problem, &target)?;
    let problem = &opened.problem;
    arguments.check_states(problem)?;
    let started = start(problem, Method::RobustWhereNeeded)?;
    output.warn(&started.initial.warnings);

    let session = Session::open(output)?;
    session.begin(|| {
        let mut drawn = scene::start(problem, &started.initial.estimate);
        drawn.film = scene::film(problem);
        drawn
    });
    let (adjusted, refine_s, iterations) = arguments.adjust(&started, &session)?;
    output.warn(&adjusted.adjustment.warnings);
    // From here on the adjustment is not lost, whatever fails.
    let mut report = arguments.report(&opened, &started, &adjusted, refine_s);
    let mut preliminary = report.clone();
    preliminary.add_verdict(&Verdict::not_diagnosed(&adjusted.adjustment, NoSigmas::NotReached));
    output.keep(&mut staged, arguments.tables(&started, &adjusted, None), &mut preliminary)?;
    drop(preliminary);

    let judged = started.judge(adjusted, arguments.states);
    let Judged { adjusted, diagnosis, verdict, diagnose_s, .. } = &judged;
    if let Err(missing) = diagnosis {
        output.warn(&[missing]);
    }
    report.add_judged(problem, diagnosis, verdict);
    report.add_seconds("diagnose", *diagnose_s);
    let diagnosis = diagnosis.as_ref().ok();
    let tables = arguments.tables(&started, adjusted, diagnosis);
    let draw = |report: &Report| {
        let mut drawn = scene::start(problem, &started.initial.estimate);
        // Images would make every result as large as its video.
        drawn.film = output.rrd.as_ref().and_then(|_| scene::film(problem));
        let precision = diagnosis.map(|found| &found.precision);
        scene::add_end(&mut drawn, problem, &adjusted.estimate, &adjusted.adjustment.fits, precision);
        drawn.iterations = iterations;
        drawn.summary = report.document();
        drawn.warnings.clone_from(&report.warnings);
        drawn
    };
    let written = output.write(&mut staged, tables, &mut report, draw)?;
    if !output.json && !output.quiet {
        print(&describe_resection(started.initial.resection.as_ref()))?;
        print(&report.facts().summary(&adjusted.adjustment.fits.tally, verdict))?;
        print(&format!("result      {}\n", written.folder.display()))?;
    }
    let Opened { problem, inputs, vehicles, reference, .. } = &opened;
    let inputs = inputs.clone();
    let referenced = Referenced { folder: &arguments.problem, vehicles, reference, inputs };
    let compare = || compare_with(referenced, problem, &written.folder, arguments, evaluation);
    if let Err(why) = guarded(|| compare().map_err(|failure| failure.to_string())) {
        report.fail("comparison", why);
    }
    session.end(output, written, &mut staged, &mut report)
}

impl Arguments {
    /// Where the result goes, and the place of its evaluation if one is asked for.
    fn places(&self) -> Result<(PathBuf, Option<Staged>), Failure> {
        let target = match &self.out {
            Some(folder) => folder.clone(),
            None => default_result_folder(&self.problem)?,
        };
        let Some(place) = &self.evaluation else { return Ok((target, None)) };
        if *place == target {
            let message = format!("{}: the result and its evaluation need a folder each", target.display());
            return Err(Failure::Usage(message));
        }
        let evaluation = take_place(place, Holds::Evaluation)?;
        Ok((target, Some(evaluation)))
    }

    /// Refuses a path of more rows than anyone can use.
    fn check_states(&self, problem: &Problem) -> Result<(), Failure> {
        let times = problem.frames.first().zip(problem.frames.last());
        let span_s = times.map_or(0.0, |(first, last)| last.time_s - first.time_s);
        let rows = |rate_hz: f64| rate_hz * span_s * problem.vehicles.len() as f64;
        match self.states {
            Some(rate_hz) if rows(rate_hz) > MOST_STATES => Err(Failure::Usage(format!(
                "--states {rate_hz}: {:.1e} rows over {span_s} s of {}, at most {MOST_STATES:.0e} are written",
                rows(rate_hz),
                counted(problem.vehicles.len(), "vehicle")
            ))),
            _ => Ok(()),
        }
    }

    fn options(&self) -> RefineOptions {
        RefineOptions {
            loss: self.loss,
            loss_scale: self.loss_scale,
            loss_shape: self.loss_shape,
            max_iterations: self.max_iterations,
            arrangement: self.elimination,
            motion: MotionPriors { camera: self.camera_motion, vehicle: self.vehicle_motion },
        }
    }

    /// Adjusts, telling how far it is; returns how long it took \[s\], and the iterations as they are drawn, where they
    /// are.
    fn adjust(
        &self,
        started: &Started<'_>,
        session: &Session,
    ) -> Result<(Adjusted, f64, Vec<Iteration>), Failure> {
        let begin = Instant::now();
        let (output, options) = (&self.output, self.options());
        let mut told = progress(output.verbose, output.quiet, options.max_iterations);
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
        let adjusted = started.refine(&options, Some(&mut sink))?;
        Ok((adjusted, begin.elapsed().as_secs_f64(), iterations))
    }

    /// The report of an adjustment that is not judged yet.
    fn report(&self, opened: &Opened, started: &Started<'_>, adjusted: &Adjusted, refine_s: f64) -> Report {
        let (problem, initial) = (started.problem, &started.initial);
        let Adjusted { estimate, adjustment, .. } = adjusted;
        let mut report = report_of_adjustment(problem, adjustment, left_out(problem, estimate));
        report.resection = resection_report(problem, initial.resection.as_ref());
        let from_before = opened.warnings.iter().cloned().map(Warning::Input);
        let from_before = from_before.chain(initial.warnings.iter().cloned().map(Warning::Initial));
        report.warn_before(&from_before.collect::<Vec<_>>());
        report.add_origin(command_told(&self.problem), &opened.inputs);
        report.add_seconds("read", opened.read_s);
        report.add_seconds("initialise", started.initialise_s);
        report.add_seconds("refine", refine_s);
        report
    }

    fn tables(&self, started: &Started<'_>, adjusted: &Adjusted, diagnosis: Option<&Diagnosis>) -> Vec<File> {
        let problem = started.problem;
        let Adjusted { estimate, adjustment, .. } = adjusted;
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
    evaluation: Option<Staged>,
) -> Result<(), Failure> {
    let Referenced { folder, vehicles, reference, inputs } = referenced;
    let output = &arguments.output;
    if evaluation.is_none()
        && (output.quiet || output.json || reference.tracks.is_empty() && reference.scans.is_empty())
    {
        return Ok(());
    }
    let mut invalid = Invalid::new();
    let frames = Some(problem.frames.as_slice());
    let to_compare = ToCompare::read(folder, result_folder, Some(vehicles), frames, inputs, &mut invalid);
    let (Some(to_compare), true) = (to_compare, invalid.is_empty()) else {
        if evaluation.is_some() {
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
    if let Some(mut staged) = evaluation {
        let mut json = evaluation_report(folder, result_folder, &compared.evaluation, warnings.clone());
        let evaluated = Evaluated {
            result_folder,
            name: &problem.name,
            problem: Some(problem),
            compared: &compared,
            warnings: &warnings,
        };
        evaluation_folder::write(&mut staged, &evaluated, &mut json, &command_told(folder))?;
    }
    if !output.json && !output.quiet && !compared.is_empty() {
        print(&describe(&compared.evaluation, &options))?;
    }
    Ok(())
}
