//! The least squares that an adjustment would end with, at unknowns that are known.

use super::gross_errors::Excluded;
use super::model::{Model, Purpose};
use super::motion::MotionPriors;
use super::outcome::Fits;
use super::{Arrangement, Network, RefineOptions, body_frames};
use crate::estimate::Estimate;
use crate::problem::Problem;
use trackbundle_solver::loss::Loss;

/// The network of a problem at its `truth`, and the truth with the motion that it has. All image points are good
/// ones; motion that is to be estimated is as strong as the true poses scatter. What is measured does not matter, but
/// for what depends on it: whether a point is seen, and when a row is exposed.
pub fn expected(problem: &Problem, truth: &Estimate, motion: MotionPriors) -> (Network, Estimate) {
    let options = RefineOptions { motion, arrangement: Arrangement::Together, ..RefineOptions::default() };
    let excluded = Excluded::nothing(problem);
    let robust = Model::new(problem, truth, truth, &options, Purpose::Adjustment { excluded: &excluded });
    let values = robust.values(truth);
    let frames = body_frames(problem, truth, &robust, &values);
    let fits = Fits::new(problem, truth, Loss::Squared, 1.0, &excluded).all_accepted();
    let purpose = Purpose::Statistics { fits: &fits, frames: &frames };
    let mut model = Model::new(problem, truth, truth, &options, purpose);
    let values = model.values(truth);
    model.set_motion_by_truth(&values);
    model.loosen_conventions();
    let estimate = model.estimate(problem, truth, &values);
    (Network { model, values, frames }, estimate)
}
