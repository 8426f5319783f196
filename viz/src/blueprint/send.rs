//! A layout on its way to a stream, with properties of views that the library has types for but no way to set: it
//! is caught, and they are added beside their views.

use crate::colour;
use crate::error::RecordingError;
use crate::path::APPLICATION;
use crate::sdk::blueprint::Blueprint;
use crate::sdk::external::arrow::array::{Array, AsArray};
use crate::sdk::external::re_log_types::{BlueprintActivationCommand, LogMsg, TimePoint, Timeline};
use crate::sdk::external::re_sdk_types::blueprint::archetypes::{
    Background, EyeControls3D, LineGrid3D, PlotLegend,
};
use crate::sdk::external::re_sdk_types::blueprint::components::{BackgroundKind, Corner2D};
use crate::sdk::log::{Chunk, RowId};
use crate::sdk::{AsComponents, RecordingStream, RecordingStreamBuilder};

/// How a view in three dimensions is first seen.
pub struct Eye {
    /// The name of the view.
    pub name: String,
    /// Its origin.
    pub origin: String,
    /// From where to where one looks \[m\], if not as the viewer likes.
    pub look_m: Option<[[f32; 3]; 2]>,
    /// What it follows.
    pub follows: Option<String>,
}

/// Sends a layout with these eyes. Their views have one dark background, and no grid beside what is
/// recorded.
pub fn send(layout: &Blueprint, eyes: &[Eye], stream: &RecordingStream) -> Result<(), RecordingError> {
    let failed = |error: &dyn std::fmt::Display| RecordingError::Encoding(error.to_string());
    let (catcher, caught) = RecordingStreamBuilder::new(APPLICATION).enabled(true).memory()?;
    layout.send(&catcher, Default::default())?;
    catcher.flush_blocking().map_err(|error| failed(&error))?;
    let mut messages = Vec::new();
    let mut store = None;
    for message in caught.take() {
        match &message {
            LogMsg::ArrowMsg(id, arrow) if id.is_blueprint() => {
                store = Some(id.clone());
                let chunk = Chunk::from_arrow_msg(arrow).map_err(|error| failed(&error))?;
                let (name, origin) = (text(&chunk, "display_name"), text(&chunk, "space_origin"));
                messages.push(message);
                let is_its = |eye: &&Eye| {
                    name.as_deref() == Some(&eye.name)
                        && origin.as_deref().map(trimmed) == Some(trimmed(&eye.origin))
                };
                let of_eye = eyes.iter().find(is_its).map(Eye::properties);
                let class = text(&chunk, "class_identifier");
                let of_curves = (class.as_deref() == Some("TimeSeries")).then(curve_properties);
                if let (Some(properties), Some(id)) = (of_eye.or(of_curves), &store) {
                    for (property, archetype) in properties {
                        let entity = format!("{}/{property}", chunk.entity_path());
                        let time = TimePoint::from([(Timeline::new_sequence("blueprint"), 0)]);
                        let chunk = Chunk::builder(entity)
                            .with_archetype(RowId::new(), time, archetype.as_ref())
                            .build()
                            .and_then(|chunk| chunk.to_arrow_msg())
                            .map_err(|error| failed(&error))?;
                        messages.push(LogMsg::ArrowMsg(id.clone(), chunk));
                    }
                }
            }
            LogMsg::SetStoreInfo(info) if info.info.store_id.is_blueprint() => messages.push(message),
            _ => {}
        }
    }
    if let Some(blueprint_id) = store {
        let command = BlueprintActivationCommand { blueprint_id, make_active: true, make_default: true };
        stream.send_blueprint(messages, command);
    }
    Ok(())
}

/// The viewer writes a path with and without a slash in front.
fn trimmed(path: &str) -> &str {
    path.trim_start_matches('/')
}

/// The text of a component whose name ends like this.
fn text(chunk: &Chunk, component: &str) -> Option<String> {
    let mut columns = chunk.components().values();
    let column = columns.find(|column| column.descriptor.component.as_str().ends_with(component))?;
    let values = column.list_array.values();
    let texts = values.as_string_opt::<i32>()?;
    (texts.len() > 0).then(|| texts.value(0).to_owned())
}

/// Names and values of properties of a view.
type Properties = Vec<(&'static str, Box<dyn AsComponents>)>;

/// The legend of curves is where the film ends: it opens at its beginning.
fn curve_properties() -> Properties {
    vec![("PlotLegend", Box::new(PlotLegend::new().with_corner(Corner2D::RightBottom)))]
}

impl Eye {
    fn properties(&self) -> Properties {
        let mut controls = EyeControls3D::new();
        if let Some([from, to]) = self.look_m {
            controls = controls.with_position(from).with_look_target(to).with_eye_up([0.0, 0.0, 1.0]);
        }
        if let Some(entity) = &self.follows {
            controls = controls.with_tracking_entity(entity.as_str());
        }
        let grid = LineGrid3D::new().with_visible(false);
        let background = Background::new(BackgroundKind::SolidColor).with_color(colour::BACKGROUND);
        vec![
            ("EyeControls3D", Box::new(controls)),
            ("LineGrid3D", Box::new(grid)),
            ("Background", Box::new(background)),
        ]
    }
}
