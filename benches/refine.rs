//! Where the time of `refine` goes on the problems that come with the program: medians by stage.
//!
//! `cargo bench --bench refine [-- RUNS]`

use std::path::Path;
use std::time::Instant;
use trackbundle::{Options, Outcome, Seconds, adjust_folder};

fn main() {
    // Cargo passes --bench along.
    let runs = std::env::args().skip(1).find_map(|a| a.parse().ok()).unwrap_or(5).max(1);
    println!(
        "{:12} {:>10} {:>12} {:>10} {:>10} {:>14} {:>12}",
        "problem", "read s", "initialise s", "refine s", "diagnose s", "2,000 states s", "iterations"
    );
    for name in ["suv-exact", "suv-noisy"] {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("problems").join(name);
        let mut seconds: [Vec<f64>; 5] = Default::default();
        let mut iterations = 0;
        for _ in 0..runs {
            let outcome = adjust_folder(&folder, &Options::default()).unwrap_or_else(|e| panic!("{e}"));
            let Seconds { read, initialise, refine, diagnose } = outcome.seconds;
            let all = [read, initialise, refine, diagnose, states_s(&outcome)];
            seconds.iter_mut().zip(all).for_each(|(seconds, one)| seconds.push(one));
            iterations = outcome.adjustment().iterations();
        }
        let [read, initial, refined, diagnosed, states] = seconds.map(|mut values| {
            values.sort_by(f64::total_cmp);
            values[values.len() / 2]
        });
        println!(
            "{name:12} {read:10.3} {initial:12.3} {refined:10.3} {diagnosed:10.3} {states:14.4} {iterations:12}"
        );
    }
}

/// How long 2,000 positions and velocities of the path between the poses take \[s\].
fn states_s(outcome: &Outcome) -> f64 {
    let (vehicle, found) = (&outcome.problem.vehicles[0], &outcome.estimate().vehicles[0]);
    let path = found.path(&outcome.problem, vehicle).expect("the adjustment knows how it moves");
    let (first, last) = (outcome.problem.frames[0].time_s, outcome.problem.frames.last().unwrap().time_s);
    let begin = Instant::now();
    for k in 0..2000 {
        std::hint::black_box(path.state_at(first + (last - first) * f64::from(k) / 2000.0));
    }
    begin.elapsed().as_secs_f64()
}
