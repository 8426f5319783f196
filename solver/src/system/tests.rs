//! The system against dense algebra and finite differences.

use super::together::TogetherFactor;
use super::*;
use crate::geometry::{pose, rotation::exp};
use crate::linear::cholesky::Cholesky;
use crate::loss::LossName;
use crate::manifold::{pose_minus, pose_minus_jacobian, read_pose, write_pose};
use crate::residual::Jacobian;
use nalgebra::{DMatrix, DVector, RowVector3, SMatrix, SVector, Vector1, Vector3};

/// Difference of two poses and a measured one.
struct Between(crate::geometry::Pose);

impl Residual<6, 2> for Between {
    const MANIFOLDS: [Manifold; 2] = [Manifold::Pose; 2];
    fn evaluate(&self, x: &[&[f64]; 2], jacobian: Option<&mut Jacobian<6, 2>>) -> Option<SVector<f64, 6>> {
        // Of the first pose against the second moved by the measurement; by the second, numerically.
        let (a, b) = (read_pose(x[0]), read_pose(x[1]));
        let value = |b: &crate::geometry::Pose| pose_minus(&a, &(b * self.0));
        if let Some(jacobian) = jacobian {
            jacobian.set(0, 0, &pose_minus_jacobian(&a, &(b * self.0)));
            let mut by_b = SMatrix::<f64, 6, 6>::zeros();
            for column in 0..6 {
                let at = |step: f64| {
                    let mut delta = [0.0; 6];
                    delta[column] = step;
                    let mut moved = [0.0; 7];
                    Manifold::Pose.plus(x[1], &delta, &mut moved);
                    value(&read_pose(&moved))
                };
                by_b.set_column(column, &((at(1e-5) - at(-1e-5)) / 2e-5));
            }
            jacobian.set(1, 0, &by_b);
        }
        Some(value(&b))
    }
}

/// Distance of a point, in the frame of a pose, from a measured place. Impossible above z = 50.
struct Seen(Vector3<f64>);

impl Residual<3, 2> for Seen {
    const MANIFOLDS: [Manifold; 2] = [Manifold::Pose, Manifold::POINT];
    fn evaluate(&self, x: &[&[f64]; 2], jacobian: Option<&mut Jacobian<3, 2>>) -> Option<Vector3<f64>> {
        let pose = read_pose(x[0]);
        let point = Vector3::from_column_slice(x[1]);
        let inverse = pose.rotation.inverse().to_rotation_matrix();
        let local = inverse * (point - pose.translation.vector);
        if let Some(jacobian) = jacobian {
            jacobian.set(0, 0, &-inverse.matrix());
            jacobian.set(0, 3, &crate::geometry::skew(&local));
            jacobian.set(1, 0, inverse.matrix());
        }
        (point.z < 50.0).then(|| local - self.0)
    }
}

/// One coordinate of a point against a scalar.
struct Level(usize);

impl Residual<1, 2> for Level {
    const MANIFOLDS: [Manifold; 2] = [Manifold::POINT, Manifold::SCALAR];
    fn evaluate(&self, x: &[&[f64]; 2], jacobian: Option<&mut Jacobian<1, 2>>) -> Option<Vector1<f64>> {
        if let Some(jacobian) = jacobian {
            let mut row = RowVector3::zeros();
            row[self.0] = 1.0;
            jacobian.set(0, 0, &row);
            jacobian.set(1, 0, &SMatrix::<f64, 1, 1>::new(-1.0));
        }
        Some(Vector1::new(x[0][self.0] - x[1][0]))
    }
}

/// Six poses in a chain, ten points, one scalar; one pose and one point are held in part, one point
/// whole; some measurements are gross.
fn example(loss: Loss) -> System {
    example_with(loss, false, &[])
}

