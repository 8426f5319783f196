//! The pattern of a body adjusted as a whole: plane poses, plane positions and heights of its points.
//!
//! With the feet `q` found for heights `h0` (see [`super::forward`]) each sighting says
//!
//! ```text
//! q + q' dh_i  =  x_f + R(psi_f) m_i        q' = dq/dh,  h_i = h0_i + dh_i
//! ```
//!
//! which is a bundle adjustment on the ground. It is minimised with Tukey's loss by Gauss-Newton:
//! poses are eliminated frame by frame, the system of the points is solved by conjugate gradients with
//! the points' own 3 x 3 blocks as preconditioner. What a common height does, a common scale undoes,
//! so that the mean height needs to be known: from points of known height, else from what cars have.

use super::forward::Foot;
use super::plane_motion::{Chain, PlanePose};
use crate::rules::rules;
use crate::stats::quantile::upper_median;
use nalgebra::{Matrix2x3, Matrix3, Rotation2, Vector2, Vector3};
use trackbundle_solver::loss::LossName;

rules! {
    /// Adjustment of poses in the plane and of the feet of points.
    pub struct PlaneAdjustmentRules {
        /// How much heights of points scatter about their mean.
        height_scatter_m: f64 = 0.6, "m";
        /// Standard deviation of the mean height of a body where no height is known ...
        mean_height_sigma_m: f64 = 0.3, "m";
        /// ... and where one is.
        free_mean_height_sigma_m: f64 = 0.6, "m";
        /// A known height is taken with this: sightings are many, and off by more than their noise, since bodies
        /// pitch and roll.
        known_height_sigma_share: f64 = 0.1, "share of its standard deviation";
        /// A point is not taken to be nearer to the camera than this leaves.
        least_distance_share: f64 = 0.1, "share of the distance to the camera";
        /// The most steps of least squares.
        most_steps: usize = 12, "steps";
        /// The most steps of conjugate gradients in each.
        most_conjugate_steps: usize = 150, "steps";
        /// Conjugate gradients end below this.
        conjugate_tolerance: f64 = 1e-5, "share of the first residual";
        /// Damping of the first step, and the least.
        first_damping: f64 = 1e-6, "factor";
        /// A step that lowers the cost by less is the last.
        settled_decrease: f64 = 1e-4, "share of the cost";
    }
}

const RULES: PlaneAdjustmentRules = PlaneAdjustmentRules::DEFAULT;

/// What is known of the height of a point \[m\].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KnownHeight {
    /// The height.
    pub value_m: f64,
    /// Its standard deviation.
    pub sigma_m: f64,
}

/// A pattern and its motion.
#[derive(Clone, Debug)]
pub struct Pattern {
    /// Plane pose of each frame.
    pub poses: Vec<Option<PlanePose>>,
    /// Part of the motion that a frame belongs to, as in [`Chain`].
    pub part: Vec<usize>,
    /// Index of the node of each part and point.
    node: Vec<Vec<Option<usize>>>,
    /// Plane position and height of each node \[m\].
    nodes: Vec<Vector3<f64>>,
    known: Vec<Option<KnownHeight>>,
    mean_m: f64,
    has_known: bool,
    /// Sightings of each node and how many of them agree.
    sightings: Vec<[usize; 2]>,
    /// Robust spread of the residuals, in standard deviations.
    pub spread: f64,
    /// Agreeing feet of each frame.
    pub agreeing: Vec<usize>,
    /// Standard deviation of place \[m\] and heading \[rad\] of each frame, the pattern given.
    pub sigma: Vec<[f64; 2]>,
}

/// One sighting in the system.
struct Row {
    foot: usize,
    node: usize,
    /// Weighted product of the derivatives by pose and by node.
    coupling: Matrix3<f64>,
}

struct FrameRows {
    frame: usize,
    rows: std::ops::Range<usize>,
    inverse: Matrix3<f64>,
    gradient: Vector3<f64>,
}

struct Normal {
    rows: Vec<Row>,
    frames: Vec<FrameRows>,
    blocks: Vec<Matrix3<f64>>,
    gradient: Vec<Vector3<f64>>,
}

