//! What `evaluate` prints for programs.

use super::folder::PROGRAM;
use super::json::SCHEMA;
use crate::clock::ClockOffset;
use crate::clock::curve::GAP_STEPS;
use crate::cloud::DistanceStatistics;
use crate::evaluate::alignment::{Aligned, Alignment};
use crate::evaluate::shape::ShapeComparison;
use crate::evaluate::statistics::{DifferenceStatistics, Distances};
use crate::evaluate::track::{LEAST_SPEED_MPS, SpeedSource, TrackComparison};
use crate::evaluate::{Evaluation, VehicleEvaluation};
use crate::geometry::quaternion_wxyz;
use serde::Serialize;
use std::path::Path;

/// A comparison. Units stand in the names; else metres, seconds, metres a second. Differences are result minus
/// reference. What is not known is `null`.
#[derive(Clone, Debug, Serialize)]
pub struct EvaluationReport {
    /// Version of this form; fields may be added without a new one.
    pub schema: u32,
    /// Always `trackbundle`.
    pub program: &'static str,
    /// Version of the program.
    pub version: &'static str,
    /// The problem folder.
    pub problem: String,
    /// The result folder.
    pub result: String,
    /// What might be changed of the result before: `none`, `rigid` or `similarity`.
    pub alignment: &'static str,
    /// One for each vehicle that was compared.
    pub vehicles: Vec<VehicleReport>,
    /// The others.
    pub not_compared: Vec<NotComparedReport>,
    /// One for each vehicle whose shape was compared with a scan.
    pub shapes: Vec<ShapeReport>,
    /// The others.
    pub shapes_not_compared: Vec<NotComparedReport>,
    /// What is odd.
    pub warnings: Vec<String>,
    /// The files of its folder, where there is one: what another comparison may replace.
    pub files: Vec<String>,
}

/// A vehicle that was not compared.
#[derive(Clone, Debug, Serialize)]
pub struct NotComparedReport {
    /// Its id.
    pub vehicle: String,
    /// The reason.
    pub why: String,
}

/// A vehicle that was compared.
#[derive(Clone, Debug, Serialize)]
pub struct VehicleReport {
    /// Its id.
    pub vehicle: String,
    /// The offset that was applied: `t_reference = t_video + clock_offset_s`.
    pub clock_offset_s: f64,
    /// What the tracks say of it.
    pub clock: ClockReport,
    /// Its track.
    pub track: TrackReport,
}

/// What tracks say of the clocks.
#[derive(Clone, Debug, Default, Serialize)]
pub struct ClockReport {
    /// Whether the offset can be estimated.
    pub observable: bool,
    /// Why not.
    pub why: Option<String>,
    /// The estimate.
    pub offset_s: Option<f64>,
    /// Its standard deviation.
    pub sigma_s: Option<f64>,
    /// Constant shift of x and y that was free beside it.
    pub shift_m: Option<[f64; 2]>,
    /// Frames, and middles between them, that it is from.
    pub samples: usize,
    /// Of these, what counted nothing.
    pub rejected: usize,
    /// How many independent ones they are worth.
    pub independent: Option<f64>,
    /// Robust standard deviation of what is left, per axis.
    pub scale_m: Option<f64>,
    /// Root mean square distance of what is left and counted.
    pub rms_m: Option<f64>,
    /// Whether the applied offset is so far off that it shows.
    pub matters: bool,
}

