//! Reads extended XYZ, as the Atomic Simulation Environment and OVITO write it: the number of atoms, a line of `key=value`, one
//! line per atom.

use super::lattice::{Vec3, subtract};
use super::source_text::SourceText;
use super::xyz_labels::LabelReader;
use super::{Alternative, Atom, Structure};
use crate::error::Result;

/// Columns with the place, and with its alternative, of atoms that exclude each other ([`Alternative`]).
const ALTERNATIVE: &str = "alternative";
/// Value of those columns for atoms that exclude none.
const NO_ALTERNATIVE: &str = "-1 -1";
/// Species of a site without atom, as the Atomic Simulation Environment writes it.
const VACANT: &str = "X";

/// Neighbouring columns of an atom's line with a common name.
pub(super) struct XyzProperty {
    /// Name, in lower case.
    pub name: String,
    /// Index of the first column.
    pub first: usize,
    /// Number of columns.
    pub width: usize,
}

/// Places of the columns in an atom's line.
struct XyzColumns {
    element: usize,
    /// Whether the element is written as an atomic number.
    numbers: bool,
    position: usize,
    occupancy: Option<usize>,
    alternative: Option<usize>,
    count: usize,
    /// Whether the file itself announces its columns.
    announced: bool,
}

/// Reads a file of exactly one frame.
pub(super) fn parse(text: &SourceText) -> Result<Structure> {
    read_frame(text, None)
}

/// Reads a file of exactly one frame; `labels` receives the labels of each atom.
pub(super) fn read_frame(
    text: &SourceText,
    mut labels: Option<&mut LabelReader>,
) -> Result<Structure> {
    let mut lines = text.lines();
    let (_, first) = lines.next().unwrap_or((1, ""));
    let count: usize = first.trim().parse().map_err(|_| {
        text.error(1, format!("expected the number of atoms, found `{}`", first.trim()))
    })?;
    text.check_count(1, count)?;
    let header = lines.next().map(|(_, line)| line).unwrap_or("");
    let pairs = key_values(header).map_err(|key| {
        text.error(2, format!("the quote or brace after `{key}=` is never closed"))
    })?;
    for (i, (key, _)) in pairs.iter().enumerate() {
        let twice = pairs[..i].iter().any(|(earlier, _)| earlier == key);
        if twice && ["lattice", "properties"].contains(&key.as_str()) {
            return Err(
                text.error(2, format!("`{key}` is given twice; keep the one that is meant"))
            );
        }
    }
    let cell = lattice(text, &pairs)?;
    let named = properties(text, &pairs)?;
    let columns = columns(text, &pairs, &named)?;
    if let Some(labels) = labels.as_deref_mut() {
        labels.begin(text, &named)?;
    }
    let origin = origin(text, &pairs)?;
    let mut atoms = Vec::new();
    for index in 0..count {
        let Some((line, row)) = lines.next().filter(|(_, row)| !row.trim().is_empty()) else {
            let message = format!(
                "line 1 announces {count} atoms, but only {index} follow; the file may be cut off"
            );
            return Err(text.error(index + 3, message));
        };
        let words = words(text, &columns, line, row)?;
        let position = subtract(position(text, &columns, line, &words)?, origin);
        let found = atom(text, &columns, line, &words, position)?;
        if let Some(labels) = labels.as_deref_mut() {
            labels.take(text, line, &words, position, found.as_ref())?;
        }
        atoms.extend(found.map(|atom| (line, atom)));
    }
    if let Some((line, row)) = lines.find(|(_, row)| !row.trim().is_empty()) {
        return Err(text.error(line, surplus(row, count)));
    }
    text.finish(cell, atoms)
}

fn surplus(row: &str, count: usize) -> String {
    if row.trim().parse::<usize>().is_ok() {
        "a second frame begins here, but a structure is one frame; keep the one to be simulated \
         and remove the others"
            .to_owned()
    } else {
        format!("line 1 announces {count} atoms, but more lines follow; correct the number")
    }
}

