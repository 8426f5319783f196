//! Alignment of a track with its reference, on request: least squares over the associated positions
//! (Umeyama 1991), all of them with the same weight.
//!
//! A rotation is found from positions alone. About a nearly straight track it is determined by nothing but
//! what the track scatters: it is applied all the same, as other programs do, and
//! [`Aligned::is_turn_determined`] tells.

use crate::geometry::Pose;
use crate::geometry::align::{rigid_fit, similarity_fit};
use crate::rules::rules;
use nalgebra::{Matrix3, Point3, Vector3};

/// What may be changed of the result before it is compared.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Alignment {
    /// Nothing.
    #[default]
    None,
    /// Rotation and shift.
    Rigid,
    /// Rotation, shift and scale.
    Similarity,
}

impl Alignment {
    /// Its name in options and reports.
    pub fn name(self) -> &'static str {
        match self {
            Alignment::None => "none",
            Alignment::Rigid => "rigid",
            Alignment::Similarity => "similarity",
        }
    }
}

/// What was applied: `reference = scale R result + t`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aligned {
    /// What was free.
    pub alignment: Alignment,
    /// The scale; 1 where it was not free.
    pub scale: f64,
    /// `R` and `t`.
    pub motion: Pose,
    /// How far the centroid of the associated positions was moved \[m\].
    pub shift_m: Vector3<f64>,
    /// Standard deviations of the associated positions of the result along their principal axes, the
    /// largest first \[m\].
    pub spread_m: [f64; 3],
}

rules! {
    /// What may be aligned before a comparison.
    pub struct AlignmentRules {
        /// A track that is not so wide says nothing of the turn about it.
        least_width_factor: f64 = 10.0, "times what is left of it";
    }
}

const RULES: AlignmentRules = AlignmentRules::DEFAULT;

impl Aligned {
    /// Nothing applied.
    pub fn none() -> Self {
        Aligned {
            alignment: Alignment::None,
            scale: 1.0,
            motion: Pose::identity(),
            shift_m: Vector3::zeros(),
            spread_m: [0.0; 3],
        }
    }

    /// The fit of the result's positions to those of the reference, pair by pair; or why there is none.
    pub fn fit(
        alignment: Alignment,
        result: &[Point3<f64>],
        reference: &[Point3<f64>],
    ) -> Result<Self, String> {
        let found = match alignment {
            Alignment::None => return Ok(Aligned::none()),
            Alignment::Rigid => rigid_fit(result, reference).map(|motion| (1.0, motion)),
            Alignment::Similarity => similarity_fit(result, reference),
        };
        let (scale, motion) = found.ok_or_else(|| {
            format!(
                "an alignment ({}) is not determined by its {} associated positions: three or more that do not \
                 lie on a line are needed (--alignment none)",
                alignment.name(),
                result.len()
            )
        })?;
        let mean = |points: &[Point3<f64>]| -> Vector3<f64> {
            points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / points.len() as f64
        };
        let centre = mean(result);
        let scatter: Matrix3<f64> =
            result.iter().map(|p| (p.coords - centre) * (p.coords - centre).transpose()).sum();
        let mut spread_m: [f64; 3] = scatter
            .symmetric_eigenvalues()
            .map(|square| (square.max(0.0) / result.len() as f64).sqrt())
            .into();
        spread_m.sort_by(|a, b| b.total_cmp(a));
        Ok(Aligned { alignment, scale, motion, shift_m: mean(reference) - centre, spread_m })
    }

    /// A position of the result where it was brought \[m\].
    pub fn position(&self, position: &Point3<f64>) -> Point3<f64> {
        match self.alignment {
            Alignment::None => *position,
            _ => Point3::from(
                self.scale * (self.motion.rotation * position.coords) + self.motion.translation.vector,
            ),
        }
    }