/// A track against its reference.
#[derive(Clone, Debug, Serialize)]
pub struct TrackReport {
    /// `interpolated` (the reference, at the times of frames) or `nearest`.
    pub association: &'static str,
    /// Frames of the track.
    pub frames: usize,
    /// Positions of the reference.
    pub reference_positions: usize,
    /// Frames that were compared.
    pub compared: usize,
    /// Frames outside the time of the reference (`nearest`: of the sparser track, what has no partner).
    pub outside: usize,
    /// Frames in its gaps.
    pub in_gaps: usize,
    /// The longest step of the reference that is no gap.
    pub longest_step_s: f64,
    /// Such a step in median steps.
    pub gap_steps: f64,
    /// `nearest`: the greatest difference of time that was allowed.
    pub max_gap_s: f64,
    /// What was applied to the result, where something might be.
    pub aligned: Option<AlignedReport>,
    /// Distances in space.
    pub distances: DistancesReport,
    /// Along x.
    pub x: StatisticsReport,
    /// Along y.
    pub y: StatisticsReport,
    /// Along z.
    pub z: StatisticsReport,
    /// Along the reference's motion, where it moves at `least_speed_mps` at least.
    pub along: Option<StatisticsReport>,
    /// To the left of it.
    pub across: Option<StatisticsReport>,
    /// Slower, the reference has no direction.
    pub least_speed_mps: f64,
    /// 90 % of horizontal distances are no larger.
    pub ce90_m: f64,
    /// 90 % of vertical distances are no larger.
    pub le90_m: f64,
    /// Of the horizontal speed.
    pub speed: Option<StatisticsReport>,
    /// Half the width of the histogram of its differences at half its maximum.
    pub speed_half_width_mps: Option<f64>,
    /// Width of a bin of this histogram.
    pub speed_bin_mps: Option<f64>,
    /// Where the speed of the reference is from: `measured`, `differences` or `mixed`.
    pub speed_source: Option<&'static str>,
    /// Median speed of the reference.
    pub median_speed_mps: Option<f64>,
    /// Heading of the result's body less the direction in which the reference moves, in degrees.
    pub heading: Option<StatisticsReport>,
    /// Direction in which the result moves less that of the reference, in degrees.
    pub course: Option<StatisticsReport>,
    /// The course of the result is from its places so long before and after a frame.
    pub course_step_s: f64,
    /// Median standard deviation of the result's heading.
    pub sigma_heading_deg: Option<f64>,
    /// Median standard deviations of the result along x, y, z.
    pub sigma_m: [Option<f64>; 3],
    /// The same of the reference.
    pub reference_sigma_m: [Option<f64>; 3],
    /// Chi-square of x and y per degree of freedom, by the covariances of both.
    pub chi_square_per_freedom: Option<f64>,
    /// Frames that it is from.
    pub chi_square_count: usize,
}

/// An alignment: `reference = scale * rotation * result + translation`.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct AlignedReport {
    /// The scale.
    pub scale: f64,
    /// The angle of the rotation.
    pub rotation_deg: f64,
    /// The rotation, scalar first.
    pub quaternion_wxyz: [f64; 4],
    /// The translation.
    pub translation_m: [f64; 3],
    /// How far the centroid of what was associated was moved.
    pub shift_m: [f64; 3],
    /// Standard deviations of the result's positions along their principal axes.
    pub spread_m: [f64; 3],
}

impl AlignedReport {
    fn of(aligned: &Aligned) -> Option<Self> {
        (aligned.alignment != Alignment::None).then(|| AlignedReport {
            scale: aligned.scale,
            rotation_deg: aligned.angle_rad().to_degrees(),
            quaternion_wxyz: quaternion_wxyz(&aligned.motion),
            translation_m: aligned.motion.translation.vector.into(),
            shift_m: aligned.shift_m.into(),
            spread_m: aligned.spread_m,
        })
    }
}

/// Distances in a few numbers, by the names of `evo`.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct DistancesReport {
    /// How many there are.
    pub count: usize,
    /// Root mean square.
    pub rmse: f64,
    /// Mean.
    pub mean: f64,
    /// Median.
    pub median: f64,
    /// Root mean square deviation from the mean.
    pub std: f64,
    /// The least.
    pub min: f64,
    /// The largest.
    pub max: f64,
    /// Sum of squares.
    pub sse: f64,
}

impl From<Distances> for DistancesReport {
    fn from(found: Distances) -> Self {
        let Distances { count, rmse, mean, median, std, min, max, sse } = found;
        DistancesReport { count, rmse, mean, median, std, min, max, sse }
    }
}

/// Differences in a few numbers.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct StatisticsReport {
    /// How many there are.
    pub count: usize,
    /// Their median.
    pub median: f64,
    /// Median absolute deviation from it.
    pub mad: f64,
    /// 1.4826 times that.
    pub mad_sigma: f64,
    /// Their mean.
    pub mean: f64,
    /// Root mean square.
    pub rms: f64,
    /// 95 % are no larger.
    pub abs_95: f64,
}

