//! Positions of the probes of a request.

use serde::{Deserialize, Serialize};

use crate::engine::Scan;
use crate::error::{Error, Result};
use crate::optics::Optics;
use crate::setting::Setting;

/// Largest number of probe positions.
const MOST_PROBES: f64 = 1e9;
/// Lengths in Angstrom that differ by less are equal.
const SAME_ANGSTROM: f64 = 1e-6;

/// A unit of lengths in the simulated box.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LengthUnit {
    /// Angstrom.
    #[default]
    #[serde(alias = "A")]
    Angstrom,
    /// Nanometre.
    Nm,
    /// Fractions of the box.
    Cell,
}

impl LengthUnit {
    /// One unit along x and y in Angstrom, in a box of `size` (x, y) in Angstrom.
    pub fn angstrom(self, size: [f64; 2]) -> [f64; 2] {
        match self {
            LengthUnit::Angstrom => [1.0; 2],
            LengthUnit::Nm => [10.0; 2],
            LengthUnit::Cell => size,
        }
    }
}

/// Probe positions: a raster over a part of the simulated box, from `start` to `end`; `end` is not a probe position.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ScanRequest {
    /// First probe (x, y); `None`: the corner of the box.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub start: Option<[f64; 2]>,
    /// End of the scan (x, y); `None`: the edges of the box.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub end: Option<[f64; 2]>,
    /// Unit of start and end.
    pub unit: LengthUnit,
    /// Distance of probes in Angstrom, reduced a little so that it divides the scan; `None`: the Nyquist limit of the image, wavelength /
    /// (4 semiangle).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub step_angstrom: Option<f64>,
    /// Number of probes along x and y, instead of their distance.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub points: Option<[usize; 2]>,
}

impl ScanRequest {
    /// The raster over a box of `size` (x, y) in Angstrom.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a scan that is empty, or has more than 1e9 probes.
    pub fn scan(&self, size: [f64; 2], optics: &Optics) -> Result<Scan> {
        let unit = self.unit.angstrom(size);
        let in_angstrom = |point: [f64; 2]| [point[0] * unit[0], point[1] * unit[1]];
        let start = self.start.map_or([0.0; 2], in_angstrom);
        let end = self.end.map_or(size, in_angstrom);
        let extent = [end[0] - start[0], end[1] - start[1]];
        let given = || format!("scan from {}, {} to {}, {} A", start[0], start[1], end[0], end[1]);
        let refuse =
            |value: String, expected: &str| Err(Error::invalid(Setting::Scan, value, expected));
        if !extent.iter().all(|w| *w > 0.0 && w.is_finite()) {
            return refuse(given(), "is empty: the end must lie right of and below the start");
        }
        let points = match (self.points, self.step_angstrom) {
            (Some(_), Some(_)) => {
                return refuse(
                    given(),
                    "the step and the number of probes both set the step; give one",
                );
            }
            (Some(points), None) => points.map(|n| n as f64),
            (None, step) => {
                let step = step.unwrap_or_else(|| nyquist(optics));
                if step.is_nan() || step <= 0.0 {
                    return refuse(
                        format!("step of {step} A"),
                        "the distance of probes is above 0",
                    );
                }
                extent.map(|w| (w / step - SAME_ANGSTROM).ceil().max(1.0))
            }
        };
        if !(1.0..=MOST_PROBES).contains(&(points[0] * points[1])) {
            let value = format!("{} x {} probes", points[0], points[1]);
            return refuse(value, "between 1 and 1e9 are possible");
        }
        Ok(Scan {
            origin_angstrom: start,
            step_angstrom: [extent[0] / points[0], extent[1] / points[1]],
            shape: [points[1] as usize, points[0] as usize],
        })
    }
}

/// The largest step that samples an incoherent image: its band ends at twice the semiangle.
fn nyquist(optics: &Optics) -> f64 {
    optics.wavelength_angstrom() / (4e-3 * optics.semiangle_mrad)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_divide_the_scan() {
        let optics = Optics::default();
        let whole = ScanRequest::default().scan([3.905, 7.81], &optics).unwrap();
        assert_eq!(whole.shape, [27, 14]);
        assert!((whole.step_angstrom[0] - 3.905 / 14.0).abs() < 1e-12);
        let step = ScanRequest { step_angstrom: Some(0.1), ..ScanRequest::default() };
        assert_eq!(step.scan([1.0, 0.95], &optics).unwrap().shape, [10, 10]);
        let part = ScanRequest {
            start: Some([-1.0, 2.0]),
            end: Some([1.0, 3.0]),
            points: Some([4, 5]),
            ..ScanRequest::default()
        };
        let scan = part.scan([9.0, 9.0], &optics).unwrap();
        assert_eq!((scan.shape, scan.step_angstrom), ([5, 4], [0.5, 0.2]));
        assert_eq!(scan.origin_angstrom, [-1.0, 2.0]);
    }

    #[test]
    fn units_scale_start_and_end() {
        let given = |unit, end| ScanRequest {
            start: Some([0.1, 0.2]),
            end: Some(end),
            unit,
            points: Some([2, 2]),
            step_angstrom: None,
        };
        let size = [20.0, 40.0];
        let nm = given(LengthUnit::Nm, [1.1, 2.2]).scan(size, &Optics::default()).unwrap();
        assert_eq!((nm.origin_angstrom, nm.step_angstrom), ([1.0, 2.0], [5.0, 10.0]));
        let cell = given(LengthUnit::Cell, [0.6, 0.7]).scan(size, &Optics::default()).unwrap();
        assert_eq!((cell.origin_angstrom, cell.step_angstrom), ([2.0, 8.0], [5.0, 10.0]));
    }

    #[test]
    fn impossible_scans_are_refused() {
        let none = ScanRequest::default;
        let bad = [
            ScanRequest { end: Some([0.0, 1.0]), ..none() },
            ScanRequest { end: Some([f64::NAN, 1.0]), ..none() },
            ScanRequest { step_angstrom: Some(-0.1), ..none() },
            ScanRequest { step_angstrom: Some(1e-9), ..none() },
            ScanRequest { points: Some([0, 3]), ..none() },
            ScanRequest { points: Some([2, 3]), step_angstrom: Some(1.0), ..none() },
        ];
        for scan in bad {
            let error = scan.scan([5.0, 5.0], &Optics::default()).unwrap_err();
            assert!(matches!(error, Error::Invalid { setting: Setting::Scan, .. }), "{scan:?}");
        }
    }
}
