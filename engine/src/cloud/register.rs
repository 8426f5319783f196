//! Registration: the motion that brings a cloud onto another that it shares only a part with.
//!
//! Iterated closest points (Chen and Medioni 1992), point to surface. The surface is that of
//! [`surface`](super::surface), curved patches without borders: against planes, a closed body would come to lie
//! deeper than it does. Where the moving cloud is about as dense as the fixed one, its surface is used too,
//! against the points of the fixed one.
//!
//! How much of the clouds is common is not asked. Heights are a mixture of normal numbers and of uniform
//! ones up to the gate, whose share and standard deviation are estimated anew in each iteration
//! (expectation and maximisation); each point counts with the probability that it belongs. The start is an
//! observation with standard deviations of its own, so that directions of which the clouds say nothing (a
//! plate along itself) stay at the start. At the end it is tried whether points coincide, as in copies of one
//! scan; if so, the pose is theirs.

use super::index::{CloudError, CloudIndex};
use super::plane::NEIGHBOURS;
use super::surface::{Offset, Surface, thinned};
use crate::geometry::{Pose, rotation, skew};
use crate::stats::quantile::upper_median;
use nalgebra::{Matrix3x6, Matrix6, Point3, SymmetricEigen, Translation3, Vector3, Vector6};
use rayon::prelude::*;

/// Fewer points than this near the other cloud are no overlap.
const FEWEST: usize = 20;

/// Where less of the moving cloud belongs to the fixed one, another start is tried.
const LITTLE_OVERLAP: f64 = 0.3;

/// Clouds whose middles are farther apart than this many times the size of the fixed one are not tried from there.
const FAR: f64 = 2.0;

/// The first guess: half of the points belong, with this standard deviation \[m\].
const FIRST_SIGMA_M: f64 = 0.08;

/// Limits of the standard deviation of heights \[m\], apart from the scatter of the surface.
const SIGMA_M: [f64; 2] = [1e-3, 0.1];

/// Iterations end when a step is this share of the standard deviation of the pose.
const SMALL_STEP: f64 = 0.01;

/// Nearest points can change to and fro for ever: from this iteration on, steps are halved.
const HALVED_FROM: usize = 25;

/// Where both surfaces are used, each distance is used twice, and patches share points. Errors of halves of real scans
/// were twice what the equations say.
const BOTH_WAYS_VARIANCE: f64 = 4.0;

/// Points this near to each other, as a share of the spacing, coincide; and they do not by chance if so many do.
const COINCIDENT: f64 = 0.02;
const COINCIDENT_SHARE: f64 = 0.1;

/// A direction is undetermined where its information is less than this many times that which noise of normals
/// alone makes.
const NOISE_INFORMATION: f64 = 3.0;

/// How clouds are registered.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RegisterOptions {
    /// Neighbours of a patch of the surface.
    pub neighbours: usize,
    /// Points farther off the surface than this do not belong \[m\].
    pub gate_m: f64,
    /// Standard deviation of the start: of the place of the fixed cloud's centre \[m\] ...
    pub start_sigma_m: f64,
    /// ... and of the attitude \[rad\].
    pub start_sigma_rad: f64,
    /// No more iterations.
    pub most_iterations: usize,
    /// Of clouds with more points as many are used, drawn at random but always alike.
    pub most_points: usize,
}

impl Default for RegisterOptions {
    fn default() -> Self {
        RegisterOptions {
            neighbours: NEIGHBOURS,
            gate_m: 0.3,
            start_sigma_m: 0.2,
            start_sigma_rad: 5f64.to_radians(),
            most_iterations: 100,
            most_points: 40_000,
        }
    }
}

/// Why clouds cannot be registered.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum RegisterError {
    /// A cloud is none.
    #[error(transparent)]
    Cloud(#[from] CloudError),
    /// The clouds are apart, or have no surface.
    #[error("{0} of the moving points lie near the fixed cloud's surface; at least 20 are wanted")]
    Apart(usize),
}

