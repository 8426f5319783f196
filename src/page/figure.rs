//! Diagrams as SVG: axes with units, and marks that stay apart in grey.

use crate::words::format::decimal;
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

/// Colours from dark to light: told apart by their lightness alone.
pub mod colour {
    use plotters::style::RGBColor;
    /// What was estimated.
    pub const RESULT: RGBColor = RGBColor(0, 70, 140);
    /// What it is compared with.
    pub const REFERENCE: RGBColor = RGBColor(230, 140, 0);
    /// What is neither.
    pub const OTHER: RGBColor = RGBColor(150, 150, 150);
}

/// Width of a drawing in its own units, alone and beside another; the page scales it.
const WIDTHS: [u32; 2] = [1400, 740];
const FONT: &str = "sans-serif";
const TEXT: i32 = 26;
/// A number from here on is told in a power of ten: positions in a national grid are not.
const LARGE: f64 = 1e9;

/// What is drawn, from the bottom up.
#[derive(Clone, Debug)]
pub enum Layer {
    /// A line; a number that is not finite breaks it.
    Line {
        /// Its corners.
        points: Vec<[f64; 2]>,
        /// Its colour.
        colour: RGBColor,
        /// Its width, in units of the drawing.
        width: u32,
        /// What it is, for the legend.
        label: &'static str,
    },
    /// An area between two curves.
    Band {
        /// `x`, lower and upper `y`.
        points: Vec<[f64; 3]>,
        /// Its colour.
        colour: RGBColor,
        /// What it is.
        label: &'static str,
    },
    /// Dots.
    Dots {
        /// Where.
        points: Vec<[f64; 2]>,
        /// Their colour.
        colour: RGBColor,
        /// Their radius, in units of the drawing.
        radius: u32,
        /// What they are.
        label: &'static str,
    },
    /// Bars that stand on zero: left, right, height.
    Bars {
        /// The bars.
        bars: Vec<[f64; 3]>,
        /// Their colour.
        colour: RGBColor,
        /// Outlines only.
        hollow: bool,
        /// What they are.
        label: &'static str,
    },
    /// Rectangles shaded by a share from 0 (white) to 1 (dark): left, right, low, high, share.
    Cells(Vec<[f64; 5]>),
    /// Arrows: from, to.
    Arrows(Vec<[[f64; 2]; 2]>),
    /// A straight line across the drawing at this `y`.
    Level(f64),
    /// A straight line up the drawing at this `x`.
    Upright(f64),
}

/// A diagram.
#[derive(Clone, Debug)]
pub struct Figure {
    /// What it shows, for those who cannot see it.
    pub title: String,
    /// What lies along x, with its unit.
    pub x: String,
    /// What lies along y, with its unit.
    pub y: String,
    /// The range of x; of the data where it is not given.
    pub x_range: Option<[f64; 2]>,
    /// The range of y, likewise.
    pub y_range: Option<[f64; 2]>,
    /// One unit is as long along x as along y.
    pub is_map: bool,
    /// `y` grows downwards, as in an image.
    pub y_down: bool,
    /// Height over width of the drawing.
    pub aspect: f64,
    /// What is drawn.
    pub layers: Vec<Layer>,
}

impl Figure {
    /// An empty one.
    pub fn new(title: impl Into<String>, x: impl Into<String>, y: impl Into<String>) -> Self {
        Figure {
            title: title.into(),
            x: x.into(),
            y: y.into(),
            x_range: None,
            y_range: None,
            is_map: false,
            y_down: false,
            aspect: 0.42,
            layers: Vec::new(),
        }
    }

    /// The corners of all layers.
    fn corners(&self) -> Vec<[f64; 2]> {
        let mut all = Vec::new();
        for layer in &self.layers {
            match layer {
                Layer::Line { points, .. } | Layer::Dots { points, .. } => all.extend(points),
                Layer::Band { points, .. } => {
                    all.extend(points.iter().flat_map(|[x, low, high]| [[*x, *low], [*x, *high]]));
                }
                Layer::Bars { bars, .. } => {
                    all.extend(bars.iter().flat_map(|[left, right, top]| [[*left, 0.0], [*right, *top]]));
                }
                Layer::Cells(cells) => {
                    all.extend(cells.iter().flat_map(|[l, r, low, high, _]| [[*l, *low], [*r, *high]]));
                }
                Layer::Arrows(arrows) => all.extend(arrows.iter().flatten()),
                Layer::Level(_) | Layer::Upright(_) => {}
            }
        }
        all.retain(|corner| corner.iter().all(|v| v.is_finite()));
        all
    }

