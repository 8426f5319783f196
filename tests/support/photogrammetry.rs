//! An adjustment as a photogrammetrist writes it down: image points of a camera that looks along its -z axis,
//! with corrections for its lens, control points that are fixed or weighted, and what the result is worth.
//!
//! ```text
//! x = (1 + b) (p u - x0),   y = y0 - p v              measured pixel (u, v), pixel size p; mm, y upwards
//! r2 = x^2 + y^2,           g = K1 r2 + K2 r2^2 + K3 r2^3
//! x' = x + x g + P1 (r2 + 2 x^2) + 2 P2 x y           corrected
//! y' = y + y g + P2 (r2 + 2 y^2) + 2 P1 x y
//! q = R^T (X - X0),   x' = -c q.x / q.z,   y' = -c q.y / q.z
//! R = Rx(omega) Ry(phi) Rz(kappa)
//! ```
//!
//! The corrections are those of Brown, *Close-range camera calibration*, Photogrammetric Engineering 37 (1971):
//! they are added to what was measured. `b` is the affinity: a pixel is `(1 + b) p` wide and `p` high.

use nalgebra::{
    Cholesky, DMatrix, Dyn, Matrix2, Matrix2x3, Matrix3, Matrix6, Point3, Rotation3, SMatrix, SVector,
    Vector2, Vector3,
};
use std::f64::consts::{PI, TAU};
use std::ops::Range;
use trackbundle::geometry::{Pose, skew};
use trackbundle_solver::manifold::{Manifold, read_point, read_pose};
use trackbundle_solver::residual::{Jacobian, Residual};
use trackbundle_solver::system::{BlockId, Curvature, System, Values};

/// `c`, `x0`, `y0` \[mm\], `b`, `K1`, `K2`, `K3`, `P1`, `P2`.
pub const INTERIOR: Manifold = Manifold::Vector(9);

/// An image point, in mm. Blocks: exterior orientation `world_from_camera`; interior orientation; object point.
#[derive(Clone, Copy, Debug)]
pub struct ImagePoint {
    /// Where it was measured.
    pub measured_px: [f64; 2],
    /// Height of a pixel.
    pub pixel_mm: f64,
}

impl ImagePoint {
    /// The image coordinates less the principal point, before the corrections.
    fn reduced_mm(&self, interior: &[f64]) -> Vector2<f64> {
        let [u, v] = self.measured_px.map(|coordinate_px| coordinate_px * self.pixel_mm);
        Vector2::new((1.0 + interior[3]) * (u - interior[1]), interior[2] - v)
    }

    /// The direction to the object point in the camera's frame, of an ideal lens.
    pub fn ray(&self, interior: &[f64]) -> Vector3<f64> {
        let reduced_mm = self.reduced_mm(interior);
        Vector3::new(reduced_mm.x, reduced_mm.y, -interior[0])
    }
}

impl Residual<2, 3> for ImagePoint {
    const MANIFOLDS: [Manifold; 3] = [Manifold::Pose, INTERIOR, Manifold::POINT];

