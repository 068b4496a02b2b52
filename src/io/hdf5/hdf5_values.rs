//! Reads the values of datasets from unknown sources.
//!
//! libhdf5 trusts the size of an unpacked chunk: a chunk that is too short is read beyond its end, and a chunk that is too long takes as
//! much memory as it unpacks to (seen in 1.10.8). Chunks are therefore unpacked here, to the size that the dataset announces or not at all;
//! the index of the chunks, the fill value and the conversion of numbers are left to the library.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::mem::MaybeUninit;
use std::ops::Range;
use std::path::Path;

use hdf5::plist::dataset_create::Layout;
use hdf5::types::{FixedAscii, TypeDescriptor};
use hdf5::{Attribute, Dataset, Datatype, H5Type, Hyperslab, SliceOrIndex};
use hdf5_sys::h5a::H5Aread;
use hdf5_sys::h5d::{H5Dget_chunk_info_by_coord, H5Dread};
use hdf5_sys::h5p::{H5P_DEFAULT, H5Pget_fill_value};
use hdf5_sys::h5s::H5S_ALL;
use hdf5_sys::h5t::{H5T_class_t, H5Tconvert, H5Tget_class};
use ndarray::{Array, ArrayD, Dimension};

use super::hdf5_filters::Filters;
use super::hdf5_guard::{Guarded, damaged};

/// The address of a chunk that was never written.
const NOWHERE: u64 = u64::MAX;

/// Values for which any bytes are valid.
///
/// # Safety
/// Every pattern of bytes is a valid value.
pub(crate) unsafe trait Plain: H5Type + Copy {}

// SAFETY: a number without unused bits.
unsafe impl Plain for u8 {}
// SAFETY: as above.
unsafe impl Plain for i32 {}
// SAFETY: as above.
unsafe impl Plain for u32 {}
// SAFETY: as above.
unsafe impl Plain for f32 {}
// SAFETY: as above.
unsafe impl Plain for f64 {}
// SAFETY: an array of bytes and nothing else. Its text (`as_str`) takes the bytes for ASCII without a check: code that reads such values
// must check `as_bytes` first.
unsafe impl<const N: usize> Plain for FixedAscii<N> {}

/// Reads all values of a dataset of the file at `path`.
pub(crate) fn all<T: Plain, D: Dimension>(dataset: &Dataset, path: &Path) -> Guarded<Array<T, D>> {
    let whole: Vec<Range<usize>> = dataset.shape().into_iter().map(|n| 0..n).collect();
    part(dataset, path, &whole)
}

/// Reads a part of a dataset's values, one range for each axis. The dataset's storage must have been checked
/// ([`super::hdf5_guard::check_storage`]).
pub(crate) fn part<T: Plain, D: Dimension>(
    dataset: &Dataset,
    path: &Path,
    ranges: &[Range<usize>],
) -> Guarded<Array<T, D>> {
    let shape = dataset.shape();
    let inside = |(range, n): (&Range<usize>, &usize)| range.start <= range.end && range.end <= *n;
    if ranges.len() != shape.len() || !ranges.iter().zip(&shape).all(inside) {
        return Err(format!("has the shape {shape:?}, which does not contain the part {ranges:?}"));
    }
    let stored = dataset.dtype().map_err(damaged)?;
    check_kind(&stored)?;
    let lengths: Vec<usize> = ranges.iter().map(Range::len).collect();
    let plan = dataset.dcpl().map_err(damaged)?;
    let values = match plan.layout() {
        _ if lengths.contains(&0) => Vec::new(),
        Layout::Chunked => {
            let chunks = Chunks::of(dataset, &stored, path)?;
            chunks.part(ranges, &lengths, &stored)?
        }
        _ if lengths == shape => dataset.read_raw().map_err(damaged)?,
        _ => {
            let axes: Vec<SliceOrIndex> = ranges.iter().cloned().map(SliceOrIndex::from).collect();
            let read: ArrayD<T> = dataset.read_slice(Hyperslab::from(axes)).map_err(damaged)?;
            read.into_iter().collect()
        }
    };
    let array = ArrayD::from_shape_vec(lengths, values).map_err(|e| e.to_string())?;
    let axes = array.ndim();
    array.into_dimensionality().map_err(|_| format!("has {axes} axes, another number is expected"))
}

