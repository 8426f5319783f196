//! A grid of heights, bilinear between cell centres.
//!
//! ```text
//!   (i, j+1) ---- (i+1, j+1)      u, v in 0..1 from the lower left centre of the patch
//!      |    patch    |            h(u, v) = a + b u + c v + e u v
//!   (i, j) ------ (i+1, j)
//! ```
//!
//! Along a ray `o + t d` the height above the patch is a quadratic in `t`.
//!
//! Beyond the border of the known ground the surface is continued for what stands on it
//! ([`super::Terrain::footing_at`]): a node without a height gets that of the plane through the known nodes near it,
//! weighted by the fourth power of their nearness, and outside the grid the outermost patches go on. Both are
//! continuous, and leave known ground as it is.

use super::footing::{Cache, FootingNoise, Nodes};
use super::{GridFault, Ground, NoGround, rounded};
use crate::rules::rules;
use nalgebra::{Matrix2, Matrix3, Point3, Vector2, Vector3};

rules! {
    /// Ground beyond the border of a terrain grid, for the minimiser.
    pub struct BorderRules {
        /// So far from known ground it is continued ...
        reach_m: f64 = 5.0, "m";
        /// ... and over so many cells at the most: a hole is looked through node by node ...
        most_cells: usize = 40, "cells";
        /// ... but over this many, however large they are.
        least_cells: usize = 2, "cells";
    }
}

const RULES: BorderRules = BorderRules::DEFAULT;

/// Heights at the nodes of a regular grid, its axes those of the world.
#[derive(Clone, Debug, PartialEq)]
pub struct Grid {
    /// x, y of the node with the smallest of both \[m\].
    first_m: [f64; 2],
    /// Distance of neighbours along x and y \[m\], above zero.
    step_m: [f64; 2],
    /// How many nodes along x and y, at least two each.
    size: [usize; 2],
    /// By y, then x; NaN where there is no height \[m\].
    heights_m: Vec<f64>,
    highest_m: f64,
    footing: Cache,
}

/// The surface between four nodes: its coefficients.
struct Patch {
    a: f64,
    b: f64,
    c: f64,
    e: f64,
}

impl Grid {
    /// From the place of the first node, the step to the next along x and y (either may be negative),
    /// how many there are along x and y, and the heights row by row, NaN where there is none \[m\].
    ///
    /// The error says what is not as it must be.
    pub fn new(
        first_m: [f64; 2],
        step_m: [f64; 2],
        size: [usize; 2],
        heights_m: Vec<f64>,
    ) -> Result<Grid, GridFault> {
        let fault = |wanted: &str, found: String| {
            Err(GridFault { line: None, column: None, wanted: wanted.to_owned(), found })
        };
        let [columns, rows] = size;
        if columns < 2 || rows < 2 {
            return fault("at least 2 columns and 2 rows", format!("{columns} x {rows}"));
        }
        if columns.checked_mul(rows) != Some(heights_m.len()) {
            return fault(&format!("{columns} x {rows} heights"), heights_m.len().to_string());
        }
        let last = |axis: usize| first_m[axis] + step_m[axis] * (size[axis] - 1) as f64;
        let has_extent = |axis: usize| last(axis).is_finite() && last(axis) != first_m[axis];
        if !(has_extent(0) && has_extent(1)) {
            return fault("a place and a cell size in metres", format!("{first_m:?}, {step_m:?}"));
        }
        if let Some(infinite) = heights_m.iter().find(|h| h.is_infinite()) {
            return fault("finite heights", infinite.to_string());
        }
        let highest_m = heights_m.iter().copied().fold(f64::NAN, f64::max);
        if highest_m.is_nan() {
            return fault("at least one height", "no data in every cell".to_owned());
        }
        let mut grid = Grid {
            first_m: [first_m[0].min(last(0)), first_m[1].min(last(1))],
            step_m: step_m.map(f64::abs),
            size,
            heights_m,
            highest_m,
            footing: Cache::default(),
        };
        if step_m[0] < 0.0 {
            grid.heights_m.chunks_exact_mut(columns).for_each(<[f64]>::reverse);
        }
        if step_m[1] < 0.0 {
            for row in 0..rows / 2 {
                let (low, high) = grid.heights_m.split_at_mut((rows - 1 - row) * columns);
                low[row * columns..(row + 1) * columns].swap_with_slice(&mut high[..columns]);
            }
        }
        Ok(grid)
    }

