//! Points on the surface of a vehicle, and which way it faces there.

use super::scenario::BodySettings;
use super::wander::{Purpose, stream};
use crate::cloud::CloudIndex;
use crate::cloud::plane::{NEIGHBOURS, plane_near};
use crate::reference::{Scan, read_cloud};
use crate::tables::{Finding, Findings};
use nalgebra::{Point3, Vector3};
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use std::path::Path;

/// Points of a parametric car that stand for its scan.
const SCAN_POINTS: usize = 5000;
/// A marker lies so near to the middle of the body, along and across \[m\].
const MARKER_NEAR_M: [f64; 2] = [1.0, 0.4];

/// Where a parametric car begins, as a share of its height.
const LOWEST_OF_HEIGHT: f64 = 0.18;

/// A point of a surface and the unit normal there, outwards.
pub type Faced = (Point3<f64>, Vector3<f64>);

/// A body.
pub struct Body {
    surface: Surface,
    axis: Axis,
    /// The smallest and the largest of each coordinate.
    bounds: [Point3<f64>; 2],
    /// A marker on its roof.
    pub marker: Point3<f64>,
    /// Points all over its surface, as a scan has them.
    pub scan: Vec<Point3<f64>>,
}

enum Surface {
    /// Quadrangles, and the sum of the areas up to each.
    Quadrangles(Vec<([Vector3<f64>; 4], f64)>),
    /// The triangles of a mesh likewise.
    Triangles(Vec<([Point3<f64>; 3], f64)>),
    /// Points of a cloud.
    Points(Vec<Faced>),
}

/// The quadrangles of a car: a body up to its shoulders, a cabin with slanted sides on it.
fn car([length, width, height]: [f64; 3]) -> Vec<[Vector3<f64>; 4]> {
    let (l, w) = (0.5 * length, 0.5 * width);
    let (low, shoulder) = (LOWEST_OF_HEIGHT * height, 0.6 * height);
    // Cabin: at the shoulders and at the roof.
    let (rear, front, side) = (-0.9 * l, 0.45 * l, 0.95 * w);
    let (roof_rear, roof_front, roof_side) = (-0.6 * l, 0.1 * l, 0.75 * w);
    let p = Vector3::new;
    let mut all = vec![
        [p(l, -w, low), p(l, w, low), p(l, w, shoulder), p(l, -w, shoulder)],
        [p(-l, w, low), p(-l, -w, low), p(-l, -w, shoulder), p(-l, w, shoulder)],
        [p(front, -w, shoulder), p(l, -w, shoulder), p(l, w, shoulder), p(front, w, shoulder)],
        [p(-l, -w, shoulder), p(rear, -w, shoulder), p(rear, w, shoulder), p(-l, w, shoulder)],
        [
            p(roof_rear, -roof_side, height),
            p(roof_front, -roof_side, height),
            p(roof_front, roof_side, height),
            p(roof_rear, roof_side, height),
        ],
        [
            p(front, -side, shoulder),
            p(front, side, shoulder),
            p(roof_front, roof_side, height),
            p(roof_front, -roof_side, height),
        ],
        [
            p(rear, side, shoulder),
            p(rear, -side, shoulder),
            p(roof_rear, -roof_side, height),
            p(roof_rear, roof_side, height),
        ],
    ];
    // Left and right.
    let left = [
        [p(l, w, low), p(-l, w, low), p(-l, w, shoulder), p(l, w, shoulder)],
        [
            p(front, side, shoulder),
            p(rear, side, shoulder),
            p(roof_rear, roof_side, height),
            p(roof_front, roof_side, height),
        ],
    ];
    let mirror = |v: Vector3<f64>| Vector3::new(v.x, -v.y, v.z);
    all.extend(left.iter().map(|[a, b, c, d]| [mirror(*b), mirror(*a), mirror(*d), mirror(*c)]));
    all.extend(left);
    all
}

impl Body {
    /// The body of a vehicle. `seed` draws the points that stand for the scan of a parametric one.
    pub fn new(settings: &BodySettings, folder: &Path, seed: u64, thing: usize) -> Result<Body, Findings> {
        match settings {
            BodySettings::Car { size_m } => Ok(Body::car(*size_m, seed, thing)),
            BodySettings::Scan(file) => Body::read(folder, file),
        }
    }

