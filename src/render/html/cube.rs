//! The page of diffraction patterns: a place of the scan shows its pattern, and a detector drawn on the mean pattern shows its image.

use std::ops::Range;

use ndarray::{Array3, Array4, ArrayView4, s};
use serde::Serialize;

use super::blobs::Blobs;
use super::{Page, PagePart, STYLE, colormaps};
use crate::detect::PixelatedDetector;
use crate::error::{Error, Result};
use crate::io::PatternHeader;
use crate::progress::Progress;
use crate::render::enlarge::check_finite;
use crate::setting::Setting;

/// Intensities that a page holds at most, in 16 bits each: browsers open pages of 50 MB within seconds.
const MOST_VALUES: usize = 1 << 24;
/// Patterns are not summed to fewer pixels along an edge.
const FEWEST_PIXELS: usize = 16;
/// The largest code of an intensity.
const LARGEST_CODE: f32 = u16::MAX as f32;

const SCRIPTS: [&str; 3] =
    [include_str!("data.js"), include_str!("shared.js"), include_str!("cube.js")];
const TEMPLATE: &str = include_str!("cube.html");
const CUBE_STYLE: &str = include_str!("cube.css");

/// Diffraction patterns of one scan.
#[derive(Debug, Clone)]
pub struct CubePage {
    /// Name of the file.
    pub title: String,
    /// Names and values to be read by people.
    pub facts: Vec<(String, String)>,
    /// Rows and columns of the scan.
    pub scan: [usize; 2],
    /// Distance of probes (x, y) in Angstrom.
    pub step_angstrom: [f64; 2],
    /// Position (x, y) of the first probe in Angstrom.
    pub origin_angstrom: [f64; 2],
    /// The pixels of a pattern.
    pub detector: PixelatedDetector,
    /// Semiangle of the probe in mrad.
    pub semiangle_mrad: f64,
    /// Whether intensities are counted electrons; else they are fractions of the beam.
    pub counted: bool,
}

/// What the page's scripts read first.
#[derive(Serialize)]
struct CubeHeader<'a> {
    title: &'a str,
    facts: &'a [(String, String)],
    /// Columns and rows of the scan.
    scan: [usize; 2],
    /// Distance of probes, and the position of the first, in Angstrom.
    step: [f64; 2],
    origin: [f64; 2],
    /// Pixels along an edge of a pattern.
    pixels: usize,
    /// Width of a pixel, and the angle of the middle of the first, in mrad.
    pixel: f64,
    first: f64,
    semiangle: f64,
    quantity: &'static str,
    /// An intensity is `scale * code`, or `scale * code^2` if `square`.
    scale: f64,
    square: bool,
    /// What was summed to keep the page small.
    note: Option<String>,
    colormaps: Vec<(&'static str, String)>,
}

/// How many pixels, and how many probes, along each axis become one.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Reduction {
    pixels: usize,
    probes: usize,
}

impl CubePage {
    /// The page of a file of patterns, as its header describes them; `None` for sums over rings.
    pub fn of(header: &PatternHeader, title: String) -> Option<Self> {
        let detector = *header.detector.pixels()?;
        let [rows, columns] = header.scan.shape;
        let [dx, dy] = header.scan.step_angstrom;
        let pixels = detector.pixels;
        let mut facts = vec![
            ("probes", format!("{columns} \u{d7} {rows}, {dx:.3} \u{d7} {dy:.3} \u{c5} apart")),
            (
                "patterns",
                format!(
                    "{pixels} \u{d7} {pixels} pixels of {:.3} mrad, to {} mrad",
                    detector.pixel_mrad(),
                    detector.max_angle_mrad
                ),
            ),
            ("beam", format!("{} keV, {} mrad", header.energy_kev, header.semiangle_mrad)),
            ("thickness", format!("{:.2} \u{c5}", header.thickness_angstrom)),
            ("defocus", format!("{} \u{c5}", header.defocus_angstrom)),
        ];
        let counted = header.counted.map(|(electrons, _)| electrons);
        facts.extend(counted.map(|n| ("dose", format!("{n:.1} electrons per pattern"))));
        Some(CubePage {
            title,
            facts: facts.into_iter().map(|(name, value)| (name.to_owned(), value)).collect(),
            scan: header.scan.shape,
            step_angstrom: header.scan.step_angstrom,
            origin_angstrom: header.scan.origin_angstrom,
            detector,
            semiangle_mrad: header.semiangle_mrad,
            counted: counted.is_some(),
        })
    }

