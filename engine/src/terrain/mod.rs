//! The ground: heights and slopes, of a level plane or of a grid of heights.

mod esri;
mod footing;
mod geotiff;
mod grid;
mod rounded;

pub use footing::FootingNoise;
pub use grid::Grid;

use crate::rules::Rules;
use nalgebra::{Matrix2, Matrix3x2, Point3, Vector2, Vector3};
use std::sync::Arc;

/// The constants of the terrain.
pub fn constants() -> Vec<Rules> {
    vec![grid::BorderRules::PAGE, footing::FootingRules::PAGE, rounded::EdgeRules::PAGE]
}

/// A terrain model in the frame of the world, z up. A clone is cheap.
#[derive(Clone, Debug, PartialEq)]
pub enum Terrain {
    /// The horizontal plane at this height \[m\].
    Plane {
        /// Its height.
        z_m: f64,
    },
    /// A grid of heights.
    Grid(Arc<Grid>),
}

/// The ground below a place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ground {
    /// Height \[m\].
    pub height_m: f64,
    /// Derivative of the height by x and y.
    pub slope: Vector2<f64>,
    /// Second derivatives of the height by x and y \[1/m\].
    pub bend_per_m: Matrix2<f64>,
}

/// There is no ground at a place; x and y in the world \[m\].
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum NoGround {
    /// Beyond the outermost cell centres.
    #[error("({x_m:.2}, {y_m:.2}) lies outside the terrain grid")]
    OutsideGrid {
        /// x.
        x_m: f64,
        /// y.
        y_m: f64,
    },
    /// One of the four cells around it has no height.
    #[error("the terrain grid has no data at ({x_m:.2}, {y_m:.2})")]
    NoData {
        /// x.
        x_m: f64,
        /// y.
        y_m: f64,
    },
    /// A ray from here never comes to the ground.
    #[error("the ray from ({x_m:.2}, {y_m:.2}) never comes to the ground")]
    NeverReached {
        /// x of its origin.
        x_m: f64,
        /// y of its origin.
        y_m: f64,
    },
}

/// What is wrong with the file of a grid.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GridFault {
    /// The line, from 1, where the format has lines.
    pub line: Option<u64>,
    /// Key of the header, tag, or number of the column of heights.
    pub column: Option<String>,
    /// What was wanted.
    pub wanted: String,
    /// What stands there.
    pub found: String,
}

/// A grid of so many cells is kept whole.
const MOST_CELLS: usize = 1 << 26;

impl Terrain {
    /// Reads a grid of heights \[m\] in the x, y of the world: a GeoTIFF if the bytes begin as one or
    /// the name ends in `.tif` or `.tiff`, else an ESRI ASCII grid. The error is everything that is
    /// wrong with it, and never empty.
    ///
    /// A GeoTIFF of more than 2^26 cells is read where it is needed alone, in `area`: the least and the largest x and y
    /// \[m\].
    pub fn read_grid(
        name: &str,
        bytes: &[u8],
        area: Option<[[f64; 2]; 2]>,
    ) -> Result<Terrain, Vec<GridFault>> {
        let name = name.to_ascii_lowercase();
        let is_tiff = geotiff::is_tiff(bytes) || name.ends_with(".tif") || name.ends_with(".tiff");
        let grid = if is_tiff {
            geotiff::parse(bytes, area, MOST_CELLS).map_err(|fault| vec![fault])
        } else {
            esri::parse(bytes)
        };
        Ok(Terrain::Grid(Arc::new(grid?)))
    }

    /// Height and slope at `x`, `y` \[m\]. At the border between two cells of a grid the slope is that
    /// of the cell on the side of larger x or y.
    pub fn at(&self, x_m: f64, y_m: f64) -> Result<Ground, NoGround> {
        match self {
            Terrain::Plane { z_m } => {
                Ok(Ground { height_m: *z_m, slope: Vector2::zeros(), bend_per_m: Matrix2::zeros() })
            }
            Terrain::Grid(grid) => grid.at(x_m, y_m),
        }
    }

