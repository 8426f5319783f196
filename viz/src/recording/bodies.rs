//! Bodies that move, their shapes and tracks, and what these are compared with.

use super::{AFTER_WIDTH, BEFORE_WIDTH, Curve, Ellipsoid, NORMAL_95, Recorded, Recorder, on_screen};
use crate::colour::{self, Colour};
use crate::path::{self, part};
use crate::scene::{Body, Pose, State, TrackPoint, TrackPrecision, each_second};
use crate::sdk::components::FillMode;
use crate::sdk::{Arrows3D, Boxes3D, Clear, LineStrips3D, Points3D};

/// Ellipsoids of shape points that are longer would hide all others; such points have the colour of poor ones \[m\].
const LONGEST_M: f64 = 1.0;

/// A body and a state of it.
struct Drawn<'a> {
    id: &'a str,
    name: &'a str,
    state: &'a State,
    colour: Colour,
    radius_m: f32,
    width: f32,
}

impl Recorder<'_> {
    pub(super) fn body_before(&self, body: &Body) -> Recorded {
        self.body(&Drawn {
            id: &body.id,
            name: "before",
            state: &body.before,
            colour: colour::BEFORE,
            radius_m: 0.02,
            width: BEFORE_WIDTH,
        })
    }

    pub(super) fn body_after(&self, body: &Body) -> Recorded {
        let drawn = Drawn {
            id: &body.id,
            name: "after",
            state: &body.after,
            colour: colour::AFTER,
            radius_m: 0.035,
            width: AFTER_WIDTH,
        };
        self.body(&drawn)?;
        self.velocity(&drawn)?;
        let id = part(&body.id);
        let ellipsoids =
            body.after.points_m.iter().zip(&body.after.sigmas_m).filter_map(|(centre, sigma)| {
                let sigma_m = sigma.filter(|sigma| sigma.iter().all(|s| NORMAL_95 * s <= LONGEST_M))?;
                let ellipsoid = Ellipsoid { centre: centre.map(|v| v as f32), sigma_m, turn_rad: 0.0 };
                Some((ellipsoid, colour::of_sigma(sigma_m)))
            });
        self.coloured_ellipsoids(&format!("{}/{id}/precision", path::SHAPES), ellipsoids)?;
        let due = each_second(&self.scene.frames, body.after.track.iter().map(|place| place.frame));
        let picked = body.after.track.iter().zip(due).filter(|(_, is_due)| *is_due);
        let of_track = picked.filter_map(|(place, _)| {
            Some(Ellipsoid::of_track(self.local(place.position_m), &place.precision?))
        });
        self.ellipsoids(&format!("{}/{id}/precision", path::PATHS), of_track, colour::ELLIPSOID)?;
        self.precision(body)
    }

    /// Points, box and heading, which appear and go with the body, and its track.
    fn body(&self, drawn: &Drawn) -> Recorded {
        let Drawn { id, name, state, colour, radius_m, width } = drawn;
        let entity = format!("{}/{}/{name}", path::BODIES, part(id));
        let (frames, poses): (Vec<usize>, Vec<Pose>) = state.poses.iter().copied().unzip();
        let (Some(first), Some(last)) = (frames.first(), frames.last()) else { return Ok(()) };
        self.poses(&entity, &frames, &poses)?;
        let points: Vec<[f32; 3]> = state.points_m.iter().map(|p| p.map(|v| v as f32)).collect();
        let colours: Vec<Colour> = match state.sigmas_m.len() {
            known if known == points.len() && known > 0 => {
                state.sigmas_m.iter().map(|s| s.map_or(*colour, colour::of_sigma)).collect()
            }
            _ => vec![*colour],
        };
        let shape =
            |radius_m: f32| Points3D::new(points.clone()).with_colors(colours.clone()).with_radii([radius_m]);
        self.fixed(&format!("{}/{}/{name}", path::SHAPES, part(id)), &shape(on_screen(width + 0.75)))?;
        self.appear(*first, &format!("{entity}/shape"), &shape(*radius_m))?;
        if let Some(Bounds { low, high }) = Bounds::of(&points) {
            let sizes: [f32; 3] = std::array::from_fn(|axis| high[axis] - low[axis]);
            // One name is enough: those of both would cover each other.
            let label = if *name == "after" { (*id).to_owned() } else { format!("{id} {name}") };
            let around = Boxes3D::from_mins_and_sizes([low], [sizes])
                .with_colors([*colour])
                .with_radii([on_screen(*width)])
                .with_fill_mode(FillMode::MajorWireframe)
                .with_labels([label.as_str()])
                .with_show_labels(*name == "after");
            self.appear(*first, &format!("{entity}/box"), &around)?;
            let middle = [(low[0] + high[0]) / 2.0, (low[1] + high[1]) / 2.0, high[2]];
            let ahead = Arrows3D::from_vectors([[0.75 * sizes[0].max(1.0), 0.0, 0.0]])
                .with_origins([middle])
                .with_colors([*colour])
                .with_radii([on_screen(*width)]);
            self.appear(*first, &format!("{entity}/heading"), &ahead)?;
        }
        if last + 1 < self.scene.frames.len() {
            self.appear(last + 1, &entity, &Clear::recursive())?;
        }
        let track = state.track.iter().map(|t| t.position_m);
        let strip = format!("{}/{}/{name}", path::PATHS, part(id));
        self.strip(&strip, &format!("{id} {name}"), track, *colour, *width)?;
        // The one that the viewer draws last must not hide the other.
        let (colour, width) = if *name == "before" { (*colour, 1.0) } else { (self.after, 2.0) };
        let curve = Curve::new(format!("{id} {name}"), colour, width);
        let speed = state.track.iter().filter_map(|t| Some((t.frame, t.speed_mps?)));
        self.curve(&format!("{}/{}/{name}", path::SPEED, part(id)), &curve, speed)?;
        let heading = state.track.iter().map(|t| (t.frame, t.heading_deg));
        self.curve(&format!("{}/{}/{name}", path::HEADING, part(id)), &curve, heading)
    }

    /// The way of one second, from the marker on.
    fn velocity(&self, drawn: &Drawn) -> Recorded {
        let track = &drawn.state.track;
        let arrow = |at: usize| {
            let [before, after] = [at.saturating_sub(1), (at + 1).min(track.len() - 1)];
            let [from, to] = [before, after].map(|at| track[at].position_m);
            let along: [f64; 3] = std::array::from_fn(|axis| to[axis] - from[axis]);
            let plan = along[0].hypot(along[1]);
            let speed = track[at].speed_mps.filter(|_| plan > 0.0)?;
            Some((at, along.map(|v| (v / plan * speed) as f32)))
        };
        let arrows: Vec<(usize, [f32; 3])> = (0..track.len()).filter_map(arrow).collect();
        if arrows.is_empty() {
            return Ok(());
        }
        let entity = self.at(&format!("world/velocity/{}", part(drawn.id)));
        let style = Arrows3D::update_fields().with_colors([drawn.colour]).with_radii([on_screen(2.0)]);
        self.stream.log_static(entity.as_str(), &style)?;
        let frames: Vec<usize> = arrows.iter().map(|(at, _)| track[*at].frame).collect();
        let columns = Arrows3D::update_fields()
            .with_origins(arrows.iter().map(|(at, _)| self.local(track[*at].position_m)))
            .with_vectors(arrows.iter().map(|(_, vector)| *vector))
            .columns_of_unit_batches()?;
        self.stream.send_columns(entity.as_str(), self.times(&frames), columns)?;
        let last = frames.iter().max().copied().unwrap_or_default();
        if last + 1 < self.scene.frames.len() {
            self.appear(last + 1, &format!("world/velocity/{}", part(drawn.id)), &Clear::flat())?;
        }
        Ok(())
    }

    /// Standard deviations of a track over time, and two of them to either side of speed and heading.
    fn precision(&self, body: &Body) -> Recorded {
        let Body { id, after, .. } = body;
        let known = |of: &dyn Fn(&TrackPoint, &TrackPrecision) -> Option<f64>| {
            let value = |t: &TrackPoint| Some((t.frame, of(t, t.precision.as_ref()?)?));
            after.track.iter().filter_map(value).collect::<Vec<_>>()
        };
        for (axis, letter) in ["x", "y", "z"].into_iter().enumerate() {
            let sigmas = known(&|_, precision| Some(precision.sigma_m[axis]));
            let curve = Curve::new(format!("{id} {letter}"), colour::AXES[axis], 2.0);
            self.curve(&format!("{}/{}/{letter}", path::SIGMA, part(id)), &curve, sigmas.into_iter())?;
        }
        for (end, sign) in [("upper", 2.0), ("lower", -2.0)] {
            let speeds = known(&|t, precision| Some(t.speed_mps? + sign * precision.sigma_speed_mps?));
            let headings = known(&|t, precision| Some(t.heading_deg + sign * precision.sigma_heading_deg));
            for (root, values) in [(path::SPEED, speeds), (path::HEADING, headings)] {
                // Curves of one name are one in the legend.
                let curve = Curve::new(format!("{id} +- 2 sigma"), colour::BAND, 0.75);
                self.curve(&format!("{root}/{}/after_{end}", part(id)), &curve, values.into_iter())?;
            }
        }
        Ok(())
    }

    /// The track and the shape beside what they are compared with.
    pub(super) fn compared(&self, body: &Body) -> Recorded {
        let id = part(&body.id);
        let places = &body.reference;
        if !places.is_empty() {
            let strip =
                LineStrips3D::new([places.iter().map(|p| self.local(p.position_m)).collect::<Vec<_>>()])
                    .with_colors([colour::REFERENCE])
                    .with_radii([on_screen(1.0)])
                    .with_labels([format!("{} reference", body.id)])
                    .with_show_labels(false);
            self.fixed(&format!("{}/{id}/reference", path::PATHS), &strip)?;
            let due = each_second(&self.scene.frames, places.iter().map(|place| place.frame));
            let picked: Vec<_> =
                places.iter().zip(due).filter(|(_, is_due)| *is_due).map(|(place, _)| place).collect();
            let dots = Points3D::new(picked.iter().map(|place| self.local(place.position_m)))
                .with_colors([colour::REFERENCE])
                .with_radii([on_screen(3.0)]);
            self.fixed(&format!("{}/{id}/reference/seconds", path::PATHS), &dots)?;
            let ellipsoids = picked.iter().filter_map(|place| {
                Some(Ellipsoid {
                    centre: self.local(place.position_m),
                    sigma_m: place.sigma_m?,
                    turn_rad: 0.0,
                })
            });
            self.ellipsoids(
                &format!("{}/{id}/reference/precision", path::PATHS),
                ellipsoids,
                colour::REFERENCE,
            )?;
            let curve = Curve::new(format!("{} reference", body.id), colour::REFERENCE, 1.0);
            let speed = places.iter().filter_map(|place| Some((place.frame, place.speed_mps?)));
            self.curve(&format!("{}/{id}/reference", path::SPEED), &curve, speed)?;
            let course = places.iter().filter_map(|place| Some((place.frame, place.course_deg?)));
            let curve = Curve::new(format!("{} reference (course)", body.id), colour::REFERENCE, 1.0);
            self.curve(&format!("{}/{id}/reference", path::HEADING), &curve, course)?;
            self.errors(body)?;
        }
        let Some(scan) = &body.scan else { return Ok(()) };
        let points = scan.points_m.iter().map(|p| p.map(|v| v as f32));
        let colours = scan.distances_m.iter().map(|distance| colour::of_length(*distance));
        let cloud = Points3D::new(points).with_colors(colours).with_radii([on_screen(1.0)]);
        self.fixed(&format!("{}/{id}/scan", path::SHAPES), &cloud)?;
        let far = scan.shape_distances_m.iter().map(|distance| distance.unwrap_or(f64::INFINITY));
        let shape = Points3D::new(body.after.points_m.iter().map(|p| p.map(|v| v as f32)))
            .with_colors(far.map(colour::of_length))
            .with_radii([on_screen(2.5)]);
        self.fixed(&format!("{}/{id}/to_scan", path::SHAPES), &shape)
    }

    /// Track minus reference along x and y, between two standard deviations of both together.
    fn errors(&self, body: &Body) -> Recorded {
        let root = format!("{}/{}", path::ERRORS, part(&body.id));
        let mut precisions = vec![None; self.scene.frames.len()];
        body.after.track.iter().for_each(|place| precisions[place.frame] = place.precision);
        for (axis, letter) in ["x", "y"].into_iter().enumerate() {
            let curve = Curve::new(format!("{} {letter}", body.id), colour::AXES[axis], 2.0);
            let errors = body.reference.iter().map(|place| (place.frame, place.difference_m[axis]));
            self.curve(&format!("{root}/{letter}"), &curve, errors)?;
            for (end, sign) in [("upper", 2.0), ("lower", -2.0)] {
                let bound = body.reference.iter().filter_map(|place| {
                    let sigma_m = precisions[place.frame]?.sigma_m[axis].hypot(place.sigma_m?[axis]);
                    Some((place.frame, sign * sigma_m))
                });
                let curve =
                    Curve::new(format!("{} {letter} +- 2 sigma of both", body.id), colour::BAND, 0.75);
                self.curve(&format!("{root}/{letter}_{end}"), &curve, bound)?;
            }
        }
        Ok(())
    }
}

/// The box around points but the outermost on each side, which may be far off.
struct Bounds {
    low: [f32; 3],
    high: [f32; 3],
}

/// Of so many points one on each side of the box is left out.
const POINTS_PER_OUTLIER: usize = 40;

impl Bounds {
    fn of(points: &[[f32; 3]]) -> Option<Self> {
        let left_out = points.len() / POINTS_PER_OUTLIER;
        let side = |axis: usize| {
            let mut values: Vec<f32> = points.iter().map(|point| point[axis]).collect();
            values.sort_by(f32::total_cmp);
            Some([*values.get(left_out)?, *values.get(values.len().checked_sub(left_out + 1)?)?])
        };
        let [x, y, z] = [side(0)?, side(1)?, side(2)?];
        Some(Bounds { low: [x[0], y[0], z[0]], high: [x[1], y[1], z[1]] })
    }
}