fn lattice(text: &SourceText, pairs: &[(String, String)]) -> Result<[[f64; 3]; 3]> {
    let value = find(pairs, "lattice").ok_or_else(|| {
        text.error(
            2,
            "no cell; add Lattice=\"ax ay az bx by bz cx cy cz\" in Angstrom to this line \
             (surround a cluster with vacuum)",
        )
    })?;
    let words: Vec<&str> = value.split_whitespace().collect();
    if words.len() != 9 {
        let message = format!("Lattice has {} numbers, expected 9", words.len());
        return Err(text.error(2, message));
    }
    let mut cell = [[0.0; 3]; 3];
    for (i, word) in words.iter().enumerate() {
        cell[i / 3][i % 3] = text.number(2, "Lattice", word)?;
    }
    text.check_cell(2, &cell)?;
    Ok(cell)
}

/// Reads the origin of the cell, in Angstrom: `Origin="x y z"`, as OVITO writes it.
fn origin(text: &SourceText, pairs: &[(String, String)]) -> Result<Vec3> {
    let Some(value) = find(pairs, "origin") else { return Ok([0.0; 3]) };
    let words: Vec<&str> = value.split_whitespace().collect();
    if words.len() != 3 {
        let message = format!("Origin has {} numbers, expected 3", words.len());
        return Err(text.error(2, message));
    }
    let mut origin = [0.0; 3];
    for (x, word) in origin.iter_mut().zip(words) {
        *x = text.number(2, "Origin", word)?;
    }
    Ok(origin)
}

/// Returns the columns that the file announces, or the columns of plain XYZ.
fn announced(pairs: &[(String, String)]) -> &str {
    find(pairs, "properties").unwrap_or("species:S:1:pos:R:3")
}

/// Reads the properties of an atom's line, in their order.
fn properties(text: &SourceText, pairs: &[(String, String)]) -> Result<Vec<XyzProperty>> {
    let properties = announced(pairs);
    let fields: Vec<&str> = properties.split(':').collect();
    let wrong = |why: String| text.error(2, format!("Properties={properties}: {why}"));
    let (mut named, mut count) = (Vec::new(), 0usize);
    for triple in fields.chunks(3) {
        let width = match triple {
            [_, kind, width] if ["S", "I", "R", "L"].contains(kind) => width.parse().ok(),
            _ => None,
        };
        let Some(width @ 1..=1000) = width else {
            let part = triple.join(":");
            return Err(wrong(format!("`{part}` is not name:kind:columns, kind S, I, R or L")));
        };
        named.push(XyzProperty { name: triple[0].to_ascii_lowercase(), first: count, width });
        count += width;
    }
    Ok(named)
}

fn columns(
    text: &SourceText,
    pairs: &[(String, String)],
    named: &[XyzProperty],
) -> Result<XyzColumns> {
    let properties = announced(pairs);
    let wrong = |why: String| text.error(2, format!("Properties={properties}: {why}"));
    let column = |names: &[&str], width: usize| -> Result<Option<usize>> {
        match names.iter().find_map(|name| named.iter().find(|p| p.name == *name)) {
            Some(XyzProperty { name, width: w, .. }) if *w != width => {
                Err(wrong(format!("`{name}` has {w} columns, expected {width}")))
            }
            other => Ok(other.map(|property| property.first)),
        }
    };
    let symbols = column(&["species", "element", "symbol"], 1)?;
    let numbers = symbols.is_none();
    let element = match symbols {
        Some(column) => Some(column),
        None => column(&["z", "numbers", "atomic_numbers"], 1)?,
    };
    let element = element
        .ok_or_else(|| wrong("no elements; expected `species:S:1` or `Z:I:1`".to_owned()))?;
    let position = column(&["pos", "positions"], 3)?
        .ok_or_else(|| wrong("no positions; expected `pos:R:3`".to_owned()))?;
    let occupancy = column(&["occupancy", "occupancies"], 1)?;
    let alternative = column(&[ALTERNATIVE], 2)?;
    let announced = find(pairs, "properties").is_some();
    let count = named.iter().map(|property| property.width).sum();
    Ok(XyzColumns { element, numbers, position, occupancy, alternative, count, announced })
}

