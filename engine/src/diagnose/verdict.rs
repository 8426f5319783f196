//! Whether a result can be trusted, and why, as data.
//!
//! A new reason is a variant of [`VerdictReason`] with its numbers, its line in [`VerdictReason::trust`], and its
//! sentence and code in the room `words`; the compiler names all three places.

use super::observability::{Class, Observability};
use super::{Diagnosis, NoSigmas, Parameter, PullCause, Source, VarianceTest};
use crate::problem::Problem;
use crate::refine::{Adjustment, CRITICAL, DirectedTest};
use crate::stats::quantile::upper_median;
use trackbundle_solver::minimise::Stop;

/// A scale that is held less well than this is said so, relative.
const WEAK_SCALE: f64 = 0.02;
/// A share of a scale's variance that is worth a word.
const WORTH_A_WORD: f64 = 0.05;
/// Probability below which check points are said to disagree.
const IMPROBABLE: f64 = 0.001;
/// By what the scatter of image points may differ from their stated standard deviations without a word.
const OTHER_SCATTER: f64 = 1.1;
/// A share of gross errors that calls for a look.
const MANY_GROSS: f64 = 0.3;
/// A convention may move nothing by more \[standard deviations\].
const PULLS: f64 = 0.2;
/// Probability of a heading that is half a turn wrong that is worth a word.
const TURNED: f64 = 0.05;
/// A source that holds a scale: without it the standard deviation is larger by more than this factor.
const HOLDS: f64 = 2.0;

/// How far a result can be trusted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Trust {
    /// As far as its standard deviations say.
    Yes,
    /// With what is named in mind.
    WithCare,
    /// Not: something is not determined, or was not solved.
    No,
}

impl Trust {
    /// Its name in files and for people.
    pub fn name(self) -> &'static str {
        match self {
            Trust::Yes => "yes",
            Trust::WithCare => "with care",
            Trust::No => "no",
        }
    }
}

/// What speaks against more trust. Vehicles and check points are told by their ids.
#[derive(Clone, Debug, PartialEq)]
pub enum VerdictReason {
    /// There are no standard deviations.
    NotDiagnosed {
        /// Why.
        why: NoSigmas,
    },
    /// The adjustment has not converged.
    NotConverged {
        /// Why it stopped.
        stop: Stop,
    },
    /// More or fewer directions are open than theory says.
    DefectUnexpected {
        /// How many are.
        found: usize,
        /// How many should be.
        expected: usize,
    },
    /// Nothing determines the scale of a vehicle.
    ScaleOpen {
        /// The vehicle.
        vehicle: String,
    },
    /// The scale of a vehicle is hardly held.
    ScaleWeak {
        /// The vehicle.
        vehicle: String,
        /// Its relative standard deviation.
        sigma: f64,
        /// What it was held against.
        limit: f64,
    },
    /// Only the motion prior holds the scale of a vehicle.
    ScaleByMotionAlone {
        /// The vehicle.
        vehicle: String,
    },
    /// Image points scatter more than stated.
    ImagesScatter {
        /// Which.
        source: Source,
        /// By what factor.
        factor: f64,
        /// What it was held against.
        limit: f64,
    },
    /// Many image points are gross errors.
    ManyGross {
        /// How many.
        gross: usize,
        /// Of how many.
        of: usize,
        /// What their share was held against.
        limit: f64,
    },
    /// Check points are off by more than their standard deviations allow.
    CheckPointsDisagree {
        /// Which.
        points: Vec<String>,
        /// The least probability of such a difference.
        probability: f64,
        /// What it was held against.
        limit: f64,
    },
    /// A convention pulls at what is read of a vehicle.
    ConventionPulls {
        /// The vehicle.
        vehicle: String,
        /// By how many standard deviations.
        sigmas: f64,
        /// What it was held against.
        limit: f64,
    },
    /// The x axis of a vehicle may point where it came from.
    HeadingTurned {
        /// The vehicle.
        vehicle: String,
        /// How probable that is.
        probability: f64,
        /// What it was held against.
        limit: f64,
    },
    /// The observations contradict what a number is held at.
    HeldNumberContradicted {
        /// The test.
        test: DirectedTest,
        /// What its statistic was held against.
        limit: f64,
    },
}

