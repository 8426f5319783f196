//! Bundle adjustment of moving vehicles filmed from a small drone.
//!
//! From image points of vehicles, surveyed targets, a calibrated camera and a terrain: 3D shapes of
//! the vehicles, their poses and tracks, and the path of the camera, adjusted together, with standard deviations and a
//! verdict on whether they can be relied on.
//!
//! # A first adjustment
//!
//! [`adjust_folder`] reads a problem folder, finds the first estimate, adjusts it, diagnoses the result and judges it:
//!
//! ```
//! use trackbundle::{Options, adjust_folder};
//!
//! let outcome = adjust_folder("problems/tiny", &Options::default())?;
//! println!("trust: {:?}", outcome.verdict.trust);
//! for vehicle in &outcome.problem.vehicles {
//!     for place in outcome.track(&vehicle.id).expect("a vehicle of the problem") {
//!         println!("{} at {} m, +- {:?} m", place.time_s, place.position, place.sigma_m);
//!     }
//! }
//! # assert!(outcome.adjustment().redundancy > 0);
//! # Ok::<(), trackbundle::Error>(())
//! ```
//!
//! # What stands where
//!
//! | to | use |
//! |---|---|
//! | adjust a folder, or a problem built in memory | [`adjust_folder`], [`adjust_problem`], [`Options`], [`Outcome`] |
//! | follow the run, or take its parts | [`start`], [`Started`], [`Judged`] |
//! | build a problem | [`problem::Problem`], [`camera::Camera`], [`terrain::Terrain`], [`geometry::Pose`] |
//! | read the adjusted unknowns | [`estimate::Estimate`], [`Outcome::track`] |
//! | predict what a flight will reach | [`predict_scenario`] |
//! | run the program from another program | `run` (feature `cli`) |
//! | adjust something else | the crate `trackbundle_solver` |
//!
//! `examples/` has a program for each: `adjust_folder`, `problem_in_memory`, `predict_accuracy`, and `custom_measurement`
//! in `solver/examples`. ARCHITECTURE.md has the rooms behind this door; they are not part of the interface.
//!
//! Features, all of them on unless said otherwise: `cli` (the command line), `report` (results as bytes),
//! `scans` (scans in LAS, LAZ, E57, PCD and PLY), `viewer` (recordings for the Rerun viewer); `program` is
//! all but the viewer. Who reads, adjusts and diagnoses in memory needs none of them.

pub use internals::{camera, estimate, geometry, problem, terrain};

pub use internals::diagnose::{Diagnosis, Trust, Verdict, VerdictReason};
pub use internals::initialise::Method;
pub use internals::network::{MotionPrior, MotionPriors};
pub use internals::pipeline::{
    Error, Judged, NoSigmas, Options, Outcome, Seconds, Started, TrackPlace, adjust_folder, adjust_problem,
    start,
};
pub use internals::refine::{Adjusted, Adjustment, NoSolution, Progress, RefineOptions};
pub use internals::study::{Prediction, predict_scenario};

/// The program: its arguments, its own name first, and its exit code.
#[cfg(feature = "cli")]
pub use internals::cli::run;

#[allow(unused_imports)]
use internals::{
    clock, cloud, diagnose, disk, evaluate, files, initialise, network, pipeline, reference, refine,
    residuals, rules, scene, simulate, stats, study, tables, trajectory, words,
};
#[cfg(feature = "report")]
#[allow(unused_imports)]
use internals::{page, report};

/// The rooms of the house, those of the engine among them, for its own tests, benchmarks and tools. Not part of the
/// interface: anything here may change in any version.
#[doc(hidden)]
#[path = "."]
pub mod internals {
    pub use trackbundle_engine::{
        camera, clock, cloud, diagnose, estimate, geometry, initialise, network, problem, refine, residuals,
        rules, stats, terrain, trajectory, words,
    };

    // In the order of their floors, lowest first; each may use those above it here only as far as
    // tests/laws/floor_plan.rs says.
    pub mod disk;

    pub mod tables;

    pub mod reference;

    pub mod files;

    pub mod evaluate;
    pub mod simulate;

    pub mod pipeline;

    pub mod study;

    #[cfg(feature = "report")]
    pub mod report;
    pub mod scene;

    #[cfg(feature = "report")]
    pub mod page;

    #[cfg(feature = "cli")]
    pub mod cli;
}
