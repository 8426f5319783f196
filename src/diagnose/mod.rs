//! How far a result can be trusted: what is determined and by what, standard deviations, tests.

pub mod observability;
