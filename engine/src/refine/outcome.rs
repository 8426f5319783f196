//! What was solved and how well.

use super::Network;
use super::fit::ObservationFit;
use super::gross_errors;
use super::score_test::DirectedTest;
use super::verdicts::{Excluded, ImagePointVerdict, Tally, Verdicts};
use super::warnings::AdjustmentWarning;
use crate::estimate::{Estimate, Imaging};
use crate::initialise::intersect_target;
use crate::network::{BodyStrength, Model, OUTLIER_SIGMAS, Selection, Source};
use crate::problem::{Problem, Role, Target};
use nalgebra::{Vector2, Vector3};
use trackbundle_solver::Elimination;
use trackbundle_solver::loss::Loss;
use trackbundle_solver::minimise::{IterationRecord, Minimum, Stop};
use trackbundle_solver::system::Values;

/// The statistics of an adjustment.
#[derive(Clone, Debug)]
pub struct Adjustment {
    /// Why the last round stopped.
    pub stop: Stop,
    /// All rounds.
    pub rounds: Vec<Round>,
    /// Half the sum of `rho` of the start and of the end, both under the last round's losses.
    pub initial_cost: f64,
    /// See `initial_cost`.
    pub final_cost: f64,
    /// The loss of the last round.
    pub image_loss: Loss,
    /// Rows: two for each image point that is not rejected, and those of everything else.
    pub observations: usize,
    /// Numbers that were adjusted.
    pub parameters: usize,
    /// Rows minus parameters.
    pub redundancy: i64,
    /// Standard deviation of unit weight a posteriori (a priori 1); `None` without redundancy.
    pub sigma0: Option<f64>,
    /// Root mean square of the coordinates of image points that are not gross errors \[px\]: of
    /// vehicles, of targets, of both.
    pub rms_px: [Option<f64>; 3],
    /// How each image point fits.
    pub fits: Fits,
    /// Spread of the whitened image points of vehicles after the approach.
    pub spread: f64,
    /// The final least squares on accepted image points; `None` where it failed.
    pub least_squares: Option<LeastSquares>,
    /// Motion priors.
    pub motion: Vec<BodyStrength>,
    /// Check points.
    pub check_points: Vec<CheckPoint>,
    /// In which order the unknowns were eliminated, and operations of one factorisation.
    pub elimination: (Elimination, f64),
    /// Tests of single numbers that are held.
    pub directed_tests: Vec<DirectedTest>,
    /// What is odd.
    pub warnings: Vec<AdjustmentWarning>,
}

/// What the final least squares did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LeastSquares {
    /// By what the standard deviations of image points were multiplied: of vehicles, of targets.
    pub image_factors: [f64; 2],
    /// How far shape points in the world moved from the robust solution: root mean square and the largest
    /// \[m\].
    pub moved_m: [f64; 2],
}

impl LeastSquares {
    fn new(robust: &Estimate, estimate: &Estimate, network: &Network) -> Self {
        let (mut sum, mut count, mut largest) = (0.0, 0_usize, 0.0_f64);
        for (before, after) in robust.vehicles.iter().zip(&estimate.vehicles) {
            for (old, new) in before.poses.iter().zip(&after.poses) {
                let (Some(old), Some(new)) = (old, new) else { continue };
                for (p, q) in before.points.iter().zip(&after.points) {
                    let (Some(p), Some(q)) = (p, q) else { continue };
                    let moved_m = (new * q - old * p).norm();
                    sum += moved_m * moved_m;
                    largest = largest.max(moved_m);
                    count += 1;
                }
            }
        }
        let rms_m = (sum / count.max(1) as f64).sqrt();
        LeastSquares { image_factors: network.model.image_factors(), moved_m: [rms_m, largest] }
    }
}

/// What sigma0 comes from.
struct Statistics {
    observations: usize,
    parameters: usize,
    squares: f64,
}

impl Statistics {
    fn of_least_squares(network: &Network) -> Self {
        let Network { model, values, frames } = network;
        let (prior_rows, prior_squares) = model.prior_rows(values);
        let images = model.image_rows(values);
        Statistics {
            observations: prior_rows + images.iter().map(|i| i.0).sum::<usize>(),
            // What is held of frames is no unknown.
            parameters: model.parameters() - frames.iter().map(|f| f.anchors.len()).sum::<usize>(),
            squares: prior_squares + images.iter().map(|i| i.1).sum::<f64>(),
        }
    }

