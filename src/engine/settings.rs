//! Settings of a simulation.

use crate::detect::Detector;
use crate::error::{Error, Result};
use crate::optics::Optics;
use crate::potential::projected::Projection;
use crate::potential::scattering::Parametrization;
use crate::potential::slices::Slicing;
use serde::{Deserialize, Serialize};

/// The algorithm.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "name", rename_all = "lowercase")]
#[non_exhaustive]
pub enum Algorithm {
    /// Each probe is propagated on the full grid: exact.
    Multislice,
    /// Plane waves are propagated and probes are put together from every `interpolation[i]`-th of
    /// them along axis i (x, y), in a window of extent / interpolation. Exact for [1, 1]
    /// (C. Ophus, Adv. Struct. Chem. Imaging 3 (2017) 13).
    Prism {
        /// Interpolation factors along x and y.
        interpolation: [usize; 2],
    },
    /// Each probe is propagated in a small window of the specimen that follows it, on a coarser grid
    /// that holds just the band limit.
    Window {
        /// Edge of the window in Angstrom.
        width_angstrom: f64,
    },
}

impl std::fmt::Display for Algorithm {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Algorithm::Multislice => f.write_str("multislice"),
            Algorithm::Prism { interpolation: [x, y] } => write!(f, "PRISM, interpolation {x},{y}"),
            Algorithm::Window { width_angstrom } => {
                write!(f, "window of {} A", (width_angstrom * 100.0).round() / 100.0)
            }
        }
    }
}

/// How fine the grid is.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum GridChoice {
    /// The coarsest fast grid that carries scattering to 1.2 times the outermost detector angle:
    /// beams beyond the detector scatter back onto it (2 % of a Ti-O column at 39 A).
    Auto,
    /// At most this many Angstrom per pixel.
    Sampling(f64),
    /// Exactly this many points along (x, y).
    Points([usize; 2]),
}

/// Factor of the angle that automatic grids carry, over the outermost detector angle.
pub(crate) const AUTO_ANGLE_MARGIN: f64 = 1.2;

/// Smallest inner angle of a detector for windows, in semiangles. At smaller angles the pixels of a window's diffraction pattern are too
/// coarse, and detectors would see the tail of the probe directly.
pub(super) const LEAST_INNER_SEMIANGLES: f64 = 2.0;

/// Whether a detector begins at angles so low that it sees the tail of a probe itself.
pub(crate) fn sees_tail(detector: &Detector, optics: &Optics) -> bool {
    detector.inner_mrad < LEAST_INNER_SEMIANGLES * optics.semiangle_mrad
}

/// Where the probe has norm 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum ProbeBox {
    /// In the simulated cell, as is usual. The tails of the probe are folded back into the cell, so that images are too
    /// bright: the middle of the probe by the fraction `wavelength / (3 semiangle L)` in a cell of width L, which is 2 % for
    /// 20 A at 200 kV and 21 mrad (bright columns are then 1.1 % brighter than in a cell of 39 A).
    Cell,
    /// In a large box, from which it is cropped, as in an infinite specimen. Scattering of its tail outside the cell is added
    /// as from free atoms.
    Large,
}

/// What to do with a detector beyond the band limit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum BeyondLimit {
    /// Refuse.
    Error,
    /// Go on, with a warning that says how much of the annulus is empty.
    Warn,
}

/// Where probes are propagated.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum ProbeStep {
    /// At every scan position.
    Scan,
    /// In windows, at 0.94 of the Nyquist distance of the image (0.28 A at 200 kV, 21 mrad) where that takes fewer
    /// probes, from which the scan is interpolated: rms errors are below 0.1 % of the image's contrast.
    /// At every scan position otherwise.
    Auto,
    /// At most so many Angstrom apart, where that takes fewer probes, with any algorithm; at most the
    /// Nyquist distance. The errors are in `resample.rs`.
    Angstrom(f64),
}

