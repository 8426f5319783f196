//! `problem.toml`.

use super::section::{Document, Section};
use super::video::Pattern;
use crate::camera::{Brown, Camera, Fisheye, INTERIOR, Lens, principal_in_image};
use crate::problem::{Calibration, Freedom, GroundKnowledge, Known, PoseSigma, ReceiverKnowledge, Shutter};
use crate::tables::Findings;
use crate::terrain::Terrain;
use nalgebra::{Vector2, Vector3};

/// Name of the file.
pub const FILE: &str = "problem.toml";

/// What the file says.
#[derive(Debug)]
pub struct Settings {
    pub name: String,
    pub camera: Camera,
    pub calibration: Calibration,
    pub shutter: Shutter,
    pub gnss: ReceiverKnowledge,
    pub vehicle_px: f64,
    pub target_px: f64,
    pub camera_pose_sigma: PoseSigma,
    pub vehicle_pose_sigma: PoseSigma,
    pub ground: Option<GroundSettings>,
    pub vehicles: Vec<VehicleSettings>,
    pub video: Option<VideoSettings>,
}

/// `[terrain]`.
#[derive(Debug)]
pub struct GroundSettings {
    pub terrain: TerrainSettings,
    pub sigma_m: f64,
    pub correlation_s: f64,
    pub bias_sigma_m: f64,
    pub tilt_sigma_rad: f64,
}

/// Which terrain.
#[derive(Debug, PartialEq)]
pub enum TerrainSettings {
    /// A level plane at this height \[m\].
    Plane(f64),
    /// The grid in this file.
    Grid(String),
}

impl GroundSettings {
    /// With the terrain that it names.
    pub fn with(&self, terrain: Terrain) -> GroundKnowledge {
        let GroundSettings { sigma_m, correlation_s, bias_sigma_m, tilt_sigma_rad, .. } = *self;
        GroundKnowledge { terrain, sigma_m, correlation_s, bias_sigma_m, tilt_sigma_rad }
    }
}

/// `[video]`.
#[derive(Debug, PartialEq)]
pub enum VideoSettings {
    /// A folder of images, and how that of a frame is named; without, they are in the order of the frames.
    Images { folder: String, pattern: Option<Pattern> },
    /// A film in one file, and time in it minus video time \[s\].
    File { file: String, offset_s: f64 },
}

/// One `[[vehicle]]`.
#[derive(Debug)]
pub struct VehicleSettings {
    pub id: String,
    /// The marker and the line where it stands.
    pub marker: Option<(String, u64)>,
    pub height: Option<Known>,
    pub is_car: bool,
}

/// Names of the keys of `[camera]` for each lens model.
const BROWN_KEYS: [&str; 5] = ["k1", "k2", "p1", "p2", "k3"];
const FISHEYE_KEYS: [&str; 4] = ["k1", "k2", "k3", "k4"];

/// A readout takes no longer \[s\].
const MOST_READOUT_S: f64 = 1.0;

/// Reads the settings; `None` where they are too wrong to go on, and always with findings then.
pub fn parse(text: &str) -> (Option<Settings>, Findings) {
    let (settings, findings) = Document::new(FILE, text).read(read);
    (settings.flatten(), findings)
}

fn read(top: &Section) -> Option<Settings> {
    top.check_format();
    let name = top.required("name", "a text", || top.text("name"));
    let camera = top.required("camera", "a table [camera]", || top.table("camera", read_camera).flatten());
    let noise = top.table("noise", read_noise).unwrap_or_else(|| Noise {
        vehicle_px: 1.0,
        target_px: 1.0,
        camera: pose_sigma(None, None, 1.0),
        vehicle: pose_sigma(None, None, 0.5),
    });
    let ground = top.table("terrain", read_terrain).flatten();
    let gnss = top.table("gnss", read_gnss).unwrap_or_default();
    let video = top.table("video", read_video).flatten();
    let (camera, calibration, shutter) = match camera {
        Some((camera, calibration, shutter)) => (Some(camera), calibration, shutter),
        None => (None, Calibration::default(), Shutter::default()),
    };
    let vehicles = top.things("vehicle", "[[vehicle]]", read_vehicle, |vehicle| &vehicle.id);
    Some(Settings {
        name: name?,
        camera: camera?,
        calibration,
        shutter,
        gnss,
        vehicle_px: noise.vehicle_px,
        target_px: noise.target_px,
        camera_pose_sigma: noise.camera,
        vehicle_pose_sigma: noise.vehicle,
        ground,
        vehicles,
        video,
    })
}