    /// The ranges of both axes.
    fn ranges(&self, corners: &[[f64; 2]]) -> [[f64; 2]; 2] {
        let of = |axis: usize, given: Option<[f64; 2]>| {
            given.unwrap_or_else(|| {
                let least = corners.iter().map(|c| c[axis]).fold(f64::INFINITY, f64::min);
                let most = corners.iter().map(|c| c[axis]).fold(f64::NEG_INFINITY, f64::max);
                let (least, most) = if least <= most { (least, most) } else { (0.0, 1.0) };
                // Never without extent, not even far from zero.
                let size = most.abs().max(1.0);
                let margin = if most - least > 1e-9 * size { 0.04 * (most - least) } else { 1e-3 * size };
                [least - margin, most + margin]
            })
        };
        let stands_on_zero = self.layers.iter().any(|layer| matches!(layer, Layer::Bars { .. }));
        let [x, mut y] = [of(0, self.x_range), of(1, self.y_range)];
        if stands_on_zero && self.y_range.is_none() {
            y[0] = 0.0;
        }
        [x, y]
    }

    /// The same with the numbers of an axis multiplied.
    fn multiplied(&self, axis: usize, factor: f64) -> Figure {
        let mut figure = self.clone();
        // Where x and y stand in the numbers of a layer.
        let multiply = |numbers: &mut [f64], places: [&[usize]; 2]| {
            places[axis].iter().for_each(|at| numbers[*at] *= factor);
        };
        for layer in &mut figure.layers {
            match layer {
                Layer::Line { points, .. } | Layer::Dots { points, .. } => {
                    points.iter_mut().for_each(|point| multiply(point, [&[0], &[1]]));
                }
                Layer::Band { points, .. } => {
                    points.iter_mut().for_each(|point| multiply(point, [&[0], &[1, 2]]));
                }
                Layer::Bars { bars, .. } => bars.iter_mut().for_each(|bar| multiply(bar, [&[0, 1], &[2]])),
                Layer::Cells(cells) => {
                    cells.iter_mut().for_each(|cell| multiply(cell, [&[0, 1], &[2, 3]]));
                }
                Layer::Arrows(arrows) => {
                    arrows.iter_mut().flatten().for_each(|end| multiply(end, [&[0], &[1]]));
                }
                Layer::Level(y) => multiply(std::slice::from_mut(y), [&[], &[0]]),
                Layer::Upright(x) => multiply(std::slice::from_mut(x), [&[0], &[]]),
            }
        }
        let range = if axis == 0 { &mut figure.x_range } else { &mut figure.y_range };
        range.iter_mut().flatten().for_each(|end| *end *= factor);
        figure
    }

    /// The drawing, or nothing where there is nothing to draw. Beside another it is narrower, with letters
    /// as large.
    pub fn svg(&self, is_beside: bool) -> Option<String> {
        let width = WIDTHS[usize::from(is_beside)];
        let corners = self.corners();
        if corners.is_empty() {
            return None;
        }
        let [mut x, mut y] = self.ranges(&corners);
        // Numbers of many digits are told in a power of ten.
        for (axis, range) in [x, y].into_iter().enumerate() {
            let most = range[0].abs().max(range[1].abs());
            if !most.is_finite() {
                return None;
            }
            if most >= LARGE {
                let power = most.log10().floor() as i32;
                let mut figure = self.multiplied(axis, 10_f64.powi(-power));
                let label = if axis == 0 { &mut figure.x } else { &mut figure.y };
                *label += &format!(" / 1e{power}");
                return figure.svg(is_beside);
            }
        }
        let entries = self.entries();
        let legend = if entries.is_empty() { 0 } else { LEGEND_HEIGHT * rows_of(&entries, width) };
        let longest = y.iter().map(|v| decimal(*v, digits(y)).chars().count()).max().unwrap_or(0) as u32;
        let (left, below, other) = ((56 + 15 * longest).max(100), 90, 20);
        let mut height = (f64::from(width) * self.aspect).round();
        if self.is_map {
            // The drawing takes the shape of what is drawn, within bounds.
            let inner = [f64::from(width - left - other), height - f64::from(below + other)];
            let extent = [x[1] - x[0], y[1] - y[0]];
            let per_unit = (inner[0] / extent[0]).min(1.8 * inner[1] / extent[1]);
            height = (extent[1] * per_unit).clamp(0.3 * inner[0], 1.8 * inner[1]).round()
                + f64::from(below + other);
            let inner = [inner[0], height - f64::from(below + other)];
            let per_unit = (inner[0] / extent[0]).min(inner[1] / extent[1]);
            for (range, inner) in [(&mut x, inner[0]), (&mut y, inner[1])] {
                let (middle, half) = (0.5 * (range[0] + range[1]), 0.5 * inner / per_unit);
                *range = [middle - half, middle + half];
            }
        }
        if self.y_down {
            y.swap(0, 1);
        }
        let mut text = String::new();
        let size = [width, height as u32 + legend];
        let drawn = self.draw(&mut text, size, [x, y], [left, below, other, legend], &entries);
        // A drawing in memory cannot fail but for a range without extent, which there is none.
        drawn.ok()?;
        Some(self.described(&text))
    }

