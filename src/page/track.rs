//! A track against its GNSS reference: Table 1 and Figures 3 to 5 of the literature.

use super::content::{Headline, Section, Table};
use super::figure::{Figure, Layer, colour};
use crate::evaluate::VehicleEvaluation;
use crate::evaluate::statistics::DifferenceStatistics;
use crate::files::TrackPosition;
use crate::stats::quantile::{median, quantile};
use crate::words::format::{DASH, cm, cm_or_dash, decimal};
use nalgebra::Point3;

/// 95 % of a normal distribution lie within so many standard deviations of one axis.
const AXIS_95: f64 = 1.959_964;
/// 95 % of a plane normal distribution lie within so many standard deviations.
const PLANE_95: f64 = 2.447_747;

/// The numbers of Masiero et al. for a roof mark over 60 s: `m_x, D_x, m_y, D_y` \[m\], then of the speed
/// `m_v`, `D_v` and the half width \[m/s\].
const PAPER: [&str; 7] = ["5 cm", "25 cm", "0 cm", "30 cm", "0.00 m/s", "0.05 m/s", "below 0.1 m/s"];

/// What a reader should see first of a track.
pub fn headlines(found: &VehicleEvaluation) -> [Headline; 2] {
    let track = &found.track;
    let distances: Vec<f64> = track.compared.iter().map(|c| c.difference_m.xy().norm()).collect();
    let middle = median(distances).unwrap_or(f64::NAN);
    let [x, y, _] = &track.axes_m;
    let position = Headline {
        name: format!("Track of {}", found.vehicle),
        value: cm(middle),
        meaning: "half of the positions are nearer than this to GNSS, in the plan".to_owned(),
        more: format!(
            "90 % within {}; median and MAD in x {}, {}; in y {}, {}",
            cm(track.circular_linear_90_m[0]),
            cm(x.median),
            cm(x.mad),
            cm(y.median),
            cm(y.mad)
        ),
        link: "track",
    };
    let speed = match &track.speed_mps {
        Some(speed) => Headline {
            name: format!("Speed of {}", found.vehicle),
            value: format!("{} m/s", decimal(speed.mad, 3)),
            meaning:
                "half of the speeds differ less than this from those of GNSS, the median difference apart"
                    .to_owned(),
            more: format!(
                "median {} m/s; half width at half maximum {}",
                decimal(speed.median, 3),
                track
                    .speed_half_width_mps
                    .map_or("not defined".to_owned(), |w| format!("{} m/s", decimal(w.half_width, 3)))
            ),
            link: "track",
        },
        None => Headline {
            name: format!("Speed of {}", found.vehicle),
            value: "\u{2013}".to_owned(),
            meaning: "neither track says how fast it is".to_owned(),
            more: String::new(),
            link: "track",
        },
    };
    [position, speed]
}

/// Adds a vehicle to the section.
pub fn add(section: &mut Section, found: &VehicleEvaluation, track: &[TrackPosition]) {
    let vehicle = &found.vehicle;
    section.heading(format!("Vehicle {vehicle}"));
    let compared = &found.track;
    section.text(format!(
        "{} positions compared; clock of the reference t = t_video + {} s; association {}, alignment {}. {} outside the time of the reference, {} in its gaps.",
        compared.compared.len(),
        decimal(compared.clock_offset_s, 4),
        compared.association.name(),
        compared.aligned.alignment.name(),
        compared.outside,
        compared.in_gaps
    ));
    section.table(table_1(found));
    section.table(differences(found));

    let number = |name: &str| format!("{name} ({vehicle})");
    let (plan, enlarged) = plan(found, track);
    section.figures(
        number("Figure 3"),
        format!("Estimated track (dots) and GNSS track (line) in plan. Ellipses: 95 % of the estimate by its own standard deviations, enlarged {enlarged} times."),
        &[("", plan)],
    );
    section.figures(
        number("Figure E"),
        "Differences over time, result minus reference. Shaded: 95 % by the standard deviations of both, as far as they are known."
            .to_owned(),
        &[("along x", errors(found, 0)), ("along y", errors(found, 1))],
    );
    section.figures(
        number("Figure 4"),
        "Horizontal speed over time: estimated (dots) and of the reference (line).",
        &[("", speeds(found))],
    );
    section.figures(
        number("Figure 5"),
        "Distribution of the speed error, result minus reference.",
        &[("", speed_errors(found))],
    );
}