/// Splits an atom's line into words.
fn words<'a>(
    text: &SourceText,
    columns: &XyzColumns,
    line: usize,
    row: &'a str,
) -> Result<Vec<&'a str>> {
    let words: Vec<&str> = row.split_whitespace().collect();
    // Plain XYZ files may have any text after the position.
    if words.len() < columns.count || (columns.announced && words.len() > columns.count) {
        let message = format!("this atom has {} columns, expected {}", words.len(), columns.count);
        return Err(text.error(line, message));
    }
    Ok(words)
}

fn position(text: &SourceText, columns: &XyzColumns, line: usize, words: &[&str]) -> Result<Vec3> {
    let mut position = [0.0; 3];
    for (axis, x) in position.iter_mut().enumerate() {
        let name = ["position x", "position y", "position z"][axis];
        *x = text.number(line, name, words[columns.position + axis])?;
    }
    Ok(position)
}

/// Reads the atom of a line; `None` for a vacant site of the species `X`.
fn atom(
    text: &SourceText,
    columns: &XyzColumns,
    line: usize,
    words: &[&str],
    position: Vec3,
) -> Result<Option<Atom>> {
    let occupancy = match columns.occupancy {
        Some(column) => text.occupancy(line, text.number(line, "occupancy", words[column])?)?,
        None => 1.0,
    };
    let species = words[columns.element];
    if occupancy == 0.0 && species == VACANT {
        return Ok(None);
    }
    if !columns.numbers && species.parse::<f64>().is_ok() {
        return Err(text.error(line, number_of_species(species)));
    }
    let alternative = match columns.alternative {
        Some(column) => alternative(text, line, [words[column], words[column + 1]])?,
        None => None,
    };
    let atom = Atom::new(text.element(line, species)?, position);
    Ok(Some(Atom { occupancy, alternative, ..atom }))
}

/// Reads an alternative from two words; `None` for -1.
fn alternative(text: &SourceText, line: usize, words: [&str; 2]) -> Result<Option<Alternative>> {
    if words.join(" ") == NO_ALTERNATIVE {
        return Ok(None);
    }
    match words.map(str::parse) {
        [Ok(place), Ok(choice)] => Ok(Some(Alternative { place, choice })),
        _ => {
            let found = words.join(" ");
            let message = format!(
                "{ALTERNATIVE} is `{found}`, expected the number of a place and of the way in which it is filled, or {NO_ALTERNATIVE}"
            );
            Err(text.error(line, message))
        }
    }
}

/// Returns the message about a number where a symbol is expected.
fn number_of_species(species: &str) -> String {
    format!(
        "the species is the number `{species}`: if it is an atomic number, name the column in line 2, as in \
         Properties=Z:I:1:pos:R:3; if it is a type (of LAMMPS, say), write the symbol of its element"
    )
}

fn find<'a>(pairs: &'a [(String, String)], key: &str) -> Option<&'a str> {
    pairs.iter().find(|(k, _)| k == key).map(|(_, v)| v.as_str())
}

/// Splits `key=value key="quoted value" flag`; keys become lower case. Fails with the key whose value is not closed.
fn key_values(line: &str) -> std::result::Result<Vec<(String, String)>, String> {
    let mut pairs = Vec::new();
    let mut rest = line.trim_start();
    while !rest.is_empty() {
        let end = rest.find(|c: char| c == '=' || c.is_whitespace()).unwrap_or(rest.len());
        let key = rest[..end].to_ascii_lowercase();
        rest = &rest[end..];
        let mut value = String::new();
        if let Some(after) = rest.strip_prefix('=') {
            (value, rest) = take_value(after).ok_or_else(|| key.clone())?;
        }
        pairs.push((key, value));
        rest = rest.trim_start();
    }
    Ok(pairs)
}

