//! The tables of a result folder.

use super::rounding::{METRE, PIXEL, RATIO, metres, round};
use super::{File, cloud};
use crate::diagnose::{Diagnosis, PosePrecision, Precision};
use crate::estimate::Estimate;
use crate::files::rows::{
    CameraPoseResult, ResidualRow, ResultRow, StateResult, TargetResultRow, TrajectoryResult,
    VehiclePointResult, VehiclePoseResult,
};
use crate::files::{RESIDUALS, RESULT_TARGETS, ResultRole, START_RESIDUALS};
use crate::geometry::{Pose, quaternion_wxyz};
use crate::problem::{Problem, Role, Target};
use crate::refine::{CheckPoint, Fits, ImagePointVerdict, ObservationFit};
use crate::tables::ResultSigma;
use crate::words::Warning;
use nalgebra::{Point3, Vector2};

/// All tables and clouds of a result; standard deviations that are not there are left empty.
pub fn result_tables(
    problem: &Problem,
    estimate: &Estimate,
    fits: &Fits,
    precision: Option<&Precision>,
) -> Vec<File> {
    let none = Precision::default();
    let precision = precision.unwrap_or(&none);
    let mut files = vec![
        table("camera_poses.csv", camera_poses(problem, estimate, precision)),
        table("vehicle_poses.csv", vehicle_poses(problem, estimate, precision)),
        table("vehicle_points.csv", vehicle_points(problem, estimate, fits, precision)),
        table("trajectories.csv", trajectories(problem, estimate, precision)),
        table(RESIDUALS, residuals(problem, fits)),
    ];
    for (at, (vehicle, estimate)) in problem.vehicles.iter().zip(&estimate.vehicles).enumerate() {
        if estimate.left_out.is_none() {
            let sigmas = precision.points.get(at).map_or(&[][..], Vec::as_slice);
            files.push((format!("shape_{}.ply", vehicle.id), cloud::shape(vehicle, estimate, sigmas)));
        }
    }
    files
}

/// The image residuals of the first estimate.
pub fn start_residuals_table(problem: &Problem, fits: &Fits) -> File {
    table(START_RESIDUALS, residuals(problem, fits))
}

/// Standard deviations of a pose as they are written: position, then roll, pitch and yaw in degrees.
fn pose_sigmas(precision: Option<&PosePrecision>) -> [Option<f64>; 6] {
    let Some(PosePrecision { position_m, attitude_rad }) = precision else { return [None; 6] };
    std::array::from_fn(|i| {
        Some(match i {
            0..3 => metres(position_m[i]),
            _ => round(attitude_rad[i - 3].to_degrees(), PIXEL),
        })
    })
}

/// A table as CSV, its header first even when no row follows.
pub(super) fn table<R: ResultRow>(name: &str, rows: Vec<R>) -> File {
    let mut writer = csv::WriterBuilder::new().has_headers(false).from_writer(Vec::new());
    writer.write_record(R::HEADER).expect("writing to memory");
    for row in rows {
        writer.serialize(row).expect("a row of plain values");
    }
    (name.to_owned(), writer.into_inner().expect("writing to memory"))
}

/// Whether a cell holds what is no number; standard deviations may be infinite.
fn is_no_number(column: &str, cell: &[u8]) -> bool {
    let may_be_infinite = column.starts_with("sigma_") || column.starts_with("reference_sigma_");
    matches!(cell, b"NaN" | b"-inf") || cell == b"inf" && !may_be_infinite
}

/// Which columns of a table hold texts.
fn texts_of(table: &str) -> Option<&'static [bool]> {
    Some(match table {
        "camera_poses.csv" => CameraPoseResult::TEXTS,
        "vehicle_poses.csv" => VehiclePoseResult::TEXTS,
        "vehicle_points.csv" => VehiclePointResult::TEXTS,
        "trajectories.csv" => TrajectoryResult::TEXTS,
        "states.csv" => StateResult::TEXTS,
        RESULT_TARGETS => TargetResultRow::TEXTS,
        RESIDUALS | START_RESIDUALS => ResidualRow::TEXTS,
        _ => return None,
    })
}

