use super::curve::Curve;
use super::*;
use crate::stats::drawn::Normal;
use nalgebra::Point3;

/// A place for each time \[s, m\].
type Road = dyn Fn(f64) -> [f64; 2];

/// A drive with bends and changes of speed.
fn drive(time_s: f64) -> [f64; 2] {
    let x = 7.0 * time_s + 9.0 * (0.41 * time_s).sin();
    let y = 14.0 * (0.29 * time_s + 0.5).sin() + 2.0 * (0.93 * time_s).cos();
    [x, y]
}

fn straight(time_s: f64) -> [f64; 2] {
    [12.0 * time_s, 5.0 * time_s]
}

fn standing(_time_s: f64) -> [f64; 2] {
    [3.0, 4.0]
}

/// Once around in 4 s.
fn circle(time_s: f64) -> [f64; 2] {
    let (sin, cos) = (std::f64::consts::TAU * time_s / 4.0).sin_cos();
    [8.0 * cos, 8.0 * sin]
}

/// A film, a receiver, and what is wrong with them.
#[derive(Clone, Copy)]
struct Setting {
    offset_s: f64,
    noise_m: f64,
    gross: f64,
    shift_m: [f64; 2],
    receiver_step_s: f64,
    film_step_s: f64,
    film_s: f64,
    seed: u64,
}

impl Default for Setting {
    fn default() -> Self {
        Setting {
            offset_s: 0.0,
            noise_m: 0.01,
            gross: 0.0,
            shift_m: [0.0; 2],
            receiver_step_s: 0.1,
            film_step_s: 1.0 / 30.0,
            film_s: 20.0,
            seed: 1,
        }
    }
}

impl Setting {
    /// The film, and the receiver from 6 s before it to 6 s after it.
    fn curves(&self, road: &Road) -> [Curve; 2] {
        let mut normal = Normal(self.seed);
        let mut sampled = |from: f64, to: f64, step: f64, clock_s: f64, shift: [f64; 2], gross: f64| {
            let count = ((to - from) / step) as usize;
            let samples: Vec<_> = (0..=count)
                .map(|k| {
                    let time_s = from + k as f64 * step;
                    let [x, y] = road(time_s);
                    let mut far =
                        || if normal.uniform() < gross { 40.0 * normal.uniform() - 10.0 } else { 0.0 };
                    let [ex, ey] = [far(), far()];
                    let [nx, ny] = [(); 2].map(|()| self.noise_m * normal.draw());
                    let at = Point3::new(x + shift[0] + nx + ex, y + shift[1] + ny + ey, 0.0);
                    (time_s + clock_s, at, None)
                })
                .collect();
            Curve::new(samples.into_iter())
        };
        let film = sampled(0.0, self.film_s, self.film_step_s, 0.0, self.shift_m, self.gross);
        [film, sampled(-6.0, self.film_s + 6.0, self.receiver_step_s, self.offset_s, [0.0; 2], 0.0)]
    }

    fn offset(&self, road: &Road, shift: Shift) -> ClockOffset {
        let [film, receiver] = self.curves(road);
        clock_offset(&film, &receiver, shift)
    }
}

fn estimated(found: ClockOffset) -> ClockEstimate {
    match found {
        ClockOffset::Estimated(found) => found,
        ClockOffset::NotObservable { why } => panic!("{why}"),
    }
}

fn not_observable(found: ClockOffset) -> String {
    match found {
        ClockOffset::Estimated(found) => panic!("{found:?}"),
        ClockOffset::NotObservable { why } => why,
    }
}

#[test]
fn offsets_are_found_with_noise_gross_errors_and_a_shift() {
    for (offset_s, gross, shift_m) in [
        (0.12, 0.0, [0.0, 0.0]),
        (-0.5, 0.0, [0.3, -0.2]),
        (3.0, 0.0, [25.0, 40.0]),
        (0.12, 0.1, [0.0, 0.0]),
        (-0.5, 0.1, [1.0, 2.0]),
        (3.0, 0.1, [-0.4, 0.1]),
    ] {
        let setting = Setting { offset_s, gross, shift_m, ..Default::default() };
        let found = estimated(setting.offset(&drive, Shift::Free));
        let off = found.offset_s - offset_s;
        assert!(off.abs() < 3.0 * found.sigma_s && off.abs() < 0.003, "{offset_s}: {found:?}");
        assert!(found.sigma_s < 0.001, "{found:?}");
        for axis in 0..2 {
            assert!((found.shift_m[axis] - shift_m[axis]).abs() < 0.01, "{found:?}");
        }
        assert!((0.008..0.016).contains(&found.scale_m), "{found:?}");
        // Gross errors hit one axis or both, and the middles beside them.
        let share = found.rejected as f64 / found.samples as f64;
        assert!(if gross > 0.0 { (0.2..0.45).contains(&share) } else { share < 0.01 }, "{share}: {found:?}");
    }
}

