//! The way of the adjustment.

use super::{Curve, Recorded, Recorder, on_screen};
use crate::colour;
use crate::path::{self, part};
use crate::scene::Iteration;
use crate::sdk::{AsComponents, BarChart, LineStrips3D, Points3D, Scalars, TextLog};

const TIMELINE: &str = "iteration";

impl Recorder<'_> {
    /// Numbers and state of an iteration; 0 is the start.
    pub fn iteration(&self, number: usize, iteration: &Iteration) -> Recorded {
        for (name, colour, value) in [
            ("cost", colour::AFTER, Some(iteration.cost)),
            ("damping", colour::BEFORE, Some(iteration.damping)),
            ("step", colour::CONTROL, iteration.step),
        ] {
            let entity = format!("{}/{name}", path::ITERATIONS);
            if number == 0 {
                let curve = Curve::new(format!("log10 {name}"), colour, 2.0);
                self.fixed(&entity, &self.style(&curve))?;
            }
            if let Some(value) = value {
                self.at_iteration(number, &entity, &Scalars::single(log10(value)))?;
            }
        }
        let text = TextLog::new(format!("{number}: {}, cost {:.6e}", iteration.stage, iteration.cost));
        self.at_iteration(number, path::LOG, &text)?;
        let state = &iteration.state;
        let places: Vec<[f64; 3]> = state.camera.iter().map(|pose| pose.position_m).collect();
        self.line(number, "camera", &places)?;
        // Cameras of the first frame: without a pose on this timeline they would stand at zero.
        let first = self.scene.camera.before.first();
        for (entity, pose) in [(path::CAMERA, state.camera.first()), (path::CAMERA_START, first)] {
            if let Some(pose) = pose {
                self.at_iteration(number, entity, &self.transform(pose))?;
            }
        }
        for body in &state.bodies {
            self.line(number, &part(&body.id), &body.track_m)?;
            let points = Points3D::new(body.points_m.iter().map(|p| p.map(|v| v as f32)))
                .with_colors([colour::ON_THE_WAY])
                .with_radii([on_screen(1.5)]);
            self.at_iteration(number, &format!("{}/{}/iteration", path::SHAPES, part(&body.id)), &points)?;
        }
        Ok(())
    }

    fn line(&self, number: usize, whose: &str, places_m: &[[f64; 3]]) -> Recorded {
        let strip = LineStrips3D::new([places_m.iter().map(|p| self.local(*p)).collect::<Vec<_>>()])
            .with_colors([colour::ON_THE_WAY])
            .with_radii([on_screen(1.0)]);
        self.at_iteration(number, &format!("{}/{whose}/iteration", path::PATHS), &strip)
    }

    fn at_iteration(&self, number: usize, entity: &str, what: &impl AsComponents) -> Recorded {
        self.stream.set_time_sequence(TIMELINE, number as i64);
        let logged = self.stream.log(self.at(entity), what);
        self.stream.reset_time();
        Ok(logged?)
    }

    /// The cost of each iteration as bars.
    pub(super) fn cost_bars(&self) -> Recorded {
        let bars: Vec<f64> = self.scene.iterations.iter().map(|i| log10(i.cost)).collect();
        if bars.is_empty() {
            return Ok(());
        }
        self.fixed(path::COST_BARS, &BarChart::new(bars).with_color(colour::AFTER))
    }
}

fn log10(value: f64) -> f64 {
    value.max(1e-300).log10()
}
