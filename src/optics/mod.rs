//! The probe-forming (or imaging) lens: aperture and aberrations.

use crate::constants::wavelength_angstrom;
use crate::error::{Error, Result};
use crate::setting::Setting;
use num_complex::Complex64;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

mod focal_spread;

pub use focal_spread::{Focus, foci};

/// One aberration coefficient `C_nm` in polar notation.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Aberration {
    /// Order n: the phase grows as angle^(n + 1).
    pub order: u8,
    /// Azimuthal symmetry m.
    pub symmetry: u8,
    /// Magnitude in Angstrom.
    pub magnitude_angstrom: f64,
    /// Azimuth in radians, from +x towards +y; ignored for m = 0.
    pub azimuth_rad: f64,
}

/// The aberration function of a lens, to fifth order:
/// `chi = (2 pi / lambda) sum_nm C_nm alpha^(n+1) cos(m (phi - phi_nm)) / (n + 1)`
/// (O. L. Krivanek, N. Dellby, A. R. Lupini, Ultramicroscopy 78 (1999) 1).
///
/// `C10` is minus the defocus: positive defocus is underfocus.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Aberrations(pub Vec<Aberration>);

const KNOWN: [(u8, u8); 14] = [
    (1, 0),
    (1, 2),
    (2, 1),
    (2, 3),
    (3, 0),
    (3, 2),
    (3, 4),
    (4, 1),
    (4, 3),
    (4, 5),
    (5, 0),
    (5, 2),
    (5, 4),
    (5, 6),
];

impl Aberration {
    /// Reads `C12=30@0.3`: 30 Angstrom at an azimuth of 0.3 rad.
    ///
    /// # Errors
    /// [`Error::Invalid`] for anything else, naming the coefficients that exist.
    pub fn parse(text: &str) -> Result<Self> {
        let bad = || {
            let names: Vec<String> = KNOWN.iter().map(|(n, m)| format!("C{n}{m}")).collect();
            let known = names.join(" ");
            Error::invalid(
                Setting::Aberration,
                text,
                format!("write C12=30@0.3 (30 A at an azimuth of 0.3 rad) with one of {known}"),
            )
        };
        let (name, value) = text.split_once('=').ok_or_else(bad)?;
        let nm = name.trim().strip_prefix(['C', 'c']).ok_or_else(bad)?;
        let known = KNOWN.iter().find(|(n, m)| nm == format!("{n}{m}"));
        let &(order, symmetry) = known.ok_or_else(bad)?;
        let (magnitude, azimuth) = value.split_once('@').unwrap_or((value, "0"));
        let number = |s: &str| s.trim().parse().ok().filter(|v: &f64| v.is_finite());
        Ok(Aberration {
            order,
            symmetry,
            magnitude_angstrom: number(magnitude).ok_or_else(bad)?,
            azimuth_rad: number(azimuth).ok_or_else(bad)?,
        })
    }

    /// Checks that the coefficient exists, with finite values.
    ///
    /// # Errors
    /// Errors of [`Aberration::parse`].
    pub(crate) fn validate(&self) -> Result<()> {
        let Aberration { order, symmetry, magnitude_angstrom, azimuth_rad } = *self;
        Self::parse(&format!("C{order}{symmetry}={magnitude_angstrom}@{azimuth_rad}")).map(drop)
    }
}

impl Aberrations {
    /// A defocus (positive: underfocus) in Angstrom, without other aberrations.
    pub fn defocus(defocus_angstrom: f64) -> Self {
        let mut a = Aberrations::default();
        a.add_defocus(defocus_angstrom);
        a
    }

    /// The defocus in Angstrom (positive: underfocus), -C10.
    pub fn defocus_angstrom(&self) -> f64 {
        let c10 = self.0.iter().filter(|a| (a.order, a.symmetry) == (1, 0));
        c10.map(|a| -a.magnitude_angstrom).sum()
    }

    /// Adds `C10 = -defocus`.
    pub fn add_defocus(&mut self, defocus_angstrom: f64) {
        if defocus_angstrom != 0.0 {
            self.0.push(Aberration {
                order: 1,
                symmetry: 0,
                magnitude_angstrom: -defocus_angstrom,
                azimuth_rad: 0.0,
            });
        }
    }

