//! `report.json`: what was solved and how well, for programs.

use super::diagnosis::{
    DirectedTestReport, ObservabilityReport, ParameterReport, PullReport, ScaleReport, StandstillReport,
    StatisticsReport, VerdictReport, directed_test_reports, observability_report, parameter_reports,
    pull_reports, scale_reports, standstill_reports, statistics_report, verdict_report,
};
use super::finding::{FindingReport, number};
use super::folder::PROGRAM;
use crate::diagnose::observability::Observability;
use crate::diagnose::{Diagnosis, NoSigmas, Verdict};
use crate::disk::InputFile;
use crate::initialise::resection::Status;
use crate::initialise::{Initial, Resection};
use crate::problem::Problem;
use crate::refine::{Adjustment, Body, BodyStrength, CheckPoint, Order, RejectionReason, Round, Tally};
use crate::words::{MotionFacts, ResultFacts, Warning};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use trackbundle_solver::Elimination;
use trackbundle_solver::loss::Loss;

/// Version of the form of the report.
pub const SCHEMA: u32 = 1;

/// A file that was read.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(default)]
pub struct InputReport {
    /// Its name within the problem folder.
    pub file: String,
    /// Its length.
    pub bytes: Option<u64>,
    /// SHA-256 of its bytes.
    pub sha256: String,
}

/// The report. Units stand in the names; else metres, seconds, degrees.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(default)]
pub struct Report {
    /// Version of this form; fields may be added without a new one.
    pub schema: u32,
    /// Always `trackbundle`: by this a folder is known as a result.
    pub program: String,
    /// Version of the program.
    pub version: String,
    /// Name of the problem.
    pub problem: String,
    /// The command, with what it was told of options that change numbers; `PROBLEM` is the problem folder.
    pub command: String,
    /// The files that it read.
    pub inputs: Vec<InputReport>,
    /// `converged`, `iteration_limit`, `stalled` or `initialised`.
    pub status: String,
    /// Why the last round stopped, with the measured value.
    pub stop: String,
    /// Iterations of all rounds.
    pub iterations: Option<usize>,
    /// Half the sum of rho at the start, under the last round's losses.
    pub initial_cost: Option<f64>,
    /// Half the sum of rho at the end.
    pub final_cost: Option<f64>,
    /// Rows that took part: two for each image point that is not rejected, and those of everything else.
    pub observations: Option<usize>,
    /// Numbers that were adjusted.
    pub parameters: Option<usize>,
    /// Rows minus parameters.
    pub redundancy: Option<i64>,
    /// Standard deviation of unit weight a posteriori (a priori 1).
    pub sigma0: Option<f64>,
    /// Root mean square of the coordinates of all image points that are not gross errors.
    pub rms_px: Option<f64>,
    /// The same of vehicles alone.
    pub rms_vehicle_px: Option<f64>,
    /// The same of targets alone.
    pub rms_target_px: Option<f64>,
    /// Gross errors among the image points.
    pub outliers: Option<usize>,
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
    /// How far conventions, and errors of estimated strengths of motion, pull at each vehicle.
    pub pulls: Vec<PullReport>,
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
    pub seconds: BTreeMap<String, f64>,
    /// What is odd, in sentences.
    pub warnings: Vec<String>,
    /// The same for programs, in the same order.
    pub findings: Vec<FindingReport>,
    /// What failed once the adjustment was done, and why.
    pub failed_steps: Vec<FailedStepReport>,
    /// The files of the folder, this one among them: what another result may replace.
    pub files: Vec<String>,
}

/// A step after the adjustment that failed.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(default)]
pub struct FailedStepReport {
    /// `diagnosis`, `recording`, `viewer` or `comparison`.
    pub step: String,
    /// Why.
    pub why: String,
}

/// What became of the image points. `given` is the sum of all others.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(default)]
pub struct ImagePointsReport {
    /// All of the problem.
    pub given: usize,
    /// That took part.
    pub used: usize,
    /// That took part with less than half of their weight.
    pub down_weighted: usize,
    /// That were rejected, by reason.
    pub rejected: BTreeMap<String, usize>,
}

