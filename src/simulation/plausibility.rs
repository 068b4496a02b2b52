//! Finds likely mistakes: values that are possible, but hardly intended. Each gives an error or a warning with its [`Setting`].

use std::path::Path;

use crate::detect::Detector;
use crate::engine::Scan;
use crate::error::{Error, Result};
use crate::optics::Aberration;
use crate::setting::Setting;

/// Angles below this in mrad are taken for radians.
const LEAST_ANGLE_MRAD: f64 = 1.0;
/// Semiangles below this in mrad are taken for radians.
const LEAST_SEMIANGLE_MRAD: f64 = 0.1;
/// Edge of a cell in Angstrom below which a probe meets its own periodic images.
const NARROW_CELL_ANGSTROM: f64 = 10.0;
/// Extensions of HDF5 files.
const HDF5: [&str; 5] = ["h5", "hdf5", "hdf", "he5", "nxs"];
/// Lengths in Angstrom that differ by less are equal.
const SAME_ANGSTROM: f64 = 1e-6;

/// A warning for the user before a simulation.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Warning {
    /// The setting that the warning is about; a front end adds its own option for it.
    pub setting: Option<Setting>,
    /// One or two sentences.
    pub message: String,
}

impl Warning {
    /// A warning about a setting.
    pub(super) fn about(setting: Setting, message: String) -> Self {
        Warning { setting: Some(setting), message }
    }
}

impl From<String> for Warning {
    fn from(message: String) -> Self {
        Warning { setting: None, message }
    }
}

/// Refuses detectors with names that no file can have, and detectors whose angles look like radians.
///
/// # Errors
/// [`Error::Invalid`] with the intended angles.
pub fn check_detector(detector: &Detector) -> Result<()> {
    detector.validate()?;
    let Detector { name, inner_mrad: inner, outer_mrad: outer, .. } = detector;
    if *outer >= LEAST_ANGLE_MRAD {
        return Ok(());
    }
    let [a, b] = [rounded(1e3 * inner), rounded(1e3 * outer)];
    let expected = format!(
        "angles are in mrad, and {inner}-{outer} mrad lie within the unscattered beam; did you mean {name}={a}-{b}?"
    );
    Err(Error::invalid(Setting::Detector, format!("{name} {inner}-{outer}"), expected))
}

/// Refuses a semiangle that looks like radians.
///
/// # Errors
/// [`Error::Invalid`] with the intended semiangle.
pub fn check_semiangle(semiangle_mrad: f64) -> Result<()> {
    if !(1e-3..LEAST_SEMIANGLE_MRAD).contains(&semiangle_mrad) {
        return Ok(());
    }
    let meant = rounded(1e3 * semiangle_mrad);
    let expected = format!(
        "the semiangle is in mrad; did you mean {meant}? (the least semiangle is {LEAST_SEMIANGLE_MRAD})"
    );
    Err(Error::invalid(Setting::SemiangleMrad, semiangle_mrad, expected))
}

/// Refuses an energy that looks like electronvolts.
///
/// # Errors
/// [`Error::Invalid`] with the intended energy.
pub fn check_energy(energy_kev: f64) -> Result<()> {
    if !(1e4..3e6).contains(&energy_kev) {
        return Ok(());
    }
    let expected = format!("the energy is in keV; did you mean {}?", energy_kev / 1e3);
    Err(Error::invalid(Setting::EnergyKev, energy_kev, expected))
}

/// A warning about an azimuth that looks like degrees: it is more than a turn.
pub(crate) fn check_azimuth(aberration: &Aberration) -> Option<Warning> {
    let Aberration { order, symmetry, azimuth_rad, .. } = *aberration;
    let turns = azimuth_rad.abs() > std::f64::consts::TAU + 1e-3;
    (turns && symmetry > 0).then(|| {
        let meant = (azimuth_rad.to_radians() * 1e4).round() / 1e4;
        let message = format!(
            "the azimuth of C{order}{symmetry} is {azimuth_rad} rad, more than a turn; azimuths are in radians: \
             {azimuth_rad} degrees are {meant} rad"
        );
        Warning::about(Setting::Aberration, message)
    })
}

