//! What is seen while a command runs, and what becomes of its end. Nothing that fails here costs a result: it is told,
//! and the exit code says so.

use super::Failure;
use super::options::{OutputOptions, Written};
use super::output::print;
use crate::pipeline::guarded;
use crate::report::folder::Staged;
use crate::report::{FailedStepReport, Report};
use trackbundle_viz::{Iteration, Layout, Live, Scene};

/// A session in a viewer, if one is asked for.
pub struct Session {
    live: Option<Live>,
    failure: Option<String>,
}

impl Session {
    /// Opens the session that is asked for. That it cannot be is told at once, and again at the end.
    pub fn open(output: &OutputOptions) -> Result<Self, Failure> {
        let mut session = Session { live: None, failure: None };
        if let Some(viewer) = output.viewer.viewer()? {
            match Live::open(&viewer, Layout::Overview) {
                Ok(live) => session.live = Some(live),
                Err(error) => {
                    output.warn(&[format!("nothing is shown: {error}")]);
                    session.failure = Some(error.to_string());
                }
            }
        }
        Ok(session)
    }

    /// Shows the start.
    pub fn begin(&self, scene: impl FnOnce() -> Scene) {
        if let Some(live) = &self.live {
            live.begin(scene());
        }
    }

    /// Shows an iteration.
    pub fn iteration(&self, iteration: &Iteration) {
        if let Some(live) = &self.live {
            live.iteration(iteration.clone());
        }
    }

    /// Shows the end, once the result is written. Steps that failed are added to what was written, and are an error.
    pub fn end(
        self,
        output: &OutputOptions,
        written: Written,
        staged: &mut Staged,
        report: &mut Report,
    ) -> Result<(), Failure> {
        let ended = match (self.live, written.scene) {
            (Some(live), Some(scene)) => guarded(|| live.end(scene).map_err(|error| error.to_string())),
            _ => Ok(()),
        };
        for why in self.failure.into_iter().chain(ended.err()) {
            report.fail("viewer", why);
        }
        let folder = written.folder.display();
        let told = |failed: &FailedStepReport| match failed.step.as_str() {
            "viewer" | "recording" => failed.why.clone(),
            step => format!("{step}: {}", failed.why),
        };
        let failed: Vec<String> = report.failed_steps.iter().map(told).collect();
        if failed.is_empty() {
            return if output.json { print(&report.to_json()) } else { Ok(()) };
        }
        let json = report.to_json();
        let replaced = staged.replace_known(json.clone());
        if output.json {
            print(&json)?;
        }
        let not_told =
            replaced.err().map_or(String::new(), |error| format!(" (report.json does not say so: {error})"));
        Err(Failure::Other(format!(
            "the result in {folder} is complete, but: {}{not_told}",
            failed.join("; ")
        )))
    }
}
