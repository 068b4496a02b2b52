//! Options of the microscope and of the engine. Given options go into a request, which holds the defaults.

use super::values::{
    self, DetectorGroup, EngineName, NumberSeries, ParametrizationName, ProbeBoxName,
    ProjectionName,
};
use anyhow::bail;
use clap::Args;
use stemgen::detect::Detector;
use stemgen::engine::{Expansion, Phonons, ProbeStep, Settings};
use stemgen::optics::Aberration;
use stemgen::simulation::{Engine, MicroscopeRequest, NumericsRequest};

/// Holds the options of the microscope.
#[derive(Debug, Args)]
#[command(next_help_heading = "Microscope")]
pub struct MicroscopeArgs {
    /// Beam energy in keV, the accelerating voltage in kV [default: 200]
    #[arg(long, value_name = "KV", value_parser = values::energy, allow_negative_numbers = true)]
    pub energy: Option<f64>,
    /// Convergence semiangle in mrad; with --plane-wave, the semiangle of the objective aperture [default: 21]
    #[arg(long, value_name = "MRAD", value_parser = values::semiangle, allow_negative_numbers = true)]
    pub semiangle: Option<f64>,
    /// Defocus in A, from the entrance surface of the box (z = 0). Positive is underfocus: the focus lies deeper in the specimen.
    /// `simulate` and `patterns` also take a series, START:END:STEP, END included [default: 0]
    #[arg(long, value_name = "A", value_parser = values::series, allow_hyphen_values = true)]
    pub defocus: Option<NumberSeries>,
    /// Aberration coefficient in A, with its azimuth in rad: C12=30@0.3, C30=1e5 (repeatable)
    #[arg(long, value_name = "Cnm=A[@RAD]", value_parser = values::aberration)]
    pub aberration: Vec<Aberration>,
    /// Mistilt of the specimen in mrad, each up to 20. The beam runs along (tan X, tan Y, 1) of the box [default: 0,0]
    #[arg(long, value_name = "X,Y", value_parser = values::point, allow_hyphen_values = true)]
    pub tilt: Option<[f64; 2]>,
    /// Focal spread: average images over a Gaussian distribution of the focus with this standard deviation, in A. It is
    /// C_c dE / E, with the standard deviation dE of the energy [default: 0]
    #[arg(long, value_name = "A", value_parser = values::finite, allow_negative_numbers = true)]
    pub focal_spread: Option<f64>,
    /// Width of the electron source in A, the full width at half maximum of a Gaussian; 0.7 to 1.0 is usual [default: a point]
    #[arg(long, value_name = "A", value_parser = values::positive, allow_negative_numbers = true)]
    pub source_size: Option<f64>,
    /// Share of the source, from 0 to 1, that has a Lorentz profile of equal width (long tails) in place of the Gaussian; for
    /// images only [default: 0]
    #[arg(long, value_name = "SHARE", value_parser = values::finite, allow_negative_numbers = true)]
    #[arg(requires = "source_size")]
    pub source_lorentz: Option<f64>,
    /// Annular detector with its inner and outer angle in mrad, such as BF=0-20, ABF=10-20, ADF=40-100 (repeatable). With :N it
    /// is divided into N equal sectors, NAME_0, NAME_1, ...; the first begins at DEGREES, from +x towards +y (DPC=0-21:4@45).
    /// With :com it gives the mean angle of its electrons in mrad, the centre of mass: images NAME_x and NAME_y (COM=0-50:com)
    /// [default: HAADF=68-200]
    #[arg(long, value_name = "NAME=IN-OUT[:N[@DEGREES]|:com]", value_parser = values::detector)]
    pub detector: Vec<DetectorGroup>,
    /// Continue if a detector reaches beyond the angles that the grid carries; that part of it stays empty
    #[arg(long)]
    pub allow_empty_angles: bool,
}

