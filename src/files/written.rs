//! A problem as the files of its folder: what [`super::read_problem`] reads back.
//!
//! Numbers are rounded far below what they are known to, so that files stay small.

use crate::camera::{Camera, Lens};
use crate::geometry::{Pose, quaternion_wxyz};
use crate::problem::{Freedom, Known, PoseSigma, Problem, Role, Vehicle};
use crate::tables::written;
use crate::terrain::Terrain;
use std::fmt::Write;

/// Digits after the point of an image coordinate \[px\].
const PIXEL_DIGITS: i32 = 4;
/// ... of a length \[m\], ...
const METRE_DIGITS: i32 = 6;
/// ... of a time \[s\], ...
const TIME_DIGITS: i32 = 7;
/// ... of a number of a quaternion.
const QUATERNION_DIGITS: i32 = 10;

/// Columns of a pose.
const POSE_COLUMNS: [&str; 7] = ["x", "y", "z", "qw", "qx", "qy", "qz"];

/// A number with so many digits after the point, without zeros at the end.
pub fn decimal(value: f64, digits: i32) -> String {
    let unit = 10_f64.powi(digits);
    // Adding zero takes the sign from -0.
    format!("{}", (value * unit).round() / unit + 0.0)
}

/// The cells of a pose, in the order of [`POSE_COLUMNS`].
fn pose_cells(pose: &Pose) -> [String; 7] {
    let [x, y, z]: [f64; 3] = pose.translation.vector.into();
    let [a, b, c, d] = quaternion_wxyz(pose).map(|v| decimal(v, QUATERNION_DIGITS));
    [metres(x), metres(y), metres(z), a, b, c, d]
}

/// A known coordinate and its standard deviation, or two empty cells.
fn number_sigma(known: Option<Known>) -> [String; 2] {
    known.map_or_else(Default::default, |k| [metres(k.value_m), metres(k.sigma_m)])
}

fn metres(value: f64) -> String {
    decimal(value, METRE_DIGITS)
}

/// The files of a problem folder: names and bytes. A grid of heights is not among them; `grid` is the name of
/// its file. One of `name`, ids of vehicles and of points may hold any text.
pub fn problem_files(problem: &Problem, grid: Option<&str>) -> Vec<(String, Vec<u8>)> {
    let number = |frame: usize| problem.frames[frame].number.to_string();
    let mut files = vec![("problem.toml".to_owned(), settings(problem, grid).into_bytes())];
    let mut add = |name: &str, bytes: Vec<u8>| files.push((name.to_owned(), bytes));
    let frames = problem.frames.iter().map(|f| [f.number.to_string(), decimal(f.time_s, TIME_DIGITS)]);
    add("frames.csv", written(&["frame", "time_s"], frames));
    let pixel = |v: f64| decimal(v, PIXEL_DIGITS);
    let seen = problem.vehicles.iter().flat_map(|vehicle| {
        vehicle.observations.iter().map(move |o| (o, &vehicle.id, &vehicle.points[o.point].id))
    });
    let seen = seen.map(|(o, vehicle, point)| {
        [
            number(o.frame),
            vehicle.clone(),
            point.clone(),
            pixel(o.image_px.x),
            pixel(o.image_px.y),
            decimal(o.sigma_px, 6),
        ]
    });
    add("vehicle_observations.csv", written(&["frame", "vehicle", "point", "u", "v", "sigma_px"], seen));
    if problem.camera_poses.iter().any(Option::is_some) {
        add("camera_poses.csv", camera_pose_table(problem, &problem.camera_poses));
    }
    if problem.vehicles.iter().any(|vehicle| !vehicle.has_no_poses()) {
        let poses = problem.vehicles.iter().map(|vehicle| vehicle.poses.as_slice());
        add("vehicle_poses.csv", vehicle_pose_table(problem, poses));
    }
    if !problem.targets.is_empty() {
        let rows = problem.targets.iter().map(|target| {
            let [x, y, z] = target.known.map(number_sigma);
            let role = match target.role {
                Role::Control => "control",
                Role::Check => "check",
            };
            let ([x, sx], [y, sy], [z, sz]) = (x, y, z);
            [target.id.clone(), x, y, z, sx, sy, sz, role.to_owned()]
        });
        let header = ["target", "x", "y", "z", "sigma_x", "sigma_y", "sigma_z", "role"];
        add("targets.csv", written(&header, rows));
        let seen = problem.target_observations.iter().map(|o| {
            let id = problem.targets[o.target].id.clone();
            [number(o.frame), id, pixel(o.image_px.x), pixel(o.image_px.y), decimal(o.sigma_px, 6)]
        });
        add("target_observations.csv", written(&["frame", "target", "u", "v", "sigma_px"], seen));
    }
    let known = problem.vehicles.iter().flat_map(|vehicle| {
        let points = vehicle.points.iter().filter(|point| point.known.iter().any(Option::is_some));
        points.map(|point| (vehicle.id.clone(), point))
    });
    let known = known.map(|(vehicle, point)| {
        let [[x, sx], [y, sy], [z, sz]] = point.known.map(number_sigma);
        [vehicle, point.id.clone(), x, y, z, sx, sy, sz]
    });
    let known: Vec<_> = known.collect();
    if !known.is_empty() {
        let header = ["vehicle", "point", "x", "y", "z", "sigma_x", "sigma_y", "sigma_z"];
        add("vehicle_points.csv", written(&header, known));
    }
    if !problem.receivers.is_empty() {
        let rows = problem.receivers.iter().flat_map(|receiver| {
            let vehicle = &problem.vehicles[receiver.vehicle];
            let ids = [vehicle.id.clone(), vehicle.points[receiver.point].id.clone()];
            receiver.positions.iter().map(move |p| {
                let numbers = p.position.iter().chain(&p.sigma_m).map(|v| metres(*v)).collect::<Vec<_>>();
                ids.clone().into_iter().chain([decimal(p.time_s, TIME_DIGITS)]).chain(numbers)
            })
        });
        let header = ["vehicle", "point", "time_s", "x", "y", "z", "sigma_x", "sigma_y", "sigma_z"];
        add("observations/gnss.csv", written(&header, rows));
    }
    files
}