/// Reads `[camera]`.
pub fn read_camera(camera: &Section) -> Option<(Camera, Calibration, Shutter)> {
    let size = |key| {
        camera.required(key, "a size above 0", || {
            let whole = "a whole number above 0";
            camera
                .number(key, whole, |v| v > 0.0 && v.fract() == 0.0 && v <= f64::from(u32::MAX))
                .map(|v| v as u32)
        })
    };
    let positive = |key| camera.required(key, "a focal length above 0", || camera.positive(key));
    let number = |key| camera.required(key, "a finite number", || camera.any_number(key));
    let size_px = (size("width"), size("height"));
    let focal = (positive("fx"), positive("fy"));
    let principal = (number("cx"), number("cy"));
    let model = camera.text("model");
    let calibration = camera.table("refine", |refine| read_refine(refine, model.as_deref()));
    let calibration = calibration.unwrap_or_default();
    let bends = calibration[3..].iter().any(|freedom| freedom.is_adjusted());
    let coefficients = |keys: &[&'static str]| -> Vec<f64> {
        keys.iter().map(|key| camera.any_number(key).unwrap_or(0.0)).collect()
    };
    let lens = match model.as_deref() {
        Some("pinhole") => {
            for key in BROWN_KEYS.into_iter().chain(["k4"]) {
                if camera.any_number(key).is_some_and(|value| value != 0.0) {
                    camera.warn(key, "has no effect: the model is \"pinhole\"");
                }
            }
            Lens::Pinhole
        }
        Some("brown") | None => {
            let brown: [f64; 5] = coefficients(&BROWN_KEYS).try_into().expect("five keys");
            if brown == [0.0; 5] && !bends { Lens::Pinhole } else { Lens::Brown(Brown::new(brown)) }
        }
        Some("fisheye") => {
            Lens::Fisheye(Fisheye::new(coefficients(&FISHEYE_KEYS).try_into().expect("four keys")))
        }
        Some(_) => {
            camera.error("model", "\"pinhole\", \"brown\" or \"fisheye\"");
            Lens::Pinhole
        }
    };
    let readout_s = camera.any_number("readout_s").unwrap_or(0.0);
    let freedom = match camera.not_negative("readout_sigma_s").unwrap_or(0.0) {
        0.0 => Freedom::Fixed,
        sigma_s => Freedom::Prior(sigma_s),
    };
    if readout_s.abs() > MOST_READOUT_S {
        camera.error("readout_s", "at most a second from the first to the last row");
    }
    let pixel_centre = |key| camera.number(key, "0.0 or 0.5", |v| v == 0.0 || v == 0.5);
    let pixel_centre_px = pixel_centre("pixel_centre").unwrap_or(0.0);
    let calibration_centre_px = pixel_centre("calibration_pixel_centre").unwrap_or(pixel_centre_px);
    let principal_px = Vector2::new(principal.0?, principal.1?);
    let read = Camera {
        size_px: [size_px.0?, size_px.1?],
        focal_px: Vector2::new(focal.0?, focal.1?),
        principal_px: principal_in_image(principal_px, calibration_centre_px, pixel_centre_px),
        pixel_centre_px,
        lens,
    };
    if let Some(fold) = read.fold_in_image() {
        camera.warn(
            "model",
            &format!(
                "folds over inside the image, {:.0} px from the principal point; beyond, {:.1} % of the image \
                 have no rays",
                fold.radius_px,
                100.0 * fold.share
            ),
        );
    }
    Some((read, calibration, Shutter { readout_s, freedom }))
}