impl VerdictReason {
    /// How far a result can be trusted for which this holds, at the most.
    pub fn trust(&self) -> Trust {
        match self {
            VerdictReason::NotDiagnosed { .. }
            | VerdictReason::NotConverged { .. }
            | VerdictReason::ScaleOpen { .. } => Trust::No,
            VerdictReason::DefectUnexpected { .. }
            | VerdictReason::ScaleWeak { .. }
            | VerdictReason::ScaleByMotionAlone { .. }
            | VerdictReason::ImagesScatter { .. }
            | VerdictReason::ManyGross { .. }
            | VerdictReason::CheckPointsDisagree { .. }
            | VerdictReason::ConventionPulls { .. }
            | VerdictReason::HeadingTurned { .. }
            | VerdictReason::HeldNumberContradicted { .. } => Trust::WithCare,
        }
    }
}

/// What a verdict rests on. Vehicles and check points are told by their ids.
#[derive(Clone, Debug, PartialEq)]
pub enum VerdictFact {
    /// What is determined, and what is not.
    Datum {
        /// Combinations of unknowns that are determined.
        rank: usize,
        /// Unknowns.
        unknowns: usize,
        /// Names of open directions.
        open: Vec<String>,
        /// Names of weak directions.
        weak: Vec<String>,
    },
    /// The scale of a vehicle is not determined.
    ScaleOpen {
        /// The vehicle.
        vehicle: String,
    },
    /// The scale of a vehicle, and what holds it.
    Scale {
        /// The vehicle.
        vehicle: String,
        /// Its relative standard deviation.
        sigma: f64,
        /// Sources without any one of which it were much larger.
        held_by: Vec<Source>,
        /// Whether poses are given and exact.
        has_exact_poses: bool,
        /// What knowledge contributes to its variance, the largest share first.
        shares: Vec<(Source, f64)>,
    },
    /// How well places are determined.
    Sigmas {
        /// The vehicle.
        vehicle: String,
        /// Whether of the places of its track or of the points of its shape.
        is_track: bool,
        /// Median standard deviations of x, y, z \[m\].
        median_m: [f64; 3],
        /// Places that are not determined ...
        open: usize,
        /// ... of how many.
        of: usize,
    },
    /// The test of sigma0.
    VarianceTest {
        /// The test.
        test: VarianceTest,
        /// Sources that scatter otherwise than stated, and by what factor.
        other: Vec<(Source, f64)>,
    },
    /// How well gross errors of image points are found.
    Reliability {
        /// Median of what is found \[px\].
        detectable_px: f64,
        /// By how many standard deviations the worst moves a result that is not found.
        worst_sigmas: f64,
    },
    /// How well check points agree.
    CheckPoints {
        /// How many were intersected.
        points: usize,
        /// Root mean square of their distances \[m\].
        rms_m: f64,
        /// Those that are off by more than their standard deviations allow.
        improbable: Vec<String>,
    },
    /// A vehicle stands.
    Standing {
        /// The vehicle.
        vehicle: String,
        /// From when to when \[s\].
        times_s: Vec<[f64; 2]>,
    },
    /// A number that is adjusted beside poses and points.
    Estimated(Parameter),
    /// Nothing ties the video to other clocks.
    ClockOpen,
    /// Standard deviations are upper bounds.
    UpperBounds,
}

/// A verdict, and what it is from.
#[derive(Clone, Debug, PartialEq)]
pub struct Verdict {
    /// How far the result can be trusted: as far as every finding allows.
    pub trust: Trust,
    /// What speaks against more.
    pub findings: Vec<VerdictReason>,
    /// What it rests on.
    pub facts: Vec<VerdictFact>,
}

impl Verdict {
    /// The verdict on an adjustment alone.
    fn of_adjustment(adjustment: &Adjustment) -> Verdict {
        let mut verdict = Verdict { trust: Trust::Yes, findings: Vec::new(), facts: Vec::new() };
        if !adjustment.stop.converged() {
            verdict.find(VerdictReason::NotConverged { stop: adjustment.stop });
        }
        verdict
    }

    /// The verdict where there is no diagnosis.
    pub fn not_diagnosed(adjustment: &Adjustment, why: NoSigmas) -> Verdict {
        let mut verdict = Verdict::of_adjustment(adjustment);
        verdict.find(VerdictReason::NotDiagnosed { why });
        verdict
    }

    /// The verdict of a diagnosis.
    pub fn new(problem: &Problem, adjustment: &Adjustment, diagnosis: &Diagnosis) -> Verdict {
        let mut verdict = Verdict::of_adjustment(adjustment);
        if let Some(found) = &diagnosis.observability {
            verdict.add_datum(found);
        }
        verdict.add_scales(problem, diagnosis);
        verdict.add_pulls(problem, diagnosis);
        verdict.add_headings(problem, diagnosis);
        verdict.add_precision(problem, diagnosis);
        verdict.add_variances(diagnosis);
        verdict.add_images(adjustment, diagnosis);
        verdict.add_check_points(adjustment, diagnosis);
        verdict.add_parameters(problem, adjustment, diagnosis);
        if diagnosis.is_upper_bound {
            verdict.facts.push(VerdictFact::UpperBounds);
        }
        verdict
    }