    /// The drawing with its title, for screen readers, and without sizes of its own.
    fn described(&self, text: &str) -> String {
        let title = escaped(&self.title);
        let begin = text.find('>').map_or(0, |at| at + 1);
        let head = &text[..begin];
        let view = head.find("viewBox").map_or("", |at| &head[at..]);
        let svg = format!("<svg role=\"img\" aria-label=\"{title}\" {view}");
        format!("{svg}<title>{title}</title>{}", &text[begin..])
    }

    fn draw(
        &self,
        text: &mut String,
        [width, height]: [u32; 2],
        [x, y]: [[f64; 2]; 2],
        [left, below, other, legend]: [u32; 4],
        entries: &[Entry],
    ) -> Result<(), Box<dyn std::error::Error>> {
        let root = SVGBackend::with_string(text, (width, height)).into_drawing_area();
        let (strip, below_it) = root.split_vertically(legend);
        draw_legend(&strip, entries, width)?;
        let mut chart = ChartBuilder::on(&below_it)
            .margin(other)
            .margin_left(4)
            .margin_bottom(4)
            .x_label_area_size(below - 4)
            .y_label_area_size(left - 4)
            .build_cartesian_2d(x[0]..x[1], y[0]..y[1])?;
        let (x_digits, y_digits) = (digits(x), digits(y));
        chart
            .configure_mesh()
            .x_desc(&self.x)
            .y_desc(&self.y)
            .x_labels(width as usize / 150)
            .y_labels(7)
            .x_label_formatter(&|value| decimal(*value, x_digits))
            .y_label_formatter(&|value| decimal(*value, y_digits))
            .label_style((FONT, TEXT))
            .axis_desc_style((FONT, TEXT + 2))
            .light_line_style(TRANSPARENT)
            .bold_line_style(RGBColor(225, 225, 225))
            .draw()?;
        for layer in &self.layers {
            draw_layer(&mut chart, layer, x, y)?;
        }
        root.present()?;
        Ok(())
    }

    /// What the legend tells.
    fn entries(&self) -> Vec<Entry<'_>> {
        let entry = |layer: &Layer| {
            let (label, colour, sign) = match layer {
                Layer::Line { colour, label, .. } => (label, *colour, Sign::Line),
                Layer::Band { colour, label, .. } => (label, *colour, Sign::Area(BAND)),
                Layer::Dots { colour, label, radius, .. } => {
                    (label, *colour, Sign::Dot((*radius + 3).min(9)))
                }
                Layer::Bars { colour, label, hollow, .. } => {
                    (label, *colour, if *hollow { Sign::Outline } else { Sign::Area(FILL) })
                }
                Layer::Arrows(_) | Layer::Cells(_) | Layer::Level(_) | Layer::Upright(_) => return None,
            };
            (!label.is_empty()).then_some(Entry { label, colour, sign })
        };
        self.layers.iter().filter_map(entry).collect()
    }
}

/// A line of a legend.
#[derive(Clone, Copy)]
struct Entry<'f> {
    label: &'f str,
    colour: RGBColor,
    sign: Sign,
}

impl Entry<'_> {
    /// Width that it takes.
    fn width(&self) -> i32 {
        84 + (self.label.chars().count() as i32 * TEXT * 54) / 100
    }
}

/// How a layer is told in a legend.
#[derive(Clone, Copy)]
enum Sign {
    Line,
    Area(f64),
    Outline,
    Dot(u32),
}

/// Height of a row of a legend.
const LEGEND_HEIGHT: u32 = 40;

/// Where each entry begins, from the left and from the top.
fn places(entries: &[Entry], width: u32) -> Vec<(i32, i32)> {
    let (mut x, mut y) = (20, 0);
    let place = |entry: &Entry| {
        if x > 20 && x + entry.width() > width as i32 {
            (x, y) = (20, y + LEGEND_HEIGHT as i32);
        }
        let at = (x, y);
        x += entry.width();
        at
    };
    entries.iter().map(place).collect()
}

