//! Where unknowns live: vectors and poses, with the perturbation that the solver applies.
//!
//! A pose is stored as `[x, y, z, qw, qx, qy, qz]` (`world_from_body`) and moved by six numbers
//! `[dx, dy, dz, rx, ry, rz]`: the position by `d` \[m\] along the axes of the world, the attitude
//! by the rotation vector `r` \[rad\] about the axes of the body, `R <- R exp(r)`. Standard
//! deviations of a pose are those of this perturbation.

use crate::geometry::rotation::{exp, log, right_jacobian_inverse};
use crate::geometry::{self, Pose};
use nalgebra::{Matrix3, Matrix6, Point3, Vector3, Vector6};

/// The most numbers that perturb one block: every [`Jacobian`](crate::Jacobian) has room for as many.
pub const MAX_TANGENT: usize = 9;

/// The set that one block of unknowns lives in.
///
/// Laws: `plus(x, 0) = x`; `minus(plus(x, d), x) = d` for rotations below pi;
/// `plus(x, minus(y, x)) = y`.
///
/// ```
/// use trackbundle_solver::Manifold;
///
/// // A pose at the origin is moved up and turned by a right angle about its z axis.
/// let (start, mut moved) = ([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], [0.0; 7]);
/// let turn = std::f64::consts::FRAC_PI_2;
/// Manifold::Pose.plus(&start, &[0.0, 0.0, 5.0, 0.0, 0.0, turn], &mut moved);
/// assert_eq!(moved[2], 5.0);
/// let mut step = [0.0; 6];
/// Manifold::Pose.minus(&moved, &start, &mut step);
/// assert!((step[5] - turn).abs() < 1e-15);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Manifold {
    /// `n <= 9` plain numbers.
    Vector(usize),
    /// A rigid transform `world_from_body`.
    Pose,
    /// A rigid transform and `n <= 3` plain numbers after it, such as a camera with its lens.
    PoseAndVector(usize),
}

impl Manifold {
    /// A point in space.
    pub const POINT: Manifold = Manifold::Vector(3);
    /// One number.
    pub const SCALAR: Manifold = Manifold::Vector(1);

    /// How many numbers store a value.
    #[inline]
    pub const fn ambient(self) -> usize {
        match self {
            Manifold::Vector(n) => n,
            Manifold::Pose => 7,
            Manifold::PoseAndVector(n) => 7 + n,
        }
    }

    /// How many numbers perturb a value.
    #[inline]
    pub const fn tangent(self) -> usize {
        match self {
            Manifold::Vector(n) => n,
            Manifold::Pose => 6,
            Manifold::PoseAndVector(n) => 6 + n,
        }
    }

    /// Writes `x` moved by `delta` to `moved`.
    #[inline]
    pub fn plus(self, x: &[f64], delta: &[f64], moved: &mut [f64]) {
        match self {
            Manifold::Vector(n) => (0..n).for_each(|i| moved[i] = x[i] + delta[i]),
            Manifold::Pose => {
                let mut value = read_pose(x);
                value.translation.vector += Vector3::from_column_slice(&delta[..3]);
                value.rotation *= exp(&Vector3::from_column_slice(&delta[3..6]));
                value.rotation.renormalize();
                moved.copy_from_slice(&write_pose(&value));
            }
            Manifold::PoseAndVector(n) => {
                Manifold::Pose.plus(&x[..7], &delta[..6], &mut moved[..7]);
                Manifold::Vector(n).plus(&x[7..], &delta[6..], &mut moved[7..]);
            }
        }
    }

    /// Writes the perturbation that moves `x` to `y` to `delta`.
    pub fn minus(self, y: &[f64], x: &[f64], delta: &mut [f64]) {
        match self {
            Manifold::Vector(n) => (0..n).for_each(|i| delta[i] = y[i] - x[i]),
            Manifold::Pose => {
                delta.copy_from_slice(pose_minus(&read_pose(y), &read_pose(x)).as_slice());
            }
            Manifold::PoseAndVector(n) => {
                Manifold::Pose.minus(&y[..7], &x[..7], &mut delta[..6]);
                Manifold::Vector(n).minus(&y[7..], &x[7..], &mut delta[6..]);
            }
        }
    }
}

/// The perturbation that moves `x` to `y`: `[position in the world; log(Rx^T Ry)]` \[m, rad\].
#[inline]
pub fn pose_minus(y: &Pose, x: &Pose) -> Vector6<f64> {
    let mut delta = Vector6::zeros();
    delta.fixed_rows_mut::<3>(0).copy_from(&(y.translation.vector - x.translation.vector));
    delta.fixed_rows_mut::<3>(3).copy_from(&log(&(x.rotation.inverse() * y.rotation)));
    delta
}

/// Derivative of [`pose_minus`] with respect to the perturbation of `y`, 6 x 6.
#[inline]
pub fn pose_minus_jacobian(y: &Pose, x: &Pose) -> Matrix6<f64> {
    let mut jacobian = Matrix6::identity();
    let turn = log(&(x.rotation.inverse() * y.rotation));
    jacobian.fixed_view_mut::<3, 3>(3, 3).copy_from(&right_jacobian_inverse(&turn));
    jacobian
}

