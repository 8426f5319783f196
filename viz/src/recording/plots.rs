//! Residuals in numbers: over time, and how many are how large.

use super::{Curve, Recorded, Recorder};
use crate::colour;
use crate::path;
use crate::scene::{ImagePoint, ImagePointKind, Marking};
use crate::sdk::BarChart;

/// Bars of the distribution on either side of zero.
const BARS: i64 = 30;

impl Recorder<'_> {
    /// Root mean square per frame, of the coordinates of image points that take part, and their distribution.
    pub(super) fn residuals(&self) -> Recorded {
        for (kind, name, colour) in [
            (ImagePointKind::Body, "vehicle points", colour::AFTER),
            (ImagePointKind::Target, "targets", colour::CONTROL),
        ] {
            let rms = |(frame, points): (usize, &Vec<ImagePoint>)| {
                let of_kind = points.iter().filter(|p| p.kind == kind);
                let squares: Vec<f64> =
                    of_kind.filter_map(residual).map(|[du, dv]| du * du + dv * dv).collect();
                let mean = squares.iter().sum::<f64>() / (2 * squares.len()) as f64;
                (!squares.is_empty()).then(|| (frame, mean.sqrt()))
            };
            let per_frame = self.scene.image_points.iter().enumerate().filter_map(rms);
            let entity = format!("{}/{}", path::RESIDUALS, name.replace(' ', "_"));
            self.curve(&entity, &Curve::new(name, colour, 2.0), per_frame)?;
        }
        self.distribution()
    }

    fn distribution(&self) -> Recorded {
        let points = self.scene.image_points.iter().flatten();
        let all: Vec<f64> = points.filter_map(residual).flatten().collect();
        let Some((middles, counts)) = histogram(&all) else { return Ok(()) };
        let bars = BarChart::new(counts).with_abscissa(middles).with_color(colour::AFTER);
        self.fixed(path::DISTRIBUTION, &bars)
    }
}

/// Observed minus computed of a point that takes part \[px\].
fn residual(point: &ImagePoint) -> Option<[f64; 2]> {
    let computed = point.computed_px.filter(|_| point.marking == Marking::Good)?;
    Some(std::array::from_fn(|axis| point.observed_px[axis] - computed[axis]))
}

/// Middles of bars of equal width about zero and how many values each has; the outermost hold what is beyond. The
/// width is a round number for which the bars reach four times the root mean square.
pub fn histogram(values: &[f64]) -> Option<(Vec<f64>, Vec<i64>)> {
    let rms = (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt();
    if !(rms.is_finite() && rms > 0.0) {
        return None;
    }
    let least = 4.0 * rms / BARS as f64;
    let decade = 10.0_f64.powf(least.log10().floor());
    let width = [1.0, 2.0, 5.0, 10.0].map(|step| step * decade).into_iter().find(|w| *w >= least)?;
    let mut counts = vec![0; (2 * BARS + 1) as usize];
    for value in values {
        let at = ((value / width).round() as i64).clamp(-BARS, BARS);
        counts[(at + BARS) as usize] += 1;
    }
    Some(((-BARS..=BARS).map(|at| at as f64 * width).collect(), counts))
}
