//! A shape against its scan: Figures 6 to 8 of the literature.

use super::content::{Headline, Section, Table};
use super::figure::{Figure, Layer, colour};
use crate::cloud::DistanceStatistics;
use crate::evaluate::shape::{BEYOND_M, ShapeComparison};
use crate::words::format::{DASH, FIXED_SPACE, cm, cm_or_dash, decimal, percent_of};
use nalgebra::{Point3, Vector3};
use plotters::style::RGBColor;
use std::collections::HashMap;

/// Classes of distances: upper end \[m\], name, colour (the darker the worse), radius of a dot.
const CLASSES: [(f64, &str, RGBColor, u32); 5] = [
    (0.01, "below 1 cm", RGBColor(122, 190, 80), 4),
    (0.02, "1 to 2 cm", RGBColor(34, 150, 130), 5),
    (0.05, "2 to 5 cm", RGBColor(42, 110, 142), 5),
    (0.10, "5 to 10 cm", RGBColor(65, 60, 135), 6),
    (f64::INFINITY, "above 10 cm", RGBColor(60, 0, 70), 8),
];

/// More dots of a scan are not drawn.
const MOST_DOTS: usize = 6_000;
/// A dot of a scan hides what lies behind it within this \[m\].
const HIDING_M: f64 = 0.12;
/// ... and farther from the eye than it by this \[m\].
const BEHIND_M: f64 = 0.4;

/// What a reader should see first of a shape.
pub fn headline(found: &ShapeComparison) -> Headline {
    let all = &found.to_scan;
    Headline {
        name: format!("Shape of {}", found.vehicle),
        value: percent_of(all.within[2], 1, " "),
        meaning: "of its points are within 5 cm of the scan".to_owned(),
        more: format!(
            "median {}, 95 % within {}; {} points, {} of them farther than {:.0} cm from any of the scan; registered {}",
            cm(all.median_m),
            cm(all.percentiles_m[3]),
            all.count,
            found.beyond(),
            100.0 * BEYOND_M,
            found.registration_told()
        ),
        link: "shape",
    }
}

/// Adds a vehicle to the section.
pub fn add(section: &mut Section, found: &ShapeComparison) {
    let vehicle = &found.vehicle;
    section.heading(format!("Vehicle {vehicle}"));
    section.text(format!(
        "{} shape points against {} points of {}. Registration: {}.",
        found.points.len(),
        found.scan.len(),
        found.file,
        found.registration_told()
    ));
    for note in &found.notes {
        section.text(note.clone());
    }
    section.table(distances(found));
    if let Some(table) = truth(found) {
        section.table(table);
    }
    let places: Vec<Point3<f64>> = found.points.iter().map(|p| p.in_scan).collect();
    let views = [
        ("Figure 6", 35.0_f64, "from the front and the left"),
        ("Figure 7", 215.0, "from the rear and the right"),
    ];
    for (name, azimuth_deg, from) in views {
        let view = View::new(azimuth_deg, 25.0, &found.scan);
        section.figures(
            format!("{name} ({vehicle})"),
            format!("The scan (a) and the estimated points (b), {from}, in the frame of the scan. Points are coloured by their distance to it, the darker and larger the worse."),
            &[("(a) scan", view.scan(&found.scan)), ("(b) estimated points", view.points(found, &places))],
        );
    }
    section.figures(
        format!("Figure 8 ({vehicle})"),
        format!(
            "Distribution of the distances from the estimated points to the scan: to its nearest point (cloud to cloud), and to its local plane. {} % are within 5 cm of a point of the scan.",
            decimal(100.0 * found.to_scan.within[2], 1)
        ),
        &[("", histogram(found))],
    );
}

fn distances(found: &ShapeComparison) -> Table {
    let mut table = Table::new(
        "Distances",
        &[
            "of",
            "count",
            "median",
            "MAD",
            "mean",
            "rms",
            "68 %",
            "95 %",
            "within 1 cm",
            "2 cm",
            "5 cm",
            "10 cm",
        ],
    );
    let mut add = |name: &str, s: &DistanceStatistics| {
        let percent = |share: f64| percent_of(share, 1, FIXED_SPACE);
        table.row([
            name.to_owned(),
            s.count.to_string(),
            cm(s.median_m),
            cm(s.mad_m),
            cm(s.mean_m),
            cm(s.rms_m),
            cm(s.percentiles_m[1]),
            cm(s.percentiles_m[3]),
            percent(s.within[0]),
            percent(s.within[1]),
            percent(s.within[2]),
            percent(s.within[3]),
        ]);
    };
    for (name, statistics) in found.statistics() {
        add(&name, statistics);
    }
    table
}

fn truth(found: &ShapeComparison) -> Option<Table> {
    let errors = found.truth.as_ref()?;
    let mut table = Table::new(
        "Point to point, against the truth of the problem",
        &["fit", "count", "median", "rms", "95 %", "within 5 cm", "scale found"],
    );
    for (name, s, scale) in errors.fits() {
        table.row([
            name.to_owned(),
            s.count.to_string(),
            cm(s.median_m),
            cm(s.rms_m),
            cm_or_dash(Some(s.percentiles_m[3])),
            percent_of(s.within[2], 1, " "),
            scale.map_or(DASH.to_owned(), |v| decimal(v, 5)),
        ]);
    }
    Some(table)
}

/// A parallel projection.
struct View {
    right: Vector3<f64>,
    up: Vector3<f64>,
    toward_eye: Vector3<f64>,
    /// How near to the eye the scan comes, by cells across the view.
    nearest_m: HashMap<[i64; 2], f64>,
    /// What is seen is drawn about it.
    centre: Point3<f64>,
}

