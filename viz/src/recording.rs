//! A scene as a Rerun recording.
//!
//! It comes in three parts, so that a session can be live: what is known at the start, the iterations, and
//! the end. Timelines: `frame` (number of the frame), `time` (video time) and `iteration`. What does not
//! change is logged once without a time. Positions are relative to [`Scene::local_origin_m`].

mod bodies;
mod image;
mod iterations;
mod map;
mod plots;
#[cfg(test)]
mod tests;
mod text;
mod world;

use crate::colour::{self, Colour};
use crate::error::RecordingError;
use crate::path;
use crate::scene::{Pose, Scene, TrackPrecision};
use crate::sdk::components::FillMode;
use crate::sdk::{
    AsComponents, Ellipsoids3D, LineStrips3D, Quaternion, RecordingStream, RecordingStreamBuilder,
    RecordingStreamError, Scalars, SerializationError, SeriesLines, TimeColumn, Transform3D,
};
use crate::{Layout, blueprint};
use std::hash::{DefaultHasher, Hash, Hasher};

/// Half the width of lines on the screen.
const BEFORE_WIDTH: f32 = 0.6;
const AFTER_WIDTH: f32 = 1.5;
/// A place in three dimensions is within so many standard deviations in 95 % of cases.
const NORMAL_95: f64 = 2.795_483;

type Recorded = Result<(), RecordingError>;

impl From<RecordingStreamError> for RecordingError {
    fn from(error: RecordingStreamError) -> Self {
        RecordingError::Encoding(error.to_string())
    }
}

impl From<SerializationError> for RecordingError {
    fn from(error: SerializationError) -> Self {
        RecordingError::Encoding(error.to_string())
    }
}

/// The stream of these scenes before it has a place to go to. Two recordings are one and the same for the viewer
/// only where all that is told of them is.
pub fn builder(scenes: &[Scene]) -> RecordingStreamBuilder {
    let mut hasher = DefaultHasher::new();
    for scene in scenes {
        (&scene.name, &scene.root, &scene.summary).hash(&mut hasher);
    }
    let name = name(scenes);
    RecordingStreamBuilder::new(path::APPLICATION)
        .recording_id(format!("{name}-{:016x}", hasher.finish()))
        .recording_name(name)
        // A time of its own would make equal scenes unequal files.
        .send_properties(false)
        .enabled(true)
}

fn name(scenes: &[Scene]) -> String {
    let first = scenes.first().map_or("", |scene| scene.name.as_str());
    let roots: Vec<&str> = scenes.iter().filter_map(|scene| scene.root.as_deref()).collect();
    if roots.is_empty() { first.to_owned() } else { format!("{first}: {}", roots.join(", ")) }
}

/// Sends the layout.
pub fn begin(stream: &RecordingStream, scenes: &[Scene], layout: Layout) -> Recorded {
    stream.set_log_time_enabled(false);
    stream.set_log_tick_enabled(false);
    stream.send_recording_name(name(scenes))?;
    blueprint::send(scenes, layout, stream)
}

/// Sends whole scenes.
pub fn record(stream: &RecordingStream, scenes: &[Scene], layout: Layout) -> Recorded {
    begin(stream, scenes, layout)?;
    for (at, scene) in scenes.iter().enumerate() {
        let recorder =
            Recorder { after: colour::SCENES[at % colour::SCENES.len()], ..Recorder::new(stream, scene) };
        recorder.start()?;
        for (number, iteration) in scene.iterations.iter().enumerate() {
            recorder.iteration(number, iteration)?;
        }
        recorder.end()?;
    }
    Ok(())
}

/// Writes one scene to a stream.
pub struct Recorder<'a> {
    stream: &'a RecordingStream,
    scene: &'a Scene,
    origin_m: [f64; 3],
    /// Colour of curves after the adjustment.
    after: Colour,
}

impl<'a> Recorder<'a> {
    /// A recorder of `scene`.
    pub fn new(stream: &'a RecordingStream, scene: &'a Scene) -> Self {
        Recorder { stream, scene, origin_m: scene.local_origin_m(), after: colour::AFTER }
    }

    /// What is known before the adjustment.
    pub fn start(&self) -> Recorded {
        for root in [path::WORLD, path::SHAPES] {
            self.fixed(root, &crate::sdk::ViewCoordinates::RIGHT_HAND_Z_UP())?;
        }
        self.ground()?;
        self.targets()?;
        self.camera_start()?;
        self.film()?;
        for body in &self.scene.bodies {
            self.body_before(body)?;
        }
        self.observed()?;
        self.legends()
    }

    /// What is known after it.
    pub fn end(&self) -> Recorded {
        self.camera_end()?;
        for body in &self.scene.bodies {
            self.body_after(body)?;
            self.compared(body)?;
            self.open_directions(body)?;
        }
        self.image_points()?;
        self.residuals()?;
        self.cost_bars()?;
        self.map()?;
        self.log()?;
        self.summary()
    }

    /// A path of this scene.
    fn at(&self, path: &str) -> String {
        path::below(self.scene.root.as_deref(), path)
    }

    /// A curve's name in the legend.
    fn told(&self, what: &str) -> String {
        match &self.scene.root {
            Some(root) => format!("{root}: {what}"),
            None => what.to_owned(),
        }
    }

    fn local(&self, position_m: [f64; 3]) -> [f32; 3] {
        std::array::from_fn(|axis| (position_m[axis] - self.origin_m[axis]) as f32)
    }

    fn fixed(&self, entity: &str, what: &impl AsComponents) -> Recorded {
        Ok(self.stream.log_static(self.at(entity), what)?)
    }

