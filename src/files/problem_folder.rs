//! A problem folder: read whole, validated whole, then made into a [`Problem`].

use super::checked::{Checked, Folder, ObservedRow, positions};
use super::problem_toml::{self, Settings, TerrainSettings};
use super::rows::{
    CameraPoseRow, FrameRow, GnssObservationRow, KnownPointRow, TargetObservationRow, TargetRow,
    VehicleObservationRow, VehiclePoseRow,
};
use super::video;
use crate::geometry::{self, Pose};
use crate::problem::{
    Frame, GroundKnowledge, Known, ReceivedPosition, Role, Target, TargetObservation, Video,
};
use crate::tables::{self, Finding, Findings, Line, Row};
use crate::terrain::{GridFault, Terrain};
use nalgebra::{Point3, Vector2, Vector4};
use std::collections::{BTreeSet, HashMap, HashSet};
use std::path::Path;

/// A quaternion may be off unit length by this much.
const UNIT_TOLERANCE: f64 = 1e-6;
/// An image point of standard deviation zero is taken as this good \[px\]: nothing measured is exact.
const LEAST_SIGMA_PX: f64 = 1e-3;
/// Standard deviation of a coordinate of a target that is given without one \[m\].
const TARGET_SIGMA_M: f64 = 0.02;
/// Standard deviation of a coordinate of a shape point that is given without one \[m\].
const POINT_SIGMA_M: f64 = 0.1;
/// Standard deviation of a coordinate of a GNSS position that is given without one \[m\].
const GNSS_SIGMA_M: f64 = 0.02;
/// No position is better than this \[m\].
const LEAST_GNSS_SIGMA_M: f64 = 1e-4;

/// Control targets with three coordinates from which a camera pose can be resected.
const LEAST_CONTROL: usize = 3;

/// Reads and validates a problem folder. The error holds everything that is wrong with it.
pub fn read_problem(folder: &Path) -> Result<Folder, Findings> {
    let mut reader = Reader { folder, findings: Findings::default() };
    let tables = reader.read_tables();
    let checked = reader.check(&tables);
    match checked {
        Some(checked) if !reader.findings.is_invalid() => Ok(checked.into_folder(reader.findings)),
        _ => Err(reader.findings),
    }
}

/// Reads the grid of heights in a file of a folder, of which `wanted` says what it is.
pub fn read_grid(folder: &Path, file: &str, wanted: &str) -> Result<Terrain, Findings> {
    let bytes = std::fs::read(folder.join(file))
        .map_err(|error| Findings::from(Finding::of_file(file, wanted, &error.to_string())))?;
    Terrain::read_grid(file, &bytes).map_err(|faults| {
        let mut findings = Findings::default();
        for GridFault { line, column, wanted, found } in faults {
            findings.error(Finding { file: file.to_owned(), line, column, wanted, found });
        }
        findings
    })
}

/// Whether frames without a camera pose can get one from targets.
fn can_resect(targets: Option<&[Line<TargetRow>]>) -> bool {
    let is_control = |row: &TargetRow| {
        row.role.as_deref() != Some("check") && [row.x, row.y, row.z].iter().all(Option::is_some)
    };
    targets.unwrap_or_default().iter().filter(|line| is_control(&line.row)).count() >= LEAST_CONTROL
}

struct Reader<'a> {
    folder: &'a Path,
    findings: Findings,
}

type Rows<R> = Option<Vec<Line<R>>>;

/// The tables as they stand; `None` where a file is not there or is no table.
struct Tables {
    settings: Option<Settings>,
    ground: Option<GroundKnowledge>,
    frames: Rows<FrameRow>,
    camera_poses: Rows<CameraPoseRow>,
    targets: Rows<TargetRow>,
    target_observations: Rows<TargetObservationRow>,
    vehicle_observations: Rows<VehicleObservationRow>,
    vehicle_poses: Rows<VehiclePoseRow>,
    known_points: Rows<KnownPointRow>,
    gnss: Rows<GnssObservationRow>,
}

const FRAMES: &str = "frames.csv";
const CAMERA_POSES: &str = "camera_poses.csv";
const TARGETS: &str = "targets.csv";
const TARGET_OBSERVATIONS: &str = "target_observations.csv";
const VEHICLE_OBSERVATIONS: &str = "vehicle_observations.csv";
const VEHICLE_POSES: &str = "vehicle_poses.csv";
const VEHICLE_POINTS: &str = "vehicle_points.csv";
const GNSS_OBSERVATIONS: &str = "observations/gnss.csv";
/// All of them.
pub const TABLES: [&str; 8] = [
    FRAMES,
    CAMERA_POSES,
    TARGETS,
    TARGET_OBSERVATIONS,
    VEHICLE_OBSERVATIONS,
    VEHICLE_POSES,
    VEHICLE_POINTS,
    GNSS_OBSERVATIONS,
];

