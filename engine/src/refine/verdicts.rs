//! What became of image points: used, down-weighted, or rejected for a named reason.

use crate::estimate::Estimate;
use crate::network::Selection;
use crate::problem::Problem;

/// What became of an image point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImagePointVerdict {
    /// It took part.
    Used,
    /// It took part, with less than half of its weight.
    DownWeighted,
    /// It took no part.
    Rejected(RejectionReason),
}

impl ImagePointVerdict {
    /// Why it was rejected, if it was.
    pub fn reason(self) -> Option<RejectionReason> {
        match self {
            ImagePointVerdict::Rejected(reason) => Some(reason),
            ImagePointVerdict::Used | ImagePointVerdict::DownWeighted => None,
        }
    }
}

/// Why an image point took no part.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum RejectionReason {
    /// It is a gross error by itself.
    ImagePoint,
    /// Its track is one as a whole: it is not of this body, or not of this target, and of what it is nobody can say.
    Track,
    /// Its track is of the static world: of the road, the background, the shadow of a building.
    Static,
    /// Its track slides over the body: a highlight, a reflection.
    Sliding,
    /// Its track has gone over to another point of the body.
    Swapped,
    /// Its track is of something else that moves: another vehicle, or the carrier of the camera.
    Foreign,
    /// All that was seen of the vehicle, or of the targets, in its frame is one.
    Frame,
    /// Its computed place is behind the camera.
    BehindCamera,
    /// Its point has no coordinates.
    NoCoordinates,
    /// It is of a check point.
    CheckPoint,
}

impl RejectionReason {
    /// All of them.
    pub const ALL: [RejectionReason; 10] = [
        RejectionReason::ImagePoint,
        RejectionReason::Track,
        RejectionReason::Static,
        RejectionReason::Sliding,
        RejectionReason::Swapped,
        RejectionReason::Foreign,
        RejectionReason::Frame,
        RejectionReason::BehindCamera,
        RejectionReason::NoCoordinates,
        RejectionReason::CheckPoint,
    ];

    /// That of this name.
    pub fn of_name(name: &str) -> Option<RejectionReason> {
        RejectionReason::ALL.into_iter().find(|reason| reason.name() == name)
    }

    /// Its name in a report and in a table.
    pub fn name(self) -> &'static str {
        match self {
            RejectionReason::ImagePoint => "image_point",
            RejectionReason::Track => "track",
            RejectionReason::Static => "static",
            RejectionReason::Sliding => "sliding",
            RejectionReason::Swapped => "swapped",
            RejectionReason::Foreign => "foreign",
            RejectionReason::Frame => "frame",
            RejectionReason::BehindCamera => "behind_camera",
            RejectionReason::NoCoordinates => "no_coordinates",
            RejectionReason::CheckPoint => "check_point",
        }
    }

    /// Whether it is a gross error of the image point.
    pub fn is_gross(self) -> bool {
        matches!(self, RejectionReason::ImagePoint | RejectionReason::Frame) || self.is_of_track()
    }

    /// Whether it is one of its track, whatever that is of.
    pub fn is_of_track(self) -> bool {
        match self {
            RejectionReason::Track
            | RejectionReason::Static
            | RejectionReason::Sliding
            | RejectionReason::Swapped
            | RejectionReason::Foreign => true,
            RejectionReason::ImagePoint
            | RejectionReason::Frame
            | RejectionReason::BehindCamera
            | RejectionReason::NoCoordinates
            | RejectionReason::CheckPoint => false,
        }
    }
}

/// How many image points were used, down-weighted and rejected; together all that were given.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// That took part.
    pub used: usize,
    /// That took part with less than half of their weight.
    pub down_weighted: usize,
    /// That took no part, in the order of [`RejectionReason::ALL`].
    pub rejected: [usize; RejectionReason::ALL.len()],
}

impl Tally {
    fn count(&mut self, verdict: ImagePointVerdict) {
        match verdict {
            ImagePointVerdict::Used => self.used += 1,
            ImagePointVerdict::DownWeighted => self.down_weighted += 1,
            ImagePointVerdict::Rejected(reason) => self.rejected[reason as usize] += 1,
        }
    }

    /// Rejected for this reason.
    pub fn of(&self, reason: RejectionReason) -> usize {
        self.rejected[reason as usize]
    }

