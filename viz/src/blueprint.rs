//! How the viewer opens: one tab for each layout.

mod send;

use crate::Layout;
use crate::error::RecordingError;
use crate::path::{self, below, part};
use crate::scene::{Body, Scene};
use crate::sdk::RecordingStream;
use crate::sdk::blueprint::{
    BarChartView, Blueprint, BlueprintPanel, ContainerLike, Horizontal, MapView, SelectionPanel,
    Spatial2DView, Spatial3DView, Tabs, TextDocumentView, TextLogView, TimePanel, TimeSeriesView, Vertical,
};
use crate::sdk::external::re_sdk_types::blueprint::components::{MapProvider, PanelState, PlayState};
use send::Eye;

/// From a body one looks from here, in shares of its length: from its left, from above.
const BESIDE: [f32; 3] = [-0.5, -0.7, 0.5];
/// ... and from farther away where it drives.
const AWAY: f32 = 2.5;

/// Sends the layout of these scenes.
pub fn send(scenes: &[Scene], top: Layout, stream: &RecordingStream) -> Result<(), RecordingError> {
    let eyes: Vec<Eye> = scenes.iter().flat_map(|scene| Views(scene).eyes()).collect();
    send::send(&layout(scenes, top), &eyes, stream)
}

/// The layout of these scenes; `top` is the tab in front. It opens on the timeline `frame`, paused at the first one.
fn layout(scenes: &[Scene], top: Layout) -> Blueprint {
    let mut tabs: Vec<(Layout, ContainerLike)> = Vec::new();
    if scenes.len() > 1 {
        tabs.push((Layout::Overview, side_by_side(scenes)));
    }
    for scene in scenes {
        let views = Views(scene);
        tabs.push((Layout::Overview, views.overview()));
        tabs.extend(scene.bodies.iter().map(|body| (Layout::Shape, views.shape(&body.id))));
        tabs.extend(scene.map.iter().map(|_| (Layout::Map, views.map())));
    }
    let (front, others): (Vec<_>, Vec<_>) = tabs.into_iter().partition(|(layout, _)| *layout == top);
    let tabs = Tabs::new(front.into_iter().chain(others).map(|(_, tab)| tab));
    Blueprint::new(ContainerLike::from(tabs))
        .with_auto_views(false)
        .with_blueprint_panel(BlueprintPanel::from_state(PanelState::Collapsed))
        .with_selection_panel(SelectionPanel::from_state(PanelState::Collapsed))
        .with_time_panel(
            TimePanel::new()
                .with_state(PanelState::Collapsed)
                .with_timeline("frame")
                .with_play_state(PlayState::Paused),
        )
}

fn tabs(views: Vec<ContainerLike>) -> ContainerLike {
    Tabs::new(views).into()
}

/// Curves of all scenes in one view. What is the same for all, the start and the reference, is there once.
fn curves(name: &str, scenes: &[&Scene], path: &str) -> ContainerLike {
    let of_scene = |(at, scene): (usize, &&Scene)| {
        let root = below(scene.root.as_deref(), path);
        let again = move |body: &Body| {
            ["before", "reference"].map(|name| format!("- /{root}/{}/{name}", part(&body.id)))
        };
        let others: Vec<String> =
            if at > 0 { scene.bodies.iter().flat_map(again).collect() } else { Vec::new() };
        std::iter::once(format!("+ /{}/**", below(scene.root.as_deref(), path))).chain(others)
    };
    let contents: Vec<String> = scenes.iter().enumerate().flat_map(of_scene).collect();
    TimeSeriesView::new(name).with_origin("/").with_contents(contents).into()
}

/// Curves over the film.
fn curves_of_time(scenes: &[&Scene]) -> Vec<ContainerLike> {
    let mut views = vec![
        curves("Speed [m/s]", scenes, path::SPEED),
        curves("Heading [deg]", scenes, path::HEADING),
        curves("Sigma of the track [m]", scenes, path::SIGMA),
        curves("Residuals, rms per frame [px]", scenes, path::RESIDUALS),
    ];
    let is_compared = |scene: &&Scene| scene.bodies.iter().any(|body| !body.reference.is_empty());
    if scenes.iter().any(is_compared) {
        views.insert(1, curves("Result minus reference, x and y [m]", scenes, path::ERRORS));
    }
    views
}

