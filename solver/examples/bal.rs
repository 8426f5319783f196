//! Solves a *Bundle Adjustment in the Large* problem (Agarwal, Snavely, Seitz and Szeliski, ECCV 2010).
//!
//! ```text
//! P = R X + t,   p = -P / P.z,   pixel = f (1 + k1 |p|^2 + k2 |p|^4) p
//! ```
//!
//! A file has nine numbers a camera: rotation vector, t, f, k1, k2. Costs are half the sum of squares
//! (of rho for a robust loss) in pixels, as in the literature.
//!
//! With `--interior shared` one camera took all images: f, k1, k2 are one block that all image points see,
//! started at the medians of the file's; with `fixed` that block is held there.
//!
//! `cargo run --release -p trackbundle-solver --example bal -- FILE [--loss huber] [--interior shared] [--json]`

use clap::{Parser, ValueEnum};
use nalgebra::{Matrix2, Matrix2x3, Matrix3, SMatrix, UnitQuaternion, Vector2, Vector3};
use std::error::Error;
use std::fmt::Write;
use std::path::PathBuf;
use trackbundle_solver::geometry::{rotation, skew};
use trackbundle_solver::loss::{DEFAULT_SHAPE, LossName};
use trackbundle_solver::manifold::{read_point, read_pose};
use trackbundle_solver::{BlockId, Jacobian, Manifold, Measurement, Residual, System, SystemBuilder, Values};

#[path = "support/run.rs"]
mod run;

/// Solves a problem of Bundle Adjustment in the Large.
#[derive(Parser)]
struct Arguments {
    /// The problem, as text
    file: PathBuf,
    /// Loss of the image points, in pixels: none, huber, cauchy, tukey, geman-mcclure or barron
    #[arg(long, default_value_t = LossName::None)]
    loss: LossName,
    /// Scale of the loss in pixels
    #[arg(long, default_value_t = 1.0)]
    loss_scale: f64,
    /// Whose the interior orientation is
    #[arg(long, value_enum, default_value_t = Interior::Own)]
    interior: Interior,
    #[command(flatten)]
    run: run::Options,
}

#[derive(Clone, Copy, Debug, PartialEq, ValueEnum)]
enum Interior {
    /// Each image has its own, as in the literature
    Own,
    /// All images share one
    Shared,
    /// All images share one that is held
    Fixed,
}

/// An image point less where it was seen, and its derivatives by rotation and translation, by f, k1 and k2, and
/// by the point.
type Projected = (Vector2<f64>, SMatrix<f64, 2, 6>, Matrix2x3<f64>, Matrix2x3<f64>);

#[inline(always)]
fn project(pose: &[f64], lens: &[f64], point: &[f64], seen: &Vector2<f64>) -> Option<Projected> {
    let camera = read_pose(pose);
    let (f, k1, k2) = (lens[0], lens[1], lens[2]);
    let point = read_point(point).coords;
    let rotation: Matrix3<f64> = *camera.rotation.to_rotation_matrix().matrix();
    let in_camera = rotation * point + camera.translation.vector;
    let inverse = -1.0 / in_camera.z;
    let p = in_camera.xy() * inverse;
    let n = p.norm_squared();
    let radial = 1.0 + n * (k1 + k2 * n);
    let bend = 2.0 * (k1 + 2.0 * k2 * n);
    let by_p = (Matrix2::identity() * radial + p * p.transpose() * bend) * f;
    let p_by_camera = Matrix2x3::new(inverse, 0.0, p.x * inverse, 0.0, inverse, p.y * inverse);
    let by_camera = by_p * p_by_camera;
    let by_point = by_camera * rotation;
    let mut by_pose = SMatrix::<f64, 2, 6>::zeros();
    by_pose.fixed_view_mut::<2, 3>(0, 0).copy_from(&by_camera);
    by_pose.fixed_view_mut::<2, 3>(0, 3).copy_from(&-(by_point * skew(&point)));
    let by_lens = Matrix2x3::from_columns(&[p * radial, p * (f * n), p * (f * n * n)]);
    (in_camera.z != 0.0).then(|| (p * (f * radial) - seen, by_pose, by_lens, by_point))
}

/// An image point under the lens that all images share. Blocks: rotation and translation
/// `camera_from_world`; f, k1, k2; the point.
struct SharedImagePoint(Vector2<f64>);

const LENS: Manifold = Manifold::Vector(3);

impl Residual<2, 3> for SharedImagePoint {
    const MANIFOLDS: [Manifold; 3] = [Manifold::Pose, LENS, Manifold::POINT];

    #[inline(always)]
    fn evaluate(&self, x: &[&[f64]; 3], jacobian: Option<&mut Jacobian<2, 3>>) -> Option<Vector2<f64>> {
        let (value, by_pose, by_lens, by_point) = project(x[0], x[1], x[2], &self.0)?;
        if let Some(jacobian) = jacobian {
            jacobian.set(0, 0, &by_pose);
            jacobian.set(1, 0, &by_lens);
            jacobian.set(2, 0, &by_point);
        }
        Some(value)
    }
}

