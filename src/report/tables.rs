//! The tables of a result folder.

use super::rounding::{METRE, PIXEL, RATIO, metres, round};
use super::{File, cloud};
use crate::estimate::Estimate;
use crate::files::rows::{
    CameraPoseResult, ResidualResult, ResultRow, TrajectoryResult, VehiclePointResult, VehiclePoseResult,
};
use crate::geometry::{Pose, quaternion_wxyz};
use crate::problem::Problem;
use crate::refine::{Fits, ObservationFit};

/// All tables and clouds of a result.
pub fn result_tables(problem: &Problem, estimate: &Estimate, fits: &Fits) -> Vec<File> {
    let mut files = vec![
        table("camera_poses.csv", camera_poses(problem, estimate)),
        table("vehicle_poses.csv", vehicle_poses(problem, estimate)),
        table("vehicle_points.csv", vehicle_points(problem, estimate, fits)),
        table("trajectories.csv", trajectories(problem, estimate)),
        table("residuals.csv", residuals(problem, fits)),
    ];
    for (vehicle, estimate) in problem.vehicles.iter().zip(&estimate.vehicles) {
        if estimate.left_out.is_none() {
            files.push((format!("shape_{}.ply", vehicle.id), cloud::shape(vehicle, estimate)));
        }
    }
    files
}

/// A table as CSV, its header first even when no row follows.
fn table<R: ResultRow>(name: &str, rows: Vec<R>) -> File {
    let mut writer = csv::WriterBuilder::new().has_headers(false).from_writer(Vec::new());
    writer.write_record(R::HEADER).expect("writing to memory");
    for row in rows {
        writer.serialize(row).expect("a row of plain values");
    }
    (name.to_owned(), writer.into_inner().expect("writing to memory"))
}

/// Position and quaternion as they are written.
fn pose_numbers(pose: &Pose) -> ([f64; 3], [f64; 4]) {
    let position: [f64; 3] = pose.translation.vector.into();
    (position.map(metres), quaternion_wxyz(pose).map(|v| round(v, RATIO)))
}

fn camera_poses(problem: &Problem, estimate: &Estimate) -> Vec<CameraPoseResult> {
    let row = |(frame, pose): (&crate::problem::Frame, &Pose)| {
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
            sigma_x: None,
            sigma_y: None,
            sigma_z: None,
            sigma_roll_deg: None,
            sigma_pitch_deg: None,
            sigma_yaw_deg: None,
        }
    };
    problem.frames.iter().zip(&estimate.camera_poses).map(row).collect()
}

fn vehicle_poses(problem: &Problem, estimate: &Estimate) -> Vec<VehiclePoseResult> {
    let mut rows = Vec::new();
    for (frame_at, frame) in problem.frames.iter().enumerate() {
        for (vehicle, estimate) in problem.vehicles.iter().zip(&estimate.vehicles) {
            let reported = estimate.left_out.is_none() && vehicle.span().contains(&frame_at);
            let Some(pose) = estimate.poses[frame_at].filter(|_| reported) else { continue };
            let ([x, y, z], [qw, qx, qy, qz]) = pose_numbers(&pose);
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
                sigma_x: None,
                sigma_y: None,
                sigma_z: None,
                sigma_roll_deg: None,
                sigma_pitch_deg: None,
                sigma_yaw_deg: None,
            });
        }
    }
    rows
}

fn vehicle_points(problem: &Problem, estimate: &Estimate, fits: &Fits) -> Vec<VehiclePointResult> {
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
                sigma_x: None,
                sigma_y: None,
                sigma_z: None,
                observations: sightings[point],
                inliers: inliers.len(),
                rms_px: (!inliers.is_empty()).then(|| round(mean_square.sqrt(), PIXEL)),
            });
        }
    }
    rows
}

fn trajectories(problem: &Problem, estimate: &Estimate) -> Vec<TrajectoryResult> {
    let mut rows = Vec::new();
    for (vehicle, estimate) in problem.vehicles.iter().zip(&estimate.vehicles) {
        if estimate.left_out.is_some() {
            continue;
        }
        for at in estimate.track(problem, vehicle) {
            let frame = problem.frames[at.frame];
            rows.push(TrajectoryResult {
                vehicle: vehicle.id.clone(),
                frame: frame.number,
                time_s: frame.time_s,
                x: metres(at.position.x),
                y: metres(at.position.y),
                z: metres(at.position.z),
                speed_mps: at.speed_mps.map(|v| round(v, METRE)),
                heading_deg: round(at.heading_rad.to_degrees(), PIXEL),
                sigma_x: None,
                sigma_y: None,
                sigma_z: None,
                cov_xy: None,
                sigma_speed_mps: None,
                sigma_heading_deg: None,
            });
        }
    }
    rows
}

fn residuals(problem: &Problem, fits: &Fits) -> Vec<ResidualResult> {
    let row = |frame: usize, kind, vehicle: &str, point: &str, fit: &ObservationFit| ResidualResult {
        frame: problem.frames[frame].number,
        kind,
        vehicle: vehicle.to_owned(),
        point: point.to_owned(),
        du: round(fit.residual_px.x, PIXEL),
        dv: round(fit.residual_px.y, PIXEL),
        weight: round(fit.weight, RATIO),
    };
    let mut rows = Vec::new();
    for (vehicle, fits) in problem.vehicles.iter().zip(&fits.vehicles) {
        for (observation, fit) in vehicle.observations.iter().zip(fits) {
            let point = &vehicle.points[observation.point].id;
            rows.extend(fit.map(|fit| row(observation.frame, "vehicle", &vehicle.id, point, &fit)));
        }
    }
    for (observation, fit) in problem.target_observations.iter().zip(&fits.targets) {
        let target = &problem.targets[observation.target].id;
        rows.extend(fit.map(|fit| row(observation.frame, "target", "", target, &fit)));
    }
    rows
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
