//! A problem folder: read whole, validated whole, then made into a [`Problem`].

use super::problem_toml::{self, Settings};
use super::rows::{
    CameraPoseRow, FrameRow, GnssObservationRow, KnownPointRow, TargetObservationRow, TargetRow,
    VehicleObservationRow, VehiclePoseRow,
};
use crate::geometry::{self, Pose};
use crate::problem::{
    Frame, Known, Problem, Role, ShapePoint, Target, TargetObservation, Vehicle, VehicleObservation,
};
use crate::tables::{self, Finding, Findings, Line, Row};
use nalgebra::{Vector2, Vector4};
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

/// A problem folder that is valid.
#[derive(Debug)]
pub struct Folder {
    /// What is there.
    pub inventory: Inventory,
    /// The problem, or what it needs that this version does not compute.
    pub problem: Result<Problem, Vec<String>>,
    /// What is odd.
    pub warnings: Vec<String>,
}

/// What is in a problem folder.
#[derive(Clone, Debug)]
pub struct Inventory {
    /// Name of the problem.
    pub name: String,
    /// How many frames.
    pub frames: usize,
    /// First and last video time \[s\].
    pub time_s: [f64; 2],
    /// Width and height of the image \[px\].
    pub size_px: [u32; 2],
    /// How many frames have a camera pose.
    pub camera_poses: usize,
    /// The vehicles.
    pub vehicles: Vec<VehicleInventory>,
    /// The targets.
    pub targets: TargetInventory,
}

/// What there is of a vehicle.
#[derive(Clone, Debug)]
pub struct VehicleInventory {
    /// Its id.
    pub id: String,
    /// Its marker.
    pub marker: Option<String>,
    /// How many points.
    pub points: usize,
    /// How many of them in one frame only.
    pub single_frame_points: usize,
    /// How many image points.
    pub observations: usize,
    /// Numbers of the first and last frame in which it is seen.
    pub span: Option<[i64; 2]>,
    /// In how many frames it is seen.
    pub frames: usize,
    /// Shortest, median and longest number of frames of a point.
    pub track_lengths: [usize; 3],
    /// How many frames have a starting pose.
    pub poses: usize,
    /// How many coordinates of its points are known beforehand.
    pub known_coordinates: usize,
    /// Whether its height is known.
    pub has_height: bool,
}

/// What there is of the static world.
#[derive(Clone, Debug, Default)]
pub struct TargetInventory {
    /// Surveyed targets that are adjusted to.
    pub control: usize,
    /// Targets that are compared with.
    pub check: usize,
    /// Points without known coordinates.
    pub tie: usize,
    /// How many image points.
    pub observations: usize,
    /// Fewest, median and most control targets in a frame.
    pub control_per_frame: [usize; 3],
}

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

struct Reader<'a> {
    folder: &'a Path,
    findings: Findings,
}

type Rows<R> = Option<Vec<Line<R>>>;

