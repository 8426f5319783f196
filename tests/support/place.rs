//! Where the package is.

use std::path::{Path, PathBuf};

/// A folder of this package.
pub fn in_package(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}
