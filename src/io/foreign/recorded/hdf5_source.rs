//! Reads the data sets of an HDF5 file with images, within the limits that its size sets.

use std::ops::Range;
use std::path::{Path, PathBuf};

use hdf5::types::TypeDescriptor;
use hdf5::{Dataset, File};
use ndarray::{Array2, ArrayD, Axis, IxDyn};

use super::image_choice::{ImageChoice, frame_of};
use crate::error::{Error, Result};
use crate::io::foreign::arrays::held;
use crate::io::foreign::hdf5_axes::AxisSource;
use crate::io::foreign::named_axes::NamedAxis;
use crate::io::hdf5::hdf5_guard::{check_storage, datasets, first_line};
use crate::io::hdf5::hdf5_open::{self, regular_file};
use crate::io::hdf5::hdf5_values::{self, Plain, is_float};

/// An HDF5 file.
pub(super) struct Hdf5Source {
    pub path: PathBuf,
    pub file: File,
    bytes: u64,
    /// Paths of all data sets.
    pub names: Vec<String>,
}

impl Hdf5Source {
    pub fn open(path: &Path) -> Result<Self> {
        let bytes = regular_file(path)?;
        let refused = |fault: String| Error::parse(path, 0, fault);
        let file = hdf5_open::open(path)
            .map_err(|e| refused(hdf5_open::reason(&e, "is damaged or truncated HDF5")))?;
        let names = datasets(&file).map_err(refused)?;
        Ok(Hdf5Source { path: path.to_owned(), file, bytes, names })
    }

    /// Returns an error about this file.
    pub fn refused(&self, fault: impl Into<String>) -> Error {
        Error::parse(&self.path, 0, fault)
    }

    /// Whether a data set has this path.
    pub fn has(&self, name: &str) -> bool {
        self.names.iter().any(|n| n == name)
    }

    /// Opens a data set whose values lie in this file.
    pub fn dataset(&self, name: &str) -> Result<Dataset> {
        let opened = self.file.dataset(name);
        let dataset = opened.map_err(|e| self.refused(format!("{name}: {}", first_line(&e))))?;
        check_storage(&dataset, self.bytes).map_err(|f| self.refused(format!("{name} {f}")))?;
        Ok(dataset)
    }

    /// Reads all values of a data set.
    pub fn all<T: Plain>(&self, name: &str) -> Result<ArrayD<T>> {
        let dataset = self.dataset(name)?;
        held(&dataset.shape()).map_err(|f| self.refused(f))?;
        let values = hdf5_values::all::<T, IxDyn>(&dataset, &self.path);
        values.map_err(|f| self.refused(format!("{name} {f}")))
    }

    /// Reads a part of the values of a data set.
    pub fn part<T: Plain>(&self, name: &str, ranges: &[Range<usize>]) -> Result<ArrayD<T>> {
        let dataset = self.dataset(name)?;
        let lengths: Vec<usize> = ranges.iter().map(Range::len).collect();
        held(&lengths).map_err(|f| self.refused(f))?;
        let values = hdf5_values::part::<T, IxDyn>(&dataset, &self.path, ranges);
        values.map_err(|f| self.refused(format!("{name} {f}")))
    }