/// Reads all values of a dataset as bytes of the type in the file. The dataset's storage must have been checked
/// ([`super::hdf5_guard::check_storage`]).
pub(crate) fn stored_bytes(dataset: &Dataset, path: &Path) -> Guarded<Vec<u8>> {
    let stored = dataset.dtype().map_err(damaged)?;
    check_kind(&stored)?;
    let lengths = dataset.shape();
    let count = lengths.iter().try_fold(stored.size(), |n, length| n.checked_mul(*length));
    let count = count.ok_or_else(|| format!("announces {lengths:?} values, more than fit"))?;
    let mut bytes = vec![0; count];
    if count == 0 {
        return Ok(bytes);
    }
    if dataset.dcpl().map_err(damaged)?.layout() == Layout::Chunked {
        let chunks = Chunks::of(dataset, &stored, path)?;
        for value in bytes.chunks_exact_mut(stored.size()) {
            value.copy_from_slice(&chunks.fill);
        }
        let whole: Vec<Range<usize>> = lengths.iter().map(|n| 0..*n).collect();
        chunks.gather(&whole, &lengths, &mut bytes)?;
        return Ok(bytes);
    }
    // SAFETY: there is room for all values of the file's type, none of which refers to other places (`check_kind`).
    let read = hdf5::sync::sync(|| unsafe {
        let to = bytes.as_mut_ptr().cast();
        H5Dread(dataset.id(), stored.id(), H5S_ALL, H5S_ALL, H5P_DEFAULT, to)
    });
    if read < 0 { Err("cannot be read".into()) } else { Ok(bytes) }
}

/// Reads the values of an attribute as bytes of the type in the file; `None` for values that refer to other places in the file, and for
/// compound values.
pub(crate) fn attribute_bytes(attribute: &Attribute) -> Guarded<Option<Vec<u8>>> {
    let stored = attribute.dtype().map_err(damaged)?;
    if check_kind(&stored).is_err() {
        return Ok(None);
    }
    let count = attribute.size().checked_mul(stored.size());
    let mut bytes = vec![0; count.ok_or("announces more values than fit")?];
    if bytes.is_empty() {
        return Ok(Some(bytes));
    }
    // SAFETY: there is room for all values of the file's type, none of which refers to other places (`check_kind`).
    let read = hdf5::sync::sync(|| unsafe {
        H5Aread(attribute.id(), stored.id(), bytes.as_mut_ptr().cast())
    });
    if read < 0 { Err("cannot be read".into()) } else { Ok(Some(bytes)) }
}

/// Reads everything about a dataset except its values: their type, and the place of each chunk.
pub(crate) fn look_through(dataset: &Dataset, path: &Path) -> Guarded<()> {
    let stored = dataset.dtype().map_err(damaged)?;
    check_kind(&stored)?;
    if dataset.dcpl().map_err(damaged)?.layout() != Layout::Chunked {
        return Ok(());
    }
    let chunks = Chunks::of(dataset, &stored, path)?;
    let first = vec![0; chunks.shape.len()];
    let end: Vec<usize> =
        dataset.shape().iter().zip(&chunks.shape).map(|(n, c)| n.div_ceil(*c)).collect();
    let mut at = first.clone();
    while !end.contains(&0) {
        let offset: Vec<usize> = at.iter().zip(&chunks.shape).map(|(i, n)| i * n).collect();
        chunks.place(&offset)?;
        if !step(&mut at, &first, &end) {
            break;
        }
    }
    Ok(())
}

/// Refuses values that refer to other places in the file, and compound values.
fn check_kind(stored: &Datatype) -> Guarded<()> {
    match stored.to_descriptor() {
        Ok(
            TypeDescriptor::Integer(_)
            | TypeDescriptor::Unsigned(_)
            | TypeDescriptor::Float(_)
            | TypeDescriptor::Boolean
            | TypeDescriptor::Enum(_)
            | TypeDescriptor::FixedAscii(_)
            | TypeDescriptor::FixedUnicode(_),
        ) => Ok(()),
        Ok(other) => {
            Err(format!("holds values of the type `{other}`; expected numbers or short texts"))
        }
        Err(_) if is_float(stored) => Ok(()),
        Err(e) => Err(damaged(e)),
    }
}

/// Whether values are floating-point numbers, including widths that the library has no name for: numbers of two bytes.
pub(crate) fn is_float(stored: &Datatype) -> bool {
    // SAFETY: the type stays open while `stored` exists.
    let class = hdf5::sync::sync(|| unsafe { H5Tget_class(stored.id()) });
    class == H5T_class_t::H5T_FLOAT && stored.size() <= size_of::<f64>()
}

