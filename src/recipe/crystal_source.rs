//! The crystal that a recipe names: one of the program's crystals, or a file of the user.

use std::path::Path;

use serde::de::{self, MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::error::{Error, Result};
use crate::files::whole_file;
use crate::structure::{self, Format, Structure, crystals};

/// The name `"srtio3"` of a crystal (see [`crystals`]), or the path of a CIF, POSCAR or extended XYZ file relative to the recipe. The text
/// of the file becomes part of the resolved recipe, `{ file = ..., text = ... }`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CrystalSource {
    /// Name or path.
    pub name: String,
    /// Text of the file; `None` for a crystal of the program, and before the file was read.
    pub text: Option<String>,
}

impl CrystalSource {
    /// Names a crystal of the program, or a path that has not been read yet.
    pub(crate) fn new(name: &str) -> Self {
        CrystalSource { name: name.to_owned(), text: None }
    }

    /// Reads the file, if the name is a path and the file was not read before.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a name that is neither a crystal nor a path, [`Error::Io`].
    pub(crate) fn read(&mut self, folder: &Path) -> Result<()> {
        if self.text.is_some() || crystals::text(&self.name).is_some() {
            return Ok(());
        }
        let path = folder.join(&self.name);
        let Ok(format) = Format::from_path(&path) else {
            let known = crystals::names().collect::<Vec<_>>().join(", ");
            let near = super::toml_errors::nearest(&self.name, crystals::names());
            let hint = near.map(|n| format!("did you mean \"{n}\"? ")).unwrap_or_default();
            let expected =
                format!("{hint}expected a .cif file beside the recipe, or one of {known}");
            return Err(Error::invalid(crate::Setting::Crystal, &self.name, expected));
        };
        self.text = Some(whole_file::read_text(&path, format.most_bytes())?);
        Ok(())
    }

    /// Returns warnings about a file of the user: what was left out of it, and where it contradicts itself.
    ///
    /// # Errors
    /// As [`CrystalSource::structure`].
    pub(crate) fn notes(&self) -> Result<Vec<String>> {
        let Some(text) = &self.text else { return Ok(Vec::new()) };
        let path = Path::new(&self.name);
        let read = structure::parse_noted(Format::from_path(path)?, text.as_bytes(), path)?;
        Ok(read.notes.into_iter().map(|note| format!("{}: {note}", self.name)).collect())
    }

    /// Returns the crystal.
    ///
    /// # Errors
    /// [`Error::Parse`] with the line of the file; [`Error::Invalid`] for an unknown name, or a file
    /// that was not read.
    pub(crate) fn structure(&self) -> Result<Structure> {
        match &self.text {
            Some(text) => {
                let path = Path::new(&self.name);
                structure::parse(Format::from_path(path)?, text.as_bytes(), path)
            }
            None => crystals::crystal(&self.name),
        }
    }
}

impl Serialize for CrystalSource {
    fn serialize<S: Serializer>(&self, serializer: S) -> std::result::Result<S::Ok, S::Error> {
        use serde::ser::SerializeMap;
        let Some(text) = &self.text else { return serializer.serialize_str(&self.name) };
        let mut map = serializer.serialize_map(Some(2))?;
        map.serialize_entry("file", &self.name)?;
        map.serialize_entry("text", text)?;
        map.end()
    }
}

impl<'de> Deserialize<'de> for CrystalSource {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> std::result::Result<Self, D::Error> {
        deserializer.deserialize_any(NameOrFile)
    }
}

struct NameOrFile;

impl<'de> Visitor<'de> for NameOrFile {
    type Value = CrystalSource;

    fn expecting(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.write_str("the name of a crystal, or the path of its file")
    }

    fn visit_str<E: de::Error>(self, name: &str) -> std::result::Result<CrystalSource, E> {
        Ok(CrystalSource::new(name))
    }

    fn visit_map<A: MapAccess<'de>>(
        self,
        mut map: A,
    ) -> std::result::Result<CrystalSource, A::Error> {
        let (mut name, mut text) = (None, None);
        while let Some(key) = map.next_key::<String>()? {
            match key.as_str() {
                "file" => name = Some(map.next_value()?),
                "text" => text = Some(map.next_value()?),
                other => return Err(de::Error::unknown_field(other, &["file", "text"])),
            }
        }
        let name = name.ok_or_else(|| de::Error::missing_field("file"))?;
        Ok(CrystalSource { name, text })
    }
}
