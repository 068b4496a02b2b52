//! The plan of a simulation: grid, slices, band limit, beams, memory. Nothing is simulated here,
//! so a plan can be shown and tested without running it.

use super::settings::{Algorithm, BeyondLimit, GridChoice, POTENTIAL_SAMPLING_ANGSTROM, Settings};
use super::stepper;
use super::windows::waves_of_patch;
use crate::detect::{DetectorMap, Pattern};
use crate::error::{Error, Result};
use crate::fft::multiplier::Disk;
use crate::fft::{frequency, good_size};
use crate::potential::projected::Projection;
use crate::potential::slices::Slices;
use serde::Serialize;

/// A periodic grid in real space.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Grid {
    /// Points along x and y.
    pub points: [usize; 2],
    /// Extent along x and y in Angstrom.
    pub extent_angstrom: [f64; 2],
}

impl Grid {
    /// Pixel size along x and y in Angstrom.
    pub fn sampling_angstrom(&self) -> [f64; 2] {
        [0, 1].map(|i| self.extent_angstrom[i] / self.points[i] as f64)
    }

    /// (rows, columns)
    pub fn shape(&self) -> (usize, usize) {
        (self.points[1], self.points[0])
    }

    /// Spacing of the Fourier grid along x and y in 1/Angstrom.
    pub fn dk(&self) -> [f64; 2] {
        self.extent_angstrom.map(|l| 1.0 / l)
    }

    /// Spatial frequency (kx, ky) of bin (row iy, column ix) in 1/Angstrom.
    pub fn k(&self, iy: usize, ix: usize) -> [f64; 2] {
        [
            frequency(ix, self.points[0]) as f64 / self.extent_angstrom[0],
            frequency(iy, self.points[1]) as f64 / self.extent_angstrom[1],
        ]
    }

    /// Nyquist frequency of the coarser axis in 1/Angstrom.
    pub fn nyquist(&self) -> f64 {
        let [x, y] = self.sampling_angstrom();
        0.5 / x.max(y)
    }
}

/// What will be computed, and on which grids.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Plan {
    /// The settings it was made from.
    #[serde(skip)]
    pub settings: Settings,
    /// Grid of the potentials, over the whole cell: fine enough for smoothed ones, or finer than the
    /// grid that carries the band limit by the oversampling.
    pub potential_grid: Grid,
    /// Cutoff of the smoothing of potentials in 1/Angstrom; `None` exponentiates them as they are.
    pub core_cutoff: Option<f64>,
    /// Grid of the transmission functions, over the whole cell.
    pub transmission_grid: Grid,
    /// Grid in which waves are propagated: the whole cell or a window.
    pub wave_grid: Grid,
    /// Radius of the anti-aliasing disk in 1/Angstrom.
    pub band_limit: f64,
    /// The largest angle in mrad that is carried in full: the band limit less the taper.
    pub band_limit_mrad: f64,
    /// Slices.
    pub slices: Slices,
    /// After which slices images are recorded (0-based, increasing; the last is usually the last
    /// slice).
    pub record_after: Vec<usize>,
    /// Slices that a wave passes: all, or fewer where windows meet atoms in some only ([`Plan::count_steps`]).
    pub steps_per_wave: f64,
    /// Waves propagated for each probe of a scan: fewer than 1 where probes are expanded ([`Plan::count_waves`]).
    pub waves_per_probe: f64,
    /// Plane waves propagated (PRISM) or 0.
    pub beams: usize,
    /// For PRISM, the grid on which exit waves are kept: the whole cell at the band limit.
    pub exit_grid: Option<Grid>,
    /// Things to tell the user.
    pub warnings: Vec<String>,
}

/// Aliasing-tolerant fraction of Nyquist of the windowed engine's coarse grid; the transmission
/// functions are band-limited beforehand on the fine grid.
const WINDOW_BAND_FRACTION: f64 = 0.98;
/// Windows may be narrower than asked for by this factor, where that makes a faster length do.
const WINDOW_WIDTH_TOLERANCE: f64 = 0.985;
/// Up to here the band fraction was found not to matter (0.1 % of HAADF).
const WELL_TRIED_BAND_FRACTION: f64 = 0.9;
/// Room above the outermost detector angle in the samplings that errors advise.
const BAND_MARGIN: f64 = 1.0005;