    /// Makes the page. `rows` gives the patterns of some rows of the scan, (row, column, ky, kx). Large scans are reduced: neighbouring
    /// pixels of patterns are summed first, then neighbouring probes averaged.
    ///
    /// # Errors
    /// Errors of `rows`; [`Error::Invalid`] for intensities that are not finite or below zero; [`Error::Interrupted`].
    pub fn page(
        &self,
        rows: &dyn Fn(Range<usize>) -> Result<Array4<f32>>,
        progress: &dyn Progress,
    ) -> Result<Page> {
        let reduction = Reduction::of(self.scan, self.detector.pixels);
        let reduced = self.reduced(reduction, rows, progress)?;
        let largest = reduced.iter().flatten().fold(0.0_f32, |a, b| a.max(*b));
        let exact = self.counted && reduction.probes == 1 && largest <= LARGEST_CODE;
        let code = |v: f32| match exact {
            true => v as u16,
            false => (LARGEST_CODE * (v / largest).sqrt()).round() as u16,
        };
        let mut blobs = Blobs::default();
        for row in &reduced {
            let codes: Vec<u16> = row.iter().map(|v| code(*v)).collect();
            let low = codes.iter().map(|c| *c as u8);
            let high = codes.iter().map(|c| (*c >> 8) as u8);
            blobs.add(&low.chain(high).collect::<Vec<u8>>());
        }
        let [by_pixels, by_probes] = [reduction.pixels, reduction.probes].map(|n| n as f64);
        let pixel = self.detector.pixel_mrad();
        let header = CubeHeader {
            title: &self.title,
            facts: &self.facts,
            scan: [1, 0].map(|axis| self.scan[axis].div_ceil(reduction.probes)),
            step: self.step_angstrom.map(|step| by_probes * step),
            origin: [0, 1]
                .map(|k| self.origin_angstrom[k] + 0.5 * (by_probes - 1.0) * self.step_angstrom[k]),
            pixels: self.detector.pixels.div_ceil(reduction.pixels),
            pixel: by_pixels * pixel,
            first: self.detector.angle_mrad(0) + 0.5 * (by_pixels - 1.0) * pixel,
            semiangle: self.semiangle_mrad,
            quantity: if self.counted { "electrons" } else { "fraction of the beam" },
            scale: match exact {
                true => 1.0,
                false => f64::from(largest) / f64::from(LARGEST_CODE).powi(2),
            },
            square: !exact,
            note: reduction.words(),
            colormaps: colormaps(),
        };
        let part = PagePart {
            title: &self.title,
            template: TEMPLATE,
            styles: &[STYLE, CUBE_STYLE],
            scripts: &SCRIPTS,
        };
        Page::of(&part, &header, &blobs)
    }

    /// The intensities that the page shows, a vector (column, ky, kx) for each row of probes.
    fn reduced(
        &self,
        reduction: Reduction,
        rows: &dyn Fn(Range<usize>) -> Result<Array4<f32>>,
        progress: &dyn Progress,
    ) -> Result<Vec<Vec<f32>>> {
        let count = self.scan[0];
        let mut reduced = Vec::with_capacity(count.div_ceil(reduction.probes));
        progress.start("reading", "rows", count as u64);
        for first in (0..count).step_by(reduction.probes) {
            if progress.interrupted() {
                return Err(Error::Interrupted);
            }
            let patterns = rows(first..(first + reduction.probes).min(count))?;
            let values: Vec<f32> = reduction.apply(patterns.view()).into_iter().collect();
            check_finite(&values, values.len().max(1))?;
            if let Some(below) = values.iter().find(|v| **v < 0.0) {
                return Err(Error::invalid(
                    Setting::Images,
                    below,
                    "expected intensities of 0 or more",
                ));
            }
            reduced.push(values);
            progress.advance(patterns.dim().0 as u64);
        }
        progress.finish();
        Ok(reduced)
    }
}

