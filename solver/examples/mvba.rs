//! Adjusts a moving vehicle under one camera, from a file in the format "mvba 1" (benches/peers/gen_mv.py).
//!
//! Camera pose and vehicle pose of each frame, and the shape: image points, a prior on every pose, and a
//! prior on the motion of the vehicle from frame to frame. Costs are half the sum of squares (of rho for
//! image points), term by term those of benches/peers/ceres_mv.cc.
//!
//! `cargo run --release -p trackbundle-solver --example mvba -- FILE [--elimination frames] [--json]`

use clap::{Parser, ValueEnum};
use nalgebra::{Matrix2x3, Matrix3, Point3, Rotation3, UnitQuaternion, Vector2, Vector3, Vector6};
use std::error::Error;
use std::fmt::Write;
use std::path::PathBuf;
use std::sync::Arc;
use trackbundle_solver::geometry::rotation::{log, right_jacobian_inverse};
use trackbundle_solver::geometry::{Pose, pose, skew};
use trackbundle_solver::loss::{DEFAULT_SHAPE, LossName};
use trackbundle_solver::manifold::{pose_minus, pose_minus_jacobian, read_point, read_pose, write_pose};
use trackbundle_solver::{
    BlockId, Jacobian, Loss, Manifold, Measurement, Residual, System, SystemBuilder, TimeStep, Values,
};

#[path = "support/run.rs"]
mod run;

/// Adjusts a moving vehicle under one camera.
#[derive(Parser)]
struct Arguments {
    /// The problem, "mvba 1"
    file: PathBuf,
    /// Loss of the image points, in pixels: none, huber, cauchy, tukey, geman-mcclure or barron
    #[arg(long, default_value_t = LossName::Huber)]
    loss: LossName,
    /// Scale of the loss in pixels
    #[arg(long, default_value_t = 2.0)]
    loss_scale: f64,
    /// What is eliminated first
    #[arg(long, value_enum, default_value_t = Elimination::Auto)]
    elimination: Elimination,
    #[command(flatten)]
    run: run::Options,
}

#[derive(Clone, Copy, Debug, PartialEq, ValueEnum)]
enum Elimination {
    /// What takes fewer operations
    Auto,
    /// Poses along time, which leaves the shape
    Frames,
    /// Points, which leaves the poses
    Points,
}

/// Points nearer to the camera's plane than this are not seen \[m\].
const LEAST_DEPTH_M: f64 = 1e-3;

/// A camera without distortion that looks along z, x to the right, y down.
#[derive(Clone, Debug)]
struct Pinhole {
    focal_px: f64,
    principal_px: Vector2<f64>,
}

impl Pinhole {
    /// The pixel of a point in the camera frame \[m\], and its derivative by the point, 2 x 3 \[px/m\]; `None`
    /// behind the camera.
    fn project(&self, point: &Vector3<f64>) -> Option<(Vector2<f64>, Matrix2x3<f64>)> {
        if point.z <= LEAST_DEPTH_M {
            return None;
        }
        let ray = point.xy() / point.z;
        let inverse_depth = 1.0 / point.z;
        #[rustfmt::skip]
        let ray_by_point = Matrix2x3::new(
            inverse_depth, 0.0, -ray.x * inverse_depth,
            0.0, inverse_depth, -ray.y * inverse_depth,
        );
        Some((self.focal_px * ray + self.principal_px, self.focal_px * ray_by_point))
    }
}

/// Image point of a point of the vehicle, observed minus computed \[px\]. Blocks: camera pose, vehicle pose, point
/// in the vehicle frame.
///
/// ```text
/// X = Rc^T (Rv M + tv - tc)          the point in the camera frame
/// r = (u, v) - project(X)
///
/// dr/dM  = -P Rc^T Rv                P = d project / dX, 2 x 3
/// dr/dtv = -P Rc^T                   dr/drv =  P Rc^T Rv [M]x
/// dr/dtc =  P Rc^T                   dr/drc = -P [X]x
/// ```
struct ImagePoint {
    camera: Arc<Pinhole>,
    observed_px: Vector2<f64>,
}

impl Residual<2, 3> for ImagePoint {
    const MANIFOLDS: [Manifold; 3] = [Manifold::Pose, Manifold::Pose, Manifold::POINT];