#[test]
fn the_standard_deviation_is_that_of_many_films() {
    // Frames in step with the receiver are the worst case: without places between them, the noise that
    // interpolation takes away would pull the offset off by half a step.
    for (step, noise_m) in [(0.1, 0.05), (0.2, 0.4)] {
        let mut squares = 0.0;
        let films = 40;
        for seed in 0..films {
            let setting =
                Setting { noise_m, seed, film_step_s: step, receiver_step_s: step, ..Default::default() };
            let found = estimated(setting.offset(&drive, Shift::Free));
            squares += (found.offset_s / found.sigma_s).powi(2);
        }
        let ratio = (squares / films as f64).sqrt();
        assert!((0.7..1.35).contains(&ratio), "{step}: {ratio}");
    }
}

#[test]
fn errors_that_last_make_it_worse_and_are_told() {
    // A receiver whose error lasts about 2 s: many of its positions are worth one.
    let mut squares = 0.0;
    let films = 40;
    for seed in 0..films {
        let setting = Setting { noise_m: 0.001, seed, film_s: 60.0, film_step_s: 0.1, ..Default::default() };
        let [film, receiver] = setting.curves(&drive);
        let mut normal = Normal(1000 + seed);
        let mut error = [0.0; 2];
        let keep = (-0.1_f64 / 2.0).exp();
        let samples: Vec<_> = receiver
            .times_s()
            .iter()
            .map(|time_s| {
                error = error.map(|e| keep * e + 0.05 * (1.0 - keep * keep).sqrt() * normal.draw());
                let at = receiver.at(*time_s).unwrap();
                (*time_s, Point3::new(at.x + error[0], at.y + error[1], 0.0), None)
            })
            .collect();
        let found = estimated(clock_offset(&film, &Curve::new(samples.into_iter()), Shift::Free));
        assert!(found.independent < 60.0, "{found:?}");
        squares += (found.offset_s / found.sigma_s).powi(2);
    }
    let ratio = (squares / films as f64).sqrt();
    assert!((0.7..1.4).contains(&ratio), "{ratio}");
}

#[test]
fn a_constant_velocity_shows_nothing_beside_a_free_shift() {
    for seed in 0..10 {
        for noise_m in [0.0, 0.01, 0.05] {
            let setting = Setting { offset_s: 0.3, noise_m, seed, ..Default::default() };
            let why = not_observable(setting.offset(&straight, Shift::Free));
            assert!(why.contains("change of velocity"), "{why}");
        }
    }
}

#[test]
fn a_constant_velocity_shows_the_offset_where_no_shift_is_free() {
    let setting = Setting { offset_s: 0.3, ..Default::default() };
    let found = estimated(setting.offset(&straight, Shift::None));
    assert!((found.offset_s - 0.3).abs() < 3.0 * found.sigma_s && found.sigma_s < 1e-3, "{found:?}");
    assert_eq!(found.shift_m, [0.0; 2]);
    // And a shift of 13 cm along the track would be taken for 10 ms.
    let shifted = Setting { shift_m: [0.12, 0.05], ..setting };
    let found = estimated(shifted.offset(&straight, Shift::None));
    assert!((found.offset_s - 0.31).abs() < 0.002, "{found:?}");
}

#[test]
fn standstill_shows_nothing() {
    for seed in 0..10 {
        for shift in [Shift::Free, Shift::None] {
            for noise_m in [0.0, 0.01] {
                let setting = Setting { noise_m, seed, ..Default::default() };
                not_observable(setting.offset(&standing, shift));
            }
        }
    }
}

