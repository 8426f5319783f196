//! The result folder: whole or not at all.

use super::File;
use serde::Deserialize;
use std::io;
use std::path::{Path, PathBuf};

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

    /// Beginnings and ends of the names of its files.
    fn names(self) -> &'static [(&'static str, &'static str)] {
        match self {
            Holds::Result => &[
                ("camera_poses.csv", ""),
                ("report.json", ""),
                ("residuals.csv", ""),
                ("residuals_start.csv", ""),
                ("session.rrd", ""),
                ("states.csv", ""),
                ("targets.csv", ""),
                ("trajectories.csv", ""),
                ("vehicle_points.csv", ""),
                ("vehicle_poses.csv", ""),
                ("shape_", ".ply"),
            ],
            Holds::Evaluation => &[
                ("evaluation.json", ""),
                ("report.html", ""),
                ("shape_distances.csv", ""),
                ("track_differences.csv", ""),
                ("evo_", ".zip"),
                ("poses_", ".kitti"),
                ("reference_", ".kitti"),
                ("reference_", ".tum"),
                ("scan_", ".ply"),
                ("shape_", ".ply"),
                ("track_", ".tum"),
            ],
            Holds::Problem => &[],
            Holds::Study => &[
                ("cells.csv", ""),
                ("plan.csv", ""),
                ("report.html", ""),
                ("study.json", ""),
                ("summary.csv", ""),
                ("videos.csv", ""),
            ],
        }
    }

    /// Whether a file of this name can be its own.
    fn owns(self, name: &str) -> bool {
        self.names().iter().any(|(begin, end)| match *end {
            "" => name == *begin,
            end => name.starts_with(begin) && name.ends_with(end),
        })
    }
}

/// The key in it by which it is known as ours.
pub const PROGRAM_KEY: &str = "program";
/// Its value.
pub const PROGRAM: &str = "trackbundle";

/// A result folder in the making, beside its place. Dropped before [`Staged::publish`], it leaves
/// nothing behind.
#[derive(Debug)]
pub struct Staged {
    target: PathBuf,
    stage: PathBuf,
}

/// Why a place cannot take a result.
#[derive(Debug, thiserror::Error)]
pub enum PlaceError {
    /// Something is there that is not a result, and it is not touched.
    #[error(
        "{0} exists{what}; it is left as it is (choose another place with --out)",
        what = match .1 {
            Holds::Result => " and is not a result of trackbundle, or holds other files too",
            Holds::Evaluation => " and is not an evaluation of trackbundle, or holds other files too",
            Holds::Study => " and is not a study of trackbundle, or holds other files too",
            Holds::Problem => "",
        }
    )]
    Occupied(PathBuf, Holds),
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
        Ok(_) if is_own(target, holds) => Ok(()),
        Ok(_) => Err(PlaceError::Occupied(target.to_owned(), holds)),
    }
}

/// What every folder of this program says in the file that it is known by.
#[derive(Default, Deserialize)]
struct Made {
    program: String,
}

/// Whether a folder was written by this program and holds nothing else.
fn is_own(folder: &Path, holds: Holds) -> bool {
    let Ok(text) = std::fs::read_to_string(folder.join(holds.known_by())) else { return false };
    let made: Made = serde_json::from_str(&text).unwrap_or_default();
    let is_ours = |name: &str| holds.owns(name);
    made.program == PROGRAM
        && std::fs::read_dir(folder).is_ok_and(|mut entries| {
            entries.all(|entry| entry.is_ok_and(|entry| entry.file_name().to_str().is_some_and(is_ours)))
        })
}

impl Staged {
    /// Begins a folder at `target`.
    pub fn begin(target: &Path, holds: Holds) -> Result<Self, PlaceError> {
        check_place(target, holds)?;
        // A link to a result stays a link.
        let target = std::fs::canonicalize(target).unwrap_or_else(|_| target.to_owned());
        let stage = beside(&target, "partial");
        let io = |source| PlaceError::Io { path: target.clone(), source };
        if let Some(parent) = stage.parent() {
            std::fs::create_dir_all(parent).map_err(io)?;
        }
        std::fs::create_dir(&stage).map_err(io)?;
        Ok(Staged { target, stage })
    }

    /// Where a file of the folder is made.
    pub fn path(&self, name: &str) -> PathBuf {
        self.stage.join(name)
    }

    /// Writes a file of the folder, which may be in a folder of it.
    pub fn write(&self, (name, bytes): &File) -> io::Result<()> {
        let path = self.path(name);
        if let Some(parent) = path.parent() {
            std::fs::create_dir_all(parent)?;
        }
        std::fs::write(path, bytes)
    }

