//! Recordings as files.

use crate::Layout;
use crate::error::RecordingError;
use crate::recording;
use crate::scene::Scene;
use crate::sdk::external::re_log_encoding::{Encoder, EncodingOptions};
use crate::sdk::external::re_log_types::LogMsg;
use crate::sdk::sink::{LogSink, SinkFlushError};
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// Writes the recording of these scenes to `file`.
pub fn save(scenes: &[Scene], layout: Layout, file: &Path) -> Result<(), RecordingError> {
    let sink = FileSink::create(file)?;
    let stream = recording::builder(scenes).buffered()?;
    stream.set_sink(Box::new(sink.clone()));
    let recorded = recording::record(&stream, scenes, layout);
    let flushed = stream.flush_blocking().map_err(|error| RecordingError::File(error.to_string()));
    drop(stream);
    // What could not be written is why the rest failed.
    sink.finish()?;
    recorded.and(flushed)
}

/// A file that keeps what went wrong. (That of the library tells it to the log alone.)
#[derive(Clone)]
struct FileSink(Arc<Mutex<Writing>>);

struct Writing {
    encoder: Encoder<BufWriter<File>>,
    failed: Option<String>,
}

impl FileSink {
    fn create(file: &Path) -> Result<Self, RecordingError> {
        let failed = |error: &dyn std::fmt::Display| RecordingError::File(error.to_string());
        let file = BufWriter::new(File::create(file).map_err(|error| failed(&error))?);
        let options = EncodingOptions::PROTOBUF_COMPRESSED;
        let encoder = Encoder::new_eager(crate::sdk::build_info().version, options, file);
        let encoder = encoder.map_err(|error| failed(&error))?;
        Ok(FileSink(Arc::new(Mutex::new(Writing { encoder, failed: None }))))
    }

    /// Does something, unless something has failed before.
    fn attempt<T, E: std::fmt::Display>(
        &self,
        what: impl FnOnce(&mut Encoder<BufWriter<File>>) -> Result<T, E>,
    ) -> Result<(), String> {
        let mut writing = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if writing.failed.is_none() {
            writing.failed = what(&mut writing.encoder).err().map(|error| error.to_string());
        }
        writing.failed.clone().map_or(Ok(()), Err)
    }

    fn finish(&self) -> Result<(), RecordingError> {
        let finished = self.attempt(Encoder::finish).and_then(|()| self.attempt(Encoder::flush_blocking));
        finished.map_err(RecordingError::File)
    }
}

impl LogSink for FileSink {
    fn send(&self, message: LogMsg) {
        // It is told at the end.
        let _ = self.attempt(|encoder| encoder.append(&message));
    }

    fn flush_blocking(&self, _timeout: Duration) -> Result<(), SinkFlushError> {
        self.attempt(Encoder::flush_blocking).map_err(SinkFlushError::failed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_recording_is_a_file() {
        let folder = std::env::temp_dir().join(format!("trackbundle-viz-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let file = folder.join("test.rrd");
        save(&[Scene::default()], Layout::Overview, &file).unwrap();
        let bytes = std::fs::read(&file).unwrap();
        std::fs::remove_dir_all(&folder).unwrap();
        assert!(bytes.starts_with(b"RRF"), "{:?}", &bytes[..4]);
        let nowhere = save(&[Scene::default()], Layout::Overview, Path::new("/nowhere/at/all/test.rrd"));
        assert!(matches!(nowhere, Err(RecordingError::File(_))), "{nowhere:?}");
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_full_disk_is_told() {
        let full = save(&[Scene::default()], Layout::Overview, Path::new("/dev/full"));
        let Err(RecordingError::File(message)) = full else { panic!("{full:?}") };
        assert!(message.contains("No space left on device"), "{message}");
    }
}
