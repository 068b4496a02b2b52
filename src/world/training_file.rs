//! Labelled tiles as a NumPy file, in the layout of `stemworlds.export`.
//!
//! | array | shape | what |
//! |---|---|---|
//! | `images`, `clean` | (N, H, W) float32 | fractions of the beam, with and without noise; `clean` only where it is known |
//! | `heat_maps` | (N, H, W) float32 | Gaussians of height 1 about columns |
//! | `class_masks`, `phase_masks` | (N, H, W) | index into [`COLUMN_CLASSES`](super::COLUMN_CLASSES), and into the phases |
//! | `dose` | (N) | electrons per square Angstrom; only where it is known |
//! | `pixel_nm`, `angle_deg` | (N) | edge of a pixel; angle of the scan against the specimen |
//! | `centre_nm` | (N, 2) | middle of the tile, (x, y) in the full field |
//! | `index`, `source` | (N) | number of the tile; index into `recipes` |
//! | `recipes` | (M) text | TOML of the recipes; empty for a recorded image |
//! | `columns` | (K) records | `sample` (the tile's `index`), `x_px`, `y_px`, `class`, `number`, `occupancy`, `sites`, `vacancies`, `substitutions` |

use std::path::Path;

use ndarray::Array1;

use super::training_set::TrainingSet;
use crate::error::Result;
use crate::io::write_npz;
use crate::lengths;

/// The fields of `columns` in NumPy's notation of data types.
const COLUMN_FIELDS: &str = "[('sample', '<i4'), ('x_px', '<f4'), ('y_px', '<f4'), ('class', '<i4'), ('number', '<i4'), \
     ('occupancy', '<f4'), ('sites', '<i4'), ('vacancies', '<i4'), ('substitutions', '<i4')]";

/// Writes tiles of a recipe (TOML), or of a recorded image without one.
///
/// # Errors
/// [`crate::Error::Io`].
pub fn write_training_set(
    path: &Path,
    overwrite: bool,
    set: &TrainingSet,
    recipe: Option<&str>,
) -> Result<()> {
    let tiles = set.images.len_of(ndarray::Axis(0));
    write_npz(path, overwrite, |npz| {
        npz.add("images", &set.images)?;
        if !set.clean.is_empty() {
            npz.add("clean", &set.clean)?;
        }
        npz.add("heat_maps", &set.heat_maps)?;
        npz.add("class_masks", &set.class_masks)?;
        npz.add("phase_masks", &set.phase_masks)?;
        if set.dose.iter().all(|dose| dose.is_finite()) {
            npz.add("dose", &set.dose)?;
        }
        npz.add("pixel_nm", &Array1::from_elem(tiles, lengths::nm(set.pixel_angstrom)))?;
        npz.add("angle_deg", &Array1::<f64>::zeros(tiles))?;
        npz.add("centre_nm", &set.centres_nm)?;
        npz.add("index", &Array1::from_iter(0..tiles as i64))?;
        npz.add("source", &Array1::<i64>::zeros(tiles))?;
        npz.add_texts("recipes", &[recipe.unwrap_or_default()])?;
        npz.add_records("columns", COLUMN_FIELDS, set.column_tiles.len(), &columns(set))
    })
}

/// Returns the records of all columns as bytes.
fn columns(set: &TrainingSet) -> Vec<u8> {
    let mut bytes = Vec::new();
    for (row, tile) in set.column_tiles.iter().enumerate() {
        let [class, sites, vacancies, substitutions, number] =
            std::array::from_fn(|k| set.columns[[row, k]]);
        let [x, y] = [0, 1].map(|k| set.column_positions_px[[row, k]]);
        let occupancy = 1.0 - vacancies as f32 / sites.max(1) as f32;
        bytes.extend(tile.to_le_bytes());
        bytes.extend([x, y].map(f32::to_le_bytes).concat());
        bytes.extend([class, number].map(i32::to_le_bytes).concat());
        bytes.extend(occupancy.to_le_bytes());
        bytes.extend([sites, vacancies, substitutions].map(i32::to_le_bytes).concat());
    }
    bytes
}
