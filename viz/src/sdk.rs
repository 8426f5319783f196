//! Rerun's SDK under the names of the package `rerun`, which would bring a store, queries and the client of a
//! catalog besides.

pub use re_sdk::log::TimeColumn;
pub use re_sdk::*;
pub use re_sdk_types::archetypes::*;
pub use re_sdk_types::components::{self, MediaType, TextLogLevel};
pub use re_sdk_types::datatypes::Quaternion;

pub mod external {
    pub use re_sdk::external::*;
    pub use re_sdk_types;
}