/// The table of these camera poses of a problem, one for each frame.
pub fn camera_pose_table(problem: &Problem, poses: &[Option<Pose>]) -> Vec<u8> {
    let rows = problem.frames.iter().zip(poses);
    let rows = rows.filter_map(|(frame, pose)| Some((frame.number.to_string(), pose_cells(pose.as_ref()?))));
    let rows = rows.map(|(frame, cells)| std::iter::once(frame).chain(cells));
    written(&[&["frame"], &POSE_COLUMNS[..]].concat(), rows)
}

/// The table of these poses of the vehicles of a problem, one for each frame.
pub fn vehicle_pose_table<'p>(problem: &Problem, poses: impl Iterator<Item = &'p [Option<Pose>]>) -> Vec<u8> {
    let rows = problem.vehicles.iter().zip(poses).flat_map(|(vehicle, poses)| {
        let rows = problem.frames.iter().zip(poses);
        rows.filter_map(|(frame, pose)| {
            Some((frame.number.to_string(), &vehicle.id, pose_cells(pose.as_ref()?)))
        })
    });
    let rows = rows.map(|(frame, id, cells)| [frame, id.clone()].into_iter().chain(cells));
    written(&[&["frame", "vehicle"], &POSE_COLUMNS[..]].concat(), rows)
}

/// A text in TOML.
fn quoted(text: &str) -> String {
    toml::Value::String(text.to_owned()).to_string()
}

