//! Chooses the reader, and holds what all readers share: text with line numbers, and the checks
//! that every structure passes.

use super::lattice::{determinant, norm};
use super::{Atom, Structure, cif, elements, neighbors, poscar, xyz};
use crate::error::{Error, Result};
use crate::setting::Setting;
use std::path::Path;

/// Shortest and longest cell vector accepted, in Angstrom.
const CELL_LIMITS: [f64; 2] = [0.5, 1e6];
/// Smallest accepted ratio of a cell's volume to the product of its edges.
const FLATTEST_CELL: f64 = 1e-3;
/// Atoms closer than this, in Angstrom, must share one site by their occupancies.
const OVERLAP: f64 = 0.3;
/// Sum of occupancies accepted on one site; above 1 for the sake of rounded thirds.
pub(super) const FULLEST_SITE: f64 = 1.005;

/// A file format of structures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// Extended XYZ with `Lattice="..."`.
    ExtXyz,
    /// Crystallographic Information File.
    Cif,
    /// VASP POSCAR or CONTCAR, version 5 (with element symbols).
    Poscar,
}

impl Format {
    /// The format that the file's name stands for: `.xyz`, `.extxyz`, `.cif`, `.vasp`, `.poscar`,
    /// `.contcar`, or a name that begins with `POSCAR` or `CONTCAR`.
    ///
    /// # Errors
    /// [`Error::Invalid`] for any other name.
    pub fn from_path(path: &Path) -> Result<Self> {
        let lower = |part: Option<&std::ffi::OsStr>| {
            part.map(|p| p.to_string_lossy().to_ascii_lowercase()).unwrap_or_default()
        };
        let name = lower(path.file_name());
        match lower(path.extension()).as_str() {
            "xyz" | "extxyz" => Ok(Format::ExtXyz),
            "cif" => Ok(Format::Cif),
            "vasp" | "poscar" | "contcar" => Ok(Format::Poscar),
            _ if name.starts_with("poscar") || name.starts_with("contcar") => Ok(Format::Poscar),
            _ => Err(Error::invalid(
                Setting::StructureFile,
                path.display(),
                "the name must end in .cif, .xyz, .extxyz, .vasp or .poscar, or begin with POSCAR \
                 or CONTCAR; rename or convert the file",
            )),
        }
    }
}

/// Reads a structure; the file's name tells the format (see [`Format::from_path`]).
///
/// Left-handed cells are accepted as they are: the positions are Cartesian, so handedness of the
/// cell vectors does not mirror the crystal.
///
/// # Errors
/// [`Error::Io`], [`Error::Invalid`] for an unknown format, [`Error::Parse`] with the line.
pub fn read(path: &Path) -> Result<Structure> {
    let format = Format::from_path(path)?;
    let bytes = std::fs::read(path).map_err(|e| Error::io(path, "read", e))?;
    parse(format, &bytes, path)
}

/// Reads a structure from memory; `path` only names it in errors.
///
/// # Errors
/// [`Error::Parse`] with the line.
pub fn parse(format: Format, bytes: &[u8], path: &Path) -> Result<Structure> {
    let text = std::str::from_utf8(bytes).map_err(|e| {
        let line = 1 + bytes[..e.valid_up_to()].iter().filter(|&&b| b == b'\n').count();
        Error::parse(path, line, "not UTF-8 text; save the file as plain text in UTF-8")
    })?;
    let text = Text { path, body: text.strip_prefix('\u{feff}').unwrap_or(text) };
    if text.body.trim().is_empty() {
        return Err(text.error(0, "the file is empty"));
    }
    match format {
        Format::ExtXyz => xyz::parse(&text),
        Format::Cif => cif::parse(&text),
        Format::Poscar => poscar::parse(&text),
    }
}

/// A file's text, and its name for errors.
pub(super) struct Text<'a> {
    pub path: &'a Path,
    pub body: &'a str,
}

impl<'a> Text<'a> {
    pub fn error(&self, line: usize, message: impl Into<String>) -> Error {
        Error::parse(self.path, line, message)
    }

    /// The lines with their numbers from 1.
    pub fn lines(&self) -> impl Iterator<Item = (usize, &'a str)> + use<'a> {
        self.body.lines().enumerate().map(|(i, line)| (i + 1, line))
    }

    /// A finite number; Fortran's `1.0D+00` is understood.
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

    /// Checks the cell; `line` is where it stands.
    pub fn check_cell(&self, line: usize, cell: &[[f64; 3]; 3]) -> Result<()> {
        let lengths = cell.map(norm);
        let [low, high] = CELL_LIMITS;
        if let Some(length) = lengths.iter().find(|l| !(low..=high).contains(*l)) {
            let message = format!(
                "a cell vector is {length} A long, expected {low} to {high} A; check the unit"
            );
            return Err(self.error(line, message));
        }
        let flatness = determinant(cell).abs() / lengths.iter().product::<f64>();
        if flatness < FLATTEST_CELL {
            let message = "the cell has no volume: its three vectors must not lie in one plane";
            return Err(self.error(line, message));
        }
        Ok(())
    }

    /// Checks the atoms, each with the line it came from, and builds the structure. Sites with
    /// occupancy 0 are dropped.
    pub fn finish(&self, cell: [[f64; 3]; 3], atoms: Vec<(usize, Atom)>) -> Result<Structure> {
        if let Some((line, atom)) =
            atoms.iter().find(|(_, a)| a.position.iter().any(|x| x.is_nan() || x.abs() > 1e7))
        {
            let message = format!("position {:?} A is absurdly far away", atom.position);
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
        let mut fault = None;
        neighbors::for_each_pair(structure, OVERLAP, |i, j, distance| {
            let together = structure.atoms[i].occupancy + structure.atoms[j].occupancy;
            if together > FULLEST_SITE && fault.is_none_or(|(a, b, _)| (i, j) < (a, b)) {
                fault = Some((i, j, distance));
            }
        });
        let Some((i, j, distance)) = fault else { return Ok(()) };
        let name = |k: usize| elements::symbol(structure.atoms[k].number);
        let message = format!(
            "this {} and the {} of line {} (or their periodic images) are {distance:.3} A apart, \
             and together occupy more than one site; remove one, or give coordinates on special \
             positions with more digits",
            name(j),
            name(i),
            lines[i]
        );
        Err(self.error(lines[j], message))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_name_tells_the_format() {
        let of = |name: &str| Format::from_path(Path::new(name));
        assert_eq!(of("a/b.cif").unwrap(), Format::Cif);
        assert_eq!(of("b.CIF").unwrap(), Format::Cif);
        assert_eq!(of("POSCAR").unwrap(), Format::Poscar);
        assert_eq!(of("CONTCAR_relaxed").unwrap(), Format::Poscar);
        assert_eq!(of("x.extxyz").unwrap(), Format::ExtXyz);
        assert!(of("x.pdb").unwrap_err().to_string().contains(".cif, .xyz"));
    }

    #[test]
    fn errors_count_lines_in_broken_text() {
        let path = Path::new("a.xyz");
        let error = parse(Format::ExtXyz, b"1\nok\n\xff", path).unwrap_err();
        assert_eq!(
            error.to_string(),
            "a.xyz:3: not UTF-8 text; save the file as plain text in UTF-8"
        );
    }

    #[test]
    fn a_missing_file_is_named() {
        let error = read(Path::new("nowhere/none.cif")).unwrap_err();
        assert!(error.to_string().starts_with("nowhere/none.cif: cannot read"), "{error}");
    }
}
