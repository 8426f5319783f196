//! Random numbers, and what wanders about zero.
//!
//! A wander is a critically damped oscillator that white noise drives: its acceleration is white where it is
//! fast, as the motion prior of the adjustment has it, and it stays within bounds.
//!
//! ```text
//! x'' + 2 w x' + w^2 x = white noise     w = 2 / T
//! E x(0) x(t) = sigma^2 (1 + w |t|) exp(-w |t|)
//! ```
//!
//! `T` is so chosen that the mean over a long time has the variance of a process with `exp(-|t| / T)`: that is
//! how the adjustment takes the contact with the ground.

use nalgebra::{Matrix2, Vector2, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// What random numbers are for. Each has a stream of its own, so that none moves when another is used more.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u64)]
pub enum Purpose {
    Body,
    Tracks,
    CameraPath,
    VehiclePath,
    Ride,
    VehicleImages,
    TargetImages,
    Gross,
    CameraPoses,
    VehiclePoses,
    Survey,
    Knowledge,
    Calibration,
    Gnss,
    Beside,
    StaticTracks,
    SlidingTracks,
    ForeignTracks,
    Draw,
    Terrain,
}

/// Streams of a run.
const PURPOSES: u64 = 64;
/// Things of one kind that have a stream each.
const THINGS: u64 = 1 << 20;

/// The random numbers of a run for a purpose, of the thing with this number.
pub fn stream(seed: u64, run: u64, purpose: Purpose, thing: usize) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream((run * PURPOSES + purpose as u64) * THINGS + thing as u64 % THINGS);
    rng
}

/// A standard normal number (Box and Muller 1958).
pub fn normal(rng: &mut ChaCha8Rng) -> f64 {
    let (radius, angle): (f64, f64) = (1.0 - rng.random::<f64>(), rng.random());
    (-2.0 * radius.ln()).sqrt() * (std::f64::consts::TAU * angle).cos()
}

/// Three of them.
pub fn normal3(rng: &mut ChaCha8Rng) -> Vector3<f64> {
    let [x, y, z] = std::array::from_fn(|_| normal(rng));
    Vector3::new(x, y, z)
}

/// Times at which a path is known: from one frame before the video to one after it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Times {
    /// The first \[s\].
    pub begin_s: f64,
    /// From one to the next \[s\].
    pub step_s: f64,
    /// How many.
    pub count: usize,
}

impl Times {
    /// Those of a video, so many to each frame.
    pub fn of_video(frames: usize, rate_hz: f64, each: usize) -> Times {
        let step_s = 1.0 / (rate_hz * each as f64);
        Times { begin_s: -1.0 / rate_hz, step_s, count: (frames + 1) * each + 1 }
    }

    /// The time of one.
    pub fn time(&self, at: usize) -> f64 {
        self.begin_s + at as f64 * self.step_s
    }

    /// The interval of a time, and where in it, from 0 to 1.
    pub fn interval(&self, time_s: f64) -> (usize, f64) {
        let place = ((time_s - self.begin_s) / self.step_s).clamp(0.0, (self.count - 1) as f64);
        let at = (place.floor() as usize).min(self.count - 2);
        (at, place - at as f64)
    }
}

/// A function of time by its values and slopes: cubic between (Hermite).
#[derive(Clone, Debug)]
pub struct Curve {
    times: Times,
    /// Value and slope.
    nodes: Vec<[f64; 2]>,
}

impl Curve {
    /// From its nodes, one for each time.
    pub fn new(times: Times, nodes: Vec<[f64; 2]>) -> Curve {
        assert_eq!(times.count, nodes.len());
        Curve { times, nodes }
    }

    /// Value and slope at a time.
    pub fn at(&self, time_s: f64) -> [f64; 2] {
        let (at, u) = self.times.interval(time_s);
        hermite(self.nodes[at], self.nodes[at + 1], self.times.step_s, u)
    }
}

/// Value and slope of the cubic between two nodes that are `step` apart, at the share `u` of the way.
pub fn hermite(a: [f64; 2], b: [f64; 2], step: f64, u: f64) -> [f64; 2] {
    let (va, vb, rise) = (a[1] * step, b[1] * step, b[0] - a[0]);
    let (second, third) = (3.0 * rise - 2.0 * va - vb, va + vb - 2.0 * rise);
    let value = a[0] + u * (va + u * (second + u * third));
    [value, (va + u * (2.0 * second + u * 3.0 * third)) / step]
}