impl View {
    /// Seen from this azimuth, from x towards y, and elevation.
    fn new(azimuth_deg: f64, elevation_deg: f64, scan: &[Point3<f64>]) -> Self {
        let ((sa, ca), (se, ce)) = (azimuth_deg.to_radians().sin_cos(), elevation_deg.to_radians().sin_cos());
        let count = scan.len().max(1) as f64;
        let first = scan.first().copied().unwrap_or_default();
        let centre = first + scan.iter().map(|p| p - first).sum::<Vector3<f64>>() / count;
        let mut view = View {
            right: Vector3::new(-sa, ca, 0.0),
            up: Vector3::new(-se * ca, -se * sa, ce),
            toward_eye: Vector3::new(ce * ca, ce * sa, se),
            nearest_m: HashMap::new(),
            centre,
        };
        for point in scan {
            let near = (point - centre).dot(&view.toward_eye);
            let cell = view.cell(view.place(point));
            for (du, dv) in [(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)] {
                let nearest = view.nearest_m.entry([cell[0] + du, cell[1] + dv]).or_insert(near);
                *nearest = nearest.max(near);
            }
        }
        view
    }

    fn place(&self, point: &Point3<f64>) -> [f64; 2] {
        let from_centre = point - self.centre;
        [from_centre.dot(&self.right), from_centre.dot(&self.up)]
    }

    fn cell(&self, place: [f64; 2]) -> [i64; 2] {
        place.map(|v| (v / HIDING_M).floor() as i64)
    }

    /// Whether the scan does not hide it.
    fn is_seen(&self, point: &Point3<f64>) -> bool {
        let near = (point - self.centre).dot(&self.toward_eye);
        self.nearest_m.get(&self.cell(self.place(point))).is_none_or(|nearest| near > nearest - BEHIND_M)
    }

    fn figure(&self, title: &str) -> Figure {
        let mut figure = Figure::new(title, "across the view (m)", "up the view (m)");
        figure.is_map = true;
        figure.aspect = 0.75;
        figure
    }

    fn scan(&self, scan: &[Point3<f64>]) -> Figure {
        let seen: Vec<[f64; 2]> = scan.iter().filter(|p| self.is_seen(p)).map(|p| self.place(p)).collect();
        let step = seen.len().div_ceil(MOST_DOTS).max(1);
        let mut figure = self.figure("The scan");
        figure.layers.push(Layer::Dots {
            points: seen.into_iter().step_by(step).collect(),
            colour: RGBColor(90, 90, 90),
            radius: 2,
            label: "scan",
        });
        self.frame(&mut figure, scan);
        figure
    }

    fn points(&self, found: &ShapeComparison, places: &[Point3<f64>]) -> Figure {
        let mut figure = self.figure("The estimated points");
        let mut from = f64::NEG_INFINITY;
        for (to, label, colour, radius) in CLASSES {
            let of_class =
                found.points.iter().zip(places).filter(|(p, _)| p.nearest_m >= from && p.nearest_m < to);
            let points: Vec<[f64; 2]> =
                of_class.filter(|(_, at)| self.is_seen(at)).map(|(_, at)| self.place(at)).collect();
            figure.layers.push(Layer::Dots { points, colour, radius, label });
            from = to;
        }
        self.frame(&mut figure, &found.scan);
        figure
    }

    /// Both drawings of a view show the same part of the world.
    fn frame(&self, figure: &mut Figure, scan: &[Point3<f64>]) {
        let mut ranges = [[f64::INFINITY, f64::NEG_INFINITY]; 2];
        for place in scan.iter().map(|p| self.place(p)) {
            for (range, value) in ranges.iter_mut().zip(place) {
                *range = [range[0].min(value), range[1].max(value)];
            }
        }
        let [x, y] = ranges.map(|[least, most]| [least - 0.2, most + 0.2]);
        (figure.x_range, figure.y_range) = (Some(x), Some(y));
    }
}

fn histogram(found: &ShapeComparison) -> Figure {
    const BIN_M: f64 = 0.005;
    const BINS: usize = 30;
    let bars = |values: &mut dyn Iterator<Item = f64>| {
        let mut counts = [0_usize; BINS];
        values.for_each(|v| counts[((v.abs() / BIN_M) as usize).min(BINS - 1)] += 1);
        let bar = |(at, count): (usize, &usize)| {
            [100.0 * BIN_M * at as f64, 100.0 * BIN_M * (at + 1) as f64, *count as f64]
        };
        counts.iter().enumerate().map(bar).collect()
    };
    let mut figure = Figure::new(
        format!("Distribution of the distances of {} to the scan", found.vehicle),
        "distance (cm); the last bar is all that is beyond",
        "points per 0.5 cm",
    );
    figure.layers.push(Layer::Bars {
        bars: bars(&mut found.points.iter().map(|p| p.nearest_m)),
        colour: colour::RESULT,
        hollow: false,
        label: "to the nearest point of the scan",
    });
    figure.layers.push(Layer::Bars {
        bars: bars(&mut found.points.iter().map(|p| p.plane_m)),
        colour: colour::REFERENCE,
        hollow: true,
        label: "to its local plane",
    });
    figure.layers.push(Layer::Upright(5.0));
    figure.x_range = Some([0.0, 100.0 * BIN_M * BINS as f64]);
    figure.aspect = 0.36;
    figure
}
