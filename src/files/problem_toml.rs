//! `problem.toml`: the list of its sections.

use super::cells::quoted;
use super::section::{Document, Section};
pub use super::sections::FILE;
use super::sections::terrain::GroundSettings;
use super::sections::vehicle::VehicleSettings;
use super::sections::video::VideoSettings;
use super::sections::{OfPoints, camera, gnss, noise, terrain, vehicle, video};
use crate::camera::Camera;
use crate::problem::{Calibration, PoseSigma, Problem, ReceiverKnowledge, Shutter};
use crate::tables::Findings;

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
    pub vehicle_poses_are_measured: bool,
    pub ground: Option<GroundSettings>,
    pub vehicles: Vec<VehicleSettings>,
    pub of_points: OfPoints,
    pub video: Option<VideoSettings>,
}

/// Reads the settings; `None` where they are too wrong to go on, and always with findings then.
pub fn parse(text: &str) -> (Option<Settings>, Findings) {
    let (settings, findings) = Document::new(FILE, text).read(read);
    (settings.flatten(), findings)
}

fn read(top: &Section) -> Option<Settings> {
    top.check_format();
    let name = top.required("name", "a text", || top.text("name"));
    let camera = top.required("camera", "a table [camera]", || top.table("camera", camera::read).flatten());
    let noise = top.table("noise", noise::read).unwrap_or_default();
    let ground = top.table("terrain", terrain::read).flatten();
    let gnss = top.table("gnss", gnss::read).unwrap_or_default();
    let video = top.table("video", video::read).flatten();
    let (camera, calibration, shutter) = match camera {
        Some((camera, calibration, shutter)) => (Some(camera), calibration, shutter),
        None => (None, Calibration::default(), Shutter::default()),
    };
    let vehicles = top.things("vehicle", "[[vehicle]]", vehicle::read, |vehicle| &vehicle.id);
    let of_points = OfPoints::read(top);
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
        vehicle_poses_are_measured: noise.vehicle_poses_are_measured,
        ground,
        vehicles,
        of_points,
        video,
    })
}

/// The file of a problem; `grid` is the name of the file of its heights, if it has some.
pub fn written(problem: &Problem, grid: Option<&str>) -> String {
    let mut text = format!("format = 1\nname = {}\n", quoted(&problem.name));
    camera::write(&mut text, problem);
    noise::write(&mut text, problem);
    terrain::write(&mut text, problem, grid);
    gnss::write(&mut text, problem);
    vehicle::write(&mut text, problem);
    OfPoints::write(&mut text, problem);
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::{Brown, Fisheye, Lens};
    use crate::files::sections::terrain::TerrainSettings;
    use crate::files::sections::video::Pattern;
    use crate::problem::{Freedom, Known, KnownTime};
    use nalgebra::{Vector2, Vector3};

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
        assert_eq!((ground.sigma_m, ground.correlation_s, ground.bias_sigma_m), (0.02, None, 0.0));
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
            "problem.toml:6: column camera.width: expected a whole number from 1 to 1000000, found \"\\\"wide\\\"\"",
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
        assert_eq!(gnss.clock_offset, Some(KnownTime { value_s: 0.1, sigma_s: 0.0 }));
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
    fn what_is_held_of_a_lens_is_read_and_not_refined() {
        let text = WHOLE.replace("k1 = -0.011", "k4 = -0.02\nskew_px = 1.5");
        let (settings, findings) = parse(&text);
        assert_eq!(findings, Findings::default());
        let lens = settings.unwrap().camera.lens;
        assert_eq!(lens, Lens::Brown(Brown::with([0.0; 5], [-0.02, 1.5])));
        let (settings, findings) =
            parse(&text.replace("[noise]", "[camera.refine]\nskew_px = \"free\"\n[noise]"));
        assert_eq!(
            findings.warnings(),
            ["problem.toml:15: camera.refine.skew_px is not known and was not read"]
        );
        assert_eq!(settings.unwrap().calibration, Calibration::default());
        let (_, findings) = parse(&text.replace("\"brown\"", "\"pinhole\""));
        let wanted = [(12, "k4"), (13, "skew_px")].map(|(line, key)| {
            format!("problem.toml:{line}: camera.{key} has no effect: the model is \"pinhole\"")
        });
        assert_eq!(findings.warnings(), wanted);
        let wanted = "problem.toml:5: column camera.model: expected \"pinhole\", \"brown\" or \"fisheye\", found \"\\\"plate\\\"\"";
        assert_eq!(errors(&WHOLE.replace("\"brown\"", "\"plate\"")), [wanted]);
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