/// The perturbation of `body` that looks from `observer` like a perturbation of the observer, 6 x 6:
/// who sees the body from the observer alone cannot tell the two apart.
///
/// ```text
/// X = Ro^T (Rb M + tb - to):   dtb = -dto + [tb - to]x Ro dro,   drb = -Rb^T Ro dro
/// ```
pub fn body_from_observer_motion(observer: &Pose, body: &Pose) -> Matrix6<f64> {
    let (turn, own) = (observer.rotation.to_rotation_matrix(), body.rotation.to_rotation_matrix());
    let between = body.translation.vector - observer.translation.vector;
    let mut motion = Matrix6::zeros();
    motion.fixed_view_mut::<3, 3>(0, 0).copy_from(&-Matrix3::identity());
    motion.fixed_view_mut::<3, 3>(0, 3).copy_from(&(geometry::skew(&between) * turn.matrix()));
    motion.fixed_view_mut::<3, 3>(3, 3).copy_from(&-(own.matrix().transpose() * turn.matrix()));
    motion
}

/// The pose stored in seven numbers, as they are (they hold a unit quaternion).
#[inline]
pub fn read_pose(x: &[f64]) -> Pose {
    use nalgebra::{Quaternion, Translation3, UnitQuaternion};
    Pose::from_parts(
        Translation3::new(x[0], x[1], x[2]),
        UnitQuaternion::new_unchecked(Quaternion::new(x[3], x[4], x[5], x[6])),
    )
}

/// The seven numbers that store a pose.
#[inline]
pub fn write_pose(pose: &Pose) -> [f64; 7] {
    let [w, x, y, z] = geometry::quaternion_wxyz(pose);
    let p = pose.translation.vector;
    [p.x, p.y, p.z, w, x, y, z]
}

/// The point stored in three numbers.
#[inline]
pub fn read_point(x: &[f64]) -> Point3<f64> {
    Point3::new(x[0], x[1], x[2])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn obeys_the_laws(manifold: Manifold, x: &[f64], delta: &[f64]) {
        let moved = |x: &[f64], delta: &[f64]| {
            let mut out = vec![0.0; manifold.ambient()];
            manifold.plus(x, delta, &mut out);
            out
        };
        let difference = |y: &[f64], x: &[f64]| {
            let mut out = vec![0.0; manifold.tangent()];
            manifold.minus(y, x, &mut out);
            out
        };
        let gap =
            |a: &[f64], b: &[f64]| -> f64 { a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) };
        assert!(gap(&moved(x, &vec![0.0; delta.len()]), x) < 1e-15, "x + 0 = x");
        let y = moved(x, delta);
        assert!(gap(&difference(&y, x), delta) < 1e-12, "(x + d) - x = d");
        assert!(gap(&moved(x, &difference(&y, x)), &y) < 1e-14, "x + (y - x) = y");
    }

    #[test]
    fn every_manifold_obeys_the_laws() {
        obeys_the_laws(Manifold::SCALAR, &[2.0], &[-0.7]);
        obeys_the_laws(Manifold::POINT, &[1.0, -2.0, 3.0], &[0.1, 0.2, 0.3]);
        let x = write_pose(&geometry::pose([1.0, -2.0, 30.0], [0.5, 0.5, -0.1, 0.7]));
        for turn in [0.0, 1e-9, 0.3, 3.1] {
            let turn = Vector3::new(0.6, -0.48, 0.64) * turn;
            obeys_the_laws(Manifold::Pose, &x, &[0.1, -4.0, 2.0, turn.x, turn.y, turn.z]);
            let with_lens = [x.as_slice(), &[2.0, -1.0]].concat();
            let delta = [0.1, -4.0, 2.0, turn.x, turn.y, turn.z, 0.5, 0.25];
            obeys_the_laws(Manifold::PoseAndVector(2), &with_lens, &delta);
        }
    }

    #[test]
    fn a_motion_of_the_observer_looks_like_one_of_the_body() {
        let observer = geometry::pose([1.0, 2.0, 30.0], [0.1, 0.9, 0.2, -0.3]);
        let body = geometry::pose([4.0, -2.5, 1.0], [0.7, -0.4, 0.1, 0.3]);
        let point = Point3::new(1.0, -0.5, 1.5);
        let moved = |pose: &Pose, delta: &[f64]| {
            let mut out = [0.0; 7];
            Manifold::Pose.plus(&write_pose(pose), delta, &mut out);
            read_pose(&out)
        };
        let motion = body_from_observer_motion(&observer, &body);
        for column in 0..6 {
            let mut delta = [0.0; 6];
            delta[column] = 1e-6;
            let seen = moved(&observer, &delta).inverse() * (body * point);
            let same: Vector6<f64> = motion.column(column) * 1e-6;
            let wanted = observer.inverse() * (moved(&body, same.as_slice()) * point);
            assert!((seen - wanted).norm() < 1e-9, "column {column}: {}", (seen - wanted).norm());
            assert!((seen - observer.inverse() * (body * point)).norm() > 1e-7);
        }
    }

    #[test]
    fn the_derivative_of_minus_is_that_of_its_differences() {
        let x = geometry::pose([1.0, 2.0, 3.0], [0.9, 0.1, 0.2, -0.3]);
        let y = geometry::pose([0.0, 2.5, 1.0], [0.7, -0.4, 0.1, 0.3]);
        let analytic = pose_minus_jacobian(&y, &x);
        for column in 0..6 {
            let at = |step: f64| {
                let mut delta = [0.0; 6];
                delta[column] = step;
                let mut moved = [0.0; 7];
                Manifold::Pose.plus(&write_pose(&y), &delta, &mut moved);
                pose_minus(&read_pose(&moved), &x)
            };
            let slope = (at(1e-6) - at(-1e-6)) / 2e-6;
            assert!((slope - analytic.column(column)).norm() < 1e-8, "column {column}");
        }
    }
}
