//! The probe at the entrance surface: on the grid of the cell, or made in a large box and cropped to a window.

use super::grid::Grid;
use super::plan::Plan;
use super::probe_patches::{largest_half, window_centre};
use super::single_precision::single;
use crate::fft::{Buffer, Fft2, Scratch, frequency};
use crate::matrix::multiply;
use crate::plane;
use num_complex::{Complex32, Complex64};
use std::f64::consts::PI;

/// The probe as Fourier coefficients on the wave grid, for any position.
pub(super) struct Probe {
    /// Bins (row, column) of the wave grid that contain the probe, sorted by row.
    pub bins: Vec<(usize, usize)>,
    form: ProbeForm,
}

enum ProbeForm {
    /// Made in the cell, or cropped to it once, and moved periodically: amplitudes of the probe at the origin.
    Moved(Vec<Complex64>),
    /// Cropped to a window: the part outside depends on where the probe stands.
    CroppedProbe(CroppedProbe),
}

impl Probe {
    /// The probe on the plan's wave grid, with the norm that the settings ask for. Its squared coefficients sum to the
    /// fraction of the beam inside the grid: a cropped probe is not renormalised, since the part outside never meets the
    /// atoms in the window.
    pub fn new(plan: &Plan) -> Self {
        let grid = plan.wave_grid;
        if !plan.has_windows() && !plan.settings.large_probe_box() {
            let (bins, amplitudes) = aperture(plan, &grid).into_iter().unzip();
            return Probe { bins, form: ProbeForm::Moved(amplitudes) };
        }
        let bins = low_bins(plan, &grid);
        if !plan.has_windows() {
            let amplitudes = in_box(plan, &grid, [0; 2], &bins);
            return Probe { bins, form: ProbeForm::Moved(amplitudes) };
        }
        let cropped = CroppedProbe::new(plan, &bins);
        Probe { bins, form: ProbeForm::CroppedProbe(cropped) }
    }

    /// Coefficients, bin by bin, of the probe at `position` (Angstrom, from the first pixel of the wave).
    pub fn at(&self, plan: &Plan, position: [f64; 2]) -> Vec<Complex32> {
        match &self.form {
            ProbeForm::Moved(amplitudes) => {
                let grid = &plan.wave_grid;
                let shift = |k: usize| position[k] / grid.extent_angstrom[k];
                let phases = [0, 1].map(|k| shift_phases(shift(k), grid.points[k]));
                let at = |(&(iy, ix), a): (&(usize, usize), &Complex64)| {
                    single(a * phases[0][ix] * phases[1][iy])
                };
                self.bins.iter().zip(amplitudes).map(at).collect()
            }
            ProbeForm::CroppedProbe(cropped) => {
                cropped.at(position).into_iter().map(single).collect()
            }
        }
    }

    /// The probe cropped to a window; `None` without windows.
    pub fn cropped(&self) -> Option<&CroppedProbe> {
        match &self.form {
            ProbeForm::CroppedProbe(cropped) => Some(cropped),
            ProbeForm::Moved(_) => None,
        }
    }
}

/// A probe that is cropped to a window in two steps: once from the large box to surroundings that contain the window for every position of
/// the probe in it, and from these, which have few coefficients, to the window for each position.
pub(super) struct CroppedProbe {
    /// The middle of the window in Angstrom.
    centre: [f64; 2],
    /// The probe in the middle of the surroundings: bins (row, column) in the rectangle of their low frequencies, and
    /// coefficients.
    pub around: Vec<((usize, usize), Complex64)>,
    /// Frequencies of that rectangle's columns and rows in 1/Angstrom.
    k: [Vec<f64>; 2],
    /// Matrices that crop along x and y: (column of the surroundings, column of the window), and (row of the window, row of
    /// the surroundings).
    crop: [Vec<Complex64>; 2],
    /// The window's bins in the rectangle of its low frequencies.
    inside: Vec<(usize, usize)>,
    /// Rows and columns of that rectangle.
    low: (usize, usize),
}

/// Width in Angstrom of the surroundings beyond the window at every position of the probe. It keeps the edges of the surroundings from
/// having an effect.
const BEYOND_ANGSTROM: f64 = 1.0;

