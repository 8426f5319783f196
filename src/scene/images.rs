//! Image points and what became of them.

use crate::files::{ResultResidual, ResultResiduals};
use crate::problem::{Problem, Role};
use crate::refine::{Fits, ImagePointVerdict, ObservationFit, RejectionReason};
use nalgebra::Vector2;
use trackbundle_viz as viz;

/// The residuals of an adjustment as they are read back from its folder.
pub fn residuals(problem: &Problem, fits: &Fits) -> ResultResiduals {
    let one = |frame, target, image_px, fit: &Option<ObservationFit>, verdict: &ImagePointVerdict| {
        fit.map(|fit| ResultResidual {
            frame,
            target,
            image_px,
            residual_px: fit.residual_px,
            weight: fit.weight,
            reason: verdict.reason().map(|reason| reason.name().to_owned()),
        })
    };
    let vehicles = problem.vehicles.iter().zip(&fits.vehicles).zip(&fits.verdicts.vehicles);
    let targets = problem.target_observations.iter().zip(&fits.targets).zip(&fits.verdicts.targets);
    ResultResiduals {
        vehicles: vehicles
            .map(|((vehicle, fits), verdicts)| {
                let all = vehicle.observations.iter().zip(fits).zip(verdicts);
                all.map(|((o, fit), verdict)| one(o.frame, None, o.image_px, fit, verdict)).collect()
            })
            .collect(),
        targets: targets
            .map(|((o, fit), verdict)| one(o.frame, Some(o.target), o.image_px, fit, verdict))
            .collect(),
    }
}

/// A reason as it stands beside an image point.
fn told(reason: RejectionReason) -> &'static str {
    match reason {
        RejectionReason::ImagePoint => "rejected alone",
        RejectionReason::Track => "rejected with its whole track",
        RejectionReason::Static => "of the static world",
        RejectionReason::Sliding => "slides over the body",
        RejectionReason::Swapped => "gone over to another point",
        RejectionReason::Foreign => "of something else that moves",
        RejectionReason::Frame => "rejected with its whole frame",
        RejectionReason::BehindCamera => "behind the camera",
        RejectionReason::NoCoordinates => "without coordinates",
        RejectionReason::CheckPoint => "check point",
    }
}

/// How an image point is marked, and why it was rejected, if it was.
fn marking(residual: Option<&ResultResidual>, role: Role) -> (viz::Marking, Option<&'static str>) {
    let Some(residual) = residual else { return (viz::Marking::NotUsed, None) };
    match residual.reason.as_deref().map(RejectionReason::of_name) {
        Some(Some(reason)) if reason.is_gross() => (viz::Marking::Rejected, Some(told(reason))),
        Some(Some(_)) => (viz::Marking::NotUsed, None),
        _ if role == Role::Check => (viz::Marking::NotUsed, None),
        None if residual.is_accepted() => (viz::Marking::Good, None),
        // An older version did not say why, a newer one may have other reasons.
        None | Some(None) => (viz::Marking::Rejected, Some("rejected")),
    }
}

/// The image points of each frame, with what became of them where that is known.
pub fn image_points(problem: &Problem, residuals: Option<&ResultResiduals>) -> Vec<Vec<viz::ImagePoint>> {
    let mut frames = vec![Vec::new(); problem.frames.len()];
    let point = |kind, role, observed_px: Vector2<f64>, residual: Option<&ResultResidual>| {
        let (marking, reason) = marking(residual, role);
        viz::ImagePoint {
            kind,
            observed_px: observed_px.into(),
            computed_px: residual.map(|residual| (observed_px - residual.residual_px).into()),
            marking,
            reason,
        }
    };
    for (vehicle, found) in problem.vehicles.iter().enumerate() {
        for (at, o) in found.observations.iter().enumerate() {
            let residual = residuals.and_then(|all| all.vehicles[vehicle][at].as_ref());
            frames[o.frame].push(point(viz::ImagePointKind::Body, Role::Control, o.image_px, residual));
        }
    }
    for (at, o) in problem.target_observations.iter().enumerate() {
        let residual = residuals.and_then(|all| all.targets[at].as_ref());
        let role = problem.targets[o.target].role;
        frames[o.frame].push(point(viz::ImagePointKind::Target, role, o.image_px, residual));
    }
    frames
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_image_point_is_marked_as_it_was_judged() {
        let residual = |weight: f64, reason: Option<&str>| ResultResidual {
            frame: 0,
            target: None,
            image_px: Vector2::zeros(),
            residual_px: Vector2::zeros(),
            weight,
            reason: reason.map(str::to_owned),
        };
        let marked = |weight, reason, role| marking(Some(&residual(weight, reason)), role);
        let (control, check) = (Role::Control, Role::Check);
        let rejected = |why| (viz::Marking::Rejected, Some(why));
        assert_eq!(marked(0.4, None, control), (viz::Marking::Good, None));
        assert_eq!(marked(0.0, Some("track"), control), rejected("rejected with its whole track"));
        // A loss that lets nothing go leaves a gross error its weight.
        assert_eq!(marked(0.4, Some("image_point"), control), rejected("rejected alone"));
        for not_used in
            [marked(0.0, Some("check_point"), check), marked(0.0, None, check), marking(None, control)]
        {
            assert_eq!(not_used, (viz::Marking::NotUsed, None));
        }
        // Of another version.
        assert_eq!(marked(0.0, None, control), rejected("rejected"));
        assert_eq!(marked(0.0, Some("whim"), control), rejected("rejected"));
    }
}
