//! The rows of the tables of results. A field is named as its column.
//!
//! Units: metres, seconds, pixels; degrees where a name ends in `_deg`. Poses are `world_from_body`,
//! quaternions scalar first. `docs/formats.md` says the rest.

use crate::tables::{Column, Kind, ResultSigma, Row, input_row};
use serde::Serialize;

/// The columns of a result table.
pub trait ResultRow: Serialize {
    /// Their names.
    const HEADER: &'static [&'static str];
    /// Which of them hold texts.
    const TEXTS: &'static [bool];
}

/// Which columns hold texts.
const fn texts<const N: usize>(columns: &[Column]) -> [bool; N] {
    let mut texts = [false; N];
    let mut at = 0;
    while at < N {
        texts[at] = matches!(columns[at].kind, Kind::Text | Kind::TextOrEmpty);
        at += 1;
    }
    texts
}

/// The names of columns.
const fn names<const N: usize>(columns: &[Column]) -> [&'static str; N] {
    let mut names = [""; N];
    let mut at = 0;
    while at < N {
        names[at] = columns[at].name;
        at += 1;
    }
    names
}

/// Makes a row that a result table is read by that which it is written with.
macro_rules! written_as_read {
    ($name:ident) => {
        impl ResultRow for $name {
            const HEADER: &'static [&'static str] = &names::<{ $name::COLUMNS.len() }>($name::COLUMNS);
            const TEXTS: &'static [bool] = &texts::<{ $name::COLUMNS.len() }>($name::COLUMNS);
        }
    };
}

input_row!(
    /// `trajectories.csv` read back; what else than places is told may be missing.
    TrajectoryRow {
        required vehicle: String, required frame: i64, required time_s: f64,
        required x: f64, required y: f64, required z: f64,
        optional speed_mps: Option<f64>, optional heading_deg: Option<f64>,
        optional sigma_x: ResultSigma, optional sigma_y: ResultSigma, optional sigma_z: ResultSigma,
        optional cov_xy: Option<f64>,
        optional sigma_speed_mps: ResultSigma, optional sigma_heading_deg: ResultSigma,
    }
);

input_row!(
    /// `vehicle_points.csv` of a result read back.
    VehiclePointResultRow {
        required vehicle: String, required point: String,
        required x: Option<f64>, required y: Option<f64>, required z: Option<f64>,
        optional sigma_x: ResultSigma, optional sigma_y: ResultSigma, optional sigma_z: ResultSigma,
        optional observations: Option<f64>, optional inliers: Option<f64>, optional rms_px: Option<f64>,
    }
);

input_row!(
    /// `camera_poses.csv` of a result read back.
    CameraPoseResultRow {
        required frame: i64,
        required x: f64, required y: f64, required z: f64,
        required qw: f64, required qx: f64, required qy: f64, required qz: f64,
        optional sigma_x: ResultSigma, optional sigma_y: ResultSigma, optional sigma_z: ResultSigma,
        optional sigma_roll_deg: ResultSigma, optional sigma_pitch_deg: ResultSigma,
        optional sigma_yaw_deg: ResultSigma,
    }
);

input_row!(
    /// `vehicle_poses.csv` of a result read back.
    VehiclePoseResultRow {
        required frame: i64, required vehicle: String,
        required x: f64, required y: f64, required z: f64,
        required qw: f64, required qx: f64, required qy: f64, required qz: f64,
        optional sigma_x: ResultSigma, optional sigma_y: ResultSigma, optional sigma_z: ResultSigma,
        optional sigma_roll_deg: ResultSigma, optional sigma_pitch_deg: ResultSigma,
        optional sigma_yaw_deg: ResultSigma,
    }
);

input_row!(
    /// `residuals.csv`: observed minus computed; weight 1 counts in full, 0 not at all; why it was rejected, if it
    /// was. What older versions did not write may be missing.
    #[derive(Serialize)]
    ResidualRow {
        required frame: i64, required kind: String, required vehicle: Option<String>, required point: String,
        required du: f64, required dv: f64, required weight: f64,
        optional reason: Option<String>, optional u_computed: Option<f64>, optional v_computed: Option<f64>,
    }
);
written_as_read!(ResidualRow);

input_row!(
    /// `targets.csv` of a result: where each target is, and its survey minus that. A statistic is empty where there
    /// is none.
    #[derive(Serialize)]
    TargetResultRow {
        required target: String, required role: String,
        required x: Option<f64>, required y: Option<f64>, required z: Option<f64>,
        required sigma_x: ResultSigma, required sigma_y: ResultSigma, required sigma_z: ResultSigma,
        required dx: Option<f64>, required dy: Option<f64>, required dz: Option<f64>,
        required w_x: Option<f64>, required w_y: Option<f64>, required w_z: Option<f64>,
        required used: i64, required rejected: i64,
    }
);
written_as_read!(TargetResultRow);

