//! Element symbols.

pub(crate) use crate::constants::MAX_ATOMIC_NUMBER;
use crate::error::{Error, Result};

const SYMBOLS: [&str; MAX_ATOMIC_NUMBER as usize] = [
    "H", "He", "Li", "Be", "B", "C", "N", "O", "F", "Ne", "Na", "Mg", "Al", "Si", "P", "S", "Cl",
    "Ar", "K", "Ca", "Sc", "Ti", "V", "Cr", "Mn", "Fe", "Co", "Ni", "Cu", "Zn", "Ga", "Ge", "As",
    "Se", "Br", "Kr", "Rb", "Sr", "Y", "Zr", "Nb", "Mo", "Tc", "Ru", "Rh", "Pd", "Ag", "Cd", "In",
    "Sn", "Sb", "Te", "I", "Xe", "Cs", "Ba", "La", "Ce", "Pr", "Nd", "Pm", "Sm", "Eu", "Gd", "Tb",
    "Dy", "Ho", "Er", "Tm", "Yb", "Lu", "Hf", "Ta", "W", "Re", "Os", "Ir", "Pt", "Au", "Hg", "Tl",
    "Pb", "Bi", "Po", "At", "Rn", "Fr", "Ra", "Ac", "Th", "Pa", "U", "Np", "Pu", "Am", "Cm", "Bk",
    "Cf", "Es", "Fm", "Md", "No", "Lr",
];

/// Returns the symbol of an element; `"?"` beyond the table.
pub fn symbol(number: u8) -> &'static str {
    SYMBOLS.get((number as usize).wrapping_sub(1)).copied().unwrap_or("?")
}

/// Returns the atomic number of a symbol (`Sr`, any case) or of a number written as text (`38`).
///
/// # Errors
/// [`Error::UnknownElement`].
pub fn atomic_number(text: &str) -> Result<u8> {
    let text = text.trim();
    let by_symbol = SYMBOLS.iter().position(|s| s.eq_ignore_ascii_case(text)).map(|i| i as u8 + 1);
    let by_number = || text.parse().ok().filter(|n| (1..=MAX_ATOMIC_NUMBER).contains(n));
    by_symbol.or_else(by_number).ok_or_else(|| Error::UnknownElement(text.to_owned()))
}
