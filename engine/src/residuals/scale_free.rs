//! What a vehicle does, told of a point of its body, its size counted in distances from the camera.
//!
//! ```text
//! r(T0, T1, ...; P)          a motion r of the poses T0 P, T1 P, ..., shifted to the point P of the body
//! r' = r D / |T P - C|       T one of the poses, C the camera, D a distance of this size
//! ```
//!
//! The scale of a vehicle moves it along its rays, and its accelerations grow with it, and how far it goes up and down
//! on the ground. White noise of unknown strength says nothing of that scale; but of `n` rows that weigh `r^2`, a
//! smaller scale makes all smaller, and the joint minimum goes that way by `n` times the variance of the scale (the
//! most probable values of all unknowns together are not those of one of them). Counted in distances from the camera,
//! they do not change with the scale, and there is nothing to gain.
//!
//! What goes along its rays is a point of the body, not the origin on the ground below it: where a smaller body would
//! hover, the origin stays on the ground. And how a vehicle leans is known worse than where the middle is of what is
//! seen of it: the motion of an origin below sees that uncertain lean times the height of what is seen, which a
//! smaller body makes less. So `P` is one of the points of the shape, an unknown like the poses. Every rigid motion
//! that is smooth at one point of the body is so at any other.
//!
//! Where nothing but its own poses holds the camera, it is an unknown that takes part in this, in two ways. The world
//! becomes smaller as a whole when the camera sinks: the distance must be that from where the camera is. And what moves
//! an image point may be put down to the vehicle or to the camera, which costs the less, counted in metres, the nearer
//! the vehicle is. So the motion of the camera is counted in the same distances.

use nalgebra::{Matrix3, Point3, RowVector3, RowVector6, SVector, Vector3};
use trackbundle_solver::manifold::{Manifold, read_pose, write_pose};
use trackbundle_solver::residual::{Jacobian, Residual};

/// Which rows are counted, and in which distance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Counting {
    /// The first so many.
    pub rows: usize,
    /// The block of the pose: of the body, or of the camera whose motion it is.
    pub pose: usize,
    /// About how far away it is \[m\].
    pub distance_m: f64,
}

/// By what rows are multiplied, and its derivatives.
struct Factor {
    value: f64,
    by_body: RowVector6<f64>,
    by_point: RowVector3<f64>,
    by_camera: RowVector3<f64>,
}

impl Counting {
    /// For a point of a body in this pose, seen from there.
    fn factor(&self, body: &[f64], point: &[f64], camera: &Vector3<f64>) -> Factor {
        let (body, point) = (read_pose(body), Vector3::from_column_slice(point));
        let turn = body.rotation.to_rotation_matrix();
        let ray = body.translation.vector + turn * point - camera;
        let distance = ray.norm().max(f64::MIN_POSITIVE);
        let value = self.distance_m / distance;
        let by_place = ray.transpose() * (-value / (distance * distance));
        let mut by_body = RowVector6::zeros();
        by_body.fixed_columns_mut::<3>(0).copy_from(&by_place);
        by_body.fixed_columns_mut::<3>(3).copy_from(&(by_place * by_turn(turn.matrix(), &point)));
        Factor { value, by_body, by_point: by_place * turn.matrix(), by_camera: -by_place }
    }

    fn rows_of<const ROWS: usize>(&self, value: SVector<f64, ROWS>, factor: &Factor) -> SVector<f64, ROWS> {
        SVector::from_fn(|row, _| if row < self.rows { factor.value * value[row] } else { value[row] })
    }

    /// Adds to a block of the Jacobian what comes from the derivatives of the factor by its first unknowns.
    fn apply<const ROWS: usize, const BLOCKS: usize, const N: usize>(
        &self,
        value: &SVector<f64, ROWS>,
        jacobian: &mut Jacobian<ROWS, BLOCKS>,
        (block, derivative): (usize, &nalgebra::SMatrix<f64, 1, N>),
    ) {
        for row in 0..self.rows {
            let mut columns = jacobian.0[block].fixed_view_mut::<1, N>(row, 0);
            columns += derivative * value[row];
        }
    }

