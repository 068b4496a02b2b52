//! A window for a requested accuracy from a table, without any simulation. The accuracy is not guaranteed: static crystals channel more
//! sharply than the displaced atoms on which the table was measured (GaAs \[110\], 10 nm, windows of 7.8 A: 4.8 % in place of 0.8 %).
//! [`super::settings_for_accuracy`] measures the error on the specimen.
//!
//! Errors are rms differences from the full grid over a raster, divided by the mean image. They were measured
//! (`cargo bench --bench accuracy`) for HAADF 68-200 mrad at 200 kV, 21 mrad, in focus, at 40 and 100 A (Pt: 13
//! and 33 A), two phonon configurations each, on SrTiO3 \[001\], BaTiO3, Si0.9Ge0.1 \[110\], GaN \[11-20\] and a Pt
//! sphere; the table holds the largest.

use super::super::probe_width::{
    MEASURED_THICKNESS_ANGSTROM, SPREAD, geometric_radius, relative_size,
};
use super::super::settings::{LEAST_INNER_SEMIANGLES, Settings};
use crate::error::{Error, Result};

/// Measured pairs: error in per cent, width of the window in Angstrom.
const MEASURED: [(f64, f64); 3] = [(3.3, 5.9), (0.8, 7.8), (0.4, 11.7)];
/// Mistilt in mrad up to which the error of a mosaic was measured, for SrTiO3 of 10 nm in one phonon configuration. With windows of 7.8 A
/// the error is 0.67 % at bright columns, and 0.46 % of the brightest one over all pixels. With 11.7 A it is 0.43 and 0.43 %.
const MEASURED_MISTILT_MRAD: f64 = 5.0;
/// A window grows by this many times the lateral distance that a tilted beam covers in the specimen: by 3.9 A for 5 mrad and 100 A.
const MISTILT_GROWTH: f64 = 7.8;

/// A window, and why its error may differ from the measured one.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct WindowChoice {
    /// Width in Angstrom.
    pub width_angstrom: f64,
    /// Why its error is an extrapolation; empty within the range of the measurements.
    pub beyond_measured: Vec<String>,
}

impl WindowChoice {
    /// A warning about a window that was chosen for an error of `accuracy_percent`; `None` within the range of the measurements.
    pub(crate) fn warning(&self, accuracy_percent: f64) -> Option<String> {
        (!self.beyond_measured.is_empty()).then(|| {
            format!(
                "an error of {accuracy_percent} % was not measured for {}; the window was widened to {:.1} A, which \
                 an audit checks",
                self.beyond_measured.join(", "),
                self.width_angstrom
            )
        })
    }
}

/// The narrowest window whose error is at most `accuracy_percent`, widened for thickness, defocus, aberrations, mistilt and
/// small apertures.
///
/// [`Error::Invalid`] for an accuracy that no window reached in the measurements, and for detectors at angles too low for windows. Both
/// name the engine to use instead.
pub fn window_for(
    accuracy_percent: f64,
    settings: &Settings,
    thickness_angstrom: f64,
) -> Result<WindowChoice> {
    let optics = &settings.optics;
    optics.validate()?;
    let least = LEAST_INNER_SEMIANGLES * optics.semiangle_mrad;
    if let Some(d) = settings.detectors.iter().find(|d| d.inner_mrad < least) {
        let value = format!("{} = {}-{} mrad", d.name, d.inner_mrad, d.outer_mrad);
        let expected = format!(
            "windows are for detectors that begin at {least:.0} mrad (two semiangles) or more; use \
             the engine multislice or prism"
        );
        return Err(Error::invalid(crate::Setting::Detector, value, expected));
    }
    let fits = MEASURED.iter().find(|(error, _)| accuracy_percent >= *error);
    let Some(&(_, base)) = fits.filter(|_| accuracy_percent.is_finite()) else {
        let best = MEASURED[MEASURED.len() - 1].0;
        let expected = format!(
            "the least error that was measured for windows is {best} %; use the engine multislice, or give the width of the window"
        );
        return Err(Error::invalid(crate::Setting::AccuracyPercent, accuracy_percent, expected));
    };
    let size = relative_size(settings);
    let beyond = (thickness_angstrom - MEASURED_THICKNESS_ANGSTROM).max(0.0);
    let blur = geometric_radius(settings);
    let [x, y] = optics.tilt_mrad;
    let mistilt = x.hypot(y);
    let across = 1e-3 * mistilt * thickness_angstrom;
    let width_angstrom = base * size.max(1.0)
        + SPREAD * optics.semiangle_mrad * 1e-3 * beyond
        + 2.0 * blur
        + MISTILT_GROWTH * across;
    let mut notes = Vec::new();
    let mut note = |is: bool, text: String| {
        if is {
            notes.push(text);
        }
    };
    note(beyond > 0.0, format!("thickness {thickness_angstrom:.0} A (measured: to 100 A)"));
    note(blur > 0.5, format!("a probe blurred by {blur:.1} A (measured: in focus)"));
    note(
        mistilt > MEASURED_MISTILT_MRAD,
        format!("a mistilt of {mistilt:.1} mrad (measured: to {MEASURED_MISTILT_MRAD} mrad)"),
    );
    note((size - 1.0).abs() > 0.15, "energy or semiangle (measured: 200 kV, 21 mrad)".into());
    let inner = settings.detectors.iter().map(|d| d.inner_mrad).fold(f64::INFINITY, f64::min);
    note(inner < 60.0, format!("inner angle {inner} mrad (measured: 68 mrad)"));
    Ok(WindowChoice { width_angstrom, beyond_measured: notes })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::Detector;
    use crate::optics::Aberrations;

    #[test]
    fn windows_grow_with_what_spreads_a_probe() {
        let plain = Settings::default();
        let width = |s: &Settings, t: f64| window_for(1.0, s, t).unwrap().width_angstrom;
        assert_eq!(width(&plain, 100.0), 7.8);
        assert!(window_for(1.0, &plain, 100.0).unwrap().beyond_measured.is_empty());
        let mut defocused = plain.clone();
        defocused.optics.aberrations = Aberrations::defocus(60.0);
        // geometric optics: 60 A times 21 mrad on either side
        assert!((width(&defocused, 100.0) - (7.8 + 2.0 * 60.0 * 0.021)).abs() < 1e-3);
        assert!((width(&plain, 195.0) - 10.14).abs() < 0.05);
        let mut small = plain.clone();
        small.optics.semiangle_mrad = 10.5;
        assert!((width(&small, 100.0) - 15.6).abs() < 0.02);
        assert_eq!(window_for(1.0, &defocused, 195.0).unwrap().beyond_measured.len(), 2);
        let mut tilted = plain.clone();
        tilted.optics.tilt_mrad = [3.0, -4.0];
        // The window with which the audit of a mosaic passed.
        assert!((width(&tilted, 100.0) - 11.7).abs() < 1e-9);
        assert!((width(&tilted, 50.0) - 9.75).abs() < 1e-9);
        assert!(window_for(1.0, &tilted, 100.0).unwrap().beyond_measured.is_empty());
    }

    #[test]
    fn what_windows_cannot_do_is_refused() {
        let plain = Settings::default();
        assert!(window_for(0.1, &plain, 50.0).is_err());
        assert!(window_for(f64::NAN, &plain, 50.0).is_err());
        let bf = Settings { detectors: vec![Detector::new("BF", 0.0, 20.0)], ..plain };
        let error = window_for(1.0, &bf, 50.0).unwrap_err().to_string();
        assert!(error.contains("BF") && error.contains("prism"), "{error}");
    }
}
