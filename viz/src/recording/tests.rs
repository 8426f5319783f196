//! What was recorded, decoded again.

use super::*;
use crate::colour;
use crate::scene::*;
use crate::sdk::log::{Chunk, LogMsg};
use std::collections::{BTreeMap, BTreeSet};

/// Two frames, a body in the first one, a target, one good and one rejected image point.
fn scene() -> Scene {
    let pose = |x: f64| Pose {
        position_m: [700_000.0 + x, 5_000_000.0, 60.0],
        quaternion_wxyz: [0.0, 1.0, 0.0, 0.0],
    };
    let state = || State {
        points_m: vec![[1.0, 0.0, 1.5], [-1.0, 0.0, 1.5], [0.0, 0.0, 1.5]],
        sigmas_m: vec![Some([0.01, 0.03, 0.015]), Some([0.01, f64::INFINITY, 0.01]), Some([0.4, 0.01, 0.01])],
        poses: vec![(0, pose(1.0))],
        track: vec![TrackPoint {
            frame: 0,
            position_m: pose(1.0).position_m,
            speed_mps: Some(3.0),
            heading_deg: 30.0,
            precision: Some(TrackPrecision {
                sigma_m: [0.1, 0.1, 0.3],
                covariance_xy_m2: 0.006,
                sigma_speed_mps: Some(0.25),
                sigma_heading_deg: 0.5,
            }),
        }],
    };
    let image_point = |marking| ImagePoint {
        reason: (marking == Marking::Rejected).then_some("its track"),
        kind: ImagePointKind::Body,
        observed_px: [10.0, 20.0],
        computed_px: Some([13.0, 16.0]),
        marking,
    };
    let on_the_way = |x: f64| Snapshot {
        camera: vec![pose(x), pose(x)],
        bodies: vec![BodySnapshot {
            id: "car".to_owned(),
            track_m: vec![pose(x).position_m],
            points_m: vec![[x, 0.0, 0.0]],
        }],
    };
    Scene {
        name: "test".to_owned(),
        frames: vec![Frame { number: 7, time_s: 0.5 }, Frame { number: 8, time_s: 0.75 }],
        camera: Camera {
            size_px: [640, 480],
            focal_px: [500.0, 500.0],
            principal_px: [320.0, 240.0],
            before: vec![pose(0.5), pose(0.5)],
            after: vec![pose(0.0), pose(0.001)],
        },
        bodies: vec![Body {
            id: "car".to_owned(),
            before: state(),
            after: state(),
            reference: vec![ReferencePlace {
                frame: 0,
                position_m: pose(1.25).position_m,
                sigma_m: Some([0.02, 0.03, 0.04]),
                difference_m: [-0.25, 0.125, 0.5],
                speed_mps: Some(3.5),
                course_deg: Some(31.0),
            }],
            scan: Some(Scan {
                points_m: vec![[1.0, 0.0, 1.5], [1.0, 0.5, 1.5], [0.0, 0.0, 3.0]],
                distances_m: vec![0.001, 0.5, f64::INFINITY],
                shape_distances_m: vec![Some(0.001), None],
            }),
            open: vec![Open {
                name: "scale of car".to_owned(),
                lines_m: vec![[pose(0.0).position_m, pose(9.0).position_m]],
            }],
        }],
        targets: vec![Target {
            id: "T1".to_owned(),
            role: TargetRole::Control,
            position_m: pose(3.0).position_m,
            sigma_m: Some([0.01, 0.02, 0.03]),
        }],
        image_points: vec![vec![image_point(Marking::Good), image_point(Marking::Rejected)], vec![]],
        ground: Ground {
            lines_m: [vec![7e5, 700_005.0, 700_010.0], vec![5e6, 5_000_005.0]],
            heights_m: vec![Some(0.0), Some(0.5), None, Some(0.25), Some(1.0), Some(2.0)],
        },
        iterations: vec![
            Iteration { cost: 100.0, damping: 1e-9, step: None, stage: "approach", state: on_the_way(2.0) },
            Iteration { cost: 1.0, damping: 1e-9, step: Some(10.0), stage: "final", state: on_the_way(1.0) },
        ],
        summary: "# test".to_owned(),
        warnings: vec!["something is odd".to_owned()],
        map: Some(Map {
            camera_deg: vec![[45.0, 11.0]],
            targets_deg: vec![(TargetRole::Check, [45.5, 11.5])],
            tracks: vec![MapTrack {
                id: "car".to_owned(),
                after_deg: vec![[46.0, 12.0]],
                ..MapTrack::default()
            }],
        }),
        film: None,
        root: None,
        residual_factor: Some(40.0),
    }
}

