//! The camera's view: the film, image points, residuals.

use super::{Recorded, Recorder, on_screen};
use crate::colour::{self, Colour};
use crate::error::RecordingError;
use crate::path;
use crate::scene::{Film, ImagePoint, Marking};
use crate::sdk::{Arrows2D, AssetVideo, EncodedImage, Points2D, VideoFrameReference};
use std::path::Path;

impl Recorder<'_> {
    /// The images themselves.
    pub(super) fn film(&self) -> Recorded {
        let entity = format!("{}/film", path::IMAGE);
        let failed =
            |file: &Path, error: std::io::Error| RecordingError::File(format!("{}: {error}", file.display()));
        match &self.scene.film {
            None => Ok(()),
            Some(Film::Images(files)) => {
                for (frame, file) in files.iter().enumerate() {
                    let Some(file) = file else { continue };
                    let image = EncodedImage::from_file(file).map_err(|error| failed(file, error))?;
                    self.appear(frame, &entity, &image)?;
                }
                Ok(())
            }
            Some(Film::Video { file, offset_s }) => {
                let asset = AssetVideo::from_file_path(file).map_err(|error| failed(file, error))?;
                self.fixed(&entity, &asset)?;
                let frames: Vec<usize> = (0..self.scene.frames.len()).collect();
                let seconds = self.scene.frames.iter().map(|frame| (frame.time_s + offset_s).max(0.0));
                let columns = VideoFrameReference::update_fields()
                    .with_many_timestamp(seconds.map(crate::sdk::components::VideoTimestamp::from_secs))
                    .columns_of_unit_batches()?;
                Ok(self.stream.send_columns(self.at(&entity), self.times(&frames), columns)?)
            }
        }
    }

    /// All observed points, before anything is known of them.
    pub(super) fn observed(&self) -> Recorded {
        self.image_layer(30.0, "observed", colour::OBSERVED, 2.0, |p| Some(p.observed_px))
    }

    /// Computed and rejected points, and residuals.
    pub(super) fn image_points(&self) -> Recorded {
        self.image_layer(33.0, "computed", colour::AFTER, 1.25, |p| p.computed_px)?;
        self.rejected()?;
        self.residual_arrows()
    }

    fn rejected(&self) -> Recorded {
        let is_rejected = |p: &&ImagePoint| p.marking == Marking::Rejected;
        let layer = "rejected";
        self.image_layer(32.0, layer, colour::REJECTED, 2.5, |p| {
            (p.marking == Marking::Rejected).then_some(p.observed_px)
        })?;
        let reasons: Vec<Vec<&str>> = self
            .scene
            .image_points
            .iter()
            .map(|points| points.iter().filter(is_rejected).map(|p| p.reason.unwrap_or_default()).collect())
            .collect();
        if reasons.iter().all(Vec::is_empty) {
            return Ok(());
        }
        let entity = self.at(&format!("{}/{layer}", path::IMAGE));
        // They are shown of the point that one points at: all at once hide the points.
        let shown = Points2D::update_fields().with_show_labels(false);
        self.stream.log_static(entity.as_str(), &shown)?;
        let frames: Vec<usize> = (0..reasons.len()).collect();
        let columns = Points2D::update_fields()
            .with_labels(reasons.iter().flatten().copied())
            .columns(reasons.iter().map(Vec::len).collect::<Vec<_>>())?;
        Ok(self.stream.send_columns(entity.as_str(), self.times(&frames), columns)?)
    }

    /// From the computed to the observed place of each image point that takes part, enlarged.
    fn residual_arrows(&self) -> Recorded {
        let entity = self.at(&format!("{}/residuals", path::IMAGE));
        let factor = self.scene.residual_factor();
        let arrow = |p: &ImagePoint| {
            let computed = p.computed_px.filter(|_| p.marking == Marking::Good)?;
            let along = |axis: usize| (factor * (p.observed_px[axis] - computed[axis])) as f32;
            Some((computed.map(|v| v as f32), [along(0), along(1)]))
        };
        let per_frame: Vec<Vec<_>> =
            self.scene.image_points.iter().map(|points| points.iter().filter_map(arrow).collect()).collect();
        if per_frame.iter().all(Vec::is_empty) {
            return Ok(());
        }
        let frames: Vec<usize> = (0..per_frame.len()).collect();
        let style = Arrows2D::update_fields()
            .with_colors([colour::RESIDUAL])
            .with_radii([on_screen(0.75)])
            .with_draw_order(31.0);
        self.stream.log_static(entity.as_str(), &style)?;
        let all = || per_frame.iter().flatten();
        let columns = Arrows2D::update_fields()
            .with_origins(all().map(|(origin, _)| *origin))
            .with_vectors(all().map(|(_, vector)| *vector))
            .columns(per_frame.iter().map(Vec::len).collect::<Vec<_>>())?;
        Ok(self.stream.send_columns(entity.as_str(), self.times(&frames), columns)?)
    }

    /// Points of each frame; those of a higher order lie on top.
    fn image_layer(
        &self,
        order: f32,
        name: &str,
        colour: Colour,
        radius: f32,
        pick: impl Fn(&ImagePoint) -> Option<[f64; 2]>,
    ) -> Recorded {
        let entity = self.at(&format!("{}/{name}", path::IMAGE));
        let frames: Vec<usize> = (0..self.scene.image_points.len()).collect();
        let per_frame: Vec<Vec<[f64; 2]>> =
            self.scene.image_points.iter().map(|points| points.iter().filter_map(&pick).collect()).collect();
        if per_frame.iter().all(Vec::is_empty) {
            return Ok(());
        }
        let style = Points2D::update_fields()
            .with_colors([colour])
            .with_radii([on_screen(radius)])
            .with_draw_order(order);
        self.stream.log_static(entity.as_str(), &style)?;
        let positions = per_frame.iter().flatten().map(|p| p.map(|v| v as f32));
        let columns = Points2D::update_fields()
            .with_positions(positions)
            .columns(per_frame.iter().map(Vec::len).collect::<Vec<_>>())?;
        Ok(self.stream.send_columns(entity.as_str(), self.times(&frames), columns)?)
    }
}