    /// How many heights along x and y.
    pub fn size(&self) -> [usize; 2] {
        self.size
    }

    /// From one node to the next along x and y \[m\].
    pub fn step_m(&self) -> [f64; 2] {
        self.step_m
    }

    /// Its nodes.
    fn nodes(&self) -> Nodes<'_> {
        Nodes { heights_m: &self.heights_m, size: self.size, step_m: self.step_m }
    }

    /// Place of the first and of the last node \[m\].
    pub fn corners_m(&self) -> [[f64; 2]; 2] {
        let last = |axis: usize| self.first_m[axis] + self.step_m[axis] * (self.size[axis] - 1) as f64;
        [self.first_m, [last(0), last(1)]]
    }

    /// Place in steps from the first node.
    fn in_steps(&self, x_m: f64, y_m: f64) -> Vector2<f64> {
        Vector2::new((x_m - self.first_m[0]) / self.step_m[0], (y_m - self.first_m[1]) / self.step_m[1])
    }

    /// The patch in which a place lies, given in steps; `None` outside the grid.
    fn patch_of(&self, place: &Vector2<f64>) -> Option<[usize; 2]> {
        let index = |axis: usize| {
            let last = self.size[axis] - 1;
            (0.0..=last as f64).contains(&place[axis]).then(|| (place[axis] as usize).min(last - 1))
        };
        Some([index(0)?, index(1)?])
    }

    /// `None` where one of its nodes has no height.
    fn patch(&self, [column, row]: [usize; 2]) -> Option<Patch> {
        let node = |i: usize, j: usize| self.heights_m[(row + j) * self.size[0] + column + i];
        let (a, right, up, across) = (node(0, 0), node(1, 0), node(0, 1), node(1, 1));
        let patch = Patch { a, b: right - a, c: up - a, e: (across - up) - (right - a) };
        (!patch.e.is_nan()).then_some(patch)
    }

    /// See [`super::Terrain::at`].
    pub fn at(&self, x_m: f64, y_m: f64) -> Result<Ground, NoGround> {
        let place = self.in_steps(x_m, y_m);
        let index = self.patch_of(&place).ok_or(NoGround::OutsideGrid { x_m, y_m })?;
        let patch = self.patch(index).ok_or(NoGround::NoData { x_m, y_m })?;
        Ok(self.ground_of(&patch, &place, index))
    }

    /// The ground of a patch at a place, given in steps.
    fn ground_of(&self, patch: &Patch, place: &Vector2<f64>, index: [usize; 2]) -> Ground {
        let (u, v) = (place.x - index[0] as f64, place.y - index[1] as f64);
        let [step_x, step_y] = self.step_m;
        Ground {
            height_m: patch.height(u, v),
            slope: Vector2::new((patch.b + patch.e * v) / step_x, (patch.c + patch.e * u) / step_y),
            bend_per_m: Matrix2::new(0.0, 1.0, 1.0, 0.0) * (patch.e / (step_x * step_y)),
        }
    }

    /// See [`super::Terrain::footing_at`].
    pub fn footing_at(&self, x_m: f64, y_m: f64) -> Option<Ground> {
        let place = self.in_steps(x_m, y_m);
        if !self.is_within_reach(&place) {
            return None;
        }
        let footing = self.footing.of(&self.nodes());
        let inside = |at: [usize; 2]| {
            let known = footing.map_or_else(|| self.node(at), |footing| footing.node(&self.nodes(), at));
            known.or_else(|| self.continued_node(at))
        };
        // Outside the grid the outermost cells go on.
        let shares = |axis: usize, at: i64| -> [(usize, f64); 2] {
            let last = self.size[axis] - 1;
            match usize::try_from(at) {
                Err(_) => [(0, (1 - at) as f64), (1, at as f64)],
                Ok(at) if at > last => [(last, (1 + at - last) as f64), (last - 1, -((at - last) as f64))],
                Ok(at) => [(at, 1.0), (at, 0.0)],
            }
        };
        rounded::ground(&place, self.step_m, |[i, j]| {
            let mut height_m = 0.0;
            for (row, of_row) in shares(1, j) {
                for (column, of_column) in shares(0, i) {
                    if of_row * of_column != 0.0 {
                        height_m += of_row * of_column * inside([column, row])?;
                    }
                }
            }
            Some(height_m)
        })
    }

    /// See [`super::Terrain::footing_noise`].
    pub fn footing_noise(&self) -> Option<FootingNoise> {
        self.footing.of(&self.nodes()).map(|footing| footing.noise)
    }

    /// Whether a place, given in steps, is in the grid or so near that ground goes on.
    fn is_within_reach(&self, place: &Vector2<f64>) -> bool {
        let beyond = |axis: usize| {
            let inside = place[axis].clamp(0.0, (self.size[axis] - 1) as f64);
            (place[axis] - inside).abs()
        };
        // A place that is no number is beyond everything.
        (0..2).all(|axis| beyond(axis) <= self.reach_cells()[axis] as f64)
    }

    /// The height at a node; `None` where it has none.
    fn node(&self, [column, row]: [usize; 2]) -> Option<f64> {
        let height_m = self.heights_m[row * self.size[0] + column];
        (!height_m.is_nan()).then_some(height_m)
    }

    /// How far the ground is continued, in cells along x and y.
    fn reach_cells(&self) -> [usize; 2] {
        self.step_m.map(|step_m| {
            ((RULES.reach_m / step_m).ceil() as usize).clamp(RULES.least_cells, RULES.most_cells)
        })
    }

    /// The height at a node of the plane through the known nodes around it: those of the first ring of cells
    /// that has some, and of the next one.
    fn continued_node(&self, at: [usize; 2]) -> Option<f64> {
        let [reach_x, reach_y] = self.reach_cells();
        let near = |axis: usize, ring: usize| {
            at[axis].saturating_sub(ring)..=(at[axis] + ring).min(self.size[axis] - 1)
        };
        let known_within = |ring: usize| {
            let (columns, rows) = (near(0, ring.min(reach_x)), near(1, ring.min(reach_y)));
            rows.flat_map(move |row| columns.clone().map(move |column| [column, row])).filter_map(|[i, j]| {
                let height_m = self.heights_m[j * self.size[0] + i];
                let away = |axis: usize, node: usize| (node as f64 - at[axis] as f64) * self.step_m[axis];
                (!height_m.is_nan()).then(|| (Vector2::new(away(0, i), away(1, j)), height_m))
            })
        };
        let first = (1..=reach_x.max(reach_y)).find(|ring| known_within(*ring).next().is_some())?;
        plane_at_origin(known_within(first + 1))
    }

    /// See [`super::Terrain::intersect`].
    pub fn intersect(
        &self,
        origin: &Point3<f64>,
        direction: &Vector3<f64>,
        raised_m: f64,
    ) -> Result<Point3<f64>, NoGround> {
        let never = NoGround::NeverReached { x_m: origin.x, y_m: origin.y };
        let along = |t: f64| origin + t * direction;
        let numbers = origin.iter().chain(direction.iter()).chain([&raised_m]);
        if direction.norm_squared() == 0.0 || !numbers.copied().all(f64::is_finite) {
            return Err(never);
        }
        // From where to where the ray is not above every height. From `from_above` on the sign of the
        // first height above ground is known, whatever rounding says.
        let clearance_m = origin.z - (self.highest_m + raised_m);
        let from_above = clearance_m > 0.0;
        if from_above && direction.z >= 0.0 {
            return Err(never);
        }
        let begin = if from_above { -clearance_m / direction.z } else { 0.0 };
        let end = if direction.z > 0.0 { -clearance_m / direction.z } else { f64::INFINITY };

        let start = self.in_steps(origin.x, origin.y);
        let speed = Vector2::new(direction.x / self.step_m[0], direction.y / self.step_m[1]);
        let outside = |t: f64| NoGround::OutsideGrid { x_m: along(t).x, y_m: along(t).y };
        let mut index = self.patch_of(&(start + begin * speed)).ok_or_else(|| outside(begin))?;
        let mut from = begin;
        let mut side = from_above.then_some(1.0);
        loop {
            let place = along(from);
            let Some(patch) = self.patch(index) else {
                return Err(NoGround::NoData { x_m: place.x, y_m: place.y });
            };
            // Where the ray crosses into the next column and row.
            let crossing = |axis: usize| match speed[axis] {
                s if s > 0.0 => ((index[axis] + 1) as f64 - start[axis]) / s,
                s if s < 0.0 => (index[axis] as f64 - start[axis]) / s,
                _ => f64::INFINITY,
            };
            let crossings = [crossing(0), crossing(1)];
            let to = crossings[0].min(crossings[1]).min(end).max(from);
            let inside = start + from * speed - Vector2::new(index[0] as f64, index[1] as f64);
            let above = patch.height_along(&inside, &speed, place.z - raised_m, direction.z);
            let side = *side.get_or_insert(above[0].signum());
            if let Some(t) = first_meeting(above, side, to - from) {
                return Ok(along(from + t));
            }
            if to == f64::INFINITY || to == end {
                return Err(never);
            }
            for axis in 0..2 {
                if crossings[axis] > to {
                    continue;
                }
                let is_last =
                    if speed[axis] > 0.0 { index[axis] + 2 == self.size[axis] } else { index[axis] == 0 };
                if is_last {
                    return Err(outside(to));
                }
                index[axis] = if speed[axis] > 0.0 { index[axis] + 1 } else { index[axis] - 1 };
            }
            from = to;
        }
    }
}