fn settings(problem: &Problem, grid: Option<&str>) -> String {
    let mut text = String::new();
    let mut line = |key: &str, value: String| {
        let _ = writeln!(text, "{key} = {value}");
    };
    line("format", "1".to_owned());
    line("name", quoted(&problem.name));
    text += "\n[camera]\n";
    camera(&mut text, problem);
    text += "\n[noise]\n";
    pose_sigma(&mut text, "camera", &problem.camera_pose_sigma);
    pose_sigma(&mut text, "vehicle", &problem.vehicle_pose_sigma);
    if let Some(ground) = &problem.ground {
        text += "\n[terrain]\n";
        let _ = match (&ground.terrain, grid) {
            (Terrain::Plane { z_m }, _) => writeln!(text, "plane_z = {z_m:?}"),
            (Terrain::Grid(_), name) => writeln!(text, "grid = {}", quoted(name.unwrap_or("terrain.asc"))),
        };
        for (key, value) in [
            ("sigma_m", ground.sigma_m),
            ("correlation_s", ground.correlation_s),
            ("bias_sigma_m", ground.bias_sigma_m),
            ("tilt_sigma_deg", ground.tilt_sigma_rad.to_degrees()),
        ] {
            let _ = writeln!(text, "{key} = {}", decimal(value, 9));
        }
    }
    if let Some(receiver) = problem.receivers.first() {
        let known = &receiver.knowledge;
        text += "\n[gnss]\n";
        if let Some(offset) = known.clock_offset {
            let _ = writeln!(text, "clock_offset_s = {}", decimal(offset.value_m, 9));
            let _ = writeln!(text, "clock_offset_sigma_s = {}", decimal(offset.sigma_m, 9));
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
    for of_vehicle in &problem.vehicles {
        text += "\n[[vehicle]]\n";
        vehicle(&mut text, of_vehicle);
    }
    text
}

fn camera(text: &mut String, problem: &Problem) {
    let Camera { size_px: [width, height], focal_px, principal_px, pixel_centre_px, lens } = &problem.camera;
    let (model, coefficients): (&str, Vec<(&str, f64)>) = match lens {
        Lens::Pinhole => ("pinhole", Vec::new()),
        Lens::Brown(lens) => {
            ("brown", ["k1", "k2", "p1", "p2", "k3"].into_iter().zip(lens.coefficients()).collect())
        }
        Lens::Fisheye(lens) => {
            ("fisheye", ["k1", "k2", "k3", "k4"].into_iter().zip(lens.coefficients()).collect())
        }
    };
    let _ = writeln!(text, "model = \"{model}\"\nwidth = {width}\nheight = {height}");
    let numbers = [("fx", focal_px.x), ("fy", focal_px.y), ("cx", principal_px.x), ("cy", principal_px.y)];
    for (key, value) in numbers.into_iter().chain([("pixel_centre", *pixel_centre_px)]).chain(coefficients) {
        let _ = writeln!(text, "{key} = {value:?}");
    }
    if problem.shutter.readout_s != 0.0 || problem.shutter.freedom.is_adjusted() {
        let _ = writeln!(text, "readout_s = {}", decimal(problem.shutter.readout_s, 9));
    }
    if let Freedom::Prior(sigma_s) = problem.shutter.freedom {
        let _ = writeln!(text, "readout_sigma_s = {}", decimal(sigma_s, 9));
    }
    if problem.calibration.iter().any(|freedom| freedom.is_adjusted()) {
        text.push_str("[camera.refine]\n");
        let coefficients: &[&str] = match lens {
            Lens::Pinhole => &[],
            Lens::Brown(_) => &["k1", "k2", "p1", "p2", "k3"],
            Lens::Fisheye(_) => &["k1", "k2", "k3", "k4"],
        };
        let keys = ["focal_length", "cx", "cy"].iter().chain(coefficients);
        for (key, freedom) in keys.zip(&problem.calibration) {
            let _ = match freedom {
                Freedom::Fixed => Ok(()),
                Freedom::Free => writeln!(text, "{key} = \"free\""),
                Freedom::Prior(sigma) => writeln!(text, "{key} = {sigma:?}"),
            };
        }
    }
}

fn pose_sigma(text: &mut String, of: &str, sigma: &PoseSigma) {
    if let Some(position_m) = sigma.position_m {
        let _ = writeln!(text, "{of}_position_m = {}", decimal(position_m, 9));
    }
    if let Some(yaw) = sigma.rotation_rad[2] {
        let _ = writeln!(text, "{of}_rotation_deg = {}", decimal(yaw.to_degrees(), 9));
    }
}

fn vehicle(text: &mut String, vehicle: &Vehicle) {
    let _ = writeln!(text, "id = {}", quoted(&vehicle.id));
    if let Some(marker) = vehicle.marker {
        let _ = writeln!(text, "marker = {}", quoted(&vehicle.points[marker].id));
    }
    if vehicle.is_car {
        text.push_str("kind = \"car\"\n");
    }
    if let Some(height) = vehicle.height {
        let [value, sigma] = number_sigma(Some(height));
        let _ = writeln!(text, "height_m = {value}\nheight_sigma_m = {sigma}");
    }
}
