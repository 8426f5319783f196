//! In place of recordings, in a build without Rerun.

use crate::{Iteration, Layout, RecordingError, Scene, Viewer};
use std::path::Path;

/// There is no recording.
pub fn save(_scenes: &[Scene], _layout: Layout, _file: &Path) -> Result<(), RecordingError> {
    Err(RecordingError::NotBuilt)
}

/// There is no session.
pub fn show(_scenes: Vec<Scene>, _layout: Layout, _viewer: &Viewer) -> Result<(), RecordingError> {
    Err(RecordingError::NotBuilt)
}

/// A session that does not come about.
#[derive(Debug)]
pub struct Live(std::convert::Infallible);

impl Live {
    /// There is no session.
    pub fn open(_viewer: &Viewer, _layout: Layout) -> Result<Live, RecordingError> {
        Err(RecordingError::NotBuilt)
    }

    /// Never called.
    pub fn begin(&self, _scene: Scene) {}

    /// Never called.
    pub fn iteration(&self, _iteration: Iteration) {}

    /// Never called.
    pub fn end(self, _scene: Scene) -> Result<(), RecordingError> {
        match self.0 {}
    }
}
