//! Measurements for the tests of the system.

use crate::geometry::{Pose, skew};
use crate::manifold::{MAX_TANGENT, Manifold, pose_minus, pose_minus_jacobian, read_point, read_pose};
use crate::residual::{Jacobian, Residual};
use nalgebra::{RowVector3, SMatrix, SVector, Vector1, Vector3};

/// Difference of two poses and a measured one.
pub(super) struct Between(pub Pose);

impl Residual<6, 2> for Between {
    const MANIFOLDS: [Manifold; 2] = [Manifold::Pose; 2];
    fn evaluate(&self, x: &[&[f64]; 2], jacobian: Option<&mut Jacobian<6, 2>>) -> Option<SVector<f64, 6>> {
        // Of the first pose against the second moved by the measurement; by the second, numerically.
        let (a, b) = (read_pose(x[0]), read_pose(x[1]));
        let value = |b: &Pose| pose_minus(&a, &(b * self.0));
        if let Some(jacobian) = jacobian {
            jacobian.set(0, 0, &pose_minus_jacobian(&a, &(b * self.0)));
            let mut by_b = SMatrix::<f64, 6, 6>::zeros();
            for column in 0..6 {
                let at = |step: f64| {
                    let mut delta = [0.0; 6];
                    delta[column] = step;
                    let mut moved = [0.0; 7];
                    Manifold::Pose.plus(x[1], &delta, &mut moved);
                    value(&read_pose(&moved))
                };
                by_b.set_column(column, &((at(1e-5) - at(-1e-5)) / 2e-5));
            }
            jacobian.set(1, 0, &by_b);
        }
        Some(value(&b))
    }
}

/// Distance of a point, in the frame of a pose, from a measured place. Impossible above z = 50.
pub(super) struct Seen(pub Vector3<f64>);

impl Residual<3, 2> for Seen {
    const MANIFOLDS: [Manifold; 2] = [Manifold::Pose, Manifold::POINT];
    fn evaluate(&self, x: &[&[f64]; 2], jacobian: Option<&mut Jacobian<3, 2>>) -> Option<Vector3<f64>> {
        let pose = read_pose(x[0]);
        let point = Vector3::from_column_slice(x[1]);
        let inverse = pose.rotation.inverse().to_rotation_matrix();
        let local = inverse * (point - pose.translation.vector);
        if let Some(jacobian) = jacobian {
            jacobian.set(0, 0, &-inverse.matrix());
            jacobian.set(0, 3, &skew(&local));
            jacobian.set(1, 0, inverse.matrix());
        }
        (point.z < 50.0).then(|| local - self.0)
    }
}

/// One coordinate of a point against a scalar.
pub(super) struct Level(pub usize);

impl Residual<1, 2> for Level {
    const MANIFOLDS: [Manifold; 2] = [Manifold::POINT, Manifold::SCALAR];
    fn evaluate(&self, x: &[&[f64]; 2], jacobian: Option<&mut Jacobian<1, 2>>) -> Option<Vector1<f64>> {
        if let Some(jacobian) = jacobian {
            let mut row = RowVector3::zeros();
            row[self.0] = 1.0;
            jacobian.set(0, 0, &row);
            jacobian.set(1, 0, &SMatrix::<f64, 1, 1>::new(-1.0));
        }
        Some(Vector1::new(x[0][self.0] - x[1][0]))
    }
}

/// A pinhole with `N` numbers of a lens that scale the image, as a bundle adjustment sees it.
pub(super) struct Image<const N: usize>(pub [f64; 2]);

impl<const N: usize> Residual<2, 2> for Image<N> {
    const MANIFOLDS: [Manifold; 2] = [Manifold::PoseAndVector(N), Manifold::POINT];
    fn evaluate(&self, x: &[&[f64]; 2], jacobian: Option<&mut Jacobian<2, 2>>) -> Option<SVector<f64, 2>> {
        let at = |camera: &[f64], point: &[f64]| {
            let point = read_point(point);
            let local = read_pose(&camera[..7]).inverse_transform_point(&point);
            let ray = SVector::<f64, 2>::new(local.x / local.z, local.y / local.z);
            let lens = |(power, k): (usize, &f64)| k * (10.0 * ray.norm_squared()).powi(power as i32);
            ray * (1.0 + camera[7..].iter().enumerate().map(lens).sum::<f64>())
        };
        if let Some(jacobian) = jacobian {
            for (block, manifold) in Self::MANIFOLDS.iter().enumerate() {
                for column in 0..manifold.tangent() {
                    let moved = |step: f64| {
                        let mut delta = [0.0; MAX_TANGENT];
                        delta[column] = step;
                        let mut moved = vec![0.0; manifold.ambient()];
                        manifold.plus(x[block], &delta[..manifold.tangent()], &mut moved);
                        if block == 0 { at(&moved, x[1]) } else { at(x[0], &moved) }
                    };
                    jacobian.set(block, column, &((moved(1e-5) - moved(-1e-5)) / 2e-5));
                }
            }
        }
        Some(at(x[0], x[1]) - SVector::from(self.0))
    }
}

