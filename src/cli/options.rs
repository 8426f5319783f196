//! Options that several commands share, and how they are read.

use super::Failure;
use super::interrupts;
use super::output::{tell, warn_all};
use crate::disk::{self, InputFile};
use crate::files::{self, Folder, Inventory};
use crate::pipeline::guarded;
use crate::problem::Problem;
use crate::reference::{self, Reference};
use crate::refine::{MotionPrior, Order, Strengths};
use crate::report::folder::{Holds, PlaceError, Staged, whole_file, whole_file_can_be};
use crate::report::{File, Report, finite_alone};
use crate::words::Warning;
use clap::Args;
use std::cell::RefCell;
use std::ffi::OsString;
use std::fmt::Display;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::time::Instant;
use trackbundle_viz::{Layout, Scene, Viewer, save};

/// The recording of a result.
const RECORDING: &str = "session.rrd";
/// How a recording begins.
const RECORDING_MAGIC: [u8; 3] = *b"RRF";

/// Where results go and what is said on the way.
#[derive(Debug, Args)]
pub struct OutputOptions {
    /// Threads to compute with; their number does not change the result [default: all cores]
    #[arg(long, value_name = "N", value_parser = thread_range())]
    pub threads: Option<u16>,

    /// Write the Rerun recording to this file instead of session.rrd in the result folder; an older
    /// recording there is replaced, nothing else is
    #[arg(long, value_name = "FILE", conflicts_with = "no_rrd")]
    pub rrd: Option<PathBuf>,

    /// Write no Rerun recording
    #[arg(long)]
    pub no_rrd: bool,

    #[command(flatten)]
    pub viewer: ViewerOptions,

    /// Print the report to standard output as JSON
    #[arg(long)]
    pub json: bool,

    /// Print neither progress nor warnings nor a summary; errors are always printed
    #[arg(long, short, conflicts_with = "verbose")]
    pub quiet: bool,

    /// Print a line for each iteration to standard error
    #[arg(long, short)]
    pub verbose: bool,
}

/// A session that is seen while the command runs.
#[derive(Debug, Args)]
pub struct ViewerOptions {
    /// Show it in the Rerun viewer, which is started unless one already listens on this machine (refine: live,
    /// iteration by iteration; view: the default without --rrd and --connect)
    #[arg(long, conflicts_with = "connect")]
    spawn: bool,

    /// Show it in a Rerun viewer that is already running [default URL: rerun+http://127.0.0.1:9876/proxy]
    #[arg(
        long,
        value_name = "URL",
        num_args = 0..=1,
        default_missing_value = trackbundle_viz::DEFAULT_URL,
        value_parser = viewer_url
    )]
    connect: Option<String>,
}

impl ViewerOptions {
    /// The viewer that is asked for, if one is.
    pub fn viewer(&self) -> Result<Option<Viewer>, Failure> {
        let viewer = match &self.connect {
            Some(url) => Some(Viewer::At(url.clone())),
            None => self.spawn.then_some(Viewer::Spawned),
        };
        if viewer.is_some() && !trackbundle_viz::RECORDS {
            return Err(without_rerun("--spawn and --connect"));
        }
        Ok(viewer)
    }
}

/// Reads the address of a viewer.
fn viewer_url(text: &str) -> Result<String, String> {
    if text.contains("://") {
        Ok(text.to_owned())
    } else {
        Err(format!(
            "wanted a URL such as {}; without one, --connect comes last",
            trackbundle_viz::DEFAULT_URL
        ))
    }
}

/// A build that cannot show anything was asked to.
pub fn without_rerun(what: &str) -> Failure {
    Failure::Usage(format!("this build has no Rerun (feature \"viewer\"), so {what} cannot be used"))
}

/// The largest number of threads that may be asked for: beyond it starting them takes longer than they save.
const MOST_THREADS: i64 = 256;

/// Reads a number of threads.
pub fn thread_range() -> clap::builder::RangedI64ValueParser<u16> {
    clap::value_parser!(u16).range(1..=MOST_THREADS)
}

/// Address space of the program itself, and of each thread beside the matrices that it works on \[byte\].
const OWN_ADDRESSES: [u64; 2] = [300 << 20, 80 << 20];
/// The largest cache of a processor, where the system does not tell it \[byte\].
const USUAL_CACHE: u64 = 32 << 20;