    #[inline(always)]
    fn evaluate(&self, x: &[&[f64]; 3], jacobian: Option<&mut Jacobian<2, 3>>) -> Option<Vector2<f64>> {
        let (world_from_camera, world_from_vehicle) = (read_pose(x[0]), read_pose(x[1]));
        let in_vehicle = read_point(x[2]);
        let in_world = world_from_vehicle * in_vehicle;
        let in_camera = world_from_camera.inverse_transform_point(&in_world).coords;
        let (computed_px, by_camera_point) = self.camera.project(&in_camera)?;
        if let Some(jacobian) = jacobian {
            let camera_from_world = world_from_camera.rotation.inverse().to_rotation_matrix();
            let by_world: Matrix2x3<f64> = by_camera_point * camera_from_world.matrix();
            let by_point = by_world * world_from_vehicle.rotation.to_rotation_matrix().matrix();
            jacobian.set(0, 0, &by_world);
            jacobian.set(0, 3, &-(by_camera_point * skew(&in_camera)));
            jacobian.set(1, 0, &-by_world);
            jacobian.set(1, 3, &(by_point * skew(&in_vehicle.coords)));
            jacobian.set(2, 0, &-by_point);
        }
        Some(self.observed_px - computed_px)
    }
}

/// A pose against the one it started with \[m, rad\]: `[ t - t0 ; log(R0^T R) ]`.
struct PosePrior {
    start: Pose,
}

impl Residual<6, 1> for PosePrior {
    const MANIFOLDS: [Manifold; 1] = [Manifold::Pose];

    fn evaluate(&self, x: &[&[f64]; 1], jacobian: Option<&mut Jacobian<6, 1>>) -> Option<Vector6<f64>> {
        let pose = read_pose(x[0]);
        if let Some(jacobian) = jacobian {
            jacobian.set(0, 0, &pose_minus_jacobian(&pose, &self.start));
        }
        Some(pose_minus(&pose, &self.start))
    }
}

/// Motion of a body from one frame to the next, in its own frame, against a mean \[m, rad\]:
/// `[ Ra^T (tb - ta) - mt ; log(Ra^T Rb) - mr ]`.
struct Motion {
    mean: Vector6<f64>,
}

impl Residual<6, 2> for Motion {
    const MANIFOLDS: [Manifold; 2] = [Manifold::Pose; 2];

    fn evaluate(&self, x: &[&[f64]; 2], jacobian: Option<&mut Jacobian<6, 2>>) -> Option<Vector6<f64>> {
        let [a, b] = x.map(read_pose);
        let to_a: Matrix3<f64> = a.rotation.to_rotation_matrix().matrix().transpose();
        let moved = to_a * (b.translation.vector - a.translation.vector);
        let turned = log(&(a.rotation.inverse() * b.rotation));
        if let Some(jacobian) = jacobian {
            let by_turn = right_jacobian_inverse(&turned);
            let mut of_a = nalgebra::Matrix6::zeros();
            of_a.fixed_view_mut::<3, 3>(0, 0).copy_from(&-to_a);
            of_a.fixed_view_mut::<3, 3>(0, 3).copy_from(&skew(&moved));
            of_a.fixed_view_mut::<3, 3>(3, 3).copy_from(&-by_turn.transpose());
            let mut of_b = nalgebra::Matrix6::zeros();
            of_b.fixed_view_mut::<3, 3>(0, 0).copy_from(&to_a);
            of_b.fixed_view_mut::<3, 3>(3, 3).copy_from(&by_turn);
            jacobian.set(0, 0, &of_a);
            jacobian.set(1, 0, &of_b);
        }
        let mut value = Vector6::zeros();
        value.fixed_rows_mut::<3>(0).copy_from(&moved);
        value.fixed_rows_mut::<3>(3).copy_from(&turned);
        Some(value - self.mean)
    }
}

/// A problem as its file has it.
struct Problem {
    camera: Arc<Pinhole>,
    /// Standard deviations, position and rotation: camera, vehicle, motion \[m, rad\].
    sigmas: [[f64; 2]; 3],
    mean_motion: Vector6<f64>,
    cameras: Vec<Pose>,
    vehicles: Vec<Pose>,
    points: Vec<Point3<f64>>,
    observations: Vec<(usize, usize, Vector2<f64>)>,
    true_points: Vec<Point3<f64>>,
}

