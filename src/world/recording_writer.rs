//! Writes recordings with their truth.

use std::path::Path;

use super::field_recording::FieldRecording;
use super::truth;
use crate::error::Result;
use crate::io::recording_file::{RecordingFile, write_recording};
use crate::recipe::CheckedRecipe;
use crate::specimen::Specimen;

impl FieldRecording {
    /// Writes a file with the recording and all that is known of it; its schema is that of [`crate::io::recording_file`].
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
        let file = RecordingFile {
            command_line: command_line.to_owned(),
            recipe: recipe.to_toml(),
            acquisition: &self.options.acquisition,
            exposure: &self.exposure,
            seed: self.options.seed,
            frame: &self.frame,
            data: &self.data,
            keeps_frames: self.options.keep_frames,
            ideal: &self.ideal,
            stages: self.stages.as_ref().map(|s| [&s.moved, &s.electrons]),
            clipped: self.clipped,
        };
        let first = recipe.field.origin_nm();
        let origin = [0, 1].map(|k| first[k] + self.frame.origin_nm[k]);
        write_recording(path, overwrite, &file, &|writer| {
            truth::write_recorded(specimen, self, origin, writer)
        })
    }
}