impl From<DifferenceStatistics> for StatisticsReport {
    fn from(found: DifferenceStatistics) -> Self {
        let DifferenceStatistics { count, median, mad, mad_sigma, mean, rms, abs_95 } = found;
        StatisticsReport { count, median, mad, mad_sigma, mean, rms, abs_95 }
    }
}

/// A shape against a scan.
#[derive(Clone, Debug, Serialize)]
pub struct ShapeReport {
    /// The vehicle.
    pub vehicle: String,
    /// The file of the scan.
    pub scan: String,
    /// How the points came onto it: `none`, `given` or `icp`.
    pub registration: &'static str,
    /// `scan_from_vehicle`: position, then the quaternion, scalar first.
    pub scan_from_vehicle: [f64; 7],
    /// How far the registration moved the middle of the shape.
    pub moved_m: f64,
    /// How far it turned it.
    pub turned_deg: f64,
    /// Share of the points that belong to the scan, by iterated closest points.
    pub overlap: Option<f64>,
    /// How many directions the clouds do not determine.
    pub undetermined: usize,
    /// Points to the nearest point of the scan.
    pub to_scan: DistanceReport,
    /// The same weighted by the standard deviations of the points.
    pub to_scan_weighted: Option<DistanceReport>,
    /// The same of points with a standard deviation of at most `limit_m`.
    pub to_scan_limited: Option<DistanceReport>,
    /// That limit.
    pub limit_m: f64,
    /// Points to the local plane of the scan.
    pub to_plane: DistanceReport,
    /// Points to the mesh, positive outside.
    pub to_mesh: Option<DistanceReport>,
    /// The scan to the nearest point.
    pub from_scan: DistanceReport,
    /// Point to point against the truth, as they stand.
    pub truth_raw: Option<DistanceReport>,
    /// After a rigid fit.
    pub truth_rigid: Option<DistanceReport>,
    /// After a similarity fit.
    pub truth_similarity: Option<DistanceReport>,
    /// The scale of that.
    pub truth_scale: Option<f64>,
}

/// Distances in a few numbers.
#[derive(Clone, Debug, Serialize)]
pub struct DistanceReport {
    /// How many.
    pub count: usize,
    /// The middle one.
    pub median_m: f64,
    /// Median absolute deviation.
    pub mad_m: f64,
    /// Mean.
    pub mean_m: f64,
    /// Root mean square.
    pub rms_m: f64,
    /// The largest.
    pub max_m: f64,
    /// 50, 68, 90 and 95 % are no larger.
    pub percentiles_m: [f64; 4],
    /// Shares within 1, 2, 5 and 10 cm.
    pub within: [f64; 4],
}

fn distance_report(found: &DistanceStatistics) -> DistanceReport {
    let DistanceStatistics { count, median_m, mad_m, mean_m, rms_m, max_m, percentiles_m, within } = *found;
    DistanceReport { count, median_m, mad_m, mean_m, rms_m, max_m, percentiles_m, within }
}

fn shape_report(found: &ShapeComparison) -> ShapeReport {
    let registered = &found.registered;
    let [x, y, z]: [f64; 3] = registered.scan_from_vehicle.translation.vector.into();
    let [qw, qx, qy, qz] = quaternion_wxyz(&registered.scan_from_vehicle);
    let truth = found.truth.as_ref();
    ShapeReport {
        vehicle: found.vehicle.clone(),
        scan: found.file.clone(),
        registration: registered.how.name(),
        scan_from_vehicle: [x, y, z, qw, qx, qy, qz],
        moved_m: registered.moved_m,
        turned_deg: registered.turned_rad.to_degrees(),
        overlap: registered.overlap.map(|(share, _)| share),
        undetermined: registered.undetermined,
        to_scan: distance_report(&found.to_scan),
        to_scan_weighted: found.weighted.as_ref().map(distance_report),
        to_scan_limited: found.limited.as_ref().map(distance_report),
        limit_m: found.limit_m,
        to_plane: distance_report(&found.to_plane),
        to_mesh: found.to_mesh.as_ref().map(distance_report),
        from_scan: distance_report(&found.from_scan),
        truth_raw: truth.map(|t| distance_report(&t.raw)),
        truth_rigid: truth.and_then(|t| t.rigid.as_ref()).map(distance_report),
        truth_similarity: truth.and_then(|t| t.similarity.as_ref()).map(distance_report),
        truth_scale: truth.and_then(|t| t.scale),
    }
}

