//! The width of the probe inside the specimen, compared with the width of windows, crops and cells.

use super::settings::{Algorithm, Settings};
use crate::plane;

/// Width in Angstrom of a window whose error is 0.8 % in focus, at the wavelength and semiangle of the measurements.
const USUAL_WINDOW_ANGSTROM: f64 = 7.8;
/// Semiangle and wavelength (Angstrom) of the measurements of windows.
const MEASURED_SEMIANGLE_MRAD: f64 = 21.0;
const MEASURED_WAVELENGTH_ANGSTROM: f64 = 0.025_08;
/// Thickness in Angstrom up to which the errors of windows were measured.
pub(super) const MEASURED_THICKNESS_ANGSTROM: f64 = 102.0;
/// Beyond the measured thickness a window grows by this share of the probe's geometric spread, semiangle times additional
/// thickness: the errors of SrTiO3 at 195 A then stay below the errors at 100 A.
pub(super) const SPREAD: f64 = 1.2;
/// Diameter of the Airy disk in units of the wavelength over the semiangle.
const AIRY: f64 = 1.22;

/// The size of the probe, which is proportional to wavelength over semiangle, in units of the probe's size in the measurements.
pub(super) fn relative_size(settings: &Settings) -> f64 {
    let optics = &settings.optics;
    optics.wavelength_angstrom()
        / optics.semiangle_mrad
        / (MEASURED_WAVELENGTH_ANGSTROM / MEASURED_SEMIANGLE_MRAD)
}

/// Largest distance in Angstrom by which aberrations, including defocus, displace rays within the aperture: `|grad chi| / 2 pi` with
/// respect to k, plus two standard deviations of the focus.
pub(super) fn geometric_radius(settings: &Settings) -> f64 {
    let optics = &settings.optics;
    let wavelength = optics.wavelength_angstrom();
    let k_max = optics.semiangle_mrad * 1e-3 / wavelength;
    let chi = |kx: f64, ky: f64| {
        optics.aberrations.chi(wavelength, kx.hypot(ky) * wavelength, ky.atan2(kx))
    };
    let step = 1e-4 * k_max;
    let mut most = 0.0_f64;
    for ring in 1..=10 {
        for spoke in 0..48 {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(spoke) / 48.0).sin_cos();
            let k = k_max * f64::from(ring) / 10.0;
            let (x, y) = (k * cos, k * sin);
            let slope_x = chi(x + step, y) - chi(x - step, y);
            let slope_y = chi(x, y + step) - chi(x, y - step);
            most = most.max(slope_x.hypot(slope_y) / (2.0 * step));
        }
    }
    let spread = 2.0 * optics.focal_spread_angstrom * optics.semiangle_mrad * 1e-3;
    most / std::f64::consts::TAU + spread
}

/// Widths in Angstrom.
struct ProbeWidth {
    /// Width of the probe inside the specimen: rays and the Airy disk.
    probe: f64,
    /// Width of a crop that contains the probe.
    needed: f64,
}

impl ProbeWidth {
    fn of(settings: &Settings, thickness: f64) -> Self {
        let optics = &settings.optics;
        let angle = optics.semiangle_mrad * 1e-3;
        let beyond = (thickness - MEASURED_THICKNESS_ANGSTROM).max(0.0);
        let rays = 2.0 * geometric_radius(settings) + SPREAD * angle * beyond;
        ProbeWidth {
            probe: rays + AIRY * optics.wavelength_angstrom() / angle,
            needed: rays + USUAL_WINDOW_ANGSTROM * relative_size(settings).max(1.0),
        }
    }
}

