//! What is seen while a command runs. Nothing that fails here costs a result: it is told, and the exit code says so.

use super::Failure;
use super::options::{OutputOptions, Written};
use trackbundle_viz::{Iteration, Layout, Live, Scene};

/// A session in a viewer, if one is asked for.
pub struct Session {
    live: Option<Live>,
    failures: Vec<String>,
}

impl Session {
    /// Opens the session that is asked for. That it cannot be is told at once, and again at the end.
    pub fn open(output: &OutputOptions) -> Result<Self, Failure> {
        let mut session = Session { live: None, failures: Vec::new() };
        if let Some(viewer) = output.viewer.viewer()? {
            match Live::open(&viewer, Layout::Overview) {
                Ok(live) => session.live = Some(live),
                Err(error) => {
                    output.warn(&[format!("nothing is shown: {error}")]);
                    session.failures.push(error.to_string());
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

    /// Shows the end, once the result is written; an error where something was not shown or recorded.
    pub fn end(mut self, written: Written) -> Result<(), Failure> {
        self.failures.extend(written.unrecorded);
        if let (Some(live), Some(scene)) = (self.live, written.scene)
            && let Err(error) = live.end(scene)
        {
            self.failures.push(error.to_string());
        }
        if self.failures.is_empty() {
            return Ok(());
        }
        let folder = written.folder.display();
        Err(Failure::Other(format!("the result in {folder} is complete, but: {}", self.failures.join("; "))))
    }
}
