//! Vehicles without starting poses: simulated drives, gross errors, several vehicles, and input that
//! says too little.

use nalgebra::{Point3, Rotation3, Translation3, UnitQuaternion, Vector2, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use trackbundle::camera::{Camera, Lens};
use trackbundle::geometry::{Pose, heading_rad};
use trackbundle::internals::initialise::{
    Initial, InitialWarning, Method, MotionBounds, initialise, initialise_within,
};
use trackbundle::problem::{
    Frame, GroundKnowledge, Known, PoseSigma, Problem, ShapePoint, Vehicle, VehicleObservation,
};
use trackbundle::terrain::Terrain;

const FRAMES: usize = 150;
const RATE_HZ: f64 = 30.0;
const CAMERA_HEIGHT_M: f64 = 60.0;
/// How far the middle of the simulated car is ahead of its rear axle \[m\].
const AXLE_M: f64 = 1.3;
/// The mark is the first point.
const MARK: Point3<f64> = Point3::new(0.2, 0.1, 1.5);

/// Speed \[m/s\] and rate of turn \[rad/s\] at a time \[s\].
type Drive = fn(f64) -> (f64, f64);

const DRIVES: &[(&str, Drive)] = &[
    ("straight", |_| (10.0, 0.0)),
    ("turning", |_| (9.0, 0.35)),
    ("reversing", |t| ((20.0 - 6.0 * t).clamp(-3.0, 5.0), 0.1 * (20.0 - 6.0 * t).clamp(-1.0, 1.0))),
    ("standing then starting", |t| ((3.0 * (t - 2.5)).max(0.0), 0.04 * (t - 2.5).max(0.0))),
    ("u-turn", |t| (5.0, if t > 0.5 && t < 4.5 { std::f64::consts::FRAC_PI_4 } else { 0.0 })),
    ("stop in the middle", |t| {
        (if t < 2.5 { (9.0 - 4.5 * t).max(0.0) } else { (4.0 * (t - 3.5)).max(0.0) }, 0.0)
    }),
];

#[derive(Clone, Copy)]
struct Simulation {
    seed: u64,
    drive: Drive,
    /// Share of gross image points: half of it are whole tracks that stay on the ground.
    gross: f64,
    /// Where the car starts and where it looks then.
    start: (f64, f64, f64),
    /// Frames in which nothing is seen; no point is seen both before and after them.
    gap: (usize, usize),
}

impl Simulation {
    fn new(drive: Drive) -> Self {
        Simulation { seed: 7, drive, gross: 0.04, start: (-12.0, 14.0, -0.4), gap: (0, 0) }
    }
}

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    let radius = (-2.0 * rng.random_range(f64::EPSILON..1.0).ln()).sqrt();
    radius * rng.random_range(0.0..std::f64::consts::TAU).cos()
}

fn camera() -> Camera {
    Camera {
        size_px: [3840, 2160],
        focal_px: Vector2::new(2680.0, 2680.0),
        principal_px: Vector2::new(1920.0, 1080.0),
        lens: Lens::Pinhole,
        pixel_centre_px: 0.0,
    }
}

/// A camera that sways over the origin, tilted a little.
fn camera_poses() -> Vec<Pose> {
    (0..FRAMES)
        .map(|frame| {
            let t = frame as f64 / RATE_HZ;
            let place = Translation3::new(0.3 * t.sin(), 0.2 * (0.7 * t).cos(), CAMERA_HEIGHT_M + 0.1 * t);
            let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
            let sway = UnitQuaternion::from_euler_angles(0.05 + 0.005 * t.cos(), 0.03, 0.2 + 0.01 * t);
            Pose::from_parts(place, down * sway)
        })
        .collect()
}

fn plane_pose(x: f64, y: f64, heading: f64) -> Pose {
    let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_axis_angle(&Vector3::z_axis(), heading));
    Pose::from_parts(Translation3::new(x, y, 0.0), turn)
}

fn truth(simulation: &Simulation) -> Vec<Pose> {
    let (mut x, mut y, mut heading) = simulation.start;
    (0..FRAMES)
        .map(|frame| {
            let pose = plane_pose(x + AXLE_M * heading.cos(), y + AXLE_M * heading.sin(), heading);
            for part in 0..10 {
                let (speed, turn) = (simulation.drive)((frame as f64 + part as f64 / 10.0) / RATE_HZ);
                x += speed * heading.cos() / RATE_HZ / 10.0;
                y += speed * heading.sin() / RATE_HZ / 10.0;
                heading += turn / RATE_HZ / 10.0;
            }
            pose
        })
        .collect()
}

