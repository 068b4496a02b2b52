//! The waves of a window and its surroundings, in a box twice as wide or wider.
//!
//! A window of width W samples diffraction patterns at steps of 1 / W, and lacks the part of the probe that it cuts off. In a box of n times
//! the width the step is 1 / (n W), and there is room for the *coherent tail*: the part of the probe outside the window. The tail is
//! propagated through free space, multiplied by the mean transmission of the slices, and added to the wave of the window. Waves beyond the
//! tail's angle are left out of the sum: electrons scattered that far reach the window's edge inside the specimen, and come in again at the
//! other side.

use super::grid::Grid;
use super::plan::Plan;
use super::single_precision::single;
use crate::fft::{Buffer, Fft2, Scratch, good_size};
use crate::plane;
use num_complex::{Complex32, Complex64};
use std::f64::consts::PI;
use std::ops::Range;

/// Angle beyond which no waves are kept, in units of the angle up to which they are kept in full.
const LOW_PASS_ENDS: f64 = 1.15;
/// Least width of the box for patterns, in units of the wavelength over the semiangle (31 A at 200 kV and 21 mrad). A box of 15.6 A lacks 1 %
/// of the bright field of SrTiO3.
pub(super) const OF_PATTERNS: f64 = 25.9;
/// Largest width of the box in units of the window's.
const MOST_TIMES: usize = 10;

/// The box around a window, with the positions of its frequencies in arrays.
pub(super) struct PaddedBox {
    window: Grid,
    /// Width of the box in units of the window's.
    pub times: usize,
    /// Points of a grid over the window that is just fine enough for the kept frequencies; even.
    coarse: [usize; 2],
    coarse_fft: Fft2,
    coarse_columns: Vec<Range<usize>>,
    box_fft: Fft2,
    box_columns: Vec<Range<usize>>,
    /// Frequencies `-reach..=reach` (x, y) of the box are kept.
    pub reach: [usize; 2],
    /// For each kept frequency of the window: its element in the array of a wave and in a coarse array, and its weight.
    inside: Vec<(usize, usize, f32)>,
    /// The weights of the frequencies of the box, [`PaddedBox::samples`] row-major.
    low_pass: Vec<f32>,
}

/// One thread's arrays.
pub(super) struct PaddedWorkspace {
    coarse: Buffer,
    padded: Buffer,
    scratch: (Scratch, Scratch),
}

/// The share of the amplitude that is kept at a frequency k, if waves are kept in full up to `full_k`.
pub(super) fn low_pass(k: f64, full_k: f64) -> f64 {
    let end = LOW_PASS_ENDS * full_k;
    match k {
        k if k <= full_k => 1.0,
        k if k >= end => 0.0,
        k => 0.5 + 0.5 * (PI * (k - full_k) / (end - full_k)).cos(),
    }
}

/// The width of the box in units of the window's, from its least width in units of the wavelength over the semiangle. On the full grid the
/// box only makes the steps of frequencies finer.
fn times_the_window(plan: &Plan, least_width: f64) -> usize {
    if !plan.has_windows() {
        return 2;
    }
    let optics = &plan.settings.optics;
    let [x, y] = plan.wave_grid.extent_angstrom;
    let least = least_width * optics.wavelength_angstrom() / (1e-3 * optics.semiangle_mrad);
    ((least / x.min(y)).ceil() as usize).clamp(2, MOST_TIMES)
}

/// Width (x, y) in Angstrom of the box around the windows of a plan.
pub(super) fn box_extent_angstrom(plan: &Plan, least_width: f64) -> [f64; 2] {
    let times = times_the_window(plan, least_width) as f64;
    plan.wave_grid.extent_angstrom.map(|l| times * l)
}

