//! Where the time of `refine` goes on the problems that come with the program: medians by stage.
//!
//! `cargo bench --bench refine [-- RUNS]`

use std::path::Path;
use std::time::Instant;
use trackbundle::files::read_problem;
use trackbundle::initialise::{Method, initialise};
use trackbundle::refine::{RefineOptions, refine};

fn main() {
    // Cargo passes --bench along.
    let runs = std::env::args().skip(1).find_map(|a| a.parse().ok()).unwrap_or(5).max(1);
    println!(
        "{:12} {:>10} {:>12} {:>10} {:>12}",
        "problem", "read s", "initialise s", "refine s", "iterations"
    );
    for name in ["suv-exact", "suv-noisy"] {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("problems").join(name);
        let mut seconds: [Vec<f64>; 3] = Default::default();
        let mut iterations = 0;
        for _ in 0..runs {
            let begin = Instant::now();
            let folder = read_problem(&folder).unwrap_or_else(|findings| panic!("{findings}"));
            let problem = folder.problem.unwrap_or_else(|missing| panic!("{missing:?}"));
            seconds[0].push(begin.elapsed().as_secs_f64());
            let begin = Instant::now();
            let initial = initialise(&problem, Method::RobustWhereNeeded).expect("camera poses are given");
            seconds[1].push(begin.elapsed().as_secs_f64());
            let begin = Instant::now();
            let (_, adjustment) =
                refine(&problem, &initial.estimate, &RefineOptions::default(), None).unwrap();
            seconds[2].push(begin.elapsed().as_secs_f64());
            iterations = adjustment.iterations();
        }
        let [read, initial, refined] = seconds.map(|mut values| {
            values.sort_by(f64::total_cmp);
            values[values.len() / 2]
        });
        println!("{name:12} {read:10.3} {initial:12.3} {refined:10.3} {iterations:12}");
    }
}
