//! Alignment of two point sets: the rigid motion, or the similarity, that brings one onto the other.
//!
//! Source: Umeyama, *Least-squares estimation of transformation parameters between two point
//! patterns*, IEEE PAMI 13 (1991).

use super::Pose;
use nalgebra::{Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

/// The rigid motion `to_from_from` with the least sum of squared distances, or `None` where the
/// points do not determine it (fewer than three, or all on one line). Umeyama's, without his scale.
pub fn rigid_fit(from: &[Point3<f64>], to: &[Point3<f64>]) -> Option<Pose> {
    let Turn { rotation, means: [from_mean, to_mean], .. } = turn(from, to)?;
    let translation = to_mean - rotation * from_mean;
    Some(Pose::from_parts(Translation3::from(translation), rotation))
}

/// The similarity `to = scale * (R from) + t` with the least sum of squared distances: its scale, and
/// `R` and `t` as a pose (which does not contain the scale). `None` where [`rigid_fit`] has none.
///
/// ```text
/// scale = tr(D S) / sum |from - mean|^2        (Umeyama 1991, equations 40 to 42)
/// ```
pub fn similarity_fit(from: &[Point3<f64>], to: &[Point3<f64>]) -> Option<(f64, Pose)> {
    let Turn { rotation, means: [from_mean, to_mean], trace } = turn(from, to)?;
    let square: f64 = from.iter().map(|point| (point.coords - from_mean).norm_squared()).sum();
    let scale = trace / square;
    let translation = to_mean - scale * (rotation * from_mean);
    scale.is_finite().then(|| (scale, Pose::from_parts(Translation3::from(translation), rotation)))
}

/// The rotation between two point sets about their centroids.
struct Turn {
    rotation: UnitQuaternion<f64>,
    /// Centroids of both.
    means: [Vector3<f64>; 2],
    /// The trace of `D S`: of the singular values of their covariance, with the sign of the last.
    trace: f64,
}

fn turn(from: &[Point3<f64>], to: &[Point3<f64>]) -> Option<Turn> {
    assert_eq!(from.len(), to.len(), "points come in pairs");
    if from.len() < 3 {
        return None;
    }
    let (from_mean, to_mean) = (centroid(from), centroid(to));
    let covariance: Matrix3<f64> =
        from.iter().zip(to).map(|(a, b)| (b.coords - to_mean) * (a.coords - from_mean).transpose()).sum();
    if !covariance.iter().all(|value| value.is_finite()) {
        return None;
    }
    let svd = covariance.svd(true, true);
    let (u, v_t) = (svd.u?, svd.v_t?);
    let mut singular = svd.singular_values.as_slice().to_vec();
    singular.sort_by(f64::total_cmp);
    if singular[1] <= 1e-12 * singular[2] || singular[2] == 0.0 {
        return None;
    }
    // The smallest singular value takes the sign that keeps the handedness.
    let smallest = (0..3).min_by(|&i, &j| svd.singular_values[i].total_cmp(&svd.singular_values[j]))?;
    let mut signs = Vector3::repeat(1.0);
    signs[smallest] = (u.determinant() * v_t.determinant()).signum();
    let rotation = Rotation3::from_matrix_unchecked(u * Matrix3::from_diagonal(&signs) * v_t);
    let rotation = UnitQuaternion::from_rotation_matrix(&rotation);
    Some(Turn { rotation, means: [from_mean, to_mean], trace: svd.singular_values.dot(&signs) })
}

/// The rigid fit on the best `share` of the pairs: the fit is repeated on the pairs that lie
/// closest under it until that choice no longer changes (at most 50 times).
pub fn rigid_fit_trimmed(from: &[Point3<f64>], to: &[Point3<f64>], share: f64) -> Option<Pose> {
    let keep = ((from.len() as f64 * share).round() as usize).clamp(3.min(from.len()), from.len());
    let mut fit = rigid_fit(from, to)?;
    let mut chosen: Vec<usize> = (0..from.len()).collect();
    for _ in 0..50 {
        let mut order: Vec<usize> = (0..from.len()).collect();
        let distance: Vec<f64> = (0..from.len()).map(|i| (fit * from[i] - to[i]).norm()).collect();
        order.sort_by(|&i, &j| distance[i].total_cmp(&distance[j]));
        order.truncate(keep);
        order.sort_unstable();
        if order == chosen {
            break;
        }
        chosen = order;
        let pick = |points: &[Point3<f64>]| chosen.iter().map(|&i| points[i]).collect::<Vec<_>>();
        fit = rigid_fit(&pick(from), &pick(to))?;
    }
    Some(fit)
}

fn centroid(points: &[Point3<f64>]) -> Vector3<f64> {
    points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / points.len() as f64
}

#[cfg(test)]
mod tests {
    use super::super::pose;
    use super::*;

    fn body() -> Vec<Point3<f64>> {
        (0..20)
            .map(|i| {
                let i = f64::from(i);
                Point3::new((1.3 * i).sin(), (2.1 * i).cos(), 0.3 * (0.7 * i).sin())
            })
            .collect()
    }

    #[test]
    fn a_known_motion_is_found() {
        let motion = pose([1.0, -2.0, 0.5], [0.9, 0.1, -0.3, 0.2]);
        let moved: Vec<_> = body().iter().map(|p| motion * p).collect();
        let found = rigid_fit(&body(), &moved).unwrap();
        assert!((found.translation.vector - motion.translation.vector).norm() < 1e-12);
        assert!(found.rotation.angle_to(&motion.rotation) < 1e-7);
    }

    #[test]
    fn a_known_similarity_is_found() {
        let motion = pose([1.0, -2.0, 0.5], [0.9, 0.1, -0.3, 0.2]);
        let moved =
            |p: &Point3<f64>| Point3::from(1.7 * (motion.rotation * p.coords) + motion.translation.vector);
        let moved: Vec<_> = body().iter().map(moved).collect();
        let (scale, found) = similarity_fit(&body(), &moved).unwrap();
        assert!((scale - 1.7).abs() < 1e-13, "{scale}");
        assert!((found.translation.vector - motion.translation.vector).norm() < 1e-12);
        assert!(found.rotation.angle_to(&motion.rotation) < 1e-7);
    }

    #[test]
    fn no_similarity_beside_the_fit_is_better() {
        // Points that do not fit, mirrored ones too: a step in any of the seven parameters makes it worse.
        for mirrored in [1.0, -1.0] {
            let other: Vec<_> = (0..20)
                .map(|i| f64::from(i) * 0.9)
                .map(|i| Point3::new(mirrored * (1.2 * i).sin(), (2.0 * i).cos() + 0.3, (0.7 * i).sin()))
                .collect();
            let (scale, motion) = similarity_fit(&body(), &other).unwrap();
            let cost = |scale: f64, motion: &Pose| -> f64 {
                let moved =
                    |p: &Point3<f64>| scale * (motion.rotation * p.coords) + motion.translation.vector;
                body().iter().zip(&other).map(|(a, b)| (moved(a) - b.coords).norm_squared()).sum()
            };
            let least = cost(scale, &motion);
            for sign in [1e-4, -1e-4] {
                assert!(cost(scale + sign, &motion) > least);
                for axis in 0..3 {
                    let step = sign * Vector3::ith(axis, 1.0);
                    let shifted = Translation3::from(step) * motion;
                    let turned = UnitQuaternion::from_scaled_axis(step);
                    let turned = Pose::from_parts(motion.translation, turned * motion.rotation);
                    assert!(cost(scale, &shifted) > least && cost(scale, &turned) > least, "{axis}");
                }
            }
        }
    }

    #[test]
    fn foreign_points_are_trimmed() {
        let motion = pose([1.0, -2.0, 0.5], [0.9, 0.1, -0.3, 0.2]);
        let mut moved: Vec<_> = body().iter().map(|p| motion * p).collect();
        for foreign in [3, 9, 14] {
            moved[foreign] += Vector3::new(0.5, 0.4, -0.6);
        }
        let found = rigid_fit_trimmed(&body(), &moved, 0.8).unwrap();
        assert!((found.translation.vector - motion.translation.vector).norm() < 1e-12);
    }

    #[test]
    fn a_mirrored_body_is_not_mirrored_back() {
        let mirrored: Vec<_> = body().iter().map(|p| Point3::new(p.x, -p.y, p.z)).collect();
        let found = rigid_fit(&body(), &mirrored).unwrap();
        assert!(found.rotation.to_rotation_matrix().matrix().determinant() > 0.0);
    }

    #[test]
    fn points_on_a_line_determine_nothing() {
        let line: Vec<_> = (0..5).map(|i| Point3::new(f64::from(i), 0.0, 0.0)).collect();
        assert!(rigid_fit(&line, &line).is_none());
        assert!(rigid_fit(&line[..2], &line[..2]).is_none());
        assert!(similarity_fit(&line, &line).is_none());
        let far: Vec<_> = body().iter().map(|p| p * 1e300).collect();
        assert!(similarity_fit(&far, &far).is_none(), "what overflows determines nothing");
    }
}
