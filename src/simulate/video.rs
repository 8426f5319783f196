//! A video of a world.

use super::knowledge::{KnownBody, LEAST_KNOWN_M};
use super::path::{FINE, PlanPath};
use super::scenario::{Course, Given, MeasuredGrid, PoseSettings, Scenario, VehicleSettings};
use super::wander::{Curve, Purpose, Times, normal, normal3, stream, values, wander, wanders};
use super::wrong_tracks::{Moment, Surroundings, WrongKind, WrongTrack};
use super::{Chance, GrossError, SimulatedVideo, Track, Tracked, World, no_ground};
use crate::camera::Camera;
use crate::estimate::{Depth, Estimate, ReceiverEstimate, VehicleEstimate};
use crate::geometry::{Pose, rotation::exp};
use crate::problem::{
    Frame, Freedom, GroundKnowledge, Known, KnownTime, PoseSigma, Problem, ReceivedPosition, Receiver,
    ReceiverKnowledge, Role, ShapePoint, Shutter, Target, TargetObservation, Vehicle, VehicleObservation,
};
use crate::reference::GnssPosition;
use crate::tables::Findings;
use crate::terrain::{Grid, NoGround, Terrain};
use nalgebra::{Point3, Rotation3, Unit, UnitQuaternion, Vector2, Vector3};
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;
use std::sync::Arc;

/// A row is found so exactly \[s\].
const ROW_TOLERANCE_S: f64 = 1e-9;
/// ... in so many steps at the most.
const ROW_STEPS: usize = 20;
/// To so many digits heights of a measured grid are written.
pub const GRID_DIGITS: i32 = 4;
/// Streams of what is known between points, of vehicles in their order, begin here.
const BETWEEN_POINTS: usize = 1 << 19;

/// Where a place is at a time.
type Place<'a> = dyn Fn(f64) -> Option<Point3<f64>> + 'a;
/// The pixel of a place in a frame, at the time of its row.
type Seen<'a> = dyn Fn(usize, &Place<'_>) -> Option<Vector2<f64>> + 'a;
/// A receiver whose positions are observations, and what is true of it.
type Received = (Receiver, ReceiverEstimate);

/// The camera at any time.
struct Drone<'w> {
    scenario: &'w Scenario,
    ground_m: f64,
    drift: [Curve; 3],
    sway: [Curve; 3],
    /// White attitude of each frame \[rad\].
    vibration: Vec<Vector3<f64>>,
    followed: Option<&'w PlanPath>,
    middle_s: f64,
}

impl Drone<'_> {
    /// Its pose at a time of a frame.
    fn pose(&self, frame: usize, time_s: f64) -> Pose {
        let flight = &self.scenario.flight;
        let since = time_s - self.middle_s;
        let azimuth = flight.azimuth_deg.to_radians();
        let ahead = |angle: f64| Vector3::new(angle.cos(), angle.sin(), 0.0);
        // Looking down with the top of the image ahead: x right, y back, z down.
        let looking = |angle: f64, tilt: f64| {
            let level = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(
                nalgebra::Matrix3::from_columns(&[
                    ahead(angle - std::f64::consts::FRAC_PI_2),
                    -ahead(angle),
                    -Vector3::z(),
                ]),
            ));
            level * exp(&(Vector3::x() * tilt))
        };
        let high = Vector3::z() * (self.ground_m + flight.altitude_m);
        let tilt = flight.tilt_deg.to_radians();
        // So far back that it looks at the middle of the scene.
        let back = -ahead(azimuth) * (flight.altitude_m * tilt.tan());
        let (place, look) = match flight.course {
            Course::Hover => (high + back, looking(azimuth, tilt)),
            Course::Straight { speed_mps, direction_deg } => (
                high + back + ahead(direction_deg.to_radians()) * (speed_mps * since),
                looking(azimuth, tilt),
            ),
            Course::Orbit { radius_m, turn_dps } => {
                let angle = azimuth + turn_dps.to_radians() * since;
                let tilt = (radius_m / flight.altitude_m).atan();
                (high - ahead(angle) * radius_m, looking(angle, tilt))
            }
            Course::Follow => {
                let at = |t: f64| {
                    let [x, y, _] = self.followed.map_or([[0.0; 2]; 3], |path| path.at(t));
                    Vector3::new(x[0], y[0], 0.0)
                };
                (high + back + at(time_s), looking(azimuth, tilt))
            }
        };
        let turn = values(&self.sway, time_s) + self.vibration[frame];
        Pose::from_parts((place + values(&self.drift, time_s)).into(), look * exp(&turn))
    }
}

/// A vehicle at any time.
struct Ride<'w> {
    settings: &'w VehicleSettings,
    path: &'w PlanPath,
    /// Height, roll and pitch over the ground.
    bumps: [Curve; 3],
    /// Beside the path.
    side: Curve,
    bias_m: f64,
}

