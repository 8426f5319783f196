//! What is to be read.

use super::{Recorded, Recorder};
use crate::path;
use crate::sdk::{MediaType, TextDocument, TextLog, TextLogLevel};

const LEGEND: &str = include_str!("legend.md");
const SHAPE_LEGEND: &str = include_str!("shape_legend.md");

impl Recorder<'_> {
    /// The summary, what is odd, and where zero is.
    pub(super) fn summary(&self) -> Recorded {
        let [x, y, z] = self.origin_m;
        let mut text = format!("{}\n\n", self.scene.summary);
        if !self.scene.warnings.is_empty() {
            text += "## Warnings\n\n";
            self.scene.warnings.iter().for_each(|warning| text += &format!("- {warning}\n"));
            text += "\n";
        }
        text +=
            &format!("Zero of this recording is ({x}, {y}, {z}) m in the world of the problem (x, y, z).\n");
        self.fixed(path::SUMMARY, &TextDocument::new(text).with_media_type(MediaType::MARKDOWN))
    }

    pub(super) fn legends(&self) -> Recorded {
        let legend = LEGEND.replace("{factor}", &self.scene.residual_factor().to_string());
        for (entity, text) in [(path::LEGEND, legend.as_str()), (path::SHAPE_LEGEND, SHAPE_LEGEND)] {
            self.fixed(entity, &TextDocument::new(text).with_media_type(MediaType::MARKDOWN))?;
        }
        Ok(())
    }

    /// Warnings, which belong to no time.
    pub(super) fn log(&self) -> Recorded {
        for (at, warning) in self.scene.warnings.iter().enumerate() {
            let text = TextLog::new(warning.as_str()).with_level(TextLogLevel::WARN);
            self.fixed(&format!("{}/warnings/{at}", path::LOG), &text)?;
        }
        Ok(())
    }
}
