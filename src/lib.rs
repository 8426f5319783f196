//! scratch
pub mod camera;
pub mod estimate;
pub mod geometry;
pub mod nlls;
pub mod problem;
pub mod residuals;
pub mod terrain;
pub mod files;
pub mod tables;
pub mod initialise;
pub mod refine;
pub mod report;
