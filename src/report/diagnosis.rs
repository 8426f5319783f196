//! The part of `report.json` that says how far a result can be trusted.

use crate::diagnose::observability::{Class, Observability};
use crate::diagnose::{Diagnosis, Parameter, Reliability, Verdict, source_name};
use crate::problem::Problem;
use crate::refine::DirectedTest;
use serde::{Serialize, Serializer};
use std::collections::BTreeMap;

/// A standard deviation: the text `"inf"` where a quantity is not determined.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sigma(pub f64);

impl Serialize for Sigma {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if self.0.is_finite() { serializer.serialize_f64(self.0) } else { serializer.serialize_str("inf") }
    }
}

/// Statistics of the final least squares.
#[derive(Clone, Debug, Serialize)]
pub struct StatisticsReport {
    /// Sum of all redundancy numbers: the redundancy.
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
#[derive(Clone, Debug, Serialize)]
pub struct VarianceTestReport {
    /// Sum of squares over redundancy.
    pub variance: f64,
    /// Where it lies in 95 % of cases, were all standard deviations right.
    pub interval: [f64; 2],
    /// Probability of a value at least as far off.
    pub probability: f64,
    /// Whether it is in the interval.
    pub passed: bool,
}

/// A kind of observation.
#[derive(Clone, Debug, Serialize)]
pub struct ComponentReport {
    /// Which.
    pub source: &'static str,
    /// Its rows.
    pub rows: usize,
    /// Sum of their redundancy numbers.
    pub redundancy: f64,
    /// By what its standard deviations would have to be multiplied.
    pub sigma_factor: Option<f64>,
    /// Standard deviation of this factor.
    pub sigma_of_factor: Option<f64>,
}

/// How well gross errors among image points would have been found.
#[derive(Clone, Debug, Serialize)]
pub struct ReliabilityReport {
    /// Coordinates of image points that took part.
    pub rows: usize,
    /// Least redundancy number of a coordinate.
    pub redundancy_number_least: f64,
    /// Median redundancy number.
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
    pub largest_standardised: f64,
}

/// What measurements and knowledge leave open.
#[derive(Clone, Debug, Serialize)]
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
#[derive(Clone, Debug, Serialize)]
pub struct DirectionReport {
    /// What it is.
    pub name: String,
    /// `null` or `weak`.
    pub class: &'static str,
    /// What rows see of it, as a share of what they see best.
    pub singular_ratio: f64,
    /// What holds it in the adjustment nevertheless.
    pub held_by: Option<&'static str>,
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
                name: d.name.clone(),
                class: match d.class {
                    Class::Null => "null",
                    Class::Weak => "weak",
                },
                singular_ratio: d.singular_ratio,
                held_by: d.held_by,
            })
            .collect(),
    }
}

/// A number that is adjusted beside poses and points.
#[derive(Clone, Debug, Serialize)]
pub struct ParameterReport {
    /// Its name, with its unit at the end.
    pub name: &'static str,
    /// Whose: vehicle and point of a receiver.
    pub of: Option<String>,
    /// What it was before.
    pub before: f64,
    /// Its standard deviation before; `null` where nothing was known.
    pub sigma_before: Option<f64>,
    /// What it is.
    pub value: f64,
    /// Its standard deviation.
    pub sigma: Sigma,
    /// Whether the observations say anything of it.
    pub observable: bool,
    /// How far the middle of a vehicle's shape would be off, were it held at what it was before.
    pub effect_m: f64,
    /// Correlations beyond 0.95, by name.
    pub correlations: BTreeMap<String, f64>,
}

