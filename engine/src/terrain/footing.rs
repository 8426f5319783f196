//! The ground under a vehicle, from a grid that is noisy.
//!
//! Between the nodes of a fine grid the slope is a difference of their errors: 3 cm of noise in cells of 0.5 m are
//! slopes of 8 %, and a slope that counts as known says where a vehicle is that stands on it. But a vehicle stands on
//! four wheels, metres apart: what is rough within its length it does not follow, whether the grid or the road is. So
//! the ground under a vehicle is that of local fits around the nodes: a polynomial of the second degree by weighted
//! least squares, each node within the window by `(1 - r^2)^2`. What is left of the nodes beside the fits counts as
//! noise, with its correlation, and what of it goes into a fit adds to the standard deviations of the contact:
//!
//! ```text
//! height = sum l h                 variance of a height   s^2 sum l_i l_j exp(-d_ij / L)
//! ```
//!
//! `s` and `L` are those of what is left, in the middle of the distribution. A rough grid then claims no more than a
//! smooth one. Near a kerb or a wall, where a fit does not hold, the next narrower window takes its place, at last the
//! node itself. A grid that is smooth, or coarse, stays as it is.
//!
//! Source: local regression, Cleveland and Devlin, *Locally weighted regression*, JASA 83 (1988).

use crate::rules::rules;
use crate::stats::normal::MAD_TO_SIGMA_ROUNDED as MAD_TO_SIGMA;
use crate::stats::quantile::upper_median;
use nalgebra::{Matrix6, Vector2, Vector6};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering};

rules! {
    /// The ground under a vehicle, from a grid that is noisy.
    pub struct FootingRules {
        /// Half the width of the window: about the length of a car.
        window_m: f64 = 5.0, "m";
        /// Of a coarser grid, less than so many cells to either side, nothing can be told.
        least_cells: f64 = 3.0, "cells";
        /// From one window to the next narrower one.
        narrower: f64 = 0.7, "";
        /// Of a finer grid not every node takes part: so many to either side.
        most_nodes: f64 = 11.0, "nodes";
        /// Less noise than this is none.
        least_noise_m: f64 = 0.0002, "m";
        /// A fit that a node is off by more than so many standard deviations does not hold ...
        off_sigmas: f64 = 6.0, "sigma";
        /// ... of which each is this at the least: what roads are uneven by.
        off_at_least_m: f64 = 0.01, "m";
        /// A fit needs this share of the nodes of its window.
        least_known: f64 = 0.4, "";
        /// Noise is judged at so many nodes, spread over the grid ...
        sample: usize = 2000, "nodes";
        /// ... and at so many at the least.
        least_sample: usize = 50, "nodes";
    }
}

const RULES: FootingRules = FootingRules::DEFAULT;
/// A correlation that is told from none.
const LEAST_CORRELATION: f64 = 1e-3;

/// What noise is left in the ground under a vehicle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FootingNoise {
    /// Of the nodes beside the fits \[m\].
    pub nodes_m: f64,
    /// How far apart that is correlated by `exp(-1)` \[m\].
    pub nodes_length_m: f64,
    /// Of a height under a vehicle \[m\].
    pub height_m: f64,
    /// Of a slope there.
    pub slope: f64,
    /// How far apart errors of heights are correlated by `exp(-1/2)` \[m\].
    pub length_m: f64,
}

impl FootingNoise {
    /// Correlation of the errors at two places so far apart \[m\].
    pub fn correlation(&self, apart_m: f64) -> f64 {
        (-0.5 * (apart_m / self.length_m).powi(2)).exp()
    }
}

/// The nodes of a grid.
#[derive(Clone, Copy)]
pub(super) struct Nodes<'g> {
    /// By y, then x; NaN where there is no height \[m\].
    pub heights_m: &'g [f64],
    /// How many along x and y.
    pub size: [usize; 2],
    /// From one to the next along x and y \[m\].
    pub step_m: [f64; 2],
}

impl Nodes<'_> {
    /// The height of the node so many cells from another; `None` outside the grid and where it has none.
    fn node_near(&self, at: [usize; 2], cells: [i64; 2]) -> Option<f64> {
        let place = |axis: usize| {
            let place = usize::try_from(at[axis] as i64 + cells[axis]).ok()?;
            (place < self.size[axis]).then_some(place)
        };
        let height_m = self.heights_m[place(1)? * self.size[0] + place(0)?];
        (!height_m.is_nan()).then_some(height_m)
    }
}

