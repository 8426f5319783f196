use super::frame::tests::{normal, sight};
use super::*;
use crate::camera::tests::cameras;
use crate::geometry::rotation::exp;
use nalgebra::{Point3, Vector2};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// A camera that drifts and turns above targets.
fn path(time_s: f64) -> Pose {
    let turn = Vector3::new(0.03 * (0.5 * time_s).sin(), 0.02, 0.4 + 0.05 * time_s);
    let place = Vector3::new(0.3 * time_s, 2.0 + (0.6 * time_s).sin(), 60.0 + 0.2 * time_s);
    Pose::from_parts(place.into(), exp(&(Vector3::x() * std::f64::consts::PI)) * exp(&turn))
}

struct Simulated {
    camera: Camera,
    times_s: Vec<f64>,
    sightings: Vec<Vec<Sighting>>,
}

impl Simulated {
    fn new(targets: usize, height_m: f64) -> Simulated {
        let mut rng = ChaCha8Rng::seed_from_u64(11);
        let [_, camera, ..] = cameras();
        let points: Vec<Point3<f64>> = (0..targets)
            .map(|_| {
                Point3::new(
                    rng.random_range(-26.0..26.0),
                    rng.random_range(-14.0..16.0),
                    height_m * normal(&mut rng),
                )
            })
            .collect();
        let times_s: Vec<f64> = (0..60).map(|k| f64::from(k) / 30.0).collect();
        let see = |time_s: &f64, rng: &mut ChaCha8Rng| -> Vec<Sighting> {
            points.iter().map(|point| sight(&camera, &path(*time_s), *point, 1.0, rng)).collect()
        };
        let sightings = times_s.iter().map(|time_s| see(time_s, &mut rng)).collect();
        Simulated { camera, times_s, sightings }
    }

    fn resect(&self) -> Result<Resection, NotResectable> {
        resect(&self.camera, &self.times_s, &self.sightings, &vec![None; self.times_s.len()])
    }

    /// Largest error of the position \[m\].
    fn worst_m(&self, resection: &Resection) -> f64 {
        let gap = |(time_s, frame): (&f64, &FrameResection)| {
            (frame.pose.translation.vector - path(*time_s).translation.vector).norm()
        };
        self.times_s.iter().zip(&resection.frames).map(gap).fold(0.0, f64::max)
    }

    fn spoil(&mut self, at: usize, which: usize, rng: &mut ChaCha8Rng) {
        let sighting = &mut self.sightings[at][which];
        sighting.image_px = Vector2::new(rng.random_range(0.0..3840.0), rng.random_range(0.0..2160.0));
        sighting.ray = self.camera.ray(&sighting.image_px).unwrap();
    }
}

fn frames(count: i64) -> Vec<crate::problem::Frame> {
    (0..count).map(|k| crate::problem::Frame { number: 100 + k, time_s: k as f64 / 30.0 }).collect()
}

#[test]
fn a_film_is_resected_frame_by_frame() {
    let video = Simulated::new(12, 0.3);
    let resection = video.resect().unwrap();
    assert!(resection.frames.iter().all(|frame| frame.status == Status::Resected));
    assert!(video.worst_m(&resection) < 0.5, "{}", video.worst_m(&resection));
    let quality = resection.quality();
    assert_eq!((quality.resected, quality.bridged, quality.gross_errors), (60, 0, 0));
    assert!((0.6..1.1).contains(&quality.median_rms_px), "{quality:?}");
    assert!(warnings(&resection, &frames(60)).is_empty());
}

#[test]
fn frames_that_see_too_little_are_bridged_and_named() {
    let mut video = Simulated::new(12, 0.3);
    (20..30).for_each(|at| video.sightings[at].truncate(2));
    video.sightings[59].clear();
    let resection = video.resect().unwrap();
    for (at, frame) in resection.frames.iter().enumerate() {
        let is_short = (20..30).contains(&at) || at == 59;
        assert_eq!(
            frame.status == Status::Bridged(BridgeReason::TooFew),
            is_short,
            "{at}: {:?}",
            frame.status
        );
    }
    assert!(video.worst_m(&resection) < 0.5, "{}", video.worst_m(&resection));
    let found = warnings(&resection, &frames(60));
    let lines: Vec<String> = found.iter().map(ToString::to_string).collect();
    assert_eq!(lines.len(), 2, "{lines:?}");
    assert!(lines[0].contains("frames 120-129: 2 control targets in view; bridged"), "{lines:?}");
    assert!(lines[1].contains("frame 159: no control target in view"), "{lines:?}");
}