/// How many threads fit into an address space, and how much of it the first needs \[byte\]: matrix kernels keep room
/// for two matrices of the size of the largest cache for each thread, and for the one that all of them begin from.
fn threads_within(address_space: u64, cache: u64) -> (u64, u64) {
    let [program, thread] = OWN_ADDRESSES;
    let each = thread + 2 * cache;
    ((address_space.saturating_sub(program) / each).saturating_sub(1), program + 2 * each)
}

/// Sets the number of threads of this process: all cores where none is given, and no more than its address space is for.
pub fn set_threads(threads: Option<u16>) -> Result<(), Failure> {
    let mut threads = match threads {
        Some(threads) => usize::from(threads),
        None => std::thread::available_parallelism().map_or(1, usize::from),
    };
    if let Some(limit) = disk::address_space_limit() {
        let (fitting, least) = threads_within(limit, disk::largest_cache().unwrap_or(USUAL_CACHE));
        if fitting == 0 {
            tell(format_args!(
                "warning: the address space of this process is limited to {} MB (ulimit -v), and large matrices need {} MB of it",
                limit >> 20,
                least >> 20
            ));
        }
        threads = threads.min(usize::try_from(fitting).unwrap_or(usize::MAX).max(1));
    }
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build_global()
        .map_err(|error| Failure::Other(format!("the threads could not be started: {error}")))
}

/// What a command has written.
pub struct Written {
    /// The result folder.
    pub folder: PathBuf,
    /// What is to be seen, where it is shown.
    pub scene: Option<Scene>,
}

/// The file of a result that says what it is.
const REPORT: &str = "report.json";

/// Takes the place of a folder before anything is computed.
pub fn take_place(target: &Path, holds: Holds) -> Result<Staged, PlaceError> {
    let staged = Staged::begin(target, holds)?;
    for cleared in staged.cleared() {
        tell(format_args!("warning: {}: left by a run that was cut off, and removed", cleared.display()));
    }
    Ok(staged)
}

/// Puts a folder in its place.
pub fn put_in_place(staged: &mut Staged) -> Result<PathBuf, Failure> {
    let published = staged.publish().map_err(|error| not_written(staged, error))?;
    if let Some((left, why)) = &published.not_removed {
        let (left, target) = (left.display(), staged.target().display());
        tell(format_args!("warning: {left}: what stood in {target} before could not be removed: {why}"));
    }
    Ok(published.path)
}

/// Why a folder could not be written.
pub fn not_written(staged: &Staged, why: std::io::Error) -> Failure {
    Failure::Other(format!("{}: {why}", staged.target().display()))
}

/// Writes files of a folder.
pub fn write_files(staged: &mut Staged, files: &[File]) -> Result<(), Failure> {
    files.iter().try_for_each(|file| staged.write(file)).map_err(|error| not_written(staged, error))
}

/// Writes the report of a folder, with the names of all that is in it.
fn write_report(staged: &mut Staged, report: &mut Report) -> std::io::Result<()> {
    report.files = staged.files();
    staged.write_known(report.to_json())
}

impl OutputOptions {
    /// Sets the number of threads of this process.
    fn set_threads(&self) -> Result<(), Failure> {
        set_threads(self.threads)
    }

    /// Whether a recording is written.
    fn records(&self) -> Result<bool, Failure> {
        match &self.rrd {
            _ if trackbundle_viz::RECORDS => Ok(!self.no_rrd),
            Some(_) => Err(without_rerun("--rrd")),
            None => Ok(false),
        }
    }

    /// Whether anything is recorded or shown.
    pub fn shows(&self) -> Result<bool, Failure> {
        Ok(self.records()? || self.viewer.viewer()?.is_some())
    }

    /// Makes a result safe before anything else that may fail is done with it.
    pub fn keep(
        &self,
        staged: &mut Staged,
        mut tables: Vec<File>,
        report: &mut Report,
    ) -> Result<(), Failure> {
        finite_alone(&mut tables);
        write_files(staged, &tables)?;
        write_report(staged, report).map_err(|error| not_written(staged, error))?;
        let folder = put_in_place(staged)?;
        interrupts::stands(format!(
            "the adjustment stands in {}, without a diagnosis: do not rely on it",
            folder.display()
        ));
        Ok(())
    }