    fn evaluate(&self, x: &[&[f64]; 3], jacobian: Option<&mut Jacobian<2, 3>>) -> Option<Vector2<f64>> {
        let (camera, interior, point) = (read_pose(x[0]), x[1], read_point(x[2]).coords);
        let (c_mm, b, [k1, k2, k3, p1, p2]) =
            (interior[0], interior[3], [4, 5, 6, 7, 8].map(|i: usize| interior[i]));
        let camera_from_world = *camera.rotation.inverse().to_rotation_matrix().matrix();
        let q = camera_from_world * (point - camera.translation.vector);
        let direction = -q.xy() / q.z;

        let m = self.reduced_mm(interior);
        let r2 = m.norm_squared();
        let g = r2 * (k1 + r2 * (k2 + r2 * k3));
        let by_p1 = Vector2::new(r2 + 2.0 * m.x * m.x, 2.0 * m.x * m.y);
        let by_p2 = Vector2::new(2.0 * m.x * m.y, r2 + 2.0 * m.y * m.y);
        let corrected = m * (1.0 + g) + by_p1 * p1 + by_p2 * p2;

        if let Some(jacobian) = jacobian {
            let by_q = Matrix2x3::new(1.0, 0.0, direction.x, 0.0, 1.0, direction.y) * (-c_mm / q.z);
            let by_point = by_q * camera_from_world;
            jacobian.set(0, 0, &-by_point);
            jacobian.set(0, 3, &(by_q * skew(&q)));
            jacobian.set(2, 0, &by_point);

            let bend = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3));
            let across = 2.0 * (p1 * m.y + p2 * m.x);
            let decentring = Matrix2::new(
                6.0 * p1 * m.x + 2.0 * p2 * m.y,
                across,
                across,
                6.0 * p2 * m.y + 2.0 * p1 * m.x,
            );
            let by_m = Matrix2::identity() * (1.0 + g) + m * m.transpose() * bend + decentring;
            let by_width = by_m.column(0);
            let columns = [
                direction,
                by_width * (1.0 + b),
                -by_m.column(1),
                -by_width * (self.measured_px[0] * self.pixel_mm - interior[1]),
                -m * r2,
                -m * (r2 * r2),
                -m * (r2 * r2 * r2),
                -by_p1,
                -by_p2,
            ];
            jacobian.set(1, 0, &SMatrix::<f64, 2, 9>::from_columns(&columns));
        }
        (q.z < 0.0).then(|| direction * c_mm - corrected)
    }
}

/// A control point whose surveyed coordinates are observations. Block: the object point.
pub struct ControlPoint(pub Vector3<f64>);

impl Residual<3, 1> for ControlPoint {
    const MANIFOLDS: [Manifold; 1] = [Manifold::POINT];

    fn evaluate(&self, x: &[&[f64]; 1], jacobian: Option<&mut Jacobian<3, 1>>) -> Option<SVector<f64, 3>> {
        if let Some(jacobian) = jacobian {
            jacobian.set(0, 0, &Matrix3::identity());
        }
        Some(read_point(x[0]).coords - self.0)
    }
}

/// The point that is nearest to rays, each with its camera: least squares of the distances.
pub fn intersection(rays: &[(Pose, Vector3<f64>)]) -> Option<Point3<f64>> {
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for (camera, ray) in rays {
        let along = (camera.rotation * ray).normalize();
        let across = Matrix3::identity() - along * along.transpose();
        normal += across;
        right += across * camera.translation.vector;
    }
    Some(Point3::from(normal.cholesky()?.solve(&right)))
}

/// An exterior orientation: `[X0, Y0, Z0, omega, phi, kappa]` \[m, rad\].
pub type Exterior = [f64; 6];

fn rotations([omega, phi, kappa]: [f64; 3]) -> [Rotation3<f64>; 3] {
    let about = Rotation3::from_axis_angle;
    [about(&Vector3::x_axis(), omega), about(&Vector3::y_axis(), phi), about(&Vector3::z_axis(), kappa)]
}

/// The pose of an exterior orientation.
pub fn pose_of([x, y, z, omega, phi, kappa]: Exterior) -> Pose {
    let [rx, ry, rz] = rotations([omega, phi, kappa]);
    Pose::from_parts(Vector3::new(x, y, z).into(), (rx * ry * rz).into())
}

/// The exterior orientation of a pose, with angles in (-pi, pi].
pub fn exterior_of(pose: &Pose) -> Exterior {
    let r = pose.rotation.to_rotation_matrix();
    let angles = [(-r[(1, 2)]).atan2(r[(2, 2)]), r[(0, 2)].asin(), (-r[(0, 1)]).atan2(r[(0, 0)])];
    let at = pose.translation.vector;
    [at.x, at.y, at.z, angles[0], angles[1], angles[2]]
}

