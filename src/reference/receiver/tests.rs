use super::*;
use nalgebra::Point3;

const ORIGIN: [f64; 3] = [45.4, 11.9, 57.0];
const SETTING: &str = "[world]\norigin_latitude_deg = 45.4\norigin_longitude_deg = 11.9\norigin_height_m = 57.0\n\
                       [time]\nzero = 2026-05-01T10:00:00Z\n";

/// A drive of 20 positions at 5 Hz, east, north, up of the origin.
fn drive() -> Vec<(f64, Point3<f64>)> {
    (0..20)
        .map(|i| f64::from(i) * 0.2)
        .map(|t| (t, Point3::new(3.0 * t - 40.0, 8.0 * t + t * t, 1.5 - 0.1 * t)))
        .collect()
}

fn ecef(enu: Point3<f64>) -> Point3<f64> {
    earth::ecef_m(ORIGIN[0], ORIGIN[1], ORIGIN[2]).unwrap()
        + earth::enu_from_ecef(ORIGIN[0], ORIGIN[1]).transpose() * enu.coords
}

/// Latitude, longitude and height by the iteration of Bowring's textbook form.
fn geodetic(p: Point3<f64>) -> [f64; 3] {
    let (a, f) = (6_378_137.0, 1.0 / 298.257_223_563);
    let e2: f64 = f * (2.0 - f);
    let r = p.x.hypot(p.y);
    let mut b = (p.z / r / (1.0 - e2)).atan();
    let mut h = 0.0;
    for _ in 0..20 {
        let n = a / (1.0 - e2 * b.sin().powi(2)).sqrt();
        h = r / b.cos() - n;
        b = (p.z / r / (1.0 - e2 * n / (n + h))).atan();
    }
    [b.to_degrees(), p.y.atan2(p.x).to_degrees(), h]
}

fn sentence(body: &str) -> String {
    format!("${body}*{:02X}\n", body.bytes().fold(0, |sum, byte| sum ^ byte))
}

fn minutes(degrees: f64, width: usize) -> String {
    let whole = degrees.trunc();
    format!("{whole:0width$.0}{:011.8}", (degrees - whole) * 60.0)
}

/// The file of the drive; UTC is 18 s behind GPS time.
fn file(kind: &str) -> (&'static str, String) {
    let rows = |row: &dyn Fn(f64, Point3<f64>) -> String| {
        drive().iter().map(|(t, p)| row(*t, *p)).collect::<String>()
    };
    let pos = |header: &str, row: &dyn Fn(f64, Point3<f64>) -> String| {
        (".pos", format!("% program : test\n{header}\n{}", rows(row)))
    };
    let utc = |t: f64| format!("2026/05/01 10:00:{t:06.3}");
    match kind {
        "utc" => pos(
            "%  UTC  latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)   sdu(m)  sdne(m)  sdeu(m)  sdun(m) age(s)  ratio    vn(m/s) ve(m/s) vu(m/s)",
            &|t, p| {
                let [b, l, h] = geodetic(ecef(p));
                format!(
                    "{} {b:.10} {l:.10} {h:.5} 1 9 0.02 0.01 0.03 0 0 0 0 9 {} 3 -0.1\n",
                    utc(t),
                    8.0 + 2.0 * t
                )
            },
        ),
        "gpst" => pos(
            "%  GPST , x-ecef(m),y-ecef(m),z-ecef(m),Q,ns,sdx(m),sdy(m),sdz(m),sdxy(m),sdyz(m),sdzx(m)",
            &|t, p| {
                let e = ecef(p);
                // Variances of 1, 4 and 9 cm^2 to the east, north and up.
                let r = earth::enu_from_ecef(ORIGIN[0], ORIGIN[1]);
                let c = r.transpose() * Matrix3::from_diagonal(&Vector3::new(1e-4, 4e-4, 9e-4)) * r;
                let root = |v: f64| v.abs().sqrt().copysign(v);
                let cells = [e.x, e.y, e.z].map(|v| format!("{v:.6}")).join(",");
                let sigmas = [c[(0, 0)], c[(1, 1)], c[(2, 2)], c[(0, 1)], c[(1, 2)], c[(2, 0)]]
                    .map(|v| format!("{}", root(v)));
                format!("2026/05/01 10:00:{:06.3},{cells},1,9,{}\n", t + 18.0, sigmas.join(","))
            },
        ),
        "week" => {
            let base = "% ref pos   : 45.4 11.9 57.0\n%  GPST  e-baseline(m)  n-baseline(m)  u-baseline(m)   Q  ns   sde(m)   sdn(m)   sdu(m)";
            pos(base, &|t, p| {
                let seconds = 5.0 * 86_400.0 + 36_018.0 + t;
                format!("2416 {seconds:.3} {:.5} {:.5} {:.5} 1 9 0.01 0.02 0.03\n", p.x, p.y, p.z)
            })
        }
        "nmea" => (
            ".nmea",
            rows(&|t, p| {
                let [b, l, h] = geodetic(ecef(p));
                let time = format!("1000{t:06.3}");
                let (b, l) = (minutes(b, 2), minutes(l, 3));
                let gga = format!("GNGGA,{time},{b},N,{l},E,4,12,0.6,{:.4},M,45.1,M,1.0,0000", h - 45.1);
                let gst = format!("GNGST,{time},0.01,,,,0.02,0.01,0.03");
                let rmc = format!("GNRMC,{time},A,{b},N,{l},E,10.0,20.0,010526,,,R");
                format!("{}{}junk\n{}", sentence(&gga), sentence(&gst), sentence(&rmc))
            }),
        ),
        _ => (
            ".tum",
            format!("# time x y z\n{}", rows(&|t, p| format!("{t} {} {} {} 0 0 0 1\n", p.x, p.y, p.z))),
        ),
    }
}

