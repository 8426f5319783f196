//! The disk: one door for reading files, and the places that results go to.
//!
//! ```text
//! path -> read -> bytes            a regular file of bounded size, or a clear refusal
//! path -> Place -> stage -> path   tried before anything is computed, put there whole, old or new at every moment
//! ```

mod inputs;
mod place;
mod read;
mod system;

pub use inputs::{InputFile, Inputs};
pub use place::{Place, PlaceFault, Published, abandon_all};
pub use read::{MOST_BYTES, read, read_text};
pub use system::{address_space_limit, largest_cache};
