//! Writes TIFF with calibrated pixels and grey values, as ImageJ and tifffile read them.

use std::path::Path;

use crate::error::{Error, Result};
use crate::files::atomic_write;
use crate::io::hdf5::images::image_series::{ImageSeries, rounded};
use crate::setting::Setting;

/// Denominator of the resolution, which gives it six decimals.
const PER_MILLION: f64 = 1e6;
/// Number of entries of a page; the first page has two more if its images have labels.
const TAGS: usize = 14;
const LABEL_TAGS: usize = 2;
/// Number of bytes of the two resolutions.
const RESOLUTION_BYTES: usize = 16;
/// Tags of ImageJ: lengths of the parts of its metadata, and the metadata.
const METADATA_COUNTS: u16 = 50838;
const METADATA: u16 = 50839;
/// Codes of the kinds of values.
const UNSIGNED: u16 = 1;
const FLOAT: u16 = 3;
/// Largest number of bytes of values; the rest of the file then fits below the 4 GiB that offsets of 32 bits reach.
const LARGEST: usize = 4_000_000_000;

/// Types of grey values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TiffDepth {
    /// Whole numbers from 0 to 255, from the least to the greatest value of the stack.
    Bits8,
    /// Whole numbers from 0 to 65 535, from the least to the greatest value of the stack.
    Bits16,
    /// The values themselves, in single precision.
    Bits32,
}

/// Writes a series as one TIFF with a page for each image: for each thickness, and in a defocus series also for each defocus.
/// `ImageDescription` and resolution give ImageJ the pixel in Angstrom, the values that whole numbers represent, and the label of each
/// image. In ImageJ a single axis becomes slices; of two axes, the thickness becomes slices and the defocus frames.
///
/// # Errors
/// [`Error::Invalid`] for more than a TIFF can hold, [`Error::Io`].
pub fn write_tiff(
    path: &Path,
    overwrite: bool,
    series: &ImageSeries,
    depth: TiffDepth,
) -> Result<()> {
    let values = series.shape().iter().fold(4_usize, |n, length| n.saturating_mul(*length));
    if values > LARGEST {
        let expected =
            format!("TIFF holds up to 4 GB, and this stack has {values} bytes; write HDF5 instead");
        return Err(Error::invalid(Setting::Output, path.display(), expected));
    }
    atomic_write::write_with(path, overwrite, |temporary| {
        std::fs::write(temporary, bytes(series, depth)).map_err(|e| Error::io(path, "write", e))
    })
}

/// Returns all pages: first the values of all pages, then their directories. ImageJ reads the values of a stack from the place behind the
/// values of its first page; other readers go from page to page.
fn bytes(series: &ImageSeries, depth: TiffDepth) -> Vec<u8> {
    let ends = |(a, b): (f32, f32), v: &f32| (a.min(*v), b.max(*v));
    let all = || series.stacks.iter().flat_map(|stack| stack.data.iter());
    let (low, high) = all().fold((f32::INFINITY, f32::NEG_INFINITY), ends);
    let (levels, bits, format) = match depth {
        TiffDepth::Bits8 => (255.0, 8u16, UNSIGNED),
        TiffDepth::Bits16 => (65535.0, 16, UNSIGNED),
        TiffDepth::Bits32 => (0.0, 32, FLOAT),
    };
    let slope = if levels > 0.0 && high > low { (high - low) / levels } else { 1.0 };
    let description = description(series, (levels > 0.0).then_some([low, slope]), [low, high]);
    let labels = Labels::new(&series.labels());
    let level = |v: f32| ((v - low) / slope).round();
    let mut out = b"II*\0\0\0\0\0".to_vec();
    let mut starts = Vec::new();
    for image in series.stacks.iter().flat_map(|stack| stack.data.outer_iter()) {
        starts.push(out.len());
        for v in image {
            match depth {
                TiffDepth::Bits8 => out.push(level(*v) as u8),
                TiffDepth::Bits16 => out.extend((level(*v) as u16).to_le_bytes()),
                TiffDepth::Bits32 => out.extend(v.to_le_bytes()),
            }
        }
    }
    let (_, rows, columns) = series.first().data.dim();
    let size = rows * columns * usize::from(bits) / 8;
    let mut link = 4;
    for (n, start) in starts.into_iter().enumerate() {
        out.resize(out.len().next_multiple_of(2), 0);
        let page = Directory { at: out.len(), columns, rows, bits, format, start, size };
        out[link..link + 4].copy_from_slice(&(page.at as u32).to_le_bytes());
        let labels = labels.as_ref().filter(|_| n == 0);
        link = page.write(&mut out, (&description, labels), series.first().step_angstrom);
    }
    out
}