/// `[camera.refine]`: what of the interior orientation is adjusted.
fn read_refine(refine: &Section, model: Option<&str>) -> Calibration {
    let mut all = Calibration::default();
    let mut set = |key: &'static str, which: std::ops::Range<usize>| {
        if let Some(freedom) = read_freedom(refine, key) {
            all[which].fill(freedom);
        }
    };
    for (key, which) in [
        ("focal_length", 0..1),
        ("fx", 0..1),
        ("fy", 0..1),
        ("principal_point", 1..3),
        ("cx", 1..2),
        ("cy", 2..3),
    ] {
        set(key, which);
    }
    let coefficients: &[&str] = match model {
        Some("pinhole") => &[],
        Some("fisheye") => &FISHEYE_KEYS,
        _ => &BROWN_KEYS,
    };
    if refine.has("distortion") && coefficients.is_empty() {
        refine.error("distortion", "a model that has distortion, \"brown\" or \"fisheye\"");
    }
    set("distortion", 3..3 + coefficients.len());
    for (at, key) in coefficients.iter().enumerate() {
        set(key, 3 + at..4 + at);
    }
    debug_assert!(3 + coefficients.len() <= INTERIOR);
    all
}

/// `"free"`, `"fixed"`, or a standard deviation.
fn read_freedom(section: &Section, key: &'static str) -> Option<Freedom> {
    if !section.has(key) {
        return None;
    }
    let wanted = "\"free\", \"fixed\" or a standard deviation above 0";
    match section.text_or_number(key) {
        (Some(text), _) if text == "free" => Some(Freedom::Free),
        (Some(text), _) if text == "fixed" => Some(Freedom::Fixed),
        (_, Some(sigma)) if sigma > 0.0 && sigma.is_finite() => Some(Freedom::Prior(sigma)),
        _ => {
            section.error(key, wanted);
            None
        }
    }
}

/// `[gnss]`: what is known of the receivers of `observations/gnss.csv`.
fn read_gnss(gnss: &Section) -> ReceiverKnowledge {
    let offset_s = gnss.any_number("clock_offset_s");
    let sigma_s = gnss.not_negative("clock_offset_sigma_s");
    if sigma_s.is_some() && offset_s.is_none() {
        gnss.warn("clock_offset_sigma_s", "has no effect without clock_offset_s");
    }
    let clock_offset = offset_s.map(|value_m| Known { value_m, sigma_m: sigma_s.unwrap_or(0.0) });
    let along = |key| gnss.any_number(key).unwrap_or(0.0);
    ReceiverKnowledge {
        clock_offset,
        drift_sigma: 1e-6 * gnss.not_negative("clock_drift_sigma_ppm").unwrap_or(0.0),
        shift_sigma_m: gnss.not_negative("shift_sigma_m").unwrap_or(0.0),
        lever_arm_m: Vector3::new(along("lever_x_m"), along("lever_y_m"), along("lever_z_m")),
        lever_sigma_m: gnss.not_negative("lever_sigma_m").unwrap_or(0.0),
    }
}

struct Noise {
    vehicle_px: f64,
    target_px: f64,
    camera: PoseSigma,
    vehicle: PoseSigma,
}

fn read_noise(noise: &Section) -> Noise {
    let pixels = |key| noise.not_negative(key).unwrap_or(1.0);
    Noise {
        vehicle_px: pixels("vehicle_px"),
        target_px: pixels("target_px"),
        camera: pose_sigma(
            noise.not_negative("camera_position_m"),
            noise.not_negative("camera_rotation_deg"),
            1.0,
        ),
        vehicle: pose_sigma(
            noise.not_negative("vehicle_position_m"),
            noise.not_negative("vehicle_rotation_deg"),
            0.5,
        ),
    }
}