fn vehicle(id: &str, simulation: &Simulation) -> (Vehicle, Vec<Pose>) {
    let mut rng = ChaCha8Rng::seed_from_u64(simulation.seed);
    let (camera, cameras, poses) = (camera(), camera_poses(), truth(simulation));
    let (from, to) = simulation.gap;
    let mut observations = Vec::new();
    let mut points = Vec::new();
    for point in 0..55 {
        let place = match point {
            0 => MARK,
            _ => Point3::new(
                rng.random_range(-2.2..2.2),
                rng.random_range(-0.9..0.9),
                rng.random_range(0.2..1.5),
            ),
        };
        let known = (point == 0).then_some(Known { value_m: MARK.z, sigma_m: 0.02 });
        points.push(ShapePoint { id: format!("p{point:03}"), known: [None, None, known] });
        // A track begins and ends somewhere.
        let length = rng.random_range(60..FRAMES);
        let first = rng.random_range(0..FRAMES - length);
        let (first, last) = if point == 0 { (0, FRAMES) } else { (first, first + length) };
        let stays = point > 0 && rng.random::<f64>() < 0.5 * simulation.gross;
        let is_after = rng.random::<f64>() < 0.5;
        let stood = poses[first] * Point3::new(place.x, place.y, 0.0);
        for frame in first..last {
            let in_world = if stays { stood } else { poses[frame] * place };
            let seen = camera.project(&cameras[frame].inverse_transform_point(&in_world).coords);
            let mut image_px = seen.unwrap() + Vector2::new(normal(&mut rng), normal(&mut rng));
            if point > 0 && rng.random::<f64>() < 0.5 * simulation.gross / (1.0 - 0.5 * simulation.gross) {
                let (angle, size) =
                    (rng.random_range(0.0..std::f64::consts::TAU), rng.random_range(8.0..150.0));
                image_px += Vector2::new(f64::cos(angle), f64::sin(angle)) * size;
            }
            let hidden = (from..to).contains(&frame) || (to > 0 && (frame < from) == is_after);
            if !hidden {
                observations.push(VehicleObservation { frame, point, image_px, sigma_px: 1.0 });
            }
        }
    }
    observations.sort_by_key(|o| (o.frame, o.point));
    let vehicle = Vehicle {
        id: id.to_owned(),
        marker: Some(0),
        height: None,
        is_car: false,
        points,
        observations,
        poses: vec![None; FRAMES],
        ..Vehicle::default()
    };
    (vehicle, poses)
}

fn problem(vehicles: Vec<Vehicle>) -> Problem {
    let unknown = PoseSigma { position_m: None, rotation_rad: [None; 3] };
    let exact = PoseSigma { position_m: Some(0.0), rotation_rad: [Some(0.0); 3] };
    let ground = GroundKnowledge {
        terrain: Terrain::Plane { z_m: 0.0 },
        sigma_m: 0.02,
        correlation_s: Some(1.0),
        bias_sigma_m: 0.0,
        tilt_sigma_rad: 0.05,
    };
    Problem {
        name: "simulated".to_owned(),
        camera: camera(),
        calibration: Default::default(),
        shutter: Default::default(),
        receivers: Vec::new(),
        video: None,
        frames: (0..FRAMES).map(|f| Frame { number: f as i64, time_s: f as f64 / RATE_HZ }).collect(),
        camera_poses: camera_poses().into_iter().map(Some).collect(),
        camera_pose_sigma: exact,
        targets: Vec::new(),
        target_observations: Vec::new(),
        vehicles,
        vehicle_pose_sigma: unknown,
        ground: Some(ground),
    }
}

/// Root mean square of the mark in the plane \[m\], and what 95 % of the headings keep within \[deg\].
fn score(initial: &Initial, at: usize, truth: &[Pose]) -> (f64, f64) {
    let estimate = &initial.estimate.vehicles[at];
    let mark = estimate.points[0].expect("the mark");
    let (mut squares, mut headings) = (Vec::new(), Vec::new());
    for (found, truth) in estimate.poses.iter().zip(truth) {
        let Some(found) = found else { continue };
        squares.push((found * mark - truth * MARK).xy().norm_squared());
        let off = heading_rad(found) - heading_rad(truth);
        headings.push(off.sin().atan2(off.cos()).abs().to_degrees());
    }
    headings.sort_by(f64::total_cmp);
    let mean = squares.iter().sum::<f64>() / squares.len() as f64;
    (mean.sqrt(), headings[(headings.len() - 1) * 95 / 100])
}

