//! Solutions of RTKLIB (`.pos`): a header whose last line names the time scale and the columns.

use super::earth::{ecef_m, enu_from_ecef, geodetic_deg, is_near_the_ground};
use super::instant::{TimeScale, gps_ns, of_week};
use super::{Epoch, Quality, finite, sigma, turned_sigmas};
use crate::tables::{Finding, Findings};
use chrono::NaiveDateTime;
use nalgebra::{Matrix3, Point3, Vector3};

/// In which coordinates positions are.
#[derive(Clone, Copy, Debug)]
enum Form {
    /// Latitude, longitude, height.
    Geodetic,
    /// Earth-centred, Earth-fixed.
    Cartesian,
    /// East, north, up of a base at these coordinates, with its latitude and longitude.
    Baseline { base_ecef_m: Point3<f64>, base_deg: [f64; 2] },
}

/// What the header says.
struct Header {
    scale: TimeScale,
    form: Form,
    /// Names without units; the time has two cells before them.
    columns: Vec<String>,
}

const COLUMNS: &str = "a header line with a time scale (GPST, UTC or JST) and columns: latitude(deg) longitude(deg) height(m), \
                       x-ecef(m) y-ecef(m) z-ecef(m), or e-baseline(m) n-baseline(m) u-baseline(m) and a line ref pos";

pub(super) fn parse(text: &str, file: &str, findings: &mut Findings) -> Option<Vec<Epoch>> {
    let mut header = None;
    let mut base = None;
    let mut epochs = Vec::new();
    for (at, line) in text.lines().enumerate() {
        let number = at as u64 + 1;
        let mut refuse = |wanted: &str, found: &str| {
            findings.error(Finding::of_line(file, number, wanted, found));
            None
        };
        if let Some(told) = line.strip_prefix('%') {
            if told.contains("WGS84/geodetic") {
                return refuse("heights above the ellipsoid (out-height = ellipsoidal)", told.trim());
            }
            if let Some((_, place)) = told.split_once("ref pos").and_then(|(_, rest)| rest.split_once(':')) {
                base = Some(place.trim().to_owned());
            }
            if let Some(read) = read_header(told, base.as_deref()) {
                header = Some(read);
            }
            continue;
        }
        if line.trim().is_empty() {
            continue;
        }
        let Some(header) = &header else { return refuse(COLUMNS, line) };
        match epoch(header, line, number) {
            Ok(epoch) => epochs.push(epoch),
            Err((column, wanted, found)) => {
                findings.error(Finding::of_cell(file, number, column, wanted, &found));
                return None;
            }
        }
    }
    if header.is_none() {
        findings.error(Finding::of_file(file, COLUMNS, "none"));
        return None;
    }
    Some(epochs)
}

fn cells(line: &str) -> Vec<&str> {
    line.split(|c: char| c.is_whitespace() || c == ',' || c == ';').filter(|cell| !cell.is_empty()).collect()
}

fn read_header(line: &str, base: Option<&str>) -> Option<Header> {
    let names = cells(line);
    let scale = TimeScale::named(names.first()?)?;
    let unit = |name: &str| name.split_once('(').map_or("", |(_, unit)| unit).to_owned();
    let columns: Vec<String> =
        names[1..].iter().map(|name| name.split('(').next().unwrap_or(name).to_owned()).collect();
    let has = |wanted: [&str; 3]| columns.len() >= 3 && (0..3).all(|i| columns[i] == wanted[i]);
    let form = if has(["latitude", "longitude", "height"]) && unit(names[1]) == "deg)" {
        Form::Geodetic
    } else if has(["x-ecef", "y-ecef", "z-ecef"]) {
        Form::Cartesian
    } else if has(["e-baseline", "n-baseline", "u-baseline"]) {
        let base: Vec<f64> = cells(base?).into_iter().map(finite).collect::<Option<_>>()?;
        let [latitude, longitude, height] = base[..] else { return None };
        Form::Baseline { base_ecef_m: ecef_m(latitude, longitude, height)?, base_deg: [latitude, longitude] }
    } else {
        return None;
    };
    Some(Header { scale, form, columns })
}

type Refused<'a> = (&'a str, &'a str, String);

