//! Gross errors of every kind, put into the tables of a drive after its noise, so that a contaminated
//! drive has the good image points of the clean one to the last digit.

use super::drive::{Truth, normal, project};
use nalgebra::{Point3, Vector2};
use rand::seq::SliceRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::path::Path;

/// From here on an image point is a gross error \[px\]; image noise is 1 px.
pub const LEAST_PX: f64 = 10.0;
/// Single gross errors are off by no more \[px\].
pub const MOST_PX: f64 = 200.0;

/// What goes wrong.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Contamination {
    /// Share of the shape points of each vehicle whose image points stay on the ground.
    pub ground_tracks: f64,
    /// Share of all image points, of vehicles and of targets, that are off each by itself.
    pub singles: f64,
    /// Frames in which all image points of a vehicle are off by one vector.
    pub shifted_frames: usize,
    /// Frames in which all image points of targets are off by one vector.
    pub shifted_target_frames: usize,
    /// The points whose tracks are good: a mark must be seen to be measured.
    pub spares_mark: bool,
}

impl Contamination {
    /// This share of all image points: half of it tracks that stay on the ground, half of it single ones.
    pub fn half_and_half(share: f64) -> Contamination {
        Contamination {
            ground_tracks: 0.5 * share,
            singles: 0.5 * share,
            spares_mark: true,
            ..Default::default()
        }
    }
}

/// Which image points are gross, by frame and id.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Gross {
    /// Those of vehicles: frame, vehicle, point.
    pub of_vehicles: BTreeSet<(i64, String, String)>,
    /// Those of targets: frame and target.
    pub of_targets: BTreeSet<(i64, String)>,
    /// Points whose whole track is gross: vehicle and point.
    pub tracks: BTreeSet<(String, String)>,
    /// Frames that are off as a whole: vehicle (none: targets) and frame.
    pub frames: BTreeSet<(Option<String>, i64)>,
}

struct Row {
    frame: i64,
    /// Vehicle and point, or target alone.
    ids: Vec<String>,
    image_px: Vector2<f64>,
}

/// Contaminates the image points of a drive that was written to `folder`.
pub fn contaminate(folder: &Path, truth: &Truth, what: &Contamination, seed: u64) -> Gross {
    let mut rng = ChaCha8Rng::seed_from_u64(1_000_003 * seed + 17);
    let mut gross = Gross::default();
    let mut of_vehicles = read(&folder.join("vehicle_observations.csv"), &["vehicle", "point"]);
    let target_file = folder.join("target_observations.csv");
    let mut of_targets = if target_file.exists() { read(&target_file, &["target"]) } else { Vec::new() };
    for (at, poses) in truth.vehicles.iter().enumerate() {
        let vehicle = format!("car{at}");
        let mut points: Vec<usize> = (usize::from(what.spares_mark)..truth.points.len()).collect();
        points.shuffle(&mut rng);
        let count = (what.ground_tracks * truth.points.len() as f64).round() as usize;
        for point in points.into_iter().take(count) {
            let (id, in_body) = &truth.points[point];
            let place = ground_place(truth, poses, in_body, &mut rng);
            gross.tracks.insert((vehicle.clone(), id.clone()));
            for row in of_vehicles.iter_mut().filter(|row| row.ids[0] == vehicle && row.ids[1] == *id) {
                // Where the place is out of view the tracker has lost it; the image point stays as it is.
                if let Some(pixel) = project(&truth.cameras[row.frame as usize], &place) {
                    row.image_px = pixel + Vector2::new(normal(&mut rng), normal(&mut rng));
                    gross.of_vehicles.insert((row.frame, vehicle.clone(), id.clone()));
                }
            }
        }
        for _ in 0..what.shifted_frames {
            let (frame, shift) = (rng.random_range(0..poses.len()) as i64, vector(30.0, &mut rng));
            gross.frames.insert((Some(vehicle.clone()), frame));
            for row in of_vehicles.iter_mut().filter(|row| row.ids[0] == vehicle && row.frame == frame) {
                row.image_px += shift;
                gross.of_vehicles.insert((frame, vehicle.clone(), row.ids[1].clone()));
            }
        }
    }
    for _ in 0..what.shifted_target_frames {
        let (frame, shift) = (rng.random_range(0..truth.cameras.len()) as i64, vector(30.0, &mut rng));
        gross.frames.insert((None, frame));
        for row in of_targets.iter_mut().filter(|row| row.frame == frame) {
            row.image_px += shift;
            gross.of_targets.insert((frame, row.ids[0].clone()));
        }
    }
    // Of what is good so far, as many as make up the share of all.
    let mut good: Vec<usize> =
        (0..of_vehicles.len()).filter(|at| !gross.of_vehicles.contains(&key(&of_vehicles[*at]))).collect();
    good.shuffle(&mut rng);
    good.truncate((what.singles * of_vehicles.len() as f64).round() as usize);
    for at in good {
        of_vehicles[at].image_px += vector(LEAST_PX, &mut rng);
        gross.of_vehicles.insert(key(&of_vehicles[at]));
    }
    for row in &mut of_targets {
        let target = (row.frame, row.ids[0].clone());
        if !gross.of_targets.contains(&target) && rng.random::<f64>() < what.singles {
            row.image_px += vector(LEAST_PX, &mut rng);
            gross.of_targets.insert(target);
        }
    }
    write(&folder.join("vehicle_observations.csv"), "frame,vehicle,point,u,v\n", &of_vehicles);
    if !of_targets.is_empty() {
        write(&target_file, "frame,target,u,v\n", &of_targets);
    }
    gross
}

