//! What results take on disk, estimated from above.

use crate::recipe::tables::Field;
use crate::structure::Format;

/// Bytes of a pixel of a tile; noise compresses to about half of them.
const PIXEL: u64 = 4;
/// Bytes of a site in a world: 3 to 4 of a perfect crystal, 14 where no two positions are alike.
const WORLD_SITE: u64 = 16;
/// Bytes of the sub-tiles kept during a build, for each pixel; their overlaps count twice.
const SUBTILE_PIXEL: u64 = 6;
/// Bytes of a site in extended XYZ and in CIF.
const XYZ_SITE: u64 = 56;
const CIF_SITE: u64 = 72;

/// Bytes that the build of a world needs, sub-tiles included.
pub fn world_bytes(field: &Field, sites: u64, keep_clean: bool) -> u64 {
    let [height, width] = field.pixels(field.built_grid()).map(|n| n as u64);
    let images = if keep_clean { 2 } else { 1 };
    let [rows, columns] = field.built_grid().map(|n| n as u64);
    let tiles = rows * columns * (field.tile_px * field.tile_px) as u64 * PIXEL * images;
    tiles + height * width * SUBTILE_PIXEL + sites * WORLD_SITE
}

/// Bytes of a file of so many atoms.
pub fn atoms_bytes(format: Format, sites: u64) -> u64 {
    sites * if format == Format::Cif { CIF_SITE } else { XYZ_SITE }
}

/// Bytes of the files in a folder; 0 if there is none.
#[cfg(feature = "hdf5")]
pub(super) fn folder_bytes(folder: &std::path::Path) -> u64 {
    let Ok(entries) = std::fs::read_dir(folder) else { return 0 };
    entries.filter_map(|e| e.ok()?.metadata().ok()).map(|m| m.len()).sum()
}
