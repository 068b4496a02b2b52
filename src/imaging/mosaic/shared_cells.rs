//! Library cells with their images that many libraries share.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use crate::engine::Settings;
use crate::error::Result;
use crate::imaging::mosaic::cell_images::CellImages;
use crate::made_once::MadeOnce;
use crate::specimen::units::library_cell::LibraryCell;
use crate::specimen::units::unit_tag::TurnedFamily;

/// Library cells with their images that the libraries of several specimens share, such as those of one recipe with other seeds.
#[derive(Default)]
pub struct SharedCells {
    /// By all that decides the images of a library cell.
    filled: MadeOnce<String, CellImages>,
    /// The same by family, to be found without that name, which takes long to make.
    by_family: Mutex<HashMap<TurnedFamily, Vec<FilledCell>>>,
}

/// Library cells with their images, and what decides these besides the library cells and the settings.
struct FilledCell {
    cell: Arc<CellImages>,
    sigmas_angstrom: Vec<f64>,
    configurations: usize,
}

impl SharedCells {
    /// The library cells of a family, if they were given to [`SharedCells::keep`] with all that decides their images the same.
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

    /// Keeps the library cells of a family for [`SharedCells::of_family`].
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

    /// Library cells of this name, from those that are there or else from `fill`.
    pub(super) fn get(
        &self,
        name: String,
        fill: impl FnOnce() -> Result<CellImages>,
    ) -> Result<Arc<CellImages>> {
        self.filled.get(name, fill)
    }
}