impl CroppedProbe {
    /// Crops the probe for the bins (row, column) of the plan's wave grid.
    pub(super) fn new(plan: &Plan, bins: &[(usize, usize)]) -> Self {
        let window = plan.wave_grid;
        let pixel = window.sampling_angstrom();
        let half = largest_half(plan);
        let beyond =
            plane::div(half.map(|l| l + BEYOND_ANGSTROM), pixel).map(|n| n.ceil() as usize);
        let points = plane::add(window.points, beyond.map(|n| 2 * n));
        let grid = Grid { points, extent_angstrom: plane::mul(points.map(|n| n as f64), pixel) };
        let around = low_bins(plan, &grid);
        let amplitudes = in_box(plan, &grid, beyond, &around);
        // The frequencies are counted from the most negative low one.
        let reach = |bins: &[(usize, usize)], grid: &Grid| {
            [0, 1].map(|k| {
                let of =
                    |b: &(usize, usize)| frequency([b.1, b.0][k], grid.points[k]).unsigned_abs();
                bins.iter().map(of).max().unwrap_or(0) as i64
            })
        };
        let (wide, low) = (reach(&around, &grid), reach(bins, &window));
        let place = |b: &(usize, usize), grid: &Grid, reach: [i64; 2]| {
            let at = |i: usize, k: usize| (frequency(i, grid.points[k]) + reach[k]) as usize;
            (at(b.0, 1), at(b.1, 0))
        };
        let k = plane::per_axis(wide, grid.extent_angstrom, |most, length| {
            (-most..=most).map(|f| f as f64 / length).collect::<Vec<_>>()
        });
        let matrix = |axis: usize| {
            let (n, scale) = (window.points[axis], (points[axis] * window.points[axis]) as f64);
            let kernel = |from: f64, to: i64| {
                let to = to as f64 / window.extent_angstrom[axis];
                crop_kernel(from, to, n, n / 2, pixel[axis]) / scale.sqrt()
            };
            let (from, to) = (&k[axis], -low[axis]..=low[axis]);
            match axis {
                0 => from.iter().flat_map(|f| to.clone().map(move |t| kernel(*f, t))).collect(),
                _ => to.flat_map(|t| from.iter().map(move |f| kernel(*f, t))).collect(),
            }
        };
        CroppedProbe {
            centre: window_centre(plan),
            around: around.iter().map(|b| place(b, &grid, wide)).zip(amplitudes).collect(),
            crop: [0, 1].map(matrix),
            inside: bins.iter().map(|b| place(b, &window, low)).collect(),
            low: ((2 * low[1] + 1) as usize, (2 * low[0] + 1) as usize),
            k,
        }
    }

    /// Phases of the surroundings' columns and rows that move the probe by `offset` (Angstrom) from the middle of the window.
    pub fn phases(&self, offset: [f64; 2]) -> [Vec<Complex64>; 2] {
        plane::per_axis(self.k.each_ref(), offset, |k, offset| {
            k.iter().map(|k| Complex64::from_polar(1.0, -2.0 * PI * k * offset)).collect()
        })
    }

    /// The distance (x, y) in Angstrom of a position in the window from its middle.
    pub fn offset(&self, position: [f64; 2]) -> [f64; 2] {
        plane::sub(position, self.centre)
    }

    /// The window's coefficients, bin by bin, of the probe at `position` (Angstrom, from the first pixel of the window).
    pub(super) fn at(&self, position: [f64; 2]) -> Vec<Complex64> {
        let [x, y] = self.phases(self.offset(position));
        self.moved(&x, &y)
    }

    /// The window's coefficients, bin by bin, of the probe with these phases of the surroundings' columns and rows.
    pub fn moved(&self, x: &[Complex64], y: &[Complex64]) -> Vec<Complex64> {
        self.cut_window(self.around.iter().map(|((row, column), a)| a * x[*column] * y[*row]))
    }

    /// Computes the window's coefficients, bin by bin, from the coefficients of the surroundings.
    pub fn cut_window(&self, around: impl Iterator<Item = Complex64>) -> Vec<Complex64> {
        let [columns, rows] = [self.k[0].len(), self.k[1].len()];
        let (low_rows, low_columns) = self.low;
        let mut rectangle = vec![Complex64::ZERO; rows * columns];
        for (((y, x), _), value) in self.around.iter().zip(around) {
            rectangle[y * columns + x] = value;
        }
        let shape = [low_rows, rows, columns, low_columns];
        let low = on_both_sides(shape, &self.crop[1], &rectangle, &self.crop[0]);
        self.inside.iter().map(|(y, x)| low[y * low_columns + x]).collect()
    }

