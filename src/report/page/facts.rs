//! What `report.json` says, in words and tables: verdict, datum and scale, control, interior orientation.

use super::content::{Block, Section, Table, cm_or_dash, decimal};
use crate::files::InputFile;
use crate::problem::Problem;
use crate::report::rounding::grouped;
use serde_json::Value;

const DASH: &str = "\u{2013}";

/// The report of a result; what it does not say reads as a dash.
#[derive(Clone, Copy, Debug)]
pub struct Facts<'a>(pub &'a Value);

impl<'a> Facts<'a> {
    /// A number at a JSON pointer.
    pub fn number(&self, pointer: &str) -> Option<f64> {
        self.0.pointer(pointer)?.as_f64()
    }

    /// A text or a number with so many digits.
    fn show(&self, pointer: &str, digits: usize) -> String {
        match self.0.pointer(pointer) {
            Some(Value::String(text)) => text.clone(),
            Some(Value::Bool(yes)) => if *yes { "yes" } else { "no" }.to_owned(),
            Some(value) => match (value.as_i64(), value.as_f64()) {
                (Some(whole), _) => grouped(whole, '\u{202f}').replace('-', "\u{2212}"),
                (None, Some(number)) => decimal(number, digits),
                _ => DASH.to_owned(),
            },
            None => DASH.to_owned(),
        }
    }

    /// The items of a list.
    fn list(&self, pointer: &str) -> Vec<Facts<'a>> {
        self.0
            .pointer(pointer)
            .and_then(Value::as_array)
            .map(|all| all.iter().map(Facts).collect())
            .unwrap_or_default()
    }

    /// The entries of an object, in the order of their names.
    fn entries(&self, pointer: &str) -> Vec<(&'a str, Facts<'a>)> {
        let object = self.0.pointer(pointer).and_then(Value::as_object);
        object
            .map(|all| all.iter().map(|(name, value)| (name.as_str(), Facts(value))).collect())
            .unwrap_or_default()
    }
}

/// The verdict in some ten lines.
pub fn verdict(facts: Facts, warnings: &[String]) -> Section {
    let mut section = Section::new("verdict", "Verdict");
    match facts.0.pointer("/verdict") {
        Some(verdict) if !verdict.is_null() => {
            section.strong(format!("Can the result be trusted? {}.", facts.show("/verdict/trust", 0)));
            let lines = ["/verdict/reasons", "/verdict/facts"].iter().flat_map(|at| facts.list(at));
            let items: Vec<String> = lines.filter_map(|line| line.0.as_str().map(str::to_owned)).collect();
            section.blocks.push(Block::List { items });
        }
        _ => section.empty("The result has no verdict: it was not adjusted, or had no final least squares."),
    }
    let told =
        facts.list("/warnings").iter().filter_map(|w| w.0.as_str()).map(str::to_owned).collect::<Vec<_>>();
    let mut all: Vec<String> = told;
    all.extend(warnings.iter().filter(|warning| !all.contains(warning)).cloned().collect::<Vec<_>>());
    if all.is_empty() {
        section.text("There are no warnings.");
    } else {
        section.heading("Warnings");
        section.blocks.push(Block::List { items: all });
    }
    section
}

/// What went in, and by which commands.
pub fn inputs(facts: Facts, commands: [&str; 2], now: &[InputFile]) -> Section {
    let mut section = Section::new("inputs", "Inputs and commands");
    let mut table = Table::new("Commands", &["what", "command"]);
    table.row(["adjustment (PROBLEM is the problem folder; without places, and without options that change no number)".to_owned(), commands[0].to_owned()]);
    table.row(["this report".to_owned(), commands[1].to_owned()]);
    table.row(["program".to_owned(), format!("trackbundle {}", facts.show("/version", 0))]);
    section.table(table);
    let recorded = facts.list("/inputs");
    let mut table =
        Table::new("Files of the problem that were adjusted", &["file", "bytes", "SHA-256", "now"]);
    for file in &recorded {
        let name = file.show("/file", 0);
        let digest = file.show("/sha256", 0);
        let state = match now.iter().find(|f| f.file == name) {
            Some(found) if found.sha256 == digest => "unchanged",
            Some(_) => "CHANGED since the adjustment",
            None => "not there any more",
        };
        table.row([name, file.show("/bytes", 0), digest, state.to_owned()]);
    }
    if table.rows.is_empty() {
        section.empty("The result does not say which files it is from (it was written by an older version).");
    }
    section.table(table);
    section
}

