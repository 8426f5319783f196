//! Signed distances of points to a triangle mesh.
//!
//! The nearest triangle comes from an R*-tree, the point on it from Ericson, *Real-Time Collision Detection*
//! (2005), section 5.1.5, and the sign from the angle-weighted pseudo-normal at that point: Baerentzen and
//! Aanaes, *Signed distance computation using the angle weighted pseudonormal*, IEEE TVCG 11 (2005).

use super::index::{SLACK, by_place, no_coordinate};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use rstar::{AABB, PointDistance, RTree, RTreeObject};

/// Why a mesh cannot be compared with.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MeshError {
    /// Nothing has an area.
    #[error("a mesh with at least one triangle that has an area is wanted")]
    Empty,
    /// A corner that is not there.
    #[error("triangle {triangle} has the corner {corner}; there are {points} points, numbered from 0")]
    Corner {
        /// Number of the triangle, from 0.
        triangle: usize,
        /// The number that its corner gives.
        corner: u32,
        /// How many points there are.
        points: usize,
    },
    /// What is no place.
    #[error("point {index} is at {coordinate} m; finite coordinates up to 1e12 m are wanted")]
    Coordinate {
        /// Number of the point, from 0.
        index: usize,
        /// Its first coordinate that is none.
        coordinate: f64,
    },
}

/// What a mesh encloses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Enclosure {
    /// A volume: each edge belongs to two triangles that run through it in opposite directions.
    Closed,
    /// Nothing: this many edges belong to one triangle only.
    Open {
        /// How many.
        edges: usize,
    },
    /// Nothing clear: through this many edges two triangles run in the same direction, or there are more than two.
    Inconsistent {
        /// How many.
        edges: usize,
    },
}

/// How far a point is from a mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeshDistance {
    /// Number of the nearest triangle, the lowest of several.
    pub triangle: usize,
    /// The nearest point of the mesh \[m\].
    pub closest: Point3<f64>,
    /// The distance \[m\]; negative inside a mesh that is [`Enclosure::Closed`], never negative with others.
    pub distance_m: f64,
}

/// A triangle that has an area.
struct Face {
    number: usize,
    /// Its corners, equal ones under one number.
    welded: [usize; 3],
    places: [Point3<f64>; 3],
    normal: Vector3<f64>,
}

/// A triangle in the tree, with the normals of its features.
#[derive(Clone, Debug)]
struct Facet {
    number: usize,
    corners: [Point3<f64>; 3],
    /// Unit normal, and those of the edges (0-1, 1-2, 2-0) and of the corners, not normalised.
    normal: Vector3<f64>,
    edges: [Vector3<f64>; 3],
    vertices: [Vector3<f64>; 3],
}

/// Where on a triangle a point is.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Feature {
    Face,
    Edge(usize),
    Vertex(usize),
}

/// A mesh to which distances can be taken.
#[derive(Debug)]
pub struct MeshIndex {
    tree: RTree<Facet>,
    enclosure: Enclosure,
    /// 1, or -1 where all triangles face inwards.
    outward: f64,
    without_area: usize,
}

