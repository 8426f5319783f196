//! What is open of a problem, against theory that is counted here by hand: 1,000 random scenes.

use nalgebra::{Point3, UnitQuaternion, Vector2, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use trackbundle::camera::{Camera, Lens};
use trackbundle::estimate::{Depth, Estimate, Imaging, VehicleEstimate};
use trackbundle::geometry::Pose;
use trackbundle::geometry::rotation::exp;
use trackbundle::internals::diagnose::observability::{
    Class, Observability, describe, observability, observability_within,
};
use trackbundle::problem::{
    Frame, GroundKnowledge, Known, PoseSigma, Problem, Role, ScaleBar, ShapePoint, Target, TargetObservation,
    Vehicle, VehicleObservation,
};
use trackbundle::terrain::Terrain;

/// A problem without noise, its solution, and what theory says.
struct Scene {
    problem: Problem,
    estimate: Estimate,
    names: Vec<String>,
}

/// How the camera moves.
#[derive(Clone, Copy, PartialEq)]
enum Flight {
    /// Anywhere.
    Free,
    /// Anywhere at one height.
    Level,
    /// It only rotates.
    Rotating,
    /// It looks straight down from one place.
    Hovering,
    /// As it lies to the first vehicle, it stays.
    Following,
}

/// How vehicles move.
#[derive(Clone, Copy, PartialEq)]
enum Drive {
    /// Anywhere, tilted.
    Tilted,
    /// On the plane z = 0, upright, in curves.
    Upright,
    /// Upright; the first turns on the spot, this far from below a camera that hovers.
    OnTheSpot(f64),
}

#[derive(Clone, Copy, PartialEq)]
enum Sigma {
    Exact,
    Stated,
    /// Of positions only.
    Positions,
    None,
}

struct Plan {
    vehicles: usize,
    frames: usize,
    flight: Flight,
    drive: Drive,
    sigma: Sigma,
    /// Surveyed and tie points.
    targets: [usize; 2],
    has_ground: bool,
    knows_height: bool,
}

fn turned(rng: &mut ChaCha8Rng, size: f64) -> UnitQuaternion<f64> {
    exp(&Vector3::from_fn(|_, _| rng.random_range(-size..size)))
}

fn down() -> UnitQuaternion<f64> {
    exp(&(Vector3::x() * std::f64::consts::PI))
}

fn camera() -> Camera {
    Camera {
        size_px: [3840, 2160],
        focal_px: Vector2::new(2680.0, 2680.0),
        principal_px: Vector2::new(1920.0, 1080.0),
        pixel_centre_px: 0.0,
        lens: Lens::Pinhole,
    }
}

fn build(plan: &Plan, rng: &mut ChaCha8Rng) -> Scene {
    let Plan { vehicles, frames, flight, drive, .. } = *plan;
    let place = Point3::new(rng.random_range(-5.0..5.0), rng.random_range(-5.0..5.0), 50.0);
    let mut poses: Vec<Vec<Pose>> = Vec::new();
    for vehicle in 0..vehicles {
        let mut of_vehicle = Vec::new();
        let spot = Vector3::new(rng.random_range(-8.0..8.0), rng.random_range(-8.0..8.0), 0.0);
        for _ in 0..frames {
            let step = Vector3::new(rng.random_range(-6.0..6.0), rng.random_range(-6.0..6.0), 0.0);
            let yaw = exp(&(Vector3::z() * rng.random_range(-3.0..3.0)));
            let pose = match drive {
                Drive::Tilted => {
                    let lift = Vector3::z() * rng.random_range(-2.0..2.0);
                    Pose::from_parts((spot + step + lift).into(), yaw * turned(rng, 0.4))
                }
                Drive::OnTheSpot(off_m) if vehicle == 0 => {
                    let below = Vector3::new(place.x + off_m, place.y, 0.0);
                    Pose::from_parts(below.into(), yaw)
                }
                _ => Pose::from_parts((spot + step).into(), yaw),
            };
            of_vehicle.push(pose);
        }
        poses.push(of_vehicle);
    }
    let relative = poses[0][0].inverse() * Pose::from_parts(place.coords.into(), down() * turned(rng, 0.1));
    let cameras: Vec<Pose> = (0..frames)
        .map(|frame| {
            let step = Vector3::from_fn(|_, _| rng.random_range(-12.0..12.0));
            let look = down() * turned(rng, 0.2);
            match flight {
                Flight::Free => Pose::from_parts((place.coords + step).into(), look),
                Flight::Level => {
                    Pose::from_parts((place.coords + Vector3::new(step.x, step.y, 0.0)).into(), look)
                }
                Flight::Rotating => Pose::from_parts(place.coords.into(), look),
                Flight::Hovering => Pose::from_parts(place.coords.into(), down()),
                Flight::Following => poses[0][frame] * relative,
            }
        })
        .collect();
    let components = match plan.sigma {
        Sigma::Exact => PoseSigma { position_m: Some(0.0), rotation_rad: [Some(0.0); 3] },
        Sigma::Stated => PoseSigma { position_m: Some(0.3), rotation_rad: [Some(0.01); 3] },
        Sigma::Positions => PoseSigma { position_m: Some(0.05), rotation_rad: [None; 3] },
        Sigma::None => PoseSigma { position_m: None, rotation_rad: [None; 3] },
    };
    let mut problem = Problem {
        name: "random".to_owned(),
        camera: camera(),
        frames: (0..frames).map(|f| Frame { number: 80 + f as i64, time_s: 0.1 * f as f64 }).collect(),
        camera_poses: cameras.iter().map(|pose| Some(*pose)).collect(),
        camera_pose_sigma: components,
        targets: Vec::new(),
        target_observations: Vec::new(),
        vehicles: Vec::new(),
        vehicle_pose_sigma: PoseSigma { position_m: Some(0.25), rotation_rad: [Some(0.02); 3] },
        calibration: Default::default(),
        shutter: Default::default(),
        receivers: Vec::new(),
        video: None,
        ground: plan.has_ground.then(|| GroundKnowledge {
            terrain: Terrain::Plane { z_m: 0.0 },
            sigma_m: 0.02,
            correlation_s: Some(1.0),
            bias_sigma_m: if rng.random() { 0.05 } else { 0.0 },
            tilt_sigma_rad: 0.05,
        }),
    };
    let mut estimate = Estimate::new(&problem, cameras, Vec::new());
    estimate.targets.clear();
    for (vehicle, poses) in poses.into_iter().enumerate() {
        let number = rng.random_range(if frames < 4 { 5 } else { 4 }..=8);
        let points: Vec<Point3<f64>> = (0..number)
            .map(|_| {
                let [x, y, z] = [2.2, 0.9, 0.7].map(|half| rng.random_range(-half..half));
                Point3::new(x, y, z + 0.8)
            })
            .collect();
        let top = points.iter().map(|p| p.z).fold(0.0, f64::max);
        problem.vehicles.push(Vehicle {
            id: format!("car{}", vehicle + 1),
            marker: None,
            height: plan.knows_height.then_some(Known { value_m: top, sigma_m: 0.05 }),
            is_car: false,
            points: (0..number).map(|p| ShapePoint { id: format!("p{p:04}"), known: [None; 3] }).collect(),
            observations: Vec::new(),
            poses: poses.iter().map(|pose| Some(*pose)).collect(),
            ..Vehicle::default()
        });
        estimate.vehicles.push(VehicleEstimate {
            poses: poses.into_iter().map(Some).collect(),
            points: points.into_iter().map(Some).collect(),
            depths: vec![Depth::Known; number],
            motion: None,
            axle: [0.0; 2],
            axes_sigma_rad: 0.0,
            heading_turned: 0.0,
            left_out: None,
        });
        for frame in 0..frames {
            for point in 0..number {
                see(&mut problem, &estimate, vehicle, frame, point);
            }
        }
    }
    for target in 0..plan.targets[0] + plan.targets[1] {
        let place = Point3::new(
            rng.random_range(-14.0..14.0),
            rng.random_range(-9.0..9.0),
            rng.random_range(-3.0..3.0),
        );
        let sigma_m = if target % 2 == 0 { 0.01 } else { 0.0 };
        let known =
            |axis: usize| (target < plan.targets[0]).then_some(Known { value_m: place[axis], sigma_m });
        problem.targets.push(Target {
            id: format!("t{target:02}"),
            known: [known(0), known(1), known(2)],
            role: Role::Control,
        });
        estimate.targets.push(Some(place));
    }
    for frame in 0..frames {
        for target in 0..problem.targets.len() {
            let place = estimate.targets[target].unwrap();
            let image_px = Imaging::new(&problem, &estimate).target_px(frame, &place).unwrap();
            problem.target_observations.push(TargetObservation { frame, target, image_px, sigma_px: 1.0 });
        }
    }
    Scene { problem, estimate, names: Vec::new() }
}

fn see(problem: &mut Problem, estimate: &Estimate, vehicle: usize, frame: usize, point: usize) {
    let image_px = Imaging::new(problem, estimate).vehicle_px(vehicle, frame, point).unwrap();
    problem.vehicles[vehicle].observations.push(VehicleObservation { frame, point, image_px, sigma_px: 1.0 });
}

const AXES: [&str; 3] = ["x", "y", "z"];

impl Scene {
    fn expect(&mut self, name: impl Into<String>) {
        self.names.push(name.into());
    }

    fn id(&self, vehicle: usize) -> String {
        self.problem.vehicles[vehicle].id.clone()
    }

    /// Whole frames of bodies.
    fn expect_body_frame(&mut self, vehicle: usize) {
        for axis in AXES {
            self.expect(format!("body frame of {}, shift along {axis}", self.id(vehicle)));
            self.expect(format!("body frame of {}, rotation about {axis}", self.id(vehicle)));
        }
    }

    /// What is seen of the first vehicle, from where the cameras are now.
    fn see_anew(&mut self) {
        for o in std::mem::take(&mut self.problem.vehicles[0].observations) {
            see(&mut self.problem, &self.estimate, 0, o.frame, o.point);
        }
    }

    fn expect_scale_and_frame(&mut self, vehicle: usize) {
        self.expect(format!("scale of {}", self.id(vehicle)));
        self.expect_body_frame(vehicle);
    }

    /// What ground leaves of a frame.
    fn expect_standing_frame(&mut self, vehicle: usize) {
        self.expect(format!("body frame of {}, rotation about z", self.id(vehicle)));
        self.expect(format!("body frame of {}, shift along x", self.id(vehicle)));
        self.expect(format!("body frame of {}, shift along y", self.id(vehicle)));
    }

    fn expect_depths(&mut self, vehicle: usize) {
        for point in self.problem.vehicles[vehicle].points.clone() {
            self.expect(format!("depth of point {} of {}", point.id, self.id(vehicle)));
        }
    }

    fn expect_world_frame(&mut self) {
        for axis in AXES {
            self.expect(format!("frame of the world, shift along {axis}"));
            self.expect(format!("frame of the world, rotation about {axis}"));
        }
    }

    fn expect_cameras(&mut self) {
        for frame in 0..self.problem.frames.len() {
            for axis in AXES {
                self.expect(format!("position of frame {}, along {axis}", 80 + frame));
                self.expect(format!("attitude of frame {}, about {axis}", 80 + frame));
            }
        }
    }

    fn vehicles(&self) -> std::ops::Range<usize> {
        0..self.problem.vehicles.len()
    }
}

const CASES: [&str; 25] = [
    "exact cameras",
    "cameras with sigmas",
    "control",
    "tie points, moving camera",
    "tie points, rotating camera",
    "nothing static",
    "ground, level flight",
    "ground, flight at many heights",
    "ground and a known height",
    "camera follows",
    "turns below the camera",
    "turns beside the camera",
    "one frame, exact camera",
    "one frame, nothing static",
    "points seen once",
    "points without parallax",
    "ground, tie points, level flight",
    "ground, tie points, flight at many heights",
    "a frame with few points",
    "a known point",
    "positions known, attitudes not, nothing static",
    "positions known, attitudes not, tie points",
    "two surveyed points and tie points",
    "frames without a static point",
    "points come and go",
];

fn scene(case: usize, rng: &mut ChaCha8Rng) -> Scene {
    let mut plan = Plan {
        vehicles: rng.random_range(1..=3),
        frames: rng.random_range(3..=12),
        flight: Flight::Free,
        drive: Drive::Tilted,
        sigma: Sigma::Exact,
        targets: [0, 0],
        has_ground: false,
        knows_height: false,
    };
    let ties = rng.random_range(6..=9);
    match CASES[case] {
        "cameras with sigmas" => plan.sigma = Sigma::Stated,
        "control" => {
            plan.sigma = Sigma::None;
            plan.targets = [rng.random_range(4..=6), rng.random_range(0..=3)];
        }
        "tie points, moving camera" => {
            plan.sigma = Sigma::None;
            plan.targets = [0, ties];
        }
        "tie points, rotating camera" => {
            plan.sigma = Sigma::None;
            plan.targets = [0, ties];
            plan.flight = Flight::Rotating;
        }
        "nothing static" => plan.sigma = Sigma::None,
        "ground, level flight" => {
            (plan.has_ground, plan.flight, plan.drive) = (true, Flight::Level, Drive::Upright);
        }
        "ground, flight at many heights" => {
            (plan.has_ground, plan.drive) = (true, Drive::Upright);
        }
        "ground and a known height" => {
            (plan.has_ground, plan.flight, plan.drive) = (true, Flight::Level, Drive::Upright);
            plan.knows_height = true;
        }
        "camera follows" => plan.flight = Flight::Following,
        "turns below the camera" => {
            (plan.flight, plan.drive) = (Flight::Hovering, Drive::OnTheSpot(0.0));
        }
        "turns beside the camera" => {
            (plan.flight, plan.drive) = (Flight::Hovering, Drive::OnTheSpot(7.0));
        }
        "one frame, exact camera" => plan.frames = 1,
        "one frame, nothing static" => {
            plan.frames = 1;
            plan.sigma = Sigma::None;
        }
        "ground, tie points, level flight" | "ground, tie points, flight at many heights" => {
            plan.sigma = Sigma::None;
            plan.targets = [0, ties];
            (plan.has_ground, plan.drive) = (true, Drive::Upright);
            if CASES[case].contains("level") {
                plan.flight = Flight::Level;
            }
        }
        "positions known, attitudes not, nothing static" => plan.sigma = Sigma::Positions,
        "positions known, attitudes not, tie points" => {
            plan.sigma = Sigma::Positions;
            plan.targets = [0, ties];
        }
        "two surveyed points and tie points" => {
            plan.sigma = Sigma::None;
            plan.targets = [2, ties];
        }
        "frames without a static point" => {
            plan.sigma = Sigma::None;
            plan.targets = [0, ties];
            plan.frames = plan.frames.max(5);
        }
        "points come and go" => plan.frames = plan.frames.max(6),
        _ => {}
    }
    let mut scene = build(&plan, rng);
    let vehicles = scene.vehicles();
    match CASES[case] {
        "tie points, moving camera" => {
            scene.expect("scale of the world");
            scene.expect_world_frame();
            vehicles.for_each(|v| scene.expect_scale_and_frame(v));
        }
        "tie points, rotating camera" => {
            scene.expect_world_frame();
            (0..ties).for_each(|t| scene.expect(format!("depth of target t{t:02}")));
            vehicles.for_each(|v| scene.expect_scale_and_frame(v));
        }
        "nothing static" => {
            scene.expect_cameras();
            vehicles.for_each(|v| scene.expect_scale_and_frame(v));
        }
        "ground, level flight" => vehicles.for_each(|v| {
            scene.expect(format!("scale of car{}", v + 1));
            scene.expect_standing_frame(v);
        }),
        "ground, flight at many heights" | "ground and a known height" => {
            vehicles.for_each(|v| scene.expect_standing_frame(v));
        }
        "camera follows" | "turns below the camera" => vehicles.for_each(|v| match v {
            0 => {
                scene.expect_body_frame(0);
                scene.expect_depths(0);
            }
            _ => scene.expect_scale_and_frame(v),
        }),
        "one frame, exact camera" | "one frame, nothing static" => {
            if CASES[case].contains("nothing") {
                scene.expect_cameras();
            }
            vehicles.for_each(|v| {
                scene.expect_body_frame(v);
                scene.expect_depths(v);
            });
        }
        "points seen once" | "points without parallax" => {
            let is_twice = CASES[case].contains("parallax");
            if is_twice {
                // The last frame looks like the first.
                let last = scene.problem.frames.len() - 1;
                let first = scene.estimate.camera_poses[0];
                let moved = scene.estimate.camera_poses[last] * first.inverse();
                for vehicle in &mut scene.estimate.vehicles {
                    vehicle.poses[last] = Some(moved * vehicle.poses[0].unwrap());
                }
                for v in scene.vehicles() {
                    let seen = std::mem::take(&mut scene.problem.vehicles[v].observations);
                    for o in seen {
                        see(&mut scene.problem, &scene.estimate, v, o.frame, o.point);
                    }
                }
            }
            let last = scene.problem.frames.len() - 1;
            for v in scene.vehicles() {
                scene.expect_scale_and_frame(v);
                let more = rng.random_range(0..=3);
                for _ in 0..more {
                    let frame = rng.random_range(0..last);
                    let point = scene.problem.vehicles[v].points.len();
                    let id = format!("q{point:04}");
                    scene.problem.vehicles[v].points.push(ShapePoint { id: id.clone(), known: [None; 3] });
                    let place = Point3::new(rng.random_range(-2.0..2.0), 0.3, rng.random_range(0.2..1.4));
                    scene.estimate.vehicles[v].points.push(Some(place));
                    if is_twice {
                        see(&mut scene.problem, &scene.estimate, v, 0, point);
                        see(&mut scene.problem, &scene.estimate, v, last, point);
                    } else {
                        see(&mut scene.problem, &scene.estimate, v, frame, point);
                    }
                    scene.expect(format!("depth of point {id} of car{}", v + 1));
                }
                scene.problem.vehicles[v].observations.sort_by_key(|o| (o.frame, o.point));
            }
        }
        "ground, tie points, level flight" | "ground, tie points, flight at many heights" => {
            scene.expect("scale of the world");
            for axis in AXES {
                scene.expect(format!("frame of the world, shift along {axis}"));
            }
            scene.expect("frame of the world, rotation about z");
            for v in vehicles {
                scene.expect_standing_frame(v);
                if CASES[case].contains("level") {
                    scene.expect(format!("scale of car{}", v + 1));
                }
            }
        }
        "a frame with few points" => {
            let keep = rng.random_range(0..=2);
            let frame = rng.random_range(1..scene.problem.frames.len());
            let is_last = frame + 1 == scene.problem.frames.len();
            let keep = if is_last { keep.max(1) } else { keep };
            // Enough elsewhere.
            for v in scene.vehicles() {
                scene.expect_scale_and_frame(v);
            }
            let enough = scene.problem.frames.len() > 4;
            if enough {
                scene.problem.vehicles[0].observations.retain(|o| o.frame != frame || o.point < keep);
                (0..6 - 2 * keep).for_each(|_| scene.expect(format!("pose of car1 in frame {}", 80 + frame)));
            }
        }
        "a known point" => {
            for v in vehicles {
                let place = scene.estimate.vehicles[v].points[0].unwrap();
                let known = |axis: usize| Some(Known { value_m: place[axis], sigma_m: 0.01 });
                scene.problem.vehicles[v].points[0].known = [known(0), known(1), known(2)];
                scene.expect(format!("scale of car{}", v + 1));
                for axis in AXES {
                    scene.expect(format!("body frame of car{}, rotation about {axis}", v + 1));
                }
            }
        }
        "positions known, attitudes not, nothing static" => {
            for frame in 0..plan.frames {
                AXES.iter()
                    .for_each(|a| scene.expect(format!("attitude of frame {}, about {a}", 80 + frame)));
            }
            vehicles.for_each(|v| scene.expect_scale_and_frame(v));
        }
        "two surveyed points and tie points" => {
            // About the line through both.
            scene.expect("frame of the world, *");
            vehicles.for_each(|v| scene.expect_scale_and_frame(v));
        }
        "frames without a static point" => {
            scene.expect("scale of the world");
            scene.expect_world_frame();
            let blind: Vec<usize> = (0..rng.random_range(1..=2)).map(|k| 2 * k).collect();
            scene.problem.target_observations.retain(|o| !blind.contains(&o.frame));
            for frame in blind {
                for axis in AXES {
                    scene.expect(format!("position of frame {}, along {axis}", 80 + frame));
                    scene.expect(format!("attitude of frame {}, about {axis}", 80 + frame));
                }
            }
            vehicles.for_each(|v| scene.expect_scale_and_frame(v));
        }
        "points come and go" => {
            for v in vehicles {
                scene.expect_scale_and_frame(v);
                // Each frame misses one point, each vehicle comes late and goes early.
                let points = scene.problem.vehicles[v].points.len();
                if points > 5 {
                    let span = rng.random_range(0..=1)..plan.frames - rng.random_range(0..=1);
                    let first = rng.random_range(0..points);
                    let missed: Vec<usize> = (0..plan.frames).map(|f| (first + f) % points).collect();
                    let keeps =
                        |o: &VehicleObservation| span.contains(&o.frame) && missed[o.frame] != o.point;
                    scene.problem.vehicles[v].observations.retain(keeps);
                }
            }
        }
        _ => vehicles.for_each(|v| scene.expect_scale_and_frame(v)),
    }
    scene.names.sort();
    scene
}

/// Gives some vehicles a scale bar, and theory what it fixes: the scale of its vehicle, or with ground that ties this
/// to the world that of the world, and no frame. Where all depths are open a bar says something of two of them
/// together, which has no name; such vehicles have none. Returns how many bars there are.
fn add_bars(scene: &mut Scene, rng: &mut ChaCha8Rng) -> usize {
    let mut count = 0;
    for v in scene.vehicles() {
        let (draw, id) = (rng.random_range(0..3), scene.id(v));
        let points =
            scene.problem.vehicles[v].points.iter().filter(|point| point.id.starts_with('p')).count();
        let a = rng.random_range(0..points);
        let b = (a + rng.random_range(1..points)) % points;
        let open_depth = format!("depth of point p{a:04} of {id}");
        if draw > 0 || scene.names.contains(&open_depth) {
            continue;
        }
        let [from, to] = [a, b].map(|point| scene.estimate.vehicles[v].points[point].unwrap());
        let bar = ScaleBar { points: [a, b], length_m: (from - to).norm(), sigma_m: 0.005 };
        scene.problem.vehicles[v].scale_bars.push(bar);
        count += 1;
        let own = format!("scale of {id}");
        let tied = scene.problem.ground.is_some().then(|| "scale of the world".to_owned());
        let fixed = if scene.names.contains(&own) { Some(own) } else { tied };
        scene.names.retain(|name| Some(name) != fixed.as_ref());
    }
    count
}

fn null_names(found: &Observability) -> Vec<String> {
    let null = found.directions.iter().filter(|direction| direction.class == Class::Null);
    let mut names: Vec<String> = null.map(|direction| direction.name.clone()).collect();
    names.sort();
    names
}

/// The wanted names that are not among those found; one that ends in `*` stands for any that begins so.
fn match_up(found: &[String], wanted: &[String]) -> Vec<String> {
    let mut left = found.to_vec();
    let mut missing = Vec::new();
    for name in wanted {
        let is_it = |other: &String| match name.strip_suffix('*') {
            Some(beginning) => other.starts_with(beginning),
            None => other == name,
        };
        match left.iter().position(is_it) {
            Some(at) => drop(left.remove(at)),
            None => missing.push(name.clone()),
        }
    }
    missing
}

#[test]
fn a_thousand_scenes_are_as_theory_says() {
    const SCENES: usize = 1000;
    let mut rng = ChaCha8Rng::seed_from_u64(20);
    // Drawn apart, so that scenes are what they were without bars.
    let (mut of_bars, mut bars) = (ChaCha8Rng::seed_from_u64(21), 0);
    let (mut defects, mut expected, mut all_names) = (0, 0, 0);
    let mut names = [0usize; 2];
    let mut alike = 0;
    let mut wrong = vec![[0usize; 3]; CASES.len()];
    let mut sizes = (0, 0);
    for number in 0..SCENES {
        let case = number % CASES.len();
        let mut scene = scene(case, &mut rng);
        bars += add_bars(&mut scene, &mut of_bars);
        let found = observability(&scene.problem, &scene.estimate);
        assert!(found.is_dense);
        sizes = (sizes.0 + found.unknowns, sizes.1.max(found.unknowns));
        let got = null_names(&found);
        let by_theory = observability_within(&scene.problem, &scene.estimate, 0);
        assert!(!by_theory.is_dense);
        alike += usize::from(null_names(&by_theory) == got && by_theory.defect == found.defect);
        let is_right = [
            found.defect == scene.names.len() && found.rank + found.defect == found.unknowns,
            found.expected_defect == scene.names.len(),
            match_up(&got, &scene.names).is_empty() && got.len() == scene.names.len(),
        ];
        defects += usize::from(is_right[0]);
        expected += usize::from(is_right[1]);
        all_names += usize::from(is_right[2]);
        names[1] += scene.names.len();
        let missing = match_up(&got, &scene.names);
        names[0] += scene.names.len() - missing.len();
        for (wrong, right) in wrong[case].iter_mut().zip(is_right) {
            *wrong += usize::from(!right);
        }
        if is_right != [true; 3] && wrong[case].iter().sum::<usize>() <= 3 {
            let left = match_up(&scene.names, &got);
            let weakest = found.directions.iter().map(|d| d.singular_ratio).fold(0.0, f64::max);
            println!(
                "{number} {}: defect {} expected {} theory {}; missing {missing:?}, too much {left:?}; {weakest:e}",
                CASES[case],
                found.defect,
                found.expected_defect,
                scene.names.len()
            );
        }
    }
    for (case, wrong) in CASES.iter().zip(&wrong).filter(|(_, wrong)| **wrong != [0; 3]) {
        println!("{case}: wrong of {}: defect, expected defect, names {wrong:?}", SCENES / CASES.len());
    }
    println!(
        "of {SCENES} scenes ({} unknowns on average, {} at the most): defect right in {defects}, expected defect \
         in {expected}, all names in {all_names}; {} of {} names; without singular values the same in {alike}",
        sizes.0 / SCENES,
        sizes.1,
        names[0],
        names[1]
    );
    println!("{bars} scale bars");
    assert!(bars > SCENES / 3);
    assert!(100 * defects >= 99 * SCENES);
    assert!(100 * expected >= 99 * SCENES);
    assert!(100 * all_names >= 99 * SCENES);
    assert!(100 * alike >= 99 * SCENES);
}

#[test]
fn a_long_film_is_looked_at_by_theory() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let plan = Plan {
        vehicles: 2,
        frames: 300,
        flight: Flight::Level,
        drive: Drive::Upright,
        sigma: Sigma::Exact,
        targets: [0, 0],
        has_ground: true,
        knows_height: false,
    };
    let mut scene = build(&plan, &mut rng);
    for v in scene.vehicles() {
        scene.expect(format!("scale of car{}", v + 1));
        scene.expect_standing_frame(v);
    }
    scene.names.sort();
    let found = observability(&scene.problem, &scene.estimate);
    assert!(!found.is_dense);
    assert_eq!(null_names(&found), scene.names);
    assert_eq!([found.defect, found.expected_defect], [8, 8]);
    println!("{}", describe(&found));
}

