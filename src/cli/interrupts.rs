//! Ctrl-C, and a polite request to end: what is in the making goes, what stands is told.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};

/// Set once the process is asked to end; from then on nobody else speaks.
static IS_ENDING: AtomicBool = AtomicBool::new(false);
/// What stands on the disk so far.
static STANDS: Mutex<String> = Mutex::new(String::new());

/// Says what of a command's result is safe from now on.
pub fn stands(text: String) {
    *STANDS.lock().unwrap_or_else(PoisonError::into_inner) = text;
}

/// Whether the process is about to end.
pub fn is_ending() -> bool {
    IS_ENDING.load(Ordering::SeqCst)
}

/// Waits for the end where the process was asked to: the exit code is that of the signal.
pub fn settle() {
    while is_ending() {
        std::thread::park();
    }
}

/// Listens to SIGINT and SIGTERM, unless they are ignored as in a job in the background. For the program's own
/// process alone.
#[cfg(unix)]
pub fn watch() {
    use signal_hook::consts::{SIGINT, SIGTERM};
    let wanted = [SIGINT, SIGTERM].into_iter().filter(|signal| !is_ignored(*signal));
    // Without it the system ends the process, and the next run clears up.
    let Ok(mut signals) = signal_hook::iterator::Signals::new(wanted) else { return };
    std::thread::spawn(move || {
        if let Some(signal) = signals.forever().next() {
            end(signal, if signal == SIGINT { "SIGINT" } else { "SIGTERM" });
        }
    });
}

/// On this system the process just ends, and the next run clears up.
#[cfg(not(unix))]
pub fn watch() {}

#[cfg(unix)]
fn end(signal: i32, name: &str) {
    use std::io::Write;
    IS_ENDING.store(true, Ordering::SeqCst);
    crate::disk::abandon_all();
    let stands = STANDS.lock().unwrap_or_else(PoisonError::into_inner);
    let stands = if stands.is_empty() { "nothing was written" } else { &stands };
    let _ = writeln!(std::io::stderr(), "\ninterrupted ({name}): {stands}");
    std::process::exit(128 + signal);
}

/// Whether the process was begun with a signal ignored, as far as the system tells.
#[cfg(unix)]
fn is_ignored(signal: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok())
        .is_some_and(|mask| mask >> (signal - 1) & 1 == 1)
}