impl Reader<'_> {
    fn read_tables(&mut self) -> Tables {
        let settings = self.read_settings();
        Tables {
            ground: settings.as_ref().and_then(|settings| self.read_ground(settings)),
            settings,
            frames: tables::read(self.folder, FRAMES, &mut self.findings),
            camera_poses: self.read_if_there(CAMERA_POSES),
            targets: self.read_if_there(TARGETS),
            target_observations: self.read_if_there(TARGET_OBSERVATIONS),
            vehicle_observations: tables::read(self.folder, VEHICLE_OBSERVATIONS, &mut self.findings),
            vehicle_poses: self.read_if_there(VEHICLE_POSES),
            known_points: self.read_if_there(VEHICLE_POINTS),
            gnss: self.read_if_there(GNSS_OBSERVATIONS),
        }
    }

    fn is_there(&self, file: &str) -> bool {
        std::fs::symlink_metadata(self.folder.join(file)).is_ok()
    }

    fn read_if_there<R: Row>(&mut self, file: &str) -> Rows<R> {
        if self.is_there(file) { tables::read(self.folder, file, &mut self.findings) } else { None }
    }

    fn read_settings(&mut self) -> Option<Settings> {
        let file = problem_toml::FILE;
        let text = match std::fs::read(self.folder.join(file)).map(String::from_utf8) {
            Ok(Ok(text)) => text,
            Ok(Err(error)) => {
                self.findings.error(Finding::of_file(file, "UTF-8 text", &error.utf8_error().to_string()));
                return None;
            }
            Err(error) => {
                self.findings.error(Finding::of_file(file, "a file that can be read", &error.to_string()));
                return None;
            }
        };
        let (settings, findings) = problem_toml::parse(&text);
        self.findings.append(findings);
        settings
    }

    /// The ground with its terrain; where it cannot be read there are findings.
    fn read_ground(&mut self, settings: &Settings) -> Option<GroundKnowledge> {
        let ground = settings.ground.as_ref()?;
        let file = match &ground.terrain {
            TerrainSettings::Plane(z_m) => return Some(ground.with(Terrain::Plane { z_m: *z_m })),
            TerrainSettings::Grid(file) => file,
        };
        match read_grid(self.folder, file, "the terrain grid that problem.toml names") {
            Ok(terrain) => Some(ground.with(terrain)),
            Err(findings) => {
                self.findings.append(findings);
                None
            }
        }
    }

    /// Checks the tables against each other; `None` where so much is missing that there is nothing
    /// to check against, and then there are findings.
    fn check<'t>(&mut self, tables: &'t Tables) -> Option<Checked<'t>> {
        let frames = self.check_frames(tables.frames.as_deref());
        let vehicle_ids: Option<Vec<&str>> =
            tables.settings.as_ref().map(|s| s.vehicles.iter().map(|v| v.id.as_str()).collect());
        let index = Index { frames, vehicles: vehicle_ids.map(|ids| positions(&ids)) };

        let camera_poses = self.check_camera_poses(tables, &index);
        let targets = self.check_targets(tables.targets.as_deref());
        let target_observations = self.check_target_observations(tables, &index, &targets);
        let vehicle_observations = self.check_vehicle_observations(tables, &index);
        let vehicle_poses = self.check_vehicle_poses(tables, &index);
        let known_points = self.check_known_points(tables, &index, &vehicle_observations);
        let received = self.check_gnss(tables, &index, &vehicle_observations);
        let video = self.check_video(tables);

        let settings = tables.settings.as_ref()?;
        let frame_rows = tables.frames.as_ref()?;
        for vehicle in &settings.vehicles {
            // A vehicle that is never seen is left out, with its marker.
            let is_seen = vehicle_observations.points.iter().any(|(id, _)| *id == vehicle.id);
            if let Some((marker, line)) = &vehicle.marker
                && is_seen
                && !vehicle_observations.points.contains(&(vehicle.id.as_str(), marker.as_str()))
            {
                let wanted = "a point that is observed";
                self.findings.error(Finding::of_cell(
                    problem_toml::FILE,
                    *line,
                    "vehicle.marker",
                    wanted,
                    marker,
                ));
            }
        }
        Some(Checked {
            settings,
            ground: tables.ground.clone(),
            frames: frame_rows.iter().map(|l| Frame { number: l.row.frame, time_s: l.row.time_s }).collect(),
            camera_poses,
            targets,
            target_observations,
            vehicle_observations: vehicle_observations.rows,
            vehicle_poses,
            has_vehicle_poses: tables.vehicle_poses.is_some(),
            known_points,
            received,
            video,
        })
    }

    fn cell(&mut self, file: &str, line: u64, column: &str, wanted: &str, found: impl ToString) {
        self.findings.error(Finding::of_cell(file, line, column, wanted, &found.to_string()));
    }

    fn check_frames(&mut self, rows: Option<&[Line<FrameRow>]>) -> HashMap<i64, usize> {
        let mut index = HashMap::new();
        let Some(rows) = rows else { return index };
        let mut last_time = f64::NEG_INFINITY;
        for (at, Line { line, row }) in rows.iter().enumerate() {
            if index.insert(row.frame, at).is_some() {
                self.cell(FRAMES, *line, "frame", "a frame that is listed once", row.frame);
            }
            if row.time_s <= last_time {
                let wanted = format!("a time after {last_time}");
                self.cell(FRAMES, *line, "time_s", &wanted, row.time_s);
            }
            last_time = row.time_s;
        }
        if rows.is_empty() && !self.findings.is_invalid() {
            self.findings.error(Finding::of_file(FRAMES, "at least one frame", "none"));
        }
        index
    }

    /// Index of a declared frame.
    fn frame(&mut self, file: &str, line: u64, frame: i64, index: &Index) -> Option<usize> {
        let found = index.frames.get(&frame).copied();
        if found.is_none() && !index.frames.is_empty() {
            self.cell(file, line, "frame", "a frame of frames.csv", frame);
        }
        found
    }

    /// Index of a declared vehicle.
    fn vehicle(&mut self, file: &str, line: u64, id: &str, index: &Index) -> Option<usize> {
        let vehicles = index.vehicles.as_ref()?;
        let found = vehicles.get(id).copied();
        if found.is_none() {
            self.cell(file, line, "vehicle", "a vehicle of problem.toml", id);
        }
        found
    }

    fn pose(&mut self, file: &str, line: u64, position: [f64; 3], quaternion: [f64; 4]) -> Pose {
        let norm = Vector4::from(quaternion).norm();
        if (norm - 1.0).abs() > UNIT_TOLERANCE {
            self.cell(file, line, "qw,qx,qy,qz", "a quaternion of length 1", format!("length {norm}"));
        }
        geometry::pose(position, quaternion)
    }

    fn check_camera_poses(&mut self, tables: &Tables, index: &Index) -> HashMap<usize, Pose> {
        let mut poses = HashMap::new();
        let Some(rows) = &tables.camera_poses else {
            if !self.is_there(CAMERA_POSES) && !self.is_there(TARGETS) {
                let wanted = "camera poses, or targets.csv to resect from";
                self.findings.error(Finding::of_file(CAMERA_POSES, wanted, "neither"));
            }
            return poses;
        };
        for Line { line, row } in rows {
            let pose =
                self.pose(CAMERA_POSES, *line, [row.x, row.y, row.z], [row.qw, row.qx, row.qy, row.qz]);
            let Some(frame) = self.frame(CAMERA_POSES, *line, row.frame, index) else { continue };
            if poses.insert(frame, pose).is_some() {
                self.cell(CAMERA_POSES, *line, "frame", "a frame that has one pose", row.frame);
            }
        }
        if can_resect(tables.targets.as_deref()) {
            return poses;
        }
        for Line { row, .. } in tables.frames.iter().flatten() {
            if index.frames.get(&row.frame).is_some_and(|frame| !poses.contains_key(frame)) {
                let wanted = format!(
                    "a pose of frame {} (there are not {LEAST_CONTROL} control targets to resect it from)",
                    row.frame
                );
                self.findings.error(Finding::of_file(CAMERA_POSES, &wanted, "none"));
            }
        }
        poses
    }

    fn check_targets(&mut self, rows: Option<&[Line<TargetRow>]>) -> Vec<Target> {
        let mut targets: Vec<Target> = Vec::new();
        let mut ids = HashSet::new();
        let mut without_sigma = 0;
        for Line { line, row } in rows.unwrap_or_default() {
            if !ids.insert(row.target.as_str()) {
                self.cell(TARGETS, *line, "target", "a target that is listed once", &row.target);
            }
            let role = match row.role.as_deref() {
                None | Some("control") => Role::Control,
                Some("check") => Role::Check,
                Some(other) => {
                    self.cell(TARGETS, *line, "role", "control or check", other);
                    Role::Control
                }
            };
            let sigmas = [row.sigma_x.0, row.sigma_y.0, row.sigma_z.0];
            let known = known([row.x, row.y, row.z], sigmas, TARGET_SIGMA_M, &mut without_sigma);
            targets.push(Target { id: row.target.clone(), known, role });
        }
        if without_sigma > 0 {
            self.findings.warn(format!(
                "{TARGETS}: coordinates without a sigma: {without_sigma}; {TARGET_SIGMA_M} m is assumed"
            ));
        }
        targets.sort_by(|a, b| a.id.cmp(&b.id));
        targets
    }

    fn check_target_observations(
        &mut self,
        tables: &Tables,
        index: &Index,
        targets: &[Target],
    ) -> Vec<TargetObservation> {
        if self.is_there(TARGETS) && !self.is_there(TARGET_OBSERVATIONS) {
            let wanted = "the image points of targets.csv";
            self.findings.error(Finding::of_file(TARGET_OBSERVATIONS, wanted, "nothing"));
        }
        if self.is_there(TARGET_OBSERVATIONS) && !self.is_there(TARGETS) {
            let wanted = "the targets of target_observations.csv";
            self.findings.error(Finding::of_file(TARGETS, wanted, "nothing"));
            return Vec::new();
        }
        let ids = positions(&targets.iter().map(|t| t.id.as_str()).collect::<Vec<_>>());
        let mut pixels = Pixels::new(TARGET_OBSERVATIONS, tables.settings.as_ref(), |s| s.target_px);
        let mut observations = Vec::new();
        let mut seen = HashSet::new();
        for Line { line, row } in tables.target_observations.iter().flatten() {
            let target = ids.get(row.target.as_str()).copied();
            if target.is_none() && tables.targets.is_some() {
                self.cell(TARGET_OBSERVATIONS, *line, "target", "a target of targets.csv", &row.target);
            }
            let frame = self.frame(TARGET_OBSERVATIONS, *line, row.frame, index);
            let (Some(frame), Some(target)) = (frame, target) else { continue };
            if !seen.insert((frame, target)) {
                let found = format!("{} twice in frame {}", row.target, row.frame);
                self.cell(TARGET_OBSERVATIONS, *line, "target", "a target once in a frame", found);
            }
            let Some((image_px, sigma_px)) = pixels.check(*line, row.u, row.v, row.sigma_px.0) else {
                continue;
            };
            observations.push(TargetObservation { frame, target, image_px, sigma_px });
        }
        pixels.warn(&mut self.findings);
        let seen_ids: HashSet<usize> = observations.iter().map(|o| o.target).collect();
        let never = targets.iter().enumerate().filter(|(at, _)| !seen_ids.contains(at));
        let never: Vec<&str> = never.map(|(_, target)| target.id.as_str()).collect();
        if !never.is_empty() && !self.findings.is_invalid() {
            self.findings.warn(format!("{TARGETS}: never seen: {}", never.join(", ")));
        }
        observations.sort_by_key(|o| (o.frame, o.target));
        observations
    }

    fn check_vehicle_observations<'t>(&mut self, tables: &'t Tables, index: &Index) -> Observed<'t> {
        let mut pixels = Pixels::new(VEHICLE_OBSERVATIONS, tables.settings.as_ref(), |s| s.vehicle_px);
        let mut observed = Observed::default();
        let mut seen = HashSet::new();
        for Line { line, row } in tables.vehicle_observations.iter().flatten() {
            observed.points.insert((&row.vehicle, &row.point));
            let frame = self.frame(VEHICLE_OBSERVATIONS, *line, row.frame, index);
            let vehicle = self.vehicle(VEHICLE_OBSERVATIONS, *line, &row.vehicle, index);
            let (Some(frame), Some(vehicle)) = (frame, vehicle) else { continue };
            if !seen.insert((frame, vehicle, row.point.as_str())) {
                let found = format!("{} twice in frame {}", row.point, row.frame);
                self.cell(VEHICLE_OBSERVATIONS, *line, "point", "a point once in a frame", found);
            }
            let Some((image_px, sigma_px)) = pixels.check(*line, row.u, row.v, row.sigma_px.0) else {
                continue;
            };
            observed.rows.push(ObservedRow { vehicle, frame, point: &row.point, image_px, sigma_px });
        }
        pixels.warn(&mut self.findings);
        observed
    }

    fn check_vehicle_poses(&mut self, tables: &Tables, index: &Index) -> HashMap<(usize, usize), Pose> {
        let mut poses = HashMap::new();
        let Some(rows) = &tables.vehicle_poses else { return poses };
        for Line { line, row } in rows {
            let pose =
                self.pose(VEHICLE_POSES, *line, [row.x, row.y, row.z], [row.qw, row.qx, row.qy, row.qz]);
            let frame = self.frame(VEHICLE_POSES, *line, row.frame, index);
            let vehicle = self.vehicle(VEHICLE_POSES, *line, &row.vehicle, index);
            let (Some(frame), Some(vehicle)) = (frame, vehicle) else { continue };
            if poses.insert((vehicle, frame), pose).is_some() {
                let found = format!("{} twice in frame {}", row.vehicle, row.frame);
                self.cell(VEHICLE_POSES, *line, "vehicle", "a vehicle once in a frame", found);
            }
        }
        let mut missing = BTreeSet::new();
        for Line { row, .. } in tables.vehicle_observations.iter().flatten() {
            let frame = index.frames.get(&row.frame);
            let vehicle = index.vehicles.as_ref().and_then(|v| v.get(row.vehicle.as_str()));
            if let (Some(frame), Some(vehicle)) = (frame, vehicle)
                && !poses.contains_key(&(*vehicle, *frame))
            {
                missing.insert((row.vehicle.as_str(), row.frame));
            }
        }
        let has_ground = tables.settings.as_ref().is_none_or(|settings| settings.ground.is_some());
        if has_ground && !missing.is_empty() {
            self.findings.warn(format!(
                "{VEHICLE_POSES}: poses that are missing where a vehicle is seen, and are found on the terrain: {}",
                missing.len()
            ));
            return poses;
        }
        for (vehicle, frame) in missing {
            let wanted = format!("a pose of {vehicle} in frame {frame}, where it is seen (or a terrain)");
            self.findings.error(Finding::of_file(VEHICLE_POSES, &wanted, "none"));
        }
        poses
    }

    fn check_known_points<'t>(
        &mut self,
        tables: &'t Tables,
        index: &Index,
        observed: &Observed,
    ) -> HashMap<(usize, &'t str), [Option<Known>; 3]> {
        let mut points = HashMap::new();
        let mut without_sigma = 0;
        for Line { line, row } in tables.known_points.iter().flatten() {
            let Some(vehicle) = self.vehicle(VEHICLE_POINTS, *line, &row.vehicle, index) else { continue };
            if tables.vehicle_observations.is_some() && !observed.points.contains(&(&row.vehicle, &row.point))
            {
                self.cell(VEHICLE_POINTS, *line, "point", "a point that is observed", &row.point);
            }
            let sigmas = [row.sigma_x.0, row.sigma_y.0, row.sigma_z.0];
            let known = known([row.x, row.y, row.z], sigmas, POINT_SIGMA_M, &mut without_sigma);
            if points.insert((vehicle, row.point.as_str()), known).is_some() {
                self.cell(VEHICLE_POINTS, *line, "point", "a point that is listed once", &row.point);
            }
        }
        if without_sigma > 0 {
            self.findings.warn(format!(
                "{VEHICLE_POINTS}: coordinates without a sigma: {without_sigma}; {POINT_SIGMA_M} m is assumed"
            ));
        }
        points
    }

    fn check_gnss<'t>(
        &mut self,
        tables: &'t Tables,
        index: &Index,
        observed: &Observed,
    ) -> Vec<(usize, &'t str, ReceivedPosition)> {
        let mut seen = HashSet::new();
        let mut received = Vec::new();
        let mut without_sigma = 0;
        for Line { line, row } in tables.gnss.iter().flatten() {
            let vehicle = self.vehicle(GNSS_OBSERVATIONS, *line, &row.vehicle, index);
            if tables.vehicle_observations.is_some() && !observed.points.contains(&(&row.vehicle, &row.point))
            {
                self.cell(GNSS_OBSERVATIONS, *line, "point", "a point that is observed", &row.point);
            }
            if !seen.insert((&row.vehicle, &row.point, row.time_s.to_bits())) {
                self.cell(GNSS_OBSERVATIONS, *line, "time_s", "a time that is listed once", row.time_s);
            }
            let Some(vehicle) = vehicle else { continue };
            let sigma_m = [row.sigma_x.0, row.sigma_y.0, row.sigma_z.0].map(|sigma| {
                without_sigma += usize::from(sigma.is_none());
                sigma.unwrap_or(GNSS_SIGMA_M).max(LEAST_GNSS_SIGMA_M)
            });
            let position = Point3::new(row.x, row.y, row.z);
            let (time_s, point) = (row.time_s, row.point.as_str());
            received.push((vehicle, point, ReceivedPosition { time_s, position, sigma_m }));
        }
        if without_sigma > 0 {
            self.findings.warn(format!(
                "{GNSS_OBSERVATIONS}: coordinates without a sigma: {without_sigma}; {GNSS_SIGMA_M} m is assumed"
            ));
        }
        received
    }

    fn check_video(&mut self, tables: &Tables) -> Option<Video> {
        let settings = tables.settings.as_ref()?;
        let video = settings.video.as_ref()?;
        // Rows that are wrong are left out: then it is not known which frames there are.
        let is_whole = self.findings.errors().all(|finding| finding.file != FRAMES);
        let rows = tables.frames.as_ref().filter(|_| is_whole);
        let frames: Option<Vec<i64>> = rows.map(|rows| rows.iter().map(|line| line.row.frame).collect());
        video::read(self.folder, video, settings.camera.size_px, frames.as_deref(), &mut self.findings)
    }
}

