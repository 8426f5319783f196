//! The surface near a point of a cloud: a plane through its neighbours.

use super::index::{CloudIndex, Nearest};
use nalgebra::{Matrix3, Point3, SymmetricEigen, Vector3};
use rayon::prelude::*;

/// How many neighbours a plane is laid through, where nothing else is said.
pub const NEIGHBOURS: usize = 12;

/// Neighbours whose second axis is shorter than this share of their first lie on a line.
const LINE: f64 = 1e-3;

/// A plane through points: through their mean, normal to the axis along which they scatter least.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LocalPlane {
    /// Mean of the points \[m\].
    pub centre: Point3<f64>,
    /// Unit normal; of its two senses that in which its largest component is positive.
    pub normal: Vector3<f64>,
    /// Standard deviation of the points off the plane, with three degrees of freedom less than points \[m\].
    pub scatter_m: f64,
}

impl LocalPlane {
    /// The plane of least squares through these points; `None` where they are fewer than three, or
    /// on one line.
    pub fn through(points: &[Point3<f64>]) -> Option<Self> {
        let first = points.first().filter(|_| points.len() >= 3)?;
        // Relative to one of them, for the sake of large coordinates.
        let count = points.len() as f64;
        let mean = points.iter().map(|p| p - first).sum::<Vector3<f64>>() / count;
        let about = |p: &Point3<f64>| (p - first) - mean;
        let moments: Matrix3<f64> = points.iter().map(|p| about(p) * about(p).transpose()).sum();
        let eigen = SymmetricEigen::new(moments);
        let mut axes = [0, 1, 2];
        axes.sort_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]));
        let [least, middle, most] = axes.map(|axis| eigen.eigenvalues[axis].max(0.0));
        if middle <= LINE * LINE * most {
            return None;
        }
        let normal = eigen.eigenvectors.column(axes[0]).into_owned();
        let sign = normal[normal.iamax()].signum();
        let scatter_m = (least / (points.len() - 3).max(1) as f64).sqrt();
        Some(LocalPlane { centre: first + mean, normal: sign * normal, scatter_m })
    }

    /// How far a point is from the plane, positive on the side of the normal \[m\].
    pub fn offset_m(&self, point: &Point3<f64>) -> f64 {
        self.normal.dot(&(point - self.centre))
    }
}

/// The plane of the neighbourhood of a point, and how far that reaches \[m\].
pub fn plane_near(cloud: &CloudIndex, point: &Point3<f64>, neighbours: usize) -> Option<(LocalPlane, f64)> {
    let near = cloud.k_nearest(point, neighbours);
    let points: Vec<Point3<f64>> = near.iter().map(|other| cloud.points()[other.index]).collect();
    Some((LocalPlane::through(&points)?, near.last()?.distance_m))
}

/// How far a point is from the surface of a cloud.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlaneDistance {
    /// The nearest point of the cloud.
    pub nearest: Nearest,
    /// The distance to the surface there, never more than that to the nearest point \[m\].
    pub distance_m: f64,
    /// Whether there is a plane at the nearest point. Otherwise the distance is that to the point.
    pub has_plane: bool,
}

/// The distances of points to the local plane of a cloud.
///
/// The plane is laid by least squares through the nearest point `n` and its neighbours, `neighbours`
/// in all. The distance is that to the disc in this plane about the foot of `n` whose radius `R` is
/// the distance from `n` to the farthest of them: with the height `h` above the plane and the way `l` along it,
/// `min(|q - n|, sqrt(h^2 + max(0, l - R)^2))`. Within the disc this is the "least square plane" of
/// CloudCompare's cloud-to-cloud distance, which likewise takes the lesser one of the distance to the
/// model and that to the point. Beyond the disc a plane says nothing, and CloudCompare's is too short.
/// It is short, too, at edges sharper than the neighbourhood resolves.
pub fn plane_distances(from: &[Point3<f64>], to: &CloudIndex, neighbours: usize) -> Vec<PlaneDistance> {
    let one = |point: &Point3<f64>| {
        let nearest = to.nearest(point);
        let place = to.points()[nearest.index];
        let Some((plane, reach_m)) = plane_near(to, &place, neighbours) else {
            return PlaneDistance { nearest, distance_m: nearest.distance_m, has_plane: false };
        };
        let height = plane.offset_m(point);
        let way = point - place;
        let along = (way - plane.normal * plane.normal.dot(&way)).norm();
        let distance_m = height.hypot((along - reach_m).max(0.0)).min(nearest.distance_m);
        PlaneDistance { nearest, distance_m, has_plane: true }
    };
    from.par_iter().map(one).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::tests::{Draws, shell};

    #[test]
    fn a_plane_is_found_with_its_scatter() {
        let mut draws = Draws::new(1);
        let (along, across) =
            (Vector3::new(2.0, 1.0, 0.0).normalize(), Vector3::new(-1.0, 2.0, 5.0).normalize());
        let normal = along.cross(&across);
        let far = Point3::new(500_000.0, 3_900_000.0, 100.0);
        let points: Vec<Point3<f64>> = (0..4000)
            .map(|_| {
                far + along * draws.uniform() + across * draws.uniform() + normal * (0.01 * draws.normal())
            })
            .collect();
        let plane = LocalPlane::through(&points).unwrap();
        assert!((plane.scatter_m / 0.01 - 1.0).abs() < 0.04, "{plane:?}");
        assert!(plane.normal.dot(&normal).abs() > 1.0 - 1e-5, "{plane:?}");
        assert!((plane.offset_m(&(far + 0.3 * normal + 0.5 * (along + across))).abs() - 0.3).abs() < 2e-3);
    }

    #[test]
    fn points_on_a_line_have_no_plane() {
        let line: Vec<Point3<f64>> = (0..8).map(|i| Point3::new(0.1 * f64::from(i), 0.0, 1.0)).collect();
        assert_eq!(LocalPlane::through(&line), None);
        assert_eq!(LocalPlane::through(&line[..2]), None);
        assert_eq!(LocalPlane::through(&[line[0]; 5]), None);
        let query = Point3::new(0.3, 0.2, 1.0);
        let found = plane_distances(&[query], &CloudIndex::new(line).unwrap(), NEIGHBOURS);
        assert!(!found[0].has_plane);
        assert_eq!(found[0].distance_m, 0.2);
    }

    #[test]
    fn a_flat_grid_is_a_surface_as_far_as_it_reaches() {
        let grid = (0..900).map(|i| Point3::new(0.1 * f64::from(i % 30), 0.1 * f64::from(i / 30), 2.0));
        let index = CloudIndex::new(grid.collect()).unwrap();
        let distance = |x, y, z| plane_distances(&[Point3::new(x, y, z)], &index, 9)[0].distance_m;
        assert!((distance(1.24, 1.07, 2.5) - 0.5).abs() < 1e-12);
        assert!((distance(1.24, 1.07, 2.01) - 0.01).abs() < 1e-12);
        // Nine points of a border reach two cells; beyond, the way to the disc counts.
        let beyond = distance(3.9, 1.5, 2.0);
        assert!((0.7..=0.8 + 1e-12).contains(&beyond), "{beyond}");
    }

    #[test]
    fn a_plane_is_never_farther_than_the_point() {
        let index = CloudIndex::new(shell(2000, 3)).unwrap();
        for found in plane_distances(&shell(500, 4), &index, NEIGHBOURS) {
            assert!(found.distance_m <= found.nearest.distance_m);
        }
    }
}
