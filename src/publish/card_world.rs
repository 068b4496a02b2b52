//! The information about a world that its card needs.

use std::path::{Path, PathBuf};

use crate::error::{Error, Result};
use crate::io::WorldFile;
use crate::recipe::Recipe;
use crate::setting::Setting;
use crate::world::WorldFacts;

/// A world in a card.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct CardWorld {
    /// Path of the file.
    pub path: PathBuf,
    /// Name of the file without its ending.
    pub name: String,
    /// Contents of the file in numbers.
    pub facts: WorldFacts,
    /// The command that makes the world again, if there is one.
    pub command: Option<String>,
    /// How the result of that command may differ from this file, if it may.
    pub note: Option<String>,
    /// The recipe as TOML, if that command reads it from `recipes/NAME.toml`.
    pub recipe_text: Option<String>,
    /// The recipe in the file, if this version can read it.
    pub recipe: Option<Recipe>,
}

/// The pictures of a world, as PNG.
#[derive(Debug, Clone)]
pub struct CardPictures {
    /// The whole field.
    pub whole: Vec<u8>,
    /// A part of the field in which columns are large enough to be seen, with its description; `None` if the whole field shows them.
    pub part: Option<(String, Vec<u8>)>,
}

impl CardWorld {
    /// Collects the facts of a world; the command is not known yet.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a damaged file, or a name that a hub does not accept.
    pub fn of(world: &WorldFile) -> Result<Self> {
        let path = world.path();
        let text = world.metadata().recipe.as_deref();
        Ok(CardWorld {
            path: path.to_owned(),
            name: card_name(path)?,
            facts: WorldFacts::of(world)?,
            command: None,
            note: None,
            recipe_text: None,
            recipe: text.and_then(|text| Recipe::from_toml_str("recipe", text, None).ok()),
        })
    }

    /// Returns the name of the file.
    pub fn file_name(&self) -> String {
        self.path.file_name().unwrap_or_default().to_string_lossy().into_owned()
    }

    /// Returns the path of the recipe in the folder of the card.
    #[must_use]
    pub fn recipe_path(name: &str) -> String {
        format!("recipes/{name}.toml")
    }

    /// Whether stemgen made the world.
    pub(super) fn is_ours(&self) -> bool {
        self.facts.stemgen_version.is_some() && self.facts.engine.is_some()
    }
}

/// Returns the name of a file without its ending, if it can stand in addresses and tables unchanged.
fn card_name(path: &Path) -> Result<String> {
    let name = path.file_stem().unwrap_or_default().to_string_lossy();
    let plain = |c: char| c.is_ascii_alphanumeric() || "_-.".contains(c);
    let begins = name.starts_with(|c: char| c.is_ascii_alphanumeric());
    if begins && name.len() <= 128 && name.chars().all(plain) {
        return Ok(name.into_owned());
    }
    let expected = "its name becomes part of addresses: rename it, to at most 128 letters (a-z), digits, _ - and .";
    Err(Error::invalid(Setting::WorldFile, path.display(), expected))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_can_stand_in_addresses() {
        assert_eq!(card_name(Path::new("a/srtio3_1x1.h5")).unwrap(), "srtio3_1x1");
        for bad in ["a b.h5", "ä.h5", "-a.h5", ".h5", "a,b.h5", "x/a\nb.h5"] {
            let message = card_name(Path::new(bad)).unwrap_err().to_string();
            assert!(message.contains("rename it"), "{message}");
        }
    }
}