#[test]
fn a_period_is_named_with_both_offsets() {
    for noise_m in [0.0, 0.01] {
        let setting = Setting { offset_s: 0.5, noise_m, ..Default::default() };
        let why = not_observable(setting.offset(&circle, Shift::Free));
        assert!(why.contains("fit alike"), "{why}");
        let numbers: Vec<f64> = why.split(' ').filter_map(|word| word.parse().ok()).collect();
        assert!((0..2).all(|k| ((numbers[k] - 0.5).rem_euclid(4.0) + 1.0).rem_euclid(4.0) < 1.01), "{why}");
        assert!((numbers[0] - numbers[1]).abs() > 3.9, "{why}");
    }
}

#[test]
fn a_change_of_velocity_that_drowns_in_noise_is_too_little() {
    let winding = |t: f64| [12.0 * t, 0.3 * (0.7 * t).sin()];
    let whys: Vec<String> = (0..10)
        .map(|seed| Setting { noise_m: 0.15, seed, ..Default::default() })
        .map(|setting| not_observable(setting.offset(&winding, Shift::Free)))
        .collect();
    assert!(whys.iter().any(|why| why.contains("its standard deviation would be 0.")), "{whys:#?}");
}

#[test]
fn an_offset_at_the_end_of_the_search_is_not_trusted() {
    let setting = Setting { offset_s: 10.03, ..Default::default() };
    let why = not_observable(setting.offset(&drive, Shift::Free));
    assert!(why.contains("the last one that was tried"), "{why}");
}

#[test]
fn an_offset_beyond_the_search_is_not_made_up() {
    let setting = Setting { offset_s: 11.5, ..Default::default() };
    not_observable(setting.offset(&drive, Shift::Free));
}

#[test]
fn too_little_in_common_is_told() {
    let curve = |from: f64, count: usize| {
        let at = |k: usize| {
            let time_s = from + 0.1 * k as f64;
            let [x, y] = drive(time_s);
            (time_s, Point3::new(x, y, 0.0), None)
        };
        Curve::new((0..count).map(at))
    };
    for (film, receiver) in [
        (curve(0.0, 0), curve(0.0, 100)),
        (curve(0.0, 1), curve(0.0, 100)),
        (curve(0.0, 100), curve(0.0, 1)),
        (curve(0.0, 100), curve(0.0, 0)),
        (curve(0.0, 15), curve(0.0, 100)),
        (curve(0.0, 50), curve(100.0, 50)),
    ] {
        let why = not_observable(clock_offset(&film, &receiver, Shift::Free));
        assert!(why.contains("in common"), "{why}");
    }
}

#[test]
fn numbers_out_of_all_proportion_do_no_harm() {
    let far = |at: f64| {
        let place = move |k: usize| {
            let x = if k % 7 == 3 { at } else { 0.01 * (k * k) as f64 };
            (0.1 * k as f64, Point3::new(x, -x, 0.0), None)
        };
        Curve::new((0..100).map(place))
    };
    for at in [1e300, -1e308, f64::MAX] {
        let _ = clock_offset(&far(at), &far(0.0), Shift::Free);
        let _ = clock_offset(&far(0.0), &far(at), Shift::None);
        let _ = clock_offset(&far(at), &far(at), Shift::Free);
    }
}

#[test]
fn a_drift_moves_the_offset_as_far_as_is_told() {
    let setting = Setting { noise_m: 0.02, offset_s: 0.12, ..Default::default() };
    let [film, receiver] = setting.curves(&drive);
    let still = estimated(clock_offset(&film, &receiver, Shift::Free));
    for axis in 0..2 {
        // 5 mm root mean square over the film.
        let drift = |time_s: f64| 0.005 * 12_f64.sqrt() * (time_s / setting.film_s - 0.5);
        let drifting = film.times_s().iter().map(|time_s| {
            let mut at = film.at(*time_s).unwrap();
            at[axis] += drift(*time_s);
            (*time_s, at, None)
        });
        let found = estimated(clock_offset(&Curve::new(drifting), &receiver, Shift::Free));
        let moved = (found.offset_s - still.offset_s).abs();
        let told = 0.005 * still.by_drift_s[axis];
        // To first order: the loss weighs the ends of the film, where the drift is largest, somewhat less.
        assert!(told > 2e-5 && (moved / told - 1.0).abs() < 0.2, "{axis}: {moved} s, {told} s told");
    }
}
