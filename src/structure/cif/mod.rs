//! Crystallographic Information Files: cell, symmetry operations and sites.
//!
//! Cell vector a lies along x and b in the xy plane.

mod displacements;
mod symmetry;
mod tokens;

use super::lattice::{Mat3, Vec3, norm, row_times, wrap_unit};
use super::source_text::SourceText;
use super::{Atom, Structure, elements};
use crate::error::Result;
pub(super) use displacements::displacements;
use symmetry::Operation;
use tokens::{CifValue, DataBlock, Loop};

/// Images nearer than this fraction of the cell in every coordinate are one atom ...
const SAME_FRACTION: f64 = 1e-3;
/// ... and so are those nearer than this, in Angstrom.
const SAME_DISTANCE: f64 = 0.01;
/// Largest relative change of the metric by a symmetry operation.
const LARGEST_STRAIN: f64 = 0.01;
/// More operations than any space group has (192), in a cell twice as large as usual.
const MOST_OPERATIONS: usize = 400;

const OPERATIONS: [&str; 2] = ["_space_group_symop_operation_xyz", "_symmetry_equiv_pos_as_xyz"];
const GROUP_NAMES: [&str; 4] = [
    "_space_group_name_h-m_alt",
    "_symmetry_space_group_name_h-m",
    "_space_group_name_hall",
    "_symmetry_space_group_name_hall",
];
const GROUP_NUMBERS: [&str; 2] = ["_space_group_it_number", "_symmetry_int_tables_number"];
const COORDINATES: [&str; 3] = ["_atom_site_fract_x", "_atom_site_fract_y", "_atom_site_fract_z"];

/// Reads the one data block that has atoms.
pub(super) fn parse(text: &SourceText) -> Result<Structure> {
    let blocks = tokens::blocks(text)?;
    let mut with_atoms = blocks.iter().filter(|b| b.table(&COORDINATES).is_some());
    let Some(block) = with_atoms.next() else {
        let message = "no data block has a loop with _atom_site_fract_x, _y and _z";
        return Err(text.error(0, message));
    };
    if let Some(second) = with_atoms.next() {
        let message = format!(
            "data block `{}` is the second with atoms, after `{}`; keep only the one to simulate",
            second.name, block.name
        );
        return Err(text.error(second.line, message));
    }
    let cell = cell(text, block)?;
    let operations = operations(text, block, &cell)?;
    let mut atoms = Vec::new();
    if let Some(table) = block.table(&COORDINATES) {
        let sites = sites(text, table)?;
        text.check_count(table.line, sites.len().saturating_mul(operations.len()))?;
        for site in sites {
            for image in images(&site, &operations, &cell) {
                let position = row_times(image, &cell);
                atoms.push((site.line, Atom { position, ..site.atom }));
            }
        }
    }
    text.finish(cell, atoms)
}

/// The cell in the standard orientation.
fn cell(text: &SourceText, block: &DataBlock) -> Result<Mat3> {
    let get = |tag: &str| -> Result<(usize, f64)> {
        let Some((line, word)) = block.get(&[tag]) else {
            return Err(text.error(block.line, format!("`{tag}` is missing")));
        };
        Ok((line, with_uncertainty(text, line, tag, word)?))
    };
    let (line, a) = get("_cell_length_a")?;
    let (b, c) = (get("_cell_length_b")?.1, get("_cell_length_c")?.1);
    for (tag, length) in ["a", "b", "c"].iter().zip([a, b, c]) {
        if length <= 0.0 {
            let message = format!("_cell_length_{tag} is {length}, expected a length in A");
            return Err(text.error(line, message));
        }
    }
    let mut cosines = [0.0; 3];
    for (cosine, tag) in
        cosines.iter_mut().zip(["_cell_angle_alpha", "_cell_angle_beta", "_cell_angle_gamma"])
    {
        let (line, degrees) = get(tag)?;
        if !(1.0..=179.0).contains(&degrees) {
            let message = format!("{tag} is {degrees}, expected degrees between 1 and 179");
            return Err(text.error(line, message));
        }
        *cosine = cos_degrees(degrees);
    }
    let [alpha, beta, gamma] = cosines;
    let sine = (1.0 - gamma * gamma).sqrt();
    let across = (alpha - beta * gamma) / sine;
    let height = 1.0 - beta * beta - across * across;
    if height <= 0.0 {
        let message = "no cell has these three angles";
        return Err(text.error(get("_cell_angle_alpha")?.0, message));
    }
    let cell =
        [[a, 0.0, 0.0], [b * gamma, b * sine, 0.0], [c * beta, c * across, c * height.sqrt()]];
    text.check_cell(line, &cell)?;
    Ok(cell)
}

/// Cosine, exact where it is a rational number.
fn cos_degrees(degrees: f64) -> f64 {
    match degrees {
        60.0 => 0.5,
        90.0 => 0.0,
        120.0 => -0.5,
        _ => libm::cos(degrees.to_radians()),
    }
}