/// What an observer sees of a point of a body.
pub(super) struct Sight(pub [f64; 2]);

impl Residual<2, 3> for Sight {
    const MANIFOLDS: [Manifold; 3] = [Manifold::Pose, Manifold::Pose, Manifold::POINT];
    fn evaluate(&self, x: &[&[f64]; 3], jacobian: Option<&mut Jacobian<2, 3>>) -> Option<SVector<f64, 2>> {
        let (observer, body) = (read_pose(x[0]), read_pose(x[1]));
        let point = read_point(x[2]);
        let local = observer.inverse_transform_point(&(body * point));
        let ray = SVector::<f64, 2>::new(local.x, local.y) / local.z;
        if let Some(jacobian) = jacobian {
            let by_local = SMatrix::<f64, 2, 3>::new(1.0, 0.0, -ray.x, 0.0, 1.0, -ray.y) / local.z;
            let to_local = observer.rotation.inverse().to_rotation_matrix();
            let by_world = by_local * to_local.matrix();
            let by_point = by_world * body.rotation.to_rotation_matrix().matrix();
            jacobian.set(0, 0, &-by_world);
            jacobian.set(0, 3, &(by_local * skew(&local.coords)));
            jacobian.set(1, 0, &by_world);
            jacobian.set(1, 3, &-(by_point * skew(&point.coords)));
            jacobian.set(2, 0, &by_point);
        }
        Some(ray - SVector::from(self.0))
    }
}

/// The same through a lens that all moments share: `s` scales the ray, `d` shifts it.
pub(super) struct LensSight(pub [f64; 2]);

impl Residual<2, 4> for LensSight {
    const MANIFOLDS: [Manifold; 4] = [Manifold::Pose, Manifold::Pose, Manifold::POINT, Manifold::Vector(3)];
    fn evaluate(&self, x: &[&[f64]; 4], jacobian: Option<&mut Jacobian<2, 4>>) -> Option<SVector<f64, 2>> {
        let (scale, shift) = (1.0 + x[3][0], SVector::<f64, 2>::new(x[3][1], x[3][2]));
        let mut plain = Jacobian::zeros();
        let ray = Sight([0.0; 2]).evaluate(&[x[0], x[1], x[2]], Some(&mut plain))?;
        if let Some(jacobian) = jacobian {
            (0..3).for_each(|block| jacobian.0[block] = plain.0[block] * scale);
            jacobian.set(3, 0, &ray);
            jacobian.set(3, 1, &SMatrix::<f64, 2, 2>::identity());
        }
        Some(ray * scale + shift - SVector::from(self.0))
    }
}

/// Difference of a pose from a given one.
pub(super) struct Near(pub Pose);

impl Residual<6, 1> for Near {
    const MANIFOLDS: [Manifold; 1] = [Manifold::Pose];
    fn evaluate(&self, x: &[&[f64]; 1], jacobian: Option<&mut Jacobian<6, 1>>) -> Option<SVector<f64, 6>> {
        let pose = read_pose(x[0]);
        if let Some(jacobian) = jacobian {
            jacobian.set(0, 0, &pose_minus_jacobian(&pose, &self.0));
        }
        Some(pose_minus(&pose, &self.0))
    }
}

/// The last number of a lens is known.
pub(super) struct Calibrated;

impl Residual<1, 1> for Calibrated {
    const MANIFOLDS: [Manifold; 1] = [Manifold::Vector(3)];
    fn evaluate(&self, x: &[&[f64]; 1], jacobian: Option<&mut Jacobian<1, 1>>) -> Option<SVector<f64, 1>> {
        if let Some(jacobian) = jacobian {
            jacobian.set(0, 2, &SVector::<f64, 1>::new(1.0));
        }
        Some(SVector::<f64, 1>::new(x[0][2]))
    }
}
