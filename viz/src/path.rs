//! Where things are in a recording; `docs/rerun.md` lists it as an interface.

use crate::sdk::EntityPathPart;

/// The application that recordings belong to; viewers keep one layout for each.
pub const APPLICATION: &str = "trackbundle";
/// The world, z up.
pub const WORLD: &str = "world";
/// The camera's pose after the adjustment.
pub const CAMERA: &str = "world/camera";
/// Its image plane; image points lie below.
pub const IMAGE: &str = "world/camera/image";
/// The camera's pose before the adjustment.
pub const CAMERA_START: &str = "world/camera_start";
/// Bodies where they are in a frame.
pub const BODIES: &str = "world/bodies";
/// Paths of the camera and of bodies, over the whole film.
pub const PATHS: &str = "world/paths";
/// What nothing determines.
pub const OPEN: &str = "world/open";
/// The points of each body, in its own frame.
pub const SHAPES: &str = "shapes";
/// The same on the Earth.
pub const MAP: &str = "map";
/// Horizontal speed of each body.
pub const SPEED: &str = "plots/speed";
/// Heading of each body.
pub const HEADING: &str = "plots/heading";
/// Standard deviations of each body's track.
pub const SIGMA: &str = "plots/sigma";
/// Track of each body minus its reference.
pub const ERRORS: &str = "plots/errors";
/// Root mean square of the residuals of each frame.
pub const RESIDUALS: &str = "plots/residuals";
/// How many residuals are how large, as bars.
pub const DISTRIBUTION: &str = "plots/distribution";
/// Cost, damping and step of each iteration, as curves.
pub const ITERATIONS: &str = "plots/iterations";
/// Logarithm of the cost of each iteration, as bars.
pub const COST_BARS: &str = "plots/cost";
/// The summary.
pub const SUMMARY: &str = "text/summary";
/// What colours and signs mean.
pub const LEGEND: &str = "text/legend";
/// The same of shapes.
pub const SHAPE_LEGEND: &str = "text/shape_legend";
/// Stages of the adjustment and warnings.
pub const LOG: &str = "text/log";

/// An id, such as that of a body, as one part of a path, whatever is in it.
pub fn part(id: &str) -> String {
    EntityPathPart::new(id).escaped_string()
}

/// A path of a scene that may stand among others.
pub fn below(root: Option<&str>, path: &str) -> String {
    match root {
        Some(root) => format!("{}/{path}", part(root)),
        None => path.to_owned(),
    }
}
