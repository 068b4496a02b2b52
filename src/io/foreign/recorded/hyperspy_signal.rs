//! Reads HDF5 files of HyperSpy (`.hspy`, `.hdf5`): signals at `/Experiments/NAME/data`, with a group for each axis beside them.

use super::hdf5_source::Hdf5Source;
use super::{ImageAxes, ImageChoice, RecordedFormat, RecordedImage};
use crate::error::Result;
use crate::io::foreign::arrays::choose;
use crate::io::foreign::named_axes::NamedAxis;
use crate::io::hdf5::hdf5_guard::{any_text, number};

const SIGNALS: &str = "/Experiments/";
/// Groups with energies in keV in the metadata of a signal, for both kinds of microscopes.
const ENERGIES: [&str; 2] = ["STEM", "TEM"];

/// Whether a file has the layout of HyperSpy.
pub(super) fn is_one(source: &Hdf5Source) -> bool {
    !signals(source).is_empty()
}

fn signals(source: &Hdf5Source) -> Vec<String> {
    let name = |path: &String| {
        let name = path.strip_prefix(SIGNALS)?.strip_suffix("/data")?;
        (!name.contains('/')).then(|| name.to_owned())
    };
    source.names.iter().filter_map(name).collect()
}

/// Reads a signal, or one image of a stack.
pub(super) fn read(source: &Hdf5Source, choice: &ImageChoice) -> Result<RecordedImage> {
    let names = signals(source);
    let data = |name: &str| format!("{SIGNALS}{name}/data");
    // A signal that is named is read even if it is no image: the error then gives the reason.
    let asked = choice.dataset.as_deref().filter(|name| source.has(&data(name)));
    let offered: Vec<String> = match names.len() {
        1 => names,
        _ => names.into_iter().filter(|name| source.is_real(&data(name))).collect(),
    };
    let name = match asked {
        Some(name) => name,
        None => choose(&source.path, &offered, choice.dataset.as_deref())?,
    };
    let group = format!("{SIGNALS}{name}");
    let count = source.dataset(&data(name))?.ndim();
    let axes: Vec<NamedAxis> = (0..count).map(|at| axis(source, &group, at)).collect();
    let axes = ImageAxes::of(&axes);
    let pixels = source.image(&data(name), axes.plane, 0, choice)?;
    let metadata = format!("{group}/metadata/Acquisition_instrument");
    let energy = ENERGIES.iter().find_map(|kind| {
        let about = source.file.group(&format!("{metadata}/{kind}")).ok()?;
        number::<f64>(&about, "beam_energy").filter(|v| v.is_finite() && *v > 0.0)
    });
    Ok(RecordedImage {
        path: source.path.clone(),
        format: RecordedFormat::HyperSpy,
        name: name.to_owned(),
        pixels,
        notes: axes.notes(),
        pixel_nm: axes.pixel_nm,
        cells: None,
        energy_kev: energy,
        detector: None,
    })
}

/// Reads the description of one dimension of a signal.
fn axis(source: &Hdf5Source, group: &str, at: usize) -> NamedAxis {
    let Ok(about) = source.file.group(&format!("{group}/axis-{at}")) else {
        return NamedAxis::default();
    };
    NamedAxis {
        name: any_text(&about, "name").unwrap_or_default(),
        step: Some(number::<f64>(&about, "scale").unwrap_or(0.0)),
        first: number::<f64>(&about, "offset"),
        unit: any_text(&about, "units").unwrap_or_default(),
    }
}