/// Where declared ids stand.
struct Index<'a> {
    frames: HashMap<i64, usize>,
    /// `None` where problem.toml could not be read, so that nothing can be said.
    vehicles: Option<HashMap<&'a str, usize>>,
}

fn known(
    coordinates: [Option<f64>; 3],
    sigmas: [Option<f64>; 3],
    default_m: f64,
    without: &mut usize,
) -> [Option<Known>; 3] {
    std::array::from_fn(|axis| {
        let value_m = coordinates[axis]?;
        if sigmas[axis].is_none() {
            *without += 1;
        }
        Some(Known { value_m, sigma_m: sigmas[axis].unwrap_or(default_m) })
    })
}

#[derive(Default)]
struct Observed<'t> {
    /// Vehicle and point of every row, whatever else is wrong with it.
    points: HashSet<(&'t str, &'t str)>,
    rows: Vec<ObservedRow<'t>>,
}

/// Image points of a table: their standard deviation, and what is odd about them.
struct Pixels<'a> {
    file: &'a str,
    settings: Option<&'a Settings>,
    default_px: f64,
    outside: Tally,
    without_ray: Tally,
    exact: Tally,
}

/// How many, and the line of the first.
#[derive(Default)]
struct Tally {
    count: usize,
    first_line: u64,
}

