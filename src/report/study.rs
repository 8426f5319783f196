//! The folder of a study or of a plan: tables, a page, and what it was made of.

use super::File;
use super::folder::{PROGRAM, PROGRAM_KEY};
use crate::study::plan::Choice;
use crate::study::summary::{name, number, table, without_result};
use crate::study::videos::{VideoSettings, Videos, summary_table, video_table};
use crate::study::{Outcome, Study, told};
use crate::tables::written;
use serde_json::{Value, json};

/// A study with what came out of it.
#[derive(Clone, Copy)]
pub struct StudyReport<'a> {
    /// The study.
    pub study: &'a Study,
    /// What came out of each cell.
    pub outcomes: &'a [Outcome],
    /// The command that was given.
    pub command: &'a str,
    /// Of a plan: its choices, and the cheapest that reaches what is wanted.
    pub plan: Option<(&'a [Choice], Option<usize>)>,
}

/// The files of the folder; `page` is its page for people.
pub fn study_files(report: &StudyReport, page: String) -> Vec<File> {
    let StudyReport { study, outcomes, command, plan } = *report;
    let (header, rows) = table(study, outcomes);
    let mut files = vec![("cells.csv".to_owned(), written(&header, rows))];
    if let Some((choices, cheapest)) = plan {
        let (header, rows) = plan_table(study, choices, cheapest);
        files.push(("plan.csv".to_owned(), written(&header, rows)));
    }
    files.push(("report.html".to_owned(), page.into_bytes()));
    files.push(study_json(
        study,
        command,
        &files,
        json!({
            "axes": study.axes.iter().map(|axis| json!({
                "parameter": axis.parameter,
                "values": axis.values.iter().map(told).collect::<Vec<_>>(),
            })).collect::<Vec<_>>(),
            "cells": outcomes.len(),
            "cells_not_computed": outcomes.iter().filter(|o| o.prediction.is_err()).count(),
            "runs_per_cell": study.runs,
            "runs_without_result": without_result(outcomes),
        }),
    ));
    files
}

/// The files of the folder of a study whose videos are judged.
pub fn video_files(study: &Study, videos: &VideoSettings, cells: &[Videos], command: &str) -> Vec<File> {
    let (header, rows) = summary_table(study, cells);
    let mut files = vec![("summary.csv".to_owned(), written(&header, rows))];
    let (header, rows) = video_table(study, videos, cells);
    files.push(("videos.csv".to_owned(), written(&header, rows)));
    files.push(study_json(
        study,
        command,
        &files,
        json!({
            "cells": cells.len(),
            "videos_per_cell": study.runs,
            "videos_without_result": cells.iter().flatten().filter(|video| video.is_err()).count(),
        }),
    ));
    files
}

/// `study.json`: what was asked, in the middle what is `own`, and all that it depends on.
fn study_json(study: &Study, command: &str, files: &[File], own: Value) -> File {
    let names = files.iter().map(|(name, _)| name.as_str());
    let mut summary = json!({
        PROGRAM_KEY: PROGRAM,
        "version": env!("CARGO_PKG_VERSION"),
        "command": command,
        "name": study.name,
        "title": study.title,
        "scenarios": study.scenarios.iter().map(|s| s.name.as_str()).collect::<Vec<_>>(),
    });
    if let (Value::Object(all), Value::Object(own)) = (&mut summary, own) {
        all.extend(own);
        all.insert("inputs".to_owned(), json!(study.inputs));
        // By these another study knows what it may replace.
        all.insert("files".to_owned(), json!(names.chain(["study.json"]).collect::<Vec<_>>()));
    }
    let mut text = serde_json::to_string_pretty(&summary).expect("plain values");
    text.push('\n');
    ("study.json".to_owned(), text.into_bytes())
}

/// The header and rows of `plan.csv`: every cell, the cheapest that reaches what is wanted first, then the others that
/// do, then those that do not, the nearest first.
pub fn plan_table(
    study: &Study,
    choices: &[Choice],
    cheapest: Option<usize>,
) -> (Vec<String>, Vec<Vec<String>>) {
    let own = ["feasible", "cheapest", "worst_ratio", "worst_quantity", "view_m2", "targets", "points"];
    let header = study.columns(&own);
    let cells = study.cells();
    let mut order: Vec<&Choice> = choices.iter().collect();
    order.sort_by(|a, b| {
        let rank = |c: &Choice| (Some(c.cell) != cheapest, !c.is_feasible());
        let view = |c: &Choice| if c.is_feasible() { -c.view_m2 } else { 0.0 };
        rank(a)
            .cmp(&rank(b))
            .then(view(a).total_cmp(&view(b)))
            .then(a.worst.0.total_cmp(&b.worst.0))
            .then(a.cell.cmp(&b.cell))
    });
    let rows = order.into_iter().map(|choice| {
        let mut row = study.cell_cells(choice.cell, &cells[choice.cell]);
        let yes = |is: bool| if is { "yes" } else { "no" }.to_owned();
        let effort =
            choice.effort.map(|count| if count == usize::MAX { String::new() } else { count.to_string() });
        row.extend([
            yes(choice.is_feasible()),
            yes(Some(choice.cell) == cheapest),
            number(Some(choice.worst.0)),
            name(choice.worst.1)[0].to_owned(),
            number(Some(choice.view_m2)),
        ]);
        row.extend(effort);
        row
    });
    let rows = rows.collect();
    (header, rows)
}
