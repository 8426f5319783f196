//! What the examples share: options of a run, its clock and its report.

use clap::Args;
use std::error::Error;
use std::path::{Path, PathBuf};
use std::str::{FromStr, SplitAsciiWhitespace};
use std::time::Instant;
use trackbundle_solver::{IterationRecord, Minimiser, MinimiserOptions, Minimum, System, Values};

/// Options of a run.
#[derive(Args)]
pub struct Options {
    /// Threads to compute with; their number does not change the result [default: all cores]
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// The most iterations
    #[arg(long, default_value_t = 50)]
    max_iterations: usize,
    /// Stop when an iteration lowers the cost by less than this share of it
    #[arg(long, default_value_t = 1e-6)]
    function_tolerance: f64,
    /// Print one line of JSON instead of the iteration table
    #[arg(long)]
    json: bool,
    /// Write the solved problem to this file
    #[arg(long)]
    pub output: Option<PathBuf>,
}

impl Options {
    /// Sets the number of threads of this process.
    pub fn set_threads(&self) -> Result<(), rayon::ThreadPoolBuildError> {
        rayon::ThreadPoolBuilder::new().num_threads(self.threads.unwrap_or(0).into()).build_global()
    }

    /// The options of the minimiser.
    pub fn minimiser_options(&self) -> MinimiserOptions {
        MinimiserOptions {
            max_iterations: self.max_iterations,
            relative_decrease: self.function_tolerance,
            hardly_damped: f64::INFINITY,
            first_damping: 1e-4,
            shrink: 1.0 / 3.0,
            growth: 2.0,
            least_flatness: 1e-3,
        }
    }

    /// Prints the iteration table, unless JSON is wanted.
    fn show(&self, r: &IterationRecord) {
        if r.iteration == 0 && !self.json {
            eprintln!("iter            cost      change  |gradient|      |step|    gain  damping  seconds");
        }
        if !self.json {
            eprintln!(
                "{:4} {:15.8e} {:11.2e} {:11.2e} {:11.2e} {:6.2}{} {:8.1e} {:8.4}",
                r.iteration,
                r.cost,
                r.change,
                r.gradient,
                r.step,
                r.gain,
                if r.accepted { ' ' } else { 'x' },
                r.damping,
                r.seconds
            );
        }
    }

    /// Prints what came out.
    fn report(&self, system: &System, minimum: &Minimum, minimiser: &Minimiser, setup_s: f64, clock: &Clock) {
        let (wall_s, cpu_s) = clock.seconds();
        let stages = minimiser.stage_seconds();
        let report = serde_json::json!({
            "initial_cost": minimum.records[0].cost,
            "final_cost": minimum.cost.value,
            "iterations": minimum.records.len() - 1,
            "rejected": minimum.records.iter().filter(|r| !r.accepted).count(),
            "stop": minimum.stop.to_string(),
            "parameters": system.parameters(),
            "seconds": wall_s,
            "cpu_seconds": cpu_s,
            "seconds_by_stage": {
                "setup": setup_s,
                "linearise": stages.linearise,
                "factorise": stages.factorise,
                "substitute": stages.substitute,
                "cost": stages.cost,
            },
            "peak_mib": peak_mib(),
        });
        if self.json {
            println!("{report}");
        } else {
            println!("{report:#}");
        }
    }
}

/// Reads a file with `read`.
pub fn read<P>(
    file: &Path,
    read: impl FnOnce(&str) -> Result<P, Box<dyn Error>>,
) -> Result<P, Box<dyn Error>> {
    read(&std::fs::read_to_string(file)?)
}

/// What a run leaves: the system, what `build` gave with it, and the minimum.
pub type Solved<B> = (System, B, Minimum);

impl Options {
    /// Builds a system, minimises its cost and reports.
    pub fn solve<B>(&self, build: impl FnOnce() -> (System, B)) -> Result<Solved<B>, Box<dyn Error>> {
        let clock = Clock::start();
        let (system, blocks) = build();
        let mut minimiser = Minimiser::new(&system)?;
        let (setup_s, _) = clock.seconds();
        let mut show = |record: &IterationRecord, _: &Values| self.show(record);
        let minimum = minimiser.run(&system, system.start(), self.minimiser_options(), Some(&mut show));
        self.report(&system, &minimum, &minimiser, setup_s, &clock);
        Ok((system, blocks, minimum))
    }
}

/// Wall time and processor time since a start.
pub struct Clock {
    wall: Instant,
    cpu_s: f64,
}

impl Clock {
    /// Starts.
    pub fn start() -> Self {
        Clock { wall: Instant::now(), cpu_s: cpu_seconds() }
    }

    /// Wall and processor seconds; the second `NaN` where the system does not tell.
    pub fn seconds(&self) -> (f64, f64) {
        (self.wall.elapsed().as_secs_f64(), cpu_seconds() - self.cpu_s)
    }
}

/// User and system time of this process \[s\], in ticks of 10 ms.
fn cpu_seconds() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    // The name of the program stands in brackets and may hold anything.
    let fields: Vec<&str> = stat.rsplit(')').next().unwrap_or_default().split_whitespace().collect();
    let ticks = |at: usize| fields.get(at).and_then(|f| f.parse::<f64>().ok()).unwrap_or(f64::NAN);
    (ticks(11) + ticks(12)) / 100.0
}

/// Largest memory of this process \[MiB\]; `NaN` where the system does not tell.
fn peak_mib() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    peak.and_then(|text| text.trim().trim_end_matches(" kB").parse::<f64>().ok())
        .map_or(f64::NAN, |k| k / 1024.0)
}

/// The words of a file, one after the other.
pub struct Words<'a>(SplitAsciiWhitespace<'a>);

impl<'a> Words<'a> {
    /// Of a text.
    pub fn new(text: &'a str) -> Self {
        Words(text.split_ascii_whitespace())
    }

    /// The next one as a number.
    pub fn next<T: FromStr>(&mut self) -> Result<T, Box<dyn Error>> {
        let word = self.0.next().ok_or("the file ends too early")?;
        word.parse().map_err(|_| format!("\"{word}\" is not the number that was expected").into())
    }

    /// The next ones as numbers.
    pub fn array<const N: usize>(&mut self) -> Result<[f64; N], Box<dyn Error>> {
        let mut numbers = [0.0; N];
        for number in &mut numbers {
            *number = self.next()?;
        }
        Ok(numbers)
    }
}
