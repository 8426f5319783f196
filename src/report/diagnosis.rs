//! The part of `report.json` that says how far a result can be trusted.

use super::finding::{FindingReport, number};
use crate::diagnose::observability::{Class, Observability};
use crate::diagnose::{Diagnosis, Parameter, Pull, PullCause, Reliability, Verdict, source_key};
use crate::problem::Problem;
use crate::refine::DirectedTest;
use crate::words::{direction_code, fact_word};
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::collections::BTreeMap;

/// A standard deviation: the text `"inf"` where a quantity is not determined.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sigma(pub f64);

impl Serialize for Sigma {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if self.0.is_finite() { serializer.serialize_f64(self.0) } else { serializer.serialize_str("inf") }
    }
}

impl Default for Sigma {
    fn default() -> Self {
        Sigma(f64::NAN)
    }
}

impl<'de> Deserialize<'de> for Sigma {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        #[derive(Deserialize)]
        #[serde(untagged)]
        enum Written {
            Number(f64),
            Text(String),
        }
        match Written::deserialize(from)? {
            Written::Number(sigma) => Ok(Sigma(sigma)),
            Written::Text(text) if text == "inf" => Ok(Sigma(f64::INFINITY)),
            Written::Text(text) => {
                Err(D::Error::custom(format!("expected a number or \"inf\", found {text:?}")))
            }
        }
    }
}

#[cfg(test)]
impl schemars::JsonSchema for Sigma {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "Sigma".into()
    }

    fn json_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
        schemars::json_schema!({
            "description": "A standard deviation: the text \"inf\" where a quantity is not determined.",
            "anyOf": [{"type": "number"}, {"const": "inf"}],
        })
    }
}

/// Statistics of the final least squares.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(default)]
pub struct StatisticsReport {
    /// Sum of all redundancy numbers: the redundancy.
    #[serde(deserialize_with = "number")]
    #[cfg_attr(test, schemars(with = "Option<f64>"))]
    pub redundancy_numbers: f64,
    /// The test of sigma0^2 against 1, at 5 %.
    pub variance_test: Option<VarianceTestReport>,
    /// One for each kind of observation.
    pub variance_components: Vec<ComponentReport>,
    /// One for each vehicle that took part, by its id.
    pub vehicles: BTreeMap<String, ReliabilityReport>,
    /// That of image points of targets.
    pub targets: Option<ReliabilityReport>,
}

/// The test of sigma0^2.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(default)]
pub struct VarianceTestReport {
    /// Sum of squares over redundancy.
    #[serde(deserialize_with = "number")]
    #[cfg_attr(test, schemars(with = "Option<f64>"))]
    pub variance: f64,
    /// Where it lies in 95 % of cases, were all standard deviations right.
    pub interval: [f64; 2],
    /// Probability of a value at least as far off.
    #[serde(deserialize_with = "number")]
    #[cfg_attr(test, schemars(with = "Option<f64>"))]
    pub probability: f64,
    /// Whether it is in the interval.
    pub passed: bool,
}

/// A kind of observation.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(default)]
pub struct ComponentReport {
    /// Which.
    pub source: String,
    /// Its rows.
    pub rows: usize,
    /// Sum of their redundancy numbers.
    #[serde(deserialize_with = "number")]
    #[cfg_attr(test, schemars(with = "Option<f64>"))]
    pub redundancy: f64,
    /// By what its standard deviations would have to be multiplied.
    pub sigma_factor: Option<f64>,
    /// Standard deviation of this factor.
    pub sigma_of_factor: Option<f64>,
}