/// Derivative of [`exterior_of`] with respect to the perturbation of the pose. The angles turn the body about
/// axes that it sees as
///
/// ```text
/// r = Rz^T Ry^T ex domega + Rz^T ey dphi + ez dkappa
/// ```
pub fn exterior_jacobian(pose: &Pose) -> Matrix6<f64> {
    let [_, _, _, omega, phi, kappa] = exterior_of(pose);
    let [_, ry, rz] = rotations([omega, phi, kappa]);
    let axes = [(ry * rz).inverse() * Vector3::x(), rz.inverse() * Vector3::y(), Vector3::z()];
    let mut jacobian = Matrix6::identity();
    let angles = Matrix3::from_columns(&axes).try_inverse().expect("phi is not a right angle");
    jacobian.fixed_view_mut::<3, 3>(3, 3).copy_from(&angles);
    jacobian
}

/// The angle as it is nearest to zero.
pub fn wrapped(angle_rad: f64) -> f64 {
    (angle_rad + PI).rem_euclid(TAU) - PI
}

/// The inverse of the normal matrix of a system that eliminates nothing first, computed as a dense matrix.
pub struct Cofactors {
    factor: Cholesky<f64, Dyn>,
    scale: Vec<f64>,
}

impl Cofactors {
    /// Those at `values`.
    pub fn new(system: &System, values: &Values) -> Cofactors {
        assert!(!system.has_eliminated_blocks() && !system.is_along_time());
        let mut normal = system.normal();
        system.linearise(values, Curvature::PLAIN, &mut normal).expect("a normal matrix");
        let scale: Vec<f64> = normal.diagonal().iter().map(|d| d.sqrt().recip()).collect();
        let mut matrix = DMatrix::zeros(scale.len(), scale.len());
        normal.for_each_entry(|row, column, value| {
            matrix[(row, column)] = value * scale[row] * scale[column];
        });
        // The factor is made from the lower triangle alone.
        Cofactors { factor: matrix.cholesky().expect("no rank defect"), scale }
    }

    /// The diagonal block of these unknowns.
    pub fn block(&self, range: Range<usize>) -> DMatrix<f64> {
        let mut columns = DMatrix::zeros(self.scale.len(), range.len());
        for (column, row) in range.clone().enumerate() {
            columns[(row, column)] = self.scale[row];
        }
        self.factor.solve_mut(&mut columns);
        DMatrix::from_fn(range.len(), range.len(), |i, j| {
            columns[(range.start + i, j)] * self.scale[range.start + i]
        })
    }
}

/// What an adjustment says of itself.
pub struct Statistics {
    /// Observations, one for each coordinate.
    pub observations: usize,
    /// Numbers that were adjusted.
    pub parameters: usize,
    /// Standard deviation of unit weight, a posteriori.
    pub sigma0: f64,
    cofactors: Cofactors,
}

impl Statistics {
    /// Those of the adjustment that ended at `values` with the sum of squares of its whitened residuals.
    pub fn new(system: &System, values: &Values, observations: usize, squares: f64) -> Statistics {
        let parameters = system.parameters();
        Statistics {
            observations,
            parameters,
            sigma0: (squares / (observations - parameters) as f64).sqrt(),
            cofactors: Cofactors::new(system, values),
        }
    }

    /// Observations less parameters.
    pub fn redundancy(&self) -> usize {
        self.observations - self.parameters
    }

    /// Covariance of a block that is adjusted.
    pub fn covariance(&self, system: &System, block: BlockId) -> DMatrix<f64> {
        let range = system.range_of(block).expect("a block that is adjusted");
        self.cofactors.block(range) * self.sigma0.powi(2)
    }

    /// Covariance of the exterior orientation that a pose is written as.
    pub fn exterior_covariance(&self, system: &System, values: &Values, pose: BlockId) -> DMatrix<f64> {
        let jacobian = exterior_jacobian(&read_pose(system.value(values, pose)));
        let covariance = jacobian * self.covariance(system, pose) * jacobian.transpose();
        DMatrix::from_iterator(6, 6, covariance.iter().copied())
    }
}

/// Standard deviations of a covariance.
pub fn deviations(covariance: &DMatrix<f64>) -> Vec<f64> {
    covariance.diagonal().iter().map(|variance| variance.sqrt()).collect()
}