impl Ride<'_> {
    fn pose(&self, world: &World, time_s: f64) -> Result<Pose, NoGround> {
        let [mut x, mut y, heading] = self.path.at(time_s);
        let (side_m, (sin, cos)) = (self.side.at(time_s)[0], heading[0].sin_cos());
        let ahead_m = -self.settings.rear_axle_m;
        x[0] += cos * ahead_m - sin * side_m;
        y[0] += sin * ahead_m + cos * side_m;
        // A body does not turn at once at the border of a cell.
        let ground = world.terrain.at(x[0], y[0])?;
        let ground = world.terrain.footing_at(x[0], y[0]).unwrap_or(ground);
        let [height, mut roll, mut pitch] = [0, 1, 2].map(|k| self.bumps[k].at(time_s)[0]);
        let h = 0.5 * FINE as f64 / world.scenario.video.rate_hz;
        let speed = |t: f64| {
            let [x, y, heading] = self.path.at(t);
            x[1] * heading[0].cos() + y[1] * heading[0].sin()
        };
        let ahead = (speed(time_s + h) - speed(time_s - h)) / (2.0 * h);
        let across = speed(time_s) * heading[1];
        // The nose goes up (turning about y to the left is down) and the body leans outwards.
        pitch -= (self.settings.pitch_by_acceleration * ahead).to_radians();
        roll += (self.settings.roll_by_acceleration * across).to_radians();
        let normal = Unit::new_normalize(ground.normal());
        let upright = UnitQuaternion::rotation_between_axis(&Vector3::z_axis(), &normal)
            .unwrap_or(UnitQuaternion::identity());
        let place = Vector3::new(x[0], y[0], ground.height_m + self.bias_m + height);
        let turn = upright * exp(&(Vector3::z() * heading[0])) * exp(&Vector3::new(roll, pitch, 0.0));
        Ok(Pose::from_parts(place.into(), turn))
    }
}

/// What errors of a run are drawn.
struct Errors {
    /// The run whose paths these are.
    run: u64,
    /// 0 where nothing is measured wrongly.
    on: f64,
}

impl Errors {
    /// Run 0 of the exact video has paths of its own: truth is one draw of many.
    fn of(chance: Chance) -> Errors {
        match chance {
            Chance::Exact => Errors { run: 0, on: 0.0 },
            Chance::Run(run) => Errors { run: run + 1, on: 1.0 },
        }
    }
}

/// What is true of the camera and of the ground.
struct TrueNumbers {
    camera: Camera,
    readout_s: f64,
    bias_m: f64,
}

/// What is recorded of vehicles, one for each.
#[derive(Default)]
struct Recorded {
    vehicles: Vec<Vehicle>,
    truth: Vec<VehicleEstimate>,
    velocities: Vec<Vec<Vector3<f64>>>,
    gross: Vec<GrossError>,
    wrong_tracks: Vec<BTreeMap<String, WrongKind>>,
    references: Vec<Vec<GnssPosition>>,
    receivers: Vec<Received>,
}

impl World {
    /// The video of a run. The error says where the ground ends.
    pub fn video(&self, chance: Chance) -> Result<SimulatedVideo, Findings> {
        let errors = Errors::of(chance);
        let really = self.true_numbers(&errors);
        let paths = self.paths(&errors);
        let rides = self.rides(&errors, &paths, really.bias_m);
        let drone = self.drone(&errors, paths.first())?;
        let frames = 0..self.scenario.video.frames;
        let cameras: Vec<Pose> = frames.map(|frame| drone.pose(frame, self.time_s(frame))).collect();
        let seen = |frame: usize, place: &Place<'_>| self.pixel(&drone, &really, frame, place);
        let mut recorded = Recorded::default();
        for (at, ride) in rides.iter().enumerate() {
            self.record_vehicle(at, ride, &errors, &cameras, &seen, &mut recorded)?;
        }
        if errors.on > 0.0 {
            self.record_wrong_tracks(&errors, &cameras, &seen, &mut recorded);
        }
        let (targets, target_observations, of_targets) = self.target_sights(&errors, &seen);
        recorded.gross.extend(of_targets);
        let mut problem = self.problem(&errors, &cameras);
        (problem.targets, problem.target_observations) = (targets, target_observations);
        problem.vehicles = recorded.vehicles;
        problem.receivers = recorded.receivers.iter().map(|(receiver, _)| receiver.clone()).collect();
        let truth = Estimate {
            camera_poses: cameras,
            vehicles: recorded.truth,
            targets: self.targets.iter().copied().map(Some).collect(),
            terrain_bias_m: if self.scenario.terrain.is_known { really.bias_m } else { 0.0 },
            camera: really.camera,
            readout_s: really.readout_s,
            receivers: recorded.receivers.into_iter().map(|(_, found)| found).collect(),
        };
        let Recorded { velocities, gross, wrong_tracks, references, .. } = recorded;
        Ok(SimulatedVideo { problem, truth, velocities, gross, wrong_tracks, references })
    }

