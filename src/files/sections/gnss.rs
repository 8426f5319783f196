//! `[gnss]`.

use super::super::cells::decimal;
use super::super::section::Section;
use crate::problem::{KnownTime, Problem, ReceiverKnowledge};
use nalgebra::Vector3;
use std::fmt::Write;

/// `[gnss]`: what is known of the receivers of `observations/gnss.csv`.
pub fn read(gnss: &Section) -> ReceiverKnowledge {
    let offset_s = gnss.any_number("clock_offset_s");
    let sigma_s = gnss.not_negative("clock_offset_sigma_s");
    if sigma_s.is_some() && offset_s.is_none() {
        gnss.warn("clock_offset_sigma_s", "has no effect without clock_offset_s");
    }
    let clock_offset = offset_s.map(|value_s| KnownTime { value_s, sigma_s: sigma_s.unwrap_or(0.0) });
    let along = |key| gnss.any_number(key).unwrap_or(0.0);
    ReceiverKnowledge {
        clock_offset,
        drift_sigma: 1e-6 * gnss.not_negative("clock_drift_sigma_ppm").unwrap_or(0.0),
        shift_sigma_m: gnss.not_negative("shift_sigma_m").unwrap_or(0.0),
        lever_arm_m: Vector3::new(along("lever_x_m"), along("lever_y_m"), along("lever_z_m")),
        lever_sigma_m: gnss.not_negative("lever_sigma_m").unwrap_or(0.0),
    }
}

/// Writes what is known of the receivers, where there are some.
pub fn write(text: &mut String, problem: &Problem) {
    let Some(receiver) = problem.receivers.first() else { return };
    let known = &receiver.knowledge;
    text.push_str("\n[gnss]\n");
    if let Some(offset) = known.clock_offset {
        let _ = writeln!(text, "clock_offset_s = {}", decimal(offset.value_s, 9));
        let _ = writeln!(text, "clock_offset_sigma_s = {}", decimal(offset.sigma_s, 9));
    }
    let [x, y, z]: [f64; 3] = known.lever_arm_m.into();
    for (key, value) in [
        ("clock_drift_sigma_ppm", 1e6 * known.drift_sigma),
        ("shift_sigma_m", known.shift_sigma_m),
        ("lever_x_m", x),
        ("lever_y_m", y),
        ("lever_z_m", z),
        ("lever_sigma_m", known.lever_sigma_m),
    ] {
        let _ = writeln!(text, "{key} = {}", decimal(value, 9));
    }
}