/// The same, with a point at an impossible place, and with leaves. Blocks 0 to 5 are poses, 6 to 15
/// points, 16 the scalar.
fn example_with(loss: Loss, impossible: bool, leaves: &[usize]) -> System {
    let mut builder = SystemBuilder::default();
    let wave = |k: f64| Vector3::new((1.3 * k).sin(), (2.1 * k).cos(), (0.7 * k + 1.0).sin());
    let poses: Vec<BlockId> = (0..6)
        .map(|i| {
            let value = crate::geometry::Pose::from_parts(
                (wave(f64::from(i)) * 3.0).into(),
                exp(&wave(9.0 + f64::from(i))),
            );
            let free = if i == 2 { [false, true, true, true, false, true] } else { [true; 6] };
            builder.add_block(Manifold::Pose, &write_pose(&value), &free)
        })
        .collect();
    let points: Vec<BlockId> = (0..10)
        .map(|i| {
            let mut value = wave(20.0 + f64::from(i)) * 4.0;
            if i == 7 && impossible {
                value.z = 60.0;
            }
            let free = match i {
                3 => [false; 3],
                4 => [true, false, true],
                _ => [true; 3],
            };
            builder.add_block(Manifold::POINT, value.as_slice(), &free)
        })
        .collect();
    let scalar = builder.add_block(Manifold::SCALAR, &[0.3], &[true]);
    let chain = poses.windows(2).map(|pair| Measurement {
        residual: Between(pose([0.5, 0.1, -0.2], [0.9, 0.1, 0.2, 0.3])),
        blocks: [pair[1], pair[0]],
        sigma: [0.5, 0.4, 0.6, 0.1, 0.2, 0.3],
    });
    builder.add_group("chain", Loss::Squared, chain.collect());
    let seen = (0..60).filter(|k| k % 7 != 0).map(|k| Measurement {
        residual: Seen(wave(f64::from(k as u32)) * if k % 11 == 0 { 30.0 } else { 2.0 }),
        blocks: [poses[k % 6], points[k % 10]],
        sigma: [0.7, 0.8, 0.9],
    });
    builder.add_group("seen", loss, seen.collect());
    let level =
        (0..10).map(|k| Measurement { residual: Level(k % 3), blocks: [points[k], scalar], sigma: [1.5] });
    builder.add_group("level", Loss::Squared, level.collect());
    builder.eliminate(leaves.iter().map(|&leaf| BlockId(leaf)).collect());
    builder.build()
}

fn dense(matrix: &BlockMatrix) -> DMatrix<f64> {
    let n = matrix.size();
    let columns: Vec<DVector<f64>> = (0..n)
        .map(|j| {
            let mut unit = vec![0.0; n];
            unit[j] = 1.0;
            DVector::from_vec(matrix.multiply(&unit))
        })
        .collect();
    DMatrix::from_columns(&columns)
}

fn linearised(system: &System) -> Normal {
    let mut normal = system.normal();
    system.linearise(system.start(), Curvature::PLAIN, &mut normal).unwrap();
    normal
}

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

/// The damped step of every block, and what the model says of it.
fn step_of(system: &System, curvature: Curvature) -> (Vec<Vec<f64>>, [f64; 3]) {
    let mut normal = system.normal();
    let values = system.start();
    system.linearise(values, curvature, &mut normal).unwrap();
    let extra: Vec<f64> = normal.scale().iter().map(|d| d * curvature.damping).collect();
    normal.matrix.add_to_diagonal(&extra);
    let mut cholesky = Cholesky::analyse(system.pattern()).unwrap();
    cholesky.factorise(&normal.matrix).unwrap();
    let mut others: Vec<f64> = normal.gradient.iter().map(|g| -g).collect();
    cholesky.solve(&mut others);
    let largest = normal.largest_gradient();
    let step = system.back_substitute(values, curvature, &mut normal, others);
    let of = |block: usize| match system.step_start[block] {
        Some(_) => system.step_of(BlockId(block), &step.delta).to_vec(),
        None => Vec::new(),
    };
    ((0..system.blocks.len()).map(of).collect(), [step.slope, step.squared, largest])
}

