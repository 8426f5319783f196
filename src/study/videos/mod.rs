//! Videos of all kinds, drawn at random: are results as right as they say, and does the verdict hear where not?
//!
//! ```text
//! scenario + what is drawn -> video -> adjustment, verdict -> against the truth, in own standard deviations -> tables
//! ```
//!
//! Unlike the runs of a Monte Carlo no two videos are of the same plan, and each is held against what its own result
//! says of itself: no prediction is needed.

mod judged;
mod kept;
mod summary;

pub use super::draw::VideoSettings;
use super::settings::Study;
use super::{CHUNK, Kept, StudyError, Told, side_by_side};
use crate::pipeline::Options;
use crate::refine::{MotionPrior, MotionPriors};
pub use judged::{COMPARED, Difference, JudgedVehicle, JudgedVideo};
use std::sync::atomic::{AtomicUsize, Ordering};
pub use summary::{Line, lines, summary_table, video_table};

/// The videos of a cell, in their order; why there is no result of one.
pub type Videos = Vec<Result<JudgedVideo, String>>;

/// What came out of every video of every cell. `told` hears of each step.
pub fn run_videos(
    study: &Study,
    settings: &VideoSettings,
    kept: &Kept,
    told: Told<'_>,
) -> Result<Vec<Videos>, StudyError> {
    let cells = study.cells();
    let chunks = study.runs.div_ceil(CHUNK);
    let mut options = Options::default();
    if !settings.has_motion {
        options.refine.motion = MotionPriors { camera: MotionPrior::Off, vehicle: MotionPrior::Off };
    }
    let file = |at: usize, chunk: usize| format!("cell-{at:06}-videos-{chunk:06}");
    let done = AtomicUsize::new(0);
    side_by_side(cells.len() * chunks, &|task| {
        let (at, chunk) = (task % cells.len(), task / cells.len());
        if kept.read::<Videos>(&file(at, chunk)).is_none() {
            let numbers = chunk * CHUNK..((chunk + 1) * CHUNK).min(study.runs);
            let video = |number: usize| {
                let drawn = study.drawn(settings, &cells[at], number);
                let scenario = study.scenario_with(&cells[at], &drawn)?;
                let seed = scenario.seed.wrapping_add(study.video_number(&cells[at], number) as u64);
                judged::judge(&scenario, seed, &options)
            };
            kept.write(&file(at, chunk), &numbers.map(video).collect::<Videos>())?;
        }
        told(done.fetch_add(1, Ordering::Relaxed) + 1, cells.len() * chunks);
        Ok(())
    })?;
    (0..cells.len())
        .map(|at| {
            let mut videos = Videos::new();
            for chunk in 0..chunks {
                videos.extend(kept.read_again::<Videos>(&file(at, chunk))?);
            }
            Ok(videos)
        })
        .collect()
}
