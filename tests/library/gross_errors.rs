//! Gross errors of three kinds: single image points, tracks that stay on the road, whole frames.
//!
//! A short form runs with all tests; the study itself is
//!
//! ```text
//! cargo bench --bench studies gross_errors
//! ```
//!
//! It prints, for each share of gross errors, the root mean square over 20 drives of the errors of the mark's track,
//! that against the same drives without gross errors, and the F1 score of the rejected image points.

use crate::support;

use crate::support::refine;
use support::drive::{Drive, Truth};
use support::gross::{Contamination, Gross, contaminate};
use trackbundle::estimate::Estimate;
use trackbundle::internals::files::read_problem;
use trackbundle::internals::initialise::{Method, initialise};
use trackbundle::internals::refine::{Adjustment, ImagePointVerdict, RefineOptions, RejectionReason};
use trackbundle::problem::Problem;

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
    let (estimate, adjustment) = refine(&problem, &start.estimate, &RefineOptions::default(), None).unwrap();
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

    /// Every image point has one verdict.
    fn assert_the_tally_adds_up(&self) {
        let of_vehicles: usize = self.problem.vehicles.iter().map(|v| v.observations.len()).sum();
        let fits = &self.adjustment.fits;
        assert_eq!(fits.tally.all(), of_vehicles + self.problem.target_observations.len());
        assert_eq!(fits.outliers, fits.tally.gross());
        let all = fits.vehicles.iter().flatten().zip(fits.verdicts.vehicles.iter().flatten());
        for (fit, verdict) in all.chain(fits.targets.iter().zip(&fits.verdicts.targets)) {
            let Some(fit) = fit else { continue };
            let is_rejected = matches!(verdict, ImagePointVerdict::Rejected(_));
            assert_eq!(is_rejected, fit.weight == 0.0, "{verdict:?} {fit:?}");
        }
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

/// Drives without gross errors and with them: ratio of the root mean squares of the track errors, and F1.
struct Compared {
    rms_m: f64,
    ratio: f64,
    f1: f64,
}

/// Compares over seeds, from given poses or from raw measurements. The tally must add up in every one.
fn compare(drive: &Drive, what: &Contamination, raw: bool, seeds: std::ops::RangeInclusive<u64>) -> Compared {
    let (mut clean, mut contaminated, mut total) = (Vec::new(), Vec::new(), [0; 3]);
    for seed in seeds {
        let drive = Drive { seed, ..drive.clone() };
        clean.push(run(&drive, &Contamination::default(), raw).track_rms_m());
        let end = run(&drive, what, raw);
        end.assert_the_tally_adds_up();
        contaminated.push(end.track_rms_m());
        end.counts().into_iter().zip(&mut total).for_each(|(count, sum)| *sum += count);
    }
    Compared { rms_m: rms(&contaminated), ratio: rms(&contaminated) / rms(&clean), f1: f1(total) }
}

fn only_tracks(share: f64) -> Contamination {
    Contamination { ground_tracks: share, spares_mark: true, ..Default::default() }
}

#[test]
fn tracks_on_the_road_and_single_errors_are_told_from_good_image_points() {
    for (share, most_ratio, least_f1) in [(0.4, 1.35, 0.97), (0.6, 2.0, 0.9)] {
        for raw in [false, true] {
            let found = compare(&Drive::default(), &Contamination::half_and_half(share), raw, 1..=2);
            assert!(found.ratio <= most_ratio, "{share}, raw {raw}: {} times", found.ratio);
            assert!(found.f1 >= least_f1, "{share}, raw {raw}: F1 {}", found.f1);
        }
    }
}

#[test]
fn whole_tracks_are_rejected_as_such_and_get_no_coordinates() {
    let slow = Drive { seed: 3, motion: [3.0, 0.1], ..Default::default() };
    let end = run(&slow, &only_tracks(0.3), false);
    assert_eq!(f1(end.counts()), 1.0, "{:?}", end.counts());
    let (vehicle, estimate) = (&end.problem.vehicles[0], &end.estimate.vehicles[0]);
    for (point, place) in vehicle.points.iter().zip(&estimate.points) {
        let is_gross = end.gross.tracks.contains(&(vehicle.id.clone(), point.id.clone()));
        assert_eq!(place.is_none(), is_gross, "{}", point.id);
    }
    let tally = end.adjustment.fits.tally;
    assert_eq!(tally.of(RejectionReason::Static), end.gross.of_vehicles.len());
    assert_eq!(tally.of(RejectionReason::ImagePoint) + tally.of(RejectionReason::Frame), 0);
}

#[test]
fn whole_frames_are_rejected_as_such() {
    let what = Contamination { shifted_frames: 5, shifted_target_frames: 5, ..Default::default() };
    for raw in [false, true] {
        let end = run(&Drive { seed: 2, ..Default::default() }, &what, raw);
        assert_eq!(f1(end.counts()), 1.0, "{:?}", end.counts());
        let tally = end.adjustment.fits.tally;
        assert_eq!(
            tally.of(RejectionReason::Frame),
            end.gross.of_vehicles.len() + end.gross.of_targets.len()
        );
        assert!(end.track_rms_m() < 0.015, "{}", end.track_rms_m());
    }
}

#[test]
fn nothing_is_rejected_where_nothing_is_gross() {
    for vehicles in [1, 2] {
        let end = run(&Drive { seed: 4, vehicles, ..Default::default() }, &Contamination::default(), false);
        assert_eq!(end.adjustment.fits.tally.gross(), 0);
        end.assert_the_tally_adds_up();
    }
}

/// Twenty drives of each share.
#[allow(dead_code)]
pub fn study() {
    println!("                             start   share   track rms   ratio      F1");
    let half = Contamination::half_and_half;
    let slow = Drive { motion: [3.0, 0.1], ..Default::default() };
    let drive = Drive::default();
    let far =
        Drive { vehicle_error: [0.5, 0.05], vehicle_shift: [1.5, -1.0, 0.5, 0.15], ..Default::default() };
    let singles = |singles: f64| Contamination { singles, ..Default::default() };
    let list = [
        ("tracks and singles", &drive, half(0.2), 1.15, 0.98),
        ("tracks and singles", &drive, half(0.4), 1.35, 0.97),
        ("tracks and singles", &drive, half(0.6), 2.0, 0.9),
        ("the same, 3 m/s", &slow, half(0.4), 2.0, 0.97),
        ("the same, far starts", &far, half(0.6), 2.0, 0.9),
        ("tracks alone", &drive, only_tracks(0.3), 1.15, 0.98),
        ("tracks alone", &drive, only_tracks(0.5), 1.35, 0.97),
        ("singles alone", &drive, singles(0.55), 2.0, 0.9),
    ];
    for (name, drive, what, most_ratio, least_f1) in list {
        for raw in [false, true] {
            // From raw measurements a far start is none.
            if raw && drive.vehicle_shift != [0.0; 4] {
                continue;
            }
            let found = compare(drive, &what, raw, 1..=20);
            println!(
                "{name:27} {:>6} {:5.0} % {:8.2} cm {:7.3} {:7.4}",
                if raw { "raw" } else { "poses" },
                100.0 * (what.ground_tracks + what.singles),
                100.0 * found.rms_m,
                found.ratio,
                found.f1
            );
            assert!(found.ratio <= most_ratio && found.f1 >= least_f1);
        }
    }
}
