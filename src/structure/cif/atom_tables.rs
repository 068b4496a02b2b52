//! Reads the sites in a data block: position, element and occupancy.

use super::atom_labels::{self, Formula, NamedAtom};
use super::cartesian_sites::{CARTESIAN, CartesianFrame};
use super::cif_numbers::{coordinate, with_uncertainty};
use super::tokens::{CifValue, DataBlock, Loop};
use crate::error::Result;
use crate::structure::Atom;
use crate::structure::lattice::{Mat3, Vec3};
use crate::structure::source_text::SourceText;

/// Columns of fractional coordinates.
pub const FRACTIONAL: [&str; 3] =
    ["_atom_site_fract_x", "_atom_site_fract_y", "_atom_site_fract_z"];
/// Columns that change the meaning of an atom; in a loop without coordinates they cannot be used.
const ATTRIBUTES: [&str; 7] = [
    "_atom_site_type_symbol",
    "_atom_site_occupancy",
    "_atom_site_disorder_group",
    "_atom_site_disorder_assembly",
    "_atom_site_label_alt_id",
    "_atom_site_u_iso_or_equiv",
    "_atom_site_b_iso_or_equiv",
];
const LABEL: &str = "_atom_site_label";

/// One row of a loop of atoms.
pub struct CifSite<'t, 'a> {
    pub line: usize,
    /// The atom, with a fractional position.
    pub atom: Atom,
    table: &'t Loop<'a>,
    row: &'t [CifValue<'a>],
}

impl<'a> CifSite<'_, 'a> {
    /// Returns the known value of the first of these columns that exists.
    pub fn value(&self, tags: &[&str]) -> Option<&'a str> {
        tags.iter().find_map(|tag| self.table.column(&[tag]).and_then(|c| self.row[c].known()))
    }

    /// Returns the label, or else the number of the line.
    pub fn name(&self) -> String {
        self.value(&[LABEL]).map_or_else(|| format!("of line {}", self.line), str::to_owned)
    }

    pub fn label(&self) -> Option<&'a str> {
        self.value(&[LABEL])
    }
}

/// Whether a data block lists atoms.
pub fn holds_atoms(block: &DataBlock) -> bool {
    block.table(&FRACTIONAL).is_some() || block.table(&CARTESIAN).is_some()
}

/// Returns the sites of all loops of atoms, in the order of the file.
pub fn sites<'t, 'a>(
    text: &SourceText,
    block: &'t DataBlock<'a>,
    cell: &Mat3,
    formula: Option<&Formula>,
    notes: &mut Vec<String>,
) -> Result<Vec<CifSite<'t, 'a>>> {
    let tags = match block.table(&FRACTIONAL) {
        Some(_) => FRACTIONAL,
        None => CARTESIAN,
    };
    let mut tables = block.tables(&tags);
    tables.sort_by_key(|table| table.line);
    check_stray(text, block)?;
    let frame = match tags == CARTESIAN {
        true => Some(CartesianFrame::of(text, block, cell, notes)?),
        false => None,
    };
    let (mut found, mut bare) = (Vec::new(), Vec::new());
    for table in tables {
        if let Some(tag) = tags.iter().find(|tag| table.column(&[tag]).is_none()) {
            return Err(text.error(table.line, format!("the atoms have no column `{tag}`")));
        }
        for row in table.rows() {
            let raw = CifSite { line: row[0].line, atom: Atom::new(1, [0.0; 3]), table, row };
            if let Some((site, named)) = site(text, raw, &tags, frame.as_ref(), formula)? {
                if named.without_hydrogen {
                    bare.push(site.name());
                }
                found.push(site);
            }
        }
    }
    if found.iter().all(|site| site.atom.number != 1) {
        notes.extend(left_out(&bare));
    }
    Ok(found)
}

/// Refuses loops with properties of atoms but without coordinates.
fn check_stray(text: &SourceText, block: &DataBlock) -> Result<()> {
    let without = |l: &&Loop| l.column(&FRACTIONAL).or(l.column(&CARTESIAN)).is_none();
    for stray in block.loops.iter().filter(without) {
        let stated = |tag: &&&str| {
            let column = stray.column(&[**tag]);
            column.is_some_and(|c| stray.rows().any(|row| row[c].known().is_some()))
        };
        if let Some(tag) = ATTRIBUTES.iter().find(stated) {
            let message = format!(
                "`{tag}` stands here without coordinates; put it into the loop that has the coordinates"
            );
            return Err(text.error(stray.line, message));
        }
    }
    Ok(())
}

/// Reports hydrogen atoms that are only implied by a site's name.
fn left_out(bare: &[String]) -> Option<String> {
    let first = bare.first()?;
    Some(format!(
        "{} sites are named as water or hydroxyl (`{first}`): read as O, their hydrogen is left out",
        bare.len()
    ))
}

/// Returns a site with its atom; `None` for dummies.
fn site<'t, 'a>(
    text: &SourceText,
    raw: CifSite<'t, 'a>,
    tags: &[&str; 3],
    frame: Option<&CartesianFrame>,
    formula: Option<&Formula>,
) -> Result<Option<(CifSite<'t, 'a>, NamedAtom)>> {
    if raw.value(&["_atom_site_calc_flag"]).is_some_and(|flag| flag.eq_ignore_ascii_case("dum")) {
        return Ok(None);
    }
    let limit = match frame {
        None => (1000.0, "a fraction of the cell"),
        Some(_) => (1e7, "a length in A"),
    };
    let mut place: Vec3 = [0.0; 3];
    for (axis, tag) in tags.iter().enumerate() {
        // All tables were selected by these columns.
        let column = raw.table.column(&[tag]).unwrap_or(0);
        place[axis] = coordinate(text, &raw.row[column], tag, limit)?;
    }
    let position = frame.map_or(place, |frame| frame.fractions(place));
    let named = named(text, &raw, formula)?;
    let occupancy = match raw.value(&["_atom_site_occupancy"]) {
        Some(word) => text
            .occupancy(raw.line, with_uncertainty(text, raw.line, "_atom_site_occupancy", word)?)?,
        None => 1.0,
    };
    let atom = Atom { occupancy, ..Atom::new(named.number, position) };
    Ok(Some((CifSite { atom, ..raw }, named)))
}

fn named(text: &SourceText, site: &CifSite, formula: Option<&Formula>) -> Result<NamedAtom> {
    match (site.value(&["_atom_site_type_symbol"]), site.label()) {
        (Some(symbol), _) => atom_labels::from_type_symbol(symbol).ok_or_else(|| {
            text.error(site.line, format!("`{symbol}` is no element symbol, such as Sr or Sr2+"))
        }),
        (None, Some(label)) => {
            atom_labels::from_label(label, formula).map_err(|why| text.error(site.line, why))
        }
        (None, None) => {
            let message = "the atom has neither _atom_site_type_symbol nor _atom_site_label";
            Err(text.error(site.line, message))
        }
    }
}