/// How a cloud came onto another.
#[derive(Clone, Debug, PartialEq)]
pub struct Registration {
    /// The motion.
    pub fixed_from_moving: Pose,
    /// How many iterations it took.
    pub iterations: usize,
    /// Whether the last step was small beside the standard deviations.
    pub is_converged: bool,
    /// Share of the moving points that belong to the fixed cloud.
    pub overlap: f64,
    /// Root mean square of their heights above its surface, or of their distances where points coincide \[m\].
    pub rms_m: f64,
    /// Whether points of both clouds are the same ones.
    pub coincides: bool,
    /// The place about which rotations are counted below: the middle of the fixed cloud \[m\].
    pub centre: Point3<f64>,
    /// Covariance of the shift of that place and of the rotation about it, both along the fixed axes
    /// \[m, rad\]. Undetermined directions have that of the start.
    pub covariance: Matrix6<f64>,
    /// Motions (shift, rotation in rad) that the clouds do not determine: along each of them the start was
    /// kept, or noise decided. A shift is weighed like the rotation that moves the typical point as far.
    pub undetermined: Vec<Vector6<f64>>,
}

impl Registration {
    /// Standard deviations along the fixed axes: three of the shift \[m\], three of the rotation \[rad\].
    pub fn sigmas(&self) -> [f64; 6] {
        std::array::from_fn(|axis| self.covariance[(axis, axis)].max(0.0).sqrt())
    }
}

/// A point near a surface: its height, and how that changes with the pose.
struct Observation {
    offset: Offset,
    slope: Vector6<f64>,
}

/// Heights as a mixture of normal and uniform numbers.
struct Mixture {
    share: f64,
    sigma_m: f64,
    gate_m: f64,
}

impl Mixture {
    fn variance(&self, offset: &Offset) -> f64 {
        self.sigma_m.powi(2) + offset.scatter_m.powi(2)
    }

    /// The probability that a point belongs.
    fn belongs(&self, offset: &Offset) -> f64 {
        if offset.height_m.abs() > self.gate_m {
            return 0.0;
        }
        let variance = self.variance(offset);
        let normal =
            (-0.5 * offset.height_m.powi(2) / variance).exp() / (std::f64::consts::TAU * variance).sqrt();
        let uniform = 0.5 / self.gate_m;
        self.share * normal / (self.share * normal + (1.0 - self.share) * uniform)
    }

    fn fit(&mut self, observations: &[Observation]) {
        let inside = |one: &&Observation| one.offset.height_m.abs() <= self.gate_m;
        let count = observations.iter().filter(inside).count().max(1) as f64;
        for _ in 0..10 {
            let (mut members, mut weight, mut excess) = (0.0, 0.0, 0.0);
            for Observation { offset, .. } in observations {
                let (belongs, variance) = (self.belongs(offset), self.variance(offset));
                members += belongs;
                weight += belongs / variance.powi(2);
                excess += belongs * (offset.height_m.powi(2) - offset.scatter_m.powi(2)) / variance.powi(2);
            }
            self.share = (members / count).clamp(0.05, 0.98);
            let variance = if weight > 0.0 { excess / weight } else { 0.0 };
            self.sigma_m = variance.max(0.0).sqrt().clamp(SIGMA_M[0], SIGMA_M[1]);
        }
    }
}

/// Normal equations of the step of a pose, without the start.
struct Equations {
    matrix: Matrix6<f64>,
    right: Vector6<f64>,
    /// What noise of the normals adds to the information along any direction.
    noise: f64,
}

fn equations(observations: &[Observation], mixture: &Mixture) -> Equations {
    let mut sum = Equations { matrix: Matrix6::zeros(), right: Vector6::zeros(), noise: 0.0 };
    for Observation { offset, slope } in observations {
        let weight = mixture.belongs(offset) / mixture.variance(offset);
        sum.matrix += slope * slope.transpose() * weight;
        sum.right -= slope * (weight * offset.height_m);
        sum.noise += weight * offset.slope_variance;
    }
    sum
}

/// Points of one cloud against the surface of the other, in whose frame `motion` puts them.
fn observe(points: &[Point3<f64>], surface: &Surface, motion: &Pose) -> Vec<Observation> {
    let one = |point: &Point3<f64>| {
        let at = motion * point;
        let offset = surface.offset(&at)?;
        let turn = at.coords.cross(&offset.normal);
        Some(Observation { offset, slope: joined(&offset.normal, &turn) })
    };
    points.par_iter().map(one).collect::<Vec<_>>().into_iter().flatten().collect()
}

