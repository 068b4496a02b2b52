//! The contents of a recipe.

use serde::{Deserialize, Serialize};

use super::atoms_table::AtomsTable;
use super::crystal_source::CrystalSource;
use super::detector_tables::DetectorTables;
use super::difficulty::Difficulty;
use super::optics_table::OpticsTable;
use super::origin::RecipeOrigin;
use super::stack_table::StackTable;
use super::surface_table::SurfaceTable;
use super::tables::*;
use crate::acquisition::AcquisitionTable;
use crate::damage::DamageTable;
use crate::error::{Error, Result};

/// A resolved recipe: every value that decides the contents of a world. The values are as they were written; [`Recipe::checked`] checks
/// them against their limits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Recipe {
    /// Version of the recipe format.
    pub version: u32,
    /// Identifier of the material: `srtio3`.
    pub id: String,
    /// The tier that this recipe was resolved for, if any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tier: Option<Difficulty>,
    /// Origin of the data that readers should state, where it matters: `synthetic_replay`. It becomes an attribute of the file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub source: Option<String>,
    /// Specimen builder of the recipe.
    pub structure: StructureKind,
    /// Direction of the beam in the crystal, as text: `[001]`, `[11-20]`; `none` for particles, for the
    /// atoms of a file and for stacks.
    pub zone_axis: String,
    /// Direction along +y, perpendicular to the zone axis; the shortest such direction when absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub y_axis: Option<String>,
    /// Seed of all random numbers.
    pub seed: u64,
    /// The crystal; `none` for the atoms of a file and for stacks.
    pub crystal: CrystalSource,
    /// Field of view, tiles and thickness.
    pub field: Field,
    /// Grain boundaries (`grains`).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub boundaries: Option<Boundaries>,
    /// Domains of a second phase (`domains`).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub domains: Option<DomainTable>,
    /// Composition of an alloy (`epitaxy`).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub alloy: Option<Alloy>,
    /// Quantum wells of the alloy (`epitaxy`).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub wells: Option<Wells>,
    /// Particles on a film (`particles`).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub particles: Option<Particles>,
    /// The atoms of a file (`atoms`).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub atoms: Option<AtomsTable>,
    /// Layers of several crystals (`stack`).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stack: Option<StackTable>,
    /// Vacancies.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub vacancies: Option<Vacancies>,
    /// Random substitutions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub substitutions: Option<Substitutions>,
    /// Further kinds of point defects (`grains`).
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub defects: Vec<PointDefect>,
    /// Thermal vibration.
    pub phonons: PhononTable,
    /// The probe.
    pub optics: OpticsTable,
    /// The detector, or several.
    pub detector: DetectorTables,
    /// Noise.
    pub dose: Dose,
    /// Amorphous carbon on the faces of the specimen.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub surface: Option<SurfaceTable>,
    /// Scan and detector of a recording. Without it the tiles are the noise-free image with Poisson noise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub acquisition: Option<AcquisitionTable>,
    /// Damage by the beam in a live world. Images and worlds show the specimen before any electron has hit it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub damage: Option<DamageTable>,
    /// Origin of the values, for errors; it does not count when recipes are compared.
    #[serde(skip)]
    pub origin: RecipeOrigin,
}

impl Recipe {
    /// Returns all crystals that the recipe names: the first, the second phase or end member, and the crystals of a stack.
    pub(crate) fn crystals(&self) -> impl Iterator<Item = &CrystalSource> {
        let second = self.domains.as_ref().map(|domains| &domains.crystal);
        let end_member = self.alloy.as_ref().map(|alloy| &alloy.end_member);
        let stack = self.stack.iter().flat_map(StackTable::crystals);
        std::iter::once(&self.crystal).chain(second).chain(end_member).chain(stack)
    }

    /// Returns a recipe of the central `rows` x `columns` tiles, with the same specimen and pixel. If the difference is odd, the part lies
    /// half a tile up and left of the centre.
    ///
    /// # Errors
    /// [`Error::Invalid`] when the grid is empty or larger than the full field.
    pub fn with_grid(mut self, rows: usize, columns: usize) -> Result<Self> {
        let [r, c] = self.field.grid;
        if rows == 0 || columns == 0 || rows > r || columns > c {
            let expected = format!("the full field has {r}x{c} tiles; use 1x1 to {r}x{c}");
            return Err(Error::invalid(
                crate::Setting::Grid,
                format!("{rows}x{columns}"),
                expected,
            ));
        }
        self.field.crop = ([rows, columns] != self.field.grid).then_some([rows, columns]);
        Ok(self)
    }

    /// Returns the resolved recipe as TOML; [`Recipe::from_toml_str`] with no difficulty reads it back.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).unwrap_or_else(|e| format!("# cannot be written as TOML: {e}\n"))
    }
}
