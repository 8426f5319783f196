//! Linearisation of the image points of [frames](super::frames).

use super::accumulators::Moment;
use super::frames::{Frames, Home};
use super::group::State;
use super::layout::BlockId;
use super::time_steps::{BodyAtStep, Step};
use crate::linear::coupling::{Coupling, CouplingBlock};
use crate::linear::small::{POINT, POSE};
use crate::manifold::{body_from_observer_motion, read_pose};
use nalgebra::{DMatrix, Matrix6, Vector6};
use rayon::prelude::*;
use std::ops::Range;

/// The image points of a linearisation.
pub(super) struct FramesLinear {
    /// For each body of each step, in order: `Hyy`, its gradient, and the motion `A`.
    pub bodies: Vec<(Matrix6<f64>, Vector6<f64>, Matrix6<f64>)>,
    /// `W` of each home.
    pub coupling: Vec<Coupling>,
    /// For each chunk the shape's diagonal blocks (9 numbers each) and gradient.
    pub sums: Vec<(Vec<f64>, Vec<f64>)>,
}

impl Frames {
    /// Room for a linearisation.
    pub(super) fn linear(&self) -> FramesLinear {
        let bodies = self.steps.iter().map(|s| s.bodies.len()).sum();
        let sums = (vec![0.0; self.shape * POINT], vec![0.0; self.shape]);
        FramesLinear {
            bodies: vec![(Matrix6::zeros(), Vector6::zeros(), Matrix6::zeros()); bodies],
            coupling: self.homes.iter().map(|home| Coupling::zeros(home.coupling.clone())).collect(),
            sums: vec![sums; self.chunks.len()],
        }
    }

    /// Linearises the image points, and adds them to gradient and diagonal.
    pub(super) fn linearise(
        &self,
        state: State<'_>,
        linear: &mut FramesLinear,
        gradient: &mut [f64],
        diagonal: &mut [f64],
    ) {
        let FramesLinear { bodies, coupling, sums } = linear;
        let mut tasks = Vec::with_capacity(self.chunks.len());
        let mut bodies_left = bodies.as_mut_slice();
        let mut coupling_left: Vec<&mut [CouplingBlock]> =
            coupling.iter_mut().map(Coupling::blocks_mut).collect();
        let mut next_pose = vec![0; self.homes.len()];
        for (chunk, sums) in self.chunks.iter().zip(sums) {
            let of_chunk = || self.steps[chunk.clone()].iter().flat_map(|s| &s.bodies);
            let own_bodies = bodies_left.split_off_mut(..of_chunk().count()).expect("one for each body");
            let first_pose = next_pose.clone();
            of_chunk().for_each(|body| next_pose[body.home] += 1);
            let own_coupling = self
                .homes
                .iter()
                .zip(&mut coupling_left)
                .zip(first_pose.iter().zip(&next_pose))
                .map(|((home, left), (first, next))| {
                    let count = (*first..*next).map(|pose| home.coupling.points(pose).len()).sum();
                    left.split_off_mut(..count).expect("blocks for each pose")
                })
                .collect();
            tasks.push(Task {
                frames: self,
                state,
                chunk: chunk.clone(),
                bodies: own_bodies,
                coupling: own_coupling,
                next_pose: first_pose,
                sums,
            });
        }
        tasks.into_par_iter().for_each(Task::run);
        let mut body = linear.bodies.iter();
        for step in &self.steps {
            for BodyAtStep { block, .. } in &step.bodies {
                let (h, g, a) = body.next().expect("one for each body");
                let mut add = |block: usize, g: Vector6<f64>, d: Vector6<f64>| {
                    let start = state.layout.step_start[block].expect("free");
                    for i in 0..POSE {
                        gradient[start + i] += g[i];
                        diagonal[start + i] += d[i];
                    }
                };
                add(*block, *g, h.diagonal());
                if let Some((observer, true)) = step.observer {
                    add(observer, a.transpose() * g, (a.transpose() * h * a).diagonal());
                }
            }
        }
        for &(at, start) in &self.points {
            for (diagonal_blocks, of_points) in &linear.sums {
                for i in 0..POINT {
                    gradient[start + i] += of_points[at + i];
                    diagonal[start + i] += diagonal_blocks[POINT * at + i * POINT + i];
                }
            }
        }
    }

    /// `T` of each step: `(c, v)` from `(c, y)`.
    pub(super) fn turns(&self, linear: &FramesLinear) -> Vec<DMatrix<f64>> {
        let mut body = linear.bodies.iter();
        let turn = |(step, &(c, y)): (&Step, &(usize, usize))| {
            let mut turn = DMatrix::identity(c + y, c + y);
            for i in 0..step.bodies.len() {
                let (.., a) = body.next().expect("one for each body");
                if c > 0 {
                    turn.fixed_view_mut::<POSE, POSE>(c + POSE * i, 0).copy_from(&-a);
                }
            }
            turn
        };
        self.steps.iter().zip(&self.dims).map(turn).collect()
    }
}

/// The image points of some steps.
struct Task<'a> {
    frames: &'a Frames,
    state: State<'a>,
    chunk: Range<usize>,
    bodies: &'a mut [(Matrix6<f64>, Vector6<f64>, Matrix6<f64>)],
    /// What is left of each home, and the pose that comes next.
    coupling: Vec<&'a mut [CouplingBlock]>,
    next_pose: Vec<usize>,
    sums: &'a mut (Vec<f64>, Vec<f64>),
}

impl Task<'_> {
    fn run(self) {
        let Task { frames, state, chunk, bodies, mut coupling, mut next_pose, sums } = self;
        let State { layout, groups, values, curvature } = state;
        let (own, gradient) = sums;
        own.fill(0.0);
        gradient.fill(0.0);
        let mut bodies = bodies.iter_mut();
        for step in &frames.steps[chunk] {
            for BodyAtStep { block: body, items, home } in &step.bodies {
                let Home { rows, coupling: pattern } = &frames.homes[*home];
                let points = pattern.points(next_pose[*home]);
                next_pose[*home] += 1;
                let mut moment = Moment {
                    by_pose: [[0.0; POSE]; POSE],
                    of_pose: [0.0; POSE],
                    points,
                    coupling: coupling[*home].split_off_mut(..points.len()).expect("a block for each point"),
                    by_point: &mut own[POINT * rows.start..POINT * rows.end],
                    of_point: &mut gradient[rows.clone()],
                };
                for items in items.chunk_by(|a, b| a.0 == b.0) {
                    let group = &groups[items[0].0 as usize];
                    group.add_to_moment(items, layout, values, curvature.least_flatness, &mut moment);
                }
                let h = moment.by_pose;
                let out = bodies.next().expect("one for each body");
                out.0 = Matrix6::from_fn(|i, j| h[i.max(j)][i.min(j)]);
                out.1 = Vector6::from(moment.of_pose);
                let pose = |block: usize| read_pose(layout.value(values, BlockId(block)));
                out.2 = step.observer.map_or(Matrix6::zeros(), |(observer, _)| {
                    body_from_observer_motion(&pose(observer), &pose(*body))
                });
            }
        }
    }
}
