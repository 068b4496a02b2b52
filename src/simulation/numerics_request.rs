//! Numerical settings of a request: engine, grid, slices and probes.

use serde::{Deserialize, Serialize};

use super::microscope::MicroscopeRequest;
use crate::detect::Detector;
use crate::engine::settings::{AUTO_ANGLE_MARGIN, DEFAULT_BAND_FRACTION};
use crate::engine::{
    Algorithm, BeyondLimit, Expansion, GridChoice, Phonons, ProbeBox, ProbeStep, Settings,
};
use crate::error::{Error, Result};
use crate::potential::projected::Projection;
use crate::potential::scattering::Parametrization;
use crate::potential::slices::Slicing;
use crate::setting::Setting;

/// Default width in Angstrom of the window that follows each probe.
pub(crate) const WINDOW_ANGSTROM: f64 = 11.7;

/// How probes are propagated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Engine {
    /// Every probe on the full grid: exact.
    Multislice,
    /// Probes put together from plane waves; exact with an interpolation of 1.
    Prism,
    /// Every probe in a small window that follows it.
    Window,
}

impl Engine {
    fn name(self) -> &'static str {
        match self {
            Engine::Multislice => "multislice",
            Engine::Prism => "prism",
            Engine::Window => "window",
        }
    }
}

/// Numerical settings of a request: engine, grid, slices and probes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NumericsRequest {
    /// The engine. `None`: the engine that a window or an interpolation implies, or else the fastest whose images have at most an
    /// error of 0.5 %.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub engine: Option<Engine>,
    /// Use the narrowest window whose rms error is at most this share of the mean image in per cent, or the exact engine.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub accuracy_percent: Option<f64>,
    /// PRISM's interpolation factors along x and y.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub interpolation: Option<[usize; 2]>,
    /// Width of the window that follows each probe, in Angstrom.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub window_angstrom: Option<f64>,
    /// Largest pixel of the grid in Angstrom; without it and `gpts`, the grid carries the outermost detector angle times `angle_margin`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sampling_angstrom: Option<f64>,
    /// Grid points along x and y.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gpts: Option<[usize; 2]>,
    /// Slices of equal thickness, at most this in Angstrom; `None`: [`Slicing::Auto`].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub slice_thickness_angstrom: Option<f64>,
    /// Distribution of an atom over slices.
    pub projection: Projection,
    /// Table of scattering factors.
    pub parametrization: Parametrization,
    /// Radius of the anti-aliasing disk in units of Nyquist.
    pub band_fraction: f64,
    /// Width of the soft edge inside that disk, in units of Nyquist.
    pub band_taper: f64,
    /// Exponentiate potentials on a grid finer by this factor; `None`: smoothed potentials with the cores added in closed form.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub oversampling: Option<usize>,
    /// The grid carries this many times the outermost detector angle.
    pub angle_margin: f64,
    /// Distance of the propagated probes: `"auto"`, `"scan"` or a distance in Angstrom.
    #[serde(with = "probe_step")]
    pub probe_step: ProbeStep,
    /// With windows, expansion of probes in fewer waves: `"auto"`, `"off"` or the error in per cent of a probe's amplitude.
    #[serde(with = "expansion", rename = "expansion_percent")]
    pub expansion: Expansion,
    /// Box in which the probe has norm 1; `None`: the cell, or with windows a large box.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub probe_box: Option<ProbeBox>,
    /// Whether PRISM keeps exit waves on the grid of the simulation.
    pub full_exit_grid: bool,
    /// Add the intensity that the probe's tail outside a window or a large box would have scattered.
    pub tail_correction: bool,
}

impl Default for NumericsRequest {
    fn default() -> Self {
        NumericsRequest {
            engine: None,
            accuracy_percent: None,
            interpolation: None,
            window_angstrom: None,
            sampling_angstrom: None,
            gpts: None,
            slice_thickness_angstrom: None,
            projection: Projection::default(),
            parametrization: Parametrization::default(),
            band_fraction: DEFAULT_BAND_FRACTION,
            band_taper: 0.0,
            oversampling: None,
            angle_margin: AUTO_ANGLE_MARGIN,
            probe_step: ProbeStep::Auto,
            expansion: Expansion::Auto,
            probe_box: None,
            full_exit_grid: false,
            tail_correction: true,
        }
    }
}