#[track_caller]
fn assert_same_step(whole: &System, with_leaves: &System) {
    assert!(with_leaves.has_leaves() && with_leaves.pattern().size() < whole.pattern().size());
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

/// A pinhole with `N` numbers of a lens that scale the image, as a bundle adjustment sees it.
struct Image<const N: usize>([f64; 2]);

impl<const N: usize> Residual<2, 2> for Image<N> {
    const MANIFOLDS: [Manifold; 2] = [Manifold::PoseAndVector(N), Manifold::POINT];
    fn evaluate(&self, x: &[&[f64]; 2], jacobian: Option<&mut Jacobian<2, 2>>) -> Option<SVector<f64, 2>> {
        let at = |camera: &[f64], point: &[f64]| {
            let point = crate::manifold::read_point(point);
            let local = read_pose(&camera[..7]).inverse_transform_point(&point);
            let ray = SVector::<f64, 2>::new(local.x / local.z, local.y / local.z);
            let lens = |(power, k): (usize, &f64)| k * (10.0 * ray.norm_squared()).powi(power as i32);
            ray * (1.0 + camera[7..].iter().enumerate().map(lens).sum::<f64>())
        };
        if let Some(jacobian) = jacobian {
            for (block, manifold) in Self::MANIFOLDS.iter().enumerate() {
                for column in 0..manifold.tangent() {
                    let moved = |step: f64| {
                        let mut delta = [0.0; MAX_TANGENT];
                        delta[column] = step;
                        let mut moved = vec![0.0; manifold.ambient()];
                        manifold.plus(x[block], &delta[..manifold.tangent()], &mut moved);
                        if block == 0 { at(&moved, x[1]) } else { at(x[0], &moved) }
                    };
                    jacobian.set(block, column, &((moved(1e-5) - moved(-1e-5)) / 2e-5));
                }
            }
        }
        Some(at(x[0], x[1]) - SVector::from(self.0))
    }
}

/// Four cameras above twenty points, one camera held; a point may be seen twice in an image.
fn images<const N: usize>(leaves: bool) -> System {
    // Of each point two images in the same camera.
    let camera = |k: usize| if k >= 100 { 0 } else { (k / 20 + k) % 4 };
    images_by::<N>(4, (0..110).map(|k| (camera(k), k % 20)), leaves)
}

/// The same by twelve cameras: many that are neighbours see a point, some of them twice, or one that is no
/// neighbour sees it too, or the one that is held.
fn images_in_a_row<const N: usize>(leaves: bool) -> System {
    let of_point = |i: usize| -> Vec<(usize, usize)> {
        let others: &[usize] = [&[] as &[usize], &[7], &[11], &[2], &[7, 7, 11]][i % 5];
        (3..10 + i % 2).chain(others.iter().copied()).map(|camera| (camera, i)).collect()
    };
    images_by::<N>(12, (0..20).flat_map(of_point), leaves)
}

fn images_by<const N: usize>(
    count: usize,
    seen: impl Iterator<Item = (usize, usize)>,
    leaves: bool,
) -> System {
    let mut builder = SystemBuilder::default();
    let wave = |k: f64| Vector3::new((1.3 * k).sin(), (2.1 * k).cos(), (0.7 * k + 1.0).sin());
    let cameras: Vec<BlockId> = (0..count as u32)
        .map(|i| {
            let place = wave(f64::from(i)) + Vector3::new(0.0, 0.0, -9.0);
            let pose =
                crate::geometry::Pose::from_parts(place.into(), exp(&(wave(5.0 + f64::from(i)) * 0.1)));
            let value = [write_pose(&pose).as_slice(), &[0.1; 3][..N]].concat();
            // One camera is held, and of another one coordinate, which is the scale.
            let mut free = vec![i != 2; 6 + N];
            free[0] &= i != 3;
            builder.add_block(Manifold::PoseAndVector(N), &value, &free)
        })
        .collect();
    let points: Vec<BlockId> = (0..20)
        .map(|i| builder.add_block(Manifold::POINT, wave(30.0 + f64::from(i)).as_slice(), &[true; 3]))
        .collect();
    let seen = seen.enumerate().map(|(k, (camera, point))| {
        let pixel = wave(k as f64) * 0.1;
        Measurement {
            residual: Image::<N>([pixel.x, pixel.y]),
            blocks: [cameras[camera], points[point]],
            sigma: [0.01, 0.02],
        }
    });
    builder.add_group("images", Loss::Huber { scale: 5.0 }, seen.collect());
    if leaves {
        builder.eliminate(points);
    }
    builder.build()
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
}

/// Points and poses of one body with all components free.
fn body() -> (System, Vec<BlockId>, Vec<BlockId>) {
    let mut builder = SystemBuilder::default();
    let wave = |k: f64| Vector3::new((1.3 * k).sin(), (2.1 * k).cos(), (0.7 * k + 1.0).sin());
    let poses: Vec<BlockId> = (0..4)
        .map(|i| {
            let value = crate::geometry::Pose::from_parts(
                (wave(f64::from(i)) * 3.0).into(),
                exp(&wave(9.0 + f64::from(i))),
            );
            builder.add_block(Manifold::Pose, &write_pose(&value), &[true; 6])
        })
        .collect();
    let points: Vec<BlockId> = (0..5)
        .map(|i| builder.add_block(Manifold::POINT, wave(30.0 + f64::from(i)).as_slice(), &[true; 3]))
        .collect();
    let seen = poses.iter().flat_map(|&pose| {
        points.iter().map(move |&point| Measurement {
            residual: Seen(Vector3::zeros()),
            blocks: [pose, point],
            sigma: [1.0; 3],
        })
    });
    builder.add_group("seen", Loss::Squared, seen.collect());
    builder.add_rigid_body(points.clone(), poses.clone());
    (builder.build(), poses, points)
}

/// The step that shifts the body's frame by `v` and turns it by `w`, to first order.
fn frame_step(
    system: &System,
    poses: &[BlockId],
    points: &[BlockId],
    v: Vector3<f64>,
    w: Vector3<f64>,
) -> Vec<f64> {
    let mut step = vec![0.0; system.pattern().size()];
    let mut write = |block: BlockId, delta: &[f64]| {
        step[system.pattern().range(system.position[block.0].unwrap())].copy_from_slice(delta);
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
                read_pose(system.value(values, pose))
                    * crate::manifold::read_point(system.value(values, point))
            };
            assert!((place(&moved) - place(system.start())).norm() < 1e-14);
        }
    }
    assert_ne!(system.value(&moved, points[0]), system.value(system.start(), points[0]));
}

