//! Reads VASP POSCAR and CONTCAR files, version 5.

use super::lattice::{determinant, row_times};
use super::source_text::SourceText;
use super::{Atom, Structure};
use crate::error::Result;

/// The file's lines, taken one after another.
struct PoscarLines<'a> {
    text: &'a SourceText<'a>,
    lines: std::iter::Peekable<std::str::Lines<'a>>,
    /// Number of the last line taken.
    next: usize,
    /// Number of lines in the file.
    count: usize,
}

impl<'a> PoscarLines<'a> {
    /// Returns the next line, with its number; `what` names the line in the error if the file ends first.
    fn take(&mut self, what: &str) -> Result<(usize, &'a str)> {
        self.next += 1;
        match self.lines.next() {
            Some(line) if self.next == 1 => Ok((1, line.trim())),
            Some(line) => Ok((self.next, without_comment(line))),
            None => Err(self.text.error(self.next, format!("the file ends before {what}"))),
        }
    }
}

/// Returns a line up to `!` or `#`.
fn without_comment(line: &str) -> &str {
    line.split(['!', '#']).next().unwrap_or_default().trim()
}

/// The first word that begins each further frame of an XDATCAR.
const FRAME: &str = "direct configuration";

/// Whether a line begins a frame of an XDATCAR.
pub(super) fn begins_frame(line: &str) -> bool {
    line.trim().get(..FRAME.len()).is_some_and(|begin| begin.eq_ignore_ascii_case(FRAME))
}

/// Reads a POSCAR; velocities and anything else after a blank line are ignored.
pub(super) fn parse(text: &SourceText) -> Result<Structure> {
    let count = text.body.lines().count();
    let mut lines = PoscarLines { text, lines: text.body.lines().peekable(), next: 0, count };
    lines.take("the comment line")?;
    let (cell, scale) = cell(&mut lines)?;
    let numbers = species(&mut lines)?;
    let direct = is_direct(&mut lines)?;
    let mut atoms = Vec::new();
    for (index, &number) in numbers.iter().enumerate() {
        let (line, row) = lines.take(&format!("atom {} of {}", index + 1, numbers.len()))?;
        let raw = vector(text, line, row, "coordinate")?;
        let position = if direct {
            row_times(raw, &cell)
        } else {
            std::array::from_fn(|axis| raw[axis] * scale[axis])
        };
        atoms.push((line, Atom::new(number, position)));
    }
    let frames = text.body.lines().filter(|line| begins_frame(line)).count();
    if frames > 1 {
        let message = format!(
            "a trajectory of {frames} frames (XDATCAR) begins here, and a structure is one of them; choose frames, or keep \
             the one to be simulated"
        );
        return Err(text.error(lines.next - numbers.len(), message));
    }
    if let Some(row) = lines.lines.peek()
        && vector(text, 0, row, "").is_ok()
    {
        let message =
            format!("the counts announce {} atoms, but another one follows", numbers.len());
        return Err(text.error(lines.next + 1, message));
    }
    text.finish(cell, atoms)
}

/// Returns the scaled cell, and the scale of each Cartesian axis.
fn cell(lines: &mut PoscarLines) -> Result<([[f64; 3]; 3], [f64; 3])> {
    let (scale_line, row) = lines.take("the scale factor")?;
    // VASP ignores text after the numbers.
    let words: Vec<&str> = row
        .split_whitespace()
        .take_while(|w| w.starts_with(|c: char| !c.is_alphabetic()))
        .collect();
    if words.len() != 1 && words.len() != 3 {
        let message = format!("expected the scale factor (one number or three), found `{row}`");
        return Err(lines.text.error(scale_line, message));
    }
    let mut factors = Vec::new();
    for word in &words {
        factors.push(lines.text.number(scale_line, "the scale factor", word)?);
    }
    let mut cell = [[0.0; 3]; 3];
    for vector_of_cell in &mut cell {
        let (line, row) = lines.take("the three cell vectors")?;
        *vector_of_cell = vector(lines.text, line, row, "a cell vector's component")?;
    }
    let scale = match factors[..] {
        // A negative factor is the volume of the cell.
        [f] if f < 0.0 => [(-f / determinant(&cell).abs()).cbrt(); 3],
        [f] => [f; 3],
        _ => [factors[0], factors[1], factors[2]],
    };
    if scale.iter().any(|s| !s.is_finite() || *s <= 0.0) {
        let message = "the scale factor must be positive, or one negative number: minus the \
                       volume of a cell that has volume";
        return Err(lines.text.error(scale_line, message));
    }
    for row in &mut cell {
        *row = std::array::from_fn(|axis| row[axis] * scale[axis]);
    }
    lines.text.check_cell(scale_line + 1, &cell)?;
    Ok((cell, scale))
}

