//! Blocks that are eliminated first change no step.

use super::examples::{example, example_with, images, images_by, images_in_a_row, step_of};
use crate::loss::Loss;
use crate::system::{Curvature, System};
use nalgebra::DVector;

#[track_caller]
fn assert_same_step(whole: &System, with_leaves: &System) {
    assert!(with_leaves.has_eliminated_blocks() && with_leaves.pattern.size() < whole.pattern.size());
    for (damping, least_flatness) in [(0.0, 1.0), (1e-4, 1.0), (10.0, 1.0), (1e-4, 0.05)] {
        let curvature = Curvature { damping, least_flatness };
        let (wanted, model) = step_of(whole, curvature);
        let (found, found_model) = step_of(with_leaves, curvature);
        let (wanted, found) = (DVector::from_vec(wanted.concat()), DVector::from_vec(found.concat()));
        let gap = (&found - &wanted).norm() / wanted.norm();
        assert!(gap < 1e-10, "damping {damping}: {gap:e}");
        for (found, wanted) in found_model.iter().zip(model) {
            assert!((found - wanted).abs() < 1e-10 * wanted.abs(), "{found} {wanted}");
        }
    }
}

#[test]
fn leaves_change_no_step() {
    let points: Vec<usize> = (6..16).collect();
    for leaves in [points.as_slice(), &points[2..7], &[0, 2, 4], &[1, 3, 5], &[0, 2, 16], &[16]] {
        for loss in [Loss::Squared, Loss::Huber { scale: 1.0 }, Loss::Tukey { scale: 8.0 }] {
            assert_same_step(&example(loss), &example_with(loss, false, leaves));
        }
    }
}

#[test]
fn the_common_sizes_of_bundle_adjustment_change_no_step() {
    assert_same_step(&images::<0>(false), &images::<0>(true));
    assert_same_step(&images::<3>(false), &images::<3>(true));
    assert_same_step(&images::<1>(false), &images::<1>(true));
}

#[test]
fn leaves_that_many_neighbours_see_change_no_step() {
    assert_same_step(&images_in_a_row::<0>(false), &images_in_a_row::<0>(true));
    assert_same_step(&images_in_a_row::<3>(false), &images_in_a_row::<3>(true));
}

#[test]
fn a_leaf_that_only_held_blocks_see_is_eliminated() {
    // Point 19 is seen by the camera that is held, and by no other.
    let seen = || (0..95).map(|k| ((k / 19 + k) % 4, k % 19)).chain([(2, 19), (2, 19)]);
    let curvature = Curvature { damping: 1e-4, least_flatness: 1.0 };
    let [wanted, found] = [false, true].map(|leaves| {
        let steps = step_of(&images_by::<3>(4, seen(), leaves), curvature).0;
        DVector::from_vec(steps.concat())
    });
    assert!((&found - &wanted).norm() < 1e-10 * wanted.norm());
}

#[test]
#[should_panic(expected = "share a measurement")]
fn leaves_that_see_each_other_are_refused() {
    example_with(Loss::Squared, false, &[0, 1]);
}
