//! The exterior orientation of one frame from its control points.
//!
//! Poses that three points allow ([`super::p3p`]) are tried against all points, the best distinct ones
//! are finished by least squares with Tukey's loss:
//!
//! ```text
//! X = R^T (G - t),   r = W ((u, v) - project(X))        dr/dt = W P R^T,   dr/drot = -W P [X]x
//! W^T W = (sigma_px^2 I + P R^T diag(survey sigma^2) R P^T)^-1,        P = d project / dX
//! ```
//!
//! perturbed as in [`trackbundle_solver::manifold`]: the position in the world, the attitude about the camera's
//! own axes. The covariance is the inverse of the undamped normal matrix at the end.

use super::p3p::p3p;
use crate::camera::Camera;
use crate::geometry::rotation::exp;
use crate::geometry::{Pose, skew};
use crate::rules::rules;
use crate::stats::normal::GROSS_SIGMAS;
use nalgebra::{Matrix2, Matrix2x3, Matrix2x6, Matrix6, Point3, Vector2, Vector3, Vector6};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use trackbundle_solver::loss::{Loss, LossName};

rules! {
    /// Resection of one frame.
    pub struct FrameResectionRules {
        /// Most triples that are tried. With 30 % gross errors one in three is good.
        most_triples: usize = 60, "triples";
        /// Of so many random triples the widest is tried.
        draws_for_a_triple: usize = 3, "triples";
        /// Frames with no more try every root of every triple to the end.
        few_points: usize = 4, "points";
        /// What a gross error costs beyond Tukey's loss: that one more point agrees by chance is that unlikely
        /// (some ten pixels across in an image of thousands).
        gross_cost: f64 = 8.0, "half chi squared";
        /// Distinct hypotheses that are finished by least squares.
        most_finished: usize = 4, "hypotheses";
        /// A hypothesis is truncated here: it rests on three noisy points.
        hypothesis_sigmas: f64 = 12.0, "standard deviations";
        /// Hypotheses nearer than this are the same.
        distinct_hypothesis: f64 = 0.03, "rad, share of the distance";
        /// Finished poses nearer than this are the same one.
        same_pose: [f64; 2] = [0.05, 1e-3], "m, rad";
        /// By what the loss is stretched in the first steps from a hypothesis ...
        first_stretch: f64 = 4.0, "factor";
        /// ... of which there are so many.
        first_steps: usize = 4, "steps";
        /// The most steps of least squares after them.
        most_steps: usize = 25, "steps";
    }
}

const RULES: FrameResectionRules = FrameResectionRules::DEFAULT;

/// A control point in a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sighting {
    /// Where it is in the world \[m\].
    pub point: Point3<f64>,
    /// Standard deviations of that \[m\].
    pub sigma_m: Vector3<f64>,
    /// Where it is seen \[px\].
    pub image_px: Vector2<f64>,
    /// Direction `(x/z, y/z)` of that, the distortion removed.
    pub ray: Vector2<f64>,
    /// Standard deviation per coordinate \[px\], above zero.
    pub sigma_px: f64,
}

/// A pose that fits.
#[derive(Clone, Debug, PartialEq)]
pub struct Fit {
    /// `world_from_camera`.
    pub pose: Pose,
    /// Half the sum of rho.
    pub cost: f64,
    /// 6 x 6, position \[m\] and attitude \[rad\]; `None` where the normal matrix is singular.
    pub covariance: Option<Matrix6<f64>>,
    /// Norm of the whitened residual of each sighting; infinite behind the camera.
    pub norms: Vec<f64>,
    /// Root mean square of the coordinates of what is no gross error \[px\].
    pub rms_px: f64,
}

/// The sightings of a frame as they are weighed.
#[derive(Clone, Copy, Debug)]
pub struct Frame<'a> {
    /// The camera.
    pub camera: &'a Camera,
    /// What it sees of control.
    pub sightings: &'a [Sighting],
    /// By what image points scatter more than their standard deviations say, at least 1.
    pub spread: f64,
}

