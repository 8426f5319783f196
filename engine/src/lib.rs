//! What trackbundle computes: the first estimate, the adjustment and its diagnosis, of a problem in memory. No files
//! and no pages: these are in the package `trackbundle`, whose front door is also the one to this.
//!
//! A package of its own so that the rest can be changed, and compiled, without it. Its interface is that of
//! `trackbundle::internals`: none that is promised.

// In the order of their floors, lowest first; each may use those above it here only as far as
// tests/laws/floor_plan.rs says.
pub mod geometry;
pub mod rules;
pub mod stats;

pub mod camera;
pub mod clock;
pub mod cloud;
pub mod terrain;

pub mod problem;
pub mod trajectory;

pub mod estimate;
pub mod residuals;

pub mod initialise;

pub mod network;

pub mod refine;

pub mod diagnose;

pub mod words;