/// How camera poses were found before the adjustment. Medians are over the frames that were resected;
/// sigmas are those along and about the worst axis.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(default)]
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
    #[serde(deserialize_with = "number")]
    #[cfg_attr(test, schemars(with = "Option<f64>"))]
    pub spread: f64,
    /// Median number of control targets that took part.
    #[serde(deserialize_with = "number")]
    #[cfg_attr(test, schemars(with = "Option<f64>"))]
    pub median_targets_used: f64,
    /// Median root mean square of the coordinates of residuals.
    #[serde(deserialize_with = "number")]
    #[cfg_attr(test, schemars(with = "Option<f64>"))]
    pub median_rms_px: f64,
    /// Median standard deviation of a position.
    #[serde(deserialize_with = "number")]
    #[cfg_attr(test, schemars(with = "Option<f64>"))]
    pub median_sigma_position_m: f64,
    /// Median standard deviation of an attitude.
    #[serde(deserialize_with = "number")]
    #[cfg_attr(test, schemars(with = "Option<f64>"))]
    pub median_sigma_attitude_deg: f64,
    /// One for each frame without a given pose.
    pub frames: Vec<FrameResectionReport>,
}

/// How the camera pose of a frame was found.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(default)]
pub struct FrameResectionReport {
    /// Number of the frame.
    pub frame: i64,
    /// `resected` or `bridged`.
    pub status: String,
    /// Why it was bridged.
    pub reason: Option<String>,
    /// Control targets in view.
    pub targets_seen: usize,
    /// Of these, what took part.
    pub targets_used: usize,
    /// Of these, gross errors.
    pub gross_errors: usize,
    /// Root mean square of the coordinates of residuals.
    pub rms_px: Option<f64>,
    /// Standard deviation of the position.
    #[serde(deserialize_with = "number")]
    #[cfg_attr(test, schemars(with = "Option<f64>"))]
    pub sigma_position_m: f64,
    /// Standard deviation of the attitude.
    #[serde(deserialize_with = "number")]
    #[cfg_attr(test, schemars(with = "Option<f64>"))]
    pub sigma_attitude_deg: f64,
}

/// The loss of image points.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(default)]
pub struct LossReport {
    /// Its name.
    pub name: String,
    /// Its scale in standard deviations of an image point.
    pub scale_sigmas: Option<f64>,
    /// Barron's alpha.
    pub shape: Option<f64>,
}

/// The motion prior of a body: scatter of its mean acceleration over one second.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(default)]
pub struct MotionReport {
    /// `camera`, or `vehicle` and its id.
    pub body: String,
    /// What is white noise: `acceleration` or `jerk`.
    pub white_noise: String,
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
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(default)]
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
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(default)]
pub struct LeastSquaresReport {
    /// By what standard deviations of image points of vehicles were multiplied: 1 where they proved right.
    #[serde(deserialize_with = "number")]
    #[cfg_attr(test, schemars(with = "Option<f64>"))]
    pub sigma_factor_vehicles: f64,
    /// The same of targets.
    #[serde(deserialize_with = "number")]
    #[cfg_attr(test, schemars(with = "Option<f64>"))]
    pub sigma_factor_targets: f64,
    /// How far shape points in the world moved from the robust solution, root mean square.
    #[serde(deserialize_with = "number")]
    #[cfg_attr(test, schemars(with = "Option<f64>"))]
    pub moved_rms_m: f64,
    /// The farthest.
    #[serde(deserialize_with = "number")]
    #[cfg_attr(test, schemars(with = "Option<f64>"))]
    pub moved_largest_m: f64,
}

/// How the normal equations were eliminated.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(default)]
pub struct EliminationReport {
    /// The order.
    pub order: String,
    /// Multiplications and additions of one factorisation.
    #[serde(deserialize_with = "number")]
    #[cfg_attr(test, schemars(with = "Option<f64>"))]
    pub operations: f64,
}

