//! Selects the reader for a file of a structure.

use super::labelled_atoms::LabelledAtoms;
use super::source_text::SourceText;
use super::xyz_labels::LabelReader;
use super::{Sigmas, Structure, cif, foreign_formats, poscar, xyz};
use crate::error::{Error, Result};
use crate::files::whole_file;
use crate::setting::Setting;
use std::path::Path;

#[cfg(test)]
thread_local! {
    /// Number of structures that this thread has parsed.
    pub(crate) static PARSED: std::cell::Cell<usize> = const { std::cell::Cell::new(0) };
}

/// A file format of structures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// Extended XYZ with `Lattice="..."`.
    ExtXyz,
    /// Crystallographic Information File.
    Cif,
    /// VASP POSCAR or CONTCAR, version 5 (with element symbols), and XDATCAR with frames.
    Poscar,
}

impl Format {
    /// Returns the largest size of a file in bytes.
    pub(crate) fn most_bytes(self) -> usize {
        match self {
            // All words of a CIF are kept until the end.
            Format::Cif => 32 << 20,
            // Ten million atoms with labels.
            Format::ExtXyz | Format::Poscar => 1 << 30,
        }
    }

    /// Returns the format that the file's name stands for: `.xyz`, `.extxyz`, `.cif`, `.vasp`, `.poscar`, `.contcar`, or a name that begins
    /// with `POSCAR`, `CONTCAR` or `XDATCAR`.
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
            _ if ["poscar", "contcar", "xdatcar"].iter().any(|n| name.starts_with(n)) => {
                Ok(Format::Poscar)
            }
            _ if let Some(advice) = foreign_formats::by_name(path) => {
                Err(Error::invalid(Setting::StructureFile, path.display(), advice))
            }
            _ => Err(Error::invalid(
                Setting::StructureFile,
                path.display(),
                "the name must end in .cif, .xyz, .extxyz, .vasp or .poscar, or begin with POSCAR, \
                 CONTCAR or XDATCAR; rename or convert the file",
            )),
        }
    }
}

/// A structure, and warnings about its file: what was left out, and where the file contradicts itself.
#[derive(Debug, Clone, PartialEq)]
pub struct ReadStructure {
    /// The atoms in their cell.
    pub structure: Structure,
    /// Warnings, as sentences for the user.
    pub notes: Vec<String>,
}

/// Reads a structure like [`read_noted`], without the warnings.
///
/// # Errors
/// As [`read_noted`].
pub fn read(path: &Path) -> Result<Structure> {
    Ok(read_noted(path)?.structure)
}

/// Reads a structure; the file's name determines the format (see [`Format::from_path`]).
///
/// Left-handed cells are accepted unchanged: the positions are Cartesian, so handedness of the cell vectors does not mirror the crystal.
///
/// # Errors
/// [`Error::Io`], [`Error::Invalid`] for an unknown format, [`Error::Parse`] with the line.
pub fn read_noted(path: &Path) -> Result<ReadStructure> {
    let format = Format::from_path(path)?;
    parse_noted(format, &whole_file::read(path, format.most_bytes())?, path)
}

/// The thermal displacements in a file.
#[derive(Debug, Clone, PartialEq)]
pub struct FileSigmas {
    /// [`Sigmas::OfAtoms`] for the structure in the file.
    pub sigmas: Sigmas,
    /// Warnings, as sentences for the user.
    pub notes: Vec<String>,
}

/// Returns the thermal displacements in a CIF: anisotropic ones are used atom by atom, isotropic U or B of the other atoms are averaged for
/// each element.
///
/// # Errors
/// [`Error::Io`], [`Error::Parse`] for another format, and for atoms without a value.
pub fn sigmas_of_file(path: &Path) -> Result<FileSigmas> {
    if Format::from_path(path)? != Format::Cif {
        let message = "contains no thermal displacements; only a CIF can (U or B of its sites)";
        return Err(Error::parse(path, 0, message));
    }
    let text = whole_file::read_text(path, Format::Cif.most_bytes())?;
    let text = SourceText { path, body: text.strip_prefix('\u{feff}').unwrap_or(&text) };
    cif::displacements(&text)
}

/// Reads a structure from memory like [`parse_noted`], without the warnings.
///
/// # Errors
/// [`Error::Parse`] with the line.
pub fn parse(format: Format, bytes: &[u8], path: &Path) -> Result<Structure> {
    Ok(parse_noted(format, bytes, path)?.structure)
}

/// Reads a structure from memory; `path` only names it in errors.
///
/// # Errors
/// [`Error::Parse`] with the line.
pub fn parse_noted(format: Format, bytes: &[u8], path: &Path) -> Result<ReadStructure> {
    let text = source_text(format, bytes, path)?;
    let (structure, mut notes) = match format {
        Format::ExtXyz => (xyz::parse(&text)?, Vec::new()),
        Format::Cif => cif::parse(&text)?,
        Format::Poscar => (poscar::parse(&text)?, Vec::new()),
    };
    notes.extend(structure.crowded_sites());
    Ok(ReadStructure { structure, notes })
}

/// Returns the text of a file, after checking that it is of a format that is read.
fn source_text<'a>(format: Format, bytes: &'a [u8], path: &'a Path) -> Result<SourceText<'a>> {
    #[cfg(test)]
    PARSED.set(PARSED.get() + 1);
    if let Some(advice) = foreign_formats::by_bytes(bytes) {
        return Err(Error::parse(path, 0, advice));
    }
    let text = std::str::from_utf8(bytes).map_err(|e| {
        let line = 1 + bytes[..e.valid_up_to()].iter().filter(|&&b| b == b'\n').count();
        Error::parse(path, line, "not UTF-8 text; save the file as plain text in UTF-8")
    })?;
    let text = SourceText { path, body: text.strip_prefix('\u{feff}').unwrap_or(text) };
    if text.body.trim().is_empty() {
        return Err(text.error(0, "the file is empty"));
    }
    if let Some(advice) = foreign_formats::by_text(text.body, format == Format::ExtXyz) {
        return Err(text.error(1, advice));
    }
    text.check_lines()?;
    Ok(text)
}

/// Reads atoms with their labels from memory: extended XYZ has labels, other formats have none. `path` only names the file in errors.
///
/// # Errors
/// As [`parse`]; [`Error::Parse`] with the line of a label that is not understood, and for sites that are partly occupied.
pub(crate) fn parse_labelled(format: Format, bytes: &[u8], path: &Path) -> Result<LabelledAtoms> {
    if format != Format::ExtXyz {
        let ReadStructure { structure, notes } = parse_noted(format, bytes, path)?;
        return LabelledAtoms::of(&structure, notes)
            .map_err(|message| Error::parse(path, 0, message));
    }
    let text = source_text(format, bytes, path)?;
    let mut labels = LabelReader::default();
    let structure = xyz::read_frame(&text, Some(&mut labels))?;
    Ok(labels.finish(structure.cell))
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
        assert!(of("x.abc").unwrap_err().to_string().contains(".cif, .xyz"));
        assert!(of("x.pdb").unwrap_err().to_string().contains("a PDB file"));
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