    /// The terrain as the problem has it: as it is, or as a grid was measured.
    fn known_terrain(&self, errors: &Errors) -> Terrain {
        let Some(MeasuredGrid { cell_m, noise_m, reach_m }) = self.scenario.terrain.measured else {
            return self.terrain.clone();
        };
        let half = (reach_m / cell_m).ceil() as usize;
        let (count, first_m) = (2 * half + 1, -(half as f64) * cell_m);
        let (mut noise, digit_m) = (self.rng(errors, Purpose::Terrain, 0), 10_f64.powi(-GRID_DIGITS));
        let height = |at: usize| {
            let [x, y] = [at % count, at / count].map(|k| first_m + k as f64 * cell_m);
            let off_m = normal(&mut noise) * noise_m * errors.on;
            let true_m = self.terrain.at(x, y).map_or(f64::NAN, |ground| ground.height_m);
            // As it is written.
            ((true_m + off_m) / digit_m).round() * digit_m
        };
        let heights = (0..count * count).map(height).collect();
        match Grid::new([first_m; 2], [cell_m; 2], [count; 2], heights) {
            Ok(grid) => Terrain::Grid(Arc::new(grid)),
            // It has no height anywhere.
            Err(_) => self.terrain.clone(),
        }
    }

    fn rng(&self, errors: &Errors, purpose: Purpose, thing: usize) -> ChaCha8Rng {
        stream(self.seed, errors.run, purpose, thing)
    }

    fn time_s(&self, frame: usize) -> f64 {
        frame as f64 / self.scenario.video.rate_hz
    }

    fn middle_s(&self) -> f64 {
        0.5 * self.time_s(self.scenario.video.frames - 1)
    }

    /// Times of what wanders, so many to each frame.
    fn times(&self, each: usize) -> Times {
        Times::of_video(self.scenario.video.frames, self.scenario.video.rate_hz, each)
    }

    fn true_numbers(&self, errors: &Errors) -> TrueNumbers {
        let Scenario { terrain, camera, errors: settings, .. } = &self.scenario;
        let mut knowledge = self.rng(errors, Purpose::Knowledge, 0);
        let bias_m = normal(&mut knowledge) * terrain.bias_sigma_m * settings.really.terrain;
        let readout_error_s = normal(&mut knowledge) * camera.readout_sigma_s;
        TrueNumbers {
            camera: self.true_camera(errors),
            readout_s: camera.readout_s + errors.on * readout_error_s,
            bias_m,
        }
    }

    /// Where vehicles drive.
    fn paths(&self, errors: &Errors) -> Vec<PlanPath> {
        let path = |(at, (settings, tracked)): (usize, (&VehicleSettings, &Tracked))| {
            let wanders = [settings.wander_m, settings.yaw_wander_deg.to_radians()];
            let [along, yaw] = [0, 1].map(|k| {
                let mut rng = self.rng(errors, Purpose::VehiclePath, 2 * at + k);
                wander(&mut rng, wanders[k], settings.wander_s, self.times(1))
            });
            PlanPath::new(settings, &tracked.rows, self.times(FINE), [&along, &yaw], self.middle_s())
        };
        self.scenario.vehicles.iter().zip(&self.vehicles).enumerate().map(path).collect()
    }

    /// How they ride along their paths.
    fn rides<'w>(&'w self, errors: &Errors, paths: &'w [PlanPath], bias_m: f64) -> Vec<Ride<'w>> {
        let (terrain, times) = (&self.scenario.terrain, self.times(1));
        let tilt = terrain.tilt_sigma_deg.to_radians();
        let sigmas = [terrain.sigma_m, tilt, tilt].map(|sigma| sigma * self.scenario.errors.really.terrain);
        let ride = |(at, (settings, path)): (usize, (&'w VehicleSettings, &'w PlanPath))| {
            let bumps = [0, 1, 2].map(|k| {
                let mut rng = self.rng(errors, Purpose::Ride, 3 * at + k);
                wander(&mut rng, sigmas[k], terrain.correlation_s, times)
            });
            let mut beside = self.rng(errors, Purpose::Beside, at);
            let side = wander(&mut beside, settings.side_wander_m, settings.wander_s, times);
            Ride { settings, path, bumps, side, bias_m }
        };
        self.scenario.vehicles.iter().zip(paths).enumerate().map(ride).collect()
    }

