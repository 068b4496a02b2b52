//! Reads labels of atoms in extended XYZ: the columns `defect`, `phase` and `grain`.
//!
//! `defect` (or `defect_type`, as in files of specimens) is a word or a logical value: `none` or `F` for an atom that belongs there,
//! `substitution_X`, `substitution` or `T` for an atom that does not. A missing atom is a line with the occupancy 0 and the label
//! `vacancy_X`. `phase` is a word or a number, `grain` a number.

use std::collections::HashMap;

use super::labelled_atoms::{LabelledAtom, LabelledAtoms, SiteLabel, partly_occupied};
use super::source_text::SourceText;
use super::xyz::XyzProperty;
use super::{Atom, elements};
use crate::error::Result;

/// Largest number of phases or grains in a file.
const MOST_GROUPS: usize = 4096;
/// Greatest length of a phase's name.
const LONGEST_NAME: usize = 64;
/// Prefix of a vacancy's label.
const VACANCY: &str = "vacancy_";
/// Prefix of a substitution's label.
const SUBSTITUTION: &str = "substitution_";

/// Collects the labels of a file's atoms, line by line.
#[derive(Default)]
pub(super) struct LabelReader {
    defect: Option<usize>,
    /// Column of the phases or of the grains.
    group: Option<usize>,
    /// Prefix of numbers of groups: `phase_` or `grain_`.
    prefix: &'static str,
    /// Whether grains are ignored because there are phases.
    grains_unread: bool,
    /// Groups in the order in which they occur.
    names: Vec<String>,
    known: HashMap<String, u16>,
    atoms: Vec<LabelledAtom>,
}

impl LabelReader {
    /// Finds the columns of labels.
    pub fn begin(&mut self, text: &SourceText, named: &[XyzProperty]) -> Result<()> {
        let column = |name: &str| match named.iter().find(|property| property.name == name) {
            Some(XyzProperty { width, .. }) if *width != 1 => {
                Err(text.error(2, format!("`{name}` has {width} columns, expected 1")))
            }
            other => Ok(other.map(|property| property.first)),
        };
        self.defect = column("defect")?.or(column("defect_type")?);
        let (phase, grain) = (column("phase")?, column("grain")?);
        self.group = phase.or(grain);
        self.prefix = if phase.is_some() { "phase_" } else { "grain_" };
        self.grains_unread = phase.is_some() && grain.is_some();
        Ok(())
    }

    /// Reads the labels of a line; `atom` is the atom of the line, `None` for the species `X`.
    pub fn take(
        &mut self,
        text: &SourceText,
        line: usize,
        words: &[&str],
        position: [f64; 3],
        atom: Option<&Atom>,
    ) -> Result<()> {
        let word = self.defect.map_or("none", |column| words[column]);
        let found = match atom.filter(|atom| atom.occupancy != 0.0) {
            Some(atom) if atom.occupancy != 1.0 => {
                return Err(text.error(line, partly_occupied("this atom", atom.occupancy)));
            }
            Some(atom) => Some((label_of_atom(text, line, word, atom.number)?, atom.number)),
            None => missing(text, line, word)?.map(|number| (SiteLabel::Vacancy, number)),
        };
        let Some((label, number)) = found else { return Ok(()) };
        let group = match self.group {
            Some(column) => self.group(text, line, words[column])?,
            None => 0,
        };
        self.atoms.push(LabelledAtom { position, number, label, group });
        Ok(())
    }

    fn group(&mut self, text: &SourceText, line: usize, word: &str) -> Result<u16> {
        if let Some(index) = self.known.get(word) {
            return Ok(*index);
        }
        let name = self.prefix.trim_end_matches('_');
        if name == "grain" && word.parse::<i64>().is_err() {
            return Err(text.error(line, format!("grain is `{word}`, expected a whole number")));
        }
        if !word.is_ascii() || word.len() > LONGEST_NAME {
            let message =
                format!("{name} is `{word}`, expected at most {LONGEST_NAME} ASCII characters");
            return Err(text.error(line, message));
        }
        if self.names.len() == MOST_GROUPS {
            let message = format!(
                "{name} has more than {MOST_GROUPS} values, too many for a map; use fewer groups"
            );
            return Err(text.error(line, message));
        }
        let index = self.names.len() as u16;
        self.names.push(word.to_owned());
        self.known.insert(word.to_owned(), index);
        Ok(index)
    }

    /// Returns the atoms; groups are sorted, numbers by value.
    pub fn finish(self, cell: [[f64; 3]; 3]) -> LabelledAtoms {
        let LabelReader { mut atoms, names, prefix, grains_unread, .. } = self;
        let unread = "the column `grain` is not read: the map of phases shows the column `phase`";
        let notes = grains_unread.then(|| unread.to_owned()).into_iter().collect();
        let mut order: Vec<usize> = (0..names.len()).collect();
        let number = |n: usize| names[n].parse::<i64>().ok();
        // Numbers come before words.
        let key = |n: usize| (number(n).is_none(), number(n), &names[n]);
        order.sort_by(|a, b| key(*a).cmp(&key(*b)));
        let mut rank = vec![0u16; names.len()];
        order.iter().enumerate().for_each(|(to, from)| rank[*from] = to as u16);
        if !names.is_empty() {
            atoms.iter_mut().for_each(|atom| atom.group = rank[usize::from(atom.group)]);
        }
        let name = |n: &usize| match number(*n) {
            Some(_) => format!("{prefix}{}", names[*n]),
            None => names[*n].clone(),
        };
        let groups = order.iter().map(name).collect();
        LabelledAtoms { cell, atoms, groups, notes }
    }
}