impl PaddedBox {
    /// Makes the box around the windows of a plan. Waves are kept up to `full_k` (1/Angstrom), and the box's frequencies up to `most_k` along
    /// each axis. `least_width` is in units of the wavelength over the semiangle.
    /// `stride` is the row stride of waves on the window's grid.
    pub fn new(plan: &Plan, stride: usize, [full_k, most_k]: [f64; 2], least_width: f64) -> Self {
        let (window, times) = (plan.wave_grid, times_the_window(plan, least_width));
        let end = LOW_PASS_ENDS * full_k;
        let along = window.extent_angstrom;
        let highest = |k: usize| ((end * along[k]) as usize).min((window.points[k] - 1) / 2);
        let coarse = [0, 1].map(|k| good_size(2 * highest(k) + 2, 2));
        let reach = plane::per_axis(along, coarse, |l, n| {
            ((times as f64 * l * most_k.min(end)) as usize).min(times * n / 2 - 1)
        });
        let weight = |k2: f64| low_pass(k2.sqrt(), full_k);
        let coarse_fft = Fft2::new(coarse[1], coarse[0]);
        let box_fft = Fft2::new(times * coarse[1], times * coarse[0]);
        let pixels = (window.points[0] * window.points[1]) as f64;
        let mut inside = Vec::new();
        let [hx, hy] = [highest(0) as i64, highest(1) as i64];
        let bin = |f: i64, n: usize| f.rem_euclid(n as i64) as usize;
        for fy in -hy..=hy {
            for fx in -hx..=hx {
                let w = weight((fx as f64 / along[0]).powi(2) + (fy as f64 / along[1]).powi(2));
                if w > 0.0 {
                    let from = bin(fy, window.points[1]) * stride + bin(fx, window.points[0]);
                    let to = bin(fy, coarse[1]) * coarse_fft.stride() + bin(fx, coarse[0]);
                    inside.push((from, to, (w / pixels) as f32));
                }
            }
        }
        let mut padded = PaddedBox {
            window,
            times,
            coarse,
            coarse_columns: coarse_fft.band_columns(highest(0)),
            coarse_fft,
            box_columns: box_fft.band_columns(reach[0]),
            box_fft,
            reach,
            inside,
            low_pass: Vec::new(),
        };
        let weights = padded.frequencies().map(|[kx, ky]| weight(kx * kx + ky * ky) as f32);
        padded.low_pass = weights.collect();
        padded
    }

    /// Kept frequencies along x and y.
    pub fn samples(&self) -> [usize; 2] {
        self.reach.map(|reach| 2 * reach + 1)
    }

    /// Number of kept frequencies.
    pub fn len(&self) -> usize {
        let [x, y] = self.samples();
        x * y
    }

    /// Width (x, y) of the box in Angstrom.
    pub fn extent_angstrom(&self) -> [f64; 2] {
        self.window.extent_angstrom.map(|l| self.times as f64 * l)
    }

    /// Points (x, y) of the grid over the box on which its waves are stored.
    pub fn points(&self) -> [usize; 2] {
        self.coarse.map(|n| self.times * n)
    }

    /// The kept frequencies (kx, ky) in 1/Angstrom, row by row.
    pub fn frequencies(&self) -> impl Iterator<Item = [f64; 2]> + use<> {
        let (reach, extent) = (self.reach.map(|n| n as i64), self.extent_angstrom());
        (-reach[1]..=reach[1]).flat_map(move |y| {
            (-reach[0]..=reach[0]).map(move |x| [x as f64 / extent[0], y as f64 / extent[1]])
        })
    }

    pub fn workspace(&self) -> PaddedWorkspace {
        PaddedWorkspace {
            coarse: self.coarse_fft.buffer(),
            padded: self.box_fft.buffer(),
            scratch: (self.coarse_fft.scratch(), self.box_fft.scratch()),
        }
    }