#[test]
fn a_long_film_without_anything_static_is_looked_at_frame_by_frame() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let mut scene = build(&Plan { sigma: Sigma::None, ..plain(200) }, &mut rng);
    scene.expect_cameras();
    scene.expect_scale_and_frame(0);
    scene.names.sort();
    let found = observability(&scene.problem, &scene.estimate);
    assert!(!found.is_dense);
    assert_eq!([found.defect, found.expected_defect], [6 * 200 + 7; 2]);
    assert_eq!(null_names(&found), scene.names);
}

/// A plan with one vehicle and exact cameras.
fn plain(frames: usize) -> Plan {
    Plan {
        vehicles: 1,
        frames,
        flight: Flight::Free,
        drive: Drive::Tilted,
        sigma: Sigma::Exact,
        targets: [0, 0],
        has_ground: false,
        knows_height: false,
    }
}

fn weak_names(found: &Observability) -> Vec<String> {
    let weak = found.directions.iter().filter(|direction| direction.class == Class::Weak);
    let mut names: Vec<String> = weak.map(|direction| direction.name.clone()).collect();
    names.sort();
    names
}

/// Between nothing and something: centimetres of height over ground hold the scale, weakly.
#[test]
fn a_flight_that_is_nearly_level_holds_the_scale_weakly() {
    for (seed, up_m) in [(1, 0.01), (2, 0.003), (3, 1e-5)] {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut scene = build(
            &Plan { flight: Flight::Level, drive: Drive::Upright, has_ground: true, ..plain(8) },
            &mut rng,
        );
        // Cameras are moved together with what they see, but for the ground.
        for frame in 0..8 {
            let up = Vector3::z() * (up_m * rng.random_range(-1.0..1.0));
            scene.estimate.camera_poses[frame].translation.vector += up;
            scene.problem.camera_poses[frame] = Some(scene.estimate.camera_poses[frame]);
        }
        scene.see_anew();
        let found = observability(&scene.problem, &scene.estimate);
        assert_eq!([found.defect, found.expected_defect], [3, 3]);
        assert!(weak_names(&found).contains(&"scale of car1".to_owned()), "{}", describe(&found));
        let weak = found.directions.iter().find(|d| d.class == Class::Weak).unwrap();
        assert!((1e-9..1e-3).contains(&weak.singular_ratio), "{}", weak.singular_ratio);
        assert_eq!(weak.held_by, Some("starting poses"));
    }
}

