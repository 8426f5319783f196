//! Problem folders in, result rows out and back in: the one place that knows the names of columns and keys.

mod cells;
mod checked;
mod inventory;
mod named;
mod problem_folder;
mod problem_toml;
mod result_folder;
mod result_residuals;
mod result_tables;
mod result_targets;
pub mod rows;
pub mod section;
mod sections;
mod tables;
mod written;

pub use cells::decimal;
pub use checked::Folder;
pub use inventory::Inventory;
pub use named::named_text;
pub use problem_folder::{read_grid, read_problem};

pub use result_folder::{ResultTracks, TrackPosition, read_tracks};
pub use result_residuals::{RESIDUALS, ResultResidual, ResultResiduals, START_RESIDUALS, read_residuals};
pub use result_tables::{ResultPoint, ResultPoses, read_points, read_poses, read_report};
pub use result_targets::{RESULT_TARGETS, ResultRole, ResultTarget, read_targets};
pub use sections::camera::read as read_camera;
pub use sections::vehicle::read_id as read_vehicle_id;
pub use tables::cameras::camera_pose_table;
pub use tables::targets::TargetInventory;
pub use tables::vehicles::{VehicleInventory, vehicle_pose_table};
pub use written::problem_files;
