//! What is known of clocks, rows and lenses.

use super::Vehicle;
use crate::camera::INTERIOR;
use nalgebra::{Point3, Vector3};

/// Whether a number is adjusted.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Freedom {
    /// It is what it is said to be.
    #[default]
    Fixed,
    /// It is adjusted, and known beforehand with this standard deviation.
    Prior(f64),
    /// It is adjusted, and nothing is known of it.
    Free,
}

impl Freedom {
    /// Whether it is adjusted.
    pub fn is_adjusted(self) -> bool {
        self != Freedom::Fixed
    }
}

/// The time from the first to the last row of an image \[s\].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Shutter {
    /// What it is known to be.
    pub readout_s: f64,
    /// Whether it is adjusted.
    pub freedom: Freedom,
}

impl Shutter {
    /// Whether rows are exposed one after another.
    pub fn is_rolling(self) -> bool {
        self.readout_s != 0.0 || self.freedom.is_adjusted()
    }
}

/// Which numbers of the interior orientation are adjusted, in the order of
/// [`crate::camera::Camera::interior`].
pub type Calibration = [Freedom; INTERIOR];

/// A receiver on a vehicle whose positions are observations.
#[derive(Clone, Debug, PartialEq)]
pub struct Receiver {
    /// Index of the vehicle.
    pub vehicle: usize,
    /// Index of the point at its antenna.
    pub point: usize,
    /// Its positions, in time order.
    pub positions: Vec<ReceivedPosition>,
    /// What is known of its clock and its errors.
    pub knowledge: ReceiverKnowledge,
}

/// A measured position of an antenna.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReceivedPosition {
    /// Time on the receiver's clock \[s\].
    pub time_s: f64,
    /// Position in the world \[m\].
    pub position: Point3<f64>,
    /// Standard deviation per axis \[m\], above zero.
    pub sigma_m: [f64; 3],
}

/// A time that is known beforehand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KnownTime {
    /// The time \[s\].
    pub value_s: f64,
    /// Its standard deviation \[s\]; zero: exact and held.
    pub sigma_s: f64,
}

/// What is known of a receiver beforehand: `[gnss]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReceiverKnowledge {
    /// Its time minus video time \[s\]; `None`: nothing is known.
    pub clock_offset: Option<KnownTime>,
    /// Standard deviation of the rate of this offset \[s/s\]; zero: it does not drift.
    pub drift_sigma: f64,
    /// Standard deviation per axis of an error that all positions have in common \[m\]; zero: there is none.
    pub shift_sigma_m: f64,
    /// From the point to the antenna's phase centre, in the vehicle frame \[m\].
    pub lever_arm_m: Vector3<f64>,
    /// Its standard deviation per axis \[m\].
    pub lever_sigma_m: f64,
}

impl Default for ReceiverKnowledge {
    fn default() -> Self {
        ReceiverKnowledge {
            clock_offset: None,
            drift_sigma: 0.0,
            shift_sigma_m: 0.0,
            lever_arm_m: Vector3::zeros(),
            lever_sigma_m: 0.0,
        }
    }
}

impl Receiver {
    /// The name of its antenna: `car1 x-mark`.
    pub fn name(&self, vehicles: &[Vehicle]) -> String {
        let vehicle = &vehicles[self.vehicle];
        format!("{} {}", vehicle.id, vehicle.points[self.point].id)
    }
}
