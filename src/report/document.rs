//! The verdict and what it rests on as a document to read beside a recording, in Markdown.

use super::Report;
use super::diagnosis::{DirectionReport, ScaleReport};
use crate::words::format::percent_or_open;

/// The document of a `report.json`; what it does not have is left out.
pub fn document(report: &Report) -> String {
    let or_sign = |text: &str| if text.is_empty() { "-".to_owned() } else { text.to_owned() };
    let mut out = format!("# {}\n\n", or_sign(&report.problem));
    match &report.verdict {
        None => out += &format!("**{}**, not adjusted\n\n", or_sign(&report.status)),
        Some(verdict) => {
            out += &format!("**Can it be trusted? {}.**\n\n", or_sign(&verdict.trust));
            verdict.reasons.iter().for_each(|reason| out += &format!("- {reason}\n"));
            out += "\n";
            for fact in &verdict.facts {
                let (word, rest) = fact.split_once(' ').unwrap_or((fact, ""));
                out += &format!("- **{word}** {rest}\n");
            }
        }
    }
    out += &report.facts().document_lines();
    if !report.scales.is_empty() {
        out += "\n## Scale: what holds it\n\n";
    }
    report.scales.iter().for_each(|scale| out += &scale_line(scale));
    let directions = report.observability.as_ref().map_or(&[][..], |found| &found.directions);
    if !directions.is_empty() {
        out += "\n## Datum: what is open or weak\n\n";
    }
    directions.iter().for_each(|direction| out += &direction_line(direction));
    out
}

fn scale_line(scale: &ScaleReport) -> String {
    let mut without: Vec<(&str, f64)> =
        scale.sigma_without.iter().map(|(source, sigma)| (source.as_str(), sigma.0)).collect();
    without.sort_by(|a, b| b.1.total_cmp(&a.1));
    let without: Vec<String> =
        without.iter().map(|(source, sigma)| format!("{source}: {}", percent_or_open(*sigma))).collect();
    let sigma = percent_or_open(scale.sigma.map_or(f64::INFINITY, |sigma| sigma.0));
    format!("- **{}** sigma {sigma}; without a source: {}\n", scale.vehicle, without.join("; "))
}

fn direction_line(direction: &DirectionReport) -> String {
    let class = if direction.class == "null" { "open" } else { "weak" };
    let held = direction.held_by.as_ref().map_or(String::new(), |held_by| format!(" (held by {held_by})"));
    format!("- **{class}** {}{held}\n", direction.name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_determined_is_said_and_what_is_missing_left_out() {
        let report = serde_json::json!({
            "problem": "film", "status": "converged", "stop": "small", "iterations": 7, "rms_px": 1.23456,
            "outliers": 3, "image_points": {"given": 100},
            "verdict": {"trust": "no", "reasons": ["nothing determines the scale of car"],
                        "facts": ["datum 5 of 6 unknowns determined"]},
            "scales": [{"vehicle": "car", "sigma": "inf", "sigma_without": {"terrain": 0.01, "survey": "inf"}}],
            "observability": {"directions": [{"name": "scale of car", "class": "null", "held_by": null}]},
        });
        let read = |json| serde_json::from_value(json).unwrap();
        let found = document(&read(report));
        for wanted in [
            "# film\n\n**Can it be trusted? no.**\n\n- nothing determines the scale of car\n",
            "- **datum** 5 of 6 unknowns determined\n",
            "- **adjusted** converged after 7 iterations (small)\n- **residuals** rms 1.235 px; gross errors 3 of 100\n",
            "- **car** sigma not determined; without a source: survey: not determined; terrain: 1.00 %\n",
            "- **open** scale of car\n",
        ] {
            assert!(found.contains(wanted), "{wanted} is not in\n{found}");
        }
        let bare = document(&read(serde_json::json!({"problem": "film", "status": "first_estimate"})));
        assert_eq!(bare, "# film\n\n**first_estimate**, not adjusted\n\n");
        assert_eq!(document(&Report::default()), "# -\n\n**-**, not adjusted\n\n");
    }
}