/// A camera that nearly follows: every depth is weak, but for the one combination that is the scale.
#[test]
fn a_camera_that_nearly_follows_leaves_depths_weak() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut scene = build(&Plan { flight: Flight::Following, ..plain(10) }, &mut rng);
    for frame in 0..10 {
        let step = Vector3::from_fn(|_, _| 1e-3 * rng.random_range(-1.0..1.0));
        scene.estimate.camera_poses[frame].translation.vector += step;
        scene.problem.camera_poses[frame] = Some(scene.estimate.camera_poses[frame]);
    }
    scene.see_anew();
    let found = observability(&scene.problem, &scene.estimate);
    scene.expect_scale_and_frame(0);
    assert_eq!([found.defect, found.expected_defect], [7, 7], "{}", describe(&found));
    assert!(match_up(&null_names(&found), &scene.names).is_empty(), "{}", describe(&found));
    let weak = weak_names(&found);
    assert_eq!(weak.len(), scene.problem.vehicles[0].points.len() - 1, "{}", describe(&found));
    assert!(weak.iter().all(|name| name.starts_with("depth of point p")), "{}", describe(&found));
}

#[test]
fn what_people_read() {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let scene = build(&Plan { sigma: Sigma::None, vehicles: 2, ..plain(12) }, &mut rng);
    let text = describe(&observability(&scene.problem, &scene.estimate));
    println!("{text}");
    assert!(text.contains("defect 86 (as expected; by all singular values)"));
    assert!(text.contains("null: attitude of frames 80-91, about x; held by given camera poses\n"));
    assert!(text.contains("null: scale of car2; held by starting poses\n"));
    assert!(text.contains("null: body frame of car1, all six; held by starting poses\n"));
}