/// Returns the value at the start of `rest`, and the text after it; `None` for a value that is never closed.
fn take_value(rest: &str) -> Option<(String, &str)> {
    let close = match rest.chars().next() {
        Some(quote @ ('"' | '\'')) => quote,
        Some('{') => '}',
        _ => {
            let end = rest.find(char::is_whitespace).unwrap_or(rest.len());
            return Some((rest[..end].to_owned(), &rest[end..]));
        }
    };
    let mut value = String::new();
    let mut escaped = false;
    for (i, c) in rest.char_indices().skip(1) {
        match c {
            '\\' if !escaped => escaped = true,
            c if c == close && !escaped => return Some((value, &rest[i + 1..])),
            c => {
                value.push(c);
                escaped = false;
            }
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::super::read::{Format, parse};
    use super::*;

    fn read(body: &str) -> Result<Structure> {
        parse(Format::ExtXyz, body.as_bytes(), Path::new("t.xyz"))
    }

    #[test]
    fn columns_may_stand_in_any_order() {
        let s = read(
            "2\nenergy=-1.5 Properties=tag:I:2:pos:R:3:occupancy:R:1:Z:I:1 \
             Lattice='4 0 0 0 5 0 0 0 6' pbc=\"T T F\"\n0 0 1 2 3 0.5 38\n0 0 2 2 3.5 1 8\n",
        )
        .unwrap();
        assert_eq!(s.cell, [[4.0, 0.0, 0.0], [0.0, 5.0, 0.0], [0.0, 0.0, 6.0]]);
        assert_eq!(s.atoms[0], Atom { occupancy: 0.5, ..Atom::new(38, [1.0, 2.0, 3.0]) });
        assert_eq!(s.atoms[1].number, 8);
    }

    #[test]
    fn the_cell_begins_at_the_origin() {
        let head = "Lattice=\"4 0 0 0 4 0 0 0 4\" Properties=species:S:1:pos:R:3 Origin=";
        let of = |origin: &str| read(&format!("1\n{head}{origin}\nCu -2 -1 0\n"));
        assert_eq!(of("\"-2 -2 -2\"").unwrap().atoms[0].position, [0.0, 1.0, 2.0]);
        assert!(of("\"1 2\"").unwrap_err().to_string().contains("Origin has 2 numbers"));
    }

    #[test]
    fn quoted_values_may_hold_escapes_and_equals() {
        let pairs = key_values(r#"flag a="x \"y\" =" B={1 2} c=3"#).unwrap();
        let text: Vec<String> = pairs.iter().map(|(k, v)| format!("{k}>{v}")).collect();
        assert_eq!(text, ["flag>", "a>x \"y\" =", "b>1 2", "c>3"]);
    }

    #[test]
    fn atoms_that_exclude_each_other_are_read() {
        let way = |place, choice| Some(Alternative { place, choice });
        let atom = |number, alternative, x| Atom {
            occupancy: 0.5,
            alternative,
            ..Atom::new(number, [x, 0.0, 0.0])
        };
        let atoms = vec![
            atom(6, way(0, 0), 1.0),
            atom(7, way(0, 1), 3.0),
            atom(8, None, 5.0),
            Atom::new(14, [7.0, 0.0, 0.0]),
        ];
        let cell = [[9.0, 0.0, 0.0], [0.0, 9.0, 0.0], [0.0, 0.0, 9.0]];
        let s = Structure { cell, atoms };
        let body = "4\nLattice=\"9 0 0 0 9 0 0 0 9\" \
                    Properties=species:S:1:pos:R:3:occupancy:R:1:alternative:I:2 pbc=\"T T T\"\n\
                    C 1 0 0 0.5 0 0\nN 3 0 0 0.5 0 1\nO 5 0 0 0.5 -1 -1\nSi 7 0 0 1 -1 -1\n";
        assert_eq!(read(body).unwrap(), s);
        let reply = read(&body.replace("0.5 0 1\n", "0.5 0 x\n")).unwrap_err().to_string();
        assert!(reply.contains("t.xyz:4: alternative is `0 x`"), "{reply}");
    }
}
