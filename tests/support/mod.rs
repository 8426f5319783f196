//! What several test files need.
#![allow(dead_code, missing_docs)]

pub mod score;
