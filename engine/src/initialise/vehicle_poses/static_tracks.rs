//! Tracks that stay where they are while the body drives on.
//!
//! A tracker that loses a point of a vehicle often goes on with the road below it. Such tracks are as rigid a
//! body as the vehicle, and of two rigid bodies the larger one would be taken for it, the road where it has
//! most of the tracks. What tells them apart is that a vehicle moves in the world. A track is held against all
//! others in the same frames, by the shift of its feet from the first half of these frames to the second, a
//! median against a median, so that gross errors in less than half of the frames do no harm: it is left behind
//! where it stays and at least a third of the others make one shift. Where a vehicle stands, all of its tracks
//! stay and none is left behind.

use super::forward::Foot;
use crate::rules::rules;
use crate::stats::quantile::upper_median;
use nalgebra::Vector2;

rules! {
    /// Tracks that stay on the ground while a body drives on.
    pub struct StaticTrackRules {
        /// What shifts less may be said to stay.
        most_static_shift_m: f64 = 1.0, "m";
        /// It stays if it shifts less than this.
        most_static_share: f64 = 0.25, "share of the shift of others";
        /// Shifts are alike that differ by less.
        alike_within_share: f64 = 0.5, "share of their median";
        /// Fewest tracks that drive on.
        least_driving_tracks: usize = 3, "tracks";
        /// Their least share.
        least_driving_share: f64 = 1.0 / 3.0, "share of tracks in the same frames";
        /// Fewest frames of a track that say anything, and of another one in these.
        least_frames: usize = 8, "frames";
    }
}

const RULES: StaticTrackRules = StaticTrackRules::DEFAULT;

/// For each point whether its track is left behind. `feet` are sorted by frame.
pub fn static_tracks(feet: &[Foot], frames: usize, points: usize) -> Vec<bool> {
    let mut tracks: Vec<Vec<(usize, Vector2<f64>)>> = vec![Vec::new(); points];
    feet.iter().for_each(|foot| tracks[foot.point].push((foot.frame, foot.place_m)));
    let own: Vec<Option<Vector2<f64>>> = tracks.iter().map(|track| shift_m(track, |_| true)).collect();
    let drives =
        |own: &Option<Vector2<f64>>| own.is_some_and(|shift| shift.norm() >= RULES.most_static_shift_m);
    let mut is_left = vec![false; points];
    if own.iter().filter(|own| drives(own)).count() < RULES.least_driving_tracks {
        return is_left;
    }
    let mut is_seen = vec![false; frames];
    for point in 0..points {
        let Some(own) = own[point].filter(|shift| shift.norm() < RULES.most_static_shift_m) else { continue };
        is_seen.fill(false);
        tracks[point].iter().for_each(|(frame, _)| is_seen[*frame] = true);
        let others = tracks.iter().enumerate().filter(|(other, _)| *other != point);
        let shifts: Vec<Vector2<f64>> =
            others.filter_map(|(_, track)| shift_m(track, |frame| is_seen[frame])).collect();
        let driving: Vec<Vector2<f64>> =
            shifts.iter().copied().filter(|shift| shift.norm() >= RULES.most_static_shift_m).collect();
        let needed =
            RULES.least_driving_tracks.max((RULES.least_driving_share * shifts.len() as f64).ceil() as usize);
        if driving.len() < needed {
            continue;
        }
        let common = middle(driving.clone());
        let alike = driving
            .iter()
            .filter(|shift| (**shift - common).norm() < RULES.alike_within_share * common.norm())
            .count();
        is_left[point] = alike >= needed && own.norm() < RULES.most_static_share * common.norm();
    }
    is_left
}

/// Median of the second half of those feet of a track that are wanted minus that of the first half.
fn shift_m(track: &[(usize, Vector2<f64>)], is_wanted: impl Fn(usize) -> bool) -> Option<Vector2<f64>> {
    let wanted: Vec<Vector2<f64>> =
        track.iter().filter(|(frame, _)| is_wanted(*frame)).map(|(_, place)| *place).collect();
    let (first, second) = wanted.split_at(wanted.len() / 2);
    (wanted.len() >= RULES.least_frames).then(|| middle(second.to_vec()) - middle(first.to_vec()))
}

/// The median of each coordinate.
fn middle(places: Vec<Vector2<f64>>) -> Vector2<f64> {
    let median = |axis: usize| upper_median(places.iter().map(|place| place[axis]).collect()).unwrap_or(0.0);
    Vector2::new(median(0), median(1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// Feet of 30 points over 60 frames at 10 m/s, of which the first stay; every so many-th foot is gross.
    fn feet(staying: usize, speed_mps: f64, gross: f64) -> Vec<Foot> {
        let mut rng = ChaCha8Rng::seed_from_u64(9);
        let mut feet = Vec::new();
        for frame in 0..60 {
            for point in 0..30 {
                let along_m = if point < staying { 2.0 } else { speed_mps * frame as f64 / 30.0 };
                let mut place_m = Vector2::new(along_m, 0.1 * point as f64);
                if rng.random::<f64>() < gross {
                    place_m += Vector2::new(rng.random_range(-4.0..4.0), rng.random_range(-4.0..4.0));
                }
                let (by_height, sigma_m, clearance_m) = (Vector2::zeros(), 0.02, 60.0);
                feet.push(Foot { frame, point, place_m, by_height, sigma_m, clearance_m });
            }
        }
        feet
    }

    #[test]
    fn tracks_on_the_road_are_told_from_those_that_drive_on_also_where_they_are_more() {
        for (staying, gross) in [(0, 0.4), (3, 0.0), (15, 0.0), (18, 0.3)] {
            let found = static_tracks(&feet(staying, 10.0, gross), 60, 30);
            let wanted: Vec<bool> = (0..30).map(|point| point < staying).collect();
            assert_eq!(found, wanted, "{staying} of 30 stay");
        }
    }

    #[test]
    fn a_vehicle_that_stands_is_left_whole() {
        assert_eq!(static_tracks(&feet(0, 0.0, 0.3), 60, 30), [false; 30]);
        // Two tracks that drive on are not the vehicle.
        assert_eq!(static_tracks(&feet(28, 10.0, 0.0), 60, 30), [false; 30]);
        assert!(static_tracks(&[], 60, 30).iter().all(|left| !left));
    }
}
