//! The floor plan: which room may use which, by which door a package comes in, and no circles between files.
//!
//! A room is a module of `src/`, of `engine/src/`, or of `solver/src/`. The plan is the data below; the tests read
//! the paths that the sources name (`crate::…`, `super::…`, `self::…`).

use crate::support::in_package;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Rooms of the engine from the lowest floor up: floor, room, and what it may use of the floors below.
const ENGINE: &[(u32, &str, &[&str])] = &[
    (1, "geometry", &[]),
    (1, "rules", &[]),
    (1, "stats", &[]),
    (2, "camera", &["geometry"]),
    (2, "clock", &["stats"]),
    (2, "cloud", &["geometry", "stats"]),
    (2, "terrain", &["geometry", "rules", "stats"]),
    (3, "trajectory", &["geometry", "stats"]),
    (3, "problem", &["camera", "terrain", "geometry", "rules"]),
    (4, "residuals", &["camera", "terrain", "geometry"]),
    (4, "estimate", &["problem", "camera", "geometry", "trajectory"]),
    (
        5,
        "initialise",
        &["residuals", "estimate", "problem", "camera", "terrain", "geometry", "stats", "rules"],
    ),
    (
        6,
        "network",
        &[
            "residuals",
            "clock",
            "trajectory",
            "estimate",
            "problem",
            "camera",
            "terrain",
            "geometry",
            "rules",
            "stats",
        ],
    ),
    (7, "refine", &["network", "initialise", "estimate", "problem", "camera", "geometry", "rules", "stats"]),
    (
        8,
        "diagnose",
        &[
            "refine",
            "network",
            "initialise",
            "residuals",
            "camera",
            "trajectory",
            "estimate",
            "problem",
            "geometry",
            "stats",
            "rules",
        ],
    ),
    (9, "words", &["diagnose", "refine", "network", "initialise", "estimate"]),
];

/// Rooms of the toolkit, which stand on those of the engine.
const TOOLKIT: &[(u32, &str, &[&str])] = &[
    (1, "disk", &[]),
    (2, "tables", &["disk"]),
    (3, "reference", &["geometry", "tables", "disk"]),
    (5, "files", &["disk", "tables", "camera", "terrain", "geometry", "problem", "estimate"]),
    (7, "evaluate", &["cloud", "files", "reference", "clock", "geometry", "stats", "rules"]),
    (
        7,
        "simulate",
        &[
            "cloud",
            "files",
            "disk",
            "tables",
            "reference",
            "estimate",
            "problem",
            "camera",
            "terrain",
            "geometry",
        ],
    ),
    (9, "pipeline", &["diagnose", "refine", "initialise", "files", "disk", "tables", "estimate", "problem"]),
    (
        10,
        "study",
        &[
            "words",
            "pipeline",
            "simulate",
            "diagnose",
            "refine",
            "network",
            "initialise",
            "cloud",
            "files",
            "disk",
            "tables",
            "estimate",
            "problem",
            "geometry",
            "stats",
        ],
    ),
    (
        11,
        "report",
        &[
            "clock",
            "cloud",
            "disk",
            "tables",
            "words",
            "study",
            "pipeline",
            "diagnose",
            "evaluate",
            "refine",
            "network",
            "initialise",
            "files",
            "estimate",
            "problem",
            "geometry",
            "stats",
        ],
    ),
    (11, "scene", &["diagnose", "evaluate", "refine", "files", "estimate", "problem", "geometry"]),
    (
        12,
        "page",
        &[
            "report", "words", "study", "simulate", "diagnose", "evaluate", "cloud", "files", "disk",
            "problem", "stats",
        ],
    ),
    (
        13,
        "cli",
        &[
            "clock",
            "page",
            "scene",
            "report",
            "study",
            "words",
            "pipeline",
            "diagnose",
            "evaluate",
            "simulate",
            "refine",
            "network",
            "initialise",
            "files",
            "disk",
            "tables",
            "reference",
            "problem",
            "rules",
            "terrain",
        ],
    ),
];

