//! A place for a result: tried before anything is computed, and filled in one step.
//!
//! What is being made stands in a folder of its own beside its place, whose name cannot be predicted and which nobody
//! else may enter:
//!
//! ```text
//! o                      the place
//! .trackbundle-x7Kf2q/   locked as long as its process lives
//!     lock               the name of the place
//!     new/o              what is being made
//! .trackbundle-x7Kf2q.old   what stood there, where it cannot be exchanged in one step
//! ```
//!
//! Such a folder whose lock nobody holds is of a process that died: the next run in the same folder puts back what was
//! taken away, and clears up.

use super::system;
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};
use tempfile::TempDir;

/// How the names of these folders begin.
const PREFIX: &str = ".trackbundle-";
const LOCK: &str = "lock";
const NEW: &str = "new";
const OLD: &str = ".old";
/// The name of a place is at most so long \[byte\].
const MOST_NAME_BYTES: u64 = 4096;

/// Folders in the making, and those that were made for them, of this process: what an interrupted one takes away.
static IN_THE_MAKING: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

fn in_the_making() -> MutexGuard<'static, Vec<PathBuf>> {
    IN_THE_MAKING.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Why a place cannot be used.
#[derive(Debug)]
pub enum PlaceFault {
    /// Another process is making something for it.
    Busy,
    /// What the system says.
    Io(io::Error),
}

impl From<io::Error> for PlaceFault {
    fn from(error: io::Error) -> Self {
        PlaceFault::Io(error)
    }
}

/// A place in use. Dropped, it leaves nothing behind but what was published.
#[derive(Debug)]
pub struct Place {
    target: PathBuf,
    /// Beside the target.
    holder: TempDir,
    _lock: File,
    made: Made,
    /// Left-overs of processes that died, which were cleared up.
    pub cleared: Vec<PathBuf>,
}

/// What became of something that was put in its place.
#[derive(Debug)]
pub struct Published {
    /// Where it stands.
    pub path: PathBuf,
    /// What stood there before and could not be removed, and why.
    pub not_removed: Option<(PathBuf, io::Error)>,
}

impl Place {
    /// Takes a place: clears up what dead processes left in its folder, and proves that it can be written to.
    ///
    /// # Errors
    ///
    /// Another process is at it, or the system does not let us.
    pub fn take(target: &Path) -> Result<Place, PlaceFault> {
        // A link to a result stays a link.
        let target = std::fs::canonicalize(target).unwrap_or_else(|_| target.to_owned());
        let name = target.file_name().ok_or_else(|| io::Error::other("no name of a file or folder"))?;
        let parent = match target.parent() {
            Some(parent) if !parent.as_os_str().is_empty() => parent.to_owned(),
            _ => PathBuf::from("."),
        };
        let made = Made::folders(&parent)?;
        let of_target = std::fs::symlink_metadata(&target).ok();
        if let Some(of_target) = of_target
            && !system::are_on_one_disk(&of_target, &std::fs::metadata(&parent)?)
        {
            return Err(io::Error::other("on another disk than the folder that it stands in").into());
        }
        let _alone = system::lock_folder(&parent);
        let cleared = clear_up(&parent, name.as_encoded_bytes())?;
        let mut builder = tempfile::Builder::new();
        builder.prefix(PREFIX);
        system::private(&mut builder);
        let holder = builder.tempdir_in(&parent)?;
        in_the_making().push(holder.path().to_owned());
        let mut lock = OpenOptions::new().write(true).create_new(true).open(holder.path().join(LOCK))?;
        lock.write_all(name.as_encoded_bytes())?;
        // Where there are no locks nothing is cleared up.
        let _ = lock.try_lock();
        let place = Place { target, holder, _lock: lock, made, cleared };
        // A name that is too long is told now.
        std::fs::remove_dir(place.stage_folder()?)?;
        Ok(place)
    }

    /// The place.
    pub fn target(&self) -> &Path {
        &self.target
    }

    /// An empty folder in which a new one is made; what was made and not published is gone.
    pub fn stage_folder(&self) -> io::Result<PathBuf> {
        let stage = self.stage_file()?;
        std::fs::create_dir(&stage)?;
        Ok(stage)
    }