/// Table 1 of the literature beside the same numbers here.
fn table_1(found: &VehicleEvaluation) -> Table {
    let track = &found.track;
    let [x, y, _] = &track.axes_m;
    let speed = track.speed_mps.as_ref();
    let mps = |value: Option<f64>| value.map_or(DASH.to_owned(), |v| format!("{} m/s", decimal(v, 3)));
    let values = [
        cm(x.median),
        cm(x.mad),
        cm(y.median),
        cm(y.mad),
        mps(speed.map(|s| s.median)),
        mps(speed.map(|s| s.mad)),
        mps(track.speed_half_width_mps.map(|w| w.half_width)),
    ];
    let names = [
        "m_x, median error in x",
        "D_x, median absolute deviation in x",
        "m_y, median error in y",
        "D_y, median absolute deviation in y",
        "median error of the speed",
        "median absolute deviation of the speed",
        "half width at half maximum of the speed error",
    ];
    let mut table = Table::new(
        "Table 1. The numbers of Masiero et al. (their film, their flight) and the same here",
        &["number", "Masiero et al.", "here"],
    );
    for ((name, paper), value) in names.iter().zip(PAPER).zip(values) {
        table.row([(*name).to_owned(), paper.to_owned(), value]);
    }
    table
}

fn differences(found: &VehicleEvaluation) -> Table {
    let track = &found.track;
    let mut table = Table::new(
        "Differences, result minus reference",
        &[
            "of",
            "count",
            "median",
            "MAD",
            "MAD x 1.4826",
            "mean",
            "rms",
            "95 %",
            "sigma here",
            "sigma of the reference",
        ],
    );
    let mut add = |name: &str, found: Option<&DifferenceStatistics>, sigmas: [Option<f64>; 2]| {
        let Some(s) = found else { return };
        let [own, reference] = sigmas.map(cm_or_dash);
        table.row([
            name.to_owned(),
            s.count.to_string(),
            cm(s.median),
            cm(s.mad),
            cm(s.mad_sigma),
            cm(s.mean),
            cm(s.rms),
            cm(s.abs_95),
            own,
            reference,
        ]);
    };
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        add(name, Some(&track.axes_m[axis]), [track.sigma_m[axis], track.reference_sigma_m[axis]]);
    }
    let turned = track.along_across_m.as_ref();
    add("along the track", turned.map(|t| &t[0]), [None; 2]);
    add("to its left", turned.map(|t| &t[1]), [None; 2]);
    table.caption = format!(
        "{}. CE90 {}, LE90 {}{}",
        table.caption,
        cm(track.circular_linear_90_m[0]),
        cm(track.circular_linear_90_m[1]),
        track.chi_square.map_or(String::new(), |(value, count)| format!(
            "; chi-square of the plan per degree of freedom {} from {count} positions",
            decimal(value, 2)
        ))
    );
    table
}

/// A whole number near the middle of some values, to draw large coordinates by what differs.
fn shift(values: impl Iterator<Item = f64>) -> f64 {
    let (mut least, mut most) = (f64::INFINITY, f64::NEG_INFINITY);
    values.for_each(|v| (least, most) = (least.min(v), most.max(v)));
    let middle = 0.5 * (least + most);
    if middle.is_finite() && middle.abs() > 10_000.0 { (middle / 100.0).round() * 100.0 } else { 0.0 }
}

/// The name of an axis that is drawn from a shift.
pub fn shifted(name: &str, shift: f64) -> String {
    match shift {
        0.0 => format!("{name} (m)"),
        _ => format!("{name} {} {:.0} (m)", if shift > 0.0 { '\u{2212}' } else { '+' }, shift.abs()),
    }
}

/// The plan, and how often its ellipses are enlarged.
fn plan(found: &VehicleEvaluation, track: &[TrackPosition]) -> (Figure, f64) {
    // Where the alignment brought them.
    let places: Vec<Point3<f64>> = track.iter().map(|t| found.track.aligned.position(&t.position)).collect();
    let [x0, y0] = [0, 1].map(|axis| shift(places.iter().map(|p| p[axis])));
    let extent = |axis: usize| {
        let values = places.iter().map(|p| p[axis]);
        values.clone().fold(f64::NEG_INFINITY, f64::max) - values.fold(f64::INFINITY, f64::min)
    };
    let wide = extent(0).max(extent(1));
    let sigmas: Vec<f64> = track.iter().flat_map(|t| [t.sigma_m[0], t.sigma_m[1]]).flatten().collect();
    let sigma = median(sigmas).unwrap_or(0.0);
    let step = (track.len() / 25).max(1);
    // Large enough to be seen, in steps of 1, 2, 5.
    let wanted = if sigma > 0.0 { 0.02 * wide / (PLANE_95 * sigma) } else { 1.0 };
    let power = 10_f64.powf(wanted.max(1.0).log10().floor());
    let enlarged =
        [5.0, 2.0, 1.0].into_iter().map(|m| m * power).find(|v| *v <= wanted).unwrap_or(1.0).max(1.0);
    let mut figure =
        Figure::new(format!("Plan of the track of {}", found.vehicle), shifted("x", x0), shifted("y", y0));
    figure.layers.push(Layer::Line {
        points: found.track.compared.iter().map(|c| [c.reference.x - x0, c.reference.y - y0]).collect(),
        colour: colour::REFERENCE,
        width: 7,
        label: "GNSS",
    });
    let mut outline = Vec::new();
    for (at, place) in track.iter().zip(&places).step_by(step) {
        let (Some(sx), Some(sy)) = (at.sigma_m[0], at.sigma_m[1]) else { continue };
        let covariance = nalgebra::Matrix2::new(
            sx * sx,
            at.covariance_xy_m2.unwrap_or(0.0),
            at.covariance_xy_m2.unwrap_or(0.0),
            sy * sy,
        );
        let Some(root) = covariance.cholesky() else { continue };
        for part in 0..=24 {
            let angle = f64::from(part) * std::f64::consts::TAU / 24.0;
            let edge = root.l() * nalgebra::Vector2::new(angle.cos(), angle.sin()) * (PLANE_95 * enlarged);
            outline.push([place.x - x0 + edge.x, place.y - y0 + edge.y]);
        }
        outline.push([f64::NAN; 2]);
    }
    figure.layers.push(Layer::Line {
        points: outline,
        colour: colour::OTHER,
        width: 2,
        label: "95 %, enlarged",
    });
    figure.layers.push(Layer::Dots {
        points: places.iter().map(|p| [p.x - x0, p.y - y0]).collect(),
        colour: colour::RESULT,
        radius: 3,
        label: "estimated",
    });
    figure.is_map = true;
    figure.aspect = 0.55;
    (figure, enlarged)
}

