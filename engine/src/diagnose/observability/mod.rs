//! What measurements and real knowledge leave open: rank and defect of the normal equations, and each direction
//! that nothing, or next to nothing, holds, in the words of the user.
//!
//! Image points, surveyed targets, ground, known heights and points, and camera poses whose standard deviations
//! are stated count; smoothness of motion, starting poses, usual sizes and holds of tie points do not. A camera
//! without a standard deviation is free here even where the adjustment holds it as given: [`Direction::held_by`]
//! then says so.
//!
//! ```text
//! J D^-1 = U S V^T       D: the norms of the columns of the whitened Jacobian J
//! null                   s_i / s_1 < 1e-9
//! weak                   1e-9 <= s_i / s_1 < 1e-3: it keeps its large, finite standard deviation
//! ```
//!
//! The null space of the image points is known by theory (`candidates.rs`); knowledge restricts it, and what is
//! left by counting is the expected defect. Singular values of the Jacobian itself (those of the normal matrix
//! would drown) say what is open beyond it. Where that takes too long (more than [`MOST_DENSE`]
//! unknowns, or very many rows) theory alone is confirmed, candidate by candidate.

mod candidates;
mod names;
mod rows;
mod span;

pub use names::describe;

use crate::estimate::Estimate;
use crate::problem::Problem;
use candidates::{Candidate, Candidates, candidates};
use nalgebra::{DMatrix, DVector};
use rows::{Coordinates, Rows, examine};
use span::{Shares, Span, orthonormal};

/// Directions whose singular value, as a share of the largest, lies below this are null.
pub const NULL_RATIO: f64 = 1e-9;
/// Those that are not null and lie below this are weak.
pub const WEAK_RATIO: f64 = 1e-3;
/// With more unknowns than this singular values are not computed.
pub const MOST_DENSE: usize = 1500;
/// Nor where that would take more operations: rows times the square of the unknowns.
const MOST_OPERATIONS: f64 = 2e10;
/// With more candidates than this in a large problem each body, and each frame, is looked at by itself.
const MOST_TOGETHER: usize = 400;
/// Multiplications with the Jacobian by which its largest singular value is found.
const POWER_STEPS: usize = 40;
/// A weak direction with this share in the span of candidates is called by one of them.
const SHARE_IN_SPAN: f64 = 0.5;

/// What is open.
#[derive(Clone, Debug, PartialEq)]
pub struct Observability {
    /// How many numbers are unknown.
    pub unknowns: usize,
    /// How many of their combinations are determined, weak ones too.
    pub rank: usize,
    /// How many are not.
    pub defect: usize,
    /// How many should not be, by theory.
    pub expected_defect: usize,
    /// The largest singular value of the Jacobian, its columns scaled to unit length.
    pub largest_singular: f64,
    /// What is null or weak: null first, each in order of bodies.
    pub directions: Vec<Direction>,
    /// Whether all singular values were computed; if not, only directions known by theory were confirmed.
    pub is_dense: bool,
}

/// A direction that nothing, or little, holds.
#[derive(Clone, Debug, PartialEq)]
pub struct Direction {
    /// What it is, in words.
    pub name: String,
    /// What it is.
    pub kind: Kind,
    /// How open it is.
    pub class: Class,
    /// What rows see of it, as a share of what they see of what they see best.
    pub singular_ratio: f64,
    /// What holds it in the adjustment nevertheless: `motion` where motion is smoothed.
    pub held_by: Option<&'static str>,
    /// Numbers of the frames that it is about; none where it is about all of them.
    pub frames: Vec<i64>,
}

/// How open a direction is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Class {
    /// Nothing holds it.
    Null,
    /// It is held, and has a large standard deviation.
    Weak,
}

/// What a direction does to a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum DatumFreedom {
    /// It shifts it.
    Shift,
    /// It rotates it.
    Rotation,
}

/// What is open of a pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Part {
    /// Its position along an axis of the world.
    Position(usize),
    /// Its attitude about an axis of the body.
    Attitude(usize),
    /// Some combination.
    Pose,
}