    fn of_robust(model: &Model, minimum: &Minimum, inside: &[(f64, ObservationFit)]) -> Self {
        let (prior_rows, prior_squares) = model.prior_rows(&minimum.values);
        // What is held of frames is no unknown.
        let held: usize = model.groups_of(Source::Frame).map(|group| model.system.rows(group)).sum();
        let image_squares: f64 =
            inside.iter().map(|(sigma, fit)| fit.residual_px.norm_squared() / (sigma * sigma)).sum();
        Statistics {
            observations: prior_rows + 2 * inside.len(),
            parameters: model.system.parameters() - held,
            squares: prior_squares + image_squares,
        }
    }
}

/// One minimisation.
#[derive(Clone, Debug)]
pub struct Round {
    /// What it was for.
    pub name: &'static str,
    /// Why it stopped.
    pub stop: Stop,
    /// Its iterations, the start first.
    pub records: Vec<IterationRecord>,
}

/// How all image points of a problem fit an estimate.
#[derive(Clone, Debug, PartialEq)]
pub struct Fits {
    /// For each vehicle one for each of its observations; `None` where it was not used.
    pub vehicles: Vec<Vec<Option<ObservationFit>>>,
    /// One for each target observation. Those of check points weigh nothing.
    pub targets: Vec<Option<ObservationFit>>,
    /// The verdict on each.
    pub verdicts: Verdicts,
    /// How many there are of each; together all image points.
    pub tally: Tally,
    /// Gross errors among them, without those of check points.
    pub outliers: usize,
    /// Those whose computed place is behind the camera.
    pub behind_camera: usize,
    /// Those of points that have no coordinates.
    pub not_used: usize,
}

/// A surveyed target that the adjustment did not use.
#[derive(Clone, Debug, PartialEq)]
pub struct CheckPoint {
    /// Index of the target.
    pub target: usize,
    /// Its id.
    pub id: String,
    /// Intersected from the adjusted cameras minus surveyed \[m\]; `None` where its rays do not meet.
    pub difference_m: Option<Vector3<f64>>,
}

/// The end of the last round.
pub struct End<'a> {
    pub model: &'a Model,
    pub minimum: Minimum,
    pub rounds: Vec<Round>,
    pub spread: f64,
    pub image_loss: Loss,
    /// How image points fit the end.
    pub fits: Fits,
    /// The end of the robust adjustment.
    pub robust: &'a Estimate,
    /// The least squares that followed.
    pub network: Option<&'a Network>,
}

impl Adjustment {
    /// Iterations of all rounds.
    pub fn iterations(&self) -> usize {
        self.rounds.iter().map(|round| round.records.len() - 1).sum()
    }
}

impl Fits {
    /// The fits of an estimate under a loss; `spread` is what good image points scatter, in units of
    /// their standard deviations. `excluded` took no part.
    pub fn new(
        problem: &Problem,
        estimate: &Estimate,
        image_loss: Loss,
        spread: f64,
        excluded: &Excluded,
    ) -> Fits {
        let limit = OUTLIER_SIGMAS * spread.max(1.0);
        let mut fits = Fits {
            vehicles: Vec::new(),
            targets: Vec::new(),
            verdicts: Verdicts::default(),
            tally: Tally::default(),
            outliers: 0,
            behind_camera: 0,
            not_used: 0,
        };
        let imaging = Imaging::new(problem, estimate);
        for (at, vehicle) in problem.vehicles.iter().enumerate() {
            let found = &estimate.vehicles[at];
            let mut of_vehicle = Vec::with_capacity(vehicle.observations.len());
            for o in &vehicle.observations {
                let is_used = found.left_out.is_none() && found.points[o.point].is_some();
                let computed = is_used.then(|| imaging.vehicle_px(at, o.frame, o.point));
                of_vehicle.push(fits.count(computed, o.image_px, o.sigma_px, image_loss));
            }
            fits.vehicles.push(of_vehicle);
        }
        for o in &problem.target_observations {
            let target = &problem.targets[o.target];
            let position = match target.role {
                Role::Control => estimate.targets[o.target],
                Role::Check => target.surveyed(),
            };
            let computed = position.map(|p| imaging.target_px(o.frame, &p));
            let fit = fits.count(computed, o.image_px, o.sigma_px, image_loss);
            fits.targets.push(fit);
        }
        fits.verdicts =
            gross_errors::verdicts(problem, estimate, (&fits.vehicles, &fits.targets), excluded, limit);
        let verdicts = fits.verdicts.vehicles.iter().chain([&fits.verdicts.targets]);
        let excluded = excluded.vehicles.iter().chain([&excluded.targets]);
        let sets = fits.vehicles.iter_mut().chain([&mut fits.targets]);
        for ((fits, verdicts), excluded) in sets.zip(verdicts).zip(excluded) {
            for ((fit, verdict), out) in fits.iter_mut().zip(verdicts).zip(excluded) {
                let (Some(fit), ImagePointVerdict::Rejected(reason)) = (fit, verdict) else { continue };
                fit.is_outlier = reason.is_gross();
                // A loss that never lets go of an image point has kept what is a gross error.
                if image_loss.redescends() || !fit.is_outlier || out.is_some() {
                    fit.weight = 0.0;
                }
            }
        }
        fits.tally = fits.verdicts.tally();
        fits.outliers = fits.tally.gross();
        fits
    }