impl MeshIndex {
    /// Of these corners \[m\] and triangles. Equal points are one corner, as in files that repeat them.
    pub fn new(points: &[Point3<f64>], triangles: &[[u32; 3]]) -> Result<Self, MeshError> {
        for (index, point) in points.iter().enumerate() {
            if let Some(coordinate) = no_coordinate(point) {
                return Err(MeshError::Coordinate { index, coordinate });
            }
        }
        for (triangle, corners) in triangles.iter().enumerate() {
            if let Some(corner) = corners.iter().copied().find(|corner| *corner as usize >= points.len()) {
                return Err(MeshError::Corner { triangle, corner, points: points.len() });
            }
        }
        let corner_of = welded(points);
        let mut faces: Vec<Face> = Vec::new();
        for (number, corners) in triangles.iter().enumerate() {
            let places = corners.map(|corner| points[corner as usize]);
            let area = (places[1] - places[0]).cross(&(places[2] - places[0]));
            let welded = corners.map(|corner| corner_of[corner as usize]);
            let is_flat = welded[0] == welded[1] || welded[1] == welded[2] || welded[2] == welded[0];
            if let Some(normal) = area.try_normalize(0.0).filter(|_| !is_flat) {
                faces.push(Face { number, welded, places, normal });
            }
        }
        let Some(first) = faces.first().map(|face| face.places[0]) else { return Err(MeshError::Empty) };
        // Edges with those that run through them, in order of their corners.
        let mut edges: Vec<([usize; 2], usize, usize, bool)> = Vec::with_capacity(3 * faces.len());
        let mut vertices = vec![Vector3::zeros(); points.len()];
        let mut volume = 0.0;
        for (face, Face { welded, places, normal, .. }) in faces.iter().enumerate() {
            for side in 0..3 {
                let (a, b) = (welded[side], welded[(side + 1) % 3]);
                edges.push(([a.min(b), a.max(b)], face, side, a < b));
                let to_next = places[(side + 1) % 3] - places[side];
                let to_last = places[(side + 2) % 3] - places[side];
                vertices[a] += normal * to_next.angle(&to_last);
            }
            let [a, b, c] = places.map(|place| place - first);
            volume += a.dot(&b.cross(&c)) / 6.0;
        }
        edges.sort_unstable();
        let mut facets: Vec<Facet> = faces
            .iter()
            .map(|face| Facet {
                number: face.number,
                corners: face.places,
                normal: face.normal,
                edges: [face.normal; 3],
                vertices: face.welded.map(|corner| vertices[corner]),
            })
            .collect();
        let (mut open, mut unclear) = (0, 0);
        for group in edges.chunk_by(|a, b| a.0 == b.0) {
            match group {
                [_] => open += 1,
                [one, other] if one.3 != other.3 => {}
                _ => unclear += 1,
            }
            let normal: Vector3<f64> = group.iter().map(|(_, face, _, _)| faces[*face].normal).sum();
            for (_, face, side, _) in group {
                facets[*face].edges[*side] = normal;
            }
        }
        let enclosure = match (open, unclear) {
            (0, 0) => Enclosure::Closed,
            (edges, 0) => Enclosure::Open { edges },
            (_, edges) => Enclosure::Inconsistent { edges },
        };
        Ok(MeshIndex {
            tree: RTree::bulk_load(facets),
            enclosure,
            outward: if volume < 0.0 { -1.0 } else { 1.0 },
            without_area: triangles.len() - faces.len(),
        })
    }

    /// What it encloses. Only with [`Enclosure::Closed`] distances have a sign.
    pub fn enclosure(&self) -> Enclosure {
        self.enclosure
    }

    /// How many triangles were left out because they have no area.
    pub fn without_area(&self) -> usize {
        self.without_area
    }

    /// The distance of a finite point, positive outside.
    pub fn distance(&self, from: &Point3<f64>) -> MeshDistance {
        let at: [f64; 3] = from.coords.into();
        let nearest = self.tree.nearest_neighbor_iter_with_distance_2(at).next();
        let square = nearest.map_or(f64::INFINITY, |(_, square)| square);
        let ties = self.tree.locate_within_distance(at, square * SLACK);
        let found = ties.chain(nearest.map(|(facet, _)| facet)).map(|facet| {
            let (closest, feature) = facet.closest(from);
            (facet, closest, feature, (from - closest).norm())
        });
        let order = |a: &(&Facet, _, _, f64), b: &(&Facet, _, _, f64)| {
            a.3.total_cmp(&b.3).then(a.0.number.cmp(&b.0.number))
        };
        let Some((facet, closest, feature, length)) = found.min_by(order) else {
            return MeshDistance { triangle: 0, closest: *from, distance_m: f64::NAN };
        };
        let normal = match feature {
            Feature::Face => facet.normal,
            Feature::Edge(side) => facet.edges[side],
            Feature::Vertex(corner) => facet.vertices[corner],
        };
        let is_inside =
            self.enclosure == Enclosure::Closed && self.outward * normal.dot(&(from - closest)) < 0.0;
        let distance_m = if is_inside { -length } else { length };
        MeshDistance { triangle: facet.number, closest, distance_m }
    }

    /// The distances of points \[m\], in their order.
    pub fn distances(&self, from: &[Point3<f64>]) -> Vec<MeshDistance> {
        from.par_iter().map(|point| self.distance(point)).collect()
    }
}

/// For each point the first one that equals it.
fn welded(points: &[Point3<f64>]) -> Vec<usize> {
    let order = |a: &usize, b: &usize| by_place(&points[*a], &points[*b]).then(a.cmp(b));
    let mut sorted: Vec<usize> = (0..points.len()).collect();
    sorted.sort_unstable_by(order);
    let mut first = vec![0; points.len()];
    for group in sorted.chunk_by(|a, b| points[*a] == points[*b]) {
        group.iter().for_each(|point| first[*point] = group[0]);
    }
    first
}

