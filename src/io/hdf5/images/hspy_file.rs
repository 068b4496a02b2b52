//! Writes files of HyperSpy (`.hspy`): HDF5 with one signal for each detector, with its axes and HyperSpy's metadata of a microscope.

use std::path::Path;

use hdf5::Group;

use super::image_file::ImageStack;
use super::image_series::ImageSeries;
use crate::error::Result;
use crate::files::atomic_write;
use crate::io::hdf5::At;
use crate::io::hdf5::hdf5_create::{self, number, text};
use crate::simulation::SimulationJob;

/// Version of HyperSpy's file format.
const FORMAT_VERSION: &str = "3.3";
/// HyperSpy recognises images by this unit.
const UNIT: &str = "\u{c5}";

/// Facts about all images of a file. Values that are `None` are not written.
#[derive(Debug, Clone, Default)]
pub struct HspyFacts {
    /// The command as typed; may be empty.
    pub command_line: String,
    /// Whether the illumination is a plane wave.
    pub plane_wave: bool,
    /// Beam energy in keV.
    pub energy_kev: Option<f64>,
    /// Convergence semiangle in mrad; for a plane wave, the semiangle of the objective aperture.
    pub semiangle_mrad: Option<f64>,
    /// Defocus in Angstrom of images that form no series; positive is underfocus.
    pub defocus_angstrom: Option<f64>,
    /// Tilt (x, y) of the specimen in mrad.
    pub tilt_mrad: Option<[f64; 2]>,
    /// Electrons per square Angstrom.
    pub dose: Option<f64>,
    /// Other texts by name, such as the request.
    pub texts: Vec<(&'static str, String)>,
}

impl HspyFacts {
    /// Collects the facts about the images of a simulation.
    pub fn of_simulation(job: &SimulationJob, command_line: &str) -> Self {
        let defocus_angstrom = match job.request().microscope.defocus_angstrom[..] {
            [defocus] => Some(defocus),
            _ => None,
        };
        HspyFacts { defocus_angstrom, ..HspyFacts::common(job, command_line) }
    }

