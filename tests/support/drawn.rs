//! A film drawn from the very model of the adjustment: every error has the distribution that is assumed.

use nalgebra::{Point3, Unit, UnitQuaternion, Vector2, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use trackbundle::camera::{Camera, Lens};
use trackbundle::estimate::{Depth, Estimate, VehicleEstimate};
use trackbundle::geometry::{Pose, rotation::exp};
use trackbundle::internals::refine::{MotionPrior, MotionPriors, Order, Strengths};
use trackbundle::problem::{
    Frame, GroundKnowledge, Known, PoseSigma, Problem, Role, ShapePoint, Target, TargetObservation, Vehicle,
    VehicleObservation,
};
use trackbundle::terrain::Terrain;

const STEP_S: f64 = 1.0 / 30.0;
pub const CAMERA_STRENGTH: Strengths = Strengths { linear: 0.2, angular: 0.01 };

/// What is drawn. What really scatters is the stated standard deviation times `really`.
#[derive(Clone, Debug)]
pub struct Film {
    pub frames: usize,
    pub points: usize,
    pub targets: usize,
    pub vehicle_px: f64,
    pub target_px: f64,
    pub survey_m: f64,
    pub ground_m: f64,
    pub tilt_rad: f64,
    pub correlation_s: f64,
    pub mark_m: f64,
    /// How fast the camera drifts along x \[m/s\].
    pub drift_mps: f64,
    /// Of the targets so many are check points.
    pub check: usize,
    /// Speed \[m/s\] and turn \[rad/s\].
    pub motion: [f64; 2],
    /// By what errors of image points of vehicles, of targets, of the survey and of the terrain really scatter.
    pub really: [f64; 4],
}

impl Default for Film {
    fn default() -> Self {
        Film {
            frames: 150,
            points: 12,
            targets: 10,
            vehicle_px: 1.0,
            target_px: 1.0,
            survey_m: 0.02,
            ground_m: 0.02,
            tilt_rad: 0.003,
            correlation_s: 1.0,
            mark_m: 0.01,
            drift_mps: 0.2,
            check: 0,
            motion: [5.0, 0.25],
            really: [1.0; 4],
        }
    }
}

/// What really was.
pub struct Truth {
    pub cameras: Vec<Pose>,
    pub vehicle: Vec<Pose>,
    pub points: Vec<Point3<f64>>,
}

pub fn normal(rng: &mut ChaCha8Rng) -> f64 {
    let (a, b): (f64, f64) = (rng.random_range(f64::EPSILON..1.0), rng.random());
    (-2.0 * a.ln()).sqrt() * (std::f64::consts::TAU * b).cos()
}

fn normal3(rng: &mut ChaCha8Rng) -> Vector3<f64> {
    Vector3::from_fn(|_, _| normal(rng))
}

impl Film {
    /// The motion priors of the film: the camera's is known, the vehicle has none.
    pub fn motion_priors() -> MotionPriors {
        MotionPriors {
            camera: MotionPrior::Given(Order::Acceleration, CAMERA_STRENGTH),
            vehicle: MotionPrior::Off,
        }
    }

    /// The problem, a start near the truth, and the truth.
    pub fn draw(&self, seed: u64) -> (Problem, Estimate, Truth) {
        let rng = &mut ChaCha8Rng::seed_from_u64(seed);
        let camera = Camera {
            size_px: [3840, 2160],
            focal_px: Vector2::new(2680.0, 2680.0),
            principal_px: Vector2::new(1920.0, 1080.0),
            pixel_centre_px: 0.0,
            lens: Lens::Pinhole,
        };
        let truth = self.truth(rng);
        let [of_vehicle, of_targets, of_survey, _] = self.really;
        let seen = |camera_pose: &Pose, point: &Point3<f64>, sigma_px: f64, rng: &mut ChaCha8Rng| {
            let pixel = camera.project(&camera_pose.inverse_transform_point(point).coords)?;
            let is_inside = (0.0..3840.0).contains(&pixel.x) && (0.0..2160.0).contains(&pixel.y);
            let pixel = pixel + Vector2::new(normal(rng), normal(rng)) * sigma_px;
            is_inside.then_some(pixel)
        };
        let (mut of_car, mut target_observations) = (Vec::new(), Vec::new());
        let places: Vec<Point3<f64>> = (0..self.targets)
            .map(|_| {
                Point3::new(
                    rng.random_range(-28.0..28.0),
                    rng.random_range(-16.0..16.0),
                    rng.random_range(0.0..2.0),
                )
            })
            .collect();
        for frame in 0..self.frames {
            for (point, place) in truth.points.iter().enumerate() {
                let in_world = truth.vehicle[frame] * place;
                let sigma_px = self.vehicle_px * of_vehicle;
                if let Some(image_px) = seen(&truth.cameras[frame], &in_world, sigma_px, rng) {
                    of_car.push(VehicleObservation { frame, point, image_px, sigma_px: self.vehicle_px });
                }
            }
            for (target, place) in places.iter().enumerate() {
                let sigma_px = self.target_px * of_targets;
                if let Some(image_px) = seen(&truth.cameras[frame], place, sigma_px, rng) {
                    let sigma_px = self.target_px;
                    target_observations.push(TargetObservation { frame, target, image_px, sigma_px });
                }
            }
        }
        let targets = places.iter().enumerate().map(|(at, place)| {
            let surveyed = place + normal3(rng) * (self.survey_m * of_survey);
            let known = |axis: usize| Some(Known { value_m: surveyed[axis], sigma_m: self.survey_m });
            Target {
                id: format!("T{at:02}"),
                known: [known(0), known(1), known(2)],
                role: if at < self.check { Role::Check } else { Role::Control },
            }
        });
        let targets: Vec<Target> = targets.collect();
        let mark_m = truth.points[0].z + normal(rng) * self.mark_m;
        let points = (0..self.points).map(|at| ShapePoint {
            id: format!("p{at:03}"),
            known: [None, None, (at == 0).then_some(Known { value_m: mark_m, sigma_m: self.mark_m })],
        });
        let disturbed = |pose: &Pose, rng: &mut ChaCha8Rng| {
            let shift = normal3(rng) * 0.05;
            Pose::from_parts(
                (pose.translation.vector + shift).into(),
                pose.rotation * exp(&(normal3(rng) * 0.002)),
            )
        };
        let start = Estimate {
            camera_poses: truth.cameras.iter().map(|pose| disturbed(pose, rng)).collect(),
            vehicles: vec![VehicleEstimate {
                poses: truth.vehicle.iter().map(|pose| Some(disturbed(pose, rng))).collect(),
                points: truth.points.iter().map(|point| Some(point + normal3(rng) * 0.02)).collect(),
                depths: vec![Depth::Known; self.points],
                motion: None,
                axle: [0.0; 2],
                axes_sigma_rad: 0.0,
                heading_turned: 0.0,
                left_out: None,
            }],
            targets: targets.iter().map(Target::surveyed).collect(),
            terrain_bias_m: 0.0,
            camera: camera.clone(),
            readout_s: 0.0,
            receivers: Vec::new(),
        };
        let unknown = PoseSigma { position_m: None, rotation_rad: [None; 3] };
        let problem = Problem {
            name: format!("drawn-{seed}"),
            camera,
            calibration: Default::default(),
            shutter: Default::default(),
            receivers: Vec::new(),
            video: None,
            frames: (0..self.frames)
                .map(|at| Frame { number: at as i64, time_s: at as f64 * STEP_S })
                .collect(),
            camera_poses: start.camera_poses.iter().copied().map(Some).collect(),
            camera_pose_sigma: unknown,
            targets,
            target_observations,
            vehicles: vec![Vehicle {
                id: "car".to_owned(),
                marker: Some(0),
                height: None,
                is_car: false,
                points: points.collect(),
                observations: of_car,
                poses: start.vehicles[0].poses.clone(),
                ..Vehicle::default()
            }],
            vehicle_pose_sigma: unknown,
            ground: Some(GroundKnowledge {
                terrain: Terrain::Plane { z_m: 0.0 },
                sigma_m: self.ground_m,
                correlation_s: Some(self.correlation_s),
                bias_sigma_m: 0.0,
                tilt_sigma_rad: self.tilt_rad,
            }),
        };
        (problem, start, truth)
    }

    fn truth(&self, rng: &mut ChaCha8Rng) -> Truth {
        // The camera: white noise of acceleration about a slow drift.
        let root = STEP_S.sqrt();
        let mut place = Vector3::new(-1.0, 1.0, 60.0);
        let mut velocity = Vector3::new(self.drift_mps, -0.1, 0.05);
        let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        let mut turn = down * exp(&Vector3::new(0.03, 0.02, 0.4));
        let mut rate = Vector3::new(0.0, 0.0, 0.01);
        let mut cameras = Vec::new();
        for _ in 0..self.frames {
            cameras.push(Pose::from_parts(place.into(), turn));
            place += velocity * STEP_S;
            turn *= exp(&(rate * STEP_S));
            velocity += normal3(rng) * (CAMERA_STRENGTH.linear / root * STEP_S);
            rate += normal3(rng) * (CAMERA_STRENGTH.angular / root * STEP_S);
        }
        // The vehicle: its height and lean are Gauss-Markov processes.
        let kept = if self.correlation_s > 0.0 { (-STEP_S / self.correlation_s).exp() } else { 0.0 };
        let sigmas = Vector3::new(self.ground_m, self.tilt_rad, self.tilt_rad) * self.really[3];
        let mut lean = normal3(rng).component_mul(&sigmas);
        let [speed, turning] = self.motion;
        let mut vehicle = Vec::new();
        for frame in 0..self.frames {
            let time = (frame as f64 - 0.5 * self.frames as f64) * STEP_S;
            let heading = 0.3 + turning * time;
            let (x, y) = if turning == 0.0 {
                (speed * time * 0.3_f64.cos(), speed * time * 0.3_f64.sin())
            } else {
                let radius = speed / turning;
                (radius * (heading.sin() - 0.3_f64.sin()), radius * (0.3_f64.cos() - heading.cos()))
            };
            let up = Vector3::new(lean.y, lean.z, (1.0 - lean.y * lean.y - lean.z * lean.z).sqrt());
            let level = UnitQuaternion::rotation_between_axis(&Unit::new_normalize(up), &Vector3::z_axis())
                .expect("nearly upright");
            vehicle.push(Pose::from_parts(
                Vector3::new(x, y, lean.x).into(),
                exp(&(Vector3::z() * heading)) * level,
            ));
            lean = lean * kept + normal3(rng).component_mul(&sigmas) * (1.0 - kept * kept).sqrt();
        }
        let mut points: Vec<Point3<f64>> = (0..self.points)
            .map(|_| {
                Point3::new(
                    rng.random_range(-2.2..2.2),
                    rng.random_range(-0.85..0.85),
                    rng.random_range(0.4..1.5),
                )
            })
            .collect();
        points[0] = Point3::new(0.1, 0.0, 1.65);
        Truth { cameras, vehicle, points }
    }
}
