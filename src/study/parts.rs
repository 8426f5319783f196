//! What is done of a study, kept until it is whole: one file for each cell's prediction, one for some runs.
//!
//! A line has a word and numbers, tabs between them. Numbers are written so that they are read as they were.

use super::cell::{Prediction, RunErrors};
use std::fmt::Write;

/// What is kept.
pub trait Part: Sized {
    /// As text.
    fn to_text(&self) -> String;
    /// From text; `None` where it was not written whole.
    fn from_text(text: &str) -> Option<Self>;
}

/// The last line of a part that was written whole.
pub const END: &str = "end\n";

/// Numbers of a line.
pub fn numbers(fields: &[&str]) -> Option<Vec<f64>> {
    fields.iter().map(|field| field.parse().ok()).collect()
}

/// Adds a line.
pub fn line(text: &mut String, word: &str, values: &[f64]) {
    text.push_str(word);
    values.iter().for_each(|value| {
        let _ = write!(text, "\t{value:?}");
    });
    text.push('\n');
}

/// The prediction of a cell, or why there is none.
impl Part for Result<Prediction, String> {
    fn to_text(&self) -> String {
        let mut text = String::new();
        match self {
            Err(why) => text.push_str(&format!("failed\t{}\n", why.replace(['\n', '\t'], " "))),
            Ok(prediction) => {
                line(&mut text, "view", &[prediction.view_m2]);
                line(&mut text, "counts", &prediction.counts.map(|count| count as f64));
                for (sigmas, factors) in prediction.sigmas.iter().zip(&prediction.factors) {
                    line(&mut text, "vehicle", sigmas);
                    for factors in factors {
                        text.push_str("factors");
                        factors.iter().for_each(|(name, share)| {
                            let _ = write!(text, "\t{name}\t{share:?}");
                        });
                        text.push('\n');
                    }
                }
            }
        }
        text + END
    }

    fn from_text(text: &str) -> Option<Self> {
        let mut prediction = Prediction::default();
        for row in text.strip_suffix(END)?.lines() {
            let fields: Vec<&str> = row.split('\t').collect();
            match fields.split_first()? {
                (&"failed", why) => return Some(Err(why.join(" "))),
                (&"view", view) => prediction.view_m2 = *numbers(view)?.first()?,
                (&"counts", counts) => {
                    let counts: [f64; 3] = numbers(counts)?.try_into().ok()?;
                    prediction.counts = counts.map(|count| count as usize);
                }
                (&"vehicle", sigmas) => {
                    prediction.sigmas.push(numbers(sigmas)?.try_into().ok()?);
                    prediction.factors.push(Vec::new());
                }
                (&"factors", pairs) => {
                    let pair = |pair: &[&str]| Some((pair[0].to_owned(), pair.get(1)?.parse().ok()?));
                    let pairs = pairs.chunks(2).map(pair).collect::<Option<_>>()?;
                    prediction.factors.last_mut()?.push(pairs);
                }
                _ => return None,
            }
        }
        Some(Ok(prediction))
    }
}

/// Runs, or why there is no result of one.
impl Part for Vec<Result<RunErrors, String>> {
    fn to_text(&self) -> String {
        let mut text = String::new();
        for run in self {
            match run {
                Err(why) => text.push_str(&format!("failed\t{}\n", why.replace(['\n', '\t'], " "))),
                Ok(errors) => {
                    text.push_str("run\n");
                    for ((squares, points), scan) in
                        errors.squares.iter().zip(&errors.to_points).zip(&errors.to_scan)
                    {
                        line(&mut text, "squares", squares);
                        line(&mut text, "points", points);
                        line(&mut text, "scan", scan);
                    }
                }
            }
        }
        text + END
    }

    fn from_text(text: &str) -> Option<Self> {
        let mut runs: Vec<Result<RunErrors, String>> = Vec::new();
        for row in text.strip_suffix(END)?.lines() {
            let fields: Vec<&str> = row.split('\t').collect();
            let (word, rest) = fields.split_first()?;
            if *word == "failed" {
                runs.push(Err(rest.join(" ")));
                continue;
            }
            if *word == "run" {
                runs.push(Ok(RunErrors::default()));
                continue;
            }
            let Some(Ok(errors)) = runs.last_mut() else { return None };
            let values = numbers(rest)?;
            match *word {
                "squares" => errors.squares.push(values.try_into().ok()?),
                "points" => errors.to_points.push(values.try_into().ok()?),
                "scan" => errors.to_scan.push(values.try_into().ok()?),
                _ => return None,
            }
        }
        Some(runs)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_come_back_as_they_were() {
        let prediction = Prediction {
            sigmas: vec![[0.1, f64::INFINITY, 1.0 / 3.0, 1e-300, 5.0, 0.2]],
            factors: vec![vec![
                vec![("image points".to_owned(), 0.75), ("survey".to_owned(), 0.25)],
                Vec::new(),
            ]],
            view_m2: f64::INFINITY,
            counts: [3, 4, 5],
        };
        for part in [Ok(prediction), Err("why\tso".to_owned())] {
            let back = Result::<Prediction, String>::from_text(&part.to_text()).unwrap();
            assert_eq!(back, part.map_err(|why: String| why.replace('\t', " ")));
        }
        let errors = RunErrors {
            squares: vec![[0.1; 6]; 2],
            to_points: vec![[1.0; 3]; 2],
            to_scan: vec![[0.5; 3]; 2],
        };
        let runs = vec![Ok(errors), Err("no".to_owned())];
        let text = runs.to_text();
        assert_eq!(Vec::<Result<RunErrors, String>>::from_text(&text).unwrap(), runs);
        // Cut off anywhere, it is none.
        assert!((0..text.len()).all(|at| Vec::<Result<RunErrors, String>>::from_text(&text[..at]).is_none()));
    }
}