/// The chunks of the recorded scene, by entity.
fn recorded() -> BTreeMap<String, Vec<Chunk>> {
    recorded_of(&[scene()])
}

fn recorded_of(scenes: &[Scene]) -> BTreeMap<String, Vec<Chunk>> {
    let (stream, storage) = RecordingStreamBuilder::new("test").enabled(true).memory().unwrap();
    record(&stream, scenes, Layout::Overview).unwrap();
    stream.flush_blocking().unwrap();
    let mut chunks: BTreeMap<String, Vec<Chunk>> = BTreeMap::new();
    for message in storage.take() {
        if let LogMsg::ArrowMsg(store, message) = message
            && store.is_recording()
        {
            let chunk = Chunk::from_arrow_msg(&message).unwrap();
            // The library's own, which has the name.
            if chunk.entity_path().to_string() != "/__properties" {
                chunks.entry(chunk.entity_path().to_string()).or_default().push(chunk);
            }
        }
    }
    chunks
}

/// The numbers of a component whose name ends like this, all rows one after the other.
fn numbers(chunks: &[Chunk], component: &str) -> Vec<f64> {
    let columns = chunks.iter().flat_map(|chunk| chunk.components().values());
    let named = columns.filter(|column| column.descriptor.component.as_str().ends_with(component));
    named
        .flat_map(|column| {
            let mut values = column.list_array.values().clone();
            // Vectors are lists of a fixed size, lines lists of any.
            loop {
                let fixed =
                    values.as_any().downcast_ref::<crate::sdk::external::arrow::array::FixedSizeListArray>();
                let free = values.as_any().downcast_ref::<crate::sdk::external::arrow::array::ListArray>();
                values = match (fixed, free) {
                    (Some(list), _) => list.values().clone(),
                    (_, Some(list)) => list.values().clone(),
                    _ => break,
                };
            }
            let single = values.as_any().downcast_ref::<crate::sdk::external::arrow::array::Float32Array>();
            let double = values.as_any().downcast_ref::<crate::sdk::external::arrow::array::Float64Array>();
            match (single, double) {
                (Some(values), _) => values.values().iter().map(|v| f64::from(*v)).collect::<Vec<_>>(),
                (_, Some(values)) => values.values().to_vec(),
                _ => panic!("{component} holds no numbers"),
            }
        })
        .collect()
}

#[test]
fn everything_has_its_place() {
    let recorded = recorded();
    let found: BTreeSet<&str> = recorded.keys().map(String::as_str).collect();
    for wanted in [
        "/world",
        "/world/ground",
        "/world/targets/control",
        "/world/camera",
        "/world/camera/image",
        "/world/camera/image/observed",
        "/world/camera/image/computed",
        "/world/camera/image/rejected",
        "/world/paths/camera/before",
        "/world/paths/camera/after",
        "/world/paths/car/before",
        "/world/paths/car/after",
        "/world/bodies/car/before",
        "/world/bodies/car/after",
        "/world/bodies/car/after/shape",
        "/shapes/car/before",
        "/shapes/car/after",
        "/plots/speed/car/after",
        "/plots/residuals/vehicle_points",
        "/plots/iterations/cost",
        "/plots/cost",
        "/world/ground/surface",
        "/world/camera_start",
        "/world/camera_start/image",
        "/world/bodies/car/after/box",
        "/world/bodies/car/after/heading",
        "/world/paths/car/reference",
        "/world/paths/car/reference/precision",
        "/world/paths/car/iteration",
        "/world/paths/camera/iteration",
        "/world/open/car/scale\\ of\\ car",
        "/shapes/car/scan",
        "/shapes/car/to_scan",
        "/shapes/car/iteration",
        "/plots/errors/car/x",
        "/plots/speed/car/reference",
        "/plots/distribution",
        "/map/camera",
        "/map/targets/check",
        "/map/car/after",
        "/text/summary",
        "/text/legend",
        "/text/log",
        "/text/log/warnings/0",
    ] {
        assert!(found.contains(wanted), "{wanted} is not among {found:?}");
    }
}

