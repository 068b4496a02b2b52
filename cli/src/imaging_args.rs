//! Options of the microscope and of the engine.

use super::slips;
use super::values::{
    self, EngineName, NumberSeries, ParametrizationName, ProbeBoxName, ProjectionName,
};
use anyhow::bail;
use clap::Args;
use stemgen::detect::Detector;
use stemgen::engine::settings::{AUTO_ANGLE_MARGIN, DEFAULT_BAND_FRACTION};
use stemgen::engine::{
    Algorithm, BeyondLimit, Expansion, GridChoice, Phonons, ProbeStep, Settings, Source,
};
use stemgen::optics::{Aberration, Aberrations, Optics};
use stemgen::potential::slices::Slicing;

/// Window of `simulate --algorithm window` in Angstrom.
const WINDOW_ANGSTROM: f64 = 11.7;

/// The microscope.
#[derive(Debug, Args)]
#[command(next_help_heading = "Microscope")]
pub struct MicroscopeArgs {
    /// Beam energy in keV (the accelerating voltage in kV)
    #[arg(long, value_name = "KV", default_value_t = 200.0, value_parser = values::energy)]
    #[arg(allow_negative_numbers = true)]
    pub energy: f64,
    /// Convergence semiangle; the objective aperture with --plane-wave
    #[arg(long, value_name = "MRAD", default_value_t = 21.0, value_parser = values::semiangle)]
    #[arg(allow_negative_numbers = true)]
    pub semiangle: f64,
    /// Defocus from the entrance surface of the box (z = 0), where the focus lies by default; positive is
    /// underfocus, with the focus deeper in the specimen
    /// `simulate` takes a series, START:END:STEP, and makes an image for each value
    #[arg(long, value_name = "A", default_value = "0", value_parser = values::series)]
    #[arg(allow_hyphen_values = true)]
    pub defocus: NumberSeries,
    /// Aberration coefficient in A, with azimuth in rad: C12=30@0.3, C30=1e5 (repeatable)
    #[arg(long, value_name = "Cnm=A[@RAD]", value_parser = values::aberration)]
    pub aberration: Vec<Aberration>,
    /// Mistilt of the specimen in mrad, up to 20: the beam runs along (tan X, tan Y, 1) of the box [default: 0,0]
    #[arg(long, value_name = "X,Y", value_parser = values::point, allow_hyphen_values = true)]
    pub tilt: Option<[f64; 2]>,
    /// Standard deviation of the focus in A, over which images are averaged: C_c dE / E, with the standard deviation dE of
    /// the energy [default: 0]
    #[arg(long, value_name = "A", value_parser = values::finite, allow_negative_numbers = true)]
    pub focal_spread: Option<f64>,
    /// Width of the electron source in A (full width at half maximum; 0.7-1.0 is usual), a Gaussian
    /// [default: a point]
    #[arg(long, value_name = "A", value_parser = values::positive, allow_negative_numbers = true)]
    pub source_size: Option<f64>,
    /// Share of the source in long tails, from 0 to 1: a Lorentz profile of the same width in place of the Gaussian
    #[arg(long, value_name = "SHARE", value_parser = values::finite, allow_negative_numbers = true)]
    #[arg(requires = "source_size")]
    pub source_lorentz: Option<f64>,
    /// Annular detector, inner and outer angle in mrad; BF=0-20, ABF=10-20, ADF=40-100
    /// (repeatable) [default: HAADF=68-200]
    #[arg(long, value_name = "NAME=IN-OUT", value_parser = values::detector)]
    pub detector: Vec<Detector>,
    /// Go on when a detector reaches beyond what the grid carries
    #[arg(long)]
    pub allow_empty_angles: bool,
}

