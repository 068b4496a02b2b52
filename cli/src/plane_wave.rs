//! Conventional imaging: a plane wave and an objective lens.

use super::structure_args::Prepared;
use anyhow::bail;
use ndarray::{Array3, Axis};
use num_complex::Complex32;
use stemgen::Error;
use stemgen::detect::Detector;
use stemgen::engine::settings::AUTO_ANGLE_MARGIN;
use stemgen::engine::{Algorithm, GridChoice, Plan, Settings, exit_wave, lens_image};
use stemgen::optics::Optics;
use stemgen::progress::Progress;

/// Angle in mrad that grids chosen by the program carry; as for scans with the default detector.
const ANGLE_MRAD: f64 = 200.0;

/// Exit waves and their image.
pub struct Conventional {
    /// (configuration, y, x)
    pub exit_waves: Array3<Complex32>,
    /// Images through each lens, (1, y, x), averaged over configurations.
    pub images: Vec<Array3<f32>>,
}

/// The settings for a plane wave: no detector decides about the grid.
pub fn settings(scan: Settings) -> anyhow::Result<Settings> {
    if scan.algorithm != Algorithm::Multislice {
        bail!("--plane-wave is computed by multislice; leave --algorithm out");
    }
    if !scan.thicknesses_angstrom.is_empty() {
        bail!("--plane-wave gives the wave at the exit surface only; leave --thicknesses out");
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
pub fn run(
    plan: &Plan,
    lenses: &[Optics],
    specimen: &Prepared,
    progress: &dyn Progress,
) -> stemgen::Result<Conventional> {
    let n = plan.settings.configurations();
    let (ny, nx) = plan.wave_grid.shape();
    let mut exit_waves = Array3::zeros((n as usize, ny, nx));
    let mut sums = vec![ndarray::Array2::<f32>::zeros((ny, nx)); lenses.len()];
    progress.start("simulating", "wave", u64::from(n));
    for configuration in 0..n {
        if progress.interrupted() {
            return Err(Error::Interrupted);
        }
        let wave = exit_wave(plan, &specimen.sites, configuration, progress)?;
        for (sum, lens) in sums.iter_mut().zip(lenses) {
            *sum += &lens_image(&wave, plan.wave_grid.extent_angstrom, lens);
        }
        exit_waves.index_axis_mut(Axis(0), configuration as usize).assign(&wave);
        progress.advance(1);
    }
    progress.finish();
    let images = sums.into_iter().map(|sum| (sum / n as f32).insert_axis(Axis(0))).collect();
    Ok(Conventional { exit_waves, images })
}
