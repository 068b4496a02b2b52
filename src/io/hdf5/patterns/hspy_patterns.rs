//! Makes HyperSpy files (`.hspy`) for the patterns of a scan: everything except the array of patterns.

use std::path::Path;

use hdf5::{File, Group};

use super::pattern_file::{PatternHeader, PatternOrigin, axes_of, units_of};
use crate::io::hdf5::hdf5_create::{self, number, text};

/// Version of HyperSpy's file format.
const FORMAT_VERSION: &str = "3.3";

/// Makes a file with one signal, navigated over the scan, and returns it with the group for its array (`data`). The origin of the patterns
/// is recorded in the signal's original metadata. `path` is the file's final name.
pub(crate) fn begin(
    temporary: &Path,
    path: &Path,
    header: &PatternHeader,
    origin: &PatternOrigin<'_>,
) -> hdf5::Result<(File, Group)> {
    let file = hdf5_create::file(temporary)?;
    text(&file, "file_format", "HyperSpy")?;
    text(&file, "file_format_version", FORMAT_VERSION)?;
    let group = hdf5_create::group(&hdf5_create::group(&file, "Experiments")?, "patterns")?;
    text(&group, "package", "hyperspy")?;
    text(&group, "package_version", "2.0")?;
    for (n, axis) in axes_of(header).into_iter().enumerate() {
        let to = hdf5_create::group(&group, &format!("axis-{n}"))?;
        text(&to, "_type", "UniformDataAxis")?;
        text(&to, "name", axis.names[1])?;
        text(&to, "units", if axis.unit == "A" { "\u{c5}" } else { "1/\u{c5}" })?;
        number(&to, "size", axis.count as i64)?;
        number(&to, "offset", axis.line[0])?;
        number(&to, "scale", axis.line[1])?;
        number(&to, "navigate", n < 2)?;
        number(&to, "is_binned", false)?;
    }
    let metadata = hdf5_create::group(&group, "metadata")?;
    let title = path.file_stem().unwrap_or_default().display().to_string();
    let general = hdf5_create::group(&metadata, "General")?;
    text(&general, "title", &title)?;
    let signal = hdf5_create::group(&metadata, "Signal")?;
    text(&signal, "signal_type", "")?;
    text(&signal, "quantity", units_of(header))?;
    let microscope = hdf5_create::group(&metadata, "Acquisition_instrument")?;
    let microscope = hdf5_create::group(&microscope, "TEM")?;
    number(&microscope, "beam_energy", header.energy_kev)?;
    number(&microscope, "convergence_angle", header.semiangle_mrad)?;
    let made = hdf5_create::group(&group, "original_metadata")?;
    let made = hdf5_create::group(&made, "stemgen")?;
    text(&made, "command_line", &origin.origin.command_line)?;
    text(&made, "request", origin.origin.request.as_deref().unwrap_or_default())?;
    number(&made, "defocus_angstrom", header.defocus_angstrom)?;
    number(&made, "thickness_angstrom", header.thickness_angstrom)?;
    hdf5_create::group(&group, "learning_results")?;
    let attributes = hdf5_create::group(&group, "attributes")?;
    number(&attributes, "_lazy", false)?;
    number(&attributes, "ragged", false)?;
    Ok((file, group))
}
