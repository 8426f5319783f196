//! One reader of the program after the other, each by the file that it reads in a folder of its own. Which one: the
//! environment variable `READER`.

#![no_main]

use libfuzzer_sys::fuzz_target;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use trackbundle::internals::files;
use trackbundle::internals::reference::{read_cloud, read_reference, read_true_shapes};
use trackbundle::internals::simulate;
use trackbundle::internals::study::read_study;
use trackbundle::internals::tables::Findings;

/// The vehicle of the folder.
const VEHICLE: &str = "cart";

/// What reads a file of a folder.
type Read = fn(&Path, &str);

/// Readers by name, the file that each reads, and how.
const READERS: &[(&str, &str, Read)] = &[
    ("problem", "problem.toml", problem),
    ("frames", "frames.csv", problem),
    ("camera_poses", "camera_poses.csv", problem),
    ("targets", "targets.csv", problem),
    ("target_observations", "target_observations.csv", problem),
    ("vehicle_observations", "vehicle_observations.csv", problem),
    ("vehicle_poses", "vehicle_poses.csv", problem),
    ("vehicle_points", "vehicle_points.csv", problem),
    ("gnss", "observations/gnss.csv", problem),
    ("asc", "terrain.asc", grid),
    ("tif", "terrain.tif", grid),
    ("ply", "reference/cart.ply", cloud),
    ("las", "reference/cart.las", cloud),
    ("laz", "reference/cart.laz", cloud),
    ("e57", "reference/cart.e57", cloud),
    ("pcd", "reference/cart.pcd", cloud),
    ("xyz", "reference/cart.xyz", cloud),
    ("pos", "reference/cart.pos", reference),
    ("nmea", "reference/cart.nmea", reference),
    ("tum", "reference/cart.tum", reference),
    ("matrix", "reference/cart.matrix.txt", reference),
    ("reference_gnss", "reference/gnss.csv", reference),
    ("reference_toml", "reference/reference.toml", reference),
    ("truth", "truth/vehicle_points.csv", truth),
    ("scenario", "scenario.toml", scenario),
    ("study", "study.toml", study),
    ("result_trajectories", "trajectories.csv", tracks),
    ("result_camera_poses", "camera_poses.csv", poses),
    ("result_vehicle_poses", "vehicle_poses.csv", poses),
    ("result_vehicle_points", "vehicle_points.csv", points),
    ("result_residuals", "residuals.csv", residuals),
    ("result_targets", "targets.csv", targets),
    ("result_report", "report.json", report),
    ("folder", "", problem),
];

fn vehicles() -> [String; 1] {
    [VEHICLE.to_owned()]
}

fn problem(folder: &Path, _: &str) {
    if let Ok(found) = files::read_problem(folder)
        && let Ok(problem) = found.problem
    {
        // What is valid can be written, and checks itself.
        problem.check().unwrap();
    }
}

fn grid(folder: &Path, file: &str) {
    let inputs = trackbundle::internals::disk::Inputs::new(folder);
    for area in [None, Some([[-3.0, 8.0], [2.0, 11.0]])] {
        if let Ok(terrain) = files::read_grid(&inputs, file, "a grid", area) {
            let _ = terrain.at(1.0, 2.0);
            let _ = terrain.footing_at(1.0, 2.0);
        }
    }
}

fn cloud(folder: &Path, file: &str) {
    let _ = read_cloud(&folder.join(file), file);
}

fn reference(folder: &Path, _: &str) {
    let _ = read_reference(folder, &vehicles());
}

fn truth(folder: &Path, _: &str) {
    let _ = read_true_shapes(folder, &vehicles(), &mut Findings::default());
}

fn scenario(folder: &Path, file: &str) {
    let _ = simulate::read_scenario(&folder.join(file));
}

fn study(folder: &Path, file: &str) {
    let _ = read_study(&folder.join(file));
}

fn tracks(folder: &Path, _: &str) {
    let _ = files::read_tracks(folder, Some(&vehicles()), None);
}

fn points(folder: &Path, _: &str) {
    let _ = files::read_points(folder, Some(&vehicles()), &mut Findings::default());
}

fn poses(folder: &Path, _: &str) {
    let _ = files::read_poses(folder, &[], &vehicles(), &mut Findings::default());
}

fn residuals(folder: &Path, _: &str) {
    let _ = files::read_residuals(folder, files::RESIDUALS, None, &mut Findings::default());
}

fn targets(folder: &Path, _: &str) {
    let _ = files::read_targets(folder, &mut Findings::default());
}

fn report(folder: &Path, _: &str) {
    let _ = files::read_report::<trackbundle::internals::report::Report>(folder, &mut Findings::default());
}

/// What is under test: a reader, and a folder in memory where the file system has one.
struct Bench {
    folder: PathBuf,
    file: &'static str,
    read: Read,
}

fn bench() -> Bench {
    let wanted = std::env::var("READER").expect("READER names one of the readers");
    let found = READERS.iter().find(|(name, ..)| *name == wanted);
    let (name, file, read) = *found.unwrap_or_else(|| panic!("{wanted} is none of the readers"));
    let memory = Path::new("/dev/shm");
    let place = if memory.is_dir() { memory.to_owned() } else { std::env::temp_dir() };
    let folder = place.join(format!("trackbundle-fuzz-{name}-{}", std::process::id()));
    for inner in ["observations", "reference", "truth"] {
        std::fs::create_dir_all(folder.join(inner)).unwrap();
    }
    let tiny = Path::new(env!("CARGO_MANIFEST_DIR")).join("../problems/tiny");
    if !name.starts_with("result_") {
        for file in ["problem.toml", "frames.csv", "camera_poses.csv", "vehicle_observations.csv", "vehicle_poses.csv"] {
            std::fs::copy(tiny.join(file), folder.join(file)).unwrap();
        }
    }
    if matches!(name, "pos" | "nmea") {
        let setting = Path::new(env!("CARGO_MANIFEST_DIR")).join("seeds/reference_toml/small");
        std::fs::copy(setting, folder.join("reference/reference.toml")).unwrap();
    }
    Bench { folder, file, read }
}

/// Several files in one, each behind its name: `<<<frames.csv>>>...`.
fn write_folder(folder: &Path, data: &[u8]) {
    let text = String::from_utf8_lossy(data);
    for part in text.split("<<<").skip(1) {
        let Some((name, content)) = part.split_once(">>>") else { continue };
        if name.chars().all(|c| c.is_ascii_alphanumeric() || matches!(c, '.' | '_')) && name.contains('.') {
            let _ = std::fs::write(folder.join(name), content);
        }
    }
}

fuzz_target!(|data: &[u8]| {
    static BENCH: OnceLock<Bench> = OnceLock::new();
    let Bench { folder, file, read } = BENCH.get_or_init(bench);
    if file.is_empty() {
        write_folder(folder, data);
    } else {
        std::fs::write(folder.join(file), data).unwrap();
    }
    read(folder, file);
});