    /// The adjoint of [`CroppedProbe::cut_window`]: `sum conj(window) cut_window(a) = sum conj(pad_window(window)) a`.
    pub fn pad_window(&self, window: &[Complex64]) -> Vec<Complex64> {
        let [columns, rows] = [self.k[0].len(), self.k[1].len()];
        let (low_rows, low_columns) = self.low;
        let mut low = vec![Complex64::ZERO; low_rows * low_columns];
        for ((y, x), value) in self.inside.iter().zip(window) {
            low[y * low_columns + x] = value.conj();
        }
        // Products of conjugates, conjugated at the end.
        let mut half = vec![Complex64::ZERO; rows * low_columns];
        let by_rows = (rows, low_columns, low_rows);
        multiply(
            by_rows,
            (&mut half, low_columns),
            (&self.crop[1], [1, rows]),
            (&low, low_columns),
        );
        let mut out = vec![Complex64::ZERO; columns * rows];
        let by_columns = (columns, rows, low_columns);
        let mut turned = vec![Complex64::ZERO; low_columns * rows];
        for (y, line) in half.chunks_exact(low_columns).enumerate() {
            line.iter().enumerate().for_each(|(x, v)| turned[x * rows + y] = *v);
        }
        multiply(by_columns, (&mut out, rows), (&self.crop[0], [low_columns, 1]), (&turned, rows));
        self.around.iter().map(|((y, x), _)| out[x * rows + y].conj()).collect()
    }
}

/// The product `left middle right` of row-major matrices of `a x b`, `b x c` and `c x d` elements.
fn on_both_sides(
    [a, b, c, d]: [usize; 4],
    left: &[Complex64],
    middle: &[Complex64],
    right: &[Complex64],
) -> Vec<Complex64> {
    let mut half = vec![Complex64::ZERO; b * d];
    multiply((b, d, c), (&mut half, d), (middle, [c, 1]), (right, d));
    let mut out = vec![Complex64::ZERO; a * d];
    multiply((a, d, b), (&mut out, d), (left, [b, 1]), (&half, d));
    out
}

/// `sum exp(2 pi i x (from - to))` over the first `n` pixels, x being their distance from pixel `centre`, times the phase of `to` in
/// transforms that begin at pixel 0.
fn crop_kernel(from: f64, to: f64, n: usize, centre: usize, pixel: f64) -> Complex64 {
    let turn = PI * (from - to) * pixel;
    let sum = match turn.sin() {
        sin if sin.abs() < 1e-12 => n as f64,
        sin => (n as f64 * turn).sin() / sin,
    };
    // The sum has the phase of the middle of the pixels.
    let middle = 0.5 * (n as f64 - 1.0) - centre as f64;
    let phase = 2.0 * turn * middle - 2.0 * PI * to * centre as f64 * pixel;
    Complex64::from_polar(sum, phase)
}

/// Coefficients at `bins` on `grid` of the probe in the grid's middle, relative to this middle, cropped from the large box. The middle
/// is the middle of a window with `beyond` pixels before and after it.
fn in_box(plan: &Plan, grid: &Grid, beyond: [usize; 2], bins: &[(usize, usize)]) -> Vec<Complex64> {
    let large = probe_grid(plan);
    let lens = aperture(plan, &large);
    let pixel = grid.sampling_angstrom();
    let scale = plane::mul(grid.points, large.points).map(|n| (n as f64).sqrt());
    let middle = plane::per_axis(grid.points, beyond, |n, beyond| beyond + (n - 2 * beyond) / 2);
    let wanted = [0, 1].map(|k| distinct(bins.iter().map(|b| [b.1, b.0][k])));
    let held = [0, 1].map(|k| distinct(lens.iter().map(|((y, x), _)| [*x, *y][k])));
    let kernel = |axis: usize, from: usize, to: usize| {
        let from = frequency(from, large.points[axis]) as f64 / large.extent_angstrom[axis];
        let to = frequency(to, grid.points[axis]) as f64 / grid.extent_angstrom[axis];
        let value = crop_kernel(from, to, grid.points[axis], middle[axis], pixel[axis]);
        let back = 2.0 * PI * to * middle[axis] as f64 * pixel[axis];
        value * Complex64::from_polar(1.0 / scale[axis], back)
    };
    let [nx, ny] = [wanted[0].len(), wanted[1].len()];
    let [mx, my] = [held[0].len(), held[1].len()];
    let across: Vec<Complex64> =
        held[0].iter().flat_map(|f| wanted[0].iter().map(|t| kernel(0, *f, *t))).collect();
    let down: Vec<Complex64> =
        wanted[1].iter().flat_map(|t| held[1].iter().map(|f| kernel(1, *f, *t))).collect();
    let mut rectangle = vec![Complex64::ZERO; mx * my];
    let find = |all: &[usize], i: usize| all.partition_point(|v| *v < i);
    for ((y, x), a) in &lens {
        rectangle[find(&held[1], *y) * mx + find(&held[0], *x)] = *a;
    }
    let out = on_both_sides([ny, my, mx, nx], &down, &rectangle, &across);
    bins.iter().map(|(y, x)| out[find(&wanted[1], *y) * nx + find(&wanted[0], *x)]).collect()
}