    fn drone<'w>(&'w self, errors: &Errors, followed: Option<&'w PlanPath>) -> Result<Drone<'w>, Findings> {
        let (scenario, flight) = (&self.scenario, &self.scenario.flight);
        let ground =
            self.terrain.at(0.0, 0.0).map_err(|e| no_ground(scenario, "the scene", &e.to_string()))?;
        let mut rng = self.rng(errors, Purpose::CameraPath, 0);
        Ok(Drone {
            scenario,
            ground_m: ground.height_m,
            drift: wanders(&mut rng, flight.drift_m, flight.drift_s, self.times(1)),
            sway: wanders(&mut rng, flight.sway_deg.to_radians(), flight.sway_s, self.times(1)),
            vibration: (0..scenario.video.frames)
                .map(|_| normal3(&mut rng) * flight.vibration_deg.to_radians())
                .collect(),
            followed,
            middle_s: self.middle_s(),
        })
    }

    /// An image point is seen at the time of its row.
    fn pixel(
        &self,
        drone: &Drone<'_>,
        really: &TrueNumbers,
        frame: usize,
        place: &Place<'_>,
    ) -> Option<Vector2<f64>> {
        let mut row_s = 0.0_f64;
        for _ in 0..ROW_STEPS {
            let at = self.time_s(frame) + row_s;
            let in_camera = drone.pose(frame, at).inverse_transform_point(&place(at)?);
            let found = really.camera.project(&in_camera.coords)?;
            let next_s = really.camera.row_delay(found.y) * really.readout_s;
            if (next_s - row_s).abs() < ROW_TOLERANCE_S {
                return self.scenario.camera.camera.contains(&found).then_some(found);
            }
            row_s = next_s;
        }
        None
    }

    fn record_vehicle(
        &self,
        at: usize,
        ride: &Ride<'_>,
        errors: &Errors,
        cameras: &[Pose],
        seen: &Seen<'_>,
        recorded: &mut Recorded,
    ) -> Result<(), Findings> {
        let (scenario, settings) = (&self.scenario, &self.scenario.vehicles[at]);
        let frames = 0..scenario.video.frames;
        let off_ground =
            |e: NoGround| no_ground(scenario, &format!("{} on its way", settings.id), &e.to_string());
        let poses: Result<Vec<Pose>, _> =
            frames.clone().map(|frame| ride.pose(self, self.time_s(frame))).collect();
        let poses = poses.map_err(off_ground)?;
        let sights = self.sights(errors, &View { vehicle: at, ride, poses: &poses, cameras, seen });
        let marker = self.vehicles[at].body.marker;
        let step = 1e-3 / scenario.video.rate_hz;
        let velocity = |frame: usize| {
            let [before, after] =
                [-step, step].map(|h| ride.pose(self, self.time_s(frame) + h).map(|pose| pose * marker));
            Ok((after? - before?) / (2.0 * step))
        };
        recorded.velocities.push(frames.map(velocity).collect::<Result<_, _>>().map_err(off_ground)?);
        let vehicle = self.vehicle(at, errors, &poses, &sights);
        let (received, reference) = self.received(at, errors, &|t| Some(ride.pose(self, t).ok()? * marker));
        recorded.references.push(reference);
        if let (Some((receiver, truth)), Some(point)) = (received, vehicle.marker) {
            recorded.receivers.push((Receiver { vehicle: at, point, ..receiver }, truth));
        }
        recorded.truth.push(VehicleEstimate {
            poses: poses.into_iter().map(Some).collect(),
            depths: vec![Depth::Known; sights.points.len()],
            points: sights.points.iter().map(|(_, place)| Some(*place)).collect(),
            motion: None,
            axle: [0.0; 2],
            axes_sigma_rad: 0.0,
            heading_turned: 0.0,
            left_out: None,
        });
        recorded.vehicles.push(Vehicle { observations: sights.observations, ..vehicle });
        recorded.gross.extend(sights.gross);
        recorded.wrong_tracks.push(sights.wrong_tracks);
        Ok(())
    }

    /// Adds to each vehicle the tracks beside those of its body.
    fn record_wrong_tracks(
        &self,
        errors: &Errors,
        cameras: &[Pose],
        seen: &Seen<'_>,
        recorded: &mut Recorded,
    ) {
        for at in 0..recorded.vehicles.len() {
            let other = (recorded.vehicles.len() > 1).then(|| (at + 1) % recorded.vehicles.len());
            let poses = |vehicle: usize| recorded.truth[vehicle].poses.iter().flatten();
            let moments =
                cameras.iter().zip(poses(at)).enumerate().map(|(frame, (camera, vehicle))| Moment {
                    camera,
                    vehicle,
                    other: other.and_then(|other| recorded.truth[other].poses[frame].as_ref()),
                });
            let around = Surroundings {
                seed: self.seed,
                run: errors.run,
                vehicle: at,
                tracks: recorded.vehicles[at].points.len(),
                rate_hz: self.scenario.video.rate_hz,
                errors: &self.scenario.errors,
                body: &self.vehicles[at].body,
                other: other.map(|other| &self.vehicles[other].body),
                camera: &self.scenario.camera.camera,
                terrain: &self.terrain,
                moments: moments.collect(),
            };
            let tracks = around.tracks();
            let rows = self.rows_of_wrong_tracks(errors, &around, &tracks, seen);
            let vehicle = &mut recorded.vehicles[at];
            let (first, sigma_px) = (vehicle.points.len(), self.scenario.errors.vehicle_px);
            for Sight { frame, track, image_px, .. } in rows {
                let observation = VehicleObservation { frame, point: first + track, image_px, sigma_px };
                vehicle.observations.push(observation);
                recorded.gross.push((frame as i64, Some(at), tracks[track].id.clone()));
            }
            vehicle.observations.sort_by_key(|o| (o.frame, o.point));
            let points = tracks.iter().map(|track| ShapePoint { id: track.id.clone(), known: [None; 3] });
            vehicle.points.extend(points);
            let truth = &mut recorded.truth[at];
            truth.points.resize(vehicle.points.len(), None);
            truth.depths.resize(vehicle.points.len(), Depth::Known);
            recorded.wrong_tracks[at].extend(tracks.iter().map(|track| (track.id.clone(), track.kind)));
        }
    }

