//! Rigid bodies whose frame is free, and a step that follows that freedom exactly.
//!
//! Points `M` of a body and its poses `T` can move to `G M`, `T G^-1` for any rigid motion `G`
//! without a change of `T M`: nothing that sees the body sees its frame. What holds the frame is
//! weak, so that a step moves far along this curved set, and a straight step leaves it by the square
//! of its rotation: a hundredth of a radian costs as much as all there was to gain, and the minimiser
//! crawls. So the rigid part of a step is taken out of the points, by least squares, and applied as
//! the rigid motion it stands for:
//!
//! ```text
//! d_j = v + w x M_j + e_j                    rigid part of the steps d of the points, and the rest
//! M_j <- exp(w) (M_j + e_j) + v
//! T_t <- (T_t + step without rigid part) G^-1,     G = (exp(w), v)
//! ```
//!
//! To first order this is the plain update, so that Jacobians are what they were.

use super::layout::{BlockId, Layout, Values};
use crate::geometry::{Pose, rotation::exp, skew};
use crate::manifold::{Manifold, read_pose, write_pose};
use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};
use std::ops::{AddAssign, SubAssign};

/// The points and poses of one rigid body, all of them free: the gauge orbit that a motion of its frame spans.
#[derive(Clone, Debug)]
pub(super) struct GaugeOrbit {
    pub points: Vec<BlockId>,
    pub poses: Vec<BlockId>,
}

impl GaugeOrbit {
    /// Moves the body's blocks in `moved`, which holds `values` moved by `step` block by block.
    pub(super) fn apply(&self, layout: &Layout, values: &Values, step: &[f64], moved: &mut Values) {
        let Some(motion) = self.rigid_part(layout, values, step) else { return };
        let (velocity, turn) = motion;
        let rotation = exp(&turn);
        for &block in &self.points {
            let point = Vector3::from_column_slice(layout.value(values, block));
            let delta = Vector3::from_column_slice(layout.step_of(block, step));
            let rest = delta - velocity - turn.cross(&point);
            layout.set_value(moved, block, (rotation * (point + rest) + velocity).as_slice());
        }
        let inverse = Pose::from_parts(velocity.into(), rotation).inverse();
        for &block in &self.poses {
            let value = layout.value(values, block);
            let mut delta = Vector6::from_column_slice(layout.step_of(block, step));
            let world_velocity = read_pose(value).rotation * velocity;
            delta.fixed_rows_mut::<3>(0).add_assign(&world_velocity);
            delta.fixed_rows_mut::<3>(3).add_assign(&turn);
            let mut pose = [0.0; 7];
            Manifold::Pose.plus(value, delta.as_slice(), &mut pose);
            let mut pose = read_pose(&pose) * inverse;
            pose.rotation.renormalize();
            layout.set_value(moved, block, &write_pose(&pose));
        }
    }

    /// `(v, w)` of the rigid part of the points' steps; `None` where the points lie on a line.
    fn rigid_part(
        &self,
        layout: &Layout,
        values: &Values,
        step: &[f64],
    ) -> Option<(Vector3<f64>, Vector3<f64>)> {
        let mut normal = Matrix6::zeros();
        let mut right = Vector6::zeros();
        for &block in &self.points {
            let point = Vector3::from_column_slice(layout.value(values, block));
            let delta = Vector3::from_column_slice(layout.step_of(block, step));
            // d = v - [M]x w
            let cross = skew(&point);
            normal.fixed_view_mut::<3, 3>(0, 0).add_assign(&Matrix3::identity());
            normal.fixed_view_mut::<3, 3>(0, 3).sub_assign(&cross);
            normal.fixed_view_mut::<3, 3>(3, 0).add_assign(&cross);
            normal.fixed_view_mut::<3, 3>(3, 3).sub_assign(&(cross * cross));
            right.fixed_rows_mut::<3>(0).add_assign(&delta);
            right.fixed_rows_mut::<3>(3).add_assign(&(cross * delta));
        }
        let largest = normal.diagonal().max();
        let solution = normal.cholesky()?;
        let smallest = solution.l_dirty().diagonal().map(|v| v * v).min();
        (smallest > 1e-9 * largest).then(|| {
            let solution = solution.solve(&right);
            (solution.fixed_rows::<3>(0).into(), solution.fixed_rows::<3>(3).into())
        })
    }
}
