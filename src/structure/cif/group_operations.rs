//! Reads the symmetry operations of a data block, in any of the supported notations.

use super::symmetry::{self, Operation};
use super::tokens::DataBlock;
use crate::error::Result;
use crate::structure::lattice::Mat3;
use crate::structure::source_text::SourceText;

/// Largest relative change of the metric by a symmetry operation.
const LARGEST_STRAIN: f64 = 0.01;
/// Largest number of operations: more than any space group has (192) in a cell of twice the usual size.
const MOST_OPERATIONS: usize = 400;

const OPERATIONS: [&str; 2] = ["_space_group_symop_operation_xyz", "_symmetry_equiv_pos_as_xyz"];
const MAGNETIC: [&str; 1] = ["_space_group_symop_magn_operation_xyz"];
const CENTERINGS: [&str; 1] = ["_space_group_symop_magn_centering_xyz"];
/// Tags of a modulated crystal, which no cell repeats.
const MODULATED: [&str; 5] = [
    "_space_group_symop_ssg_operation_algebraic",
    "_space_group_symop_magn_ssg_operation_algebraic",
    "_space_group_symop_magn_ssg_centering_algebraic",
    "_space_group_ssg_name",
    "_cell_wave_vector_x",
];
const MODULATION_DIMENSION: &str = "_cell_modulation_dimension";

/// An operation in the list of the file.
struct ListedOperation<'a> {
    line: usize,
    word: &'a str,
    operation: Operation,
}

/// Returns the symmetry operations; the identity alone for P1 and for files without information about symmetry. Time reversal, which moves
/// no atoms, is left out.
pub fn operations(
    text: &SourceText,
    block: &DataBlock,
    cell: &Mat3,
    notes: &mut Vec<String>,
) -> Result<Vec<Operation>> {
    let mut listed = of_tags(text, block, &MAGNETIC, true)?;
    match listed.is_empty() {
        true => listed = of_tags(text, block, &OPERATIONS, false)?,
        false => listed = centred(listed, of_tags(text, block, &CENTERINGS, true)?),
    }
    if listed.len() > MOST_OPERATIONS {
        let message = format!("more than {MOST_OPERATIONS} symmetry operations");
        return Err(text.error(listed[0].line, message));
    }
    for ListedOperation { line, word, operation } in &listed {
        if operation.strain(cell) > LARGEST_STRAIN {
            let message = format!(
                "symmetry operation `{word}` does not fit the cell; check its lengths and angles"
            );
            return Err(text.error(*line, message));
        }
    }
    let operations: Vec<Operation> = listed.iter().map(|l| l.operation).collect();
    if let Some((i, j)) = symmetry::missing_product(&operations) {
        let message = format!(
            "the symmetry operations are no group: `{}` after `{}` is not among them; the list \
             is incomplete",
            listed[i].word, listed[j].word
        );
        return Err(text.error(listed[0].line, message));
    }
    check_modulation(text, block, operations.len() > 1, notes)?;
    if operations.len() <= 1 {
        check_group_is_p1(text, block)?;
        return Ok(vec![Operation::IDENTITY]);
    }
    Ok(operations)
}

/// Reads the operations in a column or an item; magnetic ones end with `+1` or `-1` for time reversal.
fn of_tags<'a>(
    text: &SourceText,
    block: &DataBlock<'a>,
    tags: &[&str],
    magnetic: bool,
) -> Result<Vec<ListedOperation<'a>>> {
    let mut words: Vec<(usize, &str)> = Vec::new();
    if let Some((table, column)) =
        block.table(tags).and_then(|t| t.column(tags).map(|column| (t, column)))
    {
        words.extend(table.rows().filter_map(|r| r[column].known().map(|k| (r[column].line, k))));
    }
    words.extend(block.get(tags));
    if let Some((line, _)) = words.get(MOST_OPERATIONS) {
        return Err(text.error(*line, format!("more than {MOST_OPERATIONS} symmetry operations")));
    }
    let mut listed: Vec<ListedOperation> = Vec::new();
    for (line, word) in words {
        let place = match magnetic {
            true => without_time_reversal(word),
            false => word,
        };
        let operation = Operation::parse(place)
            .map_err(|why| text.error(line, format!("symmetry operation `{word}`: {why}")))?;
        listed.push(ListedOperation { line, word, operation });
    }
    if magnetic {
        listed = distinct(listed);
    }
    Ok(listed)
}