/// The height at the origin of the plane of weighted least squares through heights at places around it; their
/// weighted mean where the places lie on a line. `None` without any.
fn plane_at_origin(known: impl Iterator<Item = (Vector2<f64>, f64)>) -> Option<f64> {
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for (away_m, height_m) in known {
        let row = Vector3::new(1.0, away_m.x, away_m.y);
        let weight = away_m.norm_squared().powi(-2);
        normal += weight * row * row.transpose();
        right += weight * height_m * row;
    }
    let mean = right.x / normal[(0, 0)];
    // Scaled to a unit diagonal, so that places on a line are seen to be on one.
    let scale = Matrix3::from_diagonal(&normal.diagonal().map(|v| 1.0 / v.max(f64::MIN_POSITIVE).sqrt()));
    let scaled = scale * normal * scale;
    let is_plane = scaled.determinant() > 1e-6;
    let plane =
        scaled.cholesky().filter(|_| is_plane).map(|factor| (scale * factor.solve(&(scale * right))).x);
    plane.or(Some(mean)).filter(|height_m| height_m.is_finite())
}

impl Patch {
    fn height(&self, u: f64, v: f64) -> f64 {
        self.a + self.b * u + (self.c + self.e * u) * v
    }

    /// Height of a ray above the patch as `[c0, c1, c2]` of `c0 + c1 t + c2 t^2`.
    fn height_along(&self, place: &Vector2<f64>, speed: &Vector2<f64>, z_m: f64, climb: f64) -> [f64; 3] {
        let across = place.x * speed.y + place.y * speed.x;
        [
            z_m - self.height(place.x, place.y),
            climb - self.b * speed.x - self.c * speed.y - self.e * across,
            -self.e * speed.x * speed.y,
        ]
    }
}

