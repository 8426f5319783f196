//! A cloud as a surface: a curved patch at each point, and how far other points are off it.

use super::index::{CloudError, CloudIndex};
use super::plane::LocalPlane;
use crate::stats::normal::MAD_TO_SIGMA_ROUNDED;
use crate::stats::quantile::upper_median;
use nalgebra::{Matrix6, Point3, Vector3, Vector6};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

/// Second-order terms are drawn to zero by this share of a point each, so that few neighbours do not make them wild.
const RIDGE: f64 = 0.002;

/// The same for the slopes, against neighbours on a line.
const SLOPE_RIDGE: f64 = 1e-6;

/// A patch is fitted three times, neighbours far off it counting less and less.
const ROUNDS: usize = 3;

/// Where the mean of the neighbours is off the point by more than this share of their reach, the surface ends. At a
/// straight border the mean of a half disc is off by `4 / (3 pi) = 0.42`.
const BORDER: f64 = 0.3;

/// A point belongs to a patch up to this share of its reach sideways, and a quarter of its height off it more: where
/// clouds are still apart, the nearest point is not the foot.
const SIDEWAYS: f64 = 0.6;
const SIDEWAYS_OF_HEIGHT: f64 = 0.25;

/// So many patches about a point are averaged, those whose normals agree within 37 degrees with the nearest one's.
const BLENDED: usize = 6;
const AGREES: f64 = 0.8;

/// How far a point is off a surface.
#[derive(Clone, Copy, Debug)]
pub struct Offset {
    /// Distance along the normal \[m\].
    pub height_m: f64,
    /// Unit normal of the surface there.
    pub normal: Vector3<f64>,
    /// Scatter of the surface's points off it \[m\].
    pub scatter_m: f64,
    /// Variance of the slope of the normal, from that scatter.
    pub slope_variance: f64,
}

/// The height `f0 + f1 u + f2 v + f3 u^2 + f4 u v + f5 v^2` over the plane of the neighbours of a point; `u`, `v`
/// and the height in units of the reach.
#[derive(Clone, Copy, Debug)]
struct Patch {
    foot: Point3<f64>,
    axes: [Vector3<f64>; 3],
    height: Vector6<f64>,
    reach_m: f64,
    scatter_m: f64,
    slope_variance: f64,
}

fn terms(u: f64, v: f64) -> Vector6<f64> {
    Vector6::new(1.0, u, v, u * u, u * v, v * v)
}

impl Patch {
    /// Of the neighbours of a point; `None` at borders and where there is no plane.
    fn at(cloud: &CloudIndex, foot: Point3<f64>, neighbours: usize) -> Option<Self> {
        let near = cloud.k_nearest(&foot, neighbours);
        let reach_m = near.last()?.distance_m;
        let points: Vec<Point3<f64>> = near.iter().map(|other| cloud.points()[other.index]).collect();
        let plane = LocalPlane::through(&points)?;
        if (plane.centre - foot).norm() > BORDER * reach_m {
            return None;
        }
        let normal = plane.normal;
        let across = Vector3::ith(normal.iamin(), 1.0).cross(&normal).normalize();
        let axes = [across, normal.cross(&across), normal];
        let count = points.len() as f64;
        let local: Vec<(Vector6<f64>, f64)> = points
            .iter()
            .map(|point| {
                let [u, v, height] = axes.map(|axis| axis.dot(&(point - foot)) / reach_m);
                (terms(u, v), height)
            })
            .collect();
        let mut weights = vec![1.0; points.len()];
        let mut height = Vector6::zeros();
        let (mut variance, mut slope) = (0.0, 0.0);
        for round in 0..ROUNDS {
            let off = |(term, at): &(Vector6<f64>, f64)| at - term.dot(&height);
            if round > 0 {
                let size = upper_median(local.iter().map(|one| off(one).abs()).collect()).unwrap_or(0.0);
                // The fit takes six of the neighbours' freedoms; what is left is scaled up for that.
                let scale = 1.3 * MAD_TO_SIGMA_ROUNDED * size + 1e-9;
                for (weight, one) in weights.iter_mut().zip(&local) {
                    *weight = (1.0 - (off(one) / (4.0 * scale)).powi(2)).max(0.0).powi(2);
                }
            }
            let mut system = Matrix6::zeros();
            let mut right = Vector6::zeros();
            for ((term, at), weight) in local.iter().zip(&weights) {
                system += term * term.transpose() * *weight;
                right += term * (*at * *weight);
            }
            for i in 1..6 {
                system[(i, i)] += if i < 3 { SLOPE_RIDGE } else { RIDGE * count };
            }
            let inverse = system.cholesky()?.inverse();
            height = inverse * right;
            let off = |(term, at): &(Vector6<f64>, f64)| at - term.dot(&height);
            let total: f64 = weights.iter().sum();
            let squares: f64 =
                local.iter().zip(&weights).map(|(one, weight)| weight * off(one).powi(2)).sum();
            variance = squares / total * count / (count - 5.0).max(1.0);
            slope = variance * inverse[(1, 1)].max(inverse[(2, 2)]);
        }
        let scatter_m = reach_m * variance.sqrt();
        Some(Patch { foot, axes, height, reach_m, scatter_m, slope_variance: slope })
    }

