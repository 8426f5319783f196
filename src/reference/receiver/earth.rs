//! From the Earth (WGS 84, Earth-centred and Earth-fixed) into the world of a problem.

use geodesy::prelude::*;
use nalgebra::{Matrix3, Point3, Vector3};
use std::sync::Arc;

/// Ellipsoidal height is within this \[m\].
const HIGHEST_M: f64 = 1e5;

/// A projection reaches a place if it leads there and back to within this \[m\].
const THERE_AND_BACK_M: f64 = 1e-3;

/// The world of a problem on the Earth.
#[derive(Clone, Debug)]
pub enum World {
    /// East, north and up of a plane that touches the ellipsoid below an origin.
    Tangent {
        /// The origin.
        origin_ecef_m: Point3<f64>,
        /// The directions, by rows.
        enu_from_ecef: Matrix3<f64>,
    },
    /// Easting, northing and ellipsoidal height, less a shift.
    Grid {
        /// What knows the projection.
        context: Arc<Minimal>,
        /// The projection.
        projection: OpHandle,
        /// What is taken off.
        shift_m: Vector3<f64>,
    },
}

/// Whether a place can be one of a vehicle: within 100 km or so of the ellipsoid.
pub fn is_near_the_ground(ecef_m: &Point3<f64>) -> bool {
    (6.25e6..6.48e6).contains(&ecef_m.coords.norm())
}

fn wgs84() -> Ellipsoid {
    // The name is built in.
    Ellipsoid::named("WGS84").unwrap_or_default()
}

/// Earth-centred coordinates of a place, degrees and metres above the ellipsoid; `None` where it is none.
pub fn ecef_m(latitude_deg: f64, longitude_deg: f64, height_m: f64) -> Option<Point3<f64>> {
    let is_place = latitude_deg.abs() <= 90.0 && longitude_deg.abs() <= 360.0 && height_m.abs() <= HIGHEST_M;
    let place = wgs84().cartesian(&Coor3D::geo(latitude_deg, longitude_deg, height_m));
    is_place.then(|| Point3::new(place[0], place[1], place[2]))
}

/// East, north and up (rows) at a place.
pub fn enu_from_ecef(latitude_deg: f64, longitude_deg: f64) -> Matrix3<f64> {
    let (sb, cb) = latitude_deg.to_radians().sin_cos();
    let (sl, cl) = longitude_deg.to_radians().sin_cos();
    Matrix3::new(-sl, cl, 0.0, -sb * cl, -sb * sl, cb, cb * cl, cb * sl, sb)
}

/// Latitude and longitude \[deg\] of a place.
pub fn geodetic_deg(ecef_m: Point3<f64>) -> Option<[f64; 2]> {
    let place = wgs84().geographic(&Coor3D::raw(ecef_m.x, ecef_m.y, ecef_m.z));
    let found = [place[1].to_degrees(), place[0].to_degrees()];
    found.iter().all(|v| v.is_finite()).then_some(found)
}

impl World {
    /// East, north, up at an origin, degrees and metres above the ellipsoid.
    pub fn tangent(latitude_deg: f64, longitude_deg: f64, height_m: f64) -> Option<Self> {
        let origin_ecef_m = ecef_m(latitude_deg, longitude_deg, height_m)?;
        Some(World::Tangent { origin_ecef_m, enu_from_ecef: enu_from_ecef(latitude_deg, longitude_deg) })
    }

    /// A zone of UTM, less a shift \[m\].
    pub fn utm(zone: u32, is_south: bool, shift_m: Vector3<f64>) -> Option<Self> {
        let south = if is_south { " south" } else { "" };
        let definition = format!("utm zone={zone}{south} ellps=WGS84");
        let mut context = Minimal::new();
        let projection = context.op(&definition).ok()?;
        Some(World::Grid { context: Arc::new(context), projection, shift_m })
    }

    /// Where a place is in the world \[m\]; not finite where the projection does not reach it.
    pub fn place(&self, ecef_m: Point3<f64>) -> Point3<f64> {
        match self {
            World::Tangent { origin_ecef_m, enu_from_ecef } => {
                Point3::from(enu_from_ecef * (ecef_m - origin_ecef_m))
            }
            World::Grid { context, projection, shift_m } => {
                let mut place = [wgs84().geographic(&Coor3D::raw(ecef_m.x, ecef_m.y, ecef_m.z))];
                let done = context.apply(*projection, Fwd, &mut place).is_ok();
                let [x, y, z] = [0, 1, 2].map(|axis| if done { place[0][axis] } else { f64::NAN });
                Point3::new(x, y, z) - shift_m
            }
        }
    }

