//! How accurate will it be: scenarios over a grid of their parameters, predicted by covariance and confirmed by
//! Monte Carlo.
//!
//! ```text
//! STUDY.toml -> cells -> prediction of each (truth -> covariance)      -> summary -> table, page, plan
//!                     -> runs of each (truth + errors -> adjustment)  /
//! ```
//!
//! What is done is kept in a folder until all is, so that a study that was interrupted goes on. Whatever is computed is
//! read back from there: the numbers are the same in one go and in many.

pub mod cell;
pub mod draw;
mod parts;
pub mod plan;
pub mod settings;
pub mod summary;
pub mod videos;

use crate::disk;
use crate::simulate::read_scenario;
pub use cell::{Prediction, RunErrors};
use cell::{Prepared, predict};
use parts::Part;
pub use settings::{Axis, Cell, Study, Wanted, read_study, told};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, OnceLock};

/// What accuracy a flight is expected to reach, from its scenario and without an image.
///
/// ```
/// let predicted = trackbundle::predict_scenario("problems/scenarios/paper.toml")?;
/// let [plan_m, height_m, ..] = predicted.sigmas[0];
/// assert!(plan_m > 0.0 && plan_m < 0.5 && height_m > 0.0);
/// # Ok::<(), String>(())
/// ```
///
/// # Errors
///
/// Text: the scenario is not valid, shows too little of a vehicle, or leaves something undetermined.
pub fn predict_scenario(scenario: impl AsRef<Path>) -> Result<Prediction, String> {
    let scenario = read_scenario(scenario.as_ref()).map_err(|findings| findings.to_string())?;
    predict(&scenario).map(|(prediction, _)| prediction)
}

/// Runs that are kept in one file.
const CHUNK: usize = 10;
/// The file that says what the folder is for.
const INPUTS: &str = "inputs.toml";

/// What came out of a cell.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// What is expected, or why nothing can be said.
    pub prediction: Result<Prediction, String>,
    /// The runs of its Monte Carlo.
    pub runs: Vec<Result<RunErrors, String>>,
}

/// Why a study could not go on.
#[derive(Debug, thiserror::Error)]
pub enum StudyError {
    /// A folder of another study is in the way.
    #[error(
        "{0} holds what is done of another study, or of this one before its files changed; it is left as it is (remove it, or choose another place with --out)"
    )]
    Other(PathBuf),
    /// A file.
    #[error("{0}: {1}")]
    Io(PathBuf, io::Error),
}

/// What is done of a study.
pub struct Kept {
    folder: PathBuf,
}

impl Kept {
    /// Goes on with what is in `folder`, or begins there.
    pub fn open(folder: &Path, study: &Study) -> Result<Kept, StudyError> {
        let failed = |error| StudyError::Io(folder.to_owned(), error);
        // Another version may compute other numbers.
        let inputs =
            format!("# trackbundle {}, {} runs\n{}", env!("CARGO_PKG_VERSION"), study.runs, study.inputs);
        let kept = Kept { folder: folder.to_owned() };
        if std::fs::symlink_metadata(folder).is_err() {
            std::fs::create_dir_all(folder).map_err(failed)?;
        }
        match disk::read_text(&folder.join(INPUTS)) {
            Ok(text) if text == inputs => {}
            Err(_) if kept.was_just_begun() => kept.save(INPUTS, &inputs).map_err(failed)?,
            _ => return Err(StudyError::Other(folder.to_owned())),
        }
        Ok(kept)
    }

    /// Whether there is nothing in it, or inputs that were not written whole.
    fn was_just_begun(&self) -> bool {
        let is_begun = |entry: io::Result<std::fs::DirEntry>| {
            entry.is_ok_and(|entry| entry.file_name().to_str() == Some(&unfinished(INPUTS)))
        };
        std::fs::read_dir(&self.folder).is_ok_and(|mut entries| entries.all(is_begun))
    }

    /// Writes a file: all of it, or nothing under its name.
    fn save(&self, name: &str, text: &str) -> io::Result<()> {
        let place = self.folder.join(unfinished(name));
        std::fs::write(&place, text)?;
        std::fs::rename(&place, self.folder.join(name))
    }

    fn read<P: Part>(&self, name: &str) -> Option<P> {
        P::from_text(&disk::read_text(&self.folder.join(name)).ok()?)
    }

    /// What was kept before; it is an error where it is gone.
    fn read_again<P: Part>(&self, name: &str) -> Result<P, StudyError> {
        let gone = || io::Error::other("a file that was just written is gone");
        self.read(name).ok_or_else(|| StudyError::Io(self.folder.clone(), gone()))
    }

