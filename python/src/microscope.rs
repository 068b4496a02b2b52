//! Options of the microscope, the engine and the scan.

use crate::errors::Fault;
use pyo3::prelude::*;
use stemgen::Setting;
use stemgen::detect::Detector;
use stemgen::engine::settings::DEFAULT_BAND_FRACTION;
use stemgen::engine::{
    Algorithm, BeyondLimit, Expansion, GridChoice, Phonons, ProbeBox, ProbeStep, Scan, Settings,
    Source,
};
use stemgen::optics::{Aberration, Aberrations, Optics};
use stemgen::potential::projected::Projection;
use stemgen::potential::scattering::Parametrization;
use stemgen::potential::slices::Slicing;
use stemgen_cli::shared as slips;

/// Window of `engine="window"` in Angstrom.
const WINDOW_ANGSTROM: f64 = 11.7;
/// Most probe positions accepted.
const MOST_PROBES: f64 = 1e9;

/// The microscope.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Microscope {
    energy_kv: f64,
    semiangle_mrad: f64,
    /// One image for each.
    pub defocus_angstrom: Vec<f64>,
    /// `C12=30@0.3`.
    aberrations: Vec<String>,
    tilt_mrad: [f64; 2],
    focal_spread_angstrom: f64,
    source_size_angstrom: Option<f64>,
    source_lorentz: f64,
    /// In the order of the images.
    detectors: Vec<(String, f64, f64)>,
    allow_empty_angles: bool,
}

/// A word or a number.
#[derive(FromPyObject)]
pub enum WordOrNumber {
    #[pyo3(transparent)]
    Number(f64),
    #[pyo3(transparent)]
    Word(String),
}

/// The engine.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Numerics {
    engine: Option<String>,
    pub accuracy_percent: Option<f64>,
    interpolation: Option<[usize; 2]>,
    window_angstrom: Option<f64>,
    sampling_angstrom: Option<f64>,
    gpts: Option<[usize; 2]>,
    slice_thickness_angstrom: Option<f64>,
    projection: String,
    parametrization: String,
    band_fraction: Option<f64>,
    band_taper: f64,
    oversampling: Option<usize>,
    angle_margin: f64,
    probe_step: WordOrNumber,
    expansion_percent: WordOrNumber,
    probe_box: Option<String>,
    full_exit_grid: bool,
    tail_correction: bool,
    pub thicknesses_angstrom: Vec<f64>,
}

/// Probe positions: a raster over a part of the simulated box.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct ScanOptions {
    start: [f64; 2],
    end: Option<[f64; 2]>,
    /// `cell`, `nm` or `angstrom`.
    unit: String,
    step_angstrom: Option<f64>,
    points: Option<[usize; 2]>,
}

fn refuse<T>(setting: Setting, value: impl ToString, expected: &str) -> Result<T, Fault> {
    Err(Fault::Value(setting, value.to_string(), expected.to_owned()))
}

/// The value of a word.
pub fn choice<T: Copy>(setting: Setting, word: &str, known: &[(&str, T)]) -> Result<T, Fault> {
    match known.iter().find(|(name, _)| *name == word) {
        Some((_, value)) => Ok(*value),
        None => {
            let names: Vec<String> = known.iter().map(|(name, _)| format!("\"{name}\"")).collect();
            refuse(setting, format!("\"{word}\""), &format!("choose one of {}", names.join(", ")))
        }
    }
}

impl Microscope {
    /// The source; `None` for a point.
    pub fn source(&self) -> Option<Source> {
        let lorentz_share = self.source_lorentz;
        self.source_size_angstrom.map(|fwhm_angstrom| Source { fwhm_angstrom, lorentz_share })
    }

    fn optics(&self, defocus: f64) -> Result<Optics, Fault> {
        if let Some(told) = slips::energy_in_ev(self.energy_kv) {
            return refuse(Setting::EnergyKev, self.energy_kv, &told);
        }
        if let Some(told) = slips::semiangle_in_radians(self.semiangle_mrad) {
            return refuse(Setting::SemiangleMrad, self.semiangle_mrad, &told);
        }
        if !defocus.is_finite() {
            return refuse(
                Setting::Aberration,
                format!("defocus {defocus}"),
                "expected a length in A",
            );
        }
        let mut aberrations = Aberrations::defocus(defocus);
        for text in &self.aberrations {
            let found = Aberration::parse(text)?;
            let same =
                |other: &Aberration| (other.order, other.symmetry) == (found.order, found.symmetry);
            if aberrations.0.iter().any(same) {
                return refuse(
                    Setting::Aberration,
                    text,
                    "is given twice (C10 is minus the defocus)",
                );
            }
            aberrations.0.push(found);
        }
        Ok(Optics {
            energy_ev: self.energy_kv * 1e3,
            semiangle_mrad: self.semiangle_mrad,
            aberrations,
            mistilt_mrad: self.tilt_mrad,
            focal_spread_angstrom: self.focal_spread_angstrom,
            ..Optics::default()
        })
    }

