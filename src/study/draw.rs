//! What differs from video to video: parameters of a scenario that are drawn at random.

use crate::files::section::Section;
use crate::simulate::{Value, drawn_number};

/// Numbers that each draw may use.
const NUMBERS: usize = 2;

/// How videos are made and adjusted.
#[derive(Clone, Debug, PartialEq)]
pub struct VideoSettings {
    /// What is drawn for each.
    pub draws: Vec<Draw>,
    /// Whether motion priors are estimated, or there are none.
    pub has_motion: bool,
}

/// Parameters that are drawn together.
#[derive(Clone, Debug, PartialEq)]
pub struct Draw {
    /// In what share of the videos; in the others the scenario stays as it is.
    pub share: f64,
    /// From what.
    pub from: Choice,
}

/// What is drawn from.
#[derive(Clone, Debug, PartialEq)]
pub enum Choice {
    /// A number between two, of equal probability throughout, or in logarithm.
    Between {
        /// Where it stands in the scenario.
        parameter: String,
        /// The least and the largest.
        limits: [f64; 2],
        /// Whether it is a whole number.
        is_whole: bool,
        /// Whether its logarithm is drawn.
        is_logarithmic: bool,
    },
    /// One of several, each a set of parameters with their values.
    OneOf(Vec<Vec<(String, Value)>>),
}

impl Draw {
    /// What this draw, the `at`-th of the study, sets in a video.
    pub fn of_video(&self, video: usize, at: usize) -> Vec<(String, Value)> {
        if drawn_number(video, NUMBERS * at) >= self.share {
            return Vec::new();
        }
        let drawn = drawn_number(video, NUMBERS * at + 1);
        match &self.from {
            Choice::Between { parameter, limits, is_whole, is_logarithmic } => {
                let value = between(*limits, *is_whole, *is_logarithmic, drawn);
                vec![(parameter.clone(), value)]
            }
            Choice::OneOf(all) => all[((drawn * all.len() as f64) as usize).min(all.len() - 1)].clone(),
        }
    }

    /// Settings that show whether all that may be drawn can be.
    pub fn examples(&self) -> Vec<Vec<(String, Value)>> {
        match &self.from {
            Choice::Between { parameter, limits, is_whole, is_logarithmic } => [0.0, 1.0 - f64::EPSILON]
                .map(|drawn| vec![(parameter.clone(), between(*limits, *is_whole, *is_logarithmic, drawn))])
                .to_vec(),
            Choice::OneOf(all) => all.clone(),
        }
    }
}

fn between([low, high]: [f64; 2], is_whole: bool, is_logarithmic: bool, drawn: f64) -> Value {
    // A whole number has both of its limits.
    let end = if is_whole { high + 1.0 } else { high };
    let value = match is_logarithmic {
        true => low * (end / low).powf(drawn),
        false => low + (end - low) * drawn,
    };
    match is_whole {
        true => Value::Integer(value.floor().clamp(low, high) as i64),
        false => Value::Float(value),
    }
}

/// Reads a table `[[draw]]`.
pub fn read_draw(draw: &Section) -> Option<Draw> {
    let wanted = "a share above 0, at most 1";
    let share = draw.number("share", wanted, |v| v > 0.0 && v <= 1.0).unwrap_or(1.0);
    if draw.has("settings") {
        let all: Vec<Value> = draw.values("settings")?;
        let table = |value: &Value| Some(value.as_table()?.clone().into_iter().collect());
        let tables = all.iter().map(table).collect::<Option<Vec<Vec<(String, Value)>>>>();
        if tables.is_none() {
            draw.error("settings", "an array of tables such as { \"flight.tilt_deg\" = 30 }");
        }
        return Some(Draw { share, from: Choice::OneOf(tables?) });
    }
    let parameter =
        draw.required("parameter", "a key of the scenario, such as flight.altitude_m, or settings", || {
            draw.text("parameter")
        })?;
    if draw.has("values") {
        let values = draw.values("values")?;
        let one = |value: Value| vec![(parameter.clone(), value)];
        return Some(Draw { share, from: Choice::OneOf(values.into_iter().map(one).collect()) });
    }
    let low = draw.required("from", "the least value, or values", || draw.any_number("from"))?;
    let wanted = format!("a number above {low}");
    let high = draw.required("to", &wanted, || draw.number("to", &wanted, |v| v > low))?;
    let is_logarithmic = draw.flag("logarithmic").unwrap_or(false);
    if is_logarithmic && low <= 0.0 {
        draw.error("from", "a number above 0, for its logarithm");
        return None;
    }
    let is_whole = draw.flag("whole").unwrap_or(false);
    if is_whole && (low.fract() != 0.0 || high.fract() != 0.0) {
        draw.error("from", "whole limits of a whole number");
        return None;
    }
    let from = Choice::Between { parameter, limits: [low, high], is_whole, is_logarithmic };
    Some(Draw { share, from })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn draw(share: f64, is_whole: bool) -> Draw {
        let from = Choice::Between {
            parameter: "a".to_owned(),
            limits: [2.0, 5.0],
            is_whole,
            is_logarithmic: false,
        };
        Draw { share, from }
    }

    #[test]
    fn whole_numbers_are_drawn_with_both_limits_and_others_evenly() {
        let drawn = |draw: &Draw| -> Vec<Value> {
            (0..600).flat_map(|video| draw.of_video(video, 0)).map(|(_, value)| value).collect()
        };
        let whole = drawn(&draw(1.0, true));
        for wanted in 2..=5 {
            let count = whole.iter().filter(|value| value.as_integer() == Some(wanted)).count();
            assert!((100..200).contains(&count), "{wanted}: {count}");
        }
        let numbers: Vec<f64> = drawn(&draw(1.0, false)).iter().filter_map(Value::as_float).collect();
        let mean = numbers.iter().sum::<f64>() / 600.0;
        assert!(numbers.iter().all(|v| (2.0..5.0).contains(v)) && (mean - 3.5).abs() < 0.1);
        let some = drawn(&draw(0.25, false)).len();
        assert!((100..200).contains(&some), "{some}");
    }

    #[test]
    fn draws_of_a_video_do_not_depend_on_each_other() {
        let of = |at: usize| draw(1.0, false).of_video(3, at);
        assert_eq!(of(0), of(0));
        assert_ne!(of(0), of(1));
    }
}