    /// Makes the Jacobian of a residual that of its counted rows, the factor taken as constant.
    fn multiply<const ROWS: usize, const BLOCKS: usize>(
        &self,
        jacobian: &mut Jacobian<ROWS, BLOCKS>,
        factor: &Factor,
    ) {
        for block in &mut jacobian.0 {
            let mut rows = block.rows_mut(0, self.rows);
            rows *= factor.value;
        }
    }
}

/// `d (R exp(r) c) = -R [c]x r`
fn by_turn(turn: &Matrix3<f64>, point: &Vector3<f64>) -> Matrix3<f64> {
    -(turn * crate::geometry::skew(point))
}

/// The motion of a point of a body. Blocks: those of the motion, poses all; the point in the vehicle frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointMotion<R>(
    /// The motion of an origin.
    pub R,
);

/// A residual beside a point that it does not see. Blocks: its own, the point.
#[derive(Clone, Debug, PartialEq)]
pub struct WithPoint<R>(
    /// The residual.
    pub R,
);

/// What is counted from a place. Blocks: those of the residual, the last of which is a point of the body.
#[derive(Clone, Debug, PartialEq)]
pub struct ScaleFree<R> {
    /// What is counted.
    pub of: R,
    /// How.
    pub counting: Counting,
    /// The camera that sees the body in that pose.
    pub camera: Point3<f64>,
}

impl<const ROWS: usize, const N: usize, R: Residual<ROWS, N>> Residual<ROWS, N> for ScaleFree<R> {
    const MANIFOLDS: [Manifold; N] = R::MANIFOLDS;

    fn evaluate(
        &self,
        x: &[&[f64]; N],
        jacobian: Option<&mut Jacobian<ROWS, N>>,
    ) -> Option<SVector<f64, ROWS>> {
        let counting = &self.counting;
        let factor = counting.factor(x[counting.pose], x[N - 1], &self.camera.coords);
        let Some(jacobian) = jacobian else {
            return Some(counting.rows_of(self.of.evaluate(x, None)?, &factor));
        };
        let value = self.of.evaluate(x, Some(jacobian))?;
        counting.multiply(jacobian, &factor);
        counting.apply(&value, jacobian, (counting.pose, &factor.by_body));
        counting.apply(&value, jacobian, (N - 1, &factor.by_point));
        Some(counting.rows_of(value, &factor))
    }
}

/// What is counted from a camera wherever it goes. Blocks: those of the residual, the last of which is a point of the
/// body; the pose of the camera.
#[derive(Clone, Debug, PartialEq)]
pub struct ScaleFreeSeen<R> {
    /// What is counted.
    pub of: R,
    /// How.
    pub counting: Counting,
}

/// The motion of a camera, counted from a vehicle that it sees. Blocks: poses of the camera; the pose of the vehicle at
/// the one that the counting names; the point of the vehicle.
#[derive(Clone, Debug, PartialEq)]
pub struct ScaleFreeFrom<R> {
    /// What is counted.
    pub of: R,
    /// How.
    pub counting: Counting,
}

const fn with<const N: usize>(own: &[Manifold], others: &[Manifold]) -> [Manifold; N] {
    let mut all = [Manifold::POINT; N];
    let mut at = 0;
    while at < N {
        all[at] = if at < own.len() { own[at] } else { others[at - own.len()] };
        at += 1;
    }
    all
}

