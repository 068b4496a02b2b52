//! Compares the contents that a CIF states with the atoms that were read.

use super::atom_labels::Formula;
use super::atom_tables::CifSite;
use super::tokens::DataBlock;
use crate::structure::elements;

const FORMULA: [&str; 1] = ["_chemical_formula_sum"];
const UNITS: [&str; 1] = ["_cell_formula_units_z"];
const MULTIPLICITY: [&str; 2] =
    ["_atom_site_symmetry_multiplicity", "_atom_site_site_symmetry_multiplicity"];
/// Amounts of an element count as equal if they differ by less than this share, ...
const SAME_SHARE: f64 = 0.03;
/// ... or by less than this many atoms in a formula unit.
const SAME_AMOUNT: f64 = 0.02;
/// Atomic number of hydrogen.
const HYDROGEN: u8 = 1;

/// Reads the formula of a data block; `None` if there is none, or if it cannot be read.
pub fn formula(block: &DataBlock) -> Option<Formula> {
    let (_, word) = block.get(&FORMULA)?;
    parse(word)
}

/// Reads `Ca0.5 Sr0.5 Ti O3`, with or without blanks.
fn parse(word: &str) -> Option<Formula> {
    let mut formula = Formula::new();
    let mut rest = word.trim();
    while !rest.is_empty() {
        let small = rest.chars().nth(1).is_some_and(|c| c.is_ascii_lowercase());
        let symbol = rest.get(..1 + usize::from(small))?;
        let number = match symbol {
            "D" => HYDROGEN,
            _ if symbol.starts_with(|c: char| c.is_ascii_uppercase()) => {
                elements::atomic_number(symbol).ok()?
            }
            _ => return None,
        };
        rest = &rest[symbol.len()..];
        let end = rest.find(|c: char| !(c.is_ascii_digit() || c == '.')).unwrap_or(rest.len());
        let amount = if end == 0 { 1.0 } else { rest[..end].parse().ok()? };
        *formula.entry(number).or_default() += amount;
        rest = rest[end..].trim_start();
    }
    formula.retain(|_, amount| *amount > 0.0);
    Some(formula).filter(|f| !f.is_empty())
}

/// Reports sites whose multiplicity differs from the one in the file. `counts` are the numbers of images of the sites.
pub fn multiplicity_note(sites: &[CifSite], counts: &[usize]) -> Option<String> {
    let mut wrong = sites.iter().zip(counts).filter_map(|(site, &count)| {
        let stated: usize = site.value(&MULTIPLICITY)?.parse().ok()?;
        (stated != count).then(|| (site.name(), stated, count))
    });
    let (name, stated, count) = wrong.next()?;
    let more = match wrong.count() {
        0 => String::new(),
        n => format!(" (and {n} more sites)"),
    };
    Some(format!(
        "site `{name}`{more}: its multiplicity in the file is {stated}, and the symmetry operations make {count} of it; check the \
         symmetry operations and the coordinates"
    ))
}

/// Reports a composition that differs from the formula; `read` is the composition of the cell.
pub fn composition_note(block: &DataBlock, read: &Formula) -> Option<String> {
    let formula = formula(block)?;
    let z: Option<f64> =
        block.get(&UNITS).and_then(|(_, word)| word.parse().ok()).filter(|z| *z > 0.0);
    let heavy = |f: &Formula| -> f64 {
        f.iter().filter(|(number, _)| **number != HYDROGEN).map(|(_, amount)| amount).sum()
    };
    let (of_read, of_formula) = (heavy(read), heavy(&formula));
    let fitted = if of_formula > 0.0 && of_read > 0.0 { of_read / of_formula } else { 1.0 };
    let wrong = |units: f64| -> Vec<u8> {
        let amount = |f: &Formula, number: &u8| f.get(number).copied().unwrap_or(0.0);
        let mut all: Vec<u8> = formula.keys().chain(read.keys()).copied().collect();
        all.sort_unstable();
        all.dedup();
        all.retain(|number| {
            let (here, there) = (amount(read, number), units * amount(&formula, number));
            (here - there).abs() > SAME_SHARE * there + SAME_AMOUNT * units.max(1.0)
        });
        all
    };
    let units = z.unwrap_or(fitted);
    let differing = wrong(units);
    // Some programs (pymatgen) write the formula of the whole cell next to the number of formula units.
    let whole = |amount: &f64| (amount / units - (amount / units).round()).abs() < 1e-3;
    let of_cell = units > 1.0 && formula.values().all(whole) && wrong(1.0).is_empty();
    if differing.is_empty() || of_cell {
        return None;
    }
    let cause = match differing.as_slice() {
        [HYDROGEN] => "hydrogen is not among the sites".to_owned(),
        _ if z.is_some() && wrong(fitted).is_empty() => {
            format!(
                "the atoms make up {fitted:.3} formula units; symmetry operations may be missing or too many"
            )
        }
        _ => format!("check {}", symbols(&differing)),
    };
    let stated = z.map_or(String::new(), |z| format!(" with _cell_formula_units_Z {z}"));
    Some(format!(
        "the cell holds {} as read, and by _chemical_formula_sum{stated} it holds {}: {cause}",
        amounts(read, 1.0),
        amounts(&formula, units)
    ))
}

fn symbols(numbers: &[u8]) -> String {
    numbers.iter().map(|n| elements::symbol(*n)).collect::<Vec<_>>().join(", ")
}

/// Writes `Ti 3, O 9`.
fn amounts(formula: &Formula, units: f64) -> String {
    let part = |(number, amount): (&u8, &f64)| {
        format!("{} {}", elements::symbol(*number), (amount * units * 1e3).round() / 1e3)
    };
    formula.iter().map(part).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn formulas_are_read() {
        let of = |word: &str| parse(word).map(|f| f.into_iter().collect::<Vec<_>>());
        assert_eq!(of("Ca0.5 O3 D2"), Some(vec![(1, 2.0), (8, 3.0), (20, 0.5)]));
        assert_eq!(of("SrTiO3"), of("O3 Sr Ti"));
        for bad in ["(H2 O)n", "Xx2", "2H", "ca", "", "?", "O1.2.3", "Ä"] {
            assert_eq!(of(bad), None, "{bad}");
        }
    }
}