/// The distinct values in ascending order.
fn distinct(values: impl Iterator<Item = usize>) -> Vec<usize> {
    let mut all: Vec<usize> = values.collect();
    all.sort_unstable();
    all.dedup();
    all
}

/// The bins (row, column) of low frequency that cropped probes are limited to, sorted by row.
pub(super) fn low_bins(plan: &Plan, grid: &Grid) -> Vec<(usize, usize)> {
    let keep = highest_k(plan);
    let (ny, nx) = grid.shape();
    let low = |&(iy, ix): &(usize, usize)| {
        let [kx, ky] = grid.k(iy, ix);
        kx.hypot(ky) < keep
    };
    let rows = (0..ny).filter(|iy| grid.k(*iy, 0)[1].abs() < keep);
    rows.flat_map(|iy| (0..nx).map(move |ix| (iy, ix))).filter(low).collect()
}

/// The highest frequency of cropped probes in 1/Angstrom.
pub(super) fn highest_k(plan: &Plan) -> f64 {
    let optics = &plan.settings.optics;
    let angle = (optics.semiangle_mrad * 2.0).max(optics.semiangle_mrad + 20.0);
    (angle * 1e-3 / optics.wavelength_angstrom()).min(plan.band_limit)
}

/// The bins (row, column) within an aperture, with their amplitudes.
pub(super) type Lens = Vec<((usize, usize), Complex64)>;

/// The probe at the origin and the entrance surface on `grid`, normalised by the settings.
pub(super) fn aperture(plan: &Plan, grid: &Grid) -> Lens {
    let optics = &plan.settings.optics;
    let (ny, nx) = grid.shape();
    let mut lens = Vec::new();
    let [dx, dy] = grid.dk();
    let reach = 1e-3 * optics.semiangle_mrad / optics.wavelength_angstrom() + 2.0 * (dx + dy);
    let columns: Vec<usize> = (0..nx).filter(|ix| grid.k(0, *ix)[0].abs() <= reach).collect();
    for iy in (0..ny).filter(|iy| grid.k(*iy, 0)[1].abs() <= reach) {
        for &ix in &columns {
            let amplitude = optics.transfer(grid.k(iy, ix), grid.dk());
            if amplitude != Complex64::ZERO {
                lens.push(((iy, ix), amplitude));
            }
        }
    }
    // The edge of the aperture is soft: its amplitudes add to the aperture's area, their squares to less.
    let large = plan.settings.large_probe_box();
    let share = |a: Complex64| if large { a.norm() } else { a.norm_sqr() };
    let norm = lens.iter().map(|e| share(e.1)).sum::<f64>().sqrt();
    lens.iter_mut().for_each(|e| e.1 /= norm);
    lens
}

/// Width in Angstrom of the large box of [`super::settings::ProbeBox`].
const PROBE_BOX_ANGSTROM: f64 = 75.0;

/// The grid on which probes are made.
fn probe_grid(plan: &Plan) -> Grid {
    repeated(plan, &plan.transmission_grid)
}

/// `cell`, repeated along each axis to the width of the box in which probes are made.
pub(super) fn repeated(plan: &Plan, cell: &Grid) -> Grid {
    if !plan.settings.large_probe_box() {
        return *cell;
    }
    let times = cell.extent_angstrom.map(|l| {
        // Numbers of cells that keep transforms fast.
        let cells = [1usize, 2, 3, 4, 5, 6, 8, 10, 12, 15, 16, 20];
        cells.into_iter().find(|n| *n as f64 * l >= PROBE_BOX_ANGSTROM).unwrap_or(20)
    });
    Grid {
        points: plane::mul(cell.points, times),
        extent_angstrom: plane::mul(cell.extent_angstrom, times.map(|n| n as f64)),
    }
}

