//! A video as a problem folder with its truth.

use super::video::GRID_DIGITS;
use super::{SimulatedVideo, World};
use crate::disk;
use crate::files::{camera_pose_table, decimal, problem_files, vehicle_pose_table};
use crate::geometry::Pose;
use crate::problem::{GroundKnowledge, Problem};
use crate::tables::{Finding, Findings, written};
use crate::terrain::{Grid, Terrain};
use std::path::Path;

/// The files of a video: the problem folder, `truth/` and `reference/`. The bytes depend on the scenario and the
/// seed alone.
pub fn simulated_files(world: &World, video: &SimulatedVideo) -> Result<Vec<(String, Vec<u8>)>, Findings> {
    let SimulatedVideo { problem, truth, .. } = video;
    let grid = written_grid(world, problem)?;
    let mut files = problem_files(problem, grid.as_ref().map(|(name, _)| name.as_str()));
    files.extend(grid);
    let frame = |at: usize| problem.frames[at].number.to_string();
    let cameras: Vec<Option<Pose>> = truth.camera_poses.iter().copied().map(Some).collect();
    files.push(("truth/camera_poses.csv".to_owned(), camera_pose_table(problem, &cameras)));
    let vehicles = truth.vehicles.iter().map(|found| found.poses.as_slice());
    files.push(("truth/vehicle_poses.csv".to_owned(), vehicle_pose_table(problem, vehicles)));
    let metres = |v: &f64| decimal(*v, 6);
    let rows = problem.vehicles.iter().zip(&truth.vehicles).flat_map(|(vehicle, found)| {
        let points = vehicle.points.iter().zip(&found.points);
        points.filter_map(|(point, place)| {
            let [x, y, z]: [f64; 3] = (*place)?.coords.into();
            Some([vehicle.id.clone(), point.id.clone(), metres(&x), metres(&y), metres(&z)])
        })
    });
    files.push(("truth/vehicle_points.csv".to_owned(), written(&["vehicle", "point", "x", "y", "z"], rows)));
    for (at, vehicle) in problem.vehicles.iter().enumerate() {
        let marker = world.vehicles[at].body.marker;
        let poses = truth.vehicles[at].poses.iter().zip(&video.velocities[at]).enumerate();
        let rows = poses.filter_map(|(at, (pose, velocity))| {
            let place = (*pose)? * marker;
            let numbers = place.iter().chain(velocity.iter()).map(metres).collect::<Vec<_>>();
            Some([frame(at), decimal(problem.frames[at].time_s, 7)].into_iter().chain(numbers))
        });
        let header = ["frame", "time_s", "x", "y", "z", "vx", "vy", "vz"];
        files.push((format!("truth/trajectory_{}.csv", vehicle.id), written(&header, rows)));
    }
    let rows = video.gross.iter().map(|(frame, vehicle, point)| {
        let id = vehicle.map_or_else(String::new, |at| problem.vehicles[at].id.clone());
        [frame.to_string(), id, point.clone()]
    });
    files.push(("truth/outliers.csv".to_owned(), written(&["frame", "vehicle", "point"], rows)));
    files.extend(wrong_tracks(video));
    let targets = problem.targets.iter().zip(&truth.targets);
    let rows = targets.filter_map(|(target, place)| {
        let [x, y, z]: [f64; 3] = (*place)?.coords.into();
        Some([target.id.clone(), metres(&x), metres(&y), metres(&z)])
    });
    files.push(("truth/targets.csv".to_owned(), written(&["target", "x", "y", "z"], rows)));
    files.push(("truth/parameters.csv".to_owned(), parameters(video)));
    let rows = problem.vehicles.iter().zip(&video.references).flat_map(|(vehicle, positions)| {
        positions.iter().map(|p| {
            let numbers = p.position.iter().copied().chain(p.sigma_m.iter().map(|s| s.unwrap_or(0.0)));
            let numbers: Vec<String> = numbers.map(|v| metres(&v)).collect();
            [vehicle.id.clone(), decimal(p.time_s, 7)].into_iter().chain(numbers)
        })
    });
    let rows: Vec<_> = rows.collect();
    if !rows.is_empty() {
        let header = ["vehicle", "time_s", "x", "y", "z", "sigma_x", "sigma_y", "sigma_z"];
        files.push(("reference/gnss.csv".to_owned(), written(&header, rows)));
    }
    for (at, vehicle) in problem.vehicles.iter().enumerate() {
        let line =
            |p: &nalgebra::Point3<f64>| format!("{} {} {}\n", metres(&p.x), metres(&p.y), metres(&p.z));
        let text: String = world.scan(at).iter().map(line).collect();
        files.push((format!("reference/{}.xyz", vehicle.id), text.into_bytes()));
    }
    Ok(files)
}