impl NumericsRequest {
    /// The algorithm; multislice if the request leaves it open.
    ///
    /// # Errors
    /// [`Error::Invalid`] for an accuracy, a window or an interpolation that belongs to another engine.
    pub(crate) fn algorithm(&self) -> Result<Algorithm> {
        if let Some(accuracy) = self.accuracy_percent {
            if !matches!(self.engine, None | Some(Engine::Window)) {
                let expected =
                    "an accuracy chooses a window; leave the engine out, or take `window`";
                return Err(Error::invalid(Setting::AccuracyPercent, accuracy, expected));
            }
            if self.window_angstrom.is_some() || self.interpolation.is_some() {
                let expected = "an accuracy chooses the window; leave window and interpolation out";
                return Err(Error::invalid(Setting::AccuracyPercent, accuracy, expected));
            }
        }
        algorithm(
            self.engine,
            self.window_angstrom,
            self.interpolation,
            Engine::Multislice,
            WINDOW_ANGSTROM,
            [1, 1],
        )
    }

    /// The settings of the engine at one value of the defocus, in Angstrom.
    ///
    /// # Errors
    /// [`Error::Invalid`] for settings that exclude each other.
    pub fn settings(
        &self,
        microscope: &MicroscopeRequest,
        defocus_angstrom: f64,
        phonons: Option<Phonons>,
        thicknesses_angstrom: Vec<f64>,
    ) -> Result<Settings> {
        let grid = match (self.sampling_angstrom, self.gpts) {
            (Some(sampling), Some(_)) => {
                let expected = "sampling and gpts both set the grid; give one";
                return Err(Error::invalid(
                    Setting::Gpts,
                    format!("given, with a sampling of {sampling} A"),
                    expected,
                ));
            }
            (None, Some(points)) => GridChoice::Points(points),
            (Some(sampling), None) => GridChoice::Sampling(sampling),
            (None, None) => GridChoice::Auto,
        };
        Ok(Settings {
            optics: microscope.optics(defocus_angstrom),
            detectors: microscope.detectors.iter().flat_map(Detector::measured).collect(),
            parametrization: self.parametrization,
            projection: self.projection,
            slicing: self.slice_thickness_angstrom.map_or(Slicing::Auto, Slicing::Thickness),
            grid,
            algorithm: self.algorithm()?,
            probe_step: self.probe_step,
            expansion: self.expansion,
            angle_margin: self.angle_margin,
            probe_box: self.probe_box,
            full_exit_grid: self.full_exit_grid,
            tail_correction: self.tail_correction,
            direct_beam: self.tail_correction,
            band_fraction: self.band_fraction,
            band_taper: self.band_taper,
            oversampling: self.oversampling,
            phonons,
            thicknesses_angstrom,
            beyond_limit: match microscope.allow_empty_angles {
                true => BeyondLimit::Warn,
                false => BeyondLimit::Error,
            },
            ..Settings::default()
        })
    }
}

/// The algorithm of the `named` engine, else of the engine that a window or an interpolation implies, else of `default`. `width_angstrom`
/// and `factors` are the default width of the window and the default interpolation factors.
///
/// # Errors
/// [`Error::Invalid`] for a window or an interpolation that belongs to another engine.
pub(crate) fn algorithm(
    named: Option<Engine>,
    window_angstrom: Option<f64>,
    interpolation: Option<[usize; 2]>,
    default: Engine,
    width_angstrom: f64,
    factors: [usize; 2],
) -> Result<Algorithm> {
    let implied = match (window_angstrom, interpolation) {
        (Some(_), _) => Engine::Window,
        (None, Some(_)) => Engine::Prism,
        (None, None) => default,
    };
    let engine = named.unwrap_or(implied);
    if let Some(width) = window_angstrom.filter(|_| engine != Engine::Window) {
        let expected =
            format!("a window belongs to the engine `window`, not to `{}`", engine.name());
        return Err(Error::invalid(Setting::WindowAngstrom, width, expected));
    }
    if let Some([x, y]) = interpolation.filter(|_| engine != Engine::Prism) {
        let expected =
            format!("interpolation belongs to the engine `prism`, not to `{}`", engine.name());
        return Err(Error::invalid(Setting::Interpolation, format!("{x},{y}"), expected));
    }
    Ok(match engine {
        Engine::Multislice => Algorithm::Multislice,
        Engine::Prism => Algorithm::Prism { interpolation: interpolation.unwrap_or(factors) },
        Engine::Window => {
            Algorithm::Window { width_angstrom: window_angstrom.unwrap_or(width_angstrom) }
        }
    })
}

/// A number, or one of a few words.
#[derive(Serialize, Deserialize)]
#[serde(untagged)]
enum WordOrNumber {
    Number(f64),
    Word(String),
}

impl WordOrNumber {
    /// The word's value, or the value made from a number above 0.
    fn read<T: Copy, E: serde::de::Error>(
        &self,
        words: &[(&str, T)],
        number: impl Fn(f64) -> T,
        expected: &str,
    ) -> std::result::Result<T, E> {
        let found = match self {
            WordOrNumber::Number(value) => {
                (*value > 0.0 && value.is_finite()).then(|| number(*value))
            }
            WordOrNumber::Word(word) => {
                words.iter().find(|(name, _)| name == word).map(|(_, value)| *value)
            }
        };
        found.ok_or_else(|| {
            let given = match self {
                WordOrNumber::Number(value) => value.to_string(),
                WordOrNumber::Word(word) => word.clone(),
            };
            E::custom(format!("`{given}`: expected {expected}"))
        })
    }
}