    fn car(size_m: [f64; 3], seed: u64, thing: usize) -> Body {
        let mut sum = 0.0;
        let quadrangles = car(size_m).into_iter().map(|corners| {
            let [a, b, c, d] = corners;
            sum += 0.5 * (c - a).cross(&(d - b)).norm();
            (corners, sum)
        });
        let surface = Surface::Quadrangles(quadrangles.collect());
        let marker = Point3::new(-0.1 * size_m[0], 0.0, size_m[2]);
        let half = Point3::from(Vector3::from(size_m) * 0.5);
        let axis = Axis::of(&[half, Point3::new(-half.x, -half.y, 0.2 * size_m[2])]);
        let low = Point3::new(-half.x, -half.y, LOWEST_OF_HEIGHT * size_m[2]);
        let bounds = [low, Point3::new(half.x, half.y, size_m[2])];
        let mut body = Body { surface, marker, axis, bounds, scan: Vec::new() };
        // Apart from the points that are tracked.
        let mut rng = stream(seed, 1, Purpose::Body, thing);
        body.scan = (0..SCAN_POINTS).map(|_| body.point(&mut rng).0).collect();
        body
    }

    fn read(folder: &Path, file: &str) -> Result<Body, Findings> {
        let Scan { points, triangles, .. } = read_cloud(&folder.join(file), file)?;
        let unfit = |wanted: &str, found: String| Findings::from(Finding::of_file(file, wanted, &found));
        let far = points.iter().find(|p| p.coords.norm() > 50.0);
        if let Some(far) = far {
            let found = format!("a point at ({:.1}, {:.1}, {:.1})", far.x, far.y, far.z);
            return Err(unfit("a body in its own frame, within 50 m of its origin", found));
        }
        let marker = |points: &[Point3<f64>]| {
            let near = |p: &&Point3<f64>| p.x.abs() < MARKER_NEAR_M[0] && p.y.abs() < MARKER_NEAR_M[1];
            let highest = |points: &mut dyn Iterator<Item = &Point3<f64>>| {
                points.copied().reduce(|a, b| if b.z > a.z { b } else { a })
            };
            highest(&mut points.iter().filter(near)).or_else(|| highest(&mut points.iter()))
        };
        let marker = marker(&points).ok_or_else(|| unfit("a body", "nothing".to_owned()))?;
        let axis = Axis::of(&points);
        let surface = if triangles.is_empty() {
            let index = CloudIndex::new(points.clone()).map_err(|e| unfit("a cloud", e.to_string()))?;
            let faced = |p: &Point3<f64>| {
                let out = axis.outwards(p);
                let normal = plane_near(&index, p, NEIGHBOURS).map_or(out, |(plane, _)| plane.normal);
                (*p, if normal.dot(&out) < 0.0 { -normal } else { normal })
            };
            Surface::Points(points.iter().map(faced).collect())
        } else {
            let mut sum = 0.0;
            let mut all = Vec::new();
            for corners in &triangles {
                let place = |k: usize| points.get(corners[k] as usize).copied();
                let Some([a, b, c]) = place(0).zip(place(1)).zip(place(2)).map(|((a, b), c)| [a, b, c])
                else {
                    return Err(unfit("triangles of points that are there", format!("{corners:?}")));
                };
                sum += 0.5 * (b - a).cross(&(c - a)).norm();
                all.push(([a, b, c], sum));
            }
            if sum <= 0.0 {
                return Err(unfit("triangles that have an area", "none".to_owned()));
            }
            Surface::Triangles(all)
        };
        let least = points.iter().fold(points[0], |a, b| a.inf(b));
        let most = points.iter().fold(points[0], |a, b| a.sup(b));
        Ok(Body { surface, marker, axis, bounds: [least, most], scan: points })
    }

    /// The corners of the box along its axes that holds it.
    pub fn corners(&self) -> [Point3<f64>; 8] {
        let [least, most] = self.bounds;
        let side = |at: usize, axis: usize| if at >> axis & 1 == 0 { least[axis] } else { most[axis] };
        std::array::from_fn(|at| Point3::new(side(at, 0), side(at, 1), side(at, 2)))
    }

    /// Whether the box of its lower part, or of its upper one in the middle half of its length, lies between two
    /// places.
    pub fn hides(&self, from: &Point3<f64>, to: &Point3<f64>) -> bool {
        let [least, most] = self.bounds;
        let lower = [least, Point3::new(most.x, most.y, least.z + 0.6 * (most.z - least.z))];
        let quarter = 0.25 * (most.x - least.x);
        let upper =
            [Point3::new(least.x + quarter, least.y, least.z), Point3::new(most.x - quarter, most.y, most.z)];
        [lower, upper].iter().any(|bounds| is_between(bounds, from, to))
    }