/// Declares a struct for the rows of a result table.
macro_rules! result_row {
    ($(#[$doc:meta])* $name:ident { $($column:ident: $type:ty),* $(,)? }) => {
        $(#[$doc])*
        #[derive(Clone, Debug, PartialEq, Serialize)]
        pub struct $name {
            $(
                #[doc = concat!("Column `", stringify!($column), "`.")]
                pub $column: $type,
            )*
        }

        impl ResultRow for $name {
            const HEADER: &'static [&'static str] = &[$(stringify!($column)),*];
            const TEXTS: &'static [bool] = &[$(matches!(stringify!($type).as_bytes(), b"String")),*];
        }
    };
}

result_row!(
    /// `camera_poses.csv`. A sigma is empty where it was not computed.
    CameraPoseResult {
        frame: i64,
        x: f64, y: f64, z: f64, qw: f64, qx: f64, qy: f64, qz: f64,
        sigma_x: Option<f64>, sigma_y: Option<f64>, sigma_z: Option<f64>,
        sigma_roll_deg: Option<f64>, sigma_pitch_deg: Option<f64>, sigma_yaw_deg: Option<f64>,
    }
);

result_row!(
    /// `vehicle_poses.csv`.
    VehiclePoseResult {
        frame: i64, vehicle: String,
        x: f64, y: f64, z: f64, qw: f64, qx: f64, qy: f64, qz: f64,
        sigma_x: Option<f64>, sigma_y: Option<f64>, sigma_z: Option<f64>,
        sigma_roll_deg: Option<f64>, sigma_pitch_deg: Option<f64>, sigma_yaw_deg: Option<f64>,
    }
);

result_row!(
    /// `vehicle_points.csv`. A point that is not determined has no coordinates.
    VehiclePointResult {
        vehicle: String, point: String,
        x: Option<f64>, y: Option<f64>, z: Option<f64>,
        sigma_x: Option<f64>, sigma_y: Option<f64>, sigma_z: Option<f64>,
        observations: usize, inliers: usize, rms_px: Option<f64>,
    }
);

result_row!(
    /// `trajectories.csv`.
    TrajectoryResult {
        vehicle: String, frame: i64, time_s: f64,
        x: f64, y: f64, z: f64, speed_mps: Option<f64>, heading_deg: f64,
        sigma_x: Option<f64>, sigma_y: Option<f64>, sigma_z: Option<f64>, cov_xy: Option<f64>,
        sigma_speed_mps: Option<f64>, sigma_heading_deg: Option<f64>,
    }
);

result_row!(
    /// `states.csv`: the marker, or the origin, at any time. The acceleration is that of the mean path.
    StateResult {
        vehicle: String, time_s: f64,
        x: f64, y: f64, z: f64, vx: f64, vy: f64, vz: f64, ax: f64, ay: f64, az: f64,
        speed_mps: f64, heading_deg: f64, yaw_rate_degps: f64,
        sigma_x: Option<f64>, sigma_y: Option<f64>, sigma_z: Option<f64>,
        sigma_vx: Option<f64>, sigma_vy: Option<f64>, sigma_vz: Option<f64>,
        sigma_speed_mps: Option<f64>, sigma_heading_deg: Option<f64>, sigma_yaw_rate_degps: Option<f64>,
    }
);

result_row!(
    /// `track_differences.csv` of an evaluation: result minus reference, a row for each frame that is compared.
    /// Times are those of the film and of the reference's clock.
    TrackDifferenceResult {
        vehicle: String, frame: i64, time_s: f64, reference_time_s: f64,
        x: f64, y: f64, z: f64, reference_x: f64, reference_y: f64, reference_z: f64,
        dx_m: f64, dy_m: f64, dz_m: f64, distance_m: f64, along_m: Option<f64>, across_m: Option<f64>,
        speed_mps: Option<f64>, reference_speed_mps: Option<f64>, dspeed_mps: Option<f64>,
        heading_deg: Option<f64>, heading_difference_deg: Option<f64>, course_difference_deg: Option<f64>,
        sigma_x: Option<f64>, sigma_y: Option<f64>, sigma_z: Option<f64>,
        sigma_speed_mps: Option<f64>, sigma_heading_deg: Option<f64>,
        reference_sigma_x: Option<f64>, reference_sigma_y: Option<f64>, reference_sigma_z: Option<f64>,
        chi_square: Option<f64>,
    }
);

result_row!(
    /// `shape_distances.csv` of an evaluation: a point in the vehicle frame and in that of the scan, and how far
    /// it is from the scan and from the truth.
    ShapeDistanceResult {
        vehicle: String, point: String,
        x: f64, y: f64, z: f64, sigma_x: Option<f64>, sigma_y: Option<f64>, sigma_z: Option<f64>,
        scan_x: f64, scan_y: f64, scan_z: f64, to_scan_m: f64, to_plane_m: f64, to_mesh_m: Option<f64>,
        truth_raw_m: Option<f64>, truth_rigid_m: Option<f64>, truth_similarity_m: Option<f64>,
    }
);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_are_read_by_the_columns_that_they_are_written_with() {
        let read: Vec<&str> = TrajectoryRow::COLUMNS.iter().map(|column| column.name).collect();
        assert_eq!(read, TrajectoryResult::HEADER);
        let read: Vec<&str> = VehiclePointResultRow::COLUMNS.iter().map(|column| column.name).collect();
        assert_eq!(read, VehiclePointResult::HEADER);
        let read: Vec<&str> = CameraPoseResultRow::COLUMNS.iter().map(|column| column.name).collect();
        assert_eq!(read, CameraPoseResult::HEADER);
        let read: Vec<&str> = VehiclePoseResultRow::COLUMNS.iter().map(|column| column.name).collect();
        assert_eq!(read, VehiclePoseResult::HEADER);
        let read: Vec<&str> = ResidualRow::COLUMNS.iter().map(|column| column.name).collect();
        assert_eq!(read, ResidualRow::HEADER);
    }
}