    /// Where a new file is made; nothing stands there yet.
    pub fn stage_file(&self) -> io::Result<PathBuf> {
        let stage = self.stage();
        let folder = self.holder.path().join(NEW);
        if folder.exists() {
            std::fs::remove_dir_all(&folder)?;
        }
        std::fs::create_dir(folder)?;
        Ok(stage)
    }

    fn stage(&self) -> PathBuf {
        self.holder.path().join(NEW).join(self.target.file_name().unwrap_or_default())
    }

    /// Puts what was made in its place, in one step where the system can; what stood there goes.
    ///
    /// # Errors
    ///
    /// What the system says; the place is as it was.
    pub fn publish(&mut self) -> io::Result<Published> {
        // An interruption waits for the end of this.
        let mut whole = in_the_making();
        let (new, target) = (self.stage(), &self.target);
        let mut not_removed = None;
        if std::fs::symlink_metadata(target).is_ok_and(|before| before.is_dir()) {
            let is_exchanged = match system::exchange(&new, target) {
                // A folder of another user stays among its own.
                Err(error) if error.kind() == io::ErrorKind::PermissionDenied => false,
                exchanged => exchanged?,
            };
            let gone = if is_exchanged { new } else { self.replace(&new)? };
            not_removed = std::fs::remove_dir_all(&gone).err().map(|error| (gone, error));
        } else {
            std::fs::rename(&new, target)?;
        }
        self.made.stay(&mut whole);
        Ok(Published { path: self.target.clone(), not_removed })
    }

    /// Puts a folder in its place in two steps; returns where what stood there is now.
    fn replace(&self, new: &Path) -> io::Result<PathBuf> {
        let aside = aside(self.holder.path());
        std::fs::rename(&self.target, &aside)?;
        if let Err(error) = std::fs::rename(new, &self.target) {
            std::fs::rename(&aside, &self.target)?;
            return Err(error);
        }
        Ok(aside)
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let mut in_the_making = in_the_making();
        in_the_making.retain(|kept| kept != self.holder.path());
        // Nothing is left to do about a failure here. (The folders that were made for it go after it.)
        let _ = std::fs::remove_dir_all(self.holder.path());
    }
}

/// Where what stood in a place is put, beside a holder.
fn aside(holder: &Path) -> PathBuf {
    let mut name = holder.as_os_str().to_owned();
    name.push(OLD);
    PathBuf::from(name)
}

/// Folders that were made so that a place has one to stand in, the innermost first. Dropped, they go.
#[derive(Debug)]
struct Made(Vec<PathBuf>);

impl Made {
    /// Makes the folders of a path that are missing.
    fn folders(path: &Path) -> io::Result<Made> {
        let missing: Vec<PathBuf> = path
            .ancestors()
            .filter(|folder| !folder.as_os_str().is_empty())
            .take_while(|folder| std::fs::symlink_metadata(folder).is_err())
            .map(Path::to_owned)
            .collect();
        // If not all can be made, those that were go again.
        in_the_making().extend(missing.iter().rev().cloned());
        let made = Made(missing);
        std::fs::create_dir_all(path)?;
        Ok(made)
    }

    /// Something stands in them now.
    fn stay(&mut self, in_the_making: &mut Vec<PathBuf>) {
        in_the_making.retain(|kept| !self.0.contains(kept));
        self.0.clear();
    }
}

impl Drop for Made {
    fn drop(&mut self) {
        let mut in_the_making = in_the_making();
        in_the_making.retain(|kept| !self.0.contains(kept));
        // One goes unless something stands in it.
        self.0.iter().for_each(|folder| drop(std::fs::remove_dir(folder)));
    }
}

/// Takes away everything that this process has in the making: it ends now.
pub fn abandon_all() {
    // Others wait here until the process has ended.
    let in_the_making = std::mem::ManuallyDrop::new(in_the_making());
    for folder in in_the_making.iter().rev() {
        let is_holder = folder.file_name().is_some_and(|name| name.to_string_lossy().starts_with(PREFIX));
        // Someone may be writing in it still.
        for _ in 0..20 {
            if !is_holder || std::fs::remove_dir_all(folder).is_ok() || !folder.exists() {
                break;
            }
        }
        if !is_holder {
            let _ = std::fs::remove_dir(folder);
        }
    }
}

