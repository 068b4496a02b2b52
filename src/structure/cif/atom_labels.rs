//! Finds the element that a type symbol or a label of an atom stands for.

use std::collections::BTreeMap;

use crate::structure::elements;

/// Meaning of a type symbol or a label.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NamedAtom {
    /// Atomic number.
    pub number: u8,
    /// Whether the name means a water molecule or a hydroxyl group, whose hydrogen is left out.
    pub without_hydrogen: bool,
}

/// Number of atoms of each element in a formula.
pub type Formula = BTreeMap<u8, f64>;

/// Atomic number of oxygen.
const OXYGEN: u8 = 8;
/// Names of water, in capitals.
const WATER: [&str; 4] = ["WAT", "WATER", "HOH", "AQ"];
/// Elements whose symbol may be followed by a small letter that distinguishes sites: `Ow1`, `Oa`, `Cb`.
const SITE_LETTER: [u8; 6] = [1, 6, 7, 8, 9, 16];

fn atom(number: u8) -> NamedAtom {
    NamedAtom { number, without_hydrogen: false }
}

fn letters(text: &str) -> String {
    text.chars().take_while(char::is_ascii_alphabetic).collect()
}

/// Recognises water and hydroxyl: `Wat1`, `H2O`, `OH2`; `OH` only as a type.
fn group_with_hydrogen(name: &str, is_type: bool) -> Option<NamedAtom> {
    let upper = name.to_ascii_uppercase();
    let formula = ["H2O", "OH2"].iter().any(|water| {
        let rest = upper.strip_prefix(water);
        rest.is_some_and(|r| !r.starts_with(|c: char| c.is_ascii_alphanumeric()) || !is_type)
    });
    let word = letters(&upper);
    let known = WATER.contains(&word.as_str()) || is_type && word == "OH" || formula;
    known.then_some(NamedAtom { number: OXYGEN, without_hydrogen: true })
}

/// Reads a type symbol, `Sr`, `Sr2+` or `O2-`; deuterium is read as hydrogen.
pub fn from_type_symbol(symbol: &str) -> Option<NamedAtom> {
    if let Some(group) = group_with_hydrogen(symbol, true) {
        return Some(group);
    }
    element(&letters(symbol)).map(atom)
}

fn element(symbol: &str) -> Option<u8> {
    match symbol.to_ascii_uppercase().as_str() {
        "" => None,
        "D" => Some(1),
        _ => elements::atomic_number(symbol).ok(),
    }
}

/// Reads the element at the start of `Sr1`, `O2a` or `OW1`; the error gives the reason if there is none. A formula restricts the possible
/// elements.
pub fn from_label(label: &str, formula: Option<&Formula>) -> Result<NamedAtom, String> {
    if let Some(group) = group_with_hydrogen(label, false) {
        return Ok(group);
    }
    let word = letters(label);
    let cure = "add a column _atom_site_type_symbol";
    let [one, two] = candidates(&word, formula)
        .map(|number| number.filter(|z| formula.is_none_or(|formula| formula.contains_key(z))));
    // A complete symbol of two letters is read as its element, even if the formula lacks it.
    let two = if one.is_none() { two.or_else(|| whole_symbol(&word)) } else { two };
    match (one, two) {
        (Some(one), Some(two)) if word.chars().nth(1).is_some_and(|c| c.is_ascii_uppercase()) => {
            let [one, two] = [one, two].map(elements::symbol);
            Err(format!("label `{label}` may mean {one} or {}; {cure}", two.to_ascii_uppercase()))
        }
        (_, Some(number)) | (Some(number), None) => Ok(atom(number)),
        (None, None) if candidates(&word, None) != [None; 2] => {
            let known = formula.map(|formula| {
                formula.keys().map(|z| elements::symbol(*z)).collect::<Vec<_>>().join(" ")
            });
            Err(format!(
                "label `{label}` begins with no element of _chemical_formula_sum ({}); {cure}",
                known.unwrap_or_default()
            ))
        }
        (None, None) => Err(format!("label `{label}` begins with no element symbol; {cure}")),
    }
}

/// Returns the element of a word such as `Mn`.
fn whole_symbol(word: &str) -> Option<u8> {
    let small = word.chars().nth(1).is_some_and(|c| c.is_ascii_lowercase());
    if word.len() == 2 && small { element(word) } else { None }
}

/// Returns the elements of the first letter and of the first two letters. Words are excluded: `Vac` is no vanadium, and `RE` is any rare
/// earth unless the formula holds rhenium.
fn candidates(word: &str, formula: Option<&Formula>) -> [Option<u8>; 2] {
    let first = |count: usize| word.get(..count).and_then(element);
    let small = |at: usize| word[at..].starts_with(|c: char| c.is_ascii_lowercase());
    if word.len() > 2 && small(1) && small(2) {
        return [None; 2];
    }
    let known = |z: &u8| formula.is_some_and(|formula| formula.contains_key(z));
    let two = first(2).filter(|z| !word.starts_with("RE") || known(z));
    match two {
        None if word.len() > 1 && small(1) => [first(1).filter(|z| SITE_LETTER.contains(z)), None],
        _ => [first(1), two],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_and_type_symbols() {
        for (text, z) in [("Sr2+", 38), ("O2-", 8), ("Ti4+", 22), ("D", 1), ("SR", 38)] {
            assert_eq!(from_type_symbol(text), Some(atom(z)), "{text}");
        }
        let of = |label: &str| from_label(label, None);
        for (text, z) in [
            ("Sr1", 38),
            ("O2", 8),
            ("OW1", 8),
            ("Ow1", 8),
            ("Ti", 22),
            ("TI1", 22),
            ("Ga1A", 31),
            ("SiT1", 14),
            ("CaM2", 20),
        ] {
            assert_eq!(of(text), Ok(atom(z)), "{text}");
        }
        assert!(of("CA1").unwrap_err().contains("may mean C or CA"));
        for word in ["X1", "RE1", "Ree1", "Vac1", "Und", "Va2", "Site1", "Wa1", "M1", "1", ""] {
            assert!(of(word).unwrap_err().contains("_atom_site_type_symbol"), "{word}");
        }
        assert_eq!(from_type_symbol("Vac"), None);
        for water in ["Wat1", "WAT", "wat2", "H2O1", "OH2A", "HOH"] {
            let found = of(water).unwrap();
            assert!(found.number == 8 && found.without_hydrogen, "{water}");
        }
        for water in ["Wat", "H2O", "OH", "OH-"] {
            assert!(from_type_symbol(water).unwrap().without_hydrogen, "{water}");
        }
        assert_eq!(of("H21"), Ok(atom(1)));
        assert_eq!(from_type_symbol("H2"), Some(atom(1)));
    }

    #[test]
    fn the_formula_tells_labels_apart() {
        let yo = Formula::from([(39, 1.0), (8, 1.0)]);
        assert!(from_label("RE1", Some(&yo)).unwrap_err().contains("RE1"));
        assert!(from_label("W1", Some(&yo)).unwrap_err().contains("(O Y)"));
        assert_eq!(from_label("Y1", Some(&yo)), Ok(atom(39)));
        let calcium = Formula::from([(20, 1.0), (8, 1.0)]);
        assert_eq!(from_label("CA1", Some(&calcium)), Ok(atom(20)));
        assert_eq!(from_label("Mn1", Some(&calcium)), Ok(atom(25)));
        let carbon = Formula::from([(6, 1.0), (8, 1.0)]);
        assert_eq!(from_label("CA1", Some(&carbon)), Ok(atom(6)));
    }
}
