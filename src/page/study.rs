//! The page of a study or of a plan.

use super::content::{Block, Grid, GridCell, GridRow, Headline, Section, Table};
use super::figure::{Figure, Layer, colour};
use super::{Told, render};
use crate::diagnose::Quantity;
use crate::report::StudyReport;
use crate::study::plan::Choice;
use crate::study::summary::{Row, effects, name, rows, without_result};
use crate::study::{Cell, Study, told};
use crate::words::format::{FIXED_SPACE, decimal, percent_of};
use std::collections::HashMap;

/// So many grids of one quantity are shown; the others are in the table.
const MOST_GRIDS: usize = 12;
/// So many curves are drawn.
const MOST_PANELS: usize = 6;
/// So many rows of main factors are shown.
const MOST_FACTORS: usize = 120;
/// From the palest to the darkest there is at least a factor of two, as a logarithm: what is nearly the same looks so.
const LEAST_RANGE: f64 = std::f64::consts::LN_2;
/// A ratio of observed to expected beyond these is said not to hold.
const HONEST: [f64; 2] = [0.9, 1.1];

const STUDY: Told = Told {
    kind: "study",
    about: "What standard deviations an adjustment will have, from the covariance at the true state, and what was observed.",
    footer: "Standard deviations are root mean squares over the film, of a track both coordinates together, of a shape all three, over the half of its points that are known best.",
};
const PLAN: Told = Told {
    kind: "plan",
    about: "Which flights reach the wanted accuracy, and the cheapest of them.",
    footer: STUDY.footer,
};

/// By what a standard deviation is multiplied for people, and its unit then.
fn in_units(quantity: Quantity) -> (f64, &'static str) {
    match quantity {
        Quantity::TrackPlan | Quantity::TrackHeight | Quantity::Shape => (100.0, "cm"),
        Quantity::Speed => (1.0, "m/s"),
        Quantity::Heading => (1.0, "deg"),
        Quantity::Scale => (100.0, "%"),
    }
}

/// A standard deviation with its unit.
fn shown(quantity: Quantity, value: f64) -> String {
    if value.is_infinite() {
        return "not determined".to_owned();
    }
    let (factor, unit) = in_units(quantity);
    let value = factor * value;
    let digits = match unit {
        "cm" if value < 9.95 => 2,
        "cm" => 1,
        _ => 3,
    };
    format!("{}\u{a0}{}", decimal(value, digits), if unit == "deg" { "\u{b0}" } else { unit })
}

/// The page.
pub fn study_page(page: &StudyReport) -> String {
    let view = View::new(page);
    let mut sections = Vec::new();
    let (told, headlines) = match page.plan {
        Some((choices, cheapest)) => {
            sections.push(view.plan_section(choices, cheapest));
            (&PLAN, view.plan_headlines(choices, cheapest))
        }
        None => (&STUDY, view.headlines()),
    };
    if page.study.runs > 0 {
        sections.push(view.monte_carlo());
    }
    if page.study.axes.len() > 1 {
        sections.push(view.effects());
    }
    for quantity in Quantity::ALL {
        sections.push(view.quantity(quantity));
    }
    sections.push(view.factors());
    sections.push(view.inputs());
    let title = if page.study.title.is_empty() { &page.study.name } else { &page.study.title };
    render(title, told, &headlines, &sections)
}

struct View<'a> {
    page: &'a StudyReport<'a>,
    cells: Vec<Cell>,
    rows: Vec<Row>,
    /// Where the row of a cell, a vehicle and a quantity is.
    places: HashMap<(usize, usize, &'static str), usize>,
    planes: Vec<Plane>,
}

/// A table of cells: down the first axis, across the second.
struct Plane {
    /// What is the same in all of it.
    told: String,
    scenario: usize,
    /// Numbers of its cells.
    cells: Vec<Vec<usize>>,
}

