//! Tracks beside those of a body: of what stands around it, of highlights that slide over it, of other things that
//! move.
//!
//! They come in addition to the tracks of the body, which stay as they are to the last bit: so many that they are the
//! wanted share of all. Each kind is drawn from a stream of its own. A track is followed for 15 to 60 frames, while it
//! is inside a box around the vehicle in the image and the body does not hide it.

use super::body::Body;
use super::scenario::ErrorSettings;
use super::wander::{Purpose, normal3, stream};
use crate::camera::Camera;
use crate::geometry::Pose;
use crate::terrain::Terrain;
use nalgebra::{Point3, Vector2, Vector3};
use rand::Rng;
use rand_chacha::ChaCha8Rng;

/// A place, and the normal of the surface there if it has one, at a time \[s\].
type PlaceAt = dyn Fn(f64) -> (Place, Option<Vector3<f64>>);

/// Of what a wrong track is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WrongKind {
    /// A place on the road, followed for as long as a point of the body would have been (`ground_tracks`).
    Ground,
    /// Another point of the body from some moment on (`swapped_tracks`).
    Swapped,
    /// A point of the static world.
    Static,
    /// A highlight or a reflection.
    Sliding,
    /// A point of another vehicle, or of the carrier of the camera.
    Foreign,
}

impl WrongKind {
    /// As it stands in `truth/wrong_tracks.csv`: as the reason in a result. A place on the road is static too.
    pub fn name(self) -> &'static str {
        match self {
            WrongKind::Ground | WrongKind::Static => "static",
            WrongKind::Swapped => "swapped",
            WrongKind::Sliding => "sliding",
            WrongKind::Foreign => "foreign",
        }
    }
}

/// How long a wrong track is followed \[frames\].
const FRAMES: [usize; 2] = [15, 60];
/// Fewest frames in which it must be seen.
const LEAST_SEEN: usize = 8;
/// Places that are tried for a track.
const TRIES: usize = 60;
/// Static points are so far from the body at the most, along and across \[m\] ...
const AROUND_M: [f64; 2] = [6.0, 4.0];
/// ... this share of them on the ground, the others up to so high above it \[m\].
const ON_GROUND: f64 = 0.6;
const HIGHEST_M: f64 = 2.5;
/// By what the box around the body in the image is larger than the body.
const BOX_FACTOR: f64 = 1.3;
/// How fast highlights slide \[m/s\].
const SLIDE_MPS: [f64; 2] = [0.03, 0.3];
/// Depth at which a thing on the carrier of the camera is seen \[m\].
const CARRIER_M: f64 = 0.5;

/// A moment of a film, of the vehicle that is tracked and of all vehicles.
pub struct Moment<'a> {
    /// `world_from_camera`.
    pub camera: &'a Pose,
    /// `world_from_vehicle` of the vehicle.
    pub vehicle: &'a Pose,
    /// That of another one.
    pub other: Option<&'a Pose>,
}

/// A vehicle whose surroundings are tracked.
pub struct Surroundings<'a> {
    pub seed: u64,
    pub run: u64,
    pub vehicle: usize,
    /// How many tracks of its body there are.
    pub tracks: usize,
    pub rate_hz: f64,
    pub errors: &'a ErrorSettings,
    pub body: &'a Body,
    /// The body of another vehicle.
    pub other: Option<&'a Body>,
    pub camera: &'a Camera,
    pub terrain: &'a Terrain,
    pub moments: Vec<Moment<'a>>,
}

/// Where the place of a wrong track is: in the world, in the frame of the body, of another vehicle, or of the camera.
#[derive(Clone, Copy, Debug)]
pub enum Place {
    World(Point3<f64>),
    Body(Point3<f64>),
    Other(Point3<f64>),
    Camera(Point3<f64>),
}

/// A wrong track: its name, of what it is, and its place in each frame in which it is seen.
pub struct WrongTrack {
    pub id: String,
    pub kind: WrongKind,
    pub places: Vec<(usize, Place)>,
}