/// A warning about windows, or crops of PRISM, that are narrower than the probe. `cell` and `wave` are the edges (x, y) of the cell and of
/// the grid of waves, in Angstrom.
///
/// The threshold was tested by the rms difference from the full grid, in per cent of the mean: SrTiO3 of 39 x 39 x 16 A without phonons,
/// 200 kV, 21 mrad, HAADF, 4 x 4 probes in a unit cell. Windows as wide as the probe have an error of up to 2 %. Narrower crops may have
/// several times this error:
///
/// | defocus (A) | probe (A) | windows of 0.7, 1, 1.4 probes | PRISM, crops of 0.9, 1.4 probes |
/// |---|---|---|---|
/// | 100 | 5.7 | 1.8, 1.2, 1.8 | (2.3 probes: 1.2) |
/// | 200 | 9.9 | 7.1, 0.7, 1.1 | (1.3 probes: 2.8) |
/// | 300 | 14.1 | 4.4, 2.0, 1.3 | 7.5, 1.9 |
///
/// PRISM with crops of 0.7 probes at 300 A is 84 % too bright.
pub(super) fn narrow_crop(
    settings: &Settings,
    cell: [f64; 2],
    wave: [f64; 2],
    thickness: f64,
) -> Option<String> {
    let width = ProbeWidth::of(settings, thickness);
    let (crop, what) = match settings.algorithm {
        Algorithm::Window { .. } => (wave, "each window"),
        Algorithm::Prism { interpolation } if interpolation != [1, 1] => {
            (plane::div(cell, interpolation.map(|n| n as f64)), "PRISM's crop of each probe")
        }
        _ => return None,
    };
    let narrow = crop[0].min(crop[1]);
    if narrow >= width.probe {
        return None;
    }
    let narrowest_cell = cell[0].min(cell[1]);
    let cure = match settings.algorithm {
        _ if narrowest_cell < width.needed => format!(
            "use a cell of {:.1} A or more (here {narrowest_cell:.1} A), and the engine multislice",
            width.needed
        ),
        Algorithm::Prism { .. } => {
            let factors = cell.map(|edge| (edge / width.needed).floor().max(1.0));
            format!(
                "use a crop of {:.1} A or more: interpolation {} along x and {} along y at most",
                width.needed, factors[0], factors[1]
            )
        }
        _ => format!("use a window of {:.1} A or more", width.needed),
    };
    Some(format!(
        "{what} is {narrow:.1} A wide, but inside the specimen the probe is {:.1} A wide (defocus, aberrations and thickness): intensities \
         will be wrong; {cure}",
        width.probe
    ))
}

/// A warning about a cell that is narrower than the probe, which then meets its own periodic images.
pub(super) fn narrow_cell(settings: &Settings, cell: [f64; 2], thickness: f64) -> Option<String> {
    let width = ProbeWidth::of(settings, thickness);
    let narrow = cell[0].min(cell[1]);
    (narrow < width.probe).then(|| {
        format!(
            "the cell is {narrow:.1} A wide, but inside the specimen the probe is {:.1} A wide (defocus, aberrations and thickness): it \
             meets its own periodic images; repeat the cell to {:.1} A or more",
            width.probe, width.needed
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::{Aberration, Aberrations};

    const CELL: [f64; 2] = [39.05; 2];

    fn settings(algorithm: Algorithm, defocus: f64) -> Settings {
        let mut settings = Settings { algorithm, ..Settings::default() };
        settings.optics.aberrations = Aberrations::defocus(defocus);
        settings
    }

    #[test]
    fn a_defocused_probe_needs_a_wider_crop() {
        let prism = |factor| Algorithm::Prism { interpolation: [factor; 2] };
        let warned =
            |factor, defocus| narrow_crop(&settings(prism(factor), defocus), CELL, CELL, 16.0);
        // 300 A times 21 mrad on either side, and an Airy disk of 1.5 A: 14.1 A
        let warning = warned(4, 300.0).unwrap();
        for part in ["9.8 A wide", "probe is 14.1 A wide", "20.4 A", "interpolation 1 along x"] {
            assert!(warning.contains(part), "{part}: {warning}");
        }
        assert_eq!(warned(2, 300.0), None);
        assert_eq!(warned(4, 0.0), None);
        assert_eq!(warned(1, 300.0), None);
    }

    #[test]
    fn spherical_aberration_and_thickness_widen_a_probe() {
        let window = Algorithm::Window { width_angstrom: 7.8 };
        let mut aberrated = settings(window, 0.0);
        aberrated.optics.aberrations.0.push(Aberration::parse("C30=1.2e6").unwrap());
        // 1.2e6 A times (21 mrad)^3 on either side
        let warning = narrow_crop(&aberrated, CELL, [7.8; 2], 16.0).unwrap();
        assert!(
            warning.contains("probe is 23.7 A wide") && warning.contains("a window of 30.0 A"),
            "{warning}"
        );
        assert!(narrow_cell(&aberrated, CELL, 16.0).is_none());
        assert!(narrow_cell(&aberrated, [20.0; 2], 16.0).unwrap().contains("30.0 A or more"));
        let usual = settings(window, 0.0);
        assert_eq!(narrow_crop(&usual, CELL, [7.8; 2], 200.0), None);
        assert!(narrow_crop(&usual, CELL, [7.8; 2], 500.0).is_some());
    }
}
