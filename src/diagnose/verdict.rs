//! Whether a result can be trusted, and why, in some ten lines.

use super::observability::{Class, Observability};
use super::{Diagnosis, Source, source_name};
use crate::problem::Problem;
use crate::refine::Adjustment;
use crate::stats::normal::TWO_SIDED_99_9;
use crate::stats::quantile::upper_median;

/// A scale that is held less well than this is said so, relative.
const WEAK_SCALE: f64 = 0.02;
/// A share of a scale's variance that is worth a word.
const WORTH_A_WORD: f64 = 0.05;
/// Probability below which check points are said to disagree.
const IMPROBABLE: f64 = 0.001;
/// By what the scatter of image points may differ from their stated standard deviations without a word.
const OTHER_SCATTER: f64 = 1.1;
/// The most directions that are named.
const MOST_NAMES: usize = 4;
/// A share of gross errors that calls for a look.
const MANY_GROSS: f64 = 0.3;

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
    /// In a word or two.
    pub fn name(self) -> &'static str {
        match self {
            Trust::Yes => "yes",
            Trust::WithCare => "with care",
            Trust::No => "no",
        }
    }
}

/// A verdict and its reasons.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Verdict {
    /// How far.
    pub trust: Trust,
    /// What speaks against more.
    pub reasons: Vec<String>,
    /// What it rests on: a word each, and what is to be said of it.
    pub facts: Vec<(&'static str, String)>,
}

impl Verdict {
    /// The verdict of a diagnosis.
    pub fn new(problem: &Problem, adjustment: &Adjustment, diagnosis: &Diagnosis) -> Verdict {
        let mut verdict = Verdict { trust: Trust::Yes, reasons: Vec::new(), facts: Vec::new() };
        if !adjustment.stop.converged() {
            verdict.lower(Trust::No, format!("the adjustment has not converged: {}", adjustment.stop));
        }
        if let Some(found) = &diagnosis.observability {
            verdict.add_datum(found);
        }
        verdict.add_scales(problem, diagnosis);
        verdict.add_precision(problem, diagnosis);
        verdict.add_images(adjustment, diagnosis);
        verdict.add_check_points(adjustment, diagnosis);
        verdict.add_parameters(problem, adjustment, diagnosis);
        if diagnosis.is_upper_bound {
            let text = "standard deviations are upper bounds: vehicles were judged one by one".to_owned();
            verdict.facts.push(("sigmas", text));
        }
        verdict
    }

    fn lower(&mut self, to: Trust, reason: String) {
        self.trust = self.trust.max(to);
        self.reasons.push(reason);
    }

    fn add_datum(&mut self, found: &Observability) {
        let named = |class: Class| {
            let names: Vec<&str> =
                found.directions.iter().filter(|d| d.class == class).map(|d| d.name.as_str()).collect();
            match names.len() {
                0 => String::new(),
                n if n > MOST_NAMES => {
                    format!("{} and {} more", names[..MOST_NAMES].join(" / "), n - MOST_NAMES)
                }
                _ => names.join(" / "),
            }
        };
        let mut text = format!("{} of {} unknowns determined", found.rank, found.unknowns);
        for (class, word) in [(Class::Null, "open"), (Class::Weak, "weak (ratio below 1e-3)")] {
            let names = named(class);
            if !names.is_empty() {
                text += &format!("; {word}: {names}");
            }
        }
        self.facts.push(("datum", text));
        if found.defect != found.expected_defect {
            self.lower(
                Trust::WithCare,
                format!("{} directions are open where theory has {}", found.defect, found.expected_defect),
            );
        }
    }

