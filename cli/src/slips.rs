//! Likely slips: values that are possible, but hardly meant.

use anyhow::bail;
use std::path::Path;
use stemgen::optics::Aberration;

/// Angles below this in mrad are taken for radians.
const LEAST_ANGLE_MRAD: f64 = 1.0;
/// Semiangles below this in mrad are taken for radians.
const LEAST_SEMIANGLE_MRAD: f64 = 0.1;
/// Endings of files that hold HDF5.
const HDF5: [&str; 5] = ["h5", "hdf5", "hdf", "he5", "nxs"];

/// What to say of a detector whose angles look like radians.
pub fn detector_in_radians(name: &str, [inner, outer]: [f64; 2]) -> Option<String> {
    let [a, b] = [inner, outer].map(|v| round(1e3 * v));
    (outer < LEAST_ANGLE_MRAD).then(|| {
        format!(
            "angles are in mrad, and {inner}-{outer} mrad lie within the unscattered beam; did you mean {name}={a}-{b}?"
        )
    })
}

/// What to say of a semiangle that looks like radians.
pub fn semiangle_in_radians(semiangle: f64) -> Option<String> {
    (1e-3..LEAST_SEMIANGLE_MRAD).contains(&semiangle).then(|| {
        let meant = round(1e3 * semiangle);
        format!("the semiangle is in mrad; did you mean {meant}? (at least {LEAST_SEMIANGLE_MRAD} is taken)")
    })
}

/// What to say of an energy that looks like electronvolts.
pub fn energy_in_ev(energy: f64) -> Option<String> {
    (1e4..3e6)
        .contains(&energy)
        .then(|| format!("the energy is in keV; did you mean {}?", energy / 1e3))
}

/// What to say of an azimuth that looks like degrees: it is more than a turn.
pub fn azimuth_in_degrees(aberration: &Aberration) -> Option<String> {
    let Aberration { order, symmetry, azimuth_rad, .. } = *aberration;
    let turns = azimuth_rad.abs() > std::f64::consts::TAU + 1e-3;
    (turns && symmetry > 0).then(|| {
        let meant = (azimuth_rad.to_radians() * 1e4).round() / 1e4;
        format!(
            "the azimuth of C{order}{symmetry} is {azimuth_rad} rad, more than a turn; azimuths are in radians: \
             {azimuth_rad} degrees are {meant} rad"
        )
    })
}

/// Rounded, so that 0.068 rad are 68 mrad.
fn round(value: f64) -> f64 {
    (value * 1e6).round() / 1e6
}

/// Refuses coefficients that are given twice: their sum is hardly meant.
pub fn check_aberrations(defocus: f64, aberrations: &[Aberration]) -> anyhow::Result<()> {
    for (n, a) in aberrations.iter().enumerate() {
        let Aberration { order, symmetry, .. } = *a;
        if (order, symmetry) == (1, 0) && defocus != 0.0 {
            bail!(
                "--defocus {defocus} and --aberration C10={} both set the defocus; give one of them (C10 is minus \
                 the defocus)",
                a.magnitude_angstrom
            );
        }
        if aberrations[..n].iter().any(|b| (b.order, b.symmetry) == (order, symmetry)) {
            bail!("--aberration C{order}{symmetry} is given twice; give it once");
        }
    }
    Ok(())
}

/// Refuses names that promise another format than HDF5.
pub fn check_hdf5_name(path: &Path) -> anyhow::Result<()> {
    let Some(ending) = path.extension() else { return Ok(()) };
    let ending = ending.to_string_lossy().to_ascii_lowercase();
    if HDF5.contains(&ending.as_str()) {
        return Ok(());
    }
    bail!(
        "--output {}: the file is HDF5, and its name ends in .{ending}; did you mean {}?",
        path.display(),
        path.with_extension("h5").display()
    )
}

/// What to say of a scan of `extent` from `start` (x, y) in a periodic cell, all in Angstrom.
///
/// # Errors
/// For a scan that is longer than two cells.
pub fn check_scan(
    start: [f64; 2],
    extent: [f64; 2],
    cell: [f64; 2],
) -> anyhow::Result<Option<String>> {
    let axis = |k: usize| ["x", "y"][k];
    if let Some(k) = (0..2).find(|&k| extent[k] > 2.0 * cell[k] + 1e-6) {
        bail!(
            "the scan is {:.1} A long along {}, and the cell {:.3} A, which repeats: nothing new is seen beyond one \
             cell. Did you mean a --scan-end within {:.3},{:.3}? (--repeat makes a larger cell)",
            extent[k],
            axis(k),
            cell[k],
            cell[0],
            cell[1]
        );
    }
    let out = |k: &usize| start[*k] < -1e-6 || start[*k] + extent[*k] > cell[*k] + 1e-6;
    Ok((0..2).find(out).map(|k| {
        format!(
            "the scan runs from {:.3} to {:.3} A along {}, and the cell from 0 to {:.3} A: what lies outside is the \
             cell again",
            start[k],
            start[k] + extent[k],
            axis(k),
            cell[k]
        )
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_in_radians_are_found() {
        let told = detector_in_radians("HAADF", [0.068, 0.2]).unwrap();
        assert!(told.contains("did you mean HAADF=68-200?"), "{told}");
        assert!(detector_in_radians("BF", [0.0, 5.0]).is_none());
        assert!(semiangle_in_radians(0.03).unwrap().contains("did you mean 30?"));
        assert!(semiangle_in_radians(1.0).is_none() && semiangle_in_radians(5e-324).is_none());
        assert!(energy_in_ev(200e3).unwrap().contains("did you mean 200?"));
    }

    #[test]
    fn azimuths_in_degrees_are_found() {
        let told = |text: &str| azimuth_in_degrees(&Aberration::parse(text).unwrap());
        assert!(told("C12=30@45").unwrap().contains("45 degrees are 0.7854 rad"));
        assert!(told("C23=30@-90").is_some());
        for usual in ["C12=30@0.3", "C12=30@6.28318", "C12=30@-3.1", "C30=1e5@90", "C12=30"] {
            assert_eq!(told(usual), None, "{usual}");
        }
    }

    #[test]
    fn scans_that_leave_the_cell_are_told_and_long_ones_refused() {
        assert_eq!(check_scan([0.0; 2], [22.0, 22.0], [22.0; 2]).unwrap(), None);
        let told = check_scan([-1.0, 0.0], [5.0, 5.0], [22.0; 2]).unwrap().unwrap();
        assert!(told.contains("from -1.000 to 4.000 A along x"), "{told}");
        let told = check_scan([0.0; 2], [5.0, 500.0], [22.0; 2]).unwrap_err().to_string();
        assert!(told.contains("500.0 A long along y") && told.contains("--scan-end"), "{told}");
    }

    #[test]
    fn names_of_other_formats_are_refused() {
        for good in ["a.h5", "a", "a.HDF5"] {
            check_hdf5_name(Path::new(good)).unwrap();
        }
        let told = check_hdf5_name(Path::new("x.tif")).unwrap_err().to_string();
        assert!(told.contains("did you mean x.h5?"), "{told}");
    }
}
