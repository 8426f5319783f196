//! The floor plan: which room may use which, and by which door a package comes in.
//!
//! A room is a module of `src/`, or one of `src/nlls/`. The plan is the data below; the tests read
//! the paths that the sources name (`crate::…`, `super::…`).

mod support;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use support::in_package;

/// Rooms from the lowest floor up: floor, room, and what it may use of the floors below.
const PLAN: &[(u32, &str, &[&str])] = &[
    (1, "geometry", &[]),
    (1, "tables", &[]),
    (1, "nlls/loss", &[]),
    (1, "nlls/linear", &[]),
    (2, "nlls/manifold", &["geometry"]),
    (2, "camera", &["geometry"]),
    (2, "clock", &["nlls/loss"]),
    (2, "cloud", &["geometry"]),
    (2, "terrain", &["geometry"]),
    (3, "nlls/residual", &["nlls/manifold"]),
    (4, "nlls/system", &["nlls/linear", "nlls/loss", "nlls/manifold", "nlls/residual", "geometry"]),
    (5, "nlls/minimise", &["nlls/linear", "nlls/loss", "nlls/manifold", "nlls/residual", "nlls/system"]),
    (5, "nlls/covariance", &["nlls/linear", "nlls/system"]),
    (3, "problem", &["camera", "terrain", "geometry"]),
    (3, "reference", &["geometry", "tables"]),
    (4, "residuals", &["camera", "terrain", "geometry", "nlls/residual", "nlls/manifold"]),
    (4, "estimate", &["problem", "camera", "geometry", "trajectory"]),
    (3, "trajectory", &["geometry", "nlls/manifold"]),
    (5, "files", &["tables", "camera", "terrain", "geometry", "problem", "estimate"]),
    (
        5,
        "initialise",
        &["nlls/loss", "nlls/manifold", "residuals", "estimate", "problem", "camera", "terrain", "geometry"],
    ),
    (
        6,
        "refine",
        &[
            "initialise",
            "residuals",
            "clock",
            "trajectory",
            "estimate",
            "problem",
            "camera",
            "terrain",
            "geometry",
            "nlls/covariance",
            "nlls/linear",
            "nlls/loss",
            "nlls/manifold",
            "nlls/minimise",
            "nlls/residual",
            "nlls/system",
        ],
    ),
    (
        7,
        "diagnose",
        &[
            "refine",
            "initialise",
            "residuals",
            "camera",
            "trajectory",
            "estimate",
            "problem",
            "geometry",
            "nlls/covariance",
            "nlls/linear",
            "nlls/manifold",
            "nlls/residual",
            "nlls/system",
        ],
    ),
    (6, "evaluate", &["cloud", "files", "reference", "clock", "geometry"]),
    (
        6,
        "simulate",
        &["cloud", "files", "tables", "reference", "estimate", "problem", "camera", "terrain", "geometry"],
    ),
    (
        8,
        "study",
        &[
            "simulate",
            "diagnose",
            "refine",
            "initialise",
            "cloud",
            "files",
            "tables",
            "estimate",
            "problem",
            "geometry",
        ],
    ),
    (
        9,
        "report",
        &[
            "cloud",
            "tables",
            "study",
            "simulate",
            "diagnose",
            "evaluate",
            "refine",
            "initialise",
            "files",
            "estimate",
            "problem",
            "geometry",
            "nlls/linear",
            "nlls/loss",
        ],
    ),
    (
        9,
        "scene",
        &["diagnose", "evaluate", "refine", "files", "estimate", "problem", "geometry", "nlls/minimise"],
    ),
    (
        10,
        "cli",
        &[
            "diagnose",
            "evaluate",
            "files",
            "tables",
            "problem",
            "initialise",
            "refine",
            "reference",
            "report",
            "scene",
            "simulate",
            "study",
            "nlls/loss",
            "nlls/minimise",
        ],
    ),
];

/// Rooms that draw random numbers, most of them in tests alone.
const RANDOM: &[&str] = &[
    "cloud",
    "nlls/loss",
    "nlls/system",
    "initialise",
    "refine",
    "problem",
    "trajectory",
    "reference",
    "simulate",
];