/// Local fits to a grid.
#[derive(Debug)]
pub(super) struct Footing {
    /// The widest first.
    windows: Vec<Window>,
    pub noise: FootingNoise,
    /// Heights of nodes as bits, once they are computed; NaN before.
    nodes: Vec<AtomicU64>,
}

/// What a grid knows of its footing: computed when it is first wanted. It is no part of what makes two grids equal.
#[derive(Debug, Default)]
pub(super) struct Cache(OnceLock<Option<Footing>>);

impl PartialEq for Cache {
    fn eq(&self, _: &Cache) -> bool {
        true
    }
}

impl Clone for Cache {
    fn clone(&self) -> Cache {
        Cache::default()
    }
}

impl Cache {
    pub fn of(&self, grid: &Nodes<'_>) -> Option<&Footing> {
        self.0.get_or_init(|| Footing::new(grid)).as_ref()
    }
}

/// The nodes that take part in a fit.
#[derive(Clone, Debug)]
struct Window {
    nodes: Vec<WindowNode>,
    /// What each of them contributes to the height in the middle, all of them known.
    shares: Vec<f64>,
}

#[derive(Clone, Debug)]
struct WindowNode {
    cells: [i64; 2],
    away_m: Vector2<f64>,
    row: Vector6<f64>,
    weight: f64,
}

impl Window {
    fn new(half_m: f64, step_m: [f64; 2]) -> Option<Window> {
        let every = step_m.map(|step| (half_m / step / RULES.most_nodes).ceil().max(1.0) as i64);
        let reach = [0, 1].map(|axis| (half_m / step_m[axis]) as i64 / every[axis]);
        let mut nodes = Vec::new();
        for j in -reach[1]..=reach[1] {
            for i in -reach[0]..=reach[0] {
                let cells = [i * every[0], j * every[1]];
                let away_m = Vector2::new(cells[0] as f64 * step_m[0], cells[1] as f64 * step_m[1]);
                let away = away_m / half_m;
                let weight = (1.0 - away.norm_squared()).max(0.0).powi(2);
                if weight > 0.0 {
                    nodes.push(WindowNode { cells, away_m, row: quadratic(&away), weight });
                }
            }
        }
        // All of it known, there is a fit.
        let normal: Matrix6<f64> = nodes.iter().map(|n| n.weight * n.row * n.row.transpose()).sum();
        let first = normal.cholesky()?.solve(&Vector6::x());
        let shares = nodes.iter().map(|node| node.weight * node.row.dot(&first)).collect();
        Some(Window { nodes, shares })
    }

    /// The height at a node by the fit around it, and how far known nodes are off at the most \[m\]; `None` where too
    /// few are known.
    fn fit(&self, grid: &Nodes<'_>, at: [usize; 2]) -> Option<(f64, f64)> {
        let (mut normal, mut right) = (Matrix6::zeros(), Vector6::zeros());
        let known = || self.nodes.iter().filter_map(|node| Some((node, grid.node_near(at, node.cells)?)));
        let mut count = 0;
        for (node, height_m) in known() {
            normal += node.weight * node.row * node.row.transpose();
            right += node.weight * height_m * node.row;
            count += 1;
        }
        if (count as f64) < RULES.least_known * self.nodes.len() as f64 {
            return None;
        }
        let fit = normal.cholesky()?.solve(&right);
        let off = known().map(|(node, height_m)| (height_m - node.row.dot(&fit)).abs()).fold(0.0, f64::max);
        Some((fit.x, off))
    }
}

fn quadratic(away: &Vector2<f64>) -> Vector6<f64> {
    Vector6::new(1.0, away.x, away.y, away.x * away.x, away.x * away.y, away.y * away.y)
}

