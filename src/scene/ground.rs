//! The ground around everything that stands on it.

use crate::estimate::Estimate;
use crate::problem::Problem;
use nalgebra::Point3;
use trackbundle_viz as viz;

/// Between lines \[m\], unless there would be too many of them.
const STEP_M: f64 = 5.0;
const MOST_STEPS: f64 = 80.0;
/// A lost point must not make a lattice as wide as its error \[m\].
const WIDEST_M: f64 = 2000.0;

/// The terrain below tracks and targets; nothing without a terrain.
pub fn ground(problem: &Problem, estimate: &Estimate) -> viz::Ground {
    let Some(ground) = &problem.ground else { return viz::Ground::default() };
    let standing = estimate.vehicles.iter().filter(|vehicle| vehicle.left_out.is_none());
    let poses = standing.flat_map(|vehicle| vehicle.poses.iter().flatten());
    let places: Vec<Point3<f64>> = poses
        .map(|pose| pose.translation.vector.into())
        .chain(estimate.targets.iter().flatten().copied())
        .collect();
    let height_m = |x: f64, y: f64| ground.terrain.at(x, y).ok().map(|found| found.height_m);
    lattice(&places, height_m)
}

fn lattice(places: &[Point3<f64>], height_m: impl Fn(f64, f64) -> Option<f64>) -> viz::Ground {
    let spans = [0, 1].map(|axis| {
        let values = places.iter().map(|place| place[axis]).filter(|value| value.is_finite());
        let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        (low, high.min(low + WIDEST_M))
    });
    if spans.iter().any(|(low, high)| low > high) {
        return viz::Ground::default();
    }
    let widest = spans.iter().map(|(low, high)| high - low).fold(0.0, f64::max);
    let mut step_m = STEP_M;
    while widest / step_m > MOST_STEPS {
        step_m *= 2.0;
    }
    let lines_m = spans.map(|(low, high)| {
        let (first, last) = ((low / step_m).floor() - 1.0, (high / step_m).ceil() + 1.0);
        (0..=(last - first) as usize).map(|i| (first + i as f64) * step_m).collect::<Vec<f64>>()
    });
    let heights_m = lines_m[1].iter().flat_map(|y| lines_m[0].iter().map(|x| height_m(*x, *y))).collect();
    viz::Ground { lines_m, heights_m }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lattice_surrounds_what_stands_there_and_stays_small() {
        let places = [Point3::new(1.0, 12.0, 0.0), Point3::new(9.0, 13.0, 0.0)];
        let found = lattice(&places, |x, y| (x < 14.0).then_some(x + 100.0 * y));
        assert_eq!(found.lines_m, [vec![-5.0, 0.0, 5.0, 10.0, 15.0], vec![5.0, 10.0, 15.0, 20.0]]);
        assert_eq!(
            found.heights_m[..6],
            [Some(495.0), Some(500.0), Some(505.0), Some(510.0), None, Some(995.0)]
        );
        let far = [Point3::new(0.0, 0.0, 0.0), Point3::new(1e9, 1.0, 0.0)];
        let found = lattice(&far, |_, _| Some(0.0));
        assert!(found.heights_m.len() < 1000, "{}", found.heights_m.len());
        assert!(*found.lines_m[0].last().unwrap() < 2100.0);
        assert_eq!(lattice(&[], |_, _| Some(0.0)), viz::Ground::default());
    }
}
