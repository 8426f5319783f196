//! Cost, gradient, normal equations and steps against dense algebra and differences.

use super::examples::{Lens, dense, drive, drive_through, example, example_with, linearised};
use crate::linear::cholesky::Cholesky;
use crate::loss::{Loss, LossName};
use crate::system::{Arrangement, BlockId, GroupId, IMPOSSIBLE_SIGMAS, System};
use nalgebra::{DMatrix, DVector};

#[test]
fn the_gradient_is_that_of_the_true_robust_cost() {
    for (name, _) in LossName::ALL {
        let system = example(name.with_scale(2.0, -1.0));
        let gradient = linearised(&system).gradient;
        let scale = gradient.iter().fold(1.0, |a: f64, g| a.max(g.abs()));
        for index in 0..gradient.len() {
            let at = |step: f64| {
                let mut delta = vec![0.0; gradient.len()];
                delta[index] = step;
                system.cost(&system.plus(system.start(), &delta)).value
            };
            let slope = (at(1e-5) - at(-1e-5)) / 2e-5;
            // Held components have no gradient, though the cost may change along them.
            if gradient[index] != 0.0 {
                assert!(
                    (slope - gradient[index]).abs() < 1e-6 * scale,
                    "{name} {index}: {slope} {}",
                    gradient[index]
                );
            }
        }
    }
}

/// The reference: all Jacobians side by side in one dense matrix.
#[test]
fn normal_equations_and_step_are_those_of_a_dense_solver() {
    for loss in [Loss::Squared, Loss::Huber { scale: 1.0 }, Loss::Tukey { scale: 8.0 }] {
        let system = example(loss);
        let normal = linearised(&system);
        let n = normal.matrix.size();
        let rows: usize = normal.linear.iter().flatten().map(|linear| linear.residuals.len()).sum();
        let mut jacobian = DMatrix::zeros(rows, n);
        let mut residual = DVector::zeros(rows);
        let mut row = 0;
        for (index, linear) in normal.linear.iter().flatten().enumerate() {
            for item in 0..linear.residuals.len() {
                let mut unit = vec![0.0; linear.residuals.len()];
                unit[item] = 1.0;
                let product = system.transposed_product(GroupId(index), &normal, &unit);
                jacobian.set_row(row, &DVector::from_vec(product).transpose());
                residual[row] = linear.residuals[item];
                row += 1;
            }
        }
        let mut wanted = jacobian.transpose() * &jacobian;
        let held: Vec<usize> = (0..n).filter(|&i| wanted[(i, i)] == 0.0).collect();
        assert_eq!(held.len(), 3, "two of a pose, one of a point");
        held.iter().for_each(|&i| wanted[(i, i)] = 1.0);
        let found = dense(&normal.matrix);
        assert!((&found - &wanted).norm() < 1e-13 * wanted.norm());
        let gradient = jacobian.transpose() * residual;
        let found_gradient = DVector::from_vec(normal.gradient.clone());
        assert!((&found_gradient - &gradient).norm() < 1e-13 * gradient.norm());

        let damping = 1e-3;
        let extra: Vec<f64> = normal.matrix.diagonal().iter().map(|d| d * damping).collect();
        let mut damped = normal.matrix.clone();
        damped.copy_with_diagonal(&normal.matrix, &extra);
        let mut cholesky = Cholesky::analyse(&damped).unwrap();
        cholesky.factorise(&damped).unwrap();
        let mut step = normal.gradient.clone();
        cholesky.solve(&mut step);
        let wanted_step =
            (wanted + DMatrix::from_diagonal(&DVector::from_vec(extra))).lu().solve(&gradient).unwrap();
        assert!((DVector::from_vec(step) - &wanted_step).norm() < 1e-10 * wanted_step.norm());
    }
}

#[test]
fn held_components_do_not_move() {
    let system = example(Loss::Squared);
    let normal = linearised(&system);
    let mut step = normal.gradient.clone();
    let mut cholesky = Cholesky::analyse(&normal.matrix).unwrap();
    let mut damped = normal.matrix.clone();
    damped.copy_with_diagonal(&normal.matrix, &vec![1.0; step.len()]);
    cholesky.factorise(&damped).unwrap();
    cholesky.solve(&mut step);
    let moved = system.plus(system.start(), &step);
    let (before, after) =
        (|b| system.value(system.start(), BlockId(b)), |b| system.value(&moved, BlockId(b)));
    assert_eq!(before(2)[0], after(2)[0], "x of the third pose");
    assert_ne!(before(2)[1], after(2)[1]);
    assert_eq!(before(6 + 3), after(6 + 3), "a held point");
    assert_eq!(before(6 + 4)[1], after(6 + 4)[1], "y of the next");
    assert_ne!(before(6 + 4)[0], after(6 + 4)[0]);
    assert_eq!(system.parameters(), 6 * 6 - 2 + 10 * 3 - 3 - 1 + 1);
}

