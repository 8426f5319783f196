//! `trackbundle study` and `trackbundle plan`.

use super::Failure;
use super::interrupts;
use super::options::{
    command_told, not_written, put_in_place, set_threads, take_place, thread_range, write_files,
};
use super::output::{counted, print, steps};
use super::simulate::invalid;
use crate::page::study_page;
use crate::report::folder::{Holds, Staged};
use crate::report::{File, StudyReport, plan_table, study_files, video_files};
use crate::study::plan::plan;
use crate::study::summary::{rows, without_result};
use crate::study::videos::{JudgedVideo, VideoSettings, Videos, lines, run_videos};
use crate::study::{Kept, Outcome, Study, StudyError, read_study, run as run_study};
use clap::Args;
use std::path::{Path, PathBuf};

/// Arguments of both commands.
#[derive(Debug, Args)]
pub struct Arguments {
    /// The study (docs/studies.md); some are in problems/studies
    study: PathBuf,

    /// Where the tables and the page go. What is done is kept in DIR.unfinished until all is: the same command goes
    /// on with it
    #[arg(long, value_name = "DIR")]
    out: PathBuf,

    /// Runs of the Monte Carlo in each cell, in place of those of the study; 0: none
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=1_000_000))]
    runs: Option<u32>,

    /// Threads to compute with; their number does not change the result [default: all cores]
    #[arg(long, value_name = "N", value_parser = thread_range())]
    threads: Option<u16>,

    /// Print neither progress nor a summary; errors are always printed
    #[arg(long, short)]
    quiet: bool,
}

impl From<StudyError> for Failure {
    fn from(error: StudyError) -> Self {
        match error {
            StudyError::Other(_) => Failure::Usage(error.to_string()),
            StudyError::Io(..) => Failure::Other(error.to_string()),
        }
    }
}

/// Runs `study`.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    run_either(arguments, false)
}

/// Runs `plan`.
pub fn run_plan(arguments: &Arguments) -> Result<(), Failure> {
    run_either(arguments, true)
}

/// Where a study is kept until it is whole.
fn unfinished(out: &Path) -> PathBuf {
    let mut name = out.file_name().unwrap_or_default().to_owned();
    name.push(".unfinished");
    out.with_file_name(name)
}

fn run_either(arguments: &Arguments, is_plan: bool) -> Result<(), Failure> {
    let staged = take_place(&arguments.out, Holds::Study)?;
    let mut study = read_study(&arguments.study).map_err(|findings| invalid(&arguments.study, findings))?;
    if is_plan && study.wanted.is_none() {
        return Err(Failure::Usage(format!(
            "{} has no table [wanted] that says what is to be reached",
            arguments.study.display()
        )));
    }
    if is_plan {
        study.runs = 0;
    }
    if let Some(runs) = arguments.runs {
        if runs == 1 {
            return Err(Failure::Usage("one run has no scatter: two or more are wanted".to_owned()));
        }
        study.runs = runs as usize;
    }
    set_threads(arguments.threads)?;
    let place = unfinished(&arguments.out);
    let kept = Kept::open(&place, &study)?;
    interrupts::stands(format!(
        "what is done is kept in {}; the same command goes on with it",
        place.display()
    ));
    if let Some(videos) = study.videos.as_ref().filter(|_| !is_plan) {
        return run_judged(arguments, &study, videos, kept, staged);
    }
    let outcomes = {
        let told = steps(arguments.quiet);
        run_study(&study, &kept, &*told)?
    };
    let (choices, cheapest) = plan(&study, &outcomes);
    let report = StudyReport {
        study: &study,
        outcomes: &outcomes,
        command: &command_told(&arguments.study),
        plan: is_plan.then_some((choices.as_slice(), cheapest)),
    };
    let folder = publish(&study_files(&report, study_page(&report)), kept, staged)?;
    if !arguments.quiet {
        let mut text = summary(&study, &outcomes);
        if is_plan {
            text += &plan_told(&study, &report);
        }
        text += &format!("folder      {}\n", folder.display());
        print(&text)?;
    }
    if is_plan && cheapest.is_none() {
        return Err(Failure::NoSolution(
            "no cell reaches what is wanted; plan.csv has those that come nearest first".to_owned(),
        ));
    }
    Ok(())
}