/// The same the other way round, for steps of the same pose.
fn observe_back(points: &[Point3<f64>], surface: &Surface, motion: &Pose) -> Vec<Observation> {
    let mut seen = observe(points, surface, &motion.inverse());
    for one in &mut seen {
        // With the height `n (M^-1 f - s)`, a shift of M changes it by `-n`, turned, and a rotation likewise.
        let normal = motion.rotation * one.offset.normal;
        let at = motion.rotation * Vector3::new(one.slope[3], one.slope[4], one.slope[5]);
        let turn = at + motion.translation.vector.cross(&normal);
        one.slope = -joined(&normal, &turn);
    }
    seen
}

fn joined(shift: &Vector3<f64>, turn: &Vector3<f64>) -> Vector6<f64> {
    Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z)
}

/// A step `(shift, rotation)` about the origin.
fn stepped(step: &Vector6<f64>, motion: &Pose) -> Pose {
    let shift = Translation3::new(step[0], step[1], step[2]);
    Pose::from_parts(shift, rotation::exp(&Vector3::new(step[3], step[4], step[5]))) * motion
}

/// The middle of points per axis, and the middle distance from there.
fn middle(points: &[Point3<f64>]) -> (Point3<f64>, f64) {
    let median = |values: Vec<f64>| upper_median(values).unwrap_or(0.0);
    let centre = Point3::from([0, 1, 2].map(|axis| median(points.iter().map(|p| p[axis]).collect())));
    let size_m = median(points.iter().map(|p| (p - centre).norm()).collect());
    (centre, size_m.max(1e-6))
}

/// The same from `start` and, where little belongs there, from where the middles of both clouds are together,
/// horizontally or altogether; that of which most belongs. (Frames of bodies that nothing else fixes can be farther
/// from that of a scan than a registration comes.)
pub fn register_from_afar(
    moving: &[Point3<f64>],
    fixed: &CloudIndex,
    start: &Pose,
    options: &RegisterOptions,
) -> Result<Registration, RegisterError> {
    let mut best = register(moving, fixed, start, options);
    let overlap =
        |found: &Result<Registration, RegisterError>| found.as_ref().map_or(0.0, |found| found.overlap);
    if overlap(&best) < LITTLE_OVERLAP && !moving.is_empty() {
        let moved: Vec<Point3<f64>> = moving.iter().map(|p| start * p).collect();
        let (centre, size_m) = middle(fixed.points());
        let apart = centre - middle(&moved).0;
        // In another frame altogether, the way between the middles says nothing.
        let is_near = apart.norm() < FAR * size_m;
        for shift in [Vector3::new(apart.x, apart.y, 0.0), apart].into_iter().filter(|_| is_near) {
            let found = register(moving, fixed, &(Translation3::from(shift) * start), options);
            if overlap(&found) > overlap(&best) {
                best = found;
            }
        }
    }
    best
}

/// Brings `moving` onto `fixed`, from the pose `start`. The result is the same for any number of threads.
pub fn register(
    moving: &[Point3<f64>],
    fixed: &CloudIndex,
    start: &Pose,
    options: &RegisterOptions,
) -> Result<Registration, RegisterError> {
    let pair = Pair::new(moving, fixed, start, options)?;
    let nearest = pair.iterate()?;
    let mut found = pair.registration(&nearest);
    if let Some(same) = pair.coincident(&nearest.motion) {
        found.fixed_from_moving = same.motion;
        found.rms_m = same.rms_m;
        found.covariance = same.covariance;
        (found.coincides, found.is_converged) = (true, true);
        found.undetermined.clear();
    }
    let to = Translation3::from(pair.centre.coords);
    found.fixed_from_moving = to * found.fixed_from_moving * to.inverse() * start;
    Ok(found)
}

/// Two clouds that are registered, relative to the middle of the fixed one: motions start from none.
struct Pair<'a> {
    fixed: &'a CloudIndex,
    options: &'a RegisterOptions,
    centre: Point3<f64>,
    size_m: f64,
    moving: Vec<Point3<f64>>,
    surface: Surface,
    /// The surface of the moving cloud, where that is dense enough.
    back: Option<Surface>,
}

