//! Steps that follow a body's frame.

use super::examples::body;
use crate::manifold::{read_point, read_pose};
use crate::system::{BlockId, System, Values};
use nalgebra::Vector3;

/// The step that shifts the body's frame by `v` and turns it by `w`, to first order.
fn frame_step(
    system: &System,
    poses: &[BlockId],
    points: &[BlockId],
    v: Vector3<f64>,
    w: Vector3<f64>,
) -> Vec<f64> {
    let mut step = vec![0.0; system.pattern.size()];
    let mut write = |block: BlockId, delta: &[f64]| {
        step[system.pattern.range(system.layout.position[block.0].unwrap())].copy_from_slice(delta);
    };
    for &block in points {
        let point = Vector3::from_column_slice(system.value(system.start(), block));
        write(block, (v + w.cross(&point)).as_slice());
    }
    for &block in poses {
        let turned = read_pose(system.value(system.start(), block)).rotation * v;
        write(block, &[-turned.x, -turned.y, -turned.z, -w.x, -w.y, -w.z]);
    }
    step
}

#[test]
fn a_turn_of_a_bodys_frame_changes_nothing_that_is_seen() {
    let (system, poses, points) = body();
    let step =
        frame_step(&system, &poses, &points, Vector3::new(0.4, -0.2, 0.1), Vector3::new(0.3, 0.5, -0.4));
    let moved = system.plus(system.start(), &step);
    for &pose in &poses {
        for &point in &points {
            let place = |values: &Values| {
                read_pose(system.value(values, pose)) * read_point(system.value(values, point))
            };
            assert!((place(&moved) - place(system.start())).norm() < 1e-14);
        }
    }
    assert_ne!(system.value(&moved, points[0]), system.value(system.start(), points[0]));
}

#[test]
fn the_exact_update_is_the_plain_one_to_first_order() {
    let (system, ..) = body();
    let direction: Vec<f64> = (0..system.pattern.size()).map(|i| (1.7 * i as f64).sin()).collect();
    let gap = |size: f64| -> f64 {
        let step: Vec<f64> = direction.iter().map(|d| d * size).collect();
        let exact = system.plus(system.start(), &step);
        let mut plain = system.start().clone();
        for (block, position) in system.layout.blocks.iter().zip(&system.layout.position) {
            let at = block.start..block.start + block.manifold.ambient();
            let delta = &step[system.pattern.range(position.unwrap())];
            block.manifold.plus(&system.start().0[at.clone()], delta, &mut plain.0[at]);
        }
        exact.0.iter().zip(&plain.0).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    };
    assert!(gap(1e-2) > 1e-6, "they differ");
    assert!((gap(1e-3) / gap(1e-2) - 0.01).abs() < 0.002, "by the square of the step");
}
