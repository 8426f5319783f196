//! Problem folders in, result rows out: the one place that knows the names of columns and keys.

mod problem_folder;
mod problem_toml;
pub mod rows;
mod section;

pub use problem_folder::{Folder, Inventory, TargetInventory, VehicleInventory, read_problem};