#[test]
fn three_timelines_and_no_other() {
    let mut timelines = BTreeSet::new();
    for chunk in recorded().values().flatten() {
        timelines.extend(chunk.timelines().keys().map(|name| name.as_str().to_owned()));
    }
    assert_eq!(timelines.into_iter().collect::<Vec<_>>(), ["frame", "iteration", "time"]);
}

#[test]
fn large_coordinates_keep_their_millimetres() {
    let recorded = recorded();
    // The others are those of iterations.
    let is_of_frames = |chunk: &&Chunk| chunk.timelines().keys().any(|name| name.as_str() == "frame");
    let of_frames: Vec<Chunk> = recorded["/world/camera"].iter().filter(is_of_frames).cloned().collect();
    let positions = numbers(&of_frames, "translation");
    assert_eq!(positions.len(), 6);
    assert_eq!(positions[0], 0.0);
    assert!((positions[3] - 0.001).abs() < 1e-6, "{positions:?}");
    assert_eq!(numbers(&recorded["/world/targets/control"], "positions"), [3.0, 0.0, 60.0]);
}

#[test]
fn image_points_are_sorted_by_their_marking() {
    let recorded = recorded();
    let at = |layer: &str| numbers(&recorded[&format!("/world/camera/image/{layer}")], "positions");
    assert_eq!(at("observed"), [10.0, 20.0, 10.0, 20.0]);
    assert_eq!(at("rejected"), [10.0, 20.0]);
    assert_eq!(at("computed"), [13.0, 16.0, 13.0, 16.0]);
    // Residual (-3, 4): the root mean square of its coordinates.
    let rms = numbers(&recorded["/plots/residuals/vehicle_points"], "scalars");
    assert!((rms[0] - 12.5_f64.sqrt()).abs() < 1e-12);
}

#[test]
fn the_ground_has_its_heights_and_its_holes() {
    // Two lines along x, the first of them cut short; of the three along y one has a hole.
    let recorded = recorded();
    let strips = numbers(&recorded["/world/ground"], "strips");
    let heights: Vec<f64> = strips.chunks(3).map(|place| place[2]).collect();
    assert_eq!(heights, [0.0, 0.5, 0.25, 1.0, 2.0, 0.0, 0.25, 0.5, 1.0]);
    assert_eq!(strips[3..5], [5.0, 0.0]);
}

#[test]
fn residuals_point_from_the_computed_to_the_observed_place() {
    let recorded = recorded();
    let arrows = &recorded["/world/camera/image/residuals"];
    assert_eq!(numbers(arrows, "origins"), [13.0, 16.0]);
    assert_eq!(numbers(arrows, "vectors"), [-120.0, 160.0]);
    assert_eq!(scene().residual_factor(), 40.0);
    assert_eq!(Scene::default().residual_factor(), 20.0);
}

fn close(found: &[f64], wanted: &[f64]) -> bool {
    found.len() == wanted.len() && found.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-6)
}

#[test]
fn ellipsoids_hold_95_per_cent_and_leave_out_what_is_not_determined() {
    let recorded = recorded();
    let sizes = |entity: &str| numbers(&recorded[entity], "half_sizes");
    let scaled = |sigmas: &[f64]| sigmas.iter().map(|sigma| 2.795_483 * sigma).collect::<Vec<f64>>();
    assert!(close(&sizes("/world/targets/control/survey"), &scaled(&[0.01, 0.02, 0.03])));
    assert!(close(&sizes("/shapes/car/precision"), &scaled(&[0.01, 0.03, 0.015])));
    // Correlation 0.6 of equal variances: axes at 45 degrees, variances 1.6 and 0.4 times as large.
    let axes = [0.1 * 1.6_f64.sqrt(), 0.1 * 0.4_f64.sqrt(), 0.3];
    assert!(close(&sizes("/world/paths/car/precision"), &scaled(&axes)));
    let (sin, cos) = std::f64::consts::FRAC_PI_8.sin_cos();
    assert!(close(&numbers(&recorded["/world/paths/car/precision"], "quaternions"), &[0.0, 0.0, sin, cos]));
}

