//! Check points: targets that the adjustment did not use, intersected from its cameras.
//!
//! With the rays' normal equations `N = sum A^T A` (`A` the whitened derivative of an image point by the
//! target), an intersected point moves by
//!
//! ```text
//! dX = -N^-1 sum A^T (C dc + noise)        C the derivative by the camera's pose
//! ```
//!
//! so that its covariance is that of the image points, `N^-1`, and that of the cameras, all frames together.

use crate::estimate::Estimate;
use crate::problem::Problem;
use crate::refine::{CheckPoint, Network};
use crate::residuals::target_image_point::TargetImagePoint;
use crate::stats::chi_square::chi_square_exceeded;
use nalgebra::{DMatrix, Matrix3, Vector3};
use std::sync::Arc;
use trackbundle_solver::covariance::Covariance;
use trackbundle_solver::manifold::write_pose;
use trackbundle_solver::residual::{Jacobian, Residual};

/// How well a check point agrees.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CheckPrecision {
    /// Standard deviation of the difference: of cameras, image points and survey \[m\].
    pub sigma_m: Option<[f64; 3]>,
    /// Standard deviation of the intersected place: of cameras and image points \[m\].
    pub place_sigma_m: Option<[f64; 3]>,
    /// Chi-square of the difference, of three degrees of freedom, and the probability of a larger one.
    pub chi_square: Option<(f64, f64)>,
}

/// One for each check point.
pub fn check_points(
    problem: &Problem,
    estimate: &Estimate,
    found: &[CheckPoint],
    network: &Network,
    covariance: &mut Covariance<'_>,
    variance_factor: f64,
) -> Vec<CheckPrecision> {
    let mut precision = |check: &CheckPoint| {
        let target = &problem.targets[check.target];
        let difference_m = check.difference_m?;
        let place = target.surveyed()? + difference_m;
        let of_place = of_intersection(problem, estimate, network, covariance, check.target, &place)?;
        let survey = Vector3::from(target.known.map(|known| known.map_or(0.0, |k| k.sigma_m * k.sigma_m)));
        let of_place = of_place * variance_factor;
        let all = of_place + Matrix3::from_diagonal(&survey);
        let chi_square = all.try_inverse().map(|inverse| {
            let value = difference_m.dot(&(inverse * difference_m));
            (value, chi_square_exceeded(value, 3.0))
        });
        let sigmas = |of: &Matrix3<f64>| Some([0, 1, 2].map(|axis| of[(axis, axis)].max(0.0).sqrt()));
        Some(CheckPrecision { sigma_m: sigmas(&all), place_sigma_m: sigmas(&of_place), chi_square })
    };
    found.iter().map(|check| precision(check).unwrap_or_default()).collect()
}

/// Covariance of an intersected target, for a variance of unit weight of 1.
fn of_intersection(
    problem: &Problem,
    estimate: &Estimate,
    network: &Network,
    covariance: &mut Covariance<'_>,
    target: usize,
    place: &nalgebra::Point3<f64>,
) -> Option<Matrix3<f64>> {
    let system = &network.model.system;
    let camera = Arc::new(problem.camera.clone());
    let mut normal = Matrix3::zeros();
    let mut of_cameras = DMatrix::zeros(system.size(), 3);
    for observation in problem.target_observations.iter().filter(|o| o.target == target) {
        let residual = TargetImagePoint { camera: camera.clone(), observed_px: observation.image_px };
        let pose = write_pose(&estimate.camera_poses[observation.frame]);
        let mut jacobian = Jacobian::zeros();
        residual.evaluate(&[&pose, place.coords.as_slice()], Some(&mut jacobian))?;
        let by_camera = jacobian.0[0].fixed_columns::<6>(0) / observation.sigma_px;
        let by_target = jacobian.0[1].fixed_columns::<3>(0) / observation.sigma_px;
        normal += by_target.transpose() * by_target;
        if let Some(range) = system.range_of(network.model.camera(observation.frame)) {
            let mut rows = of_cameras.rows_mut(range.start, 6);
            rows += by_camera.transpose() * by_target;
        }
    }
    let inverse = normal.try_inverse()?;
    let of_cameras = of_cameras * inverse;
    let of_cameras = DMatrix::from_column_slice(of_cameras.nrows(), 3, of_cameras.as_slice());
    let moved = of_cameras.transpose() * covariance.times(&of_cameras);
    Some(inverse + moved.fixed_view::<3, 3>(0, 0))
}
