//! Rigid transforms, rotations and alignment.
//!
//! A transform is named `b_from_a`: it turns coordinates in `a` into coordinates in `b`, so that
//! equal names meet in the middle: `c_from_a = c_from_b * b_from_a`.

pub mod align;

use nalgebra::{Translation3, Vector3};
pub use trackbundle_solver::geometry::{Pose, pose, quaternion_wxyz, rotation, se3, skew};

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
}