/// Leaves cells of tables empty that hold no finite number (but for standard deviations of what nothing determines), and
/// tells in which columns, and how many.
pub fn finite_alone(files: &mut [File]) -> Vec<Warning> {
    let mut told = Vec::new();
    for (name, bytes) in files {
        let Some(texts) = texts_of(name) else { continue };
        if !bytes.windows(3).any(|three| three == b"NaN" || three == b"inf") {
            continue;
        }
        let (cleared, counts) = with_numbers_alone(bytes, texts);
        *bytes = cleared;
        let warning = |(column, cells)| Warning::NotFinite { table: name.clone(), column, cells };
        told.extend(counts.into_iter().map(warning));
    }
    told
}

/// A table without what is no number, and how many cells of which columns those were.
fn with_numbers_alone(bytes: &[u8], texts: &[bool]) -> (Vec<u8>, Vec<(String, usize)>) {
    let mut reader = csv::ReaderBuilder::new().from_reader(bytes);
    let header = reader.headers().expect("a table that was just written").clone();
    let mut counts = vec![0; header.len()];
    let mut writer = csv::WriterBuilder::new().from_writer(Vec::with_capacity(bytes.len()));
    writer.write_record(&header).expect("writing to memory");
    for record in reader.byte_records() {
        let record = record.expect("a table that was just written");
        let cells = record.iter().enumerate().map(|(at, cell)| {
            let is_number = texts[at] || !is_no_number(&header[at], cell);
            counts[at] += usize::from(!is_number);
            if is_number { cell } else { &[][..] }
        });
        writer.write_record(cells.collect::<Vec<_>>()).expect("writing to memory");
    }
    let counts = header.iter().map(str::to_owned).zip(counts).filter(|(_, count)| *count > 0).collect();
    (writer.into_inner().expect("writing to memory"), counts)
}

/// Position and quaternion as they are written.
fn pose_numbers(pose: &Pose) -> ([f64; 3], [f64; 4]) {
    let position: [f64; 3] = pose.translation.vector.into();
    (position.map(metres), quaternion_wxyz(pose).map(|v| round(v, RATIO)))
}

fn camera_poses(problem: &Problem, estimate: &Estimate, precision: &Precision) -> Vec<CameraPoseResult> {
    let row = |(at, (frame, pose)): (usize, (&crate::problem::Frame, &Pose))| {
        let sigmas = pose_sigmas(precision.cameras.get(at).and_then(Option::as_ref));
        let [sigma_x, sigma_y, sigma_z, sigma_roll_deg, sigma_pitch_deg, sigma_yaw_deg] = sigmas;
        let ([x, y, z], [qw, qx, qy, qz]) = pose_numbers(pose);
        CameraPoseResult {
            frame: frame.number,
            x,
            y,
            z,
            qw,
            qx,
            qy,
            qz,
            sigma_x,
            sigma_y,
            sigma_z,
            sigma_roll_deg,
            sigma_pitch_deg,
            sigma_yaw_deg,
        }
    };
    problem.frames.iter().zip(&estimate.camera_poses).enumerate().map(row).collect()
}

fn vehicle_poses(problem: &Problem, estimate: &Estimate, precision: &Precision) -> Vec<VehiclePoseResult> {
    let mut rows = Vec::new();
    for (frame_at, frame) in problem.frames.iter().enumerate() {
        for (at, (vehicle, estimate)) in problem.vehicles.iter().zip(&estimate.vehicles).enumerate() {
            let reported = estimate.left_out.is_none() && vehicle.span().contains(&frame_at);
            let Some(pose) = estimate.poses[frame_at].filter(|_| reported) else { continue };
            let ([x, y, z], [qw, qx, qy, qz]) = pose_numbers(&pose);
            let of_vehicle = precision.vehicles.get(at).and_then(|poses| poses.get(frame_at));
            let sigmas = pose_sigmas(of_vehicle.and_then(Option::as_ref));
            let [sigma_x, sigma_y, sigma_z, sigma_roll_deg, sigma_pitch_deg, sigma_yaw_deg] = sigmas;
            rows.push(VehiclePoseResult {
                frame: frame.number,
                vehicle: vehicle.id.clone(),
                x,
                y,
                z,
                qw,
                qx,
                qy,
                qz,
                sigma_x,
                sigma_y,
                sigma_z,
                sigma_roll_deg,
                sigma_pitch_deg,
                sigma_yaw_deg,
            });
        }
    }
    rows
}

