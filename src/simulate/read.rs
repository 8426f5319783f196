//! `SCENARIO.toml`.

use super::knowledge::KnowledgeSettings;
use super::presets::{PRESETS, Preset};
use super::scenario::{
    BodySettings, CameraSettings, Course, ErrorSettings, FlightSettings, Given, GnssSettings, MeasuredGrid,
    PathSettings, PoseSettings, Scatter, Scenario, Segment, TargetSettings, TerrainSettings, VehicleSettings,
    VideoSettings,
};
use crate::files::section::{Document, Section};
use crate::files::{read_camera, read_vehicle_id};
use crate::problem::{Calibration, Freedom};
use crate::tables::Findings;
use std::path::Path;

/// The most frames, and the most points of a vehicle: what memory can hold.
const MOST_FRAMES: f64 = 100_000.0;
const MOST_POINTS: f64 = 100_000.0;

/// The most cells of a measured grid, from the origin to its end.
const MOST_CELLS: f64 = 2000.0;
/// The largest share of tracks that come beside those of a body.
const MOST_BESIDE: f64 = 0.95;

/// Reads a scenario. Files that it names are beside it, in `folder`. Unknown keys are findings: a scenario with a
/// word misspelt would be another one.
pub fn parse(file: &str, text: &str, folder: &Path) -> Result<Scenario, Findings> {
    let (scenario, findings) = Document::new(file, text).strict().read(|top| read(top, folder));
    match scenario.flatten() {
        Some(scenario) if !findings.is_invalid() => Ok(scenario),
        _ => Err(findings),
    }
}

fn read(top: &Section, folder: &Path) -> Option<Scenario> {
    top.check_format();
    let name = top.required("name", "a text", || top.text("name"));
    let seed = whole(top, "seed", 1, 0.0, 9e15);
    let camera = top.required("camera", "a table [camera]", || top.table("camera", camera)).flatten();
    let rate_hz = camera.as_ref().map_or(30.0, |(_, rate_hz)| *rate_hz);
    let video = top.table("film", |video| read_video(video, rate_hz));
    let video = video.unwrap_or(VideoSettings { frames: 150, rate_hz });
    let flight = top.required("flight", "a table [flight]", || top.table("flight", flight)).flatten();
    let terrain = top.table("terrain", read_terrain).unwrap_or(TerrainSettings {
        grid: None,
        plane_z_m: 0.0,
        is_known: true,
        sigma_m: 0.02,
        correlation_s: 1.0,
        bias_sigma_m: 0.0,
        tilt_sigma_deg: 0.1,
        measured: None,
    });
    let vehicles = top.things("vehicle", "[[vehicle]]", vehicle, |vehicle| &vehicle.id);
    let targets = top.table("targets", targets);
    let targets = targets.unwrap_or(TargetSettings {
        count: 0,
        check: 0,
        spread_m: 30.0,
        height_m: 0.5,
        sigma_m: 0.02,
    });
    let errors = top.table("errors", errors).unwrap_or(ErrorSettings {
        vehicle_px: 1.0,
        target_px: 1.0,
        gross: 0.0,
        gross_targets: 0.0,
        gross_px: [10.0, 60.0],
        ground_tracks: 0.0,
        swapped_tracks: 0.0,
        static_tracks: 0.0,
        sliding_tracks: 0.0,
        foreign_tracks: 0.0,
        focal: 0.0,
        principal_px: 0.0,
        really: Scatter::AS_STATED,
    });
    let poses = [("camera_poses", [0.3, 0.5]), ("vehicle_poses", [0.25, 2.0])].map(|(key, [m, deg])| {
        top.table(key, |section| pose_settings(section, m, deg, key == "vehicle_poses")).unwrap_or(
            PoseSettings {
                given: Given::Start,
                white_m: m,
                white_deg: deg,
                slow_m: 0.0,
                slow_deg: 0.0,
                slow_s: 10.0,
            },
        )
    });
    let gnss = top.table("gnss", gnss);
    if poses[0].given == Given::Nothing && targets.count < 3 {
        top.error("targets", "three targets or more to find cameras from");
    }
    if poses[1].given == Given::Nothing && !terrain.is_known {
        top.error("terrain", "a known terrain to find vehicles on");
    }
    Some(Scenario {
        folder: folder.to_owned(),
        name: name?,
        seed: seed as u64,
        camera: camera?.0,
        video,
        flight: flight?,
        terrain,
        vehicles,
        targets,
        errors,
        poses,
        gnss,
    })
}

