//! Units in which files give the size of a pixel.

/// Edge of a pixel in nm, or the reason why it is not known.
pub(crate) type StatedPixel = std::result::Result<f64, String>;

/// Largest relative difference of the sides of a square pixel.
const SQUARE: f64 = 1e-3;

/// Returns a unit of length in nm, in the spellings of various programs.
pub(crate) fn unit_nm(unit: &str) -> Option<f64> {
    let plain = unit.trim().trim_matches(['[', ']', '(', ')']).replace('_', "");
    Some(match plain.as_str() {
        "m" | "meter" | "metre" | "meters" => 1e9,
        "inch" | "in" => 2.54e7,
        "cm" | "centimeter" => 1e7,
        "mm" | "millimeter" => 1e6,
        "um" | "\u{b5}m" | "\u{3bc}m" | "micron" | "microns" | "micrometer" => 1e3,
        "nm" | "nanometer" | "nanometre" | "nanometers" => 1.0,
        "A" | "Ang" | "\u{c5}" | "\u{212b}" | "A\u{30a}" | "angstrom" | "Angstrom"
        | "\u{c5}ngstrom" | "Angstroms" | "angstroms" => 0.1,
        "pm" | "picometer" => 1e-3,
        _ => return None,
    })
}

/// Returns the edge of a pixel in nm from its sides along x and y with their units.
pub(crate) fn square_nm(sides: [(f64, &str); 2]) -> StatedPixel {
    let [(x, unit_x), (y, unit_y)] = sides;
    let said = || format!("it states {x} `{unit_x}` x {y} `{unit_y}`");
    let (Some(unit_x), Some(unit_y)) = (unit_nm(unit_x), unit_nm(unit_y)) else {
        return Err(format!("{}, which is no length", said()));
    };
    // Axes that run backwards have negative steps.
    let [x_nm, y_nm] = [x * unit_x, y * unit_y].map(f64::abs);
    if !(x_nm.is_finite() && y_nm.is_finite() && x_nm > 0.0 && y_nm > 0.0) {
        return Err(said());
    }
    if (x_nm / y_nm - 1.0).abs() > SQUARE {
        return Err(format!(
            "{}: the pixels are not square, and a world needs square pixels",
            said()
        ));
    }
    Ok(0.5 * (x_nm + y_nm))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_of_length_are_known() {
        for (unit, nm) in
            [("nm", 1.0), ("\u{b5}m", 1e3), ("m", 1e9), ("[n_m]", 1.0), ("\u{c5}", 0.1)]
        {
            assert_eq!(square_nm([(2.0, unit), (-2.0, unit)]), Ok(2.0 * nm), "{unit}");
        }
        for unit in ["", "1/nm", "px", "eV", "_None_"] {
            assert!(square_nm([(1.0, unit), (1.0, unit)]).unwrap_err().contains("no length"));
        }
        assert!(square_nm([(1.0, "nm"), (1.01, "nm")]).unwrap_err().contains("not square"));
        assert!(square_nm([(0.0, "nm"), (0.0, "nm")]).is_err());
        assert!(square_nm([(f64::NAN, "nm"), (1.0, "nm")]).is_err());
    }
}
