//! The DLT with gross errors: a Huber fit of its rows as a cone program.
//!
//! ```text
//! minimise    sum over sightings of  |w_i|^2 / 2 + k t_i
//! subject to  |A_i M - b_i - w_i| <= t_i                    second-order cones of size 3
//!             lower <= M <= upper                            the body's box
//! ```
//!
//! At the minimum `w_i` is the part of a residual up to the length `k` and `t_i` the length of the
//! rest: Huber's loss of the residual of an image point as a whole. The problem is convex, so that
//! the answer needs no start, and with a `k` well below the errors of the starting poses it is
//! nearly the fit of least absolute deviations, which half of the sightings cannot spoil.

use super::dlt::LinearPoint;
use crate::residuals::inside_body::BODY_BOX_M;
use clarabel::algebra::CscMatrix;
use clarabel::solver::{
    DefaultSettingsBuilder, DefaultSolver, IPSolver, NonnegativeConeT, SecondOrderConeT, SolverStatus,
    SupportedConeT,
};
use nalgebra::Point3;

/// The Huber fit of a point of a vehicle; `huber` is the length in standard deviations at which a
/// residual turns linear. `None` where the program has no solution.
pub fn solve(linear: &LinearPoint, huber: f64) -> Option<Point3<f64>> {
    // Unknowns: M (3), w (a row each), t (a sighting each; known coordinates are not robust, t = 0).
    let (rows, sightings) = (linear.rows.nrows(), linear.sightings);
    let unknowns = 3 + rows + sightings;
    let (w, t) = (|row: usize| 3 + row, |sighting: usize| 3 + rows + sighting);
    let mut entries = Triplets::default();
    let mut right = Vec::new();
    let mut cones: Vec<SupportedConeT<f64>> = Vec::new();

    // Known coordinates: A M - b - w = 0, so that w carries the whole residual.
    let known = rows - 2 * sightings;
    for row in 2 * sightings..rows {
        let at = entries.next_row();
        (0..3).for_each(|axis| entries.add(at, axis, linear.rows[(row, axis)]));
        entries.add(at, w(row), -1.0);
        right.push(linear.right[row]);
    }
    if known > 0 {
        cones.push(SupportedConeT::ZeroConeT(known));
    }
    for (axis, [lower, upper]) in BODY_BOX_M.iter().enumerate() {
        for (sign, bound) in [(1.0, *upper), (-1.0, -*lower)] {
            let at = entries.next_row();
            entries.add(at, axis, sign);
            right.push(bound);
        }
    }
    cones.push(NonnegativeConeT(6));
    for sighting in 0..sightings {
        // (t, A M - b - w) lies in the cone.
        let at = entries.next_row();
        entries.add(at, t(sighting), -1.0);
        right.push(0.0);
        for row in [2 * sighting, 2 * sighting + 1] {
            let at = entries.next_row();
            (0..3).for_each(|axis| entries.add(at, axis, -linear.rows[(row, axis)]));
            entries.add(at, w(row), 1.0);
            right.push(-linear.right[row]);
        }
        cones.push(SecondOrderConeT(3));
    }
    let constraints = entries.into_matrix(unknowns);

    let mut quadratic = Triplets::default();
    (0..rows).for_each(|row| quadratic.add(w(row), w(row), 1.0));
    quadratic.set_rows(unknowns);
    let mut linear_cost = vec![0.0; unknowns];
    (0..sightings).for_each(|sighting| linear_cost[t(sighting)] = huber);

    let settings = DefaultSettingsBuilder::default().verbose(false).max_threads(1).build().ok()?;
    let quadratic = quadratic.into_matrix(unknowns);
    let mut solver =
        DefaultSolver::new(&quadratic, &linear_cost, &constraints, &right, &cones, settings).ok()?;
    solver.solve();
    let solved = matches!(solver.solution.status, SolverStatus::Solved | SolverStatus::AlmostSolved);
    let point = Point3::from_slice(&solver.solution.x[..3]);
    (solved && point.iter().all(|v| v.is_finite())).then_some(point)
}

/// A sparse matrix under construction.
#[derive(Default)]
pub(crate) struct Triplets {
    rows: usize,
    row: Vec<usize>,
    column: Vec<usize>,
    value: Vec<f64>,
}

