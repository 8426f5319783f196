//! Tests of single numbers that the model holds: a readout time, a clock offset.
//!
//! The test of sigma0 over a hundred thousand rows does not see what one number does to a few of them. So each
//! is set free at the minimum where it is held, and one step is made. With its change `d` and the variance `q`
//! of that,
//!
//! ```text
//! w = d / sqrt(q)
//! ```
//!
//! is standard normal where the number is what it is held at (Rao's score test: to first order it is the
//! likelihood ratio test, without another adjustment).

use super::outcome::Fits;
use super::score_test::DirectedTest;
use super::{RefineOptions, statistical};
use crate::estimate::Estimate;
use crate::network::{BodyFrame, Model};
use crate::problem::{Freedom, Problem};
use nalgebra::DMatrix;
use trackbundle_solver::covariance::Undamped;
use trackbundle_solver::system::BlockId;

/// A number that would not be known better than this is not tested \[s\].
const MOST_SIGMA_S: f64 = 0.2;

/// What the least squares were made of.
pub struct Held<'a> {
    pub problem: &'a Problem,
    pub start: &'a Estimate,
    pub estimate: &'a Estimate,
    pub options: &'a RefineOptions,
    pub fits: &'a Fits,
    pub frames: &'a [BodyFrame],
    pub model: &'a Model,
}

/// Tests all numbers that are held: the readout time, and the clock offset of each receiver.
pub fn directed_tests(held: &Held<'_>) -> Vec<DirectedTest> {
    let problem = held.problem;
    let mut tests = Vec::new();
    if !problem.shutter.freedom.is_adjusted() {
        let mut freed = problem.clone();
        freed.shutter.freedom = Freedom::Free;
        let readout = |model: &Model| Some((model.open_camera()?[1], 0));
        let found = held.test(&freed, readout);
        tests.extend(found.map(|(change, sigma)| DirectedTest {
            name: "readout_s",
            of: None,
            held_at: problem.shutter.readout_s,
            estimate: problem.shutter.readout_s + change,
            sigma,
        }));
    }
    for (at, receiver) in problem.receivers.iter().enumerate() {
        let Some(offset) = receiver.knowledge.clock_offset.filter(|offset| offset.sigma_s == 0.0) else {
            continue;
        };
        let mut freed = problem.clone();
        freed.receivers[at].knowledge.clock_offset = None;
        let found = held.test(&freed, |model| Some((model.receiver(at)?, 0)));
        tests.extend(found.map(|(change, sigma)| DirectedTest {
            name: "clock_offset_s",
            of: Some(receiver.name(&problem.vehicles)),
            held_at: offset.value_s,
            estimate: offset.value_s + change,
            sigma,
        }));
    }
    tests
}

impl Held<'_> {
    /// The change of a number of a freed problem, and its standard deviation; `None` where it is not
    /// determined.
    fn test(
        &self,
        freed: &Problem,
        place: impl Fn(&Model) -> Option<(BlockId, usize)>,
    ) -> Option<(f64, f64)> {
        let mut model = statistical(freed, self.start, self.estimate, self.options, self.fits, self.frames);
        model.copy_motion(self.model);
        model.set_image_factors(self.model.image_factors());
        model.loosen_conventions();
        let (block, at) = place(&model)?;
        let row = model.system.range_of(block)?.start + at;
        let values = model.system.start().clone();
        let mut undamped = Undamped::new(&model.system, &values).ok()?;
        let step = undamped.newton_step();
        let mut unit = DMatrix::zeros(step.len(), 1);
        unit[(row, 0)] = 1.0;
        let sigma = undamped.times(&unit)[(row, 0)].sqrt();
        (sigma.is_finite() && sigma < MOST_SIGMA_S).then_some((step[row], sigma))
    }
}