/// The smallest `t` in `0..=to` at which `c0 + c1 t + c2 t^2` is no longer on `side` of zero.
fn first_meeting([c0, c1, c2]: [f64; 3], side: f64, to: f64) -> Option<f64> {
    if side * c0 <= 0.0 {
        return Some(0.0);
    }
    // The signs at the borders decide, so that rounding cannot lose a ray between two patches.
    let is_through = to.is_finite() && side * (c0 + to * (c1 + to * c2)) <= 0.0;
    let discriminant = c1 * c1 - 4.0 * c2 * c0;
    let root = if discriminant >= 0.0 {
        let q = -0.5 * (c1 + discriminant.sqrt().copysign(c1));
        [q / c2, c0 / q].into_iter().filter(|t| *t > 0.0 && t.is_finite()).reduce(f64::min)
    } else {
        None
    };
    match root {
        Some(t) if t <= to => Some(t),
        _ => is_through.then_some(to),
    }
}

#[cfg(test)]
mod tests {
    use super::super::Terrain;
    use super::super::tests::hills;
    use super::*;
    use std::sync::Arc;

    fn terrain(first: [f64; 2], step: [f64; 2], size: [usize; 2], heights: &[f64]) -> Terrain {
        Terrain::Grid(Arc::new(Grid::new(first, step, size, heights.to_vec()).unwrap()))
    }

