//! M3C2: distances between two clouds along the normals of the surface, each with its level of detection.
//!
//! Sources: Lague, Brodu, Leroux, *Accurate 3D comparison of complex topography with terrestrial laser
//! scanner*, ISPRS J. Photogramm. Remote Sens. 82 (2013), equation 1; for points that have standard deviations of
//! their own James, Robson, Smith, *3-D uncertainty-based topographic change detection with structure-from-motion
//! photogrammetry: precision maps*, Earth Surf. Process. Landforms 42 (2017).

use super::index::CloudIndex;
use super::plane::LocalPlane;
use crate::stats::normal::TWO_SIDED_95;
use nalgebra::{Matrix3, Point3, Vector3};
use rayon::prelude::*;

/// Fewer points than this have no scatter that a level of detection could be built on.
pub const FEWEST: usize = 4;

/// The scales of the comparison.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct M3c2Options {
    /// Diameter of the neighbourhood in the scan that gives the normal (`D`) \[m\].
    pub normal_scale_m: f64,
    /// Diameter of the cylinder whose points are averaged (`d`) \[m\].
    pub cylinder_m: f64,
    /// How far the cylinder reaches to either side of the core point \[m\].
    pub reach_m: f64,
    /// Standard deviation of the registration (`reg`) \[m\].
    pub registration_m: f64,
    /// A place inside the body, from which normals point away. Without it, the largest component of a
    /// normal is positive.
    pub inside: Option<Point3<f64>>,
}

impl Default for M3c2Options {
    fn default() -> Self {
        M3c2Options {
            normal_scale_m: 0.25,
            cylinder_m: 0.15,
            reach_m: 0.5,
            registration_m: 0.0,
            inside: None,
        }
    }
}

/// Why a core point has no distance.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Missing {
    /// No plane in the scan about it.
    Normal,
    /// Fewer than [`FEWEST`] points of the scan in the cylinder.
    Scan,
    /// No point of the shape in the cylinder, or fewer than [`FEWEST`] without covariances.
    Shape,
}

/// The distance at a core point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct M3c2Distance {
    /// Mean of the shape minus mean of the scan along the normal \[m\].
    pub distance_m: f64,
    /// Distances up to this are no difference at the level of 95 % \[m\].
    pub detection_m: f64,
    /// Whether the distance is larger.
    pub is_significant: bool,
    /// Unit normal.
    pub normal: Vector3<f64>,
    /// Points of the scan in the cylinder.
    pub scan_count: usize,
    /// Points of the shape in the cylinder.
    pub shape_count: usize,
}

/// The distances at all core points, in their order.
#[derive(Clone, Debug, PartialEq)]
pub struct M3c2 {
    /// The distance, or why there is none.
    pub at: Vec<Result<M3c2Distance, Missing>>,
}

impl M3c2 {
    /// How many have no distance for this reason.
    pub fn missing(&self, why: Missing) -> usize {
        self.at.iter().filter(|found| **found == Err(why)).count()
    }

    /// Those that have one.
    pub fn distances(&self) -> impl Iterator<Item = &M3c2Distance> {
        self.at.iter().flatten()
    }
}

/// Mean and variance (with one degree of freedom less) along a direction, and how many.
struct Along {
    mean: f64,
    variance: f64,
    members: Vec<usize>,
}

fn along(cloud: &CloudIndex, core: &Point3<f64>, normal: &Vector3<f64>, options: &M3c2Options) -> Along {
    let radius = 0.5 * options.cylinder_m;
    let mut members: Vec<usize> =
        cloud.within(core, radius.hypot(options.reach_m)).iter().map(|near| near.index).collect();
    let height = |index: &usize| normal.dot(&(cloud.points()[*index] - core));
    members.retain(|index| {
        let height = height(index);
        let across = (cloud.points()[*index] - core - height * normal).norm();
        height.abs() <= options.reach_m && across <= radius
    });
    members.sort_unstable();
    let count = members.len() as f64;
    let mean = members.iter().map(height).sum::<f64>() / count;
    let variance = members.iter().map(|index| (height(index) - mean).powi(2)).sum::<f64>() / (count - 1.0);
    Along { mean, variance, members }
}