/// Whether probes that share a window are expanded in fewer waves, and only these waves propagated (see the source of
/// `engine::basis`).
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Expansion {
    /// If it takes fewer waves. The error of each probe is 1 % of its amplitude in windows of up to 7.8 A, and falls with the
    /// cube of the width in wider ones. An error of 1 % changes HAADF images by 0.2 % of their mean.
    #[default]
    Auto,
    /// Every probe is propagated.
    Off,
    /// As `Auto`, with this error as a share of each probe's amplitude.
    Error(f64),
}

impl Expansion {
    fn is_auto(&self) -> bool {
        *self == Expansion::Auto
    }
}

/// Frozen phonons.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Phonons {
    /// Number of configurations averaged.
    pub configurations: u32,
    /// Seed of the displacements.
    pub seed: u64,
}

/// All inputs of a simulation except the atoms and the probe positions.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// Probe-forming optics.
    pub optics: Optics,
    /// Detectors, all collected in one pass.
    pub detectors: Vec<Detector>,
    /// Scattering factors.
    pub parametrization: Parametrization,
    /// Infinite or finite projection.
    pub projection: Projection,
    /// Slices.
    pub slicing: Slicing,
    /// Grid.
    pub grid: GridChoice,
    /// On grids that the program chooses, the band limit is this many times the outermost detector
    /// angle: scattering beyond the detector that comes back to it is then carried.
    pub angle_margin: f64,
    /// Algorithm.
    pub algorithm: Algorithm,
    /// Box in which the probe has norm 1; `None`: a large box with windows, the cell with the other algorithms.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub probe_box: Option<ProbeBox>,
    /// Keeps the exit waves of PRISM on the grid of the simulation, not on the coarser one that just holds the band limit. Without
    /// interpolation both give equal images. With it, probes are cut out at pixels of that grid, and high angles that the cut adds are
    /// folded back at its limit: HAADF of Si \[110\] with f = 2 changes by up to 0.20 % of the maximum, HAADF of SrTiO3 by 0.02 %.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub full_exit_grid: bool,
    /// Distance of the propagated probes.
    pub probe_step: ProbeStep,
    /// Whether probes that share a window are expanded in fewer waves.
    #[serde(default, skip_serializing_if = "Expansion::is_auto")]
    pub expansion: Expansion,
    /// Adds the intensity that the part of a probe outside its window would have scattered onto the detectors (windows and large boxes), as
    /// from free atoms; see the source of `engine::probe_tail`.
    pub tail_correction: bool,
    /// Where tails are corrected, adds the wave of the cropped part of a probe for detectors that begin within two semiangles (windows:
    /// `engine::coherent_tail`), or scales images on detectors that see the direct beam so that vacuum is right (large boxes:
    /// `engine::direct_beam`). `Settings::default` has it off.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub direct_beam: bool,
    /// Radius of the anti-aliasing aperture in units of the Nyquist frequency. 2/3
    /// ([`EXACT_BAND_FRACTION`]) excludes aliasing altogether; since transmission functions are
    /// band-limited beforehand, [`DEFAULT_BAND_FRACTION`] changes HAADF by less than 0.1 % on the
    /// default grid. Where the limit is as low as the detector's edge, 0.83 changed it by 0.4 %.
    pub band_fraction: f64,
    /// Width of the soft edge inside the anti-aliasing aperture, in units of the Nyquist frequency; 0 for
    /// a hard edge. abTEM has 0.02. Detectors have to end below it.
    pub band_taper: f64,
    /// `None`: potentials are smoothed before `exp(i sigma V)`, and the cores of the atoms added in closed form
    /// (`potential/cores.rs`). Where that does not apply (finite projection, heavy atoms on top of each
    /// other in one slice), it is a number that makes the grid finer than 0.0125 A.
    ///
    /// A number: potentials are exponentiated on a grid finer by this factor along each axis, then the band is limited.
    /// With 1, as in abTEM, the exponential is aliased: the HAADF of heavy columns is 1-4 % too high at 0.02-0.04 A.
    pub oversampling: Option<usize>,
    /// Places atoms as abTEM 1.0.11 does with infinite projection: each is spread bilinearly over the four grid points
    /// around it, then potentials are multiplied by `u / sin u`, `u` = spatial frequency times pixel. The factor does not undo
    /// the spread: high angles lose up to half their amplitude for atoms between grid points and gain a little for atoms on grid points.
    /// Use it to reproduce abTEM's images, with `oversampling` 1 and abTEM's grid.
    pub abtem_placement: bool,
    /// Phonons; `None`: atoms stay at the given positions.
    pub phonons: Option<Phonons>,
    /// Thicknesses in Angstrom at which images are recorded, each moved to the nearest slice
    /// boundary; empty: at the exit surface only.
    pub thicknesses_angstrom: Vec<f64>,
    /// Treatment of detectors beyond the band limit.
    pub beyond_limit: BeyondLimit,
}

