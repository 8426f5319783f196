//! `report.json`: what was solved and how well, for programs.

use super::diagnosis::{
    DirectedTestReport, ObservabilityReport, ParameterReport, ScaleReport, StandstillReport,
    StatisticsReport, VerdictReport, directed_test_reports, observability_report, parameter_reports,
    scale_reports, standstill_reports, statistics_report, verdict_report,
};
use super::folder::PROGRAM;
use crate::diagnose::observability::Observability;
use crate::diagnose::{Diagnosis, Verdict};
use crate::files::InputFile;
use crate::initialise::resection::Status;
use crate::initialise::{Initial, Resection};
use crate::problem::Problem;
use crate::refine::{Adjustment, Body, BodyStrength, Order, RejectionReason, Tally};
use serde::Serialize;
use std::collections::BTreeMap;
use trackbundle_solver::Elimination;
use trackbundle_solver::loss::Loss;

/// Version of the form of the report.
pub const SCHEMA: u32 = 1;

/// A file that was read.
#[derive(Clone, Debug, Serialize)]
pub struct InputReport {
    /// Its name within the problem folder.
    pub file: String,
    /// Its length.
    pub bytes: u64,
    /// SHA-256 of its bytes.
    pub sha256: String,
}

/// The report. Units stand in the names; else metres, seconds, degrees.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Version of this form; fields may be added without a new one.
    pub schema: u32,
    /// Always `trackbundle`: by this a folder is known as a result.
    pub program: &'static str,
    /// Version of the program.
    pub version: &'static str,
    /// Name of the problem.
    pub problem: String,
    /// The command, with what it was told of options that change numbers; `PROBLEM` is the problem folder.
    pub command: String,
    /// The files that it read.
    pub inputs: Vec<InputReport>,
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
    /// What became of all image points.
    pub image_points: Option<ImagePointsReport>,
    /// Image points whose computed place is behind the camera.
    pub behind_camera: usize,
    /// Image points of points without coordinates.
    pub not_used: usize,
    /// How cameras without a given pose were found; `null` where all were given.
    pub resection: Option<ResectionReport>,
    /// The final least squares on accepted image points.
    pub least_squares: Option<LeastSquaresReport>,
    /// Whether vehicles were judged one by one, so that standard deviations are upper bounds.
    pub sigmas_are_upper_bounds: bool,
    /// What measurements and knowledge leave open, by name.
    pub observability: Option<ObservabilityReport>,
    /// Whether the result can be trusted.
    pub verdict: Option<VerdictReport>,
    /// Statistics of that.
    pub statistics: Option<StatisticsReport>,
    /// What determined the scale of each vehicle.
    pub scales: Vec<ScaleReport>,
    /// What is adjusted beside poses and points.
    pub estimated: Vec<ParameterReport>,
    /// When vehicles stand.
    pub standstill: Vec<StandstillReport>,
    /// Tests of single numbers that are held.
    pub directed_tests: Vec<DirectedTestReport>,
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

/// What became of the image points. `given` is the sum of all others.
#[derive(Clone, Debug, Serialize)]
pub struct ImagePointsReport {
    /// All of the problem.
    pub given: usize,
    /// That took part.
    pub used: usize,
    /// That took part with less than half of their weight.
    pub down_weighted: usize,
    /// That were rejected, by reason.
    pub rejected: BTreeMap<&'static str, usize>,
}

/// How camera poses were found before the adjustment. Medians are over the frames that were resected;
/// sigmas are those along and about the worst axis.
#[derive(Clone, Debug, Serialize)]
pub struct ResectionReport {
    /// Frames whose pose was given.
    pub given: usize,
    /// Frames that were resected.
    pub resected: usize,
    /// Frames that were bridged.
    pub bridged: usize,
    /// Gross errors among the image points of control targets in resected frames.
    pub gross_errors: usize,
    /// By what image points of targets scatter more than their sigmas say, at least 1.
    pub spread: f64,
    /// Median number of control targets that took part.
    pub median_targets_used: f64,
    /// Median root mean square of the coordinates of residuals.
    pub median_rms_px: f64,
    /// Median standard deviation of a position.
    pub median_sigma_position_m: f64,
    /// Median standard deviation of an attitude.
    pub median_sigma_attitude_deg: f64,
    /// One for each frame without a given pose.
    pub frames: Vec<FrameResectionReport>,
}