    /// The image points of wrong tracks. What moves is where it is at the time of the frame.
    fn rows_of_wrong_tracks(
        &self,
        errors: &Errors,
        around: &Surroundings<'_>,
        tracks: &[WrongTrack],
        seen: &Seen<'_>,
    ) -> Vec<Sight> {
        let of = &self.scenario.errors;
        let mut rows = Vec::new();
        let kinds = [WrongKind::Static, WrongKind::Sliding, WrongKind::Foreign];
        for kind in kinds {
            let mut noise = around.noise(kind);
            for (track, wrong) in tracks.iter().enumerate().filter(|(_, track)| track.kind == kind) {
                for (frame, place) in &wrong.places {
                    let off = white(&mut noise) * (of.vehicle_px * of.really.vehicle_px * errors.on);
                    let in_world = around.in_world(*frame, place);
                    let Some(pixel) = seen(*frame, &|_| in_world) else { continue };
                    rows.push(Sight { frame: *frame, track, image_px: pixel + off, is_gross: true });
                }
            }
        }
        rows
    }

    /// What the problem says of a vehicle, but for its image points.
    fn vehicle(&self, at: usize, errors: &Errors, poses: &[Pose], sights: &Sights) -> Vehicle {
        let settings = &self.scenario.vehicles[at];
        let mut sightings = vec![0; sights.points.len()];
        sights.observations.iter().for_each(|o| sightings[o.point] += 1);
        let marker = sights.points.iter().position(|(id, _)| id == super::MARKER);
        let body = KnownBody { points: &sights.points, sightings: &sightings, marker };
        let mut chance = self.rng(errors, Purpose::Knowledge, 1 + at);
        // Streams of their own: where lengths are measured is of the plan, how wrongly is chance.
        let mut plan = stream(self.seed, 0, Purpose::Knowledge, BETWEEN_POINTS + at);
        let mut wrong = self.rng(errors, Purpose::Knowledge, BETWEEN_POINTS + at);
        let heights = errors.on * self.scenario.errors.really.height;
        let known = settings.knowledge.of_heights(&body, &mut chance, heights);
        let known = settings.knowledge.between_points(known, &body, &mut plan, &mut wrong, errors.on);
        Vehicle {
            id: settings.id.clone(),
            marker: marker.filter(|_| settings.knowledge.names_marker),
            is_car: settings.is_car,
            poses: self.given(poses, &self.scenario.poses[1], errors, Purpose::VehiclePoses, at, true),
            poses_are_measured: self.scenario.poses[1].given == Given::Measured,
            ..known
        }
    }

    /// What the problem says, but for what is on the ground.
    fn problem(&self, errors: &Errors, cameras: &[Pose]) -> Problem {
        let Scenario { camera, terrain, poses: [camera_poses, vehicle_poses], .. } = &self.scenario;
        let frame = |at: usize| Frame { number: at as i64, time_s: self.time_s(at) };
        Problem {
            name: self.scenario.name.clone(),
            camera: camera.camera.clone(),
            calibration: camera.calibration,
            shutter: Shutter {
                readout_s: camera.readout_s,
                freedom: match camera.readout_sigma_s {
                    0.0 => Freedom::Fixed,
                    sigma_s => Freedom::Prior(sigma_s),
                },
            },
            frames: (0..self.scenario.video.frames).map(frame).collect(),
            camera_poses: self.given(cameras, camera_poses, errors, Purpose::CameraPoses, 0, false),
            camera_pose_sigma: pose_sigma(camera_poses, 1.0),
            targets: Vec::new(),
            target_observations: Vec::new(),
            vehicles: Vec::new(),
            vehicle_pose_sigma: pose_sigma(vehicle_poses, 0.5),
            ground: terrain.is_known.then(|| GroundKnowledge {
                terrain: self.known_terrain(errors),
                sigma_m: terrain.sigma_m,
                correlation_s: Some(terrain.correlation_s),
                bias_sigma_m: terrain.bias_sigma_m,
                tilt_sigma_rad: terrain.tilt_sigma_deg.to_radians(),
            }),
            receivers: Vec::new(),
            video: None,
        }
    }