    /// The fits of a first estimate, by which no image point is rejected yet.
    pub fn of_start(problem: &Problem, start: &Estimate) -> Fits {
        let mut fits = Fits::new(problem, start, Loss::Squared, 1.0, &Excluded::nothing(problem));
        let verdicts = fits.verdicts.vehicles.iter_mut().flatten().chain(&mut fits.verdicts.targets);
        for verdict in verdicts {
            if matches!(verdict, ImagePointVerdict::Rejected(reason) if reason.is_gross()) {
                *verdict = ImagePointVerdict::Used;
            }
        }
        fits
    }

    /// The same with no image point rejected.
    pub fn all_accepted(&self) -> Fits {
        let mut fits = self.clone();
        let accept = |fit: &mut ObservationFit| fit.is_outlier = false;
        fits.vehicles.iter_mut().flatten().chain(&mut fits.targets).flatten().for_each(accept);
        fits
    }

    /// The image points that are accepted.
    pub fn selection(&self) -> Selection {
        let accepted = |fits: &Vec<Option<ObservationFit>>| -> Vec<bool> {
            fits.iter().map(|fit| fit.is_some_and(|fit| fit.is_accepted())).collect()
        };
        Selection { vehicles: self.vehicles.iter().map(accepted).collect(), targets: accepted(&self.targets) }
    }

    /// One fit; `computed` is `None` where the point has no coordinates.
    fn count(
        &mut self,
        computed: Option<Option<Vector2<f64>>>,
        observed_px: Vector2<f64>,
        sigma_px: f64,
        image_loss: Loss,
    ) -> Option<ObservationFit> {
        match computed {
            None => self.not_used += 1,
            Some(None) => self.behind_camera += 1,
            Some(Some(_)) => {}
        }
        let residual_px = observed_px - computed??;
        let squared = residual_px.norm_squared() / (sigma_px * sigma_px);
        Some(ObservationFit { residual_px, weight: image_loss.weight(squared), is_outlier: false })
    }

    /// Fits that took part and are not gross errors, with the standard deviations of their image
    /// points \[px\]: of vehicles and of targets.
    pub fn inside(&self, problem: &Problem) -> [Vec<(f64, ObservationFit)>; 2] {
        let good = |sigma_px: f64, fit: &Option<ObservationFit>| {
            fit.filter(|fit| !fit.is_outlier).map(|fit| (sigma_px, fit))
        };
        let of_vehicles = problem.vehicles.iter().zip(&self.vehicles).flat_map(|(vehicle, fits)| {
            vehicle.observations.iter().zip(fits).filter_map(|(o, fit)| good(o.sigma_px, fit))
        });
        let of_targets = problem.target_observations.iter().zip(&self.targets).filter_map(|(o, fit)| {
            let takes_part = problem.targets[o.target].role == Role::Control;
            good(o.sigma_px, fit).filter(|_| takes_part)
        });
        [of_vehicles.collect(), of_targets.collect()]
    }
}

/// The statistics of an adjustment.
pub fn summarise(problem: &Problem, start: &Estimate, estimate: &Estimate, end: End) -> Adjustment {
    let End { model, minimum, rounds, spread, image_loss, fits, robust, network } = end;
    let [of_vehicles, of_targets] = fits.inside(problem);
    let both = [of_vehicles.as_slice(), &of_targets].concat();
    let initial_cost = model.system.cost(&model.values(start)).value;
    let statistics = match network {
        Some(network) => Statistics::of_least_squares(network),
        None => Statistics::of_robust(model, &minimum, &both),
    };
    let Statistics { observations, parameters, squares } = statistics;
    let values = network.map_or(&minimum.values, |network| &network.values);
    let redundancy = observations as i64 - parameters as i64;
    let counted = network.map_or(model, |network| &network.model);
    let warnings = warnings(&minimum, values, spread, &fits, both.len(), [model, counted], network.is_some());
    Adjustment {
        stop: minimum.stop,
        rounds,
        initial_cost,
        final_cost: minimum.cost.value,
        image_loss,
        observations,
        parameters,
        redundancy,
        sigma0: (redundancy > 0).then(|| (squares / redundancy as f64).sqrt()),
        rms_px: [rms_px(&of_vehicles), rms_px(&of_targets), rms_px(&both)],
        fits,
        spread,
        least_squares: network.map(|network| LeastSquares::new(robust, estimate, network)),
        motion: counted.motion.strengths(&counted.system),
        check_points: check_points(problem, estimate),
        elimination: model.system.elimination(),
        directed_tests: Vec::new(),
        warnings,
    }
}

