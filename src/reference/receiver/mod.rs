//! Tracks in the files of receivers: RTKLIB solutions, NMEA 0183 and TUM.
//!
//! What is on the Earth comes into the world of the problem by `reference/reference.toml` ([`setting`]).

mod earth;
mod instant;
mod nmea0183;
mod rtklib;
mod setting;
mod tum;

use super::GnssPosition;
use crate::disk;
use crate::tables::{Finding, Findings};
use nalgebra::{Matrix3, Point3, Vector3};
use setting::{Quality, Setting};
use std::path::Path;

pub use earth::World;
pub use setting::FILE as SETTING_FILE;

/// Ends of the names of such files.
const ENDS: [&str; 3] = [".pos", ".nmea", ".tum"];

/// Whether `name` is such a file of one of the vehicles.
pub fn is_track(name: &str, vehicles: &[String]) -> bool {
    vehicles.iter().any(|id| name.strip_prefix(id.as_str()).is_some_and(|end| ENDS.contains(&end)))
}

/// A position on the Earth as a receiver gives it.
#[derive(Clone, Debug)]
struct Epoch {
    line: u64,
    /// Nanoseconds of GPS time since 1980-01-06.
    gps_ns: i64,
    /// Earth-centred, Earth-fixed \[m\].
    ecef_m: Point3<f64>,
    /// Earth-centred, Earth-fixed \[m/s\].
    ecef_velocity_mps: Option<Vector3<f64>>,
    /// Standard deviations to the east, north and up \[m\].
    sigma_enu_m: [Option<f64>; 3],
    quality: Quality,
}

/// What receivers and their setting tell.
pub struct Received {
    /// The track of each vehicle that has such a file, with the file.
    pub tracks: Vec<(String, String, Vec<GnssPosition>)>,
    /// Where the world is on the Earth, if there is a setting.
    pub world: Option<World>,
}

/// Reads the files of receivers and their setting.
pub fn read(problem_folder: &Path, vehicles: &[String], findings: &mut Findings) -> Received {
    let mut tracks = Vec::new();
    let is_set = std::fs::symlink_metadata(problem_folder.join(SETTING_FILE)).is_ok();
    let mut setting = is_set.then(|| Setting::read(problem_folder, "the file of a receiver", findings));
    for vehicle in vehicles {
        for end in ENDS {
            let file = format!("reference/{vehicle}{end}");
            let path = problem_folder.join(&file);
            if std::fs::symlink_metadata(&path).is_err() {
                continue;
            }
            let bytes = match disk::read(&path) {
                Ok(bytes) => bytes,
                Err(error) => {
                    findings.error(Finding::of_file(&file, "a file that can be read", &error.to_string()));
                    continue;
                }
            };
            let text = String::from_utf8_lossy(&bytes);
            let text = text.trim_start_matches('\u{feff}');
            let track = if end == ".tum" {
                tum::parse(text, &file, findings)
            } else {
                let setting = setting.get_or_insert_with(|| Setting::read(problem_folder, &file, findings));
                let Some(setting) = setting else { continue };
                let epochs = match end {
                    ".pos" => rtklib::parse(text, &file, findings),
                    _ => nmea0183::parse(text, &file, findings),
                };
                epochs.and_then(|epochs| in_world(epochs, setting, &file, findings))
            };
            tracks.extend(track.map(|track| (vehicle.clone(), file, track)));
        }
    }
    Received { tracks, world: setting.flatten().map(|setting| setting.world) }
}

/// Epochs of an accepted quality, in the world of the problem.
fn in_world(
    epochs: Vec<Epoch>,
    setting: &Setting,
    file: &str,
    findings: &mut Findings,
) -> Option<Vec<GnssPosition>> {
    let (accepted, others): (Vec<Epoch>, Vec<Epoch>) =
        epochs.into_iter().partition(|epoch| setting.accepts(epoch.quality));
    let counts: Vec<String> = Quality::ALL
        .iter()
        .map(|quality| (quality, others.iter().filter(|epoch| epoch.quality == *quality).count()))
        .filter(|(_, count)| *count > 0)
        .map(|(quality, count)| format!("{count} {}", quality.name()))
        .collect();
    let told = counts.join(", ");
    if accepted.is_empty() {
        let wanted = format!("positions of an accepted quality ({})", setting.accepted_names());
        findings.error(Finding::of_file(file, &wanted, if told.is_empty() { "none" } else { &told }));
        return None;
    }
    if !others.is_empty() {
        let names = setting.accepted_names();
        findings.warn(format!("{file}: left out by their quality (accepted: {names}): {told}"));
    }
    let zero_gps_ns = setting.zero_gps_ns(findings)?;
    let mut track: Vec<GnssPosition> = Vec::new();
    for epoch in accepted {
        let position = setting.world.place(epoch.ecef_m);
        let position = GnssPosition {
            time_s: (epoch.gps_ns.saturating_sub(zero_gps_ns)) as f64 * 1e-9,
            position,
            velocity_mps: epoch.ecef_velocity_mps.map(|v| setting.world.velocity(epoch.ecef_m, v)),
            sigma_m: epoch.sigma_enu_m,
        };
        push(&mut track, position, file, epoch.line, findings)?;
    }
    Some(track)
}

/// Adds a position that is finite and later than the last one.
fn push(
    track: &mut Vec<GnssPosition>,
    position: GnssPosition,
    file: &str,
    line: u64,
    findings: &mut Findings,
) -> Option<()> {
    let mut refused = |wanted: &str, found: &str| {
        findings.error(Finding::of_line(file, line, wanted, found));
        None
    };
    let velocity = position.velocity_mps.unwrap_or_default();
    if !position.position.coords.iter().chain(velocity.iter()).all(|v| v.is_finite()) {
        return refused(
            "a position and a velocity that the world of reference/reference.toml can take",
            "none",
        );
    }
    match track.last() {
        Some(last) if position.time_s <= last.time_s => refused(
            &format!("a time after that of the line before ({} s)", last.time_s),
            &format!("{} s", position.time_s),
        ),
        _ => {
            track.push(position);
            Some(())
        }
    }
}

/// A finite number in a cell.
fn finite(cell: &str) -> Option<f64> {
    cell.parse::<f64>().ok().filter(|v| v.is_finite())
}

/// A standard deviation, where the number can be one.
fn sigma(value: f64) -> Option<f64> {
    (value.is_finite() && value >= 0.0).then_some(value)
}

/// Standard deviations along axes that are turned by `r`, from variances and covariances.
fn turned_sigmas(r: &Matrix3<f64>, covariance: &Matrix3<f64>) -> [Option<f64>; 3] {
    let turned = r * covariance * r.transpose();
    [0, 1, 2].map(|axis| sigma(turned[(axis, axis)].sqrt()))
}

#[cfg(test)]
mod tests;