/// The chunks of a dataset.
struct Chunks<'a> {
    dataset: &'a Dataset,
    file: File,
    file_bytes: u64,
    filters: Filters,
    /// Number of values of a chunk along each axis.
    shape: Vec<usize>,
    /// Number of bytes of a value in the file.
    value_bytes: usize,
    /// Fill value, for values that were never written.
    fill: Vec<u8>,
}

/// Place of a chunk in the file.
struct ChunkPlace {
    address: u64,
    bytes: usize,
    /// Bits of the filters that were not applied to the chunk.
    skipped: u32,
}

impl<'a> Chunks<'a> {
    fn of(dataset: &'a Dataset, stored: &Datatype, path: &Path) -> Guarded<Self> {
        let unreadable = |e: std::io::Error| format!("cannot be read ({e})");
        let file = File::open(path).map_err(unreadable)?;
        let plan = dataset.dcpl().map_err(damaged)?;
        let shape = plan.chunk().filter(|c| c.len() == dataset.ndim() && !c.contains(&0));
        let value_bytes = stored.size();
        let mut fill = vec![0; value_bytes];
        // SAFETY: the fill value is a value of this type, for which there is room.
        let filled = hdf5::sync::sync(|| unsafe {
            H5Pget_fill_value(plan.id(), stored.id(), fill.as_mut_ptr().cast())
        });
        if filled < 0 {
            return Err("has no readable fill value".into());
        }
        Ok(Chunks {
            dataset,
            file_bytes: file.metadata().map_err(unreadable)?.len(),
            file,
            filters: Filters::of(&plan, value_bytes)?,
            shape: shape.ok_or("has chunks of no size")?,
            value_bytes,
            fill,
        })
    }

    /// Reads the values of a part, without gaps. There is one copy of them, which first holds the values of the file's type.
    fn part<T: Plain>(
        &self,
        ranges: &[Range<usize>],
        lengths: &[usize],
        stored: &Datatype,
    ) -> Guarded<Vec<T>> {
        let largest = size_of::<T>().max(self.value_bytes);
        let bytes = lengths.iter().try_fold(largest, |n, length| n.checked_mul(*length));
        let bytes = bytes.ok_or_else(|| format!("announces {lengths:?} values, more than fit"))?;
        let (count, room): (usize, usize) =
            (lengths.iter().product(), bytes.div_ceil(size_of::<T>()));
        // SAFETY: zeros are a valid value, as any bytes are (`Plain`).
        let mut values = vec![unsafe { MaybeUninit::<T>::zeroed().assume_init() }; room];
        // SAFETY: all bytes of the values, which may become any other bytes (`Plain`); nothing else accesses them while `out` exists.
        let out = unsafe {
            std::slice::from_raw_parts_mut(
                values.as_mut_ptr().cast::<u8>(),
                size_of_val(&values[..]),
            )
        };
        for value in out[..count * self.value_bytes].chunks_exact_mut(self.value_bytes.max(1)) {
            value.copy_from_slice(&self.fill);
        }
        self.gather(ranges, lengths, out)?;
        convert::<T>(out, stored, count)?;
        values.truncate(count);
        Ok(values)
    }

    /// Copies the bytes of a part to the beginning of `out`, without gaps.
    fn gather(&self, ranges: &[Range<usize>], lengths: &[usize], out: &mut [u8]) -> Guarded<()> {
        let first: Vec<usize> = ranges.iter().zip(&self.shape).map(|(r, n)| r.start / n).collect();
        let end: Vec<usize> =
            ranges.iter().zip(&self.shape).map(|(r, n)| r.end.div_ceil(*n)).collect();
        let mut at = first.clone();
        loop {
            let offset: Vec<usize> = at.iter().zip(&self.shape).map(|(i, n)| i * n).collect();
            if let Some(chunk) = self.chunk(&offset)? {
                self.copy(&chunk, &offset, ranges, lengths, out);
            }
            if !step(&mut at, &first, &end) {
                return Ok(());
            }
        }
    }