/// Refuses coefficients that are given twice, since their sum is hardly intended. The defocus is one of the coefficients.
///
/// # Errors
/// [`Error::Invalid`] naming the coefficient.
pub(crate) fn check_aberrations(
    defocus_angstrom: f64,
    series: bool,
    aberrations: &[Aberration],
) -> Result<()> {
    for (n, a) in aberrations.iter().enumerate() {
        a.validate()?;
        let Aberration { order, symmetry, magnitude_angstrom, .. } = *a;
        let value = format!("C{order}{symmetry}={magnitude_angstrom}");
        if (order, symmetry) == (1, 0) && (defocus_angstrom != 0.0 || series) {
            let expected = format!(
                "C10 is minus the defocus, which is {defocus_angstrom} A: both set it; give one of them"
            );
            return Err(Error::invalid(Setting::Aberration, value, expected));
        }
        if aberrations[..n].iter().any(|b| (b.order, b.symmetry) == (order, symmetry)) {
            return Err(Error::invalid(Setting::Aberration, value, "is given twice; give it once"));
        }
    }
    Ok(())
}

/// Refuses names of output files that do not end as the names of HDF5 files do: other programs choose their reader by the ending.
///
/// # Errors
/// [`Error::Invalid`] with the intended name.
pub fn check_hdf5_name(path: &Path) -> Result<()> {
    let ending = path.extension().map(|ending| ending.to_string_lossy().to_ascii_lowercase());
    let found = match &ending {
        Some(ending) if HDF5.contains(&ending.as_str()) => return Ok(()),
        Some(ending) => format!("its name ends in .{ending}"),
        None => "its name has no ending".into(),
    };
    let expected = format!(
        "the file is HDF5, and {found}; did you mean {}?",
        path.with_extension("h5").display()
    );
    Err(Error::invalid(Setting::OutputName, path.display(), expected))
}

/// A warning about a scan that leaves the cell of `size` (x, y) in Angstrom, which repeats.
///
/// # Errors
/// [`Error::Invalid`] for a scan that is longer than two cells.
pub(super) fn check_scan(scan: &Scan, size: [f64; 2]) -> Result<Option<Warning>> {
    let [[x0, x1], [y0, y1]] = ends(scan);
    for (name, length, cell) in [("x", x1 - x0, size[0]), ("y", y1 - y0, size[1])] {
        if length > 2.0 * cell + SAME_ANGSTROM {
            let expected = format!(
                "the cell is {cell:.3} A long along {name} and repeats: a longer scan shows it again. Did you mean an end within \
                 {:.3},{:.3} A? Repeat the cell for a larger one",
                size[0], size[1]
            );
            let value = format!("{length:.1} A along {name}");
            return Err(Error::invalid(Setting::Scan, value, expected));
        }
    }
    for (name, from, to, cell) in [("x", x0, x1, size[0]), ("y", y0, y1, size[1])] {
        if from < -SAME_ANGSTROM || to > cell + SAME_ANGSTROM {
            let message = format!(
                "the scan runs from {from:.3} to {to:.3} A along {name}, and the cell from 0 to {cell:.3} A: outside the cell, the image \
                 shows the cell again"
            );
            return Ok(Some(Warning::about(Setting::Scan, message)));
        }
    }
    Ok(None)
}

/// First and last edge of a scan along x and along y, in Angstrom.
fn ends(scan: &Scan) -> [[f64; 2]; 2] {
    let ([x, y], [dx, dy], [rows, columns]) =
        (scan.origin_angstrom, scan.step_angstrom, scan.shape);
    [[x, x + dx * columns as f64], [y, y + dy * rows as f64]]
}

/// A warning about a cell of `size` (x, y) in Angstrom that is narrower than a probe's tails. `repeat` holds the number of repetitions of
/// the smaller cell that it was made from.
pub(super) fn check_cell(size: [f64; 2], repeat: [usize; 3]) -> Option<Warning> {
    let [x, y] = size;
    (x.min(y) < NARROW_CELL_ANGSTROM).then(|| {
        let times = |length: f64, given: usize| (1.5 * NARROW_CELL_ANGSTROM / length).ceil() * given as f64;
        let message = format!(
            "the cell of {x:.2} x {y:.2} A is narrow: a probe meets its own periodic images; repeat it {},{},{} times and end the scan at \
             {x:.4},{y:.4} A for an image of this area in a wider cell",
            times(x, repeat[0]),
            times(y, repeat[1]),
            repeat[2]
        );
        Warning::about(Setting::Repeat, message)
    })
}