/// Rooms of the solver.
const SOLVER: &[(u32, &str, &[&str])] = &[
    (1, "geometry", &[]),
    (1, "loss", &[]),
    (1, "linear", &[]),
    (2, "manifold", &["geometry"]),
    (3, "residual", &["manifold"]),
    (4, "system", &["linear", "loss", "manifold", "residual", "geometry"]),
    (5, "minimise", &["linear", "loss", "manifold", "residual", "system"]),
    (5, "covariance", &["linear", "system"]),
];

/// A package of the workspace: its sources, its plan, and the doors of other packages.
struct House {
    sources: &'static str,
    plan: &'static [(u32, &'static str, &'static [&'static str])],
    /// Rooms of the package that it stands on.
    below: &'static [(u32, &'static str, &'static [&'static str])],
    doors: &'static [(&'static str, &'static [&'static str])],
}

const HOUSES: &[House] = &[
    House { sources: "src", plan: TOOLKIT, below: ENGINE, doors: DOORS },
    House { sources: "engine/src", plan: ENGINE, below: &[], doors: ENGINE_DOORS },
    House { sources: "solver/src", plan: SOLVER, below: &[], doors: SOLVER_DOORS },
];

/// Rooms that draw random numbers, most of them in tests alone.
const RANDOM: &[&str] = &["cloud", "initialise", "network", "trajectory"];

/// Packages that come in by their own doors only. Nalgebra and thiserror are at home everywhere.
const DOORS: &[(&str, &[&str])] = &[
    ("csv", &["tables", "report"]),
    ("serde", &["tables", "files", "reference", "report", "page"]),
    ("serde_json", &["files", "report", "page"]),
    ("schemars", &["report"]),
    ("sha2", &["disk"]),
    ("zip", &["report"]),
    ("plotters", &["page"]),
    ("minijinja", &["page"]),
    ("toml", &["files", "reference", "simulate"]),
    ("chrono", &["reference"]),
    ("geodesy", &["reference"]),
    ("nmea", &["reference"]),
    ("imagesize", &["files"]),
    ("ply_rs_bw", &["reference", "report"]),
    ("las", &["reference"]),
    ("laz", &["reference"]),
    ("e57", &["reference"]),
    ("pcd_rs", &["reference"]),
    ("rayon", &["study", "cli"]),
    ("rand", &["reference", "simulate"]),
    ("rand_chacha", &["reference", "simulate"]),
    ("rustix", &["disk"]),
    ("signal_hook", &["cli"]),
    ("clap", &["cli"]),
    ("clap_complete", &["cli"]),
    ("indicatif", &["cli"]),
    ("trackbundle_engine", &[]),
    ("trackbundle_viz", &["scene", "cli"]),
    ("rerun", &[]),
];

/// Doors of the engine.
const ENGINE_DOORS: &[(&str, &[&str])] = &[
    ("clarabel", &["initialise"]),
    ("argmin", &["clock"]),
    ("kiddo", &["cloud"]),
    ("rstar", &["cloud"]),
    ("tiff", &["terrain"]),
    ("rayon", &["cloud", "initialise", "diagnose"]),
    ("rand", RANDOM),
    ("rand_chacha", RANDOM),
    ("trackbundle", &[]),
];

/// Doors of the solver.
const SOLVER_DOORS: &[(&str, &[&str])] = &[
    ("faer", &["linear"]),
    ("argmin", &["minimise"]),
    ("pulp", &["linear", "system"]),
    ("rayon", &["linear", "system", "minimise"]),
    ("rand", &["loss", "system"]),
    ("rand_chacha", &["loss", "system"]),
    ("trackbundle", &[]),
];

/// What lies between `files` and `refine` must not be able to see what a result is compared with. (A simulation
/// makes references, and reads scans as bodies.)
const MAY_OPEN_REFERENCE: &[&str] = &["reference", "evaluate", "simulate", "cli"];

