//! What is adjusted beside poses and points: interior orientation, readout time, clocks, shifts, the bias of
//! the terrain.
//!
//! With the column `q = Q e` of the covariance that belongs to a number `p`, its variance is `e^T q`, and were
//! it held where it was before, the unknowns would be off by
//!
//! ```text
//! dx = q (p - p0) / (e^T q)
//! ```
//!
//! which is its effect on the result. A number that is known no better than before, or of which nothing but a
//! convention keeps it in its place, is not observable.

use super::inner::UNDETERMINED;
use super::scale::{share, track_shift};
use crate::estimate::{Estimate, USUAL_AXLE};
use crate::problem::{Freedom, Problem};
use crate::refine::{Model, Network, Source};
use crate::rules::rules;
use nalgebra::DMatrix;
use trackbundle_solver::covariance::Covariance;
use trackbundle_solver::system::BlockId;

/// Correlations beyond this are worth a word.
pub const CORRELATED: f64 = 0.95;
rules! {
    /// Numbers beside poses and points.
    pub struct ParameterRules {
        /// Not observable is what is known no better.
        not_observable_share: f64 = 0.95, "share of the standard deviation before";
    }
}

const RULES: ParameterRules = ParameterRules::DEFAULT;

/// A number that is adjusted.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameter {
    /// Its name, with its unit at the end: `readout_s`.
    pub name: &'static str,
    /// Whose: the vehicle and point of a receiver, say.
    pub of: Option<String>,
    /// What it was before.
    pub before: f64,
    /// Its standard deviation before; `None`: nothing was known.
    pub sigma_before: Option<f64>,
    /// Its value.
    pub value: f64,
    /// Its standard deviation a posteriori; infinite where nothing determines it.
    pub sigma: f64,
    /// Whether the observations say anything of it.
    pub is_observable: bool,
    /// How far the middle of a vehicle's shape would be, were it held at `before`: root mean square over the
    /// frames, of the vehicle that it moves most \[m\].
    pub effect_m: f64,
    /// Others with which it is correlated beyond [`CORRELATED`].
    pub correlated: Vec<(String, f64)>,
}

impl Parameter {
    /// Its name and whose it is.
    pub fn full_name(&self) -> String {
        match &self.of {
            None => self.name.to_owned(),
            Some(of) => format!("{} of {of}", self.name),
        }
    }
}

/// Where a number is, and what was known of it.
struct Place {
    block: BlockId,
    at: usize,
    /// What it is counted from: the point that an antenna stands on.
    from: Option<BlockId>,
    name: &'static str,
    of: Option<String>,
    before: f64,
    /// Standard deviation before; of a convention where nothing was known.
    sigma_before: Option<f64>,
    value: f64,
}

fn places(problem: &Problem, estimate: &Estimate, network: &Network) -> Vec<Place> {
    let model = &network.model;
    let mut all = camera_places(problem, estimate, model);
    all.extend(problem.ground.as_ref().map(|ground| Place {
        block: model.terrain_bias(),
        at: 0,
        from: None,
        name: "terrain_bias_m",
        of: None,
        before: 0.0,
        sigma_before: Some(ground.bias_sigma_m),
        value: estimate.terrain_bias_m,
    }));
    all.extend(axle_places(problem, estimate, model));
    all.extend(receiver_places(problem, estimate, model));
    all.retain(|place| {
        model.system.range_of(place.block).is_some() && model.system.free(place.block)[place.at]
    });
    all
}

/// The interior orientation and the readout time.
fn camera_places(problem: &Problem, estimate: &Estimate, model: &Model) -> Vec<Place> {
    let Some([interior, readout]) = model.open_camera() else { return Vec::new() };
    let names = problem.camera.interior_names();
    let (before, now) = (problem.camera.interior(), estimate.camera.interior());
    let of_interior = problem.calibration.iter().enumerate().map(|(at, freedom)| Place {
        block: interior,
        at,
        from: None,
        name: names[at],
        of: None,
        before: before[at],
        sigma_before: sigma_of(*freedom),
        value: now[at],
    });
    let readout = Place {
        block: readout,
        at: 0,
        from: None,
        name: "readout_s",
        of: None,
        before: problem.shutter.readout_s,
        sigma_before: sigma_of(problem.shutter.freedom),
        value: estimate.readout_s,
    };
    of_interior.chain([readout]).collect()
}