/// Clears up what dead processes left in a folder, and tells what. It is an error where a living one is at `name`.
fn clear_up(parent: &Path, name: &[u8]) -> Result<Vec<PathBuf>, PlaceFault> {
    let mut cleared = Vec::new();
    let mut names: Vec<_> =
        std::fs::read_dir(parent)?.filter_map(|entry| Some(entry.ok()?.file_name())).collect();
    names.sort();
    for left in names.iter().filter(|name| name.to_string_lossy().starts_with(PREFIX)) {
        let holder = parent.join(left);
        // A link is no folder of ours.
        if !std::fs::symlink_metadata(&holder).is_ok_and(|about| about.is_dir()) {
            continue;
        }
        let Some(lock) = open_lock(&holder) else {
            // It died before it had locked; whatever is not empty is left alone.
            if std::fs::remove_dir(&holder).is_ok() {
                cleared.push(holder);
            }
            continue;
        };
        let mut of = Vec::new();
        let read = (&lock).take(MOST_NAME_BYTES).read_to_end(&mut of);
        match lock.try_lock() {
            Ok(()) if read.is_ok() => {
                put_back(parent, &holder);
                if std::fs::remove_dir_all(&holder).is_ok() {
                    cleared.push(holder);
                }
            }
            Err(TryLockError::WouldBlock) if of == name => return Err(PlaceFault::Busy),
            // It is at another place, or locks do not work here.
            _ => {}
        }
    }
    Ok(cleared)
}

fn open_lock(holder: &Path) -> Option<File> {
    let path = holder.join(LOCK);
    let about = std::fs::symlink_metadata(&path).ok()?;
    about.is_file().then(|| File::open(path).ok())?
}

