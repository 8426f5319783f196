//! A path at a time, and how functions of its state follow from poses and marker.

use crate::trajectory::{Linear, StateBlock};
use nalgebra::{Point3, SVector, Vector2, Vector3};

/// At rest a speed has no derivative: any direction will do.
pub fn direction(moved: Vector2<f64>) -> Vector2<f64> {
    if moved.norm() > 1e-9 { moved.normalize() } else { Vector2::x() }
}

/// A path at a time.
pub struct Moment {
    /// The state.
    pub linear: Linear,
    /// The marker, in the body \[m\].
    pub marker: Point3<f64>,
}

/// A function of a state: its gradient by the twelve numbers of the state, and by the marker.
pub type Function = (SVector<f64, 12>, Vector3<f64>);

impl Moment {
    fn function(parts: [(usize, Vector3<f64>); 3], by_marker: Vector3<f64>) -> Function {
        let mut by_state = SVector::<f64, 12>::zeros();
        for (row, part) in parts {
            let mut rows = by_state.fixed_rows_mut::<3>(row);
            rows += part;
        }
        (by_state, by_marker)
    }

    fn in_body(&self, direction: &Vector3<f64>) -> Vector3<f64> {
        self.linear.state.pose.rotation.inverse() * direction
    }

    /// Of `p + R m` along a direction of the world, of which `d(R) = R [dr]x`.
    pub fn of_position(&self, along: &Vector3<f64>) -> Function {
        let in_body = self.in_body(along);
        let turned = self.marker.coords.cross(&in_body);
        Moment::function([(0, *along), (3, turned), (6, Vector3::zeros())], in_body)
    }

    /// Of `v + R (w x m)`.
    pub fn of_velocity(&self, along: &Vector3<f64>) -> Function {
        let (in_body, w) = (self.in_body(along), self.linear.state.angular_velocity_rps);
        let turned = w.cross(&self.marker.coords).cross(&in_body);
        let swung = self.marker.coords.cross(&in_body);
        Moment::function([(3, turned), (6, *along), (9, swung)], in_body.cross(&w))
    }

    /// Of the horizontal speed.
    pub fn of_speed(&self) -> Function {
        let direction = direction(self.linear.state.velocity_of(&self.marker).xy());
        self.of_velocity(&Vector3::new(direction.x, direction.y, 0.0))
    }

    /// Of the direction of `R ex` in the plan.
    pub fn of_heading(&self) -> Function {
        let ahead = self.linear.state.pose.rotation * Vector3::x();
        let across = Vector3::new(-ahead.y, ahead.x, 0.0) / ahead.xy().norm_squared();
        let turned = Vector3::x().cross(&self.in_body(&across));
        Moment::function([(3, turned), (0, Vector3::zeros()), (6, Vector3::zeros())], Vector3::zeros())
    }

    /// Of `ez . R w`: that of a vehicle that stands nearly level.
    pub fn of_yaw_rate(&self) -> Function {
        let up = self.in_body(&Vector3::z());
        let turned = self.linear.state.angular_velocity_rps.cross(&up);
        Moment::function([(3, turned), (9, up), (0, Vector3::zeros())], Vector3::zeros())
    }

    /// The gradient of a function by the shift and the turn of each pose on which it depends.
    pub fn by_poses(&self, (by_state, _): &Function) -> Vec<(Vector3<f64>, Vector3<f64>)> {
        let of_pose = |block: &StateBlock| {
            let gradient = block.transpose() * by_state;
            (gradient.fixed_rows::<3>(0).into(), gradient.fixed_rows::<3>(3).into())
        };
        self.linear.blocks.iter().map(of_pose).collect()
    }

    /// The variance that poses leave a function, were they known exactly.
    pub fn between(&self, (by_state, _): &Function) -> f64 {
        (by_state.transpose() * self.linear.process * by_state)[(0, 0)]
    }
}
