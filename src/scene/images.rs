//! Image points and what became of them.

use crate::problem::{Problem, Role};
use crate::refine::{ImagePointVerdict, ObservationFit, RejectionReason};
use nalgebra::Vector2;
use trackbundle_viz as viz;

/// What became of an image point.
#[derive(Clone, Copy, Debug, Default)]
pub struct Judged {
    /// Observed minus computed \[px\].
    pub residual_px: Option<Vector2<f64>>,
    /// Whether it took part.
    pub took_part: bool,
    /// Why it was rejected, if it was.
    pub rejected: Option<&'static str>,
}

impl Judged {
    /// By how it fits.
    pub fn by(fit: &Option<ObservationFit>, verdict: ImagePointVerdict) -> Self {
        Judged {
            residual_px: fit.map(|fit| fit.residual_px),
            took_part: matches!(verdict, ImagePointVerdict::Used | ImagePointVerdict::DownWeighted),
            rejected: match verdict {
                ImagePointVerdict::Rejected(reason) if reason.is_gross() => Some(told(reason)),
                _ => None,
            },
        }
    }
}

/// A reason as it stands beside an image point.
pub fn told(reason: RejectionReason) -> &'static str {
    match reason {
        RejectionReason::ImagePoint => "rejected alone",
        RejectionReason::Track => "rejected with its whole track",
        RejectionReason::Frame => "rejected with its whole frame",
        RejectionReason::BehindCamera => "behind the camera",
        RejectionReason::NoCoordinates => "without coordinates",
        RejectionReason::CheckPoint => "check point",
    }
}

/// The image points of each frame, judged one by one: of a vehicle, by its index and that of the observation, and
/// of targets.
pub fn image_points(
    problem: &Problem,
    of_vehicle: impl Fn(usize, usize) -> Judged,
    of_target: impl Fn(usize) -> Judged,
) -> Vec<Vec<viz::ImagePoint>> {
    let mut frames = vec![Vec::new(); problem.frames.len()];
    let point = |kind, observed_px: Vector2<f64>, judged: Judged| viz::ImagePoint {
        kind,
        observed_px: observed_px.into(),
        computed_px: judged.residual_px.map(|residual_px| (observed_px - residual_px).into()),
        marking: match judged {
            Judged { rejected: Some(_), .. } => viz::Marking::Rejected,
            Judged { took_part: true, .. } => viz::Marking::Good,
            _ => viz::Marking::NotUsed,
        },
        reason: judged.rejected,
    };
    for (vehicle, found) in problem.vehicles.iter().enumerate() {
        for (at, o) in found.observations.iter().enumerate() {
            frames[o.frame].push(point(viz::ImagePointKind::Body, o.image_px, of_vehicle(vehicle, at)));
        }
    }
    for (at, o) in problem.target_observations.iter().enumerate() {
        let mut judged = of_target(at);
        judged.took_part &= problem.targets[o.target].role == Role::Control;
        frames[o.frame].push(point(viz::ImagePointKind::Target, o.image_px, judged));
    }
    frames
}