fn vehicle_points(
    problem: &Problem,
    estimate: &Estimate,
    fits: &Fits,
    precision: &Precision,
) -> Vec<VehiclePointResult> {
    let mut rows = Vec::new();
    for (at, (vehicle, estimate)) in problem.vehicles.iter().zip(&estimate.vehicles).enumerate() {
        let mut of_point: Vec<Vec<ObservationFit>> = vec![Vec::new(); vehicle.points.len()];
        for (observation, fit) in vehicle.observations.iter().zip(&fits.vehicles[at]) {
            of_point[observation.point].extend(fit);
        }
        let sightings = vehicle.sightings();
        for (point, shape_point) in vehicle.points.iter().enumerate() {
            let position = estimate.points[point].filter(|_| estimate.left_out.is_none());
            let coordinate = |axis: usize| position.map(|p| metres(p[axis]));
            let sigmas = precision.points.get(at).and_then(|points| points[point]);
            let sigma = |axis: usize| sigmas.map(|sigmas| metres(sigmas[axis]));
            let inliers: Vec<f64> = of_point[point]
                .iter()
                .filter(|fit| !fit.is_outlier)
                .map(|fit| fit.residual_px.norm_squared())
                .collect();
            let mean_square = inliers.iter().sum::<f64>() / (2 * inliers.len().max(1)) as f64;
            rows.push(VehiclePointResult {
                vehicle: vehicle.id.clone(),
                point: shape_point.id.clone(),
                x: coordinate(0),
                y: coordinate(1),
                z: coordinate(2),
                sigma_x: sigma(0),
                sigma_y: sigma(1),
                sigma_z: sigma(2),
                observations: sightings[point],
                inliers: inliers.len(),
                rms_px: (!inliers.is_empty()).then(|| round(mean_square.sqrt(), PIXEL)),
            });
        }
    }
    rows
}

fn trajectories(problem: &Problem, estimate: &Estimate, precision: &Precision) -> Vec<TrajectoryResult> {
    let mut rows = Vec::new();
    for (index, (vehicle, estimate)) in problem.vehicles.iter().zip(&estimate.vehicles).enumerate() {
        if estimate.left_out.is_some() {
            continue;
        }
        let of_vehicle = precision.tracks.get(index);
        for (place, at) in estimate.track(problem, vehicle).into_iter().enumerate() {
            let frame = problem.frames[at.frame];
            let sigmas = of_vehicle.and_then(|track| track[place]);
            let sigma = |axis: usize| sigmas.map(|sigmas| metres(sigmas.position_m[axis]));
            rows.push(TrajectoryResult {
                vehicle: vehicle.id.clone(),
                frame: frame.number,
                time_s: frame.time_s,
                x: metres(at.position.x),
                y: metres(at.position.y),
                z: metres(at.position.z),
                speed_mps: at.speed_mps.map(|v| round(v, METRE)),
                heading_deg: round(at.heading_rad.to_degrees(), PIXEL),
                sigma_x: sigma(0),
                sigma_y: sigma(1),
                sigma_z: sigma(2),
                cov_xy: sigmas.and_then(|s| s.covariance_xy_m2).map(|c| round(c, RATIO)),
                sigma_speed_mps: sigmas.and_then(|s| s.speed_mps).map(|v| round(v, METRE)),
                sigma_heading_deg: sigmas.map(|s| round(s.heading_rad.to_degrees(), PIXEL)),
            });
        }
    }
    rows
}

