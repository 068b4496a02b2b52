//! The crystals of a recipe, read and oriented by the check, from which specimens are built.

use std::sync::Arc;

use super::crystal_source::CrystalSource;
use super::stacked_crystals::StackedCrystals;
use crate::error::{Error, Result};
use crate::models::particles::Metal;
use crate::structure::columns::ColumnCrystal;
use crate::structure::{LabelledAtoms, OrientedBox, Structure, direction};

/// The crystals of a recipe, each in the form that its specimen needs.
#[derive(Debug, Clone)]
#[expect(clippy::large_enum_variant, reason = "there is one for each recipe")]
pub enum OrientedCrystals {
    /// A crystal whose atoms stand in columns along the beam.
    Columns {
        /// The crystal in a box whose z axis is the zone axis.
        structure: Structure,
        /// The crystal as columns.
        columns: ColumnCrystal,
        /// The second phase of domains, or the end member of an alloy, in such a box.
        second: Option<Structure>,
    },
    /// The metal of the particles.
    Particles {
        /// Atomic number.
        number: u8,
        /// Lattice and surface of the metal.
        metal: Metal,
    },
    /// The atoms of a file.
    Atoms(Arc<LabelledAtoms>),
    /// The layers of a stack.
    Stack(Arc<StackedCrystals>),
}

/// Orients a crystal so that the beam runs along `zone_axis`.
///
/// # Errors
/// As [`Structure::oriented`], and errors of the crystal's file.
pub fn oriented(
    crystal: &CrystalSource,
    zone_axis: &str,
    y_axis: Option<&str>,
) -> Result<Structure> {
    Ok(oriented_box(crystal, zone_axis, y_axis)?.structure)
}

/// Orients a crystal like [`oriented`]; also returns its directions along the axes.
///
/// # Errors
/// As [`oriented`].
pub fn oriented_box(
    crystal: &CrystalSource,
    zone_axis: &str,
    y_axis: Option<&str>,
) -> Result<OrientedBox> {
    let zone = direction::parse(zone_axis)
        .map_err(|e| Error::invalid(crate::Setting::Zone, zone_axis, e))?;
    let up = match y_axis {
        Some(text) => {
            Some(direction::parse(text).map_err(|e| Error::invalid(crate::Setting::Up, text, e))?)
        }
        None => None,
    };
    crystal.structure()?.oriented_within(zone, up, None)
}
