//! `STUDY.toml`: scenarios, what varies of them, and what is wanted.

use super::draw::{VideoSettings, read_draw};
use crate::disk::{self, InputFile};
use crate::files::named_text;
use crate::files::section::{Document, Section};
use crate::simulate::scenario::Scenario;
use crate::simulate::{Value, parse, vary};
use crate::tables::{Finding, Findings};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// The most cells, and the most runs of each.
const MOST_CELLS: usize = 100_000;
const MOST_RUNS: f64 = 1e6;

/// A study.
#[derive(Clone, Debug)]
pub struct Study {
    /// Its name.
    pub name: String,
    /// What it asks, in a line.
    pub title: String,
    /// The scenarios, one at least.
    pub scenarios: Vec<BaseScenario>,
    /// What varies of each.
    pub axes: Vec<Axis>,
    /// Runs of the Monte Carlo in each cell, or videos; 0: none.
    pub runs: usize,
    /// Where videos of all kinds are judged: how they are made.
    pub videos: Option<VideoSettings>,
    /// What a plan must reach.
    pub wanted: Option<Wanted>,
    /// All that it depends on, as text.
    pub inputs: String,
}

/// A scenario that is varied.
#[derive(Clone, Debug)]
pub struct BaseScenario {
    /// Its name.
    pub name: String,
    /// Ids of its vehicles.
    pub vehicles: Vec<String>,
    file: PathBuf,
    text: String,
    set: Vec<(String, Value)>,
}

/// A parameter and its values.
#[derive(Clone, Debug, PartialEq)]
pub struct Axis {
    /// Where it stands in the scenario.
    pub parameter: String,
    /// What people call it.
    pub label: String,
    /// What it takes.
    pub values: Vec<Value>,
}

/// What a plan must reach; standard deviations.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wanted {
    /// Of the track in the plan: both coordinates together \[m\].
    pub track_m: Option<f64>,
    /// Of its height \[m\].
    pub height_m: Option<f64>,
    /// Of the speed \[m/s\].
    pub speed_mps: Option<f64>,
    /// Of the heading \[deg\].
    pub heading_deg: Option<f64>,
    /// Of a point of the shape: all coordinates together \[m\].
    pub shape_m: Option<f64>,
    /// Of the scale, relative.
    pub scale: Option<f64>,
}

/// One combination of values.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Cell {
    /// Which scenario.
    pub scenario: usize,
    /// Which value of each axis.
    pub values: Vec<usize>,
}

/// A value as it is written in a table.
pub fn told(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        Value::Float(number) => number.to_string(),
        other => other.to_string(),
    }
}

/// Reads a study.
pub fn read_study(path: &Path) -> Result<Study, Findings> {
    let (file, text) = named_text(path, "a study that can be read")?;
    let folder = path.parent().unwrap_or(Path::new(""));
    let (study, findings) = Document::new(&file, &text).strict().read(|top| read(top, folder));
    let mut study = match study.flatten() {
        Some(study) if !findings.is_invalid() => study,
        _ => return Err(findings),
    };
    study.inputs = text;
    for base in &study.scenarios {
        study.inputs += &format!("\n# {}\n{}", base.name, base.text);
    }
    // Every value of every axis at least once, before anything is computed.
    let mut findings = Findings::default();
    let mut files: BTreeSet<(PathBuf, String)> = BTreeSet::new();
    for at in 0..study.scenarios.len() {
        let first = Cell { scenario: at, values: vec![0; study.axes.len()] };
        let others = study
            .axes
            .iter()
            .enumerate()
            .flat_map(|(axis, of)| (1..of.values.len()).map(move |value| (axis, value)));
        let others = others.map(|(axis, value)| {
            let mut cell = first.clone();
            cell.values[axis] = value;
            cell
        });
        for cell in std::iter::once(first.clone()).chain(others).collect::<Vec<_>>() {
            let examples = study.videos.iter().flat_map(|videos| &videos.draws);
            for example in examples.flat_map(|draw| draw.examples()).filter(|_| cell == first) {
                if let Err(why) = study.scenario_with(&cell, &example) {
                    let told: Vec<String> =
                        example.iter().map(|(key, value)| format!("{key} = {}", self::told(value))).collect();
                    let wanted = format!("a scenario with {}, {}", study.told(&cell), told.join(", "));
                    findings.error(Finding::of_file(&file, &wanted, &why));
                }
            }
            match study.scenario(&cell) {
                Ok(found) => {
                    files.extend(found.files().into_iter().map(|name| (found.folder.clone(), name)));
                    study.scenarios[at].vehicles = found.vehicles.into_iter().map(|v| v.id).collect();
                }
                Err(why) => {
                    let wanted = format!("a scenario with {}", study.told(&cell));
                    findings.error(Finding::of_file(&file, &wanted, &why));
                }
            }
        }
    }
    if findings.is_invalid() {
        return Err(findings);
    }
    for (folder, name) in files {
        let bytes = disk::read(&folder.join(&name));
        let digest = bytes.map_or_else(|_| String::new(), |bytes| InputFile::new(&name, &bytes).sha256);
        study.inputs += &format!("\n# {name} {digest}");
    }
    Ok(study)
}

