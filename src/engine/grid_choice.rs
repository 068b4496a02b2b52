//! Chooses the grids and the band limit of a simulation.

use super::grid::Grid;
use super::settings::{BeyondLimit, GridChoice, POTENTIAL_SAMPLING_ANGSTROM, Settings};
use crate::detect::Detector;
use crate::error::{Error, Result};
use crate::fft::good_size;
use crate::plane;

/// Band limit of windows in units of their Nyquist frequency. This high fraction is safe in windows, since transmission functions are
/// band-limited on the fine grid beforehand.
const WINDOW_BAND_FRACTION: f64 = 0.98;
/// Windows may be narrower than requested by this factor if this allows a faster transform.
const WINDOW_WIDTH_TOLERANCE: f64 = 0.985;
/// Most points of a grid along an axis.
const MOST_POINTS: usize = 1 << 16;
/// Error messages recommend samplings that carry the outermost detector angle times this factor.
const BAND_MARGIN: f64 = 1.0005;

/// The angle in mrad that automatic grids carry.
pub(super) fn carried_mrad(settings: &Settings) -> f64 {
    let outermost = settings.detectors.iter().map(|d| d.outer_mrad).fold(0.0, f64::max);
    outermost.max(settings.optics.semiangle_mrad) * settings.angle_margin.max(BAND_MARGIN)
}

/// The grid of the cell that the settings ask for, `extent` (x, y) Angstrom wide; its points are multiples of `multiple`.
///
/// # Errors
/// Points or a sampling out of range.
pub(super) fn cell_grid(
    settings: &Settings,
    extent: [f64; 2],
    multiple: [usize; 2],
) -> Result<Grid> {
    let points = match settings.grid {
        GridChoice::Points(points) => checked_points(points, multiple)?,
        GridChoice::Sampling(sampling) => sampled_points(sampling, extent, multiple)?,
        GridChoice::Auto => sampled_points(auto_sampling(settings), extent, multiple)?,
    };
    check_count(points)?;
    Ok(Grid { points, extent_angstrom: extent })
}

/// Refuses grids that are too large for any machine.
fn check_count(points: [usize; 2]) -> Result<()> {
    if points.iter().any(|&n| n > MOST_POINTS) {
        let value = format!("{},{}", points[0], points[1]);
        let expected = format!("at most {MOST_POINTS}; simulate a smaller cell");
        return Err(Error::invalid(crate::Setting::Gpts, value, expected));
    }
    Ok(())
}

fn checked_points(points: [usize; 2], multiple: [usize; 2]) -> Result<[usize; 2]> {
    for i in 0..2 {
        if points[i] < 8 || !points[i].is_multiple_of(multiple[i]) {
            let value = format!("{},{}", points[0], points[1]);
            let expected = "needs at least 8 points along each axis, in multiples of the \
                            interpolation factor";
            return Err(Error::invalid(crate::Setting::Gpts, value, expected));
        }
    }
    Ok(points)
}

/// The coarsest sampling in Angstrom that carries [`carried_mrad`].
fn auto_sampling(settings: &Settings) -> f64 {
    let angle = carried_mrad(settings) * 1e-3;
    let wavelength = settings.optics.wavelength_angstrom();
    (settings.band_fraction - settings.band_taper) * wavelength / (2.0 * angle)
}

/// Points for pixels of at most `sampling` Angstrom.
fn sampled_points(sampling: f64, extent: [f64; 2], multiple: [usize; 2]) -> Result<[usize; 2]> {
    if !(1e-4..10.0).contains(&sampling) {
        let expected = "must be between 0.0001 and 10";
        return Err(Error::invalid(crate::Setting::SamplingAngstrom, sampling, expected));
    }
    let least = extent.map(|l| (l / sampling - 1e-3).ceil() as usize);
    // The check comes before the search for a good size: good sizes are rare among large numbers.
    check_count(least)?;
    Ok(plane::per_axis(least, multiple, good_size))
}

/// A grid `factor` times finer along each axis. By default the factor brings its pixels down to [`POTENTIAL_SAMPLING_ANGSTROM`].
pub(super) fn oversampled(grid: &Grid, factor: Option<usize>) -> Grid {
    let [x, y] = grid.sampling_angstrom();
    let finer = (x.max(y) / POTENTIAL_SAMPLING_ANGSTROM - 1e-3).ceil().max(1.0) as usize;
    Grid { points: grid.points.map(|n| n * factor.unwrap_or(finer)), ..*grid }
}

