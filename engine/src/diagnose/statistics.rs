//! Redundancy, sigma0, variance components and reliability.
//!
//! Of the whitened rows of the final least squares, with the leverage `h = J Q J^T` of each,
//!
//! ```text
//! redundancy number       r = 1 - h             their sum is the redundancy
//! variance component      sum v^2 / sum r       of each kind of observation: 1 where its sigma is right
//! standardised residual   w = v / sqrt(r)       Baarda's w-test
//! minimal detectable      4.13 sigma / sqrt(r)  found in 80 % of cases at a level of 0.1 %
//! external reliability    4.13 sqrt((1-r) / r)  by how many standard deviations it may move a function of
//!                                               the unknowns if it is not found
//! ```
//!
//! (Foerstner 1979 and 1987; Baarda 1968.) Standard deviations are those stated, or where image points proved
//! to be of another quality, those that were estimated.

use crate::network::{Nature, Source};
use crate::problem::Problem;
use crate::refine::{Adjustment, Network};
use crate::stats::chi_square::{chi_square_exceeded, chi_square_quantile};
use crate::stats::normal::TWO_SIDED_99_9;
use crate::stats::quantile::upper_median;
use trackbundle_solver::covariance::Covariance;
use trackbundle_solver::system::GroupId;

/// Non-centrality at which a test of level 0.1 % finds an error in 80 % of cases.
pub const NON_CENTRALITY: f64 = 4.13;
/// Critical value of a standardised residual at a level of 0.1 %.
pub const CRITICAL: f64 = TWO_SIDED_99_9;
/// Level of the test of sigma0, two-sided.
pub const LEVEL: f64 = 0.05;
/// A row whose redundancy number is less is checked by nothing.
pub const UNCHECKED: f64 = 1e-6;

/// Observations of one kind.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Component {
    /// Which.
    pub source: Source,
    /// Its rows.
    pub rows: usize,
    /// Sum of their redundancy numbers.
    pub redundancy: f64,
    /// Sum of their squared whitened residuals.
    pub squares: f64,
    /// By what the stated standard deviations were multiplied before.
    pub weighed_by: f64,
}

impl Component {
    /// By what the stated standard deviations would have to be multiplied; `None` without redundancy.
    pub fn sigma_factor(&self) -> Option<f64> {
        (self.redundancy > 0.5).then(|| self.weighed_by * (self.squares / self.redundancy).sqrt())
    }

    /// Standard deviation of this factor, as a share of it: `1 / sqrt(2 r)`.
    pub fn relative_sigma(&self) -> f64 {
        1.0 / (2.0 * self.redundancy.max(0.0)).sqrt()
    }
}

/// How well gross errors among the image points of a vehicle would have been found.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Reliability {
    /// Coordinates of image points that took part.
    pub rows: usize,
    /// Least and median redundancy number.
    pub redundancy_number: [f64; 2],
    /// Median and largest minimal detectable error \[px\]; infinite where nothing checks a row.
    pub minimal_detectable_px: [f64; 2],
    /// Median and largest external reliability \[standard deviations\].
    pub external: [f64; 2],
    /// Standardised residuals beyond the critical value.
    pub beyond_critical: usize,
    /// The largest standardised residual.
    pub largest: f64,
}

/// The test of sigma0^2.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VarianceTest {
    /// Sum of squares over redundancy.
    pub variance: f64,
    /// Redundancy.
    pub redundancy: f64,
    /// Between what it would lie in 95 % of cases, were all standard deviations right.
    pub interval: [f64; 2],
    /// Probability of a value at least as far off.
    pub probability: f64,
}

impl VarianceTest {
    fn new(squares: f64, redundancy: f64) -> Option<Self> {
        (redundancy > 0.5).then(|| {
            let upper = chi_square_exceeded(squares, redundancy);
            VarianceTest {
                variance: squares / redundancy,
                redundancy,
                interval: [1.0 - LEVEL / 2.0, LEVEL / 2.0]
                    .map(|exceeded| chi_square_quantile(exceeded, redundancy) / redundancy),
                probability: (2.0 * upper.min(1.0 - upper)).min(1.0),
            }
        })
    }

    /// Whether it is where it would be in 95 % of cases.
    pub fn is_passed(&self) -> bool {
        self.interval[0] <= self.variance && self.variance <= self.interval[1]
    }
}

/// Statistics of the final least squares.
#[derive(Clone, Debug)]
pub struct Statistics {
    /// One for each kind of observation.
    pub components: Vec<Component>,
    /// Sum of all redundancy numbers.
    pub redundancy_numbers: f64,
    /// The test of sigma0; `None` without redundancy.
    pub test: Option<VarianceTest>,
    /// One for each vehicle.
    pub vehicles: Vec<Reliability>,
    /// That of the image points of targets.
    pub targets: Reliability,
}

impl Statistics {
    /// Adds the vehicles of another under the same cameras and targets.
    pub(super) fn join(&mut self, other: Statistics) {
        for component in other.components {
            let is_own = component.source.traits().per_vehicle;
            match self.components.iter_mut().find(|own| own.source == component.source) {
                Some(own) if is_own => {
                    own.rows += component.rows;
                    own.redundancy += component.redundancy;
                    own.squares += component.squares;
                }
                // Cameras and targets are the same ones.
                Some(_) => {}
                None => self.components.push(component),
            }
        }
        self.components.sort_by_key(|component| component.source);
        self.redundancy_numbers = self.components.iter().map(|c| c.redundancy).sum();
        self.vehicles.extend(other.vehicles);
    }

