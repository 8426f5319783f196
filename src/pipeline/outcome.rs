//! What a whole run ends with.

use super::NoSigmas;
use crate::diagnose::{Diagnosis, Verdict};
use crate::estimate::Estimate;
use crate::initialise::Initial;
use crate::problem::Problem;
use crate::refine::{Adjusted, Adjustment};
use nalgebra::Point3;

/// A problem, its adjustment, and what can be said of it.
pub struct Outcome {
    /// What was observed and known.
    pub problem: Problem,
    /// The first estimate.
    pub initial: Initial,
    /// The adjusted unknowns, how they were found, and the least squares behind them.
    pub adjusted: Adjusted,
    /// Standard deviations, observability, tests.
    pub diagnosis: Result<Diagnosis, NoSigmas>,
    /// Whether the result can be relied on; without a diagnosis it cannot.
    pub verdict: Verdict,
    /// What is odd in the folder that the problem was read from.
    pub input_warnings: Vec<String>,
    /// How long each stage took.
    pub seconds: Seconds,
}

/// How long the stages took \[s\].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Seconds {
    /// Reading the folder.
    pub read: f64,
    /// The first estimate.
    pub initialise: f64,
    /// The adjustment.
    pub refine: f64,
    /// Its diagnosis.
    pub diagnose: f64,
}

/// A place of a track: that of the marker, or without one of the body's origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackPlace {
    /// The number of the frame.
    pub frame: i64,
    /// Video time \[s\].
    pub time_s: f64,
    /// Where it is in the world \[m\].
    pub position: Point3<f64>,
    /// Standard deviations along the axes of the world \[m\], infinite where nothing determines one; `None` without
    /// a diagnosis.
    pub sigma_m: Option<[f64; 3]>,
    /// Speed along the ground \[m/s\]; `None` where there is one pose alone.
    pub speed_mps: Option<f64>,
    /// Heading, counter-clockwise from the world's x axis \[rad\].
    pub heading_rad: f64,
}

impl Outcome {
    /// The adjusted unknowns.
    pub fn estimate(&self) -> &Estimate {
        &self.adjusted.estimate
    }

    /// How they were found.
    pub fn adjustment(&self) -> &Adjustment {
        &self.adjusted.adjustment
    }

    /// The track of the vehicle with this id; `None` where there is no such vehicle.
    pub fn track(&self, vehicle: &str) -> Option<Vec<TrackPlace>> {
        let at = self.problem.vehicles.iter().position(|other| other.id == vehicle)?;
        let places = self.estimate().vehicles[at].track(&self.problem, &self.problem.vehicles[at]);
        let sigmas = self.diagnosis.as_ref().ok().map(|found| &found.precision.tracks[at]);
        let place = |(order, place): (usize, crate::estimate::TrackPoint)| {
            let frame = &self.problem.frames[place.frame];
            let sigma = sigmas.and_then(|sigmas| sigmas[order].as_ref());
            TrackPlace {
                frame: frame.number,
                time_s: frame.time_s,
                position: place.position,
                sigma_m: sigma.map(|sigma| sigma.position_m),
                speed_mps: place.speed_mps,
                heading_rad: place.heading_rad,
            }
        };
        Some(places.into_iter().enumerate().map(place).collect())
    }
}
