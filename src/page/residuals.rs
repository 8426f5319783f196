//! Image residuals before and after: scatter, histogram, over the image, over time.

use super::content::{Section, Table};
use super::figure::{Figure, Layer, colour};
use crate::files::{ResultResidual, ResultResiduals};
use crate::problem::{Problem, Role};
use crate::stats::quantile::quantile;
use crate::words::format::decimal;
use nalgebra::Vector2;
use std::collections::BTreeMap;

/// Root mean square of the coordinates of residuals; `None` without any.
pub fn rms_px<'a>(residuals: impl Iterator<Item = &'a ResultResidual>) -> Option<f64> {
    let (mut sum, mut count) = (0.0, 0_usize);
    for r in residuals {
        sum += r.residual_px.norm_squared();
        count += 2;
    }
    (count > 0).then(|| (sum / count as f64).sqrt())
}

/// The section. `start` and `end` are `None` where the result has no such table.
pub fn section(problem: &Problem, start: Option<&ResultResiduals>, end: Option<&ResultResiduals>) -> Section {
    let mut section = Section::new("residuals", "Image residuals before and after");
    let Some(end) = end.filter(|end| end.all().next().is_some()) else {
        section.empty("The result has no residuals of this problem (residuals.csv).");
        return section;
    };
    if start.is_none() {
        section.empty("What the residuals were before is not known: the result has no residuals_start.csv.");
    }
    // What is rejected at the end is no measure of either.
    let good: Vec<&ResultResidual> = end.all().filter(|r| r.is_accepted()).collect();
    let of_start = start.into_iter().flat_map(|start| start.each().zip(end.each()));
    let before: Vec<&ResultResidual> = of_start
        .filter_map(|(before, end)| before.filter(|_| end.is_some_and(ResultResidual::is_accepted)))
        .collect();
    section.text(format!(
        "{} image points took part at the end, {} were rejected as gross errors or belong to check points; before and after are of the former. Residuals are observed minus computed.",
        good.len(),
        end.all().count() - good.len()
    ));
    let mut table =
        Table::new("Root mean square of a coordinate", &["of", "image points", "before", "after"]);
    for (name, is_target) in [("vehicles", false), ("targets", true)] {
        let of =
            |all: &[&ResultResidual]| rms_px(all.iter().copied().filter(|r| r.target.is_some() == is_target));
        let show =
            |value: Option<f64>| value.map_or("\u{2013}".to_owned(), |v| format!("{} px", decimal(v, 2)));
        let count = good.iter().filter(|r| r.target.is_some() == is_target).count();
        table.row([name.to_owned(), count.to_string(), show(of(&before)), show(of(&good))]);
    }
    section.table(table);
    let panels = |draw: &dyn Fn(&[&ResultResidual]) -> Figure| {
        let mut panels = Vec::new();
        if !before.is_empty() {
            panels.push(("before", draw(&before)));
        }
        panels.push(("after", draw(&good)));
        panels
    };
    section.figures(
        "Figure A",
        "Residuals in u and v; darker where there are more. The axes of the two panels differ; 1 % of the residuals lie outside.",
        &panels(&scatter),
    );
    section.figures(
        "Figure B",
        "Distribution of the coordinates of the residuals, u and v together.",
        &panels(&histogram),
    );
    section.figures(
        "Figure C",
        "Mean residual over the image, enlarged so that the longest arrow is one cell long. A pattern would speak of the interior orientation.",
        &panels(&|all| over_image(problem, all)),
    );
    section.figures(
        "Figure D",
        "Root mean square residual of each frame over time.",
        &panels(&|all| over_time(problem, all)),
    );
    section
}

/// The coordinate that 99 % do not exceed \[px\].
fn reach_px(all: &[&ResultResidual]) -> f64 {
    let coordinates = all.iter().flat_map(|r| [r.residual_px.x.abs(), r.residual_px.y.abs()]).collect();
    quantile(coordinates, 0.99).unwrap_or(1.0).max(1e-6)
}

const CELLS: usize = 44;

