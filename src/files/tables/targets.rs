//! `targets.csv` and `target_observations.csv`: the static world.

use super::super::cells::{number_sigma, pixels};
use super::Tables;
use super::reading::{Index, Pixels, Reader, known, positions, spread};
use crate::problem::{Problem, Role, Target, TargetObservation};
use crate::tables::{Finding, Line, Sigma, input_row, written};
use std::collections::HashSet;

/// Name of the file of targets.
pub const FILE: &str = "targets.csv";
/// Name of that of their image points.
pub const OBSERVATIONS: &str = "target_observations.csv";

/// Standard deviation of a coordinate of a target that is given without one \[m\].
const SIGMA_M: f64 = 0.02;
/// Control targets with three coordinates from which a camera pose can be resected.
pub const LEAST_CONTROL: usize = 3;

input_row!(
    /// `targets.csv`: points of the static world in its frame.
    TargetRow {
        required target: String,
        required x: Option<f64>, required y: Option<f64>, required z: Option<f64>,
        required sigma_x: Sigma, required sigma_y: Sigma, required sigma_z: Sigma,
        optional role: Option<String>,
    }
);

input_row!(
    /// `target_observations.csv`.
    TargetObservationRow {
        required frame: i64, required target: String,
        required u: f64, required v: f64,
        optional sigma_px: Sigma,
    }
);

/// Whether frames without a camera pose can get one from targets.
pub fn can_resect(targets: Option<&[Line<TargetRow>]>) -> bool {
    let is_control = |row: &TargetRow| {
        row.role.as_deref() != Some("check") && [row.x, row.y, row.z].iter().all(Option::is_some)
    };
    targets.unwrap_or_default().iter().filter(|line| is_control(&line.row)).count() >= LEAST_CONTROL
}

/// The targets, sorted by id.
pub fn check(reader: &mut Reader, rows: Option<&[Line<TargetRow>]>) -> Vec<Target> {
    let mut targets: Vec<Target> = Vec::new();
    let mut ids = HashSet::new();
    let mut without_sigma = 0;
    for Line { line, row } in rows.unwrap_or_default() {
        if !ids.insert(row.target.as_str()) {
            reader.cell(FILE, *line, "target", "a target that is listed once", &row.target);
        }
        let role = match row.role.as_deref() {
            None | Some("control") => Role::Control,
            Some("check") => Role::Check,
            Some(other) => {
                reader.cell(FILE, *line, "role", "control or check", other);
                Role::Control
            }
        };
        let sigmas = [row.sigma_x.0, row.sigma_y.0, row.sigma_z.0];
        let known = known([row.x, row.y, row.z], sigmas, SIGMA_M, &mut without_sigma);
        targets.push(Target { id: row.target.clone(), known, role });
    }
    if without_sigma > 0 {
        reader
            .findings
            .warn(format!("{FILE}: coordinates without a sigma: {without_sigma}; {SIGMA_M} m is assumed"));
    }
    targets.sort_by(|a, b| a.id.cmp(&b.id));
    targets
}

/// Their image points, sorted by frame and target.
pub fn check_observations(
    reader: &mut Reader,
    tables: &Tables,
    index: &Index,
    targets: &[Target],
) -> Vec<TargetObservation> {
    if reader.is_there(FILE) && !reader.is_there(OBSERVATIONS) {
        let wanted = "the image points of targets.csv";
        reader.findings.error(Finding::of_file(OBSERVATIONS, wanted, "nothing"));
    }
    if reader.is_there(OBSERVATIONS) && !reader.is_there(FILE) {
        let wanted = "the targets of target_observations.csv";
        reader.findings.error(Finding::of_file(FILE, wanted, "nothing"));
        return Vec::new();
    }
    let ids = positions(&targets.iter().map(|t| t.id.as_str()).collect::<Vec<_>>());
    let mut pixels = Pixels::new(OBSERVATIONS, tables.settings.as_ref(), |s| s.target_px);
    let mut observations = Vec::new();
    let mut seen = HashSet::new();
    for Line { line, row } in tables.target_observations.iter().flatten() {
        let target = ids.get(row.target.as_str()).copied();
        if target.is_none() && tables.targets.is_some() {
            reader.cell(OBSERVATIONS, *line, "target", "a target of targets.csv", &row.target);
        }
        let frame = reader.frame(OBSERVATIONS, *line, row.frame, index);
        let (Some(frame), Some(target)) = (frame, target) else { continue };
        if !seen.insert((frame, target)) {
            let found = format!("{} twice in frame {}", row.target, row.frame);
            reader.cell(OBSERVATIONS, *line, "target", "a target once in a frame", found);
        }
        let Some((image_px, sigma_px)) = pixels.check(*line, row.u, row.v, row.sigma_px.0) else {
            continue;
        };
        observations.push(TargetObservation { frame, target, image_px, sigma_px });
    }
    pixels.warn(&mut reader.findings);
    let seen_ids: HashSet<usize> = observations.iter().map(|o| o.target).collect();
    let never = targets.iter().enumerate().filter(|(at, _)| !seen_ids.contains(at));
    let never: Vec<&str> = never.map(|(_, target)| target.id.as_str()).collect();
    if !never.is_empty() && !reader.findings.is_invalid() {
        reader.findings.warn(format!("{FILE}: never seen: {}", never.join(", ")));
    }
    observations.sort_by_key(|o| (o.frame, o.target));
    observations
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

impl TargetInventory {
    /// Counts it.
    pub fn new(targets: &[Target], observations: &[TargetObservation], frames: usize) -> Self {
        let is_control = |t: &Target| t.role == Role::Control && t.known.iter().any(Option::is_some);
        let mut control_per_frame = vec![0; frames];
        for observation in observations {
            control_per_frame[observation.frame] += usize::from(is_control(&targets[observation.target]));
        }
        let check = targets.iter().filter(|t| t.role == Role::Check).count();
        let control = targets.iter().filter(|t| is_control(t)).count();
        TargetInventory {
            control,
            check,
            tie: targets.len() - control - check,
            observations: observations.len(),
            control_per_frame: spread(control_per_frame),
        }
    }
}

/// The table of the targets of a problem.
pub fn table(problem: &Problem) -> Vec<u8> {
    let rows = problem.targets.iter().map(|target| {
        let [x, y, z] = target.known.map(number_sigma);
        let role = match target.role {
            Role::Control => "control",
            Role::Check => "check",
        };
        let ([x, sx], [y, sy], [z, sz]) = (x, y, z);
        [target.id.clone(), x, y, z, sx, sy, sz, role.to_owned()]
    });
    let header = ["target", "x", "y", "z", "sigma_x", "sigma_y", "sigma_z", "role"];
    written(&header, rows)
}

/// The table of their image points.
pub fn observations_table(problem: &Problem) -> Vec<u8> {
    let seen = problem.target_observations.iter().map(|o| {
        let id = problem.targets[o.target].id.clone();
        let [u, v, sigma_px] = pixels(&o.image_px, o.sigma_px);
        [problem.frames[o.frame].number.to_string(), id, u, v, sigma_px]
    });
    written(&["frame", "target", "u", "v", "sigma_px"], seen)
}