/// The rear axles of vehicles.
fn axle_places(problem: &Problem, estimate: &Estimate, model: &Model) -> Vec<Place> {
    let mut all = Vec::new();
    for (at, vehicle) in problem.vehicles.iter().enumerate() {
        let Some(axle) = model.axle(at) else { continue };
        for (k, name) in ["rear_axle_x_m", "rolling_direction_rad"].into_iter().enumerate() {
            all.push(Place {
                block: axle,
                at: k,
                from: None,
                name,
                of: Some(vehicle.id.clone()),
                before: USUAL_AXLE[k],
                sigma_before: None,
                value: estimate.vehicles[at].axle[k],
            });
        }
    }
    all
}

/// Clocks, shifts and lever arms of receivers.
fn receiver_places(problem: &Problem, estimate: &Estimate, model: &Model) -> Vec<Place> {
    let mut all = Vec::new();
    for (at, (receiver, found)) in problem.receivers.iter().zip(&estimate.receivers).enumerate() {
        let (Some(numbers), Some(antenna)) = (model.receiver(at), model.antenna(at)) else { continue };
        let known = &receiver.knowledge;
        let mut add = |block: BlockId, at: usize, name, before: f64, sigma_before, value: f64| {
            let of = Some(receiver.name(&problem.vehicles));
            let from =
                if block == antenna { model.shape_point(receiver.vehicle, receiver.point) } else { None };
            all.push(Place { block, at, from, name, of, before, sigma_before, value });
        };
        let offset = known.clock_offset;
        let before = offset.map_or(0.0, |offset| offset.value_s);
        add(numbers, 0, "clock_offset_s", before, offset.map(|o| o.sigma_s), found.clock_offset_s);
        add(numbers, 1, "clock_drift", 0.0, Some(known.drift_sigma), found.clock_drift);
        for (axis, name) in ["shift_x_m", "shift_y_m", "shift_z_m"].into_iter().enumerate() {
            add(numbers, 2 + axis, name, 0.0, Some(known.shift_sigma_m), found.shift_m[axis]);
        }
        if known.lever_sigma_m > 0.0 {
            for (axis, name) in ["lever_x_m", "lever_y_m", "lever_z_m"].into_iter().enumerate() {
                let (before, value) = (known.lever_arm_m[axis], found.lever_arm_m[axis]);
                add(antenna, axis, name, before, Some(known.lever_sigma_m), value);
            }
        }
    }
    all
}

fn sigma_of(freedom: Freedom) -> Option<f64> {
    match freedom {
        Freedom::Prior(sigma) => Some(sigma),
        Freedom::Fixed => Some(0.0),
        Freedom::Free => None,
    }
}

/// All that are adjusted.
pub fn parameters(
    problem: &Problem,
    estimate: &Estimate,
    network: &Network,
    covariance: &mut Covariance<'_>,
    variance_factor: f64,
) -> Vec<Parameter> {
    let system = &network.model.system;
    let places = places(problem, estimate, network);
    if places.is_empty() {
        return Vec::new();
    }
    let mut units = DMatrix::zeros(system.size(), places.len());
    for (column, place) in places.iter().enumerate() {
        let mut add = |block: BlockId, sign: f64| {
            if let Some(range) = system.range_of(block) {
                units[(range.start + place.at, column)] += sign;
            }
        };
        add(place.block, 1.0);
        place.from.into_iter().for_each(|from| add(from, -1.0));
    }
    let columns = covariance.times(&units);
    let covariance_of = units.tr_mul(&columns);
    let variance = |at: usize| covariance_of[(at, at)];
    let mut all: Vec<Parameter> = Vec::new();
    for (at, place) in places.iter().enumerate() {
        let own = variance(at);
        let is_convention = place.sigma_before.is_none()
            && share(network, Source::Convention, columns.column(at).as_slice(), own) > UNDETERMINED;
        let sigma = if is_convention { f64::INFINITY } else { (own * variance_factor).sqrt() };
        let is_observable = match place.sigma_before {
            None => !is_convention,
            Some(before) => own.sqrt() < RULES.not_observable_share * before,
        };
        let change = place.value - place.before;
        let step: Vec<f64> = columns.column(at).iter().map(|q| q * change / own).collect();
        let effect = |vehicle: usize| track_shift(estimate, network, vehicle, &step);
        let effect_m = (0..network.frames.len()).map(effect).fold(0.0, f64::max);
        all.push(Parameter {
            name: place.name,
            of: place.of.clone(),
            before: place.before,
            sigma_before: place.sigma_before,
            value: place.value,
            sigma,
            is_observable,
            effect_m,
            correlated: Vec::new(),
        });
    }
    for a in 0..places.len() {
        for b in 0..places.len() {
            let r = covariance_of[(a, b)] / (variance(a) * variance(b)).sqrt();
            if a != b && r.abs() > CORRELATED {
                let name = all[b].full_name();
                all[a].correlated.push((name, r));
            }
        }
    }
    all
}