    /// The camera as it really is.
    fn true_camera(&self, errors: &Errors) -> Camera {
        let settings = &self.scenario.errors;
        let mut rng = self.rng(errors, Purpose::Calibration, 0);
        let mut camera = self.scenario.camera.camera.clone();
        let [focal, x, y] = std::array::from_fn(|_| errors.on * normal(&mut rng));
        camera.focal_px *= 1.0 + settings.focal * focal;
        camera.principal_px += Vector2::new(x, y) * settings.principal_px;
        camera
    }

    /// Poses as the problem gives them. Vehicles err about z twice as much as about x and y.
    fn given(
        &self,
        poses: &[Pose],
        settings: &PoseSettings,
        errors: &Errors,
        purpose: Purpose,
        thing: usize,
        is_level: bool,
    ) -> Vec<Option<Pose>> {
        if settings.given == Given::Nothing {
            return vec![None; poses.len()];
        }
        if settings.given == Given::Exact {
            return poses.iter().copied().map(Some).collect();
        }
        let video = &self.scenario.video;
        let mut rng = stream(self.seed, errors.run, purpose, thing);
        let times = Times::of_video(poses.len(), video.rate_hz, 1);
        let shifts = wanders(&mut rng, settings.slow_m, settings.slow_s, times);
        let turns = wanders(&mut rng, settings.slow_deg.to_radians(), settings.slow_s, times);
        let about = if is_level { Vector3::new(0.5, 0.5, 1.0) } else { Vector3::repeat(1.0) };
        let of_frame = |(frame, pose): (usize, &Pose)| {
            let t = frame as f64 / video.rate_hz;
            let shift = values(&shifts, t) + normal3(&mut rng) * settings.white_m;
            let turn = values(&turns, t) + normal3(&mut rng) * settings.white_deg.to_radians();
            let turn = about.component_mul(&turn) * errors.on;
            Some(Pose::from_parts(
                (pose.translation.vector + shift * errors.on).into(),
                pose.rotation * exp(&turn),
            ))
        };
        poses.iter().enumerate().map(of_frame).collect()
    }

    fn target_sights(
        &self,
        errors: &Errors,
        seen: &Seen<'_>,
    ) -> (Vec<Target>, Vec<TargetObservation>, Vec<GrossError>) {
        let scenario = &self.scenario;
        let (settings, of) = (&scenario.targets, &scenario.errors);
        let mut survey = stream(self.seed, errors.run, Purpose::Survey, 0);
        let first_check = settings.count - settings.check;
        let target = |(at, place): (usize, &Point3<f64>)| {
            let error = normal3(&mut survey) * (settings.sigma_m * of.really.survey * errors.on);
            let known = |axis: usize| Known { value_m: place[axis] + error[axis], sigma_m: settings.sigma_m };
            Target {
                id: format!("T{at:03}"),
                known: [0, 1, 2].map(|axis| Some(known(axis))),
                role: if at < first_check { Role::Control } else { Role::Check },
            }
        };
        let targets: Vec<Target> = self.targets.iter().enumerate().map(target).collect();
        let mut images = stream(self.seed, errors.run, Purpose::TargetImages, 0);
        let mut chance = stream(self.seed, errors.run, Purpose::Gross, usize::MAX >> 1);
        let (mut observations, mut gross) = (Vec::new(), Vec::new());
        for frame in 0..scenario.video.frames {
            for (target, place) in self.targets.iter().enumerate() {
                let Some(pixel) = seen(frame, &|_| Some(*place)) else { continue };
                let noise = white(&mut images) * (of.target_px * of.really.target_px * errors.on);
                let mut image_px = pixel + noise;
                let (draw, off) = (chance.random::<f64>(), gross_px(&mut chance, of.gross_px));
                if draw < of.gross_targets {
                    if errors.on == 0.0 {
                        continue;
                    }
                    image_px += off;
                    gross.push((frame as i64, None, targets[target].id.clone()));
                }
                observations.push(TargetObservation { frame, target, image_px, sigma_px: of.target_px });
            }
        }
        (targets, observations, gross)
    }

