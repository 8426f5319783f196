//! Clouds of points: how far two of them are apart, and by what motion one comes onto the other.
//!
//! Functions of points in metres; nothing here knows what the points are or where they come from.

pub mod index;
pub mod m3c2;
pub mod mesh;
pub mod plane;
pub mod register;
pub mod statistics;
pub mod surface;
pub mod truth;

pub use index::{CloudError, CloudIndex, Nearest, distances};
pub use statistics::DistanceStatistics;

#[cfg(test)]
mod tests {
    use nalgebra::Point3;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// Random numbers for tests.
    pub struct Draws(ChaCha8Rng);

    impl Draws {
        pub fn new(seed: u64) -> Self {
            Draws(ChaCha8Rng::seed_from_u64(seed))
        }

        /// From 0 to 1.
        pub fn uniform(&mut self) -> f64 {
            self.0.random_range(0.0..1.0)
        }

        /// With mean 0 and variance 1 (Box and Muller).
        pub fn normal(&mut self) -> f64 {
            let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
            radius * (std::f64::consts::TAU * self.uniform()).cos()
        }
    }

    /// A scan of a real car.
    pub fn scan() -> Vec<Point3<f64>> {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../problems/suv-exact/reference/car1.ply");
        let text = std::fs::read_to_string(path).unwrap();
        let (_, rows) = text.split_once("end_header\n").unwrap();
        let point = |row: &str| {
            let mut numbers = row.split_whitespace().map(|n| n.parse().unwrap());
            Point3::from([(); 3].map(|()| numbers.next().unwrap()))
        };
        rows.lines().map(point).collect()
    }

    /// Points on the faces of a box as large as a car.
    pub fn shell(count: usize, seed: u64) -> Vec<Point3<f64>> {
        let mut draws = Draws::new(seed);
        let half = [2.3, 0.9, 0.8];
        (0..count)
            .map(|_| {
                let face = (draws.uniform() * 6.0) as usize;
                let mut point = half.map(|half| half * (2.0 * draws.uniform() - 1.0));
                point[face / 2] = half[face / 2] * if face.is_multiple_of(2) { 1.0 } else { -1.0 };
                Point3::from(point)
            })
            .collect()
    }
}