/// Directory of a page.
struct Directory {
    at: usize,
    columns: usize,
    rows: usize,
    bits: u16,
    format: u16,
    start: usize,
    size: usize,
}

impl Directory {
    /// Appends the directory; returns the place at which the offset of the next directory must be written.
    fn write(
        &self,
        out: &mut Vec<u8>,
        (description, labels): (&str, Option<&Labels>),
        step_angstrom: [f64; 2],
    ) -> usize {
        let text = [description.as_bytes(), b"\0"].concat();
        let tags = TAGS + labels.map_or(0, |_| LABEL_TAGS);
        let beyond = self.at + 2 + 12 * tags + 4;
        let resolution = beyond + text.len().next_multiple_of(2);
        let counts = resolution + RESOLUTION_BYTES;
        let (long, short) =
            (|tag, n: usize| (tag, 4u16, 1, n), |tag, n: u16| (tag, 3u16, 1, usize::from(n)));
        let entries: [(u16, u16, usize, usize); TAGS] = [
            long(256, self.columns),
            long(257, self.rows),
            short(258, self.bits),
            short(259, 1),
            short(262, 1),
            (270, 2, text.len(), beyond),
            long(273, self.start),
            short(277, 1),
            long(278, self.rows),
            long(279, self.size),
            (282, 5, 1, resolution),
            (283, 5, 1, resolution + 8),
            // 1: a unit that the description names.
            short(296, 1),
            short(339, self.format),
        ];
        let of_labels = labels.map(|labels| {
            let lengths = labels.counts.len();
            [
                (METADATA_COUNTS, 4, lengths, counts),
                (METADATA, 1, labels.bytes.len(), counts + 4 * lengths),
            ]
        });
        out.extend((tags as u16).to_le_bytes());
        for (tag, kind, count, value) in entries.into_iter().chain(of_labels.into_iter().flatten())
        {
            out.extend(tag.to_le_bytes());
            out.extend(kind.to_le_bytes());
            out.extend((count as u32).to_le_bytes());
            out.extend((value as u32).to_le_bytes());
        }
        let next = out.len();
        out.extend([0; 4]);
        out.extend(&text);
        out.resize(resolution, 0);
        for step in step_angstrom {
            out.extend(((PER_MILLION / step).round() as u32).to_le_bytes());
            out.extend((PER_MILLION as u32).to_le_bytes());
        }
        if let Some(labels) = labels {
            labels.counts.iter().for_each(|n| out.extend((*n as u32).to_le_bytes()));
            out.extend(&labels.bytes);
        }
        next
    }
}

/// Labels that ImageJ shows above each image of a stack, in ImageJ's tags.
struct Labels {
    /// Number of bytes of the header and of each label.
    counts: Vec<usize>,
    bytes: Vec<u8>,
}

impl Labels {
    /// Makes the labels; `None` for one image.
    fn new(labels: &[String]) -> Option<Self> {
        if labels.len() < 2 {
            return None;
        }
        // "IJIJ" and "labl", read as numbers of this byte order.
        let head = [&b"JIJI"[..], b"lbal", &(labels.len() as u32).to_le_bytes()].concat();
        let mut all = Labels { counts: vec![head.len()], bytes: head };
        for label in labels {
            let text: Vec<u8> = label.encode_utf16().flat_map(u16::to_le_bytes).collect();
            all.counts.push(text.len());
            all.bytes.extend(text);
        }
        Some(all)
    }
}

