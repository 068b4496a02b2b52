//! Options of the microscope and of the engine: what is given goes into a request, which has the defaults.

use super::values::{
    self, EngineName, NumberSeries, ParametrizationName, ProbeBoxName, ProjectionName,
};
use anyhow::bail;
use clap::Args;
use stemgen::detect::Detector;
use stemgen::engine::{Expansion, Phonons, ProbeStep, Settings};
use stemgen::optics::Aberration;
use stemgen::simulation::{Engine, MicroscopeRequest, NumericsRequest};

/// The microscope.
#[derive(Debug, Args)]
#[command(next_help_heading = "Microscope")]
pub struct MicroscopeArgs {
    /// Beam energy in keV (the accelerating voltage in kV) [default: 200]
    #[arg(long, value_name = "KV", value_parser = values::energy, allow_negative_numbers = true)]
    pub energy: Option<f64>,
    /// Convergence semiangle; the objective aperture with --plane-wave [default: 21]
    #[arg(long, value_name = "MRAD", value_parser = values::semiangle, allow_negative_numbers = true)]
    pub semiangle: Option<f64>,
    /// Defocus from the entrance surface of the box (z = 0), where the focus lies by default; positive is
    /// underfocus, with the focus deeper in the specimen
    /// `simulate` takes a series, START:END:STEP, and makes an image for each value [default: 0]
    #[arg(long, value_name = "A", value_parser = values::series, allow_hyphen_values = true)]
    pub defocus: Option<NumberSeries>,
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
    /// How probes are propagated [default: the fastest way that keeps --accuracy]
    #[arg(long = "engine", visible_alias = "algorithm", value_name = "NAME")]
    pub algorithm: Option<EngineName>,
    /// Take the narrowest window whose error is at most so many per cent of the mean image (rms), measured beforehand
    /// on a sample of probes; where no window saves time, the exact engine [default: 0.5, unless an engine is named]
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
    /// How an atom is distributed over slices [default: infinite]
    #[arg(long, value_name = "NAME")]
    pub projection: Option<ProjectionName>,
    /// Table of scattering factors [default: lobato]
    #[arg(long, value_name = "NAME")]
    pub parametrization: Option<ParametrizationName>,
    /// Radius of the anti-aliasing disk, in units of Nyquist [default: 0.8; 2/3 excludes
    /// aliasing altogether]
    #[arg(long, value_name = "F", value_parser = values::finite, allow_negative_numbers = true)]
    pub band_fraction: Option<f64>,
    /// Width of the soft edge inside that disk, in units of Nyquist [default: 0]
    #[arg(long, value_name = "F", value_parser = values::finite, allow_negative_numbers = true)]
    pub band_taper: Option<f64>,
    /// Exponentiate potentials on a grid so many times finer [default: smoothed potentials, with the
    /// cores of the atoms put back in closed form]
    #[arg(long, value_name = "N")]
    pub oversampling: Option<usize>,
    /// The grid carries so many times the outermost detector angle [default: 1.2]
    #[arg(long, value_name = "F", value_parser = values::finite, allow_negative_numbers = true)]
    pub angle_margin: Option<f64>,
    /// How far apart probes are propagated, in A, at most; images are interpolated to the scan. `scan`: at every
    /// scan position; `auto`: with an --engine that, but in windows at 0.94 of the image's Nyquist distance (0.28 A at
    /// 200 kV, 21 mrad); without, at 0.84 of it; where that takes fewer probes [default: auto]
    #[arg(long, value_name = "A|scan|auto", value_parser = values::probe_step, allow_negative_numbers = true)]
    pub probe_step: Option<ProbeStep>,
    /// Windows: expand probes that share one in fewer waves, each right to so many per cent of its amplitude. `off`
    /// propagates every probe; `auto`: 1 % in 7.8 A, less in wider windows, where that takes fewer waves
    /// [default: auto]
    #[arg(long, value_name = "PERCENT|off|auto", value_parser = values::expansion, allow_negative_numbers = true)]
    pub expansion: Option<Expansion>,
    /// Where the probe has norm 1: in the cell, as is usual, though a small cell makes bright columns too bright
    /// (by 1 % in 20 A), or in a large box, as in an infinite specimen [default: large; with the engines multislice and
    /// prism: cell]
    #[arg(long, value_name = "NAME")]
    pub probe_box: Option<ProbeBoxName>,
    /// PRISM: keep exit waves on the grid of the simulation [default: on one that holds the band limit]
    #[arg(long)]
    pub full_exit_grid: bool,
    /// Windows and large boxes: leave out what the probe's tail outside would have scattered
    #[arg(long)]
    pub no_tail: bool,
}