/// Returns `x,y,z` of `x,y,z,-1`.
fn without_time_reversal(word: &str) -> &str {
    match word.rsplit_once(',') {
        Some((place, sign)) if ["+1", "-1", "1"].contains(&sign.trim()) => place,
        _ => word,
    }
}

/// Keeps each operation once: two that differ only in time reversal move atoms alike.
fn distinct(listed: Vec<ListedOperation<'_>>) -> Vec<ListedOperation<'_>> {
    let mut kept: Vec<ListedOperation> = Vec::new();
    for one in listed {
        if !kept.iter().any(|other| other.operation.moves_alike(&one.operation)) {
            kept.push(one);
        }
    }
    kept
}

/// Returns the operations, each followed by each of the centring translations.
fn centred<'a>(
    listed: Vec<ListedOperation<'a>>,
    centerings: Vec<ListedOperation<'a>>,
) -> Vec<ListedOperation<'a>> {
    if centerings.is_empty() {
        return listed;
    }
    let both = centerings.iter().take(MOST_OPERATIONS).flat_map(|centering| {
        listed.iter().map(|one| ListedOperation {
            operation: centering.operation.after(&one.operation),
            ..ListedOperation { line: one.line, word: one.word, operation: one.operation }
        })
    });
    distinct(both.take(2 * MOST_OPERATIONS).collect())
}

/// Refuses modulated crystals. If ordinary operations are listed too, they give the average structure, which is read.
fn check_modulation(
    text: &SourceText,
    block: &DataBlock,
    average: bool,
    notes: &mut Vec<String>,
) -> Result<()> {
    let dimension = block.get(&[MODULATION_DIMENSION]).filter(|(_, n)| *n != "0");
    let line = dimension.map(|(line, _)| line).or_else(|| {
        let table = block.table(&MODULATED).map(|table| table.line);
        table.or_else(|| block.get(&MODULATED).map(|(line, _)| line))
    });
    match line {
        None => Ok(()),
        Some(_) if average => {
            let note = "the crystal is modulated; its average structure was read, without the modulation";
            notes.push(note.to_owned());
            Ok(())
        }
        Some(line) => Err(text.error(
            line,
            "a modulated crystal with operations in superspace, which are not read; export a supercell with all of its \
             atoms (a commensurate approximant, space group `P 1`)",
        )),
    }
}

/// Information of a tag about the symmetry.
#[derive(PartialEq)]
enum SymmetryTag {
    /// A name or number of the group, or of its point group.
    Group,
    /// The crystal system, which is ignored if the group has a name.
    System,
    /// No information about the places of atoms.
    Other,
}

fn symmetry_tag(tag: &str) -> SymmetryTag {
    let has = |parts: &[&str]| parts.iter().any(|part| tag.contains(part));
    let speaks = tag.starts_with("_space_group") || tag.starts_with("_symmetry");
    let silent = [
        "symop",
        "equiv_pos",
        "transform",
        "description",
        "details",
        "multiplicity",
        "patterson",
        "wyckoff",
    ];
    if !speaks || has(&silent) || tag.ends_with("_id") {
        SymmetryTag::Other
    } else if has(&["setting", "system"]) {
        SymmetryTag::System
    } else if has(&["name", "number", "point_group"]) {
        SymmetryTag::Group
    } else {
        SymmetryTag::Other
    }
}