impl Surroundings<'_> {
    /// The wrong tracks, by kind.
    pub fn tracks(&self) -> Vec<WrongTrack> {
        let of = self.errors;
        let shares = [of.static_tracks, of.sliding_tracks, of.foreign_tracks];
        let all = self.tracks as f64 / (1.0 - shares.iter().sum::<f64>()).max(0.05);
        let kinds = [
            (WrongKind::Static, Purpose::StaticTracks, "x"),
            (WrongKind::Sliding, Purpose::SlidingTracks, "y"),
            (WrongKind::Foreign, Purpose::ForeignTracks, "z"),
        ];
        let mut tracks = Vec::new();
        for ((kind, purpose, letter), share) in kinds.into_iter().zip(shares) {
            let mut rng = stream(self.seed, self.run, purpose, 2 * self.vehicle);
            for at in 0..(share * all).round() as usize {
                let places =
                    (0..TRIES).map(|_| self.draw(kind, &mut rng)).find(|places| places.len() >= LEAST_SEEN);
                let Some(places) = places else { continue };
                tracks.push(WrongTrack { id: format!("{letter}{:05}", at + 1), kind, places });
            }
        }
        tracks
    }

    /// The noise of the image points of a kind of tracks.
    pub fn noise(&self, kind: WrongKind) -> ChaCha8Rng {
        let purpose = match kind {
            WrongKind::Sliding => Purpose::SlidingTracks,
            WrongKind::Foreign => Purpose::ForeignTracks,
            WrongKind::Ground | WrongKind::Swapped | WrongKind::Static => Purpose::StaticTracks,
        };
        stream(self.seed, self.run, purpose, 2 * self.vehicle + 1)
    }

    /// A track that begins at a random moment, for as long as it is seen.
    fn draw(&self, kind: WrongKind, rng: &mut ChaCha8Rng) -> Vec<(usize, Place)> {
        let begin = rng.random_range(0..self.moments.len());
        let life = rng.random_range(FRAMES[0]..=FRAMES[1]);
        let at_time = self.path(kind, begin, rng);
        let frames = begin..(begin + life).min(self.moments.len());
        let seen = |frame: usize| {
            let (place, normal) = at_time((frame - begin) as f64 / self.rate_hz);
            self.is_seen(frame, &place, normal).then_some((frame, place))
        };
        frames.map_while(seen).collect()
    }

    /// Where a thing of a kind is after a time, and which way its surface faces in the frame of its body.
    fn path(&self, kind: WrongKind, begin: usize, rng: &mut ChaCha8Rng) -> Box<PlaceAt> {
        match (kind, self.other) {
            (WrongKind::Static | WrongKind::Ground, _) => {
                let vehicle = self.moments[begin].vehicle;
                let around = AROUND_M.map(|m| rng.random_range(-m..m));
                let draw: f64 = rng.random();
                let above_m = ((draw - ON_GROUND) / (1.0 - ON_GROUND)).max(0.0) * HIGHEST_M;
                let near = vehicle * Point3::new(around[0], around[1], 0.0);
                let ground_m = self.terrain.at(near.x, near.y).map_or(near.z, |ground| ground.height_m);
                let place = Point3::new(near.x, near.y, ground_m + above_m);
                Box::new(move |_| (Place::World(place), None))
            }
            (WrongKind::Sliding | WrongKind::Swapped, _) => {
                let (place, normal) = self.body.point(rng);
                let random = normal3(rng);
                let along = (random - normal * normal.dot(&random)).normalize();
                let velocity_mps = along * rng.random_range(SLIDE_MPS[0]..SLIDE_MPS[1]);
                Box::new(move |time_s| (Place::Body(place + velocity_mps * time_s), Some(normal)))
            }
            (WrongKind::Foreign, Some(other)) => {
                let (place, normal) = other.point(rng);
                Box::new(move |_| (Place::Other(place), Some(normal)))
            }
            (WrongKind::Foreign, None) => {
                let moment = &self.moments[begin];
                let [length, width] = AROUND_M.map(|m| 0.5 * m);
                let around =
                    Point3::new(rng.random_range(-length..length), rng.random_range(-width..width), 0.5);
                let seen = moment.camera.inverse_transform_point(&(moment.vehicle * around));
                let place = seen * (CARRIER_M / seen.z.abs().max(CARRIER_M));
                Box::new(move |_| (Place::Camera(place), None))
            }
        }
    }

    /// Where a place is in the world at the time of a frame.
    pub fn in_world(&self, frame: usize, place: &Place) -> Option<Point3<f64>> {
        let moment = &self.moments[frame];
        Some(match place {
            Place::World(point) => *point,
            Place::Body(point) => moment.vehicle * point,
            Place::Other(point) => moment.other? * point,
            Place::Camera(point) => moment.camera * point,
        })
    }

    /// Whether a place is inside the box around the vehicle in the image, faces the camera, and is not hidden.
    fn is_seen(&self, frame: usize, place: &Place, normal: Option<Vector3<f64>>) -> bool {
        let moment = &self.moments[frame];
        let Some(in_world) = self.in_world(frame, place) else { return false };
        let project =
            |point: &Point3<f64>| self.camera.project(&moment.camera.inverse_transform_point(point).coords);
        let Some(pixel) = project(&in_world) else { return false };
        let corners = self.body.corners().map(|corner| project(&(moment.vehicle * corner)));
        let Some(corners) = corners.into_iter().collect::<Option<Vec<Vector2<f64>>>>() else { return false };
        let is_inside = (0..2).all(|axis| {
            let least = corners.iter().map(|c| c[axis]).fold(f64::INFINITY, f64::min);
            let most = corners.iter().map(|c| c[axis]).fold(f64::NEG_INFINITY, f64::max);
            (pixel[axis] - 0.5 * (least + most)).abs() <= 0.5 * BOX_FACTOR * (most - least)
        });
        let eye = Point3::from(moment.camera.translation.vector);
        let faces = match (place, normal) {
            (Place::Body(_), Some(normal)) => (moment.vehicle.rotation * normal).dot(&(eye - in_world)) > 0.0,
            (Place::Other(_), Some(normal)) => {
                moment.other.is_some_and(|pose| (pose.rotation * normal).dot(&(eye - in_world)) > 0.0)
            }
            _ => true,
        };
        let is_of_body = matches!(place, Place::Body(_) | Place::Camera(_));
        let hidden = || {
            let to_body = moment.vehicle.inverse();
            self.body.hides(&(to_body * eye), &(to_body * in_world))
        };
        is_inside && faces && (is_of_body || !hidden())
    }
}