impl Plan {
    /// Plans the simulation of a cell of `cell_angstrom` (x, y, z) with atoms at mean heights `z`.
    ///
    /// # Errors
    /// Settings out of range; a detector beyond the band limit.
    pub fn new(settings: &Settings, cell_angstrom: [f64; 3], z: &[f64]) -> Result<Self> {
        settings.validate()?;
        if cell_angstrom.iter().any(|l| !(*l > 0.0 && l.is_finite())) {
            let value = format!("{cell_angstrom:?}");
            return Err(Error::invalid(
                crate::Setting::CellAngstrom,
                value,
                "edges must be positive",
            ));
        }
        let slices = Slices::new(settings.slicing, cell_angstrom[2], z)?;
        let extent = [cell_angstrom[0], cell_angstrom[1]];
        let wavelength = settings.optics.wavelength_angstrom();
        let interpolation = match settings.algorithm {
            Algorithm::Prism { interpolation } => interpolation,
            _ => [1, 1],
        };
        let grid = choose_grid(settings, extent, interpolation)?;
        let (mut band_limit, warnings) = band_limit(settings, &grid)?;
        if let (Algorithm::Window { .. }, GridChoice::Auto) = (settings.algorithm, settings.grid) {
            // Windows have a grid of their own: no more than what was asked for.
            let taper = settings.band_fraction / (settings.band_fraction - settings.band_taper);
            band_limit = carried_mrad(settings) * 1e-3 / wavelength * taper;
        }
        let (transmission_grid, wave_grid) = match settings.algorithm {
            Algorithm::Window { width_angstrom } => {
                window_grids(grid.extent_angstrom, band_limit, width_angstrom)
            }
            _ => (grid, grid),
        };
        let cores = settings.oversampling.is_none()
            && settings.projection == Projection::Infinite
            && !settings.abtem_pixel_correction;
        let (potential_grid, core_cutoff) = if cores {
            let (grid, cutoff) = smooth_grid(extent, band_limit);
            (grid, Some(cutoff))
        } else {
            (oversampled(&grid, settings.oversampling), None)
        };
        let mut plan = Plan {
            settings: settings.clone(),
            potential_grid,
            core_cutoff,
            transmission_grid,
            wave_grid,
            band_limit,
            band_limit_mrad: (band_limit - settings.band_taper * grid.nyquist()) * wavelength * 1e3,
            record_after: record_after(&settings.thicknesses_angstrom, &slices)?,
            steps_per_wave: slices.len() as f64,
            slices,
            waves_per_probe: 1.0,
            beams: 0,
            exit_grid: None,
            warnings,
        };
        if matches!(settings.algorithm, Algorithm::Prism { .. }) {
            plan.beams = plan.prism_beams().len();
            plan.exit_grid = Some(plan.prism_exit_grid(interpolation));
        }
        plan.check_aperture()?;
        plan.warn_about_aliasing();
        Ok(plan)
    }

    /// The grid on which potentials are exponentiated as they are where cores come too close.
    pub(super) fn oversampled_grid(&self) -> Grid {
        oversampled(&self.transmission_grid, None)
    }

    /// The anti-aliasing disk.
    pub fn disk(&self) -> Disk {
        let full = self.band_limit_mrad * 1e-3 / self.settings.optics.wavelength_angstrom();
        Disk { limit_k2: self.band_limit * self.band_limit, full_k2: full * full }
    }

    /// The angle in mrad from which on nothing is carried.
    pub fn cutoff_mrad(&self) -> f64 {
        self.band_limit * self.settings.optics.wavelength_angstrom() * 1e3
    }