    /// To first order; beyond the reach the patch goes on straight. `None` too far sideways.
    fn offset(&self, point: &Point3<f64>) -> Option<Offset> {
        let [u, v, height] = self.axes.map(|axis| axis.dot(&(point - self.foot)) / self.reach_m);
        let shrink = u.hypot(v).max(1.0).recip();
        let (inner_u, inner_v) = (u * shrink, v * shrink);
        let f = &self.height;
        let slope_u = f[1] + 2.0 * f[3] * inner_u + f[4] * inner_v;
        let slope_v = f[2] + f[4] * inner_u + 2.0 * f[5] * inner_v;
        let level = f.dot(&terms(inner_u, inner_v)) + slope_u * (u - inner_u) + slope_v * (v - inner_v);
        let upright = self.axes[2] - self.axes[0] * slope_u - self.axes[1] * slope_v;
        let length = upright.norm();
        let height_m = (height - level) / length * self.reach_m;
        let sideways_m = u.hypot(v) * self.reach_m;
        (sideways_m <= SIDEWAYS * self.reach_m + SIDEWAYS_OF_HEIGHT * height_m.abs()).then(|| Offset {
            height_m,
            normal: upright / length,
            scatter_m: self.scatter_m,
            slope_variance: self.slope_variance,
        })
    }
}

/// A cloud with its patches.
#[derive(Debug)]
pub struct Surface {
    cloud: CloudIndex,
    patches: Vec<Option<Patch>>,
}

impl Surface {
    /// Of these points, each patch from so many neighbours.
    pub fn new(points: Vec<Point3<f64>>, neighbours: usize) -> Result<Self, CloudError> {
        let cloud = CloudIndex::new(points)?;
        let patches = cloud.points().par_iter().map(|foot| Patch::at(&cloud, *foot, neighbours)).collect();
        Ok(Surface { cloud, patches })
    }

    /// Its points \[m\].
    pub fn points(&self) -> &[Point3<f64>] {
        self.cloud.points()
    }

    /// The middle one of how far patches reach \[m\]; `None` without a patch.
    pub fn reach_m(&self) -> Option<f64> {
        let mut all: Vec<f64> = self.patches.iter().flatten().map(|patch| patch.reach_m).collect();
        all.sort_by(f64::total_cmp);
        all.get(all.len() / 2).copied()
    }

