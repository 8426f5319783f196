//! Statistical studies whose tables stand in the documents: hundreds of adjustments each. Their short forms run with
//! all tests, from the same files.
//!
//! ```text
//! cargo bench --bench studies            # says what there is
//! cargo bench --bench studies statistics
//! ```
//!
//! A study prints what it finds, and ends with an error where that is not what it should be.

#[path = "../tests/library/convergence.rs"]
#[allow(dead_code, unused_imports)]
mod convergence;
#[path = "../tests/library/gross_errors.rs"]
#[allow(dead_code, unused_imports)]
mod gross_errors;
#[path = "../tests/program/study.rs"]
#[allow(dead_code, unused_imports)]
mod honesty;
#[path = "../tests/program/moving_parts.rs"]
#[allow(dead_code, unused_imports)]
mod moving_parts;
#[path = "../tests/library/registration.rs"]
#[allow(dead_code, unused_imports)]
mod registration;
#[path = "../tests/library/statistics.rs"]
#[allow(dead_code, unused_imports)]
mod statistics;
#[path = "../tests/support/mod.rs"]
mod support;

/// A study: its name, its parts, and what it takes.
type Study = (&'static str, &'static [fn()], &'static str);

const STUDIES: &[Study] = &[
    ("convergence", &[convergence::study], "200 wrong starts: some minutes"),
    ("gross_errors", &[gross_errors::study], "500 adjustments: two minutes"),
    ("honesty", &[honesty::study_of_honesty], "1,000 adjustments: some minutes"),
    (
        "moving_parts",
        &[
            moving_parts::study::with_gnss,
            moving_parts::study::without_gnss,
            moving_parts::study::what_is_left_out,
        ],
        "800 adjustments: an hour; RUNS=20 makes it short",
    ),
    ("registration", &[registration::study], "200 registrations: half a minute"),
    (
        "statistics",
        &[statistics::study_of_detectable_errors, statistics::study_of_standardised_errors],
        "3,300 adjustments: some minutes",
    ),
];

fn main() {
    let wanted: Vec<String> = std::env::args().skip(1).filter(|word| !word.starts_with('-')).collect();
    if wanted.is_empty() {
        println!("cargo bench --bench studies NAME, where NAME is one of");
        for (name, _, takes) in STUDIES {
            println!("  {name:13} {takes}");
        }
    }
    for name in &wanted {
        let Some((_, parts, _)) = STUDIES.iter().find(|(known, ..)| known == name) else {
            eprintln!("there is no study {name}");
            std::process::exit(2);
        };
        parts.iter().for_each(|part| part());
    }
}
