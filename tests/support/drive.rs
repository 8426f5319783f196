//! A simulated drive below a hovering camera, written as a problem folder with its truth.

use nalgebra::{Point3, UnitQuaternion, Vector2, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::fmt::Write;
use std::path::Path;
use trackbundle::geometry::{Pose, quaternion_wxyz, rotation::exp};

/// What is simulated.
#[derive(Clone, Debug)]
pub struct Drive {
    pub seed: u64,
    pub frames: usize,
    pub points: usize,
    pub vehicles: usize,
    pub targets: usize,
    /// Where each target is; anywhere below the camera without.
    pub target_place: Option<fn(usize) -> [f64; 3]>,
    /// Of these targets so many are check points.
    pub check: usize,
    /// Noise of image points, of vehicles and of targets \[px\].
    pub noise_px: [f64; 2],
    /// Share of vehicle image points that are gross, and how far they are off \[px\].
    pub gross: (f64, [f64; 2]),
    /// White errors of the starting camera poses \[m, rad\].
    pub camera_error: [f64; 2],
    /// White errors of the starting vehicle poses \[m, rad\].
    pub vehicle_error: [f64; 2],
    /// By what all starting vehicle poses are off together: along x, y and z \[m\], and in heading \[rad\].
    pub vehicle_shift: [f64; 4],
    /// Speed of the first vehicle \[m/s\], backwards below zero, and how fast all turn \[rad/s\].
    pub motion: [f64; 2],
    /// A point is seen in a frame with this probability.
    pub visibility: f64,
    /// What stands in `[noise]` and `[terrain]`; the image sigmas are added.
    pub settings: String,
    /// What stands in each `[[vehicle]]`.
    pub vehicle_settings: String,
    /// Whether the height of the mark is known.
    pub knows_mark: bool,
}

impl Default for Drive {
    fn default() -> Self {
        Drive {
            seed: 1,
            frames: 60,
            points: 40,
            vehicles: 1,
            targets: 12,
            target_place: None,
            check: 0,
            noise_px: [1.0, 1.0],
            gross: (0.0, [0.0, 0.0]),
            camera_error: [0.2, 0.004],
            vehicle_error: [0.2, 0.02],
            vehicle_shift: [0.0; 4],
            motion: [14.0, 0.25],
            visibility: 1.0,
            settings: "camera_position_m = 0.2\ncamera_rotation_deg = 0.25\nvehicle_position_m = 0.2\n\
                       vehicle_rotation_deg = 1.2\n[terrain]\nplane_z = 0.0\n"
                .to_owned(),
            vehicle_settings: "marker = \"mark\"\n".to_owned(),
            knows_mark: true,
        }
    }
}

/// What really was.
#[derive(Clone, Debug)]
pub struct Truth {
    pub cameras: Vec<Pose>,
    /// For each vehicle its poses.
    pub vehicles: Vec<Vec<Pose>>,
    /// The points that all vehicles have, with their ids in the order of the tables.
    pub points: Vec<(String, Point3<f64>)>,
}

const FOCAL_PX: f64 = 2680.0;
const PRINCIPAL_PX: [f64; 2] = [1920.0, 1080.0];
pub const MARK_HEIGHT_M: f64 = 1.65;

impl Drive {
    /// Writes the folder and returns the truth.
    pub fn write(&self, folder: &Path) -> Truth {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        let truth = self.truth(&mut rng);
        std::fs::create_dir_all(folder).unwrap();
        let save = |name: &str, text: String| std::fs::write(folder.join(name), text).unwrap();
        let time = |frame: usize| frame as f64 / 30.0;

        let mut frames = "frame,time_s\n".to_owned();
        let mut cameras = "frame,x,y,z,qw,qx,qy,qz\n".to_owned();
        let mut vehicles = "frame,vehicle,x,y,z,qw,qx,qy,qz\n".to_owned();
        let mut seen = "frame,vehicle,point,u,v\n".to_owned();
        for frame in 0..self.frames {
            writeln!(frames, "{frame},{}", time(frame)).unwrap();
            let start = disturb(&truth.cameras[frame], self.camera_error, &mut rng);
            writeln!(cameras, "{frame},{}", row(&start)).unwrap();
            for (at, poses) in truth.vehicles.iter().enumerate() {
                let mut start = disturb(&poses[frame], self.vehicle_error, &mut rng);
                let [x, y, z, turn] = self.vehicle_shift;
                start.translation.vector += Vector3::new(x, y, z);
                start.rotation *= exp(&(Vector3::z() * turn));
                writeln!(vehicles, "{frame},car{at},{}", row(&start)).unwrap();
                for (id, point) in &truth.points {
                    let visible = rng.random::<f64>() < self.visibility;
                    let Some(pixel) = project(&truth.cameras[frame], &(poses[frame] * point)) else {
                        continue;
                    };
                    let mut pixel =
                        pixel + Vector2::new(normal(&mut rng), normal(&mut rng)) * self.noise_px[0];
                    if rng.random::<f64>() < self.gross.0 {
                        let [least, most] = self.gross.1;
                        let (angle, size) =
                            (rng.random_range(0.0..std::f64::consts::TAU), rng.random_range(least..most));
                        pixel += Vector2::new(f64::cos(angle), f64::sin(angle)) * size;
                    }
                    if visible {
                        writeln!(seen, "{frame},car{at},{id},{},{}", pixel.x, pixel.y).unwrap();
                    }
                }
            }
        }
        let mut targets = "target,x,y,z,sigma_x,sigma_y,sigma_z,role\n".to_owned();
        let mut target_points = "frame,target,u,v\n".to_owned();
        for target in 0..self.targets {
            let anywhere = Point3::new(
                rng.random_range(-30.0..30.0),
                rng.random_range(-18.0..18.0),
                rng.random_range(0.0..0.5),
            );
            let place = self.target_place.map_or(anywhere, |place| Point3::from(place(target)));
            let role = if target < self.check { "check" } else { "control" };
            writeln!(targets, "T{target:02},{},{},{},0.01,0.01,0.01,{role}", place.x, place.y, place.z)
                .unwrap();
            for frame in 0..self.frames {
                let Some(pixel) = project(&truth.cameras[frame], &place) else { continue };
                let pixel = pixel + Vector2::new(normal(&mut rng), normal(&mut rng)) * self.noise_px[1];
                writeln!(target_points, "{frame},T{target:02},{},{}", pixel.x, pixel.y).unwrap();
            }
        }
        save("frames.csv", frames);
        save("camera_poses.csv", cameras);
        save("vehicle_poses.csv", vehicles);
        save("vehicle_observations.csv", seen);
        if self.targets > 0 {
            save("targets.csv", targets);
            save("target_observations.csv", target_points);
        }
        if self.knows_mark {
            let mut known = "vehicle,point,x,y,z,sigma_x,sigma_y,sigma_z\n".to_owned();
            (0..self.vehicles)
                .for_each(|at| writeln!(known, "car{at},mark,,,{MARK_HEIGHT_M},,,0.01").unwrap());
            save("vehicle_points.csv", known);
        }
        save("problem.toml", self.problem_toml());
        truth
    }

    fn truth(&self, rng: &mut ChaCha8Rng) -> Truth {
        let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        let camera = |frame: usize| {
            let time = frame as f64 / 30.0;
            let place = Vector3::new(
                -3.0 + 0.3 * (0.7 * time).sin(),
                2.0 + 0.2 * time,
                60.0 + 0.2 * (0.9 * time).cos(),
            );
            let lean = Vector3::new(0.03 * (0.5 * time).sin(), 0.02, 0.4 + 0.02 * time);
            Pose::from_parts(place.into(), down * exp(&lean))
        };
        let vehicle = |at: usize, frame: usize| {
            let time = (frame as f64 - 0.5 * self.frames as f64) / 30.0;
            let [speed, turn] = self.motion;
            let speed = speed - 3.0 * at as f64;
            let middle = 0.3 + 2.0 * at as f64;
            let heading = middle + turn * time;
            let place = if turn == 0.0 {
                Vector3::new(middle.cos(), middle.sin(), 0.0) * (speed * time)
            } else {
                let arc = Vector3::new(heading.sin() - middle.sin(), middle.cos() - heading.cos(), 0.0);
                arc * (speed / turn)
            };
            Pose::from_parts(
                (place + Vector3::y() * (5.0 * at as f64)).into(),
                exp(&(Vector3::z() * heading)),
            )
        };
        let mut points: Vec<(String, Point3<f64>)> = (0..self.points)
            .map(|at| {
                let (along, across) = (rng.random_range(-2.2..2.2), rng.random_range(-0.85..0.85));
                (format!("p{at:03}"), Point3::new(along, across, rng.random_range(0.4..1.5)))
            })
            .collect();
        points.insert(0, ("mark".to_owned(), Point3::new(0.1, 0.0, MARK_HEIGHT_M)));
        Truth {
            cameras: (0..self.frames).map(camera).collect(),
            vehicles: (0..self.vehicles)
                .map(|at| (0..self.frames).map(|frame| vehicle(at, frame)).collect())
                .collect(),
            points,
        }
    }

    fn problem_toml(&self) -> String {
        // An image sigma of zero is not allowed to weigh infinitely.
        let [vehicle_px, target_px] = self.noise_px.map(|px| if px == 0.0 { 1.0 } else { px });
        let mut text = format!(
            "format = 1\nname = \"drive-{}\"\n[camera]\nwidth = 3840\nheight = 2160\nfx = {FOCAL_PX}\nfy = {FOCAL_PX}\n\
             cx = {}\ncy = {}\n[noise]\nvehicle_px = {vehicle_px}\ntarget_px = {target_px}\n{}",
            self.seed, PRINCIPAL_PX[0], PRINCIPAL_PX[1], self.settings
        );
        (0..self.vehicles)
            .for_each(|at| write!(text, "[[vehicle]]\nid = \"car{at}\"\n{}", self.vehicle_settings).unwrap());
        text
    }
}

impl Truth {
    /// Track of the mark of a vehicle.
    pub fn mark(&self, vehicle: usize) -> Vec<Point3<f64>> {
        self.vehicles[vehicle].iter().map(|pose| pose * self.points[0].1).collect()
    }
}

pub(super) fn project(camera: &Pose, point: &Point3<f64>) -> Option<Vector2<f64>> {
    let x = camera.inverse_transform_point(point);
    let pixel = Vector2::new(x.x, x.y) / x.z * FOCAL_PX + Vector2::from(PRINCIPAL_PX);
    (x.z > 0.0 && (0.0..3840.0).contains(&pixel.x) && (0.0..2160.0).contains(&pixel.y)).then_some(pixel)
}

fn row(pose: &Pose) -> String {
    let p = pose.translation.vector;
    let [w, x, y, z] = quaternion_wxyz(pose);
    format!("{},{},{},{w},{x},{y},{z}", p.x, p.y, p.z)
}

fn disturb(pose: &Pose, [position_m, rotation_rad]: [f64; 2], rng: &mut ChaCha8Rng) -> Pose {
    let mut error = |sigma: f64| Vector3::new(normal(rng), normal(rng), normal(rng)) * sigma;
    let (shift, turn) = (error(position_m), error(rotation_rad));
    Pose::from_parts((pose.translation.vector + shift).into(), pose.rotation * exp(&turn))
}

pub(super) fn normal(rng: &mut ChaCha8Rng) -> f64 {
    let (a, b): (f64, f64) = (rng.random_range(f64::EPSILON..1.0), rng.random());
    (-2.0 * a.ln()).sqrt() * (std::f64::consts::TAU * b).cos()
}
