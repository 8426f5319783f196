//! The scene: plain numbers, 64 bits, in the world's coordinates (z up, metres).

use std::path::PathBuf;

/// How many times as long arrows of residuals are if nothing else is said.
pub const DEFAULT_RESIDUAL_FACTOR: f64 = 20.0;

/// Everything that is drawn.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Scene {
    /// Its name.
    pub name: String,
    /// Where it stands among scenes that are drawn side by side; nothing where it is the only one.
    pub root: Option<String>,
    /// The frames of the film, in time order.
    pub frames: Vec<Frame>,
    /// The camera.
    pub camera: Camera,
    /// What moves.
    pub bodies: Vec<Body>,
    /// Points of the static world.
    pub targets: Vec<Target>,
    /// The image points of each frame.
    pub image_points: Vec<Vec<ImagePoint>>,
    /// The ground, where it is known.
    pub ground: Ground,
    /// The iterations of the adjustment, in order.
    pub iterations: Vec<Iteration>,
    /// A summary to read, in Markdown.
    pub summary: String,
    /// What is odd.
    pub warnings: Vec<String>,
    /// Arrows of residuals are so many times as long; by default [`DEFAULT_RESIDUAL_FACTOR`].
    pub residual_factor: Option<f64>,
    /// The film.
    pub film: Option<Film>,
    /// The same on the Earth.
    pub map: Option<Map>,
}

/// The film that the image points are from, in files that are read when they are drawn.
#[derive(Clone, Debug, PartialEq)]
pub enum Film {
    /// An image of each frame, where there is one.
    Images(Vec<Option<PathBuf>>),
    /// A video asset.
    Video {
        /// The file.
        file: PathBuf,
        /// Its time minus the time of frames \[s\].
        offset_s: f64,
    },
}

/// Latitude and longitude \[deg\].
pub type Geodetic = [f64; 2];

/// What of a scene has a place on the Earth.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Map {
    /// Path of the camera.
    pub camera_deg: Vec<Geodetic>,
    /// Targets.
    pub targets_deg: Vec<(TargetRole, Geodetic)>,
    /// Tracks of the bodies.
    pub tracks: Vec<MapTrack>,
}

/// A track on the Earth.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MapTrack {
    /// Id of the body.
    pub id: String,
    /// Before the adjustment.
    pub before_deg: Vec<Geodetic>,
    /// After it.
    pub after_deg: Vec<Geodetic>,
    /// Where something else says it was.
    pub reference_deg: Vec<Geodetic>,
}

/// Heights on a lattice.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Ground {
    /// The lines of the lattice along x, y \[m\].
    pub lines_m: [Vec<f64>; 2],
    /// Heights \[m\], one for each x of the first y, then of the next; `None` where there is no ground.
    pub heights_m: Vec<Option<f64>>,
}

/// A frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Frame {
    /// Its number.
    pub number: i64,
    /// Its time \[s\].
    pub time_s: f64,
}

/// A rigid transform `world_from_body`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Position of the body's origin \[m\].
    pub position_m: [f64; 3],
    /// Unit quaternion, scalar first.
    pub quaternion_wxyz: [f64; 4],
}

/// A camera that looks along z, x to the right, y down.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Camera {
    /// Width and height of the image \[px\].
    pub size_px: [u32; 2],
    /// Focal lengths \[px\].
    pub focal_px: [f64; 2],
    /// Principal point \[px\].
    pub principal_px: [f64; 2],
    /// Its pose in each frame, before the adjustment.
    pub before: Vec<Pose>,
    /// Its pose in each frame, after the adjustment; nothing before there is one.
    pub after: Vec<Pose>,
}

/// A rigid body that moves.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Body {
    /// Its id.
    pub id: String,
    /// Before the adjustment.
    pub before: State,
    /// After it.
    pub after: State,
    /// What the track after it is compared with.
    pub reference: Vec<ReferencePlace>,
    /// What the shape after it is compared with.
    pub scan: Option<Scan>,
    /// What nothing determines.
    pub open: Vec<Open>,
}

/// A place that something else, such as a receiver, measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReferencePlace {
    /// Index of the frame.
    pub frame: usize,
    /// Position in the world \[m\].
    pub position_m: [f64; 3],
    /// Its standard deviations along x, y, z \[m\].
    pub sigma_m: Option<[f64; 3]>,
    /// The track minus it \[m\].
    pub difference_m: [f64; 3],
    /// Horizontal speed \[m/s\].
    pub speed_mps: Option<f64>,
    /// Direction of motion, counter-clockwise from x \[deg\].
    pub course_deg: Option<f64>,
}

/// A scan of a body, in the body's frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Scan {
    /// Its points \[m\].
    pub points_m: Vec<[f64; 3]>,
    /// How far each is from the nearest point of the shape \[m\].
    pub distances_m: Vec<f64>,
    /// How far each point of the shape is from it \[m\], in the order of the shape; nothing where that is not
    /// known.
    pub shape_distances_m: Vec<Option<f64>>,
}

/// A direction that nothing determines.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Open {
    /// What it is.
    pub name: String,
    /// Lines in the world along which things may be anywhere \[m\].
    pub lines_m: Vec<[[f64; 3]; 2]>,
}