fn scatter(all: &[&ResultResidual]) -> Figure {
    let reach = reach_px(all);
    let mut counts = vec![0_usize; CELLS * CELLS];
    let place = |value: f64| {
        let at = ((value / reach + 1.0) * 0.5 * CELLS as f64).floor();
        (at >= 0.0 && at < CELLS as f64).then_some(at as usize)
    };
    for r in all {
        if let (Some(x), Some(y)) = (place(r.residual_px.x), place(r.residual_px.y)) {
            counts[y * CELLS + x] += 1;
        }
    }
    let most = counts.iter().copied().max().unwrap_or(1).max(1) as f64;
    let edge = |at: usize| reach * (2.0 * at as f64 / CELLS as f64 - 1.0);
    let cells = (0..CELLS * CELLS).filter(|at| counts[*at] > 0).map(|at| {
        let (x, y) = (at % CELLS, at / CELLS);
        // By the root, so that single ones still show.
        let share = 0.08 + 0.92 * (counts[at] as f64 / most).sqrt();
        [edge(x), edge(x + 1), edge(y), edge(y + 1), share]
    });
    let mut figure = Figure::new("Scatter of image residuals", "du (px)", "dv (px)");
    figure.layers = vec![Layer::Cells(cells.collect()), Layer::Level(0.0), Layer::Upright(0.0)];
    (figure.x_range, figure.y_range) = (Some([-reach, reach]), Some([-reach, reach]));
    figure.is_map = true;
    figure.aspect = 0.8;
    figure
}

fn histogram(all: &[&ResultResidual]) -> Figure {
    const BINS: usize = 60;
    let reach = 1.3 * reach_px(all);
    let mut counts = [0_usize; BINS];
    for value in all.iter().flat_map(|r| [r.residual_px.x, r.residual_px.y]) {
        let at = ((value / reach + 1.0) * 0.5 * BINS as f64).floor();
        if at >= 0.0 && at < BINS as f64 {
            counts[at as usize] += 1;
        }
    }
    let edge = |at: usize| reach * (2.0 * at as f64 / BINS as f64 - 1.0);
    let bars = counts.iter().enumerate().map(|(at, count)| [edge(at), edge(at + 1), *count as f64]).collect();
    let mut figure = Figure::new("Distribution of image residuals", "du, dv (px)", "coordinates per bin");
    figure.layers.push(Layer::Bars { bars, colour: colour::RESULT, hollow: false, label: "residuals" });
    if let Some(sigma) = rms_px(all.iter().copied()) {
        let area = 2.0 * all.len() as f64 * (edge(1) - edge(0));
        let normal = |x: f64| {
            area / (sigma * (2.0 * std::f64::consts::PI).sqrt()) * (-0.5 * (x / sigma).powi(2)).exp()
        };
        let points =
            (0..=240).map(|at| reach * (f64::from(at) / 120.0 - 1.0)).map(|x| [x, normal(x)]).collect();
        figure.layers.push(Layer::Line {
            points,
            colour: colour::REFERENCE,
            width: 4,
            label: "normal, same rms",
        });
    }
    figure.x_range = Some([-reach, reach]);
    figure.aspect = 0.6;
    figure
}

