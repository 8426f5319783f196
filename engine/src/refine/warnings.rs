//! What is odd about an adjustment, and why there may be none, as data.

use crate::estimate::LeftOut;
use crate::network::NetworkWarning;
use trackbundle_solver::minimise::Stop;
use trackbundle_solver::{Singular, TooLarge};

/// What is odd about an adjustment.
#[derive(Clone, Debug, PartialEq)]
pub enum AdjustmentWarning {
    /// About its network.
    Network(NetworkWarning),
    /// The final least squares could not be solved.
    NoLeastSquares,
    /// It has not converged.
    NotConverged {
        /// Why it stopped.
        stop: Stop,
    },
    /// Points lie behind the camera.
    BehindCamera {
        /// How many image points they have there.
        image_points: usize,
    },
    /// Poses left the terrain grid.
    ContactsLost {
        /// How many.
        contacts: usize,
    },
    /// Image points of vehicles scatter more than stated.
    VehiclesScatter {
        /// By what factor.
        factor: f64,
        /// Up to which nothing is said.
        limit: f64,
    },
    /// Points whose image points are gross errors, but for one at most.
    PointsRejected {
        /// The vehicle.
        vehicle: String,
        /// Which.
        points: Vec<String>,
    },
}

/// The problem has no usable solution.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum NoSolution {
    /// Every vehicle is left out.
    NoVehicle {
        /// Each by its id, and why.
        left_out: Vec<(String, LeftOut)>,
    },
    /// The adjustment does not end in finite numbers.
    NotFinite,
    /// No image point of a vehicle fits.
    NothingFits,
    /// All poses are exact, and no point has coordinates that are to be adjusted.
    NothingToAdjust,
    /// The normal equations do not fit into memory.
    TooLarge(TooLarge),
    /// The normal equations have no factorisation.
    Singular(Singular),
}

impl From<TooLarge> for NoSolution {
    fn from(error: TooLarge) -> Self {
        NoSolution::TooLarge(error)
    }
}

impl From<Singular> for NoSolution {
    fn from(error: Singular) -> Self {
        NoSolution::Singular(error)
    }
}