impl Footing {
    fn new(grid: &Nodes<'_>) -> Option<Footing> {
        let (step_m, size) = (grid.step_m, grid.size);
        let narrowest_m = RULES.least_cells * step_m[0].max(step_m[1]);
        let halves = std::iter::successors(Some(RULES.window_m), |half_m| Some(half_m * RULES.narrower));
        let halves = halves.take_while(|half_m| *half_m >= narrowest_m);
        let windows: Vec<Window> = halves.filter_map(|half_m| Window::new(half_m, step_m)).collect();
        let window = windows.first()?;
        let count = size[0] * size[1];
        let left = |at: [usize; 2]| Some(grid.node_near(at, [0, 0])? - window.fit(grid, at)?.0);
        let places = (0..count).step_by((count / RULES.sample).max(1)).map(|at| [at % size[0], at / size[0]]);
        let sample: Vec<([usize; 2], f64)> = places.filter_map(|at| Some((at, left(at)?))).collect();
        if sample.len() < RULES.least_sample {
            return None;
        }
        let nodes_m = MAD_TO_SIGMA * upper_median(sample.iter().map(|(_, off)| off.abs()).collect())?;
        if nodes_m < RULES.least_noise_m {
            return None;
        }
        let nodes_length_m = length_m(grid, &sample, nodes_m, &left);

        // The variances of a height, and of the difference of two next to each other.
        let variance_at = |shift_m: Vector2<f64>| -> f64 {
            let mut sum = 0.0;
            for (a, share_a) in window.nodes.iter().zip(&window.shares) {
                for (b, share_b) in window.nodes.iter().zip(&window.shares) {
                    let apart_m = (a.away_m - b.away_m - shift_m).norm();
                    sum += share_a * share_b * (-apart_m / nodes_length_m).exp();
                }
            }
            nodes_m * nodes_m * sum
        };
        let step = 0.5 * (step_m[0] + step_m[1]);
        let variance = variance_at(Vector2::zeros());
        // Nodes of one window lie on those of the other only so many cells apart: shifted by less, noise without
        // correlation would be shared by none.
        let apart_m = step * (window.nodes[1].cells[0] - window.nodes[0].cells[0]).max(1) as f64;
        let beside = variance_at(Vector2::new(apart_m, 0.0));
        let alike = (beside / variance).clamp(1e-6, 1.0 - 1e-9);
        let noise = FootingNoise {
            nodes_m,
            nodes_length_m,
            height_m: variance.sqrt(),
            slope: (2.0 * variance * (1.0 - alike)).sqrt() / apart_m,
            length_m: apart_m / (-2.0 * alike.ln()).sqrt(),
        };
        let nodes = (0..count).map(|_| AtomicU64::new(f64::NAN.to_bits())).collect();
        Some(Footing { windows, noise, nodes })
    }

    /// The height of a node; `None` where the grid has none that can be told there.
    pub fn node(&self, grid: &Nodes<'_>, at: [usize; 2]) -> Option<f64> {
        let place = &self.nodes[at[1] * grid.size[0] + at[0]];
        let kept = f64::from_bits(place.load(Ordering::Relaxed));
        if !kept.is_nan() {
            return Some(kept);
        }
        let most_m = RULES.off_sigmas * self.noise.nodes_m.max(RULES.off_at_least_m);
        let mut fits = self.windows.iter().filter_map(|window| window.fit(grid, at));
        let fitted = fits.find(|(_, off_m)| *off_m <= most_m).map(|(height_m, _)| height_m);
        let height_m = fitted.or_else(|| grid.node_near(at, [0, 0]))?;
        // Whoever computes it, it is the same.
        place.store(height_m.to_bits(), Ordering::Relaxed);
        Some(height_m)
    }
}

/// How far apart what is left of nodes is correlated by `exp(-1)` \[m\].
fn length_m(
    grid: &Nodes<'_>,
    sample: &[([usize; 2], f64)],
    sigma_m: f64,
    left: &impl Fn([usize; 2]) -> Option<f64>,
) -> f64 {
    let step_m = grid.step_m[0];
    let most_m = RULES.off_sigmas * sigma_m;
    let correlation = |cells: usize| -> f64 {
        let (mut products, mut squares) = (0.0, 0.0);
        for (at, off) in sample.iter().filter(|(_, off)| off.abs() <= most_m) {
            let other = [at[0] + cells, at[1]];
            let Some(beside) = (other[0] < grid.size[0]).then(|| left(other)).flatten() else { continue };
            if beside.abs() <= most_m {
                products += off * beside;
                squares += 0.5 * (off * off + beside * beside);
            }
        }
        if squares > 0.0 { products / squares } else { 0.0 }
    };
    let (mut before, mut at) = (1.0, 0.0);
    let one_e = (-1.0_f64).exp();
    for cells in 1..=(RULES.window_m / step_m) as usize {
        let (now, here) = (correlation(cells).max(LEAST_CORRELATION), cells as f64 * step_m);
        if now <= one_e {
            // Between the two as an exponential.
            let rate = (f64::ln(before) - f64::ln(now)) / (here - at);
            return at + (f64::ln(before) + 1.0) / rate;
        }
        (before, at) = (now, here);
    }
    RULES.window_m
}

#[cfg(test)]
mod tests {
    use super::super::{Grid, Terrain};
    use super::*;
    use crate::stats::drawn::Normal;
    use std::sync::Arc;

    const STEP_M: f64 = 0.5;
    const SIZE: usize = 101;

