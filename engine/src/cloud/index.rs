//! The points of a cloud that are nearest to a point.
//!
//! The k-d tree finds who is near; distances are then computed from the coordinates as they are given,
//! so that no shift of the origin comes in between. Points at one distance come in the order of their
//! numbers. Equal points stand in the tree once, so that many of them cost no more than one.

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use nalgebra::Point3;
use rayon::prelude::*;
use std::num::NonZero;

/// No coordinate is larger \[m\]; beyond, squares lose their meaning.
const LARGEST_M: f64 = 1e12;

/// How much farther the tree is asked than what it answered, so that ties come along whatever the
/// order in which it adds up.
pub(super) const SLACK: f64 = 1.0 + 1e-14;

/// Why a cloud cannot be searched.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum CloudError {
    /// Without points, nothing is near.
    #[error("a cloud with at least one point is wanted")]
    Empty,
    /// What is no place.
    #[error("point {index} is at {coordinate} m; finite coordinates up to 1e12 m are wanted")]
    Coordinate {
        /// Number of the point, from 0.
        index: usize,
        /// Its first coordinate that is none.
        coordinate: f64,
    },
    /// More than the tree can number.
    #[error("{0} points; at most 4294967295 are wanted")]
    TooMany(usize),
}

/// A point of a cloud as it is seen from another point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Nearest {
    /// Its number in the cloud, from 0; the lowest one of several at the same distance.
    pub index: usize,
    /// How far it is \[m\].
    pub distance_m: f64,
}

/// A cloud that can be searched.
pub struct CloudIndex {
    points: Vec<Point3<f64>>,
    /// Of the distinct points.
    tree: ImmutableKdTree<f64, 3>,
    /// Numbers of the points, equal points side by side and in order.
    members: Vec<u32>,
    /// Where in `members` a distinct point starts; one more at the end.
    starts: Vec<u32>,
}

impl std::fmt::Debug for CloudIndex {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "CloudIndex of {} points", self.points.len())
    }
}

impl CloudIndex {
    /// Of these points \[m\].
    pub fn new(points: Vec<Point3<f64>>) -> Result<Self, CloudError> {
        if points.is_empty() {
            return Err(CloudError::Empty);
        }
        if u32::try_from(points.len()).is_err() {
            return Err(CloudError::TooMany(points.len()));
        }
        for (index, point) in points.iter().enumerate() {
            if let Some(coordinate) = no_coordinate(point) {
                return Err(CloudError::Coordinate { index, coordinate });
            }
        }
        let place = |number: u32| one_zero(&points[number as usize]);
        let order = |a: &u32, b: &u32| {
            let [p, q] = [a, b].map(|number| &points[*number as usize]);
            by_place(p, q).then(a.cmp(b))
        };
        let mut members: Vec<u32> = (0..points.len() as u32).collect();
        members.par_sort_unstable_by(order);
        let mut starts = Vec::with_capacity(points.len() + 1);
        let mut distinct = Vec::with_capacity(points.len());
        for (at, number) in members.iter().enumerate() {
            let here: [f64; 3] = place(*number).coords.into();
            if distinct.last() != Some(&here) {
                distinct.push(here);
                starts.push(at as u32);
            }
        }
        starts.push(members.len() as u32);
        let tree =
            ImmutableKdTree::new_from_slice(&distinct).map_err(|_| CloudError::TooMany(points.len()))?;
        Ok(CloudIndex { points, tree, members, starts })
    }

    /// Its points, in the order in which they were given \[m\].
    pub fn points(&self) -> &[Point3<f64>] {
        &self.points
    }

    /// The numbers of the points that equal a distinct one.
    fn members(&self, distinct: u32) -> &[u32] {
        let at = distinct as usize;
        &self.members[self.starts[at] as usize..self.starts[at + 1] as usize]
    }

    fn seen(&self, from: &Point3<f64>, number: u32) -> Nearest {
        let index = number as usize;
        Nearest { index, distance_m: (self.points[index] - from).norm() }
    }

    /// Its point nearest to a finite point.
    pub fn nearest(&self, from: &Point3<f64>) -> Nearest {
        let at: [f64; 3] = from.coords.into();
        let first = self.tree.query(&at).nearest_one::<SquaredEuclidean<f64>>().execute();
        let mut best = self.seen(from, self.members(first.item)[0]);
        let radius = first.distance * SLACK;
        for other in self.tree.query(&at).within::<SquaredEuclidean<f64>>(radius).unsorted().execute() {
            let other = self.seen(from, self.members(other.item)[0]);
            if before(&other, &best).is_lt() {
                best = other;
            }
        }
        best
    }

