//! How the viewer opens: the world and the shapes on the left, the camera's view and the curves on the
//! right.

use crate::path;
use rerun::blueprint::{
    BarChartView, Blueprint, BlueprintPanel, ContainerLike, Horizontal, SelectionPanel, Spatial2DView,
    Spatial3DView, Tabs, TextDocumentView, TimePanel, TimeSeriesView, Vertical,
};
use rerun::external::re_sdk_types::blueprint::components::{PanelState, PlayState};

/// The layout for bodies of these ids. It opens on the timeline `frame`, paused at the first one.
pub fn layout<'a>(bodies: impl Iterator<Item = &'a str>) -> Blueprint {
    let world = Spatial3DView::new("World").with_origin(path::WORLD).with_contents(["+ $origin/**"]);
    let camera = Spatial2DView::new("Camera: observed and computed image points, residuals x 20")
        .with_origin(path::IMAGE)
        .with_contents(["+ $origin/**"]);
    let speed = TimeSeriesView::new("Speed [m/s]").with_origin(path::SPEED);
    let heading = TimeSeriesView::new("Heading [deg]").with_origin(path::HEADING);
    let sigma = TimeSeriesView::new("Sigma of the track [m]").with_origin(path::SIGMA);
    let residuals = TimeSeriesView::new("Residuals, rms per frame [px]").with_origin(path::RESIDUALS);
    let cost = BarChartView::new("Cost by iteration (log10)").with_origin(path::COST_BARS);
    let iterations = TimeSeriesView::new("Iterations (timeline: iteration)").with_origin(path::ITERATIONS);
    let summary = TextDocumentView::new("Summary").with_origin(path::SUMMARY);
    let tabs = |views: Vec<ContainerLike>| ContainerLike::from(Tabs::new(views));
    let right = Vertical::new([
        camera.into(),
        tabs(vec![speed.into(), heading.into(), sigma.into(), residuals.into()]),
        tabs(vec![cost.into(), iterations.into(), summary.into()]),
    ])
    .with_row_shares([5.0_f32, 3.0, 3.0]);
    // Ellipsoids hide what they belong to: they have a view of their own.
    let shape = |id: &str, told: &str, contents: &[&str]| {
        let origin = format!("{}/{id}", path::SHAPES);
        let view = Spatial3DView::new(format!("Shape of {id}, {told}")).with_origin(origin);
        ContainerLike::from(view.with_contents(contents.iter().copied()))
    };
    let shapes: Vec<ContainerLike> = bodies
        .flat_map(|id| {
            [
                shape(id, "before and after", &["+ $origin/**", "- $origin/precision"]),
                shape(id, "95 % ellipsoids", &["+ $origin/precision", "+ $origin/after"]),
            ]
        })
        .collect();
    let left = if shapes.is_empty() {
        ContainerLike::from(world)
    } else {
        Vertical::new([world.into(), tabs(shapes)]).with_row_shares([3.0_f32, 2.0]).into()
    };
    let all = Horizontal::new([left, right.into()]).with_column_shares([3.0_f32, 2.0]);
    Blueprint::new(ContainerLike::from(all))
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
