//! `report.html`: a result and what it was held against, in one page that needs nothing beside it.
//!
//! ```text
//! report.json, tables, problem, evaluation -> sections (facts, residuals, track) -> template -> bytes
//! ```
//!
//! Figures are drawn by plotters, the page is laid out by minijinja; the template is `page.html`.

mod content;
mod facts;
mod figure;
mod residuals;
mod shape;
mod study;
#[cfg(test)]
mod tests;
mod track;

use crate::disk::InputFile;
use crate::evaluate::Evaluation;
use crate::files::{ResultResiduals, ResultTracks};
use crate::problem::Problem;
use crate::report::Report;
use content::{Headline, Section};
pub use facts::changed_inputs;
pub use study::study_page;

/// So many vehicles get figures; the others are in the tables.
const MOST_DRAWN: usize = 8;

/// What a page is made of.
#[derive(Clone, Copy, Debug)]
pub struct PageInput<'a> {
    /// Name of the problem.
    pub name: &'a str,
    /// The command that makes the page.
    pub command: &'a str,
    /// The problem, where it can be computed.
    pub problem: Option<&'a Problem>,
    /// Its files as they are now.
    pub inputs: &'a [InputFile],
    /// `report.json` of the result.
    pub report: &'a Report,
    /// Image residuals of the first estimate.
    pub start: Option<&'a ResultResiduals>,
    /// Image residuals of the result.
    pub end: Option<&'a ResultResiduals>,
    /// Its tracks.
    pub tracks: &'a ResultTracks,
    /// The comparison.
    pub evaluation: &'a Evaluation,
    /// What is odd.
    pub warnings: &'a [String],
}

/// The page.
pub fn page(input: &PageInput) -> String {
    let report = input.report;
    let recorded = Some(report.command.as_str()).filter(|text| !text.is_empty());

    let mut sections = vec![
        facts::verdict(report, input.warnings),
        facts::inputs(report, [recorded.unwrap_or("not recorded"), input.command], input.inputs),
        facts::adjusted(report),
    ];
    sections.push(match input.problem {
        Some(problem) => residuals::section(problem, input.start, input.end),
        None => {
            let mut section = Section::new("residuals", "Image residuals before and after");
            section
                .empty("The problem cannot be computed by this version, so its image points are not known.");
            section
        }
    });
    sections.push(control(input));
    sections.push(facts::interior(report, input.problem));
    sections.push(tracks(input));
    sections.push(shapes(input));
    render(input.name, &REPORT, &headlines(input), &sections)
}

fn headlines(input: &PageInput) -> Vec<Headline> {
    let unchecked = |name: &str, why: &str, link| Headline {
        name: name.to_owned(),
        value: "not checked".to_owned(),
        meaning: why.to_owned(),
        more: String::new(),
        link,
    };
    let mut all: Vec<Headline> = match input.evaluation.vehicles.first() {
        Some(found) => track::headlines(found).into(),
        None => vec![unchecked("Track and speed", "there is no GNSS track to hold them against", "track")],
    };
    all.push(match input.evaluation.shapes.first() {
        Some(found) => shape::headline(found),
        None => unchecked("Shape", "there is no scan to hold it against", "shape"),
    });
    all
}

fn shapes(input: &PageInput) -> Section {
    let mut section = Section::new("shape", "Shape against the scan");
    let evaluation = input.evaluation;
    if evaluation.shapes.is_empty() {
        section.empty("No shape was compared, so Figures 6 to 8 are empty.");
    }
    for (vehicle, why) in &evaluation.shapes_not_compared {
        section.empty(format!("The shape of {vehicle} was not compared: {why}."));
    }
    evaluation.shapes.iter().take(MOST_DRAWN).for_each(|found| shape::add(&mut section, found));
    section
}

fn control(input: &PageInput) -> Section {
    let mut section = Section::new("control", "Control and check points");
    match (input.problem, input.end) {
        (Some(problem), _) if problem.targets.is_empty() => {
            section.empty("The problem has no targets: nothing but the poses as given ties it to the world.");
            return section;
        }
        (Some(problem), Some(end)) => section.table(residuals::by_target(problem, end)),
        _ => section.empty("Image residuals of targets are not known."),
    }
    facts::check_points(&mut section, input.report);
    section
}

fn tracks(input: &PageInput) -> Section {
    let mut section = Section::new("track", "Track and speed against GNSS");
    let evaluation = input.evaluation;
    if evaluation.vehicles.is_empty() {
        section.empty("No track was compared, so Table 1 and Figures 3 to 5 are empty.");
    }
    for (vehicle, why) in &evaluation.not_compared {
        section.empty(format!("The track of {vehicle} was not compared: {why}."));
    }
    for (at, found) in evaluation.vehicles.iter().enumerate() {
        if at == MOST_DRAWN {
            let left = evaluation.vehicles.len() - MOST_DRAWN;
            section.empty(format!("{left} more vehicles are in evaluation.json."));
            break;
        }
        let track = input.tracks.tracks.iter().find(|(id, _)| *id == found.vehicle);
        track::add(&mut section, found, track.map_or(&[], |(_, track)| track));
    }
    section
}

/// What a page is.
struct Told {
    kind: &'static str,
    about: &'static str,
    footer: &'static str,
}

const REPORT: Told = Told {
    kind: "adjustment report",
    about: "Bundle adjustment of moving vehicles, held against what it was never adjusted to.",
    footer: "Lengths in metres or centimetres, angles in degrees, times in seconds of the video. A difference is result minus reference.",
};

fn render(title: &str, told: &Told, headlines: &[Headline], sections: &[Section]) -> String {
    let mut environment = minijinja::Environment::new();
    environment.set_auto_escape_callback(|_| minijinja::AutoEscape::Html);
    environment.set_undefined_behavior(minijinja::UndefinedBehavior::Strict);
    let template =
        environment.template_from_str(include_str!("page.html")).expect("the template that the tests render");
    let program = concat!("trackbundle ", env!("CARGO_PKG_VERSION"));
    let Told { kind, about, footer } = told;
    let context = minijinja::context! { title, kind, about, footer, headlines, sections, program };
    template.render(context).expect("the template that the tests render")
}