/// How well gross errors among image points would have been found.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(default)]
pub struct ReliabilityReport {
    /// Coordinates of image points that took part.
    pub rows: usize,
    /// Least redundancy number of a coordinate.
    #[serde(deserialize_with = "number")]
    #[cfg_attr(test, schemars(with = "Option<f64>"))]
    pub redundancy_number_least: f64,
    /// Median redundancy number.
    #[serde(deserialize_with = "number")]
    #[cfg_attr(test, schemars(with = "Option<f64>"))]
    pub redundancy_number_median: f64,
    /// Minimal detectable error (0.1 %, power 80 %), median.
    pub minimal_detectable_px_median: Sigma,
    /// The largest.
    pub minimal_detectable_px_largest: Sigma,
    /// By how many standard deviations such an error may move a function of the unknowns, median.
    pub external_sigmas_median: Sigma,
    /// The largest.
    pub external_sigmas_largest: Sigma,
    /// Standardised residuals beyond 3.29.
    pub beyond_critical: usize,
    /// The largest standardised residual.
    #[serde(deserialize_with = "number")]
    #[cfg_attr(test, schemars(with = "Option<f64>"))]
    pub largest_standardised: f64,
}

/// What measurements and knowledge leave open.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(default)]
pub struct ObservabilityReport {
    /// How many numbers are unknown.
    pub unknowns: usize,
    /// How many of their combinations are determined, weak ones too.
    pub rank: usize,
    /// How many are not.
    pub defect: usize,
    /// How many should not be, by theory.
    pub expected_defect: usize,
    /// Whether singular values were computed, not only what theory names.
    pub decomposed: bool,
    /// What is open or weak.
    pub directions: Vec<DirectionReport>,
}

/// A direction.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(default)]
pub struct DirectionReport {
    /// What it is, for programs.
    pub code: String,
    /// What it is, for people.
    pub name: String,
    /// `null` or `weak`.
    pub class: String,
    /// What rows see of it, as a share of what they see best.
    #[serde(deserialize_with = "number")]
    #[cfg_attr(test, schemars(with = "Option<f64>"))]
    pub singular_ratio: f64,
    /// What holds it in the adjustment nevertheless.
    pub held_by: Option<String>,
}

/// What is left open.
pub fn observability_report(found: &Observability) -> ObservabilityReport {
    ObservabilityReport {
        unknowns: found.unknowns,
        rank: found.rank,
        defect: found.defect,
        expected_defect: found.expected_defect,
        decomposed: found.is_dense,
        directions: found
            .directions
            .iter()
            .map(|d| DirectionReport {
                code: direction_code(&d.kind).to_owned(),
                name: d.name.clone(),
                class: match d.class {
                    Class::Null => "null".to_owned(),
                    Class::Weak => "weak".to_owned(),
                },
                singular_ratio: d.singular_ratio,
                held_by: d.held_by.map(str::to_owned),
            })
            .collect(),
    }
}

/// A number that is adjusted beside poses and points.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(default)]
pub struct ParameterReport {
    /// Its name, with its unit at the end.
    pub name: String,
    /// Whose: vehicle and point of a receiver.
    pub of: Option<String>,
    /// What it was before.
    pub before: Option<f64>,
    /// Its standard deviation before; `null` where nothing was known.
    pub sigma_before: Option<f64>,
    /// What it is.
    pub value: Option<f64>,
    /// Its standard deviation.
    pub sigma: Option<Sigma>,
    /// Whether the observations say anything of it.
    #[serde(default = "yes")]
    pub observable: bool,
    /// How far the middle of a vehicle's shape would be off, were it held at what it was before.
    pub effect_m: Option<f64>,
    /// Correlations beyond 0.95, by name.
    pub correlations: BTreeMap<String, f64>,
}

fn yes() -> bool {
    true
}

/// A vehicle that stands.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(default)]
pub struct StandstillReport {
    /// Its id.
    pub vehicle: String,
    /// From when.
    #[serde(deserialize_with = "number")]
    #[cfg_attr(test, schemars(with = "Option<f64>"))]
    pub from_s: f64,
    /// To when.
    #[serde(deserialize_with = "number")]
    #[cfg_attr(test, schemars(with = "Option<f64>"))]
    pub to_s: f64,
}

/// When vehicles stand.
pub fn standstill_reports(problem: &Problem, diagnosis: &Diagnosis) -> Vec<StandstillReport> {
    let all = problem.vehicles.iter().zip(&diagnosis.standstill);
    all.flat_map(|(vehicle, found)| {
        found.iter().map(|[from_s, to_s]| StandstillReport {
            vehicle: vehicle.id.clone(),
            from_s: *from_s,
            to_s: *to_s,
        })
    })
    .collect()
}

