//! What makes a problem invalid, as data.

use super::{Freedom, GroundKnowledge, Known, PoseSigma, Problem, Receiver, Role, Target, Vehicle, Video};
use crate::geometry::Pose;
use crate::terrain::Terrain;
use std::collections::HashSet;
use std::fmt;

/// Surveyed control targets from which a camera pose that is not given can be resected.
const LEAST_CONTROL: usize = 3;

/// Where in a problem something stands; numbers are indices.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// The problem as a whole.
    Problem,
    /// [`Problem::camera`], with what is adjusted of it.
    Camera,
    /// [`Problem::shutter`].
    Shutter,
    /// [`Problem::ground`].
    Ground,
    /// A frame.
    Frame(usize),
    /// A target.
    Target(usize),
    /// An image point of a target.
    TargetObservation(usize),
    /// A vehicle.
    Vehicle(usize),
    /// A point of a vehicle: vehicle and point.
    ShapePoint(usize, usize),
    /// An image point of a vehicle: vehicle and image point.
    VehicleObservation(usize, usize),
    /// A pose of a vehicle: vehicle and frame.
    VehiclePose(usize, usize),
    /// A receiver.
    Receiver(usize),
    /// A position of a receiver: receiver and position.
    ReceivedPosition(usize, usize),
}

/// What is wrong there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Wrong {
    /// There is none.
    Missing,
    /// A list is not as long as it must be.
    Length {
        /// How long it is.
        found: usize,
        /// How long it must be.
        wanted: usize,
    },
    /// An index leads nowhere.
    Index {
        /// The index.
        found: usize,
        /// How many there are.
        count: usize,
    },
    /// A number is infinite or none.
    NotFinite,
    /// A number must be above zero.
    NotAboveZero(f64),
    /// A number must not be below zero.
    Negative(f64),
    /// It does not come after the one before.
    Order,
    /// There is another of this name or number.
    Repeated,
    /// The lens model has no ray for this image point.
    WithoutRay,
}

/// Something that makes a problem invalid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fault {
    /// Where.
    pub part: Part,
    /// The field there.
    pub field: &'static str,
    /// What is wrong with it.
    pub wrong: Wrong,
}

/// All that makes a problem invalid.
#[derive(Clone, Debug, PartialEq)]
pub struct Faults(pub Vec<Fault>);

impl fmt::Display for Faults {
    /// One line for each.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|Fault { part, field, wrong }| writeln!(f, "{part:?}, {field}: {wrong:?}"))
    }
}

impl std::error::Error for Faults {}

impl Problem {
    /// Checks what the room `files` guarantees of a problem that it read, for one that is built in memory.
    ///
    /// # Errors
    ///
    /// Everything that is wrong: lists that are not one for each frame, indices out of range, numbers that are not
    /// finite, standard deviations that are not positive (of what may be held: negative), times and image points
    /// that are not in order, names that are not unique, image points without a ray, poses that can neither be
    /// given nor found.
    pub fn check(&self) -> Result<(), Faults> {
        let mut faults = Check { problem: self, faults: Vec::new() };
        faults.camera();
        faults.frames();
        faults.targets();
        for (at, vehicle) in self.vehicles.iter().enumerate() {
            faults.vehicle(at, vehicle);
        }
        faults.unique("id", self.vehicles.iter().map(|vehicle| vehicle.id.as_str()), Part::Vehicle);
        faults.ground();
        for (at, receiver) in self.receivers.iter().enumerate() {
            faults.receiver(at, receiver);
        }
        let owners = self.receivers.iter().map(|receiver| (receiver.vehicle, receiver.point));
        faults.increasing("vehicle", owners, Part::Receiver);
        if faults.faults.is_empty() { Ok(()) } else { Err(Faults(faults.faults)) }
    }
}

struct Check<'p> {
    problem: &'p Problem,
    faults: Vec<Fault>,
}