    /// What is possible, but hardly meant.
    pub fn doubts(&self) -> Vec<String> {
        let read = self.aberrations.iter().filter_map(|text| Aberration::parse(text).ok());
        read.filter_map(|aberration| slips::azimuth_in_degrees(&aberration)).collect()
    }

    fn detectors(&self) -> Result<Vec<Detector>, Fault> {
        let detector = |(name, inner, outer): &(String, f64, f64)| {
            let parsed = Detector::parse(&format!("{name}={inner}-{outer}"))?;
            match slips::detector_in_radians(name, [*inner, *outer]) {
                Some(told) => refuse(Setting::Detector, format!("{name} {inner}-{outer}"), &told),
                None => Ok(parsed),
            }
        };
        self.detectors.iter().map(detector).collect()
    }
}

impl Numerics {
    fn algorithm(&self) -> Result<Algorithm, Fault> {
        let implied = match (self.window_angstrom, self.interpolation) {
            (Some(_), _) => "window",
            (None, Some(_)) => "prism",
            (None, None) => "multislice",
        };
        let engine = self.engine.as_deref().unwrap_or(implied);
        if self.accuracy_percent.is_some()
            && !matches!(self.engine.as_deref(), None | Some("window"))
        {
            return refuse(
                Setting::AccuracyPercent,
                self.accuracy_percent.unwrap_or_default(),
                "chooses a window; leave the engine out, or take \"window\"",
            );
        }
        if let Some(width) = self.window_angstrom.filter(|_| engine != "window") {
            return refuse(Setting::WindowAngstrom, width, "belongs to the engine \"window\"");
        }
        if let Some([x, y]) = self.interpolation.filter(|_| engine != "prism") {
            return refuse(
                Setting::Interpolation,
                format!("{x}, {y}"),
                "belongs to the engine \"prism\"",
            );
        }
        let window =
            Algorithm::Window { width_angstrom: self.window_angstrom.unwrap_or(WINDOW_ANGSTROM) };
        let prism = Algorithm::Prism { interpolation: self.interpolation.unwrap_or([1, 1]) };
        let known = [("multislice", Algorithm::Multislice), ("prism", prism), ("window", window)];
        choice(Setting::Algorithm, engine, &known)
    }

    fn probe_step(&self) -> Result<ProbeStep, Fault> {
        match &self.probe_step {
            WordOrNumber::Number(step) if *step > 0.0 && step.is_finite() => {
                Ok(ProbeStep::Angstrom(*step))
            }
            WordOrNumber::Number(step) => {
                refuse(Setting::SampleStepAngstrom, step, "expected a length above 0")
            }
            WordOrNumber::Word(word) => {
                let known = [("auto", ProbeStep::Auto), ("scan", ProbeStep::Scan)];
                choice(Setting::SampleStepAngstrom, word, &known)
            }
        }
    }

    fn expansion(&self) -> Result<Expansion, Fault> {
        expansion(&self.expansion_percent)
    }
}

/// `auto`, `off` or per cent of an amplitude.
pub fn expansion(given: &WordOrNumber) -> Result<Expansion, Fault> {
    match given {
        WordOrNumber::Number(percent) if *percent > 0.0 && percent.is_finite() => {
            Ok(Expansion::Error(percent / 100.0))
        }
        WordOrNumber::Number(percent) => {
            refuse(Setting::ExpansionPercent, percent, "expected per cent above 0")
        }
        WordOrNumber::Word(word) => {
            let known = [("auto", Expansion::Auto), ("off", Expansion::Off)];
            choice(Setting::ExpansionPercent, word, &known)
        }
    }
}

