//! `trackbundle view`.

use super::Failure;
use super::comparison::{Invalid, ToCompare};
use super::comparison_text::describe;
use super::evaluate::clock_offset;
use super::options::{
    Input, ViewerOptions, check_recording_place, computable, default_result_folder, positive, read,
    save_whole, without_rerun,
};
use super::output::warn_all;
use crate::disk::InputFile;
use crate::evaluate::{Clock, EvaluateOptions};
use crate::files::{RESIDUALS, read_poses, read_residuals};
use crate::initialise::{Method, initialise};
use crate::problem::Problem;
use crate::reference::Reference;
use crate::report::document;
use crate::scene::{self, Shown};
use crate::tables::Findings;
use clap::{Args, ValueEnum};
use std::path::{Path, PathBuf};
use trackbundle_viz::{Layout, Scene, Viewer, show};

/// Arguments of the command.
#[derive(Debug, Args)]
pub struct Arguments {
    /// The problem folder
    problem: PathBuf,

    /// Result folders; several are shown side by side [default: <PROBLEM>-result where that is there]
    results: Vec<PathBuf>,

    /// Write the recording to this file; replaces an older recording and no other file
    #[arg(long, value_name = "FILE")]
    rrd: Option<PathBuf>,

    // Without any of them a viewer is started.
    #[command(flatten)]
    viewer: ViewerOptions,

    /// What is on top when it opens; the others are tabs beside it
    #[arg(long, value_enum, default_value_t = Top::Overview)]
    layout: Top,

    /// Offset of the receiver's clock, t_reference = t_video + offset: seconds, or estimate to take it from
    /// the tracks themselves
    #[arg(
        long,
        value_name = "SECONDS|estimate",
        default_value = "0",
        value_parser = clock_offset,
        allow_hyphen_values = true
    )]
    clock_offset: Clock,

    /// Arrows of residuals are so many times as long
    #[arg(long, value_name = "X", default_value_t = trackbundle_viz::DEFAULT_RESIDUAL_FACTOR, value_parser = positive)]
    residual_factor: f64,

    /// Print no warnings; errors are always printed
    #[arg(long, short)]
    quiet: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Top {
    /// World, camera's view, curves and the verdict
    Overview,
    /// The shape of a vehicle, against its scan
    Shape,
    /// Tracks on a map; only where reference/reference.toml says where on the Earth the world is
    Map,
}

/// What every result is shown with.
struct Shared<'a> {
    folder: &'a Path,
    problem: &'a Problem,
    vehicles: Vec<String>,
    reference: &'a Reference,
    inputs: Vec<InputFile>,
    start: Scene,
    options: EvaluateOptions,
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    if !trackbundle_viz::RECORDS {
        return Err(without_rerun("view"));
    }
    let viewer = match (arguments.viewer.viewer()?, &arguments.rrd) {
        (None, None) => Some(Viewer::Spawned),
        (viewer, _) => viewer,
    };
    arguments.rrd.as_deref().map_or(Ok(()), check_recording_place)?;
    let Input { inventory, problem, reference, warnings, inputs } = read(&arguments.problem)?;
    let problem = computable(problem)?;
    let initial = initialise(&problem, Method::RobustWhereNeeded)?;
    let results = match &arguments.results {
        given if !given.is_empty() => given.clone(),
        _ => default_result_folder(&arguments.problem)
            .ok()
            .filter(|folder| folder.is_dir())
            .into_iter()
            .collect(),
    };
    let mut start = scene::start(&problem, &initial.estimate);
    start.film = scene::film(&problem);
    start.residual_factor = Some(arguments.residual_factor);
    start.warnings.extend(warnings);
    start.warnings.extend(initial.warnings.iter().map(ToString::to_string));
    let shared = Shared {
        folder: &arguments.problem,
        problem: &problem,
        vehicles: inventory.vehicles.into_iter().map(|vehicle| vehicle.id).collect(),
        reference: &reference,
        inputs,
        start,
        options: EvaluateOptions { clock: arguments.clock_offset, ..EvaluateOptions::default() },
    };
    let mut invalid = Invalid::new();
    let mut scenes: Vec<Scene> =
        results.iter().filter_map(|folder| shared.result(folder, &mut invalid)).collect();
    if !invalid.is_empty() {
        return Err(Failure::Invalid(invalid));
    }
    if scenes.is_empty() {
        scenes.push(shared.unadjusted());
    }
    if scenes.len() > 1 {
        name(&mut scenes, &results);
    }
    if !arguments.quiet {
        scenes.iter().for_each(|scene| warn_all(&scene.warnings));
    }
    let layout = match arguments.layout {
        Top::Overview => Layout::Overview,
        Top::Shape => Layout::Shape,
        Top::Map => Layout::Map,
    };
    if matches!(layout, Layout::Map) && reference.world.is_none() && !arguments.quiet {
        let missing = "no map: reference/reference.toml does not say where on the Earth the world is";
        warn_all(&[missing.to_owned()]);
    }
    if let Some(file) = &arguments.rrd {
        save_whole(&scenes, layout, file).map_err(Failure::Other)?;
    }
    match viewer {
        Some(viewer) => show(scenes, layout, &viewer).map_err(|error| Failure::Other(error.to_string())),
        None => Ok(()),
    }
}