/// Puts the files where they were asked for, all at once, and takes away what was kept until then.
fn publish(files: &[File], kept: Kept, mut staged: Staged) -> Result<PathBuf, Failure> {
    write_files(&mut staged, files)?;
    let folder = put_in_place(&mut staged)?;
    kept.remove().map_err(|error| not_written(&staged, error))?;
    Ok(folder)
}

/// A study of videos that are judged.
fn run_judged(
    arguments: &Arguments,
    study: &Study,
    videos: &VideoSettings,
    kept: Kept,
    staged: Staged,
) -> Result<(), Failure> {
    let cells = {
        let told = steps(arguments.quiet);
        run_videos(study, videos, &kept, &*told)?
    };
    let files = video_files(study, videos, &cells, &command_told(&arguments.study));
    let folder = publish(&files, kept, staged)?;
    if !arguments.quiet {
        print(&format!("{}folder      {}\n", videos_told(study, &cells), folder.display()))?;
    }
    Ok(())
}

/// A row for each cell: errors over their standard deviations.
fn videos_told(study: &Study, cells: &[Videos]) -> String {
    let mut text = format!(
        "study       {}, {} of each of {}\n",
        study.name,
        counted(study.runs, "video"),
        counted(cells.len(), "cell")
    );
    let all = lines(cells);
    for (at, cell) in study.cells().iter().enumerate() {
        let of = |quantity: &str| {
            let line = all.iter().find(|line| line.cell == at && line.quantity == quantity);
            line.map_or_else(|| "-".to_owned(), |line| format!("{:.2}", line.rms[0]))
        };
        let told: Vec<String> =
            ["x", "y", "z", "heading", "scale"].iter().map(|name| format!("{name} {}", of(name))).collect();
        let good: Vec<&JudgedVideo> = cells[at].iter().flatten().collect();
        let yes = good.iter().filter(|video| video.is_relied_on()).count();
        text += &format!(
            "{}: error over its sigma {}; trust yes {yes} of {}, without a result {}\n",
            study.told(cell),
            told.join(", "),
            good.len(),
            cells[at].len() - good.len()
        );
    }
    text
}

fn summary(study: &Study, outcomes: &[Outcome]) -> String {
    let without = outcomes.iter().filter(|outcome| outcome.prediction.is_err()).count();
    let mut text = format!("study       {}, {}", study.name, counted(outcomes.len(), "cell"));
    if without > 0 {
        text += &format!(", {without} of them cannot be computed (cells.csv says why)");
    }
    text.push('\n');
    let all = rows(outcomes);
    let ratios: Vec<[f64; 3]> = all.iter().filter_map(|row| row.ratio).collect();
    if !ratios.is_empty() {
        let least = ratios.iter().map(|ratio| ratio[0]).fold(f64::INFINITY, f64::min);
        let most = ratios.iter().map(|ratio| ratio[0]).fold(0.0, f64::max);
        text += &format!(
            "observed    over expected {least:.2} to {most:.2} from {} of each cell, {} without a result\n",
            counted(study.runs, "run"),
            without_result(outcomes)
        );
    }
    text
}

/// How many rows of a plan are printed.
const ROWS: usize = 10;

fn plan_told(study: &Study, report: &StudyReport) -> String {
    let Some((choices, cheapest)) = report.plan else { return String::new() };
    let (header, rows) = plan_table(study, choices, cheapest);
    let shown: Vec<&Vec<String>> = std::iter::once(&header).chain(rows.iter().take(ROWS)).collect();
    let width = |column: usize| shown.iter().map(|row| row[column].chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..header.len()).map(width).collect();
    let feasible = choices.iter().filter(|choice| choice.is_feasible()).count();
    let mut text =
        format!("plan        {feasible} of {} reach what is wanted\n", counted(choices.len(), "cell"));
    for row in shown {
        let cells: Vec<String> =
            row.iter().zip(&widths).map(|(cell, width)| format!("{cell:width$}")).collect();
        text += &format!("            {}\n", cells.join("  ").trim_end());
    }
    text
}
