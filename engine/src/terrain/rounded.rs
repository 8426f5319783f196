//! The edges between the cells of a grid, rounded.
//!
//! Where two cells of a bilinear surface meet, its slope jumps, and with it the lean of what stands there: a cost with
//! steps, at which a minimiser stops before its minimum. The ground under a vehicle is the surface averaged twice over
//! `a` to either side, along x and along y:
//!
//! ```text
//! h(x, y) = sum_ij h_ij w(x - i) w(y - j)        w = hat * box * box,   a = 0.25 m, or half a cell where that is less
//! ```
//!
//! It has continuous second derivatives, is that of the grid to millimetres, farther than `2 a` from an edge exactly
//! where the surface is a plane, and of cells up to 0.5 m it is the cubic B-spline whose coefficients are the heights.
//!
//! Source: de Boor, *A Practical Guide to Splines* (1978), chapter IX.

use super::Ground;
use crate::rules::rules;
use nalgebra::{Matrix2, Vector2};
use std::ops::RangeInclusive;

rules! {
    /// The edges between the cells of a terrain grid, rounded.
    pub struct EdgeRules {
        /// The surface is averaged over so much to either side, twice.
        average_m: f64 = 0.25, "m";
    }
}

/// How the nodes along one axis of a grid contribute to the ground at a place.
#[derive(Clone, Copy, Debug)]
struct Axis {
    /// Of the place, in steps from the first node.
    place: f64,
    /// Over how much the surface is averaged to either side, in steps.
    average: f64,
}

impl Axis {
    fn new(place: f64, step_m: f64) -> Axis {
        Axis { place, average: (EdgeRules::DEFAULT.average_m / step_m).min(0.5) }
    }

    /// The nodes that contribute.
    fn nodes(&self) -> RangeInclusive<i64> {
        let reach = 1.0 + 2.0 * self.average;
        (self.place - reach).ceil() as i64..=(self.place + reach).floor() as i64
    }

    /// The weight of a node, its first and its second derivative by the place.
    fn weight(&self, node: i64) -> [f64; 3] {
        // Differences of the integrals of max(u, 0), which a hat is three of.
        const DIFFERENCES: [(f64, f64); 3] = [(-1.0, 1.0), (0.0, -2.0), (1.0, 1.0)];
        // To the left of the middle fewer of them are above zero, and none is large.
        let (away, side) = (self.place - node as f64, (node as f64 - self.place).signum());
        let mut sums = [0.0; 3];
        for (shift, factor) in DIFFERENCES {
            for (averages, other) in DIFFERENCES {
                let u = (shift + 2.0 * self.average * averages - away.abs()).max(0.0);
                let integrals = [u * u * u / 6.0, u * u / 2.0, u];
                sums.iter_mut().zip(integrals).for_each(|(sum, integral)| *sum += factor * other * integral);
            }
        }
        let [value, first, second] = sums.map(|sum| sum / (4.0 * self.average * self.average));
        [value, side * first, second]
    }
}