/// `states.csv`: the paths of all vehicles, so many times a second.
pub fn states_table(
    problem: &Problem,
    estimate: &Estimate,
    precision: Option<&Precision>,
    rate_hz: f64,
) -> File {
    let mut rows = Vec::new();
    for (at, (vehicle, found)) in problem.vehicles.iter().zip(&estimate.vehicles).enumerate() {
        let Some(path) = found.path(problem, vehicle).filter(|_| found.left_out.is_none()) else { continue };
        let marker = vehicle.marker.and_then(|marker| found.points[marker]).unwrap_or_default();
        let sigmas = precision.and_then(|precision| precision.states.get(at)).map_or(&[][..], Vec::as_slice);
        let mut sigmas = sigmas.iter().peekable();
        for time_s in path.times_at(rate_hz) {
            let Some(state) = path.state_at(time_s) else { continue };
            let own = sigmas.next_if(|sigmas| sigmas.time_s == time_s);
            let (place, v, a) =
                (state.pose * marker, state.velocity_of(&marker), state.acceleration_of(&marker));
            let sigma = |axis: usize| own.map(|own| metres(own.position_m[axis]));
            let sigma_v = |axis: usize| own.map(|own| round(own.velocity_mps[axis], METRE));
            let degrees = |rad: f64| round(rad.to_degrees(), PIXEL);
            rows.push(StateResult {
                vehicle: vehicle.id.clone(),
                time_s: round(time_s, METRE),
                x: metres(place.x),
                y: metres(place.y),
                z: metres(place.z),
                vx: round(v.x, METRE),
                vy: round(v.y, METRE),
                vz: round(v.z, METRE),
                ax: round(a.x, METRE),
                ay: round(a.y, METRE),
                az: round(a.z, METRE),
                speed_mps: round(v.xy().norm(), METRE),
                heading_deg: degrees(state.heading_rad()),
                yaw_rate_degps: degrees(state.yaw_rate_rps()),
                sigma_x: sigma(0),
                sigma_y: sigma(1),
                sigma_z: sigma(2),
                sigma_vx: sigma_v(0),
                sigma_vy: sigma_v(1),
                sigma_vz: sigma_v(2),
                sigma_speed_mps: own.map(|own| round(own.speed_mps, METRE)),
                sigma_heading_deg: own.map(|own| degrees(own.heading_rad)),
                sigma_yaw_rate_degps: own.map(|own| degrees(own.yaw_rate_rps)),
            });
        }
    }
    table("states.csv", rows)
}

fn residuals(problem: &Problem, fits: &Fits) -> Vec<ResidualRow> {
    let row = |frame: usize,
               of: [&str; 3],
               image_px: Vector2<f64>,
               fit: &ObservationFit,
               verdict: &ImagePointVerdict| {
        let [kind, vehicle, point] = of;
        let computed_px = image_px - fit.residual_px;
        ResidualRow {
            frame: problem.frames[frame].number,
            kind: kind.to_owned(),
            vehicle: Some(vehicle.to_owned()),
            point: point.to_owned(),
            du: round(fit.residual_px.x, PIXEL),
            dv: round(fit.residual_px.y, PIXEL),
            weight: round(fit.weight, RATIO),
            reason: verdict.reason().map(|reason| reason.name().to_owned()),
            u_computed: Some(round(computed_px.x, PIXEL)),
            v_computed: Some(round(computed_px.y, PIXEL)),
        }
    };
    let mut rows = Vec::new();
    for ((vehicle, fits), verdicts) in
        problem.vehicles.iter().zip(&fits.vehicles).zip(&fits.verdicts.vehicles)
    {
        for ((o, fit), verdict) in vehicle.observations.iter().zip(fits).zip(verdicts) {
            let of = ["vehicle", &vehicle.id, &vehicle.points[o.point].id];
            rows.extend(fit.map(|fit| row(o.frame, of, o.image_px, &fit, verdict)));
        }
    }
    for ((o, fit), verdict) in
        problem.target_observations.iter().zip(&fits.targets).zip(&fits.verdicts.targets)
    {
        let of = ["target", "", &problem.targets[o.target].id];
        rows.extend(fit.map(|fit| row(o.frame, of, o.image_px, &fit, verdict)));
    }
    rows
}