/// Compares a shape with a scan at core points. With the covariances of the points of the shape \[m2\], the
/// variance of their mean is `sum(n' C n) / n1^2`, which a single point has too; without them it is their scatter,
/// `s1^2 / n1`. The level of detection is `1.96 (sqrt(s1^2/n1 + s2^2/n2) + reg)`.
pub fn m3c2(
    core: &[Point3<f64>],
    shape: &CloudIndex,
    covariances_m2: Option<&[Matrix3<f64>]>,
    scan: &CloudIndex,
    options: &M3c2Options,
) -> M3c2 {
    assert!(
        covariances_m2.is_none_or(|all| all.len() == shape.points().len()),
        "a covariance for each point"
    );
    let one = |core: &Point3<f64>| {
        let near = scan.within(core, 0.5 * options.normal_scale_m);
        let near: Vec<Point3<f64>> = near.iter().map(|other| scan.points()[other.index]).collect();
        let mut normal = LocalPlane::through(&near).ok_or(Missing::Normal)?.normal;
        if options.inside.is_some_and(|inside| normal.dot(&(core - inside)) < 0.0) {
            normal = -normal;
        }
        let of_scan = along(scan, core, &normal, options);
        if of_scan.members.len() < FEWEST {
            return Err(Missing::Scan);
        }
        let of_shape = along(shape, core, &normal, options);
        let count = of_shape.members.len();
        let shape_variance = match covariances_m2 {
            Some(all) if count > 0 => {
                of_shape.members.iter().map(|index| normal.dot(&(all[*index] * normal))).sum::<f64>()
                    / (count * count) as f64
            }
            None if count >= FEWEST => of_shape.variance / count as f64,
            _ => return Err(Missing::Shape),
        };
        let scan_variance = of_scan.variance / of_scan.members.len() as f64;
        let distance_m = of_shape.mean - of_scan.mean;
        let detection_m = TWO_SIDED_95 * ((shape_variance + scan_variance).sqrt() + options.registration_m);
        Ok(M3c2Distance {
            distance_m,
            detection_m,
            is_significant: distance_m.abs() > detection_m,
            normal,
            scan_count: of_scan.members.len(),
            shape_count: count,
        })
    };
    M3c2 { at: core.par_iter().map(one).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::tests::Draws;

    /// A noisy plane at this height, 2 m by 2 m.
    fn plane(count: usize, height: f64, sigma: f64, seed: u64) -> CloudIndex {
        let mut draws = Draws::new(seed);
        let points = (0..count)
            .map(|_| {
                Point3::new(2.0 * draws.uniform(), 2.0 * draws.uniform(), height + sigma * draws.normal())
            })
            .collect();
        CloudIndex::new(points).unwrap()
    }

    fn cores() -> Vec<Point3<f64>> {
        (0..196)
            .map(|i| Point3::new(0.3 + 0.1 * f64::from(i % 14), 0.3 + 0.1 * f64::from(i / 14), 0.0))
            .collect()
    }

    fn quiet() -> M3c2Options {
        M3c2Options { inside: Some(Point3::new(1.0, 1.0, -5.0)), ..M3c2Options::default() }
    }

    #[test]
    fn a_shift_along_the_normal_is_found_with_its_sign() {
        let (scan, shape) = (plane(20_000, 0.0, 0.005, 1), plane(20_000, 0.03, 0.005, 2));
        let found = m3c2(&cores(), &shape, None, &scan, &quiet());
        assert_eq!(found.distances().count(), 196);
        for at in found.distances() {
            assert!((at.distance_m - 0.03).abs() < 0.005 && at.is_significant, "{at:?}");
        }
        let below = M3c2Options { inside: Some(Point3::new(1.0, 1.0, 5.0)), ..quiet() };
        assert!(m3c2(&cores(), &shape, None, &scan, &below).distances().all(|at| at.distance_m < 0.0));
    }

    #[test]
    fn the_level_of_detection_is_that_of_the_formula() {
        // Normals are upright here, so that the cylinder and its numbers can be counted by hand.
        let (scan, shape) = (plane(6000, 0.0, 1e-9, 3), plane(4000, 0.0, 1e-9, 4));
        let mut draws = Draws::new(8);
        let mut lift = |cloud: &CloudIndex| {
            let points = cloud.points().iter().map(|p| p + Vector3::z() * (0.01 * draws.normal())).collect();
            CloudIndex::new(points).unwrap()
        };
        let (scan, shape) = (lift(&scan), lift(&shape));
        let options = M3c2Options { normal_scale_m: 3.0, registration_m: 0.002, ..quiet() };
        let core = Point3::new(1.0, 1.0, 0.0);
        let found = m3c2(&[core], &shape, None, &scan, &options).at[0].unwrap();
        let heights = |cloud: &CloudIndex| -> Vec<f64> {
            let inside = |p: &&Point3<f64>| (p.x - 1.0).hypot(p.y - 1.0) <= 0.075;
            cloud.points().iter().filter(inside).map(|p| p.z).collect()
        };
        let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
        let of_mean = |v: &[f64]| {
            v.iter().map(|h| (h - mean(v)).powi(2)).sum::<f64>() / (v.len() - 1) as f64 / v.len() as f64
        };
        let (a, b) = (heights(&shape), heights(&scan));
        assert!(found.shape_count.abs_diff(a.len()) <= 1 && found.scan_count.abs_diff(b.len()) <= 1);
        let wanted = 1.96 * ((of_mean(&a) + of_mean(&b)).sqrt() + 0.002);
        assert!((found.detection_m / wanted - 1.0).abs() < 0.03, "{found:?} {wanted}");
        assert!((found.distance_m - (mean(&a) - mean(&b))).abs() < 3e-4, "{found:?}");
    }

    #[test]
    fn where_nothing_changed_one_in_twenty_is_significant() {
        let mut significant = 0;
        for seed in 0..10 {
            let (scan, shape) =
                (plane(8000, 0.0, 0.01, 2 * seed + 10), plane(8000, 0.0, 0.01, 2 * seed + 11));
            // Cylinders of one draw do not overlap.
            let found = m3c2(&cores(), &shape, None, &scan, &M3c2Options { cylinder_m: 0.1, ..quiet() });
            significant += found.distances().filter(|at| at.is_significant).count();
        }
        let share = f64::from(significant as u32) / 1960.0;
        assert!((0.03..0.08).contains(&share), "{share}");
    }

    #[test]
    fn single_points_are_judged_by_their_own_covariance() {
        let scan = plane(20_000, 0.0, 0.005, 1);
        let mut draws = Draws::new(9);
        let points: Vec<Point3<f64>> =
            cores().iter().map(|p| p + Vector3::z() * (0.02 * draws.normal())).collect();
        let shape = CloudIndex::new(points.clone()).unwrap();
        let options = M3c2Options { cylinder_m: 0.08, ..quiet() };
        assert_eq!(m3c2(&points, &shape, None, &scan, &options).missing(Missing::Shape), 196);
        // What lies in the plane of the surface does not count.
        let covariances = vec![Matrix3::from_diagonal(&Vector3::new(9.0, 9.0, 4e-4)); 196];
        let found = m3c2(&points, &shape, Some(&covariances), &scan, &options);
        assert_eq!(found.distances().count(), 196);
        let significant = found.distances().filter(|at| at.is_significant).count();
        assert!((2..=20).contains(&significant), "{significant}");
        // The normal of a noisy neighbourhood leans a little, by which 9 m2 count somewhat.
        let mut levels: Vec<f64> = found.distances().map(|at| at.detection_m).collect();
        levels.sort_by(f64::total_cmp);
        assert!(found.distances().all(|at| at.shape_count == 1));
        assert!(levels[0] >= 1.96 * 0.02 && levels[98] < 1.96 * 0.06, "{levels:?}");
    }

    #[test]
    fn what_has_too_few_points_is_counted() {
        let scan = CloudIndex::new(
            (0..6).map(|i| Point3::new(0.03 * f64::from(i % 3), 0.1 * f64::from(i / 3), 0.0)).collect(),
        );
        let scan = scan.unwrap();
        let shape = CloudIndex::new(vec![Point3::origin()]).unwrap();
        let far = Point3::new(9.0, 0.0, 0.0);
        let cores = [far, Point3::new(0.0, 0.05, 0.0)];
        let found = m3c2(&cores, &shape, None, &scan, &M3c2Options { cylinder_m: 0.02, ..quiet() });
        assert_eq!(found.at, [Err(Missing::Normal), Err(Missing::Scan)]);
        assert_eq!((found.missing(Missing::Normal), found.missing(Missing::Shape)), (1, 0));
    }
}
