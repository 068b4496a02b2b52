//! Writes the sites of a specimen piece by piece, as extended XYZ or CIF.
//!
//! Besides element and position every site has `atom_type` (codes of [`super::atom_type`]), `defect_type` (`none`, `vacancy_O` ...),
//! `column` (the index of its atomic column, -1 for none) and `occupancy` (0 for a vacant site). In extended XYZ a vacant site has the
//! species `X`, which no program reads as an atom; in CIF it keeps the missing element.

use std::fs::File;
use std::io::{BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use super::atom_type;
use crate::error::{Error, Result};
use crate::setting::Setting;
use crate::structure::{Format, elements};

/// Width of the number of atoms in the first line of extended XYZ; the number is known only at the end.
const COUNT_WIDTH: usize = 20;

/// One site.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct AtomRow<'a> {
    /// Atomic number; of a vacant site, the atomic number of the missing atom.
    pub number: u8,
    /// Position in Angstrom.
    pub position_angstrom: [f64; 3],
    /// Code of [`super::atom_type`].
    pub atom_type: i32,
    /// Name of the defect; empty for none.
    pub defect: &'a str,
    /// Index of the column; `None`, written as -1, for an atom of a layer on the specimen.
    pub column: Option<u64>,
}

/// Header of a file of atoms.
#[derive(Debug, Clone, Default)]
pub(crate) struct AtomsHeader {
    /// Name of the data: `srtio3_easy`.
    pub name: String,
    /// Edges of the (orthogonal) cell in Angstrom.
    pub cell_angstrom: [f64; 3],
    /// Further keys and values, each on one line.
    pub notes: Vec<(&'static str, String)>,
    /// The recipe as TOML; extended XYZ holds it as JSON, since it must fit on a line.
    pub recipe: String,
}

/// Formats rows; cheap to copy to other threads.
#[derive(Debug, Clone, Copy)]
pub(crate) struct RowFormat {
    format: Format,
    cell_angstrom: [f64; 3],
}

/// A file of atoms that is being written.
pub(crate) struct AtomsWriter {
    path: PathBuf,
    out: BufWriter<File>,
    rows: RowFormat,
}

impl AtomsWriter {
    /// Begins a file; the ending of `name` selects the format: `.extxyz`, `.xyz` or `.cif`.
    ///
    /// # Errors
    /// [`Error::Invalid`] for another ending, [`Error::Io`].
    pub(crate) fn create(path: &Path, name: &Path, header: &AtomsHeader) -> Result<Self> {
        let format = writable(name)?;
        let file = File::create(path).map_err(|e| Error::io(path, "create", e))?;
        let rows = RowFormat { format, cell_angstrom: header.cell_angstrom };
        let mut writer = AtomsWriter {
            path: path.to_owned(),
            out: BufWriter::with_capacity(1 << 20, file),
            rows,
        };
        writer.append(match format {
            Format::Cif => cif_head(header),
            _ => extxyz_head(header),
        })?;
        Ok(writer)
    }

    /// Returns the formatter of the rows of this file.
    pub(crate) fn rows(&self) -> RowFormat {
        self.rows
    }

    /// Appends formatted rows.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub(crate) fn append(&mut self, text: impl AsRef<[u8]>) -> Result<()> {
        self.out.write_all(text.as_ref()).map_err(|e| Error::io(&self.path, "write", e))
    }

    /// Writes all data out and completes the file; `count` is the number of rows.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub(crate) fn finish(mut self, count: u64) -> Result<()> {
        let mut end = || {
            if self.rows.format == Format::ExtXyz {
                self.out.seek(SeekFrom::Start(0))?;
                write!(self.out, "{count:<COUNT_WIDTH$}")?;
            }
            self.out.flush()
        };
        end().map_err(|e| Error::io(&self.path, "write", e))
    }
}

/// Returns the format that the ending of a name selects, if it can be written.
///
/// # Errors
/// [`Error::Invalid`].
pub fn writable(name: &Path) -> Result<Format> {
    match Format::from_path(name) {
        Ok(format @ (Format::ExtXyz | Format::Cif)) => Ok(format),
        _ => {
            let expected = "atoms are written as extended XYZ or CIF; the name must end in \
                            .extxyz, .xyz or .cif";
            Err(Error::invalid(Setting::Output, name.display(), expected))
        }
    }
}

impl RowFormat {
    /// Appends one row; `serial` numbers the rows of the file from 1.
    pub(crate) fn push(&self, out: &mut Vec<u8>, row: &AtomRow, serial: u64) {
        let vacant = row.atom_type == atom_type::VACANCY;
        let defect = if row.defect.is_empty() { "none" } else { row.defect };
        let symbol = elements::symbol(row.number);
        let [x, y, z] = row.position_angstrom;
        let occupancy = u8::from(!vacant);
        match self.format {
            Format::Cif => {
                text(out, format_args!("{symbol}{serial} {symbol} "));
                for (value, edge) in [x, y, z].into_iter().zip(self.cell_angstrom) {
                    fixed(out, value / edge, 8);
                }
            }
            _ => {
                text(out, format_args!("{} ", if vacant { "X" } else { symbol }));
                [x, y, z].into_iter().for_each(|value| fixed(out, value, 5));
            }
        }
        let (code, column) = (row.atom_type, row.column.map_or(-1, |n| n as i64));
        text(out, format_args!("{occupancy} {code} {defect} {column}\n"));
    }
}

