//! What a first estimate says.

use super::{Code, Coded};
use crate::estimate::LeftOut;
use crate::initialise::resection::{BridgeReason, ResectionRules};
use crate::initialise::vehicle_poses::motion_program::Bound;
use crate::initialise::{InitialWarning, NotResectable};
use std::fmt;

impl fmt::Display for LeftOut {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            LeftOut::NeverSeen => write!(f, "it is never seen"),
            LeftOut::NoTerrain => {
                write!(f, "it has no starting poses, and there is no terrain to find them on")
            }
            LeftOut::RaysMissTerrain { rays } => {
                write!(f, "it has no starting poses, and none of its {rays} rays meets the terrain")
            }
            LeftOut::TooFewOnTerrain => {
                write!(f, "it has no starting poses, and no frame shows two of its points on the terrain")
            }
            LeftOut::NoPositions => {
                write!(f, "it has no starting poses, and its motion was not found: no frame has a position")
            }
            LeftOut::MotionNotSolved => write!(
                f,
                "it has no starting poses, and its motion was not found: the cone program of the motion was not solved"
            ),
            LeftOut::TooFewSeen { seen, needed } => {
                write!(f, "{seen} of its points are seen in two frames or more, {needed} are needed")
            }
            LeftOut::TooFewIntersected { found, needed } => write!(
                f,
                "{found} of its points have rays that meet, {needed} are needed: seen from one side only?"
            ),
        }
    }
}

impl Coded for LeftOut {
    fn coded(&self) -> Code {
        match self {
            LeftOut::NeverSeen => Code::new("never_seen"),
            LeftOut::NoTerrain => Code::new("no_poses_no_terrain"),
            LeftOut::RaysMissTerrain { rays } => Code::new("rays_miss_terrain").count(*rays),
            LeftOut::TooFewOnTerrain => Code::new("too_few_points_on_terrain"),
            LeftOut::NoPositions => Code::new("no_positions"),
            LeftOut::MotionNotSolved => Code::new("motion_not_solved"),
            LeftOut::TooFewSeen { seen, needed } => {
                Code::new("too_few_points_seen").count(*seen).limit(*needed as f64)
            }
            LeftOut::TooFewIntersected { found, needed } => {
                Code::new("too_few_points_intersected").count(*found).limit(*needed as f64)
            }
        }
    }
}

impl fmt::Display for NotResectable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "no camera pose can be determined: ")?;
        match self {
            NotResectable::TooFew { most } => write!(
                f,
                "a frame needs three control targets with three known coordinates in view, and none sees more than {most} (one target leaves the attitude and the distance open, two a turn about the line through them)"
            ),
            NotResectable::OnALine => write!(
                f,
                "in every frame the control targets in view lie (nearly) on one line, and the rotation of the camera about that line is open"
            ),
            NotResectable::PoorlySpread => write!(
                f,
                "the control targets in view are so poorly spread in every frame that the camera is not known to {} m and {:.0} degree",
                ResectionRules::DEFAULT.most_sigma[0],
                ResectionRules::DEFAULT.most_sigma[1].to_degrees()
            ),
            NotResectable::Ambiguous => write!(
                f,
                "in every frame several poses fit the control targets in view (three of them allow up to four); a fourth in some frames would decide"
            ),
            NotResectable::Contradictory => write!(
                f,
                "in no frame do most of the control targets in view agree on a pose: are coordinates, ids or the interior orientation those of another problem?"
            ),
        }
    }
}

impl std::error::Error for NotResectable {}

/// Why a frame was not resected, in words that follow a number of targets.
fn reason_of_frame(reason: BridgeReason) -> &'static str {
    match reason {
        BridgeReason::TooFew => "in view",
        BridgeReason::OnALine => "in view, nearly on one line",
        BridgeReason::PoorlySpread => "in view, too poorly spread",
        BridgeReason::Ambiguous => "in view, which several poses fit",
        BridgeReason::Contradictory => "in view, which do not agree on a pose",
    }
}

fn frames_named([first, last]: [i64; 2]) -> String {
    if first == last { format!("frame {first}") } else { format!("frames {first}-{last}") }
}

fn control_targets([least, most]: [usize; 2]) -> String {
    match (least, most) {
        (0, 0) => "no control target".to_owned(),
        (1, 1) => "1 control target".to_owned(),
        _ if least == most => format!("{least} control targets"),
        _ => format!("{least} to {most} control targets"),
    }
}

/// The name of a motion and its unit, and by what its numbers are multiplied to be in that.
fn motion_named(bound: Bound, turns: bool) -> (&'static str, &'static str, fn(f64) -> f64) {
    match (bound, turns) {
        (Bound::Rate, false) => ("speed", "m/s", |value| value),
        (Bound::Rate, true) => ("rate of turn", "deg/s", f64::to_degrees),
        (Bound::Acceleration, _) => ("acceleration", "m/s^2", |value| value),
    }
}