    /// Writes the kept frequencies of a wave in the box to `out`, row by row; their squared moduli add to the fraction of the beam. `wave`
    /// holds Fourier coefficients of the window times its pixels. Where the window is a periodic cell, `centre` (Angstrom) is moved to the
    /// middle of the box.
    pub fn sample(
        &self,
        wave: &[Complex32],
        centre: Option<[f64; 2]>,
        w: &mut PaddedWorkspace,
        out: &mut [Complex32],
    ) {
        let PaddedWorkspace { coarse, padded, scratch } = w;
        coarse.fill(Complex32::ZERO);
        for &(from, to, weight) in &self.inside {
            coarse[to] = wave[from] * weight;
        }
        for columns in &self.coarse_columns {
            self.coarse_fft.some_columns(coarse, columns.clone(), true, &mut scratch.0);
        }
        self.coarse_fft.all_rows(coarse, true, &mut scratch.0);
        let [nx, ny] = self.coarse;
        let first = centre.map_or([0; 2], |centre| self.first_of(centre));
        let (from, to) = (self.coarse_fft.stride(), self.box_fft.stride());
        padded.fill(Complex32::ZERO);
        // Twice the widths of the window before it.
        let before = self.times - 1;
        for y in 0..ny {
            let row = &coarse[(y + first[1]) % ny * from..][..nx];
            let line = &mut padded[(y + before * ny / 2) * to + before * nx / 2..][..nx];
            let (left, right) = row.split_at(first[0]);
            line[..right.len()].copy_from_slice(right);
            line[right.len()..].copy_from_slice(left);
        }
        self.box_fft.all_rows(padded, false, &mut scratch.1);
        for columns in &self.box_columns {
            self.box_fft.some_columns(padded, columns.clone(), false, &mut scratch.1);
        }
        // A wave's amplitude per point falls with the width of the box.
        let scale = self.times as f32 / (self.times * self.times * nx * ny) as f32;
        self.keep(padded, to, self.points(), |v, _| v * scale, out);
    }

    /// The pixel (x, y) of the coarse grid at which a window around `centre` (Angstrom) begins.
    fn first_of(&self, centre: [f64; 2]) -> [usize; 2] {
        [0, 1].map(|k| {
            let n = self.coarse[k];
            let pixel = self.window.extent_angstrom[k] / n as f64;
            ((centre[k] / pixel).round() as i64 - n as i64 / 2).rem_euclid(n as i64) as usize
        })
    }

    /// Writes the kept frequencies of an array of the box in FFT order, of `points` (x, y), to `out`.
    fn keep(
        &self,
        array: &[Complex32],
        stride: usize,
        points: [usize; 2],
        value: impl Fn(Complex32, usize) -> Complex32,
        out: &mut [Complex32],
    ) {
        let reach = self.reach.map(|n| n as i64);
        let bin = |f: i64, n: usize| f.rem_euclid(n as i64) as usize;
        let mut at = 0;
        for fy in -reach[1]..=reach[1] {
            let row = &array[bin(fy, points[1]) * stride..];
            for fx in -reach[0]..=reach[0] {
                out[at] = value(row[bin(fx, points[0])], at);
                at += 1;
            }
        }
    }
}

/// Splits probes in the box into the part inside the window and the part outside.
pub(super) struct ProbeSplit {
    /// Points (x, y) of the box before the window.
    pub lead: [usize; 2],
    /// The box on the window's pixels.
    pub grid: Grid,
    fft: Fft2,
    window_fft: Fft2,
    /// Bins (row, column) of the box and of the window that contain probes.
    bins: Vec<(usize, usize)>,
    window_bins: Vec<(usize, usize)>,
    /// Distance (x, y) in Angstrom by which the window lies further from the box's first point on the grid of [`PaddedBox`].
    shift: [f64; 2],
}

/// One thread's arrays.
pub(super) struct SplitWorkspace {
    around: Buffer,
    inside: Buffer,
    scratch: (Scratch, Scratch),
}

impl ProbeSplit {
    /// The box on the window's pixels.
    pub fn grid_around(padded: &PaddedBox) -> Grid {
        Grid {
            points: padded.window.points.map(|n| padded.times * n),
            extent_angstrom: padded.extent_angstrom(),
        }
    }

    pub fn new(
        padded: &PaddedBox,
        bins: Vec<(usize, usize)>,
        window_bins: Vec<(usize, usize)>,
    ) -> Self {
        let window = padded.window;
        let grid = Self::grid_around(padded);
        // The middle of the box is the middle of the window, as probes count it.
        let lead = window.points.map(|n| padded.times * n / 2 - n / 2);
        let pixel = window.sampling_angstrom();
        let before = 0.5 * (padded.times - 1) as f64;
        let shift = plane::sub(
            window.extent_angstrom.map(|l| before * l),
            plane::mul(lead.map(|n| n as f64), pixel),
        );
        ProbeSplit {
            lead,
            grid,
            fft: Fft2::new(grid.points[1], grid.points[0]),
            window_fft: Fft2::new(window.points[1], window.points[0]),
            bins,
            window_bins,
            shift,
        }
    }