/// All planes, one for each scenario and combination of values of the axes beyond the second.
fn planes(study: &Study, cells: &[Cell]) -> Vec<Plane> {
    let down = study.axes.first().map_or(1, |axis| axis.values.len());
    let mut planes: Vec<Plane> = Vec::new();
    let mut place_of: HashMap<(usize, &[usize]), usize> = HashMap::new();
    for (number, cell) in cells.iter().enumerate() {
        let beyond = cell.values.get(2..).unwrap_or_default();
        let at = *place_of.entry((cell.scenario, beyond)).or_insert_with(|| {
            let mut parts = Vec::new();
            if study.scenarios.len() > 1 || study.axes.is_empty() {
                parts.push(study.scenarios[cell.scenario].name.clone());
            }
            for (axis, at) in study.axes.iter().skip(2).zip(beyond) {
                parts.push(format!("{} = {}", axis.label, told(&axis.values[*at])));
            }
            let told = parts.join(", ");
            planes.push(Plane { told, scenario: cell.scenario, cells: vec![Vec::new(); down] });
            planes.len() - 1
        });
        planes[at].cells[cell.values.first().copied().unwrap_or(0)].push(number);
    }
    planes
}

impl<'a> View<'a> {
    fn new(page: &'a StudyReport<'a>) -> Self {
        let (cells, rows) = (page.study.cells(), rows(page.outcomes));
        let places = rows.iter().map(|row| (row.cell, row.vehicle, row.quantity)).zip(0..).collect();
        let planes = planes(page.study, &cells);
        View { page, cells, rows, places, planes }
    }

