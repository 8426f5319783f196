//! What `report.json` says, in words and tables: verdict, datum and scale, control, interior orientation.
//! What it does not say reads as a dash.

use super::content::{Block, Section, Table};
use crate::disk::InputFile;
use crate::problem::Problem;
use crate::report::{ParameterReport, Report, ScaleReport, Sigma};
use crate::words::format::{DASH, cm_or_dash, decimal, decimal_or_dash, percent_of, whole_or_dash};

fn or_dash(text: &str) -> String {
    if text.is_empty() { DASH.to_owned() } else { text.to_owned() }
}

/// The verdict in some ten lines.
pub fn verdict(report: &Report, warnings: &[String]) -> Section {
    let mut section = Section::new("verdict", "Verdict");
    match &report.verdict {
        Some(verdict) => {
            section.strong(format!("Can the result be trusted? {}.", or_dash(&verdict.trust)));
            let items = verdict.reasons.iter().chain(&verdict.facts).cloned().collect();
            section.blocks.push(Block::List { items });
        }
        None => {
            section.empty("The result has no verdict: it was not adjusted, or had no final least squares.")
        }
    }
    let mut all = report.warnings.clone();
    all.extend(warnings.iter().filter(|warning| !report.warnings.contains(warning)).cloned());
    if all.is_empty() {
        section.text("There are no warnings.");
    } else {
        section.heading("Warnings");
        section.blocks.push(Block::List { items: all });
    }
    section
}

/// What went in, and by which commands.
pub fn inputs(report: &Report, commands: [&str; 2], now: &[InputFile]) -> Section {
    let mut section = Section::new("inputs", "Inputs and commands");
    let mut table = Table::new("Commands", &["what", "command"]);
    table.row(["adjustment (PROBLEM is the problem folder; without places, and without options that change no number)".to_owned(), commands[0].to_owned()]);
    table.row(["this report".to_owned(), commands[1].to_owned()]);
    table.row(["program".to_owned(), format!("trackbundle {}", or_dash(&report.version))]);
    section.table(table);
    let mut table =
        Table::new("Files of the problem that were adjusted", &["file", "bytes", "SHA-256", "now"]);
    for file in &report.inputs {
        let state = match now.iter().find(|f| f.file == file.file) {
            Some(found) if found.sha256 == file.sha256 => "unchanged",
            Some(_) => "CHANGED since the adjustment",
            None => "not there any more",
        };
        let (name, digest) = (or_dash(&file.file), or_dash(&file.sha256));
        table.row([name, whole_or_dash(file.bytes), digest, state.to_owned()]);
    }
    if table.rows.is_empty() {
        section.empty("The result does not say which files it is from (it was written by an older version).");
    }
    section.table(table);
    section
}

/// Files of the problem that are no longer those of the result.
pub fn changed_inputs(report: &Report, now: &[InputFile]) -> Vec<String> {
    let is_as_now = |file: &str, sha256: &str| now.iter().any(|f| f.file == file && f.sha256 == sha256);
    let changed = report.inputs.iter().filter(|input| !is_as_now(&input.file, &input.sha256));
    changed.map(|input| input.file.clone()).collect()
}

/// What was adjusted, and what held the datum and the scale.
pub fn adjusted(report: &Report) -> Section {
    let mut section = Section::new("adjusted", "What was adjusted, and what held the datum and the scale");
    let mut table = Table::new("Adjustment", &["", ""]);
    report.facts().page_rows().into_iter().for_each(|(name, value)| table.row([name, value]));
    section.table(table);
    section.heading("Datum");
    add_datum(&mut section, report);
    section.heading("Scale");
    if report.scales.is_empty() {
        section.empty("The result does not say what determined the scale.");
    }
    report.scales.iter().for_each(|scale| section.table(of_scale(scale)));
    section
}

fn add_datum(section: &mut Section, report: &Report) {
    let Some(found) = &report.observability else {
        section.empty("The result does not say what its datum rests on.");
        return;
    };
    let [rank, unknowns, defect] = [found.rank, found.unknowns, found.defect].map(|n| whole_or_dash(Some(n)));
    section.text(format!("{rank} of {unknowns} unknowns are determined; {defect} are not."));
    let mut table = Table::new("Open or weak directions", &["direction", "class", "held by"]);
    for direction in &found.directions {
        let held_by = direction.held_by.as_deref().unwrap_or_default();
        table.row([direction.name.as_str(), &direction.class, held_by].map(or_dash));
    }
    section.table(table);
}