    /// Writes a result folder: all of it or nothing. `draw` makes the scene to show, if one is. A recording that
    /// fails costs nothing else.
    pub fn write(
        &self,
        staged: &mut Staged,
        mut tables: Vec<File>,
        report: &mut Report,
        draw: impl FnOnce(&Report) -> Scene,
    ) -> Result<Written, Failure> {
        let not_finite = finite_alone(&mut tables);
        self.warn(&not_finite);
        not_finite.iter().for_each(|warning| report.warn(warning));
        let begin = Instant::now();
        let is_recorded = self.records()? && self.rrd.is_none();
        let drawn = if self.shows()? { guarded(|| Ok(draw(report))).map(Some) } else { Ok(None) };
        write_files(staged, &tables)?;
        // The largest file comes when the others are there, and goes where the disk is too small for both.
        let recorded = match &drawn {
            Ok(Some(scene)) if is_recorded => {
                let recorded = guarded(|| {
                    let file = staged.path(RECORDING).map_err(|error| error.to_string())?;
                    save(std::slice::from_ref(scene), Layout::Overview, &file)
                        .map_err(|error| error.to_string())
                });
                report.add_seconds("recording", begin.elapsed().as_secs_f64());
                recorded
            }
            Ok(None) if !self.no_rrd => {
                report.warn(&Warning::NoRecorder);
                Ok(())
            }
            Ok(_) => Ok(()),
            Err(why) => Err(why.clone()),
        };
        let recorded = match recorded.map(|()| write_report(staged, report)) {
            Ok(Err(error)) if !is_recorded => return Err(not_written(staged, error)),
            Ok(written) => written.map_err(|error| error.to_string()),
            Err(why) => Err(why),
        };
        if let Err(why) = recorded {
            // Half of a recording is of no use.
            staged.take_back(REPORT);
            staged.take_back(RECORDING);
            report.warn(&Warning::NoRecording { why: why.clone() });
            report.fail("recording", format!("{RECORDING}: {why}"));
            write_report(staged, report).map_err(|error| not_written(staged, error))?;
        }
        let folder = put_in_place(staged)?;
        interrupts::stands(format!("the result in {} is complete", folder.display()));
        let scene = drawn.unwrap_or(None);
        if let (Some(scene), Some(file)) = (&scene, &self.rrd)
            && let Err(why) = guarded(|| save_whole(std::slice::from_ref(scene), Layout::Overview, file))
        {
            report.fail("recording", why);
        }
        Ok(Written { folder, scene })
    }

    /// Prints warnings, unless the user wants quiet.
    pub fn warn<W: Display>(&self, warnings: &[W]) {
        if !self.quiet {
            warn_all(warnings);
        }
    }
}

/// Refuses a place for a recording where something else stands.
pub fn check_recording_place(file: &Path) -> Result<(), Failure> {
    let is_recording = || {
        let mut magic = [0; 3];
        let read = std::fs::File::open(file).and_then(|mut file| file.read_exact(&mut magic));
        read.is_ok() && magic == RECORDING_MAGIC
    };
    match std::fs::metadata(file) {
        Ok(found) if !(found.is_file() && (found.len() == 0 || is_recording())) => {
            Err(Failure::Usage(format!("{} exists and is no recording; it is left as it is", file.display())))
        }
        // That one can be made is tried now, not when it is there.
        _ => Ok(whole_file_can_be(file)?),
    }
}

/// Writes a recording to a file of its own.
pub fn save_whole(scenes: &[Scene], layout: Layout, file: &Path) -> Result<(), String> {
    whole_file(file, |place| save(scenes, layout, place))
}

/// Options that change no number of a result, and whether a value follows.
const WITHOUT_EFFECT: [(&str, bool); 12] = [
    ("--out", true),
    ("--evaluation", true),
    ("--threads", true),
    ("--rrd", true),
    ("--no-rrd", false),
    ("--spawn", false),
    ("--json", false),
    ("--quiet", false),
    ("-q", false),
    ("--verbose", false),
    ("-v", false),
    ("--elimination", true),
];

thread_local! {
    /// The arguments that the program runs with, without its own name.
    static COMMAND: RefCell<Vec<OsString>> = const { RefCell::new(Vec::new()) };
}

/// Keeps the arguments of the program for [`command_told`].
pub fn set_command(arguments: &[OsString]) {
    COMMAND.set(arguments.iter().skip(1).cloned().collect());
}

/// The command as it was given.
pub fn command_given() -> String {
    let arguments = COMMAND.with_borrow(Clone::clone).into_iter();
    let arguments = arguments.map(|argument| argument.to_string_lossy().into_owned());
    std::iter::once("trackbundle".to_owned()).chain(arguments).collect::<Vec<_>>().join(" ")
}

/// The command as a report quotes it: without places, and without options that change no number, so that equal
/// results have equal reports.
pub fn command_told(problem: &Path) -> String {
    told(COMMAND.with_borrow(Clone::clone).into_iter(), problem)
}