impl Tally {
    fn count(&mut self, line: u64) {
        if self.count == 0 {
            self.first_line = line;
        }
        self.count += 1;
    }
}

impl<'a> Pixels<'a> {
    fn new(file: &'a str, settings: Option<&'a Settings>, default: impl Fn(&Settings) -> f64) -> Self {
        let default_px = settings.map_or(1.0, default);
        let [outside, without_ray, exact] = Default::default();
        Pixels { file, settings, default_px, outside, without_ray, exact }
    }

    /// An image point and its standard deviation; `None` where the lens model has no ray for it.
    fn check(&mut self, line: u64, u: f64, v: f64, sigma_px: Option<f64>) -> Option<(Vector2<f64>, f64)> {
        let image_px = Vector2::new(u, v);
        if let Some(Settings { camera, .. }) = self.settings {
            if !camera.contains(&image_px) {
                self.outside.count(line);
            }
            if camera.ray(&image_px).is_none() {
                self.without_ray.count(line);
                return None;
            }
        }
        let sigma_px = sigma_px.unwrap_or(self.default_px);
        if sigma_px == 0.0 {
            self.exact.count(line);
        }
        Some((image_px, sigma_px.max(LEAST_SIGMA_PX)))
    }

    fn warn(&self, findings: &mut Findings) {
        let Pixels { file, outside, without_ray, exact, .. } = self;
        let mut warn = |what: &str, Tally { count, first_line }: &Tally| {
            if *count > 0 {
                findings
                    .warn(format!("{file}: image points {what}: {count}, the first on line {first_line}"));
            }
        };
        warn("outside the image", outside);
        warn("beyond the fold of the lens model, which are left out", without_ray);
        warn(&format!("with a sigma of 0 px, for which {LEAST_SIGMA_PX} px is assumed"), exact);
    }
}