    /// What a receiver on a vehicle measures: as observations with what is true of it, or to compare with.
    fn received(
        &self,
        vehicle: usize,
        errors: &Errors,
        place: &Place<'_>,
    ) -> (Option<Received>, Vec<GnssPosition>) {
        let Some(gnss) = &self.scenario.gnss else { return (None, Vec::new()) };
        let video = &self.scenario.video;
        let mut rng = stream(self.seed, errors.run, Purpose::Gnss, vehicle);
        let clock_error_s = normal(&mut rng) * gnss.clock_sigma_s.unwrap_or(0.0) * errors.on;
        let offset_s = gnss.clock_offset_s + clock_error_s;
        let shift_m = normal3(&mut rng) * (gnss.shift_sigma_m * errors.on);
        let last_s = (video.frames - 1) as f64 / video.rate_hz;
        let mut positions = Vec::new();
        let mut k = 0_u32;
        loop {
            // Not in step with the frames.
            let t = (f64::from(k) + 0.37) / gnss.rate_hz;
            if t > last_s {
                break;
            }
            let noise = normal3(&mut rng) * (gnss.sigma_m * errors.on);
            if let Some(place) = place(t) {
                positions.push((t, place + shift_m + noise));
            }
            k += 1;
        }
        let sigma_m = [gnss.sigma_m; 3];
        if !gnss.is_observation {
            let row = |(t, position): (f64, Point3<f64>)| GnssPosition {
                time_s: t + offset_s,
                position,
                velocity_mps: None,
                sigma_m: sigma_m.map(Some),
            };
            return (None, positions.into_iter().map(row).collect());
        }
        let row =
            |(t, position): (f64, Point3<f64>)| ReceivedPosition { time_s: t + offset_s, position, sigma_m };
        let knowledge = ReceiverKnowledge {
            clock_offset: gnss
                .clock_sigma_s
                .map(|sigma_s| KnownTime { value_s: gnss.clock_offset_s, sigma_s }),
            shift_sigma_m: gnss.shift_sigma_m,
            ..ReceiverKnowledge::default()
        };
        let positions = positions.into_iter().map(row).collect();
        let truth = ReceiverEstimate { clock_offset_s: offset_s, shift_m, ..ReceiverEstimate::default() };
        (Some((Receiver { vehicle, point: 0, positions, knowledge }, truth)), Vec::new())
    }
}

/// What is seen of a vehicle.
struct Sights {
    /// Ids and places of the points, sorted by id.
    points: Vec<(String, Point3<f64>)>,
    observations: Vec<VehicleObservation>,
    gross: Vec<GrossError>,
    wrong_tracks: BTreeMap<String, WrongKind>,
}

/// A vehicle before the camera.
struct View<'a> {
    vehicle: usize,
    ride: &'a Ride<'a>,
    poses: &'a [Pose],
    cameras: &'a [Pose],
    seen: &'a Seen<'a>,
}

/// An image point of a track.
struct Sight {
    frame: usize,
    track: usize,
    image_px: Vector2<f64>,
    is_gross: bool,
}

impl World {
    fn sights(&self, errors: &Errors, view: &View<'_>) -> Sights {
        let vehicle = view.vehicle;
        let tracks = &self.vehicles[vehicle].tracks;
        // Which tracks go wrong, and where to, is chance; which image points are missing is not.
        let mut chance = self.rng(errors, Purpose::Gross, vehicle);
        let fates: Vec<Fate> =
            tracks.iter().map(|track| self.fate(track, tracks, view.poses, &mut chance)).collect();
        let mut rows = self.image_points(errors, view, &fates, &mut chance);
        if errors.on == 0.0 {
            rows.retain(|row| !row.is_gross);
        }
        // Points that are seen in one frame have no place.
        let mut sightings = vec![0_usize; tracks.len()];
        rows.iter().for_each(|row| sightings[row.track] += 1);
        let mut order: Vec<usize> = (0..tracks.len()).filter(|at| sightings[*at] >= 2).collect();
        order.sort_by(|a, b| tracks[*a].id.cmp(&tracks[*b].id));
        let mut index = vec![None; tracks.len()];
        order.iter().enumerate().for_each(|(to, at)| index[*at] = Some(to));
        let sigma_px = self.scenario.errors.vehicle_px;
        let (mut observations, mut gross) = (Vec::new(), Vec::new());
        for Sight { frame, track, image_px, is_gross } in rows {
            let Some(point) = index[track] else { continue };
            if is_gross {
                gross.push((frame as i64, Some(vehicle), tracks[track].id.clone()));
            }
            observations.push(VehicleObservation { frame, point, image_px, sigma_px });
        }
        observations.sort_by_key(|o| (o.frame, o.point));
        let points = order.iter().map(|at| (tracks[*at].id.clone(), tracks[*at].place)).collect();
        let wrong = tracks.iter().zip(&fates).filter_map(|(track, fate)| {
            let kind = match fate {
                Fate::Good => return None,
                Fate::Ground(_) => WrongKind::Ground,
                Fate::Swapped(..) => WrongKind::Swapped,
            };
            Some((track.id.clone(), kind))
        });
        let wrong_tracks = wrong.collect();
        Sights { points, observations, gross, wrong_tracks }
    }