fn over_image(problem: &Problem, all: &[&ResultResidual]) -> Figure {
    const COLUMNS: usize = 16;
    const MOST_ROWS: usize = 64;
    let [width, height] = problem.camera.size_px.map(f64::from);
    // Whatever the shape of the image, there are not many of them.
    let size = (width / COLUMNS as f64).max(height / MOST_ROWS as f64);
    let rows = (height / size).ceil().max(1.0) as usize;
    let mut sums = vec![(Vector2::<f64>::zeros(), 0_usize); COLUMNS * rows];
    for r in all {
        let (x, y) = ((r.image_px.x / size).floor(), (r.image_px.y / size).floor());
        if x >= 0.0 && y >= 0.0 && (x as usize) < COLUMNS && (y as usize) < rows {
            let sum = &mut sums[y as usize * COLUMNS + x as usize];
            *sum = (sum.0 + r.residual_px, sum.1 + 1);
        }
    }
    // A mean of few is mostly noise.
    let means: Vec<(usize, Vector2<f64>)> = (0..sums.len())
        .filter(|at| sums[*at].1 >= 20)
        .map(|at| (at, sums[at].0 / sums[at].1 as f64))
        .collect();
    let longest = means.iter().map(|(_, mean)| mean.norm()).fold(0.0, f64::max);
    let factor = if longest > 0.0 { size / longest } else { 1.0 };
    let arrow = |(at, mean): &(usize, Vector2<f64>)| {
        let from = [((at % COLUMNS) as f64 + 0.5) * size, ((at / COLUMNS) as f64 + 0.5) * size];
        [from, [from[0] + factor * mean.x, from[1] + factor * mean.y]]
    };
    let mut figure = Figure::new(
        "Mean image residual over the image",
        format!("u (px); the longest arrow is {} px", decimal(longest, 2)),
        "v (px)",
    );
    figure.layers.push(Layer::Arrows(means.iter().map(arrow).collect()));
    (figure.x_range, figure.y_range) = (Some([0.0, width]), Some([0.0, height]));
    figure.is_map = true;
    figure.y_down = true;
    figure.aspect = 0.7;
    figure
}

fn over_time(problem: &Problem, all: &[&ResultResidual]) -> Figure {
    let mut figure = Figure::new("Root mean square residual over time", "time (s)", "rms of a frame (px)");
    let mut highest = 0.0_f64;
    for (is_target, colour, label) in
        [(true, colour::REFERENCE, "targets"), (false, colour::RESULT, "vehicles")]
    {
        let mut frames: BTreeMap<usize, (f64, usize)> = BTreeMap::new();
        for r in all.iter().filter(|r| r.target.is_some() == is_target) {
            let sum = frames.entry(r.frame).or_default();
            *sum = (sum.0 + r.residual_px.norm_squared(), sum.1 + 2);
        }
        if frames.is_empty() {
            continue;
        }
        let mut points: Vec<[f64; 2]> = Vec::with_capacity(problem.frames.len());
        for (at, frame) in problem.frames.iter().enumerate() {
            let value = frames.get(&at).map_or(f64::NAN, |(sum, count)| (sum / *count as f64).sqrt());
            highest = highest.max(value);
            points.push([frame.time_s, value]);
        }
        let width = if is_target { 3 } else { 2 };
        figure.layers.push(Layer::Line { points, colour, width, label });
    }
    // From zero, with room for the legend.
    figure.y_range = (highest > 0.0).then_some([0.0, 1.25 * highest]);
    figure.aspect = 0.6;
    figure
}

/// Image residuals of each control target and tie point at the end.
pub fn by_target(problem: &Problem, end: &ResultResiduals) -> Table {
    let mut table = Table::new(
        "Image points of targets",
        &["target", "role", "image points", "rejected", "mean du", "mean dv", "rms of a coordinate"],
    );
    for (at, target) in problem.targets.iter().enumerate() {
        let own: Vec<&ResultResidual> = end.all().filter(|r| r.target == Some(at)).collect();
        if own.is_empty() {
            continue;
        }
        let good: Vec<&ResultResidual> = own.iter().copied().filter(|r| r.is_accepted()).collect();
        let mean: Vector2<f64> =
            good.iter().map(|r| r.residual_px).sum::<Vector2<f64>>() / good.len().max(1) as f64;
        let px = |value: f64| format!("{} px", decimal(value, 2));
        let role = match target.role {
            Role::Check => "check",
            Role::Control if target.is_surveyed() => "control",
            Role::Control => "tie point",
        };
        table.row([
            target.id.clone(),
            role.to_owned(),
            own.len().to_string(),
            (own.len() - good.len()).to_string(),
            px(mean.x),
            px(mean.y),
            rms_px(good.into_iter()).map_or("\u{2013}".to_owned(), px),
        ]);
    }
    table
}
