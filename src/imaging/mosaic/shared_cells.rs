//! Library cells and their images, shared by many libraries.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use crate::engine::Settings;
use crate::error::Result;
use crate::imaging::mosaic::cell_images::CellImages;
use crate::made_once::MadeOnce;
use crate::specimen::units::library_cell::LibraryCell;
use crate::specimen::units::unit_tag::TurnedFamily;

/// Library cells and their images, shared by the libraries of several specimens, for example of one recipe with different seeds.
#[derive(Default)]
pub(crate) struct SharedCells {
    /// Filled cells, by a digest of everything that decides their images.
    filled: MadeOnce<String, CellImages>,
    /// Filled cells by family, so that they are found without the digest, which takes long to make.
    by_family: Mutex<HashMap<TurnedFamily, Vec<FilledCell>>>,
}

/// Library cells with their images, and the parameters that decide these besides geometry and settings.
struct FilledCell {
    cell: Arc<CellImages>,
    sigmas_angstrom: Vec<f64>,
    configurations: usize,
}

impl SharedCells {
    /// The library cells of a family, if [`SharedCells::keep`] was called with cells whose images would be identical.
    pub(super) fn of_family(
        &self,
        family: TurnedFamily,
        (library_cell, settings): (&LibraryCell, &Settings),
        (sigma, configurations): (&dyn Fn(u8) -> f64, usize),
    ) -> Option<Arc<CellImages>> {
        let known = self.by_family.lock().unwrap_or_else(PoisonError::into_inner);
        let same = |f: &&FilledCell| {
            f.configurations == configurations
                && f.cell.shows(library_cell, settings)
                && f.cell.elements().into_iter().map(sigma).eq(f.sigmas_angstrom.iter().copied())
        };
        known.get(&family)?.iter().find(same).map(|f| Arc::clone(&f.cell))
    }

    /// Stores the library cells of a family for [`SharedCells::of_family`].
    pub(super) fn keep(
        &self,
        family: TurnedFamily,
        cell: &Arc<CellImages>,
        (sigma, configurations): (&dyn Fn(u8) -> f64, usize),
    ) {
        let sigmas_angstrom = cell.elements().into_iter().map(sigma).collect();
        let filled = FilledCell { cell: Arc::clone(cell), sigmas_angstrom, configurations };
        let mut known = self.by_family.lock().unwrap_or_else(PoisonError::into_inner);
        known.entry(family).or_default().push(filled);
    }

    /// The library cells of this name; `fill` makes them if they are not there.
    pub(super) fn get(
        &self,
        name: String,
        fill: impl FnOnce() -> Result<CellImages>,
    ) -> Result<Arc<CellImages>> {
        self.filled.get(name, fill)
    }
}
