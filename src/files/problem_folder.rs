//! A problem folder: read whole, validated whole, then made into a [`crate::problem::Problem`].

use super::checked::{Checked, Folder};
use super::problem_toml::{self, Settings};
use super::sections::terrain::TerrainSettings;
use super::sections::video;
use super::tables::reading::{Index, Reader, positions};
use super::tables::{NAMES, Tables, cameras, frames, gnss, points, targets, vehicles};
use crate::disk::{InputFile, Inputs};
use crate::problem::{GroundKnowledge, Video};
use crate::tables::{Finding, Findings};
use crate::terrain::{GridFault, Terrain};
use std::collections::HashSet;
use std::path::Path;

/// Reads and validates a problem folder. The error holds everything that is wrong with it.
pub fn read_problem(folder: &Path) -> Result<Folder, Findings> {
    let mut reader = Reader { inputs: Inputs::new(folder), findings: Findings::default() };
    let settings = read_settings(&mut reader);
    let mut tables = Tables::read(&mut reader, settings);
    let area = tables.area();
    tables.ground = tables.settings.as_ref().and_then(|settings| read_ground(&mut reader, settings, area));
    let checked = check(&mut reader, &tables);
    let checked = checked.map(|checked| (checked.vehicles(&mut reader.findings), checked));
    match checked {
        Some((vehicles, checked)) if !reader.findings.is_invalid() => {
            Ok(checked.into_folder(vehicles, reader.findings, in_order(reader.inputs.files())))
        }
        _ => Err(reader.findings),
    }
}

/// The files of a problem in the order in which they are told, `problem.toml` first. References are not among them.
fn in_order(mut files: Vec<InputFile>) -> Vec<InputFile> {
    let names: Vec<&str> = std::iter::once(problem_toml::FILE).chain(NAMES).collect();
    files.sort_by_key(|read| names.iter().position(|name| *name == read.file).unwrap_or(names.len()));
    files
}

/// Reads the grid of heights in a file of a folder, of which `wanted` says what it is.
/// A large grid is read in `area` alone: the least and the largest x and y \[m\].
pub fn read_grid(
    inputs: &Inputs<'_>,
    file: &str,
    wanted: &str,
    area: Option<[[f64; 2]; 2]>,
) -> Result<Terrain, Findings> {
    let bytes = inputs
        .read(file)
        .map_err(|error| Findings::from(Finding::of_file(file, wanted, &error.to_string())))?;
    Terrain::read_grid(file, &bytes, area).map_err(|faults| {
        let mut findings = Findings::default();
        for GridFault { line, column, wanted, found } in faults {
            findings.error(Finding { file: file.to_owned(), line, column, wanted, found });
        }
        findings
    })
}

fn read_settings(reader: &mut Reader) -> Option<Settings> {
    let file = problem_toml::FILE;
    let text = match reader.inputs.read(file).map(String::from_utf8) {
        Ok(Ok(text)) => text,
        Ok(Err(error)) => {
            reader.findings.error(Finding::of_file(file, "UTF-8 text", &error.utf8_error().to_string()));
            return None;
        }
        Err(error) => {
            reader.findings.error(Finding::of_file(file, "a file that can be read", &error.to_string()));
            return None;
        }
    };
    let (settings, findings) = problem_toml::parse(&text);
    reader.findings.append(findings);
    settings
}

/// The ground with its terrain; where it cannot be read there are findings.
fn read_ground(
    reader: &mut Reader,
    settings: &Settings,
    area: Option<[[f64; 2]; 2]>,
) -> Option<GroundKnowledge> {
    let ground = settings.ground.as_ref()?;
    let file = match &ground.terrain {
        TerrainSettings::Plane(z_m) => return Some(ground.with(Terrain::Plane { z_m: *z_m })),
        TerrainSettings::Grid(file) => file,
    };
    match read_grid(&reader.inputs, file, "the terrain grid that problem.toml names", area) {
        Ok(terrain) => Some(ground.with(terrain)),
        Err(findings) => {
            reader.findings.append(findings);
            None
        }
    }
}

/// Checks the tables against each other; `None` where so much is missing that there is nothing
/// to check against, and then there are findings.
fn check<'t>(reader: &mut Reader, tables: &'t Tables) -> Option<Checked<'t>> {
    let numbers = frames::check(reader, tables.frames.as_deref());
    let vehicle_ids: Option<Vec<&str>> =
        tables.settings.as_ref().map(|s| s.vehicles.iter().map(|v| v.id.as_str()).collect());
    let index = Index { frames: numbers, vehicles: vehicle_ids.map(|ids| positions(&ids)) };

    let camera_poses = cameras::check(reader, tables, &index);
    let targets = targets::check(reader, tables.targets.as_deref());
    let target_observations = targets::check_observations(reader, tables, &index, &targets);
    let vehicle_observations = vehicles::check_observations(reader, tables, &index);
    let vehicle_poses = vehicles::check_poses(reader, tables, &index);
    let known_points = points::check(reader, tables, &index, &vehicle_observations);
    let received = gnss::check(reader, tables, &index, &vehicle_observations);
    let video = check_video(reader, tables);

    let settings = tables.settings.as_ref()?;
    let frame_rows = tables.frames.as_ref()?;
    let seen: HashSet<&str> = vehicle_observations.points.iter().map(|(id, _)| *id).collect();
    for vehicle in &settings.vehicles {
        // A vehicle that is never seen is left out, with its marker.
        if let Some((marker, line)) = &vehicle.marker
            && seen.contains(vehicle.id.as_str())
            && !vehicle_observations.points.contains(&(vehicle.id.as_str(), marker.as_str()))
        {
            let wanted = "a point that is observed";
            reader.findings.error(Finding::of_cell(
                problem_toml::FILE,
                *line,
                "vehicle.marker",
                wanted,
                marker,
            ));
        }
    }
    Some(Checked {
        settings,
        ground: tables.ground.clone(),
        frames: frames::frames(frame_rows),
        camera_poses,
        targets,
        target_observations,
        vehicle_observations: vehicle_observations.vehicles,
        vehicle_poses,
        has_vehicle_poses: tables.vehicle_poses.is_some(),
        known_points,
        received,
        video,
    })
}

fn check_video(reader: &mut Reader, tables: &Tables) -> Option<Video> {
    let settings = tables.settings.as_ref()?;
    let video = settings.video.as_ref()?;
    // Rows that are wrong are left out: then it is not known which frames there are.
    let is_whole = reader.findings.errors().all(|finding| finding.file != frames::FILE);
    let rows = tables.frames.as_ref().filter(|_| is_whole);
    let frames: Option<Vec<i64>> = rows.map(|rows| rows.iter().map(|line| line.row.frame).collect());
    video::find(
        reader.inputs.folder(),
        video,
        settings.camera.size_px,
        frames.as_deref(),
        &mut reader.findings,
    )
}