impl Problem {
    fn read(text: &str) -> Result<Problem, Box<dyn Error>> {
        let mut words = run::Words::new(text);
        if words.next::<String>()? != "mvba" || words.next::<usize>()? != 1 {
            return Err("the file does not begin with \"mvba 1\"".into());
        }
        let (frames, points): (usize, usize) = (words.next()?, words.next()?);
        let count: usize = words.next()?;
        let [f, cx, cy] = words.array()?;
        let camera = Pinhole { focal_px: f, principal_px: Vector2::new(cx, cy) };
        let [ct, cr, vt, vr, mt, mr] = words.array()?;
        let [rx, ry, rz, tx, ty, tz] = words.array()?;
        let read_poses = |words: &mut run::Words, n: usize| -> Result<Vec<Pose>, Box<dyn Error>> {
            let one = |_| {
                let [w, i, j, k, x, y, z] = words.array()?;
                Ok(pose([x, y, z], [w, i, j, k]))
            };
            (0..n).map(one).collect()
        };
        let read_points = |words: &mut run::Words, n: usize| -> Result<Vec<Point3<f64>>, Box<dyn Error>> {
            (0..n).map(|_| Ok(Point3::from(words.array::<3>()?))).collect()
        };
        let cameras = read_poses(&mut words, frames)?;
        let vehicles = read_poses(&mut words, frames)?;
        let start = read_points(&mut words, points)?;
        let mut observations = Vec::with_capacity(count.min(text.len()));
        for _ in 0..count {
            let (frame, point): (usize, usize) = (words.next()?, words.next()?);
            if frame >= frames || point >= points {
                return Err(format!("there is no frame {frame} or no point {point}").into());
            }
            observations.push((frame, point, Vector2::new(words.next()?, words.next()?)));
        }
        read_poses(&mut words, 2 * frames)?;
        let true_points = read_points(&mut words, points)?;
        Ok(Problem {
            camera: Arc::new(camera),
            sigmas: [[ct, cr], [vt, vr], [mt, mr]],
            mean_motion: Vector6::new(tx, ty, tz, rx, ry, rz),
            cameras,
            vehicles,
            points: start,
            observations,
            true_points,
        })
    }

    /// The system with the image points, which are no longer needed afterwards.
    fn system(&mut self, arguments: &Arguments) -> (System, [Vec<BlockId>; 3]) {
        let observations = std::mem::take(&mut self.observations);
        let mut builder = SystemBuilder::default();
        let mut add = |poses: &[Pose]| -> Vec<BlockId> {
            poses.iter().map(|p| builder.add_block(Manifold::Pose, &write_pose(p), &[true; 6])).collect()
        };
        let (cameras, vehicles) = (add(&self.cameras), add(&self.vehicles));
        let points: Vec<BlockId> = self
            .points
            .iter()
            .map(|p| builder.add_block(Manifold::POINT, p.coords.as_slice(), &[true; 3]))
            .collect();
        let image = |(frame, point, pixel): (usize, usize, Vector2<f64>)| Measurement {
            residual: ImagePoint { camera: self.camera.clone(), observed_px: pixel },
            blocks: [cameras[frame], vehicles[frame], points[point]],
            sigma: [1.0; 2],
        };
        let loss = arguments.loss.with_scale(arguments.loss_scale, DEFAULT_SHAPE);
        let images = builder.add_group("image points", loss, observations.into_iter().map(image).collect());
        let sigma = |[t, r]: [f64; 2]| [t, t, t, r, r, r];
        for (poses, blocks, sigmas) in
            [(&self.cameras, &cameras, self.sigmas[0]), (&self.vehicles, &vehicles, self.sigmas[1])]
        {
            let prior = |(start, block): (&Pose, &BlockId)| Measurement {
                residual: PosePrior { start: *start },
                blocks: [*block],
                sigma: sigma(sigmas),
            };
            builder.add_group("poses", Loss::Squared, poses.iter().zip(blocks).map(prior).collect());
        }
        let motion = vehicles.windows(2).map(|pair| Measurement {
            residual: Motion { mean: self.mean_motion },
            blocks: [pair[0], pair[1]],
            sigma: sigma(self.sigmas[2]),
        });
        builder.add_group("motion", Loss::Squared, motion.collect());
        // Of shape by innovations of the frames, and of poses by points.
        let (shape, poses) = (3.0 * points.len() as f64, 12.0 * cameras.len() as f64);
        let frames_flops = 0.5 * poses * shape * shape + shape.powi(3) / 3.0;
        let points_first = match arguments.elimination {
            Elimination::Frames => false,
            Elimination::Points => true,
            Elimination::Auto => poses.powi(3) / 3.0 < frames_flops,
        };
        if points_first {
            builder.eliminate(points.clone());
        } else {
            let step = |(camera, vehicle): (&BlockId, &BlockId)| TimeStep {
                observer: Some(*camera),
                bodies: vec![*vehicle],
            };
            builder.along_time(cameras.iter().zip(&vehicles).map(step).collect(), vec![images]);
        }
        (builder.build(), [cameras, vehicles, points])
    }