    fn add_scales(&mut self, problem: &Problem, diagnosis: &Diagnosis) {
        for scale in &diagnosis.scales {
            let id = &problem.vehicles[scale.vehicle].id;
            if scale.sigma.is_infinite() {
                self.lower(Trust::No, format!("nothing determines the scale of {id}"));
                let text =
                    format!("of {id}: not determined; size, height and track share one unknown factor");
                self.facts.push(("scale", text));
                continue;
            }
            if scale.sigma > WEAK_SCALE {
                let text = format!("the scale of {id} is held to {} only", percent(scale.sigma));
                self.lower(Trust::WithCare, text);
            }
            let knowledge = |source: &Source| {
                !matches!(source, Source::VehicleImages | Source::TargetImages | Source::Frame)
            };
            let needed: Vec<&'static str> = scale
                .without
                .iter()
                .filter(|(_, without)| without.is_infinite() || *without > 2.0 * scale.sigma)
                .map(|(source, _)| source_name(*source))
                .collect();
            let mut shares: Vec<(Source, f64)> =
                scale.shares.iter().copied().filter(|(source, _)| knowledge(source)).collect();
            shares.sort_by(|a, b| b.1.total_cmp(&a.1));
            let shares: Vec<String> = shares
                .iter()
                .filter(|(_, share)| *share >= WORTH_A_WORD)
                .map(|(source, share)| format!("{} {}", percent(*share), source_name(*source)))
                .collect();
            let mut text = format!("of {id}: sigma {}", percent(scale.sigma));
            if !needed.is_empty() {
                text += &format!(", held by {}", needed.join(" and "));
            } else if problem.vehicle_pose_sigma.position_m == Some(0.0) {
                text += ", held by exact poses";
            }
            if !shares.is_empty() {
                text += &format!("; of its variance {}", shares.join(", "));
            }
            self.facts.push(("scale", text));
            if needed == [source_name(Source::VehicleMotion)] {
                self.lower(Trust::WithCare, format!("only the motion prior holds the scale of {id}"));
            }
        }
    }

    fn add_precision(&mut self, problem: &Problem, diagnosis: &Diagnosis) {
        for (at, vehicle) in problem.vehicles.iter().enumerate() {
            let track: Vec<[f64; 3]> =
                diagnosis.precision.tracks[at].iter().flatten().map(|p| p.position_m).collect();
            let points: Vec<[f64; 3]> = diagnosis.precision.points[at].iter().flatten().copied().collect();
            for (name, sigmas) in [("track", &track), ("shape", &points)] {
                if sigmas.is_empty() {
                    continue;
                }
                let medians = [0, 1, 2]
                    .map(|axis| upper_median(sigmas.iter().map(|s| s[axis]).collect()).unwrap_or(f64::NAN));
                let open = sigmas.iter().filter(|s| s.iter().any(|v| v.is_infinite())).count();
                let mut text = format!(
                    "of {}: median sigma x {}, y {}, z {}",
                    vehicle.id,
                    centimetres(medians[0]),
                    centimetres(medians[1]),
                    centimetres(medians[2])
                );
                if open > 0 {
                    text += &format!("; not determined: {open} of {}", sigmas.len());
                }
                self.facts.push((name, text));
            }
        }
    }

    fn add_images(&mut self, adjustment: &Adjustment, diagnosis: &Diagnosis) {
        let statistics = &diagnosis.statistics;
        if let Some(test) = statistics.test {
            let mut text = format!(
                "sigma0^2 {:.3} from redundancy {:.0}; in 95 % of cases {:.3} to {:.3}",
                test.variance, test.redundancy, test.interval[0], test.interval[1]
            );
            if test.variance < test.interval[0] {
                text += " (below: less scatter than stated; standard deviations go by what was found)";
            } else if test.variance > test.interval[1] {
                text += " (above: more scatter than stated, or something is not modelled)";
            }
            let odd: Vec<String> = statistics
                .components
                .iter()
                .filter_map(|c| {
                    let factor = c.sigma_factor()?;
                    let is_sure = (factor.ln() / c.relative_sigma()).abs() > TWO_SIDED_99_9;
                    (is_sure && factor.max(1.0 / factor) > OTHER_SCATTER)
                        .then(|| format!("{} scatter {factor:.2} times as stated", source_name(c.source)))
                })
                .collect();
            if !odd.is_empty() {
                text += &format!("; {}", odd.join(", "));
            }
            self.facts.push(("test", text));
        }
        for component in &statistics.components {
            let is_image = matches!(component.source, Source::VehicleImages | Source::TargetImages);
            if let Some(factor) =
                component.sigma_factor().filter(|factor| is_image && *factor > OTHER_SCATTER)
            {
                let name = source_name(component.source);
                self.lower(
                    Trust::WithCare,
                    format!("{name} scatter {factor:.2} times as much as stated: they were weighed by it"),
                );
            }
        }
        let fits = &adjustment.fits;
        let all: usize = fits.vehicles.iter().flatten().chain(&fits.targets).flatten().count();
        if fits.outliers as f64 > MANY_GROSS * all as f64 {
            self.lower(Trust::WithCare, format!("{} of {all} image points are gross errors", fits.outliers));
        }
        let detectable: Vec<f64> = statistics
            .vehicles
            .iter()
            .filter(|vehicle| vehicle.rows > 0)
            .map(|vehicle| vehicle.minimal_detectable_px[0])
            .collect();
        if !detectable.is_empty() {
            let worst = statistics.vehicles.iter().map(|v| v.external[1]).fold(0.0, f64::max);
            self.facts.push((
                "reliability",
                format!(
                    "errors of an image point from {:.1} px are found; the worst that is not found moves a result by {worst:.1} sigma",
                    upper_median(detectable).unwrap_or(f64::NAN)
                ),
            ));
        }
    }