#[test]
fn speed_and_heading_have_their_bands() {
    let recorded = recorded();
    let value = |entity: &str| numbers(&recorded[entity], "scalars");
    assert_eq!(value("/plots/speed/car/after_upper"), [3.5]);
    assert_eq!(value("/plots/speed/car/after_lower"), [2.5]);
    assert_eq!(value("/plots/heading/car/after"), [30.0]);
    assert_eq!(value("/plots/heading/car/after_lower"), [29.0]);
    assert_eq!(value("/plots/sigma/car/z"), [0.3]);
}

#[test]
fn points_have_the_colour_of_their_worst_standard_deviation() {
    let colours =
        [[0.01, 0.002, 0.0], [0.011, 0.0, 0.0], [0.0, 0.05, 0.0], [0.0, 0.0, 0.2]].map(colour::of_sigma);
    assert_eq!(colours, [0xFDE7_25FF, 0x5EC9_62FF, 0x2191_8CFF, 0x7B3F_9EFF]);
    assert_eq!(colour::of_sigma([0.01, f64::INFINITY, 0.01]), 0x5555_55FF);
}

#[test]
fn the_cost_is_there_for_each_iteration() {
    assert_eq!(numbers(&recorded()["/plots/iterations/cost"], "scalars"), [2.0, 0.0]);
    assert_eq!(numbers(&recorded()["/plots/iterations/step"], "scalars"), [1.0]);
}

#[test]
fn everything_has_its_place_among_others_too() {
    let with_root = |root: &str| Scene { root: Some(root.to_owned()), ..scene() };
    let several = recorded_of(&[with_root("a b"), with_root("c")]);
    let alone = recorded();
    for (root, escaped) in [("a b", "a\\ b"), ("c", "c")] {
        for entity in alone.keys() {
            assert!(several.contains_key(&format!("/{escaped}{entity}")), "{entity} of {root}");
        }
    }
    assert_eq!(several.len(), 2 * alone.len());
}

/// The rows of an entity on a timeline: what time it has, and how many values each.
fn rows(chunks: &[Chunk], timeline: &str) -> Vec<i64> {
    let times = chunks.iter().flat_map(|chunk| {
        let column = chunk.timelines().iter().find(|(name, _)| name.as_str() == timeline);
        column.map_or(Vec::new(), |(_, column)| column.times_raw().to_vec())
    });
    times.collect()
}

#[test]
fn each_iteration_has_its_state() {
    let recorded = recorded();
    let line = &recorded["/world/paths/car/iteration"];
    assert_eq!(rows(line, "iteration"), [0, 1]);
    assert!(rows(line, "frame").is_empty());
    let strips = numbers(line, "strips");
    assert_eq!([strips[0], strips[3]], [2.0, 1.0]);
    assert_eq!(numbers(&recorded["/shapes/car/iteration"], "positions"), [2.0, 0.0, 0.0, 1.0, 0.0, 0.0]);
}

#[test]
fn what_a_result_is_compared_with_is_beside_it() {
    let recorded = recorded();
    let value = |entity: &str| numbers(&recorded[entity], "scalars");
    assert_eq!(value("/plots/errors/car/x"), [-0.25]);
    assert_eq!(value("/plots/errors/car/y"), [0.125]);
    // Both standard deviations: 0.1 and 0.02 along x.
    assert!(close(&value("/plots/errors/car/x_upper"), &[2.0 * 0.1_f64.hypot(0.02)]));
    assert_eq!(value("/plots/speed/car/reference"), [3.5]);
    assert_eq!(value("/plots/heading/car/reference"), [31.0]);
    let sizes = numbers(&recorded["/world/paths/car/reference/precision"], "half_sizes");
    assert!(close(&sizes, &[0.02, 0.03, 0.04].map(|sigma| NORMAL_95 * sigma)));
    assert_eq!(colours(&recorded["/shapes/car/scan"]), [0xFDE7_25FF, 0x7B3F_9EFF, 0x5555_55FF]);
    assert_eq!(colours(&recorded["/shapes/car/to_scan"]), [0xFDE7_25FF, 0x5555_55FF]);
}

