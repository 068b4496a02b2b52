//! Recipes: what a world is made of, as TOML with one table per difficulty.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::recipe_check;
use crate::error::{Error, Result};

/// Recipes that come with the program: name and text.
const BUILT_IN: [(&str, &str); 1] = [("srtio3", include_str!("../../generate/srtio3.toml"))];

/// A tier of difficulty.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Difficulty {
    /// Many defects, much dose.
    Easy,
    /// Between.
    Medium,
    /// Few defects, little dose.
    Hard,
}

impl Difficulty {
    /// All tiers.
    pub const ALL: [Difficulty; 3] = [Difficulty::Easy, Difficulty::Medium, Difficulty::Hard];

    /// The name that recipes and the command line use.
    pub fn name(self) -> &'static str {
        match self {
            Difficulty::Easy => "easy",
            Difficulty::Medium => "medium",
            Difficulty::Hard => "hard",
        }
    }
}

impl std::str::FromStr for Difficulty {
    type Err = Error;
    fn from_str(text: &str) -> Result<Self> {
        let found = Difficulty::ALL.into_iter().find(|d| d.name() == text);
        found.ok_or_else(|| Error::invalid("difficulty", text, "expected easy, medium or hard"))
    }
}

/// A resolved recipe: every value that decides what a world holds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Recipe {
    /// Version of the recipe format.
    pub version: u32,
    /// Identifies the material: `srtio3`.
    pub id: String,
    /// The tier that this recipe was resolved for, if any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tier: Option<Difficulty>,
    /// Which specimen builder the recipe is for.
    pub structure: StructureKind,
    /// Direction of the beam in the crystal, as text.
    pub zone_axis: String,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Field of view, tiles and thickness.
    pub field: Field,
    /// The crystal.
    pub lattice: Lattice,
    /// Grain boundaries.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub boundaries: Option<Boundaries>,
    /// Vacancies.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub vacancies: Option<Vacancies>,
    /// Thermal vibration.
    pub phonons: Phonons,
    /// The probe.
    pub optics: Optics,
    /// The detector.
    pub detector: Detector,
    /// Noise.
    pub dose: Dose,
}

/// Specimen builders.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum StructureKind {
    /// Perovskite seen along \[001\], in grains rotated about the beam.
    PerovskiteGrains,
}

/// Field of view, tiles and thickness.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Field {
    /// Height and width of the full field in nm.
    pub fov_nm: [f64; 2],
    /// Rows and columns of tiles of the full field.
    pub grid: [usize; 2],
    /// Rows and columns of tiles of the central part that is built; all when absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub crop: Option<[usize; 2]>,
    /// Edge of a tile in pixels.
    pub tile_px: usize,
    /// Pixels shared by neighbouring tiles.
    pub overlap_px: usize,
    /// Thickness along the beam in nm, rounded to whole unit cells.
    pub thickness_nm: f64,
}

/// A cubic perovskite ABX3.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Lattice {
    /// Edge of the unit cell in Angstrom.
    pub a_angstrom: f64,
    /// Symbol of the element at the corner.
    pub a_site: String,
    /// Symbol of the element in the centre.
    pub b_site: String,
    /// Symbol of the element at the faces.
    pub x_site: String,
}

/// Straight symmetric tilt boundaries along y, equally spaced in x.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Boundaries {
    /// Number of boundaries.
    pub count: usize,
    /// Rotation between neighbouring grains in degrees.
    pub misorientation_deg: f64,
    /// Coincidence index; the exact coincidence angle then replaces `misorientation_deg`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sigma: Option<u32>,
    /// Least distance per pair of elements (`"Ti-O"`) in Angstrom.
    pub min_distance_angstrom: BTreeMap<String, f64>,
}

/// Vacancies of one element.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Vacancies {
    /// Symbol of the element that is missing.
    pub element: String,
    /// Vacant fraction of all its sites.
    pub rate: f64,
    /// Share of the vacancies gathered about the boundaries.
    pub cluster_fraction: f64,
    /// Standard deviation of their distance from the boundary in nm.
    pub cluster_sigma_nm: f64,
    /// Upper limit of the local vacancy probability.
    pub max_probability: f64,
    /// Distance by which cations beside a vacancy move away from it, in Angstrom.
    #[serde(default)]
    pub relaxation_angstrom: f64,
}

/// Thermal vibration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Phonons {
    /// Number of frozen configurations averaged.
    pub configurations: usize,
    /// Standard deviation of each Cartesian component in Angstrom, per element.
    pub sigma_angstrom: BTreeMap<String, f64>,
}

/// The probe.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Optics {
    /// Accelerating voltage in kV.
    pub energy_kv: f64,
    /// Convergence semi-angle in mrad.
    pub convergence_mrad: f64,
}