/// What a direction is. Vehicles, points, targets and frames are indices; axes are 0, 1, 2 for x, y, z.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// Scale of the static world: cameras and static points.
    WorldScale,
    /// Frame of the world.
    World {
        /// What it does.
        freedom: DatumFreedom,
        /// Along or about which axis of the world.
        axis: usize,
    },
    /// Scale of a vehicle: its size and its distance from the camera.
    Scale {
        /// The vehicle.
        vehicle: usize,
    },
    /// Frame of a vehicle.
    BodyFrame {
        /// The vehicle.
        vehicle: usize,
        /// What it does.
        freedom: DatumFreedom,
        /// Along or about which axis of the vehicle.
        axis: usize,
    },
    /// Depth of a point of a vehicle, or of a target.
    PointDepth {
        /// The vehicle; `None` for a target.
        vehicle: Option<usize>,
        /// The point or target.
        point: usize,
    },
    /// Pose of the camera, its vehicles moving along.
    CameraPose {
        /// In these frames.
        frames: Vec<usize>,
        /// What of it.
        part: Part,
    },
    /// Pose of a vehicle.
    VehiclePose {
        /// The vehicle.
        vehicle: usize,
        /// In these frames.
        frames: Vec<usize>,
    },
    /// A number of the interior orientation.
    Interior {
        /// Which.
        at: usize,
    },
    /// The readout time.
    Readout,
    /// The rear axle of a vehicle: its place, or the direction in which it rolls.
    Axle {
        /// The vehicle.
        vehicle: usize,
        /// Which.
        at: usize,
    },
    /// The antenna of a receiver, along an axis of its vehicle.
    Antenna {
        /// The receiver.
        receiver: usize,
        /// Which axis.
        axis: usize,
    },
    /// A number of a receiver: clock offset, drift, shift along x, y, z.
    Receiver {
        /// The receiver.
        receiver: usize,
        /// Which.
        at: usize,
    },
    /// None of these.
    Other,
}

/// What is open of a problem at an estimate.
pub fn observability(problem: &Problem, estimate: &Estimate) -> Observability {
    observability_within(problem, estimate, MOST_DENSE)
}

/// [`observability`], singular values being computed up to so many unknowns.
pub fn observability_within(problem: &Problem, estimate: &Estimate, most_dense: usize) -> Observability {
    let (all, rows) = examine(problem, estimate);
    let norms = rows.column_norms(all.len());
    let candidates = candidates(problem, estimate, &all, &rows);
    let unknowns = all.unknowns();
    let work = Work { problem, all: &all, rows: &rows, norms: &norms };
    let operations = rows.measured as f64 * (unknowns as f64).powi(2);
    let is_small = unknowns <= most_dense && operations <= MOST_OPERATIONS;
    let dense = if is_small { work.dense(&candidates) } else { None };
    let found = dense.unwrap_or_else(|| work.by_theory(&candidates));
    let mut directions = found.directions;
    directions.sort_by(|a, b| (a.class == Class::Weak, &a.kind).cmp(&(b.class == Class::Weak, &b.kind)));
    Observability {
        unknowns,
        rank: unknowns.saturating_sub(found.defect),
        defect: found.defect,
        // Fewer rows than unknowns leave something open wherever they are.
        expected_defect: found.expected.max(unknowns.saturating_sub(rows.measured)),
        largest_singular: found.largest,
        directions,
        is_dense: found.is_dense,
    }
}

struct Found {
    directions: Vec<Direction>,
    defect: usize,
    expected: usize,
    largest: f64,
    is_dense: bool,
}

/// What is open within a span.
struct InSpan {
    /// How many directions knowledge alone leaves open.
    expected: usize,
    /// Those that all rows leave open.
    directions: Vec<Direction>,
    /// Their combinations.
    null: DMatrix<f64>,
    /// The rows restricted to the span.
    rows: DMatrix<f64>,
    /// Their singular values.
    shares: Shares,
}

/// What both ways need.
struct Work<'a> {
    problem: &'a Problem,
    all: &'a Coordinates,
    rows: &'a Rows,
    norms: &'a [f64],
}

