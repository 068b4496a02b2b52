//! Conventional imaging: a plane wave and an objective lens.

use ndarray::{Array2, Array3, Axis};
use num_complex::Complex32;

use crate::detect::Detector;
use crate::engine::settings::AUTO_ANGLE_MARGIN;
use crate::engine::{Algorithm, GridChoice, Plan, Settings, Site, exit_wave, lens_image};
use crate::error::{Error, Result};
use crate::optics::Optics;
use crate::progress::Progress;
use crate::setting::Setting;

/// Angle in mrad that automatic grids carry, as for scans with the default detector.
const ANGLE_MRAD: f64 = 200.0;

/// Exit waves and their images.
#[derive(Debug, Clone)]
pub struct PlaneWaveImages {
    /// (configuration, y, x)
    pub exit_waves: Array3<Complex32>,
    /// Images through each lens, (1, y, x), averaged over configurations; the intensity of the incident wave is 1.
    pub images: Vec<Array3<f32>>,
}

/// The settings for a plane wave, whose grid does not depend on a detector.
pub(super) fn settings(scan: Settings) -> Result<Settings> {
    if scan.algorithm != Algorithm::Multislice {
        let expected = "a plane wave is propagated by multislice; leave the engine out";
        return Err(Error::invalid(Setting::Algorithm, scan.algorithm, expected));
    }
    if let Some(thickness) = scan.thicknesses_angstrom.first() {
        let expected = "a plane wave is known at the exit surface only; leave the thicknesses out";
        return Err(Error::invalid(Setting::ThicknessAngstrom, thickness, expected));
    }
    let grid = match scan.grid {
        GridChoice::Auto => {
            let angle = ANGLE_MRAD * AUTO_ANGLE_MARGIN * 1e-3;
            let band = scan.band_fraction - scan.band_taper;
            GridChoice::Sampling(band * scan.optics.wavelength_angstrom() / (2.0 * angle))
        }
        given => given,
    };
    let aperture = Detector::new("aperture", 0.0, scan.optics.semiangle_mrad);
    Ok(Settings { grid, detectors: vec![aperture], ..scan })
}

/// Propagates the wave through every configuration, and images it through each lens.
pub(super) fn run(
    plan: &Plan,
    lenses: &[&Optics],
    sites: &[Site],
    progress: &dyn Progress,
) -> Result<PlaneWaveImages> {
    let n = plan.settings.configurations();
    let (ny, nx) = plan.wave_grid.shape();
    let mut exit_waves = Array3::zeros((n as usize, ny, nx));
    let mut sums = vec![Array2::<f32>::zeros((ny, nx)); lenses.len()];
    progress.start("simulating", "wave", u64::from(n));
    for configuration in 0..n {
        if progress.interrupted() {
            return Err(Error::Interrupted);
        }
        let wave = exit_wave(plan, sites, configuration, progress)?;
        for (sum, lens) in sums.iter_mut().zip(lenses) {
            *sum += &lens_image(&wave, plan.wave_grid.extent_angstrom, lens);
        }
        exit_waves.index_axis_mut(Axis(0), configuration as usize).assign(&wave);
        progress.advance(1);
    }
    progress.finish();
    let images = sums.into_iter().map(|sum| (sum / n as f32).insert_axis(Axis(0))).collect();
    Ok(PlaneWaveImages { exit_waves, images })
}
