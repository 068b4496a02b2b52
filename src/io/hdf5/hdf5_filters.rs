//! Packs and unpacks the chunks of HDF5 files: the library does this on one thread.

use std::io::{Read, Write};

use flate2::Compression;
use flate2::read::ZlibDecoder;
use flate2::write::ZlibEncoder;
use hdf5::filters::Filter;
use hdf5::plist::DatasetCreate;
use ndarray::ArrayView2;

use super::hdf5_guard::{Guarded, damaged};

/// Number of bytes of a checksum behind a chunk.
const CHECKSUM: usize = 4;

/// The filters with which the chunks of a dataset are packed.
pub(crate) struct Filters {
    steps: Vec<FilterStep>,
    /// Number of bytes of a value, which the filters shuffle.
    value_bytes: usize,
}

#[derive(Clone, Copy, PartialEq)]
enum FilterStep {
    Deflate,
    Shuffle,
    Checksum,
}

impl Filters {
    /// Reads the filters of a dataset. Only filters whose unpacked size is bounded are accepted.
    pub fn of(plan: &DatasetCreate, value_bytes: usize) -> Guarded<Self> {
        let known = |filter: &Filter| match filter {
            Filter::Deflate(_) => Ok(FilterStep::Deflate),
            Filter::Shuffle => Ok(FilterStep::Shuffle),
            Filter::Fletcher32 => Ok(FilterStep::Checksum),
            other => Err(format!(
                "is packed by {other:?}, which is not read; save it again with gzip, or unpacked"
            )),
        };
        let filters = plan.get_filters().map_err(damaged)?;
        let steps: Vec<FilterStep> = filters.iter().map(known).collect::<Guarded<_>>()?;
        if steps.iter().filter(|step| **step == FilterStep::Deflate).count() > 1 {
            return Err("is packed twice, which is not read; save it again".into());
        }
        Ok(Filters { steps, value_bytes })
    }

    /// Unpacks a chunk. Filters whose bit is set in `skipped` were not applied to it. The chunk must unpack to `expected` bytes; no more
    /// are ever unpacked.
    pub fn unpacked(&self, packed: Vec<u8>, skipped: u32, expected: usize) -> Guarded<Vec<u8>> {
        let most = expected + CHECKSUM * self.steps.len();
        let mut bytes = packed;
        for (i, step) in self.steps.iter().enumerate().rev() {
            if i < 32 && skipped >> i & 1 == 1 {
                continue;
            }
            bytes = match step {
                FilterStep::Deflate => inflated(&bytes, most)?,
                FilterStep::Shuffle => unshuffled(&bytes, self.value_bytes),
                FilterStep::Checksum => checked(bytes)?,
            };
        }
        match bytes.len() == expected {
            true => Ok(bytes),
            false => Err(format!("holds {} bytes in place of {expected}", bytes.len())),
        }
    }
}

/// Largest number of bytes that one byte unpacks to (zlib's documentation).
const LARGEST_DEFLATION: usize = 1032;

fn inflated(packed: &[u8], most: usize) -> Guarded<Vec<u8>> {
    // Memory is reserved for all bytes at once: a vector that grows exists twice for a moment.
    let mut bytes = Vec::with_capacity(most.min(packed.len().saturating_mul(LARGEST_DEFLATION)));
    let mut decoder = ZlibDecoder::new(packed).take(most as u64 + 1);
    decoder.read_to_end(&mut bytes).map_err(|e| format!("does not unpack ({e})"))?;
    match bytes.len() > most {
        true => Err(format!("unpacks to more than {most} bytes")),
        false => Ok(bytes),
    }
}

/// Packs a chunk as the filters shuffle and deflate of this level do.
pub fn shuffled_and_deflated(values: ArrayView2<f32>, level: u8) -> std::io::Result<Vec<u8>> {
    const BYTES: usize = size_of::<f32>();
    let mut shuffled = Vec::with_capacity(BYTES * values.len());
    for byte in 0..BYTES {
        shuffled.extend(values.iter().map(|value| value.to_ne_bytes()[byte]));
    }
    let packed = Vec::with_capacity(shuffled.len());
    let mut encoder = ZlibEncoder::new(packed, Compression::new(u32::from(level)));
    encoder.write_all(&shuffled)?;
    encoder.finish()
}

/// Undoes shuffling: the first bytes of all values, then the second bytes ...; the remaining bytes stay at the end.
fn unshuffled(bytes: &[u8], value_bytes: usize) -> Vec<u8> {
    let count = bytes.len() / value_bytes.max(1);
    let mut out = vec![0; bytes.len()];
    for (k, plane) in bytes[..count * value_bytes].chunks_exact(count.max(1)).enumerate() {
        for (i, byte) in plane.iter().enumerate() {
            out[i * value_bytes + k] = *byte;
        }
    }
    out[count * value_bytes..].copy_from_slice(&bytes[count * value_bytes..]);
    out
}

/// Checks the checksum, and returns the bytes before it.
fn checked(mut bytes: Vec<u8>) -> Guarded<Vec<u8>> {
    let end = bytes.len().checked_sub(CHECKSUM).ok_or("is too short for its checksum")?;
    let stored = u32::from_le_bytes([bytes[end], bytes[end + 1], bytes[end + 2], bytes[end + 3]]);
    bytes.truncate(end);
    match fletcher32(&bytes) == stored {
        true => Ok(bytes),
        false => Err("is damaged: its checksum is another".into()),
    }
}

/// Returns the sum of 16-bit words, high byte first, and the sum of those sums (RFC 1146, as HDF5 uses it).
fn fletcher32(bytes: &[u8]) -> u32 {
    let (mut low, mut high) = (0_u32, 0_u32);
    let fold = |sum: u32| (sum & 0xffff) + (sum >> 16);
    for pair in bytes.chunks(2) {
        low = fold(low + u32::from(pair[0]) * 256 + u32::from(*pair.get(1).unwrap_or(&0)));
        high = fold(high + low);
    }
    fold(high) << 16 | fold(low)
}