fn read(top: &Section, folder: &Path) -> Option<Study> {
    top.check_format();
    let name = top.required("name", "a text", || top.text("name"));
    let title = top.text("title").unwrap_or_default();
    let names = match top.has("scenarios") {
        true => top.texts("scenarios").unwrap_or_default(),
        false => {
            top.required("scenario", "the file of a scenario", || top.text("scenario")).into_iter().collect()
        }
    };
    let set: Vec<(String, Value)> = top.free_table("set").unwrap_or_default().into_iter().collect();
    let mut scenarios = Vec::new();
    for name in names {
        let file = folder.join(&name);
        match disk::read_text(&file) {
            Ok(text) => {
                let name = file.file_stem().map_or(name, |stem| stem.to_string_lossy().into_owned());
                scenarios.push(BaseScenario { name, vehicles: Vec::new(), file, text, set: set.clone() });
            }
            Err(error) => {
                let key = if top.has("scenarios") { "scenarios" } else { "scenario" };
                top.error(key, &format!("the file of a scenario ({}: {error})", file.display()));
            }
        }
    }
    let axes: Vec<Axis> = top
        .tables("axis", |axis| {
            let parameter =
                axis.required("parameter", "a key of the scenario, such as flight.altitude_m", || {
                    axis.text("parameter")
                })?;
            let label = axis.text("label").unwrap_or_else(|| parameter.clone());
            let values = axis.required("values", "an array of values", || axis.values("values"))?;
            let is_value = |v: &Value| !matches!(v, Value::Array(_) | Value::Table(_) | Value::Datetime(_));
            if !values.iter().all(is_value) {
                axis.error("values", "numbers, texts, true or false");
            }
            Some(Axis { parameter, label, values })
        })
        .into_iter()
        .flatten()
        .collect();
    let cells = axes.iter().fold(scenarios.len(), |all, axis| all.saturating_mul(axis.values.len()));
    if cells > MOST_CELLS {
        top.error("axis", &format!("at most {MOST_CELLS} cells, not {cells}"));
    }
    let right = |v: f64| v.fract() == 0.0 && (2.0..=MOST_RUNS).contains(&v);
    let runs = top.table("monte_carlo", |section| {
        let wanted = "a whole number of runs, two at least";
        section.required("runs", wanted, || section.number("runs", wanted, right))
    });
    let draws: Vec<_> = top.tables("draw", read_draw).into_iter().flatten().collect();
    let videos = top.table("videos", |section| {
        let wanted = "a whole number of videos, two at least";
        let count = section.required("count", wanted, || section.number("count", wanted, right));
        (count, section.flag("motion").unwrap_or(true))
    });
    if videos.is_some() && top.has("monte_carlo") {
        top.error("monte_carlo", "either runs or videos");
    }
    if videos.is_none() && top.has("draw") {
        top.error("draw", "nothing without a table [videos]");
    }
    let wanted = top.table("wanted", |section| Wanted {
        track_m: section.positive("track_m"),
        height_m: section.positive("height_m"),
        speed_mps: section.positive("speed_mps"),
        heading_deg: section.positive("heading_deg"),
        shape_m: section.positive("shape_m"),
        scale: section.positive("scale"),
    });
    if wanted.is_some_and(|wanted| wanted == Wanted::default()) {
        top.error("wanted", "one standard deviation or more");
    }
    let runs = match videos {
        Some((count, _)) => count,
        None => runs.flatten(),
    };
    let runs = runs.map_or(0, |runs| runs as usize);
    let videos = videos.map(|(_, has_motion)| VideoSettings { draws, has_motion });
    Some(Study { name: name?, title, scenarios, axes, runs, videos, wanted, inputs: String::new() })
}