/// Largest interpolation factor: the grid has multiples of it as points.
const MOST_INTERPOLATION: usize = 1024;
/// Default sampling of the potentials in Angstrom.
pub(crate) const POTENTIAL_SAMPLING_ANGSTROM: f64 = 0.0125;
/// The exact anti-aliasing limit (Kirkland 2010, sec. 6.8).
pub const EXACT_BAND_FRACTION: f64 = 2.0 / 3.0;
/// Default anti-aliasing limit: grids are 1.44 times smaller, for an error below 0.1 %.
pub const DEFAULT_BAND_FRACTION: f64 = 0.8;

impl Default for Settings {
    /// 200 kV, 21 mrad, HAADF 68-200 mrad, plain multislice, no phonons.
    fn default() -> Self {
        Settings {
            optics: Optics::default(),
            detectors: vec![Detector::new("HAADF", 68.0, 200.0)],
            parametrization: Parametrization::default(),
            projection: Projection::default(),
            slicing: Slicing::default(),
            grid: GridChoice::Auto,
            angle_margin: AUTO_ANGLE_MARGIN,
            algorithm: Algorithm::Multislice,
            probe_box: None,
            full_exit_grid: false,
            probe_step: ProbeStep::Auto,
            expansion: Expansion::Auto,
            tail_correction: true,
            direct_beam: false,
            band_fraction: DEFAULT_BAND_FRACTION,
            band_taper: 0.0,
            oversampling: None,
            abtem_placement: false,
            phonons: None,
            thicknesses_angstrom: Vec::new(),
            beyond_limit: BeyondLimit::Error,
        }
    }
}