fn told(arguments: impl Iterator<Item = OsString>, problem: &Path) -> String {
    let mut told = vec!["trackbundle".to_owned()];
    let mut arguments = arguments.peekable();
    while let Some(given) = arguments.next() {
        let argument = given.to_string_lossy();
        let name = argument.split('=').next().unwrap_or_default();
        if name == "--connect" {
            // Its value may be missing.
            arguments.next_if(|next| !argument.contains('=') && next.to_string_lossy().contains("://"));
        } else if let Some((_, has_value)) = WITHOUT_EFFECT.iter().find(|(option, _)| *option == name) {
            if *has_value && !argument.contains('=') {
                arguments.next();
            }
        } else if Path::new(&given) == problem {
            told.push("PROBLEM".to_owned());
        } else {
            told.push(argument.into_owned());
        }
    }
    told.join(" ")
}

/// A problem folder with its references, all of it valid.
pub struct Input {
    /// What is there.
    pub inventory: Inventory,
    /// The problem, or what it needs that this version does not compute.
    pub problem: Result<Problem, Vec<String>>,
    /// What it is compared with.
    pub reference: Reference,
    /// What is odd.
    pub warnings: Vec<String>,
    /// The files that an adjustment reads, as they were read.
    pub inputs: Vec<InputFile>,
}

/// A problem that can be computed.
pub struct Opened {
    /// The problem.
    pub problem: Problem,
    /// What is odd in its folder.
    pub warnings: Vec<String>,
    /// The files that it is from.
    pub inputs: Vec<InputFile>,
    /// Its vehicles.
    pub vehicles: Vec<String>,
    /// What the result will be compared with, once it is written.
    pub reference: Reference,
    /// How long it took to read \[s\].
    pub read_s: f64,
}

impl OutputOptions {
    /// Reads the problem of a command that will leave a result at `target`, once it is clear that
    /// the result has a place, which is taken.
    pub fn open(&self, folder: &Path, target: &Path) -> Result<(Opened, Staged), Failure> {
        self.shows()?;
        self.rrd.as_deref().map_or(Ok(()), check_recording_place)?;
        let staged = take_place(target, Holds::Result)?;
        self.set_threads()?;
        let begin = Instant::now();
        let Input { inventory, problem, reference, warnings, inputs } = read(folder)?;
        self.warn(&warnings);
        let problem = computable(problem)?;
        let vehicles = inventory.vehicles.into_iter().map(|vehicle| vehicle.id).collect();
        let read_s = begin.elapsed().as_secs_f64();
        Ok((Opened { problem, warnings, inputs, vehicles, reference, read_s }, staged))
    }
}

/// Reads and validates a problem folder whole.
pub fn read(folder: &Path) -> Result<Input, Failure> {
    let invalid = |findings| Failure::Invalid(vec![(folder.to_owned(), findings)]);
    match files::read_problem(folder) {
        Ok(Folder { inventory, problem, warnings, inputs }) => {
            let vehicles: Vec<String> = inventory.vehicles.iter().map(|v| v.id.clone()).collect();
            let reference = reference::read_reference(folder, &vehicles).map_err(invalid)?;
            let warnings = warnings.into_iter().chain(reference.warnings.iter().cloned()).collect();
            Ok(Input { inventory, problem, reference, warnings, inputs })
        }
        Err(findings) => Err(invalid(findings)),
    }
}

/// The problem of an input, or why it cannot be computed.
pub fn computable(problem: Result<Problem, Vec<String>>) -> Result<Problem, Failure> {
    problem.map_err(|missing| {
        Failure::NoSolution(format!(
            "this problem needs what this version does not compute: {}",
            missing.join("; ")
        ))
    })
}

/// `<problem folder>-result`, beside it.
pub fn default_result_folder(problem: &Path) -> Result<PathBuf, Failure> {
    // "." and ".." have no name of their own.
    let whole = std::fs::canonicalize(problem).unwrap_or_else(|_| problem.to_owned());
    let path = if problem.file_name().is_some() { problem } else { &whole };
    let name = path
        .file_name()
        .ok_or_else(|| Failure::Usage("a place for the result is needed: --out DIR".to_owned()))?;
    let mut name = name.to_owned();
    name.push("-result");
    Ok(path.with_file_name(name))
}

