//! The plan of a simulation: grids, slices, band limit, beams. Nothing is simulated here, so a plan can be shown and
//! tested without running it; [`super::Cost`] estimates what running it takes.

use super::grid::Grid;
use super::grid_choice::{
    band_limit, carried_mrad, cell_grid, oversampled, smoothed_grid, window_grids,
};
use super::probe_width;
use super::settings::{Algorithm, GridChoice, Settings};
use crate::detect::{Detector, DetectorMap, Pattern};
use crate::error::{Error, Result};
use crate::fft::{BandLimit, good_size};
use crate::optics::{Focus, foci};
use crate::plane;
use crate::potential::projected::Projection;
use crate::potential::slices::{FINE_ANGSTROM, GROUP_ANGSTROM, Slices, Slicing};
use serde::Serialize;

/// Computations of a simulation, and their grids. A plan is final when [`Plan::new`] returns it: nothing changes it afterwards.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Plan {
    /// The settings that the plan was made from.
    #[serde(skip)]
    pub settings: Settings,
    /// Grid of the potentials, over the whole cell: fine enough for smoothed potentials, or finer than the
    /// transmission grid by the oversampling.
    pub potential_grid: Grid,
    /// Cutoff of the smoothing of potentials in 1/Angstrom; `None`: they are not smoothed.
    pub core_cutoff: Option<f64>,
    /// Grid of the transmission functions, over the whole cell.
    pub transmission_grid: Grid,
    /// Grid on which waves are propagated: the whole cell or a window.
    pub wave_grid: Grid,
    /// Radius of the anti-aliasing aperture in 1/Angstrom.
    pub band_limit: f64,
    /// The largest angle in mrad that is carried in full: the band limit less the taper.
    pub band_limit_mrad: f64,
    /// Slices.
    pub slices: Slices,
    /// How the specimen is cut, with [`Slicing::Auto`] replaced by the slices that it stands for.
    #[serde(skip)]
    pub slicing: Slicing,
    /// Indices of the slices after which images are recorded (0-based, increasing). The last is usually the last slice.
    pub record_after: Vec<usize>,
    /// Number of plane waves propagated with PRISM, 0 with other algorithms.
    pub beams: usize,
    /// Grid on which PRISM keeps exit waves: the whole cell, with just the points that the band limit needs.
    pub exit_grid: Option<Grid>,
    /// Warnings for the user.
    pub warnings: Vec<String>,
}

/// Up to this band fraction, tests found that HAADF images change by less than 0.1 %.
const WELL_TRIED_BAND_FRACTION: f64 = 0.9;
impl Plan {
    /// Plans the simulation of a cell of `cell_angstrom` (x, y, z) with atoms at mean heights `z` (Angstrom).
    ///
    /// # Errors
    /// Settings out of range ([`Error::Invalid`]); [`Error::DetectorBeyondBandLimit`].
    pub fn new(settings: &Settings, cell_angstrom: [f64; 3], z: &[f64]) -> Result<Self> {
        settings.validate()?;
        check_edges(cell_angstrom)?;
        let windows = matches!(settings.algorithm, Algorithm::Window { .. });
        let slicing = settings.slicing.resolved(windows, cell_angstrom[2], z);
        let slices = Slices::new(slicing, cell_angstrom[2], z)?;
        let record_after = record_after(&settings.thicknesses_angstrom, &slices)?;
        let extent = [cell_angstrom[0], cell_angstrom[1]];
        let interpolation = match settings.algorithm {
            Algorithm::Prism { interpolation } => interpolation,
            _ => [1, 1],
        };
        let grid = cell_grid(settings, extent, interpolation)?;
        let (cell_limit, mut warnings) = band_limit(settings, &grid)?;
        let band_limit = match (settings.algorithm, settings.grid) {
            (Algorithm::Window { .. }, GridChoice::Auto) => window_band_limit(settings),
            _ => cell_limit,
        };
        let (transmission_grid, wave_grid) = match settings.algorithm {
            Algorithm::Window { width_angstrom } => {
                window_grids(grid.extent_angstrom, band_limit, width_angstrom)
            }
            _ => (grid, grid),
        };
        warnings.extend(aliasing_warning(settings));
        warnings.extend(same_slice_warning(settings, &record_after, &slices));
        let wave = wave_grid.extent_angstrom;
        warnings.extend(probe_width::narrow_crop(settings, extent, wave, slices.thickness()));
        let (potential_grid, core_cutoff) = match smooths_potentials(settings) {
            true => {
                let (grid, cutoff) = smoothed_grid(extent, band_limit);
                (grid, Some(cutoff))
            }
            false => (oversampled(&grid, settings.oversampling), None),
        };
        let wavelength = settings.optics.wavelength_angstrom();
        let mut plan = Plan {
            settings: settings.clone(),
            potential_grid,
            core_cutoff,
            transmission_grid,
            wave_grid,
            band_limit,
            band_limit_mrad: (band_limit - settings.band_taper * grid.nyquist()) * wavelength * 1e3,
            record_after,
            slices,
            slicing,
            beams: 0,
            exit_grid: None,
            warnings,
        };
        if matches!(settings.algorithm, Algorithm::Prism { .. }) {
            plan.beams = plan.prism_beams().len();
            plan.exit_grid = Some(plan.prism_exit_grid(interpolation));
        }
        plan.check_aperture()?;
        Ok(plan)
    }