    /// Adds a reason, and lowers the trust to what it allows.
    pub fn find(&mut self, reason: VerdictReason) {
        self.trust = self.trust.max(reason.trust());
        self.findings.push(reason);
    }

    fn add_datum(&mut self, found: &Observability) {
        let named = |class: Class| {
            found.directions.iter().filter(|d| d.class == class).map(|d| d.name.clone()).collect()
        };
        self.facts.push(VerdictFact::Datum {
            rank: found.rank,
            unknowns: found.unknowns,
            open: named(Class::Null),
            weak: named(Class::Weak),
        });
        if found.defect != found.expected_defect {
            let (found, expected) = (found.defect, found.expected_defect);
            self.find(VerdictReason::DefectUnexpected { found, expected });
        }
    }

    fn add_scales(&mut self, problem: &Problem, diagnosis: &Diagnosis) {
        for scale in &diagnosis.scales {
            let vehicle = || problem.vehicles[scale.vehicle].id.clone();
            if scale.sigma.is_infinite() {
                self.find(VerdictReason::ScaleOpen { vehicle: vehicle() });
                self.facts.push(VerdictFact::ScaleOpen { vehicle: vehicle() });
                continue;
            }
            if scale.sigma > WEAK_SCALE {
                let (sigma, limit) = (scale.sigma, WEAK_SCALE);
                self.find(VerdictReason::ScaleWeak { vehicle: vehicle(), sigma, limit });
            }
            let needs =
                |(_, without): &&(Source, f64)| without.is_infinite() || *without > HOLDS * scale.sigma;
            let held_by: Vec<Source> =
                scale.without.iter().filter(needs).map(|(source, _)| *source).collect();
            let is_knowledge = |source: &Source| {
                !matches!(source, Source::VehicleImages | Source::TargetImages | Source::Frame)
            };
            let is_told = |(source, share): &(Source, f64)| is_knowledge(source) && *share >= WORTH_A_WORD;
            let mut shares: Vec<(Source, f64)> = scale.shares.iter().copied().filter(is_told).collect();
            shares.sort_by(|a, b| b.1.total_cmp(&a.1));
            let by_motion_alone = held_by == [Source::VehicleMotion];
            self.facts.push(VerdictFact::Scale {
                vehicle: vehicle(),
                sigma: scale.sigma,
                held_by,
                has_exact_poses: problem.vehicle_pose_sigma.position_m == Some(0.0),
                shares,
            });
            if by_motion_alone {
                self.find(VerdictReason::ScaleByMotionAlone { vehicle: vehicle() });
            }
        }
    }

    fn add_pulls(&mut self, problem: &Problem, diagnosis: &Diagnosis) {
        for pull in diagnosis.pulls.iter().filter(|pull| pull.cause == PullCause::Conventions) {
            let (sigmas, limit) = (pull.largest(), PULLS);
            if sigmas > limit {
                let vehicle = problem.vehicles[pull.vehicle].id.clone();
                self.find(VerdictReason::ConventionPulls { vehicle, sigmas, limit });
            }
        }
    }

    fn add_headings(&mut self, problem: &Problem, diagnosis: &Diagnosis) {
        for (vehicle, probability) in problem.vehicles.iter().zip(&diagnosis.headings_turned) {
            let (probability, limit) = (*probability, TURNED);
            if probability > limit {
                let vehicle = vehicle.id.clone();
                self.find(VerdictReason::HeadingTurned { vehicle, probability, limit });
            }
        }
    }

    fn add_precision(&mut self, problem: &Problem, diagnosis: &Diagnosis) {
        for (at, vehicle) in problem.vehicles.iter().enumerate() {
            let track: Vec<[f64; 3]> =
                diagnosis.precision.tracks[at].iter().flatten().map(|p| p.position_m).collect();
            let points: Vec<[f64; 3]> = diagnosis.precision.points[at].iter().flatten().copied().collect();
            for (is_track, sigmas) in [(true, &track), (false, &points)] {
                if sigmas.is_empty() {
                    continue;
                }
                self.facts.push(VerdictFact::Sigmas {
                    vehicle: vehicle.id.clone(),
                    is_track,
                    median_m: [0, 1, 2].map(|axis| {
                        upper_median(sigmas.iter().map(|s| s[axis]).collect()).unwrap_or(f64::NAN)
                    }),
                    open: sigmas.iter().filter(|s| s.iter().any(|v| v.is_infinite())).count(),
                    of: sigmas.len(),
                });
            }
        }
    }