    /// Latitude and longitude \[deg\] of a place in the world \[m\]; `None` where it is not finite or the projection
    /// does not reach it.
    pub fn geodetic_deg(&self, place_m: Point3<f64>) -> Option<[f64; 2]> {
        match self {
            World::Tangent { origin_ecef_m, enu_from_ecef } => {
                geodetic_deg(origin_ecef_m + enu_from_ecef.transpose() * place_m.coords)
            }
            World::Grid { context, projection, shift_m } => {
                let on_grid = place_m + shift_m;
                let mut place = [Coor3D::raw(on_grid.x, on_grid.y, on_grid.z)];
                context.apply(*projection, Inv, &mut place).ok()?;
                let ecef_m = wgs84().cartesian(&place[0]);
                let ecef_m = Point3::new(ecef_m[0], ecef_m[1], ecef_m[2]);
                // Far from its meridian it turns back on itself.
                let is_reached = (self.place(ecef_m) - place_m).norm() < THERE_AND_BACK_M;
                if is_reached { geodetic_deg(ecef_m) } else { None }
            }
        }
    }

    /// A velocity at a place, in the axes of the world \[m/s\].
    pub fn velocity(&self, ecef_m: Point3<f64>, velocity_mps: Vector3<f64>) -> Vector3<f64> {
        self.place(ecef_m + velocity_mps / 2.0) - self.place(ecef_m - velocity_mps / 2.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Closed form of geographic into Earth-centred coordinates.
    fn plain_ecef(latitude_deg: f64, longitude_deg: f64, height_m: f64) -> Point3<f64> {
        let (a, f) = (6_378_137.0, 1.0 / 298.257_223_563);
        let e2: f64 = f * (2.0 - f);
        let (sb, cb) = latitude_deg.to_radians().sin_cos();
        let (sl, cl) = longitude_deg.to_radians().sin_cos();
        let n = a / (1.0 - e2 * sb * sb).sqrt();
        Point3::new((n + height_m) * cb * cl, (n + height_m) * cb * sl, (n * (1.0 - e2) + height_m) * sb)
    }

    #[test]
    fn cartesian_coordinates_are_those_of_the_formula() {
        for (b, l, h) in [(45.4, 11.9, 57.0), (-33.9, 151.2, 300.0), (0.0, 0.0, 0.0), (78.2, -15.6, -20.0)] {
            assert!((ecef_m(b, l, h).unwrap() - plain_ecef(b, l, h)).norm() < 1e-8);
            let [latitude, longitude] = geodetic_deg(plain_ecef(b, l, h)).unwrap();
            assert!((latitude - b).abs() < 1e-11 && (longitude - l).abs() < 1e-11);
        }
        assert!(ecef_m(91.0, 0.0, 0.0).is_none() && ecef_m(0.0, 0.0, f64::NAN).is_none());
    }

    #[test]
    fn the_tangent_plane_has_east_north_and_up() {
        let world = World::tangent(45.0, 12.0, 50.0).unwrap();
        let at = |b, l, h| world.place(plain_ecef(b, l, h));
        let north = at(45.0 + 1e-4, 12.0, 50.0);
        // Radius of the meridian at 45 deg, 6,367,381.8 m, and of the parallel, 4,517,590.9 m.
        assert!(
            (north.y - (6_367_381.8 + 50.0) * 1e-4_f64.to_radians()).abs() < 1e-4 && north.x.abs() < 1e-6
        );
        let east = at(45.0, 12.0 + 1e-4, 50.0);
        assert!((east.x - (4_517_590.9 + 35.4) * 1e-4_f64.to_radians()).abs() < 1e-4 && east.y.abs() < 1e-4);
        assert!((at(45.0, 12.0, 51.0) - Point3::new(0.0, 0.0, 1.0)).norm() < 1e-8);
    }

    /// Transverse Mercator by the series of Redfearn (1948), good to a millimetre within a zone.
    fn redfearn(latitude_deg: f64, from_meridian_deg: f64) -> [f64; 2] {
        let (a, f) = (6_378_137.0, 1.0 / 298.257_223_563);
        let e2: f64 = f * (2.0 - f);
        let (phi, w) = (latitude_deg.to_radians(), from_meridian_deg.to_radians());
        let (s, c) = phi.sin_cos();
        let t = (s / c).powi(2);
        let nu = a / (1.0 - e2 * s * s).sqrt();
        let rho = a * (1.0 - e2) / (1.0 - e2 * s * s).powf(1.5);
        let psi = nu / rho;
        // The arc of the meridian by Simpson's rule.
        let radius = |p: f64| a * (1.0 - e2) / (1.0 - e2 * p.sin().powi(2)).powf(1.5);
        let steps = 2000;
        let h = phi / f64::from(steps);
        let arc: f64 = (0..=steps)
            .map(|i| {
                let weight = if i == 0 || i == steps {
                    1.0
                } else if i % 2 == 1 {
                    4.0
                } else {
                    2.0
                };
                weight * radius(f64::from(i) * h)
            })
            .sum::<f64>()
            * h
            / 3.0;
        let x2 = w * w * c * c;
        let east = 1.0
            + x2 / 6.0 * (psi - t)
            + x2 * x2 / 120.0
                * (4.0 * psi.powi(3) * (1.0 - 6.0 * t) + psi * psi * (1.0 + 8.0 * t) - 2.0 * psi * t + t * t)
            + x2.powi(3) / 5040.0 * (61.0 - 479.0 * t + 179.0 * t * t - t.powi(3));
        let north = w * w / 2.0
            + w * w * x2 / 24.0 * (4.0 * psi * psi + psi - t)
            + w * w * x2 * x2 / 720.0
                * (8.0 * psi.powi(4) * (11.0 - 24.0 * t) - 28.0 * psi.powi(3) * (1.0 - 6.0 * t)
                    + psi * psi * (1.0 - 32.0 * t)
                    - 2.0 * psi * t
                    + t * t);
        [500_000.0 + 0.9996 * nu * w * c * east, 0.9996 * (arc + nu * s * c * north)]
    }

    #[test]
    fn zones_are_those_of_the_series() {
        for (b, l) in [(45.4, 11.9), (45.0, 9.0), (59.9, 6.3), (2.0, 11.0)] {
            let world = World::utm(32, false, Vector3::new(0.0, 0.0, 7.0)).unwrap();
            let place = world.place(plain_ecef(b, l, 57.0));
            let [x, y] = redfearn(b, l - 9.0);
            assert!((place - Point3::new(x, y, 50.0)).norm() < 1e-3, "{b} {l}: {place} {x} {y}");
            let south = World::utm(32, true, Vector3::zeros()).unwrap().place(plain_ecef(-b, l, 57.0));
            assert!((south - Point3::new(x, 1e7 - y, 57.0)).norm() < 1e-3);
        }
    }

    #[test]
    fn places_lead_back_to_the_earth() {
        let shift_m = Vector3::new(724_000.0, 5_031_000.0, 10.0);
        for (world, b, l) in [
            (World::tangent(45.4, 11.9, 57.0).unwrap(), 45.4, 11.9),
            (World::tangent(-33.9, 151.2, 0.0).unwrap(), -33.9, 151.2),
            (World::utm(32, false, shift_m).unwrap(), 45.4, 11.9),
            (World::utm(32, false, Vector3::zeros()).unwrap(), 59.9, 6.3),
            (World::utm(56, true, Vector3::zeros()).unwrap(), -33.9, 151.2),
        ] {
            for (north, east, h) in [(0.0, 0.0, 57.0), (0.01, -0.02, 0.0), (-0.03, 0.01, 300.0)] {
                let (b, l) = (b + north, l + east);
                let [latitude, longitude] = world.geodetic_deg(world.place(plain_ecef(b, l, h))).unwrap();
                assert!(
                    (latitude - b).abs() < 1e-9 && (longitude - l).abs() < 1e-9,
                    "{latitude} {longitude}"
                );
            }
            assert!(world.geodetic_deg(Point3::new(f64::NAN, 0.0, 0.0)).is_none());
            assert!(world.geodetic_deg(Point3::new(0.0, f64::INFINITY, 0.0)).is_none());
        }
        let utm = World::utm(32, false, Vector3::zeros()).unwrap();
        for (x, y) in [(1e8, 5e6), (5e5, 5e7), (2e7, 0.0), (f64::MAX, f64::MAX)] {
            assert_eq!(utm.geodetic_deg(Point3::new(x, y, 0.0)), None, "{x} {y}");
        }
    }

    #[test]
    fn velocities_turn_with_the_grid() {
        let (b, l) = (45.4, 11.9);
        let world = World::utm(32, false, Vector3::zeros()).unwrap();
        let north = enu_from_ecef(b, l).row(1).transpose() * 10.0;
        let velocity = world.velocity(plain_ecef(b, l, 57.0), north);
        // Convergence of the meridian: atan(tan(l - l0) sin b); north on the ground leans to the west here.
        let convergence = ((l - 9.0f64).to_radians().tan() * b.to_radians().sin()).atan();
        assert!((velocity.x / velocity.y + convergence.tan()).abs() < 1e-5, "{velocity} {convergence}");
        assert!((velocity.norm() - 10.0).abs() < 5e-3);
    }
}
