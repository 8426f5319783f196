//! A problem as the files of its folder: what [`super::read_problem`] reads back.

use super::{problem_toml, tables};
use crate::problem::Problem;

/// The files of a problem folder: names and bytes. A grid of heights is not among them; `grid` is the name of
/// its file. One of `name`, ids of vehicles and of points may hold any text.
pub fn problem_files(problem: &Problem, grid: Option<&str>) -> Vec<(String, Vec<u8>)> {
    let settings = (problem_toml::FILE, problem_toml::written(problem, grid).into_bytes());
    let all = std::iter::once(settings).chain(tables::written(problem));
    all.map(|(name, bytes)| (name.to_owned(), bytes)).collect()
}