/// A residual and a point.
macro_rules! with_point {
    ($own:literal, $all:literal) => {
        impl<R: Residual<3, $own>> Residual<3, $all> for PointMotion<R> {
            const MANIFOLDS: [Manifold; $all] = with(&R::MANIFOLDS, &[Manifold::POINT]);

            fn evaluate(
                &self,
                x: &[&[f64]; $all],
                jacobian: Option<&mut Jacobian<3, $all>>,
            ) -> Option<Vector3<f64>> {
                let point = Vector3::from_column_slice(x[$own]);
                let poses: [_; $own] = std::array::from_fn(|at| read_pose(x[at]));
                let moved = poses.map(|mut pose| {
                    pose.translation.vector += pose.rotation * point;
                    write_pose(&pose)
                });
                let moved: [&[f64]; $own] = std::array::from_fn(|at| moved[at].as_slice());
                let Some(jacobian) = jacobian else { return self.0.evaluate(&moved, None) };
                let mut of_own = Jacobian::zeros();
                let value = self.0.evaluate(&moved, Some(&mut of_own))?;
                let mut by_point = Matrix3::zeros();
                for (at, pose) in poses.iter().enumerate() {
                    let turn = pose.rotation.to_rotation_matrix();
                    let by_place = of_own.0[at].fixed_view::<3, 3>(0, 0).into_owned();
                    jacobian.0[at] = of_own.0[at];
                    let mut columns = jacobian.0[at].fixed_view_mut::<3, 3>(0, 3);
                    columns += by_place * by_turn(turn.matrix(), &point);
                    by_point += by_place * turn.matrix();
                }
                jacobian.set($own, 0, &by_point);
                Some(value)
            }
        }

        impl<R: Residual<3, $own>> Residual<3, $all> for WithPoint<R> {
            const MANIFOLDS: [Manifold; $all] = with(&R::MANIFOLDS, &[Manifold::POINT]);

            fn evaluate(
                &self,
                x: &[&[f64]; $all],
                jacobian: Option<&mut Jacobian<3, $all>>,
            ) -> Option<Vector3<f64>> {
                let own: [&[f64]; $own] = std::array::from_fn(|at| x[at]);
                let Some(jacobian) = jacobian else { return self.0.evaluate(&own, None) };
                let mut of_own = Jacobian::zeros();
                let value = self.0.evaluate(&own, Some(&mut of_own))?;
                jacobian.0[..$own].copy_from_slice(&of_own.0);
                Some(value)
            }
        }
    };
}

with_point!(2, 3);
with_point!(3, 4);
with_point!(4, 5);

/// A residual whose last block is a point, and a camera.
macro_rules! seen {
    ($own:literal, $all:literal) => {
        impl<R: Residual<3, $own>> Residual<3, $all> for ScaleFreeSeen<R> {
            const MANIFOLDS: [Manifold; $all] = with(&R::MANIFOLDS, &[Manifold::Pose]);

            fn evaluate(
                &self,
                x: &[&[f64]; $all],
                jacobian: Option<&mut Jacobian<3, $all>>,
            ) -> Option<Vector3<f64>> {
                let counting = &self.counting;
                let own: [&[f64]; $own] = std::array::from_fn(|at| x[at]);
                let camera = read_pose(x[$own]).translation.vector;
                let factor = counting.factor(x[counting.pose], x[$own - 1], &camera);
                let Some(jacobian) = jacobian else {
                    return Some(counting.rows_of(self.of.evaluate(&own, None)?, &factor));
                };
                let mut of_own = Jacobian::zeros();
                let value = self.of.evaluate(&own, Some(&mut of_own))?;
                jacobian.0[..$own].copy_from_slice(&of_own.0);
                counting.multiply(jacobian, &factor);
                counting.apply(&value, jacobian, (counting.pose, &factor.by_body));
                counting.apply(&value, jacobian, ($own - 1, &factor.by_point));
                counting.apply(&value, jacobian, ($own, &factor.by_camera));
                Some(counting.rows_of(value, &factor))
            }
        }
    };
}

seen!(3, 4);
seen!(4, 5);
seen!(5, 6);

