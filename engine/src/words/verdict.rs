//! What a verdict says.

use super::format::{centimetres, estimated, percent};
use super::{Code, Coded, source_name};
use crate::diagnose::{Parameter, Trust, VarianceTest, Verdict, VerdictFact, VerdictReason};
use crate::refine::{DirectedTest, Source};
use std::fmt;

/// The most directions that are named.
const MOST_NAMES: usize = 4;

impl fmt::Display for VerdictReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            VerdictReason::NotDiagnosed { why } => write!(f, "{why}"),
            VerdictReason::NotConverged { stop } => write!(f, "the adjustment has not converged: {stop}"),
            VerdictReason::DefectUnexpected { found, expected } => {
                write!(f, "{found} directions are open where theory has {expected}")
            }
            VerdictReason::ScaleOpen { vehicle } => write!(f, "nothing determines the scale of {vehicle}"),
            VerdictReason::ScaleWeak { vehicle, sigma, .. } => {
                write!(f, "the scale of {vehicle} is held to {} only", percent(*sigma))
            }
            VerdictReason::ScaleByMotionAlone { vehicle } => {
                write!(f, "only the motion prior holds the scale of {vehicle}")
            }
            VerdictReason::ImagesScatter { source, factor, .. } => write!(
                f,
                "{} scatter {factor:.2} times as much as stated: they were weighed by it",
                source_name(*source)
            ),
            VerdictReason::ManyGross { gross, of, .. } => {
                write!(f, "{gross} of {of} image points are gross errors")
            }
            VerdictReason::CheckPointsDisagree { points, .. } => {
                write!(f, "check points disagree: {}", points.join(", "))
            }
            VerdictReason::ConventionPulls { vehicle, sigmas, .. } => write!(
                f,
                "what is assumed for want of knowledge moves {vehicle} by {sigmas:.1} of its standard deviations"
            ),
            VerdictReason::HeadingTurned { vehicle, probability, .. } => write!(
                f,
                "{vehicle} may look the other way (probability {}): it drove too little, or both ways, to tell front from rear",
                percent(*probability)
            ),
            VerdictReason::HeldNumberContradicted { test, .. } => write!(
                f,
                "{} is held at {}, and the observations say {} +- {}: {:.1} sigma",
                test_named(test),
                estimated(test.held_at),
                estimated(test.estimate),
                estimated(test.sigma),
                test.statistic().abs()
            ),
        }
    }
}

fn test_named(test: &DirectedTest) -> String {
    let of = test.of.as_ref().map_or(String::new(), |of| format!(" of {of}"));
    format!("{}{of}", test.name)
}

impl Coded for VerdictReason {
    fn coded(&self) -> Code {
        match self {
            VerdictReason::NotDiagnosed { .. } => Code::new("not_diagnosed"),
            VerdictReason::NotConverged { .. } => Code::new("not_converged"),
            VerdictReason::DefectUnexpected { found, expected } => {
                Code::new("defect_unexpected").count(*found).limit(*expected as f64)
            }
            VerdictReason::ScaleOpen { vehicle } => Code::new("scale_open").of_vehicle(vehicle),
            VerdictReason::ScaleWeak { vehicle, sigma, limit } => {
                Code::new("scale_weak").value(*sigma).limit(*limit).of_vehicle(vehicle)
            }
            VerdictReason::ScaleByMotionAlone { vehicle } => {
                Code::new("scale_by_motion_alone").of_vehicle(vehicle)
            }
            VerdictReason::ImagesScatter { source, factor, limit } => {
                let code = match source {
                    Source::TargetImages => "target_images_scatter",
                    _ => "vehicle_images_scatter",
                };
                Code::new(code).value(*factor).limit(*limit)
            }
            VerdictReason::ManyGross { gross, of, limit } => {
                Code::new("many_gross_errors").value(*gross as f64 / *of as f64).limit(*limit)
            }
            VerdictReason::CheckPointsDisagree { points, probability, limit } => {
                let code = Code::new("check_points_disagree").value(*probability).limit(*limit);
                code.at(format!("targets {}", points.join(", ")))
            }
            VerdictReason::ConventionPulls { vehicle, sigmas, limit } => {
                Code::new("convention_pulls").value(*sigmas).limit(*limit).of_vehicle(vehicle)
            }
            VerdictReason::HeadingTurned { vehicle, probability, limit } => {
                Code::new("heading_turned").value(*probability).limit(*limit).of_vehicle(vehicle)
            }
            VerdictReason::HeldNumberContradicted { test, limit } => {
                let code = Code::new("held_number_contradicted").value(test.statistic().abs()).limit(*limit);
                code.at(test_named(test))
            }
        }
    }
}