    /// The ground that bears a vehicle: the same with the edges between the cells of a grid rounded over half a metre,
    /// and where a grid is fine and noisy, that of local fits to it, whose noise is [`Terrain::footing_noise`]. Up to
    /// some metres beyond its border the ground is continued from there, without a jump: for a minimiser, whose steps
    /// must be able to cross it. `None` farther off.
    pub fn footing_at(&self, x_m: f64, y_m: f64) -> Option<Ground> {
        match self {
            Terrain::Plane { .. } => self.at(x_m, y_m).ok(),
            Terrain::Grid(grid) => grid.footing_at(x_m, y_m),
        }
    }

    /// What noise is left in [`Terrain::footing_at`]; `None` where it is the terrain as it came.
    pub fn footing_noise(&self) -> Option<FootingNoise> {
        match self {
            Terrain::Plane { .. } => None,
            Terrain::Grid(grid) => grid.footing_noise(),
        }
    }

    /// How uneven the ground is under a vehicle that touches it `reach_m` from its middle \[m\]: how far the mean height
    /// of four places there is from that in the middle \[m\], and the root mean square of how far a component of the
    /// slope is. Places without ground do not count; zero without any.
    pub fn unevenness_at(&self, x_m: f64, y_m: f64, reach_m: f64) -> [f64; 2] {
        let Some(middle) = self.footing_at(x_m, y_m) else { return [0.0; 2] };
        let around = [(reach_m, 0.0), (-reach_m, 0.0), (0.0, reach_m), (0.0, -reach_m)];
        let places: Vec<Ground> =
            around.iter().filter_map(|(dx, dy)| self.footing_at(x_m + dx, y_m + dy)).collect();
        let count = places.len().max(1) as f64;
        let higher_m = places.iter().map(|place| place.height_m - middle.height_m).sum::<f64>() / count;
        let steeper = places.iter().map(|place| (place.slope - middle.slope).norm_squared()).sum::<f64>();
        [higher_m.abs(), (steeper / (2.0 * count)).sqrt()]
    }

    /// The first place where a ray meets the ground raised by `raised_m`.
    ///
    /// `direction` has any length but zero. Above the highest height of a grid there is nothing to
    /// meet; from where it comes below it the ray must stay over cells that have heights until it
    /// meets the ground. Where it does not, the error says where it left them.
    pub fn intersect(
        &self,
        origin: &Point3<f64>,
        direction: &Vector3<f64>,
        raised_m: f64,
    ) -> Result<Point3<f64>, NoGround> {
        match self {
            Terrain::Plane { z_m } => {
                let share = (z_m + raised_m - origin.z) / direction.z;
                if share.is_finite() && share >= 0.0 {
                    Ok(origin + share * direction)
                } else {
                    Err(NoGround::NeverReached { x_m: origin.x, y_m: origin.y })
                }
            }
            Terrain::Grid(grid) => grid.intersect(origin, direction, raised_m),
        }
    }
}

impl Ground {
    /// The unit normal, upwards.
    pub fn normal(&self) -> Vector3<f64> {
        Vector3::new(-self.slope.x, -self.slope.y, 1.0).normalize()
    }

