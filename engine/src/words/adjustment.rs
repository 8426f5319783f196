//! What an adjustment says, and why there is none.

use super::{Code, Coded};
use crate::network::{CameraGap, NetworkWarning, ScaleGap};
use crate::refine::{AdjustmentWarning, NoSolution};
use std::fmt;

impl fmt::Display for CameraGap {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            CameraGap::Held { positions, attitudes, targets_needed } => {
                let held = match (positions, attitudes) {
                    (true, false) => "camera positions",
                    (false, true) => "camera attitudes",
                    _ => "camera poses",
                };
                write!(
                    f,
                    "{held} are held as given: there is neither a sigma (noise.camera_position_m, \
                     noise.camera_rotation_deg) nor {targets_needed} control targets in most frames"
                )
            }
            CameraGap::Adrift => write!(
                f,
                "most frames see fewer than three surveyed control targets: errors of the starting camera poses that \
                 last for many frames stay in the cameras and in the tracks"
            ),
        }
    }
}

impl fmt::Display for ScaleGap {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            ScaleGap::NoTerrain => {
                "a height is known, but without a terrain there is no ground to count it from"
            }
            ScaleGap::NoHeight => "the terrain is known, but no height above it",
            ScaleGap::Nothing => "neither a terrain, nor a height, nor a size is known",
        })
    }
}

impl fmt::Display for NetworkWarning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            NetworkWarning::Cameras(gap) => gap.fmt(f),
            NetworkWarning::Scale { vehicle, gap } => write!(
                f,
                "scale of {vehicle}: held only by the starting poses ({gap}); size, height and track are wrong by one common share"
            ),
            NetworkWarning::WithoutGround { vehicle, poses, frame, reason } => write!(
                f,
                "vehicle {vehicle}: poses without ground below them, which no terrain ties: {poses}, the first in frame {frame} \
                 ({reason})"
            ),
            NetworkWarning::ReceiverWithoutPlace { receiver } => {
                write!(f, "GNSS positions of {receiver}: not used, its point has no place")
            }
            NetworkWarning::PositionsRejected { receiver, rejected, used } => {
                write!(f, "GNSS positions of {receiver}: {rejected} rejected, {used} used")
            }
            NetworkWarning::NoPositionInTime { receiver } => write!(
                f,
                "GNSS positions of {receiver}: none falls into the time in which the vehicle is seen"
            ),
        }
    }
}

impl Coded for NetworkWarning {
    fn coded(&self) -> Code {
        let of_receiver =
            |code: &'static str, receiver: &str| Code::new(code).at(format!("receiver {receiver}"));
        match self {
            NetworkWarning::Cameras(CameraGap::Held { .. }) => Code::new("cameras_held_as_given"),
            NetworkWarning::Cameras(CameraGap::Adrift) => Code::new("cameras_adrift"),
            NetworkWarning::Scale { vehicle, .. } => Code::new("scale_by_starting_poses").of_vehicle(vehicle),
            NetworkWarning::WithoutGround { vehicle, poses, .. } => {
                Code::new("poses_without_ground").count(*poses).of_vehicle(vehicle)
            }
            NetworkWarning::ReceiverWithoutPlace { receiver } => {
                of_receiver("receiver_without_place", receiver)
            }
            NetworkWarning::PositionsRejected { receiver, rejected, .. } => {
                of_receiver("gnss_positions_rejected", receiver).count(*rejected)
            }
            NetworkWarning::NoPositionInTime { receiver } => {
                of_receiver("no_gnss_position_in_time", receiver)
            }
        }
    }
}

impl fmt::Display for AdjustmentWarning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            AdjustmentWarning::Network(warning) => warning.fmt(f),
            AdjustmentWarning::NoLeastSquares => write!(
                f,
                "the final least squares on accepted image points could not be solved: the result is that of the \
                 robust adjustment, without standard deviations"
            ),
            AdjustmentWarning::NotConverged { stop } => {
                write!(f, "the adjustment has not converged: {stop}")
            }
            AdjustmentWarning::BehindCamera { image_points } => {
                write!(f, "{image_points} image points belong to points behind the camera")
            }
            AdjustmentWarning::ContactsLost { contacts } => write!(
                f,
                "contacts with the ground that were lost, because a pose left the terrain grid: {contacts}"
            ),
            AdjustmentWarning::VehiclesScatter { factor, .. } => {
                write!(f, "image points of vehicles scatter {factor:.1} times as much as their sigmas say")
            }
            AdjustmentWarning::PointsRejected { vehicle, points } => write!(
                f,
                "vehicle {vehicle}: points whose image points are gross errors but for one at most, which get no coordinates: {}",
                points.join(", ")
            ),
        }
    }
}

impl Coded for AdjustmentWarning {
    fn coded(&self) -> Code {
        match self {
            AdjustmentWarning::Network(warning) => warning.coded(),
            AdjustmentWarning::NoLeastSquares => Code::new("no_least_squares"),
            AdjustmentWarning::NotConverged { .. } => Code::new("not_converged"),
            AdjustmentWarning::BehindCamera { image_points } => {
                Code::new("behind_camera").count(*image_points)
            }
            AdjustmentWarning::ContactsLost { contacts } => {
                Code::new("ground_contacts_lost").count(*contacts)
            }
            AdjustmentWarning::VehiclesScatter { factor, limit } => {
                Code::new("vehicle_images_scatter").value(*factor).limit(*limit)
            }
            AdjustmentWarning::PointsRejected { vehicle, points } => {
                Code::new("points_rejected").count(points.len()).of_vehicle(vehicle)
            }
        }
    }
}

impl fmt::Display for NoSolution {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            NoSolution::NoVehicle { left_out } => {
                let reasons: Vec<String> =
                    left_out.iter().map(|(vehicle, why)| format!("vehicle {vehicle}: {why}")).collect();
                write!(f, "no vehicle can be adjusted; {}", reasons.join("; "))
            }
            NoSolution::NotFinite => {
                write!(f, "the adjustment does not end in finite numbers: is a value out of all proportion?")
            }
            NoSolution::NothingFits => write!(
                f,
                "no image point of a vehicle fits: is the camera's pose, or its axes, another convention?"
            ),
            NoSolution::NothingToAdjust => write!(
                f,
                "nothing is left to adjust: all poses are exact, and no point of a vehicle gets coordinates from its rays \
                 (are lengths in metres? are the camera's axes another convention?)"
            ),
            NoSolution::TooLarge(error) => error.fmt(f),
            NoSolution::Singular(error) => error.fmt(f),
        }
    }
}

impl Coded for NoSolution {
    fn coded(&self) -> Code {
        match self {
            NoSolution::NoVehicle { .. } => Code::new("no_vehicle"),
            NoSolution::NotFinite => Code::new("not_finite"),
            NoSolution::NothingFits => Code::new("nothing_fits"),
            NoSolution::NothingToAdjust => Code::new("nothing_to_adjust"),
            NoSolution::TooLarge(_) => Code::new("too_large"),
            NoSolution::Singular(_) => Code::new("singular"),
        }
    }
}

impl std::error::Error for NoSolution {}
