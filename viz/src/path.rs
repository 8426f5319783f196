//! Where things are in the recording.

/// The world, z up.
pub const WORLD: &str = "world";
/// The camera's pose.
pub const CAMERA: &str = "world/camera";
/// Its image plane; image points lie below.
pub const IMAGE: &str = "world/camera/image";
/// The points of each body, in its own frame.
pub const SHAPES: &str = "shapes";
/// Horizontal speed of each body.
pub const SPEED: &str = "plots/speed";
/// Heading of each body.
pub const HEADING: &str = "plots/heading";
/// Standard deviations of each body's track.
pub const SIGMA: &str = "plots/sigma";
/// Root mean square of the residuals of each frame.
pub const RESIDUALS: &str = "plots/residuals";
/// Cost, damping and step of each iteration, as curves.
pub const ITERATIONS: &str = "plots/iterations";
/// Logarithm of the cost of each iteration, as bars.
pub const COST_BARS: &str = "plots/cost";
/// The summary.
pub const SUMMARY: &str = "summary";
