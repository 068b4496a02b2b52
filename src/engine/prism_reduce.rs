//! The reduction of PRISM: images from the exit waves of plane waves.
//!
//! A probe at (x, y) is `sum_k A(k) exp(-2 pi i (kx x + ky y)) S_k`, cut to a window; S_k are the exit waves. On a raster the
//! sum separates: first over kx for each column of the raster, then over ky for each probe. With n beams across the
//! aperture that takes n instead of about 0.8 n^2 products per probe and pixel.

use super::prism::Prism;
use super::probe_scan::Scan;
use super::single_precision::single;
use super::stepper::TransmissionView;
use super::transmission::Transmission;
use crate::error::{Error, Result};
use crate::fft::Buffer;
use crate::matrix::multiply;
use crate::progress::Progress;
use num_complex::{Complex32, Complex64};
use rayon::prelude::*;
use std::f64::consts::PI;
use std::ops::Range;

/// Memory in bytes that one thread may use for sums over kx.
const PARTIAL_SUM_BYTES: usize = 192 << 20;
/// Largest distance in pixels between the first pixels of windows whose raster columns, or rows, are summed together.
const SPREAD_PIXELS: i64 = 16;
/// Largest number of raster columns, or rows, that are summed together.
const MOST_TOGETHER: usize = 16;

/// Neighbouring lines of the raster (columns or rows), and the pixels that their windows cover.
#[derive(Debug, Clone, PartialEq)]
struct LineBand {
    lines: Range<usize>,
    /// First pixel of the union of the windows on the exit grid, not wrapped.
    first: i64,
    /// Number of pixels of that union.
    len: usize,
}

/// One thread's sums, kept from band to band, since allocating memory takes as long as the products.
#[derive(Default)]
struct Sums {
    partial: Vec<Complex32>,
    region: Vec<Complex32>,
}

/// The exit waves of all beams, with the amplitude of each in a probe.
struct LensBeams<'w> {
    waves: &'w [Complex32],
    amplitudes: &'w [Complex64],
    /// Displacement (x, y) in Angstrom of a tilted beam between entrance and exit of the specimen.
    shift: [f64; 2],
}

impl LensBeams<'_> {
    /// Position along `axis` where the probe at `position` leaves the specimen.
    fn leaves(&self, position: [f64; 2], axis: usize) -> f64 {
        position[axis] + self.shift[axis]
    }
}

