//! A result folder held against the references of its problem: what `evaluate` does, and `refine` at its end.

use crate::disk::InputFile;
use crate::evaluate::{EvaluateOptions, Evaluation, VehicleEvaluation, evaluate, evaluate_shapes};
use crate::files::{ResultPoint, ResultTracks, read_points, read_report, read_tracks};
use crate::page::changed_inputs;
use crate::problem::{Frame, Problem, Receiver};
use crate::reference::{Reference, TrueShape, read_true_shapes};
use crate::report::Report;
use crate::tables::Findings;
use nalgebra::Point3;
use std::path::{Path, PathBuf};

/// What is wrong, folder by folder.
pub type Invalid = Vec<(PathBuf, Findings)>;

/// What is compared of a result folder, with the truth of its problem where that is simulated.
pub struct ToCompare {
    /// Its tracks.
    pub tracks: ResultTracks,
    /// Its shapes.
    pub shapes: Vec<(String, Vec<ResultPoint>)>,
    truths: Vec<(String, TrueShape)>,
    report: Report,
    inputs: Vec<InputFile>,
}

/// A comparison.
pub struct Compared {
    /// The tracks of the result.
    pub tracks: ResultTracks,
    /// The report of the adjustment.
    pub report: Report,
    /// The files of the problem as they are now.
    pub inputs: Vec<InputFile>,
    /// The comparison itself.
    pub evaluation: Evaluation,
    /// What has a reference, or might have one, and was not compared.
    pub missing: Vec<String>,
    /// What is odd.
    pub warnings: Vec<String>,
}

impl Compared {
    /// Whether nothing was compared.
    pub fn is_empty(&self) -> bool {
        self.evaluation.vehicles.is_empty() && self.evaluation.shapes.is_empty()
    }

    /// What is odd and what was not compared, as it is told.
    pub fn told(&self) -> Vec<String> {
        let missing = self.missing.iter().map(|missing| format!("not compared: {missing}"));
        self.warnings.iter().cloned().chain(missing).collect()
    }
}

impl ToCompare {
    /// Reads what both folders have beside the problem itself, whose files are `inputs`; what is wrong with any of
    /// them is added to `invalid`. Without the vehicles of the problem rows are not held against them.
    pub fn read(
        problem_folder: &Path,
        result_folder: &Path,
        vehicles: Option<&[String]>,
        frames: Option<&[Frame]>,
        inputs: Vec<InputFile>,
        invalid: &mut Invalid,
    ) -> Option<Self> {
        let mut of_problem = Findings::default();
        let truths = vehicles.map(|vehicles| read_true_shapes(problem_folder, vehicles, &mut of_problem));
        let tracks = read_tracks(result_folder, vehicles, frames);
        let mut of_result = Findings::default();
        let shapes = read_points(result_folder, vehicles, &mut of_result);
        let report: Report = read_report(result_folder, &mut of_result).unwrap_or_default();
        if of_problem.is_invalid() {
            invalid.push((problem_folder.to_owned(), of_problem));
        }
        let tracks = tracks.map_err(|findings| invalid.push((result_folder.to_owned(), findings))).ok();
        if of_result.is_invalid() {
            invalid.push((result_folder.to_owned(), of_result));
        }
        Some(ToCompare { tracks: tracks?, shapes, truths: truths?, report, inputs })
    }

    /// Compares, for each of the problem's `vehicles`.
    pub fn compare(
        self,
        vehicles: &[String],
        reference: &Reference,
        problem: Option<&Problem>,
        options: &EvaluateOptions,
    ) -> Compared {
        let ToCompare { tracks, shapes, truths, report, inputs } = self;
        let used: Vec<(String, Point3<f64>)> = problem.into_iter().flat_map(observed_positions).collect();
        let mut evaluation = evaluate(vehicles, &tracks.tracks, reference, &used, options);
        (evaluation.shapes, evaluation.shapes_not_compared) =
            evaluate_shapes(vehicles, &shapes, reference, &truths, options);
        let has_scan = |vehicle: &str| reference.scans.iter().any(|(id, _)| id == vehicle);
        let tracks_missing = evaluation.not_compared.iter();
        let shapes_missing = evaluation.shapes_not_compared.iter().filter(|(vehicle, _)| has_scan(vehicle));
        let missing = tracks_missing
            .map(|(vehicle, why)| format!("vehicle {vehicle}: {why}"))
            .chain(shapes_missing.map(|(vehicle, why)| format!("shape of {vehicle}: {why}")))
            .collect();
        let changed = changed_inputs(&report, &inputs);
        let warnings = tracks
            .warnings
            .iter()
            .cloned()
            .chain((!changed.is_empty()).then(|| {
                format!("files of the problem are not those that were adjusted: {}", changed.join(", "))
            }))
            .chain(evaluation.vehicles.iter().filter_map(clock_warning))
            .chain(evaluation.vehicles.iter().filter_map(turn_warning))
            .collect();
        Compared { tracks, report, inputs, evaluation, missing, warnings }
    }
}

/// Positions that the problem adjusts to, and whose.
fn observed_positions(problem: &Problem) -> Vec<(String, Point3<f64>)> {
    let of_receiver = |receiver: &Receiver| {
        let id = &problem.vehicles[receiver.vehicle].id;
        receiver.positions.iter().map(|p| (id.clone(), p.position)).collect::<Vec<_>>()
    };
    problem.receivers.iter().flat_map(of_receiver).collect()
}

fn clock_warning(found: &VehicleEvaluation) -> Option<String> {
    let [off_s, moved_m] = found.clock_matters()?;
    let VehicleEvaluation { vehicle, track, .. } = found;
    Some(format!(
        "vehicle {vehicle}: by its tracks the offset of the receiver's clock is {:.4} s, {:.4} s was applied: {moved_m:.3} m \
         at its median speed (--clock-offset estimate)",
        track.clock_offset_s + off_s,
        track.clock_offset_s,
    ))
}

fn turn_warning(found: &VehicleEvaluation) -> Option<String> {
    let VehicleEvaluation { vehicle, track, .. } = found;
    let [_, second_m, _] = track.aligned.spread_m;
    (!track.aligned.is_turn_determined(track.distances_m.rmse)).then(|| {
        format!(
            "vehicle {vehicle}: its track is nearly straight ({second_m:.3} m wide, {:.3} m are left after the \
             alignment): the turn about it is hardly determined, and with it height and cross slope",
            track.distances_m.rmse
        )
    })
}