/// Image points of vehicles are said to scatter more than stated from this factor on ...
const OTHER_SCATTER: f64 = 2.0;
/// ... where there are so many.
const LEAST_IMAGE_POINTS: usize = 100;

/// What is odd about the end; `models` are those of the robust adjustment and of what statistics are from.
fn warnings(
    minimum: &Minimum,
    values: &Values,
    spread: f64,
    fits: &Fits,
    image_points: usize,
    models: [&Model; 2],
    has_least_squares: bool,
) -> Vec<AdjustmentWarning> {
    let mut warnings: Vec<AdjustmentWarning> = Vec::new();
    for warning in models.iter().flat_map(|model| &model.warnings) {
        let is_repeated = |told: &AdjustmentWarning| matches!(told, AdjustmentWarning::Network(told) if told.is_of_the_same(warning));
        if !warnings.iter().any(is_repeated) {
            warnings.push(AdjustmentWarning::Network(warning.clone()));
        }
    }
    if !has_least_squares {
        warnings.push(AdjustmentWarning::NoLeastSquares);
    }
    if !minimum.stop.converged() {
        warnings.push(AdjustmentWarning::NotConverged { stop: minimum.stop });
    }
    if fits.behind_camera > 0 {
        warnings.push(AdjustmentWarning::BehindCamera { image_points: fits.behind_camera });
    }
    let contacts = models[1].lost_contacts(values);
    if contacts > 0 {
        warnings.push(AdjustmentWarning::ContactsLost { contacts });
    }
    if spread > OTHER_SCATTER && image_points >= LEAST_IMAGE_POINTS {
        warnings.push(AdjustmentWarning::VehiclesScatter { factor: spread, limit: OTHER_SCATTER });
    }
    warnings
}

/// Takes the coordinates of shape points that fewer than two image points agree with: they are where
/// the usual size of a car puts them, not where anybody saw them. Says which.
pub fn drop_rejected_points(
    problem: &Problem,
    estimate: &mut Estimate,
    fits: &Fits,
) -> Vec<AdjustmentWarning> {
    let mut warnings = Vec::new();
    for (at, vehicle) in problem.vehicles.iter().enumerate() {
        let found = &mut estimate.vehicles[at];
        let mut good = vec![0; vehicle.points.len()];
        for (observation, fit) in vehicle.observations.iter().zip(&fits.vehicles[at]) {
            good[observation.point] += usize::from(fit.is_some_and(|fit| !fit.is_outlier));
        }
        let mut dropped = Vec::new();
        for (point, shape_point) in vehicle.points.iter().enumerate() {
            let is_known = shape_point.known.iter().any(Option::is_some);
            if good[point] < 2 && !is_known && found.points[point].take().is_some() {
                dropped.push(shape_point.id.clone());
            }
        }
        if !dropped.is_empty() {
            warnings.push(AdjustmentWarning::PointsRejected { vehicle: vehicle.id.clone(), points: dropped });
        }
    }
    warnings
}

/// Root mean square of the coordinates.
fn rms_px(fits: &[(f64, ObservationFit)]) -> Option<f64> {
    let sum: f64 = fits.iter().map(|(_, fit)| fit.residual_px.norm_squared()).sum();
    (!fits.is_empty()).then(|| (sum / (2 * fits.len()) as f64).sqrt())
}

fn check_points(problem: &Problem, estimate: &Estimate) -> Vec<CheckPoint> {
    let check = |(at, target): (usize, &Target)| {
        let surveyed = target.surveyed().filter(|_| target.role == Role::Check)?;
        let found = intersect_target(problem, &estimate.camera_poses, at);
        let difference_m = found.map(|p| p - surveyed);
        Some(CheckPoint { target: at, id: target.id.clone(), difference_m })
    };
    problem.targets.iter().enumerate().filter_map(check).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use trackbundle_solver::loss::LossName;

    #[test]
    fn the_default_loss_rejects_what_counts_as_a_gross_error() {
        assert_eq!(LossName::Tukey.default_scale(), OUTLIER_SIGMAS);
        assert_eq!(crate::refine::RefineOptions::default().loss, LossName::Tukey);
    }
}