/// The colours of an entity.
fn colours(chunks: &[Chunk]) -> Vec<u32> {
    use crate::sdk::external::arrow::array::{Array, UInt32Array};
    let columns = chunks.iter().flat_map(|chunk| chunk.components().values());
    let named = columns.filter(|column| column.descriptor.component.as_str().ends_with("colors"));
    let values = named.map(|column| column.list_array.values().clone());
    let numbers = |values: &std::sync::Arc<dyn Array>| {
        values.as_any().downcast_ref::<UInt32Array>().unwrap().values().to_vec()
    };
    values.flat_map(|values| numbers(&values)).collect()
}

#[test]
fn what_is_open_is_dashed_and_says_what_it_is() {
    let recorded = recorded();
    let strips = numbers(&recorded["/world/open/car/scale\\ of\\ car"], "strips");
    let along: Vec<f64> = strips.chunks(3).map(|place| place[0]).collect();
    assert!(close(&along, &[0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0]), "{along:?}");
}

#[test]
fn a_box_surrounds_the_points_and_arrows_show_heading_and_speed() {
    let recorded = recorded();
    let around = &recorded["/world/bodies/car/after/box"];
    assert_eq!(numbers(around, "half_sizes"), [1.0, 0.0, 0.0]);
    assert_eq!(numbers(around, "centers"), [0.0, 0.0, 1.5]);
    assert_eq!(numbers(&recorded["/world/bodies/car/after/heading"], "vectors"), [1.5, 0.0, 0.0]);
}

#[test]
fn arrows_of_speed_are_the_way_of_a_second() {
    let mut scene = scene();
    let track = &mut scene.bodies[0].after.track;
    let mut next = track[0];
    next.frame = 1;
    next.position_m[0] += 3.0;
    next.position_m[1] += 4.0;
    next.speed_mps = Some(10.0);
    track.push(next);
    let recorded = recorded_of(&[scene]);
    let vectors = numbers(&recorded["/world/velocity/car"], "vectors");
    assert!(close(&vectors, &[1.8, 2.4, 0.0, 6.0, 8.0, 0.0]), "{vectors:?}");
}

#[test]
fn a_body_goes_after_its_last_frame() {
    let recorded = recorded();
    let of = |entity: &str| rows(&recorded[entity], "frame");
    assert_eq!(of("/world/bodies/car/after"), [7, 8]);
    assert_eq!(of("/world/bodies/car/after/shape"), [7]);
}

#[test]
fn residuals_are_counted_by_their_size() {
    // Root mean square 0.5, so that bars are 0.1 wide.
    let (middles, counts) = super::plots::histogram(&[0.5, -0.5, 0.5, -0.5]).unwrap();
    assert_eq!(middles.len(), 61);
    assert!((middles[1] - middles[0] - 0.1).abs() < 1e-12);
    let at: Vec<(usize, i64)> = counts.iter().copied().enumerate().filter(|(_, count)| *count > 0).collect();
    assert_eq!(at, [(25, 2), (35, 2)]);
    assert!((middles[35] - 0.5).abs() < 1e-12);
    // What is far off is in the last bar.
    let mut values = vec![0.01; 10_000];
    values.push(7.0);
    let (middles, counts) = super::plots::histogram(&values).unwrap();
    assert_eq!((counts[60], counts.iter().sum::<i64>()), (1, 10_001));
    assert!(middles[60] < 7.0);
    assert_eq!(super::plots::histogram(&[]), None);
    assert_eq!(super::plots::histogram(&[0.0]), None);
}

#[test]
fn two_recordings_are_one_only_if_all_that_is_told_of_them_is() {
    let id = |scene: &Scene| {
        let (stream, _storage) = builder(std::slice::from_ref(scene)).memory().unwrap();
        stream.store_info().unwrap().store_id.recording_id().to_string()
    };
    let other = Scene { summary: "another".to_owned(), ..scene() };
    assert_eq!(id(&scene()), id(&scene()));
    assert_ne!(id(&scene()), id(&other));
}
