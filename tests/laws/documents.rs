//! Documents: relative links lead to files and headings, and the README promises what the manifest says.

use crate::support::in_package;
use std::path::{Path, PathBuf};

/// All documents of the repository.
fn documents() -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut folders = vec![in_package("")];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            let is_made = name == "target" || name.starts_with('.') || name.ends_with("-result");
            if path.is_dir() && !is_made {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "md") {
                found.push(path);
            }
        }
    }
    found.sort();
    found
}

/// A document without its blocks of code.
fn prose(text: &str) -> String {
    let mut is_code = false;
    let mut kept = String::new();
    for line in text.lines() {
        let is_fence = line.trim_start().starts_with("```");
        is_code ^= is_fence;
        if !is_code && !is_fence {
            kept.push_str(line);
        }
        kept.push('\n');
    }
    kept
}

/// Targets of links and pictures, with the number of the line, from 1.
fn links(text: &str) -> Vec<(usize, String)> {
    let mut found = Vec::new();
    for (at, line) in prose(text).lines().enumerate() {
        for part in line.split("](").skip(1) {
            if let Some((target, _)) = part.split_once(')') {
                found.push((at + 1, target.to_owned()));
            }
        }
    }
    found
}

/// The anchors of the headings of a document.
fn anchors(text: &str) -> Vec<String> {
    let heading = |line: &str| line.starts_with('#').then(|| anchor(line.trim_start_matches('#').trim()));
    prose(text).lines().filter_map(heading).collect()
}

/// The anchor of a heading: small letters, digits, hyphens; blanks as hyphens.
fn anchor(heading: &str) -> String {
    let kept = heading.to_lowercase();
    let kept = kept.chars().filter(|c| c.is_alphanumeric() || "-_ ".contains(*c));
    kept.map(|c| if c == ' ' { '-' } else { c }).collect()
}

/// Why a link of a document leads nowhere.
fn broken(document: &Path, target: &str) -> Option<String> {
    if target.contains("://") || target.starts_with("mailto:") {
        return None;
    }
    let (file, heading) = target.split_once('#').map_or((target, None), |(file, h)| (file, Some(h)));
    let file = if file.is_empty() { document.to_owned() } else { document.parent().unwrap().join(file) };
    if !file.exists() {
        return Some(format!("{} is missing", file.display()));
    }
    let heading = heading?;
    let text = std::fs::read_to_string(&file).unwrap_or_default();
    let is_there = anchors(&text).iter().any(|anchor| anchor == heading);
    (!is_there).then(|| format!("{} has no heading #{heading}", file.display()))
}

#[test]
fn links_lead_somewhere() {
    let mut checked = 0;
    let mut wrong = Vec::new();
    for document in documents() {
        let text = std::fs::read_to_string(&document).unwrap();
        for (line, target) in links(&text) {
            checked += 1;
            let place = format!("{}:{line}", document.display());
            wrong.extend(broken(&document, &target).map(|why| format!("{place}: {why}")));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(checked > 40, "the documents were not read");
}

#[test]
fn links_that_lead_nowhere_are_found() {
    let readme = in_package("README.md");
    assert_eq!(
        links("a [b](c.md#d)\n```\n[e](f)\n```\n![g](h.png)"),
        [(1, "c.md#d".to_owned()), (5, "h.png".to_owned())]
    );
    assert_eq!(anchor("Rows, and `lenses`"), "rows-and-lenses");
    assert!(broken(&readme, "docs/nowhere.md").is_some());
    assert!(broken(&readme, "docs/equations.md#nowhere").is_some());
    assert!(broken(&readme, "https://rerun.io").is_none());
}

/// The value of a key of the manifest's `[workspace.package]`.
fn of_workspace(key: &str) -> String {
    let manifest: toml::Table = std::fs::read_to_string(in_package("Cargo.toml")).unwrap().parse().unwrap();
    manifest["workspace"]["package"][key].as_str().unwrap().to_owned()
}

#[test]
fn the_readme_promises_the_rust_version_of_the_manifest() {
    let readme = std::fs::read_to_string(in_package("README.md")).unwrap();
    let promised = format!("({} or later)", of_workspace("rust-version"));
    assert!(readme.contains(&promised), "the README does not say {promised}");
}