impl Reduction {
    fn of(scan: [usize; 2], pixels: usize) -> Self {
        let mut reduction = Reduction { pixels: 1, probes: 1 };
        let values = |r: Reduction| {
            let probes = scan.map(|n| n.div_ceil(r.probes)).iter().product::<usize>();
            probes * pixels.div_ceil(r.pixels).pow(2)
        };
        while values(reduction) > MOST_VALUES {
            if pixels >= 2 * reduction.pixels * FEWEST_PIXELS {
                reduction.pixels *= 2;
            } else {
                reduction.probes *= 2;
            }
        }
        reduction
    }

    /// Some rows of probes as one row: (row, column, ky, kx) becomes (column, ky, kx). Pixels are summed, probes averaged.
    fn apply(self, patterns: ArrayView4<'_, f32>) -> Array3<f32> {
        let (_, columns, height, width) = patterns.dim();
        let (by, step) = (self.pixels, self.probes);
        let shape = (columns.div_ceil(step), height.div_ceil(by), width.div_ceil(by));
        let block = |i: usize, by: usize, n: usize| i * by..((i + 1) * by).min(n);
        Array3::from_shape_fn(shape, |(column, ky, kx)| {
            let columns = block(column, step, columns);
            let (ky, kx) = (block(ky, by, height), block(kx, by, width));
            let part = patterns.slice(s![.., columns, ky, kx]);
            let probes = part.dim().0 * part.dim().1;
            (part.iter().map(|v| f64::from(*v)).sum::<f64>() / probes as f64) as f32
        })
    }

    fn words(self) -> Option<String> {
        let pixels = match self.pixels {
            1 => None,
            n => Some(format!("{n} x {n} pixels of a pattern are summed")),
        };
        let probes = match self.probes {
            1 => None,
            n => Some(format!("{n} x {n} probes are averaged")),
        };
        let parts: Vec<String> = pixels.into_iter().chain(probes).collect();
        (!parts.is_empty()).then(|| format!("to keep the page small, {}", parts.join(", and ")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pages_hold_so_many_intensities_at_most() {
        let cases = [
            ([20, 20], 64, (1, 1)),
            ([64, 64], 64, (1, 1)),
            ([128, 128], 128, (4, 1)),
            ([512, 512], 64, (4, 2)),
            ([512, 512], 20, (1, 4)),
        ];
        for (scan, pixels, (summed, averaged)) in cases {
            let expected = Reduction { pixels: summed, probes: averaged };
            assert_eq!(Reduction::of(scan, pixels), expected, "{scan:?} x {pixels}");
        }
    }

    #[test]
    fn reduced_patterns_keep_the_share_of_the_beam() {
        let patterns =
            Array4::from_shape_fn((2, 3, 5, 5), |(a, b, y, x)| (a + 2 * b + y * x) as f32);
        let reduced = Reduction { pixels: 2, probes: 2 }.apply(patterns.view());
        assert_eq!(reduced.dim(), (2, 3, 3));
        let of = |range: Range<usize>| patterns.slice(s![.., range, .., ..]).sum();
        assert_eq!(reduced.slice(s![0, .., ..]).sum(), of(0..2) / 4.0);
        assert_eq!(reduced.slice(s![1, .., ..]).sum(), of(2..3) / 2.0);
        assert_eq!(reduced[[1, 2, 2]], (patterns[[0, 2, 4, 4]] + patterns[[1, 2, 4, 4]]) / 2.0);
    }
}
