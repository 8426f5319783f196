//! The result folder: whole or not at all.

use super::File;
use crate::disk::{self, Place, PlaceFault, Published};
use serde::Deserialize;
use std::collections::BTreeSet;
use std::fs::{DirEntry, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// So many files are named that are not its own.
const MOST_NAMED: usize = 5;

/// What a folder holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Holds {
    /// The result of an adjustment, or a first estimate.
    Result,
    /// The comparison of a result with references.
    Evaluation,
    /// A simulated problem; none is ever replaced, since it may have been worked on.
    Problem,
    /// What accuracy is to be expected.
    Study,
}

impl Holds {
    /// The file by which a folder is known; it names the program.
    fn known_by(self) -> &'static str {
        match self {
            Holds::Result => "report.json",
            Holds::Evaluation => "evaluation.json",
            Holds::Problem => "problem.toml",
            Holds::Study => "study.json",
        }
    }

    fn article_and_name(self) -> &'static str {
        match self {
            Holds::Result => "a result",
            Holds::Evaluation => "an evaluation",
            Holds::Problem => "a problem",
            Holds::Study => "a study",
        }
    }
}

/// The key in it by which it is known as ours.
pub const PROGRAM_KEY: &str = "program";
/// Its value.
pub const PROGRAM: &str = "trackbundle";

/// A place for a folder, and the folder in the making. Dropped before [`Staged::publish`], it leaves nothing behind.
#[derive(Debug)]
pub struct Staged {
    place: Place,
    holds: Holds,
    /// Where it is made, once something is in it.
    stage: Option<PathBuf>,
    /// The names of its files.
    files: BTreeSet<String>,
}

/// Why a place cannot take a result.
#[derive(Debug, thiserror::Error)]
pub enum PlaceError {
    /// Something is there that is not a result, and it is not touched.
    #[error(
        "{0} exists{what}; it is left as it is (choose another place with --out)",
        what = match .1 {
            Holds::Problem => String::new(),
            holds => format!(
                " and is not {} of trackbundle, or holds other files too ({})", holds.article_and_name(), .2
            ),
        }
    )]
    Occupied(PathBuf, Holds, String),
    /// Another process is making a result for it.
    #[error("{0}: another trackbundle is at work on this place")]
    Busy(PathBuf),
    /// The place cannot be used.
    #[error("{path}: {source}")]
    Io {
        /// Where.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
}

/// Refuses a place where something else stands.
pub fn check_place(target: &Path, holds: Holds) -> Result<(), PlaceError> {
    match std::fs::symlink_metadata(target) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        Err(source) => Err(PlaceError::Io { path: target.to_owned(), source }),
        Ok(_) => {
            let occupied = |why| PlaceError::Occupied(target.to_owned(), holds, why);
            what_else(target, holds).map_or(Ok(()), |why| Err(occupied(why)))
        }
    }
}

/// What every folder of this program says in the file that it is known by.
#[derive(Default, Deserialize)]
#[serde(default)]
struct Made {
    program: String,
    files: Vec<String>,
}

/// Why a folder is not one that was written by this program and holds nothing else: only what it lists itself is its own.
fn what_else(folder: &Path, holds: Holds) -> Option<String> {
    let known_by = holds.known_by();
    if holds == Holds::Problem {
        return Some(String::new());
    }
    let Ok(text) = disk::read(&folder.join(known_by)) else { return Some(format!("it has no {known_by}")) };
    let made: Made = serde_json::from_slice(&text).unwrap_or_default();
    if made.program != PROGRAM {
        return Some(format!("{known_by} is not of this program"));
    }
    let listed: BTreeSet<&str> = made.files.iter().map(String::as_str).chain([known_by]).collect();
    let entries = match std::fs::read_dir(folder) {
        Ok(entries) => entries,
        Err(error) => return Some(error.to_string()),
    };
    let other = |entry: io::Result<DirEntry>| {
        let Ok(entry) = entry else { return Some("what cannot be read".to_owned()) };
        let name = entry.file_name();
        let is_file = entry.file_type().is_ok_and(|kind| kind.is_file());
        let is_listed = name.to_str().is_some_and(|name| listed.contains(name));
        (!is_file || !is_listed).then(|| name.to_string_lossy().into_owned())
    };
    let mut others: Vec<String> = entries.filter_map(other).collect();
    others.sort();
    let more = others.len().saturating_sub(MOST_NAMED);
    others.truncate(MOST_NAMED);
    if more > 0 {
        others.push(format!("{more} more"));
    }
    (!others.is_empty()).then(|| format!("{known_by} does not list {}", others.join(", ")))
}