    /// Reads the image of a data set, [row, column]. The dimensions `plane`, `[y, x]`, count rows and columns; without them the two
    /// dimensions other than `frames` do, where `frames` counts the frames of a data set of three dimensions. Further dimensions must have
    /// length 1.
    pub fn image(
        &self,
        name: &str,
        plane: Option<[usize; 2]>,
        frames: usize,
        choice: &ImageChoice,
    ) -> Result<Array2<f64>> {
        let dataset = self.dataset(name)?;
        self.check_real(name, &dataset)?;
        let shape = dataset.shape();
        let [y, x] = match (plane, shape.len()) {
            (Some(plane), _) => plane,
            (None, 3) => [usize::from(frames == 0), 2 - usize::from(frames == 2)],
            (None, n @ 2..) => [n - 2, n - 1],
            (None, _) => return Err(self.no_image(name, &shape)),
        };
        let others: Vec<usize> = (0..shape.len()).filter(|d| *d != y && *d != x).collect();
        let counting: Vec<usize> = others.iter().copied().filter(|d| shape[*d] != 1).collect();
        let count = match counting[..] {
            [] => 1,
            [axis] => shape[axis],
            _ => return Err(self.no_image(name, &shape)),
        };
        let frame = frame_of(&self.path, name, count, choice.index)?;
        let mut ranges: Vec<Range<usize>> = shape.iter().map(|n| 0..*n).collect();
        counting.iter().for_each(|axis| ranges[*axis] = frame..frame + 1);
        let mut values = self.part::<f64>(name, &ranges)?;
        for axis in others.into_iter().rev() {
            values = values.index_axis_move(Axis(axis), 0);
        }
        let image: Array2<f64> =
            values.into_dimensionality().map_err(|e| self.refused(e.to_string()))?;
        let image = if x < y { image.reversed_axes() } else { image };
        // A large image in standard order is not copied.
        Ok(if image.is_standard_layout() { image } else { image.as_standard_layout().into_owned() })
    }

    fn no_image(&self, name: &str, shape: &[usize]) -> Error {
        let n = shape.len();
        self.refused(format!(
            "{name} has {n} axes, {shape:?}; an image has two, and a third for its frames"
        ))
    }

    /// Returns the description of the axes of a data set, in its order.
    pub fn axes(&self, name: &str) -> Option<Vec<NamedAxis>> {
        let dataset = self.dataset(name).ok()?;
        let source = AxisSource {
            file: &self.file,
            path: &self.path,
            bytes: self.bytes,
            names: &self.names,
        };
        source.axes(name, &dataset)
    }

    /// Whether a data set holds real numbers, and may be an image.
    pub fn is_real(&self, name: &str) -> bool {
        self.file.dataset(name).is_ok_and(|dataset| value_kind(&dataset) == ValueKind::Real)
    }

    /// Refuses complex numbers, colours and texts.
    fn check_real(&self, name: &str, dataset: &Dataset) -> Result<()> {
        match value_kind(dataset) {
            ValueKind::Real => Ok(()),
            ValueKind::Compound(parts) => Err(self.refused(format!(
                "{name} holds values made of {parts}: complex numbers or colours; expected grey values"
            ))),
            ValueKind::Other => Err(self.refused(format!("{name} holds no numbers"))),
        }
    }

    /// Returns the data sets that may be images: real numbers and two axes or more.
    pub fn images(&self) -> Vec<String> {
        let may_be = |name: &&String| {
            self.file.dataset(name).is_ok_and(|d| {
                value_kind(&d) == ValueKind::Real
                    && check_storage(&d, self.bytes).is_ok()
                    && d.ndim() >= 2
            })
        };
        self.names.iter().filter(may_be).cloned().collect()
    }

    /// Returns the error of the first data set of real numbers that is refused: compressed too much, cut off, or in another file.
    pub fn refusal(&self) -> Option<Error> {
        self.names
            .iter()
            .filter(|name| self.is_real(name))
            .find_map(|name| self.dataset(name).err())
    }
}

/// Kind of the values of a data set.
#[derive(Debug, Clone, PartialEq, Eq)]
enum ValueKind {
    Real,
    /// Compound values, with the names of their parts.
    Compound(String),
    Other,
}

fn value_kind(dataset: &Dataset) -> ValueKind {
    let Ok(kind) = dataset.dtype() else { return ValueKind::Other };
    match kind.to_descriptor() {
        Ok(
            TypeDescriptor::Float(_)
            | TypeDescriptor::Integer(_)
            | TypeDescriptor::Unsigned(_)
            | TypeDescriptor::Boolean,
        ) => ValueKind::Real,
        Ok(TypeDescriptor::Compound(parts)) => {
            let names: Vec<&str> = parts.fields.iter().map(|f| f.name.as_str()).collect();
            ValueKind::Compound(names.join(" and "))
        }
        Err(_) if is_float(&kind) => ValueKind::Real,
        _ => ValueKind::Other,
    }
}
