//! Two photogrammetric adjustments with published statistics come out as published: a camera calibration with
//! fixed control points, and an aerial block with weighted ones. Where the data come from:
//! `tests/data/dbat/README.md`; the equations: `tests/support/photogrammetry.rs`.
//!
//! Covariances are a posteriori (multiplied by sigma0 squared). Image points have a standard deviation in pixels
//! of nominal size, also where the affinity is adjusted. An observation is a coordinate; of a control point only
//! where it is weighted. Fixed control points are no parameters, weighted ones are. Check points are object points
//! like all others.

use crate::support;

use nalgebra::{DMatrix, Vector3};
use std::collections::BTreeMap;
use support::in_package;
use support::photogrammetry::{
    ControlPoint, Exterior, INTERIOR, ImagePoint, Statistics, deviations, exterior_jacobian, exterior_of,
    intersection, pose_of, wrapped,
};
use trackbundle_solver::loss::Loss;
use trackbundle_solver::manifold::{Manifold, read_pose, write_pose};
use trackbundle_solver::minimise::{Minimiser, MinimiserOptions};
use trackbundle_solver::residual::worst_jacobian_entry;
use trackbundle_solver::system::{BlockId, Measurement, System, SystemBuilder, Values};

fn read(file: &str) -> String {
    let path = in_package("tests/data/dbat").join(file);
    std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// The fields of the rows of a table; `#` begins a comment.
fn rows(file: &str) -> Vec<Vec<String>> {
    let text = read(file);
    let lines = text.lines().filter(|line| !line.starts_with('#') && !line.trim().is_empty());
    lines.map(|line| line.split(',').map(|field| field.trim().to_owned()).collect()).collect()
}

fn number(field: &str) -> f64 {
    field.parse().unwrap_or_else(|_| panic!("{field} is no number"))
}

fn numbers<const N: usize>(fields: &[String]) -> [f64; N] {
    std::array::from_fn(|i| number(&fields[i]))
}

/// A number of the report, with what is printed below it.
#[derive(Debug, Default)]
struct Quantity {
    name: String,
    value: f64,
    deviation: Option<f64>,
    /// Those above 95 %.
    correlations: BTreeMap<String, f64>,
}

/// What a report says.
#[derive(Debug, Default)]
struct Report {
    sigma0: f64,
    redundancy: usize,
    parameters: usize,
    observations: usize,
    /// By camera and photo.
    quantities: BTreeMap<String, Vec<Quantity>>,
    /// Control and check points a posteriori: coordinates, then standard deviations.
    points: BTreeMap<u32, [f64; 6]>,
}

fn read_report(file: &str) -> Report {
    let mut report = Report::default();
    let (mut owner, mut is_posterior) = (String::new(), false);
    for line in read(file).lines().map(str::trim) {
        let (key, rest) = line.split_once(':').map_or((line, ""), |(key, rest)| (key, rest.trim()));
        let first = rest.split_whitespace().next().unwrap_or_default();
        let quantities = report.quantities.entry(owner.clone()).or_default();
        match key {
            "Sigma0" => report.sigma0 = number(first),
            "Number of params" => report.parameters = number(first) as usize,
            "Number of observations" => report.observations = number(first) as usize,
            "Value" => quantities.last_mut().unwrap().value = number(first),
            "Deviation" => quantities.last_mut().unwrap().deviation = Some(number(first)),
            "Correlations over 95%" => {
                let pairs = rest.trim_end_matches('.').split(',').filter_map(|pair| pair.split_once(':'));
                let percent = |text: &str| number(text.trim_end_matches(['%', '.'])) / 100.0;
                let pairs = pairs.map(|(name, value)| (name.trim().to_owned(), percent(value)));
                quantities.last_mut().unwrap().correlations = pairs.collect();
            }
            "Posterior" | "Prior" | "Diff (pos=abs diff, std=rel diff)" => is_posterior = key == "Posterior",
            "Camera1 (simple)" => owner = "Camera1".to_owned(),
            "Quality" => owner = String::new(),
            _ if key.starts_with("Redundancy") => {
                report.redundancy = number(key["Redundancy".len()..].trim()) as usize
            }
            _ if key.starts_with("Photo ") && !first.is_empty() => owner = key.to_owned(),
            _ if rest.is_empty() && line.ends_with(':') => {
                let name = key.split(" - ").next().unwrap_or(key).to_owned();
                quantities.push(Quantity { name, ..Default::default() });
            }
            _ if is_posterior => {
                let fields: Vec<String> = line.split(',').map(|field| field.trim().to_owned()).collect();
                if let Some(id) = fields.first().and_then(|id| id.parse().ok()) {
                    report.points.insert(id, numbers(&fields[1..7]));
                }
            }
            _ => {}
        }
    }
    report
}

impl Report {
    fn of(&self, owner: &str, name: &str) -> &Quantity {
        let found = self.quantities[owner].iter().find(|quantity| quantity.name == name);
        found.unwrap_or_else(|| panic!("{owner} has no {name}"))
    }
}

/// Names of an exterior orientation in a report, as [`Exterior`] has them.
const EXTERIOR: [&str; 6] = ["Xc", "Yc", "Zc", "Omega", "Phi", "Kappa"];

/// Names of an interior orientation, as [`INTERIOR`] has them, in a report and where it lists correlations.
const INTERIOR_NAMES: [(&str, &str); 9] = [
    ("Camera Constant", "cc"),
    ("px", "px"),
    ("py", "py"),
    ("as", "as"),
    ("K1", "K1"),
    ("K2", "K2"),
    ("K3", "K3"),
    ("P1", "P1"),
    ("P2", "P2"),
];

/// The largest of gaps, each in units of what is allowed.
#[derive(Default)]
struct Gaps(Vec<(f64, String)>);

impl Gaps {
    fn add(&mut self, what: impl Into<String>, ours: f64, published: f64, allowed: f64) {
        let what = format!("{}: {ours} against {published}", what.into());
        self.0.push(((ours - published).abs() / allowed, what));
    }

    fn close(&self, title: &str) {
        let (worst, what) = self.0.iter().max_by(|a, b| a.0.total_cmp(&b.0)).expect("something was compared");
        println!("{title}: {} numbers, worst {worst:.3} of what is allowed ({what})", self.0.len());
        assert!(*worst <= 1.0, "{title}: {worst} of what is allowed: {what}");
    }
}

/// What number `i` of an exterior orientation is more than another one; whole turns do not count.
fn gap(ours: f64, published: f64, i: usize) -> f64 {
    let gap = ours - published;
    if i < 3 { gap } else { wrapped(gap) }
}

/// Half a unit of the last digit of a number that is printed with so many significant ones.
fn half_unit(printed: f64, digits: i32) -> f64 {
    0.5000001 * 10_f64.powi(printed.abs().log10().floor() as i32 + 1 - digits)
}

struct Project {
    pixel_mm: f64,
    interior: [f64; 9],
    interior_is_free: bool,
    cameras: Vec<Exterior>,
    image_points: Vec<(usize, u32, [f64; 2], f64)>,
    /// Coordinates and their standard deviations; a fixed point has none.
    control: BTreeMap<u32, ([f64; 3], Option<[f64; 3]>)>,
}

struct Adjusted {
    system: System,
    values: Values,
    interior: BlockId,
    cameras: Vec<BlockId>,
    points: BTreeMap<u32, BlockId>,
    statistics: Statistics,
}

impl Project {
    /// Object points start where the rays of the starting cameras meet, control points where they were surveyed.
    fn adjust(&self) -> Adjusted {
        let poses: Vec<_> = self.cameras.iter().map(|exterior| pose_of(*exterior)).collect();
        let point_of =
            |measured_px: &[f64; 2]| ImagePoint { measured_px: *measured_px, pixel_mm: self.pixel_mm };
        let mut rays: BTreeMap<u32, Vec<_>> = BTreeMap::new();
        for (image, point, measured_px, _) in &self.image_points {
            let ray = point_of(measured_px).ray(&self.interior);
            rays.entry(*point).or_default().push((poses[*image], ray));
        }

        let mut builder = SystemBuilder::default();
        let interior = builder.add_block(INTERIOR, &self.interior, &[self.interior_is_free; 9]);
        let camera = |pose| builder.add_block(Manifold::Pose, &write_pose(pose), &[true; 6]);
        let cameras: Vec<BlockId> = poses.iter().map(camera).collect();
        let mut points = BTreeMap::new();
        for (id, rays) in &rays {
            let control = self.control.get(id);
            let start = control.map_or_else(|| intersection(rays).unwrap().coords.into(), |(at, _)| *at);
            let is_free = control.is_none_or(|(_, sigma_m)| sigma_m.is_some());
            points.insert(*id, builder.add_block(Manifold::POINT, &start, &[is_free; 3]));
        }
        let measurement = |(image, point, measured_px, sigma_px): &(usize, u32, [f64; 2], f64)| Measurement {
            residual: point_of(measured_px),
            blocks: [cameras[*image], interior, points[point]],
            sigma: [sigma_px * self.pixel_mm; 2],
        };
        let image_points = self.image_points.iter().map(measurement).collect();
        let image_points = builder.add_group("image points", Loss::Squared, image_points);
        let weighted = |(id, (at, sigma_m)): (&u32, &([f64; 3], Option<[f64; 3]>))| {
            let (residual, blocks) = (ControlPoint(Vector3::from(*at)), [points[id]]);
            Some(Measurement { residual, blocks, sigma: (*sigma_m)? })
        };
        let control = self.control.iter().filter_map(weighted).collect();
        let control = builder.add_group("control points", Loss::Squared, control);
        let system = builder.build();

        let options =
            MinimiserOptions { max_iterations: 100, relative_decrease: 1e-15, ..Default::default() };
        let mut minimiser = Minimiser::new(&system).unwrap();
        let minimum = minimiser.run(&system, system.start(), options, None);
        assert!(minimum.stop.converged() && minimum.cost.impossible == 0, "{}", minimum.stop);
        let observations = system.rows(image_points) + system.rows(control);
        let squares = 2.0 * minimum.cost.value;
        let statistics = Statistics::new(&system, &minimum.values, observations, squares);
        Adjusted { system, values: minimum.values, interior, cameras, points, statistics }
    }
}

impl Adjusted {
    fn value(&self, block: BlockId) -> &[f64] {
        self.system.value(&self.values, block)
    }

    fn covariance(&self, block: BlockId) -> DMatrix<f64> {
        self.statistics.covariance(&self.system, block)
    }

    /// The exterior orientation of an image and its covariance.
    fn exterior(&self, image: usize) -> (Exterior, DMatrix<f64>) {
        let block = self.cameras[image];
        let covariance = self.statistics.exterior_covariance(&self.system, &self.values, block);
        (exterior_of(&read_pose(self.value(block))), covariance)
    }

    fn has_the_published_counts_and_sigma0(&self, report: &Report) {
        let Statistics { observations, parameters, sigma0, .. } = self.statistics;
        assert_eq!(observations, report.observations, "observations");
        assert_eq!(parameters, report.parameters, "parameters");
        assert_eq!(self.statistics.redundancy(), report.redundancy, "redundancy");
        let mut gaps = Gaps::default();
        gaps.add("sigma0", sigma0, report.sigma0, half_unit(report.sigma0, 6));
        gaps.close("sigma0, to the digits printed");
    }

    /// Values, standard deviations and the correlations above 95 %, to the digits printed.
    fn has_the_published_exterior_orientations(&self, report: &Report) {
        let (mut values, mut sds, mut correlations) = (Gaps::default(), Gaps::default(), Gaps::default());
        for image in 0..self.cameras.len() {
            let owner = format!("Photo {}", image + 1);
            let (exterior, covariance) = self.exterior(image);
            let sd = deviations(&covariance);
            for (i, name) in EXTERIOR.iter().enumerate() {
                let published = report.of(&owner, name);
                let what = format!("{owner} {name}");
                let unit = if i < 3 { 1.0 } else { 1_f64.to_degrees() };
                let ours = published.value + gap(exterior[i], published.value / unit, i) * unit;
                // Half a unit of the sixth decimal, and what the published iteration stopped short of.
                values.add(&what, ours, published.value, 0.5e-6 + 1e-4 * sd[i] * unit);
                let published_sd = published.deviation.unwrap();
                sds.add(&what, sd[i] * unit, published_sd, half_unit(published_sd, 3));
            }
            correlations.add_correlations(&owner, &covariance, EXTERIOR.map(|name| (name, name)), report);
        }
        values.close("exterior orientations, to the decimals printed");
        sds.close("their standard deviations, to the digits printed");
        correlations.close("their correlations");
    }
}

impl Gaps {
    /// Correlations that are printed agree to the decimals printed; the others are below 95 %.
    fn add_correlations<const N: usize>(
        &mut self,
        owner: &str,
        covariance: &DMatrix<f64>,
        names: [(&str, &str); N],
        report: &Report,
    ) {
        let sd = deviations(covariance);
        for (i, (name, _)) in names.iter().enumerate() {
            let printed = &report.of(owner, name).correlations;
            for (j, (_, other)) in names.iter().enumerate().filter(|(j, _)| *j != i) {
                let ours = covariance[(i, j)] / (sd[i] * sd[j]);
                let what = format!("correlation of {name} and {other} of {owner}");
                match printed.get(*other) {
                    Some(published) => self.add(what, ours, *published, 0.5001e-3),
                    None => self.add(what, ours, 0.0, 0.95),
                }
            }
        }
    }
}

/// The calibration of a camera on a sheet of 100 points, four of them control points. Starts from the nominal
/// focal length, a principal point in the middle, no distortion, and cameras known to 10 cm and 0.1 rad.
fn calibration(control: BTreeMap<u32, ([f64; 3], Option<[f64; 3]>)>) -> Project {
    let (format_height_mm, height_px, width_px) = (5.43764, 1704.0, 2272.0);
    let pixel_mm = format_height_mm / height_px;
    let mut interior = [0.0; 9];
    interior[..3].copy_from_slice(&[7.5, 0.5 * width_px * pixel_mm, 0.5 * height_px * pixel_mm]);
    let stations = rows("camcaldemo/result/camera_stations.txt");
    let coarse = |station: &Vec<String>| numbers(&station[2..8]).map(|v: f64| (v / 0.1).round() * 0.1);
    let seen = |fields: Vec<String>| {
        let [image, point, u, v, sigma_px] = numbers(&fields);
        (image as usize - 1, point as u32, [u, v], sigma_px)
    };
    Project {
        pixel_mm,
        interior,
        interior_is_free: true,
        cameras: stations.iter().map(coarse).collect(),
        image_points: rows("camcaldemo/measurements/markpts.txt").into_iter().map(seen).collect(),
        control,
    }
}

fn calibration_control(file: &str) -> BTreeMap<u32, ([f64; 3], Option<[f64; 3]>)> {
    let control = |fields: Vec<String>| {
        let sigma_m = fields.get(5).map(|sigma_m| [number(sigma_m); 3]);
        (fields[0].parse().unwrap(), (numbers(&fields[2..5]), sigma_m))
    };
    rows(file).into_iter().map(control).collect()
}

/// Five aerial images of known interior orientation over 14 control and 2 check points. Starts from cameras known
/// to 10 m and 1 degree.
fn aerial_block(report: &Report) -> Project {
    const CHECK_POINTS: [u32; 2] = [351, 410];
    let coarse = |image: usize| {
        let owner = format!("Photo {image}");
        let value = |i: usize| report.of(&owner, EXTERIOR[i]).value;
        std::array::from_fn(|i| match i {
            0..3 => (value(i) / 10.0).round() * 10.0,
            _ => value(i).round().to_radians(),
        })
    };
    let seen = |file: &str, sigma_px: f64| {
        let point = move |fields: Vec<String>| {
            let [point, image, u, v] = numbers(&fields);
            (image as usize - 1, point as u32, [u, v], sigma_px)
        };
        rows(file).into_iter().map(point)
    };
    let marked = seen("sxb/measurements/markpts.txt", 0.5);
    let matched = seen("sxb/measurements/smartpts.txt", 1.0);
    let control = |fields: Vec<String>| {
        (fields[0].parse().unwrap(), (numbers(&fields[2..5]), Some(numbers(&fields[5..8]))))
    };
    let mut control: BTreeMap<_, _> =
        rows("sxb/reference/sxb-control.txt").into_iter().map(control).collect();
    control.retain(|id, _| !CHECK_POINTS.contains(id));
    Project {
        pixel_mm: 53.148 / 8858.0,
        interior: [123.9392, 26.577, 38.811, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        interior_is_free: false,
        cameras: (1..=5).map(coarse).collect(),
        image_points: marked.chain(matched).collect(),
        control,
    }
}

#[test]
fn a_camera_calibration_with_fixed_control_points_has_the_published_statistics() {
    let report = read_report("camcaldemo/result/report.txt");
    let adjusted = calibration(calibration_control("camcaldemo/reference/camcal-fixed.txt")).adjust();
    adjusted.has_the_published_counts_and_sigma0(&report);
    adjusted.has_the_published_exterior_orientations(&report);

    let (mut values, mut sds, mut correlations) = (Gaps::default(), Gaps::default(), Gaps::default());
    let covariance = adjusted.covariance(adjusted.interior);
    let sd = deviations(&covariance);
    for (i, (name, _)) in INTERIOR_NAMES.iter().enumerate() {
        let published = report.of("Camera1", name);
        let ours = adjusted.value(adjusted.interior)[i];
        values.add(*name, ours, published.value, half_unit(published.value, 6) + 1e-4 * sd[i]);
        let published_sd = published.deviation.unwrap();
        sds.add(*name, sd[i], published_sd, half_unit(published_sd, 3));
    }
    correlations.add_correlations("Camera1", &covariance, INTERIOR_NAMES, &report);
    values.close("interior orientation, to the digits printed");
    sds.close("its standard deviations, to the digits printed");
    correlations.close("its correlations");
}

/// The list of stations has many more digits than the report. Its angles are in radians, whatever its head says,
/// and all its standard deviations, those of lengths too, were multiplied by 180 / pi.
#[test]
fn the_camera_stations_of_the_calibration_agree_to_six_digits() {
    let adjusted = calibration(calibration_control("camcaldemo/reference/camcal-fixed.txt")).adjust();
    let (mut values, mut sds) = (Gaps::default(), Gaps::default());
    for (image, station) in rows("camcaldemo/result/camera_stations.txt").iter().enumerate() {
        let published: [f64; 12] = numbers(&station[2..14]);
        let (exterior, covariance) = adjusted.exterior(image);
        let sd = deviations(&covariance);
        for (i, name) in EXTERIOR.iter().enumerate() {
            let what = format!("{name} of {}", station[14]);
            let ours = published[i] + gap(exterior[i], published[i], i);
            values.add(&what, ours, published[i], 1e-4 * sd[i]);
            let published_sd = published[6 + i].to_radians();
            sds.add(&what, sd[i], published_sd, 1e-6 * published_sd);
        }
    }
    values.close("camera stations, to 1e-4 of their standard deviations");
    sds.close("their standard deviations, to 1e-6");
}

/// Nothing is published for these control points, 1 mm each. The counts follow from those with fixed ones: each
/// coordinate is an observation and a parameter more. The other numbers are those of an adjustment that shares no
/// code with this one (dense normal equations in angles, differences for derivatives).
#[test]
fn a_camera_calibration_with_weighted_control_points_has_the_same_redundancy() {
    let report = read_report("camcaldemo/result/report.txt");
    let control = calibration_control("camcaldemo/reference/camcal-weighted.txt");
    assert!(control.len() == 4 && control.values().all(|(_, sigma_m)| *sigma_m == Some([0.001; 3])));
    let adjusted = calibration(control).adjust();
    assert_eq!(adjusted.statistics.observations, report.observations + 12);
    assert_eq!(adjusted.statistics.parameters, report.parameters + 12);
    assert_eq!(adjusted.statistics.redundancy(), report.redundancy);
    let mut gaps = Gaps::default();
    gaps.add("sigma0", adjusted.statistics.sigma0, 1.425369429, 1e-8);
    let sd = deviations(&adjusted.covariance(adjusted.interior));
    let other = [
        9.24447784e-4,
        7.25334314e-4,
        8.66136987e-4,
        1.83447022e-5,
        1.95331777e-5,
        2.33760897e-6,
        8.88621766e-8,
        3.10831634e-6,
        3.47956898e-6,
    ];
    for ((ours, other), (name, _)) in sd.iter().zip(other).zip(INTERIOR_NAMES) {
        gaps.add(name, *ours, other, 1e-6 * other);
    }
    gaps.close("weighted control points, against an independent adjustment");
}

#[test]
fn control_points_weighted_as_good_as_exact_are_fixed_ones() {
    let report = read_report("camcaldemo/result/report.txt");
    let mut control = calibration_control("camcaldemo/reference/camcal-weighted.txt");
    control.values_mut().for_each(|(_, sigma_m)| *sigma_m = Some([1e-7; 3]));
    let adjusted = calibration(control).adjust();
    assert_eq!(adjusted.statistics.redundancy(), report.redundancy);
    let mut gaps = Gaps::default();
    gaps.add("sigma0", adjusted.statistics.sigma0, report.sigma0, half_unit(report.sigma0, 6));
    gaps.close("sigma0, to the digits printed");
    adjusted.has_the_published_exterior_orientations(&report);
}

#[test]
fn an_aerial_block_with_weighted_control_points_has_the_published_statistics() {
    let report = read_report("sxb/result/report.txt");
    let adjusted = aerial_block(&report).adjust();
    adjusted.has_the_published_counts_and_sigma0(&report);
    adjusted.has_the_published_exterior_orientations(&report);

    assert_eq!(report.points.len(), 16);
    let (mut values, mut sds) = (Gaps::default(), Gaps::default());
    for (id, published) in &report.points {
        let sd = deviations(&adjusted.covariance(adjusted.points[id]));
        for (i, axis) in ["X", "Y", "Z"].iter().enumerate() {
            let what = format!("{axis} of {id}");
            values.add(&what, adjusted.value(adjusted.points[id])[i], published[i], 0.5001e-3);
            sds.add(&what, sd[i], published[3 + i], half_unit(published[3 + i], 3));
        }
    }
    values.close("control and check points, to the millimetre printed");
    sds.close("their standard deviations, to the digits printed");
}

#[test]
fn an_image_point_has_the_jacobian_of_its_differences() {
    let camera = write_pose(&pose_of([0.4, -0.6, 1.5, 0.5, 0.2, -0.7]));
    let interior = [7.5, 3.6, 2.7, 4e-4, 4.6e-3, -4.5e-4, 2.1e-4, -6.1e-3, 4.4e-3];
    for measured_px in [[1429.2, 1156.5], [852.0, 400.0], [2100.0, 160.0]] {
        let residual = ImagePoint { measured_px, pixel_mm: 5.43764 / 1704.0 };
        let entry = worst_jacobian_entry(&residual, &[&camera, &interior, &[0.6, 0.3, -0.2]], 1e-6).unwrap();
        assert!(entry.gap < 2e-8, "{measured_px:?}: {entry:?}");
    }
    let control = ControlPoint(Vector3::new(1.0, 2.0, 3.0));
    assert!(worst_jacobian_entry(&control, &[&[0.5, 2.5, 2.0]], 1e-6).unwrap().gap < 1e-8);
}

#[test]
fn the_angles_of_a_camera_have_the_derivative_of_their_differences() {
    let exterior = [0.4, -0.6, 1.5, 0.5, -0.9, 2.7];
    let pose = pose_of(exterior);
    let gap = |a: Exterior, b: Exterior| (0..6).map(|i| (a[i] - b[i]).abs()).fold(0.0, f64::max);
    assert!(gap(exterior_of(&pose), exterior) < 1e-14);
    for column in 0..6 {
        let at = |step: f64| {
            let (mut delta, mut moved) = ([0.0; 6], [0.0; 7]);
            delta[column] = step;
            Manifold::Pose.plus(&write_pose(&pose), &delta, &mut moved);
            exterior_of(&read_pose(&moved))
        };
        let (after, before) = (at(1e-6), at(-1e-6));
        for row in 0..6 {
            let slope = (after[row] - before[row]) / 2e-6;
            let analytic = exterior_jacobian(&pose)[(row, column)];
            assert!((slope - analytic).abs() < 1e-8, "{row}, {column}: {analytic} against {slope}");
        }
    }
}
