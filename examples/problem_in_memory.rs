//! Builds a problem from nothing and adjusts it: a car with eight points that drives under a drone whose poses are
//! exact; its scale is known from one measured distance between two of its points.
//!
//! `cargo run --release --no-default-features --example problem_in_memory`

use nalgebra::{Point3, Vector2};
use trackbundle::camera::{Camera, Lens};
use trackbundle::geometry::{Pose, pose};
use trackbundle::problem::{
    Calibration, Frame, PoseSigma, Problem, ScaleBar, ShapePoint, Shutter, Vehicle, VehicleObservation,
};
use trackbundle::{Options, adjust_problem};

/// Points of the car in its own frame: x forwards, y to the left, z up from the ground \[m\].
const POINTS_M: [[f64; 3]; 8] = [
    [2.0, 0.7, 0.6],
    [2.0, -0.7, 0.6],
    [-2.0, 0.8, 0.7],
    [-2.0, -0.8, 0.7],
    [0.6, 0.6, 1.4],
    [0.6, -0.6, 1.4],
    [-0.9, 0.6, 1.5],
    [-0.9, -0.6, 1.5],
];
const FRAMES: usize = 30;
/// Standard deviation of an image coordinate \[px\].
const SIGMA_PX: f64 = 0.5;

fn main() -> Result<(), trackbundle::Error> {
    let outcome = adjust_problem(problem(), &Options::default())?;
    let track = outcome.track("car").unwrap_or_default();
    let errors = track.iter().zip((0..FRAMES).map(true_pose)).map(|(place, truth)| {
        let marker = truth * Point3::from(POINTS_M[0]);
        (place.position - marker).norm()
    });
    println!("largest error of the marker: {:.3} m", errors.fold(0.0, f64::max));
    if let Some([x, y, z]) = track.first().and_then(|place| place.sigma_m) {
        println!("its first standard deviations: {x:.3} {y:.3} {z:.3} m");
    }
    println!("trust: {:?}", outcome.verdict.trust);
    Ok(())
}

fn problem() -> Problem {
    let camera = Camera {
        size_px: [3840, 2160],
        focal_px: Vector2::new(2900.0, 2900.0),
        principal_px: Vector2::new(1919.5, 1079.5),
        pixel_centre_px: 0.0,
        lens: Lens::Pinhole,
    };
    let mut observations = Vec::new();
    for frame in 0..FRAMES {
        for (point, place) in POINTS_M.into_iter().enumerate() {
            let in_camera = camera_pose(frame).inverse() * true_pose(frame) * Point3::from(place);
            let Some(image_px) = camera.project(&in_camera.coords) else { continue };
            let image_px = image_px + noise_px(frame * POINTS_M.len() + point);
            observations.push(VehicleObservation { frame, point, image_px, sigma_px: SIGMA_PX });
        }
    }
    // The starting poses are 20 cm off, and no more than starting values.
    let off = pose([0.2, -0.1, 0.05], [1.0, 0.0, 0.0, 0.01]);
    let unknown = PoseSigma { position_m: None, rotation_rad: [None; 3] };
    let exact = PoseSigma { position_m: Some(0.0), rotation_rad: [Some(0.0); 3] };
    Problem {
        name: "in memory".to_owned(),
        camera,
        calibration: Calibration::default(),
        shutter: Shutter::default(),
        frames: (0..FRAMES).map(|k| Frame { number: k as i64, time_s: time_s(k) }).collect(),
        camera_poses: (0..FRAMES).map(|frame| Some(camera_pose(frame))).collect(),
        camera_pose_sigma: exact,
        targets: Vec::new(),
        target_observations: Vec::new(),
        vehicles: vec![Vehicle {
            id: "car".to_owned(),
            marker: Some(0),
            height: None,
            scale_bars: vec![ScaleBar { points: [0, 2], length_m: 4.002, sigma_m: 0.005 }],
            is_car: false,
            points: (0..POINTS_M.len())
                .map(|k| ShapePoint { id: format!("p{k}"), known: [None; 3] })
                .collect(),
            observations,
            poses: (0..FRAMES).map(|frame| Some(true_pose(frame) * off)).collect(),
            poses_are_measured: false,
        }],
        vehicle_pose_sigma: unknown,
        ground: None,
        receivers: Vec::new(),
        video: None,
    }
}

fn time_s(frame: usize) -> f64 {
    frame as f64 / 15.0
}

/// The car drives at 8 m/s and turns a little.
fn true_pose(frame: usize) -> Pose {
    let turn = 0.15 * time_s(frame);
    pose([8.0 * time_s(frame), 0.6 * time_s(frame), 0.0], [(0.5 * turn).cos(), 0.0, 0.0, (0.5 * turn).sin()])
}

/// The drone looks down from 35 m and follows.
fn camera_pose(frame: usize) -> Pose {
    pose([3.0 + 6.0 * time_s(frame), -4.0, 35.0], [0.0, 1.0, 0.0, 0.0])
}

/// Something like noise.
fn noise_px(seed: usize) -> Vector2<f64> {
    let of = |k: f64| 2.0_f64.sqrt() * SIGMA_PX * (k * 12.9898).sin();
    Vector2::new(of(seed as f64), of(seed as f64 + 0.5))
}
