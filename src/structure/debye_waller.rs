//! Thermal displacements in crystals of one element, from tables.

use super::elements;
use crate::error::{Error, Result};
use crate::setting::Setting;

/// Room temperature in K.
pub(crate) const ROOM_TEMPERATURE_K: f64 = 293.0;
/// Temperatures in K for which the table is used: below, zero-point motion bends the curves; above, anharmonic motion does.
pub(crate) const TABLE_TEMPERATURES_K: [f64; 2] = [200.0, 400.0];

/// Temperatures of the two columns in K.
const COLUMNS_K: [f64; 2] = [210.0, 280.0];
/// Debye-Waller factors B in square Angstrom at both temperatures: L.-M. Peng, G. Ren, S. L. Dudarev and M. J. Whelan, Acta Cryst. A 52
/// (1996) 456, table 1. Iron is body-centred, calcium face-centred, carbon diamond.
const TABLE: [(&str, [f64; 2]); 38] = [
    ("Li", [3.4477, 4.5950]),
    ("Be", [0.3032, 0.4040]),
    ("C", [0.1363, 0.1420]),
    ("Na", [4.7802, 6.3640]),
    ("Mg", [1.2996, 1.7310]),
    ("Al", [0.5596, 0.7460]),
    ("Si", [0.3476, 0.4630]),
    ("K", [7.7077, 10.2390]),
    ("Ca", [1.4328, 1.9080]),
    ("Sc", [0.5346, 0.7120]),
    ("Ti", [0.3684, 0.4910]),
    ("V", [0.4100, 0.5460]),
    ("Cr", [0.1799, 0.2390]),
    ("Fe", [0.2330, 0.3100]),
    ("Ni", [0.2551, 0.3400]),
    ("Cu", [0.3947, 0.5260]),
    ("Zn", [0.8190, 1.0910]),
    ("Ge", [0.4302, 0.5730]),
    ("Rb", [9.5392, 12.6040]),
    ("Sr", [2.7243, 3.6220]),
    ("Y", [0.6137, 0.8170]),
    ("Zr", [0.4078, 0.5430]),
    ("Nb", [0.3225, 0.4290]),
    ("Mo", [0.1545, 0.2050]),
    ("Pd", [0.3196, 0.4250]),
    ("Ag", [0.5267, 0.7017]),
    ("Sn", [0.8123, 1.0825]),
    ("Cs", [12.8022, 16.7698]),
    ("Ba", [2.2046, 2.9279]),
    ("La", [1.3345, 1.7739]),
    ("Tb", [0.7259, 0.9660]),
    ("Ho", [0.6028, 0.8023]),
    ("Ta", [0.2310, 0.3078]),
    ("W", [0.1145, 0.1526]),
    ("Pt", [0.2670, 0.3557]),
    ("Au", [0.4448, 0.5925]),
    ("Pb", [1.5318, 2.0341]),
    ("Th", [0.5241, 0.6977]),
];

/// Returns the standard deviation in Angstrom of each Cartesian component of the displacement of an atom in the crystal of its element: the
/// root of `B / (8 pi^2)`. Between and beyond the two temperatures of the table, B is interpolated linearly.
///
/// # Errors
/// [`Error::Invalid`] for elements that the table lacks, and temperatures outside [`TABLE_TEMPERATURES_K`].
pub(crate) fn tabulated_sigma_angstrom(number: u8, temperature_k: f64) -> Result<f64> {
    let [least, most] = TABLE_TEMPERATURES_K;
    if !(least..=most).contains(&temperature_k) {
        let expected = format!("expected {least} to {most} K");
        return Err(Error::invalid(Setting::Temperature, temperature_k, expected));
    }
    let symbol = elements::symbol(number);
    let Some((_, [low, high])) = TABLE.iter().find(|(known, _)| *known == symbol) else {
        let expected = format!(
            "the table holds crystals of one element, and {symbol} is not among them; give a length in A for each element"
        );
        return Err(Error::invalid(Setting::ThermalSigma, "table", expected));
    };
    let share = (temperature_k - COLUMNS_K[0]) / (COLUMNS_K[1] - COLUMNS_K[0]);
    let b = (1.0 - share) * low + share * high;
    Ok((b / (8.0 * std::f64::consts::PI.powi(2))).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Other columns of the table (B in square Angstrom), and a measured value: silicon at room temperature, 0.461 (P. J. E. Aldred and M.
    /// Hart, Proc. R. Soc. A 332 (1973) 223), which the table meets within 6 %.
    #[test]
    fn temperatures_between_are_those_of_the_paper() {
        let b = |symbol: &str, kelvin: f64| {
            let number = elements::atomic_number(symbol).unwrap();
            let sigma = tabulated_sigma_angstrom(number, kelvin).unwrap();
            8.0 * std::f64::consts::PI.powi(2) * sigma * sigma
        };
        for (symbol, kelvin, expected) in [
            ("Al", 240.0, 0.6395),
            ("Si", 260.0, 0.4303),
            ("C", 240.0, 0.1386),
            ("Pt", 230.0, 0.2924),
            ("Au", 270.0, 0.5714),
            ("W", 220.0, 0.1199),
        ] {
            assert!((b(symbol, kelvin) / expected - 1.0).abs() < 0.005, "{symbol} {kelvin}");
        }
        assert!((b("Si", 293.0) / 0.461 - 1.0).abs() < 0.06);
    }

    #[test]
    fn what_the_table_lacks_is_said() {
        let message = tabulated_sigma_angstrom(8, 293.0).unwrap_err().to_string();
        assert!(message.contains("O is not among them"), "{message}");
        let message = tabulated_sigma_angstrom(14, 77.0).unwrap_err().to_string();
        assert!(message.contains("200 to 400 K"), "{message}");
    }
}
