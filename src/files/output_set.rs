//! Several outputs of one command. Each appears complete or not at all. If the command ends between two of them, the next run of that
//! command makes the missing ones, as a build does.
//!
//! Before the first output gets its name, a note beside it (`<output>.unfinished`) records the command; it is removed when the last output
//! is in place. If the note is found, the existing outputs belong to that command, which may replace them.

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use super::atomic_write;
use super::outputs::{UNFINISHED, beside};
use crate::error::{Error, Result};
use crate::setting::Setting;

/// First line of a note.
const TITLE: &str = "stemgen was ended before all files of this command were written; the same command writes them:";

/// The outputs of one command.
#[derive(Debug)]
pub struct OutputSet {
    first: PathBuf,
    note: PathBuf,
    text: String,
    overwrite: bool,
    left: bool,
    begun: bool,
}

impl OutputSet {
    /// Returns the outputs of a command, of which `first` is written first.
    #[must_use]
    pub fn of(first: &Path, command: &str, overwrite: bool) -> Self {
        let note = beside(first, UNFINISHED);
        let text = format!("{TITLE}\n{command}\n");
        let left = fs::read(&note).is_ok_and(|found| found == text.as_bytes());
        OutputSet { first: first.to_owned(), note, text, overwrite, left, begun: false }
    }

    /// Whether existing outputs may be replaced: because the user allows it, or because an earlier run of this command has left them.
    #[must_use]
    pub fn replaces(&self) -> bool {
        self.overwrite || self.left
    }

    /// Returns the warning about an earlier run that ended between its outputs.
    #[must_use]
    pub fn warning(&self) -> Option<String> {
        let message = "an earlier run of this command ended before all its files were written; all are written again";
        self.left.then(|| format!("{}: {message}", self.note.display()))
    }

    /// Writes the note, before outputs get their names.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a foreign file at the path of the note, [`Error::Io`].
    pub fn begin(&mut self) -> Result<()> {
        let foreign = match fs::read(&self.note) {
            Ok(found) => !found.starts_with(TITLE.as_bytes()),
            Err(e) => e.kind() != ErrorKind::NotFound,
        };
        if foreign {
            let why = "this command writes a note here, but the place holds something else; move it, or name another output";
            return Err(Error::invalid(Setting::Output, self.note.display(), why));
        }
        atomic_write::write(&self.note, self.text.as_bytes())?;
        self.begun = true;
        Ok(())
    }

    /// Removes the note, since all outputs are in place.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn finish(self) -> Result<()> {
        match fs::remove_file(&self.note) {
            Err(e) if e.kind() != ErrorKind::NotFound => Err(Error::io(&self.note, "remove", e)),
            _ => Ok(()),
        }
    }
}

impl Drop for OutputSet {
    /// Removes the note of a command that failed before its first output.
    fn drop(&mut self) {
        if self.begun && !self.first.exists() {
            let _ = fs::remove_file(&self.note);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_command_that_was_ended_replaces_its_outputs() {
        let folder = tempfile::tempdir().unwrap();
        let first = folder.path().join("s.h5");
        let of = |command: &str| OutputSet::of(&first, command, false);
        assert!(!of("a").replaces() && OutputSet::of(&first, "a", true).replaces());
        of("a").begin().unwrap();
        assert!(!of("a").replaces(), "nothing was written");
        fs::write(&first, "an image").unwrap();
        of("a").begin().unwrap();
        assert!(of("a").replaces() && of("a").warning().unwrap().contains("s.h5.unfinished"));
        assert!(!of("b").replaces() && of("b").warning().is_none());
        of("a").finish().unwrap();
        of("a").finish().unwrap();
        assert!(!of("a").replaces() && fs::read_dir(folder.path()).unwrap().count() == 1);
    }

    #[test]
    fn the_note_replaces_nothing_of_others() {
        let folder = tempfile::tempdir().unwrap();
        let first = folder.path().join("s.h5");
        let note = folder.path().join("s.h5.unfinished");
        fs::write(&note, "mine").unwrap();
        let message = OutputSet::of(&first, "a", true).begin().unwrap_err().to_string();
        assert!(message.contains("holds something else"), "{message}");
        assert_eq!(fs::read(&note).unwrap(), b"mine");
        fs::remove_file(&note).unwrap();
        fs::create_dir(&note).unwrap();
        assert!(OutputSet::of(&first, "a", true).begin().is_err());
    }
}