/// Returns the atomic number of every atom, from the line of symbols and the line of counts.
fn species(lines: &mut PoscarLines) -> Result<Vec<u8>> {
    let (line, symbols) = lines.take("the line of element symbols")?;
    if symbols.split_whitespace().next().is_none_or(|word| word.parse::<f64>().is_ok()) {
        let message = format!(
            "expected element symbols, found `{symbols}`; this is the format of VASP 4: insert a \
             line such as `Sr Ti O` above the counts"
        );
        return Err(lines.text.error(line, message));
    }
    let mut kinds = Vec::new();
    for word in symbols.split_whitespace() {
        // `Sr_sv` and `Sr/5a8f...` also name the potential.
        let symbol = word.split(['_', '/']).next().unwrap_or(word);
        if symbol.parse::<f64>().is_ok() {
            let message = format!("expected an element symbol, found the number `{symbol}`");
            return Err(lines.text.error(line, message));
        }
        kinds.push(lines.text.element(line, symbol)?);
    }
    let (line, counts) = lines.take("the line of counts")?;
    let counts: Vec<&str> = counts.split_whitespace().collect();
    if counts.len() != kinds.len() {
        let message = format!("{} counts for {} element symbols", counts.len(), kinds.len());
        return Err(lines.text.error(line, message));
    }
    let remaining = lines.count.saturating_sub(lines.next);
    let mut numbers = Vec::new();
    for (kind, word) in kinds.into_iter().zip(counts) {
        let count: usize = word.parse().map_err(|_| {
            lines.text.error(line, format!("expected a number of atoms, found `{word}`"))
        })?;
        if count > remaining - numbers.len().min(remaining) {
            let message = format!(
                "the counts announce more atoms than the {remaining} lines that follow; the file \
                 may be cut off"
            );
            return Err(lines.text.error(line, message));
        }
        lines.text.check_count(line, numbers.len() + count)?;
        numbers.extend(std::iter::repeat_n(kind, count));
    }
    Ok(numbers)
}

fn is_direct(lines: &mut PoscarLines) -> Result<bool> {
    let (mut line, mut row) = lines.take("the line `Direct` or `Cartesian`")?;
    if row.starts_with(['S', 's']) {
        (line, row) = lines.take("the line `Direct` or `Cartesian`")?;
    }
    match row.chars().next().map(|c| c.to_ascii_lowercase()) {
        Some('d') => Ok(true),
        Some('c' | 'k') => Ok(false),
        _ => {
            let message = format!("expected `Direct` or `Cartesian`, found `{row}`");
            Err(lines.text.error(line, message))
        }
    }
}

fn vector(text: &SourceText, line: usize, row: &str, what: &str) -> Result<[f64; 3]> {
    let words: Vec<&str> = row.split_whitespace().collect();
    if words.len() < 3 {
        return Err(text.error(line, format!("expected three numbers, found `{}`", row.trim())));
    }
    let mut vector = [0.0; 3];
    for (x, word) in vector.iter_mut().zip(words) {
        *x = text.number(line, what, word)?;
    }
    Ok(vector)
}

#[cfg(test)]
mod tests {
    use super::super::read::{Format, parse};
    use super::*;
    use std::path::Path;

    fn read(body: &str) -> Result<Structure> {
        parse(Format::Poscar, body.as_bytes(), Path::new("POSCAR"))
    }

    #[test]
    fn a_negative_scale_is_the_volume() {
        let s = read("c\n-64\n1 0 0\n0 1 0\n0 0 1\nSr_sv O\n1 1\nCart\n0 0 0\n.5 .5 .5\n").unwrap();
        for i in 0..3 {
            assert!((s.cell[i][i] - 4.0).abs() < 1e-12);
            assert!((s.atoms[1].position[i] - 2.0).abs() < 1e-12);
        }
        assert_eq!(s.atoms[0].number, 38);
    }

    #[test]
    fn selective_dynamics_and_velocities_are_passed_over() {
        let s = read(
            "c\n1.0\n4 0 0\n0 4 0\n0 0 4D0\nO\n1\nSelective dynamics\nDirect\n.25 0 0 T T F\n\n\
             0 0 1e-3\n",
        )
        .unwrap();
        assert_eq!(s.atoms.len(), 1);
        assert_eq!(s.atoms[0].position, [1.0, 0.0, 0.0]);
    }

    #[test]
    fn comments_end_lines() {
        let s = read(
            "c\n1.0 ! scale\n4 0 0 # a\n0 4 0\n0 0 4\nSr O ! kinds\n1 1 ! counts\nDirect\n0 0 0\n.5 .5 .5 O\n",
        )
        .unwrap();
        assert_eq!((s.atoms.len(), s.cell[0][0]), (2, 4.0));
        assert_eq!(
            read("c\n2 scale\n2 0 0\n0 2 0\n0 0 2\nO\n1\nD\n0 0 0\n").unwrap().cell[0][0],
            4.0
        );
        for bad in ["", "scale", "1.0 2.0 ! two", "1 2 3 4", "1.0.0"] {
            assert!(read(&format!("c\n{bad}\n4 0 0\n0 4 0\n0 0 4\nO\n1\nD\n0 0 0\n")).is_err());
        }
    }

    #[test]
    fn a_count_that_would_exhaust_memory_is_an_error() {
        let body = "c\n1\n4 0 0\n0 4 0\n0 0 4\nO\n18446744073709551615\nDirect\n0 0 0\n";
        assert!(read(body).unwrap_err().to_string().starts_with("POSCAR:7: the counts announce"));
    }
}