impl Settings {
    /// Checks all limits that do not depend on the specimen.
    ///
    /// # Errors
    /// [`Error::Invalid`] naming the setting and its limits.
    pub(crate) fn validate(&self) -> Result<()> {
        self.optics.validate()?;
        if !(1.0..=3.0).contains(&self.angle_margin) {
            return Err(Error::invalid(
                crate::Setting::AngleMargin,
                self.angle_margin,
                "must be from 1 to 3",
            ));
        }
        if self.detectors.is_empty() {
            return Err(Error::invalid(crate::Setting::Detectors, "none", "give at least one"));
        }
        for (i, d) in self.detectors.iter().enumerate() {
            if !(d.inner_mrad >= 0.0 && d.outer_mrad > d.inner_mrad && d.outer_mrad.is_finite()) {
                let value = format!("{} = {}-{} mrad", d.name, d.inner_mrad, d.outer_mrad);
                return Err(Error::invalid(
                    crate::Setting::Detector,
                    value,
                    "needs 0 <= inner < outer",
                ));
            }
            if d.sector_degrees.is_some() {
                d.validate()?;
            }
            if !d.is_measured() {
                let expected = "is made of several measured images; replace it by those of `Detector::measured`";
                return Err(Error::invalid(crate::Setting::Detector, &d.name, expected));
            }
            if self.detectors[..i].iter().any(|e| e.name == d.name) {
                return Err(Error::invalid(crate::Setting::DetectorName, &d.name, "is used twice"));
            }
        }
        if !(0.1..=0.95).contains(&self.band_fraction) {
            let expected = "must be between 0.1 and 0.95; 2/3 excludes aliasing";
            return Err(Error::invalid(crate::Setting::BandFraction, self.band_fraction, expected));
        }
        if !(0.0..0.5 * self.band_fraction).contains(&self.band_taper) {
            let expected = "must be at least 0 and below half the band fraction";
            return Err(Error::invalid(crate::Setting::BandTaper, self.band_taper, expected));
        }
        if let Expansion::Error(e) = self.expansion
            && !(1e-5..=0.1).contains(&e)
        {
            let expected = "must be from 0.001 to 10 % of a probe's amplitude, or `off`";
            return Err(Error::invalid(crate::Setting::ExpansionPercent, 100.0 * e, expected));
        }
        if let Some(n) = self.oversampling
            && !(1..=8).contains(&n)
        {
            return Err(Error::invalid(crate::Setting::Oversampling, n, "must be between 1 and 8"));
        }
        if let Some(p) = self.phonons
            && !(1..1 << 20).contains(&p.configurations)
        {
            let expected = "must be at least 1 and below 2^20";
            return Err(Error::invalid(
                crate::Setting::PhononConfigurations,
                p.configurations,
                expected,
            ));
        }
        match self.algorithm {
            Algorithm::Prism { .. } if self.large_probe_box() => {
                let expected =
                    "PRISM makes probes in the cell; use the engine multislice or window";
                Err(Error::invalid(crate::Setting::ProbeBox, "large", expected))
            }
            Algorithm::Prism { interpolation: [fx, fy] }
                if [fx, fy].iter().any(|f| !(1..=MOST_INTERPOLATION).contains(f)) =>
            {
                let value = format!("{fx},{fy}");
                Err(Error::invalid(
                    crate::Setting::Interpolation,
                    value,
                    format!("factors must be from 1 to {MOST_INTERPOLATION}"),
                ))
            }
            // In a box wider than the cell, a probe that is made in the cell occurs several times.
            Algorithm::Window { .. } if !self.large_probe_box() && self.reads_tail_in_windows() => {
                let expected = "windows need the probe of a large box for detectors that begin within two semiangles; use `large`, or multislice";
                Err(Error::invalid(crate::Setting::ProbeBox, "cell", expected))
            }
            Algorithm::Window { width_angstrom: w } if !(2.0..1000.0).contains(&w) => {
                Err(Error::invalid(
                    crate::Setting::WindowAngstrom,
                    w,
                    "must be between 2 and 1000; 11.7 is usual",
                ))
            }
            _ => Ok(()),
        }
    }

    /// Whether probes are made in a box larger than the cell.
    pub(crate) fn large_probe_box(&self) -> bool {
        let windows = matches!(self.algorithm, Algorithm::Window { .. });
        self.probe_box.map_or(windows, |b| b == ProbeBox::Large)
    }

    /// Whether any detector reads the part of a probe outside its window, if these settings use windows.
    pub(super) fn reads_tail_in_windows(&self) -> bool {
        self.detectors.iter().any(|detector| self.reads_tail(detector))
    }

    /// Whether a detector reads the part of a probe outside its window, if these settings use windows.
    pub(super) fn reads_tail(&self, detector: &Detector) -> bool {
        sees_tail(detector, &self.optics) && self.tail_correction && self.direct_beam
    }

    /// Number of phonon configurations simulated.
    pub(crate) fn configurations(&self) -> u32 {
        self.phonons.map_or(1, |p| p.configurations)
    }
}