fn text(out: &mut Vec<u8>, arguments: std::fmt::Arguments) {
    // Writing to memory cannot fail.
    let _ = out.write_fmt(arguments);
}

/// Appends a number with `decimals` decimals, and a space. Several times as fast as `{:.5}`.
fn fixed(out: &mut Vec<u8>, value: f64, decimals: u32) {
    let unit = 10u64.pow(decimals);
    let scaled = (value * unit as f64).round() as i64;
    if scaled < 0 {
        out.push(b'-');
    }
    let (mut whole, mut part) = (scaled.unsigned_abs() / unit, scaled.unsigned_abs() % unit);
    let mut digits = [b'0'; 32];
    let mut at = digits.len();
    for _ in 0..decimals {
        at -= 1;
        digits[at] = b'0' + (part % 10) as u8;
        part /= 10;
    }
    at -= 1;
    digits[at] = b'.';
    loop {
        at -= 1;
        digits[at] = b'0' + (whole % 10) as u8;
        whole /= 10;
        if whole == 0 {
            break;
        }
    }
    out.extend_from_slice(&digits[at..]);
    out.push(b' ');
}

fn extxyz_head(header: &AtomsHeader) -> String {
    let [a, b, c] = header.cell_angstrom;
    let mut line = format!(
        "Lattice=\"{a} 0 0 0 {b} 0 0 0 {c}\" Properties=species:S:1:pos:R:3:occupancy:R:1:\
         atom_type:I:1:defect_type:S:1:column:I:1 pbc=\"F F F\" name={}",
        quoted(&header.name)
    );
    let json = toml::from_str::<serde_json::Value>(&header.recipe).unwrap_or_default().to_string();
    for (key, value) in header.notes.iter().chain([&("recipe", json)]) {
        line += &format!(" {key}={}", quoted(value));
    }
    format!("{:<COUNT_WIDTH$}\n{line}\n", 0)
}

fn quoted(value: &str) -> String {
    format!("\"{}\"", one_line(value).replace('\\', "\\\\").replace('"', "\\\""))
}

fn one_line(value: &str) -> String {
    value.replace(['\n', '\r'], " ")
}

fn cif_head(header: &AtomsHeader) -> String {
    let word = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
    let name: String = header.name.chars().map(word).collect();
    let [a, b, c] = header.cell_angstrom;
    let mut out = String::new();
    for (key, value) in &header.notes {
        out += &format!("# {key}: {}\n", one_line(value));
    }
    let lines: Vec<&str> = header.recipe.lines().collect();
    out += &format!("# recipe:\n#   {}\n", lines.join("\n#   "));
    out += &format!(
        "data_{name}\n\
         _audit_creation_method 'stemgen {}'\n\
         _cell_length_a {a}\n_cell_length_b {b}\n_cell_length_c {c}\n\
         _cell_angle_alpha 90\n_cell_angle_beta 90\n_cell_angle_gamma 90\n\
         _space_group_name_H-M_alt 'P 1'\n_space_group_IT_number 1\n\
         loop_\n_space_group_symop_operation_xyz\n'x, y, z'\n\
         loop_\n_atom_site_label\n_atom_site_type_symbol\n\
         _atom_site_fract_x\n_atom_site_fract_y\n_atom_site_fract_z\n_atom_site_occupancy\n\
         _atom_site_stemgen_atom_type\n_atom_site_stemgen_defect_type\n_atom_site_stemgen_column\n",
        env!("CARGO_PKG_VERSION")
    );
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_fixed_decimals() {
        let of = |value: f64, decimals| {
            let mut out = Vec::new();
            fixed(&mut out, value, decimals);
            String::from_utf8(out).unwrap()
        };
        for value in [0.0, 1.0, -0.00001, 999.999994, 999.999996, 3.905, -12.5, 0.1 + 0.2] {
            assert_eq!(of(value, 5), format!("{value:.5} "), "{value}");
        }
        assert_eq!(of(-0.000001, 5), "0.00000 ");
        assert_eq!(of(0.123456789, 8), "0.12345679 ");
    }

    #[test]
    fn other_endings_are_refused() {
        assert!(writable(Path::new("a.extxyz")).is_ok() && writable(Path::new("a.CIF")).is_ok());
        let message = writable(Path::new("a.vasp")).unwrap_err().to_string();
        assert!(message.contains(".extxyz"), "{message}");
    }
}