/// Shape and motion of a body.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct State {
    /// Its points, in its own frame \[m\].
    pub points_m: Vec<[f64; 3]>,
    /// Standard deviations of its points along the axes of its frame \[m\], infinite where nothing determines
    /// them; none at all where they were not computed.
    pub sigmas_m: Vec<Option<[f64; 3]>>,
    /// Its pose in each frame in which it is there.
    pub poses: Vec<(usize, Pose)>,
    /// The track of its marker.
    pub track: Vec<TrackPoint>,
}

/// A place on a track.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackPoint {
    /// Index of the frame.
    pub frame: usize,
    /// Position in the world \[m\].
    pub position_m: [f64; 3],
    /// Horizontal speed \[m/s\].
    pub speed_mps: Option<f64>,
    /// Heading, counter-clockwise from x \[deg\].
    pub heading_deg: f64,
    /// How well it is known.
    pub precision: Option<TrackPrecision>,
}

/// Standard deviations of a place on a track; infinite where nothing determines them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackPrecision {
    /// Along x, y, z \[m\].
    pub sigma_m: [f64; 3],
    /// Covariance of x and y \[m^2\].
    pub covariance_xy_m2: f64,
    /// Of the horizontal speed \[m/s\].
    pub sigma_speed_mps: Option<f64>,
    /// Of the heading \[deg\].
    pub sigma_heading_deg: f64,
}

/// What a target is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TargetRole {
    /// It was adjusted to.
    Control,
    /// It was only compared with.
    Check,
    /// It had no known coordinates.
    Tie,
}

/// A point of the static world.
#[derive(Clone, Debug, PartialEq)]
pub struct Target {
    /// Its id.
    pub id: String,
    /// What it is for.
    pub role: TargetRole,
    /// Where it is \[m\].
    pub position_m: [f64; 3],
    /// Standard deviations of its survey along x, y, z \[m\].
    pub sigma_m: Option<[f64; 3]>,
}

/// What an image point shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImagePointKind {
    /// A point of a moving body.
    Body,
    /// A target.
    Target,
}

/// How an image point was taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Marking {
    /// It takes part.
    Good,
    /// It is a gross error.
    Rejected,
    /// It takes no part for another reason.
    NotUsed,
}

/// An image point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImagePoint {
    /// What it shows.
    pub kind: ImagePointKind,
    /// Where it was seen \[px\].
    pub observed_px: [f64; 2],
    /// Where it should be, after the adjustment \[px\].
    pub computed_px: Option<[f64; 2]>,
    /// How it was taken.
    pub marking: Marking,
    /// Why it takes no part.
    pub reason: Option<&'static str>,
}

/// One iteration.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Iteration {
    /// What it belongs to.
    pub stage: &'static str,
    /// Cost after it.
    pub cost: f64,
    /// Damping of its step.
    pub damping: f64,
    /// Length of its step; nothing where none was made.
    pub step: Option<f64>,
    /// The state after it.
    pub state: Snapshot,
}

/// A state on the way.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Snapshot {
    /// The camera's pose in each frame.
    pub camera: Vec<Pose>,
    /// The bodies.
    pub bodies: Vec<BodySnapshot>,
}

/// A body on the way.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BodySnapshot {
    /// Its id.
    pub id: String,
    /// Its track \[m\].
    pub track_m: Vec<[f64; 3]>,
    /// Its points, in its own frame \[m\].
    pub points_m: Vec<[f64; 3]>,
}

impl Scene {
    /// How many times as long arrows of residuals are.
    pub fn residual_factor(&self) -> f64 {
        self.residual_factor.unwrap_or(DEFAULT_RESIDUAL_FACTOR)
    }

    /// The point that recordings put at zero, because the viewer keeps 32 bits: nothing where the
    /// coordinates are small, else a round number in their midst \[m\].
    pub fn local_origin_m(&self) -> [f64; 3] {
        let places: Vec<[f64; 3]> = self.camera.before.iter().map(|pose| pose.position_m).collect();
        std::array::from_fn(|axis| {
            let mean = places.iter().map(|p| p[axis]).sum::<f64>() / places.len().max(1) as f64;
            if mean.abs() < SMALL_M { 0.0 } else { (mean / ROUND_M).round() * ROUND_M }
        })
    }
}

/// Which of these frames, given by their indices in order, are about a second apart: the first, and each that is a
/// second or more after the last one.
pub fn each_second(frames: &[Frame], indices: impl Iterator<Item = usize>) -> Vec<bool> {
    let mut next_s = f64::NEG_INFINITY;
    indices
        .map(|at| {
            let time_s = frames[at].time_s;
            let is_due = time_s >= next_s;
            if is_due {
                next_s = time_s + 1.0;
            }
            is_due
        })
        .collect()
}

/// Up to here 32 bits hold a tenth of a millimetre \[m\].
const SMALL_M: f64 = 1000.0;
const ROUND_M: f64 = 100.0;

#[cfg(test)]
mod tests {
    use super::*;

    fn scene_at(position_m: [f64; 3]) -> Scene {
        let pose = Pose { position_m, quaternion_wxyz: [1.0, 0.0, 0.0, 0.0] };
        Scene { camera: Camera { before: vec![pose], ..Default::default() }, ..Default::default() }
    }

    #[test]
    fn small_coordinates_stay_and_large_ones_are_shifted_by_a_round_number() {
        assert_eq!(scene_at([-20.0, 0.0, 60.0]).local_origin_m(), [0.0; 3]);
        let shifted = scene_at([691_234.5, 5_334_760.2, 580.0]).local_origin_m();
        assert_eq!(shifted, [691_200.0, 5_334_800.0, 0.0]);
    }
}