    /// `chi` in radians at angle `alpha` (rad) and azimuth `phi` (rad).
    pub fn chi(&self, wavelength_angstrom: f64, alpha: f64, phi: f64) -> f64 {
        let term = |a: &Aberration| {
            let power = i32::from(a.order) + 1;
            let turn = (f64::from(a.symmetry) * (phi - a.azimuth_rad)).cos();
            a.magnitude_angstrom * alpha.powi(power) * turn / f64::from(power)
        };
        2.0 * PI / wavelength_angstrom * self.0.iter().map(term).sum::<f64>()
    }
}

/// Energies of the beam in keV.
const ENERGY_KEV: std::ops::RangeInclusive<f64> = 10.0..=3000.0;
/// Semiangles in mrad.
const SEMIANGLE_MRAD: std::ops::RangeInclusive<f64> = 0.01..=500.0;
/// Largest phase of an aberration at the edge of the aperture: a defocus of 0.18 mm at 200 kV and 21 mrad.
const MOST_PHASE_RAD: f64 = 1e7;
/// Largest azimuth in radians; a turn is 6.28.
const MOST_AZIMUTH_RAD: f64 = 1e3;

/// How the aperture ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ApertureEdge {
    /// Falls linearly over one Fourier pixel, so that the effective radius is exact on any grid.
    #[default]
    Soft,
    /// Ones strictly inside, zero elsewhere.
    Hard,
}

/// Largest mistilt along x and y in mrad: beyond, the columns of a crystal lie side by side.
pub(crate) const MOST_MISTILT_MRAD: f64 = 20.0;

/// Beam energy, aperture and aberrations, mistilt and focal spread.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Optics {
    /// Beam energy in keV. Files hold it in eV.
    #[serde(rename = "energy_ev", with = "stored_ev")]
    pub energy_kev: f64,
    /// Convergence semiangle (for imaging: objective aperture) in mrad.
    pub semiangle_mrad: f64,
    /// Aberrations of the lens.
    #[serde(default)]
    pub aberrations: Aberrations,
    /// Edge of the aperture.
    #[serde(default)]
    pub edge: ApertureEdge,
    /// Mistilt (x, y) of the specimen in mrad: the beam runs along `(tan x, tan y, 1)` of the specimen, whose slices stay
    /// planes of constant z; detectors are centred on the beam. abTEM's `tilt` has the same sign.
    #[serde(rename = "mistilt_mrad", default, skip_serializing_if = "is_none_of")]
    pub tilt_mrad: [f64; 2],
    /// Standard deviation in Angstrom of the focus, over which images are averaged: `C_c dE / E` with the standard deviation dE
    /// of the beam's energy.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub focal_spread_angstrom: f64,
}

fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

/// The beam energy as files hold it.
mod stored_ev {
    use serde::{Deserialize, Deserializer, Serializer};

    #[expect(clippy::trivially_copy_pass_by_ref, reason = "serde gives a reference")]
    pub(super) fn serialize<S: Serializer>(kev: &f64, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_f64(kev * 1e3)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
        Ok(f64::deserialize(from)? / 1e3)
    }
}

fn is_none_of(values: &[f64; 2]) -> bool {
    *values == [0.0; 2]
}

impl Default for Optics {
    fn default() -> Self {
        Optics {
            energy_kev: 200.0,
            semiangle_mrad: 21.0,
            aberrations: Aberrations::default(),
            edge: ApertureEdge::Soft,
            tilt_mrad: [0.0; 2],
            focal_spread_angstrom: 0.0,
        }
    }
}

impl Optics {
    /// Electron wavelength in Angstrom.
    pub(crate) fn wavelength_angstrom(&self) -> f64 {
        wavelength_angstrom(self.energy_ev())
    }

    /// Beam energy in eV, as the formulas of electrons take it.
    pub(crate) fn energy_ev(&self) -> f64 {
        self.energy_kev * 1e3
    }