/// Where iterations ended.
struct Iterated {
    motion: Pose,
    mixture: Mixture,
    iterations: usize,
    is_converged: bool,
    covariance: Matrix6<f64>,
    equations: Equations,
}

impl<'a> Pair<'a> {
    fn new(
        moving: &[Point3<f64>],
        fixed: &'a CloudIndex,
        start: &Pose,
        options: &'a RegisterOptions,
    ) -> Result<Self, RegisterError> {
        let (centre, size_m) = middle(fixed.points());
        let fixed_points: Vec<Point3<f64>> = fixed.points().iter().map(|p| p - centre.coords).collect();
        let moving: Vec<Point3<f64>> = moving.iter().map(|p| start * p - centre.coords).collect();
        let moving = thinned(&moving, options.most_points);
        let surface = Surface::new(thinned(&fixed_points, options.most_points), options.neighbours)?;
        let back = Surface::new(moving.clone(), options.neighbours)?;
        let is_dense = |a: f64, b: f64| a < 2.0 * b;
        let reaches = surface.reach_m().zip(back.reach_m());
        let back = Some(back).filter(|_| reaches.is_some_and(|(fixed, moving)| is_dense(moving, fixed)));
        Ok(Pair { fixed, options, centre, size_m, moving, surface, back })
    }

    /// Of a step, so that all six count alike.
    fn units(&self) -> Vector6<f64> {
        Vector6::from_fn(|axis, _| if axis < 3 { 1.0 } else { 1.0 / self.size_m })
    }

    /// The weight of the start in an axis.
    fn start_weight(&self, axis: usize) -> f64 {
        let sigma = if axis < 3 { self.options.start_sigma_m } else { self.options.start_sigma_rad };
        sigma.powi(-2)
    }

    /// Heights of either cloud over the surface of the other.
    fn observations(&self, motion: &Pose) -> Result<Vec<Observation>, RegisterError> {
        let mut observations = observe(&self.moving, &self.surface, motion);
        let is_near = |one: &&Observation| one.offset.height_m.abs() <= self.options.gate_m;
        let near = observations.iter().filter(is_near).count();
        if near < FEWEST {
            return Err(RegisterError::Apart(near));
        }
        if let Some(back) = &self.back {
            observations.extend(observe_back(self.surface.points(), back, motion));
        }
        Ok(observations)
    }

    /// Iterated closest points.
    fn iterate(&self) -> Result<Iterated, RegisterError> {
        let gate_m = self.options.gate_m;
        let mut now = Iterated {
            motion: Pose::identity(),
            mixture: Mixture { share: 0.5, sigma_m: FIRST_SIGMA_M, gate_m },
            iterations: 0,
            is_converged: false,
            covariance: Matrix6::zeros(),
            equations: Equations { matrix: Matrix6::zeros(), right: Vector6::zeros(), noise: 0.0 },
        };
        let units = self.units();
        let length = |step: &Vector6<f64>| step.component_div(&units).norm();
        let variance_scale = if self.back.is_some() { BOTH_WAYS_VARIANCE } else { 1.0 };
        while now.iterations < self.options.most_iterations && !now.is_converged {
            let observations = self.observations(&now.motion)?;
            now.mixture.fit(&observations);
            now.equations = equations(&observations, &now.mixture);
            let moved = joined(&now.motion.translation.vector, &rotation::log(&now.motion.rotation));
            let mut matrix = now.equations.matrix / variance_scale;
            let mut right = now.equations.right / variance_scale;
            for axis in 0..6 {
                matrix[(axis, axis)] += self.start_weight(axis);
                right[axis] -= self.start_weight(axis) * moved[axis];
            }
            let Some(inverse) = matrix.cholesky().map(|factor| factor.inverse()) else { break };
            let step = inverse * right * if now.iterations < HALVED_FROM { 1.0 } else { 0.5 };
            now.motion = stepped(&step, &now.motion);
            now.iterations += 1;
            now.covariance = inverse;
            let sigma_m = Vector6::from_fn(|axis, _| inverse[(axis, axis)].sqrt());
            now.is_converged = length(&step) < SMALL_STEP * length(&sigma_m);
        }
        Ok(now)
    }