fn read_folder(files: &[(&str, &str)]) -> (Vec<GnssPosition>, Findings) {
    let place = tempfile::tempdir().unwrap();
    std::fs::create_dir(place.path().join("reference")).unwrap();
    for (name, text) in files {
        std::fs::write(place.path().join("reference").join(name), text).unwrap();
    }
    let mut findings = Findings::default();
    let tracks = read(place.path(), &["car1".to_owned()], &mut findings).tracks;
    (tracks.into_iter().next().map(|found| found.2).unwrap_or_default(), findings)
}

fn read_drive(kind: &str, setting: &str) -> (Vec<GnssPosition>, Findings) {
    let (end, text) = file(kind);
    read_folder(&[(&format!("car1{end}"), &text), ("reference.toml", setting)])
}

#[test]
fn one_drive_is_the_same_in_every_format() {
    // Ten digits of a degree are 11 um, eight of a minute 18 um; NMEA has altitudes in 32 bits.
    for (kind, resolution_m) in [("utc", 2e-5), ("gpst", 1e-6), ("week", 1e-5), ("nmea", 8e-5), ("tum", 0.0)]
    {
        let (found, findings) = read_drive(kind, SETTING);
        assert!(!findings.is_invalid() && findings.warnings().is_empty(), "{kind}: {findings} {findings:?}");
        assert_eq!(found.len(), 20, "{kind}");
        for (found, (t, p)) in found.iter().zip(drive()) {
            assert!((found.time_s - t).abs() < 1e-9, "{kind} {t}: {}", found.time_s);
            assert!((found.position - p).norm() <= resolution_m, "{kind} {t}: {} {p}", found.position);
            let sigma_m = found.sigma_m.map(|sigma| sigma.unwrap_or(f64::NAN));
            if kind != "tum" {
                let off =
                    [0.01, 0.02, 0.03].iter().zip(sigma_m).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
                assert!(off < 1e-6, "{kind}: {sigma_m:?}");
            }
            if kind == "utc" {
                let off = found.velocity_mps.unwrap() - Vector3::new(3.0, 8.0 + 2.0 * t, -0.1);
                // Up and north there and at the origin differ by 1e-5.
                assert!(off.norm() < 2e-4, "{off}");
            }
        }
    }
}

#[test]
fn the_zero_of_time_has_its_scale() {
    let gps = SETTING.replace("10:00:00Z", "10:00:18").replace("[time]", "[time]\nscale = \"GPST\"");
    let zoned = SETTING.replace("10:00:00Z", "12:00:00+02:00");
    for (setting, wanted) in [(gps, 0.0), (zoned, 0.0), (SETTING.replace("10:00:00Z", "09:59:59.5Z"), 0.5)] {
        assert!((read_drive("utc", &setting).0[0].time_s - wanted).abs() < 1e-9, "{setting}");
    }
}

#[test]
fn a_zone_of_utm_is_shifted() {
    let setting = "[world]\nutm_zone = 32\nhemisphere = \"north\"\nshift_x_m = 727000.0\nshift_y_m = 5031000.0\nshift_z_m = 57.0\n\
                   [time]\nzero = 2026-05-01T10:00:00Z\n";
    let (found, findings) = read_drive("gpst", setting);
    assert!(!findings.is_invalid(), "{findings}");
    let (first, last) = (found[0].position, found[19].position);
    let there = drive();
    let (length, wanted) = ((last - first).norm(), (there[19].1 - there[0].1).norm());
    // The scale of the grid: 0.9996 at the meridian, 1 some 180 km from it; here 227 km.
    assert!((length / wanted - 1.00023).abs() < 1e-4, "{}", length / wanted);
    assert!((first.z - 1.5).abs() < 2e-3, "{first}");
}