impl Pattern {
    /// A pattern from a chain. `height_m` and `known` have one entry a point; heights start from
    /// `height_m`, and where none is known their mean is drawn to `mean_m`.
    pub fn new(chain: &Chain, height_m: &[f64], known: &[Option<KnownHeight>], mean_m: f64) -> Pattern {
        let (mut nodes, mut node_known) = (Vec::new(), Vec::new());
        let node = chain.patterns.iter().map(|pattern| {
            let of_point = |(point, place): (usize, &Option<Vector2<f64>>)| {
                let place = (*place)?;
                nodes.push(place.push(height_m[point]));
                node_known.push(known[point]);
                Some(nodes.len() - 1)
            };
            pattern.iter().enumerate().map(of_point).collect()
        });
        let node = node.collect();
        Pattern {
            poses: chain.poses.clone(),
            part: chain.part.clone(),
            node,
            has_known: node_known.iter().any(Option::is_some),
            sightings: vec![[0, 0]; nodes.len()],
            nodes,
            known: node_known,
            mean_m,
            spread: 1.0,
            agreeing: vec![0; chain.poses.len()],
            sigma: vec![[f64::INFINITY; 2]; chain.poses.len()],
        }
    }

    /// Plane position and height of a point in a part \[m\], its sightings, and how many agree.
    pub fn point(&self, part: usize, point: usize) -> Option<(Vector3<f64>, [usize; 2])> {
        let node = self.node[part][point]?;
        Some((self.nodes[node], self.sightings[node]))
    }

    /// How many parts there are.
    pub fn parts(&self) -> usize {
        self.node.len()
    }

    /// How many points there are, seen or not.
    pub fn points(&self) -> usize {
        self.node.first().map_or(0, Vec::len)
    }

    /// Height of each point: the mean of its parts', by agreeing sightings \[m\].
    pub fn heights_m(&self, before_m: &[f64]) -> Vec<f64> {
        let height = |(point, before): (usize, &f64)| {
            let nodes = self.node.iter().filter_map(|part| part[point]);
            let (mut sum, mut count) = (0.0, 0.0);
            for node in nodes {
                let weight = self.sightings[node][1] as f64;
                sum += weight * self.nodes[node].z;
                count += weight;
            }
            if count > 0.0 { (sum / count).clamp(0.0, 4.5) } else { *before }
        };
        before_m.iter().enumerate().map(height).collect()
    }

    /// The highest point, of those that are seen and agree at least half as often as most.
    pub fn highest_point(&self) -> Option<usize> {
        let agreeing = |point: usize| {
            let nodes = self.node.iter().filter_map(|part| part[point]);
            let best = nodes.max_by_key(|node| (self.sightings[*node][1], std::cmp::Reverse(*node)))?;
            Some((self.sightings[best][1], self.nodes[best].z, point))
        };
        let all: Vec<(usize, f64, usize)> = (0..self.points()).filter_map(agreeing).collect();
        let mut counts: Vec<usize> = all.iter().map(|(count, _, _)| *count).collect();
        counts.sort_unstable();
        let enough = counts.get(counts.len() / 2)? / 2;
        let often = all.iter().filter(|(count, _, _)| *count >= enough);
        often.max_by(|a, b| a.1.total_cmp(&b.1)).map(|(_, _, point)| *point)
    }

    fn node_of(&self, foot: &Foot) -> Option<(PlanePose, usize)> {
        let pose = self.poses[foot.frame]?;
        Some((pose, self.node[self.part[foot.frame]][foot.point]?))
    }

    /// The whitened residual of a foot, and its derivative by the height of its point. A higher point is
    /// nearer to the camera and its foot more precise: without that, all points together would rise, since
    /// a smaller pattern has smaller residuals.
    fn residual(
        &self,
        foot: &Foot,
        start_m: &[f64],
        pose: &PlanePose,
        node: usize,
    ) -> (Vector2<f64>, Vector2<f64>) {
        let at = self.nodes[node];
        let rise = at.z - start_m[foot.point];
        let off = foot.place_m + foot.by_height * rise - pose.place(&at.xy());
        let nearer = 1.0 - rise / foot.clearance_m;
        if nearer < RULES.least_distance_share {
            let sigma_m = RULES.least_distance_share * foot.sigma_m;
            return (off / sigma_m, foot.by_height / sigma_m);
        }
        let sigma_m = nearer * foot.sigma_m;
        (off / sigma_m, (foot.by_height + off / (nearer * foot.clearance_m)) / sigma_m)
    }

