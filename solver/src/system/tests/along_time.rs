//! Poses that are eliminated along time, with bodies joint and separate, change no step.

use super::examples::{drive, step_of};
use super::residuals::Sight;
use crate::geometry::Pose;
use crate::linear::ordering::Elimination;
use crate::loss::Loss;
use crate::manifold::{Manifold, write_pose};
use crate::system::frames_factor::FramesFactor;
use crate::system::together::TogetherFactor;
use crate::system::{
    Accuracy, Arrangement, BlockId, Curvature, Measurement, System, SystemBuilder, TimeStep,
};
use nalgebra::DVector;

fn factor_of(system: &System) -> FramesFactor {
    FramesFactor::new(system.frames.as_ref().unwrap()).unwrap()
}

#[test]
fn frames_first_changes_no_step() {
    for (arrangement, elimination) in
        [(Arrangement::Together, Elimination::JointBodies), (Arrangement::Apart, Elimination::SeparateBodies)]
    {
        assert_frames_change_no_step(arrangement, elimination);
    }
}

fn assert_frames_change_no_step(arrangement: Arrangement, elimination: Elimination) {
    for held_observers in [false, true] {
        for loss in [Loss::Squared, Loss::Huber { scale: 3.0 }, Loss::Tukey { scale: 200.0 }] {
            let whole = drive(None, held_observers, loss);
            let framed = drive(Some(arrangement), held_observers, loss);
            assert!(framed.is_along_time() && !whole.is_along_time());
            assert_eq!(framed.elimination().0, elimination);
            for (damping, least_flatness) in [(0.0, 1.0), (1e-4, 1.0), (1.0, 1.0), (1e-3, 0.1)] {
                let curvature = Curvature { damping, least_flatness };
                let (wanted, model) = step_of(&whole, curvature);

                let mut normal = framed.normal();
                framed.linearise(framed.start(), curvature, &mut normal).unwrap();
                let mut factor = factor_of(&framed);
                let extra: Vec<f64> = normal.scale().iter().map(|d| d * damping).collect();
                let frames = framed.frames.as_ref().unwrap();
                factor.factorise(frames, &normal, &extra).unwrap();
                let mut delta: Vec<f64> = normal.raw_gradient().iter().map(|g| -g).collect();
                // Two right-hand sides at once.
                delta.extend(delta.clone().iter().map(|d| 2.0 * d));
                factor.solve(frames, &normal, Accuracy::Exact, &mut delta);
                let n = delta.len() / 2;
                for i in 0..n {
                    assert!((2.0 * delta[i] - delta[n + i]).abs() <= 1e-12 * delta[n + i].abs());
                }
                delta.truncate(n);
                let largest = normal.largest_gradient();
                let step = framed.back_substitute(framed.start(), curvature, &mut normal, delta);
                let mut found = Vec::new();
                for (block, wanted) in wanted.iter().enumerate() {
                    if !wanted.is_empty() {
                        found.extend_from_slice(framed.layout.step_of(BlockId(block), &step.delta));
                    }
                }
                let (found, wanted) = (DVector::from_vec(found), DVector::from_vec(wanted.concat()));
                let gap = (&found - &wanted).norm() / wanted.norm();
                assert!(gap < 1e-10, "{arrangement:?} {held_observers} {loss:?} damping {damping}: {gap:e}");
                for (found, wanted) in [step.slope, step.squared, largest].iter().zip(model) {
                    assert!((found - wanted).abs() < 1e-10 * wanted.abs(), "{found} {wanted}");
                }
            }
        }
    }
}

