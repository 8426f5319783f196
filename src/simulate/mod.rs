//! Videos with known truth: a scenario and a seed make a problem and what really was.
//!
//! ```text
//! SCENARIO.toml -> Scenario -> World (bodies, tracks, targets: of the seed) -> SimulatedVideo (errors: of the run)
//! ```
//!
//! What a plan would decide is of the seed alone: which points are tracked when. Targets stand where they always do. What chance
//! decides is drawn anew for each run: paths about their plan, the ride over the ground, survey, calibration, and every
//! error of a measurement. So the scatter over runs is what the standard deviations of the adjustment speak of.

mod body;
mod folder;
pub mod knowledge;
mod path;
pub mod presets;
mod read;
pub mod scenario;
mod vary;
mod video;
mod wander;
mod wrong_tracks;

use crate::disk::Inputs;
use crate::estimate::Estimate;
use crate::files::{named_text, read_grid};
use crate::problem::Problem;
use crate::reference::GnssPosition;
use crate::tables::{Finding, Findings};
use crate::terrain::Terrain;
use body::{Body, Faced};
pub use folder::simulated_files;
use nalgebra::{Point3, Vector2, Vector3};
pub use read::parse;
use scenario::{PathSettings, Scenario, VehicleSettings};
use std::collections::BTreeMap;
use std::path::Path;
pub use vary::{ABSENT, Value, vary};
use wander::{Purpose, stream};
pub use wrong_tracks::WrongKind;

/// A scenario with everything that is of its seed.
pub struct World {
    /// The scenario.
    pub scenario: Scenario,
    seed: u64,
    terrain: Terrain,
    targets: Vec<Point3<f64>>,
    vehicles: Vec<Tracked>,
}

/// A vehicle and the tracks of its points.
struct Tracked {
    body: Body,
    rows: Vec<path::Fix>,
    tracks: Vec<Track>,
}

/// A point that is tracked.
struct Track {
    id: String,
    place: Point3<f64>,
    normal: Vector3<f64>,
    /// Frames, from the first to before the last.
    frames: std::ops::Range<usize>,
}

/// What chance does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Chance {
    /// Paths and rides are those of run 0, and nothing is measured wrongly; gross errors are left out.
    Exact,
    /// All of it, as in the run of this number.
    Run(u64),
}

/// Number of the frame, index of the vehicle (none, for a target), id of the point or the target.
pub type GrossError = (i64, Option<usize>, String);

/// A video and what really was.
pub struct SimulatedVideo {
    /// What is measured.
    pub problem: Problem,
    /// What is true of its unknowns.
    pub truth: Estimate,
    /// Velocities of the marker of each vehicle in each frame \[m/s\].
    pub velocities: Vec<Vec<Vector3<f64>>>,
    /// Gross errors.
    pub gross: Vec<GrossError>,
    /// For each vehicle the points whose tracks are, in part or whole, of something else, and of what.
    pub wrong_tracks: Vec<BTreeMap<String, WrongKind>>,
    /// Positions of a receiver on each vehicle that are only to compare with.
    pub references: Vec<Vec<GnssPosition>>,
}

/// The name of the marker of each vehicle.
pub const MARKER: &str = "mark";

/// Reads the scenario in a file.
pub fn read_scenario(path: &Path) -> Result<Scenario, Findings> {
    let (file, text) = named_text(path, "a scenario that can be read")?;
    parse(&file, &text, path.parent().unwrap_or(Path::new("")))
}

impl World {
    /// The world of a scenario, with its own seed or another.
    pub fn new(scenario: Scenario, seed: Option<u64>) -> Result<World, Findings> {
        let seed = seed.unwrap_or(scenario.seed);
        let terrain = read_terrain(&scenario)?;
        let mut findings = Findings::default();
        let mut vehicles = Vec::new();
        for (at, settings) in scenario.vehicles.iter().enumerate() {
            let body = match Body::new(&settings.body, &scenario.folder, seed, at) {
                Ok(body) => body,
                Err(found) => {
                    findings.append(found);
                    continue;
                }
            };
            let rows = match &settings.path {
                PathSettings::Driven { .. } => Vec::new(),
                PathSettings::File(file) => match path::read_rows(&scenario.folder, file) {
                    Ok(rows) => rows,
                    Err(found) => {
                        findings.append(found);
                        continue;
                    }
                },
            };
            let video_s = (scenario.video.frames - 1) as f64 / scenario.video.rate_hz;
            let end_s = path::PlanPath::end_s(&rows);
            if !rows.is_empty() && video_s > end_s + 1e-6 {
                let PathSettings::File(file) = &settings.path else { continue };
                let wanted = format!("a path as long as the film, {video_s:.3} s");
                findings.error(Finding::of_file(file, &wanted, &format!("{end_s:.3} s")));
            }
            let tracks = tracks(settings, &body, scenario.video.frames, scenario.video.rate_hz, seed, at);
            vehicles.push(Tracked { body, rows, tracks });
        }
        if findings.is_invalid() {
            return Err(findings);
        }
        let targets = targets(&scenario, &terrain)?;
        Ok(World { scenario, seed, terrain, targets, vehicles })
    }