    #[test]
    fn heights_are_bilinear_between_nodes() {
        let terrain = terrain([10.0, 20.0], [2.0, 4.0], [3, 2], &[0.0, 1.0, 5.0, 2.0, 4.0, 4.0]);
        for (x, y, wanted) in [(10.0, 20.0, 0.0), (11.0, 22.0, 1.75), (14.0, 24.0, 4.0), (13.0, 20.0, 3.0)] {
            assert_eq!(terrain.at(x, y).unwrap().height_m, wanted, "{x} {y}");
        }
        for (x_m, y_m) in [(9.99, 21.0), (14.01, 21.0), (11.0, 19.9), (11.0, f64::NAN)] {
            assert!(matches!(terrain.at(x_m, y_m), Err(NoGround::OutsideGrid { .. })), "{x_m} {y_m}");
        }
    }

    #[test]
    fn the_order_of_rows_and_columns_makes_no_difference() {
        let south_first = terrain([0.0, 0.0], [1.0, 2.0], [3, 3], &[1., 2., 3., 4., 5., 6., 7., 8., 9.]);
        let north_first = terrain([0.0, 4.0], [1.0, -2.0], [3, 3], &[7., 8., 9., 4., 5., 6., 1., 2., 3.]);
        let east_first = terrain([2.0, 0.0], [-1.0, 2.0], [3, 3], &[3., 2., 1., 6., 5., 4., 9., 8., 7.]);
        assert_eq!(south_first, north_first);
        assert_eq!(south_first, east_first);
    }

    #[test]
    fn a_place_without_data_has_no_height() {
        let terrain = terrain([0.0, 0.0], [1.0, 1.0], [3, 2], &[0.0, 0.0, f64::NAN, 0.0, 0.0, 0.0]);
        assert!(terrain.at(0.5, 0.5).is_ok());
        assert_eq!(terrain.at(1.5, 0.5), Err(NoGround::NoData { x_m: 1.5, y_m: 0.5 }));
    }

    /// A slope of 30 x 30 cells of 0.5 m with a hole, that bends a little.
    fn with_a_hole() -> Terrain {
        let height = |at: usize| {
            let (column, row) = (at % 31, at / 31);
            let (x, y) = (0.5 * column as f64, 0.5 * row as f64);
            let is_hole = (10..=18).contains(&column) && (12..=17).contains(&row);
            if is_hole { f64::NAN } else { 1.0 + 0.1 * x - 0.05 * y + 0.002 * x * x }
        };
        terrain([0.0, 0.0], [0.5, 0.5], [31, 31], &(0..31 * 31).map(height).collect::<Vec<_>>())
    }

    #[test]
    fn beyond_its_border_known_ground_goes_on_without_a_jump() {
        let terrain = with_a_hole();
        let continued = |x: f64, y: f64| terrain.footing_at(x, y).unwrap();
        // Across the hole and out of the grid on either side.
        let (mut before, mut holes) = (continued(-4.0, 7.3), 0);
        for k in 1..23_000 {
            let x = -4.0 + 1e-3 * f64::from(k);
            let now = continued(x, 7.3);
            // Slopes are 0.1 to 0.2.
            assert!((now.height_m - before.height_m).abs() < 3e-4, "{x}");
            let true_m = 1.0 + 0.1 * x - 0.05 * 7.3 + 0.002 * x * x;
            assert!((now.height_m - true_m).abs() < 0.08, "{x}: {} {true_m}", now.height_m);
            match terrain.at(x, 7.3) {
                Ok(known) => assert!((known.height_m - now.height_m).abs() < 2e-3, "{x}"),
                Err(_) => holes += 1,
            }
            before = now;
        }
        assert!(holes > 10_000, "{holes}");
        assert!(matches!(terrain.at(7.0, 7.3), Err(NoGround::NoData { .. })), "users are told so");
    }

    #[test]
    fn continued_ground_has_the_slope_of_its_differences_and_an_end() {
        let terrain = with_a_hole();
        for (x, y) in [(5.2, 6.7), (7.1, 7.4), (9.3, 8.6), (-1.3, 3.2), (15.9, -2.2)] {
            let at = |x, y| terrain.footing_at(x, y).unwrap();
            let h = 1e-5;
            let slope = [
                (at(x + h, y).height_m - at(x - h, y).height_m) / (2.0 * h),
                (at(x, y + h).height_m - at(x, y - h).height_m) / (2.0 * h),
            ];
            assert!((at(x, y).slope - Vector2::from(slope)).norm() < 1e-8, "{x} {y}");
        }
        for (x, y) in [(-5.1, 3.0), (20.2, 3.0), (3.0, f64::NAN), (f64::INFINITY, 3.0)] {
            assert_eq!(terrain.footing_at(x, y), None, "{x} {y}");
        }
        // Three known nodes on a line.
        let mut heights = [f64::NAN; 9];
        heights[..3].copy_from_slice(&[1.0, 2.0, 3.0]);
        let line = super::tests::terrain([0.0, 0.0], [1.0, 1.0], [3, 3], &heights);
        assert!(line.footing_at(1.0, 1.5).unwrap().height_m.is_finite());
    }