#[test]
fn what_is_not_good_enough_is_left_out_and_counted() {
    let (end, text) = file("utc");
    let mixed: String = text
        .lines()
        .enumerate()
        .map(|(i, line)| if i == 5 || i == 7 { line.replace(" 1 9 ", " 2 9 ") } else { line.to_owned() } + "\n")
        .collect();
    let name = format!("car1{end}");
    let (found, findings) = read_folder(&[(&name, &mixed), ("reference.toml", SETTING)]);
    assert_eq!(found.len(), 18);
    assert_eq!(
        findings.warnings(),
        ["reference/car1.pos: left out by their quality (accepted: fix): 2 float"]
    );
    let both = format!("{SETTING}[quality]\naccept = [\"fix\", \"float\"]\n");
    assert_eq!(read_folder(&[(&name, &mixed), ("reference.toml", &both)]).0.len(), 20);
    let none = format!("{SETTING}[quality]\naccept = [\"ppp\"]\n");
    let (_, findings) = read_folder(&[(&name, &mixed), ("reference.toml", &none)]);
    assert!(findings.to_string().contains("accepted quality (ppp), found \"18 fix, 2 float\""), "{findings}");
}

#[test]
fn a_damaged_sentence_is_told_and_midnight_is_passed() {
    let (_, text) = file("nmea");
    let damaged = text.replacen("GNGGA,100000.200,45", "GNGGA,100000.200,46", 1);
    let (found, findings) = read_folder(&[("car1.nmea", &damaged), ("reference.toml", SETTING)]);
    assert_eq!(found.len(), 19);
    assert!(
        findings.warnings()[0].ends_with("left out: 1, the first in line 5"),
        "{:?}",
        findings.warnings()
    );
    // The sentence with the day comes last, after midnight.
    let gga =
        |time: &str| sentence(&format!("GNGGA,{time},4524.0,N,01154.0,E,4,12,0.6,11.9,M,45.1,M,1.0,0000"));
    let rmc = sentence("GNRMC,000000.200,A,4524.0,N,01154.0,E,10.0,20.0,020526,,,R");
    let night = [gga("235959.800"), gga("000000.000"), gga("000000.200"), rmc].concat();
    let (found, findings) = read_folder(&[("car1.nmea", &night), ("reference.toml", SETTING)]);
    assert!(!findings.is_invalid(), "{findings}");
    let times: Vec<f64> = found.iter().map(|p| p.time_s).collect();
    assert!((times[0] - 50_399.8).abs() < 1e-6 && (times[2] - 50_400.2).abs() < 1e-6, "{times:?}");
}