/// One minimisation.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(default)]
pub struct RoundReport {
    /// Its name.
    pub name: String,
    /// Iterations of all rounds.
    pub iterations: usize,
    /// Half the sum of rho at the start, under the last round's losses.
    #[serde(deserialize_with = "number")]
    #[cfg_attr(test, schemars(with = "Option<f64>"))]
    pub initial_cost: f64,
    /// Half the sum of rho at the end.
    #[serde(deserialize_with = "number")]
    #[cfg_attr(test, schemars(with = "Option<f64>"))]
    pub final_cost: f64,
    /// Why the last round stopped, with the measured value.
    pub stop: String,
}

fn of_order(order: Order, found: &BodyStrength, strength: f64) -> Option<f64> {
    (found.order == order).then_some(strength)
}

/// The report of an adjustment. Stages and their seconds, and warnings from before, are added.
pub fn report_of_adjustment(problem: &Problem, adjustment: &Adjustment, left_out: Vec<String>) -> Report {
    let [rms_vehicle_px, rms_target_px, rms_px] = adjustment.rms_px;
    let mut report = Report {
        status: adjustment.stop.status().to_owned(),
        stop: adjustment.stop.to_string(),
        iterations: Some(adjustment.iterations()),
        initial_cost: Some(adjustment.initial_cost),
        final_cost: Some(adjustment.final_cost),
        observations: Some(adjustment.observations),
        parameters: Some(adjustment.parameters),
        redundancy: Some(adjustment.redundancy),
        sigma0: adjustment.sigma0,
        rms_px,
        rms_vehicle_px,
        rms_target_px,
        outliers: Some(adjustment.fits.outliers),
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
        motion: adjustment.motion.iter().map(motion_report).collect(),
        check_points: adjustment.check_points.iter().map(check_point_report).collect(),
        elimination: Some(elimination_report(adjustment.elimination)),
        rounds: adjustment.rounds.iter().map(round_report).collect(),
        directed_tests: directed_test_reports(&adjustment.directed_tests),
        ..empty(problem, left_out)
    };
    adjustment.warnings.iter().for_each(|warning| report.warn(&warning.clone().into()));
    report
}

fn motion_report(found: &BodyStrength) -> MotionReport {
    let (linear, angular) = (found.strength.linear, found.strength.angular.to_degrees());
    let white_noise = match found.order {
        Order::Acceleration => "acceleration",
        Order::Jerk => "jerk",
    };
    MotionReport {
        body: match &found.body {
            Body::Camera => "camera".to_owned(),
            Body::Vehicle(id) => format!("vehicle {id}"),
        },
        white_noise: white_noise.to_owned(),
        acceleration_mps2: of_order(Order::Acceleration, found, linear),
        angular_acceleration_degps2: of_order(Order::Acceleration, found, angular),
        jerk_mps3: of_order(Order::Jerk, found, linear),
        angular_jerk_degps3: of_order(Order::Jerk, found, angular),
        estimated: found.is_estimated,
    }
}

fn check_point_report(check: &CheckPoint) -> CheckPointReport {
    CheckPointReport {
        target: check.id.clone(),
        dx: check.difference_m.map(|d| d.x),
        dy: check.difference_m.map(|d| d.y),
        dz: check.difference_m.map(|d| d.z),
        ..CheckPointReport::default()
    }
}

fn elimination_report((rule, operations): (Elimination, f64)) -> EliminationReport {
    let order = match rule {
        Elimination::JointBodies => "frames by what image points see of them, then shape and rest",
        Elimination::SeparateBodies => "each vehicle with its shape, then cameras and the rest",
        Elimination::AsDeclared => "frames along time, then shape and targets",
        Elimination::MinimumDegree => "approximate minimum degree",
    };
    EliminationReport { order: order.to_owned(), operations }
}