impl Study {
    /// All cells: the last axis varies fastest.
    pub fn cells(&self) -> Vec<Cell> {
        let mut cells = Vec::new();
        for scenario in 0..self.scenarios.len() {
            let mut choices = vec![Vec::new()];
            for axis in &self.axes {
                let longer = |choice: &Vec<usize>| {
                    let choice = choice.clone();
                    (0..axis.values.len()).map(move |value| [choice.clone(), vec![value]].concat())
                };
                choices = choices.iter().flat_map(longer).collect();
            }
            cells.extend(choices.into_iter().map(|values| Cell { scenario, values }));
        }
        cells
    }

    /// The scenario of a cell; the error says what is wrong with it.
    pub fn scenario(&self, cell: &Cell) -> Result<Scenario, String> {
        self.scenario_with(cell, &[])
    }

    /// The number by which all of a video is drawn: another for each scenario, the same whatever the axes say.
    pub fn video_number(&self, cell: &Cell, number: usize) -> usize {
        cell.scenario * MOST_RUNS as usize + number
    }

    /// What is drawn for a video.
    pub fn drawn(&self, videos: &VideoSettings, cell: &Cell, number: usize) -> Vec<(String, Value)> {
        let number = self.video_number(cell, number);
        videos.draws.iter().enumerate().flat_map(|(at, draw)| draw.of_video(number, at)).collect()
    }

    /// The same with what was drawn; the cell's own values come last.
    pub fn scenario_with(&self, cell: &Cell, drawn: &[(String, Value)]) -> Result<Scenario, String> {
        let drawn = drawn.iter().map(|(key, value)| (key.as_str(), value));
        let base = &self.scenarios[cell.scenario];
        let set = base.set.iter().map(|(key, value)| (key.as_str(), value));
        let own =
            self.axes.iter().zip(&cell.values).map(|(axis, at)| (axis.parameter.as_str(), &axis.values[*at]));
        let text = vary(&base.text, &set.chain(drawn).chain(own).collect::<Vec<_>>())?;
        let file = base.file.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        parse(&file, &text, base.file.parent().unwrap_or(Path::new(""))).map_err(|findings| {
            // Lines are those of a text that nobody has seen.
            let told = findings.errors().map(|f| Finding { line: None, ..f.clone() }.to_string());
            told.collect::<Vec<_>>().join("; ")
        })
    }

    /// Names of the columns of a table: those that tell a cell, then its own.
    pub fn columns(&self, own: &[&str]) -> Vec<String> {
        let axes = self.axes.iter().map(|axis| axis.parameter.as_str());
        let all = ["cell", "scenario"].into_iter().chain(axes).chain(own.iter().copied());
        all.map(str::to_owned).collect()
    }

    /// What stands in them for a cell, of this number.
    pub fn cell_cells(&self, number: usize, cell: &Cell) -> Vec<String> {
        let values = self.axes.iter().zip(&cell.values).map(|(axis, at)| told(&axis.values[*at]));
        [number.to_string(), self.scenarios[cell.scenario].name.clone()].into_iter().chain(values).collect()
    }

    /// A cell in words.
    pub fn told(&self, cell: &Cell) -> String {
        let mut parts = vec![self.scenarios[cell.scenario].name.clone()];
        for (axis, at) in self.axes.iter().zip(&cell.values) {
            parts.push(format!("{} = {}", axis.parameter, told(&axis.values[*at])));
        }
        parts.join(", ")
    }
}