fn errors(found: &VehicleEvaluation, axis: usize) -> Figure {
    let compared = &found.track.compared;
    let name = ["x", "y", "z"][axis];
    let label =
        if found.track.reference_sigma_m[axis].is_some() { "95 % of both" } else { "95 % of the estimate" };
    let mut figure = Figure::new(
        format!("Differences along {name} over time, {}", found.vehicle),
        "time (s)",
        format!("{name}, result minus reference (cm)"),
    );
    let band = compared.iter().map(|c| {
        let half = match (c.sigma_m[axis], c.reference_sigma_m[axis]) {
            (Some(own), reference) => 100.0 * AXIS_95 * own.hypot(reference.unwrap_or(0.0)),
            (None, _) => f64::NAN,
        };
        [c.time_s, -half, half]
    });
    figure.layers.push(Layer::Band { points: band.collect(), colour: colour::RESULT, label });
    figure.layers.push(Layer::Level(0.0));
    figure.layers.push(Layer::Dots {
        points: compared.iter().map(|c| [c.time_s, 100.0 * c.difference_m[axis]]).collect(),
        colour: colour::RESULT,
        radius: 3,
        label: "difference",
    });
    figure.aspect = 0.6;
    figure
}

fn speeds(found: &VehicleEvaluation) -> Figure {
    let compared = &found.track.compared;
    let mut figure = Figure::new(format!("Speed of {} over time", found.vehicle), "time (s)", "speed (m/s)");
    let reference = compared.iter().map(|c| [c.time_s, c.reference_speed_mps.unwrap_or(f64::NAN)]).collect();
    let own =
        compared.iter().filter_map(|c| Some([c.time_s, c.reference_speed_mps? + c.speed_difference_mps?]));
    figure.layers.push(Layer::Line { points: reference, colour: colour::REFERENCE, width: 7, label: "GNSS" });
    figure.layers.push(Layer::Dots {
        points: own.collect(),
        colour: colour::RESULT,
        radius: 3,
        label: "estimated",
    });
    figure
}

fn speed_errors(found: &VehicleEvaluation) -> Figure {
    let values: Vec<f64> = found.track.compared.iter().filter_map(|c| c.speed_difference_mps).collect();
    let mut figure = Figure::new(
        format!("Distribution of the speed error of {}", found.vehicle),
        "speed, result minus reference (m/s)",
        "frames per bin",
    );
    let Some(width) = found.track.speed_half_width_mps else {
        figure.layers.clear();
        return figure;
    };
    let middle = median(values.clone()).unwrap_or(0.0);
    // As wide as 99 % of the values; what lies beyond is in the first and the last bar.
    let reach = quantile(values.iter().map(|v| (v - middle).abs()).collect(), 0.99).unwrap_or(0.0);
    let half = ((reach / width.bin).ceil() as i64).clamp(3, 200);
    let mut counts = vec![0_usize; (2 * half + 1) as usize];
    for value in &values {
        let at = ((value - middle) / width.bin).round().clamp(-(half as f64), half as f64) as i64;
        counts[(at + half) as usize] += 1;
    }
    let bars = counts.iter().enumerate().map(|(at, count)| {
        let centre = middle + (at as i64 - half) as f64 * width.bin;
        [centre - 0.5 * width.bin, centre + 0.5 * width.bin, *count as f64]
    });
    figure.layers.push(Layer::Bars {
        bars: bars.collect(),
        colour: colour::RESULT,
        hollow: false,
        label: "frames",
    });
    let top = counts.iter().copied().max().unwrap_or(0) as f64;
    figure.layers.push(Layer::Line {
        points: vec![[middle - width.half_width, 0.5 * top], [middle + width.half_width, 0.5 * top]],
        colour: colour::REFERENCE,
        width: 6,
        label: "half width at half maximum, to either side",
    });
    figure.layers.push(Layer::Upright(0.0));
    figure.aspect = 0.36;
    figure
}
