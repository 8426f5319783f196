//! Rear axles of cars, which roll where they point.

use super::blocks::Blocks;
use super::sink::Sink;
use super::source::Source;
use crate::estimate::USUAL_AXLE;
use crate::problem::Problem;
use crate::residuals::known_coordinate::KnownNumber;
use crate::residuals::no_side_slip::NoSideSlip;
use trackbundle_solver::system::{BlockId, Measurement};

/// Slip of a rear axle across its direction, and how long it lasts \[m/s, s\].
const SLIP: (f64, f64) = (0.1, 1.0);
/// Standard deviation of the place of a rear axle \[m\], and of the direction in which it rolls \[rad\]: nothing
/// is known of that, since the x axis of a body is a convention.
const AXLE_SIGMA_M: f64 = 1.0;
const ROLLING_SIGMA_RAD: f64 = 0.2;

/// Rear axles of cars, which roll where they point, and what only keeps their direction near the x axis.
pub fn add_driving(sink: &mut impl Sink, problem: &Problem, blocks: &Blocks) {
    let (mut rolling, mut places, mut directions) = (Vec::new(), Vec::new(), Vec::new());
    for vehicle in &blocks.vehicles {
        let Some(axle) = vehicle.axle else { continue };
        let known = vehicle.poses.iter().enumerate().filter_map(|(frame, pose)| Some((frame, (*pose)?)));
        let known: Vec<(usize, BlockId)> = known.collect();
        for pair in known.windows(2) {
            let [(before, from), (after, to)] = [pair[0], pair[1]];
            let step_s = problem.frames[after].time_s - problem.frames[before].time_s;
            // Errors that last count once in twice that time.
            let sigma = SLIP.0 * (2.0 * SLIP.1 / step_s).max(1.0).sqrt();
            let residual = NoSideSlip { step_s };
            rolling.push(Measurement { residual, blocks: [from, to, axle], sigma: [sigma] });
        }
        let row = |at: usize, sigma: f64| {
            let residual = KnownNumber::<2> { at, known: USUAL_AXLE[at] };
            Measurement { residual, blocks: [axle], sigma: [sigma] }
        };
        places.push(row(0, AXLE_SIGMA_M));
        directions.push(row(1, ROLLING_SIGMA_RAD));
    }
    sink.squares(Source::Driving, "rolling of a rear axle", rolling);
    places.extend(directions);
    sink.squares(Source::Convention, "usual rear axle", places);
}
