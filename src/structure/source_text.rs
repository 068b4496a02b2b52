//! Common parts of all readers of structures: text with line numbers, and the checks that every structure passes.

use super::lattice::{determinant, face_distances, norm};
use super::overlap::{FULLEST_SITE, OVERLAP, Overlap};
use super::{Atom, Structure, elements};
use crate::error::{Error, Result};
use std::path::Path;

/// Shortest and longest cell vector accepted, in Angstrom.
const CELL_LIMITS: [f64; 2] = [0.5, 1e6];
/// Smallest accepted ratio of a cell's volume to the product of its edges.
const FLATTEST_CELL: f64 = 1e-3;
/// Largest accepted coordinate of a position, in Angstrom.
pub(super) const FARTHEST: f64 = 1e7;
/// Largest number of atoms in a file.
pub(super) const MOST_ATOMS: usize = 10_000_000;
/// Longest line in bytes.
const LONGEST_LINE: usize = 1 << 16;

/// Checks a cell; the error describes the fault.
pub(super) fn check_cell(cell: &[[f64; 3]; 3]) -> std::result::Result<(), String> {
    let lengths = cell.map(norm);
    let [low, high] = CELL_LIMITS;
    if let Some(length) = lengths.iter().find(|l| !(low..=high).contains(*l)) {
        return Err(format!(
            "a cell vector is {length} A long, expected {low} to {high} A; check the unit"
        ));
    }
    let flatness = determinant(cell).abs() / lengths.iter().product::<f64>();
    if flatness < FLATTEST_CELL {
        return Err("the cell has no volume: its three vectors must not lie in one plane".into());
    }
    let thinnest = face_distances(cell).into_iter().fold(f64::INFINITY, f64::min);
    if thinnest < OVERLAP {
        return Err(format!(
            "two opposite faces of the cell are {thinnest:.2e} A apart, expected at least {OVERLAP} A"
        ));
    }
    Ok(())
}

/// The text of a file, and its name for errors.
pub(super) struct SourceText<'a> {
    pub path: &'a Path,
    pub body: &'a str,
}

impl<'a> SourceText<'a> {
    /// Refuses lines that are too long.
    pub fn check_lines(&self) -> Result<()> {
        match self.lines().find(|(_, line)| line.len() > LONGEST_LINE) {
            None => Ok(()),
            Some((number, line)) => {
                let length = line.len();
                let message =
                    format!("this line has {length} bytes, at most {LONGEST_LINE} are read");
                Err(self.error(number, message))
            }
        }
    }

    /// Refuses more than the largest number of atoms.
    pub fn check_count(&self, line: usize, atoms: usize) -> Result<()> {
        self.check_count_to(line, atoms, MOST_ATOMS)
    }

    /// Refuses more than `most` atoms.
    pub fn check_count_to(&self, line: usize, atoms: usize, most: usize) -> Result<()> {
        if atoms > most {
            let message = format!(
                "{atoms} atoms are announced, at most {most} are read from a file; take a smaller cell and \
                 repeat it"
            );
            return Err(self.error(line, message));
        }
        Ok(())
    }

    pub fn error(&self, line: usize, message: impl Into<String>) -> Error {
        Error::parse(self.path, line, message)
    }

    /// Returns the lines with their numbers from 1.
    pub fn lines(&self) -> impl Iterator<Item = (usize, &'a str)> + use<'a> {
        self.body.lines().enumerate().map(|(i, line)| (i + 1, line))
    }

    /// Reads a finite number, also in Fortran's form `1.0D+00`.
    pub fn number(&self, line: usize, what: &str, word: &str) -> Result<f64> {
        let parsed = word.parse::<f64>().or_else(|_| word.replace(['d', 'D'], "e").parse());
        match parsed {
            Ok(value) if value.is_finite() => Ok(value),
            Ok(_) => Err(self.error(line, format!("{what} is `{word}`, not a finite number"))),
            Err(_) => Err(self.error(line, format!("{what} is `{word}`, expected a number"))),
        }
    }

    pub fn element(&self, line: usize, word: &str) -> Result<u8> {
        elements::atomic_number(word).map_err(|e| self.error(line, e.to_string()))
    }

    /// Accepts occupancies in [0, 1] and a little above 1, which becomes 1.
    pub fn occupancy(&self, line: usize, value: f64) -> Result<f64> {
        if !(0.0..=FULLEST_SITE).contains(&value) {
            let message = format!("occupancy is {value}, expected a number from 0 to 1");
            return Err(self.error(line, message));
        }
        Ok(value.min(1.0))
    }

    /// Checks the cell; `line` is its line in the file.
    pub fn check_cell(&self, line: usize, cell: &[[f64; 3]; 3]) -> Result<()> {
        check_cell(cell).map_err(|message| self.error(line, message))
    }

    /// Checks the atoms, each with its line, and builds the structure. Sites with occupancy 0 are dropped.
    pub fn finish(&self, cell: [[f64; 3]; 3], atoms: Vec<(usize, Atom)>) -> Result<Structure> {
        self.check_count(0, atoms.len())?;
        if let Some((line, atom)) =
            atoms.iter().find(|(_, a)| a.position.iter().any(|x| x.is_nan() || x.abs() > FARTHEST))
        {
            let message = format!(
                "position {:?} A is farther away than {FARTHEST} A; check the unit",
                atom.position
            );
            return Err(self.error(*line, message));
        }
        let (lines, atoms): (Vec<usize>, Vec<Atom>) =
            atoms.into_iter().filter(|(_, atom)| atom.occupancy > 0.0).unzip();
        if atoms.is_empty() {
            return Err(self.error(0, "the file holds no atoms"));
        }
        let structure = Structure { cell, atoms };
        self.check_overlap(&structure, &lines)?;
        Ok(structure)
    }

    fn check_overlap(&self, structure: &Structure, lines: &[usize]) -> Result<()> {
        let Some(overlap) = Overlap::of(structure) else { return Ok(()) };
        let message = overlap.describe(structure, "this", |first| format!("line {}", lines[first]));
        Err(self.error(lines[overlap.atom()], message))
    }
}