/// Returns the text that ImageJ reads: a key and a value on each line.
fn description(
    series: &ImageSeries,
    calibration: Option<[f32; 2]>,
    [low, high]: [f32; 2],
) -> String {
    let axes = series.axes();
    let pages: usize = axes.iter().map(|axis| axis.values_angstrom.len()).product();
    let mut lines = vec!["ImageJ=1.54f".to_owned(), format!("images={pages}")];
    match &axes[..] {
        [] => {}
        [only] => {
            lines.push(format!("slices={pages}"));
            lines.extend(only.even().map(|[_, step]| format!("spacing={}", rounded(step))));
        }
        [outer, inner, ..] => {
            lines.push(format!("slices={}", inner.values_angstrom.len()));
            lines.push(format!("frames={}\nhyperstack=true", outer.values_angstrom.len()));
            lines.extend(inner.even().map(|[_, step]| format!("spacing={}", rounded(step))));
        }
    }
    lines.push("unit=Angstrom".into());
    let stack = series.first();
    if let Some([offset, slope]) = calibration {
        lines.push(format!("cf=0\nc0={offset}\nc1={slope}\nvunit={}", stack.units));
    } else {
        lines.push(format!("min={low}\nmax={high}"));
    }
    let [x, y] = stack.origin_angstrom;
    lines.push(format!("image={}\norigin_angstrom={x},{y}", series.name));
    let names: Vec<&str> = axes.iter().map(|axis| axis.name).chain(["y", "x"]).collect();
    lines.push(format!("axes={}", names.join(",")));
    let list = |values: &[f64]| {
        values.iter().map(|v| rounded(*v).to_string()).collect::<Vec<_>>().join(",")
    };
    for axis in &axes {
        lines.push(format!("{}_angstrom={}", axis.name, list(&axis.values_angstrom)));
    }
    if !axes.iter().any(|axis| axis.name == "thickness") {
        lines.push(format!("thickness_angstrom={}", list(stack.thicknesses_angstrom)));
    }
    lines.join("\n") + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::hdf5::images::image_file::ImageStack;
    use ndarray::Array3;
    use std::fs::File;
    use tiff::decoder::{Decoder, DecodingResult};
    use tiff::tags::Tag;

    #[test]
    fn pages_values_and_imagej_tags_come_back() {
        let folder = tempfile::tempdir().unwrap();
        let data = Array3::from_shape_fn((2, 3, 4), |(t, i, j)| (t * 12 + i * 4 + j) as f32 * 0.01);
        let stack = ImageStack {
            name: "HAADF",
            data: data.view(),
            units: "fraction of the incident beam",
            step_angstrom: [0.25, 0.5],
            origin_angstrom: [0.0; 2],
            thicknesses_angstrom: &[10.0, 20.0],
            defocus_angstrom: None,
            annulus_mrad: None,
            sector_degrees: None,
            electrons_per_pixel: None,
        };
        for depth in [TiffDepth::Bits8, TiffDepth::Bits16, TiffDepth::Bits32] {
            let path = folder.path().join(format!("{depth:?}.tif"));
            write_tiff(&path, false, &ImageSeries::of_one(&stack), depth).unwrap();
            let mut decoder = Decoder::new(File::open(&path).unwrap()).unwrap();
            let text = decoder.get_tag_ascii_string(Tag::ImageDescription).unwrap();
            assert!(
                text.starts_with("ImageJ=")
                    && text.contains("unit=Angstrom")
                    && text.contains("axes=thickness,y,x\nthickness_angstrom=10,20")
                    && text.contains("images=2"),
                "{text}"
            );
            let labels = decoder.get_tag_u8_vec(Tag::Unknown(METADATA)).unwrap();
            let counts = decoder.get_tag_u64_vec(Tag::Unknown(METADATA_COUNTS)).unwrap();
            let utf16: Vec<u8> = "thickness 10 A".bytes().flat_map(|b| [b, 0]).collect();
            assert_eq!(counts, [12, 28, 28]);
            assert_eq!(labels[12..40], utf16[..]);
            let resolution = decoder.get_tag_u64_vec(Tag::XResolution).unwrap();
            assert_eq!(resolution, [4_000_000, 1_000_000]);
            let number = |key: &str| -> f32 {
                let line = text.lines().find_map(|l| l.strip_prefix(key));
                line.map_or(f32::from(key == "c1="), |v| v.parse().unwrap())
            };
            let (offset, slope) = (number("c0="), number("c1="));
            // The pages' values lie one after the other, as ImageJ reads them.
            let starts: Vec<u64> = (0..2)
                .map(|n| {
                    decoder.seek_to_image(n).unwrap();
                    decoder.get_tag_u64(Tag::StripOffsets).unwrap()
                })
                .collect();
            let bytes = decoder.get_tag_u64(Tag::StripByteCounts).unwrap();
            assert_eq!(starts, [8, 8 + bytes]);
            decoder.seek_to_image(0).unwrap();
            for page in data.outer_iter() {
                let found: Vec<f32> = match decoder.read_image().unwrap() {
                    DecodingResult::U8(v) => v.into_iter().map(f32::from).collect(),
                    DecodingResult::U16(v) => v.into_iter().map(f32::from).collect(),
                    DecodingResult::F32(v) => v,
                    other => panic!("{other:?}"),
                };
                let most = if depth == TiffDepth::Bits8 { 5e-4 } else { 3e-6 };
                for (a, b) in found.iter().zip(page) {
                    assert!((offset + slope * a - b).abs() <= most, "{depth:?}: {a} {b}");
                }
                if decoder.more_images() {
                    decoder.next_image().unwrap();
                }
            }
        }
    }
}
