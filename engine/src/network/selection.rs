//! What takes part in a network, and what the network is for.

use crate::problem::Problem;
use crate::stats::normal::GROSS_SIGMAS;

/// An image point this many standard deviations off (times the spread of all) is a gross error. Good
/// ones get there once in half a million; the default loss rejects from here on.
pub const OUTLIER_SIGMAS: f64 = GROSS_SIGMAS;

/// Which image points take part.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Selection {
    /// For each vehicle, whether each of its observations does.
    pub vehicles: Vec<Vec<bool>>,
    /// Whether each observation of a target does.
    pub targets: Vec<bool>,
}

impl Purpose<'_> {
    /// To find the minimum from afar, while it is not known what of the frames of bodies is open.
    pub const FROM_AFAR: Purpose<'static> = Purpose::Adjustment { anchors: &[] };

    /// What holds the frame of each vehicle.
    pub fn anchors(&self) -> &[Anchors] {
        match self {
            Purpose::Adjustment { anchors } | Purpose::Statistics { anchors } => anchors,
        }
    }
}

impl Selection {
    /// All of them.
    pub fn everything(problem: &Problem) -> Selection {
        let all = |vehicle: &crate::problem::Vehicle| vec![true; vehicle.observations.len()];
        Selection {
            vehicles: problem.vehicles.iter().map(all).collect(),
            targets: vec![true; problem.target_observations.len()],
        }
    }
}

/// Points and axes whose coordinates hold what is open of the frame of a body.
pub type Anchors = Vec<(usize, usize)>;

/// What a network is for.
#[derive(Clone, Copy, Debug)]
pub enum Purpose<'a> {
    /// To find the minimum from afar, with robust losses.
    Adjustment {
        /// What holds the frame of each vehicle; none of any while it is not known what is open.
        anchors: &'a [Anchors],
    },
    /// Least squares on accepted image points and what is known: frames of bodies are held by as many
    /// coordinates as measurements leave open.
    Statistics {
        /// What holds the frame of each vehicle.
        anchors: &'a [Anchors],
    },
}