/// Several results in one tab: their worlds beside each other, their curves in the same views.
fn side_by_side(scenes: &[Scene]) -> ContainerLike {
    let views = || scenes.iter().map(Views);
    let all: Vec<&Scene> = scenes.iter().collect();
    let worlds = Horizontal::new(views().map(|view| view.world()));
    let texts = Horizontal::new(views().map(|view| view.summary()));
    Vertical::new([worlds.into(), tabs(curves_of_time(&all)), texts.into()])
        .with_row_shares([4.0_f32, 3.0, 3.0])
        .with_name("Side by side")
        .into()
}

/// Names of views.
const WORLD: &str = "World: orange before, blue after";
const BEFORE_AND_AFTER: &str = "Before (orange); after by sigma";
const PRECISION: &str = "After, with 95 % ellipsoids";
const SCAN: &str = "Shape (large) and scan (small), by distance";

/// The diagonal of the box around points, at least a metre, and its middle \[m\].
fn extent(points_m: &[[f64; 3]]) -> (f32, [f32; 3]) {
    let sides = [0, 1, 2].map(|axis| {
        let values = points_m.iter().map(|point| point[axis]);
        let (low, high) =
            values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
        if low <= high { [low, high] } else { [0.0, 0.0] }
    });
    let diagonal_m = sides.iter().map(|[low, high]| (high - low).powi(2)).sum::<f64>().sqrt();
    (diagonal_m.max(1.0) as f32, sides.map(|[low, high]| ((low + high) / 2.0) as f32))
}

struct Views<'a>(&'a Scene);