/// The word before a fact, which is its code too.
pub fn fact_word(fact: &VerdictFact) -> &'static str {
    match fact {
        VerdictFact::Datum { .. } => "datum",
        VerdictFact::ScaleOpen { .. } | VerdictFact::Scale { .. } => "scale",
        VerdictFact::Sigmas { is_track: true, .. } => "track",
        VerdictFact::Sigmas { is_track: false, .. } => "shape",
        VerdictFact::VarianceTest { .. } => "test",
        VerdictFact::Reliability { .. } => "reliability",
        VerdictFact::CheckPoints { .. } => "check",
        VerdictFact::Standing { .. } => "standing",
        VerdictFact::Estimated(_) => "estimated",
        VerdictFact::ClockOpen => "clock",
        VerdictFact::UpperBounds => "sigmas",
    }
}

impl fmt::Display for VerdictFact {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            VerdictFact::Datum { rank, unknowns, open, weak } => {
                write!(f, "{rank} of {unknowns} unknowns determined")?;
                write_directions(f, "open", open)?;
                write_directions(f, "weak (ratio below 1e-3)", weak)
            }
            VerdictFact::ScaleOpen { vehicle } => {
                write!(f, "of {vehicle}: not determined; size, height and track share one unknown factor")
            }
            VerdictFact::Scale { vehicle, sigma, held_by, has_exact_poses, shares } => {
                write!(f, "of {vehicle}: sigma {}", percent(*sigma))?;
                write_holders(f, held_by, *has_exact_poses)?;
                write_shares(f, shares)
            }
            VerdictFact::Sigmas { vehicle, median_m, open, of, .. } => {
                let [x, y, z] = median_m.map(centimetres);
                write!(f, "of {vehicle}: median sigma x {x}, y {y}, z {z}")?;
                if *open > 0 { write!(f, "; not determined: {open} of {of}") } else { Ok(()) }
            }
            VerdictFact::VarianceTest { test, other } => write_test(f, test, other),
            VerdictFact::Reliability { detectable_px, worst_sigmas } => write!(
                f,
                "errors of an image point from {detectable_px:.1} px are found; the worst that is not found moves a result by {worst_sigmas:.1} sigma"
            ),
            VerdictFact::CheckPoints { points, rms_m, improbable } => {
                write!(f, "{points} points, rms {}", centimetres(*rms_m))?;
                match improbable.as_slice() {
                    [] => Ok(()),
                    improbable => write!(f, "; beyond what their sigmas allow: {}", improbable.join(", ")),
                }
            }
            VerdictFact::Standing { vehicle, times_s } => {
                let times: Vec<String> =
                    times_s.iter().map(|[from, to]| format!("{from:.1} to {to:.1} s")).collect();
                write!(f, "{vehicle}: {}", times.join(", "))
            }
            VerdictFact::Estimated(found) => write_estimated(f, found),
            VerdictFact::ClockOpen => {
                write!(f, "offset to other clocks: not observable, no GNSS positions are observations")
            }
            VerdictFact::UpperBounds => {
                write!(f, "standard deviations are upper bounds: vehicles were judged one by one")
            }
        }
    }
}

fn write_directions(f: &mut fmt::Formatter<'_>, word: &str, names: &[String]) -> fmt::Result {
    match names.len() {
        0 => Ok(()),
        n if n > MOST_NAMES => {
            write!(f, "; {word}: {} and {} more", names[..MOST_NAMES].join(" / "), n - MOST_NAMES)
        }
        _ => write!(f, "; {word}: {}", names.join(" / ")),
    }
}

fn write_holders(f: &mut fmt::Formatter<'_>, held_by: &[Source], has_exact_poses: bool) -> fmt::Result {
    let names: Vec<&str> = held_by.iter().map(|source| source_name(*source)).collect();
    match (names.is_empty(), has_exact_poses) {
        (false, _) => write!(f, ", held by {}", names.join(" and ")),
        (true, true) => write!(f, ", held by exact poses"),
        (true, false) => Ok(()),
    }
}