/// Whether a name, number or system of a group means that no two atoms are equivalent.
fn is_p1(tag: &str, name: &str) -> bool {
    let kept = |c: &char| !c.is_whitespace() && !"_^()'".contains(*c);
    let compact: String = name.chars().filter(kept).collect::<String>().to_ascii_lowercase();
    let alike: &[&str] = match tag {
        // The Hermann-Mauguin symbol `C 1` has a centred cell, so it is not listed.
        _ if tag.contains("schoenflies") => &["c1", "c11"],
        _ if tag.contains("_magn_") => &["p1", "p11", "1", "1.1", "1.2", "1.1.1", "1.2.2"],
        _ => &["p1", "p111", "1", "triclinic", "anorthic"],
    };
    alike.contains(&compact.as_str())
}

/// Refuses groups other than P1 without operations: name or number alone do not determine setting and origin.
fn check_group_is_p1(text: &SourceText, block: &DataBlock) -> Result<()> {
    let mut stated: Vec<(usize, &str, &str)> = Vec::new();
    for (tag, value) in &block.items {
        stated.extend(value.known().map(|known| (value.line, tag.as_str(), known)));
    }
    for table in &block.loops {
        for (column, tag) in table.tags.iter().enumerate() {
            if symmetry_tag(tag) != SymmetryTag::Other {
                let values = table.rows().filter_map(|row| row[column].known());
                stated.extend(values.map(|known| (table.line, tag.as_str(), known)));
            }
        }
    }
    stated.retain(|(_, tag, _)| symmetry_tag(tag) != SymmetryTag::Other);
    stated.sort_unstable();
    let is_system = |tag: &str| symmetry_tag(tag) == SymmetryTag::System;
    let named = stated.iter().any(|(_, tag, name)| !is_system(tag) && is_p1(tag, name));
    let fault = stated.iter().find(|(_, tag, name)| !(is_p1(tag, name) || is_system(tag) && named));
    let Some((line, tag, name)) = fault else { return Ok(()) };
    let what = if is_system(tag) { "crystal system" } else { "space group" };
    let message = format!(
        "{what} `{name}`, but its symmetry operations are not listed; add a loop \
         with _space_group_symop_operation_xyz, or set the group to `P 1` if all atoms \
         of the cell are listed"
    );
    Err(text.error(*line, message))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_the_group_without_symmetry() {
        let hall = "_space_group_name_hall";
        for (tag, name) in [
            (hall, "P 1"),
            (hall, "P1"),
            ("_space_group_it_number", "1"),
            ("_space_group_name_schoenflies", "C1^1"),
            ("_space_group_magn_name_bns", "P 1 1'"),
            ("_space_group_magn_number_bns", "1.1"),
            ("_symmetry_cell_setting", "triclinic"),
        ] {
            assert!(is_p1(tag, name), "{tag} {name}");
        }
        for name in ["P -1", "P 2", "11", "2", "1.3", "P 1 21 1", "Ci", "C 1", "cubic"] {
            assert!(!is_p1(hall, name), "{name}");
        }
        assert!(!is_p1("_space_group_magn_name_bns", "P_S1"));
    }

    #[test]
    fn tags_of_symmetry_are_distinguished_from_others() {
        for tag in [
            "_space_group_magn_name_bns",
            "_space_group_magn_number_og",
            "_space_group_name_schoenflies",
            "_symmetry_space_group_name_hall",
            "_space_group_it_number",
            "_space_group_point_group_h-m",
        ] {
            assert!(symmetry_tag(tag) == SymmetryTag::Group, "{tag}");
        }
        for tag in ["_space_group_magn_transform_bns_pp_abc", "_space_group_id", "_cell_length_a"] {
            assert!(symmetry_tag(tag) == SymmetryTag::Other, "{tag}");
        }
        assert!(symmetry_tag("_symmetry_cell_setting") == SymmetryTag::System);
    }

    #[test]
    fn time_reversal_is_left_out() {
        assert_eq!(without_time_reversal("x,y,z,+1"), "x,y,z");
        assert_eq!(without_time_reversal("-x, y, z+1/2 , -1"), "-x, y, z+1/2 ");
        assert_eq!(without_time_reversal("x,y,z"), "x,y,z");
    }
}