/// How many rows a legend takes.
fn rows_of(entries: &[Entry], width: u32) -> u32 {
    places(entries, width).last().map_or(0, |(_, y)| *y as u32 / LEGEND_HEIGHT + 1)
}

type Area<'s> = DrawingArea<SVGBackend<'s>, plotters::coord::Shift>;
type Chart<'a, 's> = ChartContext<'a, SVGBackend<'s>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;
type Failed<'s> = DrawingAreaErrorKind<<SVGBackend<'s> as DrawingBackend>::ErrorType>;

/// The legend, above the drawing.
fn draw_legend<'s>(area: &Area<'s>, entries: &[Entry], width: u32) -> Result<(), Failed<'s>> {
    let style = (FONT, TEXT).into_font().color(&BLACK).pos(Pos::new(HPos::Left, VPos::Center));
    for (entry, (x, y)) in entries.iter().zip(places(entries, width)) {
        let Entry { label, colour, sign } = *entry;
        let middle = y + LEGEND_HEIGHT as i32 / 2;
        let bar = [(x + 4, middle - 10), (x + 36, middle + 10)];
        match sign {
            Sign::Line => {
                let ends = vec![(x, middle), (x + 40, middle)];
                area.draw(&PathElement::new(ends, colour.stroke_width(5)))?;
            }
            Sign::Area(strength) => area.draw(&Rectangle::new(bar, colour.mix(strength).filled()))?,
            Sign::Outline => area.draw(&Rectangle::new(bar, colour.stroke_width(3)))?,
            Sign::Dot(radius) => area.draw(&Circle::new((x + 20, middle), radius, colour.filled()))?,
        }
        area.draw(&Text::new(label.to_owned(), (x + 50, middle), style.clone()))?;
    }
    Ok(())
}

const BAND: f64 = 0.22;
const FILL: f64 = 0.75;

fn draw_layer<'s>(
    chart: &mut Chart<'_, 's>,
    layer: &Layer,
    x: [f64; 2],
    y: [f64; 2],
) -> Result<(), Failed<'s>> {
    let pair = |[x, y]: [f64; 2]| (x, y);
    let is_finite = |p: &[f64; 2]| p.iter().all(|v| v.is_finite());
    let area = chart.plotting_area();
    match layer {
        Layer::Line { points, colour, width, .. } => {
            for piece in points.split(|p| !is_finite(p)).filter(|piece| piece.len() > 1) {
                let piece = piece.iter().copied().map(pair).collect::<Vec<_>>();
                area.draw(&PathElement::new(piece, colour.stroke_width(*width)))?;
            }
        }
        Layer::Band { points, colour, .. } => {
            for piece in points.split(|p| !p.iter().all(|v| v.is_finite())).filter(|piece| piece.len() > 1) {
                let upper = piece.iter().map(|[x, _, high]| (*x, *high));
                let lower = piece.iter().rev().map(|[x, low, _]| (*x, *low));
                area.draw(&Polygon::new(upper.chain(lower).collect::<Vec<_>>(), colour.mix(BAND)))?;
            }
        }
        Layer::Dots { points, colour, radius, .. } => {
            for point in points.iter().filter(|p| is_finite(p)) {
                area.draw(&Circle::new(pair(*point), *radius, colour.filled()))?;
            }
        }
        Layer::Bars { bars, colour, hollow, .. } => {
            for [left, right, top] in bars {
                let corners = [(*left, 0.0), (*right, *top)];
                if *hollow {
                    area.draw(&Rectangle::new(corners, colour.stroke_width(3)))?;
                } else {
                    area.draw(&Rectangle::new(corners, colour.mix(FILL).filled()))?;
                }
            }
        }
        Layer::Cells(cells) => {
            for [left, right, low, high, share] in cells {
                let grey = |dark: f64| (255.0 - (255.0 - dark) * share.clamp(0.0, 1.0)).round() as u8;
                let shade = RGBColor(grey(0.0), grey(40.0), grey(90.0));
                area.draw(&Rectangle::new([(*left, *low), (*right, *high)], shade.filled()))?;
            }
        }
        Layer::Arrows(arrows) => {
            for [from, to] in arrows {
                area.draw(&PathElement::new(vec![pair(*from), pair(*to)], BLACK.stroke_width(2)))?;
                area.draw(&Circle::new(pair(*from), 4, BLACK.filled()))?;
            }
        }
        Layer::Level(at) => {
            area.draw(&PathElement::new(vec![(x[0], *at), (x[1], *at)], BLACK.stroke_width(1)))?;
        }
        Layer::Upright(at) => {
            area.draw(&PathElement::new(vec![(*at, y[0]), (*at, y[1])], BLACK.stroke_width(1)))?;
        }
    }
    Ok(())
}

