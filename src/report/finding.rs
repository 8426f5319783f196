//! What was found in a form for programs, and how numbers are read.

use crate::words::{Code, Coded};
use serde::{Deserialize, Deserializer, Serialize};

/// What was found, for programs: a code that stays, and the sentence that may change.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(default)]
pub struct FindingReport {
    /// What it is.
    pub code: String,
    /// In a sentence.
    pub text: String,
    /// The number that it is about.
    pub value: Option<f64>,
    /// What that was held against.
    pub limit: Option<f64>,
    /// What it is about: `vehicle car`, `frame 12`.
    #[serde(rename = "where")]
    pub place: Option<String>,
}

impl FindingReport {
    /// Of anything that has a sentence and a code.
    pub fn new(found: &impl Coded) -> Self {
        let Code { code, value, limit, place } = found.coded();
        FindingReport { code: code.to_owned(), text: found.to_string(), value, limit, place }
    }
}

/// Reads a number; `null` is one that is none.
pub(super) fn number<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    Ok(Option::<f64>::deserialize(from)?.unwrap_or(f64::NAN))
}