    /// Derivative of [`Ground::normal`] by x and y, 3 x 2 \[1/m\].
    pub fn normal_by_place(&self) -> Matrix3x2<f64> {
        let upwards = Vector3::new(-self.slope.x, -self.slope.y, 1.0);
        let normal = upwards.normalize();
        let mut change = Matrix3x2::zeros();
        change.fixed_view_mut::<2, 2>(0, 0).copy_from(&-self.bend_per_m);
        (change - normal * (normal.transpose() * change)) / upwards.norm()
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// A grid of 2 m cells with hills, twisted everywhere, from (-20, -20) to (20, 20).
    pub(crate) fn hills() -> Terrain {
        let height = |column: usize, row: usize| {
            let (x, y) = (column as f64, row as f64);
            0.6 * (0.7 * x).sin() + 0.04 * x * y - 0.3 * (0.9 * y + 0.2 * x).cos()
        };
        let heights = (0..21).flat_map(|row| (0..21).map(move |column| height(column, row))).collect();
        let grid = Grid::new([-20.0, -20.0], [2.0, 2.0], [21, 21], heights).unwrap();
        Terrain::Grid(Arc::new(grid))
    }

    #[test]
    fn a_plane_is_level_everywhere() {
        let ground = Terrain::Plane { z_m: 3.5 }.at(100.0, -20.0).unwrap();
        assert_eq!(ground.height_m, 3.5);
        assert_eq!(ground.normal(), Vector3::z());
    }

    #[test]
    fn what_is_uneven_is_what_the_ground_around_says() {
        // A bowl: r^2 b / 2 above its middle, b r steeper along the way to each place.
        let (bend, reach_m) = (0.04, 1.5);
        let height = |at: usize| {
            let [x, y] = [at % 81, at / 81].map(|k| 0.5 * k as f64 - 20.0);
            0.5 * bend * (x * x + y * y)
        };
        let heights = (0..81 * 81).map(height).collect();
        let bowl = Terrain::Grid(Arc::new(Grid::new([-20.0, -20.0], [0.5; 2], [81; 2], heights).unwrap()));
        let [higher_m, steeper] = bowl.unevenness_at(3.0, -2.0, reach_m);
        assert!((higher_m / (0.5 * bend * reach_m.powi(2)) - 1.0).abs() < 0.05, "{higher_m}");
        assert!((steeper / (bend * reach_m / 2_f64.sqrt()) - 1.0).abs() < 0.05, "{steeper}");
        assert_eq!(Terrain::Plane { z_m: 2.0 }.unevenness_at(0.0, 0.0, reach_m), [0.0; 2]);
        assert_eq!(bowl.unevenness_at(500.0, 0.0, reach_m), [0.0; 2]);
    }

    #[test]
    fn a_normal_is_square_to_the_slope() {
        let ground = Ground { height_m: 0.0, slope: Vector2::new(0.1, -0.3), bend_per_m: Matrix2::zeros() };
        for along in [Vector3::new(1.0, 0.0, 0.1), Vector3::new(0.0, 1.0, -0.3)] {
            assert!(ground.normal().dot(&along).abs() < 1e-15);
        }
    }

    #[test]
    fn derivatives_are_those_of_differences() {
        let terrain = hills();
        let as_it_is = |x, y| terrain.at(x, y).unwrap();
        let rounded = |x, y| terrain.footing_at(x, y).unwrap();
        derivatives_of(&as_it_is);
        derivatives_of(&rounded);
    }

    fn derivatives_of(at: &dyn Fn(f64, f64) -> Ground) {
        for (x, y) in [(-18.7, 3.3), (0.7, 0.4), (0.2, 3.9), (11.9, -7.1), (19.1, 18.9)] {
            let (ground, h) = (at(x, y), 1e-5);
            for (axis, [dx, dy]) in [[h, 0.0], [0.0, h]].into_iter().enumerate() {
                let (after, before) = (at(x + dx, y + dy), at(x - dx, y - dy));
                let slope = (after.height_m - before.height_m) / (2.0 * h);
                assert!((slope - ground.slope[axis]).abs() < 1e-8);
                let bend = (after.slope - before.slope) / (2.0 * h);
                assert!((bend - ground.bend_per_m.column(axis)).norm() < 1e-8 && bend.norm() > 1e-3);
                let turn = (after.normal() - before.normal()) / (2.0 * h);
                assert!((turn - ground.normal_by_place().column(axis)).norm() < 1e-8);
            }
        }
    }

    #[test]
    fn a_ray_meets_a_plane() {
        let plane = Terrain::Plane { z_m: 1.0 };
        let origin = Point3::new(2.0, 3.0, 11.0);
        let hit = plane.intersect(&origin, &Vector3::new(0.5, -1.0, -2.0), 2.0).unwrap();
        assert!((hit - Point3::new(4.0, -1.0, 3.0)).norm() < 1e-14);
        let never = Err(NoGround::NeverReached { x_m: 2.0, y_m: 3.0 });
        for direction in [Vector3::z(), Vector3::x(), Vector3::zeros()] {
            assert_eq!(plane.intersect(&origin, &direction, 0.0), never);
        }
    }
}
