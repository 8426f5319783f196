//! The film itself.

use std::path::PathBuf;

/// The film itself, to look at: it has no effect on an adjustment.
#[derive(Clone, Debug, PartialEq)]
pub enum Video {
    /// The image of each frame, where there is one.
    Images(Vec<Option<PathBuf>>),
    /// A film in one file.
    File {
        /// The file.
        path: PathBuf,
        /// Time in the film minus video time \[s\].
        offset_s: f64,
    },
}
