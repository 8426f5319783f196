//! A scene as a Rerun recording.
//!
//! Timelines: `frame` (number of the frame), `time` (video time) and `iteration`. What does not
//! change is logged once without a time. Positions are relative to [`Scene::local_origin_m`].

use crate::blueprint;
use crate::colour::{self, Colour};
use crate::path;
use crate::scene::{
    Body, Ground, ImagePoint, ImagePointKind, Marking, Pose, Scene, State, TargetRole, TrackPoint,
    TrackPrecision,
};
use rerun::{
    Arrows2D, Clear, Ellipsoids3D, LineStrips3D, Pinhole, Points2D, Points3D, Quaternion, RecordingStream,
    RecordingStreamBuilder, RecordingStreamError, Scalars, SerializationError, SeriesLines, TextDocument,
    TimeColumn, Transform3D,
};
use std::path::Path;

/// Half the width of lines on the screen.
const BEFORE_WIDTH: f32 = 0.6;
const AFTER_WIDTH: f32 = 1.5;

/// A radius in points of the screen, which the viewer knows by its sign.
fn on_screen(points: f32) -> f32 {
    -points
}

/// The recording could not be written.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The file or the stream failed.
    #[error("the recording could not be written: {0}")]
    Stream(#[from] RecordingStreamError),
    /// Something does not fit the viewer's types.
    #[error("the recording could not be encoded: {0}")]
    Encoding(#[from] SerializationError),
    /// What was recorded could not be brought to the disk.
    #[error("the recording could not be finished: {0}")]
    Flush(String),
}

/// Writes the recording of `scene` to `file`.
pub fn save(scene: &Scene, file: &Path) -> Result<(), RecordingError> {
    let stream = RecordingStreamBuilder::new("trackbundle")
        .recording_id(scene.name.as_str())
        .enabled(true)
        .save(file)?;
    record(scene, &stream)?;
    stream.flush_blocking().map_err(|error| RecordingError::Flush(error.to_string()))
}

/// Sends layout and scene to a stream.
fn record(scene: &Scene, stream: &RecordingStream) -> Recorded {
    stream.set_log_time_enabled(false);
    stream.set_log_tick_enabled(false);
    stream.send_recording_name(scene.name.as_str())?;
    blueprint::layout(scene.bodies.iter().map(|body| body.id.as_str())).send(stream, Default::default())?;
    Recorder { stream, scene, origin_m: scene.local_origin_m() }.record()
}

/// A place in three dimensions is within so many standard deviations in 95 % of cases.
const NORMAL_95: f64 = 2.795_483;
/// Between ellipsoids of a track \[s\].
const ELLIPSOID_STEP_S: f64 = 1.0;
/// Arrows of residuals are so many times as long.
const RESIDUAL_FACTOR: f64 = 20.0;

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

struct Recorder<'a> {
    stream: &'a RecordingStream,
    scene: &'a Scene,
    origin_m: [f64; 3],
}

type Recorded = Result<(), RecordingError>;

