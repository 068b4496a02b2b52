//! The atomic planes of a crystal parallel to an interface.

use std::collections::BTreeMap;

use crate::structure::lattice::gcd;
use crate::structure::{Structure, elements};

/// Atoms farther apart along the normal than this, in Angstrom, belong to different planes.
const SAME_PLANE_ANGSTROM: f64 = 0.3;

/// A plane of atoms in the box of a crystal.
#[derive(Debug, Clone, PartialEq)]
pub struct AtomicPlane {
    /// Mean position along the normal, in cells; from 0 to below 1.
    pub fraction: f64,
    /// Least and greatest distance of its atoms from the mean position, in Angstrom.
    pub spread_angstrom: [f64; 2],
    /// Numbers of atoms of each element without a common divisor.
    pub formula: BTreeMap<u8, usize>,
}

impl AtomicPlane {
    /// Returns the formula: `O2Ti` as `TiO2`, the heavier element first.
    pub fn name(&self) -> String {
        let count = |n: usize| if n == 1 { String::new() } else { n.to_string() };
        let parts = self.formula.iter().rev();
        parts.map(|(z, n)| format!("{}{}", elements::symbol(*z), count(*n))).collect()
    }
}

/// Returns the atomic planes of a crystal in an orthogonal box perpendicular to an axis (0 is x), by their positions.
pub fn atomic_planes(crystal: &Structure, axis: usize) -> Vec<AtomicPlane> {
    let length = crystal.cell[axis][axis];
    let mut atoms: Vec<(f64, u8)> = crystal
        .atoms
        .iter()
        .map(|atom| ((atom.position[axis] / length).rem_euclid(1.0), atom.number))
        .collect();
    atoms.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let apart = |a: f64, b: f64| (b - a) * length > SAME_PLANE_ANGSTROM;
    // The list begins behind a gap, so that no plane lies at both ends of the cell.
    let wraps = match (atoms.first(), atoms.last()) {
        (Some(first), Some(last)) => !apart(last.0, first.0 + 1.0),
        _ => false,
    };
    if wraps {
        let begin = (1..atoms.len()).find(|n| apart(atoms[n - 1].0, atoms[*n].0)).unwrap_or(0);
        atoms[..begin].iter_mut().for_each(|atom| atom.0 += 1.0);
        atoms.rotate_left(begin);
    }
    let planes = atoms.chunk_by(|a, b| !apart(a.0, b.0));
    let mut planes: Vec<AtomicPlane> = planes.map(|atoms| plane(atoms, length)).collect();
    planes.sort_by(|a, b| a.fraction.total_cmp(&b.fraction));
    planes
}

fn plane(atoms: &[(f64, u8)], length: f64) -> AtomicPlane {
    let mean = atoms.iter().map(|(f, _)| f).sum::<f64>() / atoms.len() as f64;
    let mut formula = BTreeMap::new();
    atoms.iter().for_each(|(_, number)| *formula.entry(*number).or_insert(0) += 1);
    let ends = [atoms[0].0, atoms[atoms.len() - 1].0];
    // A fraction that rounding puts just below 1 is 0.
    let fraction = mean.rem_euclid(1.0);
    AtomicPlane {
        fraction: if fraction > 1.0 - 1e-9 { 0.0 } else { fraction },
        spread_angstrom: ends.map(|f| (f - mean) * length),
        formula: reduced(formula),
    }
}

/// Divides the numbers of atoms by their greatest common divisor.
fn reduced(formula: BTreeMap<u8, usize>) -> BTreeMap<u8, usize> {
    let divisor = formula.values().copied().fold(0, gcd).max(1);
    formula.into_iter().map(|(z, n)| (z, n / divisor)).collect()
}

/// Reads a formula such as `TiO2`: numbers of atoms of each element without a common divisor.
///
/// # Errors
/// A sentence that describes how formulas are written.
pub fn parse_formula(text: &str) -> Result<BTreeMap<u8, usize>, String> {
    let expected = || "expected a formula with whole numbers such as \"TiO2\"".to_owned();
    let mut formula = BTreeMap::new();
    let mut rest = text.trim();
    while !rest.is_empty() {
        let letters = rest.char_indices().skip(1).find(|(_, c)| !c.is_ascii_lowercase());
        let (symbol, after) = rest.split_at(letters.map_or(rest.len(), |(at, _)| at));
        let digits = after.find(|c: char| !c.is_ascii_digit()).unwrap_or(after.len());
        let (count, after) = after.split_at(digits);
        let number =
            elements::atomic_number(symbol).ok().filter(|z| elements::symbol(*z) == symbol);
        let count = if count.is_empty() { Some(1) } else { count.parse::<usize>().ok() };
        let count = count.filter(|n| (1..=1000).contains(n)).ok_or_else(expected)?;
        *formula.entry(number.ok_or_else(expected)?).or_insert(0) += count;
        rest = after;
    }
    if formula.is_empty() { Err(expected()) } else { Ok(reduced(formula)) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::structure::crystals;

    #[test]
    fn perovskite_has_two_planes_and_silicon_pairs_of_planes() {
        let planes = atomic_planes(&crystals::crystal("srtio3").unwrap(), 1);
        let names: Vec<String> = planes.iter().map(AtomicPlane::name).collect();
        assert_eq!(names, ["SrO", "TiO2"]);
        assert_eq!(planes.iter().map(|p| p.fraction).collect::<Vec<_>>(), [0.0, 0.5]);
        assert_eq!(planes[1].formula, parse_formula("TiO2").unwrap());
        let silicon =
            crystals::crystal("si").unwrap().oriented([1, 1, 0], Some([1, -1, 1])).unwrap();
        let planes = atomic_planes(&silicon, 1);
        assert_eq!(planes.len(), 6);
        let gaps: Vec<f64> = planes
            .windows(2)
            .map(|w| (w[1].fraction - w[0].fraction) * silicon.cell[1][1])
            .collect();
        // Spacings of {111}: sqrt(3) a / 12 and sqrt(3) a / 4.
        for gap in gaps {
            let known = [5.431 * 3f64.sqrt() / 12.0, 5.431 * 3f64.sqrt() / 4.0];
            assert!(known.iter().any(|k| (k - gap).abs() < 1e-6), "{gap}");
        }
    }

    #[test]
    fn a_plane_at_the_end_of_the_cell_is_one_plane() {
        let mut crystal = crystals::crystal("srtio3").unwrap();
        crystal.atoms.iter_mut().for_each(|atom| {
            let wobble = if atom.number == 8 { -0.05 } else { 0.05 };
            atom.position[0] = (atom.position[0] + wobble).rem_euclid(3.905);
        });
        let planes = atomic_planes(&crystal, 0);
        assert_eq!(planes.len(), 2);
        assert!(planes.iter().any(|p| p.name() == "SrO"));
        assert!(planes.iter().all(|p| p.spread_angstrom[1] - p.spread_angstrom[0] < 0.11));
    }

    #[test]
    fn formulas_are_read() {
        assert_eq!(parse_formula("Ti2O4").unwrap(), BTreeMap::from([(8, 2), (22, 1)]));
        assert_eq!(parse_formula("SiO2").unwrap(), BTreeMap::from([(8, 2), (14, 1)]));
        for bad in ["", "tio2", "Xx", "O0", "Ti-O"] {
            assert!(parse_formula(bad).is_err(), "{bad}");
        }
    }
}