    fn squares(&self, feet: &[Foot], start_m: &[f64]) -> Vec<Option<f64>> {
        let square = |foot: &Foot| {
            let (pose, node) = self.node_of(foot)?;
            Some(self.residual(foot, start_m, &pose, node).0.norm_squared())
        };
        feet.iter().map(square).collect()
    }

    /// Mean height of the points whose height is not known, drawn to where it is expected, and the
    /// share by which a mean of ones is.
    fn mean(&self) -> (f64, f64) {
        let mean_sigma =
            if self.has_known { RULES.free_mean_height_sigma_m } else { RULES.mean_height_sigma_m };
        let extra = (RULES.height_scatter_m / mean_sigma).powi(2);
        let free = self.nodes.iter().zip(&self.known).filter(|(_, known)| known.is_none());
        let (sum, count) = free.fold((0.0, 0.0), |(sum, count), (node, _)| (sum + node.z, count + 1.0));
        ((sum + extra * self.mean_m) / (count + extra), 1.0 / (count + extra))
    }

    fn prior_cost(&self) -> f64 {
        let (mean, _) = self.mean();
        let mean_sigma =
            if self.has_known { RULES.free_mean_height_sigma_m } else { RULES.mean_height_sigma_m };
        let of = |(node, known): (&Vector3<f64>, &Option<KnownHeight>)| match known {
            Some(known) => {
                ((node.z - known.value_m) / (RULES.known_height_sigma_share * known.sigma_m)).powi(2)
            }
            None => ((node.z - mean) / RULES.height_scatter_m).powi(2),
        };
        let scatter: f64 = self.nodes.iter().zip(&self.known).map(of).sum();
        0.5 * (scatter + ((mean - self.mean_m) / mean_sigma).powi(2))
    }

    /// Adjusts to `feet` that were found for the heights `start_m`. What is off by much more than
    /// `reach` times the spread is gross.
    pub fn adjust(&mut self, feet: &[Foot], start_m: &[f64], reach: f64) {
        let mut damping = RULES.first_damping;
        for _ in 0..RULES.most_steps {
            let squares = self.squares(feet, start_m);
            self.spread = spread(&squares);
            let loss = LossName::Tukey.with_scale(LossName::Tukey.default_scale() * reach * self.spread, 0.0);
            let cost_of = |pattern: &Pattern| {
                let squares = pattern.squares(feet, start_m);
                0.5 * squares.iter().flatten().map(|s| loss.rho(*s)[0]).sum::<f64>()
                    + pattern.spread.powi(2) * pattern.prior_cost()
            };
            let before = cost_of(self);
            let normal = self.normal(feet, start_m, |s| loss.weight(s), damping);
            let step = self.solve(&normal);
            let mut trial = self.clone();
            trial.take(feet, &normal, &step);
            let after = cost_of(&trial);
            if after < before {
                *self = trial;
                damping = (damping / 10.0).max(RULES.first_damping);
                if before - after < RULES.settled_decrease * before {
                    break;
                }
            } else if damping > 1.0 {
                break;
            } else {
                damping *= 100.0;
            }
        }
        self.count(feet, start_m, reach);
    }

    fn count(&mut self, feet: &[Foot], start_m: &[f64], reach: f64) {
        let squares = self.squares(feet, start_m);
        self.spread = spread(&squares);
        let most = (3.5 * reach * self.spread).powi(2);
        self.sightings.iter_mut().for_each(|s| *s = [0, 0]);
        self.agreeing.iter_mut().for_each(|a| *a = 0);
        for (foot, square) in feet.iter().zip(&squares) {
            let (Some(square), Some((_, node))) = (square, self.node_of(foot)) else { continue };
            self.sightings[node][0] += 1;
            if *square < most {
                self.sightings[node][1] += 1;
                self.agreeing[foot.frame] += 1;
            }
        }
        let normal = self.normal(feet, start_m, |s| if s < most { 1.0 } else { 0.0 }, RULES.first_damping);
        self.sigma.iter_mut().for_each(|s| *s = [f64::INFINITY; 2]);
        for rows in &normal.frames {
            let variance = rows.inverse.diagonal() * self.spread.powi(2);
            self.sigma[rows.frame] = [((variance.x + variance.y) / 2.0).sqrt(), variance.z.sqrt()];
        }
    }