/// Puts back what a process had moved away when it died with nothing in its place; else that goes.
fn put_back(parent: &Path, holder: &Path) {
    let aside = aside(holder);
    // What was to stand there stands here still.
    let staged = std::fs::read_dir(holder.join(NEW)).ok().and_then(|mut entries| entries.next()?.ok());
    let target = staged.map(|entry| parent.join(entry.file_name()));
    // Nothing is left to do about a failure here: it stays where it is.
    let _ = match target.filter(|target| std::fs::symlink_metadata(target).is_err()) {
        Some(target) => std::fs::rename(aside, target),
        None => std::fs::remove_dir_all(aside),
    };
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let entries = std::fs::read_dir(folder).unwrap();
        let mut names: Vec<String> =
            entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    fn fill(place: &Place, text: &str) {
        std::fs::write(place.stage_folder().unwrap().join("a"), text).unwrap();
    }

    #[test]
    fn the_old_stands_until_the_new_does_and_nothing_is_left() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("deep/er/o");
        for text in ["one", "two"] {
            let mut place = Place::take(&target).unwrap();
            fill(&place, "given up");
            fill(&place, text);
            assert_eq!(target.exists(), text == "two");
            let published = place.publish().unwrap();
            assert!(published.not_removed.is_none());
            assert_eq!(std::fs::read_to_string(published.path.join("a")).unwrap(), text);
            // Twice from one place.
            fill(&place, text);
            place.publish().unwrap();
            drop(place);
            assert_eq!(names(target.parent().unwrap()), ["o"]);
        }
    }

    #[test]
    fn where_two_cannot_be_exchanged_the_old_one_goes_aside() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("o");
        std::fs::create_dir(&target).unwrap();
        std::fs::write(target.join("a"), "old").unwrap();
        let place = Place::take(&target).unwrap();
        // Nothing is made yet: the old one comes back.
        assert!(place.replace(&place.stage()).is_err());
        assert_eq!(std::fs::read_to_string(target.join("a")).unwrap(), "old");
        fill(&place, "new");
        let aside = place.replace(&place.stage()).unwrap();
        assert_eq!(std::fs::read_to_string(target.join("a")).unwrap(), "new");
        assert_eq!(std::fs::read_to_string(aside.join("a")).unwrap(), "old");
        assert_eq!(aside.parent(), target.parent());
    }

    #[test]
    fn what_is_given_up_leaves_nothing_not_even_its_folders() {
        let folder = tempfile::tempdir().unwrap();
        let place = Place::take(&folder.path().join("x/y/o")).unwrap();
        fill(&place, "text");
        assert!(folder.path().join("x/y").exists());
        drop(place);
        assert!(names(folder.path()).is_empty());
    }

    #[test]
    fn a_file_is_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("x.rrd");
        for text in ["one", "two"] {
            let mut place = Place::take(&target).unwrap();
            std::fs::write(place.stage_file().unwrap(), text).unwrap();
            place.publish().unwrap();
            assert_eq!(std::fs::read_to_string(&target).unwrap(), text);
        }
        assert_eq!(names(folder.path()), ["x.rrd"]);
    }

    #[test]
    fn one_place_is_taken_once() {
        let folder = tempfile::tempdir().unwrap();
        let first = Place::take(&folder.path().join("o")).unwrap();
        assert!(matches!(Place::take(&folder.path().join("o")), Err(PlaceFault::Busy)));
        let other = Place::take(&folder.path().join("other")).unwrap();
        drop(first);
        drop(Place::take(&folder.path().join("o")).unwrap());
        drop(other);
        assert!(names(folder.path()).is_empty());
    }

    #[test]
    fn left_overs_of_the_dead_are_cleared_up_and_what_they_took_away_is_put_back() {
        let folder = tempfile::tempdir().unwrap();
        let holder = folder.path().join(".trackbundle-dead");
        let aside = folder.path().join(".trackbundle-dead.old");
        std::fs::create_dir(&aside).unwrap();
        std::fs::write(aside.join("a"), "old").unwrap();
        std::fs::create_dir_all(holder.join("new/o")).unwrap();
        std::fs::write(holder.join("lock"), "o").unwrap();
        let just_begun = folder.path().join(".trackbundle-begun");
        std::fs::create_dir(&just_begun).unwrap();
        // Whatever has no lock is not ours.
        std::fs::create_dir_all(folder.path().join(".trackbundle-mine/notes")).unwrap();
        let place = Place::take(&folder.path().join("another")).unwrap();
        assert_eq!(place.cleared, [just_begun, holder]);
        drop(place);
        assert_eq!(names(folder.path()), [".trackbundle-mine", "o"]);
        assert_eq!(std::fs::read_to_string(folder.path().join("o/a")).unwrap(), "old");
    }

    #[test]
    fn what_stands_there_is_not_replaced_by_what_died() {
        let folder = tempfile::tempdir().unwrap();
        let holder = folder.path().join(".trackbundle-dead");
        std::fs::create_dir_all(holder.join("new")).unwrap();
        std::fs::create_dir(folder.path().join(".trackbundle-dead.old")).unwrap();
        std::fs::write(folder.path().join(".trackbundle-dead.old/a"), "old").unwrap();
        std::fs::write(holder.join("lock"), "o").unwrap();
        std::fs::create_dir(folder.path().join("o")).unwrap();
        std::fs::write(folder.path().join("o/a"), "new").unwrap();
        drop(Place::take(&folder.path().join("o")).unwrap());
        assert_eq!(names(folder.path()), ["o"]);
        assert_eq!(std::fs::read_to_string(folder.path().join("o/a")).unwrap(), "new");
    }

    #[test]
    fn a_name_that_is_too_long_is_told_at_once() {
        let folder = tempfile::tempdir().unwrap();
        let fault = Place::take(&folder.path().join("o".repeat(256))).unwrap_err();
        assert!(matches!(fault, PlaceFault::Io(_)), "{fault:?}");
        assert!(names(folder.path()).is_empty());
        drop(Place::take(&folder.path().join("o".repeat(255))).unwrap());
    }

    #[cfg(unix)]
    #[test]
    fn nobody_else_enters_what_is_being_made() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let place = Place::take(&folder.path().join("o")).unwrap();
        let holder = std::fs::metadata(place.holder.path()).unwrap();
        assert_eq!(holder.permissions().mode() & 0o777, 0o700);
    }
}
