//! What the program does: each test runs it, or reads what it left.

mod bad_input;
mod command_line;
mod evaluate;
mod evo;
mod exports;
mod hostile;
mod moving_parts;
mod references;
mod scans;
mod shipped_problems;
mod simulate;
mod study;
#[path = "../support/mod.rs"]
mod support;
mod view;