#[test]
fn the_exact_update_is_the_plain_one_to_first_order() {
    let (system, ..) = body();
    let direction: Vec<f64> = (0..system.pattern().size()).map(|i| (1.7 * i as f64).sin()).collect();
    let gap = |size: f64| -> f64 {
        let step: Vec<f64> = direction.iter().map(|d| d * size).collect();
        let exact = system.plus(system.start(), &step);
        let mut plain = system.start().clone();
        for (block, position) in system.blocks.iter().zip(&system.position) {
            let at = block.start..block.start + block.manifold.ambient();
            let delta = &step[system.pattern().range(position.unwrap())];
            block.manifold.plus(&system.start().0[at.clone()], delta, &mut plain.0[at]);
        }
        exact.0.iter().zip(&plain.0).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    };
    assert!(gap(1e-2) > 1e-6, "they differ");
    assert!((gap(1e-3) / gap(1e-2) - 0.01).abs() < 0.002, "by the square of the step");
}

/// What an observer sees of a point of a body.
struct Sight([f64; 2]);

impl Residual<2, 3> for Sight {
    const MANIFOLDS: [Manifold; 3] = [Manifold::Pose, Manifold::Pose, Manifold::POINT];
    fn evaluate(&self, x: &[&[f64]; 3], jacobian: Option<&mut Jacobian<2, 3>>) -> Option<SVector<f64, 2>> {
        let (observer, body) = (read_pose(x[0]), read_pose(x[1]));
        let point = crate::manifold::read_point(x[2]);
        let local = observer.inverse_transform_point(&(body * point));
        let ray = SVector::<f64, 2>::new(local.x, local.y) / local.z;
        if let Some(jacobian) = jacobian {
            let by_local = SMatrix::<f64, 2, 3>::new(1.0, 0.0, -ray.x, 0.0, 1.0, -ray.y) / local.z;
            let to_local = observer.rotation.inverse().to_rotation_matrix();
            let by_world = by_local * to_local.matrix();
            let by_point = by_world * body.rotation.to_rotation_matrix().matrix();
            jacobian.set(0, 0, &-by_world);
            jacobian.set(0, 3, &(by_local * crate::geometry::skew(&local.coords)));
            jacobian.set(1, 0, &by_world);
            jacobian.set(1, 3, &-(by_point * crate::geometry::skew(&point.coords)));
            jacobian.set(2, 0, &by_point);
        }
        Some(ray - SVector::from(self.0))
    }
}

/// The same through a lens that all moments share: `s` scales the ray, `d` shifts it.
struct LensSight([f64; 2]);

