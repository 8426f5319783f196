//! Tracks on the Earth.

use super::{Recorded, Recorder, on_screen};
use crate::colour::{self, Colour};
use crate::path::{self, part};
use crate::scene::{Geodetic, TargetRole};
use crate::sdk::{GeoLineStrings, GeoPoints};

impl Recorder<'_> {
    /// Lines and points of the map.
    pub(super) fn map(&self) -> Recorded {
        let Some(map) = &self.scene.map else { return Ok(()) };
        self.map_line("camera", &map.camera_deg, colour::TIE, 1.0)?;
        for (role, name, colour) in [
            (TargetRole::Control, "control", colour::CONTROL),
            (TargetRole::Check, "check", colour::CHECK),
            (TargetRole::Tie, "tie", colour::TIE),
        ] {
            let of_role = map.targets_deg.iter().filter(|(found, _)| *found == role);
            let places: Vec<(f64, f64)> = of_role.map(|(_, at)| (at[0], at[1])).collect();
            if !places.is_empty() {
                let points =
                    GeoPoints::from_lat_lon(places).with_colors([colour]).with_radii([on_screen(4.0)]);
                self.fixed(&format!("{}/targets/{name}", path::MAP), &points)?;
            }
        }
        for track in &map.tracks {
            let id = part(&track.id);
            self.map_line(&format!("{id}/before"), &track.before_deg, colour::BEFORE, 1.0)?;
            self.map_line(&format!("{id}/after"), &track.after_deg, colour::AFTER, 3.0)?;
            self.map_line(&format!("{id}/reference"), &track.reference_deg, colour::REFERENCE, 1.5)?;
        }
        Ok(())
    }

    fn map_line(&self, name: &str, places: &[Geodetic], colour: Colour, width: f32) -> Recorded {
        if places.is_empty() {
            return Ok(());
        }
        let line: Vec<(f64, f64)> = places.iter().map(|at| (at[0], at[1])).collect();
        let lines = GeoLineStrings::from_lat_lon([line]).with_colors([colour]).with_radii([on_screen(width)]);
        self.fixed(&format!("{}/{name}", path::MAP), &lines)
    }
}
