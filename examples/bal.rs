//! Solves a *Bundle Adjustment in the Large* problem (Agarwal, Snavely, Seitz and Szeliski, ECCV 2010).
//!
//! ```text
//! P = R X + t,   p = -P / P.z,   pixel = f (1 + k1 |p|^2 + k2 |p|^4) p
//! ```
//!
//! A file has nine numbers a camera: rotation vector, t, f, k1, k2. Costs are half the sum of squares
//! (of rho for a robust loss) in pixels, as in the literature.
//!
//! `cargo run --release --example bal -- FILE [--loss huber] [--json]`

use clap::Parser;
use nalgebra::{Matrix2, Matrix2x3, Matrix3, UnitQuaternion, Vector2, Vector3};
use std::error::Error;
use std::fmt::Write;
use std::path::PathBuf;
use trackbundle::geometry::{rotation, skew};
use trackbundle::nlls::loss::{DEFAULT_SHAPE, LossName};
use trackbundle::nlls::manifold::{Manifold, read_point, read_pose};
use trackbundle::nlls::residual::{Jacobian, Residual};
use trackbundle::nlls::system::{BlockId, Measurement, System, SystemBuilder, Values};

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
    #[command(flatten)]
    run: run::Options,
}

/// An image point. Blocks: rotation and translation `camera_from_world` with f, k1, k2; the point.
struct ImagePoint(Vector2<f64>);

const CAMERA: Manifold = Manifold::PoseAndVector(3);

impl Residual<2, 2> for ImagePoint {
    const MANIFOLDS: [Manifold; 2] = [CAMERA, Manifold::POINT];

    #[inline(always)]
    fn evaluate(&self, x: &[&[f64]; 2], jacobian: Option<&mut Jacobian<2, 2>>) -> Option<Vector2<f64>> {
        let camera = read_pose(&x[0][..7]);
        let (f, k1, k2) = (x[0][7], x[0][8], x[0][9]);
        let point = read_point(x[1]).coords;
        let rotation: Matrix3<f64> = *camera.rotation.to_rotation_matrix().matrix();
        let in_camera = rotation * point + camera.translation.vector;
        let inverse = -1.0 / in_camera.z;
        let p = in_camera.xy() * inverse;
        let n = p.norm_squared();
        let lens = 1.0 + n * (k1 + k2 * n);
        if let Some(jacobian) = jacobian {
            let bend = 2.0 * (k1 + 2.0 * k2 * n);
            let by_p = (Matrix2::identity() * lens + p * p.transpose() * bend) * f;
            let p_by_camera = Matrix2x3::new(inverse, 0.0, p.x * inverse, 0.0, inverse, p.y * inverse);
            let by_camera = by_p * p_by_camera;
            let by_point = by_camera * rotation;
            jacobian.set(0, 0, &by_camera);
            jacobian.set(0, 3, &-(by_point * skew(&point)));
            jacobian.set(0, 6, &(p * lens));
            jacobian.set(0, 7, &(p * (f * n)));
            jacobian.set(0, 8, &(p * (f * n * n)));
            jacobian.set(1, 0, &by_point);
        }
        (in_camera.z != 0.0).then(|| p * (f * lens) - self.0)
    }
}

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

    fn system(&self, arguments: &Arguments) -> (System, [Vec<BlockId>; 2]) {
        let mut builder = SystemBuilder::default();
        let camera = |c: &[f64; 9]| {
            let q = UnitQuaternion::from_scaled_axis(Vector3::new(c[0], c[1], c[2]));
            let [w, x, y, z] = [q.w, q.i, q.j, q.k];
            [c[3], c[4], c[5], w, x, y, z, c[6], c[7], c[8]]
        };
        let cameras: Vec<BlockId> =
            self.cameras.iter().map(|c| builder.add_block(CAMERA, &camera(c), &[true; 9])).collect();
        let points: Vec<BlockId> =
            self.points.iter().map(|p| builder.add_block(Manifold::POINT, p, &[true; 3])).collect();
        let measurement = |(camera, point, pixel): &(usize, usize, Vector2<f64>)| Measurement {
            residual: ImagePoint(*pixel),
            blocks: [cameras[*camera], points[*point]],
            sigma: [1.0; 2],
        };
        let loss = arguments.loss.with_scale(arguments.loss_scale, DEFAULT_SHAPE);
        builder.add_group("image points", loss, self.observations.iter().map(measurement).collect());
        builder.eliminate(points.clone());
        (builder.build(), [cameras, points])
    }

    fn write(&self, system: &System, values: &Values, cameras: &[BlockId], points: &[BlockId]) -> String {
        let mut text = format!("{} {} {}\n", cameras.len(), points.len(), self.observations.len());
        for (camera, point, pixel) in &self.observations {
            let _ = writeln!(text, "{camera} {point} {:e} {:e}", pixel.x, pixel.y);
        }
        for camera in cameras {
            let value = system.value(values, *camera);
            let pose = read_pose(&value[..7]);
            let turn = rotation::log(&pose.rotation);
            for number in turn.iter().chain(&value[..3]).chain(&value[7..]) {
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
    let (system, [cameras, points], minimum) = arguments.run.solve(|| problem.system(&arguments))?;
    if let Some(file) = &arguments.run.output {
        std::fs::write(file, problem.write(&system, &minimum.values, &cameras, &points))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Rotation3;
    use trackbundle::nlls::residual::worst_jacobian_entry;

    #[test]
    fn the_jacobian_is_that_of_its_differences() {
        let q = UnitQuaternion::from_rotation_matrix(&Rotation3::from_euler_angles(0.3, -0.2, 1.0));
        let camera = [0.5, -0.3, -6.0, q.w, q.i, q.j, q.k, 500.0, -0.1, 0.02];
        let entry =
            worst_jacobian_entry(&ImagePoint(Vector2::new(3.0, 4.0)), &[&camera, &[1.0, 0.5, -0.7]], 1e-6);
        assert!(entry.unwrap().gap < 1e-8, "{entry:?}");
    }

    #[test]
    fn a_file_comes_back() {
        let text = "1 1 1\n0 0 3.5 -4.25\n0.1\n-0.2\n0.3\n1\n2\n-9\n500\n-1e-3\n2e-6\n0.5\n0.25\n-0.125\n";
        let problem = Problem::read(text).unwrap();
        let arguments = Arguments::parse_from(["bal", "file"]);
        let (system, [cameras, points]) = problem.system(&arguments);
        let again = Problem::read(&problem.write(&system, system.start(), &cameras, &points)).unwrap();
        let gap = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(gap(&problem.cameras[0], &again.cameras[0]) < 1e-12);
        assert_eq!(problem.points, again.points);
        assert_eq!(problem.observations, again.observations);
        assert!(Problem::read("1 1 1\n0 1 3.5 -4.25\n").is_err() && Problem::read("1 1").is_err());
    }
}
