//! Contact of vehicles with the ground: height and tilt over the terrain, correlated in time.

use super::blocks::Blocks;
use super::motion::Counted;
use super::sink::Sink;
use super::source::Source;
use super::warnings::NetworkWarning;
use crate::estimate::{Estimate, VehicleEstimate};
use crate::geometry::Pose;
use crate::problem::{ContactRules, Frame, GroundKnowledge, Problem};
use crate::residuals::ground_contact::{FirstContact, NextContact};
use crate::residuals::scale_free::{Counting, ScaleFree, ScaleFreeSeen, WithPoint};
use crate::terrain::{NoGround, Terrain};
use nalgebra::Vector2;
use trackbundle_solver::residual::Residual;
use trackbundle_solver::system::{BlockId, GroupId, Measurement};

/// Least standard deviations of the contact with the ground \[m, rad\]: nothing stands exactly.
const LEAST_CONTACT_SIGMA: (f64, f64) = (1e-4, 1e-5);
const RULES: ContactRules = ContactRules::DEFAULT;
/// Rows of a contact.
pub const CONTACT_ROWS: usize = 3;
/// How far around a pose there must be ground for it to be tied to it \[m\].
const GROUND_AROUND_M: f64 = 1.0;
/// How far a vehicle goes is asked over times no shorter than this \[s\].
const STEP_OF_SPEED_S: f64 = 0.5;

/// How long errors of the contact of each vehicle last \[s\].
pub fn contacts_last_s(problem: &Problem, ground: &GroundKnowledge, current: &Estimate) -> Vec<f64> {
    let of = |vehicle: &VehicleEstimate| ground.lasts_s(mean_speed_m_s(&problem.frames, &vehicle.poses));
    current.vehicles.iter().map(of).collect()
}

/// Mean speed of a vehicle with these poses \[m/s\], zero with fewer than two: of steps of half a second or more, so
/// that errors of the poses count for little.
fn mean_speed_m_s(frames: &[Frame], poses: &[Option<Pose>]) -> f64 {
    let places = frames.iter().zip(poses).filter_map(|(frame, pose)| {
        let pose = pose.as_ref()?;
        Some((frame.time_s, pose.translation.vector.xy()))
    });
    let (mut way_m, mut time_s) = (0.0, 0.0);
    let mut before: Option<(f64, Vector2<f64>)> = None;
    for (now_s, place) in places {
        match before {
            Some((then_s, _)) if now_s - then_s < STEP_OF_SPEED_S => {}
            Some((then_s, then)) => {
                way_m += (place - then).norm();
                time_s += now_s - then_s;
                before = Some((now_s, place));
            }
            None => before = Some((now_s, place)),
        }
    }
    if time_s > 0.0 { way_m / time_s } else { 0.0 }
}

/// Adds the contacts; returns what a shift of the ground by one standard deviation does to the first row of each,
/// whitened: of first and of next contacts.
pub fn add_contacts(
    sink: &mut impl Sink,
    problem: &Problem,
    (ground, last_s): (&GroundKnowledge, &[f64]),
    current: &Estimate,
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
    // What is left of them, of that noise and of what is uneven under a vehicle, by the share of each.
    let whitened_by = |place: &Pose, [innovation, of_noise, of_uneven]: [f64; 3]| -> [f64; CONTACT_ROWS] {
        let [height_m, slope] =
            ground.terrain.unevenness_at(place.translation.x, place.translation.y, RULES.reach_m);
        let uneven = [height_m, slope, slope];
        std::array::from_fn(|row| {
            (sigma[row] * innovation).hypot(added[row] * of_noise).hypot(uneven[row] * of_uneven)
        })
    };
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
                        let sigma = whitened_by(place, [1.0; 3]);
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
                        NextContact::after(ground.terrain.clone(), step_s, last_s[at]);
                    let seen = [pose, pose_before, blocks.bias];
                    if sink.decides(&seen) {
                        // Of the noise at both places, and of what is uneven there, as far as it differs.
                        let c = residual.correlation;
                        let left = |alike: f64| (1.0 + c * c - 2.0 * c * alike).sqrt();
                        let of_noise = left(noise.map_or(1.0, |n| n.correlation(apart_m)));
                        let of_uneven = left((-apart_m / RULES.uneven_m).exp());
                        let sigma = whitened_by(place, [innovation, of_noise, of_uneven]);
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

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Translation3, UnitQuaternion};

    fn ground(correlation_s: Option<f64>) -> GroundKnowledge {
        let terrain = Terrain::Plane { z_m: 0.0 };
        GroundKnowledge { terrain, sigma_m: 0.02, correlation_s, bias_sigma_m: 0.0, tilt_sigma_rad: 0.05 }
    }

    /// Errors of the ground are errors of places: a slow vehicle keeps them longer. What is stated holds.
    #[test]
    fn a_contact_lasts_as_long_as_the_way_over_alike_ground() {
        let lasts_s = |stated: Option<f64>, speed_m_s: f64| ground(stated).lasts_s(speed_m_s);
        assert_eq!([20.0, 10.0, 2.0, 0.1, 0.0].map(|v| lasts_s(None, v)), [1.0, 1.0, 5.0, 10.0, 10.0]);
        assert_eq!([lasts_s(Some(0.0), 2.0), lasts_s(Some(3.0), 2.0)], [0.0, 3.0]);
    }

    /// Starting poses that scatter by 7 cm from frame to frame would be a way of 4 m a second.
    #[test]
    fn speed_is_hardly_that_of_the_scatter_of_poses() {
        let frame = |number: i64| Frame { number, time_s: number as f64 / 30.0 };
        let frames: Vec<Frame> = (0..300).map(frame).collect();
        let pose = |(at, frame): (usize, &Frame)| {
            let scatter = if at % 2 == 0 { 0.05 } else { -0.05 };
            let place = Vector2::new(2.0 * frame.time_s + scatter, scatter);
            let place = Translation3::new(place.x, place.y, 0.0);
            // Not seen for a while.
            (!(100..140).contains(&at)).then(|| Pose::from_parts(place, UnitQuaternion::identity()))
        };
        let poses: Vec<Option<Pose>> = frames.iter().enumerate().map(pose).collect();
        let speed = mean_speed_m_s(&frames, &poses);
        assert!((speed - 2.0).abs() < 0.2, "{speed}");
        assert_eq!(mean_speed_m_s(&frames[..1], &poses[..1]), 0.0);
        assert_eq!(mean_speed_m_s(&frames, &vec![None; 300]), 0.0);
    }
}