    /// Puts everything in its place; a result that stood there is replaced.
    pub fn publish(self) -> io::Result<PathBuf> {
        let old = beside(&self.target, "old");
        let replaces = std::fs::symlink_metadata(&self.target).is_ok();
        if replaces {
            std::fs::rename(&self.target, &old)?;
        }
        if let Err(error) = std::fs::rename(&self.stage, &self.target) {
            if replaces {
                std::fs::rename(&old, &self.target)?;
            }
            return Err(error);
        }
        if replaces {
            std::fs::remove_dir_all(&old)?;
        }
        Ok(self.target.clone())
    }
}

impl Drop for Staged {
    fn drop(&mut self) {
        // Nothing is left to do about a failure here.
        let _ = std::fs::remove_dir_all(&self.stage);
    }
}

/// Makes a single file with `write`: it appears whole or not at all. The error is told with what it is about.
pub fn whole_file<E: std::fmt::Display>(
    target: &Path,
    write: impl FnOnce(&Path) -> Result<(), E>,
) -> Result<(), String> {
    let stage = beside(target, "partial");
    let told = |error: &dyn std::fmt::Display| format!("{}: {error}", target.display());
    let written = write(&stage).map_err(|error| told(&error));
    let moved = written.and_then(|()| std::fs::rename(&stage, target).map_err(|error| told(&error)));
    if moved.is_err() {
        // Nothing is left to do about a failure here.
        let _ = std::fs::remove_file(&stage);
    }
    moved
}

/// A hidden place in the same folder, so that moving from there is one step.
fn beside(target: &Path, what: &str) -> PathBuf {
    let name = target.file_name().unwrap_or_default().to_string_lossy();
    target.with_file_name(format!(".{name}.{what}-{}", std::process::id()))
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

    #[test]
    fn a_result_appears_whole_and_replaces_an_older_one() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("deep/result");
        for text in ["one", "two"] {
            let staged = Staged::begin(&target, Holds::Result).unwrap();
            staged
                .write(&file("report.json", &format!("{{\"program\": \"trackbundle\", \"n\": \"{text}\"}}")))
                .unwrap();
            let cloud = format!("shape_{text}.ply");
            staged.write(&file(&cloud, text)).unwrap();
            assert!(!target.join(&cloud).exists());
            staged.publish().unwrap();
            assert_eq!(names(&target), ["report.json".to_owned(), cloud]);
            assert_eq!(names(target.parent().unwrap()), ["result"]);
        }
    }

    #[test]
    fn what_is_given_up_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let staged = Staged::begin(&folder.path().join("result"), Holds::Result).unwrap();
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
    fn a_folder_that_is_no_result_is_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        assert!(
            matches!(Staged::begin(folder.path(), Holds::Result), Err(PlaceError::Occupied(..))),
            "empty"
        );
        std::fs::write(folder.path().join("report.json"), "{\"program\": \"other\"}").unwrap();
        assert!(
            matches!(Staged::begin(folder.path(), Holds::Result), Err(PlaceError::Occupied(..))),
            "another's"
        );
        std::fs::write(folder.path().join("report.json"), "{\"program\": \"trackbundle\"}").unwrap();
        assert!(check_place(folder.path(), Holds::Result).is_ok());
        std::fs::write(folder.path().join("notes.txt"), "mine").unwrap();
        assert!(
            matches!(Staged::begin(folder.path(), Holds::Result), Err(PlaceError::Occupied(..))),
            "with a note"
        );
        assert_eq!(names(folder.path()), ["notes.txt", "report.json"]);
    }

    #[test]
    fn results_and_evaluations_do_not_replace_each_other() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("evaluation.json"), "{\"program\": \"trackbundle\"}").unwrap();
        std::fs::write(folder.path().join("report.html"), "").unwrap();
        assert!(check_place(folder.path(), Holds::Evaluation).is_ok());
        assert!(matches!(check_place(folder.path(), Holds::Result), Err(PlaceError::Occupied(..))));
        for name in [
            "evo_car1.zip",
            "poses_car1.kitti",
            "reference_car1.kitti",
            "reference_car1.tum",
            "scan_car1.ply",
            "shape_car1.ply",
            "shape_distances.csv",
            "track_car1.tum",
            "track_differences.csv",
        ] {
            assert!(Holds::Evaluation.owns(name), "{name}");
            std::fs::write(folder.path().join(name), "").unwrap();
        }
        assert!(check_place(folder.path(), Holds::Evaluation).is_ok());
        for name in ["scan_car1.csv", "car1.zip", "track_car1.kitti", "track_differences_car1.csv"] {
            assert!(!Holds::Evaluation.owns(name), "{name}");
        }
    }
}
