//! Writes recordings with their truth.

use std::path::Path;

use super::field_recording::FieldRecording;
use super::truth;
use crate::error::Result;
use crate::io::{RecordingFile, TruthWriter, write_recording};
use crate::plane;
use crate::recipe::CheckedRecipe;
use crate::specimen::Specimen;

impl FieldRecording {
    /// Writes a file with the recording and its ground truth; its schema is in `recording_file.rs`.
    ///
    /// # Errors
    /// [`crate::Error::Io`], [`crate::Error::Hdf5`].
    pub fn write(
        &self,
        path: &Path,
        overwrite: bool,
        recipe: &CheckedRecipe,
        specimen: &dyn Specimen,
        command_line: &str,
    ) -> Result<()> {
        let file = self.file(recipe, command_line);
        write_recording(path, overwrite, &file, &|writer| {
            self.write_truth(recipe, specimen, writer)
        })
    }

    /// Returns the contents of a file of the recording without the truth.
    pub(crate) fn file(&self, recipe: &CheckedRecipe, command_line: &str) -> RecordingFile<'_> {
        RecordingFile {
            command_line: command_line.to_owned(),
            recipe: recipe.to_toml(),
            acquisition: &self.options.acquisition,
            exposure: &self.exposure,
            seed: self.options.seed,
            frame: &self.frame,
            data: &self.data,
            is_stack: self.options.keep_frames,
            is_sum: !self.options.keep_frames && self.exposure.frames > 1,
            ideal: &self.ideal,
            stages: self.stages.as_ref().map(|s| [&s.moved, &s.electrons]),
            carbon_nm: &self.carbon_nm,
            clipped: self.clipped,
            series: None,
        }
    }

    /// Writes the truth about the recording; phases, boundaries and particles come from the specimen.
    pub(crate) fn write_truth(
        &self,
        recipe: &CheckedRecipe,
        specimen: &dyn Specimen,
        writer: &TruthWriter,
    ) -> Result<()> {
        let first = recipe.field.origin_nm();
        let origin = plane::add(first, self.frame.origin_nm);
        truth::write_recorded(specimen, self, origin, writer)
    }
}
