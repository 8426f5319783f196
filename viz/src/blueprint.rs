//! How the viewer opens: one tab for each layout.

use crate::Layout;
use crate::path::{self, below, part};
use crate::scene::Scene;
use rerun::blueprint::{
    BarChartView, Blueprint, BlueprintPanel, ContainerLike, Horizontal, MapView, SelectionPanel,
    Spatial2DView, Spatial3DView, Tabs, TextDocumentView, TextLogView, TimePanel, TimeSeriesView, Vertical,
};
use rerun::external::re_sdk_types::blueprint::components::{MapProvider, PanelState, PlayState};

/// The layout of these scenes; `top` is the tab in front. It opens on the timeline `frame`, paused at the first one.
pub fn layout(scenes: &[Scene], top: Layout) -> Blueprint {
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

/// Curves of all scenes in one view.
fn curves(name: &str, scenes: &[&Scene], path: &str) -> ContainerLike {
    let contents = scenes.iter().map(|scene| format!("+ /{}/**", below(scene.root.as_deref(), path)));
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
        let view = Spatial3DView::new(self.named("World (before: orange, thin; after: blue, thick)"));
        view.with_origin(self.at(path::WORLD)).with_contents(["+ $origin/**"]).into()
    }

    fn summary(&self) -> ContainerLike {
        TextDocumentView::new(self.named("Summary")).with_origin(self.at(path::SUMMARY)).into()
    }

    fn overview(&self) -> ContainerLike {
        let camera = Spatial2DView::new("Camera: observed yellow, computed blue, residuals x 20 white")
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
        let left = Vertical::new([self.world(), tabs(below_world)]).with_row_shares([3.0_f32, 2.0]);
        let texts = tabs(vec![self.summary(), legend.into(), log.into(), cost.into(), iterations.into()]);
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
        let before = view(
            "Before (orange) and after, by sigma",
            &["+ $origin/before", "+ $origin/after", "+ $origin/iteration"],
        );
        let precision = view("After, with 95 % ellipsoids", &["+ $origin/precision", "+ $origin/after"]);
        let legend = TextDocumentView::new("Legend").with_origin(self.at(path::LEGEND)).into();
        let all = if has_scan {
            let scan =
                view("Scan (small) and shape (large), by distance", &["+ $origin/scan", "+ $origin/to_scan"]);
            let right = Vertical::new([before, tabs(vec![precision, legend])]);
            Horizontal::new([scan, right.into()]).with_column_shares([3.0_f32, 2.0])
        } else {
            Horizontal::new([before, Vertical::new([precision, legend]).into()])
                .with_column_shares([3.0_f32, 2.0])
        };
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