/// A place on the road within three metres of where the vehicle once was, whose image is at least
/// [`LEAST_PX`] off the point's in nine of ten frames.
fn ground_place(
    truth: &Truth,
    poses: &[trackbundle::geometry::Pose],
    in_body: &Point3<f64>,
    rng: &mut ChaCha8Rng,
) -> Point3<f64> {
    loop {
        let frame = rng.random_range(0..poses.len());
        let at = poses[frame].translation.vector;
        let mut within = || rng.random_range(-3.0..3.0);
        let place = Point3::new(at.x + within(), at.y + within(), 0.0);
        let far = (0..poses.len())
            .filter(|frame| {
                let camera = &truth.cameras[*frame];
                let pair = project(camera, &place).zip(project(camera, &(poses[*frame] * in_body)));
                pair.is_none_or(|(a, b)| (a - b).norm() >= LEAST_PX)
            })
            .count();
        if 10 * far >= 9 * poses.len() {
            return place;
        }
    }
}

/// A vector of random direction, of a length from `least_px` to [`MOST_PX`].
fn vector(least_px: f64, rng: &mut ChaCha8Rng) -> Vector2<f64> {
    let (angle, size): (f64, f64) =
        (rng.random_range(0.0..std::f64::consts::TAU), rng.random_range(least_px..MOST_PX));
    Vector2::new(angle.cos(), angle.sin()) * size
}

fn key(row: &Row) -> (i64, String, String) {
    (row.frame, row.ids[0].clone(), row.ids[1].clone())
}

fn read(path: &Path, ids: &[&str]) -> Vec<Row> {
    let row = |row: BTreeMap<String, String>| Row {
        frame: row["frame"].parse().unwrap(),
        ids: ids.iter().map(|id| row[*id].clone()).collect(),
        image_px: Vector2::new(row["u"].parse().unwrap(), row["v"].parse().unwrap()),
    };
    super::score::rows(path).into_iter().map(row).collect()
}

fn write(path: &Path, header: &str, rows: &[Row]) {
    let mut text = header.to_owned();
    for Row { frame, ids, image_px } in rows {
        writeln!(text, "{frame},{},{},{}", ids.join(","), image_px.x, image_px.y).unwrap();
    }
    std::fs::write(path, text).unwrap();
}