/// The report of a comparison.
pub fn evaluation_report(
    problem: &Path,
    result: &Path,
    evaluation: &Evaluation,
    warnings: Vec<String>,
) -> EvaluationReport {
    let missing = |all: &[(String, String)]| {
        all.iter()
            .map(|(vehicle, why)| NotComparedReport { vehicle: vehicle.clone(), why: why.clone() })
            .collect()
    };
    EvaluationReport {
        schema: SCHEMA,
        program: PROGRAM,
        version: env!("CARGO_PKG_VERSION"),
        problem: problem.display().to_string(),
        result: result.display().to_string(),
        alignment: evaluation.alignment.name(),
        vehicles: evaluation.vehicles.iter().map(vehicle_report).collect(),
        not_compared: missing(&evaluation.not_compared),
        shapes: evaluation.shapes.iter().map(shape_report).collect(),
        shapes_not_compared: missing(&evaluation.shapes_not_compared),
        warnings,
        files: Vec::new(),
    }
}

fn vehicle_report(found: &VehicleEvaluation) -> VehicleReport {
    VehicleReport {
        vehicle: found.vehicle.clone(),
        clock_offset_s: found.track.clock_offset_s,
        clock: ClockReport { matters: found.clock_matters().is_some(), ..clock_report(&found.clock) },
        track: track_report(&found.track),
    }
}

fn clock_report(clock: &ClockOffset) -> ClockReport {
    match clock {
        ClockOffset::NotObservable { why } => ClockReport { why: Some(why.clone()), ..Default::default() },
        ClockOffset::Estimated(found) => ClockReport {
            observable: true,
            why: None,
            offset_s: Some(found.offset_s),
            sigma_s: Some(found.sigma_s),
            shift_m: Some(found.shift_m),
            samples: found.samples,
            rejected: found.rejected,
            independent: Some(found.independent),
            scale_m: Some(found.scale_m),
            rms_m: Some(found.rms_m),
            matters: false,
        },
    }
}

fn track_report(found: &TrackComparison) -> TrackReport {
    let [x, y, z] = found.axes_m.map(StatisticsReport::from);
    let turned = |at: usize| found.along_across_m.map(|both| both[at].into());
    TrackReport {
        association: found.association.name(),
        frames: found.positions[0],
        reference_positions: found.positions[1],
        compared: found.compared.len(),
        outside: found.outside,
        in_gaps: found.in_gaps,
        longest_step_s: found.longest_step_s,
        gap_steps: GAP_STEPS,
        max_gap_s: found.max_gap_s,
        aligned: AlignedReport::of(&found.aligned),
        distances: found.distances_m.into(),
        x,
        y,
        z,
        along: turned(0),
        across: turned(1),
        least_speed_mps: LEAST_SPEED_MPS,
        ce90_m: found.circular_linear_90_m[0],
        le90_m: found.circular_linear_90_m[1],
        speed: found.speed_mps.map(StatisticsReport::from),
        speed_half_width_mps: found.speed_half_width_mps.map(|width| width.half_width),
        speed_bin_mps: found.speed_half_width_mps.map(|width| width.bin),
        speed_source: found.speed_source.map(|source| match source {
            SpeedSource::Measured => "measured",
            SpeedSource::Differences => "differences",
            SpeedSource::Mixed => "mixed",
        }),
        median_speed_mps: found.median_speed_mps,
        heading: found.heading_deg.map(StatisticsReport::from),
        course: found.course_deg.map(StatisticsReport::from),
        course_step_s: found.course_step_s,
        sigma_heading_deg: found.sigma_heading_deg,
        sigma_m: found.sigma_m,
        reference_sigma_m: found.reference_sigma_m,
        chi_square_per_freedom: found.chi_square.map(|(value, _)| value),
        chi_square_count: found.chi_square.map_or(0, |(_, count)| count),
    }
}

impl EvaluationReport {
    /// Its text.
    pub fn to_json(&self) -> String {
        let mut text = serde_json::to_string_pretty(self).expect("plain data");
        text.push('\n');
        text
    }
}
