//! The pose of a calibrated camera from three points: all real solutions.
//!
//! With unit rays `y_i`, distances `l_i` along them and `c_ij = y_i . y_j`, the law of cosines says
//!
//! ```text
//! l_i^2 + l_j^2 - 2 c_ij l_i l_j = |X_i - X_j|^2 = a_ij            (Grunert 1841)
//! ```
//!
//! Two combinations of the three equations have no right side: two conics `l^T D1 l = l^T D2 l = 0` in
//! the ratios of the distances. A member `D1 + g D2` of their pencil that is singular, `g` a root of a
//! cubic, is a pair of lines that meets either conic where both meet. Each line leaves a quadratic.
//!
//! Sources: Persson and Nordberg, *Lambda Twist: an accurate fast robust perspective three point
//! solver*, ECCV 2018 (the pencil, the final Newton steps on the distances); Richter-Gebert,
//! *Perspectives on Projective Geometry*, 2011, section 11.3 (how a singular conic falls apart).

use crate::geometry::Pose;
use nalgebra::{Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

/// Sine of the smallest angle of a triangle, and of the angle between two rays, below which they are
/// said to be degenerate.
const LEAST_SINE: f64 = 1e-7;
/// Newton steps on the distances.
const POLISH_STEPS: usize = 5;
/// Largest error of a law of cosines as a share of the longest side squared.
const TOLERANCE: f64 = 1e-9;
/// Roots whose distances differ by less than this share are the same one.
const SAME_ROOT: f64 = 1e-7;

/// Every `world_from_camera` from which `points` \[m\] are seen along `rays` (any length, z forward), in
/// front of the camera; at most four. None where the points lie on one line or two of them, or two
/// rays, coincide.
pub fn p3p(points: &[Point3<f64>; 3], rays: &[Vector3<f64>; 3]) -> Vec<Pose> {
    let mut poses = Vec::with_capacity(4);
    let Some(triangle) = Triangle::new(points, rays) else { return poses };
    for distances in triangle.distances() {
        let in_camera = [0, 1, 2].map(|i| triangle.rays[i] * distances[i]);
        poses.extend(pose_of(points, &in_camera));
    }
    poses
}

/// The three laws of cosines, lengths in units of the longest side.
struct Triangle {
    rays: [Vector3<f64>; 3],
    /// Squared sides 12, 13, 23.
    sides: [f64; 3],
    /// Cosines between the rays, likewise.
    cosines: [f64; 3],
    unit_m: f64,
}

/// Corners of the sides.
const PAIRS: [(usize, usize); 3] = [(0, 1), (0, 2), (1, 2)];

impl Triangle {
    fn new(points: &[Point3<f64>; 3], rays: &[Vector3<f64>; 3]) -> Option<Self> {
        let side = |(i, j): (usize, usize)| points[i] - points[j];
        let unit_m = PAIRS.map(|pair| side(pair).norm()).into_iter().fold(0.0, f64::max);
        let rays = [rays[0].try_normalize(0.0)?, rays[1].try_normalize(0.0)?, rays[2].try_normalize(0.0)?];
        let least_height = side(PAIRS[0]).cross(&side(PAIRS[1])).norm() / (unit_m * unit_m);
        let between_rays = PAIRS.map(|(i, j)| rays[i].cross(&rays[j]).norm());
        let is_sound = least_height > LEAST_SINE && between_rays.iter().all(|sine| *sine > LEAST_SINE);
        (unit_m.is_finite() && is_sound).then(|| Triangle {
            rays,
            sides: PAIRS.map(|pair| side(pair).norm_squared() / (unit_m * unit_m)),
            cosines: PAIRS.map(|(i, j)| rays[i].dot(&rays[j])),
            unit_m,
        })
    }

    /// The distances of the three points \[m\].
    fn distances(&self) -> Vec<Vector3<f64>> {
        let mut found: Vec<Vector3<f64>> = Vec::with_capacity(4);
        let [a12, a13, a23] = self.sides;
        let [c12, c13, c23] = self.cosines;
        #[rustfmt::skip]
        let d1 = Matrix3::new(
            a23, -a23 * c12, 0.0,
            -a23 * c12, a23 - a12, a12 * c23,
            0.0, a12 * c23, -a12,
        );
        #[rustfmt::skip]
        let d2 = Matrix3::new(
            a23, 0.0, -a23 * c13,
            0.0, -a13, a13 * c23,
            -a23 * c13, a13 * c23, a23 - a13,
        );
        for (singular, other) in singular_members(&d1, &d2) {
            for line in lines_of(&singular).into_iter().flatten() {
                for ratios in meet(&line, &other).into_iter().flatten() {
                    let Some(distances) = self.scaled(ratios).and_then(|l| self.polished(l)) else {
                        continue;
                    };
                    let is_new = |other: &Vector3<f64>| (other - distances).norm() > SAME_ROOT * other.norm();
                    if found.iter().all(is_new) {
                        found.push(distances);
                    }
                }
            }
        }
        found.truncate(4);
        found.iter().map(|l| l * self.unit_m).collect()
    }

    /// Distances with these ratios, all in front.
    fn scaled(&self, ratios: Vector3<f64>) -> Option<Vector3<f64>> {
        let ratios = if ratios.sum() < 0.0 { -ratios } else { ratios };
        if ratios.min() <= 0.0 {
            return None;
        }
        let longest = (0..3).max_by(|&i, &j| self.sides[i].total_cmp(&self.sides[j]))?;
        let (i, j) = PAIRS[longest];
        let square =
            ratios[i].powi(2) + ratios[j].powi(2) - 2.0 * self.cosines[longest] * ratios[i] * ratios[j];
        (square > 0.0).then(|| ratios * (self.sides[longest] / square).sqrt())
    }

    /// Newton steps; `None` where they do not end in a root in front of the camera.
    fn polished(&self, start: Vector3<f64>) -> Option<Vector3<f64>> {
        let mut l = start;
        let mut error = self.errors(&l);
        for _ in 0..POLISH_STEPS {
            let mut slope = Matrix3::zeros();
            for (row, (i, j)) in PAIRS.into_iter().enumerate() {
                slope[(row, i)] = 2.0 * (l[i] - self.cosines[row] * l[j]);
                slope[(row, j)] = 2.0 * (l[j] - self.cosines[row] * l[i]);
            }
            let Some(inverse) = slope.try_inverse() else { break };
            let next = l - inverse * error;
            let next_error = self.errors(&next);
            // Rounding is all that is left.
            if next_error.norm().partial_cmp(&error.norm()) != Some(std::cmp::Ordering::Less) {
                break;
            }
            (l, error) = (next, next_error);
        }
        (error.amax() <= TOLERANCE && l.min() > 0.0).then_some(l)
    }

    fn errors(&self, l: &Vector3<f64>) -> Vector3<f64> {
        Vector3::from_fn(|row, _| {
            let (i, j) = PAIRS[row];
            // (li - lj)^2 + 2 (1 - c) li lj keeps its digits where the rays are close.
            (l[i] - l[j]).powi(2) + 2.0 * (1.0 - self.cosines[row]) * l[i] * l[j] - self.sides[row]
        })
    }
}

/// The singular members of the pencil of two conics, each with another member.
fn singular_members(d1: &Matrix3<f64>, d2: &Matrix3<f64>) -> Vec<(Matrix3<f64>, Matrix3<f64>)> {
    let (adjugate1, adjugate2) = (adjugate(d1), adjugate(d2));
    // det(d1 + g d2), constant first.
    let cubic = [
        d1.determinant(),
        adjugate1.component_mul(&d2.transpose()).sum(),
        adjugate2.component_mul(&d1.transpose()).sum(),
        d2.determinant(),
    ];
    if cubic[3].abs() >= cubic[0].abs() {
        real_roots(cubic).into_iter().map(|g| (d1 + g * d2, if g.abs() > 1.0 { *d1 } else { *d2 })).collect()
    } else {
        let [c0, c1, c2, c3] = cubic;
        let roots = real_roots([c3, c2, c1, c0]);
        roots.into_iter().map(|g| (d2 + g * d1, if g.abs() > 1.0 { *d2 } else { *d1 })).collect()
    }
}

fn adjugate(m: &Matrix3<f64>) -> Matrix3<f64> {
    let [a, b, c] = [m.row(0).transpose(), m.row(1).transpose(), m.row(2).transpose()];
    Matrix3::from_columns(&[b.cross(&c), c.cross(&a), a.cross(&b)])
}

/// Real roots of `c0 + c1 x + c2 x^2 + c3 x^3`, polished by Newton's method.
fn real_roots([c0, c1, c2, c3]: [f64; 4]) -> Vec<f64> {
    if c3 == 0.0 {
        // Then the constant, which is no larger, is zero too.
        return vec![0.0];
    }
    let (b, c, d) = (c2 / c3, c1 / c3, c0 / c3);
    let shift = b / 3.0;
    let p = c - b * shift;
    let q = shift * (2.0 * shift * shift - c) + d;
    let discriminant = 0.25 * q * q + p * p * p / 27.0;
    let starts = if discriminant > 0.0 {
        let root = -(0.5 * q.abs() + discriminant.sqrt()).cbrt() * q.signum();
        vec![if root == 0.0 { 0.0 } else { root - p / (3.0 * root) } - shift]
    } else {
        let radius = 2.0 * (-p / 3.0).max(0.0).sqrt();
        let cosine = if radius == 0.0 { 0.0 } else { (3.0 * q / (p * radius)).clamp(-1.0, 1.0) };
        let angle = cosine.acos() / 3.0;
        let third = std::f64::consts::TAU / 3.0;
        (0..3).map(|k| radius * (angle - third * f64::from(k)).cos() - shift).collect()
    };
    let polish = |start: f64| {
        let mut x = start;
        for _ in 0..3 {
            let value = ((x + b) * x + c) * x + d;
            let slope = (3.0 * x + 2.0 * b) * x + c;
            let next = x - value / slope;
            if !next.is_finite() || (((next + b) * next + c) * next + d).abs() >= value.abs() {
                break;
            }
            x = next;
        }
        x
    };
    starts.into_iter().map(polish).collect()
}

/// The two lines that a singular conic consists of, where they are real.
fn lines_of(conic: &Matrix3<f64>) -> [Option<Vector3<f64>>; 2] {
    let adjugate = adjugate(conic);
    let pick = (0..3).max_by(|&i, &j| adjugate[(i, i)].abs().total_cmp(&adjugate[(j, j)].abs())).unwrap_or(0);
    let square = -adjugate[(pick, pick)];
    let mut split = *conic;
    if square > 0.0 {
        split += crate::geometry::skew(&(adjugate.column(pick) / square.sqrt()));
    } else if square < -1e-10 * conic.norm_squared() {
        return [None, None];
    }
    let at = split.iamax_full();
    [Some(split.row(at.0).transpose()), Some(split.column(at.1).into_owned())]
}

/// Where a line meets a conic.
fn meet(line: &Vector3<f64>, conic: &Matrix3<f64>) -> [Option<Vector3<f64>>; 2] {
    let Some(normal) = line.try_normalize(0.0) else { return [None, None] };
    let u = normal.cross(&Vector3::ith(normal.iamin(), 1.0)).normalize();
    let v = normal.cross(&u);
    let (a, b, c) = (u.dot(&(conic * u)), u.dot(&(conic * v)), v.dot(&(conic * v)));
    let discriminant = b * b - a * c;
    if discriminant < -1e-8 * (b * b + (a * c).abs()) {
        return [None, None];
    }
    let half = -(b + discriminant.max(0.0).sqrt().copysign(b));
    [(half, a), (c, half)].map(|(along_u, along_v)| (u * along_u + v * along_v).try_normalize(0.0))
}

/// `world_from_camera` of three points given in both frames.
fn pose_of(in_world: &[Point3<f64>; 3], in_camera: &[Vector3<f64>; 3]) -> Option<Pose> {
    let world = in_world.map(|p| p.coords);
    let rotation = axes(&world)? * axes(in_camera)?.transpose();
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
    let middle = |points: &[Vector3<f64>; 3]| points.iter().sum::<Vector3<f64>>() / 3.0;
    let position = middle(&world) - rotation * middle(in_camera);
    Some(Pose::from_parts(Translation3::from(position), rotation))
}

/// Axes that go with a triangle.
fn axes(points: &[Vector3<f64>; 3]) -> Option<Matrix3<f64>> {
    let first = (points[1] - points[0]).try_normalize(0.0)?;
    let third = (points[1] - points[0]).cross(&(points[2] - points[0])).try_normalize(0.0)?;
    Some(Matrix3::from_columns(&[first, third.cross(&first), third]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::rotation::exp;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn any_point(rng: &mut ChaCha8Rng, size: [f64; 3]) -> Point3<f64> {
        Point3::from(Vector3::from_fn(|axis, _| rng.random_range(-size[axis]..size[axis])))
    }

    /// Points in front of a camera that stands and looks anywhere.
    fn case(rng: &mut ChaCha8Rng) -> (Pose, [Point3<f64>; 3], [Vector3<f64>; 3]) {
        let turn = any_point(rng, [3.0; 3]).coords;
        let pose = Pose::from_parts(any_point(rng, [100.0; 3]).coords.into(), exp(&turn));
        let rays = [(); 3].map(|()| any_point(rng, [0.7, 0.4, 0.1]).coords.xy().push(1.0));
        let points = rays.map(|ray| pose * Point3::from(ray * rng.random_range(20.0..90.0)));
        (pose, points, rays)
    }

    fn gap(a: &Pose, b: &Pose) -> f64 {
        (a.translation.vector - b.translation.vector).norm() / 100.0
            + (a.rotation.to_rotation_matrix().matrix() - b.rotation.to_rotation_matrix().matrix()).norm()
    }

    #[test]
    fn the_pose_is_among_the_roots() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut gaps: Vec<f64> = (0..20_000)
            .map(|_| {
                let (pose, points, rays) = case(&mut rng);
                let roots = p3p(&points, &rays);
                roots.iter().map(|root| gap(root, &pose)).fold(f64::INFINITY, f64::min)
            })
            .collect();
        gaps.sort_by(f64::total_cmp);
        // Where two roots nearly coincide (on the dangerous cylinder) each is known to half the digits.
        assert!(gaps[19_900] < 1e-9, "{}", gaps[19_900]);
        assert!(gaps[19_999] < 1e-5, "{}", gaps[19_999]);
    }

    #[test]
    fn every_root_sees_the_points_along_the_rays() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let mut counts = [0; 5];
        for _ in 0..5_000 {
            let (_, points, rays) = case(&mut rng);
            let roots = p3p(&points, &rays);
            counts[roots.len()] += 1;
            for root in roots {
                for (point, ray) in points.iter().zip(&rays) {
                    let seen = root.inverse_transform_point(point).coords;
                    assert!(seen.z > 0.0 && (seen.xy() / seen.z - ray.xy()).norm() < 1e-8, "{seen} {ray}");
                }
            }
        }
        assert!(counts[0] == 0 && counts[1..].iter().all(|count| *count > 10), "{counts:?}");
    }

    /// The second road: the first distance is walked along, and the others follow from two laws of
    /// cosines; where the third changes its sign there is a root.
    #[test]
    fn no_root_that_a_walk_finds_is_missed() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut found = 0;
        for _ in 0..200 {
            let (_, points, rays) = case(&mut rng);
            let triangle = Triangle::new(&points, &rays).unwrap();
            let roots = triangle.distances();
            let [c12, c13, _] = triangle.cosines;
            let other = |l1: f64, c: f64, side: f64, sign: f64| {
                let square = side - l1 * l1 * (1.0 - c * c);
                (square >= 0.0).then(|| l1 * c + sign * square.sqrt()).filter(|l| *l > 0.0)
            };
            for (sign2, sign3) in [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)] {
                let value = |l1: f64| {
                    let l2 = other(l1, c12, triangle.sides[0], sign2)?;
                    let l3 = other(l1, c13, triangle.sides[1], sign3)?;
                    Some((triangle.errors(&Vector3::new(l1, l2, l3))[2], l1))
                };
                let most = 1.0 / (1.0 - c12.max(c13).powi(2)).sqrt();
                let steps = 4000;
                let walk: Vec<_> =
                    (1..steps).map(|k| value(most * f64::from(k) / f64::from(steps))).collect();
                for pair in walk.windows(2) {
                    let [Some((a, low)), Some((b, high))] = [pair[0], pair[1]] else { continue };
                    if a.signum() == b.signum() {
                        continue;
                    }
                    found += 1;
                    let margin = 1e-9 + (high - low);
                    let l1 = |root: &Vector3<f64>| root[0] / triangle.unit_m;
                    let is_there = roots.iter().any(|r| (low - margin..high + margin).contains(&l1(r)));
                    assert!(is_there, "a root near {low} is not in {roots:?}");
                }
            }
        }
        assert!(found > 300, "{found}");
    }

    #[test]
    fn degenerate_triples_have_no_root() {
        let rays = [Vector3::new(0.1, 0.0, 1.0), Vector3::new(-0.1, 0.2, 1.0), Vector3::new(0.3, -0.1, 1.0)];
        let (a, b) = (Point3::new(1.0, 2.0, 3.0), Point3::new(4.0, -2.0, 3.5));
        let on_line = a + (b - a) * 0.3;
        let c = Point3::new(0.0, 5.0, -1.0);
        for points in [[a, b, on_line], [a, a, b], [a, b, a], [a, b, b], [a, a, a]] {
            assert!(p3p(&points, &rays).is_empty(), "{points:?}");
        }
        for wrong in
            [[rays[0], rays[0], rays[1]], [rays[0], rays[1], rays[0]], [Vector3::zeros(), rays[0], rays[1]]]
        {
            assert!(p3p(&[a, b, c], &wrong).is_empty());
        }
        let endless = [Point3::new(f64::NAN, 0.0, 0.0), b, c];
        assert!(p3p(&endless, &rays).is_empty());
        assert!(p3p(&[Point3::new(1e300, 0.0, 0.0), b, c], &rays).is_empty());
        // Nearly degenerate: whatever there is, is a number.
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        for exponent in 1..14 {
            let mut near = on_line;
            near.x += 10_f64.powi(-exponent);
            let rays = [(); 3].map(|()| any_point(&mut rng, [0.7, 0.4, 0.1]).coords.xy().push(1.0));
            for pose in p3p(&[a, b, near], &rays) {
                assert!(pose.to_homogeneous().iter().all(|v| v.is_finite()));
            }
        }
    }

    #[test]
    fn an_equilateral_triangle_seen_from_above_has_its_four_poses() {
        let corner = |k: i32| {
            let angle = f64::from(k) * std::f64::consts::TAU / 3.0;
            Point3::new(angle.cos(), angle.sin(), 0.0)
        };
        let points = [0, 1, 2].map(corner);
        // Fischler and Bolles, CACM 24 (1981): one distance can be shorter where the rays are close enough.
        let pose = Pose::from_parts(
            Vector3::new(0.0, 0.0, 3_f64.sqrt()).into(),
            exp(&(Vector3::x() * std::f64::consts::PI)),
        );
        let rays = points.map(|p| pose.inverse_transform_point(&p).coords);
        let roots = p3p(&points, &rays);
        assert_eq!(roots.len(), 4, "{roots:?}");
        assert!(roots.iter().any(|root| gap(root, &pose) < 1e-7));
    }
}