/// So many digits tell the marks of an axis apart.
fn digits(range: [f64; 2]) -> usize {
    let step = (range[1] - range[0]).abs() / 8.0;
    (-step.log10().floor()).clamp(0.0, 9.0) as usize
}

/// Text that is safe within HTML.
pub fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn dots(points: Vec<[f64; 2]>) -> Figure {
        let mut figure = Figure::new("a <b> & \"c\"", "x (m)", "y (m)");
        figure.layers.push(Layer::Dots { points, colour: colour::RESULT, radius: 3, label: "" });
        figure
    }

    /// Centres of the discs of a drawing, in its units.
    fn discs(svg: &str) -> Vec<[f64; 2]> {
        let number = |text: &str, name: &str| -> f64 {
            let at = text.find(name).unwrap() + name.len();
            text[at..].split('"').next().unwrap().parse().unwrap()
        };
        svg.split("<circle").skip(1).map(|disc| [number(disc, "cx=\""), number(disc, "cy=\"")]).collect()
    }

    #[test]
    fn a_drawing_is_named_and_has_no_size_of_its_own() {
        let svg = dots(vec![[0.0, 1.0], [2.0, 3.0]]).svg(false).unwrap();
        assert!(svg.starts_with("<svg role=\"img\" aria-label=\"a &lt;b&gt; &amp; &quot;c&quot;\" viewBox"));
        assert!(svg.trim_end().ends_with("</svg>") && !svg.contains("<b>"));
        assert!(!svg[..svg.find('>').unwrap()].contains(" width="));
        for text in ["x (m)", "y (m)"] {
            assert!(svg.contains(text), "{text}");
        }
    }

    #[test]
    fn what_cannot_be_drawn_is_nothing() {
        assert_eq!(dots(Vec::new()).svg(false), None);
        assert_eq!(dots(vec![[f64::NAN, 1.0], [1.0, f64::INFINITY]]).svg(true), None);
        for one in [[0.0, 0.0], [3.9e6, -1e-300], [1e12, 1e12]] {
            assert_eq!(discs(&dots(vec![one; 3]).svg(true).unwrap()).len(), 3, "{one:?}");
        }
    }

    #[test]
    fn a_map_is_as_long_as_it_is_wide() {
        for (size, shift) in [(1.0, 0.0), (250.0, 3.9e6)] {
            for is_beside in [false, true] {
                let corners = [[0.0, 0.0], [size, 0.0], [0.0, size]];
                let mut figure = dots(corners.iter().map(|c| c.map(|v| v + shift)).collect());
                figure.is_map = true;
                let [a, b, c] = discs(&figure.svg(is_beside).unwrap())[..] else { panic!("three discs") };
                let (along, up) = (b[0] - a[0], a[1] - c[1]);
                assert!(along > 50.0 && (along - up).abs() <= 2.0, "{along} by {up}");
            }
        }
    }

    #[test]
    fn rows_of_an_image_go_down() {
        let mut figure = dots(vec![[0.0, 0.0], [1.0, 1.0]]);
        let up = discs(&figure.svg(false).unwrap());
        figure.y_down = true;
        let down = discs(&figure.svg(false).unwrap());
        assert!(up[1][1] < up[0][1] && down[1][1] > down[0][1]);
    }

    #[test]
    fn what_is_not_known_breaks_a_line() {
        let mut figure = dots(vec![[0.0, 0.0], [5.0, 1.0]]);
        let before = figure.svg(false).unwrap().matches("<polyline").count();
        let points =
            [0.0, 0.5, f64::NAN, 0.5, 0.7].iter().enumerate().map(|(at, y)| [at as f64, *y]).collect();
        figure.layers.push(Layer::Line { points, colour: colour::REFERENCE, width: 2, label: "" });
        assert_eq!(figure.svg(false).unwrap().matches("<polyline").count(), before + 2);
    }

    #[test]
    fn legends_take_the_rows_that_they_need() {
        let entry = |label| Entry { label, colour: colour::OTHER, sign: Sign::Line };
        let long = "a label of forty letters, more or less so";
        assert_eq!(rows_of(&[entry("GNSS"), entry("estimated")], 1400), 1);
        assert_eq!(rows_of(&[entry(long); 3], 740), 3);
        assert_eq!(decimal(-0.001, 2), "0.00");
        assert_eq!(decimal(-1.5, 1), "\u{2212}1.5");
    }
}