fn round_report(round: &Round) -> RoundReport {
    RoundReport {
        name: round.name.to_owned(),
        iterations: round.records.len() - 1,
        initial_cost: round.records[0].cost,
        final_cost: round.records[round.records.len() - 1].cost,
        stop: round.stop.to_string(),
    }
}

/// The report of a first estimate.
pub fn report_of_initial(problem: &Problem, initial: &Initial, left_out: Vec<String>) -> Report {
    let resection = resection_report(problem, initial.resection.as_ref());
    let mut report = Report { resection, ..empty(problem, left_out) };
    initial.warnings.iter().for_each(|warning| report.warn(&warning.clone().into()));
    report
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
            status: status.to_owned(),
            reason: reason.map(str::to_owned),
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
        program: PROGRAM.to_owned(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        problem: problem.name.clone(),
        status: "initialised".to_owned(),
        stop: "not adjusted".to_owned(),
        iterations: Some(0),
        observations: Some(0),
        parameters: Some(0),
        redundancy: Some(0),
        outliers: Some(0),
        left_out,
        ..Report::default()
    }
}

fn image_points(tally: &Tally) -> ImagePointsReport {
    ImagePointsReport {
        given: tally.all(),
        used: tally.used,
        down_weighted: tally.down_weighted,
        rejected: RejectionReason::ALL
            .into_iter()
            .map(|reason| (reason.name().to_owned(), tally.of(reason)))
            .collect(),
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
    LossReport { name: name.to_owned(), scale_sigmas: scale, shape }
}

fn motion_facts(found: &MotionReport) -> MotionFacts<'_> {
    MotionFacts {
        body: &found.body,
        white_noise: &found.white_noise,
        strength: match found.white_noise.as_str() {
            "jerk" => [found.jerk_mps3, found.angular_jerk_degps3],
            _ => [found.acceleration_mps2, found.angular_acceleration_degps2],
        },
        is_estimated: found.estimated,
    }
}

impl Report {
    /// Adds a warning.
    pub fn warn(&mut self, warning: &Warning) {
        self.warnings.push(warning.to_string());
        self.findings.push(FindingReport::new(warning));
    }

    /// Adds warnings from before, ahead of all others.
    pub fn warn_before(&mut self, warnings: &[Warning]) {
        self.warnings.splice(0..0, warnings.iter().map(ToString::to_string));
        self.findings.splice(0..0, warnings.iter().map(FindingReport::new));
    }

    /// Adds the seconds that a stage took.
    pub fn add_seconds(&mut self, stage: &str, seconds: f64) {
        self.seconds.insert(stage.to_owned(), seconds);
    }

