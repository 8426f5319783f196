//! Bundle adjustment of moving vehicles filmed from a small drone.
//!
//! From image points of vehicles, surveyed targets, a calibrated camera and a terrain: 3D shapes of
//! the vehicles, their poses and tracks, and the path of the camera, adjusted together.
//!
//! ```text
//! problem folder -> files -> Problem -> initialise -> Estimate -> refine -> Estimate + Adjustment -> report
//!                                                                   solver                        -> scene
//! reference + result folder -> evaluate -> report
//! ```
//!
//! Modules stand in the order of their floors, lowest first; each may use those above it here only
//! as far as `tests/laws/floor_plan.rs` says.
//!
//! Features, all of them on unless said otherwise: `cli` (the command line), `report` (results as bytes),
//! `scans` (scans in LAS, LAZ, E57, PCD and PLY), `viewer` (recordings for the Rerun viewer); `program` is
//! all but the viewer. Who reads, adjusts and diagnoses in memory needs none of them.

pub mod geometry;
pub mod rules;
pub mod stats;
pub mod tables;

pub mod camera;
pub mod clock;
pub mod cloud;
pub mod terrain;

pub mod problem;
pub mod reference;
pub mod residuals;
pub mod trajectory;

pub mod estimate;

pub mod files;
pub mod initialise;

pub mod network;

pub mod refine;

pub mod evaluate;
pub mod simulate;

pub mod diagnose;

pub mod pipeline;

pub mod study;
pub mod words;

#[cfg(feature = "report")]
pub mod report;
pub mod scene;

#[cfg(feature = "report")]
pub mod page;

#[cfg(feature = "cli")]
pub mod cli;