    /// Gross errors of all kinds.
    pub fn gross(&self) -> usize {
        self.of_those(RejectionReason::is_gross)
    }

    /// Rejected with their tracks, whatever these are of.
    pub fn with_track(&self) -> usize {
        self.of_those(RejectionReason::is_of_track)
    }

    fn of_those(&self, counts: fn(RejectionReason) -> bool) -> usize {
        RejectionReason::ALL.into_iter().filter(|reason| counts(*reason)).map(|reason| self.of(reason)).sum()
    }

    /// All that were given.
    pub fn all(&self) -> usize {
        self.used + self.down_weighted + self.rejected.iter().sum::<usize>()
    }
}

/// The verdicts on all image points of a problem.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Verdicts {
    /// For each vehicle one for each of its observations.
    pub vehicles: Vec<Vec<ImagePointVerdict>>,
    /// One for each target observation.
    pub targets: Vec<ImagePointVerdict>,
}

impl Verdicts {
    /// Their counts.
    pub fn tally(&self) -> Tally {
        let mut tally = Tally::default();
        self.vehicles.iter().flatten().chain(&self.targets).for_each(|verdict| tally.count(*verdict));
        tally
    }
}

/// Image points that an adjustment leaves out: of whole tracks and whole frames.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Excluded {
    /// For each vehicle one for each of its observations.
    pub vehicles: Vec<Vec<Option<RejectionReason>>>,
    /// One for each target observation.
    pub targets: Vec<Option<RejectionReason>>,
}

impl Excluded {
    /// The image points that are not left out.
    pub fn selection(&self) -> Selection {
        let taken =
            |out: &Vec<Option<RejectionReason>>| -> Vec<bool> { out.iter().map(Option::is_none).collect() };
        Selection { vehicles: self.vehicles.iter().map(taken).collect(), targets: taken(&self.targets) }
    }

    /// The estimate without the points of which nothing but image points that are left out says anything: far from the
    /// body, they would only disturb the others.
    pub fn without_points_left_out(&self, problem: &Problem, estimate: &Estimate) -> Estimate {
        let mut taken = estimate.clone();
        for (at, vehicle) in problem.vehicles.iter().enumerate() {
            let mut is_wanted = vec![false; vehicle.points.len()];
            let mut is_out = vec![false; vehicle.points.len()];
            for (o, reason) in vehicle.observations.iter().zip(&self.vehicles[at]) {
                is_wanted[o.point] |= reason.is_none();
                is_out[o.point] |= reason.is_some();
            }
            is_wanted.iter_mut().zip(&vehicle.points).for_each(|(is_wanted, point)| {
                *is_wanted |= point.known.iter().any(Option::is_some);
            });
            let of_receivers = problem.receivers.iter().filter(|r| r.vehicle == at).map(|r| r.point);
            let of_bars = vehicle.scale_bars.iter().flat_map(|bar| bar.points);
            of_receivers.chain(of_bars).chain(vehicle.marker).for_each(|point| is_wanted[point] = true);
            let points = taken.vehicles[at].points.iter_mut().zip(is_wanted.iter().zip(&is_out));
            points.filter(|(_, (wanted, out))| **out && !**wanted).for_each(|(point, _)| *point = None);
        }
        taken
    }

    /// Nothing is left out.
    pub fn nothing(problem: &Problem) -> Excluded {
        Excluded {
            vehicles: problem.vehicles.iter().map(|v| vec![None; v.observations.len()]).collect(),
            targets: vec![None; problem.target_observations.len()],
        }
    }

    /// Whether nothing is left out.
    pub fn is_empty(&self) -> bool {
        self.vehicles.iter().flatten().chain(&self.targets).all(Option::is_none)
    }

    /// Whether tracks are left out that were not `before` and that a motion may be bent to: what stands or slides, or
    /// moves steadily, fits a moving body so well that a robust loss holds on to it.
    pub fn has_new_tracks_that_bend(&self, before: &Excluded) -> bool {
        let bends = |reason: &Option<RejectionReason>| {
            matches!(
                reason,
                Some(RejectionReason::Static | RejectionReason::Sliding | RejectionReason::Foreign)
            )
        };
        let pairs = self.vehicles.iter().flatten().zip(before.vehicles.iter().flatten());
        pairs.into_iter().any(|(now, before)| bends(now) && before.is_none())
    }
}
