//! A study in rows: for each cell, vehicle and quantity what is expected, what was observed, and from what it comes.

use super::Outcome;
use super::cell::RunErrors;
use super::settings::{Cell, Study};
use crate::diagnose::Quantity;
use crate::stats::normal::TWO_SIDED_95;
use std::collections::HashMap;

/// A row.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Number of the cell, from 0.
    pub cell: usize,
    /// Index of the vehicle.
    pub vehicle: usize,
    /// Name of the quantity.
    pub quantity: &'static str,
    /// Its unit.
    pub unit: &'static str,
    /// Expected standard deviation; infinite where it is not determined, `None` where there is none.
    pub predicted: Option<f64>,
    /// Observed root mean square error, or mean share.
    pub observed: Option<f64>,
    /// Observed over expected, and its 95 % interval.
    pub ratio: Option<[f64; 3]>,
    /// Standard deviation over the runs of a share.
    pub spread: Option<f64>,
    /// Runs that gave a result, and runs that did not.
    pub runs: [usize; 2],
    /// What the variance comes from, the largest share first.
    pub factors: Vec<(String, f64)>,
}

/// The name of a quantity, its unit, what people call it, and as a title.
pub fn name(quantity: Quantity) -> [&'static str; 4] {
    match quantity {
        Quantity::TrackPlan => ["track_plan", "m", "track in the plan", "Track in the plan"],
        Quantity::TrackHeight => ["track_height", "m", "height of the track", "Height of the track"],
        Quantity::Speed => ["speed", "m/s", "speed", "Speed"],
        Quantity::Heading => ["heading", "deg", "heading", "Heading"],
        Quantity::Shape => ["shape", "m", "shape", "Shape"],
        Quantity::Scale => ["scale", "1", "scale", "Scale"],
    }
}

/// Runs that gave no result.
pub fn without_result(outcomes: &[Outcome]) -> usize {
    outcomes.iter().flat_map(|outcome| &outcome.runs).filter(|run| run.is_err()).count()
}

/// Names of the shares within [`super::cell::WITHIN_M`].
const TO_POINTS: [&str; 3] = ["within_1cm_of_point", "within_2cm_of_point", "within_5cm_of_point"];
const TO_SCAN: [&str; 3] = ["within_1cm_of_scan", "within_2cm_of_scan", "within_5cm_of_scan"];

/// The rows of a study.
pub fn rows(outcomes: &[Outcome]) -> Vec<Row> {
    outcomes.iter().enumerate().flat_map(|(cell, outcome)| of_cell(cell, outcome)).collect()
}

fn of_cell(cell: usize, outcome: &Outcome) -> Vec<Row> {
    let Ok(prediction) = &outcome.prediction else { return Vec::new() };
    let good: Vec<&RunErrors> = outcome.runs.iter().flatten().collect();
    let runs = [good.len(), outcome.runs.len() - good.len()];
    let mut rows = Vec::new();
    for (vehicle, sigmas) in prediction.sigmas.iter().enumerate() {
        for (at, quantity) in Quantity::ALL.into_iter().enumerate() {
            let [name, unit, ..] = name(quantity);
            let squares: Vec<f64> = good.iter().map(|run| run.squares[vehicle][at]).collect();
            let moments = moments(&squares);
            let ratio =
                moments.filter(|_| sigmas[at] > 0.0 && sigmas[at].is_finite()).map(|[mean, spread]| {
                    let error = TWO_SIDED_95 * spread / (squares.len() as f64).sqrt();
                    [mean, (mean - error).max(0.0), mean + error].map(|square| square.sqrt() / sigmas[at])
                });
            rows.push(Row {
                cell,
                vehicle,
                quantity: name,
                unit,
                predicted: Some(sigmas[at]),
                observed: moments.map(|[mean, _]| mean.sqrt()),
                ratio,
                spread: None,
                runs,
                factors: prediction.factors[vehicle][at].clone(),
            });
        }
        let mut add = |names: [&'static str; 3], of: &dyn Fn(&RunErrors) -> [f64; 3]| {
            for (at, name) in names.into_iter().enumerate() {
                let shares: Vec<f64> =
                    good.iter().map(|run| of(run)[at]).filter(|share| share.is_finite()).collect();
                let Some([mean, spread]) = moments(&shares) else { continue };
                rows.push(Row {
                    cell,
                    vehicle,
                    quantity: name,
                    unit: "share",
                    predicted: None,
                    observed: Some(mean),
                    ratio: None,
                    spread: Some(spread),
                    runs,
                    factors: Vec::new(),
                });
            }
        };
        add(TO_POINTS, &|run| run.to_points[vehicle]);
        add(TO_SCAN, &|run| run.to_scan[vehicle]);
    }
    rows
}

/// Mean and standard deviation of two values or more.
fn moments(values: &[f64]) -> Option<[f64; 2]> {
    if values.len() < 2 {
        return None;
    }
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (count - 1.0);
    Some([mean, variance.sqrt()])
}

