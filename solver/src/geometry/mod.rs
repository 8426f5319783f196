//! Rigid transforms and rotations.
//!
//! A transform is named `b_from_a`: it turns coordinates in `a` into coordinates in `b`, so that
//! equal names meet in the middle: `c_from_a = c_from_b * b_from_a`.

pub mod rotation;
pub mod se3;

use nalgebra::{Isometry3, Matrix3, Quaternion, Translation3, UnitQuaternion, Vector3};

/// A rigid transform `b_from_a`: rotation (unit quaternion) and position of `a`'s origin in `b` \[m\].
pub type Pose = Isometry3<f64>;

/// A pose from a position \[m\] and a Hamilton quaternion, scalar first, which is normalised.
#[inline]
pub fn pose(position_m: [f64; 3], quaternion_wxyz: [f64; 4]) -> Pose {
    let [w, x, y, z] = quaternion_wxyz;
    Pose::from_parts(
        Translation3::from(Vector3::from(position_m)),
        UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z)),
    )
}

/// The quaternion of a pose, scalar first, with the sign that makes the scalar non-negative.
#[inline]
pub fn quaternion_wxyz(pose: &Pose) -> [f64; 4] {
    let q = pose.rotation.quaternion();
    let sign = if q.w < 0.0 { -1.0 } else { 1.0 };
    [sign * q.w, sign * q.i, sign * q.j, sign * q.k]
}

/// The matrix `[v]x` with `[v]x w = v x w`.
#[inline]
pub fn skew(v: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -v.z, v.y, v.z, 0.0, -v.x, -v.y, v.x, 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quaternion_is_written_with_a_non_negative_scalar() {
        let found = quaternion_wxyz(&pose([0.0; 3], [-0.6, 0.8, 0.0, 0.0]));
        for (found, wanted) in found.iter().zip([0.6, -0.8, 0.0, 0.0]) {
            assert!((found - wanted).abs() < 1e-15);
        }
    }
}