impl Facet {
    /// The point of the triangle nearest to `p`, and where on it that is.
    fn closest(&self, p: &Point3<f64>) -> (Point3<f64>, Feature) {
        let [a, b, c] = self.corners;
        let (ab, ac) = (b - a, c - a);
        let ap = p - a;
        let (d1, d2) = (ab.dot(&ap), ac.dot(&ap));
        if d1 <= 0.0 && d2 <= 0.0 {
            return (a, Feature::Vertex(0));
        }
        let bp = p - b;
        let (d3, d4) = (ab.dot(&bp), ac.dot(&bp));
        if d3 >= 0.0 && d4 <= d3 {
            return (b, Feature::Vertex(1));
        }
        let vc = d1 * d4 - d3 * d2;
        if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
            return (a + ab * (d1 / (d1 - d3)), Feature::Edge(0));
        }
        let cp = p - c;
        let (d5, d6) = (ab.dot(&cp), ac.dot(&cp));
        if d6 >= 0.0 && d5 <= d6 {
            return (c, Feature::Vertex(2));
        }
        let vb = d5 * d2 - d1 * d6;
        if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
            return (a + ac * (d2 / (d2 - d6)), Feature::Edge(2));
        }
        let va = d3 * d6 - d5 * d4;
        if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
            let along = (d4 - d3) / ((d4 - d3) + (d5 - d6));
            return (b + (c - b) * along, Feature::Edge(1));
        }
        (p - self.normal * self.normal.dot(&ap), Feature::Face)
    }
}

impl RTreeObject for Facet {
    type Envelope = AABB<[f64; 3]>;

    fn envelope(&self) -> Self::Envelope {
        AABB::from_points(self.corners.map(|corner| corner.coords.into()).iter())
    }
}

impl PointDistance for Facet {
    fn distance_2(&self, point: &[f64; 3]) -> f64 {
        let point = Point3::from(*point);
        (point - self.closest(&point).0).norm_squared()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::tests::Draws;

    const HALF: [f64; 3] = [2.3, 0.9, 0.8];

    /// A box, its triangles facing outwards.
    fn car() -> (Vec<Point3<f64>>, Vec<[u32; 3]>) {
        let sign = |corner: u32, axis: u32| if corner >> axis & 1 == 1 { 1.0 } else { -1.0 };
        let corner = |c: u32| Point3::from([0, 1, 2].map(|axis| HALF[axis as usize] * sign(c, axis)));
        let quads = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
        let triangles = quads.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect();
        ((0..8).map(corner).collect(), triangles)
    }

    /// A star: a sphere of `2 rings^2` triangles or so whose radius varies between 0.6 and 1.
    fn star(rings: u32) -> (Vec<Point3<f64>>, Vec<[u32; 3]>) {
        let mut points = vec![Point3::new(0.0, 0.0, 1.0), Point3::new(0.0, 0.0, -1.0)];
        for i in 1..rings {
            let polar = std::f64::consts::PI * f64::from(i) / f64::from(rings);
            for j in 0..rings {
                let azimuth = std::f64::consts::TAU * f64::from(j) / f64::from(rings);
                let radius = 0.8 + 0.2 * (5.0 * azimuth).sin() * (4.0 * polar).cos();
                let [x, y] = [azimuth.cos(), azimuth.sin()].map(|part| polar.sin() * part);
                points.push(Point3::new(x, y, polar.cos()) * radius);
            }
        }
        let at = |i: u32, j: u32| 2 + (i - 1) * rings + j % rings;
        let mut triangles = Vec::new();
        for j in 0..rings {
            triangles.push([0, at(1, j), at(1, j + 1)]);
            triangles.push([1, at(rings - 1, j + 1), at(rings - 1, j)]);
            for i in 1..rings - 1 {
                triangles.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)]);
                triangles.push([at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
            }
        }
        (points, triangles)
    }

    fn about(count: usize, reach: f64) -> Vec<Point3<f64>> {
        let mut draws = Draws::new(11);
        (0..count).map(|_| Point3::from([0; 3].map(|_| reach * (2.0 * draws.uniform() - 1.0)))).collect()
    }

    #[test]
    fn distances_to_a_box_are_those_of_its_formula() {
        let (points, triangles) = car();
        let mesh = MeshIndex::new(&points, &triangles).unwrap();
        assert_eq!(mesh.enclosure(), Enclosure::Closed);
        let far = Vector3::new(500_000.0, 3_900_000.0, 0.0);
        let moved: Vec<Point3<f64>> = points.iter().map(|p| p + far).collect();
        let mesh_far = MeshIndex::new(&moved, &triangles).unwrap();
        for p in about(3000, 3.0) {
            let over = Vector3::from_fn(|axis, _| p[axis].abs() - HALF[axis]);
            let wanted = over.map(|o| o.max(0.0)).norm() + over.max().min(0.0);
            let found = mesh.distance(&p);
            assert!((found.distance_m - wanted).abs() < 1e-14, "{p} {found:?} {wanted}");
            assert!((mesh_far.distance(&(p + far)).distance_m - wanted).abs() < 1e-8);
        }
    }

