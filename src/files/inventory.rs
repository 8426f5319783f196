//! What is in a problem folder, counted.

use super::tables::targets::TargetInventory;
use super::tables::vehicles::VehicleInventory;
use crate::problem::{Frame, Vehicle};

/// What is in a problem folder.
#[derive(Clone, Debug)]
pub struct Inventory {
    /// Name of the problem.
    pub name: String,
    /// How many frames.
    pub frames: usize,
    /// First and last video time \[s\].
    pub time_s: [f64; 2],
    /// Width and height of the image \[px\].
    pub size_px: [u32; 2],
    /// How many frames have a camera pose.
    pub camera_poses: usize,
    /// The vehicles.
    pub vehicles: Vec<VehicleInventory>,
    /// The targets.
    pub targets: TargetInventory,
}

impl Inventory {
    /// Counts what is there.
    pub(super) fn new(
        name: &str,
        size_px: [u32; 2],
        frames: &[Frame],
        camera_poses: usize,
        vehicles: &[Vehicle],
        targets: TargetInventory,
    ) -> Inventory {
        Inventory {
            name: name.to_owned(),
            frames: frames.len(),
            time_s: [frames[0].time_s, frames[frames.len() - 1].time_s],
            size_px,
            camera_poses,
            vehicles: vehicles.iter().map(|vehicle| VehicleInventory::new(vehicle, frames)).collect(),
            targets,
        }
    }
}