    /// Checks that a probe of these optics can be simulated.
    ///
    /// # Errors
    /// [`Error::Invalid`] for an energy, a semiangle or an aberration out of range, naming the range.
    pub(crate) fn validate(&self) -> Result<()> {
        let kev = self.energy_kev;
        if !ENERGY_KEV.contains(&kev) {
            let (low, high) = (ENERGY_KEV.start(), ENERGY_KEV.end());
            let expected = format!("must be between {low} and {high}");
            return Err(Error::invalid(Setting::EnergyKev, kev, expected));
        }
        if !SEMIANGLE_MRAD.contains(&self.semiangle_mrad) {
            let (low, high) = (SEMIANGLE_MRAD.start(), SEMIANGLE_MRAD.end());
            let expected = format!("must be between {low} and {high}");
            return Err(Error::invalid(Setting::SemiangleMrad, self.semiangle_mrad, expected));
        }
        self.aberrations.0.iter().try_for_each(|a| self.validate_aberration(a))?;
        self.validate_mistilt()?;
        foci(self).map(|_| ())
    }

    fn validate_mistilt(&self) -> Result<()> {
        let [x, y] = self.tilt_mrad;
        if x.abs() <= MOST_MISTILT_MRAD && y.abs() <= MOST_MISTILT_MRAD {
            return Ok(());
        }
        let expected = format!("each must be from -{MOST_MISTILT_MRAD} to {MOST_MISTILT_MRAD}");
        Err(Error::invalid(Setting::MistiltMrad, format!("{x},{y}"), expected))
    }

    /// Displacement (x, y) of the beam in Angstrom for each Angstrom of depth.
    pub fn slope(&self) -> [f64; 2] {
        self.tilt_mrad.map(|t| libm::tan(t * 1e-3))
    }

    /// Whether images are unchanged when specimen and scan are turned about the beam.
    pub fn is_round(&self) -> bool {
        let round = |a: &Aberration| a.symmetry == 0 || a.magnitude_angstrom == 0.0;
        self.tilt_mrad == [0.0; 2] && self.aberrations.0.iter().all(round)
    }

    /// These optics seen from axes whose directions are the columns of the orthogonal matrix `frame`: (x, y) there are
    /// `frame` times (x, y).
    #[must_use]
    pub fn seen_from(&self, frame: [[f64; 2]; 2]) -> Self {
        let [[a, b], [c, d]] = frame;
        let [x, y] = self.tilt_mrad;
        let [sx, sy] = [x, y].map(|t| libm::tan(t * 1e-3));
        let back = |u: f64, v: f64| 1e3 * libm::atan(u * sx + v * sy);
        // A direction at azimuth p is seen at p - turn, or mirrored at turn - p.
        let (turn, hand) = (libm::atan2(c, a), (a * d - b * c).signum());
        let turned = |t: &Aberration| match t.symmetry {
            0 => *t,
            _ => Aberration { azimuth_rad: hand * (t.azimuth_rad - turn), ..*t },
        };
        Optics {
            tilt_mrad: if is_none_of(&[x, y]) { [x, y] } else { [back(a, c), back(b, d)] },
            aberrations: Aberrations(self.aberrations.0.iter().map(turned).collect()),
            ..self.clone()
        }
    }

    /// Refuses an aberration whose phase at the edge of the aperture is too large.
    fn validate_aberration(&self, aberration: &Aberration) -> Result<()> {
        let Aberration { order, symmetry, magnitude_angstrom, azimuth_rad } = *aberration;
        let power = i32::from(order) + 1;
        let angle = self.semiangle_mrad * 1e-3;
        let most = MOST_PHASE_RAD * f64::from(power) * self.wavelength_angstrom()
            / (2.0 * PI * angle.powi(power));
        // The comparison is not `> most`, so that NaN is refused too.
        let small = magnitude_angstrom.abs() <= most;
        if small && azimuth_rad.abs() <= MOST_AZIMUTH_RAD {
            return Ok(());
        }
        let value = format!("C{order}{symmetry} = {magnitude_angstrom} A at {azimuth_rad} rad");
        let expected = format!(
            "must be below {most:.3e} A, {MOST_PHASE_RAD:e} rad at the edge of the aperture, and its azimuth below \
             {MOST_AZIMUTH_RAD} rad"
        );
        Err(Error::invalid(Setting::Aberration, value, expected))
    }

