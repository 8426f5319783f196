use super::*;
use crate::files::{ResultResidual, read_problem};
use nalgebra::Vector2;
use std::path::Path;

fn tiny() -> Problem {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("problems/tiny");
    read_problem(&folder).unwrap().problem.unwrap()
}

fn input<'a>(
    problem: &'a Problem,
    report: &'a Report,
    evaluation: &'a Evaluation,
    empty: &'a ResultTracks,
) -> PageInput<'a> {
    PageInput {
        name: "tiny & <small>",
        command: "trackbundle evaluate PROBLEM RESULT",
        problem: Some(problem),
        inputs: &[],
        report,
        start: None,
        end: None,
        tracks: empty,
        evaluation,
        warnings: &[],
    }
}

#[test]
fn every_part_is_there_and_an_empty_one_says_why() {
    let (problem, empty) = (tiny(), ResultTracks::default());
    let (report, evaluation) = (Report::default(), Evaluation::default());
    let html = page(&input(&problem, &report, &evaluation, &empty));
    for part in ["verdict", "inputs", "adjusted", "residuals", "control", "interior", "track", "shape"] {
        assert_eq!(html.matches(&format!("href=\"#{part}\"")).count().min(1), 1, "{part} in the contents");
        assert_eq!(html.matches(&format!("<h2 id=\"{part}\"")).count(), 1, "{part}");
    }
    for why in [
        "The result has no verdict",
        "does not say which files it is from",
        "does not say what its datum rests on",
        "The result has no residuals of this problem",
        "The problem has no targets",
        "the interior orientation is held as calibrated",
        "so Table 1 and Figures 3 to 5 are empty",
        "so Figures 6 to 8 are empty",
    ] {
        assert!(html.contains(why), "{why}");
    }
    assert!(html.contains("<h1>tiny &amp; &lt;small&gt;</h1>"));
    // Nothing is fetched from anywhere.
    for outside in ["http:", "https:", "src=", "<script", "@import", "url("] {
        let found = html.replace("http://www.w3.org/2000/svg", "");
        assert!(!found.contains(outside), "{outside}");
    }
}

#[test]
fn residuals_before_are_those_of_what_took_part_at_the_end() {
    let problem = tiny();
    let residuals = |of: &[(usize, f64, f64)]| {
        let mut all = ResultResiduals::none_of(&problem);
        for &(at, du, weight) in of {
            let o = problem.vehicles[0].observations[at];
            all.vehicles[0][at] = Some(ResultResidual {
                frame: o.frame,
                target: None,
                image_px: o.image_px,
                residual_px: Vector2::new(du, -2.0 * du),
                weight,
                reason: None,
            });
        }
        all
    };
    let start = residuals(&[(0, 4.0, 1.0), (1, 100.0, 1.0), (2, 100.0, 1.0)]);
    let end = residuals(&[(0, 0.5, 1.0), (1, 50.0, 0.0), (3, 0.5, 1.0)]);
    assert_eq!(residuals::rms_px(end.all().filter(|r| r.is_accepted())), Some((1.25_f64 / 2.0).sqrt()));
    assert_eq!(residuals::rms_px([].into_iter()), None);
    let section = residuals::section(&problem, Some(&start), Some(&end));
    let text = serde_json::to_string(&section).unwrap();
    assert!(text.contains("2 image points took part at the end, 1 were rejected"), "{text}");
    assert!(text.contains("[\"vehicles\",\"2\",\"6.32 px\",\"0.79 px\"]"), "{text}");
}

#[test]
fn what_a_report_says_is_told() {
    let report = serde_json::json!({
        "command": "trackbundle refine PROBLEM --loss huber",
        "verdict": {"trust": "no", "reasons": ["datum is open"], "facts": ["scale of a: sigma 1 %"]},
        "warnings": ["twice", "twice"],
        "inputs": [{"file": "problem.toml", "bytes": 12345, "sha256": "00ff"}],
        "scales": [{"vehicle": "a", "sigma": "inf", "shares": {"gnss": 0.25, "terrain": 0.75}, "sigma_without": {"gnss": "inf"}}],
        "check_points": [{"target": "T1", "dx": 0.012, "dy": null, "dz": -0.5}],
        "estimated": [{"name": "cx_px", "of": null, "before": 1.0, "value": 2.0, "sigma": 0.5, "observable": true,
                       "effect_m": 0.031, "correlations": {"cy_px": 0.97}}],
    });
    let report: Report = serde_json::from_value(report).unwrap();
    let (problem, empty) = (tiny(), ResultTracks::default());
    let evaluation = Evaluation::default();
    let warnings = ["twice".to_owned(), "once".to_owned()];
    let html = page(&PageInput { warnings: &warnings, ..input(&problem, &report, &evaluation, &empty) });
    for told in [
        "Can the result be trusted? no.",
        "<li>datum is open</li>",
        "trackbundle refine PROBLEM --loss huber",
        "12\u{202f}345",
        "not there any more",
        "Scale of a: not determined",
        "<td>75.00 %</td>",
        "<td>3.1\u{a0}cm</td>",
        "<td>cy_px 0.970</td>",
        "<li>once</li>",
    ] {
        assert!(html.contains(told), "{told}");
    }
    let mut section = Section::new("control", "Control and check points");
    facts::check_points(&mut section, &report);
    let table = serde_json::to_string(&section).unwrap();
    assert!(table.contains("[\"T1\",\"1.2\u{a0}cm\",\"\u{2013}\",\"\u{2212}50.0\u{a0}cm\""), "{table}");
    assert_eq!(changed_inputs(&report, &[]), ["problem.toml"]);
    let same = InputFile { file: "problem.toml".to_owned(), bytes: 12345, sha256: "00ff".to_owned() };
    assert!(changed_inputs(&report, &[same]).is_empty());
}
