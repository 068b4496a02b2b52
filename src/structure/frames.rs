//! Reads the frames of a trajectory in extended XYZ or XDATCAR; each frame is a separate structure.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::poscar::begins_frame;
use super::read::{Format, ReadStructure, parse_noted};
use super::{Structure, elements};
use crate::error::{Error, Result};
use crate::files::whole_file;

/// Largest number of frames that are read.
const MOST_FRAMES: usize = 100_000;
/// Number of lines in the header of an XDATCAR: a comment, the scale, the cell, symbols and counts.
const XDATCAR_HEAD: usize = 7;
/// Cells that differ by less than this in Angstrom count as equal.
const SAME_CELL_ANGSTROM: f64 = 1e-4;

/// A range of frames: the first, the last, and the step, as in any series START:END:STEP. Frames count from 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FrameRange {
    /// First frame.
    #[serde(default)]
    pub start: usize,
    /// Last frame that may be read; `None` reads to the end.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub end: Option<usize>,
    /// Step: every `step`-th frame is read.
    #[serde(default = "one")]
    pub step: usize,
}

fn one() -> usize {
    1
}

impl FrameRange {
    /// Returns the number in its file of a chosen frame, both counted from 0.
    #[must_use]
    pub(crate) fn number(&self, chosen: usize) -> usize {
        self.start + chosen * self.step.max(1)
    }

    fn holds(&self, frame: usize) -> bool {
        let before = self.end.is_none_or(|end| frame <= end);
        frame >= self.start && before && (frame - self.start).is_multiple_of(self.step.max(1))
    }
}

/// Reads some frames of a trajectory in extended XYZ or VASP's XDATCAR, each with warnings about it. All frames have one cell and the same
/// elements.
///
/// # Errors
/// [`Error::Io`], [`Error::Parse`] with the line, [`Error::Invalid`] for another format.
pub fn read_frames(path: &Path, range: FrameRange) -> Result<Vec<ReadStructure>> {
    let format = Format::from_path(path)?;
    if format == Format::Cif {
        let message = "holds one structure; frames are read from extended XYZ and XDATCAR";
        return Err(Error::parse(path, 0, message));
    }
    let text = whole_file::read_text(path, format.most_bytes())?;
    let lines: Vec<&str> = text.lines().collect();
    let mut chosen = ChosenFrames { path, format, range, frames: Vec::new(), passed: 0 };
    match format {
        Format::ExtXyz => chosen.take_xyz(&lines)?,
        Format::Poscar | Format::Cif => chosen.take_xdatcar(&lines)?,
    }
    if chosen.frames.is_empty() {
        let message = format!(
            "holds {} frames, none of them in the chosen range; frames count from 0",
            chosen.passed
        );
        return Err(Error::parse(path, 0, message));
    }
    Ok(chosen.frames)
}

/// The chosen frames of a trajectory.
struct ChosenFrames<'a> {
    path: &'a Path,
    format: Format,
    range: FrameRange,
    frames: Vec<ReadStructure>,
    /// Number of frames of the file so far.
    passed: usize,
}

impl ChosenFrames<'_> {
    fn take_xyz(&mut self, lines: &[&str]) -> Result<()> {
        let mut at = 0;
        while at < lines.len() && self.frames.len() <= MOST_FRAMES {
            if lines[at].trim().is_empty() {
                at += 1;
                continue;
            }
            let atoms: usize = lines[at].trim().parse().map_err(|_| {
                let found = lines[at].trim().chars().take(40).collect::<String>();
                let message = format!("expected the number of atoms, found `{found}`");
                Error::parse(self.path, at + 1, message)
            })?;
            let end = at.saturating_add(2).saturating_add(atoms).min(lines.len());
            self.take(at, || lines[at..end].join("\n"))?;
            at = end;
        }
        Ok(())
    }

    /// Reads an XDATCAR. Each frame follows the header of the file, or a new header where the cell changes.
    fn take_xdatcar(&mut self, lines: &[&str]) -> Result<()> {
        let begins: Vec<usize> = (0..lines.len()).filter(|&at| begins_frame(lines[at])).collect();
        let Some(&first) = begins.first() else {
            let message = "holds one structure; frames are read from extended XYZ and XDATCAR";
            return Err(Error::parse(self.path, 0, message));
        };
        let mut head = &lines[..first];
        for (number, &at) in begins.iter().enumerate() {
            let end = begins.get(number + 1).copied().unwrap_or(lines.len());
            let mut rows = &lines[at..end];
            // The header of the next frame stands at the end of this one.
            let next = rows.len().checked_sub(XDATCAR_HEAD).filter(|&next| {
                number + 1 < begins.len() && rows[next + 1].split_whitespace().count() == 1
            });
            let next_head = next.map_or(head, |next| &rows[next..]);
            rows = next.map_or(rows, |next| &rows[..next]);
            self.take(at.saturating_sub(head.len()), || {
                let frame: Vec<&str> = head.iter().chain(rows).copied().collect();
                frame.join("\n")
            })?;
            head = next_head;
            if self.frames.len() > MOST_FRAMES {
                break;
            }
        }
        Ok(())
    }

    /// Reads the next frame, which begins after `lines_before` lines, if it is chosen.
    fn take(&mut self, lines_before: usize, body: impl FnOnce() -> String) -> Result<()> {
        if self.range.holds(self.passed) {
            let frame = parse_noted(self.format, body().as_bytes(), self.path)
                .map_err(|e| shifted(e, lines_before))?;
            if let Some(first) = self.frames.first() {
                check_alike(self.path, lines_before, &first.structure, &frame.structure)?;
            }
            self.frames.push(frame);
        }
        self.passed += 1;
        Ok(())
    }
}