impl Fit {
    /// Sightings that are no gross errors.
    pub fn used(&self) -> usize {
        self.norms.iter().filter(|norm| **norm <= GROSS_SIGMAS).count()
    }

    /// By what fits are compared: the cost, and a charge for each gross error.
    pub fn rating(&self) -> f64 {
        self.cost + RULES.gross_cost * (self.norms.len() - self.used()) as f64
    }

    /// Standard deviation of the position along its worst axis \[m\], and of the attitude \[rad\].
    pub fn largest_sigmas(&self) -> Option<[f64; 2]> {
        self.covariance.as_ref().map(largest_sigmas)
    }

    /// Whether two fits are the same minimum.
    pub fn is_same(&self, other: &Fit) -> bool {
        let turn = self.pose.rotation.angle_to(&other.pose.rotation);
        let shift = (self.pose.translation.vector - other.pose.translation.vector).norm();
        shift < RULES.same_pose[0] && turn < RULES.same_pose[1]
            || self.mahalanobis(other).is_some_and(|d2| d2 < 1.0)
    }

    fn mahalanobis(&self, other: &Fit) -> Option<f64> {
        let sum = self.covariance? + other.covariance?;
        let gap = trackbundle_solver::manifold::pose_minus(&other.pose, &self.pose);
        Some(gap.dot(&sum.cholesky()?.solve(&gap)))
    }
}

/// Standard deviation of a position along its worst axis \[m\] and of an attitude \[rad\].
pub fn largest_sigmas(covariance: &Matrix6<f64>) -> [f64; 2] {
    [0, 3].map(|at| {
        let block = covariance.fixed_view::<3, 3>(at, at).into_owned();
        block.symmetric_eigenvalues().max().max(0.0).sqrt()
    })
}

