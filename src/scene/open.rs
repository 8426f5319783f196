//! What nothing determines, as lines along which things may be anywhere.

use trackbundle_viz as viz;

/// Lines reach so far to either side: a share of the distance from the camera, or metres along an axis.
const SHARE: f64 = 0.05;
const ALONG_AXIS_M: f64 = 2.0;
const AXES: [&str; 3] = ["x", "y", "z"];

/// Adds lines to the bodies whose tracks are not determined: along the rays of the camera where all axes are open,
/// which is what an unknown scale does, else along those axes that are.
pub fn add_open(scene: &mut viz::Scene) {
    let frames = &scene.frames;
    for body in &mut scene.bodies {
        let track = &body.after.track;
        let due = viz::each_second(frames, track.iter().map(|place| place.frame));
        let picked: Vec<&viz::TrackPoint> =
            track.iter().zip(due).filter(|(_, is_due)| *is_due).map(|(place, _)| place).collect();
        let is_open = |place: &&&viz::TrackPoint, axis: usize| {
            place.precision.is_some_and(|precision| precision.sigma_m[axis].is_infinite())
        };
        let along_rays = picked.iter().filter(|place| (0..3).all(|axis| is_open(place, axis)));
        let rays: Vec<[[f64; 3]; 2]> = along_rays
            .filter_map(|place| {
                let from_m = scene.camera.after.get(place.frame)?.position_m;
                let at = |share: f64| {
                    std::array::from_fn(|k| from_m[k] + share * (place.position_m[k] - from_m[k]))
                };
                Some([at(1.0 - SHARE), at(1.0 + SHARE)])
            })
            .collect();
        if !rays.is_empty() {
            let name = format!("scale of {}: not determined", body.id);
            body.open.push(viz::Open { name, lines_m: rays });
        }
        for (axis, letter) in AXES.into_iter().enumerate() {
            let of_axis = picked.iter().filter(|place| is_open(place, axis));
            let partly = of_axis.filter(|place| !(0..3).all(|axis| is_open(place, axis)));
            let lines_m: Vec<[[f64; 3]; 2]> = partly
                .map(|place| {
                    [-ALONG_AXIS_M, ALONG_AXIS_M].map(|along_m| {
                        let mut end = place.position_m;
                        end[axis] += along_m;
                        end
                    })
                })
                .collect();
            if !lines_m.is_empty() {
                let name = format!("{letter} of {}: not determined", body.id);
                body.open.push(viz::Open { name, lines_m });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scene(sigma_m: [f64; 3]) -> viz::Scene {
        let pose = viz::Pose { position_m: [0.0, 0.0, 100.0], quaternion_wxyz: [0.0, 1.0, 0.0, 0.0] };
        let place = |frame: usize| viz::TrackPoint {
            frame,
            position_m: [10.0, 0.0, 0.0],
            speed_mps: None,
            heading_deg: 0.0,
            precision: Some(viz::TrackPrecision {
                sigma_m,
                covariance_xy_m2: 0.0,
                sigma_speed_mps: None,
                sigma_heading_deg: 0.0,
            }),
        };
        let track = (0..5).map(place).collect();
        viz::Scene {
            frames: (0..5).map(|k| viz::Frame { number: k, time_s: 0.5 * k as f64 }).collect(),
            camera: viz::Camera { after: vec![pose; 5], ..Default::default() },
            bodies: vec![viz::Body {
                id: "car".to_owned(),
                after: viz::State { track, ..Default::default() },
                ..Default::default()
            }],
            ..Default::default()
        }
    }

    fn open(sigma_m: [f64; 3]) -> Vec<viz::Open> {
        let mut scene = scene(sigma_m);
        add_open(&mut scene);
        scene.bodies.remove(0).open
    }

    #[test]
    fn an_open_scale_lies_along_the_rays_and_an_open_axis_along_itself() {
        let inf = f64::INFINITY;
        assert!(open([0.1, 0.1, 0.1]).is_empty());
        let scale = open([inf; 3]);
        assert_eq!(scale.len(), 1);
        assert_eq!(scale[0].name, "scale of car: not determined");
        assert_eq!(scale[0].lines_m.len(), 3, "one a second of two seconds");
        let [near, far] = scale[0].lines_m[0];
        assert!((near[0] - 9.5).abs() < 1e-12 && (near[2] - 5.0).abs() < 1e-12, "{near:?}");
        assert!((far[0] - 10.5).abs() < 1e-12 && (far[2] + 5.0).abs() < 1e-12, "{far:?}");
        let height = open([0.1, 0.1, inf]);
        assert_eq!(height.len(), 1);
        assert_eq!(height[0].name, "z of car: not determined");
        assert_eq!(height[0].lines_m[0], [[10.0, 0.0, -2.0], [10.0, 0.0, 2.0]]);
    }
}