/// A whole number within bounds; `default` where there is none.
fn whole(section: &Section, key: &'static str, default: usize, least: f64, most: f64) -> usize {
    let wanted = format!("a whole number from {least} to {most}");
    let right = |v: f64| v.fract() == 0.0 && (least..=most).contains(&v);
    section.number(key, &wanted, right).map_or(default, |v| v as usize)
}

fn share(section: &Section, key: &'static str) -> f64 {
    section.number(key, "a share from 0 to 0.95", |v| (0.0..=0.95).contains(&v)).unwrap_or(0.0)
}

fn choice<T: Copy>(section: &Section, key: &'static str, choices: &[(&str, T)]) -> T {
    let (_, default) = choices[0];
    let Some(text) = section.text(key) else { return default };
    match choices.iter().find(|(name, _)| *name == text) {
        Some((_, choice)) => *choice,
        None => {
            let names: Vec<String> = choices.iter().map(|(name, _)| format!("{name:?}")).collect();
            section.error(key, &names.join(" or "));
            default
        }
    }
}

fn camera(section: &Section) -> Option<(CameraSettings, f64)> {
    let (camera, calibration, rate_hz, readout_s);
    if section.has("preset") {
        let name = section.text("preset")?;
        let Some(preset) = Preset::named(&name) else {
            let names: Vec<&str> = PRESETS.iter().map(|preset| preset.name).collect();
            section.error("preset", &format!("one of {}", names.join(", ")));
            return None;
        };
        (camera, calibration, rate_hz) = (preset.camera(), Calibration::default(), preset.rate_hz);
        readout_s = section.number("readout_s", "from -1 to 1", |v| v.abs() <= 1.0).unwrap_or(0.0);
    } else {
        let (read, refined, shutter) = read_camera(section)?;
        (camera, calibration, rate_hz, readout_s) = (read, refined, 30.0, shutter.readout_s);
    }
    let readout_sigma_s = section.not_negative("readout_sigma_s").unwrap_or(0.0);
    let mut calibration: Calibration = calibration;
    // Short for what a preset can have adjusted.
    for (key, which) in [("refine_focal_length", 0..1), ("refine_principal_point", 1..3)] {
        if section.has(key) && section.flag(key) == Some(true) {
            calibration[which].fill(Freedom::Free);
        }
    }
    Some((CameraSettings { camera, calibration, readout_s, readout_sigma_s }, rate_hz))
}

fn read_video(video: &Section, usual_hz: f64) -> VideoSettings {
    let rate_hz = video.number("rate_hz", "from 0.1 to 1000", |v| (0.1..=1000.0).contains(&v));
    let rate_hz = rate_hz.unwrap_or(usual_hz);
    let duration_s = video.positive("duration_s");
    if video.has("frames") && video.has("duration_s") {
        video.error("frames", "one of frames and duration_s");
    }
    let by_time = duration_s.map(|s| (s * rate_hz).round().max(2.0));
    if by_time.is_some_and(|frames| frames > MOST_FRAMES) {
        video.error("duration_s", "at most 100,000 frames");
    }
    let frames = by_time.filter(|v| *v <= MOST_FRAMES).map_or(150, |v| v as usize);
    VideoSettings { frames: whole(video, "frames", frames, 2.0, MOST_FRAMES), rate_hz }
}

fn flight(flight: &Section) -> Option<FlightSettings> {
    let altitude_m =
        flight.required("altitude_m", "a height above the ground", || flight.positive("altitude_m"));
    #[derive(Clone, Copy, PartialEq)]
    enum Kind {
        Hover,
        Straight,
        Orbit,
        Follow,
    }
    let kinds = [
        ("hover", Kind::Hover),
        ("straight", Kind::Straight),
        ("orbit", Kind::Orbit),
        ("follow", Kind::Follow),
    ];
    let kind = choice(flight, "kind", &kinds);
    let number = |key, of: Kind, default: f64| {
        let value = flight.any_number(key);
        if value.is_some() && kind != of {
            flight.error(key, "nothing with this kind of flight");
        }
        value.unwrap_or(default)
    };
    let (speed_mps, direction_deg) =
        (number("speed_mps", Kind::Straight, 5.0), number("direction_deg", Kind::Straight, 0.0));
    let (radius_m, turn_dps) = (number("radius_m", Kind::Orbit, 20.0), number("turn_dps", Kind::Orbit, 6.0));
    let course = match kind {
        Kind::Hover => Course::Hover,
        Kind::Straight => Course::Straight { speed_mps, direction_deg },
        Kind::Orbit => Course::Orbit { radius_m, turn_dps },
        Kind::Follow => Course::Follow,
    };
    if kind == Kind::Orbit && flight.has("tilt_deg") {
        flight.error("tilt_deg", "nothing: an orbit looks at its middle");
    }
    let tilt = flight.number("tilt_deg", "from -80 to 80 degrees", |v| v.abs() <= 80.0);
    let or = |key, default| flight.not_negative(key).unwrap_or(default);
    let lasts = |key, default| flight.positive(key).unwrap_or(default);
    Some(FlightSettings {
        course,
        altitude_m: altitude_m?,
        tilt_deg: tilt.unwrap_or(0.0),
        azimuth_deg: flight.any_number("azimuth_deg").unwrap_or(90.0),
        drift_m: or("drift_m", 0.3),
        drift_s: lasts("drift_s", 5.0),
        sway_deg: or("sway_deg", 0.3),
        sway_s: lasts("sway_s", 2.0),
        vibration_deg: or("vibration_deg", 0.0),
    })
}