/// Files of the problem that are no longer those of the result.
pub fn changed_inputs(report: &Value, now: &[InputFile]) -> Vec<String> {
    let recorded = Facts(report).list("/inputs");
    let is_other = |file: &Facts| {
        let (name, digest) = (file.show("/file", 0), file.show("/sha256", 0));
        now.iter().all(|f| f.file != name || f.sha256 != digest)
    };
    recorded.iter().filter(|file| is_other(file)).map(|file| file.show("/file", 0)).collect()
}

/// What was adjusted, and what held the datum and the scale.
pub fn adjusted(facts: Facts) -> Section {
    let mut section = Section::new("adjusted", "What was adjusted, and what held the datum and the scale");
    let mut table = Table::new("Adjustment", &["", ""]);
    let mut row = |name: &str, value: String| table.row([name.to_owned(), value]);
    row("status", format!("{} ({})", facts.show("/status", 0), facts.show("/stop", 0)));
    row("iterations, all rounds", facts.show("/iterations", 0));
    row(
        "cost at the start, at the end",
        format!("{}, {}", facts.show("/initial_cost", 1), facts.show("/final_cost", 1)),
    );
    row(
        "rows, parameters, redundancy",
        format!(
            "{}, {}, {}",
            facts.show("/observations", 0),
            facts.show("/parameters", 0),
            facts.show("/redundancy", 0)
        ),
    );
    row("sigma0 a posteriori (a priori 1)", facts.show("/sigma0", 4));
    row(
        "image residuals, rms",
        format!(
            "{} px (vehicles {}, targets {})",
            facts.show("/rms_px", 2),
            facts.show("/rms_vehicle_px", 2),
            facts.show("/rms_target_px", 2)
        ),
    );
    row(
        "image points given, used, gross errors",
        format!(
            "{}, {}, {}",
            facts.show("/image_points/given", 0),
            facts.show("/image_points/used", 0),
            facts.show("/outliers", 0)
        ),
    );
    row(
        "robust loss",
        format!("{}, scale {} sigma", facts.show("/loss/name", 0), facts.show("/loss/scale_sigmas", 2)),
    );
    for motion in facts.list("/motion") {
        let (power, linear, angular) = match motion.show("/white_noise", 0).as_str() {
            "jerk" => ("3", "/jerk_mps3", "/angular_jerk_degps3"),
            _ => ("2", "/acceleration_mps2", "/angular_acceleration_degps2"),
        };
        row(
            &format!("motion of {}", motion.show("/body", 0)),
            format!(
                "white {}, {} m/s^{power} and {} deg/s^{power} over one second{}",
                motion.show("/white_noise", 0),
                motion.show(linear, 3),
                motion.show(angular, 3),
                if motion.0.pointer("/estimated") == Some(&Value::Bool(true)) { " (estimated)" } else { "" }
            ),
        );
    }
    section.table(table);

    section.heading("Datum");
    match facts.0.pointer("/observability") {
        Some(found) if !found.is_null() => {
            section.text(format!(
                "{} of {} unknowns are determined; {} are not.",
                facts.show("/observability/rank", 0),
                facts.show("/observability/unknowns", 0),
                facts.show("/observability/defect", 0)
            ));
            let mut table = Table::new("Open or weak directions", &["direction", "class", "held by"]);
            for direction in facts.list("/observability/directions") {
                table.row([
                    direction.show("/name", 0),
                    direction.show("/class", 0),
                    direction.show("/held_by", 0),
                ]);
            }
            section.table(table);
        }
        _ => section.empty("The result does not say what its datum rests on."),
    }
    section.heading("Scale");
    let scales = facts.list("/scales");
    if scales.is_empty() {
        section.empty("The result does not say what determined the scale.");
    }
    for scale in scales {
        let percent =
            |value: Option<f64>| value.map_or(DASH.to_owned(), |v| format!("{} %", decimal(100.0 * v, 2)));
        let sigma = match scale.0.pointer("/sigma") {
            Some(Value::String(_)) => "not determined".to_owned(),
            _ => format!("standard deviation {}", percent(scale.number("/sigma"))),
        };
        let mut table = Table::new(
            format!("Scale of {}: {sigma}", scale.show("/vehicle", 0)),
            &["source", "share of the variance", "standard deviation without it"],
        );
        let mut shares = scale.entries("/shares");
        shares.sort_by(|a, b| b.1.0.as_f64().unwrap_or(0.0).total_cmp(&a.1.0.as_f64().unwrap_or(0.0)));
        for (source, share) in shares {
            let without = match scale.0.pointer("/sigma_without").and_then(|all| all.get(source)) {
                Some(Value::String(_)) => "not determined".to_owned(),
                Some(value) => percent(value.as_f64()),
                None => DASH.to_owned(),
            };
            table.row([source.to_owned(), percent(share.0.as_f64()), without]);
        }
        section.table(table);
    }
    section
}

