//! `trackbundle evaluate`.

use super::Failure;
use super::evaluation_folder::{self, Evaluated};
use super::options::{Input, positive, read};
use super::output::{counted, grouped, print, warn_all};
use crate::evaluate::alignment::{Aligned, Alignment};
use crate::evaluate::clock::{ClockOffset, Shift};
use crate::evaluate::pairs::Association;
use crate::evaluate::shape::{Registering, ShapeComparison};
use crate::evaluate::statistics::Statistics;
use crate::evaluate::track::{SpeedSource, TrackComparison};
use crate::evaluate::{Clock, EvaluateOptions, Evaluation, VehicleEvaluation, evaluate, evaluate_shapes};
use crate::files::{read_points, read_tracks};
use crate::problem::{Problem, Receiver};
use crate::reference::read_true_shapes;
use crate::report::evaluation_report;
use crate::report::folder::{Holds, check_place};
use crate::tables::Findings;
use clap::{Args, ValueEnum};
use nalgebra::Point3;
use std::path::PathBuf;

/// Arguments of the command.
#[derive(Debug, Args)]
pub struct Arguments {
    /// The problem folder, with what is compared in reference/
    problem: PathBuf,

    /// A result folder: its trajectories.csv and vehicle_points.csv are compared
    result: PathBuf,

