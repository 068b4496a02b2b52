//! Crystals that are installed with the program: the files of `structures/`.

use super::{Format, Structure, parse};
use crate::error::{Error, Result};
use crate::setting::Setting;
use std::path::PathBuf;

macro_rules! library {
    ($($name:literal),*) => {
        [$(($name, include_str!(concat!("../../structures/", $name, ".cif")))),*]
    };
}

const LIBRARY: [(&str, &str); 12] = library![
    "srtio3",
    "batio3_cubic",
    "batio3_tetragonal",
    "si",
    "ge",
    "gaas",
    "gan",
    "inn",
    "pt",
    "mos2",
    "wse2",
    "graphene"
];

/// Returns the names of the crystals: `srtio3`, `batio3_cubic` ...
pub(crate) fn names() -> impl Iterator<Item = &'static str> + Clone {
    LIBRARY.iter().map(|(name, _)| *name)
}

/// Returns the CIF text of a crystal; `None` for an unknown name.
pub(crate) fn text(name: &str) -> Option<&'static str> {
    LIBRARY.iter().find(|(known, _)| *known == name).map(|(_, text)| *text)
}

/// Returns a crystal.
///
/// # Errors
/// [`Error::Invalid`] for an unknown name.
pub fn crystal(name: &str) -> Result<Structure> {
    let text = text(name).ok_or_else(|| {
        let known = names().collect::<Vec<_>>().join(", ");
        Error::invalid(Setting::Crystal, name, format!("known crystals: {known}"))
    })?;
    parse(Format::Cif, text.as_bytes(), &PathBuf::from(format!("structures/{name}.cif")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_crystal_of_the_folder_is_known_and_readable() {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("structures");
        let mut count = 0;
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.extension().is_some_and(|e| e == "cif") {
                let name = path.file_stem().unwrap().to_str().unwrap().to_owned();
                assert!(!crystal(&name).unwrap().atoms.is_empty(), "{name}");
                count += 1;
            }
        }
        assert_eq!(count, names().count());
        assert!(crystal("unobtainium").unwrap_err().to_string().contains("srtio3"));
    }
}