    pub fn workspace(&self) -> SplitWorkspace {
        SplitWorkspace {
            around: self.fft.buffer(),
            inside: self.window_fft.buffer(),
            scratch: (self.fft.scratch(), self.window_fft.scratch()),
        }
    }

    /// The coefficients of a wave on the window's bins, and the kept frequencies in the box of the part outside. `wave` holds the
    /// coefficients on the box's bins.
    pub fn split(
        &self,
        padded: &PaddedBox,
        wave: &[Complex32],
        w: &mut SplitWorkspace,
    ) -> (Vec<Complex32>, Vec<Complex32>) {
        let SplitWorkspace { around, inside, scratch } = w;
        let ([nx, ny], [lx, ly]) = (padded.window.points, self.lead);
        let (stride, narrow) = (self.fft.stride(), self.window_fft.stride());
        around.fill(Complex32::ZERO);
        for (&(y, x), value) in self.bins.iter().zip(wave) {
            around[y * stride + x] = *value;
        }
        self.fft.inverse(around, &mut scratch.0);
        inside.fill(Complex32::ZERO);
        // Coefficients of norm 1 in the box are smaller by its width in the window.
        let times = padded.times as f32;
        for y in 0..ny {
            let row = &around[(y + ly) * stride + lx..][..nx];
            inside[y * narrow..][..nx]
                .iter_mut()
                .zip(row)
                .for_each(|(to, v)| *to = v * (1.0 / times));
        }
        self.window_fft.forward(inside, &mut scratch.1);
        let pixels = 1.0 / (nx * ny) as f32;
        let bins = self.window_bins.iter();
        let held: Vec<Complex32> = bins.map(|&(y, x)| inside[y * narrow + x] * pixels).collect();
        inside.fill(Complex32::ZERO);
        for (&(y, x), value) in self.window_bins.iter().zip(&held) {
            inside[y * narrow + x] = *value;
        }
        self.window_fft.inverse(inside, &mut scratch.1);
        for y in 0..ny {
            let row = &mut around[(y + ly) * stride + lx..][..nx];
            row.iter_mut().zip(&inside[y * narrow..][..nx]).for_each(|(to, v)| *to -= v * times);
        }
        self.fft.forward(around, &mut scratch.0);
        let scale = pixels / (times * times);
        let shift = padded.phases(self.shift, 0.0);
        let columns = padded.samples()[0];
        let value = |v: Complex32, at: usize| {
            v * shift[0][at % columns] * shift[1][at / columns] * (padded.low_pass[at] * scale)
        };
        let mut outside = vec![Complex32::ZERO; padded.len()];
        padded.keep(around, stride, self.grid.points, value, &mut outside);
        (held, outside)
    }
}

impl PaddedBox {
    /// The phases `exp(-i pi a k^2 - 2 pi i k d)` at the kept frequencies along x and y: a is wavelength times distance in Angstrom^2, d
    /// the displacement `way` along x and y in Angstrom.
    pub fn phases(&self, way: [f64; 2], fresnel_angstrom2: f64) -> [Vec<Complex32>; 2] {
        let extent = self.extent_angstrom();
        [0, 1].map(|axis| {
            let reach = self.reach[axis] as i64;
            let phase = |f: i64| {
                let k = f as f64 / extent[axis];
                single(Complex64::from_polar(
                    1.0,
                    -PI * fresnel_angstrom2 * k * k - 2.0 * PI * way[axis] * k,
                ))
            };
            (-reach..=reach).map(phase).collect()
        })
    }

    /// Adds `outside` to the samples of a wave, multiplied by `factor` and by the phases along x and y.
    pub fn add_tail(
        &self,
        samples: &mut [Complex32],
        outside: &[Complex32],
        factor: Complex32,
        [across, down]: &[Vec<Complex32>; 2],
    ) {
        let columns = across.len();
        let rows = samples.chunks_exact_mut(columns).zip(outside.chunks_exact(columns));
        for ((row, tail), phase) in rows.zip(down) {
            let by = factor * phase;
            for ((to, v), x) in row.iter_mut().zip(tail).zip(across) {
                *to += v * x * by;
            }
        }
    }
}
