//! Results into bytes, and the whole folder at once or not at all.

mod cloud;
pub mod folder;
mod json;
mod tables;

pub use json::{Report, report_of_initial, report_of_adjustment};
pub use tables::result_tables;

/// A file of a result folder: its name and its bytes.
pub type File = (String, Vec<u8>);
