//! Rigid transforms, rotations and alignment.
//!
//! A transform is named `b_from_a`: it turns coordinates in `a` into coordinates in `b`, so that
//! equal names meet in the middle: `c_from_a = c_from_b * b_from_a`.

pub mod align;
pub mod rotation;
pub mod se3;

use nalgebra::{Isometry3, Matrix3, Quaternion, Translation3, UnitQuaternion, Vector3};

/// A rigid transform `b_from_a`: rotation (unit quaternion) and position of `a`'s origin in `b` \[m\].
pub type Pose = Isometry3<f64>;

/// A pose from a position \[m\] and a Hamilton quaternion, scalar first, which is normalised.
pub fn pose(position_m: [f64; 3], quaternion_wxyz: [f64; 4]) -> Pose {
    let [w, x, y, z] = quaternion_wxyz;
    Pose::from_parts(
        Translation3::from(Vector3::from(position_m)),
        UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z)),
    )
}

/// The quaternion of a pose, scalar first, with the sign that makes the scalar non-negative.
pub fn quaternion_wxyz(pose: &Pose) -> [f64; 4] {
    let q = pose.rotation.quaternion();
    let sign = if q.w < 0.0 { -1.0 } else { 1.0 };
    [sign * q.w, sign * q.i, sign * q.j, sign * q.k]
}

/// The matrix `[v]x` with `[v]x w = v x w`.
pub fn skew(v: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -v.z, v.y, v.z, 0.0, -v.x, -v.y, v.x, 0.0)
}

/// Heading of the body's x axis, counter-clockwise from the world's x axis, in (-pi, pi] \[rad\].
pub fn heading_rad(world_from_body: &Pose) -> f64 {
    let forward = world_from_body.rotation * Vector3::x();
    let heading = forward.y.atan2(forward.x);
    if heading <= -std::f64::consts::PI { std::f64::consts::PI } else { heading }
}

/// The pose at `fraction` of the way from `a` to `b`: position linear, attitude on the shortest arc.
pub fn interpolate(a: &Pose, b: &Pose, fraction: f64) -> Pose {
    let turn = rotation::log(&(a.rotation.inverse() * b.rotation));
    Pose::from_parts(
        Translation3::from(a.translation.vector + fraction * (b.translation.vector - a.translation.vector)),
        a.rotation * rotation::exp(&(fraction * turn)),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heading_covers_the_half_open_circle() {
        let at = |degrees: f64| {
            heading_rad(&Pose::from_parts(
                Translation3::identity(),
                rotation::exp(&(Vector3::z() * degrees.to_radians())),
            ))
            .to_degrees()
        };
        for (given, wanted) in [(0.0, 0.0), (90.0, 90.0), (-90.0, -90.0), (200.0, -160.0), (-180.0, 180.0)] {
            assert!((at(given) - wanted).abs() < 1e-9, "{given}: {}", at(given));
        }
    }

    #[test]
    fn interpolation_meets_its_ends_and_halves_the_turn() {
        let a = pose([0.0, 1.0, 2.0], [1.0, 0.0, 0.0, 0.0]);
        let b = pose([4.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]);
        for (fraction, wanted) in [(0.0, a), (1.0, b)] {
            let found = interpolate(&a, &b, fraction);
            assert!((found.translation.vector - wanted.translation.vector).norm() < 1e-12);
            assert!(found.rotation.angle_to(&wanted.rotation) < 1e-7);
        }
        assert!((interpolate(&a, &b, 0.5).rotation.angle() - std::f64::consts::FRAC_PI_2) < 1e-12);
    }

    #[test]
    fn a_quaternion_is_written_with_a_non_negative_scalar() {
        let found = quaternion_wxyz(&pose([0.0; 3], [-0.6, 0.8, 0.0, 0.0]));
        for (found, wanted) in found.iter().zip([0.6, -0.8, 0.0, 0.0]) {
            assert!((found - wanted).abs() < 1e-15);
        }
    }
}
