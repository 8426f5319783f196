//! Gross errors.

mod support;

use std::collections::BTreeSet;
use support::drive::{Drive, Truth};
use support::gross::{Contamination, Gross, contaminate};
use trackbundle::estimate::Estimate;
use trackbundle::files::read_problem;
use trackbundle::initialise::{Method, initialise};
use trackbundle::problem::Problem;
use trackbundle::refine::{Adjustment, RefineOptions, refine};

struct Run {
    problem: Problem,
    truth: Truth,
    gross: Gross,
    estimate: Estimate,
    adjustment: Adjustment,
}

fn run(drive: &Drive, what: &Contamination, raw: bool) -> Run {
    let folder = tempfile::tempdir().unwrap();
    let truth = drive.write(folder.path());
    let gross = contaminate(folder.path(), &truth, what, drive.seed);
    if raw {
        for name in ["camera_poses.csv", "vehicle_poses.csv"] {
            std::fs::remove_file(folder.path().join(name)).unwrap();
        }
    }
    let problem = read_problem(folder.path()).unwrap_or_else(|f| panic!("{f}")).problem.unwrap();
    let start = initialise(&problem, Method::RobustWhereNeeded).unwrap();
    let watch = std::time::Instant::now();
    let (estimate, adjustment) = refine(&problem, &start.estimate, &RefineOptions::default(), None).unwrap();
    if std::env::var("ROUNDS").is_ok() {
        println!("{:.2} s, spread {:.2}", watch.elapsed().as_secs_f64(), adjustment.spread);
        for r in &adjustment.rounds {
            println!("  {} {} {:?}", r.name, r.records.len() - 1, r.stop);
        }
    }
    Run { problem, truth, gross, estimate, adjustment }
}

impl Run {
    /// Root mean square distance in the plane of the first vehicle's mark from its true track \[m\].
    fn track_rms_m(&self) -> f64 {
        let track = self.estimate.vehicles[0].track(&self.problem, &self.problem.vehicles[0]);
        let mark = self.truth.mark(0);
        assert_eq!(track.len(), mark.len());
        let squares: f64 = track.iter().zip(&mark).map(|(a, b)| (a.position - b).xy().norm_squared()).sum();
        (squares / mark.len() as f64).sqrt()
    }

    /// Hits, false alarms and misses of the rejected image points.
    fn counts(&self) -> [usize; 3] {
        let mut counts = [0; 3];
        let mut count = |is_rejected: bool, is_gross: bool| match (is_rejected, is_gross) {
            (true, true) => counts[0] += 1,
            (true, false) => counts[1] += 1,
            (false, true) => counts[2] += 1,
            (false, false) => {}
        };
        for (vehicle, fits) in self.problem.vehicles.iter().zip(&self.adjustment.fits.vehicles) {
            for (o, fit) in vehicle.observations.iter().zip(fits) {
                let key = (
                    self.problem.frames[o.frame].number,
                    vehicle.id.clone(),
                    vehicle.points[o.point].id.clone(),
                );
                count(fit.is_none_or(|fit| fit.is_outlier), self.gross.of_vehicles.contains(&key));
            }
        }
        for (o, fit) in self.problem.target_observations.iter().zip(&self.adjustment.fits.targets) {
            let key = (self.problem.frames[o.frame].number, self.problem.targets[o.target].id.clone());
            count(fit.is_none_or(|fit| fit.is_outlier), self.gross.of_targets.contains(&key));
        }
        counts
    }
}