const TOP_LEVEL: &[&str] = &[
    ".ci/run",
    ".gitignore",
    "ARCHITECTURE.md",
    "CHANGELOG.md",
    "CITATION.cff",
    "CONTRIBUTING.md",
    "Cargo.lock",
    "Cargo.toml",
    "LICENSE-APACHE",
    "LICENSE-MIT",
    "README.md",
    "benches",
    "docs",
    "engine",
    "examples",
    "fuzz",
    "problems",
    "rustfmt.toml",
    "solver",
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
    for house in HOUSES {
        let found: BTreeSet<String> = sources(house).into_iter().filter_map(|s| s.room).collect();
        let planned: BTreeSet<String> = house.plan.iter().map(|(_, room, _)| (*room).to_owned()).collect();
        assert_eq!(found, planned, "{}", house.sources);
    }
}

/// ARCHITECTURE.md may run ahead of the plan, never behind it.
#[test]
fn every_room_is_in_the_code_map() {
    let page = std::fs::read_to_string(in_package("ARCHITECTURE.md")).unwrap();
    let named: BTreeSet<&str> = page
        .lines()
        .filter_map(|row| row.strip_prefix("| ")?.split(" | ").nth(1))
        .flat_map(|rooms| rooms.split('`').skip(1).step_by(2))
        .collect();
    for house in HOUSES {
        for (_, room, _) in house.plan {
            assert!(
                named.contains(room),
                "{}/{room} is not in the code map of ARCHITECTURE.md",
                house.sources
            );
        }
    }
}

#[test]
fn the_plan_leads_downstairs_only() {
    for house in HOUSES {
        let rooms = house.below.iter().chain(house.plan);
        let floors: BTreeMap<&str, u32> = rooms.map(|(floor, room, _)| (*room, *floor)).collect();
        for (floor, room, uses) in house.plan {
            for used in *uses {
                assert!(floors[used] < *floor, "{room} on floor {floor} may not use {used}");
            }
        }
    }
}

#[test]
fn rooms_use_what_the_plan_lets_them_use() {
    for house in HOUSES {
        let rooms = house.below.iter().chain(house.plan);
        let plan: BTreeMap<&str, &[&str]> = rooms.map(|(_, room, uses)| (*room, *uses)).collect();
        let mut used = BTreeSet::new();
        for source in sources(house) {
            let Some(room) = &source.room else { continue };
            for (line, path) in source.paths_named() {
                let Some(other) = path.first().filter(|other| plan.contains_key(other.as_str())) else {
                    continue;
                };
                if other == room {
                    continue;
                }
                let place = format!("{}:{line}", source.file.display());
                assert!(plan[room.as_str()].contains(&other.as_str()), "{place}: {room} may not use {other}");
                assert!(
                    other != "reference" || MAY_OPEN_REFERENCE.contains(&room.as_str()),
                    "{place}: evaluation is blind"
                );
                used.insert((room.clone(), other.clone()));
            }
        }
        assert!(used.len() > house.plan.len(), "the sources were not read: {used:?}");
    }
}

#[test]
fn packages_come_in_by_their_doors() {
    for house in HOUSES {
        let mut seen = BTreeSet::new();
        for source in sources(house) {
            let Some(room) = &source.room else { continue };
            for (package, doors) in house.doors {
                for (at, line) in source.text.lines().enumerate() {
                    if names(line, package) {
                        let place = format!("{}:{}", source.file.display(), at + 1);
                        assert!(doors.contains(&room.as_str()), "{place}: {package} has no door in {room}");
                        seen.insert(*package);
                    }
                }
            }
        }
        for (package, doors) in house.doors {
            assert!(doors.is_empty() || seen.contains(package), "nothing uses {package}");
        }
    }
}

/// Files of these circles use each other still. The list may only shrink.
const CIRCLES: &[&[&str]] = &[];

