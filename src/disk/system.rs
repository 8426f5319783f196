//! What each system does in its own way; where one cannot, a plain way that is not as tight.

use std::fs::{File, Metadata};
use std::io;
use std::path::Path;

/// What something is that is neither a file nor a folder.
#[cfg(unix)]
pub fn kind_of(about: &Metadata) -> &'static str {
    use std::os::unix::fs::FileTypeExt;
    let kind = about.file_type();
    if kind.is_fifo() {
        "a pipe"
    } else if kind.is_socket() {
        "a socket"
    } else if kind.is_char_device() || kind.is_block_device() {
        "a device"
    } else {
        "something else"
    }
}

/// What something is that is neither a file nor a folder.
#[cfg(not(unix))]
pub fn kind_of(_: &Metadata) -> &'static str {
    "something else"
}

/// Exchanges what stands under two names, in one step. `false`: this system or disk cannot.
#[cfg(any(target_os = "linux", target_os = "android", target_vendor = "apple"))]
pub fn exchange(one: &Path, other: &Path) -> io::Result<bool> {
    use rustix::fs::{CWD, RenameFlags, renameat_with};
    use rustix::io::Errno;
    match renameat_with(CWD, one, CWD, other, RenameFlags::EXCHANGE) {
        Ok(()) => Ok(true),
        Err(Errno::INVAL | Errno::NOSYS | Errno::NOTSUP) => Ok(false),
        Err(error) => Err(error.into()),
    }
}

/// Exchanges what stands under two names, in one step. `false`: this system or disk cannot.
#[cfg(not(any(target_os = "linux", target_os = "android", target_vendor = "apple")))]
pub fn exchange(_: &Path, _: &Path) -> io::Result<bool> {
    Ok(false)
}

/// Keeps others of this program from beginning in a folder, as long as what is returned is kept; `None` where the
/// system or the disk has no such thing.
pub fn lock_folder(folder: &Path) -> Option<File> {
    if !cfg!(unix) {
        return None;
    }
    let opened = File::open(folder).ok()?;
    opened.lock().ok()?;
    Some(opened)
}

/// Whether two places lie on one disk, as far as this can be known.
#[cfg(unix)]
pub fn are_on_one_disk(one: &Metadata, other: &Metadata) -> bool {
    use std::os::unix::fs::MetadataExt;
    one.dev() == other.dev()
}

/// Whether two places lie on one disk, as far as this can be known.
#[cfg(not(unix))]
pub fn are_on_one_disk(_: &Metadata, _: &Metadata) -> bool {
    true
}

/// Lets nobody else into folders that a builder makes.
#[cfg(unix)]
pub fn private(builder: &mut tempfile::Builder<'_, '_>) {
    use std::os::unix::fs::PermissionsExt;
    builder.permissions(std::fs::Permissions::from_mode(0o700));
}

/// Lets nobody else into folders that a builder makes.
#[cfg(not(unix))]
pub fn private(_: &mut tempfile::Builder<'_, '_>) {}

/// How much address space this process may take, where that is limited \[byte\].
#[cfg(unix)]
pub fn address_space_limit() -> Option<u64> {
    rustix::process::getrlimit(rustix::process::Resource::As).current
}

/// How much address space this process may take, where that is limited \[byte\].
#[cfg(not(unix))]
pub fn address_space_limit() -> Option<u64> {
    None
}

/// The size of the largest cache of a processor, where it is known \[byte\].
pub fn largest_cache() -> Option<u64> {
    let sizes = (0..4).filter_map(|index| {
        let file = format!("/sys/devices/system/cpu/cpu0/cache/index{index}/size");
        let text = std::fs::read_to_string(file).ok()?;
        text.trim().strip_suffix('K')?.parse::<u64>().ok()
    });
    sizes.max().map(|kib| 1024 * kib)
}