/// Returns the error with the line in the whole file.
fn shifted(error: Error, first: usize) -> Error {
    match error {
        Error::Parse { path, line, message } if line > 0 => {
            Error::Parse { path, line: line + first, message }
        }
        other => other,
    }
}

fn check_alike(path: &Path, at: usize, first: &Structure, frame: &Structure) -> Result<()> {
    let (a, b) = (first.cell.as_flattened(), frame.cell.as_flattened());
    if a.iter().zip(b).any(|(a, b)| (a - b).abs() > SAME_CELL_ANGSTROM) {
        let message = "this frame has another cell than the first; simulate at constant volume, or frame by frame";
        return Err(Error::parse(path, at + 2, message));
    }
    let known = |z: u8| first.atoms.iter().any(|a| a.number == z);
    match frame.atoms.iter().find(|a| !known(a.number)) {
        Some(atom) => {
            let symbol = elements::symbol(atom.number);
            Err(Error::parse(
                path,
                at + 1,
                format!("this frame holds {symbol}, the first does not"),
            ))
        }
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_chosen_and_faults_have_their_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("md.xyz");
        let head = "Lattice=\"4 0 0 0 4 0 0 0 4\" Properties=species:S:1:pos:R:3";
        let frame = |x: usize| format!("1\n{head}\nSi {x}.25 0 0\n");
        let all: String = (0..10).map(frame).collect();
        std::fs::write(&path, &all).unwrap();
        let read = |start, end, step| {
            let frames = read_frames(&path, FrameRange { start, end, step })?;
            Ok::<_, Error>(
                frames.iter().map(|f| f.structure.atoms[0].position[0]).collect::<Vec<_>>(),
            )
        };
        assert_eq!(read(2, Some(8), 3).unwrap(), [2.25, 5.25, 8.25]);
        assert_eq!(read(8, None, 1).unwrap(), [8.25, 9.25]);
        assert!(read(10, None, 1).unwrap_err().to_string().contains("holds 10 frames"));
        std::fs::write(&path, all.replace("Si 3.25", "Xx 3.25")).unwrap();
        assert!(read(0, None, 1).unwrap_err().to_string().contains("md.xyz:12: "));
        let other = all.replacen("4 0 0 0 4\"", "4 0 0 0 5\"", 2).replacen("0 5\"", "0 4\"", 1);
        std::fs::write(&path, other).unwrap();
        assert!(read(0, None, 1).unwrap_err().to_string().contains("another cell"));
    }

    #[test]
    fn an_xdatcar_has_frames() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("XDATCAR");
        let head = "x\n1\n4 0 0\n0 4 0\n0 0 4\nCu O\n1 1\n";
        let frame = |n: usize| format!("Direct configuration= {n}\n0.{n} 0 0\n.5 .5 .5\n");
        let all: String = (1..=4).map(frame).collect();
        std::fs::write(&path, format!("{head}{all}")).unwrap();
        let read = |start, step| {
            let frames = read_frames(&path, FrameRange { start, end: None, step })?;
            Ok::<_, Error>(
                frames.iter().map(|f| f.structure.atoms[0].position[0]).collect::<Vec<_>>(),
            )
        };
        let found = read(0, 2).unwrap();
        assert!(found.len() == 2 && (found[0] - 0.4).abs() + (found[1] - 1.2).abs() < 1e-12);
        let words = super::super::read(&path).unwrap_err().to_string();
        assert!(words.contains("XDATCAR:8: a trajectory of 4 frames"), "{words}");
        // A trajectory with a header for each frame, where the cell may change.
        let all: String = (1..=3).map(|n| format!("{head}{}", frame(n))).collect();
        std::fs::write(&path, &all).unwrap();
        assert_eq!(read(1, 1).unwrap().len(), 2);
        let other = all.replacen("0 0 4\n", "0 0 5\n", 3).replacen("0 0 5\n", "0 0 4\n", 2);
        std::fs::write(&path, other).unwrap();
        assert!(read(0, 1).unwrap_err().to_string().contains("another cell"));
    }
}