impl Residual<2, 4> for LensSight {
    const MANIFOLDS: [Manifold; 4] = [Manifold::Pose, Manifold::Pose, Manifold::POINT, Manifold::Vector(3)];
    fn evaluate(&self, x: &[&[f64]; 4], jacobian: Option<&mut Jacobian<2, 4>>) -> Option<SVector<f64, 2>> {
        let (scale, shift) = (1.0 + x[3][0], SVector::<f64, 2>::new(x[3][1], x[3][2]));
        let mut plain = Jacobian::zeros();
        let ray = Sight([0.0; 2]).evaluate(&[x[0], x[1], x[2]], Some(&mut plain))?;
        if let Some(jacobian) = jacobian {
            (0..3).for_each(|block| jacobian.0[block] = plain.0[block] * scale);
            jacobian.set(3, 0, &ray);
            jacobian.set(3, 1, &SMatrix::<f64, 2, 2>::identity());
        }
        Some(ray * scale + shift - SVector::from(self.0))
    }
}

/// Difference of a pose from a given one.
struct Near(crate::geometry::Pose);

impl Residual<6, 1> for Near {
    const MANIFOLDS: [Manifold; 1] = [Manifold::Pose];
    fn evaluate(&self, x: &[&[f64]; 1], jacobian: Option<&mut Jacobian<6, 1>>) -> Option<SVector<f64, 6>> {
        let pose = read_pose(x[0]);
        if let Some(jacobian) = jacobian {
            jacobian.set(0, 0, &pose_minus_jacobian(&pose, &self.0));
        }
        Some(pose_minus(&pose, &self.0))
    }
}

/// Seven moments of two bodies under one observer; a body is not there at two of them, a point is held in
/// part and another whole; observers and bodies move smoothly, and see static points and a scalar.
fn film(frames: Option<Arrangement>, held_observers: bool, loss: Loss) -> System {
    film_through(Lens::None, frames, held_observers, loss)
}

/// A lens that all moments of a film share.
#[derive(Clone, Copy, PartialEq)]
enum Lens {
    None,
    /// One component of it is held. It is eliminated like any other block.
    Plain,
    /// It is eliminated last.
    Shared,
}