    fn add_variances(&mut self, diagnosis: &Diagnosis) {
        let statistics = &diagnosis.statistics;
        if let Some(test) = statistics.test {
            let other = statistics.components.iter().filter_map(|c| {
                let factor = c.sigma_factor()?;
                let is_sure = (factor.ln() / c.relative_sigma()).abs() > CRITICAL;
                (is_sure && factor.max(1.0 / factor) > OTHER_SCATTER).then_some((c.source, factor))
            });
            self.facts.push(VerdictFact::VarianceTest { test, other: other.collect() });
        }
        for component in &statistics.components {
            let source = component.source;
            let is_image = source.is_image();
            let factor = component.sigma_factor().filter(|factor| is_image && *factor > OTHER_SCATTER);
            if let Some(factor) = factor {
                self.find(VerdictReason::ImagesScatter { source, factor, limit: OTHER_SCATTER });
            }
        }
    }

    fn add_images(&mut self, adjustment: &Adjustment, diagnosis: &Diagnosis) {
        let statistics = &diagnosis.statistics;
        let fits = &adjustment.fits;
        let of: usize = fits.vehicles.iter().flatten().chain(&fits.targets).flatten().count();
        if fits.outliers as f64 > MANY_GROSS * of as f64 {
            self.find(VerdictReason::ManyGross { gross: fits.outliers, of, limit: MANY_GROSS });
        }
        let detectable: Vec<f64> = statistics
            .vehicles
            .iter()
            .filter(|vehicle| vehicle.rows > 0)
            .map(|vehicle| vehicle.minimal_detectable_px[0])
            .collect();
        if !detectable.is_empty() {
            self.facts.push(VerdictFact::Reliability {
                detectable_px: upper_median(detectable).unwrap_or(f64::NAN),
                worst_sigmas: statistics.vehicles.iter().map(|v| v.external[1]).fold(0.0, f64::max),
            });
        }
    }

    fn add_check_points(&mut self, adjustment: &Adjustment, diagnosis: &Diagnosis) {
        let found = &adjustment.check_points;
        let differences: Vec<f64> =
            found.iter().filter_map(|check| Some(check.difference_m?.norm_squared())).collect();
        if differences.is_empty() {
            return;
        }
        let (mut improbable, mut least) = (Vec::new(), 1.0_f64);
        for (check, precision) in found.iter().zip(&diagnosis.check_points) {
            let Some((_, probability)) = precision.chi_square.filter(|(_, p)| *p < IMPROBABLE) else {
                continue;
            };
            improbable.push(check.id.clone());
            least = least.min(probability);
        }
        if !improbable.is_empty() {
            let (points, probability) = (improbable.clone(), least);
            self.find(VerdictReason::CheckPointsDisagree { points, probability, limit: IMPROBABLE });
        }
        self.facts.push(VerdictFact::CheckPoints {
            points: differences.len(),
            rms_m: (differences.iter().sum::<f64>() / differences.len() as f64).sqrt(),
            improbable,
        });
    }

    fn add_parameters(&mut self, problem: &Problem, adjustment: &Adjustment, diagnosis: &Diagnosis) {
        for (vehicle, times_s) in problem.vehicles.iter().zip(&diagnosis.standstill) {
            if !times_s.is_empty() {
                let (vehicle, times_s) = (vehicle.id.clone(), times_s.clone());
                self.facts.push(VerdictFact::Standing { vehicle, times_s });
            }
        }
        self.facts.extend(diagnosis.parameters.iter().cloned().map(VerdictFact::Estimated));
        if problem.shutter.is_rolling() && problem.receivers.is_empty() {
            self.facts.push(VerdictFact::ClockOpen);
        }
        for test in adjustment.directed_tests.iter().filter(|test| test.is_rejected()) {
            self.find(VerdictReason::HeldNumberContradicted { test: test.clone(), limit: CRITICAL });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_worst_finding_decides() {
        let mut verdict = Verdict { trust: Trust::Yes, findings: Vec::new(), facts: Vec::new() };
        verdict.find(VerdictReason::ManyGross { gross: 4, of: 10, limit: MANY_GROSS });
        assert_eq!(verdict.trust, Trust::WithCare);
        verdict.find(VerdictReason::ScaleOpen { vehicle: "car".to_owned() });
        verdict.find(VerdictReason::DefectUnexpected { found: 2, expected: 1 });
        assert_eq!((verdict.trust, verdict.findings.len()), (Trust::No, 3));
    }
}