impl fmt::Display for InitialWarning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            InitialWarning::Bridged { reason, frames, targets, sigma_m } => write!(
                f,
                "camera pose of {}: {} {}; bridged from the frames beside (to about {sigma_m:.2} m)",
                frames_named(*frames),
                control_targets(*targets),
                reason_of_frame(*reason)
            ),
            InitialWarning::MoreBridged { frames, gaps } => {
                write!(f, "camera poses of {frames} more frames in {gaps} shorter gaps were bridged likewise")
            }
            InitialWarning::TargetsScatter { factor } => {
                write!(f, "image points of targets scatter {factor:.1} times as much as their sigmas say")
            }
            InitialWarning::HeadingGuessed { vehicle } => write!(
                f,
                "vehicle {vehicle}: it hardly moves: its heading is that of its long axis and may be half a turn wrong"
            ),
            InitialWarning::BeyondBounds { vehicle, time_s: [from, to], bound, turns, reached, limit } => {
                let (name, unit, shown) = motion_named(*bound, *turns);
                write!(
                    f,
                    "vehicle {vehicle}: from {from:.2} s to {to:.2} s its image points demand a {name} of {:.1} {unit}, \
                     beyond the bound of {:.1} {unit}",
                    shown(*reached),
                    shown(*limit)
                )
            }
            InitialWarning::VehicleLeftOut { vehicle, reason } => {
                write!(f, "vehicle {vehicle} is left out: {reason}")
            }
            InitialWarning::SeenOnce { vehicle, points } => write!(
                f,
                "vehicle {vehicle}: points seen in one frame only, which get no coordinates: {points}"
            ),
            InitialWarning::RaysDoNotMeet { vehicle, points } => write!(
                f,
                "vehicle {vehicle}: points whose rays do not meet, which get no coordinates: {points}"
            ),
            InitialWarning::DepthOpen { vehicle, points, of } => write!(
                f,
                "vehicle {vehicle}: the rays to {points} of its {of} points leave their depth open: it hardly turns under the camera, and its shape is not determined along the line of sight"
            ),
            InitialWarning::MarkerMissing { vehicle } => {
                write!(f, "vehicle {vehicle}: its marker has no coordinates; the track is that of the origin")
            }
            InitialWarning::TargetsLeftOut { targets } => write!(
                f,
                "targets whose rays are too nearly parallel to meet in a point, which are left out: {}",
                targets.join(", ")
            ),
        }
    }
}

impl Coded for InitialWarning {
    fn coded(&self) -> Code {
        match self {
            InitialWarning::Bridged { frames, targets, .. } => {
                Code::new("camera_poses_bridged").count(targets[1]).at(frames_named(*frames))
            }
            InitialWarning::MoreBridged { frames, .. } => {
                Code::new("more_camera_poses_bridged").count(*frames)
            }
            InitialWarning::TargetsScatter { factor } => {
                Code::new("targets_scatter").value(*factor).limit(1.0)
            }
            InitialWarning::HeadingGuessed { vehicle } => Code::new("heading_guessed").of_vehicle(vehicle),
            InitialWarning::BeyondBounds { vehicle, bound, turns, reached, limit, .. } => {
                let (_, _, shown) = motion_named(*bound, *turns);
                let code = match (bound, turns) {
                    (Bound::Rate, false) => "speed_beyond_bound",
                    (Bound::Rate, true) => "turn_beyond_bound",
                    (Bound::Acceleration, _) => "acceleration_beyond_bound",
                };
                Code::new(code).value(shown(*reached)).limit(shown(*limit)).of_vehicle(vehicle)
            }
            InitialWarning::VehicleLeftOut { vehicle, reason } => reason.coded().of_vehicle(vehicle),
            InitialWarning::SeenOnce { vehicle, points } => {
                Code::new("points_seen_once").count(*points).of_vehicle(vehicle)
            }
            InitialWarning::RaysDoNotMeet { vehicle, points } => {
                Code::new("rays_do_not_meet").count(*points).of_vehicle(vehicle)
            }
            InitialWarning::DepthOpen { vehicle, points, .. } => {
                Code::new("depth_open").count(*points).of_vehicle(vehicle)
            }
            InitialWarning::MarkerMissing { vehicle } => Code::new("marker_missing").of_vehicle(vehicle),
            InitialWarning::TargetsLeftOut { targets } => {
                let code = Code::new("targets_left_out").count(targets.len());
                code.at(format!("targets {}", targets.join(", ")))
            }
        }
    }
}