    /// The detectors on a diffraction pattern of `grid`, `stride` elements from row to row.
    pub(super) fn detector_map(&self, grid: &Grid, stride: usize, ramp_mrad: f64) -> DetectorMap {
        let wavelength = self.settings.optics.wavelength_angstrom();
        let limit_mrad = self.cutoff_mrad();
        let pattern = Pattern { shape: grid.shape(), stride, limit_mrad, ramp_mrad };
        DetectorMap::new(&self.settings.detectors, pattern, |iy, ix| {
            let [kx, ky] = grid.k(iy, ix);
            kx.hypot(ky) * wavelength * 1e3
        })
    }

    /// Width of the detectors' edges in mrad: one Fourier pixel in windows, whose pixels are coarse;
    /// none on the full grid.
    pub fn detector_ramp_mrad(&self) -> f64 {
        if self.wave_grid == self.transmission_grid {
            return 0.0;
        }
        let [x, y] = self.wave_grid.dk();
        x.max(y) * self.settings.optics.wavelength_angstrom() * 1e3
    }

    /// Thicknesses of the recorded images in Angstrom.
    pub fn thicknesses_angstrom(&self) -> Vec<f64> {
        let entrance = self.slices.entrance();
        self.record_after.iter().map(|&i| self.slices.boundaries[i + 1] - entrance).collect()
    }

    /// Frequencies (kx, ky indices on the full Fourier grid) of the PRISM beams.
    pub fn prism_beams(&self) -> Vec<[i64; 2]> {
        let Algorithm::Prism { interpolation } = self.settings.algorithm else { return Vec::new() };
        let optics = &self.settings.optics;
        let dk: [f64; 2] =
            [0, 1].map(|i| interpolation[i] as f64 / self.wave_grid.extent_angstrom[i]);
        let radius = optics.semiangle_mrad * 1e-3 / optics.wavelength_angstrom();
        let reach = dk.map(|d| (radius / d) as i64 + 1);
        let mut beams = Vec::new();
        for iy in -reach[1]..=reach[1] {
            for ix in -reach[0]..=reach[0] {
                let k = [ix as f64 * dk[0], iy as f64 * dk[1]];
                if optics.transfer(k, dk).norm() > 0.0 {
                    beams.push([ix * interpolation[0] as i64, iy * interpolation[1] as i64]);
                }
            }
        }
        beams
    }

    fn prism_exit_grid(&self, interpolation: [usize; 2]) -> Grid {
        if self.settings.full_exit_grid {
            return self.wave_grid;
        }
        let points = [0, 1].map(|i| {
            let half = (self.band_limit * self.wave_grid.extent_angstrom[i]) as usize;
            good_size(2 * half + 2, interpolation[i]).min(self.wave_grid.points[i])
        });
        Grid { points, ..self.wave_grid }
    }

    /// Bytes that the largest arrays will take on `threads` threads.
    pub fn memory_bytes(&self, threads: usize, probes: usize) -> u64 {
        let size = |g: &Grid| (g.points[0] * g.points[1] * 8) as u64;
        let fine = size(&self.potential_grid);
        // windows go on beyond the cell
        let padding = match self.wave_grid == self.transmission_grid {
            true => [0, 0],
            false => self.wave_grid.points,
        };
        let [nx, ny] = [0, 1].map(|i| self.transmission_grid.points[i] + padding[i]);
        let transmission = (nx * ny * 8 * self.slices.len()) as u64;
        let exit = self.exit_grid.as_ref().map_or(0, |g| size(g) * self.beams as u64);
        let wave = size(&self.wave_grid);
        // expanded probes: the waves of a patch, and their amplitudes on detectors
        let together = stepper::group(wave as usize).max(2 * waves_of_patch(self));
        let waves = wave * (together as u64 + 2) * threads as u64;
        let images = (probes * self.settings.detectors.len() * self.record_after.len() * 16) as u64;
        transmission + exit + waves + fine * 5 * threads as u64 + images
    }