    fn normal(&self, feet: &[Foot], start_m: &[f64], weight: impl Fn(f64) -> f64, damping: f64) -> Normal {
        let mut blocks = vec![Matrix3::zeros(); self.nodes.len()];
        let mut gradient = vec![Vector3::zeros(); self.nodes.len()];
        let (mut rows, mut frames) = (Vec::with_capacity(feet.len()), Vec::new());
        let mut first = 0;
        for of_frame in feet.chunk_by(|a, b| a.frame == b.frame) {
            let (start, mut block, mut slope) = (rows.len(), Matrix3::zeros(), Vector3::zeros());
            for (at, foot) in of_frame.iter().enumerate() {
                let Some((pose, node)) = self.node_of(foot) else { continue };
                let (residual, by_height) = self.residual(foot, start_m, &pose, node);
                let rise = self.nodes[node].z - start_m[foot.point];
                let sigma_m = foot.sigma_m * (1.0 - rise / foot.clearance_m).max(RULES.least_distance_share);
                let weight = weight(residual.norm_squared());
                let turn = Rotation2::new(pose.heading_rad);
                let arm = turn * self.nodes[node].xy();
                let matrix = turn.matrix();
                #[rustfmt::skip]
                let by_pose = Matrix2x3::new(
                    -1.0, 0.0, arm.y,
                    0.0, -1.0, -arm.x,
                ) / sigma_m;
                #[rustfmt::skip]
                let by_node = Matrix2x3::new(
                    -matrix[(0, 0)] / sigma_m, -matrix[(0, 1)] / sigma_m, by_height.x,
                    -matrix[(1, 0)] / sigma_m, -matrix[(1, 1)] / sigma_m, by_height.y,
                );
                let weighted = weight * by_pose.transpose();
                block += weighted * by_pose;
                slope += weighted * residual;
                blocks[node] += weight * by_node.transpose() * by_node;
                gradient[node] += weight * by_node.transpose() * residual;
                rows.push(Row { foot: first + at, node, coupling: weighted * by_node });
            }
            first += of_frame.len();
            for axis in 0..3 {
                block[(axis, axis)] = block[(axis, axis)] * (1.0 + damping) + 1e-6;
            }
            if let Some(inverse) = block.try_inverse() {
                let frame = of_frame[0].frame;
                frames.push(FrameRows { frame, rows: start..rows.len(), inverse, gradient: slope });
            } else {
                rows.truncate(start);
            }
        }
        let variance = self.spread.powi(2);
        let (mean, _) = self.mean();
        for (node, known) in self.known.iter().enumerate() {
            let (value, sigma) = match known {
                Some(known) => (known.value_m, RULES.known_height_sigma_share * known.sigma_m),
                None => (mean, RULES.height_scatter_m),
            };
            for axis in 0..3 {
                blocks[node][(axis, axis)] = blocks[node][(axis, axis)] * (1.0 + damping) + 1e-6;
            }
            blocks[node][(2, 2)] += variance / sigma.powi(2);
            gradient[node].z += variance * (self.nodes[node].z - value) / sigma.powi(2);
        }
        Normal { rows, frames, blocks, gradient }
    }

    /// What the reduced system of the points makes of a vector.
    fn apply(&self, normal: &Normal, vector: &[Vector3<f64>], out: &mut [Vector3<f64>]) {
        for ((out, block), v) in out.iter_mut().zip(&normal.blocks).zip(vector) {
            *out = block * v;
        }
        for frame in &normal.frames {
            let rows = &normal.rows[frame.rows.clone()];
            let pose: Vector3<f64> = rows.iter().map(|row| row.coupling * vector[row.node]).sum();
            let pose = frame.inverse * pose;
            for row in rows {
                out[row.node] -= row.coupling.tr_mul(&pose);
            }
        }
        // The mean height is an unknown that was eliminated.
        let (_, share) = self.mean();
        let free = || self.known.iter().enumerate().filter(|(_, known)| known.is_none());
        let sum: f64 = free().map(|(node, _)| vector[node].z).sum();
        let pull = (self.spread / RULES.height_scatter_m).powi(2) * share * sum;
        free().for_each(|(node, _)| out[node].z -= pull);
    }