/// The grid for smoothed potentials and the cutoff of the smoothing in 1/Angstrom. Frequencies that alias into the band
/// limit then lie at 5.5 cutoffs or more, where the exponential of a smoothed Pt atom has fallen below 2e-4 of its
/// scattering (measured, 200 kV).
pub(super) fn smoothed_grid(extent: [f64; 2], band_limit: f64) -> (Grid, f64) {
    const CUTOFFS: f64 = 5.5;
    const LEAST_CUTOFF: f64 = 2.5;
    const MOST_CUTOFF: f64 = 4.0;
    let nyquist = (0.5 * (CUTOFFS * LEAST_CUTOFF + band_limit)).max(1.02 * band_limit);
    let points = extent.map(|l| good_size((2.0 * nyquist * l).ceil() as usize, 1));
    let grid = Grid { points, extent_angstrom: extent };
    (grid, ((2.0 * grid.nyquist() - band_limit) / CUTOFFS).min(MOST_CUTOFF))
}

/// The radius of the band limit on `grid` in 1/Angstrom, and warnings about detectors that reach beyond it.
///
/// # Errors
/// [`crate::Error::DetectorBeyondBandLimit`], unless the settings ask only for a warning and part of the annulus is carried.
pub(super) fn band_limit(settings: &Settings, grid: &Grid) -> Result<(f64, Vec<String>)> {
    let wavelength = settings.optics.wavelength_angstrom();
    let limit = settings.band_fraction * grid.nyquist();
    let limit_mrad = (limit - settings.band_taper * grid.nyquist()) * wavelength * 1e3;
    let [x, y] = grid.sampling_angstrom();
    let sampling = x.max(y);
    let mut warnings = Vec::new();
    for d in settings.detectors.iter().filter(|d| d.outer_mrad > limit_mrad) {
        let needed_angstrom = sampling * limit_mrad / (d.outer_mrad * BAND_MARGIN);
        if settings.beyond_limit == BeyondLimit::Error || d.inner_mrad >= limit_mrad {
            return Err(Error::DetectorBeyondBandLimit {
                name: d.name.clone(),
                outer_mrad: d.outer_mrad,
                limit_mrad,
                sampling_angstrom: sampling,
                needed_angstrom,
            });
        }
        warnings.push(empty_annulus(d, limit_mrad, needed_angstrom));
    }
    Ok((limit, warnings))
}

/// Warns that a detector is empty beyond `limit_mrad`, and names the sampling (Angstrom) that would fill it.
fn empty_annulus(d: &Detector, limit_mrad: f64, needed_angstrom: f64) -> String {
    let area = |r: f64| r * r;
    let empty = (area(d.outer_mrad) - area(limit_mrad)) / (area(d.outer_mrad) - area(d.inner_mrad));
    format!(
        "detector `{}` ({}-{} mrad): the grid carries scattering only to {limit_mrad:.1} mrad, \
         so {:.0} % of the annulus is empty; a sampling of {needed_angstrom:.4} A would fill it",
        d.name,
        d.inner_mrad,
        d.outer_mrad,
        100.0 * empty
    )
}

/// Whether `n` has no prime factor above 5.
fn smooth(mut n: usize) -> bool {
    for p in [2, 3, 5] {
        while n.is_multiple_of(p) {
            n /= p;
        }
    }
    n == 1
}

/// The coarse grid of the whole cell, and the window with equal pixels. The window is transformed for every probe and the cell once for
/// each slice, so the window gets a fast length and the cell any product of 2, 3 and 5.
pub(super) fn window_grids(extent: [f64; 2], band_limit: f64, width: f64) -> (Grid, Grid) {
    let coarsest = WINDOW_BAND_FRACTION / (2.0 * band_limit);
    let mut cell = Grid { points: [0; 2], extent_angstrom: extent };
    let mut window = cell;
    for i in 0..2 {
        let least = (extent[i] / coarsest).ceil() as usize;
        let window_points = |n: usize| {
            let wanted = width * WINDOW_WIDTH_TOLERANCE * n as f64 / extent[i];
            good_size(wanted.ceil() as usize, 1).min(n)
        };
        let candidates = (least..=least + least / 8 + 8).filter(|&n| smooth(n));
        let n = candidates.min_by_key(|&n| (window_points(n), n)).unwrap_or(least);
        cell.points[i] = n;
        window.points[i] = window_points(n);
        window.extent_angstrom[i] = extent[i] * window.points[i] as f64 / n as f64;
    }
    (cell, window)
}
