//! The table `[atoms]` of a recipe, which names a file of atoms.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::files::file_digest::{sha256_of_bytes, sha256_of_file};
use crate::files::whole_file;
use crate::setting::Setting;
use crate::structure::{Format, LabelledAtoms, parse_labelled};

/// Value of `crystal` and `zone_axis` in recipes without a crystal.
pub(super) const NO_CRYSTAL: &str = "none";

/// The atoms of a file: extended XYZ, with labels of defects and phases if it has such columns, CIF or POSCAR. The beam runs along +z.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AtomsTable {
    /// Path of the file, relative to the recipe; in a resolved recipe, relative to the current folder or the recipe.
    pub file: String,
    /// SHA-256 of the file; another file is refused.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sha256: Option<String>,
    /// Position (x, y) in the file, in Angstrom, of the centre of the first pixel of the full field. When absent, the middle of the atoms
    /// is the middle of the field.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub origin_angstrom: Option<[f64; 2]>,
    /// Repeat the cell along x and y over the field and beyond.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub repeat: bool,
}

/// Key of a file that was read: its SHA-256 and its format.
type ReadKey = (String, Format);

/// The file that was read last: a recipe is changed and checked several times before its world is made.
static LAST_READ: Mutex<Option<(ReadKey, Arc<LabelledAtoms>)>> = Mutex::new(None);

/// Whether a path names a file of atoms.
pub fn is_atoms_file(path: &Path) -> bool {
    // A POSCAR may have any ending except the endings of recipes and worlds.
    let ending = path.extension().map(|ending| ending.to_ascii_lowercase()).unwrap_or_default();
    !["toml", "h5", "hdf5"].iter().any(|other| ending == *other) && Format::from_path(path).is_ok()
}

impl AtomsTable {
    /// Makes a table for a file that has not been searched yet.
    pub(crate) fn new(file: &str) -> Self {
        AtomsTable { file: file.to_owned(), sha256: None, origin_angstrom: None, repeat: false }
    }

    /// Finds the file relative to `folder`, and records its digest, if that has not been done before.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a name of no known format, [`Error::Io`].
    pub(super) fn find(&mut self, folder: &Path) -> Result<()> {
        if self.sha256.is_some() {
            return Ok(());
        }
        let path = folder.join(&self.file);
        whole_file::check(&path, Format::from_path(&path)?.most_bytes())?;
        let (sha256, _) = sha256_of_file(&path)?;
        self.file = path.display().to_string();
        self.sha256 = Some(sha256);
        Ok(())
    }

    /// Clears the digest if the table names another file than `before` but still has the old digest.
    pub(super) fn forget_another(&mut self, before: &AtomsTable) {
        if self.file != before.file && self.sha256 == before.sha256 {
            self.sha256 = None;
        }
    }

    /// Returns the paths at which the file may lie: its own path, and places in `folder`, the folder of the recipe or of a world built from
    /// it.
    fn places(&self, folder: &Path) -> Vec<PathBuf> {
        let own = PathBuf::from(&self.file);
        let beside = own.file_name().map(|name| folder.join(name));
        let mut places = vec![own.clone(), folder.join(&own)];
        places.extend(beside);
        let mut seen = Vec::new();
        places.retain(|place| {
            let new = !seen.contains(place);
            seen.push(place.clone());
            new
        });
        places
    }

    /// Reads the atoms; the file is searched at its own path, and in `folder`.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a file that is missing or has changed; errors of reading it.
    pub(super) fn atoms(&self, folder: &Path) -> Result<Arc<LabelledAtoms>> {
        let refuse =
            |expected: String| Err(Error::invalid(Setting::StructureFile, &self.file, expected));
        let format = Format::from_path(Path::new(&self.file))?;
        let Some(wanted) = &self.sha256 else {
            return refuse(
                "the recipe was not resolved: its file of atoms has not been read".into(),
            );
        };
        let key = (wanted.clone(), format);
        let last = || LAST_READ.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, atoms)) = last().as_ref().filter(|(known, _)| *known == key) {
            return Ok(Arc::clone(atoms));
        }
        let mut changed = None;
        for place in self.places(folder).iter().filter(|place| place.is_file()) {
            let bytes = whole_file::read(place, format.most_bytes())?;
            let found = sha256_of_bytes(&bytes);
            if found == *wanted {
                let atoms = Arc::new(parse_labelled(format, &bytes, place)?);
                *last() = Some((key, Arc::clone(&atoms)));
                return Ok(atoms);
            }
            changed.get_or_insert((place.display().to_string(), found));
        }
        match changed {
            Some((place, found)) => refuse(format!(
                "{place} has changed since the recipe was resolved: its SHA-256 is {found}, expected {wanted}; restore the file, or remove \
                 `sha256` from the table [atoms] to make another world from the changed file"
            )),
            None => refuse(format!(
                "the file does not exist: expected it at this place, or beside the recipe or world ({}), with the SHA-256 {wanted}",
                if folder.as_os_str().is_empty() {
                    ".".into()
                } else {
                    folder.display().to_string()
                }
            )),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn recipes_and_worlds_are_no_files_of_atoms() {
        for name in ["a.xyz", "b/a.CIF", "POSCAR", "POSCAR_relaxed", "a.vasp"] {
            assert!(is_atoms_file(Path::new(name)), "{name}");
        }
        for name in ["poscar.toml", "POSCAR.h5", "srtio3", "a.pdb"] {
            assert!(!is_atoms_file(Path::new(name)), "{name}");
        }
    }

    #[test]
    fn the_file_may_lie_beside_the_recipe() {
        let places = |file: &str, folder: &str| AtomsTable::new(file).places(Path::new(folder));
        let paths = |names: &[&str]| names.iter().map(PathBuf::from).collect::<Vec<_>>();
        assert_eq!(places("a/b.xyz", "w"), paths(&["a/b.xyz", "w/a/b.xyz", "w/b.xyz"]));
        assert_eq!(places("b.xyz", ""), paths(&["b.xyz"]));
    }
}