/// An image point. Blocks: rotation and translation `camera_from_world` with f, k1, k2; the point.
struct ImagePoint(Vector2<f64>);

const CAMERA: Manifold = Manifold::PoseAndVector(3);

impl Residual<2, 2> for ImagePoint {
    const MANIFOLDS: [Manifold; 2] = [CAMERA, Manifold::POINT];

    #[inline(always)]
    fn evaluate(&self, x: &[&[f64]; 2], jacobian: Option<&mut Jacobian<2, 2>>) -> Option<Vector2<f64>> {
        let (value, by_pose, by_lens, by_point) = project(&x[0][..7], &x[0][7..], x[1], &self.0)?;
        if let Some(jacobian) = jacobian {
            jacobian.set(0, 0, &by_pose);
            jacobian.set(0, 6, &by_lens);
            jacobian.set(1, 0, &by_point);
        }
        Some(value)
    }
}

/// Cameras, points, and the lens that all share, if they do.
type Blocks = (Vec<BlockId>, Vec<BlockId>, Option<BlockId>);

/// A problem as its file has it.
struct Problem {
    observations: Vec<(usize, usize, Vector2<f64>)>,
    cameras: Vec<[f64; 9]>,
    points: Vec<[f64; 3]>,
}

impl Problem {
    fn read(text: &str) -> Result<Problem, Box<dyn Error>> {
        let mut words = run::Words::new(text);
        let (cameras, points, observations) = (words.next()?, words.next()?, words.next()?);
        let mut problem = Problem { observations: Vec::new(), cameras: Vec::new(), points: Vec::new() };
        for _ in 0..observations {
            let (camera, point): (usize, usize) = (words.next()?, words.next()?);
            if camera >= cameras || point >= points {
                return Err(format!("there is no camera {camera} or no point {point}").into());
            }
            problem.observations.push((camera, point, Vector2::new(words.next()?, words.next()?)));
        }
        for _ in 0..cameras {
            problem.cameras.push(words.array()?);
        }
        for _ in 0..points {
            problem.points.push(words.array()?);
        }
        Ok(problem)
    }

    /// The system, its cameras, its points, and the lens where they share one.
    fn system(&self, arguments: &Arguments) -> (System, Blocks) {
        let mut builder = SystemBuilder::default();
        let is_own = arguments.interior == Interior::Own;
        let camera = |c: &[f64; 9]| {
            let q = UnitQuaternion::from_scaled_axis(Vector3::new(c[0], c[1], c[2]));
            let [w, x, y, z] = [q.w, q.i, q.j, q.k];
            [c[3], c[4], c[5], w, x, y, z, c[6], c[7], c[8]]
        };
        let cameras: Vec<BlockId> = if is_own {
            self.cameras.iter().map(|c| builder.add_block(CAMERA, &camera(c), &[true; 9])).collect()
        } else {
            let pose = |c| builder.add_block(Manifold::Pose, &camera(c)[..7], &[true; 6]);
            self.cameras.iter().map(pose).collect()
        };
        let is_free = arguments.interior == Interior::Shared;
        let lens = (!is_own).then(|| builder.add_block(LENS, &self.median_lens(), &[is_free; 3]));
        let points: Vec<BlockId> =
            self.points.iter().map(|p| builder.add_block(Manifold::POINT, p, &[true; 3])).collect();
        let loss = arguments.loss.with_scale(arguments.loss_scale, DEFAULT_SHAPE);
        let seen = self.observations.iter();
        if let Some(lens) = lens {
            let measurement = |(camera, point, pixel): &(usize, usize, Vector2<f64>)| Measurement {
                residual: SharedImagePoint(*pixel),
                blocks: [cameras[*camera], lens, points[*point]],
                sigma: [1.0; 2],
            };
            builder.add_group("image points", loss, seen.map(measurement).collect());
        } else {
            let measurement = |(camera, point, pixel): &(usize, usize, Vector2<f64>)| Measurement {
                residual: ImagePoint(*pixel),
                blocks: [cameras[*camera], points[*point]],
                sigma: [1.0; 2],
            };
            builder.add_group("image points", loss, seen.map(measurement).collect());
        }
        builder.eliminate(points.clone());
        (builder.build(), (cameras, points, lens))
    }

    fn median_lens(&self) -> [f64; 3] {
        [6, 7, 8].map(|number| {
            let mut values: Vec<f64> = self.cameras.iter().map(|c| c[number]).collect();
            values.sort_by(f64::total_cmp);
            values.get(values.len() / 2).copied().unwrap_or(0.0)
        })
    }

