//! Points held against where they truly are, point by point.

use crate::geometry::Pose;
use crate::geometry::align::{rigid_fit, similarity_fit};
use nalgebra::Point3;

/// What is left of points after a fit onto their truth.
#[derive(Clone, Debug, PartialEq)]
pub struct FittedErrors {
    /// The motion of the fit, `truth_from_points`.
    pub truth_from_points: Pose,
    /// The scale of the fit: `truth = scale * rotation * point + translation`. 1 where it was not free.
    pub scale: f64,
    /// Distance of each point from its truth \[m\].
    pub errors_m: Vec<f64>,
}

/// How far points are from where they truly are.
#[derive(Clone, Debug, PartialEq)]
pub struct PointErrors {
    /// As they stand \[m\].
    pub raw_m: Vec<f64>,
    /// After the rigid motion of least squares, where the points determine one.
    pub rigid: Option<FittedErrors>,
    /// After the similarity of least squares, where the points determine one.
    pub similarity: Option<FittedErrors>,
}

/// The errors of points \[m\] against their truth, pair by pair.
pub fn point_errors(points: &[Point3<f64>], truth: &[Point3<f64>]) -> PointErrors {
    assert_eq!(points.len(), truth.len(), "points come in pairs");
    let fitted = |scale: f64, pose: Pose| FittedErrors {
        truth_from_points: pose,
        scale,
        errors_m: points.iter().zip(truth).map(|(p, t)| (pose * (p * scale) - t).norm()).collect(),
    };
    PointErrors {
        raw_m: points.iter().zip(truth).map(|(p, t)| (p - t).norm()).collect(),
        rigid: rigid_fit(points, truth).map(|pose| fitted(1.0, pose)),
        similarity: similarity_fit(points, truth).map(|(scale, pose)| fitted(scale, pose)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::tests::shell;
    use crate::geometry::pose;

    #[test]
    fn each_fit_takes_away_what_it_frees() {
        let truth = shell(50, 1);
        let motion = pose([0.3, -0.2, 0.1], [0.99, 0.02, -0.03, 0.05]);
        let points: Vec<Point3<f64>> = truth.iter().map(|p| motion.inverse() * (p / 1.02)).collect();
        let found = point_errors(&points, &truth);
        let largest = |errors: &[f64]| errors.iter().copied().fold(0.0, f64::max);
        assert!(largest(&found.raw_m) > 0.2);
        let rigid = largest(&found.rigid.unwrap().errors_m);
        assert!((0.01..0.06).contains(&rigid), "{rigid}");
        let similarity = found.similarity.unwrap();
        assert!(largest(&similarity.errors_m) < 1e-12);
        assert!((similarity.scale - 1.02).abs() < 1e-12);
        let few = point_errors(&points[..2], &truth[..2]);
        assert!(few.rigid.is_none() && few.similarity.is_none() && few.raw_m.len() == 2);
    }
}