#[test]
fn a_step_by_the_factor_of_an_earlier_border_is_that_of_the_dense_solver() {
    for held_observers in [false, true] {
        for loss in [Loss::Squared, Loss::Huber { scale: 3.0 }] {
            let whole = drive(None, held_observers, loss);
            let drive = drive(Some(Arrangement::Together), held_observers, loss);
            let frames = drive.frames.as_ref().unwrap();
            let mut factor = TogetherFactor::new(frames).unwrap();
            let mut normal = drive.normal();
            // Once for a damping that is another, then as it should be; and given up after one product.
            for (earlier, damping, most, comes_to_its_end) in
                [(1.0, 1e-4, 200, true), (1e-2, 0.0, 200, true), (1.0, 1e-4, 1, false)]
            {
                let curvature = Curvature { damping, least_flatness: 1.0 };
                drive.linearise(drive.start(), curvature, &mut normal).unwrap();
                let scaled = |damping: f64| normal.scale().iter().map(|d| d * damping).collect::<Vec<_>>();
                factor.factorise(frames, &normal, &scaled(earlier)).unwrap();
                let extra = scaled(damping);
                let right: Vec<f64> = normal.raw_gradient().iter().map(|g| -g).collect();
                let mut delta = vec![0.0; right.len()];
                // The change of variables cancels digits, so that a second step refines the first.
                for _ in 0..2 {
                    let product = frames.multiply(&normal, &extra, &delta);
                    let mut rest: Vec<f64> = right.iter().zip(product).map(|(b, p)| b - p).collect();
                    let found = factor.step_within(frames, &normal, &extra, (1e-13, most), &mut rest);
                    assert_eq!(found, Ok(comes_to_its_end), "{held_observers} {loss:?} {earlier} {damping}");
                    delta.iter_mut().zip(rest).for_each(|(d, r)| *d += r);
                    factor.factorise(frames, &normal, &scaled(earlier)).unwrap();
                }
                let (wanted, _) = step_of(&whole, curvature);
                let found: Vec<f64> = (0..wanted.len())
                    .filter(|block| !wanted[*block].is_empty())
                    .flat_map(|block| drive.layout.step_of(BlockId(block), &delta).to_vec())
                    .collect();
                let (found, wanted) = (DVector::from_vec(found), DVector::from_vec(wanted.concat()));
                let gap = (&found - &wanted).norm() / wanted.norm();
                assert!(gap < 1e-10, "{held_observers} {loss:?} {earlier} {damping}: {gap:e}");
                // What the step did without can be had afterwards.
                let mut rest = right.clone();
                factor.step_within(frames, &normal, &extra, (1e-2, most), &mut rest).unwrap();
                factor.complete(frames, &normal).unwrap();
                let mut again = right.clone();
                factor.solve(frames, &normal, &mut again);
                let gap = (DVector::from_vec(again) - DVector::from_vec(delta.clone())).norm();
                assert!(gap < 1e-6 * DVector::from_vec(delta).norm(), "{gap:e}");
            }
        }
    }
}

#[test]
fn bodies_apart_are_solved_to_the_same_bits_by_any_number_of_threads() {
    let bits = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let system = drive(Some(Arrangement::Apart), false, Loss::Huber { scale: 3.0 });
            let mut normal = system.normal();
            system.linearise(system.start(), Curvature::PLAIN, &mut normal).unwrap();
            let mut factor = factor_of(&system);
            let extra = vec![0.0; system.pattern.size()];
            let frames = system.frames.as_ref().unwrap();
            factor.factorise(frames, &normal, &extra).unwrap();
            let mut step = normal.raw_gradient().to_vec();
            factor.solve(frames, &normal, Accuracy::Exact, &mut step);
            step.iter().map(|s| s.to_bits()).collect::<Vec<_>>()
        })
    };
    assert_eq!(bits(1), bits(2));
    assert_eq!(bits(1), bits(5));
}

#[test]
fn poses_that_are_held_in_part_are_not_eliminated_by_frames() {
    let mut builder = SystemBuilder::default();
    let pose = write_pose(&Pose::identity());
    let mut free = [true; 6];
    let observer = builder.add_block(Manifold::Pose, &pose, &free);
    free[2] = false;
    let body = builder.add_block(Manifold::Pose, &pose, &free);
    let point = builder.add_block(Manifold::POINT, &[0.0, 0.0, 5.0], &[true; 3]);
    let sight = Measurement { residual: Sight([0.0; 2]), blocks: [observer, body, point], sigma: [1.0; 2] };
    let sights = builder.add_group("sights", Loss::Squared, vec![sight]);
    builder.along_time(vec![TimeStep { observer: Some(observer), bodies: vec![body] }], vec![sights]);
    assert!(!builder.build().is_along_time());
}