#[test]
fn four_targets_are_enough() {
    for height_m in [0.0, 0.5] {
        let video = Simulated::new(4, height_m);
        let resection = video.resect().unwrap();
        let is_resected = |frame: &&FrameResection| frame.status == Status::Resected && frame.used == 4;
        assert!(resection.frames.iter().filter(is_resected).count() >= 55, "{:?}", resection.quality());
        assert!(video.worst_m(&resection) < 2.0, "{}", video.worst_m(&resection));
    }
}

#[test]
fn three_targets_are_decided_by_the_neighbours() {
    let mut video = Simulated::new(12, 0.3);
    (20..35).for_each(|at| video.sightings[at].truncate(3));
    let resection = video.resect().unwrap();
    let decided = resection.frames[20..35].iter().filter(|frame| frame.status == Status::Resected).count();
    assert!(decided >= 10, "{decided}");
    assert!(video.worst_m(&resection) < 1.0, "{}", video.worst_m(&resection));
}

#[test]
fn a_gross_error_among_four_targets_is_found_by_the_neighbours() {
    let mut video = Simulated::new(12, 0.3);
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    for at in (10..50).step_by(4) {
        video.sightings[at].truncate(4);
        video.spoil(at, at / 4 % 4, &mut rng);
    }
    let resection = video.resect().unwrap();
    assert!(video.worst_m(&resection) < 1.0, "{}", video.worst_m(&resection));
    let used = |at: usize| resection.frames[at].used;
    assert!((10..50).step_by(4).all(|at| used(at) == 3 || used(at) == 0));
    assert!((10..50).step_by(4).filter(|at| used(*at) == 3).count() >= 5);
}

#[test]
fn a_third_of_gross_errors_moves_no_frame() {
    let mut video = Simulated::new(12, 0.3);
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    for at in 0..60 {
        for which in 0..12 {
            if rng.random::<f64>() < 0.3 {
                video.spoil(at, which, &mut rng);
            }
        }
    }
    let resection = video.resect().unwrap();
    assert!(video.worst_m(&resection) < 1.3, "{}", video.worst_m(&resection));
    // Seven or more of twelve are gross in one frame of 25.
    assert!(resection.quality().resected >= 52, "{:?}", resection.quality());
}

#[test]
fn a_mirrored_frame_is_healed_by_its_neighbours() {
    let video = Simulated::new(6, 0.0);
    let fits = |video: &Simulated| -> Vec<Vec<Fit>> {
        let one = |s: &Vec<Sighting>| Frame { camera: &video.camera, sightings: s, spread: 1.0 }.search(1);
        video.sightings.iter().map(one).collect()
    };
    let given = vec![None; 60];
    let mut whole = Video {
        camera: &video.camera,
        times_s: &video.times_s,
        sightings: &video.sightings,
        given: &given,
        spread: 1.0,
        fits: fits(&video),
        chosen: Vec::new(),
    };
    whole.chosen = (0..60).map(|at| whole.alone(at)).collect();
    assert!(whole.chosen[30].is_ok());
    // A far worse pose in frame 30 that passes for the only one.
    let mut wrong = whole.fits[30][0].clone();
    wrong.pose.rotation *= exp(&Vector3::new(0.5, 0.0, 0.0));
    wrong.cost += 40.0;
    whole.fits[30] = vec![wrong.clone()];
    whole.chosen[30] = Ok(wrong);
    whole.restart_between_neighbours();
    let resection = whole.bridge().unwrap();
    assert!(video.worst_m(&resection) < 1.0, "{}", video.worst_m(&resection));
}