/// `tilt_share`: what share of the standard deviation about z goes for those about x and y.
fn pose_sigma(position_m: Option<f64>, rotation_deg: Option<f64>, tilt_share: f64) -> PoseSigma {
    let about = |share: f64| rotation_deg.map(|deg| (share * deg).to_radians());
    PoseSigma { position_m, rotation_rad: [about(tilt_share), about(tilt_share), about(1.0)] }
}

fn read_terrain(terrain: &Section) -> Option<GroundSettings> {
    let plane_z = terrain.any_number("plane_z");
    let grid = terrain.text("grid");
    let sigma_m = terrain.not_negative("sigma_m").unwrap_or(0.02);
    let correlation_s = terrain.not_negative("correlation_s").unwrap_or(1.0);
    let bias_sigma_m = terrain.not_negative("bias_sigma_m").unwrap_or(0.0);
    let tilt_sigma_rad = terrain.not_negative("tilt_sigma_deg").unwrap_or(3.0).to_radians();
    if terrain.has("plane_z") == terrain.has("grid") {
        terrain.error("plane_z", "one of plane_z and grid");
    }
    let terrain = plane_z.map(TerrainSettings::Plane).or(grid.map(TerrainSettings::Grid))?;
    Some(GroundSettings { terrain, sigma_m, correlation_s, bias_sigma_m, tilt_sigma_rad })
}

/// `[video]`: the film itself, to look at.
fn read_video(video: &Section) -> Option<VideoSettings> {
    let images = video.text("images");
    let file = video.text("file");
    let offset_s = video.any_number("offset_s").unwrap_or(0.0);
    let pattern = video.text("pattern").map(|text| Pattern::new(&text));
    if pattern == Some(None) {
        video.error("pattern", "a name with one {frame} or, with zeros in front, {frame:06} in it");
    }
    if video.has("images") == video.has("file") {
        video.error("images", "one of images and file");
        return None;
    }
    for (key, other) in [("pattern", "images"), ("offset_s", "file")] {
        if video.has(key) && !video.has(other) {
            video.error(key, &format!("nothing without {other}"));
        }
    }
    let images = images.map(|folder| VideoSettings::Images { folder, pattern: pattern.flatten() });
    images.or(file.map(|file| VideoSettings::File { file, offset_s }))
}

/// Reads the id of a vehicle.
pub fn read_vehicle_id(vehicle: &Section) -> Option<String> {
    let id = vehicle.required("id", "a text", || vehicle.text("id"));
    // The id becomes part of a file's name.
    let unfit = |c: char| c.is_control() || "/\\:*?\"<>|".contains(c);
    if id.as_ref().is_some_and(|id| id.contains(unfit) || id.starts_with('.')) {
        vehicle.error("id", "an id that can be part of a file name");
    }
    id
}

fn read_vehicle(vehicle: &Section) -> Option<VehicleSettings> {
    let id = read_vehicle_id(vehicle);
    let marker = vehicle.text("marker").map(|id| (id, vehicle.line("marker")));
    let height_m = vehicle.positive("height_m");
    let sigma_m = vehicle.not_negative("height_sigma_m").unwrap_or(0.1);
    if vehicle.has("height_sigma_m") && !vehicle.has("height_m") {
        vehicle.warn("height_sigma_m", "has no effect without height_m");
    }
    let kind = vehicle.text("kind");
    if kind.as_ref().is_some_and(|kind| kind != "car" && kind != "other") {
        vehicle.error("kind", "\"car\" or \"other\"");
    }
    let height = height_m.map(|value_m| Known { value_m, sigma_m });
    Some(VehicleSettings { id: id?, marker, height, is_car: kind.is_some_and(|kind| kind == "car") })
}

#[cfg(test)]
mod tests {
    use super::*;