fn of_scale(scale: &ScaleReport) -> Table {
    let percent = |value: Option<f64>| value.map_or(DASH.to_owned(), |value| percent_of(value, 2, " "));
    let told = |sigma: Option<Sigma>| match sigma {
        Some(Sigma(sigma)) if sigma.is_infinite() => None,
        sigma => Some(percent(sigma.map(|sigma| sigma.0))),
    };
    let not_determined = || "not determined".to_owned();
    let sigma = told(scale.sigma).map_or_else(not_determined, |sigma| format!("standard deviation {sigma}"));
    let mut table = Table::new(
        format!("Scale of {}: {sigma}", or_dash(&scale.vehicle)),
        &["source", "share of the variance", "standard deviation without it"],
    );
    let mut shares: Vec<(&String, Option<f64>)> = scale.shares.iter().map(|(s, share)| (s, *share)).collect();
    shares.sort_by(|a, b| b.1.unwrap_or(0.0).total_cmp(&a.1.unwrap_or(0.0)));
    for (source, share) in shares {
        let without = told(scale.sigma_without.get(source).copied()).unwrap_or_else(not_determined);
        table.row([source.clone(), percent(share), without]);
    }
    table
}

/// Check points; control points are told by their image residuals.
pub fn check_points(section: &mut Section, report: &Report) {
    let mut table = Table::new(
        "Check points, result minus survey",
        &["target", "dx", "dy", "dz", "sigma x", "sigma y", "sigma z", "probability"],
    );
    for check in &report.check_points {
        let lengths = [check.dx, check.dy, check.dz, check.sigma_dx, check.sigma_dy, check.sigma_dz];
        let [dx, dy, dz, sigma_dx, sigma_dy, sigma_dz] = lengths.map(cm_or_dash);
        let (target, probability) = (or_dash(&check.target), decimal_or_dash(check.probability, 3));
        table.row([target, dx, dy, dz, sigma_dx, sigma_dy, sigma_dz, probability]);
    }
    if table.rows.is_empty() {
        section.empty("There are no check points: no target has the role \"check\".");
    }
    section.table(table);
}

/// The interior orientation, and whatever else was adjusted beside poses and points.
pub fn interior(report: &Report, problem: Option<&Problem>) -> Section {
    let mut section = Section::new("interior", "Interior orientation, and other numbers");
    if let Some(problem) = problem {
        section.table(of_camera(report, problem));
    }
    let mut table = Table::new(
        "Numbers adjusted beside poses and points",
        &["number", "before", "adjusted", "sigma", "effect on the shape", "correlations beyond 0.95"],
    );
    report.estimated.iter().for_each(|number| table.row(of_number(number)));
    if table.rows.is_empty() {
        section.empty("No number was adjusted beside poses and points: the interior orientation is held as calibrated, and has no correlations.");
    }
    section.table(table);
    let mut table = Table::new(
        "Tests of numbers that are held",
        &["number", "held at", "if it were free", "sigma", "rejected at 0.1 %"],
    );
    for test in &report.directed_tests {
        let [held_at, estimate, sigma] =
            [test.held_at, test.estimate, test.sigma].map(|value| decimal_or_dash(value, 6));
        let rejected = if test.rejected { "yes" } else { "no" };
        table.row([or_dash(&test.name), held_at, estimate, sigma, rejected.to_owned()]);
    }
    section.table(table);
    section
}

fn of_camera(report: &Report, problem: &Problem) -> Table {
    let mut table = Table::new("Interior orientation", &["number", "as calibrated", "in the adjustment"]);
    let camera = &problem.camera;
    let (values, names) = (camera.interior(), camera.interior_names());
    for at in 0..camera.interior_count() {
        let is_adjusted = report.estimated.iter().any(|number| number.name == names[at]);
        let digits = if at < 3 { 3 } else { 6 };
        let how = if is_adjusted { "adjusted, see below" } else { "held" };
        table.row([names[at].to_owned(), decimal(values[at], digits), how.to_owned()]);
    }
    table
}

fn of_number(number: &ParameterReport) -> [String; 6] {
    let of = number.of.as_ref().map_or(String::new(), |of| format!(" of {of}"));
    let sigma = match number.sigma {
        _ if !number.observable => "not observable".to_owned(),
        Some(Sigma(sigma)) if sigma.is_infinite() => "inf".to_owned(),
        sigma => decimal_or_dash(sigma.map(|sigma| sigma.0), 6),
    };
    let told = |(name, r): (&String, &f64)| format!("{name} {}", decimal(*r, 3));
    let correlations: Vec<String> = number.correlations.iter().map(told).collect();
    [
        format!("{}{of}", or_dash(&number.name)),
        decimal_or_dash(number.before, 6),
        decimal_or_dash(number.value, 6),
        sigma,
        cm_or_dash(number.effect_m),
        if correlations.is_empty() { "none".to_owned() } else { correlations.join(", ") },
    ]
}