/// A vehicle that stands.
#[derive(Clone, Debug, Serialize)]
pub struct StandstillReport {
    /// Its id.
    pub vehicle: String,
    /// From when.
    pub from_s: f64,
    /// To when.
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
#[derive(Clone, Debug, Serialize)]
pub struct DirectedTestReport {
    /// Its name, with its unit at the end.
    pub name: &'static str,
    /// Whose.
    pub of: Option<String>,
    /// What it is held at.
    pub held_at: f64,
    /// What it would be if it were free, to first order.
    pub estimate: f64,
    /// Standard deviation of that.
    pub sigma: f64,
    /// Standard normal where the number is what it is held at.
    pub statistic: f64,
    /// Whether that is rejected at a level of 0.1 %.
    pub rejected: bool,
}

/// The numbers of a diagnosis.
pub fn parameter_reports(diagnosis: &Diagnosis) -> Vec<ParameterReport> {
    let report = |found: &Parameter| ParameterReport {
        name: found.name,
        of: found.of.clone(),
        before: found.before,
        sigma_before: found.sigma_before,
        value: found.value,
        sigma: Sigma(found.sigma),
        observable: found.is_observable,
        effect_m: found.effect_m,
        correlations: found.correlated.iter().cloned().collect(),
    };
    diagnosis.parameters.iter().map(report).collect()
}

/// The tests of an adjustment.
pub fn directed_test_reports(tests: &[DirectedTest]) -> Vec<DirectedTestReport> {
    let report = |test: &DirectedTest| DirectedTestReport {
        name: test.name,
        of: test.of.clone(),
        held_at: test.held_at,
        estimate: test.estimate,
        sigma: test.sigma,
        statistic: test.statistic(),
        rejected: test.is_rejected(),
    };
    tests.iter().map(report).collect()
}

/// What determined the scale of a vehicle.
#[derive(Clone, Debug, Serialize)]
pub struct ScaleReport {
    /// Its id.
    pub vehicle: String,
    /// Relative standard deviation of its scale.
    pub sigma: Sigma,
    /// What each source contributes to its variance; they sum to one.
    pub shares: BTreeMap<&'static str, f64>,
    /// The relative standard deviation with one source left out.
    pub sigma_without: BTreeMap<&'static str, Sigma>,
    /// What an error of one standard deviation does that all rows of a source have in common.
    pub common_error: BTreeMap<&'static str, CommonErrorReport>,
    /// Directions of the frame of its body that nothing determines: inner constraints on the shape.
    pub frame_open_directions: usize,
    /// Standard deviations of the six directions of its frame from what is known, worst first: root mean
    /// square over its points.
    pub frame_sigma_m: Vec<Sigma>,
}

/// What a common error does.
#[derive(Clone, Debug, Serialize)]
pub struct CommonErrorReport {
    /// Relative change of the scale.
    pub scale: f64,
    /// How far the middle of the shape moves in the world.
    pub track_m: f64,
}

/// Whether a result can be trusted.
#[derive(Clone, Debug, Serialize)]
pub struct VerdictReport {
    /// `yes`, `with care` or `no`.
    pub trust: &'static str,
    /// What speaks against more.
    pub reasons: Vec<String>,
    /// What it rests on.
    pub facts: Vec<String>,
}

/// A verdict.
pub fn verdict_report(verdict: &Verdict) -> VerdictReport {
    VerdictReport {
        trust: verdict.trust.name(),
        reasons: verdict.reasons.clone(),
        facts: verdict.facts.iter().map(|(word, text)| format!("{word} {text}")).collect(),
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
                source: source_name(c.source),
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
    let report = |scale: &crate::diagnose::Scale| {
        let (open, sigmas) = &diagnosis.frames[scale.vehicle];
        ScaleReport {
            vehicle: problem.vehicles[scale.vehicle].id.clone(),
            sigma: Sigma(scale.sigma),
            shares: scale.shares.iter().map(|(source, share)| (source_name(*source), *share)).collect(),
            sigma_without: scale
                .without
                .iter()
                .map(|(source, sigma)| (source_name(*source), Sigma(*sigma)))
                .collect(),
            common_error: scale
                .common
                .iter()
                .map(|(source, error)| {
                    let report = CommonErrorReport { scale: error.scale, track_m: error.track_m };
                    (source_name(*source), report)
                })
                .collect(),
            frame_open_directions: *open,
            frame_sigma_m: sigmas.iter().map(|sigma| Sigma(*sigma)).collect(),
        }
    };
    diagnosis.scales.iter().map(report).collect()
}
