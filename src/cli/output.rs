//! What is said on the way.

use super::Failure;
use super::interrupts;
use crate::initialise::Resection;
use crate::refine::Progress;
use crate::words::format;
pub use crate::words::format::counted;
use indicatif::{ProgressBar, ProgressStyle};
use std::borrow::Cow;
use std::fmt::Display;
use std::io::{ErrorKind, IsTerminal, Write};
use trackbundle_solver::minimise::IterationRecord;

/// Prints to standard output. A reader that has gone away is no error.
pub fn print(text: &str) -> Result<(), Failure> {
    if interrupts::is_ending() {
        return Ok(());
    }
    let mut out = std::io::stdout().lock();
    match out.write_all(harmless(text).as_bytes()).and_then(|()| out.flush()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            Err(Failure::Other(format!("standard output: {error}")))
        }
        _ => Ok(()),
    }
}

/// Prints a line to standard error. Nothing that fails there costs a result.
pub fn tell(line: impl Display) {
    if !interrupts::is_ending() {
        let _ = writeln!(std::io::stderr().lock(), "{}", harmless(&line.to_string()));
    }
}

/// A text without characters that a terminal obeys, or that turn the order of others: they are told by their numbers.
fn harmless(text: &str) -> Cow<'_, str> {
    let is_obeyed = |c: char| {
        c.is_control() && !matches!(c, '\n' | '\t')
            || matches!(c, '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}' | '\u{200e}' | '\u{200f}' | '\u{61c}')
    };
    if !text.contains(is_obeyed) {
        return Cow::Borrowed(text);
    }
    let mut told = String::with_capacity(text.len());
    for c in text.chars() {
        if is_obeyed(c) { told.extend(c.escape_unicode()) } else { told.push(c) }
    }
    Cow::Owned(told)
}

/// Prints warnings to standard error.
pub fn warn_all<W: Display>(warnings: &[W]) {
    warnings.iter().for_each(|warning| tell(format_args!("warning: {warning}")));
}

/// Where the progress of an adjustment goes: a table with `verbose`, else a bar on a terminal, else
/// a line for each round; nothing with `quiet`.
pub fn progress(verbose: bool, quiet: bool, max_iterations: usize) -> Box<dyn FnMut(&Progress<'_>)> {
    if quiet {
        Box::new(|_| {})
    } else if verbose {
        Box::new(table())
    } else if std::io::stderr().is_terminal() {
        Box::new(bar(max_iterations))
    } else {
        Box::new(|progress| {
            if let Progress::Round(number, name) = progress {
                tell(format_args!("round {number}: {name}"));
            }
        })
    }
}

fn table() -> impl FnMut(&Progress<'_>) {
    let mut before_s = 0.0;
    move |progress| match progress {
        Progress::Round(number, name) => {
            before_s = 0.0;
            tell(format_args!("round {number}: {name}"));
            tell(
                "iter         cost       change   |gradient|       |step|    gain   damping  iter time  total time",
            );
        }
        Progress::Iteration(record, _) => {
            before_s += record.seconds;
            tell(row(record, before_s));
        }
    }
}

fn row(r: &IterationRecord, total_seconds: f64) -> String {
    let mark = if r.accepted { ' ' } else { 'x' };
    format!(
        "{:4} {:12.6e} {:12.2e} {:12.2e} {:12.2e} {:7.2}{mark} {:8.1e} {:10.3} {:11.3}",
        r.iteration, r.cost, r.change, r.gradient, r.step, r.gain, r.damping, r.seconds, total_seconds
    )
}

fn bar(max_iterations: usize) -> impl FnMut(&Progress<'_>) {
    let style =
        ProgressStyle::with_template("{spinner} {msg} {wide_bar} {pos}/{len} iterations at most, {elapsed}");
    let bar = ProgressBar::new(max_iterations as u64);
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
    let bar = Clearing(bar);
    move |progress| match progress {
        Progress::Round(_, name) => bar.0.set_message(*name),
        Progress::Iteration(record, _) if record.iteration > 0 => bar.0.inc(1),
        Progress::Iteration(..) => bar.0.tick(),
    }
}

/// Where the steps of a study go: a bar with the time that is left on a terminal, else a line for every tenth;
/// nothing with `quiet`.
pub fn steps(quiet: bool) -> Box<dyn Fn(usize, usize) + Sync> {
    if quiet {
        return Box::new(|_, _| {});
    }
    if std::io::stderr().is_terminal() {
        let style = ProgressStyle::with_template("{wide_bar} {pos}/{len} steps, {elapsed}, {eta} left");
        let bar = ProgressBar::new(0);
        bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
        let bar = Clearing(bar);
        return Box::new(move |done, all| {
            bar.0.set_length(all as u64);
            bar.0.set_position(done as u64);
        });
    }
    let begin = std::time::Instant::now();
    Box::new(move |done, all| {
        if done * 10 / all > (done - 1) * 10 / all {
            let passed_s = begin.elapsed().as_secs_f64();
            let left_s = passed_s * (all - done) as f64 / done as f64;
            tell(format_args!("{done} of {all} steps, {passed_s:.0} s, {left_s:.0} s left"));
        }
    })
}

/// A bar that leaves the terminal clean.
struct Clearing(ProgressBar);

impl Drop for Clearing {
    fn drop(&mut self) {
        self.0.finish_and_clear();
    }
}

/// A number with its thousands set apart.
pub fn grouped(number: impl ToString) -> String {
    format::grouped(number, ',')
}

/// How camera poses were found, in a line; nothing where all were given.
pub fn describe_resection(resection: Option<&Resection>) -> String {
    let Some(quality) = resection.map(Resection::quality) else { return String::new() };
    format!(
        "resection   {} resected, {} bridged; medians: {} targets, rms {:.2} px, sigma {:.3} m, {:.3} deg; {}\n",
        counted(quality.resected, "frame"),
        grouped(quality.bridged),
        quality.median_used,
        quality.median_rms_px,
        quality.median_sigma_position_m,
        quality.median_sigma_attitude_rad.to_degrees(),
        counted(quality.gross_errors, "gross error")
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn terminals_obey_nothing_that_is_printed() {
        assert_eq!(harmless("two lines\nand a\ttab, M\u{e4}rz"), "two lines\nand a\ttab, M\u{e4}rz");
        let title = "a\u{1b}]0;title\u{7}b\r\u{9b}2J\u{202e}c";
        assert_eq!(harmless(title), "a\\u{1b}]0;title\\u{7}b\\u{d}\\u{9b}2J\\u{202e}c");
    }

    #[test]
    fn thousands_are_set_apart() {
        assert_eq!([0, 999, 1000, 60150, 1234567].map(grouped), ["0", "999", "1,000", "60,150", "1,234,567"]);
        assert_eq!([-999, -1000].map(grouped), ["-999", "-1,000"]);
        assert_eq!(counted(1, "frame"), "1 frame");
        assert_eq!(counted(2000, "frame"), "2,000 frames");
    }
}