#[test]
fn drives_of_every_kind_are_found_in_the_image_points() {
    for gross in [0.04, 0.4] {
        for (name, drive) in DRIVES {
            for seed in [7, 8, 9] {
                let simulation = Simulation { seed, gross, ..Simulation::new(*drive) };
                let (vehicle, truth) = vehicle("car", &simulation);
                let initial = initialise(&problem(vec![vehicle]), Method::RobustWhereNeeded).unwrap();
                assert_eq!(initial.estimate.vehicles[0].left_out, None);
                let (mark_m, heading_deg) = score(&initial, 0, &truth);
                println!(
                    "{name}, {gross} gross, seed {seed}: mark {mark_m:.3} m, heading {heading_deg:.2} deg {:?}",
                    initial.warnings
                );
                assert!(
                    mark_m < 0.15 && heading_deg < 3.0,
                    "{name}, {gross} gross: {mark_m} m, {heading_deg} deg"
                );
            }
        }
    }
}

#[test]
fn a_long_occlusion_without_common_points_is_bridged_by_the_direction_of_travel() {
    let simulation = Simulation { gap: (65, 90), ..Simulation::new(|_| (7.0, 0.15)) };
    let (vehicle, truth) = vehicle("car", &simulation);
    let problem = problem(vec![vehicle]);
    let initial = initialise(&problem, Method::RobustWhereNeeded).unwrap();
    let (_, heading_deg) = score(&initial, 0, &truth);
    assert!(heading_deg < 5.0, "{heading_deg} deg");
    let span = problem.vehicles[0].span();
    assert!(initial.estimate.vehicles[0].poses[span].iter().all(Option::is_some));
}

#[test]
fn a_vehicle_that_never_moves_has_its_long_axis_and_a_warning() {
    for gross in [0.04, 0.4] {
        let simulation = Simulation { gross, ..Simulation::new(|_| (0.0, 0.0)) };
        let (vehicle, truth) = vehicle("car", &simulation);
        let initial = initialise(&problem(vec![vehicle]), Method::RobustWhereNeeded).unwrap();
        assert!(
            initial.warnings.iter().any(|w| w.to_string().contains("half a turn")),
            "{:?}",
            initial.warnings
        );
        let estimate = &initial.estimate.vehicles[0];
        for (found, truth) in estimate.poses.iter().zip(&truth) {
            let off = heading_rad(&found.unwrap()) - heading_rad(truth);
            assert!((2.0 * off).cos() > 0.9, "{off}");
        }
    }
}

#[test]
fn given_poses_fix_the_frame_of_the_others_and_stay_as_they_are() {
    let simulation = Simulation::new(|_| (6.0, 0.2));
    let (mut vehicle, truth) = vehicle("car", &simulation);
    // A body frame of its own: turned, and off the middle.
    let own = plane_pose(0.7, -0.3, 0.5);
    for frame in 40..60 {
        vehicle.poses[frame] = Some(truth[frame] * own);
    }
    let given = vehicle.poses.clone();
    let initial = initialise(&problem(vec![vehicle]), Method::RobustWhereNeeded).unwrap();
    for (frame, found) in initial.estimate.vehicles[0].poses.iter().enumerate() {
        let found = found.unwrap();
        let wanted = truth[frame] * own;
        if given[frame].is_some() {
            assert_eq!(given[frame], Some(found));
        }
        assert!((found.translation.vector - wanted.translation.vector).xy().norm() < 0.1, "frame {frame}");
        assert!(found.rotation.angle_to(&wanted.rotation) < 0.05, "frame {frame}");
    }
}

#[test]
fn several_vehicles_are_found_the_same_way_by_any_number_of_threads() {
    let one = Simulation::new(|_| (10.0, 0.0));
    let other = Simulation { seed: 8, start: (15.0, -8.0, 2.5), ..Simulation::new(|_| (5.0, 0.3)) };
    let ((first, first_truth), (second, second_truth)) = (vehicle("a", &one), vehicle("b", &other));
    let mut empty = second.clone();
    empty.id = "c".to_owned();
    empty.observations.truncate(1);
    let problem = problem(vec![first, second, empty]);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| initialise(&problem, Method::RobustWhereNeeded).unwrap())
    };
    let (by_one, by_two) = (run(1), run(2));
    assert_eq!(by_one.estimate, by_two.estimate);
    assert_eq!(by_one.warnings, by_two.warnings);
    for (at, truth) in [first_truth, second_truth].iter().enumerate() {
        let (mark_m, heading_deg) = score(&by_one, at, truth);
        assert!(mark_m < 0.1 && heading_deg < 2.0, "{mark_m} m, {heading_deg} deg");
    }
    let reason = by_one.estimate.vehicles[2].left_out.unwrap().to_string();
    assert!(reason.contains("points"), "{reason}");
}

