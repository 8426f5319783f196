//! Measurements of one kind under one loss.

use super::accumulators::{Entry, Local, Moment, Part};
use super::layout::{BlockId, Layout, Values};
use super::model::Curvature;
use crate::linear::small::{POINT, POSE};
use crate::loss::Loss;
use crate::manifold::{MAX_TANGENT, Manifold};
use crate::residual::{Jacobian, Residual};
use nalgebra::{SMatrix, SVector};
use pulp::{Arch, Simd, WithSimd};

/// A measurement whose geometry is impossible, such as a point behind the camera, costs as much as
/// one that is this many standard deviations off, and pulls nowhere.
pub const IMPOSSIBLE_SIGMAS: f64 = 1e4;

/// A residual, the blocks it sees, and the standard deviation of each of its rows.
#[derive(Clone, Debug)]
pub struct Measurement<R, const ROWS: usize, const BLOCKS: usize> {
    /// The measurement.
    pub residual: R,
    /// Its blocks.
    pub blocks: [BlockId; BLOCKS],
    /// Standard deviations, in the unit of the residual, above zero.
    pub sigma: [f64; ROWS],
}

pub(super) struct Group<R, const ROWS: usize, const BLOCKS: usize> {
    pub name: &'static str,
    pub loss: Loss,
    /// Of the standard deviations of each row.
    pub sigma_factors: [f64; ROWS],
    pub measurements: Vec<Measurement<R, ROWS, BLOCKS>>,
}

/// A whitened, weighted residual, and what makes its Jacobian so.
struct Weighed<const ROWS: usize> {
    residual: SVector<f64, ROWS>,
    factor: SVector<f64, ROWS>,
    /// Along the residual, of squared length `1 - flat`.
    along: SVector<f64, ROWS>,
}

impl<const ROWS: usize> Weighed<ROWS> {
    #[inline(always)]
    fn column(&self, jacobian: &SMatrix<f64, ROWS, MAX_TANGENT>, column: usize) -> SVector<f64, ROWS> {
        let scaled = jacobian.column(column).component_mul(&self.factor);
        scaled - self.along * self.along.dot(&scaled)
    }
}

/// What the system asks of a group, whatever its kind. It is compiled for each kind of measurement, so it is
/// little: what is done with all items of a group, and in parallel, stands once, in `whole_group`.
pub(super) trait AnyGroup: Send + Sync {
    fn len(&self) -> usize;
    fn rows(&self) -> usize;
    fn blocks(&self, item: usize) -> &[BlockId];
    fn manifolds(&self) -> &'static [Manifold];
    fn loss(&self) -> Loss;
    fn set_loss(&mut self, loss: Loss);
    /// As many as a measurement has rows.
    fn set_sigma_factors(&mut self, factors: &[f64]);
    fn sigma_factors(&self) -> &[f64];
    /// Whitened residuals of the items from `first` on, as many as `out` has room for; NaN where the geometry is
    /// impossible.
    fn residuals_from(&self, first: usize, layout: &Layout, values: &Values, out: &mut [f64]);
    /// Linearises the items from `first` on, as many as there is room for. Columns of what is held are zero,
    /// and so is all of what pulls nowhere.
    fn linearise_from(
        &self,
        first: usize,
        layout: &Layout,
        values: &Values,
        least_flatness: f64,
        residuals: &mut [f64],
        jacobians: &mut [f64],
    );
    /// Adds image points of a body at a moment: observer, body and point are their first blocks.
    fn add_to_moment(
        &self,
        items: &[(u32, u32)],
        layout: &Layout,
        values: &Values,
        least_flatness: f64,
        moment: &mut Moment<'_>,
    );
    /// Appends measurements that see this leaf, linearised.
    fn linearise_leaf(
        &self,
        items: &[(u32, u32)],
        leaf: usize,
        layout: &Layout,
        values: &Values,
        least_flatness: f64,
        local: &mut Local,
    );
}

/// A system at some values, to be linearised with some curvature.
#[derive(Clone, Copy)]
pub(super) struct State<'a> {
    pub layout: &'a Layout,
    pub groups: &'a [Box<dyn AnyGroup>],
    pub values: &'a Values,
    pub curvature: Curvature,
}