fn film_through(lens: Lens, frames: Option<Arrangement>, held_observers: bool, loss: Loss) -> System {
    let mut builder = SystemBuilder::default();
    let wave = |k: f64| Vector3::new((1.3 * k).sin(), (2.1 * k).cos(), (0.7 * k + 1.0).sin());
    let near = |k: f64, z: f64| {
        crate::geometry::Pose::from_parts(
            (wave(k) * 0.3 + Vector3::z() * z).into(),
            exp(&(wave(k + 3.0) * 0.2)),
        )
    };
    let moments = 7;
    let observers: Vec<BlockId> = (0..moments)
        .map(|t| {
            let start = write_pose(&near(f64::from(t), -10.0));
            builder.add_block(Manifold::Pose, &start, &[!held_observers; 6])
        })
        .collect();
    let bodies: Vec<Vec<BlockId>> = (0..2)
        .map(|b| {
            let pose = |t: i32| write_pose(&near(20.0 + f64::from(10 * b + t), 0.0));
            (0..moments).map(|t| builder.add_block(Manifold::Pose, &pose(t), &[true; 6])).collect()
        })
        .collect();
    let is_there = |b: usize, t: usize| b == 0 || !(2..4).contains(&t);
    let mut add = |k: f64, free: [bool; 3]| builder.add_block(Manifold::POINT, wave(k).as_slice(), &free);
    let points: Vec<Vec<BlockId>> = (0..2)
        .map(|b| {
            let free = |i: i32| match i {
                1 => [true, false, true],
                2 => [false; 3],
                _ => [true; 3],
            };
            (0..6).map(|i| add(f64::from(50 + 10 * b + i), free(i))).collect()
        })
        .collect();
    let statics: Vec<BlockId> = (0..4).map(|i| add(80.0 + f64::from(i), [true; 3])).collect();
    let scalar = builder.add_block(Manifold::SCALAR, &[0.2], &[true]);
    let shared = builder.add_block(Manifold::Vector(3), &[0.1, -0.02, 0.01], &[true, false, true]);

    let mut seen = Vec::new();
    for t in 0..moments as usize {
        for b in (0..2).filter(|b| is_there(*b, t)) {
            for (i, point) in points[b].iter().enumerate().filter(|(i, _)| (i + t) % 4 != 0) {
                let pixel = wave((t * 20 + b * 9 + i) as f64) * if i == 5 { 0.5 } else { 0.05 };
                let blocks = [observers[t], bodies[b][t], *point];
                seen.push(Measurement { residual: Sight([pixel.x, pixel.y]), blocks, sigma: [0.01, 0.02] });
            }
        }
    }
    let sights = if lens == Lens::None {
        builder.add_group("sights", loss, seen)
    } else {
        let through =
            seen.into_iter().map(|Measurement { residual: Sight(seen), blocks: [o, b, p], sigma }| {
                Measurement { residual: LensSight(seen), blocks: [o, b, p, shared], sigma }
            });
        let sights = builder.add_group("sights", loss, through.collect());
        let known = Measurement { residual: Calibrated, blocks: [shared], sigma: [0.3] };
        builder.add_group("calibration", Loss::Squared, vec![known]);
        if lens == Lens::Shared {
            builder.share(vec![shared]);
        }
        sights
    };
    let mut between = Vec::new();
    let chains = [&observers, &bodies[0], &bodies[1]];
    for (c, chain) in chains.into_iter().enumerate() {
        let there: Vec<usize> = (0..moments as usize).filter(|t| c < 2 || is_there(1, *t)).collect();
        for pair in there.windows(2) {
            between.push(Measurement {
                residual: Between(pose([0.1, 0.0, 0.1], [1.0, 0.0, 0.0, 0.0])),
                blocks: [chain[pair[1]], chain[pair[0]]],
                sigma: [0.3, 0.3, 0.3, 0.1, 0.1, 0.1],
            });
        }
    }
    builder.add_group("motion", Loss::Squared, between);
    let known = chains.into_iter().flatten().map(|pose| Measurement {
        residual: Near(near(1.0, 0.0)),
        blocks: [*pose],
        sigma: [3.0, 3.0, 3.0, 1.0, 1.0, 1.0],
    });
    builder.add_group("poses", Loss::Squared, known.collect());
    let place = (0..moments as usize).flat_map(|t| {
        let statics = statics.iter().enumerate().filter(move |(i, _)| (i + t) % 3 != 0);
        statics.map(move |(i, point)| (t, i, *point))
    });
    let place = place.map(|(t, i, point)| Measurement {
        residual: Seen(wave((t + 5 * i) as f64)),
        blocks: [observers[t], point],
        sigma: [0.2; 3],
    });
    builder.add_group("static points", Loss::Squared, place.collect());
    let level = points.iter().flatten().enumerate().map(|(k, point)| Measurement {
        residual: Level(k % 3),
        blocks: [*point, scalar],
        sigma: [0.5],
    });
    builder.add_group("level", Loss::Squared, level.collect());
    if let Some(arrangement) = frames {
        builder.arrange(arrangement);
        let step =
            |t: usize| TimeStep { observer: Some(observers[t]), bodies: vec![bodies[0][t], bodies[1][t]] };
        builder.along_time((0..moments as usize).map(step).collect(), vec![sights]);
    }
    builder.build()
}

/// The last number of a lens is known.
struct Calibrated;

impl Residual<1, 1> for Calibrated {
    const MANIFOLDS: [Manifold; 1] = [Manifold::Vector(3)];
    fn evaluate(&self, x: &[&[f64]; 1], jacobian: Option<&mut Jacobian<1, 1>>) -> Option<SVector<f64, 1>> {
        if let Some(jacobian) = jacobian {
            jacobian.set(0, 2, &SVector::<f64, 1>::new(1.0));
        }
        Some(SVector::<f64, 1>::new(x[0][2]))
    }
}

