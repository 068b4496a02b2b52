//! Reads the description of an array's axes in HDF5 files.
//!
//! | file | where |
//! |---|---|
//! | `stemgen simulate` | attributes `axes` and `sampling_angstrom` of the image |
//! | Berkeley EMD, Prismatic | `dim1`, `dim2` ... beside the image, with attributes `name` and `units` |
//! | emdfile, py4DSTEM | as in Berkeley EMD, but from `dim0` |
//! | NeXus | the attribute `axes` of the group, or of the image in older files; a list of positions for each name |
//! | HDF5's own dimension labels and scales (h5py, netCDF-4, xarray) | `DIMENSION_LABELS`, `DIMENSION_LIST` |

use std::path::Path;

use hdf5::{Dataset, File};
use ndarray::IxDyn;

use super::arrays::held;
use super::named_axes::{NamedAxis, even_step};
use crate::io::hdf5::hdf5_guard::{any_text, any_texts, check_storage, pair, scale_paths};
use crate::io::hdf5::hdf5_values;

/// The group of all files of Prismatic. Its lengths are in Angstrom; some versions of Prismatic name the unit `[n_m]`.
const PRISMATIC: &str = "/4DSTEM_simulation/";

/// A file whose arrays have described axes.
pub(crate) struct AxisSource<'a> {
    pub file: &'a File,
    pub path: &'a Path,
    pub bytes: u64,
    /// Paths of all data sets of the file.
    pub names: &'a [String],
}

impl AxisSource<'_> {
    /// Returns the axes of an array in its order; `None` if the file describes none of them.
    pub fn axes(&self, name: &str, dataset: &Dataset) -> Option<Vec<NamedAxis>> {
        let (group, own) = name.rsplit_once('/')?;
        let count = dataset.ndim();
        let named = |axes: &Vec<NamedAxis>| axes.iter().any(|axis| *axis != NamedAxis::default());
        let found = [
            stemgen(dataset, count),
            self.lists(group, count),
            self.nexus(group, own, dataset, count),
            self.scales(dataset, count),
        ];
        found.into_iter().flatten().find(named)
    }

    /// Reads `dim1` ... beside the array, or from `dim0`.
    fn lists(&self, group: &str, count: usize) -> Option<Vec<NamedAxis>> {
        let first = usize::from(!self.has(&format!("{group}/dim0")));
        let prismatic = format!("{group}/").starts_with(PRISMATIC);
        let axis = |at: usize| {
            let path = format!("{group}/dim{}", at + first);
            let mut axis = self.list(&path).unwrap_or_default();
            let about = self.dataset(&path);
            axis.name = about.and_then(|d| any_text(&d, "name")).unwrap_or_default();
            if prismatic && let Some(name) = axis.name.strip_prefix("R_") {
                (axis.name, axis.unit) = (name.to_owned(), "A".into());
            }
            axis
        };
        (count > 0 && self.has(&format!("{group}/dim{first}")))
            .then(|| (0..count).map(axis).collect())
    }

    /// Reads NeXus: the attribute `axes` names the lists of positions.
    fn nexus(
        &self,
        group: &str,
        own: &str,
        dataset: &Dataset,
        count: usize,
    ) -> Option<Vec<NamedAxis>> {
        let at = if group.is_empty() { "/" } else { group };
        let about = self.file.group(at).ok()?;
        let signal = any_text(&about, "signal");
        let others = about.attr("auxiliary_signals").map_or(0, |a| a.size());
        let others = any_texts(&about, "auxiliary_signals", others).unwrap_or_default();
        let is_signal =
            signal.is_none_or(|signal| signal == own) || others.iter().any(|o| o == own);
        let of_group = || any_texts(&about, "axes", count).filter(|_| is_signal);
        // Names are written as `y:x` or `[y,x]`.
        let of_array = || {
            let list = any_text(dataset, "axes")?;
            let names = list.trim_matches(['[', ']']).split([':', ',']);
            Some(names.map(|name| name.trim().to_owned()).collect())
        };
        let names: Vec<String> =
            of_group().or_else(of_array).filter(|n: &Vec<_>| n.len() == count)?;
        let axis = |name: String| {
            let list = self.list(&format!("{group}/{name}")).unwrap_or_default();
            NamedAxis { name, ..list }
        };
        Some(names.into_iter().map(axis).collect())
    }

    /// Reads the dimension labels and scales of HDF5.
    fn scales(&self, dataset: &Dataset, count: usize) -> Option<Vec<NamedAxis>> {
        let labels = any_texts(dataset, "DIMENSION_LABELS", count).unwrap_or_default();
        let scales = scale_paths(dataset);
        let axis = |at: usize| {
            let scale = scales.get(at).and_then(Option::as_deref);
            let list = scale.and_then(|path| self.list(path)).unwrap_or_default();
            let label = labels.get(at).filter(|label| !label.is_empty()).map(String::as_str);
            let own_name = scale.and_then(|path| path.rsplit('/').next());
            NamedAxis { name: label.or(own_name).unwrap_or_default().to_owned(), ..list }
        };
        Some((0..count).map(axis).collect())
    }

    /// Reads a list of positions, without its name.
    fn list(&self, path: &str) -> Option<NamedAxis> {
        let dataset = self.dataset(path)?;
        held(&dataset.shape()).ok().filter(|_| dataset.ndim() == 1)?;
        let places = hdf5_values::all::<f64, IxDyn>(&dataset, self.path).ok()?;
        let places: Vec<f64> = places.into_iter().collect();
        Some(NamedAxis {
            name: String::new(),
            step: even_step(&places),
            first: places.first().copied().filter(|v| v.is_finite()),
            unit: any_text(&dataset, "units").unwrap_or_default(),
        })
    }

    fn has(&self, path: &str) -> bool {
        self.names.iter().any(|name| name == path)
    }

    /// Opens a data set whose values lie in this file.
    fn dataset(&self, path: &str) -> Option<Dataset> {
        let dataset = self.file.dataset(path).ok().filter(|_| self.has(path))?;
        check_storage(&dataset, self.bytes).ok().map(|()| dataset)
    }
}

/// Reads the attributes of images of `stemgen simulate`: names of all axes, pixel and origin of the last two.
fn stemgen(dataset: &Dataset, count: usize) -> Option<Vec<NamedAxis>> {
    let labels = any_texts(dataset, "axes", count)?;
    let (sampling, origin) =
        (pair(dataset, "sampling_angstrom")?, pair(dataset, "origin_angstrom")?);
    let axis = |(at, name): (usize, String)| match (at + 2).checked_sub(count) {
        None => NamedAxis { name, ..NamedAxis::default() },
        Some(place) => NamedAxis {
            name,
            step: Some(sampling[place]),
            first: Some(origin[place]),
            unit: "A".into(),
        },
    };
    Some(labels.into_iter().enumerate().map(axis).collect())
}
