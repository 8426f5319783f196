//! What a result is compared with, and where it is on the Earth.

use crate::evaluate::shape::ShapeComparison;
use crate::evaluate::track::Compared;
use crate::evaluate::{Evaluation, VehicleEvaluation};
use crate::problem::Problem;
use nalgebra::Point3;
use std::collections::HashMap;
use trackbundle_viz as viz;

/// Of a larger scan every so many points are drawn that no more are left than this.
const MOST_POINTS: usize = 100_000;

/// Adds the references to the bodies.
pub fn add_comparison(scene: &mut viz::Scene, problem: &Problem, evaluation: &Evaluation) {
    let index: HashMap<i64, usize> =
        problem.frames.iter().enumerate().map(|(at, frame)| (frame.number, at)).collect();
    for body in &mut scene.bodies {
        if let Some(found) = evaluation.vehicles.iter().find(|found| found.vehicle == body.id) {
            body.reference = places(found, &index);
        }
        let shape = evaluation.shapes.iter().find(|found| found.vehicle == body.id);
        body.scan = shape.map(|found| scan(found, &body.after.points_m));
    }
}

fn places(found: &VehicleEvaluation, index: &HashMap<i64, usize>) -> Vec<viz::ReferencePlace> {
    let place = |at: &Compared| {
        let course = at.heading_deg.zip(at.heading_difference_deg).map(|(own, less)| own - less);
        let [x, y, z] = at.reference_sigma_m;
        Some(viz::ReferencePlace {
            frame: *index.get(&at.frame)?,
            position_m: at.reference.coords.into(),
            sigma_m: (|| Some([x?, y?, z?]))(),
            difference_m: at.difference_m.into(),
            speed_mps: at.reference_speed_mps,
            // In the same turn as the heading of the result, so that curves lie on each other.
            course_deg: course,
        })
    };
    found.track.compared.iter().filter_map(place).collect()
}

/// The scan in the frame of the vehicle.
fn scan(found: &ShapeComparison, points_m: &[[f64; 3]]) -> viz::Scan {
    let vehicle_from_scan = found.registered.scan_from_vehicle.inverse();
    let step = found.scan.len().div_ceil(MOST_POINTS).max(1);
    let drawn = || found.scan.iter().zip(&found.from_scan_m).step_by(step);
    let bits = |place: [f64; 3]| place.map(f64::to_bits);
    let distances: HashMap<[u64; 3], f64> =
        found.points.iter().map(|point| (bits(point.position.coords.into()), point.nearest_m)).collect();
    viz::Scan {
        points_m: drawn().map(|(point, _)| (vehicle_from_scan * point).coords.into()).collect(),
        distances_m: drawn().map(|(_, distance)| *distance).collect(),
        shape_distances_m: points_m.iter().map(|place| distances.get(&bits(*place)).copied()).collect(),
    }
}

/// Adds latitudes and longitudes \[deg\] of what is drawn, where the world has them.
pub fn add_map(scene: &mut viz::Scene, geodetic_deg: impl Fn(Point3<f64>) -> Option<viz::Geodetic>) {
    let line = |places: &mut dyn Iterator<Item = [f64; 3]>| -> Vec<viz::Geodetic> {
        places.filter_map(|place| geodetic_deg(place.into())).collect()
    };
    let track = |state: &viz::State| line(&mut state.track.iter().map(|place| place.position_m));
    let target = |target: &viz::Target| Some((target.role, geodetic_deg(target.position_m.into())?));
    let map = viz::Map {
        camera_deg: line(&mut scene.camera.after.iter().map(|pose| pose.position_m)),
        targets_deg: scene.targets.iter().filter_map(target).collect(),
        tracks: scene
            .bodies
            .iter()
            .map(|body| viz::MapTrack {
                id: body.id.clone(),
                before_deg: track(&body.before),
                after_deg: track(&body.after),
                reference_deg: line(&mut body.reference.iter().map(|place| place.position_m)),
            })
            .collect(),
    };
    scene.map = Some(map);
}
