//! Direct linear transformation: a point of a rigid body from its rays in many frames.
//!
//! With the camera's `P = [rho | w]` (rows `k` = 1, 2, 3), the body's pose `R, t` in the frame and
//! the ray `(x, y)` with the lens distortion removed, each sighting gives two rows in the point `M`:
//!
//! ```text
//! (x rho3 - rho1) R M = (rho1 - x rho3) t + w1 - x w3       equation (7) of the seed paper
//! (y rho3 - rho2) R M = (rho2 - y rho3) t + w2 - y w3       equation (8), corrected: y w3, not x w3
//! ```
//!
//! The rows of all frames are stacked. Each is divided by the depth of the body and the standard
//! deviation of the ray, so that it counts in standard deviations of the image. In terms of
//! `camera_from_body = [A | b]`, `rho R = A` and `rho t + w = b`, and both rows read
//! `(x A3 - A1) M = b1 - x b3`, `(y A3 - A2) M = b2 - y b3`.

use crate::geometry::Pose;
use crate::problem::Known;
use crate::residuals::inside_body::BODY_MIDDLE_M;
use crate::rules::rules;
use crate::stats::normal::median_of_norm_2;
use crate::stats::quantile::upper_median;
use nalgebra::{Dyn, Matrix3, OMatrix, OVector, Point3, U3, Vector2, Vector3};
use trackbundle_solver::loss::LossName;

rules! {
    /// Intersection of rays by linear least squares.
    pub struct DltRules {
        /// Smallest ratio of singular values at which the rays are said to meet.
        least_singular_ratio: f64 = 1e-7, "ratio";
        /// Standard deviation that a coordinate known as exact is given.
        exact_sigma_m: f64 = 1e-6, "m";
        /// Ratio of root mean square to median of residuals beyond which their tails are heavy. Normal errors of
        /// two coordinates have 1.20.
        heavy_tail_ratio: f64 = 1.5, "ratio";
        /// Re-weightings of [`LinearPoint::polish`].
        polish_steps: usize = 5, "steps";
        /// Fewest sightings that say anything about tails.
        tail_least_sightings: usize = 5, "sightings";
    }
}

const RULES: DltRules = DltRules::DEFAULT;

/// A ray to a point from one frame.
#[derive(Clone, Copy, Debug)]
pub struct Sighting {
    /// Pose of the body in the camera frame.
    pub camera_from_body: Pose,
    /// Direction `(x/z, y/z)`, distortion removed.
    pub ray: Vector2<f64>,
    /// Its standard deviation.
    pub sigma: f64,
}

/// The stacked rows `rows * M = right`, in standard deviations.
#[derive(Clone, Debug)]
pub struct LinearPoint {
    /// n x 3: two rows a sighting, then one for each known coordinate.
    pub rows: OMatrix<f64, Dyn, U3>,
    /// n.
    pub right: OVector<f64, Dyn>,
    /// How many sightings.
    pub sightings: usize,
}

impl LinearPoint {
    /// Stacks the rows of all sightings, and one for each coordinate that is known beforehand.
    pub fn new(sightings: &[Sighting], known: &[Option<Known>; 3]) -> Self {
        let count = 2 * sightings.len() + known.iter().flatten().count();
        let mut rows = OMatrix::<f64, Dyn, U3>::zeros(count);
        let mut right = OVector::<f64, Dyn>::zeros(count);
        for (at, sighting) in sightings.iter().enumerate() {
            let a: Matrix3<f64> = *sighting.camera_from_body.rotation.to_rotation_matrix().matrix();
            let b: Vector3<f64> = sighting.camera_from_body.translation.vector;
            let weight = 1.0 / (b.z.abs().max(1e-3) * sighting.sigma);
            for axis in 0..2 {
                let direction = sighting.ray[axis];
                rows.set_row(2 * at + axis, &(weight * (direction * a.row(2) - a.row(axis))));
                right[2 * at + axis] = weight * (b[axis] - direction * b.z);
            }
        }
        let known = known.iter().enumerate().filter_map(|(axis, known)| Some((axis, (*known)?)));
        for (at, (axis, known)) in known.enumerate() {
            let weight = 1.0 / known.sigma_m.max(RULES.exact_sigma_m);
            rows[(2 * sightings.len() + at, axis)] = weight;
            right[2 * sightings.len() + at] = weight * known.value_m;
        }
        LinearPoint { rows, right, sightings: sightings.len() }
    }