/// Packages that come in by their own doors only. Nalgebra and thiserror are at home everywhere.
const DOORS: &[(&str, &[&str])] = &[
    ("faer", &["nlls/linear"]),
    ("clarabel", &["initialise"]),
    ("argmin", &["nlls/minimise", "clock"]),
    ("kiddo", &["cloud"]),
    ("rstar", &["cloud"]),
    ("csv", &["tables", "report"]),
    ("serde", &["tables", "files", "reference", "report"]),
    ("serde_json", &["files", "report"]),
    ("sha2", &["files"]),
    ("zip", &["report"]),
    ("plotters", &["report"]),
    ("minijinja", &["report"]),
    ("pulp", &["nlls/linear", "nlls/system"]),
    ("toml", &["files", "reference", "simulate"]),
    ("chrono", &["reference"]),
    ("geodesy", &["reference"]),
    ("nmea", &["reference"]),
    ("tiff", &["terrain"]),
    ("imagesize", &["files"]),
    ("ply_rs_bw", &["reference", "report"]),
    ("las", &["reference"]),
    ("laz", &["reference"]),
    ("e57", &["reference"]),
    ("pcd_rs", &["reference"]),
    (
        "rayon",
        &[
            "cloud",
            "nlls/linear",
            "nlls/system",
            "nlls/minimise",
            "initialise",
            "refine",
            "diagnose",
            "study",
            "cli",
        ],
    ),
    ("rand", RANDOM),
    ("rand_chacha", RANDOM),
    ("clap", &["cli"]),
    ("clap_complete", &["cli"]),
    ("indicatif", &["cli"]),
    ("trackbundle_viz", &["scene", "cli"]),
    ("rerun", &[]),
];

/// What lies between `files` and `refine` must not be able to see what a result is compared with. (A simulation
/// makes references, and reads scans as bodies.)
const MAY_OPEN_REFERENCE: &[&str] = &["reference", "evaluate", "simulate", "cli"];

const TOP_LEVEL: &[&str] = &[
    ".ci/run",
    ".gitignore",
    "Cargo.lock",
    "Cargo.toml",
    "LICENSE-APACHE",
    "LICENSE-MIT",
    "README.md",
    "benches",
    "docs",
    "examples",
    "problems",
    "rustfmt.toml",
    "src",
    "tests",
    "viz",
];

#[test]
fn the_top_level_is_as_planned() {
    for wanted in TOP_LEVEL {
        assert!(in_package(wanted).exists(), "{wanted} is missing");
    }
    for entry in std::fs::read_dir(in_package("")).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        let is_made = name == "target" || name == ".git" || name.ends_with("-result");
        let is_planned = TOP_LEVEL.iter().any(|planned| planned.split('/').next() == Some(name.as_str()));
        assert!(is_made || is_planned, "{name} is not in the plan");
    }
}

#[test]
fn every_room_is_in_the_plan_and_the_other_way_round() {
    let found: BTreeSet<String> = sources().iter().filter_map(|s| s.room.clone()).collect();
    let planned: BTreeSet<String> = PLAN.iter().map(|(_, room, _)| (*room).to_owned()).collect();
    assert_eq!(found, planned);
}

#[test]
fn the_plan_leads_downstairs_only() {
    let floors: BTreeMap<&str, u32> = PLAN.iter().map(|(floor, room, _)| (*room, *floor)).collect();
    for (floor, room, uses) in PLAN {
        for used in *uses {
            assert!(floors[used] < *floor, "{room} on floor {floor} may not use {used}");
        }
    }
}

#[test]
fn rooms_use_what_the_plan_lets_them_use() {
    let plan: BTreeMap<&str, &[&str]> = PLAN.iter().map(|(_, room, uses)| (*room, *uses)).collect();
    let mut used = BTreeSet::new();
    for source in sources() {
        let Some(room) = &source.room else { continue };
        for (line, other) in source.rooms_named() {
            if other == *room {
                continue;
            }
            let place = format!("{}:{line}", source.file.display());
            assert!(plan[room.as_str()].contains(&other.as_str()), "{place}: {room} may not use {other}");
            assert!(
                other != "reference" || MAY_OPEN_REFERENCE.contains(&room.as_str()),
                "{place}: evaluation is blind"
            );
            used.insert((room.clone(), other));
        }
    }
    assert!(used.len() > 30, "the sources were not read: {used:?}");
}

#[test]
fn packages_come_in_by_their_doors() {
    let mut seen = BTreeSet::new();
    for source in sources() {
        let Some(room) = &source.room else { continue };
        for (package, doors) in DOORS {
            for (at, line) in source.text.lines().enumerate() {
                if names(line, package) {
                    let place = format!("{}:{}", source.file.display(), at + 1);
                    assert!(doors.contains(&room.as_str()), "{place}: {package} has no door in {room}");
                    seen.insert(*package);
                }
            }
        }
    }
    for (package, doors) in DOORS {
        assert!(doors.is_empty() || seen.contains(package), "nothing uses {package}");
    }
}

#[test]
fn what_is_seen_knows_nothing_of_adjustment() {
    let manifest = std::fs::read_to_string(in_package("viz/Cargo.toml")).unwrap();
    assert!(manifest.lines().all(|line| !line.starts_with("trackbundle ") && !line.contains("\"..\"")));
    for file in rust_files(&in_package("viz/src")) {
        let text = std::fs::read_to_string(&file).unwrap();
        assert!(text.lines().all(|line| !names(line, "trackbundle")), "{}", file.display());
    }
}