impl Frame<'_> {
    /// Poses that fit, the best first; none where there are fewer than three sightings. Random choices
    /// are drawn from `seed`.
    pub fn search(&self, seed: u64) -> Vec<Fit> {
        let mut hypotheses: Vec<(f64, Pose)> = Vec::new();
        for triple in self.triples(seed) {
            let points = triple.map(|i| self.sightings[i].point);
            let rays = triple.map(|i| self.sightings[i].ray.push(1.0));
            hypotheses.extend(p3p(&points, &rays).into_iter().map(|pose| (self.score(&pose), pose)));
        }
        hypotheses.sort_by(|a, b| a.0.total_cmp(&b.0));
        let most = if self.sightings.len() <= RULES.few_points { usize::MAX } else { RULES.most_finished };
        let mut chosen: Vec<Pose> = Vec::new();
        for (_, pose) in hypotheses {
            if chosen.len() >= most {
                break;
            }
            if most == usize::MAX || chosen.iter().all(|other| self.is_distinct(other, &pose)) {
                chosen.push(pose);
            }
        }
        let mut fits: Vec<Fit> = chosen.iter().filter_map(|pose| self.finish(pose, true)).collect();
        sort_out(&mut fits);
        fits
    }

    fn is_distinct(&self, a: &Pose, b: &Pose) -> bool {
        let distance = (self.sightings[0].point - Point3::from(a.translation.vector)).norm();
        a.rotation.angle_to(&b.rotation) > RULES.distinct_hypothesis
            || (a.translation.vector - b.translation.vector).norm() > RULES.distinct_hypothesis * distance
    }

    /// Triples to try: all of them, or of random ones those that are widest in the image.
    fn triples(&self, seed: u64) -> Vec<[usize; 3]> {
        let count = self.sightings.len();
        let all = count * count.saturating_sub(1) * count.saturating_sub(2) / 6;
        let mut triples = Vec::with_capacity(all.min(RULES.most_triples));
        if all <= RULES.most_triples {
            for i in 0..count {
                for j in i + 1..count {
                    triples.extend((j + 1..count).map(|k| [i, j, k]));
                }
            }
            return triples;
        }
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut draw = || {
            let i = rng.random_range(0..count);
            let j = (i + rng.random_range(1..count)) % count;
            loop {
                let k = rng.random_range(0..count);
                if k != i && k != j {
                    return [i, j, k];
                }
            }
        };
        let area = |[i, j, k]: &[usize; 3]| {
            let ray = |at: usize| self.sightings[at].ray;
            (ray(*j) - ray(*i)).perp(&(ray(*k) - ray(*i))).abs()
        };
        while triples.len() < RULES.most_triples {
            let drawn: [_; RULES.draws_for_a_triple] = std::array::from_fn(|_| draw());
            triples.extend(drawn.into_iter().max_by(|a, b| area(a).total_cmp(&area(b))));
        }
        triples
    }

    /// Sum of the truncated squares of a hypothesis (MSAC; Torr and Zisserman 2000).
    fn score(&self, pose: &Pose) -> f64 {
        let camera_from_world = pose.rotation.inverse().to_rotation_matrix();
        let truncated = RULES.hypothesis_sigmas * RULES.hypothesis_sigmas;
        let focal_px = self.camera.focal_px.mean();
        let one = |s: &Sighting| {
            let seen = camera_from_world * (s.point.coords - pose.translation.vector);
            if seen.z <= 0.0 {
                return truncated;
            }
            let off_px = (seen.xy() / seen.z - s.ray) * focal_px;
            let survey_px = focal_px / seen.z * s.sigma_m.norm();
            let variance =
                (s.sigma_px * s.sigma_px + survey_px * survey_px / 3.0) * self.spread * self.spread;
            (off_px.norm_squared() / variance).min(truncated)
        };
        self.sightings.iter().map(one).sum()
    }

    /// The least sum of Tukey's loss near `start`. From a rough start the loss is stretched first.
    /// `None` where no number comes of it.
    pub fn finish(&self, start: &Pose, is_rough: bool) -> Option<Fit> {
        let loss = LossName::Tukey.with_scale(GROSS_SIGMAS, 0.0);
        let mut pose = *start;
        if is_rough {
            pose = self.descend(pose, loss.stretched(RULES.first_stretch), RULES.first_steps);
        }
        pose = self.descend(pose, loss, RULES.most_steps);
        let normal = self.normal(&pose, loss);
        let (mut squares, mut count) = (0.0, 0);
        for (sighting, norm) in self.sightings.iter().zip(&normal.norms) {
            if *norm <= GROSS_SIGMAS
                && let Some(px) = self.camera.project(&pose.inverse_transform_point(&sighting.point).coords)
            {
                squares += (sighting.image_px - px).norm_squared();
                count += 2;
            }
        }
        let is_finite = pose.to_homogeneous().iter().all(|v| v.is_finite()) && normal.cost.is_finite();
        is_finite.then(|| Fit {
            pose,
            cost: normal.cost,
            covariance: covariance(&normal.matrix),
            norms: normal.norms,
            rms_px: (squares / f64::from(count.max(1))).sqrt(),
        })
    }

    /// Gauss-Newton, damped where a step would raise the cost.
    fn descend(&self, start: Pose, loss: Loss, steps: usize) -> Pose {
        let mut pose = start;
        let mut normal = self.normal(&pose, loss);
        let mut damping = 0.0;
        for _ in 0..steps {
            let mut damped = normal.matrix;
            (0..6).for_each(|i| damped[(i, i)] *= 1.0 + damping);
            let Some(step) = damped.cholesky().map(|factor| factor.solve(&-normal.gradient)) else { break };
            let next = moved(&pose, &step);
            let next_normal = self.normal(&next, loss);
            if next_normal.cost <= normal.cost {
                let is_small = step.dot(&(normal.matrix * step)) < 1e-10;
                (pose, normal) = (next, next_normal);
                damping *= 0.1;
                if is_small {
                    break;
                }
            } else {
                damping = (10.0 * damping).max(1e-3);
            }
        }
        pose
    }

    fn normal(&self, pose: &Pose, loss: Loss) -> Normal {
        let mut normal = Normal {
            matrix: Matrix6::zeros(),
            gradient: Vector6::zeros(),
            cost: 0.0,
            norms: Vec::with_capacity(self.sightings.len()),
        };
        for sighting in self.sightings {
            let Some((residual, jacobian)) = self.whitened(sighting, pose) else {
                normal.cost += 0.5 * loss.rho(f64::MAX)[0];
                normal.norms.push(f64::INFINITY);
                continue;
            };
            let square = residual.norm_squared();
            let [rho, weight, _] = loss.rho(square);
            normal.cost += 0.5 * rho;
            normal.norms.push(square.sqrt());
            if weight > 0.0 {
                normal.matrix += weight * jacobian.transpose() * jacobian;
                normal.gradient += weight * jacobian.transpose() * residual;
            }
        }
        normal
    }

    /// Whitened residual of a sighting and its derivative by the perturbation of the pose; `None` behind
    /// the camera. The whitening is taken as constant.
    fn whitened(&self, sighting: &Sighting, pose: &Pose) -> Option<(Vector2<f64>, Matrix2x6<f64>)> {
        let in_camera = pose.inverse_transform_point(&sighting.point).coords;
        let (computed_px, by_camera_point) = self.camera.project_with_jacobian(&in_camera)?;
        let camera_from_world = pose.rotation.inverse().to_rotation_matrix();
        let by_world: Matrix2x3<f64> = by_camera_point * camera_from_world.matrix();
        let survey = Matrix2x3::from_fn(|row, axis| by_world[(row, axis)] * sighting.sigma_m[axis]);
        let image = Matrix2::from_diagonal_element(sighting.sigma_px * sighting.sigma_px);
        let covariance = (image + survey * survey.transpose()) * (self.spread * self.spread);
        let root = covariance.cholesky()?;
        let mut jacobian = Matrix2x6::zeros();
        jacobian.fixed_view_mut::<2, 3>(0, 0).copy_from(&by_world);
        jacobian.fixed_view_mut::<2, 3>(0, 3).copy_from(&-(by_camera_point * skew(&in_camera)));
        let lower = root.l_dirty();
        let whiten = |rows: &mut Matrix2x6<f64>| {
            for column in 0..6 {
                let first = rows[(0, column)] / lower[(0, 0)];
                rows[(1, column)] = (rows[(1, column)] - lower[(1, 0)] * first) / lower[(1, 1)];
                rows[(0, column)] = first;
            }
        };
        whiten(&mut jacobian);
        let residual = sighting.image_px - computed_px;
        let first = residual.x / lower[(0, 0)];
        Some((Vector2::new(first, (residual.y - lower[(1, 0)] * first) / lower[(1, 1)]), jacobian))
    }
}

