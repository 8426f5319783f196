//! The one door for reading: regular files only, and no more of them than memory is for.

use super::system;
use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

/// A file that is read whole may be so long \[byte\].
pub const MOST_BYTES: u64 = 1 << 32;

/// The bytes of a regular file.
///
/// # Errors
///
/// What the system says; that it is no file but a folder, a pipe, a device; that it is longer than [`MOST_BYTES`].
pub fn read(path: &Path) -> io::Result<Vec<u8>> {
    read_at_most(path, MOST_BYTES)
}

/// [`read`], as UTF-8 text.
pub fn read_text(path: &Path) -> io::Result<String> {
    let invalid = |error: std::string::FromUtf8Error| {
        io::Error::new(io::ErrorKind::InvalidData, format!("no UTF-8 text: {}", error.utf8_error()))
    };
    String::from_utf8(read(path)?).map_err(invalid)
}

fn read_at_most(path: &Path, most: u64) -> io::Result<Vec<u8>> {
    // Opening a pipe would wait for whoever writes to it.
    regular(&std::fs::metadata(path)?)?;
    let file = File::open(path)?;
    let about = file.metadata()?;
    regular(&about)?;
    let too_long = |bytes: u64| {
        let told = format!("a file of {bytes} bytes or more, at most {most} can be read");
        Err(io::Error::new(io::ErrorKind::FileTooLarge, told))
    };
    if about.len() > most {
        return too_long(about.len());
    }
    let mut bytes = Vec::new();
    let expected = usize::try_from(about.len()).unwrap_or_default();
    bytes.try_reserve_exact(expected).map_err(|_| {
        io::Error::new(io::ErrorKind::OutOfMemory, format!("no memory for a file of {expected} bytes"))
    })?;
    // Files of the system tell no length and may have no end.
    file.take(most + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most { too_long(bytes.len() as u64) } else { Ok(bytes) }
}

fn regular(about: &std::fs::Metadata) -> io::Result<()> {
    if about.is_file() {
        return Ok(());
    }
    let kind = if about.is_dir() { "a folder" } else { system::kind_of(about) };
    Err(io::Error::new(io::ErrorKind::InvalidInput, format!("{kind}, not a file")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_files_of_bounded_length_are_read() {
        let place = tempfile::tempdir().unwrap();
        let file = place.path().join("a");
        std::fs::write(&file, "abc").unwrap();
        assert_eq!(read(&file).unwrap(), b"abc");
        assert_eq!(read_at_most(&file, 3).unwrap(), b"abc");
        let told = read_at_most(&file, 2).unwrap_err().to_string();
        assert_eq!(told, "a file of 3 bytes or more, at most 2 can be read");
        assert_eq!(read(place.path()).unwrap_err().to_string(), "a folder, not a file");
        assert_eq!(read(&place.path().join("b")).unwrap_err().kind(), io::ErrorKind::NotFound);
        std::fs::write(&file, b"a\xff").unwrap();
        assert!(read_text(&file).unwrap_err().to_string().starts_with("no UTF-8 text: "));
    }

    #[cfg(unix)]
    #[test]
    fn what_has_no_end_is_not_read() {
        assert_eq!(read(Path::new("/dev/zero")).unwrap_err().to_string(), "a device, not a file");
        let place = tempfile::tempdir().unwrap();
        let link = place.path().join("link");
        std::os::unix::fs::symlink("/dev/zero", &link).unwrap();
        assert_eq!(read(&link).unwrap_err().to_string(), "a device, not a file");
        let socket = place.path().join("socket");
        let _listening = std::os::unix::net::UnixListener::bind(&socket).unwrap();
        assert_eq!(read(&socket).unwrap_err().to_string(), "a socket, not a file");
    }
}
