//! Why there is no recording, or no session.

/// A recording or a session in the viewer that did not come about.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RecordingError {
    /// The recording could not be written.
    #[error("the recording could not be written: {0}")]
    File(String),
    /// Something does not fit the viewer's types.
    #[error("the recording could not be encoded: {0}")]
    Encoding(String),
    /// There is no viewer, or it did not start.
    #[error("{0}")]
    NoViewer(String),
    /// The viewer went away, or does not take what it is sent.
    #[error("the connection to the viewer was lost: {0}")]
    Lost(String),
    /// This build cannot record.
    #[error("this build has no Rerun (feature \"viewer\" of the program)")]
    NotBuilt,
}