impl Views<'_> {
    fn at(&self, path: &str) -> String {
        below(self.0.root.as_deref(), path)
    }

    /// A name, and whose it is among several.
    fn named(&self, name: &str) -> String {
        match &self.0.root {
            Some(root) => format!("{root}: {name}"),
            None => name.to_owned(),
        }
    }

    fn world(&self) -> ContainerLike {
        let view = Spatial3DView::new(self.named(WORLD));
        view.with_origin(self.at(path::WORLD)).with_contents(["+ $origin/**"]).into()
    }

    /// The world around a body, which it follows; without what is far away.
    fn around(&self, body: &Body) -> ContainerLike {
        let view = Spatial3DView::new(self.following(body)).with_origin(self.at(path::WORLD));
        view.with_contents(["+ $origin/**", "- $origin/camera/**", "- $origin/camera_start/**"]).into()
    }

    fn following(&self, body: &Body) -> String {
        self.named(&format!("Following {}", body.id))
    }

    /// How views in three dimensions are first seen.
    fn eyes(&self) -> Vec<Eye> {
        let world = self.at(path::WORLD);
        let eye = |name: String, look_m: Option<[[f32; 3]; 2]>, follows: Option<String>| Eye {
            name,
            origin: world.clone(),
            look_m,
            follows,
        };
        let mut eyes = vec![eye(self.named(WORLD), None, None)];
        for body in &self.0.bodies {
            let (length_m, middle) = extent(&body.before.points_m);
            let entity = self.at(&format!("{}/{}/before", path::BODIES, part(&body.id)));
            let first = body.before.poses.first().map(|(_, pose)| pose.position_m);
            let look_m = first.map(|place| {
                let origin_m = self.0.local_origin_m();
                let at: [f32; 3] = std::array::from_fn(|axis| (place[axis] - origin_m[axis]) as f32);
                [std::array::from_fn(|axis| at[axis] + AWAY * length_m * BESIDE[axis]), at]
            });
            eyes.push(eye(self.following(body), look_m, Some(entity)));
            let origin = self.at(&format!("{}/{}", path::SHAPES, part(&body.id)));
            let from =
                [0, 1, 2].map(|axis| middle[axis] + length_m * [-BESIDE[0], BESIDE[1], BESIDE[2]][axis]);
            for name in [BEFORE_AND_AFTER, PRECISION, SCAN] {
                eyes.push(Eye {
                    name: name.to_owned(),
                    origin: origin.clone(),
                    look_m: Some([from, middle]),
                    follows: None,
                });
            }
        }
        eyes
    }

    fn summary(&self) -> ContainerLike {
        TextDocumentView::new(self.named("Summary")).with_origin(self.at(path::SUMMARY)).into()
    }

    fn overview(&self) -> ContainerLike {
        let camera = Spatial2DView::new(format!("Camera: residuals x {} [px]", self.0.residual_factor()))
            .with_origin(self.at(path::IMAGE))
            .with_contents(["+ $origin/**"]);
        let distribution = BarChartView::new("Residuals: how many of which size [px]")
            .with_origin(self.at(path::DISTRIBUTION));
        let legend = TextDocumentView::new("Legend").with_origin(self.at(path::LEGEND));
        let log = TextLogView::new("Log").with_origin(self.at(path::LOG)).with_contents(["+ $origin/**"]);
        let cost = BarChartView::new("Cost by iteration (log10)").with_origin(self.at(path::COST_BARS));
        let iterations =
            TimeSeriesView::new("Iterations (timeline: iteration)").with_origin(self.at(path::ITERATIONS));
        let mut below_world = curves_of_time(&[self.0]);
        below_world.push(distribution.into());
        let around = self.0.bodies.first().map(|body| self.around(body));
        let worlds = Horizontal::new([self.world()].into_iter().chain(around));
        let left = Vertical::new([worlds.into(), tabs(below_world)]).with_row_shares([3.0_f32, 2.0]);
        let mut texts = vec![self.summary(), legend.into(), log.into()];
        // They come later where nothing is adjusted yet.
        if !self.0.iterations.is_empty() || self.0.camera.after.is_empty() {
            texts.extend([cost.into(), iterations.into()]);
        }
        let texts = tabs(texts);
        let right = Vertical::new([camera.into(), texts]).with_row_shares([1.0_f32, 1.0]);
        Horizontal::new([left.into(), right.into()])
            .with_column_shares([3.0_f32, 2.0])
            .with_name(self.named("Overview"))
            .into()
    }

    /// The shape of a body before and after, against its scan, and how well it is known: ellipsoids hide what they
    /// belong to, and have a view of their own.
    fn shape(&self, id: &str) -> ContainerLike {
        let origin = self.at(&format!("{}/{}", path::SHAPES, part(id)));
        let view = |name: &str, contents: &[&str]| {
            let view = Spatial3DView::new(name).with_origin(origin.as_str());
            ContainerLike::from(view.with_contents(contents.iter().copied()))
        };
        let has_scan = self.0.bodies.iter().any(|body| body.id == id && body.scan.is_some());
        let before = view(BEFORE_AND_AFTER, &["+ $origin/before", "+ $origin/after", "+ $origin/iteration"]);
        let precision = view(PRECISION, &["+ $origin/precision", "+ $origin/after"]);
        let legend = TextDocumentView::new("Legend").with_origin(self.at(path::SHAPE_LEGEND)).into();
        // What is compared with most interest is on the left.
        let (left, mut right) = if has_scan {
            (view(SCAN, &["+ $origin/scan", "+ $origin/to_scan"]), vec![before, precision])
        } else {
            (before, vec![precision])
        };
        right.push(legend);
        let all = Horizontal::new([left, Vertical::new(right).into()]).with_column_shares([3.0_f32, 2.0]);
        all.with_name(self.named(&format!("Shape of {id}"))).into()
    }

    /// The viewer knows no map without a background: while this tab is in front, it asks OpenStreetMap for it.
    fn map(&self) -> ContainerLike {
        let view = MapView::new("Map: before orange, after blue, reference yellow")
            .with_origin(self.at(path::MAP))
            .with_map_provider(MapProvider::OpenStreetMap);
        let views = vec![curves("Speed [m/s]", &[self.0], path::SPEED), self.summary()];
        Horizontal::new([view.into(), Vertical::new(views).into()])
            .with_column_shares([3.0_f32, 2.0])
            .with_name(self.named("Map"))
            .into()
    }
}