    /// What is told of it in more than one place.
    pub fn facts(&self) -> ResultFacts<'_> {
        let image_points = self.image_points.as_ref();
        let loss = self.loss.as_ref();
        ResultFacts {
            status: &self.status,
            stop: &self.stop,
            iterations: self.iterations,
            cost: [self.initial_cost, self.final_cost],
            rows: self.observations,
            parameters: self.parameters,
            redundancy: self.redundancy,
            sigma0: self.sigma0,
            rms_px: [self.rms_px, self.rms_vehicle_px, self.rms_target_px],
            gross: self.outliers,
            image_points: [image_points.map(|p| p.given), image_points.map(|p| p.used)],
            loss: (loss.map_or("", |loss| loss.name.as_str()), loss.and_then(|loss| loss.scale_sigmas)),
            motion: self.motion.iter().map(motion_facts).collect(),
            check_points: self
                .check_points
                .iter()
                .map(|check| (check.target.as_str(), [check.dx, check.dy, check.dz]))
                .collect(),
        }
    }

    /// Adds what measurements leave open of a first estimate.
    pub fn add_observability(&mut self, found: &Observability) {
        self.observability = Some(observability_report(found));
    }

    /// Adds the verdict.
    pub fn add_verdict(&mut self, verdict: &Verdict) {
        self.verdict = Some(verdict_report(verdict));
    }

    /// Adds the verdict, and what a diagnosis says or why there is none.
    pub fn add_judged(
        &mut self,
        problem: &Problem,
        diagnosis: &Result<Diagnosis, NoSigmas>,
        verdict: &Verdict,
    ) {
        self.add_verdict(verdict);
        match diagnosis {
            Ok(diagnosis) => self.add_diagnosis(problem, diagnosis),
            Err(NoSigmas::Failed(why)) => self.fail("diagnosis", why.clone()),
            Err(_) => {}
        }
    }

    /// Adds what a diagnosis says.
    fn add_diagnosis(&mut self, problem: &Problem, diagnosis: &Diagnosis) {
        self.observability = diagnosis.observability.as_ref().map(observability_report);
        self.sigmas_are_upper_bounds = diagnosis.is_upper_bound;
        self.statistics = Some(statistics_report(problem, diagnosis));
        self.scales = scale_reports(problem, diagnosis);
        self.pulls = pull_reports(problem, diagnosis);
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
            bytes: Some(*bytes),
            sha256: sha256.clone(),
        };
        self.inputs = inputs.iter().map(report).collect();
    }

    /// Adds a step after the adjustment that failed.
    pub fn fail(&mut self, step: &str, why: String) {
        self.failed_steps.push(FailedStepReport { step: step.to_owned(), why });
    }

    /// The verdict and what it rests on as a document to read.
    pub fn document(&self) -> String {
        super::document(self)
    }

    /// Its text, as it stands in the folder.
    pub fn to_json(&self) -> String {
        let mut text = serde_json::to_string_pretty(self).expect("plain data");
        text.push('\n');
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::refine::AdjustmentWarning;
    use crate::report::diagnosis::Sigma;

    #[test]
    fn the_schema_is_that_of_the_types() {
        let wanted = serde_json::to_value(schemars::schema_for!(Report)).unwrap();
        let file = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/report.schema.json");
        if std::env::var_os("WRITE_SCHEMA").is_some() {
            std::fs::write(&file, format!("{wanted:#}\n")).unwrap();
        }
        let found: serde_json::Value = serde_json::from_slice(&std::fs::read(&file).unwrap()).unwrap();
        assert!(found == wanted, "run this test with WRITE_SCHEMA=1, and commit {}", file.display());
    }

    #[test]
    fn what_is_written_is_read_back_as_it_was() {
        let mut report = Report { iterations: Some(7), sigma0: Some(1.25), ..Report::default() };
        report.warn(&AdjustmentWarning::BehindCamera { image_points: 3 }.into());
        report.warn_before(&[Warning::Input("problem.toml:3: odd".to_owned())]);
        let scale = ScaleReport { sigma: Some(Sigma(f64::INFINITY)), ..ScaleReport::default() };
        report.scales.push(scale);
        let read: Report = serde_json::from_str(&report.to_json()).unwrap();
        assert_eq!(read, report);
        let codes: Vec<&str> = read.findings.iter().map(|found| found.code.as_str()).collect();
        assert_eq!(codes, ["input", "behind_camera"]);
        assert_eq!(read.findings[1].value, Some(3.0));
        assert!(read.warnings.iter().zip(&read.findings).all(|(text, found)| *text == found.text));
    }

    #[test]
    fn a_report_of_an_older_version_is_read() {
        let text = r#"{"schema": 1, "program": "trackbundle", "unheard_of": 1, "rms_px": null,
            "rounds": [{"name": "final", "final_cost": null}], "scales": [{"sigma": "inf", "shares": {"a": null}}],
            "estimated": [{"name": "cx_px"}], "verdict": {"trust": "yes", "reasons": []}}"#;
        let report: Report = serde_json::from_str(text).unwrap();
        assert_eq!((report.iterations, report.rms_px, report.findings.len()), (None, None, 0));
        assert!(report.rounds[0].final_cost.is_nan() && report.estimated[0].observable);
        assert_eq!(report.scales[0].sigma, Some(Sigma(f64::INFINITY)));
    }
}