    /// The step of the points, by conjugate gradients.
    fn solve(&self, normal: &Normal) -> Vec<Vector3<f64>> {
        let count = self.nodes.len();
        let mut residual: Vec<Vector3<f64>> = normal.gradient.iter().map(|g| -g).collect();
        for frame in &normal.frames {
            let pose = frame.inverse * frame.gradient;
            for row in &normal.rows[frame.rows.clone()] {
                residual[row.node] += row.coupling.tr_mul(&pose);
            }
        }
        let inverse: Vec<Matrix3<f64>> =
            normal.blocks.iter().map(|b| b.try_inverse().unwrap_or_else(Matrix3::identity)).collect();
        let dot =
            |a: &[Vector3<f64>], b: &[Vector3<f64>]| a.iter().zip(b).map(|(a, b)| a.dot(b)).sum::<f64>();
        let precondition = |r: &[Vector3<f64>]| -> Vec<Vector3<f64>> {
            r.iter().zip(&inverse).map(|(r, i)| i * r).collect()
        };
        let mut step = vec![Vector3::zeros(); count];
        let mut scaled = precondition(&residual);
        let mut direction = scaled.clone();
        let mut energy = dot(&residual, &scaled);
        let first = energy;
        let mut image = vec![Vector3::zeros(); count];
        for _ in 0..RULES.most_conjugate_steps {
            if energy.is_nan() || energy <= RULES.conjugate_tolerance.powi(2) * first {
                break;
            }
            self.apply(normal, &direction, &mut image);
            let curvature = dot(&direction, &image);
            if curvature.is_nan() || curvature <= 0.0 {
                break;
            }
            let length = energy / curvature;
            for at in 0..count {
                step[at] += length * direction[at];
                residual[at] -= length * image[at];
            }
            scaled = precondition(&residual);
            let next = dot(&residual, &scaled);
            for at in 0..count {
                direction[at] = scaled[at] + next / energy * direction[at];
            }
            energy = next;
        }
        step
    }

    /// Takes a step of the points and the step of the poses that belongs to it.
    fn take(&mut self, feet: &[Foot], normal: &Normal, step: &[Vector3<f64>]) {
        for frame in &normal.frames {
            let rows = &normal.rows[frame.rows.clone()];
            let coupled: Vector3<f64> = rows.iter().map(|row| row.coupling * step[row.node]).sum();
            let pose_step = -(frame.inverse * (frame.gradient + coupled));
            if let Some(row) = rows.first()
                && let Some(pose) = &mut self.poses[feet[row.foot].frame]
            {
                pose.place_m += pose_step.xy();
                pose.heading_rad += pose_step.z;
            }
        }
        self.nodes.iter_mut().zip(step).for_each(|(node, step)| *node += step);
    }
}