    /// A horizontal direction of the result where it was turned \[rad\].
    pub fn heading_rad(&self, heading_rad: f64) -> f64 {
        match self.alignment {
            Alignment::None => heading_rad,
            _ => {
                let turned = self.motion.rotation * Vector3::new(heading_rad.cos(), heading_rad.sin(), 0.0);
                turned.y.atan2(turned.x)
            }
        }
    }

    /// The same in degrees.
    pub fn heading_deg(&self, heading_deg: f64) -> f64 {
        match self.alignment {
            Alignment::None => heading_deg,
            _ => self.heading_rad(heading_deg.to_radians()).to_degrees(),
        }
    }

    /// The angle of the rotation \[rad\].
    pub fn angle_rad(&self) -> f64 {
        self.motion.rotation.angle()
    }

    /// Whether the track is so wide that the turn about it is determined by more than what is left of it, of
    /// which the root mean square distance is `rms_m`.
    pub fn is_turn_determined(&self, rms_m: f64) -> bool {
        self.alignment == Alignment::None || self.spread_m[1] > RULES.least_width_factor * rms_m
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::pose;

    fn bend() -> Vec<Point3<f64>> {
        let at = |k: i32| f64::from(k) * 0.5;
        (0..40).map(at).map(|t| Point3::new(8.0 * t, 20.0 * (0.2 * t).sin(), 0.1 * t)).collect()
    }

    #[test]
    fn what_was_applied_comes_back() {
        let motion = pose([3.0, -2.0, 1.0], [0.99, 0.0, 0.0, 0.1]);
        let reference: Vec<_> = bend().iter().map(|p| motion * (p * 1.01)).collect();
        let found = Aligned::fit(Alignment::Similarity, &bend(), &reference).unwrap();
        assert!((found.scale - 1.01).abs() < 1e-12);
        for (from, to) in bend().iter().zip(&reference) {
            assert!((found.position(from) - to).norm() < 1e-11);
        }
        // A turn about the vertical adds its angle to a heading.
        let angle = 2.0 * 0.1_f64.atan2(0.99);
        assert!((found.angle_rad() - angle).abs() < 1e-9);
        assert!((found.heading_rad(0.3) - 0.3 - angle).abs() < 1e-9);
        let mean = |of: fn(&Point3<f64>) -> f64| bend().iter().map(of).sum::<f64>() / 40.0;
        let centre = Point3::new(mean(|p| p.x), mean(|p| p.y), mean(|p| p.z));
        assert!((found.shift_m - (motion * (centre * 1.01) - centre)).norm() < 1e-11);
        // The scale is not found where it is not free, nor anything where nothing is.
        let rigid = Aligned::fit(Alignment::Rigid, &bend(), &reference).unwrap();
        assert!(rigid.scale == 1.0 && (rigid.position(&bend()[0]) - reference[0]).norm() > 0.1);
        let none = Aligned::fit(Alignment::None, &bend(), &reference).unwrap();
        assert_eq!((none.position(&bend()[3]), none.heading_rad(0.3)), (bend()[3], 0.3));
    }

    #[test]
    fn a_line_is_refused_and_a_nearly_straight_track_is_told() {
        let line: Vec<_> = (0..40).map(|k| Point3::new(f64::from(k), 2.0 * f64::from(k), 0.0)).collect();
        let why = Aligned::fit(Alignment::Rigid, &line, &line).unwrap_err();
        assert!(why.contains("(rigid)") && why.contains("on a line"), "{why}");
        assert!(Aligned::fit(Alignment::Similarity, &bend()[..2], &bend()[..2]).is_err());
        let nearly: Vec<_> =
            (0..40).map(|k| Point3::new(f64::from(k), 0.05 * f64::from(k % 3), 0.0)).collect();
        let found = Aligned::fit(Alignment::Rigid, &nearly, &nearly).unwrap();
        assert!(!found.is_turn_determined(0.02) && found.is_turn_determined(0.001), "{found:?}");
        assert!((found.spread_m[0] - (1599.0_f64 / 12.0).sqrt()).abs() < 1e-3, "{found:?}");
    }
}