/// The ground at a place in steps from the first node of a grid, by the heights of its nodes; `None` where one that
/// contributes has none.
pub(super) fn ground(
    place: &Vector2<f64>,
    step_m: [f64; 2],
    height_m: impl Fn([i64; 2]) -> Option<f64>,
) -> Option<Ground> {
    let [along_x, along_y] = [0, 1].map(|axis| Axis::new(place[axis], step_m[axis]));
    let weights_x: Vec<(i64, [f64; 3])> = along_x.nodes().map(|node| (node, along_x.weight(node))).collect();
    // Differences from one of them, so that rounding does not grow with the height above the sea.
    let base_m = height_m([place.x.round() as i64, place.y.round() as i64])?;
    let (mut height, mut slope, mut bend) = (0.0, Vector2::zeros(), Matrix2::zeros());
    for j in along_y.nodes() {
        let wy = along_y.weight(j);
        for (i, wx) in &weights_x {
            let above_m = height_m([*i, j])? - base_m;
            height += wx[0] * wy[0] * above_m;
            slope += above_m * Vector2::new(wx[1] * wy[0], wx[0] * wy[1]);
            bend += above_m * Matrix2::new(wx[2] * wy[0], wx[1] * wy[1], wx[1] * wy[1], wx[0] * wy[2]);
        }
    }
    let per_m = Vector2::from(step_m).map(|step| 1.0 / step);
    Some(Ground {
        height_m: base_m + height,
        slope: slope.component_mul(&per_m),
        bend_per_m: bend.component_mul(&(per_m * per_m.transpose())),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A saddle with an edge in it along x = 3.
    fn node([i, j]: [i64; 2]) -> f64 {
        let (x, y) = (i as f64, j as f64);
        500.0 + 0.3 * x - 0.1 * y + 0.02 * x * y + 0.4 * (x - 3.0).abs()
    }

    /// Second road: the mean of the bilinear surface at many places around, each as far off as two draws say.
    #[test]
    fn it_is_the_surface_averaged_twice() {
        let bilinear = |x: f64, y: f64| {
            let (i, j) = (x.floor() as i64, y.floor() as i64);
            let (u, v) = (x - i as f64, y - j as f64);
            let along = |j: i64| (1.0 - u) * node([i, j]) + u * node([i + 1, j]);
            (1.0 - v) * along(j) + v * along(j + 1)
        };
        for step_m in [0.3, 0.5, 0.8, 5.0] {
            let average = f64::min(0.25 / step_m, 0.5);
            let offsets: Vec<f64> = (0..24).map(|k| average * (f64::from(2 * k + 1) / 24.0 - 1.0)).collect();
            let sums: Vec<f64> = offsets.iter().flat_map(|a| offsets.iter().map(move |b| a + b)).collect();
            for (x, y) in [(3.0, 2.4), (2.9, 0.0), (4.6, 1.9), (-7.3, 2.2)] {
                let around = sums.iter().flat_map(|dx| sums.iter().map(move |dy| bilinear(x + dx, y + dy)));
                let wanted = around.sum::<f64>() / (sums.len() * sums.len()) as f64;
                let found = ground(&Vector2::new(x, y), [step_m; 2], |at| Some(node(at))).unwrap();
                assert!((found.height_m - wanted).abs() < 5e-4, "{step_m} {x} {y}: {found:?} {wanted}");
            }
            // Away from the edge the saddle is what it was.
            let found = ground(&Vector2::new(6.5, 1.25), [step_m; 2], |at| Some(node(at))).unwrap();
            assert!((found.height_m - bilinear(6.5, 1.25)).abs() < 1e-10, "{step_m}");
            assert!((found.slope.x * step_m - (0.7 + 0.02 * 1.25)).abs() < 1e-9, "{step_m}");
        }
    }

    #[test]
    fn slope_and_bend_are_those_of_differences_and_do_not_jump() {
        for step_m in [0.5, 2.0] {
            let at = |x: f64, y: f64| {
                ground(&Vector2::new(x / step_m, y / step_m), [step_m; 2], |at| Some(node(at))).unwrap()
            };
            let h = 1e-5;
            for k in 0..200 {
                let (x, y) = (3.0 * step_m + 0.013 * f64::from(k - 100), 0.9 + 0.01 * f64::from(k));
                let now = at(x, y);
                for (axis, [dx, dy]) in [[h, 0.0], [0.0, h]].into_iter().enumerate() {
                    let (after, before) = (at(x + dx, y + dy), at(x - dx, y - dy));
                    let slope = (after.height_m - before.height_m) / (2.0 * h);
                    assert!((slope - now.slope[axis]).abs() < 1e-8);
                    let bend = (after.slope - before.slope) / (2.0 * h);
                    assert!((bend - now.bend_per_m.column(axis)).norm() < 1e-3 / step_m, "{bend} {now:?}");
                    assert!((after.bend_per_m - before.bend_per_m).norm() < 1e-3 / step_m, "{x} {y}");
                }
            }
        }
    }
}