    /// Root mean square distance of the points to the true ones after a rigid fit \[m\].
    fn shape_rms_m(&self, points: &[Point3<f64>]) -> f64 {
        let Some(fit) = rigid_fit(points, &self.true_points) else { return f64::NAN };
        let squares = points.iter().zip(&self.true_points).map(|(p, q)| (fit * p - q).norm_squared());
        (squares.sum::<f64>() / points.len() as f64).sqrt()
    }
}

/// The rigid motion with the least sum of squared distances between pairs of points; `None` where they do not
/// determine it. Source: Umeyama, IEEE PAMI 13 (1991), without his scale.
fn rigid_fit(from: &[Point3<f64>], to: &[Point3<f64>]) -> Option<Pose> {
    let centroid =
        |points: &[Point3<f64>]| points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / points.len() as f64;
    let (from_mean, to_mean) = (centroid(from), centroid(to));
    let covariance: Matrix3<f64> =
        from.iter().zip(to).map(|(a, b)| (b.coords - to_mean) * (a.coords - from_mean).transpose()).sum();
    if !covariance.iter().all(|value| value.is_finite()) {
        return None;
    }
    let svd = covariance.svd(true, true);
    let (u, v_t) = (svd.u?, svd.v_t?);
    // Singular values come largest first; the last takes the sign that keeps the handedness.
    if svd.singular_values[1] <= 1e-12 * svd.singular_values[0] {
        return None;
    }
    let signs = Vector3::new(1.0, 1.0, (u.determinant() * v_t.determinant()).signum());
    let turn = Rotation3::from_matrix_unchecked(u * Matrix3::from_diagonal(&signs) * v_t);
    let rotation = UnitQuaternion::from_rotation_matrix(&turn);
    Some(Pose::from_parts((to_mean - rotation * from_mean).into(), rotation))
}

