//! `report.json`: what was solved and how well, for programs.

use super::folder::PROGRAM;
use crate::initialise::Initial;
use crate::nlls::linear::ordering::Rule;
use crate::nlls::loss::Loss;
use crate::problem::Problem;
use crate::refine::{Adjustment, Body};
use serde::Serialize;
use std::collections::BTreeMap;

/// The report. Units stand in the names; else metres, seconds, degrees.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Always `trackbundle`: by this a folder is known as a result.
    pub program: &'static str,
    /// Version of the program.
    pub version: &'static str,
    /// Name of the problem.
    pub problem: String,
    /// `converged`, `iteration_limit`, `stalled` or `initialised`.
    pub status: &'static str,
    /// Why the last round stopped, with the measured value.
    pub stop: String,
    /// Iterations of all rounds.
    pub iterations: usize,
    /// Half the sum of rho at the start, under the last round's losses.
    pub initial_cost: Option<f64>,
    /// Half the sum of rho at the end.
    pub final_cost: Option<f64>,
    /// Rows that took part: two for each image point that is not rejected, and those of everything else.
    pub observations: usize,
    /// Numbers that were adjusted.
    pub parameters: usize,
    /// Rows minus parameters.
    pub redundancy: i64,
    /// Standard deviation of unit weight a posteriori (a priori 1).
    pub sigma0: Option<f64>,
    /// Root mean square of the coordinates of all image points that are not gross errors.
    pub rms_px: Option<f64>,
    /// The same of vehicles alone.
    pub rms_vehicle_px: Option<f64>,
    /// The same of targets alone.
    pub rms_target_px: Option<f64>,
    /// Gross errors among the image points.
    pub outliers: usize,
    /// Image points whose computed place is behind the camera.
    pub behind_camera: usize,
    /// Image points of points without coordinates.
    pub not_used: usize,
    /// The loss of image points.
    pub loss: Option<LossReport>,
    /// The motion priors.
    pub motion: Vec<MotionReport>,
    /// The check points.
    pub check_points: Vec<CheckPointReport>,
    /// How the normal equations were eliminated.
    pub elimination: Option<EliminationReport>,
    /// The minimisations.
    pub rounds: Vec<RoundReport>,
    /// Vehicles that were left out.
    pub left_out: Vec<String>,
    /// Wall time of each stage.
    pub seconds: BTreeMap<&'static str, f64>,
    /// What is odd.
    pub warnings: Vec<String>,
}

/// The loss of image points.
#[derive(Clone, Debug, Serialize)]
pub struct LossReport {
    /// Its name.
    pub name: &'static str,
    /// Its scale in standard deviations of an image point.
    pub scale_sigmas: Option<f64>,
    /// Barron's alpha.
    pub shape: Option<f64>,
}

/// The motion prior of a body: scatter of its mean acceleration over one second.
#[derive(Clone, Debug, Serialize)]
pub struct MotionReport {
    /// `camera`, or `vehicle` and its id.
    pub body: String,
    /// Of the position, per axis.
    pub acceleration_mps2: f64,
    /// Of the attitude, per axis.
    pub angular_acceleration_degps2: f64,
    /// Whether it was estimated from the data.
    pub estimated: bool,
}

/// A check point: intersected from the adjusted cameras minus surveyed.
#[derive(Clone, Debug, Serialize)]
pub struct CheckPointReport {
    /// Id of the target.
    pub target: String,
    /// Difference along x, `null` where its rays do not meet.
    pub dx: Option<f64>,
    /// Along y.
    pub dy: Option<f64>,
    /// Along z.
    pub dz: Option<f64>,
}

/// How the normal equations were eliminated.
#[derive(Clone, Debug, Serialize)]
pub struct EliminationReport {
    /// The order.
    pub order: &'static str,
    /// Multiplications and additions of one factorisation.
    pub operations: f64,
}

/// One minimisation.
#[derive(Clone, Debug, Serialize)]
pub struct RoundReport {
    /// Its name.
    pub name: &'static str,
    /// Iterations of all rounds.
    pub iterations: usize,
    /// Half the sum of rho at the start, under the last round's losses.
    pub initial_cost: f64,
    /// Half the sum of rho at the end.
    pub final_cost: f64,
    /// Why the last round stopped, with the measured value.
    pub stop: String,
}

