//! Writes recordings with their truth.

use std::path::Path;

use ndarray::Array3;

use super::field_recording::{DetectorRecording, FieldRecording, RecordingStages};
use super::truth;
use crate::error::Result;
use crate::io::{RecordedImages, RecordingFile, TruthWriter, write_recording};
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
        let main = recipe.detector.all().into_iter().next().map_or(String::new(), |d| d.name);
        RecordingFile {
            command_line: command_line.to_owned(),
            recipe: recipe.to_toml(),
            first: RecordedImages {
                detector: &self.detector,
                acquisition: &self.options.acquisition,
                data: &self.data,
                ideal: &self.ideal,
                stages: self.stages.as_ref().map(RecordingStages::both),
                clipped: self.clipped,
                series: None,
            },
            others: self.others.iter().map(DetectorRecording::images).collect(),
            is_named: !self.others.is_empty() || self.detector.name != main,
            exposure: &self.exposure,
            seed: self.options.seed,
            frame: &self.frame,
            is_stack: self.options.keep_frames,
            is_sum: !self.options.keep_frames && self.exposure.frames > 1,
            carbon_nm: &self.carbon_nm,
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

impl RecordingStages {
    fn both(&self) -> [&Array3<f32>; 2] {
        [&self.moved, &self.electrons]
    }
}

impl DetectorRecording {
    /// Returns its images for a file.
    fn images(&self) -> RecordedImages<'_> {
        RecordedImages {
            detector: &self.detector,
            acquisition: &self.acquisition,
            data: &self.data,
            ideal: &self.ideal,
            stages: self.stages.as_ref().map(RecordingStages::both),
            clipped: self.clipped,
            series: None,
        }
    }
}
