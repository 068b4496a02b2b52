//! Frames of a trajectory in extended XYZ: each is a structure of its own.

use crate::files::whole_file;
use std::path::Path;

use super::read::{Format, parse};
use super::{Structure, elements};
use crate::error::{Error, Result};

/// Most frames that are read.
const MOST_FRAMES: usize = 100_000;
/// Cells that differ by less than this in Angstrom are one.
const SAME_CELL_ANGSTROM: f64 = 1e-4;

/// Which frames: the first, the first that is none of them, and the step. Frames count from 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FrameRange {
    /// First.
    pub start: usize,
    /// The first that is not read; `None` for all to the end.
    pub end: Option<usize>,
    /// Every how many-th.
    pub step: usize,
}

impl FrameRange {
    fn holds(&self, frame: usize) -> bool {
        let before = self.end.is_none_or(|end| frame < end);
        frame >= self.start && before && (frame - self.start).is_multiple_of(self.step.max(1))
    }
}

/// Reads some frames of a trajectory. They have one cell and the same elements.
///
/// # Errors
/// [`Error::Io`], [`Error::Parse`] with the line, [`Error::Invalid`] for another format.
pub fn read_frames(path: &Path, range: FrameRange) -> Result<Vec<Structure>> {
    if Format::from_path(path)? != Format::ExtXyz {
        return Err(Error::parse(
            path,
            0,
            "holds one structure; frames are read from extended XYZ",
        ));
    }
    let text = whole_file::read_text(path, Format::ExtXyz.most_bytes())?;
    let lines: Vec<&str> = text.lines().collect();
    let (mut at, mut number) = (0, 0);
    let mut frames: Vec<Structure> = Vec::new();
    while at < lines.len() && frames.len() <= MOST_FRAMES {
        if lines[at].trim().is_empty() {
            at += 1;
            continue;
        }
        let atoms: usize = lines[at].trim().parse().map_err(|_| {
            let found = lines[at].trim().chars().take(40).collect::<String>();
            Error::parse(path, at + 1, format!("expected the number of atoms, found `{found}`"))
        })?;
        let end = at.saturating_add(2).saturating_add(atoms).min(lines.len());
        if range.holds(number) {
            let body = lines[at..end].join("\n");
            let frame = parse(Format::ExtXyz, body.as_bytes(), path).map_err(|e| shifted(e, at))?;
            if let Some(first) = frames.first() {
                check_alike(path, at, first, &frame)?;
            }
            frames.push(frame);
        }
        at = end;
        number += 1;
    }
    if frames.is_empty() {
        let message = format!("holds {number} frames, and none of those asked for");
        return Err(Error::parse(path, 0, message));
    }
    Ok(frames)
}

/// The error with the line in the whole file.
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
            Ok::<_, Error>(frames.iter().map(|f| f.atoms[0].position[0]).collect::<Vec<_>>())
        };
        assert_eq!(read(2, Some(9), 3).unwrap(), [2.25, 5.25, 8.25]);
        assert_eq!(read(8, None, 1).unwrap(), [8.25, 9.25]);
        assert!(read(10, None, 1).unwrap_err().to_string().contains("holds 10 frames"));
        std::fs::write(&path, all.replace("Si 3.25", "Xx 3.25")).unwrap();
        assert!(read(0, None, 1).unwrap_err().to_string().contains("md.xyz:12: "));
        let other = all.replacen("4 0 0 0 4\"", "4 0 0 0 5\"", 2).replacen("0 5\"", "0 4\"", 1);
        std::fs::write(&path, other).unwrap();
        assert!(read(0, None, 1).unwrap_err().to_string().contains("another cell"));
    }
}