    /// Nominal floating-point operations (`5 N log2 N` a transform) for `probes` probes.
    pub fn nominal_flops(&self, probes: usize) -> f64 {
        let fft = |g: &Grid| {
            let n = (g.points[0] * g.points[1]) as f64;
            5.0 * n * n.log2()
        };
        let waves = match self.beams {
            0 => probes as f64 * self.waves_per_probe,
            beams => beams as f64,
        };
        let propagation = waves * self.steps_per_wave * 2.0 * fft(&self.wave_grid);
        let potentials = self.slices.len() as f64 * 4.0 * fft(&self.potential_grid);
        let reduction = match (&self.exit_grid, self.settings.algorithm) {
            (Some(g), Algorithm::Prism { interpolation }) => {
                let window =
                    (g.points[0] / interpolation[0] * (g.points[1] / interpolation[1])) as f64;
                (probes * self.record_after.len()) as f64 * 8.0 * window * self.beams as f64 * 1.3
            }
            _ => 0.0,
        };
        f64::from(self.settings.configurations()) * (propagation + potentials + reduction)
    }

    fn check_aperture(&self) -> Result<()> {
        let semiangle = self.settings.optics.semiangle_mrad;
        if semiangle * 1.02 > self.band_limit_mrad {
            let expected = format!(
                "must lie inside the grid's band limit of {:.1} mrad; use a finer sampling",
                self.band_limit_mrad
            );
            return Err(Error::invalid(crate::Setting::SemiangleMrad, semiangle, expected));
        }
        Ok(())
    }

    fn warn_about_aliasing(&mut self) {
        let fraction = self.settings.band_fraction;
        if fraction > WELL_TRIED_BAND_FRACTION {
            self.warnings.push(format!(
                "band fraction {fraction:.3} above {WELL_TRIED_BAND_FRACTION}: intensity is aliased \
                 at the highest angles; the error was not measured"
            ));
        }
    }
}

/// The angle that grids of the program's choice carry.
fn carried_mrad(settings: &Settings) -> f64 {
    let outermost = settings.detectors.iter().map(|d| d.outer_mrad).fold(0.0, f64::max);
    outermost.max(settings.optics.semiangle_mrad) * settings.angle_margin.max(BAND_MARGIN)
}

fn choose_grid(settings: &Settings, extent: [f64; 2], multiple: [usize; 2]) -> Result<Grid> {
    let wavelength = settings.optics.wavelength_angstrom();
    let points = match settings.grid {
        GridChoice::Points(points) => {
            for i in 0..2 {
                if points[i] < 8 || !points[i].is_multiple_of(multiple[i]) {
                    let value = format!("{},{}", points[0], points[1]);
                    let expected = "needs at least 8 points along each axis, in multiples of the \
                                    interpolation factor";
                    return Err(Error::invalid(crate::Setting::Gpts, value, expected));
                }
            }
            points
        }
        choice => {
            let sampling = match choice {
                GridChoice::Sampling(s) => s,
                _ => {
                    let angle = carried_mrad(settings) * 1e-3;
                    (settings.band_fraction - settings.band_taper) * wavelength / (2.0 * angle)
                }
            };
            if !(1e-4..10.0).contains(&sampling) {
                let expected = "must be between 0.0001 and 10";
                return Err(Error::invalid(crate::Setting::SamplingAngstrom, sampling, expected));
            }
            [0, 1].map(|i| good_size((extent[i] / sampling - 1e-3).ceil() as usize, multiple[i]))
        }
    };
    if points.iter().any(|&n| n > 1 << 16) {
        let value = format!("{},{}", points[0], points[1]);
        return Err(Error::invalid(
            crate::Setting::Gpts,
            value,
            "at most 65536; simulate a smaller cell",
        ));
    }
    Ok(Grid { points, extent_angstrom: extent })
}

/// A grid `factor` times finer, by default finer than [`POTENTIAL_SAMPLING_ANGSTROM`].
fn oversampled(grid: &Grid, factor: Option<usize>) -> Grid {
    let [x, y] = grid.sampling_angstrom();
    let finer = (x.max(y) / POTENTIAL_SAMPLING_ANGSTROM - 1e-3).ceil().max(1.0) as usize;
    Grid { points: grid.points.map(|n| n * factor.unwrap_or(finer)), ..*grid }
}

