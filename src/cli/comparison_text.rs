//! A comparison in a few lines.

use super::output::{counted, grouped};
use crate::clock::ClockOffset;
use crate::evaluate::alignment::{Aligned, Alignment};
use crate::evaluate::pairs::Association;
use crate::evaluate::shape::ShapeComparison;
use crate::evaluate::statistics::DifferenceStatistics;
use crate::evaluate::track::{SpeedSource, TrackComparison};
use crate::evaluate::{Clock, EvaluateOptions, Evaluation, VehicleEvaluation};

/// A shape against its scan in a few lines.
fn describe_shape(found: &ShapeComparison) -> String {
    let mut text = format!(
        "shape       {}: {} against {} of {}; registration {}\n",
        found.vehicle,
        counted(found.points.len(), "point"),
        counted(found.scan.len(), "point"),
        found.file,
        found.registration_told()
    );
    for (name, s) in found.statistics() {
        text += &format!(
            "            {name}: median {:.4} m, MAD {:.4} m, 95 % {:.4} m; within 1, 2, 5, 10 cm {}\n",
            s.median_m,
            s.mad_m,
            s.percentiles_m[3],
            s.within.map(|share| format!("{:.1} %", 100.0 * share)).join(", ")
        );
    }
    for note in &found.notes {
        text += &format!("            {note}\n");
    }
    if let Some(truth) = &found.truth {
        for (fit, s, _) in truth.fits() {
            text += &format!(
                "            point to point against the truth, fit {fit}: median {:.4} m, 95 % {:.4} m\n",
                s.median_m, s.percentiles_m[3]
            );
        }
    }
    text
}

/// The comparison in a few lines.
pub fn describe(evaluation: &Evaluation, options: &EvaluateOptions) -> String {
    let mut text = format!("differences result minus reference; alignment {}\n", options.alignment.name());
    text += match options.association {
        Association::Interpolated => {
            "association the reference at the times of frames, between its positions\n"
        }
        Association::Nearest { .. } => {
            "association each position of the sparser track with the nearest of the other\n"
        }
    };
    for found in &evaluation.vehicles {
        text += &describe_vehicle(found, options.clock);
    }
    text += &evaluation.shapes.iter().map(describe_shape).collect::<String>();
    text
}

fn describe_vehicle(found: &VehicleEvaluation, clock: Clock) -> String {
    let VehicleEvaluation { vehicle, track, .. } = found;
    let mut text = format!(
        "vehicle     {vehicle}: {} compared of {} and {} of the reference; ",
        grouped(track.compared.len()),
        counted(track.positions[0], "frame"),
        counted(track.positions[1], "position"),
    );
    text += &match track.association {
        Association::Interpolated => format!(
            "{} outside, {} in gaps (steps above {:.3} s)\n",
            grouped(track.outside),
            grouped(track.in_gaps),
            track.longest_step_s
        ),
        Association::Nearest { .. } => {
            format!("{} without a partner within {:.6} s\n", grouped(track.outside), track.max_gap_s)
        }
    };
    let origin = if clock == Clock::Estimated { "estimated" } else { "as given" };
    text += &format!(
        "clock       t_reference = t_video + {:.4} s ({origin}); {}\n",
        track.clock_offset_s,
        describe_clock(&found.clock)
    );
    text += &describe_alignment(&track.aligned);
    text += &describe_track(track);
    text
}

fn describe_alignment(aligned: &Aligned) -> String {
    let [x, y, z] = aligned.shift_m.into();
    match aligned.alignment {
        Alignment::None => String::new(),
        Alignment::Rigid | Alignment::Similarity => format!(
            "alignment   {}: scale {:.6}, rotation by {:.4} deg, centroid moved by {x:.4} {y:.4} {z:.4} m\n",
            aligned.alignment.name(),
            aligned.scale,
            aligned.angle_rad().to_degrees()
        ),
    }
}