fn read_terrain(terrain: &Section) -> TerrainSettings {
    let grid = terrain.text("grid");
    if terrain.has("grid") && terrain.has("plane_z_m") {
        terrain.error("plane_z_m", "one of plane_z_m and grid");
    }
    let or = |key, default| terrain.not_negative(key).unwrap_or(default);
    let measured = terrain.positive("cell_m").map(|cell_m| MeasuredGrid {
        cell_m,
        noise_m: or("noise_m", 0.0),
        reach_m: terrain.positive("reach_m").unwrap_or(60.0),
    });
    for key in ["noise_m", "reach_m"] {
        if terrain.has(key) && !terrain.has("cell_m") {
            terrain.error(key, "nothing without cell_m");
        }
    }
    if measured.is_some_and(|of| of.reach_m / of.cell_m > MOST_CELLS) {
        terrain
            .error("cell_m", &format!("at most {MOST_CELLS} cells from the origin to the end of the grid"));
    }
    TerrainSettings {
        measured: measured.filter(|of| of.reach_m / of.cell_m <= MOST_CELLS),
        grid,
        plane_z_m: terrain.any_number("plane_z_m").unwrap_or(0.0),
        is_known: terrain.flag("known").unwrap_or(true),
        sigma_m: or("sigma_m", 0.02),
        correlation_s: terrain.positive("correlation_s").unwrap_or(1.0),
        bias_sigma_m: or("bias_sigma_m", 0.0),
        tilt_sigma_deg: or("tilt_sigma_deg", 0.1),
    }
}

fn vehicle(vehicle: &Section) -> Option<VehicleSettings> {
    let id = read_vehicle_id(vehicle);
    let is_car = choice(vehicle, "kind", &[("other", false), ("car", true)]);
    let segments = vehicle.tables("segment", |segment| {
        let speed = "a speed of at least 0";
        Some(Segment {
            duration_s: segment
                .required("duration_s", "a time above 0", || segment.positive("duration_s"))?,
            speed_mps: segment.required("speed_mps", speed, || segment.not_negative("speed_mps"))?,
            curvature_per_m: segment.any_number("curvature_per_m").unwrap_or(0.0),
        })
    });
    let path = match vehicle.text("path") {
        Some(name) => {
            for key in ["speed_mps", "curvature_per_m", "segment"] {
                if vehicle.has(key) {
                    vehicle.error(key, "nothing with a path from a file");
                }
            }
            PathSettings::File(name)
        }
        None => PathSettings::Driven {
            speed_mps: vehicle.not_negative("speed_mps").unwrap_or(10.0),
            curvature_per_m: vehicle.any_number("curvature_per_m").unwrap_or(0.0),
            segments: segments.into_iter().flatten().collect(),
        },
    };
    let body = vehicle.table("body", |section| {
        if section.has("scan") {
            return Some(BodySettings::Scan(section.text("scan")?));
        }
        let size = |key, default| {
            section.number(key, "from 0.5 to 30 m", |v| (0.5..=30.0).contains(&v)).unwrap_or(default)
        };
        Some(BodySettings::Car {
            size_m: [size("length_m", 4.5), size("width_m", 1.8), size("height_m", 1.5)],
        })
    });
    let body = body.flatten().unwrap_or(BodySettings::Car { size_m: [4.5, 1.8, 1.5] });
    let number = |key| vehicle.any_number(key).unwrap_or(0.0);
    let or = |key, default| vehicle.not_negative(key).unwrap_or(default);
    Some(VehicleSettings {
        id: id?,
        is_car,
        x_m: number("x_m"),
        y_m: number("y_m"),
        heading_deg: number("heading_deg"),
        path,
        wander_m: or("wander_m", 0.2),
        side_wander_m: or("side_wander_m", 0.2),
        yaw_wander_deg: or("yaw_wander_deg", 0.8),
        wander_s: vehicle.positive("wander_s").unwrap_or(4.0),
        pitch_by_acceleration: number("pitch_deg_per_mps2"),
        roll_by_acceleration: number("roll_deg_per_mps2"),
        rear_axle_m: number("rear_axle_m"),
        body,
        points: whole(vehicle, "points", 100, 3.0, MOST_POINTS),
        track_s: vehicle.positive("track_s"),
        dropout: share(vehicle, "dropout"),
        grazing_deg: vehicle
            .number("grazing_deg", "from 10 to 180 degrees", |v| (10.0..=180.0).contains(&v))
            .unwrap_or(80.0),
        knowledge: KnowledgeSettings::read(vehicle),
    })
}