impl<const ROWS: usize, const BLOCKS: usize, R: Residual<ROWS, BLOCKS>> Group<R, ROWS, BLOCKS> {
    /// The whitened residual; the Jacobian that comes back is not whitened.
    #[inline(always)]
    fn whitened(
        &self,
        measurement: &Measurement<R, ROWS, BLOCKS>,
        layout: &Layout,
        values: &Values,
        jacobian: Option<&mut Jacobian<ROWS, BLOCKS>>,
    ) -> Option<SVector<f64, ROWS>> {
        let x = measurement.blocks.map(|block| layout.value(values, block));
        let mut residual = measurement.residual.evaluate(&x, jacobian)?;
        for ((value, sigma), factor) in residual.iter_mut().zip(measurement.sigma).zip(self.sigma_factors) {
            *value /= sigma * factor;
        }
        residual.iter().all(|v| v.is_finite()).then_some(residual)
    }

    /// A measurement as a row of least squares; `None` where it pulls nowhere.
    ///
    /// Gauss-Newton for a robust loss: `J~ = sqrt(rho') F J` and `r~ = sqrt(rho') F^-1 r` have the
    /// gradient of `rho(s) / 2`. `F` flattens the curvature along `r` to that of the loss
    /// ([`Loss::flatness`]); where it is 1, this is iteratively re-weighted least squares.
    #[inline(always)]
    fn weighed(
        &self,
        measurement: &Measurement<R, ROWS, BLOCKS>,
        layout: &Layout,
        values: &Values,
        least_flatness: f64,
        jacobian: &mut Jacobian<ROWS, BLOCKS>,
    ) -> Option<Weighed<ROWS>> {
        let residual = self.whitened(measurement, layout, values, Some(jacobian))?;
        let squared = residual.norm_squared();
        let root = match self.loss {
            Loss::Squared => 1.0,
            loss => loss.weight(squared).sqrt(),
        };
        if root == 0.0 {
            return None;
        }
        let factor = SVector::from_fn(|row, _| root / (measurement.sigma[row] * self.sigma_factors[row]));
        let flat = self.loss.flatness(squared, least_flatness).sqrt();
        let along =
            if flat < 1.0 { residual * ((1.0 - flat).sqrt() / squared.sqrt()) } else { SVector::zeros() };
        Some(Weighed { residual: residual * (root / flat), factor, along })
    }

    fn linearise_one(
        &self,
        measurement: &Measurement<R, ROWS, BLOCKS>,
        layout: &Layout,
        values: &Values,
        least_flatness: f64,
        residual_out: &mut [f64],
        jacobian_out: &mut [f64],
    ) {
        residual_out.fill(0.0);
        jacobian_out.fill(0.0);
        let mut jacobian = Jacobian::zeros();
        let Some(weighed) = self.weighed(measurement, layout, values, least_flatness, &mut jacobian) else {
            return;
        };
        residual_out.copy_from_slice(weighed.residual.as_slice());
        let mut columns = jacobian_out.chunks_exact_mut(ROWS);
        for (block, manifold) in R::MANIFOLDS.iter().enumerate() {
            let free = layout.free(measurement.blocks[block]);
            for (column, free) in (0..manifold.tangent()).zip(free) {
                let out = columns.next().expect("one column a perturbation");
                if *free {
                    out.copy_from_slice(weighed.column(&jacobian.0[block], column).as_slice());
                }
            }
        }
    }
}