/// The test of a number that is held.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(default)]
pub struct DirectedTestReport {
    /// Its name, with its unit at the end.
    pub name: String,
    /// Whose.
    pub of: Option<String>,
    /// What it is held at.
    pub held_at: Option<f64>,
    /// What it would be if it were free, to first order.
    pub estimate: Option<f64>,
    /// Standard deviation of that.
    pub sigma: Option<f64>,
    /// Standard normal where the number is what it is held at.
    pub statistic: Option<f64>,
    /// Whether that is rejected at a level of 0.1 %.
    pub rejected: bool,
}

/// The numbers of a diagnosis.
pub fn parameter_reports(diagnosis: &Diagnosis) -> Vec<ParameterReport> {
    let report = |found: &Parameter| ParameterReport {
        name: found.name.to_owned(),
        of: found.of.clone(),
        before: Some(found.before),
        sigma_before: found.sigma_before,
        value: Some(found.value),
        sigma: Some(Sigma(found.sigma)),
        observable: found.is_observable,
        effect_m: Some(found.effect_m),
        correlations: found.correlated.iter().cloned().collect(),
    };
    diagnosis.parameters.iter().map(report).collect()
}

/// The tests of an adjustment.
pub fn directed_test_reports(tests: &[DirectedTest]) -> Vec<DirectedTestReport> {
    let report = |test: &DirectedTest| DirectedTestReport {
        name: test.name.to_owned(),
        of: test.of.clone(),
        held_at: Some(test.held_at),
        estimate: Some(test.estimate),
        sigma: Some(test.sigma),
        statistic: Some(test.statistic()),
        rejected: test.is_rejected(),
    };
    tests.iter().map(report).collect()
}

/// What determined the scale of a vehicle.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(default)]
pub struct ScaleReport {
    /// Its id.
    pub vehicle: String,
    /// Relative standard deviation of its scale.
    pub sigma: Option<Sigma>,
    /// What each source contributes to its variance; they sum to one.
    pub shares: BTreeMap<String, Option<f64>>,
    /// The relative standard deviation with one source left out.
    pub sigma_without: BTreeMap<String, Sigma>,
    /// What an error of one standard deviation does that all rows of a source have in common.
    pub common_error: BTreeMap<String, CommonErrorReport>,
    /// Directions of the frame of its body that nothing determines: inner constraints on the shape.
    pub frame_open_directions: usize,
    /// Standard deviations of the six directions of its frame from what is known, worst first: root mean
    /// square over its points.
    pub frame_sigma_m: Vec<Sigma>,
}

/// How far something that is no knowledge pulls at a vehicle and its cameras, in their standard deviations.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(default)]
pub struct PullReport {
    /// The id of the vehicle.
    pub vehicle: String,
    /// `conventions`, or `motion strengths`: an error of one standard deviation in those that were estimated.
    pub cause: String,
    /// At its scale.
    pub scale_sigmas: Option<f64>,
    /// At the coordinate of its track that is pulled most.
    pub track_sigmas: Option<f64>,
    /// At the coordinate of its shape that is pulled most.
    pub shape_sigmas: Option<f64>,
    /// At the coordinate of a camera position that is pulled most.
    pub camera_sigmas: Option<f64>,
}

/// Pulls of a diagnosis.
pub fn pull_reports(problem: &Problem, diagnosis: &Diagnosis) -> Vec<PullReport> {
    let report = |pull: &Pull| PullReport {
        vehicle: problem.vehicles[pull.vehicle].id.clone(),
        cause: match pull.cause {
            PullCause::Conventions => "conventions".to_owned(),
            PullCause::MotionStrengths => "motion strengths".to_owned(),
        },
        scale_sigmas: Some(pull.scale),
        track_sigmas: Some(pull.track),
        shape_sigmas: Some(pull.shape),
        camera_sigmas: Some(pull.camera),
    };
    diagnosis.pulls.iter().map(report).collect()
}

