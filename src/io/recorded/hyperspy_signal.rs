//! HDF5 files of HyperSpy (`.hspy`, `.hdf5`): signals at `/Experiments/NAME/data`, with a group for each axis beside them.

use super::hdf5_source::Hdf5Source;
use super::length_units::{StatedPixel, square_nm};
use super::{ImageChoice, RecordedFormat, RecordedImage};
use crate::error::Result;
use crate::io::arrays::choose;
use crate::io::hdf5_guard::{any_text, number};

const SIGNALS: &str = "/Experiments/";
/// Energies in keV below its metadata, for images of either kind of microscope.
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

/// Reads a signal, or one image of a stack of them.
pub(super) fn read(source: &Hdf5Source, choice: &ImageChoice) -> Result<RecordedImage> {
    let names = signals(source);
    let name = choose(&source.path, &names, choice.dataset.as_deref())?;
    let group = format!("{SIGNALS}{name}");
    let pixels = source.image(&format!("{group}/data"), 0, choice)?;
    let axes = source.dataset(&format!("{group}/data"))?.ndim();
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
        pixel_nm: pixel_nm(source, &group, axes),
        cells: None,
        energy_kev: energy,
        detector: None,
    })
}

/// Of the last two axes, which are y and x.
fn pixel_nm(source: &Hdf5Source, group: &str, axes: usize) -> StatedPixel {
    let side = |axis: usize| {
        let about = source.file.group(&format!("{group}/axis-{axis}")).ok();
        let scale = about.as_ref().and_then(|about| number::<f64>(about, "scale")).unwrap_or(0.0);
        (scale, about.and_then(|about| any_text(&about, "units")).unwrap_or_default())
    };
    let (y, x) = (side(axes - 2), side(axes - 1));
    square_nm([(x.0, &x.1), (y.0, &y.1)])
}
