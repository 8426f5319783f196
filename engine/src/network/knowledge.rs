//! What is known beforehand of points, heights, distances, the terrain as a whole and the camera.

use super::blocks::Blocks;
use super::highest::Highest;
use super::sink::Sink;
use super::source::Source;
use crate::problem::{Freedom, Known, Problem};
use crate::residuals::known_coordinate::{KnownCoordinate, KnownNumber, KnownZero};
use crate::residuals::known_distance::KnownDistance;
use trackbundle_solver::system::{BlockId, Measurement};

/// Least standard deviation of a known height of a body \[m\].
pub const LEAST_HEIGHT_SIGMA_M: f64 = 1e-4;

/// Known coordinates of a point as measurements; one that is known exactly is held and needs none.
fn coordinates(
    block: Option<BlockId>,
    known: &[Option<Known>; 3],
) -> Vec<Measurement<KnownCoordinate, 1, 1>> {
    let Some(block) = block else { return Vec::new() };
    let one = |axis: usize| {
        let Known { value_m: known_m, sigma_m } = known[axis].filter(|known| known.sigma_m > 0.0)?;
        Some(Measurement { residual: KnownCoordinate { axis, known_m }, blocks: [block], sigma: [sigma_m] })
    };
    (0..3).filter_map(one).collect()
}

/// Adds what is known of targets, of points, heights and distances of bodies, and of the terrain as a whole.
pub fn add_knowledge(sink: &mut impl Sink, problem: &Problem, blocks: &Blocks, highest: &[Option<Highest>]) {
    let of_targets = problem.targets.iter().zip(&blocks.targets);
    let survey = of_targets.flat_map(|(target, block)| coordinates(*block, &target.known)).collect();
    let (mut points, mut heights) = (Vec::new(), Vec::new());
    for ((vehicle, own), highest) in problem.vehicles.iter().zip(&blocks.vehicles).zip(highest) {
        for (point, block) in vehicle.points.iter().zip(&own.points) {
            points.extend(coordinates(*block, &point.known));
        }
        let highest = highest.and_then(|highest| Some((own.points[highest.point]?, highest)));
        if let (Some((block, highest)), Some(Known { value_m, sigma_m })) = (highest, vehicle.height) {
            let residual = KnownCoordinate { axis: 2, known_m: value_m + highest.above_m };
            let sigma = [sigma_m.max(LEAST_HEIGHT_SIGMA_M).hypot(highest.above_sigma_m)];
            heights.push(Measurement { residual, blocks: [block], sigma });
        }
    }
    let bias_sigma_m = problem.ground.as_ref().map_or(0.0, |ground| ground.bias_sigma_m);
    let bias = (bias_sigma_m > 0.0).then_some(Measurement {
        residual: KnownZero,
        blocks: [blocks.bias],
        sigma: [bias_sigma_m],
    });
    sink.squares(Source::Survey, "surveyed coordinate of a target", survey);
    sink.squares(Source::KnownPoint, "known coordinate of a shape point", points);
    sink.squares(Source::KnownHeight, "known height of a body", heights);
    sink.squares(Source::KnownDistance, "known distance of two shape points", scale_bars(problem, blocks));
    sink.squares(Source::Terrain, "bias of the terrain", bias.into_iter().collect());
}

/// Known distances between points of a vehicle that have places.
fn scale_bars(problem: &Problem, blocks: &Blocks) -> Vec<Measurement<KnownDistance, 1, 2>> {
    let mut rows = Vec::new();
    for (vehicle, own) in problem.vehicles.iter().zip(&blocks.vehicles) {
        for bar in &vehicle.scale_bars {
            let [Some(a), Some(b)] = bar.points.map(|point| own.points[point]) else { continue };
            let residual = KnownDistance { length_m: bar.length_m };
            rows.push(Measurement { residual, blocks: [a, b], sigma: [bar.sigma_m] });
        }
    }
    rows
}

/// By what a number of an interior orientation that is free is kept near its start: as much as no lens is off.
fn conventional(problem: &Problem, at: usize) -> f64 {
    let camera = &problem.camera;
    match at {
        0 => 0.2 * camera.focal_px.x,
        1 | 2 => 0.2 * f64::from(camera.size_px[0]),
        _ => 1.0,
    }
}

/// By what a readout time that is free is kept near its start \[s\].
const CONVENTIONAL_READOUT_S: f64 = 0.1;

/// What is known of the camera beforehand, and what only keeps it near its start.
pub fn add_camera_knowledge(sink: &mut impl Sink, problem: &Problem, open: Option<[BlockId; 2]>) {
    let (mut known, mut kept, mut readout_known, mut readout_kept) =
        (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    if let Some([interior, readout]) = open {
        for (at, (freedom, value)) in problem.calibration.iter().zip(problem.camera.interior()).enumerate() {
            let row = |sigma: f64| Measurement {
                residual: KnownNumber::<{ crate::camera::INTERIOR }> { at, known: value },
                blocks: [interior],
                sigma: [sigma],
            };
            match *freedom {
                Freedom::Fixed => {}
                Freedom::Prior(sigma) => known.push(row(sigma)),
                Freedom::Free => kept.push(row(conventional(problem, at))),
            }
        }
        let row = |sigma: f64| Measurement {
            residual: KnownNumber::<1> { at: 0, known: problem.shutter.readout_s },
            blocks: [readout],
            sigma: [sigma],
        };
        match problem.shutter.freedom {
            Freedom::Fixed => {}
            Freedom::Prior(sigma) => readout_known.push(row(sigma)),
            Freedom::Free => readout_kept.push(row(CONVENTIONAL_READOUT_S)),
        }
    }
    sink.squares(Source::Calibration, "known interior orientation", known);
    sink.squares(Source::Readout, "known readout time", readout_known);
    sink.squares(Source::Convention, "start of the interior orientation", kept);
    sink.squares(Source::Convention, "start of the readout time", readout_kept);
}
