//! Alignment of two point sets: the rigid motion that brings one onto the other.

use super::Pose;
use nalgebra::{Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

/// The rigid motion `to_from_from` with the least sum of squared distances, or `None` where the
/// points do not determine it (fewer than three, or all on one line).
///
/// Source: Umeyama, *Least-squares estimation of transformation parameters between two point
/// patterns*, IEEE PAMI 13 (1991), without its scale.
pub fn rigid_fit(from: &[Point3<f64>], to: &[Point3<f64>]) -> Option<Pose> {
    assert_eq!(from.len(), to.len(), "points come in pairs");
    if from.len() < 3 {
        return None;
    }
    let (from_mean, to_mean) = (centroid(from), centroid(to));
    let covariance: Matrix3<f64> =
        from.iter().zip(to).map(|(a, b)| (b.coords - to_mean) * (a.coords - from_mean).transpose()).sum();
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
    let translation = to_mean - rotation * from_mean;
    Some(Pose::from_parts(Translation3::from(translation), rotation))
}

/// The similarity `to = scale * rotation * from + translation` with the least sum of squared distances:
/// the scale and the pose. `None` where the points do not determine it (fewer than three, or all on one
/// line), or where a scale of zero fits best.
///
/// Source: Umeyama (1991), equations 40 to 42.
pub fn similarity_fit(from: &[Point3<f64>], to: &[Point3<f64>]) -> Option<(f64, Pose)> {
    let rotation = rigid_fit(from, to)?.rotation;
    let (from_mean, to_mean) = (centroid(from), centroid(to));
    let spread: f64 = from.iter().map(|p| (p.coords - from_mean).norm_squared()).sum();
    let common: f64 = from
        .iter()
        .zip(to)
        .map(|(a, b)| (b.coords - to_mean).dot(&(rotation * (a.coords - from_mean))))
        .sum();
    let scale = common / spread;
    let translation = to_mean - rotation * from_mean * scale;
    (scale > 0.0).then(|| (scale, Pose::from_parts(Translation3::from(translation), rotation)))
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
    fn a_known_similarity_is_found_and_is_the_least() {
        let motion = pose([1.0, -2.0, 0.5], [0.9, 0.1, -0.3, 0.2]);
        let wave = |i: usize| 0.05 * Vector3::new((3.0 * i as f64).sin(), (5.0 * i as f64).cos(), 0.0);
        let to: Vec<_> = body().iter().map(|p| motion * (p * 1.3)).collect();
        let (scale, found) = similarity_fit(&body(), &to).unwrap();
        assert!((scale - 1.3).abs() < 1e-12);
        assert!((found.translation.vector - motion.translation.vector).norm() < 1e-12);
        let to: Vec<_> = to.iter().enumerate().map(|(i, p)| p + wave(i)).collect();
        let (scale, found) = similarity_fit(&body(), &to).unwrap();
        let cost = |scale: f64, pose: &Pose| -> f64 {
            body().iter().zip(&to).map(|(a, b)| (pose * (a * scale) - b).norm_squared()).sum()
        };
        let least = cost(scale, &found);
        for nudge in [-1e-3, 1e-3] {
            assert!(cost(scale + nudge, &found) > least);
            for axis in 0..3 {
                let mut moved = found;
                moved.translation.vector[axis] += nudge;
                assert!(cost(scale, &moved) > least);
                let turn = UnitQuaternion::from_scaled_axis(Vector3::ith(axis, nudge));
                let turned = Pose::from_parts(found.translation, found.rotation * turn);
                assert!(cost(scale, &turned) > least);
            }
        }
        assert!(similarity_fit(&body()[..2], &to[..2]).is_none());
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
    }
}