    /// What is told of the end of iterations; the motion is still about the middle of the fixed cloud.
    fn registration(&self, end: &Iterated) -> Registration {
        let heights = observe(&self.moving, &self.surface, &end.motion);
        let belongs: Vec<f64> = heights.iter().map(|one| end.mixture.belongs(&one.offset)).collect();
        let members: f64 = belongs.iter().sum();
        let squares: f64 =
            heights.iter().zip(&belongs).map(|(one, belongs)| belongs * one.offset.height_m.powi(2)).sum();
        Registration {
            fixed_from_moving: end.motion,
            iterations: end.iterations,
            is_converged: end.is_converged,
            overlap: members / self.moving.len() as f64,
            rms_m: if members > 0.0 { (squares / members).sqrt() } else { 0.0 },
            coincides: false,
            centre: self.centre,
            covariance: end.covariance,
            undetermined: undetermined(&end.equations, &self.units()),
        }
    }

    /// The motion by which points of both clouds coincide, where they are copies of one scan.
    fn coincident(&self, start: &Pose) -> Option<Coincident> {
        let neighbours = self.options.neighbours as f64;
        let spacing_m = self.surface.reach_m().map_or(0.0, |reach| reach / (neighbours / 3.0).sqrt());
        coincident(&self.moving, self.fixed, &self.centre, start, spacing_m)
    }
}

/// Directions with no more information than noise of normals makes, largest uncertainty first.
fn undetermined(equations: &Equations, units: &Vector6<f64>) -> Vec<Vector6<f64>> {
    let scaled = Matrix6::from_diagonal(units) * equations.matrix * Matrix6::from_diagonal(units);
    let eigen = SymmetricEigen::new(scaled);
    let most = eigen.eigenvalues.max();
    let limit = NOISE_INFORMATION * equations.noise + 1e-9 * most;
    let mut weak: Vec<usize> = (0..6).filter(|axis| eigen.eigenvalues[*axis] <= limit).collect();
    weak.sort_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]));
    weak.iter().map(|axis| eigen.eigenvectors.column(*axis).component_mul(units)).collect()
}

struct Coincident {
    motion: Pose,
    rms_m: f64,
    covariance: Matrix6<f64>,
}

