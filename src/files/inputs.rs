//! What a problem is made of, file by file, with a fingerprint: so that a report can say what it is about.

use super::{problem_toml, tables};
use crate::tables::{Finding, Findings};
use sha2::{Digest, Sha256};
use std::path::Path;

/// A file of a problem that an adjustment reads.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct InputFile {
    /// Its name within the problem folder.
    pub file: String,
    /// Its length.
    pub bytes: u64,
    /// SHA-256 of its bytes, in hexadecimal digits.
    pub sha256: String,
}

/// The files of a problem folder that an adjustment reads, `problem.toml` first. References are not among them.
pub fn input_files(folder: &Path) -> Vec<InputFile> {
    let toml = std::fs::read_to_string(folder.join(problem_toml::FILE)).unwrap_or_default();
    let grid = toml::from_str::<toml::Table>(&toml)
        .ok()
        .and_then(|table| Some(table.get("terrain")?.get("grid")?.as_str()?.to_owned()));
    let names = std::iter::once(problem_toml::FILE).chain(tables::NAMES).chain(grid.as_deref());
    names.filter_map(|name| input_file(folder, name)).collect()
}

/// A file of a folder; `None` where it cannot be read.
pub fn input_file(folder: &Path, name: &str) -> Option<InputFile> {
    let bytes = std::fs::read(folder.join(name)).ok()?;
    let digits = Sha256::digest(&bytes).iter().map(|byte| format!("{byte:02x}")).collect();
    Some(InputFile { file: name.to_owned(), bytes: bytes.len() as u64, sha256: digits })
}

/// The name of a file without its folder, and the text in it, which is `wanted`.
pub fn named_text(path: &Path, wanted: &str) -> Result<(String, String), Findings> {
    let name = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
    match std::fs::read_to_string(path) {
        Ok(text) => Ok((name, text)),
        Err(error) => Err(Finding::of_file(&name, wanted, &error.to_string()).into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_told_by_their_bytes() {
        let place = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| std::fs::write(place.path().join(name), text).unwrap();
        write("problem.toml", "[terrain]\ngrid = \"height.asc\"\n");
        write("height.asc", "abc");
        write("notes.txt", "not an input");
        let found = input_files(place.path());
        assert_eq!(found.iter().map(|f| f.file.as_str()).collect::<Vec<_>>(), ["problem.toml", "height.asc"]);
        // The example of FIPS 180-4.
        let wanted = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!((found[1].bytes, found[1].sha256.as_str()), (3, wanted));
    }

    #[test]
    fn a_film_is_no_input() {
        let place = tempfile::tempdir().unwrap();
        std::fs::create_dir(place.path().join("images")).unwrap();
        for (name, text) in
            [("film.mp4", "a film"), ("images/1.png", "an image"), ("frames.csv", "frame,time_s\n")]
        {
            std::fs::write(place.path().join(name), text).unwrap();
        }
        for video in ["images = \"images\"", "file = \"film.mp4\""] {
            std::fs::write(place.path().join("problem.toml"), format!("[video]\n{video}\n")).unwrap();
            let found = input_files(place.path());
            let names: Vec<&str> = found.iter().map(|f| f.file.as_str()).collect();
            assert_eq!(names, ["problem.toml", "frames.csv"]);
        }
    }
}
