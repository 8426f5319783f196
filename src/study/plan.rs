//! From a wanted accuracy to a flight: which cells of a study reach it, and which of them is the cheapest.

use super::Outcome;
use super::cell::Prediction;
use super::settings::{Study, Wanted};
use crate::diagnose::Quantity;

/// What a cell is worth to a plan.
#[derive(Clone, Debug, PartialEq)]
pub struct Choice {
    /// Number of the cell.
    pub cell: usize,
    /// The worst ratio of an expected standard deviation to the wanted one, and of which quantity; at most 1 where all
    /// is reached. Infinite where something is not determined, or cannot be computed.
    pub worst: (f64, Quantity),
    /// What an image shows of the ground \[m^2\].
    pub view_m2: f64,
    /// Targets to survey, and points to track.
    pub effort: [usize; 2],
}

impl Choice {
    /// Whether it reaches what is wanted.
    pub fn is_feasible(&self) -> bool {
        self.worst.0 <= 1.0
    }
}

impl Wanted {
    /// What is wanted of each quantity, in the order of [`Quantity::ALL`].
    pub fn limits(&self) -> [Option<f64>; 6] {
        [self.track_m, self.height_m, self.speed_mps, self.heading_deg, self.shape_m, self.scale]
    }
}

/// The worst of all vehicles and quantities.
fn worst(prediction: &Prediction, limits: &[Option<f64>; 6]) -> (f64, Quantity) {
    let mut worst = (0.0, Quantity::TrackPlan);
    for sigmas in &prediction.sigmas {
        for ((sigma, limit), quantity) in sigmas.iter().zip(limits).zip(Quantity::ALL) {
            let Some(limit) = limit else { continue };
            let ratio = sigma / limit;
            if ratio > worst.0 || ratio.is_nan() {
                worst = (if ratio.is_nan() { f64::INFINITY } else { ratio }, quantity);
            }
        }
    }
    worst
}

/// All cells, and the cheapest that reaches what is wanted: of those with the largest view that with the fewest
/// targets, then with the fewest points, then the most accurate one.
pub fn plan(study: &Study, outcomes: &[Outcome]) -> (Vec<Choice>, Option<usize>) {
    let limits = study.wanted.unwrap_or_default().limits();
    let choice = |(cell, outcome): (usize, &Outcome)| match &outcome.prediction {
        Ok(prediction) => Choice {
            cell,
            worst: worst(prediction, &limits),
            view_m2: prediction.view_m2,
            effort: [prediction.counts[1], prediction.counts[2]],
        },
        Err(_) => Choice {
            cell,
            worst: (f64::INFINITY, Quantity::TrackPlan),
            view_m2: 0.0,
            effort: [usize::MAX; 2],
        },
    };
    let choices: Vec<Choice> = outcomes.iter().enumerate().map(choice).collect();
    // Views that differ by a thousandth are the same.
    let view = |choice: &Choice| (choice.view_m2.ln() * 1e3).round();
    let cheapest = choices.iter().filter(|choice| choice.is_feasible()).min_by(|a, b| {
        view(b)
            .total_cmp(&view(a))
            .then(a.effort.cmp(&b.effort))
            .then(a.worst.0.total_cmp(&b.worst.0))
            .then(a.cell.cmp(&b.cell))
    });
    let cheapest = cheapest.map(|choice| choice.cell);
    (choices, cheapest)
}