/// A wander of this standard deviation that lasts so long.
pub fn wander(rng: &mut ChaCha8Rng, sigma: f64, lasts_s: f64, times: Times) -> Curve {
    let w = 2.0 / lasts_s;
    let h = times.step_s;
    #[rustfmt::skip]
    let step = Matrix2::new(
        1.0 + w * h, h,
        -w * w * h, 1.0 - w * h,
    ) * (-w * h).exp();
    let steady = Matrix2::from_diagonal(&Vector2::new(1.0, w * w));
    let noise = steady - step * steady * step.transpose();
    // Lower triangle; the first pivot is of third order in the step, and may drown in rounding.
    let a = noise[(0, 0)].max(0.0).sqrt();
    let b = if a > 0.0 { noise[(1, 0)] / a } else { 0.0 };
    let c = (noise[(1, 1)] - b * b).max(0.0).sqrt();
    let mut state = Vector2::new(normal(rng), w * normal(rng));
    let nodes = (0..times.count).map(|_| {
        let now = [sigma * state.x, sigma * state.y];
        let (p, q) = (normal(rng), normal(rng));
        state = step * state + Vector2::new(a * p, b * p + c * q);
        now
    });
    Curve::new(times, nodes.collect())
}

/// Three of them.
pub fn wanders(rng: &mut ChaCha8Rng, sigma: f64, lasts_s: f64, times: Times) -> [Curve; 3] {
    [(); 3].map(|()| wander(rng, sigma, lasts_s, times))
}

/// Values of three curves.
pub fn values(curves: &[Curve; 3], time_s: f64) -> Vector3<f64> {
    Vector3::from_fn(|axis, _| curves[axis].at(time_s)[0])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wander_has_the_covariance_that_it_says() {
        let times = Times { begin_s: 0.0, step_s: 0.1, count: 31 };
        let (sigma, lasts_s) = (0.7, 1.5);
        let w = 2.0 / lasts_s;
        let count = 4000;
        let mut sums = [[0.0; 2]; 31];
        for seed in 0..count {
            let curve = wander(&mut stream(seed, 0, Purpose::Ride, 0), sigma, lasts_s, times);
            for (sum, node) in sums.iter_mut().zip(&curve.nodes) {
                sum[0] += curve.nodes[0][0] * node[0];
                sum[1] += node[1] * node[1];
            }
        }
        for (at, sum) in sums.iter().enumerate() {
            let t = times.time(at);
            let wanted = sigma * sigma * (1.0 + w * t) * (-w * t).exp();
            let found = sum[0] / count as f64;
            // A mean product of 4,000 has a standard deviation of at most 2.3 % of the variance.
            assert!((found - wanted).abs() < 0.08 * sigma * sigma, "{t}: {found} {wanted}");
            let slope = (sum[1] / count as f64).sqrt();
            assert!((slope / (w * sigma) - 1.0).abs() < 0.04, "{slope}");
        }
    }

    #[test]
    fn a_curve_is_smooth_between_its_nodes() {
        let times = Times { begin_s: -0.5, step_s: 0.25, count: 9 };
        let curve = Curve::new(times, (0..9).map(|k| [times.time(k).sin(), times.time(k).cos()]).collect());
        for k in 0..80 {
            let t = -0.5 + 0.025 * f64::from(k);
            let [value, slope] = curve.at(t);
            assert!((value - t.sin()).abs() < 2e-5, "{t}");
            assert!((slope - t.cos()).abs() < 5e-4, "{t}");
        }
    }

    #[test]
    fn streams_are_apart() {
        let mut first = stream(3, 0, Purpose::Ride, 0);
        let values: Vec<f64> = (0..4).map(|_| normal(&mut first)).collect();
        for (seed, run, purpose, thing) in [
            (4, 0, Purpose::Ride, 0),
            (3, 1, Purpose::Ride, 0),
            (3, 0, Purpose::Gross, 0),
            (3, 0, Purpose::Ride, 1),
        ] {
            let mut other = stream(seed, run, purpose, thing);
            assert!(values.iter().all(|v| *v != normal(&mut other)));
        }
    }
}