    const WHOLE: &str = r#"
format = 1
name = "x"
[camera]
model = "brown"
width = 3840
height = 2160
fx = 2680
fy = 2681.5
cx = 1920.0
cy = 1080.0
k1 = -0.011
[noise]
vehicle_px = 3.0
vehicle_position_m = 0.0
vehicle_rotation_deg = 2.0
[terrain]
plane_z = 1.0
[[vehicle]]
id = "car1"
marker = "m"
kind = "car"
height_m = 1.5
[[vehicle]]
id = "car2"
"#;

    fn errors(text: &str) -> Vec<String> {
        parse(text).1.errors().map(|finding| finding.to_string()).collect()
    }

    #[test]
    fn a_whole_file_is_read_with_its_defaults() {
        let (settings, findings) = parse(WHOLE);
        assert_eq!(findings, Findings::default());
        let settings = settings.unwrap();
        assert_eq!(settings.camera.focal_px, Vector2::new(2680.0, 2681.5));
        assert!(matches!(settings.camera.lens, Lens::Brown(_)));
        assert_eq!((settings.vehicle_px, settings.target_px), (3.0, 1.0));
        assert!(settings.camera_pose_sigma.is_unknown());
        let half = Some(1_f64.to_radians());
        assert_eq!(settings.vehicle_pose_sigma.rotation_rad, [half, half, Some(2_f64.to_radians())]);
        assert_eq!(settings.vehicle_pose_sigma.position_m, Some(0.0));
        let ground = settings.ground.unwrap();
        assert_eq!((ground.sigma_m, ground.correlation_s, ground.bias_sigma_m), (0.02, 1.0, 0.0));
        assert_eq!(settings.vehicles[0].height, Some(Known { value_m: 1.5, sigma_m: 0.1 }));
        assert_eq!(settings.vehicles[1].id, "car2");
        assert!(settings.vehicles[0].is_car && !settings.vehicles[1].is_car);
        let wrong = errors(&WHOLE.replace("kind = \"car\"", "kind = \"boat\""));
        assert_eq!(
            wrong,
            ["problem.toml:22: column vehicle.kind: expected \"car\" or \"other\", found \"\\\"boat\\\"\""]
        );
        assert_eq!((settings.shutter, settings.calibration), Default::default());
    }

    #[test]
    fn every_wrong_value_is_found_in_one_go() {
        let text = WHOLE
            .replace("format = 1", "format = 2")
            .replace("fx = 2680", "fx = -2680")
            .replace("width = 3840", "width = \"wide\"")
            .replace("vehicle_px = 3.0", "vehicle_px = -3.0")
            .replace("cy = 1080.0\n", "")
            .replace("id = \"car2\"", "id = \"car1\"");
        let wanted = [
            "problem.toml:2: column format: expected 1, found \"2\"",
            "problem.toml:6: column camera.width: expected a whole number above 0, found \"\\\"wide\\\"\"",
            "problem.toml:8: column camera.fx: expected a finite number above 0, found \"-2680\"",
            "problem.toml:4: column camera.cy: expected a finite number, found \"nothing\"",
            "problem.toml:13: column noise.vehicle_px: expected a finite number of at least 0, found \"-3.0\"",
            "problem.toml:24: column vehicle.id: expected an id that no other vehicle has, found \"\\\"car1\\\"\"",
        ];
        assert_eq!(errors(&text), wanted);
    }

    #[test]
    fn what_is_not_toml_is_shown_by_its_line() {
        let found = errors(&WHOLE.replace("fx = 2680", "fx 2680"));
        assert!(found[0].starts_with("problem.toml:8: expected valid TOML"), "{found:?}");
    }

    #[test]
    fn unknown_keys_are_warned_of() {
        let (_, findings) = parse(&WHOLE.replace("plane_z = 1.0", "plane_z = 1.0\nplain_z = 2.0"));
        assert_eq!(findings.warnings(), ["problem.toml:19: terrain.plain_z is not known and was not read"]);
    }

