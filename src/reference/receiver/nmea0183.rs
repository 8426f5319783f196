//! NMEA 0183: positions and their quality of GGA, standard deviations of GST, the day of RMC or ZDA.
//!
//! Heights are the altitude and the separation of the geoid of GGA together, which gives the height above the
//! ellipsoid. There is no vertical velocity in NMEA, so velocities are not read.

use super::earth::ecef_m;
use super::instant::{TimeScale, gps_ns};
use super::{Epoch, Quality, sigma};
use crate::tables::{Finding, Findings};
use chrono::{NaiveDate, NaiveTime, TimeDelta};
use nmea::sentences::{FixType, GgaData};
use nmea::{ParseResult, parse_str};

/// What a file says, each with its line.
#[derive(Default)]
struct Log {
    positions: Vec<(u64, GgaData)>,
    sigmas: Vec<(u64, NaiveTime, [Option<f64>; 3])>,
    days: Vec<(u64, NaiveTime, NaiveDate)>,
    damaged: Vec<u64>,
}

pub(super) fn parse(text: &str, file: &str, findings: &mut Findings) -> Option<Vec<Epoch>> {
    let log = read(text);
    if let Some(first) = log.damaged.first() {
        let count = log.damaged.len();
        findings.warn(format!(
            "{file}: sentences that are damaged, left out: {count}, the first in line {first}"
        ));
    }
    if log.positions.is_empty() {
        findings.error(Finding::of_file(file, "sentences GGA with positions", "none"));
        return None;
    }
    if log.days.is_empty() {
        findings.error(Finding::of_file(file, "a sentence RMC or ZDA with the day", "none"));
        return None;
    }
    let mut epochs = Vec::new();
    for (line, found) in &log.positions {
        match epoch(&log, *line, found) {
            Ok(Some(epoch)) => epochs.push(epoch),
            Ok(None) => {}
            Err((wanted, found)) => {
                findings.error(Finding::of_line(file, *line, wanted, &found));
                return None;
            }
        }
    }
    Some(epochs)
}

fn read(text: &str) -> Log {
    let mut log = Log::default();
    for (at, line) in text.lines().enumerate() {
        let number = at as u64 + 1;
        let line = line.trim();
        // Whatever else a receiver writes stands between the sentences.
        let is_wanted = line.starts_with('$')
            && line.get(3..6).is_some_and(|kind| ["GGA", "GST", "RMC", "ZDA"].contains(&kind));
        if !is_wanted {
            continue;
        }
        match parse_str(line) {
            Ok(ParseResult::GGA(found)) => log.positions.push((number, found)),
            Ok(ParseResult::GST(found)) => {
                let sigmas = [found.long_sd, found.lat_sd, found.alt_sd]
                    .map(|found_sigma| found_sigma.map(f64::from).and_then(sigma));
                log.sigmas.extend(found.time.map(|time| (number, time, sigmas)));
            }
            Ok(ParseResult::RMC(found)) => {
                log.days.extend(found.fix_time.zip(found.fix_date).map(|(time, day)| (number, time, day)));
            }
            Ok(ParseResult::ZDA(found)) => {
                log.days.extend(found.utc_time.zip(found.utc_date()).map(|(time, day)| (number, time, day)));
            }
            Ok(_) => {}
            Err(_) => log.damaged.push(number),
        }
    }
    log
}

/// `None` where the receiver had no position.
fn epoch(log: &Log, line: u64, found: &GgaData) -> Result<Option<Epoch>, (&'static str, String)> {
    let quality = match found.fix_type {
        None | Some(FixType::Invalid) => return Ok(None),
        Some(FixType::Rtk) => Quality::Fix,
        Some(FixType::FloatRtk) => Quality::Float,
        Some(FixType::DGps) => Quality::Dgps,
        Some(FixType::Gps) => Quality::Single,
        Some(FixType::Pps | FixType::Estimated | FixType::Manual | FixType::Simulation) => Quality::Other,
    };
    let GgaData { fix_time: Some(time), latitude: Some(latitude), longitude: Some(longitude), .. } = found
    else {
        return Ok(None);
    };
    let (Some(altitude), Some(separation)) = (found.altitude, found.geoid_separation) else {
        return Err(("altitude and separation of the geoid", format!("{found:?}")));
    };
    let height_m = f64::from(altitude) + f64::from(separation);
    let place = ecef_m(*latitude, *longitude, height_m)
        .ok_or_else(|| ("a place on the Earth", format!("{latitude} {longitude} {height_m}")))?;
    let gps_ns = day(log, line, *time)
        .and_then(|day| gps_ns(day.and_time(*time), TimeScale::Utc))
        .ok_or_else(|| ("a day from 1996 on", "none".to_owned()))?;
    let beside = around(&log.sigmas, line, |found| found.0).iter().find(|(_, at, _)| at == time);
    let sigma_enu_m = beside.map_or([None; 3], |found| found.2);
    Ok(Some(Epoch { line, gps_ns, ecef_m: place, ecef_velocity_mps: None, sigma_enu_m, quality }))
}

/// The day of the sentence nearest in the file, or the one before or after it where midnight is between.
fn day(log: &Log, line: u64, time: NaiveTime) -> Option<NaiveDate> {
    let beside = around(&log.days, line, |found| found.0).iter();
    let (_, of_day, day) = beside.min_by_key(|(at, _, _)| at.abs_diff(line))?;
    let later = time - *of_day;
    if later > TimeDelta::hours(12) {
        day.pred_opt()
    } else if later < -TimeDelta::hours(12) {
        day.succ_opt()
    } else {
        Some(*day)
    }
}

/// The last of `found` before a line and the first after it; they are in the order of lines.
fn around<T>(found: &[T], line: u64, line_of: impl Fn(&T) -> u64) -> &[T] {
    let after = found.partition_point(|found| line_of(found) < line);
    &found[after.saturating_sub(1)..(after + 1).min(found.len())]
}
