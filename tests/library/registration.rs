//! Parts of a scan come together, whatever they have in common and whatever is in them that belongs nowhere.
//!
//! A short form runs with all tests; the study itself is
//!
//! ```text
//! cargo bench --bench studies registration
//! ```

use nalgebra::{Point3, Translation3, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use trackbundle::geometry::{Pose, rotation};
use trackbundle::internals::cloud::CloudIndex;
use trackbundle::internals::cloud::register::{RegisterOptions, Registration, register};

/// Random numbers for tests.
struct Draws(ChaCha8Rng);

impl Draws {
    fn new(seed: u64) -> Self {
        Draws(ChaCha8Rng::seed_from_u64(seed))
    }

    /// From 0 to 1.
    fn uniform(&mut self) -> f64 {
        self.0.random_range(0.0..1.0)
    }

    /// With mean 0 and variance 1 (Box and Muller).
    fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

/// A scan of a real car.
fn scan() -> Vec<Point3<f64>> {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/problems/suv-exact/reference/car1.ply");
    let text = std::fs::read_to_string(path).unwrap();
    let (_, rows) = text.split_once("end_header\n").unwrap();
    let point = |row: &str| {
        let mut numbers = row.split_whitespace().map(|n| n.parse().unwrap());
        Point3::from([(); 3].map(|()| numbers.next().unwrap()))
    };
    rows.lines().map(point).collect()
}

fn direction(draws: &mut Draws) -> Vector3<f64> {
    Vector3::from_fn(|_, _| draws.normal()).normalize()
}

/// Adds a tenth of all that belongs nowhere: half of it anywhere in the box, half in a ball.
fn with_foreign(mut cloud: Vec<Point3<f64>>, draws: &mut Draws) -> Vec<Point3<f64>> {
    let least = cloud.iter().fold(cloud[0], |a, p| a.inf(p));
    let most = cloud.iter().fold(cloud[0], |a, p| a.sup(p));
    let anywhere = |draws: &mut Draws| {
        Point3::from(Vector3::from_fn(|axis, _| {
            least[axis] - 0.2 + (most[axis] - least[axis] + 0.4) * draws.uniform()
        }))
    };
    let count = cloud.len() / 9;
    let ball = anywhere(draws);
    for i in 0..count {
        let point =
            if i % 2 == 0 { anywhere(draws) } else { ball + direction(draws) * (0.25 * draws.uniform()) };
        cloud.push(point);
    }
    cloud
}

fn mean(cloud: &[Point3<f64>]) -> Point3<f64> {
    Point3::from(cloud.iter().map(|p| p.coords).sum::<Vector3<f64>>() / cloud.len() as f64)
}

/// 10 cm and 3 degrees about a place, in random directions.
fn displacement(about: &Point3<f64>, draws: &mut Draws) -> Pose {
    let turn = rotation::exp(&(direction(draws) * 3f64.to_radians()));
    let to = about.coords + direction(draws) * 0.1;
    Pose::from_parts(Translation3::from(to - turn * about.coords), turn)
}

/// What is left of a displacement: of the centre \[m\], and of the attitude \[deg\].
fn left(found: &Registration, displaced: &Pose, about: &Point3<f64>) -> [f64; 2] {
    let left = found.fixed_from_moving * displaced;
    [(left * about - about).norm(), left.rotation.angle().to_degrees()]
}

#[derive(Clone, Copy, PartialEq)]
enum Clouds {
    Copies,
    Halves,
}

/// Errors of registrations of two parts of the scan that have `common` of each in common.
fn errors(clouds: Clouds, common: f64, seeds: std::ops::Range<u64>) -> Vec<[f64; 2]> {
    let scan = scan();
    let about = mean(&scan);
    let mut along: Vec<f64> = scan.iter().map(|p| p.x).collect();
    along.sort_by(f64::total_cmp);
    // Each part has the share f of all, and they overlap by common f = 2 f - 1.
    let share = 1.0 / (2.0 - common);
    let at = |share: f64| along[((along.len() - 1) as f64 * share) as usize];
    let (low, high) = (at(1.0 - share), at(share));
    let one = |seed: u64| {
        let mut draws = Draws::new(seed);
        let (mut moving, mut fixed) = (Vec::new(), Vec::new());
        for point in &scan {
            let to_moving = draws.uniform() < 0.5;
            if point.x <= high && (clouds == Clouds::Copies || to_moving) {
                moving.push(*point);
            }
            if point.x >= low && (clouds == Clouds::Copies || !to_moving) {
                fixed.push(*point);
            }
        }
        if seed % 2 == 1 {
            std::mem::swap(&mut moving, &mut fixed);
        }
        let (moving, fixed) = (with_foreign(moving, &mut draws), with_foreign(fixed, &mut draws));
        let displaced = displacement(&about, &mut draws);
        let moving: Vec<Point3<f64>> = moving.iter().map(|p| displaced * p).collect();
        let fixed = CloudIndex::new(fixed).unwrap();
        let found = register(&moving, &fixed, &Pose::identity(), &RegisterOptions::default()).unwrap();
        assert_eq!(found.coincides, clouds == Clouds::Copies, "seed {seed}");
        left(&found, &displaced, &about)
    };
    seeds.map(one).collect()
}

fn all_within(errors: &[[f64; 2]], shift_m: f64, turn_deg: f64) {
    for (seed, error) in errors.iter().enumerate() {
        assert!(error[0] <= shift_m && error[1] <= turn_deg, "seed {seed}: {error:?}");
    }
}

#[test]
fn copies_come_together_whatever_they_have_in_common() {
    all_within(&errors(Clouds::Copies, 1.0, 0..3), 1e-3, 0.02);
    all_within(&errors(Clouds::Copies, 0.4, 0..8), 1e-3, 0.02);
}

#[test]
fn halves_of_a_scan_come_together() {
    all_within(&errors(Clouds::Halves, 1.0, 0..4), 0.01, 0.3);
    all_within(&errors(Clouds::Halves, 0.4, 0..8), 0.01, 0.3);
}

/// The same in fifty directions.
#[allow(dead_code)]
pub fn study() {
    for common in [1.0, 0.4] {
        all_within(&errors(Clouds::Copies, common, 0..50), 1e-3, 0.02);
    }
    all_within(&errors(Clouds::Halves, 1.0, 0..50), 0.01, 0.3);
    let common = errors(Clouds::Halves, 0.4, 0..50);
    let worst = [0, 1].map(|of| common.iter().map(|error| error[of]).fold(0.0, f64::max));
    let beyond = common.iter().filter(|error| error[1] > 0.3).count();
    println!("halves, 40 % in common: at most {} m, {} deg; {beyond} beyond 0.3", worst[0], worst[1]);
    // Where one knew what is common and nothing foreign were there, the worst one would be 0.29 deg.
    assert!(worst[0] <= 0.01 && worst[1] <= 0.45 && beyond <= 4, "{worst:?} {beyond}");
}
