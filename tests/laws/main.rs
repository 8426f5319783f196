//! What holds for the sources, the manifest and the documents; nothing of the library is run.

mod documents;
mod floor_plan;
mod packages;
#[path = "../support/place.rs"]
mod support;