struct Normal {
    matrix: Matrix6<f64>,
    gradient: Vector6<f64>,
    cost: f64,
    norms: Vec<f64>,
}

/// Sorts fits by their ratings and keeps one of each minimum.
pub fn sort_out(fits: &mut Vec<Fit>) {
    fits.sort_by(|a, b| a.rating().total_cmp(&b.rating()));
    let mut kept: Vec<Fit> = Vec::with_capacity(fits.len());
    for fit in fits.drain(..) {
        if kept.iter().all(|other| !other.is_same(&fit)) {
            kept.push(fit);
        }
    }
    *fits = kept;
}

fn moved(pose: &Pose, step: &Vector6<f64>) -> Pose {
    let mut moved = *pose;
    moved.translation.vector += step.fixed_rows::<3>(0);
    moved.rotation *= exp(&step.fixed_rows::<3>(3).into_owned());
    moved.rotation.renormalize();
    moved
}

/// Inverse of a normal matrix, scaled to a unit diagonal first; `None` where it is singular.
fn covariance(normal: &Matrix6<f64>) -> Option<Matrix6<f64>> {
    let scale = Vector6::from_fn(|i, _| 1.0 / normal[(i, i)].sqrt());
    if scale.iter().any(|s| !s.is_finite()) {
        return None;
    }
    let scale = Matrix6::from_diagonal(&scale);
    let inverse = scale * (scale * normal * scale).cholesky()?.inverse() * scale;
    inverse.iter().all(|v| v.is_finite()).then_some(inverse)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::camera::tests::cameras;

    pub fn normal(rng: &mut ChaCha8Rng) -> f64 {
        let radius = (-2.0 * rng.random_range(f64::EPSILON..1.0).ln()).sqrt();
        radius * rng.random_range(0.0..std::f64::consts::TAU).cos()
    }

    pub fn normal3(rng: &mut ChaCha8Rng) -> Vector3<f64> {
        Vector3::from_fn(|_, _| normal(rng))
    }

    /// A camera 60 m above the ground that looks down.
    pub fn hovering() -> Pose {
        crate::geometry::pose([3.0, 8.0, 60.0], [0.02, 0.98, 0.15, 0.03])
    }

    /// Where a camera sees a point, with noise.
    pub fn sight(
        camera: &Camera,
        pose: &Pose,
        point: Point3<f64>,
        sigma_px: f64,
        rng: &mut ChaCha8Rng,
    ) -> Sighting {
        let exact = camera.project(&pose.inverse_transform_point(&point).coords).unwrap();
        let image_px = exact + Vector2::new(normal(rng), normal(rng)) * sigma_px;
        let ray = camera.ray(&image_px).unwrap();
        Sighting { point, sigma_m: Vector3::repeat(0.01), image_px, ray, sigma_px: sigma_px.max(1e-3) }
    }

    /// Points on the ground below, within `height_m` of it.
    fn ground(count: usize, height_m: f64, rng: &mut ChaCha8Rng) -> Vec<Point3<f64>> {
        let mut one = || {
            let (x, y) = (rng.random_range(-25.0..25.0), rng.random_range(-10.0..25.0));
            Point3::new(x, y, rng.random_range(0.0..1.0) * height_m)
        };
        (0..count).map(|_| one()).collect()
    }

    fn seen(camera: &Camera, count: usize, height_m: f64, rng: &mut ChaCha8Rng) -> Vec<Sighting> {
        let points = ground(count, height_m, rng);
        points.into_iter().map(|point| sight(camera, &hovering(), point, 1.0, rng)).collect()
    }

    fn gap_sigmas(fit: &Fit) -> f64 {
        let gap = trackbundle_solver::manifold::pose_minus(&hovering(), &fit.pose);
        let covariance = fit.covariance.unwrap();
        gap.dot(&covariance.cholesky().unwrap().solve(&gap))
    }

    #[test]
    fn the_jacobian_is_that_of_its_differences() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for camera in cameras() {
            // Without the survey the whitening is constant, as the Jacobian takes it.
            let mut sightings = seen(&camera, 6, 2.0, &mut rng);
            sightings.iter_mut().for_each(|s| s.sigma_m = Vector3::zeros());
            let frame = Frame { camera: &camera, sightings: &sightings, spread: 1.3 };
            for sighting in &sightings {
                let at = |axis: usize, by: f64| {
                    frame.whitened(sighting, &moved(&hovering(), &(Vector6::ith(axis, by)))).unwrap().0
                };
                let (_, jacobian) = frame.whitened(sighting, &hovering()).unwrap();
                for axis in 0..6 {
                    let slope = (at(axis, 1e-5) - at(axis, -1e-5)) / 2e-5;
                    let size = 1.0 + jacobian.column(axis).norm();
                    assert!((slope - jacobian.column(axis)).norm() < 1e-7 * size, "axis {axis}");
                }
            }
        }
    }

    #[test]
    fn errors_are_what_the_covariance_says() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        for camera in cameras() {
            let mut sum = 0.0;
            for seed in 0..200 {
                let mut sightings = seen(&camera, 10, 3.0, &mut rng);
                for s in &mut sightings {
                    s.sigma_m = Vector3::new(0.02, 0.05, 0.1);
                    s.point += s.sigma_m.component_mul(&normal3(&mut rng));
                }
                let frame = Frame { camera: &camera, sightings: &sightings, spread: 1.0 };
                sum += gap_sigmas(&frame.search(seed)[0]);
            }
            // Chi squared with 6 degrees of freedom: the mean of 200 scatters by 0.25; Tukey costs 5 %.
            assert!((sum / 200.0 - 6.2).abs() < 0.9, "{}", sum / 200.0);
        }
    }

    #[test]
    fn gross_errors_spoil_nothing() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let [camera, ..] = cameras();
        for (count, gross) in [(7, 2), (10, 3), (20, 6), (20, 8)] {
            for seed in 0..40 {
                let mut sightings = seen(&camera, count, 0.5, &mut rng);
                for s in &mut sightings[..gross] {
                    s.image_px = Vector2::new(rng.random_range(0.0..3840.0), rng.random_range(0.0..2160.0));
                    s.ray = camera.ray(&s.image_px).unwrap();
                }
                let frame = Frame { camera: &camera, sightings: &sightings, spread: 1.0 };
                let best = &frame.search(seed)[0];
                assert_eq!(best.used(), count - gross, "{count} {gross} {seed}: {:?}", best.norms);
                assert!(gap_sigmas(best) < 40.0, "{count} {gross} {seed}: {}", gap_sigmas(best));
            }
        }
    }

    #[test]
    fn a_camera_below_its_targets_is_found() {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let [camera, ..] = cameras();
        let up = crate::geometry::pose([0.0, 0.0, 1.5], [1.0, 0.05, -0.02, 0.3]);
        let points = [[3.0, 2.0], [-4.0, 1.0], [2.0, -3.0], [-2.0, 2.5], [0.5, 0.4]];
        let mut one =
            |[x, y]: [f64; 2]| sight(&camera, &up, Point3::new(x, y, 10.0 + 0.3 * x), 1.0, &mut rng);
        let sightings = points.map(&mut one);
        let frame = Frame { camera: &camera, sightings: &sightings, spread: 1.0 };
        let best = &frame.search(0)[0];
        assert!((best.pose.translation.vector - up.translation.vector).norm() < 0.05, "{}", best.pose);
    }

    #[test]
    fn three_points_leave_several_poses_and_four_one() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let [camera, ..] = cameras();
        let mut several = 0;
        for seed in 0..50 {
            let sightings = seen(&camera, 4, 0.0, &mut rng);
            let three = Frame { camera: &camera, sightings: &sightings[..3], spread: 1.0 }.search(seed);
            several += usize::from(three.len() > 1);
            assert!(three.iter().all(|fit| fit.cost < 1e-6), "{three:?}");
            let four = Frame { camera: &camera, sightings: &sightings, spread: 1.0 }.search(seed);
            let Some([position_m, _]) = four[0].largest_sigmas() else { continue };
            assert!(position_m > 1.0 || gap_sigmas(&four[0]) < 40.0, "{seed}: {}", gap_sigmas(&four[0]));
        }
        assert!(several > 30, "{several}");
    }

    #[test]
    fn what_does_not_determine_a_pose_gives_none_or_no_covariance() {
        let mut rng = ChaCha8Rng::seed_from_u64(6);
        let [camera, ..] = cameras();
        let mut on_line = |k: usize| {
            let k = k as f64;
            sight(&camera, &hovering(), Point3::new(4.0 * k - 10.0, 3.0 * k, 0.1 * k), 0.0, &mut rng)
        };
        let sightings: Vec<Sighting> = (0..6).map(&mut on_line).collect();
        let frame = Frame { camera: &camera, sightings: &sightings, spread: 1.0 };
        let is_bad = |fit: &Fit| fit.largest_sigmas().is_none_or(|[m, rad]| m > 1.0 || rad > 0.02);
        assert!(frame.search(0).iter().all(is_bad));
        for count in 0..3 {
            let few = Frame { sightings: &sightings[..count], ..frame };
            assert!(few.search(0).is_empty());
        }
        let same = [sightings[0]; 5];
        assert!(Frame { sightings: &same, ..frame }.search(0).is_empty());
    }
}