    /// Distance by many points of each triangle's plane, edges and corners, and the side by the winding number
    /// (the solid angles of van Oosterom and Strackee 1983).
    fn brute(p: &Point3<f64>, points: &[Point3<f64>], triangles: &[[u32; 3]]) -> f64 {
        let mut least = f64::INFINITY;
        let mut angle = 0.0;
        for corners in triangles {
            let [a, b, c] = corners.map(|corner| points[corner as usize] - p);
            let normal = (b - a).cross(&(c - a));
            let foot = normal * (a.dot(&normal) / normal.norm_squared());
            let sides = [(a, b), (b, c), (c, a)];
            if sides.iter().all(|(s, e)| (e - s).cross(&(foot - s)).dot(&normal) >= 0.0) {
                least = least.min(foot.norm());
            }
            for (s, e) in sides {
                let along = (-s.dot(&(e - s)) / (e - s).norm_squared()).clamp(0.0, 1.0);
                least = least.min((s + (e - s) * along).norm());
            }
            let [la, lb, lc] = [a.norm(), b.norm(), c.norm()];
            let below = la * lb * lc + a.dot(&b) * lc + b.dot(&c) * la + c.dot(&a) * lb;
            angle += 2.0 * a.dot(&b.cross(&c)).atan2(below);
        }
        if angle > std::f64::consts::TAU { -least } else { least }
    }

    #[test]
    fn distances_to_a_star_are_those_of_brute_force() {
        let (points, triangles) = star(24);
        let mesh = MeshIndex::new(&points, &triangles).unwrap();
        assert_eq!(mesh.enclosure(), Enclosure::Closed);
        let queries = about(800, 1.2);
        let mut inside = 0;
        for (p, found) in queries.iter().zip(mesh.distances(&queries)) {
            let wanted = brute(p, &points, &triangles);
            assert!((found.distance_m - wanted).abs() < 1e-12, "{p} {found:?} {wanted}");
            assert!(((p - found.closest).norm() - wanted.abs()).abs() < 1e-12);
            inside += usize::from(wanted < 0.0);
        }
        assert!(inside > 50);
    }

    #[test]
    fn a_mesh_turned_inside_out_has_the_same_inside() {
        let (points, mut triangles) = star(12);
        let right = MeshIndex::new(&points, &triangles).unwrap().distances(&about(100, 1.2));
        triangles.iter_mut().for_each(|corners| corners.swap(0, 1));
        let turned = MeshIndex::new(&points, &triangles).unwrap().distances(&about(100, 1.2));
        assert!(right.iter().zip(&turned).all(|(a, b)| (a.distance_m - b.distance_m).abs() < 1e-14));
    }

    #[test]
    fn corners_that_a_file_repeats_are_one() {
        let (points, triangles) = car();
        let soup: Vec<Point3<f64>> = triangles.iter().flatten().map(|c| points[*c as usize]).collect();
        let alone: Vec<[u32; 3]> = (0..12).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        assert_eq!(MeshIndex::new(&soup, &alone).unwrap().enclosure(), Enclosure::Closed);
    }

    #[test]
    fn a_mesh_that_encloses_nothing_says_so_and_has_no_sign() {
        let (points, mut triangles) = car();
        let last = triangles.pop().unwrap();
        let open = MeshIndex::new(&points, &triangles).unwrap();
        assert_eq!(open.enclosure(), Enclosure::Open { edges: 3 });
        assert!(open.distance(&Point3::origin()).distance_m > 0.0);
        triangles.push([last[1], last[0], last[2]]);
        let unclear = MeshIndex::new(&points, &triangles).unwrap();
        assert_eq!(unclear.enclosure(), Enclosure::Inconsistent { edges: 3 });
        assert!(unclear.distance(&Point3::origin()).distance_m > 0.0);
    }

    #[test]
    fn what_is_no_mesh_is_refused() {
        let (mut points, mut triangles) = car();
        triangles.push([3, 3, 4]);
        assert_eq!(MeshIndex::new(&points, &triangles).unwrap().without_area(), 1);
        assert_eq!(MeshIndex::new(&points, &[[1, 1, 2]]).unwrap_err(), MeshError::Empty);
        let missing = MeshIndex::new(&points, &[[0, 1, 8]]).unwrap_err().to_string();
        assert_eq!(missing, "triangle 0 has the corner 8; there are 8 points, numbered from 0");
        points[2].y = f64::NAN;
        assert!(matches!(MeshIndex::new(&points, &triangles), Err(MeshError::Coordinate { index: 2, .. })));
    }
}