/// Poses and points as lines of numbers, in the order of the problem's file.
fn solved(system: &System, values: &Values, blocks: &[Vec<BlockId>; 3]) -> String {
    let mut text = String::new();
    for poses in &blocks[..2] {
        for block in poses {
            let v = system.value(values, *block);
            let _ = writeln!(text, "{} {} {} {} {} {} {}", v[3], v[4], v[5], v[6], v[0], v[1], v[2]);
        }
    }
    for block in &blocks[2] {
        let v = Vector3::from_column_slice(system.value(values, *block));
        let _ = writeln!(text, "{} {} {}", v.x, v.y, v.z);
    }
    text
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments = Arguments::parse();
    arguments.run.set_threads()?;
    let mut problem = run::read(&arguments.file, Problem::read)?;
    let (system, blocks, minimum) = arguments.run.solve(|| problem.system(&arguments))?;
    let points: Vec<Point3<f64>> =
        blocks[2].iter().map(|block| read_point(system.value(&minimum.values, *block))).collect();
    eprintln!(
        "shape rms {:.4} m to {:.4} m",
        problem.shape_rms_m(&problem.points),
        problem.shape_rms_m(&points)
    );
    if let Some(file) = &arguments.run.output {
        std::fs::write(file, solved(&system, &minimum.values, &blocks))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use trackbundle_solver::{Minimiser, worst_jacobian_entry};

    #[test]
    fn jacobians_are_those_of_their_differences() {
        let a = write_pose(&pose([1.0, 2.0, 3.0], [0.9, 0.1, 0.2, -0.3]));
        let b = write_pose(&pose([1.4, 1.5, 3.1], [0.7, -0.4, 0.1, 0.3]));
        let motion = Motion { mean: Vector6::new(0.3, 0.0, 0.0, 0.0, 0.1, 0.0) };
        let prior = PosePrior { start: read_pose(&a) };
        // The camera stands 50 m above and looks down, nearly.
        let camera = write_pose(&pose([2.0, -1.0, 50.0], [0.05, 0.99, 0.02, -0.03]));
        let pinhole = Pinhole { focal_px: 1000.0, principal_px: Vector2::new(500.0, 400.0) };
        let image = ImagePoint { camera: Arc::new(pinhole), observed_px: Vector2::new(510.0, 390.0) };
        let entries = [
            worst_jacobian_entry(&motion, &[&a, &b], 1e-6),
            worst_jacobian_entry(&prior, &[&b], 1e-6),
            worst_jacobian_entry(&image, &[&camera, &b, &[0.7, -0.4, 1.2]], 1e-5),
        ];
        for entry in entries.map(Option::unwrap) {
            assert!(entry.gap < 1e-8, "{entry:?}");
        }
        assert!(image.evaluate(&[&camera, &b, &[0.0, 0.0, 200.0]], None).is_none(), "behind the camera");
    }

    #[test]
    fn a_rigid_motion_is_found() {
        let from: Vec<Point3<f64>> = [[1.0, 0.5, 1.0], [-1.0, 0.5, 1.2], [1.0, -0.6, 0.4], [-1.1, -0.5, 0.2]]
            .map(Point3::from)
            .to_vec();
        let motion = pose([3.0, -2.0, 0.5], [0.7, -0.4, 0.1, 0.3]);
        let to: Vec<Point3<f64>> = from.iter().map(|p| motion * p).collect();
        let found = rigid_fit(&from, &to).unwrap();
        assert!(from.iter().zip(&to).all(|(p, q)| (found * p - q).norm() < 1e-12));
        assert!(rigid_fit(&[from[0]; 4], &to).is_none());
    }

    #[test]
    fn both_eliminations_take_the_same_steps() {
        let mut text =
            "mvba 1\n4 5 20\n1000 500 500\n0.05 0.002 0.3 0.03 0.02 0.005\n0 0 0 5 0 0\n".to_owned();
        for (step, z, q) in [(0.0, 50.0, "0 1 0 0"), (5.0, 0.0, "1 0 0 0")] {
            for t in 0..4 {
                let _ = writeln!(text, "{q} {} 0 {z}", step * f64::from(t));
            }
        }
        let points: [[f64; 3]; 5] =
            [[1.0, 0.5, 1.0], [-1.0, 0.5, 1.2], [1.0, -0.6, 0.4], [-1.1, -0.5, 0.2], [0.0, 0.0, 1.5]];
        points.iter().for_each(|[x, y, z]| text += &format!("{x} {y} {z}\n"));
        for t in 0..4_u32 {
            for j in 0..5_u32 {
                // The camera stands 50 m above the start and looks down.
                let [x, y, z] = points[j as usize].map(|v| v + 0.01 * f64::from(t));
                let noise = (f64::from((t * 7 + j * 3) % 5) - 2.0) / 2.0;
                let (u, v) =
                    (500.0 + 1000.0 * (x + 5.0 * f64::from(t)) / (50.0 - z), 500.0 - 1000.0 * y / (50.0 - z));
                let _ = writeln!(text, "{t} {j} {} {}", u + noise, v - 0.7 * noise);
            }
        }
        for _ in 0..2 {
            (0..4).for_each(|_| text += "1 0 0 0 0 0 0\n");
        }
        points.iter().for_each(|[x, y, z]| text += &format!("{x} {y} {z}\n"));
        let ends = ["frames", "points"].map(|elimination| {
            let to_the_end = ["--function-tolerance", "1e-13", "--max-iterations", "200"];
            let arguments = ["mvba", "file", "--elimination", elimination].into_iter().chain(to_the_end);
            let arguments = Arguments::parse_from(arguments);
            let (system, blocks) = Problem::read(&text).unwrap().system(&arguments);
            assert_eq!(system.is_along_time(), elimination == "frames");
            let minimum = Minimiser::new(&system).unwrap().run(
                &system,
                system.start(),
                arguments.run.minimiser_options(),
                None,
            );
            (minimum.cost.value, solved(&system, &minimum.values, &blocks))
        });
        assert!((ends[0].0 - ends[1].0).abs() < 1e-9 * ends[0].0, "{} {}", ends[0].0, ends[1].0);
        let numbers =
            |text: &str| -> Vec<f64> { text.split_whitespace().map(|w| w.parse().unwrap()).collect() };
        for (a, b) in numbers(&ends[0].1).iter().zip(numbers(&ends[1].1)) {
            assert!((a - b).abs() < 1e-6, "{a} {b}");
        }
    }
}