/// A number such as `3.905(1)`.
fn with_uncertainty(text: &SourceText, line: usize, what: &str, word: &str) -> Result<f64> {
    let plain = match word.split_once('(') {
        Some((value, rest)) => match rest.strip_suffix(')') {
            Some(digits) if digits.chars().all(|c| c.is_ascii_digit() || c == '.') => value,
            _ => word,
        },
        None => word,
    };
    text.number(line, what, plain)
}

/// The symmetry operations; the identity alone for P1 and for files silent about symmetry.
fn operations(text: &SourceText, block: &DataBlock, cell: &Mat3) -> Result<Vec<Operation>> {
    let mut listed: Vec<(usize, &str)> = Vec::new();
    if let Some((table, column)) =
        block.table(&OPERATIONS).and_then(|t| t.column(&OPERATIONS).map(|c| (t, c)))
    {
        listed.extend(table.rows().filter_map(|r| r[column].known().map(|k| (r[column].line, k))));
    }
    listed.extend(block.get(&OPERATIONS));
    if listed.len() > MOST_OPERATIONS {
        let message = format!("more than {MOST_OPERATIONS} symmetry operations");
        return Err(text.error(listed[0].0, message));
    }
    let mut operations = Vec::new();
    for &(line, word) in &listed {
        let operation = Operation::parse(word)
            .map_err(|why| text.error(line, format!("symmetry operation `{word}`: {why}")))?;
        if operation.strain(cell) > LARGEST_STRAIN {
            let message = format!(
                "symmetry operation `{word}` does not fit the cell; check its lengths and angles"
            );
            return Err(text.error(line, message));
        }
        operations.push(operation);
    }
    if let Some((i, j)) = symmetry::missing_product(&operations) {
        let message = format!(
            "the symmetry operations are no group: `{}` after `{}` is not among them; the list \
             is incomplete",
            listed[i].1, listed[j].1
        );
        return Err(text.error(listed[0].0, message));
    }
    if operations.len() <= 1 {
        check_group_is_p1(text, block)?;
        return Ok(vec![Operation::IDENTITY]);
    }
    Ok(operations)
}

/// A group's name or number alone does not fix setting and origin, so nothing is guessed.
fn check_group_is_p1(text: &SourceText, block: &DataBlock) -> Result<()> {
    let fault = |line: usize, group: &str| {
        text.error(
            line,
            format!(
                "space group `{group}`, but its symmetry operations are not listed; add a loop \
                 with _space_group_symop_operation_xyz, or set the group to `P 1` if all atoms \
                 of the cell are listed"
            ),
        )
    };
    for tag in GROUP_NAMES {
        if let Some((line, name)) = block.get(&[tag]) {
            let compact: String = name.chars().filter(|c| !c.is_whitespace()).collect();
            if !compact.eq_ignore_ascii_case("P1") {
                return Err(fault(line, name));
            }
        }
    }
    match block.get(&GROUP_NUMBERS) {
        Some((line, number)) if number != "1" => Err(fault(line, number)),
        _ => Ok(()),
    }
}

/// One row of the atom loop; `atom.position` is fractional.
struct CifSite {
    line: usize,
    atom: Atom,
}

fn sites(text: &SourceText, table: &Loop) -> Result<Vec<CifSite>> {
    let symbol = table.column(&["_atom_site_type_symbol"]);
    let label = table.column(&["_atom_site_label"]);
    let occupancy = table.column(&["_atom_site_occupancy"]);
    let calculated = table.column(&["_atom_site_calc_flag"]);
    let mut sites = Vec::new();
    for row in table.rows() {
        let is = |column: Option<usize>| column.and_then(|c| row[c].known());
        if is(calculated).is_some_and(|flag| flag.eq_ignore_ascii_case("dum")) {
            continue;
        }
        let line = row[0].line;
        let mut position = [0.0; 3];
        for (axis, tag) in COORDINATES.iter().enumerate() {
            let Some(column) = table.column(&[tag]) else {
                return Err(text.error(table.line, format!("the atoms have no column `{tag}`")));
            };
            position[axis] = coordinate(text, &row[column], tag)?;
        }
        let number = match (is(symbol), is(label)) {
            (Some(symbol), _) => from_type_symbol(symbol).ok_or_else(|| {
                text.error(line, format!("`{symbol}` is no element symbol, such as Sr or Sr2+"))
            })?,
            (None, Some(label)) => from_label(label).map_err(|why| text.error(line, why))?,
            (None, None) => {
                let message = "the atom has neither _atom_site_type_symbol nor _atom_site_label";
                return Err(text.error(line, message));
            }
        };
        let occupancy = match is(occupancy) {
            Some(word) => {
                text.occupancy(line, with_uncertainty(text, line, "_atom_site_occupancy", word)?)?
            }
            None => 1.0,
        };
        sites.push(CifSite { line, atom: Atom { number, position, occupancy } });
    }
    Ok(sites)
}