    /// A point of the surface, each part of it as likely as it is large; of a cloud one of its points.
    pub fn point(&self, rng: &mut ChaCha8Rng) -> Faced {
        let (which, u, v): (f64, f64, f64) = (rng.random(), rng.random(), rng.random());
        fn chosen<T>(parts: &[(T, f64)], which: f64) -> &T {
            let sum = parts.last().map_or(0.0, |part| part.1);
            let at = parts.partition_point(|part| part.1 <= which * sum);
            &parts[at.min(parts.len() - 1)].0
        }
        match &self.surface {
            Surface::Quadrangles(parts) => {
                let [a, b, c, d] = chosen(parts, which);
                let (low, high) = (a + u * (b - a), d + u * (c - d));
                let normal = (c - a).cross(&(d - b)).normalize();
                (Point3::from(low + v * (high - low)), normal)
            }
            Surface::Triangles(parts) => {
                let [a, b, c] = chosen(parts, which);
                let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
                let place = a + u * (b - a) + v * (c - a);
                let normal = (b - a).cross(&(c - a)).normalize();
                let out = self.axis.outwards(&place);
                (place, if normal.dot(&out) < 0.0 { -normal } else { normal })
            }
            Surface::Points(points) => points[((which * points.len() as f64) as usize).min(points.len() - 1)],
        }
    }
}

/// Whether a box lies between two places, or around the second.
fn is_between([least, most]: &[Point3<f64>; 2], from: &Point3<f64>, to: &Point3<f64>) -> bool {
    let (mut enter, mut leave) = (0.0_f64, 1.0_f64);
    for axis in 0..3 {
        let way = to[axis] - from[axis];
        let shares = [(least[axis] - from[axis]) / way, (most[axis] - from[axis]) / way];
        if way == 0.0 {
            if !(least[axis]..=most[axis]).contains(&from[axis]) {
                return false;
            }
            continue;
        }
        enter = enter.max(shares[0].min(shares[1]));
        leave = leave.min(shares[0].max(shares[1]));
    }
    enter < leave
}

/// The axis of a body: the middle half of its length, at half its width and height.
struct Axis {
    ends: [f64; 2],
    y: f64,
    z: f64,
}

impl Axis {
    fn of(points: &[Point3<f64>]) -> Axis {
        let bounds = |axis: usize| {
            let values = || points.iter().map(|p| p[axis]);
            [values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max)]
        };
        let middle = |[least, most]: [f64; 2]| 0.5 * (least + most);
        let x = bounds(0);
        let quarter = 0.25 * (x[1] - x[0]);
        let ends = [middle(x) - quarter, middle(x) + quarter];
        Axis { ends, y: middle(bounds(1)), z: middle(bounds(2)) }
    }

    /// Away from it.
    fn outwards(&self, from: &Point3<f64>) -> Vector3<f64> {
        let along = from.x.clamp(self.ends[0], self.ends[1]);
        (from - Point3::new(along, self.y, self.z)).try_normalize(1e-9).unwrap_or(Vector3::z())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_car_has_its_size_and_faces_outwards() {
        let size = [4.5, 1.8, 1.5];
        let body = Body::new(&BodySettings::Car { size_m: size }, Path::new(""), 1, 0).unwrap();
        let mut rng = stream(1, 0, Purpose::Body, 0);
        let mut top = 0;
        for _ in 0..2000 {
            let (p, n) = body.point(&mut rng);
            assert!(p.x.abs() <= 2.25 + 1e-9 && p.y.abs() <= 0.9 + 1e-9 && (0.2..=1.5 + 1e-9).contains(&p.z));
            assert!((n.norm() - 1.0).abs() < 1e-12);
            // From a point of a convex-ish body a step outwards leaves the box of its axis.
            assert!(n.dot(&body.axis.outwards(&p)) > -0.2, "{p} {n}");
            assert!(n.z >= -1e-12, "nothing faces down");
            top += usize::from(n.z > 0.9);
        }
        assert!((200..1400).contains(&top), "{top}");
        assert_eq!(body.marker.z, 1.5);
    }

    #[test]
    fn a_scan_faces_outwards_too() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("problems/suv-exact/reference");
        let read = |file: &str| Body::new(&BodySettings::Scan(file.to_owned()), &folder, 1, 0);
        let body = read("car1.ply").unwrap();
        let mut rng = stream(1, 0, Purpose::Body, 0);
        for _ in 0..300 {
            let (p, n) = body.point(&mut rng);
            assert!(body.scan.contains(&p));
            assert!(n.dot(&body.axis.outwards(&p)) >= 0.0);
        }
        assert!(read("car1.xyz").is_err());
    }
}
