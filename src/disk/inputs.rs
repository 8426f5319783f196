//! The files of a folder that something is made of, each read once: what is told of it is of the bytes that were used.

use super::read::read;
use sha2::{Digest, Sha256};
use std::cell::RefCell;
use std::io;
use std::path::Path;

/// A file that was read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct InputFile {
    /// Its name within its folder.
    pub file: String,
    /// Its length.
    pub bytes: u64,
    /// SHA-256 of its bytes, in hexadecimal digits.
    pub sha256: String,
}

impl InputFile {
    /// A file of this name with these bytes.
    pub fn new(file: &str, bytes: &[u8]) -> Self {
        let sha256 = Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect();
        InputFile { file: file.to_owned(), bytes: bytes.len() as u64, sha256 }
    }
}

/// Reads files of a folder, and keeps which.
pub struct Inputs<'a> {
    folder: &'a Path,
    read: RefCell<Vec<InputFile>>,
}

impl<'a> Inputs<'a> {
    /// Files of this folder, none of them read so far.
    pub fn new(folder: &'a Path) -> Self {
        Inputs { folder, read: RefCell::default() }
    }

    /// The folder.
    pub fn folder(&self) -> &'a Path {
        self.folder
    }

    /// The bytes of a file.
    ///
    /// # Errors
    ///
    /// As [`read`].
    pub fn read(&self, file: &str) -> io::Result<Vec<u8>> {
        let bytes = read(&self.folder.join(file))?;
        self.read.borrow_mut().push(InputFile::new(file, &bytes));
        Ok(bytes)
    }

    /// What was read, in that order.
    pub fn files(self) -> Vec<InputFile> {
        self.read.into_inner()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_told_by_the_bytes_that_were_read() {
        let place = tempfile::tempdir().unwrap();
        std::fs::write(place.path().join("height.asc"), "abc").unwrap();
        let inputs = Inputs::new(place.path());
        assert_eq!(inputs.read("height.asc").unwrap(), b"abc");
        assert!(inputs.read("gone.csv").is_err());
        std::fs::write(place.path().join("height.asc"), "changed since").unwrap();
        // The example of FIPS 180-4.
        let sha256 = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad".to_owned();
        let wanted = InputFile { file: "height.asc".to_owned(), bytes: 3, sha256 };
        assert_eq!(inputs.files(), [wanted]);
    }
}