    /// A warning about a cell that is narrower than the probe inside the specimen. Plane waves have no such limit.
    pub(crate) fn narrow_cell(&self) -> Option<String> {
        let crops = matches!(self.settings.algorithm, Algorithm::Window { .. });
        let cell = self.transmission_grid.extent_angstrom;
        (!crops)
            .then(|| probe_width::narrow_cell(&self.settings, cell, self.slices.thickness()))
            .flatten()
    }

    /// A warning about slices that were left open and are coarser than the slices of the exact engine.
    pub(crate) fn coarse_slices(&self) -> Option<String> {
        let coarse = self.settings.slicing == Slicing::Auto
            && self.slicing == Slicing::Grouped(GROUP_ANGSTROM);
        coarse.then(|| {
            format!(
                "the atoms form no planes: atoms within {GROUP_ANGSTROM} A along the beam share a slice, which was found to change dark-field images \
                 by 0.5 to 3 % rms of their mean; slices of {FINE_ANGSTROM} A, or windows, have smaller errors"
            )
        })
    }

    /// Whether waves are propagated in windows instead of the whole cell.
    pub(crate) fn has_windows(&self) -> bool {
        self.wave_grid != self.transmission_grid
    }

    /// Whether each window puts slices at the heights of the atoms near its middle.
    pub(super) fn has_local_slices(&self) -> bool {
        self.has_windows() && matches!(self.slicing, Slicing::Local(_))
    }

    /// Displacement (x, y) of the beam in Angstrom at a height in Angstrom, caused by the mistilt from the entrance surface on.
    pub(super) fn beam_shift(&self, height: f64) -> [f64; 2] {
        self.settings.optics.slope().map(|s| s * (height - self.slices.entrance()))
    }

    /// Pixels (x, y) by which windows have moved at a height (Angstrom) to follow the beam.
    pub(super) fn window_shift(&self, height: f64) -> [i64; 2] {
        if !self.has_windows() || self.settings.optics.tilt_mrad == [0.0; 2] {
            return [0; 2];
        }
        let (shift, pixel) = (self.beam_shift(height), self.wave_grid.sampling_angstrom());
        plane::div(shift, pixel).map(|n| n.round() as i64)
    }

    /// The plans for each focus of the focal spread, with their weights. Without focal spread there is only this one.
    pub(super) fn at_foci(&self) -> Vec<(f64, Plan)> {
        // Plans are made from checked settings, so there are foci.
        let foci = foci(&self.settings.optics).unwrap_or_default();
        let at = |focus: Focus| {
            let mut plan = self.clone();
            plan.settings.optics.aberrations.add_defocus(focus.offset_angstrom);
            (focus.weight, plan)
        };
        foci.into_iter().map(at).collect()
    }

    /// The grid of unsmoothed potentials, for slices in which atoms come too close for the closed form of their cores.
    pub(super) fn oversampled_grid(&self) -> Grid {
        oversampled(&self.transmission_grid, None)
    }

    /// The anti-aliasing aperture, with its soft edge.
    pub(crate) fn anti_aliasing(&self) -> BandLimit {
        let full = self.band_limit_mrad * 1e-3 / self.settings.optics.wavelength_angstrom();
        BandLimit { limit_k2: self.band_limit * self.band_limit, full_k2: full * full }
    }

    /// The angle in mrad beyond which no scattering is carried.
    pub(crate) fn cutoff_mrad(&self) -> f64 {
        self.band_limit * self.settings.optics.wavelength_angstrom() * 1e3
    }

    /// The detectors on a diffraction pattern of `grid`, `stride` elements from row to row.
    pub(super) fn detector_map(&self, grid: &Grid, stride: usize, ramp_mrad: f64) -> DetectorMap {
        self.detector_map_of(grid, stride, ramp_mrad, |_, _| 1.0, |iy, ix| grid.k(iy, ix))
    }