/// Holds the options of the engine.
#[derive(Debug, Args)]
#[command(next_help_heading = "Numerics")]
pub struct NumericsArgs {
    /// How probes are propagated [default: the fastest way within --accuracy]
    #[arg(long = "engine", visible_alias = "algorithm", value_name = "NAME")]
    pub algorithm: Option<EngineName>,
    /// Largest error, in per cent of the mean image (rms). The program measures it on a sample of probes, and takes the narrowest
    /// window within it; if no window saves time, the exact engine [default: 0.5, unless --engine is given]
    #[arg(long, value_name = "PERCENT", value_parser = values::percent, allow_negative_numbers = true)]
    #[arg(conflicts_with_all = ["window", "interpolation"])]
    pub accuracy: Option<f64>,
    /// Interpolation factor of PRISM, or one for x and one for y [default: 1]
    #[arg(long, value_name = "F[,FY]", value_parser = values::factors, conflicts_with = "window")]
    pub interpolation: Option<[usize; 2]>,
    /// Width in A of the window, the small box around each probe in which the probe is propagated [default: 11.7]
    #[arg(long, value_name = "A", value_parser = values::finite, allow_negative_numbers = true)]
    pub window: Option<f64>,
    /// Largest pixel of the grid in A [default: a grid that carries the outermost detector angle times --angle-margin]
    #[arg(long, value_name = "A", value_parser = values::finite, allow_negative_numbers = true)]
    #[arg(conflicts_with = "gpts")]
    pub sampling: Option<f64>,
    /// Grid points along x and y, in place of --sampling
    #[arg(long, value_name = "NX,NY", value_parser = values::counts2)]
    pub gpts: Option<[usize; 2]>,
    /// Largest thickness of slices in A; all slices are then equally thick [default: one slice for each atomic plane; without
    /// planes, atoms within 0.35 A share a slice in windows, and within 0.5 A with --engine multislice or prism]
    #[arg(long, value_name = "A", value_parser = values::finite, allow_negative_numbers = true)]
    pub slice_thickness: Option<f64>,
    /// How an atom is distributed over slices [default: infinite]
    #[arg(long, value_name = "NAME")]
    pub projection: Option<ProjectionName>,
    /// Parametrization of the scattering factors [default: lobato]
    #[arg(long, value_name = "NAME")]
    pub parametrization: Option<ParametrizationName>,
    /// Radius of the anti-aliasing disk, as a fraction of the Nyquist frequency [default: 0.8; 2/3 excludes all aliasing]
    #[arg(long, value_name = "F", value_parser = values::finite, allow_negative_numbers = true)]
    pub band_fraction: Option<f64>,
    /// Width of the soft edge inside the anti-aliasing disk, as a fraction of the Nyquist frequency [default: 0]
    #[arg(long, value_name = "F", value_parser = values::finite, allow_negative_numbers = true)]
    pub band_taper: Option<f64>,
    /// Exponentiate potentials on a grid that is N times finer [default: smoothed potentials, whose atomic cores are added in
    /// closed form]
    #[arg(long, value_name = "N")]
    pub oversampling: Option<usize>,
    /// Largest angle that the grid carries, as a multiple of the outermost detector angle [default: 1.2]
    #[arg(long, value_name = "F", value_parser = values::finite, allow_negative_numbers = true)]
    pub angle_margin: Option<f64>,
    /// Largest distance in A between propagated probes, from which images are interpolated to the scan. `scan` propagates every
    /// scan position. `auto` takes 0.84 of the image's Nyquist distance (which is 0.3 A at 200 kV, 21 mrad), 0.94 of it with
    /// --engine window, and every position with another --engine or if interpolation saves no probes [default: auto]
    #[arg(long, value_name = "A|scan|auto", value_parser = values::probe_step, allow_negative_numbers = true)]
    pub probe_step: Option<ProbeStep>,
    /// In windows: expand the probes that share a window in fewer waves, and propagate only these waves. The value is the error
    /// of each probe, in per cent of its amplitude. `auto` takes 1 % in 7.8 A and less in wider windows, if that saves waves;
    /// `off` propagates every probe [default: auto]
    #[arg(long, value_name = "PERCENT|off|auto", value_parser = values::expansion, allow_negative_numbers = true)]
    pub expansion: Option<Expansion>,
    /// Box in which the probe has norm 1. A small cell folds the tails of the probe back: images are too bright by
    /// wavelength / (3 semiangle L) in a cell of width L, 2 % in 20 A (200 kV, 21 mrad). A large box acts as an infinite
    /// specimen [default: large; cell with --engine multislice or prism, and without --engine in cells narrower than 15 A]
    #[arg(long, value_name = "NAME")]
    pub probe_box: Option<ProbeBoxName>,
    /// With PRISM: keep exit waves on the grid of the simulation [default: on a coarser grid that holds the band limit]
    #[arg(long)]
    pub full_exit_grid: bool,
    /// Leave out the tail, the part of the probe outside its window or cell: its scattering, and its wave on detectors at low angles
    #[arg(long)]
    pub no_tail: bool,
}

/// Replaces a value if another is given.
fn put<T: Clone>(given: &Option<T>, to: &mut T) {
    if let Some(given) = given {
        to.clone_from(given);
    }
}

/// Replaces an optional value if another is given.
pub fn put_some<T: Clone>(given: &Option<T>, to: &mut Option<T>) {
    if given.is_some() {
        to.clone_from(given);
    }
}

impl MicroscopeArgs {
    /// Puts the given options into a request.
    pub fn apply(&self, to: &mut MicroscopeRequest) {
        put(&self.energy, &mut to.energy_kev);
        put(&self.semiangle, &mut to.semiangle_mrad);
        put(&self.defocus.as_ref().map(|series| series.0.clone()), &mut to.defocus_angstrom);
        put(&Some(&self.aberration).filter(|a| !a.is_empty()).cloned(), &mut to.aberrations);
        put(&self.tilt, &mut to.tilt_mrad);
        put(&self.focal_spread, &mut to.focal_spread_angstrom);
        put_some(&self.source_size, &mut to.source_size_angstrom);
        put(&self.source_lorentz, &mut to.source_lorentz_share);
        let detectors: Vec<Detector> = self.detector.iter().flat_map(|d| d.0.clone()).collect();
        put(&Some(detectors).filter(|d| !d.is_empty()), &mut to.detectors);
        to.allow_empty_angles |= self.allow_empty_angles;
    }
}

impl NumericsArgs {
    /// Puts the given options into a request, and removes settings of the request that exclude them.
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

/// Returns the engine of a simulation. Mosaics are for worlds only.
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

/// Returns the settings of the engine for an image of one defocus and a point source.
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