/// Standard deviation per coordinate of pairs with these squared norms, of which half may be gross;
/// at least 0.5.
fn spread(squares: &[Option<f64>]) -> f64 {
    let median = upper_median(squares.iter().flatten().copied().collect());
    median.map_or(1.0, |median| (0.5 * median / 2_f64.ln()).sqrt().clamp(0.5, 100.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    const START_M: f64 = 0.8;

    fn height(point: usize) -> f64 {
        1.0 + 0.5 * (1.3 * point as f64).sin()
    }

    /// A chain that is a little wrong, and feet of twenty points of a body that drives a bend by a camera
    /// 60 m up, found for a height of 0.8 m.
    fn example(noise_m: f64) -> (Chain, Vec<Foot>) {
        let (frames, points) = (80, 20);
        let at = |point: usize| Vector2::new(2.0 * (2.4 * point as f64).cos(), (3.7 * point as f64).sin());
        let (mut feet, mut poses) = (Vec::new(), Vec::new());
        for frame in 0..frames {
            let place_m = Vector2::new(0.5 * frame as f64 - 20.0, 10.0 + 0.004 * (frame * frame) as f64);
            let pose = PlanePose { place_m, heading_rad: 0.02 * frame as f64 };
            for point in 0..points {
                let foot_m = pose.place(&at(point));
                let by_height = -foot_m / 60.0;
                let key = (frame * points + point) as f64;
                // Two numbers that look like noise, between -1 and 1.
                let noise = |factor: f64| 2.0 * ((factor * key).sin() * 43_758.545_3).rem_euclid(1.0) - 1.0;
                let off = noise_m * Vector2::new(noise(12.9898), noise(78.233));
                let place_m = foot_m - by_height * (height(point) - START_M) + off;
                feet.push(Foot { frame, point, place_m, by_height, sigma_m: 0.03, clearance_m: 60.0 });
            }
            let (wrong_m, wrong) = (0.1 * (0.3 * frame as f64).sin(), 0.02 * (0.2 * frame as f64).cos());
            let place_m = place_m + Vector2::new(wrong_m, -wrong_m);
            poses.push(Some(PlanePose { place_m, heading_rad: pose.heading_rad + wrong }));
        }
        let pattern = (0..points).map(|point| Some(at(point) + Vector2::new(0.05, -0.03))).collect();
        (Chain { poses, part: vec![0; frames], patterns: vec![pattern] }, feet)
    }

    fn adjusted(noise_m: f64) -> Pattern {
        let (chain, feet) = example(noise_m);
        let mut known = vec![None; 20];
        known[3] = Some(KnownHeight { value_m: height(3), sigma_m: 0.02 });
        let mut pattern = Pattern::new(&chain, &[START_M; 20], &known, START_M);
        pattern.adjust(&feet, &[START_M; 20], 1.2);
        pattern
    }

    #[test]
    fn heights_come_back_from_views_that_turn() {
        let pattern = adjusted(0.0);
        for point in 0..20 {
            let (found, _) = pattern.point(0, point).unwrap();
            // What is believed of the scatter of heights draws a little.
            assert!((found.z - height(point)).abs() < 0.03, "{point}: {} {}", found.z, height(point));
        }
        assert_eq!(pattern.highest_point(), (0..20).max_by(|a, b| height(*a).total_cmp(&height(*b))));
    }

    /// A body that shrinks towards the camera looks the same: no residual may change.
    #[test]
    fn no_residual_sees_the_scale() {
        let (chain, feet) = example(0.1);
        let pattern = Pattern::new(&chain, &[START_M; 20], &[None; 20], START_M);
        let mut smaller = pattern.clone();
        let share = 0.9;
        for node in &mut smaller.nodes {
            *node = (share * node.xy()).push(node.z + (1.0 - share) * 60.0);
        }
        smaller.poses.iter_mut().flatten().for_each(|pose| pose.place_m *= share);
        let squares = |pattern: &Pattern, feet: &[Foot]| pattern.squares(feet, &[START_M; 20]);
        // The camera is above the origin, so that a foot's way to it is its place itself.
        let feet: Vec<Foot> = feet.iter().map(|f| Foot { by_height: -f.place_m / 60.0, ..*f }).collect();
        for (a, b) in squares(&pattern, &feet).iter().zip(squares(&smaller, &feet)) {
            assert!((a.unwrap() - b.unwrap()).abs() < 1e-9 * (1.0 + a.unwrap()), "{a:?} {b:?}");
        }
    }

    #[test]
    fn the_derivative_by_the_height_is_that_of_its_differences() {
        let (chain, feet) = example(0.1);
        let mut pattern = Pattern::new(&chain, &[START_M; 20], &[None; 20], START_M);
        let foot = &feet[333];
        let (pose, node) = pattern.node_of(foot).unwrap();
        let mut at = |rise: f64| {
            pattern.nodes[node].z = START_M + rise;
            pattern.residual(foot, &[START_M; 20], &pose, node)
        };
        let slope = (at(0.4 + 1e-5).0 - at(0.4 - 1e-5).0) / 2e-5;
        assert!((slope - at(0.4).1).norm() < 1e-6, "{slope} {}", at(0.4).1);
    }

    #[test]
    fn gross_feet_do_not_count() {
        let (chain, mut feet) = example(0.02);
        for foot in feet.iter_mut().filter(|foot| (foot.frame * 7 + foot.point * 3) % 10 < 3) {
            foot.place_m += Vector2::new(1.5, -0.8);
        }
        let mut known = vec![None; 20];
        known[3] = Some(KnownHeight { value_m: height(3), sigma_m: 0.02 });
        let mut pattern = Pattern::new(&chain, &[START_M; 20], &known, START_M);
        pattern.adjust(&feet, &[START_M; 20], 2.0);
        for point in 0..20 {
            let (found, [seen, agree]) = pattern.point(0, point).unwrap();
            assert!((found.z - height(point)).abs() < 0.15, "{point}: {}", found.z - height(point));
            assert_eq!((seen, agree), (80, 56));
        }
    }
}