/// How the camera pose of a frame was found.
#[derive(Clone, Debug, Serialize)]
pub struct FrameResectionReport {
    /// Number of the frame.
    pub frame: i64,
    /// `resected` or `bridged`.
    pub status: &'static str,
    /// Why it was bridged.
    pub reason: Option<&'static str>,
    /// Control targets in view.
    pub targets_seen: usize,
    /// Of these, what took part.
    pub targets_used: usize,
    /// Of these, gross errors.
    pub gross_errors: usize,
    /// Root mean square of the coordinates of residuals.
    pub rms_px: Option<f64>,
    /// Standard deviation of the position.
    pub sigma_position_m: f64,
    /// Standard deviation of the attitude.
    pub sigma_attitude_deg: f64,
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
    /// What is white noise: `acceleration` or `jerk`.
    pub white_noise: &'static str,
    /// Acceleration of the position, per axis.
    pub acceleration_mps2: Option<f64>,
    /// Of the attitude, per axis.
    pub angular_acceleration_degps2: Option<f64>,
    /// Jerk of the position, per axis.
    pub jerk_mps3: Option<f64>,
    /// Of the attitude, per axis.
    pub angular_jerk_degps3: Option<f64>,
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
    /// Standard deviation of the difference along x: of cameras, image points and survey.
    pub sigma_dx: Option<f64>,
    /// Along y.
    pub sigma_dy: Option<f64>,
    /// Along z.
    pub sigma_dz: Option<f64>,
    /// Chi-square of the difference, of three degrees of freedom.
    pub chi_square: Option<f64>,
    /// Probability of a larger one.
    pub probability: Option<f64>,
}