/// The report of an adjustment. Stages and their seconds, and warnings from before, are added.
pub fn report_of_adjustment(problem: &Problem, adjustment: &Adjustment, left_out: Vec<String>) -> Report {
    let [rms_vehicle_px, rms_target_px, rms_px] = adjustment.rms_px;
    Report {
        status: adjustment.stop.status(),
        stop: adjustment.stop.to_string(),
        iterations: adjustment.iterations(),
        initial_cost: Some(adjustment.initial_cost),
        final_cost: Some(adjustment.final_cost),
        observations: adjustment.observations,
        parameters: adjustment.parameters,
        redundancy: adjustment.redundancy,
        sigma0: adjustment.sigma0,
        rms_px,
        rms_vehicle_px,
        rms_target_px,
        outliers: adjustment.fits.outliers,
        behind_camera: adjustment.fits.behind_camera,
        not_used: adjustment.fits.not_used,
        loss: Some(loss_report(&adjustment.image_loss)),
        motion: adjustment
            .motion
            .iter()
            .map(|m| MotionReport {
                body: match &m.body {
                    Body::Camera => "camera".to_owned(),
                    Body::Vehicle(id) => format!("vehicle {id}"),
                },
                acceleration_mps2: m.strength.acceleration_mps2,
                angular_acceleration_degps2: m.strength.angular_acceleration_rps2.to_degrees(),
                estimated: m.is_estimated,
            })
            .collect(),
        check_points: adjustment
            .check_points
            .iter()
            .map(|check| CheckPointReport {
                target: check.id.clone(),
                dx: check.difference_m.map(|d| d.x),
                dy: check.difference_m.map(|d| d.y),
                dz: check.difference_m.map(|d| d.z),
            })
            .collect(),
        elimination: Some(EliminationReport {
            order: match adjustment.elimination.0 {
                Rule::FramesFirst => "frames by what image points see of them, then shape and rest",
                Rule::BodiesApart => "each vehicle with its shape, then cameras and the rest",
                Rule::AsDeclared => "frames along time, then shape and targets",
                Rule::MinimumDegree => "approximate minimum degree",
            },
            operations: adjustment.elimination.1,
        }),
        rounds: adjustment
            .rounds
            .iter()
            .map(|round| RoundReport {
                name: round.name,
                iterations: round.records.len() - 1,
                initial_cost: round.records[0].cost,
                final_cost: round.records[round.records.len() - 1].cost,
                stop: round.stop.to_string(),
            })
            .collect(),
        warnings: adjustment.warnings.clone(),
        ..empty(problem, left_out)
    }
}

/// The report of a first estimate.
pub fn report_of_initial(problem: &Problem, initial: &Initial, left_out: Vec<String>) -> Report {
    Report { warnings: initial.warnings.clone(), ..empty(problem, left_out) }
}

fn empty(problem: &Problem, left_out: Vec<String>) -> Report {
    Report {
        program: PROGRAM,
        version: env!("CARGO_PKG_VERSION"),
        problem: problem.name.clone(),
        status: "initialised",
        stop: "not adjusted".to_owned(),
        iterations: 0,
        initial_cost: None,
        final_cost: None,
        observations: 0,
        parameters: 0,
        redundancy: 0,
        sigma0: None,
        rms_px: None,
        rms_vehicle_px: None,
        rms_target_px: None,
        outliers: 0,
        behind_camera: 0,
        not_used: 0,
        loss: None,
        motion: Vec::new(),
        check_points: Vec::new(),
        elimination: None,
        rounds: Vec::new(),
        left_out,
        seconds: BTreeMap::new(),
        warnings: Vec::new(),
    }
}

fn loss_report(loss: &Loss) -> LossReport {
    let (name, scale, shape) = match *loss {
        Loss::Squared => ("none", None, None),
        Loss::Huber { scale } => ("huber", Some(scale), None),
        Loss::Cauchy { scale } => ("cauchy", Some(scale), None),
        Loss::Tukey { scale } => ("tukey", Some(scale), None),
        Loss::GemanMcClure { scale } => ("geman-mcclure", Some(scale), None),
        Loss::Barron { shape, scale } => ("barron", Some(scale), Some(shape)),
    };
    LossReport { name, scale_sigmas: scale, shape }
}

impl Report {
    /// Its text, as it stands in the folder.
    pub fn to_json(&self) -> String {
        let mut text = serde_json::to_string_pretty(self).expect("plain data");
        text.push('\n');
        text
    }
}