#[test]
fn paths_are_resolved() {
    let source = |module: &str, text: &str| Source {
        file: PathBuf::new(),
        room: None,
        module: module.split('/').map(str::to_owned).collect(),
        text: text.to_owned(),
    };
    let named = |module, text| -> Vec<String> {
        source(module, text).rooms_named().into_iter().map(|(_, room)| room).collect()
    };
    assert_eq!(named("cli/check", "use crate::files::{A, B};"), ["files"]);
    assert_eq!(named("cli/check", "use crate::{files::A, nlls::loss};"), ["files", "nlls/loss"]);
    assert_eq!(named("nlls/minimise", "use super::system::Cost;"), ["nlls/system"]);
    assert_eq!(named("nlls/system/group", "use super::super::loss::Loss;"), ["nlls/loss"]);
    assert_eq!(named("nlls/system/group", "use super::orbit;"), ["nlls/system"]);
    assert_eq!(named("nlls/loss", "#[cfg(test)]\nmod tests {\n use super::linear;"), ["nlls/loss"]);
    assert_eq!(named("refine", "// crate::reference is only named here"), [""; 0]);
}

struct Source {
    file: PathBuf,
    /// `None` for lib.rs, main.rs and nlls/mod.rs, which only name rooms.
    room: Option<String>,
    /// Where it stands, as in `["nlls", "system", "group"]`.
    module: Vec<String>,
    text: String,
}

impl Source {
    /// The rooms that paths of this source lead to, with line numbers. What follows `#[cfg(test)]`
    /// is one module deeper.
    fn rooms_named(&self) -> Vec<(usize, String)> {
        let mut named = Vec::new();
        let mut depth = 0;
        for (at, line) in self.text.lines().enumerate() {
            depth += usize::from(line.starts_with("#[cfg(test)]"));
            let code = line.split("//").next().unwrap_or_default();
            for (start, _) in code.match_indices("crate::") {
                if code[..start].ends_with(|c: char| c.is_alphanumeric() || c == '_') {
                    continue;
                }
                for path in expanded(&code[start + "crate::".len()..]) {
                    named.extend(room_of(&path).map(|room| (at + 1, room)));
                }
            }
            let mut rest = code;
            while let Some(start) = rest.find("super::") {
                let mut ups = 0;
                rest = &rest[start..];
                while let Some(after) = rest.strip_prefix("super::") {
                    ups += 1;
                    rest = after;
                }
                let mut module = self.module.clone();
                module.extend(std::iter::repeat_n("tests".to_owned(), depth));
                module.truncate(module.len().saturating_sub(ups));
                module.extend(expanded(rest).into_iter().next().unwrap_or_default());
                named.extend(room_of(&module).map(|room| (at + 1, room)));
            }
        }
        named
    }
}

/// The paths of `a::b::{c, d::e};` as their names.
fn expanded(text: &str) -> Vec<Vec<String>> {
    let parts = |path: &str| -> Vec<String> {
        let end = path.find(|c: char| !(c.is_alphanumeric() || c == '_' || c == ':')).unwrap_or(path.len());
        path[..end].split("::").filter(|part| !part.is_empty()).map(str::to_owned).collect()
    };
    match text.strip_prefix('{') {
        Some(group) => group.split(',').map(|path| parts(path.trim())).collect(),
        None => vec![parts(text)],
    }
}

/// The room of a module path.
fn room_of(module: &[String]) -> Option<String> {
    let (first, rest) = module.split_first()?;
    match rest.first() {
        Some(second) if first == "nlls" => Some(format!("nlls/{second}")),
        None if first == "nlls" => None,
        _ if PLAN.iter().any(|(_, room, _)| room == first) => Some(first.clone()),
        _ => None,
    }
}

/// Whether a line of code names a package in a path or an import.
fn names(line: &str, package: &str) -> bool {
    let code = line.split("//").next().unwrap_or_default();
    code.match_indices(&format!("{package}::"))
        .any(|(start, _)| !code[..start].ends_with(|c: char| c.is_alphanumeric() || c == '_' || c == ':'))
        || code.trim_start().starts_with(&format!("use {package};"))
}

fn rust_files(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            files.extend(rust_files(&path));
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            files.push(path);
        }
    }
    files.sort();
    files
}

fn sources() -> Vec<Source> {
    let root = in_package("src");
    rust_files(&root)
        .into_iter()
        .map(|file| {
            let inside = file.strip_prefix(&root).unwrap().with_extension("");
            let mut module: Vec<String> =
                inside.iter().map(|part| part.to_str().unwrap().to_owned()).collect();
            if module.last().is_some_and(|name| name == "mod") {
                module.pop();
            }
            let is_top = matches!(module.as_slice(), [name] if name == "lib" || name == "main");
            let room = if is_top { None } else { room_of(&module) };
            let is_known = is_top || module == ["nlls"] || room.is_some();
            assert!(is_known, "{} is in no room of the plan", file.display());
            let text = std::fs::read_to_string(&file).unwrap();
            Source { file, room, module, text }
        })
        .collect()
}