#[test]
fn what_all_moments_share_changes_no_step() {
    for frames in [None, Some(Arrangement::Together), Some(Arrangement::Apart)] {
        for held_observers in [false, true] {
            for loss in [Loss::Squared, Loss::Huber { scale: 3.0 }, Loss::Tukey { scale: 200.0 }] {
                let whole = film_through(Lens::Plain, None, held_observers, loss);
                let shared = film_through(Lens::Shared, frames, held_observers, loss);
                assert_eq!(shared.has_frames(), frames.is_some());
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
                        found.extend_from_slice(shared.step_of(BlockId(block), &step.delta));
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
            let whole = film_through(Lens::Plain, None, false, loss);
            let shared = film_through(Lens::Shared, frames, false, loss);
            let (worst, count) = worst_block(&shared, &whole);
            assert!(worst < 1e-10, "{frames:?} {loss:?}: {worst:e}");
            assert!(count > 200, "{count}");
        }
    }
}

#[test]
fn frames_first_changes_no_step() {
    for (arrangement, rule) in
        [(Arrangement::Together, Rule::FramesFirst), (Arrangement::Apart, Rule::BodiesApart)]
    {
        assert_frames_change_no_step(arrangement, rule);
    }
}

fn assert_frames_change_no_step(arrangement: Arrangement, rule: Rule) {
    for held_observers in [false, true] {
        for loss in [Loss::Squared, Loss::Huber { scale: 3.0 }, Loss::Tukey { scale: 200.0 }] {
            let whole = film(None, held_observers, loss);
            let framed = film(Some(arrangement), held_observers, loss);
            assert!(framed.has_frames() && !whole.has_frames());
            assert_eq!(framed.elimination().0, rule);
            for (damping, least_flatness) in [(0.0, 1.0), (1e-4, 1.0), (1.0, 1.0), (1e-3, 0.1)] {
                let curvature = Curvature { damping, least_flatness };
                let (wanted, model) = step_of(&whole, curvature);

                let mut normal = framed.normal();
                framed.linearise(framed.start(), curvature, &mut normal).unwrap();
                let mut factor = framed.frames_factor().unwrap();
                let extra: Vec<f64> = normal.scale().iter().map(|d| d * damping).collect();
                framed.factorise_frames(&normal, &extra, &mut factor).unwrap();
                let mut delta: Vec<f64> = normal.raw_gradient().iter().map(|g| -g).collect();
                // Two right-hand sides at once.
                delta.extend(delta.clone().iter().map(|d| 2.0 * d));
                framed.solve_frames(&normal, &mut factor, Accuracy::Exact, &mut delta);
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
                        found.extend_from_slice(framed.step_of(BlockId(block), &step.delta));
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
            let whole = film(None, held_observers, loss);
            let film = film(Some(Arrangement::Together), held_observers, loss);
            let frames = film.frames.as_ref().unwrap();
            let mut factor = TogetherFactor::new(frames).unwrap();
            let mut normal = film.normal();
            // Once for a damping that is another, then as it should be; and given up after one product.
            for (earlier, damping, most, comes_to_its_end) in
                [(1.0, 1e-4, 200, true), (1e-2, 0.0, 200, true), (1.0, 1e-4, 1, false)]
            {
                let curvature = Curvature { damping, least_flatness: 1.0 };
                film.linearise(film.start(), curvature, &mut normal).unwrap();
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
                    .flat_map(|block| film.step_of(BlockId(block), &delta).to_vec())
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
            let system = film(Some(Arrangement::Apart), false, Loss::Huber { scale: 3.0 });
            let mut normal = system.normal();
            system.linearise(system.start(), Curvature::PLAIN, &mut normal).unwrap();
            let mut factor = system.frames_factor().unwrap();
            let extra = vec![0.0; system.pattern().size()];
            system.factorise_frames(&normal, &extra, &mut factor).unwrap();
            let mut step = normal.raw_gradient().to_vec();
            system.solve_frames(&normal, &mut factor, Accuracy::Exact, &mut step);
            step.iter().map(|s| s.to_bits()).collect::<Vec<_>>()
        })
    };
    assert_eq!(bits(1), bits(2));
    assert_eq!(bits(1), bits(5));
}

#[test]
fn poses_that_are_held_in_part_are_not_eliminated_by_frames() {
    let mut builder = SystemBuilder::default();
    let pose = write_pose(&crate::geometry::Pose::identity());
    let mut free = [true; 6];
    let observer = builder.add_block(Manifold::Pose, &pose, &free);
    free[2] = false;
    let body = builder.add_block(Manifold::Pose, &pose, &free);
    let point = builder.add_block(Manifold::POINT, &[0.0, 0.0, 5.0], &[true; 3]);
    let sight = Measurement { residual: Sight([0.0; 2]), blocks: [observer, body, point], sigma: [1.0; 2] };
    let sights = builder.add_group("sights", Loss::Squared, vec![sight]);
    builder.along_time(vec![TimeStep { observer: Some(observer), bodies: vec![body] }], vec![sights]);
    assert!(!builder.build().has_frames());
}

/// The largest gap between blocks of the covariance and those of the dense inverse, relative to the standard
/// deviations of their rows and columns, and how many were compared.
fn worst_block(film: &System, whole: &System) -> (f64, usize) {
    let normal = linearised(whole);
    let mut inverse = dense(&normal.matrix).cholesky().unwrap().inverse();
    for block in 0..whole.blocks.len() {
        let Some(range) = whole.range_of(BlockId(block)) else { continue };
        for (at, _) in range.zip(whole.free(BlockId(block))).filter(|(_, free)| !**free) {
            inverse[(at, at)] = 0.0;
        }
    }
    let mut of_film = linearised(film);
    let mut factors = Factors::new(film).unwrap();
    factors.factorise(film, &mut of_film, &vec![0.0; film.size()]).unwrap();
    let selected = SelectedInverse::new(film, film.start(), &of_film, &mut factors).unwrap();
    let (mut worst, mut count) = (0.0_f64, 0);
    for a in (0..film.blocks.len()).map(BlockId) {
        for b in (0..film.blocks.len()).map(BlockId) {
            let Some(found) = selected.block(film, a, b) else { continue };
            let (of_a, of_b) = (whole.range_of(a).unwrap(), whole.range_of(b).unwrap());
            for (i, row) in of_a.enumerate() {
                for (j, column) in of_b.clone().enumerate() {
                    let scale = (inverse[(row, row)] * inverse[(column, column)]).sqrt();
                    let gap = (found[(i, j)] - inverse[(row, column)]).abs();
                    worst = worst.max(if scale > 0.0 { gap / scale } else { gap * 1e12 });
                }
            }
            count += 1;
        }
    }
    // Leverages are those of dense Jacobians.
    for (index, group) in film.groups.iter().enumerate() {
        let (rows, wanted) = (group.rows(), linearised_group(whole, &normal, index));
        let found = selected.leverages(GroupId(index));
        assert_eq!(found.len(), group.len() * rows * rows);
        for (item, found) in found.chunks_exact(rows * rows).enumerate() {
            let rows_of = wanted.rows(item * rows, rows);
            let wanted = rows_of * &inverse * rows_of.transpose();
            for (found, wanted) in found.iter().zip(wanted.as_slice()) {
                worst = worst.max((found - wanted).abs());
            }
        }
    }
    (worst, count)
}

/// The Jacobian of a group, dense, from products with unit vectors.
fn linearised_group(system: &System, normal: &Normal, group: usize) -> DMatrix<f64> {
    let n = normal.matrix.size();
    let mut jacobian = DMatrix::zeros(system.rows(GroupId(group)), n);
    for column in 0..n {
        let mut unit = vec![0.0; n];
        unit[column] = 1.0;
        jacobian.column_mut(column).copy_from_slice(&system.product(GroupId(group), system.start(), &unit));
    }
    jacobian
}

#[test]
fn selected_blocks_and_leverages_are_those_of_the_dense_inverse() {
    for held_observers in [false, true] {
        for loss in [Loss::Squared, Loss::Huber { scale: 3.0 }, Loss::Tukey { scale: 200.0 }] {
            let whole = film(None, held_observers, loss);
            let film = film(Some(Arrangement::Together), held_observers, loss);
            let (worst, count) = worst_block(&film, &whole);
            assert!(worst < 1e-10, "{held_observers} {loss:?}: {worst:e}");
            assert!(count > 200, "{count}");
            let (worst, _) = worst_block(&whole, &whole);
            assert!(worst < 1e-10, "{held_observers} {loss:?}: {worst:e}");
        }
    }
}

#[test]
fn normal_matrices_of_single_blocks_are_those_on_the_diagonal() {
    let whole = film(None, false, Loss::Huber { scale: 3.0 });
    let dense = dense(&linearised(&whole).matrix);
    let film = film(Some(Arrangement::Together), false, Loss::Huber { scale: 3.0 });
    let blocks: Vec<BlockId> =
        (0..whole.blocks.len()).map(BlockId).filter(|b| whole.range_of(*b).is_some()).collect();
    let normals = film.own_normals(film.start());
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
    let system = film_through(Lens::Shared, None, false, Loss::Huber { scale: 3.0 });
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