/// The annular detector.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Detector {
    /// Inner angle in mrad.
    pub inner_mrad: f64,
    /// Outer angle in mrad.
    pub outer_mrad: f64,
}

/// Noise.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Dose {
    /// Electrons per square Angstrom of the field.
    pub electrons_per_angstrom2: f64,
}

impl Recipe {
    /// Names of the recipes that come with the program.
    pub fn built_in() -> impl Iterator<Item = &'static str> {
        BUILT_IN.iter().map(|(name, _)| *name)
    }

    /// A recipe that comes with the program.
    ///
    /// # Errors
    /// [`Error::Invalid`] for an unknown material, naming the nearest.
    pub fn load(material: &str, difficulty: Difficulty) -> Result<Self> {
        let known = BUILT_IN.iter().find(|(name, _)| *name == material.to_ascii_lowercase());
        let (name, text) = known.ok_or_else(|| {
            let near = recipe_check::nearest(material, Recipe::built_in());
            let names = Recipe::built_in().collect::<Vec<_>>().join(", ");
            let hint = near.map(|n| format!("did you mean `{n}`? ")).unwrap_or_default();
            Error::invalid("material", material, format!("{hint}known materials: {names}"))
        })?;
        Recipe::from_toml_str(&format!("generate/{name}.toml"), text, Some(difficulty))
    }

    /// Reads a recipe from a file.
    ///
    /// # Errors
    /// [`Error::Io`], or as [`Recipe::from_toml_str`].
    pub fn from_file(path: &Path, difficulty: Option<Difficulty>) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(|e| Error::io(path, "read", e))?;
        Recipe::from_toml_str(&path.display().to_string(), &text, difficulty)
    }

    /// Parses a recipe and applies the table of `difficulty`; `name` stands in errors. A text
    /// without tables of difficulty (a resolved recipe) takes `None`.
    ///
    /// # Errors
    /// [`Error::Parse`] with the line, for bad syntax, unknown keys and values out of limits.
    pub fn from_toml_str(name: &str, text: &str, difficulty: Option<Difficulty>) -> Result<Self> {
        let source = Source { path: PathBuf::from(name), text, difficulty };
        let mut table: toml::Table =
            toml::from_str(text).map_err(|e| source.syntax_error(&e, text))?;
        let tiers = table.remove("difficulty");
        if let Some(chosen) = source.tier(tiers, difficulty)? {
            merge(&mut table, chosen);
        }
        if let Some(difficulty) = difficulty {
            table.insert("tier".into(), difficulty.name().into());
        }
        let recipe: Recipe =
            table.try_into().map_err(|e: toml::de::Error| source.value_error(e.message()))?;
        recipe_check::check(&recipe).map_err(|fault| {
            let line = source.line_of(fault.key.rsplit('.').next().unwrap_or_default());
            let Fault { key, value, expected } = fault;
            Error::parse(&source.path, line, format!("{key} = {value}: {expected}"))
        })?;
        Ok(recipe)
    }

    /// Checks every value against its limits, as needed after changing some.
    ///
    /// # Errors
    /// [`Error::Invalid`] that names the key.
    pub fn check(&self) -> Result<()> {
        recipe_check::check(self).map_err(|Fault { key, value, expected }| {
            Error::invalid("recipe", format!("{key} = {value}"), expected)
        })
    }

    /// The same specimen and pixel, but only the central `rows` x `columns` tiles. Where the
    /// difference is odd, the part lies half a tile up and left of the centre.
    ///
    /// # Errors
    /// [`Error::Invalid`] when the grid is empty or larger than the full field.
    pub fn with_grid(mut self, rows: usize, columns: usize) -> Result<Self> {
        let [r, c] = self.field.grid;
        if rows == 0 || columns == 0 || rows > r || columns > c {
            let expected = format!("the full field has {r}x{c} tiles; use 1x1 to {r}x{c}");
            return Err(Error::invalid("grid", format!("{rows}x{columns}"), expected));
        }
        self.field.crop = ([rows, columns] != self.field.grid).then_some([rows, columns]);
        Ok(self)
    }

    /// The resolved recipe as TOML; [`Recipe::from_toml_str`] with no difficulty reads it back.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).unwrap_or_else(|e| format!("# cannot be written as TOML: {e}\n"))
    }
}

