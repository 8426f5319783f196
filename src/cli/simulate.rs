//! `trackbundle simulate`.

use super::Failure;
use super::options::{put_in_place, take_place, write_files};
use super::output::{counted, print};
use crate::report::folder::Holds;
use crate::simulate::{Chance, World, read_scenario, simulated_files};
use crate::tables::Findings;
use clap::Args;
use std::path::{Path, PathBuf};

/// Arguments of the command.
#[derive(Debug, Args)]
pub struct Arguments {
    /// The scenario (docs/scenarios.md); some are in problems/scenarios
    scenario: PathBuf,

    /// Where the problem folder goes; it must not be there yet
    #[arg(long, value_name = "DIR")]
    out: PathBuf,

    /// What random numbers begin from, in place of the scenario's own seed
    #[arg(long, value_name = "N")]
    seed: Option<u64>,

    /// Measure everything exactly: no noise, no gross errors, true poses
    #[arg(long)]
    exact: bool,

    /// Print no summary; errors are always printed
    #[arg(long, short)]
    quiet: bool,
}

/// Findings of a scenario are told with its folder.
pub fn invalid(scenario: &Path, findings: Findings) -> Failure {
    Failure::Invalid(vec![(scenario.parent().unwrap_or(Path::new("")).to_owned(), findings)])
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let refused = |findings| invalid(&arguments.scenario, findings);
    let mut staged = take_place(&arguments.out, Holds::Problem)?;
    let scenario = read_scenario(&arguments.scenario).map_err(refused)?;
    let world = World::new(scenario, arguments.seed).map_err(refused)?;
    let chance = if arguments.exact { Chance::Exact } else { Chance::Run(0) };
    let video = world.video(chance).map_err(refused)?;
    let problem = &video.problem;
    if let Some(unseen) = problem.vehicles.iter().find(|vehicle| vehicle.observations.is_empty()) {
        return Err(Failure::NoSolution(format!("vehicle {} is never in view", unseen.id)));
    }
    write_files(&mut staged, &simulated_files(&world, &video).map_err(refused)?)?;
    let folder = put_in_place(&mut staged)?;
    if arguments.quiet {
        return Ok(());
    }
    let mut text = format!("simulated   {}, {}\n", problem.name, counted(problem.frames.len(), "frame"));
    for vehicle in &problem.vehicles {
        let points = counted(vehicle.points.len(), "point");
        let seen = counted(vehicle.observations.len(), "image point");
        text += &format!("vehicle     {}: {points}, {seen}\n", vehicle.id);
    }
    if !problem.targets.is_empty() {
        let seen = counted(problem.target_observations.len(), "image point");
        text += &format!("targets     {}, {seen}\n", problem.targets.len());
    }
    text += &format!("gross       {}\n", counted(video.gross.len(), "gross error"));
    text += &format!("problem     {}\n", folder.display());
    print(&text)
}