    #[test]
    fn what_is_adjusted_of_the_camera_is_read() {
        let with = |keys: &str| WHOLE.replace("k1 = -0.011", keys);
        let text = with(
            "k1 = 0.1\nreadout_s = 0.02\nreadout_sigma_s = 0.005\n[camera.refine]\nfocal_length = \"free\"\n\
             principal_point = 3.0\ndistortion = \"free\"\nk3 = \"fixed\"",
        );
        let settings = parse(&text).0.unwrap();
        let (free, fixed) = (Freedom::Free, Freedom::Fixed);
        let centre = Freedom::Prior(3.0);
        assert_eq!(settings.calibration, [free, centre, centre, free, free, free, free, fixed]);
        assert_eq!(settings.shutter, Shutter { readout_s: 0.02, freedom: Freedom::Prior(0.005) });
        // A lens without distortion that is to be estimated is no pinhole.
        let text = with("k1 = 0.0\n[camera.refine]\nk1 = \"free\"");
        assert!(matches!(parse(&text).0.unwrap().camera.lens, Lens::Brown(_)));
        let wrong = errors(&with("k1 = 0.0\nreadout_s = 5\n[camera.refine]\nk1 = \"loose\"\ncx = \"free\""));
        assert_eq!(
            wrong,
            [
                "problem.toml:15: column camera.refine.k1: expected \"free\", \"fixed\" or a standard deviation \
                 above 0, found \"\\\"loose\\\"\"",
                "problem.toml:13: column camera.readout_s: expected at most a second from the first to the last \
                 row, found \"5\""
            ]
        );
        let pinhole = WHOLE
            .replace("\"brown\"", "\"pinhole\"")
            .replace("k1 = -0.011", "[camera.refine]\ndistortion = \"free\"");
        assert_eq!(errors(&pinhole).len(), 1);
    }

    #[test]
    fn what_is_known_of_receivers_is_read() {
        let text = format!(
            "{WHOLE}[gnss]\nclock_offset_s = 0.1\nclock_drift_sigma_ppm = 20\nshift_sigma_m = 0.03\nlever_z_m = 0.05\n"
        );
        let gnss = parse(&text).0.unwrap().gnss;
        assert_eq!(gnss.clock_offset, Some(Known { value_m: 0.1, sigma_m: 0.0 }));
        assert!((gnss.drift_sigma - 2e-5).abs() < 1e-18);
        assert_eq!((gnss.shift_sigma_m, gnss.lever_arm_m), (0.03, Vector3::z() * 0.05));
        assert_eq!(parse(WHOLE).0.unwrap().gnss, ReceiverKnowledge::default());
    }

    #[test]
    fn a_grid_is_named_in_place_of_a_plane() {
        let text = WHOLE.replace("plane_z = 1.0", "grid = \"terrain.asc\"");
        let ground = parse(&text).0.unwrap().ground.unwrap();
        assert_eq!(ground.terrain, TerrainSettings::Grid("terrain.asc".to_owned()));
        let both = WHOLE.replace("plane_z = 1.0", "plane_z = 1.0\ngrid = \"terrain.asc\"");
        let wanted =
            "problem.toml:18: column terrain.plane_z: expected one of plane_z and grid, found \"1.0\"";
        assert_eq!(errors(&both), [wanted]);
        assert_eq!(errors(&WHOLE.replace("plane_z = 1.0\n", "")).len(), 1);
    }