/// A value with six digits that count; nothing for none, `inf` for what is not determined.
pub fn number(value: Option<f64>) -> String {
    match value {
        None => String::new(),
        Some(value) if value == 0.0 || !value.is_finite() => format!("{value}"),
        Some(value) => {
            let digits = (5 - value.abs().log10().floor() as i32).clamp(0, 12) as usize;
            let text = format!("{value:.digits$}");
            if text.contains('.') {
                text.trim_end_matches('0').trim_end_matches('.').to_owned()
            } else {
                text
            }
        }
    }
}

/// How many sources of a variance are written.
const FACTORS: usize = 3;

/// The header and the rows of `cells.csv`: a row for each cell, vehicle and quantity. Cells that cannot be computed
/// have one row that says why.
pub fn table(study: &Study, outcomes: &[Outcome]) -> (Vec<String>, Vec<Vec<String>>) {
    let own = [
        "vehicle",
        "quantity",
        "unit",
        "predicted",
        "observed",
        "ratio",
        "ratio_low",
        "ratio_high",
        "spread",
        "runs",
        "failed",
        "factor_1",
        "share_1",
        "factor_2",
        "share_2",
        "factor_3",
        "share_3",
        "view_m2",
        "image_points",
        "why_not",
    ];
    let header = study.columns(&own);
    let cells = study.cells();
    let mut all = Vec::new();
    for (number_of_cell, (cell, outcome)) in cells.iter().zip(outcomes).enumerate() {
        let place = study.cell_cells(number_of_cell, cell);
        let prediction = match &outcome.prediction {
            Ok(prediction) => prediction,
            Err(why) => {
                let mut row = place;
                row.extend((1..own.len()).map(|_| String::new()));
                row.push(why.clone());
                all.push(row);
                continue;
            }
        };
        for row in of_cell(number_of_cell, outcome) {
            let mut cells = place.clone();
            let ratio = |at: usize| number(row.ratio.map(|ratio| ratio[at]));
            cells.extend([
                study.scenarios[cell.scenario].vehicles[row.vehicle].clone(),
                row.quantity.to_owned(),
                row.unit.to_owned(),
                number(row.predicted),
                number(row.observed),
                ratio(0),
                ratio(1),
                ratio(2),
                number(row.spread),
                row.runs[0].to_string(),
                row.runs[1].to_string(),
            ]);
            for at in 0..FACTORS {
                let factor = row.factors.get(at);
                cells.push(factor.map_or_else(String::new, |(name, _)| name.clone()));
                cells.push(
                    factor.map_or_else(String::new, |(_, share)| number(Some((share * 1e6).round() / 1e6))),
                );
            }
            cells.extend([number(Some(prediction.view_m2)), prediction.counts[0].to_string(), String::new()]);
            all.push(cells);
        }
    }
    debug_assert!(all.iter().all(|row| row.len() == header.len()));
    (header, all)
}

/// What a value of an axis does to a quantity.
#[derive(Clone, Debug, PartialEq)]
pub struct Effect {
    /// Which axis, and which of its values.
    pub axis: usize,
    /// See `axis`.
    pub value: usize,
    /// For each quantity the geometric mean, over all other axes and all vehicles, of the expected standard deviation
    /// at this value over that at the first; `None` where one of them is not determined.
    pub ratios: [Option<f64>; 6],
}

/// What each value of each axis does by itself, all others being equal.
pub fn effects(study: &Study, outcomes: &[Outcome]) -> Vec<Effect> {
    let cells = study.cells();
    let number: HashMap<&Cell, usize> = cells.iter().zip(0..).collect();
    let mut all = Vec::new();
    for axis in 0..study.axes.len() {
        for value in 1..study.axes[axis].values.len() {
            let pairs: Vec<(usize, usize)> = cells
                .iter()
                .enumerate()
                .filter(|(_, cell)| cell.values[axis] == value)
                .filter_map(|(at, cell)| {
                    let mut first = cell.clone();
                    first.values[axis] = 0;
                    Some((at, *number.get(&first)?))
                })
                .collect();
            let ratios = std::array::from_fn(|quantity| {
                let (mut sum, mut count) = (0.0, 0_usize);
                for (at, first) in &pairs {
                    let (Ok(here), Ok(there)) = (&outcomes[*at].prediction, &outcomes[*first].prediction)
                    else {
                        continue;
                    };
                    for (a, b) in here.sigmas.iter().zip(&there.sigmas) {
                        sum += (a[quantity] / b[quantity]).ln();
                        count += 1;
                    }
                }
                let mean = (sum / count as f64).exp();
                (count > 0 && mean.is_finite() && mean > 0.0).then_some(mean)
            });
            all.push(Effect { axis, value, ratios });
        }
    }
    all
}