/// A module that hands on what its own files have is no part of a circle.
#[test]
fn files_do_not_use_each_other_in_circles() {
    for folder in ["src", "engine/src", "solver/src", "viz/src"] {
        let sources = sources_in(folder);
        let files: BTreeMap<&[String], usize> =
            sources.iter().enumerate().map(|(at, source)| (source.module.as_slice(), at)).collect();
        let uses: Vec<BTreeSet<usize>> = sources
            .iter()
            .map(|source| {
                let own = files[source.module.as_slice()];
                let file_of = |path: &[String]| {
                    (0..=path.len()).rev().find_map(|length| files.get(&path[..length]).copied())
                };
                let named = source.paths_named().into_iter().filter(|(line, _)| *line < source.tests_from());
                let used = named.filter_map(|(_, path)| file_of(&path));
                used.filter(|used| *used != own && !source.module.starts_with(&sources[*used].module))
                    .collect()
            })
            .collect();
        let reach: Vec<BTreeSet<usize>> = (0..sources.len()).map(|from| reached(&uses, from)).collect();
        let mut circles = BTreeSet::new();
        for from in 0..sources.len() {
            let circle: Vec<&str> = (0..sources.len())
                .filter(|to| reach[from].contains(to) && reach[*to].contains(&from))
                .map(|to| sources[to].file.to_str().unwrap())
                .collect();
            if !circle.is_empty() {
                circles.insert(circle);
            }
        }
        let known: BTreeSet<Vec<&str>> = CIRCLES
            .iter()
            .filter(|circle| circle[0].starts_with(folder))
            .map(|circle| circle.to_vec())
            .collect();
        assert_eq!(circles, known, "circles between the files of {folder}");
        assert!(uses.iter().map(BTreeSet::len).sum::<usize>() > 15, "the sources were not read");
    }
}

/// All that is used from one place on, by way of others too.
fn reached(uses: &[BTreeSet<usize>], from: usize) -> BTreeSet<usize> {
    let (mut reached, mut next) = (BTreeSet::new(), vec![from]);
    while let Some(at) = next.pop() {
        next.extend(uses[at].iter().filter(|used| reached.insert(**used)));
    }
    reached
}

#[test]
fn what_is_seen_knows_nothing_of_adjustment() {
    for package in ["viz", "solver", "engine"] {
        let manifest = std::fs::read_to_string(in_package(package).join("Cargo.toml")).unwrap();
        assert!(manifest.lines().all(|line| !line.starts_with("trackbundle ") && !line.contains("\"..\"")));
        for file in rust_files(&in_package(package).join("src")) {
            let text = std::fs::read_to_string(&file).unwrap();
            assert!(text.lines().all(|line| !names(line, "trackbundle")), "{}", file.display());
        }
    }
}

#[test]
fn paths_are_resolved() {
    let named = |module: &str, text: &str| -> Vec<String> {
        let module = module.split('/').map(str::to_owned).collect();
        let source = Source { file: PathBuf::new(), room: None, module, text: text.to_owned() };
        source.paths_named().into_iter().map(|(_, path)| path.join("/")).collect()
    };
    assert_eq!(named("cli/check", "use crate::files::{A, B};"), ["files/A", "files/B"]);
    assert_eq!(
        named("cli/check", "use crate::{files::A, cloud::{\n    self, mesh::B\n}};"),
        ["files/A", "cloud", "cloud/mesh/B"]
    );
    assert_eq!(named("minimise", "use super::system::Cost;"), ["system/Cost"]);
    assert_eq!(named("system/group", "use super::super::loss::Loss;"), ["loss/Loss"]);
    assert_eq!(named("system/group", "use super::orbit;"), ["system/orbit"]);
    assert_eq!(named("system/group", "let a = self::inner::b(1);"), ["system/group/inner/b"]);
    assert_eq!(named("loss", "#[cfg(test)]\nmod tests {\n use super::Linear;"), ["loss/Linear"]);
    assert_eq!(named("refine", "// crate::reference is only named here"), [""; 0]);
    assert_eq!(named("refine", "let text = \"super:: and \\\" crate::files\";"), [""; 0]);
}

struct Source {
    /// From the package's folder on.
    file: PathBuf,
    /// `None` for lib.rs and main.rs, which only name rooms.
    room: Option<String>,
    /// Where it stands, as in `["system", "group"]`.
    module: Vec<String>,
    text: String,
}

impl Source {
    /// The first line of tests, counted from 1.
    fn tests_from(&self) -> usize {
        let is_test = |line: &str| line.starts_with("#[cfg(test)]");
        self.text.lines().position(is_test).map_or(usize::MAX, |line| line + 1)
    }

