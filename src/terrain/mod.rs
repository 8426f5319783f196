//! The ground: heights and slopes.

use nalgebra::{Vector2, Vector3};

/// A terrain model in the frame of the world, z up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Terrain {
    /// The horizontal plane at this height \[m\].
    Plane {
        /// Its height.
        z_m: f64,
    },
}

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
    fn a_normal_is_square_to_the_slope() {
        let ground = Ground { height_m: 0.0, slope: Vector2::new(0.1, -0.3) };
        for along in [Vector3::new(1.0, 0.0, 0.1), Vector3::new(0.0, 1.0, -0.3)] {
            assert!(ground.normal().dot(&along).abs() < 1e-15);
        }
    }
}
