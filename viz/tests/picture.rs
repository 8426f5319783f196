//! A recording in the real viewer, without a display: are the main parts of the picture there, by colour and place?
//!
//! It needs the viewer: the environment variable `RERUN_VIEWER`, or `rerun` on the PATH. Without one the test says so
//! and passes.
#![cfg(feature = "rerun")]

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use trackbundle_viz::*;

/// The viewer, if one of the version that fits can be run.
fn viewer() -> Option<PathBuf> {
    let viewer = std::env::var_os("RERUN_VIEWER").map_or_else(|| PathBuf::from("rerun"), PathBuf::from);
    let told = Command::new(&viewer).arg("--version").stderr(Stdio::null()).output().ok()?;
    let version = String::from_utf8_lossy(&told.stdout).into_owned();
    let fits = version.contains(VIEWER_VERSION.rsplit_once('.')?.0);
    if !fits {
        eprintln!("the viewer is another version: {version}");
    }
    fits.then_some(viewer)
}

/// A picture: width, height, and red, green, blue of each of its points.
struct Picture {
    size: [usize; 2],
    pixels: Vec<[u8; 3]>,
}

impl Picture {
    fn of(viewer: &Path, scene: &Scene, layout: Layout, folder: &Path) -> Picture {
        let (recording, file) = (folder.join("x.rrd"), folder.join("x.png"));
        save(std::slice::from_ref(scene), layout, &recording).unwrap();
        let shot = Command::new(viewer)
            .args(["--headless", "--bind", "127.0.0.1", "--port", "0", "--window-size", "1000x625"])
            .arg("--screenshot-to")
            .args([&file, &recording])
            .envs([("RERUN_ANALYTICS", "0"), ("RUST_LOG", "error")])
            .output()
            .unwrap();
        assert!(file.exists(), "no picture: {}", String::from_utf8_lossy(&shot.stderr));
        let decoder = png::Decoder::new(std::io::BufReader::new(std::fs::File::open(&file).unwrap()));
        let mut reader = decoder.read_info().unwrap();
        let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut bytes).unwrap();
        let channels = info.color_type.samples();
        assert!(channels >= 3 && info.bit_depth == png::BitDepth::Eight);
        let pixels = bytes.chunks(channels).map(|p| [p[0], p[1], p[2]]).collect();
        Picture { size: [info.width as usize, info.height as usize], pixels }
    }

    /// How many points of this colour a part of the picture has (left, top, right, bottom, in shares of the whole), and
    /// where in it their middle is, in shares of the part. Colours are
    /// matched to so many steps: points are shaded.
    fn find(&self, colour: [u8; 3], steps: u8, [left, top, right, bottom]: [f64; 4]) -> (usize, [f64; 2]) {
        let [width, height] = self.size.map(|size| size as f64);
        let (mut count, mut sum) = (0, [0.0; 2]);
        for (at, pixel) in self.pixels.iter().enumerate() {
            let place = [(at % self.size[0]) as f64 / width, (at / self.size[0]) as f64 / height];
            let is_inside = (left..right).contains(&place[0]) && (top..bottom).contains(&place[1]);
            if is_inside && (0..3).all(|k| pixel[k].abs_diff(colour[k]) < steps) {
                count += 1;
                sum[0] += (place[0] - left) / (right - left);
                sum[1] += (place[1] - top) / (bottom - top);
            }
        }
        (count, sum.map(|sum| sum / count.max(1) as f64))
    }
}