impl Shared<'_> {
    /// The scene of a result; what is wrong with its folder is added to `invalid`.
    fn result(&self, folder: &Path, invalid: &mut Invalid) -> Option<Scene> {
        let before = invalid.len();
        let (frames, vehicles) = (&self.problem.frames, &self.vehicles);
        let to_compare =
            ToCompare::read(self.folder, folder, Some(vehicles), Some(frames), self.inputs.clone(), invalid);
        let mut findings = Findings::default();
        let poses = read_poses(folder, frames, vehicles, &mut findings);
        let residuals = read_residuals(folder, RESIDUALS, Some(self.problem), &mut findings);
        if findings.is_invalid() {
            invalid.push((folder.to_owned(), findings));
        }
        let to_compare = to_compare.filter(|_| invalid.len() == before)?;
        let mut scene = self.start.clone();
        let shown = Shown {
            poses: &poses,
            tracks: &to_compare.tracks,
            shapes: &to_compare.shapes,
            residuals: residuals.as_ref(),
        };
        scene::add_result(&mut scene, self.problem, shown);
        let compared = to_compare.compare(vehicles, self.reference, Some(self.problem), &self.options);
        scene::add_comparison(&mut scene, self.problem, &compared.evaluation);
        scene.summary = document(&compared.report);
        if !compared.is_empty() {
            let told = describe(&compared.evaluation, &self.options);
            scene.summary += &format!("\n## Against the references\n\n```\n{told}```\n");
        }
        if !self.reference.tracks.is_empty() || !self.reference.scans.is_empty() {
            scene.warnings.extend(compared.told());
        }
        self.locate(&mut scene);
        Some(scene)
    }

    /// The problem alone: its first estimate stands for a result.
    fn unadjusted(&self) -> Scene {
        let mut scene = self.start.clone();
        scene.summary =
            format!("# {}\n\nFirst estimate, not adjusted: no result is given.\n", self.problem.name);
        self.locate(&mut scene);
        scene
    }

    /// Says where on the Earth it is.
    fn locate(&self, scene: &mut Scene) {
        if let Some(world) = &self.reference.world {
            scene::add_map(scene, |place| world.geodetic_deg(place));
        }
    }
}

/// Names scenes by the folders of their results, or by the whole path where two folders have one name.
fn name(scenes: &mut [Scene], results: &[PathBuf]) {
    let short = |path: &PathBuf| {
        path.file_name().map_or(path.display().to_string(), |name| name.to_string_lossy().into_owned())
    };
    for (scene, path) in scenes.iter_mut().zip(results) {
        let own = short(path);
        let is_unique = results.iter().filter(|other| short(other) == own).count() == 1;
        scene.root = Some(if is_unique { own } else { path.display().to_string() });
    }
}