/// The tables as they stand; `None` where a file is not there or is no table.
struct Tables {
    settings: Option<Settings>,
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

impl Reader<'_> {
    fn read_tables(&mut self) -> Tables {
        Tables {
            settings: self.read_settings(),
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
        let (settings, findings) = problem_toml::parse(text.trim_start_matches('\u{feff}'));
        self.findings.append(findings);
        for named in settings.iter().flat_map(|s| &s.files) {
            if !self.folder.join(named).is_file() {
                self.findings.error(Finding::of_file(named, "the file that problem.toml names", "nothing"));
            }
        }
        settings
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
        self.check_gnss(tables, &index, &vehicle_observations);

        let settings = tables.settings.as_ref()?;
        let frame_rows = tables.frames.as_ref()?;
        for vehicle in &settings.vehicles {
            if let Some((marker, line)) = &vehicle.marker
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
            frames: frame_rows.iter().map(|l| Frame { number: l.row.frame, time_s: l.row.time_s }).collect(),
            frame_index: index.frames,
            vehicle_index: index.vehicles?,
            camera_poses,
            targets,
            target_observations,
            vehicle_observations: vehicle_observations.rows,
            vehicle_poses,
            has_vehicle_poses: tables.vehicle_poses.is_some(),
            known_points,
            has_gnss: tables.gnss.is_some(),
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
        for Line { row, .. } in tables.frames.iter().flatten() {
            if index.frames.get(&row.frame).is_some_and(|frame| !poses.contains_key(frame)) {
                let wanted = format!("a pose of frame {} (gaps are not filled by resection yet)", row.frame);
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
                None | Some("" | "control") => Role::Control,
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
            let (image_px, sigma_px) = pixels.check(*line, row.u, row.v, row.sigma_px.0);
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
            let (image_px, sigma_px) = pixels.check(*line, row.u, row.v, row.sigma_px.0);
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
        for (vehicle, frame) in missing {
            let wanted = format!("a pose of {vehicle} in frame {frame}, where it is seen");
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

    fn check_gnss(&mut self, tables: &Tables, index: &Index, observed: &Observed) {
        let mut seen = HashSet::new();
        for Line { line, row } in tables.gnss.iter().flatten() {
            self.vehicle(GNSS_OBSERVATIONS, *line, &row.vehicle, index);
            if tables.vehicle_observations.is_some() && !observed.points.contains(&(&row.vehicle, &row.point))
            {
                self.cell(GNSS_OBSERVATIONS, *line, "point", "a point that is observed", &row.point);
            }
            if !seen.insert((&row.vehicle, &row.point, row.time_s.to_bits())) {
                self.cell(GNSS_OBSERVATIONS, *line, "time_s", "a time that is listed once", row.time_s);
            }
        }
    }
}

/// Where declared ids stand.
struct Index<'a> {
    frames: HashMap<i64, usize>,
    /// `None` where problem.toml could not be read, so that nothing can be said.
    vehicles: Option<HashMap<&'a str, usize>>,
}

fn positions<'a>(ids: &[&'a str]) -> HashMap<&'a str, usize> {
    ids.iter().enumerate().map(|(at, id)| (*id, at)).collect()
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

struct ObservedRow<'t> {
    vehicle: usize,
    frame: usize,
    point: &'t str,
    image_px: Vector2<f64>,
    sigma_px: f64,
}

/// Image points of a table: their standard deviation, and what is odd about them.
struct Pixels<'a> {
    file: &'a str,
    settings: Option<&'a Settings>,
    default_px: f64,
    outside: usize,
    first_outside: u64,
    exact: usize,
}

impl<'a> Pixels<'a> {
    fn new(file: &'a str, settings: Option<&'a Settings>, default: impl Fn(&Settings) -> f64) -> Self {
        let default_px = settings.map_or(1.0, default);
        Pixels { file, settings, default_px, outside: 0, first_outside: 0, exact: 0 }
    }

    fn check(&mut self, line: u64, u: f64, v: f64, sigma_px: Option<f64>) -> (Vector2<f64>, f64) {
        let image_px = Vector2::new(u, v);
        if self.settings.is_some_and(|s| !s.camera.contains(&image_px)) {
            if self.outside == 0 {
                self.first_outside = line;
            }
            self.outside += 1;
        }
        let sigma_px = sigma_px.unwrap_or(self.default_px);
        self.exact += usize::from(sigma_px == 0.0);
        (image_px, sigma_px.max(LEAST_SIGMA_PX))
    }

    fn warn(&self, findings: &mut Findings) {
        let Pixels { file, outside, first_outside, exact, .. } = self;
        if *outside > 0 {
            findings.warn(format!(
                "{file}: image points outside the image: {outside}, the first on line {first_outside}"
            ));
        }
        if *exact > 0 {
            findings.warn(format!(
                "{file}: image points with a sigma of 0 px: {exact}; {LEAST_SIGMA_PX} px is assumed"
            ));
        }
    }
}

/// Tables that fit each other, as far as there are no findings.
struct Checked<'t> {
    settings: &'t Settings,
    frames: Vec<Frame>,
    frame_index: HashMap<i64, usize>,
    vehicle_index: HashMap<&'t str, usize>,
    camera_poses: HashMap<usize, Pose>,
    targets: Vec<Target>,
    target_observations: Vec<TargetObservation>,
    vehicle_observations: Vec<ObservedRow<'t>>,
    vehicle_poses: HashMap<(usize, usize), Pose>,
    has_vehicle_poses: bool,
    known_points: HashMap<(usize, &'t str), [Option<Known>; 3]>,
    has_gnss: bool,
}

impl Checked<'_> {
    fn into_folder(self, findings: Findings) -> Folder {
        debug_assert_eq!(self.frame_index.len(), self.frames.len());
        debug_assert_eq!(self.vehicle_index.len(), self.settings.vehicles.len());
        let vehicles = self.vehicles();
        let inventory = self.inventory(&vehicles);
        let mut not_supported = self.settings.not_supported.clone();
        let without_pose = self.frames.len() - self.camera_poses.len();
        if without_pose > 0 {
            not_supported.push(format!("spatial resection ({without_pose} frames have no camera pose)"));
        }
        if !self.has_vehicle_poses {
            not_supported.push(
                "vehicle poses from ray-terrain intersection (there is no vehicle_poses.csv)".to_owned(),
            );
        }
        if self.has_gnss {
            not_supported.push("GNSS positions as observations (observations/gnss.csv)".to_owned());
        }
        let warnings = findings.warnings().to_vec();
        if !not_supported.is_empty() {
            return Folder { inventory, problem: Err(not_supported), warnings };
        }
        let problem = Problem {
            name: self.settings.name.clone(),
            camera: self.settings.camera.clone(),
            camera_poses: (0..self.frames.len()).map(|frame| self.camera_poses[&frame]).collect(),
            frames: self.frames,
            camera_pose_sigma: self.settings.camera_pose_sigma,
            targets: self.targets,
            target_observations: self.target_observations,
            vehicles,
            vehicle_pose_sigma: self.settings.vehicle_pose_sigma,
            ground: self.settings.ground,
        };
        Folder { inventory, problem: Ok(problem), warnings }
    }

