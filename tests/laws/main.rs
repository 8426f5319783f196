//! What holds for the sources, the manifest and the documents; nothing of the library is run.

mod floor_plan;
#[path = "../support/place.rs"]
mod support;
