//! What a problem knows of a vehicle beforehand: what a scenario says of it, and what is drawn.

use super::wander::normal;
use crate::files::section::Section;
use crate::problem::{Known, ScaleBar, ShapePoint, Vehicle};
use nalgebra::Point3;
use rand::Rng;
use rand_chacha::ChaCha8Rng;

/// A known height, or a pose, is not better than this in what the problem says \[m\].
pub const LEAST_KNOWN_M: f64 = 1e-4;
/// The most known distances of a vehicle.
const MOST_BARS: f64 = 1000.0;

/// What is known of a vehicle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KnowledgeSettings {
    /// How well the height of the highest point is known \[m\]; `None`: not at all.
    pub height_sigma_m: Option<f64>,
    /// How well the height of the marker is known \[m\].
    pub marker_sigma_m: Option<f64>,
    /// Distances that are known between points far apart.
    pub scale_bars: usize,
    /// How well these are known \[m\].
    pub scale_bar_sigma_m: f64,
    /// Points whose coordinates in the vehicle frame are known.
    pub known_points: usize,
    /// How well these are known, per axis \[m\].
    pub known_point_sigma_m: f64,
    /// Whether the problem says which point the marker is.
    pub names_marker: bool,
}

impl Default for KnowledgeSettings {
    fn default() -> Self {
        KnowledgeSettings {
            height_sigma_m: None,
            marker_sigma_m: None,
            scale_bars: 0,
            scale_bar_sigma_m: 0.01,
            known_points: 0,
            known_point_sigma_m: 0.01,
            names_marker: true,
        }
    }
}

/// The body of which something is known.
pub struct KnownBody<'a> {
    /// Ids and places of its points, sorted by id.
    pub points: &'a [(String, Point3<f64>)],
    /// In how many frames each is seen.
    pub sightings: &'a [usize],
    /// Which of them is the marker.
    pub marker: Option<usize>,
}

impl KnowledgeSettings {
    /// Reads it from `[[vehicle]]` of a scenario.
    pub fn read(vehicle: &Section) -> KnowledgeSettings {
        let wanted = format!("a whole number from 0 to {MOST_BARS}");
        let is_count = |v: f64| v.fract() == 0.0 && (0.0..=MOST_BARS).contains(&v);
        let sigma_m = vehicle.positive("scale_bar_sigma_m");
        if sigma_m.is_some() && !vehicle.has("scale_bars") {
            vehicle.error("scale_bar_sigma_m", "nothing without scale_bars");
        }
        let point_sigma_m = vehicle.positive("known_point_sigma_m");
        if point_sigma_m.is_some() && !vehicle.has("known_points") {
            vehicle.error("known_point_sigma_m", "nothing without known_points");
        }
        let usual = KnowledgeSettings::default();
        let count = |key| vehicle.number(key, &wanted, is_count).map(|count| count as usize);
        KnowledgeSettings {
            height_sigma_m: vehicle.not_negative("height_sigma_m"),
            marker_sigma_m: vehicle.not_negative("marker_sigma_m"),
            scale_bars: count("scale_bars").unwrap_or(usual.scale_bars),
            scale_bar_sigma_m: sigma_m.unwrap_or(usual.scale_bar_sigma_m),
            known_points: count("known_points").unwrap_or(usual.known_points),
            known_point_sigma_m: point_sigma_m.unwrap_or(usual.known_point_sigma_m),
            names_marker: vehicle.flag("marker").unwrap_or(usual.names_marker),
        }
    }

    /// A vehicle of these points with what is known of heights, whose errors are `scatter` times as large as stated.
    pub fn of_heights(&self, body: &KnownBody<'_>, chance: &mut ChaCha8Rng, scatter: f64) -> Vehicle {
        let [mark_error, height_error] = [(); 2].map(|()| normal(chance));
        let highest = body.points.iter().map(|(_, p)| p.z).fold(f64::NEG_INFINITY, f64::max);
        let known = |value_m: f64, sigma_m: f64, error: f64| Known {
            value_m: value_m + sigma_m * error,
            sigma_m: sigma_m.max(LEAST_KNOWN_M),
        };
        let shape = body.points.iter().enumerate().map(|(at, (id, place))| {
            let height = self.marker_sigma_m.filter(|_| body.marker == Some(at));
            ShapePoint {
                id: id.clone(),
                known: [None, None, height.map(|s| known(place.z, s, mark_error * scatter))],
            }
        });
        Vehicle {
            height: self
                .height_sigma_m
                .filter(|_| highest.is_finite())
                .map(|sigma_m| known(highest, sigma_m, scatter * height_error)),
            points: shape.collect(),
            ..Vehicle::default()
        }
    }

    /// The same vehicle with what is known of some points, their coordinates, and between them: distances from points of
    /// the plan to those farthest from them, no pair twice, among points that are seen at least half as often as most. Their errors are
    /// `scatter` times as large as stated.
    pub fn between_points(
        &self,
        mut vehicle: Vehicle,
        body: &KnownBody<'_>,
        plan: &mut ChaCha8Rng,
        chance: &mut ChaCha8Rng,
        scatter: f64,
    ) -> Vehicle {
        let mut sorted = body.sightings.to_vec();
        sorted.sort_unstable();
        let enough = sorted.get(sorted.len() / 2).map_or(0, |median| median / 2);
        let seen: Vec<usize> =
            (0..body.points.len()).filter(|point| body.sightings[*point] >= enough).collect();
        let mut order: Vec<(f64, usize)> = seen.iter().map(|point| (plan.random(), *point)).collect();
        order.sort_by(|a, b| a.0.total_cmp(&b.0));
        let length_m = |a: usize, b: usize| (body.points[a].1 - body.points[b].1).norm();
        for (_, point) in order.iter().take(self.known_points) {
            for axis in 0..3 {
                let error_m = normal(chance) * self.known_point_sigma_m * scatter;
                let value_m = body.points[*point].1[axis] + error_m;
                vehicle.points[*point].known[axis] =
                    Some(Known { value_m, sigma_m: self.known_point_sigma_m });
            }
        }
        let mut scale_bars: Vec<ScaleBar> = Vec::new();
        for (_, from) in order.iter().cycle().take(self.scale_bars) {
            let is_new = |to: &usize| {
                let pairs = [[*from, *to], [*to, *from]];
                to != from && scale_bars.iter().all(|bar| !pairs.contains(&bar.points))
            };
            let others = seen.iter().copied().filter(is_new);
            let farthest = others.max_by(|a, b| length_m(*from, *a).total_cmp(&length_m(*from, *b)));
            let Some(to) = farthest else { continue };
            let error_m = normal(chance) * self.scale_bar_sigma_m * scatter;
            scale_bars.push(ScaleBar {
                points: [*from, to],
                length_m: length_m(*from, to) + error_m,
                sigma_m: self.scale_bar_sigma_m,
            });
        }
        Vehicle { scale_bars, ..vehicle }
    }
}