    fn common(job: &SimulationJob, command_line: &str) -> Self {
        let request = job.request();
        let texts = [
            ("request", serde_json::to_string(request)),
            ("settings", serde_json::to_string(&job.plans()[0].settings)),
        ];
        HspyFacts {
            command_line: command_line.to_owned(),
            plane_wave: request.plane_wave,
            energy_kev: Some(request.microscope.energy_kev),
            semiangle_mrad: Some(request.microscope.semiangle_mrad),
            defocus_angstrom: None,
            tilt_mrad: Some(request.microscope.tilt_mrad),
            dose: request.electrons_per_angstrom2,
            texts: texts.into_iter().filter_map(|(n, text)| Some((n, text.ok()?))).collect(),
        }
    }
}

/// Writes images as signals, each named after its detector: `hyperspy.api.load` returns them. Series over defocus and thickness have
/// navigation axes.
///
/// # Errors
/// [`crate::Error::Io`], [`crate::Error::Hdf5`].
pub fn write_hspy(
    path: &Path,
    overwrite: bool,
    stacks: &[ImageStack],
    facts: &HspyFacts,
) -> Result<()> {
    atomic_write::write_with(path, overwrite, |temporary| {
        create_hspy(temporary, path, stacks, facts)
    })
}

/// Writes images as [`write_hspy`] does, directly to `path`; errors name the file `place`.
///
/// # Errors
/// [`crate::Error::Hdf5`].
pub fn create_hspy(
    path: &Path,
    place: &Path,
    stacks: &[ImageStack],
    facts: &HspyFacts,
) -> Result<()> {
    let write = || -> hdf5::Result<()> {
        let file = hdf5_create::file(path)?;
        text(&file, "file_format", "HyperSpy")?;
        text(&file, "file_format_version", FORMAT_VERSION)?;
        let experiments = hdf5_create::group(&file, "Experiments")?;
        let series = ImageSeries::group(stacks);
        series.iter().try_for_each(|series| signal(&experiments, series, facts))?;
        file.flush()
    };
    write().at(place)
}

fn signal(experiments: &Group, series: &ImageSeries, facts: &HspyFacts) -> hdf5::Result<()> {
    let group = hdf5_create::group(experiments, &series.name)?;
    text(&group, "package", "hyperspy")?;
    text(&group, "package_version", "2.0")?;
    group.new_dataset_builder().with_data(&series.data()).create("data")?;
    write_axes(&group, series)?;
    let metadata = hdf5_create::group(&group, "metadata")?;
    let general = hdf5_create::group(&metadata, "General")?;
    text(&general, "title", &series.name)?;
    let version = env!("CARGO_PKG_VERSION");
    let made_by = if facts.command_line.is_empty() { "" } else { ": " };
    text(&general, "notes", &format!("stemgen {version}{made_by}{}", facts.command_line))?;
    let about = hdf5_create::group(&metadata, "Signal")?;
    text(&about, "signal_type", "")?;
    text(&about, "quantity", series.first().units)?;
    write_instrument(&metadata, series, facts)?;
    let original = hdf5_create::group(&group, "original_metadata")?;
    let own = hdf5_create::group(&original, "stemgen")?;
    text(&own, "version", version)?;
    text(&own, "command_line", &facts.command_line)?;
    facts.texts.iter().try_for_each(|(name, value)| text(&own, name, value))?;
    hdf5_create::group(&group, "learning_results")?;
    let attributes = hdf5_create::group(&group, "attributes")?;
    number(&attributes, "_lazy", false)?;
    number(&attributes, "ragged", false)
}

fn write_axes(group: &Group, series: &ImageSeries) -> hdf5::Result<()> {
    let mut count = 0;
    let mut axis = |name: &str, size: usize, navigate: bool| -> hdf5::Result<Group> {
        let axis = hdf5_create::group(group, &format!("axis-{count}"))?;
        count += 1;
        text(&axis, "name", name)?;
        text(&axis, "units", UNIT)?;
        number(&axis, "size", size as i64)?;
        number(&axis, "navigate", navigate)?;
        number(&axis, "is_binned", false)?;
        Ok(axis)
    };
    let evenly = |axis: &Group, [offset, scale]: [f64; 2]| {
        text(axis, "_type", "UniformDataAxis")?;
        number(axis, "offset", offset)?;
        number(axis, "scale", scale)
    };
    for along in series.axes() {
        let one = axis(along.name, along.values_angstrom.len(), true)?;
        match along.even() {
            Some(even) => evenly(&one, even)?,
            None => {
                text(&one, "_type", "DataAxis")?;
                one.new_dataset_builder().with_data(&along.values_angstrom).create("axis")?;
            }
        }
    }
    let stack = series.first();
    let (_, rows, columns) = stack.data.dim();
    let [x0, y0] = stack.origin_angstrom;
    let [x, y] = stack.step_angstrom;
    for (name, size, even) in [("y", rows, [y0, y]), ("x", columns, [x0, x])] {
        evenly(&axis(name, size, false)?, even)?;
    }
    Ok(())
}

/// Writes `Acquisition_instrument.TEM`, with HyperSpy's names and units where they exist.
fn write_instrument(metadata: &Group, series: &ImageSeries, facts: &HspyFacts) -> hdf5::Result<()> {
    let instrument = hdf5_create::group(metadata, "Acquisition_instrument")?;
    let tem = hdf5_create::group(&instrument, "TEM")?;
    let put = |name: &str, value: Option<f64>| match value {
        Some(value) => number(&tem, name, value),
        None => Ok(()),
    };
    text(&tem, "acquisition_mode", if facts.plane_wave { "TEM" } else { "STEM" })?;
    text(&tem, "microscope", "simulated")?;
    put("beam_energy", facts.energy_kev)?;
    put("convergence_angle", facts.semiangle_mrad.filter(|_| !facts.plane_wave))?;
    put("objective_aperture_mrad", facts.semiangle_mrad.filter(|_| facts.plane_wave))?;
    put("defocus_angstrom", facts.defocus_angstrom)?;
    let stack = series.first();
    if stack.electrons_per_pixel.is_some() {
        put("dose_electrons_per_angstrom2", facts.dose)?;
        put("electrons_per_pixel", stack.electrons_per_pixel)?;
    }
    if let Some([x, y]) = facts.tilt_mrad {
        let stage = hdf5_create::group(&tem, "Stage")?;
        // HyperSpy's tilts are in degrees.
        number(&stage, "tilt_alpha", (1e-3 * x).to_degrees())?;
        number(&stage, "tilt_beta", (1e-3 * y).to_degrees())?;
    }
    if let Some([inner, outer]) = stack.annulus_mrad {
        let detector = hdf5_create::group(&tem, "Detector")?;
        text(&detector, "name", series.name.strip_suffix("_noisy").unwrap_or(&series.name))?;
        number(&detector, "inner_angle_mrad", inner)?;
        if let Some(sector) = stack.sector_degrees {
            detector.new_attr_builder().with_data(&sector).create("sector_degrees")?;
        }
        number(&detector, "outer_angle_mrad", outer)?;
    }
    Ok(())
}
