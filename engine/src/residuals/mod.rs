//! The measurements, one file per equation.
//!
//! | group of measurements | equation |
//! |---|---|
//! | image point of a vehicle point | [`vehicle_image_point`] |
//! | image point of a target | [`target_image_point`] |
//! | surveyed coordinate of a target, known coordinate of a shape point, height of the body, bias of the terrain | [`known_coordinate`] |
//! | image point at the time of its row, of an interior orientation that is adjusted | [`row_image_point`] |
//! | measured position of an antenna | [`antenna_position`] |
//! | starting pose of a camera or a vehicle | [`pose_prior`] |
//! | contact of a vehicle with the ground | [`ground_contact`] |
//! | smooth motion of a camera or a vehicle | [`smooth_motion`], [`jerk`] |
//! | smooth motion of a vehicle in its own axes | [`twist`], [`jerk`] |
//! | ... in distances from the camera | [`scale_free`] |
//! | known distance of two shape points | [`known_distance`] |
//! | rolling of a vehicle's rear axle | [`no_side_slip`] |
//!
//! Poses are `world_from_body` and perturbed as [`trackbundle_solver::manifold`] says.

pub mod antenna_position;
pub mod ground_contact;
pub mod inside_body;
pub mod jerk;
pub mod known_coordinate;
pub mod known_distance;
pub mod no_side_slip;
pub mod pose_prior;
pub mod row_image_point;
pub mod same_point;
pub mod scale_free;
pub mod smooth_motion;
mod steps;
pub mod target_image_point;
pub mod twist;
pub mod vehicle_image_point;

#[cfg(test)]
mod testing {
    //! States at which Jacobians are checked.

    use crate::geometry::{Pose, pose, se3};
    use nalgebra::Vector6;
    use trackbundle_solver::manifold::write_pose;
    use trackbundle_solver::residual::{Residual, worst_jacobian_entry};

    /// Cameras 60 m above the ground that look down, along the road and askew.
    pub fn camera_poses() -> [Pose; 3] {
        [
            pose([-22.0, -0.5, 60.3], [0.12, -0.69, 0.70, -0.12]),
            pose([3.0, 8.0, 55.0], [0.0, 1.0, 0.02, 0.0]),
            pose([1.0, -30.0, 40.0], [0.25, -0.95, 0.1, 0.05]),
        ]
    }

    /// Vehicles that stand level, lean and turn.
    pub fn vehicle_poses() -> [Pose; 3] {
        [
            pose([1.9, 2.3, 0.02], [1.0, 0.0, 0.0, 0.0]),
            pose([-3.0, 4.0, -0.3], [0.67, -0.02, -0.006, -0.74]),
            pose([0.0, 0.0, 0.0], [0.1, 0.05, -0.04, 0.99]),
        ]
    }

    /// A vehicle in a steady curve, at these times.
    pub fn steady_curve<const N: usize>(times: &[f64; N]) -> [[f64; 7]; N] {
        let twist = Vector6::new(9.0, 0.2, -0.1, 0.02, -0.03, 0.5);
        times.map(|t| write_pose(&(vehicle_poses()[1] * se3::exp(&(twist * t)))))
    }

    /// Asserts that analytic and numeric Jacobian agree at `x`.
    pub fn assert_jacobian<const ROWS: usize, const BLOCKS: usize>(
        residual: &impl Residual<ROWS, BLOCKS>,
        x: &[&[f64]; BLOCKS],
    ) {
        let worst = worst_jacobian_entry(residual, x, 1e-6).expect("a possible geometry");
        assert!(worst.gap < 1e-7, "{worst:?}");
    }
}
