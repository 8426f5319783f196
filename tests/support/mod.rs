//! What several test files need.
#![allow(dead_code, missing_docs)]

pub mod drawn;
pub mod drive;
pub mod gross;
pub mod moving;
pub mod photogrammetry;
pub mod score;

use std::path::{Path, PathBuf};

/// A folder of this package.
pub fn in_package(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

/// The program.
pub fn program() -> assert_cmd::Command {
    assert_cmd::Command::new(env!("CARGO_BIN_EXE_trackbundle"))
}

/// Copies the files and folders of one folder into another, which is made.
pub fn copy_folder(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        let target = to.join(entry.file_name());
        if entry.file_type().unwrap().is_dir() {
            copy_folder(&entry.path(), &target);
        } else {
            std::fs::copy(entry.path(), target).unwrap();
        }
    }
}