/// Check points; control points are told by their image residuals.
pub fn check_points(section: &mut Section, facts: Facts) {
    let mut table = Table::new(
        "Check points, result minus survey",
        &["target", "dx", "dy", "dz", "sigma x", "sigma y", "sigma z", "probability"],
    );
    for check in facts.list("/check_points") {
        let cell = |name: &str| cm_or_dash(check.number(name));
        table.row([
            check.show("/target", 0),
            cell("/dx"),
            cell("/dy"),
            cell("/dz"),
            cell("/sigma_dx"),
            cell("/sigma_dy"),
            cell("/sigma_dz"),
            check.show("/probability", 3),
        ]);
    }
    if table.rows.is_empty() {
        section.empty("There are no check points: no target has the role \"check\".");
    }
    section.table(table);
}

/// The interior orientation, and whatever else was adjusted beside poses and points.
pub fn interior(facts: Facts, problem: Option<&Problem>) -> Section {
    let mut section = Section::new("interior", "Interior orientation, and other numbers");
    let estimated = facts.list("/estimated");
    if let Some(problem) = problem {
        let mut table = Table::new("Interior orientation", &["number", "as calibrated", "in the adjustment"]);
        let camera = &problem.camera;
        let (values, names) = (camera.interior(), camera.interior_names());
        for at in 0..camera.interior_count() {
            let is_adjusted = estimated.iter().any(|e| e.show("/name", 0) == names[at]);
            let digits = if at < 3 { 3 } else { 6 };
            let how = if is_adjusted { "adjusted, see below" } else { "held" };
            table.row([names[at].to_owned(), decimal(values[at], digits), how.to_owned()]);
        }
        section.table(table);
    }
    let mut table = Table::new(
        "Numbers adjusted beside poses and points",
        &["number", "before", "adjusted", "sigma", "effect on the shape", "correlations beyond 0.95"],
    );
    for number in &estimated {
        let of =
            number.0.pointer("/of").and_then(Value::as_str).map_or(String::new(), |of| format!(" of {of}"));
        let is_observable = number.0.pointer("/observable") != Some(&Value::Bool(false));
        let correlations: Vec<String> = number
            .entries("/correlations")
            .into_iter()
            .map(|(name, value)| format!("{name} {}", decimal(value.0.as_f64().unwrap_or(f64::NAN), 3)))
            .collect();
        table.row([
            format!("{}{of}", number.show("/name", 0)),
            number.show("/before", 6),
            number.show("/value", 6),
            if is_observable { number.show("/sigma", 6) } else { "not observable".to_owned() },
            cm_or_dash(number.number("/effect_m")),
            if correlations.is_empty() { "none".to_owned() } else { correlations.join(", ") },
        ]);
    }
    if table.rows.is_empty() {
        section.empty("No number was adjusted beside poses and points: the interior orientation is held as calibrated, and has no correlations.");
    }
    section.table(table);
    let mut table = Table::new(
        "Tests of numbers that are held",
        &["number", "held at", "if it were free", "sigma", "rejected at 0.1 %"],
    );
    for test in facts.list("/directed_tests") {
        table.row([
            test.show("/name", 0),
            test.show("/held_at", 6),
            test.show("/estimate", 6),
            test.show("/sigma", 6),
            test.show("/rejected", 0),
        ]);
    }
    section.table(table);
    section
}