/// The motion of a camera, the pose of a vehicle, and a point of it.
macro_rules! from_vehicle {
    ($own:literal, $all:literal) => {
        impl<R: Residual<3, $own>> Residual<3, $all> for ScaleFreeFrom<R> {
            const MANIFOLDS: [Manifold; $all] = with(&R::MANIFOLDS, &[Manifold::Pose, Manifold::POINT]);

            fn evaluate(
                &self,
                x: &[&[f64]; $all],
                jacobian: Option<&mut Jacobian<3, $all>>,
            ) -> Option<Vector3<f64>> {
                let counting = &self.counting;
                let own: [&[f64]; $own] = std::array::from_fn(|at| x[at]);
                let camera = read_pose(x[counting.pose]).translation.vector;
                let factor = counting.factor(x[$own], x[$own + 1], &camera);
                let Some(jacobian) = jacobian else {
                    return Some(counting.rows_of(self.of.evaluate(&own, None)?, &factor));
                };
                let mut of_own = Jacobian::zeros();
                let value = self.of.evaluate(&own, Some(&mut of_own))?;
                jacobian.0[..$own].copy_from_slice(&of_own.0);
                counting.multiply(jacobian, &factor);
                counting.apply(&value, jacobian, (counting.pose, &factor.by_camera));
                counting.apply(&value, jacobian, ($own, &factor.by_body));
                counting.apply(&value, jacobian, ($own + 1, &factor.by_point));
                Some(counting.rows_of(value, &factor))
            }
        }
    };
}

from_vehicle!(3, 5);
from_vehicle!(4, 6);

#[cfg(test)]
mod tests {
    use super::super::ground_contact::{FirstContact, NextContact};
    use super::super::jerk::{FourSteps, LinearJerk};
    use super::super::smooth_motion::{Acceleration, Steps};
    use super::super::testing::{assert_jacobian, steady_curve, vehicle_poses};
    use super::super::twist::LinearAcceleration;
    use super::*;
    use crate::geometry::{Pose, pose};
    use crate::terrain::Terrain;

    const STEPS: Steps = Steps { first_s: 0.7, second_s: 1.1 };
    const IN_BODY: LinearAcceleration = LinearAcceleration(STEPS);
    const IN_WORLD: Acceleration = Acceleration(STEPS);
    const FOUR: LinearJerk = LinearJerk(FourSteps { first_s: 0.7, second_s: 1.1, third_s: 0.9 });
    const COUNTING: Counting = Counting { rows: 3, pose: 1, distance_m: 35.0 };
    const HEIGHT: Counting = Counting { rows: 1, pose: 0, distance_m: 35.0 };
    const POINT: [f64; 3] = [0.3, -0.2, 0.9];

    fn camera() -> Pose {
        pose([3.0, 5.0, 40.0], [0.1, 0.9, 0.0, 0.3])
    }

    fn contacts() -> (FirstContact, NextContact) {
        let terrain = Terrain::Plane { z_m: 0.7 };
        (FirstContact { terrain: terrain.clone() }, NextContact { terrain, correlation: 0.9 })
    }

    #[test]
    fn the_jacobians_are_those_of_their_differences() {
        let [a, b, c] = &vehicle_poses().map(|p| write_pose(&p));
        let (place, from) = (Point3::from(camera().translation.vector), write_pose(&camera()));
        assert_jacobian(&PointMotion(IN_BODY), &[a, b, c, &POINT]);
        assert_jacobian(&PointMotion(FOUR), &[a, b, c, b, &POINT]);
        let held = ScaleFree { of: PointMotion(IN_BODY), counting: COUNTING, camera: place };
        assert_jacobian(&held, &[a, b, c, &POINT]);
        assert_jacobian(&held, &[c, a, b, &POINT]);
        let held = ScaleFree { of: PointMotion(FOUR), counting: COUNTING, camera: place };
        assert_jacobian(&held, &[a, b, c, b, &POINT]);
        let seen = ScaleFreeSeen { of: PointMotion(IN_BODY), counting: COUNTING };
        assert_jacobian(&seen, &[a, b, c, &POINT, &from]);
        let seen = ScaleFreeSeen { of: PointMotion(FOUR), counting: COUNTING };
        assert_jacobian(&seen, &[a, b, c, b, &POINT, &from]);
        let of_camera = ScaleFreeFrom { of: IN_WORLD, counting: COUNTING };
        assert_jacobian(&of_camera, &[a, &from, c, b, &POINT]);
    }

