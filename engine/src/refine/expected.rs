//! The least squares that an adjustment would end with, at unknowns that are known.

use super::outcome::Fits;
use super::verdicts::Excluded;
use super::{Arrangement, Network, RefineOptions, statistical};
use crate::estimate::Estimate;
use crate::network::{Model, MotionPriors, Purpose, Selection, body_frames};
use crate::problem::Problem;
use trackbundle_solver::loss::Loss;

/// The network of a problem at its `truth`, and the truth with the motion that it has. All image points are good
/// ones; motion that is to be estimated is as strong as the true poses scatter. What is measured does not matter, but
/// for what depends on it: whether a point is seen, and when a row is exposed.
pub fn expected(problem: &Problem, truth: &Estimate, motion: MotionPriors) -> (Network, Estimate) {
    let options = RefineOptions { motion, arrangement: Arrangement::Together, ..RefineOptions::default() };
    let excluded = Excluded::nothing(problem);
    let selection = Selection::everything(problem);
    let robust = Model::new(problem, truth, truth, options.network(), &selection, Purpose::FROM_AFAR);
    let values = robust.values(truth);
    let frames = body_frames(problem, truth, &robust, &values);
    let fits = Fits::new(problem, truth, Loss::Squared, 1.0, &excluded).all_accepted();
    let mut model = statistical(problem, truth, truth, &options, &fits, &frames);
    let values = model.values(truth);
    model.set_motion_by_truth(&values);
    model.loosen_conventions();
    let estimate = model.estimate(problem, truth, &values);
    (Network { model, values, frames }, estimate)
}