fn targets(targets: &Section) -> TargetSettings {
    let count = whole(targets, "count", 12, 0.0, 10_000.0);
    TargetSettings {
        count,
        check: whole(targets, "check", 0, 0.0, count as f64),
        spread_m: targets.positive("spread_m").unwrap_or(30.0),
        height_m: targets.not_negative("height_m").unwrap_or(0.5),
        sigma_m: targets.not_negative("sigma_m").unwrap_or(0.02),
    }
}

fn errors(errors: &Section) -> ErrorSettings {
    let or = |key, default| errors.not_negative(key).unwrap_or(default);
    let gross_px = [or("gross_from_px", 10.0), or("gross_to_px", 60.0)];
    if gross_px[1] <= gross_px[0] {
        errors.error("gross_to_px", "more than gross_from_px");
    }
    let really = errors.table("really", |section| {
        let factor = |key| section.not_negative(key).unwrap_or(1.0);
        Scatter {
            vehicle_px: factor("vehicle_px"),
            target_px: factor("target_px"),
            survey: factor("survey"),
            terrain: factor("terrain"),
            height: factor("height"),
        }
    });
    let beside = ["static_tracks", "sliding_tracks", "foreign_tracks"];
    let [static_tracks, sliding_tracks, foreign_tracks] = beside.map(|key| share(errors, key));
    if static_tracks + sliding_tracks + foreign_tracks > MOST_BESIDE {
        errors.error("static_tracks", "with sliding_tracks and foreign_tracks at most 0.95");
    }
    ErrorSettings {
        vehicle_px: errors.positive("vehicle_px").unwrap_or(1.0),
        target_px: errors.positive("target_px").unwrap_or(1.0),
        gross: share(errors, "gross"),
        gross_targets: share(errors, "gross_targets"),
        gross_px,
        ground_tracks: share(errors, "ground_tracks"),
        swapped_tracks: share(errors, "swapped_tracks"),
        static_tracks,
        sliding_tracks,
        foreign_tracks,
        focal: or("focal", 0.0),
        principal_px: or("principal_px", 0.0),
        really: really.unwrap_or(Scatter::AS_STATED),
    }
}

fn pose_settings(poses: &Section, usual_m: f64, usual_deg: f64, are_of_vehicles: bool) -> PoseSettings {
    let mut all = vec![
        ("start", Given::Start),
        ("known", Given::Known),
        ("exact", Given::Exact),
        ("none", Given::Nothing),
    ];
    if are_of_vehicles {
        all.push(("measured", Given::Measured));
    }
    let given = choice(poses, "given", &all);
    let number = |key: &'static str, default: f64| {
        let value = poses.not_negative(key);
        if value.is_some_and(|value| value > 0.0) && matches!(given, Given::Exact | Given::Nothing) {
            poses.error(key, "nothing with these poses");
        }
        value.unwrap_or(default)
    };
    PoseSettings {
        given,
        white_m: number("white_m", usual_m),
        white_deg: number("white_deg", usual_deg),
        slow_m: number("slow_m", 0.0),
        slow_deg: number("slow_deg", 0.0),
        slow_s: poses.positive("slow_s").unwrap_or(10.0),
    }
}

fn gnss(gnss: &Section) -> GnssSettings {
    GnssSettings {
        is_observation: choice(gnss, "use", &[("reference", false), ("observation", true)]),
        rate_hz: gnss.number("rate_hz", "from 0.01 to 1000", |v| (0.01..=1000.0).contains(&v)).unwrap_or(5.0),
        sigma_m: gnss.positive("sigma_m").unwrap_or(0.02),
        clock_offset_s: gnss.any_number("clock_offset_s").unwrap_or(0.0),
        clock_sigma_s: gnss.not_negative("clock_sigma_s"),
        shift_sigma_m: gnss.not_negative("shift_sigma_m").unwrap_or(0.0),
    }
}