/// Reads `estimate`, `off` or `A,B`: scatter of the mean acceleration over one second in m/s^2, and
/// of the angular acceleration in deg/s^2. After `jerk:` white noise is that of the jerk.
pub fn motion_prior(text: &str) -> Result<MotionPrior, String> {
    let strength = |text: &str| text.trim().parse::<f64>().ok().filter(|v| v.is_finite() && *v > 0.0);
    let (order, of_order) = match text.split_once(':') {
        Some(("jerk", rest)) => (Order::Jerk, rest),
        Some(("acceleration", rest)) => (Order::Acceleration, rest),
        _ => (Order::Acceleration, text),
    };
    match of_order {
        "estimate" => Ok(MotionPrior::Estimated(order)),
        "off" if of_order == text => Ok(MotionPrior::Off),
        _ => of_order
            .split_once(',')
            .and_then(|(position, rotation)| Some((strength(position)?, strength(rotation)?)))
            .map(|(linear, degrees)| {
                MotionPrior::Given(order, Strengths { linear, angular: degrees.to_radians() })
            })
            .ok_or_else(|| {
                "wanted estimate, off, or two numbers above 0 as in 2.0,5.0; jerk:estimate or jerk:2.0,5.0"
                    .to_owned()
            }),
    }
}

/// Reads a finite number above zero.
pub fn positive(text: &str) -> Result<f64, String> {
    let value = text.parse::<f64>().ok().filter(|v| v.is_finite() && *v > 0.0);
    value.ok_or_else(|| "wanted a number above 0".to_owned())
}

/// Reads a number of at most 2, or -inf.
pub fn shape(text: &str) -> Result<f64, String> {
    let value = text.parse::<f64>().ok().filter(|v| *v <= 2.0);
    value.ok_or_else(|| "wanted a number of at most 2".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_result_stands_beside_the_problem() {
        let place = |path: &str| default_result_folder(Path::new(path)).unwrap();
        assert_eq!(place("problems/suv"), Path::new("problems/suv-result"));
        assert_eq!(place("problems/suv/"), Path::new("problems/suv-result"));
        let here = std::env::current_dir().unwrap();
        assert_eq!(
            place("."),
            here.with_file_name(format!("{}-result", here.file_name().unwrap().display()))
        );
    }

    #[test]
    fn a_report_quotes_what_changes_numbers() {
        let of = |text: &str| told(text.split(' ').map(OsString::from), Path::new("film/"));
        assert_eq!(
            of("refine film/ --out x -q --loss huber --threads=2"),
            "trackbundle refine PROBLEM --loss huber"
        );
        for shown in ["--spawn", "--connect", "--connect rerun+http://127.0.0.1:1/proxy", "--connect=a://b"] {
            assert_eq!(of(&format!("refine {shown} film/")), "trackbundle refine PROBLEM", "{shown}");
        }
        assert_eq!(of("refine --loss-shape=-2 --rrd r film/"), "trackbundle refine --loss-shape=-2 PROBLEM");
    }

    #[test]
    fn threads_fit_into_their_address_space() {
        let (cache, of_one) = (64 << 20, (80 + 128) << 20);
        assert_eq!(threads_within(0, cache).0, 0);
        let (_, least) = threads_within(0, cache);
        assert_eq!(least, (300 << 20) + 2 * of_one);
        assert_eq!(threads_within(least - 1, cache).0, 0);
        assert_eq!(threads_within(least, cache).0, 1);
        assert_eq!(threads_within(least + 3 * of_one, cache).0, 4);
    }

    #[test]
    fn motion_priors_are_read() {
        assert_eq!(motion_prior("off"), Ok(MotionPrior::Off));
        let estimated = |order| Ok(MotionPrior::Estimated(order));
        assert_eq!(motion_prior("estimate"), estimated(Order::Acceleration));
        assert_eq!(motion_prior("acceleration:estimate"), estimated(Order::Acceleration));
        assert_eq!(motion_prior("jerk:estimate"), estimated(Order::Jerk));
        for (text, wanted) in [("2, 90", Order::Acceleration), ("jerk:2,90", Order::Jerk)] {
            let MotionPrior::Given(order, given) = motion_prior(text).unwrap() else { panic!("a strength") };
            assert_eq!((order, given.linear), (wanted, 2.0));
            assert!((given.angular - std::f64::consts::FRAC_PI_2).abs() < 1e-15);
        }
        for wrong in ["", "2", "0,1", "a,b", "1,inf", "1,2,3", "jerk", "jerk:", "jerk:off", "snap:estimate"] {
            assert!(motion_prior(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn numbers_out_of_range_are_refused() {
        assert!(positive("0").is_err() && positive("nan").is_err() && positive("1e999").is_err());
        assert!(shape("2.1").is_err() && shape("nan").is_err());
        assert_eq!(shape("-inf"), Ok(f64::NEG_INFINITY));
    }
}