    fn fate(&self, track: &Track, tracks: &[Track], poses: &[Pose], chance: &mut ChaCha8Rng) -> Fate {
        let of = &self.scenario.errors;
        let (draw, x, y): (f64, f64, f64) =
            (chance.random(), chance.random_range(-3.0..3.0), chance.random_range(-3.0..3.0));
        let at = chance.random_range(track.frames.clone());
        let on_ground = || {
            let place = poses[at].translation.vector;
            let (x, y) = (place.x + x, place.y + y);
            let z = self.terrain.at(x, y).map_or(place.z, |ground| ground.height_m);
            Fate::Ground(Point3::new(x, y, z))
        };
        match draw {
            // The marker is painted on, and stays.
            _ if track.id == super::MARKER => Fate::Good,
            draw if draw < of.ground_tracks => on_ground(),
            draw if draw < of.ground_tracks + of.swapped_tracks => {
                let other = chance.random_range(0..tracks.len());
                Fate::Swapped(other, track.frames.start + (track.frames.len()) / 2)
            }
            _ => Fate::Good,
        }
    }

    /// All image points of a vehicle, frame by frame; `chance` has drawn the fates of its tracks.
    fn image_points(
        &self,
        errors: &Errors,
        view: &View<'_>,
        fates: &[Fate],
        chance: &mut ChaCha8Rng,
    ) -> Vec<Sight> {
        let View { vehicle, ride, poses, cameras, seen } = *view;
        let (settings, of) = (&self.scenario.vehicles[vehicle], &self.scenario.errors);
        let tracks = &self.vehicles[vehicle].tracks;
        let least_cosine = settings.grazing_deg.to_radians().cos();
        let mut images = self.rng(errors, Purpose::VehicleImages, vehicle);
        let mut missing = stream(self.seed, 2, Purpose::Tracks, vehicle);
        let mut rows = Vec::new();
        for frame in 0..poses.len() {
            for (at, track) in tracks.iter().enumerate().filter(|(_, track)| track.frames.contains(&frame)) {
                let is_missing = missing.random::<f64>() < settings.dropout;
                let noise = white(&mut images) * (of.vehicle_px * of.really.vehicle_px * errors.on);
                let (draw, off) = (chance.random::<f64>(), gross_px(chance, of.gross_px));
                let (on, is_other) = match fates[at] {
                    Fate::Swapped(other, from) if frame >= from => (&tracks[other], true),
                    _ => (track, false),
                };
                let (place, normal) = (on.place, on.normal);
                let of_body = || {
                    let (in_world, faces) = (poses[frame] * place, poses[frame].rotation * normal);
                    let to_camera = cameras[frame].translation.vector - in_world.coords;
                    let is_seen = faces.dot(&to_camera.normalize()) > least_cosine;
                    let at_time = |t: f64| Some(ride.pose(self, t).ok()? * place);
                    if is_seen { seen(frame, &at_time) } else { None }
                };
                let (pixel, is_wrong) = match fates[at] {
                    Fate::Ground(place) => (seen(frame, &|_| Some(place)), true),
                    _ => (of_body(), is_other),
                };
                let Some(pixel) = pixel.filter(|_| !is_missing) else { continue };
                let is_single = draw < of.gross;
                let image_px = pixel + noise + if is_single { off } else { Vector2::zeros() };
                rows.push(Sight { frame, track: at, image_px, is_gross: is_wrong || is_single });
            }
        }
        rows
    }
}

/// What becomes of a track.
#[derive(Clone, Copy)]
enum Fate {
    Good,
    /// It is of this place on the road.
    Ground(Point3<f64>),
    /// From this frame on it is of another point.
    Swapped(usize, usize),
}

fn white(rng: &mut ChaCha8Rng) -> Vector2<f64> {
    let (u, v) = (normal(rng), normal(rng));
    Vector2::new(u, v)
}

/// A gross error: of any direction.
fn gross_px(rng: &mut ChaCha8Rng, [from, to]: [f64; 2]) -> Vector2<f64> {
    let (angle, size): (f64, f64) =
        (rng.random_range(0.0..std::f64::consts::TAU), rng.random_range(from..to));
    Vector2::new(angle.cos(), angle.sin()) * size
}

/// What the problem says of its poses; `level_share` of the standard deviation about z goes for x and y.
fn pose_sigma(settings: &PoseSettings, level_share: f64) -> PoseSigma {
    match settings.given {
        Given::Exact => PoseSigma { position_m: Some(0.0), rotation_rad: [Some(0.0); 3] },
        Given::Start | Given::Nothing => PoseSigma { position_m: None, rotation_rad: [None; 3] },
        Given::Known | Given::Measured => {
            let turn = settings.white_deg.hypot(settings.slow_deg).to_radians().max(1e-6);
            PoseSigma {
                position_m: Some(settings.white_m.hypot(settings.slow_m).max(LEAST_KNOWN_M)),
                rotation_rad: [Some(level_share * turn), Some(level_share * turn), Some(turn)],
            }
        }
    }
}