#[test]
fn a_pose_on_four_points_far_from_its_neighbours_is_taken_back() {
    let video = Simulated::new(12, 0.3);
    let mut given: Vec<Option<(Pose, Matrix6<f64>)>> = vec![None; 60];
    given[0] = Some((path(video.times_s[0]), Matrix6::from_diagonal_element(1e-6)));
    let search = |s: &Vec<Sighting>| Frame { camera: &video.camera, sightings: s, spread: 1.0 }.search(1);
    let (camera, times_s, sightings) = (&video.camera, &video.times_s, &video.sightings);
    let fits: Vec<Vec<Fit>> = sightings.iter().map(search).collect();
    let mut whole =
        Video { camera, times_s, sightings, given: &given, spread: 1.0, fits, chosen: Vec::new() };
    whole.chosen = (0..60).map(|at| whole.alone(at)).collect();
    let mut wrong = whole.fits[30][0].clone();
    wrong.pose.translation.x += 20.0;
    wrong.norms[4..].fill(100.0);
    whole.chosen[30] = Ok(wrong);
    whole.drop_outcasts();
    assert_eq!(whole.chosen[30].as_ref().err(), Some(&BridgeReason::Contradictory));
    assert_eq!(whole.chosen.iter().filter(|chosen| chosen.is_err()).count(), 1);
}

#[test]
fn what_cannot_be_determined_is_said() {
    let mut one = Simulated::new(12, 0.3);
    one.sightings.iter_mut().for_each(|s| s.truncate(1));
    assert_eq!(one.resect(), Err(NotResectable::TooFew { most: 1 }));
    assert_eq!(Simulated::new(0, 0.0).resect(), Err(NotResectable::TooFew { most: 0 }));

    let three = Simulated::new(3, 0.3);
    assert_eq!(three.resect(), Err(NotResectable::Ambiguous));

    let mut line = Simulated::new(8, 0.3);
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    for at in 0..60 {
        let time_s = line.times_s[at];
        let on_line = |k: usize| Point3::new(4.0 * k as f64 - 14.0, 1.5 * k as f64 - 5.0, 0.0);
        let see = |k: usize| sight(&line.camera, &path(time_s), on_line(k), 1.0, &mut rng);
        line.sightings[at] = (0..8).map(see).collect();
    }
    assert_eq!(line.resect(), Err(NotResectable::OnALine));

    let mut foreign = Simulated::new(9, 0.3);
    for at in 0..60 {
        (0..9).for_each(|which| foreign.spoil(at, which, &mut rng));
    }
    let error = foreign.resect().unwrap_err();
    assert!(matches!(error, NotResectable::Contradictory | NotResectable::PoorlySpread), "{error}");
}

#[test]
fn image_points_worse_than_stated_are_not_taken_for_gross_errors() {
    let mut video = Simulated::new(12, 0.3);
    for sighting in video.sightings.iter_mut().flatten() {
        sighting.sigma_px = 0.25;
        sighting.sigma_m = Vector3::repeat(1e-3);
    }
    let resection = video.resect().unwrap();
    assert!((3.0..5.0).contains(&resection.spread), "{}", resection.spread);
    assert!(resection.quality().gross_errors < 5, "{:?}", resection.quality());
}

#[test]
fn given_poses_stay_and_lend_their_neighbours_a_hand() {
    let mut video = Simulated::new(12, 0.3);
    (10..20).for_each(|at| video.sightings[at].truncate(1));
    let small = Matrix6::from_diagonal_element(1e-6);
    let known = |at: usize| (at == 9 || at == 20).then(|| (path(video.times_s[at]), small));
    let given: Vec<_> = (0..60).map(known).collect();
    let resection = resect(&video.camera, &video.times_s, &video.sightings, &given).unwrap();
    for at in [9, 20] {
        assert_eq!(resection.frames[at].pose, path(video.times_s[at]));
        assert_eq!(resection.frames[at].status, Status::Given);
    }
    let gap = resection.frames[15].pose.translation.vector - path(video.times_s[15]).translation.vector;
    assert!(gap.norm() < 0.2, "{}", gap.norm());
}

#[test]
fn threads_change_no_bit() {
    let video = Simulated::new(14, 0.3);
    let pool = |threads: usize| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    assert_eq!(pool(1).install(|| video.resect()), pool(3).install(|| video.resect()));
}