/// Reads the label of an atom.
fn label_of_atom(text: &SourceText, line: usize, word: &str, number: u8) -> Result<SiteLabel> {
    let symbol = elements::symbol(number);
    match word {
        "none" | "pristine" | "-" | "F" | "False" | "false" | "0" => Ok(SiteLabel::Pristine),
        "substitution" | "T" | "True" | "true" | "1" => Ok(SiteLabel::Substitution),
        _ if word.strip_prefix(SUBSTITUTION) == Some(symbol) => Ok(SiteLabel::Substitution),
        _ if word.starts_with(SUBSTITUTION) => {
            let message = format!(
                "defect is `{word}`, but the atom is {symbol}; expected `{SUBSTITUTION}{symbol}`"
            );
            Err(text.error(line, message))
        }
        _ if word.starts_with(VACANCY) => {
            let message = format!(
                "defect is `{word}`, but the line is an atom; give a vacant site the species X and a column `occupancy` with 0"
            );
            Err(text.error(line, message))
        }
        _ => Err(text.error(
            line,
            format!("defect is `{word}`, expected none, {SUBSTITUTION}{symbol}, T or F"),
        )),
    }
}

/// Returns the missing element of a site without an atom; `None` if there is no label.
fn missing(text: &SourceText, line: usize, word: &str) -> Result<Option<u8>> {
    match word.strip_prefix(VACANCY) {
        Some(symbol) => text.element(line, symbol).map(Some),
        None if ["none", "-", "F", "False", "false", "0"].contains(&word) => Ok(None),
        None => {
            let message = format!(
                "defect is `{word}`, but the site is vacant; expected {VACANCY}X with the element that is missing, or none"
            );
            Err(text.error(line, message))
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::super::read::{Format, parse_labelled};
    use super::*;

    const HEAD: &str = "Lattice=\"9 0 0 0 9 0 0 0 9\" Properties=species:S:1:pos:R:3";

    fn read(columns: &str, rows: &[&str]) -> Result<LabelledAtoms> {
        let body = format!("{}\n{HEAD}{columns}\n{}\n", rows.len(), rows.join("\n"));
        parse_labelled(Format::ExtXyz, body.as_bytes(), Path::new("t.xyz"))
    }

    #[test]
    fn defects_phases_and_vacant_sites_are_read() {
        let columns = ":occupancy:R:1:defect_type:S:1:phase:S:1:grain:I:1";
        let rows =
            ["Si 0 0 0 1 none b 7", "X 2 0 0 0 vacancy_O a 7", "Ge 4 0 0 1 substitution_Ge b 7"];
        let read = read(columns, &rows).unwrap();
        let labels: Vec<_> = read.atoms.iter().map(|a| (a.number, a.label, a.group)).collect();
        let expected = [
            (14, SiteLabel::Pristine, 1),
            (8, SiteLabel::Vacancy, 0),
            (32, SiteLabel::Substitution, 1),
        ];
        assert_eq!(labels, expected);
        assert_eq!((read.groups, read.notes.len()), (vec!["a".to_owned(), "b".to_owned()], 1));
        assert_eq!(read.atoms[1].position, [2.0, 0.0, 0.0]);
    }

    #[test]
    fn grains_are_sorted_by_number_and_logical_values_are_defects() {
        let read = read(":defect:L:1:grain:I:1", &["Si 0 0 0 T 10", "Si 2 0 0 F 9"]).unwrap();
        assert_eq!(read.groups, ["grain_9", "grain_10"]);
        let labels: Vec<_> = read.atoms.iter().map(|a| (a.label, a.group)).collect();
        assert_eq!(labels, [(SiteLabel::Substitution, 1), (SiteLabel::Pristine, 0)]);
        assert_eq!(read.elements(), ["Si"]);
        assert_eq!(read.extent()[0], [0.0, 2.0]);
    }

    #[test]
    fn files_without_labels_are_all_pristine() {
        let read = read("", &["Si 0 0 0", "O 2 0 0"]).unwrap();
        assert!(read.groups.is_empty());
        assert!(read.atoms.iter().all(|a| (a.label, a.group) == (SiteLabel::Pristine, 0)));
    }

    #[test]
    fn labels_that_contradict_the_line_are_reported() {
        let of = |columns: &str, row: &str| read(columns, &[row]).unwrap_err().to_string();
        let cases = [
            (
                ":defect:S:1",
                "Si 0 0 0 substitution_Ge",
                "t.xyz:3: defect is `substitution_Ge`, but the atom is Si",
            ),
            (":defect:S:1", "Si 0 0 0 vacancy_Si", "give a vacant site the species X"),
            (":defect:S:1", "Si 0 0 0 twin", "expected none, substitution_Si, T or F"),
            (":occupancy:R:1", "Si 0 0 0 0.5", "has the occupancy 0.5"),
            (":occupancy:R:1:defect:S:1", "X 0 0 0 0 hole", "expected vacancy_X"),
            (":occupancy:R:1:defect:S:1", "X 0 0 0 0 vacancy_Qq", "unknown element `Qq`"),
            (":grain:S:1", "Si 0 0 0 left", "grain is `left`, expected a whole number"),
            (":phase:I:2", "Si 0 0 0 1 2", "`phase` has 2 columns, expected 1"),
        ];
        for (columns, row, part) in cases {
            let message = of(columns, row);
            assert!(message.contains(part), "{row}: {message}");
        }
    }
}
