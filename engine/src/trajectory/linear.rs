//! How a state of a path follows from its poses, to first order.

use super::{State, Trajectory};
use crate::geometry::{Pose, se3, skew};
use nalgebra::{Matrix6, SMatrix};
use std::ops::Range;

/// Derivative of a state by the perturbation of one pose.
pub type StateBlock = SMatrix<f64, 12, 6>;
/// Covariance of a state.
pub type StateCovariance = SMatrix<f64, 12, 12>;

/// A state, and its derivatives. The twelve rows are its perturbation: position in the world \[m\] and
/// attitude in the body \[rad\], as [`trackbundle_solver::manifold`] perturbs poses, velocity in the world
/// \[m/s\], angular velocity in the body \[rad/s\].
#[derive(Clone, Debug, PartialEq)]
pub struct Linear {
    /// The state.
    pub state: State,
    /// The poses on which it depends, by their index.
    pub knots: Range<usize>,
    /// Derivative by the perturbation of each of them.
    pub blocks: Vec<StateBlock>,
    /// What the poses leave open, even if they were known exactly.
    pub process: StateCovariance,
}

impl Linear {
    /// Covariance of the state, given those of the poses: `covariance(i, j)` is that of the
    /// perturbations of poses `i` and `j`, indices as in [`Linear::knots`].
    pub fn covariance(&self, covariance: impl Fn(usize, usize) -> Matrix6<f64>) -> StateCovariance {
        let mut sum = self.process;
        for (i, left) in self.knots.clone().zip(&self.blocks) {
            for (j, right) in self.knots.clone().zip(&self.blocks) {
                sum += left * covariance(i, j) * right.transpose();
            }
        }
        sum
    }
}

impl Trajectory {
    /// The state at a time and its derivatives; `None` where there is no state.
    ///
    /// A pose that is perturbed by `d_k` is `T_k exp(A_k d_k)`, `A_k = [R_k^T 0; 0 1]`, and to first
    /// order
    ///
    /// ```text
    /// dxi_k = Jr^-1(xi_k) A_k d_k - Jl^-1(xi_k) A_r d_r
    /// T(t) moves by exp(Jr(xi) dxi + Ad(exp(-xi)) A_r d_r) on its right
    /// d[v; w] = d(Jr(xi) xi')/dxi dxi + Jr(xi) dxi'
    /// ```
    pub fn linear_at(&self, time_s: f64) -> Option<Linear> {
        let local = self.local(time_s)?;
        let reference = &self.poses[local.reference];
        let state = local.state(reference);
        let outward = outward(&state);
        let jacobian = se3::right_jacobian(&local.twist);
        let mut from_local = StateCovariance::zeros();
        from_local.fixed_view_mut::<6, 6>(0, 0).copy_from(&jacobian);
        from_local.fixed_view_mut::<6, 6>(6, 6).copy_from(&jacobian);
        let slope = se3::right_jacobian_slope(&local.twist, &local.rate);
        from_local.fixed_view_mut::<6, 6>(6, 0).copy_from(&slope);
        from_local = outward * from_local;

        let weights = &local.path.weights;
        let mut by_reference = StateBlock::zeros();
        let mut blocks: Vec<StateBlock> = Vec::with_capacity(local.twists.len());
        for (at, (knot, xi)) in local.knots.clone().zip(&local.twists).enumerate() {
            let of_local = |twist: Matrix6<f64>| {
                let mut block = StateBlock::zeros();
                block.fixed_view_mut::<6, 6>(0, 0).copy_from(&(twist * weights[(0, at)]));
                block.fixed_view_mut::<6, 6>(6, 0).copy_from(&(twist * weights[(1, at)]));
                block
            };
            let own = se3::right_jacobian_inverse(xi) * inward(&self.poses[knot]);
            blocks.push(from_local * of_local(own));
            by_reference -= of_local(se3::left_jacobian_inverse(xi));
        }
        let mut carried = StateBlock::zeros();
        let back = se3::adjoint(&se3::exp(&-local.twist));
        carried.fixed_view_mut::<6, 6>(0, 0).copy_from(&back);
        let by_reference = (from_local * by_reference + outward * carried) * inward(reference);
        blocks[local.reference - local.knots.start] += by_reference;

        let densities = [self.strengths.linear.powi(2), self.strengths.angular.powi(2)];
        let mut open = StateCovariance::zeros();
        for (i, j) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
            for axis in 0..6 {
                open[(6 * i + axis, 6 * j + axis)] = local.path.covariance[(i, j)] * densities[axis / 3];
            }
        }
        let process = from_local * open * from_local.transpose();
        Some(Linear { state, knots: local.knots, blocks, process })
    }
}

/// `A`: the perturbation in body axes by that of the manifold.
fn inward(pose: &Pose) -> Matrix6<f64> {
    let mut matrix = Matrix6::identity();
    let turn = pose.rotation.to_rotation_matrix();
    matrix.fixed_view_mut::<3, 3>(0, 0).copy_from(&turn.matrix().transpose());
    matrix
}

/// The perturbation of a state by that of its pose and its twist in body axes.
fn outward(state: &State) -> StateCovariance {
    let turn = state.pose.rotation.to_rotation_matrix();
    let velocity = state.pose.rotation.inverse() * state.velocity_mps;
    let mut matrix = StateCovariance::identity();
    matrix.fixed_view_mut::<3, 3>(0, 0).copy_from(turn.matrix());
    matrix.fixed_view_mut::<3, 3>(6, 3).copy_from(&-(turn.matrix() * skew(&velocity)));
    matrix.fixed_view_mut::<3, 3>(6, 6).copy_from(turn.matrix());
    matrix
}
