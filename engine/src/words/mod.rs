//! Every sentence for people. Rooms below find things and say what they are by enums with data; here each gets
//! its sentence (`Display`) and, for programs, its code and its numbers ([`Coded`]).
//!
//! A sentence may be reworded at any time; a code stays.
//!
//! To say something new: a variant with its numbers in the enum of the room that finds it (`InitialWarning`,
//! `NetworkWarning`, `AdjustmentWarning`, `VerdictReason`, ...), its sentence and its code here. The compiler names
//! the places, and `report.json`, the page and the terminal have it.

mod adjustment;
mod directions;
pub mod format;
mod initial;
mod result;
mod sources;
mod verdict;

pub use directions::direction_code;
pub use result::{MotionFacts, ResultFacts};
pub use sources::source_name;
pub use verdict::{fact_word, verdict_lines};

use crate::diagnose::NoSigmas;
use crate::initialise::InitialWarning;
use crate::refine::AdjustmentWarning;
use format::counted;
use std::fmt;

/// What a sentence says, for programs.
#[derive(Clone, Debug, PartialEq)]
pub struct Code {
    /// What it is; stays the same in all versions.
    pub code: &'static str,
    /// The number that it is about.
    pub value: Option<f64>,
    /// What that was held against.
    pub limit: Option<f64>,
    /// What it is about: `vehicle car`, `target T1`, `frame 12`.
    pub place: Option<String>,
}

impl Code {
    /// A code alone.
    pub fn new(code: &'static str) -> Self {
        Code { code, value: None, limit: None, place: None }
    }

    /// With its number.
    pub fn value(self, value: f64) -> Self {
        Code { value: Some(value), ..self }
    }

    /// With a count.
    pub fn count(self, count: usize) -> Self {
        self.value(count as f64)
    }

    /// With what its number was held against.
    pub fn limit(self, limit: f64) -> Self {
        Code { limit: Some(limit), ..self }
    }

    /// With what it is about.
    pub fn at(self, place: impl Into<String>) -> Self {
        Code { place: Some(place.into()), ..self }
    }

    /// About a vehicle.
    pub fn of_vehicle(self, id: &str) -> Self {
        self.at(format!("vehicle {id}"))
    }
}

/// Whatever has a sentence and a code.
pub trait Coded: fmt::Display {
    /// What the sentence says, for programs.
    fn coded(&self) -> Code;
}

/// Whatever is odd on the way from a problem folder to a result.
#[derive(Clone, Debug, PartialEq)]
pub enum Warning {
    /// About a file that was read, which says where.
    Input(String),
    /// About the first estimate.
    Initial(InitialWarning),
    /// About the adjustment.
    Adjustment(AdjustmentWarning),
    /// There are no standard deviations.
    NoSigmas(NoSigmas),
    /// Numbers of a table are not finite; their cells are empty.
    NotFinite {
        /// The table.
        table: String,
        /// The column.
        column: String,
        /// How many cells.
        cells: usize,
    },
    /// This build cannot write recordings.
    NoRecorder,
    /// A recording could not be written.
    NoRecording {
        /// What the system says.
        why: String,
    },
}

impl fmt::Display for NoSigmas {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            NoSigmas::NotReached => write!(f, "no standard deviations: the run ended before them"),
            NoSigmas::Failed(why) => write!(f, "no standard deviations: the diagnosis failed ({why})"),
            NoSigmas::NoLeastSquares => write!(f, "no standard deviations: there is no final least squares"),
            NoSigmas::NoCovariance(why) => write!(f, "no standard deviations: {why}"),
        }
    }
}

impl fmt::Display for Warning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Warning::Input(text) => f.write_str(text),
            Warning::Initial(warning) => warning.fmt(f),
            Warning::Adjustment(warning) => warning.fmt(f),
            Warning::NoSigmas(why) => why.fmt(f),
            Warning::NotFinite { table, column, cells } => {
                write!(
                    f,
                    "{table}: {column} is not a finite number in {}, left empty",
                    counted(*cells, "row")
                )
            }
            Warning::NoRecorder => write!(f, "no recording was written: this build has no Rerun"),
            Warning::NoRecording { why } => write!(f, "session.rrd is missing: {why}"),
        }
    }
}

impl Coded for Warning {
    fn coded(&self) -> Code {
        match self {
            Warning::Input(_) => Code::new("input"),
            Warning::Initial(warning) => warning.coded(),
            Warning::Adjustment(warning) => warning.coded(),
            Warning::NoSigmas(_) => Code::new("no_sigmas"),
            Warning::NotFinite { cells, .. } => Code::new("not_finite").count(*cells),
            Warning::NoRecorder => Code::new("no_recorder"),
            Warning::NoRecording { .. } => Code::new("no_recording"),
        }
    }
}

impl From<InitialWarning> for Warning {
    fn from(warning: InitialWarning) -> Self {
        Warning::Initial(warning)
    }
}

impl From<AdjustmentWarning> for Warning {
    fn from(warning: AdjustmentWarning) -> Self {
        Warning::Adjustment(warning)
    }
}
