//! Contact of vehicles with the ground: height and tilt over the terrain, correlated in time.

use super::blocks::Blocks;
use super::motion::Counted;
use super::sink::Sink;
use super::source::Source;
use super::warnings::NetworkWarning;
use crate::estimate::Estimate;
use crate::geometry::Pose;
use crate::problem::{GroundKnowledge, Problem};
use crate::residuals::ground_contact::{FirstContact, NextContact};
use crate::residuals::scale_free::{Counting, ScaleFree, ScaleFreeSeen, WithPoint};
use crate::terrain::{NoGround, Terrain};
use trackbundle_solver::residual::Residual;
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
    (ground, current): (&GroundKnowledge, &Estimate),
    blocks: &Blocks,
    (counted, is_seen): (&[Vec<Option<Counted>>], &[Vec<bool>]),
    warnings: &mut Vec<NetworkWarning>,
) -> Vec<(GroupId, Vec<f64>)> {
    let (least_m, least_rad) = LEAST_CONTACT_SIGMA;
    let tilt = ground.tilt_sigma_rad.max(least_rad);
    let sigma = [ground.sigma_m.max(least_m), tilt, tilt];
    // What noise of a grid adds to them.
    let noise = ground.terrain.footing_noise();
    let added = noise.map_or([0.0; 3], |noise| [noise.height_m, noise.slope, noise.slope]);
    let (mut first, mut next) = (Contacts::default(), Contacts::default());
    let mut shifts = [Vec::new(), Vec::new()];
    for (at, vehicle) in blocks.vehicles.iter().enumerate() {
        let mut before: Option<(usize, BlockId)> = None;
        let mut without_ground = Vec::new();
        for (frame, pose) in vehicle.poses.iter().enumerate() {
            let (Some(pose), Some(place), Some(counted)) =
                (*pose, &current.vehicles[at].poses[frame], counted[at][frame])
            else {
                continue;
            };
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
                        first.add(
                            residual,
                            counted,
                            &|point| [pose, blocks.bias, point],
                            &|point, camera| [pose, blocks.bias, point, camera],
                            (sigma, is_seen[at][frame]),
                        );
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
                        next.add(
                            residual,
                            counted,
                            &|point| [pose, pose_before, blocks.bias, point],
                            &|point, camera| [pose, pose_before, blocks.bias, point, camera],
                            (sigma, is_seen[at][frame]),
                        );
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
        (first.into_group(sink, "first contact with the ground"), of_first),
        (next.into_group(sink, "next contact with the ground"), of_next),
    ]
}

/// Contacts, their heights counted in distances from the camera: where that is held, or from its pose. How far
/// a vehicle goes up and down must not say how far away it is. All are counted alike.
struct Contacts<R, const P: usize, const L: usize> {
    from_place: Vec<Measurement<ScaleFree<WithPoint<R>>, CONTACT_ROWS, P>>,
    from_camera: Vec<Measurement<ScaleFreeSeen<WithPoint<R>>, CONTACT_ROWS, L>>,
}

impl<R, const P: usize, const L: usize> Default for Contacts<R, P, L> {
    fn default() -> Self {
        Contacts { from_place: Vec::new(), from_camera: Vec::new() }
    }
}

impl<R: Send + Sync + 'static, const P: usize, const L: usize> Contacts<R, P, L>
where
    WithPoint<R>: Residual<CONTACT_ROWS, P>,
    ScaleFreeSeen<WithPoint<R>>: Residual<CONTACT_ROWS, L>,
{
    fn add(
        &mut self,
        residual: R,
        counted: Counted,
        with_point: &dyn Fn(BlockId) -> [BlockId; P],
        with_camera: &dyn Fn(BlockId, BlockId) -> [BlockId; L],
        (sigma, is_seen): ([f64; CONTACT_ROWS], bool),
    ) {
        let of = WithPoint(residual);
        // Where nobody sees a vehicle it would go off, so that its height counted less.
        let rows = if is_seen { 1 } else { 0 };
        let counting = |distance_m| Counting { rows, pose: 0, distance_m };
        match counted {
            Counted::FromCamera { point, camera, distance_m } => {
                let residual = ScaleFreeSeen { of, counting: counting(distance_m) };
                self.from_camera.push(Measurement { residual, blocks: with_camera(point, camera), sigma });
            }
            Counted::FromPlace { point, camera, distance_m } => {
                let residual = ScaleFree { of, counting: counting(distance_m), camera };
                self.from_place.push(Measurement { residual, blocks: with_point(point), sigma });
            }
            Counted::Metres | Counted::FromVehicle { .. } => {
                unreachable!("a vehicle is counted from the camera")
            }
        }
    }

    fn into_group(self, sink: &mut impl Sink, name: &'static str) -> GroupId {
        match self.from_camera.is_empty() {
            true => sink.squares(Source::Terrain, name, self.from_place),
            false => sink.squares(Source::Terrain, name, self.from_camera),
        }
    }
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