impl Field {
    /// Rows and columns of the tiles that are built.
    pub fn built_grid(&self) -> [usize; 2] {
        self.crop.unwrap_or(self.grid)
    }
    /// Height and width in pixels that `grid` tiles cover.
    pub fn pixels(&self, grid: [usize; 2]) -> [usize; 2] {
        grid.map(|n| n * self.stride_px() + self.overlap_px)
    }
    /// Distance between neighbouring tiles in pixels.
    pub fn stride_px(&self) -> usize {
        self.tile_px - self.overlap_px
    }
    /// Edge of a (square) pixel in nm: width of the full field over its pixels.
    pub fn pixel_nm(&self) -> f64 {
        self.fov_nm[1] / self.pixels(self.grid)[1] as f64
    }
    /// Row and column, in pixels of the full field, of the first pixel that is built.
    pub fn crop_origin_px(&self) -> [usize; 2] {
        let built = self.built_grid();
        [0, 1].map(|i| (self.grid[i] - built[i]) / 2 * self.stride_px())
    }
}

/// A value outside its limits.
#[derive(Debug)]
pub(super) struct Fault {
    pub key: String,
    pub value: String,
    pub expected: String,
}

/// Where a recipe came from, for errors.
struct Source<'a> {
    path: PathBuf,
    text: &'a str,
    difficulty: Option<Difficulty>,
}

impl Source<'_> {
    fn syntax_error(&self, error: &toml::de::Error, text: &str) -> Error {
        let start = error.span().map_or(0, |s| s.start.min(text.len()));
        let line = text.as_bytes()[..start].iter().filter(|&&b| b == b'\n').count() + 1;
        Error::parse(&self.path, line, error.message())
    }

    /// The table of the chosen difficulty.
    fn tier(
        &self,
        tiers: Option<toml::Value>,
        difficulty: Option<Difficulty>,
    ) -> Result<Option<toml::Table>> {
        let line = self.line_of("difficulty");
        let fail = |message: String| Err(Error::parse(&self.path, line, message));
        let mut tiers = match (tiers, difficulty) {
            (None, None) => return Ok(None),
            (Some(toml::Value::Table(t)), Some(_)) => t,
            (Some(_), Some(_)) => return fail("`difficulty` is not a table".into()),
            (Some(_), None) => return fail("say which difficulty: easy, medium or hard".into()),
            (None, Some(d)) => {
                return fail(format!("there is no [difficulty.{}]; give no difficulty", d.name()));
            }
        };
        let known = Difficulty::ALL.map(Difficulty::name);
        if let Some(key) = tiers.keys().find(|k| !known.contains(&k.as_str())) {
            return Err(self.unknown_key(key, known.into_iter()));
        }
        match difficulty.and_then(|d| tiers.remove(d.name())) {
            Some(toml::Value::Table(t)) => Ok(Some(t)),
            Some(_) => fail("a difficulty has to be a table".into()),
            None => fail("the recipe has no table for this difficulty".into()),
        }
    }

    /// An error of deserialisation; serde's list of fields yields the nearest known key.
    fn value_error(&self, message: &str) -> Error {
        let quoted: Vec<&str> = message.split('`').skip(1).step_by(2).collect();
        match quoted.split_first() {
            Some((key, known)) if message.starts_with("unknown field") => {
                self.unknown_key(key, known.iter().copied())
            }
            Some((key, _)) => Error::parse(&self.path, self.line_of(key), message.trim()),
            None => Error::parse(&self.path, 0, message.trim()),
        }
    }

    fn unknown_key<'k>(&self, key: &str, known: impl Iterator<Item = &'k str> + Clone) -> Error {
        let message = match recipe_check::nearest(key, known.clone()) {
            Some(near) => format!("unknown key `{key}`; did you mean `{near}`?"),
            None => format!("unknown key `{key}`; known: {}", known.collect::<Vec<_>>().join(", ")),
        };
        Error::parse(&self.path, self.line_of(key), message)
    }

    /// The line that mentions `key`: in the table of the difficulty if there, else the first. 0 if
    /// there is none.
    fn line_of(&self, key: &str) -> usize {
        let word = |c: char| c.is_alphanumeric() || c == '_' || c == '-';
        let mentions = |line: &str| {
            let code = line.split('#').next().unwrap_or("");
            code.split(|c| !word(c)).any(|w| w == key)
        };
        let header = self.difficulty.map(|d| format!("[difficulty.{}", d.name()));
        let (mut first, mut inside) = (0, false);
        for (n, line) in self.text.lines().enumerate() {
            if line.starts_with('[') {
                inside = header.as_ref().is_some_and(|h| line.starts_with(h));
            }
            match mentions(line) {
                true if inside => return n + 1,
                true if first == 0 => first = n + 1,
                _ => {}
            }
        }
        first
    }
}

/// Lays `over` over `base`, table by table.
fn merge(base: &mut toml::Table, over: toml::Table) {
    for (key, value) in over {
        match (base.get_mut(&key), value) {
            (Some(toml::Value::Table(inner)), toml::Value::Table(more)) => merge(inner, more),
            (_, value) => drop(base.insert(key, value)),
        }
    }
}