    #[test]
    fn the_jacobians_of_contacts_are_those_of_their_differences() {
        let [a, b, _] = &vehicle_poses().map(|p| write_pose(&p));
        let (place, from) = (Point3::from(camera().translation.vector), write_pose(&camera()));
        let (first, next) = contacts();
        let held = ScaleFree { of: WithPoint(first.clone()), counting: HEIGHT, camera: place };
        assert_jacobian(&held, &[a, &[0.3], &POINT]);
        let held = ScaleFree { of: WithPoint(next.clone()), counting: HEIGHT, camera: place };
        assert_jacobian(&held, &[a, b, &[0.3], &POINT]);
        let seen = ScaleFreeSeen { of: WithPoint(first), counting: HEIGHT };
        assert_jacobian(&seen, &[a, &[0.3], &POINT, &from]);
        let seen = ScaleFreeSeen { of: WithPoint(next), counting: HEIGHT };
        assert_jacobian(&seen, &[a, b, &[0.3], &POINT, &from]);
    }

    #[test]
    fn a_steady_curve_is_one_at_each_point() {
        let curve = steady_curve(&[0.0, 0.7, 1.8]);
        let x = [curve[0].as_slice(), &curve[1], &curve[2], &[2.0, 0.7, 1.1]];
        assert!(PointMotion(IN_BODY).evaluate(&x, None).unwrap().norm() < 1e-12);
        assert!(PointMotion(IN_WORLD).evaluate(&x, None).unwrap().norm() > 1.0);
    }

    /// A body that is larger, as far away as that makes it, with its origin anywhere, moves as before.
    #[test]
    fn the_scale_changes_nothing() {
        let camera = Point3::new(3.0, 5.0, 40.0);
        let value = |scale: f64, up_m: f64| {
            let point = Vector3::from(POINT) * scale + Vector3::z() * up_m;
            let moved = vehicle_poses().map(|mut pose| {
                let seen = pose * Point3::from(POINT);
                let place = camera.coords + scale * (seen - camera);
                pose.translation.vector = place - pose.rotation * point;
                write_pose(&pose)
            });
            let held = ScaleFree { of: PointMotion(IN_BODY), counting: COUNTING, camera };
            held.evaluate(&[&moved[0], &moved[1], &moved[2], point.as_slice()], None).unwrap()
        };
        assert!((value(1.0, 0.0) - value(0.7, 11.7)).norm() < 1e-11 && value(1.0, 0.0).norm() > 0.1);
    }

    #[test]
    fn a_smaller_world_changes_nothing() {
        let scaled = |by: f64| {
            let of = |mut pose: Pose| {
                pose.translation.vector *= by;
                write_pose(&pose)
            };
            let camera = of(camera());
            let poses = vehicle_poses().map(of);
            let point = POINT.map(|v| v * by);
            let seen = ScaleFreeSeen { of: PointMotion(IN_BODY), counting: COUNTING };
            let seen = seen.evaluate(&[&poses[0], &poses[1], &poses[2], &point, &camera], None).unwrap();
            let from = ScaleFreeFrom { of: IN_WORLD, counting: COUNTING };
            let from = from.evaluate(&[&poses[0], &camera, &poses[1], &poses[2], &point], None).unwrap();
            [seen, from]
        };
        for (one, other) in scaled(1.0).into_iter().zip(scaled(0.7)) {
            assert!((one - other).norm() < 1e-11 && one.norm() > 0.1);
        }
    }
}
