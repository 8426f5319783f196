//! Mean velocities between neighbouring frames, and how they change: what smooth motion is made of.

use crate::geometry::rotation::{
    left_jacobian_inverse, left_jacobian_inverse_slope, log, right_jacobian_inverse,
};
use crate::geometry::{Pose, skew};
use nalgebra::{Matrix3, Matrix3x6, Vector3};
use trackbundle_solver::manifold::read_pose;
use trackbundle_solver::residual::Jacobian;

/// The times between three neighbouring frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Steps {
    /// From the first to the second \[s\].
    pub first_s: f64,
    /// From the second to the third \[s\].
    pub second_s: f64,
}

impl Steps {
    /// Over what time the acceleration is a mean \[s\].
    pub fn mean_s(&self) -> f64 {
        0.5 * (self.first_s + self.second_s)
    }

    /// How much a mean velocity changes over that time.
    pub(super) fn evaluate(
        &self,
        x: &[&[f64]; 3],
        rate: impl Fn(&Pose, &Pose, f64) -> MeanRate,
        jacobian: Option<&mut Jacobian<3, 3>>,
    ) -> Vector3<f64> {
        let [t0, t1, t2] = x.map(read_pose);
        let rates = [rate(&t0, &t1, self.first_s), rate(&t1, &t2, self.second_s)];
        let weight = 1.0 / self.mean_s();
        combined(&rates, &[-weight, weight], jacobian)
    }
}

/// A mean velocity between two poses and its derivatives by their perturbations.
pub(super) struct MeanRate {
    /// The velocity \[m/s or rad/s\].
    pub value: Vector3<f64>,
    /// By the pose before.
    pub by_first: Matrix3x6<f64>,
    /// By the pose after.
    pub by_second: Matrix3x6<f64>,
}

impl MeanRate {
    /// Of the position in the world \[m/s\], over `step_s`.
    pub fn of_position(from: &Pose, to: &Pose, step_s: f64) -> Self {
        let by_second = joined(&(Matrix3::identity() / step_s), &Matrix3::zeros());
        let value = (to.translation.vector - from.translation.vector) / step_s;
        MeanRate { value, by_first: -by_second, by_second }
    }

    /// The angular part of the twist \[rad/s\]: `log(R0^T R1) / h`.
    pub fn angular(from: &Pose, to: &Pose, step_s: f64) -> Self {
        let turn = log(&(from.rotation.inverse() * to.rotation));
        // log((R exp(a))^T S exp(b)) = phi - Jl^-1(phi) a + Jr^-1(phi) b to first order.
        let by_first = joined(&Matrix3::zeros(), &(left_jacobian_inverse(&turn) / -step_s));
        let by_second = joined(&Matrix3::zeros(), &(right_jacobian_inverse(&turn) / step_s));
        MeanRate { value: turn / step_s, by_first, by_second }
    }

    /// The linear part of the twist, in the axes of the body \[m/s\]: `Jl^-1(phi) R0^T (p1 - p0) / h`.
    pub fn linear(from: &Pose, to: &Pose, step_s: f64) -> Self {
        let turn = log(&(from.rotation.inverse() * to.rotation));
        let to_body = from.rotation.inverse().to_rotation_matrix().into_inner();
        let moved = to_body * (to.translation.vector - from.translation.vector);
        let inverse = left_jacobian_inverse(&turn);
        // exp(-a) g = g + [g]x a to first order.
        let by_turn = left_jacobian_inverse_slope(&turn, &moved);
        let by_position = inverse * to_body / step_s;
        let by_first = (inverse * skew(&moved) - by_turn * inverse) / step_s;
        let by_second = by_turn * right_jacobian_inverse(&turn) / step_s;
        MeanRate {
            value: inverse * moved / step_s,
            by_first: joined(&-by_position, &by_first),
            by_second: joined(&by_position, &by_second),
        }
    }
}

/// The sum of weighted rates, the next of which begins at the pose where the last one ends.
pub(super) fn combined<const BLOCKS: usize>(
    rates: &[MeanRate],
    weights: &[f64],
    jacobian: Option<&mut Jacobian<3, BLOCKS>>,
) -> Vector3<f64> {
    if let Some(jacobian) = jacobian {
        for (at, (rate, weight)) in rates.iter().zip(weights).enumerate() {
            for (block, part) in [(at, rate.by_first), (at + 1, rate.by_second)] {
                let mut columns = jacobian.0[block].fixed_columns_mut::<6>(0);
                columns += part * *weight;
            }
        }
    }
    rates.iter().zip(weights).map(|(rate, weight)| rate.value * *weight).sum()
}

/// The derivative with these parts by position and by attitude.
fn joined(position: &Matrix3<f64>, attitude: &Matrix3<f64>) -> Matrix3x6<f64> {
    let mut matrix = Matrix3x6::zeros();
    matrix.fixed_view_mut::<3, 3>(0, 0).copy_from(position);
    matrix.fixed_view_mut::<3, 3>(0, 3).copy_from(attitude);
    matrix
}