fn write_shares(f: &mut fmt::Formatter<'_>, shares: &[(Source, f64)]) -> fmt::Result {
    if shares.is_empty() {
        return Ok(());
    }
    let told = shares.iter().map(|(source, share)| format!("{} {}", percent(*share), source_name(*source)));
    write!(f, "; of its variance {}", told.collect::<Vec<_>>().join(", "))
}

fn write_test(f: &mut fmt::Formatter<'_>, test: &VarianceTest, other: &[(Source, f64)]) -> fmt::Result {
    let [least, most] = test.interval;
    write!(
        f,
        "sigma0^2 {:.3} from redundancy {:.0}; in 95 % of cases {least:.3} to {most:.3}",
        test.variance, test.redundancy
    )?;
    if test.variance < least {
        write!(f, " (below: less scatter than stated; standard deviations go by what was found)")?;
    } else if test.variance > most {
        write!(f, " (above: more scatter than stated, or something is not modelled)")?;
    }
    let told = |(source, factor): &(Source, f64)| {
        format!("{} scatter {factor:.2} times as stated", source_name(*source))
    };
    match other {
        [] => Ok(()),
        other => write!(f, "; {}", other.iter().map(told).collect::<Vec<_>>().join(", ")),
    }
}

fn write_estimated(f: &mut fmt::Formatter<'_>, found: &Parameter) -> fmt::Result {
    let name = found.full_name();
    if !found.is_observable {
        write!(f, "{name}: not observable, ")?;
        return match found.sigma.is_infinite() {
            true => write!(f, "the observations say nothing of it"),
            false => write!(f, "kept at {} +- {}", estimated(found.value), estimated(found.sigma)),
        };
    }
    write!(f, "{name} {} +- {}", estimated(found.value), estimated(found.sigma))?;
    if let Some(sigma) = found.sigma_before {
        write!(f, " (before {} +- {})", estimated(found.before), estimated(sigma))?;
    }
    write!(f, "; moves the track by {}", centimetres(found.effect_m))?;
    found.correlated.iter().try_for_each(|(other, r)| write!(f, "; correlated with {other}: {r:.3}"))
}

/// A verdict line by line: a word, and what is to be said of it.
pub fn verdict_lines(verdict: &Verdict) -> Vec<(&'static str, String)> {
    let reasons: Vec<String> = verdict.findings.iter().map(ToString::to_string).collect();
    let trust = match verdict.trust {
        Trust::Yes => "yes, as far as the standard deviations say".to_owned(),
        trust => format!("{}: {}", trust.name(), reasons.join("; ")),
    };
    let facts = verdict.facts.iter().map(|fact| (fact_word(fact), fact.to_string()));
    [("trust", trust)].into_iter().chain(facts).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scale_says_what_holds_it() {
        let held_by = vec![Source::Terrain, Source::KnownHeight];
        let shares = vec![(Source::Terrain, 0.75), (Source::KnownHeight, 0.005)];
        let vehicle = "car".to_owned();
        let fact = VerdictFact::Scale { vehicle, sigma: 0.0123, held_by, has_exact_poses: true, shares };
        assert_eq!(
            fact.to_string(),
            "of car: sigma 1 %, held by terrain contact and known height; of its variance 75 % terrain contact, 0.50 % known height"
        );
        assert_eq!(fact_word(&fact), "scale");
    }

    #[test]
    fn a_finding_has_its_numbers_beside_the_sentence() {
        let found = VerdictReason::ScaleWeak { vehicle: "car".to_owned(), sigma: 0.05, limit: 0.02 };
        assert_eq!(found.to_string(), "the scale of car is held to 5 % only");
        let code = Code::new("scale_weak").value(0.05).limit(0.02).at("vehicle car");
        assert_eq!(found.coded(), code);
    }

    #[test]
    fn many_directions_are_counted() {
        let names = |count: usize| (0..count).map(|at| format!("d{at}")).collect::<Vec<_>>();
        let fact = VerdictFact::Datum { rank: 1, unknowns: 7, open: names(6), weak: names(1) };
        assert_eq!(
            fact.to_string(),
            "1 of 7 unknowns determined; open: d0 / d1 / d2 / d3 and 2 more; weak (ratio below 1e-3): d0"
        );
    }
}