    fn add_check_points(&mut self, adjustment: &Adjustment, diagnosis: &Diagnosis) {
        let found = &adjustment.check_points;
        let differences: Vec<f64> =
            found.iter().filter_map(|check| Some(check.difference_m?.norm_squared())).collect();
        if differences.is_empty() {
            return;
        }
        let rms_m = (differences.iter().sum::<f64>() / differences.len() as f64).sqrt();
        let improbable: Vec<&str> = found
            .iter()
            .zip(&diagnosis.check_points)
            .filter(|(_, p)| p.chi_square.is_some_and(|(_, probability)| probability < IMPROBABLE))
            .map(|(check, _)| check.id.as_str())
            .collect();
        let mut text = format!("{} points, rms {}", differences.len(), centimetres(rms_m));
        if !improbable.is_empty() {
            text += &format!("; beyond what their sigmas allow: {}", improbable.join(", "));
            self.lower(Trust::WithCare, format!("check points disagree: {}", improbable.join(", ")));
        }
        self.facts.push(("check", text));
    }

    fn add_parameters(&mut self, problem: &Problem, adjustment: &Adjustment, diagnosis: &Diagnosis) {
        for (vehicle, found) in problem.vehicles.iter().zip(&diagnosis.standstill) {
            if !found.is_empty() {
                let times: Vec<String> =
                    found.iter().map(|[from, to]| format!("{from:.1} to {to:.1} s")).collect();
                self.facts.push(("standing", format!("{}: {}", vehicle.id, times.join(", "))));
            }
        }
        for found in &diagnosis.parameters {
            let name = found.full_name();
            if !found.is_observable {
                let kept = match found.sigma.is_infinite() {
                    true => "the observations say nothing of it".to_owned(),
                    false => format!("kept at {} +- {}", number(found.value), number(found.sigma)),
                };
                self.facts.push(("estimated", format!("{name}: not observable, {kept}")));
                continue;
            }
            let mut text = format!("{name} {} +- {}", number(found.value), number(found.sigma));
            if let Some(sigma) = found.sigma_before {
                text += &format!(" (before {} +- {})", number(found.before), number(sigma));
            }
            text += &format!("; moves the track by {}", centimetres(found.effect_m));
            for (other, r) in &found.correlated {
                text += &format!("; correlated with {other}: {r:.3}");
            }
            self.facts.push(("estimated", text));
        }
        if problem.shutter.is_rolling() && problem.receivers.is_empty() {
            let text = "offset to other clocks: not observable, no GNSS positions are observations";
            self.facts.push(("clock", text.to_owned()));
        }
        for test in adjustment.directed_tests.iter().filter(|test| test.is_rejected()) {
            let of = test.of.as_ref().map_or(String::new(), |of| format!(" of {of}"));
            self.lower(
                Trust::WithCare,
                format!(
                    "{}{of} is held at {}, and the observations say {} +- {}: {:.1} sigma",
                    test.name,
                    number(test.held_at),
                    number(test.estimate),
                    number(test.sigma),
                    test.statistic().abs()
                ),
            );
        }
    }

    /// Line by line.
    pub fn lines(&self) -> Vec<(&'static str, String)> {
        let mut lines = vec![(
            "trust",
            match self.reasons.as_slice() {
                [] => "yes, as far as the standard deviations say".to_owned(),
                reasons => format!("{}: {}", self.trust.name(), reasons.join("; ")),
            },
        )];
        lines.extend(self.facts.iter().cloned());
        lines
    }
}

fn percent(share: f64) -> String {
    let percent = 100.0 * share;
    if percent < 1.0 { format!("{percent:.2} %") } else { format!("{percent:.0} %") }
}

/// Four digits, at least.
fn number(value: f64) -> String {
    let digits = match value.abs() {
        v if v >= 100.0 => 2,
        v if v >= 1.0 => 3,
        v if v >= 1e-4 || v == 0.0 => 5,
        _ => return format!("{value:.3e}"),
    };
    format!("{value:.digits$}")
}

fn centimetres(length_m: f64) -> String {
    if length_m.is_infinite() { "inf".to_owned() } else { format!("{:.1} cm", 100.0 * length_m) }
}
