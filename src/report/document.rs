//! The verdict and what it rests on as a document to read beside a recording, in Markdown.

use serde_json::Value;

/// The document of a `report.json`; what it does not have is left out.
pub fn document(report: &Value) -> String {
    let text = |value: &Value| match value {
        Value::String(text) => text.clone(),
        Value::Null => "-".to_owned(),
        other => other.to_string(),
    };
    let mut out = format!("# {}\n\n", text(&report["problem"]));
    match &report["verdict"] {
        Value::Null => out += &format!("**{}**, not adjusted\n\n", text(&report["status"])),
        verdict => {
            out += &format!("**Can it be trusted? {}.**\n\n", text(&verdict["trust"]));
            for reason in list(&verdict["reasons"]) {
                out += &format!("- {}\n", text(reason));
            }
            out += "\n";
            for fact in list(&verdict["facts"]) {
                let fact = text(fact);
                let (word, rest) = fact.split_once(' ').unwrap_or((&fact, ""));
                out += &format!("- **{word}** {rest}\n");
            }
        }
    }
    if report["iterations"].is_u64() {
        out += &format!(
            "- **adjusted** {} after {} iterations ({})\n- **residuals** rms {} px; gross errors {} of {}\n",
            text(&report["status"]),
            text(&report["iterations"]),
            text(&report["stop"]),
            number(&report["rms_px"]),
            text(&report["outliers"]),
            text(&report["image_points"]["given"])
        );
    }
    let scales = list(&report["scales"]);
    if !scales.is_empty() {
        out += "\n## Scale: what holds it\n\n";
    }
    for scale in scales {
        let mut without: Vec<(String, f64)> = entries(&scale["sigma_without"])
            .map(|(source, sigma)| (source.clone(), sigma.as_f64().unwrap_or(f64::INFINITY)))
            .collect();
        without.sort_by(|a, b| b.1.total_cmp(&a.1));
        let without: Vec<String> =
            without.iter().map(|(source, sigma)| format!("{source}: {}", percent(*sigma))).collect();
        let sigma = scale["sigma"].as_f64().unwrap_or(f64::INFINITY);
        let vehicle = text(&scale["vehicle"]);
        out +=
            &format!("- **{vehicle}** sigma {}; without a source: {}\n", percent(sigma), without.join("; "));
    }
    let directions = list(&report["observability"]["directions"]);
    if !directions.is_empty() {
        out += "\n## Datum: what is open or weak\n\n";
    }
    for direction in directions {
        let class = if direction["class"] == "null" { "open" } else { "weak" };
        out += &format!("- **{class}** {}", text(&direction["name"]));
        if let Some(held_by) = direction["held_by"].as_str() {
            out += &format!(" (held by {held_by})");
        }
        out += "\n";
    }
    out
}

fn list(value: &Value) -> &[Value] {
    value.as_array().map_or(&[], Vec::as_slice)
}

fn entries(value: &Value) -> impl Iterator<Item = (&String, &Value)> {
    value.as_object().into_iter().flatten()
}

fn number(value: &Value) -> String {
    value.as_f64().map_or("-".to_owned(), |value| format!("{value:.3}"))
}

fn percent(share: f64) -> String {
    if share.is_finite() { format!("{:.2} %", 100.0 * share) } else { "not determined".to_owned() }
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
        let found = document(&report);
        for wanted in [
            "# film\n\n**Can it be trusted? no.**\n\n- nothing determines the scale of car\n",
            "- **datum** 5 of 6 unknowns determined\n",
            "- **adjusted** converged after 7 iterations (small)\n- **residuals** rms 1.235 px; gross errors 3 of 100\n",
            "- **car** sigma not determined; without a source: survey: not determined; terrain: 1.00 %\n",
            "- **open** scale of car\n",
        ] {
            assert!(found.contains(wanted), "{wanted} is not in\n{found}");
        }
        let bare = document(&serde_json::json!({"problem": "film", "status": "first_estimate"}));
        assert_eq!(bare, "# film\n\n**first_estimate**, not adjusted\n\n");
        assert_eq!(document(&Value::Null), "# -\n\n**-**, not adjusted\n\n");
    }
}