/// The settings for one value of a series of defocus, in Angstrom.
pub fn settings(
    microscope: &Microscope,
    numerics: &Numerics,
    phonons: Option<Phonons>,
    defocus: f64,
) -> Result<Settings, Fault> {
    let grid = match (numerics.sampling_angstrom, numerics.gpts) {
        (Some(_), Some(_)) => {
            return refuse(Setting::Gpts, "given", "sampling and gpts both set the grid; give one");
        }
        (None, Some(points)) => GridChoice::Points(points),
        (Some(sampling), None) => GridChoice::Sampling(sampling),
        (None, None) => GridChoice::Auto,
    };
    let projections = [("infinite", Projection::Infinite), ("finite", Projection::Finite)];
    let tables = [
        ("lobato", Parametrization::Lobato),
        ("kirkland", Parametrization::Kirkland),
        ("peng", Parametrization::Peng),
    ];
    let boxes = [("cell", ProbeBox::Cell), ("large", ProbeBox::Large)];
    let probe_box = numerics.probe_box.as_deref();
    Ok(Settings {
        optics: microscope.optics(defocus)?,
        detectors: microscope.detectors()?,
        // No setting of the library is these words: a wrong one is a wrong algorithm.
        parametrization: choice(Setting::Algorithm, &numerics.parametrization, &tables)?,
        projection: choice(Setting::Algorithm, &numerics.projection, &projections)?,
        slicing: numerics.slice_thickness_angstrom.map_or(Slicing::Planes, Slicing::Thickness),
        grid,
        algorithm: numerics.algorithm()?,
        probe_step: numerics.probe_step()?,
        expansion: numerics.expansion()?,
        angle_margin: numerics.angle_margin,
        probe_box: probe_box.map(|word| choice(Setting::ProbeBox, word, &boxes)).transpose()?,
        full_exit_grid: numerics.full_exit_grid,
        tail_correction: numerics.tail_correction,
        band_fraction: numerics.band_fraction.unwrap_or(DEFAULT_BAND_FRACTION),
        band_taper: numerics.band_taper,
        oversampling: numerics.oversampling,
        phonons,
        thicknesses_angstrom: numerics.thicknesses_angstrom.clone(),
        beyond_limit: match microscope.allow_empty_angles {
            true => BeyondLimit::Warn,
            false => BeyondLimit::Error,
        },
        ..Settings::default()
    })
}

/// A unit of lengths (x, y) in Angstrom, for a box of `size`.
pub fn length_unit(word: &str, size: [f64; 2]) -> Result<[f64; 2], Fault> {
    let units = [("cell", size), ("nm", [10.0; 2]), ("angstrom", [1.0; 2]), ("A", [1.0; 2])];
    choice(Setting::Region, word, &units)
}

impl ScanOptions {
    /// The raster over a box of `size` (x, y) in Angstrom, and what is to be said of it.
    ///
    /// # Errors
    /// A scan that is empty, or much longer than the box.
    pub fn scan(&self, size: [f64; 2], optics: &Optics) -> Result<(Scan, Option<String>), Fault> {
        let unit = length_unit(&self.unit, size)?;
        let start = [0, 1].map(|k| self.start[k] * unit[k]);
        let end = self.end.map_or(size, |end| [0, 1].map(|k| end[k] * unit[k]));
        let window = [0, 1].map(|k| end[k] - start[k]);
        let told = || format!("from {start:?} to {end:?} A");
        if !window.iter().all(|w| *w > 0.0 && w.is_finite()) {
            return refuse(Setting::Region, told(), "the end lies right of and below the start");
        }
        let points = match (self.points, self.step_angstrom) {
            (Some(_), Some(_)) => {
                return refuse(
                    Setting::Region,
                    told(),
                    "step_angstrom and points both set the step; give one",
                );
            }
            (Some(points), None) => points.map(|n| n as f64),
            (None, step) => {
                // The coarsest step that samples an incoherent image: its band ends at twice the semiangle.
                let nyquist = optics.wavelength_angstrom() / (4e-3 * optics.semiangle_mrad);
                let step = step.unwrap_or(nyquist);
                if step.is_nan() || step <= 0.0 {
                    return refuse(
                        Setting::Region,
                        format!("step {step} A"),
                        "the distance of probes is above 0",
                    );
                }
                window.map(|w| (w / step - 1e-6).ceil().max(1.0))
            }
        };
        if !(1.0..=MOST_PROBES).contains(&(points[0] * points[1])) {
            let value = format!("{} x {} probes", points[0], points[1]);
            return refuse(Setting::Region, value, "between 1 and 1e9 are possible");
        }
        if (0..2).any(|k| window[k] > 2.0 * size[k] + 1e-6) {
            let expected = format!(
                "is more than twice as long as the box of {:.3} x {:.3} A, which repeats: nothing new is seen there; repeat=(nx, ny, nz) makes a larger one",
                size[0], size[1]
            );
            return refuse(Setting::Region, told(), &expected);
        }
        let scan = Scan {
            origin_angstrom: start,
            step_angstrom: [0, 1].map(|k| window[k] / points[k]),
            shape: [points[1] as usize, points[0] as usize],
        };
        let left = slips::check_scan(start, window, size).map_err(Fault::from)?;
        Ok((scan, left))
    }
}