    /// The point with the least sum of squares; `None` where the rays do not meet in one.
    pub fn solve(&self) -> Option<Point3<f64>> {
        if self.rows.nrows() < 3 {
            return None;
        }
        let qr = self.rows.clone().qr();
        let upper: Matrix3<f64> = qr.r().fixed_view::<3, 3>(0, 0).into();
        let singular = upper.singular_values();
        if singular.min() <= RULES.least_singular_ratio * singular.max() {
            return None;
        }
        let projected = qr.q().tr_mul(&self.right);
        let point = upper.solve_upper_triangular(&projected.fixed_rows::<3>(0).into_owned())?;
        point.iter().all(|v| v.is_finite()).then(|| Point3::from(point))
    }

    /// Largest standard deviation of the point in any direction \[m\], from the standard deviations of
    /// the rays alone; infinite where they do not meet.
    pub fn largest_sigma_m(&self) -> f64 {
        let smallest = self.rows.clone().singular_values().min();
        if smallest > 0.0 { 1.0 / smallest } else { f64::INFINITY }
    }

    /// Norm of the residual of each sighting at a point, in standard deviations.
    pub fn residual_norms(&self, point: &Point3<f64>) -> Vec<f64> {
        let residual = &self.rows * point.coords - &self.right;
        (0..self.sightings).map(|at| residual[2 * at].hypot(residual[2 * at + 1])).collect()
    }

    /// What the residuals of the rays scatter at a point, in standard deviations, and at least 1; half
    /// of them may be gross.
    pub fn spread(&self, point: &Point3<f64>) -> f64 {
        upper_median(self.residual_norms(point)).map_or(1.0, |norm| (norm / median_of_norm_2()).max(1.0))
    }

    /// The same rows and three more, which draw the point to the middle of a car as much as rays that
    /// scatter by `spread` standard deviations leave open.
    pub fn drawn_to_body(&self, spread: f64) -> LinearPoint {
        let first = self.rows.nrows();
        let mut drawn = LinearPoint {
            rows: self.rows.clone().insert_rows(first, 3, 0.0),
            right: self.right.clone().insert_rows(first, 3, 0.0),
            sightings: self.sightings,
        };
        for (axis, (middle_m, half_size_m)) in BODY_MIDDLE_M.into_iter().enumerate() {
            drawn.rows[(first + axis, axis)] = spread / half_size_m;
            drawn.right[first + axis] = spread * middle_m / half_size_m;
        }
        drawn
    }

    /// The point with the least sum of Tukey's loss near `start`, by re-weighted least squares: what is
    /// farther off than 5.12 times `spread` standard deviations counts no more.
    pub fn polish(&self, start: &Point3<f64>, spread: f64) -> Option<Point3<f64>> {
        let loss = LossName::Tukey.with_scale(LossName::Tukey.default_scale() * spread, 0.0);
        let mut point = *start;
        for _ in 0..RULES.polish_steps {
            let mut weighted = self.clone();
            for (at, norm) in self.residual_norms(&point).into_iter().enumerate() {
                let root = loss.weight(norm * norm).sqrt();
                for row in [2 * at, 2 * at + 1] {
                    weighted.rows.row_mut(row).scale_mut(root);
                    weighted.right[row] *= root;
                }
            }
            point = weighted.solve()?;
        }
        Some(point)
    }

