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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::{Brown, Lens};
    use crate::files::read_problem;
    use std::path::Path;

    fn read_back(problem: &Problem) -> (String, Problem) {
        let folder = tempfile::tempdir().unwrap();
        for (name, bytes) in problem_files(problem, None) {
            let file = folder.path().join(name);
            std::fs::create_dir_all(file.parent().unwrap()).unwrap();
            std::fs::write(file, bytes).unwrap();
        }
        let text = std::fs::read_to_string(folder.path().join("problem.toml")).unwrap();
        let read = read_problem(folder.path()).unwrap_or_else(|findings| panic!("{findings}"));
        (text, read.problem.unwrap())
    }

    #[test]
    fn what_is_held_of_a_lens_is_written_where_there_is_some() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("problems/suv-noisy");
        let mut problem = read_problem(&folder).unwrap().problem.unwrap();
        assert_eq!(problem.check(), Ok(()));
        let coefficients = [-0.011, 0.002, 0.0, 0.0, 0.0];
        for (held, is_written) in
            [([0.0; 2], [false; 2]), ([0.0, 0.7], [false, true]), ([-0.01, 0.7], [true; 2])]
        {
            problem.camera.lens = Lens::Brown(Brown::with(coefficients, held));
            let (text, read) = read_back(&problem);
            assert_eq!([text.contains("k4 ="), text.contains("skew_px =")], is_written, "{text}");
            assert_eq!(read.camera, problem.camera);
            assert_eq!(read.check(), Ok(()));
            assert_eq!(read.target_observations.len(), problem.target_observations.len());
        }
    }
}