impl<const ROWS: usize, const BLOCKS: usize, R: Residual<ROWS, BLOCKS>> Group<R, ROWS, BLOCKS> {
    #[inline(always)]
    fn append_to_leaf(
        &self,
        measurement: &Measurement<R, ROWS, BLOCKS>,
        leaf: usize,
        layout: &Layout,
        values: &Values,
        least_flatness: f64,
        local: &mut Local,
    ) {
        let mut jacobian = Jacobian::zeros();
        let Some(weighed) = self.weighed(measurement, layout, values, least_flatness, &mut jacobian) else {
            return;
        };
        let row = local.residuals.len();
        let (first_part, mut width) = (local.parts.len(), 0);
        local.residuals.extend_from_slice(weighed.residual.as_slice());
        for (block, manifold) in measurement.blocks.iter().zip(R::MANIFOLDS) {
            if let Some(position) = layout.position[block.0].filter(|_| block.0 != leaf) {
                local.parts.push(Part { position, dim: manifold.tangent(), column: width });
                width += manifold.tangent();
            }
        }
        let other = local.other.len();
        for (b, manifold) in R::MANIFOLDS.iter().enumerate() {
            for c in 0..manifold.tangent() {
                let column = weighed.column(&jacobian.0[b], c);
                jacobian.0[b].set_column(c, &column);
            }
        }
        for k in 0..ROWS {
            for (b, manifold) in R::MANIFOLDS.iter().enumerate() {
                let block = measurement.blocks[b].0;
                let out = if block == leaf {
                    &mut local.leaf
                } else if layout.position[block].is_some() {
                    &mut local.other
                } else {
                    continue;
                };
                let free = &layout.blocks[block].free;
                let mut row = [0.0; MAX_TANGENT];
                for c in 0..manifold.tangent() {
                    row[c] = if free[c] { jacobian.0[b][(k, c)] } else { 0.0 };
                }
                out.extend_from_slice(&row[..manifold.tangent()]);
            }
        }
        let parts = (first_part, local.parts.len());
        local.entries.push(Entry { row, rows: ROWS, parts, other, width });
    }
}

impl<const ROWS: usize, const BLOCKS: usize, R: Residual<ROWS, BLOCKS>> Group<R, ROWS, BLOCKS> {
    #[inline(always)]
    fn add_one_to_moment(
        &self,
        measurement: &Measurement<R, ROWS, BLOCKS>,
        layout: &Layout,
        values: &Values,
        least_flatness: f64,
        moment: &mut Moment<'_>,
    ) {
        let point = measurement.blocks[2];
        let place = layout.position[point.0].map(|_| {
            let at = *moment.points.split_off_first().expect("a place for each point") as usize;
            let block = moment.coupling.split_off_first_mut().expect("a block for each point");
            *block = [[0.0; POSE]; POINT];
            (at, block)
        });
        let mut jacobian = Jacobian::zeros();
        let Some(weighed) = self.weighed(measurement, layout, values, least_flatness, &mut jacobian) else {
            return;
        };
        let residual = &weighed.residual;
        let of_pose: [SVector<f64, ROWS>; POSE] = std::array::from_fn(|k| weighed.column(&jacobian.0[1], k));
        for i in 0..POSE {
            moment.of_pose[i] += of_pose[i].dot(residual);
            for j in 0..=i {
                moment.by_pose[i][j] += of_pose[i].dot(&of_pose[j]);
            }
        }
        let Some((at, block)) = place else { return };
        let free = &layout.blocks[point.0].free;
        let of_point: [SVector<f64, ROWS>; POINT] =
            std::array::from_fn(
                |i| {
                    if free[i] { weighed.column(&jacobian.0[2], i) } else { SVector::zeros() }
                },
            );
        let own = &mut moment.by_point[POINT * at..][..POINT * POINT];
        let gradient = &mut moment.of_point[at..][..POINT];
        for i in 0..POINT {
            gradient[i] += of_point[i].dot(residual);
            for j in 0..POINT {
                own[i * POINT + j] += of_point[i].dot(&of_point[j]);
            }
            for k in 0..POSE {
                block[i][k] = of_point[i].dot(&of_pose[k]);
            }
        }
    }
}

/// [`Group::add_one_to_moment`] with the vector instructions that the machine has.
struct AddToMoment<'a, 'm, R, const ROWS: usize, const BLOCKS: usize> {
    group: &'a Group<R, ROWS, BLOCKS>,
    items: &'a [(u32, u32)],
    layout: &'a Layout,
    values: &'a Values,
    least_flatness: f64,
    moment: &'a mut Moment<'m>,
}

impl<const ROWS: usize, const BLOCKS: usize, R: Residual<ROWS, BLOCKS>> WithSimd
    for AddToMoment<'_, '_, R, ROWS, BLOCKS>
{
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let AddToMoment { group, items, layout, values, least_flatness, moment } = self;
        for (_, item) in items {
            let measurement = &group.measurements[*item as usize];
            group.add_one_to_moment(measurement, layout, values, least_flatness, moment);
        }
    }
}