/// What a common error does.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(default)]
pub struct CommonErrorReport {
    /// Relative change of the scale.
    #[serde(deserialize_with = "number")]
    #[cfg_attr(test, schemars(with = "Option<f64>"))]
    pub scale: f64,
    /// How far the middle of the shape moves in the world.
    #[serde(deserialize_with = "number")]
    #[cfg_attr(test, schemars(with = "Option<f64>"))]
    pub track_m: f64,
}

/// Whether a result can be trusted.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(default)]
pub struct VerdictReport {
    /// `yes`, `with care` or `no`.
    pub trust: String,
    /// What speaks against more.
    pub reasons: Vec<String>,
    /// What it rests on: a word that stays, and what is to be said.
    pub facts: Vec<String>,
    /// The reasons for programs, in the same order.
    pub findings: Vec<FindingReport>,
}

/// A verdict.
pub fn verdict_report(verdict: &Verdict) -> VerdictReport {
    VerdictReport {
        trust: verdict.trust.name().to_owned(),
        reasons: verdict.findings.iter().map(ToString::to_string).collect(),
        facts: verdict.facts.iter().map(|fact| format!("{} {fact}", fact_word(fact))).collect(),
        findings: verdict.findings.iter().map(FindingReport::new).collect(),
    }
}

/// Statistics of a diagnosis.
pub fn statistics_report(problem: &Problem, diagnosis: &Diagnosis) -> StatisticsReport {
    let statistics = &diagnosis.statistics;
    let vehicles = problem.vehicles.iter().zip(&statistics.vehicles);
    StatisticsReport {
        redundancy_numbers: statistics.redundancy_numbers,
        variance_test: statistics.test.map(|test| VarianceTestReport {
            variance: test.variance,
            interval: test.interval,
            probability: test.probability,
            passed: test.is_passed(),
        }),
        variance_components: statistics
            .components
            .iter()
            .map(|c| ComponentReport {
                source: source_key(c.source).to_owned(),
                rows: c.rows,
                redundancy: c.redundancy,
                sigma_factor: c.sigma_factor(),
                sigma_of_factor: c.sigma_factor().map(|factor| factor * c.relative_sigma()),
            })
            .collect(),
        vehicles: vehicles
            .filter_map(|(vehicle, found)| Some((vehicle.id.clone(), reliability_report(found)?)))
            .collect(),
        targets: reliability_report(&statistics.targets),
    }
}

fn reliability_report(found: &Reliability) -> Option<ReliabilityReport> {
    (found.rows > 0).then_some(ReliabilityReport {
        rows: found.rows,
        redundancy_number_least: found.redundancy_number[0],
        redundancy_number_median: found.redundancy_number[1],
        minimal_detectable_px_median: Sigma(found.minimal_detectable_px[0]),
        minimal_detectable_px_largest: Sigma(found.minimal_detectable_px[1]),
        external_sigmas_median: Sigma(found.external[0]),
        external_sigmas_largest: Sigma(found.external[1]),
        beyond_critical: found.beyond_critical,
        largest_standardised: found.largest,
    })
}

/// Scales of a diagnosis.
pub fn scale_reports(problem: &Problem, diagnosis: &Diagnosis) -> Vec<ScaleReport> {
    let key = |source| source_key(source).to_owned();
    let report = |scale: &crate::diagnose::Scale| {
        let (open, sigmas) = &diagnosis.frames[scale.vehicle];
        ScaleReport {
            vehicle: problem.vehicles[scale.vehicle].id.clone(),
            sigma: Some(Sigma(scale.sigma)),
            shares: scale.shares.iter().map(|(source, share)| (key(*source), Some(*share))).collect(),
            sigma_without: scale
                .without
                .iter()
                .map(|(source, sigma)| (key(*source), Sigma(*sigma)))
                .collect(),
            common_error: scale
                .common
                .iter()
                .map(|(source, error)| {
                    let report = CommonErrorReport { scale: error.scale, track_m: error.track_m };
                    (key(*source), report)
                })
                .collect(),
            frame_open_directions: *open,
            frame_sigma_m: sigmas.iter().map(|sigma| Sigma(*sigma)).collect(),
        }
    };
    diagnosis.scales.iter().map(report).collect()
}
