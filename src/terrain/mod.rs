//! The ground: heights and slopes.

use nalgebra::{Point3, Vector2, Vector3};

/// A terrain model in the frame of the world, z up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Terrain {
    /// The horizontal plane at this height \[m\].
    Plane {
        /// Its height.
        z_m: f64,
    },
}

/// A ray does not meet the terrain.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the ray does not meet the terrain")]
pub struct MissedTerrain;

/// The ground below a place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ground {
    /// Height \[m\].
    pub height_m: f64,
    /// Derivative of the height by x and y.
    pub slope: Vector2<f64>,
}

impl Terrain {
    /// Height and slope at `x`, `y` \[m\].
    pub fn at(&self, _x_m: f64, _y_m: f64) -> Ground {
        match self {
            Terrain::Plane { z_m } => Ground { height_m: *z_m, slope: Vector2::zeros() },
        }
    }

    /// Where the ray from `origin` along `direction` first meets the terrain raised by `raised_m`.
    pub fn intersect(
        &self,
        origin: &Point3<f64>,
        direction: &Vector3<f64>,
        raised_m: f64,
    ) -> Result<Point3<f64>, MissedTerrain> {
        match self {
            Terrain::Plane { z_m } => {
                let along = (z_m + raised_m - origin.z) / direction.z;
                if along.is_finite() && along >= 0.0 {
                    Ok(origin + along * direction)
                } else {
                    Err(MissedTerrain)
                }
            }
        }
    }
}

impl Ground {
    /// The unit normal, upwards.
    pub fn normal(&self) -> Vector3<f64> {
        Vector3::new(-self.slope.x, -self.slope.y, 1.0).normalize()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plane_is_level_everywhere() {
        let ground = Terrain::Plane { z_m: 3.5 }.at(100.0, -20.0);
        assert_eq!(ground.height_m, 3.5);
        assert_eq!(ground.normal(), Vector3::z());
    }

    #[test]
    fn a_ray_meets_the_raised_plane_or_misses_it() {
        let terrain = Terrain::Plane { z_m: 3.0 };
        let met = terrain.intersect(&Point3::new(1.0, 2.0, 13.0), &Vector3::new(0.5, 0.0, -1.0), 2.0);
        assert_eq!(met, Ok(Point3::new(5.0, 2.0, 5.0)));
        for away in [Vector3::z(), Vector3::x()] {
            assert_eq!(terrain.intersect(&Point3::new(1.0, 2.0, 13.0), &away, 2.0), Err(MissedTerrain));
        }
    }

    #[test]
    fn a_normal_is_square_to_the_slope() {
        let ground = Ground { height_m: 0.0, slope: Vector2::new(0.1, -0.3) };
        for along in [Vector3::new(1.0, 0.0, 0.1), Vector3::new(0.0, 1.0, -0.3)] {
            assert!(ground.normal().dot(&along).abs() < 1e-15);
        }
    }
}