/// [`Group::append_to_leaf`] with the vector instructions that the machine has.
struct AppendToLeaf<'a, R, const ROWS: usize, const BLOCKS: usize> {
    group: &'a Group<R, ROWS, BLOCKS>,
    items: &'a [(u32, u32)],
    leaf: usize,
    layout: &'a Layout,
    values: &'a Values,
    least_flatness: f64,
    local: &'a mut Local,
}

impl<const ROWS: usize, const BLOCKS: usize, R: Residual<ROWS, BLOCKS>> AppendToLeaf<'_, R, ROWS, BLOCKS> {
    #[inline(always)]
    fn run(self) {
        let AppendToLeaf { group, items, leaf, layout, values, least_flatness, local } = self;
        for (_, item) in items {
            let measurement = &group.measurements[*item as usize];
            group.append_to_leaf(measurement, leaf, layout, values, least_flatness, local);
        }
    }
}

impl<const ROWS: usize, const BLOCKS: usize, R: Residual<ROWS, BLOCKS>> WithSimd
    for AppendToLeaf<'_, R, ROWS, BLOCKS>
{
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        self.run();
    }
}

impl<const ROWS: usize, const BLOCKS: usize, R: Residual<ROWS, BLOCKS>> AnyGroup for Group<R, ROWS, BLOCKS> {
    fn len(&self) -> usize {
        self.measurements.len()
    }

    fn rows(&self) -> usize {
        ROWS
    }

    fn blocks(&self, item: usize) -> &[BlockId] {
        &self.measurements[item].blocks
    }

    fn manifolds(&self) -> &'static [Manifold] {
        &R::MANIFOLDS
    }

    fn loss(&self) -> Loss {
        self.loss
    }

    fn set_loss(&mut self, loss: Loss) {
        self.loss = loss;
    }

    fn set_sigma_factors(&mut self, factors: &[f64]) {
        let are_factors = factors.iter().all(|factor| *factor > 0.0 && factor.is_finite());
        assert!(are_factors, "sigma factors of {}: {factors:?}", self.name);
        self.sigma_factors.copy_from_slice(factors);
    }

    fn sigma_factors(&self) -> &[f64] {
        &self.sigma_factors
    }

    fn residuals_from(&self, first: usize, layout: &Layout, values: &Values, out: &mut [f64]) {
        for (measurement, out) in self.measurements[first..].iter().zip(out.chunks_exact_mut(ROWS)) {
            match self.whitened(measurement, layout, values, None) {
                Some(residual) => out.copy_from_slice(residual.as_slice()),
                None => out.fill(f64::NAN),
            }
        }
    }

    fn linearise_from(
        &self,
        first: usize,
        layout: &Layout,
        values: &Values,
        least_flatness: f64,
        residuals: &mut [f64],
        jacobians: &mut [f64],
    ) {
        let columns: usize = R::MANIFOLDS.iter().map(|m| m.tangent()).sum();
        for ((measurement, residual), jacobian) in self.measurements[first..]
            .iter()
            .zip(residuals.chunks_exact_mut(ROWS))
            .zip(jacobians.chunks_exact_mut(ROWS * columns))
        {
            self.linearise_one(measurement, layout, values, least_flatness, residual, jacobian);
        }
    }

    fn add_to_moment(
        &self,
        items: &[(u32, u32)],
        layout: &Layout,
        values: &Values,
        least_flatness: f64,
        moment: &mut Moment<'_>,
    ) {
        // Without a third block there is no point of a body.
        if const { BLOCKS > 2 } {
            Arch::new().dispatch(AddToMoment { group: self, items, layout, values, least_flatness, moment });
        }
    }

    fn linearise_leaf(
        &self,
        items: &[(u32, u32)],
        leaf: usize,
        layout: &Layout,
        values: &Values,
        least_flatness: f64,
        local: &mut Local,
    ) {
        let work = AppendToLeaf { group: self, items, leaf, layout, values, least_flatness, local };
        // Image points are many; the code for each kind of machine is not worth its size for others.
        if const { ROWS == 2 } {
            Arch::new().dispatch(work);
        } else {
            work.run();
        }
    }
}