#[test]
fn what_is_wrong_is_named() {
    let wrong = |name: &str, text: &str, setting: &str, wanted: &str| {
        let (found, findings) = read_folder(&[(name, text), ("reference.toml", setting)]);
        let told = findings.to_string();
        assert!(found.is_empty() && told.contains(wanted), "{name} {wanted:?}: {told}");
    };
    let (_, utc) = file("utc");
    let (_, week) = file("week");
    let (_, nmea) = file("nmea");
    let pos = |text: &str, wanted: &str| wrong("car1.pos", text, SETTING, wanted);
    pos("", "car1.pos: expected a header line with a time scale");
    pos("2026/05/01 10:00:00 1 2 3 1\n", "car1.pos:1: expected a header line");
    pos(&utc.replace("10:00:00.400", "10:00:61.400"), "car1.pos:5: column time: expected yyyy/mm/dd");
    pos(
        &utc.replace("10:00:00.400", "10:00:00.200"),
        "car1.pos:5: expected a time after that of the line before (0.2 s)",
    );
    pos(
        &utc.replace("2026/05/01 10:00:00.400 45.", "2026/05/01 10:00:00.400 145."),
        "column latitude: expected a place on the Earth",
    );
    pos(
        &utc.replace("10:00:00.400 45", "10:00:00.400 nan"),
        "column latitude: expected a finite number, found \"nan",
    );
    pos(&utc.replace(" 1 9 ", " x 9 "), "column Q: expected a quality flag");
    pos(&utc.replace("latitude(deg)", "latitude(d'\")"), "expected a header line");
    pos(&utc.replace("test", "(lat/lon/height=WGS84/geodetic)"), "heights above the ellipsoid");
    pos(&week.replace("ref pos", "reference"), "expected a header line");
    pos(&week.replace("GPST", "UTC"), "column time");
    pos("%  GPST  latitude(deg) longitude(deg) height(m) Q\n2026/05/01\n", "column time");
    pos("%  GPST  latitude(deg) longitude(deg) height(m) Q\n2416 1e300 1 2 3 1\n", "column time");
    pos(
        "%  GPST  latitude(deg) longitude(deg) height(m) Q\n2416 1 1 2\n",
        "column height: expected a finite number, found \"nothing\"",
    );
    pos(
        "%  GPST  x-ecef(m) y-ecef(m) z-ecef(m) Q\n2416 1 1e308 1e308 1e308 1\n",
        "column x-ecef: expected a place on the Earth",
    );
    wrong("car1.nmea", "\u{0}\u{ff}\n", SETTING, "sentences GGA with positions");
    wrong("car1.nmea", &nmea.replace("RMC", "XXX"), SETTING, "RMC or ZDA with the day");
    wrong("car1.nmea", &sentence("GNGGA,what"), SETTING, "sentences GGA with positions");
    wrong(
        "car1.tum",
        "0 1 2 3 0 0 0 1\n1 x 2 3 0 0 0 1\n",
        SETTING,
        "car1.tum:2: expected eight finite numbers",
    );
    wrong("car1.tum", "# none\n", SETTING, "car1.tum: expected lines");
    wrong("car1.tum", "0 1 2 3 0 0 0 1\n0 1 2 3 0 0 0 1\n", SETTING, "car1.tum:2: expected a time after");

    let setting = |text: &str, wanted: &str| wrong("car1.pos", &utc, text, wanted);
    setting("", "column world");
    setting("[world]\nwhere = 1\n", "reference/reference.toml:2: expected keys of docs/formats.md");
    setting(&SETTING.replace("origin_height_m = 57.0", ""), "column world");
    setting(&SETTING.replace("45.4", "95.4"), "column world");
    setting(&SETTING.replace("[time]", "utm_zone = 32\n[time]"), "column world");
    setting(&SETTING.replace("2026-05-01T10:00:00Z", "1"), "column time");
    let without_time = SETTING.split("[time]").next().unwrap();
    setting(without_time, "reference/reference.toml: column time: expected zero, a date and time");
    setting(&SETTING.replace("[time]", "[time]\nscale = \"GPST\""), "column time");
    setting(&format!("{SETTING}[quality]\naccept = [\"good\"]\n"), "column quality.accept");
    let (_, findings) = read_folder(&[("car1.pos", &utc)]);
    assert!(findings.to_string().contains("which reference/car1.pos needs"), "{findings}");
}

#[test]
fn numbers_that_are_no_uncertainties_are_not_taken_for_some() {
    let (_, gpst) = file("gpst");
    let header = gpst.lines().nth(1).unwrap();
    let place = ecef(Point3::origin());
    let line =
        |tail: &str| format!("{header}\n2416 468018.0 {} {} {} 1 9 {tail}\n", place.x, place.y, place.z);
    let sigmas = |text: String| {
        let (found, findings) = read_folder(&[("car1.pos", &text), ("reference.toml", SETTING)]);
        assert!(!findings.is_invalid(), "{findings}");
        found[0].sigma_m
    };
    assert!(sigmas(line("0.01 0.01 0.01 0 0 0")).iter().all(|sigma| (sigma.unwrap() - 0.01).abs() < 1e-12));
    for tail in ["1e200 1e200 1e200 0 0 0", "-0.01 0.01 0.01 0 0 0", "0.01 0.01 nan 0 0 0", ""] {
        assert_eq!(sigmas(line(tail)), [None; 3], "{tail}");
    }
    let (_, nmea) = file("nmea");
    let body = "GNGST,100000.000,0.01,,,,-0.02,inf,0.03";
    let text = nmea.replacen(&sentence("GNGST,100000.000,0.01,,,,0.02,0.01,0.03"), &sentence(body), 1);
    assert!(text.contains("inf"));
    let (found, _) = read_folder(&[("car1.nmea", &text), ("reference.toml", SETTING)]);
    assert!(found[0].sigma_m[..2] == [None, None], "{:?}", found[0].sigma_m);
}

#[test]
fn a_log_that_was_cut_off_is_read_up_to_there() {
    let (_, text) = file("nmea");
    let (found, findings) =
        read_folder(&[("car1.nmea", &text[..text.len() - 20]), ("reference.toml", SETTING)]);
    assert_eq!((found.len(), findings.warnings().len()), (20, 1), "{findings:?}");
}

#[test]
fn a_setting_is_validated_whoever_needs_it() {
    let (_, tum) = file("tum");
    let (_, findings) = read_folder(&[("car1.tum", &tum), ("reference.toml", "what")]);
    assert!(findings.is_invalid());
    assert!(!read_folder(&[("car1.tum", &tum)]).1.is_invalid());
}