/// A camera at a height of 30 m that looks down on a body which drives along x; the ground.
fn scene() -> Scene {
    let down = |x: f64| Pose { position_m: [x, 0.0, 30.0], quaternion_wxyz: [0.0, 1.0, 0.0, 0.0] };
    let stands = |x: f64| Pose { position_m: [x, 0.0, 0.0], quaternion_wxyz: [1.0, 0.0, 0.0, 0.0] };
    let corners = [-2.0, 2.0].map(|x| [-1.0, 1.0].map(|y| [0.0, 1.5].map(|z| [x, y, z])));
    let state = |shift_m: f64| State {
        points_m: corners.as_flattened().as_flattened().to_vec(),
        sigmas_m: Vec::new(),
        poses: (0..10).map(|k| (k, stands(k as f64 + shift_m))).collect(),
        track: (0..10)
            .map(|k| TrackPoint {
                frame: k,
                position_m: [k as f64 + shift_m, 0.0, 0.0],
                speed_mps: Some(10.0),
                heading_deg: 0.0,
                precision: None,
            })
            .collect(),
    };
    // Observed in the upper left, rejected in the lower right.
    let cluster = |u: f64, v: f64, marking| {
        let at = move |k: usize| {
            let observed_px = [u + 12.0 * (k % 5) as f64, v + 12.0 * (k / 5) as f64];
            ImagePoint { kind: ImagePointKind::Body, observed_px, computed_px: None, marking, reason: None }
        };
        (0..25).map(at).collect::<Vec<_>>()
    };
    let frame = [cluster(130.0, 90.0, Marking::NotUsed), cluster(450.0, 330.0, Marking::Rejected)].concat();
    let lattice_m = vec![-20.0, -10.0, 0.0, 10.0, 20.0];
    Scene {
        name: "picture".to_owned(),
        frames: (0..10).map(|k| Frame { number: k as i64, time_s: 0.1 * k as f64 }).collect(),
        camera: Camera {
            size_px: [640, 480],
            focal_px: [500.0, 500.0],
            principal_px: [320.0, 240.0],
            before: (0..10).map(|k| down(k as f64 + 3.0)).collect(),
            after: (0..10).map(|k| down(k as f64)).collect(),
        },
        bodies: vec![Body {
            id: "car".to_owned(),
            before: state(3.0),
            after: state(0.0),
            scan: Some(Scan {
                points_m: (0..8000)
                    .map(|k| [0.0005 * k as f64 - 2.0, 0.02 * (k % 100) as f64 - 1.0, 1.5])
                    .collect(),
                // Near on the rear half, far on the front half.
                distances_m: (0..8000).map(|k| if k < 4000 { 0.001 } else { 0.5 }).collect(),
                shape_distances_m: vec![None; 8],
            }),
            ..Body::default()
        }],
        image_points: vec![frame; 10],
        ground: Ground { lines_m: [lattice_m.clone(), lattice_m], heights_m: vec![Some(0.0); 25] },
        summary: "# picture".to_owned(),
        ..Scene::default()
    }
}

const ORANGE: [u8; 3] = [0xC8, 0x7F, 0x00];
const BLUE: [u8; 3] = [0x56, 0xB4, 0xE9];
const BROWN: [u8; 3] = [0xB0, 0x8D, 0x57];
const YELLOW: [u8; 3] = [0xF0, 0xE4, 0x42];
const RED: [u8; 3] = [0xD5, 0x5E, 0x00];
const BRIGHTEST: [u8; 3] = [0xFD, 0xE7, 0x25];
const VIOLET: [u8; 3] = [0x7B, 0x3F, 0x9E];

#[test]
fn the_main_parts_are_where_they_belong() {
    let Some(viewer) = viewer() else {
        eprintln!("no viewer (RERUN_VIEWER, or rerun on the PATH): the picture is not compared");
        return;
    };
    let folder = std::env::temp_dir().join(format!("trackbundle-picture-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let overview = Picture::of(&viewer, &scene(), Layout::Overview, &folder);
    // The world, the body from near, the camera's view.
    let (world, near, camera) = ([0.0, 0.1, 0.29, 0.6], [0.3, 0.1, 0.59, 0.6], [0.6, 0.1, 1.0, 0.5]);
    for (name, part, colour, least) in [
        ("ground in the world", world, BROWN, 100),
        ("the start in the world", world, ORANGE, 100),
        ("the end in the world", world, BLUE, 100),
        ("the body from near, before", near, ORANGE, 300),
        ("the body from near, after", near, BLUE, 300),
        ("observed points", camera, YELLOW, 100),
        ("rejected points", camera, RED, 100),
    ] {
        let (count, _) = overview.find(colour, 24, part);
        assert!(count >= least, "{name}: {count} points of its colour");
    }
    let (_, observed) = overview.find(YELLOW, 24, camera);
    let (_, rejected) = overview.find(RED, 24, camera);
    assert!(observed[0] < 0.5 && observed[1] < 0.5, "observed points are in the upper left: {observed:?}");
    assert!(rejected[0] > 0.5 && rejected[1] > 0.5, "rejected points are in the lower right: {rejected:?}");
    // What belongs to shapes is not in the world.
    assert_eq!(overview.find(VIOLET, 24, world).0, 0);

    let shape = Picture::of(&viewer, &scene(), Layout::Shape, &folder);
    let part = [0.0, 0.1, 0.59, 0.95];
    let ((near, rear), (far, front)) = (shape.find(BRIGHTEST, 60, part), shape.find(VIOLET, 60, part));
    assert!(near > 200 && far > 200, "points of the scan that are near {near}, far {far}");
    assert!((rear[0] - front[0]).abs() > 0.1, "rear and front are apart: {rear:?} {front:?}");
    std::fs::remove_dir_all(&folder).unwrap();
}