/// `"auto"`, `"scan"` or Angstrom.
mod probe_step {
    use super::{Deserialize, ProbeStep, Serialize, WordOrNumber};

    pub fn serialize<S: serde::Serializer>(step: &ProbeStep, to: S) -> Result<S::Ok, S::Error> {
        match step {
            ProbeStep::Auto => "auto".serialize(to),
            ProbeStep::Scan => "scan".serialize(to),
            ProbeStep::Angstrom(step) => step.serialize(to),
        }
    }

    pub fn deserialize<'de, D: serde::Deserializer<'de>>(from: D) -> Result<ProbeStep, D::Error> {
        let words = [("auto", ProbeStep::Auto), ("scan", ProbeStep::Scan)];
        let expected = "\"auto\", \"scan\" or a distance in A above 0";
        WordOrNumber::deserialize(from)?.read(&words, ProbeStep::Angstrom, expected)
    }
}

/// `"auto"`, `"off"` or per cent.
mod expansion {
    use super::{Deserialize, Expansion, Serialize, WordOrNumber};

    pub fn serialize<S: serde::Serializer>(of: &Expansion, to: S) -> Result<S::Ok, S::Error> {
        match of {
            Expansion::Auto => "auto".serialize(to),
            Expansion::Off => "off".serialize(to),
            Expansion::Error(error) => (100.0 * error).serialize(to),
        }
    }

    pub fn deserialize<'de, D: serde::Deserializer<'de>>(from: D) -> Result<Expansion, D::Error> {
        let words = [("auto", Expansion::Auto), ("off", Expansion::Off)];
        let expected = "\"auto\", \"off\" or per cent above 0";
        WordOrNumber::deserialize(from)?.read(
            &words,
            |percent| Expansion::Error(percent / 100.0),
            expected,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_those_of_the_engine() {
        let microscope = MicroscopeRequest::default();
        let settings = NumericsRequest::default().settings(&microscope, 0.0, None, Vec::new());
        let slicing = Slicing::Auto;
        let expected = Settings { direct_beam: true, slicing, ..Settings::default() };
        assert_eq!(settings.unwrap(), expected);
    }

    #[test]
    fn windows_and_interpolation_imply_their_engine() {
        let none = NumericsRequest::default;
        let window = NumericsRequest { window_angstrom: Some(9.0), ..none() };
        assert_eq!(window.algorithm().unwrap(), Algorithm::Window { width_angstrom: 9.0 });
        let prism = NumericsRequest { interpolation: Some([2, 1]), ..none() };
        assert_eq!(prism.algorithm().unwrap(), Algorithm::Prism { interpolation: [2, 1] });
        let named = NumericsRequest { engine: Some(Engine::Window), ..none() };
        let usual = Algorithm::Window { width_angstrom: WINDOW_ANGSTROM };
        assert_eq!(named.algorithm().unwrap(), usual);
    }

    #[test]
    fn settings_of_another_engine_are_refused() {
        let none = NumericsRequest::default;
        let refused = [
            (
                NumericsRequest {
                    engine: Some(Engine::Prism),
                    window_angstrom: Some(9.0),
                    ..none()
                },
                Setting::WindowAngstrom,
            ),
            (
                NumericsRequest {
                    window_angstrom: Some(9.0),
                    interpolation: Some([2, 2]),
                    ..none()
                },
                Setting::Interpolation,
            ),
            (
                NumericsRequest {
                    engine: Some(Engine::Multislice),
                    interpolation: Some([2, 2]),
                    ..none()
                },
                Setting::Interpolation,
            ),
            (
                NumericsRequest {
                    engine: Some(Engine::Prism),
                    accuracy_percent: Some(1.0),
                    ..none()
                },
                Setting::AccuracyPercent,
            ),
            (
                NumericsRequest {
                    window_angstrom: Some(9.0),
                    accuracy_percent: Some(1.0),
                    ..none()
                },
                Setting::AccuracyPercent,
            ),
            (
                NumericsRequest { sampling_angstrom: Some(0.1), gpts: Some([9, 9]), ..none() },
                Setting::Gpts,
            ),
        ];
        for (request, expected) in refused {
            let made = request.settings(&MicroscopeRequest::default(), 0.0, None, Vec::new());
            match made.unwrap_err() {
                Error::Invalid { setting, .. } => assert_eq!(setting, expected),
                other => panic!("{other}"),
            }
        }
    }
}