    /// Its `count` points nearest to a finite point (all, if it has no more), nearest first.
    pub fn k_nearest(&self, from: &Point3<f64>, count: usize) -> Vec<Nearest> {
        let Some(wanted) = NonZero::new(count) else { return Vec::new() };
        let at: [f64; 3] = from.coords.into();
        let found = self.tree.query(&at).nearest_n::<SquaredEuclidean<f64>>(wanted).execute();
        let farthest = found.iter().map(|other| other.distance).fold(0.0, f64::max);
        let found =
            self.tree.query(&at).within::<SquaredEuclidean<f64>>(farthest * SLACK).unsorted().execute();
        let mut nearest: Vec<Nearest> = found
            .iter()
            .flat_map(|other| self.members(other.item).iter().take(count))
            .map(|number| self.seen(from, *number))
            .collect();
        nearest.sort_unstable_by(before);
        nearest.truncate(count);
        nearest
    }

    /// All its points within a radius \[m\] of a finite point (the radius belongs to it), nearest first.
    pub fn within(&self, from: &Point3<f64>, radius_m: f64) -> Vec<Nearest> {
        let at: [f64; 3] = from.coords.into();
        let radius = radius_m * radius_m * SLACK;
        let found = self.tree.query(&at).within::<SquaredEuclidean<f64>>(radius).unsorted().execute();
        let mut nearest: Vec<Nearest> = found
            .iter()
            .flat_map(|other| self.members(other.item))
            .map(|number| self.seen(from, *number))
            .filter(|other| other.distance_m <= radius_m)
            .collect();
        nearest.sort_unstable_by(before);
        nearest
    }
}

/// The first coordinate of a point that is none.
pub(super) fn no_coordinate(point: &Point3<f64>) -> Option<f64> {
    point.iter().copied().find(|c| c.is_nan() || c.abs() > LARGEST_M)
}

/// A place whose zeros are all positive: zeros of both signs are one place.
fn one_zero(point: &Point3<f64>) -> Point3<f64> {
    point.map(|c| c + 0.0)
}

/// The order of places by x, then y, then z.
pub(super) fn by_place(a: &Point3<f64>, b: &Point3<f64>) -> std::cmp::Ordering {
    let (p, q) = (one_zero(a), one_zero(b));
    p.x.total_cmp(&q.x).then(p.y.total_cmp(&q.y)).then(p.z.total_cmp(&q.z))
}

fn before(a: &Nearest, b: &Nearest) -> std::cmp::Ordering {
    a.distance_m.total_cmp(&b.distance_m).then(a.index.cmp(&b.index))
}