    /// Takes the test of sigma0 from the adjustment of all.
    pub(super) fn set_test(&mut self, adjustment: &Adjustment) {
        let redundancy = adjustment.redundancy as f64;
        self.test = adjustment.sigma0.and_then(|s| VarianceTest::new(s * s * redundancy, redundancy));
    }
}

/// One row of an image point.
struct Row {
    redundancy: f64,
    residual: f64,
    sigma_px: f64,
}

/// The statistics of a network.
pub fn statistics(problem: &Problem, network: &Network, covariance: &Covariance<'_>) -> Statistics {
    let model = &network.model;
    let mut components: Vec<Component> = Vec::new();
    for (source, group) in &model.sources {
        let (rows, redundancy, squares) = of_group(network, covariance, *group);
        if matches!(source.traits().nature, Nature::Datum | Nature::Convention) {
            continue;
        }
        // Given poses together are one observation of a few numbers.
        let counted = model.counted_rows(*group);
        let redundancy = redundancy - (rows - counted) as f64;
        match components.iter_mut().find(|component| component.source == *source) {
            Some(component) => {
                component.rows += counted;
                component.redundancy += redundancy;
                component.squares += squares;
            }
            None if rows > 0 => {
                // That of motion is its strength, which stands for itself.
                let weighed_by = if source.is_image() { model.system.sigma_factor(*group) } else { 1.0 };
                components.push(Component {
                    source: *source,
                    rows: counted,
                    redundancy,
                    squares,
                    weighed_by,
                });
            }
            None => {}
        }
    }
    components.sort_by_key(|component| component.source);
    let redundancy_numbers = components.iter().map(|c| c.redundancy).sum();
    let squares: f64 = components.iter().map(|c| c.squares).sum();
    let (of_vehicles, of_targets) = image_rows(problem, network, covariance);
    Statistics {
        redundancy_numbers,
        test: VarianceTest::new(squares, redundancy_numbers),
        vehicles: of_vehicles.iter().map(|rows| reliability(rows)).collect(),
        targets: reliability(&of_targets),
        components,
    }
}

/// Rows of a group, the sum of their redundancy numbers and of their squared residuals.
pub(super) fn of_group(network: &Network, covariance: &Covariance<'_>, group: GroupId) -> (usize, f64, f64) {
    let system = &network.model.system;
    let rows = system.rows(group);
    let squares = system.squared_norms(group, &network.values).into_iter().flatten().sum();
    let leverages = covariance.leverages(group);
    // Square blocks, one for each measurement.
    let size = (leverages.len() / rows.max(1)).max(1);
    let trace: f64 =
        leverages.chunks_exact(size * size).flat_map(|block| block.iter().step_by(size + 1)).sum();
    (rows, rows as f64 - trace, squares)
}

/// Rows of image points: for each vehicle, and of targets.
fn image_rows(
    problem: &Problem,
    network: &Network,
    covariance: &Covariance<'_>,
) -> (Vec<Vec<Row>>, Vec<Row>) {
    let model = &network.model;
    let of_group = |group: GroupId| {
        let residuals = model.system.residuals(group, &network.values);
        let leverages = covariance.leverages(group);
        residuals.into_iter().zip(leverages.chunks_exact(4).map(|block| [block[0], block[3]]))
    };
    let rows = |(residual, leverage): (Option<Vec<f64>>, [f64; 2]), sigma_px: f64| {
        let rows = residual.into_iter().flatten().zip(leverage);
        rows.map(move |(residual, leverage)| Row { redundancy: 1.0 - leverage, residual, sigma_px })
    };
    let [in_vehicles, in_targets] = model.image_groups();
    let factors = model.image_factors();
    let mut of_vehicles: Vec<Vec<Row>> = problem.vehicles.iter().map(|_| Vec::new()).collect();
    for (found, &(vehicle, item)) in of_group(in_vehicles).zip(&model.vehicle_items) {
        let sigma_px = problem.vehicles[vehicle].observations[item].sigma_px * factors[0];
        of_vehicles[vehicle].extend(rows(found, sigma_px));
    }
    let of_targets = of_group(in_targets)
        .zip(&model.target_items)
        .flat_map(|(found, &item)| rows(found, problem.target_observations[item].sigma_px * factors[1]));
    (of_vehicles, of_targets.collect())
}

fn reliability(rows: &[Row]) -> Reliability {
    if rows.is_empty() {
        return Reliability::default();
    }
    let median_and_last = |values: Vec<f64>| {
        let last = values.iter().copied().max_by(f64::total_cmp);
        [upper_median(values), last].map(|value| value.unwrap_or(f64::NAN))
    };
    let detectable = |row: &Row| match row.redundancy > UNCHECKED {
        true => NON_CENTRALITY * row.sigma_px / row.redundancy.sqrt(),
        false => f64::INFINITY,
    };
    let external = |row: &Row| match row.redundancy > UNCHECKED {
        true => NON_CENTRALITY * ((1.0 - row.redundancy).max(0.0) / row.redundancy).sqrt(),
        false => f64::INFINITY,
    };
    let standardised: Vec<f64> = rows
        .iter()
        .filter(|row| row.redundancy > UNCHECKED)
        .map(|row| row.residual.abs() / row.redundancy.sqrt())
        .collect();
    let [negative_median, negative_least] = median_and_last(rows.iter().map(|row| -row.redundancy).collect());
    Reliability {
        rows: rows.len(),
        redundancy_number: [-negative_least, -negative_median],
        minimal_detectable_px: median_and_last(rows.iter().map(detectable).collect()),
        external: median_and_last(rows.iter().map(external).collect()),
        beyond_critical: standardised.iter().filter(|w| **w > CRITICAL).count(),
        largest: standardised.iter().copied().fold(0.0, f64::max),
    }
}
