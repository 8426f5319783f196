//! `trackbundle check`.

use super::Failure;
use super::options::{Input, computable, read};
use super::output::{counted, grouped, print, warn_all};
use crate::files::{Inventory, VehicleInventory};
use crate::reference::Reference;
use crate::refine::scale_gap;
use clap::Args;
use std::fmt::Write;
use std::path::PathBuf;

/// Arguments of the command.
#[derive(Debug, Args)]
pub struct Arguments {
    /// The problem folder
    problem: PathBuf,
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let Input { inventory, problem, reference, warnings, .. } = read(&arguments.problem)?;
    warn_all(&warnings);
    let mut text = describe(&inventory);
    text += &describe_reference(&reference);
    match &problem {
        Ok(problem) => {
            text += "ready for   initialise, refine\n";
            for vehicle in &problem.vehicles {
                let _ = match scale_gap(problem, vehicle) {
                    None => writeln!(text, "scale       of {} is fixed by what is known", vehicle.id),
                    Some(gap) => writeln!(text, "scale       of {} is not fixed: {gap}", vehicle.id),
                };
            }
        }
        Err(missing) => {
            for missing in missing {
                let _ = writeln!(text, "missing     for initialise and refine: {missing}");
            }
        }
    }
    print(&text)?;
    computable(problem).map(|_| ())
}

fn describe(inventory: &Inventory) -> String {
    let Inventory {
        name,
        frames,
        time_s: [first, last],
        size_px: [width, height],
        camera_poses,
        vehicles,
        targets,
    } = inventory;
    let mut text = format!("problem     {name}\n");
    text += &format!("frames      {}, {:.3} s to {:.3} s\n", grouped(*frames), first, last);
    text += &format!("camera      {width} x {height} px, poses of {}", counted(*camera_poses, "frame"));
    text += if camera_poses < frames { "; the others by resection from targets\n" } else { "\n" };
    vehicles.iter().for_each(|vehicle| text += &describe_vehicle(vehicle));
    if targets.control + targets.check + targets.tie == 0 {
        text += "targets     none\n";
    } else {
        let [least, median, most] = targets.control_per_frame;
        text += &format!(
            "targets     {} control, {} check, {} tie; {}; control targets in a frame {least} to {most}, median {median}\n",
            targets.control,
            targets.check,
            targets.tie,
            counted(targets.observations, "image point"),
        );
    }
    text
}

fn describe_vehicle(vehicle: &VehicleInventory) -> String {
    let VehicleInventory { id, points, observations, frames, poses, .. } = vehicle;
    let mut text =
        format!("vehicle     {id}: {}, {}", counted(*points, "point"), counted(*observations, "image point"));
    if let Some([first, last]) = vehicle.span {
        let [least, median, most] = vehicle.track_lengths;
        text += &format!(
            ", seen in {} ({first} to {last}); a point is seen in {least} to {most} frames, median {median}",
            counted(*frames, "frame")
        );
    }
    if vehicle.single_frame_points > 0 {
        text += &format!("; {} in one frame only", counted(vehicle.single_frame_points, "point"));
    }
    text += &format!("\n            poses of {}", counted(*poses, "frame"));
    text += &format!(", {} known beforehand", counted(vehicle.known_coordinates, "coordinate"));
    text += if vehicle.has_height { ", height known" } else { "" };
    text += &match &vehicle.marker {
        Some(marker) => format!(", marker {marker}\n"),
        None => ", no marker: the track is that of the origin\n".to_owned(),
    };
    text
}

fn describe_reference(reference: &Reference) -> String {
    let tracks = reference
        .tracks
        .iter()
        .map(|(id, track)| format!("GNSS track of {id} ({})", counted(track.len(), "position")));
    let scans = reference.scans.iter().map(|(id, scan)| {
        let (points, triangles) = (scan.points.len(), scan.triangles.len());
        let surface =
            if triangles > 0 { format!(", {}", counted(triangles, "triangle")) } else { String::new() };
        format!("scan of {id} ({}{surface})", counted(points, "point"))
    });
    let all: Vec<String> = tracks.chain(scans).collect();
    format!("reference   {}\n", if all.is_empty() { "none".to_owned() } else { all.join(", ") })
}
