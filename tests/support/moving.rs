//! A film in which everything moves between two exposures: rows are read out one after another, a receiver
//! on the vehicle has a clock of its own, start poses and terrain are wrong together. Every error is drawn
//! from its standard deviation.

use super::drawn::normal;
use nalgebra::{Point3, Vector2, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::TAU;
use trackbundle::camera::{Camera, Lens};
use trackbundle::geometry::{Pose, rotation::exp};
use trackbundle::problem::{
    Frame, Freedom, GroundKnowledge, Known, PoseSigma, Problem, ReceivedPosition, Receiver,
    ReceiverKnowledge, Role, ShapePoint, Shutter, Target, TargetObservation, Vehicle, VehicleObservation,
};
use trackbundle::terrain::Terrain;

/// What is drawn.
#[derive(Clone, Copy, Debug)]
pub struct Flight {
    pub frames: usize,
    pub points: usize,
    pub targets: usize,
    pub image_px: f64,
    pub speed_mps: f64,
    pub height_m: f64,
    pub pose_m: f64,
    pub terrain_bias_m: f64,
    pub terrain_m: f64,
    pub roof_m: f64,
    pub clock_s: f64,
    /// Readout time and its standard deviation; zero: exactly that.
    pub readout_s: [f64; 2],
    pub gross: f64,
    /// GNSS positions a second, and their standard deviation.
    pub gnss: Option<(f64, f64)>,
}

/// The film of the study.
pub const FULL: Flight = Flight {
    frames: 150,
    points: 400,
    targets: 40,
    image_px: 1.0,
    speed_mps: 10.0,
    height_m: 60.0,
    pose_m: 0.3,
    terrain_bias_m: 0.5,
    terrain_m: 0.05,
    roof_m: 0.1,
    clock_s: 0.03,
    readout_s: [0.03, 0.01],
    gross: 0.05,
    gnss: Some((5.0, 0.02)),
};

impl Default for Flight {
    fn default() -> Self {
        FULL
    }
}

const STEP_S: f64 = 1.0 / 30.0;
const SURVEY_M: f64 = 0.01;
const CORRELATION_S: f64 = 1.0;
/// How long errors of start poses last \[s\].
const SLOW_S: f64 = 3.0;
/// Standard deviations of roll and pitch on the ground \[rad\].
const TILT_RAD: f64 = 0.01;
const ROTATION_RAD: f64 = 0.005;

/// What really was.
pub struct Truth {
    pub vehicle: Vec<Pose>,
    pub points: Vec<Point3<f64>>,
    pub clock_s: f64,
    pub readout_s: f64,
    pub bias_m: f64,
}

/// Where the camera is at a time, in any pose that a gust may have given it.
struct Drone {
    height_m: f64,
    phase: [f64; 6],
}

impl Drone {
    fn pose(&self, t: f64) -> Pose {
        let wave = |k: usize, period: f64| (TAU * t / period + self.phase[k]).sin();
        let place =
            Vector3::new(0.8 * wave(0, 7.0), 0.7 * wave(1, 9.0) - 12.0, self.height_m + 0.4 * wave(2, 8.0));
        // Looks down, and some degrees ahead.
        let down = exp(&Vector3::new(std::f64::consts::PI + 0.2, 0.0, 0.0));
        let sway = Vector3::new(0.01 * wave(3, 3.0), 0.01 * wave(4, 2.5), 0.02 * wave(5, 6.0));
        Pose::from_parts(place.into(), down * exp(&sway))
    }
}

/// Where the vehicle is: it brakes, speeds up and turns.
struct Drive {
    speed_mps: f64,
    middle_s: f64,
    heading: f64,
    swing: f64,
    /// Height above the plane at each frame.
    heights: Vec<f64>,
    leans: Vec<[f64; 2]>,
}

impl Drive {
    fn heading_at(&self, t: f64) -> f64 {
        self.heading + self.swing * (TAU * t / 6.0).sin()
    }

    fn level(&self, t: f64) -> (f64, f64, f64) {
        // Simpson's rule from the middle of the film on.
        let speed = |t: f64| self.speed_mps * (1.0 + 0.25 * (TAU * t / 4.0).sin());
        let from = t - self.middle_s;
        let steps = 64;
        let h = from / f64::from(steps);
        let (mut x, mut y) = (0.0, 0.0);
        for k in 0..=steps {
            let s = f64::from(k) * h;
            let weight = if k == 0 || k == steps {
                1.0
            } else if k % 2 == 1 {
                4.0
            } else {
                2.0
            };
            let (v, a) = (speed(s), self.heading_at(s));
            x += weight * v * a.cos();
            y += weight * v * a.sin();
        }
        (x * h / 3.0, y * h / 3.0, self.heading_at(from))
    }

    fn pose(&self, t: f64) -> Pose {
        let (x, y, heading) = self.level(t);
        let at = (t / STEP_S).clamp(0.0, (self.heights.len() - 1) as f64);
        let (k, part) = (at.floor() as usize, at.fract());
        let next = (k + 1).min(self.heights.len() - 1);
        let mix = |a: f64, b: f64| a + part * (b - a);
        let z = mix(self.heights[k], self.heights[next]);
        let lean = [0, 1].map(|axis| mix(self.leans[k][axis], self.leans[next][axis]));
        Pose::from_parts(
            Vector3::new(x, y, z).into(),
            exp(&(Vector3::z() * heading)) * exp(&Vector3::new(lean[0], lean[1], 0.0)),
        )
    }
}

/// A Gauss-Markov process that is smooth enough to be driven over.
fn slow(count: usize, sigma: f64, lasts_s: f64, rng: &mut ChaCha8Rng) -> Vec<f64> {
    let kept = (-STEP_S / lasts_s).exp();
    let mut value = normal(rng) * sigma;
    (0..count)
        .map(|_| {
            let now = value;
            value = value * kept + normal(rng) * sigma * (1.0 - kept * kept).sqrt();
            now
        })
        .collect()
}

impl Flight {
    /// The problem and the truth.
    pub fn draw(&self, seed: u64) -> (Problem, Truth) {
        let rng = &mut ChaCha8Rng::seed_from_u64(seed);
        let camera = Camera {
            size_px: [3840, 2160],
            focal_px: Vector2::new(2680.0, 2680.0),
            principal_px: Vector2::new(1920.0, 1080.0),
            pixel_centre_px: 0.0,
            lens: Lens::Pinhole,
        };
        let bias_m = normal(rng) * self.terrain_bias_m;
        let readout_s = self.readout_s[0] + normal(rng) * self.readout_s[1];
        let clock_s = normal(rng) * self.clock_s;
        let drone =
            Drone { height_m: self.height_m, phase: std::array::from_fn(|_| rng.random_range(0.0..TAU)) };
        let rough = slow(self.frames, self.terrain_m, CORRELATION_S, rng);
        let leans = [(); 2].map(|()| slow(self.frames, TILT_RAD, CORRELATION_S, rng));
        let drive = Drive {
            speed_mps: self.speed_mps,
            middle_s: 0.5 * self.frames as f64 * STEP_S,
            heading: rng.random_range(-0.5..0.5),
            swing: 0.4,
            heights: rough.iter().map(|h| h + bias_m).collect(),
            leans: (0..self.frames).map(|k| [leans[0][k], leans[1][k]]).collect(),
        };
        let (points, normals) = body(self.points, rng);
        // Seen at the time of its row.
        let seen = |place: &dyn Fn(f64) -> Point3<f64>, t: f64| -> Option<Vector2<f64>> {
            let mut row_s = 0.0;
            let mut pixel = None;
            for _ in 0..4 {
                let at = t + row_s;
                let found = camera.project(&drone.pose(at).inverse_transform_point(&place(at)).coords)?;
                row_s = camera.row_delay(found.y) * readout_s;
                pixel = Some(found);
            }
            pixel.filter(|pixel| camera.contains(pixel))
        };
        let places: Vec<Point3<f64>> = (0..self.targets)
            .map(|_| {
                let (x, y) = (rng.random_range(-50.0..50.0), rng.random_range(-24.0..24.0));
                Point3::new(x, y, rng.random_range(0.0..0.5))
            })
            .collect();
        let (mut of_car, mut target_observations) = (Vec::new(), Vec::new());
        let noise = |rng: &mut ChaCha8Rng| Vector2::new(normal(rng), normal(rng)) * self.image_px;
        for frame in 0..self.frames {
            let t = frame as f64 * STEP_S;
            let (now, eye) = (drive.pose(t), drone.pose(t).translation.vector);
            for (point, (place, normal)) in points.iter().zip(&normals).enumerate() {
                let is_hidden = (now * normal).dot(&(eye - (now * place).coords)) <= 0.0;
                if is_hidden {
                    continue;
                }
                let Some(mut pixel) = seen(&|at| drive.pose(at) * place, t) else { continue };
                if rng.random::<f64>() < self.gross {
                    pixel += Vector2::new(rng.random_range(-40.0..40.0), rng.random_range(-40.0..40.0));
                }
                let image_px = pixel + noise(rng);
                of_car.push(VehicleObservation { frame, point, image_px, sigma_px: self.image_px });
            }
            for (target, place) in places.iter().enumerate() {
                if let Some(pixel) = seen(&|_| *place, t) {
                    let image_px = pixel + noise(rng);
                    let sigma_px = self.image_px;
                    target_observations.push(TargetObservation { frame, target, image_px, sigma_px });
                }
            }
        }
        let targets = places.iter().enumerate().map(|(at, place)| Target {
            id: format!("T{at:02}"),
            known: std::array::from_fn(|axis| {
                Some(Known { value_m: place[axis] + normal(rng) * SURVEY_M, sigma_m: SURVEY_M })
            }),
            role: Role::Control,
        });
        let targets: Vec<Target> = targets.collect();
        let mut wrong = |pose: &dyn Fn(f64) -> Pose, level: bool| -> Vec<Option<Pose>> {
            let shifts = [(); 3].map(|()| slow(self.frames, self.pose_m, SLOW_S, rng));
            let turns = [(); 3].map(|()| slow(self.frames, ROTATION_RAD, SLOW_S, rng));
            let of_frame = |frame: usize| {
                let pose = pose(frame as f64 * STEP_S);
                let shift = Vector3::from_fn(|axis, _| shifts[axis][frame]);
                let turn = Vector3::from_fn(|axis, _| turns[axis][frame] * if level { 4.0 } else { 1.0 });
                Some(Pose::from_parts((pose.translation.vector + shift).into(), pose.rotation * exp(&turn)))
            };
            (0..self.frames).map(of_frame).collect()
        };
        let camera_poses = wrong(&|t| drone.pose(t), false);
        let vehicle_poses = wrong(&|t| drive.pose(t), true);
        let receivers = self.gnss.map(|(rate, sigma_m)| {
            let count = (self.frames as f64 * STEP_S * rate) as usize;
            let positions = (0..count).map(|k| {
                let t = k as f64 / rate + 0.013;
                let place = drive.pose(t) * points[0];
                ReceivedPosition {
                    time_s: t + clock_s,
                    position: Point3::from(place.coords.map(|v| v + normal(rng) * sigma_m)),
                    sigma_m: [sigma_m; 3],
                }
            });
            let (positions, knowledge) = (positions.collect(), ReceiverKnowledge::default());
            Receiver { vehicle: 0, point: 0, positions, knowledge }
        });
        let roof_m = points.iter().map(|p| p.z).fold(0.0, f64::max) + normal(rng) * self.roof_m;
        let problem = Problem {
            name: format!("moving-{seed}"),
            camera,
            calibration: Default::default(),
            shutter: Shutter {
                readout_s: self.readout_s[0],
                freedom: match self.readout_s[1] {
                    0.0 => Freedom::Fixed,
                    sigma_s => Freedom::Prior(sigma_s),
                },
            },
            frames: (0..self.frames)
                .map(|at| Frame { number: at as i64, time_s: at as f64 * STEP_S })
                .collect(),
            camera_poses,
            camera_pose_sigma: PoseSigma {
                position_m: Some(self.pose_m),
                rotation_rad: [Some(ROTATION_RAD); 3],
            },
            targets,
            target_observations,
            vehicles: vec![Vehicle {
                id: "car".to_owned(),
                marker: Some(0),
                height: Some(Known { value_m: roof_m, sigma_m: self.roof_m }),
                is_car: false,
                points: (0..self.points)
                    .map(|at| ShapePoint { id: format!("p{at:03}"), known: [None; 3] })
                    .collect(),
                observations: of_car,
                poses: vehicle_poses,
                ..Vehicle::default()
            }],
            vehicle_pose_sigma: PoseSigma {
                position_m: Some(self.pose_m),
                rotation_rad: [Some(2.0 * ROTATION_RAD), Some(2.0 * ROTATION_RAD), Some(4.0 * ROTATION_RAD)],
            },
            ground: Some(GroundKnowledge {
                terrain: Terrain::Plane { z_m: 0.0 },
                sigma_m: self.terrain_m,
                correlation_s: Some(CORRELATION_S),
                bias_sigma_m: self.terrain_bias_m,
                tilt_sigma_rad: TILT_RAD,
            }),
            receivers: receivers.into_iter().collect(),
            video: None,
        };
        let vehicle = (0..self.frames).map(|frame| drive.pose(frame as f64 * STEP_S)).collect();
        (problem, Truth { vehicle, points, clock_s, readout_s, bias_m })
    }
}

/// Points on the top and the sides of a car, and which way they look.
fn body(count: usize, rng: &mut ChaCha8Rng) -> (Vec<Point3<f64>>, Vec<Vector3<f64>>) {
    let (mut points, mut normals) = (Vec::new(), Vec::new());
    while points.len() < count {
        let (u, v) = (rng.random_range(-1.0..1.0), rng.random_range(-1.0..1.0));
        let (point, normal) = match rng.random_range(0..8) {
            0 | 1 => (Point3::new(2.2 * u, 0.9, 0.75 + 0.4 * v), Vector3::y()),
            2 | 3 => (Point3::new(2.2 * u, -0.9, 0.75 + 0.4 * v), -Vector3::y()),
            4 => (Point3::new(2.25, 0.8 * u, 0.65 + 0.3 * v), Vector3::x()),
            5 => (Point3::new(-2.25, 0.8 * u, 0.75 + 0.4 * v), -Vector3::x()),
            _ => (Point3::new(1.2 * u - 0.3, 0.7 * v, 1.5 - 0.05 * u * u), Vector3::z()),
        };
        points.push(point);
        normals.push(normal);
    }
    // The mark, and the highest point.
    points[0] = Point3::new(-0.1, 0.05, 1.56);
    normals[0] = Vector3::z();
    (points, normals)
}

/// Writes a problem folder.
pub fn write(problem: &Problem, folder: &std::path::Path, extra_toml: &str) {
    use std::fmt::Write;
    std::fs::create_dir_all(folder.join("observations")).unwrap();
    let mut toml = String::new();
    let camera = &problem.camera;
    let sigma_s = match problem.shutter.freedom {
        Freedom::Prior(sigma_s) => sigma_s,
        _ => 0.0,
    };
    let ground = problem.ground.as_ref().unwrap();
    let [roll, _, yaw] = problem.vehicle_pose_sigma.rotation_rad.map(|s| s.unwrap().to_degrees());
    assert!((2.0 * roll - yaw).abs() < 1e-9);
    let _ = write!(
        toml,
        "format = 1\nname = \"{}\"\n[camera]\nmodel = \"pinhole\"\nwidth = {}\nheight = {}\nfx = {}\nfy = {}\ncx = {}\ncy = {}\n\
         readout_s = {}\nreadout_sigma_s = {sigma_s}\n[noise]\ncamera_position_m = {}\ncamera_rotation_deg = {}\n\
         vehicle_position_m = {}\nvehicle_rotation_deg = {yaw}\n[terrain]\nplane_z = 0.0\nsigma_m = {}\ncorrelation_s = {}\n\
         bias_sigma_m = {}\ntilt_sigma_deg = {}\n",
        problem.name,
        camera.size_px[0],
        camera.size_px[1],
        camera.focal_px.x,
        camera.focal_px.y,
        camera.principal_px.x,
        camera.principal_px.y,
        problem.shutter.readout_s,
        problem.camera_pose_sigma.position_m.unwrap(),
        problem.camera_pose_sigma.rotation_rad[0].unwrap().to_degrees(),
        problem.vehicle_pose_sigma.position_m.unwrap(),
        ground.sigma_m,
        CORRELATION_S,
        ground.bias_sigma_m,
        ground.tilt_sigma_rad.to_degrees(),
    );
    let vehicle = &problem.vehicles[0];
    let height = vehicle.height.unwrap();
    let _ = write!(
        toml,
        "{extra_toml}[[vehicle]]\nid = \"{}\"\nmarker = \"{}\"\nheight_m = {}\nheight_sigma_m = {}\n",
        vehicle.id, vehicle.points[0].id, height.value_m, height.sigma_m
    );
    let save = |name: &str, text: String| std::fs::write(folder.join(name), text).unwrap();
    save("problem.toml", toml);
    let row = |pose: &Pose| {
        let p = pose.translation.vector;
        let [w, x, y, z] = trackbundle::geometry::quaternion_wxyz(pose);
        format!("{},{},{},{w},{x},{y},{z}", p.x, p.y, p.z)
    };
    let table = |header: &str, rows: Vec<String>| format!("{header}\n{}\n", rows.join("\n"));
    let frames = problem.frames.iter().map(|f| format!("{},{}", f.number, f.time_s)).collect();
    save("frames.csv", table("frame,time_s", frames));
    let poses = problem.camera_poses.iter().enumerate();
    let poses = poses.filter_map(|(k, pose)| Some(format!("{k},{}", row(pose.as_ref()?)))).collect();
    save("camera_poses.csv", table("frame,x,y,z,qw,qx,qy,qz", poses));
    let poses = vehicle.poses.iter().enumerate();
    let poses = poses.filter_map(|(k, pose)| Some(format!("{k},car,{}", row(pose.as_ref()?)))).collect();
    save("vehicle_poses.csv", table("frame,vehicle,x,y,z,qw,qx,qy,qz", poses));
    let seen = vehicle
        .observations
        .iter()
        .map(|o| format!("{},car,{},{},{}", o.frame, vehicle.points[o.point].id, o.image_px.x, o.image_px.y));
    save("vehicle_observations.csv", table("frame,vehicle,point,u,v", seen.collect()));
    let targets = problem.targets.iter().map(|t| {
        let [x, y, z] = t.known.map(|known| known.unwrap());
        format!("{},{},{},{},{s},{s},{s}", t.id, x.value_m, y.value_m, z.value_m, s = x.sigma_m)
    });
    save("targets.csv", table("target,x,y,z,sigma_x,sigma_y,sigma_z", targets.collect()));
    let seen = problem.target_observations.iter();
    let seen = seen
        .map(|o| format!("{},{},{},{}", o.frame, problem.targets[o.target].id, o.image_px.x, o.image_px.y));
    save("target_observations.csv", table("frame,target,u,v", seen.collect()));
    if let Some(receiver) = problem.receivers.first() {
        let rows = receiver.positions.iter().map(|p| {
            let [x, y, z] = p.sigma_m;
            let at = p.position;
            let id = &vehicle.points[receiver.point].id;
            format!("car,{id},{},{},{},{},{x},{y},{z}", p.time_s, at.x, at.y, at.z)
        });
        let header = "vehicle,point,time_s,x,y,z,sigma_x,sigma_y,sigma_z";
        save("observations/gnss.csv", table(header, rows.collect()));
    }
}
