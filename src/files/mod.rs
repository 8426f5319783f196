//! Problem folders in, result rows out and back in: the one place that knows the names of columns and keys.

mod checked;
mod inputs;
mod inventory;
mod problem_folder;
mod problem_toml;
mod result_folder;
mod result_tables;
pub mod rows;
pub mod section;
mod video;
mod written;

pub use checked::Folder;
pub use inputs::{InputFile, input_file, input_files, named_text};
pub use inventory::{Inventory, TargetInventory, VehicleInventory};
pub use problem_folder::{read_grid, read_problem};
pub use problem_toml::{read_camera, read_vehicle_id};
pub use result_folder::{ResultTracks, TrackPosition, read_tracks};
pub use result_tables::{
    RESIDUALS, ResultPoint, ResultPoses, ResultResidual, START_RESIDUALS, read_points, read_poses,
    read_report, read_residuals,
};
pub use written::{camera_pose_table, decimal, problem_files, vehicle_pose_table};
