//! The command that makes a world again.

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::invocation::PROGRAM;
use super::text::quoted;
use stemgen::engine::Expansion;
use stemgen::io::WorldFile;
use stemgen::numerics::NUMERICS_VERSION;
use stemgen::recipe::{CheckedRecipe, Recipe, RecipeChange};
use stemgen::world::{BuildMethod, BuildOptions, BuildProfile};

/// Most changes of a recipe on the command line. More changes are easier to read in a recipe file.
const MOST_CHANGES: usize = 6;

/// The command that makes a world again.
#[derive(Debug, Clone, Serialize)]
pub struct BuildAgain {
    /// The words of the command after the program's name; `None` if no command makes the world.
    pub arguments: Option<Vec<String>>,
    /// The recipe as TOML, if the command reads it from a file.
    pub recipe: Option<String>,
    /// The reason why there is no command, or why its pixels may differ.
    pub note: Option<String>,
}

impl BuildAgain {
    /// Finds the command that makes a world again and writes it to `output`. The command reads `recipe_file` if the recipe is not one
    /// of the program.
    pub fn of(world: &WorldFile, recipe_file: &Path, output: &Path) -> stemgen::Result<Self> {
        let none = |note: &str| {
            Ok(BuildAgain { arguments: None, recipe: None, note: Some(note.to_owned()) })
        };
        let Some(text) = &world.metadata().recipe else {
            if let Some(recorded) = world.making().recorded {
                return none(&format!(
                    "it is a recorded image; `stemgen import` converts {} to it",
                    recorded.file
                ));
            }
            return none("the file holds no recipe; it was not built by stemgen");
        };
        let name = world.path().display().to_string();
        let Ok(recipe) = Recipe::from_toml_str(&name, text, None) else {
            return none("this version of stemgen cannot read its recipe");
        };
        // The recipe of a file of atoms cannot be checked without this file, and the error names it.
        let own = recipe.atoms.is_some();
        let recipe = match recipe.checked() {
            Ok(recipe) => recipe,
            Err(error) if own => return none(&error.to_string()),
            Err(_) => return none("this version of stemgen cannot read its recipe"),
        };
        let Some(options) = BuildOptions::of_world(world, &recipe)? else {
            return none("no options of `stemgen build` give its engine settings");
        };
        let mut words = vec!["build".to_owned()];
        let own = recipe_words(&recipe, &mut words, recipe_file);
        words.extend(options_words(&options));
        words.extend(["-o".to_owned(), output.display().to_string()]);
        let recipe = own.then(|| recipe.to_toml());
        Ok(BuildAgain { arguments: Some(words), recipe, note: note(world) })
    }

    /// Returns the command as a line of a shell.
    pub fn line(&self) -> Option<String> {
        self.line_of(PROGRAM)
    }

    /// Returns the command as a line of a shell, for a program called `name`.
    pub fn line_of(&self, name: &str) -> Option<String> {
        let words = self.arguments.as_ref()?;
        let program = std::iter::once(name.to_owned());
        Some(program.chain(words.iter().map(|w| quoted(w))).collect::<Vec<_>>().join(" "))
    }
}

/// Returns the reason why pixels may differ.
fn note(world: &WorldFile) -> Option<String> {
    let making = world.making();
    match (making.numerics_version, making.subtile_nm) {
        (Some(NUMERICS_VERSION), Some(_)) => None,
        (Some(NUMERICS_VERSION), None) => Some(
            "the file does not hold the size of its sub-tiles; pixels differ if it was not the default"
                .into(),
        ),
        (made, _) => Some(format!(
            "made with version {} of the numerics, but this program has version {NUMERICS_VERSION}: the truth is equal, pixels differ",
            made.map_or("(unknown)".into(), |v| v.to_string())
        )),
    }
}

/// Adds the words that choose the recipe; returns whether they name a recipe file.
fn recipe_words(recipe: &CheckedRecipe, words: &mut Vec<String>, file: &Path) -> bool {
    let mut add = |text: &[&str]| words.extend(text.iter().map(|w| (*w).to_owned()));
    let near = recipe.as_shipped().filter(|near| near.changes.len() <= MOST_CHANGES);
    let Some(shipped) = near else {
        add(&["--recipe", &file.display().to_string()]);
        return true;
    };
    add(&[&shipped.material]);
    if let Some(tier) = shipped.tier {
        add(&["--difficulty", tier.name()]);
    }
    for change in &shipped.changes {
        match change {
            RecipeChange::Set(text) => add(&["--set", text]),
            RecipeChange::Unset(key) => add(&["--unset", key]),
        }
    }
    if let Some([rows, columns]) = shipped.grid {
        add(&["--grid", &format!("{rows}x{columns}")]);
    }
    if let Some(seed) = shipped.seed {
        add(&["--seed", &seed.to_string()]);
    }
    false
}

/// Returns the words of `stemgen build` that set these options.
fn options_words(options: &BuildOptions) -> Vec<String> {
    let usual = BuildOptions::default();
    let mut words = Vec::new();
    let mut add = |flag: &str, value: Option<String>| {
        words.push(flag.to_owned());
        words.extend(value);
    };
    if options.profile == BuildProfile::Published {
        add("--profile", Some("published".into()));
    }
    let engine = match options.method {
        BuildMethod::Auto => None,
        BuildMethod::Mosaic => Some("mosaic"),
        BuildMethod::Window => Some("window"),
        BuildMethod::Prism => Some("prism"),
        BuildMethod::Multislice => Some("multislice"),
    };
    if let Some(engine) = engine {
        add("--engine", Some(engine.into()));
    }
    if let Some(width) = options.window_angstrom {
        add("--window", Some(width.to_string()));
    }
    if let Some([x, y]) = options.interpolation {
        add("--interpolation", Some(format!("{x},{y}")));
    }
    match options.expansion {
        Expansion::Error(share) => add("--expansion", Some((100.0 * share).to_string())),
        Expansion::Off => add("--expansion", Some("off".into())),
        _ => {}
    }
    for (flag, length) in
        [("--subtile", options.subtile_nm), ("--subtile-overlap", options.subtile_overlap_nm)]
    {
        if let Some(nm) = length {
            add(flag, Some(nm.to_string()));
        }
    }
    if (options.audit_regions, options.audit_direct) != (usual.audit_regions, usual.audit_direct) {
        add("--audit", Some(options.audit_regions.to_string()));
    }
    for (flag, set) in [("--no-noise", !options.noise), ("--keep-clean", options.keep_clean)] {
        if set {
            add(flag, None);
        }
    }
    words
}

/// Returns the path of the recipe file beside a world.
pub fn recipe_file(world: &Path) -> PathBuf {
    world.with_extension("toml")
}