/// `targets.csv`: where targets are, and how their surveys agree. Check points are where the adjusted cameras see
/// them.
pub fn targets_table(
    problem: &Problem,
    estimate: &Estimate,
    fits: &Fits,
    checks: &[CheckPoint],
    diagnosis: Option<&Diagnosis>,
) -> File {
    let mut counts = vec![[0; 2]; problem.targets.len()];
    for (o, verdict) in problem.target_observations.iter().zip(&fits.verdicts.targets) {
        counts[o.target][usize::from(verdict.reason().is_some())] += 1;
    }
    let row = |(at, target): (usize, &Target)| {
        let adjusted = match target.role {
            Role::Control => adjusted_target(estimate, diagnosis, at),
            Role::Check => checked_target(target, checks, diagnosis, at),
        };
        let AdjustedTarget { place, sigma_m, w } = adjusted;
        let difference = |axis: usize| Some(round(target.known[axis]?.value_m - place?[axis], METRE));
        let sigma = |axis: usize| ResultSigma(sigma_m.map(|sigma_m| metres(sigma_m[axis])));
        let w = |axis: usize| w[axis].map(|w| round(w, PIXEL));
        let role = match target.role {
            Role::Check => ResultRole::Check,
            Role::Control if target.known.iter().any(Option::is_some) => ResultRole::Control,
            Role::Control => ResultRole::Tie,
        };
        let [used, rejected] = counts[at];
        TargetResultRow {
            target: target.id.clone(),
            role: role.name().to_owned(),
            x: place.map(|place| metres(place.x)),
            y: place.map(|place| metres(place.y)),
            z: place.map(|place| metres(place.z)),
            sigma_x: sigma(0),
            sigma_y: sigma(1),
            sigma_z: sigma(2),
            dx: difference(0),
            dy: difference(1),
            dz: difference(2),
            w_x: w(0),
            w_y: w(1),
            w_z: w(2),
            used,
            rejected,
        }
    };
    table(RESULT_TARGETS, problem.targets.iter().enumerate().map(row).collect())
}

/// Where a target is \[m\], its standard deviations, and its survey's difference from it in units of its own.
#[derive(Default)]
struct AdjustedTarget {
    place: Option<Point3<f64>>,
    sigma_m: Option<[f64; 3]>,
    w: [Option<f64>; 3],
}

fn adjusted_target(estimate: &Estimate, diagnosis: Option<&Diagnosis>, target: usize) -> AdjustedTarget {
    AdjustedTarget {
        place: estimate.targets[target],
        sigma_m: diagnosis.and_then(|found| found.precision.targets.get(target).copied().flatten()),
        w: diagnosis.and_then(|found| found.survey_tests.get(target).copied()).unwrap_or_default(),
    }
}

fn checked_target(
    target: &Target,
    checks: &[CheckPoint],
    diagnosis: Option<&Diagnosis>,
    at: usize,
) -> AdjustedTarget {
    let Some(check) = checks.iter().position(|check| check.target == at) else {
        return AdjustedTarget::default();
    };
    let difference_m = checks[check].difference_m;
    let precision = diagnosis.and_then(|found| found.check_points.get(check));
    let w = |axis: usize| {
        let sigma_m = precision?.sigma_m?[axis];
        (sigma_m > 0.0).then_some(-difference_m?[axis] / sigma_m)
    };
    AdjustedTarget {
        place: target.surveyed().zip(difference_m).map(|(surveyed, difference_m)| surveyed + difference_m),
        sigma_m: precision.and_then(|found| found.place_sigma_m),
        w: [0, 1, 2].map(w),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_empty_table_has_its_header() {
        let (name, bytes) = table::<TrajectoryResult>("t.csv", Vec::new());
        assert_eq!(name, "t.csv");
        assert!(bytes.starts_with(b"vehicle,frame,time_s,x,y,z,speed_mps,heading_deg,sigma_x,"));
        assert_eq!(bytes.iter().filter(|b| **b == b'\n').count(), 1);
    }
}