/// Point to point with a radius that shrinks. `None` unless the points that coincide at the end are many.
fn coincident(
    moving: &[Point3<f64>],
    fixed: &CloudIndex,
    centre: &Point3<f64>,
    start: &Pose,
    spacing_m: f64,
) -> Option<Coincident> {
    let near_m = COINCIDENT * spacing_m;
    let mut radius_m = spacing_m;
    let mut motion = *start;
    for _ in 0..60 {
        let pairs: Vec<(Point3<f64>, Vector3<f64>, f64)> = moving
            .par_iter()
            .map(|point| {
                let at = motion * point;
                let in_fixed = at + centre.coords;
                let nearest = fixed.nearest(&in_fixed);
                (at, fixed.points()[nearest.index] - in_fixed, nearest.distance_m)
            })
            .collect();
        let mut matrix = Matrix6::zeros();
        let mut right = Vector6::zeros();
        let (mut weights, mut squares) = (0.0, 0.0);
        for (at, way, distance_m) in pairs.iter().filter(|pair| pair.2 < radius_m) {
            let weight = (1.0 - (distance_m / radius_m).powi(2)).powi(2);
            let mut slope = Matrix3x6::identity();
            slope.fixed_columns_mut::<3>(3).copy_from(&-skew(&at.coords));
            matrix += slope.transpose() * slope * weight;
            right += slope.transpose() * way * weight;
            weights += weight;
            squares += weight * distance_m.powi(2);
        }
        let inverse = matrix.cholesky()?.inverse();
        let step = inverse * right;
        motion = stepped(&step, &motion);
        let same = pairs.iter().filter(|pair| pair.2 < near_m).count() as f64 / pairs.len() as f64;
        if same > COINCIDENT_SHARE && radius_m <= near_m && step.norm() < 1e-3 * near_m {
            let variance = squares / (3.0 * weights);
            return Some(Coincident {
                motion,
                rms_m: (squares / weights).sqrt(),
                covariance: inverse * variance,
            });
        }
        radius_m = (0.8 * radius_m).max(near_m);
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::tests::{Draws, scan, shell};

    fn direction(draws: &mut Draws) -> Vector3<f64> {
        Vector3::from_fn(|_, _| draws.normal()).normalize()
    }

    fn mean(cloud: &[Point3<f64>]) -> Point3<f64> {
        Point3::from(cloud.iter().map(|p| p.coords).sum::<Vector3<f64>>() / cloud.len() as f64)
    }

    /// 10 cm and 3 degrees about a place, in random directions.
    fn displacement(about: &Point3<f64>, draws: &mut Draws) -> Pose {
        let turn = rotation::exp(&(direction(draws) * 3f64.to_radians()));
        let to = about.coords + direction(draws) * 0.1;
        Pose::from_parts(Translation3::from(to - turn * about.coords), turn)
    }

    /// What is left of a displacement: of the centre \[m\], and of the attitude \[deg\].
    fn left(found: &Registration, displaced: &Pose, about: &Point3<f64>) -> [f64; 2] {
        let left = found.fixed_from_moving * displaced;
        [(left * about - about).norm(), left.rotation.angle().to_degrees()]
    }

    #[test]
    fn a_frame_that_is_far_off_is_found_from_the_middle() {
        // Some points of a body, in a frame that is elsewhere.
        let scan = scan();
        let about = mean(&scan);
        let mut draws = Draws::new(3);
        let turn = rotation::exp(&Vector3::new(0.0, 0.0, 0.02));
        let displaced = Pose::from_parts(Translation3::new(-1.6, 0.9, 0.02), turn);
        let moving: Vec<Point3<f64>> =
            scan.iter().filter(|_| draws.uniform() < 0.3).map(|p| displaced * p).collect();
        let index = CloudIndex::new(scan).unwrap();
        let options = RegisterOptions::default();
        let near = register(&moving, &index, &Pose::identity(), &options);
        assert!(near.map_or(1.0, |found| left(&found, &displaced, &about)[0]) > 0.2);
        let found = register_from_afar(&moving, &index, &Pose::identity(), &options).unwrap();
        let [shift_m, turn_deg] = left(&found, &displaced, &about);
        assert!(shift_m < 1e-3 && turn_deg < 0.02, "{shift_m} {turn_deg}");
    }

    /// 400 points of the scan with 2 cm of noise, and what is left in units of the standard deviations.
    #[test]
    fn a_sparse_shape_comes_onto_a_scan_within_its_standard_deviations() {
        let scan = scan();
        let about = mean(&scan);
        let fixed = CloudIndex::new(scan.clone()).unwrap();
        let mut squares = [0.0; 6];
        for seed in 0..12 {
            let mut draws = Draws::new(100 + seed);
            let displaced = displacement(&about, &mut draws);
            let moving: Vec<Point3<f64>> = (0..400)
                .map(|_| {
                    let point = scan[(draws.uniform() * scan.len() as f64) as usize];
                    displaced * (point + Vector3::from_fn(|_, _| 0.02 * draws.normal()))
                })
                .collect();
            let found = register(&moving, &fixed, &Pose::identity(), &RegisterOptions::default()).unwrap();
            let error = left(&found, &displaced, &found.centre);
            assert!(error[0] < 0.02 && error[1] < 1.2, "{error:?}");
            assert!(found.undetermined.is_empty() && !found.coincides);
            assert!((0.015..0.03).contains(&found.rms_m), "{}", found.rms_m);
            let motion = found.fixed_from_moving * displaced;
            let shift = motion * found.centre - found.centre;
            let error = joined(&shift, &rotation::log(&motion.rotation));
            for (axis, sigma) in found.sigmas().iter().enumerate() {
                squares[axis] += (error[axis] / sigma).powi(2) / 12.0;
            }
        }
        for square in squares {
            assert!(square < 6.0, "{squares:?}");
        }
    }

    #[test]
    fn large_coordinates_make_no_difference() {
        let mut draws = Draws::new(5);
        let scan = scan();
        let displaced = displacement(&mean(&scan), &mut draws);
        let moving: Vec<Point3<f64>> = scan.iter().step_by(2).map(|p| displaced * p).collect();
        let fixed: Vec<Point3<f64>> = scan.iter().skip(1).step_by(2).copied().collect();
        let to = Translation3::new(500_000.0, 3_900_000.0, 30.0);
        let run = |moving: Vec<Point3<f64>>, fixed: Vec<Point3<f64>>| {
            let fixed = CloudIndex::new(fixed).unwrap();
            register(&moving, &fixed, &Pose::identity(), &RegisterOptions::default()).unwrap()
        };
        let far = |cloud: &[Point3<f64>]| cloud.iter().map(|p| to * p).collect::<Vec<_>>();
        let there = run(far(&moving), far(&fixed));
        let here = run(moving.clone(), fixed);
        for point in &moving {
            let apart = there.fixed_from_moving * (to * point) - to * (here.fixed_from_moving * point);
            assert!(apart.norm() < 1e-5, "{apart}");
        }
    }

    #[test]
    fn a_plate_is_determined_off_itself_only() {
        let mut draws = Draws::new(7);
        let mut plate = |sigma: f64| -> Vec<Point3<f64>> {
            (0..3000)
                .map(|_| Point3::new(2.0 * draws.uniform(), draws.uniform(), sigma * draws.normal()))
                .collect()
        };
        for sigma in [0.0, 0.005] {
            let fixed = CloudIndex::new(plate(sigma)).unwrap();
            let start = Pose::translation(0.02, -0.03, 0.05);
            let found = register(&plate(sigma), &fixed, &start, &RegisterOptions::default()).unwrap();
            assert_eq!(found.undetermined.len(), 3, "{:?}", found.undetermined);
            for motion in &found.undetermined {
                // Along x and y, and about z.
                let off = [motion[2], motion[3], motion[4]].map(f64::abs).into_iter().fold(0.0, f64::max);
                assert!(off < 0.05 * motion.amax(), "{motion}");
            }
            let shift = found.fixed_from_moving * Point3::new(1.0, 0.5, 0.0) - Point3::new(1.0, 0.5, 0.0);
            assert!(shift.z.abs() < 2e-3, "{shift}");
            if sigma == 0.0 {
                assert!((shift.x - 0.02).abs() < 1e-3 && (shift.y + 0.03).abs() < 1e-3, "{shift}");
                assert!((found.sigmas()[0] - 0.2).abs() < 0.01, "{:?}", found.sigmas());
            }
        }
    }

    #[test]
    fn any_number_of_threads_gives_the_same_bytes() {
        let moving = shell(3000, 1);
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let start = Pose::translation(0.05, 0.02, -0.04);
            pool.install(|| {
                let fixed = CloudIndex::new(shell(4000, 2)).unwrap();
                register(&moving, &fixed, &start, &RegisterOptions::default()).unwrap()
            })
        };
        assert_eq!(run(1), run(3));
    }

    #[test]
    fn clouds_that_are_apart_are_refused() {
        let fixed = CloudIndex::new(shell(2000, 1)).unwrap();
        let far = Pose::translation(50.0, 0.0, 0.0);
        let options = RegisterOptions::default();
        assert_eq!(register(&shell(500, 2), &fixed, &far, &options), Err(RegisterError::Apart(0)));
        let none = register(&[], &fixed, &Pose::identity(), &options);
        assert_eq!(none, Err(RegisterError::Cloud(CloudError::Empty)));
        let mut bad = shell(50, 1);
        bad[7].x = f64::NAN;
        assert!(matches!(
            register(&bad, &fixed, &Pose::identity(), &options),
            Err(RegisterError::Cloud(CloudError::Coordinate { index: 7, .. }))
        ));
        // All of a line, or all one place.
        for points in
            [vec![Point3::origin(); 100], (0..100).map(|i| Point3::new(f64::from(i), 0.0, 0.0)).collect()]
        {
            let fixed = CloudIndex::new(points.clone()).unwrap();
            assert!(register(&points, &fixed, &Pose::identity(), &options).is_err());
        }
    }
}
