//! What measurements and knowledge are called.

use crate::network::Source;

/// A source in the words of a sentence. Files have [`crate::diagnose::source_key`], which never changes.
pub fn source_name(source: Source) -> &'static str {
    match source {
        Source::VehicleImages => "image points of vehicles",
        Source::TargetImages => "image points of targets",
        Source::Survey => "survey of targets",
        Source::Terrain => "terrain contact",
        Source::KnownHeight => "known height",
        Source::KnownPoint => "known points",
        Source::KnownDistance => "known distances",
        Source::Calibration => "known interior orientation",
        Source::Readout => "known readout time",
        Source::Gnss => "GNSS positions",
        Source::GnssKnowledge => "knowledge of GNSS receivers",
        Source::CameraPoses => "given camera poses",
        Source::CameraMotion => "motion of the camera",
        Source::VehicleMotion => "motion of vehicles",
        Source::Driving => "rolling of rear axles",
        Source::Frame => "frame of the body",
        Source::Convention => "conventions",
    }
}