impl Prism<'_> {
    /// Intensities as fractions of the beam, (probe, recorded thickness, detector) row-major, through each of several lenses. A lens is
    /// given by the amplitudes of its beams at each focus. Beams are propagated once, because the specimen does not depend on the lens.
    ///
    /// # Errors
    /// [`Error::Interrupted`].
    pub(super) fn run(
        &mut self,
        transmission: &Transmission,
        scan: &Scan,
        lenses: &[Vec<Vec<Complex64>>],
        progress: &dyn Progress,
    ) -> Result<Vec<Vec<f64>>> {
        let detectors = self.plan.settings.detectors.len();
        let records = self.plan.record_after.len();
        let mut waves = Buffer::zeros(self.exit_plane() * self.beams.len());
        let mut out = vec![vec![0.0; scan.len() * detectors * records]; lenses.len()];
        let mut first = 0;
        let view = TransmissionView { transmission, origin: (0, 0) };
        for (r, &last) in self.plan.record_after.iter().enumerate() {
            self.propagate(&mut waves, view, first..last + 1, progress)?;
            first = last + 1;
            let shift = self.plan.beam_shift(self.plan.slices.boundaries[last + 1]);
            for (foci, out) in lenses.iter().zip(&mut out) {
                for amplitudes in foci {
                    let beams = LensBeams { waves: &waves, amplitudes, shift };
                    for (probe, values) in self.reduce(&beams, scan, progress)? {
                        let at = (probe * records + r) * detectors;
                        let sums = &mut out[at..at + detectors];
                        sums.iter_mut().zip(&values).for_each(|(sum, v)| *sum += v);
                    }
                }
            }
        }
        Ok(out)
    }

    /// Images from exit waves: for each probe, its index and its intensities on the detectors.
    fn reduce(
        &self,
        beams: &LensBeams,
        scan: &Scan,
        progress: &dyn Progress,
    ) -> Result<Vec<(usize, Vec<f64>)>> {
        let [rows, columns] = scan.shape;
        let one = self.runs().len() * self.exit.points[1] * (self.window.points[0] + 16) * 8;
        let together = (PARTIAL_SUM_BYTES / one).clamp(1, MOST_TOGETHER);
        let across = self.bands(0, columns, together, |c| beams.leaves(scan.position(c), 0));
        let down =
            self.bands(1, rows, MOST_TOGETHER, |r| beams.leaves(scan.position(r * columns), 1));
        let per_band = across
            .par_iter()
            .map_init(Sums::default, |sums, band| {
                self.reduce_columns(beams, scan, band, &down, sums, progress)
            })
            .collect::<Result<Vec<_>>>()?;
        Ok(per_band.into_iter().flatten().collect())
    }

    /// Ranges of beams with equal ky.
    fn runs(&self) -> Vec<Range<usize>> {
        let mut runs: Vec<Range<usize>> = Vec::new();
        for (i, beam) in self.beams.iter().enumerate() {
            match runs.last_mut() {
                Some(run) if self.beams[run.start][1] == beam[1] => run.end = i + 1,
                _ => runs.push(i..i + 1),
            }
        }
        runs
    }

    /// First pixel along `axis` of the window of a probe at `position`.
    fn window_start(&self, axis: usize, position: f64) -> i64 {
        if self.window.points[axis] == self.exit.points[axis] {
            return 0;
        }
        let pixel = self.exit.sampling_angstrom()[axis];
        (position / pixel).round() as i64 - self.window.points[axis] as i64 / 2
    }

    /// Groups neighbouring lines of the raster. The result depends on the raster only, not on the number of threads.
    fn bands(
        &self,
        axis: usize,
        lines: usize,
        most: usize,
        position: impl Fn(usize) -> f64,
    ) -> Vec<LineBand> {
        let window = self.window.points[axis];
        let mut bands: Vec<LineBand> = Vec::new();
        for line in 0..lines {
            let start = self.window_start(axis, position(line));
            if let Some(band) = bands.last_mut() {
                let (low, high) = (
                    band.first.min(start),
                    (band.first + band.len as i64).max(start + window as i64),
                );
                let spread = high - low - window as i64;
                if band.lines.len() < most && spread <= SPREAD_PIXELS {
                    *band = LineBand {
                        lines: band.lines.start..line + 1,
                        first: low,
                        len: (high - low) as usize,
                    };
                    continue;
                }
            }
            bands.push(LineBand { lines: line..line + 1, first: start, len: window });
        }
        bands
    }

    /// All probes on a band of raster columns.
    fn reduce_columns(
        &self,
        beams: &LensBeams,
        scan: &Scan,
        band: &LineBand,
        down: &[LineBand],
        Sums { partial, region }: &mut Sums,
        progress: &dyn Progress,
    ) -> Result<Vec<(usize, Vec<f64>)>> {
        self.sum_over_kx(beams, scan, band, partial);
        let runs = self.runs().len();
        let column_size = runs * self.exit.points[1] * band.len;
        let (mut wave, mut scratch) = (self.window_fft.buffer(), self.window_fft.scratch());
        let mut images = Vec::new();
        for (i, column) in band.lines.clone().enumerate() {
            let offset = (self.window_start(0, beams.leaves(scan.position(column), 0)) - band.first)
                as usize;
            let sums = &partial[i * column_size..][..column_size];
            for rows in down {
                if progress.interrupted() {
                    return Err(Error::Interrupted);
                }
                self.sum_over_ky(sums, scan, band.len, rows, region);
                for (j, row) in rows.lines.clone().enumerate() {
                    let probe = row * scan.shape[1] + column;
                    let below = beams.leaves(scan.position(probe), 1);
                    let top = (self.window_start(1, below) - rows.first) as usize;
                    let area = rows.len * band.len;
                    let source = &region[j * area + top * band.len + offset..];
                    for (y, line) in wave
                        .chunks_exact_mut(self.window_fft.stride())
                        .take(self.window.points[1])
                        .enumerate()
                    {
                        let from = &source[y * band.len..][..self.window.points[0]];
                        line[..self.window.points[0]].copy_from_slice(from);
                    }
                    self.window_fft.forward(&mut wave, &mut scratch);
                    let mut values = vec![0.0; self.plan.settings.detectors.len()];
                    let pixels = (self.window.points[0] * self.window.points[1]) as f64;
                    self.map.collect(&wave, 1.0 / (pixels * pixels), &mut values);
                    images.push((probe, values));
                }
                progress.advance(rows.lines.len() as u64);
            }
        }
        Ok(images)
    }

    /// Sums over kx, `sum_kx A(k) exp(-2 pi i kx x) S_k`, as (raster column, ky, y, x within the band), row-major.
    fn sum_over_kx(
        &self,
        beams: &LensBeams,
        scan: &Scan,
        band: &LineBand,
        out: &mut Vec<Complex32>,
    ) {
        let runs = self.runs();
        let [nx, ny] = self.exit.points;
        let (plane, stride) = (self.exit_plane(), self.exit_fft.stride());
        let count = band.lines.len();
        let column_size = runs.len() * ny * band.len;
        out.resize(count * column_size, Complex32::ZERO);
        for (r, run) in runs.iter().enumerate() {
            let k = run.len();
            let coefficients: Vec<Complex32> = band
                .lines
                .clone()
                .flat_map(|c| run.clone().map(move |b| (c, b)))
                .map(|(c, b)| {
                    let u = scan.position(c)[0] / self.exit.extent_angstrom[0];
                    single(beams.amplitudes[b] * turn(self.beams[b][0], u))
                })
                .collect();
            for y in 0..ny {
                let mut x = 0;
                while x < band.len {
                    let column = (band.first + x as i64).rem_euclid(nx as i64) as usize;
                    let n = (band.len - x).min(nx - column);
                    let source = &beams.waves[run.start * plane + y * stride + column..];
                    let target = &mut out[(r * ny + y) * band.len + x..];
                    multiply(
                        (count, n, k),
                        (target, column_size),
                        (&coefficients, [k, 1]),
                        (source, plane),
                    );
                    x += n;
                }
            }
        }
    }

    /// Sums over ky for one raster column, `sum_ky exp(-2 pi i ky y) sums`, as (raster row, y within the band of rows,
    /// x), row-major.
    fn sum_over_ky(
        &self,
        sums: &[Complex32],
        scan: &Scan,
        width: usize,
        rows: &LineBand,
        out: &mut Vec<Complex32>,
    ) {
        let runs = self.runs();
        let ny = self.exit.points[1];
        let coefficients: Vec<Complex32> = rows
            .lines
            .clone()
            .flat_map(|row| {
                let u = scan.position(row * scan.shape[1])[1] / self.exit.extent_angstrom[1];
                runs.iter().map(move |run| (u, run.start))
            })
            .map(|(u, b)| single(turn(self.beams[b][1], u)))
            .collect();
        let area = rows.len * width;
        out.resize(rows.lines.len() * area, Complex32::ZERO);
        let mut y = 0;
        while y < rows.len {
            let line = (rows.first + y as i64).rem_euclid(ny as i64) as usize;
            let n = (rows.len - y).min(ny - line);
            multiply(
                (rows.lines.len(), n * width, runs.len()),
                (&mut out[y * width..], area),
                (&coefficients, [runs.len(), 1]),
                (&sums[line * width..], ny * width),
            );
            y += n;
        }
    }
}

/// `exp(-2 pi i f u)`
fn turn(f: i64, u: f64) -> Complex64 {
    Complex64::from_polar(1.0, -2.0 * PI * u * f as f64)
}