#[test]
fn an_impossible_measurement_costs_and_pulls_nowhere() {
    let system = example_with(Loss::Squared, true, &[]);
    let cost = system.cost(system.start());
    // Point 7 is seen by k = 17, 27, 37, 47, 57 (k = 7 is left out).
    assert_eq!(cost.impossible, 5);
    assert!(cost.value > 5.0 * 0.5 * IMPOSSIBLE_SIGMAS * IMPOSSIBLE_SIGMAS);
    assert_eq!(system.squared_norms(GroupId(1), system.start()).iter().filter(|s| s.is_none()).count(), 5);
    assert!(linearised(&system).gradient.iter().all(|g| g.abs() < 1e6));
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let bits = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let system = example(Loss::Cauchy { scale: 1.0 });
            let normal = linearised(&system);
            let mut bits = vec![system.cost(system.start()).value.to_bits()];
            bits.extend(normal.gradient.iter().map(|g| g.to_bits()));
            bits.extend(dense(&normal.matrix).iter().map(|v| v.to_bits()));
            bits
        })
    };
    assert_eq!(bits(1), bits(2));
    assert_eq!(bits(1), bits(7));
}

#[test]
fn a_group_can_be_weighed_anew() {
    let mut system = example(Loss::Squared);
    let squares = |system: &System| -> f64 {
        system.squared_norms(GroupId(2), system.start()).into_iter().flatten().sum()
    };
    let before = squares(&system);
    system.set_sigma_factor(GroupId(2), 2.0);
    assert!((squares(&system) - before / 4.0).abs() < 1e-12 * before);
    assert_eq!(system.sigma_factor(GroupId(2)), 2.0);
    // A row by itself: its residuals alone become less.
    let residuals = |system: &System| system.residuals(GroupId(2), system.start());
    let all = residuals(&system);
    let rows = system.sigma_factors(GroupId(2)).len();
    let mut factors = vec![2.0; rows];
    factors[rows - 1] = 6.0;
    system.set_sigma_factors(GroupId(2), &factors);
    for (before, after) in all.into_iter().flatten().zip(residuals(&system).into_iter().flatten()) {
        let wanted: Vec<f64> = before.iter().zip(&factors).map(|(r, factor)| r * 2.0 / factor).collect();
        assert!(
            wanted.iter().zip(&after).all(|(a, b)| (a - b).abs() < 1e-12 * a.abs()),
            "{wanted:?} {after:?}"
        );
    }
}

#[test]
fn normal_matrices_of_single_blocks_are_those_on_the_diagonal() {
    let whole = drive(None, false, Loss::Huber { scale: 3.0 });
    let dense = dense(&linearised(&whole).matrix);
    let drive = drive(Some(Arrangement::Together), false, Loss::Huber { scale: 3.0 });
    let blocks: Vec<BlockId> =
        (0..whole.layout.blocks.len()).map(BlockId).filter(|b| whole.range_of(*b).is_some()).collect();
    let normals = drive.own_normals(drive.start());
    for block in &blocks {
        let found = normals.of(*block);
        let range = whole.range_of(*block).unwrap();
        for (i, row) in range.clone().enumerate().filter(|(i, _)| whole.free(*block)[*i]) {
            for (j, column) in range.clone().enumerate() {
                assert!((found[(i, j)] - dense[(row, column)]).abs() < 1e-11 * dense[(row, row)]);
            }
        }
    }
}

#[test]
fn products_with_jacobians_are_those_of_their_transposes() {
    let system = drive_through(Lens::Shared, None, false, Loss::Huber { scale: 3.0 });
    let normal = linearised(&system);
    let n = system.size();
    let x: Vec<f64> = (0..n).map(|i| (0.3 * i as f64).sin()).collect();
    for group in (0..system.groups.len()).map(GroupId) {
        let z: Vec<f64> = (0..system.rows(group)).map(|i| (0.7 * i as f64).cos()).collect();
        let forward: f64 = system.product(group, system.start(), &x).iter().zip(&z).map(|(a, b)| a * b).sum();
        let back: f64 =
            system.transposed_product(group, &normal, &z).iter().zip(&x).map(|(a, b)| a * b).sum();
        assert!((forward - back).abs() < 1e-11 * forward.abs().max(1.0), "{forward} {back}");
    }
}
