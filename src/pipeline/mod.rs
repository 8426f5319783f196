//! The whole run as one call: read, initialise, adjust, diagnose, judge.
//!
//! ```text
//! folder -> Problem -> start -> Started -> adjust -> Judged        adjust_folder: all of it, as an Outcome
//! ```
//!
//! The program, studies, benchmarks and tests run through here. What a result is compared with is not seen from here.

mod outcome;

pub use crate::diagnose::NoSigmas;
pub use outcome::{Outcome, Seconds, TrackPlace};

use crate::diagnose::{Diagnosis, Verdict, diagnose_with_states};
use crate::files::{Folder, read_problem};
use crate::initialise::{Initial, Method, NotResectable, initialise};
use crate::problem::{Faults, Problem};
use crate::refine::{Adjusted, NoSolution, ProgressSink, RefineOptions, adjust_network};
use crate::tables::Findings;
use std::any::Any;
use std::fmt;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::time::Instant;

/// What a user may choose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// How first shapes are found.
    pub method: Method,
    /// The adjustment.
    pub refine: RefineOptions,
    /// Standard deviations of the path between poses, so many times a second; `None`: of poses alone.
    pub states_hz: Option<f64>,
}

impl Default for Options {
    fn default() -> Self {
        Options { method: Method::RobustWhereNeeded, refine: RefineOptions::default(), states_hz: None }
    }
}

/// Why there is no result.
#[derive(Clone, Debug)]
pub enum Error {
    /// The folder is not valid: every finding with its file, line and column.
    Invalid(Findings),
    /// The problem was built with values that it must not have.
    Faulty(Faults),
    /// The problem needs what this version does not compute.
    NotComputed(Vec<String>),
    /// No camera pose can be found.
    NotResectable(NotResectable),
    /// The adjustment has no solution.
    NoSolution(NoSolution),
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Error::Invalid(findings) => findings.fmt(f),
            Error::Faulty(faults) => faults.fmt(f),
            Error::NotComputed(missing) => {
                write!(f, "this problem needs what this version does not compute: {}", missing.join("; "))
            }
            Error::NotResectable(why) => why.fmt(f),
            Error::NoSolution(why) => why.fmt(f),
        }
    }
}

impl std::error::Error for Error {}

impl From<NotResectable> for Error {
    fn from(error: NotResectable) -> Self {
        Error::NotResectable(error)
    }
}

impl From<NoSolution> for Error {
    fn from(error: NoSolution) -> Self {
        Error::NoSolution(error)
    }
}

/// A problem with its first estimate.
pub struct Started<'a> {
    /// The problem.
    pub problem: &'a Problem,
    /// The first estimate.
    pub initial: Initial,
    /// How long it took \[s\].
    pub initialise_s: f64,
}

/// An adjustment with what can be said of it.
pub struct Judged {
    /// The adjusted unknowns, how they were found, and the least squares behind them.
    pub adjusted: Adjusted,
    /// Standard deviations, observability, tests.
    pub diagnosis: Result<Diagnosis, NoSigmas>,
    /// Whether the result can be relied on; without a diagnosis it cannot.
    pub verdict: Verdict,
    /// How long the adjustment took \[s\].
    pub refine_s: f64,
    /// How long the diagnosis took \[s\].
    pub diagnose_s: f64,
}

/// Finds the first estimate of a problem: the first part of a run that is followed.
///
/// ```
/// use trackbundle::{Options, Progress, adjust_folder, start};
///
/// let problem = adjust_folder("problems/tiny", &Options::default())?.problem;
/// let options = Options::default();
/// let started = start(&problem, options.method)?;
/// let mut rounds = Vec::new();
/// let mut watch = |progress: Progress<'_>| {
///     if let Progress::Round(_, name) = progress {
///         rounds.push(name);
///     }
/// };
/// let judged = started.adjust(&options, Some(&mut watch))?;
/// assert_eq!(rounds.len(), judged.adjusted.adjustment.rounds.len());
/// # Ok::<(), trackbundle::Error>(())
/// ```
///
/// # Errors
///
/// Why no camera pose can be had.
pub fn start(problem: &Problem, method: Method) -> Result<Started<'_>, NotResectable> {
    let begin = Instant::now();
    let initial = initialise(problem, method)?;
    Ok(Started { problem, initial, initialise_s: begin.elapsed().as_secs_f64() })
}