impl Recorder<'_> {
    fn record(&self) -> Recorded {
        self.stream.log_static(path::WORLD, &rerun::ViewCoordinates::RIGHT_HAND_Z_UP())?;
        self.ground()?;
        self.targets()?;
        self.camera()?;
        for body in &self.scene.bodies {
            self.body(body)?;
        }
        self.image_points()?;
        self.residuals()?;
        self.iterations()?;
        self.summary()
    }

    fn local(&self, position_m: [f64; 3]) -> [f32; 3] {
        std::array::from_fn(|axis| (position_m[axis] - self.origin_m[axis]) as f32)
    }

    /// Frame and time columns for rows at these frames.
    fn times(&self, frames: &[usize]) -> [TimeColumn; 2] {
        let frames: Vec<_> = frames.iter().map(|at| self.scene.frames[*at]).collect();
        [
            TimeColumn::new_sequence("frame", frames.iter().map(|f| f.number)),
            TimeColumn::new_duration_secs("time", frames.iter().map(|f| f.time_s)),
        ]
    }

    fn strip(
        &self,
        entity: &str,
        points: impl Iterator<Item = [f64; 3]>,
        colour: Colour,
        width: f32,
    ) -> Recorded {
        let strip: Vec<[f32; 3]> = points.map(|p| self.local(p)).collect();
        let strips = LineStrips3D::new([strip]).with_colors([colour]).with_radii([on_screen(width)]);
        Ok(self.stream.log_static(entity, &strips)?)
    }

    /// The lines of the lattice, as far as there is ground.
    fn ground(&self) -> Recorded {
        let Ground { lines_m: [x, y], heights_m } = &self.scene.ground;
        let place = |i: usize, j: usize| {
            let height = heights_m.get(j * x.len() + i).copied().flatten();
            height.map(|z| self.local([x[i], y[j], z]))
        };
        let along_x = (0..y.len()).map(|j| (0..x.len()).map(|i| place(i, j)).collect());
        let along_y = (0..x.len()).map(|i| (0..y.len()).map(|j| place(i, j)).collect());
        let lines: Vec<Vec<Option<[f32; 3]>>> = along_x.chain(along_y).collect();
        let strips: Vec<Vec<[f32; 3]>> = lines
            .iter()
            .flat_map(|line| line.split(Option::is_none))
            .filter(|part| part.len() > 1)
            .map(|part| part.iter().flatten().copied().collect())
            .collect();
        if strips.is_empty() {
            return Ok(());
        }
        let grid = LineStrips3D::new(strips).with_colors([colour::GROUND]).with_radii([on_screen(0.4)]);
        Ok(self.stream.log_static("world/ground", &grid)?)
    }

    fn targets(&self) -> Recorded {
        for (role, name, colour) in [
            (TargetRole::Control, "control", colour::CONTROL),
            (TargetRole::Check, "check", colour::CHECK),
            (TargetRole::Tie, "tie", colour::TIE),
        ] {
            let of_role: Vec<_> = self.scene.targets.iter().filter(|t| t.role == role).collect();
            if of_role.is_empty() {
                continue;
            }
            let points = Points3D::new(of_role.iter().map(|t| self.local(t.position_m)))
                .with_colors([colour])
                .with_radii([on_screen(3.0)])
                .with_labels(of_role.iter().map(|t| t.id.as_str()))
                .with_show_labels(false);
            self.stream.log_static(format!("world/targets/{name}"), &points)?;
            let known = of_role.iter().filter_map(|t| {
                Some(Ellipsoid { centre: self.local(t.position_m), sigma_m: t.sigma_m?, turn_rad: 0.0 })
            });
            self.ellipsoids(&format!("world/targets/{name}/survey"), known, colour)?;
        }
        Ok(())
    }

    /// Ellipsoids in which a place is in 95 % of cases; where nothing determines it there is none.
    fn ellipsoids(
        &self,
        entity: &str,
        ellipsoids: impl Iterator<Item = Ellipsoid>,
        colour: Colour,
    ) -> Recorded {
        let is_known = |e: &Ellipsoid| e.sigma_m.iter().all(|s| s.is_finite()) && e.sigma_m != [0.0; 3];
        let known: Vec<Ellipsoid> = ellipsoids.filter(is_known).collect();
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
            .with_colors([colour])
            .with_line_radii([on_screen(0.5)]);
        Ok(self.stream.log_static(entity, &drawn)?)
    }

    /// Ellipsoids of a track, about one a second.
    fn track_ellipsoids(&self, id: &str, track: &[TrackPoint]) -> Recorded {
        let mut next_s = f64::NEG_INFINITY;
        let picked = track.iter().filter(|place| {
            let time_s = self.scene.frames[place.frame].time_s;
            let is_due = time_s >= next_s;
            if is_due {
                next_s = time_s + ELLIPSOID_STEP_S;
            }
            is_due
        });
        let ellipsoids = picked
            .filter_map(|place| Some(Ellipsoid::of_track(self.local(place.position_m), &place.precision?)));
        self.ellipsoids(&format!("world/paths/{id}/precision"), ellipsoids, colour::ELLIPSOID)
    }

    fn camera(&self) -> Recorded {
        let camera = &self.scene.camera;
        let [focal, principal] = [camera.focal_px, camera.principal_px].map(|v| v.map(|v| v as f32));
        let height = camera.after.first().map_or(10.0, |pose| pose.position_m[2].abs()) as f32;
        let pinhole = Pinhole::from_focal_length_and_resolution(focal, camera.size_px.map(|v| v as f32))
            .with_principal_point(principal)
            .with_image_plane_distance((0.1 * height).clamp(0.5, 10.0));
        self.stream.log_static(path::IMAGE, &pinhole)?;
        let frames: Vec<usize> = (0..camera.after.len()).collect();
        self.poses(path::CAMERA, &frames, &camera.after)?;
        let positions = |poses: &[Pose]| poses.iter().map(|p| p.position_m).collect::<Vec<_>>().into_iter();
        self.strip("world/paths/camera/before", positions(&camera.before), colour::BEFORE, BEFORE_WIDTH)?;
        self.strip("world/paths/camera/after", positions(&camera.after), colour::AFTER, AFTER_WIDTH)
    }

    fn poses(&self, entity: &str, frames: &[usize], poses: &[Pose]) -> Recorded {
        let quaternion = |pose: &Pose| {
            let [w, x, y, z] = pose.quaternion_wxyz.map(|v| v as f32);
            Quaternion::from_xyzw([x, y, z, w])
        };
        let columns = Transform3D::update_fields()
            .with_many_translation(poses.iter().map(|p| self.local(p.position_m)))
            .with_many_quaternion(poses.iter().map(quaternion))
            .columns_of_unit_batches()?;
        Ok(self.stream.send_columns(entity, self.times(frames), columns)?)
    }

    fn body(&self, body: &Body) -> Recorded {
        for (state, name, colour, radius_m, width) in [
            (&body.before, "before", colour::BEFORE, 0.02, BEFORE_WIDTH),
            (&body.after, "after", colour::AFTER, 0.035, AFTER_WIDTH),
        ] {
            let entity = format!("world/bodies/{}/{name}", body.id);
            let (frames, poses): (Vec<usize>, Vec<Pose>) = state.poses.iter().copied().unzip();
            let (Some(first), Some(last)) = (frames.first(), frames.last()) else { continue };
            self.poses(&entity, &frames, &poses)?;
            // The points appear and go with the body; a static point would stay.
            let points: Vec<[f32; 3]> = state.points_m.iter().map(|p| p.map(|v| v as f32)).collect();
            let count = points.len();
            let own_frame = format!("{}/{}", path::SHAPES, body.id);
            self.stream.log_static(own_frame.as_str(), &rerun::ViewCoordinates::RIGHT_HAND_Z_UP())?;
            let colours: Vec<Colour> = match state.sigmas_m.len() {
                known if known == count && known > 0 => {
                    state.sigmas_m.iter().map(|s| s.map_or(colour, colour::of_sigma)).collect()
                }
                _ => vec![colour],
            };
            let shape =
                Points3D::new(points.clone()).with_colors(colours.clone()).with_radii([0.6 * radius_m]);
            self.stream.log_static(format!("{own_frame}/{name}"), &shape)?;
            let style = Points3D::update_fields().with_colors(colours).with_radii([radius_m]);
            self.stream.log_static(format!("{entity}/shape"), &style)?;
            let columns = Points3D::update_fields().with_positions(points).columns([count])?;
            self.stream.send_columns(format!("{entity}/shape"), self.times(&[*first]), columns)?;
            if last + 1 < self.scene.frames.len() {
                let columns =
                    Clear::update_fields().with_many_is_recursive([true]).columns_of_unit_batches()?;
                self.stream.send_columns(entity.as_str(), self.times(&[last + 1]), columns)?;
            }
            let track = state.track.iter().map(|t| t.position_m);
            self.strip(&format!("world/paths/{}/{name}", body.id), track, colour, width)?;
            self.speed(&body.id, name, state, colour)?;
            let places = state.track.iter().map(|t| (t.frame, t.heading_deg));
            let (frames, headings): (Vec<usize>, Vec<f64>) = places.unzip();
            let heading = format!("{}/{}", path::HEADING, body.id);
            self.curve(
                &format!("{heading}/{name}"),
                &format!("{} {name}", body.id),
                colour,
                &frames,
                headings,
            )?;
        }
        self.precision(&body.id, &body.after)
    }

    /// What is known of the adjusted state: ellipsoids of shape and track, bands of the curves.
    fn precision(&self, id: &str, state: &State) -> Recorded {
        let ellipsoids = state.points_m.iter().zip(&state.sigmas_m).filter_map(|(centre, sigma)| {
            Some(Ellipsoid { centre: centre.map(|v| v as f32), sigma_m: (*sigma)?, turn_rad: 0.0 })
        });
        self.ellipsoids(&format!("{}/{id}/precision", path::SHAPES), ellipsoids, colour::ELLIPSOID)?;
        self.track_ellipsoids(id, &state.track)?;
        self.bands(id, state)
    }

    /// Standard deviations of a track over time, and two of them to either side of speed and heading.
    fn bands(&self, id: &str, state: &State) -> Recorded {
        let known = |of: &dyn Fn(&TrackPoint, &TrackPrecision) -> Option<f64>| -> (Vec<usize>, Vec<f64>) {
            let value = |t: &TrackPoint| Some((t.frame, of(t, t.precision.as_ref()?)?));
            state.track.iter().filter_map(value).filter(|(_, value)| value.is_finite()).unzip()
        };
        for (axis, letter) in ["x", "y", "z"].into_iter().enumerate() {
            let (frames, sigmas) = known(&|_, precision| Some(precision.sigma_m[axis]));
            if !frames.is_empty() {
                let entity = format!("{}/{id}/{letter}", path::SIGMA);
                self.curve(&entity, &format!("{id} {letter}"), colour::AXES[axis], &frames, sigmas)?;
            }
        }
        for (end, sign) in [("upper", 2.0), ("lower", -2.0)] {
            let speeds = known(&|t, precision| Some(t.speed_mps? + sign * precision.sigma_speed_mps?));
            let headings = known(&|t, precision| Some(t.heading_deg + sign * precision.sigma_heading_deg));
            for (root, (frames, values)) in [(path::SPEED, speeds), (path::HEADING, headings)] {
                if !frames.is_empty() {
                    let entity = format!("{root}/{id}/after_{end}");
                    let legend = format!("{id} {end} 2 sigma");
                    self.curve(&entity, &legend, colour::BAND, &frames, values)?;
                }
            }
        }
        Ok(())
    }

    fn speed(&self, id: &str, name: &str, state: &State, colour: Colour) -> Recorded {
        let known = state.track.iter().filter_map(|t| Some((t.frame, t.speed_mps?)));
        let (frames, speeds): (Vec<usize>, Vec<f64>) = known.unzip();
        let legend = format!("{id} {name}");
        self.curve(&format!("{}/{id}/{name}", path::SPEED), &legend, colour, &frames, speeds)
    }

    fn curve(
        &self,
        entity: &str,
        legend: &str,
        colour: Colour,
        frames: &[usize],
        values: Vec<f64>,
    ) -> Recorded {
        let width = match colour {
            colour::BAND => 0.75,
            // The viewer draws it last.
            colour::BEFORE => 1.0,
            _ => 2.0,
        };
        let style = SeriesLines::new().with_colors([colour]).with_names([legend]).with_widths([width]);
        self.stream.log_static(entity, &style)?;
        let columns = Scalars::update_fields().with_scalars(values).columns_of_unit_batches()?;
        Ok(self.stream.send_columns(entity, self.times(frames), columns)?)
    }

    fn image_points(&self) -> Recorded {
        let is_good = |p: &&ImagePoint| p.marking == Marking::Good;
        let is_rejected = |p: &&ImagePoint| p.marking == Marking::Rejected;
        self.image_layer("observed", colour::OBSERVED, 2.0, |points| {
            points.iter().filter(is_good).map(|p| p.observed_px).collect()
        })?;
        self.image_layer("computed", colour::AFTER, 1.25, |points| {
            points.iter().filter_map(|p| p.computed_px).collect()
        })?;
        self.image_layer("rejected", colour::REJECTED, 2.5, |points| {
            points.iter().filter(is_rejected).map(|p| p.observed_px).collect()
        })?;
        self.residual_arrows()
    }

    /// From the computed to the observed place of each image point that takes part, enlarged.
    fn residual_arrows(&self) -> Recorded {
        let entity = format!("{}/residuals", path::IMAGE);
        let arrow = |p: &ImagePoint| {
            let computed = p.computed_px.filter(|_| p.marking == Marking::Good)?;
            let along = |axis: usize| (RESIDUAL_FACTOR * (p.observed_px[axis] - computed[axis])) as f32;
            Some((computed.map(|v| v as f32), [along(0), along(1)]))
        };
        let per_frame: Vec<Vec<_>> =
            self.scene.image_points.iter().map(|points| points.iter().filter_map(arrow).collect()).collect();
        if per_frame.iter().all(Vec::is_empty) {
            return Ok(());
        }
        let frames: Vec<usize> = (0..per_frame.len()).collect();
        let style = Arrows2D::update_fields().with_colors([colour::RESIDUAL]).with_radii([on_screen(0.75)]);
        self.stream.log_static(entity.as_str(), &style)?;
        let all = || per_frame.iter().flatten();
        let columns = Arrows2D::update_fields()
            .with_origins(all().map(|(origin, _)| *origin))
            .with_vectors(all().map(|(_, vector)| *vector))
            .columns(per_frame.iter().map(Vec::len).collect::<Vec<_>>())?;
        Ok(self.stream.send_columns(entity.as_str(), self.times(&frames), columns)?)
    }

    fn image_layer(
        &self,
        name: &str,
        colour: Colour,
        radius: f32,
        pick: impl Fn(&[ImagePoint]) -> Vec<[f64; 2]>,
    ) -> Recorded {
        let entity = format!("{}/{name}", path::IMAGE);
        let frames: Vec<usize> = (0..self.scene.image_points.len()).collect();
        let per_frame: Vec<Vec<[f64; 2]>> =
            self.scene.image_points.iter().map(|points| pick(points)).collect();
        if per_frame.iter().all(Vec::is_empty) {
            return Ok(());
        }
        let style = Points2D::update_fields().with_colors([colour]).with_radii([on_screen(radius)]);
        self.stream.log_static(entity.as_str(), &style)?;
        let positions = per_frame.iter().flatten().map(|p| p.map(|v| v as f32));
        let columns = Points2D::update_fields()
            .with_positions(positions)
            .columns(per_frame.iter().map(Vec::len).collect::<Vec<_>>())?;
        Ok(self.stream.send_columns(entity.as_str(), self.times(&frames), columns)?)
    }

    /// Root mean square per frame, of the coordinates of image points that take part.
    fn residuals(&self) -> Recorded {
        for (kind, name, colour) in [
            (ImagePointKind::Body, "vehicle points", colour::AFTER),
            (ImagePointKind::Target, "targets", colour::CONTROL),
        ] {
            let rms = |points: &Vec<ImagePoint>| {
                let squares: Vec<f64> = points
                    .iter()
                    .filter(|p| p.kind == kind && p.marking == Marking::Good)
                    .filter_map(|p| {
                        let [u, v] = p.computed_px?;
                        Some((p.observed_px[0] - u).powi(2) + (p.observed_px[1] - v).powi(2))
                    })
                    .collect();
                (!squares.is_empty())
                    .then(|| (squares.iter().sum::<f64>() / (2 * squares.len()) as f64).sqrt())
            };
            let per_frame = self.scene.image_points.iter().map(rms).enumerate();
            let (frames, values): (Vec<usize>, Vec<f64>) =
                per_frame.filter_map(|(at, v)| Some((at, v?))).unzip();
            if !frames.is_empty() {
                let entity = format!("{}/{}", path::RESIDUALS, name.replace(' ', "_"));
                self.curve(&entity, name, colour, &frames, values)?;
            }
        }
        Ok(())
    }

    fn iterations(&self) -> Recorded {
        let iterations = &self.scene.iterations;
        if iterations.is_empty() {
            return Ok(());
        }
        let log10 = |value: f64| value.max(1e-300).log10();
        let bars: Vec<f64> = iterations.iter().map(|i| log10(i.cost)).collect();
        self.stream.log_static(path::COST_BARS, &rerun::BarChart::new(bars).with_color(colour::AFTER))?;
        let numbers = || [TimeColumn::new_sequence("iteration", 0..iterations.len() as i64)];
        for (name, colour, values) in [
            ("log10 cost", colour::AFTER, iterations.iter().map(|i| log10(i.cost)).collect::<Vec<f64>>()),
            ("log10 damping", colour::BEFORE, iterations.iter().map(|i| log10(i.damping)).collect()),
            ("log10 step", colour::CONTROL, iterations.iter().skip(1).map(|i| log10(i.step)).collect()),
        ] {
            let entity = format!("{}/{}", path::ITERATIONS, name.trim_start_matches("log10 "));
            let style = SeriesLines::new().with_colors([colour]).with_names([name]).with_widths([2.0]);
            self.stream.log_static(entity.as_str(), &style)?;
            let skipped = iterations.len() - values.len();
            let columns = Scalars::update_fields().with_scalars(values).columns_of_unit_batches()?;
            let times = match skipped {
                0 => numbers(),
                _ => [TimeColumn::new_sequence("iteration", skipped as i64..iterations.len() as i64)],
            };
            self.stream.send_columns(entity.as_str(), times, columns)?;
        }
        Ok(())
    }

    fn summary(&self) -> Recorded {
        let [x, y, z] = self.origin_m;
        let text = format!(
            "{}\n\nOrange, thin: before the adjustment. Blue, thick: after it. Green: control targets. \
             In the camera's view yellow is observed, blue computed, red rejected.\n\n\
             Zero of this recording in the world: ({x}, {y}, {z}) m.\n",
            self.scene.summary
        );
        let document = TextDocument::new(text).with_media_type(rerun::MediaType::MARKDOWN);
        Ok(self.stream.log_static(path::SUMMARY, &document)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Camera, Frame, Iteration, Target, TrackPoint};
    use rerun::log::{Chunk, LogMsg};
    use std::collections::{BTreeMap, BTreeSet};

    /// Two frames, a body in the first one, a target, one good and one rejected image point.
    fn scene() -> Scene {
        let pose = |x: f64| Pose {
            position_m: [700_000.0 + x, 5_000_000.0, 60.0],
            quaternion_wxyz: [0.0, 1.0, 0.0, 0.0],
        };
        let state = || State {
            points_m: vec![[1.0, 0.0, 1.5], [-1.0, 0.0, 1.5]],
            sigmas_m: vec![Some([0.01, 0.03, 0.015]), Some([0.01, f64::INFINITY, 0.01])],
            poses: vec![(0, pose(1.0))],
            track: vec![TrackPoint {
                frame: 0,
                position_m: pose(1.0).position_m,
                speed_mps: Some(3.0),
                heading_deg: 30.0,
                precision: Some(TrackPrecision {
                    sigma_m: [0.1, 0.1, 0.3],
                    covariance_xy_m2: 0.006,
                    sigma_speed_mps: Some(0.25),
                    sigma_heading_deg: 0.5,
                }),
            }],
        };
        let image_point = |marking| ImagePoint {
            kind: ImagePointKind::Body,
            observed_px: [10.0, 20.0],
            computed_px: Some([13.0, 16.0]),
            marking,
        };
        Scene {
            name: "test".to_owned(),
            frames: vec![Frame { number: 7, time_s: 0.5 }, Frame { number: 8, time_s: 0.75 }],
            camera: Camera {
                size_px: [640, 480],
                focal_px: [500.0, 500.0],
                principal_px: [320.0, 240.0],
                before: vec![pose(0.5), pose(0.5)],
                after: vec![pose(0.0), pose(0.001)],
            },
            bodies: vec![Body { id: "car".to_owned(), before: state(), after: state() }],
            targets: vec![Target {
                id: "T1".to_owned(),
                role: TargetRole::Control,
                position_m: pose(3.0).position_m,
                sigma_m: Some([0.01, 0.02, 0.03]),
            }],
            image_points: vec![vec![image_point(Marking::Good), image_point(Marking::Rejected)], vec![]],
            ground: Ground {
                lines_m: [vec![7e5, 700_005.0, 700_010.0], vec![5e6, 5_000_005.0]],
                heights_m: vec![Some(0.0), Some(0.5), None, Some(0.25), Some(1.0), Some(2.0)],
            },
            iterations: vec![
                Iteration { cost: 100.0, damping: 1e-9, step: 0.0 },
                Iteration { cost: 1.0, damping: 1e-9, step: 10.0 },
            ],
            summary: "# test".to_owned(),
        }
    }

    /// The chunks of a recorded scene, by entity.
    fn recorded() -> BTreeMap<String, Vec<Chunk>> {
        let (stream, storage) = RecordingStreamBuilder::new("test").enabled(true).memory().unwrap();
        record(&scene(), &stream).unwrap();
        stream.flush_blocking().unwrap();
        let mut chunks: BTreeMap<String, Vec<Chunk>> = BTreeMap::new();
        for message in storage.take() {
            if let LogMsg::ArrowMsg(store, message) = message
                && store.is_recording()
            {
                let chunk = Chunk::from_arrow_msg(&message).unwrap();
                chunks.entry(chunk.entity_path().to_string()).or_default().push(chunk);
            }
        }
        chunks
    }

    /// The numbers of a component whose name ends like this, all rows one after the other.
    fn numbers(chunks: &[Chunk], component: &str) -> Vec<f64> {
        let columns = chunks.iter().flat_map(|chunk| chunk.components().values());
        let named = columns.filter(|column| column.descriptor.component.as_str().ends_with(component));
        named
            .flat_map(|column| {
                let mut values = column.list_array.values().clone();
                // Vectors are lists of a fixed size, lines lists of any.
                loop {
                    let fixed =
                        values.as_any().downcast_ref::<rerun::external::arrow::array::FixedSizeListArray>();
                    let free = values.as_any().downcast_ref::<rerun::external::arrow::array::ListArray>();
                    values = match (fixed, free) {
                        (Some(list), _) => list.values().clone(),
                        (_, Some(list)) => list.values().clone(),
                        _ => break,
                    };
                }
                let single = values.as_any().downcast_ref::<rerun::external::arrow::array::Float32Array>();
                let double = values.as_any().downcast_ref::<rerun::external::arrow::array::Float64Array>();
                match (single, double) {
                    (Some(values), _) => values.values().iter().map(|v| f64::from(*v)).collect::<Vec<_>>(),
                    (_, Some(values)) => values.values().to_vec(),
                    _ => panic!("{component} holds no numbers"),
                }
            })
            .collect()
    }

    #[test]
    fn everything_has_its_place() {
        let recorded = recorded();
        let found: BTreeSet<&str> = recorded.keys().map(String::as_str).collect();
        for wanted in [
            "/world",
            "/world/ground",
            "/world/targets/control",
            "/world/camera",
            "/world/camera/image",
            "/world/camera/image/observed",
            "/world/camera/image/computed",
            "/world/camera/image/rejected",
            "/world/paths/camera/before",
            "/world/paths/camera/after",
            "/world/paths/car/before",
            "/world/paths/car/after",
            "/world/bodies/car/before",
            "/world/bodies/car/after",
            "/world/bodies/car/after/shape",
            "/shapes/car/before",
            "/shapes/car/after",
            "/plots/speed/car/after",
            "/plots/residuals/vehicle_points",
            "/plots/iterations/cost",
            "/plots/cost",
            "/summary",
        ] {
            assert!(found.contains(wanted), "{wanted} is not among {found:?}");
        }
    }

    #[test]
    fn three_timelines_and_no_other() {
        let mut timelines = BTreeSet::new();
        for chunk in recorded().values().flatten() {
            timelines.extend(chunk.timelines().keys().map(|name| name.as_str().to_owned()));
        }
        assert_eq!(timelines.into_iter().collect::<Vec<_>>(), ["frame", "iteration", "time"]);
    }

    #[test]
    fn large_coordinates_keep_their_millimetres() {
        let recorded = recorded();
        let positions = numbers(&recorded["/world/camera"], "translation");
        assert_eq!(positions.len(), 6);
        assert_eq!(positions[0], 0.0);
        assert!((positions[3] - 0.001).abs() < 1e-6, "{positions:?}");
        assert_eq!(numbers(&recorded["/world/targets/control"], "positions"), [3.0, 0.0, 60.0]);
    }

    #[test]
    fn image_points_are_sorted_by_their_marking() {
        let recorded = recorded();
        let at = |layer: &str| numbers(&recorded[&format!("/world/camera/image/{layer}")], "positions");
        assert_eq!(at("observed"), [10.0, 20.0]);
        assert_eq!(at("rejected"), [10.0, 20.0]);
        assert_eq!(at("computed"), [13.0, 16.0, 13.0, 16.0]);
        // Residual (-3, 4): the root mean square of its coordinates.
        let rms = numbers(&recorded["/plots/residuals/vehicle_points"], "scalars");
        assert!((rms[0] - 12.5_f64.sqrt()).abs() < 1e-12);
    }

    #[test]
    fn the_ground_has_its_heights_and_its_holes() {
        // Two lines along x, the first of them cut short; of the three along y one has a hole.
        let recorded = recorded();
        let strips = numbers(&recorded["/world/ground"], "strips");
        let heights: Vec<f64> = strips.chunks(3).map(|place| place[2]).collect();
        assert_eq!(heights, [0.0, 0.5, 0.25, 1.0, 2.0, 0.0, 0.25, 0.5, 1.0]);
        assert_eq!(strips[3..5], [5.0, 0.0]);
    }

    #[test]
    fn residuals_point_from_the_computed_to_the_observed_place() {
        let recorded = recorded();
        let arrows = &recorded["/world/camera/image/residuals"];
        assert_eq!(numbers(arrows, "origins"), [13.0, 16.0]);
        assert_eq!(numbers(arrows, "vectors"), [-60.0, 80.0]);
    }

    fn close(found: &[f64], wanted: &[f64]) -> bool {
        found.len() == wanted.len() && found.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-6)
    }

    #[test]
    fn ellipsoids_hold_95_per_cent_and_leave_out_what_is_not_determined() {
        let recorded = recorded();
        let sizes = |entity: &str| numbers(&recorded[entity], "half_sizes");
        let scaled = |sigmas: &[f64]| sigmas.iter().map(|sigma| 2.795_483 * sigma).collect::<Vec<f64>>();
        assert!(close(&sizes("/world/targets/control/survey"), &scaled(&[0.01, 0.02, 0.03])));
        assert!(close(&sizes("/shapes/car/precision"), &scaled(&[0.01, 0.03, 0.015])));
        // Correlation 0.6 of equal variances: axes at 45 degrees, variances 1.6 and 0.4 times as large.
        let axes = [0.1 * 1.6_f64.sqrt(), 0.1 * 0.4_f64.sqrt(), 0.3];
        assert!(close(&sizes("/world/paths/car/precision"), &scaled(&axes)));
        let (sin, cos) = std::f64::consts::FRAC_PI_8.sin_cos();
        assert!(close(
            &numbers(&recorded["/world/paths/car/precision"], "quaternions"),
            &[0.0, 0.0, sin, cos]
        ));
    }

    #[test]
    fn speed_and_heading_have_their_bands() {
        let recorded = recorded();
        let value = |entity: &str| numbers(&recorded[entity], "scalars");
        assert_eq!(value("/plots/speed/car/after_upper"), [3.5]);
        assert_eq!(value("/plots/speed/car/after_lower"), [2.5]);
        assert_eq!(value("/plots/heading/car/after"), [30.0]);
        assert_eq!(value("/plots/heading/car/after_lower"), [29.0]);
        assert_eq!(value("/plots/sigma/car/z"), [0.3]);
    }

    #[test]
    fn points_have_the_colour_of_their_worst_standard_deviation() {
        let colours =
            [[0.01, 0.002, 0.0], [0.011, 0.0, 0.0], [0.0, 0.05, 0.0], [0.0, 0.0, 0.2]].map(colour::of_sigma);
        assert_eq!(colours, [0xFDE7_25FF, 0x5EC9_62FF, 0x2191_8CFF, 0x8A5B_B5FF]);
        assert_eq!(colour::of_sigma([0.01, f64::INFINITY, 0.01]), 0x7777_77FF);
    }

    #[test]
    fn the_cost_is_there_for_each_iteration() {
        assert_eq!(numbers(&recorded()["/plots/iterations/cost"], "scalars"), [2.0, 0.0]);
        assert_eq!(numbers(&recorded()["/plots/iterations/step"], "scalars"), [1.0]);
    }

    #[test]
    fn a_recording_is_a_file() {
        let folder = std::env::temp_dir().join(format!("trackbundle-viz-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let file = folder.join("test.rrd");
        save(&scene(), &file).unwrap();
        let bytes = std::fs::read(&file).unwrap();
        std::fs::remove_dir_all(&folder).unwrap();
        assert!(bytes.starts_with(b"RRF"), "{:?}", &bytes[..4]);
        assert!(save(&scene(), Path::new("/nowhere/at/all/test.rrd")).is_err());
    }
}