    /// A road with a crown and a slope, 50 by 50 m.
    fn road(x: f64, y: f64) -> f64 {
        0.03 * x - 0.001 * y * y
    }

    fn grid(noise_m: f64, seed: u64, other: &dyn Fn(f64, f64) -> Option<f64>) -> Arc<Grid> {
        let mut drawn = Normal(seed);
        let height = |at: usize| {
            let [x, y] = [at % SIZE, at / SIZE].map(|k| STEP_M * k as f64 - 25.0);
            other(x, y).unwrap_or(road(x, y)) + noise_m * drawn.draw()
        };
        let heights = (0..SIZE * SIZE).map(height).collect();
        Arc::new(Grid::new([-25.0, -25.0], [STEP_M; 2], [SIZE; 2], heights).unwrap())
    }

    #[test]
    fn noise_is_found_and_what_is_left_is_what_it_says() {
        let terrain = Terrain::Grid(grid(0.03, 7, &|_, _| None));
        let noise = terrain.footing_noise().unwrap();
        assert!((noise.nodes_m / 0.03 - 1.0).abs() < 0.05 && noise.nodes_length_m < 0.2, "{noise:?}");
        // Second road: what heights and slopes are really off by.
        let (mut heights, mut slopes, mut count) = (0.0_f64, 0.0_f64, 0.0);
        for i in 0..30 {
            for j in 0..30 {
                let (x, y) = (-18.1 + 1.2 * f64::from(i), -18.3 + 1.2 * f64::from(j));
                let ground = terrain.footing_at(x, y).unwrap();
                heights += (ground.height_m - road(x, y)).powi(2);
                slopes += (ground.slope - Vector2::new(0.03, -0.002 * y)).norm_squared() / 2.0;
                count += 1.0;
            }
        }
        let (height, slope) = ((heights / count).sqrt(), (slopes / count).sqrt());
        assert!((0.8..1.25).contains(&(height / noise.height_m)), "{height} {noise:?}");
        assert!((0.8..1.25).contains(&(slope / noise.slope)), "{slope} {noise:?}");
        assert!(noise.slope < 0.03 / STEP_M / 10.0, "{noise:?}");
    }

    #[test]
    fn a_smooth_or_a_coarse_grid_stays_as_it_is() {
        let smooth = Terrain::Grid(grid(0.0, 1, &|_, _| None));
        assert!(smooth.footing_noise().is_none());
        let [rounded, as_it_is] = [smooth.footing_at(1.3, 2.7), smooth.at(1.3, 2.7).ok()].map(Option::unwrap);
        assert!((rounded.height_m - as_it_is.height_m).abs() < 3e-4);
        assert!(super::super::tests::hills().footing_noise().is_none());
    }

    /// A wall beside the road does not lift it.
    #[test]
    fn a_step_is_not_smoothed_away() {
        let wall = |_: f64, y: f64| (y > 4.1).then_some(3.0);
        let terrain = Terrain::Grid(grid(0.02, 3, &wall));
        for k in 0..60 {
            let (x, y) = (-15.0 + 0.5 * f64::from(k), 2.6);
            let off = terrain.footing_at(x, y).unwrap().height_m - road(x, y);
            assert!(off.abs() < 0.08, "{x}: {off}");
        }
    }

    #[test]
    fn the_ground_has_the_slope_of_its_differences_and_does_not_jump() {
        let hole = |x: f64, y: f64| (x.abs() < 2.1 && y.abs() < 1.7).then_some(f64::NAN);
        let terrain = Terrain::Grid(grid(0.02, 5, &hole));
        let at = |x: f64, y: f64| terrain.footing_at(x, y).unwrap();
        let h = 1e-6;
        for (x, y) in [(4.2, 6.7), (0.1, 0.2), (2.3, 0.1), (-24.9, 3.1), (25.7, 3.1)] {
            let slope = [
                (at(x + h, y).height_m - at(x - h, y).height_m) / (2.0 * h),
                (at(x, y + h).height_m - at(x, y - h).height_m) / (2.0 * h),
            ];
            assert!((at(x, y).slope - Vector2::from(slope)).norm() < 1e-6, "{x} {y}");
        }
        for k in 0..60_000 {
            let x = -30.0 + 1e-3 * f64::from(k);
            if let (Some(a), Some(b)) = (terrain.footing_at(x, 0.3), terrain.footing_at(x + 1e-3, 0.3)) {
                assert!((a.height_m - b.height_m).abs() < 1e-3, "{x}");
            }
        }
    }
}