/// The file of the terrain that the problem has, where that is a grid: as it was measured, or as the scenario names it.
fn written_grid(world: &World, problem: &Problem) -> Result<Option<(String, Vec<u8>)>, Findings> {
    let terrain = &world.scenario.terrain;
    let Some(GroundKnowledge { terrain: Terrain::Grid(known), .. }) = &problem.ground else {
        return Ok(None);
    };
    let (Some(file), None) = (&terrain.grid, terrain.measured) else {
        return Ok(Some(("terrain.asc".to_owned(), grid_written(known).into_bytes())));
    };
    let extension = Path::new(file).extension().and_then(|e| e.to_str()).unwrap_or("asc");
    let bytes = disk::read(&world.scenario.folder.join(file))
        .map_err(|error| Finding::of_file(file, "a file that can be read", &error.to_string()))?;
    Ok(Some((format!("terrain.{}", extension.to_ascii_lowercase()), bytes)))
}

/// An ESRI ASCII grid of square cells.
fn grid_written(grid: &Grid) -> String {
    let ([columns, rows], [first, last], [step_m, _]) = (grid.size(), grid.corners_m(), grid.step_m());
    let mut text = format!(
        "ncols {columns}\nnrows {rows}\nxllcenter {}\nyllcenter {}\ncellsize {step_m}\nNODATA_value -9999\n",
        first[0], first[1]
    );
    for row in 0..rows {
        let heights = (0..columns).map(|column| {
            let (x, y) = (first[0] + column as f64 * step_m, last[1] - row as f64 * step_m);
            grid.at(x.min(last[0]), y.max(first[1]))
                .map_or("-9999".to_owned(), |g| decimal(g.height_m, GRID_DIGITS))
        });
        text += &heights.collect::<Vec<_>>().join(" ");
        text.push('\n');
    }
    text
}

/// The tracks that are not of their vehicle's body, where there are some.
fn wrong_tracks(video: &SimulatedVideo) -> Option<(String, Vec<u8>)> {
    let vehicles = video.problem.vehicles.iter().zip(&video.wrong_tracks);
    let rows = vehicles.flat_map(|(vehicle, tracks)| {
        let seen = vehicle.points.iter().filter_map(|point| Some((&point.id, tracks.get(&point.id)?)));
        seen.map(|(point, kind)| [vehicle.id.as_str(), point.as_str(), kind.name()])
    });
    let rows: Vec<_> = rows.collect();
    let has_some = !rows.is_empty();
    has_some.then(|| ("truth/wrong_tracks.csv".to_owned(), written(&["vehicle", "point", "kind"], rows)))
}

/// What is true beside poses and points.
fn parameters(video: &SimulatedVideo) -> Vec<u8> {
    let truth = &video.truth;
    let mut rows = vec![
        ["terrain_bias_m".to_owned(), decimal(truth.terrain_bias_m, 9)],
        ["readout_s".to_owned(), decimal(truth.readout_s, 9)],
        ["fx".to_owned(), decimal(truth.camera.focal_px.x, 6)],
        ["fy".to_owned(), decimal(truth.camera.focal_px.y, 6)],
        ["cx".to_owned(), decimal(truth.camera.principal_px.x, 6)],
        ["cy".to_owned(), decimal(truth.camera.principal_px.y, 6)],
    ];
    for (receiver, found) in video.problem.receivers.iter().zip(&truth.receivers) {
        let id = &video.problem.vehicles[receiver.vehicle].id;
        rows.push([format!("clock_offset_s {id}"), decimal(found.clock_offset_s, 9)]);
        for (axis, shift) in ["x", "y", "z"].iter().zip(found.shift_m.iter()) {
            rows.push([format!("gnss_shift_{axis}_m {id}"), decimal(*shift, 9)]);
        }
    }
    written(&["name", "value"], rows)
}