/// Puts a value that is given in the place of another.
fn put<T: Clone>(given: &Option<T>, to: &mut T) {
    if let Some(given) = given {
        to.clone_from(given);
    }
}

/// Puts a value that is given in the place of another, or of none.
pub fn put_some<T: Clone>(given: &Option<T>, to: &mut Option<T>) {
    if given.is_some() {
        to.clone_from(given);
    }
}

impl MicroscopeArgs {
    /// Puts what is given into a request.
    pub fn apply(&self, to: &mut MicroscopeRequest) {
        put(&self.energy, &mut to.energy_kev);
        put(&self.semiangle, &mut to.semiangle_mrad);
        put(&self.defocus.as_ref().map(|series| series.0.clone()), &mut to.defocus_angstrom);
        put(&Some(&self.aberration).filter(|a| !a.is_empty()).cloned(), &mut to.aberrations);
        put(&self.tilt, &mut to.tilt_mrad);
        put(&self.focal_spread, &mut to.focal_spread_angstrom);
        put_some(&self.source_size, &mut to.source_size_angstrom);
        put(&self.source_lorentz, &mut to.source_lorentz_share);
        put(&Some(&self.detector).filter(|d| !d.is_empty()).cloned(), &mut to.detectors);
        to.allow_empty_angles |= self.allow_empty_angles;
    }
}

impl NumericsArgs {
    /// Puts what is given into a request; what excludes it is taken out there.
    pub fn apply(&self, to: &mut NumericsRequest) -> anyhow::Result<()> {
        put_some(&self.algorithm.map(simulation_engine).transpose()?, &mut to.engine);
        if self.accuracy.is_some() {
            (to.window_angstrom, to.interpolation) = (None, None);
        }
        if self.window.is_some() || self.interpolation.is_some() {
            (to.window_angstrom, to.interpolation, to.accuracy_percent) = (None, None, None);
        }
        put_some(&self.accuracy, &mut to.accuracy_percent);
        put_some(&self.interpolation, &mut to.interpolation);
        put_some(&self.window, &mut to.window_angstrom);
        if self.sampling.is_some() || self.gpts.is_some() {
            (to.sampling_angstrom, to.gpts) = (self.sampling, self.gpts);
        }
        put_some(&self.slice_thickness, &mut to.slice_thickness_angstrom);
        put(&self.projection.map(Into::into), &mut to.projection);
        put(&self.parametrization.map(Into::into), &mut to.parametrization);
        put(&self.band_fraction, &mut to.band_fraction);
        put(&self.band_taper, &mut to.band_taper);
        put_some(&self.oversampling, &mut to.oversampling);
        put(&self.angle_margin, &mut to.angle_margin);
        put(&self.probe_step, &mut to.probe_step);
        put(&self.expansion, &mut to.expansion);
        put_some(&self.probe_box.map(Into::into), &mut to.probe_box);
        to.full_exit_grid |= self.full_exit_grid;
        to.tail_correction &= !self.no_tail;
        Ok(())
    }
}

/// The engine of a simulation; that of worlds is none.
fn simulation_engine(name: EngineName) -> anyhow::Result<Engine> {
    match name {
        EngineName::Multislice => Ok(Engine::Multislice),
        EngineName::Prism => Ok(Engine::Prism),
        EngineName::Window => Ok(Engine::Window),
        EngineName::Mosaic => bail!(
            "--engine mosaic is for worlds (`stemgen build`); take window, prism or multislice"
        ),
    }
}

/// The settings of the engine for an image of one defocus and a point source.
pub fn settings(
    microscope: &MicroscopeArgs,
    numerics: &NumericsRequest,
    phonons: Option<Phonons>,
) -> anyhow::Result<Settings> {
    let mut request = MicroscopeRequest::default();
    microscope.apply(&mut request);
    request.check()?;
    let [defocus] = request.defocus_angstrom[..] else {
        bail!("--defocus: a series is for `stemgen simulate`; give one value");
    };
    if request.source_size_angstrom.is_some() {
        bail!("--source-size is for `stemgen simulate`; leave it out");
    }
    Ok(numerics.settings(&request, defocus, phonons, Vec::new())?)
}
