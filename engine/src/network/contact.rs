//! Contact of vehicles with the ground: height and tilt over the terrain, correlated in time.

use super::blocks::Blocks;
use super::sink::Sink;
use super::source::Source;
use super::warnings::NetworkWarning;
use crate::estimate::Estimate;
use crate::geometry::Pose;
use crate::problem::{GroundKnowledge, Problem};
use crate::residuals::ground_contact::{FirstContact, NextContact};
use crate::terrain::{NoGround, Terrain};
use trackbundle_solver::system::{BlockId, GroupId, Measurement};

/// Least standard deviations of the contact with the ground \[m, rad\]: nothing stands exactly.
const LEAST_CONTACT_SIGMA: (f64, f64) = (1e-4, 1e-5);
/// Rows of a contact.
pub const CONTACT_ROWS: usize = 3;
/// How far around a pose there must be ground for it to be tied to it \[m\].
const GROUND_AROUND_M: f64 = 1.0;

/// Adds the contacts; returns what a shift of the ground by one standard deviation does to the first row of each,
/// whitened: of first and of next contacts.
pub fn add_contacts(
    sink: &mut impl Sink,
    problem: &Problem,
    ground: &GroundKnowledge,
    current: &Estimate,
    blocks: &Blocks,
    warnings: &mut Vec<NetworkWarning>,
) -> Vec<(GroupId, Vec<f64>)> {
    let (least_m, least_rad) = LEAST_CONTACT_SIGMA;
    let tilt = ground.tilt_sigma_rad.max(least_rad);
    let sigma = [ground.sigma_m.max(least_m), tilt, tilt];
    // What noise of a grid adds to them.
    let noise = ground.terrain.footing_noise();
    let added = noise.map_or([0.0; 3], |noise| [noise.height_m, noise.slope, noise.slope]);
    let (mut first, mut next) = (Vec::new(), Vec::new());
    let mut shifts = [Vec::new(), Vec::new()];
    for (at, vehicle) in blocks.vehicles.iter().enumerate() {
        let mut before: Option<(usize, BlockId)> = None;
        let mut without_ground = Vec::new();
        for (frame, pose) in vehicle.poses.iter().enumerate() {
            let (Some(pose), Some(place)) = (*pose, &current.vehicles[at].poses[frame]) else { continue };
            if let Err(reason) = ground_around(&ground.terrain, place) {
                without_ground.push((frame, reason));
                continue;
            }
            match before {
                None => {
                    let residual = FirstContact { terrain: ground.terrain.clone() };
                    let seen = [pose, blocks.bias];
                    if sink.decides(&seen) {
                        let sigma: [f64; CONTACT_ROWS] =
                            std::array::from_fn(|row| sigma[row].hypot(added[row]));
                        shifts[0].push(ground.sigma_m / sigma[0]);
                        first.push(Measurement { residual, blocks: seen, sigma });
                    }
                }
                Some((frame_before, pose_before)) => {
                    let moved = &current.vehicles[at].poses[frame_before];
                    let apart_m = moved.map_or(0.0, |before| {
                        (place.translation.vector - before.translation.vector).xy().norm()
                    });
                    let step_s = problem.frames[frame].time_s - problem.frames[frame_before].time_s;
                    let (residual, innovation) =
                        NextContact::after(ground.terrain.clone(), step_s, ground.correlation_s);
                    // Of the noise at both places, as far as it differs.
                    let (c, alike) = (residual.correlation, noise.map_or(1.0, |n| n.correlation(apart_m)));
                    let left = (1.0 + c * c - 2.0 * c * alike).sqrt();
                    let sigma: [f64; CONTACT_ROWS] =
                        std::array::from_fn(|row| (sigma[row] * innovation).hypot(added[row] * left));
                    let seen = [pose, pose_before, blocks.bias];
                    if sink.decides(&seen) {
                        shifts[1].push((1.0 - residual.correlation) * ground.sigma_m / sigma[0]);
                        next.push(Measurement { residual, blocks: seen, sigma });
                    }
                }
            }
            before = Some((frame, pose));
        }
        if let Some((first, reason)) = without_ground.first() {
            warnings.push(NetworkWarning::WithoutGround {
                vehicle: problem.vehicles[at].id.clone(),
                poses: without_ground.len(),
                frame: problem.frames[*first].number,
                reason: *reason,
            });
        }
    }
    let [of_first, of_next] = shifts;
    vec![
        (sink.squares(Source::Terrain, "first contact with the ground", first), of_first),
        (sink.squares(Source::Terrain, "next contact with the ground", next), of_next),
    ]
}

/// Whether there is ground below a pose, and as far around it as it is likely to move: beyond, a
/// contact would have no residual, and the step that leads there would be refused.
fn ground_around(terrain: &Terrain, pose: &Pose) -> Result<(), NoGround> {
    let r = GROUND_AROUND_M;
    for [dx, dy] in [[0.0, 0.0], [r, 0.0], [-r, 0.0], [0.0, r], [0.0, -r]] {
        terrain.at(pose.translation.x + dx, pose.translation.y + dy)?;
    }
    Ok(())
}