    /// Amplitude of the lens' transfer, `A exp(-i chi)`, at spatial frequency `k` (1/Angstrom) on a
    /// Fourier grid of spacing `dk` (1/Angstrom).
    pub(crate) fn transfer(&self, k: [f64; 2], dk: [f64; 2]) -> Complex64 {
        let lambda = self.wavelength_angstrom();
        // Most of a grid lies far outside the aperture and its soft edge.
        let beyond = self.semiangle_mrad * 1e-3 / lambda + dk[0] + dk[1];
        if k[0] * k[0] + k[1] * k[1] > beyond * beyond {
            return Complex64::ZERO;
        }
        let alpha = lambda * k[0].hypot(k[1]);
        let phi = k[1].atan2(k[0]);
        let limit = self.semiangle_mrad * 1e-3;
        let amplitude = match self.edge {
            _ if alpha == 0.0 => 1.0,
            ApertureEdge::Soft => {
                let width = lambda * (dk[0] * phi.cos()).hypot(dk[1] * phi.sin());
                ((limit - alpha) / width + 0.5).clamp(0.0, 1.0)
            }
            ApertureEdge::Hard => f64::from(u8::from(alpha < limit)),
        };
        if amplitude == 0.0 {
            return Complex64::ZERO;
        }
        Complex64::from_polar(amplitude, -self.aberrations.chi(lambda, alpha, phi))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parses_coefficients() {
        let a = Aberration::parse("C12=30@0.3").unwrap();
        assert_eq!((a.order, a.symmetry, a.magnitude_angstrom, a.azimuth_rad), (1, 2, 30.0, 0.3));
        assert_eq!(Aberration::parse("C30=1e5").unwrap().magnitude_angstrom, 1e5);
        for bad in ["C11=3", "C12", "12=3", "C12=x", "C12=1@nan", ""] {
            let message = Aberration::parse(bad).unwrap_err().to_string();
            assert!(message.contains("C56"), "{message}");
        }
    }

    /// Scherzer defocus balances C_s: chi = -2 pi / 3 at its minimum (Kirkland 2010, sec. 3.2).
    #[test]
    fn scherzer_phase() {
        let lambda = wavelength_angstrom(200e3);
        let cs = 1.3e7;
        let defocus = (1.5 * cs * lambda).sqrt();
        let mut a = Aberrations::defocus(defocus);
        a.0.push(Aberration::parse("C30=1.3e7").unwrap());
        let lowest = (0..3000).map(|i| a.chi(lambda, f64::from(i) * 5e-6, 0.4)).fold(0.0, f64::min);
        assert!((lowest + 2.25 * PI / 3.0).abs() < 1e-3, "{lowest}");
    }

    #[test]
    fn settings_that_no_probe_has_are_refused() {
        let usual = Optics::default();
        usual.validate().unwrap();
        let defocus = |d| Optics { aberrations: Aberrations::defocus(d), ..usual.clone() };
        defocus(1e6).validate().unwrap();
        let turned = Aberration::parse("C12=1@1e308").unwrap();
        let cases = [
            Optics { energy_kev: 1.0, ..usual.clone() },
            Optics { energy_kev: f64::NAN, ..usual.clone() },
            Optics { semiangle_mrad: 5e-324, ..usual.clone() },
            Optics { semiangle_mrad: f64::INFINITY, ..usual.clone() },
            Optics { aberrations: Aberrations(vec![turned]), ..usual.clone() },
            defocus(1e308),
            defocus(f64::NAN),
            defocus(f64::NEG_INFINITY),
        ];
        for optics in cases {
            let message = optics.validate().unwrap_err().to_string();
            assert!(message.contains("must be b"), "{message}");
        }
    }

    #[test]
    fn soft_edge_is_half_at_the_semiangle() {
        let o = Optics::default();
        let k = 0.021 / o.wavelength_angstrom();
        assert!((o.transfer([k, 0.0], [0.1, 0.2]).norm() - 0.5).abs() < 1e-12);
        assert!((o.transfer([0.0, k + 0.05], [0.1, 0.2]).norm() - 0.25).abs() < 1e-12);
        assert_eq!(o.transfer([0.0, k + 0.21], [0.1, 0.2]).norm(), 0.0);
    }
}