    /// The paths inside the package that this source names, from its root on, with line numbers counted from 1.
    /// What follows `#[cfg(test)]` is one module deeper.
    fn paths_named(&self) -> Vec<(usize, Vec<String>)> {
        let code = code_of(&self.text);
        let mut named = Vec::new();
        let mut done = 0;
        while let Some((start, word)) = ["crate::", "super::", "self::"]
            .into_iter()
            .filter_map(|word| Some((done + code[done..].find(word)?, word)))
            .min()
        {
            done = start + word.len();
            if code[..start].ends_with(|c: char| c.is_alphanumeric() || c == '_' || c == ':') {
                continue;
            }
            let line = code[..start].matches('\n').count() + 1;
            let mut module = if word == "crate::" { Vec::new() } else { self.module.clone() };
            if word != "crate::" && line > self.tests_from() {
                module.push("tests".to_owned());
            }
            if word == "super::" {
                module.pop();
                while code[done..].starts_with("super::") {
                    module.pop();
                    done += "super::".len();
                }
            }
            named.extend(expanded(&code[done..], &module).0.into_iter().map(|path| (line, path)));
        }
        named
    }
}

/// A text without comments and without what stands in quotation marks; lines stay.
fn code_of(text: &str) -> String {
    let mut code = String::with_capacity(text.len());
    let mut rest = text.chars().peekable();
    let (mut is_comment, mut is_quoted, mut before) = (false, false, ' ');
    while let Some(c) = rest.next() {
        match c {
            '\n' => is_comment = false,
            '\\' if is_quoted => {
                rest.next();
            }
            '"' if !is_comment && before != '\'' => is_quoted = !is_quoted,
            '/' if !is_quoted && rest.peek() == Some(&'/') => is_comment = true,
            _ => {}
        }
        if c == '\n' || !(is_comment || is_quoted) {
            code.push(c);
        }
        before = c;
    }
    code
}

/// The paths of `a::b::{c, d::{self, e}};`, each behind `inside`, and how much of the text they take.
fn expanded(text: &str, inside: &[String]) -> (Vec<Vec<String>>, usize) {
    let mut path = inside.to_vec();
    let mut at = 0;
    loop {
        let rest = &text[at..];
        if rest.starts_with('{') {
            let mut paths = Vec::new();
            at += 1;
            loop {
                at += text[at..].find(|c: char| !c.is_whitespace() && c != ',').unwrap_or(text.len() - at);
                if at >= text.len() || text[at..].starts_with('}') {
                    return (paths, (at + 1).min(text.len()));
                }
                let (more, taken) = expanded(&text[at..], &path);
                paths.extend(more);
                at += taken;
                let end = text[at..].find([',', '}']).unwrap_or(text.len() - at);
                at += end;
            }
        }
        let end = rest.find(|c: char| !(c.is_alphanumeric() || c == '_')).unwrap_or(rest.len());
        if end == 0 {
            return (vec![path], at);
        }
        if &rest[..end] != "self" {
            path.push(rest[..end].to_owned());
        }
        at += end;
        if !text[at..].starts_with("::") {
            return (vec![path], at);
        }
        at += 2;
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

/// The sources of a house, each in its room.
fn sources(house: &House) -> Vec<Source> {
    let mut sources = sources_in(house.sources);
    for source in &mut sources {
        let is_planned =
            house.plan.iter().any(|(_, room, _)| source.module.first().is_some_and(|m| m == room));
        source.room = source.module.first().filter(|_| is_planned).cloned();
        let is_top = source.module.is_empty() || source.module == ["main"];
        assert!(is_top || is_planned, "{} is in no room of the plan", source.file.display());
    }
    sources
}

/// All sources below a folder of the package.
fn sources_in(folder: &str) -> Vec<Source> {
    let root = in_package(folder);
    rust_files(&root)
        .into_iter()
        .map(|file| {
            let inside = file.strip_prefix(&root).unwrap().with_extension("");
            let mut module: Vec<String> =
                inside.iter().map(|part| part.to_str().unwrap().to_owned()).collect();
            if module.last().is_some_and(|name| name == "mod" || (name == "lib" && module.len() == 1)) {
                module.pop();
            }
            let text = std::fs::read_to_string(&file).unwrap();
            let file = Path::new(folder).join(file.strip_prefix(&root).unwrap());
            Source { file, room: None, module, text }
        })
        .collect()
}
