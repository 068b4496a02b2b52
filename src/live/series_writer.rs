//! Files of series of recordings.

use std::collections::BTreeMap;
use std::path::Path;

use super::dose_series::DoseSeries;
use super::live_world::LiveWorld;
use crate::error::Result;
use crate::io::{RecordedImages, RecordingFile, SeriesPart, write_recording};

impl DoseSeries {
    /// Writes a file with the recordings and their truth. Its schema is described in `recording_file.rs`.
    ///
    /// # Errors
    /// [`crate::Error::Io`], [`crate::Error::Hdf5`].
    pub fn write(
        &self,
        path: &Path,
        overwrite: bool,
        world: &LiveWorld,
        command_line: &str,
    ) -> Result<()> {
        let series = SeriesPart {
            vacancies: &self.vacancies,
            dose_before: &self.dose_before,
            lost: self.lost(),
            history: serde_json::to_string(&self.history).unwrap_or_default(),
        };
        let one = self.first.file(world.recipe(), command_line);
        let others = one.others.into_iter().zip(&self.others);
        let others = others.map(|(one, own)| RecordedImages {
            data: &own.data,
            clipped: own.clipped,
            series: Some(&own.ideal),
            ..one
        });
        let file = RecordingFile {
            first: RecordedImages {
                data: &self.data,
                clipped: self.clipped,
                series: Some(&self.ideal),
                ..one.first
            },
            others: others.collect(),
            is_stack: true,
            is_sum: self.first.exposure.frames > 1,
            series: Some(series),
            ..self.first.file(world.recipe(), command_line)
        };
        write_recording(path, overwrite, &file, &|writer| {
            self.first.write_truth(world.recipe(), world.specimen(), writer)
        })
    }

    /// Number of atoms that each recording removed, by element.
    fn lost(&self) -> BTreeMap<String, Vec<u64>> {
        let mut lost = BTreeMap::new();
        for (number, one) in self.history.iter().enumerate() {
            for (element, atoms) in &one.lost {
                let all = lost.entry(element.clone());
                all.or_insert_with(|| vec![0; self.history.len()])[number] = *atoms;
            }
        }
        lost
    }
}