#[test]
fn what_says_too_little_is_left_out_with_a_reason_and_without_a_panic() {
    let simulation = Simulation::new(|_| (8.0, 0.1));
    let (whole, _) = vehicle("car", &simulation);
    let reason = |change: &dyn Fn(&mut Problem)| {
        let mut problem = problem(vec![whole.clone()]);
        change(&mut problem);
        let initial = initialise(&problem, Method::RobustWhereNeeded).unwrap();
        assert!(initial.estimate.is_finite());
        initial.estimate.vehicles[0].left_out.map(|reason| reason.to_string())
    };
    let keep = |keep: fn(&VehicleObservation) -> bool| {
        move |p: &mut Problem| p.vehicles[0].observations.retain(keep)
    };
    let look = |turn: UnitQuaternion<f64>| {
        move |p: &mut Problem| p.camera_poses.iter_mut().flatten().for_each(|pose| pose.rotation = turn)
    };
    type Change<'a> = &'a dyn Fn(&mut Problem);
    let cases: [(Change, Option<&str>); 9] = [
        (&|p| p.ground = None, Some("no terrain")),
        (&|p| p.vehicles[0].observations.clear(), Some("never seen")),
        (&keep(|o| o.frame == 70), Some("seen in two frames")),
        (&keep(|o| o.point == 0), Some("points")),
        (&keep(|o| o.point < 2), Some("points")),
        (&look(UnitQuaternion::identity()), Some("meets the terrain")),
        (&look(UnitQuaternion::from_euler_angles(std::f64::consts::FRAC_PI_2, 0.0, 0.0)), None),
        // Straight down.
        (&look(UnitQuaternion::from_euler_angles(std::f64::consts::PI, 0.0, 0.0)), None),
        // All in one image point.
        (
            &|p| p.vehicles[0].observations.iter_mut().for_each(|o| o.image_px = Vector2::new(900.0, 900.0)),
            None,
        ),
    ];
    for (at, (change, wanted)) in cases.iter().enumerate() {
        let found = reason(*change);
        println!("{at}: {found:?}");
        if let Some(wanted) = wanted {
            let found = found.unwrap_or_else(|| panic!("case {at} is not left out"));
            assert!(found.contains(wanted), "case {at}: {found}");
        }
    }
    // Points on a line, and image points far outside any image.
    let on_a_line = |p: &mut Problem| {
        let camera = p.camera.clone();
        let cameras = camera_poses();
        for o in &mut p.vehicles[0].observations {
            let place = Point3::new(0.1 * o.point as f64 + 0.2 * o.frame as f64, 5.0, 0.0);
            o.image_px = camera.project(&cameras[o.frame].inverse_transform_point(&place).coords).unwrap();
        }
    };
    println!("line: {:?}", reason(&on_a_line));
    println!("far: {:?}", reason(&|p| p.vehicles[0].observations.iter_mut().for_each(|o| o.image_px *= 1e6)));
}

#[test]
fn a_bound_that_the_image_points_contradict_is_named_with_its_time() {
    let simulation = Simulation::new(|t| (if t > 2.0 && t < 3.5 { 14.0 } else { 6.0 }, 0.0));
    let (vehicle, _) = vehicle("car", &simulation);
    let problem = problem(vec![vehicle]);
    let within = |speed_mps: f64| {
        let bounds = MotionBounds { speed_mps, acceleration_mps2: 1e3, ..MotionBounds::default() };
        initialise_within(&problem, Method::RobustWhereNeeded, &bounds).unwrap().warnings
    };
    assert_eq!(within(20.0), []);
    let warnings = within(10.0);
    let [warning] = warnings.as_slice() else { panic!("{warnings:?}") };
    assert!(matches!(warning, InitialWarning::BeyondBounds { turns: false, limit: 10.0, .. }), "{warning:?}");
    let text = warning.to_string();
    assert!(text.contains("speed of 1") && text.contains("bound of 10.0 m/s"), "{text}");
}