fn f1([hits, false_alarms, misses]: [usize; 3]) -> f64 {
    2.0 * hits as f64 / (2 * hits + false_alarms + misses) as f64
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

#[test]
#[ignore = "80 adjustments"]
fn study() {
    let raw = std::env::var("RAW").is_ok();
    let verbose = std::env::var("VERBOSE").is_ok();
    let seeds: u64 = std::env::var("SEEDS").map_or(20, |s| s.parse().unwrap());
    let only: Option<u64> = std::env::var("SEED").ok().map(|s| s.parse().unwrap());
    let seeds: Vec<u64> = only.map_or((1..=seeds).collect(), |s| vec![s]);
    let mut clean = Vec::new();
    for share in [0.0, 0.2, 0.4, 0.6, 0.3] {
        let what = if share == 0.3 {
            Contamination { ground_tracks: 0.3, spares_mark: true, ..Default::default() }
        } else {
            Contamination::half_and_half(share)
        };
        let watch = std::time::Instant::now();
        let mut tracks = Vec::new();
        let mut total = [0; 3];
        let mut worst: f64 = 1.0;
        for seed in &seeds {
            let run = run(&Drive { seed: *seed, ..Default::default() }, &what, raw);
            let counts = run.counts();
            if share > 0.0 {
                worst = worst.min(f1(counts));
            }
            (0..3).for_each(|i| total[i] += counts[i]);
            tracks.push(run.track_rms_m());
            if verbose {
                if std::env::var("WHO").is_ok() {
                    let mut who = std::collections::BTreeMap::new();
                    for (v, verdicts) in
                        run.problem.vehicles.iter().zip(&run.adjustment.fits.verdicts.vehicles)
                    {
                        for (o, verdict) in v.observations.iter().zip(verdicts) {
                            let key = (
                                run.problem.frames[o.frame].number,
                                v.id.clone(),
                                v.points[o.point].id.clone(),
                            );
                            if !run.gross.of_vehicles.contains(&key)
                                && *verdict != trackbundle::refine::Verdict::Used
                            {
                                *who.entry(format!("{} {verdict:?}", key.2)).or_insert(0) += 1;
                            }
                        }
                    }
                    for (o, verdict) in
                        run.problem.target_observations.iter().zip(&run.adjustment.fits.verdicts.targets)
                    {
                        if *verdict != trackbundle::refine::Verdict::Used {
                            *who.entry(format!("{} {verdict:?}", run.problem.targets[o.target].id))
                                .or_insert(0) += 1;
                        }
                    }
                    println!("{who:?} {:?}", run.adjustment.fits.tally);
                }

                println!(
                    "   seed {seed}: {:.2} cm, {counts:?} F1 {:.4} {}",
                    100.0 * run.track_rms_m(),
                    f1(counts),
                    run.adjustment.stop
                );
            }
        }
        if share == 0.0 {
            clean = tracks.clone();
        }
        println!(
            "{:3.0} %: rms {:.3} cm, ratio {:.3}, F1 {:.4} (worst {worst:.4}), {total:?}, {:.1} s",
            100.0 * share,
            100.0 * rms(&tracks),
            rms(&tracks) / rms(&clean),
            f1(total),
            watch.elapsed().as_secs_f64()
        );
    }
    let _: BTreeSet<u8> = BTreeSet::new();
}

#[test]
#[ignore = "explore"]
fn explore() {
    let seeds: u64 = std::env::var("SEEDS").map_or(8, |s| s.parse().unwrap());
    let half = Contamination::half_and_half;
    let tracks = |t: f64, s: f64| Contamination {
        ground_tracks: t,
        singles: s,
        spares_mark: true,
        ..Default::default()
    };
    let drive = Drive::default;
    let far = || Drive { vehicle_error: [0.5, 0.05], vehicle_shift: [1.5, -1.0, 0.5, 0.15], ..drive() };
    let list: Vec<(&str, Drive, Contamination, bool)> = vec![
        ("far 40", far(), half(0.4), false),
        ("far 60", far(), half(0.6), false),
        ("slow 3 m/s 40", Drive { motion: [3.0, 0.1], ..drive() }, half(0.4), false),
        ("slow 3 m/s 60", Drive { motion: [3.0, 0.1], ..drive() }, half(0.6), false),
        ("slow 3 m/s 40 raw", Drive { motion: [3.0, 0.1], ..drive() }, half(0.4), true),
        ("slow 3 m/s 60 raw", Drive { motion: [3.0, 0.1], ..drive() }, half(0.6), true),
        ("tracks 39 singles 30", drive(), tracks(0.39, 0.3), false),
        ("tracks 39 singles 30 raw", drive(), tracks(0.39, 0.3), true),
        ("tracks 50", drive(), tracks(0.5, 0.0), false),
        ("tracks 50 raw", drive(), tracks(0.5, 0.0), true),
        ("tracks 60", drive(), tracks(0.6, 0.0), false),
        ("tracks 60 raw", drive(), tracks(0.6, 0.0), true),
        ("singles 45", drive(), tracks(0.0, 0.45), false),
        ("singles 45 raw", drive(), tracks(0.0, 0.45), true),
        ("singles 55", drive(), tracks(0.0, 0.55), false),
        (
            "150 frames vis .5, 40",
            Drive { frames: 150, visibility: 0.5, motion: [6.0, 0.25], ..drive() },
            half(0.4),
            false,
        ),
        (
            "150 frames vis .5, 60 raw",
            Drive { frames: 150, visibility: 0.5, motion: [6.0, 0.25], ..drive() },
            half(0.6),
            true,
        ),
        ("3 cars 40", Drive { vehicles: 3, ..drive() }, half(0.4), false),
        ("3 cars 40 raw", Drive { vehicles: 3, ..drive() }, half(0.4), true),
        (
            "frames 6+6",
            drive(),
            Contamination { shifted_frames: 6, shifted_target_frames: 6, ..tracks(0.0, 0.0) },
            false,
        ),
        (
            "frames 6+6 raw",
            drive(),
            Contamination { shifted_frames: 6, shifted_target_frames: 6, ..tracks(0.0, 0.0) },
            true,
        ),
        (
            "frames 6+6, 40",
            drive(),
            Contamination { shifted_frames: 6, shifted_target_frames: 6, ..half(0.4) },
            false,
        ),
        ("standing 40", Drive { motion: [0.0, 0.0], ..drive() }, half(0.4), false),
    ];
    let only = std::env::var("ONLY").ok();
    for (name, drive, what, raw) in list {
        if only.as_ref().is_some_and(|only| !name.contains(only.as_str())) {
            continue;
        }
        let (mut clean, mut dirty, mut total, mut worst) = (vec![], vec![], [0; 3], 1.0_f64);
        let watch = std::time::Instant::now();
        for seed in 1..=seeds {
            let drive = Drive { seed, ..drive.clone() };
            clean.push(run(&drive, &Contamination::default(), raw).track_rms_m());
            let end = run(&drive, &what, raw);
            let counts = end.counts();
            if std::env::var("VERBOSE").is_ok() {
                println!(
                    "{seed}: {:.2} clean {:.2} {counts:?} {:?}",
                    100.0 * end.track_rms_m(),
                    100.0 * clean.last().unwrap(),
                    end.adjustment.fits.tally.rejected
                );
            }
            dirty.push(end.track_rms_m());
            (0..3).for_each(|i| total[i] += counts[i]);
            worst = worst.min(f1(counts));
        }
        println!(
            "{name:26}: clean {:.2} cm, ratio {:8.3} (worst {:.1} cm), F1 {:.4} (worst {worst:.4}) {total:?} {:.1} s",
            100.0 * rms(&clean),
            rms(&dirty) / rms(&clean),
            100.0 * dirty.iter().copied().fold(0.0, f64::max),
            f1(total),
            watch.elapsed().as_secs_f64()
        );
    }
}