    /// Whether some sightings fit much worse than most.
    pub fn has_heavy_tails(&self, point: &Point3<f64>) -> bool {
        let norms = self.residual_norms(point);
        if norms.len() < RULES.tail_least_sightings {
            return false;
        }
        let mean_square = norms.iter().map(|n| n * n).sum::<f64>() / norms.len() as f64;
        mean_square.sqrt() > RULES.heavy_tail_ratio * upper_median(norms).unwrap_or(0.0).max(1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{pose, rotation::exp};

    /// A vehicle that drives and turns below a camera, and the rays to one of its points.
    fn sightings(point: Point3<f64>) -> Vec<Sighting> {
        (0..60)
            .map(|frame| {
                let time = f64::from(frame) / 30.0;
                let world_from_camera = pose([-20.0, 0.5 * time, 60.0], [0.12, -0.69, 0.70, -0.12]);
                let mut world_from_body =
                    pose([2.0 - time, 20.0 - 9.0 * time, 0.02], [0.67, -0.02, -0.01, -0.74]);
                world_from_body.rotation *= exp(&(Vector3::z() * (0.2 * time)));
                let camera_from_body = world_from_camera.inverse() * world_from_body;
                let in_camera = camera_from_body * point;
                Sighting { camera_from_body, ray: in_camera.xy().coords / in_camera.z, sigma: 1e-3 }
            })
            .collect()
    }

    #[test]
    fn noise_free_rays_give_the_point_back() {
        for point in [Point3::origin(), Point3::new(2.1, -0.9, 1.6), Point3::new(-2.3, 0.8, 0.2)] {
            let found = LinearPoint::new(&sightings(point), &[None; 3]).solve().unwrap();
            assert!((found - point).norm() < 1e-9, "{}", (found - point).norm());
        }
    }

    /// Equation (8) as the paper prints it, with `u w3` where `v w3` belongs. In its pixels, with
    /// its calibration matrix.
    #[test]
    fn the_printed_equation_is_tens_of_metres_wrong() {
        let point = Point3::new(2.1, -0.9, 1.6);
        let solve = |printed: bool| {
            let sightings = sightings(point);
            let mut rows = OMatrix::<f64, Dyn, U3>::zeros(2 * sightings.len());
            let mut right = OVector::<f64, Dyn>::zeros(2 * sightings.len());
            let calibration = Matrix3::new(2680.0, 0.0, 1920.0, 0.0, 2680.0, 1080.0, 0.0, 0.0, 1.0);
            for (frame, sighting) in sightings.iter().enumerate() {
                // The world is the body at rest here, so that R = 1 and t = 0 in (7) and (8).
                let rho = calibration * sighting.camera_from_body.rotation.to_rotation_matrix().matrix();
                let w = calibration * sighting.camera_from_body.translation.vector;
                let pixel = calibration * sighting.ray.push(1.0);
                let (u, v) = (pixel.x, pixel.y);
                rows.set_row(2 * frame, &(u * rho.row(2) - rho.row(0)));
                rows.set_row(2 * frame + 1, &(v * rho.row(2) - rho.row(1)));
                right[2 * frame] = w.x - u * w.z;
                right[2 * frame + 1] = w.y - if printed { u } else { v } * w.z;
            }
            LinearPoint { rows, right, sightings: sightings.len() }.solve().unwrap()
        };
        assert!((solve(false) - point).norm() < 1e-9);
        let wrong = (solve(true) - point).norm();
        assert!(wrong > 10.0, "only {wrong} m");
    }

    #[test]
    fn a_point_without_depth_is_drawn_to_the_body() {
        let truth = Point3::new(1.0, 0.3, 1.5);
        let mut sightings = sightings(truth)[..2].to_vec();
        sightings.iter_mut().for_each(|s| s.sigma = 1e-2);
        sightings[1].ray.x += 1e-3;
        let linear = LinearPoint::new(&sightings, &[None; 3]);
        let plain = linear.solve().unwrap();
        assert!((plain - truth).norm() > 2.0 && linear.largest_sigma_m() > 2.0);
        let drawn = linear.drawn_to_body(linear.spread(&plain)).solve().unwrap();
        assert!((drawn - truth).norm() < 1.0, "{drawn}");
    }

    #[test]
    fn one_frame_alone_does_not_determine_a_point() {
        let one = &sightings(Point3::new(1.0, 0.0, 1.0))[..1];
        assert!(LinearPoint::new(one, &[None; 3]).solve().is_none());
        let again = [one[0], one[0], one[0]];
        assert!(LinearPoint::new(&again, &[None; 3]).solve().is_none());
    }

    #[test]
    fn a_point_that_is_known_and_never_seen_has_a_place_and_no_scatter() {
        let known = [1.0, 2.0, 0.5].map(|value_m| Some(Known { value_m, sigma_m: 0.02 }));
        let linear = LinearPoint::new(&[], &known);
        let found = linear.solve().unwrap();
        assert!((found - Point3::new(1.0, 2.0, 0.5)).norm() < 1e-12);
        assert_eq!((linear.spread(&found), linear.has_heavy_tails(&found)), (1.0, false));
    }

    #[test]
    fn a_known_height_stands_in_for_a_second_frame() {
        let point = Point3::new(1.0, 0.3, 1.5);
        let height = Some(Known { value_m: 1.5, sigma_m: 0.0 });
        let one = &sightings(point)[..1];
        let found = LinearPoint::new(one, &[None, None, height]).solve().unwrap();
        assert!((found - point).norm() < 1e-6);
    }
}