    /// What an image shows of level ground in the middle of the video \[m^2\]; infinite where it sees the horizon.
    pub fn view_m2(&self, video: &SimulatedVideo) -> f64 {
        let camera = &self.scenario.camera.camera;
        let pose = video.truth.camera_poses[video.truth.camera_poses.len() / 2];
        let [width, height] = camera.size_px.map(f64::from);
        let ground_m = self.terrain.at(0.0, 0.0).map_or(0.0, |ground| ground.height_m);
        let corner = |u: f64, v: f64| {
            let ray = camera.ray(&Vector2::new(u, v))?;
            let ray = pose.rotation * Vector3::new(ray.x, ray.y, 1.0);
            let share = (ground_m - pose.translation.z) / ray.z;
            (ray.z < 0.0).then(|| (pose.translation.vector + share * ray).xy())
        };
        let corners = [corner(0.0, 0.0), corner(width, 0.0), corner(width, height), corner(0.0, height)];
        let [Some(a), Some(b), Some(c), Some(d)] = corners else { return f64::INFINITY };
        0.5 * (c - a).perp(&(d - b)).abs()
    }

    /// Points all over the surface of a vehicle.
    pub fn scan(&self, vehicle: usize) -> &[Point3<f64>] {
        &self.vehicles[vehicle].body.scan
    }
}

fn read_terrain(scenario: &Scenario) -> Result<Terrain, Findings> {
    match &scenario.terrain.grid {
        None => Ok(Terrain::Plane { z_m: scenario.terrain.plane_z_m }),
        Some(file) => {
            read_grid(&Inputs::new(&scenario.folder), file, "the terrain grid that the scenario names", None)
        }
    }
}

/// A number from 0 to 1, the upper end aside: that of this place among those drawn for the scenario of a video.
pub fn drawn_number(video: usize, place: usize) -> f64 {
    rand::Rng::random(&mut stream(0, video as u64, Purpose::Draw, place))
}

/// The number of this index in the sequence of van der Corput in a base: spread evenly, however many.
fn even(index: usize, base: usize) -> f64 {
    let (mut left, mut share, mut sum) = (index + 1, 1.0, 0.0);
    while left > 0 {
        share /= base as f64;
        sum += share * (left % base) as f64;
        left /= base;
    }
    sum
}

/// Targets, spread evenly (Halton 1960): of more targets the first are where those of fewer are.
fn targets(scenario: &Scenario, terrain: &Terrain) -> Result<Vec<Point3<f64>>, Findings> {
    let settings = &scenario.targets;
    let place = |at: usize| {
        let [x, y] = [2, 3].map(|base| settings.spread_m * (2.0 * even(at, base) - 1.0));
        let ground = terrain.at(x, y).map_err(|error| no_ground(scenario, "a target", &error.to_string()))?;
        Ok(Point3::new(x, y, ground.height_m + settings.height_m * even(at, 5)))
    };
    (0..settings.count).map(place).collect()
}

fn no_ground(scenario: &Scenario, what: &str, error: &str) -> Findings {
    let file = scenario.terrain.grid.as_deref().unwrap_or_default();
    Finding::of_file(file, &format!("ground under {what}"), error).into()
}

/// The tracks of a vehicle: as many at a time as it has points, each followed by another when it ends.
fn tracks(
    settings: &VehicleSettings,
    body: &Body,
    frames: usize,
    rate_hz: f64,
    seed: u64,
    thing: usize,
) -> Vec<Track> {
    let mut places = stream(seed, 0, Purpose::Body, thing);
    let mut lives = stream(seed, 0, Purpose::Tracks, thing);
    let marker = Track { id: MARKER.to_owned(), place: body.marker, normal: Vector3::z(), frames: 0..frames };
    let mut all = vec![marker];
    for _ in 0..settings.points {
        let mut begin = 0;
        while begin < frames {
            let life = settings.track_s.map_or(frames as f64, |mean_s| {
                // Exponential, as of a tracker that may lose a point at any time; the first is in the middle of its life.
                -(1.0 - rand::Rng::random::<f64>(&mut lives)).ln() * mean_s * rate_hz
            });
            let end = begin.saturating_add(life.ceil().max(2.0) as usize).min(frames);
            let (place, normal): Faced = body.point(&mut places);
            all.push(Track { id: format!("p{:05}", all.len()), place, normal, frames: begin..end });
            begin = end;
        }
    }
    all
}
