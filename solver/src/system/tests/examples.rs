//! Small systems of every kind, and what they are in dense algebra.

use super::residuals::{Between, Calibrated, Image, LensSight, Level, Near, Seen, Sight};
use crate::geometry::{Pose, pose as given_pose, rotation::exp};
use crate::linear::cholesky::Cholesky;
use crate::linear::matrix::BlockMatrix;
use crate::loss::Loss;
use crate::manifold::{Manifold, write_pose};
use crate::system::{
    Arrangement, BlockId, Curvature, Factors, GroupId, Measurement, Normal, SelectedInverse, System,
    SystemBuilder, TimeStep,
};
use nalgebra::{DMatrix, DVector, Vector3};

/// Six poses in a chain, ten points, one scalar; one pose and one point are held in part, one point
/// whole; some measurements are gross.
pub(super) fn example(loss: Loss) -> System {
    example_with(loss, false, &[])
}

/// The same, with a point at an impossible place, and with leaves. Blocks 0 to 5 are poses, 6 to 15
/// points, 16 the scalar.
pub(super) fn example_with(loss: Loss, impossible: bool, leaves: &[usize]) -> System {
    let mut builder = SystemBuilder::default();
    let wave = |k: f64| Vector3::new((1.3 * k).sin(), (2.1 * k).cos(), (0.7 * k + 1.0).sin());
    let poses: Vec<BlockId> = (0..6)
        .map(|i| {
            let value = Pose::from_parts((wave(f64::from(i)) * 3.0).into(), exp(&wave(9.0 + f64::from(i))));
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
        residual: Between(given_pose([0.5, 0.1, -0.2], [0.9, 0.1, 0.2, 0.3])),
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

pub(super) fn dense(matrix: &BlockMatrix) -> DMatrix<f64> {
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

pub(super) fn linearised(system: &System) -> Normal {
    let mut normal = system.normal();
    system.linearise(system.start(), Curvature::PLAIN, &mut normal).unwrap();
    normal
}

/// The damped step of every block, and what the model says of it.
pub(super) fn step_of(system: &System, curvature: Curvature) -> (Vec<Vec<f64>>, [f64; 3]) {
    let mut normal = system.normal();
    let values = system.start();
    system.linearise(values, curvature, &mut normal).unwrap();
    let extra: Vec<f64> = normal.scale().iter().map(|d| d * curvature.damping).collect();
    normal.matrix.add_to_diagonal(&extra);
    let mut cholesky = Cholesky::analyse(&system.pattern).unwrap();
    cholesky.factorise(&normal.matrix).unwrap();
    let mut others: Vec<f64> = normal.gradient.iter().map(|g| -g).collect();
    cholesky.solve(&mut others);
    let largest = normal.largest_gradient();
    let step = system.back_substitute(values, curvature, &mut normal, others);
    let of = |block: usize| match system.layout.step_start[block] {
        Some(_) => system.layout.step_of(BlockId(block), &step.delta).to_vec(),
        None => Vec::new(),
    };
    ((0..system.layout.blocks.len()).map(of).collect(), [step.slope, step.squared, largest])
}

/// Four cameras above twenty points, one camera held; a point may be seen twice in an image.
pub(super) fn images<const N: usize>(leaves: bool) -> System {
    // Of each point two images in the same camera.
    let camera = |k: usize| if k >= 100 { 0 } else { (k / 20 + k) % 4 };
    images_by::<N>(4, (0..110).map(|k| (camera(k), k % 20)), leaves)
}

/// The same by twelve cameras: many that are neighbours see a point, some of them twice, or one that is no
/// neighbour sees it too, or the one that is held.
pub(super) fn images_in_a_row<const N: usize>(leaves: bool) -> System {
    let of_point = |i: usize| -> Vec<(usize, usize)> {
        let others: &[usize] = [&[] as &[usize], &[7], &[11], &[2], &[7, 7, 11]][i % 5];
        (3..10 + i % 2).chain(others.iter().copied()).map(|camera| (camera, i)).collect()
    };
    images_by::<N>(12, (0..20).flat_map(of_point), leaves)
}

pub(super) fn images_by<const N: usize>(
    count: usize,
    seen: impl Iterator<Item = (usize, usize)>,
    leaves: bool,
) -> System {
    let mut builder = SystemBuilder::default();
    let wave = |k: f64| Vector3::new((1.3 * k).sin(), (2.1 * k).cos(), (0.7 * k + 1.0).sin());
    let cameras: Vec<BlockId> = (0..count as u32)
        .map(|i| {
            let place = wave(f64::from(i)) + Vector3::new(0.0, 0.0, -9.0);
            let pose = Pose::from_parts(place.into(), exp(&(wave(5.0 + f64::from(i)) * 0.1)));
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

/// Points and poses of one body with all components free.
pub(super) fn body() -> (System, Vec<BlockId>, Vec<BlockId>) {
    let mut builder = SystemBuilder::default();
    let wave = |k: f64| Vector3::new((1.3 * k).sin(), (2.1 * k).cos(), (0.7 * k + 1.0).sin());
    let poses: Vec<BlockId> = (0..4)
        .map(|i| {
            let value = Pose::from_parts((wave(f64::from(i)) * 3.0).into(), exp(&wave(9.0 + f64::from(i))));
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

/// Seven moments of two bodies under one observer; a body is not there at two of them, a point is held in
/// part and another whole; observers and bodies move smoothly, and see static points and a scalar.
pub(super) fn drive(frames: Option<Arrangement>, held_observers: bool, loss: Loss) -> System {
    drive_through(Lens::None, frames, held_observers, loss)
}

/// A lens that all moments of a drive share.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Lens {
    None,
    /// One component of it is held. It is eliminated like any other block.
    Plain,
    /// It is eliminated last.
    Shared,
}

pub(super) fn drive_through(
    lens: Lens,
    frames: Option<Arrangement>,
    held_observers: bool,
    loss: Loss,
) -> System {
    let mut builder = SystemBuilder::default();
    let wave = |k: f64| Vector3::new((1.3 * k).sin(), (2.1 * k).cos(), (0.7 * k + 1.0).sin());
    let near = |k: f64, z: f64| {
        Pose::from_parts((wave(k) * 0.3 + Vector3::z() * z).into(), exp(&(wave(k + 3.0) * 0.2)))
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
                residual: Between(given_pose([0.1, 0.0, 0.1], [1.0, 0.0, 0.0, 0.0])),
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

/// The largest gap between blocks of the covariance and those of the dense inverse, relative to the standard
/// deviations of their rows and columns, and how many were compared.
pub(super) fn worst_block(drive: &System, whole: &System) -> (f64, usize) {
    let normal = linearised(whole);
    let mut inverse = dense(&normal.matrix).cholesky().unwrap().inverse();
    for block in 0..whole.layout.blocks.len() {
        let Some(range) = whole.range_of(BlockId(block)) else { continue };
        for (at, _) in range.zip(whole.free(BlockId(block))).filter(|(_, free)| !**free) {
            inverse[(at, at)] = 0.0;
        }
    }
    let mut of_drive = linearised(drive);
    let mut factors = Factors::new(drive).unwrap();
    factors.factorise(drive, &mut of_drive, &vec![0.0; drive.size()]).unwrap();
    let selected = SelectedInverse::new(drive, drive.start(), &of_drive, &mut factors).unwrap();
    let (mut worst, mut count) = (0.0_f64, 0);
    for a in (0..drive.layout.blocks.len()).map(BlockId) {
        for b in (0..drive.layout.blocks.len()).map(BlockId) {
            let Some(found) = selected.block(drive, a, b) else { continue };
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
    for (index, group) in drive.groups.iter().enumerate() {
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
pub(super) fn linearised_group(system: &System, normal: &Normal, group: usize) -> DMatrix<f64> {
    let n = normal.matrix.size();
    let mut jacobian = DMatrix::zeros(system.rows(GroupId(group)), n);
    for column in 0..n {
        let mut unit = vec![0.0; n];
        unit[column] = 1.0;
        jacobian.column_mut(column).copy_from_slice(&system.product(GroupId(group), system.start(), &unit));
    }
    jacobian
}