/// For each point its nearest in a cloud: the cloud-to-cloud distances.
pub fn distances(from: &[Point3<f64>], to: &CloudIndex) -> Vec<Nearest> {
    from.par_iter().map(|point| to.nearest(point)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::tests::{Draws, scan, shell};

    fn brute(from: &Point3<f64>, points: &[Point3<f64>]) -> Vec<Nearest> {
        let mut all: Vec<Nearest> = points
            .iter()
            .enumerate()
            .map(|(index, p)| {
                let [x, y, z] = [p.x - from.x, p.y - from.y, p.z - from.z];
                Nearest { index, distance_m: (x * x + y * y + z * z).sqrt() }
            })
            .collect();
        all.sort_by(|a, b| a.distance_m.total_cmp(&b.distance_m).then(a.index.cmp(&b.index)));
        all
    }

    fn is_as_brute_force_says(from: &[Point3<f64>], points: Vec<Point3<f64>>) {
        let index = CloudIndex::new(points).unwrap();
        for (point, found) in from.iter().zip(distances(from, &index)) {
            let wanted = brute(point, index.points());
            let near = |a: &Nearest, b: &Nearest| {
                a.index == b.index && (a.distance_m - b.distance_m).abs() <= 1e-15 * b.distance_m
            };
            assert!(near(&found, &wanted[0]), "{found:?} {:?}", wanted[0]);
            let several = index.k_nearest(point, 9);
            assert_eq!(several.len(), 9.min(wanted.len()));
            assert!(several.iter().zip(&wanted).all(|(a, b)| near(a, b)), "{several:?} {:?}", &wanted[..9]);
            let radius_m = wanted[wanted.len() / 7].distance_m;
            let inside = index.within(point, radius_m);
            let wanted = wanted.iter().filter(|other| other.distance_m <= radius_m).count();
            assert_eq!(inside.len(), wanted);
        }
    }

    #[test]
    fn the_nearest_are_those_of_brute_force() {
        is_as_brute_force_says(&shell(100, 2), shell(3000, 1));
    }

    /// `tests/clouds/compare.py --golden` writes these numbers, by scipy's k-d tree.
    #[test]
    fn distances_to_a_scan_are_those_of_another_program() {
        let golden = include_str!("../../../tests/clouds/nearest_400.txt");
        let place = |i: u32| {
            let i = f64::from(i);
            Point3::new(2.5 * i.sin(), (1.7 * i).cos(), 0.8 + 0.8 * (2.3 * i).sin())
        };
        let from: Vec<Point3<f64>> = (0..400).map(place).collect();
        let found = distances(&from, &CloudIndex::new(scan()).unwrap());
        assert_eq!(golden.lines().count(), found.len());
        for (row, found) in golden.lines().zip(found) {
            let (index, distance) = row.split_once(' ').unwrap();
            assert_eq!(found.index, index.parse::<usize>().unwrap());
            assert!((found.distance_m - distance.parse::<f64>().unwrap()).abs() < 1e-12, "{row} {found:?}");
        }
    }

    #[test]
    fn the_shift_to_a_map_changes_nothing() {
        let shift = nalgebra::Vector3::new(500_000.0, 3_900_000.0, 0.0);
        let moved = |points: Vec<Point3<f64>>| points.iter().map(|p| p + shift).collect::<Vec<_>>();
        is_as_brute_force_says(&moved(shell(100, 2)), moved(shell(3000, 1)));
        let near = distances(&shell(300, 2), &CloudIndex::new(shell(2000, 1)).unwrap());
        let far = distances(&moved(shell(300, 2)), &CloudIndex::new(moved(shell(2000, 1))).unwrap());
        for (a, b) in near.iter().zip(&far) {
            assert!((a.distance_m - b.distance_m).abs() < 1e-8);
        }
    }

    #[test]
    fn equal_points_and_flat_grids_are_searched() {
        let same = vec![Point3::new(1.0, 2.0, 3.0); 10_000];
        let index = CloudIndex::new(same.clone()).unwrap();
        assert_eq!(index.nearest(&Point3::new(1.0, 2.0, 5.0)), Nearest { index: 0, distance_m: 2.0 });
        let several: Vec<usize> = index.k_nearest(&same[0], 4).iter().map(|n| n.index).collect();
        assert_eq!(several, [0, 1, 2, 3]);
        assert_eq!(index.within(&same[0], 0.0).len(), 10_000);
        assert_eq!(distances(&same, &index).iter().filter(|n| n.index == 0).count(), 10_000);

        // Every query in the middle of a cell has four nearest.
        let at = |i: usize| Point3::new((i % 400) as f64, (i / 400) as f64, -0.0);
        let index = CloudIndex::new((0..100_000).map(at).collect()).unwrap();
        for i in [0, 399 - 1, 77_777, 98_000] {
            let middle = at(i) + nalgebra::Vector3::new(0.5, 0.5, 0.25);
            let several: Vec<usize> = index.k_nearest(&middle, 4).iter().map(|n| n.index).collect();
            assert_eq!(several, [i, i + 1, i + 400, i + 401]);
            assert_eq!(index.nearest(&middle).index, i);
        }
    }

    #[test]
    fn ties_are_the_lowest_number_in_any_order() {
        let mut draws = Draws::new(4);
        let whole: Vec<Point3<f64>> =
            (0..2000).map(|_| Point3::from([0; 3].map(|_| (draws.uniform() * 7.0).floor()))).collect();
        is_as_brute_force_says(&whole[..60], whole.clone());
    }

    #[test]
    fn what_cannot_be_searched_is_named() {
        assert_eq!(CloudIndex::new(Vec::new()).unwrap_err(), CloudError::Empty);
        for bad in [f64::NAN, f64::INFINITY, 1e200] {
            let points = vec![Point3::origin(), Point3::new(0.0, bad, 0.0)];
            let text = CloudIndex::new(points).unwrap_err().to_string();
            assert!(text.starts_with("point 1 is at "), "{text}");
        }
    }

    #[test]
    fn distances_are_those_of_any_number_of_threads() {
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| distances(&shell(3000, 2), &CloudIndex::new(shell(60_000, 1)).unwrap()))
        };
        assert_eq!(run(1), run(3));
    }
}