impl Triplets {
    /// Begins a row and returns its index.
    pub(crate) fn next_row(&mut self) -> usize {
        self.rows += 1;
        self.rows - 1
    }

    /// Adds to an entry.
    pub(crate) fn add(&mut self, row: usize, column: usize, value: f64) {
        self.row.push(row);
        self.column.push(column);
        self.value.push(value);
    }

    /// Sets the number of rows of a matrix that is not built row by row.
    pub(crate) fn set_rows(&mut self, rows: usize) {
        self.rows = rows;
    }

    /// The matrix; entries that were added twice are summed.
    pub(crate) fn into_matrix(self, columns: usize) -> CscMatrix<f64> {
        CscMatrix::new_from_triplets(self.rows, columns, self.row, self.column, self.value)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::problem::Known;
    use nalgebra::{Dyn, OMatrix, OVector, U3, Vector2, Vector3};

    /// Rows of a point seen from 40 sides, with normal-like errors and every third one gross.
    fn example(gross: bool) -> (LinearPoint, Point3<f64>) {
        let truth = Point3::new(1.2, -0.7, 0.9);
        let count = 40;
        let mut rows = OMatrix::<f64, Dyn, U3>::zeros(2 * count);
        let mut right = OVector::<f64, Dyn>::zeros(2 * count);
        for at in 0..2 * count {
            let angle = at as f64;
            let row = Vector3::new(angle.sin(), (1.3 * angle).cos(), (0.7 * angle).sin()) * 15.0;
            let error = (2.1 * angle).sin() + if gross && at % 6 < 2 { 200.0 + 3.0 * angle } else { 0.0 };
            rows.set_row(at, &row.transpose());
            right[at] = row.dot(&truth.coords) + error;
        }
        (LinearPoint { rows, right, sightings: count }, truth)
    }

    /// The optimality condition of the Huber fit: the weighted residuals balance.
    fn imbalance(linear: &LinearPoint, point: &Point3<f64>, huber: f64) -> f64 {
        let residual = &linear.rows * point.coords - &linear.right;
        let mut sum = Vector3::zeros();
        for at in 0..linear.sightings {
            let pair = Vector2::new(residual[2 * at], residual[2 * at + 1]);
            let weight = (huber / pair.norm()).min(1.0);
            sum += weight * (linear.rows.fixed_rows::<2>(2 * at).transpose() * pair);
        }
        sum.norm()
    }

    #[test]
    fn it_is_the_huber_fit() {
        for gross in [false, true] {
            let (linear, truth) = example(gross);
            let found = solve(&linear, 1.5).unwrap();
            assert!(imbalance(&linear, &found, 1.5) < 1e-3, "{}", imbalance(&linear, &found, 1.5));
            assert!((found - truth).norm() < 0.1, "{}", (found - truth).norm());
        }
    }

    #[test]
    fn gross_errors_spoil_the_plain_fit_only() {
        let (linear, truth) = example(true);
        let plain = linear.solve().unwrap();
        assert!((plain - truth).norm() > 1.0);
        assert!(linear.has_heavy_tails(&plain));
        let (clean, _) = example(false);
        assert!(!clean.has_heavy_tails(&clean.solve().unwrap()));
    }

    #[test]
    fn the_point_stays_in_the_box() {
        let (mut linear, _) = example(false);
        linear.right *= 100.0;
        let found = solve(&linear, 1.5).unwrap();
        for (value, [lower, upper]) in found.iter().zip(BODY_BOX_M) {
            assert!(*value > lower - 1e-4 && *value < upper + 1e-4);
        }
    }

    #[test]
    fn a_known_coordinate_is_kept_whatever_the_rays_say() {
        let (linear, truth) = example(true);
        let known = LinearPoint::new(&[], &[None, None, Some(Known { value_m: 1.3, sigma_m: 0.0 })]);
        let rows = linear.rows.nrows();
        let mut both = LinearPoint {
            rows: linear.rows.insert_row(rows, 0.0),
            right: linear.right.insert_row(rows, 0.0),
            ..linear
        };
        both.rows.set_row(rows, &known.rows.row(0));
        both.right[rows] = known.right[0];
        let found = solve(&both, 1.5).unwrap();
        assert!((found.z - 1.3).abs() < 1e-4, "{}", found.z);
        assert!((found.xy() - truth.xy()).norm() < 0.2);
    }
}