    /// Ids of the vehicles of a scenario.
    fn vehicles(&self, scenario: usize) -> &'a [String] {
        &self.page.study.scenarios[scenario].vehicles
    }

    /// How many there are in the scenario with the most.
    fn most_vehicles(&self) -> usize {
        self.page.study.scenarios.iter().map(|scenario| scenario.vehicles.len()).max().unwrap_or(0)
    }

    fn sigma(&self, cell: usize, vehicle: usize, quantity: Quantity) -> Option<f64> {
        let prediction = self.page.outcomes[cell].prediction.as_ref().ok()?;
        Some(prediction.sigmas[vehicle][quantity as usize])
    }

    fn row(&self, cell: usize, vehicle: usize, quantity: &'static str) -> Option<&Row> {
        self.places.get(&(cell, vehicle, quantity)).map(|at| &self.rows[*at])
    }

    fn axis_label(&self, at: usize) -> String {
        self.page.study.axes.get(at).map_or_else(String::new, |axis| axis.label.clone())
    }

    /// A grid of a plane; `cell` says what stands in each.
    fn grid(&self, plane: &Plane, caption: String, cell: &dyn Fn(usize) -> GridCell) -> Block {
        let study = self.page.study;
        let value =
            |axis: usize, at: usize| study.axes.get(axis).map_or_else(String::new, |a| told(&a.values[at]));
        let across = study.axes.get(1).map_or(1, |axis| axis.values.len());
        let corner = match study.axes.len() {
            0 => String::new(),
            1 => self.axis_label(0),
            _ => format!("{} \\ {}", self.axis_label(0), self.axis_label(1)),
        };
        let row = |(at, cells): (usize, &Vec<usize>)| GridRow {
            label: value(0, at),
            cells: cells.iter().map(|number| cell(*number)).collect(),
        };
        Block::Grid(Grid {
            caption,
            corner,
            head: (0..across).map(|at| value(1, at)).collect(),
            rows: plane.cells.iter().enumerate().map(row).collect(),
        })
    }

    fn caption(&self, plane: &Plane, vehicle: usize, what: &str) -> String {
        let vehicles = self.vehicles(plane.scenario);
        let mut parts = vec![what.to_owned()];
        if vehicles.len() > 1 {
            parts.push(vehicles[vehicle].clone());
        }
        if !plane.told.is_empty() {
            parts.push(plane.told.clone());
        }
        parts.join("; ")
    }

    /// Planes and vehicles that are shown.
    fn shown(&self) -> (Vec<(&Plane, usize)>, usize) {
        let mut all: Vec<(&Plane, usize)> = Vec::new();
        for vehicle in 0..self.most_vehicles() {
            let planes = self.planes.iter().filter(|p| vehicle < self.vehicles(p.scenario).len());
            all.extend(planes.map(|plane| (plane, vehicle)));
        }
        let left = all.len().saturating_sub(MOST_GRIDS);
        all.truncate(MOST_GRIDS);
        (all, left)
    }

    fn quantity(&self, quantity: Quantity) -> Section {
        let [id, _, words, title] = name(quantity);
        let mut section = Section::new(id, title);
        let (planes, left) = self.shown();
        let all = planes.iter().flat_map(|(plane, vehicle)| {
            plane.cells.iter().flatten().filter_map(|cell| self.sigma(*cell, *vehicle, quantity))
        });
        let finite: Vec<f64> = all.filter(|v| v.is_finite() && *v > 0.0).collect();
        let least = finite.iter().copied().fold(f64::INFINITY, f64::min).ln();
        let most = finite.iter().copied().fold(0.0, f64::max).ln();
        for (plane, vehicle) in &planes {
            let cell = |number: usize| {
                let Some(sigma) = self.sigma(number, *vehicle, quantity) else {
                    let why =
                        self.page.outcomes[number].prediction.as_ref().err().cloned().unwrap_or_default();
                    return GridCell::shaded("\u{2013}".to_owned(), why, None);
                };
                let share = sigma.is_finite().then(|| (sigma.ln() - least) / (most - least).max(LEAST_RANGE));
                let more =
                    self.row(number, *vehicle, id).map_or_else(String::new, |row| factors_told(&row.factors));
                GridCell::shaded(shown(quantity, sigma), more, share)
            };
            let caption =
                self.caption(plane, *vehicle, &format!("Expected standard deviation of the {words}"));
            section.blocks.push(self.grid(plane, caption, &cell));
        }
        if left > 0 {
            section.empty(format!("{left} more tables of this kind are in cells.csv."));
        }
        let panels: Vec<(String, Figure)> = planes
            .iter()
            .flat_map(|(plane, vehicle)| self.curves(plane, *vehicle, quantity))
            .take(MOST_PANELS)
            .collect();
        if !panels.is_empty() {
            let panels: Vec<(&str, Figure)> =
                panels.iter().map(|(label, f)| (label.as_str(), f.clone())).collect();
            let observed =
                if self.page.study.runs > 0 { "; dots: observed root mean square errors" } else { "" };
            section.figures(format!("Curves of the {words}"), format!("Line: expected{observed}."), &panels);
        }
        section
    }

    /// A curve for each column of a plane, where the first axis is of numbers.
    fn curves(&self, plane: &Plane, vehicle: usize, quantity: Quantity) -> Vec<(String, Figure)> {
        let study = self.page.study;
        let Some(first) = study.axes.first() else { return Vec::new() };
        let number = |value: &crate::simulate::Value| {
            value.as_float().or_else(|| value.as_integer().map(|whole| whole as f64))
        };
        let Some(xs) = first.values.iter().map(number).collect::<Option<Vec<f64>>>() else {
            return Vec::new();
        };
        if xs.len() < 2 {
            return Vec::new();
        }
        let [id, ..] = name(quantity);
        let (factor, unit) = in_units(quantity);
        let columns = plane.cells.first().map_or(0, Vec::len);
        let mut order: Vec<usize> = (0..xs.len()).collect();
        order.sort_by(|a, b| xs[*a].total_cmp(&xs[*b]));
        let one = |column: usize| {
            let points = |of: &dyn Fn(usize) -> Option<f64>| -> Vec<[f64; 2]> {
                let value = |at: usize| of(plane.cells[at][column]).map_or(f64::NAN, |v| factor * v);
                order.iter().map(|at| [xs[*at], value(*at)]).collect()
            };
            let line = points(&|cell| self.sigma(cell, vehicle, quantity));
            let dots = points(&|cell| self.row(cell, vehicle, id).and_then(|row| row.observed));
            if line.iter().filter(|p| p[1].is_finite()).count() < 2 {
                return None;
            }
            let mut label = study
                .axes
                .get(1)
                .map_or_else(String::new, |a| format!("{} = {}", a.label, told(&a.values[column])));
            if !plane.told.is_empty() {
                label =
                    if label.is_empty() { plane.told.clone() } else { format!("{label}, {}", plane.told) };
            }
            let [_, _, words, _] = name(quantity);
            let mut figure =
                Figure::new(format!("{words} {label}"), first.label.clone(), format!("{words} [{}]", unit));
            let highest =
                line.iter().chain(&dots).map(|p| p[1]).filter(|v| v.is_finite()).fold(0.0, f64::max);
            figure.y_range = Some([0.0, 1.06 * highest.max(1e-9)]);
            figure.layers.push(Layer::Line {
                points: line,
                colour: colour::RESULT,
                width: 4,
                label: "expected",
            });
            if dots.iter().any(|p| p[1].is_finite()) {
                figure.layers.push(Layer::Dots {
                    points: dots,
                    colour: colour::REFERENCE,
                    radius: 8,
                    label: "observed",
                });
            }
            Some((label, figure))
        };
        (0..columns).filter_map(one).collect()
    }

    fn monte_carlo(&self) -> Section {
        let mut section = Section::new("monte-carlo", "Does it hold? Monte Carlo");
        section.text(format!(
            "Each cell was simulated {} times with every error drawn anew, and adjusted as a user would. Observed root \
             mean square error over expected standard deviation, with its 95 % interval. Where the interval lies \
             outside {} to {} the cell has a frame: there the model does not hold.",
            self.page.study.runs, HONEST[0], HONEST[1]
        ));
        let failed = without_result(self.page.outcomes);
        if failed > 0 {
            section.empty(format!("{failed} runs gave no result and are not among them."));
        }
        let study = self.page.study;
        let mut head = vec!["cell".to_owned()];
        head.extend(Quantity::ALL.map(|quantity| name(quantity)[2].to_owned()));
        let vehicles = self.most_vehicles();
        for vehicle in 0..vehicles {
            let mut rows = Vec::new();
            for (number, cell) in self.cells.iter().enumerate() {
                let Some(id) = self.vehicles(cell.scenario).get(vehicle) else { continue };
                let cells = Quantity::ALL.map(|quantity| {
                    let ratio = self.row(number, vehicle, name(quantity)[0]).and_then(|row| row.ratio);
                    let Some([ratio, low, high]) = ratio else {
                        return GridCell::shaded("\u{2013}".to_owned(), String::new(), None);
                    };
                    let text =
                        format!("{} ({}\u{2013}{})", decimal(ratio, 2), decimal(low, 2), decimal(high, 2));
                    let mut cell =
                        GridCell::shaded(text, String::new(), Some((ratio.ln().abs() / 0.5).min(1.0)));
                    cell.marked = high < HONEST[0] || low > HONEST[1];
                    cell
                });
                let mut label = study.told(cell);
                if vehicles > 1 {
                    label = format!("{label}, {id}");
                }
                rows.push(GridRow { label, cells: cells.to_vec() });
            }
            let caption = "Observed over expected".to_owned();
            section.blocks.push(Block::Grid(Grid {
                caption,
                corner: head[0].clone(),
                head: head[1..].to_vec(),
                rows,
            }));
        }
        let shares: Vec<&Row> = self.rows.iter().filter(|row| row.unit == "share").collect();
        if !shares.is_empty() {
            let mut table = Table::new(
                "Points of the shape near their true places, and near the scan that they were sampled from: mean share over the runs, and its standard deviation",
                &["cell", "vehicle", "within", "share", "spread"],
            );
            for row in shares {
                let percent = |v: Option<f64>| v.map_or_else(String::new, |v| percent_of(v, 1, FIXED_SPACE));
                let cell = &self.cells[row.cell];
                table.row([
                    study.told(cell),
                    self.vehicles(cell.scenario)[row.vehicle].clone(),
                    row.quantity.trim_start_matches("within_").replace('_', " "),
                    percent(row.observed),
                    percent(row.spread),
                ]);
            }
            section.table(table);
        }
        section
    }

    fn effects(&self) -> Section {
        let mut section = Section::new("effects", "What each parameter does");
        section.text(
            "Expected standard deviation at a value over that at the first value of its axis, all others being equal: \
             geometric mean over all of them.",
        );
        let mut head = vec!["value over first".to_owned()];
        head.extend(Quantity::ALL.map(|quantity| name(quantity)[2].to_owned()));
        let rows = effects(self.page.study, self.page.outcomes).into_iter().map(|effect| {
            let axis = &self.page.study.axes[effect.axis];
            let cells = effect.ratios.map(|ratio| {
                let text = ratio.map_or_else(|| "\u{2013}".to_owned(), |ratio| decimal(ratio, 2));
                GridCell::shaded(text, String::new(), ratio.map(|ratio| ratio.log2().abs() / 2.0))
            });
            let (value, first) = (told(&axis.values[effect.value]), told(&axis.values[0]));
            GridRow { label: format!("{}: {value} over {first}", axis.label), cells: cells.to_vec() }
        });
        let rows = rows.collect();
        let caption = "1 is no effect; the darker, the larger".to_owned();
        section.blocks.push(Block::Grid(Grid {
            caption,
            corner: head[0].clone(),
            head: head[1..].to_vec(),
            rows,
        }));
        section
    }

    fn factors(&self) -> Section {
        let mut section = Section::new("factors", "Where variance comes from");
        section.text(
            "Where the variance of a quantity comes from: the three largest shares. What would have to be better to \
             gain something stands first.",
        );
        let mut table = Table::new("", &["cell", "vehicle", "quantity", "main factors"]);
        let told: Vec<&Row> = self.rows.iter().filter(|row| !row.factors.is_empty()).collect();
        for row in told.iter().take(MOST_FACTORS) {
            let cell = &self.cells[row.cell];
            table.row([
                self.page.study.told(cell),
                self.vehicles(cell.scenario)[row.vehicle].clone(),
                row.quantity.replace('_', " "),
                factors_told(&row.factors),
            ]);
        }
        section.table(table);
        if told.len() > MOST_FACTORS {
            section.empty(format!("{} more rows are in cells.csv.", told.len() - MOST_FACTORS));
        }
        section
    }

    fn inputs(&self) -> Section {
        let mut section = Section::new("inputs", "What it was made of");
        section.text(format!("Command: {}", self.page.command));
        for axis in &self.page.study.axes {
            let values: Vec<String> = axis.values.iter().map(told).collect();
            section.text(format!("{} ({}): {}", axis.label, axis.parameter, values.join(", ")));
        }
        for (number, outcome) in self.page.outcomes.iter().enumerate() {
            if let Err(why) = &outcome.prediction {
                section.empty(format!("{}: {why}", self.page.study.told(&self.cells[number])));
            }
        }
        section
    }

    fn headlines(&self) -> Vec<Headline> {
        let of = |quantity: Quantity, title: &str| {
            let all = (0..self.cells.len()).filter_map(|cell| self.sigma(cell, 0, quantity));
            let finite: Vec<f64> = all.filter(|v| v.is_finite()).collect();
            let least = finite.iter().copied().fold(f64::INFINITY, f64::min);
            let most = finite.iter().copied().fold(0.0, f64::max);
            let value = if finite.is_empty() {
                "not determined".to_owned()
            } else {
                format!("{} to {}", shown(quantity, least), shown(quantity, most))
            };
            Headline {
                name: title.to_owned(),
                value,
                meaning: "expected standard deviation".to_owned(),
                more: format!("{} of {} cells", finite.len(), self.cells.len()),
                link: name(quantity)[0],
            }
        };
        vec![
            of(Quantity::TrackPlan, "Track in the plan"),
            of(Quantity::Speed, "Speed"),
            of(Quantity::Shape, "Shape"),
        ]
    }

    fn plan_headlines(&self, choices: &[Choice], cheapest: Option<usize>) -> Vec<Headline> {
        let feasible = choices.iter().filter(|choice| choice.is_feasible()).count();
        let mut all = vec![Headline {
            name: "Flights that reach it".to_owned(),
            value: format!("{feasible} of {}", choices.len()),
            meaning: "all wanted standard deviations are expected".to_owned(),
            more: String::new(),
            link: "plan",
        }];
        let (value, more) = match cheapest {
            Some(cell) => {
                (self.values_told(cell), format!("view {} m\u{b2}", decimal(choices[cell].view_m2, 0)))
            }
            None => ("none".to_owned(), "the nearest stand first in plan.csv".to_owned()),
        };
        let meaning = "largest view, then fewest targets, then fewest points".to_owned();
        all.push(Headline { name: "The cheapest".to_owned(), value, meaning, more, link: "plan" });
        all
    }

    fn values_told(&self, cell: usize) -> String {
        let axes = self.page.study.axes.iter().zip(&self.cells[cell].values);
        let parts: Vec<String> =
            axes.map(|(axis, at)| format!("{} {}", axis.label, told(&axis.values[*at]))).collect();
        if parts.is_empty() { self.page.study.told(&self.cells[cell]) } else { parts.join(", ") }
    }

    fn plan_section(&self, choices: &[Choice], cheapest: Option<usize>) -> Section {
        let mut section = Section::new("plan", "What reaches the wanted accuracy");
        let wanted = self.page.study.wanted.unwrap_or_default().limits();
        let told: Vec<String> = wanted
            .iter()
            .zip(Quantity::ALL)
            .filter_map(|(limit, quantity)| {
                Some(format!("{} {}", name(quantity)[2], shown(quantity, (*limit)?)))
            })
            .collect();
        section.strong(format!("Wanted: {}", told.join(", ")));
        for plane in self.planes.iter().take(MOST_GRIDS) {
            let cell = |number: usize| {
                let choice = &choices[number];
                let (ratio, quantity) = choice.worst;
                let text = match ratio {
                    ratio if ratio.is_infinite() => "\u{2013}".to_owned(),
                    _ => format!(
                        "{}{}",
                        decimal(ratio, 2),
                        if choice.is_feasible() { " \u{2713}" } else { "" }
                    ),
                };
                let share = ratio.is_finite().then(|| (0.5 + ratio.log2() / 4.0).clamp(0.0, 1.0));
                let mut cell = GridCell::shaded(text, format!("worst: {}", name(quantity)[2]), share);
                cell.marked = Some(number) == cheapest;
                cell
            };
            let what = "Worst expected standard deviation over the wanted one; a tick where all is reached, a frame around the cheapest";
            section.blocks.push(self.grid(plane, self.caption(plane, 0, what), &cell));
        }
        let points = |is: bool| -> Vec<[f64; 2]> {
            let those = choices
                .iter()
                .filter(|c| c.is_feasible() == is && c.worst.0.is_finite() && c.view_m2.is_finite());
            those.map(|choice| [choice.view_m2, choice.worst.0.min(4.0)]).collect()
        };
        let mut figure = Figure::new("view and accuracy", "view [m^2]", "worst over wanted");
        for (is, colour, label) in
            [(true, colour::RESULT, "reaches it"), (false, colour::OTHER, "does not (4 and more at 4)")]
        {
            figure.layers.push(Layer::Dots { points: points(is), colour, radius: 7, label });
        }
        figure.layers.push(Layer::Level(1.0));
        figure.y_range = Some([0.0, 4.2]);
        section.figures(
            "View and accuracy",
            "Each flight by what an image shows of the ground.",
            &[("", figure)],
        );
        section
    }
}

fn factors_told(factors: &[(String, f64)]) -> String {
    let largest = factors.iter().take(3).filter(|(_, share)| *share >= 0.005);
    let told: Vec<String> =
        largest.map(|(name, share)| format!("{name} {:.0}\u{a0}%", 100.0 * share)).collect();
    told.join(", ")
}
