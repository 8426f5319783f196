//! `trackbundle evaluate`.

use super::Failure;
use super::comparison::{Invalid, ToCompare};
use super::comparison_text::describe;
use super::evaluation_folder::{self, Evaluated};
use super::options::{Input, command_given, positive, read, take_place};
use super::output::{print, warn_all};
use crate::clock::Shift;
use crate::evaluate::alignment::Alignment;
use crate::evaluate::pairs::Association;
use crate::evaluate::shape::Registering;
use crate::evaluate::{Clock, EvaluateOptions};
use crate::report::evaluation_report;
use crate::report::folder::Holds;
use clap::{Args, ValueEnum};
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
pub fn clock_offset(text: &str) -> Result<Clock, String> {
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

impl Arguments {
    fn options(&self) -> EvaluateOptions {
        EvaluateOptions {
            clock: self.clock_offset,
            shift: match self.clock_shift {
                FreeShift::Free => Shift::Free,
                FreeShift::None => Shift::None,
            },
            association: match self.association {
                Associated::Interpolated => Association::Interpolated,
                Associated::Nearest => Association::Nearest { max_gap_s: self.max_gap },
            },
            alignment: match self.alignment {
                Aligning::None => Alignment::None,
                Aligning::Rigid => Alignment::Rigid,
                Aligning::Similarity => Alignment::Similarity,
            },
            registering: match self.registration {
                Registration::None => Registering::None,
                Registration::Given => Registering::Given,
                Registration::Icp => Registering::Icp,
            },
            sigma_limit_m: self.sigma_limit,
        }
    }
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let mut staged = match &arguments.out {
        Some(target) => Some(take_place(target, Holds::Evaluation)?),
        None => None,
    };
    let input = read(&arguments.problem);
    let known = input.as_ref().ok();
    let vehicles: Option<Vec<String>> =
        known.map(|input| input.inventory.vehicles.iter().map(|v| v.id.clone()).collect());
    let frames = known.and_then(|input| input.problem.as_ref().ok()).map(|problem| problem.frames.as_slice());
    // What is wrong with either folder is told at once.
    let mut invalid: Invalid = Vec::new();
    let Arguments { problem: problem_folder, result: result_folder, .. } = arguments;
    let to_compare = ToCompare::read(
        problem_folder,
        result_folder,
        vehicles.as_deref(),
        frames,
        known.map(|input| input.inputs.clone()).unwrap_or_default(),
        &mut invalid,
    );
    let input = match input {
        Ok(input) => Some(input),
        Err(Failure::Invalid(all)) => {
            invalid.splice(0..0, all);
            None
        }
        Err(failure) => return Err(failure),
    };
    let (Some(input), Some(to_compare), true) = (input, to_compare, invalid.is_empty()) else {
        return Err(Failure::Invalid(invalid));
    };
    let Input { inventory, reference, problem, mut warnings, .. } = input;

    let options = arguments.options();
    if arguments.max_gap.is_some() && matches!(options.association, Association::Interpolated) {
        warnings.push("--max-gap counts with --association nearest only".to_owned());
    }
    let vehicles = vehicles.unwrap_or_default();
    let compared = to_compare.compare(&vehicles, &reference, problem.as_ref().ok(), &options);
    if compared.is_empty() && arguments.out.is_none() {
        let missing = compared.missing.join("; ");
        return Err(Failure::NoSolution(format!("nothing can be compared: {missing}")));
    }
    warnings.extend(compared.told());
    if !arguments.quiet {
        warn_all(&warnings);
    }
    let mut json = evaluation_report(problem_folder, result_folder, &compared.evaluation, warnings.clone());
    if let Some(staged) = &mut staged {
        let evaluated = Evaluated {
            result_folder,
            name: &inventory.name,
            problem: problem.as_ref().ok(),
            compared: &compared,
            warnings: &warnings,
        };
        evaluation_folder::write(staged, &evaluated, &mut json, &command_given())?;
    }
    if arguments.json {
        print(&json.to_json())
    } else if arguments.quiet {
        Ok(())
    } else {
        print(&describe(&compared.evaluation, &options))
    }
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