    fn write(&self, system: &System, values: &Values, (cameras, points, lens): &Blocks) -> String {
        let mut text = format!("{} {} {}\n", cameras.len(), points.len(), self.observations.len());
        for (camera, point, pixel) in &self.observations {
            let _ = writeln!(text, "{camera} {point} {:e} {:e}", pixel.x, pixel.y);
        }
        for camera in cameras {
            let value = system.value(values, *camera);
            let pose = read_pose(&value[..7]);
            let turn = rotation::log(&pose.rotation);
            let lens = lens.map_or(&value[7..], |lens| system.value(values, lens));
            for number in turn.iter().chain(&value[..3]).chain(lens) {
                let _ = writeln!(text, "{number:e}");
            }
        }
        for number in points.iter().flat_map(|point| system.value(values, *point)) {
            let _ = writeln!(text, "{number:e}");
        }
        text
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments = Arguments::parse();
    arguments.run.set_threads()?;
    let problem = run::read(&arguments.file, Problem::read)?;
    let (system, blocks, minimum) = arguments.run.solve(|| problem.system(&arguments))?;
    if let Some(file) = &arguments.run.output {
        std::fs::write(file, problem.write(&system, &minimum.values, &blocks))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Rotation3;
    use trackbundle_solver::{Minimiser, worst_jacobian_entry};

    #[test]
    fn the_jacobian_is_that_of_its_differences() {
        let q = UnitQuaternion::from_rotation_matrix(&Rotation3::from_euler_angles(0.3, -0.2, 1.0));
        let camera = [0.5, -0.3, -6.0, q.w, q.i, q.j, q.k, 500.0, -0.1, 0.02];
        let entry =
            worst_jacobian_entry(&ImagePoint(Vector2::new(3.0, 4.0)), &[&camera, &[1.0, 0.5, -0.7]], 1e-6);
        assert!(entry.unwrap().gap < 1e-8, "{entry:?}");
        let shared = SharedImagePoint(Vector2::new(3.0, 4.0));
        let entry = worst_jacobian_entry(&shared, &[&camera[..7], &camera[7..], &[1.0, 0.5, -0.7]], 1e-6);
        assert!(entry.unwrap().gap < 1e-8, "{entry:?}");
    }

    /// Six images of thirty points by one camera, whose lens is found though it starts wrong.
    #[test]
    fn a_lens_that_all_images_share_is_found() {
        let lens = [500.0, -0.1, 0.02];
        let wave = |k: f64| [(1.3 * k).sin(), (2.1 * k).cos(), (0.7 * k + 1.0).sin()];
        let points: Vec<[f64; 3]> = (0..30).map(|k| wave(f64::from(k)).map(|v| 2.0 * v)).collect();
        let cameras: Vec<[f64; 9]> = (0..6)
            .map(|k| {
                let [a, b, c] = wave(40.0 + f64::from(k)).map(|v| 0.4 * v);
                [a, b, c, 0.3 * b, 0.3 * a, -7.0 + c, 1.05 * lens[0], 0.0, 0.0]
            })
            .collect();
        let mut problem = Problem { observations: Vec::new(), cameras, points };
        let arguments = [
            "bal",
            "file",
            "--interior",
            "shared",
            "--function-tolerance",
            "1e-15",
            "--max-iterations",
            "200",
        ];
        let arguments = Arguments::parse_from(arguments);
        let (system, (cameras, points, _)) = problem.system(&arguments);
        for (i, camera) in cameras.iter().enumerate() {
            for (j, point) in points.iter().enumerate() {
                let [pose, point] = [camera, point].map(|block| system.value(system.start(), *block));
                problem.observations.push((i, j, project(pose, &lens, point, &Vector2::zeros()).unwrap().0));
            }
        }
        let (system, (.., shared)) = problem.system(&arguments);
        let options = arguments.run.minimiser_options();
        let minimum = Minimiser::new(&system).unwrap().run(&system, system.start(), options, None);
        let found = system.value(&minimum.values, shared.unwrap());
        assert!(minimum.cost.value < 1e-12, "{:e}", minimum.cost.value);
        assert!((found[0] - 500.0).abs() < 1e-3 && (found[1] + 0.1).abs() < 1e-6, "{found:?}");
        let fixed = Arguments::parse_from(["bal", "file", "--interior", "fixed"]);
        assert_eq!(problem.system(&fixed).0.parameters() + 3, system.parameters());
    }

    #[test]
    fn a_file_comes_back() {
        let text = "1 1 1\n0 0 3.5 -4.25\n0.1\n-0.2\n0.3\n1\n2\n-9\n500\n-1e-3\n2e-6\n0.5\n0.25\n-0.125\n";
        let problem = Problem::read(text).unwrap();
        let arguments = Arguments::parse_from(["bal", "file"]);
        let (system, blocks) = problem.system(&arguments);
        let again = Problem::read(&problem.write(&system, system.start(), &blocks)).unwrap();
        let gap = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(gap(&problem.cameras[0], &again.cameras[0]) < 1e-12);
        assert_eq!(problem.points, again.points);
        assert_eq!(problem.observations, again.observations);
        assert!(Problem::read("1 1 1\n0 1 3.5 -4.25\n").is_err() && Problem::read("1 1").is_err());
    }
}