    /// Returns the place in the file of the chunk whose first value is at `offset`, if it was written.
    fn place(&self, offset: &[usize]) -> Guarded<Option<ChunkPlace>> {
        let place: Vec<u64> = offset.iter().map(|n| *n as u64).collect();
        let (mut skipped, mut address, mut bytes) = (0, NOWHERE, 0);
        // SAFETY: `place` has a number for each axis of the dataset, as chunks do; the library writes one value to each of the other
        // arguments.
        let found = hdf5::sync::sync(|| unsafe {
            H5Dget_chunk_info_by_coord(
                self.dataset.id(),
                place.as_ptr(),
                &raw mut skipped,
                &raw mut address,
                &raw mut bytes,
            )
        });
        if found < 0 {
            return Err("has an index of its chunks that cannot be read".into());
        }
        if address == NOWHERE || bytes == 0 {
            return Ok(None);
        }
        if address.checked_add(bytes).is_none_or(|end| end > self.file_bytes) {
            return Err(format!("has a chunk beyond the end of the file, at {offset:?}"));
        }
        Ok(Some(ChunkPlace { address, bytes: bytes as usize, skipped }))
    }

    /// Returns the bytes of the chunk whose first value is at `offset`, if it was written.
    fn chunk(&self, offset: &[usize]) -> Guarded<Option<Vec<u8>>> {
        let Some(place) = self.place(offset)? else { return Ok(None) };
        let mut packed = vec![0; place.bytes];
        let mut file = &self.file;
        file.seek(SeekFrom::Start(place.address))
            .and_then(|_| file.read_exact(&mut packed))
            .map_err(|e| format!("has a chunk at {offset:?} that cannot be read ({e})"))?;
        let expected = self.shape.iter().product::<usize>() * self.value_bytes;
        let unpacked = self.filters.unpacked(packed, place.skipped, expected);
        unpacked.map(Some).map_err(|fault| format!("has a chunk at {offset:?} that {fault}"))
    }

    /// Copies the values that a chunk and the part share, row by row.
    fn copy(
        &self,
        chunk: &[u8],
        offset: &[usize],
        ranges: &[Range<usize>],
        lengths: &[usize],
        out: &mut [u8],
    ) {
        let low: Vec<usize> = ranges.iter().zip(offset).map(|(r, o)| r.start.max(*o)).collect();
        let ends = offset.iter().zip(&self.shape).map(|(o, n)| o + n);
        let high: Vec<usize> = ranges.iter().zip(ends).map(|(r, end)| r.end.min(end)).collect();
        // A dataset without axes has no chunks, so there is at least one axis.
        let last = low.len() - 1;
        let row = (high[last] - low[last]) * self.value_bytes;
        let (mut at, mut ends) = (low.clone(), high);
        ends[last] = low[last] + 1;
        loop {
            let index = |sizes: &[usize], first: &dyn Fn(usize) -> usize| {
                (0..=last).fold(0, |n, k| n * sizes[k] + at[k] - first(k)) * self.value_bytes
            };
            let from = index(&self.shape, &|k| offset[k]);
            let to = index(lengths, &|k| ranges[k].start);
            out[to..to + row].copy_from_slice(&chunk[from..from + row]);
            if !step(&mut at, &low, &ends) {
                return;
            }
        }
    }
}

/// Moves to the next place of a box, the last axis fastest; returns false behind the last place.
fn step(at: &mut [usize], first: &[usize], end: &[usize]) -> bool {
    for axis in (0..at.len()).rev() {
        at[axis] += 1;
        if at[axis] < end[axis] {
            return true;
        }
        at[axis] = first[axis];
    }
    false
}

/// Converts values of the file's type to another type, in place.
fn convert<T: Plain>(bytes: &mut [u8], stored: &Datatype, count: usize) -> Guarded<()> {
    let wanted = Datatype::from_type::<T>().map_err(damaged)?;
    if *stored == wanted {
        return Ok(());
    }
    assert!(bytes.len() >= count * size_of::<T>().max(stored.size()), "room for either type");
    // SAFETY: the buffer has room for the values of either type, as asserted. Neither type refers to other places (`check_kind`), nor is it
    // compound, which would take a second buffer.
    let done = hdf5::sync::sync(|| unsafe {
        let at = bytes.as_mut_ptr().cast();
        H5Tconvert(stored.id(), wanted.id(), count, at, std::ptr::null_mut(), H5P_DEFAULT)
    });
    match done {
        done if done < 0 => Err(format!("holds values of another kind than {wanted:?}")),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Ix1;

    /// No value is written, so no earlier read can fail.
    #[test]
    fn more_values_than_can_be_counted_in_bytes_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("wide.h5");
        let file = hdf5::File::create(&path).unwrap();
        let shape = file.new_dataset::<u8>().chunk(1024).shape(1_usize << 61);
        let dataset = shape.create("values").unwrap();
        let fault = all::<f64, Ix1>(&dataset, &path).unwrap_err();
        assert!(fault.contains("more than fit"), "{fault}");
    }
}