    /// How far a point is off; `None` where there is no surface near.
    pub fn offset(&self, point: &Point3<f64>) -> Option<Offset> {
        let near = self.cloud.k_nearest(point, BLENDED);
        let mut found = near.iter().map(|other| self.patches[other.index].as_ref()?.offset(point));
        let first = found.next()??;
        let mut sum = first;
        let mut count = 1.0;
        for other in found.flatten() {
            let agreement = other.normal.dot(&first.normal);
            if agreement.abs() >= AGREES {
                sum.height_m += agreement.signum() * other.height_m;
                sum.normal += agreement.signum() * other.normal;
                sum.scatter_m += other.scatter_m;
                sum.slope_variance += other.slope_variance;
                count += 1.0;
            }
        }
        Some(Offset {
            height_m: sum.height_m / count,
            normal: sum.normal.normalize(),
            scatter_m: sum.scatter_m / count,
            slope_variance: sum.slope_variance / count,
        })
    }
}

/// `most` of the points at the most: a random one of each stretch of equally many, in their order. Means of cells
/// of a grid would be smoother, but where a wall of cells runs along a noisy surface they lie beside it.
pub fn thinned(points: &[Point3<f64>], most: usize) -> Vec<Point3<f64>> {
    if points.len() <= most {
        return points.to_vec();
    }
    let mut draws = ChaCha8Rng::seed_from_u64(0);
    let stretches = points.chunks(points.len().div_ceil(most.max(1)));
    stretches.map(|stretch| stretch[draws.random_range(0..stretch.len())]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::tests::Draws;

    #[test]
    fn a_ball_is_a_surface_without_the_bias_of_its_curvature() {
        let mut draws = Draws::new(2);
        let radius = |point: &Point3<f64>| point.coords.norm();
        let ball: Vec<Point3<f64>> =
            (0..3000).map(|_| Point3::from(Vector3::from_fn(|_, _| draws.normal()).normalize())).collect();
        let surface = Surface::new(ball.clone(), 12).unwrap();
        let (mut all, mut bias) = (0.0, 0.0);
        for at in ball.iter().step_by(7) {
            let point = at * 1.02;
            let Some(found) = surface.offset(&point) else { continue };
            let side = found.normal.dot(&at.coords).signum();
            assert!((side * found.height_m - 0.02).abs() < 2e-3, "{found:?}");
            bias += side * found.height_m - (radius(&point) - 1.0);
            all += 1.0;
        }
        // The sagitta of a neighbourhood is 2e-3.
        assert!(all > 300.0 && (bias / all).abs() < 3e-4, "{all} {}", bias / all);
    }

    #[test]
    fn a_surface_ends_at_its_border() {
        let grid = (0..2500).map(|i| Point3::new(0.02 * f64::from(i % 50), 0.02 * f64::from(i / 50), 0.0));
        let surface = Surface::new(grid.collect(), 12).unwrap();
        assert!(surface.offset(&Point3::new(0.5, 0.5, 0.01)).is_some());
        assert!(surface.offset(&Point3::new(0.995, 0.5, 0.01)).is_none());
        assert!(surface.offset(&Point3::new(1.2, 0.5, 0.01)).is_none());
    }

    #[test]
    fn a_thinned_noisy_plate_is_where_it_was() {
        let mut draws = Draws::new(3);
        let plate: Vec<Point3<f64>> = (0..100_000)
            .map(|_| Point3::new(2.0 * draws.uniform(), 2.0 * draws.uniform(), 0.01 * draws.normal()))
            .collect();
        let thin = thinned(&plate, 4000);
        assert_eq!(thin.len(), 4000);
        let surface = Surface::new(thin, 12).unwrap();
        let (mut sum, mut count) = (0.0, 0.0);
        for i in 0..1000 {
            let height = if i % 2 == 0 { 0.02 } else { -0.02 };
            let at = Point3::new(0.2 + 1.6 * draws.uniform(), 0.2 + 1.6 * draws.uniform(), height);
            let Some(found) = surface.offset(&at) else { continue };
            sum += found.height_m * found.normal.z.signum() - height;
            count += 1.0;
        }
        assert!(count > 600.0 && (sum / count).abs() < 1e-3, "{count} {}", sum / count);
    }
}
