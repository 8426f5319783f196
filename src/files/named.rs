//! Files that stand for themselves, told by their names.

use crate::disk;
use crate::tables::{Finding, Findings};
use std::path::Path;

/// The name of a file without its folder, and the text in it, which is `wanted`.
pub fn named_text(path: &Path, wanted: &str) -> Result<(String, String), Findings> {
    let name = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
    match disk::read_text(path) {
        Ok(text) => Ok((name, text)),
        Err(error) => Err(Finding::of_file(&name, wanted, &error.to_string()).into()),
    }
}