    /// Logs something that is there from a frame on.
    fn appear(&self, frame: usize, entity: &str, what: &impl AsComponents) -> Recorded {
        let frame = self.scene.frames[frame];
        self.stream.set_time_sequence("frame", frame.number);
        self.stream.set_duration_secs("time", frame.time_s);
        let logged = self.stream.log(self.at(entity), what);
        self.stream.reset_time();
        Ok(logged?)
    }

    /// Frame and time columns for rows at these frames.
    fn times(&self, frames: &[usize]) -> [TimeColumn; 2] {
        let frames: Vec<_> = frames.iter().map(|at| self.scene.frames[*at]).collect();
        [
            TimeColumn::new_sequence("frame", frames.iter().map(|f| f.number)),
            TimeColumn::new_duration_secs("time", frames.iter().map(|f| f.time_s)),
        ]
    }

    /// A line that carries its name.
    fn strip(
        &self,
        entity: &str,
        label: &str,
        points: impl Iterator<Item = [f64; 3]>,
        colour: Colour,
        width: f32,
    ) -> Recorded {
        let strip: Vec<[f32; 3]> = points.map(|p| self.local(p)).collect();
        if strip.is_empty() {
            return Ok(());
        }
        let strips = LineStrips3D::new([strip])
            .with_colors([colour])
            .with_radii([on_screen(width)])
            .with_labels([label])
            .with_show_labels(false);
        self.fixed(entity, &strips)
    }

    fn transform(&self, pose: &Pose) -> Transform3D {
        Transform3D::from_translation(self.local(pose.position_m)).with_quaternion(quaternion(pose))
    }

    fn poses(&self, entity: &str, frames: &[usize], poses: &[Pose]) -> Recorded {
        let columns = Transform3D::update_fields()
            .with_many_translation(poses.iter().map(|p| self.local(p.position_m)))
            .with_many_quaternion(poses.iter().map(quaternion))
            .columns_of_unit_batches()?;
        Ok(self.stream.send_columns(self.at(entity), self.times(frames), columns)?)
    }

    /// Ellipsoids in which a place is in 95 % of cases; where nothing determines it there is none.
    fn ellipsoids(
        &self,
        entity: &str,
        ellipsoids: impl Iterator<Item = Ellipsoid>,
        colour: Colour,
    ) -> Recorded {
        self.coloured_ellipsoids(entity, ellipsoids.map(|found| (found, colour)))
    }

    fn coloured_ellipsoids(
        &self,
        entity: &str,
        ellipsoids: impl Iterator<Item = (Ellipsoid, Colour)>,
    ) -> Recorded {
        let is_known =
            |(e, _): &(Ellipsoid, Colour)| e.sigma_m.iter().all(|s| s.is_finite()) && e.sigma_m != [0.0; 3];
        let (known, colours): (Vec<Ellipsoid>, Vec<Colour>) = ellipsoids.filter(is_known).unzip();
        if known.is_empty() {
            return Ok(());
        }
        let half_sizes = known.iter().map(|e| e.sigma_m.map(|sigma| (NORMAL_95 * sigma) as f32));
        let turn = |e: &Ellipsoid| {
            let (sin, cos) = (0.5 * e.turn_rad).sin_cos();
            Quaternion::from_xyzw([0.0, 0.0, sin as f32, cos as f32])
        };
        let drawn = Ellipsoids3D::from_centers_and_half_sizes(known.iter().map(|e| e.centre), half_sizes)
            .with_quaternions(known.iter().map(turn))
            .with_colors(colours)
            .with_fill_mode(FillMode::MajorWireframe)
            .with_line_radii([on_screen(0.3)]);
        self.fixed(entity, &drawn)
    }

    /// A curve over frames; nothing where there is none.
    fn curve(&self, entity: &str, style: &Curve, values: impl Iterator<Item = (usize, f64)>) -> Recorded {
        let (frames, values): (Vec<usize>, Vec<f64>) = values.filter(|(_, v)| v.is_finite()).unzip();
        if frames.is_empty() {
            return Ok(());
        }
        self.fixed(entity, &self.style(style))?;
        let columns = Scalars::update_fields().with_scalars(values).columns_of_unit_batches()?;
        Ok(self.stream.send_columns(self.at(entity), self.times(&frames), columns)?)
    }

    fn style(&self, style: &Curve) -> SeriesLines {
        SeriesLines::new()
            .with_colors([style.colour])
            .with_names([self.told(&style.legend)])
            .with_widths([style.width])
    }
}

/// How a curve looks.
struct Curve {
    legend: String,
    colour: Colour,
    width: f32,
}

impl Curve {
    fn new(legend: impl Into<String>, colour: Colour, width: f32) -> Self {
        Curve { legend: legend.into(), colour, width }
    }
}

fn quaternion(pose: &Pose) -> Quaternion {
    let [w, x, y, z] = pose.quaternion_wxyz.map(|v| v as f32);
    Quaternion::from_xyzw([x, y, z, w])
}

/// A radius in points of the screen, which the viewer knows by its sign.
fn on_screen(points: f32) -> f32 {
    -points
}

/// Standard deviations along axes that are turned about z.
struct Ellipsoid {
    centre: [f32; 3],
    sigma_m: [f64; 3],
    turn_rad: f64,
}

impl Ellipsoid {
    /// The principal axes in the plane, and z by itself.
    fn of_track(centre: [f32; 3], precision: &TrackPrecision) -> Self {
        let [x, y, z] = precision.sigma_m;
        let (xx, yy, xy) = (x * x, y * y, precision.covariance_xy_m2);
        let (mean, half) = ((xx + yy) / 2.0, ((xx - yy) / 2.0).hypot(xy));
        let turn_rad = 0.5 * (2.0 * xy).atan2(xx - yy);
        Ellipsoid { centre, sigma_m: [(mean + half).sqrt(), (mean - half).max(0.0).sqrt(), z], turn_rad }
    }
}
