//! What was compared as tables, one row for each frame and for each point. Numbers read back the same.

use super::super::File;
use super::super::tables::table;
use crate::evaluate::VehicleEvaluation;
use crate::evaluate::shape::{ComparedPoint, ShapeComparison};
use crate::evaluate::track::Compared;
use crate::files::rows::{ShapeDistanceResult, TrackDifferenceResult};

/// `track_differences.csv`.
pub fn track_differences(vehicles: &[VehicleEvaluation]) -> File {
    let of_vehicle = |found: &VehicleEvaluation| {
        let row = |at: &Compared| track_row(&found.vehicle, at);
        found.track.compared.iter().map(row).collect::<Vec<_>>()
    };
    table("track_differences.csv", vehicles.iter().flat_map(of_vehicle).collect())
}

fn track_row(vehicle: &str, at: &Compared) -> TrackDifferenceResult {
    let [sigma_x, sigma_y, sigma_z] = at.sigma_m;
    let [reference_sigma_x, reference_sigma_y, reference_sigma_z] = at.reference_sigma_m;
    TrackDifferenceResult {
        vehicle: vehicle.to_owned(),
        frame: at.frame,
        time_s: at.time_s,
        reference_time_s: at.reference_time_s,
        x: at.position.x,
        y: at.position.y,
        z: at.position.z,
        reference_x: at.reference.x,
        reference_y: at.reference.y,
        reference_z: at.reference.z,
        dx_m: at.difference_m.x,
        dy_m: at.difference_m.y,
        dz_m: at.difference_m.z,
        distance_m: at.difference_m.norm(),
        along_m: at.along_across_m.map(|turned| turned.x),
        across_m: at.along_across_m.map(|turned| turned.y),
        speed_mps: at.speed_mps,
        reference_speed_mps: at.reference_speed_mps,
        dspeed_mps: at.speed_difference_mps,
        heading_deg: at.heading_deg,
        heading_difference_deg: at.heading_difference_deg,
        course_difference_deg: at.course_difference_deg,
        sigma_x,
        sigma_y,
        sigma_z,
        sigma_speed_mps: at.sigma_speed_mps,
        sigma_heading_deg: at.sigma_heading_deg,
        reference_sigma_x,
        reference_sigma_y,
        reference_sigma_z,
        chi_square: at.chi_square,
    }
}

/// `shape_distances.csv`.
pub fn shape_distances(shapes: &[ShapeComparison]) -> File {
    let of_shape = |found: &ShapeComparison| {
        found.points.iter().map(|point| shape_row(&found.vehicle, point)).collect::<Vec<_>>()
    };
    table("shape_distances.csv", shapes.iter().flat_map(of_shape).collect())
}

fn shape_row(vehicle: &str, point: &ComparedPoint) -> ShapeDistanceResult {
    let [sigma_x, sigma_y, sigma_z] = point.axis_sigmas_m;
    let [truth_raw_m, truth_rigid_m, truth_similarity_m] = point.truth_m;
    ShapeDistanceResult {
        vehicle: vehicle.to_owned(),
        point: point.point.clone(),
        x: point.position.x,
        y: point.position.y,
        z: point.position.z,
        sigma_x,
        sigma_y,
        sigma_z,
        scan_x: point.in_scan.x,
        scan_y: point.in_scan.y,
        scan_z: point.in_scan.z,
        to_scan_m: point.nearest_m,
        to_plane_m: point.plane_m,
        to_mesh_m: point.mesh_m,
        truth_raw_m,
        truth_rigid_m,
        truth_similarity_m,
    }
}