/// The probe in real space at `position` (Angstrom) on `grid`, the box in which it is made, from its [`aperture`]. The result is an array of
/// `fft`, the transform of this grid.
pub(super) fn probe_in_box(
    lens: &Lens,
    grid: &Grid,
    position: [f64; 2],
    fft: &Fft2,
    scratch: &mut Scratch,
) -> Buffer {
    let phases =
        plane::per_axis(plane::div(position, grid.extent_angstrom), grid.points, shift_phases);
    let mut wave = fft.buffer();
    for &((iy, ix), a) in lens {
        wave[iy * fft.stride() + ix] = single(a * phases[0][ix] * phases[1][iy]);
    }
    let highest = lens.iter().map(|((iy, _), _)| frequency(*iy, grid.points[1]).unsigned_abs());
    fft.inverse_of_low_rows(&mut wave, highest.max().unwrap_or(0) as usize, scratch);
    wave
}

/// `exp(-2 pi i f u)` for all FFT frequencies f of n bins.
fn shift_phases(u: f64, n: usize) -> Vec<Complex64> {
    (0..n).map(|i| Complex64::from_polar(1.0, -2.0 * PI * u * frequency(i, n) as f64)).collect()
}

#[cfg(test)]
mod tests {
    use super::super::{Algorithm, Settings};
    use super::*;
    use crate::optics::Aberrations;

    /// Compares with the probe in real space, cut and transformed: the error is 0.0007 of its amplitude.
    #[test]
    fn windows_cut_probes_where_they_stand() {
        let mut settings = Settings {
            algorithm: Algorithm::Window { width_angstrom: 6.3 },
            ..Settings::default()
        };
        settings.optics.aberrations = Aberrations::defocus(25.0);
        let plan = Plan::new(&settings, [33.0, 27.0, 2.0], &[1.0]).unwrap();
        let (window, large) = (plan.wave_grid, probe_grid(&plan));
        let fft = Fft2::new(large.points[1], large.points[0]);
        let small = Fft2::new(window.points[1], window.points[0]);
        let (nx, ny) = (window.points[0], window.points[1]);
        let pixels = (nx * ny * large.points[0] * large.points[1]) as f32;
        let probe = Probe::new(&plan);
        let centre = window_centre(&plan);
        for offset in [[0.0, 0.0], [1.31, -0.4], [-1.5, 1.52]] {
            let position = [centre[0] + offset[0], centre[1] + offset[1]];
            let lens = aperture(&plan, &large);
            let wave = probe_in_box(&lens, &large, position, &fft, &mut fft.scratch());
            let mut cut = small.buffer();
            for y in 0..ny {
                cut[y * small.stride()..][..nx].copy_from_slice(&wave[y * fft.stride()..][..nx]);
            }
            small.forward(&mut cut, &mut small.scratch());
            let ours = probe.at(&plan, position);
            let (mut off, mut norm) = (0.0, 0.0);
            for (&(iy, ix), value) in probe.bins.iter().zip(ours) {
                let expected = cut[iy * small.stride() + ix] / pixels.sqrt();
                off += (value - expected).norm_sqr();
                norm += expected.norm_sqr();
            }
            assert!(norm > 0.9 && norm < 1.0, "{norm}");
            assert!((off / norm).sqrt() < 2e-3, "{offset:?}: {}", (off / norm).sqrt());
        }
    }

    #[test]
    fn pad_window_is_the_adjoint_of_cut_window() {
        let algorithm = Algorithm::Window { width_angstrom: 5.9 };
        let plan =
            Plan::new(&Settings { algorithm, ..Settings::default() }, [31.0, 29.0, 2.0], &[1.0]);
        let probe = Probe::new(&plan.unwrap());
        let cropped = probe.cropped().unwrap();
        let some = |n: usize, step: f64| -> Vec<Complex64> {
            (0..n)
                .map(|i| Complex64::new((step * i as f64).sin(), (1.7 * step * i as f64).cos()))
                .collect()
        };
        let (around, window) = (some(cropped.around.len(), 0.3), some(probe.bins.len(), 0.7));
        let dot = |a: &[Complex64], b: &[Complex64]| -> Complex64 {
            a.iter().zip(b).map(|(a, b)| a.conj() * b).sum()
        };
        let one = dot(&window, &cropped.cut_window(around.iter().copied()));
        let other = dot(&cropped.pad_window(&window), &around);
        assert!((one - other).norm() < 1e-9 * one.norm().max(1.0), "{one} {other}");
    }
}