fn coordinate(text: &SourceText, value: &CifValue, tag: &str) -> Result<f64> {
    let Some(word) = value.known() else {
        return Err(text.error(value.line, format!("`{tag}` of this atom is not known")));
    };
    let x = with_uncertainty(text, value.line, tag, word)?;
    if x.abs() > 1000.0 {
        let message = format!("`{tag}` is {word}, expected a fraction of the cell");
        return Err(text.error(value.line, message));
    }
    Ok(x)
}

/// `Sr`, `Sr2+`, `O2-`; deuterium is hydrogen.
fn from_type_symbol(symbol: &str) -> Option<u8> {
    let letters: String = symbol.chars().take_while(char::is_ascii_alphabetic).collect();
    match letters.to_ascii_uppercase().as_str() {
        "" => None,
        "D" => Some(1),
        _ => elements::atomic_number(&letters).ok(),
    }
}

/// The element at the start of `Sr1`, `O2a` or `OW1`; the error says why there is none.
fn from_label(label: &str) -> std::result::Result<u8, String> {
    let letters: Vec<char> = label.chars().take_while(char::is_ascii_alphabetic).collect();
    let try_first = |count: usize| -> Option<u8> {
        let text: String = letters.get(..count)?.iter().collect();
        from_type_symbol(&text)
    };
    match (try_first(1), try_first(2)) {
        (Some(_), Some(_)) if letters[1].is_ascii_uppercase() => Err(format!(
            "label `{label}` may mean {} or {}; add a column _atom_site_type_symbol",
            letters[0],
            letters[..2].iter().collect::<String>()
        )),
        (_, Some(two)) => Ok(two),
        (Some(one), None) => Ok(one),
        (None, None) => Err(format!(
            "label `{label}` begins with no element symbol; add a column _atom_site_type_symbol"
        )),
    }
}

/// The distinct images of a site in the cell, as fractions in [0, 1).
fn images(site: &CifSite, operations: &[Operation], cell: &Mat3) -> Vec<Vec3> {
    // A file that lists all atoms keeps them where they are.
    if operations.len() == 1 {
        return vec![site.atom.position];
    }
    let mut images: Vec<Vec3> = Vec::new();
    for operation in operations {
        let image = operation.apply(site.atom.position).map(wrap_unit);
        if !images.iter().any(|other| same_place(image, *other, cell)) {
            images.push(image);
        }
    }
    images
}

fn same_place(a: Vec3, b: Vec3, cell: &Mat3) -> bool {
    let d: Vec3 = std::array::from_fn(|i| {
        let d = a[i] - b[i];
        d - d.round()
    });
    d.iter().all(|x| x.abs() < SAME_FRACTION) || norm(row_times(d, cell)) < SAME_DISTANCE
}

#[cfg(test)]
mod tests {
    use super::super::read::{Format, parse as parse_format};
    use super::*;
    use std::path::Path;

    #[test]
    fn labels_and_type_symbols() {
        for (text, z) in [("Sr2+", 38), ("O2-", 8), ("Ti4+", 22), ("D", 1), ("SR", 38)] {
            assert_eq!(from_type_symbol(text), Some(z), "{text}");
        }
        for (text, z) in [("Sr1", 38), ("O2", 8), ("OW1", 8), ("Ti", 22), ("TI1", 22), ("Ga1A", 31)]
        {
            assert_eq!(from_label(text), Ok(z), "{text}");
        }
        assert!(from_label("CA1").unwrap_err().contains("may mean C or CA"));
        assert!(from_label("X1").is_err());
        assert_eq!(from_type_symbol("Wat"), None);
    }

    #[test]
    fn the_cell_stands_in_the_standard_orientation() {
        let body = "data_t\n_cell_length_a 5.0(1)\n_cell_length_b 6\n_cell_length_c 7\n\
                    _cell_angle_alpha 80\n_cell_angle_beta 95\n_cell_angle_gamma 110\nloop_\n\
                    _atom_site_label\n_atom_site_fract_x\n_atom_site_fract_y\n_atom_site_fract_z\n\
                    Si1 0.5 0.25 0\n";
        let s = parse_format(Format::Cif, body.as_bytes(), Path::new("t.cif")).unwrap();
        let angle = |i: usize, j: usize| {
            let (a, b) = (s.cell[i], s.cell[j]);
            (super::super::lattice::dot(a, b) / norm(a) / norm(b)).acos().to_degrees()
        };
        assert_eq!(s.cell[0], [5.0, 0.0, 0.0]);
        for (got, expected) in [(angle(1, 2), 80.0), (angle(0, 2), 95.0), (angle(0, 1), 110.0)] {
            assert!((got - expected).abs() < 1e-9, "{got} {expected}");
        }
        assert!((norm(s.cell[2]) - 7.0).abs() < 1e-12);
    }
}
