//! What all moments share is eliminated last and changes no step.

use super::examples::{Lens, drive_through, step_of, worst_block};
use crate::loss::Loss;
use crate::system::{Accuracy, Arrangement, BlockId, Curvature, Factors};
use nalgebra::DVector;

#[test]
fn what_all_moments_share_changes_no_step() {
    for frames in [None, Some(Arrangement::Together), Some(Arrangement::Apart)] {
        for held_observers in [false, true] {
            for loss in [Loss::Squared, Loss::Huber { scale: 3.0 }, Loss::Tukey { scale: 200.0 }] {
                let whole = drive_through(Lens::Plain, None, held_observers, loss);
                let shared = drive_through(Lens::Shared, frames, held_observers, loss);
                assert_eq!(shared.is_along_time(), frames.is_some());
                assert_eq!(shared.size(), whole.size());
                assert_eq!(shared.size(), shared.pattern.size() + 3);
                for (damping, least_flatness) in [(0.0, 1.0), (1e-4, 1.0), (1.0, 1.0), (1e-3, 0.1)] {
                    let curvature = Curvature { damping, least_flatness };
                    let (wanted, model) = step_of(&whole, curvature);
                    let mut normal = shared.normal();
                    shared.linearise(shared.start(), curvature, &mut normal).unwrap();
                    let mut factors = Factors::new(&shared).unwrap();
                    let extra: Vec<f64> = normal.scale().iter().map(|d| d * damping).collect();
                    factors.factorise(&shared, &mut normal, &extra).unwrap();
                    let mut delta: Vec<f64> = normal.raw_gradient().iter().map(|g| -g).collect();
                    factors.solve(&shared, &normal, Accuracy::Exact, &mut delta);
                    let largest = normal.largest_gradient();
                    let step = shared.back_substitute(shared.start(), curvature, &mut normal, delta);
                    let mut found = Vec::new();
                    for (block, _) in wanted.iter().enumerate().filter(|(_, wanted)| !wanted.is_empty()) {
                        found.extend_from_slice(shared.layout.step_of(BlockId(block), &step.delta));
                    }
                    let (found, wanted) = (DVector::from_vec(found), DVector::from_vec(wanted.concat()));
                    let gap = (&found - &wanted).norm() / wanted.norm();
                    assert!(gap < 1e-10, "{frames:?} {held_observers} {loss:?} {damping}: {gap:e}");
                    for (found, wanted) in [step.slope, step.squared, largest].iter().zip(model) {
                        assert!((found - wanted).abs() < 1e-10 * wanted.abs(), "{found} {wanted}");
                    }
                }
            }
        }
    }
}

#[test]
fn the_covariance_of_what_all_moments_share_is_that_of_the_dense_inverse() {
    for frames in [None, Some(Arrangement::Together)] {
        for loss in [Loss::Squared, Loss::Huber { scale: 3.0 }] {
            let whole = drive_through(Lens::Plain, None, false, loss);
            let shared = drive_through(Lens::Shared, frames, false, loss);
            let (worst, count) = worst_block(&shared, &whole);
            assert!(worst < 1e-10, "{frames:?} {loss:?}: {worst:e}");
            assert!(count > 200, "{count}");
        }
    }
}