impl Work<'_> {
    /// By the singular values of the whole Jacobian; `None` where there are none.
    fn dense(&self, candidates: &Candidates) -> Option<Found> {
        let free: Vec<usize> = (0..self.all.len()).filter(|at| self.all.is_free[*at]).collect();
        let mut column = vec![None; self.all.len()];
        free.iter().enumerate().for_each(|(at, coordinate)| column[*coordinate] = Some(at));
        let mut jacobian = DMatrix::zeros(self.rows.measured, free.len());
        for row in 0..self.rows.measured {
            for (at, value) in self.rows.row(row) {
                if let Some(column) = column[*at] {
                    jacobian[(row, column)] += value / self.norms[*at];
                }
            }
        }
        let (shares, largest) = Shares::of_its_largest(&jacobian)?;
        let together: Vec<Candidate> =
            candidates.of_bodies.iter().chain(&candidates.of_frames).flatten().cloned().collect();
        let span = Span::new(&together, self.norms);
        let every: Vec<usize> = (0..self.rows.len()).collect();
        let InSpan { expected, mut directions, null: in_span, .. } = self.in_span(&span, &every, largest)?;
        let mut confirmed = DMatrix::zeros(self.all.len(), in_span.ncols());
        for (mut into, along) in confirmed.column_iter_mut().zip(in_span.column_iter()) {
            into.copy_from(&span.perturbation(&along.clone_owned()));
        }
        let spread = |vectors: DMatrix<f64>| {
            let mut spread = DMatrix::zeros(self.all.len(), vectors.ncols());
            free.iter().enumerate().for_each(|(at, to)| spread.row_mut(*to).copy_from(&vectors.row(at)));
            spread
        };
        // What is null beyond theory.
        let null = spread(shares.within(-1.0..NULL_RATIO));
        let beyond = orthonormal(&(&null - &confirmed * confirmed.tr_mul(&null)));
        let number = null.ncols().saturating_sub(confirmed.ncols());
        for direction in localised(&beyond, number) {
            let kind = names::by_weight(self.all, &direction);
            let ratio = self.ratio(&direction, largest);
            directions.push(self.direction(kind, Class::Null, ratio));
        }
        let weak = NULL_RATIO..WEAK_RATIO;
        let ratios = shares.values.iter().filter(|value| weak.contains(*value));
        let mut elsewhere = Vec::new();
        for (ratio, vector) in ratios.zip(spread(shares.within(weak.clone())).column_iter()) {
            let vector = vector.clone_owned();
            let along = span.along(&vector);
            let is_inside = along.norm_squared() > SHARE_IN_SPAN;
            let named = if is_inside { span.names(&DMatrix::from_columns(&[along])).pop() } else { None };
            match named {
                Some(named) => directions.push(self.direction(named.kind, Class::Weak, *ratio)),
                None => elsewhere.push(vector),
            }
        }
        if !elsewhere.is_empty() {
            for direction in localised(&DMatrix::from_columns(&elsewhere), elsewhere.len()) {
                let kind = names::by_weight(self.all, &direction);
                let ratio = self.ratio(&direction, largest);
                directions.push(self.direction(kind, Class::Weak, ratio));
            }
        }
        Some(Found { directions, defect: null.ncols(), expected, largest, is_dense: true })
    }

    /// By theory alone, confirmed.
    fn by_theory(&self, candidates: &Candidates) -> Found {
        let largest = self.largest_singular();
        let number: usize = candidates.of_bodies.iter().chain(&candidates.of_frames).map(Vec::len).sum();
        let groups: Vec<Vec<Candidate>> = if number <= MOST_TOGETHER {
            let together = candidates.of_bodies.iter().chain(&candidates.of_frames).flatten();
            vec![together.cloned().collect()]
        } else {
            candidates.of_bodies.iter().chain(&candidates.of_frames).cloned().collect()
        };
        let mut found = Found { directions: Vec::new(), defect: 0, expected: 0, largest, is_dense: false };
        let of_coordinates = self.rows.of_coordinates(self.all.len());
        for group in &groups {
            let span = Span::new(group, self.norms);
            let seen_by = span.seen_by(&of_coordinates);
            let Some(InSpan { expected, directions, rows, shares, .. }) =
                self.in_span(&span, &seen_by, largest)
            else {
                continue;
            };
            found.expected += expected;
            found.defect += directions.len();
            found.directions.extend(directions);
            for named in span.names(&shares.within(NULL_RATIO..WEAK_RATIO)) {
                let ratio = (&rows * &named.along).norm() / largest;
                found.directions.push(self.direction(named.kind, Class::Weak, ratio));
            }
        }
        found
    }

    /// What some rows, all that see anything of it, leave open of the span of candidates.
    fn in_span(&self, span: &Span, some: &[usize], largest: f64) -> Option<InSpan> {
        let images = some.partition_point(|row| *row < self.rows.images);
        let rows = span.restricted(self.rows, some, self.norms);
        let knowledge = rows.rows(images, some.len() - images).clone_owned();
        let expected = Shares::of(&knowledge, largest)?.within(-1.0..NULL_RATIO).ncols();
        let shares = Shares::of(&rows, largest)?;
        let null = shares.within(-1.0..NULL_RATIO);
        let direction = |named: span::Named| {
            let ratio = (&rows * &named.along).norm() / largest.max(f64::MIN_POSITIVE);
            self.direction(named.kind, Class::Null, ratio)
        };
        let directions = span.names(&null).into_iter().map(direction).collect();
        Some(InSpan { expected, directions, null, rows, shares })
    }

    fn direction(&self, kind: Kind, class: Class, singular_ratio: f64) -> Direction {
        let name = names::name(self.problem, &kind);
        let held_by = names::held_by(self.problem, &kind);
        let frames = match &kind {
            Kind::CameraPose { frames, .. } | Kind::VehiclePose { frames, .. } => frames.as_slice(),
            _ => &[],
        };
        let frames = frames.iter().map(|frame| self.problem.frames[*frame].number).collect();
        Direction { name, kind, class, singular_ratio, held_by, frames }
    }

    /// What measurements see of a scaled perturbation.
    fn ratio(&self, perturbation: &DVector<f64>, largest: f64) -> f64 {
        let seen = |row: usize| -> f64 {
            self.rows.row(row).iter().map(|(at, value)| value * perturbation[*at] / self.norms[*at]).sum()
        };
        let square: f64 = (0..self.rows.measured).map(|row| seen(row).powi(2)).sum();
        square.sqrt() / perturbation.norm().max(f64::MIN_POSITIVE) / largest.max(f64::MIN_POSITIVE)
    }

    /// The largest singular value by the power method.
    fn largest_singular(&self) -> f64 {
        let is_free = |at: &usize| self.all.is_free[*at];
        let mut vector: Vec<f64> = (0..self.all.len()).map(|at| f64::from(u8::from(is_free(&at)))).collect();
        let mut largest = 0.0;
        for _ in 0..POWER_STEPS {
            let length = vector.iter().map(|x| x * x).sum::<f64>().sqrt();
            if length == 0.0 || !length.is_finite() {
                break;
            }
            let mut next = vec![0.0; vector.len()];
            for row in 0..self.rows.measured {
                let entries = self.rows.row(row).iter().filter(|(at, _)| is_free(at));
                let seen: f64 =
                    entries.clone().map(|(at, value)| value / self.norms[*at] * vector[*at] / length).sum();
                entries.for_each(|(at, value)| next[*at] += value / self.norms[*at] * seen);
            }
            largest = next.iter().map(|x| x * x).sum::<f64>().sqrt().sqrt();
            vector = next;
        }
        largest
    }
}

/// So many directions of a space, each about one coordinate.
fn localised(space: &DMatrix<f64>, number: usize) -> Vec<DVector<f64>> {
    let mut left = space.clone();
    let mut directions = Vec::new();
    while directions.len() < number && left.ncols() > 0 {
        let largest = (0..left.nrows()).max_by(|a, b| left.row(*a).norm().total_cmp(&left.row(*b).norm()));
        let Some(row) = largest.map(|at| left.row(at).transpose()) else { break };
        let length = row.norm();
        if length.is_nan() || length < 1e-6 {
            break;
        }
        let row = row / length;
        let direction = &left * &row;
        left -= &direction * row.transpose();
        directions.push(direction);
    }
    directions
}