/// Refuses places of probes (x, y) in Angstrom more than one cell outside a cell of `size`, which repeats.
///
/// # Errors
/// [`Error::Invalid`] with the place.
pub(super) fn check_places(places: &[[f64; 2]], size: [f64; 2]) -> Result<()> {
    let near = |place: &[f64; 2]| {
        place.iter().zip(size).all(|(at, cell)| (-cell..=2.0 * cell).contains(at))
    };
    let Some(number) = places.iter().position(|place| !near(place)) else { return Ok(()) };
    let [x, y] = places[number];
    let expected = format!(
        "the cell of {:.3} x {:.3} A repeats, and this place is more than one cell outside; expected places in the cell (check the \
         unit)",
        size[0], size[1]
    );
    Err(Error::invalid(Setting::Region, format!("places[{number}] at {x}, {y} A"), expected))
}

/// Rounds a value, so that 0.068 rad become 68 mrad.
fn rounded(value: f64) -> f64 {
    (value * 1e6).round() / 1e6
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_in_radians_are_found() {
        let message = check_detector(&Detector::new("HAADF", 0.068, 0.2)).unwrap_err().to_string();
        assert!(message.contains("did you mean HAADF=68-200?"), "{message}");
        check_detector(&Detector::new("BF", 0.0, 5.0)).unwrap();
        assert!(check_semiangle(0.03).unwrap_err().to_string().contains("did you mean 30?"));
        assert!(check_semiangle(1.0).is_ok() && check_semiangle(5e-324).is_ok());
        assert!(check_energy(200e3).unwrap_err().to_string().contains("did you mean 200?"));
    }

    #[test]
    fn azimuths_in_degrees_are_found() {
        let message =
            |text: &str| check_azimuth(&Aberration::parse(text).unwrap()).map(|w| w.message);
        assert!(message("C12=30@45").unwrap().contains("45 degrees are 0.7854 rad"));
        assert!(message("C23=30@-90").is_some());
        for usual in ["C12=30@0.3", "C12=30@6.28318", "C12=30@-3.1", "C30=1e5@90", "C12=30"] {
            assert_eq!(message(usual), None, "{usual}");
        }
    }

    #[test]
    fn scans_that_leave_the_cell_give_a_warning_and_long_ones_are_refused() {
        let scan = |origin_angstrom, [x, y]: [f64; 2]| Scan {
            origin_angstrom,
            step_angstrom: [x / 4.0, y / 5.0],
            shape: [5, 4],
        };
        assert_eq!(check_scan(&scan([0.0; 2], [22.0, 22.0]), [22.0; 2]).unwrap(), None);
        let left = check_scan(&scan([-1.0, 0.0], [5.0, 5.0]), [22.0; 2]).unwrap().unwrap();
        assert!(left.message.contains("from -1.000 to 4.000 A along x"), "{left:?}");
        let error = check_scan(&scan([0.0; 2], [5.0, 500.0]), [22.0; 2]).unwrap_err().to_string();
        assert!(error.contains("500.0 A along y") && error.contains("22.000,22.000"), "{error}");
    }

    #[test]
    fn narrow_cells_give_a_warning_with_the_wider_one() {
        let message = check_cell([5.431, 5.431], [1, 1, 10]).unwrap();
        assert_eq!(message.setting, Some(Setting::Repeat));
        assert!(message.message.contains("repeat it 3,3,10 times"), "{message:?}");
        assert_eq!(check_cell([10.0, 30.0], [1; 3]), None);
    }

    #[test]
    fn places_far_outside_are_refused() {
        check_places(&[[0.0, 0.0], [-5.0, 9.9]], [5.0, 5.0]).unwrap();
        let message = check_places(&[[0.0, 0.0], [11.0, 0.0]], [5.0, 5.0]).unwrap_err().to_string();
        assert!(message.contains("places[1] at 11, 0 A"), "{message}");
    }

    #[test]
    fn names_of_other_formats_are_refused() {
        for good in ["a.h5", "a.HDF5"] {
            check_hdf5_name(Path::new(good)).unwrap();
        }
        for wrong in ["x.tif", "x"] {
            let message = check_hdf5_name(Path::new(wrong)).unwrap_err().to_string();
            assert!(message.contains("did you mean x.h5?"), "{message}");
        }
    }
}