impl Check<'_> {
    fn add(&mut self, part: Part, field: &'static str, wrong: Wrong) {
        self.faults.push(Fault { part, field, wrong });
    }

    fn finite(&mut self, part: Part, field: &'static str, numbers: impl IntoIterator<Item = f64>) -> bool {
        let is_finite = numbers.into_iter().all(f64::is_finite);
        if !is_finite {
            self.add(part, field, Wrong::NotFinite);
        }
        is_finite
    }

    fn positive(&mut self, part: Part, field: &'static str, number: f64) {
        if self.finite(part, field, [number]) && number <= 0.0 {
            self.add(part, field, Wrong::NotAboveZero(number));
        }
    }

    fn not_negative(&mut self, part: Part, field: &'static str, number: f64) {
        if self.finite(part, field, [number]) && number < 0.0 {
            self.add(part, field, Wrong::Negative(number));
        }
    }

    fn length(&mut self, part: Part, field: &'static str, found: usize, wanted: usize) {
        if found != wanted {
            self.add(part, field, Wrong::Length { found, wanted });
        }
    }

    fn index(&mut self, part: Part, field: &'static str, found: usize, count: usize) -> bool {
        if found >= count {
            self.add(part, field, Wrong::Index { found, count });
        }
        found < count
    }

    fn unique<K: std::hash::Hash + Eq>(
        &mut self,
        field: &'static str,
        keys: impl Iterator<Item = K>,
        part: impl Fn(usize) -> Part,
    ) {
        let mut seen = HashSet::new();
        for (at, key) in keys.enumerate() {
            if !seen.insert(key) {
                self.add(part(at), field, Wrong::Repeated);
            }
        }
    }

    /// Each comes after the one before.
    fn increasing<K: PartialOrd>(
        &mut self,
        field: &'static str,
        keys: impl Iterator<Item = K>,
        part: impl Fn(usize) -> Part,
    ) {
        let mut last = None;
        for (at, key) in keys.enumerate() {
            if last.as_ref().is_some_and(|last| key <= *last) {
                self.add(part(at), field, Wrong::Order);
            }
            last = Some(key);
        }
    }

    fn pose(&mut self, part: Part, field: &'static str, pose: &Pose) {
        self.finite(part, field, pose.to_homogeneous().iter().copied());
    }

    fn known(&mut self, part: Part, field: &'static str, known: &Known) {
        self.finite(part, field, [known.value_m]);
        self.not_negative(part, field, known.sigma_m);
    }

    fn freedom(&mut self, part: Part, field: &'static str, freedom: Freedom) {
        if let Freedom::Prior(sigma) = freedom {
            self.positive(part, field, sigma);
        }
    }

    fn pose_sigma(&mut self, field: &'static str, sigma: &PoseSigma) {
        for sigma in sigma.rotation_rad.into_iter().chain([sigma.position_m]).flatten() {
            self.not_negative(Part::Problem, field, sigma);
        }
    }

    fn camera(&mut self) {
        let Problem { camera, calibration, shutter, .. } = self.problem;
        for size in camera.size_px {
            self.positive(Part::Camera, "size_px", f64::from(size));
        }
        camera.focal_px.iter().for_each(|focal| self.positive(Part::Camera, "focal_px", *focal));
        self.finite(Part::Camera, "principal_px", camera.principal_px.iter().copied());
        self.finite(Part::Camera, "pixel_centre_px", [camera.pixel_centre_px]);
        self.finite(Part::Camera, "lens", camera.lens.numbers().into_iter().chain(camera.lens.held()));
        calibration.iter().for_each(|freedom| self.freedom(Part::Camera, "calibration", *freedom));
        self.finite(Part::Shutter, "readout_s", [shutter.readout_s]);
        self.freedom(Part::Shutter, "freedom", shutter.freedom);
    }

    fn frames(&mut self) {
        let problem = self.problem;
        let count = problem.frames.len();
        if count == 0 {
            self.add(Part::Problem, "frames", Wrong::Missing);
        }
        for (at, frame) in problem.frames.iter().enumerate() {
            self.finite(Part::Frame(at), "time_s", [frame.time_s]);
        }
        self.increasing("time_s", problem.frames.iter().map(|frame| frame.time_s), Part::Frame);
        self.unique("number", problem.frames.iter().map(|frame| frame.number), Part::Frame);
        self.length(Part::Problem, "camera_poses", problem.camera_poses.len(), count);
        if let Some(Video::Images(images)) = &problem.video {
            self.length(Part::Problem, "video", images.len(), count);
        }
        let is_control = |target: &&Target| target.role == Role::Control && target.is_surveyed();
        let can_resect = problem.targets.iter().filter(is_control).count() >= LEAST_CONTROL;
        for (at, pose) in problem.camera_poses.iter().enumerate() {
            match pose {
                Some(pose) => self.pose(Part::Frame(at), "camera_poses", pose),
                None if !can_resect => self.add(Part::Frame(at), "camera_poses", Wrong::Missing),
                None => {}
            }
        }
        self.pose_sigma("camera_pose_sigma", &problem.camera_pose_sigma);
        self.pose_sigma("vehicle_pose_sigma", &problem.vehicle_pose_sigma);
    }

    /// An image point: its frame, place and standard deviation.
    fn image_point(&mut self, part: Part, frame: usize, image_px: &nalgebra::Vector2<f64>, sigma_px: f64) {
        self.index(part, "frame", frame, self.problem.frames.len());
        if self.finite(part, "image_px", image_px.iter().copied())
            && self.problem.camera.ray(image_px).is_none()
        {
            self.add(part, "image_px", Wrong::WithoutRay);
        }
        self.positive(part, "sigma_px", sigma_px);
    }

    fn targets(&mut self) {
        let Problem { targets, target_observations, .. } = self.problem;
        for (at, target) in targets.iter().enumerate() {
            target.known.iter().flatten().for_each(|known| self.known(Part::Target(at), "known", known));
        }
        self.unique("id", targets.iter().map(|target| target.id.as_str()), Part::Target);
        for (at, o) in target_observations.iter().enumerate() {
            let part = Part::TargetObservation(at);
            self.index(part, "target", o.target, targets.len());
            self.image_point(part, o.frame, &o.image_px, o.sigma_px);
        }
        let places = target_observations.iter().map(|o| (o.frame, o.target));
        self.increasing("frame", places, Part::TargetObservation);
    }

    fn vehicle(&mut self, at: usize, vehicle: &Vehicle) {
        let (part, points) = (Part::Vehicle(at), vehicle.points.len());
        if let Some(marker) = vehicle.marker {
            self.index(part, "marker", marker, points);
        }
        if let Some(height) = &vehicle.height {
            self.positive(part, "height", height.value_m);
            self.not_negative(part, "height", height.sigma_m);
        }
        for (point, shape_point) in vehicle.points.iter().enumerate() {
            let part = Part::ShapePoint(at, point);
            shape_point.known.iter().flatten().for_each(|known| self.known(part, "known", known));
        }
        let ids = vehicle.points.iter().map(|point| point.id.as_str());
        self.unique("id", ids, |point| Part::ShapePoint(at, point));
        for (field, wrong) in vehicle.faults_between_points() {
            self.add(part, field, wrong);
        }
        self.length(part, "poses", vehicle.poses.len(), self.problem.frames.len());
        for (frame, pose) in vehicle.poses.iter().enumerate() {
            pose.iter().for_each(|pose| self.pose(Part::VehiclePose(at, frame), "poses", pose));
        }
        let mut missing = HashSet::new();
        for (item, o) in vehicle.observations.iter().enumerate() {
            let part = Part::VehicleObservation(at, item);
            self.index(part, "point", o.point, points);
            self.image_point(part, o.frame, &o.image_px, o.sigma_px);
            let has_none = vehicle.poses.get(o.frame).is_some_and(Option::is_none);
            // Without ground there is nothing to find a pose on.
            if has_none && self.problem.ground.is_none() && missing.insert(o.frame) {
                self.add(Part::VehiclePose(at, o.frame), "poses", Wrong::Missing);
            }
        }
        let places = vehicle.observations.iter().map(|o| (o.frame, o.point));
        self.increasing("frame", places, |item| Part::VehicleObservation(at, item));
    }

    fn ground(&mut self) {
        let Some(ground) = &self.problem.ground else { return };
        let GroundKnowledge { terrain, sigma_m, correlation_s, bias_sigma_m, tilt_sigma_rad } = ground;
        if let Terrain::Plane { z_m } = terrain {
            self.finite(Part::Ground, "terrain", [*z_m]);
        }
        for (field, value) in [
            ("sigma_m", sigma_m),
            ("correlation_s", &correlation_s.unwrap_or(0.0)),
            ("bias_sigma_m", bias_sigma_m),
            ("tilt_sigma_rad", tilt_sigma_rad),
        ] {
            self.not_negative(Part::Ground, field, *value);
        }
    }

    fn receiver(&mut self, at: usize, receiver: &Receiver) {
        let (part, vehicles) = (Part::Receiver(at), &self.problem.vehicles);
        if self.index(part, "vehicle", receiver.vehicle, vehicles.len()) {
            self.index(part, "point", receiver.point, vehicles[receiver.vehicle].points.len());
        }
        for (item, position) in receiver.positions.iter().enumerate() {
            let part = Part::ReceivedPosition(at, item);
            self.finite(part, "time_s", [position.time_s]);
            self.finite(part, "position", position.position.iter().copied());
            position.sigma_m.iter().for_each(|sigma_m| self.positive(part, "sigma_m", *sigma_m));
        }
        let times = receiver.positions.iter().map(|position| position.time_s);
        self.increasing("time_s", times, |item| Part::ReceivedPosition(at, item));
        let known = &receiver.knowledge;
        if let Some(offset) = known.clock_offset {
            self.finite(part, "clock_offset", [offset.value_s]);
            self.not_negative(part, "clock_offset", offset.sigma_s);
        }
        self.not_negative(part, "drift_sigma", known.drift_sigma);
        self.not_negative(part, "shift_sigma_m", known.shift_sigma_m);
        self.finite(part, "lever_arm_m", known.lever_arm_m.iter().copied());
        self.not_negative(part, "lever_sigma_m", known.lever_sigma_m);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::{Camera, Lens};
    use crate::problem::{
        Calibration, Frame, KnownTime, ReceivedPosition, ReceiverKnowledge, ShapePoint, Shutter,
        TargetObservation, VehicleObservation,
    };
    use nalgebra::{Point3, Vector2};

    fn valid() -> Problem {
        let exact = |value_m: f64| Some(Known { value_m, sigma_m: 0.0 });
        let sigma = PoseSigma { position_m: Some(0.1), rotation_rad: [None; 3] };
        let target = |id: &str| Target {
            id: id.to_owned(),
            known: [exact(1.0), exact(2.0), exact(0.0)],
            role: Role::Control,
        };
        let shape_point = |id: &str| ShapePoint { id: id.to_owned(), known: [None; 3] };
        let image_px = Vector2::new(400.0, 300.0);
        let seen = |frame, point| VehicleObservation { frame, point, image_px, sigma_px: 1.0 };
        let received =
            |time_s: f64| ReceivedPosition { time_s, position: Point3::origin(), sigma_m: [0.02; 3] };
        let clock_offset = Some(KnownTime { value_s: 0.1, sigma_s: 0.0 });
        Problem {
            name: "x".to_owned(),
            camera: Camera {
                size_px: [800, 600],
                focal_px: Vector2::new(700.0, 700.0),
                principal_px: image_px,
                pixel_centre_px: 0.0,
                lens: Lens::Pinhole,
            },
            calibration: Calibration::default(),
            shutter: Shutter::default(),
            frames: vec![Frame { number: 3, time_s: 0.0 }, Frame { number: 4, time_s: 0.1 }],
            camera_poses: vec![Some(Pose::identity()); 2],
            camera_pose_sigma: sigma,
            targets: vec![target("a"), target("b")],
            target_observations: (0..2)
                .map(|target| TargetObservation { frame: 1, target, image_px, sigma_px: 1.0 })
                .collect(),
            vehicles: vec![Vehicle {
                id: "car".to_owned(),
                marker: Some(1),
                height: Some(Known { value_m: 1.5, sigma_m: 0.1 }),
                is_car: false,
                points: vec![shape_point("p"), shape_point("q")],
                observations: vec![seen(0, 0), seen(0, 1), seen(1, 0)],
                poses: vec![Some(Pose::identity()); 2],
                ..Vehicle::default()
            }],
            vehicle_pose_sigma: sigma,
            ground: None,
            receivers: vec![Receiver {
                vehicle: 0,
                point: 1,
                positions: vec![received(0.0), received(0.1)],
                knowledge: ReceiverKnowledge { clock_offset, ..ReceiverKnowledge::default() },
            }],
            video: None,
        }
    }

    #[test]
    fn a_valid_problem_has_no_faults() {
        assert_eq!(valid().check(), Ok(()));
        assert_eq!(Problem { ground: Some(level()), ..valid() }.check(), Ok(()));
    }

    fn level() -> GroundKnowledge {
        GroundKnowledge {
            terrain: Terrain::Plane { z_m: 0.0 },
            sigma_m: 0.02,
            correlation_s: Some(1.0),
            bias_sigma_m: 0.0,
            tilt_sigma_rad: 0.05,
        }
    }

    /// A change that breaks a problem, and what is then wrong.
    type Breach = (fn(&mut Problem), Part, &'static str, Wrong);

    const BREACHES: [Breach; 22] = [
        (|p| p.camera.focal_px.y = -1.0, Part::Camera, "focal_px", Wrong::NotAboveZero(-1.0)),
        (|p| p.camera.size_px[0] = 0, Part::Camera, "size_px", Wrong::NotAboveZero(0.0)),
        (|p| p.calibration[1] = Freedom::Prior(0.0), Part::Camera, "calibration", Wrong::NotAboveZero(0.0)),
        (|p| p.shutter.readout_s = f64::NAN, Part::Shutter, "readout_s", Wrong::NotFinite),
        (|p| p.frames[1].time_s = 0.0, Part::Frame(1), "time_s", Wrong::Order),
        (|p| p.frames[1].number = 3, Part::Frame(1), "number", Wrong::Repeated),
        (|p| p.camera_poses[1] = None, Part::Frame(1), "camera_poses", Wrong::Missing),
        (
            |p| p.camera_poses.truncate(1),
            Part::Problem,
            "camera_poses",
            Wrong::Length { found: 1, wanted: 2 },
        ),
        (
            |p| p.camera_pose_sigma.position_m = Some(f64::INFINITY),
            Part::Problem,
            "camera_pose_sigma",
            Wrong::NotFinite,
        ),
        (|p| p.targets[1].id = "a".to_owned(), Part::Target(1), "id", Wrong::Repeated),
        (
            |p| p.targets[0].known[2] = Some(Known { value_m: 0.0, sigma_m: -0.1 }),
            Part::Target(0),
            "known",
            Wrong::Negative(-0.1),
        ),
        (
            |p| p.target_observations[1].target = 2,
            Part::TargetObservation(1),
            "target",
            Wrong::Index { found: 2, count: 2 },
        ),
        (|p| p.target_observations[1].target = 0, Part::TargetObservation(1), "frame", Wrong::Order),
        (
            |p| p.vehicles[0].observations[2].frame = 7,
            Part::VehicleObservation(0, 2),
            "frame",
            Wrong::Index { found: 7, count: 2 },
        ),
        (
            |p| p.vehicles[0].observations[1].sigma_px = 0.0,
            Part::VehicleObservation(0, 1),
            "sigma_px",
            Wrong::NotAboveZero(0.0),
        ),
        (|p| p.vehicles[0].marker = Some(2), Part::Vehicle(0), "marker", Wrong::Index { found: 2, count: 2 }),
        (|p| p.vehicles[0].points[1].id = "p".to_owned(), Part::ShapePoint(0, 1), "id", Wrong::Repeated),
        (|p| p.vehicles[0].poses[1] = None, Part::VehiclePose(0, 1), "poses", Wrong::Missing),
        (|p| p.receivers[0].positions[1].time_s = -1.0, Part::ReceivedPosition(0, 1), "time_s", Wrong::Order),
        (
            |p| p.receivers[0].positions[0].sigma_m[2] = 0.0,
            Part::ReceivedPosition(0, 0),
            "sigma_m",
            Wrong::NotAboveZero(0.0),
        ),
        (|p| p.receivers[0].vehicle = 1, Part::Receiver(0), "vehicle", Wrong::Index { found: 1, count: 1 }),
        (
            |p| p.ground = Some(GroundKnowledge { correlation_s: Some(-2.0), ..level() }),
            Part::Ground,
            "correlation_s",
            Wrong::Negative(-2.0),
        ),
    ];

    #[test]
    fn each_fault_is_named_with_its_place() {
        for (at, (breach, part, field, wrong)) in BREACHES.into_iter().enumerate() {
            let mut problem = valid();
            breach(&mut problem);
            assert_eq!(problem.check(), Err(Faults(vec![Fault { part, field, wrong }])), "{at}");
        }
    }

    #[test]
    fn an_image_point_needs_a_ray() {
        let mut problem = valid();
        // r - r^3 / 3 is largest, 2/3, at 1: 467 px.
        problem.camera.lens = Lens::Brown(crate::camera::Brown::new([-1.0 / 3.0, 0.0, 0.0, 0.0, 0.0]));
        problem.vehicles[0].observations[0].image_px.x += 500.0;
        let fault =
            Fault { part: Part::VehicleObservation(0, 0), field: "image_px", wrong: Wrong::WithoutRay };
        let faults = problem.check().unwrap_err();
        assert_eq!(faults, Faults(vec![fault]));
        assert_eq!(faults.to_string(), "VehicleObservation(0, 0), image_px: WithoutRay\n");
    }
}
