//! A resection in a few numbers and a few lines.

use super::frame::largest_sigmas;
use super::{BridgeReason, FrameResection, Resection, Status};
use crate::initialise::InitialWarning;
use crate::problem::Frame;
use crate::stats::quantile::upper_median;

/// Runs of bridged frames that are named one by one.
const MOST_RUNS: usize = 8;

/// How good a resection is. Medians are over the frames that were resected.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Quality {
    /// Frames whose pose was given.
    pub given: usize,
    /// Frames that were resected.
    pub resected: usize,
    /// Frames that were bridged.
    pub bridged: usize,
    /// Gross errors among the image points of control targets in resected frames.
    pub gross_errors: usize,
    /// Median number of control targets that took part.
    pub median_used: f64,
    /// Median root mean square of the residuals \[px\].
    pub median_rms_px: f64,
    /// Median standard deviation of the position along its worst axis \[m\].
    pub median_sigma_position_m: f64,
    /// Median standard deviation of the attitude about its worst axis \[rad\].
    pub median_sigma_attitude_rad: f64,
}

impl FrameResection {
    /// Standard deviation of the position \[m\] and of the attitude \[rad\], along and about the worst
    /// axis.
    pub fn largest_sigmas(&self) -> [f64; 2] {
        largest_sigmas(&self.covariance)
    }
}

impl Resection {
    /// The resection in a few numbers.
    pub fn quality(&self) -> Quality {
        let count = |is: &dyn Fn(&FrameResection) -> bool| self.frames.iter().filter(|f| is(f)).count();
        let resected = || self.frames.iter().filter(|f| f.status == Status::Resected);
        Quality {
            given: count(&|f| f.status == Status::Given),
            resected: resected().count(),
            bridged: count(&|f| matches!(f.status, Status::Bridged(_))),
            gross_errors: resected().map(|f| f.gross).sum(),
            median_used: median(resected().map(|f| f.used as f64)),
            median_rms_px: median(resected().filter_map(|f| f.rms_px)),
            median_sigma_position_m: median(resected().map(|f| f.largest_sigmas()[0])),
            median_sigma_attitude_rad: median(resected().map(|f| f.largest_sigmas()[1])),
        }
    }
}

/// Zero where there is none.
fn median(values: impl Iterator<Item = f64>) -> f64 {
    upper_median(values.collect()).unwrap_or(0.0)
}

impl BridgeReason {
    /// In one word, for tables.
    pub fn name(self) -> &'static str {
        match self {
            BridgeReason::TooFew => "too_few_targets",
            BridgeReason::OnALine => "targets_on_a_line",
            BridgeReason::PoorlySpread => "targets_poorly_spread",
            BridgeReason::Ambiguous => "ambiguous",
            BridgeReason::Contradictory => "contradictory_targets",
        }
    }
}

/// What is odd about a resection: one warning for each run of bridged frames, for so many as can be read.
pub fn warnings(resection: &Resection, frames: &[Frame]) -> Vec<InitialWarning> {
    let mut runs: Vec<(BridgeReason, std::ops::Range<usize>)> = Vec::new();
    for (at, frame) in resection.frames.iter().enumerate() {
        let Status::Bridged(reason) = frame.status else { continue };
        match runs.last_mut() {
            Some((last, run)) if *last == reason && run.end == at => run.end = at + 1,
            _ => runs.push((reason, at..at + 1)),
        }
    }
    let mut warnings = Vec::new();
    // The longest runs are named, in the order of time.
    let mut by_length: Vec<usize> = (0..runs.len()).collect();
    by_length.sort_by_key(|&k| std::cmp::Reverse(runs[k].1.len()));
    by_length.truncate(MOST_RUNS);
    by_length.sort_unstable();
    for (reason, run) in by_length.iter().map(|&k| &runs[k]) {
        let seen = resection.frames[run.clone()].iter().map(|f| f.seen);
        let (least, most) = (seen.clone().min().unwrap_or(0), seen.max().unwrap_or(0));
        let sigma_m = resection.frames[run.clone()].iter().map(|f| f.largest_sigmas()[0]).fold(0.0, f64::max);
        warnings.push(InitialWarning::Bridged {
            reason: *reason,
            frames: [frames[run.start].number, frames[run.end - 1].number],
            targets: [least, most],
            sigma_m,
        });
    }
    if runs.len() > MOST_RUNS {
        let rest: usize = runs.iter().map(|(_, run)| run.len()).sum::<usize>()
            - by_length.iter().map(|&k| runs[k].1.len()).sum::<usize>();
        warnings.push(InitialWarning::MoreBridged { frames: rest, gaps: runs.len() - MOST_RUNS });
    }
    if resection.spread > 1.0 {
        warnings.push(InitialWarning::TargetsScatter { factor: resection.spread });
    }
    warnings
}