/// What the final least squares did.
#[derive(Clone, Debug, Serialize)]
pub struct LeastSquaresReport {
    /// By what standard deviations of image points of vehicles were multiplied: 1 where they proved right.
    pub sigma_factor_vehicles: f64,
    /// The same of targets.
    pub sigma_factor_targets: f64,
    /// How far shape points in the world moved from the robust solution, root mean square.
    pub moved_rms_m: f64,
    /// The farthest.
    pub moved_largest_m: f64,
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

impl MotionReport {
    /// The power of the second in the unit of the strength, and the strength of position and attitude.
    pub fn strength(&self) -> (u32, f64, f64) {
        match (self.acceleration_mps2, self.angular_acceleration_degps2) {
            (Some(linear), Some(angular)) => (2, linear, angular),
            _ => (3, self.jerk_mps3.unwrap_or(0.0), self.angular_jerk_degps3.unwrap_or(0.0)),
        }
    }
}

fn of_order(order: Order, found: &BodyStrength, strength: f64) -> Option<f64> {
    (found.order == order).then_some(strength)
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
        image_points: Some(image_points(&adjustment.fits.tally)),
        behind_camera: adjustment.fits.behind_camera,
        not_used: adjustment.fits.not_used,
        least_squares: adjustment.least_squares.map(|found| LeastSquaresReport {
            sigma_factor_vehicles: found.image_factors[0],
            sigma_factor_targets: found.image_factors[1],
            moved_rms_m: found.moved_m[0],
            moved_largest_m: found.moved_m[1],
        }),
        loss: Some(loss_report(&adjustment.image_loss)),
        motion: adjustment
            .motion
            .iter()
            .map(|m| MotionReport {
                body: match &m.body {
                    Body::Camera => "camera".to_owned(),
                    Body::Vehicle(id) => format!("vehicle {id}"),
                },
                white_noise: match m.order {
                    Order::Acceleration => "acceleration",
                    Order::Jerk => "jerk",
                },
                acceleration_mps2: of_order(Order::Acceleration, m, m.strength.linear),
                angular_acceleration_degps2: of_order(
                    Order::Acceleration,
                    m,
                    m.strength.angular.to_degrees(),
                ),
                jerk_mps3: of_order(Order::Jerk, m, m.strength.linear),
                angular_jerk_degps3: of_order(Order::Jerk, m, m.strength.angular.to_degrees()),
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
                sigma_dx: None,
                sigma_dy: None,
                sigma_dz: None,
                chi_square: None,
                probability: None,
            })
            .collect(),
        elimination: Some(EliminationReport {
            order: match adjustment.elimination.0 {
                Elimination::JointBodies => "frames by what image points see of them, then shape and rest",
                Elimination::SeparateBodies => "each vehicle with its shape, then cameras and the rest",
                Elimination::AsDeclared => "frames along time, then shape and targets",
                Elimination::MinimumDegree => "approximate minimum degree",
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
        directed_tests: directed_test_reports(&adjustment.directed_tests),
        warnings: adjustment.warnings.clone(),
        ..empty(problem, left_out)
    }
}

/// The report of a first estimate.
pub fn report_of_initial(problem: &Problem, initial: &Initial, left_out: Vec<String>) -> Report {
    let resection = resection_report(problem, initial.resection.as_ref());
    Report { warnings: initial.warnings.clone(), resection, ..empty(problem, left_out) }
}

/// How camera poses were found.
pub fn resection_report(problem: &Problem, resection: Option<&Resection>) -> Option<ResectionReport> {
    let resection = resection?;
    let quality = resection.quality();
    let frame = |(frame, found): (&crate::problem::Frame, &crate::initialise::resection::FrameResection)| {
        let (status, reason) = match found.status {
            Status::Given => return None,
            Status::Resected => ("resected", None),
            Status::Bridged(reason) => ("bridged", Some(reason.name())),
        };
        let [sigma_position_m, sigma_attitude_rad] = found.largest_sigmas();
        Some(FrameResectionReport {
            frame: frame.number,
            status,
            reason,
            targets_seen: found.seen,
            targets_used: found.used,
            gross_errors: found.gross,
            rms_px: found.rms_px,
            sigma_position_m,
            sigma_attitude_deg: sigma_attitude_rad.to_degrees(),
        })
    };
    Some(ResectionReport {
        given: quality.given,
        resected: quality.resected,
        bridged: quality.bridged,
        gross_errors: quality.gross_errors,
        spread: resection.spread,
        median_targets_used: quality.median_used,
        median_rms_px: quality.median_rms_px,
        median_sigma_position_m: quality.median_sigma_position_m,
        median_sigma_attitude_deg: quality.median_sigma_attitude_rad.to_degrees(),
        frames: problem.frames.iter().zip(&resection.frames).filter_map(frame).collect(),
    })
}

fn empty(problem: &Problem, left_out: Vec<String>) -> Report {
    Report {
        schema: SCHEMA,
        program: PROGRAM,
        version: env!("CARGO_PKG_VERSION"),
        problem: problem.name.clone(),
        command: String::new(),
        inputs: Vec::new(),
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
        image_points: None,
        behind_camera: 0,
        not_used: 0,
        resection: None,
        least_squares: None,
        sigmas_are_upper_bounds: false,
        observability: None,
        verdict: None,
        statistics: None,
        scales: Vec::new(),
        estimated: Vec::new(),
        standstill: Vec::new(),
        directed_tests: Vec::new(),
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

fn image_points(tally: &Tally) -> ImagePointsReport {
    ImagePointsReport {
        given: tally.all(),
        used: tally.used,
        down_weighted: tally.down_weighted,
        rejected: RejectionReason::ALL.into_iter().map(|reason| (reason.name(), tally.of(reason))).collect(),
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
    /// Adds what measurements leave open of a first estimate.
    pub fn add_observability(&mut self, found: &Observability) {
        self.observability = Some(observability_report(found));
    }

    /// Adds what a diagnosis says.
    pub fn add_diagnosis(&mut self, problem: &Problem, diagnosis: &Diagnosis, verdict: &Verdict) {
        self.verdict = Some(verdict_report(verdict));
        self.observability = diagnosis.observability.as_ref().map(observability_report);
        self.sigmas_are_upper_bounds = diagnosis.is_upper_bound;
        self.statistics = Some(statistics_report(problem, diagnosis));
        self.scales = scale_reports(problem, diagnosis);
        self.estimated = parameter_reports(diagnosis);
        self.standstill = standstill_reports(problem, diagnosis);
        for (report, found) in self.check_points.iter_mut().zip(&diagnosis.check_points) {
            let [x, y, z] = found.sigma_m.map_or([None; 3], |sigma| sigma.map(Some));
            (report.sigma_dx, report.sigma_dy, report.sigma_dz) = (x, y, z);
            report.chi_square = found.chi_square.map(|(value, _)| value);
            report.probability = found.chi_square.map(|(_, probability)| probability);
        }
    }

    /// Adds what the numbers are from: the command, and the files that it read.
    pub fn add_origin(&mut self, command: String, inputs: &[InputFile]) {
        self.command = command;
        let report = |InputFile { file, bytes, sha256 }: &InputFile| InputReport {
            file: file.clone(),
            bytes: *bytes,
            sha256: sha256.clone(),
        };
        self.inputs = inputs.iter().map(report).collect();
    }

    /// The verdict and what it rests on as a document to read.
    pub fn document(&self) -> String {
        super::document(&serde_json::to_value(self).expect("plain data"))
    }

    /// Its text, as it stands in the folder.
    pub fn to_json(&self) -> String {
        let mut text = serde_json::to_string_pretty(self).expect("plain data");
        text.push('\n');
        text
    }
}