    #[test]
    fn a_grid_that_cannot_be_one_is_refused() {
        let new = |step, size, heights: &[f64]| Grid::new([0.0, 0.0], step, size, heights.to_vec());
        assert!(new([1.0, 1.0], [1, 2], &[0.0; 2]).is_err());
        assert!(new([1.0, 1.0], [2, 2], &[0.0; 5]).is_err());
        assert!(new([0.0, 1.0], [2, 2], &[0.0; 4]).is_err());
        assert!(new([f64::NAN, 1.0], [2, 2], &[0.0; 4]).is_err());
        assert!(new([1.0, 1.0], [2, 2], &[f64::NAN; 4]).is_err());
        assert!(new([1.0, 1.0], [2, 2], &[0.0, 0.0, f64::INFINITY, 0.0]).is_err());
        assert!(new([1.0, 1.0], [usize::MAX, 2], &[0.0; 4]).is_err());
    }

    /// Second road: steps of a millimetre along the ray, then bisection.
    fn by_small_steps(
        terrain: &Terrain,
        origin: &Point3<f64>,
        to: &Vector3<f64>,
        raised: f64,
    ) -> Option<f64> {
        let above = |t: f64| {
            let p = origin + t * to;
            terrain.at(p.x, p.y).ok().map(|ground| p.z - raised - ground.height_m)
        };
        let (mut low, step) = (0.0, 1e-3);
        while above(low + step).is_none_or(|height| height > 0.0) {
            low += step;
            if low > 200.0 {
                return None;
            }
        }
        let mut high = low + step;
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if above(middle)? > 0.0 { low = middle } else { high = middle }
        }
        Some(low)
    }

    #[test]
    fn a_ray_meets_the_surface_where_small_steps_do() {
        let terrain = hills();
        let mut met = 0;
        for number in 0..200 {
            let angle = f64::from(number) * 2.399;
            let flatness = 0.05 + 3.0 * f64::from(number % 17) / 17.0;
            let to = Vector3::new(angle.cos(), angle.sin(), -flatness).normalize();
            let origin = Point3::new(
                7.0 * (f64::from(number) * 0.37).sin(),
                6.0 * (f64::from(number) * 0.71).cos(),
                9.0 + f64::from(number % 5) * 6.0,
            );
            let raised = if number % 3 == 0 { 1.4 } else { 0.0 };
            let wanted = by_small_steps(&terrain, &origin, &to, raised);
            let found = terrain.intersect(&origin, &(3.0 * to), raised);
            let (Some(wanted), Ok(found)) = (wanted, &found) else {
                assert!(wanted.is_none() && found.is_err(), "{number}: {wanted:?} {found:?}");
                continue;
            };
            met += 1;
            assert!((found - (origin + wanted * to)).norm() < 1e-9, "{number}: {found} {wanted}");
            let ground = terrain.at(found.x, found.y).unwrap();
            assert!((found.z - raised - ground.height_m).abs() < 1e-12, "{number}");
        }
        assert!((100..190).contains(&met), "{met}");
    }

    #[test]
    fn a_ray_straight_down_meets_what_is_below_it() {
        let terrain = hills();
        for (x, y) in [(0.0, 0.0), (3.7, -11.2), (-20.0, -20.0), (20.0, 20.0), (20.0, 3.0)] {
            let height = terrain.at(x, y).unwrap().height_m;
            let hit = terrain.intersect(&Point3::new(x, y, 70.0), &-Vector3::z(), 1.5).unwrap();
            assert!((hit - Point3::new(x, y, height + 1.5)).norm() < 1e-13);
        }
        let down = terrain.intersect(&Point3::new(20.5, 0.0, 70.0), &-Vector3::z(), 0.0);
        assert_eq!(down, Err(NoGround::OutsideGrid { x_m: 20.5, y_m: 0.0 }));
    }

    #[test]
    fn a_ray_along_the_nodes_of_level_ground_is_not_lost() {
        let level = terrain([0.0, 0.0], [1.0, 1.0], [11, 11], &[0.1; 121]);
        for to in [[1.0, 0.0, -1.0], [1.0, 1.0, -1.0], [0.0, -1.0, -0.9], [-0.1, 0.0, -0.1]] {
            for number in 0..100 {
                let origin = Point3::new(5.0, 5.0, 3.1 + 0.0137 * f64::from(number));
                let hit = level.intersect(&origin, &Vector3::from(to), 0.0).unwrap();
                assert!((hit.z - 0.1).abs() < 1e-14, "{hit}");
            }
        }
    }

    #[test]
    fn the_first_of_two_hills_is_met() {
        // Ridges at x = 2 and x = 5; the ray passes through both.
        let row = [0.0, 0.0, 4.0, 0.0, 0.0, 4.0, 0.0];
        let terrain = terrain([0.0, 0.0], [1.0, 1.0], [7, 2], &[row, row].concat());
        let hit = terrain.intersect(&Point3::new(0.0, 0.5, 2.5), &Vector3::new(1.0, 0.0, -0.1), 0.0).unwrap();
        // 2.5 - 0.1 x = 4 (x - 1)
        assert!((hit.x - 6.5 / 4.1).abs() < 1e-14, "{hit}");
        // From between the ridges, going back.
        let hit = terrain.intersect(&Point3::new(3.5, 0.5, 2.5), &Vector3::new(-1.0, 0.0, 0.0), 0.0).unwrap();
        assert!((hit.x - (3.0 - 2.5 / 4.0)).abs() < 1e-14, "{hit}");
    }

    #[test]
    fn a_saddle_is_met_between_its_borders() {
        // h = 4 (u - u v): both ends of this diagonal ray are above the surface, its middle is below.
        let terrain = terrain([0.0, 0.0], [1.0, 1.0], [2, 2], &[0.0, 4.0, 0.0, 0.0]);
        let origin = Point3::new(0.0, 0.0, 0.9);
        let hit = terrain.intersect(&origin, &Vector3::new(1.0, 1.0, 0.0), 0.0).unwrap();
        let u = 0.5 - (0.25_f64 - 0.225).sqrt();
        assert!((hit - Point3::new(u, u, 0.9)).norm() < 1e-14, "{hit}");
    }

    #[test]
    fn a_ray_that_leaves_the_known_ground_says_where() {
        let mut heights = [0.0; 36];
        heights[3 * 6 + 3] = f64::NAN;
        let terrain = terrain([0.0, 0.0], [1.0, 1.0], [6, 6], &heights);
        let from = |x: f64, y: f64, z: f64, to: [f64; 3], raised| {
            terrain.intersect(&Point3::new(x, y, z), &Vector3::from(to), raised)
        };
        // Raised, the ground is at 2, and the ray meets it after four steps of x, beyond the hole.
        let at_hole = from(0.5, 2.5, 2.0, [1.0, 0.0, 1e-9], 2.0 + 4e-9);
        let Err(NoGround::NoData { x_m, y_m }) = at_hole else { panic!("{at_hole:?}") };
        assert!((x_m - 2.0).abs() < 1e-12 && y_m == 2.5);
        // It comes down to the level ground outside.
        let beside = from(0.5, 0.5, 10.0, [1.0, 0.0, -1.0], 0.0);
        assert_eq!(beside, Err(NoGround::OutsideGrid { x_m: 10.5, y_m: 0.5 }));
        // High above the hole there is nothing to meet; the ground behind it is.
        let beyond = from(0.5, 2.5, 4.0, [1.0, 0.0, -1.0], 0.0).unwrap();
        assert!((beyond - Point3::new(4.5, 2.5, 0.0)).norm() < 1e-13);
        // In from beside the grid.
        let inwards = from(-5.0, 0.5, 7.0, [1.0, 0.0, -1.0], 0.0).unwrap();
        assert!((inwards - Point3::new(2.0, 0.5, 0.0)).norm() < 1e-13);
        let never = Err(NoGround::NeverReached { x_m: 0.5, y_m: 0.5 });
        for to in [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0; 3], [f64::NAN, 0.0, -1.0]] {
            assert_eq!(from(0.5, 0.5, 1.0, to, 0.0), never);
        }
    }
}
