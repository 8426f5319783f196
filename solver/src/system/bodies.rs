//! Which poses and points make up a body, and whether bodies can be eliminated one by one.

use super::group::AnyGroup;
use super::time_steps::{Place, Placed, Step};
use crate::linear::matrix::Pattern;
use crate::linear::small::{POINT, POSE};
use std::ops::Range;

/// What conjugate gradients are counted as before any has been tried: their number, and how many times
/// longer an operation takes that waits for memory.
const EXPECTED_GRADIENTS: f64 = 60.0 * 4.0;

/// A body and its poses.
#[derive(Clone, Debug)]
pub(super) struct Body {
    /// Step, and which of its bodies, in time order.
    pub places: Vec<(usize, usize)>,
    /// Its rows of the border.
    pub shape: Range<usize>,
}

/// For each block a number that all blocks of one body share: its poses and its points.
pub(super) fn components(
    steps: &[Step],
    relative: &[usize],
    groups: &[Box<dyn AnyGroup>],
    at_step: &[Option<usize>],
    blocks: usize,
) -> Vec<usize> {
    let mut is_pose: Vec<bool> = at_step.iter().map(Option::is_some).collect();
    steps.iter().filter_map(|s| s.observer).for_each(|(observer, _)| is_pose[observer] = false);
    let mut parent: Vec<usize> = (0..blocks).collect();
    fn root(parent: &mut [usize], mut block: usize) -> usize {
        while parent[block] != block {
            parent[block] = parent[parent[block]];
            block = parent[block];
        }
        block
    }
    let mut join = |a: usize, b: usize| {
        let (a, b) = (root(&mut parent, a), root(&mut parent, b));
        parent[a.max(b)] = a.min(b);
    };
    for (index, group) in groups.iter().enumerate() {
        for item in 0..group.len() {
            let seen = group.blocks(item);
            if relative.contains(&index) {
                join(seen[1].0, seen[2].0);
            } else {
                let mut poses = seen.iter().filter(|b| is_pose[b.0]);
                if let Some(first) = poses.next() {
                    poses.for_each(|other| join(first.0, other.0));
                }
            }
        }
    }
    (0..blocks).map(|block| root(&mut parent, block)).collect()
}

/// The bodies and the operations that eliminate them; `None` where they are not apart. `of_block` and
/// `of_position` are their [`components`].
pub(super) fn bodies(
    placed: &Placed,
    pattern: &Pattern,
    of_block: &[usize],
    of_position: &[usize],
) -> Option<(Vec<Body>, f64)> {
    let mut index: Vec<Option<usize>> = vec![None; of_block.len()];
    let mut bodies: Vec<Body> = Vec::new();
    for (step, found) in placed.steps.iter().enumerate() {
        for (order, pose) in found.bodies.iter().enumerate() {
            let body = *index[of_block[pose.block]].get_or_insert(bodies.len());
            if body == bodies.len() {
                bodies.push(Body { places: Vec::new(), shape: 0..0 });
            }
            let places = &mut bodies[body].places;
            if places.last().is_some_and(|last| last.0 == step) {
                return None;
            }
            places.push((step, order));
        }
    }
    for (position, place) in placed.places.iter().enumerate() {
        if let Place::Border(at) = *place
            && at < placed.shape
        {
            let shape = &mut bodies[index[of_position[position]]?].shape;
            *shape =
                if shape.end == 0 { at..at + POINT } else { shape.start.min(at)..shape.end.max(at + POINT) };
        }
    }
    // What shares a measurement.
    let is_observer = |step: usize, at: usize| at < placed.dims[step].0;
    for (column, rows) in pattern.rows().iter().enumerate() {
        for &row in rows {
            let same = of_position[row] == of_position[column];
            let is_apart = match (placed.places[row], placed.places[column]) {
                (Place::Chain(s, i), Place::Chain(t, j)) => match (is_observer(s, i), is_observer(t, j)) {
                    (true, true) => true,
                    (false, false) => same,
                    _ => false,
                },
                (Place::Border(i), Place::Border(j)) => i.max(j) >= placed.shape || same,
                (Place::Chain(..), Place::Border(at)) | (Place::Border(at), Place::Chain(..)) => {
                    at >= placed.shape
                }
            };
            if !is_apart {
                return None;
            }
        }
    }
    let flops = |body: &Body| {
        let (y, s) = ((POSE * body.places.len()) as f64, body.shape.len() as f64);
        y * s * s + s.powi(3) / 3.0 + EXPECTED_GRADIENTS * 4.0 * y * s
    };
    let flops = bodies.iter().map(flops).sum();
    Some((bodies, flops))
}
