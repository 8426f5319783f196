//! `reference/reference.toml`: where the world is on the Earth, when the clock of the reference begins, and
//! which positions are good enough.

use super::earth::World;
use super::instant::{TimeScale, gps_ns};
use crate::disk;
use crate::tables::{Finding, Findings};
use chrono::{DateTime, NaiveDateTime};
use nalgebra::Vector3;
use serde::Deserialize;
use std::path::Path;

/// The file.
pub const FILE: &str = "reference/reference.toml";

/// How a receiver found a position.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quality {
    /// Carrier phase with integer ambiguities.
    Fix,
    /// Carrier phase with float ambiguities.
    Float,
    /// Code with satellite-based augmentation.
    Sbas,
    /// Code with differential corrections.
    Dgps,
    /// Code alone.
    Single,
    /// Precise point positioning.
    Ppp,
    /// None of these.
    Other,
}

impl Quality {
    /// All of them.
    pub const ALL: [Quality; 7] = [
        Quality::Fix,
        Quality::Float,
        Quality::Sbas,
        Quality::Dgps,
        Quality::Single,
        Quality::Ppp,
        Quality::Other,
    ];

    /// Its name in settings.
    pub fn name(self) -> &'static str {
        match self {
            Quality::Fix => "fix",
            Quality::Float => "float",
            Quality::Sbas => "sbas",
            Quality::Dgps => "dgps",
            Quality::Single => "single",
            Quality::Ppp => "ppp",
            Quality::Other => "other",
        }
    }
}

const ZERO_WANTED: &str =
    "zero, a date and time from 1996 on (2026-05-01T10:00:00Z), and scale: UTC, or GPST without a zone";

/// The setting.
pub struct Setting {
    /// The world of the problem on the Earth.
    pub world: World,
    /// Where the clock of the reference is zero, in nanoseconds of GPS time, if that is said.
    zero_gps_ns: Option<i64>,
    accepted: Vec<Quality>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SettingToml {
    world: Option<WorldToml>,
    time: Option<TimeToml>,
    quality: Option<QualityToml>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct WorldToml {
    origin_latitude_deg: Option<f64>,
    origin_longitude_deg: Option<f64>,
    origin_height_m: Option<f64>,
    utm_zone: Option<u32>,
    hemisphere: Option<String>,
    #[serde(default)]
    shift_x_m: f64,
    #[serde(default)]
    shift_y_m: f64,
    #[serde(default)]
    shift_z_m: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TimeToml {
    zero: toml::Value,
    scale: Option<String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct QualityToml {
    accept: Vec<String>,
}

impl Setting {
    /// Reads the setting; `needed_by` is the file that cannot be understood without it.
    pub fn read(problem_folder: &Path, needed_by: &str, findings: &mut Findings) -> Option<Self> {
        let text = match disk::read_text(&problem_folder.join(FILE)) {
            Ok(text) => text,
            Err(error) => {
                let wanted = format!(
                    "the place of the world on the Earth and the zero of time, which {needed_by} needs"
                );
                findings.error(Finding::of_file(FILE, &wanted, &error.to_string()));
                return None;
            }
        };
        let raw: SettingToml = match toml::from_str(&text) {
            Ok(raw) => raw,
            Err(error) => {
                let before = error.span().and_then(|span| text.get(..span.start)).unwrap_or_default();
                let line = before.matches('\n').count() as u64 + 1;
                findings.error(Finding::of_line(FILE, line, "keys of docs/formats.md", error.message()));
                return None;
            }
        };
        let mut refuse = |key: &str, wanted: &str, found: &str| {
            let column = Some(key.to_owned());
            findings.error(Finding { column, ..Finding::of_file(FILE, wanted, found) });
        };
        let world = raw.world.as_ref().map_or(Err("nothing".to_owned()), world);
        let zero_gps_ns = raw.time.as_ref().map(zero_gps_ns).transpose();
        let accepted = raw.quality.as_ref().map_or(Ok(vec![Quality::Fix]), accepted);
        if let Err(found) = &world {
            let wanted = "origin_latitude_deg, origin_longitude_deg and origin_height_m, or utm_zone (1 to 60) and hemisphere (north or south)";
            refuse("world", wanted, found);
        }
        if let Err(found) = &zero_gps_ns {
            refuse("time", ZERO_WANTED, found);
        }
        if let Err(found) = &accepted {
            refuse("quality.accept", "a list of fix, float, sbas, dgps, single, ppp", found);
        }
        Some(Setting { world: world.ok()?, zero_gps_ns: zero_gps_ns.ok()?, accepted: accepted.ok()? })
    }

    /// Where the clock of a receiver is zero, which its file needs.
    pub fn zero_gps_ns(&self, findings: &mut Findings) -> Option<i64> {
        if self.zero_gps_ns.is_none() {
            let column = Some("time".to_owned());
            findings.error(Finding { column, ..Finding::of_file(FILE, ZERO_WANTED, "nothing") });
        }
        self.zero_gps_ns
    }

    /// Whether positions of this quality are compared.
    pub fn accepts(&self, quality: Quality) -> bool {
        self.accepted.contains(&quality)
    }

    /// The qualities that are.
    pub fn accepted_names(&self) -> String {
        self.accepted.iter().map(|quality| quality.name()).collect::<Vec<_>>().join(", ")
    }
}

fn world(raw: &WorldToml) -> Result<World, String> {
    let shift_m = Vector3::new(raw.shift_x_m, raw.shift_y_m, raw.shift_z_m);
    let origin = (raw.origin_latitude_deg, raw.origin_longitude_deg, raw.origin_height_m);
    match (origin, raw.utm_zone, raw.hemisphere.as_deref()) {
        ((Some(latitude), Some(longitude), Some(height)), None, None) if shift_m == Vector3::zeros() => {
            World::tangent(latitude, longitude, height).ok_or(format!("{latitude} {longitude} {height}"))
        }
        ((None, None, None), Some(zone @ 1..=60), Some(half @ ("north" | "south")))
            if shift_m.iter().all(|v| v.is_finite()) =>
        {
            World::utm(zone, half == "south", shift_m).ok_or(format!("zone {zone}"))
        }
        _ => Err("another combination".to_owned()),
    }
}

fn zero_gps_ns(raw: &TimeToml) -> Result<i64, String> {
    let text = match &raw.zero {
        toml::Value::Datetime(zero) => zero.to_string(),
        toml::Value::String(zero) => zero.clone(),
        other => other.to_string(),
    };
    let scale = raw.scale.as_deref().unwrap_or("UTC");
    let found = || format!("{text} {scale}");
    let plain = NaiveDateTime::parse_from_str(&text, "%Y-%m-%dT%H:%M:%S%.f").ok();
    let zoned = DateTime::parse_from_rfc3339(&text).ok().map(|zero| zero.naive_utc());
    let (civil, scale) = match scale {
        "GPST" => (plain, TimeScale::Gpst),
        "UTC" => (zoned.or(plain), TimeScale::Utc),
        _ => (None, TimeScale::Utc),
    };
    civil.and_then(|civil| gps_ns(civil, scale)).ok_or_else(found)
}

fn accepted(raw: &QualityToml) -> Result<Vec<Quality>, String> {
    let named = |name: &String| {
        let of_name = |quality: &&Quality| **quality != Quality::Other && quality.name() == name;
        Quality::ALL.iter().find(of_name).copied().ok_or_else(|| name.clone())
    };
    let accepted: Vec<Quality> = raw.accept.iter().map(named).collect::<Result<_, _>>()?;
    if accepted.is_empty() { Err("an empty list".to_owned()) } else { Ok(accepted) }
}
