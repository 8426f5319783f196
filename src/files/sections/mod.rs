//! The sections of `problem.toml`, a file each: what it says, how it is read and how it is written.
//!
//! A new section is a file here, and a line in `problem_toml.rs` for each of the three.

pub mod camera;
pub mod gnss;
pub mod noise;
pub mod terrain;
pub mod vehicle;
pub mod video;

/// Name of the file.
pub const FILE: &str = "problem.toml";