    fn vehicles(&self) -> Vec<Vehicle> {
        let mut point_ids: Vec<BTreeSet<&str>> = vec![BTreeSet::new(); self.settings.vehicles.len()];
        for row in &self.vehicle_observations {
            point_ids[row.vehicle].insert(row.point);
        }
        let mut vehicles: Vec<Vehicle> = Vec::new();
        let mut indices = Vec::new();
        for (at, (settings, ids)) in self.settings.vehicles.iter().zip(&point_ids).enumerate() {
            let index = positions(&ids.iter().copied().collect::<Vec<_>>());
            let shape_point = |id: &&str| ShapePoint {
                id: (*id).to_owned(),
                known: self.known_points.get(&(at, *id)).copied().unwrap_or_default(),
            };
            vehicles.push(Vehicle {
                id: settings.id.clone(),
                marker: settings.marker.as_ref().and_then(|(id, _)| index.get(id.as_str()).copied()),
                height: settings.height,
                points: ids.iter().map(shape_point).collect(),
                observations: Vec::new(),
                poses: (0..self.frames.len())
                    .map(|frame| self.vehicle_poses.get(&(at, frame)).copied())
                    .collect(),
            });
            indices.push(index);
        }
        for ObservedRow { vehicle, frame, point, image_px, sigma_px } in &self.vehicle_observations {
            let point = indices[*vehicle][*point];
            let (frame, image_px, sigma_px) = (*frame, *image_px, *sigma_px);
            vehicles[*vehicle].observations.push(VehicleObservation { frame, point, image_px, sigma_px });
        }
        for vehicle in &mut vehicles {
            vehicle.observations.sort_by_key(|o| (o.frame, o.point));
        }
        vehicles
    }

    fn inventory(&self, vehicles: &[Vehicle]) -> Inventory {
        let number = |frame: usize| self.frames[frame].number;
        let of_vehicle = |vehicle: &Vehicle| {
            let sightings = vehicle.sightings();
            let frames: BTreeSet<usize> = vehicle.observations.iter().map(|o| o.frame).collect();
            let known = |point: &ShapePoint| point.known.iter().flatten().count();
            VehicleInventory {
                id: vehicle.id.clone(),
                marker: vehicle.marker.map(|point| vehicle.points[point].id.clone()),
                points: vehicle.points.len(),
                single_frame_points: sightings.iter().filter(|count| **count < 2).count(),
                observations: vehicle.observations.len(),
                span: frames.first().zip(frames.last()).map(|(a, b)| [number(*a), number(*b)]),
                frames: frames.len(),
                track_lengths: spread(sightings),
                poses: vehicle.poses.iter().flatten().count(),
                known_coordinates: vehicle.points.iter().map(known).sum(),
                has_height: vehicle.height.is_some(),
            }
        };
        let is_control = |t: &Target| t.role == Role::Control && t.known.iter().any(Option::is_some);
        let mut control_per_frame = vec![0; self.frames.len()];
        for observation in &self.target_observations {
            control_per_frame[observation.frame] +=
                usize::from(is_control(&self.targets[observation.target]));
        }
        let check = self.targets.iter().filter(|t| t.role == Role::Check).count();
        let control = self.targets.iter().filter(|t| is_control(t)).count();
        Inventory {
            name: self.settings.name.clone(),
            frames: self.frames.len(),
            time_s: [self.frames[0].time_s, self.frames[self.frames.len() - 1].time_s],
            size_px: self.settings.camera.size_px,
            camera_poses: self.camera_poses.len(),
            vehicles: vehicles.iter().map(of_vehicle).collect(),
            targets: TargetInventory {
                control,
                check,
                tie: self.targets.len() - control - check,
                observations: self.target_observations.len(),
                control_per_frame: spread(control_per_frame),
            },
        }
    }
}

/// Smallest, median and largest; zeros where there is none.
fn spread(mut counts: Vec<usize>) -> [usize; 3] {
    counts.sort_unstable();
    match counts.as_slice() {
        [] => [0; 3],
        [first, ..] => [*first, counts[counts.len() / 2], counts[counts.len() - 1]],
    }
}