    #[test]
    fn a_film_is_images_or_a_file() {
        let with = |keys: &str| format!("{WHOLE}[video]\n{keys}\n");
        let video = |keys: &str| {
            let (settings, findings) = parse(&with(keys));
            assert_eq!(findings, Findings::default());
            settings.unwrap().video
        };
        assert_eq!(parse(WHOLE).0.unwrap().video, None);
        let images = |pattern| Some(VideoSettings::Images { folder: "in".to_owned(), pattern });
        assert_eq!(video("images = \"in\""), images(None));
        let pattern = Pattern::new("f{frame:04}.png");
        assert!(pattern.is_some());
        assert_eq!(video("images = \"in\"\npattern = \"f{frame:04}.png\""), images(pattern));
        let film = |offset_s| Some(VideoSettings::File { file: "a.mp4".to_owned(), offset_s });
        assert_eq!(video("file = \"a.mp4\""), film(0.0));
        assert_eq!(video("file = \"a.mp4\"\noffset_s = -2.5"), film(-2.5));
        for (keys, key, wanted, found) in [
            ("", "26: column video.images", "one of images and file", "nothing"),
            (
                "images = \"in\"\nfile = \"a\"",
                "27: column video.images",
                "one of images and file",
                "\\\"in\\\"",
            ),
            (
                "file = \"a\"\npattern = \"{frame}\"",
                "28: column video.pattern",
                "nothing without images",
                "\\\"{frame}\\\"",
            ),
            ("images = \"in\"\noffset_s = 1", "28: column video.offset_s", "nothing without file", "1"),
            (
                "images = \"in\"\npattern = \"a.png\"",
                "28: column video.pattern",
                "a name with one {frame} or, with zeros in front, {frame:06} in it",
                "\\\"a.png\\\"",
            ),
            ("file = \"a\"\noffset_s = inf", "28: column video.offset_s", "a finite number", "inf"),
            ("images = \"\"", "27: column video.images", "a text that is not empty", "\\\"\\\""),
            ("file = 1", "27: column video.file", "a text", "1"),
        ] {
            let wanted = format!("problem.toml:{key}: expected {wanted}, found \"{found}\"");
            assert_eq!(errors(&with(keys)), [wanted]);
        }
    }

    #[test]
    fn a_fisheye_lens_has_its_own_coefficients() {
        let text = WHOLE.replace("\"brown\"", "\"fisheye\"").replace("k1 = -0.011", "k1 = 0.1\nk4 = 0.02");
        let (settings, findings) = parse(&text);
        assert_eq!(findings, Findings::default());
        assert_eq!(settings.unwrap().camera.lens, Lens::Fisheye(Fisheye::new([0.1, 0.0, 0.0, 0.02])));
        let (_, findings) = parse(&text.replace("k4", "p1"));
        assert_eq!(findings.warnings(), ["problem.toml:13: camera.p1 is not known and was not read"]);
    }

    #[test]
    fn pixel_conventions_are_read_and_brought_together() {
        let camera = |keys: &str| parse(&WHOLE.replace("k1 = -0.011", keys)).0.unwrap().camera;
        let centre = |keys: &str| (camera(keys).pixel_centre_px, camera(keys).principal_px.x);
        assert_eq!(centre(""), (0.0, 1920.0));
        assert_eq!(centre("pixel_centre = 0.5"), (0.5, 1920.0));
        assert_eq!(centre("calibration_pixel_centre = 0.5"), (0.0, 1919.5));
        assert_eq!(centre("pixel_centre = 0.5\ncalibration_pixel_centre = 0.0"), (0.5, 1920.5));
        for key in ["pixel_centre", "calibration_pixel_centre"] {
            let found = errors(&WHOLE.replace("k1 = -0.011", &format!("{key} = 1")));
            assert_eq!(
                found,
                [format!("problem.toml:12: column camera.{key}: expected 0.0 or 0.5, found \"1\"")]
            );
        }
    }

    #[test]
    fn a_lens_that_folds_over_inside_the_image_is_warned_of() {
        // r - 0.9 r^3 is largest at r = 0.61, where it is 0.41: 1088 px.
        let (settings, findings) = parse(&WHOLE.replace("-0.011", "-0.9"));
        assert!(settings.is_some());
        let [warning] = findings.warnings() else { panic!("{findings:?}") };
        assert!(
            warning.starts_with("problem.toml:5: camera.model folds over inside the image, 1087 px"),
            "{warning}"
        );
    }

    #[test]
    fn a_vehicle_cannot_lead_a_file_astray() {
        for id in ["../car", "a/b", ".hidden", "a\\tb"] {
            assert_eq!(errors(&WHOLE.replace("car2", id)).len(), 1, "{id}");
        }
    }
}