/// The engine.
#[derive(Debug, Args)]
#[command(next_help_heading = "Numerics")]
pub struct NumericsArgs {
    /// How probes are propagated [default: multislice]
    #[arg(long = "engine", visible_alias = "algorithm", value_name = "NAME")]
    pub algorithm: Option<EngineName>,
    /// Take the narrowest window whose error is at most so many per cent of the mean image (rms), measured beforehand
    /// on a sample of probes; where no window saves time, the exact engine
    #[arg(long, value_name = "PERCENT", value_parser = values::percent, allow_negative_numbers = true)]
    #[arg(conflicts_with_all = ["window", "interpolation"])]
    pub accuracy: Option<f64>,
    /// PRISM interpolation factor, or one for x and one for y [default: 1]
    #[arg(long, value_name = "F[,FY]", value_parser = values::factors, conflicts_with = "window")]
    pub interpolation: Option<[usize; 2]>,
    /// Width of the window that follows each probe, in A [default: 11.7]
    #[arg(long, value_name = "A", value_parser = values::finite, allow_negative_numbers = true)]
    pub window: Option<f64>,
    /// Pixel of the grid in A, at most [default: carries the outermost detector angle times
    /// --angle-margin]
    #[arg(long, value_name = "A", value_parser = values::finite, allow_negative_numbers = true)]
    #[arg(conflicts_with = "gpts")]
    pub sampling: Option<f64>,
    /// Grid points along x and y
    #[arg(long, value_name = "NX,NY", value_parser = values::counts2)]
    pub gpts: Option<[usize; 2]>,
    /// Slices of equal thickness, at most so many A [default: one slice per atomic plane;
    /// without planes, atoms within 0.5 A share one]
    #[arg(long, value_name = "A", value_parser = values::finite, allow_negative_numbers = true)]
    pub slice_thickness: Option<f64>,
    /// How an atom is distributed over slices
    #[arg(long, value_name = "NAME", default_value = "infinite")]
    pub projection: ProjectionName,
    /// Table of scattering factors
    #[arg(long, value_name = "NAME", default_value = "lobato")]
    pub parametrization: ParametrizationName,
    /// Radius of the anti-aliasing disk, in units of Nyquist [default: 0.8; 2/3 excludes
    /// aliasing altogether]
    #[arg(long, value_name = "F", value_parser = values::finite, allow_negative_numbers = true)]
    pub band_fraction: Option<f64>,
    /// Width of the soft edge inside that disk, in units of Nyquist
    #[arg(long, value_name = "F", default_value_t = 0.0, value_parser = values::finite)]
    #[arg(allow_negative_numbers = true)]
    pub band_taper: f64,
    /// Exponentiate potentials on a grid so many times finer [default: smoothed potentials, with the
    /// cores of the atoms put back in closed form]
    #[arg(long, value_name = "N")]
    pub oversampling: Option<usize>,
    /// The grid carries so many times the outermost detector angle
    #[arg(long, value_name = "F", default_value_t = AUTO_ANGLE_MARGIN, value_parser = values::finite)]
    #[arg(allow_negative_numbers = true)]
    pub angle_margin: f64,
    /// How far apart probes are propagated, in A, at most; images are interpolated to the scan. `scan`: at every
    /// scan position; `auto`: that, but in windows at 0.94 of the image's Nyquist distance (0.28 A at 200 kV,
    /// 21 mrad), where that takes fewer probes
    #[arg(long, value_name = "A|scan|auto", default_value = "auto", value_parser = values::probe_step)]
    #[arg(allow_negative_numbers = true)]
    pub probe_step: ProbeStep,
    /// Windows: expand probes that share one in fewer waves, each right to so many per cent of its amplitude. `off`
    /// propagates every probe; `auto`: 1 % in 7.8 A, less in wider windows, where that takes fewer waves
    #[arg(long, value_name = "PERCENT|off|auto", default_value = "auto", value_parser = values::expansion)]
    #[arg(allow_negative_numbers = true)]
    pub expansion: Expansion,
    /// Where the probe has norm 1: in the cell, as is usual, though a small cell makes bright columns too bright
    /// (by 1 % in 20 A), or in a large box, as in an infinite specimen [default: cell; windows: large]
    #[arg(long, value_name = "NAME")]
    pub probe_box: Option<ProbeBoxName>,
    /// PRISM: keep exit waves on the grid of the simulation [default: on one that holds the band limit]
    #[arg(long)]
    pub full_exit_grid: bool,
    /// Windows and large boxes: leave out what the probe's tail outside would have scattered
    #[arg(long)]
    pub no_tail: bool,
}

impl NumericsArgs {
    /// The algorithm that the options stand for.
    pub fn algorithm(&self) -> anyhow::Result<Algorithm> {
        check_accuracy(self.accuracy, self.algorithm)?;
        if self.algorithm == Some(EngineName::Mosaic) {
            bail!(
                "--engine mosaic is for worlds (`stemgen build`); take window, prism or multislice"
            );
        }
        algorithm(
            self.algorithm,
            self.window,
            self.interpolation,
            EngineName::Multislice,
            WINDOW_ANGSTROM,
            [1, 1],
        )
    }
}

