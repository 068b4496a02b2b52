//! Makes training tiles from the stored image of a world without a recipe.

use ndarray::{Axis, s};

use crate::error::{Error, Result};
use crate::io::WorldFile;
use crate::lengths;
use crate::progress::Progress;
use crate::world::column_labels::{REACH_SIGMAS, class_of_counts, draw_column};
use crate::world::training_set::{ColumnLists, TrainingOptions, TrainingSet, check_sizes, corner};

/// Cuts tiles with labels from the image of a world file, noise included: `clean` has no tiles, and the dose is not known (NaN). Places are
/// drawn as for a world with a recipe, but no recipe is needed.
///
/// # Errors
/// [`Error::Invalid`] for tiles larger than the image and options out of limits; errors of the file, [`Error::Interrupted`].
pub fn stored_training_set(
    world: &WorldFile,
    options: &TrainingOptions,
    progress: &dyn Progress,
) -> Result<TrainingSet> {
    let (shape, size) = (world.shape(), options.size_px);
    check_sizes(shape, options)?;
    let pixel_nm = world.metadata().pixel_size_nm;
    let mut set = TrainingSet::empty(options.tiles, size, lengths::angstrom(pixel_nm));
    set.clean = ndarray::Array3::zeros((0, size, size));
    set.dose.fill(f64::NAN);
    let columns = world.columns()?;
    let mut lists = ColumnLists::default();
    progress.start("tiles", "tile", options.tiles as u64);
    for tile in 0..options.tiles {
        if progress.interrupted() {
            return Err(Error::Interrupted);
        }
        let [row, column] = corner(shape, options, tile as u64);
        let (rows, places) = (row..row + size, column..column + size);
        let image = world.stitched(rows.clone(), places.clone())?;
        world.check_finite(&image, [row, column], false)?;
        set.images.slice_mut(s![tile, .., ..]).assign(&image);
        set.place(tile, [row, column]);
        if let Some(map) = world.phase_map(rows, places)? {
            set.phase_masks.index_axis_mut(Axis(0), tile).assign(&map);
        }
        let mut heat = set.heat_maps.index_axis_mut(Axis(0), tile);
        let mut mask = set.class_masks.index_axis_mut(Axis(0), tile);
        let reach = REACH_SIGMAS * options.sigma_px;
        for found in &columns {
            let [x, y] = found.position_nm.map(|nm| f64::from(nm) / pixel_nm);
            let at = [y - row as f64, x - column as f64];
            if !at.iter().all(|v| (-reach..size as f64 + reach).contains(v)) {
                continue;
            }
            let class = class_of_counts(found.vacancies, found.substitutions);
            draw_column(at, class, options.sigma_px, &mut heat, &mut mask);
            if at.iter().all(|v| (-0.5..size as f64 - 0.5).contains(v)) {
                // The elements are not known, so the atomic number is 0.
                let facts =
                    [i32::from(class), found.sites, found.vacancies, found.substitutions, 0];
                lists.add(tile, at, facts);
            }
        }
        progress.advance(1);
    }
    progress.finish();
    Ok(lists.into_set(set))
}