    fn write<P: Part>(&self, name: &str, part: &P) -> Result<(), StudyError> {
        self.save(name, &part.to_text()).map_err(|error| StudyError::Io(self.folder.clone(), error))
    }

    /// Takes it away, when the study is whole.
    pub fn remove(self) -> io::Result<()> {
        std::fs::remove_dir_all(self.folder)
    }
}

/// What a file is called until it is whole.
fn unfinished(name: &str) -> String {
    format!("{name}.unfinished")
}

/// How far a study is: steps that are done, of how many.
pub type Told<'a> = &'a (dyn Fn(usize, usize) + Sync);

/// What came out of every cell, in their order. `told` hears of each step.
pub fn run(study: &Study, kept: &Kept, told: Told<'_>) -> Result<Vec<Outcome>, StudyError> {
    let cells = study.cells();
    let chunks = study.runs.div_ceil(CHUNK);
    let all = cells.len() * (1 + chunks);
    let done = AtomicUsize::new(0);
    let step = || told(done.fetch_add(1, Ordering::Relaxed) + 1, all);
    let prepared: Vec<OnceLock<Result<Prepared, String>>> = cells.iter().map(|_| OnceLock::new()).collect();
    let prediction_file = |at: usize| format!("cell-{at:06}");
    let scenario = |at: usize| study.scenario(&cells[at]);
    side_by_side(cells.len(), &|at| {
        if kept.read::<Result<Prediction, String>>(&prediction_file(at)).is_none() {
            let found = scenario(at).and_then(|scenario| predict(&scenario));
            let (prediction, own) = match found {
                Ok((prediction, own)) => (Ok(prediction), Ok(own)),
                Err(why) => (Err(why.clone()), Err(why)),
            };
            kept.write(&prediction_file(at), &prediction)?;
            if chunks > 0 {
                let _ = prepared[at].set(own);
            }
        }
        step();
        Ok(())
    })?;
    let chunk_file = |at: usize, chunk: usize| format!("cell-{at:06}-runs-{chunk:06}");
    let is_missing = |at: usize, chunk: usize| {
        kept.read::<Vec<Result<RunErrors, String>>>(&chunk_file(at, chunk)).is_none()
    };
    // Of cells whose prediction was kept, but not all of their runs.
    side_by_side(cells.len(), &|at| {
        if prepared[at].get().is_none() && (0..chunks).any(|chunk| is_missing(at, chunk)) {
            let found = scenario(at).and_then(|scenario| predict(&scenario));
            let _ = prepared[at].set(found.map(|(_, own)| own));
        }
        Ok(())
    })?;
    side_by_side(cells.len() * chunks, &|task| {
        let (at, chunk) = (task / chunks, task % chunks);
        if is_missing(at, chunk) {
            let numbers = chunk * CHUNK..((chunk + 1) * CHUNK).min(study.runs);
            let runs: Vec<Result<RunErrors, String>> = match prepared[at].get() {
                Some(Ok(own)) => numbers.map(|number| own.run(number as u64)).collect(),
                // The cell says why.
                _ => Vec::new(),
            };
            kept.write(&chunk_file(at, chunk), &runs)?;
        }
        step();
        Ok(())
    })?;
    (0..cells.len())
        .map(|at| {
            let prediction = kept.read_again(&prediction_file(at))?;
            let mut runs: Vec<Result<RunErrors, String>> = Vec::new();
            for chunk in 0..chunks {
                runs.extend(kept.read_again::<Vec<_>>(&chunk_file(at, chunk))?);
            }
            Ok(Outcome { prediction, runs })
        })
        .collect()
}

/// Does tasks on as many threads as there are to compute with; the first task that failed says why. These are threads
/// of their own: one of the pool that waits for a part of its task would take up another task meanwhile, within
/// it another, and so on.
fn side_by_side(
    tasks: usize,
    task: &(dyn Fn(usize) -> Result<(), StudyError> + Sync),
) -> Result<(), StudyError> {
    let (next, failed) = (AtomicUsize::new(0), Mutex::new(None::<(usize, StudyError)>));
    std::thread::scope(|scope| {
        for _ in 0..rayon::current_num_threads().min(tasks) {
            scope.spawn(|| {
                loop {
                    let at = next.fetch_add(1, Ordering::Relaxed);
                    if at >= tasks {
                        break;
                    }
                    let Err(error) = task(at) else { continue };
                    let mut failed = failed.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
                    if failed.as_ref().is_none_or(|(first, _)| at < *first) {
                        *failed = Some((at, error));
                    }
                    // Nothing more is begun.
                    next.store(tasks, Ordering::Relaxed);
                }
            });
        }
    });
    match failed.into_inner().unwrap_or_else(|poisoned| poisoned.into_inner()) {
        Some((_, error)) => Err(error),
        None => Ok(()),
    }
}
