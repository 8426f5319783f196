//! `[terrain]`.

use super::super::cells::{decimal, quoted};
use super::super::section::Section;
use crate::problem::{GroundKnowledge, Problem};
use crate::terrain::Terrain;
use std::fmt::Write;

/// `[terrain]`.
#[derive(Debug)]
pub struct GroundSettings {
    pub terrain: TerrainSettings,
    pub sigma_m: f64,
    pub correlation_s: Option<f64>,
    pub bias_sigma_m: f64,
    pub tilt_sigma_rad: f64,
}

/// Which terrain.
#[derive(Debug, PartialEq)]
pub enum TerrainSettings {
    /// A level plane at this height \[m\].
    Plane(f64),
    /// The grid in this file.
    Grid(String),
}

impl GroundSettings {
    /// With the terrain that it names.
    pub fn with(&self, terrain: Terrain) -> GroundKnowledge {
        let GroundSettings { sigma_m, correlation_s, bias_sigma_m, tilt_sigma_rad, .. } = *self;
        GroundKnowledge { terrain, sigma_m, correlation_s, bias_sigma_m, tilt_sigma_rad }
    }
}

/// Reads `[terrain]`.
pub fn read(terrain: &Section) -> Option<GroundSettings> {
    let plane_z = terrain.any_number("plane_z");
    let grid = terrain.text("grid");
    let sigma_m = terrain.not_negative("sigma_m").unwrap_or(0.02);
    let correlation_s = terrain.not_negative("correlation_s");
    let bias_sigma_m = terrain.not_negative("bias_sigma_m").unwrap_or(0.0);
    let tilt_sigma_rad = terrain.not_negative("tilt_sigma_deg").unwrap_or(3.0).to_radians();
    if terrain.has("plane_z") == terrain.has("grid") {
        terrain.error("plane_z", "one of plane_z and grid");
    }
    let terrain = plane_z.map(TerrainSettings::Plane).or(grid.map(TerrainSettings::Grid))?;
    Some(GroundSettings { terrain, sigma_m, correlation_s, bias_sigma_m, tilt_sigma_rad })
}

/// Writes the ground, where it is known; `grid` is the name of the file of its heights.
pub fn write(text: &mut String, problem: &Problem, grid: Option<&str>) {
    let Some(ground) = &problem.ground else { return };
    text.push_str("\n[terrain]\n");
    let _ = match (&ground.terrain, grid) {
        (Terrain::Plane { z_m }, _) => writeln!(text, "plane_z = {z_m:?}"),
        (Terrain::Grid(_), name) => writeln!(text, "grid = {}", quoted(name.unwrap_or("terrain.asc"))),
    };
    for (key, value) in [
        ("sigma_m", Some(ground.sigma_m)),
        ("correlation_s", ground.correlation_s),
        ("bias_sigma_m", Some(ground.bias_sigma_m)),
        ("tilt_sigma_deg", Some(ground.tilt_sigma_rad.to_degrees())),
    ] {
        if let Some(value) = value {
            let _ = writeln!(text, "{key} = {}", decimal(value, 9));
        }
    }
}