    /// The map of [`Plan::detector_map`] for a pattern with `k(row, column)` in 1/Angstrom, where `share(detector, theta_mrad)` of the
    /// electrons at an angle are counted.
    pub(super) fn detector_map_of(
        &self,
        grid: &Grid,
        stride: usize,
        ramp_mrad: f64,
        share: impl Fn(&Detector, f64) -> f64,
        k: impl Fn(usize, usize) -> [f64; 2],
    ) -> DetectorMap {
        let wavelength = self.settings.optics.wavelength_angstrom();
        let limit_mrad = self.cutoff_mrad();
        let pixel_mrad = grid.dk().map(|dk| dk * wavelength * 1e3);
        let pattern = Pattern { shape: grid.shape(), stride, limit_mrad, ramp_mrad, pixel_mrad };
        let angles = |iy, ix| k(iy, ix).map(|k| k * wavelength * 1e3);
        DetectorMap::new(&self.settings.detectors, pattern, angles, share)
    }

    /// Width of the detectors' soft edges in mrad: one Fourier pixel in windows, whose pixels are coarse, and 0 on the full grid.
    pub(crate) fn detector_ramp_mrad(&self) -> f64 {
        if !self.has_windows() {
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

    /// Frequencies of the PRISM beams as indices (kx, ky) on the full Fourier grid, ordered by ky, then kx; empty
    /// with other algorithms.
    pub(crate) fn prism_beams(&self) -> Vec<[i64; 2]> {
        let Algorithm::Prism { interpolation } = self.settings.algorithm else { return Vec::new() };
        let optics = &self.settings.optics;
        let dk: [f64; 2] =
            plane::div(interpolation.map(|n| n as f64), self.wave_grid.extent_angstrom);
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
}

fn check_edges(cell_angstrom: [f64; 3]) -> Result<()> {
    if cell_angstrom.iter().all(|l| *l > 0.0 && l.is_finite()) {
        return Ok(());
    }
    let value = format!("{cell_angstrom:?}");
    Err(Error::invalid(crate::Setting::CellAngstrom, value, "edges must be positive"))
}

/// Whether potentials are smoothed and the cores of atoms are added in closed form.
fn smooths_potentials(settings: &Settings) -> bool {
    settings.oversampling.is_none()
        && settings.projection == Projection::Infinite
        && !settings.abtem_placement
}

/// The band limit of windows on an automatic grid in 1/Angstrom: just the requested one.
fn window_band_limit(settings: &Settings) -> f64 {
    let taper = settings.band_fraction / (settings.band_fraction - settings.band_taper);
    carried_mrad(settings) * 1e-3 / settings.optics.wavelength_angstrom() * taper
}

fn aliasing_warning(settings: &Settings) -> Option<String> {
    let fraction = settings.band_fraction;
    (fraction > WELL_TRIED_BAND_FRACTION).then(|| {
        format!(
            "band fraction {fraction:.3} above {WELL_TRIED_BAND_FRACTION}: intensity is aliased \
             at the highest angles; the error was not measured"
        )
    })
}

/// A warning about thicknesses that end with the same slice: they share one image.
fn same_slice_warning(settings: &Settings, after: &[usize], slices: &Slices) -> Option<String> {
    let asked = &settings.thicknesses_angstrom;
    if asked.len() <= after.len() || asked.is_empty() {
        return None;
    }
    let entrance = slices.entrance();
    let found: Vec<String> = after
        .iter()
        .map(|&last| format!("{:.3}", slices.boundaries[last + 1] - entrance))
        .collect();
    Some(format!(
        "{} thicknesses were asked for, but some end with the same slice: images are recorded at {} A only; use thinner slices to separate \
         them",
        asked.len(),
        found.join(", ")
    ))
}

/// Indices of the slices after which images of these thicknesses (Angstrom) are recorded.
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
    use super::super::settings::BeyondLimit;
    use super::*;

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
        assert!(
            plan.warnings[0].contains("recorded at 9.762, 39.050 A only"),
            "{:?}",
            plan.warnings
        );
        let bad = Settings { thicknesses_angstrom: vec![50.0], ..Settings::default() };
        assert!(Plan::new(&bad, CELL, &heights()).is_err());
    }

    #[test]
    fn slices_that_are_left_open_follow_atoms_without_planes() {
        let none: Vec<f64> =
            (0..400).map(|i| (f64::from(i) * 38.0 * 0.618_034).rem_euclid(38.0)).collect();
        let plan = |algorithm, z: &[f64]| {
            let settings = Settings { algorithm, slicing: Slicing::Auto, ..Settings::default() };
            Plan::new(&settings, CELL, z).unwrap()
        };
        let windows = Algorithm::Window { width_angstrom: 7.8 };
        let local = plan(windows, &none);
        assert!(local.has_local_slices() && local.coarse_slices().is_none());
        let whole = plan(Algorithm::Multislice, &none);
        assert!(!whole.has_local_slices() && whole.coarse_slices().unwrap().contains("0.1 A"));
        for algorithm in [windows, Algorithm::Multislice] {
            let planes = plan(algorithm, &heights());
            assert!(!planes.has_local_slices() && planes.coarse_slices().is_none());
            assert_eq!(planes.slices.len(), 20);
        }
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