impl Staged {
    /// Takes the place, and begins a folder for it.
    pub fn begin(target: &Path, holds: Holds) -> Result<Self, PlaceError> {
        check_place(target, holds)?;
        Ok(Staged { place: take(target)?, holds, stage: None, files: BTreeSet::new() })
    }

    /// Where it will stand.
    pub fn target(&self) -> &Path {
        self.place.target()
    }

    /// Left-overs of processes that died, which were cleared up.
    pub fn cleared(&self) -> &[PathBuf] {
        &self.place.cleared
    }

    /// Where a file of the folder is made by others.
    pub fn path(&mut self, name: &str) -> io::Result<PathBuf> {
        let stage = match self.stage.take() {
            Some(stage) => stage,
            None => self.place.stage_folder()?,
        };
        let path = stage.join(name);
        self.stage = Some(stage);
        self.files.insert(name.to_owned());
        Ok(path)
    }

    /// Takes a file away again.
    pub fn take_back(&mut self, name: &str) {
        if self.files.remove(name)
            && let Some(stage) = &self.stage
        {
            // Nothing is left to do about a failure here.
            let _ = std::fs::remove_file(stage.join(name));
        }
    }

    /// The names of its files so far, with that by which it is known: what the folder lists of itself.
    pub fn files(&self) -> Vec<String> {
        let known_by = Some(self.holds.known_by().to_owned());
        self.files.iter().cloned().chain(known_by).collect::<BTreeSet<_>>().into_iter().collect()
    }

    /// Writes a file of the folder, which may be in a folder of it.
    pub fn write(&mut self, (name, bytes): &File) -> io::Result<()> {
        let path = self.path(name)?;
        if let Some(parent) = path.parent() {
            std::fs::create_dir_all(parent)?;
        }
        let mut file = OpenOptions::new().write(true).create_new(true).open(path)?;
        file.write_all(bytes)
    }

    /// Puts everything in its place; a result that stood there is replaced. What is written after that is of a new
    /// folder for the same place.
    pub fn publish(&mut self) -> io::Result<Published> {
        let published = self.place.publish()?;
        self.files.clear();
        self.stage = None;
        Ok(published)
    }

    /// Writes the file by which the folder is known.
    pub fn write_known(&mut self, text: String) -> io::Result<()> {
        self.write(&(self.holds.known_by().to_owned(), text.into_bytes()))
    }

    /// Replaces the file by which it is known in what was published.
    pub fn replace_known(&mut self, text: String) -> io::Result<()> {
        self.write_known(text)?;
        let name = self.holds.known_by();
        std::fs::rename(self.path(name)?, self.place.target().join(name))
    }
}

fn take(target: &Path) -> Result<Place, PlaceError> {
    Place::take(target).map_err(|fault| match fault {
        PlaceFault::Busy => PlaceError::Busy(target.to_owned()),
        PlaceFault::Io(source) => PlaceError::Io { path: target.to_owned(), source },
    })
}

/// Whether a single file can be made at this place.
pub fn whole_file_can_be(target: &Path) -> Result<(), PlaceError> {
    take(target).map(|_| ())
}