    /// Offset of the receiver's clock, t_reference = t_video + offset: seconds, or estimate to apply what
    /// the tracks themselves say
    #[arg(
        long,
        value_name = "SECONDS|estimate",
        default_value = "0",
        value_parser = clock_offset,
        allow_hyphen_values = true
    )]
    clock_offset: Clock,

    /// What is free beside the offset where it is estimated
    #[arg(long, value_enum, default_value_t = FreeShift::Free)]
    clock_shift: FreeShift,

    /// What is compared with what
    #[arg(long, value_enum, default_value_t = Associated::Interpolated)]
    association: Associated,

    /// How the shape of a vehicle comes onto its scan
    #[arg(long, value_enum, default_value_t = Registration::Icp)]
    registration: Registration,

    /// Distances are also told of points with a standard deviation of at most this alone [m]
    #[arg(long, value_name = "METRES", default_value_t = 0.1, value_parser = positive)]
    sigma_limit: f64,

    /// Write report.html, for people, and files for other tools to this folder; a folder that is there and
    /// is not an evaluation is never touched
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,

    /// With --association nearest: what is compared is no farther apart in time [default: half the median
    /// step of the denser of the two]
    #[arg(long, value_name = "SECONDS", value_parser = seconds)]
    max_gap: Option<f64>,

    /// What may be changed of the result before it is compared, by least squares over what is associated
    #[arg(long, value_enum, default_value_t = Aligning::None)]
    alignment: Aligning,

    /// Print the comparison to standard output as JSON
    #[arg(long)]
    json: bool,

    /// Print no warnings and no summary; errors are always printed
    #[arg(long, short)]
    quiet: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum FreeShift {
    /// A constant shift in x and y: only changes of velocity show the offset
    Free,
    /// Nothing: a constant velocity shows it too
    None,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Associated {
    /// Every frame with the reference at its time, between its positions
    Interpolated,
    /// Every position of the sparser of the two with the nearest of the other
    Nearest,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Aligning {
    /// Nothing
    None,
    /// Rotation and shift
    Rigid,
    /// Rotation, shift and scale
    Similarity,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Registration {
    /// As both stand: the scan is in the vehicle frame
    None,
    /// By the matrix reference/<vehicle>.matrix.txt
    Given,
    /// By iterated closest points, from that matrix or, without it, from the vehicle frame
    Icp,
}

/// Reads `estimate` or seconds.
fn clock_offset(text: &str) -> Result<Clock, String> {
    if text == "estimate" {
        return Ok(Clock::Estimated);
    }
    let seconds = text.parse::<f64>().ok().filter(|v| v.is_finite());
    seconds.map(Clock::Given).ok_or_else(|| "wanted estimate, or a number of seconds".to_owned())
}

/// Reads seconds of at least zero.
fn seconds(text: &str) -> Result<f64, String> {
    let seconds = text.parse::<f64>().ok().filter(|v| v.is_finite() && *v >= 0.0);
    seconds.ok_or_else(|| "wanted a number of seconds of at least 0".to_owned())
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    if let Some(target) = &arguments.out {
        check_place(target, Holds::Evaluation)?;
    }
    let input = read(&arguments.problem);
    let known = input.as_ref().ok();
    let vehicles: Option<Vec<String>> =
        known.map(|input| input.inventory.vehicles.iter().map(|v| v.id.clone()).collect());
    let frames = known.and_then(|input| input.problem.as_ref().ok()).map(|problem| problem.frames.as_slice());
    let mut of_result = Findings::default();
    let tracks = read_tracks(&arguments.result, vehicles.as_deref(), frames);
    let shapes = read_points(&arguments.result, vehicles.as_deref(), &mut of_result);
    let mut of_problem = Findings::default();
    let truths =
        read_true_shapes(&arguments.problem, vehicles.as_deref().unwrap_or_default(), &mut of_problem);
    // What is wrong with any of them is told at once.
    let mut invalid: Vec<(PathBuf, Findings)> = Vec::new();
    let input = match input {
        Ok(input) => Some(input),
        Err(Failure::Invalid(all)) => {
            invalid.extend(all);
            None
        }
        Err(failure) => return Err(failure),
    };
    // Without the problem's vehicles every row of the truth would be wrong.
    if vehicles.is_some() && of_problem.is_invalid() {
        invalid.push((arguments.problem.clone(), of_problem));
    }
    let tracks = tracks.map_err(|findings| invalid.push((arguments.result.clone(), findings))).ok();
    if of_result.is_invalid() {
        invalid.push((arguments.result.clone(), of_result));
    }
    let (Some(input), Some(tracks), true) = (input, tracks, invalid.is_empty()) else {
        return Err(Failure::Invalid(invalid));
    };
    let Input { inventory, reference, problem, mut warnings } = input;
    let used: Vec<(String, Point3<f64>)> = problem.iter().flat_map(observed_positions).collect();
    warnings.extend(tracks.warnings.iter().cloned());

    let options = EvaluateOptions {
        clock: arguments.clock_offset,
        shift: match arguments.clock_shift {
            FreeShift::Free => Shift::Free,
            FreeShift::None => Shift::None,
        },
        association: match arguments.association {
            Associated::Interpolated => Association::Interpolated,
            Associated::Nearest => Association::Nearest { max_gap_s: arguments.max_gap },
        },
        alignment: match arguments.alignment {
            Aligning::None => Alignment::None,
            Aligning::Rigid => Alignment::Rigid,
            Aligning::Similarity => Alignment::Similarity,
        },
        registering: match arguments.registration {
            Registration::None => Registering::None,
            Registration::Given => Registering::Given,
            Registration::Icp => Registering::Icp,
        },
        sigma_limit_m: arguments.sigma_limit,
    };
    if arguments.max_gap.is_some() && matches!(options.association, Association::Interpolated) {
        warnings.push("--max-gap counts with --association nearest only".to_owned());
    }
    let vehicles = vehicles.unwrap_or_default();
    let mut evaluation = evaluate(&vehicles, &tracks.tracks, &reference, &used, &options);
    (evaluation.shapes, evaluation.shapes_not_compared) =
        evaluate_shapes(&vehicles, &shapes, &reference, &truths, &options);
    let missing: Vec<String> =
        evaluation.not_compared.iter().map(|(vehicle, why)| format!("vehicle {vehicle}: {why}")).collect();
    if evaluation.vehicles.is_empty() && evaluation.shapes.is_empty() && arguments.out.is_none() {
        return Err(Failure::NoSolution(format!("nothing can be compared: {}", missing.join("; "))));
    }
    warnings.extend(missing.into_iter().map(|missing| format!("not compared: {missing}")));
    warnings.extend(evaluation.vehicles.iter().filter_map(clock_warning));
    warnings.extend(evaluation.vehicles.iter().filter_map(turn_warning));
    if !arguments.quiet {
        warn_all(&warnings);
    }
    let json =
        evaluation_report(&arguments.problem, &arguments.result, &evaluation, warnings.clone()).to_json();
    if let Some(target) = &arguments.out {
        let evaluated = Evaluated {
            problem_folder: &arguments.problem,
            result_folder: &arguments.result,
            name: &inventory.name,
            problem: problem.as_ref().ok(),
            tracks: &tracks,
            evaluation: &evaluation,
            warnings: &warnings,
        };
        let command = std::env::args().skip(1).collect::<Vec<_>>().join(" ");
        evaluation_folder::write(target, &evaluated, &json, &format!("trackbundle {command}"))?;
    }
    if arguments.json {
        print(&json)
    } else if arguments.quiet {
        Ok(())
    } else {
        print(&describe(&evaluation, &options))
    }
}

/// Positions that the problem adjusts to, and whose.
fn observed_positions(problem: &Problem) -> Vec<(String, Point3<f64>)> {
    let of_receiver = |receiver: &Receiver| {
        let id = &problem.vehicles[receiver.vehicle].id;
        receiver.positions.iter().map(|p| (id.clone(), p.position)).collect::<Vec<_>>()
    };
    problem.receivers.iter().flat_map(of_receiver).collect()
}

fn clock_warning(found: &VehicleEvaluation) -> Option<String> {
    let [off_s, moved_m] = found.clock_matters()?;
    let VehicleEvaluation { vehicle, track, .. } = found;
    Some(format!(
        "vehicle {vehicle}: by its tracks the offset of the receiver's clock is {:.4} s, {:.4} s was applied: {moved_m:.3} m \
         at its median speed (--clock-offset estimate)",
        track.clock_offset_s + off_s,
        track.clock_offset_s,
    ))
}

fn turn_warning(found: &VehicleEvaluation) -> Option<String> {
    let VehicleEvaluation { vehicle, track, .. } = found;
    let [_, second_m, _] = track.aligned.spread_m;
    (!track.aligned.is_turn_determined(track.distances_m.rmse)).then(|| {
        format!(
            "vehicle {vehicle}: its track is nearly straight ({second_m:.3} m wide, {:.3} m are left after the \
             alignment): the turn about it is hardly determined, and with it height and cross slope",
            track.distances_m.rmse
        )
    })
}

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
fn describe(evaluation: &Evaluation, options: &EvaluateOptions) -> String {
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
fn row(name: &str, index: &str, unit: &str, found: &Statistics) -> String {
    let Statistics { median, mad, mad_sigma, mean, rms, abs_95, .. } = found;
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_are_read() {
        assert_eq!(seconds("0.02"), Ok(0.02));
        for wrong in ["", "-0.1", "nan", "inf", "some"] {
            assert!(seconds(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn offsets_are_read() {
        assert_eq!(clock_offset("estimate"), Ok(Clock::Estimated));
        assert_eq!(clock_offset("-0.5"), Ok(Clock::Given(-0.5)));
        for wrong in ["", "soon", "nan", "inf", "1e999", "0.1 s"] {
            assert!(clock_offset(wrong).is_err(), "{wrong}");
        }
    }
}