/// The algorithm `named`, or else the one that `--window` or `--interpolation` implies, or else
/// `default`. `factors` are the interpolation factors unless given.
pub fn algorithm(
    named: Option<EngineName>,
    window: Option<f64>,
    interpolation: Option<[usize; 2]>,
    default: EngineName,
    width_angstrom: f64,
    factors: [usize; 2],
) -> anyhow::Result<Algorithm> {
    let implied = match (window, interpolation) {
        (Some(_), _) => EngineName::Window,
        (None, Some(_)) => EngineName::Prism,
        (None, None) => named.unwrap_or(default),
    };
    let engine = named.unwrap_or(implied);
    if window.is_some() && !matches!(engine, EngineName::Window | EngineName::Mosaic) {
        bail!("--window belongs to the algorithm `window`, not to `{}`", name(engine));
    }
    if interpolation.is_some() && engine != EngineName::Prism {
        bail!("--interpolation belongs to the algorithm `prism`, not to `{}`", name(engine));
    }
    Ok(match engine {
        EngineName::Multislice => Algorithm::Multislice,
        EngineName::Prism => Algorithm::Prism { interpolation: interpolation.unwrap_or(factors) },
        EngineName::Window | EngineName::Mosaic => {
            Algorithm::Window { width_angstrom: window.unwrap_or(width_angstrom) }
        }
    })
}

fn name(engine: EngineName) -> &'static str {
    match engine {
        EngineName::Multislice => "multislice",
        EngineName::Prism => "prism",
        EngineName::Window => "window",
        EngineName::Mosaic => "mosaic",
    }
}

impl MicroscopeArgs {
    /// The source; `None` for a point.
    pub fn source(&self) -> Option<Source> {
        let lorentz_share = self.source_lorentz.unwrap_or_default();
        self.source_size.map(|fwhm_angstrom| Source { fwhm_angstrom, lorentz_share })
    }

    fn optics(&self, defocus: f64) -> Optics {
        let mut aberrations = Aberrations::defocus(defocus);
        aberrations.0.extend(self.aberration.iter().copied());
        Optics {
            energy_ev: self.energy * 1e3,
            semiangle_mrad: self.semiangle,
            aberrations,
            mistilt_mrad: self.tilt.unwrap_or_default(),
            focal_spread_angstrom: self.focal_spread.unwrap_or_default(),
            ..Optics::default()
        }
    }
}

/// Refuses an accuracy for engines that have no windows.
pub fn check_accuracy(accuracy: Option<f64>, engine: Option<EngineName>) -> anyhow::Result<()> {
    if accuracy.is_some() && !matches!(engine, None | Some(EngineName::Window | EngineName::Mosaic))
    {
        bail!("--accuracy chooses a window; leave out --engine, or take --engine window");
    }
    Ok(())
}

/// The settings of the engine for a scan.
pub fn settings(
    microscope: &MicroscopeArgs,
    numerics: &NumericsArgs,
    phonons: Option<Phonons>,
    thicknesses_angstrom: Vec<f64>,
) -> anyhow::Result<Settings> {
    let [defocus] = microscope.defocus.0[..] else {
        bail!("--defocus: a series is for `stemgen simulate`; give one value");
    };
    if microscope.source_size.is_some() {
        bail!("--source-size is for `stemgen simulate`; leave it out");
    }
    settings_at(defocus, microscope, numerics, phonons, thicknesses_angstrom)
}

/// The same for one value of a series of defocus, in Angstrom.
pub fn settings_at(
    defocus: f64,
    microscope: &MicroscopeArgs,
    numerics: &NumericsArgs,
    phonons: Option<Phonons>,
    thicknesses_angstrom: Vec<f64>,
) -> anyhow::Result<Settings> {
    let grid = match (numerics.sampling, numerics.gpts) {
        (_, Some(points)) => GridChoice::Points(points),
        (Some(sampling), None) => GridChoice::Sampling(sampling),
        (None, None) => GridChoice::Auto,
    };
    slips::check_aberrations(defocus, &microscope.aberration)?;
    let given = &microscope.detector;
    let default = Settings::default();
    Ok(Settings {
        optics: microscope.optics(defocus),
        detectors: if given.is_empty() { default.detectors.clone() } else { given.clone() },
        parametrization: numerics.parametrization.into(),
        projection: numerics.projection.into(),
        slicing: numerics.slice_thickness.map_or(Slicing::Planes, Slicing::Thickness),
        grid,
        algorithm: numerics.algorithm()?,
        probe_step: numerics.probe_step,
        expansion: numerics.expansion,
        angle_margin: numerics.angle_margin,
        probe_box: numerics.probe_box.map(Into::into),
        full_exit_grid: numerics.full_exit_grid,
        tail_correction: !numerics.no_tail,
        band_fraction: numerics.band_fraction.unwrap_or(DEFAULT_BAND_FRACTION),
        band_taper: numerics.band_taper,
        oversampling: numerics.oversampling,
        phonons,
        thicknesses_angstrom,
        beyond_limit: match microscope.allow_empty_angles {
            true => BeyondLimit::Warn,
            false => BeyondLimit::Error,
        },
        ..default
    })
}