/// Makes a single file with `write`: it appears whole or not at all. The error is told with what it is about.
pub fn whole_file<E: std::fmt::Display>(
    target: &Path,
    write: impl FnOnce(&Path) -> Result<(), E>,
) -> Result<(), String> {
    let told = |error: &dyn std::fmt::Display| format!("{}: {error}", target.display());
    let mut place = take(target).map_err(|error| error.to_string())?;
    let stage = place.stage_file().map_err(|error| told(&error))?;
    write(&stage).map_err(|error| told(&error))?;
    place.publish().map(|_| ()).map_err(|error| told(&error))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> = std::fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    fn file(name: &str, text: &str) -> File {
        (name.to_owned(), text.as_bytes().to_vec())
    }

    fn of(program: &str, files: &[&str]) -> Vec<u8> {
        serde_json::json!({ "program": program, "files": files }).to_string().into_bytes()
    }

    #[test]
    fn a_result_appears_whole_and_replaces_an_older_one() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("deep/result");
        for text in ["one", "two"] {
            let mut staged = Staged::begin(&target, Holds::Result).unwrap();
            let cloud = format!("shape_{text}.ply");
            staged.write(&file(&cloud, text)).unwrap();
            assert_eq!(staged.files(), ["report.json".to_owned(), cloud.clone()]);
            staged.write(&("report.json".to_owned(), of("trackbundle", &["report.json", &cloud]))).unwrap();
            assert!(!target.join(&cloud).exists());
            staged.publish().unwrap();
            assert_eq!(names(&target), ["report.json".to_owned(), cloud]);
            // Once more from the same place: what is in the making is empty again.
            assert_eq!(staged.files(), ["report.json"]);
            staged
                .replace_known(String::from_utf8(of("trackbundle", &[&format!("shape_{text}.ply")])).unwrap())
                .unwrap();
            drop(staged);
            assert_eq!(names(target.parent().unwrap()), ["result"]);
            assert_eq!(names(&target).len(), 2);
        }
    }

    #[test]
    fn what_is_given_up_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let mut staged = Staged::begin(&folder.path().join("result"), Holds::Result).unwrap();
        staged.write(&file("a", "b")).unwrap();
        drop(staged);
        assert!(names(folder.path()).is_empty());
        let single = folder.path().join("x.rrd");
        let half = whole_file(&single, |place| {
            std::fs::write(place, "half").unwrap();
            Err("the disk is full")
        });
        assert_eq!(half, Err(format!("{}: the disk is full", single.display())));
        assert!(names(folder.path()).is_empty());
        whole_file(&single, |place| std::fs::write(place, "whole")).unwrap();
        assert_eq!(names(folder.path()), ["x.rrd"]);
    }

    #[test]
    fn a_place_in_use_is_told() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("result");
        let _first = Staged::begin(&target, Holds::Result).unwrap();
        assert!(matches!(Staged::begin(&target, Holds::Result), Err(PlaceError::Busy(_))));
    }

    fn refused(folder: &Path, holds: Holds) -> String {
        check_place(folder, holds).unwrap_err().to_string()
    }

    #[test]
    fn what_a_folder_does_not_list_itself_is_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let put = |name: &str, bytes: &[u8]| std::fs::write(folder.path().join(name), bytes).unwrap();
        assert!(refused(folder.path(), Holds::Result).contains("it has no report.json"), "empty");
        put("report.json", &of("other", &[]));
        assert!(refused(folder.path(), Holds::Result).contains("not of this program"));
        put("report.json", &of("trackbundle", &["shape_car1.ply", "states.csv"]));
        put("shape_car1.ply", b"");
        check_place(folder.path(), Holds::Result).unwrap();
        // Whatever its name looks like.
        put("shape_car1_cleaned.ply", b"mine");
        assert!(refused(folder.path(), Holds::Result).contains("does not list shape_car1_cleaned.ply)"));
        std::fs::remove_file(folder.path().join("shape_car1_cleaned.ply")).unwrap();
        std::fs::create_dir(folder.path().join("states.csv")).unwrap();
        assert!(refused(folder.path(), Holds::Result).contains("does not list states.csv)"), "a folder");
        for at in 0..9 {
            put(&format!("notes{at}.txt"), b"mine");
        }
        assert!(refused(folder.path(), Holds::Result).contains("notes3.txt, notes4.txt, 5 more)"));
    }

    #[test]
    fn results_and_evaluations_do_not_replace_each_other() {
        let folder = tempfile::tempdir().unwrap();
        let put = |name: &str, bytes: &[u8]| std::fs::write(folder.path().join(name), bytes).unwrap();
        put("evaluation.json", &of("trackbundle", &["evaluation.json", "report.html"]));
        put("report.html", b"");
        check_place(folder.path(), Holds::Evaluation).unwrap();
        for holds in [Holds::Result, Holds::Study, Holds::Problem] {
            assert!(matches!(check_place(folder.path(), holds), Err(PlaceError::Occupied(..))));
        }
    }
}