/// The grid for smoothed potentials and the cutoff of the smoothing in 1/Angstrom: frequencies that
/// alias into the disk are then 5.5 cutoffs and more, where the exponential of a smoothed Pt atom
/// has fallen below 2e-4 of its scattering (measured, 200 kV).
fn smooth_grid(extent: [f64; 2], band_limit: f64) -> (Grid, f64) {
    const CUTOFFS: f64 = 5.5;
    const LEAST_CUTOFF: f64 = 2.5;
    const MOST_CUTOFF: f64 = 4.0;
    let nyquist = (0.5 * (CUTOFFS * LEAST_CUTOFF + band_limit)).max(1.02 * band_limit);
    let points = extent.map(|l| good_size((2.0 * nyquist * l).ceil() as usize, 1));
    let grid = Grid { points, extent_angstrom: extent };
    (grid, ((2.0 * grid.nyquist() - band_limit) / CUTOFFS).min(MOST_CUTOFF))
}

/// The radius of the anti-aliasing disk, and warnings about detectors.
fn band_limit(settings: &Settings, grid: &Grid) -> Result<(f64, Vec<String>)> {
    let wavelength = settings.optics.wavelength_angstrom();
    let limit = settings.band_fraction * grid.nyquist();
    let limit_mrad = (limit - settings.band_taper * grid.nyquist()) * wavelength * 1e3;
    let mut warnings = Vec::new();
    for d in settings.detectors.iter().filter(|d| d.outer_mrad > limit_mrad) {
        let [x, y] = grid.sampling_angstrom();
        let sampling = x.max(y);
        if settings.beyond_limit == BeyondLimit::Error || d.inner_mrad >= limit_mrad {
            return Err(Error::DetectorBeyondBandLimit {
                name: d.name.clone(),
                outer_mrad: d.outer_mrad,
                limit_mrad,
                sampling_angstrom: sampling,
                needed_angstrom: sampling * limit_mrad / (d.outer_mrad * BAND_MARGIN),
            });
        }
        let area = |r: f64| r * r;
        let empty =
            (area(d.outer_mrad) - area(limit_mrad)) / (area(d.outer_mrad) - area(d.inner_mrad));
        warnings.push(format!(
            "detector `{}` ({}-{} mrad): the grid carries scattering only to {limit_mrad:.1} mrad, \
             so {:.0} % of the annulus is empty; a sampling of {:.4} A would fill it",
            d.name,
            d.inner_mrad,
            d.outer_mrad,
            100.0 * empty,
            sampling * limit_mrad / (d.outer_mrad * BAND_MARGIN)
        ));
    }
    Ok((limit, warnings))
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

/// The coarse grid of the whole cell and the window, with the same pixels.
fn window_grids(extent: [f64; 2], band_limit: f64, width: f64) -> (Grid, Grid) {
    let coarsest = WINDOW_BAND_FRACTION / (2.0 * band_limit);
    let mut cell = Grid { points: [0; 2], extent_angstrom: extent };
    let mut window = cell;
    for i in 0..2 {
        let least = (extent[i] / coarsest).ceil() as usize;
        // The window is transformed for every probe, the cell once a slice: a fast length for the one,
        // any product of 2, 3 and 5 for the other.
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

fn record_after(thicknesses: &[f64], slices: &Slices) -> Result<Vec<usize>> {
    let last = slices.len() - 1;
    if thicknesses.is_empty() {
        return Ok(vec![last]);
    }
    let mut after = Vec::new();
    for &t in thicknesses {
        if !(t > 0.0 && t <= slices.thickness() + 1e-6) {
            let expected =
                format!("must be above 0 and at most the thickness, {:.3} A", slices.thickness());
            return Err(Error::invalid(crate::Setting::ThicknessAngstrom, t, expected));
        }
        let exit = slices.entrance() + t;
        let distance = |i: &usize| (slices.boundaries[i + 1] - exit).abs();
        let nearest = (0..=last).min_by(|a, b| distance(a).total_cmp(&distance(b)));
        after.extend(nearest);
    }
    after.sort_unstable();
    after.dedup();
    Ok(after)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::Detector;

    const CELL: [f64; 3] = [19.525, 19.525, 39.05];

    fn heights() -> Vec<f64> {
        (0..20).map(|i| f64::from(i) * 1.9525).collect()
    }

    #[test]
    fn default_grid_carries_200_mrad() {
        let plan = Plan::new(&Settings::default(), CELL, &heights()).unwrap();
        assert!(plan.band_limit_mrad >= 200.0, "{}", plan.band_limit_mrad);
        assert_eq!(plan.wave_grid.points, [480, 480]);
        assert_eq!(plan.potential_grid.points, [480, 480]);
        assert_eq!(plan.slices.len(), 20);
        assert_eq!(plan.record_after, vec![19]);
    }

    #[test]
    fn detector_beyond_the_limit_names_a_sampling_that_does() {
        let coarse = Settings {
            grid: GridChoice::Sampling(0.05),
            band_fraction: 2.0 / 3.0,
            ..Settings::default()
        };
        let error = Plan::new(&coarse, CELL, &heights()).unwrap_err();
        let Error::DetectorBeyondBandLimit { needed_angstrom, limit_mrad, .. } = error else {
            panic!("{error}")
        };
        assert!((167.0..175.0).contains(&limit_mrad), "{limit_mrad}");
        let finer = Settings { grid: GridChoice::Sampling(needed_angstrom), ..coarse.clone() };
        assert!(Plan::new(&finer, CELL, &heights()).is_ok());
        let published = Settings { beyond_limit: BeyondLimit::Warn, ..coarse };
        let plan = Plan::new(&published, CELL, &heights()).unwrap();
        assert!(plan.warnings[0].contains("% of the annulus is empty"), "{:?}", plan.warnings);
    }

    #[test]
    fn prism_beams_fill_the_aperture() {
        for f in [1, 2, 3] {
            let algorithm = Algorithm::Prism { interpolation: [f, f] };
            let plan = Plan::new(&Settings { algorithm, ..Settings::default() }, CELL, &heights())
                .unwrap();
            let area = std::f64::consts::PI * (0.021 / 0.025_079_3 * 19.525 / f as f64).powi(2);
            // a soft edge adds half a pixel to the radius
            let radius = (area / std::f64::consts::PI).sqrt();
            let with_edge = std::f64::consts::PI * (radius + 0.5).powi(2);
            assert!(
                (plan.beams as f64 / with_edge - 1.0).abs() < 0.1,
                "{} {with_edge}",
                plan.beams
            );
            let exit = plan.exit_grid.unwrap();
            assert!(exit.nyquist() > plan.band_limit && exit.points[0].is_multiple_of(f));
        }
    }

    #[test]
    fn thickness_series_is_moved_to_slice_boundaries() {
        let settings =
            Settings { thicknesses_angstrom: vec![39.05, 10.0, 9.7], ..Settings::default() };
        let plan = Plan::new(&settings, CELL, &heights()).unwrap();
        assert_eq!(plan.record_after, vec![4, 19]);
        assert!((plan.thicknesses_angstrom()[0] - 9.7625).abs() < 1e-6);
        let bad = Settings { thicknesses_angstrom: vec![50.0], ..Settings::default() };
        assert!(Plan::new(&bad, CELL, &heights()).is_err());
    }

    #[test]
    fn bad_settings_name_what_and_why() {
        let cases: Vec<(Settings, &str)> = vec![
            (Settings { detectors: vec![], ..Settings::default() }, "detectors"),
            (
                Settings { detectors: vec![Detector::new("a", 30.0, 10.0)], ..Settings::default() },
                "inner < outer",
            ),
            (Settings { band_fraction: 1.2, ..Settings::default() }, "band fraction"),
            (Settings { grid: GridChoice::Sampling(-1.0), ..Settings::default() }, "sampling"),
            (Settings { grid: GridChoice::Points([4, 4]), ..Settings::default() }, "gpts"),
            (
                Settings {
                    algorithm: Algorithm::Prism { interpolation: [0, 1] },
                    ..Settings::default()
                },
                "interpolation",
            ),
        ];
        for (settings, expected) in cases {
            let message = Plan::new(&settings, CELL, &heights()).unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        }
    }
}
