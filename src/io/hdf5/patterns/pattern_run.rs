//! Simulates the diffraction patterns of a job into files, one for each defocus and thickness.

use std::path::{Path, PathBuf};

use ndarray::{Array2, ArrayView4, Axis};

use super::pattern_file::{PatternHeader, PatternOrigin, PatternWriter, write_patterns};
use super::pattern_format::PatternFormat;
use super::pattern_parts::PatternParts;
use crate::error::Result;
use crate::files::disk_space::check_places;
use crate::io::hdf5::images::image_file::Origin;
use crate::progress::Progress;
use crate::simulation::{PatternBand, PatternValues, SimulationJob};

/// The patterns of a job, and the files for them.
#[derive(Debug, Clone, Copy)]
pub struct PatternRun<'a> {
    /// The simulation; its request asks for patterns.
    pub job: &'a SimulationJob,
    /// Path of the file, or the beginning of the names of several files.
    pub output: &'a Path,
    /// The command as typed, or another origin of the request.
    pub command_line: &'a str,
}

/// A file of patterns that was written.
#[derive(Debug, Clone)]
pub struct WrittenPatterns {
    /// The file.
    pub path: PathBuf,
    /// Description of its patterns.
    pub header: PatternHeader,
    /// Mean of its patterns.
    pub mean: Array2<f64>,
}

impl PatternRun<'_> {
    /// Returns the files and the description of their patterns, in the order of defocus, then thickness: `NAME.emd`, or
    /// `NAME_defocus_50A_39.0A.emd`.
    pub fn files(&self) -> Vec<(PathBuf, PatternHeader)> {
        let headers = self.headers();
        let thicknesses = self.job.plans()[0].record_after.len();
        let ending = PatternFormat::of(self.output).unwrap_or(PatternFormat::Emd).ending();
        let name = |(n, header): (usize, PatternHeader)| {
            let mut suffix = String::new();
            if let Some(defocus) = self.job.series_defocus(n / thicknesses.max(1)) {
                suffix += &format!("_defocus_{defocus}A");
            }
            if thicknesses > 1 {
                suffix += &format!("_{:.1}A", header.thickness_angstrom);
            }
            let mut file = self.output.file_stem().unwrap_or_default().to_owned();
            file.push(suffix);
            file.push(ending);
            (self.output.with_file_name(file), header)
        };
        headers.into_iter().enumerate().map(name).collect()
    }

    /// Returns the descriptions of the patterns, in the order of defocus, then thickness.
    pub fn headers(&self) -> Vec<PatternHeader> {
        let (job, request) = (self.job, self.job.request());
        let Some(settings) = job.pattern_settings() else { return Vec::new() };
        let mut headers = Vec::new();
        for (n, plan) in job.plans().iter().enumerate() {
            for thickness_angstrom in plan.thicknesses_angstrom() {
                headers.push(PatternHeader {
                    detector: settings.detector,
                    scan: *job.scan(),
                    thickness_angstrom,
                    defocus_angstrom: request.microscope.defocus_angstrom[n],
                    energy_kev: request.microscope.energy_kev,
                    semiangle_mrad: request.microscope.semiangle_mrad,
                    wavelength_angstrom: plan.settings.optics.wavelength_angstrom(),
                    counted: job.electrons_per_pixel().map(|e| (e, request.specimen.seed)),
                });
            }
        }
        headers
    }

    /// Returns all files that will be written: files of patterns, and the files that belong to them.
    ///
    /// # Errors
    /// [`Error::Invalid`](crate::Error::Invalid) for a name that selects no kind of file, and for patterns that the kind cannot hold.
    pub fn outputs(&self) -> Result<Vec<PathBuf>> {
        let format = PatternFormat::of(self.output)?;
        let mut all = Vec::new();
        for (path, header) in self.files() {
            format.check(&header)?;
            all.extend(format.companions(&path));
            all.push(path);
        }
        Ok(all)
    }

    /// Refuses patterns for which their disk has too little room.
    ///
    /// # Errors
    /// [`Error::DiskSpace`](crate::Error::DiskSpace).
    pub fn check_space(&self) -> Result<()> {
        let (format, files) = (PatternFormat::of(self.output)?, self.files());
        let needed = files.iter().map(|(path, header)| (path.as_path(), format.bytes(header)));
        check_places(&needed.collect::<Vec<_>>())
    }

    /// Simulates and writes the patterns. Files of one defocus appear together, complete. Parts that [`PatternParts::make`] stored beside
    /// the output are not simulated again, and removed at the end.
    ///
    /// # Errors
    /// Errors of [`SimulationJob::patterns`] and of the files.
    pub fn write(&self, overwrite: bool, progress: &dyn Progress) -> Result<Vec<WrittenPatterns>> {
        let parts = PatternParts::new(self.job, self.output, progress)?;
        let vacuum = self.job.vacuum_pattern()?;
        let origin = Origin::of_simulation(self.job, self.command_line)?;
        let plans = self.job.plans();
        let origin = PatternOrigin {
            origin: &origin,
            engine: plans[0].settings.algorithm.to_string(),
            coherent_tail: self.job.pattern_settings().is_some_and(|s| s.coherent_tail),
            vacuum: &vacuum,
        };
        let files = self.files();
        let mut written = Vec::new();
        for (n, files) in files.chunks((files.len() / plans.len()).max(1)).enumerate() {
            let mut sums: Vec<Array2<f64>> = vec![Array2::zeros(vacuum.dim()); files.len()];
            let mut fill = |writers: &mut [PatternWriter]| {
                let mut take = |band: PatternBand<'_>| take(writers, &mut sums, band);
                self.job.patterns(n, Some(&parts), &mut take, progress)
            };
            write_patterns(files, overwrite, &origin, &mut fill)?;
            for ((path, header), sum) in files.iter().zip(sums) {
                let mean = sum / header.scan.len() as f64;
                written.push(WrittenPatterns { path: path.clone(), header: header.clone(), mean });
            }
        }
        parts.remove()?;
        Ok(written)
    }
}

/// Writes rows to the files of the thicknesses, and sums the patterns.
fn take(
    writers: &mut [PatternWriter],
    sums: &mut [Array2<f64>],
    band: PatternBand<'_>,
) -> Result<()> {
    fn add<T: Copy + Into<f64>>(sum: &mut Array2<f64>, rows: ArrayView4<'_, T>) {
        for patterns in rows.outer_iter() {
            for pattern in patterns.outer_iter() {
                sum.zip_mut_with(&pattern, |sum, v| *sum += (*v).into());
            }
        }
    }
    for (t, (writer, sum)) in writers.iter_mut().zip(sums).enumerate() {
        match &band.values {
            PatternValues::Fractions(values) => {
                let rows = values.index_axis(Axis(0), t);
                add(sum, rows);
                writer.fractions(band.first_row, rows)?;
            }
            PatternValues::Counts(values) => {
                let rows = values.index_axis(Axis(0), t);
                add(sum, rows);
                writer.counts(band.first_row, rows)?;
            }
        }
    }
    Ok(())
}