fn describe_clock(clock: &ClockOffset) -> String {
    match clock {
        ClockOffset::NotObservable { why } => format!("not to be estimated: {why}"),
        ClockOffset::Estimated(found) => format!(
            "by the tracks {:.4} s, sigma {:.4} s, beside a shift of {:.3} {:.3} m ({} independent places, left {:.3} m)",
            found.offset_s,
            found.sigma_s,
            found.shift_m[0],
            found.shift_m[1],
            found.independent.round(),
            found.scale_m
        ),
    }
}

/// A row of statistics: median `m` and median absolute deviation `D` by the names of the literature.
fn row(name: &str, index: &str, unit: &str, found: &DifferenceStatistics) -> String {
    let DifferenceStatistics { median, mad, mad_sigma, mean, rms, abs_95, .. } = found;
    format!(
        "{name:12}m_{index} {median:.4} {unit}, D_{index} {mad:.4} {unit} (x 1.4826: {mad_sigma:.4}), mean {mean:.4}, rms {rms:.4}, \
         95 % {abs_95:.4}\n"
    )
}

fn describe_track(track: &TrackComparison) -> String {
    let number =
        |value: Option<f64>, digits: usize| value.map_or("-".to_owned(), |v| format!("{v:.digits$}"));
    let mut text = String::new();
    for (axis, found) in ["x", "y", "z"].iter().zip(&track.axes_m) {
        text += &row(axis, axis, "m", found);
    }
    match &track.along_across_m {
        Some([along, across]) => {
            text += &row("along track", "along", "m", along);
            text += &row("to its left", "left", "m", across);
        }
        None => text += "along track no direction: the reference hardly moves\n",
    }
    let distances = &track.distances_m;
    text += &format!(
        "distance    rmse {:.4} m, mean {:.4}, median {:.4}, std {:.4}, min {:.4}, max {:.4}\n",
        distances.rmse, distances.mean, distances.median, distances.std, distances.min, distances.max
    );
    let [ce90, le90] = track.circular_linear_90_m;
    text += &format!("CE90, LE90  {ce90:.4} m, {le90:.4} m\n");
    match &track.speed_mps {
        Some(speed) => {
            text += &row("speed", "v", "m/s", speed);
            let (width, bin) = match track.speed_half_width_mps {
                Some(width) => (Some(width.half_width), Some(width.bin)),
                None => (None, None),
            };
            text += &format!(
                "            half width at half maximum {} m/s (bins of {} m/s); reference by {}, median {} m/s\n",
                number(width, 4),
                number(bin, 4),
                match track.speed_source {
                    Some(SpeedSource::Measured) => "its own velocities",
                    Some(SpeedSource::Mixed) => "its own velocities and central differences",
                    Some(SpeedSource::Differences) | None => "central differences of its positions",
                },
                number(track.median_speed_mps, 3)
            );
        }
        None => text += "speed       not known in either track\n",
    }
    text += &match &track.heading_deg {
        Some(heading) => row("heading", "heading", "deg", heading),
        None => "heading     not known in either track\n".to_owned(),
    };
    if let Some(course) = &track.course_deg {
        text += &row("course", "course", "deg", course);
    }
    if track.heading_deg.is_some() || track.course_deg.is_some() {
        text += &format!(
            "            against the course of the reference: of the body's x axis (sigma {} deg), and of the track \
             itself over {:.2} s\n",
            number(track.sigma_heading_deg, 4),
            2.0 * track.course_step_s
        );
    }
    let sigmas = |sigmas: &[Option<f64>; 3]| sigmas.map(|sigma| number(sigma, 4)).join(" ");
    text += &format!(
        "sigma       x y z, median: result {} m, reference {} m\n",
        sigmas(&track.sigma_m),
        sigmas(&track.reference_sigma_m)
    );
    if let Some((value, count)) = track.chi_square {
        text += &format!(
            "chi-square  of x and y per degree of freedom {value:.3} (1 where both are as good as they say), {}\n",
            counted(count, "frame")
        );
    }
    text
}