fn epoch<'a>(header: &'a Header, line: &str, number: u64) -> Result<Epoch, Refused<'a>> {
    let cells = cells(line);
    let [day, clock, values @ ..] = &cells[..] else {
        return Err(("time", "a date and a time, or a week and seconds", line.to_owned()));
    };
    let gps_ns = time(header.scale, day, clock)
        .ok_or_else(|| ("time", "yyyy/mm/dd hh:mm:ss.sss or week and seconds", format!("{day} {clock}")))?;
    let cell = |name: &str| header.columns.iter().position(|n| n == name).and_then(|at| values.get(at));
    let value = |name: &str| cell(name).and_then(|cell| finite(cell));
    let all = |names: [&str; 3]| Some(Vector3::new(value(names[0])?, value(names[1])?, value(names[2])?));
    let mut coordinates = Vector3::zeros();
    for axis in 0..3 {
        let name = header.columns[axis].as_str();
        coordinates[axis] = value(name).ok_or_else(|| {
            (
                name,
                "a finite number",
                values.get(axis).map_or("nothing".to_owned(), |cell| (*cell).to_owned()),
            )
        })?;
    }
    let place = match header.form {
        Form::Geodetic => ecef_m(coordinates[0], coordinates[1], coordinates[2]),
        Form::Cartesian => Some(Point3::from(coordinates)),
        Form::Baseline { base_ecef_m, base_deg } => {
            Some(base_ecef_m + enu_from_ecef(base_deg[0], base_deg[1]).transpose() * coordinates)
        }
    };
    let first = header.columns[0].as_str();
    let no_place =
        || (first, "a place on the Earth", format!("{} {} {}", coordinates.x, coordinates.y, coordinates.z));
    let ecef_m = place.filter(is_near_the_ground).ok_or_else(no_place)?;
    let degrees = match header.form {
        Form::Geodetic => Some([coordinates[0], coordinates[1]]),
        Form::Cartesian => geodetic_deg(ecef_m),
        Form::Baseline { base_deg, .. } => Some(base_deg),
    };
    let [latitude, longitude] = degrees.ok_or_else(no_place)?;
    let enu_from_ecef = enu_from_ecef(latitude, longitude);
    let is_cartesian = matches!(header.form, Form::Cartesian);
    let sigma_enu_m = if is_cartesian {
        let covariance = all(["sdx", "sdy", "sdz"])
            .filter(|sigma| sigma.min() >= 0.0)
            .map(|sigma| covariance(sigma, all(["sdxy", "sdyz", "sdzx"]).unwrap_or_default()));
        covariance.map_or([None; 3], |covariance| turned_sigmas(&enu_from_ecef, &covariance))
    } else {
        ["sde", "sdn", "sdu"].map(value).map(|found| found.and_then(sigma))
    };
    let ecef_velocity_mps = if is_cartesian {
        all(["vx", "vy", "vz"])
    } else {
        all(["ve", "vn", "vu"]).map(|enu| enu_from_ecef.transpose() * enu)
    };
    let quality = match cell("Q").copied() {
        Some("1") => Quality::Fix,
        Some("2") => Quality::Float,
        Some("3") => Quality::Sbas,
        Some("4") => Quality::Dgps,
        Some("5") => Quality::Single,
        Some("6") => Quality::Ppp,
        Some(cell) if finite(cell).is_some() => Quality::Other,
        cell => return Err(("Q", "a quality flag from 1 to 6", cell.unwrap_or("nothing").to_owned())),
    };
    Ok(Epoch { line: number, gps_ns, ecef_m, ecef_velocity_mps, sigma_enu_m, quality })
}

fn time(scale: TimeScale, day: &str, clock: &str) -> Option<i64> {
    if day.contains('/') {
        let civil = NaiveDateTime::parse_from_str(&format!("{day} {clock}"), "%Y/%m/%d %H:%M:%S%.f").ok()?;
        return gps_ns(civil, scale);
    }
    // Weeks are those of GPS time.
    (scale == TimeScale::Gpst).then(|| of_week(finite(day)?, finite(clock)?))?
}

/// From standard deviations and the signed roots of covariances (xy, yz, zx).
fn covariance(sigma: Vector3<f64>, root: Vector3<f64>) -> Matrix3<f64> {
    let [xx, yy, zz] = [0, 1, 2].map(|axis| sigma[axis] * sigma[axis]);
    let [xy, yz, zx] = [0, 1, 2].map(|axis| root[axis] * root[axis].abs());
    Matrix3::new(xx, xy, zx, xy, yy, yz, zx, yz, zz)
}