impl Started<'_> {
    /// The adjustment alone.
    pub fn refine(
        &self,
        options: &RefineOptions,
        progress: Option<ProgressSink<'_>>,
    ) -> Result<Adjusted, NoSolution> {
        adjust_network(self.problem, &self.initial.estimate, options, progress)
    }

    /// The adjustment, its diagnosis and its verdict.
    pub fn adjust(
        &self,
        options: &Options,
        progress: Option<ProgressSink<'_>>,
    ) -> Result<Judged, NoSolution> {
        let begin = Instant::now();
        let adjusted = self.refine(&options.refine, progress)?;
        let refine_s = begin.elapsed().as_secs_f64();
        Ok(Judged { refine_s, ..self.judge(adjusted, options.states_hz) })
    }

    /// The diagnosis and the verdict of an adjustment; `states_hz` is that of [`Options`], `refine_s` of what is
    /// returned is zero. A diagnosis that fails in a way that was not foreseen costs standard deviations, not the
    /// adjustment.
    pub fn judge(&self, mut adjusted: Adjusted, states_hz: Option<f64>) -> Judged {
        let begin = Instant::now();
        let diagnose = AssertUnwindSafe(|| diagnose_with_states(self.problem, &mut adjusted, states_hz));
        let diagnosis = match catch_unwind(diagnose) {
            Ok(None) => Err(NoSigmas::NoLeastSquares),
            Ok(Some(found)) => found.map_err(NoSigmas::NoCovariance),
            Err(panic) => Err(NoSigmas::Failed(told(&*panic))),
        };
        let verdict = match &diagnosis {
            Ok(found) => Verdict::new(self.problem, &adjusted.adjustment, found),
            Err(why) => Verdict::not_diagnosed(&adjusted.adjustment, why.clone()),
        };
        let diagnose_s = begin.elapsed().as_secs_f64();
        Judged { adjusted, diagnosis, verdict, refine_s: 0.0, diagnose_s }
    }
}

/// Does something that must not cost what is done already; if it fails, or panics, the error says why.
pub fn guarded<T>(step: impl FnOnce() -> Result<T, String>) -> Result<T, String> {
    catch_unwind(AssertUnwindSafe(step)).unwrap_or_else(|panic| Err(told(&*panic)))
}

/// What a panic says.
fn told(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
    let text = text.or_else(|| panic.downcast_ref::<String>().cloned());
    text.unwrap_or_else(|| "it does not say why".to_owned())
}

/// Reads a problem folder and adjusts it.
///
/// ```
/// use trackbundle::{Error, Options, adjust_folder};
///
/// let outcome = adjust_folder("problems/tiny", &Options::default())?;
/// assert!(outcome.adjustment().sigma0.is_some());
///
/// let Err(Error::Invalid(findings)) = adjust_folder("problems/no-such-folder", &Options::default()) else {
///     panic!("a folder that is not there is not valid")
/// };
/// println!("{findings}");
/// # Ok::<(), Error>(())
/// ```
///
/// # Errors
///
/// [`Error::Invalid`] with every finding where the folder is not valid, [`Error::NotComputed`] where it needs what
/// this version has not, [`Error::NotResectable`] and [`Error::NoSolution`] where nothing can be computed from it.
pub fn adjust_folder(folder: impl AsRef<Path>, options: &Options) -> Result<Outcome, Error> {
    let begin = Instant::now();
    let Folder { problem, warnings, .. } = read_problem(folder.as_ref()).map_err(Error::Invalid)?;
    let problem = problem.map_err(Error::NotComputed)?;
    let read_s = begin.elapsed().as_secs_f64();
    let mut outcome = run(problem, options)?;
    outcome.input_warnings = warnings;
    outcome.seconds.read = read_s;
    Ok(outcome)
}

/// Adjusts a problem that was built in memory, once it is clear that it is one. `examples/problem_in_memory.rs` builds
/// one from nothing.
///
/// ```
/// use trackbundle::{Error, Options, adjust_folder, adjust_problem};
///
/// let mut problem = adjust_folder("problems/tiny", &Options::default())?.problem;
/// problem.vehicles[0].observations[0].sigma_px = 0.0;
/// let Err(Error::Faulty(faults)) = adjust_problem(problem, &Options::default()) else {
///     panic!("an image point needs a standard deviation above zero")
/// };
/// println!("{faults}");
/// # Ok::<(), Error>(())
/// ```
///
/// # Errors
///
/// [`Error::Faulty`] where an index is out of range, a number is not finite, or the like; else as [`adjust_folder`].
pub fn adjust_problem(problem: Problem, options: &Options) -> Result<Outcome, Error> {
    problem.check().map_err(Error::Faulty)?;
    run(problem, options)
}

fn run(problem: Problem, options: &Options) -> Result<Outcome, Error> {
    let started = start(&problem, options.method)?;
    let judged = started.adjust(options, None)?;
    let Started { initial, initialise_s, .. } = started;
    let Judged { adjusted, diagnosis, verdict, refine_s, diagnose_s } = judged;
    let seconds = Seconds { read: 0.0, initialise: initialise_s, refine: refine_s, diagnose: diagnose_s };
    Ok(Outcome { problem, initial, adjusted, diagnosis, verdict, input_warnings: Vec::new(), seconds })
}
